"""The targets `fmu2` and `fmu3`: a directory with the FMU, a page that says how to use it, and the machine file."""

from __future__ import annotations

from pathlib import Path

from feeddrive.export.design import CONTROL, MACHINE_FILE, Design
from feeddrive.export.fmu.fmu import fmu
from feeddrive.export.fmu.variables import FmuVariable, variables
from feeddrive.export.manifest import FILE, manifest_text, rules_table
from feeddrive.files.atomic_io import check_directory, new_directory


def write_fmu(design: Design, out: Path, *, version: int = 2, binary: bool = True) -> Path:
    """Write the export, whole or not at all; the README is returned.

    Raises FileError as `new_directory` and what `fmu` raises.
    """
    check_directory(out)
    content = fmu(design.layout, version, title=design.title, made_by=design.made_by, binary=binary)
    files: dict[str, bytes | str] = {
        f"{design.name}.fmu": content, "README.md": _readme(design, version, binary),
        MACHINE_FILE: design.machine.file.text,
    }  # fmt: skip
    files[FILE] = manifest_text(design, f"fmu{version}", files, binary=binary)
    with new_directory(out) as folder:
        for name, each in files.items():
            (folder / name).write_bytes(each.encode() if isinstance(each, str) else each)
    return out / "README.md"


def _readme(design: Design, version: int, binary: bool) -> str:
    return _README.format(
        title=design.title,
        made_by=design.made_by,
        file=f"{design.name}.fmu",
        version=version,
        T=f"{1e6 * design.routine.sample_time:g}",
        use=_CONTROL if design.what == CONTROL else _PLANT,
        binary="It holds a binary for the machine it was made on." if binary else "It holds sources only, no binary.",
        rules=rules_table(design.routine),
        table="\n".join(["| variable | what | unit | meaning | start |", "|---|---|---|---|---|", *_rows(design)]),
    )


def _rows(design: Design) -> list[str]:
    return [
        f"| `{each.name}` | {_what(each)} | {each.unit} | {each.meaning.replace('|', chr(92) + '|')} | {_start(each)} |"
        for each in variables(design.routine)
        if each.group != "time"
    ]


def _what(variable: FmuVariable) -> str:
    if variable.group in ("input", "output"):
        return variable.group
    return "tunable parameter" if variable.tunable else "fixed parameter"


def _start(variable: FmuVariable) -> str:
    return "" if variable.start is None else f"{variable.start:.10g}" if variable.kind == "number" else "false"


_README = """\
# {title}

{made_by}

`{file}` is a component for co-simulation by FMI {version}.0.

- One step takes {T} µs. A communication step must be a whole multiple of it: any other is refused.
- Every number is in SI; forces and velocities are those of the table.
- Inputs are held over a step; outputs are those at its end, so that none depends on an input of the same instant.
{use}
- {binary} For another machine: `fmpy compile {file}`, which needs a C compiler, or the files of `sources/` with
  `-ffp-contract=off` and without `-ffast-math`.
- States can be kept, restored and serialized; directional derivatives are not provided.

## Variables

{table}

## Rules of the parameters

Parameters that break one of these rules are refused with an error whose message names it: at the end of the
initialization, and at the next step, after which the old parameters go on.

{rules}
"""
_CONTROL = """\
- Let the controller step first and hand its force to the plant before the plant steps: the other order adds a sample of
  dead time.
- The loop is off until `enable` is given, and takes over where the axis is. A trip is latched until `enable` is taken
  away; it is logged under `logEvents`.
- Tunable parameters may be set between steps; the state follows, so that the force has no bump.

**Before this controls a machine**, on whatever: check sign and unit of every reading and of the command with the drive
switched off; make the first moves with a reduced force limit, the emergency stop in reach, and a hanging axis held from
below. It was proven to compute what was simulated; nobody proved that the machine is the one that was simulated.
"""
_PLANT = """\
- It starts at rest at `start_position`. Its parameters are fixed once it is initialized.
- It is the machine of the machine file, with the noise of one seed; it is no measured machine.
"""

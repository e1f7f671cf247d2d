"""The directory that `feeddrive export --target fmu2` or `fmu3` leaves: the FMU and a page that says how to use it."""

from __future__ import annotations

from pathlib import Path

from feeddrive.artefacts.export.fmu.fmu import fmu
from feeddrive.artefacts.export.fmu.variables import variables
from feeddrive.artefacts.export.identifiers import check_name
from feeddrive.artefacts.files.machine import Machine
from feeddrive.artefacts.files.whole import check_directory, new_directory
from feeddrive.loop.routine import Routine, controller_routine, plant_routine

_README = """\
# {title}

`{file}` is a component for co-simulation by FMI {version}.0, made by feeddrive from {source}.

- One step takes {T:g} s. A communication step must be a whole multiple of it; any other is answered with `Discard`.
- Every number is in SI; units and meanings stand in modelDescription.xml.
- Inputs are held over a step. {order}
- {binary}
- To compile it for another machine: `fmpy compile {file}` (needs CMake and a C compiler), or the files of `sources/`
  with `-ffp-contract=off` and without `-ffast-math`.

{table}

This was simulated, not run on a machine. Before it moves one: check every number, start with a small limit of the force
and of the speed, and keep the emergency stop in reach.
"""
_ORDER = {
    "controller": "In a loop let the controller step first and hand its force to the plant before the plant steps: the "
    "other order adds a sample of dead time.",
    "plant": "Its outputs are those at the end of a step.",
}


def write_fmu(
    machine: Machine,
    axis: str | None,
    out: str | Path,
    *,
    version: int = 2,
    plant: bool = False,
    name: str | None = None,
    binary: bool = True,
) -> Path:
    """Write the FMU of an axis' control, and with `plant` that of the axis beside it, into a directory; its path.

    Files are NAME.fmu, NAME_plant.fmu and README.md; `name` is by default the axis' name behind `axis_`.

    compiler refuses, and MissingProgramError without a compiler (unless `binary` is false).
    """
    loop = machine.loop(axis)
    axis = axis or next(iter(machine.loops))
    name = name or f"axis_{axis}"
    check_name(name, "--name")
    check_directory(out)
    made = {name: (controller_routine(loop, name), f"{machine.name}, axis {axis}: {loop.control.law.kind}")}
    if plant:
        made[f"{name}_plant"] = (
            plant_routine(loop, f"{name}_plant"), f"{machine.name}, axis {axis}: {loop.axis.plant.kind} plant"
        )  # fmt: skip
    source = Path(machine.file.name).name
    content = {
        f"{name}.fmu": fmu(routine, version, title=title, source=source, binary=binary)
        for name, (routine, title) in made.items()
    }
    pages = [_page(routine, title, version, source, binary) for routine, title in made.values()]
    with new_directory(out) as folder:
        for file, content_ in content.items():
            (folder / file).write_bytes(content_)
        (folder / "README.md").write_text("\n\n".join(pages), encoding="utf-8")
    return Path(out)


def _page(routine: Routine, title: str, version: int, source: str, binary: bool) -> str:
    rows = ["| variable | | unit | meaning |", "|---|---|---|---|"]
    for each in variables(routine):
        if each.group in ("start", "parameter", "input", "output"):
            group = "fixed parameter" if each.group == "start" or not each.tunable else "tunable parameter"
            group = each.group if each.group in ("input", "output") else group
            rows.append(f"| `{each.name}` | {group} | {each.unit} | {each.meaning.replace('|', chr(92) + '|')} |")
    return _README.format(
        title=title,
        file=f"{routine.name}.fmu",
        version=version,
        source=source,
        T=routine.sample_time,
        order=_ORDER[routine.memory],
        binary="It holds a binary for the machine it was made on." if binary else "It holds sources only, no binary.",
        table="\n".join(rows),
    )

"""The target `st`: a directory with a control as Structured Text, in the forms that PLC tools import, and a README."""

from __future__ import annotations

import inspect
import textwrap
from pathlib import Path

from feeddrive.export.design import CONTROL, MACHINE_FILE, Design
from feeddrive.export.manifest import FILE, manifest_text, rules_table
from feeddrive.export.structured_text.check import SAMPLES, check
from feeddrive.export.structured_text.controller import Program, program
from feeddrive.export.structured_text.project_files import plcopen, twincat_file
from feeddrive.export.structured_text.units import INPUTS, OUTPUTS, WIDTH, Declared
from feeddrive.files.atomic_io import new_directory
from feeddrive.language.errors import ParameterError
from feeddrive.loop.guard import TRIPS


def structured_text_files(design: Design) -> dict[str, str]:
    """The files of the export by name, without machine file and manifest.

    Raises ParameterError for an axis, StructureError for a table with too many entries.
    """
    if design.what != CONTROL:
        raise ParameterError("st: a PLC runs the control; export an axis as fmu2, fmu3 or c")
    P = design.name
    printed = program(design.layout, header(design))
    tried = check(design.layout, printed)
    parts = (*printed.structures, *printed.units, tried)
    files = {f"{P}.st": printed.text(), f"{P}_check.st": tried.text(), f"{P}.xml": plcopen(P, parts)}
    files |= {f"twincat/{name}": content for name, content in map(twincat_file, parts)}
    files["README.md"] = readme(design, printed)
    return files


def write_structured_text(design: Design, out: Path) -> Path:
    """Write the export, whole or not at all; its README is returned.

    Raises as `structured_text_files`, and FileError as `new_directory`.
    """
    files = structured_text_files(design)
    files[MACHINE_FILE] = design.machine.file.text
    files[FILE] = manifest_text(design, "st", files)
    with new_directory(out) as folder:
        (folder / "twincat").mkdir()
        for name, content in files.items():
            (folder / name).write_text(content, encoding="utf-8")
    return out / "README.md"


def header(design: Design) -> str:
    """The comment above the function block: what it is, how it is called, and what its blocks say of themselves."""
    parts = [
        design.title,
        design.made_by,
        f"Call it once in every cycle of a task with a cycle of {_time(design)}.",
    ]
    for path, block in design.routine.blocks:
        said = inspect.getdoc(type(block))
        if path and said:
            parts.append(f"{path}: {block.kind}\n{textwrap.indent(said, '  ')}")
    lines: list[str] = []
    for line in "\n\n".join(parts).split("\n"):
        indent = " " * (len(line) - len(line.lstrip()))
        lines += textwrap.wrap(line, WIDTH, subsequent_indent=indent) or [""]
    return "\n".join(lines)


def readme(design: Design, program: Program) -> str:
    """What is in the directory, how it is imported and called, and what to mind before an axis moves."""
    P, block = design.name, program.block
    inputs, outputs = block.sections[INPUTS], block.sections[OUTPUTS]
    codes = "\n".join(f"| {code:.0f} | {text} |" for code, text in TRIPS.items())
    parts = [
        f"# {design.title}",
        design.made_by,
        _READ.format(P=P),
        _SAFETY,
        _IMPORT.format(P=P),
        _CALL.format(P=P, time=_time(design), call=_call(design)),
        _TRAPS.format(P=P, samples=SAMPLES),
        f"## What `trip` says\n\n| code | tripped by |\n|---|---|\n| 0 | nothing |\n{codes}",
        "## Inputs\n\n" + _table(inputs),
        "## Outputs\n\n" + _table(outputs),
        "## Parameters\n\n" + _parameters(design, program),
        "## Rules of the parameters\n\n" + rules_table(design.routine),
    ]
    return "\n\n".join(parts) + "\n"


def _time(design: Design) -> str:
    return f"{1e6 * design.routine.sample_time:.10g} µs"


def _call(design: Design) -> str:
    lines = [f"    {v.name} := {v.name}," for v in design.routine.inputs]
    return "\n".join([*lines, "    cycle_time := cycle_time);"])


def _table(variables: list[Declared]) -> str:
    rows = [f"| `{v.name}` | {v.kind} | {v.meaning.replace('|', chr(92) + '|')} |" for v in variables]
    return "\n".join(["| name | type | meaning |", "|---|---|---|", *rows])


def _parameters(design: Design, program: Program) -> str:
    rows = []
    for v in design.routine.parameters:
        name = f"`{program.names[v.path]}`" if v.path in program.names else "fixed"
        rows.append(f"| {name} | `{v.path}` | {v.value:.10g} | {v.unit} | {v.meaning.replace('|', chr(92) + '|')} |")
    lines = ["| field | in the machine file | value | unit | meaning |", "|---|---|---|---|---|", *rows]
    if program.fixed.parameters:
        lines += ["", _FIXED]
    return "\n".join(lines)


_READ = """\
`{P}.st` holds all of it as text, to be read beside the law. The numbers are those of `machine.toml`, which is in this
directory. Positions, forces and all else are in SI; forces and velocities are those of the table.

| file | for |
|---|---|
| `{P}.st` | reading; compilers that take plain text |
| `{P}.xml` | CODESYS and others that import PLCopen XML |
| `twincat/` | TwinCAT 3: a file for each structure, function and function block |
| `{P}_check.st` | a function block that tries the controller on the PLC; it is in the other two as well |"""

_SAFETY = """\
**Before this moves an axis**: check sign and unit of every reading and of the command with the drive switched off; make
the first moves with reduced force limit, the emergency stop in reach, and a hanging axis held from below. This text was
proven to compute what was simulated; nobody proved that the machine is the one that was simulated. It is no safety
function: the emergency stop, the brake and the limit switches must work without it."""

_IMPORT = """\
## Import

- **TwinCAT 3**: in the Solution Explorer, right-click a folder of the PLC project, *Add*, *Existing Item*, and choose
  all files of `twincat/`.
- **CODESYS**: select the application, then *Project*, *Import*, *Import PLCopenXML*, and choose `{P}.xml`.
- **A compiler of plain text** (strict IEC 61131-3): add `{P}.st` before the program that calls it."""

_CALL = """\
## Call

```
VAR
    controller : {P};
END_VAR

controller(
{call}
```

- Call it once in every cycle of a task with a cycle of **{time}**; the law is designed for that time and no other.
  Connect `cycle_time` with what the PLC says of the task, in s; where that is another time, `cycle_wrong` is set and
  the loop stays off. Left open, nothing is checked. In TwinCAT it is
  `UDINT_TO_LREAL(_TaskInfo[GETCURTASKINDEXEX()].CycleTime) * 1.0E-7`.
- `force` is limited and never NaN. `enabled` drops when the loop is off or tripped: let it drop the drive.
- A trip is latched. Take `enable` away and give it again: the loop takes over where the axis is.
- `parameters` are read in the first cycle. To change them while the loop runs, write into them, then give `retune` a
  rising edge: state and force go on without a jump.
- Parameters that the simulation refuses are refused here: `broken_rule` is then the code of the first rule that they
  break, and the table below has its sentence. At a retune the old parameters go on. In the first cycle and at a reset
  the block commands the safe force of the machine file until the parameters are mended.
- `reset` starts anew where the axis is."""

_TRAPS = """\
## What a PLC may do otherwise

- A reading that is NaN is caught by comparisons, as IEEE 754 has them: each one with NaN is false. **Some runtimes stop
  at such a comparison**, and at a division by zero; in TwinCAT, untick *Floating Point Exceptions* in the settings of
  the task. Otherwise one broken reading stops the PLC and not the loop.
- Every operation must be rounded to its type by itself: no extended precision of an x87 unit, no fused multiplication
  and addition. Numbers below the normal ones count as zero in the simulation; a PLC may keep them, which nobody sees.
- `{P}_check` finds out: call an instance in any task until `done`. `wrong = 0` says that {samples} samples, with a live
  change of parameters, gave the simulator's outputs, all bits."""

_FIXED = """\
Fixed parameters are no inputs: what is computed from them, such as a matrix exponential, is too much for a PLC and was
computed at the export. To change them, export anew."""

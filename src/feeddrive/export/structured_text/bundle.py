"""The target `st`: a directory with a control as Structured Text, in the forms that PLC tools import, and a README."""

from __future__ import annotations

import inspect
import textwrap
from pathlib import Path

from feeddrive.export.design import CONTROL, MACHINE_FILE, Design
from feeddrive.export.manifest import FILE, manifest_text
from feeddrive.export.readme import readme
from feeddrive.export.structured_text.check import SAMPLES, check
from feeddrive.export.structured_text.controller import Program, program
from feeddrive.export.structured_text.project_files import plcopen, twincat_file
from feeddrive.export.structured_text.units import INPUTS, OUTPUTS, WIDTH
from feeddrive.files.atomic_io import new_directory
from feeddrive.language.errors import ParameterError


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
    files["README.md"] = _readme(design, printed)
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


def _readme(design: Design, printed: Program) -> str:
    return readme(
        "structured_text.md.j2", design, time=_time(design), samples=SAMPLES,
        inputs=printed.block.sections[INPUTS], outputs=printed.block.sections[OUTPUTS],
        fields=printed.names, fixed=printed.fixed.parameters,
    )  # fmt: skip


def _time(design: Design) -> str:
    return f"{1e6 * design.routine.sample_time:.10g} µs"

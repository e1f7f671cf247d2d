"""The target `st`: a control as Structured Text, import files for PLC tools, a test block, and a README."""

from __future__ import annotations

import inspect
import re
import textwrap
import uuid
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from feeddrive.export.c_bundle import stepped
from feeddrive.export.design import CONTROL, Design
from feeddrive.export.identifiers import bare
from feeddrive.export.layout import Layout
from feeddrive.export.manifest import readme, write_bundle
from feeddrive.export.structured_text_code import (
    CONSTANTS,
    INDENT,
    INPUTS,
    OUTPUTS,
    VARIABLES,
    WIDTH,
    Declared,
    Structure,
    Unit,
    decimal,
    literal,
)
from feeddrive.export.structured_text_control import Program, program
from feeddrive.export.trial import Trial, trial
from feeddrive.language.errors import ParameterError
from feeddrive.loop.routine_run import run
from feeddrive.version import __version__


def structured_text_files(design: Design) -> dict[str, str]:
    """Return the files of the export by name, without machine file and manifest.

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
    """Write the export, completely or not at all, and return its README.

    Raises as `structured_text_files`, and FileError as `new_directory`.
    """
    files = structured_text_files(design)
    return write_bundle(design, "st", out, files)


def header(design: Design) -> str:
    """Return the comment above the function block: its title, how it is called, and the docstrings of its blocks."""
    parts = [
        design.title,
        design.made_by,
        f"Call it once in every cycle of a task with a cycle of {_time(design)}.",
    ]
    for path, block in design.routine.blocks:
        docstring = inspect.getdoc(type(block))
        if path and docstring:
            parts.append(f"{path}: {block.kind}\n{textwrap.indent(docstring, '  ')}")
    lines: list[str] = []
    for line in "\n\n".join(parts).split("\n"):
        indent = " " * (len(line) - len(line.lstrip()))
        lines += textwrap.wrap(line, WIDTH, subsequent_indent=indent) or [""]
    return "\n".join(lines)


def _readme(design: Design, printed: Program) -> str:
    return readme(
        "structured_text.md.j2",
        design,
        time=_time(design),
        samples=SAMPLES,
        inputs=printed.block.sections[INPUTS],
        outputs=printed.block.sections[OUTPUTS],
        fields=printed.names,
        fixed=printed.fixed.parameters,
    )


def _time(design: Design) -> str:
    return f"{1e6 * design.routine.sample_time:.10g} µs"


NAMESPACE = "http://www.plcopen.org/xml/tc6_0200"
_XHTML = "http://www.w3.org/1999/xhtml"
_PLACES = {INPUTS: "inputVars", OUTPUTS: "outputVars", VARIABLES: "localVars", CONSTANTS: "localVars"}
_ARRAY = re.compile(r"ARRAY\[(\d+)\.\.(\d+)\] OF (\w+)")
_ELEMENTARY = ("LREAL", "REAL", "BOOL", "INT", "DINT")
_WHEN = "2000-01-01T00:00:00"  # the format wants a date; the same export has the same bytes


def plcopen(name: str, parts: Iterable[Structure | Unit]) -> str:
    """Return the text of the PLCopen project file."""
    parts = list(parts)
    project = ET.Element("project", {"xmlns": NAMESPACE})
    ET.SubElement(
        project,
        "fileHeader",
        companyName="",
        productName="feeddrive",
        productVersion=__version__,
        creationDateTime=_WHEN,
    )
    header = ET.SubElement(project, "contentHeader", name=name)
    scales = ET.SubElement(header, "coordinateInfo")
    for language in ("fbd", "ld", "sfc"):
        ET.SubElement(ET.SubElement(scales, language), "scaling", x="1", y="1")
    types = ET.SubElement(project, "types")
    data, units = ET.SubElement(types, "dataTypes"), ET.SubElement(types, "pous")
    for part in parts:
        if isinstance(part, Structure):
            kind = ET.SubElement(ET.SubElement(data, "dataType", name=part.name), "baseType")
            struct = ET.SubElement(kind, "struct")
            for field in part.declared():
                _variable(struct, field)
        else:
            _unit(units, part)
    ET.SubElement(ET.SubElement(project, "instances"), "configurations")
    ET.indent(project, " ")
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(project, encoding="unicode") + "\n"


def _unit(units: ET.Element, unit: Unit) -> None:
    pou = ET.SubElement(units, "pou", name=unit.name, pouType="function" if unit.result else "functionBlock")
    interface = ET.SubElement(pou, "interface")
    if unit.result:
        _type(ET.SubElement(interface, "returnType"), unit.result)
    for section, place in _PLACES.items():
        if unit.sections.get(section):
            constant = {"constant": "true"} if section == CONSTANTS else {}
            variables = ET.SubElement(interface, place, constant)
            for declared in unit.sections[section]:
                _variable(variables, declared)
    text = ET.SubElement(ET.SubElement(ET.SubElement(pou, "body"), "ST"), "xhtml", xmlns=_XHTML)
    text.text = "\n" + unit.implementation()
    if unit.comment:
        _document(pou, unit.comment)


def _variable(parent: ET.Element, declared: Declared) -> None:
    variable = ET.SubElement(parent, "variable", name=declared.name)
    _type(ET.SubElement(variable, "type"), declared.kind)
    if declared.value:
        initial = ET.SubElement(variable, "initialValue")
        if declared.value.startswith("["):
            row = ET.SubElement(initial, "arrayValue")
            for value in declared.value.strip("[]").split(", "):
                ET.SubElement(ET.SubElement(row, "value"), "simpleValue", value=value)
        else:
            ET.SubElement(initial, "simpleValue", value=declared.value)
    if declared.meaning:
        _document(variable, declared.meaning)


def _document(parent: ET.Element, text: str) -> None:
    ET.SubElement(ET.SubElement(parent, "documentation"), "xhtml", xmlns=_XHTML).text = text


def _type(parent: ET.Element, kind: str) -> None:
    array = _ARRAY.fullmatch(kind)
    if array:
        inner = ET.SubElement(parent, "array")
        ET.SubElement(inner, "dimension", lower=array[1], upper=array[2])
        _type(ET.SubElement(inner, "baseType"), array[3])
    elif kind in _ELEMENTARY:
        ET.SubElement(parent, kind)
    else:
        ET.SubElement(parent, "derived", name=kind)


_HEAD = '<?xml version="1.0" encoding="utf-8"?>\n<TcPlcObject Version="1.1.0.1" ProductVersion="3.1.4024.12">\n'


def twincat_file(part: Structure | Unit) -> tuple[str, str]:
    """Return name and content of the file of a structure, function or function block."""
    if isinstance(part, Structure):
        body = f"    <Declaration><![CDATA[{_cdata(part.text())}]]></Declaration>\n"
        return f"{part.name}.TcDUT", _wrapped("DUT", part.name, "", body)
    body = (
        f"    <Declaration><![CDATA[{_cdata(part.declaration())}]]></Declaration>\n"
        f"    <Implementation>\n      <ST><![CDATA[{_cdata(part.implementation())}]]></ST>\n    </Implementation>\n"
    )
    return f"{part.name}.TcPOU", _wrapped("POU", part.name, ' SpecialFunc="None"', body)


def _wrapped(tag: str, name: str, more: str, body: str) -> str:
    """Wrap an element. Its GUID depends on the name alone, so that a repeated export replaces the file in a project."""
    identity = uuid.uuid5(uuid.NAMESPACE_URL, f"feeddrive/{tag}/{name}")
    return f'{_HEAD}  <{tag} Name="{name}" Id="{{{identity}}}"{more}>\n{body}  </{tag}>\n</TcPlcObject>\n'


def _cdata(text: str) -> str:
    """Return text that cannot end its CDATA section."""
    return text.replace("]]>", "]] >")


SAMPLES = 100  # they are constants in the memory of the PLC
_SAID = """\
Tries {name} on this PLC: call it in any task until done. It gives {samples} stored samples to the controller, with
a live change of parameters in between, and compares every output with the simulator's, all bits.
wrong = 0 says that this PLC computes what was simulated; otherwise first_wrong is the first sample that differs."""


def check(layout: Layout, program: Program, seed: int = 0) -> Unit:
    """Return the function block `axis_x_check`, which compares the controller with stored samples."""
    routine, name = layout.routine, layout.routine.name
    real = "LREAL" if layout.precision == "double" else "REAL"
    tried = trial(routine, SAMPLES, seed, changes=1, broken=0.0)
    changes = {
        sample: {path: value for path, value in changed.items() if path in program.names}
        for sample, changed in tried.changes.items()
    }
    tried = Trial(tried.inputs, changes)
    expected = run(routine, tried.inputs, changes) if real == "LREAL" else stepped(layout, tried)
    signals = {v.name: tried.inputs[:, i] for i, v in enumerate(routine.inputs)}
    wanted = {v.name: expected[:, i] for i, v in enumerate(routine.outputs)}
    constants = [_array(f"given_{signal}", signal, row, real) for signal, row in signals.items()]
    constants += [_array(f"wanted_{signal}", signal, row, real) for signal, row in wanted.items()]
    retunes = [f"(k = {sample})" for sample in changes]
    calls = [f"{signal} := given_{signal}[k]" for signal in signals]
    calls += [f"retune := {' OR '.join(retunes) or 'FALSE'}", "parameters := parameters"]
    differs = " OR ".join(f"(tried.{signal} <> wanted_{signal}[k])" for signal in wanted)
    body = [
        "IF NOT done THEN",
        *(INDENT + line for line in _changes(changes, program)),
        f"{INDENT}tried(",
        *(f"{INDENT * 2}{call}{',' if call != calls[-1] else ');'}" for call in calls),
        f"{INDENT}IF {differs} THEN",
        f"{INDENT * 2}IF wrong = 0 THEN",
        f"{INDENT * 3}first_wrong := k;",
        f"{INDENT * 2}END_IF;",
        f"{INDENT * 2}wrong := wrong + 1;",
        f"{INDENT}END_IF;",
        f"{INDENT}k := k + 1;",
        f"{INDENT}done := k >= {SAMPLES};",
        "END_IF;",
    ]
    return Unit(
        f"{name}_check",
        _SAID.format(name=name, samples=SAMPLES),
        sections={
            OUTPUTS: [
                Declared("done", "BOOL", "FALSE"),
                Declared("wrong", "DINT", "0", "samples that differ"),
                Declared("first_wrong", "DINT", "-1"),
            ],
            VARIABLES: [
                Declared("tried", name),
                Declared("parameters", f"{name}_parameters"),
                Declared("k", "DINT", "0"),
            ],
            CONSTANTS: constants,
        },
        body=body,
    )


def _changes(changes: dict[int, dict[str, float]], program: Program) -> list[str]:
    lines: list[str] = []
    for sample, changed in changes.items():
        lines.append(f"IF k = {sample} THEN")
        lines += [f"{INDENT}parameters.{program.names[path]} := {bare(literal(v))};" for path, v in changed.items()]
        lines += ["END_IF;"] if changed else [f"{INDENT};", "END_IF;"]
    return lines


def _array(name: str, signal: str, row: Sequence[float] | np.ndarray, real: str) -> Declared:
    """Return a signal over the samples, as an array in the type of the controller's interface."""
    if signal in ("enable", "enabled"):
        kind, texts = "BOOL", ["TRUE" if x > 0.5 else "FALSE" for x in row]
    elif signal == "trip":
        kind, texts = "INT", [f"{x:.0f}" for x in row]
    else:
        kind, texts = real, [decimal(float(x), real) for x in row]
    return Declared(name, f"ARRAY[0..{len(texts) - 1}] OF {kind}", f"[{', '.join(texts)}]")

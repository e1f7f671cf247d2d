"""Import files for PLC tools: PLCopen XML for CODESYS and others, and TwinCAT's format."""

from __future__ import annotations

import re
import uuid
import xml.etree.ElementTree as ET
from collections.abc import Iterable

from feeddrive.export.structured_text.units import CONSTANTS, INPUTS, OUTPUTS, VARIABLES, Declared, Structure, Unit
from feeddrive.version import __version__

NAMESPACE = "http://www.plcopen.org/xml/tc6_0200"
_XHTML = "http://www.w3.org/1999/xhtml"
_PLACES = {INPUTS: "inputVars", OUTPUTS: "outputVars", VARIABLES: "localVars", CONSTANTS: "localVars"}
_ARRAY = re.compile(r"ARRAY\[(\d+)\.\.(\d+)\] OF (\w+)")
_ELEMENTARY = ("LREAL", "REAL", "BOOL", "INT", "DINT")
_WHEN = "2000-01-01T00:00:00"  # the format wants a date; the same export has the same bytes


def plcopen(name: str, parts: Iterable[Structure | Unit]) -> str:
    """The text of the project file."""
    parts = list(parts)
    project = ET.Element("project", {"xmlns": NAMESPACE})
    ET.SubElement(
        project, "fileHeader", companyName="", productName="feeddrive", productVersion=__version__,
        creationDateTime=_WHEN,
    )  # fmt: skip
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
            for each in part.declared():
                _variable(struct, each)
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
            for each in unit.sections[section]:
                _variable(variables, each)
    text = ET.SubElement(ET.SubElement(ET.SubElement(pou, "body"), "ST"), "xhtml", xmlns=_XHTML)
    text.text = "\n" + unit.implementation()
    if unit.said:
        _document(pou, unit.said)


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


def twincat_file(each: Structure | Unit) -> tuple[str, str]:
    """Name and content of the file of a structure, function or function block."""
    if isinstance(each, Structure):
        body = f"    <Declaration><![CDATA[{_cdata(each.text())}]]></Declaration>\n"
        return f"{each.name}.TcDUT", _wrapped("DUT", each.name, "", body)
    body = (
        f"    <Declaration><![CDATA[{_cdata(each.declaration())}]]></Declaration>\n"
        f"    <Implementation>\n      <ST><![CDATA[{_cdata(each.implementation())}]]></ST>\n    </Implementation>\n"
    )
    return f"{each.name}.TcPOU", _wrapped("POU", each.name, ' SpecialFunc="None"', body)


def _wrapped(tag: str, name: str, more: str, body: str) -> str:
    """The same name has the same identity, so that a repeated export replaces the file in a project."""
    identity = uuid.uuid5(uuid.NAMESPACE_URL, f"feeddrive/{tag}/{name}")
    return f'{_HEAD}  <{tag} Name="{name}" Id="{{{identity}}}"{more}>\n{body}  </{tag}>\n</TcPlcObject>\n'


def _cdata(text: str) -> str:
    """Text that cannot end the section it stands in."""
    return text.replace("]]>", "]] >")

"""The XML descriptions of an FMU: modelDescription.xml, and for FMI 3 sources/buildDescription.xml."""

from __future__ import annotations

import contextlib
import re
import sys
from collections.abc import Sequence
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from feeddrive.export.fmu.model import TRIP_NAMES, FmuVariable
from feeddrive.language.errors import ParameterError
from feeddrive.language.units import measure

_BASE = ("m", "kg", "s", "A", "rad")  # in the order of `units.Dimension`
_DISPLAYED = {"m": ("mm", 1e3), "m/s": ("mm/s", 1e3), "s": ("ms", 1e3), "N": ("kN", 1e-3)}
_TAGS = {"number": ("Real", "Float64"), "truth": ("Boolean", "Boolean"), "enumeration": ("Enumeration", "Enumeration")}
_CAUSALITY = {"time": "independent", "sample_time": "parameter", "parameter": "parameter", "start": "parameter"}
_NOT_XML = re.compile("[^\t\n\r -\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_CATEGORIES = {
    "logEvents": "trips of the guard, and their end",
    "logStatusDiscard": "steps that are no whole multiple of the sample time",
    "logStatusError": "calls and values that are refused",
}


def model_description(
    version: int,
    name: str,
    title: str,
    token: str,
    tool: str,
    sample_time: float,
    variables: Sequence[FmuVariable],
    sources: Sequence[str],
) -> bytes:
    """modelDescription.xml of FMI 2.0 or 3.0; `sources` are the files to compile."""
    three = version == 3
    root = Element("fmiModelDescription", fmiVersion="3.0" if three else "2.0", modelName=name)
    root.set("instantiationToken" if three else "guid", token)
    root.set("description", _text(title))
    root.set("generationTool", tool)
    root.set("variableNamingConvention", "flat")
    state = "FMUState" if three else "FMUstate"
    simulated = SubElement(root, "CoSimulation", modelIdentifier=name, canHandleVariableCommunicationStepSize="true")
    simulated.set(f"canGetAndSet{state}", "true")
    simulated.set(f"canSerialize{state}", "true")
    if three:
        simulated.set("fixedInternalStepSize", repr(sample_time))
        simulated.set("providesDirectionalDerivatives", "false")
    else:
        simulated.set("canNotUseMemoryManagementFunctions", "true")
        simulated.set("providesDirectionalDerivative", "false")
        files = SubElement(simulated, "SourceFiles")
        for each in sources:
            SubElement(files, "File", name=each)
    _units(root, variables)
    if any(each.kind == "enumeration" for each in variables):
        _trip(root, three)
    categories = SubElement(root, "LogCategories")
    for category, meaning in _CATEGORIES.items():
        SubElement(categories, "Category", name=category, description=meaning)
    SubElement(root, "DefaultExperiment", startTime="0", stopTime="1", stepSize=repr(sample_time))
    _variables(SubElement(root, "ModelVariables"), three, variables)
    _structure(SubElement(root, "ModelStructure"), three, variables)
    return _written(root)


def build_description(name: str, sources: Sequence[str]) -> bytes:
    """sources/buildDescription.xml of FMI 3.0."""
    root = Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = SubElement(root, "BuildConfiguration", modelIdentifier=name)
    files = SubElement(configuration, "SourceFileSet", language="C99")
    files.set("compilerOptions", "-ffp-contract=off")
    for each in sources:
        SubElement(files, "SourceFile", name=each)
    return _written(root)


def _text(text: str) -> str:
    """Text without the characters that no XML document may hold."""
    return _NOT_XML.sub(" ", text)


def _written(root: Element) -> bytes:
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _units(root: Element, variables: Sequence[FmuVariable]) -> None:
    """Every unit with the powers of its base units; those of angle too, so that Hz is not 1/s."""
    found = sorted({each.unit for each in variables if each.unit})
    definitions = SubElement(root, "UnitDefinitions")
    for name in found:
        unit = SubElement(definitions, "Unit", name=name)
        with contextlib.suppress(ParameterError):  # a drive's own unit, "A or V", has no base units
            factor, dimension = measure(name)
            powers = {base: str(power) for base, power in zip(_BASE, dimension, strict=True) if power}
            SubElement(unit, "BaseUnit", powers | ({} if factor == 1.0 else {"factor": repr(factor)}))
        if name in _DISPLAYED:
            shown, times = _DISPLAYED[name]
            SubElement(unit, "DisplayUnit", name=shown, factor=repr(times))


def _trip(root: Element, three: bool) -> None:
    """The codes of the guard as an enumeration."""
    types = SubElement(root, "TypeDefinitions")
    if three:
        kind = SubElement(types, "EnumerationType", name="Trip")
    else:
        kind = SubElement(SubElement(types, "SimpleType", name="Trip"), "Enumeration")
    for code, meaning in TRIP_NAMES.items():
        SubElement(kind, "Item", name=meaning.removeprefix("the ").removeprefix("a "), value=str(code))


def _variables(parent: Element, three: bool, variables: Sequence[FmuVariable]) -> None:
    for reference, each in enumerate(variables):
        tag = _TAGS[each.kind][three]
        outer = SubElement(parent, tag if three else "ScalarVariable", name=each.name, valueReference=str(reference))
        outer.set("causality", _CAUSALITY.get(each.group, each.group))
        outer.set("variability", _variability(each))
        if each.group != "time":
            if each.group == "output":
                outer.set("initial", "calculated")
            elif each.group != "input":
                outer.set("initial", "exact")
        outer.set("description", _text(each.meaning))
        inner = outer if three else SubElement(outer, tag)
        if each.kind == "enumeration":
            inner.set("declaredType", "Trip")
        if each.unit:
            inner.set("unit", each.unit)
        if each.least > float("-inf"):
            inner.set("min", _bound(each.least))
        if each.most < float("inf"):
            inner.set("max", _bound(each.most))
        if each.start is not None:
            inner.set("start", repr(each.start) if each.kind == "number" else "false")


def _bound(value: float) -> str:
    """The smallest normal number stands for "above zero", which no tool needs to see."""
    return repr(0.0 if abs(value) == sys.float_info.min else value)


def _variability(variable: FmuVariable) -> str:
    """Inputs and outputs are discrete: held from sample to sample, never interpolated."""
    if variable.group == "time":
        return "continuous"
    if variable.group in ("input", "output"):
        return "discrete"
    return "tunable" if variable.tunable else "fixed"


def _structure(parent: Element, three: bool, variables: Sequence[FmuVariable]) -> None:
    """Outputs are those of the last step, so that none depends on an input of the same instant."""
    outputs = [i for i, each in enumerate(variables) if each.group == "output"]
    if three:
        for i in outputs:
            SubElement(parent, "Output", valueReference=str(i), dependencies="")
        for i in outputs:
            SubElement(parent, "InitialUnknown", valueReference=str(i))
        return
    listed, unknown = SubElement(parent, "Outputs"), SubElement(parent, "InitialUnknowns")
    for i in outputs:
        SubElement(listed, "Unknown", index=str(i + 1), dependencies="")
        SubElement(unknown, "Unknown", index=str(i + 1))

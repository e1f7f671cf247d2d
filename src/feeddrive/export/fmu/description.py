"""The variables of an FMU: the C header that declares them, and the XML descriptions."""

from __future__ import annotations

import contextlib
import json
import math
import re
import sys
from collections.abc import Sequence
from typing import NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from feeddrive.export.c.arithmetic import CODE, SENTENCE
from feeddrive.export.c.statements import number
from feeddrive.export.identifiers import ascii_text
from feeddrive.language.declaration import Declaration
from feeddrive.language.errors import ParameterError
from feeddrive.language.units import measure
from feeddrive.loop.guard import TRIPS
from feeddrive.loop.loop import quantity
from feeddrive.loop.routine import Routine

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
    """A bound as text; the smallest normal number means "above zero" and is written as 0."""
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


TRIP_NAMES = {0: "none"} | {int(code): text for code, text in TRIPS.items()}
_TRUTHS = ("enable", "enabled")


class FmuVariable(NamedTuple):
    """One variable; its place in the tuple of all is its value reference.

    group        "time", "sample_time", "parameter", "start" (a fixed parameter where the model begins), "input" or
                 "output"
    kind         "number", "truth" or "enumeration"
    start        value before anything is set; of a computed variable None
    least, most  bounds that the model checks; infinite where there are none
    """

    name: str
    group: str
    kind: str
    unit: str
    meaning: str
    start: float | None
    tunable: bool = False
    least: float = -math.inf
    most: float = math.inf


def is_plant(routine: Routine) -> bool:
    """Whether the routine is the axis and not its control."""
    return routine.memory == "plant"


def variables(routine: Routine) -> tuple[FmuVariable, ...]:
    """All variables, in the order of their value references."""
    T = routine.sample_time
    found = [
        FmuVariable("time", "time", "number", "s", "simulated time", None),
        FmuVariable("sample_time", "sample_time", "number", "s", "from sample to sample; fixed", T, least=T, most=T),
    ]
    for each in routine.parameters:
        least, most = _bounds(each.declared)
        found.append(
            FmuVariable(
                each.name,
                "parameter",
                "number",
                each.unit,
                each.meaning,
                each.value,
                not is_plant(routine),
                least,
                most,
            )
        )
    found += [
        FmuVariable(
            i.name, "start" if quantity(i.path).startswith("start_") else "input", _kind(i.name), i.unit, i.meaning, 0.0
        )
        for i in routine.inputs
    ]
    for each in routine.outputs:
        found.append(FmuVariable(each.name, "output", _kind(each.name), each.unit, each.meaning, None))
    return tuple(found)


def _kind(name: str) -> str:
    return "truth" if name in _TRUTHS else "enumeration" if name == "trip" else "number"


def _bounds(declared: Declaration | None) -> tuple[float, float]:
    """Smallest and largest admissible value; a bound that is itself excluded gives the number next to it."""
    if declared is None:
        return -math.inf, math.inf
    least = -math.inf if declared.least is None else declared.least
    most = math.inf if declared.most is None else declared.most
    if declared.above is not None:
        least = _beside(declared.above, math.inf)
    if declared.below is not None:
        most = _beside(declared.below, -math.inf)
    return least, most


def _beside(bound: float, towards: float) -> float:
    """The next number; next to zero the smallest normal one, as tools may take subnormal numbers as zero."""
    return math.copysign(sys.float_info.min, towards) if bound == 0.0 else math.nextafter(bound, towards)


_GROUPS = {"time": "TIME", "sample_time": "CLOCK", "parameter": "PARAMETER", "start": "START", "input": "INPUT"}
_STRUCTS = {"parameter": "parameters", "start": "inputs", "input": "inputs", "output": "outputs"}
_HEAD = """\
/* The model of this FMU: its token and its variables in the order of their value references. */
#ifndef FMU_MODEL_H
#define FMU_MODEL_H

#include <math.h>
#include <stddef.h>
#include <string.h>

#include "{P}.h"

#define MODEL(word) {P}_##word
#define MODEL_CORE {P}_{held}
#define MODEL_TOKEN "{token}"
#define MODEL_SAMPLE_TIME {P_upper}_SAMPLE_TIME

enum group {{ TIME, CLOCK, PARAMETER, START, INPUT, OUTPUT }};
enum kind {{ NUMBER, TRUTH, ENUMERATION }};

struct variable {{
    const char *name;
    enum group group;
    enum kind kind;
    int tunable;
    size_t offset; /* in the struct of its group; START stands among the inputs */
    double least, most;
}};

static const struct variable VARIABLES[] = {{
"""
_CONTROLLER = """
/* The outputs before the first step: those of a sample in which the loop is off. */
static void model_first(MODEL_CORE *core, const MODEL(inputs) *inputs, MODEL(outputs) *outputs)
{
    MODEL_CORE copy = *core;
    MODEL(inputs) off = *inputs;
    off.enable = 0.0;
    MODEL(reset)(&copy, &off);
    MODEL(step)(&copy, &off, outputs);
}

/* At the first step: off, without a trip, where the axis is. */
static void model_start(MODEL_CORE *core, const MODEL(inputs) *inputs) { MODEL(reset)(core, inputs); }

static void model_tune(MODEL_CORE *core, const MODEL(parameters) *parameters) { MODEL(retune)(core, parameters); }

static int model_trip(const MODEL(outputs) *outputs) { return (int)outputs->trip; }
"""
_PLANT = """
/* The axis at rest at its start position, and what its encoders read there. */
static void model_first(MODEL_CORE *core, const MODEL(inputs) *inputs, MODEL(outputs) *outputs)
{
    MODEL(reset)(core, inputs, outputs);
}

/* At the first step: all was done when the initialization ended. */
static void model_start(MODEL_CORE *core, const MODEL(inputs) *inputs)
{
    (void)core;
    (void)inputs;
}

/* No parameter of a plant is tunable. */
static void model_tune(MODEL_CORE *core, const MODEL(parameters) *parameters)
{
    (void)core;
    (void)parameters;
}

/* A plant has no guard. */
static int model_trip(const MODEL(outputs) *outputs)
{
    (void)outputs;
    return 0;
}
"""


def model_header(routine: Routine, token: str, variables: Sequence[FmuVariable]) -> str:
    """The text of fmu_model.h."""
    P = routine.name
    head = _HEAD.format(P=P, P_upper=P.upper(), held=routine.memory, token=token)
    rows = ",\n".join(f"    {_row(each)}" for each in variables)
    names = ", ".join(json.dumps(text) for text in TRIP_NAMES.values())
    rules = ",\n        ".join(json.dumps(ascii_text(text)) for text in routine.sentences.values()) or '""'
    arithmetic = f"code == {CODE} ? {json.dumps(SENTENCE)} : "
    return (
        f"{head}{rows}\n}};\n\nenum {{ VARIABLE_COUNT = sizeof VARIABLES / sizeof VARIABLES[0] }};\n"
        f"{_PLANT if is_plant(routine) else _CONTROLLER}\n"
        f"static const char *model_trip_name(int trip)\n{{\n    static const char *const names[] = {{{names}}};\n"
        f'    return trip >= 0 && trip < {len(TRIP_NAMES)} ? names[trip] : "unknown";\n}}\n\n'
        f"static const char *model_rule(int code)\n{{\n    static const char *const rules[] = {{{rules}}};\n"
        f"    return {arithmetic}"
        f'code > 0 && code <= {len(routine.conditions)} ? rules[code - 1] : "unknown";\n}}\n\n#endif\n'
    )


def _row(variable: FmuVariable) -> str:
    struct = _STRUCTS.get(variable.group)
    offset = "0" if struct is None else f"offsetof(MODEL({struct}), {variable.name})"
    kind = {"number": "NUMBER", "truth": "TRUTH", "enumeration": "ENUMERATION"}[variable.kind]
    group = _GROUPS.get(variable.group, "OUTPUT")
    bounds = f"{number(variable.least)}, {number(variable.most)}"
    return f'{{"{variable.name}", {group}, {kind}, {int(variable.tunable)}, {offset}, {bounds}}}'

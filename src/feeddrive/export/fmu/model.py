"""The variables of an FMU, and the C header that declares them."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Sequence
from typing import NamedTuple

from feeddrive.export.c.expressions import number
from feeddrive.export.identifiers import ascii_text
from feeddrive.language.block import Declaration
from feeddrive.loop.guard import TRIPS
from feeddrive.loop.loop import quantity
from feeddrive.loop.routine import Routine

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
    """The next number; beside zero the smallest normal one, since a tool may count those below it as zero."""
    return math.copysign(sys.float_info.min, towards) if bound == 0.0 else math.nextafter(bound, towards)


_GROUPS = {"time": "TIME", "sample_time": "CLOCK", "parameter": "PARAMETER", "start": "START", "input": "INPUT"}
_STRUCTS = {"parameter": "parameters", "start": "inputs", "input": "inputs", "output": "outputs"}
_HEAD = """\
/* What this FMU is made of: the model, its token and its variables in the order of their value references. */
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
/* What the outputs are before the first step: those of a sample in which the loop is off. */
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
    return (
        f"{head}{rows}\n}};\n\nenum {{ VARIABLE_COUNT = sizeof VARIABLES / sizeof VARIABLES[0] }};\n"
        f"{_PLANT if is_plant(routine) else _CONTROLLER}\n"
        f"static const char *model_trip_name(int trip)\n{{\n    static const char *const names[] = {{{names}}};\n"
        f'    return trip >= 0 && trip < {len(TRIP_NAMES)} ? names[trip] : "unknown";\n}}\n\n'
        f"static const char *model_rule(int code)\n{{\n    static const char *const rules[] = {{{rules}}};\n"
        f'    return code > 0 && code <= {len(routine.conditions)} ? rules[code - 1] : "unknown";\n}}\n\n#endif\n'
    )


def _row(variable: FmuVariable) -> str:
    struct = _STRUCTS.get(variable.group)
    offset = "0" if struct is None else f"offsetof(MODEL({struct}), {variable.name})"
    kind = {"number": "NUMBER", "truth": "TRUTH", "enumeration": "ENUMERATION"}[variable.kind]
    group = _GROUPS.get(variable.group, "OUTPUT")
    bounds = f"{number(variable.least)}, {number(variable.most)}"
    return f'{{"{variable.name}", {group}, {kind}, {int(variable.tunable)}, {offset}, {bounds}}}'

"""The variables of an FMU: those of a routine, with the kinds, causalities and bounds that FMI wants to know.

Names are those of the exported C, so that a value has one name in all targets.  Every number is in SI.
"""

from __future__ import annotations

import math
import sys
from typing import NamedTuple

from feeddrive.language.block import Declaration
from feeddrive.loop.guard import TRIPS
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
        FmuVariable(i.name, "start" if i.name.startswith("start_") else "input", _kind(i.name), i.unit, i.meaning, 0.0)
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

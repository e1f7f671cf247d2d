"""The G and M codes: which group each belongs to, and in which order the codes of a block act."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple


class Step(IntEnum):
    """What a block does, in the order in which it does it; the modal groups are named so too."""

    FEED_MODE = 1
    FEED = 2
    SPINDLE_SPEED = 3
    TOOL = 4
    OUTPUT = 5
    TOOL_CHANGE = 6
    SPINDLE = 7
    COOLANT = 8
    OVERRIDE = 9
    DWELL = 10
    PLANE = 11
    UNITS = 12
    CUTTER = 13
    TOOL_LENGTH = 14
    SYSTEM = 15
    PATH_MODE = 16
    DISTANCE = 17
    ARC_DISTANCE = 18
    RETRACT = 19
    OFFSET = 20
    MOTION = 21
    STOP = 22


class Code(NamedTuple):
    """A code: its step, what excludes what in one block, and what it does."""

    step: Step
    group: str
    meaning: str
    native: bool = True


def _codes(step: Step, meanings: dict[float, str], group: str = "", native: bool = True) -> dict[int, Code]:
    return {round(10 * code): Code(step, group or step.name, text, native) for code, text in meanings.items()}


G_CODES: dict[int, Code] = {
    **_codes(Step.FEED_MODE, {93: "inverse time feed", 94: "feed per minute", 95: "feed per revolution"}),
    **_codes(Step.DWELL, {4: "dwell of P seconds"}, "non-modal"),
    **_codes(Step.PLANE, {17: "plane XY", 18: "plane ZX", 19: "plane YZ"}),
    **_codes(Step.UNITS, {20: "inch", 21: "mm"}),
    **_codes(Step.CUTTER, {40: "cutter compensation off"}),
    **_codes(
        Step.CUTTER,
        {41: "cutter compensation left", 41.1: "the same, D", 42: "right", 42.1: "the same, D"},
        native=False,
    ),
    **_codes(
        Step.TOOL_LENGTH, {43: "tool offset of the table", 43.1: "tool offset of the words", 43.2: "added", 49: "off"}
    ),
    **_codes(Step.SYSTEM, dict.fromkeys((54, 55, 56, 57, 58, 59, 59.1, 59.2, 59.3), "work offsets 1 to 9")),
    **_codes(Step.PATH_MODE, {61: "exact path", 61.1: "exact stop", 64: "continuous within P, Q"}),
    **_codes(Step.DISTANCE, {90: "absolute", 91: "incremental"}),
    **_codes(Step.ARC_DISTANCE, {90.1: "absolute I J K", 91.1: "incremental I J K"}),
    **_codes(Step.RETRACT, {98: "retract to the start", 99: "retract to R"}),
    **_codes(
        Step.OFFSET,
        {
            10: "write offsets: L1 L10 L2 L20",
            28: "go home 1",
            28.1: "set home 1",
            30: "go home 2",
            30.1: "set home 2",
            52: "local offset",
            92: "set position",
            92.1: "clear G92",
            92.2: "suspend G92",
            92.3: "restore G92",
        },
        "non-modal",
    ),
    **_codes(Step.OFFSET, {53: "in machine coordinates"}, "non-modal"),
    **_codes(Step.MOTION, {0: "traverse", 1: "straight feed", 2: "arc clockwise", 3: "arc counterclockwise"}),
    **_codes(Step.MOTION, {5: "cubic spline", 5.1: "quadratic spline", 33: "spindle-synchronized feed"}),
    **_codes(
        Step.MOTION, {73: "drill, break chips", 80: "no motion", 81: "drill", 82: "drill, dwell", 83: "drill, peck"}
    ),
    **_codes(Step.MOTION, {74: "tap left-hand, dwell", 84: "tap right-hand, dwell", 85: "bore, feed out"}),
    **_codes(Step.MOTION, {86: "bore, stop, traverse out", 89: "bore, dwell, feed out"}),
    **_codes(
        Step.MOTION, {33.1: "rigid tapping", 38.2: "probe", 38.3: "probe", 38.4: "probe", 38.5: "probe"}, native=False
    ),
    **_codes(
        Step.MOTION,
        {5.2: "NURBS", 5.3: "NURBS end", 76: "thread", 87: "back bore", 88: "bore, manual out"},
        native=False,
    ),
    **_codes(Step.DISTANCE, {7: "lathe diameter", 8: "lathe radius"}, "lathe", native=False),
    **_codes(Step.SPINDLE_SPEED, {96: "constant surface speed"}, "spindle mode", native=False),
    **_codes(Step.SPINDLE_SPEED, {97: "spindle speed in rpm"}, "spindle mode"),
}
"""By ten times the number: 59.3 is 593."""

M_CODES: dict[int, Code] = {
    **_codes(Step.OUTPUT, {62: "output on", 63: "output off", 64: "output on", 65: "output off"}),
    **_codes(Step.OUTPUT, {67: "analog output", 68: "analog output"}),
    **_codes(Step.OUTPUT, {66: "wait for an input"}, native=False),
    **_codes(Step.TOOL_CHANGE, {6: "change tool", 61: "set tool number"}),
    **_codes(Step.SPINDLE, {3: "spindle clockwise", 4: "spindle counterclockwise", 5: "spindle stop"}),
    **_codes(Step.SPINDLE, {19: "orient the spindle"}, native=False),
    **_codes(Step.COOLANT, {7: "mist on", 8: "flood on", 9: "coolant off"}),
    **_codes(Step.OVERRIDE, {48: "overrides on", 49: "overrides off", 50: "feed override", 51: "speed override"}),
    **_codes(Step.OVERRIDE, {52: "adaptive feed", 53: "feed hold"}),
    **_codes(
        Step.OVERRIDE,
        {70: "save modes", 71: "drop saved modes", 72: "restore modes", 73: "save for the call"},
        native=False,
    ),
    **_codes(Step.STOP, {0: "stop", 1: "optional stop", 2: "end", 30: "end, pallet change", 60: "pallet change, stop"}),
}

REFUSED: dict[str, str] = {
    "G5.2": "the interpreter of LinuxCNC prints no points of a NURBS: use G5 or G5.1",
    "G5.3": "the interpreter of LinuxCNC prints no points of a NURBS: use G5 or G5.1",
    "G33.1": "rigid tapping follows the real spindle: take it out of what is planned",
    **dict.fromkeys(("M98", "M99"), "subprograms are o-words here: o100 sub .. o100 endsub, and o100 call"),
    "M66": "what an input reads is not known before: take it out of what is planned",
    **dict.fromkeys(
        ("G38.2", "G38.3", "G38.4", "G38.5"),
        "where a probe touches is not known before: take it out of what is planned",
    ),
}
"""Codes that no front end reads, with the reason."""


def name_of(letter: str, code: int) -> str:
    """A code as it is written: G59.3."""
    return f"{letter.upper()}{code // 10}" + (f".{code % 10}" if code % 10 else "")

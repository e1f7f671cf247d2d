"""A block of a part program: the words of a line with their values, its codes in the order in which they act."""

from __future__ import annotations

import math
import re
from enum import IntEnum
from typing import NamedTuple

from feeddrive.language.errors import nearest
from feeddrive.language.quantity import Quantity
from feeddrive.path.program.expressions import Parameters, Values
from feeddrive.path.program.lines import BlockError, Line, compact


class Step(IntEnum):
    """The actions of a block in the order in which they act; the modal groups have the same names."""

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
    """A code: its step, its group (codes that exclude each other in a block), and its meaning."""

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
    """Return a code as it is written: G59.3."""
    return f"{letter.upper()}{code // 10}" + (f".{code % 10}" if code % 10 else "")


AXES = "xyzabcuvw"
LARGEST = 1e9
"""No word is larger: mm, degrees, or what else it holds."""
RS274 = "the own reader has no {}: LinuxCNC's interpreter rs274 reads it, which comes with the package linuxcnc-uspace"

_PLAIN = re.compile(r"(?:[a-mp-z@^][+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+))+")
_WORDS = re.compile(r"([a-mp-z@^])([+-]?[0-9.]+)")
_NUMBERED = re.compile(r"n([0-9]+(?:\.[0-9]+)?)")
_LETTERS = frozenset("abcdefghijklmpqrstuvwxyz@^")


class Block:
    """The content of one line.

    words     letter -> value, without G and M; who uses a word takes it out, and what is left is refused
    codes     letter and ten times the number of each code, sorted by step
    assigned  parameters that the block sets, after all of its values were read
    comments  texts in parentheses
    control   the line without white space and comments, if it is an o-word's, else empty
    """

    __slots__ = ("assigned", "codes", "comments", "control", "line", "words")

    def __init__(self, line: Line) -> None:
        self.line = line
        self.words: dict[str, float] = {}
        self.codes: list[tuple[Step, str, int]] = []
        self.assigned: list[tuple[int | str, float]] = []
        self.comments: list[str] = []
        self.control = ""

    def take(self, letter: str, code: str = "") -> float | None:
        """Remove a word and return it; a missing one is None, or is refused if a code is named that needs it."""
        value = self.words.pop(letter, None)
        if value is None and code:
            raise BlockError(f"{code} needs the word {letter.upper()}, which this block does not have: write it", code)
        return value

    def whole(self, letter: str, code: str, least: int, most: int, default: int | None = None) -> int:
        """Remove a word that holds an integer within bounds, and return the integer."""
        value = self.take(letter, "" if default is not None else code)
        if value is None:
            assert default is not None
            return default
        if abs(value - round(value)) > 1e-4 or not least <= round(value) <= most:
            raise BlockError(
                f"{letter.upper()} of {code} is a whole number from {least} to {most}, not {Quantity(value):6}",
                letter.upper(),
            )
        return round(value)


def read_block(line: Line, parameters: Parameters, skip_deleted: bool) -> Block:
    """Read a line; with `skip_deleted` a line that begins with / is an empty block."""
    block = Block(line)
    text, block.comments = compact(line.text)
    if not text:
        return block
    start = 0
    if text[0] == "/":
        if skip_deleted:
            block.comments = []
            return block
        start = 1
    if text.startswith("n", start):
        numbered = _NUMBERED.match(text, start)
        if not numbered:
            raise BlockError("a line number is N and digits, such as N100", text[start : start + 12], start)
        start = numbered.end()
    if text.startswith("o", start):
        block.control = text[start:]
    elif _PLAIN.fullmatch(text, start):
        words = block.words
        for letter, number in _WORDS.findall(text, start):
            if letter in "gm":
                block.codes.append(_WRITTEN.get(letter + number) or _code(letter, float(number), text, None))
            elif letter in words:
                raise _twice(letter, text.rindex(letter))
            else:
                words[letter] = float(number)
        if words and not -LARGEST <= min(words.values()) <= max(words.values()) <= LARGEST:
            large = next(letter for letter, value in words.items() if abs(value) > LARGEST)
            raise _too_large(large, words[large], text.find(large, start))
    elif start < len(text):
        _read_words(block, Values(text, parameters, start))
    if len(block.codes) > 1:
        block.codes.sort()
        _refuse_two_of_a_group(block)
    return block


def _read_words(block: Block, values: Values) -> None:
    """Read words whose values are not all plain numbers, and settings of parameters."""
    text = values.text
    while values.at < len(text):
        start = values.at
        letter = text[start]
        values.at += 1
        if letter == "#":
            key = values.key()
            if not text.startswith("=", values.at):
                raise values.fault("a parameter at this place is set: #1=2 or #<name>=2", start)
            values.at += 1
            block.assigned.append((key, values.value()))
        elif letter in _LETTERS:
            try:
                _add(block, letter, values.value(), start)
            except BlockError as fault:
                if fault.index in (None, start + 1):  # of the whole word
                    raise values.fault(fault.reason, start) from None
                raise
        elif letter in "no":
            raise values.fault(f"{letter.upper()} stands at the start of a line only", start)
        else:
            raise values.fault("a word begins with a letter: this character has no meaning here", start)


def _add(block: Block, letter: str, value: float, start: int) -> None:
    """Add a word to a block."""
    if letter in "gm":
        block.codes.append(_code(letter, value, "", start))
    elif letter in block.words:
        raise _twice(letter, start)
    elif abs(value) > LARGEST:
        raise _too_large(letter, value, start)
    else:
        block.words[letter] = value


def _twice(letter: str, at: int) -> BlockError:
    return BlockError(f"the word {letter.upper()} stands twice in this block: split the line", letter.upper(), at)


def _too_large(letter: str, value: float, at: int) -> BlockError:
    return BlockError(f"a word is at most {Quantity(LARGEST)}", f"{letter.upper()}{value:g}", at)


def _code(letter: str, value: float, text: str, start: int | None) -> tuple[Step, str, int]:
    table = G_CODES if letter == "g" else M_CODES
    tenths = 10.0 * value
    number = round(tenths) if abs(tenths) < 1e6 else -1
    code = table.get(number) if abs(tenths - number) < 1e-3 else None
    if code and code.native:
        return code.step, letter, number
    at = _place(text, letter, value) if start is None else start
    if code is None:
        written = f"{letter.upper()}{value:g}"
        if written in REFUSED:
            raise BlockError(REFUSED[written], written, at)
        known = nearest(written, [name_of(letter, listed) for listed in table])
        raise BlockError(f"there is no such code here{known}", written, at)
    name = name_of(letter, number)
    raise BlockError(REFUSED.get(name) or RS274.format(f"{name} ({code.meaning})"), name, at)


_WRITTEN = {
    f"{letter}{text}": (code.step, letter, number)
    for letter, table in (("g", G_CODES), ("m", M_CODES))
    for number, code in table.items()
    if code.native
    for text in {f"{number / 10:g}", f"{number / 10:04.1f}" if number % 10 else f"{number // 10:02}"}
}
"""Codes by how they are mostly written, g1 or g01: the rest is looked up by number."""


def _place(text: str, letter: str, value: float) -> int:
    """Return the position of a word in a line of plain words; of equal ones the last."""
    return max(word.start() for word in _WORDS.finditer(text) if word[1] == letter and float(word[2]) == value)


def code_of(letter: str, number: int) -> Code:
    """Return the code-table entry of this word."""
    return (G_CODES if letter == "g" else M_CODES)[number]


def _refuse_two_of_a_group(block: Block) -> None:
    seen: dict[str, str] = {}
    for _, letter, number in block.codes:
        group, name = code_of(letter, number).group, name_of(letter, number)
        if group in seen:
            raise BlockError(
                f"{seen[group]} and {name} exclude each other ({group.lower().replace('_', ' ')}): use two lines", name
            )
        seen[group] = name


def read_debug(text: str, parameters: Parameters) -> str:
    """Return the text of a (DEBUG, ...) or (PRINT, ...) comment with the values of its parameters; %d, %f, %.2f format
    them.
    """
    form = "%f"

    def shown(match: re.Match[str]) -> str:
        nonlocal form
        if match[0].startswith("%"):
            form = match[0]
            return ""
        key: int | str = int(match[1]) if match[1] else "".join(match[2].split()).lower()
        if not parameters.known(key):
            return "######"
        value = parameters.value(key)
        return str(math.floor(value + 0.5)) if form == "%d" else form % value

    return re.sub(r"#(?:(\d{1,4})|<([^<>]+)>)|%(?:d|f|\.\df)", shown, text)

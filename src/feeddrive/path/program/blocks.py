"""A block of a part program: its line, words and expressions, and its codes in order of execution.

Parameters are numbered (`#31`), named (`#<depth>`), or reflect the interpreter's state; numbered ones are stored in a
`.var` file.  Operator precedence, as in LinuxCNC: `**`; `* / mod`; `+ -`; `eq ne gt ge lt le`; `and or xor`; each
evaluated from left to right.
"""

import math
import re
from codecs import BOM_UTF8, BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Callable
from enum import IntEnum
from io import BufferedReader
from math import isfinite
from pathlib import Path
from typing import NamedTuple

from feeddrive.language.errors import FileError, ProgramError, nearest, plain, shown
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.text import Text

LONGEST_LINE = 65536
"""The largest length of a line, line ending included, in bytes; reading of a longer line stops there."""


class Line(NamedTuple):
    """A line of a program: its file, its number (from 1), and its text without the line ending."""

    file: str
    number: int
    text: str


class Place(NamedTuple):
    """The position of a line in its file: the number of bytes and lines before it."""

    offset: int
    number: int


class BlockError(Exception):
    """An error in a block, before its position in the file is known.

    word   the word shown in the message; the line is searched for its letter if `index` is missing
    index  its index in the line as compacted by `compact`
    column its column in the original line, from 1, if known
    """

    def __init__(self, reason: str, word: str = "", index: int | None = None, column: int | None = None) -> None:
        self.reason, self.word, self.index, self.column = Text(reason), word, index, column
        super().__init__(self.reason)


def open_program(path: Path, name: str) -> BufferedReader:
    """Open a part program. Raise FileError, with the name that the user knows, if it is no file that can be read."""
    try:
        if path.is_dir():
            raise FileError(f"{name}: this is a folder, a part program is a file")
        # a device such as /dev/zero would be read forever
        if path.exists() and not path.is_file():
            raise FileError(f"{name}: is a device or pipe, not a file; copy it to a file first")
        # binary, since loops and calls return to a position in bytes
        return path.open("rb")
    except OSError as error:
        raise FileError(f"{name}: cannot be read: {error.strerror or error}") from None


class LineReader:
    """A reader of the lines of a file that can return to an earlier position."""

    def __init__(self, path: Path) -> None:
        """Check that the file can be opened; raise FileError if it cannot."""
        self.name = str(path)
        self._path = path
        self._file: BufferedReader | None = None
        # not kept open: a program whose lines are never read would leave an open file behind
        self._open().close()
        self._offset = self._number = self._last = 0
        self.furthest = 0

    def _open(self) -> BufferedReader:
        return open_program(self._path, self.name)

    @property
    def place(self) -> Place:
        """The position of the next line."""
        return Place(self._offset, self._number)

    @property
    def last(self) -> Place:
        """The position of the last line read."""
        return Place(self._last, self._number - 1)

    def go(self, place: Place) -> None:
        """Continue reading at a position."""
        self._offset, self._number = place
        if self._file is None:
            self._file = self._open()
        self._file.seek(self._offset)

    def read(self) -> Line | None:
        """Return the next line, or None at the end of the file."""
        if self._file is None:
            self._file = self._open()
        # bounded: a binary file may be a single line of gigabytes
        raw = self._file.readline(LONGEST_LINE + 1)
        if not raw:
            return None
        self._number += 1
        self._last = self._offset
        if self._offset == 0:
            raw = self._marked(raw)
        if len(raw) > LONGEST_LINE:
            raise ProgramError(
                self.name,
                self._number,
                LONGEST_LINE + 1,
                "",
                f"the line is longer than {LONGEST_LINE} bytes: a part program has short lines, is this one?",
            )
        self._offset += len(raw)
        # bytes of another encoding are mostly in comments, and elsewhere they are refused with their column
        return Line(self.name, self._number, raw.decode("utf-8", "replace").rstrip("\r\n"))

    def _marked(self, raw: bytes) -> bytes:
        """Return the first line without the byte order mark of UTF-8; refuse UTF-16."""
        if raw.startswith((BOM_UTF16_LE, BOM_UTF16_BE)):
            reason = "the file has two bytes for each character (UTF-16): save it as plain text (UTF-8)"
            raise ProgramError(self.name, 1, 1, "", reason)
        if raw.startswith(BOM_UTF8):
            # counted as read, so that the position of the second line is right
            self._offset += len(BOM_UTF8)
            return raw[len(BOM_UTF8) :]
        return raw

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
            self._file = None


def located(line: Line, fault: BlockError) -> ProgramError:
    """Convert the error of a faulty line to a ProgramError with file, line and column."""
    column = fault.column or 1
    if fault.column is None and fault.index is not None:
        kept = _kept(line.text)
        column = (kept[fault.index] if fault.index < len(kept) else len(line.text.rstrip())) + 1
    elif fault.column is None and fault.word:
        kept = _kept(line.text)
        column = 1 + next((i for i in kept if line.text[i].lower() == fault.word[0].lower()), kept[0] if kept else 0)
    return ProgramError(line.file, line.number, column, plain(fault.word), fault.reason)


def _kept(text: str) -> list[int]:
    """Return the indices of the characters of a line that are neither white space nor comment."""
    kept: list[int] = []
    inside = False
    for index, letter in enumerate(text):
        if inside:
            inside = letter != ")"
        elif letter == ";":
            break
        elif letter == "(":
            inside = True
        elif not letter.isspace():
            kept.append(index)
    return kept


def compact(text: str) -> tuple[str, list[str]]:
    """Return a line in lower case without white space and comments, and its comments in parentheses.

    White space has no meaning in RS-274, not even inside a number: `g0x +0. 12 34y 7` is `g0x+0.1234y7`.
    """
    if "(" not in text:
        return "".join(text.partition(";")[0].split()).lower(), []
    kept: list[str] = []
    comments: list[str] = []
    rest = text
    while rest:
        opened, ended = rest.find("("), rest.find(";")
        if opened < 0 or 0 <= ended < opened:
            kept.append(rest if ended < 0 else rest[:ended])
            break
        kept.append(rest[:opened])
        closed = rest.find(")", opened)
        inner = rest[opened + 1 :] if closed < 0 else rest[opened + 1 : closed]
        if closed < 0 or "(" in inner:
            shown = "(" + (inner if len(inner) <= 20 else inner[:17] + "...")
            what = "a comment opens inside a comment" if closed >= 0 else "the comment has no closing parenthesis"
            raise BlockError(f"{what}: write ) before it", shown, column=len(text) - len(rest) + opened + 1)
        comments.append(inner)
        rest = rest[closed + 1 :]
    return "".join("".join(kept).split()).lower(), comments


# the numbers of parameters are fixed by LinuxCNC, whose programs and .var files are read
MOST = 5602
"""The number of the last numbered parameter; the first is #1."""
ARGUMENTS = range(1, 31)
"""The parameters that are local to a subroutine: the arguments of its call."""
READ_ONLY = range(5400, 5429)
"""The parameters of tool, tool offset and position, which a program can only read."""


class Parameters:
    """The parameters of a program: by number, by name (local to the current subroutine), and by `_name` (global).

    numbered  the nonzero numbered parameters
    live      read-only parameters that reflect the program's state: number or name -> function
    """

    def __init__(self, numbered: dict[int, float] | None = None) -> None:
        self.numbered: dict[int, float] = dict(numbered or {})
        self.live: dict[int | str, Callable[[], float]] = {}
        self.common: dict[str, float] = {}
        self.local: dict[str, float] = {}

    def value(self, key: int | str) -> float:
        """Return the value of a parameter; raise BlockError for a named one that was never set."""
        live = self.live.get(key)
        if live is not None:
            return live()
        if isinstance(key, int):
            return self.numbered.get(key, 0.0)
        names = self.common if key.startswith("_") else self.local
        if key not in names:
            raise BlockError(f"the parameter #<{key}> has no value here: write #<{key}> = ... before", "#")
        return names[key]

    def known(self, key: int | str) -> bool:
        """Return True if a parameter has a value, as tested by EXISTS."""
        # numbered parameters always have a value: 0 unless they were set
        return key in self.live or isinstance(key, int) or key in (self.common if key.startswith("_") else self.local)

    def set(self, key: int | str, value: float) -> None:
        """Set a parameter; raise BlockError if it is read-only or the value is not finite."""
        if not isfinite(value):
            raise BlockError(f"a parameter must be a finite number, not {value}", "#")
        if key in self.live or key in READ_ONLY:
            raise BlockError(f"the parameter #{key if isinstance(key, int) else f'<{key}>'} is read-only", "#")
        if isinstance(key, int):
            self.numbered[key] = value
        else:
            (self.common if key.startswith("_") else self.local)[key] = value


def number_of(value: float) -> int:
    """Check that a value is the number of a parameter, and return it as an integer."""
    # computed numbers are whole up to rounding only
    whole = round(value)
    if abs(value - whole) > 1e-4 or not 1 <= whole <= MOST:
        raise BlockError(f"a parameter has a whole number from 1 to {MOST}, not {Quantity(value):6}", "#")
    return whole


def read_offsets(path: Path | str) -> dict[int, float]:
    """Read the numbered parameters of a `.var` file of LinuxCNC: two columns, number and value.

    They hold the work offsets (5221 ff), G28 (5161 ff), G30 (5181 ff) and G92 (5210 ff), in mm and degrees, or in
    inches if that is the machine's unit.
    """
    file = Path(path)
    try:
        text = file.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise FileError(f"{file}: cannot be read: {error.strerror or error}") from None
    values: dict[int, float] = {}
    for row, line in enumerate(text.splitlines(), 1):
        columns = line.split("#")[0].split()
        if not columns:
            continue
        try:
            key, value = int(columns[0]), float(columns[1])
        except (IndexError, ValueError):
            raise FileError(
                f"{file}, line {row}: {shown(line.strip())}: a line holds the number of a parameter and its value"
            ) from None
        if not 1 <= key <= MOST or not isfinite(value):
            raise FileError(
                f"{file}, line {row}: parameter {columns[0]} = {columns[1]}: the number lies in 1..{MOST}, "
                "the value is finite"
            )
        if key in values:
            raise FileError(f"{file}, line {row}: parameter {key} stands there twice: delete one of the lines")
        values[key] = value
    return values


# the parser is recursive: an error with line and column must come before the recursion limit of Python
DEEPEST = 60
"""The deepest nesting of brackets, signs and parameters in a value."""
# as in LinuxCNC, since programs compare numbers that they have computed
EQUAL = 1e-5
"""The difference below which `eq` treats two numbers as equal."""

# without an exponent, which RS-274 does not have: in 1e5 a word E begins
NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)")
_NAME = re.compile(r"<([^<>]+)>")
# ** before *, since the first alternative that fits is taken
_OPERATOR = re.compile(r"\*\*|\*|/|mod|\+|-|eq|ne|gt|ge|lt|le|and|or|xor|\]")
_FUNCTION = re.compile(r"abs|acos|asin|atan|cos|exists|exp|fix|fup|ln|round|sin|sqrt|tan")

_RANKS = (("and", "or", "xor"), ("eq", "ne", "gt", "ge", "lt", "le"), ("+", "-"), ("*", "/", "mod"), ("**",))
_RANK = {operator: rank for rank, operators in enumerate(_RANKS, 1) for operator in operators}


def _power(a: float, b: float) -> float:
    if a < 0 and b != math.floor(b):
        raise BlockError(f"{number(a, 6)} ** {number(b, 6)}: a negative number has whole powers only")
    if a == 0 and b < 0:
        raise BlockError("division by zero: 0 has no negative power")
    return math.pow(a, b)


def _divide(a: float, b: float) -> float:
    if b == 0:
        raise BlockError("division by zero: check the divisor before")
    return a / b


def _modulo(a: float, b: float) -> float:
    if b == 0:
        raise BlockError("mod by zero: check the divisor before")
    # never negative, as in LinuxCNC
    rest = math.fmod(a, b)
    return rest + abs(b) if rest < 0 else rest


_BINARY: dict[str, Callable[[float, float], float]] = {
    "**": _power,
    "*": lambda a, b: a * b,
    "/": _divide,
    "mod": _modulo,
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "eq": lambda a, b: float(abs(a - b) < EQUAL),
    "ne": lambda a, b: float(abs(a - b) >= EQUAL),
    "gt": lambda a, b: float(a > b),
    "ge": lambda a, b: float(a >= b),
    "lt": lambda a, b: float(a < b),
    "le": lambda a, b: float(a <= b),
    "and": lambda a, b: float(a != 0 and b != 0),
    "or": lambda a, b: float(a != 0 or b != 0),
    "xor": lambda a, b: float((a == 0) != (b == 0)),
}


def _inside(name: str, value: float, least: float, most: float) -> float:
    if not least <= value <= most:
        raise BlockError(f"{name}[{number(value, 6)}]: its argument lies in {number(least, 6)}..{number(most, 6)}")
    return value


_UNARY: dict[str, Callable[[float], float]] = {
    "abs": abs,
    "acos": lambda x: math.degrees(math.acos(_inside("acos", x, -1, 1))),
    "asin": lambda x: math.degrees(math.asin(_inside("asin", x, -1, 1))),
    "cos": lambda x: math.cos(math.radians(x)),
    "exp": math.exp,
    "fix": lambda x: float(math.floor(x)),
    "fup": lambda x: float(math.ceil(x)),
    # 5e-324 is the least positive number: ln of 0 is refused
    "ln": lambda x: math.log(_inside("ln", x, 5e-324, math.inf)),
    # halves away from zero; Python's round would go to the even neighbor
    "round": lambda x: float(math.floor(abs(x) + 0.5)) * math.copysign(1.0, x),
    "sin": lambda x: math.sin(math.radians(x)),
    "sqrt": lambda x: math.sqrt(_inside("sqrt", x, 0, math.inf)),
    "tan": lambda x: math.tan(math.radians(x)),
}


class Values:
    """A parser of values in a compacted line, starting at index `at`."""

    def __init__(self, text: str, parameters: Parameters, at: int = 0) -> None:
        self.text, self.parameters, self.at = text, parameters, at
        self._depth = 0

    def fault(self, reason: str, start: int | None = None) -> BlockError:
        """Return an error for the text from `start` (or the current position) on."""
        begin = self.at if start is None else start
        rest = self.text[begin:]
        return BlockError(reason, rest if len(rest) <= 20 else rest[:17] + "...", begin)

    def value(self) -> float:
        """Read a number, a parameter, an expression in brackets or a function, with or without a sign."""
        start = self.at
        match = NUMBER.match(self.text, start)
        if match:
            self.at = match.end()
            if self.text.startswith(".", self.at):
                raise self.fault("a number has one decimal point", start)
            return self._finite(float(match[0]), start)
        self._deeper()
        try:
            return self._finite(self._signed(), start)
        except BlockError as fault:
            if fault.index is None:
                raise self.fault(fault.reason, start) from None
            raise
        except ArithmeticError:
            raise self.fault("the result is too large for a number", start) from None
        finally:
            self._depth -= 1

    def key(self) -> int | str:
        """Read the name or the number of a parameter after a #."""
        named = _NAME.match(self.text, self.at)
        if named:
            self.at = named.end()
            return named[1]
        return number_of(self.value())

    def _signed(self) -> float:
        text = self.text
        first = text[self.at : self.at + 1]
        if first and first in "+-":
            self.at += 1
            return -self.value() if first == "-" else self.value()
        if first == "[":
            self.at += 1
            return self._expression()
        if first == "#":
            self.at += 1
            return self.parameters.value(self.key())
        name = _FUNCTION.match(text, self.at)
        if not name:
            raise self.fault("a number, a parameter (#1, #<name>), an expression [...] or a function is expected here")
        self.at = name.end()
        if not text.startswith("[", self.at):
            raise self.fault(f"{name[0]} takes its argument in brackets: {name[0]}[...]")
        if name[0] == "exists":
            return self._exists()
        self.at += 1
        if name[0] == "atan":
            return self._arc_tangent()
        return float(_UNARY[name[0]](self._expression()))

    def _exists(self) -> float:
        if not self.text.startswith("[#", self.at):
            raise self.fault("exists takes the name of a parameter: exists[#<name>]")
        self.at += 2
        key = self.key()
        if not self.text.startswith("]", self.at):
            raise self.fault("exists takes one parameter: a ] is expected here")
        self.at += 1
        return float(self.parameters.known(key))

    def _arc_tangent(self) -> float:
        y = self._expression()
        if not self.text.startswith("/[", self.at):
            raise self.fault("atan takes two arguments: atan[y]/[x]")
        self.at += 2
        return math.degrees(math.atan2(y, self._expression()))

    def _expression(self) -> float:
        """Read an expression after an opening bracket, up to the closing one."""
        values = [self.value()]
        operators: list[str] = []
        while True:
            match = _OPERATOR.match(self.text, self.at)
            if not match:
                raise self.fault("an operator or a closing bracket ] is expected here")
            self.at = match.end()
            rank = _RANK.get(match[0], 0)
            # >=, so that operators of one rank, ** included, are evaluated from left to right
            while operators and _RANK[operators[-1]] >= rank:
                right = values.pop()
                values[-1] = _BINARY[operators.pop()](values[-1], right)
            if rank == 0:
                return values[0]
            operators.append(match[0])
            values.append(self.value())

    def _deeper(self) -> None:
        self._depth += 1
        if self._depth > DEEPEST:
            raise self.fault(
                f"brackets, signs and parameters lie more than {DEEPEST} deep: use a parameter for a part of it"
            )

    def _finite(self, value: float, start: int) -> float:
        if not math.isfinite(value):
            raise self.fault("the value is not a finite number", start)
        return value


class Step(IntEnum):
    """The steps of a block in order of execution; the modal groups have the same names."""

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
    """A G or M code: its step, its modal group (mutually exclusive codes in a block), and its meaning."""

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
    **_codes(
        Step.CUTTER,
        {
            40: "radius compensation off",
            41: "radius compensation left",
            41.1: "left, D a diameter",
            42: "radius compensation right",
            42.1: "right, D a diameter",
        },
    ),
    **_codes(
        Step.TOOL_LENGTH,
        {
            43: "tool offset of the table",
            43.1: "tool offset of the words",
            43.2: "added",
            43.4: "tool point, by angles",
            43.5: "tool point, by tool axes",
            49: "off",
        },
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
    **_codes(Step.MOTION, {33.1: "rigid tapping"}, native=False),
    **_codes(Step.MOTION, {38.2: "probe", 38.3: "probe", 38.4: "probe away", 38.5: "probe away"}),
    **_codes(Step.MOTION, {5.2: "NURBS with L, P", 5.3: "end of G5.2", 6.2: "NURBS with P, K, R"}),
    **_codes(
        Step.MOTION, {70: "lathe cycle", 71: "lathe cycle", 71.1: "lathe cycle", 71.2: "lathe cycle"}, native=False
    ),
    **_codes(Step.MOTION, {72: "lathe cycle", 72.1: "lathe cycle", 72.2: "lathe cycle"}, native=False),
    **_codes(Step.MOTION, {76: "thread", 87: "back bore", 88: "bore, manual out"}, native=False),
    **_codes(Step.DISTANCE, {7: "lathe diameter", 8: "lathe radius"}, "lathe", native=False),
    **_codes(Step.SPINDLE_SPEED, {96: "constant surface speed"}, "spindle mode", native=False),
    **_codes(Step.SPINDLE_SPEED, {97: "spindle speed in rpm"}, "spindle mode"),
}
"""The G codes by ten times their number, so that 593 is G59.3."""

M_CODES: dict[int, Code] = {
    **_codes(Step.OUTPUT, {62: "output on", 63: "output off", 64: "output on", 65: "output off"}),
    **_codes(Step.OUTPUT, {67: "analog output", 68: "analog output"}),
    **_codes(Step.OUTPUT, {66: "wait for an input"}),
    **_codes(Step.TOOL_CHANGE, {6: "change tool", 61: "set tool number"}),
    **_codes(Step.SPINDLE, {3: "spindle clockwise", 4: "spindle counterclockwise", 5: "spindle stop"}),
    **_codes(Step.SPINDLE, {19: "orient the spindle"}),
    **_codes(Step.COOLANT, {7: "mist on", 8: "flood on", 9: "coolant off"}),
    **_codes(Step.OVERRIDE, {48: "overrides on", 49: "overrides off", 50: "feed override", 51: "speed override"}),
    **_codes(Step.OVERRIDE, {52: "adaptive feed", 53: "feed hold"}),
    **_codes(
        Step.OVERRIDE,
        {70: "save modes", 71: "drop saved modes", 72: "restore modes", 73: "save for the call"},
        "saved modes",
    ),
    **_codes(Step.STOP, {0: "stop", 1: "optional stop", 2: "end", 30: "end, pallet change", 60: "pallet change, stop"}),
}

_UNDEFINED = "LinuxCNC's manual says that it is accepted, but not defined; write its moves"
REFUSED: dict[str, str] = {
    "G33.1": "rigid tapping follows the real spindle: take it out of what is planned",
    "G76": "lathe: a thread follows the real spindle, take it out of what is planned",
    "G87": f"back boring: {_UNDEFINED}",
    "G88": f"boring with a manual retract, from where the operator leaves it: {_UNDEFINED}",
    **dict.fromkeys(
        (f"M{number}" for number in range(100, 200)),
        "M100 to M199 start programs of the machine, and what they do is not known: take it out",
    ),
    **dict.fromkeys(("M98", "M99"), "subprograms are o-words here: o100 sub .. o100 endsub, and o100 call"),
}
"""The codes that neither front end supports, with the reason."""


def name_of(letter: str, code: int) -> str:
    """Return a code as written in a program, e.g. G59.3."""
    return f"{letter.upper()}{code // 10}" + (f".{code % 10}" if code % 10 else "")


AXES = "xyzabcuvw"
LARGEST = 1e9
"""The largest magnitude of a word, in the unit of the word."""
RS274 = "the own reader has no {}: LinuxCNC's interpreter rs274 reads it, which comes with the package linuxcnc-uspace"

_PLAIN = re.compile(r"(?:[a-mp-z@^$][+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+))+")
_WORDS = re.compile(r"([a-mp-z@^$])([+-]?[0-9.]+)")
_NUMBERED = re.compile(r"n([0-9]+(?:\.[0-9]+)?)")
_LETTERS = frozenset("abcdefghijklmpqrstuvwxyz@^$")


class Block:
    """The content of one line.

    words     letter -> value, without G and M; used words are removed, and any remaining word is refused
    codes     letter and ten times the number of each code, in order of execution
    assigned  parameters that the block sets after all its values have been read
    comments  texts in parentheses
    control   the line without white space and comments if it contains an o-word, otherwise empty
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
        """Remove a word and return it; for a missing word return None, or raise BlockError if `code` names a code that
        requires it.
        """
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
    """Parse a line; with `skip_deleted` a line that begins with / is an empty block."""
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
    # nearly all lines have plain numbers only, for which two regular expressions are much faster than the parser
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
        # tuples compare by their step first, which is the order of execution
        block.codes.sort()
        _refuse_two_of_a_group(block)
    return block


def _read_words(block: Block, values: Values) -> None:
    """Read words whose values are not all plain numbers, and parameter assignments."""
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
    meaning = code.meaning if "lathe" in code.meaning else f"lathe: {code.meaning}"
    raise BlockError(REFUSED.get(name) or RS274.format(f"{name} ({meaning})"), name, at)


_WRITTEN = {
    f"{letter}{text}": (code.step, letter, number)
    for letter, table in (("g", G_CODES), ("m", M_CODES))
    for number, code in table.items()
    if code.native
    for text in {f"{number / 10:g}", f"{number / 10:04.1f}" if number % 10 else f"{number // 10:02}"}
}
"""The codes by their usual spellings, such as g1 and g01; other spellings are looked up by number."""


def _place(text: str, letter: str, value: float) -> int:
    """Return the index in a line of plain words at which the last word with this letter and value begins."""
    return max(word.start() for word in _WORDS.finditer(text) if word[1] == letter and float(word[2]) == value)


def code_of(letter: str, number: int) -> Code:
    """Return the code-table entry of this word."""
    return (G_CODES if letter == "g" else M_CODES)[number]


def _refuse_two_of_a_group(block: Block) -> None:
    seen: dict[str, str] = {}
    for _, letter, code in block.codes:
        group, name = code_of(letter, code).group, name_of(letter, code)
        if group in seen:
            raise BlockError(
                f"{seen[group]} and {name} exclude each other ({group.lower().replace('_', ' ')}): use two lines", name
            )
        seen[group] = name


def read_debug(text: str, parameters: Parameters) -> str:
    """Return the text of a (DEBUG, ...) or (PRINT, ...) comment with the values of its parameters inserted,
    formatted by %d, %f or %.2f.
    """
    form = "%f"

    def shown(match: re.Match[str]) -> str:
        nonlocal form
        if match[0].startswith("%"):
            form = match[0]
            return ""
        key: int | str = int(match[1]) if match[1] else "".join(match[2].split()).lower()
        if not parameters.known(key):
            # as LinuxCNC prints a parameter without a value
            return "######"
        value = parameters.value(key)
        return str(math.floor(value + 0.5)) if form == "%d" else form % value

    return re.sub(r"#(?:(\d{1,4})|<([^<>]+)>)|%(?:d|f|\.\df)", shown, text)

"""Values in a part program: its parameters, and numbers, expressions in brackets and functions. Angles are in degrees.


Parameters are numbered (`#31`), named (`#<depth>`), or follow the interpreter itself; a `.var` file keeps them.
Precedence, as in LinuxCNC: `**`; `* / mod`; `+ -`; `eq ne gt ge lt le`; `and or xor`; each from left to right.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from math import isfinite
from pathlib import Path

from feeddrive.language.errors import FileError, shown
from feeddrive.language.quantity import Quantity, number
from feeddrive.path.program.lines import BlockError

MOST = 5602
"""Numbered parameters are #1 to #5602."""
ARGUMENTS = range(1, 31)
"""Those that a subroutine has of its own: the arguments of its call."""
READ_ONLY = range(5400, 5429)
"""Tool, tool offset and position: they follow the program."""


class Parameters:
    """The parameters: by number, by name within the running subroutine, and by `_name` for the whole program.

    numbered  those that are not 0
    live      values that follow the program: number or name -> function
    """

    def __init__(self, numbered: dict[int, float] | None = None) -> None:
        self.numbered: dict[int, float] = dict(numbered or {})
        self.live: dict[int | str, Callable[[], float]] = {}
        self.common: dict[str, float] = {}
        self.local: dict[str, float] = {}

    def value(self, key: int | str) -> float:
        """Return the value of a parameter; a named one must have been set."""
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
        """True if a parameter has a value, as EXISTS asks."""
        return key in self.live or isinstance(key, int) or key in (self.common if key.startswith("_") else self.local)

    def set(self, key: int | str, value: float) -> None:
        """Set a parameter."""
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
    whole = round(value)
    if abs(value - whole) > 1e-4 or not 1 <= whole <= MOST:
        raise BlockError(f"a parameter has a whole number from 1 to {MOST}, not {Quantity(value):6}", "#")
    return whole


def read_offsets(path: Path | str) -> dict[int, float]:
    """Read the numbered parameters of a `.var` file of LinuxCNC: two columns, number and value.

    They hold the work offsets (5221 ff), G28 (5161 ff), G30 (5181 ff) and G92 (5210 ff), in mm and degrees, or in
    inches if the machine's unit is the inch.
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


DEEPEST = 60
"""Brackets inside brackets."""
EQUAL = 1e-5
"""Numbers closer than this are eq."""

NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)")
_NAME = re.compile(r"<([^<>]+)>")
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
    "ln": lambda x: math.log(_inside("ln", x, 5e-324, math.inf)),
    "round": lambda x: float(math.floor(abs(x) + 0.5)) * math.copysign(1.0, x),
    "sin": lambda x: math.sin(math.radians(x)),
    "sqrt": lambda x: math.sqrt(_inside("sqrt", x, 0, math.inf)),
    "tan": lambda x: math.tan(math.radians(x)),
}


class Values:
    """Reads values from a compacted line, from index `at` on."""

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
        """Read the name or the number of a parameter behind a #."""
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
        """Read an expression behind an opening bracket, up to its closing one."""
        values = [self.value()]
        operators: list[str] = []
        while True:
            match = _OPERATOR.match(self.text, self.at)
            if not match:
                raise self.fault("an operator or a closing bracket ] is expected here")
            self.at = match.end()
            rank = _RANK.get(match[0], 0)
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

"""Parameters of a part program: numbered, named, of the interpreter itself; and the `.var` file that keeps them."""

from __future__ import annotations

from collections.abc import Callable
from math import isfinite
from pathlib import Path

from feeddrive.language.errors import FileError, shown
from feeddrive.language.quantity import Quantity
from feeddrive.path.program.lines import BlockError

MOST = 5602
"""Numbered parameters are #1 to #5602."""
ARGUMENTS = range(1, 31)
"""Those that a subroutine has of its own: the arguments of its call."""
READ_ONLY = range(5400, 5429)
"""Tool, tool offset and position: they follow the program."""


class Parameters:
    """Numbers by number, by name for the subroutine that runs, and by `_name` for all of the program.

    numbered  those that are not 0
    live      values that follow the program: number or name -> function
    """

    def __init__(self, numbered: dict[int, float] | None = None) -> None:
        self.numbered: dict[int, float] = dict(numbered or {})
        self.live: dict[int | str, Callable[[], float]] = {}
        self.common: dict[str, float] = {}
        self.local: dict[str, float] = {}

    def value(self, key: int | str) -> float:
        """The value of a parameter; a name must have been given a value."""
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
        """Whether a parameter has a value, as EXISTS asks."""
        return key in self.live or isinstance(key, int) or key in (self.common if key.startswith("_") else self.local)

    def set(self, key: int | str, value: float) -> None:
        """Give a parameter a value."""
        if not isfinite(value):
            raise BlockError(f"a parameter must be a finite number, not {value}", "#")
        if key in self.live or key in READ_ONLY:
            raise BlockError(f"the parameter #{key if isinstance(key, int) else f'<{key}>'} is read-only", "#")
        if isinstance(key, int):
            self.numbered[key] = value
        else:
            (self.common if key.startswith("_") else self.local)[key] = value


def number_of(value: float) -> int:
    """A number as the number of a parameter."""
    whole = round(value)
    if abs(value - whole) > 1e-4 or not 1 <= whole <= MOST:
        raise BlockError(f"a parameter has a whole number from 1 to {MOST}, not {Quantity(value):6}", "#")
    return whole


def read_offsets(path: Path | str) -> dict[int, float]:
    """The numbered parameters of a `.var` file of LinuxCNC: two columns, number and value.

    They hold the work offsets (5221 ff), G28 (5161 ff), G30 (5181 ff) and G92 (5210 ff), in mm and degrees, or in
    inches if the machine's unit is the inch.
    """
    file = Path(path)
    try:
        text = file.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise FileError(f"{file}: cannot be read: {error.strerror or error}") from None
    values: dict[int, float] = {}
    for number, line in enumerate(text.splitlines(), 1):
        columns = line.split("#")[0].split()
        if not columns:
            continue
        try:
            key, value = int(columns[0]), float(columns[1])
        except (IndexError, ValueError):
            raise FileError(
                f"{file}, line {number}: {shown(line.strip())}: a line holds the number of a parameter and its value"
            ) from None
        if not 1 <= key <= MOST or not isfinite(value):
            raise FileError(
                f"{file}, line {number}: parameter {columns[0]} = {columns[1]}: the number lies in 1..{MOST}, "
                "the value is finite"
            )
        if key in values:
            raise FileError(f"{file}, line {number}: parameter {key} stands there twice: delete one of the lines")
        values[key] = value
    return values

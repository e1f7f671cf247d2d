"""A room of the page: what it shows, and the acts that a person does in it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar, cast

from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import USUAL, Units
from feeddrive.language.table import Grid, Table
from feeddrive.plot.chart import Chart

if TYPE_CHECKING:
    from feeddrive.studio.desk import Desk

F = TypeVar("F", bound=Callable[..., Any])
_MARK = "studio_act"


@dataclass(frozen=True)
class Said:
    """What the page gets of a room.

    words   what goes into the header as JSON
    charts  by name
    """

    words: Mapping[str, Any] = field(default_factory=dict[str, Any])
    charts: Mapping[str, Chart] = field(default_factory=dict[str, Chart])


class Asked:
    """What the page asks for. What is missing or of another kind raises ParameterError."""

    def __init__(self, given: Mapping[str, Any]) -> None:
        self.given = given

    def text(self, name: str) -> str:
        """A text."""
        found = self.given.get(name)
        if not isinstance(found, str):
            raise ParameterError(f"the page must send {name} as a text, not {found!r:.60}")
        return found

    def number(self, name: str) -> float:
        """A number."""
        found = self.given.get(name)
        if isinstance(found, bool) or not isinstance(found, (int, float)):
            raise ParameterError(f"{name} must be a number, not {found!r:.60}")
        try:
            value = float(found)
        except OverflowError:  # a whole number of any length
            value = math.inf
        if not math.isfinite(value):
            raise ParameterError(f"{name} must be a finite number, not {found!r:.60}")
        return value

    def yes(self, name: str, usual: bool = False) -> bool:
        """True or false."""
        found = self.given.get(name, usual)
        if not isinstance(found, bool):
            raise ParameterError(f"{name} must be true or false, not {found!r:.60}")
        return found

    def text_or_none(self, name: str) -> str | None:
        """A text; None where it is missing or empty."""
        return self.text(name) if self.given.get(name) not in (None, "") else None

    def number_or_none(self, name: str) -> float | None:
        """A number; None where it is missing or empty."""
        return self.number(name) if self.given.get(name) not in (None, "") else None

    def texts(self, name: str) -> list[str]:
        """Several texts, or none."""
        found = self.given.get(name, [])
        if not isinstance(found, list) or not all(isinstance(each, str) for each in cast("list[Any]", found)):
            raise ParameterError(f"{name} must be a list of texts, not {found!r:.60}")
        return cast("list[str]", found)

    def choice(self, name: str, among: Iterable[str]) -> str:
        """One of several texts."""
        found, known = self.text(name), tuple(among)
        if found not in known:
            raise ParameterError(f"{name} must be one of {', '.join(known)}, not '{found:.60}'")
        return found


def tabled(found: Table | Grid, units: Units = USUAL) -> dict[str, Any]:
    """A table for the page, in the units of its reader."""
    grid = found if isinstance(found, Grid) else found.grid(units)
    return {"title": grid.title, "heads": grid.heads, "rows": grid.rows}


def act(method: F) -> F:
    """Mark a method of a room as an act of the page: `move` of the room `tune` is asked for as `tune.move`."""
    setattr(method, _MARK, True)
    return method


class Room:
    """A part of the page. It holds what only it needs; what rooms share is on the desk.

    An act takes an `Asked` and gives a `Said`, or None for `show()`.
    """

    name: ClassVar[str] = ""

    def __init__(self, desk: Desk) -> None:
        self.desk = desk

    def show(self) -> Said:
        """State and pictures, as a page needs them that has just been opened or loaded again."""
        return Said()

    def begin(self) -> None:
        """Another source is on the desk: forget what belonged to the one before."""

    def do(self, name: str, asked: Asked) -> Said:
        """One act, by name. Raises ParameterError for one that there is not."""
        known = [each for each in dir(self) if getattr(getattr(type(self), each, None), _MARK, False)]
        if name == "show":
            return self.show()
        if name not in known:
            raise ParameterError(f"the room {self.name} has no act '{name:.60}': it has {', '.join(['show', *known])}")
        found = getattr(self, name)(asked)
        return self.show() if found is None else found

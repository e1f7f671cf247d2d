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
    """The answer of a room to the page.

    words   what goes into the header as JSON
    charts  by name
    """

    words: Mapping[str, Any] = field(default_factory=dict[str, Any])
    charts: Mapping[str, Chart] = field(default_factory=dict[str, Chart])


class Asked:
    """The parameters of a request from the page. A missing value or one of another type raises ParameterError."""

    def __init__(self, parameters: Mapping[str, Any]) -> None:
        self.parameters = parameters

    def text(self, name: str) -> str:
        """Return a text."""
        value = self.parameters.get(name)
        if not isinstance(value, str):
            raise ParameterError(f"the page must send {name} as a text, not {value!r:.60}")
        return value

    def number(self, name: str) -> float:
        """Return a number."""
        entry = self.parameters.get(name)
        if isinstance(entry, bool) or not isinstance(entry, (int, float)):
            raise ParameterError(f"{name} must be a number, not {entry!r:.60}")
        try:
            value = float(entry)
        except OverflowError:  # a whole number of any length
            value = math.inf
        if not math.isfinite(value):
            raise ParameterError(f"{name} must be a finite number, not {entry!r:.60}")
        return value

    def yes(self, name: str, usual: bool = False) -> bool:
        """Return true or false."""
        value = self.parameters.get(name, usual)
        if not isinstance(value, bool):
            raise ParameterError(f"{name} must be true or false, not {value!r:.60}")
        return value

    def text_or_none(self, name: str) -> str | None:
        """Return a text; None if it is missing or empty."""
        return self.text(name) if self.parameters.get(name) not in (None, "") else None

    def number_or_none(self, name: str) -> float | None:
        """Return a number; None if it is missing or empty."""
        return self.number(name) if self.parameters.get(name) not in (None, "") else None

    def texts(self, name: str) -> list[str]:
        """Return a list of texts, possibly empty."""
        values = self.parameters.get(name, [])
        if not isinstance(values, list) or not all(isinstance(value, str) for value in cast("list[Any]", values)):
            raise ParameterError(f"{name} must be a list of texts, not {values!r:.60}")
        return cast("list[str]", values)

    def choice(self, name: str, among: Iterable[str]) -> str:
        """Return one of several texts."""
        value, known = self.text(name), tuple(among)
        if value not in known:
            raise ParameterError(f"{name} must be one of {', '.join(known)}, not '{value:.60}'")
        return value


def tabled(table: Table | Grid, units: Units = USUAL) -> dict[str, Any]:
    """Return a table for the page, in the units of its reader."""
    grid = table if isinstance(table, Grid) else table.grid(units)
    return {"title": grid.title, "heads": grid.heads, "rows": grid.rows}


def act(method: F) -> F:
    """Mark a method of a room as an action of the page: `move` of the room `tune` is requested as `tune.move`."""
    setattr(method, _MARK, True)
    return method


class Room:
    """A part of the page with its own state; state that rooms share is on the desk.

    An act takes an `Asked` and gives a `Said`, or None for `show()`.
    """

    name: ClassVar[str] = ""

    def __init__(self, desk: Desk) -> None:
        self.desk = desk

    def show(self) -> Said:
        """Return state and pictures for a page that has just been opened or reloaded."""
        return Said()

    def begin(self) -> None:
        """Forget the state that belonged to the previous source."""

    def do(self, name: str, asked: Asked) -> Said:
        """Run an action, by name. Raises ParameterError for an unknown one."""
        known = [attribute for attribute in dir(self) if getattr(getattr(type(self), attribute, None), _MARK, False)]
        if name == "show":
            return self.show()
        if name not in known:
            raise ParameterError(f"the room {self.name} has no act '{name:.60}': it has {', '.join(['show', *known])}")
        answer = getattr(self, name)(asked)
        return self.show() if answer is None else answer

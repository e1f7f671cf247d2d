"""The rows of a maker's file: which quantity is entered under which name, in which unit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from feeddrive.blocks.families import Filter
from feeddrive.export.parameters.quantities import QUANTITIES, Cascade, DriveTrain, at_shaft
from feeddrive.export.parameters.unsupported import Lost

NOT_CHECKED = "NOT CHECKED against a manual: name and unit are those in common use"


class Row(NamedTuple):
    """A parameter of a maker.

    unit      as the maker writes it, and `measure` the same for `language.units`
    source    manual and page that say so; empty where none was at hand
    linear    name, unit and measure for a linear motor, where they differ
    scale     on top of the unit: -1 for a lower limit
    decimals  that the control keeps, and `most` the largest value that it takes
    """

    name: str
    quantity: str
    unit: str
    measure: str
    meaning: str
    source: str = ""
    linear: tuple[str, str, str] | None = None
    scale: float = 1.0
    decimals: int | None = None
    most: float | None = None


class Line(NamedTuple):
    """A number as it stands in a file, and where it comes from in SI."""

    name: str
    text: str
    unit: str
    meaning: str
    path: str
    si: str
    source: str


class Filtered(NamedTuple):
    """The lines of a filter, or why the maker has none like it."""

    lines: tuple[Line, ...] = ()
    why: str = ""


@dataclass(frozen=True)
class Maker:
    """A control or drive: its rows, its filters, and how its files are written.

    notes    lines at the head of its file: which loop is meant, how the integral is switched off, and the like
    rotary   whether it knows no linear motor
    held     kinds of items (cascade/beside.py) that it holds whole, `outside` why it does not hold others
    filters  (filter, place among the filters, drive train) -> its lines
    """

    key: str
    title: str
    comment: str
    rows: Sequence[Row]
    held: Sequence[str]
    outside: Mapping[str, tuple[str, str]]
    filters: Callable[[Filter, int], Filtered]
    notes: Sequence[str] = ()
    rotary: bool = False
    always: Sequence[Lost] = field(default_factory=tuple[Lost, ...])


def lines_of(maker: Maker, cascade: Cascade, train: DriveTrain) -> tuple[list[Line], list[Lost]]:
    """The numbers that a maker's file holds, and those that it cannot take."""
    lines: list[Line] = []
    lost: list[Lost] = []
    for row in maker.rows:
        name, unit, measure = (row.name, row.unit, row.measure) if train.rotary or not row.linear else row.linear
        value = at_shaft(cascade, train, row.quantity, measure) if name else None
        if value is None:
            continue
        text = number(row.scale * value, row.decimals)
        path, si = QUANTITIES[row.quantity].path, in_si(cascade, train, row.quantity)
        problem = _problem(row, row.scale * value, text)
        if problem:
            lost.append(Lost(path, f"{row.scale * value:.6g} {unit} in {name}", *problem))
        else:
            lines.append(Line(name, text, unit, row.meaning, path, si, row.source or NOT_CHECKED))
    for i, block in enumerate(cascade.loop.control.filters):
        lines += maker.filters(block, i).lines
    return lines, lost


def _problem(row: Row, value: float, text: str) -> tuple[str, str] | None:
    """Why a value cannot be entered, and what happens; None if it can."""
    if row.most is not None and abs(value) > row.most:
        return f"{row.name} takes at most {row.most:g}", "the loop cannot be set up there: the gain stays lower"
    if value != 0.0 and abs(float(text) - value) > 0.01 * abs(value):
        return f"{row.name} keeps {row.decimals} decimals", f"the value would be {text}, more than 1 % off"
    return None


def number(value: float, decimals: int | None = None) -> str:
    """Six significant digits, or the decimals that a control keeps."""
    return f"{value:.6g}" if decimals is None else f"{value:.{decimals}f}"


def in_si(cascade: Cascade, train: DriveTrain, quantity: str) -> str:
    """A quantity in SI at the table, to the last digit."""
    own = {"lead": train.lead, "gear": train.gear}
    value = own[quantity] if quantity in own else cascade.values[quantity]
    return f"{value!r} {QUANTITIES[quantity].table}".rstrip()


def filter_line(
    name: str, value: float, unit: str, meaning: str, path: str, source: str, decimals: int | None = None
) -> Line:
    """A number of a filter."""
    return Line(
        name, number(value, decimals), unit, meaning, path, f"{float(value)!r} {unit}".rstrip(), source or NOT_CHECKED
    )

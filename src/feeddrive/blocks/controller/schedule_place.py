"""One place of a gain schedule: a position, and the law that holds there, or one law for each payload."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, Self

from feeddrive.blocks.controller.schedule_load import ScheduleLoad, require_schedulable
from feeddrive.blocks.families import Law
from feeddrive.language import ops, tree
from feeddrive.language.block import Block, Number, Rule, parameter, part
from feeddrive.language.errors import StructureError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text

# two places are the least between which a number can be interpolated; more than ten would be read off no measurement
FEWEST, MOST_PLACES = 2, 10


class SchedulePlace(Block):
    """A position of the axis and the law with the parameters that are right there, for a `GainSchedule`.

        p(position) = the parameters of this law
        w_j = min(max(payload - m_j, 0), m_(j+1) - m_j)                         for the payloads m_0 < m_1 < ... < m_n
        p(position, payload) = p_0 + Σ w_j (p_(j+1) - p_j)/(m_(j+1) - m_j)      with `loads` in place of one law

    Each law is complete, so it can be read, tuned and checked like the law of an axis without a schedule.
    """

    position: Number = parameter("m", "position of the load at which the parameters of this law hold")
    law: Law | None = part("the law with its parameters at this position; absent with loads", default=None)
    loads: tuple[ScheduleLoad, ...] = part(
        "payloads in ascending order, each with the law that holds for it at this position", default=(), alike=True
    )

    def check(self) -> None:
        """Raise StructureError for a law that a schedule cannot interpolate, and for laws of different structure."""
        if self.law is not None:
            require_schedulable(self.law, f"{self.kind}.law")
        if (self.law is None) == (not self.loads):
            raise StructureError(
                f"{self.kind} needs either law or loads, and has {'both' if self.loads else 'neither'}: give the law "
                f"of this position, or in loads one for each payload"
            )
        if self.loads and not FEWEST <= len(self.loads) <= MOST_PLACES:
            raise StructureError(
                f"{self.kind}.loads holds {len(self.loads)} payloads; it must be {FEWEST} to {MOST_PLACES}: for one "
                f"payload give the law itself"
            )
        for i, load in enumerate(self.loads[1:], 1):
            differs = tree.difference(self.loads[0].law, load.law, f"loads.{i}.law")
            if differs is not None:
                raise StructureError(
                    f"{self.kind}.{differs} with the payload: a schedule interpolates numbers only; give the laws of "
                    f"all payloads the kind, choices, tables and optional parameters of loads.0"
                )

    def rules(self) -> Iterator[Rule]:
        """Yield the validity rules: the payloads ascend."""
        payloads = [load.payload for load in self.loads]
        for i, (before, after) in enumerate(pairwise(payloads)):
            yield ascends(f"{self.kind}.loads", "payload", "kg", i, before, after)

    def laws(self) -> tuple[tuple[str, Law], ...]:
        """Return the laws of this place with their names within it."""
        if self.law is not None:
            return (("law", self.law),)
        return tuple((f"loads.{i}.law", load.law) for i, load in enumerate(self.loads))

    def with_laws(self, change: Callable[[Law], Law]) -> Self:
        """Return the place with changed laws; itself if none changes."""
        # unchanged blocks keep their identity, by which others see that nothing has changed
        if self.law is not None:
            law = change(self.law)
            return self if law is self.law else replace(self, law=law)
        laws = [change(load.law) for load in self.loads]
        if all(law is load.law for law, load in zip(laws, self.loads, strict=True)):
            return self
        return replace(self, loads=tuple(replace(m, law=law) for m, law in zip(self.loads, laws, strict=True)))

    def numbers(self, payload: Number | None) -> list[Any]:
        """Return the parameters of the law at this place for a payload (kg), in the order of the law's leaves."""
        rows = [[value for _, value in tree.leaves(law)] for _, law in self.laws()]
        if payload is None or not self.loads:
            return rows[0]
        payloads = [load.payload for load in self.loads]
        return interpolated(rows[0], payload, payloads, *slopes(payloads, rows))


def slopes(places: Sequence[Number], rows: Sequence[Sequence[Any]]) -> tuple[tuple[Number, ...], tuple[Any, ...]]:
    """Return the widths of the intervals between places, and in each of them the slope of every parameter."""
    widths = tuple(after - before for before, after in pairwise(places))
    pairs = zip(rows, rows[1:], widths, strict=False)
    return widths, tuple(tuple((b - a) / width for a, b in zip(x, y, strict=True)) for x, y, width in pairs)


def interpolated(
    first: Sequence[Any], at: Number, places: Sequence[Number], widths: Sequence[Number], rises: Sequence[Sequence[Any]]
) -> list[Any]:
    """Return the parameters at a place from those of the first place and the slopes; held outside of the places."""
    numbers = list(first)
    for place, width, rise in zip(places, widths, rises, strict=False):
        along = ops.clip(at - place, 0.0, width)
        numbers = [value + along * slope for value, slope in zip(numbers, rise, strict=True)]
    return numbers


def ascends(where: str, name: str, unit: str, i: int, before: Number, after: Number) -> Rule:
    """Return the rule that entry i + 1 of a list of places is beyond entry i."""
    listed = where.rpartition(".")[2]
    return Rule(
        after > before,
        f"{listed}.{i + 1}.{name} is beyond {listed}.{i}.{name}",
        lambda: Text(
            f"{where}.{i + 1}.{name} = {Quantity(after, unit):6 SI} must be > {Quantity(before, unit):6 SI}, the "
            f"{name} of {listed}.{i}: list the {listed} in ascending order, each {name} once"
        ),
    )

"""A law whose numbers depend on the position of the axis, and on the payload that it carries."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple, Self

from feeddrive.blocks.axis_model import AxisModel, Start
from feeddrive.blocks.controller.schedule_place import (
    FEWEST,
    MOST_PLACES,
    SchedulePlace,
    ascends,
    interpolated,
    slopes,
)
from feeddrive.blocks.families import Law
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language import ops, tree
from feeddrive.language.block import Number, Rule, parameter, part
from feeddrive.language.errors import StructureError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text


class GainSchedule(Law):
    """Any law with numbers that are interpolated over the position of the load, and over the payload.

        u_i   = min(max(x_load - x_i, 0), x_(i+1) - x_i)                       for the places x_0 < x_1 < ... < x_n
        p(x)  = p_0 + Σ u_i (p_(i+1) - p_i) / (x_(i+1) - x_i)                  for every parameter p of the law,
                                                                               p_i that of place i for the payload
        state = retune of the law from p(x(k-1)) to p(x(k)), applied to the state of the last sample
        (state, force) = step of the law with the parameters p(x(k))

    x_load is the measured position.  Between two places every parameter is linear in the position; outside of the range
    the parameters of the first or last place hold, because gains are never extrapolated.  At a fixed position the law
    is exactly the one with the parameters p(x), which its own `prepare` turns into gains in each sample.  Equal
    parameters at all places give the bits of the law without a schedule.

    The `retune` of the law keeps its force continuous, as at a live change: an axis that moves sees no steps, and an
    axis at rest under load has the linear model of the law with fixed parameters.  A law whose force jumps at a live
    change (`LinuxcncPid`) is therefore refused.  So is one whose `prepare` takes more than 500 operations, since it
    would run twice in each sample: predictive control, LQG, and laws with a GPI observer.  To interpolate what they
    precompute is no way out: between two places the gains would not belong together, and a predictive law would answer
    to the position itself.

    With `payload`, the mass on the table, each place holds a law for each of its payloads (`SchedulePlace`). It is not
    measured: user or CNC set it, as a live change.  A payload beyond those of the places is refused.  It costs nothing
    in a sample, because `prepare` interpolates over it.

    The laws at all places have one structure: choices, tables and absent parameters must not differ.

    When to use: axes whose stiffness or mass changes along the travel, as with a long ball screw.  Filters,
    compensations and feedforward have no schedule; they act behind the law or beside it.
    Source: Leith & Leithead 2000, section 4 (why the state must be converted); the conversion is this library's.
    """

    title = "gain schedule"

    payload: Number | None = parameter(
        "kg", "mass on the table now; absent for a schedule over the position alone", least=0, default=None
    )
    places: tuple[SchedulePlace, ...] = part(
        "positions in ascending order, each with the law that holds there", alike=True
    )

    class Prepared(NamedTuple):
        """T (s); parameters at the first place; widths (m) of intervals between places; slopes of parameters per m."""

        T: Number
        first: tuple[Number, ...]
        widths: tuple[Number, ...]
        slopes: tuple[tuple[Number, ...], ...]

    class State(NamedTuple):
        """The state of the law, and the position (m) that the parameters of the last sample belong to."""

        law: Any
        position: Number

    @classmethod
    def begin(cls, axis: AxisModel, present: Law) -> tuple[Start, ...]:
        """Return no variant, so that a comparison omits the law: an axis does not tell its positions."""
        return ()

    def check(self) -> None:
        """Raise StructureError for too few or too many places, and for laws that cannot be interpolated."""
        count = len(self.places)
        if not FEWEST <= count <= MOST_PLACES:
            raise StructureError(
                f"{self.kind}.places holds {count} places; it must be {FEWEST} to {MOST_PLACES}: without a schedule, "
                f"give the law itself"
            )
        if (self.payload is None) != (not self.places[0].loads):
            missing = "payload is absent" if self.payload is None else "places.0 has one law for all payloads"
            raise StructureError(
                f"{self.kind}: {missing}: a schedule over the payload needs both, payload (the mass on the table now) "
                f"and at each place loads (payloads with the law for each); one over the position alone has neither"
            )
        first = self._first
        if first.commanded != self.commanded:
            raise StructureError(
                f"{self.kind}.places.0.law: {first.kind} commands a {first.commanded}, and a schedule is for laws that "
                f"command a {self.commanded}: take the law without a schedule"
            )
        for i, place in enumerate(self.places[1:], 1):
            differs = tree.difference(self.places[0], place, f"places.{i}")
            if differs is not None:
                raise StructureError(
                    f"{self.kind}.{differs} along the travel: a schedule interpolates numbers only; give the laws of "
                    f"all places the kind, choices, tables and optional parameters of places.0"
                )

    def rules(self) -> Iterator[Rule]:
        """Yield the validity rules: the positions ascend, and every place knows the payload."""
        positions = [place.position for place in self.places]
        for i, (before, after) in enumerate(pairwise(positions)):
            yield ascends(f"{self.kind}.places", "position", "m", i, before, after)
        if self.payload is not None:
            for i, place in enumerate(self.places):
                yield _knows(self.kind, i, place, self.payload)

    def tuned(self) -> tuple[str, ...]:
        """Return the parameters to tune of the law at each place, and for each payload."""
        laws = [(f"places.{i}.{name}", law) for i, place in enumerate(self.places) for name, law in place.laws()]
        return tuple(f"{name}.{tuned}" for name, law in laws for tuned in law.tuned())

    @property
    def _first(self) -> Law:
        return self.places[0].laws()[0][1]

    def fed(self) -> tuple[str, ...]:
        """Return the parts of the set motion that the law at the places feeds forward."""
        return self._first.fed()

    def subtracts(self) -> bool:
        """Return True if the law at the places subtracts a disturbance estimate."""
        return self._first.subtracts()

    def positions(self) -> int:
        return self._first.positions()

    def period(self) -> int:
        """Return the period of the law at the places."""
        return self._first.period()

    def at_one_rate(self) -> Self:
        """Return the schedule with the law of each place at one rate."""
        return self._with_laws(lambda law: law.at_one_rate())

    def settled(self) -> Self:
        return self._with_laws(lambda law: law.settled())

    def _with_laws(self, change: Callable[[Law], Law]) -> Self:
        places = [place.with_laws(change) for place in self.places]
        if all(new is old for new, old in zip(places, self.places, strict=True)):
            return self
        return replace(self, places=tuple(places))

    def prepare(self, T: Number) -> Prepared:
        """Compute the parameters at the places for the payload, and their slopes between the places."""
        rows = [place.numbers(self.payload) for place in self.places]
        return self.Prepared(T, tuple(rows[0]), *slopes([place.position for place in self.places], rows))

    def start(self, prepared: Prepared, setpoint: Setpoint, reading: Reading) -> State:
        """Return the state of the law with its parameters at the reading."""
        law = self._at(prepared, reading.position_load)
        return self.State(law.start(law.prepare(prepared.T), setpoint, reading), reading.position_load)

    def step(
        self, prepared: Prepared, state: State, setpoint: Setpoint, reading: Reading, T: Number
    ) -> tuple[State, Number]:
        law = self._at(prepared, reading.position_load)
        computed = law.prepare(T)
        old = self._at(prepared, state.position)
        held = law.retune(state.law, old, old.prepare(T), computed)
        held, force = law.step(computed, held, setpoint, reading, T)
        return self.State(held, reading.position_load), force

    def retune(self, state: State, old: Self, old_prepared: Prepared, prepared: Prepared) -> State:
        """Convert the state of the law from the old to the new parameters at the position of the last sample."""
        before, law = old._at(old_prepared, state.position), self._at(prepared, state.position)
        held = law.retune(state.law, before, before.prepare(old_prepared.T), law.prepare(prepared.T))
        return state._replace(law=held)

    def scheduled_at(self) -> tuple[Number, ...]:
        return tuple(place.position for place in self.places)

    def with_payload(self, payload: Number) -> Self:
        """Return the schedule with another payload (kg) on the table; itself if it is over the position alone."""
        return self if self.payload is None else replace(self, payload=payload)

    def law_at(self, position: float) -> Law:
        """Return the law with its parameters at a position (m): the schedule, for an axis that stays there."""
        return self._at(self.prepare(1.0), position)

    def _at(self, prepared: Prepared, position: Number) -> Law:
        """Return the law with its parameters at a position (m)."""
        positions = [place.position for place in self.places]
        numbers = interpolated(prepared.first, position, positions, prepared.widths, prepared.slopes)
        return tree.rebuild(self._first, iter(numbers))


def _knows(kind: str, i: int, place: SchedulePlace, payload: Number) -> Rule:
    """Return the rule that a payload lies between the first and the last one of a place."""
    least, most = place.loads[0].payload, place.loads[-1].payload
    return Rule(
        ops.both(payload >= least, payload <= most),
        f"payload lies within the loads of places.{i}",
        lambda: Text(
            f"{kind}.payload = {Quantity(payload, 'kg'):6 SI} must be between {Quantity(least, 'kg'):6 SI} and "
            f"{Quantity(most, 'kg'):6 SI}, the payloads of places.{i}: gains are not extrapolated; tune the law for "
            f"this payload, too, and add it to loads"
        ),
    )

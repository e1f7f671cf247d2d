"""A law whose numbers depend on the position of the axis."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, NamedTuple, Self

from feeddrive.blocks.axis_model import AxisModel, Start
from feeddrive.blocks.controller.schedule_place import SchedulePlace
from feeddrive.blocks.families import Law
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language import ops, tree
from feeddrive.language.block import Number, Rule, part
from feeddrive.language.errors import StructureError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text

# two places are the least between which a number can be interpolated; more than ten would be read off no measurement
FEWEST, MOST_PLACES = 2, 10


class GainSchedule(Law):
    """Any law with numbers that are interpolated over the position of the load.

        u_i   = min(max(x_load - x_i, 0), x_(i+1) - x_i)                       for the places x_0 < x_1 < ... < x_n
        p(x)  = p_0 + Σ u_i (p_(i+1) - p_i) / (x_(i+1) - x_i)                  for every parameter p of the law
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

    The laws at all places have one structure: choices, tables and absent parameters must not differ.

    When to use: axes whose stiffness or mass changes along the travel, as with a long ball screw.  Filters,
    compensations and feedforward have no schedule; they act behind the law or beside it.
    Source: Leith & Leithead 2000, section 4 (why the state must be converted); the conversion is this library's.
    """

    title = "gain schedule"

    places: tuple[SchedulePlace, ...] = part(
        "positions in ascending order, each with the law that holds there", alike=True
    )

    class Prepared(NamedTuple):
        """The sample time (s); the width (m) of each interval between places; the slopes of all parameters per m."""

        T: Number
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
        first = self.places[0].law
        if first.commanded != self.commanded:
            raise StructureError(
                f"{self.kind}.places.0.law: {first.kind} commands a {first.commanded}, and a schedule is for laws that "
                f"command a {self.commanded}: take the law without a schedule"
            )
        for i, place in enumerate(self.places[1:], 1):
            differs = tree.difference(first, place.law, f"places.{i}.law")
            if differs is not None:
                raise StructureError(
                    f"{self.kind}.{differs} along the travel: a schedule interpolates numbers only; give the laws of "
                    f"all places the kind, choices, tables and optional parameters of places.0"
                )

    def rules(self) -> Iterator[Rule]:
        """Yield the validity rules: the positions ascend."""
        for i, (before, after) in enumerate(zip(self.places, self.places[1:], strict=False)):
            yield _ascends(self.kind, i, before.position, after.position)

    def tuned(self) -> tuple[str, ...]:
        """Return the parameters to tune of the law at each place."""
        return tuple(f"places.{i}.law.{name}" for i, place in enumerate(self.places) for name in place.law.tuned())

    def fed(self) -> tuple[str, ...]:
        """Return the parts of the set motion that the law at the places feeds forward."""
        return self.places[0].law.fed()

    def subtracts(self) -> bool:
        """Return True if the law at the places subtracts a disturbance estimate."""
        return self.places[0].law.subtracts()

    def positions(self) -> int:
        return self.places[0].law.positions()

    def period(self) -> int:
        """Return the period of the law at the places."""
        return self.places[0].law.period()

    def at_one_rate(self) -> Self:
        """Return the schedule with the law of each place at one rate."""
        return self._with_laws(lambda law: law.at_one_rate())

    def settled(self) -> Self:
        return self._with_laws(lambda law: law.settled())

    def _with_laws(self, change: Callable[[Law], Law]) -> Self:
        laws = [change(place.law) for place in self.places]
        # unchanged blocks keep their identity, by which others see that nothing has changed
        if all(law is place.law for law, place in zip(laws, self.places, strict=True)):
            return self
        return replace(self, places=tuple(replace(p, law=law) for p, law in zip(self.places, laws, strict=True)))

    def prepare(self, T: Number) -> Prepared:
        """Compute the slopes of all parameters between the places."""
        pairs = list(zip(self.places, self.places[1:], strict=False))
        widths = tuple(after.position - before.position for before, after in pairs)
        slopes = tuple(
            tuple((b - a) / width for a, b in zip(_numbers(before.law), _numbers(after.law), strict=True))
            for (before, after), width in zip(pairs, widths, strict=True)
        )
        return self.Prepared(T, widths, slopes)

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

    def law_at(self, position: float) -> Law:
        """Return the law with its parameters at a position (m): the schedule, for an axis that stays there."""
        return self._at(self.prepare(1.0), position)

    def _at(self, prepared: Prepared, position: Number) -> Law:
        """Return the law with its parameters at a position (m)."""
        numbers = _numbers(self.places[0].law)
        for place, width, slopes in zip(self.places, prepared.widths, prepared.slopes, strict=False):
            along = ops.clip(position - place.position, 0.0, width)
            numbers = [value + along * slope for value, slope in zip(numbers, slopes, strict=True)]
        return tree.rebuild(self.places[0].law, iter(numbers))


def _numbers(law: Law) -> list[Any]:
    return [value for _, value in tree.leaves(law)]


def _ascends(kind: str, i: int, before: Number, after: Number) -> Rule:
    return Rule(
        after > before,
        f"places.{i + 1}.position is beyond places.{i}.position",
        lambda: Text(
            f"{kind}.places.{i + 1}.position = {Quantity(after, 'm'):6 SI} must be > {Quantity(before, 'm'):6 SI}, "
            f"the position of places.{i}: list the places in ascending order, each position once"
        ),
    )

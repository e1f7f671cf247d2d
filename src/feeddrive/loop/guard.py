"""The safety of a loop: enable and disable, trips, and numbers that are none. Simulated and exported like the law."""

from __future__ import annotations

from typing import NamedTuple

from feeddrive.blocks.signals import Setpoint
from feeddrive.language import ops
from feeddrive.language.block import Block, Number, parameter

# codes of `Signals.trip`
TRIP_NONE, TRIP_READING, TRIP_FOLLOWING_ERROR, TRIP_VELOCITY, TRIP_TRAVEL, TRIP_COMMAND = 0.0, 1.0, 2.0, 3.0, 4.0, 5.0
TRIPS = {TRIP_READING: "a broken reading or setpoint", TRIP_FOLLOWING_ERROR: "the following error",
         TRIP_VELOCITY: "the velocity", TRIP_TRAVEL: "the travel",
         TRIP_COMMAND: "a command that is no number"}  # in words  # fmt: skip

SMOOTHING = 1.0 / 32.0  # of the velocity: a count that toggles at standstill must not look like motion
SETPOINT_LIMIT = 1e12  # of a setpoint's five numbers in SI, summed: no axis comes near it, not in its snap
COMMAND_LIMIT = 1e18  # N, before the limit: a law that asks for more has overflowed


class Guard(Block):
    """Cuts the force in the very sample in which a bound is broken, and keeps it cut until the loop was disabled.

    A reading that is NaN or beyond `reading_limit` is broken, and so is a setpoint with a NaN or infinite number in it.
    For at most `hold_samples` in a row the last command is held, and law and observers see an axis that goes on: the
    last good reading plus its velocity times T, the last good setpoint likewise.  Then the loop trips.  It trips at
    once on a following error, a velocity or a position beyond its bound, and on a command that is no number.

    A trip is latched; taking `enable` away clears it, giving it again resets the law, its filters and observers to
    where the axis is.  An `enable` that is NaN counts as taken away.
    A loop that does not run, tripped or disabled, commands the `safe_force`.  It is 0 on a level axis; on a hanging
    one it is the force that carries the weight, so that the axis hangs still while the brake closes and after it was
    opened: a law takes over from the force that acts.
    When two encoders are read, the motor's is aligned to the load's at enable, so that their offset cannot act.
    An axis that moves at enable is taken over as it moves: law and observers start from the readings of one sample
    before, and observers from the velocity, which is smoothed over some 32 samples.

        velocity T = travel(k) = travel(k-1) + (x(k) - x(k-1) - travel(k-1)) / 32
    """

    following_error_limit: Number | None = parameter(
        "m", "largest |setpoint - reading|; absent for none", above=0, default=None
    )
    velocity_limit: Number | None = parameter(
        "m/s", "largest speed of the reading; absent for none", above=0, default=None
    )
    travel_least: Number | None = parameter("m", "lower end of the travel; absent for none", default=None)
    travel_most: Number | None = parameter("m", "upper end of the travel; absent for none", default=None)
    reading_limit: Number = parameter("m", "a reading beyond it is taken as broken", above=0, default=1000.0)
    hold_samples: Number = parameter(
        "", "broken readings or setpoints in a row over which the last command is held", least=0, most=1e6, default=1.0
    )
    safe_force: Number = parameter(
        "N", "commanded while the loop does not run: the weight of a hanging axis", default=0
    )

    class Prepared(NamedTuple):
        """The sample time in s, and the largest motion in a sample in m, empty if it has no bound."""

        T: Number
        fastest: tuple[Number, ...]

    class State(NamedTuple):
        """What the guard remembers of the sample before.

        running       whether the loop ran, 0 or 1
        trip          code of the trip
        broken        broken samples in a row
        position      last readings of motor and load, m; where one was broken, where the axis went on to
        offset        between the two encoders, m
        travel        smoothed motion in a sample, m
        set_position  last good setpoint, m and m/s
        """

        running: Number
        trip: Number
        broken: Number
        position_motor: Number
        position_load: Number
        offset: Number
        travel: Number
        set_position: Number
        set_velocity: Number

    class Verdict(NamedTuple):
        """What the law may see, and whether its command counts.

        runs, ran, held are truth values: whether the loop may run in this sample, whether it did in the last one, and
        whether the last command is held.  The readings before are for a start.
        """

        runs: object
        ran: object
        held: object
        setpoint: Setpoint
        position_motor: Number
        position_load: Number
        before_motor: Number
        before_load: Number
        velocity: Number

    def prepare(self, T: Number) -> Prepared:
        """The bound of the velocity as one of the motion in a sample."""
        return self.Prepared(T, () if self.velocity_limit is None else (self.velocity_limit * T,))

    def sound(self, setpoint: Setpoint, motor: Number, load: Number) -> tuple[Setpoint, Number, Number]:
        """What to start from: a broken reading is 0 there, a broken setpoint is where the axis stands."""
        one = motor is load
        load = ops.where(ops.absolute(load) <= self.reading_limit, load, 0.0)
        motor = load if one else ops.where(ops.absolute(motor) <= self.reading_limit, motor, 0.0)
        good = ops.absolute(_sum(setpoint)) <= SETPOINT_LIMIT
        rest = (load, 0.0, 0.0, 0.0, 0.0)
        return Setpoint(*(ops.where(good, x, y) for x, y in zip(setpoint, rest, strict=True))), motor, load

    def start(self, prepared: Prepared, setpoint: Setpoint, motor: Number, load: Number, velocity: Number) -> State:
        """Disabled, without a trip, at the readings of one sample before the first step."""
        zero = motor - motor
        travel = velocity * prepared.T
        return self.State(
            zero, zero, zero, motor, load, motor - load, travel, setpoint.position, zero + setpoint.velocity
        )

    def step(
        self, prepared: Prepared, state: State, setpoint: Setpoint, motor: Number, load: Number, enable: Number
    ) -> tuple[State, Verdict]:
        """Before the law: broken numbers, following error, velocity, travel, in this order of precedence."""
        ran = state.running > 0.5
        one = motor is load  # one encoder: nothing to align
        # written so that NaN, which compares as false, is bad
        good_motor = ops.absolute(motor) <= self.reading_limit
        good_load = ops.absolute(load) <= self.reading_limit
        good_setpoint = ops.absolute(_sum(setpoint)) <= SETPOINT_LIMIT
        good = ops.both(good_load if one else ops.both(good_motor, good_load), good_setpoint)
        goes_on = ops.where(ran, state.travel, 0.0)
        load = ops.where(good_load, load, state.position_load + goes_on)
        motor = load if one else ops.where(good_motor, motor, state.position_motor + goes_on)
        setpoint = self._setpoint(prepared, state, setpoint, good_setpoint)
        broken = ops.where(good, 0.0, state.broken + 1.0)
        found = ops.where(broken > self.hold_samples, TRIP_READING, TRIP_NONE)
        if self.following_error_limit is not None:
            far = ops.absolute(setpoint.position - load) > self.following_error_limit
            found = _first(found, far, TRIP_FOLLOWING_ERROR)
        moved = load - state.position_load
        if prepared.fastest:
            found = _first(found, ops.absolute(moved) > prepared.fastest[0], TRIP_VELOCITY)
        if self.travel_least is not None:
            found = _first(found, load < self.travel_least, TRIP_TRAVEL)
        if self.travel_most is not None:
            found = _first(found, load > self.travel_most, TRIP_TRAVEL)
        enabled = enable > 0.5
        trip = ops.where(enabled, ops.where(state.trip > 0.0, state.trip, found), TRIP_NONE)
        runs = ops.both(enabled, trip <= 0.0)
        offset = state.offset if one else ops.where(ran, state.offset, motor - load)
        travel = state.travel + SMOOTHING * (moved - state.travel)
        after = self.State(
            ops.where(runs, 1.0, 0.0), trip, broken, motor, load, offset, travel, setpoint.position, setpoint.velocity
        )
        aligned = load if one else motor - offset
        before = state.position_load if one else state.position_motor - offset
        velocity = travel / prepared.T
        verdict = self.Verdict(runs, ran, ops.no(good), setpoint, aligned, load, before, state.position_load, velocity)
        return after, verdict

    def _setpoint(self, prepared: Prepared, state: State, setpoint: Setpoint, good: object) -> Setpoint:
        """The setpoint, or where the last good one went on to."""
        gone_on = state.set_position + prepared.T * state.set_velocity
        return Setpoint(
            ops.where(good, setpoint.position, gone_on),
            ops.where(good, setpoint.velocity, state.set_velocity),
            *(ops.where(good, value, 0.0) for value in setpoint[2:]),
        )

    def command(
        self, after: State, verdict: Verdict, last: Number, applied: Number, requested: Number
    ) -> tuple[State, Number, Number]:
        """Behind the law: the force to apply and that requested, in N, and the state with the last kind of trip."""
        sound = ops.absolute(requested) <= COMMAND_LIMIT
        runs = ops.both(verdict.runs, sound)
        trip = ops.where(ops.both(verdict.runs, ops.no(sound)), TRIP_COMMAND, after.trip)
        kept = (ops.where(verdict.held, last, value) for value in (applied, requested))
        applied, requested = (ops.where(runs, value, self.safe_force) for value in kept)
        return after._replace(running=ops.where(runs, 1.0, 0.0), trip=trip), applied, requested


def _sum(setpoint: Setpoint) -> Number:
    """NaN or infinite if one of the five numbers is."""
    x, v, a, j, s = setpoint
    return x + v + a + j + s


def _first(found: Number, broken: object, code: float) -> Number:
    return ops.where(found > 0.0, found, ops.where(broken, code, TRIP_NONE))

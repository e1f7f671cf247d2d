"""The safety of a loop: enable and disable, trips, and readings that are none. Simulated and exported like the law."""

from __future__ import annotations

from typing import NamedTuple

from feeddrive.language import ops
from feeddrive.language.block import Block, Number, parameter

# codes of `Signals.trip`
TRIP_NONE, TRIP_READING, TRIP_FOLLOWING_ERROR, TRIP_VELOCITY, TRIP_TRAVEL = 0.0, 1.0, 2.0, 3.0, 4.0
TRIPS = {TRIP_READING: "a broken reading", TRIP_FOLLOWING_ERROR: "the following error", TRIP_VELOCITY: "the velocity",
         TRIP_TRAVEL: "the travel"}  # in words  # fmt: skip


SMOOTHING = 1.0 / 32.0  # of the velocity at enable: a count that toggles at standstill must not look like motion


class Guard(Block):
    """Cuts the force in the very sample in which a bound is broken, and keeps it cut until the loop was disabled.

    A trip is latched; taking `enable` away clears it, giving it again resets the law, its filters and observers to
    where the axis is.  A reading that is NaN or beyond `reading_limit` is replaced by the last good one before a law
    sees it.
    When two encoders are read, the motor's is aligned to the load's at enable, so that their offset cannot act.
    An axis that moves at enable is taken over as it moves: law and observers start from the readings of one sample
    before, and observers from the velocity, which is smoothed over some 32 samples.
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

    class State(NamedTuple):
        """Whether the loop ran (0 or 1), the trip, the last good readings (m), encoder offset (m), velocity (m/s)."""

        running: Number
        trip: Number
        position_motor: Number
        position_load: Number
        offset: Number
        velocity: Number

    class Verdict(NamedTuple):
        """Whether the loop runs now and whether it did; the readings that the law may see; those before, to start."""

        runs: object
        ran: object
        position_motor: Number
        position_load: Number
        before_motor: Number
        before_load: Number
        velocity: Number

    def start(self, motor: Number, load: Number, velocity: Number) -> State:
        """Disabled, without a trip, at the readings of one sample before the first step."""
        zero = motor - motor
        return self.State(zero, zero, motor, load, motor - load, velocity)

    def step(
        self, state: State, setpoint: Number, motor: Number, load: Number, enable: Number, T: Number
    ) -> tuple[State, Verdict]:
        """One sample: bad reading, following error, velocity, travel, in this order of precedence."""
        # written so that NaN, which compares as false, is bad
        good_motor = ops.absolute(motor) <= self.reading_limit
        good_load = ops.absolute(load) <= self.reading_limit
        good = ops.both(good_motor, good_load)
        motor = ops.where(good_motor, motor, state.position_motor)
        load = ops.where(good_load, load, state.position_load)
        found = ops.where(good, TRIP_NONE, TRIP_READING)
        if self.following_error_limit is not None:
            far = ops.absolute(setpoint - load) > self.following_error_limit
            found = _first(found, far, TRIP_FOLLOWING_ERROR)
        if self.velocity_limit is not None:
            fast = ops.absolute(load - state.position_load) > self.velocity_limit * T
            found = _first(found, fast, TRIP_VELOCITY)
        if self.travel_least is not None:
            found = _first(found, load < self.travel_least, TRIP_TRAVEL)
        if self.travel_most is not None:
            found = _first(found, load > self.travel_most, TRIP_TRAVEL)
        enabled = enable > 0.5
        trip = ops.where(state.trip > 0.0, state.trip, found)
        trip = ops.where(enabled, trip, TRIP_NONE)
        runs = ops.both(enabled, trip <= 0.0)
        ran = state.running > 0.5
        offset = ops.where(ran, state.offset, motor - load)
        velocity = state.velocity + SMOOTHING * ((load - state.position_load) / T - state.velocity)
        after = self.State(ops.where(runs, 1.0, 0.0), trip, motor, load, offset, velocity)
        before = (state.position_motor - offset, state.position_load)
        return after, self.Verdict(runs, ran, motor - offset, load, *before, velocity)


def _first(found: Number, broken: object, code: float) -> Number:
    return ops.where(found > 0.0, found, ops.where(broken, code, TRIP_NONE))

"""The guard of a loop, which handles enable, disable, trips and NaN. It is simulated and exported like the law."""

from collections.abc import Iterator
from typing import Any, NamedTuple, TypeVar

from feeddrive.blocks.signals import Setpoint
from feeddrive.language import ops
from feeddrive.language.block import Block, Number, Rule, choice, parameter
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.language.tree import cases

Memory = TypeVar("Memory")

# codes of `Signals.trip`
TRIP_NONE, TRIP_READING, TRIP_FOLLOWING_ERROR, TRIP_VELOCITY, TRIP_TRAVEL, TRIP_COMMAND = 0.0, 1.0, 2.0, 3.0, 4.0, 5.0
TRIPS = {
    TRIP_READING: "a broken reading or setpoint",
    TRIP_FOLLOWING_ERROR: "the following error",
    TRIP_VELOCITY: "the velocity",
    TRIP_TRAVEL: "the travel",
    TRIP_COMMAND: "a command that is no number",
}  # in words

LEFT_OUT = {
    "checks_setpoint": "a NaN or infinite number in a setpoint trips only when it makes the law's command one",
    "holds": "the loop trips in the first broken sample, and hold_samples is not read",
    "aligns": "the motor's reading goes to the law as it is, with the offset between the encoders",
    "starts_moving": "law and observers start at rest, with a step of the force on an axis that moves at enable",
}  # what happens where a part of the guard is left out

# Of the velocity at enable: a count that toggles at standstill must not look like motion.
SMOOTHING = 1.0 / 32.0
# Of the magnitudes of a setpoint's five numbers in SI, summed: no axis comes near it, not even in its snap.
SETPOINT_LIMIT = 1e12
# N, before the limit: a law with a larger command has overflowed.
COMMAND_LIMIT = 1e18


class Guard(Block):
    """The guard of a loop: it switches to the safe force when a bound is violated, until the loop is disabled.

    It acts in the sample in which the bound is violated.
    A reading that is NaN or beyond `reading_limit` is invalid, and so is a setpoint that contains a NaN, infinite or
    absurdly large number.  For at most `hold_samples` invalid samples in a row, the last command is held.  Law and
    observers then receive an extrapolated reading, which is the last valid one plus the motion in the previous sample;
    the setpoint is extrapolated in the same way.  After that the loop trips.  It trips immediately if a following
    error, a velocity or a position exceeds its bound, if a command is NaN or absurdly large, and if the loop is enabled
    on an invalid reading.

    A trip is latched.  Switching `enable` off clears it; switching it on again resets the law, its filters and
    observers to the present position.  An `enable` that is NaN counts as off.  A loop that does not run, tripped or
    disabled, commands the `safe_force`.  It is 0 on a horizontal axis; on a vertical one it is the force that carries
    the weight.  A vertical axis then stays at rest while the brake closes, and also after the brake has opened, since a
    law starts from the acting force.  When two encoders are read, the motor encoder is aligned to the load encoder at
    enable, so that their offset has no effect.  If the axis moves at enable, law and observers are initialized for a
    moving axis: from the readings of the previous sample, and the observers also from the velocity, which is smoothed
    over about 32 samples while the loop is not running.

        velocity T = travel(k) = travel(k-1) + (x(k) - x(k-1) - travel(k-1)) / 32

    A part that a machine does not need can be left out of the simulation and of every export: a bound by omitting it,
    and `checks_setpoint`, `holds`, `aligns` and `starts_moving` by `false`.  The rest is always present: the loop trips
    on a reading that is NaN or beyond `reading_limit` and on a command that is NaN or absurdly large, a trip is
    latched, and a loop that does not run commands the `safe_force`.

    Every conditional operation first tests `usual`, which is true if all numbers are valid and the loop is enabled and
    running.  A compiler merges all these tests into one branch, so nearly all samples are computed quickly; the
    others take a third longer.
    """

    following_error_limit: Number | None = parameter(
        "m", "largest |setpoint - reading|; absent for none", above=0, default=None
    )
    velocity_limit: Number | None = parameter(
        "m/s", "largest speed of the reading; absent for none", above=0, default=None
    )
    travel_least: Number | None = parameter("m", "lower end of the travel; absent for none", default=None)
    travel_most: Number | None = parameter("m", "upper end of the travel; absent for none", default=None)
    reading_limit: Number = parameter("m", "a reading beyond it counts as broken", above=0, default=1000.0)
    hold_samples: Number = parameter(
        "", "broken readings or setpoints in a row over which the last command is held", least=0, most=1e6, default=1.0
    )
    safe_force: Number = parameter(
        "N", "commanded while the loop does not run: the weight of a hanging axis", default=0
    )
    checks_setpoint: bool = choice(
        "whether a setpoint with a NaN, infinite or absurd number is broken", options=(True, False), default=True
    )
    holds: bool = choice(
        "whether the command is held over `hold_samples` broken samples", options=(True, False), default=True
    )
    aligns: bool = choice(
        "whether the motor's encoder is aligned to the load's at enable", options=(True, False), default=True
    )
    starts_moving: bool = choice(
        "whether law and observers start in motion on an axis that moves", options=(True, False), default=True
    )

    class Prepared(NamedTuple):
        """The sample time in s, and the largest motion per sample in m (empty if there is no velocity limit)."""

        T: Number
        fastest: tuple[Number, ...]

    class State(NamedTuple):
        """The guard's memory of the last sample.

        mode          1 + number of successive invalid samples while the loop runs, 0 if disabled, -code if tripped
        position      last readings of the motor and the load, m; extrapolated if invalid
        offset        offset between the two encoders, m
        travel        motion in the last sample, m; smoothed while the loop is not running
        set_position  last set position, m; extrapolated if invalid
        """

        mode: Number
        position_motor: Number
        position_load: Number
        offset: Number
        travel: Number
        set_position: Number

    class Verdict(NamedTuple):
        """The setpoint and readings passed to the law, and whether the law's command is used.

        usual         true if the loop keeps running, all numbers are valid and no bound is exceeded
        ran, good     true if the loop ran in the last sample; true if readings and setpoint are valid
        before, velocity  readings in m and velocity in m/s in the previous sample, for a start
        """

        usual: object
        ran: object
        good: object
        setpoint: Setpoint
        position_motor: Number
        position_load: Number
        before_motor: Number
        before_load: Number
        velocity: Number

    class Outcome(NamedTuple):
        """The applied and the requested force in N, the trip code, and 1 while the loop runs."""

        applied: Number
        requested: Number
        trip: Number
        running: Number

    def rules(self) -> Iterator[Rule]:
        """Yield the conditions on the ends of the travel."""
        yield from travel_rules("guard", self.travel_least, self.travel_most)

    def left_out(self) -> dict[str, str]:
        """Return a sentence for each part of the guard that is set to `false`, stating the consequence."""
        return {name: then for name, then in LEFT_OUT.items() if not getattr(self, name)}

    def prepare(self, T: Number) -> Prepared:
        """Return the sample time, and the velocity limit converted to the largest motion per sample."""
        return self.Prepared(T, () if self.velocity_limit is None else (self.velocity_limit * T,))

    def sound(self, setpoint: Setpoint, motor: Number, load: Number) -> tuple[Setpoint, Number, Number]:
        """Return a valid setpoint and valid readings to start from: an invalid reading is replaced by 0, an invalid
        setpoint by the position.
        """
        one = motor is load
        load = ops.where(ops.absolute(load) <= self.reading_limit, load, 0.0)
        motor = load if one else ops.where(ops.absolute(motor) <= self.reading_limit, motor, 0.0)
        if self.checks_setpoint:
            setpoint_size = _size(setpoint)
            good_setpoint = setpoint_size <= SETPOINT_LIMIT
            # standstill at the present position: a law that starts there commands no jump
            rest = (load, *(ops.zero(load) for _ in setpoint[1:]))
            setpoint = Setpoint(*(ops.where(good_setpoint, x, y) for x, y in zip(setpoint, rest, strict=True)))
        return setpoint, motor, load

    def start(self, prepared: Prepared, setpoint: Setpoint, motor: Number, load: Number, velocity: Number) -> State:
        """Return the state one sample before the first step: disabled, without a trip, at these readings."""
        travel = velocity * prepared.T
        return self.State(ops.zero(motor), motor, load, motor - load, travel, setpoint.position)

    def step(
        self, prepared: Prepared, state: State, setpoint: Setpoint, motor: Number, load: Number, enable: Number
    ) -> tuple[State, Verdict]:
        """Check a sample before the law runs, in this order: invalid numbers, following error, velocity, travel."""
        one = motor is load  # one encoder: nothing to align
        ran, enabled = state.mode > 0.5, enable > 0.5
        # written so that NaN, which compares as false, is bad
        good_load = ops.absolute(load) <= self.reading_limit
        good_motor = good_load if one else ops.absolute(motor) <= self.reading_limit
        if self.checks_setpoint:
            setpoint_size = _size(setpoint)
            good_setpoint: Any = setpoint_size <= SETPOINT_LIMIT
            good = ops.both(good_load if one else ops.both(good_motor, good_load), good_setpoint)
        else:
            good_setpoint = True
            good = good_load if one else ops.both(good_motor, good_load)
        usual = ops.both(ops.both(good, enabled), ran)

        load = cases((usual, load), (good_load, load), otherwise=self._went_on(state.position_load, state))
        if one:
            motor = load
        else:
            motor = cases((usual, motor), (good_motor, motor), otherwise=self._went_on(state.position_motor, state))
        if self.checks_setpoint:
            setpoint = cases(
                (usual, setpoint), (good_setpoint, setpoint), otherwise=self._set_on(prepared, state, load)
            )
        # first: whatever the readings are, a trip stays until `enable` falls
        latched = [(state.mode < 0.0, state.mode), (good, 1.0)]
        if self.holds:
            latched.append((ops.both(ran, state.mode <= self.hold_samples), state.mode + 1.0))
        # `usual` first, here and below: a compiler then makes one branch of all these selections
        mode = cases((usual, 1.0), (enabled, cases(*latched, otherwise=-TRIP_READING)), otherwise=0.0)
        moved = load - state.position_load
        after = state._replace(mode=mode, position_motor=motor, position_load=load, set_position=setpoint.position)
        after, usual = self._within_bounds(prepared, setpoint, moved, after, usual)
        offset = state.offset
        if self.aligns and not one:
            # while the loop does not run the offset is measured, so that it is right when the loop is enabled
            offset = cases((usual, offset), (ran, offset), otherwise=motor - load)
        travel = moved
        if self.starts_moving:
            travel = cases((usual, moved), (ran, moved), otherwise=state.travel + SMOOTHING * (moved - state.travel))
        after = after._replace(offset=offset, travel=travel)
        aligned, before, before_load, velocity = load, state.position_load, state.position_load, ops.zero(load)
        if not one:
            aligned = motor - offset if self.aligns else motor
            before = state.position_motor - offset if self.aligns else state.position_motor
        if self.starts_moving:
            velocity = travel / prepared.T
        else:
            before, before_load = aligned, load
        return after, self.Verdict(usual, ran, good, setpoint, aligned, load, before, before_load, velocity)

    def _went_on(self, last: Number, state: State) -> Number:
        """Return the substitute for an invalid reading: the extrapolated one, or the last one if `holds` is false."""
        return last + state.travel if self.holds else last

    def _set_on(self, prepared: Prepared, state: State, load: Number) -> tuple[Number, ...]:
        """Return the substitute for an invalid setpoint: the extrapolated one, or the present position if `holds` is
        false.
        """
        if not self.holds:
            return load, 0.0, 0.0, 0.0, 0.0
        return state.set_position + state.travel, state.travel / prepared.T, 0.0, 0.0, 0.0

    def _within_bounds(
        self, prepared: Prepared, setpoint: Setpoint, moved: Number, state: State, usual: object
    ) -> tuple[State, object]:
        """Return the state of this sample and `usual` after checking all bounds that are specified.

        A condition that needs memory keeps it in the state: `state._replace(mode=..., memory=...)`. Each condition uses
        different local names, which also appear in exports.
        """
        load = state.position_load
        if self.following_error_limit is not None:
            following_error = setpoint.position - load
            lags = ops.absolute(following_error) > self.following_error_limit
            mode_at_lag, usual_at_lag = _tripped(TRIP_FOLLOWING_ERROR, lags, state.mode, usual)
            state, usual = state._replace(mode=mode_at_lag), usual_at_lag
        if prepared.fastest:
            too_fast = ops.absolute(moved) > prepared.fastest[0]
            mode_at_speed, usual_at_speed = _tripped(TRIP_VELOCITY, too_fast, state.mode, usual)
            state, usual = state._replace(mode=mode_at_speed), usual_at_speed
        if self.travel_least is not None:
            below = load < self.travel_least
            mode_above_least, usual_above_least = _tripped(TRIP_TRAVEL, below, state.mode, usual)
            state, usual = state._replace(mode=mode_above_least), usual_above_least
        if self.travel_most is not None:
            above = load > self.travel_most
            mode_below_most, usual_below_most = _tripped(TRIP_TRAVEL, above, state.mode, usual)
            state, usual = state._replace(mode=mode_below_most), usual_below_most
        return state, usual

    def live(self, verdict: Verdict, memory: Memory, fresh: Memory) -> Memory:
        """Return the state with which the law continues: a new one if the loop did not run."""
        return cases((verdict.usual, memory), (verdict.ran, memory), otherwise=fresh)

    def command(
        self, after: State, verdict: Verdict, last: Number, applied: Number, requested: Number
    ) -> tuple[State, Outcome]:
        """Return the state, forces and trip code after the law has run; `last` is the last command in N."""
        # a NaN fails the comparison
        sound = ops.absolute(requested) <= COMMAND_LIMIT
        usual_command = ops.both(verdict.usual, sound)
        next_mode = cases(
            (usual_command, 1.0), (ops.both(after.mode > 0.5, ops.no(sound)), -TRIP_COMMAND), otherwise=after.mode
        )
        runs = next_mode > 0.5
        fresh = applied, requested
        applied, requested = cases(
            (usual_command, fresh),
            # after a broken sample the law has computed with extrapolated numbers: its command is not used
            (runs, cases((verdict.good, fresh), otherwise=(last, last)) if self.holds else fresh),
            otherwise=(self.safe_force, self.safe_force),
        )
        trip = cases((usual_command, TRIP_NONE), (next_mode < 0.0, -next_mode), otherwise=TRIP_NONE)
        running = cases((usual_command, 1.0), (runs, 1.0), otherwise=0.0)
        return after._replace(mode=next_mode), self.Outcome(applied, requested, trip, running)


def _tripped(code: float, beyond: object, mode: Number, usual: object) -> tuple[Number, object]:
    """Return `mode` and `usual` after checking one bound: if `beyond` is true, a running loop trips with this code."""
    return ops.where(ops.both(mode > 0.5, beyond), -code, mode), ops.both(usual, ops.no(beyond))


def _size(setpoint: Setpoint) -> Number:
    """Return the sum of the magnitudes of a setpoint's five numbers, which is NaN or too large if any of them is."""
    size_x, size_v, size_a, size_j, size_s = (ops.absolute(component) for component in setpoint)
    return size_x + size_v + size_a + size_j + size_s


def travel_rules(of: str, least: Number | None, most: Number | None) -> Iterator[Rule]:
    """Yield the condition that the lower end `least` (m) of a travel is below its upper end `most`; `of` names the
    guard or limits in messages.
    """
    if least is not None and most is not None:
        yield Rule(
            least < most,
            "travel_least is below travel_most",
            lambda: Text(
                f"{of}.travel_least = {Quantity(least, 'm'):6 SI} must be < {of}.travel_most = "
                f"{Quantity(most, 'm'):6 SI}: between them the axis may move; leave one out for a travel without that "
                "end"
            ),
        )

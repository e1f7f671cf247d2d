"""The safety monitor of a motion over a bus: it ends the motion, and trusts neither the drive nor the player.

`Monitor.step` is a pure function of plain values, one call per cycle: the target that was sent, the raw actual values,
statusword and mode, or None for a frame that did not come, the time since the last cycle in cycles, and a person's
request to stop.  It shares no state with the client, the player or the drive, and has neither bus nor clock.

    c, T     one increment, m; cycle time, s
    x, v, F  actual position, velocity (0x606C) and force; r, w  the target position and velocity that they answer
    u        velocity from positions: (x - x_n)/(n T) over n = `lost_frames` + 2 answers;  U over R = RESPONSE/T
    E, M     limits.following_error, limits.largest_mass
    a        limits.quick_stop_deceleration, with which the axis brakes
    N        reaction: lag + lost_frames + 2 cycles, the longest time until the braking acts

Checks, in this order; the first that fails is the fault:

    stop           a person: Ctrl-C, a key, the loss of the terminal, or whatever the caller passes as `stop`
    stop_input     a person at an input of the drive: its bit of 0x60FD has the level at which it stops
    frames         `lost_frames` cycles in a row without an answer
    drive, mode    statusword other than 'operation enabled'; 0x6061 other than the mode for more than `lag` cycles
    jump           |x - x_1 - u_1 t| > A t (t + n T) + JUMP c: no motion within the accelerations A gets there in the
                   time t since the position last changed.  Without limits.acceleration: |x - x_1| > limits.velocity t
                   + JUMP c
    runaway        the following error exceeds 3/4 E, which no healthy drive reaches (see `watch`), or E; it grows, the
                   axis moves away from its target, by 0x606C as well, and either the force has the sign of the motion
                   or the speed grows, for 2 cycles.  cst: after a push beyond limits.breakaway_force for RESPONSE (see
                   `watch`), an axis must not go against the force faster than it did: friction of any kind would slow
                   it down, too.  Under a control in the master: as in csp, since elastic parts may swing against its
                   force.  A quick stop of the drive would use the same wrong sign
    travel         |x - x_start| + s N T + s²/(2 a) > limits.travel, with s the outward speed, the largest of v, u and
                   that of the last target, and from where the drive is led, if that is farther: in csp the last
                   target, in csv x + the following error.  The axis must be able to stop within the limit.
                   limits.position_least and _most likewise
    velocity       |v| > limits.velocity; without 0x606C the difference of the positions
    force, energy  |F| > limits.force + NOISE thousandths of the rated torque; M v²/2 > limits.energy, if both are
                   stated
    following      csp: max(|r - x|, |0x60F4|) > E.  csv: |Σ (w T - Δx)| > E, a leaky sum over 10 RESPONSE.  cst and
                   csv under a control in the master: |r - x| > E
    acceleration   (U - U_R)/(R T) > limits.acceleration plus rounding and noise of the positions, JUMP c/(R T)², if
                   stated
    and the checks of `watch`: standstill, frozen values, velocity against positions

The reaction depends on what the fault leaves credible (`REACTIONS`): a braking profile, then disable (`Braking`); the
drive's quick stop; or force off.  While an axis brakes, `braking=True` leaves frames, drive and mode, and adds a speed
that grows although the axis brakes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from feeddrive.bus import watch
from feeddrive.bus.cia402 import MODES, PowerState, state_of
from feeddrive.bus.drive_file import BusDrive
from feeddrive.bus.watch import MEMORY, SPARE, USED, Answer, Fault, Target, Watch
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text

# two counts of noise at either end, rounding, and as much again in the velocity that continues the motion
JUMP = 10  # counts by which a position may differ from where its motion leads
# noise of a torque that the drive itself keeps at its limit, 0x6072
NOISE = 10  # thousandths of the rated torque by which 0x6077 may exceed limits.force
AWAY = 2  # cycles in a row in which the error grows: one may be noise
# a reported velocity may be some ms older than the positions
LIKE = 1.5  # ratio of the mean reported velocity and that of the positions up to which both are believed
# a speed that is known to a count in a window, and a drive that begins to brake a window late
GROWN = 1.1  # of the speed at which the braking began

RESTING = 0.1  # s for which an axis is watched once its drive is off: a brake that slips lets it move

BRAKE, QUICK_STOP, OFF = "brake", "quick stop", "off"
# a ramp of ours needs credible values and a drive that obeys; a quick stop needs a drive whose own loop is sound
REACTIONS = {
    "frames": QUICK_STOP,
    "drive": QUICK_STOP,
    "mode": QUICK_STOP,
    "standstill": QUICK_STOP,
    "velocity_frozen": QUICK_STOP,
    "velocity_contradicts": QUICK_STOP,
    "jump": QUICK_STOP,
    "runaway": OFF,
    "braking": OFF,
}


def reaction_to(fault: Fault) -> str:
    """Return the first reaction to a fault: `BRAKE`, `QUICK_STOP` or `OFF`."""
    return REACTIONS.get(fault.kind, BRAKE)


class Skew(NamedTuple):
    """The check of the two drives of a gantry: the difference of their positions stays near that of the free beam.

        |x1 - x2 - free| > most        fault, and both brake

    free  difference of the two counts at which the beam is free of force, m
    most  limits.skew, m

    Actual values count, also those of a wanted twist.  It sees no twist of a beam whose drives count against each
    other.
    """

    free: float
    most: float

    def fault(self, first: float, second: float, cycle: int) -> Fault | None:
        """Return the fault of a cycle with these positions of both drives, m; None if there is none."""
        twist = first - second - self.free
        if abs(twist) <= self.most:
            return None
        said = Text(
            f"the two drives are {Quantity(twist, 'm'):SI} apart from where the beam is free of force, more than "
            f"limits.skew = {Quantity(self.most, 'm'):SI}"
        )
        return Fault("skew", abs(twist), self.most, "m", cycle, said)


class Cycle(NamedTuple):
    """One cycle as the monitor sees it; `answer` is None if the frame was lost, and statusword and mode are not used.

    elapsed  time since the last cycle began, in cycles
    stop     why a person or a program asks for a stop; empty: nobody does
    inputs   the digital inputs of the drive (0x60FD), None if they are not told
    """

    target: Target
    answer: Answer | None
    statusword: int
    mode: int
    elapsed: float = 1.0
    stop: str = ""
    inputs: int | None = None


class Seen(NamedTuple):
    """A position (m) and a velocity (m/s, None if none is reported), and the time at which they were reported, s."""

    time: float
    position: float
    velocity: float | None


class State(NamedTuple):
    """The state of the monitor after a cycle.

    watch      the state of the checks of `watch`
    time       time since the motion began, counted in cycles, s
    seen       the last positions, oldest first
    changed    the last position that differed from the one before it, and its velocity, m/s
    lost       frames lost in a row
    strange    answers in a row with another mode
    target     the last target, and its speed: that of the positions in csp, 0 in cst, m/s
    error      following error, m: r - x in csp, the leaky sum in csv
    away       cycles in a row in which the error grew as in a runaway
    pushed     direction of a push of cst, its duration (s), and the lowest speed along it (m/s, at most 0)
    at_most    speed above which a braking axis is not braking, m/s
    """

    watch: watch.State
    time: float
    seen: tuple[Seen, ...]
    changed: tuple[Seen, float | None]
    target: tuple[float, float]
    lost: int = 0
    strange: int = 0
    error: float = 0.0
    away: int = 0
    pushed: tuple[float, float, float | None] = (0.0, 0.0, None)
    at_most: float = math.inf


class Monitor:
    """The safety monitor of one drive within the limits of its drive file; it holds no state."""

    def __init__(self, drive: BusDrive, *, follows: bool = False) -> None:
        """Set up the monitor; `follows`: a control in the master makes the force of cst, or the velocity of csv, from
        the target position.
        """
        self.drive, self.limits, self._follows = drive, drive.limits, follows
        self._watch = Watch(drive, follows=follows and drive.mode == "cst")
        self._count = drive.scaling.metre
        self._window = drive.lost_frames + SPARE
        self._mode = MODES[drive.mode]
        self._response = max(watch.RESPONSE, self._window * drive.cycle_time)
        self._long = math.ceil(self._response / drive.cycle_time - 1e-9)
        self._memory = MEMORY * self._response
        self._reaction = reaction_time(drive)

    def begin(self, answer: Answer) -> State:
        """Return the initial state, for an axis that holds its position."""
        here = Seen(0.0, answer.position, answer.velocity)
        return State(self._watch.begin(answer), 0.0, (here,), (here, 0.0), (answer.position, 0.0))

    def step(self, state: State, cycle: Cycle, *, braking: bool = False) -> tuple[State, Fault | None]:
        """Check one cycle; return the new state and the first fault, or None."""
        drive, number, answer = self.drive, state.watch.cycle, cycle.answer
        acting = (*state.watch.sent, cycle.target)[0]
        speeds = {"csp": (cycle.target.position - state.target[0]) / drive.cycle_time, "csv": cycle.target.velocity}
        target = cycle.target.position, speeds.get(drive.mode, 0.0)
        # what happened in a cycle that began late is unknown: the history starts again
        late = cycle.elapsed > 2.0
        watched, fault = self._watch.step(state.watch, cycle.target, answer, late=late)
        time = state.time + drive.cycle_time
        if answer is None:
            asked = acting.velocity * drive.cycle_time if drive.mode == "csv" else 0.0
            # which forces act is unknown, as the target may be lost as well: a push begins anew
            nothing = (0.0, 0.0, None)
            after = state._replace(
                watch=watched, time=time, target=target, lost=state.lost + 1, error=state.error + asked, pushed=nothing
            )
            return after, self._stop(cycle, number) or self._silent(after.lost, number)
        here = Seen(time, answer.position, answer.velocity)
        seen = (here,) if late else (*state.seen, here)[-2 * self._long - 1 :]
        speed = _speed(seen, self._window)
        error = self._error(state, acting, answer, late=late)
        strange = 0 if cycle.mode == self._mode else state.strange + 1
        slow = _speed(seen, self._long)
        pushed = self._pushed(state, watched.push, slow)
        grows = abs(error) > abs(state.error) and self._flees(error, answer, speed, seen)
        away = state.away + 1 if grows and abs(error) > USED * self.limits.following_error else 0
        after = state._replace(
            watch=watched,
            time=time,
            seen=seen,
            changed=(here, speed) if answer.position != state.seen[-1].position or late else state.changed,
            target=target,
            lost=0,
            strange=strange,
            error=error,
            away=away,
            pushed=pushed,
        )
        first = (
            self._stop(cycle, number)
            # which stays as it is while the axis brakes
            or (None if braking else self._pressed(cycle, number))
            or self._left(cycle, number)
            or (self._other_mode(cycle.mode, number) if strange > drive.lag + 1 else None)
        )
        if braking:
            return after, first or self._grown(state, speed, number)
        return after, (
            first
            or (None if late else self._jumped(state, here, number))
            or self._runaway(after, answer, speed, slow, number)
            or self._beyond(after, answer, state, speed, number)
            or self._accelerated(seen, self._renewal(watched, answer.velocity), number)
            or fault
        )

    def brakes(self, state: State) -> State:
        """Return the state with which an axis begins to brake."""
        speed = abs(_speed(state.seen, self._window) or 0.0)
        # a count in each of two readings, and the acceleration that is still under way
        resolved = 2.0 * self._count / (self._window * self.drive.cycle_time)
        under_way = self.limits.quick_stop_deceleration * self._reaction
        return state._replace(at_most=GROWN * speed + resolved + under_way, away=0)

    def rests(self, state: State) -> Fault | None:
        """Return a fault if an axis that was braked still moves."""
        speed = abs(_speed(state.seen, self._window) or 0.0)
        # half of it, as it would otherwise pass for an axis whose brake slips
        bound = 0.5 * self.limits.following_error / RESTING
        if speed <= bound:
            return None
        message = Text(
            f"the axis still moves at {Quantity(speed, 'm/s'):SI} at the end of its braking ramp, more than "
            f"{Quantity(bound, 'm/s'):SI}"
        )
        return Fault("braking", speed, bound, "m/s", state.watch.cycle, message)

    def _stop(self, cycle: Cycle, number: int) -> Fault | None:
        return Fault("stop", 1.0, 0.0, "", number, cycle.stop) if cycle.stop else None

    def _pressed(self, cycle: Cycle, number: int) -> Fault | None:
        """Return a fault if the stop input of the drive asks for a stop."""
        drive = self.drive
        if not drive.asks_stop(cycle.inputs):
            return None
        message = f"stopped by the stop input of the drive (bit {drive.stop_input} of 0x60FD is {drive.stop_level})"
        return Fault("stop_input", float(drive.stop_level), float(1 - drive.stop_level), "", number, message)

    def _silent(self, lost: int, number: int) -> Fault | None:
        """Return a fault if too many frames in a row were lost."""
        most = self.drive.lost_frames
        if lost < most:
            return None
        return Fault("frames", float(lost), float(most), "frames", number, f"{lost} frames in a row were lost")

    def _left(self, cycle: Cycle, number: int) -> Fault | None:
        """Return a fault if the drive left operation."""
        state = state_of(cycle.statusword)
        if state is PowerState.ENABLED:
            return None
        at = "an unknown state" if state is None else f"'{state.words}'"
        word = float(cycle.statusword)
        message = f"the drive left operation by itself in cycle {number} and is in {at}"
        return Fault("drive", word, float(PowerState.ENABLED.status), "", number, message)

    def _other_mode(self, mode: int, number: int) -> Fault | None:
        message = (
            f"the drive runs mode {mode} (0x6061) in cycle {number}, and not {self._mode} ({self.drive.mode}): another "
            "master, or a person at the drive, changed it"
        )
        return Fault("mode", float(mode), float(self._mode), "", number, message)

    def _error(self, state: State, acting: Target, answer: Answer, *, late: bool) -> float:
        """Return the following error, m: of the position in csp, of the travel commanded lately in csv."""
        if self.drive.mode == "csp" or self._follows:
            return acting.position - answer.position
        if self.drive.mode == "cst":
            return 0.0
        last, dt = state.watch.answer, state.watch.silent + self.drive.cycle_time
        if late:
            return state.error
        kept = max(0.0, 1.0 - dt / self._memory)
        # what was commanded in lost cycles is in the error already
        return kept * state.error + acting.velocity * self.drive.cycle_time - (answer.position - last.position)

    def _pushed(self, state: State, push: watch.Push, speed: float | None) -> tuple[float, float, float | None]:
        """Return direction, duration (s) and reference velocity (m/s) of a push, or (0, 0, None)."""
        least = self.limits.breakaway_force
        # under a control in the master the following error tells a runaway, and elastic parts may swing against a force
        if self.drive.mode != "cst" or self._follows or least is None or speed is None or not push.forces:
            return 0.0, 0.0, None
        sign, time, begun = state.pushed
        now = math.copysign(1.0, push.forces[-1])
        # the last RESPONSE, as the force may act so late
        if min(now * force for force in push.forces) <= least:
            return 0.0, 0.0, None
        if now != sign:
            return now, 0.0, None
        time += self.drive.cycle_time
        # a reported velocity may be as late as the force
        if time < self._response:
            return sign, time, None
        # along the force friction may slow the axis; against it force and friction have one direction
        along = min(0.0, sign * speed)
        return sign, time, along if begun is None else max(begun, along)

    def _flees(self, error: float, answer: Answer, speed: float | None, seen: tuple[Seen, ...]) -> bool:
        """Return True if the axis moves away from its target, driven by its force or faster and faster."""
        if speed is None or error * speed >= 0.0 or not _agree(seen, self._window):
            return False
        before = _speed(seen[: len(seen) - 1], self._window)
        # a count in the window may be noise
        least = self._count / (self._window * self.drive.cycle_time)
        return answer.force * speed > 0.0 or (before is not None and abs(speed) - abs(before) > least)

    def _runaway(
        self, state: State, answer: Answer, speed: float | None, slow: float | None, number: int
    ) -> Fault | None:
        most, error = self.limits.following_error, state.error
        if state.away >= AWAY or (state.away and abs(error) > most):
            bound = USED * most
            message = Text(
                f"the axis runs away: in cycle {number} it moves at {Quantity(speed or 0.0, 'm/s'):SI} from its target,"
                f" which is {Quantity(error, 'm'):SI} off, under a force of {Quantity(answer.force, 'N')}: a sign is "
                "wrong, or a load drives it"
            )
            return Fault("runaway", abs(error), bound, "m", number, message)
        sign, _, begun = state.pushed
        if begun is None or not slow or not _agree(state.seen, self._long):
            return None
        # a drive that renews its values every so many cycles: one renewal more or less in either window
        renewal = self._renewal(state.watch, answer.velocity)
        spread = (renewal - 1) / self._long * (abs(slow) + abs(begun))
        bound = JUMP * self._count / (self._long * self.drive.cycle_time) + spread
        change = begun - sign * slow
        if change <= bound:
            return None
        message = Text(
            f"the axis runs away: in cycle {number} it moves at {Quantity(slow, 'm/s'):SI}, faster by "
            f"{Quantity(change, 'm/s'):SI}, against a force beyond limits.breakaway_force = "
            f"{Quantity(self.limits.breakaway_force or 0.0, 'N')}: a sign is wrong, or a load drives it"
        )
        return Fault("runaway", change, bound, "m/s", number, message)

    def _grown(self, state: State, speed: float | None, number: int) -> Fault | None:
        """Return a fault if a braking axis is faster than when the braking began."""
        if speed is None or abs(speed) <= state.at_most:
            return None
        message = Text(
            f"the axis does not brake: in cycle {number} it moves at {Quantity(abs(speed), 'm/s'):SI}, more than "
            f"{Quantity(state.at_most, 'm/s'):SI}"
        )
        return Fault("braking", abs(speed), state.at_most, "m/s", number, message)

    def _beyond(
        self, state: State, answer: Answer, before: State, difference: float | None, number: int
    ) -> Fault | None:
        """Return a fault if a limit of the drive file is exceeded, or can no longer be kept by braking."""
        limits, position = self.limits, answer.position
        start, silent = before.watch.start, before.watch.silent + self.drive.cycle_time
        speed = answer.velocity
        if speed is None:
            speed = (position - before.watch.answer.position) / silent
        # negated comparisons, so that NaN is a fault, too
        outward = (speed, speed if difference is None else difference, state.target[1])
        # a drive goes on to its target, and makes up for the travel that it lags behind its set velocity
        led = state.target[0] if self.drive.mode == "csp" else position + state.error
        for way in (-1.0, 1.0):
            ahead = self.braking_distance(max(0.0, *(way * each for each in outward)))
            far = max(way * (position - start), way * (led - start))
            if not far + ahead <= limits.travel:
                return _exceeded("travel", far + ahead, limits.travel, "m", number, _to_brake(ahead))
        if not abs(speed) <= limits.velocity:
            return _exceeded("velocity", abs(speed), limits.velocity, "m/s", number)
        if not abs(answer.force) <= limits.force + NOISE * self.drive.scaling.newton:
            return _exceeded("force", abs(answer.force), limits.force, "N", number)
        if limits.energy is not None and limits.largest_mass is not None:
            energy = 0.5 * limits.largest_mass * speed * speed
            if energy > limits.energy:
                return _exceeded("energy", energy, limits.energy, "J", number)
        error = abs(state.error)
        if self.drive.mode == "csp":
            told = answer.following_error
            error = max(error, abs(told or 0.0))
            says = (
                "the drive has no 0x60F4"
                if told is None
                else Text(f"the drive says {Quantity(told, 'm'):SI} in 0x60F4")
            )
            which = f" (set position - 0x6064; {says})" if error == abs(state.error) else " (0x60F4)"
        elif self._follows:
            which = " (set position - 0x6064)"
        else:
            which = " (travel that the set velocity asked for, less that of 0x6064)"
        if not error <= limits.following_error:
            return _exceeded("following_error", error, limits.following_error, "m", number, which)
        for key, bound, way in (
            ("position_least", limits.position_least, -1.0),
            ("position_most", limits.position_most, 1.0),
        ):
            if bound is None:
                continue
            ahead = self.braking_distance(max(0.0, *(way * each for each in outward)))
            if max(way * (position - bound), way * (led - bound)) + ahead > 0.0:
                message = Text(
                    f"position = {Quantity(position, 'm'):6 SI}{_to_brake(ahead)} in cycle {number} left "
                    f"limits.{key} = {Quantity(bound, 'm'):6 SI}"
                )
                return Fault("position", position, bound, "m", number, message)
        return None

    def braking_distance(self, speed: float) -> float:
        """Return the travel from a speed (m/s) to standstill, m: the reaction, and v²/(2 a)."""
        return braking_distance(self.drive, speed)

    def _renewal(self, watched: watch.State, velocity: float | None) -> int:
        """Return the cycles after which values are new, at most: the watch sees them only beside a velocity."""
        return self._window if velocity is None else watched.renewal

    def _accelerated(self, seen: tuple[Seen, ...], renewal: int, number: int) -> Fault | None:
        most, n = self.limits.acceleration, self._long
        if most is None or len(seen) <= 2 * n:
            return None
        now, before = _speed(seen, n), _speed(seen[:-n], n)
        assert now is not None
        assert before is not None
        span = 0.5 * (seen[-1].time - seen[-1 - 2 * n].time)
        spread = (renewal - 1) / n * (abs(now) + abs(before)) / span
        value, bound = abs(now - before) / span, most + JUMP * self._count / span**2 + spread
        return _exceeded("acceleration", value, bound, "m/s2", number) if not value <= bound else None

    def _jumped(self, state: State, here: Seen, number: int) -> Fault | None:
        """Return a fault if a position cannot be that of the motion that led to it."""
        last, speed = state.changed
        if here.position == state.seen[-1].position:
            return None
        # the position may have been renewed after its last report; a drive renews its values within the window
        time = here.time - max(last.time, here.time - self._window * self.drive.cycle_time)
        most = self.limits.acceleration
        if most is None and here.velocity is None:
            # the speed is that of the positions then, and its limit is checked
            return None
        moved = here.position - last.position
        if most is None or speed is None:
            bound, why = self.limits.velocity * time, "limits.velocity"
        else:
            moved -= speed * time
            spread = (self._renewal(state.watch, here.velocity) - 1) * self.drive.cycle_time * abs(speed)
            bound = most * time * (time + self._window * self.drive.cycle_time) + spread
            why = "limits.acceleration"
        bound += JUMP * self._count
        if abs(moved) <= bound:
            return None
        message = Text(
            f"the position (0x6064) jumps by {Quantity(here.position - last.position, 'm'):SI} in cycle {number}, "
            f"{Quantity(abs(moved), 'm'):SI} from where its motion leads, and {why} allows "
            f"{Quantity(bound, 'm'):SI} in {Quantity(time, 's'):SI}: the encoder or its cable fails"
        )
        return Fault("jump", abs(moved), bound, "m", number, message)


def braking_distance(drive: BusDrive, speed: float) -> float:
    """Return the travel from a speed (m/s) to standstill, m: lag + lost_frames + 2 cycles of reaction, and v²/(2 a)."""
    return speed * reaction_time(drive) + 0.5 * speed * speed / drive.limits.quick_stop_deceleration


def reaction_time(drive: BusDrive) -> float:
    """Return the longest time until a reaction acts, s: the answer is `lag` cycles old, and the frames that carry the
    reaction may be lost.
    """
    return (drive.lag + drive.lost_frames + SPARE) * drive.cycle_time


def _agree(seen: tuple[Seen, ...], n: int) -> bool:
    """Return True if positions and reported velocities of the last n answers agree, or no velocity is reported.

    Otherwise it is the readings that are wrong, and the drive may be sound.
    """
    told = [each.velocity for each in seen[-n:] if each.velocity is not None]
    if len(told) < n:
        return True
    speed, mean = _speed(seen, n), sum(told) / n
    return not speed or 1.0 / LIKE < mean / speed < LIKE


def _speed(seen: tuple[Seen, ...], n: int) -> float | None:
    """Return the mean velocity of the last n answers, m/s; None if there are not so many."""
    if len(seen) <= n:
        return None
    then, now = seen[-1 - n], seen[-1]
    return (now.position - then.position) / (now.time - then.time)


def _to_brake(ahead: float) -> str:
    return Text(f" ({Quantity(ahead, 'm'):SI} of it to brake)") if ahead > 0.0 else ""


def _exceeded(key: str, value: float, bound: float, unit: str, cycle: int, which: str = "") -> Fault:
    """Return the fault of an exceeded limit of the drive file; `which` names the source of the value."""
    message = Text(
        f"{key} = {Quantity(value, unit):SI}{which} in cycle {cycle} exceeded limits.{key} = {Quantity(bound, unit):SI}"
    )
    return Fault(key, value, bound, unit, cycle, message)


class Braking(NamedTuple):
    """A braking profile: what is commanded next, and how many cycles are left of it.

    position, velocity  set position (m) and velocity (m/s), which ramp down
    force               braking force of cst, N
    held                force of cst that carries the weight of the axis meanwhile, N
    """

    position: float
    velocity: float
    force: float
    left: int
    held: float = 0.0


SETTLING = 0.2  # s for which the end of the ramp is held: six time constants of a slow position loop (30 1/s)
# the force acts on a velocity that is lag + 1 cycles old: four times that keeps a lighter axis from being reversed
SOFT = 4.0  # of the reaction's cycles, over which the last of the speed is braked


def begin_braking(drive: BusDrive, last: Target, before: Target, velocity: float, held: float = 0.0) -> Braking:
    """Return the braking profile from the last two targets; in cst from the measured velocity, m/s.

    `held` is the force of cst under which the axis rested before the motion, N.
    """
    limits, T = drive.limits, drive.cycle_time
    speed = {
        # with the excitation, which the set velocity of the profile does not hold
        "csp": (last.position - before.position) / T,
        "csv": last.velocity,
        "cst": velocity,
    }[drive.mode]
    speed = math.copysign(min(abs(speed), limits.velocity), speed)
    left = math.ceil(abs(speed) / (limits.quick_stop_deceleration * T)) + round(SETTLING / T)
    return Braking(last.position, speed, held, left, held)


def brake(drive: BusDrive, braking: Braking, velocity: float) -> Braking:
    """Return the setpoints of the next cycle, with the deceleration limits.quick_stop_deceleration.

    csp  the set position goes on along a ramp of its velocity;  csv  the set velocity is that ramp
    cst  a force against the measured velocity:  min(M a, M |v|/τ),  τ = SOFT (lag + 1) T, beside the force that held
         the axis before, both within limits.force.  Friction is not subtracted: a smaller true mass or more friction
         brakes harder, by a bounded force
    """
    limits, T = drive.limits, drive.cycle_time
    a = limits.quick_stop_deceleration
    if drive.mode == "cst":
        # once it has turned, the elastic parts may swing: no force then drives them
        going = braking.velocity if braking.velocity * velocity > 0.0 else 0.0
        soft = abs(velocity) / (SOFT * (drive.lag + 1) * T)
        mass = limits.largest_mass or 0.0
        force = braking.held - (math.copysign(mass * min(a, soft), going) if going else 0.0)
        within = max(-limits.force, min(limits.force, force))
        return Braking(braking.position, going, within, braking.left - 1, braking.held)
    after = math.copysign(max(0.0, abs(braking.velocity) - a * T), braking.velocity)
    position = braking.position + 0.5 * (braking.velocity + after) * T
    return Braking(position, after, 0.0, braking.left - 1, braking.held)

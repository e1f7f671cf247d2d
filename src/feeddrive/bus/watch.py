"""The watch over a drive in motion, which believes nothing that the drive reports about itself.

`Watch.step` is pure: state, targets and actual values of one cycle give the next state and a fault, or None.  It opens
no bus, reads no clock, and does not know how the targets were made.

    c        one increment, m
    r, w, F  target position, velocity and force that an answer belongs to: those sent `lag` cycles before it
    x, v     actual position (0x6064) and velocity (0x606C)
    E, M, B  limits.following_error, limits.largest_mass, limits.breakaway_force

Limits.  |x - x_start|, |v|, actual force and x are kept within the drive file's limits.  In csp the following error is

    e = max(|r - x|, |0x60F4|)                                                        fault if e > E

The own count r - x holds whatever the drive reports as 0x60F4, which may be 0 for ever.

Standstill.  The anchor a is the reading of a cycle j, and moves to x as soon as |x - a| >= 2 c.  Until then the axis
has shown less than two counts.  An axis that has moved by 4 c has shown two counts: the rounding of two readings takes
one, noise of half a count in both another.  Three bounds say when a live axis must have moved by 4 c.

csp.  Let L = r - a be the lead of the target, and L_j that of cycle j.  A live drive moves before the target is E/2
from it; one that already lags by L_j moves before half of what is left to E is used up:

    |L| > (E + max(0, L_j sgn L))/2  and  |L - L_j| >= 4 c                            fault

The bound is less than E wherever |L_j| < E, so that it acts before the following error does.  No healthy drive is
stopped whose lost motion is less than E/2: a stuck axis stands until its loop pushes harder than friction, which takes
a lead of lost motion and no time, so that dwell, creep and any slow setpoint are free.  While an axis moves with a
lag, its target advances about as far as the axis itself, a few counts.

csv.  No position is held, so the way S that the set velocity has asked for since cycle j takes the place of the lead:

    S = Σ w T,    |S| > max(E/2, 4 c)                                                 fault

cst.  Where the force exceeds B, the net force on the axis has its sign, and as its mass is at most M

    sgn(F) x'' >= (|F| - B)/M = a(t) > 0

Integrated over a push of one sign that began τ ago, with q = ∫∫ a, the axis has moved by at least v0 τ + q.  The
velocity v0 at its beginning is not known.  An axis that stayed within 4 c throughout had one with

    -(4c + q(τ'))/τ' < v0 < (4c - q(τ'))/τ'    for all τ' <= τ

The right side falls with τ'.  If it falls below the largest left side, no v0 is left and a live axis must have moved;
under a constant push that is the case after τ = (1 + √2) √(8 c/a).  RESPONSE, 10 ms or `lost_frames` + 2 cycles if
that is longer, is then waited for current loops, filters and elastic parts: a fault, unless two counts were shown.

Velocity.  It is compared with the differences of the positions, in two ways:

1. The same values, all of them, in `lost_frames` + 2 answers after the first, with |v| T summed over them (at most 10
   RESPONSE) of 2 c or more: the drive says that it moves, and stands in every bit.  A fault, which finds values frozen
   in motion before any bound above.  A healthy drive that stops dead changes its velocity, its force or both.
2. A leaky sum of v T - Δx, with the time constant 10 RESPONSE.  A filter or a delay in v of at most RESPONSE leaves
   no more than RESPONSE times the largest speed of either in the same memory, and a wrong factor of 10 % as much:

       |Σ (v T - Δx)| > RESPONSE max(|v|, |Δx|/T) + 4 c                               fault

   The sum begins anew after a cycle that began more than a cycle late, as the axis went on for an unknown time.

What it cannot see: a force (0x6077) or second encoder (0x60E4) that is wrong; noise of two counts over a dead encoder,
until the following error tells; a dead drive at rest in csp, whose target does not move, or in cst below B.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from feeddrive.bus.drive_file import BusDrive

SHOWN = 2  # counts by which a reading must change to be a sign of life: one may be noise
SURE = 4  # counts of true motion that show two: rounding of two readings takes one, noise in them another
USED = 0.5  # share of what is left to the following error's limit, of which a live drive uses less before it moves
RESPONSE = 0.01  # s that current loop, filters and elastic parts may take
MEMORY = 10.0  # responses over which velocity and positions are compared


class Target(NamedTuple):
    """What is commanded in a cycle; which of it the drive obeys depends on the mode."""

    position: float  # m
    velocity: float  # m/s
    force: float  # N


class Answer(NamedTuple):
    """Actual values of a cycle; None where the drive has no such object."""

    position: float  # m
    velocity: float | None  # m/s
    force: float  # N
    following_error: float | None = None  # m
    second: float | None = None  # m


class Fault(NamedTuple):
    """Why a motion must end: what was seen, its value and bound in one unit, the cycle, and a sentence with them."""

    kind: str
    value: float
    bound: float
    unit: str
    cycle: int
    message: str


class Anchor(NamedTuple):
    """A reading and its cycle, the lead of the target in it (csp, m), and the way asked for since (csv, m)."""

    position: float
    cycle: int
    lead: float
    asked: float = 0.0


class Push(NamedTuple):
    """A force beyond breakaway in one direction: its time (s), and speed (m/s) and way (m) that it gives at least.

    least    lower bound of the speed at its beginning, m/s, of an axis that has stayed within `SURE` counts
    overdue  time since a live axis must have moved, s; None before
    """

    sign: float = 0.0
    time: float = 0.0
    speed: float = 0.0
    way: float = 0.0
    least: float = -math.inf
    overdue: float | None = None


class State(NamedTuple):
    """What is known after a cycle.

    cycle    number of the next one
    start    position at which the motion began, m
    sent     targets without an answer, oldest first
    silent   time since the last answer, s
    answer   the last one
    same     how many answers after the first had the same values, and over which time, s
    gap      leaky sum of v T - Δx, m
    speed    largest speed of late, m/s
    """

    cycle: int
    start: float
    sent: tuple[Target, ...]
    silent: float
    answer: Answer
    anchor: Anchor
    push: Push = Push()
    same: tuple[int, float] = (0, 0.0)
    gap: float = 0.0
    speed: float = 0.0


class Watch:
    """The watch over one drive; it holds the bounds of its drive file, and no state."""

    def __init__(self, drive: BusDrive) -> None:
        self.drive, self.limits = drive, drive.limits
        self._count = drive.scaling.metre
        self._sure = SURE * self._count
        self._shown = (SHOWN - 1e-6) * self._count  # readings are whole counts, and their products with c are rounded
        self._patience = drive.lost_frames + 2
        self._response = max(RESPONSE, self._patience * drive.cycle_time)
        self._memory = MEMORY * self._response

    def begin(self, answer: Answer) -> State:
        """The state before the first cycle, of an axis that is held where it is."""
        here = answer.position
        return State(0, here, (Target(here, 0.0, 0.0),) * self.drive.lag, 0.0, answer, Anchor(here, 0, 0.0))

    def step(
        self, state: State, target: Target, answer: Answer | None, *, late: bool = False
    ) -> tuple[State, Fault | None]:
        """One cycle with its target and its answer; the answer is None if it was lost.

        Time is counted in cycles.  `late` says that more than a cycle passed before this one: how far the axis went
        meanwhile is not known.
        """
        acting, *sent = (*state.sent, target)
        dt = self.drive.cycle_time
        silent = state.silent + dt
        if answer is None:  # a target may be lost with it: nothing is concluded from this cycle
            push = Push(overdue=state.push.overdue)
            return state._replace(cycle=state.cycle + 1, sent=tuple(sent), silent=silent, push=push), None
        moved = abs(answer.position - state.anchor.position) >= self._shown
        lead = acting.position - answer.position
        anchor = state.anchor._replace(asked=state.anchor.asked + acting.velocity * dt)
        push = self._pushed(state.push, acting.force, dt)
        if moved:
            anchor, push = Anchor(answer.position, state.cycle, lead), Push(push.sign)
        same, gap, speed = self._compared(state, answer, silent, late)
        fault = (
            self._beyond(state, answer, lead, silent)
            or self._standing(state.cycle, anchor, push, acting)
            or self._contradiction(state.cycle, answer, same, gap, speed)
        )
        return State(
            state.cycle + 1, state.start, tuple(sent), 0.0, answer, anchor, push, same, gap, speed
        ), fault  # fmt: skip

    def _beyond(self, state: State, answer: Answer, lead: float, silent: float) -> Fault | None:
        """A limit of the drive file that is exceeded."""
        limits, own = self.limits, abs(answer.position - state.answer.position) / silent if silent > 0.0 else 0.0
        checks = [
            ("travel", abs(answer.position - state.start), limits.travel, "m", ""),
            ("velocity", own if answer.velocity is None else abs(answer.velocity), limits.velocity, "m/s", ""),
            ("force", abs(answer.force), limits.force, "N", ""),
        ]
        if self.drive.mode == "csp":
            told = answer.following_error
            says = "the drive has no 0x60F4" if told is None else f"the drive says {told:.4g} m in 0x60F4"
            beside = f" (set position - 0x6064; {says})" if told is None or abs(lead) > abs(told) else " (0x60F4)"
            error = max(abs(lead), abs(told or 0.0))
            checks.append(("following_error", error, limits.following_error, "m", beside))
        for key, got, most, unit, beside in checks:
            if not got <= most:
                said = (
                    f"{key} = {got:.4g} {unit}{beside} in cycle {state.cycle} exceeded limits.{key} = {most:.4g} {unit}"
                )
                return Fault(key, got, most, unit, state.cycle, said)
        for key, bound, way in (
            ("position_least", limits.position_least, -1.0),
            ("position_most", limits.position_most, 1.0),
        ):
            if bound is not None and way * (answer.position - bound) > 0.0:
                said = (
                    f"position = {answer.position:.6g} m in cycle {state.cycle} left limits.position_least .. "
                    f"position_most at {key} = {bound:.6g} m"
                )
                return Fault("position", answer.position, bound, "m", state.cycle, said)
        return None

    def _pushed(self, push: Push, force: float, dt: float) -> Push:
        """The push a cycle later: the least motion that it gives, and whether an axis may still have stayed."""
        mass, breakaway = self.limits.largest_mass, self.limits.breakaway_force
        if self.drive.mode != "cst" or mass is None or breakaway is None:
            return push
        overdue = None if push.overdue is None else push.overdue + dt  # goes on after the push: the answer may be late
        net = abs(force) - breakaway
        sign = math.copysign(1.0, force) if net > 0.0 else 0.0
        if sign == 0.0 or sign != push.sign:
            push = Push(sign)
        if sign == 0.0:
            return push._replace(overdue=overdue)
        gained = net / mass * dt
        time, way = push.time + dt, push.way + (push.speed + 0.5 * gained) * dt
        least = max(push.least, -(self._sure + way) / time)
        if overdue is None and (self._sure - way) / time < least:
            overdue = 0.0
        return Push(sign, time, push.speed + gained, way, least, overdue)

    def _standing(self, cycle: int, anchor: Anchor, push: Push, acting: Target) -> Fault | None:
        """A position that stands where that of a live drive must have moved."""
        mode, most = self.drive.mode, self.limits.following_error
        stands = (
            f"0x6064 stands still, less than {SHOWN} increments ({SHOWN * self._count:.4g} m) from where it was in "
            f"cycle {anchor.cycle}"
        )
        dead = "the drive no longer measures or does not follow"
        if mode == "csp":
            lead = acting.position - anchor.position
            before = max(0.0, math.copysign(anchor.lead, anchor.lead * lead))
            bound = before + USED * (most - before)
            if abs(lead) > bound and abs(lead - anchor.lead) >= self._sure:
                said = (
                    f"{stands}, and in cycle {cycle} the set position leads it by {abs(lead):.4g} m, more than the "
                    f"{bound:.4g} m (of limits.following_error = {most:.4g} m) before which a live drive has moved: "
                    f"{dead}"
                )
                return Fault("standstill", abs(lead), bound, "m", cycle, said)
        elif mode == "csv":
            asked, bound = abs(anchor.asked), max(USED * most, self._sure)
            if asked > bound:
                said = (
                    f"{stands}, and up to cycle {cycle} the set velocity asked for {asked:.4g} m, more than the "
                    f"{bound:.4g} m (of limits.following_error = {most:.4g} m) before which a live drive has moved: "
                    f"{dead}"
                )
                return Fault("standstill", asked, bound, "m", cycle, said)
        elif push.overdue is not None and push.overdue >= self._response:
            said = (
                f"{stands}, and in cycle {cycle} it is {push.overdue:.4g} s, at least {self._response:.4g} s, since "
                f"the force must have moved limits.largest_mass = {self.limits.largest_mass:.4g} kg against "
                f"limits.breakaway_force = {self.limits.breakaway_force:.4g} N by {SURE} increments: {dead}"
            )
            return Fault("standstill", push.overdue, self._response, "s", cycle, said)
        return None

    def _compared(
        self, state: State, answer: Answer, silent: float, late: bool
    ) -> tuple[tuple[int, float], float, float]:
        """How long the values have been the same; the gap between velocity and positions; the largest speed."""
        many, time = state.same
        same = (many + 1, time + silent) if answer == state.answer else (0, 0.0)
        if answer.velocity is None:
            return same, 0.0, 0.0
        kept = max(0.0, 1.0 - silent / self._memory)
        moved = answer.position - state.answer.position
        gap = 0.0 if late else kept * state.gap + answer.velocity * silent - moved
        return same, gap, max(kept * state.speed, abs(answer.velocity), abs(moved) / silent)

    def _contradiction(
        self, cycle: int, answer: Answer, same: tuple[int, float], gap: float, speed: float
    ) -> Fault | None:
        """A velocity that the positions contradict."""
        many, time = same
        if answer.velocity is None:
            return None
        way, least = abs(answer.velocity) * min(time, self._memory), SHOWN * self._count
        if many >= self._patience and way >= least:
            said = (
                f"all values stand still since cycle {cycle - many}, and 0x606C says {answer.velocity:.4g} m/s: up to "
                f"cycle {cycle} that is {way:.4g} m, and a live drive would have shown {SHOWN} increments, "
                f"{least:.4g} m"
            )
            return Fault("velocity_frozen", way, least, "m", cycle, said)
        bound = self._response * speed + self._sure
        if abs(gap) > bound:
            said = (
                f"0x606C and 0x6064 contradict each other: in cycle {cycle} the velocity, {answer.velocity:.4g} m/s, "
                f"and the positions of the last {self._memory:.4g} s differ by {abs(gap):.4g} m, more than "
                f"{bound:.4g} m: one of them is dead, or the unit of the velocity is another"
            )
            return Fault("velocity_contradicts", abs(gap), bound, "m", cycle, said)
        return None

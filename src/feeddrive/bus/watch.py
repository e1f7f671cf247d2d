"""Signs of life of a drive in motion: what no live drive would report, whatever it says of its own health.

The safety monitor (`monitor`) makes these checks after its own.  `Watch.step` is a pure function: it maps state,
targets and actual values of one cycle to the next state, and to a fault or None.  It accesses neither bus nor clock,
and does not depend on the source of the targets.

    c        one increment, m
    r, w, F  target position, velocity and force that an answer refers to: those sent `lag` cycles before it
    x, v     actual position (0x6064) and velocity (0x606C)
    T        cycle time, s
    E, M, B  limits.following_error, limits.largest_mass, limits.breakaway_force

Standstill.  The anchor a is the reading of a cycle j, and is set to x as soon as |x - a| >= 2 c.  Until then the axis
has shown less than two counts of motion.  An axis that has moved by more than 3 c shows at least two counts: of the
travel, one count is lost to the rounding of two readings, and one to noise of half a count in each.  For each mode, a
bound determines when a live axis must have moved by that much.

csp.  Let L = r - a be the lead of the target, L_j that of cycle j, and L+ that of the next cycle, whose target has
already been sent.  A live drive moves before its target leads it by 3/4 E; a drive that already lags by L_j moves
before 3/4 of the remaining distance to E is used up:

    |L - L_j| >= 3 c  and  (|L| > L' + 3/4 (E - L')  or  |L+| > E),    L' = max(0, L_j sgn L)      fault

A dead drive is thus detected before its target leads the last reading by E, if `lag` is not 0 and the target advances
in each cycle by at least 3 c and at most half of E - |L_j|; with a slower target, the drive is detected at the first
bound if E - |L_j| is 12 c or more.  The criterion is travel, not time: a stuck axis remains at rest until the force of
its loop exceeds friction, which requires a certain lead, so that dwell, creep and slow setpoints cause no fault.  There
is no false alarm for a drive whose following error never exceeds 3/4 E - 2 c, and whose target advances by less than
E/4 per cycle: while the axis is within 2 c of a, L differs from the following error by less than 2 c.  A drive whose
lag at speed is larger causes no false alarm either, since its target advances only about as far as the axis itself
before the axis shows two counts.

csv.  No position is controlled, so the travel S commanded by the set velocity since cycle j replaces the lead:

    S = Σ w T,    |S| > max(3/4 E, 3 c)                                                 fault

At standstill, S is the change since cycle j of the distance between the axis and Σ w T, summed from the start.  Since
this distance may change sign, there is no false alarm for a drive whose distance never exceeds 3/8 E - c.

cst.  Dead time, current loop and filters delay and smooth the force.  Let RESPONSE be 10 ms or, if longer,
`lost_frames` + 2 cycles.  If the force responds completely within RESPONSE, the acting force is a mean of the target
forces during that time, and not less than their minimum F-.  If all of them have the same sign and F- > B, an axis with
a mass of at most M has

    sgn(F) x'' >= (F- - B)/M = a(t) > 0

During a push of one sign that began τ ago, the axis has moved by at least v0 τ + q, with q = ∫∫ a.  The initial
velocity v0 is unknown.  For an axis that stayed within 3 c throughout, v0 satisfies

    -(3c + q(τ'))/τ' < v0 < (3c - q(τ'))/τ'    for all τ' <= τ

The right side decreases with τ'.  When it falls below the largest left side, no v0 is possible and a live axis must
have moved; under a constant push this happens RESPONSE + (1 + √2) √(6 c/a) after the push began.  The axis is dead if
it has still not shown two counts `lost_frames` + 1 cycles later: a drive may report a reading `lost_frames` + 2 times.
Where a control in the master makes this force from a set position, the bounds of csp hold as well: r is the set
position with which the control compares the reading.

Velocity.  The velocity is compared with the position differences in two ways:

1. Frozen values: all values but 0x60F4 are identical in `lost_frames` + 2 answers after the first, although the sum of
   |v| T over these answers, or at most over a memory of 10 RESPONSE, is 2 c or more: the drive reports a velocity, but
   its readings are constant.  This check detects values frozen in motion earlier than any bound above.  A live axis
   that has moved by 2 c has changed its reading, one that stops abruptly changes its velocity, and noise that hides a
   motion changes one or the other.  A drive that updates its values only every n cycles, detected by repeated values
   while |v| T exceeds 1.1 c, may repeat them once more by chance: it is therefore allowed 2 n identical answers.
2. Contradiction: a leaky sum over the memory is compared with the largest speed U, from either source, in that time:

       |Σ (v T - Δx)| > RESPONSE U + max(3/4 E, 3 c)                                    fault

   A velocity delayed by δ leaves at most 2 δ U, after a reversal; a relative error g leaves 10 g RESPONSE U.  A 5 ms
   filter or an error of 10 % is tolerated, and so are both at half these values; 3/4 E allows for the resolution of v.
   The sum is reset after a cycle that began more than a cycle late, as the axis continued for an unknown time.

The following faults are not detectable: a wrong force (0x6077) or second encoder (0x60E4); a dead encoder with noise of
two counts, until the following error exceeds its limit; and a dead drive whose target does not move (csp, csv) or stays
below B (cst).
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from feeddrive.bus.drive_file import BusDrive
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text

# counts by which a reading must change to be a sign of life: one may be noise
SHOWN = 2
SURE = 3  # counts of true motion beyond which two are shown: one is shown, rounding and noise take one each
USED = 0.75  # share of what is left to limits.following_error, of which a live drive uses less before it moves
# cycles beyond `lost_frames` for which values may repeat: a frame in between, and slow process data
SPARE = 2
RESPONSE = 0.01  # s that current loop, filters and elastic parts may take
MEMORY = 10.0  # responses over which velocity and positions are compared


class Target(NamedTuple):
    """The target values of a cycle; the mode determines which of them the drive follows."""

    position: float  # m
    velocity: float  # m/s
    force: float  # N


class Answer(NamedTuple):
    """The actual values of a cycle; None where the drive lacks the object."""

    position: float  # m
    velocity: float | None  # m/s
    force: float  # N
    following_error: float | None = None  # m
    second: float | None = None  # m


class Fault(NamedTuple):
    """The reason to end a motion: its kind, value and bound in one unit, cycle, and error message."""

    kind: str
    value: float
    bound: float
    unit: str
    cycle: int
    message: str


class Anchor(NamedTuple):
    """A reference reading: position and cycle, the lead of its target (csp, m), and the travel commanded since (csv,
    m).
    """

    position: float
    cycle: int
    lead: float
    asked: float = 0.0


class Push(NamedTuple):
    """A force above breakaway in one direction.

    forces  forces during the last RESPONSE, oldest first, N
    sign    direction of the push; 0: no push
    time    duration so far, s
    speed   minimum speed gained, m/s
    way     minimum travel due to that speed, m
    slowest, fastest  bounds of the initial speed, m/s, of an axis that has stayed within `SURE` counts
    due     the first cycle in which a live axis must have moved; retained after the push ends
    """

    forces: tuple[float, ...] = ()
    sign: float = 0.0
    time: float = 0.0
    speed: float = 0.0
    way: float = 0.0
    slowest: float = -math.inf
    fastest: float = math.inf
    due: int | None = None


class State(NamedTuple):
    """The state of the watch after a cycle.

    cycle    number of the next cycle
    start    position at which the motion began, m
    sent     targets without an answer, oldest first
    silent   time since the last answer, s
    answer   the last answer
    same     number and duration (s) of the answers that repeat the values of the last one
    renewal  update interval of the values in motion, in answers, at most `lost_frames` + 2
    gap      leaky sum of v T - Δx, m
    speed    largest recent speed, m/s
    """

    cycle: int
    start: float
    sent: tuple[Target, ...]
    silent: float
    answer: Answer
    anchor: Anchor
    push: Push = Push()
    same: tuple[int, float] = (0, 0.0)
    renewal: int = 1
    gap: float = 0.0
    speed: float = 0.0


class Watch:
    """The signs of life of one drive within the bounds of its drive file; it holds no state."""

    def __init__(self, drive: BusDrive, *, follows: bool = False) -> None:
        """Set up the watch; `follows`: a control in the master makes the force of cst from the target position."""
        self.drive, self.limits, self._follows = drive, drive.limits, follows
        self._count = drive.scaling.metre
        self._sure = SURE * self._count
        # readings are whole counts, but their products with c are rounded
        self._shown = (SHOWN - 1e-6) * self._count
        self._patience = drive.lost_frames + SPARE
        self._response = max(RESPONSE, self._patience * drive.cycle_time)
        self._memory = MEMORY * self._response
        # a reading renewed in time stays the same for one count of travel at most, 10 % more by a wrong velocity
        self._held = (1.0 + 1.0 / MEMORY) * self._count
        # both ends of RESPONSE included; the quotient may be a whole number but for rounding
        self._forces = 1 + math.ceil(self._response / drive.cycle_time - 1e-9)

    def begin(self, answer: Answer) -> State:
        """Return the initial state, for an axis that holds its position."""
        here = answer.position
        return State(0, here, (Target(here, 0.0, 0.0),) * self.drive.lag, 0.0, answer, Anchor(here, 0, 0.0))

    def step(
        self, state: State, target: Target, answer: Answer | None, *, late: bool = False
    ) -> tuple[State, Fault | None]:
        """Check one cycle, given its target and its answer (None for a lost frame); return the new state and a fault.

        Time is counted in cycles.  `late` is True if this cycle began more than a cycle late, which makes the travel
        since the last one unknown.
        """
        acting, *sent = (*state.sent, target)
        dt = self.drive.cycle_time
        silent = state.silent + dt
        anchor = state.anchor._replace(asked=state.anchor.asked + acting.velocity * dt)
        # a target may be lost with the answer: which forces act is unknown, and the push starts again
        if answer is None:
            lost = state._replace(
                cycle=state.cycle + 1, sent=tuple(sent), silent=silent, anchor=anchor, push=Push(due=state.push.due)
            )
            return lost, None
        moved = abs(answer.position - state.anchor.position) >= self._shown
        lead = acting.position - answer.position
        push = self._pushed(state.push, acting.force, dt, state.cycle)
        if moved:
            anchor, push = Anchor(answer.position, state.cycle, lead), Push(push.forces)
        same, renewal = self._repeated(state, answer, silent)
        gap, speed = self._compared(state, answer, silent, late)
        fault = (
            self._standing(state.cycle, anchor, push, acting, sent)
            or self._frozen(state.cycle, answer, same, renewal)
            or self._contradiction(state.cycle, answer, gap, speed)
        )
        after = State(state.cycle + 1, state.start, tuple(sent), 0.0, answer, anchor, push, same, renewal, gap, speed)
        return after, fault

    def _pushed(self, push: Push, force: float, dt: float, cycle: int) -> Push:
        """Update the push by one cycle: the minimum motion caused by it, and the bounds of the initial speed."""
        mass, breakaway = self.limits.largest_mass, self.limits.breakaway_force
        if self.drive.mode != "cst" or mass is None or breakaway is None:
            return push
        forces = (*push.forces, force)[-self._forces :]
        sign = math.copysign(1.0, force)
        least = min(forces) if sign > 0.0 else -max(forces)
        due = push.due
        if least <= breakaway or len(forces) < self._forces:
            return Push(forces, due=due)
        if sign != push.sign:
            push = Push()
        gained = (least - breakaway) / mass * dt
        time, way = push.time + dt, push.way + (push.speed + 0.5 * gained) * dt
        slowest, fastest = max(push.slowest, -(self._sure + way) / time), (self._sure - way) / time
        if due is None and fastest < slowest:
            due = cycle
        return Push(forces, sign, time, push.speed + gained, way, slowest, fastest, due)

    def _standing(self, cycle: int, anchor: Anchor, push: Push, acting: Target, sent: Sequence[Target]) -> Fault | None:
        """Return a fault if the position has not changed although a live drive would have moved by now."""
        mode, most = self.drive.mode, self.limits.following_error
        if mode == "cst" and not self._follows:
            return self._unmoved(cycle, anchor, push)
        if mode != "csv":
            lead = acting.position - anchor.position
            # L' of the module's docstring: a lead to the other side leaves the whole following error
            before = max(0.0, math.copysign(anchor.lead, anchor.lead * lead))
            value, bound, why = abs(lead), before + USED * (most - before), "the set position leads it"
            # nor may a dead drive reach the limit in the next cycle, whose target is already on its way
            if value <= bound and sent:
                value, bound, why = abs(sent[0].position - anchor.position), most, "the next set position leads it"
            if value <= bound or abs(lead - anchor.lead) < self._sure:
                return self._unmoved(cycle, anchor, push) if mode == "cst" else None
        else:
            value, bound, why = abs(anchor.asked), max(USED * most, self._sure), "the set velocity asked it to go on"
            if value <= bound:
                return None
        message = Text(
            f"{self._stands(cycle, anchor)}: {why} by {Quantity(value, 'm'):SI}, and a live drive moves before "
            f"{Quantity(bound, 'm'):SI} at limits.following_error = {Quantity(most, 'm'):SI}"
        )
        return Fault("standstill", value, bound, "m", cycle, message)

    def _unmoved(self, cycle: int, anchor: Anchor, push: Push) -> Fault | None:
        """Return a fault if a force should have moved the axis by now."""
        # a reading that is renewed every so many cycles is one cycle less old
        if push.due is None or cycle - push.due < self._patience - 1:
            return None
        value, bound = float(cycle - push.due), float(self._patience - 1)
        message = Text(
            f"{self._stands(cycle, anchor)}: since cycle {push.due} the force, beyond limits.breakaway_force = "
            f"{Quantity(self.limits.breakaway_force or 0.0, 'N')}, must have moved limits.largest_mass = "
            f"{Quantity(self.limits.largest_mass or 0.0, 'kg')} by {SURE} increments, and a live drive shows it "
            f"within {self._patience - 1} cycles"
        )
        return Fault("standstill", value, bound, "cycles", cycle, message)

    def _stands(self, cycle: int, anchor: Anchor) -> str:
        return Text(
            f"in cycle {cycle} the position (0x6064) still stands within {SHOWN} increments "
            f"({Quantity(SHOWN * self._count, 'm'):SI}) of cycle {anchor.cycle}"
        )

    def _repeated(self, state: State, answer: Answer, silent: float) -> tuple[tuple[int, float], int]:
        """Return the number and duration of repeated answers, and the update interval of the values, in answers."""
        many, time = state.same
        # 0x60F4 may be computed from the target, which goes on
        if answer._replace(following_error=None) == state.answer._replace(following_error=None):
            return (many + 1, time + silent), state.renewal
        # otherwise the axis was at rest or slow, and repeated values say nothing about the drive
        held = abs(state.answer.velocity or 0.0) * time > self._held
        return (0, 0.0), max(state.renewal, min(many + 1, self._patience)) if held else state.renewal

    def _frozen(self, cycle: int, answer: Answer, same: tuple[int, float], renewal: int) -> Fault | None:
        """Return a fault if all values are frozen at a nonzero velocity."""
        many, time = same
        if answer.velocity is None or many < max(self._patience, 2 * renewal):
            return None
        way, least = abs(answer.velocity) * min(time, self._memory), SHOWN * self._count
        if way < least:
            return None
        message = Text(
            f"all values stand still since cycle {cycle - many}, and 0x606C says "
            f"{Quantity(answer.velocity or 0.0, 'm/s'):SI}: that is {Quantity(way, 'm'):SI} up to cycle {cycle}, and a "
            f"live drive would have shown {SHOWN} increments, {Quantity(least, 'm'):SI}"
        )
        return Fault("velocity_frozen", way, least, "m", cycle, message)

    def _compared(self, state: State, answer: Answer, silent: float, late: bool) -> tuple[float, float]:
        """Return the gap between integrated velocity and positions, m, and the largest recent speed, m/s."""
        if answer.velocity is None:
            return 0.0, 0.0
        kept = max(0.0, 1.0 - silent / self._memory)
        moved = answer.position - state.answer.position
        gap = 0.0 if late else kept * state.gap + answer.velocity * silent - moved
        return gap, max(kept * state.speed, abs(answer.velocity), abs(moved) / silent)

    def _contradiction(self, cycle: int, answer: Answer, gap: float, speed: float) -> Fault | None:
        """Return a fault if velocity and positions contradict each other."""
        bound = self._response * speed + max(self._sure, USED * self.limits.following_error)
        if abs(gap) > bound:
            sentence = Text(
                f"0x606C and 0x6064 contradict each other: in cycle {cycle} the velocity, "
                f"{Quantity(answer.velocity or 0.0, 'm/s'):SI}, and the positions of the last "
                f"{Quantity(self._memory, 's'):SI} differ by {Quantity(abs(gap), 'm'):SI}, more than "
                f"{Quantity(bound, 'm'):SI}: one of them is dead, or the unit of the velocity is another"
            )
            return Fault("velocity_contradicts", abs(gap), bound, "m", cycle, sentence)
        return None

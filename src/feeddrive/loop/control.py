"""The controller of one axis: prefilter, compensation, feedback law, filters, feedforward, force limit and guard."""

from collections.abc import Iterator
from dataclasses import replace
from functools import reduce
from operator import add
from typing import Any, NamedTuple, Self

from feeddrive.blocks.families import FEEDS, Compensation, Feedforward, Filter, Law, Nothing, Prefilter
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language import matrix, ops, tree
from feeddrive.language.block import Block, Number, Rule, parameter, part
from feeddrive.language.errors import StructureError
from feeddrive.language.graph import Symbol
from feeddrive.language.quantity import Quantity
from feeddrive.language.ring import History, Ring, Track
from feeddrive.language.text import Text
from feeddrive.loop.guard import Guard


class Control(Block):
    """The controller of one axis, with its parts in the order of the signal flow.

        setpoint -> prefilter -> compensation -> law -> filters -> + feedforward + compensation -> limit -> force

    Compensation shifts the setpoint or adds a force; feedforward and compensation bypass the filters.  The force
    actually commanded and the requested force are fed back to law and compensation with the next reading, as `applied`
    and `requested`.

    With `feedback_delay`, the law receives the setpoint delayed by this time, computed by a Taylor series up to snap.
    The axis responds to a feedforward force only after the dead time; with an equally delayed setpoint, the law sees no
    error during this response.  The axis then lags the setpoint by this time, so all axes of a machine need the same
    value.
    """

    law: Law = part("the feedback law")
    prefilter: Prefilter | None = part("changes the setpoint first", default=None)
    compensation: tuple[Compensation, ...] = part(
        "compensation by estimates: disturbance rejection, structural modes", default=()
    )
    filters: tuple[Filter, ...] = part("filter pack on the feedback force", default=())
    feedforward: tuple[Feedforward, ...] = part("forces added behind the filters", default=())
    feedback_delay: Number | None = parameter(
        "s",
        "time by which the law sees the setpoint later than the feedforward: the axis's dead time; absent: none",
        above=0,
        default=None,
    )
    velocity_limit: Number | None = parameter(
        "m/s", "largest velocity that a law commands to a drive; absent for no limit", above=0, default=None
    )
    force_limit: Number | None = parameter("N", "largest commanded force; absent for no limit", above=0, default=None)
    guard: Guard | None = part("enable, trips and broken readings", default=None)

    class Prepared(NamedTuple):
        """The numbers that `prepare` computes from the parameters of the parts."""

        law: Any
        compensation: tuple[Any, ...]
        filters: tuple[Any, ...]
        guard: Any

    class Memory(NamedTuple):
        """The states of the parts, which a reset initializes at the present position."""

        prefilter: Any
        compensation: tuple[Any, ...]
        law: Any
        filters: tuple[Any, ...]
        feedforward: tuple[Any, ...]

    class State(NamedTuple):
        """The states of the parts, the last commanded and requested force, and the state of the guard."""

        memory: Any
        applied: Number  # N
        requested: Number  # N
        guard: Any

    class Judged(NamedTuple):
        """The setpoint and readings (m) for the law, and the state and verdict of the guard, if there is one."""

        setpoint: Setpoint
        motor: Number
        load: Number
        guard: Any
        verdict: Any = None

    class Command(NamedTuple):
        """The commands of a sample in N (or m/s: `Law.commanded`), the trip code, and 1 while the loop runs.
        `requested` is the sum of feedback, feedforward and compensation; `applied` is what is commanded, after limit
        and guard.
        """

        applied: Number
        requested: Number
        feedback: Number
        feedforward: Number
        compensation: Number
        trip: Number
        running: Number

    def rules(self) -> Iterator[Rule]:
        """Yield the conditions that the guard's safe force does not exceed the force limit, and is 0 where the command
        is a velocity.
        """
        limit, held = self.force_limit, None if self.guard is None else self.guard.safe_force
        if self.law.commanded == "velocity" and held is not None:
            yield Rule(
                ops.equal(held, 0.0),
                "guard.safe_force is 0 of a law that commands a velocity",
                lambda: Text(
                    f"control.guard.safe_force = {Quantity(held, 'N'):6} is a force, and {self.law.kind} commands a "
                    "velocity: leave it out; the velocity loop of the drive holds the axis"
                ),
            )
        if limit is not None and held is not None:
            yield Rule(
                ops.absolute(held) <= limit,
                "guard.safe_force is within the force_limit",
                lambda: Text(
                    f"control.guard.safe_force = {Quantity(held, 'N'):6} is beyond control.force_limit = "
                    f"{Quantity(limit, 'N'):6} by {Quantity(abs(held) - limit, 'N'):6}: raise the limit, or lower the "
                    "force"
                ),
            )

    def check(self) -> None:
        """Reject duplicate feedforward terms, compensations that this law does not support, and forces and velocities
        in one command.
        """
        self._check_command()
        for block in self.compensation:
            block.suits(self.law)
        if self.feedback_delay is not None and self.law.fed():
            raise StructureError(
                f"control.feedback_delay delays the set motion of {self.law.kind}, which feeds the "
                f"{' and the '.join(self.law.fed())} forward itself: leave it out, or take a law without feedforward"
            )
        fed = dict.fromkeys(self.law.fed(), self.law.kind)
        for i, block in enumerate(self.feedforward):
            for name in (name for name in FEEDS if name in block.fed()):
                if name in fed:
                    raise StructureError(
                        f"control.feedforward.{i}: {block.kind} feeds the {name} forward, which {fed[name]} does "
                        f"already: the force would act twice; leave one of them out"
                    )
                fed[name] = block.kind

    def _check_command(self) -> None:
        """Raise StructureError for parts whose unit is not that of the law's command."""
        kind, by_velocity = self.law.kind, self.law.commanded == "velocity"
        if not by_velocity:
            if self.velocity_limit is not None:
                raise StructureError(
                    f"control.velocity_limit bounds a commanded velocity, and {kind} commands a force: give "
                    "force_limit in N, or guard.velocity_limit for the speed of the axis"
                )
            return
        for name in ("force_limit", "feedforward", "compensation"):
            if getattr(self, name) not in (None, ()):
                raise StructureError(
                    f"control.{name} is a force in N, and {kind} commands a velocity in m/s to a drive that makes the "
                    f"force by itself: leave it out{', or give velocity_limit' if name == 'force_limit' else ''}"
                )

    def unlimited(self) -> Self:
        """Return the controller without guard and limits of its command, for linear models."""
        if self.guard is None and self.force_limit is None and self.velocity_limit is None:
            return self
        return replace(self, guard=None, force_limit=None, velocity_limit=None)

    def prepare(self, T: Number) -> Prepared:
        """Compute the numbers of every part that depend on its parameters only."""
        return self.Prepared(
            self.law.prepare(T),
            tuple(part.prepare(T) for part in self.compensation),
            tuple(part.prepare(T) for part in self.filters),
            Nothing() if self.guard is None else self.guard.prepare(T),
        )

    def start(
        self, prepared: Prepared, setpoint: Setpoint, motor: Number, load: Number, velocity: Number = 0.0
    ) -> State:
        """Return the state one sample before the first step, for an axis with these encoder readings and `velocity`
        (m/s).

        Until then the force is assumed to be the guard's safe force, or 0 if there is no guard.
        """
        if self.guard is not None:
            setpoint, motor, load = self.guard.sound(setpoint, motor, load)
        zero = ops.zero(load)
        moving = zero + velocity
        if self.guard is None:
            guard, force = Nothing(), zero
        else:
            guard, force = self.guard.start(prepared.guard, setpoint, motor, load, moving), self.guard.safe_force
        memory = self._memory(prepared, setpoint, Reading(motor, load, force, force, moving))
        return self.State(memory, force, force, guard)

    def _memory(self, prepared: Prepared, setpoint: Setpoint, reading: Reading) -> Memory:
        compensation = zip(self.compensation, prepared.compensation, strict=True)
        filters = zip(self.filters, prepared.filters, strict=True)
        # compensations add their own part of the acting force again: law and filters start from the rest, without a
        # jump
        force = reduce(_less, (part.carries(reading) for part in self.compensation), reading.applied)
        return self.Memory(
            Nothing() if self.prefilter is None else self.prefilter.start(setpoint),
            tuple(part.start(coefficients, setpoint, reading) for part, coefficients in compensation),
            self.law.start(prepared.law, setpoint, reading._replace(applied=force)),
            tuple(part.start(coefficients, force) for part, coefficients in filters),
            tuple(part.start(setpoint) for part in self.feedforward),
        )

    def step(
        self,
        prepared: Prepared,
        state: State,
        setpoint: Setpoint,
        motor: Number,
        load: Number,
        enable: Number,
        T: Number,
    ) -> tuple[State, Command]:
        """Compute one sample: the new state, and the commanded force (N) from the readings of the two encoders (m)."""
        return self.answer(prepared, state, self.judge(prepared, state, setpoint, motor, load, enable), T)

    def judge(
        self, prepared: Prepared, state: State, setpoint: Setpoint, motor: Number, load: Number, enable: Number
    ) -> Judged:
        """Compute the first half of a sample: the guard's verdict on setpoint and readings."""
        if self.guard is None:
            return self.Judged(setpoint, motor, load, state.guard)
        guard, verdict = self.guard.step(prepared.guard, state.guard, setpoint, motor, load, enable)
        return self.Judged(verdict.setpoint, verdict.position_motor, verdict.position_load, guard, verdict)

    def answer(
        self, prepared: Prepared, state: State, judged: Judged, T: Number, added: Number | None = None
    ) -> tuple[State, Command]:
        """Compute the second half of a sample; `added` (m/s) is added to the law's velocity command (see
        `Law.position_gain`).
        """
        reading = self._reading(state, judged.motor, judged.load)
        verdict = judged.verdict
        if self.guard is None:
            memory, command = self._run(prepared, state.memory, judged.setpoint, reading, T, added)
            return self.State(memory, command.applied, command.requested, judged.guard), command
        # from the readings of one sample before, so that a law that is started on a moving axis sees its velocity
        fresh = self._memory(
            prepared,
            verdict.setpoint,
            Reading(verdict.before_motor, verdict.before_load, state.applied, state.requested, verdict.velocity),
        )
        _check_forgetful(fresh, "control")
        live = self.guard.live(verdict, state.memory, fresh)
        memory, command = self._run(prepared, live, verdict.setpoint, reading, T, added)
        guard, outcome = self.guard.command(judged.guard, verdict, state.applied, command.applied, command.requested)
        return self.State(memory, outcome.applied, outcome.requested, guard), command._replace(**outcome._asdict())

    def moved(self, state: State) -> Number:
        """Return the part (m) of the compensations' set-position shift that corrects the reading for pitch errors."""
        pairs = zip(self.compensation, state.memory.compensation, strict=True)
        shifts = [block.moved(held) for block, held in pairs]
        shifts = [shift for shift in shifts if not matrix.is_zero(shift)]
        return reduce(add, shifts) if shifts else 0.0

    def check_live(self, old: Self, place: str = "control") -> None:
        """Raise StructureError, naming the first difference, if this controller and `old` differ in more than parameter
        values.
        """
        differs = tree.difference(old, self, place)
        if differs is not None:
            raise StructureError(
                f"{differs}: a live change may change numbers only; to change the structure, begin a new run"
            )

    def retune(self, state: State, old: Self, old_prepared: Prepared, prepared: Prepared) -> State:
        """Return the state after a bumpless live change from `old` to this controller between two samples.

        Only parameter values may differ. Raises StructureError if a block, a choice or the presence of a parameter
        differs.
        """
        self.check_live(old)
        held = state.memory
        memory = self.Memory(
            held.prefilter if self.prefilter is None else self.prefilter.retune(held.prefilter, old.prefilter),
            tuple(
                map(
                    _retuned,
                    self.compensation,
                    held.compensation,
                    old.compensation,
                    old_prepared.compensation,
                    prepared.compensation,
                )
            ),
            self.law.retune(held.law, old.law, old_prepared.law, prepared.law),
            tuple(map(_retuned, self.filters, held.filters, old.filters, old_prepared.filters, prepared.filters)),
            tuple(
                block.retune(state, before)
                for block, state, before in zip(self.feedforward, held.feedforward, old.feedforward, strict=True)
            ),
        )
        return state._replace(memory=memory)

    def _reading(self, state: State, motor: Number, load: Number) -> Reading:
        return Reading(motor, load, state.applied, state.requested)

    def _run(
        self, prepared: Prepared, memory: Any, setpoint: Setpoint, reading: Reading, T: Number, velocity: Number | None
    ) -> tuple[Memory, Command]:
        """Run the parts in the order of the signal flow."""
        prefilter = memory.prefilter
        if self.prefilter is not None:
            prefilter, setpoint = self.prefilter.step(prefilter, setpoint, T)
        compensation: list[Any] = []
        added: Any = 0.0
        for i, (block, coefficients, held) in enumerate(
            zip(self.compensation, prepared.compensation, memory.compensation, strict=True)
        ):
            held, setpoint, force = block.step(coefficients, held, setpoint, reading, T)
            compensation.append(held)
            added = force if i == 0 else added + force
        target = setpoint if self.feedback_delay is None else setpoint.shifted(-self.feedback_delay)
        if velocity is not None:
            # a law has no input for a velocity: a shift of the set position passes its position gain
            target = target._replace(position=target.position + velocity / self.law.position_gain())
        law, feedback = _answered(self.law, memory.law, self.law.step(prepared.law, memory.law, target, reading, T))
        filters: list[Any] = []
        for filter_, coefficients, held in zip(self.filters, prepared.filters, memory.filters, strict=True):
            held, feedback = filter_.step(coefficients, held, feedback)
            filters.append(held)
        forward: Any = 0.0
        fed: list[Any] = []
        for i, (block, held) in enumerate(zip(self.feedforward, memory.feedforward, strict=True)):
            held, force = block.step(held, setpoint, T)
            fed.append(held)
            forward = force if i == 0 else forward + force
        # an absent part adds no operation, not even x + 0
        requested = feedback + forward if self.feedforward else feedback
        requested = requested + added if self.compensation else requested
        applied = requested
        if self.force_limit is not None:
            applied = ops.clip(requested, -self.force_limit, self.force_limit)
        if self.velocity_limit is not None:
            applied = ops.clip(requested, -self.velocity_limit, self.velocity_limit)
        command = self.Command(applied, requested, feedback, forward, added, 0.0, 1.0)
        return self.Memory(prefilter, tuple(compensation), law, tuple(filters), tuple(fed)), command


def _less(force: Any, carried: Any) -> Any:
    return force if matrix.is_zero(carried) else force - carried


def _answered(law: Law, before: Any, found: Any) -> tuple[Any, Any]:
    """Check the result of a law's step, a pair of state and force, and return it.  During tracing, the state must keep
    its structure.

    Raises StructureError, with the type or the numbers that the law returned, if the result is not such a pair or the
    state has another structure.
    """
    # exported code calls the second part `found_1`: a local name of traced code is a name in the export (`Names`)
    if not isinstance(found, tuple) or len(found) != 2:  # type: ignore[arg-type]
        raise StructureError(f"{law.kind}: step must return (state, force), not {type(found).__name__}")
    state, force = found
    if isinstance(force, Symbol):
        had, has = ([name for name, _ in tree.leaves(memory)] for memory in (before, state))
        if had != has:
            raise StructureError(
                f"{law.kind}: step returns a state with the numbers {', '.join(has) or 'none'}; start gave one with "
                f"{', '.join(had) or 'none'}, and both must be the same"
            )
    return state, force


def _check_forgetful(memory: Any, path: str) -> None:
    """Raise StructureError if a reset cannot clear the memory, as with a ring buffer outside a `History` or `Track`."""
    if isinstance(memory, Ring):
        raise StructureError(
            f"{path} is a ring, which the reset of the guard does not clear: what it holds from before a trip would "
            f"act after it, with a jump of the force. Keep the past of a signal in a History, or leave the guard out"
        )
    if isinstance(memory, tuple) and not isinstance(memory, History | Track):
        names = getattr(memory, "_fields", None) or range(len(memory))
        for name, part in zip(names, memory, strict=True):
            _check_forgetful(part, f"{path}.{name}")


def _retuned(block: Any, state: Any, old: Any, old_prepared: Any, prepared: Any) -> Any:
    return block.retune(state, old, old_prepared, prepared)

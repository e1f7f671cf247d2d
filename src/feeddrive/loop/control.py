"""All that runs on the real controller: prefilter, law, filter pack, feedforward, limit and guard."""

from __future__ import annotations

from typing import Any, NamedTuple

from feeddrive.blocks.families import Feedforward, Filter, Law, Nothing, Prefilter
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language import ops, tree
from feeddrive.language.block import Block, Number, parameter, part
from feeddrive.loop.guard import Guard


class Control(Block):
    """One sample of the controller; its parts are in the order of the signal.

        setpoint -> prefilter -> law -> filters -> + feedforward -> limit -> force

    Feedforward bypasses the filters.  The force really commanded and the force wanted come back to the law with the
    next reading, as `applied` and `requested`.
    """

    law: Law = part("the feedback law")
    prefilter: Prefilter | None = part("changes the setpoint first", default=None)
    filters: tuple[Filter, ...] = part("filter pack on the feedback force", default=())
    feedforward: tuple[Feedforward, ...] = part("forces added behind the filters", default=())
    force_limit: Number | None = parameter("N", "largest commanded force; absent for no limit", above=0, default=None)
    guard: Guard | None = part("enable, trips and readings that are none", default=None)

    class Prepared(NamedTuple):
        """What law and filters prepared."""

        law: Any
        filters: tuple[Any, ...]

    class Memory(NamedTuple):
        """What a reset brings back to where the axis is."""

        prefilter: Any
        law: Any
        filters: tuple[Any, ...]

    class State(NamedTuple):
        """The memory of the parts, the last command and the guard."""

        memory: Any
        applied: Number  # N
        requested: Number  # N
        guard: Any

    class Command(NamedTuple):
        """Forces in N: commanded, wanted before the limit, its feedback and feedforward parts; and the trip code."""

        applied: Number
        requested: Number
        feedback: Number
        feedforward: Number
        trip: Number

    def prepare(self, T: Number) -> Prepared:
        """Of every part."""
        return self.Prepared(self.law.prepare(T), tuple(part.prepare(T) for part in self.filters))

    def start(self, prepared: Prepared, setpoint: Setpoint, motor: Number, load: Number) -> State:
        """At rest where the axis is, without force."""
        zero = load - load
        guard = Nothing() if self.guard is None else self.guard.start(motor, load)
        return self.State(self._memory(prepared, setpoint, Reading(motor, load, zero, zero)), zero, zero, guard)

    def _memory(self, prepared: Prepared, setpoint: Setpoint, reading: Reading) -> Memory:
        return self.Memory(
            Nothing() if self.prefilter is None else self.prefilter.start(setpoint),
            self.law.start(setpoint, reading),
            tuple(part.start(made, reading.applied) for part, made in zip(self.filters, prepared.filters, strict=True)),
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
        """One sample, from the readings of the two encoders in m to the commanded force in N."""
        if self.guard is None:
            memory, command = self._run(prepared, state.memory, setpoint, self._reading(state, motor, load), T)
            return self.State(memory, command.applied, command.requested, state.guard), command
        guard, verdict = self.guard.step(state.guard, setpoint.position, motor, load, enable, T)
        reading = self._reading(state, verdict.position_motor, verdict.position_load)
        fresh = self._memory(prepared, setpoint, reading)
        live = tree.select(verdict.ran, state.memory, fresh)
        memory, command = self._run(prepared, live, setpoint, reading, T)
        applied = ops.where(verdict.runs, command.applied, 0.0)
        requested = ops.where(verdict.runs, command.requested, 0.0)
        command = command._replace(applied=applied, requested=requested, trip=guard.trip)
        return self.State(memory, applied, requested, guard), command

    def _reading(self, state: State, motor: Number, load: Number) -> Reading:
        return Reading(motor, load, state.applied, state.requested)

    def _run(
        self, prepared: Prepared, memory: Any, setpoint: Setpoint, reading: Reading, T: Number
    ) -> tuple[Memory, Command]:
        """The parts in the order of the signal."""
        prefilter = memory.prefilter
        if self.prefilter is not None:
            prefilter, setpoint = self.prefilter.step(prefilter, setpoint, T)
        law, feedback = self.law.step(prepared.law, memory.law, setpoint, reading, T)
        filters: list[Any] = []
        for filter_, made, held in zip(self.filters, prepared.filters, memory.filters, strict=True):
            held, feedback = filter_.step(made, held, feedback)
            filters.append(held)
        forward: Any = 0.0
        for i, block in enumerate(self.feedforward):
            forward = block.force(setpoint, T) if i == 0 else forward + block.force(setpoint, T)
        requested = feedback + forward if self.feedforward else feedback
        applied = requested
        if self.force_limit is not None:
            applied = ops.clip(requested, -self.force_limit, self.force_limit)
        command = self.Command(applied, requested, feedback, forward, 0.0)
        return self.Memory(prefilter, law, tuple(filters)), command

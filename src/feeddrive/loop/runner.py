"""A program with its numbers, ready to run: one variant, or many in lanes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from feeddrive.blocks.families import Load, Reference
from feeddrive.blocks.signals import Setpoint
from feeddrive.language import tree
from feeddrive.language.recent import Recent
from feeddrive.loop.engine.native import Native, native
from feeddrive.loop.engine.plan import plan
from feeddrive.loop.loop import Loop
from feeddrive.loop.statistics import begin, gathering
from feeddrive.loop.trace import SETPOINT, Program, concrete, numbers, trace

_programs: Recent[Program] = Recent(256)
_natives: Recent[Native] = Recent(256)


class Prepared:
    """A loop with all numbers that a run needs: structure, prepared numbers, first state. Leaves may be arrays."""

    def __init__(
        self,
        loop: Loop,
        setpoint: Setpoint,
        start: tuple[Any, Any] | None = None,
        seed: Any = 0,
        bound: float = 1.0,
        *,
        partial: bool = False,
    ) -> None:
        """`partial` keeps room for a part of a sample of dead time, for a slope to it, also where none is left."""
        self.loop = loop
        self.timing = loop.timing()
        if partial:
            self.timing = self.timing._replace(partial=True)
        plain = self._plain = concrete(loop)
        position, velocity = (setpoint.position, setpoint.velocity) if start is None else start
        with np.errstate(all="ignore"):
            made = plain.prepare(self.timing)
            begun = plain.start(made, self.timing, setpoint, _typed(position), _typed(velocity))
        self._made, self._begun = made, begun
        self.numbers: dict[str, Any] = dict(tree.leaves(plain))
        self.numbers.update(numbers(made, "prepared"))
        self.numbers["seed"] = _typed(seed)
        self.numbers["bound"] = np.float64(bound)
        self.first: dict[str, Any] = dict(tree.leaves(begun))
        self.tables = dict(tree.tables(loop))

    def program(self, *, load: bool, enable: bool, probes: tuple[str, ...] = ()) -> Program:
        """The program of the loop, traced once for all loops of the same structure."""
        key = (tree.structure(self.loop), self.timing, load, enable, probes)

        def traced() -> Program:
            made = trace(self.loop, self._made, self._begun, load=load, enable=enable, probes=probes)
            return replace(made, key=key)

        return _programs.get(key, traced)

    def varying(self) -> frozenset[str]:
        """Names of numbers and states that are arrays over lanes."""
        both = {**self.numbers, **self.first}
        return frozenset(name for name, value in both.items() if isinstance(value, np.ndarray))

    def lanes(self) -> int:
        """How many variants there are; 1 for a single run."""
        both = {**self.numbers, **self.first}
        return max((value.size for value in both.values() if isinstance(value, np.ndarray)), default=1)

    def native(
        self,
        program: Program,
        *,
        record: Sequence[str],
        gather: Sequence[str] = (),
        bounded: str | None = None,
        lanes: int = 1,
        arithmetic: str = "exact",
    ) -> Native:
        """Machine code that records some signals and gathers statistics of others."""
        key = (program.key, tuple(record), tuple(gather), bounded, lanes, self.varying(), arithmetic)

        def made() -> Native:
            chosen = gathering(program, gather, bounded).keeping(record)
            return native(plan(chosen, lanes=lanes, varying=self.varying(), arithmetic=arithmetic))

        return made() if program.key is None else _natives.get(key, made)

    def constants(self, made: Native, lanes: slice | None = None) -> np.ndarray:
        """Constants in the order of the machine code, shape (n, lanes)."""
        return by_lane([name for name, _ in made.plan.constants], self.numbers, made.plan.lanes, lanes)

    def states(self, made: Native, lanes: slice | None = None) -> np.ndarray:
        """First states in the order of the machine code, shape (n, lanes)."""
        first = self.first_states(made)
        return by_lane(list(first), first, made.plan.lanes, lanes)

    def first_states(self, made: Native) -> dict[str, Any]:
        """First states by name, in the order of the machine code."""
        first = {s.name: self.first.get(s.name, None) for s in made.plan.states}
        return {name: begin(name) if value is None else value for name, value in first.items()}

    def retune(self, old: Prepared, made: Native, states: np.ndarray) -> None:
        """The states of the control of a single run after a live change from the loop `old` to this one, in place."""
        before, after = old._plain.control, self._plain.control
        rows = {state.name: i for i, state in enumerate(made.plan.states)}
        chosen = [rows[name] for name, _ in tree.leaves(self._begun.control, "control")]
        state = tree.rebuild(self._begun.control, iter(states[chosen, 0]))
        with np.errstate(all="ignore"):
            state = after.retune(state, before, old._made.control, self._made.control)
        states[chosen, 0] = [value for _, value in tree.leaves(state)]

    def rows(self, made: Native) -> list[np.ndarray]:
        """Tables in the order of the machine code."""
        return [self.tables[name] for name, _ in made.plan.tables]


def _typed(value: Any) -> Any:
    return np.asarray(value, dtype=np.float64) if isinstance(value, (list, np.ndarray)) else np.float64(value)


def by_lane(names: Sequence[str], values: Mapping[str, Any], lanes: int, chosen: slice | None) -> np.ndarray:
    """Numbers by name as rows; the lanes that a group has too many repeat its last variant."""
    out = np.empty((len(names), lanes))
    for row, name in zip(out, names, strict=True):
        value = values[name]
        if isinstance(value, np.ndarray):
            part = value[chosen] if chosen is not None else value
            row[: part.size] = part
            row[part.size :] = part[-1]
        else:
            row[:] = value
    return out


class Work:
    """What a loop is given to do, sampled: setpoints, load force, enable, added force. Any stretch can be asked for."""

    def __init__(
        self,
        loop: Loop,
        reference: Reference,
        load: Load | None = None,
        enable: np.ndarray | None = None,
        added_force: Load | None = None,
    ) -> None:
        self.T = float(loop.sample_time)
        self.reference, self.load, self.enable, self.added_force = reference, load, enable, added_force
        self._first, self._count = 0, 0
        self._rows: list[Any] = []

    def first(self) -> Setpoint:
        """The setpoint at t = 0, as numbers."""
        return Setpoint(*(np.float64(row[0]) for row in self.sampled(0, 1)[: len(SETPOINT)]))

    def positions(self, count: int, most: int) -> np.ndarray:
        """Set positions in m at up to `most` samples, spread over the first `count`."""
        chosen = np.unique(np.linspace(0, count - 1, most).astype(np.int64))
        if self._first == 0 and self._count >= count:
            return self._rows[0][chosen]
        return np.asarray(self.reference.at(chosen * self.T).position)

    def sampled(self, first: int, count: int) -> list[Any]:
        """Setpoint, load force and added force (0 N without one) of some samples as rows; the last stretch is kept."""
        start = first - self._first
        if start < 0 or start + count > self._count:
            t = (first + np.arange(count)) * self.T
            forces = [0.0 if force is None else force.at(t) for force in (self.load, self.added_force)]
            rows = [*self.reference.at(t), *forces]
            self._rows = [np.broadcast_to(row, count) for row in rows]
            self._first, self._count, start = first, count, 0
        return [row[start : start + count] for row in self._rows]

    def inputs(self, made: Native, first: int, count: int) -> np.ndarray:
        """Samples first .. first + count - 1 in the order of the machine code, shape (count, n)."""
        rows = dict(zip((*SETPOINT, "load_force", "added_force"), self.sampled(first, count), strict=True))
        out = np.empty((count, len(made.plan.inputs)))
        for column, (name, _) in enumerate(made.plan.inputs):
            out[:, column] = self._enabled(first, count) if name == "enable" else rows.get(name, 0.0)
        return out

    def _enabled(self, first: int, count: int) -> np.ndarray:
        """The last value holds on."""
        assert self.enable is not None
        return self.enable[np.minimum(first + np.arange(count), len(self.enable) - 1)]


PIECE = 4096  # samples whose inputs and outputs stay in a processor's cache


def recorded(prepared: Prepared, made: Native, work: Work, states: np.ndarray, first: int, count: int) -> np.ndarray:
    """Some samples of a single run from `states` on, which move on; the recorded signals as rows."""
    constants, rows = prepared.constants(made), prepared.rows(made)
    work.sampled(first, count)
    found = np.empty((len(made.plan.outputs), count))
    outputs = np.empty((min(PIECE, count), len(found)))
    for start in range(0, count, PIECE):
        size = min(PIECE, count - start)
        made.run(size, first + start, constants, work.inputs(made, first + start, size), states, outputs, rows)
        found[:, start : start + size] = outputs[:size].T
    return found


@lru_cache(maxsize=1)
def cores() -> int:
    """How many processors this process may use."""
    import os

    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1

"""A compiled program with its values, states and statistics: one variant, or many in lanes on all threads."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from feeddrive.language import ops, tree
from feeddrive.language.graph import Symbol
from feeddrive.language.recent import Recent
from feeddrive.language.ring import Ring, settled
from feeddrive.loop.beginning import Work, beginning, typed
from feeddrive.loop.control import Control
from feeddrive.loop.engine.llvm import Native, native
from feeddrive.loop.engine.plan import plan
from feeddrive.loop.loop import SETPOINT, Loop
from feeddrive.loop.machine import System
from feeddrive.loop.trace import Carried, Program, trace

LEFT = "statistics.left"


def gathered(signal: str, what: str) -> str:
    """Return the name of the state that accumulates `squares` (sum of squares), `least` or `most` of a signal."""
    return f"statistics.{signal}.{what}"


def gathering(program: Program, signals: Sequence[str], bounded: Sequence[str] = ()) -> Program:
    """Return the program extended by the sum of squares, minimum and maximum of signals, from which the peak follows.

    `bounded` names signals; the first sample in which one of them is outside ±`bound` (a constant of the program) is
    stored in `LEFT`, which is -1 until then.  NaN counts as outside.
    """
    graph = program.graph
    states, constants, sample = list(program.states), dict(program.constants), program.sample

    def carry(name: str, after: object) -> None:
        states.append(Carried(name, graph.input(f"state.{name}").index, graph.symbol(after).index))

    for signal in signals:
        value = Symbol(graph, program.outputs[signal])
        before = {what: graph.input(f"state.{gathered(signal, what)}") for what in START}
        carry(gathered(signal, "squares"), before["squares"] + value * value)
        carry(gathered(signal, "least"), ops.minimum(before["least"], value))
        carry(gathered(signal, "most"), ops.maximum(before["most"], value))
    if bounded:
        bound = graph.input("bound")
        constants["bound"] = bound.index
        count = graph.input("sample")
        sample = count.index
        left = graph.input(f"state.{LEFT}")
        inside: Any = None
        for name in bounded:
            one = ops.absolute(Symbol(graph, program.outputs[name])) <= bound
            inside = one if inside is None else ops.both(inside, one)
        carry(LEFT, ops.where(ops.either(inside, left >= 0.0), left, count))
    return replace(program, states=tuple(states), constants=constants, sample=sample)


START = {"squares": 0.0, "least": float("inf"), "most": float("-inf")}


def begin(name: str) -> float:
    """Return the initial value of a statistics state."""
    return -1.0 if name == LEFT else START[name.rsplit(".", 1)[1]]


_programs: Recent[Program] = Recent(256)
_natives: Recent[Native] = Recent(256)


class Prepared:
    """A loop or a machine with all numbers that a run needs: structure, prepared numbers, initial state.

    Leaves may be arrays over variants.  For a machine `setpoint` and `start` are given by axis.
    """

    def __init__(
        self,
        system: System,
        setpoint: Any,
        start: Any = None,
        seed: Any = 0,
        bound: float = 1.0,
        *,
        partial: Collection[str] = (),
    ) -> None:
        """Prepare a run; `start` is (position, velocity).

        `partial` names axes that keep the structure of a fractional dead time even if the fraction is 0, for
        derivatives with respect to the dead time.
        """
        self.system = system
        self._begun = beginning(system, setpoint, start, partial)
        self.timing: Any = self._begun.timing
        self.numbers: dict[str, Any] = {**self._begun.numbers, "seed": typed(seed), "bound": np.float64(bound)}
        self.first: dict[str, Any] = dict(self._begun.first)
        self.tables = self._begun.tables

    def program(
        self,
        *,
        load: bool | Collection[str] = False,
        enable: bool | Collection[str] = False,
        probes: Sequence[str] = (),
    ) -> Program:
        """Return the program of the loop or machine, traced once per structure.

        `load` and `enable` state whether these inputs exist, or on which axes; `probes` names the inputs of `Probe`.
        """
        names = [f"{port}{name}" for port in self.system.ports() for name in SETPOINT]
        for kind, wanted in (("load_force", load), ("enable", enable)):
            there = [axis for axis in self.system.loops() if wanted is True or (wanted and axis in wanted)]
            names += [
                f"{port}{kind}"
                for axis, port in zip(self.system.loops(), self.system.ports(), strict=True)
                if axis in there
            ]
        names += probes
        key = (self._begun.structure, self.timing, tuple(names))

        def traced() -> Program:
            _, prepared, begun = self._begun.trees
            return replace(trace(self.system, prepared, begun, names), key=key)

        return _programs.get(key, traced)

    def settled(self) -> dict[str, Any]:
        """Return the initial states by name, including rings, in the limit of infinite time at constant inputs."""
        return dict(tree.leaves(settled(self._begun.trees.begun)))

    def varying(self) -> frozenset[str]:
        """Return the names of numbers and states that are arrays over lanes."""
        varying = self._begun.varying
        return varying | {"seed"} if isinstance(self.numbers["seed"], np.ndarray) else varying

    def lanes(self) -> int:
        """Return the number of variants; 1 for a single run."""
        rows = (self.numbers[name] if name in self.numbers else self.first[name] for name in self.varying())
        return max((row.size for row in rows), default=1)

    def native(
        self,
        program: Program,
        *,
        record: Sequence[str],
        gather: Sequence[str] = (),
        bounded: Sequence[str] = (),
        lanes: int = 1,
        arithmetic: str = "exact",
    ) -> Native:
        """Return machine code that records some signals and accumulates statistics of others."""
        key = (program.key, tuple(record), tuple(gather), tuple(bounded), lanes, self.varying(), arithmetic)

        def compiled() -> Native:
            chosen = gathering(program, gather, bounded).keeping(record)
            return native(plan(chosen, lanes=lanes, varying=self.varying(), arithmetic=arithmetic))

        return compiled() if program.key is None else _natives.get(key, compiled)

    def constants(self, code: Native, lanes: slice | None = None) -> np.ndarray:
        """Return the constants in the order of the machine code, shape (n, lanes)."""
        return by_lane([name for name, _ in code.plan.constants], self.numbers, code.plan.lanes, lanes)

    def states(self, code: Native, lanes: slice | None = None) -> np.ndarray:
        """Return the initial states in the order of the machine code, shape (n, lanes)."""
        first = self.first_states(code)
        return by_lane(list(first), first, code.plan.lanes, lanes)

    def first_states(self, code: Native) -> dict[str, Any]:
        """Return the initial states by name, in the order of the machine code; the cells of rings are 0."""
        first = {s.name: self.first.get(s.name, None) for s in code.plan.states}
        named = {name: begin(name) if value is None else value for name, value in first.items()}
        return named | dict.fromkeys(code.plan.memory[len(named) :], 0.0)

    def retune(self, old: Prepared, code: Native, states: np.ndarray) -> None:
        """Update the states of a single run's controls after a live change from `old` to this one, in place."""
        rows = {state.name: i for i, state in enumerate(code.plan.states)}
        for now, before in zip(self._controls(), old._controls(), strict=True):
            begun = now.begun
            held = (v if isinstance(v, Ring) else states[rows[name], 0] for name, v in tree.leaves(begun, now.path))
            state = tree.rebuild(begun, held)
            with np.errstate(all="ignore"):
                state = now.control.retune(state, before.control, before.prepared, now.prepared)
            for name, value in tree.leaves(state, now.path):  # cells of a ring stay as they are
                if not isinstance(value, Ring):
                    states[rows[name], 0] = value

    def _controls(self) -> list[_Running]:
        """Return each control with its prepared numbers and its initial state."""
        plain, all_prepared, begun = self._begun.trees
        if isinstance(plain, Loop):
            return [_Running("control", plain.control, all_prepared.control, begun.control)]
        rows = zip(plain.axes().items(), all_prepared.control, begun.axis, strict=True)
        return [
            _Running(f"axis.{name}.control", axis.control, prepared, begun.control)
            for (name, axis), prepared, begun in rows
        ]

    def rows(self, code: Native) -> list[np.ndarray]:
        """Return the tables in the order of the machine code."""
        return [self.tables[name] for name, _ in code.plan.tables]


def by_lane(names: Sequence[str], values: Mapping[str, Any], lanes: int, chosen: slice | None) -> np.ndarray:
    """Return numbers by name as rows over lanes; surplus lanes of a group repeat its last variant."""
    if lanes == 1 and chosen is None:
        columns = [values[name] for name in names]
        if np.ndarray not in map(type, columns):
            return np.array(columns, dtype=np.float64).reshape(-1, 1)
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


class _Running(NamedTuple):
    """A control, the path of its state, its prepared numbers and its initial state."""

    path: str
    control: Control
    prepared: Any
    begun: Any


STRETCH = 65_536  # samples whose inputs are in memory at once


def recorded(prepared: Prepared, code: Native, work: Work, states: np.ndarray, first: int, count: int) -> np.ndarray:
    """Compute some samples of a single run and update `states`; return the recorded signals, shape (count, signals)."""
    constants, rows = prepared.constants(code), prepared.rows(code)
    work.sample(first, count)
    record = np.empty((count, len(code.plan.outputs)))
    for start in range(0, count, STRETCH):
        size = min(STRETCH, count - start)
        inputs = work.inputs(code, first + start, size)
        code.run(size, first + start, constants, inputs, states, record[start : start + size], rows)
    return record


@lru_cache(maxsize=1)
def cores() -> int:
    """Return the number of processors that this process may use."""
    import os

    # a container or an affinity mask may leave fewer cores than the computer has
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


WIDTHS = (8, 16, 32)
# Samples of all variants together from which on wider vectors, and a trial of them, pay for being compiled.
WIDE, TRIED = 5_000_000, 100_000_000
_TRIAL = 400  # samples
_fastest: Recent[int] = Recent(64)  # by the source of the narrowest machine code


class Groups:
    """The variants of a prepared loop in groups of lanes; the last group is filled up with its last variant."""

    def __init__(self, prepared: Prepared, code: Native, variants: int) -> None:
        self.code, self.variants, self.lanes = code, variants, code.plan.lanes
        self.constants = _dealt([name for name, _ in code.plan.constants], prepared.numbers, self.lanes, variants)
        first = prepared.first_states(code)
        self.states = _dealt(list(first), first, self.lanes, variants)
        self.rows = prepared.rows(code)

    def advance(self, pool: Executor, first: int, inputs: np.ndarray) -> Iterator[int]:
        """Advance all groups over the same range of samples; yield the number of finished variants of each group."""

        def one(group: int) -> int:
            self._run(group, first, inputs, self.states[group])
            return min(self.lanes, self.variants - group * self.lanes)

        yield from pool.map(one, range(len(self.states)))

    def _run(self, group: int, first: int, inputs: np.ndarray, states: np.ndarray) -> None:
        self.code.run(len(inputs), first, self.constants[group], inputs, states, None, self.rows)

    def ends(self) -> dict[str, np.ndarray]:
        """Return the states by name, each of shape (variants,)."""
        flat = np.moveaxis(self.states, 0, 1).reshape(self.states.shape[1], -1)[:, : self.variants]
        return {state.name: row for state, row in zip(self.code.plan.states, flat, strict=False)}

    def trial(self, inputs: np.ndarray) -> float:
        """Return the computing time in s per variant over a short stretch, the least of three; states are unchanged."""
        spans: list[float] = []
        for _ in range(3):
            states = self.states[0].copy()
            begun = time.perf_counter()
            self._run(0, 0, inputs[:_TRIAL], states)
            spans.append(time.perf_counter() - begun)
        # the least: other work on the computer only adds time
        return min(spans) / self.lanes


def grouped(
    prepared: Prepared,
    native: Callable[[int], Native],
    lanes: int | None,
    samples: int,
    inputs: Callable[[Native], np.ndarray],
) -> Groups:
    """Return the variants in groups of `lanes`; None takes the fastest number on this computer.

    Results are bit-identical for any number.  `native(lanes)` returns the machine code and `inputs(native)` the first
    samples; trial runs are made once per structure, and only if the work is long enough to justify them.
    """
    variants = prepared.lanes()
    if lanes is not None or variants == 1:
        return Groups(prepared, native(lanes or 1), variants)
    work = variants * samples
    # vectors of which more than half is used
    fitting = [width for width in WIDTHS if width < 2 * variants] or [WIDTHS[0]]
    if work < WIDE:
        return Groups(prepared, native(fitting[0]), variants)
    if work < TRIED or len(fitting) < 3:
        return Groups(prepared, native(fitting[min(1, len(fitting) - 1)]), variants)
    programs = [native(width) for width in fitting]

    def tried() -> int:
        stretch = inputs(programs[0])
        return min(range(len(programs)), key=lambda i: Groups(prepared, programs[i], fitting[i]).trial(stretch))

    return Groups(prepared, programs[_fastest.get(programs[0].key, tried)], variants)


def _dealt(names: Sequence[str], values: Mapping[str, Any], lanes: int, variants: int) -> np.ndarray:
    """Return numbers by name for all groups, shape (groups, names, lanes)."""
    groups = -(-variants // lanes)
    out = np.empty((groups, len(names), lanes))
    for i, name in enumerate(names):
        value = values[name]
        if isinstance(value, np.ndarray):
            padded = np.append(value[: groups * lanes], np.repeat(value[-1], max(0, groups * lanes - value.size)))
            value = padded.reshape(groups, lanes)
        out[:, i] = value
    return out

"""A runner: a compiled program with its parameter values and states, for one variant or many in lanes."""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from dataclasses import replace
from functools import cache, lru_cache
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from feeddrive.blocks.families import Load, Reference
from feeddrive.blocks.signals import Setpoint
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.language.recent import Recent
from feeddrive.language.ring import Ring, settled
from feeddrive.loop.control import Control
from feeddrive.loop.engine.native import Native, native
from feeddrive.loop.engine.plan import plan
from feeddrive.loop.hold import Hold
from feeddrive.loop.loop import SETPOINT, Loop
from feeddrive.loop.machine import Machine
from feeddrive.loop.statistics import begin, gathering
from feeddrive.loop.trace import Program, concrete, numbers, trace

System: TypeAlias = Loop | Machine  # what is traced to a program


class _Begun(NamedTuple):
    """What a run begins with: structure, what was prepared, first state, and the numbers of each by name."""

    timing: Any
    plain: Any
    made: Any
    begun: Any
    numbers: dict[str, Any]
    first: dict[str, Any]
    tables: dict[str, Any]
    structure: Hashable


_programs: Recent[Program] = Recent(256)
_natives: Recent[Native] = Recent(256)
_holds: Recent[Hold] = Recent(256)
_beginnings: Recent[_Begun] = Recent(256)
_KEPT = 200_000  # samples of a reference that are kept at most, for the next run along it
_references: Recent[Any] = Recent(8)
_inputs: Recent[np.ndarray] = Recent(8)


class Prepared:
    """A loop or a machine with all numbers that a run needs: structure, prepared numbers, first state.

    Leaves may be arrays over variants.  Of a machine `setpoint` and `start` are given by axis.
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
        """`start` is (position, velocity).

        `partial` names axes that keep a fraction of a sample of dead time, for a derivative to it, also where none is
        left.
        """
        self.system = system
        key = _key((system, setpoint)) if isinstance(system, Loop) and start is None else None
        if key is None:
            found = _begin(system, setpoint, start, partial)
        else:  # whether a number is a float or a numpy number matters to a trace
            whole = key, tuple(map(type, setpoint)), frozenset(partial)
            found = _beginnings.get(whole, lambda: _begin(system, setpoint, start, partial))
        self.timing: Any = found.timing
        self._plain: System = found.plain
        self._made, self._begun = found.made, found.begun
        self.numbers: dict[str, Any] = {**found.numbers, "seed": _typed(seed), "bound": np.float64(bound)}
        self.first: dict[str, Any] = dict(found.first)
        self.tables = found.tables
        self._structure = found.structure

    def program(
        self,
        *,
        load: bool | Collection[str] = False,
        enable: bool | Collection[str] = False,
        probes: Sequence[str] = (),
    ) -> Program:
        """The program of the loop or machine, traced once for all of the same structure.

        `load` and `enable` say whether there are these inputs, or on which axes; `probes` which inputs of `Probe`.
        """
        names = [f"{port}{name}" for port in self.system.ports() for name in SETPOINT]
        for kind, wanted in (("load_force", load), ("enable", enable)):
            there = [axis for axis in self.system.loops() if wanted is True or (wanted and axis in wanted)]
            names += [f"{port}{kind}" for axis, port in zip(self.system.loops(), self.system.ports(), strict=True)
                      if axis in there]  # fmt: skip
        names += probes
        key = (self._structure, self.timing, tuple(names))

        def traced() -> Program:
            return replace(trace(self.system, self._made, self._begun, names), key=key)

        return _programs.get(key, traced)

    def settled(self) -> dict[str, Any]:
        """First states by name, with rings, as after an infinitely long time at constant inputs."""
        return dict(tree.leaves(settled(self._begun)))

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
        bounded: Sequence[str] = (),
        lanes: int = 1,
        arithmetic: str = "exact",
    ) -> Native:
        """Machine code that records some signals and gathers statistics of others."""
        key = (program.key, tuple(record), tuple(gather), tuple(bounded), lanes, self.varying(), arithmetic)

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
        """First states by name, in the order of the machine code; the cells of rings are 0."""
        first = {s.name: self.first.get(s.name, None) for s in made.plan.states}
        named = {name: begin(name) if value is None else value for name, value in first.items()}
        return named | dict.fromkeys(made.plan.memory[len(named) :], 0.0)

    def retune(self, old: Prepared, made: Native, states: np.ndarray) -> None:
        """The states of the controls of a single run after a live change from `old` to this one, in place."""
        rows = {state.name: i for i, state in enumerate(made.plan.states)}
        for now, before in zip(self._controls(), old._controls(), strict=True):
            begun = now.begun
            held = (v if isinstance(v, Ring) else states[rows[name], 0] for name, v in tree.leaves(begun, now.path))
            state = tree.rebuild(begun, held)
            with np.errstate(all="ignore"):
                state = now.control.retune(state, before.control, before.made, now.made)
            for name, value in tree.leaves(state, now.path):  # cells of a ring stay as they are
                if not isinstance(value, Ring):
                    states[rows[name], 0] = value

    def _controls(self) -> list[_Running]:
        """Each control with its prepared numbers and its first state."""
        plain = self._plain
        if isinstance(plain, Loop):
            return [_Running("control", plain.control, self._made.control, self._begun.control)]
        rows = zip(plain.axes().items(), self._made.control, self._begun.axis, strict=True)
        return [_Running(f"axis.{name}.control", each.control, made, begun.control)
                for (name, each), made, begun in rows]  # fmt: skip

    def rows(self, made: Native) -> list[np.ndarray]:
        """Tables in the order of the machine code."""
        return [self.tables[name] for name, _ in made.plan.tables]


def _begin(system: Any, setpoint: Any, start: Any, partial: Collection[str]) -> _Begun:
    """What a loop or machine prepares, and its first state."""
    timing = system.timing(partial)
    plain = concrete(system)
    if start is None:
        start = each_axis(lambda at: (at.position, at.velocity), setpoint)
    position, velocity = (each_axis(lambda at, i=i: _typed(at[i]), start) for i in (0, 1))
    with np.errstate(all="ignore"):
        made = _prepared(plain, timing)
        begun = plain.start(made, timing, setpoint, position, velocity)
    named = dict(tree.leaves(plain))
    named.update(numbers(made, "prepared"))
    first = {name: v for name, v in tree.leaves(begun) if not isinstance(v, Ring)}
    return _Begun(timing, plain, made, begun, named, first, dict(tree.tables(system)), tree.structure(system))


def _typed(value: Any) -> Any:
    return np.asarray(value, dtype=np.float64) if isinstance(value, (list, np.ndarray)) else np.float64(value)


def by_lane(names: Sequence[str], values: Mapping[str, Any], lanes: int, chosen: slice | None) -> np.ndarray:
    """Numbers by name as rows; the lanes that a group has too many repeat its last variant."""
    if lanes == 1 and chosen is None:
        found = [values[name] for name in names]
        if not any(isinstance(value, np.ndarray) for value in found):
            return np.array(found, dtype=np.float64).reshape(-1, 1)
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
    """A control, the path of its state, its prepared numbers and its first state."""

    path: str
    control: Control
    made: Any
    begun: Any


def _prepared(plain: Any, timing: Any) -> Any:
    """What a loop or machine prepares; the hold of an axis that did not change since is kept."""
    if not isinstance(plain, Loop):
        return plain.prepare(timing)
    axis, T = plain.axis, plain.sample_time
    core = (axis.plant, axis.actuator, axis.friction_motor, axis.friction_load)
    key = _key(core)
    if key is None:
        return plain.prepare(timing)
    hold = _holds.get((key, axis.substeps, T, timing), lambda: axis.prepare(T, timing))
    return plain.Prepared(plain.control.prepare(T), hold)


def _key(held: Any) -> Hashable:
    """Structure of blocks and all bits of their numbers; None with tables or lanes, of which nothing is kept."""
    structure, values = tree.structure_and_values(held)
    if any(isinstance(value, np.ndarray) for value in values):
        return None
    return structure, np.array(values, dtype=np.float64).tobytes()


def each_axis(function: Callable[[Any], Any], given: Any) -> Any:
    """A function of what a loop is given, or for each axis of what a machine is given."""
    return {name: function(one) for name, one in given.items()} if isinstance(given, Mapping) else function(given)


class Work:
    """The sampled inputs of a run: setpoints, load force, enable, added force, for any range of samples.

    Of a machine each is a mapping from axes to what they are given; an axis that is not there has no such force.
    """

    def __init__(
        self,
        system: System,
        reference: Reference | Mapping[str, Reference],
        load: Load | Mapping[str, Load] | None = None,
        enable: np.ndarray | Mapping[str, np.ndarray] | None = None,
        added_force: Load | Mapping[str, Load] | None = None,
    ) -> None:
        self.T = float(system.sample_time)
        self._single = isinstance(system, Loop)
        self._ports = dict(zip(system.loops(), system.ports(), strict=True))
        given = [self._by_axis(each, what) for each, what in (
            (reference, "reference"), (load, "load"), (enable, "enable"), (added_force, "added_force"))]  # fmt: skip
        self.reference, self.load, self.enable, self.added_force = given
        missing = [axis for axis in self._ports if axis not in self.reference]
        if missing:
            raise ParameterError(f"reference: axis {', '.join(missing)} has none; one that stands is a move by 0 m")
        self._first, self._count = 0, 0
        self._rows: dict[str, Any] = {}
        self._key: Hashable = None  # of a stretch that is a function of it

    def _by_axis(self, given: Any, what: str) -> dict[str, Any]:
        if self._single:
            return {} if given is None else dict.fromkeys(self._ports, given)
        if given is not None and not isinstance(given, Mapping):
            raise ParameterError(f"{what}: a machine takes one for each axis, by name: {', '.join(self._ports)}")
        unknown = [axis for axis in given or {} if axis not in self._ports]
        if unknown:
            raise ParameterError(
                f"{what}: the machine has no axis {', '.join(unknown)}; it has {', '.join(self._ports)}"
            )
        return dict(given or {})

    @property
    def duration(self) -> float:
        """Of the longest reference, s."""
        return max(each.duration for each in self.reference.values())

    def first(self) -> Any:
        """The setpoint at t = 0, as numbers; of a machine by axis."""
        rows = self.sampled(0, 1)
        found = {
            axis: Setpoint(*(np.float64(rows[f"{port}{name}"][0]) for name in SETPOINT))
            for axis, port in self._ports.items()
        }
        return next(iter(found.values())) if self._single else found

    def travel(self, count: int, most: int) -> float:
        """The longest travel of an axis in m, seen at up to `most` samples, spread over the first `count`."""
        chosen = _spread(count, most)
        if self._first == 0 and self._count >= count:
            seen = [self._rows[f"{port}set_position"][chosen] for port in self._ports.values()]
        else:
            seen = [np.asarray(each.at(chosen * self.T).position) for each in self.reference.values()]
        return max(float(np.ptp(each)) for each in seen)

    def sampled(self, first: int, count: int) -> dict[str, Any]:
        """Setpoints, load and added forces (0 N without one) of some samples by name; the last stretch is kept."""
        start = first - self._first
        if start < 0 or start + count > self._count:
            t = cache(lambda: (first + np.arange(count)) * self.T)
            self._rows = {}
            for axis, port in self._ports.items():
                rows = dict(zip(SETPOINT, self._setpoints(self.reference[axis], t, first, count), strict=True))
                for name, forces in (("load_force", self.load), ("added_force", self.added_force)):
                    rows[name] = forces[axis].at(t()) if axis in forces else 0.0
                for name, row in rows.items():
                    self._rows[f"{port}{name}"] = row if np.shape(row) == (count,) else np.broadcast_to(row, count)
            self._first, self._count, start = first, count, 0
        if start == 0 and count == self._count:
            return dict(self._rows)
        return {name: row[start : start + count] for name, row in self._rows.items()}

    def _setpoints(self, reference: Reference, t: Callable[[], np.ndarray], first: int, count: int) -> Any:
        """The setpoints of a reference; those of a whole run are kept: the next one often follows the same path."""
        self._key = None
        kept = first == 0 and 1 < count <= _KEPT
        key = _key(reference) if kept else None
        if key is None:
            return reference.at(t())
        if self._single and not (self.load or self.enable or self.added_force):
            self._key = (key, count, self.T)
        return _references.get((key, count, self.T), lambda: reference.at(t()))

    def inputs(self, made: Native, first: int, count: int) -> np.ndarray:
        """Samples first .. first + count - 1 in the order of the machine code, shape (count, n); not to be written."""
        if self._key is not None and self._first == 0 and first + count <= self._count:
            names = tuple(name for name, _ in made.plan.inputs)
            whole = _inputs.get((self._key, names), lambda: self._input_rows(made, 0, self._count))
            return whole[first : first + count]
        return self._input_rows(made, first, count)

    def _input_rows(self, made: Native, first: int, count: int) -> np.ndarray:
        rows = self.sampled(first, count)
        for axis, enable in self.enable.items():  # the last value holds on
            rows[f"{self._ports[axis]}enable"] = enable[np.minimum(first + np.arange(count), len(enable) - 1)]
        out = np.empty((count, len(made.plan.inputs)))
        for column, (name, _) in enumerate(made.plan.inputs):
            out[:, column] = rows.get(name, 0.0)
        out.flags.writeable = False
        return out


@lru_cache(maxsize=64)
def _spread(count: int, most: int) -> np.ndarray:
    """Up to `most` of the first `count` samples, the first and the last among them."""
    return np.unique(np.linspace(0, count - 1, most).astype(np.int64))


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

"""A compiled program with its values, states and statistics: one variant, or many variants on all threads.

A thread computes several variants at once, each in one lane of a vector.

A run begins with its sampled inputs, precomputed coefficients and initial state.
Coefficients and initial state come from the same source, `prepare` and `start` of the blocks.  The first runs of a
structure compute them in Python, which is faster than compiling code that runs once; later runs use the compiled graph,
with bit-identical results.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Hashable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import cache, cached_property, lru_cache
from itertools import pairwise
from typing import Any, NamedTuple, cast

import numpy as np

from feeddrive.blocks.families import Load, Reference
from feeddrive.blocks.reference.stretches import Piece, Stretch, Way, rest
from feeddrive.blocks.signals import Setpoint
from feeddrive.language import ops, tree
from feeddrive.language.block import Number
from feeddrive.language.errors import ParameterError
from feeddrive.language.graph import Graph, Symbol
from feeddrive.language.recent import Recent
from feeddrive.language.ring import Ring, settled
from feeddrive.loop.control import Control
from feeddrive.loop.engine.llvm import Native, native
from feeddrive.loop.engine.plan import plan
from feeddrive.loop.hold import Hold
from feeddrive.loop.loop import SETPOINT, Loop
from feeddrive.loop.machine import System
from feeddrive.loop.trace import Carried, Program, concrete, evaluate, numbers, trace

_KEPT = 200_000  # longest reference, in samples, that is cached for the next run along it
_references: Recent[Path] = Recent(8)
_SHORT = 1000  # samples; fewer are left to numpy
# Samples that numpy computes before the sampler is compiled: compiling takes about as long as so many of them.
_PAYS_AFTER = 100_000
_sampled_by_numpy = [0]


class Path:
    """The sampled setpoints of an axis, shape (5, samples), read-only."""

    def __init__(self, rows: np.ndarray) -> None:
        self.rows = rows
        self._travels: dict[int, float] = {}

    def travel(self, most: int) -> float:
        """Return the travel in m, evaluated at up to `most` samples."""
        if most not in self._travels:
            self._travels[most] = travel(self.rows[0, _spread(self.rows.shape[1], most)])
        return self._travels[most]


class Work:
    """The sampled inputs of a run for any range of samples: setpoints, load force, enable, added force.

    For a machine each of them is a mapping by axis; an axis without an entry for a force has no such force.
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
        by_axis = [
            self._by_axis(value, what)
            for value, what in (
                (reference, "reference"),
                (load, "load"),
                (enable, "enable"),
                (added_force, "added_force"),
            )
        ]
        self.reference, self.load, self.enable, self.added_force = by_axis
        missing = [axis for axis in self._ports if axis not in self.reference]
        if missing:
            raise ParameterError(f"reference: axis {', '.join(missing)} has none; an axis at rest needs a move by 0 m")
        self._first, self._count = 0, 0
        self._paths: dict[str, Path] = {}  # by axis
        self._forces: dict[str, np.ndarray] = {}  # by the name of the input

    def _by_axis(self, argument: Any, what: str) -> dict[str, Any]:
        if self._single:
            if what == "reference" and not isinstance(argument, Reference):
                kind = type(argument).__name__
                raise ParameterError(
                    f"reference: a block such as SnapLimitedMove, or Recorded for an array, not a {kind}"
                )
            return {} if argument is None else dict.fromkeys(self._ports, argument)
        if argument is not None and not isinstance(argument, Mapping):
            raise ParameterError(f"{what}: a machine takes one for each axis, by name: {', '.join(self._ports)}")
        unknown = [axis for axis in argument or {} if axis not in self._ports]
        if unknown:
            raise ParameterError(
                f"{what}: the machine has no axis {', '.join(unknown)}; it has {', '.join(self._ports)}"
            )
        return dict(argument or {})

    @property
    def duration(self) -> float:
        """The duration of the longest reference, s."""
        return max(reference.duration for reference in self.reference.values())

    def first(self) -> Any:
        """Return the setpoint at t = 0, as numbers; for a machine by axis."""
        if self._first != 0 or self._count == 0:
            self.sample(0, 1)
        setpoints = {axis: Setpoint(*path.rows[:, 0]) for axis, path in self._paths.items()}
        return next(iter(setpoints.values())) if self._single else setpoints

    def travel(self, count: int, most: int) -> float:
        """Return the largest travel of any axis in m, evaluated at up to `most` of the first `count` samples."""
        if self._first == 0 and self._count == count:
            return max(path.travel(most) for path in self._paths.values())
        return max(
            travel(reference.at(_spread(count, most) * self.T).position) for reference in self.reference.values()
        )

    def sample(self, first: int, count: int) -> slice:
        """Sample the inputs over a range unless the cached range contains it; return the range as a slice of the cached
        one.
        """
        start = first - self._first
        if start < 0 or start + count > self._count:
            # computed on first use: a cached path does not need it
            t = cache(lambda: (first + np.arange(count)) * self.T)
            self._paths = {axis: self._along(self.reference[axis], t, first, count) for axis in self._ports}
            self._forces = {
                f"{port}{name}": np.broadcast_to(forces[axis].at(t()), count)
                for axis, port in self._ports.items()
                for name, forces in (("load_force", self.load), ("added_force", self.added_force))
                if axis in forces
            }
            self._first, self._count, start = first, count, 0
        return slice(start, start + count)

    def sampled(self, first: int, count: int) -> dict[str, Any]:
        """Return setpoints, load and added forces (0 N if absent) by name over a range of samples; the last
        range is cached.
        """
        held, inputs = self.sample(first, count), {}
        for axis, port in self._ports.items():
            inputs |= {f"{port}{name}": row[held] for name, row in zip(SETPOINT, self._paths[axis].rows, strict=True)}
            for name in (f"{port}load_force", f"{port}added_force"):
                inputs[name] = self._forces[name][held] if name in self._forces else np.broadcast_to(0.0, count)
        return inputs

    def _along(self, reference: Reference, t: Callable[[], np.ndarray], first: int, count: int) -> Path:
        """Return the setpoints of a reference; those of a whole run are cached for further runs along the same path."""
        place = key(reference) if first == 0 and 1 < count <= _KEPT else None
        if place is None:
            return self._fresh(reference, t, first, count)
        return _references.get((place, count, self.T), lambda: self._fresh(reference, t, first, count))

    def _fresh(self, reference: Reference, t: Callable[[], np.ndarray], first: int, count: int) -> Path:
        """Sample the setpoints of a reference, without using the cache."""
        stretches = reference.stretches() if count >= _SHORT else ()
        if stretches and _sampled_by_numpy[0] > _PAYS_AFTER:
            out = _by_stretches(stretches, self.T, first, count)
        else:
            _sampled_by_numpy[0] += count if stretches else 0
            out = np.empty((len(SETPOINT), count))
            for row, values in zip(out, reference.at(t()), strict=True):
                row[:] = values
        # cached for other runs, which must not change it
        out.flags.writeable = False
        return Path(out)

    def inputs(self, code: Native, first: int, count: int) -> np.ndarray:
        """Return the inputs of samples first .. first + count - 1 in the order of the machine code, shape (count, n),
        read-only.
        """
        names = tuple(name for name, _ in code.plan.inputs)
        begin = SETPOINT.index(names[0]) if self._single and names and names[0] in SETPOINT else 0
        # setpoints alone, in their order: a view of the sampled rows, no copy
        if self._single and names == SETPOINT[begin : begin + len(names)]:
            stretch = self.sample(first, count)
            (path,) = self._paths.values()
            return path.rows[begin : begin + len(names), stretch].T
        rows = self.sampled(first, count)
        # the last value holds until the end of the run
        for axis, enable in self.enable.items():
            rows[f"{self._ports[axis]}enable"] = enable[np.minimum(first + np.arange(count), len(enable) - 1)]
        out = np.empty((len(names), count))
        for row, name in zip(out, names, strict=True):
            row[:] = rows.get(name, 0.0)
        out.flags.writeable = False
        return out.T


def _by_stretches(stretches: Sequence[Stretch], T: float, first: int, count: int) -> np.ndarray:
    """Compute the setpoints of samples first .. first + count - 1 by machine code, bit-identical to numpy."""
    sampler, out = _sampler(), np.empty((count, len(SETPOINT)))
    rows = np.array([(*way, *piece, T) for way, piece in stretches])
    way, piece = len(Way._fields), len(Way._fields) + len(Piece._fields)
    columns = rows.T[:, :, None]
    # the rounded quotient gives the first sample of a stretch to within one: the test of the stretch itself decides
    near = np.ceil((rows[:, 0] + rows[:, way]) / T)
    times: Any = (near[:, None] + (-1.0, 0.0, 1.0)) * T
    held = Stretch(Way(*columns[:way]), Piece(*columns[way:piece])).holds(times)
    begins = np.clip(near + 2.0 - np.sum(held, axis=1) - first, 0.0, count).astype(np.int64)
    # the first stretch holds before its begin, too
    begins[0] = 0
    constants, outputs = rows.ctypes.data, out.ctypes.data
    for place, (low, high) in enumerate(pairwise([*begins.tolist(), count])):
        if low < high and stretches[place].way.lasts == 0.0:
            out[low:high].fill(0.0)
            out[low:high, 0].fill(stretches[place].way.first)
        elif low < high:
            memory = constants + place * rows.strides[0], 0, 0, outputs + low * out.strides[0], 0
            sampler.run_at(high - low, first + low, memory, (0, 0))
    return out.T


@lru_cache(maxsize=1)
def _sampler() -> Native:
    """Return machine code for the setpoints of one stretch, with its parameters and the sample time as constants."""
    graph = Graph()
    leaves = [name for name, _ in tree.leaves(rest(0.0, 0.0))]
    stretch = tree.rebuild(rest(0.0, 0.0), (graph.input(name) for name in leaves))
    sample, T = graph.input("sample"), graph.input("sample_time")
    setpoint = stretch.at(cast(Number, sample * T))
    program = Program(
        graph=graph,
        constants={name: graph.input(name).index for name in (*leaves, "sample_time")},
        inputs={},
        states=(),
        outputs={name: graph.symbol(value).index for name, value in zip(SETPOINT, setpoint, strict=True)},
        sample=sample.index,
        tables={},
    )
    # numpy keeps subnormal numbers, and both samplers must give the same bits
    return native(plan(program), flush=False)


def travel(positions: Any) -> float:
    """Return the difference between the largest and the smallest position."""
    return float(np.ptp(positions))


@lru_cache(maxsize=64)
def _spread(count: int, most: int) -> np.ndarray:
    """Return the indices of up to `most` of the first `count` samples, including the first and the last."""
    return np.unique(np.linspace(0, count - 1, most).astype(np.int64))


# Starts with new numbers that are computed in Python before machine code is compiled: compiling takes about as long as
# so many of them.
PAYS_AFTER = 12


class Trees(NamedTuple):
    """A system with numpy numbers as leaves, its precomputed coefficients, and its initial state."""

    plain: Any
    prepared: Any
    begun: Any


class Beginning:
    """The data for the start of a run: delay structure, numbers and initial states by name, tables and structure."""

    def __init__(
        self,
        timing: Any,
        numbers: dict[str, Any],
        first: dict[str, Any],
        tables: dict[str, Any],
        structure: Hashable,
        trees: Callable[[], Trees],
    ) -> None:
        self.timing, self.numbers, self.first = timing, numbers, first
        self.tables, self.structure, self._trees = tables, structure, trees

    @cached_property
    def trees(self) -> Trees:
        """The numbers and initial states as trees, needed only for a trace or a live change."""
        return self._trees()

    @cached_property
    def varying(self) -> frozenset[str]:
        """The names of numbers and initial states that are arrays over variants."""
        both = {**self.numbers, **self.first}
        return frozenset(name for name, value in both.items() if isinstance(value, np.ndarray))


class _Structure:
    """The number of starts of one loop structure with new parameter values, and its compiled code, if any."""

    def __init__(self) -> None:
        self.begun = 0
        self.code: NativeBeginning | None = None


_holds: Recent[Hold] = Recent(256)
_beginnings: Recent[Beginning] = Recent(256)
_structures: Recent[_Structure] = Recent(64)


def beginning(system: System, setpoint: Any, start: Any, partial: Collection[str]) -> Beginning:
    """Return the data for the start of a run; `start` is (position, velocity), by default those of the setpoint.

    The result is cached and reused by the next run with the same parameter values, setpoint and start. It is not cached
    for machines, for loops with tables, or for batches of variants.
    """
    if start is None:
        start = each_axis(lambda at: (at.position, at.velocity), setpoint)
    position, velocity = (each_axis(lambda at, i=i: typed(at[i]), start) for i in (0, 1))

    def by_python() -> Beginning:
        return _by_python(system, setpoint, position, velocity, partial)

    if not isinstance(system, Loop):
        return by_python()
    shape, values = tree.structure_and_values(system)
    row = _bits([*values, position, velocity, *setpoint])
    if row is None:
        return by_python()
    # whether a number is a float or a numpy number matters to a trace
    key = shape, tuple(map(type, setpoint)), frozenset(partial)

    def built() -> Beginning:
        timing = system.timing(partial)
        seen = _structures.get((*key, timing), _Structure)
        seen.begun += 1
        if seen.begun <= PAYS_AFTER:
            return by_python()
        if seen.code is None:
            seen.code = NativeBeginning(system, timing, row)
        trees = seen.code.run(row)
        if trees is None:
            # these numbers need more iterations than those of the trace: one without a limit serves all that follow
            seen.code = NativeBeginning(system, timing, None)
            trees = cast(tuple[dict[str, Any], dict[str, Any]], seen.code.run(row))
        return Beginning(timing, *trees, {}, shape, lambda: by_python().trees)

    return _beginnings.get((key, row.tobytes()), built)


def _by_python(system: Any, setpoint: Any, position: Any, velocity: Any, partial: Collection[str]) -> Beginning:
    """Return the precomputed coefficients and the initial state of a loop or machine, computed in Python."""
    timing = system.timing(partial)
    plain = concrete(system)
    with np.errstate(all="ignore"):
        prepared = _prepared(plain, timing)
        begun = plain.start(prepared, timing, setpoint, position, velocity)
    named = dict(tree.leaves(plain))
    named.update(numbers(prepared, "prepared"))
    first = {name: v for name, v in tree.leaves(begun) if not isinstance(v, Ring)}
    trees = Trees(plain, prepared, begun)
    return Beginning(timing, named, first, dict(tree.tables(system)), tree.structure(system), lambda: trees)


def _prepared(plain: Any, timing: Any) -> Any:
    """Return the precomputed coefficients of a loop or machine; those of an unchanged axis are reused."""
    if not isinstance(plain, Loop):
        return plain.prepare(timing)
    axis, T = plain.axis, plain.sample_time
    core = (axis.plant, axis.actuator, axis.friction_motor, axis.friction_load)
    kept = key(core)
    if kept is None:
        return plain.prepare(timing)
    # its matrix exponentials take nearly all the time of `prepare`
    hold = _holds.get((kept, axis.substeps, T, timing), lambda: axis.prepare(T, timing))
    return plain.Prepared(plain.control.prepare(T), hold)


def key(held: Any) -> Hashable:
    """Return the structure of blocks and the bits of their numbers as a cache key; None if there are tables or
    arrays over variants.
    """
    structure, values = tree.structure_and_values(held)
    row = _bits(values)
    return None if row is None else (structure, row.tobytes())


def _bits(values: Sequence[Any]) -> np.ndarray | None:
    """Return numbers as an array of floats; None if there are tables or arrays over variants."""
    if np.ndarray in map(type, values):
        return None
    return np.array(values, dtype=np.float64)


def typed(value: Any) -> Any:
    """Convert a number, or the numbers of all variants, to numpy types."""
    return np.asarray(value, dtype=np.float64) if isinstance(value, (list, np.ndarray)) else np.float64(value)


def each_axis(function: Callable[[Any], Any], argument: Any) -> Any:
    """Apply a function to the argument of a loop, or to the argument of each axis of a machine."""
    return (
        {name: function(one) for name, one in argument.items()} if isinstance(argument, Mapping) else function(argument)
    )


class TracedBeginning(NamedTuple):
    """The graph of `prepare` and `start`.

    Leaves are the numbers of the system by name, and `start.position`, `start.velocity`, `start.set_position` ...; for
    a machine the latter are prefixed by the axis.
    """

    graph: Graph
    constants: dict[str, int]  # nodes of prepared numbers, by name
    states: dict[str, int]  # nodes of first states, by name


STARTS = tuple(f"start.{name}" for name in ("position", "velocity", *SETPOINT))


def traced_beginning(system: System, timing: Any, counted: Callable[[Symbol], float] | None = None) -> TracedBeginning:
    """Trace `prepare` and `start` of a system on symbols; for `counted` see `Graph`."""
    graph = Graph(counted)
    rows = {name: graph.table(name, len(row)) for name, row in tree.tables(system)}
    leaves = (graph.input(name) for name, _ in tree.leaves(system))
    symbolic: Any = tree.with_tables(tree.rebuild(system, leaves), rows)
    prepared = symbolic.prepare(timing)
    at = {
        axis: [cast(Number, graph.input(f"{port}{name}")) for name in STARTS]
        for axis, port in zip(system.loops(), system.ports(), strict=True)
    }
    position, velocity, setpoint = (
        {axis: take(row) for axis, row in at.items()}
        for take in (lambda row: row[0], lambda row: row[1], lambda row: Setpoint(*row[2:]))
    )
    if isinstance(system, Loop):
        setpoint, position, velocity = setpoint[system.name], position[system.name], velocity[system.name]
    begun = symbolic.start(prepared, timing, setpoint, position, velocity)
    constants = {name: graph.symbol(v).index for name, v in tree.leaves(prepared, "prepared") if isinstance(v, Symbol)}
    states = {name: graph.symbol(v).index for name, v in tree.leaves(begun) if not isinstance(v, Ring)}
    return TracedBeginning(graph, constants, states)


class NativeBeginning:
    """The machine code of `prepare` and `start` for one structure of a loop."""

    def __init__(self, loop: Loop, timing: Any, row: np.ndarray | None) -> None:
        """Compile `prepare` and `start`.

        `row` holds the numbers of a run; loops of fixed count are limited to the iterations that this run needs. None
        means no limit.
        """
        self._leaves = [name for name, _ in tree.leaves(loop)]
        names = [*self._leaves, *STARTS]
        counts: dict[int, float] = {}

        def counted(symbol: Symbol) -> float:
            assert row is not None
            # a loop of fixed count ends in the trace where it ends for these numbers
            (count,) = evaluate(symbol.graph, [symbol.index], dict(zip(names, row, strict=True)))
            return counts.setdefault(symbol.index, float(count))

        graph, constants, states = traced_beginning(loop, timing, None if row is None else counted)
        self._constants, self._states, self._counts = list(constants), list(states), np.array([*counts.values()])
        ends = [*counts, *constants.values(), *states.values()]
        program = Program(
            graph=graph,
            constants={name: graph.input(name).index for name in names},
            inputs={},
            states=(),
            outputs={str(place): node for place, node in enumerate(ends)},
            sample=None,
            tables={},
        )
        # quick: what runs once a start never earns back the time of optimizing it
        self._native: Native = native(plan(program), flush=False, quick=True)

    def run(self, row: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]] | None:
        """Return numbers and initial states by name; None if a loop of fixed count exceeds the traced iterations."""
        outputs = np.empty((1, len(self._native.plan.outputs)))
        self._native.run(1, 0, row, np.empty((1, 0)), np.empty(0), outputs, ())
        counts, prepared = len(self._counts), len(self._counts) + len(self._constants)
        if not np.all(outputs[0, :counts] <= self._counts):
            return None
        values = dict(zip(self._leaves, row, strict=False))
        values.update(zip(self._constants, outputs[0, counts:prepared], strict=True))
        return values, dict(zip(self._states, outputs[0, prepared:], strict=True))


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
        # a NaN changes neither least nor most: the sum of squares and `LEFT` show it
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
    """A loop or a machine with all numbers that a run needs: structure, precomputed coefficients, initial state.

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
        """Return the steady states by name, including ring buffers: the limits that the initial states reach after
        infinite time at constant inputs.
        """
        return dict(tree.leaves(settled(self._begun.trees.begun)))

    def varying(self) -> frozenset[str]:
        """Return the names of numbers and states that are arrays over variants."""
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
        """Return the initial states by name, in the order of the machine code; the cells of ring buffers are 0."""
        first = {s.name: self.first.get(s.name, None) for s in code.plan.states}
        named = {name: begin(name) if value is None else value for name, value in first.items()}
        return named | dict.fromkeys(code.plan.memory[len(named) :], 0.0)

    def retune(self, old: Prepared, code: Native, states: np.ndarray) -> None:
        """Update in place the controller states of a single run, after a live change from `old` to this loop."""
        rows = {state.name: i for i, state in enumerate(code.plan.states)}
        for now, before in zip(self._controls(), old._controls(), strict=True):
            begun = now.begun
            held = (v if isinstance(v, Ring) else states[rows[name], 0] for name, v in tree.leaves(begun, now.path))
            state = tree.rebuild(begun, held)
            with np.errstate(all="ignore"):
                state = now.control.retune(state, before.control, before.prepared, now.prepared)
            # the past of a signal, in the cells of a ring, does not depend on parameters
            for name, value in tree.leaves(state, now.path):
                if not isinstance(value, Ring):
                    states[rows[name], 0] = value

    def _controls(self) -> list[_Running]:
        """Return each controller with its precomputed coefficients and its initial state."""
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
    """Return numbers by name as rows with one variant per lane; surplus lanes repeat the last variant."""
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
    """A controller, the path of its state, its precomputed coefficients and its initial state."""

    path: str
    control: Control
    prepared: Any
    begun: Any


STRETCH = 65_536  # samples whose inputs are in memory at once


def recorded(prepared: Prepared, code: Native, work: Work, states: np.ndarray, first: int, count: int) -> np.ndarray:
    """Compute `count` samples of a run, updating `states`; return the recorded signals, shape (count, signals)."""
    constants, rows = prepared.constants(code), prepared.rows(code)
    return recorded_by_lane(code, work, constants, states, rows, first, count)[:, :, 0]


def recorded_by_lane(
    code: Native,
    work: Work,
    constants: np.ndarray,
    states: np.ndarray,
    rows: Sequence[np.ndarray],
    first: int,
    count: int,
) -> np.ndarray:
    """Compute `count` samples of the runs in all lanes, updating `states`, shape (n, lanes); return the recorded
    signals, shape (count, signals, lanes).
    """
    work.sample(first, count)
    record = np.empty((count, len(code.plan.outputs), code.plan.lanes))
    for start in range(0, count, STRETCH):
        size = min(STRETCH, count - start)
        inputs = work.inputs(code, first + start, size)
        code.run(size, first + start, constants, inputs, states, record[start : start + size], rows)
    return record


WIDTHS = (8, 16, 32)
# Samples of all variants together from which on wider vectors, and a trial of them, pay for being compiled.
WIDE, TRIED = 5_000_000, 100_000_000
_TRIAL = 400  # samples
_fastest: Recent[int] = Recent(64)  # by the source of the narrowest machine code


class Groups:
    """The variants of a prepared loop in groups of one vector each; the last group is padded."""

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
        """Return the states of all variants after the last sample by name, each of shape (variants,)."""
        flat = np.moveaxis(self.states, 0, 1).reshape(self.states.shape[1], -1)[:, : self.variants]
        return {state.name: row for state, row in zip(self.code.plan.states, flat, strict=False)}

    def trial(self, inputs: np.ndarray) -> float:
        """Return the computing time in s per variant over a short range of samples, the shortest of three trials;
        states are unchanged.
        """
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
    """Return the variants in groups of `lanes` each; None selects the fastest number on this computer.

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

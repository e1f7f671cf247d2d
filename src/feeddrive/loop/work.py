"""The sampled inputs of a run: setpoints, load force, enable and added force."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache, lru_cache
from itertools import pairwise
from typing import Any, cast

import numpy as np

from feeddrive.blocks.families import Load, Reference
from feeddrive.blocks.reference.stretches import Piece, Stretch, Way, rest
from feeddrive.blocks.signals import Setpoint
from feeddrive.language import tree
from feeddrive.language.block import Number
from feeddrive.language.errors import ParameterError
from feeddrive.language.graph import Graph
from feeddrive.language.recent import Recent
from feeddrive.loop.beginning import key
from feeddrive.loop.engine.native import Native, native
from feeddrive.loop.engine.plan import plan
from feeddrive.loop.loop import SETPOINT, Loop
from feeddrive.loop.machine import System
from feeddrive.loop.trace import Program

_KEPT = 200_000  # samples of a reference that are kept at most, for the next run along it
_references: Recent[Path] = Recent(8)
_SHORT = 1000  # samples; fewer are left to numpy
# Samples of stretches that numpy computes before machine code is made: it costs about as much as so many of them.
_PAYS_AFTER = 100_000
_sampled_by_numpy = [0]


class Path:
    """Sampled setpoints, shape (5, samples), read only."""

    def __init__(self, rows: np.ndarray) -> None:
        self.rows = rows
        self._travels: dict[int, float] = {}

    def travel(self, most: int) -> float:
        """Return the travel in m, sampled at up to `most` samples."""
        if most not in self._travels:
            self._travels[most] = travel(self.rows[0, _spread(self.rows.shape[1], most)])
        return self._travels[most]


class Work:
    """The sampled inputs of a run: setpoints, load force, enable, added force, for any range of samples.

    For a machine each is a mapping by axis; an axis that is missing has no such force.
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
        """Return the longest travel of an axis in m, at up to `most` samples spread over the first `count`."""
        if self._first == 0 and self._count == count:
            return max(path.travel(most) for path in self._paths.values())
        return max(
            travel(reference.at(_spread(count, most) * self.T).position) for reference in self.reference.values()
        )

    def sample(self, first: int, count: int) -> slice:
        """Sample a stretch, unless the last one holds it, and return its place in that one."""
        start = first - self._first
        if start < 0 or start + count > self._count:
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
        """Return setpoints, load and added forces (0 N without one) of some samples by name; the last stretch is
        cached.
        """
        held, inputs = self.sample(first, count), {}
        for axis, port in self._ports.items():
            inputs |= {f"{port}{name}": row[held] for name, row in zip(SETPOINT, self._paths[axis].rows, strict=True)}
            for name in (f"{port}load_force", f"{port}added_force"):
                inputs[name] = self._forces[name][held] if name in self._forces else np.broadcast_to(0.0, count)
        return inputs

    def _along(self, reference: Reference, t: Callable[[], np.ndarray], first: int, count: int) -> Path:
        """Return the setpoints of a reference; those of a whole run are cached, since the next run often follows the
        same path.
        """
        place = key(reference) if first == 0 and 1 < count <= _KEPT else None
        if place is None:
            return self._fresh(reference, t, first, count)
        return _references.get((place, count, self.T), lambda: self._fresh(reference, t, first, count))

    def _fresh(self, reference: Reference, t: Callable[[], np.ndarray], first: int, count: int) -> Path:
        """Sample the setpoints of a reference."""
        stretches = reference.stretches() if count >= _SHORT else ()
        if stretches and _sampled_by_numpy[0] > _PAYS_AFTER:
            out = _by_stretches(stretches, self.T, first, count)
        else:
            _sampled_by_numpy[0] += count if stretches else 0
            out = np.empty((len(SETPOINT), count))
            for row, values in zip(out, reference.at(t()), strict=True):
                row[:] = values
        out.flags.writeable = False
        return Path(out)

    def inputs(self, code: Native, first: int, count: int) -> np.ndarray:
        """Return samples first .. first + count - 1 in the order of the machine code, shape (count, n), read only."""
        names = tuple(name for name, _ in code.plan.inputs)
        begin = SETPOINT.index(names[0]) if self._single and names and names[0] in SETPOINT else 0
        if self._single and names == SETPOINT[begin : begin + len(names)]:
            stretch = self.sample(first, count)
            (path,) = self._paths.values()
            return path.rows[begin : begin + len(names), stretch].T
        rows = self.sampled(first, count)
        for axis, enable in self.enable.items():  # the last value holds on
            rows[f"{self._ports[axis]}enable"] = enable[np.minimum(first + np.arange(count), len(enable) - 1)]
        out = np.empty((len(names), count))
        for row, name in zip(out, names, strict=True):
            row[:] = rows.get(name, 0.0)
        out.flags.writeable = False
        return out.T


def _by_stretches(stretches: Sequence[Stretch], T: float, first: int, count: int) -> np.ndarray:
    """Sample the setpoints first .. first + count - 1 by machine code, with the same bits as numpy."""
    sampler, out = _sampler(), np.empty((count, len(SETPOINT)))
    rows = np.array([(*way, *piece, T) for way, piece in stretches])
    way, piece = len(Way._fields), len(Way._fields) + len(Piece._fields)
    columns = rows.T[:, :, None]
    # a division that is rounded tells the first sample of a stretch to one sample
    near = np.ceil((rows[:, 0] + rows[:, way]) / T)
    times: Any = (near[:, None] + (-1.0, 0.0, 1.0)) * T
    held = Stretch(Way(*columns[:way]), Piece(*columns[way:piece])).holds(times)
    begins = np.clip(near + 2.0 - np.sum(held, axis=1) - first, 0.0, count).astype(np.int64)
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
    """Return machine code for the setpoints of one stretch; its numbers and the sample time are constants."""
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
    return native(plan(program), flush=False)


def travel(positions: Any) -> float:
    """Return the distance from the least to the largest position."""
    return float(np.ptp(positions))


@lru_cache(maxsize=64)
def _spread(count: int, most: int) -> np.ndarray:
    """Return up to `most` of the first `count` samples, including the first and the last."""
    return np.unique(np.linspace(0, count - 1, most).astype(np.int64))

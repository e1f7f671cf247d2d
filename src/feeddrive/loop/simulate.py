"""Simulation: a single run, a batch of variants, or a stream; with parameter changes during the run."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Hashable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np

from feeddrive.blocks.families import Load, Reference
from feeddrive.language import tree
from feeddrive.language.errors import DivergedError, ParameterError, StructureError, nearest
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity, signal_unit
from feeddrive.language.table import UNIT, Result, Table
from feeddrive.language.text import Text
from feeddrive.language.threads import cores
from feeddrive.loop.control import Control
from feeddrive.loop.engine.llvm import Native
from feeddrive.loop.engine.plan import ARITHMETIC
from feeddrive.loop.loop import Loop, quantity, unit_of
from feeddrive.loop.machine import Machine, System, check_system, turning_ports, velocity_ports
from feeddrive.loop.runner import LEFT, Prepared, Work, gathered, grouped, recorded, recorded_by_lane

# by sample (int) or time in s (float): a whole control, or values of some of its parameters by path
Changes: TypeAlias = Mapping[int | float, Control | Mapping[str, float]]

_CONTROL = re.compile(r"(axis\.\w+\.)?control\.")


def changed_loops(loop: System, changes: Changes | None, count: int) -> list[tuple[int, System]]:
    """Return all changes in a run of `count` samples in chronological order, as (sample, loop from that sample onward).

    A change acts between two samples: sample k is the first one that runs with the new values.  A time is rounded up to
    a whole sample.  Values by name change the controller that is active at that time.

    Raises ParameterError for a sample or time that is outside the run or named twice, a name that is not in the
    controller, or a value out of bounds, and StructureError for a change of the structure.
    """
    placed: dict[int, Control | Mapping[str, float]] = {}
    for key, change in (changes or {}).items():
        sample = _sample(key, float(loop.sample_time), count)
        if sample in placed:
            raise ParameterError(f"changes: there are two at sample {sample}, the second at {_shown(key)}; join them")
        placed[sample] = change
    loops = []
    for sample in sorted(placed):
        try:
            loop = _changed(loop, placed[sample])
        except (ParameterError, StructureError) as error:
            raise type(error)(f"changes at sample {sample}: {error}") from None
        loops.append((sample, loop))
    return loops


def _sample(key: int | float, T: float, count: int) -> int:
    if isinstance(key, (int, np.integer)) and not isinstance(key, bool):
        sample = int(key)
    elif isinstance(key, (float, np.floating)) and math.isfinite(key):
        # a time on a sample, up to rounding, is that sample and not the next one
        sample = math.ceil(float(key) / T * (1.0 - 1e-12) - 1e-9)
    else:
        raise ParameterError(f"changes: {key!r} must be a sample (whole number) or a time in s (float)")
    if not 0 <= sample < count:
        raise ParameterError(
            f"changes: {_shown(key)} is outside of the run, which has {count} samples, 0 ... {count - 1} (0 ... "
            f"{Quantity((count - 1) * T, 's'):6 SI})"
        )
    return sample


def _shown(key: int | float) -> str:
    return Text(f"{Quantity(key, 's'):6 SI}") if isinstance(key, (float, np.floating)) else f"sample {key}"


def _changed(loop: System, change: Any) -> System:
    """Return the loop with another controller, or with other parameter values in its controller."""
    if isinstance(change, Control):
        if not isinstance(loop, Loop):
            raise ParameterError("a machine changes by names such as axis.x.control.law.Kv, not by a whole Control")
        changed = dataclasses.replace(loop, control=change)
    elif isinstance(change, Mapping):
        for name, value in change.items():
            if not isinstance(name, str) or not _on_controller(loop, tree.name_of(loop, name)):
                raise ParameterError(
                    f"'{name}' is no parameter of the control, such as axis.x.control.law.Kv: the axis "
                    "does not change live"
                )
            if isinstance(value, (list, tuple, np.ndarray)):
                raise ParameterError(f"{name} must be one number: a batch of variants cannot be changed live")
        changed = tree.vary(loop, change)
    else:
        raise ParameterError(
            f"{change!r} must be a Control, or values by path, as in {{'axis.x.control.law.Kv': 80.0}}"
        )
    for name, before in loop.loops().items():
        control = changed.loops()[name].control
        if any(isinstance(value, np.ndarray) for _, value in tree.leaves(control)):
            raise ParameterError("the control holds arrays of variants: a batch of variants cannot be changed live")
        control.check_live(before.control, before.place_of("control"))
    return changed


def _on_controller(loop: System, name: str) -> bool:
    """True if a parameter belongs to a controller, or to a coupling between the controllers of a machine."""
    first, _, rest = name.partition(".")
    if first == "couplings" and isinstance(loop, Machine):
        return loop.couplings[int(rest.partition(".")[0])].controls
    return bool(_CONTROL.match(name))


class Course:
    """A run whose controller changes at given samples, computed in pieces."""

    def __init__(self, prepared: Prepared, later: list[tuple[int, Prepared]]) -> None:
        """Begin a run. `later` holds the first sample and the prepared loop of each change, in order."""
        self._now, self._later = prepared, list(later)

    def advance(self, code: Native, work: Work, states: np.ndarray, first: int, count: int) -> np.ndarray:
        """Compute samples first .. first + count - 1 from `states`, which are updated; return the recorded signals
        (count, signals).
        """
        work.sample(first, count)
        pieces, at, end = [], first, first + count
        while at < end:
            while self._later and self._later[0][0] == at:
                old, self._now = self._now, self._later.pop(0)[1]
                self._now.retune(old, code, states)
            until = min(end, self._later[0][0]) if self._later else end
            pieces.append(recorded(self._now, code, work, states, at, until - at))
            at = until
        return pieces[0] if len(pieces) == 1 else np.concatenate(pieces)


CHUNK = 20_000  # samples that are in memory at once
GATHERED = ("following_error", "tracking_error", "force", "velocity_load")


class Recorded(Mapping[str, np.ndarray]):
    """A mapping from signal names to the columns of an array (samples, signals); a column is copied when it is read."""

    def __init__(self, names: Sequence[str], rows: np.ndarray) -> None:
        self._places = {name: place for place, name in enumerate(names)}
        self.rows = rows
        self._read: dict[str, np.ndarray] = {}

    def __getitem__(self, name: str) -> np.ndarray:
        if name not in self._read:
            self._read[name] = np.ascontiguousarray(self.rows[:, self._places[name]])
        return self._read[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)

    def __contains__(self, name: object) -> bool:
        return name in self._places

    def __reduce__(self) -> tuple[Any, ...]:
        return dict, (dict(self),)


@dataclass(frozen=True, eq=False, repr=False)
class Run(Result):
    """A simulated run: signals over time. `run["force"]` is an array of shape (n,), in the unit `run.units["force"]`.

    Row k is the sample at `time[k]` = kT; see `loop.Signals` for the meaning of each signal.  For a machine its name is
    prefixed by the axis: `run["x.force"]`.  `turning` holds the prefixes of rotary axes, such as `c.`, and
    `by_velocity` those of axes whose drives are commanded by velocities, in m/s; the prefix of a single axis is empty.
    """

    name: str
    signals: Mapping[str, np.ndarray]
    sample_time: float
    samples: int
    first: int = 0
    turning: frozenset[str] = frozenset()
    by_velocity: frozenset[str] = frozenset()

    @cached_property
    def time(self) -> np.ndarray:
        """The times t = kT of all rows, s."""
        time = np.arange(self.first, self.first + self.samples, dtype=np.float64)
        time *= self.sample_time
        return time

    def __getitem__(self, signal: str) -> np.ndarray:
        if signal not in self.signals:
            raise ParameterError(f"the run has no signal '{signal}'; it has {', '.join(self.signals)}")
        return self.signals[signal]

    def axis(self, name: str) -> Run:
        """Return the run of one axis of a machine, with the signal names of a single axis.

        Raises ParameterError for an unknown axis.
        """
        by_quantity = {quantity(signal): signal for signal in self.signals if signal == f"{name}.{quantity(signal)}"}
        if not by_quantity:
            there = dict.fromkeys(signal.rpartition(".")[0] for signal in self.signals)
            raise ParameterError(f"the run has no axis '{name}'; it has {', '.join(filter(None, there))}")
        turning, by_velocity = (
            frozenset({""} if f"{name}." in ports else ()) for ports in (self.turning, self.by_velocity)
        )
        signals = {short: self.signals[signal] for short, signal in by_quantity.items()}
        return Run(
            f"{self.name}, axis {name}", signals, self.sample_time, self.samples, self.first, turning, by_velocity
        )

    @property
    def units(self) -> dict[str, str]:
        """The SI unit of every signal."""
        return {name: unit_of(name, self.turning, None, self.by_velocity) for name in self.signals}

    @property
    def rotary(self) -> bool:
        """True if all axes of the run are rotary."""
        return all(signal.removesuffix(quantity(signal)) in self.turning for signal in self.signals)

    def table(self) -> Table:
        """Return a table of the RMS and peak of errors, forces and velocities."""
        rows = []
        for name in self.signals:
            if quantity(name) in ("following_error", "tracking_error", "force", "friction_load", "velocity_load"):
                unit, values = self.units[name], self.signals[name]
                sizes = root_mean_square(values), float(np.max(np.abs(values), initial=0.0))
                rows.append(
                    [name.replace("_", " "), UNIT, *(Quantity(size, unit, form=signal_unit(unit)) for size in sizes)]
                )
        title = Text(f"{self.name}: {self.samples} samples, {Quantity(self.samples * self.sample_time, 's'):SI}")
        return Table(title, ["signal", "unit", "RMS", "peak"], rows)


def root_mean_square(values: np.ndarray) -> float:
    """Return the root mean square of values, or 0 for an empty array."""
    return float(np.sqrt(np.mean(values * values))) if values.size else 0.0


def samples(duration: float, T: float) -> int:
    """Return the number of samples from 0 to `duration`, both ends included; rounding errors of the duration are
    tolerated.
    """
    return int(np.floor(duration / T * (1.0 + 1e-12) + 1e-9)) + 1


def simulate(
    loop: System,
    reference: Reference | Mapping[str, Reference],
    *,
    load: Load | Mapping[str, Load] | None = None,
    added_force: Load | Mapping[str, Load] | None = None,
    enable: np.ndarray | Mapping[str, np.ndarray] | None = None,
    changes: Changes | None = None,
    duration: float | None = None,
    start: tuple[float, float] | Mapping[str, tuple[float, float]] | None = None,
    seed: int = 0,
    record: Sequence[str] | None = None,
    arithmetic: str = "exact",
    bound: float | None = None,
    name: str = "run",
    progress: Progress | None = None,
) -> Run:
    """Simulate a loop along a reference, or a machine along one reference for each axis.

    For a machine, reference, load, added_force, enable and start are mappings by axis, and signal names are prefixed by
    the axis: `x.force`.

    load        force on the table, N
    added_force force added to the command after the force limit, N: the excitation of a measurement.  The signal
                `force` does not include it
    enable      1 or 0 for each sample, shape (n,), for a loop with a guard; the last value applies until the end
    changes     live changes of parameters: by sample (int) or time in s (float), a `Control`, or values by name such as
                {"axis.x.control.law.Kv": 80.0}.  The change is bumpless (`Control.retune`)
    duration    s; default: that of the reference
    start       position (m) and velocity (m/s) of the axis at t = 0; default: those of the setpoint
    seed        integer seed of the noise
    record      names of signals; default: all
    arithmetic  "exact" (default; bit-identical on every machine), "libm" or "fma"
    bound       m; default: the larger of 1 m and 100 times the travel
    progress    receives the simulated time in s, and may cancel the run

    Raises DivergedError with the sample at which |tracking error| exceeded `bound` or became NaN, ParameterError for an
    unknown signal or arithmetic and for a change with an invalid time, name or value, and StructureError for a change
    of the structure.
    """
    pieces = stream(
        loop,
        reference,
        load=load,
        added_force=added_force,
        enable=enable,
        changes=changes,
        duration=duration,
        start=start,
        seed=seed,
        record=record,
        arithmetic=arithmetic,
        bound=bound,
        # a run is cut into chunks only to report progress and to be canceled between them
        chunk=None if progress is None else CHUNK,
        name=name,
        progress=progress,
    )
    parts = list(pieces)
    first = parts[0]
    if len(parts) == 1:
        return first
    names = list(first.signals)
    rows = np.concatenate([piece.signals.rows for piece in parts if isinstance(piece.signals, Recorded)])
    return Run(name, Recorded(names, rows), first.sample_time, len(rows), 0, first.turning, first.by_velocity)


def checked_signals(system: System, record: Sequence[str], arithmetic: str) -> list[str]:
    """Return the names of signals as a list. Raises ParameterError for an unknown signal or arithmetic."""
    if arithmetic not in ARITHMETIC:
        raise ParameterError(f"arithmetic = {arithmetic!r} must be one of {', '.join(ARITHMETIC)}")
    there = system.signals()
    for signal in record:
        if signal not in there:
            raise ParameterError(f"there is no signal '{signal}'{nearest(signal, there)}")
    return list(record)


def everywhere(system: System, names: Sequence[str]) -> list[str]:
    """Return the names of signals; for a machine those of every axis with its prefix."""
    return [f"{port}{name}" for port in system.ports() for name in names]


def sample_count(work: Work, duration: float | None) -> int:
    """Return the number of samples of a run. Raises ParameterError for a duration that is not finite."""
    span = work.duration if duration is None else duration
    if not 0.0 <= span < float("inf"):
        raise ParameterError(f"duration = {Quantity(span, 's'):6 SI} must be a finite time, >= 0 s")
    return samples(span, work.T)


def _bound(work: Work, bound: float | None, count: int) -> float:
    """Return `bound`, or by default the larger of 1 m and 100 times the travel, evaluated at up to 257 samples."""
    if bound is not None:
        return bound
    # a few samples suffice for the size of the travel
    return max(1.0, 100.0 * work.travel(count, 257))


def _check_inside(left: float, bound: float, T: float, where: str = "") -> None:
    if left >= 0.0:
        raise DivergedError(
            f"{where}the loop left its bounds at sample {int(left)} (t = {Quantity(left * T, 's'):6 SI}): |tracking "
            f"error| > {Quantity(bound, 'm'):6 SI}. It is unstable or was started far from its setpoint: check its "
            "margins, gains and sample time"
        )


@dataclass(frozen=True, eq=False, repr=False)
class Batch(Result):
    """The RMS, peak, minimum and maximum of signals for every variant, each an array of shape (variants,).

    `left` is the sample at which a variant left its bounds, -1 if it never did. `turning` and `by_velocity` are the
    signal prefixes of rotary axes and of axes whose drives are commanded by velocities, as of `Run`.
    """

    rms: Mapping[str, np.ndarray]
    peak: Mapping[str, np.ndarray]
    least: Mapping[str, np.ndarray]
    most: Mapping[str, np.ndarray]
    left: np.ndarray
    samples: int
    sample_time: float
    turning: frozenset[str] = frozenset()
    by_velocity: frozenset[str] = frozenset()

    @property
    def units(self) -> dict[str, str]:
        """The SI unit of every signal."""
        return {name: unit_of(name, self.turning, None, self.by_velocity) for name in self.rms}

    def table(self) -> Table:
        """Return a table of the best, median and worst variant for each signal."""
        rows, units = [], self.units
        for signal, values in self.rms.items():
            unit = units[signal]
            low, middle, high = (Quantity(size, unit) for size in np.quantile(values, [0.0, 0.5, 1.0]).tolist())
            rows.append([signal.replace("_", " "), UNIT, low, int(np.argmin(values)), middle, high])
        title = f"{self.left.size} variants of {self.samples} samples; {int(np.sum(self.left >= 0))} left their bounds"
        return Table(title, ["RMS of", "unit", "least", "variant", "median", "most"], rows)


def simulate_batch(
    loop: System,
    reference: Reference | Mapping[str, Reference],
    *,
    load: Load | Mapping[str, Load] | None = None,
    enable: np.ndarray | Mapping[str, np.ndarray] | None = None,
    duration: float | None = None,
    start: tuple[Any, Any] | Mapping[str, tuple[Any, Any]] | None = None,
    seed: Any = 0,
    gather: Sequence[str] | None = None,
    arithmetic: str = "exact",
    bound: float | None = None,
    lanes: int | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Batch:
    """Simulate all variants of a loop whose parameters are arrays (`tree.vary`), along the same reference.

    Arguments are those of `simulate`, without live changes; seed and start may be arrays over the variants too. `lanes`
    variants share a vector (default: the fastest number on this computer), and `threads` run in parallel (default: all
    cores); the results are bit-identical for any choice. `progress` receives the number of finished variants after each
    group, and may cancel the simulation.
    """
    check_system(loop)
    gather = checked_signals(loop, everywhere(loop, GATHERED) if gather is None else gather, arithmetic)
    work = Work(loop, reference, load, enable)
    count = sample_count(work, duration)
    prepared = Prepared(loop, work.first(), start, seed, _bound(work, bound, count))
    program = prepared.program(load=work.load, enable=work.enable)

    bounded = everywhere(loop, ["tracking_error"])

    def native(width: int) -> Native:
        return prepared.native(
            program,
            record=(),
            gather=gather,
            bounded=bounded,
            lanes=width,
            arithmetic=arithmetic,
        )

    groups = grouped(prepared, native, lanes, count, lambda code: work.inputs(code, 0, min(count, CHUNK)))
    stretches = range(0, count, CHUNK)
    done = 0
    with ThreadPoolExecutor(threads or cores()) as pool:
        for first in stretches:
            inputs = work.inputs(groups.code, first, min(CHUNK, count - first))
            for size in groups.advance(pool, first, inputs):
                done += size
                if progress is not None:
                    # each variant is advanced once a stretch
                    progress.step("variants", done // len(stretches), groups.variants)
    named = groups.ends()
    return Batch(
        rms={s: np.sqrt(named[gathered(s, "squares")] / count) for s in gather},
        # 0 for a signal that was NaN throughout, whose least and most are still infinite
        peak={s: np.fmax(0.0, np.fmax(named[gathered(s, "most")], -named[gathered(s, "least")])) for s in gather},
        least={s: named[gathered(s, "least")] for s in gather},
        most={s: named[gathered(s, "most")] for s in gather},
        left=named[LEFT].astype(np.int64),
        samples=count,
        sample_time=work.T,
        turning=turning_ports(loop),
        by_velocity=velocity_ports(loop),
    )


def stream(
    loop: System,
    reference: Reference | Mapping[str, Reference],
    *,
    load: Load | Mapping[str, Load] | None = None,
    added_force: Load | Mapping[str, Load] | None = None,
    enable: np.ndarray | Mapping[str, np.ndarray] | None = None,
    changes: Changes | None = None,
    duration: float | None = None,
    start: tuple[float, float] | Mapping[str, tuple[float, float]] | None = None,
    seed: int = 0,
    record: Sequence[str] | None = None,
    arithmetic: str = "exact",
    bound: float | None = None,
    chunk: int | None = CHUNK,
    name: str = "stream",
    progress: Progress | None = None,
) -> Iterator[Run]:
    """Yield the run of `simulate` in chunks of samples, with constant memory for any length.

    Arguments and errors are those of `simulate`; `chunk` = None yields the whole run at once.  The arrays of a chunk
    are not reused.
    """
    check_system(loop)
    record = checked_signals(loop, loop.signals() if record is None else record, arithmetic)
    work = Work(loop, reference, load, enable, added_force)
    count = sample_count(work, duration)
    if chunk is None:
        chunk = count
        # all at once: `first` below would sample the start of the path alone
        work.sample(0, count)
    limit = _bound(work, bound, count)
    prepared = Prepared(loop, work.first(), start, seed, limit)
    if prepared.lanes() > 1:
        raise ParameterError("the loop holds arrays of variants: run it with simulate_batch")
    ports = zip(loop.loops(), loop.ports(), strict=True)
    probes = [f"{port}added_force" for axis, port in ports if axis in work.added_force]
    program = prepared.program(load=work.load, enable=work.enable, probes=probes)
    bounded = everywhere(loop, ["tracking_error"])
    compiled = prepared.native(program, record=record, bounded=bounded, arithmetic=arithmetic)
    states = prepared.states(compiled)
    left = compiled.plan.memory.index(LEFT)
    later = changed_loops(loop, changes, count)
    course = Course(prepared, [(at, Prepared(changed, work.first(), start, seed, limit)) for at, changed in later])
    for first in range(0, count, chunk):
        size = min(chunk, count - first)
        if progress is not None:
            progress.step(f"{name}: seconds of the run", int(first * work.T), int(count * work.T))
        rows = course.advance(compiled, work, states, first, size)
        _check_inside(states[left, 0], limit, work.T)
        yield Run(name, Recorded(record, rows), work.T, size, first, turning_ports(loop), velocity_ports(loop))


_LANES = (1, 2, 4, 8)  # of a vector; wider ones gain nothing for the few systems of a group


def stream_each(
    systems: Mapping[str, System],
    reference: Reference | Mapping[str, Reference],
    *,
    load: Load | Mapping[str, Load] | None = None,
    added_force: Load | Mapping[str, Load] | None = None,
    seeds: Mapping[str, int] | None = None,
    duration: float | None = None,
    record: Sequence[str] | None = None,
    bound: float | None = None,
    chunk: int = CHUNK,
    threads: int | None = None,
    name: str = "runs",
    progress: Progress | None = None,
) -> Iterator[dict[str, Run]]:
    """Yield the runs of several systems along the same references, by name, in chunks of samples.

    Systems that differ in numbers only share a program and a vector, in which each has a lane; the bits are those of
    `simulate`, also for another number of `threads` (default: all cores).  All systems have the same signals.

    seeds  integer seed of the noise by name; default: 0

    Other arguments and errors are those of `simulate`; the error of a run that leaves its bounds names its system.
    """
    groups: dict[Hashable, list[str]] = {}
    for each, system in systems.items():
        check_system(system)
        tables = tuple((table, row.tobytes()) for table, row in tree.tables(system))
        groups.setdefault((tree.structure(system), system.timing(()), tables), []).append(each)
    most = _LANES[-1]
    lanes = [
        _Lanes(
            {each: systems[each] for each in group[begin : begin + most]},
            Work(systems[group[0]], reference, load, None, added_force),
            seeds or {},
            duration,
            record,
            bound,
        )
        for group in groups.values()
        for begin in range(0, len(group), most)
    ]
    count, T = lanes[0].count, lanes[0].work.T
    with ThreadPoolExecutor(threads or cores()) as pool:
        for first in range(0, count, chunk):
            if progress is not None:
                progress.step(f"{name}: seconds of the run", int(first * T), int(count * T))
            size = min(chunk, count - first)
            advancing = [pool.submit(lane.advance, first, size) for lane in lanes]
            runs = {each: run for lane in advancing for each, run in lane.result().items()}
            yield {each: runs[each] for each in systems}


class _Lanes:
    """The runs of systems of one structure, each in a lane of one vector."""

    def __init__(
        self,
        systems: Mapping[str, System],
        work: Work,
        seeds: Mapping[str, int],
        duration: float | None,
        record: Sequence[str] | None,
        bound: float | None,
    ) -> None:
        self.names, self.work = list(systems), work
        one = systems[self.names[0]]
        self.record = checked_signals(one, one.signals() if record is None else record, "exact")
        self.count = sample_count(work, duration)
        work.sample(0, self.count)
        self.bound = _bound(work, bound, self.count)
        width = next(lanes for lanes in _LANES if lanes >= len(systems))
        seed: Any = [seeds.get(name, 0) for name in self.names]
        prepared = Prepared(_joined(systems), work.first(), None, seed[0] if width == 1 else seed, self.bound)
        probes = [
            f"{port}added_force"
            for axis, port in zip(one.loops(), one.ports(), strict=True)
            if axis in work.added_force
        ]
        program = prepared.program(load=work.load, probes=probes)
        bounded = everywhere(one, ["tracking_error"])
        self.code = prepared.native(program, record=self.record, bounded=bounded, lanes=width)
        every = slice(0, len(systems)) if width > 1 else None
        self.constants, self.states = prepared.constants(self.code, every), prepared.states(self.code, every)
        self.rows = prepared.rows(self.code)
        self.left = self.code.plan.memory.index(LEFT)
        self.turning, self.by_velocity = turning_ports(one), velocity_ports(one)

    def advance(self, first: int, count: int) -> dict[str, Run]:
        """Return the runs over a range of samples, by name. Raise DivergedError for one that left its bounds."""
        rows = recorded_by_lane(self.code, self.work, self.constants, self.states, self.rows, first, count)
        runs: dict[str, Run] = {}
        for lane, name in enumerate(self.names):
            _check_inside(float(self.states[self.left, lane]), self.bound, self.work.T, f"{name}: ")
            signals = Recorded(self.record, rows[:, :, lane])
            runs[name] = Run(name, signals, self.work.T, count, first, self.turning, self.by_velocity)
        return runs


def _joined(systems: Mapping[str, System]) -> Any:
    """Return one system whose leaves are arrays over systems of the same structure where their numbers differ."""
    rows = zip(*([value for _, value in tree.leaves(system)] for system in systems.values()), strict=True)
    values = (row[0] if all(value == row[0] for value in row) else np.array(row, np.float64) for row in rows)
    return tree.rebuild(next(iter(systems.values())), values)

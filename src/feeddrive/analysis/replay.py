"""Replay of a measured log through a controller, a loop or an observer."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from feeddrive.blocks.families import Observer
from feeddrive.blocks.load.recorded_force import RecordedForce
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.blocks.signals import Estimate, Reading, Setpoint
from feeddrive.language import tree
from feeddrive.language.block import Block, Number, parameter, part
from feeddrive.language.errors import LogError, ParameterError
from feeddrive.language.graph import Graph
from feeddrive.language.quantity import Quantity, signal_unit
from feeddrive.language.recent import Recent
from feeddrive.language.ring import Ring
from feeddrive.language.table import UNIT, Column, Result, Table
from feeddrive.language.text import Text
from feeddrive.loop.control import Control
from feeddrive.loop.engine.llvm import Native, native
from feeddrive.loop.engine.plan import plan
from feeddrive.loop.loop import SETPOINT, UNITS, Loop
from feeddrive.loop.simulate import Run, simulate
from feeddrive.loop.trace import Carried, Program, concrete, numbers, trace

_INPUTS = (*SETPOINT, "reading_motor", "reading_load", "acted")
_compiled: Recent[Native] = Recent(16)


class OnLog(Block):
    """A controller whose inputs in each sample are the setpoint, the readings and the applied force of a log."""

    control: Control = part("the control, without its guard")
    sample_time: Number = parameter("s", "time from row to row", above=0)

    def sample(
        self, prepared: Any, state: Any, inputs: Mapping[str, Number], noise: object, time: object
    ) -> tuple[Any, dict[str, Number]]:
        """Compute one sample. The applied force is that of the log, so that errors of the law do not accumulate."""
        setpoint = Setpoint(*(inputs[name] for name in SETPOINT))
        state = state._replace(applied=inputs["acted"], requested=inputs["acted"])
        readings = inputs["reading_motor"], inputs["reading_load"]
        after, command = self.control.step(prepared, state, setpoint, *readings, 1.0, self.sample_time)
        return after, {"force": command.applied}


def path_of(control: Control, set_position: np.ndarray, sample_time: float) -> Recorded:
    """Return the set positions of a log (m) as the reference of a controller.

    A controller that feeds forward gets their central differences, whose Taylor expansion has the same backward
    differences; all others get the positions alone, bit-identical.
    """
    if not control.feedforward and not control.law.fed():
        return Recorded(position=set_position, sample_time=sample_time)
    T, around = sample_time, np.pad(set_position, 1, mode="edge")
    velocity = (around[2:] - around[:-2]) / (2.0 * T)
    acceleration = np.diff(around, 2) / T**2
    return Recorded(position=set_position, velocity=velocity, acceleration=acceleration, sample_time=T)


def commanded(
    control: Control,
    sample_time: float,
    set_position: np.ndarray,
    reading: np.ndarray,
    force: np.ndarray,
    reading_motor: np.ndarray | None = None,
) -> np.ndarray:
    """Return the force in N that a controller commands at each row of a log, shape (n,).

    set_position   m, shape (n,), one row per sample of the controller
    reading        m, shape (n,): reading of the load encoder, also used for the motor if `reading_motor` is None
    force          N, shape (n,): the force that was commanded at each row

    No plant model is involved: for the controller that produced the log, the result is the logged force, except for
    rounding and the unknown initial state of the controller.  The guard is inactive.
    """
    T = np.float64(sample_time)
    motor = reading if reading_motor is None else reading_motor
    _, velocity = estimate_start(reading, float(T))
    path = path_of(control, set_position, float(T)).at(np.arange(set_position.size) * float(T))
    # `applied` of a sample is the command of the sample before
    acted = np.concatenate([force[:1], force[:-1]])
    rows = np.column_stack([np.broadcast_to(row, reading.size) for row in (*path, motor, reading, acted)])
    system = concrete(OnLog(control=replace(control, guard=None), sample_time=float(T)))
    with np.errstate(all="ignore"):
        prepared = system.control.prepare(T)
        begun = system.control.start(
            prepared,
            Setpoint(*map(np.float64, rows[0, : len(SETPOINT)])),
            # a law starts one sample earlier, so that its first difference is the velocity of the log
            np.float64(motor[0] - velocity * T),
            np.float64(reading[0] - velocity * T),
            np.float64(velocity),
        )
    # the machine code depends on the structure alone: other numbers of the same law reuse it
    key = tuple(tree.structure(part) for part in (system, prepared, begun))
    return _ran(
        _compiled.get(key, lambda: native(plan(trace(system, prepared, begun, _INPUTS)))), system, prepared, begun, rows
    )


def _ran(compiled: Native, system: OnLog, prepared: Any, begun: Any, rows: np.ndarray) -> np.ndarray:
    """Run a compiled controller over all rows and return the commanded forces."""
    steps, held = compiled.plan, dict(tree.leaves(begun))
    values = {**dict(tree.leaves(system)), **dict(numbers(prepared, "prepared")), "seed": 0.0}
    states = [np.float64(held[state.name]) for state in steps.states]
    for name, _, length in steps.rings:
        ring = held[name.removeprefix("state.")]
        states += [0.0] * length if not isinstance(ring, Ring) or ring.cells is None else list(ring.cells)
    constants = np.array([[values[name]] for name, _ in steps.constants], dtype=np.float64).reshape(-1, 1)
    tables = dict(tree.tables(system))
    out = np.empty((len(rows), len(steps.outputs), 1))
    inputs = np.ascontiguousarray(rows[:, [_INPUTS.index(name) for name, _ in steps.inputs]])
    compiled.run(
        len(rows),
        0,
        constants,
        inputs,
        np.array(states, dtype=np.float64).reshape(-1, 1),
        out,
        [tables[name] for name, _ in steps.tables],
    )
    return out[:, 0, 0].copy()


INJECTED = ("load_force", "added_force")
# a millionth of the limit lies below what any force is known by
_ROUNDS, _SETTLED = 20, 1e-6  # runs until the injected force stays, to this share of the limit
# a parabola over 50 samples: the first difference of a reading of counts would be a velocity of noise
FITTED = 50  # samples from which position and velocity at the start are estimated


@dataclass(frozen=True, eq=False, repr=False)
class Replay(Result):
    """A simulated run along a log, and the measured signals by the same names at the same samples.

    The first `skipped` samples are excluded from the errors, since the initial state of the real loop is unknown.
    `contained` is True if the logged force included the injected one, which has been subtracted in `measured`.
    """

    run: Run
    measured: Mapping[str, np.ndarray]
    skipped: int
    contained: bool = False

    def residual(self, signal: str) -> np.ndarray:
        """Return predicted - measured, after the skipped samples."""
        return (self.run[signal] - self.measured[signal])[self.skipped :]

    def rms(self, signal: str) -> float:
        """Return the RMS of the residual in SI units."""
        return float(np.sqrt(np.mean(self.residual(signal) ** 2)))

    def share(self, signal: str) -> float:
        """Return the RMS of the residual divided by that of the measured signal."""
        return self.rms(signal) / float(np.sqrt(np.mean(self.measured[signal][self.skipped :] ** 2)))

    def table(self) -> Table:
        """Return a table of the RMS of measurement and residual, and the peak of the residual."""
        rows = []
        for signal, measured in self.measured.items():
            is_position = signal in ("position_load", "position_motor")
            size = float(np.sqrt(np.mean(measured[self.skipped :] ** 2)))
            peak = float(np.max(np.abs(self.residual(signal))))
            cells = [None if is_position else size, self.rms(signal), peak]
            unit = UNITS[signal]
            numbers = [None if cell is None else Quantity(cell, unit, form=signal_unit(unit)) for cell in cells]
            rows.append([signal.replace("_", " "), UNIT, *numbers])
        title = f"predicted against measured, after {self.skipped} samples"
        return Table(title, ["signal", "unit", "measured RMS", "residual RMS", "residual peak"], rows)


def replay(loop: Loop, measured: Mapping[str, np.ndarray], *, skip: int = 0, name: str = "predicted") -> Replay:
    """Run the recorded reference through the loop, from the position and velocity at which the log starts.

    measured  `set_position` and `position_load` in m; optionally `force` in N, `load_force` in N (a known additional
              force on the table, which is also applied to the model) and `added_force` in N (a force that an experiment
              added at the drive, after the force limit); all of shape (n,), one row per sample of the loop
    skip      number of samples at the start that are excluded from the errors

    A drive may log its command before or after `added_force` is added.  The interpretation that agrees better with the
    force of the model is used.

    Raises LogError for a log too short to estimate its initial state.
    """
    setpoint, position = measured["set_position"], measured["position_load"]
    if position.size <= max(FITTED, skip):
        raise LogError(
            f"the log has {position.size} samples; {max(FITTED, skip) + 1} are needed to estimate how it starts"
        )
    T = float(loop.sample_time)
    injected = {name: measured[name] for name in INJECTED if name in measured}
    forces = {name: RecordedForce(force=force, sample_time=T) for name, force in injected.items()}
    run = simulate(
        loop,
        path_of(loop.control, setpoint, T),
        load=forces.get("load_force"),
        added_force=forces.get("added_force"),
        start=estimate_start(position, T),
        name=name,
    )
    signals = {"position_load": position, "following_error": setpoint - position}
    contained = False
    if "force" in measured:
        logged = measured["force"]
        bare = logged - sum(injected.values(), np.zeros(logged.size))
        # no field of a log says whether the drive logs its command before or after the sum: the model decides
        apart = [float(np.mean((run["force"] - loop_)[skip:] ** 2)) for loop_ in (logged, bare)]
        contained = apart[1] < apart[0]
        signals["force"] = bare if contained else logged
    return Replay(run, signals, skip, contained)


def injected_scale(loop: Loop, measured: Mapping[str, np.ndarray], fit: Replay) -> tuple[float, Replay]:
    """Return the factor on the injected forces that fits the log best, ideally 1, and the replay with that factor.

        c = -e₀ · d / (d · d),   e₀ the position residual without injected forces, d the change that they cause

    `fit` is the replay with the unscaled forces.
    """
    without = {name: values for name, values in measured.items() if name not in INJECTED}
    bare = replay(loop, without, skip=fit.skipped).residual("position_load")
    change = fit.residual("position_load") - bare
    size = float(change @ change)
    if size == 0.0:
        return 1.0, fit
    # least squares in closed form: the loop is nearly linear in a small injected force
    scale = -float(bare @ change) / size
    scaled = {name: scale * values if name in INJECTED else values for name, values in measured.items()}
    return scale, replay(loop, scaled, skip=fit.skipped)


def before_limit(loop: Loop, measured: Mapping[str, np.ndarray], limited: Replay) -> tuple[np.ndarray, Replay] | None:
    """Return the part of `added_force` that passes the limit if added before it, and the replay with this part.

        a'(k) = sat(u(k) + a(k)) - sat(u(k)),   sat at ±F, the force limit,   u the force that the controller requests

    Each run uses the a' computed from the requested forces of the previous run, until a' converges, at most 20 times.
    The result is None if the limit is never active.  The law receives its own command, without the injected force.
    `limited` is the replay with the force added after the limit.
    """
    if loop.control.force_limit is None:
        return None
    limit, added, again = float(loop.control.force_limit), measured["added_force"], limited
    left = added
    for _ in range(_ROUNDS):
        requested = again.run["requested"]
        last, left = left, np.clip(requested + added, -limit, limit) - np.clip(requested, -limit, limit)
        if np.max(np.abs(left - last)) <= _SETTLED * limit:
            break
        again = replay(loop, {**measured, "added_force": left}, skip=limited.skipped, name=limited.run.name)
    return None if again is limited else (left, again)


def estimate_start(position: np.ndarray, T: float) -> tuple[float, float]:
    """Estimate position (m) and velocity (m/s) at the first sample, by a parabola fit to the first `FITTED` samples."""
    t = np.arange(FITTED) * T
    _, velocity, start = np.polyfit(t, position[:FITTED], 2)
    return float(start), float(velocity)


@dataclass(frozen=True, eq=False, repr=False)
class Observation(Result):
    """The estimates of an observer over time, of shape (n,): position (m), velocity (m/s), disturbance (N).

    `lag` is the delay in s of the estimate of a slow disturbance; 0 if the observer does not state it.
    """

    name: str
    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    disturbance: np.ndarray
    sample_time: float
    lag: float

    def error(self, true: np.ndarray, *, skip: int = 0, aligned: bool = False) -> float:
        """Return the RMS error of the estimated disturbance in N, without the first `skip` samples.

        true     the true disturbance in N, shape (n,); row k acts over [kT, (k+1)T], like `load_force` of a run
        aligned  True to delay `true` by the lag of the observer before comparing
        """
        if true.shape != self.disturbance.shape:
            raise ParameterError(f"the true disturbance has {true.size} rows, the estimate {self.disturbance.size}")
        late = round(self.lag / self.sample_time) if aligned else 0
        first = max(skip, late)
        off = self.disturbance[first:] - true[first - late : true.size - late]
        return float(np.sqrt(np.mean(off**2)))

    def table(self) -> Table:
        """Return a table of mean, RMS and peak of the disturbance."""
        d = self.disturbance
        row = [self.name, float(d.mean()), float(np.sqrt(np.mean(d**2))), float(np.max(np.abs(d)))]
        title = Text(
            f"estimated disturbance over {Quantity(d.size * self.sample_time, 's')}, {Quantity(self.lag, 's'):3} late"
        )
        columns = ["observer", Column("mean", "N"), Column("RMS", "N"), Column("peak", "N")]
        return Table(title, columns, [row])


def observe(
    observer: Observer,
    position: np.ndarray,
    force: np.ndarray,
    sample_time: float,
    *,
    before: float = 0.0,
    velocity: float = 0.0,
) -> Observation:
    """Run an observer on measured positions and commanded forces, with the same compiled step as in a loop.

    position     m, read at kT, shape (n,): `reading_load` of a run, `position_load` of a log
    force        N, commanded at kT and acting over [kT, (k+1)T], shape (n,): `force` of a run or a log
    sample_time  s
    before       N, force before the first row, such as the force that holds the weight of a vertical axis
    velocity     m/s, velocity of the axis at the first row; needed for a record that begins in motion: otherwise the
                 first estimates contain a false force pulse that accelerates the observer to this velocity

    Raises LogError for rows of different length or with values that are not finite, ParameterError for an observer that
    cannot run at the sample time.
    """
    x, u = np.asarray(position, dtype=np.float64), np.asarray(force, dtype=np.float64)
    if x.ndim != 1 or x.shape != u.shape or not x.size:
        raise LogError(f"an observer needs one force for each position, not {u.shape} for {x.shape}")
    if not (np.all(np.isfinite(x)) and np.all(np.isfinite(u)) and np.isfinite(before + velocity)):
        raise LogError("positions and forces for an observer must be finite: cut the rows without a reading out")
    if not 0.0 < sample_time < np.inf:
        raise ParameterError(f"sample_time = {Quantity(sample_time, 's'):6 SI} must be > 0 s")
    tree.check_sampled(observer, float(sample_time))
    T = np.float64(sample_time)
    plain = tree.rebuild(observer, (np.float64(value) for _, value in tree.leaves(observer)))
    # an observer starts one sample before the first row, like a law
    last = x[0] - velocity * T
    first = Reading(last, last, np.float64(before), np.float64(before), np.float64(velocity))
    with np.errstate(all="ignore"):
        prepared = plain.prepare(T)
        begun = plain.start(prepared, first)
    program = _program(observer, prepared, begun)
    compiled = native(plan(program))
    values = {**dict(tree.leaves(plain)), **dict(numbers(prepared, "prepared")), "T": T}
    constants = np.array([[values[name]] for name, _ in compiled.plan.constants]).reshape(-1, 1)
    held = dict(tree.leaves(begun))
    states = np.array([[held[state.name]] for state in compiled.plan.states], dtype=np.float64).reshape(-1, 1)
    rows = {"position": x, "applied": np.concatenate([[before], u[:-1]])}
    inputs = np.column_stack([rows[name] for name, _ in compiled.plan.inputs])
    outputs = np.empty((x.size, len(compiled.plan.outputs), 1))
    compiled.run(x.size, 0, constants, np.ascontiguousarray(inputs), states, outputs, [])
    signals = {name: outputs[:, i, 0].copy() for i, (name, _) in enumerate(compiled.plan.outputs)}
    lag = float(plain.lag(prepared, T))
    return Observation(observer.kind, np.arange(x.size) * float(T), **signals, sample_time=float(T), lag=lag)


def _program(observer: Observer, prepared_numbers: Any, begun: Any) -> Program:
    """Trace one step of the observer into a program with named inputs, states and outputs."""
    graph = Graph()
    constants: dict[str, int] = {}
    inputs: dict[str, int] = {}

    def leaf(name: str, kept: dict[str, int]) -> Number:
        symbol = graph.input(name)
        kept[name] = symbol.index
        return cast(Number, symbol)

    symbolic = tree.rebuild(observer, (leaf(name, constants) for name, _ in tree.leaves(observer)))
    prepared = tree.rebuild(
        prepared_numbers,
        (v if type(v) is float else leaf(name, constants) for name, v in tree.leaves(prepared_numbers, "prepared")),
    )
    names = [name for name, _ in tree.leaves(begun)]
    before = tree.rebuild(begun, (graph.input(f"state.{name}") for name in names))
    position, applied = leaf("position", inputs), leaf("applied", inputs)
    reading = Reading(position, position, applied, applied)
    after, estimate = symbolic.step(prepared, before, reading, leaf("T", constants))
    carried = tuple(
        Carried(name, graph.input(f"state.{name}").index, graph.symbol(value).index)
        for name, (_, value) in zip(names, tree.leaves(after), strict=True)
    )
    outputs = {name: graph.symbol(value).index for name, value in zip(Estimate._fields, estimate, strict=True)}
    return Program(graph, constants, inputs, carried, outputs, None, {}).keeping(list(outputs))

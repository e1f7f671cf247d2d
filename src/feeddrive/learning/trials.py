"""Iterative learning over trials: feedforward parameters or a force signal of one loop, or all axes of a machine."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from feeddrive.blocks.compensation.learned_force import LearnedForce
from feeddrive.blocks.families import Load, Plant, Reference
from feeddrive.blocks.prefilter.trajectory_prefilter import TrajectoryPrefilter
from feeddrive.language import tree
from feeddrive.language.block import Block
from feeddrive.language.errors import FeeddriveError, ParameterError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity, form_unit, number, unit_name
from feeddrive.language.table import Column, Result, Table
from feeddrive.language.text import Text
from feeddrive.learning import iterative_feedforward
from feeddrive.learning.iterative_feedforward import Iteration
from feeddrive.learning.trajectory_prefilter import REGRESSORS, fit_prefilter
from feeddrive.learning.trial import Trial, simulated_trial
from feeddrive.loop.linearize import Lifted, StateSpace
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine
from feeddrive.loop.simulate import Run, simulate
from feeddrive.machining.contour import contour_error

_RECORDED = (
    "set_position",
    "set_velocity",
    "set_acceleration",
    "position_load",
    "following_error",
    "requested",
    "force",
    "trip",
)
# far below any count, far above the rounding of a position of 1 m
_STANDS = 1e-9  # m of travel


@dataclass(frozen=True, eq=False, repr=False)
class Trials(Result):
    """A sequence of trials; trial j ran with the parameters learned from trial j - 1.

    trials      data of each trial
    iterations  result of each trial except the last
    loops       loop of each trial
    """

    trials: tuple[Trial, ...]
    iterations: tuple[Iteration, ...]
    loops: tuple[Loop, ...]

    @property
    def loop(self) -> Loop:
        """The loop of the last trial."""
        return self.loops[-1]

    @property
    def rms(self) -> np.ndarray:
        """The RMS of the following error of each trial, m."""
        return np.array([trial.rms for trial in self.trials])

    def parameters(self) -> dict[str, np.ndarray]:
        """Return the parameter values over the trials by name, in SI units."""
        blocks = [iteration.before for iteration in self.iterations]
        blocks.append(self.iterations[-1].after)
        return {name: np.array([block.parameters()[name] for block in blocks]) for name in blocks[0].parameters()}

    def errors(self) -> dict[str, np.ndarray]:
        """Return the standard errors over the trials by name, in SI units; NaN for a value that the previous trial did
        not update.
        """
        names = self.iterations[0].before.parameters()
        return {name: np.array([np.nan, *(i.errors.get(name, np.nan) for i in self.iterations)]) for name in names}

    def table(self) -> Table:
        """Return a table of the error, its prediction and the parameters, with one column per trial."""
        declared = self.iterations[0].before
        curves: list[tuple[str, str, str, Sequence[float | None]]] = [
            ("RMS", "m", "", [trial.rms for trial in self.trials]),
            (
                "predicted",
                "m",
                "",
                [None, *(iteration.predicted_rms for iteration in self.iterations[: len(self.trials) - 1])],
            ),
            ("peak", "m", "", [trial.peak for trial in self.trials]),
        ]
        for name, values in self.parameters().items():
            curves.append((name, tree.declaration(declared, name).unit, "5 SI", values[: len(self.trials)].tolist()))
        rows = [
            [
                f"{name} {unit_name(unit, form_unit(form))}",
                *(None if value is None else Quantity(value, unit, form=form, bare=True) for value in values),
            ]
            for name, unit, form, values in curves
        ]
        heads = ["trial", *(str(j + 1) for j in range(len(self.trials)))]
        form = self.iterations[0].form
        return Table(f"{len(self.trials)} trials, {form}; predicted: as if the reference stayed", heads, rows)


def iterate_trials(
    loop: Loop,
    references: Reference | Sequence[Reference],
    trials: int = 6,
    *,
    form: str = "model_free",
    gamma: float = 1.0,
    mu: float = 1e-9,
    columns: Sequence[str] | None = None,
    plant: Plant | None = None,
    least_mass: float = 0.0,
    saturation: str = "refused",
    at_rest: str = "none",
    believed: Loop | None = None,
    load: Callable[[int], Load] | Load | None = None,
    seed: int = 0,
) -> Trials:
    """Simulate trials, each with the parameters learned from the previous one by `next_iteration`.

    references  one motion, or several that are used in turn from trial to trial
    trials      number of trials, >= 2
    at_rest     friction at rest, "none" or "held", see `next_iteration`.  "none" needs more trials and minimizes the
                error of this motion; "held" needs one or two and yields approximately the axis's mass and friction
    believed    the loop with the gains that the tuner assumes, if they differ from the real ones
    load        force on the table, or a function that returns it for the index of a trial, from 0 on
    seed        seed of the noise; trial j has seed + j
    """
    if trials < 2:
        raise ParameterError(f"trials = {trials} must be >= 2: the first shows the error, the second what was learned")
    turns = (references,) if isinstance(references, Reference) else tuple(references)
    if not turns:
        raise ParameterError("references: at least one motion is needed")
    shown: list[Trial] = []
    learned: list[Iteration] = []
    loops = [loop]
    for j in range(trials):
        reference = turns[j % len(turns)]
        acting = load(j) if callable(load) else load
        name = f"trial {j + 1}"
        run = simulate(loop, reference, load=acting, seed=seed + j, record=_RECORDED, name=name)
        shown.append(simulated_trial(run, reference))
        if j == trials - 1:
            break
        # gains may be believed wrongly, but the present feedforward is the tuner's own and exact
        tuner = (
            loop
            if believed is None
            else iterative_feedforward.compensated(believed, iterative_feedforward.compensator(loop))
        )
        iteration = iterative_feedforward.next_iteration(
            tuner,
            shown[-1],
            form=form,
            gamma=gamma,
            mu=mu,
            columns=columns,
            plant=plant,
            least_mass=least_mass,
            saturation=saturation,
            at_rest=at_rest,
        )
        learned.append(iteration)
        loop = iterative_feedforward.compensated(loop, iteration.after)
        loops.append(loop)
    return Trials(tuple(shown), tuple(learned), tuple(loops))


# where Ĝ_d falls off its inverse would learn the noise of the error
_REGULAR = 0.01  # of the largest |Ĝ_d|: where it is smaller its inverse is bounded


@dataclass(frozen=True, eq=False, repr=False)
class SignalTrials(Result):
    """A sequence of trials, each with the force learned from the previous one.

    forces  learned force of each trial in N; the first is 0
    rate    largest |Q (1 - gain L G_d)| above 1 Hz; the learned force converges if it is < 1.  Lower frequencies are
            omitted, because integral action leaves no error there
    """

    trials: tuple[Trial, ...]
    forces: tuple[np.ndarray, ...]
    loop: Loop
    rate: float

    @property
    def rms(self) -> np.ndarray:
        """The RMS of the following error of each trial, m."""
        return np.array([trial.rms for trial in self.trials])

    def table(self) -> Table:
        """Return a table of the error and the learned force of each trial."""
        rows = [
            [j + 1, trial.rms, trial.peak, float(np.sqrt(np.mean(force**2)))]
            for j, (trial, force) in enumerate(zip(self.trials, self.forces, strict=True))
        ]
        verdict = "converges" if self.rate < 1.0 else "DIVERGES: lower gain or bandwidth"
        title = Text(f"signal-based learning: rate {Quantity(self.rate):.3f}, {verdict}")
        columns = ["trial", Column("RMS", "m"), Column("peak", "m"), Column("learned force RMS", "N")]
        return Table(title, columns, rows)


def learn_signal(
    loop: Loop,
    references: Reference | Sequence[Reference],
    trials: int = 6,
    *,
    bandwidth: float = 50.0,
    gain: float = 1.0,
    form: str = "model_free",
    plant: Plant | None = None,
    load: Callable[[int], Load] | Load | None = None,
    seed: int = 0,
) -> SignalTrials:
    """Simulate trials that learn a force as a function of time, which is added to the feedforward of the loop.

        f_next = Q (f + gain L e),   L = Ĝ_d* / (|Ĝ_d|² + ε²),   Q = 1 / (1 + (frequency/bandwidth)⁴)

    Q has zero phase, since it filters the whole record offline; Ĝ_d is that of `error_model`.  Learning converges if
    |Q (1 - gain L G_d)| < 1 at all frequencies: the bandwidth must not exceed the range in which Ĝ_d is accurate.

    bandwidth  bandwidth of the robustness filter Q, Hz
    gain       share of the correction that is applied, > 0 and <= 1
    references, trials, load, seed, form, plant: as in `iterate_trials`

    When to use: if reference and disturbance repeat exactly in time, whatever their shape.  Do not use it if the
    reference changes, since the learned force fits only the old one, or if nothing repeats, since it then learns noise.
    Raises ParameterError for values out of bounds, and the errors of `error_model`.
    Source: Arimoto, Kawamura & Miyazaki 1984; the filters as in Bristow, Tharayil & Alleyne 2006.
    """
    turns = (references,) if isinstance(references, Reference) else tuple(references)
    nyquist = 0.5 / float(loop.sample_time)
    for name, value, most in (("bandwidth", bandwidth, nyquist), ("gain", gain, 1.0)):
        if not 0.0 < value <= most:
            raise ParameterError(f"{name} = {number(value, 6)} must be > 0 and <= {number(most, 6)}")
    if trials < 2 or not turns:
        raise ParameterError(f"trials = {trials} must be >= 2, with at least one reference")
    model = iterative_feedforward.error_model(loop, form, plant=plant)
    learned = np.zeros(2)
    shown: list[Trial] = []
    forces: list[np.ndarray] = []
    now = loop
    for j in range(trials):
        reference = turns[j % len(turns)]
        now = _played(loop, learned)
        acting = load(j) if callable(load) else load
        # another seed in each trial: noise that repeats would be learned as a disturbance
        run = simulate(now, reference, load=acting, seed=seed + j, record=_RECORDED, name=f"trial {j + 1}")
        shown.append(simulated_trial(run, reference))
        forces.append(learned)
        learned = _next(model, learned, shown[-1].following_error, gain, bandwidth)
    return SignalTrials(
        tuple(shown), tuple(forces), now, _rate(model, iterative_feedforward.true_error_model(loop), gain, bandwidth)
    )


def _played(loop: Loop, force: np.ndarray) -> Loop:
    """Return the loop with the learned force, followed by a final 0, as a compensation."""
    others = tuple(block for block in loop.control.compensation if not isinstance(block, LearnedForce))
    # the block holds its last row: without the 0 the last force would act on after the motion
    block = LearnedForce(force=np.append(force, 0.0))
    return dataclasses.replace(loop, control=dataclasses.replace(loop.control, compensation=(*others, block)))


def _lines(model: StateSpace | Lifted, size: int) -> np.ndarray:
    return np.fft.rfftfreq(size, model.sample_time)


def _response(model: StateSpace | Lifted, frequency: np.ndarray) -> np.ndarray:
    """Return the frequency response, including 0 Hz; for a multirate model, the component at the excited frequency."""
    if isinstance(model, Lifted):
        A, B, C, D = model.stacked(model.inputs, model.outputs)
        held = np.ones(B.shape[1])
        still = np.mean(C @ np.linalg.solve(np.eye(A.shape[0]) - A, B @ held) + D @ held)
        return np.concatenate([[still], model.response(frequency[1:], model.outputs[0], model.inputs[0]).response])
    n = model.A.shape[0]
    still = model.C[0] @ np.linalg.solve(np.eye(n) - model.A, model.B[:, 0]) + model.D[0, 0]
    return np.concatenate([[still], model.response(frequency[1:]).response])


def _correction(model: StateSpace | Lifted, frequency: np.ndarray) -> np.ndarray:
    """Return the learning filter L at the frequencies."""
    g = _response(model, frequency)
    return g.conj() / (np.abs(g) ** 2 + (_REGULAR * np.max(np.abs(g))) ** 2)


def _robust(frequency: np.ndarray, bandwidth: float) -> np.ndarray:
    return 1.0 / (1.0 + (frequency / bandwidth) ** 4)


def _next(
    model: StateSpace | Lifted, force: np.ndarray, error: np.ndarray, gain: float, bandwidth: float
) -> np.ndarray:
    n = error.size
    # zeros behind the trial: a circular convolution would carry its end into its start, and the reverse
    size = 1 << (n + 2 * iterative_feedforward.decay(model) - 1).bit_length()
    frequency = _lines(model, size)
    held = np.zeros(size)
    held[: min(n, force.size)] = force[:n]
    both = np.fft.rfft(held) + gain * _correction(model, frequency) * np.fft.rfft(error, size)
    return np.fft.irfft(_robust(frequency, bandwidth) * both, size)[:n]


def _rate(model: StateSpace | Lifted, true: StateSpace | Lifted, gain: float, bandwidth: float) -> float:
    frequency = _lines(model, 1 << 14)
    left = _robust(frequency, bandwidth) * (1.0 - gain * _correction(model, frequency) * _response(true, frequency))
    return float(np.max(np.abs(left[frequency >= 1.0])))


@dataclass(frozen=True, eq=False, repr=False)
class MachineTrials(Result):
    """Runs of the same motion, each with the parameters learned from the previous one.

    error    RMS of the following error of each run, m or rad, by axis
    contour  maximum and RMS of the contour error of the linear axes of each run, m; empty unless two or three move
    learned  learned block in the last run, by axis: a disturbance compensator or a trajectory prefilter
    machine  machine of the last run
    remarks  one remark per axis that learned nothing from a run, with the reason
    """

    error: Mapping[str, np.ndarray]
    contour: tuple[tuple[float, float], ...]
    learned: Mapping[str, Block]
    machine: Machine
    remarks: tuple[str, ...]

    def table(self) -> Table:
        """Return a table of the errors, with one column per run."""
        runs = len(next(iter(self.error.values())))
        units = {axis: ("rad", "urad") if loop.axis.rotary else ("m", "") for axis, loop in self.machine.axes().items()}
        curves = [(f"{axis}: error RMS", row, *units[axis]) for axis, row in self.error.items()]
        if self.contour:
            largest, rms = np.transpose(self.contour)
            curves += [("contour error, largest", largest, "m", ""), ("contour error, RMS", rms, "m", "")]
        rows = [
            [name, *(Quantity(value, unit, form=shown) for value in values)] for name, values, unit, shown in curves
        ]
        heads = ["run", *(str(j + 1) for j in range(runs))]
        return Table(f"{runs} runs of the same motion on {', '.join(self.error)}", heads, rows)


def iterate_machine(
    machine: Machine,
    references: Mapping[str, Reference],
    runs: int = 4,
    *,
    form: str = "model_free",
    gamma: float = 1.0,
    columns: Sequence[str] | None = None,
    least_mass: float = 0.0,
    seed: int = 0,
    progress: Progress | None = None,
) -> MachineTrials:
    """Learn the feedforward parameters of all moving axes from run to run (see `next_iteration` for the update law).

    Each axis learns from its own error; its coupling with other axes acts as a repeating disturbance.  If a run
    contains no information on an axis, the axis keeps its parameters, and a remark states why.
    Raises ParameterError for fewer than two runs, and any error that `simulate` raises.
    """

    def learned(loop: Loop, run: Run, reference: Reference) -> tuple[Loop, Block]:
        trial = simulated_trial(run, reference)
        iteration = iterative_feedforward.next_iteration(
            loop, trial, form=form, gamma=gamma, columns=columns, least_mass=least_mass, at_rest="none"
        )
        return iterative_feedforward.compensated(loop, iteration.after), iteration.after

    def begun(loop: Loop) -> Loop:
        return iterative_feedforward.begin_compensation(loop, columns)

    return _repeated(machine, references, runs, begun, learned, iterative_feedforward.compensator, seed, progress)


def tune_prefilters(
    machine: Machine,
    references: Mapping[str, Reference],
    runs: int = 3,
    *,
    regressors: Sequence[str] = REGRESSORS,
    seed: int = 0,
    progress: Progress | None = None,
) -> MachineTrials:
    """Tune the trajectory prefilters of all moving axes from run to run (see `fit_prefilter` for the fit).

    Raises ParameterError for fewer than two runs or if an axis has a prefilter that is not a trajectory prefilter,
    and the errors of `simulate`.
    """

    def present(loop: Loop) -> TrajectoryPrefilter | None:
        held = loop.control.prefilter
        if held is not None and not isinstance(held, TrajectoryPrefilter):
            raise ParameterError(
                f"axis.{loop.name}.control.prefilter is a {held.kind}: remove it, or tune a trajectory_prefilter"
            )
        return held

    def learned(loop: Loop, run: Run, reference: Reference) -> tuple[Loop, Block]:
        prefilter = fit_prefilter(run, reference, regressors=regressors, present=present(loop)).prefilter
        return dataclasses.replace(loop, control=dataclasses.replace(loop.control, prefilter=prefilter)), prefilter

    def begun(loop: Loop) -> Loop:
        present(loop)
        return loop

    return _repeated(machine, references, runs, begun, learned, present, seed, progress)


def _repeated(
    machine: Machine,
    references: Mapping[str, Reference],
    runs: int,
    begun: Callable[[Loop], Loop],
    learned: Callable[[Loop, Run, Reference], tuple[Loop, Block]],
    held: Callable[[Loop], Block | None],
    seed: int,
    progress: Progress | None,
) -> MachineTrials:
    """Simulate runs of the same motion, each with the parameters that the axes learned from the previous run."""
    if runs < 2:
        raise ParameterError(f"runs = {runs} must be >= 2: the first shows the error, the second what was learned")
    moving = [name for name, reference in references.items() if _moves(reference, float(machine.sample_time))]
    if not moving:
        raise ParameterError("references: no axis moves, so that there is nothing to learn")
    machine = machine.with_loops({name: begun(machine.loop(name)) for name in moving})
    along = [name for name in moving if not machine.axes()[name].axis.rotary]
    there = set(machine.signals())
    record = [f"{name}.{signal}" for name in machine.axes() for signal in _RECORDED]
    record += [signal for signal in ("tool.x", "tool.y", "tool.z") if signal in there]
    error: dict[str, list[float]] = {name: [] for name in moving}
    contour: list[tuple[float, float]] = []
    remarks: dict[str, str] = {}
    for j in range(runs):
        if progress is not None:
            progress.step("runs", j + 1, runs)
        run = simulate(machine, references, seed=seed + j, record=record, name=f"run {j + 1}")
        for name in moving:
            error[name].append(float(np.sqrt(np.mean(run[f"{name}.following_error"] ** 2))))
        # a contour error needs a path in a plane or in space, of axes that move along lines
        if 2 <= len(along) <= 3:
            deviation = contour_error(run, axes=tuple(along), signal="position_load")
            contour.append((float(deviation.largest), float(deviation.rms)))
        if j == runs - 1:
            break
        loops: dict[str, Loop] = {}
        for name in moving:
            try:
                loops[name], _ = learned(machine.loop(name), run.axis(name), references[name])
            except FeeddriveError as wrong:
                remarks[name] = f"axis {name} learned nothing from run {j + 1}: {wrong}"
        machine = machine.with_loops(loops)
    blocks = {name: held(machine.loop(name)) for name in moving}
    return MachineTrials(
        {name: np.array(row) for name, row in error.items()},
        tuple(contour),
        {name: block for name, block in blocks.items() if block is not None},
        machine,
        tuple(remarks.values()),
    )


def _moves(reference: Reference, T: float) -> bool:
    # on the sampling instants, and at most a thousand of them
    t = T * np.unique(np.linspace(0.0, reference.duration / T, 1001).round())
    return bool(np.ptp(np.asarray(reference.at(t).position)) > _STANDS)

"""Iterative learning over trials: convergence, learned feedforward parameters, or a learned force signal."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from feeddrive.blocks.compensation.learned_force import LearnedForce
from feeddrive.blocks.families import Load, Plant, Reference
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity, form_unit, number, unit_name
from feeddrive.language.table import Column, Result, Table
from feeddrive.language.text import Text
from feeddrive.loop.lifting import Lifted
from feeddrive.loop.linearize import StateSpace
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import samples, simulate
from feeddrive.tuning.error_model import condition, decay, error_model, filtered, true_error_model
from feeddrive.tuning.iterative_feedforward import Iteration, compensated, compensator, next_iteration, regressors
from feeddrive.tuning.trial import Trial, simulated_trial


@dataclass(frozen=True, eq=False, repr=False)
class Convergence(Result):
    """What a trial does to the error of the parameters: θ_next - θ0 = (I - gamma Ψ̂⁺ Ψ)(θ - θ0) + noise.

    matrix     I - gamma Ψ̂⁺ Ψ, in parameters that are scaled so that all columns have the same size
    condition  condition number of the assumed columns
    """

    names: tuple[str, ...]
    matrix: np.ndarray
    condition: float
    gamma: float

    @property
    def rate(self) -> float:
        """ρ: the factor of the error of the parameters from trial to trial in the long run."""
        return float(np.max(np.abs(np.linalg.eigvals(self.matrix)), initial=0.0))

    @property
    def converges(self) -> bool:
        """Whether ρ < 1."""
        return self.rate < 1.0

    def table(self) -> Table:
        """Rate, verdict and condition."""
        verdict = "converges" if self.converges else "DIVERGES: lower gamma"
        row = [", ".join(self.names), self.gamma, self.rate, self.condition, verdict]
        columns = ["columns", "gamma", Column("rho", form=".3f"), Column("condition", form="3"), ""]
        return Table("error of the parameters from trial to trial", columns, [row])


def convergence(
    loop: Loop,
    reference: Reference,
    *,
    believed: Loop | None = None,
    form: str = "model_free",
    gamma: float = 1.0,
    columns: Sequence[str] | None = None,
    plant: Plant | None = None,
    least_mass: float = 0.0,
) -> Convergence:
    """The rate at which `iterate` converges on a loop whose axis is known, with a tuner that assumes another axis.

        Ψ = G_d φ of the loop,   Ψ̂ = Ĝ_d φ of the believed one,   ρ = largest |eigenvalue| of I - gamma Ψ̂⁺ Ψ

    believed  the loop with the gains and parameters that the tuner takes for true; default: the loop itself

    The other arguments are those of `iterate`.  Friction is taken as fed forward along the set velocity, so that a
    slip of the real velocity is left out.
    Raises UnstableError for a model loop that is not stable, and ParameterError for a column that is 0 all along.
    Source: this library's, for the step of `iterate`; the text of Wu, Han, Xiong & Ding 2017 at hand ends at
    eq. (10) and states no rate.
    """
    T = float(loop.sample_time)
    setpoint = reference.at(np.arange(samples(reference.duration, T)) * T)
    block = compensator(loop)
    names, phi, _ = regressors(loop, block, setpoint, columns)
    silent = [name for i, name in enumerate(names) if not np.any(phi[:, i])]
    if silent:
        raise ParameterError(f"columns: the reference does not excite {', '.join(silent)}: leave it out")
    true = filtered(true_error_model(loop), phi)
    guess = error_model(loop if believed is None else believed, form, plant=plant, least_mass=least_mass)
    seen = filtered(guess, phi)
    sizes = np.linalg.norm(seen, axis=0)
    learned = np.linalg.lstsq(seen / sizes, true / sizes, rcond=None)[0]
    return Convergence(tuple(names), np.eye(len(names)) - gamma * learned, condition(seen), gamma)


_RECORDED = ("following_error", "tracking_error", "force", "requested", "trip")


@dataclass(frozen=True, eq=False, repr=False)
class Trials(Result):
    """Trials one after another; trial j ran with the parameters learned from trial j - 1.

    trials      the data of each
    iterations  the result of each except the last, so one fewer
    loops       the loop of each trial
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
        """Of the following error of each trial, m."""
        return np.array([trial.rms for trial in self.trials])

    def parameters(self) -> dict[str, np.ndarray]:
        """Values by name over the trials, SI."""
        blocks = [iteration.before for iteration in self.iterations]
        blocks.append(self.iterations[-1].after)
        return {name: np.array([block.parameters()[name] for block in blocks]) for name in blocks[0].parameters()}

    def errors(self) -> dict[str, np.ndarray]:
        """Standard errors by name over the trials, SI; NaN where a parameter was not learned in the trial before."""
        names = self.iterations[0].before.parameters()
        return {name: np.array([np.nan, *(i.errors.get(name, np.nan) for i in self.iterations)]) for name in names}

    def table(self) -> Table:
        """Error, prediction and parameters, a column for each trial."""
        declared = self.iterations[0].before
        curves: list[tuple[str, str, str, Sequence[float | None]]] = [
            ("RMS", "m", "", [trial.rms for trial in self.trials]),
            ("predicted", "m", "", [None, *(each.predicted_rms for each in self.iterations[: len(self.trials) - 1])]),
            ("peak", "m", "", [trial.peak for trial in self.trials]),
        ]
        for name, values in self.parameters().items():
            curves.append((name, tree.declaration(declared, name).unit, "5 SI", values[: len(self.trials)].tolist()))
        rows = [
            [f"{name} {unit_name(unit, form_unit(form))}", *(
                None if value is None else Quantity(value, unit, form=form, bare=True) for value in values
            )]
            for name, unit, form, values in curves
        ]  # fmt: skip
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
    believed: Loop | None = None,
    load: Callable[[int], Load] | Load | None = None,
    seed: int = 0,
) -> Trials:
    """Simulate trials, each with the parameters learned from the one before (`iterate` has the law and its arguments).

    references  one motion, or several that take turns from trial to trial
    trials      how many, >= 2
    believed    the loop whose gains the tuner believes in, if they are not those of the real one
    load        a force on the table, or a function of the trial's number, from 0 on, that gives one
    seed        of the noise; trial j has seed + j
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
        tuner = loop if believed is None else compensated(believed, compensator(loop))
        found = next_iteration(
            tuner, shown[-1], form=form, gamma=gamma, mu=mu, columns=columns, plant=plant, least_mass=least_mass,
            saturation=saturation,
        )  # fmt: skip
        learned.append(found)
        loop = compensated(loop, found.after)
        loops.append(loop)
    return Trials(tuple(shown), tuple(learned), tuple(loops))


_REGULAR = 0.01  # of the largest |Ĝ_d|: where it is smaller its inverse is bounded


@dataclass(frozen=True, eq=False, repr=False)
class SignalTrials(Result):
    """Trials one after another, each with the force learned from the one before.

    forces  learned force of each trial in N; the first is 0
    rate    largest |Q (1 - gain L G_d)| from 1 Hz on: < 1, and the learned force converges.  Towards 0 Hz integral
            action leaves no error to learn from
    """

    trials: tuple[Trial, ...]
    forces: tuple[np.ndarray, ...]
    loop: Loop
    rate: float

    @property
    def rms(self) -> np.ndarray:
        """Of the following error of each trial, m."""
        return np.array([trial.rms for trial in self.trials])

    def table(self) -> Table:
        """Error and learned force of each trial."""
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
    """Simulate trials in which a force over time is learned, in addition to the feedforward of the loop.

        f_next = Q (f + gain L e),   L = Ĝ_d* / (|Ĝ_d|² + ε²),   Q = 1 / (1 + (frequency/bandwidth)⁴)

    Q has no phase, since it works on the record; Ĝ_d is that of `error_model`.  It converges where |Q (1 - gain L G_d)|
    < 1 at all frequencies: the bandwidth must end where Ĝ_d is no longer known.

    bandwidth  Hz, of the robustness filter Q
    gain       share of the correction that is taken, > 0 and <= 1
    references, trials, load, seed, form, plant: as in `iterate_trials`

    It wins where all repeats: the same reference, the same disturbance at the same time, of any shape.  It loses where
    the reference changes, since the force belongs to the old one, and where nothing repeats, since it learns noise.
    Raises ParameterError for values out of bounds; errors of `error_model`.
    Source: Arimoto, Kawamura & Miyazaki 1984; the filters as in Bristow, Tharayil & Alleyne 2006.
    """
    turns = (references,) if isinstance(references, Reference) else tuple(references)
    nyquist = 0.5 / float(loop.sample_time)
    for name, value, most in (("bandwidth", bandwidth, nyquist), ("gain", gain, 1.0)):
        if not 0.0 < value <= most:
            raise ParameterError(f"{name} = {number(value, 6)} must be > 0 and <= {number(most, 6)}")
    if trials < 2 or not turns:
        raise ParameterError(f"trials = {trials} must be >= 2, with at least one reference")
    model = error_model(loop, form, plant=plant)
    learned = np.zeros(2)
    shown: list[Trial] = []
    forces: list[np.ndarray] = []
    now = loop
    for j in range(trials):
        reference = turns[j % len(turns)]
        now = _played(loop, learned)
        acting = load(j) if callable(load) else load
        run = simulate(now, reference, load=acting, seed=seed + j, record=_RECORDED, name=f"trial {j + 1}")
        shown.append(simulated_trial(run, reference))
        forces.append(learned)
        learned = _next(model, learned, shown[-1].following_error, gain, bandwidth)
    return SignalTrials(tuple(shown), tuple(forces), now, _rate(model, true_error_model(loop), gain, bandwidth))


def _played(loop: Loop, force: np.ndarray) -> Loop:
    """The loop that adds the force; it ends with 0."""
    others = tuple(each for each in loop.control.compensation if not isinstance(each, LearnedForce))
    block = LearnedForce(force=np.append(force, 0.0))
    return dataclasses.replace(loop, control=dataclasses.replace(loop.control, compensation=(*others, block)))


def _lines(model: StateSpace | Lifted, size: int) -> np.ndarray:
    return np.fft.rfftfreq(size, model.sample_time)


def _response(model: StateSpace | Lifted, frequency: np.ndarray) -> np.ndarray:
    """From 0 Hz on, where an FRF has no line; with two rates the answer at the frequency itself."""
    if isinstance(model, Lifted):
        A, B, C, D = model.stacked(model.inputs, model.outputs)
        held = np.ones(B.shape[1])
        still = np.mean(C @ np.linalg.solve(np.eye(A.shape[0]) - A, B @ held) + D @ held)
        return np.concatenate([[still], model.response(frequency[1:], model.outputs[0], model.inputs[0]).response])
    n = model.A.shape[0]
    still = model.C[0] @ np.linalg.solve(np.eye(n) - model.A, model.B[:, 0]) + model.D[0, 0]
    return np.concatenate([[still], model.response(frequency[1:]).response])


def _correction(model: StateSpace | Lifted, frequency: np.ndarray) -> np.ndarray:
    """L at the frequencies."""
    g = _response(model, frequency)
    return g.conj() / (np.abs(g) ** 2 + (_REGULAR * np.max(np.abs(g))) ** 2)


def _robust(frequency: np.ndarray, bandwidth: float) -> np.ndarray:
    return 1.0 / (1.0 + (frequency / bandwidth) ** 4)


def _next(
    model: StateSpace | Lifted, force: np.ndarray, error: np.ndarray, gain: float, bandwidth: float
) -> np.ndarray:
    n = error.size
    size = 1 << (n + 2 * decay(model) - 1).bit_length()
    frequency = _lines(model, size)
    held = np.zeros(size)
    held[: min(n, force.size)] = force[:n]
    both = np.fft.rfft(held) + gain * _correction(model, frequency) * np.fft.rfft(error, size)
    return np.fft.irfft(_robust(frequency, bandwidth) * both, size)[:n]


def _rate(model: StateSpace | Lifted, true: StateSpace | Lifted, gain: float, bandwidth: float) -> float:
    frequency = _lines(model, 1 << 14)
    left = _robust(frequency, bandwidth) * (1.0 - gain * _correction(model, frequency) * _response(true, frequency))
    return float(np.max(np.abs(left[frequency >= 1.0])))

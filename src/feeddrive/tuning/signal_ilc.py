"""Signal-based iterative learning control: the plain baseline that learns a force over time, not parameters."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from feeddrive.blocks.compensation.learned_force import LearnedForce
from feeddrive.blocks.families import Load, Plant, Reference
from feeddrive.language.errors import ParameterError
from feeddrive.language.table import Result, Table
from feeddrive.loop.linearize import StateSpace
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import simulate
from feeddrive.tuning.error_model import decay, error_model, true_error_model
from feeddrive.tuning.trial import Trial, simulated_trial

_REGULAR = 0.01  # of the largest |Ĝ_d|: where it is smaller its inverse is bounded
_RECORDED = ("following_error", "force", "requested", "trip")


@dataclass(frozen=True, eq=False, repr=False)
class SignalTrials(Result):
    """Trials one after another, each with the force that the one before taught.

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
            [f"{j + 1}", f"{1e6 * t.rms:.4g}", f"{1e6 * t.peak:.4g}", f"{np.sqrt(np.mean(f**2)):.4g}"]
            for j, (t, f) in enumerate(zip(self.trials, self.forces, strict=True))
        ]
        verdict = "converges" if self.rate < 1.0 else "DIVERGES: lower gain or bandwidth"
        title = f"signal-based learning: rate {self.rate:.3f}, {verdict}"
        return Table(title, ["trial", "RMS um", "peak um", "learned force RMS N"], rows)


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
    """Simulate trials in which a force over time is learned, beside the feedforward that the loop has.

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
            raise ParameterError(f"{name} = {value:g} must be > 0 and <= {most:g}")
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


def _lines(model: StateSpace, size: int) -> np.ndarray:
    return np.fft.rfftfreq(size, model.sample_time)


def _response(model: StateSpace, frequency: np.ndarray) -> np.ndarray:
    """From 0 Hz on, where an FRF has no line."""
    n = model.A.shape[0]
    still = model.C[0] @ np.linalg.solve(np.eye(n) - model.A, model.B[:, 0]) + model.D[0, 0]
    return np.concatenate([[still], model.response(frequency[1:]).response])


def _correction(model: StateSpace, frequency: np.ndarray) -> np.ndarray:
    """L at the frequencies."""
    g = _response(model, frequency)
    return g.conj() / (np.abs(g) ** 2 + (_REGULAR * np.max(np.abs(g))) ** 2)


def _robust(frequency: np.ndarray, bandwidth: float) -> np.ndarray:
    return 1.0 / (1.0 + (frequency / bandwidth) ** 4)


def _next(model: StateSpace, force: np.ndarray, error: np.ndarray, gain: float, bandwidth: float) -> np.ndarray:
    n = error.size
    size = 1 << (n + 2 * decay(model) - 1).bit_length()
    frequency = _lines(model, size)
    held = np.zeros(size)
    held[: min(n, force.size)] = force[:n]
    both = np.fft.rfft(held) + gain * _correction(model, frequency) * np.fft.rfft(error, size)
    return np.fft.irfft(_robust(frequency, bandwidth) * both, size)[:n]


def _rate(model: StateSpace, true: StateSpace, gain: float, bandwidth: float) -> float:
    frequency = _lines(model, 1 << 14)
    left = _robust(frequency, bandwidth) * (1.0 - gain * _correction(model, frequency) * _response(true, frequency))
    return float(np.max(np.abs(left[frequency >= 1.0])))

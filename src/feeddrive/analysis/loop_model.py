"""The linear loop, opened at the actuator and closed: the common model for poles, responses and robustness."""

from dataclasses import dataclass

import numpy as np

from feeddrive.loop.frequency_response import FRF, transfer
from feeddrive.loop.linearize import Lifted, StateSpace, gain_of, lifted, linearize
from feeddrive.loop.loop import Loop

_LOWEST = 1e-5  # of Nyquist: where the lines of a loop gain begin
_LINES = 40  # a decade
_APART = 2e-4  # of a frequency: lines keep this distance
_OF_WIDTH = 0.1  # of the half width of a resonance: its lines keep at least this distance
_BESIDE = np.linspace(-4.0, 4.0, 33)  # half widths of a resonance at which lines are added


@dataclass(frozen=True, eq=False)
class LoopModel:
    """The linear model of a loop from `cut` and further inputs to `force` and `position_load`, open and closed.

    open    the loop cut between controller and actuator
    closed  the same model with cut = force

    For a law with a period of several samples both models are lifted.  The response to a sine then contains several
    frequencies, and the loop gain describes only the component at the frequency of the sine (`loop_gain`).
    """

    open: StateSpace | Lifted
    closed: StateSpace | Lifted

    def lines(self, per_decade: int = _LINES) -> np.ndarray:
        """Return frequencies in Hz up to Nyquist, spaced evenly over ln f and more densely around each resonance."""
        nyquist = 0.5 / self.open.sample_time
        spread = np.geomspace(_LOWEST * nyquist, nyquist, round(-np.log10(_LOWEST) * per_decade))
        # over a period the frequencies of poles are folded: those of a single sample show the resonances
        one = [model if isinstance(model, StateSpace) else model.samples[-1] for model in (self.open, self.closed)]
        poles = np.concatenate([model.poles() for model in one])
        # a pole near 0 is a delay and one on the real axis no resonance: neither needs lines of its own
        poles = poles[(np.abs(poles) > 0.1) & (np.abs(poles.imag) > 0.0)]
        s = np.log(poles) / self.open.sample_time
        beside = np.abs(s.imag)[:, None] + np.abs(s.real)[:, None] * _BESIDE
        near, width = beside.ravel() / (2.0 * np.pi), np.repeat(np.abs(s.real) / (2.0 * np.pi), _BESIDE.size)
        inside = (near > spread[0]) & (near < nyquist)
        both, first = np.unique(np.concatenate([spread, near[inside]]), return_index=True)
        # a parabola through lines that nearly coincide would be fitted to rounding errors, unless the response changes
        # between them, as at a resonance with little damping
        apart = np.minimum(_APART * both, np.concatenate([_APART * spread, _OF_WIDTH * width[inside]])[first])
        kept = np.ones(both.size, bool)
        last = both.size - 1  # Nyquist
        for k in range(both.size - 2, -1, -1):
            kept[k] = both[last] - both[k] > min(apart[k], apart[last])
            last = k if kept[k] else last
        return both[kept]

    def loop_gain(self, frequency: np.ndarray) -> FRF:
        """Return the loop gain L = -force/cut; `cut` is the force injected at the actuator, where the loop is opened.

        The stability limit is 1 + L = 0.
        """
        model = self.open
        if isinstance(model, Lifted):
            return gain_of(model, frequency)[0]
        row, column = model.outputs.index("force"), model.inputs.index("cut")
        z = np.exp(2j * np.pi * frequency * model.sample_time)
        values = transfer(model.A, model.B[:, column], model.C[row], model.D[row, column], z)
        return FRF(frequency, -values, "cut", "force", "N/N", model.sample_time)


def loop_model(loop: Loop, *, velocity: float = 0.05, position: str = "position_load") -> LoopModel:
    """Linearize a loop that moves with `velocity` (m/s), opened at the actuator.

    The inputs of the model are `cut`, `load_force` and both readings; its outputs are the force and a position.
    `loop_gain` of the model raises ParameterError for a law whose period exceeds 64 samples.
    """
    inputs = ("cut", "load_force", "reading_motor", "reading_load")
    if loop.control.law.period() > 1:
        samples = lifted(loop, inputs, ("force", position), velocity=velocity)
        return LoopModel(samples, Lifted(tuple(close(sample) for sample in samples.samples)))
    model = linearize(loop, inputs, ("force", position), velocity=velocity)
    return LoopModel(model, close(model))


def close(model: StateSpace, gain: float = 1.0) -> StateSpace:
    """Return the model closed by `cut` = gain · `force`; its other inputs and outputs remain.

    x' = A x + b f + B u,  f = c x + d u  gives  x' = (A + b c) x + (B + b d) u,  for gain = 1.  There is no
    algebraic loop, since the command of a sample never depends on the actuator's force in the same sample.
    """
    place, row = model.inputs.index("cut"), model.outputs.index("force")
    kept = [i for i in range(len(model.inputs)) if i != place]
    b, c, d = gain * model.B[:, [place]], model.C[[row]], model.D[[row]][:, kept]
    through = gain * model.D[:, [place]]
    return StateSpace(
        model.A + b @ c,
        model.B[:, kept] + b @ d,
        model.C + through @ c,
        model.D[:, kept] + through @ d,
        model.sample_time,
        model.states,
        tuple(model.inputs[i] for i in kept),
        model.outputs,
    )


_HIGHEST, _STEPS = 1e3, 120  # largest gain of the search for the first edge, and its number of steps
_LATEST = 400  # samples: largest dead time of the search


def gain_edge(model: Lifted) -> float | None:
    """Return the factor > 1 by which the force may be multiplied until the loop becomes unstable.

    It is computed from the poles over one period of the law, and is exact for a factor common to all samples, whereas
    the loop gain of a sine covers one frequency only.
    The result is None if the loop is stable for factors up to 1000.  The loop itself must be stable.
    """

    def stable(gain: float) -> bool:
        return abs(Lifted(tuple(close(sample, gain) for sample in model.samples)).poles()[0]) < 1.0

    # 6 % from step to step: an unstable range narrower than that could be passed over
    steps = np.geomspace(1.0, _HIGHEST, _STEPS)
    first = next((i for i, gain in enumerate(steps) if i > 0 and not stable(gain)), None)
    if first is None:
        return None
    low, high = float(steps[first - 1]), float(steps[first])
    while high / low - 1.0 > 1e-7:
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low


def delay_edge(model: Lifted) -> int | None:
    """Return the number of samples by which the dead time may grow while the loop stays stable, from its poles.

    The result is None if the loop is stable even with 400 additional samples.
    """
    N, place, row = len(model.samples), model.inputs.index("cut"), model.outputs.index("force")
    n = model.samples[0].A.shape[0]
    for count in range(1, _LATEST + 1):
        product = np.eye(n + count)
        for k in range(N):  # the forces on their way, the oldest first
            sample, step = model.samples[k], np.zeros((n + count, n + count))
            step[:n, :n], step[:n, n] = sample.A, sample.B[:, place]
            step[n:-1, n + 1 :] = np.eye(count - 1)
            step[-1, :n], step[-1, n] = sample.C[row], sample.D[row, place]
            product = step @ product
        if np.max(np.abs(np.linalg.eigvals(product))) >= 1.0:
            return count - 1
    return None

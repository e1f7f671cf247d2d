"""The loop opened at the actuator and closed again: one linearization gives poles, all responses and robustness."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import matrix_balance, schur

from feeddrive.analysis.margins import margins
from feeddrive.analysis.stiffness import rope_snap
from feeddrive.language.errors import ParameterError
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.linearize import StateSpace, linearize
from feeddrive.loop.loop import Loop

_LOWEST = 1e-5  # of Nyquist: where the lines of a loop gain begin
_LINES = 40  # a decade
_APART = 2e-4  # of a frequency: lines keep this distance
_BESIDE = np.linspace(-4.0, 4.0, 33)  # half widths of a resonance at which lines are added


@dataclass(frozen=True, eq=False)
class LoopModel:
    """The linear model of a loop from `cut` and further inputs to `force` and `position_load`, and its closed form.

    open    the loop cut between control and actuator
    closed  the same model with cut = force
    """

    open: StateSpace
    closed: StateSpace

    def lines(self, per_decade: int = _LINES) -> np.ndarray:
        """Frequencies in Hz up to Nyquist, spread evenly over ln f and denser around each resonance."""
        nyquist = 0.5 / self.open.sample_time
        spread = np.geomspace(_LOWEST * nyquist, nyquist, round(-np.log10(_LOWEST) * per_decade))
        poles = np.concatenate([self.open.poles(), self.closed.poles()])
        poles = poles[(np.abs(poles) > 0.1) & (np.abs(poles.imag) > 0.0)]
        s = np.log(poles) / self.open.sample_time
        beside = np.abs(s.imag)[:, None] + np.abs(s.real)[:, None] * _BESIDE
        near = beside.ravel() / (2.0 * np.pi)
        both = np.unique(np.concatenate([spread, near[(near > spread[0]) & (near < nyquist)]]))
        # a parabola through lines that nearly coincide would be fitted to rounding errors; the last line is Nyquist
        return both[np.append(np.diff(both) > _APART * both[:-1], True)]

    def loop_gain(self, frequency: np.ndarray) -> FRF:
        """L = -force/cut: 1 + L = 0 is the edge of stability.

        (z - A)⁻¹ by the Schur form of the balanced A, from its last row up: unitary, so as safe as solving for each
        frequency, and ten times as quick.
        """
        model = self.open
        row, column = model.outputs.index("force"), model.inputs.index("cut")
        z = np.exp(2j * np.pi * frequency * model.sample_time)
        # m and N differ by ten powers of ten: unbalanced, the rounding of the large ones would swallow the small ones
        A, (scale, _) = matrix_balance(model.A, permute=False, separate=True)
        form = schur(A, output="complex")
        S, Z = form[0], form[1]
        left = (model.C[row] * scale) @ Z
        right = np.repeat((Z.conj().T @ (model.B[:, column] / scale))[:, None], z.size, axis=1)
        values = np.full(z.size, model.D[row, column], dtype=complex)
        for i in range(scale.size - 1, -1, -1):
            x = right[i] / (z - S[i, i])
            right[:i] += S[:i, i, None] * x
            values += left[i] * x
        return FRF(frequency, -values, "cut", "force", "N/N", model.sample_time)


def loop_model(loop: Loop, *, velocity: float = 0.05) -> LoopModel:
    """The linear model of a loop that moves with `velocity` (m/s), opened at the actuator.

    Its inputs are `cut`, `load_force` and both readings.
    Raises ParameterError for a law whose period is several samples (multirate): it has no loop gain at the actuator.
    """
    if loop.control.law.period() > 1:
        raise ParameterError(
            f"the law '{loop.control.law.kind}' repeats itself only every {loop.control.law.period()} samples: its "
            f"loop has no gain at the actuator, and no margins"
        )
    inputs = ("cut", "load_force", "reading_motor", "reading_load")
    model = linearize(loop, inputs, ("force", "position_load"), velocity=velocity)
    return LoopModel(model, close(model))


def close(model: StateSpace) -> StateSpace:
    """The model with its input `cut` fed by its output `force`; the other inputs and outputs stay.

    x' = A x + b f + B u,  f = c x + d u  gives  x' = (A + b c) x + (B + b d) u: the command of a sample never depends
    on the actuator's force in the same sample.
    """
    place, row = model.inputs.index("cut"), model.outputs.index("force")
    kept = [i for i in range(len(model.inputs)) if i != place]
    b, c, d = model.B[:, [place]], model.C[[row]], model.D[[row]][:, kept]
    through = model.D[:, [place]]
    return StateSpace(
        model.A + b @ c, model.B[:, kept] + b @ d, model.C + through @ c, model.D[:, kept] + through @ d,
        model.sample_time, model.states, tuple(model.inputs[i] for i in kept), model.outputs,
    )  # fmt: skip


_EDGE = 1e-9  # of |z|: what eigenvalues of a small matrix are uncertain by


class Robustness(NamedTuple):
    """Figures of one loop. If it is not stable, those after `growth` are infinite and the delay margin is 0."""

    growth: float  # |z| of the largest pole; infinite where the parameters do not fit each other
    sensitivity_peak: float = np.inf  # Ms
    delay_margin_samples: float = 0.0  # infinite without a gain crossover
    rope_snap: float = np.inf  # m s^½/N

    @property
    def stable(self) -> bool:
        """All poles inside the unit circle."""
        return self.growth < 1.0 - _EDGE


def robustness(loop: Loop, *, velocity: float = 0.05, per_decade: int = 40) -> Robustness:
    """The figures of a loop that moves with `velocity` (m/s), opened at the actuator."""
    both = loop_model(loop, velocity=velocity)
    poles = both.closed.poles()
    growth = float(abs(poles[0])) if poles.size else 0.0
    if not Robustness(growth).stable:
        return Robustness(growth)
    found = margins(both.loop_gain(both.lines(per_decade)))
    if not np.isfinite(found.sensitivity_peak):
        return Robustness(np.inf)  # the parameters are so extreme that rounding leaves no digits
    delay = found.delay_margin_samples
    return Robustness(growth, found.sensitivity_peak, np.inf if delay is None else delay, rope_snap(both.closed))

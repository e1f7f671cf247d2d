"""How an axis recovers from a force that is switched on, or from a rope that is cut: linear figures."""

from __future__ import annotations

import numpy as np

from feeddrive.analysis.sums import summed
from feeddrive.loop.linearize import StateSpace

_ROUNDING = 1e-9  # of what the terms of a static compliance amount to


def rope_snap(model: StateSpace) -> float:
    """ISE^½ of a force step of 1 N, in m s^½/N: the L2 norm of the position's response; infinite where it stays off.

        ISE^½ = [∫ |C|²/ω² dω/π]^½ = [T Σ y(k)²]^½,   y the response of a model from `load_force` to `position_load`

    From the sum over all samples (`summed`): C x(k) = C A^k (x(0) - x(∞)), x(∞) = (1 - A)⁻¹ B.
    Without integral action the axis does not come back, and the figure is infinite.
    Raises UnstableError for a model that is not stable.
    """
    column, row = model.inputs.index("load_force"), model.outputs.index("position_load")
    A, B, C, D = model.A, model.B[:, column], model.C[row], model.D[row, column]
    P = summed(A, np.outer(C, C))
    rest = np.linalg.solve(np.eye(A.shape[0]) - A, B)
    left = float(C @ rest + D)
    scale = np.sum(np.abs(C * rest)) + abs(D) + np.linalg.norm(B) * np.linalg.norm(C)
    if abs(left) > _ROUNDING * scale:
        return float("inf")
    return float(np.sqrt(max(rest @ P @ rest, 0.0) * model.sample_time))


def rope_snap_of_lines(frequency: np.ndarray, compliance: np.ndarray, T: float) -> float:
    """The same from a compliance over frequency (Hz, from near 0 to Nyquist; m/N), by the trapezoidal rule.

        ISE = ∫ |C|² T² / (2 - 2 cos ωT) dω/π

    which is |C|²/ω² of a continuous loop with the step held over the samples, so that both forms agree.
    """
    angle = 2.0 * np.pi * frequency * T
    values = np.abs(compliance) ** 2 * (T / (2.0 * np.sin(0.5 * angle))) ** 2
    # below the first line the integrand is that line's: with integral action C falls as ω
    return float(np.sqrt(2.0 * frequency[0] * values[0] + np.trapezoid(values, 2.0 * frequency)))


def force_noise(model: StateSpace, motor: float, load: float, *, shared: bool = False) -> float:
    """RMS of the commanded force in N, from white errors of the readings with standard deviations in m.

    motor, load  of the two readings, independent of each other
    shared       one encoder gives both readings: its error, `load`, is in both

    A count of q has an error of q/√12, white as long as the axis moves by a count or more each sample.
    Raises UnstableError for a model that is not stable.
    """
    row = model.outputs.index("force")
    first, second = (model.inputs.index(name) for name in ("reading_motor", "reading_load"))
    B, D = model.B[:, [first, second]], model.D[row, [first, second]]
    scales = np.array([[load], [load]]) if shared else np.diag([motor, load])
    into, through = B @ scales, D @ scales
    P = summed(model.A, np.outer(model.C[row], model.C[row]))
    return float(np.sqrt(max(np.trace(into.T @ P @ into), 0.0) + np.sum(through * through)))

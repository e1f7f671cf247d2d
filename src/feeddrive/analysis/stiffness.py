"""Response of the closed loop to a force on the table: dynamic stiffness, ISE of a force step, force noise."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from feeddrive.analysis.conversion import as_frf
from feeddrive.analysis.margins import least
from feeddrive.language.errors import ParameterError, UnstableError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Cell, Column, Result, Table
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.lifting import Lifted
from feeddrive.loop.linearize import StateSpace

_DOUBLINGS = 64  # 2^64 samples: longer than any run


def summed(A: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """P = Σ (Aᵀ)^k Q A^k over k = 0, 1, ...: the solution of P = Aᵀ P A + Q.

    P ← P + Aᵀ P A, A ← A A doubles the number of terms in each step.
    Raises UnstableError if the sum does not end.  Source: Smith 1968 (squaring for the Lyapunov equation).
    """
    total, power = Q.copy(), A.copy()
    with np.errstate(all="ignore"):
        for _ in range(_DOUBLINGS):
            more = power.T @ total @ power
            total = total + more
            if not np.all(np.isfinite(total)):
                break
            if np.max(np.abs(more), initial=0.0) <= 1e-15 * np.max(np.abs(total), initial=0.0):
                return total
            power = power @ power
    raise UnstableError("the sum over all time does not end: the loop is not stable, or at its edge")


NAMED = (1.0, 10.0, 100.0, 1000.0)  # Hz, at which the table states it


@dataclass(frozen=True, eq=False, repr=False)
class Stiffness(Result):
    """|force/displacement| in N/m at `frequency` in Hz, both of shape (n,); shown in N/um.

    `static` is its limit at 0 Hz, infinite with integral action, None where it is not known.
    """

    frequency: np.ndarray
    magnitude: np.ndarray
    static: float | None = None

    @property
    def minimum(self) -> float:
        """The least stiffness, N/m."""
        return float(np.exp(self._least()[1]))

    @property
    def minimum_frequency(self) -> float:
        """The frequency of the least stiffness, Hz."""
        return float(np.exp(self._least()[0]))

    @property
    def mean(self) -> float:
        """Geometric mean over the lines, N/m; over lines evenly spaced in ln f the mean of a band on log-log paper."""
        return float(np.exp(np.mean(np.log(self.magnitude))))

    def _least(self) -> tuple[float, float]:
        return least(np.log(self.frequency), np.log(self.magnitude))

    def at(self, frequency: float) -> float:
        """N/m at a frequency in Hz, straight between lines on log-log paper. Raises ParameterError outside of them."""
        if not self.frequency[0] <= frequency <= self.frequency[-1]:
            raise ParameterError(
                f"frequency {Quantity(frequency, 'Hz'):6} is outside of the stiffness's lines, "
                f"{Quantity(self.frequency[0], 'Hz', bare=True):6} to {Quantity(self.frequency[-1], 'Hz'):6}"
            )
        return float(np.exp(np.interp(np.log(frequency), np.log(self.frequency), np.log(self.magnitude))))

    def table(self, frequencies: Sequence[float] = NAMED) -> Table:
        """Static, minimum, and at named frequencies as far as they were computed."""
        rows = list[list[Cell]]()
        if self.static is not None:
            rows.append(["static", 0.0, self.static if np.isfinite(self.static) else "infinite"])
        rows.append(["minimum", self.minimum_frequency, self.minimum])
        inside = [f for f in frequencies if self.frequency[0] <= f <= self.frequency[-1]]
        rows += [["dynamic", f, self.at(f)] for f in inside]
        columns = ["kind", Column("frequency", "Hz"), Column("stiffness", "N/m")]
        return Table("dynamic stiffness of the closed loop", columns, rows)


def stiffness(compliance: FRF | Any, static: float | None = None, *, frequency: np.ndarray | None = None) -> Stiffness:
    """The inverse of a closed-loop compliance in m/N, modeled or measured; `static` in N/m if it is known.

    Raises ParameterError if there are no lines or the compliance is zero on one, where the stiffness is not a number.
    """
    compliance = as_frf(compliance, frequency)
    magnitude = compliance.magnitude
    if not magnitude.size:
        raise ParameterError("a stiffness needs at least one line of compliance")
    if np.any(magnitude == 0.0):
        where = compliance.frequency[np.argmin(magnitude)]
        raise ParameterError(f"the compliance is zero at {Quantity(where, 'Hz'):6}: leave out this line")
    return Stiffness(compliance.frequency, 1.0 / magnitude, static)


_ROUNDING = 1e-9  # of what the terms of a static compliance amount to


def trapezoid_weights(x: np.ndarray) -> np.ndarray:
    """w of ∫ y dx = Σ w y by the trapezoidal rule; x of shape (n,), n >= 1, rising."""
    width = np.zeros(x.size)
    step = 0.5 * np.diff(x)
    width[:-1] += step
    width[1:] += step
    return width


def mean_compliance(frequency: np.ndarray, compliance: np.ndarray, band: tuple[float, float]) -> float:
    """RMS of |C| over ln f in m/N, [∫ |C|² d ln f / ∫ d ln f]^½ by the trapezoidal rule, from the lines in the band.

    frequency, band in Hz; compliance in m/N, of the closed loop.  At least two lines must lie in the band.
    """
    inside = (frequency >= band[0]) & (frequency <= band[1])
    x = np.log(frequency[inside])
    return float(np.sqrt(np.trapezoid(np.abs(compliance[inside]) ** 2, x) / (x[-1] - x[0])))


def static_stiffness(model: StateSpace) -> float:
    """The stiffness at 0 Hz in N/m of a model from `load_force` to a position: infinite with integral action.

    1/|C (I - A)⁻¹ B + D|; a compliance below 1e-9 of what the terms of that sum amount to is rounding and counts as 0.
    Raises ParameterError for a model that drifts away under a constant force.
    """
    n = model.A.shape[0]
    try:
        moved = np.linalg.solve(np.eye(n) - model.A, model.B[:, 0])
    except np.linalg.LinAlgError:
        raise ParameterError(
            "the model drifts away under a constant force: close its position loop, or use its dynamic stiffness"
        ) from None
    compliance = float(model.C[0] @ moved + model.D[0, 0])
    scale = float(np.sum(np.abs(model.C[0] * moved)) + abs(model.D[0, 0]))
    cancelled = np.linalg.norm(model.B[:, 0]) * np.linalg.norm(model.C[0])
    return float("inf") if abs(compliance) <= _ROUNDING * max(scale, cancelled) else 1.0 / abs(compliance)


def rope_snap(model: StateSpace | Lifted) -> float:
    """ISE^½ of a force step of 1 N, in m s^½/N: the L2 norm of the position's response; infinite if an offset remains.

        ISE^½ = [∫ |C|²/ω² dω/π]^½ = [T Σ y(k)²]^½,   y the response of a model from `load_force` to `position_load`

    From the sum over all samples (`summed`): C x(k) = C A^k (x(0) - x(∞)), x(∞) = (1 - A)⁻¹ B.
    Without integral action the axis does not come back, and the figure is infinite.  Of a lifted model over all samples
    of its periods, for a step at the beginning of one.
    Raises UnstableError for a model that is not stable.
    """
    if isinstance(model, Lifted):
        a, b, c, d = model.stacked(["load_force"], ["position_load"])
        rest = np.linalg.solve(np.eye(a.shape[0]) - a, np.sum(b, axis=1))
        left = c @ rest + np.sum(d, axis=1)
        scale = np.abs(c) @ np.abs(rest) + np.sum(np.abs(d), axis=1) + np.linalg.norm(b) * np.linalg.norm(c)
        if np.any(np.abs(left) > _ROUNDING * scale):
            return float("inf")
        return float(np.sqrt(max(rest @ summed(a, c.T @ c) @ rest, 0.0) * model.sample_time))
    column, row = model.inputs.index("load_force"), model.outputs.index("position_load")
    A, B, C, D = model.A, model.B[:, column], model.C[row], model.D[row, column]
    P = summed(A, np.outer(C, C))
    rest = np.linalg.solve(np.eye(A.shape[0]) - A, B)
    left = float(C @ rest + D)
    scale = np.sum(np.abs(C * rest)) + abs(D) + np.linalg.norm(B) * np.linalg.norm(C)
    if abs(left) > _ROUNDING * scale:
        return float("inf")
    return float(np.sqrt(max(rest @ P @ rest, 0.0) * model.sample_time))


def rope_snap_weights(frequency: np.ndarray, T: float) -> np.ndarray:
    """w in s² Hz of ISE = Σ w |C|², with the compliance C in m/N on lines in Hz, from near 0 to Nyquist at most.

        ISE = ∫ |C|² T² / (2 - 2 cos ωT) dω/π

    which is |C|²/ω² of a continuous loop with the step held over the samples, so that `rope_snap` of the model agrees.
    By the trapezoidal rule.  Below the first line the integrand is that line's: with integral action C falls as ω.
    """
    kernel = (T / (2.0 * np.sin(np.pi * frequency * T))) ** 2
    width = trapezoid_weights(frequency)
    width[0] += frequency[0]
    return 2.0 * kernel * width


def rope_snap_of_lines(frequency: np.ndarray, compliance: np.ndarray, T: float) -> float:
    """The rope snap in m s^½/N from a closed-loop compliance in m/N over frequency in Hz: `rope_snap_weights`."""
    return float(np.sqrt(np.sum(rope_snap_weights(frequency, T) * np.abs(compliance) ** 2)))


def rope_snap_of_run(displacement: np.ndarray, force: float, T: float) -> float:
    """The rope snap in m s^½/N from samples of the displacement (m) that a step of `force` (N) causes: [T Σ y²]^½/F.

    The run must last until the axis is back.
    """
    return float(np.sqrt(T * np.sum(displacement**2))) / force


def force_noise(model: StateSpace | Lifted, motor: float, load: float, *, shared: bool = False) -> float:
    """RMS of the commanded force in N, from white errors of the readings with standard deviations in m.

    motor, load  of the two readings, independent of each other
    shared       one encoder gives both readings: its error, `load`, is in both

    A count of q has an error of q/√12, white as long as the axis moves by a count or more each sample.  Of a lifted
    model the mean over the samples of a period.
    Raises UnstableError for a model that is not stable.
    """
    if isinstance(model, Lifted):
        N = len(model.samples)
        a, b, c, d = model.stacked(["reading_motor", "reading_load"], ["force"])
        mixed = np.kron(np.array([[load], [load]]) if shared else np.diag([motor, load]), np.eye(N))
        into, through = b @ mixed, d @ mixed
        power = np.trace(into.T @ summed(a, c.T @ c) @ into) + np.sum(through * through)
        return float(np.sqrt(max(power, 0.0) / N))
    row = model.outputs.index("force")
    first, second = (model.inputs.index(name) for name in ("reading_motor", "reading_load"))
    B, D = model.B[:, [first, second]], model.D[row, [first, second]]
    scales = np.array([[load], [load]]) if shared else np.diag([motor, load])
    into, through = B @ scales, D @ scales
    P = summed(model.A, np.outer(model.C[row], model.C[row]))
    return float(np.sqrt(max(np.trace(into.T @ P @ into), 0.0) + np.sum(through * through)))


def reading_deviation(encoder: Any) -> float:
    """Standard deviation in m of an encoder's reading: that of its counts, q/√12, and its noise; 0 without either."""
    resolution = getattr(encoder, "resolution", None) or 0.0
    return math.hypot(resolution / math.sqrt(12.0), getattr(encoder, "noise", None) or 0.0)


def force_noise_weights(frequency: np.ndarray, T: float) -> np.ndarray:
    """w of σ_u² = Σ w |C S|² σ², the variance of the command by one reading with a white error of σ.

        σ_u² = σ² 2 T ∫ |C S|² df   from 0 to 1/(2T)

    By the trapezoidal rule over lines in Hz; below the first and above the last line the integrand is that line's.
    C: the control's response from that reading, N/m, with dead time or without; S = 1/(1 + L).
    """
    width = trapezoid_weights(frequency)
    width[0] += frequency[0]
    width[-1] += max(0.5 / T - frequency[-1], 0.0)
    return 2.0 * T * width


def force_noise_of_lines(frequency: np.ndarray, T: float, readings: Sequence[tuple[np.ndarray, float]]) -> float:
    """RMS of the commanded force in N from responses C S (N/m) of readings and their white errors in m, independent."""
    weight = force_noise_weights(frequency, T)
    return float(np.sqrt(sum(float(np.sum(weight * sigma**2 * np.abs(C) ** 2)) for C, sigma in readings)))

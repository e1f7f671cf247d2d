"""Disturbance response and robustness of the closed loop: dynamic stiffness, rope-snap error, noise, margins."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from feeddrive.analysis.conversion import as_frf
from feeddrive.analysis.loop_model import loop_model
from feeddrive.analysis.margins import least, margins
from feeddrive.language.errors import ParameterError, UnstableError
from feeddrive.language.quantity import Quantity, span
from feeddrive.language.table import Cell, Column, Result, Table
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.linearize import Lifted, StateSpace
from feeddrive.loop.loop import Loop

_DOUBLINGS = 64  # 2^64 samples: longer than any run


def summed(A: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """Return P = Σ (Aᵀ)^k Q A^k over k = 0, 1, ...: the solution of P = Aᵀ P A + Q.

    Each step, P ← P + Aᵀ P A and A ← A A, doubles the number of terms.
    Raises UnstableError if the sum does not converge.  Source: Smith 1968 (squaring for the Lyapunov equation).
    """
    total, power = Q.copy(), A.copy()
    # an unstable A overflows on purpose: the test below reports it
    with np.errstate(all="ignore"):
        for _ in range(_DOUBLINGS):
            more = power.T @ total @ power
            total = total + more
            if not np.all(np.isfinite(total)):
                break
            # relative to the largest entry: what follows would be rounded away
            if np.max(np.abs(more), initial=0.0) <= 1e-15 * np.max(np.abs(total), initial=0.0):
                return total
            power = power @ power
    raise UnstableError("the sum over all time does not end: the loop is not stable, or at its edge")


NAMED = (1.0, 10.0, 100.0, 1000.0)  # Hz, at which the table states it


@dataclass(frozen=True, eq=False, repr=False)
class Stiffness(Result):
    """The dynamic stiffness |force/displacement| in N/m by `frequency` in Hz, both of shape (n,); displayed in N/um.

    `static` is its limit at 0 Hz: infinite with integral action, None if unknown.
    """

    frequency: np.ndarray
    magnitude: np.ndarray
    static: float | None = None

    @property
    def minimum(self) -> float:
        """The minimum stiffness, N/m."""
        return float(np.exp(self._least()[1]))

    @property
    def minimum_frequency(self) -> float:
        """The frequency of the minimum stiffness, Hz."""
        return float(np.exp(self._least()[0]))

    @property
    def mean(self) -> float:
        """The geometric mean of the stiffness over the frequency lines, N/m.

        For lines evenly spaced in ln f, it is the mean height of the curve on log-log axes.
        """
        return float(np.exp(np.mean(np.log(self.magnitude))))

    def _least(self) -> tuple[float, float]:
        return least(np.log(self.frequency), np.log(self.magnitude))

    def at(self, frequency: float) -> float:
        """Return the stiffness in N/m at a frequency in Hz, interpolated on log-log axes.

        Raises ParameterError for a frequency beyond the first or last line.
        """
        if not self.frequency[0] <= frequency <= self.frequency[-1]:
            raise ParameterError(
                f"frequency {Quantity(frequency, 'Hz'):6} is outside of the stiffness's lines, "
                f"{span(self.frequency[0], self.frequency[-1], 'Hz', '6')}"
            )
        return float(np.exp(np.interp(np.log(frequency), np.log(self.frequency), np.log(self.magnitude))))

    def table(self, frequencies: Sequence[float] = NAMED) -> Table:
        """Return a table of the static and minimum stiffness, and of the stiffness at those `frequencies` that lie
        within the range of the frequency lines.
        """
        rows = list[list[Cell]]()
        if self.static is not None:
            rows.append(["static", 0.0, self.static if np.isfinite(self.static) else "infinite"])
        rows.append(["minimum", self.minimum_frequency, self.minimum])
        inside = [f for f in frequencies if self.frequency[0] <= f <= self.frequency[-1]]
        rows += [["dynamic", f, self.at(f)] for f in inside]
        columns = ["kind", Column("frequency", "Hz"), Column("stiffness", "N/m")]
        return Table("dynamic stiffness of the closed loop", columns, rows)


def stiffness(compliance: FRF | Any, static: float | None = None, *, frequency: np.ndarray | None = None) -> Stiffness:
    """Return the inverse of a closed-loop compliance in m/N, modeled or measured; `static` in N/m if it is known.

    Raises ParameterError if there are no frequency lines or the compliance is zero at one of them.
    """
    compliance = as_frf(compliance, frequency)
    magnitude = compliance.magnitude
    if not magnitude.size:
        raise ParameterError("a stiffness needs at least one line of compliance")
    if np.any(magnitude == 0.0):
        where = compliance.frequency[np.argmin(magnitude)]
        raise ParameterError(f"the compliance is zero at {Quantity(where, 'Hz'):6}: leave out this line")
    return Stiffness(compliance.frequency, 1.0 / magnitude, static)


# integral action cancels terms exactly, apart from rounding of the solution of a system that is badly scaled
_ROUNDING = 1e-9  # of what the terms of a static compliance amount to


def trapezoid_weights(x: np.ndarray) -> np.ndarray:
    """Return the weights w of the trapezoidal rule, ∫ y dx = Σ w y; x of shape (n,), n >= 1, ascending."""
    width = np.zeros(x.size)
    step = 0.5 * np.diff(x)
    width[:-1] += step
    width[1:] += step
    return width


def mean_compliance(frequency: np.ndarray, compliance: np.ndarray, band: tuple[float, float]) -> float:
    """Return the RMS of |C| over ln f within a band, in m/N.

        [∫ |C|² d ln f / ∫ d ln f]^½,   by the trapezoidal rule

    frequency, band in Hz; compliance in m/N, of the closed loop.  At least two frequency lines must lie in the band.
    """
    inside = (frequency >= band[0]) & (frequency <= band[1])
    x = np.log(frequency[inside])
    return float(np.sqrt(np.trapezoid(np.abs(compliance[inside]) ** 2, x) / (x[-1] - x[0])))


def static_stiffness(model: StateSpace) -> float:
    """Return the stiffness at 0 Hz in N/m of a model from `load_force` to a position; infinite with integral action.

    It is 1/|C (I - A)⁻¹ B + D|; a compliance below 1e-9 of the magnitude of its terms is rounding error and taken as 0.
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
    # the terms themselves may be rounding: then their sum is no measure, but the size of B and C is
    cancelled = np.linalg.norm(model.B[:, 0]) * np.linalg.norm(model.C[0])
    return float("inf") if abs(compliance) <= _ROUNDING * max(scale, cancelled) else 1.0 / abs(compliance)


def rope_snap(model: StateSpace | Lifted, output: str = "position_load") -> float:
    """Return the square root of the integrated squared position error (ISE) after a force step of 1 N, in m s^½/N.

        ISE^½ = [∫ |C|²/ω² dω/π]^½ = [T Σ y(k)²]^½,   y the response of a model from `load_force` to `output`

    The sum over all samples (`summed`) uses C x(k) = C A^k (x(0) - x(∞)), x(∞) = (1 - A)⁻¹ B.
    Without integral action the axis does not return to its position, and the result is infinite.  With one encoder at
    the motor the table does not return either, since the force keeps the spring deflected.  For a lifted model,
    the sum covers all samples of each period, and the step is at the start of a period.
    Raises UnstableError for a model that is not stable.
    """
    if isinstance(model, Lifted):
        a, b, c, d = model.stacked(["load_force"], [output])
        rest = np.linalg.solve(np.eye(a.shape[0]) - a, np.sum(b, axis=1))
        left = c @ rest + np.sum(d, axis=1)
        scale = np.abs(c) @ np.abs(rest) + np.sum(np.abs(d), axis=1) + np.linalg.norm(b) * np.linalg.norm(c)
        if np.any(np.abs(left) > _ROUNDING * scale):
            return float("inf")
        return float(np.sqrt(max(rest @ summed(a, c.T @ c) @ rest, 0.0) * model.sample_time))
    column, row = model.inputs.index("load_force"), model.outputs.index(output)
    A, B, C, D = model.A, model.B[:, column], model.C[row], model.D[row, column]
    # before the solution: an unstable loop is refused, whereas x(∞) exists for it too
    P = summed(A, np.outer(C, C))
    rest = np.linalg.solve(np.eye(A.shape[0]) - A, B)
    left = float(C @ rest + D)
    scale = np.sum(np.abs(C * rest)) + abs(D) + np.linalg.norm(B) * np.linalg.norm(C)
    if abs(left) > _ROUNDING * scale:
        return float("inf")
    # rounding may leave a tiny negative square
    return float(np.sqrt(max(rest @ P @ rest, 0.0) * model.sample_time))


def rope_snap_weights(frequency: np.ndarray, T: float) -> np.ndarray:
    """Return the weights w, in s² Hz, for ISE = Σ w |C|², with the compliance C in m/N on lines in Hz up to Nyquist.

        ISE = ∫ |C|² T² / (2 - 2 cos ωT) dω/π

    ISE is the integrated squared error after a force step, as in `rope_snap`.  The integrand is the sampled counterpart
    of |C|²/ω², which applies to a continuous loop.
    The integral is evaluated by the trapezoidal rule; below the first line the integrand is constant, since C is
    proportional to ω with integral action.
    """
    # 2 - 2 cos ωT = 4 sin²(ωT/2): the cosine would lose all digits at low frequencies
    kernel = (T / (2.0 * np.sin(np.pi * frequency * T))) ** 2
    width = trapezoid_weights(frequency)
    width[0] += frequency[0]
    return 2.0 * kernel * width


def rope_snap_of_lines(frequency: np.ndarray, compliance: np.ndarray, T: float) -> float:
    """Return the rope snap in m s^½/N from a closed-loop compliance in m/N on lines in Hz, by `rope_snap_weights`."""
    return float(np.sqrt(np.sum(rope_snap_weights(frequency, T) * np.abs(compliance) ** 2)))


def rope_snap_of_run(displacement: np.ndarray, force: float, T: float) -> float:
    """Return the rope snap [T Σ y²]^½/F in m s^½/N from samples of the displacement (m) after a step of `force` (N).

    The run must last until the axis has returned.
    """
    return float(np.sqrt(T * np.sum(displacement**2))) / force


def force_noise(model: StateSpace | Lifted, motor: float, load: float, *, shared: bool = False) -> float:
    """Return the RMS of the commanded force in N due to white noise of the readings.

    motor, load  standard deviations of the two readings in m, whose errors are independent
    shared       True if one encoder gives both readings: its error, `load`, is in both

    The quantization error of a count of length q has the standard deviation q/√12; it is white if the axis moves by at
    least one count per sample.  For a lifted model the mean square is averaged over the samples of a period.
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
    """Return the standard deviation of an encoder's reading in m, from quantization (resolution/√12) and noise."""
    resolution = getattr(encoder, "resolution", None) or 0.0
    # the error of a count is uniform over one count
    return math.hypot(resolution / math.sqrt(12.0), getattr(encoder, "noise", None) or 0.0)


def force_noise_weights(frequency: np.ndarray, T: float) -> np.ndarray:
    """Return the weights w for σ_u² = Σ w |C S|² σ², the variance of the command due to white noise σ of one reading.

        σ_u² = σ² 2 T ∫ |C S|² df   from 0 to 1/(2T)

    The integral is evaluated by the trapezoidal rule over lines in Hz, with a constant integrand below the first and
    above the last line.  C is the controller's response from that reading in N/m; S = 1/(1 + L).  A dead time of C has
    no effect.
    """
    width = trapezoid_weights(frequency)
    width[0] += frequency[0]
    # measured lines often end below Nyquist, where the command still passes noise
    width[-1] += max(0.5 / T - frequency[-1], 0.0)
    return 2.0 * T * width


def force_noise_of_lines(frequency: np.ndarray, T: float, readings: Sequence[tuple[np.ndarray, float]]) -> float:
    """Return the RMS of the commanded force in N due to independent white noise of the readings.

    readings  for each reading, the response C S in N/m and the standard deviation of the noise in m
    """
    weight = force_noise_weights(frequency, T)
    return float(np.sqrt(sum(float(np.sum(weight * sigma**2 * np.abs(C) ** 2)) for C, sigma in readings)))


_EDGE = 1e-9  # of |z|: the uncertainty of eigenvalues of a small matrix


class Robustness(NamedTuple):
    """The robustness figures of a loop; an unstable loop has infinite Ms and rope snap, and a delay margin of 0."""

    growth: float  # |z| of the largest pole; infinite where the parameters do not fit each other
    sensitivity_peak: float = np.inf  # Ms
    delay_margin_samples: float = 0.0  # infinite without a gain crossover
    rope_snap: float = np.inf  # m s^½/N

    @property
    def stable(self) -> bool:
        """True if all poles lie inside the unit circle."""
        return self.growth < 1.0 - _EDGE


def robustness(loop: Loop, *, velocity: float = 0.05, per_decade: int = 40) -> Robustness:
    """Compute the robustness figures of a loop whose axis moves at `velocity` (m/s).

    The margins are those of the loop opened at the actuator.
    """
    both = loop_model(loop, velocity=velocity)
    poles = both.closed.poles()  # over a period
    growth = float(abs(poles[0])) if poles.size else 0.0
    # margins of an unstable loop are numbers without a meaning
    if not Robustness(growth).stable:
        return Robustness(growth)
    margins_ = margins(both.loop_gain(both.lines(per_decade)))
    if not np.isfinite(margins_.sensitivity_peak):
        return Robustness(np.inf)  # the parameters are so extreme that rounding leaves no digits
    delay = margins_.delay_margin_samples
    return Robustness(growth, margins_.sensitivity_peak, np.inf if delay is None else delay, rope_snap(both.closed))

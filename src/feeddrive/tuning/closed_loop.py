"""Closed-loop responses of a controller at an operating point, with derivatives and measurement variances."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from feeddrive.analysis.margins import Logarithms, Margins, bandwidth, logarithms, margins, peak_deviation
from feeddrive.analysis.stiffness import Stiffness, rope_snap_of_lines, stiffness
from feeddrive.figures.catalogue import figures as catalogue
from feeddrive.figures.figure import NEUTRAL, Figure
from feeddrive.figures.of_loops import SENSITIVITY_PEAK
from feeddrive.figures.slopes import Reading, force_noise_of
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.linearize import StateSpace
from feeddrive.tuning.control_response import READINGS, Response
from feeddrive.tuning.operating_point import OperatingPoint

# lower end of the extension as a share of the first line, and its number of lines: below a first line of 1 Hz, recovery
# times of minutes still show
_DEEPEST, _LINES = 1e-3, 40


class Recovery(NamedTuple):
    """Frequency lines, compliance and the derivatives of the compliance, for computing the rope-snap error."""

    frequency: np.ndarray
    compliance: np.ndarray
    slope: np.ndarray


class Below:
    """The axis of an operating point below its first line f₁, extrapolated as a free mass.

        X_load(f) = X_load(f₁) (f₁/f)²,    X_motor/X_load = 1 + ρ,  ρ(f) = ρ(f₁) (f/f₁)²
        y = X_d (1 + C_motor X_u (ρ_d - ρ_u)) / (1 + L),    L = -X_u (C_motor (1 + ρ_u) + C_load)

    X is the response of a reading to the command (u) or to a force on the table (d), C the response of the controller
    to a reading, and y the compliance. With integral action, y is nearly 1/C, regardless of the mass; a rough
    extrapolation therefore suffices to reveal a law that recovers slowly from a disturbance.
    """

    def __init__(self, point: OperatingPoint) -> None:
        first = point.frequency[0]
        self.frequency = first * np.geomspace(_DEEPEST, 1.0, _LINES, endpoint=False)
        down = (first / self.frequency) ** 2
        self.by_force, self.by_load = point.by_force[1, 0] * down, point.by_load[1, 0] * down
        self.apart_force, self.apart_load = (
            (response[0, 0] / response[1, 0] - 1.0) / down for response in (point.by_force, point.by_load)
        )

    def recovery(self, response: Response) -> Recovery:
        """Return the compliance of the closed loop; `response` is that of the controller on these lines."""
        (C, D), (dC, dD) = response.value, response.slope
        loop = -self.by_force * (C * (1.0 + self.apart_force) + D)
        dloop = -self.by_force[:, None] * (dC * (1.0 + self.apart_force)[:, None] + dD)
        twist = self.by_force * (self.apart_load - self.apart_force)
        S = 1.0 / (1.0 + loop)
        y = self.by_load * (1.0 + C * twist) * S
        return Recovery(self.frequency, y, (self.by_load * S * twist)[:, None] * dC - (y * S)[:, None] * dloop)


# lines for counting integrators: up to this multiple of the first one, and at least this number
_LOWEST, _FEWEST = 2.5, 5
# Times the first line: a pole of the control below it counts as an integrator. A resonance near it changes the phase at
# the lowest lines by less than 5° of the 90° that decide.
_SLOW = 30.0


@dataclass(frozen=True, eq=False)
class Answer:
    """The closed-loop responses at the frequency lines of an operating point.

    Derivatives have shape (lines, tunables), variances (lines,).  The compliance is computed when it is first needed:
    at a plant of a box only limits apply, and most of them are limits of the loop gain.

    below   the compliance below the first line, where the axis is a free mass; None if not needed
    """

    point: OperatingPoint
    response: Response
    gain: np.ndarray
    gain_slope: np.ndarray
    gain_variance: np.ndarray
    below: Recovery | None = None

    @property
    def compliance(self) -> np.ndarray:
        """The compliance, m/N."""
        return self._table[0]

    @property
    def compliance_slope(self) -> np.ndarray:
        """The derivatives of the compliance."""
        return self._table[1]

    @property
    def compliance_variance(self) -> np.ndarray:
        """The variance of the compliance."""
        return self._table[2]

    @cached_property
    def _table(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The compliance, its derivatives and its variance, with the symbols of `answer`."""
        C, dC = self.response.value, self.response.slope
        xd, (yu, yd) = self.point.by_load, self.point.moved
        back, dback = np.einsum("kl,kl->l", C, xd), np.einsum("klp,kl->lp", dC, xd)
        S = 1.0 / (1.0 + self.gain)
        y = yd + yu * back * S
        dy = (yu * S)[:, None] * (dback - (back * S)[:, None] * self.gain_slope)
        return y, dy, _of_compliance(self.point, C, back, S)

    @property
    def frequency(self) -> np.ndarray:
        """The frequency lines, Hz."""
        return self.point.frequency

    @property
    def sample_time(self) -> float:
        """The sample time, s."""
        return self.point.sample_time

    @property
    def logarithms(self) -> Logarithms:
        """The logarithmic form of the loop gain."""
        return self._logarithms

    @property
    def thinned(self) -> bool:
        """True at a plant of a box, at which hundreds of lines would be near a limit."""
        return self.point.bounds_only

    @cached_property
    def _logarithms(self) -> Logarithms:
        return logarithms(self.point.frequency, self.gain)

    def readings(self, noise: tuple[float, float]) -> list[Reading]:
        """Return the responses from the encoder errors to the force; `noise` is the RMS error of motor and load, m."""
        C, dC = self.response.value, self.response.slope
        # the error of a single encoder enters both readings: the gains add, not their squares
        if self.point.ratio is not None and np.all(self.point.ratio[0] == 1.0):  # a single encoder gives both readings
            return [Reading(C[0] + C[1], dC[0] + dC[1], max(noise))]
        return [Reading(C[k], dC[k], noise[k]) for k in range(2)]

    def recovery(self) -> Recovery:
        """Return frequency lines, compliance and its derivatives, extended far below the first measured line."""
        lines = Recovery(self.point.frequency, self.compliance, self.compliance_slope)
        if self.below is None:
            return lines
        return Recovery(*(np.concatenate(pair) for pair in zip(self.below, lines, strict=True)))


def answer(point: OperatingPoint, response: Response, below: Recovery | None = None) -> Answer:
    """Compute the closed loop, with derivatives and first-order variances.

    The loop gain is L = -C·X_u, the compliance y = y_d + y_u (C·X_d)/(1 + L). C is the controller; X and y are the
    responses of the two readings and of the table to the command (u) and to a force on the table (d).
    """
    C, dC, xu = response.value, response.slope, point.by_force
    L = -np.einsum("kl,kl->l", C, xu)
    dL = -np.einsum("klp,kl->lp", dC, xu)
    gain_variance = np.zeros(point.frequency.size) if point.variance is None else through(point, 0, C)
    return Answer(point, response, L, dL, gain_variance, below)


def through(point: OperatingPoint, source: int, factors: np.ndarray) -> np.ndarray:
    """Return the variance of Σ factor·X, the weighted sum of both readings' responses X to one source.

    source   0: the command, 1: a force on the table
    factors  one factor per reading and line

    On lines where the motor reading is the load reading times a ratio, the errors of the two readings are fully
    correlated; on all others they are assumed to be independent.
    """
    variance = (point.variance, point.load_variance)[source]
    assert variance is not None
    independent = np.einsum("kl,kl->l", np.abs(factors) ** 2, variance)
    if point.ratio is None:
        return independent
    ratio = point.ratio[source]
    together = np.abs(factors[0] * ratio + factors[1]) ** 2 * variance[1] + np.abs(factors[0]) ** 2 * variance[0]
    return np.where(np.isnan(ratio), independent, together)


def _of_compliance(point: OperatingPoint, C: np.ndarray, back: np.ndarray, S: np.ndarray) -> np.ndarray:
    """Return the variance of the compliance.

    The derivatives are, with the symbols of `answer`, S = 1/(1 + L), back = C·X_d, and k for the reading,

        ∂y/∂X_u = C_k y_u back S² + back S (load),    ∂y/∂X_d = y_u S C_k + 1 (load)

    The terms marked (load) exist for the load reading only.
    """
    variance = np.zeros(S.size)
    if point.variance is None:
        return variance
    # only the load row is the table itself: the direct terms of y belong to it
    table = np.array([[0.0], [1.0]])
    yu = point.moved[0]
    # y = y_u S: a single measurement determines it
    if point.at_drive:
        return through(point, 0, table * S + C * (yu * S * S))
    variance = variance + through(point, 0, C * (yu * back * S * S) + table * (back * S))
    if point.load_variance is not None:
        variance = variance + through(point, 1, C * (yu * S) + table)
    return variance


# an uncontrolled free motion is a pole at 1, which rounding puts on either side
_EDGE = 1.0 - 1e-9  # of |z|: a motion that decays more slowly does not count as stable


def unstable(answer: Answer) -> bool:
    """Return True if the closed loop is unstable: by eigenvalues for a model, else by encirclements of -1."""
    axis, samples = answer.point.model, answer.response.samples
    return encircles(answer) if axis is None else grows(axis, samples)


def unstable_among(answers: Sequence[Answer]) -> bool:
    """Return True if one of several loops of a control is unstable."""
    groups: dict[tuple[int, ...], list[StateSpace]] = {}
    for each in answers:
        axis, samples = each.point.model, each.response.samples
        if axis is None or len(samples) > 1:
            if unstable(each):
                return True
        else:
            groups.setdefault(axis.A.shape, []).append(axis)
    return any(
        bool(
            np.any(
                growing(
                    np.array([axis.A for axis in axes]),
                    np.array([axis.B[:, axis.inputs.index("cut")] for axis in axes]),
                    np.array([axis.C[[axis.outputs.index(reading) for reading in READINGS]] for axis in axes]),
                    answers[0].response.samples[0],
                )
            )
        )
        for axes in groups.values()
    )


def grows(axis: StateSpace, samples: np.ndarray) -> bool:
    """Return True if an axis and a controller, given by [A B; c d] of each sample, form an unstable loop.

    The loop is unstable if the transition matrix of axis state x and controller state ξ over one period has an
    eigenvalue on or outside the unit circle. The transition is the product over the samples k of

        x ← A x + B (d_k C x + c_k ξ),    ξ ← A_k ξ + B_k C x

    Control states that do not affect the force, such as an integrator with zero gain, are ignored.
    """
    samples = with_effect(samples)
    n, many = samples.shape[1] - 1, axis.A.shape[0]
    force = axis.inputs.index("cut")
    read = [axis.outputs.index(reading) for reading in READINGS]
    C = axis.C[read]
    steps = np.zeros((len(samples), many + n, many + n))
    steps[:, many:, :many], steps[:, many:, many:] = samples[:, :n, n:] @ C, samples[:, :n, :n]
    by_states = np.concatenate([samples[:, n:, n:] @ C, samples[:, n:, :n]], axis=2)  # the force, from both states
    steps[:, :many] = axis.B[:, [force]] @ by_states
    steps[:, :many, :many] += axis.A
    moved = steps[0]
    for step in steps[1:]:
        moved = step @ moved
    # the product over a period may overflow, and eigvals raises LinAlgError for infinite entries
    if not np.all(np.isfinite(moved)):
        return True
    # negated, so that NaN counts as unstable
    return not float(np.max(np.abs(np.linalg.eigvals(moved)))) < _EDGE


def growing(A: np.ndarray, B: np.ndarray, C: np.ndarray, sample: np.ndarray) -> np.ndarray:
    """Return for each of many axes whether it forms an unstable loop with a single-rate controller, as `grows` does.

    A, B, C  of the axes from force to both readings, of shapes (axes, m, m), (axes, m) and (axes, 2, m); a C of shape
             (2, m) is that of all axes
    sample   [A B; c d] of the controller
    """
    sample = with_effect(sample[None])[0]
    n, many = sample.shape[0] - 1, A.shape[1]
    moved = np.zeros((len(A), many + n, many + n))
    force = sample[n, n:] @ C
    moved[:, many:, :many], moved[:, many:, many:] = sample[:n, n:] @ C, sample[:n, :n]
    moved[:, :many, :many] = B[:, :, None] * force[..., None, :]
    moved[:, :many, many:] = B[:, :, None] * sample[n, :n]
    moved[:, :many, :many] += A
    finite = np.all(np.isfinite(moved), axis=(1, 2))
    largest = np.max(np.abs(np.linalg.eigvals(np.where(finite[:, None, None], moved, 0.0))), axis=1)
    return ~(finite & (largest < _EDGE))


def with_effect(samples: np.ndarray) -> np.ndarray:
    """Return the controller matrices without the states that do not affect the force, which is the last row."""
    n = samples.shape[1] - 1
    through = np.any(samples[:, :, :n] != 0.0, axis=0)
    reached = np.frombuffer(_reached(n, through.tobytes()), bool)
    if np.all(reached):
        return samples
    rows, columns = np.append(reached, True), np.append(reached, np.ones(samples.shape[2] - n, bool))
    return samples[:, rows][:, :, columns]


@lru_cache(512)
def _reached(n: int, through: bytes) -> bytes:
    """Return which of n states affect the force, as bools; `through`: the entries of [A; c] that are not 0."""
    # a search asks for thousands of controllers of one structure
    links = np.frombuffer(through, bool).reshape(n + 1, n)
    reached = links[n]
    while True:
        more = reached | np.any(links[:n][reached], axis=0)
        if np.array_equal(more, reached):
            return reached.tobytes()
        reached = more


def encircles(answer: Answer) -> bool:
    """Return True if the encirclements of -1 by L show that the closed loop is unstable.

    The axis is assumed to be stable except for its free motion. The phase φ of 1 + L is unwrapped downward from the
    Nyquist frequency, where it lies within ±180°, to the lowest lines. The loop is stable if

        |φ + 90° n + 180° P| < 90°,   n = -d ln|1 + L|/d ln f

    n is the number of integrators at low frequencies: 2 for a free mass plus 1 for each integrator of the controller.
    P is the number of unstable poles of the controller alone at higher frequencies than the lowest line. Each pair of
    unstable closed-loop poles adds 360° to φ, a single pole or a response of the wrong sign adds 180°. The slope shows
    a resonance of the controller near the lowest lines only in part. Such a resonance is therefore treated as
    integrators: 1 + L is multiplied by (z - p)/(z - 1), which replaces each of its poles p by 1.
    """
    f, values = answer.point.frequency, 1.0 + answer.gain
    slow = answer.response.swings
    if slow.size:
        z = np.exp(2j * np.pi * f * answer.point.sample_time)[:, None]
        near = slow[np.abs(np.log(slow)) < 2.0 * np.pi * _SLOW * f[0] * answer.point.sample_time]
        values = values * np.prod((z - near) / (z - 1.0), axis=1)
    # a multirate loop is judged by det(1 + L) of the lifted loop, which repeats beyond its own Nyquist frequency
    if answer.response.rest is not None:
        below = f <= 0.5 / (answer.point.sample_time * answer.response.period)
        f, values = f[below], (values * answer.response.rest)[below]
    low = np.arange(min(max(int(np.searchsorted(f, _LOWEST * f[0])), _FEWEST), f.size))
    # downwards from the last line, where L has fallen, so that the phase of 1 + L needs no unwrapping there
    steps = np.angle(values[:-1] * np.conj(values[1:]))
    phase = np.angle(values[-1]) + np.cumsum(steps[::-1])[::-1][low[low < steps.size]]
    level, x = np.log(np.abs(values[low])), np.log(f[low])
    apart = x - np.mean(x)
    n = -float(apart @ level / (apart @ apart))
    # slower unstable poles are already in the slope n
    fast = int(np.sum(answer.response.growth(answer.point.sample_time) > 2.0 * np.pi * f[0]))
    return not abs(np.degrees(np.mean(phase)) + 90.0 * n + 180.0 * fast) < 90.0


@dataclass(frozen=True, eq=False)
class Figures:
    """The figures of a controller at an operating point.

    rope_snap  rope-snap error; infinite if the loop is unstable
    bandwidth  disturbance rejection bandwidth; None if the loop is unstable
    deviation  standard deviation of Ms due to the variance of the measurement, 0 for a model
    """

    point: str
    stable: bool
    loop_gain: FRF
    compliance: FRF
    rope_snap: float  # m s^½/N
    bandwidth: float | None  # Hz, where |S| rises to -3 dB
    force_noise: float | None  # N RMS
    deviation: float
    at_drive: bool

    @property
    def known_deviation(self) -> float | None:
        """The standard deviation of Ms; None for a model."""
        return self.deviation or None

    @property
    def margins(self) -> Margins:
        """The margins of the loop gain."""
        return self._margins

    @property
    def stiffness(self) -> Stiffness:
        """The dynamic stiffness, which is the inverse of the compliance."""
        return self._stiffness

    @cached_property
    def _margins(self) -> Margins:
        return margins(self.loop_gain)

    @cached_property
    def _stiffness(self) -> Stiffness:
        return stiffness(self.compliance)

    def stiffness_at(self, frequency: float) -> float | None:
        """Return the dynamic stiffness at a frequency (Hz) in N/m; None outside the frequency range."""
        f = self.compliance.frequency
        return self.stiffness.at(frequency) if f[0] <= frequency <= f[-1] else None


def figures(answer: Answer, reading_noise: tuple[float, float]) -> Figures:
    """Compute the figures of a closed loop from all frequency lines of its operating point."""
    point = answer.point
    f, T = point.frequency, point.sample_time
    variance = None if point.variance is None else answer.gain_variance
    L = FRF(f, answer.gain, "cut", "force", "N/N", T, point.coherence, variance)
    C = FRF(f, answer.compliance, "load_force", "position_load", "m/N", T)
    stable = not unstable(answer)
    recovery = answer.recovery()
    return Figures(
        point=point.name,
        stable=stable,
        loop_gain=L,
        compliance=C,
        rope_snap=rope_snap_of_lines(recovery.frequency, recovery.compliance, T) if stable else np.inf,
        bandwidth=bandwidth(f, answer.gain) if stable else None,
        force_noise=force_noise_of(answer, reading_noise) if any(reading_noise) else None,
        deviation=peak_deviation(answer.gain, answer.gain_variance),
        at_drive=point.at_drive,
    )


DEVIATION = Figure(
    "sensitivity_peak_deviation", "its standard deviation", "", "model", attrgetter("known_deviation"), NEUTRAL
)


@cache
def reported() -> tuple[Figure, ...]:
    """Return the figures that a tuning reports; the standard deviation of Ms follows Ms."""
    tuned = [figure for figure in catalogue().values() if figure.tuned]
    return tuple(row for figure in tuned for row in ((figure, DEVIATION) if figure == SENSITIVITY_PEAK else (figure,)))

"""Figures of a closed loop and their derivatives with respect to the tunables, for the goals and limits of a search.

The slack of a limit is the distance to its violation, as a logarithm or a relative difference: 0.01 is about 1 %.
A limit is satisfied if its slack is >= 0.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from feeddrive.analysis.margins import (
    GainCrossover,
    Logarithms,
    Margins,
    PhaseCrossover,
    bandwidth_crossing,
    gain_crossings,
    least,
    phase_crossings,
)
from feeddrive.analysis.stiffness import (
    Stiffness,
    force_noise_of_lines,
    force_noise_weights,
    rope_snap_weights,
    trapezoid_weights,
)
from feeddrive.loop.frequency_response import FRF

Band = tuple[float, float]
"""Lower and upper frequency, Hz."""


class JudgedLoop(Protocol):
    """A closed loop whose figures can be computed, from a model or a measurement.

    A class that computes a figure only once must define it as a property that returns a cached property, because type
    checkers do not accept a `cached_property` in place of a property of a protocol.
    """

    @property
    def margins(self) -> Margins:
        """The margins of the loop gain."""
        ...

    @property
    def compliance(self) -> FRF:
        """The compliance at all frequency lines, m/N."""
        ...

    @property
    def stiffness(self) -> Stiffness:
        """The dynamic stiffness at the frequency lines over which its minimum is taken."""
        ...

    @property
    def rope_snap(self) -> float:
        """The rope-snap error, m √s/N."""
        ...

    @property
    def bandwidth(self) -> float | None:
        """The bandwidth of the disturbance rejection, where |S| rises to -3 dB, Hz; None if there is none."""
        ...

    @property
    def force_noise(self) -> float | None:
        """The RMS force caused by the noise of the readings, N; None for readings without noise."""
        ...

    def stiffness_at(self, frequency: float) -> float | None:
        """Return the dynamic stiffness at a frequency (Hz) in N/m; None outside the frequency range of the loop."""
        ...


class Reading(NamedTuple):
    """The response of the controller to a reading (N/m), its derivatives, and the white noise of the reading, m RMS."""

    response: np.ndarray
    slope: np.ndarray
    noise: float


class SlopedLoop(Protocol):
    """A closed loop on n lines with the derivatives of its responses with respect to p tunables."""

    @property
    def gain(self) -> np.ndarray:
        """The loop gain, shape (n,)."""
        ...

    @property
    def gain_slope(self) -> np.ndarray:
        """The derivatives of the loop gain, shape (n, p)."""
        ...

    @property
    def gain_variance(self) -> np.ndarray:
        """The variance of the loop gain due to measurement noise, shape (n,)."""
        ...

    @property
    def compliance(self) -> np.ndarray:
        """The compliance, m/N, shape (n,)."""
        ...

    @property
    def compliance_slope(self) -> np.ndarray:
        """The derivatives of the compliance, shape (n, p)."""
        ...

    @property
    def compliance_variance(self) -> np.ndarray:
        """The variance of the compliance, shape (n,)."""
        ...

    @property
    def frequency(self) -> np.ndarray:
        """The frequency lines, Hz."""
        ...

    @property
    def sample_time(self) -> float:
        """The sample time, s."""
        ...

    @property
    def logarithms(self) -> Logarithms:
        """The logarithmic form of the loop gain."""
        ...

    @property
    def thinned(self) -> bool:
        """True if of the lines near a limit only some count: those beside its minima, and every fourth of the rest."""
        ...

    def recovery(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the frequency lines, compliance and its derivatives, extended far below the first line of the loop."""
        ...

    def readings(self, noise: tuple[float, float]) -> Sequence[Reading]:
        """Return the response of the controller to each reading; `noise` is the noise of both readings, m RMS."""
        ...


class Slope(NamedTuple):
    """The logarithm of a quantity to minimize, its derivatives, and the Gauss-Newton part of its Hessian."""

    value: float
    slope: np.ndarray
    curvature: np.ndarray


class Place(NamedTuple):
    """A frequency at which a loop is near a limit, with the slack, its derivatives and its standard deviation.

    frequency  Hz; 0 for a limit without a frequency
    line       index of the frequency line, which distinguishes several places of one limit
    """

    frequency: float
    slack: float
    slope: np.ndarray
    deviation: float
    line: int


@dataclass(frozen=True, eq=False)
class Places:
    """The places of one limit as columns: there are hundreds in a step of a search, and few are looked at one by one.

    frequency, slack, deviation  shape (n,)
    slope                        shape (n, tunables)
    line                         shape (n,), whole numbers
    """

    frequency: np.ndarray
    slack: np.ndarray
    slope: np.ndarray
    deviation: np.ndarray
    line: np.ndarray

    @classmethod
    def of(cls, places: Iterable[Place]) -> Places:
        """Return places as columns."""
        if isinstance(places, Places):
            return places
        rows = list(places)
        columns = zip(*rows, strict=True) if rows else ([],) * len(Place._fields)
        frequency, slack, slope, deviation, line = map(np.array, columns)
        return cls(frequency, slack, slope, deviation, line.astype(int))

    def __iter__(self) -> Iterator[Place]:
        columns = (
            self.frequency.tolist(),
            self.slack.tolist(),
            self.slope,
            self.deviation.tolist(),
            self.line.tolist(),
        )
        return map(Place, *columns)

    def __len__(self) -> int:
        return self.slack.size


# larger than the trust region of the search, 0.6 of a logarithm (tuning/search.py): a step hardly reaches further
_NEAR = 0.65  # of a logarithm: bounds with more slack on a line are not stored (where L vanishes, Ms <= 2 has 0.69)
_THINNED = 4  # of the lines near a limit of a thinned loop, one of so many is kept
# near its pole the fraction leaves the response altogether: no circle goes through these three lines
_POINTS, _POLE = 41, 0.2  # points between two neighbors of a line; distance to a pole within which no value is used
_SHARES = np.linspace(0.0, 1.0, _POINTS)
# a crossover at -1 has no delay margin left; its logarithm and the division by it must stay finite
_AHEAD = 1e-9  # rad: smallest distance to -1 used for a crossover
_STRETCH = 0.08  # of ln f: interval on both sides of a crossover for its derivatives


def rope_snap_slope(loop: SlopedLoop, _: Band) -> Slope:
    """Return the logarithm of the rope-snap error, with its derivatives."""
    lines, y, dy = loop.recovery()
    return _mean_square(y, dy, rope_snap_weights(lines, loop.sample_time))


def mean_compliance_slope(loop: SlopedLoop, band: Band) -> Slope:
    """Return the logarithm of `mean_compliance` over the frequency lines within a band, with its derivatives."""
    f = loop.frequency
    width = np.where(_inside(f, band), trapezoid_weights(np.log(f)), 0.0)
    return _mean_square(loop.compliance, loop.compliance_slope, width / np.sum(width))


def compliance_peak_slope(loop: SlopedLoop, band: Band) -> Slope:
    """Return the logarithm of the largest compliance in a band, with its derivatives."""
    return largest(loop, band)


def integral_slope(loop: SlopedLoop, band: Band) -> Slope:
    """Return the logarithm of the largest |y|/ω in a band, with its derivatives; y is the compliance."""
    return largest(loop, band, 1.0 / (2.0 * np.pi * loop.frequency))


def bandwidth_slope(loop: SlopedLoop, _: Band) -> Slope:
    """Return -ln of the frequency at which |S| first rises to -3 dB, with its derivatives."""
    x = np.log(loop.frequency)
    tunables = loop.gain_slope.shape[1]
    crossing = bandwidth_crossing(loop.gain)
    # |S| is above -3 dB on all lines: the bandwidth is at most the first of them
    if crossing is None:
        return Slope(float(-x[0]), np.zeros(tunables), np.zeros((tunables, tunables)))
    i, part = crossing
    level = -np.log(np.abs(1.0 + loop.gain[i : i + 2]))
    # the crossing moves against the level: d ln f = -d ln|S| / (d ln|S|/d ln f)
    tilt = (level[1] - level[0]) / (x[i + 1] - x[i])
    pushed = -(loop.gain_slope / (1.0 + loop.gain)[:, None]).real
    moved = (1.0 - part) * pushed[i] + part * pushed[i + 1]
    slope = moved / tilt
    return Slope(float(-(x[i] + part * (x[i + 1] - x[i]))), slope, np.outer(slope, slope))


def _inside(frequency: np.ndarray, band: Band) -> np.ndarray:
    return (frequency >= band[0]) & (frequency <= band[1])


def largest(loop: SlopedLoop, band: Band, weight: np.ndarray | float = 1.0) -> Slope:
    """Return the logarithm of the largest compliance in a band, weighted by `weight`, with its derivatives."""
    size = np.where(_inside(loop.frequency, band), weight * np.abs(loop.compliance), 0.0)
    k = int(np.argmax(size))
    slope = (loop.compliance_slope[k] / loop.compliance[k]).real
    return Slope(float(np.log(size[k])), slope, np.outer(slope, slope))


def _mean_square(y: np.ndarray, dy: np.ndarray, weight: np.ndarray) -> Slope:
    """Return ½ ln Σ w |y|², with weights w at the frequency lines, and its derivatives."""
    total = float(np.sum(weight * np.abs(y) ** 2))
    slope = np.real(dy.T @ (weight * np.conj(y))) / total
    # Gauss-Newton: the second derivatives of y are left out, so the first term cannot become indefinite
    root = np.sqrt(weight)[:, None] * dy
    curvature = np.real(root.conj().T @ root) / total
    return Slope(0.5 * float(np.log(total)), slope, curvature - np.outer(slope, slope))


def sensitivity_places(loop: SlopedLoop, limit: float, _: Band) -> Places:
    """Return the frequency lines at which |S| is near the limit of Ms, the largest |S|."""
    f, L, dL = loop.frequency, loop.gain, loop.gain_slope
    spread = _spread(loop)
    away = np.abs(1.0 + L)
    # the slack of 1 + L > 1/limit, whose minimum between two lines is that of a circle, not of a parabola
    slack = _between_lines(np.log(f), 1.0 + L, np.log(away * limit))
    near = _near(slack, loop)
    slopes = (dL[near] / (1.0 + L[near])[:, None]).real
    return Places(f[near], slack[near], slopes, spread[near] / away[near], near)


def small_gain_places(loop: SlopedLoop, limit: float, _: Band) -> Iterator[Place]:
    """Yield the frequency lines that nearly violate the small-gain condition for `limit` samples of added dead time."""
    f, L, dL = loop.frequency, loop.gain, loop.gain_slope
    spread = _spread(loop)
    late = np.pi * f * limit * loop.sample_time
    # |e^(-jωτ) - 1| = 2 sin(ωτ/2), at most 2, which it reaches at ωτ = π; beyond that every phase may occur
    # where L is 0 any dead time is admissible, and the slack is rightly infinite
    with np.errstate(divide="ignore"):
        slack = np.log(np.abs((1.0 + L) / L) / (2.0 * np.sin(np.minimum(late, 0.5 * np.pi))))
    slack = _at_vertex(np.log(f), slack)
    for k in _near(slack, loop).tolist():
        slope = -(dL[k] / (L[k] * (1.0 + L[k]))).real
        deviation = float(spread[k] / np.abs(L[k] * (1.0 + L[k])))
        yield Place(float(f[k]), float(slack[k]), slope, deviation, k)


def compliance_places(loop: SlopedLoop, limit: float, _: Band) -> Iterator[Place]:
    """Yield the frequency lines at which the compliance is near its limit."""
    return places_below(loop, limit)


def places_below(loop: SlopedLoop, limit: float, weight: np.ndarray | float = 1.0) -> Iterator[Place]:
    """Yield the frequency lines at which the compliance, times `weight`, is near an upper limit."""
    f = loop.frequency
    size = np.abs(loop.compliance)
    slack = _at_vertex(np.log(f), np.log(limit / (weight * size)))
    deviation = np.sqrt(0.5 * loop.compliance_variance) / size
    for k in _near(slack, loop).tolist():
        slope = -(loop.compliance_slope[k] / loop.compliance[k]).real
        yield Place(float(f[k]), float(slack[k]), slope, float(deviation[k]), k)


class _Crossings(NamedTuple):
    """The gain crossovers of a loop, with the derivatives of their phases and frequencies.

    lines       index of the frequency line below each crossover
    margins     frequencies and margins of the crossovers
    turned      derivatives of the phase at the crossovers with respect to the tunables, shape (crossovers, tunables)
    along       derivatives of ln f of the crossovers with respect to the tunables, of the same shape
    """

    lines: np.ndarray
    margins: Sequence[GainCrossover]
    turned: np.ndarray
    along: np.ndarray


def _gain_crossings(loop: SlopedLoop) -> _Crossings:
    crossings = gain_crossings(loop.logarithms)
    x, level, _, turn = loop.logarithms
    # all crossovers at once: a loop with a resonance has several, and each search looks at thousands of loops
    k = np.array([line for line, _, _ in crossings], int)
    part = np.array([part for _, part, _ in crossings])[:, None]
    width = (x[k + 1] - x[k])[:, None]
    before, after = (loop.gain_slope[line] / loop.gain[line, None] for line in (k, k + 1))  # of ln L
    moved = (1.0 - part) * before + part * after
    along = -moved.real / ((level[k + 1] - level[k])[:, None] / width)  # derivatives of ln f of the crossover
    turned = moved.imag + (turn[k, None] / width) * along
    return _Crossings(k, [margin for _, _, margin in crossings], turned, along)


def phase_margin_places(loop: SlopedLoop, limit: float, _: Band) -> Places:
    """Return the gain crossovers, with the distance of |phase margin| from a limit in deg as the slack."""
    lines, margins, turned, _along = _gain_crossings(loop)
    degrees = np.array([margin.phase_margin_deg for margin in margins])
    # noise of the phase and of the crossover frequency
    deviation = np.array([_crossing_deviation(loop, k, 1.0, 0.0) for k in lines.tolist()])
    sign = np.where(degrees >= 0.0, 1.0, -1.0)
    frequency = np.array([margin.frequency for margin in margins])
    return Places(frequency, np.radians(np.abs(degrees) - limit), sign[:, None] * turned, deviation, lines)


def delay_margin_places(loop: SlopedLoop, limit: float, _: Band) -> Places:
    """Return the gain crossovers, with the distance of the delay margin from a limit in samples as the slack."""
    T = loop.sample_time
    lines, margins, turned, along = _gain_crossings(loop)
    f = np.array([margin.frequency for margin in margins])
    # the logarithm of the angle that a delay may use up: its derivative has a term of the phase and one of ln f
    ahead = np.maximum(2.0 * np.pi * f * np.array([margin.delay_margin for margin in margins]), _AHEAD)
    slack = np.log(ahead / (2.0 * np.pi * f * T * limit))
    deviation = np.array(
        [_crossing_deviation(loop, k, 1.0 / x, 1.0) for k, x in zip(lines.tolist(), ahead.tolist(), strict=True)]
    )
    return Places(f, slack, turned / ahead[:, None] - along, deviation, lines)


def _crossing_deviation(loop: SlopedLoop, k: int, by_phase: float, by_frequency: float) -> float:
    """Return the standard deviation of `by_phase` times the phase minus `by_frequency` times ln f at crossover k."""
    variance = float(loop.gain_variance[k])
    if variance == 0.0:
        return 0.0
    x, level, _, turn = loop.logarithms
    tilt, bend = _tilts(x, level, turn, k)
    return math.sqrt(0.5 * variance) * float(np.hypot(by_phase, (bend * by_phase - by_frequency) / tilt))


def gain_margin_places(loop: SlopedLoop, limit: float, _: Band) -> Iterator[Place]:
    """Yield the phase crossovers, with the distance of the gain margin from a limit in dB as the slack."""
    spread = _spread(loop)
    x, level, _lead, turn = loop.logarithms
    crossing: PhaseCrossover
    for k, part, crossing in phase_crossings(loop.logarithms):
        # where the gain may fall but not rise, Ms is the limit that applies
        if crossing.gain_margin_dB < 0.0 or np.abs(turn[k]) >= 0.9 * np.pi:
            continue
        width = x[k + 1] - x[k]
        pushed = loop.gain_slope[k : k + 2] / loop.gain[k : k + 2, None]
        moved = (1.0 - part) * pushed[0] + part * pushed[1]
        along = -moved.imag / (turn[k] / width)
        slope = -(moved.real + (level[k + 1] - level[k]) / width * along)
        tilt, bend = _tilts(x, level, turn, k)
        slack = float(np.log(10.0) / 20.0 * (crossing.gain_margin_dB - limit))
        relative = float(spread[k] / np.abs(loop.gain[k])) * float(np.hypot(1.0, tilt / bend))
        # the noise adds to L and not to its logarithm: far below the limit, where it may exceed L itself, a violation
        # needs e^slack - 1 times |L|, and not slack times
        deviation = relative * (slack / float(np.expm1(slack)) if slack > 0.0 else 1.0)
        yield Place(crossing.frequency, slack, slope, deviation, k)


def force_noise_places(loop: SlopedLoop, limit: float, noise: tuple[float, float]) -> Places:
    """Return a single place, for the limit of the RMS force noise σ_u.

        d σ_u = Σ w σ² Re[(C S)* d(C S)] / σ_u

    The sum is over the readings, with controller response C and noise σ, and over the frequency lines, with weight w; S
    is the sensitivity.
    """
    value = force_noise_of(loop, noise)
    S = 1.0 / (1.0 + loop.gain)
    dS = -(S * S)[:, None] * loop.gain_slope
    weight = force_noise_weights(loop.frequency, loop.sample_time)
    slope = np.zeros(loop.gain_slope.shape[1])
    for C, dC, sigma in loop.readings(noise):
        through, change = C * S, dC * S[:, None] + C[:, None] * dS
        slope = slope + np.einsum("l,lp->p", weight * sigma**2 * np.conj(through), change).real / value
    zero = np.zeros(1)
    return Places(zero, np.log([limit / value]), -slope[None] / value, zero, np.zeros(1, int))


def force_noise_of(loop: SlopedLoop, noise: tuple[float, float]) -> float:
    """Return the RMS force in N caused by white noise of the readings in m."""
    S = 1.0 / (1.0 + loop.gain)
    parts = [(C * S, sigma) for C, _, sigma in loop.readings(noise)]
    return force_noise_of_lines(loop.frequency, loop.sample_time, parts)


def _spread(loop: SlopedLoop) -> np.ndarray:
    # a slack depends on one component of the complex error, which has half of its variance
    return np.sqrt(0.5 * loop.gain_variance)


def _near(slack: np.ndarray, loop: SlopedLoop) -> np.ndarray:
    """Return the indices of frequency lines at which a limit is violated or nearly so; without slopes, only the worst
    line.
    """
    near = np.flatnonzero(slack < _NEAR)
    if near.size and not loop.gain_slope.shape[1]:
        # nothing is searched: only the critical line is of interest
        return near[[np.argmin(slack[near])]]
    if loop.thinned and near.size >= 3 * _THINNED:
        left = slack[near]
        low = np.flatnonzero((left[1:-1] <= left[:-2]) & (left[1:-1] <= left[2:])) + 1
        kept = np.zeros(near.size, bool)
        kept[::_THINNED] = True
        for beside in (-1, 0, 1):
            kept[low + beside] = True
        near = near[kept]
    return near


def _between_lines(x: np.ndarray, w: np.ndarray, slack: np.ndarray) -> np.ndarray:
    """Return the slacks, with each local minimum corrected for the smallest |w| between the neighboring frequency
    lines.

    w is interpolated through three frequency lines by (w0 + b u)/(1 + c u), u = ln f - ln f0. A resonance traces a
    circle in the complex plane, and the point of this circle that is closest to 0 may lie far from any of these lines.
    """
    out = slack.copy()
    low = (slack[1:-1] < slack[:-2]) & (slack[1:-1] < slack[2:]) & (slack[1:-1] < _NEAR)
    k = np.flatnonzero(low) + 1
    out[k] += np.log(lower_between(np.array([x[k - 1], x[k], x[k + 1]]), np.array([w[k - 1], w[k], w[k + 1]])))
    return out


def lower_between(x: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Return the least |w| between three neighboring lines, divided by |w| of the middle one; 1 if it is not lower.

    x, w  ln f and complex values of shape (3, n), of n such places
    """
    left, right = x[0] - x[1], x[2] - x[1]
    # (w0 + b u)/(1 + c u) is the value of a side: b u - c u w = w - w0, two equations for b and c
    before, after = w[0] - w[1], w[2] - w[1]
    with np.errstate(divide="ignore", invalid="ignore"):
        c = (left * after - right * before) / (left * right * (w[0] - w[2]))
        b = before / left + c * w[0]
        way = left[:, None] + (right - left)[:, None] * _SHARES
        under = 1.0 + c[:, None] * way
        lower = np.min(np.abs((w[1][:, None] + b[:, None] * way) / under), axis=1) / np.abs(w[1])
    fitted = (np.min(np.abs(under), axis=1) > _POLE) & ~np.isnan(lower)
    return np.where(fitted, np.minimum(lower, 1.0), 1.0)


def _at_vertex(x: np.ndarray, slack: np.ndarray) -> np.ndarray:
    """Return the slacks; each local minimum is replaced by that of a parabola through it and its two neighbors."""
    out = slack.copy()
    for k in np.flatnonzero((slack[1:-1] < slack[:-2]) & (slack[1:-1] < slack[2:])) + 1:
        if slack[k] < _NEAR:
            out[k] = least(x[k - 1 : k + 2], slack[k - 1 : k + 2])[1]
    return out


def _tilts(x: np.ndarray, level: np.ndarray, turn: np.ndarray, k: int) -> tuple[float, float]:
    """Return d ln|L|/d ln f and dφ/d ln f at line k; φ is the phase of L.

    Both are fitted over an interval, because the difference between two frequency lines would be mostly noise.
    """
    low, high = (int(end) for end in np.searchsorted(x, (x[k] - _STRETCH, x[k + 1] + _STRETCH)))
    # at least the two lines of the crossing, where lines are sparse
    low, high = min(low, k), max(high, k + 2)
    apart = x[low:high] - np.mean(x[low:high])
    phase = np.concatenate([[0.0], np.cumsum(turn[low : high - 1])])
    scale = apart @ apart
    return float(apart @ level[low:high] / scale), float(apart @ phase / scale)

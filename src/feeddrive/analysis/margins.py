"""Stability margins and sensitivity from a loop gain, with their confidence intervals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from feeddrive.analysis.conversion import as_frf
from feeddrive.analysis.loop_model import loop_model
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity, span
from feeddrive.language.table import UNIT, Column, Result, Table
from feeddrive.language.text import Text
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.loop import Loop

if TYPE_CHECKING:
    from scipy.sparse import csr_array


def coprime_margin(plant: FRF, controller: FRF, crossover: float) -> float:
    """Return the normalized coprime factor margin b, with P scaled to 1 at `crossover` in Hz.

        b(P, C) = min over the frequency lines of |1 + PC| / √((1 + |P|²)(1 + |C|²))

    A stable closed loop remains stable as long as the normalized coprime factors of P change by less than b.  Its phase
    margin is at least 2 asin b, and its gain margin at least (1 + b)/(1 - b).  For the plant 1/s² no controller exceeds
    b = 1/√(4 + 2√2).  For a sampled law C, P must be the sampled axis with its dead time, P = L/C.
    Do not tune P-PI for b: this law does not roll off, and b then measures its gain at half the sample rate.
    Raises ParameterError if the lines are not common to both, or the crossover is not within their range.
    Source: McFarlane & Glover 1990.
    """
    f = plant.frequency
    if not np.array_equal(f, controller.frequency):
        raise ParameterError(f"plant ({f.size} lines) and controller ({controller.frequency.size}) need the same lines")
    if not f[0] <= crossover <= f[-1]:
        raise ParameterError(
            f"crossover = {Quantity(crossover, 'Hz'):6} must lie on the lines, {span(f[0], f[-1], 'Hz', '6')}"
        )
    # b depends on the units of P and C: at the crossover |P| = 1 weighs input and output alike
    scale = np.exp(np.interp(np.log(crossover), np.log(f), np.log(np.abs(plant.response))))
    P, C = plant.response / scale, controller.response * scale
    return float(np.min(np.abs(1.0 + P * C) / np.sqrt((1.0 + np.abs(P) ** 2) * (1.0 + np.abs(C) ** 2))))


def least(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Return the location and value of the minimum of y(x), shape (n,), refined by a parabola except at an end."""
    k = int(np.argmin(y))
    if k in (0, y.size - 1):
        return float(x[k]), float(y[k])
    left, right = x[k - 1] - x[k], x[k + 1] - x[k]
    slope_left, slope_right = (y[k - 1] - y[k]) / left, (y[k + 1] - y[k]) / right
    bend = (slope_right - slope_left) / (right - left)
    # three points on a line, or rounding of equal values: there is no vertex
    if not bend > 0.0:
        return float(x[k]), float(y[k])
    slope = slope_left - bend * left
    step = -0.5 * slope / bend
    # the neighbors are not lower, so the vertex lies within half an interval; rounding must not take it below zero
    return float(x[k] + step), float(y[k] + 0.5 * slope * step)


# far above the rounding of a response, some 1e-15 of it, and far below what any margin is read to
_ROUNDING = 1e-9  # in rad, and in ln |L|: a line nearer to a crossing than this counts as on it


class GainCrossover(NamedTuple):
    """A gain crossover, |L| = 1, at `frequency` in Hz, with its phase margin and its delay margin in s."""

    frequency: float
    phase_margin_deg: float
    delay_margin: float


class PhaseCrossover(NamedTuple):
    """A phase crossover at `frequency` in Hz, where L is real and negative.

    A negative margin in dB means that L reaches -1 when the gain is reduced.
    """

    frequency: float
    gain_margin_dB: float


class Logarithms(NamedTuple):
    """The logarithm of a loop gain L: x = ln f, level = ln |L|, lead = phase + 180° in rad.

    turn is the phase change in rad from line to line.  x, level, lead have shape (n,), turn has shape (n - 1,).
    """

    x: np.ndarray
    level: np.ndarray
    lead: np.ndarray
    turn: np.ndarray


def logarithms(frequency: np.ndarray, loop_gain: np.ndarray) -> Logarithms:
    """Return ln L over ln f (f in Hz), for linear interpolation; values that are 0 except for rounding are set to 0."""
    # tiny, since a zero of L has no logarithm
    level = _snapped(np.log(np.maximum(np.abs(loop_gain), np.finfo(float).tiny)))
    # from the ratio of neighbors and not np.unwrap: it needs no branch cut, and each step stands for itself
    turn = np.angle(loop_gain[1:] * np.conj(loop_gain[:-1]))
    return Logarithms(np.log(frequency), level, _snapped(np.angle(-loop_gain)), turn)


def gain_crossings(lines: Logarithms) -> list[tuple[int, float, GainCrossover]]:
    """Return the gain crossovers, |L| = 1: for each, the index of the interval, the position in it, and the margins."""
    x, level, lead, turn = lines
    return [
        (i, part, _gain_crossover(np.exp(x[i] + part * (x[i + 1] - x[i])), lead[i] + part * turn[i]))
        for i, part in _crossings(level[:-1], level[1:])
    ]


def phase_crossings(lines: Logarithms) -> list[tuple[int, float, PhaseCrossover]]:
    """Return the phase crossovers, L < 0: for each, the index of the interval, the position in it, and the margin."""
    x, level, lead, turn = lines
    crossings: list[tuple[int, float, PhaseCrossover]] = []
    # the end of each interval is its start plus its turn: lead itself jumps by 2π where L crosses the positive axis
    for i, part in _crossings(lead[:-1], _snapped(lead[:-1] + turn)):
        gain = -20.0 / np.log(10.0) * (level[i] + part * (level[i + 1] - level[i]))
        crossings.append((i, part, PhaseCrossover(float(np.exp(x[i] + part * (x[i + 1] - x[i]))), float(gain) + 0.0)))
    return crossings


def _snapped(values: np.ndarray) -> np.ndarray:
    return np.where(np.abs(values) < _ROUNDING, 0.0, values)


def _crossings(a: np.ndarray, b: np.ndarray) -> list[tuple[int, float]]:
    """Return the index i and position (0 to 1) of each zero crossing on the straight line from a[i] to b[i].

    A crossing that stays at zero over several lines counts once.
    """
    crosses = (a * b < 0.0) | ((b == 0.0) & (a != 0.0))
    # an interval counts where it ends on zero; the first line has no interval before it
    crosses[0] |= bool(a[0] == 0.0 and b[0] != 0.0)
    return [(int(i), float(a[i] / (a[i] - b[i]))) for i in np.flatnonzero(crosses)]


def _gain_crossover(frequency: float, lead: float) -> GainCrossover:
    # a delay only reduces the phase, so the phase that it may use up is counted upward from -180°
    turned = 0.0 if abs(lead) < _ROUNDING else lead % (2.0 * np.pi)
    signed = turned - 2.0 * np.pi if turned > np.pi else turned
    return GainCrossover(float(frequency), float(np.degrees(signed)), float(turned / (2.0 * np.pi * frequency)))


@dataclass(frozen=True, eq=False, repr=False)
class Margins(Result):
    """The stability margins of a loop gain. A margin that does not exist is None or an empty tuple, never NaN.

    The figures are valid only for a stable closed loop. A frequency response alone does not show stability: see
    `stability`.  Frequencies are in Hz.
    """

    loop_gain: FRF
    gain_crossovers: tuple[GainCrossover, ...]
    phase_crossovers: tuple[PhaseCrossover, ...]
    modulus_margin: float
    modulus_frequency: float

    @cached_property
    def crossover(self) -> float | None:
        """The first frequency at which |L| = 1, Hz."""
        return self.gain_crossovers[0].frequency if self.gain_crossovers else None

    @cached_property
    def phase_margin_deg(self) -> float | None:
        """The phase margin of the smallest magnitude over all gain crossovers, degrees."""
        return min((c.phase_margin_deg for c in self.gain_crossovers), key=abs, default=None)

    @cached_property
    def gain_increase_dB(self) -> float | None:
        """The smallest gain increase in dB at which L passes through -1."""
        return min((c.gain_margin_dB for c in self.phase_crossovers if c.gain_margin_dB >= 0.0), default=None)

    @cached_property
    def gain_reduction_dB(self) -> float | None:
        """The smallest gain reduction in dB at which L passes through -1, as a positive number."""
        return min((-c.gain_margin_dB for c in self.phase_crossovers if c.gain_margin_dB < 0.0), default=None)

    @cached_property
    def delay_margin(self) -> float | None:
        """The smallest additional dead time in s at which L passes through -1.

        It often belongs to a different crossover than the smallest phase margin.
        """
        return min((c.delay_margin for c in self.gain_crossovers), default=None)

    @cached_property
    def delay_margin_samples(self) -> float | None:
        """The delay margin in samples, for a sampled loop."""
        T = self.loop_gain.sample_time
        return None if T is None or self.delay_margin is None else self.delay_margin / T

    @cached_property
    def small_gain_delay(self) -> float | None:
        """The largest additional dead time τ in s for which |T| |e^(-jωτ) - 1| <= 1 at all lines f, with T = L/(1 + L).

        It never exceeds the delay margin.  It is None if |T| is nowhere above ½: no dead time then violates the
        condition.
        """
        size = np.abs(self.loop_gain.response / (1.0 + self.loop_gain.response))
        # |T| |e^(-jωτ) - 1| <= 2 |T| for any τ
        high = size > 0.5
        if not np.any(high):
            return None
        # |e^(-jωτ) - 1| = 2 sin(ωτ/2)
        return float(np.min(np.arcsin(0.5 / size[high]) / (np.pi * self.loop_gain.frequency[high])))

    @cached_property
    def sensitivity_peak(self) -> float:
        """The sensitivity peak Ms = max |1/(1 + L)| = 1/modulus_margin; infinite if L passes through -1."""
        return 1.0 / self.modulus_margin if self.modulus_margin > 0.0 else float("inf")

    def numbers(self) -> dict[str, float | None]:
        """Return the scalar margins by the names under which they are written to files."""
        return {
            "crossover_Hz": self.crossover,
            "phase_margin_deg": self.phase_margin_deg,
            "gain_increase_dB": self.gain_increase_dB,
            "gain_reduction_dB": self.gain_reduction_dB,
            "delay_margin_s": self.delay_margin,
            "delay_margin_samples": self.delay_margin_samples,
            "modulus_margin": self.modulus_margin,
            "sensitivity_peak_frequency_Hz": self.modulus_frequency,
        }

    def table(self) -> Table:
        """Return a table of all crossovers and of the modulus margin."""
        rows = [
            [
                "gain crossover",
                c.frequency,
                Text(
                    f"phase margin {Quantity(c.phase_margin_deg, 'deg'):.1f}, delay margin "
                    f"{Quantity(c.delay_margin, 's')}{self._samples(c.delay_margin)}"
                ),
            ]
            for c in self.gain_crossovers
        ]
        for c in self.phase_crossovers:
            verb = "rise" if c.gain_margin_dB >= 0.0 else "fall"
            may = Text(f"gain may {verb} by {Quantity(abs(c.gain_margin_dB), 'dB'):.2f}")
            rows.append(["phase crossover", c.frequency, may])
        peak, margin = Quantity(self.sensitivity_peak), Quantity(self.modulus_margin)
        rows.append(["nearest to -1", self.modulus_frequency, Text(f"Ms {peak:.3f}, modulus margin {margin:.3f}")])
        return Table("margins of the loop gain", ["what", Column("frequency", "Hz"), "how much"], rows)

    def _samples(self, delay: float) -> str:
        T = self.loop_gain.sample_time
        return "" if T is None else f" = {Quantity(delay / T):.2f} samples"


def margins(loop_gain: FRF | Loop | Any, frequency: np.ndarray | None = None) -> Margins:
    """Return the margins of a loop gain L(f); the stability limit is 1 + L = 0.

    Between two frequency lines ln |L| and the phase are interpolated linearly over ln f, so a pure power of f is exact;
    the modulus margin is interpolated by a parabola.  The phases of neighboring lines must differ by less than 180°.
    If the lines of a sampled loop extend to Nyquist, the last one is assumed to be real.  For an array or a loop gain
    of another tool, `frequency` in Hz is required, see `as_frf`.  A `Loop` is linearized at 0.05 m/s and opened at the
    drive (`loop_model`); without `frequency` the lines are chosen automatically.
    Raises ParameterError for fewer than two lines.

    The margins are meaningless if the closed loop is unstable, and unreliable for a measured L with low coherence.
    Source: Skogestad & Postlethwaite, Multivariable Feedback Control, section 2.4 (definitions).
    """
    if isinstance(loop_gain, Loop):
        model = loop_model(loop_gain)
        loop_gain, frequency = model.loop_gain(model.lines() if frequency is None else frequency), None
    L = as_frf(loop_gain, frequency)
    if L.frequency.size < 2:
        raise ParameterError(f"margins need at least two lines of the loop gain, not {L.frequency.size}")
    response = _real_at_nyquist(L)
    lines = logarithms(L.frequency, response)
    gains = tuple(crossover for _, _, crossover in gain_crossings(lines))
    phases = tuple(crossover for _, _, crossover in phase_crossings(lines))
    # squared, since a straight piece of curve passes -1 at a distance whose square is a parabola
    place, squared = least(lines.x, np.abs(1.0 + response) ** 2)
    return Margins(L, gains, phases, float(np.sqrt(max(squared, 0.0))), float(np.exp(place)))


def _real_at_nyquist(L: FRF) -> np.ndarray:
    # rounding of e^(-jπ) leaves an imaginary part of either sign, which decides whether a crossing counts
    if L.sample_time is None or L.frequency[-1] * L.sample_time < 0.5 * (1.0 - 1e-9):
        return L.response
    response = L.response.copy()
    response[-1] = response[-1].real
    return response


def sensitivity(loop_gain: FRF | Any, frequency: np.ndarray | None = None) -> FRF:
    """Return the sensitivity S = 1/(1 + L): the response to a disturbance at the point where the loop was opened.

    The variance of a measured L is propagated to first order, |S|⁴ var(L).
    Raises ParameterError if L is exactly -1 on a line, since the closed loop is then at its stability limit.
    """
    L = as_frf(loop_gain, frequency)
    _check(L)
    return replace((1.0 + L).inverse(), input="disturbance", output="remainder", unit="")


def complementary_sensitivity(loop_gain: FRF | Any, frequency: np.ndarray | None = None) -> FRF:
    """Return T = L/(1 + L) = 1 - S: the closed-loop response to a signal at the point where the loop was opened.

    Raises ParameterError if L is exactly -1 on a line.  For the response to the setpoint, which includes feedforward,
    use `tracking`.
    """
    L = as_frf(loop_gain, frequency)
    _check(L)
    # the response by one division: 1 - S would lose digits where |L| is small; the variance is that of S
    response = L.response / (1.0 + L.response)
    return replace((1.0 + L).inverse(), response=response, input="disturbance", output="answer", unit="")


_HALF_POWER = float(np.sqrt(0.5))  # -3 dB


def bandwidth_crossing(loop_gain: np.ndarray) -> tuple[int, float] | None:
    """Return where |S| = 1/|1 + L| first rises to √½, as index of the interval and position in it (0 to 1), or None.

    Between two frequency lines ln |S| is interpolated linearly over ln f.
    """
    return _first_rise(-np.log(np.abs(1.0 + loop_gain)) - np.log(_HALF_POWER))


def _first_rise(level: np.ndarray) -> tuple[int, float] | None:
    """Return the index and position (0 to 1) of the first upward zero crossing, level[i] < 0 to level[i + 1] >= 0."""
    rises = np.flatnonzero((level[:-1] < 0.0) & (level[1:] >= 0.0))
    if not rises.size:
        return None
    i = int(rises[0])
    return i, float(level[i] / (level[i] - level[i + 1]))


def bandwidth(frequency: np.ndarray, loop_gain: np.ndarray) -> float | None:
    """Return the bandwidth of disturbance rejection in Hz, at which |S| = |1/(1 + L)| first rises to √½, or -3 dB.

    frequency is in Hz and loop_gain is L, both of shape (n,); the result is None if |S| has no such crossing.
    Source: Skogestad & Postlethwaite, Multivariable Feedback Control, section 2.4.5.
    """
    crossing = bandwidth_crossing(loop_gain)
    if crossing is None:
        return None
    i, part = crossing
    return float(frequency[i] * (frequency[i + 1] / frequency[i]) ** part)


def tracking_bandwidth(response: FRF) -> float | None:
    """Return the frequency in Hz at which the setpoint response first falls below √½ (-3 dB); None if it never does."""
    # a fall of the response is a rise of its inverse
    rise = _first_rise(np.log(_HALF_POWER) - np.log(np.maximum(response.magnitude, np.finfo(float).tiny)))
    if rise is None:
        return None
    i, part = rise
    x = np.log(response.frequency[i : i + 2])
    return float(np.exp(x[0] + part * (x[1] - x[0])))


def peak_deviation(loop_gain: np.ndarray, variance: np.ndarray) -> float:
    """Return the standard deviation of Ms = max 1/|1 + L| from the variance E|dL|² of each line, to first order.

    It is Ms² [var(L)/2]^½ at the line at which L is nearest to -1; half of the variance is in the direction of -1.
    """
    away = np.abs(1.0 + loop_gain)
    k = int(np.argmin(away))
    return float(np.sqrt(0.5 * variance[k]) / away[k] ** 2)


def _check(L: FRF) -> None:
    on_edge = np.flatnonzero(L.response == -1.0)
    if on_edge.size:
        raise ParameterError(
            f"the loop gain is exactly -1 at {Quantity(L.frequency[on_edge[0]], 'Hz'):6}: the closed loop is at the "
            "edge of stability and has no sensitivity there"
        )


# geometric: the bias of a parabola grows with a power of the width, so equal steps would be needlessly fine
_HALVES = (2, 3, 4, 6, 8, 12, 16, 24, 32, 48)  # lines on each side that are tried
# high, since each line tests up to ten windows: at 95 % many lines would stop at a window that is right
_LEVEL = 0.999  # of the χ² test that a parabola explains the lines
# the normal equations lose as many digits as the weights differ by: ten of sixteen at most
_EXACT = 1e-10  # of the largest variance in a window: a smaller variance is raised to this
_CENTER, _SPREAD = 1, 2  # steps by which a window is narrower than the widest that passes the test


@dataclass(frozen=True, eq=False)
class Smoother:
    """A linear smoother of the frequency lines of an FRF: a sparse weight matrix of shape (n, n)."""

    weights: csr_array

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Return the smoothed values, shape (..., n)."""
        columns = np.moveaxis(values, -1, 0).reshape(values.shape[-1], -1)
        smooth = self.weights @ np.real(columns) + 1j * (self.weights @ np.imag(columns))
        return np.moveaxis(smooth.reshape(np.moveaxis(values, -1, 0).shape), 0, -1)


def smoothers(frf: FRF) -> tuple[Smoother, Smoother]:
    """Return two smoothers of an FRF, (center, spread), which fit local parabolas over ln f in windows of frequency
    lines.

    At each line the window grows from 5 to at most 97 lines until χ² of the residuals exceeds its 99.9 % point. A line
    for which even the smallest window fails is not smoothed. In the widest window that passes, the bias is as large as
    the remaining noise. The smoother `center`, for the curve itself, therefore uses windows one step narrower. The
    smoother `spread`, for random draws whose spread must also cover the remaining bias, uses windows two steps
    narrower.
    Raises ParameterError for an FRF without variance.
    Source: Goldenshluger & Nemirovski 1997 (windows as wide as the noise allows); Schoukens et al. 2009 (local
    polynomials of frequency responses).
    """
    from scipy.special import chdtri

    if frf.variance is None:
        raise ParameterError(
            f"the response to {frf.output} has no variance: estimate it from several periods or averages, or give it"
        )
    n, x = frf.frequency.size, np.log(frf.frequency)
    # a variance of 0 claims exactness, which rounding denies: (1e-12 of the response)²
    variance = np.maximum(frf.variance, np.maximum(1e-24 * frf.magnitude**2, 1e-200))
    reach = np.full(n, -1)  # index of the widest window that holds
    growing = np.ones(n, bool)
    maps: list[tuple[np.ndarray, np.ndarray]] = []
    for i, half in enumerate(_HALVES):
        width = 2 * half + 1
        if width > n or not np.any(growing):
            break
        start = np.clip(np.arange(n) - half, 0, n - width)
        places = start[:, None] + np.arange(width)
        offset = x[places] - x[:, None]
        # columns of like size keep the normal equations solvable for any spacing of the lines
        offset = offset / np.max(np.abs(offset), axis=1, keepdims=True)
        columns = np.stack([np.ones_like(offset), offset, offset**2], axis=2)
        # a line where the response is zero (a sampled one at Nyquist) has no noise and would otherwise get nearly all
        # of the weight
        unsure = variance[places]
        unsure = np.maximum(unsure, _EXACT * np.max(unsure, axis=1, keepdims=True))
        heavy = columns / unsure[:, :, None]
        weights = np.linalg.solve(np.swapaxes(columns, 1, 2) @ heavy, np.swapaxes(heavy, 1, 2))
        fitted = np.squeeze(columns @ (weights @ frf.response[places][:, :, None]), axis=2)
        misfit = np.sum(np.abs(frf.response[places] - fitted) ** 2 / unsure, axis=1)
        # |r|²/variance has mean 1 with two real degrees of freedom, and the parabola uses three complex ones
        growing &= 2.0 * misfit <= chdtri(2 * (width - 3), 1.0 - _LEVEL)
        reach[growing] = i
        maps.append((start, weights[:, 0, :]))
    return _smoother(n, maps, reach - _CENTER), _smoother(n, maps, reach - _SPREAD)


def _smoother(n: int, maps: Sequence[tuple[np.ndarray, np.ndarray]], reach: np.ndarray) -> Smoother:
    """Return the smoother that uses, at each line, the window with the index `reach`; negative: line not smoothed."""
    from scipy.sparse import csr_array

    stays = np.flatnonzero(reach < 0)
    rows, columns, weights = [stays], [stays], [np.ones(stays.size)]
    for i, (start, weights_of_line) in enumerate(maps):
        lines, width = np.flatnonzero(reach == i), weights_of_line.shape[1]
        rows.append(np.repeat(lines, width))
        columns.append((start[lines, None] + np.arange(width)).ravel())
        weights.append(weights_of_line[lines].ravel())
    places = np.concatenate(rows), np.concatenate(columns)
    return Smoother(csr_array((np.concatenate(weights), places), shape=(n, n)))


DRAWS = 200
_SURE = 0.95  # share of draws that must show a figure, around one value, to be sure of it

FIGURES: dict[str, tuple[str, Callable[[Margins], float | None]]] = {
    "crossover": ("Hz", lambda m: m.crossover),
    "phase_margin_deg": ("deg", lambda m: m.phase_margin_deg),
    "gain_increase_dB": ("dB", lambda m: m.gain_increase_dB),
    "gain_reduction_dB": ("dB", lambda m: m.gain_reduction_dB),
    "delay_margin": ("s", lambda m: m.delay_margin),
    "modulus_margin": ("", lambda m: m.modulus_margin),
    "sensitivity_peak": ("", lambda m: m.sensitivity_peak),
}


@dataclass(frozen=True)
class Interval:
    """A margin with its confidence interval; `sure` is True if nearly all draws have it, clustered around one value."""

    value: float
    low: float
    high: float
    unit: str
    sure: bool


@dataclass(frozen=True, eq=False, repr=False)
class MarginIntervals(Result):
    """The confidence intervals of margins, by their names in `Margins`; margins that do not exist are left out.

    margins  margins of the smoothed loop gain; `value` of an interval is the margin minus the bias caused by noise
    level    confidence level of each single interval
    draws, seed   number of draws and random seed of the Monte Carlo simulation
    """

    margins: Margins
    intervals: dict[str, Interval]
    level: float
    draws: int
    seed: int

    def __getitem__(self, name: str) -> Interval:
        if name not in self.intervals:
            raise ParameterError(f"there is no interval of '{name}'; there are {', '.join(self.intervals)}")
        return self.intervals[name]

    def table(self) -> Table:
        """Return a table with one row per figure."""
        rows = [
            [
                name,
                UNIT,
                *(Quantity(number, interval.unit) for number in (interval.value, interval.low, interval.high)),
                "" if interval.sure else "not sure",
            ]
            for name, interval in self.intervals.items()
        ]
        title = Text(f"margins with {Quantity(self.level, 'share'):6} intervals ({self.draws} draws, seed {self.seed})")
        return Table(title, ["figure", "unit", "value", "from", "to", ""], rows)


def margin_intervals(L: FRF, *, level: float = 0.95, draws: int = DRAWS, seed: int = 0) -> MarginIntervals:
    """Compute confidence intervals of all margins from the variance of a measured loop gain, by Monte Carlo.

    The smallest of many noisy distances to -1 is biased low, and noisy lines cross |L| = 1 many times.  Therefore the
    loop gain is first smoothed as far as its variances allow, and every draw is smoothed a little less (`smoothers`):

        L* = B (A L + e),  e complex normal with the variance of each line, independent from line to line
        θ = margins of A L - (mean(θ*) - margins of B A L),  θ* = margins of L*,  interval = θ ± z std(θ*)

    A and B are the smoothers `center` and `spread`, and z is the quantile of the normal distribution for `level`.
    The term in parentheses is the bias caused by noise: the minimum of several noisy distances is below the true one.

    A margin is marked as not sure if less than 95 % of the draws have it, or if less than 95 % lie around one value.
    Where a resonance just reaches |L| = 1, for example, the delay margin jumps between two crossings. If the values do
    not lie around one value, the interval is extended to contain the central share `level` of the draws.

    Raises ParameterError for an L without variance.  Nonlinear distortion is covered only if the variance includes it.
    Resonances narrower than five lines are not smoothed, and their intervals are those of the unsmoothed lines.
    """
    if not 0.5 <= level < 1.0 or draws < 20:
        raise ParameterError(f"level = {Quantity(level):6} must be >= 0.5 and < 1, and draws = {draws} at least 20")
    center_by, spread_by = smoothers(L)
    assert L.variance is not None
    center = center_by(L.response)
    margins_ = margins(replace(L, response=center, variance=None))
    random = np.random.default_rng(seed)
    # half of E|dL|² lies in the real part, half in the imaginary part
    size = np.sqrt(0.5 * L.variance)
    noise = random.standard_normal((2, draws, L.frequency.size)) * size
    curves = spread_by(center + noise[0] + 1j * noise[1])
    drawn = [margins(replace(L, response=curve, variance=None)) for curve in curves]
    quiet = margins(replace(L, response=spread_by(center), variance=None))
    # normal intervals from mean and deviation: quantiles of 200 draws at 95 % depend on five of them at each end
    reach = _two_sided(level)
    intervals: dict[str, Interval] = {}
    for name, (unit, figure) in FIGURES.items():
        value = figure(margins_)
        if value is None:
            continue
        others = np.array([other for m in drawn if (other := figure(m)) is not None and np.isfinite(other)])
        still = figure(quiet)
        # a deviation of fewer draws is no more than a guess
        if others.size < 10 or still is None:
            intervals[name] = Interval(value, -np.inf, np.inf, unit, False)
            continue
        settled = _settled(others)
        value -= float(np.mean(others)) - still if settled else 0.0
        spread = reach * float(np.std(others))
        low, high = value - spread, value + spread
        if not settled:
            # two clusters are not normal: the interval must at least hold where the draws lie
            ends = np.quantile(others, [0.5 - 0.5 * level, 0.5 + 0.5 * level])
            low, high = min(low, float(ends[0])), max(high, float(ends[1]))
        positive = name in ("modulus_margin", "delay_margin", "crossover")
        low = max(low, 0.0) if positive else low
        intervals[name] = Interval(value, low, high, unit, settled and others.size >= _SURE * draws)
    distance = intervals["modulus_margin"]
    # Ms = 1/modulus margin: its interval is the inverse of that of the modulus margin, whose distribution is nearly
    # normal
    peak = np.inf if distance.low <= 0.0 else 1.0 / distance.low
    intervals["sensitivity_peak"] = Interval(
        1.0 / max(distance.value, 1e-300), 1.0 / max(distance.high, 1e-300), peak, "", distance.sure
    )
    return MarginIntervals(margins_, intervals, level, draws, seed)


def _settled(drawn: np.ndarray) -> bool:
    """Return True if nearly all draws lie around one value.

    This holds if the largest gap between the sorted draws does not exceed the sum of the standard deviations of the
    draws on either side; 5 % of the draws at each end are treated as outliers.
    """
    ordered = np.sort(drawn)
    # a gap near an end separates a few outliers only, and is no sign of two crossings
    beyond = int(np.ceil((1.0 - _SURE) * ordered.size))  # fewer draws than this are outliers
    place = beyond + int(np.argmax(np.diff(ordered)[beyond - 1 : ordered.size - beyond]))
    low, high = ordered[:place], ordered[place:]
    return bool(high[0] - low[-1] <= np.std(low) + np.std(high) + 1e-9 * abs(high[0]))


def _two_sided(level: float) -> float:
    from scipy.special import ndtri

    return float(ndtri(0.5 + 0.5 * level))

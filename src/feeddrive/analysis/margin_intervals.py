"""Confidence intervals of the margins of a measured loop, from the noise of the measurement."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from feeddrive.analysis.margins import Margins, margins
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import UNIT, Result, Table
from feeddrive.language.text import Text
from feeddrive.loop.frequency_response import FRF

if TYPE_CHECKING:
    from scipy.sparse import csr_array

_HALVES = (2, 3, 4, 6, 8, 12, 16, 24, 32, 48)  # lines on each side that are tried
_LEVEL = 0.999  # of the χ² test that a parabola explains the lines
_EXACT = 1e-10  # of the largest variance in a window: a smaller variance is raised to this
_CENTER, _SPREAD = 1, 2  # steps by which a window is narrower than the widest that passes the test


@dataclass(frozen=True, eq=False)
class Smoother:
    """A linear map from the lines of an FRF to smooth ones: the weights of each line in each, a sparse (n, n)."""

    weights: csr_array

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Smooth values of shape (..., n)."""
        columns = np.moveaxis(values, -1, 0).reshape(values.shape[-1], -1)
        smooth = self.weights @ np.real(columns) + 1j * (self.weights @ np.imag(columns))
        return np.moveaxis(smooth.reshape(np.moveaxis(values, -1, 0).shape), 0, -1)


def smoothers(frf: FRF) -> tuple[Smoother, Smoother]:
    """Local parabolas over ln f, each as wide as the variance of its lines allows: (center, spread).

    Windows grow from 5 to 97 lines and stop at the first that fails: χ² of the residuals is beyond its 99.9 % point.
    Where the first one fails, the line stays as it is. A window that just passes has a bias as large as the remaining
    noise. So the curve itself is taken from windows one step narrower. Its spread, which must cover the rest of that
    bias, is taken from windows two steps narrower.
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
    """Each line smoothed by the map of its widest window; a line whose index is below 0 stays as it is."""
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
    """A figure with the interval that holds the true one with `level`; `sure` if nearly all draws have the figure."""

    value: float
    low: float
    high: float
    unit: str
    sure: bool


@dataclass(frozen=True, eq=False, repr=False)
class MarginIntervals(Result):
    """Confidence intervals by name of the figure in `Margins`; figures that do not occur are left out.

    margins  of the smoothed loop gain; the values of the intervals are these minus the bias caused by noise
    level    probability with which each single interval holds the true figure
    draws, seed   of the Monte Carlo
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
        """One row a figure."""
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
    """Intervals of all margins from the variance of a measured loop gain, by Monte Carlo with a stated seed.

    The least of many noisy distances to -1 is too small, and noisy lines cross |L| = 1 many times.  So the loop gain is
    first smoothed as far as its variances allow, and every draw is smoothed a little less (`smoothers`):

        L* = B (A L + e),  e complex normal with the variance of each line, independent from line to line
        θ = margins of A L - (mean(θ*) - margins of B A L),  θ* = margins of L*,  interval = θ ± z std(θ*)

    The parenthesis is the bias that noise alone causes: the least of several noisy distances is less than the true one.

    A figure is marked as not sure if less than 95 % of the draws show it, or if less than 95 % lie around one value.
    Where a resonance just reaches |L| = 1, for example, the delay margin jumps between two crossings. The interval then
    also holds the middle 95 % of the draws.

    Raises ParameterError for an L without variance.  Nonlinear distortion counts only if the variance holds it.
    When not: for resonances narrower than five lines, which no window spans; their interval is that of the unsmoothed
    lines.
    """
    if not 0.5 <= level < 1.0 or draws < 20:
        raise ParameterError(f"level = {Quantity(level):6} must be >= 0.5 and < 1, and draws = {draws} at least 20")
    center_by, spread_by = smoothers(L)
    assert L.variance is not None
    center = center_by(L.response)
    margins_ = margins(replace(L, response=center, variance=None))
    random = np.random.default_rng(seed)
    size = np.sqrt(0.5 * L.variance)
    noise = random.standard_normal((2, draws, L.frequency.size)) * size
    curves = spread_by(center + noise[0] + 1j * noise[1])
    drawn = [margins(replace(L, response=curve, variance=None)) for curve in curves]
    quiet = margins(replace(L, response=spread_by(center), variance=None))
    reach = _two_sided(level)
    intervals: dict[str, Interval] = {}
    for name, (unit, figure) in FIGURES.items():
        value = figure(margins_)
        if value is None:
            continue
        others = np.array([other for m in drawn if (other := figure(m)) is not None and np.isfinite(other)])
        still = figure(quiet)
        if others.size < 10 or still is None:
            intervals[name] = Interval(value, -np.inf, np.inf, unit, False)
            continue
        settled = _settled(others)
        value -= float(np.mean(others)) - still if settled else 0.0
        spread = reach * float(np.std(others))
        low, high = value - spread, value + spread
        if not settled:
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
    """True if nearly all draws lie around one value: no gap between them exceeds the deviations on both sides."""
    ordered = np.sort(drawn)
    beyond = int(np.ceil((1.0 - _SURE) * ordered.size))  # fewer draws than this are outliers
    place = beyond + int(np.argmax(np.diff(ordered)[beyond - 1 : ordered.size - beyond]))
    low, high = ordered[:place], ordered[place:]
    return bool(high[0] - low[-1] <= np.std(low) + np.std(high) + 1e-9 * abs(high[0]))


def _two_sided(level: float) -> float:
    from scipy.special import ndtri

    return float(ndtri(0.5 + 0.5 * level))

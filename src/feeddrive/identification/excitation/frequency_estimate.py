"""The record of an excited axis, and the frequency response estimated from it with variance, coherence and distortion.

A record contains input, output and reference, sampled by a common clock; a periodic record is cut into periods.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np

from feeddrive.language.errors import LogError, ParameterError
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.table import Column, Result, Table
from feeddrive.language.text import Text
from feeddrive.loop.frequency_response import FRF

FEWEST = 32  # samples
_STUCK = 0.02  # share of samples at the very largest or smallest value from which a channel counts as saturated
_ALIKE = 0.9  # least correlation of a signal with itself one period later
_EXACT = 1e-3  # share of its spread by which a reference may differ from itself one period later
_DRIFTS = 5.0  # standard errors above which a drift counts
_BANDS = 12  # of lines, over which the test for a transient looks
RISK = 0.01  # probability that a steady record loses its first period by chance


@dataclass(frozen=True, kw_only=True, eq=False)
class Record:
    """A measurement: `input` and `output` of shape (n,), sampled every `sample_time` s.

    references  external signals, shape (n,) each: the setpoint, or the force added to the command. In a closed loop,
                they are needed to separate the effect of the excitation from that of noise
    Raises LogError for channels of different length, too short or constant channels, NaN, and an output that equals the
    input.
    """

    input: np.ndarray
    output: np.ndarray
    sample_time: float
    references: tuple[np.ndarray, ...] = ()
    input_name: str = "input"
    output_name: str = "output"
    unit: str = ""
    name: str = "record"

    def __post_init__(self) -> None:
        if not (np.isfinite(self.sample_time) and self.sample_time > 0.0):
            raise LogError(f"{self.name}: sample time {Quantity(self.sample_time, 's'):6 SI} must be > 0 s")
        for name, values in self._channels():
            if values.ndim != 1 or values.size < FEWEST:
                raise LogError(
                    f"{self.name}: '{name}' of shape {values.shape} must be one row of {FEWEST} samples or more"
                )
            if values.size != np.size(self.output):
                raise LogError(f"{self.name}: '{name}' has {values.size} samples, the output {np.size(self.output)}")
            bad = np.flatnonzero(~np.isfinite(values))
            if bad.size:
                raise LogError(
                    f"{self.name}: '{name}' is {values[bad[0]]} at sample {bad[0]} ({bad.size} such samples)"
                )
            if np.ptp(values) == 0.0:
                raise LogError(
                    f"{self.name}: '{name}' is constant at {Quantity(values[0]):6}: it contains no information"
                )
        if np.array_equal(self.input, self.output):
            raise LogError(
                f"{self.name}: input '{self.input_name}' and output '{self.output_name}' are the same numbers, whose "
                "response is 1: name two different columns"
            )
        for name in ("input", "output"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), float))
        object.__setattr__(self, "references", tuple(np.asarray(reference, float) for reference in self.references))

    def _channels(self) -> list[tuple[str, np.ndarray]]:
        named = [(self.input_name, self.input), (self.output_name, self.output)]
        named += [(f"reference {i + 1}", reference) for i, reference in enumerate(self.references)]
        return [(name, np.asarray(values, float)) for name, values in named]

    def __len__(self) -> int:
        return self.output.size

    @cached_property
    def remarks(self) -> tuple[str, ...]:
        """Remarks on saturated channels."""
        return tuple(remark for name, values in self._channels()[:2] for remark in saturation(name, values))

    @property
    def nyquist(self) -> float:
        """The Nyquist frequency, Hz."""
        return 0.5 / self.sample_time


def saturation(name: str, values: np.ndarray) -> list[str]:
    """Return a remark for each extreme value, the largest or the smallest, at which a channel is saturated."""
    remarks: list[str] = []
    for what, end in (("largest", np.max(values)), ("smallest", np.min(values))):
        share = float(np.mean(values == end))
        # quantized signals also stay at their extremes for a few samples; a saturated one does so in long runs
        held = np.flatnonzero((values[1:] == end) & (values[:-1] == end)).size / values.size
        if share > _STUCK and held > 0.5 * share:
            remarks.append(
                Text(
                    f"{name} stays at its {what} value {number(end, 6)} for {Quantity(share, 'share'):.1f} of the "
                    "record: it seems saturated, and a saturated drive has no frequency response"
                )
            )
    return remarks


def find_period(values: np.ndarray) -> int | None:
    """Return the period of a signal in samples, at most half of the record, or None if it is not periodic.

    The period is the lag of the first autocorrelation peak beyond the first zero crossing that is about as high as the
    highest peak.
    """
    x = np.asarray(values, float) - np.mean(values)
    n = x.size
    # padded to twice the length: the transform would otherwise correlate the end with the start
    size = int(2 ** np.ceil(np.log2(2 * n)))
    spectrum = np.fft.rfft(x, size)
    lagged = np.fft.irfft(np.abs(spectrum) ** 2, size)[: n // 2 + 1]
    squares = np.concatenate([[0.0], np.cumsum(x * x)])
    lags = np.arange(lagged.size)
    # normalized by the overlapping part, or the correlation would fall with the lag
    power = np.sqrt(np.maximum(squares[n - lags] * (squares[n] - squares[lags]), np.finfo(float).tiny))
    alike = lagged / power
    # near lag 0 every signal resembles itself: the search begins behind the first zero
    below = np.flatnonzero(alike <= 0.0)
    if not below.size or below[0] >= alike.size - 1:
        return None
    rest = alike[below[0] :]
    best = float(rest.max())
    if best < _ALIKE:
        return None
    inner = rest[1:-1]
    # the last lag may be the peak itself: a record of exactly two periods
    peaks = np.concatenate(
        [[False], (inner >= rest[:-2]) & (inner >= rest[2:]), [rest.size > 1 and rest[-1] > rest[-2]]]
    )
    # the first of all peaks about as high as the highest, since every multiple of the period is one
    good = np.flatnonzero(peaks & (rest > 1.0 - 2.0 * (1.0 - best) - 1e-6))
    return int(below[0] + good[0]) if good.size else None


def repeating(values: np.ndarray, period: int) -> tuple[int, int]:
    """Return the first sample and the end of the longest part in which a signal is periodic, apart from a linear trend.

    This part excludes fade-in and fade-out of a reference, and the standstill before and after them.
    """
    x = np.asarray(values, float)
    change = x[period:] - x[:-period]
    same = np.abs(change - np.median(change)) <= _EXACT * np.std(x)
    # without excitation the zeros would count as periodic
    moves = np.cumsum(np.diff(x, prepend=x[0]) != 0.0)
    alive = moves[period:] > moves[:-period]
    edges = np.diff(np.concatenate([[False], same & alive, [False]]).astype(int))
    begins, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    if not begins.size:
        return 0, x.size
    longest = int(np.argmax(ends - begins))
    return int(begins[longest]), int(ends[longest]) + period


def cut(record: Record, period: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the spectra of input, output and r references in p periods: shapes (p, lines), (p, lines), (r, p, lines).

    Lines range from 1/period to Nyquist; a sine of amplitude a on a line has the magnitude a.  A constant drift, due to
    a bias velocity of the axis, is removed if it is significant: its slope is the mean increase per period over the
    second half of the record, and must exceed five standard errors.
    Raises LogError for fewer than two periods.
    """
    count = len(record) // period
    if count < 2:
        raise LogError(f"{record.name}: {len(record)} samples are less than two periods of {period}")
    # the incomplete period is cut at the start, where the axis is farther from steady state
    start = len(record) - count * period

    def transformed(values: np.ndarray) -> np.ndarray:
        kept = values[start:]
        # the mean of a whole period contains no excitation, so that the steps between means show the drift alone
        steps = np.diff(kept.reshape(count, period).mean(axis=1))[(count - 1) // 2 :]
        error = np.std(steps, ddof=1) / np.sqrt(steps.size) if steps.size > 1 else 0.0
        slope = np.mean(steps) / period if abs(np.mean(steps)) > _DRIFTS * error else 0.0
        level = kept - slope * np.arange(kept.size)
        return np.fft.rfft(level.reshape(count, period), axis=1)[:, 1 : (period + 1) // 2] * (2.0 / period)

    r = np.array([transformed(reference) for reference in record.references])
    return transformed(record.input), transformed(record.output), r


def transient_periods(periods: np.ndarray) -> int:
    """Count the initial periods that are not yet in steady state, at most half; `periods` has the shape (p, lines).

    Each period in turn is compared with the m periods of the second half, in bands of neighboring frequency lines,

        Q = Σ |Z - Z̄|² / ((1 + 1/m) Σ s²),   s² the variance among the m

    Q is F-distributed with 2L and 2L(m - 1) degrees of freedom for L lines of equal noise, fewer for unequal
    noise. A period is dropped if Q exceeds the quantile in any band, for a total risk of 1 %.  The first period that
    is not dropped ends the test, since a transient only decays.
    """
    # scipy.stats has the same function, but takes a second to import
    from scipy.special import fdtri

    count, lines = periods.shape
    half = count // 2
    last = periods[half:]
    m = last.shape[0]
    if m < 2:
        return 0
    bands = np.array_split(np.arange(lines), min(_BANDS, lines))
    mean = last.mean(axis=0)
    spread = np.sum(np.abs(last - mean) ** 2, axis=0) / (m - 1)
    for p in range(half):
        away = np.abs(periods[p] - mean) ** 2 / (1.0 + 1.0 / m)
        quotients = [float(np.sum(away[band]) / max(np.sum(spread[band]), 1e-300)) for band in bands]
        limits = [float(fdtri(*_freedom(spread[band], m), 1.0 - RISK / len(bands))) for band in bands]
        if all(q <= limit for q, limit in zip(quotients, limits, strict=True)):
            return p
    return half


def _freedom(spread: np.ndarray, m: int) -> tuple[float, float]:
    """Return the degrees of freedom of numerator and denominator of Q, for noise with any spectrum (Satterthwaite)."""
    even = float(np.sum(spread) ** 2 / max(np.sum(spread**2), 1e-300))
    return 2.0 * even, 2.0 * even * (m - 1)


_DOUBT = 0.1  # relative variance of the input; a line above it is left out


@dataclass(frozen=True, eq=False)
class Level:
    """The amplitude of noise or distortion in the output, RMS over neighboring lines.

    frequency  frequencies of the lines, Hz, shape (m,)
    output     amplitude at the output, in its unit
    response   that amplitude divided by the exciting input, in the unit of the frequency response; NaN outside the band
    """

    frequency: np.ndarray
    output: np.ndarray
    response: np.ndarray


@dataclass(frozen=True, eq=False, repr=False)
class FrequencyEstimate(Result):
    """An FRF with coherence and variance, the estimator used, and the degrees of freedom of the variance.

    frf      `frf.variance` is E|dG|² of the response: noise, and nonlinear distortion if `total` is true
    method   description of the estimator
    freedom  complex degrees of freedom of the variance on each line, shape (n,)
    noise    E|dG|² due to noise only, shape (n,)
    total    True if `frf.variance` includes nonlinear distortion besides noise
    levels   "odd", "even", "nonlinear", "noise": levels over frequency, as far as the excitation reveals them
    counts   numbers of averages, periods, realizations ... by name
    remarks  remarks on the validity of the estimate
    """

    frf: FRF
    method: str
    freedom: np.ndarray
    noise: np.ndarray
    total: bool = False
    levels: dict[str, Level] = field(default_factory=dict[str, Level])
    counts: dict[str, int] = field(default_factory=dict[str, int])
    remarks: tuple[str, ...] = ()

    @property
    def frequency(self) -> np.ndarray:
        """The frequencies of the lines, Hz."""
        return self.frf.frequency

    def lines(self, kept: np.ndarray, *remarks: str) -> Self:
        """Return the estimate at the frequency lines where `kept` (shape (n,)) is True, with additional remarks."""
        f = self.frf

        def of(values: np.ndarray | None) -> np.ndarray | None:
            return None if values is None else values[kept]

        frf = replace(
            f,
            frequency=f.frequency[kept],
            response=f.response[kept],
            coherence=of(f.coherence),
            variance=of(f.variance),
        )
        return replace(
            self, frf=frf, freedom=self.freedom[kept], noise=self.noise[kept], remarks=(*self.remarks, *remarks)
        )

    def where_excited(self, doubt: np.ndarray) -> Self:
        """Return the estimate at the frequency lines where the relative variance of the input, `doubt`, is at most 0.1.

        The variance of a quotient is undefined if the denominator may be 0.  Raises LogError if no line is left.
        """
        kept = doubt <= _DOUBT
        if np.all(kept):
            return self
        f = self.frequency
        if not np.any(kept):
            raise LogError(
                f"between {Quantity(f[0], 'Hz', bare=True)} and {Quantity(f[-1], 'Hz')} the excitation does not exceed "
                "the noise of the input: measure again with more amplitude or longer"
            )
        left = f[~kept]
        return self.lines(
            kept,
            Text(
                f"{left.size} of {f.size} lines between {Quantity(left[0], 'Hz', bare=True)} and "
                f"{Quantity(left[-1], 'Hz')} are left out: the excitation does not exceed the noise of the input "
                "there; measure again with more amplitude, longer, or with a coarser resolution"
            ),
        )

    def radius(self, confidence: float = 0.95) -> np.ndarray:
        """Return the radius r of a disc around each response that contains the true response with probability p.

            r² = ν ((1 - p)^(-1/ν) - 1) · variance

        p is `confidence`, and ν are the degrees of freedom of the variance. The radius follows from the F distribution
        with 2 and 2ν degrees of freedom, since |dG|² is exponentially distributed and the variance is its mean.
        """
        if not 0.0 < confidence < 1.0:
            raise ParameterError(f"confidence = {Quantity(confidence):6} must be > 0 and < 1")
        assert self.frf.variance is not None
        return np.sqrt(fisher(confidence, self.freedom) * self.frf.variance)

    def table(self) -> Table:
        """Return a table of response, standard deviation, noise and coherence at up to twelve lines."""
        frf = self.frf
        assert frf.variance is not None
        assert frf.coherence is not None
        n = frf.frequency.size
        deviation, noise = (np.sqrt(variance) / frf.magnitude for variance in (frf.variance, self.noise))
        values = np.column_stack(
            [frf.frequency, frf.magnitude, np.radians(frf.phase_deg), deviation, noise, frf.coherence]
        )
        rows = values[np.unique(np.linspace(0, n - 1, 12).astype(int))].tolist()
        columns = [
            Column("frequency", "Hz", "5"),
            Column("magnitude", frf.unit or "1"),
            Column("phase", "rad", ".1f deg"),
            Column("deviation", "share", "3"),
            Column("by noise", "share", "3"),
            Column("coherence", form=".4f"),
        ]
        return Table(f"{frf.output} / {frf.input}, {n} lines; {self.method}", columns, rows)


def fisher(confidence: float, freedom: np.ndarray | float) -> np.ndarray:
    """Return the quantile of the F distribution with 2 and 2ν degrees of freedom, in closed form; ν is `freedom`."""
    nu = np.asarray(freedom, float)
    return nu * ((1.0 - confidence) ** (-1.0 / nu) - 1.0)

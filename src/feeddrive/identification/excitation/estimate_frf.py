"""Estimation of frequency responses from records of a multisine or of any other excitation."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from feeddrive.identification.excitation import frequency_estimate
from feeddrive.identification.excitation.frequency_estimate import FrequencyEstimate, Level, Record
from feeddrive.identification.excitation.impacts import find_blows, impacts
from feeddrive.identification.excitation.nonperiodic import METHODS, averaged, local_polynomial
from feeddrive.language.errors import LogError, ParameterError
from feeddrive.language.quantity import Quantity, span
from feeddrive.loop.frequency_response import FRF, coherence_of

_GAP = 5.0  # factor between excited and empty lines below which there are no empty ones
_ROUNDING = 1e-9  # share of the largest line below which a line is rounding
_RISK = 0.01  # probability that noise is called distortion
_NEIGHBORS = 5  # detection lines over which a level is the RMS
_HALF = 5  # lines on each side of the local polynomial
_ORDER = 2
_REACH = 31  # lines over which the share of the scatter is a median
_ROUGH = 1.5  # scatter over noise, as median, from which a single draw of phases is called nonlinear


@dataclass(frozen=True, eq=False)
class Averaged:
    """The spectra of input and output averaged over periods, shape (lines,), with their variances and covariance."""

    frequency: np.ndarray
    input: np.ndarray
    output: np.ndarray
    yy: np.ndarray
    uu: np.ndarray
    yu: np.ndarray
    freedom: int  # complex degrees of freedom of the variances
    excited: np.ndarray  # bool

    def noise(self, response: np.ndarray, lines: np.ndarray) -> np.ndarray:
        """Return the noise power E|v|², v = y - G u, at the given frequency lines; `response` is G at these lines."""
        cross = np.real(np.conj(response) * self.yu[lines])
        return np.maximum(self.yy[lines] + np.abs(response) ** 2 * self.uu[lines] - 2.0 * cross, 0.0)


def excited_lines(cause: np.ndarray) -> np.ndarray:
    """Return a mask of the excited lines, which lie above the widest gap in the sorted magnitudes of `cause`.

    This gap separates excited from empty lines even if the spectrum falls by decades over the band.
    """
    # empty lines of a generated reference are exactly 0, and a ratio to them would be the widest gap
    size = np.maximum(np.abs(cause) / np.max(np.abs(cause)), _ROUNDING)
    ordered = np.sort(size)[::-1]
    gaps = ordered[:-1] / ordered[1:]
    widest = int(np.argmax(gaps))
    if gaps[widest] < _GAP:
        return np.ones(size.size, bool)
    return size > np.sqrt(ordered[widest] * ordered[widest + 1])


def detection(mean: Averaged, response: np.ndarray) -> dict[str, Level]:
    """Return the levels of odd and even distortion on empty lines, with the noise subtracted.

        D(k) = Ȳ(k) - Ĝ(k) Ū(k),   level² = mean of |D|² - noise over 5 odd, or 5 even, lines

    Ĝ is interpolated between the neighboring excited lines; the term Ĝ Ū is needed in a closed loop, where the input is
    not zero on the empty lines. Within the band, the level of odd (or even) distortion is set to 0 if a joint
    test of all odd (even) lines finds only noise, at a significance level of 1 %. Outside the band the response is
    unknown, and D is the whole output, including the effect of distortion at the input.  `response` is given on the
    excited lines.  Only lines up to three times the upper end of the band are used.
    """
    lines = np.flatnonzero(mean.excited)
    first, last = int(lines[0]), int(lines[-1])
    levels: dict[str, Level] = {}
    # distortion of third order reaches up to three times the band
    everywhere = np.arange(min(3 * (last + 1), mean.frequency.size))
    empty = everywhere[~mean.excited[everywhere]]
    if not empty.size:
        return levels
    between = (empty > first) & (empty < last)
    # real and imaginary part, not magnitude and phase: no jump where the phase wraps
    guessed = np.interp(empty, lines, np.real(response)) + 1j * np.interp(empty, lines, np.imag(response))
    guessed = np.where(between, guessed, 0.0)
    power = np.abs(mean.output[empty] - guessed * mean.input[empty]) ** 2
    noise = mean.noise(guessed, empty)
    size = np.interp(empty, lines, np.abs(mean.input[lines]))
    # line k has the index k - 1
    for name, kind in (("odd", (empty + 1) % 2 == 1), ("even", (empty + 1) % 2 == 0)):
        if not np.any(kind):
            continue
        inside = between[kind]
        level = np.sqrt(np.maximum(smoothed(power[kind] - noise[kind]), 0.0))
        if np.any(inside) and not _loud(power[kind][inside], noise[kind][inside], mean.freedom):
            level = np.where(inside, 0.0, level)
        response_level = np.where(inside, level / size[kind], np.nan)
        levels[name] = Level(mean.frequency[empty[kind]], level, response_level)
    return levels


def _loud(power: np.ndarray, noise: np.ndarray, freedom: int) -> bool:
    """Return True if the frequency lines contain more than noise, that is, if the mean of |D|²/noise exceeds its
    quantile.

    With noise only, each of the N terms has the distribution F(2, 2ν).  The quantile of their mean is approximated by
    that of F(2N, 2ν) times ν/(ν - 1), the mean of F(2, 2ν).  The noise may have any spectrum.
    """
    from scipy.special import fdtri

    quotient = float(np.mean(power / np.maximum(noise, 1e-300)))
    # the mean of F(2, 2ν) is ν/(ν - 1); with few periods single lines scatter widely, and the test of their sum is
    # conservative
    expected = freedom / (freedom - 1.0) if freedom > 1 else np.inf
    return quotient > expected * float(fdtri(2 * power.size, 2 * max(freedom, 1), 1.0 - _RISK))


def smoothed(values: np.ndarray) -> np.ndarray:
    """Return the moving average over neighboring frequency lines, with a shorter window at the ends."""
    width = min(_NEIGHBORS, values.size)
    ones = np.ones(width)
    return np.convolve(values, ones, "same") / np.convolve(np.ones(values.size), ones, "same")


def local_scatter(frequency: np.ndarray, input: np.ndarray, output: np.ndarray) -> np.ndarray | None:  # noqa: A002
    """Return the scatter E|v|² of the output about a locally smooth response, shape (lines,).

    The response is fitted to eleven excited lines; the result is None if there are fewer.

        Ȳ(i) = (g₀ + g₁ x + g₂ x²) fᵖ Ū(i) + V(i),   x from -1 to 1 over the lines, p the slope of |Ȳ/Ū| on log scales

    The scatter contains noise and nonlinear distortion; the grid needs no empty lines. At a sharp resonance it
    would also include the curvature of the response; therefore the result is the median of |V|²/|Ȳ|² over 31 lines,
    times |Ȳ|².
    Source: Pintelon et al. 2010; in steady state there is no transient to estimate.
    """
    n = frequency.size
    width = 2 * _HALF + 1
    if n < width:
        return None
    starts = np.clip(np.arange(n) - _HALF, 0, n - width)
    around = starts[:, None] + np.arange(width)
    f, u, y = frequency[around], input[around], output[around]
    x = f - 0.5 * (f[:, :1] + f[:, -1:])
    x = x / x[:, -1:]
    # a response that falls as 1/f² is no parabola over eleven lines at low frequency: its slope is taken out first
    response = np.log(np.maximum(np.abs(y / u), 1e-300))
    away = np.log(f) - np.mean(np.log(f), axis=1, keepdims=True)
    slope = np.sum(away * response, axis=1, keepdims=True) / np.sum(away**2, axis=1, keepdims=True)
    regressors = (u * (f / f[:, :1]) ** slope)[:, :, None] * x[:, :, None] ** np.arange(_ORDER + 1)
    scale = np.maximum(np.abs(regressors).max(axis=(1, 2), keepdims=True), np.finfo(float).tiny)
    q = np.linalg.qr(regressors / scale)[0]
    rest = y[:, :, None] - q @ (np.conj(q).transpose(0, 2, 1) @ y[:, :, None])
    scatter = np.sum(np.abs(rest[:, :, 0]) ** 2, axis=1) / (width - _ORDER - 1)
    power = np.abs(output) ** 2
    share = scatter / np.mean(np.abs(y) ** 2, axis=1)
    reach = min(_REACH, n)
    begins = np.clip(np.arange(n) - reach // 2, 0, n - reach)
    return np.median(share[begins[:, None] + np.arange(reach)], axis=1) * power


@dataclass(frozen=True, eq=False)
class _Realisation:
    """One realization: spectra averaged over periods, and the noise (co)variances of y, u and y u*, shape (lines,)."""

    input: np.ndarray
    output: np.ndarray
    reference: np.ndarray | None
    yy: np.ndarray
    uu: np.ndarray
    yu: np.ndarray
    periods: int
    dropped: int


def periodic(
    records: Sequence[Record],
    period: int,
    *,
    band: tuple[float, float] | None = None,
    skip: int | None = None,
) -> FrequencyEstimate:
    """Estimate the response on the excited lines from P periods of each of M realizations (records) in steady state.

        G = Ȳ/Ū,   var = (σ_y² + |G|² σ_u² - 2 Re(conj(G) σ_yu²))/|Ū|²

    σ² are the variances and the covariance of the means.  Computed from the differences between periods, they contain
    only noise; computed from the differences between realizations with different phases, they contain noise and
    nonlinear distortion together (`total`).  With a reference, Y and U are rotated by its phase and averaged over
    the realizations before the division, so that noise at the input causes no bias; this is valid in a closed loop.
    With one realization the distortion on the excited lines is estimated from the odd empty lines between them, if any.
    On a full grid it is estimated as the scatter around a smooth response, if that clearly exceeds the noise. Otherwise
    the variance is that of noise only.

    period  period in samples
    band    lowest and highest frequency, Hz; default: all excited lines
    skip    number of periods dropped at the start; default: as many as are not yet in steady state according to a test,
            at most half

    Raises LogError if fewer than two periods are left.
    Source: Pintelon & Schoukens 2012, sections 2.5 and 4.3.
    """
    cuts = [frequency_estimate.cut(record, period) for record in records]
    # feedback fills the empty lines of the input, so that only a reference shows which lines are excited
    cause = cuts[0][2][0] if records[0].references else cuts[0][0]
    frequency = np.arange(1, (period + 1) // 2) / (period * records[0].sample_time)
    excited = excited_lines(cause.mean(axis=0))
    if band is not None:
        asked = (frequency >= band[0] * (1.0 - 1e-9)) & (frequency <= band[1] * (1.0 + 1e-9))
        chosen = excited & asked
    else:
        chosen = excited
    if not np.any(chosen):
        raise LogError(f"{records[0].name}: no excited line lies in the band")
    drawn = [_realisation(record, cut_record, skip, excited) for record, cut_record in zip(records, cuts, strict=True)]
    lines = np.flatnonzero(chosen)
    response, noise, freedom = _response(drawn, lines)
    first = records[0]
    remarks = [remark for record in records for remark in record.remarks]
    levels = _levels(drawn[0], frequency, excited)
    variance, total, nu, rule = _total(drawn, lines, frequency, response, noise, freedom, levels)
    if len(drawn) == 1 and not total:
        remarks.append("one realisation: the variance is that of noise alone")
    if any(
        realisation.dropped >= (realisation.dropped + realisation.periods) // 2
        for realisation in drawn
        if realisation.dropped
    ):
        remarks.append(
            "half of the periods, the largest number allowed, were dropped: a transient decays so slowly that it "
            "still exceeds the noise; if the deviation is too large, measure more periods, or wait longer before "
            "recording"
        )
    frf = FRF(
        frequency[lines],
        response,
        first.input_name,
        first.output_name,
        first.unit,
        first.sample_time,
        coherence_of(response, noise, freedom),
        variance,
    )
    counts = {
        "realisations": len(drawn),
        "periods": sum(realisation.periods for realisation in drawn),
        "dropped": sum(realisation.dropped for realisation in drawn),
    }
    text = (
        f"periods of {period} samples: {counts['periods']} averaged, {counts['dropped']} dropped, "
        f"{len(drawn)} realisation{'s' if len(drawn) > 1 else ''}; variance by {rule}"
    )
    estimate = FrequencyEstimate(frf, text, nu, noise, total, levels, counts, tuple(remarks))
    doubt = np.mean([realisation.uu[lines] / np.abs(realisation.input[lines]) ** 2 for realisation in drawn], axis=0)
    return estimate.where_excited(doubt)


def _realisation(
    record: Record, transforms: tuple[np.ndarray, np.ndarray, np.ndarray], skip: int | None, excited: np.ndarray
) -> _Realisation:
    u, y, r = transforms
    dropped = (
        max(frequency_estimate.transient_periods(u[:, excited]), frequency_estimate.transient_periods(y[:, excited]))
        if skip is None
        else skip
    )
    if u.shape[0] - dropped < 2:
        raise LogError(f"{record.name}: {u.shape[0]} periods less {dropped} leave fewer than two for the noise")
    u, y = u[dropped:], y[dropped:]
    p = u.shape[0]
    du, dy = u - u.mean(axis=0), y - y.mean(axis=0)
    share = 1.0 / (p * (p - 1))
    yy, uu = share * np.sum(np.abs(dy) ** 2, axis=0), share * np.sum(np.abs(du) ** 2, axis=0)
    yu = share * np.sum(dy * np.conj(du), axis=0)
    reference = r[0].mean(axis=0) if len(r) else None
    return _Realisation(u.mean(axis=0), y.mean(axis=0), reference, yy, uu, yu, p, dropped)


def _turned(drawn: Sequence[_Realisation], lines: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return inputs and outputs of all realizations, rotated to equal phases of the excitation, shape (M, lines)."""
    turns = [
        np.exp(-1j * np.angle((realisation.input if realisation.reference is None else realisation.reference)[lines]))
        for realisation in drawn
    ]
    u = np.array([realisation.input[lines] * turn for realisation, turn in zip(drawn, turns, strict=True)])
    y = np.array([realisation.output[lines] * turn for realisation, turn in zip(drawn, turns, strict=True)])
    return u, y


def _response(drawn: Sequence[_Realisation], lines: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the response, its variance due to noise, and the degrees of freedom of that variance."""
    u, y = _turned(drawn, lines)
    mean_u, mean_y = u.mean(axis=0), y.mean(axis=0)
    response = mean_y / mean_u
    m = len(drawn)
    yy, uu, yu = (
        np.sum([getattr(realisation, name)[lines] for realisation in drawn], axis=0) / m**2
        for name in ("yy", "uu", "yu")
    )
    noise = np.maximum(yy + np.abs(response) ** 2 * uu - 2.0 * np.real(np.conj(response) * yu), 0.0)
    freedom = np.full(lines.size, float(sum(realisation.periods - 1 for realisation in drawn)))
    return response, noise / np.abs(mean_u) ** 2, freedom


def _levels(first: _Realisation, frequency: np.ndarray, excited: np.ndarray) -> dict[str, Level]:
    """Return the noise and distortion levels of the first realization."""
    lines = np.flatnonzero(excited)
    response = first.output[lines] / first.input[lines]
    freedom = first.periods - 1
    mean = Averaged(frequency, first.input, first.output, first.yy, first.uu, first.yu, freedom, excited)
    levels = detection(mean, response)
    noise = np.sqrt(mean.noise(response, lines))
    size = np.abs(first.input[lines])
    levels["noise"] = Level(frequency[lines], noise, noise / size)
    scatter = local_scatter(frequency[lines], first.input[lines], first.output[lines])
    if scatter is not None:
        level = np.sqrt(np.maximum(scatter - noise**2, 0.0))
        levels["nonlinear"] = Level(frequency[lines], level, level / size)
    return levels


def _total(
    drawn: Sequence[_Realisation],
    lines: np.ndarray,
    frequency: np.ndarray,
    response: np.ndarray,
    noise: np.ndarray,
    freedom: np.ndarray,
    levels: dict[str, Level],
) -> tuple[np.ndarray, bool, np.ndarray, str]:
    """Return the variance, True if it includes nonlinear distortion, its degrees of freedom, and the method as text."""
    m = len(drawn)
    if m > 1:
        u, y = _turned(drawn, lines)
        rest = y - response * u
        spread = np.sum(np.abs(rest - rest.mean(axis=0)) ** 2, axis=0) / (m * (m - 1))
        return spread / np.abs(u.mean(axis=0)) ** 2, True, np.full(lines.size, m - 1.0), "the spread of realisations"
    odd = levels.get("odd")
    if odd is not None and np.any(between := np.isfinite(odd.response)):
        if not np.any(odd.response[between]):
            return (
                noise,
                False,
                freedom,
                "the noise of periods; no significant odd distortion on empty lines",
            )
        added = np.interp(frequency[lines], odd.frequency[between], odd.response[between]) ** 2
        return noise + added, True, freedom, "the noise of periods and the odd distortion on empty lines"
    rough = levels.get("nonlinear")
    if rough is not None:
        quiet = np.maximum(levels["noise"].output ** 2, 1e-300)
        if np.median((rough.output**2 + quiet) / quiet) > _ROUGH:
            added = np.interp(frequency[lines], rough.frequency, rough.response) ** 2
            return noise + added, True, freedom, "the noise of periods and the scatter around a smooth response"
    return noise, False, freedom, "the noise of periods"


ALL = ("auto", "periodic", "impact", "local_polynomial", *METHODS)
MOST_LINES = 2000  # of a local polynomial by default
# one period has no scatter, and so no variance
_LEAST_PERIODS = 2
_ENDS = 0.01  # share of a period that may differ without being cut off


def estimate_frf(
    records: Record | Sequence[Record],
    *,
    method: str = "auto",
    band: tuple[float, float] | None = None,
    period: int | None = None,
    skip: int | None = None,
    segment: int | None = None,
    overlap: float = 0.5,
    lines: int | None = None,
) -> FrequencyEstimate:
    """Estimate a frequency response from records of the same channels, with coherence and variance on each line.

    method   "periodic" (multisines in steady state), "impact" (blows of a hammer), "local_polynomial" (chirp, step,
             PRBS, noise), "h1", "h2", "hv", "indirect", "joint" (averaged spectra); "auto": periodic if the excitation
             is periodic in the record, impact if the input consists of short pulses from rest, otherwise local
             polynomials
    band     lowest and highest frequency, Hz
    period   period in samples; default: detected in the reference, or in the input if there is none
    skip     number of periods dropped at the start; default: determined by a test
    segment  samples per segment of averaged spectra; `overlap` is the fraction by which neighboring segments
             overlap
    lines    maximum number of frequency lines of local polynomials; default: 2000

    In a closed loop, records need a reference: without it, every method except "periodic" mistakes noise that is fed
    back through the controller for excitation.  In periodic records this noise averages out over the periods.
    Raises ParameterError for an unknown method and for records that do not match, LogError for
    records that are too short.
    """
    measurements = [records] if isinstance(records, Record) else list(records)
    if not measurements:
        raise ParameterError("there is no record to estimate from")
    if method not in ALL:
        raise ParameterError(f"method = {method!r} must be one of {', '.join(ALL)}")
    _belong(measurements)
    shortest = min(map(len, measurements))
    if period is not None and not 2 <= period <= shortest // _LEAST_PERIODS:
        raise ParameterError(
            f"period = {period} samples must be >= 2 and <= {shortest // _LEAST_PERIODS}, so that the shortest record "
            f"holds {_LEAST_PERIODS} of them"
        )
    if skip is not None and skip < 0:
        raise ParameterError(f"skip = {skip} periods must be >= 0")
    if band is not None:
        _check_band(measurements[0], band)
    if method in ("auto", "periodic"):
        repetition = period or _period(measurements)
        if repetition is not None:
            return periodic([_steady(record, repetition) for record in measurements], repetition, band=band, skip=skip)
        if method == "periodic":
            raise LogError(
                f"{measurements[0].name}: the excitation does not repeat at least {_LEAST_PERIODS} times within the "
                f"record: give the period in samples, or take method 'local_polynomial'"
            )
    if method == "impact" or (method == "auto" and _struck(measurements)):
        return within(impacts(measurements), band)
    if method in METHODS:
        return within(averaged(measurements, method, segment=segment, overlap=overlap), band)
    if method == "local_polynomial" and (repetition := _period(measurements)) is not None:
        raise LogError(
            f"{measurements[0].name}: the excitation repeats every {repetition} samples, so that most lines of the "
            "whole record are empty and local polynomials lack neighboring lines: take method 'periodic'"
        )
    if method == "local_polynomial" and _struck(measurements):
        raise LogError(
            f"{measurements[0].name}: the excitation is hammer blows: force and transient are both smooth over "
            "frequency, and local polynomials cannot separate them: take method 'impact'"
        )
    return local_polynomial(measurements, band=band, lines=lines or MOST_LINES)


def _period(records: Sequence[Record]) -> int | None:
    first = records[0]
    repetition = frequency_estimate.find_period(first.references[0] if first.references else first.input)
    return repetition if repetition is not None and min(map(len, records)) // repetition >= _LEAST_PERIODS else None


def _struck(records: Sequence[Record]) -> bool:
    """Return True if the input of every record consists of hammer blows and no record has a reference."""
    return not any(record.references for record in records) and all(find_blows(record.input) for record in records)


def _steady(record: Record, period: int) -> Record:
    """Return the part of a record in which the reference is periodic.

    The whole record is returned without a reference, if this part is shorter than two periods, and if hardly anything
    would be removed.
    """
    if not record.references:
        return record
    begin, end = frequency_estimate.repeating(record.references[0], period)
    # a few samples at the ends, where a generator stops, must not cost a period
    if end - begin < 2 * period or len(record) - (end - begin) <= _ENDS * period:
        return record
    kept = slice(begin, end)
    references = tuple(reference[kept] for reference in record.references)
    return replace(record, input=record.input[kept], output=record.output[kept], references=references)


def _belong(records: Sequence[Record]) -> None:
    first = records[0]
    for record in records[1:]:
        if record.sample_time != first.sample_time or len(record.references) != len(first.references):
            raise ParameterError(f"{record.name}: differs in sample time or references from {first.name}")


def _check_band(record: Record, band: tuple[float, float]) -> None:
    low, high = band
    if not 0.0 <= low < high <= record.nyquist * (1.0 + 1e-9):
        raise ParameterError(
            f"band {span(low, high, 'Hz', '6', between='..')} must rise and lie between 0 Hz and Nyquist, "
            f"{Quantity(record.nyquist, 'Hz'):6}"
        )


def within(estimate: FrequencyEstimate, band: tuple[float, float] | None) -> FrequencyEstimate:
    """Return the estimate restricted to the frequency lines of a band. Raises ParameterError if there are none."""
    if band is None:
        return estimate
    f = estimate.frf
    kept = (f.frequency >= band[0] * (1.0 - 1e-9)) & (f.frequency <= band[1] * (1.0 + 1e-9))
    if not np.any(kept):
        raise ParameterError(
            f"no line lies in {span(*band, 'Hz', '6', between='..')}: take longer segments, or excite this band"
        )
    return estimate.lines(kept)

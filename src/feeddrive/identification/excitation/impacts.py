"""Frequency responses from impact tests: force window, exponential window with correction, averaging over blows."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from feeddrive.identification.excitation.frequency_estimate import FEWEST, FrequencyEstimate, Record, saturation
from feeddrive.identification.excitation.nonperiodic import local_rational
from feeddrive.identification.regression import median_spread
from feeddrive.language.errors import LogError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.loop.frequency_response import FRF, coherence_of

_STRONG = 0.1  # of the largest force: a sample above it belongs to a blow
_BUSY = 0.05  # share of strong samples up to which a force counts as blows
_INSIDE = 0.9  # share of the energy of the force, beyond its noise, that its blows hold
# of the largest force: a ringing sensor swings back by so much, any other excitation by more
_ONE_WAY = 0.1
_WEAK = 0.3  # of the median blow: weaker ones are not used
_BOUNCE = 0.1  # of the usual time between blows: a pulse that comes sooner is a bounce of the same blow
_SHORT = 0.5  # of the median stretch: shorter ones are not used
_NOISE = 4.0  # standard deviations of the force at rest, up to which it is noise
_DECAYED = 0.02  # of its start: a response that is smaller at the end of its stretch needs no window
_STRONG_OCTAVE = 1e-4  # of the power of the strongest octave: weaker octaves do not count
_FALLING = 0.7  # of the power of the previous quarter: vibration decays by more
_LOUD = 0.3  # of the start: noise is less
_LEFT = 0.01  # of its start: remainder of a response at the end of an exponential window
_HALF = 4  # lines on each side from which the effect of the window is taken out
_FALLS = 0.1  # of the largest force spectrum: below it the blow no longer excites


@dataclass(frozen=True)
class _Blow:
    """A hammer blow with its bounces: begin and end in samples, the number of contacts, and the peak force."""

    begin: int
    end: int
    touches: int
    peak: float


def find_blows(force: np.ndarray) -> list[_Blow]:
    """Find the hammer blows in a force signal; other signals, such as noise, a chirp or a periodic force, contain none.

    A blow is a short unipolar pulse that starts and ends at rest.
    """
    u = force - np.median(force)
    # a hammer's sensor may be wired either way
    if np.max(u) < -np.min(u):
        u = -u
    peak = float(np.max(u))
    strong = np.abs(u) > _STRONG * peak
    if np.mean(strong) > _BUSY or -float(np.min(u)) > _ONE_WAY * peak + _NOISE * _rest(u):
        return []
    quiet = np.abs(u) <= max(_NOISE * _rest(u), 1e-3 * peak)
    touches = _runs(strong)
    touches = [_wide(_before(quiet, begin), _after(quiet, end), u.size) for begin, end in touches]
    merged: list[list[int]] = []
    for begin, end in touches:
        if merged and begin <= merged[-1][1]:
            merged[-1][1] = max(end, merged[-1][1])
        else:
            merged.append([begin, end])
    held = sum(float(np.sum(u[begin:end] ** 2)) for begin, end in merged)
    if (
        held < _INSIDE * (float(np.sum(u**2)) - u.size * _rest(u) ** 2)
        or max(end - begin for begin, end in merged) > _BUSY * u.size
    ):
        return []
    return _bounces_joined(u, merged)


def _rest(u: np.ndarray) -> float:
    """Return the standard deviation of the force at rest, from its median absolute value."""
    # a few blows do not move a median
    return median_spread(u)


def _runs(inside: np.ndarray) -> list[tuple[int, int]]:
    edges = np.diff(np.concatenate([[False], inside, [False]]).astype(int))
    return list(zip(np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist(), strict=True))


def _before(quiet: np.ndarray, begin: int) -> int:
    """Return the last quiet sample before a pulse, or 0 if there is none."""
    still = np.flatnonzero(quiet[:begin])
    return int(still[-1]) if still.size else 0


def _after(quiet: np.ndarray, end: int) -> int:
    still = np.flatnonzero(quiet[end:])
    return end + int(still[0]) + 1 if still.size else quiet.size


def _wide(begin: int, end: int, size: int) -> tuple[int, int]:
    """Return the start and end of a pulse extended by half its length on each side, as its ends are hidden in the
    noise.
    """
    more = (end - begin + 1) // 2
    return max(0, begin - more), min(size, end + more)


def _bounces_joined(u: np.ndarray, pulses: Sequence[Sequence[int]]) -> list[_Blow]:
    """Merge pulses into blows; a pulse that follows a blow after much less than the usual interval is a bounce."""
    begins = np.array([begin for begin, _ in pulses])
    gaps = np.diff(begins)
    usual = float(np.max(gaps)) if gaps.size else np.inf
    blows: list[_Blow] = []
    for begin, end in pulses:
        peak = float(np.max(u[begin:end]))
        if blows and begin - blows[-1].begin < _BOUNCE * usual:
            last = blows[-1]
            blows[-1] = _Blow(last.begin, end, last.touches + 1, max(last.peak, peak))
        else:
            blows.append(_Blow(begin, end, 1, peak))
    return blows


def impacts(records: Sequence[Record]) -> FrequencyEstimate:
    """Estimate a frequency response from hammer blows, one or several per record, each from rest.

        G(s) = Σ Y(s) U*(s) / Σ |U(s)|²   over the blows,   s = jω + σ

    The records are cut into one segment per blow, all of equal length. Outside the contact time of the hammer the force
    is set to 0 (force window).  If a response has not decayed to 2 % at the end of its segment, response and force are
    multiplied by exp(-σt), so that 1 % remains (exponential window). The Fourier transform then gives the response at
    s = jω + σ, where the decay rate of every mode appears larger by σ. To correct this, a function with one resonance,

        G(s) (1 + b x) = a₀ + a₁ x + a₂ x²,   x = s - s₀,

    is fitted to the 9 lines around each line and evaluated at s = jω.  The variance follows from the scatter of the
    blows,

        var(G) = |G|² (1 - γ²)/(γ² (n - 1)),

    and includes noise, differences in point and direction between the blows, and nonlinearity.  A single blow has no
    scatter and no coherence: its noise is that of the output before the blow or the residual of the local function,
    whichever is larger. The coherence is that of averaged spectra with the same variance.

    Lines on which the force does not exceed its noise are left out.
    Raises LogError if there is no blow, or none with a sufficiently long segment.
    Source: Halvorsen & Brown 1977, Sound and Vibration 11(11) (windows); McKelvey & Guérin 2012 (local function).
    """
    first = records[0]
    by_record = [(record, find_blows(record.input)) for record in records]
    if not any(blows for _, blows in by_record):
        raise LogError(
            f"{first.name}: '{first.input_name}' holds no blows of a hammer: short pulses in one direction, from rest "
            f"and back to it"
        )
    stretches, length, remarks = _stretches(by_record)
    rows = [_row(record, blow, length) for record, blow in stretches]
    u, y = np.array([row[0] for row in rows]), np.array([row[1] for row in rows])
    sigma = _needed_damping(y, first.sample_time)
    if sigma:
        window = np.exp(-sigma * first.sample_time * np.arange(length))
        u, y = u * window, y * window
    lines = slice(1, (length + 1) // 2)
    force, answer = np.fft.rfft(u, axis=1)[:, lines], np.fft.rfft(y, axis=1)[:, lines]
    frequency = np.arange(1, (length + 1) // 2) / (length * first.sample_time)
    power = np.sum(np.abs(force) ** 2, axis=0)
    response = np.sum(answer * np.conj(force), axis=0) / power
    count = len(rows)
    noise = sum(_force_noise(record, blow) for record, blow in stretches)
    if count > 1:
        rest = np.sum(np.abs(answer - response * force) ** 2, axis=0) / (count - 1)
        freedom = float(count - 1)
    else:
        rest = _noise_of_one(records, stretches[0], sigma, length) + np.abs(response) ** 2 * noise
        # lines of the local function less its complex unknowns
        freedom = float(2 * _HALF + 1 - 4)
    variance = rest / power
    omega = 2.0 * np.pi * frequency
    if sigma or count == 1:
        # with few blows the variance of single lines scatters widely, and with it the weights
        floor = np.maximum(_averaged(rest * np.ones_like(power)) / power, 1e-12 * np.abs(response) ** 2)
        every = np.arange(frequency.size)
        value, spread, excess = local_rational(
            omega,
            response,
            floor,
            2 * _HALF + 1,
            every,
            at=1j * sigma,
            correlation=_correlation(sigma * first.sample_time, length),
        )
        # a single blow has no scatter: the residual of the local function counts as noise, too
        if count == 1:
            more = np.maximum(excess / (2.0 * freedom), 1.0)
            variance, spread = floor * more, spread * more
        if sigma:
            response, variance = value, spread
    frf = FRF(
        frequency,
        response,
        first.input_name,
        first.output_name,
        first.unit,
        first.sample_time,
        coherence_of(response, variance, freedom),
        variance,
    )
    window = (
        Text(f"exponential window of {Quantity(sigma, '1/s')}, corrected")
        if sigma
        else "no exponential window: responses decay"
    )
    text = Text(f"{count} blow{'s' if count > 1 else ''} of {length} samples, force window, {window}")
    remarks += _remarks(stretches, frequency, power, sigma)
    estimate = FrequencyEstimate(
        frf,
        text,
        np.full(frequency.size, freedom),
        variance,
        total=count > 1,
        counts={"blows": count},
        remarks=(*_saturation(stretches), *remarks),
    )
    return estimate.where_excited(noise / power)


def _correlation(decay: float, length: int) -> np.ndarray:
    """Return the correlation between frequency lines at distances 0, 1, ... of white noise with a window exp(-decay ·
    sample).
    """
    window = np.exp(-2.0 * decay * np.arange(length))
    spectrum = np.fft.fft(window)[: 2 * _HALF + 1]
    return spectrum / spectrum[0]


def _averaged(values: np.ndarray) -> np.ndarray:
    """Return the moving average over as many lines as in a local fit, with a shorter window at the ends."""
    ones = np.ones(2 * _HALF + 1)
    return np.convolve(values, ones, "same") / np.convolve(np.ones(values.size), ones, "same")


def _stretches(by_record: Sequence[tuple[Record, list[_Blow]]]) -> tuple[list[tuple[Record, _Blow]], int, list[str]]:
    """Return the usable blows with their records, the length of their segments in samples, and remarks on the rest."""
    usual = float(np.median([blow.peak for _, blows in by_record for blow in blows]))
    usable: list[tuple[Record, _Blow, int]] = []
    weak = 0
    for record, blows in by_record:
        ends = [_start(after) for after in blows[1:]] + [len(record)]
        for blow, end in zip(blows, ends, strict=True):
            if blow.peak < _WEAK * usual:
                weak += 1
            else:
                usable.append((record, blow, end - _start(blow)))
    typical = float(np.median([length for *_, length in usable]))
    kept = [(record, blow, length) for record, blow, length in usable if length >= _SHORT * typical]
    # one length for all segments, so that their lines coincide
    length = min(length for *_, length in kept)
    if length < 4 * FEWEST:
        raise LogError(
            f"{kept[0][0].name}: {length} samples after a blow are too few; record longer after each blow, at least "
            f"{4 * FEWEST} samples and until the response has decayed"
        )
    remarks: list[str] = []
    if weak:
        remarks.append(Text(f"{weak} blow(s) below {Quantity(_WEAK, 'share'):6} of the usual force are not used"))
    if len(usable) > len(kept):
        remarks.append(
            Text(
                f"{len(usable) - len(kept)} blow(s) with less than {Quantity(_SHORT, 'share'):6} of the usual time "
                "after them are not used"
            )
        )
    return [(record, blow) for record, blow, _ in kept], length, remarks


def _start(blow: _Blow) -> int:
    """Return the first sample of a segment: half a pulse length before the blow, since a filter may smear its start."""
    return max(0, blow.begin - (blow.end - blow.begin) // 2 - 1)


def _row(record: Record, blow: _Blow, length: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the force and response of a segment, both relative to rest; outside the contact the force is set to 0."""
    start = _start(blow)
    force = np.zeros(length)
    end = min(blow.end, start + length)
    force[blow.begin - start : end - start] = record.input[blow.begin : end] - np.median(record.input)
    # offset and slow drift of the sensor before the blow are no response to it
    before = record.output[max(0, start - FEWEST) : blow.begin + 1]
    return force, record.output[start : start + length] - np.mean(before)


def _needed_damping(answers: np.ndarray, step: float) -> float:
    """Return σ, 1/s, of an exponential window that reduces the responses to 1 % at the end, or 0 if none is needed.

    The last quarter of the segments is compared with the first in each octave, since one mode may mask another that
    decays more slowly.  A signal that does not decay from the third quarter to the last is noise, not vibration.
    """
    quarter = answers.shape[1] // 4
    window = np.hanning(quarter)
    power = [
        np.mean(np.abs(np.fft.rfft(window * (piece - piece.mean(axis=1, keepdims=True)), axis=1)) ** 2, axis=0)
        for piece in (answers[:, k * quarter : (k + 1) * quarter] for k in range(4))
    ]
    edges = 2 ** np.arange(1, int(np.log2(quarter)) + 1)
    start, third, last = (np.add.reduceat(power[k][: edges[-1]], edges[:-1]) for k in (0, 2, 3))
    strong = start >= _STRONG_OCTAVE * np.max(start)
    left = np.sqrt(last / np.maximum(start, np.finfo(float).tiny))
    noise = (last > _FALLING * third) & (left < _LOUD)
    needs = strong & ~noise & (left > _DECAYED)
    if not np.any(needs):
        return 0.0
    return float(np.log(np.max(left[needs]) / _LEFT)) / (answers.shape[1] * step)


def _noise_of_one(
    records: Sequence[Record], stretch: tuple[Record, _Blow], sigma: float, length: int
) -> np.ndarray | float:
    """Return the output noise power per line for a single blow, from samples before it, or 0 if they are too few."""
    record, blow = stretch
    before = record.output[: _start(blow)]
    if before.size < FEWEST:
        return 0.0
    window = np.exp(-2.0 * sigma * records[0].sample_time * np.arange(length))
    return np.full((length + 1) // 2 - 1, float(np.var(before) * np.sum(window)))


def _force_noise(record: Record, blow: _Blow) -> float:
    """Return the power of the force noise per line, within the force window."""
    return _rest(record.input - np.median(record.input)) ** 2 * (blow.end - blow.begin)


def _saturation(stretches: Sequence[tuple[Record, _Blow]]) -> list[str]:
    """Return remarks on saturated outputs and on blows with a clipped peak."""
    remarks: list[str] = []
    for record in dict.fromkeys(record for record, _ in stretches):
        remarks += saturation(record.output_name, record.output)
    flat = sum(_clipped(record.input[blow.begin : blow.end]) for record, blow in stretches)
    if flat:
        remarks.append(f"{flat} of {len(stretches)} blows are clipped at the top: the force sensor was saturated")
    return remarks


def _clipped(pulse: np.ndarray) -> bool:
    """Return True for a pulse with three or more samples exactly at its largest value."""
    away = np.abs(pulse)
    # a pulse of a sensor within its range has one largest sample, or two by rounding
    return int(np.count_nonzero(away == np.max(away))) >= 3


def _remarks(
    stretches: Sequence[tuple[Record, _Blow]], frequency: np.ndarray, power: np.ndarray, sigma: float
) -> list[str]:
    remarks: list[str] = []
    bounced = sum(blow.touches > 1 for _, blow in stretches)
    if bounced:
        remarks.append(
            f"{bounced} of {len(stretches)} blows touched more than once: the force has notches over frequency; "
            "all contacts are included in the force, but blows without a bounce are better"
        )
    if len(stretches) == 1:
        remarks.append(
            "one blow does not show noise at the input, scatter of blows, or nonlinearity; strike five times or more"
        )
    amplitude = np.sqrt(power / np.max(power))
    below = np.flatnonzero(amplitude < _FALLS)
    if below.size:
        remarks.append(
            Text(
                f"the spectrum of the force falls to {Quantity(_FALLS, 'share'):6} of its largest value at "
                f"{Quantity(frequency[below[0]], 'Hz')}: a harder tip excites higher frequencies"
            )
        )
    if sigma:
        remarks.append(
            Text(
                "the response had not decayed when its stretch ended: an exponential window of "
                f"{Quantity(sigma, '1/s')} was applied and its damping was corrected; with more time between blows it "
                "would not be needed"
            )
        )
    return remarks

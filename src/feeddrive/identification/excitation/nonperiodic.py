"""Frequency responses for arbitrary excitation: averaged spectra, and the local polynomial method."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from feeddrive.identification.excitation.frequency_estimate import FrequencyEstimate, Record
from feeddrive.language.errors import LogError, ParameterError
from feeddrive.language.quantity import Quantity, span
from feeddrive.language.text import Text
from feeddrive.loop.frequency_response import FRF, coherence_of

METHODS = ("h1", "h2", "hv", "indirect", "joint")
AVERAGES = 16  # half-overlapping stretches that a record is cut into if no length is given


@dataclass(frozen=True, eq=False)
class Spectra:
    """The Fourier transforms of windowed segments of input, output and references.

    Shapes are (segments, lines), for references (segments, references, lines); `averages` is the equivalent number of
    independent segments, which is lower than the actual number if they overlap.
    """

    frequency: np.ndarray
    input: np.ndarray
    output: np.ndarray
    references: np.ndarray
    averages: float


def spectra(records: Sequence[Record], segment: int | None = None, overlap: float = 0.5) -> Spectra:
    """Return the spectra of overlapping, detrended segments of `segment` samples with a Hann window.

    The variance of averages over overlapping segments follows from the window (Welch 1967):
        1/averages = (1 + 2 Σⱼ (1 - j/n) ρⱼ²)/n,   ρⱼ = Σ w(t) w(t + jD)/Σ w²
    Raises LogError for records shorter than two segments, ParameterError for an overlap outside 0..0.75.
    """
    if not 0.0 <= overlap <= 0.75:
        raise ParameterError(f"overlap = {Quantity(overlap):6} must be >= 0 and <= 0.75 of a stretch")
    shortest = min(len(record) for record in records)
    total = sum(len(record) for record in records)
    if segment is None:
        segment = 2 * int(min(total / (AVERAGES * (1.0 - overlap) + overlap), 0.5 * shortest) / 2)
    if segment < 16 or segment > shortest:
        raise LogError(
            f"stretches of {segment} samples do not fit: at least 16, and at most {shortest}, the shortest record"
        )
    step = max(1, round(segment * (1.0 - overlap)))
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * (np.arange(segment) + 0.5) / segment)
    columns: list[list[np.ndarray]] = [[], [], []]
    for record in records:
        starts = np.arange(0, len(record) - segment + 1, step)
        for place, values in enumerate((record.input[None], record.output[None], np.array(record.references))):
            if values.size == 0:
                values = np.zeros((0, len(record)))
            pieces = values[:, starts[:, None] + np.arange(segment)].transpose(1, 0, 2)
            columns[place].append(np.fft.rfft(window * _level(pieces), axis=-1)[..., 1 : segment // 2])
    count = sum(segments.shape[0] for segments in columns[0])
    if count < 3:
        raise LogError(f"{count} stretches of {segment} samples are too few for a variance: at least 3")
    lags = np.arange(1, min(count, -(-segment // step)))
    shares = np.array([np.sum(window[: segment - j * step] * window[j * step :]) for j in lags]) / np.sum(window**2)
    averages = count / (1.0 + 2.0 * float(np.sum((1.0 - lags / count) * shares**2)))
    frequency = np.arange(1, segment // 2) / (segment * records[0].sample_time)
    joined = [np.concatenate(column) for column in columns]
    return Spectra(frequency, joined[0][:, 0], joined[1][:, 0], joined[2], averages)


def _level(pieces: np.ndarray) -> np.ndarray:
    """Return segments without mean and linear trend, since a drift would leak into all frequency lines."""
    t = np.arange(pieces.shape[-1]) - 0.5 * (pieces.shape[-1] - 1)
    slope = (pieces @ t) / np.sum(t * t)
    return pieces - pieces.mean(axis=-1, keepdims=True) - slope[..., None] * t


def averaged(
    records: Sequence[Record], method: str = "h1", *, segment: int | None = None, overlap: float = 0.5
) -> FrequencyEstimate:
    """Estimate a frequency response from averaged spectra (Welch's method), with ν = averages - 1 degrees of freedom.

        h1        S_yu/S_uu               noise at the output only               var = |G|² (1 - γ²)/(γ² ν)
        h2        S_yy/S_uy               noise at the input only                as h1
        hv        √(S_yy/S_uu), phase of S_yu: equal shares of noise at both     var = |G|² (1 + γ⁻²)(1 - γ²)/(2ν)
        indirect  S_yr/S_ur               closed loop, one reference
        joint     Sₐy/Sₐa, a = U projected on all references: closed loop, any number of them
                                          var = S_vv/(ν' Sₐa), v = y - G u, with ν' = averages - references

    In a closed loop h1, h2 and hv are biased: noise is fed back through the controller C, and the estimates tend to
    -1/C where the noise is large.  The coherence is that of input and output; for indirect and joint it is the smaller
    of those from reference to input and from reference to output.
    Not suitable for short records and for resonances narrower than the line spacing; use `local_polynomial`.
    Source: Bendat & Piersol 2010, chapter 9; Pintelon & Schoukens 2012, sections 2.6 and 2.7.
    """
    if method not in METHODS:
        raise ParameterError(f"method = {method!r} must be one of {', '.join(METHODS)}")
    transforms = spectra(records, segment, overlap)
    u, y, r = transforms.input, transforms.output, transforms.references
    closed = method in ("indirect", "joint")
    if closed and r.shape[1] == 0:
        raise ParameterError(f"method '{method}' needs a reference: what was added to the loop from outside")
    if method == "indirect" and r.shape[1] > 1:
        raise ParameterError(f"method 'indirect' takes one reference, not {r.shape[1]}; take 'joint'")
    if closed:
        response, variance, coherence, nu, doubt = _closed(u, y, r, transforms.averages)
    else:
        nu, doubt = transforms.averages - 1.0, np.zeros(transforms.frequency.size)
        suu, syy = np.mean(np.abs(u) ** 2, axis=0), np.mean(np.abs(y) ** 2, axis=0)
        syu = np.mean(y * np.conj(u), axis=0)
        coherence = np.clip(np.abs(syu) ** 2 / np.maximum(suu * syy, np.finfo(float).tiny), 0.0, 1.0)
        response = {"h1": syu / suu, "h2": syy / np.conj(syu), "hv": np.sqrt(syy / suu) * np.exp(1j * np.angle(syu))}[
            method
        ]
        share = (1.0 - coherence) / np.maximum(coherence, 1e-12) / nu
        if method == "hv":
            share = 0.5 * (1.0 + coherence) * share
        variance = np.abs(response) ** 2 * share
    first = records[0]
    frf = FRF(
        transforms.frequency,
        response,
        first.input_name,
        first.output_name,
        first.unit,
        first.sample_time,
        coherence,
        variance,
    )
    length = 1.0 / (transforms.frequency[0] * first.sample_time)
    text = Text(
        f"{method}: {u.shape[0]} stretches of {round(length)} samples, Hann window, {Quantity(overlap, 'share'):6} "
        f"overlap, worth {Quantity(transforms.averages):.1f} independent ones"
    )
    remarks = tuple(remark for record in records for remark in record.remarks)
    estimate = FrequencyEstimate(
        frf, text, np.full(transforms.frequency.size, nu), variance, counts={"stretches": u.shape[0]}, remarks=remarks
    )
    return estimate.where_excited(doubt)


def _closed(
    u: np.ndarray, y: np.ndarray, r: np.ndarray, averages: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float, np.ndarray]:
    """Return response, variance, coherence, degrees of freedom, and relative variance of the projected input."""
    lines = r.transpose(2, 0, 1)  # (lines, stretches, references)
    nu = averages - lines.shape[2]
    if nu < 1.0:
        raise LogError(f"{Quantity(averages):.1f} independent stretches do not separate {lines.shape[2]} references")
    # an orthonormal basis, since references may be correlated
    base = np.linalg.qr(lines)[0]
    projected = np.einsum("lsr,lr->sl", base, np.einsum("lsr,sl->lr", np.conj(base), u))
    power = np.mean(np.abs(projected) ** 2, axis=0)
    response = np.mean(y * np.conj(projected), axis=0) / power
    rest = np.mean(np.abs(y - response * u) ** 2, axis=0) * averages / nu
    answered = np.einsum("lsr,sl->lr", np.conj(base), y)
    of_input = power / np.mean(np.abs(u) ** 2, axis=0)
    of_output = np.sum(np.abs(answered) ** 2, axis=1) / np.sum(np.abs(y) ** 2, axis=0)
    coherence = np.clip(np.minimum(of_input, of_output), 0.0, 1.0)
    doubt = np.mean(np.abs(u - projected) ** 2, axis=0) / (nu * power)
    return response, rest / (averages * power), coherence, nu, doubt


ORDER = 2
UNKNOWNS = 4  # of a local function with one resonance
_AT_ONCE = 4096  # lines whose small systems are solved together


def local_polynomial(
    records: Sequence[Record], *, band: tuple[float, float] | None = None, lines: int | None = None, freedom: int = 8
) -> FrequencyEstimate:
    """Estimate the frequency response at each line k from the 2n + 1 lines around it, n = (6 + ν - 1)/2 rounded up.

        Y(k+i) = (g₀ + g₁ i + g₂ i²) U(k+i) + (t₀ + t₁ i + t₂ i²) + V(k+i),   i = -n .. n

    The response and the transient of the record (its leakage) are assumed to be smooth over these frequency lines. The
    residual is noise, and its variance, with ν degrees of freedom, determines that of the response.  The coherence is
    that of averaged spectra with the same variance: it is low where response and transient cannot be separated.  With a
    reference, both Y/R and U/R are estimated in this way, with their covariance; their quotient is valid in a closed
    loop. Several records are averaged with weights that assume equal noise in all of them.

    band     lowest and highest frequency, Hz; default: all lines
    lines    maximum number of lines, spaced logarithmically over the band; default: all
    freedom  ν: a larger value gives a smoother response with less variance, but flattens resonances

    The responses at neighboring lines share data, so their errors are correlated over 2n lines.
    Suitable for chirps, steps, PRBS, noise and any motion.  Not suitable for periods of a multisine in steady state.
    Source: Pintelon, Schoukens, Vandersteen & Barbé 2010, Mech. Syst. Signal Process. 24, 573; order 2.
    """
    if freedom < 1:
        raise ParameterError(f"freedom = {freedom} must be >= 1")
    if any(len(record.references) > 1 for record in records):
        raise ParameterError("the local polynomial method takes one reference; for several take method 'joint'")
    half = -(-(2 * (ORDER + 1) + freedom - 1) // 2)
    results: list[tuple[np.ndarray, ...]] = []
    first = records[0]
    chosen = _chosen(first, half, band, lines)
    frequency = chosen / (len(first) * first.sample_time)
    for record in records:
        if len(record) != len(first):
            raise LogError(
                f"{record.name}: has {len(record)} samples, {first.name} {len(first)}: cut them to one length"
            )
        results.append(_one(record, chosen, half))
    responses, gains, noises, doubts = (np.array(part) for part in zip(*results, strict=True))
    weights = 1.0 / gains
    response = np.sum(weights * responses, axis=0) / np.sum(weights, axis=0)
    variance = np.mean(noises, axis=0) / np.sum(weights, axis=0)
    nu = float((2 * half + 1 - 2 * (ORDER + 1)) * len(records))
    frf = FRF(
        frequency,
        response,
        first.input_name,
        first.output_name,
        first.unit,
        first.sample_time,
        coherence_of(response, variance, nu),
        variance,
    )
    text = Text(
        f"local polynomials of order {ORDER} over {2 * half + 1} lines of "
        f"{Quantity(1 / (len(first) * first.sample_time), 'Hz')}"
    ) + (", through the reference" if first.references else "")
    remarks = tuple(remark for record in records for remark in record.remarks)
    estimate = FrequencyEstimate(
        frf, text, np.full(frequency.size, nu), variance, counts={"records": len(records)}, remarks=remarks
    )
    return estimate.where_excited(np.max(doubts, axis=0))


def _chosen(record: Record, half: int, band: tuple[float, float] | None, lines: int | None) -> np.ndarray:
    """Return the chosen lines of a band, at least `half` lines away from 0 Hz and Nyquist."""
    n = len(record)
    resolution = 1.0 / (n * record.sample_time)
    low, high = band or (0.0, record.nyquist)
    least, most = (
        max(half + 1, int(np.ceil(low / resolution * (1 - 1e-12)))),
        min((n - 1) // 2 - half, int(high / resolution * (1 + 1e-12))),
    )
    if most < least:
        raise LogError(
            f"{record.name}: no line of {Quantity(resolution, 'Hz')} in {span(low, high, 'Hz', '6', between='..')} has "
            f"{half} neighbors on each side: record longer"
        )
    if lines is None or lines >= most - least + 1:
        return np.arange(least, most + 1)
    return np.unique(np.rint(np.geomspace(least, most, lines)).astype(int))


def _one(record: Record, chosen: np.ndarray, half: int) -> tuple[np.ndarray, ...]:
    """Return, for one record, response, variance for unit noise power, noise power, and relative variance of U/R."""
    spectrum = {
        name: np.fft.rfft(values - values.mean()) for name, values in (("u", record.input), ("y", record.output))
    }
    cause = np.fft.rfft(record.references[0] - record.references[0].mean()) if record.references else spectrum["u"]
    parts: list[tuple[np.ndarray, ...]] = []
    for start in range(0, chosen.size, _AT_ONCE):
        k = chosen[start : start + _AT_ONCE, None] + np.arange(-half, half + 1)
        parts.append(_solved(cause[k], spectrum["u"][k], spectrum["y"][k], half, bool(record.references)))
    return tuple(np.concatenate(part) for part in zip(*parts, strict=True))


def _solved(cause: np.ndarray, u: np.ndarray, y: np.ndarray, half: int, closed: bool) -> tuple[np.ndarray, ...]:
    """Solve the local least-squares problems of many lines: 2n + 1 equations and 6 unknowns per line and output."""
    powers = (np.arange(-half, half + 1) / half)[:, None] ** np.arange(ORDER + 1)
    # the columns of the input are scaled to 1, so that the systems are well conditioned
    size = np.sqrt(np.mean(np.abs(cause) ** 2, axis=1, keepdims=True))[:, :, None]
    size = np.maximum(size, np.finfo(float).tiny)
    regressors = np.concatenate(
        [powers * cause[:, :, None] / size, np.broadcast_to(powers, (*cause.shape, ORDER + 1))], axis=2
    )
    q, r = np.linalg.qr(regressors)
    answers = np.stack([y, u], axis=2) if closed else y[:, :, None]
    projected = np.conj(q).transpose(0, 2, 1) @ answers
    rest = answers - q @ projected
    nu = answers.shape[1] - regressors.shape[2]
    # only the first row of the inverse is needed: the response at the line itself
    unit = np.zeros((regressors.shape[2], 1))
    unit[0] = 1.0
    try:
        row = np.linalg.solve(np.conj(r).transpose(0, 2, 1), np.broadcast_to(unit, (r.shape[0], *unit.shape)))
    except np.linalg.LinAlgError:
        raise LogError(
            "the excitation has too few lines for local polynomials: it is zero over a whole window"
        ) from None
    first = (np.conj(row).transpose(0, 2, 1) @ projected)[:, 0] / size[:, 0]
    gain = np.sum(np.abs(row[:, :, 0]) ** 2, axis=1) / size[:, 0, 0] ** 2
    if not closed:
        noise = np.sum(np.abs(rest[:, :, 0]) ** 2, axis=1) / nu
        return first[:, 0], gain, noise, np.zeros_like(gain)
    response = first[:, 0] / first[:, 1]
    noise = np.sum(np.abs(rest[:, :, 0] - response[:, None] * rest[:, :, 1]) ** 2, axis=1) / nu
    of_input = gain / np.abs(first[:, 1]) ** 2
    doubt = of_input * np.sum(np.abs(rest[:, :, 1]) ** 2, axis=1) / nu
    return response, of_input, noise, doubt


def local_rational(
    x: np.ndarray,
    y: np.ndarray,
    spread: np.ndarray,
    width: int,
    lines: np.ndarray,
    at: complex = 0.0,
    correlation: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fit a function with one resonance around each of `lines` (indices); return value, variance and residuals.

    Value and variance are those of the function at x + `at`, which may be complex (analytic continuation).

        y (1 + b u) = a0 + a1 u + a2 u²,   u = x - x(line),   complex a, b

    The least-squares problem over `width` lines is weighted with the variance `spread` of y and solved twice, the
    second time with weights from the first b.  The residual returned for each line is twice the weighted sum of
    squares, which is χ² distributed with 2(width - 4) degrees of freedom if the function fits.  `correlation`, shape
    (width,), is the correlation of the noise between frequency lines at distances 0, 1, ...; default: independent
    lines.
    Source: McKelvey & Guérin 2012; Sanathanan & Koerner 1963.
    """
    begin = np.clip(lines - width // 2, 0, x.size - width)
    place = begin[:, None] + np.arange(width)
    u = x[place] - x[lines][:, None]
    reach = np.max(np.abs(u), axis=1, keepdims=True)
    u = u / reach
    values = y[place]
    columns = np.stack([np.ones_like(u) + 0j, u + 0j, u * u + 0j, -u * values], axis=2)
    weight = 1.0 / spread[place]
    coefficients = np.zeros((lines.size, UNKNOWNS), complex)
    inverse = np.zeros((lines.size, UNKNOWNS, UNKNOWNS), complex)
    # the first solution weights lines by |1 + b u|², most where the denominator is largest: the second one removes that
    for turn in range(2):
        if turn:
            weight = weight / np.maximum(np.abs(1.0 + coefficients[:, 3:4] * u) ** 2, 1e-4)
        weighted = columns.conj() * weight[:, :, None]
        normal = weighted.transpose(0, 2, 1) @ columns
        scale = np.sqrt(np.abs(np.einsum("nii->ni", normal)))
        # columns of unit size, and a trace of 1e-12 where the lines do not determine all four
        normal = normal / (scale[:, :, None] * scale[:, None, :]) + 1e-12 * np.eye(UNKNOWNS)
        inverse = np.linalg.inv(normal) / (scale[:, :, None] * scale[:, None, :])
        coefficients = (inverse @ (weighted.transpose(0, 2, 1) @ values[:, :, None]))[:, :, 0]
    rest = values - (columns @ coefficients[:, :, None])[:, :, 0]
    residuals = 2.0 * np.sum(weight * np.abs(rest) ** 2, axis=1)
    if at == 0.0 and correlation is None:
        return coefficients[:, 0], np.real(inverse[:, 0, 0]), residuals
    v = at / reach[:, 0]
    below = 1.0 + coefficients[:, 3] * v
    value = (coefficients[:, 0] + coefficients[:, 1] * v + coefficients[:, 2] * v * v) / below
    slopes = np.stack([np.ones_like(v), v, v * v, -v * value], axis=1) / below[:, None]
    if correlation is None:
        return value, np.real(np.einsum("ni,nij,nj->n", slopes, inverse, np.conj(slopes))), residuals
    # the sensitivity of the value to each line, times the standard deviation of that line
    follows = np.einsum("ni,nij,nkj->nk", slopes, inverse, columns.conj() * weight[:, :, None])
    follows = follows * (1.0 + coefficients[:, 3:4] * u) * np.sqrt(spread[place])
    apart = np.arange(width)[:, None] - np.arange(width)
    alike = np.where(apart >= 0, correlation[np.abs(apart)], np.conj(correlation[np.abs(apart)]))
    variance = np.real(np.einsum("nk,kl,nl->n", follows, alike, np.conj(follows)))
    return value, variance, residuals

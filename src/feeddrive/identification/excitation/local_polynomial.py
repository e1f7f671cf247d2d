"""Frequency responses for arbitrary excitation by the local polynomial method, which suppresses leakage."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from feeddrive.identification.excitation.frequency_estimate import FrequencyEstimate
from feeddrive.identification.excitation.record import Record
from feeddrive.language.errors import LogError, ParameterError
from feeddrive.loop.frequency_response import FRF

ORDER = 2
_AT_ONCE = 4096  # lines whose small systems are solved together


def local_polynomial(
    records: Sequence[Record], *, band: tuple[float, float] | None = None, lines: int | None = None, freedom: int = 8
) -> FrequencyEstimate:
    """Frequency response around each line k from 2n + 1 lines, n = (6 + ν - 1)/2 rounded up.

        Y(k+i) = (g₀ + g₁ i + g₂ i²) U(k+i) + (t₀ + t₁ i + t₂ i²) + V(k+i),   i = -n .. n

    The response and the transient of the record, which is what leakage is, are smooth over a few lines; what they do
    not explain is noise, and its variance with ν degrees of freedom is that of the response.  With one reference both
    Y/R and U/R are estimated so, with their covariance, and their quotient holds in a closed loop.
    Several records are averaged with the weights that fit one noise in all of them.

    band     Hz; default: all lines
    lines    at most so many, spread logarithmically over the band; default: all
    freedom  ν: more is smoother and more certain, and blunter at resonances

    Responses of neighboring lines share data, so that their errors are correlated over 2n lines.
    When to use: chirps, steps, PRBS, noise, any motion.  When not: periods of a multisine in steady state.
    Source: Pintelon, Schoukens, Vandersteen & Barbé 2010, Mech. Syst. Signal Process. 24, 573; order 2.
    """
    if freedom < 1:
        raise ParameterError(f"freedom = {freedom} must be >= 1")
    if any(len(record.references) > 1 for record in records):
        raise ParameterError("the local polynomial method takes one reference; for several take method 'joint'")
    half = -(-(2 * (ORDER + 1) + freedom - 1) // 2)
    found: list[tuple[np.ndarray, ...]] = []
    first = records[0]
    chosen = _chosen(first, half, band, lines)
    frequency = chosen / (len(first) * first.sample_time)
    for record in records:
        if len(record) != len(first):
            raise LogError(
                f"{record.name}: has {len(record)} samples, {first.name} {len(first)}: cut them to one length"
            )
        found.append(_one(record, chosen, half))
    responses, gains, noises, explained, doubts = (np.array(each) for each in zip(*found, strict=True))
    weights = 1.0 / gains
    response = np.sum(weights * responses, axis=0) / np.sum(weights, axis=0)
    variance = np.mean(noises, axis=0) / np.sum(weights, axis=0)
    nu = float((2 * half + 1 - 2 * (ORDER + 1)) * len(records))
    coherence = np.clip(np.mean(explained, axis=0), 0.0, 1.0)
    frf = FRF(frequency, response, first.input_name, first.output_name, first.unit, first.sample_time,
              coherence, variance)  # fmt: skip
    text = (
        f"local polynomials of order {ORDER} over {2 * half + 1} lines of {1 / (len(first) * first.sample_time):.4g} Hz"
        + (", through the reference" if first.references else "")
    )
    remarks = tuple(remark for record in records for remark in record.remarks)
    estimate = FrequencyEstimate(
        frf, text, np.full(frequency.size, nu), variance, counts={"records": len(records)}, remarks=remarks
    )
    return estimate.where_told(np.max(doubts, axis=0))


def _chosen(record: Record, half: int, band: tuple[float, float] | None, lines: int | None) -> np.ndarray:
    """Numbers of the lines, so far from 0 Hz and Nyquist that all neighbors are there."""
    n = len(record)
    resolution = 1.0 / (n * record.sample_time)
    low, high = band or (0.0, record.nyquist)
    least, most = (
        max(half + 1, int(np.ceil(low / resolution * (1 - 1e-12)))),
        min((n - 1) // 2 - half, int(high / resolution * (1 + 1e-12))),
    )
    if most < least:
        raise LogError(
            f"{record.name}: no line of {resolution:.4g} Hz in {low:g} .. {high:g} Hz has {half} neighbors on each "
            f"side: record longer"
        )
    if lines is None or lines >= most - least + 1:
        return np.arange(least, most + 1)
    return np.unique(np.rint(np.geomspace(least, most, lines)).astype(int))


def _one(record: Record, chosen: np.ndarray, half: int) -> tuple[np.ndarray, ...]:
    """Response, its variance by unit noise, noise power, explained share, relative variance of U/R, of one record."""
    spectrum = {
        name: np.fft.rfft(values - values.mean()) for name, values in (("u", record.input), ("y", record.output))
    }
    cause = np.fft.rfft(record.references[0] - record.references[0].mean()) if record.references else spectrum["u"]
    parts: list[tuple[np.ndarray, ...]] = []
    for start in range(0, chosen.size, _AT_ONCE):
        k = chosen[start : start + _AT_ONCE, None] + np.arange(-half, half + 1)
        parts.append(_solved(cause[k], spectrum["u"][k], spectrum["y"][k], half, bool(record.references)))
    return tuple(np.concatenate(each) for each in zip(*parts, strict=True))


def _solved(cause: np.ndarray, u: np.ndarray, y: np.ndarray, half: int, closed: bool) -> tuple[np.ndarray, ...]:
    """The small systems of many lines at once: regressors (lines, 2n + 1, 6), outputs (lines, 2n + 1, 1 or 2)."""
    powers = (np.arange(-half, half + 1) / half)[:, None] ** np.arange(ORDER + 1)
    # the powers of the input side are scaled to 1, so that the systems are as good as their neighborhoods
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
            "the excitation holds too few lines for local polynomials: it is zero over a whole window"
        ) from None
    first = (np.conj(row).transpose(0, 2, 1) @ projected)[:, 0] / size[:, 0]
    gain = np.sum(np.abs(row[:, :, 0]) ** 2, axis=1) / size[:, 0, 0] ** 2
    power = np.mean(np.abs(y) ** 2, axis=1)
    if not closed:
        noise = np.sum(np.abs(rest[:, :, 0]) ** 2, axis=1) / nu
        return first[:, 0], gain, noise, 1.0 - np.mean(np.abs(rest[:, :, 0]) ** 2, axis=1) / power, np.zeros_like(gain)
    response = first[:, 0] / first[:, 1]
    noise = np.sum(np.abs(rest[:, :, 0] - response[:, None] * rest[:, :, 1]) ** 2, axis=1) / nu
    seen = 1.0 - np.mean(np.abs(rest) ** 2, axis=1) / np.stack([power, np.mean(np.abs(u) ** 2, axis=1)], axis=1)
    of_input = gain / np.abs(first[:, 1]) ** 2
    doubt = of_input * np.sum(np.abs(rest[:, :, 1]) ** 2, axis=1) / nu
    return response, of_input, noise, np.min(seen, axis=1), doubt

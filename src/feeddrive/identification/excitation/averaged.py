"""Frequency responses from averaged spectra (Welch): H1, H2, Hv, and estimators that are unbiased in closed loop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from feeddrive.identification.excitation.frequency_estimate import FrequencyEstimate
from feeddrive.identification.excitation.record import Record
from feeddrive.language.errors import LogError, ParameterError
from feeddrive.loop.frequency_response import FRF

METHODS = ("h1", "h2", "hv", "indirect", "joint")
AVERAGES = 16  # half-overlapping stretches that a record is cut into if no length is given


@dataclass(frozen=True, eq=False)
class Spectra:
    """Fourier transforms of windowed stretches: references (n, r), input and output (n,), for each of `lines`.

    All of shape (stretches, lines) or (stretches, references, lines); `averages` is how many independent stretches
    would give the same spread, fewer than there are where they overlap.
    """

    frequency: np.ndarray
    input: np.ndarray
    output: np.ndarray
    references: np.ndarray
    averages: float


def spectra(records: Sequence[Record], segment: int | None = None, overlap: float = 0.5) -> Spectra:
    """Hann-windowed transforms of stretches of `segment` samples, straight lines taken out, that overlap by a share.

    The spread of averages over overlapping stretches follows from the window alone (Welch 1967):
        1/averages = (1 + 2 Σⱼ (1 - j/n) ρⱼ²)/n,   ρⱼ = Σ w(t) w(t + jD)/Σ w²
    Raises LogError for records that are shorter than two stretches, ParameterError for an overlap outside 0..0.75.
    """
    if not 0.0 <= overlap <= 0.75:
        raise ParameterError(f"overlap = {overlap:g} must be >= 0 and <= 0.75 of a stretch")
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
    count = sum(each.shape[0] for each in columns[0])
    if count < 3:
        raise LogError(f"{count} stretches of {segment} samples are too few for a variance: at least 3")
    lags = np.arange(1, min(count, -(-segment // step)))
    shares = np.array([np.sum(window[: segment - j * step] * window[j * step :]) for j in lags]) / np.sum(window**2)
    averages = count / (1.0 + 2.0 * float(np.sum((1.0 - lags / count) * shares**2)))
    frequency = np.arange(1, segment // 2) / (segment * records[0].sample_time)
    made = [np.concatenate(each) for each in columns]
    return Spectra(frequency, made[0][:, 0], made[1][:, 0], made[2], averages)


def _level(pieces: np.ndarray) -> np.ndarray:
    """Without mean and straight line: a drift leaks over all lines."""
    t = np.arange(pieces.shape[-1]) - 0.5 * (pieces.shape[-1] - 1)
    slope = (pieces @ t) / np.sum(t * t)
    return pieces - pieces.mean(axis=-1, keepdims=True) - slope[..., None] * t


def averaged(
    records: Sequence[Record], method: str = "h1", *, segment: int | None = None, overlap: float = 0.5
) -> FrequencyEstimate:
    """Frequency response by Welch's averages, with ν = averages - 1 degrees of freedom.

        h1        S_yu/S_uu               noise at the output only               var = |G|² (1 - γ²)/(γ² ν)
        h2        S_yy/S_uy               noise at the input only                the same
        hv        √(S_yy/S_uu), phase of S_yu: equal shares of noise at both     var = |G|² (1 + γ⁻²)(1 - γ²)/(2ν)
        indirect  S_yr/S_ur               closed loop, one reference
        joint     Sₐy/Sₐa, a = U projected on all references: closed loop, any number of them
                                          var = S_vv/(ν' Sₐa), v = y - G u, with ν' = averages - references

    h1, h2 and hv of a closed loop are wrong: noise comes back through the control, and they lean to -1/C where it is
    large.  The coherence is that of input and output; for indirect and joint the smaller one of reference to input and
    reference to output.
    When not: short records and resonances narrower than a line of the stretches; take `local_polynomial`.
    Source: Bendat & Piersol 2010, chapter 9; Pintelon & Schoukens 2012, sections 2.6 and 2.7.
    """
    if method not in METHODS:
        raise ParameterError(f"method = {method!r} must be one of {', '.join(METHODS)}")
    found = spectra(records, segment, overlap)
    u, y, r = found.input, found.output, found.references
    closed = method in ("indirect", "joint")
    if closed and r.shape[1] == 0:
        raise ParameterError(f"method '{method}' needs a reference: what was added to the loop from outside")
    if method == "indirect" and r.shape[1] > 1:
        raise ParameterError(f"method 'indirect' takes one reference, not {r.shape[1]}; take 'joint'")
    if closed:
        response, variance, coherence, nu, doubt = _closed(u, y, r, found.averages)
    else:
        nu, doubt = found.averages - 1.0, np.zeros(found.frequency.size)
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
    frf = FRF(found.frequency, response, first.input_name, first.output_name, first.unit, first.sample_time,
              coherence, variance)  # fmt: skip
    length = 1.0 / (found.frequency[0] * first.sample_time)
    text = (
        f"{method}: {u.shape[0]} stretches of {length:.0f} samples, Hann window, {100 * overlap:g} % overlap, "
        f"worth {found.averages:.1f} independent ones"
    )
    remarks = tuple(remark for record in records for remark in record.remarks)
    estimate = FrequencyEstimate(
        frf, text, np.full(found.frequency.size, nu), variance, counts={"stretches": u.shape[0]}, remarks=remarks
    )
    return estimate.where_told(doubt)


def _closed(
    u: np.ndarray, y: np.ndarray, r: np.ndarray, averages: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float, np.ndarray]:
    """Response, variance, coherence, degrees of freedom and doubt, by what the references made of the input."""
    lines = r.transpose(2, 0, 1)  # (lines, stretches, references)
    nu = averages - lines.shape[2]
    if nu < 1.0:
        raise LogError(f"{averages:.1f} independent stretches do not tell {lines.shape[2]} references apart")
    base = np.linalg.qr(lines)[0]
    made = np.einsum("lsr,lr->sl", base, np.einsum("lsr,sl->lr", np.conj(base), u))
    power = np.mean(np.abs(made) ** 2, axis=0)
    response = np.mean(y * np.conj(made), axis=0) / power
    rest = np.mean(np.abs(y - response * u) ** 2, axis=0) * averages / nu
    answered = np.einsum("lsr,sl->lr", np.conj(base), y)
    of_input = power / np.mean(np.abs(u) ** 2, axis=0)
    of_output = np.sum(np.abs(answered) ** 2, axis=1) / np.sum(np.abs(y) ** 2, axis=0)
    coherence = np.clip(np.minimum(of_input, of_output), 0.0, 1.0)
    doubt = np.mean(np.abs(u - made) ** 2, axis=0) / (nu * power)
    return response, rest / (averages * power), coherence, nu, doubt

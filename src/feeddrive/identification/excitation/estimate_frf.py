"""Frequency responses from records; the estimator is selected by the kind of excitation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from feeddrive.identification.excitation.frequency_estimate import FrequencyEstimate
from feeddrive.identification.excitation.impacts import find_blows, impacts
from feeddrive.identification.excitation.nonperiodic import METHODS, averaged, local_polynomial
from feeddrive.identification.excitation.periodic import periodic
from feeddrive.identification.excitation.record import Record, find_period, repeating
from feeddrive.language.errors import LogError, ParameterError
from feeddrive.language.quantity import Quantity

ALL = ("auto", "periodic", "impact", "local_polynomial", *METHODS)
MOST_LINES = 2000  # of a local polynomial by default
_LEAST_PERIODS = 2  # one period has no scatter, and so no variance
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
             PRBS, noise), "h1", "h2", "hv", "indirect", "joint" (averaged spectra); "auto": periodic if what excites
             repeats itself in the record, impact if the input is short pulses from rest, else local polynomials
    band     lowest and highest frequency, Hz
    period   samples; default: found in the reference, or in the input if there is none
    skip     periods dropped at the start; default: by a test
    segment  samples of a stretch of averaged spectra, and `overlap` the share that two have in common
    lines    at most so many lines of the local polynomials; default: 2000

    In a closed loop give the reference, whatever the method: without it, noise that is fed back through the control
    counts as excitation.  Periodic records are the exception: noise averages out from period to period.
    Raises ParameterError for a method that is not known and for records that do not match each other, LogError for
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
    repetition = find_period(first.references[0] if first.references else first.input)
    return repetition if repetition is not None and min(map(len, records)) // repetition >= _LEAST_PERIODS else None


def _struck(records: Sequence[Record]) -> bool:
    """True if the input is hammer blows in every record."""
    return not any(record.references for record in records) and all(find_blows(record.input) for record in records)


def _steady(record: Record, period: int) -> Record:
    """Return the stretch in which the reference repeats, at least two periods; the whole record without a reference."""
    if not record.references:
        return record
    begin, end = repeating(record.references[0], period)
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
            f"band {low:g} .. {Quantity(high, 'Hz'):6} must rise and lie between 0 Hz and Nyquist, "
            f"{Quantity(record.nyquist, 'Hz'):6}"
        )


def within(estimate: FrequencyEstimate, band: tuple[float, float] | None) -> FrequencyEstimate:
    """Keep only the lines of a band. Raises ParameterError if there are none."""
    if band is None:
        return estimate
    f = estimate.frf
    kept = (f.frequency >= band[0] * (1.0 - 1e-9)) & (f.frequency <= band[1] * (1.0 + 1e-9))
    if not np.any(kept):
        raise ParameterError(
            f"no line lies in {band[0]:g} .. {Quantity(band[1], 'Hz'):6}: take longer segments, or excite this band"
        )
    return estimate.lines(kept)

"""The clock of a log: one sample time, no gap, no step back; or an error that says where and what to do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from feeddrive.language import units
from feeddrive.language.errors import LogError

LEAST_ROWS = 3
JITTER = 0.1  # of the sample time: the most by which a step may differ from it
GAP = 1.5  # of the sample time: a longer step has lost a sample
_BLOCK = 100_000  # rows that are looked at together
_SLOWEST, _FASTEST = 0.5, 1e-7  # s; a servo log outside is one in another unit


@dataclass(frozen=True)
class Clock:
    """Sample time in s, and the largest deviation of a step from it as a share of it."""

    sample_time: float
    jitter: float


def checked_clock(name: str, time: np.ndarray, place: Callable[[int], str], sample_time: float | None = None) -> Clock:
    """The clock of stamps in s, shape (n,).

    With a `sample_time` given, the stamps may be rounded, as long as none is off by half a sample.
    Raises LogError that names the file, the first bad row, its stamps, and what to do.
    """
    if time.size < LEAST_ROWS:
        raise LogError(f"{name}: has {time.size} row{'s' * (time.size != 1)}; a log needs at least {LEAST_ROWS}")
    if sample_time is not None:
        return _fitted(name, time, place, sample_time)
    steps = np.diff(time)
    back = np.flatnonzero(steps <= 0.0)
    if back.size:
        k = int(back[0])
        what = "stands still" if steps[k] == 0.0 else "runs backward"
        raise LogError(
            f"{name}: time {what} at {place(k + 1)}: {time[k]:.9g} s is followed by {time[k + 1]:.9g} s "
            f"({back.size} such rows); remove the repeated rows, or give the sample time if the stamps are only rounded"
        )
    usual = float(np.median(steps))
    gaps = np.flatnonzero(steps > GAP * usual)
    if gaps.size:
        k = int(gaps[0])
        raise LogError(
            f"{name}: a gap lies before {place(k + 1)}: {time[k]:.9g} s is followed by {time[k + 1]:.9g} s, "
            f"where the step is {usual:.6g} s ({gaps.size} such rows); "
            "cut the log there, or record it again without loss"
        )
    mean = float(time[-1] - time[0]) / (time.size - 1)
    deviation = np.divide(steps, mean, out=steps)  # in place: logs are large
    np.abs(np.subtract(deviation, 1.0, out=deviation), out=deviation)
    worst = int(np.argmax(deviation))
    if deviation[worst] > JITTER:
        k = int(np.argmax(deviation > JITTER))
        raise LogError(
            f"{name}: the clock is not uniform: the step to {place(k + 1)} is {time[k + 1] - time[k]:.6g} s, "
            f"the mean {mean:.6g} s; "
            "resample the log to a uniform clock, or give the sample time if the stamps are only rounded"
        )
    _check_plausible(name, mean)
    largest = float(deviation[worst])
    del deviation, steps
    return Clock(_decimal(mean, time), largest)


def _fitted(name: str, time: np.ndarray, place: Callable[[int], str], sample_time: float) -> Clock:
    _check_plausible(name, sample_time)
    off = (time - time[0]) / sample_time - np.arange(time.size)
    bad = np.flatnonzero(np.abs(off) >= 0.5)
    if bad.size:
        k = int(bad[0])
        raise LogError(
            f"{name}: with a sample time of {sample_time:.6g} s, {place(k)} should be at "
            f"{time[0] + k * sample_time:.9g} s, not at {time[k]:.9g} s; "
            "give the right sample time, or cut the log there"
        )
    return Clock(units.decimal(sample_time), float(np.max(np.abs(np.diff(off)))))


def _check_plausible(name: str, sample_time: float) -> None:
    if not _FASTEST <= sample_time <= _SLOWEST:
        raise LogError(
            f"{name}: a sample time of {sample_time:.6g} s is not one of a servo loop, {_FASTEST:g} to {_SLOWEST:g} s; "
            "is the time in another unit? Then say so, as in  time = { column = 't', unit = 'ms' }"
        )


def _decimal(mean: float, time: np.ndarray) -> float:
    """The shortest decimal that the stamps cannot tell from their mean step: 0.001, not 0.0010000000000002."""
    n = time.size
    scatter = max(
        float(np.max(np.abs(time[k : k + _BLOCK] - time[0] - mean * np.arange(k, min(k + _BLOCK, n)))))
        for k in range(0, n, _BLOCK)
    )
    for digits in range(1, 12):
        near = float(f"{mean:.{digits}g}")
        if abs(near - mean) * (n - 1) <= scatter + 1e-9 * mean * n:
            return near
    return units.decimal(mean)

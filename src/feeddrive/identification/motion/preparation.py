"""A log prepared for least squares: filtered, differentiated, aligned and decimated, stretch by stretch of motion."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from feeddrive.identification.motion.motion_log import MotionLog, checked
from feeddrive.language.errors import LogError, NotIdentifiableError, ParameterError
from feeddrive.language.quantity import Quantity

HOLD = 0.5  # samples: a force that is held from k to k+1 acts at k + 1/2 on average
_LEAST_ROWS = 40
_REST = 5e-3  # share of the largest speed below which the axis counts as at rest
_ORDER = 8  # of the decimating low pass
_ENDS = 3 * _ORDER  # samples by which it extends both ends
_SMEARED = 0.01  # of a step: what the low pass of the position may still show of a stop in a sample that counts


@dataclass(frozen=True, kw_only=True)
class Preparation:
    """The filters and delays that prepare a log for least squares.

    cutoff       Hz, of the Butterworth low pass on the position
    decimation   every so many samples are kept; None: one each 10 ms
    delay        samples from a logged force to the acceleration that it causes: 1/2 for the hold, and the dead time
    acceleration "second": (x(k+1) - 2 x(k) + x(k-1)) / T², which a held force fits exactly;
                 "twice": the central difference of the central difference
    skip         samples left out at each end, where the filters lack the continuation of the motion;
                 None: 5 periods of the cutoff
    skip_end     samples left out at the end; None: as many as at the start
    reversals    whether rows at rest and within one decimated step of a reversal are kept: the sign of friction is not
                 defined there

    Without `reversals` the decimating low pass runs over each stretch of motion by itself.  At rest friction holds any
    force, and a low pass over the whole log spreads it over some 70 ms to both sides, where the mass is to be seen.
    A stretch ends where the low pass of the position no longer shows the stop by more than 1 % (`reach`).
    """

    cutoff: float = 100.0
    decimation: int | None = None
    delay: float = HOLD
    acceleration: str = "second"
    skip: int | None = None
    skip_end: int | None = None
    reversals: bool = False


# What Janot, Gautier & Brunot 2019 do.  A force is assumed to act at its sample instant, not over the time that it is
# held; docs/identification.md states the resulting error.
JANOT = Preparation(delay=0.0, acceleration="twice", skip=49, skip_end=0, decimation=10, reversals=True)


@dataclass(frozen=True, eq=False)
class Prepared:
    """The rows that count: time in s, and the filtered, decimated channels, each of shape (n,).

    filtered    velocity at each sample of the log, before it was decimated
    constant    of 1, which the ripple of the filter reduces a little
    places      sample numbers of the rows in the log
    stretches   samples of the log that were filtered, each by itself
    cutoff      Hz, of the position's low pass; sample_time in s of the log; how it was prepared
    """

    time: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    constant: np.ndarray
    force: np.ndarray
    filtered: np.ndarray
    decimation: int
    places: np.ndarray
    stretches: tuple[slice, ...]
    cutoff: float
    sample_time: float
    how: Preparation

    def reduced(self, values: np.ndarray) -> np.ndarray:
        """Prepare values at each sample of the log as the force is; the samples are the last axis."""
        return _reduced(values, self.stretches, self.places, self.decimation)

    def force_with(self, force: np.ndarray, delay: float) -> np.ndarray:
        """Return another force of the same log in these rows, so many samples later."""
        return self.reduced(delayed(force, delay))

    def errors(self, position: np.ndarray) -> np.ndarray:
        """Return the effect of errors of the position (m, at each sample) on acceleration and
        velocity, shape (2, n).
        """
        velocity, acceleration = _differenced(position, self.cutoff, self.sample_time, self.how)
        return self.reduced(np.array([acceleration, velocity]))


def prepare(log: MotionLog, how: Preparation) -> Prepared:
    """Prepare the rows of least squares. Raises LogError for a log that is too short for its filters, ParameterError
    for anything but a MotionLog.
    """
    checked(log)
    T = log.sample_time
    if how.acceleration not in ("second", "twice"):
        raise ParameterError(f"acceleration = {how.acceleration!r} must be 'second' or 'twice'")
    factor = how.decimation if how.decimation is not None else max(1, round(0.01 / T))
    cutoff = min(how.cutoff, 0.4 / T)
    velocity, acceleration = _differenced(log.position, cutoff, T, how)
    skip = round(5.0 / (cutoff * T)) if how.skip is None else how.skip
    end = skip if how.skip_end is None else how.skip_end
    rows = slice(skip, max(skip, log.position.size - end))
    samples = len(range(*rows.indices(log.position.size)))
    if samples < _LEAST_ROWS * factor:
        raise LogError(
            f"{log.name}: {samples} samples are left of {log.position.size} after the ends are cut; "
            f"{_LEAST_ROWS * factor} are needed: the log is {Quantity(log.position.size * T, 's'):3 SI} long as its "
            "time was read; state the unit if it is another, as --time 't:s', else record "
            f"{Quantity((_LEAST_ROWS * factor - samples) * T, 's'):3 SI} more"
        )
    places = skip + kept(samples, factor)
    stretches: tuple[slice, ...] = (rows,)
    if not how.reversals:
        stretches = _stretches(velocity, slice(*rows.indices(velocity.size)), reach(cutoff * T))
        within = np.zeros(velocity.size, dtype=bool)
        for stretch in stretches:
            within[stretch] = True
        places = places[_away(velocity, places, factor) & within[places]]
    if places.size < _LEAST_ROWS:
        raise NotIdentifiableError(
            f"{log.name}: {places.size} of {-(-samples // factor)} rows are left where the axis moves, more than "
            f"{Quantity(factor * T, 's'):3 SI} away from each reversal; {_LEAST_ROWS} are needed: the axis rests, "
            "vibrates or reverses too often; record next moves to and fro that keep their direction for "
            f"{Quantity(4 * factor * T, 's'):2 SI}"
        )
    channels = np.array([velocity, acceleration, np.ones_like(velocity), delayed(log.force, how.delay)])
    slow, changes, constant, applied = _reduced(channels, stretches, places, factor)
    return Prepared(places * T, slow, changes, constant, applied, velocity, factor, places, stretches, cutoff, T, how)


def _differenced(values: np.ndarray, cutoff: float, T: float, how: Preparation) -> tuple[np.ndarray, np.ndarray]:
    """Return velocity and acceleration of positions behind their low pass."""
    position = zero_phase(values, cutoff, T)
    velocity = central_difference(position, T)
    acceleration = central_difference(velocity, T)
    if how.acceleration == "second":
        acceleration[1:-1] = np.diff(position, 2) / (T * T)
    return velocity, acceleration


def _stretches(velocity: np.ndarray, rows: slice, reach: int) -> tuple[slice, ...]:
    """Return the runs of samples in motion that keep `reach` samples away from each rest, long enough for their low
    pass.
    """
    moves = np.abs(velocity) > _REST * np.max(np.abs(velocity))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], moves, [False]]).astype(np.int8)))
    stretches = []
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        first = max(rows.start, begin + reach if begin else 0)
        last = min(rows.stop, end - reach if end < velocity.size else end)
        if last - first > _ENDS:
            stretches.append(slice(int(first), int(last)))
    return tuple(stretches)


def _reduced(values: np.ndarray, stretches: tuple[slice, ...], places: np.ndarray, factor: int) -> np.ndarray:
    """Return values at the rows `places`, after the decimating low pass over each stretch separately."""
    parts = []
    for stretch in stretches:
        own = places[slice(*np.searchsorted(places, (stretch.start, stretch.stop)))] - stretch.start
        parts.append(_decimating(values[..., stretch], factor)[..., own])
    return np.concatenate(parts, axis=-1) if parts else values[..., :0]


@lru_cache(maxsize=32)
def reach(cutoff: float) -> int:
    """Return the samples after which the position's low pass shows a step by at most `_SMEARED`; the cutoff is in
    1/sample.

        the largest d with |Σ_{k >= d} h(k)| > 1 %,   h: impulse response of both passes

    12 ms at 100 Hz and samples of a millisecond.
    """
    around = round(5.0 / cutoff)
    impulse = np.zeros(2 * around + 1)
    impulse[around] = 1.0
    left = np.abs(np.cumsum(zero_phase(impulse, cutoff, 1.0)[::-1])[::-1])[around:]
    return int(np.flatnonzero(left > _SMEARED)[-1])


def delayed(values: np.ndarray, samples: float) -> np.ndarray:
    """Return values as they were so many samples before, interpolated linearly, held at the ends."""
    k = np.arange(values.size, dtype=np.float64)
    return values if samples == 0.0 else np.interp(k - samples, k, values)


def _away(velocity: np.ndarray, places: np.ndarray, factor: int) -> np.ndarray:
    """True for rows that are more than a decimated step away from every change of direction, rest included."""
    turns = np.flatnonzero(np.diff(np.sign(velocity)) != 0.0)
    if not turns.size:
        return np.ones(places.size, dtype=bool)
    after = np.searchsorted(turns, places)
    left = places - turns[np.maximum(after - 1, 0)]
    right = turns[np.minimum(after, turns.size - 1)] - places
    return np.minimum(np.abs(left), np.abs(right)) > factor


def zero_phase(values: np.ndarray, cutoff: float, sample_time: float, order: int = 4) -> np.ndarray:
    """Apply a Butterworth low pass of `order`, forward and backward, so that there is no delay; `cutoff` in Hz.

        gain of both passes = 1 / (1 + (f / cutoff)^(2 order)),   1/2 at the cutoff

    Both ends are extended by 3 `order` samples, reflected about the end point, as in MATLAB's filtfilt.
    Raises ParameterError for a cutoff that is not below half the sampling rate, LogError for a log that is too short.
    """
    nyquist = 0.5 / sample_time
    if not 0.0 < cutoff < nyquist:
        raise ParameterError(
            f"cutoff = {Quantity(cutoff, 'Hz'):6} must be > 0 Hz and < {Quantity(nyquist, 'Hz'):6}, half the sampling "
            "rate"
        )
    from scipy.signal import butter  # takes a second to import

    return _forth_and_back(butter(order, cutoff / nyquist, output="sos"), order, values)


def central_difference(values: np.ndarray, sample_time: float) -> np.ndarray:
    """Return (x(k+1) - x(k-1)) / 2T, one-sided at both ends."""
    return np.gradient(values, sample_time)


def decimated(values: np.ndarray, factor: int) -> np.ndarray:
    """Return every `factor`-th sample of the last axis after an anti-aliasing low pass; the last sample is kept.

    The low pass is that of MATLAB's decimate: Chebyshev of first kind, order 8, ripple 0.05 dB, edge 0.8 / factor of
    the half sampling rate, forward and backward.
    """
    if factor < 1:
        raise ParameterError(f"decimation = {factor} must be >= 1")
    if factor == 1:
        return values
    return _decimating(values, factor)[..., kept(values.shape[-1], factor)]


def _decimating(values: np.ndarray, factor: int) -> np.ndarray:
    """Apply the low pass of `decimated` over the last axis."""
    return values if factor == 1 else _forth_and_back(_chebyshev(factor), _ORDER, values)


@lru_cache(maxsize=32)
def _chebyshev(factor: int) -> Any:
    from scipy.signal import cheby1  # takes a second to import

    return np.asarray(cheby1(_ORDER, 0.05, 0.8 / factor, output="sos"))


def kept(samples: int, factor: int) -> np.ndarray:
    """Return the indices of the samples that decimation keeps."""
    rows = -(-samples // factor)
    return np.arange(samples - factor * (rows - 1) - 1, samples, factor)


def _forth_and_back(sections: Any, order: int, values: np.ndarray) -> np.ndarray:
    """Filter in second-order sections: as one polynomial, rounding makes the low pass of a log at 20 kHz unstable."""
    ends = 3 * order
    if values.shape[-1] <= ends:
        raise LogError(
            f"the log has {values.shape[-1]} samples; its filter needs more than {ends}: record a longer one"
        )
    from scipy.signal import sosfiltfilt  # takes a second to import

    return sosfiltfilt(sections, values, padlen=ends)

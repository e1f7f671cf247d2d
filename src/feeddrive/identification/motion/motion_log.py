"""The input of an identification: position and force over time, checked, filtered, differentiated and aligned."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from feeddrive.identification.estimate import TABLE, TURNING, Frame, frame_of
from feeddrive.identification.regression import short_runs, strays_said
from feeddrive.language.errors import LogError, NotIdentifiableError, ParameterError

LEAST_ROWS = 100
LARGEST = 1e100  # in SI: its square does not overflow
_USUAL_SHARE = 0.99  # of the rows, whose largest force is the usual one
_NEAR, _AROUND, _NOISE = 9, 61, 8.0  # rows of the medians about a spike; standard deviations that it exceeds
_SPIKE = 5.0  # times the usual force: no real force peak is so short and so high
_JUMP = 3.0  # usual steps by which a row of a position leaves its neighbors
_JUMP_TRAVEL = 1e-3  # of the travel, the least that counts
_BEYOND = 1.05  # times its limit, beyond which a force was not commanded under that limit
_SPIKE_ROWS = 3  # samples that a spike lasts at most
MOST_SATURATED = 0.01  # share of the samples that may sit at the largest force


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionLog:
    """Position (m, or rad of a shaft) and commanded force (N, or N m) on one clock, each of shape (n,).

    set_position  setpoint of the loop, if it was logged
    force_limit   N or N m, if it is known
    rotary        position in rad and force in N m
    turning       of those: it is the axis itself that turns, and no shaft in front of a screw

    Raises LogError for a channel that is not finite or of another length, and NotIdentifiableError for a channel that
    does not change or a force that stays at its limit.
    """

    name: str
    position: np.ndarray
    force: np.ndarray
    sample_time: float
    set_position: np.ndarray | None = None
    force_limit: float | None = None
    rotary: bool = False
    turning: bool = False

    def __post_init__(self) -> None:
        if not (np.isfinite(self.sample_time) and self.sample_time > 0.0):
            raise ParameterError(f"{self.name}: sample_time = {self.sample_time:g} s must be > 0 s")
        for channel in ("position", "force", "set_position"):
            values = getattr(self, channel)
            if values is not None:
                object.__setattr__(self, channel, self._checked(channel, np.asarray(values, dtype=np.float64)))
        if self.position.size < LEAST_ROWS:
            raise LogError(f"{self.name}: has {self.position.size} rows; identification needs at least {LEAST_ROWS}")
        self._check_saturation()
        self._check_spikes()
        self._check_jumps()

    @property
    def frame(self) -> Frame:
        """Units of a table, of a shaft, or of an axis that turns."""
        return TURNING if self.turning else frame_of(self.rotary)

    @property
    def micro(self) -> str:
        """The unit in which residuals of the position are shown, a millionth of its own."""
        return "um" if self.frame is TABLE else "urad"

    def _checked(self, channel: str, values: np.ndarray) -> np.ndarray:
        if values.ndim != 1 or values.size != np.size(self.position):
            raise LogError(f"{self.name}: '{channel}' has {values.size} rows, position has {np.size(self.position)}")
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise LogError(
                f"{self.name}: '{channel}' is {values[bad[0]]} at row {int(bad[0]) + 1} ({bad.size} such rows); "
                f"cut the log there or repair the row"
            )
        if np.max(np.abs(values)) > LARGEST:
            raise LogError(
                f"{self.name}: '{channel}' reaches {np.max(np.abs(values)):.3g}, beyond {LARGEST:g}: check the column "
                f"and its unit"
            )
        if np.ptp(values) == 0.0:
            raise NotIdentifiableError(
                f"{self.name}: '{channel}' is {values[0]:.6g} in all rows: it was not recorded, or nothing moved; "
                f"record a move to and fro with its {channel}"
            )
        return values

    def _check_saturation(self) -> None:
        """A saturated force is not the force that acted on the axis."""
        force = self.force
        most = float(np.max(np.abs(force))) if self.force_limit is None else self.force_limit
        largest = float(np.max(np.abs(force)))
        if largest > _BEYOND * most:
            unit = self.frame.force
            raise NotIdentifiableError(
                f"{self.name}: the force reaches {largest:.5g} {unit}, beyond the limit of {most:.5g} {unit} that the "
                f"machine has: one of the two is wrong; check the unit or factor of the force, and the force limit and "
                f"axis of the machine file"
            )
        there = np.abs(force) >= most * (1.0 - 1e-9)
        held = there[1:] & there[:-1]  # a peak reaches its value once; a limit holds it over several samples
        share = float(np.mean(held))
        if share > MOST_SATURATED:
            unit = self.frame.force
            raise NotIdentifiableError(
                f"{self.name}: the force sits at {most:.5g} {unit} in {100.0 * share:.3g} % of the rows (at most "
                f"{100.0 * MOST_SATURATED:g} % are admitted): the drive or its recorder is saturated, and what acted "
                f"on the axis is not known; repeat the motion with a lower acceleration, or with a wider recorder range"
            )

    def _check_spikes(self) -> None:
        """Spikes: single samples of a force that no drive commands, from a broken line or a recorder."""
        size = np.abs(self.force)
        most = float(np.quantile(size, _USUAL_SHARE))
        beyond = size > _SPIKE * most
        starts = np.flatnonzero(beyond & ~np.concatenate([[False], beyond[:-1]]))
        if most > 0.0 and starts.size and int(np.sum(beyond)) <= _SPIKE_ROWS * starts.size:
            k = int(starts[np.argmax(size[starts])])
            raise NotIdentifiableError(
                f"{self.name}: the force has {starts.size} spike{'s' * (starts.size != 1)}, the largest of "
                f"{self.force[k]:.4g} {self.frame.force} at row {k + 1} ({k * self.sample_time:.4g} s), where "
                f"{100.0 * _USUAL_SHARE:g} % of the log stay within {most:.4g} {self.frame.force}: no mass reacts "
                "to them; repair these rows, or cut the log there"
            )

    def _check_jumps(self) -> None:
        """Rows of a position that leave their neighbors and come back at once: an encoder line, not the axis.

        A position that rises or falls steadily is its own median, so that only reversals and noise depart from it:

            |x - median9(x)| > 3 · usual step, which 99 % of the steps from row to row do not exceed,
                               and > 1e-3 of the travel: jumps of a few counts in a slow run stay
        """
        steps = np.abs(np.diff(self.position))
        usual = float(np.quantile(steps, _USUAL_SHARE))
        least = max(_JUMP * usual, _JUMP_TRAVEL * float(np.ptp(self.position)))
        if float(np.max(steps)) <= least:
            return
        from scipy.ndimage import median_filter  # not for commands that only read

        away = np.abs(self.position - median_filter(self.position, _NEAR, mode="nearest"))
        found = short_runs(away > least, _SPIKE_ROWS)
        if np.any(found):
            k = int(np.argmax(np.where(found, away, 0.0)))
            unit = self.frame.position
            raise NotIdentifiableError(
                f"{self.name}: the position has {int(np.sum(found))} jump{'s' * (int(np.sum(found)) != 1)} there and "
                f"back, the largest to {self.position[k]:.4g} {unit} at row {k + 1} ({k * self.sample_time:.4g} s), "
                f"{away[k]:.4g} {unit} off its neighbors, where {100.0 * _USUAL_SHARE:g} % of the steps stay within "
                f"{usual:.4g} {unit}: no axis moves so; repair these rows, or cut the log there"
            )

    def without_spikes(self) -> tuple[MotionLog, tuple[str, ...]]:
        """The log with the mean of the neighbors in place of lesser spikes of the force, and a remark on them.

        A spike lasts three samples at most and is away from the median of 9 rows by more than the usual force F, within
        which 99 % of the rows stay, and by 8 standard deviations of the 61 rows around it:

            d = |f - median9(f)| > max(F, 8 · 1.4826 median61(d))

        No axis answers so short a force visibly, and a drive that really commanded it would not be fitted otherwise.
        """
        from scipy.ndimage import median_filter  # not for commands that only read

        away = np.abs(self.force - median_filter(self.force, _NEAR, mode="nearest"))
        spread = 1.4826 * median_filter(away, min(_AROUND, away.size), mode="nearest")
        usual = float(np.quantile(np.abs(self.force), _USUAL_SHARE))
        found = short_runs(away > np.maximum(usual, _NOISE * spread), _SPIKE_ROWS)
        if not np.any(found):
            return self, ()
        rows, there = np.flatnonzero(~found), np.flatnonzero(found)
        force = self.force.copy()
        force[there] = np.interp(there, rows, self.force[rows])
        return replace(self, force=force), strays_said(f"{self.name}, force", self.force, found, self.frame.force)


HOLD = 0.5  # samples: a force that is held from k to k+1 acts at k + 1/2 on average
_LEAST_ROWS = 40
_REST = 5e-3  # share of the largest speed below which the axis counts as at rest


@dataclass(frozen=True, kw_only=True)
class Preparation:
    """How a log is prepared.

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
    """The rows that count: time in s, and what was filtered and decimated, each of shape (n,).

    filtered    velocity at each sample of the log, before it was decimated
    constant    of 1, which the ripple of the filter reduces a little
    places      sample numbers of the rows in the log
    rows        samples of the log that were filtered
    """

    time: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    constant: np.ndarray
    force: np.ndarray
    filtered: np.ndarray
    decimation: int
    places: np.ndarray
    rows: slice

    def reduced(self, values: np.ndarray) -> np.ndarray:
        """Values at each sample of the log, prepared as the force is."""
        few = decimated(values[self.rows], self.decimation)
        after = (self.rows.stop - 1 - int(self.places[-1])) // self.decimation  # rows after the last one that counts
        return few[(self.places - self.places[-1]) // self.decimation + few.size - 1 - after]

    def force_with(self, force: np.ndarray, delay: float) -> np.ndarray:
        """Another force of the same log, or the same with another delay, in these rows."""
        return self.reduced(delayed(force, delay))


def checked(log: MotionLog) -> MotionLog:
    """The log. Raises ParameterError, with what to write, for what is no MotionLog."""
    if not isinstance(log, MotionLog):  # pyright: ignore[reportUnnecessaryIsInstance]  what `read_log` gives is tempting
        raise ParameterError(
            f"identification takes a MotionLog, not a {type(log).__name__}: MotionLog(name=log.name, position=log["
            "'position_load'], force=log['force'], set_position=log['setpoint_position'], sample_time=log.sample_time)"
        )
    return log


def prepare(log: MotionLog, how: Preparation) -> Prepared:
    """The rows of least squares. Raises LogError for a log that is too short for its filters, ParameterError for one
    that is no MotionLog.
    """
    checked(log)
    T = log.sample_time
    if how.acceleration not in ("second", "twice"):
        raise ParameterError(f"acceleration = {how.acceleration!r} must be 'second' or 'twice'")
    factor = how.decimation if how.decimation is not None else max(1, round(0.01 / T))
    cutoff = min(how.cutoff, 0.4 / T)
    position = zero_phase(log.position, cutoff, T)
    velocity = central_difference(position, T)
    acceleration = central_difference(velocity, T)
    if how.acceleration == "second":
        acceleration[1:-1] = np.diff(position, 2) / (T * T)
    skip = round(5.0 / (cutoff * T)) if how.skip is None else how.skip
    end = skip if how.skip_end is None else how.skip_end
    rows = slice(skip, max(skip, log.position.size - end))
    samples = len(range(*rows.indices(log.position.size)))
    if samples < _LEAST_ROWS * factor:
        raise LogError(
            f"{log.name}: {samples} samples are left of {log.position.size} after the ends are cut; "
            f"{_LEAST_ROWS * factor} are needed: the log is {log.position.size * T:.3g} s long as its time was read; "
            f"state the unit if it is another, as --time 't:s', else record {(_LEAST_ROWS * factor - samples) * T:.3g} "
            "s more"
        )
    channels = (velocity, acceleration, np.ones_like(velocity), delayed(log.force, how.delay))
    few = [decimated(channel[rows], factor) for channel in channels]
    places = skip + kept(samples, factor)
    stays = np.ones(places.size, dtype=bool)
    if not how.reversals:
        moves = np.abs(velocity[places]) > _REST * np.max(np.abs(velocity))
        stays = _away(velocity, places, factor) & moves
    if np.count_nonzero(stays) < _LEAST_ROWS:
        raise NotIdentifiableError(
            f"{log.name}: {np.count_nonzero(stays)} of {stays.size} rows are left where the axis moves, more than "
            f"{factor * T:.3g} s away from each reversal; {_LEAST_ROWS} are needed: the axis rests, vibrates or "
            f"reverses too often; record next moves to and fro that keep their direction for {4 * factor * T:.2g} s"
        )
    slow, changes, constant, applied = (channel[stays] for channel in few)
    return Prepared(places[stays] * T, slow, changes, constant, applied, velocity, factor, places[stays], rows)


def delayed(values: np.ndarray, samples: float) -> np.ndarray:
    """Values as they were so many samples before, straight lines between samples, held at the ends."""
    k = np.arange(values.size, dtype=np.float64)
    return values if samples == 0.0 else np.interp(k - samples, k, values)


def _away(velocity: np.ndarray, places: np.ndarray, factor: int) -> np.ndarray:
    """Rows that are more than a decimated step away from every change of direction, rest included."""
    turns = np.flatnonzero(np.diff(np.sign(velocity)) != 0.0)
    if not turns.size:
        return np.ones(places.size, dtype=bool)
    after = np.searchsorted(turns, places)
    left = places - turns[np.maximum(after - 1, 0)]
    right = turns[np.minimum(after, turns.size - 1)] - places
    return np.minimum(np.abs(left), np.abs(right)) > factor


def zero_phase(values: np.ndarray, cutoff: float, sample_time: float, order: int = 4) -> np.ndarray:
    """A Butterworth low pass of `order`, forward and backward, so that there is no delay; `cutoff` in Hz.

        gain of both passes = 1 / (1 + (f / cutoff)^(2 order)),   1/2 at the cutoff

    Both ends are extended by 3 `order` samples, reflected about the end point, as in MATLAB's filtfilt.
    Raises ParameterError for a cutoff that is not below half the sampling rate, LogError for a log that is too short.
    """
    nyquist = 0.5 / sample_time
    if not 0.0 < cutoff < nyquist:
        raise ParameterError(f"cutoff = {cutoff:g} Hz must be > 0 Hz and < {nyquist:g} Hz, half the sampling rate")
    from scipy.signal import butter  # takes a second to import

    return _forth_and_back(butter(order, cutoff / nyquist, output="sos"), order, values)


def central_difference(values: np.ndarray, sample_time: float) -> np.ndarray:
    """(x(k+1) - x(k-1)) / 2T, one-sided at both ends."""
    return np.gradient(values, sample_time)


def decimated(values: np.ndarray, factor: int) -> np.ndarray:
    """Every `factor`-th sample after an anti-aliasing low pass; the last sample is kept.

    The low pass is that of MATLAB's decimate: Chebyshev of first kind, order 8, ripple 0.05 dB, edge 0.8 / factor of
    the half sampling rate, forward and backward.
    """
    if factor < 1:
        raise ParameterError(f"decimation = {factor} must be >= 1")
    if factor == 1:
        return values
    from scipy.signal import cheby1  # takes a second to import

    smooth = _forth_and_back(cheby1(8, 0.05, 0.8 / factor, output="sos"), 8, values)
    return smooth[kept(values.size, factor)]


def kept(samples: int, factor: int) -> np.ndarray:
    """Indices of the samples that decimation keeps."""
    rows = -(-samples // factor)
    return np.arange(samples - factor * (rows - 1) - 1, samples, factor)


def _forth_and_back(sections: Any, order: int, values: np.ndarray) -> np.ndarray:
    """In sections of second order: as one polynomial the low pass of a log at 20 kHz is unstable by rounding."""
    ends = 3 * order
    if values.size <= ends:
        raise LogError(f"the log has {values.size} samples; its filter needs more than {ends}: record a longer one")
    from scipy.signal import sosfiltfilt  # takes a second to import

    return sosfiltfilt(sections, values, padlen=ends)

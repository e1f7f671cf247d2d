"""From a motion log to the rows of least squares: which filters, and which force belongs to which acceleration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from feeddrive.identification.motion.conditioning import central_difference, decimated, kept, zero_phase
from feeddrive.identification.motion.motion_log import MotionLog
from feeddrive.language.errors import LogError, ParameterError

HOLD = 0.5  # samples: a force that is held from k to k+1 acts at k + 1/2 on average
_LEAST_ROWS = 40
_REST = 5e-3  # share of the largest speed below which friction is not that of motion


@dataclass(frozen=True, kw_only=True)
class Preparation:
    """How a log is prepared.

    cutoff       Hz, of the Butterworth low pass on the position
    decimation   every so many samples stay; None: one each 10 ms
    delay        samples from a logged force to the acceleration that it causes: 1/2 for the hold, and the dead time
    acceleration "second": (x(k+1) - 2 x(k) + x(k-1)) / T², which a held force fits exactly;
                 "twice": the central difference of the central difference
    skip         samples left out at each end, where the filters do not know how the motion went on;
                 None: 5 periods of the cutoff
    skip_end     samples left out at the end; None: as many as at the start
    reversals    whether rows within one decimated step of a reversal, and at rest, stay: there friction is no number
    """

    cutoff: float = 100.0
    decimation: int | None = None
    delay: float = HOLD
    acceleration: str = "second"
    skip: int | None = None
    skip_end: int | None = None
    reversals: bool = False


# What Janot, Gautier & Brunot 2019 do.  A force is taken to act at its own sample, not over the sample that it is held;
# docs/identification.md says what that costs.
JANOT = Preparation(delay=0.0, acceleration="twice", skip=49, skip_end=0, decimation=10, reversals=True)


@dataclass(frozen=True, eq=False)
class Prepared:
    """Decimated velocity, acceleration, its friction columns and force of the rows that count, each of shape (n,)."""

    time: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    forward: np.ndarray  # 1 in forward motion, 0 else
    backward: np.ndarray  # 1 in backward motion, 0 else
    velocity_forward: np.ndarray
    velocity_backward: np.ndarray
    constant: np.ndarray  # of 1, which the filter's ripple makes a little less
    force: np.ndarray
    decimation: int
    places: np.ndarray  # samples of the log at which the rows stand
    rows: slice  # samples of the log that were filtered

    def force_with(self, force: np.ndarray, delay: float) -> np.ndarray:
        """Another force of the same log, or the same with another delay, in these rows."""
        few = decimated(delayed(force, delay)[self.rows], self.decimation)
        return few[(self.places - self.places[-1]) // self.decimation + few.size - 1 - self._after()]

    def _after(self) -> int:
        """Rows that were left out after the last one that counts."""
        return (self.rows.stop - 1 - int(self.places[-1])) // self.decimation

    @property
    def direction(self) -> np.ndarray:
        """sign(v), prepared as the force is."""
        return self.forward - self.backward


def prepare(log: MotionLog, how: Preparation) -> Prepared:
    """The rows of least squares. Raises LogError for a log that is too short for its filters, ParameterError for one
    that is no MotionLog.
    """
    if not isinstance(log, MotionLog):  # pyright: ignore[reportUnnecessaryIsInstance]  what `read_log` gives is tempting
        raise ParameterError(
            f"identification takes a MotionLog, not a {type(log).__name__}: MotionLog(name=log.name, position=log["
            "'position_load'], force=log['force'], set_position=log['setpoint_position'], sample_time=log.sample_time)"
        )
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
            f"{_LEAST_ROWS * factor} are needed: record {(_LEAST_ROWS * factor - samples) * T:.3g} s more"
        )
    forward, backward = np.where(velocity > 0.0, 1.0, 0.0), np.where(velocity < 0.0, 1.0, 0.0)
    force = delayed(log.force, how.delay)
    channels = (velocity, acceleration, forward, backward, velocity * forward, velocity * backward,
                np.ones_like(velocity), force)  # fmt: skip
    few = [decimated(channel[rows], factor) for channel in channels]
    places = skip + kept(samples, factor)
    stays = np.ones(places.size, dtype=bool)
    if not how.reversals:
        moves = np.abs(velocity[places]) > _REST * np.max(np.abs(velocity))
        stays = _away(velocity, places, factor) & moves
    return Prepared(
        places[stays] * T, *(channel[stays] for channel in few), decimation=factor, places=places[stays], rows=rows
    )


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

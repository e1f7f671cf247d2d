"""The input of an identification: position and force over time, checked for errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from feeddrive.identification.estimate import Frame, frame_of
from feeddrive.language.errors import LogError, NotIdentifiableError, ParameterError

LEAST_ROWS = 100
LARGEST = 1e100  # in SI: squares of it are still numbers
_USUAL_SHARE = 0.99  # of the rows, whose largest force is the usual one
_SPIKE = 5.0  # times the usual force: a drive's own peaks are not so short and so high
_SPIKE_ROWS = 3  # samples that a spike lasts at most
MOST_SATURATED = 0.01  # share of the samples that may sit at the largest force


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionLog:
    """Position (m, or rad of a shaft) and commanded force (N, or N m) on one clock, each of shape (n,).

    set_position  setpoint of the loop, if it was logged
    force_limit   N or N m, if it is known
    rotary        position in rad and force in N m

    Raises LogError for a channel that is not finite or of another length, and NotIdentifiableError for one that does
    not change or whose force sits at its limit.
    """

    name: str
    position: np.ndarray
    force: np.ndarray
    sample_time: float
    set_position: np.ndarray | None = None
    force_limit: float | None = None
    rotary: bool = False

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

    @property
    def frame(self) -> Frame:
        """Units of a table or of a shaft."""
        return frame_of(self.rotary)

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
        """Force that sits at its largest value is not what the axis would have been given."""
        force = self.force
        most = float(np.max(np.abs(force))) if self.force_limit is None else self.force_limit
        there = np.abs(force) >= most * (1.0 - 1e-9)
        held = there[1:] & there[:-1]  # a peak touches once; a limit holds
        share = float(np.mean(held))
        if share > MOST_SATURATED:
            unit = self.frame.force
            raise NotIdentifiableError(
                f"{self.name}: the force sits at {most:.5g} {unit} in {100.0 * share:.3g} % of the rows (at most "
                f"{100.0 * MOST_SATURATED:g} % are admitted): the drive or its recorder is saturated, and what acted "
                f"on the axis is not known; repeat the motion with a lower acceleration, or with a wider recorder range"
            )

    def _check_spikes(self) -> None:
        """Single samples of a force that no drive commands, from a broken line or a recorder: least squares follow."""
        size = np.abs(self.force)
        most = float(np.quantile(size, _USUAL_SHARE))
        beyond = size > _SPIKE * most
        starts = np.flatnonzero(beyond & ~np.concatenate([[False], beyond[:-1]]))
        if most > 0.0 and starts.size and int(np.sum(beyond)) <= _SPIKE_ROWS * starts.size:
            k = int(starts[np.argmax(size[starts])])
            raise NotIdentifiableError(
                f"{self.name}: the force has {starts.size} spike{'s' * (starts.size != 1)}, the largest of "
                f"{self.force[k]:.4g} {self.frame.force} at row {k + 1} ({k * self.sample_time:.4g} s), where "
                f"{100.0 * _USUAL_SHARE:g} % of the log stay within {most:.4g} {self.frame.force}: no mass answers to "
                f"them; repair these rows, or cut the log there"
            )

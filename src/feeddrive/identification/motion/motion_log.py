"""The input of an identification: position and force over time, checked."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from feeddrive.identification.estimate import TABLE, TURNING, Frame, frame_of
from feeddrive.identification.regression import short_runs, strays_said
from feeddrive.language.errors import LogError, NotIdentifiableError, ParameterError
from feeddrive.language.quantity import Quantity

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
            raise ParameterError(f"{self.name}: sample_time = {Quantity(self.sample_time, 's'):6 SI} must be > 0 s")
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

    def distance(self, value: float, digits: int = 4) -> Quantity:
        """Return a residual of the position as a quantity."""
        return Quantity(value, self.frame.position, form=f"{digits} {self.micro}")

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
                f"{self.name}: '{channel}' reaches {Quantity(np.max(np.abs(values))):3}, beyond {Quantity(LARGEST)}: "
                "check the column and its unit"
            )
        if np.ptp(values) == 0.0:
            raise NotIdentifiableError(
                f"{self.name}: '{channel}' is {Quantity(values[0]):6} in all rows: it was not recorded, or nothing "
                f"moved; record a move to and fro with its {channel}"
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
                f"{self.name}: the force reaches {Quantity(largest, unit):5}, beyond the limit of "
                f"{Quantity(most, unit):5} that the machine has: one of the two is wrong; check the unit or factor of "
                "the force, and the force limit and axis of the machine file"
            )
        there = np.abs(force) >= most * (1.0 - 1e-9)
        held = there[1:] & there[:-1]  # a peak reaches its value once; a limit holds it over several samples
        share = float(np.mean(held))
        if share > MOST_SATURATED:
            raise NotIdentifiableError(
                f"{self.name}: the force sits at {Quantity(most, self.frame.force):5} in {Quantity(share, 'share'):3} "
                f"of the rows (at most {Quantity(MOST_SATURATED, 'share'):6} are admitted): the drive or its recorder "
                "is saturated, and what acted on the axis is not known; repeat the motion with a lower acceleration, "
                "or with a wider recorder range"
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
                f"{Quantity(self.force[k], self.frame.force)} at row {k + 1} "
                f"({Quantity(k * self.sample_time, 's'):SI}), where {Quantity(_USUAL_SHARE, 'share'):6} of the log "
                f"stay within {Quantity(most, self.frame.force)}: no mass reacts to them; repair these rows, or cut "
                "the log there"
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
            place, apart, step = (
                Quantity(value, self.frame.position, form="SI") for value in (self.position[k], away[k], usual)
            )
            raise NotIdentifiableError(
                f"{self.name}: the position has {int(np.sum(found))} jump{'s' * (int(np.sum(found)) != 1)} there and "
                f"back, the largest to {place} at row {k + 1} ({Quantity(k * self.sample_time, 's'):SI}), {apart} off "
                f"its neighbors, where {Quantity(_USUAL_SHARE, 'share'):6} of the steps stay within {step}: no axis "
                "moves so; repair these rows, or cut the log there"
            )

    def without_spikes(self) -> tuple[MotionLog, tuple[str, ...]]:
        """The log with the mean of the neighbors in place of lesser spikes of the force, and a remark on them.

        A spike lasts three samples at most and is away from the median of 9 rows by more than the usual force F, within
        which 99 % of the rows stay, and by 8 standard deviations of the 61 rows around it:

            d = |f - median9(f)| > max(F, 8 · 1.4826 median61(d))

        No axis answers so short a force visibly, and a drive that really commanded it would not be fitted otherwise.
        More than 1 % of such rows are no faults of a line: coarse counts make them through a velocity gain.
        """
        from scipy.ndimage import median_filter  # not for commands that only read

        away = np.abs(self.force - median_filter(self.force, _NEAR, mode="nearest"))
        spread = 1.4826 * median_filter(away, min(_AROUND, away.size), mode="nearest")
        usual = float(np.quantile(np.abs(self.force), _USUAL_SHARE))
        found = short_runs(away > np.maximum(usual, _NOISE * spread), _SPIKE_ROWS)
        if not np.any(found) or np.mean(found) > 1.0 - _USUAL_SHARE:
            return self, ()
        rows, there = np.flatnonzero(~found), np.flatnonzero(found)
        force = self.force.copy()
        force[there] = np.interp(there, rows, self.force[rows])
        return replace(self, force=force), strays_said(f"{self.name}, force", self.force, found, self.frame.force)


def checked(log: MotionLog) -> MotionLog:
    """The log. Raises ParameterError, with what to write, for what is no MotionLog."""
    if not isinstance(log, MotionLog):  # pyright: ignore[reportUnnecessaryIsInstance]  what `read_log` gives is tempting
        raise ParameterError(
            f"identification takes a MotionLog, not a {type(log).__name__}: MotionLog(name=log.name, position=log["
            "'position_load'], force=log['force'], set_position=log['setpoint_position'], sample_time=log.sample_time)"
        )
    return log

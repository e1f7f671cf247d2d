"""The response of an axis's table to set positions, for setpoints that are changed before they are run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from feeddrive.blocks.families import Reference
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.language.errors import ParameterError
from feeddrive.loop.lifting import lifted
from feeddrive.loop.linearize import StateSpace, linearize
from feeddrive.loop.loop import Loop

_INPUTS, _OUTPUTS = ("set_position", "set_velocity"), ("position_load",)


@dataclass(frozen=True, eq=False)
class SetPath:
    """The linear model from set positions, with their backward difference as set velocity, to the position of the
    table.

    samples  the linear model of each sample of a period; one for most loops
    """

    samples: tuple[StateSpace, ...]

    @property
    def sample_time(self) -> float:
        """The time T of one sample, s."""
        return float(self.samples[0].sample_time)

    @property
    def period(self) -> int:
        """The samples after which the loop repeats itself."""
        return len(self.samples)

    def answers(self, positions: np.ndarray, phase: int = 0) -> np.ndarray:
        """Return the table position, m, shape (n, columns), for set positions of that shape, all 0 before; row 0 is
        sample `phase`.
        """
        velocity = np.diff(positions, axis=0, prepend=0.0) / self.sample_time
        x = np.zeros((self.samples[0].A.shape[0], positions.shape[1]))
        table = np.empty(positions.shape)
        for k in range(positions.shape[0]):
            sample = self.samples[(phase + k) % self.period]
            u = np.stack([positions[k], velocity[k]])
            table[k] = (sample.C @ x + sample.D @ u)[0]
            x = sample.A @ x + sample.B @ u
        return table


def set_path(loop: Loop, *, velocity: float = 0.05) -> SetPath:
    """Return the linear model of a loop that moves with `velocity` (m/s), from its set positions to its table.

    Feedforward of acceleration, jerk and snap acts on none of it: a table of positions states none of these.
    """
    if loop.control.law.period() > 1:
        return SetPath(lifted(loop, _INPUTS, _OUTPUTS, velocity=velocity).samples)
    return SetPath((linearize(loop, _INPUTS, _OUTPUTS, velocity=velocity),))


@dataclass(frozen=True, eq=False)
class ChangedReference:
    """Set positions that were changed so that the table moves along the wanted ones.

    reference  what the loop is given: positions, their differences as velocities, no higher derivatives
    wanted     where the table should be at the same rows
    lead       s by which the wanted motion begins later than it did: the preview
    """

    reference: Recorded
    wanted: Recorded
    lead: float

    @property
    def shift(self) -> float:
        """The largest distance of the changed set positions from the wanted ones, m."""
        return float(np.max(np.abs(self.reference.position - self.wanted.position)))


def sampled(reference: Reference, sample_time: float, before: int, after: int) -> np.ndarray:
    """Return set positions in m at kT, with the given rows at rest before the start and after the end."""
    rows = round(float(reference.duration) / sample_time) + 1
    return np.asarray(reference.at(np.arange(-before, rows + after) * sample_time).position, dtype=float)


def changed(positions: np.ndarray, wanted: np.ndarray, sample_time: float, lead: int) -> ChangedReference:
    """Return the changed reference, for rows `sample_time` apart.

    Raises ParameterError for positions that are not finite.
    """
    if not np.all(np.isfinite(positions)):
        raise ParameterError("the changed set positions are not finite: the model of the loop is not stable")
    both = (Recorded(position=row, sample_time=sample_time) for row in (positions, wanted))
    return ChangedReference(*both, lead=lead * sample_time)

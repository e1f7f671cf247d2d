"""A recorded reference: the set positions of a log, replayed sample by sample."""

from functools import cached_property

import numpy as np

from feeddrive.blocks.families import Reference
from feeddrive.blocks.sampled import check_duration, check_single, rows_at
from feeddrive.blocks.signals import Setpoint
from feeddrive.language.block import Number, choice, parameter, table
from feeddrive.language.errors import StructureError
from feeddrive.language.quantity import Quantity

_HIGHER = ("velocity", "acceleration", "jerk", "snap")


class Recorded(Reference):
    """A replayed log: row k of the tables at t = k · sample_time, the first position before it, the last one after it.

    If only positions are recorded, the velocity is the backward difference, 0 in the first row, and all higher
    derivatives are 0, so `Setpoint.backward_velocity(sample_time)` reproduces the recorded difference bit for bit.
    Times between the rows are refused; with `between = "linear"` all tables are interpolated linearly, and a velocity
    computed as a difference is the slope of the interpolated position.  Outside the table the axis is at rest, and no
    time is refused.
    Do not use it to run a loop at a sample time other than the log's: the velocity steps of the straight lines excite
    the loop.
    Raises StructureError for tables that do not match, and for refused times.
    """

    position: np.ndarray = table("m", "set positions")
    velocity: np.ndarray | None = table("m/s", "set velocities; absent: backward differences", default=None)
    acceleration: np.ndarray | None = table("m/s2", "set accelerations; absent: 0", default=None)
    jerk: np.ndarray | None = table("m/s3", "set jerks; absent: 0", default=None)
    snap: np.ndarray | None = table("m/s4", "set snaps; absent: 0", default=None)
    sample_time: Number = parameter("s", "time from row to row", above=0)
    between: str = choice("what holds between two rows", options=("refused", "linear"), default="refused")

    def check(self) -> None:
        """Raise StructureError for tables of unequal length, or for a derivative without all lower ones."""
        check_single(self)
        check_duration(self.kind, self.duration)
        missing = ""
        for name in _HIGHER:
            row = getattr(self, name)
            if row is None:
                missing = missing or name
                continue
            if row.size != self.position.size:
                raise StructureError(
                    f"recorded.{name} has {row.size} rows, recorded.position {self.position.size}: they must be equal"
                )
            if missing:
                raise StructureError(
                    f"recorded.{name} is given without recorded.{missing}: a derivative needs all lower ones"
                )

    @property
    def duration(self) -> float:
        """The time of the last row, s."""
        return (self.position.size - 1) * self.sample_time

    @cached_property
    def _rows(self) -> tuple[np.ndarray, ...]:
        rest = np.zeros(self.position.size)
        first = np.diff(self.position, prepend=self.position[0]) / self.sample_time
        others = (rest if row is None else row for row in (self.acceleration, self.jerk, self.snap))
        return self.position, first if self.velocity is None else self.velocity, *others

    def at(self, t: np.ndarray) -> Setpoint:
        """Return the rows at times t in s."""
        times = np.asarray(t, dtype=np.float64)
        last = self.position.size - 1
        place, on_row = rows_at(times, self.sample_time)
        inside = (place >= 0.0) & (place <= last)
        if self.between == "refused":
            self._refuse(times[inside & ~on_row])
        held = np.clip(place, 0.0, float(last))
        above = np.ceil(held).astype(np.int64)
        below = np.maximum(above - 1, 0)
        # 0 on a row: its value is then used without the rounding of an interpolation
        share = above - held
        rows: list[np.ndarray] = []
        for order, row in enumerate(self._rows):
            value = row[above]
            # a velocity from differences is constant between two rows, as the slope of the line is
            if self.between == "linear" and (order != 1 or self.velocity is not None):
                value = np.where(share > 0.0, value + share * (row[below] - value), value)
            rows.append(value if order == 0 else np.where(inside, value, 0.0))
        return Setpoint(*rows)  # type: ignore[arg-type]

    def _refuse(self, missed: np.ndarray) -> None:
        if missed.size:
            raise StructureError(
                f"recorded has a row every {Quantity(self.sample_time, 's'):6 SI} and none at t = "
                f'{Quantity(missed[0], "s"):12 SI}: run the loop at this sample time, or choose between = "linear"'
            )

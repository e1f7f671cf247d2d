"""A recorded force over time."""

import numpy as np

from feeddrive.blocks.families import Load
from feeddrive.blocks.sampled import check_single, rows_at
from feeddrive.language.block import Number, parameter, table


class RecordedForce(Load):
    """A recorded force: row k of the table over [kT, (k+1)T), T = sample_time; 0 N outside the table.

    A loop with another sample time uses the row that is valid at each of its samples.  A time that lies before the
    start of a row only because of rounding belongs to that row.
    """

    force: np.ndarray = table("N", "force on the table, row by row")
    sample_time: Number = parameter("s", "time from row to row", above=0)

    def check(self) -> None:
        """Raise StructureError if a parameter is an array of variants."""
        check_single(self)

    def at(self, t: np.ndarray) -> np.ndarray:
        place, _ = rows_at(np.asarray(t, dtype=np.float64), self.sample_time)
        row = np.floor(place)
        inside = (row >= 0.0) & (row < self.force.size)
        # numpy reads the rows before it selects: an index outside of the table must not occur
        return np.where(inside, self.force[np.where(inside, row, 0.0).astype(np.int64)], 0.0)

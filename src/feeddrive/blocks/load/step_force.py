"""A force step."""

import numpy as np

from feeddrive.blocks.families import Load
from feeddrive.blocks.sampled import check_order, check_single, since
from feeddrive.language.block import Number, parameter


class StepForce(Load):
    """A constant force for start <= t < end, 0 N otherwise.

    The loop holds a force over each sample, so it acts from the first sample with t >= start to the first with
    t >= end.  Rounding of kT does not shift this by a sample: a sample time that lies before `start` by less than
    1e-12 s plus 1e-14 of `start` counts as `start`.
    """

    force: Number = parameter("N", "force on the table, positive towards greater positions")
    start: Number = parameter("s", "when it begins", default=0)
    end: Number | None = parameter("s", "when it ends; absent: never", default=None)

    def check(self) -> None:
        """Raise StructureError if a parameter is an array of variants, ParameterError unless end > start."""
        check_single(self)
        check_order(self.kind, self.start, self.end)

    def at(self, t: np.ndarray) -> np.ndarray:
        times = np.asarray(t, dtype=np.float64)
        acts = since(times, self.start)
        if self.end is not None:
            acts = acts & ~since(times, self.end)
        return np.where(acts, self.force, 0.0)

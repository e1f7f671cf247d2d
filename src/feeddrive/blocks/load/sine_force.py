"""A sinusoidal force."""

import numpy as np

from feeddrive.blocks.families import Load
from feeddrive.blocks.sampled import check_order, check_single, since
from feeddrive.language.block import Number, parameter


class SineForce(Load):
    """A sinusoidal force, amplitude · sin(2π frequency (t - start) + phase) for start <= t < end, otherwise 0 N.

    The loop holds the force over each sample, so the acting force is a staircase delayed by half a sample.  Start
    and end are assigned to samples as in StepForce.
    For a force that depends on the position of the axis, use a ForceMap.
    """

    amplitude: Number = parameter("N", "amplitude of the force on the table", least=0)
    frequency: Number = parameter("Hz", "frequency", above=0)
    phase: Number = parameter("rad", "phase at the start", default=0)
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
        turns = self.frequency * (times - self.start)
        # reduced to one period, for the same digits late in a long run
        swing = self.amplitude * np.sin(2.0 * np.pi * (turns - np.floor(turns)) + self.phase)
        return np.where(acts, swing, 0.0)

"""A reference filtered by an input shaper."""

import numpy as np

from feeddrive.blocks.families import Reference
from feeddrive.blocks.reference.pulses import SHAPERS, pulses
from feeddrive.blocks.sampled import are_all, check_duration, check_single
from feeddrive.blocks.signals import Setpoint
from feeddrive.language.block import Number, choice, parameter, part
from feeddrive.language.errors import StructureError


class InputShaped(Reference):
    """The reference r convolved with pulses of sum 1: x(t) = Σ Aᵢ r(t - tᵢ), exact in all derivatives at any time.

    A mode with the specified frequency and damping does not ring after the end of the shaped motion ("zv"), hardly
    rings even if its frequency is slightly different ("zvd", half a period longer), or rings by at most `tolerance`
    over a wider band ("ei").  The motion stays within the limits of r, ends where r ends, and is longer by one or two
    half periods of the mode.
    Do not use it on axes that trace a path together, unless all of them have the same shaper.
    Raises StructureError for a Recorded reference, unless it interpolates: pulses rarely fall on its rows.
    For the pulses and their sources see `pulses.py`.
    """

    reference: Reference = part("the reference to shape")
    shaper: str = choice("the pulses", options=SHAPERS, default="zv")
    frequency: Number = parameter("Hz", "frequency of the mode without damping", above=0)
    damping: Number = parameter("", "damping ratio of the mode", default=0, least=0, below=1)
    tolerance: Number = parameter("", "share of the vibration that EI leaves", default=0.05, least=0, below=1)

    def check(self) -> None:
        """Raise StructureError unless there is a reference of finite duration."""
        check_single(self)
        if not are_all((self.reference,), Reference):
            raise StructureError(f"input_shaped.reference must be a reference, not {self.reference!r}")
        check_duration(self.kind, self.duration)

    def pulses(self) -> tuple[list[float], list[float]]:
        """Return the amplitudes of the pulses, with sum 1, and their times in s."""
        return pulses(self.shaper, self.frequency, self.damping, self.tolerance)

    @property
    def duration(self) -> float:
        """The duration of the reference plus the time of the last pulse, s."""
        return self.reference.duration + self.pulses()[1][-1]

    def at(self, t: np.ndarray) -> Setpoint:
        """Sum over the pulses, last pulse first, so that the motion ends exactly at the end of the reference."""
        times = np.asarray(t, dtype=np.float64)
        heights, delays = self.pulses()
        # rounding must not put the end before `duration`
        ended = np.where(times >= self.duration, self.reference.duration, -np.inf)
        last = self.reference.at(np.maximum(times - delays[-1], ended))
        total = list(last)
        for height, delay in zip(heights[:-1], delays[:-1], strict=True):
            seen = self.reference.at(times - delay)
            total = [so_far + height * (value - end) for so_far, value, end in zip(total, seen, last, strict=True)]
        return Setpoint(*total)

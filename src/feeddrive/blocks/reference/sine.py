"""A sine motion."""

import numpy as np

from feeddrive.blocks.families import Reference
from feeddrive.blocks.reference.derivatives import product, resting, sine_of, stretched
from feeddrive.blocks.reference.smooth_step import window
from feeddrive.blocks.sampled import check_duration, check_single
from feeddrive.blocks.signals import Setpoint
from feeddrive.language.block import Number, choice, parameter
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity


class Sine(Reference):
    """A motion x = center + amplitude · w(t) · sin(2π frequency t) over whole cycles.

    Without `blend_time`, w is 1: position and acceleration are then continuous at both ends, but velocity and jerk
    jump.  With it, w rises during the first `blend_time` and falls during the last, along a seventh-degree polynomial,
    and all derivatives up to the jerk are continuous.
    Raises ParameterError if the two blends together are longer than the cycles.
    """

    amplitude: Number = parameter("m", "largest distance from the center", least=0)
    frequency: Number = parameter("Hz", "cycles per second", above=0)
    cycles: int = choice("number of whole cycles, blends included", default=1, least=1)
    center: Number = parameter("m", "position at start, end and between the half waves", default=0)
    blend_time: Number = parameter(
        "s", "how long the amplitude rises, and falls; 0 s for not at all", default=0, least=0
    )

    def check(self) -> None:
        """Raise ParameterError unless the blends fit into the cycles."""
        check_single(self)
        check_duration(self.kind, self.duration)
        if 2.0 * self.blend_time > self.duration:
            raise ParameterError(
                f"sine.blend_time = {Quantity(self.blend_time, 's'):6 SI} must be <= "
                f"{Quantity(0.5 * self.duration, 's'):6 SI}, half of all cycles"
            )

    @property
    def duration(self) -> float:
        """The duration of all cycles, s."""
        return self.cycles / self.frequency

    def at(self, t: np.ndarray) -> Setpoint:
        times = np.asarray(t, dtype=np.float64)
        inside = np.clip(times, 0.0, self.duration)
        turns = self.frequency * inside
        rate = np.full_like(turns, 2.0 * np.pi * self.frequency)
        still = np.zeros_like(turns)
        # reduced to one cycle, so that late ones keep their digits
        wave = sine_of((2.0 * np.pi * (turns - np.floor(turns)), rate, still, still, still))
        moved = stretched(product(window(inside, self.duration, self.blend_time), wave), self.amplitude, 1.0)
        return resting(times, self.duration, (self.center + moved[0], *moved[1:]), self.center, self.center)

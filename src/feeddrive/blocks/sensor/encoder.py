"""A linear or rotary encoder with its faults."""

from __future__ import annotations

from typing import Any

from feeddrive.blocks.families import Nothing, Sensor
from feeddrive.blocks.signals import Noise
from feeddrive.language import ops
from feeddrive.language.block import Number, parameter


class Encoder(Sensor):
    """Position to the nearest count, after noise.

        reading = resolution · round((x + noise · n(k)) / resolution),      n(k) ~ N(0, 1), white, from the run's seed

    A parameter that is left out costs nothing.
    """

    resolution: Number = parameter("m", "length of one count; absent for a continuous reading", above=0, default=None)
    noise: Number = parameter("m", "standard deviation of the reading", least=0, default=None)

    def start(self, position: Number) -> Nothing:
        """No memory."""
        return Nothing()

    def step(self, state: Any, position: Number, velocity: Number, noise: Noise, T: Number) -> tuple[Any, Number]:
        """The equation above."""
        reading = position
        if self.noise is not None:
            reading = reading + self.noise * noise.normal()
        if self.resolution is not None:
            reading = ops.quantise(reading, self.resolution)
        return state, reading

"""A sine sweep through a frequency band."""

import numpy as np

from feeddrive.blocks.families import Reference
from feeddrive.blocks.reference.derivatives import Derivatives, product, resting, sine_of, stretched
from feeddrive.blocks.reference.smooth_step import window
from feeddrive.blocks.sampled import check_duration, check_single
from feeddrive.blocks.signals import Setpoint
from feeddrive.language.block import Number, choice, parameter
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity


class Chirp(Reference):
    """A sweep x = center + amplitude · w(t) · sin(φ(t)); φ' runs from 2π first_frequency to 2π last_frequency.

        linear       φ = 2π (f₁ t + (f₂ - f₁) t² / 2D)
        logarithmic  φ = 2π f₁ (eᵍᵗ - 1) / g,   g = ln(f₂/f₁) / D,       D = sweep_time

    w rises from 0 during the first `blend_time` and falls to 0 during the last, along a seventh-degree polynomial; the
    motion starts and ends at rest at the center.  The sweep may run up or down.
    Not suitable for measuring an axis with dry friction around standstill; use a multisine with a bias velocity there.
    Raises ParameterError if the two blends together are longer than the sweep.
    """

    amplitude: Number = parameter("m", "largest distance from the center", least=0)
    first_frequency: Number = parameter("Hz", "frequency at the start", above=0)
    last_frequency: Number = parameter("Hz", "frequency at the end", above=0)
    sweep_time: Number = parameter("s", "duration of the sweep, blends included", above=0)
    sweep: str = choice("how the frequency changes in time", options=("linear", "logarithmic"), default="logarithmic")
    center: Number = parameter("m", "position at start and end", default=0)
    blend_time: Number | None = parameter(
        "s",
        "how long the amplitude rises, and falls; 0 s for not at all, absent: a tenth of the sweep",
        least=0,
        default=None,
    )

    def check(self) -> None:
        """Raise ParameterError unless the blends fit into the sweep."""
        check_single(self)
        check_duration(self.kind, self.duration)
        if 2.0 * self._blend() > self.sweep_time:
            raise ParameterError(
                f"chirp.blend_time = {Quantity(self._blend(), 's'):6 SI} must be <= "
                f"{Quantity(0.5 * self.sweep_time, 's'):6 SI}, half of the sweep"
            )

    def _blend(self) -> float:
        return 0.1 * self.sweep_time if self.blend_time is None else self.blend_time

    @property
    def duration(self) -> float:
        return self.sweep_time

    def _angle(self, t: np.ndarray) -> Derivatives:
        first, last = 2.0 * np.pi * self.first_frequency, 2.0 * np.pi * self.last_frequency
        growth = np.log(last / first) / self.sweep_time
        if self.sweep == "linear" or growth == 0.0:
            # equal frequencies: (eᵍᵗ - 1)/g would be 0/0
            slope = (last - first) / self.sweep_time
            still = np.zeros_like(t)
            return t * (first + 0.5 * slope * t), first + slope * t, np.full_like(t, slope), still, still
        rate = first * np.exp(growth * t)
        # expm1: with nearly equal frequencies eᵍᵗ - 1 would lose its digits
        return first * np.expm1(growth * t) / growth, rate, growth * rate, growth**2 * rate, growth**3 * rate

    def at(self, t: np.ndarray) -> Setpoint:
        times = np.asarray(t, dtype=np.float64)
        moved = self._moved(np.clip(times, 0.0, self.duration))
        # without a blend the sweep ends at any phase
        last = self.center if self._blend() > 0.0 else float(self._moved(np.array([self.duration]))[0][0])
        return resting(times, self.duration, moved, self.center, last)

    def _moved(self, t: np.ndarray) -> Derivatives:
        steps = product(window(t, self.duration, self._blend()), sine_of(self._angle(t)))
        moved = stretched(steps, self.amplitude, 1.0)
        return self.center + moved[0], *moved[1:]

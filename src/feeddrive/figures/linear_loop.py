"""The linear model of a loop, from which its figures are computed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from feeddrive.analysis.loop_model import LoopModel, loop_model
from feeddrive.analysis.margins import Margins, bandwidth, margins
from feeddrive.analysis.stiffness import Stiffness, force_noise, reading_deviation, rope_snap, stiffness
from feeddrive.language.errors import ParameterError, UnstableError
from feeddrive.language.quantity import Quantity, number
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.loop import Loop

LOWEST = 1.0  # Hz, from which the least stiffness counts
_LINES = 60  # of a band


@dataclass(frozen=True, eq=False)
class LinearLoop:
    """A loop with its linear model, which is computed once for all figures.

    velocity       m/s, at which the axis slides
    known          its model, if it is known: that of a stable loop
    density        lines a decade
    lowest         Hz, from which the least stiffness counts
    reading_noise  of both readings, white, m RMS; None: counts and noise of the encoders

    Raises UnstableError where a figure of a loop is wanted that is not stable: it has none.
    """

    loop: Loop
    velocity: float = 0.05
    known: LoopModel | None = None
    density: int = 200
    lowest: float = LOWEST
    reading_noise: tuple[float, float] | None = None

    @cached_property
    def model(self) -> LoopModel:
        """The model opened at the actuator, and closed."""
        if self.known is not None:
            return self.known
        model = loop_model(self.loop, velocity=self.velocity)
        largest = float(np.max(np.abs(model.closed.poles()), initial=0.0))
        if not largest < 1.0:
            raise UnstableError(f"the loop is not stable: its slowest pole has the absolute value {number(largest, 6)}")
        return model

    @cached_property
    def lines(self) -> np.ndarray:
        """Frequencies in Hz, dense around the resonances."""
        return self.model.lines(self.density)

    @property
    def margins(self) -> Margins:
        """The margins of the loop gain."""
        return self._margins_on_lines

    @cached_property
    def _margins_on_lines(self) -> Margins:
        return margins(self.model.loop_gain(self.lines))

    @property
    def compliance(self) -> FRF:
        """The compliance on all lines, m/N."""
        return self._compliance_on_lines

    @cached_property
    def _compliance_on_lines(self) -> FRF:
        return self._compliance(self.lines)

    @property
    def stiffness(self) -> Stiffness:
        """The dynamic stiffness from the lowest frequency on that counts."""
        return self._stiffness_on_lines

    @cached_property
    def _stiffness_on_lines(self) -> Stiffness:
        lowest = min(self.lowest, 0.01 * self.nyquist)
        return stiffness(self._compliance(self.lines[self.lines >= lowest]))

    def stiffness_at(self, frequency: float) -> float:
        """Return the dynamic stiffness at a frequency (Hz), N/m. Raises ParameterError beyond half the sample rate."""
        if frequency > self.nyquist:
            raise ParameterError(
                f"a stiffness at {Quantity(frequency, 'Hz'):6} is asked for, and the loop ends at "
                f"{Quantity(self.nyquist, 'Hz'):6}"
            )
        return stiffness(self._compliance(np.array([frequency]))).at(frequency)

    def mean_stiffness(self, low: float, high: float) -> float:
        """Return the geometric mean of the dynamic stiffness over a band in Hz, N/m."""
        return stiffness(self._compliance(np.geomspace(low, min(high, self.nyquist), _LINES))).mean

    def _compliance(self, frequency: np.ndarray) -> FRF:
        return self.model.closed.response(frequency, "position_load", "load_force")

    @cached_property
    def nyquist(self) -> float:
        """Half of the sampling frequency, Hz."""
        return 0.5 / float(self.loop.sample_time)

    @property
    def rope_snap(self) -> float:
        """The rope-snap error, m √s/N."""
        return float(rope_snap(self.model.closed))

    @property
    def bandwidth(self) -> float | None:
        """The frequency up to which disturbances are rejected, Hz."""
        return bandwidth(self.lines, self.model.loop_gain(self.lines).response)

    @property
    def force_noise(self) -> float | None:
        """RMS of the force from the errors of the readings, N; None if they have none."""
        axis = self.loop.axis
        if self.reading_noise is not None:
            motor, load = self.reading_noise
            if axis.one_encoder():
                return force_noise(self.model.closed, 0.0, max(motor, load), shared=True)
            return force_noise(self.model.closed, motor, load)
        motor, load = reading_deviation(axis.encoder_motor), reading_deviation(axis.encoder_load)
        if motor == 0.0 and load == 0.0:
            return None
        if axis.one_encoder():
            return force_noise(self.model.closed, 0.0, motor + load, shared=True)
        return force_noise(self.model.closed, motor, load)

    @cached_property
    def noise_gain(self) -> float:
        """RMS of the force per RMS of white noise, equal in all readings and independent, N/m."""
        one = self.loop.axis.one_encoder()
        return force_noise(self.model.closed, 0.0 if one else 1.0, 1.0, shared=one)

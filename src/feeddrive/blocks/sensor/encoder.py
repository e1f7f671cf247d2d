"""A linear or rotary encoder with its errors."""

from typing import Any, NamedTuple

from feeddrive.blocks.families import Nothing, Sensor
from feeddrive.blocks.plant.lead_error import LeadError
from feeddrive.blocks.sensor.eccentricity import Eccentricity
from feeddrive.blocks.sensor.interpolation import Interpolation
from feeddrive.blocks.signals import Noise
from feeddrive.language import ops
from feeddrive.language.block import Number, parameter, part
from feeddrive.language.errors import ParameterError


class Encoder(Sensor):
    """An encoder with the following errors, applied in this order.

        jitter          r = x + v · jitter · T · n₁(k)         the sample is taken a little early or late
        lead error      r = r - e(r)                           a rotary encoder on a rigid axis measures the screw
        eccentricity    r = r + error(r)
        interpolation   r = r + error(r)
        noise           r = r + noise · n₀(k)
        resolution      r = resolution · round(r / resolution)
        count rate      r changes by at most largest_rate · T counts a sample; missed counts remain lost
        offset          r = r + offset

    n₀ and n₁ are white, independent, N(0, 1), and are generated from the run's seed.  Lead error and eccentricity are
    evaluated at the position at which the sample is taken.

    An error that is not specified needs no computation.
    """

    resolution: Number | None = parameter(
        "m", "length of one count; absent for a continuous reading", above=0, default=None
    )
    noise: Number | None = parameter("m", "standard deviation of the reading", least=0, default=None)
    jitter: Number | None = parameter(
        "", "standard deviation of the sampling instant, share of T", least=0, default=None
    )
    largest_rate: Number | None = parameter(
        "1/s", "counts per second that the counter can follow", above=0, default=None
    )
    offset: Number | None = parameter("m", "reading at x = 0", default=None)
    lead_error: LeadError | None = part("lead error of the screw that carries the encoder", default=None)
    eccentricity: Eccentricity | None = part("eccentricity of a rotary encoder", default=None)
    interpolation: Interpolation | None = part("interpolation error of a sine encoder", default=None)

    class Counter(NamedTuple):
        """The reading of the last sample without lost counts, and the sum of all lost counts (m)."""

        wanted: Number
        lost: Number

    def check(self) -> None:
        """Raise ParameterError if a count rate is specified without a resolution."""
        if self.largest_rate is not None and self.resolution is None:
            raise ParameterError("encoder.largest_rate is given without encoder.resolution: a rate needs counts")

    def start(self, position: Number) -> Any:
        """Return the state in which no counts are lost yet."""
        # a zero of the kind of the position: a state has the same types before and after a step, in a trace too
        return Nothing() if self.largest_rate is None else self.Counter(self._counted(position), ops.zero(position))

    def still(self, position: Number) -> Number:
        """Return the reading with all errors that need neither time nor random numbers."""
        return self._shifted(self._counted(position))

    def step(self, state: Any, position: Number, velocity: Number, noise: Noise, T: Number) -> tuple[Any, Number]:
        """Compute the reading with all errors."""
        seen = position
        if self.jitter is not None:
            # the next channel: n₁ is independent of n₀
            seen = seen + velocity * (self.jitter * T * noise.on(noise.channel + 1.0).normal())
        reading = self._counted(seen, noise)
        if self.largest_rate is not None and self.resolution is not None:
            wanted = reading
            most = self.largest_rate * self.resolution * T
            change = wanted - state.wanted
            # a counter adds differences: a count missed once offsets all later readings
            lost = state.lost + (ops.clip(change, -most, most) - change)
            state, reading = self.Counter(wanted, lost), wanted + lost
        return state, self._shifted(reading)

    def _counted(self, position: Number, noise: Noise | None = None) -> Number:
        """Return the reading before count-rate limit and offset; it is free of noise if `noise` is None."""
        reading = position
        if self.lead_error is not None:
            reading = reading - self.lead_error.at(position)
        if self.eccentricity is not None:
            reading = reading + self.eccentricity.at(position)
        if self.interpolation is not None:
            reading = self.interpolation.apply(reading)
        if self.noise is not None and noise is not None:
            reading = reading + self.noise * noise.normal()
        return reading if self.resolution is None else ops.quantise(reading, self.resolution)

    def _shifted(self, reading: Number) -> Number:
        return reading if self.offset is None else reading + self.offset

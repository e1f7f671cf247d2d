"""The signals that the parts of a loop exchange in one sample."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from feeddrive.language import ops
from feeddrive.language.block import Number
from feeddrive.language.units import Unit


class Setpoint(NamedTuple):
    """The setpoint of an axis at t = kT, with exact derivatives."""

    position: Annotated[Number, Unit("m")]
    velocity: Annotated[Number, Unit("m/s")] = 0.0
    acceleration: Annotated[Number, Unit("m/s2")] = 0.0
    jerk: Annotated[Number, Unit("m/s3")] = 0.0
    snap: Annotated[Number, Unit("m/s4")] = 0.0

    def backward_velocity(self, T: Number) -> Number:
        """Return (x(k) - x(k-1)) / T in m/s by Taylor expansion: exact while the snap is constant over the last sample.

        A law that computes velocity as a difference of readings needs the same difference of the reference.
        """
        return self.velocity - T * (
            0.5 * self.acceleration - T * ((1.0 / 6.0) * self.jerk - T * ((1.0 / 24.0) * self.snap))
        )

    def shifted(self, time: Number) -> Setpoint:
        """Return the setpoint `time` seconds later, by Taylor expansion up to snap.

        Feedforward that acts over [kT, (k+1)T] uses T/2.
        """
        snap = self.snap
        jerk = self.jerk + time * snap
        acceleration = self.acceleration + time * (self.jerk + 0.5 * time * snap)
        velocity = self.velocity + time * (self.acceleration + 0.5 * time * (self.jerk + (1.0 / 3.0) * (time * snap)))
        position = self.position + time * (
            self.velocity + 0.5 * time * (self.acceleration + (1.0 / 3.0) * time * (self.jerk + 0.25 * (time * snap)))
        )
        return Setpoint(position, velocity, acceleration, jerk, snap)


class Reading(NamedTuple):
    """The measurements and past commands that are available to a law at t = kT, before it computes a command.

    With one encoder both positions are equal to its reading. `applied` is the force actually commanded in the last
    sample, after filters, limit and enable; `requested` is this force before the limit. Anti-windup, observers,
    disturbance recovery and bumpless enable use only these two.

    When a law or an observer starts, the positions are those of the previous sample, so that its first difference is
    correct, and `velocity` is the velocity of the axis at that time.
    """

    position_motor: Number  # m
    position_load: Number  # m
    applied: Number = 0.0  # N
    requested: Number = 0.0  # N
    velocity: Number = 0.0  # m/s, at a start only

    def position(self, encoder: str) -> Number:
        """Return the position that an encoder measures, "motor" or "load", m."""
        return self.position_motor if encoder == "motor" else self.position_load


class Estimate(NamedTuple):
    """An observer's estimate of the axis at t = kT.

    `disturbance` is the force on the axis in addition to the drive's: friction, cutting, gravity, model errors.  A
    positive one acts towards larger positions, so a controller compensates for it by subtraction.
    """

    position: Number  # m
    velocity: Number  # m/s
    disturbance: Number  # N


class Motion(NamedTuple):
    """The positions (m) and velocities (m/s) of the motor's and the load's body, which are equal on a rigid axis."""

    position_motor: Number
    position_load: Number
    velocity_motor: Number
    velocity_load: Number


class Noise(NamedTuple):
    """A source of random numbers that depend on seed, sample and channel only, so batched and single runs agree."""

    seed: Number  # whole number
    sample: Number  # k
    channel: Number = 0.0

    def normal(self) -> Number:
        """Return a random number with mean 0 and standard deviation 1."""
        return ops.normal(self.seed, self.sample, self.channel)

    def on(self, channel: float) -> Noise:
        """Return the source of random numbers for another channel."""
        return Noise(self.seed, self.sample, channel)

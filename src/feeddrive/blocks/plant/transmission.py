"""Conversion from the motor's shaft to the table: angle, torque and inertia through gear and screw."""

from feeddrive.language import ops
from feeddrive.language.block import Number


def radians_per_metre(lead: Number) -> Number:
    """Return the angle of the screw per table motion, 2π / lead, in rad/m."""
    return 2.0 * ops.pi / lead


def reflected(inertia: Number, ratio: Number) -> Number:
    """Return a rotary quantity referred to the table: J ratio² in kg for kg m², N s/m for N m s/rad; ratio in rad/m."""
    return inertia * ratio * ratio

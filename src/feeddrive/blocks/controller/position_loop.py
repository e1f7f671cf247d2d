"""The position loop around a velocity loop that runs in the drive."""

from typing import ClassVar, Self

from feeddrive.blocks.axis_model import AxisModel, Start
from feeddrive.blocks.controller.cascade_options import commanded_velocity
from feeddrive.blocks.families import Law, Nothing
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language.block import Number, parameter


class PositionLoop(Law):
    """P position loop with velocity feedforward, whose command is a velocity.

        w = Kv (x_set - x_load) + velocity_feedforward · v_set,     v_set = (x_set(k) - x_set(k-1)) / T

    It is the outer loop of `CascadePPI`, for a drive that closes its velocity loop by itself (`VelocityLoop`): mode csv
    of CiA 402, or ±10 V to an amplifier in velocity mode.  Its command is a velocity in m/s, so it needs an axis that
    takes one, and what commands a force cannot be beside it: feedforward of forces, compensations, a force limit.

    When to use: where the drive closes the velocity loop.  It leaves that loop as it is: forces on the table are held
    by the drive's own gains, and this law only brings the axis back.
    Source: Altintas & Okwudire 2009, section 2 (the cascade).
    """

    commanded: ClassVar[str] = "velocity"
    tunables: ClassVar[tuple[str, ...]] = ("Kv",)
    title: ClassVar[str] = "P"

    Kv: Number = parameter("1/s", "position gain", above=0)
    velocity_feedforward: Number = parameter("", "share of the set velocity that is fed forward", default=1.0, least=0)

    @classmethod
    def begin(cls, axis: AxisModel, present: Law) -> tuple[Start, ...]:
        """Return no variant, so that a comparison of laws that command forces omits the law, unless it is present."""
        return (Start(cls.title, present),) if isinstance(present, cls) else ()

    def position_gain(self) -> Number:
        return self.Kv

    def start(self, prepared: object, setpoint: Setpoint, reading: Reading) -> Nothing:
        return Nothing()

    def step(
        self, prepared: object, state: Nothing, setpoint: Setpoint, reading: Reading, T: Number
    ) -> tuple[Nothing, Number]:
        velocity = commanded_velocity(self.Kv, self.velocity_feedforward, setpoint, reading, T)
        return state, velocity

    def retune(self, state: Nothing, old: Self, old_prepared: object, prepared: object) -> Nothing:
        """Return the state unchanged: there is none."""
        return state

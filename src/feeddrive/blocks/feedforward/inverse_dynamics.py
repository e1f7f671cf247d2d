"""Inverse dynamics of screw and table: the force needed for the set motion, with the spring between them."""

from typing import Any

from feeddrive.blocks.families import Feedforward, Plant
from feeddrive.blocks.plant.two_bodies import series, two_bodies
from feeddrive.blocks.signals import Setpoint
from feeddrive.language.block import Number, choice, part


class InverseDynamics(Feedforward):
    """Inverse dynamics of two masses and a spring, evaluated in the middle of the sample in which the force acts.

        force = (m11 + m12) a1 + (c11 + c12) v1 + (m22 + m12) a2 + (c22 + c12) v2
        v2, a2 = v_set, a_set at t + T/2;   v1 = v2 + lead', a1 = a2 + lead'' of the screw (blocks/plant/two_bodies.py)

    For a diagonal mass matrix this is m1 a1 + b1 v1 + m2 a2 + b2 v2, that is,
    (m1 + m2) a + (b1 + b2) v + (m1 b2 + m2 b1) j/k + m1 m2 snap/k + ...   With `order` = "rigid" the spring is
    treated as rigid: a1 = a2, v1 = v2.

    When to use: with references that provide jerk and snap, under any law with an encoder on the table.  It helps only
    together with matching set positions of the screw, as in `PolePlacement`.
    Source: Gordon & Erkorkmaz 2013, section 2 (inverse dynamics); Lambrechts, Boerlage & Steinbuch 2005.
    """

    feeds = ("acceleration", "velocity")

    model: Plant = part("screw, table and the spring between them")
    order: str = choice("with the spring, or as one rigid mass", options=("full", "rigid"), default="full")

    def check(self) -> None:
        """Raise StructureError unless the model has two bodies."""
        two_bodies(self.kind, self.model)

    def step(self, state: Any, setpoint: Setpoint, T: Number) -> tuple[Any, Number]:
        m11, m12, m22, c11, c12, c22, _ = bodies = two_bodies(self.kind, self.model)
        middle = setpoint.shifted(0.5 * T)
        a1, v1 = middle.acceleration, middle.velocity
        if self.order == "full":
            # the series, not the exact lag: it has no state, and is stable for any coupling mass
            lead = series(bodies, middle)
            a1, v1 = a1 + lead.acceleration, v1 + lead.velocity
        screw = (m11 + m12) * a1 + (c11 + c12) * v1
        return state, screw + (m22 + m12) * middle.acceleration + (c22 + c12) * middle.velocity

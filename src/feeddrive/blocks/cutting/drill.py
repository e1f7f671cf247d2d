"""A twist drill with straight lips and a chisel edge."""

from collections.abc import Iterator
from typing import Any, NamedTuple

from feeddrive.blocks.cutting.edge_coefficients import EdgeCoefficients
from feeddrive.blocks.cutting.engagement import LEAST_CHIP
from feeddrive.language import ops
from feeddrive.language.block import Block, Number, Rule, choice, parameter, part
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text


class Drill(Block):
    """Thrust and torque of a drill from its depth in the work and the chip of a lip.

        κ = point_angle / 2,   R = diameter / 2,   r_c = chisel_length / 2
        r_out = clip(r_c + depth tan κ, r_c, R),   r_in = clip(r_c + (depth - thickness) tan κ, r_c, R)
        lips:    thrust = lips (Kfc c sin κ + Kfe) (r_out - r_in)
                 torque = lips (Ktc c + Kte / sin κ) (r_out² - r_in²) / 2
        chisel:  thrust = lips (Kfc c' + Kfe) r_c,   torque = lips (Ktc c' + Kte) r_c² / 2

    c is the feed of a lip, so that a lip cuts a chip c sin κ thick and (r_out - r_in) / sin κ wide.  depth is that of
    the chisel edge below the surface: the lips come into the work over (R - r_c) / tan κ, and leave a plate of
    `thickness` over the same way.  The chisel edge, with coefficients of its own, is in the work for 0 < depth <
    thickness, with c' = min(c, depth).  All forces are 0 where c <= 0.
    Then  torque of the lips · ω = lips' Ktc · (volume per second) + their Kte · (length of edge · its mean velocity).
    The coefficients are means over the lip, whose rake changes along it.  Do not use it for the bulge of a thin floor
    before the breakthrough, or for the lateral force of unequal lips.
    Source: Altintas, Manufacturing Automation (2nd ed. 2012), chapter 2, mechanics of drilling (lips by F = K_c b h +
    K_e b over the radius; chisel edge apart).
    """

    diameter: Number = parameter("m", "of the drill", above=0, most=1)
    lips: int = choice("cutting lips, equal and equally spaced", default=2, least=1, most=12)
    # 118 degrees, the usual twist drill
    point_angle: Number = parameter("rad", "angle of the point", above=0.1, below=3.1415, default=2.0594885173533086)
    chisel_length: Number = parameter("m", "length of the chisel edge", least=0, default=0)
    lip: EdgeCoefficients = part("force coefficients of the lips")
    chisel: EdgeCoefficients | None = part("force coefficients of the chisel edge; absent: no force", default=None)

    class Forces(NamedTuple):
        """Thrust on the drill against its feed, N, and torque, N m."""

        thrust: Any
        torque: Any

    def rules(self) -> Iterator[Rule]:
        """Yield the validity rule: the chisel edge is shorter than the diameter."""
        yield Rule(
            self.chisel_length < self.diameter,
            "the chisel edge is shorter than the diameter of the drill",
            lambda: Text(
                f"drill.chisel_length = {Quantity(self.chisel_length, 'm'):6 SI} must be < drill.diameter = "
                f"{Quantity(self.diameter, 'm'):6 SI}: a usual chisel edge is 0.1 to 0.2 of it"
            ),
        )

    def forces(self, depth: Any, thickness: Any, chip: Any) -> Forces:
        """Return thrust and torque at a depth in m in a plate of `thickness` (m; None: no end), with a chip c in m."""
        core, outside, half = 0.5 * self.chisel_length, 0.5 * self.diameter, 0.5 * self.point_angle
        sine, slope = ops.sin(half), ops.tan(half)
        outer = ops.clip(core + depth * slope, core, outside)
        inner: Any = core if thickness is None else ops.clip(core + (depth - thickness) * slope, core, outside)
        wide, middle = outer - inner, 0.5 * (outer + inner)
        tangential, normal = self.lip.forces(chip * wide, wide / sine)
        thrust, torque = normal * sine, tangential * middle
        if self.chisel is not None:
            tangential, normal = self.chisel.forces(ops.minimum(chip, depth) * core, core)
            acts = depth > 0.0 if thickness is None else ops.both(depth > 0.0, depth < thickness)
            thrust = thrust + ops.where(acts, normal, 0.0)
            torque = torque + ops.where(acts, 0.5 * core * tangential, 0.0)
        cuts = chip > LEAST_CHIP
        return self.Forces(
            ops.where(cuts, float(self.lips) * thrust, 0.0), ops.where(cuts, float(self.lips) * torque, 0.0)
        )

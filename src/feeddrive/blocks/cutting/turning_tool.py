"""A turning tool with one straight edge."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from feeddrive.blocks.cutting.edge_coefficients import EdgeCoefficients
from feeddrive.blocks.cutting.engagement import LEAST_CHIP
from feeddrive.language import ops
from feeddrive.language.block import Block, Number, parameter, part


class TurningTool(Block):
    """Forces on a single-point tool, from the motion of its edge since the earlier turns of the workpiece.

        h   = min over m of step_m,feed cos ψ + step_m,depth sin ψ,   b = cutting_depth / cos ψ,   ψ = lead_angle
        F_t = Ktc b h + Kte b,   F_f = Kfc b h + Kfe b,               both 0 where h <= 0
        F   = -F_f (cos ψ, sin ψ) along feed and depth

    step_m is the motion of the tool over the last m turns of the workpiece, along the feed and into the work.  With a
    constant feed per turn c, b h = cutting_depth · c: the lead angle makes the chip thinner and wider, and turns the
    force from the feed to the depth.  The edge is straight and longer than b, and its width of cut does not change with
    the vibration: do not use it where the nose radius or the feed per turn is not small against the depth of cut.
    Source: Altintas, Manufacturing Automation (2nd ed. 2012), chapter 2, mechanics of turning; chapter 4 for the chip
    between two turns.
    """

    cutting_depth: Number = parameter("m", "depth of cut, from the old surface to the new one", above=0)
    lead_angle: Number = parameter(
        "rad",
        "side cutting edge angle: 0 if the edge is normal to the feed; positive: its outer end comes first to the work",
        above=-1.4,
        below=1.4,
        default=0,
    )
    edge: EdgeCoefficients = part("force coefficients of the edge")

    class Forces(NamedTuple):
        """Force on the tool along the feed and into the work, and along the cutting velocity, N."""

        feed: Any
        depth: Any
        tangential: Any

    def forces(self, steps: Sequence[tuple[Any, Any]]) -> Forces:
        """Return the forces for the motions (feed, depth) in m over the last 1, 2, ... turns of the workpiece."""
        cosine, sine = ops.cos(self.lead_angle), ops.sin(self.lead_angle)
        (feed, depth), *others = steps
        chip = feed * cosine + depth * sine
        for other_feed, other_depth in others:
            chip = ops.minimum(chip, other_feed * cosine + other_depth * sine)
        width = self.cutting_depth / cosine
        tangential, normal = self.edge.forces(chip * width, width)
        # the force of the edge, too, needs a chip
        cuts = chip > LEAST_CHIP
        tangential, normal = ops.where(cuts, tangential, 0.0), ops.where(cuts, normal, 0.0)
        return self.Forces(-(normal * cosine), -(normal * sine), tangential)

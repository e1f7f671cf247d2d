"""The cutting force of a milling tool on one axis."""

from typing import Any

import numpy as np

from feeddrive.blocks.families import Cutter, Load, Reference
from feeddrive.blocks.sampled import check_order, check_single, since
from feeddrive.language.block import Number, choice, parameter, part
from feeddrive.language.errors import StructureError


class MillingForce(Load):
    """The component along one machine axis of the force on a milling tool with its feed in the x-y plane.

        angle     = start_angle + 2π (spindle_speed / 60) t
        F_x, F_y  = F_feed t + F_normal n,   t = (cos direction, sin direction, 0),  n = z x t
        F_z       = -F_axial:  the force pulls a right-handed helix out of its holder, away from the spindle

    The cutter computes F_feed, F_normal and F_axial.  The chip load is `chip_load`, with a constant `direction` of the
    feed; or, with two `references`, the motions of x and y, it follows the instantaneous feed v along the path:

        chip_load = v / (teeth · spindle_speed / 60),   direction = that of the velocity;   no force without feed

    It acts for start <= t < end; the spindle always turns.  The force at kT is held over the sample.  If the table
    moves the workpiece instead of the tool, the force on the axis has the opposite sign.
    When to use: for an axis that must hold its path while cutting; use one block per axis, each with its component.
    Not suitable for chatter, since the chip does not depend on vibration.
    Source: Beltrán-Carbajal et al. 2013, eqs. (4)-(8); F_c in the paper's axis equations is the negative of this force.
    Raises StructureError unless exactly one of chip_load and references is specified.
    """

    cutter: Cutter = part("the tool")
    spindle_speed: Number = parameter("rpm", "turns of the spindle", above=0)
    component: str = choice("machine axis along which the component is taken", options=("x", "y", "z"), default="x")
    chip_load: Number | None = parameter(
        "m", "feed per tooth; absent: it follows from the references", least=0, default=None
    )
    direction: Number = parameter(
        "rad", "direction of the feed, from x towards y; with references it follows from them", default=0
    )
    references: tuple[Reference, ...] = part("motions of x and y, whose feed makes the chip", default=())
    start_angle: Number = parameter("rad", "angle of the spindle at t = 0", default=0)
    start: Number = parameter("s", "when the cut begins", default=0)
    end: Number | None = parameter("s", "instant at which it ends; absent: it does not end", default=None)

    def check(self) -> None:
        """Raise StructureError unless the chip load has exactly one source, ParameterError unless end > start."""
        check_single(self)
        check_single(self.cutter)
        check_order(self.kind, self.start, self.end)
        if (self.chip_load is None) == (not self.references):
            raise StructureError(
                "milling_force takes its chip from either chip_load (m per tooth) or references (the motions of x and "
                "y): give exactly one of them"
            )
        if self.references and len(self.references) != 2:
            raise StructureError(
                f"milling_force.references must be two, the motions of x and y, not {len(self.references)}; "
                f"for an axis at rest give a move of 0 m"
            )

    def at(self, t: np.ndarray) -> np.ndarray:
        times = np.asarray(t, dtype=np.float64)
        turns = (self.spindle_speed / 60.0) * times
        # reduced to one turn first: after many turns the product with 2π would lose the digits of the angle
        angle: Any = self.start_angle + 2.0 * np.pi * (turns - np.floor(turns))
        chip_load, along_x, along_y = self._feed(times)
        feed, normal, axial = self.cutter.forces(angle, chip_load)
        acts = since(times, self.start)
        if self.end is not None:
            acts = acts & ~since(times, self.end)
        components = {"x": feed * along_x - normal * along_y, "y": feed * along_y + normal * along_x, "z": -axial}
        return np.where(acts, components[self.component], 0.0)

    def _feed(self, t: np.ndarray) -> tuple[Any, Any, Any]:
        """Return the chip load in m, and the components of the feed's unit vector along x and y."""
        if self.chip_load is not None:
            return self.chip_load, float(np.cos(self.direction)), float(np.sin(self.direction))
        x, y = (np.asarray(reference.at(t).velocity) for reference in self.references)
        feed = np.hypot(x, y)
        # without feed there is no chip, so that the direction does not matter; it only must not divide by 0
        moving = np.where(feed > 0.0, feed, 1.0)
        return feed / (self.cutter.teeth * self.spindle_speed / 60.0), x / moving, y / moving

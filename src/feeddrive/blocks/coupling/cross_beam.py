"""The beam between the two drives of a gantry axis."""

from feeddrive.blocks.families import Coupling, SharedSpring
from feeddrive.language.block import Number, choice, parameter
from feeddrive.language.errors import StructureError


class CrossBeam(Coupling):
    """The cross beam of an axis with two drives: a spring and a damper that resist the skew of the drives.

        f = stiffness (x_axis - x_follower) + damping (x_axis' - x_follower'),   on both tables, in opposite directions

    Each drive has its own plant, controller and encoder; the mass of each includes half of the beam.  A word of a part
    program that moves `axis` moves both drives.  The plants of both are discretized together, exactly, with a
    zero-order hold, so the beam may have any stiffness. The position difference between the two tables is the skew in
    m; divided by the distance between the drives it is an angle.  Do not use it if a slide moves along the beam and
    shifts mass from one drive to the other, since both masses are constant here.  If the beam is guided so softly that
    its rotation is a separate degree of freedom, add a `StructureMode`.
    """

    axis: str = choice("axis whose word of a part program moves both drives", default="y")
    follower: str = choice("its second drive", default="y2")
    stiffness: Number = parameter("N/m", "force against skew, at the tables", above=0)
    damping: Number = parameter("N s/m", "damping of the skew", least=0, default=0)

    def check(self) -> None:
        """Raise StructureError unless the two drives are different axes."""
        if self.axis == self.follower:
            raise StructureError(
                f"cross_beam: axis and follower are both '{self.axis}': a beam lies between two drives"
            )

    def axes(self) -> tuple[str, ...]:
        """Return the axis names of the two drives."""
        return (self.axis, self.follower)

    def springs(self) -> tuple[SharedSpring, ...]:
        return (SharedSpring(self.stiffness, self.damping, {self.axis: 1.0, self.follower: -1.0}),)

    def follows(self) -> dict[str, str]:
        """Return the second drive as a follower of the first."""
        return {self.follower: self.axis}

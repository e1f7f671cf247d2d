"""The geometric errors of a machine: the tool point as a function of the axis positions."""

from collections.abc import Mapping

from feeddrive.blocks.coupling.straightness import Straightness
from feeddrive.language.block import Block, Number, choice, parameter, part
from feeddrive.language.errors import StructureError


class Geometry(Block):
    """Scale, squareness and straightness errors, which relate the tool point to the true positions of the tables.

        tool.x = x + scale_x x + squareness_xy y + squareness_xz z + straightness
        tool.y = y + scale_y y + squareness_yz z + straightness
        tool.z = z + scale_z z + straightness

    A positive squareness means that the tool moves towards larger x while y increases: the angle between the axes is
    less than a right angle.  No axis encoder measures these errors; they appear only at the tool, for instance in a
    circle test or on a part.  They do not affect cutting forces and controllers, which act on the axes.
    Source: ISO 230-1; signs as in the circle test, x += squareness_xy y.
    """

    along_x: str = choice("axis that moves the tool along x", default="x")
    along_y: str = choice("axis that moves the tool along y", default="y")
    along_z: str | None = choice("axis that moves the tool along z; absent: none", default=None)
    scale_x: Number = parameter("", "relative error of the length along x", above=-1, default=0)
    scale_y: Number = parameter("", "the same along y", above=-1, default=0)
    scale_z: Number = parameter("", "the same along z", above=-1, default=0)
    squareness_xy: Number = parameter(
        "rad", "error of the right angle between x and y", least=-0.5, most=0.5, default=0
    )
    squareness_xz: Number = parameter("rad", "the same between x and z", least=-0.5, most=0.5, default=0)
    squareness_yz: Number = parameter("rad", "the same between y and z", least=-0.5, most=0.5, default=0)
    straightness: tuple[Straightness, ...] = part("straightness errors of the guideways", default=())

    def check(self) -> None:
        """Raise StructureError for an axis used twice, or for a straightness error with an invalid direction."""
        if len(set(self.axes().values())) < len(self.axes()):
            raise StructureError(
                f"geometry: x, y and z must be moved by different axes, not {', '.join(self.axes().values())}"
            )
        for i, error in enumerate(self.straightness):
            if error.along == error.across:
                raise StructureError(
                    f"geometry.straightness.{i}: along and across are both {error.along}: an error along the motion is "
                    f"one of the scale or of the screw (lead_error)"
                )
            for way in (error.along, error.across):
                if way not in self.axes():
                    raise StructureError(f"geometry.straightness.{i}: no axis moves the tool along {way}")

    def axes(self) -> dict[str, str]:
        """Return, for each direction, the name of the axis that moves the tool in it."""
        third = {} if self.along_z is None else {"z": self.along_z}
        return {"x": self.along_x, "y": self.along_y, **third}

    def tool(self, position: Mapping[str, Number]) -> dict[str, Number]:
        """Return the tool point by direction (m) from the table position of each axis by name (m)."""
        at = {way: position[axis] for way, axis in self.axes().items()}
        point = {
            "x": at["x"] + self.scale_x * at["x"] + self.squareness_xy * at["y"],
            "y": at["y"] + self.scale_y * at["y"],
        }
        if "z" in at:
            point["x"] = point["x"] + self.squareness_xz * at["z"]
            point["y"] = point["y"] + self.squareness_yz * at["z"]
            point["z"] = at["z"] + self.scale_z * at["z"]
        for error in self.straightness:
            point[error.across] = point[error.across] + error.at(at[error.along])
        return point

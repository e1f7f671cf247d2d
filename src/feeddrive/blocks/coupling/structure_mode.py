"""A structure mode of the machine shared by several axes."""

from feeddrive.blocks.coupling.mode_shape import ModeShape
from feeddrive.blocks.families import Coupling, SharedMode
from feeddrive.language import ops
from feeddrive.language.block import Number, parameter, part
from feeddrive.language.errors import StructureError


class StructureMode(Coupling):
    """One mode η of bed, column or gantry, scaled by its modal mass, that the axes named in `shapes` excite and follow.

        mass (η'' + 2 damping_ratio ω η' + ω² η) = Σ over axes (motor f_motor + load f_load),      ω = 2π frequency
        it adds motor · η and load · η to the positions of the two bodies of each of these axes

    Several modes act in parallel, as the modes of a measured response matrix do.  A structure in series, such as a
    column on a bed, is described by the modes of the complete structure: its undamped modes and their shapes form such
    a sum too, which is exact for modal damping.  Modes and axes are discretized together, exactly, with a zero-order
    hold: the response of any position of the coupled machine to any force is exact except for rounding.  Friction acts
    on the position of a body including its modes, as on a guideway that does not move.  Do not use it for a mode that
    changes with the position of an axis, since shapes are constant.
    Source: modal superposition, Ewins 2000, ch. 2; shapes may have either sign.
    """

    frequency: Number = parameter("Hz", "undamped natural frequency", above=0)
    damping_ratio: Number = parameter("", "damping ratio", least=0, default=0.02)
    mass: Number = parameter("kg", "modal mass", above=0)
    shapes: tuple[ModeShape, ...] = part("mode shape at each axis that feels it")

    def check(self) -> None:
        """Raise StructureError unless at least one axis is named, and each only once."""
        names = self.axes()
        if len(set(names)) < len(names) or not names:
            raise StructureError(
                f"structure_mode.shapes must name one or more axes, each axis once, not {', '.join(names) or 'none'}"
            )

    def axes(self) -> tuple[str, ...]:
        """Return the names of the axes in `shapes`."""
        return tuple(shape.axis for shape in self.shapes)

    def modes(self) -> tuple[SharedMode, ...]:
        w = 2.0 * ops.pi * self.frequency
        shapes = {shape.axis: (shape.motor, shape.load) for shape in self.shapes}
        return (SharedMode(self.mass, 2.0 * self.damping_ratio * w * self.mass, w * w * self.mass, shapes),)

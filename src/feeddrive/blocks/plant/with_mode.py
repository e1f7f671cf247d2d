"""A plant with one more structural mode."""

from feeddrive.blocks.families import Mechanics, Plant
from feeddrive.blocks.plant.mode import Mode
from feeddrive.language import matrix
from feeddrive.language.block import Number, part


class WithMode(Plant):
    """Any plant with one structural mode in parallel that its model may leave out.

        mass (η'' + 2 damping_ratio ω η' + ω² η) = motor f_motor + load f_load,      ω = 2π frequency
        x_motor and x_load of the plant become x_motor + motor η and x_load + load η

    The rigid mass is that of the plant.  It tests a control that was designed for the plant alone, as the benchmark
    does.  Do not use it for a mode that a law shall know: laws with a model of the axis do not take this plant.
    """

    plant: Plant = part("the plant without the mode")
    mode: Mode = part("the mode")

    @property
    def stiffness(self) -> Number | None:
        """The spring of the plant, on which backlash acts; None if it has none."""
        return getattr(self.plant, "stiffness", None)

    def mechanics(self) -> Mechanics:
        """Return the matrices of the plant, with the coordinate of the mode before its own."""
        plain, mode = self.plant.mechanics(), self.mode
        n = len(plain.mass) + 1
        tables = [matrix.zeros(n, n) for _ in range(3)]
        own = (mode.mass, mode.damping(), mode.stiffness())
        for table, value, rows in zip(tables, own, (plain.mass, plain.damping, plain.stiffness), strict=True):
            table[0][0] = value
            for i, row in enumerate(rows, 1):
                table[i][1:] = row
        mass, damping, stiffness = (tuple(map(tuple, table)) for table in tables)
        driven, read = (mode.motor, *plain.shape[plain.motor]), (mode.load, *plain.shape[plain.load])
        # the drive may act on another body than that of the motor's encoder
        apart = plain.drive != plain.motor
        first = ((mode.motor, *plain.shape[plain.drive]),) if apart else ()
        return Mechanics(
            mass=mass,
            damping=damping,
            stiffness=stiffness,
            shape=(*first, driven, read),
            motor=len(first),
            load=len(first) + 1,
            rigid=(0.0, *plain.rigid_motion()),
        )

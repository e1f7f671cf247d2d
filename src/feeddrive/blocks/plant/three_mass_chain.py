"""A ball screw with its torsional and its axial mode: motor, screw and table in a row."""

from feeddrive.blocks.families import Mechanics, Plant
from feeddrive.blocks.plant.chain import chain
from feeddrive.language.block import Number, parameter


class ThreeMassChain(Plant):
    """Motor, screw and table, with the coupling as a torsional and the nut as an axial spring.

        mass_motor x0'' + viscous_motor x0' = force - Fc
        mass_screw x1'' + viscous_screw x1' = Fc - Fn + d1
        mass_load  x2'' + viscous_load  x2' = Fn + d2
        Fc = coupling_stiffness (x0 - x1) + coupling_damping (x0' - x1')
        Fn = stiffness (x1 - x2) + damping (x1' - x2')

    All quantities are referred to table motion.  The force acts on the motor x0.  The motor encoder, the friction of
    bearings and nut, and forces such as cogging are located at the screw x1.  The load is the table x2.  Use this plant
    as the true axis on which to test designs made for a two-mass model.
    Source: Gordon & Erkorkmaz 2013, eq. (1), with a coupling before the screw.
    """

    mass_motor: Number = parameter("kg", "rotor, seen at the table", above=0)
    mass_screw: Number = parameter("kg", "screw and the screw's half of the coupling, seen at the table", above=0)
    mass_load: Number = parameter("kg", "table and workpiece", above=0)
    coupling_stiffness: Number = parameter("N/m", "coupling between motor and screw, seen at the table", above=0)
    stiffness: Number = parameter("N/m", "axial stiffness between screw and table", above=0)
    coupling_damping: Number = parameter("N s/m", "damping of the coupling, seen at the table", least=0, default=0)
    damping: Number = parameter("N s/m", "damping between screw and table", least=0, default=0)
    viscous_motor: Number = parameter("N s/m", "viscous friction of the motor, seen at the table", least=0, default=0)
    viscous_screw: Number = parameter("N s/m", "viscous friction of the screw", least=0, default=0)
    viscous_load: Number = parameter("N s/m", "viscous friction of the guideway", least=0, default=0)

    def mechanics(self) -> Mechanics:
        return chain(
            masses=(self.mass_motor, self.mass_screw, self.mass_load),
            springs=((self.coupling_stiffness, self.coupling_damping), (self.stiffness, self.damping)),
            viscous=(self.viscous_motor, self.viscous_screw, self.viscous_load),
            motor=1,
        )

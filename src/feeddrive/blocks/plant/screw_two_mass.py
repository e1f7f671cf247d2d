"""A ball screw with one axial mode, described by data-sheet values: inertias in kg m², lead, gear."""

from feeddrive.blocks.families import Mechanics, Plant
from feeddrive.blocks.plant.chain import chain
from feeddrive.blocks.plant.transmission import radians_per_metre, reflected
from feeddrive.language.block import Number, parameter


class ScrewTwoMass(Plant):
    """The rotating parts and the table as two masses, with the screw between them as a spring.

        r = 2π / lead,   m1 = (inertia_screw + gear² inertia_motor) r²,   b1 = viscous_bearings r²
        m1        x1'' + b1           x1' = force - F          F = stiffness (x1 - x2) + damping (x1' - x2')
        mass_load x2'' + viscous_load x2' = F

    x1 is the angle of the screw divided by r.  The force is the motor's torque · gear · r.
    Source: Gordon & Erkorkmaz 2013, eq. (1), with the reflected inertia.
    """

    inertia_motor: Number = parameter("kg m2", "rotor, brake and what turns with the motor", above=0)
    lead: Number = parameter("m", "table motion in one turn of the screw", above=0)
    mass_load: Number = parameter("kg", "table and workpiece", above=0)
    stiffness: Number = parameter("N/m", "axial stiffness between screw and table", above=0)
    inertia_screw: Number = parameter("kg m2", "screw, coupling and what turns with the screw", least=0, default=0)
    gear: Number = parameter("", "turns of the motor in one turn of the screw", above=0, default=1)
    damping: Number = parameter("N s/m", "damping between screw and table", least=0, default=0)
    viscous_bearings: Number = parameter("N m s/rad", "viscous friction of the screw's bearings", least=0, default=0)
    viscous_load: Number = parameter("N s/m", "viscous friction of the guideway", least=0, default=0)

    def mechanics(self) -> Mechanics:
        ratio = radians_per_metre(self.lead)
        turning = self.inertia_screw + self.gear * self.gear * self.inertia_motor
        return chain(
            masses=(reflected(turning, ratio), self.mass_load),
            springs=((self.stiffness, self.damping),),
            viscous=(reflected(self.viscous_bearings, ratio), self.viscous_load),
            motor=0,
        )

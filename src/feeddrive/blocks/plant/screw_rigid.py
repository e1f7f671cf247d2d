"""A rigid axis with a screw, described by data-sheet values: inertias in kg m², lead, gear."""

from feeddrive.blocks.families import Mechanics, Plant
from feeddrive.blocks.plant.transmission import radians_per_metre, reflected
from feeddrive.language.block import Number, parameter


class ScrewRigid(Plant):
    """One mass on a guideway, driven through gear and screw.

        r = 2π / lead,      total mass = mass + (inertia_screw + gear² inertia_motor) r²
        total mass · x'' + (viscous_load + viscous_bearings r²) x' = force

    The force is the motor's torque · gear · r.  Do not use it at frequencies above about a third of the drive's first
    mode.
    Source: Altintas & Okwudire 2009, eq. (1), with the reflected inertia.
    """

    inertia_motor: Number = parameter("kg m2", "rotor, brake and what turns with the motor", above=0)
    lead: Number = parameter("m", "table motion in one turn of the screw", above=0)
    mass: Number = parameter("kg", "table and workpiece", above=0)
    inertia_screw: Number = parameter("kg m2", "screw, coupling and what turns with the screw", least=0, default=0)
    gear: Number = parameter("", "turns of the motor in one turn of the screw", above=0, default=1)
    viscous_bearings: Number = parameter("N m s/rad", "viscous friction of the screw's bearings", least=0, default=0)
    viscous_load: Number = parameter("N s/m", "viscous friction of the guideway", least=0, default=0)

    def mechanics(self) -> Mechanics:
        """Return M = total mass, C = the viscous terms, K = 0."""
        ratio = radians_per_metre(self.lead)
        turning = self.inertia_screw + self.gear * self.gear * self.inertia_motor
        total = self.mass + reflected(turning, ratio)
        viscous = self.viscous_load + reflected(self.viscous_bearings, ratio)
        return Mechanics(mass=((total,),), damping=((viscous,),), stiffness=((0.0,),), shape=((1.0,),))

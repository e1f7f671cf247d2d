"""An axis of a small milling machine with the parameters used in control papers: carriage, screw, torque input."""

from feeddrive.blocks.families import Mechanics, Plant
from feeddrive.blocks.plant.transmission import radians_per_metre, reflected
from feeddrive.language.block import Number, parameter


class MillingAxis(Plant):
    """A rigid carriage driven by a screw; a = lead / 2π.

        (carriage_mass + inertia / a²) q'' + (c_b + c_t / a²) q' = torque / a + other forces

    The force of the loop is torque / a, in N at the carriage.  Dry friction (μ sign q'), gravity and cutting forces are
    separate blocks.  `ScrewRigid` describes such an axis by data-sheet values and includes a gear.
    Source: the milling machine in the papers on GPI control by Beltrán-Carbajal and co-workers; their rotary equation
    is divided by a here.
    """

    inertia: Number = parameter("kg m2", "all that turns with the screw", above=0)
    lead: Number = parameter("m", "carriage motion in one turn of the screw", above=0)
    carriage_mass: Number = parameter("kg", "all that moves with the carriage", above=0)
    c_b: Number = parameter("N s/m", "viscous friction of the carriage", least=0, default=0)
    c_t: Number = parameter("N m s/rad", "viscous friction of the screw's bearings", least=0, default=0)

    def mechanics(self) -> Mechanics:
        """Return M = carriage_mass + inertia / a², C = c_b + c_t / a², K = 0."""
        ratio = radians_per_metre(self.lead)
        mass = self.carriage_mass + reflected(self.inertia, ratio)
        viscous = self.c_b + reflected(self.c_t, ratio)
        return Mechanics(mass=((mass,),), damping=((viscous,),), stiffness=((0.0,),), shape=((1.0,),))

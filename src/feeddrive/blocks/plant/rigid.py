"""A rigid axis: one moving mass."""

from feeddrive.blocks.families import Mechanics, Plant
from feeddrive.language.block import Number, parameter


class Rigid(Plant):
    """One mass on a guideway.

        mass · x'' + viscous · x' = force

    Use it for a linear motor, or for a screw drive at frequencies below about a third of its first mode.  Rotating
    parts with the inertia J contribute J (2π/lead)² to the mass.  Source: Altintas & Okwudire 2009, eq. (1).
    """

    mass: Number = parameter("kg", "all that moves, seen at the table", above=0)
    viscous: Number = parameter("N s/m", "viscous friction of the guideway", least=0, default=0)

    def mechanics(self) -> Mechanics:
        """Return M = mass, C = viscous, K = 0."""
        return Mechanics(mass=((self.mass,),), damping=((self.viscous,),), stiffness=((0.0,),), shape=((1.0,),))

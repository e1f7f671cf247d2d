"""A ball screw with one axial mode: driven mass and table mass, with the screw between them as a spring."""

from collections.abc import Iterator

from feeddrive.blocks.families import Mechanics, Plant
from feeddrive.language import ops
from feeddrive.language.block import Number, Rule, parameter
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text


class TwoMass(Plant):
    """Two masses and a spring, with a diagonal or a full mass matrix.

        [m1  m12] [x1'']   [b1+c  -c  ] [x1']   [ k  -k] [x1]   [force + d1]
        [m12 m2 ] [x2''] + [-c    b2+c] [x2'] + [-k   k] [x2] = [d2        ]

    x1 is the screw in units of table motion (rotary encoder), x2 the table (linear encoder).  `coupling_mass` is m12;
    omit it if the mass matrix is diagonal.
    Source: Gordon & Erkorkmaz 2013, eq. (1), and eq. (2) for the full matrix.
    """

    mass_motor: Number = parameter("kg", "motor, coupling and screw, seen at the table", above=0)
    mass_load: Number = parameter("kg", "table and workpiece", above=0)
    stiffness: Number = parameter("N/m", "axial stiffness between screw and table", above=0)
    damping: Number = parameter("N s/m", "damping between screw and table", least=0, default=0)
    viscous_motor: Number = parameter("N s/m", "viscous friction of the screw", least=0, default=0)
    viscous_load: Number = parameter("N s/m", "viscous friction of the guideway", least=0, default=0)
    coupling_mass: Number | None = parameter("kg", "off-diagonal term of the mass matrix", default=None)

    def rules(self) -> Iterator[Rule]:
        """Yield the validity rule: the mass matrix is positive definite."""
        m12, product = self.coupling_mass, self.mass_motor * self.mass_load
        if m12 is not None:
            yield Rule(
                m12 * m12 < product,
                "coupling_mass is smaller than the geometric mean of mass_motor and mass_load",
                lambda: Text(
                    f"two_mass.coupling_mass = {Quantity(m12, 'kg'):6} must be smaller than the geometric mean of "
                    f"mass_motor and mass_load, {Quantity(ops.sqrt(product), 'kg'):6}: the mass matrix is not positive "
                    "definite"
                ),
            )

    def mechanics(self) -> Mechanics:
        k, c = self.stiffness, self.damping
        m12 = 0.0 if self.coupling_mass is None else self.coupling_mass
        return Mechanics(
            mass=((self.mass_motor, m12), (m12, self.mass_load)),
            damping=((self.viscous_motor + c, -c), (-c, self.viscous_load + c)),
            stiffness=((k, -k), (-k, k)),
            shape=((1.0, 0.0), (0.0, 1.0)),
            load=1,
        )

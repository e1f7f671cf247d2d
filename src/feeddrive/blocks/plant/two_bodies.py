"""Properties of a screw-and-table model: its mode, the displacement between its bodies, and pole placement.

All equations are those of Gordon & Erkorkmaz 2013, eq. (2):

    [m11 m12] [x1'']   [c11 c12] [x1']     [ 1 -1] [x1]   [u]
    [m12 m22] [x2''] + [c12 c22] [x2'] + k [-1  1] [x2] = [0]
"""

from typing import Any, NamedTuple

from feeddrive.blocks.families import Plant
from feeddrive.blocks.plant.three_mass_chain import ThreeMassChain
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.signals import Setpoint
from feeddrive.language import matrix, ops
from feeddrive.language.block import Number, Rule
from feeddrive.language.errors import StructureError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text

# relative to a table that only its screw moves; below it the gains lose all their digits
LEAST_CONTROL = 1e-6


class TwoBodies(NamedTuple):
    """The matrices of the equation in the module docstring; a literal 0.0 marks an absent term."""

    m11: Number
    m12: Number
    m22: Number
    c11: Number
    c12: Number
    c22: Number
    k: Number

    @property
    def led(self) -> Number:
        """The mass m22 + m12 in kg that the spring accelerates when both bodies have the same acceleration."""
        # a diagonal mass matrix must not pay for m12: in a trace each sum is an operation
        return self.m22 if matrix.is_zero(self.m12) else self.m22 + self.m12

    @property
    def dragged(self) -> Number:
        """The viscous friction b2 = c22 + c12 of the guideway in N s/m, which loads the spring in common motion."""
        return self.c22 + self.c12

    @property
    def determinant(self) -> Number:
        """The determinant of the mass matrix, m11 m22 - m12², in kg²."""
        plain = self.m11 * self.m22
        return plain if matrix.is_zero(self.m12) else plain - self.m12 * self.m12

    @property
    def mode(self) -> Number:
        """The frequency of the undamped axial mode, rad/s: ω² = k (m11 + 2 m12 + m22) / (m11 m22 - m12²)."""
        total = self.m11 + self.m22
        total = total if matrix.is_zero(self.m12) else total + 2.0 * self.m12
        return ops.sqrt(self.k * total / self.determinant)


def two_bodies(where: str, plant: Plant) -> TwoBodies:
    """Return the matrices of a plant with two bodies.

    Raises StructureError, with a remedy, if the plant does not have this form.
    """
    mechanics = plant.mechanics()
    places = (mechanics.drive, mechanics.motor, mechanics.load)
    if mechanics.shape != ((1.0, 0.0), (0.0, 1.0)) or places != (0, 0, 1):
        raise StructureError(
            f"{where}: the model '{plant.kind}' is not a driven body, a load and one spring between them; "
            f"take two_mass or screw_two_mass with the mode that is to be damped"
        )
    return TwoBodies(
        m11=mechanics.mass[0][0],
        m12=mechanics.mass[0][1],
        m22=mechanics.mass[1][1],
        c11=mechanics.damping[0][0],
        c12=mechanics.damping[0][1],
        c22=mechanics.damping[1][1],
        k=mechanics.stiffness[0][0],
    )


def two_mass_model(plant: Plant) -> Plant:
    """Return the two-mass model of screw and table in a plant, for a law that places poles.

    A chain of motor, screw and table is reduced to two masses: motor and screw become one body, which is valid below
    the mode of the coupling. Raises StructureError, with the reason, for a plant that has no such model.
    """
    if isinstance(plant, ThreeMassChain):
        return TwoMass(
            mass_motor=plant.mass_motor + plant.mass_screw,
            mass_load=plant.mass_load,
            stiffness=plant.stiffness,
            damping=plant.damping,
            viscous_motor=plant.viscous_motor + plant.viscous_screw,
            viscous_load=plant.viscous_load,
        )
    mechanics = plant.mechanics()
    if mechanics.motor == mechanics.load and len(mechanics.mass) == 1:
        raise StructureError(
            f"the plant '{plant.kind}' is one mass: it has no mode between motor and load that poles could be placed on"
        )
    two_bodies("pole_placement", plant)
    return plant


def controllable(where: str, bodies: TwoBodies) -> Rule:
    """Return the rule that a force on the screw can place all poles with numerically meaningful gains.

    With q = dragged/led, an equal motion e^-qt of both bodies leaves the spring relaxed.  This motion is uncontrollable
    if it also balances the forces on the table: control = |led² - (c q + m12 q²) led²/k| / m22² = 0,  c = -c12.
    """
    led, dragged, k = bodies.led, bodies.dragged, bodies.k
    reached = ops.absolute(led * led + (bodies.c12 * led - bodies.m12 * dragged) * dragged / k)
    found = reached / (bodies.m22 * bodies.m22)
    return Rule(
        found >= LEAST_CONTROL,
        "a force on the screw of the model reaches every motion of its table, so that all poles can be placed",
        lambda: _uncontrollable(where, bodies, found),
    )


def _uncontrollable(where: str, bodies: TwoBodies, control: float) -> str:
    """Return the error message: how far the model is from being controllable, and the nearest admissible value."""
    led, dragged, k = bodies.led, bodies.dragged, bodies.k
    if abs(led) < 0.5 * bodies.m22:
        # with little damping control = (led/m22)²
        near = -bodies.m22 * (1.0 - ops.sqrt(LEAST_CONTROL) * (1.0 if led >= 0.0 else -1.0))
        remedy = Text(
            f"coupling_mass = {Quantity(bodies.m12, 'kg'):6} cancels mass_load; the nearest admissible value is "
            f"{Quantity(near, 'kg'):6}"
        )
    else:
        # without m12 control = 1 - c dragged/(k m22); twice the least lies on the admissible side
        near = -k * bodies.m22 / bodies.c12 * (1.0 - 2.0 * LEAST_CONTROL)
        remedy = Text(
            f"the damping of the guideway is {Quantity(dragged, 'N s/m'):6}; the nearest admissible value is "
            f"{Quantity(near, 'N s/m'):6}"
        )
    return Text(
        f"{where}: the poles cannot be placed: a force on the screw does not reach one motion of the table (control "
        f"{Quantity(control):3} of 1, the least is {Quantity(LEAST_CONTROL)}): {remedy}"
    )


class Gains(NamedTuple):
    """The gains of u = K1 (x1r - x1) + K2 (x2r - x2) + K3 (v1r - v1) + K4 (v2r - v2) + Ki ∫ (x2r - x2) dt."""

    K1: Number  # N/m
    K2: Number  # N/m
    K3: Number  # N s/m
    K4: Number  # N s/m
    Ki: Number  # N/(m s)


def polynomial(real: Number, *pairs: tuple[Number, Number]) -> list[Any]:
    """Return the coefficients of (s + real) Π (s² + 2 ζ ω s + ω²), from that of s⁰ on; pairs are (ω, ζ)."""
    coefficients: list[Any] = [real, 1.0]
    for frequency, damping in pairs:
        quadratic = (frequency * frequency, 2.0 * damping * frequency, 1.0)
        product: list[Any] = [0.0] * (len(coefficients) + 2)
        for i, a in enumerate(coefficients):
            for j, b in enumerate(quadratic):
                # literal ones and zeros cost no operation
                term = b if matrix.is_one(a) else a if matrix.is_one(b) else a * b
                product[i + j] = term if matrix.is_zero(product[i + j]) else product[i + j] + term
        coefficients = product
    return coefficients


def place(bodies: TwoBodies, desired: list[Any]) -> Gains:
    """Return the gains that give the closed loop the characteristic polynomial `desired` = [a0, a1, a2, a3, a4, 1].

    With Pij = mij s² + cij s ± k and Δ = P11 P22 - P12², equation (2) closed by the gains has the characteristic
    polynomial

        s Δ + s (K1 + K3 s) P22 - (s K2 + s² K4 + Ki) P12 = (m11 m22 - m12²) · desired

    With the sums S1 = K1 + K2 and S3 = K3 + K4 this is, since P22 + P12 = led s² + dragged s is free of the spring,

        s² (K1 + K3 s)(led s + dragged) + (Ki + S1 s + S3 s²)(k - c12 s - m12 s²) = (m11 m22 - m12²) · desired - s Δ

    whose coefficients, from s⁰ to s⁴ for (Ki, S1, S3, K1, K3), need no pivoting: the equations are nearly triangular
    in any units, and elimination without pivoting is invariant to scaling of rows and columns.  Repeated poles
    need no special case.
    """
    m11, m12, m22, c11, c12, c22, k = bodies
    led, dragged = bodies.led, bodies.dragged
    # s Δ = s (P11 P22 - P12²), from s² on; s¹ is free of terms, since the whole axis moves freely
    free = (
        0.0,
        0.0,
        k * (c11 + c22 + 2.0 * c12),
        c11 * c22 - c12 * c12 + k * (m11 + m22 + 2.0 * m12),
        m11 * c22 + m22 * c11 - 2.0 * (m12 * c12),
    )
    right = [
        (bodies.determinant * a if matrix.is_zero(b) else bodies.determinant * a - b,)
        for a, b in zip(desired[:5], free, strict=True)
    ]
    off, slope = (0.0 if matrix.is_zero(m12) else -m12), -c12
    left = (
        (k, 0.0, 0.0, 0.0, 0.0),
        (slope, k, 0.0, 0.0, 0.0),
        (off, slope, k, dragged, 0.0),
        (0.0, off, slope, led, dragged),
        (0.0, 0.0, off, 0.0, led),
    )
    (Ki,), (S1,), (S3,), (K1,), (K3,) = matrix.solve(left, right)
    return Gains(K1, S1 - K1, K3, S3 - K3, Ki)


class ScrewCommand(NamedTuple):
    """The displacement x1 - x2 of the screw relative to the table that a table motion requires, with derivatives."""

    position: Number  # m
    velocity: Number  # m/s
    acceleration: Number  # m/s²


def relaxed_lead(bodies: TwoBodies, setpoint: Setpoint) -> ScrewCommand:
    """Return the lead for an undamped spring in m, m/s and m/s²: (led a + dragged v) / k and its derivatives."""
    per_acceleration, per_velocity = bodies.led / bodies.k, bodies.dragged / bodies.k
    return ScrewCommand(
        per_acceleration * setpoint.acceleration + per_velocity * setpoint.velocity,
        per_acceleration * setpoint.jerk + per_velocity * setpoint.acceleration,
        per_acceleration * setpoint.snap + per_velocity * setpoint.jerk,
    )


def lag(bodies: TwoBodies) -> Number:
    """Return the time constant in s with which the screw's lead follows the relaxed one: c/k, c = -c12."""
    return -bodies.c12 / bodies.k


def series(bodies: TwoBodies, setpoint: Setpoint) -> ScrewCommand:
    """Return the lead from the series in c/k up to first order, which needs no state and is stable for any m12.

    The second line of equation (2), solved for x1 - x2 = lead:

        (k - c12 s - m12 s²) lead = (led s² + dragged s) x2
        lead  = relaxed  - (c/k) relaxed',    lead' = relaxed' - (c/k) relaxed'',    lead'' = relaxed''
    """
    relaxed, late = relaxed_lead(bodies, setpoint), lag(bodies)
    return ScrewCommand(
        relaxed.position - late * relaxed.velocity,
        relaxed.velocity - late * relaxed.acceleration,
        relaxed.acceleration,
    )

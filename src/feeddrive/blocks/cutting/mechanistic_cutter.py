"""An end mill with cutting and edge force coefficients and run-out."""

from collections.abc import Iterator
from typing import NamedTuple

from feeddrive.blocks.cutting.edge_coefficients import material_rules
from feeddrive.blocks.cutting.engagement import Cut, arc, cut, fits_slices
from feeddrive.blocks.families import Cutter, Edge
from feeddrive.language import ops
from feeddrive.language.block import Number, Rule, choice, parameter
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text


class MechanisticCutter(Cutter):
    """Forces on an end mill with helical edges, from three coefficients per chip area and three per edge length.

    The edge of tooth j at height z is at v = φ + 2πj/teeth - 2 z tan(helix_angle) / diameter, φ = angle.  On a piece dz
    of it between entry and exit with a chip thickness h > 0

        F_t = (Ktc h + Kte) dz against its motion,   F_r = (Krc h + Kre) dz towards the axis,   F_a = (Kac h + Kae) dz
        h   = min over m of [m chip_load sin v + R(φ - v) - R(φ - v - 2πm/teeth)]
        R(u) = runout_offset cos(runout_angle + u)

    F_a acts on the tool along the spindle, out of the work.  Without a chip the edge has no force either.  Sums over
    the engaged part of each edge are closed forms; with run-out the minimizing m is chosen for each of the `slices` of
    an edge, which leaves an error of about 0.1 % with five of them.
        mean torque · ω = Ktc · (volume per second) + Kte · (cutting speed) · teeth · axial_depth · (exit - entry) / 2π

    Entry and exit are 0 and π in a slot; with a radial_depth up milling cuts from 0 to arccos(1 - 2 radial_depth /
    diameter), down milling over the same angle up to π, a symmetric face cut π/2 ∓ arcsin(radial_depth / diameter).
    Alternatively, `entry` and `exit` specify them directly.
    When to use: for forces with a worn or rubbing edge, for run-out, for a `MillingCut` that may lose contact.
    Not suitable for unequal pitch, or within c²/2R of entry and exit, where the path of a tooth is no longer a circle.
    Raises ParameterError for coefficients outside the range of real materials, usually the result of a wrong unit.
    Source: Budak, Altintas & Armarego 1996; run-out Kline & DeVor 1983.
    """

    diameter: Number = parameter("m", "of the tool", above=0, most=1)
    axial_depth: Number = parameter("m", "depth of cut along the spindle", above=0)
    flute_length: Number | None = parameter(
        "m", "length of the edges; absent: they are long enough", above=0, default=None
    )
    radial_depth: Number | None = parameter(
        "m", "width of cut across the feed; absent: a slot, the whole diameter", above=0, default=None
    )
    milling: str = choice(
        "whether the chip starts thin (up), ends thin (down), or the tool stands in the middle of the width",
        options=("up", "down", "symmetric"),
        default="up",
    )
    entry: Number | None = parameter(
        "rad", "angle at which the chip begins; absent: by the width", least=0, below=3.15, default=None
    )
    exit: Number | None = parameter(
        "rad", "angle at which it ends; absent: by the width", above=0, below=3.15, default=None
    )
    helix_angle: Number = parameter("rad", "of the edges; 0 for straight ones", least=0, below=1.5, default=0)
    runout_offset: Number | None = parameter(
        "m", "distance from the axis of the tool to that of the spindle, ρ; absent: none", least=0, default=None
    )
    runout_angle: Number = parameter("rad", "from the first tooth to this offset, λ", default=0)
    Ktc: Number = parameter("N/m2", "tangential force per area of the chip", above=0)
    Krc: Number = parameter("N/m2", "radial force per area of the chip", least=0, default=0)
    Kac: Number = parameter("N/m2", "axial force per area of the chip", least=0, default=0)
    Kte: Number = parameter("N/m", "tangential force per length of edge", least=0, default=0)
    Kre: Number = parameter("N/m", "radial force per length of edge", least=0, default=0)
    Kae: Number = parameter("N/m", "axial force per length of edge", least=0, default=0)

    def check(self) -> None:
        """Raise ParameterError if the engagement is incomplete or specified in two ways."""
        if (self.entry is None) != (self.exit is None):
            raise ParameterError(
                "mechanistic_cutter.entry and .exit (rad) belong together: give both, or neither and a radial_depth"
            )
        if self.entry is not None and self.radial_depth is not None:
            raise ParameterError(
                "mechanistic_cutter has a radial_depth, from which entry and exit follow, as well as these: give one"
            )

    def rules(self) -> Iterator[Rule]:
        """Yield the validity rules: the cut must fit the tool, and the coefficients must be those of a material."""
        diameter, depth = self.diameter, self.axial_depth
        width, flute, entry, leave = self.radial_depth, self.flute_length, self.entry, self.exit
        if width is not None:
            yield Rule(
                width <= diameter,
                "the cut is not wider than the tool",
                lambda: Text(
                    f"mechanistic_cutter.radial_depth = {Quantity(width, 'm'):6 SI} is "
                    f"{Quantity(width - diameter, 'm'):3 SI} more than mechanistic_cutter.diameter = "
                    f"{Quantity(diameter, 'm'):6 SI}: at most {Quantity(diameter, 'm'):6 SI}, or leave it out for a "
                    "slot"
                ),
            )
        if flute is not None:
            yield Rule(
                depth <= flute,
                "the cut is not deeper than the edges are long",
                lambda: Text(
                    f"mechanistic_cutter.axial_depth = {Quantity(depth, 'm'):6 SI} is "
                    f"{Quantity(depth - flute, 'm'):3 SI} more than mechanistic_cutter.flute_length = "
                    f"{Quantity(flute, 'm'):6 SI}: at most {Quantity(flute, 'm'):6 SI}, in two cuts or with a longer "
                    "tool"
                ),
            )
        if entry is not None and leave is not None:
            yield Rule(
                leave > entry,
                "the chip ends after it begins",
                lambda: Text(
                    f"mechanistic_cutter.exit = {Quantity(leave, 'rad'):6} must be > mechanistic_cutter.entry = "
                    f"{Quantity(entry, 'rad'):6}: both from 0 (along the normal) to π (against it)"
                ),
            )
        yield fits_slices("mechanistic_cutter", self.edge())
        yield from material_rules(self, ("Ktc", "Krc", "Kac"), ("Kte", "Kre", "Kae"))

    def edge(self) -> Edge:
        """Return the edges with the parameters of this cutter."""
        entry, leave = self.entry, self.exit
        if entry is None or leave is None:
            entry, leave = arc(self.milling, self.radial_depth, self.diameter)
        return Edge(
            self.teeth,
            self.slices,
            self.diameter,
            self.axial_depth,
            self.helix_angle,
            entry,
            leave,
            (self.Ktc, self.Krc, self.Kac),
            (self.Kte, self.Kre, self.Kae),
            None if self.runout_offset is None else (self.runout_offset, self.runout_angle),
            self.flute_length,
        )

    def forces(self, angle: Number, chip_load: Number) -> tuple[Number, Number, Number]:
        """Evaluate the equations in the class docstring at the spindle `angle` in rad, which may exceed a turn."""
        found = self._static(angle, chip_load)
        return found.feed, found.normal, found.axial

    def torque(self, angle: Number, chip_load: Number) -> Number:
        """Return diameter / 2 times the tangential forces of all teeth, N m."""
        return self._static(angle, chip_load).torque

    def _static(self, angle: Number, chip_load: Number) -> Cut:
        # with run-out a tooth may miss the surface of the last one and cut that of any tooth within a turn
        surfaces = 1 if self.runout_offset is None else self.teeth
        steps = [(float(m) * chip_load, 0.0) for m in range(1, surfaces + 1)]
        # no sweep: the forces at this angle, not their mean over a substep
        return cut(self.edge(), angle, 0.0, steps)


class Oblique(NamedTuple):
    """The cutting coefficients of an oblique edge, N/m2."""

    Ktc: float
    Krc: float
    Kac: float


def oblique(
    shear_stress: float, shear_angle: float, friction_angle: float, rake_angle: float, inclination: float
) -> Oblique:
    """Return the cutting coefficients of a helical edge from orthogonal cutting data (Armarego's transformation).

        tan β_n = tan β_a cos i,   q = √(cos²(φ + β_n - α) + tan²i sin²β_n)
        Ktc = τ/sin φ · (cos(β_n - α) + tan²i sin β_n) / q
        Krc = τ/(sin φ cos i) · sin(β_n - α) / q
        Kac = τ/sin φ · (cos(β_n - α) tan i - tan i sin β_n) / q

    shear_stress    τ, N/m2
    shear_angle     φ, rad
    friction_angle  β_a, rad
    rake_angle      α, the normal rake angle, rad
    inclination     i, of the edge, rad: the helix angle; the chip flows at the same angle (Stabler's rule)

    Source: Budak, Altintas & Armarego 1996.
    """
    sine, slope = float(ops.sin(shear_angle)), float(ops.tan(inclination))
    normal = float(ops.atan(ops.tan(friction_angle) * ops.cos(inclination)))
    lean, drag = float(ops.cos(normal - rake_angle)), float(ops.sin(normal))
    across = float(ops.cos(shear_angle + normal - rake_angle))
    q = float(ops.sqrt(across * across + slope * drag * slope * drag))
    stress = shear_stress / (sine * q)
    return Oblique(
        Ktc=stress * (lean + slope * slope * drag),
        Krc=stress * float(ops.sin(normal - rake_angle)) / float(ops.cos(inclination)),
        Kac=stress * slope * (lean - drag),
    )

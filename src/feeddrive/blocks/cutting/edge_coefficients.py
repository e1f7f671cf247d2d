"""The force coefficients of a cutting edge that does not turn out of its chip: of a turning tool, of a drill."""

from collections.abc import Iterator, Sequence
from typing import Any

from feeddrive.blocks.cutting.engagement import edge_force
from feeddrive.language import ops
from feeddrive.language.block import Block, Number, Rule, parameter
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.text import Text

# N/m2: from foam to the hardest alloys; excludes 600 N/mm2 written as 600 N/m2
_CUTTING = 1e6, 1e11
# N/m: excludes 27.7 N/mm written as 27.7 N/m
_EDGE = 100.0, 1e6


class EdgeCoefficients(Block):
    """The force of an edge along its cutting velocity and normal to it, by chip area and by length of the edge.

        F_t = Ktc · (area of the chip) + Kte · (length of the edge)      against the cutting velocity
        F_f = Kfc · (area of the chip) + Kfe · (length of the edge)      normal to the edge, against the feed

    The area of the chip is its thickness h times the width of cut b, which is the length of the edge.
    Raises ParameterError for coefficients outside the range of real materials, usually the result of a wrong unit.
    Source: Altintas, Manufacturing Automation (2nd ed. 2012), chapter 2, mechanistic modeling of cutting forces.
    """

    Ktc: Number = parameter("N/m2", "tangential force per area of the chip", above=0)
    Kfc: Number = parameter("N/m2", "force normal to the edge per area of the chip", least=0, default=0)
    Kte: Number = parameter("N/m", "tangential force per length of edge", least=0, default=0)
    Kfe: Number = parameter("N/m", "force normal to the edge per length of edge", least=0, default=0)

    def rules(self) -> Iterator[Rule]:
        """Yield the validity rules: the coefficients are those of a material."""
        yield from material_rules(self, ("Ktc", "Kfc"), ("Kte", "Kfe"))

    def forces(self, chip: Any, length: Any) -> tuple[Any, Any]:
        """Return F_t and F_f in N for an area of the chip in m2 and a length of the edge in m."""
        return edge_force(self.Ktc, self.Kte, chip, length), edge_force(self.Kfc, self.Kfe, chip, length)


def material_rules(block: Block, cutting: Sequence[str], edge: Sequence[str]) -> Iterator[Rule]:
    """Yield the rules that coefficients, N/m2 in `cutting` and N/m in `edge`, are 0 or those of a real material."""
    for name in cutting:
        yield _material(block.kind, name, getattr(block, name), "N/m2", "N_per_mm2", "N/mm2", _CUTTING)
    for name in edge:
        yield _material(block.kind, name, getattr(block, name), "N/m", "N_per_mm", "N/mm", _EDGE)


def _material(kind: str, name: str, value: Any, unit: str, key: str, other: str, bounds: tuple[float, float]) -> Rule:
    """Return the rule that a coefficient is 0 or in the range of real materials, from foam to the hardest alloys."""
    least, most = bounds
    factor = 1e6 if other == "N/mm2" else 1e3

    def quantity(size: float, *, bare: bool = False) -> str:
        return f"{Quantity(size, unit, stays=True, bare=bare):6 SI}"

    def refusal() -> Text:
        refused = (
            f"{kind}.{name} = {quantity(value)} is that of no material ({quantity(least, bare=True)} .. "
            f"{quantity(most)} or 0)"
        )
        if value < least:
            plain = number(value, 6)
            return Text(
                f"{refused}; if {plain} is in {other}, write {name}_{key} = {plain} in the file, "
                f"{name}={number(value * factor, 6)} in Python"
            )
        return Text(f"{refused}; if it was {quantity(value / factor)}, leave the unit out of the key")

    within = ops.both(value >= least, value <= most)
    return Rule(ops.either(ops.equal(value, 0.0), within), f"{name} is that of a material", refusal)

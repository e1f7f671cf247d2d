"""The check that a plant has the spring between motor and load body on which a force block acts."""

from feeddrive.blocks.families import Plant
from feeddrive.language.errors import StructureError


def check_spring(kind: str, plant: Plant) -> None:
    """Raise StructureError if the plant has no `stiffness` between two bodies."""
    if getattr(plant, "stiffness", None) is None:
        raise StructureError(
            f"axis.forces: '{kind}' acts on the spring between motor and load, but the plant '{plant.kind}' has no "
            f"spring; take a plant with a stiffness, such as two_mass or three_mass_chain"
        )

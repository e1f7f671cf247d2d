"""The Stribeck curve shared by the friction laws."""

from collections.abc import Iterator

from feeddrive.language import ops
from feeddrive.language.block import Number, Rule
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text


def stribeck_level(
    velocity: Number, coulomb: Number, breakaway: Number, stribeck_velocity: Number, exponent: int = 2
) -> Number:
    """Return coulomb + (breakaway - coulomb) e^-|v / stribeck_velocity|^exponent in N.

    Source: Armstrong-Hélouvry et al. 1994.
    """
    ratio = velocity / stribeck_velocity
    if exponent == 1:
        return coulomb + (breakaway - coulomb) * ops.exp(-ops.absolute(ratio))
    return coulomb + (breakaway - coulomb) * ops.exp(-(ratio * ratio))


def levels(
    kind: str, coulomb_name: str, coulomb: Number | None, breakaway_name: str, breakaway: Number | None
) -> Iterator[Rule]:
    """Yield the validity rule that the breakaway level is not below the Coulomb level, if both are specified."""
    if coulomb is not None and breakaway is not None:
        yield Rule(
            breakaway >= coulomb,
            f"{breakaway_name} is at least {coulomb_name}",
            lambda: Text(
                f"{kind}.{breakaway_name} = {Quantity(breakaway, 'N'):6} must be >= {kind}.{coulomb_name} = "
                f"{Quantity(coulomb, 'N'):6}"
            ),
        )


def check_pair(kind: str, first: str, one: Number | None, second: str, other: Number | None) -> None:
    """Raise ParameterError if only one of two parameters is specified."""
    if (one is None) != (other is None):
        present, missing = (first, second) if other is None else (second, first)
        raise ParameterError(f"{kind}.{present} is given without {kind}.{missing}: give both or neither")

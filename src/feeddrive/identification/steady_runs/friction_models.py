"""The friction curves that are compared: columns that are linear in all but the Stribeck velocity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from feeddrive.blocks.families import Friction
from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.blocks.friction.directional import Directional
from feeddrive.blocks.friction.directional_stribeck import DirectionalStribeck
from feeddrive.blocks.friction.stribeck import Stribeck


@dataclass(frozen=True)
class Candidate:
    """A friction curve by name; `exponent` is that of its Stribeck part, 0 for none."""

    name: str
    directional: bool = False
    exponent: int = 0
    offset: bool = False
    twice: bool = False  # two curves that share nothing: compared, but no block holds it

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names in the order of the columns; those of a Stribeck curve end with its velocity."""
        if self.twice:
            sides = ("positive", "negative")
            return tuple(
                f"{name}_{s}" for s in sides for name in ("coulomb", "breakaway", "viscous", "stribeck_velocity")
            )
        levels = ("coulomb", "breakaway") if self.exponent else ("coulomb",)
        if self.directional:
            names = tuple(f"{level}_{side}" for level in levels for side in ("positive", "negative"))
            names += ("viscous",) if self.exponent else ("viscous_positive", "viscous_negative")
        else:
            names = (*levels, "viscous")
        names += ("offset",) if self.offset else ()
        return (*names, "stribeck_velocity") if self.exponent else names

    def columns(self, v: np.ndarray, stribeck_velocity: float = 1.0) -> np.ndarray:
        """d force / d parameter for all linear parameters, shape (n, p)."""
        sides = (np.where(v > 0.0, 1.0, 0.0), np.where(v < 0.0, -1.0, 0.0))
        if not self.directional:
            sides = (sides[0] + sides[1],)
        if self.exponent:
            fall = np.exp(-(np.abs(v / stribeck_velocity) ** self.exponent))
            columns = [side * (1.0 - fall) for side in sides] + [side * fall for side in sides] + [v]
        elif self.directional:
            columns = [*sides, *(np.abs(side) * v for side in sides)]
        else:
            columns = [*sides, v]
        if self.offset:
            columns.append(np.ones_like(v))
        return np.column_stack(columns)

    def slope(self, v: np.ndarray, values: dict[str, float]) -> np.ndarray:
        """d force / d stribeck_velocity, shape (n,)."""
        vs, q = values["stribeck_velocity"], self.exponent
        ratio = np.abs(v / vs) ** q
        names = ("_positive", "_negative") if self.directional else ("", "")
        excess = [values[f"breakaway{name}"] - values[f"coulomb{name}"] for name in names]
        return np.where(v > 0.0, excess[0], -excess[1]) * np.exp(-ratio) * q * ratio / vs

    def is_sound(self, values: dict[str, float]) -> bool:
        """Whether no level is negative and no breakaway level is below its Coulomb level."""
        ends = ("_positive", "_negative") if self.directional or self.twice else ("",)
        levels = all(values[f"coulomb{end}"] >= 0.0 for end in ends)
        if not self.exponent:
            return levels
        return levels and all(values[f"breakaway{end}"] >= values[f"coulomb{end}"] for end in ends)

    def block(self, values: dict[str, float]) -> Friction:
        """The friction block with these values; a negative viscous part becomes 0."""
        given = {name: value for name, value in values.items() if name != "offset"}
        given |= {name: max(0.0, value) for name, value in given.items() if name.startswith("viscous")}
        if self.exponent:
            kind = DirectionalStribeck if self.directional else Stribeck
            return kind(**given, exponent=self.exponent)
        return Directional(**given) if self.directional else Coulomb(**given)


CANDIDATES = (
    Candidate("coulomb and viscous"),
    Candidate("coulomb and viscous, offset", offset=True),
    Candidate("directional", directional=True),
    *(
        Candidate(f"{name}, {curve}", directional=directional, exponent=exponent, offset=offset)
        for exponent, curve in ((1, "exponential"), (2, "gaussian"))
        for name, directional, offset in (
            ("stribeck", False, False),
            ("stribeck with offset", False, True),
            ("directional stribeck", True, False),
        )
    ),
)
# what no block can hold: if it is much better, the result says so
SEPARATE = (Candidate("two curves, exponential", exponent=1, twice=True),
            Candidate("two curves, gaussian", exponent=2, twice=True))  # fmt: skip

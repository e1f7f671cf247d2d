"""In which quantities a drive is described: along the table, or at a shaft."""

from __future__ import annotations

import math
from dataclasses import dataclass

from feeddrive.language.errors import ParameterError


@dataclass(frozen=True)
class Frame:
    """The SI units of position, velocity, force, inertia and viscous friction, and their sizes at a table.

    A shaft is described in rad, N m and kg m² until its `lever` r is known, the table's travel per rad:

        x = r θ,   F = τ / r,   m = J / r²,   b = c / r²,   r = lead / (2π gear)

    A lead is never guessed: without one a result stays rotary, and only its use as a block of an axis is refused.
    """

    name: str
    position: str
    velocity: str
    force: str
    inertia: str
    viscous: str


TABLE = Frame("table", "m", "m/s", "N", "kg", "N s/m")
SHAFT = Frame("shaft", "rad", "rad/s", "N m", "kg m2", "N m s/rad")


def frame_of(rotary: bool) -> Frame:
    """The frame of a shaft or of a table."""
    return SHAFT if rotary else TABLE


def lever(lead: float, gear: float = 1.0) -> float:
    """Travel of the table per rad of the motor, m/rad; lead in m, gear in turns of the motor per turn of the screw."""
    if not (math.isfinite(lead) and lead > 0.0 and math.isfinite(gear) and gear > 0.0):
        raise ParameterError(f"lead = {lead:g} m and gear = {gear:g} must be > 0")
    return lead / (2.0 * math.pi * gear)


def power(unit: str) -> int:
    """The power n with which a rotary quantity of that unit goes to the table: value · lever^n."""
    powers = {"rad": 1, "rad/s": 1, "N m": -1, "kg m2": -2, "N m s/rad": -2}
    return powers[unit]


def table_unit(unit: str) -> str:
    """The unit at the table of a quantity with that unit at a shaft."""
    pairs = {"rad": "m", "rad/s": "m/s", "N m": "N", "kg m2": "kg", "N m s/rad": "N s/m"}
    return pairs[unit]


def require_table(frame: Frame, what: str) -> None:
    """Raise ParameterError for a result at a shaft."""
    if frame is SHAFT:
        raise ParameterError(
            f"{what} is in {frame.force} and {frame.velocity} of a shaft; give the screw's lead with  "
            f".at_table(lead=..., gear=...)  before it becomes part of an axis"
        )

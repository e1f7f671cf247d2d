"""An estimated parameter with its standard errors, in units of a table or of a shaft."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from feeddrive.blocks.plant.transmission import radians_per_metre
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import UNIT, Cell, Column, Table
from feeddrive.language.text import Text

NORMAL = 1.959963985  # half width of a 95 % interval of a normal error, in standard errors
SIGNIFICANT = 3.0  # standard errors beyond which an offset is not 0
LEAST_PULL = 0.05  # share of Coulomb friction beyond which an offset is a force of the axis


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
# an axis that turns by itself, a rotary table: its blocks hold the same numbers, no lead is wanted
TURNING = Frame("rotary axis", "rad", "rad/s", "N m", "kg m2", "N m s/rad")


def frame_of(rotary: bool) -> Frame:
    """Return the frame of a shaft or of a table."""
    return SHAFT if rotary else TABLE


def lever(lead: float, gear: float = 1.0) -> float:
    """Return the travel of the table per rad of the motor, m/rad; lead in m, gear in turns of the motor per turn of the
    screw.
    """
    if not (math.isfinite(lead) and lead > 0.0 and math.isfinite(gear) and gear > 0.0):
        raise ParameterError(f"lead = {Quantity(lead, 'm', stays=True):6 SI} and gear = {Quantity(gear):6} must be > 0")
    return 1.0 / (gear * float(radians_per_metre(lead)))


def power(unit: str) -> int:
    """Return the power n that converts a rotary quantity of that unit to the table: value · lever^n."""
    powers = {"rad": 1, "rad/s": 1, "N m": -1, "kg m2": -2, "N m s/rad": -2}
    return powers[unit]


def table_unit(unit: str) -> str:
    """Return the unit at the table of a quantity with that unit at a shaft."""
    pairs = {"rad": "m", "rad/s": "m/s", "N m": "N", "kg m2": "kg", "N m s/rad": "N s/m"}
    return pairs[unit]


def require_table(frame: Frame, what: str) -> None:
    """Raise ParameterError for a result at a shaft."""
    if frame is SHAFT:
        raise ParameterError(
            f"{what} is in {frame.force} and {frame.velocity} of a shaft; give the screw's lead with  "
            f".at_table(lead=..., gear=...)  before it becomes part of an axis"
        )


@dataclass(frozen=True)
class Estimate:
    """A value in SI with two standard errors.

    error  robust to autocorrelation and changing variance of the residual: the one to use
    ols    as if the residual were white, s² (XᵀX)⁻¹: what most papers print
    """

    name: str
    value: float
    unit: str
    error: float
    ols: float

    @property
    def quantity(self) -> Quantity:
        """The value with its unit and its robust standard error."""
        return Quantity(self.value, self.unit, self.error)

    @property
    def interval(self) -> tuple[float, float]:
        """The interval that contains the true value with 95 %, if the model holds."""
        return self.value - NORMAL * self.error, self.value + NORMAL * self.error

    def at_table(self, lever: float) -> Estimate:
        """Return a quantity of a shaft, referred to the table."""
        factor = lever ** power(self.unit)
        unit = table_unit(self.unit)
        return replace(self, value=factor * self.value, unit=unit, error=factor * self.error, ols=factor * self.ols)


def pulls(offset: Estimate, coulomb: float) -> bool:
    """True if an offset is a force of the axis: more than 3 standard errors and 5 % of Coulomb friction.

    A smaller one cannot move the axis, and counts of the encoder at rest make it too: their error is the same for
    hundreds of rows, more than standard errors account for.
    """
    return abs(offset.value) > max(SIGNIFICANT * offset.error, LEAST_PULL * coulomb)


def estimates_table(title: str, estimates: tuple[Estimate, ...]) -> Table:
    """Tabulate estimates, a row for each parameter."""
    return Table(title, ESTIMATE_COLUMNS, [estimate_row(estimate) for estimate in estimates])


ESTIMATE_COLUMNS = (
    "parameter",
    "unit",
    Column("value", form="6"),
    Column("standard error", form="3"),
    Column("ols", form="3"),
    "95 % interval",
)


def estimate_row(estimate: Estimate) -> list[Cell]:
    """Return the cells of `ESTIMATE_COLUMNS`."""
    error, ols = Quantity(estimate.error, estimate.unit), Quantity(estimate.ols, estimate.unit)
    low, high = (Quantity(bound, estimate.unit, form="4", bare=True) for bound in estimate.interval)
    return [estimate.name, UNIT, estimate.quantity, error, ols, Text(f"{low} .. {high}")]

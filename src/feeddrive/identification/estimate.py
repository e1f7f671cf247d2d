"""A parameter that was estimated, with its standard errors."""

from __future__ import annotations

from dataclasses import dataclass, replace

from feeddrive.identification.frame import power, table_unit
from feeddrive.language.table import Table

NORMAL = 1.959963985  # half width of a 95 % interval of a normal error, in standard errors


@dataclass(frozen=True)
class Estimate:
    """A value in SI with two standard errors.

    error  robust to the residual's autocorrelation and to its changing size: the one to use
    ols    as if the residual were white, s² (XᵀX)⁻¹: what most papers print
    """

    name: str
    value: float
    unit: str
    error: float
    ols: float

    @property
    def interval(self) -> tuple[float, float]:
        """In which the true value lies with 95 %, if the model holds."""
        return self.value - NORMAL * self.error, self.value + NORMAL * self.error

    def at_table(self, lever: float) -> Estimate:
        """The same quantity of a shaft, seen at the table."""
        factor = lever ** power(self.unit)
        unit = table_unit(self.unit)
        return replace(self, value=factor * self.value, unit=unit, error=factor * self.error, ols=factor * self.ols)


def estimates_table(title: str, estimates: tuple[Estimate, ...]) -> Table:
    """One row a parameter."""
    rows = [
        [each.name, each.unit, f"{each.value:.6g}", f"{each.error:.3g}", f"{each.ols:.3g}",
         f"{each.interval[0]:.4g} .. {each.interval[1]:.4g}"]
        for each in estimates
    ]  # fmt: skip
    return Table(title, ["parameter", "unit", "value", "standard error", "ols", "95 % interval"], rows)

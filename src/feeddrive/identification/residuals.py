"""What a fit leaves over, and what that says about the model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from feeddrive.language.table import Result, Table

SHOWN_LAGS = (1, 2, 5, 10, 20)


@dataclass(frozen=True, eq=False, repr=False)
class Residuals(Result):
    """Measured - fitted, shape (n,), over the rows that were fitted.

    norm       √(rᵀr);  relative: over that of the measured values
    condition  number of the columns as they are, in SI
    """

    values: np.ndarray
    measured: np.ndarray
    condition: float
    unit: str

    @property
    def norm(self) -> float:
        """√(rᵀr)."""
        return float(np.linalg.norm(self.values))

    @property
    def relative(self) -> float:
        """|r| / |y|."""
        return self.norm / float(np.linalg.norm(self.measured))

    @property
    def deviation(self) -> float:
        """Standard deviation, in the unit of the force."""
        return float(np.std(self.values, ddof=1))

    def autocorrelation(self, lag: int) -> float:
        """Σ r(k) r(k - lag) / Σ r(k)²; within ±2/√n for a white residual."""
        r = self.values
        return float(r[lag:] @ r[: r.size - lag]) / float(r @ r)

    @property
    def white(self) -> bool:
        """Whether the first autocorrelation is within what chance gives in 95 % of white residuals."""
        return abs(self.autocorrelation(1)) < 1.96 / np.sqrt(self.values.size)

    def table(self) -> Table:
        """Sizes and autocorrelation."""
        rows = [
            ["norm", self.unit, f"{self.norm:.6g}"],
            ["relative to the measured force", "%", f"{100.0 * self.relative:.4g}"],
            ["standard deviation", self.unit, f"{self.deviation:.4g}"],
            ["condition of the columns", "", f"{self.condition:.6g}"],
        ]
        lags = [lag for lag in SHOWN_LAGS if lag < self.values.size]
        rows += [[f"autocorrelation at lag {lag}", "", f"{self.autocorrelation(lag):.2f}"] for lag in lags]
        what = "white" if self.white else "not white: errors as if it were (ols) are too small"
        return Table(f"residual of {self.values.size} rows, {what}", ["", "unit", "value"], rows)

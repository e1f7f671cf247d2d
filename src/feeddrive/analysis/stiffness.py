"""Dynamic stiffness: which force on the table moves it by how much, in closed loop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from feeddrive.analysis.conversion import as_frf
from feeddrive.analysis.extremum import least
from feeddrive.language.errors import ParameterError
from feeddrive.language.table import Result, Table
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.linearize import StateSpace

NAMED = (1.0, 10.0, 100.0, 1000.0)  # Hz, at which the table states it


@dataclass(frozen=True, eq=False, repr=False)
class Stiffness(Result):
    """|force/displacement| in N/m at `frequency` in Hz, both of shape (n,); shown in N/um.

    `static` is its limit at 0 Hz, infinite with integral action, None where it is not known.
    """

    frequency: np.ndarray
    magnitude: np.ndarray
    static: float | None = None

    @property
    def minimum(self) -> float:
        """The least stiffness, N/m: where the axis is softest."""
        return float(np.exp(self._least()[1]))

    @property
    def minimum_frequency(self) -> float:
        """Where it is least, Hz."""
        return float(np.exp(self._least()[0]))

    def _least(self) -> tuple[float, float]:
        return least(np.log(self.frequency), np.log(self.magnitude))

    def at(self, frequency: float) -> float:
        """N/m at a frequency in Hz, straight between lines on log-log paper. Raises ParameterError outside of them."""
        if not self.frequency[0] <= frequency <= self.frequency[-1]:
            raise ParameterError(
                f"frequency {frequency:g} Hz is outside of the stiffness's lines, "
                f"{self.frequency[0]:g} to {self.frequency[-1]:g} Hz"
            )
        return float(np.exp(np.interp(np.log(frequency), np.log(self.frequency), np.log(self.magnitude))))

    def table(self, frequencies: Sequence[float] = NAMED) -> Table:
        """Static, minimum, and at named frequencies as far as they were computed."""
        rows = []
        if self.static is not None:
            rows.append(["static", "0", f"{1e-6 * self.static:.4g}" if np.isfinite(self.static) else "infinite"])
        rows.append(["minimum", f"{self.minimum_frequency:.4g}", f"{1e-6 * self.minimum:.4g}"])
        inside = [f for f in frequencies if self.frequency[0] <= f <= self.frequency[-1]]
        rows += [["dynamic", f"{f:g}", f"{1e-6 * self.at(f):.4g}"] for f in inside]
        return Table("dynamic stiffness of the closed loop", ["stiffness", "Hz", "N/um"], rows)


def stiffness(compliance: FRF | Any, static: float | None = None, *, frequency: np.ndarray | None = None) -> Stiffness:
    """The inverse of a closed-loop compliance in m/N, modelled or measured; `static` in N/m if it is known.

    Raises ParameterError if there are no lines or the compliance is zero on one, where the stiffness is not a number.
    """
    compliance = as_frf(compliance, frequency)
    magnitude = compliance.magnitude
    if not magnitude.size:
        raise ParameterError("a stiffness needs at least one line of compliance")
    if np.any(magnitude == 0.0):
        where = compliance.frequency[np.argmin(magnitude)]
        raise ParameterError(f"the compliance is zero at {where:g} Hz: leave out this line")
    return Stiffness(compliance.frequency, 1.0 / magnitude, static)


def static_stiffness(model: StateSpace) -> float:
    """The stiffness at 0 Hz in N/m of a model from `load_force` to a position: infinite with integral action.

    1/|C (I - A)⁻¹ B + D|; a compliance below 1e-9 of what the terms of that sum amount to is rounding and counts as 0.
    Raises ParameterError for a model that drifts away under a constant force.
    """
    n = model.A.shape[0]
    try:
        moved = np.linalg.solve(np.eye(n) - model.A, model.B[:, 0])
    except np.linalg.LinAlgError:
        raise ParameterError(
            "the model drifts away under a constant force: close its position loop, or ask for its dynamic stiffness"
        ) from None
    compliance = float(model.C[0] @ moved + model.D[0, 0])
    scale = float(np.sum(np.abs(model.C[0] * moved)) + abs(model.D[0, 0]))
    cancelled = np.linalg.norm(model.B[:, 0]) * np.linalg.norm(model.C[0])
    return float("inf") if abs(compliance) <= 1e-9 * max(scale, cancelled) else 1.0 / abs(compliance)

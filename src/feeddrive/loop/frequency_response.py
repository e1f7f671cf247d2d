"""A frequency response: complex numbers over frequency, the same for a measured and a modelled system."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from feeddrive.language.errors import ParameterError
from feeddrive.language.table import Result, Table


@dataclass(frozen=True, eq=False, repr=False)
class FRF(Result):
    """response(f) from `input` to `output` at `frequency` in Hz, both of shape (n,); `unit` is output over input in SI.

    `coherence`, shape (n,), comes with a measured one.  Arithmetic with numbers and other FRFs on the same frequencies
    works as on arrays.  Raises ParameterError for frequencies that do not rise or are not positive, and for NaN.
    """

    frequency: np.ndarray
    response: np.ndarray
    input: str = "input"
    output: str = "output"
    unit: str = ""
    sample_time: float | None = None
    coherence: np.ndarray | None = None

    def __post_init__(self) -> None:
        frequency, response = np.asarray(self.frequency, float), np.asarray(self.response, complex)
        if frequency.ndim != 1 or frequency.shape != response.shape:
            raise ParameterError(
                f"an FRF needs one response for each frequency, not {response.shape} for {frequency.shape}"
            )
        if frequency.size and (frequency[0] <= 0.0 or np.any(np.diff(frequency) <= 0.0)):
            raise ParameterError("the frequencies of an FRF must be positive and rise from line to line")
        if not (np.all(np.isfinite(frequency)) and np.all(np.isfinite(response))):
            raise ParameterError(f"the FRF from {self.input} to {self.output} holds numbers that are not finite")
        object.__setattr__(self, "frequency", frequency)
        object.__setattr__(self, "response", response)

    @property
    def magnitude(self) -> np.ndarray:
        """|response|."""
        return np.abs(self.response)

    @property
    def phase_deg(self) -> np.ndarray:
        """Phase in degrees, continuous from the first line on."""
        return np.degrees(np.unwrap(np.angle(self.response)))

    def _with(self, response: Any, unit: str) -> FRF:
        return replace(self, response=response, unit=unit, coherence=None)

    def _other(self, other: Any) -> Any:
        if isinstance(other, FRF):
            if other.frequency.shape != self.frequency.shape or np.any(other.frequency != self.frequency):
                raise ParameterError("two FRFs on different frequencies cannot be combined")
            return other.response
        return other

    def __mul__(self, other: Any) -> FRF:
        return self._with(self.response * self._other(other), self.unit)

    __rmul__ = __mul__

    def __add__(self, other: Any) -> FRF:
        return self._with(self.response + self._other(other), self.unit)

    __radd__ = __add__

    def __neg__(self) -> FRF:
        return self._with(-self.response, self.unit)

    def inverse(self) -> FRF:
        """From output to input."""
        parts = self.unit.split("/")
        unit = "/".join(reversed(parts)) if len(parts) == 2 else ""
        return replace(
            self, response=1.0 / self.response, unit=unit, input=self.output, output=self.input, coherence=None
        )

    def table(self) -> Table:
        """Magnitude and phase at up to twelve frequencies."""
        chosen = np.unique(np.linspace(0, self.frequency.size - 1, 12).astype(int)) if self.frequency.size else []
        rows = [
            [f"{self.frequency[i]:.5g}", f"{self.magnitude[i]:.4g}", f"{20 * np.log10(self.magnitude[i]):.2f}",
             f"{self.phase_deg[i]:.1f}"]
            for i in chosen
        ]  # fmt: skip
        title = f"{self.output} / {self.input} in {self.unit or '1'}, {self.frequency.size} lines"
        return Table(title, ["Hz", "magnitude", "dB", "deg"], rows)

    def plot(self) -> Any:
        """Bode plot as a matplotlib figure."""
        from feeddrive.artefacts import plot

        return plot.bode(self)

    def to_pandas(self) -> Any:
        """A DataFrame with real and imaginary part over frequency in Hz."""
        from feeddrive.artefacts.plot import frames

        columns = {"real": np.real(self.response), "imaginary": np.imag(self.response)}
        return frames.frame(self.frequency, columns, "frequency")

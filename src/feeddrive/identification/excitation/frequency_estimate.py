"""An estimated frequency response with its variance, coherence and distortion levels."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from feeddrive.language.errors import LogError, ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column, Result, Table
from feeddrive.language.text import Text
from feeddrive.loop.frequency_response import FRF

_DOUBT = 0.1  # relative variance of the input; a line above it is left out


@dataclass(frozen=True, eq=False)
class Level:
    """The amplitude of noise or distortion in the output, RMS over neighboring lines.

    frequency  Hz, shape (m,)
    output     amplitude at the output, in its unit
    response   amplitude over the exciting input, in the unit of the frequency response; NaN outside the band
    """

    frequency: np.ndarray
    output: np.ndarray
    response: np.ndarray


@dataclass(frozen=True, eq=False, repr=False)
class FrequencyEstimate(Result):
    """An FRF with coherence and variance, the estimator used, and the degrees of freedom of the variance.

    frf      `frf.variance` is E|dG|² of the response: noise, and nonlinear distortion if `total` is true
    method   description of the estimator
    freedom  complex degrees of freedom of the variance on each line, shape (n,)
    noise    E|dG|² due to noise only, shape (n,)
    total    True if `frf.variance` includes nonlinear distortion besides noise
    levels   "odd", "even", "nonlinear", "noise": levels over frequency, as far as the excitation reveals them
    counts   averages, periods, realisations, ... by name
    remarks  remarks on the validity of the estimate
    """

    frf: FRF
    method: str
    freedom: np.ndarray
    noise: np.ndarray
    total: bool = False
    levels: dict[str, Level] = field(default_factory=dict[str, Level])
    counts: dict[str, int] = field(default_factory=dict[str, int])
    remarks: tuple[str, ...] = ()

    @property
    def frequency(self) -> np.ndarray:
        """The frequencies of the lines, Hz."""
        return self.frf.frequency

    def lines(self, kept: np.ndarray, *remarks: str) -> FrequencyEstimate:
        """Return the estimate on the lines where `kept` (bool, shape (n,)) is True, with further remarks."""
        f = self.frf

        def of(values: np.ndarray | None) -> np.ndarray | None:
            return None if values is None else values[kept]

        frf = replace(
            f,
            frequency=f.frequency[kept],
            response=f.response[kept],
            coherence=of(f.coherence),
            variance=of(f.variance),
        )
        return replace(
            self, frf=frf, freedom=self.freedom[kept], noise=self.noise[kept], remarks=(*self.remarks, *remarks)
        )

    def where_told(self, doubt: np.ndarray) -> FrequencyEstimate:
        """Return the estimate on lines with sufficient excitation: `doubt`, the relative variance of the input, <= 0.1.

        The variance of a quotient is undefined if the denominator may be 0.  Raises LogError if no line is left.
        """
        kept = doubt <= _DOUBT
        if np.all(kept):
            return self
        f = self.frequency
        if not np.any(kept):
            raise LogError(
                f"between {Quantity(f[0], 'Hz', bare=True)} and {Quantity(f[-1], 'Hz')} the excitation does not exceed "
                "the noise of the input: measure again with more amplitude or longer"
            )
        left = f[~kept]
        return self.lines(
            kept,
            Text(
                f"{left.size} of {f.size} lines between {Quantity(left[0], 'Hz', bare=True)} and "
                f"{Quantity(left[-1], 'Hz')} are left out: the excitation does not exceed the noise of the input "
                "there; measure again with more amplitude, longer, or with a coarser resolution"
            ),
        )

    def radius(self, confidence: float = 0.95) -> np.ndarray:
        """Return the radius of the confidence disc around each response.

            r² = ν ((1 - p)^(-1/ν) - 1) · variance

        This is Fisher's distribution with 2 and 2ν degrees of freedom: |dG|² is exponential, the variance a mean.
        """
        if not 0.0 < confidence < 1.0:
            raise ParameterError(f"confidence = {Quantity(confidence):6} must be > 0 and < 1")
        assert self.frf.variance is not None
        return np.sqrt(fisher(confidence, self.freedom) * self.frf.variance)

    def table(self) -> Table:
        """Return a table of response, standard deviation, noise and coherence at up to twelve lines."""
        frf = self.frf
        assert frf.variance is not None
        assert frf.coherence is not None
        n = frf.frequency.size
        deviation, noise = (np.sqrt(variance) / frf.magnitude for variance in (frf.variance, self.noise))
        values = np.column_stack(
            [frf.frequency, frf.magnitude, np.radians(frf.phase_deg), deviation, noise, frf.coherence]
        )
        rows = values[np.unique(np.linspace(0, n - 1, 12).astype(int))].tolist()
        columns = [
            Column("frequency", "Hz", "5"),
            Column("magnitude", frf.unit or "1"),
            Column("phase", "rad", ".1f deg"),
            Column("deviation", "share", "3"),
            Column("by noise", "share", "3"),
            Column("coherence", form=".4f"),
        ]
        return Table(f"{frf.output} / {frf.input}, {n} lines; {self.method}", columns, rows)


def fisher(confidence: float, freedom: np.ndarray | float) -> np.ndarray:
    """Return the quantile of F(2, 2ν), in closed form."""
    nu = np.asarray(freedom, float)
    return nu * ((1.0 - confidence) ** (-1.0 / nu) - 1.0)

"""The amplitude spectrum of a signal, and its cumulative RMS over frequency."""

from dataclasses import dataclass

import numpy as np

from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity, signal_unit
from feeddrive.language.table import Column, Result, Table
from feeddrive.language.text import Text

LARGEST = 6  # lines that the table names


@dataclass(frozen=True, eq=False, repr=False)
class Spectrum(Result):
    """The one-sided amplitude spectrum and cumulative RMS of a signal by `frequency` in Hz, 0 to Nyquist, shape (m,).

    The spectrum of a sine whose frequency is that of a line equals its amplitude there.  The last value of
    `cumulative_rms` is the RMS of the whole signal.  All values are in `unit`, an SI unit.
    """

    name: str
    unit: str
    frequency: np.ndarray
    amplitude: np.ndarray
    cumulative_rms: np.ndarray

    @property
    def rms(self) -> float:
        """The RMS of the signal, including its mean."""
        return float(self.cumulative_rms[-1])

    def largest(self, count: int = LARGEST) -> list[tuple[float, float]]:
        """Return the frequency and amplitude of the largest peaks above 0 Hz, the largest first."""
        inner = self.amplitude[1:-1]
        peaks = 1 + np.flatnonzero((inner >= self.amplitude[:-2]) & (inner > self.amplitude[2:]))
        chosen = peaks[np.argsort(-self.amplitude[peaks], kind="stable")][:count]
        return [(float(self.frequency[i]), float(self.amplitude[i])) for i in chosen]

    def table(self) -> Table:
        """Return a table of the largest peaks, with the cumulative RMS up to each peak as a share of the total RMS."""
        rows, unit = [], signal_unit(self.unit)
        for frequency, amplitude in self.largest():
            gathered = float(self.cumulative_rms[np.searchsorted(self.frequency, frequency)])
            share = Quantity(gathered / self.rms, "share", form=".1f") if self.rms else None
            rows.append([frequency, amplitude, gathered, share])
        title = Text(f"{self.name.replace('_', ' ')}: RMS {Quantity(self.rms, self.unit, form=unit)}")
        columns = [
            Column("frequency", "Hz"),
            Column("amplitude", self.unit, unit),
            Column("RMS up to there", self.unit, unit),
            "of RMS",
        ]
        return Table(title, columns, rows)


def spectrum(
    values: np.ndarray, sample_time: float, *, name: str = "signal", unit: str = "", window: str = "hann"
) -> Spectrum:
    """Compute the amplitude spectrum of equidistant samples, shape (n,), n >= 2.

        amplitude(0) = |mean|,  amplitude(f) = c |Σ w (x - mean) e^(-j2πfkT)| / Σ w,  c = 2, and 1 at Nyquist
        cumulative_rms(f)² = Σ over lines up to f of c |Σ x e^(-j2πfkT)|² / n²

    window  "hann" (default) or "none".  It applies to the amplitudes, in which it limits the leakage of a signal that
            is not periodic, but not to the cumulative RMS, which satisfies Parseval's theorem exactly.

    Raises ParameterError for another window, fewer than two samples, or a value that is not finite.
    """
    values = np.asarray(values, dtype=float)
    n = values.size
    if values.ndim != 1 or n < 2:
        raise ParameterError(f"a spectrum needs one row of at least two samples, not an array of shape {values.shape}")
    if not np.all(np.isfinite(values)):
        raise ParameterError(f"{name} holds numbers that are not finite: it has no spectrum")
    if window not in ("hann", "none"):
        raise ParameterError(f"window = {window!r} must be one of hann, none")
    # periodic Hann window (n in the denominator): lines of a periodic signal leak to one neighbor on each side only
    weight = np.ones(n) if window == "none" else 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(n) / n)
    sides = np.full(n // 2 + 1, 2.0)
    # all other lines stand for f and -f
    sides[0] = 1.0
    if n % 2 == 0:
        sides[-1] = 1.0
    mean = float(np.mean(values))
    amplitude = sides * np.abs(np.fft.rfft(weight * (values - mean))) / np.sum(weight)
    amplitude[0] = abs(mean)
    power = sides * np.abs(np.fft.rfft(values) / n) ** 2
    return Spectrum(name, unit, np.fft.rfftfreq(n, sample_time), amplitude, np.sqrt(np.cumsum(power)))

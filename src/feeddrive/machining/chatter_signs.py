"""Signs of chatter in a force or a motion: lines beside the harmonics of the teeth, and samples once per tooth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from feeddrive.analysis.spectrum import Spectrum, spectrum
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity, signal_unit
from feeddrive.language.table import Column, Result, Table
from feeddrive.language.text import Text

_LINES = 2  # of the spectrum to each side of a harmonic that belong to it: the width of the window
_TEETH = 16  # at least
_STILL = 0.01  # of the swing within a tooth: samples that spread by less are one dot
_PLACES = 64  # in a tooth that are tried
_FALLS = 0.5  # of the spread of the first half: a second half that spreads by less dies out
_APART = 0.25  # of their spread: every second sample that spreads by less is one of two dots


@dataclass(frozen=True, eq=False, repr=False)
class ChatterSigns(Result):
    """Spectrum and once-per-tooth samples of a signal.

    harmonic   of each line: it belongs to a harmonic of the teeth, or with run-out of the spindle, bool
    passing    frequency of the teeth, Hz
    samples    value at the same angle of each tooth (of each turn, with run-out), SI
    swing      from the least to the largest value within a tooth, mean over the teeth, SI
    dots       1: all samples agree, the cut is stable; 2: every second one does, a flip; 0: a ring, a Hopf chatter
    """

    spectrum: Spectrum
    harmonic: np.ndarray
    passing: float
    samples: np.ndarray
    swing: float
    dots: int

    @property
    def chatter(self) -> float:
        """The strongest line beside all harmonics, Hz; for a stable cut it means nothing."""
        beside = np.where(self.harmonic, 0.0, self.spectrum.amplitude)
        return float(self.spectrum.frequency[np.argmax(beside)])

    def sentence(self) -> str:
        """The interpretation of the samples as a sentence."""
        spread = float(np.std(self.samples)) / self.swing if self.swing else 0.0
        phrase = {
            1: "no chatter: samples once per tooth agree",
            2: Text(f"flip chatter at {Quantity(self.chatter, 'Hz')}: every second tooth cuts deeper"),
            0: Text(
                f"chatter at {Quantity(self.chatter, 'Hz')}, beside the harmonics of the teeth: samples once per tooth "
                "run round"
            ),
        }[self.dots]
        return Text(f"{phrase} (they spread by {Quantity(spread, 'share'):2} of the swing within a tooth)")

    def table(self) -> Table:
        """The strongest lines and their origin."""
        rows: list[list[str | float]] = []
        for frequency, amplitude in self.spectrum.largest():
            line = int(np.searchsorted(self.spectrum.frequency, frequency))
            times = Text(f"{Quantity(frequency / self.passing):3} x teeth")
            belongs = times if self.harmonic[line] else "chatter" if self.dots != 1 else "beside"
            rows.append([frequency, amplitude, belongs])
        amplitudes = Column("amplitude", self.spectrum.unit, f"4 {signal_unit(self.spectrum.unit)}")
        return Table(self.sentence(), [Column("line", "Hz", "5"), amplitudes, "belongs to"], rows)


def chatter_signs(
    values: np.ndarray,
    sample_time: float,
    *,
    speed: float,
    teeth: int,
    name: str = "signal",
    unit: str = "",
    start: float | None = None,
    runout: bool = False,
) -> ChatterSigns:
    """Look for the signs of chatter in equidistant samples of a force, an error or a sound, once the cut is
    established.

    speed   of the spindle in rpm, constant; teeth: of the tool
    start   s, time of the first once-per-tooth sample after the first value; None: where samples spread most
    runout  the tool runs out: harmonics of the spindle are no chatter, and samples are taken once per turn

    A stable cut repeats itself with the teeth: all its lines are harmonics, and samples once per tooth are one dot, or
    come together to one.  At a flip they are two dots, else a ring.
    Raises ParameterError for fewer than 16 teeth (turns, with run-out) and for fewer than four samples a tooth.
    """
    signal = np.asarray(values, float)
    if not speed > 0.0 or teeth < 1:
        raise ParameterError(f"speed = {Quantity(speed, 'rpm'):6} must be > 0 and teeth = {teeth} must be 1 or more")
    passing = teeth * speed / 60.0
    period = 60.0 / speed if runout else 1.0 / passing
    count = int(((signal.size - 1) * sample_time - (start or 0.0)) / period)
    if 1.0 / passing < 4.0 * sample_time:
        raise ParameterError(
            f"a tooth passes every {Quantity(1.0 / passing, 's')}, and {name} has a sample every "
            f"{Quantity(sample_time, 's')}: four samples a tooth are needed, sample faster"
        )
    if count < _TEETH:
        what = "turns" if runout else "teeth"
        raise ParameterError(f"{name} lasts {max(count, 0)} {what}: at least {_TEETH} are needed, give a longer record")
    lines = spectrum(signal, sample_time, name=name, unit=unit)
    width = lines.frequency[1] - lines.frequency[0]
    times = lines.frequency * period
    harmonic = np.abs(times - np.round(times)) <= (_LINES + 0.5) * width * period
    curve = CubicSpline(sample_time * np.arange(signal.size), signal)
    at = (start or 0.0) + period * np.arange(count)
    inside = curve(at[:-1, None] + period / _PLACES * np.arange(_PLACES))
    samples = curve(at) if start is not None else inside[:, np.argmax(np.std(inside, axis=0))]
    swing = float(np.mean(np.ptp(inside, axis=1)))
    return ChatterSigns(lines, harmonic, passing, samples, swing, _dots(samples, swing))


def _dots(samples: np.ndarray, swing: float) -> int:
    """Return 1 or 2 dots, 0 for a ring."""
    spread, half = float(np.std(samples)), samples.size // 2
    if spread <= _STILL * swing or np.std(samples[half:]) < _FALLS * np.std(samples[:half]):
        return 1
    return 2 if max(np.std(samples[::2]), np.std(samples[1::2])) <= _APART * spread else 0

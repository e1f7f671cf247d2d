"""The units in which a person wants to read pictures and tables: one choice for each kind of quantity."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np

from feeddrive.language.errors import ParameterError
from feeddrive.language.table import shown

DECIBEL, ABSOLUTE = "dB", "absolute"
_LENGTHS = {"nm": 1e9, "um": 1e6, "mm": 1e3}
_FORCES = {"N": 1.0, "kN": 1e-3}
_FREQUENCIES = {"Hz": 1.0, "rad/s": 2.0 * np.pi}
CHOICES: Mapping[str, tuple[str, ...]] = {
    "length": tuple(_LENGTHS), "force": tuple(_FORCES), "frequency": tuple(_FREQUENCIES), "gain": (DECIBEL, ABSOLUTE),
}  # fmt: skip


@dataclass(frozen=True)
class ShownUnits:
    """A unit for lengths, forces and frequencies, and dB or plain ratios for gains; of an axis that turns the same.

    Lengths are those of errors, which on an axis that turns are angles; speeds, times and angles keep their units.
    Raises ParameterError for a unit that is none of `CHOICES`.
    """

    length: str = "um"
    force: str = "N"
    frequency: str = "Hz"
    gain: str = DECIBEL

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if value not in CHOICES[field.name]:
                raise ParameterError(
                    f"the unit of {field.name} must be one of {', '.join(CHOICES[field.name])}, not '{value:.40}'"
                )

    def of(self, unit: str) -> tuple[str, float]:
        """The unit in which a quantity of an SI unit is shown, in typographic form, and the factor to it."""
        length, force = self.length.replace("u", "µ"), self.force
        known = {
            "m": (length, _LENGTHS[self.length]),
            "N": (force, _FORCES[force]),
            "N/m": (f"{force}/{length}", _FORCES[force] / _LENGTHS[self.length]),
            "m/N": (f"{length}/{force}", _LENGTHS[self.length] / _FORCES[force]),
            "Hz": (self.frequency, _FREQUENCIES[self.frequency]),
        }
        return known[unit] if unit in known else shown(unit)

    def said(self, value: float, unit: str, digits: int = 4) -> str:
        """A quantity given in SI, as a person reads it."""
        name, factor = self.of(unit)
        return f"{factor * value:.{digits}g} {name}".rstrip()

    @property
    def decibel(self) -> bool:
        """Whether gains are in dB."""
        return self.gain == DECIBEL

    def from_decibel(self, level: np.ndarray | float) -> np.ndarray | float:
        """A gain in dB, or the ratio that it stands for: 10^(level/20)."""
        return level if self.decibel else 10.0 ** (np.asarray(level) / 20.0)

    def to_decibel(self, gain: float) -> float:
        """The gain in dB of a height in a picture of gains. Raises ParameterError for a ratio that is not positive."""
        if self.decibel:
            return gain
        if not gain > 0.0:
            raise ParameterError(f"a gain must be > 0, not {gain:g}")
        return 20.0 * float(np.log10(gain))

    def gain_said(self, level: float, digits: int = 1) -> str:
        """A gain given in dB, as a person reads it."""
        return f"{level:.{digits}f} dB" if self.decibel else f"a factor of {10.0 ** (level / 20.0):.3g}"


USUAL = ShownUnits()

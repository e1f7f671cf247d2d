"""Quantities: numbers that keep their SI unit and error until they are shown in display units.

    rms = Quantity(5.88e-6, "m")
    str(rms)                                         # 5.88 um
    Units(length="inch").text(rms)                   # 0.0002315 in
    Units(rotary=True).text(rms)                     # 5.88 urad: lengths of a rotary axis are angles

`Units` is the only renderer of numbers, including those in tables (`table.py`) and strings (`text.py`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cache
from typing import TYPE_CHECKING, Any, SupportsFloat

if TYPE_CHECKING:
    import numpy as np

from feeddrive.language.errors import ParameterError
from feeddrive.language.text import Mark, keeps_marks, marks
from feeddrive.language.units import factor, turning

# the unit customary in the field, by SI unit
_USUAL = {
    "m": "um",
    "m/s": "mm/s",
    "s": "ms",
    "N/m": "N/um",
    "m/N": "um/N",
    "m √s/N": "nm √s/N",
    "share": "%",
}
# a recorded angle or torque of a rotary axis has the same prefixes as the length or force of a linear one
_OF_SIGNALS = _USUAL | {turning(unit): turning(name) for unit, name in _USUAL.items()}
_SHARES = {"%": 100.0, "ppm": 1e6, "": 1.0}
# a length per force is small in every machine, whatever else the unit holds: m/(s N)
_COMPLIANT = re.compile(r"m(?= |/)[^/]*/.*(?<!\w)N(?!\w)")
_DIGITS = 4
_READABLE = 7  # digits before the decimal point up to which a number is written without an exponent

DECIBEL, ABSOLUTE = "dB", "absolute"
_LENGTHS = {"nm": "nm", "um": "um", "mm": "mm", "inch": "in"}
CHOICES: Mapping[str, tuple[str, ...]] = {
    "length": tuple(_LENGTHS),
    "force": ("N", "kN"),
    "frequency": ("Hz", "rad/s"),
    "gain": (DECIBEL, ABSOLUTE),
}
_LENGTH_WORD = re.compile(r"(?<!\w)[num]?m(?!\w)")


def _usual(unit: str) -> str:
    """Return the display unit of a quantity for which no other display unit is specified."""
    return _USUAL.get(unit) or (f"u{unit}" if _COMPLIANT.match(unit) else unit)


def count_of(count: int, noun: str) -> str:
    """Return a count with its noun, in the plural unless it is 1: `1 stop`, `1,200 stops`."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"


def number(value: float | None, digits: int = _DIGITS) -> str:
    """Format a number with `digits` significant digits, without an exponent if that is readable; `-` for None.

    Trailing zeros are omitted, and all digits before the decimal point are written: 0.5, 12345.
    """
    if value is None:
        return "-"
    value = float(value)
    if not math.isfinite(value) or value == 0.0:
        return f"{value:g}"
    size = _places(value, digits)
    if not -4 < size <= _READABLE:
        return f"{value:.{digits}g}"
    text = f"{value:.{max(digits - size, 0)}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def _places(value: float, digits: int) -> int:
    """Return the number of digits of a number before the decimal point after rounding: 1 for 9.4, 0 for 0.94."""
    # by the formatted number, which is rounded: 9.96 to two digits has two places before the point
    return int(f"{value:.{digits - 1}e}".partition("e")[2]) + 1


def _numeral(value: float, form: str) -> str:
    """Format a number: `form` is a number of significant digits (`3`) or a Python format (`.2f`)."""
    if not form:
        return number(value)
    return number(value, int(form)) if form.isdigit() else f"{value:{form}}"


@dataclass(frozen=True)
class Units:
    """The display units of a user, one choice for each kind of quantity.

    length       unit of errors and positions; `um` selects the usual unit of each (um or mm)
    force        N or kN
    frequency    Hz or rad/s
    gain         dB or ratios
    rotary       True for a rotary axis: lengths become angles, forces torques, masses inertias, with the same numbers
    typographic  µ in place of u, ± in place of +-

    Raises ParameterError for a unit that is not in `CHOICES`.
    """

    length: str = "um"
    force: str = "N"
    frequency: str = "Hz"
    gain: str = DECIBEL
    rotary: bool = False
    typographic: bool = False

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name in CHOICES and value not in CHOICES[field.name]:
                raise ParameterError(
                    f"the unit of {field.name} must be one of {', '.join(CHOICES[field.name])}, not '{value:.40}'"
                )

    def of(self, unit: str, shown: str = "", *, stays: bool = False) -> tuple[str, float]:
        """Return the name of the display unit for an SI unit, and the conversion factor from SI.

        shown  the customary unit of this quantity; empty for the usual display unit of its SI unit
        stays  True if the unit is the same for a rotary axis, because the quantity does not describe the motion of the
               axis
        """
        wanted = unit if shown == "SI" else self._chosen(unit, shown or _usual(unit))
        size = _factor(unit, wanted)
        if self.rotary and not stays:
            wanted = turning(wanted)
        if self.typographic:
            wanted = re.sub(r"(?<!\w)u(?=[A-Za-z])", "µ", wanted).replace("deg", "°")
        return wanted, size

    def _chosen(self, unit: str, usual: str) -> str:
        if unit == "Hz" and usual == "Hz":
            return self.frequency
        # the lengths of a rotary axis are angles, which have no inch
        if self.length != USUAL_LENGTH and not self.rotary and unit in ("m", "N/m", "m/N"):
            usual = _LENGTH_WORD.sub(_LENGTHS[self.length], usual)
        if self.force != "N" and unit in ("N", "N/m", "m/N"):
            usual = re.sub(r"(?<!\w)N(?!\w)", self.force, usual)
        return usual

    def name(self, unit: str, shown: str = "", *, stays: bool = False) -> str:
        """Return the name of the display unit for an SI unit."""
        return self.of(unit, shown, stays=stays)[0]

    def text(self, quantity: Quantity, form: str = "") -> str:
        """Return a quantity as text in the display units, with its standard error, if any, to two digits."""
        digits, shown = _read(form or quantity.form)
        name, size = self.of(quantity.unit, shown, stays=quantity.stays)
        value, error = size * float(quantity.value), quantity.error
        if error is None or not 0.0 < (error := size * float(error)) < math.inf or digits:
            numeral = _numeral(value, digits)
        else:
            decimals = max(0, 2 - _places(error, 2))
            # data without noise: fixed decimals would be far too many
            if error < abs(value) * 10.0**-_READABLE:
                shares = number(value, _READABLE), number(error, 2)
            else:
                shares = f"{value:.{decimals}f}", f"{error:.{decimals}f}"
            numeral = f" {'±' if self.typographic else '+-'} ".join(shares)
        return numeral if quantity.bare or not name else f"{numeral}{'' if name == '°' else ' '}{name}"

    def read(self, mark: Mark) -> str:
        """Return the text that a mark represents: a quantity, or the name of a unit."""
        if mark.value:
            return self.text(_quantity(mark))
        if not mark.unit:
            return "–" if self.typographic and mark == ABSENT else mark.plain
        return self.name(mark.unit, mark.form, stays="s" in mark.flags)

    def value_text(self, value: float, unit: str, digits: int = _DIGITS) -> str:
        """Return a number in SI as text in the display units."""
        return self.text(Quantity(value, unit), str(digits))

    @property
    def decibel(self) -> bool:
        """True if gains are in dB."""
        return self.gain == DECIBEL

    def from_decibel(self, level: np.ndarray | float) -> np.ndarray | float:
        """Convert a gain from dB to the display unit: unchanged in dB, or the ratio 10^(level/20)."""
        return level if self.decibel else 10.0 ** (level / 20.0)

    def to_decibel(self, gain: float) -> float:
        """Convert a gain from the display unit to dB. Raises ParameterError for a ratio <= 0."""
        if self.decibel:
            return gain
        if not gain > 0.0:
            raise ParameterError(f"a gain must be > 0, not {number(gain, 6)}")
        return 20.0 * math.log10(gain)

    def gain_text(self, level: float, digits: int = 1) -> str:
        """Return a gain in dB as text in the display unit."""
        return f"{level:.{digits}f} dB" if self.decibel else f"a factor of {number(10.0 ** (level / 20.0), 3)}"


USUAL_LENGTH = "um"
USUAL = Units()
DRAWN = Units(typographic=True)


@cache
def _factor(unit: str, shown: str) -> float:
    """Return the conversion factor from an SI unit to the displayed unit; ratios may become % or ppm."""
    if unit == shown:
        return 1.0
    if unit in ("", "share", "1") and shown in _SHARES:
        return _SHARES[shown]
    # the grammar of units has no roots; √s is on both sides
    plain, other = (word.replace("√s", "1") for word in (unit, shown))
    return factor(plain, other)


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number with its unit.

    value  the number in SI units
    unit   SI unit of a linear axis: `m`, `N/m`, `N s/m`; `share` is displayed in percent; empty for a plain number
    error  standard error in SI units, if known
    form   digits and unit for display, as in an f-string: `3`, `3 mm`, `.2f`, `.1f ms`
    stays  True if it is not a quantity of the axis: a length stays a length on a rotary axis
    bare   True if it is displayed without its unit, which is shown elsewhere

    In an f-string: `{lag}`, `{lag:3}` (significant digits), `{lag:3 us}` (with the unit), `{lag:.2f}`, `{low:SI}`
    (in the SI unit, as in a file).
    """

    value: SupportsFloat
    unit: str = ""
    error: SupportsFloat | None = None
    form: str = ""
    stays: bool = False
    bare: bool = False

    def __str__(self) -> str:
        return USUAL.text(self)

    def __format__(self, form: str) -> str:
        if not keeps_marks():
            return USUAL.text(self, form)
        error = "" if self.error is None else repr(float(self.error))
        form = form or self.form
        flags = f"{'s' if self.stays else ''}{'b' if self.bare else ''}"
        return str(Mark(repr(float(self.value)), self.unit, error, form, flags, USUAL.text(self, form)))

    def record(self) -> dict[str, Any]:
        """Return the quantity as a JSON object: value and error in SI units, and the unit."""
        record: dict[str, Any] = {"value": finite(float(self.value)), "unit": self.unit}
        if self.error is not None:
            record["error"] = finite(float(self.error))
        return record


def finite(value: float) -> float | None:
    """Return the number, or None if it is infinite or NaN, which JSON cannot represent."""
    return float(value) if math.isfinite(value) else None


@cache
def _read(form: str) -> tuple[str, str]:
    """Split a form such as `3 um`, `.2f` or `um` into digits and unit."""
    head, _, tail = form.partition(" ")
    if re.fullmatch(r"[+]?,?(\d+|(\.\d+)?[gfe])", head):
        return head, tail
    return "", form


def signal_unit(unit: str) -> str:
    """Return the display unit for a recorded signal in an SI unit; a signal in rad belongs to a rotary axis."""
    return _OF_SIGNALS.get(unit, unit)


def form_unit(form: str) -> str:
    """Return the unit in a form; empty if the form has none."""
    return _read(form)[1]


ABSENT = Mark("", "", "", "", "", "-")
"""The mark that is shown where there is no number."""


def unit_name(si: str, shown: str = "", *, stays: bool = False) -> str:
    """Return the mark of a unit name, for f-strings in column heads and labels: `f"force, {unit_name('N')}"`."""
    return str(Mark("", si, "", shown, "s" if stays else "", USUAL.name(si, shown))) if si else shown.removeprefix("SI")


def span(low: SupportsFloat, high: SupportsFloat, unit: str, form: str = "", between: str = "to") -> str:
    """Return a range between two numbers with the same unit as marked text for f-strings: `5 to 500 Hz`."""
    return f"{Quantity(low, unit, form=form, bare=True)} {between} {Quantity(high, unit, form=form)}"


def quantities(text: str) -> tuple[Quantity, ...]:
    """Return the quantities in a string, in order."""
    return tuple(_quantity(mark) for mark in marks(text) if mark.value)


def _quantity(mark: Mark) -> Quantity:
    error = float(mark.error) if mark.error else None
    return Quantity(float(mark.value), mark.unit, error, mark.form, "s" in mark.flags, "b" in mark.flags)

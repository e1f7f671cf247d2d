"""Positions and texts of the ticks of an axis: round steps, plain numbers, a true minus sign."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

_STEPS = (1.0, 2.0, 5.0, 10.0)  # round steps, times a power of ten
_TURNS = (1.0, 2.0, 5.0, 10.0, 15.0, 30.0, 45.0, 90.0, 180.0, 360.0, 720.0)  # degrees: round steps of an angle
_PHASES = (15.0, 30.0, 45.0, 90.0, 180.0, 360.0, 720.0)  # degrees: steps of a phase axis, which is extended to them
_PLAIN = 1e-3, 1e6  # numbers outside are written with a common power of ten
_DECADE = 1e-4, 1e5  # the same for each number of a logarithmic axis
_DIGITS = (1,), (1, 2, 5), tuple(range(1, 10))  # digits of a logarithmic axis with texts
_ENOUGH = 3  # texts
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


class Ticks(NamedTuple):
    """Ticks with texts, ticks without (`minor`), and the common power of ten of all texts; empty if it is 1."""

    values: Sequence[float]
    texts: Sequence[str]
    minor: Sequence[float] = ()
    power: str = ""


def linear(low: float, high: float, most: float) -> Ticks:
    """Return ticks at multiples of 1, 2 or 5 times a power of ten, with at most `most` intervals."""
    return _stepped(low, high, _round((high - low) / most))


def degrees(low: float, high: float, most: float) -> Ticks:
    """Return ticks at round angles, with at most `most` intervals."""
    least = 0.999 * (high - low) / most
    return _stepped(low, high, next((step for step in _TURNS if step >= least), _round(least)))


def phase_step(low: float, high: float) -> float:
    """Return the step of a phase axis in degrees, 15 to 720: at most 6 intervals where possible."""
    return next((step for step in _PHASES if (high - low) / step <= 6.0), _PHASES[-1])


def logarithmic(low: float, high: float, most: float) -> Ticks:
    """Return ticks with at most about `most` texts: at some decades, at decades, at 1, 2 and 5 of them or at all
    digits, the coarsest with three texts; on an axis shorter than that at linear steps.
    """
    decades = float(np.log10(high / low))
    skipped = max(1, int(np.ceil(decades / most)))
    values, minor = list[float](), list[float]()
    for digits in _DIGITS:
        if len(digits) * decades > most and digits is not _DIGITS[0]:
            break
        values, minor = _decades(low, high, digits, skipped)
        if len(values) >= _ENOUGH:
            break
    if len(values) < 2 and decades < 1.0:
        values, texts, _, power = linear(low, high, min(most, 5.0))
        return Ticks(values, texts, (), power)
    return Ticks(values, [decade_text(value) for value in values], minor)


def _decades(low: float, high: float, digits: Sequence[int], skipped: int) -> tuple[list[float], list[float]]:
    """Return the places between two ends that begin with one of the digits, and the others."""
    values, minor = list[float](), list[float]()
    # 1e-9: the ends are often decades themselves, and their logarithms a rounding off
    for power in range(int(np.floor(np.log10(low) - 1e-9)), int(np.ceil(np.log10(high) + 1e-9)) + 1):
        for digit in range(1, 10):
            value = float(f"{digit}e{power}")
            if low * (1.0 - 1e-9) <= value <= high * (1.0 + 1e-9):
                named = digit in digits and power % skipped == 0
                (values if named else minor).append(value)
    return values, minor if skipped == 1 else []


def decade_text(value: float) -> str:
    """Return a number of a logarithmic axis: 0.1, 20, 10⁻⁵, 2·10⁶."""
    if _DECADE[0] < value < _DECADE[1]:
        return f"{value:.10g}"
    digit, power = f"{value:.0e}".split("e")
    raised = f"10{str(int(power)).translate(_RAISED)}"
    return raised if digit == "1" else f"{digit}·{raised}"


def _round(step: float) -> float:
    """Round a step up to 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(step))
    return float(power * next(each for each in _STEPS if each * power >= 0.999 * step))


def _stepped(low: float, high: float, step: float) -> Ticks:
    largest = max(abs(low), abs(high))
    exponent = 0 if _PLAIN[0] <= largest < _PLAIN[1] else 3 * int(np.floor(np.log10(largest) / 3.0))
    # 1e-6 of a step: a tick at the end of the axis must not be lost by rounding
    values = [float(k * step) for k in range(int(np.ceil(low / step - 1e-6)), int(np.floor(high / step + 1e-6)) + 1)]
    digits = max(0, -int(np.floor(np.log10(step) - exponent + 1e-9)))
    texts = [signed(value / 10.0**exponent, digits) for value in values]
    return Ticks(values, texts, (), f"×10{str(exponent).translate(_RAISED)}" if exponent else "")


def signed(value: float, digits: int) -> str:
    """Return a number with some digits behind the point and a true minus sign."""
    # + 0.0: no text "-0"
    return f"{round(value, digits) + 0.0:.{digits}f}".replace("-", "\u2212")

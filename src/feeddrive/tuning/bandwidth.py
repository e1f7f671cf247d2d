"""The whole loop made faster or slower by one factor: which numbers follow it, and how far it can go."""

from __future__ import annotations

import math
from collections.abc import Mapping

from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import number
from feeddrive.loop.control import Control
from feeddrive.tuning.tunables import HIGHEST, own_tunables, speeds

_INSIDE = 1e-9  # relative distance to a bound that is open


def speed_powers(control: Control) -> Mapping[str, float]:
    """Of the tunables of law, observers and compensations the powers of 1/s in their units, where there is one.

    A rate of 1/s, rad/s or Hz goes with w, a velocity gain in N s/m with w, a stiffness in N/m with w², an integral
    time in s with 1/w.  For a free mass the loop gain is then the old one at f/w: L(jω; w) = L(jω/w; 1), so that every
    crossover is moved by w and every margin stays, as far as dead time and sampling do not count.  Filters, models of
    the axis and feedforward belong to the axis and stay.
    """
    names = own_tunables(control)
    powers = zip(names, speeds(control, names), strict=True)
    return {name: float(power) for name, power in powers if power != 0.0}


def quickened(control: Control, factor: float) -> Mapping[str, float]:
    """The numbers of `speed_powers` for a loop that is faster by a factor > 0, by name, in SI.

    Raises ParameterError if there is none, and for a factor that is not > 0 or with which a number is too large for a
    computer.
    """
    if not (factor > 0.0 and math.isfinite(factor)):
        raise ParameterError(f"a loop is made faster by a finite factor > 0, not {number(factor, 6)}")
    powers = speed_powers(control)
    if not powers:
        raise ParameterError(
            f"the law '{control.law.kind}' has no number that is a rate or a gain with a unit, which could be scaled: "
            f"move its numbers one by one"
        )
    try:
        return {name: float(tree.get(control, name)) * factor**power for name, power in powers.items()}
    except (OverflowError, ZeroDivisionError):
        raise ParameterError(
            f"a loop cannot be made {number(factor, 3)} times as fast: take a factor nearer to 1"
        ) from None


def speed_range(control: Control, sample_time: float) -> tuple[float, float]:
    """The smallest and the largest factor of `quickened` with which all numbers keep their bounds.

    Frequencies in Hz also stay below 0.49 times the sample rate (sample_time in s).
    """
    low, high = 0.0, math.inf
    for name, power in speed_powers(control).items():
        declared, value = tree.declaration(control, name), float(tree.get(control, name))
        least = max(filter(None, (declared.least, declared.above)), default=0.0) * (1.0 + _INSIDE)
        most = min((bound for bound in (declared.most, declared.below) if bound is not None), default=math.inf)
        if declared.unit == "Hz":
            most = min(most, HIGHEST / sample_time)
        if not value > 0.0:
            continue
        ends = sorted(
            (end / value) ** (1.0 / power) if end > 0.0 else (0.0 if power > 0.0 else math.inf)
            for end in (least, most * (1.0 - _INSIDE))
        )
        low, high = max(low, ends[0]), min(high, ends[1])
    return low, high

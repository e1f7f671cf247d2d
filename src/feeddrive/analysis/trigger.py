"""The instants at which a signal passes a level, as an oscilloscope finds them, also where it comes piece by piece."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity

RISING, FALLING = "rising", "falling"


@dataclass(frozen=True)
class Trigger:
    """The condition of an instant.

    channel     by its name
    level       that is passed, in the unit of the channel
    edge        rising or falling
    hysteresis  distance by which the signal must have been on the other side before, so that noise at the level
                counts once; >= 0, in the unit of the channel
    hold        after an instant that counted, the time in which no other one does; >= 0, s
    """

    channel: str
    level: float = 0.0
    edge: str = RISING
    hysteresis: float = 0.0
    hold: float = 0.0

    def __post_init__(self) -> None:
        if self.edge not in (RISING, FALLING):
            raise ParameterError(f"edge = '{self.edge:.20}' of the trigger must be {RISING} or {FALLING}")
        if not math.isfinite(self.level):
            raise ParameterError(f"level = {self.level} of the trigger must be a finite number")
        for name, value, unit in (("hysteresis", self.hysteresis, ""), ("hold", self.hold, "s")):
            if not 0.0 <= value < math.inf:
                least = Quantity(0.0, unit)
                raise ParameterError(
                    f"{name} = {Quantity(value, unit):6 SI} of the trigger must be >= {least:SI} and finite"
                )


class Crossings:
    """Finds the instants of a trigger in a signal that comes in pieces; the cuts do not change the result.

    A rising instant lies between two samples a, b of the times s, t with a < level <= b, if the signal was below
    level - hysteresis since it last was at the level or above:

        instant = s + (t - s) (level - a) / (b - a)

    Falling is the same of the signal with the other sign.  NaN is a gap: nothing is known of what was before it.
    """

    def __init__(self, trigger: Trigger) -> None:
        self._sign = 1.0 if trigger.edge == RISING else -1.0
        self._level = self._sign * trigger.level
        self._low = self._level - trigger.hysteresis
        self._last: tuple[float, float] = (math.nan, math.nan)
        self._armed = False

    def take(self, time: np.ndarray, values: np.ndarray) -> np.ndarray:
        """The instants (s) in the next samples, both of shape (n,)."""
        if not time.size:
            return np.empty(0)
        t = np.concatenate([[self._last[0]], time])
        y = np.concatenate([[self._last[1]], self._sign * values])
        with np.errstate(invalid="ignore"):
            high, low, gap = y >= self._level, (y < self._level) & (y <= self._low), ~np.isfinite(y)
        known = high | low | gap
        # whether the last sample at or before each one that is high, low or a gap was low
        index = np.where(known, np.arange(y.size), -1)
        index = np.maximum.accumulate(index)
        below = np.where(index >= 0, low[index], self._armed)
        below[0] = self._armed
        crossings = np.flatnonzero(high[1:] & below[:-1] & ~gap[:-1]) + 1
        self._last = float(t[-1]), float(y[-1])
        self._armed = bool(below[-1])
        a, b = y[crossings - 1], y[crossings]
        return t[crossings - 1] + (t[crossings] - t[crossings - 1]) * (self._level - a) / (b - a)

"""Numbers that are made of numbers: truncated Taylor series, a number with its change, intervals, and majorants.

They pass through the same text as floats and arrays, if it uses only + - * and `ops.sin` and `ops.cos`, as the
kinematics of a machine do (`path/kinematics.py`).  Their parts may be floats, arrays or composite numbers themselves:
the Taylor series of an interval encloses all series.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from feeddrive.language import ops
from feeddrive.language.primitives import Composite

# Relative width added to each end of an interval: above the rounding error 2⁻⁵³ of one operation.
_OUTWARD = 2.0**-52
# What a sine or cosine of `mathematics.py` may be off, absolute: 4 units in the last place of 1
_SINE_ERROR = 2.0**-50
# Smallest normal number: below it rounding errors are no longer relative
_TINY = 2.0**-1022


class Taylor(Composite):
    """A truncated power series y(t) = Σ termsₖ tᵏ, k = 0 .. order; termsₖ = y⁽ᵏ⁾(0)/k!.

    A product has the order of the shorter factor. Plain numbers are constants of any order.
    """

    def __init__(self, *terms: Any) -> None:
        self.terms = terms

    @property
    def order(self) -> int:
        """The order of the last term."""
        return len(self.terms) - 1

    def __repr__(self) -> str:
        return f"Taylor{self.terms}"

    def __add__(self, other: Any) -> Taylor:
        if isinstance(other, Taylor):
            return Taylor(*(a + b for a, b in zip(self.terms, other.terms, strict=False)))
        return Taylor(self.terms[0] + other, *self.terms[1:])

    __radd__ = __add__

    def __neg__(self) -> Taylor:
        return Taylor(*(-a for a in self.terms))

    def __sub__(self, other: Any) -> Taylor:
        if isinstance(other, Taylor):
            return Taylor(*(a - b for a, b in zip(self.terms, other.terms, strict=False)))
        return Taylor(self.terms[0] - other, *self.terms[1:])

    def __rsub__(self, other: Any) -> Taylor:
        return Taylor(other - self.terms[0], *(-a for a in self.terms[1:]))

    def __mul__(self, other: Any) -> Taylor:
        if not isinstance(other, Taylor):
            return Taylor(*(a * other for a in self.terms))
        a, b = self.terms, other.terms
        return Taylor(*(_sum(a[i] * b[k - i] for i in range(k + 1)) for k in range(min(len(a), len(b)))))

    __rmul__ = __mul__

    def waves(self) -> tuple[Taylor, Taylor]:
        """Return sine and cosine, from s' = a' c, c' = -a' s: k sₖ = Σ i aᵢ cₖ₋ᵢ, k cₖ = -Σ i aᵢ sₖ₋ᵢ, i = 1 .. k."""
        a = self.terms
        s, c = [ops.sin(a[0])], [ops.cos(a[0])]
        for k in range(1, len(a)):
            slopes = [(i / k) * a[i] for i in range(1, k + 1)]
            sine = _sum(slope * c[k - 1 - i] for i, slope in enumerate(slopes))
            cosine = _sum(slope * s[k - 1 - i] for i, slope in enumerate(slopes))
            s.append(sine)
            c.append(-cosine)
        return Taylor(*s), Taylor(*c)


def _sum(terms: Any) -> Any:
    """Sum without a leading zero, which not every number can be added to."""
    total = None
    for term in terms:
        total = term if total is None else total + term
    return total


class Change(Composite):
    """A number and its change, which is computed without subtracting nearby numbers: `start` and `start + change`.

        Δ(a b) = a Δb + Δa (b + Δb)
        Δ sin a = 2 cos(a + Δa/2) sin(Δa/2),   Δ cos a = -2 sin(a + Δa/2) sin(Δa/2)

    A small change keeps its relative accuracy, while f(a + Δa) - f(a) has the rounding error of f(a).
    """

    def __init__(self, start: Any, change: Any) -> None:
        self.start, self.change = start, change

    def __repr__(self) -> str:
        return f"Change({self.start}, {self.change})"

    def __add__(self, other: Any) -> Change:
        if isinstance(other, Change):
            return Change(self.start + other.start, self.change + other.change)
        return Change(self.start + other, self.change)

    __radd__ = __add__

    def __neg__(self) -> Change:
        return Change(-self.start, -self.change)

    def __sub__(self, other: Any) -> Change:
        if isinstance(other, Change):
            return Change(self.start - other.start, self.change - other.change)
        return Change(self.start - other, self.change)

    def __rsub__(self, other: Any) -> Change:
        return Change(other - self.start, -self.change)

    def __mul__(self, other: Any) -> Change:
        if not isinstance(other, Change):
            return Change(self.start * other, self.change * other)
        change = self.start * other.change + self.change * (other.start + other.change)
        return Change(self.start * other.start, change)

    __rmul__ = __mul__

    def waves(self) -> tuple[Change, Change]:
        """Return the sine and cosine by the formulas above."""
        half = 0.5 * self.change
        middle = self.start + half
        twice = 2.0 * ops.sin(half)
        sine = Change(ops.sin(self.start), ops.cos(middle) * twice)
        return sine, Change(ops.cos(self.start), -(ops.sin(middle) * twice))


class Interval(Composite):
    """All numbers from `low` to `high`, arrays of equal shape or floats; each result is rounded outward.

    An interval times itself is a square: it is not negative.
    """

    def __init__(self, low: Any, high: Any) -> None:
        self.low, self.high = low, high

    @staticmethod
    def around(value: Any, reach: Any = 0.0) -> Interval:
        """Return the interval of all numbers that differ from a value by at most `reach`."""
        return _outward(value - reach, value + reach) if np.any(reach) else Interval(value, value)

    def __repr__(self) -> str:
        return f"Interval({self.low}, {self.high})"

    @property
    def size(self) -> Any:
        """The largest magnitude."""
        return np.maximum(np.abs(self.low), np.abs(self.high))

    def __add__(self, other: Any) -> Interval:
        if isinstance(other, Interval):
            return _outward(self.low + other.low, self.high + other.high)
        return _outward(self.low + other, self.high + other)

    __radd__ = __add__

    def __neg__(self) -> Interval:
        return Interval(-self.high, -self.low)

    def __sub__(self, other: Any) -> Interval:
        if isinstance(other, Interval):
            return _outward(self.low - other.high, self.high - other.low)
        return _outward(self.low - other, self.high - other)

    def __rsub__(self, other: Any) -> Interval:
        return _outward(other - self.high, other - self.low)

    def __mul__(self, other: Any) -> Interval:
        if other is self:
            size = self.size
            small = np.where(
                (self.low <= 0.0) & (self.high >= 0.0), 0.0, np.minimum(np.abs(self.low), np.abs(self.high))
            )
            square = _outward(small * small, size * size)
            return Interval(np.maximum(square.low, 0.0), square.high)
        if not isinstance(other, Interval):
            a, b = self.low * other, self.high * other
            return _outward(np.minimum(a, b), np.maximum(a, b))
        ends = [x * y for x in (self.low, self.high) for y in (other.low, other.high)]
        low = np.minimum(np.minimum(ends[0], ends[1]), np.minimum(ends[2], ends[3]))
        return _outward(low, np.maximum(np.maximum(ends[0], ends[1]), np.maximum(ends[2], ends[3])))

    __rmul__ = __mul__

    def waves(self) -> tuple[Interval, Interval]:
        """Return the sine and cosine of all angles of the interval."""
        return self._wave(ops.sin, 0.25), self._wave(ops.cos, 0.0)

    def _wave(self, wave: Any, peak: float) -> Interval:
        """Enclose sine or cosine, whose maxima lie at `peak` turns and every whole turn from there."""
        ends = wave(np.asarray(self.low)), wave(np.asarray(self.high))
        low = np.minimum(*ends) - _SINE_ERROR
        high = np.maximum(*ends) + _SINE_ERROR

        def holds(place: float) -> Any:
            # more is counted as inside than is, by some roundings of the number of turns
            a, b = self.low / (2.0 * np.pi) - place, self.high / (2.0 * np.pi) - place
            slack = 4.0 * _OUTWARD * (1.0 + np.maximum(np.abs(a), np.abs(b)))
            return np.floor(b + slack) >= np.ceil(a - slack)

        low = np.where(holds(peak + 0.5), -1.0, np.maximum(low, -1.0))
        return Interval(low[()], np.where(holds(peak), 1.0, np.minimum(high, 1.0))[()])


def _outward(low: Any, high: Any) -> Interval:
    """Return the interval with its ends moved outward by more than one rounding error."""
    return Interval(low - (_OUTWARD * np.abs(low) + _TINY), high + (_OUTWARD * np.abs(high) + _TINY))


class Majorant(Composite):
    """Bounds on the magnitudes of all coefficients of a power series, `terms` of shape (order + 1, ...), that stay
    bounds in sums, products, sine and cosine.

    Differences do not cancel: a bound is wide where the numbers are large, and costs a few operations.
    """

    def __init__(self, terms: Any) -> None:
        self.terms = terms

    def __repr__(self) -> str:
        return f"Majorant({self.terms})"

    def __add__(self, other: Any) -> Majorant:
        if isinstance(other, Majorant):
            return Majorant(self.terms + other.terms)
        terms = self.terms.copy()
        terms[0] += abs(other)
        return Majorant(terms)

    __radd__ = __sub__ = __rsub__ = __add__

    def __neg__(self) -> Majorant:
        return self

    def __mul__(self, other: Any) -> Majorant:
        if not isinstance(other, Majorant):
            return Majorant(self.terms * abs(other))
        a, b = self.terms, other.terms
        terms = a[0] * b
        for k in range(1, len(a)):
            terms[k:] += a[k] * b[:-k]
        return Majorant(terms)

    __rmul__ = __mul__

    def waves(self) -> tuple[Majorant, Majorant]:
        """Return the bounds of sine and cosine, which are equal: 1, and k sₖ = Σ i aᵢ sₖ₋ᵢ, i = 1 .. k."""
        terms = np.ones_like(self.terms)
        slopes = (np.arange(len(terms)) * self.terms.T).T
        for k in range(1, len(terms)):
            terms[k] = (slopes[1 : k + 1] * terms[k - 1 :: -1]).sum(axis=0) / k
        return Majorant(terms), Majorant(terms)

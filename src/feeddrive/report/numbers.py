"""Numbers as a reader wants them."""

from __future__ import annotations

import math


def number(value: float | None, digits: int = 3) -> str:
    """So many significant digits without an exponent where that is readable; a dash for what is absent."""
    if value is None:
        return "–"
    if math.isnan(value):
        return "not a number"
    if math.isinf(value):
        return "∞" if value > 0.0 else "-∞"
    if value == 0.0:
        return "0"
    size = math.floor(math.log10(abs(value))) + 1
    if not -4 < size <= 7:
        return f"{value:.{digits - 1}e}"
    return f"{value:.{max(digits - size, 0)}f}"


def percent(share: float) -> str:
    """A share in percent."""
    return f"{number(100.0 * share, 2 if abs(share) < 0.0995 else 3)} %"


def decibel(value: float | None) -> str:
    """One decimal."""
    return "–" if value is None else f"{value:.1f}"

"""Arcs G2 and G3: their center from I J K or from the radius R, their turns."""

from __future__ import annotations

import math

from feeddrive.language.quantity import Quantity
from feeddrive.path.program.lines import BlockError

LEAST_SPREAD, RELATIVE_SPREAD, LARGEST_SPREAD = 0.03, 1e-3, 0.5
"""By how much the radii of start and end may differ: always (mm), as a part of the radius, at most (mm)."""
CHORD_SPREAD = 0.00127
"""By how much (mm) a chord may exceed the diameter."""
MOST_TURNS = 100_000


def center_of_radius(
    start: tuple[float, float], end: tuple[float, float], radius: float, clockwise: bool, unit: float
) -> tuple[float, float]:
    """The center of an arc of given radius; a negative one asks for the longer arc. `unit`: mm in a program unit."""
    if radius == 0:
        raise BlockError("an arc of radius 0: write its radius R or its center I J K", "R")
    dx, dy = end[0] - start[0], end[1] - start[1]
    half = 0.5 * math.hypot(dx, dy)
    if half == 0:
        raise BlockError(
            "an arc of given R ends where it begins, which leaves its center open: write I J K instead", "R"
        )
    size = abs(radius)
    if half * unit > size * unit + CHORD_SPREAD:
        raise BlockError(
            f"the radius {Quantity(size):6} does not reach: start and end are {Quantity(2 * half):6} apart, so R is "
            f"at least {Quantity(half):6}",
            "R",
        )
    height = math.sqrt(max(0.0, size * size - half * half)) if half / size < 1 - 1e-12 else 0.0
    if clockwise == (radius > 0):
        height = -height
    return (
        0.5 * (start[0] + end[0]) - height * dy / (2 * half),
        0.5 * (start[1] + end[1]) + height * dx / (2 * half),
    )


def check_radii(
    start: tuple[float, float], end: tuple[float, float], center: tuple[float, float], letters: str, unit: float
) -> None:
    """Refuse an arc whose start and end do not lie on one circle. `letters`: the words of the center."""
    first = math.hypot(start[0] - center[0], start[1] - center[1]) * unit
    last = math.hypot(end[0] - center[0], end[1] - center[1]) * unit
    spread = abs(first - last)
    if first * last == 0 or not math.isfinite(spread):
        raise BlockError(f"an arc of radius 0: the center {letters} lies on its start or end", letters[:1])
    most = min(LARGEST_SPREAD, max(LEAST_SPREAD, RELATIVE_SPREAD * max(first, last)))
    if spread > most:
        raise BlockError(
            f"the end is no point of the circle: its radius is {_millimeters(first):6} at the start, "
            f"{_millimeters(last):6} at the end, which may differ by {_millimeters(most):3}; correct the end or "
            f"{letters}",
            letters[:1],
        )


def _millimeters(length: float) -> Quantity:
    """Return a length in mm as a quantity that is read in mm."""
    return Quantity(length, "mm", stays=True)


def sweep(start: tuple[float, float], end: tuple[float, float], center: tuple[float, float], turns: int) -> float:
    """The angle of an arc, rad: positive counterclockwise. An arc that ends where it begins is a full turn."""
    a = math.atan2(start[1] - center[1], start[0] - center[0])
    b = math.atan2(end[1] - center[1], end[0] - center[0])
    angle = b - a
    if turns > 0:
        while angle <= 1e-12:
            angle += math.tau
        return angle + math.tau * (turns - 1)
    while angle >= -1e-12:
        angle -= math.tau
    return angle + math.tau * (turns + 1)

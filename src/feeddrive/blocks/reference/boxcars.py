"""The lengths of the boxcars of a limited move, also for distances too short to reach all limits."""

import math
from collections.abc import Sequence

from feeddrive.blocks.reference.profile import Profile
from feeddrive.language.errors import StructureError

# its square is still finite
_HUGE = 1e150
# products with smaller numbers are subnormal and lose digits
_TINY = 1e-290


def limited_profile(kind: str, distance: float, limits: Sequence[float]) -> Profile:
    """Return the shortest move of the boxcar family over a distance > 0 within `limits`, velocity first (SI).

    If all limits are reached, the lengths are the usual ones (for the snap-limited move j/s, a/j, v/a and
    distance/v).  In general the lengths are chosen in ascending order, each as long as possible.  L₁ times the highest
    derivative is the peak of the next lower one, and so on.  Since ramps must not overlap, each length is at least the
    sum of the shorter ones, so L₁ = x means at least (x, 2x, 4x) for the others:

        L₁ = x:  s·x ≤ j,  s·x² ≤ a,  s·2x³ ≤ v,  s·8x⁴ ≤ distance
        L₂ = x:  j'·x ≤ a,  j'·x(x + L₁) ≤ v,  j'·2x(x + L₁)² ≤ distance,             j' = s·L₁
        L₃ = x:  a'·x ≤ v,  a'·x(x + L₁ + L₂) ≤ distance,                             a' = j'·L₂
        L₄ = distance / v',                                                           v' = a'·L₃

    The highest limit is thus always used in full, and a limit is lowered only if the limit of a lower derivative, or
    the distance, does not allow it to be reached: first the velocity is lowered (L₃), then the acceleration (L₂), then
    the jerk (L₁).  Since the product of the lengths is fixed and short lengths are lower bounds of long ones, making
    the short lengths as long as possible minimizes the sum, which is the time of the move.  The last length is distance
    / v' with the computed v', so that the distance is exact.

    Raises StructureError if the move would never end, if the numbers overflow, and, as an internal check, if the
    finished profile violates a limit.
    """
    height, span = limits[-1], 0.0
    goals = [*reversed(limits[:-1]), distance]
    lengths: list[float] = []
    while goals:
        # the floor only keeps the quotients finite until the refusal below
        shares = [goal / max(height, _TINY) for goal in goals]
        if height < _TINY or distance < _TINY or min(shares) < 1.0 / _HUGE:
            raise StructureError(f"{kind}: distance and limits are too far apart to compute with: check their units")
        longest = min(_longest(min(share, _HUGE), place, span) for place, share in enumerate(shares))
        # if a lower goal was just met, rounding may leave `longest` below the sum
        length = max(span, longest)
        lengths.append(length)
        height, span = height * length, span + length
        goals = goals[1:]
    profile = Profile(distance, tuple(lengths))
    profile.check(kind, limits)
    return profile


def _longest(goal: float, place: int, span: float) -> float:
    """Return the x for which x, x(x + span), 2x(x + span)² or 8x(x + span)³ (`place` 0 .. 3) equals `goal`."""
    if place == 0:
        return goal
    if place == 1:
        # the positive root without the difference of two nearly equal numbers
        return 2.0 * goal / (span + math.sqrt(span * span + 4.0 * goal))
    if span == 0.0:
        return math.cbrt(0.5 * goal) if place == 2 else math.sqrt(math.sqrt(0.125 * goal))
    # y²(y - 1) = c with y = 1 + x/span; its one real root by the hyperbolic form of Cardano's formula, c >= 4 here
    c = goal / (2.0 * span) / span / span
    y = (1.0 + 2.0 * math.cosh(math.acosh(1.0 + 13.5 * c) / 3.0)) / 3.0
    return (y - 1.0) * span

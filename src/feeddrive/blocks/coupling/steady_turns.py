"""What cuts with one motion of a spindle at constant speed have in common: how far they look back, and signs."""

from typing import Any

from feeddrive.language.block import Number, Rule
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text

TOWARDS = ("negative", "positive")


def sign_of(towards: str) -> float:
    """Return 1 for a direction towards larger positions of an axis, and -1 otherwise."""
    return 1.0 if towards == "positive" else -1.0


def covers(kind: str, remembered: int, back: Any, h: Number) -> Rule:
    """Return the rule that the `remembered` substeps of h seconds reach `back` by a time in s."""
    return Rule(
        # the interpolation reads the two stored values around an instant, and the newest is a step behind
        back / h <= float(remembered - 2),
        "the substeps that the cut stores are not shorter than the turns that it looks back",
        lambda: Text(
            f"{kind}.remembered = {remembered} substeps of {Quantity(h, 's'):6 SI} are shorter than the "
            f"{Quantity(back, 's'):6 SI} that the cut looks back: at least {-int(-(back / h) // 1) + 2}"
        ),
    )

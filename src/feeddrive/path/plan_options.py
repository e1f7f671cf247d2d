"""Options of a plan, which the command line and the section [program] of a job state alike."""

from __future__ import annotations

import contextlib
import math
from typing import TYPE_CHECKING

import numpy as np

from feeddrive.language.errors import ParameterError, shown
from feeddrive.path.geometry.weights import ROTARY
from feeddrive.path.limits import MachineLimits
from feeddrive.path.program.moves import Orientation

if TYPE_CHECKING:
    from feeddrive.path.program.aiming import Turning

NAMED = "_depth=3, _feed=40"
"""An example of values by name."""
_AT_POLE = 0.5  # of the tolerance of angles: cone at the pole, in which the tool may be off its direction


def turning_of(orientation: str, limits: MachineLimits, tolerance: float | None) -> Turning:
    """Return how the tool turns where the program does not say; half of the tolerance of angles is for the pole.

    tolerance  tolerance of corners where the program states none, m; None: none
    """
    how: Orientation = orientation  # type: ignore[assignment]
    least = float(np.min(limits.angle_tolerances, initial=math.inf))
    from feeddrive.path.program.aiming import Turning  # imported late: the options of a job need no planner

    return Turning(how, _AT_POLE * least if math.isfinite(least) else 0.0, tolerance is not None)


def turning_within(limits: MachineLimits, tolerance: float, option: str) -> MachineLimits:
    """Return the limits with a tolerance, rad, for all rotary axes; `option` is its name, for messages."""
    if not limits.rotary:
        raise ParameterError(
            f"{option} is for axes that turn (a, b, c), and the machine has "
            f"{', '.join(limits.letters.lower())}: leave it out"
        )
    try:
        return limits.turning_within(tolerance)
    except ParameterError as error:
        raise ParameterError(f"{option}: {error}") from None


def read_start(option: str, text: str, letters: str) -> dict[str, float]:
    """Parse a position such as `X=10, C=90`, in mm and degrees; return it in m and rad by axis letter.

    letters  those of the machine's axes
    """
    values = named_values(option, text, "X=10, Y=-5")
    other = next((letter for letter in values if letter.upper() not in tuple(letters)), None)
    if other is not None:
        raise ParameterError(
            f"{option}: the machine has no axis {other.upper()}; it has {', '.join(letters)}: name those that do not "
            "stand at 0"
        )
    return {
        letter.upper(): math.radians(value) if letter.upper() in ROTARY else 1e-3 * value
        for letter, value in values.items()
    }


def named_values(option: str, text: str, example: str = NAMED) -> dict[str, float]:
    """Return values by name; raise ParameterError for an entry of the option that is no name and number."""
    values: dict[str, float] = {}
    for entry in text.split(","):
        name, equals, number = entry.rpartition("=")
        with contextlib.suppress(ValueError):
            if name.strip() and equals and math.isfinite(float(number)):
                values[name.strip()] = float(number)
                continue
        raise ParameterError(f"{option}: {shown(entry.strip())} is no name with a number: write {example}")
    return values

"""Feed override and feed hold: the feed factor as a function of time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity

MOST = 2.0
"""The largest factor."""


class Override(NamedTuple):
    """The feed factor as steps over time; constructed by `override`.

    time    start of each step, s from the start of the program, the first at 0, shape (n,)
    factor  feed factor from then on, 0 .. 2; 0 holds the motion, shape (n,)
    """

    time: np.ndarray
    factor: np.ndarray

    def at(self, time: float) -> float:
        """Return the factor at a time, s."""
        return float(self.factor[np.searchsorted(self.time, time, side="right") - 1])

    def moves_again(self, time: float) -> float:
        """Return the first time at or after `time` at which the factor is not 0, s."""
        k = int(np.searchsorted(self.time, time, side="right")) - 1
        if self.factor[k] > 0.0:
            return time
        return float(self.time[k + int(np.argmax(self.factor[k:] > 0.0))])


def override(steps: Sequence[tuple[float, float]]) -> Override:
    """Return an override from pairs of time (s) and factor; before the first pair the factor is 1.

    Raises ParameterError for times that do not increase, a factor outside 0 .. 2, and a hold that never ends.
    """
    time, factor = [0.0], [1.0]
    for k, (begin, value) in enumerate(steps):
        if not 0.0 <= begin < np.inf or (k and begin <= time[-1]):
            raise ParameterError(
                f"override: the times must rise from 0 s on, step {k + 1} is at {Quantity(begin, 's'):6 SI}"
            )
        if not 0.0 <= value <= MOST:
            raise ParameterError(
                f"override: the factor of step {k + 1} must be 0 .. {Quantity(MOST)} (0 .. "
                f"{Quantity(MOST, 'share'):6}), got {Quantity(value):6}"
            )
        if begin == 0.0:
            factor[0] = value
            continue
        time.append(float(begin))
        factor.append(float(value))
    if factor[-1] == 0.0:
        raise ParameterError("override: the last factor is 0, a hold that never ends: add a step with a factor > 0")
    return Override(np.array(time), np.array(factor, float))


def read_steps(text: str) -> Override:
    """Parse the text of an override: steps of time in s, a colon and the feed in %, e.g. `1:50, 2:0, 3.5:120`.

    Raises ParameterError as `override` does, and for malformed text.
    """
    steps: list[tuple[float, float]] = []
    for step in text.split(","):
        time, colon, percent = step.partition(":")
        try:
            steps.append((float(time), float(percent.strip().removesuffix("%")) / 100.0))
        except ValueError:
            missing = "" if colon else " (there is no colon)"
            raise ParameterError(
                f"override: {step.strip()!r} is no step{missing}: give the time in s, a colon and the feed in %, such "
                "as 1:50, 2:0, 3.5:120"
            ) from None
    return override(steps)

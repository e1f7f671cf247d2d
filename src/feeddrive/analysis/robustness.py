"""Robustness figures of a loop: slowest pole, Ms, delay margin and rope-snap error."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from feeddrive.analysis.loop_model import loop_model
from feeddrive.analysis.margins import margins
from feeddrive.analysis.stiffness import rope_snap
from feeddrive.loop.loop import Loop

_EDGE = 1e-9  # of |z|: what eigenvalues of a small matrix are uncertain by


class Robustness(NamedTuple):
    """The robustness figures of a loop. If it is unstable, Ms and the rope snap are infinite, the delay margin is 0."""

    growth: float  # |z| of the largest pole; infinite where the parameters do not fit each other
    sensitivity_peak: float = np.inf  # Ms
    delay_margin_samples: float = 0.0  # infinite without a gain crossover
    rope_snap: float = np.inf  # m s^½/N

    @property
    def stable(self) -> bool:
        """True if all poles lie inside the unit circle."""
        return self.growth < 1.0 - _EDGE


def robustness(loop: Loop, *, velocity: float = 0.05, per_decade: int = 40) -> Robustness:
    """Compute the robustness figures of a loop that moves with `velocity` (m/s), opened at the actuator."""
    both = loop_model(loop, velocity=velocity)
    poles = both.closed.poles()  # over a period
    growth = float(abs(poles[0])) if poles.size else 0.0
    # margins of an unstable loop are numbers without a meaning
    if not Robustness(growth).stable:
        return Robustness(growth)
    margins_ = margins(both.loop_gain(both.lines(per_decade)))
    if not np.isfinite(margins_.sensitivity_peak):
        return Robustness(np.inf)  # the parameters are so extreme that rounding leaves no digits
    delay = margins_.delay_margin_samples
    return Robustness(growth, margins_.sensitivity_peak, np.inf if delay is None else delay, rope_snap(both.closed))

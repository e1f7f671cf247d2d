"""What a candidate is judged by: poles, sensitivity peak, delay margin, rope-snap error; from one linearisation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from feeddrive.analysis.margins import margins
from feeddrive.analysis.opened import opened
from feeddrive.analysis.recovery import rope_snap
from feeddrive.language import tree
from feeddrive.language.errors import FeeddriveError
from feeddrive.loop.loop import Loop

_EDGE = 1e-9  # of |z|: what eigenvalues of a small matrix are uncertain by


class Robustness(NamedTuple):
    """Figures of one loop; those behind `growth` are infinite, or 0 for the delay margin, if it is not stable."""

    growth: float  # |z| of the largest pole; infinite where the parameters do not fit each other
    sensitivity_peak: float = np.inf  # Ms
    delay_margin_samples: float = 0.0  # infinite without a gain crossover
    rope_snap: float = np.inf  # m s^½/N

    @property
    def stable(self) -> bool:
        """All poles inside the unit circle."""
        return self.growth < 1.0 - _EDGE


def robustness(loop: Loop, *, velocity: float = 0.05, per_decade: int = 40) -> Robustness:
    """The figures of a loop that moves with `velocity` (m/s), opened at the actuator."""
    both = opened(loop, velocity=velocity)
    poles = both.closed.poles()
    growth = float(abs(poles[0])) if poles.size else 0.0
    if not Robustness(growth).stable:
        return Robustness(growth)
    found = margins(both.loop_gain(both.lines(per_decade)))
    if not np.isfinite(found.sensitivity_peak):
        return Robustness(np.inf)  # so far out that nothing is left of its digits
    delay = found.delay_margin_samples
    return Robustness(growth, found.sensitivity_peak, np.inf if delay is None else delay, rope_snap(both.closed))


class Judge:
    """Judges a loop at values of some of its parameters; values are logarithms. Each point is computed once."""

    def __init__(self, loop: Loop, names: tuple[str, ...], velocity: float) -> None:
        self.loop, self.names, self.velocity = loop, names, velocity
        # linear models have neither guard nor limit: without them no block is made, and checked, at each point
        self._bare = replace(loop, control=replace(loop.control, guard=None, force_limit=None))
        self._known: dict[bytes, Robustness] = {}

    @property
    def count(self) -> int:
        """Points that were computed."""
        return len(self._known)

    def values(self, x: np.ndarray) -> Mapping[str, float]:
        """The parameters at a point."""
        return dict(zip(self.names, np.exp(x).tolist(), strict=True))

    def at(self, x: np.ndarray) -> Loop:
        """The loop at a point. Raises ParameterError or StructureError where the values are out of bounds."""
        return tree.vary(self.loop, self.values(x))

    def __call__(self, x: np.ndarray) -> Robustness:
        """The figures at a point; where the values do not fit each other nothing is stable."""
        key = np.asarray(x, dtype=float).tobytes()
        if key not in self._known:
            self._known[key] = self._judged(x)
        return self._known[key]

    def _judged(self, x: np.ndarray) -> Robustness:
        values = self.values(x)
        # without the checks of the blocks: an unstable law's is dear, and its poles say the same
        plain = tree.rebuild(self._bare, (values.get(name, value) for name, value in tree.leaves(self._bare)))
        try:
            return robustness(plain, velocity=self.velocity)
        except (FeeddriveError, np.linalg.LinAlgError, ArithmeticError):
            # so large that the model overflows: no candidate
            return Robustness(np.inf)

    def fits(self, x: np.ndarray) -> bool:
        """Whether the blocks themselves accept the values of a point."""
        try:
            self.at(x)
        except (FeeddriveError, ArithmeticError):
            return False
        return True

"""A run that shows cogging: position in turns, and the force that held or moved the axis there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from feeddrive.language.errors import LogError, NotIdentifiableError, ParameterError

_ONE_WAY = 0.98  # share of a run's steps that must go its way


@dataclass(frozen=True, eq=False)
class CoggingRun:
    """Position in turns (or in periods of whatever repeats) and the force that held or moved the axis, shape (n,).

    direction is +1 for a run towards larger positions and -1 for the other; by default it is seen in the positions.
    """

    turns: np.ndarray
    force: np.ndarray
    direction: int = 0

    def __post_init__(self) -> None:
        turns, force = np.asarray(self.turns, dtype=np.float64), np.asarray(self.force, dtype=np.float64)
        if turns.ndim != 1 or turns.shape != force.shape:
            raise LogError(f"a cogging run needs one force for each position, not {force.shape} for {turns.shape}")
        if not (np.all(np.isfinite(turns)) and np.all(np.isfinite(force))):
            bad = int(np.argmin(np.isfinite(turns) & np.isfinite(force)))
            raise LogError(f"a cogging run is not finite at row {bad + 1}; cut it there")
        direction = self.direction
        if direction == 0:
            steps = np.diff(turns)
            steps = steps[np.abs(steps) > 0.0]
            share = float(np.mean(steps > 0.0)) if steps.size else 0.5
            if 1.0 - _ONE_WAY < share < _ONE_WAY:
                raise NotIdentifiableError(
                    f"a cogging run goes both ways ({100.0 * share:.3g} % of its steps forward): friction changes its "
                    f"sign within it; cut it into runs of one direction, or state `direction`"
                )
            direction = 1 if share > 0.5 else -1
        if direction not in (-1, 1):
            raise ParameterError(f"direction = {direction} must be 1 or -1")
        for name, value in (("turns", turns), ("force", force), ("direction", direction)):
            object.__setattr__(self, name, value)

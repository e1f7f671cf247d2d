"""Whether a substep is short enough for what happens in it."""

from __future__ import annotations

import math

import numpy as np

from feeddrive.language import tree
from feeddrive.loop.loop import Loop

# rad that the fastest mode may turn in a substep: a tenth of a turn, by judgement
MOST_TURN = 0.6


def fastest_mode(loop: Loop) -> float:
    """Natural frequency of the fastest vibration of the axis in Hz; 0 for a rigid one."""
    mechanics = loop.axis.mechanics()
    mass = np.array(mechanics.mass, dtype=float)
    stiffness = np.array(mechanics.stiffness, dtype=float)
    squares = np.linalg.eigvals(np.linalg.solve(mass, stiffness))
    return float(np.sqrt(np.max(np.abs(squares), initial=0.0)) / (2.0 * np.pi))


def substeps_needed(loop: Loop) -> int:
    """Substeps for friction and other forces on a flexible axis: the exact hold itself needs one only.

    Without friction and forces that depend on motion it is 1.
    """
    axis = loop.axis
    held = (axis.friction_motor, axis.friction_load)
    if not axis.forces and all(friction is None for friction in held):
        return 1
    turn = 2.0 * math.pi * fastest_mode(loop) * float(tree.get(loop, "sample_time"))
    return max(1, math.ceil(turn / MOST_TURN))

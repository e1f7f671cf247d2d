"""Whether the exact hold can still be computed: an axis that is far too fast for its substeps is refused."""

from __future__ import annotations

import math

import numpy as np

from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.loop.axis import Axis

# Beyond these a substep's exponential loses the digits that are promised: rad a mode turns, and how often a decay by e
# passes.  A lag that decays by e^-100 in a substep is an ideal one.
MOST_TURN, MOST_DECAY = 1000.0, 100.0


def check_fastest(axis: Axis, T: float) -> None:
    """Raise ParameterError if current loop, damping or a mode is too fast for substeps of T/substeps (s)."""
    h = T / axis.substeps
    lag = axis.actuator.current_loop
    if isinstance(lag, float) and 2.0 * math.pi * lag * h > MOST_DECAY:
        raise ParameterError(
            f"axis.actuator.current_loop = {lag:g} Hz is over within a substep of {h:g} s: leave it out for an ideal "
            f"current loop, or keep it below {MOST_DECAY / (2.0 * math.pi * h):g} Hz"
        )
    given = tree.leaves((axis.plant, axis.friction_motor, axis.friction_load))
    if any(not isinstance(value, (float, np.floating)) for _, value in given):
        return  # variants and symbols are checked as the single axes that they come from
    mechanics = axis.mechanics()
    mass, stiffness, damping = (
        np.array(matrix, dtype=float) for matrix in (mechanics.mass, mechanics.stiffness, mechanics.damping)
    )
    with np.errstate(all="ignore"):
        try:
            squares = np.abs(np.linalg.eigvals(np.linalg.solve(mass, stiffness)))
            decays = np.abs(np.linalg.eigvals(np.linalg.solve(mass, damping)))
        except np.linalg.LinAlgError:
            squares = decays = np.array([np.inf])
    mode, decay = math.sqrt(float(np.max(squares))), float(np.max(decays))
    if not mode * h <= MOST_TURN:
        raise ParameterError(
            f"axis.plant: its fastest mode, {mode / (2.0 * math.pi):.4g} Hz, turns {mode * h:.4g} rad in a substep of "
            f"{h:g} s, more than {MOST_TURN:g}: check masses and stiffnesses, or raise substeps"
        )
    if not decay * h <= MOST_TURN:
        raise ParameterError(
            f"axis.plant: its fastest motion dies out in {1.0 / decay:.4g} s, more than {MOST_TURN:g} times within a "
            f"substep of {h:g} s: check masses and damping, or raise substeps"
        )

"""Refuses an axis whose fastest mode is too fast for its substep: the matrix exponential would lose its accuracy."""

from __future__ import annotations

import math
from collections.abc import Iterator

from feeddrive.blocks.families import Mechanics
from feeddrive.language import matrix
from feeddrive.language.block import Number, Rule

# Beyond these a substep's exponential loses the digits that are promised: rad a mode turns, and how often a decay by e
# passes.  A lag that decays by e^-100 in a substep is an ideal one.
MOST_TURN, MOST_DECAY = 1000.0, 100.0


def slow_enough(
    mechanics: Mechanics, current_loop: Number | None, h: Number, what: str = "axis.plant"
) -> Iterator[Rule]:
    """Current loop (Hz), damping and modes are slow enough for substeps of h s; `what` has them."""
    whose = "the axis" if what == "axis.plant" else what
    if current_loop is not None:
        yield Rule(
            2.0 * math.pi * current_loop * h <= MOST_DECAY,
            "the actuator's current_loop is slow enough for a substep",
            lambda: (
                f"axis.actuator.current_loop = {current_loop:g} Hz is over within a substep of {h:g} s: leave it out "
                f"for an ideal current loop, or keep it below {MOST_DECAY / (2.0 * math.pi * h):g} Hz"
            ),
        )
    squares = matrix.solve(mechanics.mass, mechanics.stiffness)
    turn = h / MOST_TURN
    yield Rule(
        matrix.decays(matrix.scale(turn * turn, squares)),
        f"the fastest mode of {whose} is slow enough for a substep: masses are not too small, nor springs too stiff",
        lambda: _too_fast_a_mode(math.sqrt(matrix.growth(squares)), h, what),
    )
    decays = matrix.solve(mechanics.mass, mechanics.damping)
    yield Rule(
        matrix.decays(matrix.scale(turn, decays)),
        f"the fastest motion of {whose} dies out slowly enough for a substep: masses are not too small, nor damping "
        "too large",
        lambda: (
            f"{what}: its fastest motion dies out in {1.0 / matrix.growth(decays):.4g} s, more than {MOST_TURN:g} "
            f"times within a substep of {h:g} s: check masses and damping, or raise substeps"
        ),
    )


def _too_fast_a_mode(mode: float, h: float, what: str) -> str:
    return (
        f"{what}: its fastest mode, {mode / (2.0 * math.pi):.4g} Hz, turns {mode * h:.4g} rad in a substep of "
        f"{h:g} s, more than {MOST_TURN:g}: check masses and stiffnesses, or raise substeps"
    )

"""The figures by which laws are ranked, and those of a law that come from its linear model."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from feeddrive.analysis.loop_model import LoopModel
from feeddrive.figures.figure import Figure
from feeddrive.figures.linear_loop import LinearLoop
from feeddrive.figures.of_loops import (
    CROSSOVER,
    DELAY_MARGIN,
    EFFORT,
    FORCE_NOISE,
    NOISE_GAIN,
    PHASE_MARGIN,
    ROPE_SNAP,
    SENSITIVITY_PEAK,
    STIFFNESS_AT,
    STIFFNESS_LEAST,
    STIFFNESS_OVER,
    StiffnessAt,
    StiffnessOver,
)
from feeddrive.figures.of_runs import (
    SNAP_PEAK,
    SNAP_SETTLING,
    STEP_PEAK,
    STEP_SETTLING,
    TRACKING_PEAK,
    TRACKING_RMS,
)
from feeddrive.loop.loop import Loop

TIE = 0.005  # share by which figures must differ to be ranked apart


CRITERIA = (
    ROPE_SNAP,
    *STIFFNESS_AT,
    TRACKING_RMS,
    TRACKING_PEAK,
    SNAP_PEAK,
    SNAP_SETTLING,
    STEP_PEAK,
    STEP_SETTLING,
    STIFFNESS_OVER[2],
    STIFFNESS_LEAST,
    FORCE_NOISE,
    EFFORT,
)
"""The figures by which laws are ranked."""
LINEAR = (
    SENSITIVITY_PEAK,
    DELAY_MARGIN,
    PHASE_MARGIN,
    CROSSOVER,
    ROPE_SNAP,
    FORCE_NOISE,
    NOISE_GAIN,
    *STIFFNESS_OVER,
    *STIFFNESS_AT,
    STIFFNESS_LEAST,
)
"""The figures of a law that come from its linear model."""


def ranks(criterion: Figure, figures: Sequence[Mapping[str, float | None]]) -> list[int | None]:
    """The place of each law, 1 for the best; those within half a percent share one, and what has no figure has none.

    What is infinite (a law that never settles, a force that is never held) has a figure: the last place.
    """
    values = [row.get(criterion.key) for row in figures]
    found: list[int | None] = []
    for value in values:
        better = sum(
            1 for other in values if value is not None and other is not None and beats(criterion, other, value)
        )
        found.append(None if value is None else 1 + better)
    return found


def beats(criterion: Figure, a: float, b: float) -> bool:
    """Whether a is better than b by more than a tie; two infinite values are equal."""
    better, worse = (b, a) if criterion.higher else (a, b)
    if math.isinf(better) or math.isinf(worse):
        return better < worse
    return better < (1.0 - TIE) * worse


def linear(loop: Loop, both: LoopModel) -> dict[str, float | None]:
    """Margins, rope-snap error, stiffness by band, noise in the force, effort; of a stable loop."""
    model = LinearLoop(loop, known=both)
    return effort_of(loop) | {figure.key: figure.value(model) for figure in LINEAR if _below(figure, model.nyquist)}


def _below(figure: Figure, nyquist: float) -> bool:
    """Return True for a figure whose frequencies lie below half the sample rate."""
    of: Any = figure.of
    if isinstance(of, StiffnessAt):
        return of.frequency < nyquist
    return of.high <= nyquist if isinstance(of, StiffnessOver) else True


def effort_of(loop: Loop) -> dict[str, float | None]:
    """Return the operations of one sample."""
    return {EFFORT.key: EFFORT.read(LinearLoop(loop))}

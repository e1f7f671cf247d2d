"""The figures by which laws are ranked, and the ranking."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any, TypeAlias

from feeddrive.analysis.loop_model import LoopModel, loop_model
from feeddrive.analysis.margins import margins
from feeddrive.analysis.stability import stability
from feeddrive.figures import of_loops, of_runs
from feeddrive.figures.catalogue import figures as catalogue
from feeddrive.figures.figure import DUTY, Figure
from feeddrive.figures.of_loops import LinearLoop
from feeddrive.language import tree
from feeddrive.loop.loop import Loop

Values: TypeAlias = Mapping[str, float | None]
"""Figures of a law in SI units by key; None where the law has no such figure."""
TIE = 0.005  # least relative difference of figures that are ranked differently

CRITERIA = (
    of_loops.ROPE_SNAP,
    *of_loops.STIFFNESS_AT,
    of_runs.TRACKING_RMS,
    of_runs.TRACKING_PEAK,
    of_runs.SNAP_PEAK,
    of_runs.SNAP_SETTLING,
    of_runs.STEP_PEAK,
    of_runs.STEP_SETTLING,
    of_loops.STIFFNESS_OVER[2],
    of_loops.STIFFNESS_LEAST,
    of_loops.FORCE_NOISE,
    of_loops.EFFORT,
)
"""The figures by which laws are ranked."""
LINEAR = tuple(figure for figure in of_loops.OF_LOOPS if figure.judges_laws)
"""The figures of a law that come from its linear model."""
ROBUST = Figure("sensitivity_peak_varied", "Ms varied", "", DUTY, meaning="largest Ms with wrong masses or stiffnesses")
# units of a plant's numbers that are wrong together, and the power of the share that they take: a frequency is a root
_WRONG = ({"kg": 1.0, "kg m2": 1.0}, {"N/m": 1.0, "Hz": 0.5})


def ranks(criterion: Figure, figures: Sequence[Values]) -> list[int | None]:
    """Return the rank of each law by one figure; 1 is the best, ties share a rank, and a missing figure has rank None.

    An infinite figure, such as the settling time of a law that never settles, is ranked last.
    """
    values = [row.get(criterion.key) for row in figures]
    known = [value for value in values if value is not None]
    return [None if value is None else 1 + sum(beats(criterion, other, value) for other in known) for value in values]


def beats(criterion: Figure, a: float, b: float) -> bool:
    """Return True if a is better than b by more than the tolerance for ties; two infinite values are a tie."""
    better, worse = (b, a) if criterion.higher else (a, b)
    if math.isinf(better) or math.isinf(worse):
        return better < worse
    return better < (1.0 - TIE) * worse


def losses(ours: Values, theirs: Values) -> list[tuple[Figure, float, float]]:
    """Return each criterion by which our law is worse than the other one, with the values of both."""
    both = ((criterion, ours.get(criterion.key), theirs.get(criterion.key)) for criterion in CRITERIA)
    return [(c, a, b) for c, a, b in both if a is not None and b is not None and beats(c, b, a)]


def linear(loop: Loop, both: LoopModel) -> dict[str, float | None]:
    """Return margins, rope-snap error, stiffness by band, force noise and computing effort of a stable loop."""
    model = LinearLoop(loop, known=both)
    return effort_of(loop) | {figure.key: figure.value(model) for figure in LINEAR if _below(figure, model.nyquist)}


def _below(figure: Figure, nyquist: float) -> bool:
    """Return True unless the figure needs frequencies above the Nyquist frequency."""
    of: Any = figure.of
    if isinstance(of, of_loops.StiffnessAt):
        return of.frequency < nyquist
    return of.high <= nyquist if isinstance(of, of_loops.StiffnessOver) else True


def effort_of(loop: Loop) -> dict[str, float | None]:
    """Return the figure for the computing effort by its key: the number of operations per sample."""
    return {of_loops.EFFORT.key: of_loops.EFFORT.read(LinearLoop(loop))}


def worst(figures: Sequence[Values]) -> dict[str, float | None]:
    """Return the worst value of each figure over all rows, by key; None if any row lacks the figure."""
    known, worst_values = catalogue(), dict[str, float | None]()
    for key in figures[0]:
        values = [value for row in figures if (value := row.get(key)) is not None]
        higher = key in known and known[key].higher
        # a figure that is missing in one row may be the worst there: the other rows do not bound it
        worst_values[key] = None if len(values) < len(figures) else (min if higher else max)(values)
    return worst_values


def robust_peak(loop: Loop, velocity: float, share: float) -> float:
    """Return the largest Ms over plants in which all masses, or all stiffnesses, differ from the model by ±`share`.

    The result is infinite if the loop is unstable with any of these plants.
    """
    peaks: list[float] = []
    for powers, factor in product(_WRONG, (1.0 - share, 1.0 + share)):
        plant = loop.axis.plant
        changes = {
            name: value * factor ** powers[unit]
            for name, value in tree.leaves(plant)
            if (unit := tree.declaration(plant, name).unit) in powers
        }
        if not changes:
            continue
        wrong = replace(loop, axis=replace(loop.axis, plant=tree.vary(plant, changes)))
        if not stability(wrong, velocity=velocity).stable:
            return math.inf
        both = loop_model(wrong, velocity=velocity)
        peaks.append(margins(both.loop_gain(both.lines(200))).sensitivity_peak)
    return max(peaks)

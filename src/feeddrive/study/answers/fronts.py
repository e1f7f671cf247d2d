"""The Pareto front between stiffness, tracking and robustness: machines of which no other one is better in all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from feeddrive.figures.figure import Figure
from feeddrive.figures.of_loops import (
    DELAY_MARGIN,
    GAIN_MARGIN,
    PHASE_MARGIN,
    ROPE_SNAP,
    SENSITIVITY_PEAK,
    STIFFNESS_AT,
    STIFFNESS_LEAST,
    STIFFNESS_OVER,
)
from feeddrive.figures.of_runs import FOLLOWING_PEAK, FOLLOWING_RMS, TRACKING_END, TRACKING_PEAK, TRACKING_RMS
from feeddrive.study.answers.judged import Judged, joined
from feeddrive.study.study import Study

# the figures of each subject, of which the first one that a study measures is used
SUBJECTS = {
    "tracking": (TRACKING_RMS, TRACKING_PEAK, FOLLOWING_RMS, FOLLOWING_PEAK, TRACKING_END),
    "stiffness": (
        STIFFNESS_LEAST,
        STIFFNESS_OVER[1],
        *STIFFNESS_AT,
        STIFFNESS_OVER[0],
        STIFFNESS_OVER[2],
        ROPE_SNAP,
    ),
    "robustness": (SENSITIVITY_PEAK, DELAY_MARGIN, PHASE_MARGIN, GAIN_MARGIN),
}


def subjects(study: Study) -> dict[str, Figure]:
    """Return the measured figure of each subject."""
    measured = {
        subject: next((figure for figure in figures if figure in study.measure), None)
        for subject, figures in SUBJECTS.items()
    }
    return {subject: figure for subject, figure in measured.items() if figure is not None}


@dataclass(frozen=True, eq=False)
class Front:
    """The variants of the front with their rows, in the order of tracking, or of the first subject there is."""

    figures: dict[str, Figure]
    rows: Judged


class FrontKept:
    """Collects the Pareto front of the rows, part by part."""

    def __init__(self, study: Study) -> None:
        self._figures = subjects(study)
        self._rows: Judged | None = None

    def add(self, rows: Judged) -> None:
        """Add some rows; those without a number for one of the figures are left out."""
        if len(self._figures) < 2:
            return
        several = [*([] if self._rows is None else [self._rows]), rows]
        together = joined([part.some(front(_costs(part, self._figures))) for part in several])
        self._rows = together.some(front(_costs(together, self._figures)))

    def result(self) -> Front | None:
        """Return the front; None for a study that measures fewer than two subjects, or has no variant with both."""
        if self._rows is None or not self._rows.variant.size:
            return None
        order = np.argsort(_costs(self._rows, self._figures)[:, 0], kind="stable")
        return Front(self._figures, self._rows.some(order))


def _costs(rows: Judged, figures: dict[str, Figure]) -> np.ndarray:
    """The objectives, all to be minimized, shape (n, subjects)."""
    return np.stack(
        [(-1.0 if figure.better == "higher" else 1.0) * rows.figures[figure.key] for figure in figures.values()], axis=1
    )


def front(costs: np.ndarray) -> np.ndarray:
    """True for rows that no other row dominates, by being as small everywhere and smaller somewhere; (n, m) -> (n,).

    Rows with NaN are not on it; of equal rows all are.
    """
    there = np.flatnonzero(~np.isnan(costs).any(axis=1))
    left = there[np.lexsort(costs[there].T[::-1])]  # what dominates a row stands before it
    undominated = np.zeros(len(costs), dtype=bool)
    while left.size:
        first = costs[left[0]]
        equal = (costs[left] == first).all(axis=1)
        undominated[left[equal]] = True
        left = left[~equal & (costs[left] < first).any(axis=1)]
    return undominated

"""The Pareto front between stiffness, tracking and robustness: machines of which no other one is better in all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from feeddrive.study.answers.judged import Judged, joined
from feeddrive.study.figure import Figure
from feeddrive.study.study import Study

# by subject the figures that speak for it: the first one that a study measures
SUBJECTS = {
    "tracking": (
        "tracking_error_rms_m", "tracking_error_peak_m", "following_error_rms_m", "following_error_peak_m",
        "tracking_error_end_m",
    ),
    "stiffness": (
        "stiffness_least_N_per_m", "stiffness_10_100_Hz_N_per_m", "stiffness_10_Hz_N_per_m", "stiffness_100_Hz_N_per_m",
        "stiffness_1_10_Hz_N_per_m", "stiffness_100_1000_Hz_N_per_m", "rope_snap_ISE_root_m_per_N",
    ),
    "robustness": ("sensitivity_peak", "delay_margin_samples", "phase_margin_deg", "gain_margin_dB"),
}  # fmt: skip


def subjects(study: Study) -> dict[str, Figure]:
    """By subject its figure, of those that a study measures."""
    measured = {each.name: each for each in study.measure}
    found = {subject: next((measured[name] for name in names if name in measured), None)
             for subject, names in SUBJECTS.items()}  # fmt: skip
    return {subject: figure for subject, figure in found.items() if figure is not None}


@dataclass(frozen=True, eq=False)
class Front:
    """The variants of the front with their rows, in the order of tracking, or of the first subject there is."""

    figures: dict[str, Figure]
    rows: Judged


class FrontKept:
    """The front so far, a part of the rows after the other."""

    def __init__(self, study: Study) -> None:
        self._figures = subjects(study)
        self._rows: Judged | None = None

    def add(self, rows: Judged) -> None:
        """Put in some rows; those without a number for one of the figures are left out."""
        if len(self._figures) < 2:
            return
        several = [*([] if self._rows is None else [self._rows]), rows]
        together = joined([each.some(front(_costs(each, self._figures))) for each in several])
        self._rows = together.some(front(_costs(together, self._figures)))

    def result(self) -> Front | None:
        """None for a study that measures fewer than two subjects, or has no variant with both."""
        if self._rows is None or not self._rows.variant.size:
            return None
        order = np.argsort(_costs(self._rows, self._figures)[:, 0], kind="stable")
        return Front(self._figures, self._rows.some(order))


def _costs(rows: Judged, figures: dict[str, Figure]) -> np.ndarray:
    """What is to be small, shape (n, subjects)."""
    return np.stack(
        [(-1.0 if each.better == "higher" else 1.0) * rows.figures[each.name] for each in figures.values()], axis=1
    )


def front(costs: np.ndarray) -> np.ndarray:
    """Which rows no other row dominates: none is as small everywhere and smaller somewhere. Shape (n, m) -> (n,).

    Rows with NaN are not on it; of equal rows all are.
    """
    there = np.flatnonzero(~np.isnan(costs).any(axis=1))
    left = there[np.lexsort(costs[there].T[::-1])]  # what dominates a row stands before it
    found = np.zeros(len(costs), dtype=bool)
    while left.size:
        first = costs[left[0]]
        equal = (costs[left] == first).all(axis=1)
        found[left[equal]] = True
        left = left[~equal & (costs[left] < first).any(axis=1)]
    return found

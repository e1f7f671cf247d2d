"""By what the laws of the arena are ranked."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

TIE = 0.005  # share by which figures must differ to be ranked apart


class Criterion(NamedTuple):
    """A figure by which laws are ranked: its name in files (SI), in words, unit and factor as shown, what is better."""

    key: str
    head: str
    unit: str
    factor: float = 1.0
    higher: bool = False


CRITERIA = (
    Criterion("tracking_error_rms_m", "tracking RMS", "µm", 1e6),
    Criterion("tracking_error_peak_m", "tracking peak", "µm", 1e6),
    Criterion("snap_peak_m", "rope snap peak", "µm", 1e6),
    Criterion("snap_settling_s", "rope snap settling", "ms", 1e3),
    Criterion("step_peak_m", "force step peak", "µm", 1e6),
    Criterion("step_settling_s", "force step settling", "ms", 1e3),
    Criterion("rope_snap_ISE_root_m_per_N", "rope snap ISE^½", "nm √s/N", 1e9),
    Criterion("stiffness_1_10_Hz_N_per_m", "stiffness 1-10 Hz", "N/µm", 1e-6, higher=True),
    Criterion("stiffness_10_100_Hz_N_per_m", "stiffness 10-100 Hz", "N/µm", 1e-6, higher=True),
    Criterion("stiffness_100_1000_Hz_N_per_m", "stiffness 100-1000 Hz", "N/µm", 1e-6, higher=True),
    Criterion("stiffness_least_N_per_m", "least stiffness", "N/µm", 1e-6, higher=True),
    Criterion("force_noise_N", "noise in the force, RMS", "N"),
    Criterion("operations", "effort", "operations a sample"),
)


def ranks(criterion: Criterion, figures: Sequence[Mapping[str, float | None]]) -> list[int | None]:
    """The place of each law, 1 for the best; those within half a per cent share one, and what has no figure has none.

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


def beats(criterion: Criterion, a: float, b: float) -> bool:
    """Whether a is better than b by more than a tie; what is infinite is neither better nor worse than its like."""
    better, worse = (b, a) if criterion.higher else (a, b)
    if math.isinf(better) or math.isinf(worse):
        return better < worse
    return better < (1.0 - TIE) * worse

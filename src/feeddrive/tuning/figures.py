"""Figures of a closed loop as they are reported: margins, stiffness, rope snap, force noise; with uncertainties."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from feeddrive.analysis.margins import Margins, bandwidth, margins, peak_deviation
from feeddrive.analysis.stiffness import Stiffness, rope_snap_of_lines, stiffness
from feeddrive.loop.frequency_response import FRF
from feeddrive.tuning.closed_loop import Answer, encircles
from feeddrive.tuning.limits import force_noise


@dataclass(frozen=True, eq=False)
class Figures:
    """Of one control at one point; infinite or 0 where the loop is unstable.

    deviation  standard deviation of Ms from the variance of the measurement, 0 for a model
    """

    point: str
    stable: bool
    loop_gain: FRF
    compliance: FRF
    rope_snap: float  # m s^½/N
    bandwidth: float | None  # Hz, where |S| rises to -3 dB
    force_noise: float | None  # N RMS
    deviation: float
    at_drive: bool

    @property
    def margins(self) -> Margins:
        """Of the loop gain."""
        return margins(self.loop_gain)

    @property
    def stiffness(self) -> Stiffness:
        """The inverse of the compliance."""
        return stiffness(self.compliance)

    @property
    def peak_compliance(self) -> float:
        """m/N."""
        return float(1.0 / self.stiffness.minimum)


def figures(answer: Answer, reading_noise: tuple[float, float]) -> Figures:
    """From a closed loop on all lines of its point."""
    point = answer.point
    f, T = point.frequency, point.sample_time
    L = FRF(f, answer.gain, "cut", "force", "N/N", T, variance=None if point.variance is None else answer.gain_variance)
    C = FRF(f, answer.compliance, "load_force", "position_load", "m/N", T)
    stable = not encircles(answer)
    recovery = answer.recovery()
    return Figures(
        point=point.name,
        stable=stable,
        loop_gain=L,
        compliance=C,
        rope_snap=rope_snap_of_lines(recovery.frequency, recovery.compliance, T) if stable else np.inf,
        bandwidth=bandwidth(f, answer.gain) if stable else None,
        force_noise=force_noise(answer, reading_noise) if any(reading_noise) else None,
        deviation=peak_deviation(answer.gain, answer.gain_variance),
        at_drive=point.at_drive,
    )


def _at(each: Figures, frequency: float) -> float | None:
    f = each.compliance.frequency
    return 1e-6 * each.stiffness.at(frequency) if f[0] <= frequency <= f[-1] else None


# head, unit, how it is read off
FIGURES: tuple[tuple[str, str, Callable[[Figures], float | None]], ...] = (
    ("Ms", "", lambda each: each.margins.sensitivity_peak),
    ("its standard deviation", "", lambda each: each.deviation or None),
    ("crossover", "Hz", lambda each: each.margins.crossover),
    ("bandwidth (|S| at -3 dB)", "Hz", lambda each: each.bandwidth),
    ("phase margin", "deg", lambda each: each.margins.phase_margin_deg),
    ("gain may rise by", "dB", lambda each: each.margins.gain_increase_dB),
    ("delay margin", "samples", lambda each: each.margins.delay_margin_samples),
    ("least stiffness", "N/um", lambda each: 1e-6 * each.stiffness.minimum),
    ("stiffness at 10 Hz", "N/um", lambda each: _at(each, 10.0)),
    ("peak compliance", "um/N", lambda each: 1e6 * each.peak_compliance),
    ("rope-snap error", "nm s^1/2/N", lambda each: 1e9 * each.rope_snap),
    ("force noise", "N RMS", lambda each: each.force_noise),
)
# which of them are better when they are larger; of the others Ms is bounded and the crossover is neither
LARGER = {
    "bandwidth (|S| at -3 dB)": True, "phase margin": True, "gain may rise by": True, "delay margin": True,
    "least stiffness": True, "stiffness at 10 Hz": True, "rope-snap error": False, "force noise": False,
}  # fmt: skip

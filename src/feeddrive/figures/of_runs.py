"""The figures of runs: from statistics gathered during a batch, from a recorded run, or from runs of a comparison."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from feeddrive.figures.figure import DUTY, LOWER, NEUTRAL, RUN, STATISTICS, Figure, Statistics
from feeddrive.language.units import in_key
from feeddrive.loop.simulate import Run


@dataclass(frozen=True)
class Of:
    """A statistic of a signal, for use as `Figure.of`."""

    signal: str
    what: str

    def __call__(self, statistics: Statistics) -> np.ndarray:
        """Return the statistic, shape (n,), of all variants."""
        return statistics.rms(self.signal) if self.what == "rms" else statistics.peak(self.signal)


def _of_signal(signal: str, unit: str, title: str, meaning: str, better: str = LOWER) -> Iterator[Figure]:
    for what, name, statistic in (("rms", "RMS", "root mean square"), ("peak", "peak", "largest absolute value")):
        yield Figure(
            f"{signal}_{what}_{in_key(unit)}",
            f"{title} {name}",
            unit,
            STATISTICS,
            Of(signal, what),
            better,
            f"{statistic} of the {meaning}",
            title if what == "rms" else "",
            signals=(signal,),
        )


def _error_at_end(run: Run) -> float:
    return abs(float(run["tracking_error"][-1]))


def _saturated(run: Run) -> float:
    # the limiter returns its argument unchanged while it is inactive, so exact comparison is correct
    return float(np.mean(run["force"] != run["requested"]))


def _tripped(run: Run) -> float:
    return float(np.any(run["trip"] > 0.0))


def _jerk(run: Run) -> float:
    return float(np.sqrt(np.mean(np.diff(run["force"]) ** 2)))


OF_SIGNALS = (
    *_of_signal("following_error", "m", "following error", "set position minus position as the control reads it"),
    *_of_signal("tracking_error", "m", "tracking", "set position minus true position of the load"),
    *_of_signal("force", "N", "force", "force commanded after the limit"),
    *_of_signal("velocity_load", "m/s", "velocity", "velocity of the load", NEUTRAL),
)
FOLLOWING_RMS, FOLLOWING_PEAK, TRACKING_RMS, TRACKING_PEAK, FORCE_RMS, FORCE_PEAK = OF_SIGNALS[:6]
TRACKING_END = Figure("tracking_error_end_m", "absolute tracking error in the last sample", "m", RUN, _error_at_end)

SNAP_PEAK = Figure("snap_peak_m", "rope snap peak", "m", DUTY, meaning="largest error after a rope is cut")
SNAP_SETTLING = Figure("snap_settling_s", "rope snap settling", "s", DUTY, short="settling")
STEP_PEAK = Figure("step_peak_m", "force step peak", "m", DUTY, meaning="largest error after a force is switched on")
STEP_SETTLING = Figure("step_settling_s", "force step settling", "s", DUTY, short="settling")
CUTTING_RMS = Figure("cutting_error_rms_m", "error while cutting, RMS", "m", DUTY, short="cutting")

OF_RUNS = (
    *OF_SIGNALS,
    TRACKING_END,
    Figure("limited_share", "share of the samples in which the force is at its limit", "", RUN, _saturated),
    Figure("tripped", "1 if the guard tripped, else 0", "", RUN, _tripped),
    Figure("force_step_rms_N", "root mean square of the change of the force from sample to sample", "N", RUN, _jerk),
    SNAP_PEAK,
    SNAP_SETTLING,
    STEP_PEAK,
    STEP_SETTLING,
    CUTTING_RMS,
)

"""The figures of a study that come from signals: statistics gathered while a batch runs, and whole runs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from feeddrive.loop.simulate import Run
from feeddrive.study.figure import Figure, Statistics


@dataclass(frozen=True)
class Of:
    """One statistic of one signal, as the function of a Figure."""

    signal: str
    what: str

    def __call__(self, statistics: Statistics) -> np.ndarray:
        """The values of all variants."""
        return statistics.rms(self.signal) if self.what == "rms" else statistics.peak(self.signal)


def _of_signal(signal: str, unit: str, meaning: str, better: str = "lower") -> Iterator[Figure]:
    for what, said in (("rms", "root mean square"), ("peak", "largest absolute value")):
        yield Figure(
            f"{signal}_{what}_{unit.replace('/', '_per_')}", unit, f"{said} of the {meaning}", "statistics",
            Of(signal, what), better, (signal,),
        )  # fmt: skip


def _error_at_end(run: Run) -> float:
    return abs(float(run["tracking_error"][-1]))


def _saturated(run: Run) -> float:
    return float(np.mean(run["force"] != run["requested"]))


def _tripped(run: Run) -> float:
    return float(np.any(run["trip"] > 0.0))


def _jerk(run: Run) -> float:
    return float(np.sqrt(np.mean(np.diff(run["force"]) ** 2)))


OF_RUNS = (
    *_of_signal("following_error", "m", "set position minus position as the control reads it"),
    *_of_signal("tracking_error", "m", "set position minus true position of the load"),
    *_of_signal("force", "N", "force commanded after the limit"),
    *_of_signal("velocity_load", "m/s", "velocity of the load", ""),
    Figure("tracking_error_end_m", "m", "absolute tracking error in the last sample", "run", _error_at_end),
    Figure("limited_share", "", "share of the samples in which the force is at its limit", "run", _saturated),
    Figure("tripped", "", "1 if the guard tripped, else 0", "run", _tripped),
    Figure("force_step_rms_N", "N", "root mean square of the change of the force from sample to sample", "run", _jerk),
)

"""Figures and DataFrames of results, registered by result type: `Result.plot()` and `.to_pandas()` use them.

A picture is drawn with matplotlib's object API: a figure that shows itself in a notebook and writes itself with
`savefig`.  Importing this package does not import matplotlib or pandas.
"""

from __future__ import annotations

from feeddrive.plot import frames as frames  # registers the frames
from feeddrive.plot.certificate import certificate, certificate_discs
from feeddrive.plot.complex_plane import nyquist, poles
from feeddrive.plot.distributions import batch, effort, gradient
from feeddrive.plot.identification import (
    cogging,
    cogging_over_turn,
    control_fit,
    delay_fit,
    friction,
    identified_friction,
    residuals,
    rigid_fit,
    steady_runs,
    validation,
)
from feeddrive.plot.over_frequency import bode, closed_loop, open_loop, sensitivity, spectrum, stiffness
from feeddrive.plot.over_time import comparison, following_error, force, log, motion, replay, run
from feeddrive.plot.responses import excitation, frequency_estimate, response_fit, response_nyquist, response_residuals
from feeddrive.plot.tuning import delay_map, disturbance, iteration, prefilter_fit, trial, trials

__all__ = [
    "batch",
    "bode",
    "certificate",
    "certificate_discs",
    "closed_loop",
    "cogging",
    "cogging_over_turn",
    "comparison",
    "control_fit",
    "delay_fit",
    "delay_map",
    "disturbance",
    "effort",
    "excitation",
    "following_error",
    "force",
    "frequency_estimate",
    "friction",
    "gradient",
    "identified_friction",
    "iteration",
    "log",
    "motion",
    "nyquist",
    "open_loop",
    "poles",
    "prefilter_fit",
    "replay",
    "residuals",
    "response_fit",
    "response_nyquist",
    "response_residuals",
    "rigid_fit",
    "run",
    "sensitivity",
    "spectrum",
    "steady_runs",
    "stiffness",
    "trial",
    "trials",
    "validation",
]


def __dir__() -> list[str]:
    return __all__

"""Pictures of results, drawn with matplotlib's object API; every `.plot()` downstairs is one of these functions.

Each returns a figure that shows itself in a notebook and writes itself with `savefig`.  Importing this package does not
import matplotlib.
"""

from __future__ import annotations

from feeddrive.artefacts.plot.certificate import certificate, certificate_discs
from feeddrive.artefacts.plot.channels import log
from feeddrive.artefacts.plot.complex_plane import nyquist, poles
from feeddrive.artefacts.plot.distributions import batch, effort, gradient
from feeddrive.artefacts.plot.estimates import delay_map, disturbance
from feeddrive.artefacts.plot.frequency_estimate import excitation, frequency_estimate
from feeddrive.artefacts.plot.friction_curve import friction
from feeddrive.artefacts.plot.identification import (
    cogging,
    cogging_over_turn,
    control_fit,
    delay_fit,
    identified_friction,
    residuals,
    rigid_fit,
    steady_runs,
    validation,
)
from feeddrive.artefacts.plot.learning import iteration, trial, trials
from feeddrive.artefacts.plot.open_loop import open_loop
from feeddrive.artefacts.plot.over_frequency import bode, closed_loop, sensitivity, spectrum, stiffness
from feeddrive.artefacts.plot.over_time import comparison, following_error, force, motion, run
from feeddrive.artefacts.plot.prediction import replay
from feeddrive.artefacts.plot.prefilter import prefilter_fit
from feeddrive.artefacts.plot.response_fit import response_fit, response_nyquist, response_residuals

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

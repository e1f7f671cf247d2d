"""Sensitivity functions of a loop, from its gain as complex numbers over frequency."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from feeddrive.analysis.conversion import as_frf
from feeddrive.language.errors import ParameterError
from feeddrive.loop.frequency_response import FRF


def sensitivity(loop_gain: FRF | Any, frequency: np.ndarray | None = None) -> FRF:
    """S = 1/(1 + L): what is left of a disturbance that enters where the loop was opened.

    The variance of a measured L goes along to first order, |S|⁴ var(L).
    Raises ParameterError if L is exactly -1 on a line: the closed loop then oscillates and has no response there.
    """
    L = as_frf(loop_gain, frequency)
    _check(L)
    return replace((1.0 + L).inverse(), input="disturbance", output="remainder", unit="")


def complementary_sensitivity(loop_gain: FRF | Any, frequency: np.ndarray | None = None) -> FRF:
    """T = L/(1 + L) = 1 - S: what the loop answers to a signal that enters where it was opened.

    Raises ParameterError as `sensitivity`.  It is not the response to the setpoint, which has feedforward: `tracking`.
    """
    L = as_frf(loop_gain, frequency)
    _check(L)
    # the response by one division: 1 - S would lose the digits where |L| is small; the variance is that of S
    response = L.response / (1.0 + L.response)
    return replace((1.0 + L).inverse(), response=response, input="disturbance", output="answer", unit="")


def _check(L: FRF) -> None:
    on_edge = np.flatnonzero(L.response == -1.0)
    if on_edge.size:
        raise ParameterError(
            f"the loop gain is exactly -1 at {L.frequency[on_edge[0]]:g} Hz: the closed loop is at the edge of "
            f"stability and has no sensitivity there"
        )

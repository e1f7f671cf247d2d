"""Sensitivity functions of a loop, from its gain as complex numbers over frequency."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from feeddrive.language.errors import ParameterError
from feeddrive.loop.frequency_response import FRF


def sensitivity(L: FRF) -> FRF:
    """S = 1/(1 + L): what is left of a disturbance that enters where the loop was opened.

    Raises ParameterError if L is exactly -1 on a line: the closed loop then oscillates and has no response there.
    """
    _check(L)
    return replace(
        L, response=1.0 / (1.0 + L.response), input="disturbance", output="remainder", unit="", coherence=None
    )


def complementary_sensitivity(L: FRF) -> FRF:
    """T = L/(1 + L) = 1 - S: what the loop answers to a signal that enters where it was opened.

    Raises ParameterError as `sensitivity`.  It is not the response to the setpoint, which has feedforward: `tracking`.
    """
    _check(L)
    return replace(
        L, response=L.response / (1.0 + L.response), input="disturbance", output="answer", unit="", coherence=None
    )


def _check(L: FRF) -> None:
    on_edge = np.flatnonzero(L.response == -1.0)
    if on_edge.size:
        raise ParameterError(
            f"the loop gain is exactly -1 at {L.frequency[on_edge[0]]:g} Hz: the closed loop is at the edge of "
            f"stability and has no sensitivity there"
        )

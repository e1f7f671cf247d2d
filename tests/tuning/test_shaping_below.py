"""What no line shows: a law that takes seconds to come back is seen, and a position gain is not given away."""

from __future__ import annotations

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.figures.of_loops import ROPE_SNAP
from feeddrive.tuning.closed_loop import figures
from feeddrive.tuning.control_response import ControlResponse
from feeddrive.tuning.criteria import Criteria


def snap(point: fd.tuning.OperatingPoint, control: fd.Control) -> float:
    response = ControlResponse(control, point.sample_time, ())
    criteria = Criteria((point,), response, ROPE_SNAP, fd.tuning.Limits(), (0.0, np.inf))
    return figures(criteria.answers(np.zeros(0))[0], (0.0, 0.0)).rope_snap


@pytest.mark.parametrize("Kv", [100.0, 3.0, 0.3])
def test_the_error_far_below_the_lines_is_counted(Kv: float) -> None:
    """Lines from 2 Hz on against lines from 1 mHz on; for Kv = 0.3 1/s nine tenths of the error lie below 2 Hz.

    2 %: the viscous friction of the axis, which a free mass has not, and the trapezoidal rule.
    """
    loop = fd.read_machine("ball_screw").loop("x")
    control = fd.vary(loop.control, {"law.Kv": Kv})
    whole = fd.tuning.modelled_point(loop)
    deep = fd.linearize(loop, ["cut", "load_force"], ["reading_motor", "reading_load"])
    lines = np.unique(np.concatenate([np.geomspace(1e-3, 1.0, 2000), whole.frequency]))
    found = {
        source: np.array([deep.response(lines, output=each, input=source).response for each in deep.outputs])
        for source in deep.inputs
    }
    true = fd.tuning.OperatingPoint(
        "true",
        lines,
        found["cut"],
        found["load_force"],
        np.array([found["cut"][1], found["load_force"][1]]),
        whole.sample_time,
    )
    cut = true.chosen(np.flatnonzero(lines >= 2.0))
    assert snap(cut, control) == pytest.approx(snap(true, control), rel=0.02)


def test_a_goal_that_does_not_see_the_position_gain_keeps_it() -> None:
    """Bandwidth alone would let the position loop fall asleep: it ended at a hundredth of the gain that was there."""
    loop = fd.read_machine("ball_screw").loop("x")
    whole = fd.tuning.modelled_point(loop)
    point = whole.chosen(np.flatnonzero(whole.frequency >= 2.0))
    found = fd.tuning.tune_control(loop.control, point, goal="bandwidth", filters="kept", starts=1)
    assert found.tunables["law.Kv"] > 5.0  # 1/s: the position comes back within a second
    assert found.tunables["law.Tn"] < 0.1  # s

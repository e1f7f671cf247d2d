"""Measured responses in place of the axis: the same loop as the modelled one, for any law and any delay."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.language.errors import ParameterError
from feeddrive.papers.gordon2013.testbed import cascade, placed

LINES = np.geomspace(1.0, 5000.0, 300)


def responses(loop: fd.Loop, source: str) -> tuple[fd.FRF, fd.FRF]:
    """Of the axis alone, to the readings of load and motor."""
    model = fd.linearize(loop, ["cut", source] if source != "cut" else ["cut"], ["reading_load", "reading_motor"])
    load, motor = (model.response(LINES, output=name, input=source) for name in ("reading_load", "reading_motor"))
    return load, motor


@pytest.mark.parametrize("loop", [placed(), cascade()], ids=["pole placement", "P-PI"])
def test_gain_and_compliance_are_those_of_the_modelled_loop(loop: fd.Loop) -> None:
    load, motor = responses(loop, "cut")
    found = fd.measured_loop(
        loop.control, float(loop.sample_time), load, motor, disturbance=responses(loop, "load_force")
    )
    gain, closed = fd.loop_gain(loop, LINES), fd.compliance(loop, LINES)
    assert np.max(np.abs(found.loop_gain.response / gain.response - 1.0)) < 1e-9
    assert found.compliance is not None
    assert np.max(np.abs(found.compliance.response / closed.response - 1.0)) < 1e-8
    assert found.margins.sensitivity_peak == pytest.approx(fd.margins(gain).sensitivity_peak, rel=1e-9)
    assert found.sensitivity.response == pytest.approx(fd.analysis.sensitivity(gain).response, rel=1e-8)
    assert "least stiffness" in str(found)


def test_a_delay_that_was_not_measured_is_added() -> None:
    """The axis without dead time, and 50 µs by the argument, are the axis with it."""
    loop = placed()
    quick = dataclasses.replace(
        loop, axis=dataclasses.replace(loop.axis, actuator=fd.blocks.Actuator(current_loop=1500.0))
    )
    load, motor = responses(quick, "cut")
    found = fd.measured_loop(loop.control, float(loop.sample_time), load, motor, delay=5e-5)
    assert np.max(np.abs(found.loop_gain.response / fd.loop_gain(loop, LINES).response - 1.0)) < 1e-9


def test_one_encoder_is_enough_for_a_law_with_one() -> None:
    axis = fd.Axis(plant=fd.blocks.Rigid(mass=100.0), actuator=fd.blocks.Actuator(dead_time=1e-4))
    loop = fd.Loop(control=fd.Control(law=fd.blocks.CascadePPI(Kv=40.0, Kp=2e4, Tn=0.02)), axis=axis, sample_time=1e-4)
    lines = LINES[LINES < 4000.0]
    load = fd.linearize(loop, ["cut"], ["reading_load"]).response(lines)
    found = fd.measured_loop(loop.control, 1e-4, load)
    assert found.loop_gain.response == pytest.approx(fd.loop_gain(loop, lines).response, rel=1e-9)
    with pytest.raises(ParameterError, match="needs two encoders"):
        fd.measured_loop(placed().control, 5e-5, load)
    with pytest.raises(ParameterError, match="not measured"):
        _ = found.stiffness


def test_lines_beyond_nyquist_are_refused() -> None:
    load = fd.FRF(np.array([10.0, 20_000.0]), np.array([1e-6, 1e-9]), unit="m/N")
    with pytest.raises(ParameterError, match="beyond Nyquist"):
        fd.measured_loop(placed().control, 5e-5, load, load)

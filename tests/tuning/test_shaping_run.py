"""A tuning on a measurement is run on the machine that agrees with it: friction, counts, guard and force limit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.loop.guard import Guard
from feeddrive.tuning.criteria import Limits
from feeddrive.tuning.operating_point import OperatingPoint, measured_point, with_table_force
from feeddrive.tuning.proof import of_model
from feeddrive.tuning.tune import Verdict, tune_control

RUN = "run with friction, counts and limit"


@pytest.fixture(scope="module")
def screw() -> fd.Loop:
    return fd.read_machine("ball_screw").loop("x")


def point_of(loop: fd.Loop) -> OperatingPoint:
    """Both encoders, 2000 lines, without noise."""
    model = fd.linearize(loop, ["cut"], ["reading_load", "reading_motor"])
    load, motor = (model.response(np.arange(1.0, 2001.0), each, "cut") for each in model.outputs)
    return measured_point(replace(load, unit="m/N"), replace(motor, unit="m/N"), sample_time=float(loop.sample_time))


def test_the_run_keeps_the_force_limit(screw: fd.Loop) -> None:
    """50 N on the table need 50 N and some overshoot: within 1000 N it holds, within 40 N it cannot."""
    limits = Limits(sensitivity_peak=2.0, compliance_peak_m_per_N=0.2e-6, snap_force=50.0)
    for most, holds in ((1000.0, True), (40.0, False)):
        strong = replace(screw, control=replace(screw.control, force_limit=most))
        point, said = with_table_force(point_of(screw), strong, "the plant of the baseline")
        assert "agrees" in said
        found = tune_control(strong.control, point, limits=limits, filters="kept", starts=1)
        line = next(each for each in found.proof if RUN in each.what)
        assert line.holds is holds, line
        assert found.holds is holds
        assert found.recommendation().startswith("Do not use" if not holds else ("Take", "Leave"))


@pytest.mark.parametrize("fastest", [0.04, None])
def test_an_axis_that_may_not_go_as_fast_as_the_model_slides_is_run_all_the_same(
    screw: fd.Loop, fastest: float | None
) -> None:
    """The run slides at 0.05 m/s, at which the model is made: the axis's own limit of velocity is no part of a tuning.

    That of the following error is one: 50 N move the table by far less than 1 mm.
    """
    guard = Guard(velocity_limit=fastest, following_error_limit=1e-3)
    loop = replace(screw, control=replace(screw.control, guard=guard))
    line = of_model("x", loop, Limits(snap_force=50.0), 0.05)[-1]
    assert line.holds, line
    tight = replace(loop, control=replace(loop.control, guard=replace(guard, following_error_limit=1e-7)))
    assert "the guard trips" in of_model("x", tight, Limits(snap_force=50.0), 0.05)[-1].text


def test_a_plant_that_is_another_one_is_not_run(screw: fd.Loop) -> None:
    heavy = fd.vary(screw, {"axis.x.plant.mass_load": 90.0})
    point, said = with_table_force(point_of(screw), heavy, "the plant of the baseline")
    assert "% away from the response" in said
    assert point.known_as is None
    found = tune_control(screw.control, point, limits=Limits(sensitivity_peak=2.0), filters="kept", starts=1)
    line = next(each for each in found.proof if RUN in each.what)
    assert line.holds is None
    assert "--baseline" in line.text
    assert "Against a force at the drive" in found.recommendation() or found.verdict is Verdict.LEAVE

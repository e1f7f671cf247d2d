"""Stops learned from a simulated log of the loop that will feed them forward."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.evaluation.duty import duty_of
from feeddrive.learning.stops import _swings, learn_stops
from feeddrive.tuning.candidates import candidates

FRICTION = fd.blocks.GeneralizedMaxwellSlip(
    coulomb=30.0,
    breakaway=30.0,
    stribeck_velocity=4e-3,
    stiffness=np.array([2e6, 1e6, 5e5]),
    share=np.array([0.4, 0.3, 0.3]),
)


def test_the_log_of_a_loop_with_presliding_gives_its_friction_and_the_loop_feeds_it_forward() -> None:
    """30 N on 3.5 N/um: the level to 0.2 %, the stiffness to 2 %, and 60 N s/m beside it."""
    loop = fd.read_machine("linear_motor").loop("x")
    loop = replace(loop, axis=replace(loop.axis, friction_load=FRICTION))
    learned, found = learn_stops(loop)
    assert found["level"].value == pytest.approx(30.0, rel=2e-3)
    assert found["stiffness"].value == pytest.approx(3.5e6, rel=0.02)
    assert found["viscous"].value == pytest.approx(60.0, abs=3.0 * found["viscous"].error)
    assert found.left[1] < 0.05 * found.plain[1]
    assert learned.control.feedforward[-1] is found.stops


def test_a_comparison_tries_them_beside_the_cascade_with_its_gains() -> None:
    loop = fd.read_machine("linear_motor").loop("x")
    made = {each.name: each for each in candidates(loop)[0]}
    row = made["P-PI + learned stops"]
    assert (row.like, row.then) == ("P-PI", "stops")
    assert not any(name.endswith("learned stops") for name in made if not name.startswith("P-PI"))
    ready = row.tuned(loop.control).adapted(duty_of(loop).move, 0)
    assert ready.control.law == loop.control.law
    assert [block.kind for block in ready.control.feedforward] == ["inertia", "friction_stops"]


def test_an_axis_without_dry_friction_has_no_stops() -> None:
    loop = fd.read_machine("linear_motor").loop("x")
    refused = candidates(replace(loop, axis=replace(loop.axis, friction_load=None)))[1]
    reasons = {each.name: each.reason for each in refused}
    assert reasons["P-PI + learned stops"].startswith("the axis has no dry friction")


def test_the_slowest_swing_goes_back_and_forth_twice() -> None:
    """At 0.5 Hz: a log that begins and ends at the same place."""
    assert 0.5 * 1e-3 * _swings(0.1, 1e-3).position.size == 2.0

"""Iterative feedforward under other laws, behind a prefilter, beside compensation and filters."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.controller.dadsc import DADSC
from feeddrive.blocks.controller.pole_placement import PolePlacement
from feeddrive.blocks.feedforward.disturbance_compensator import DisturbanceCompensator
from feeddrive.blocks.filter.low_pass2 import LowPass2
from feeddrive.blocks.friction.directional import Directional
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.prefilter.trajectory_prefilter import TrajectoryPrefilter
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.language import tree
from feeddrive.language.errors import StructureError
from feeddrive.learning.iterative_feedforward import (
    begin_compensation,
    compensator,
    filtered,
    next_iteration,
    regressors,
    true_error_model,
)
from feeddrive.learning.trial import simulated_trial
from feeddrive.learning.trials import iterate_trials
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import simulate
from trials import MOVE, OUT_AND_BACK, START, along, linear_loop

T = 1e-4
SCREW = TwoMass(
    mass_motor=220.0, mass_load=90.0, stiffness=9.0e7, damping=1800.0, viscous_motor=2500.0, viscous_load=100.0
)
OTHER = SnapLimitedMove(distance=0.05, **{**OUT_AND_BACK, "velocity": 0.15})


def placed(friction: Directional | None = None) -> Loop:
    axis = Axis(
        plant=SCREW,
        actuator=Actuator(dead_time=T, current_loop=1200.0),
        encoder_motor=Encoder(),
        encoder_load=Encoder(),
        friction_motor=friction,
    )
    law = PolePlacement(model=SCREW, bandwidth=60.0, axial_damping=0.08)
    return Loop(control=Control(law=law), axis=axis, sample_time=T)


@pytest.mark.parametrize("form", ["model_free", "model_based"])
def test_under_pole_placement(form: str) -> None:
    """Two encoders, an axial mode, set-valued friction: from no feedforward to a tenth of the error in two updates."""
    loop = begin_compensation(placed(Directional(coulomb_positive=60.0, coulomb_negative=50.0)))
    found = iterate_trials(loop, (MOVE, MOVE, MOVE, OTHER, MOVE), 5, form=form)
    assert found.rms[2] < 0.1 * found.rms[0]
    values = found.parameters()
    # dead time and current loop, 0.23 ms together, turn viscous friction into mass: 310 kg - 2600 N s/m · 0.23 ms ...
    assert values["mass"][-1] == pytest.approx(310.0, rel=0.06)
    assert values["viscous"][-1] == pytest.approx(2600.0, rel=0.1)


def test_the_error_model_under_pole_placement_is_the_loop() -> None:
    loop = begin_compensation(placed())
    trial = simulated_trial(simulate(loop, MOVE), MOVE)
    moved = tree.vary(
        loop, {"axis.x.control.feedforward.0.mass": 300.0, "axis.x.control.feedforward.0.viscous": 2000.0}
    )
    after = simulated_trial(simulate(moved, MOVE), MOVE)
    names, phi, _ = regressors(loop, compensator(loop), MOVE.at(along(MOVE, T)))
    theta = [compensator(moved).parameters()[name] for name in names]
    predicted = filtered(true_error_model(loop), phi) @ theta
    off = trial.following_error - after.following_error - predicted
    assert np.max(np.abs(off)) < 1e-8 * np.max(np.abs(predicted))


def test_under_dadsc_friction_is_tuned_and_mass_is_its_own() -> None:
    axis = Axis(
        plant=Rigid(mass=40.0, viscous=60.0),
        actuator=Actuator(dead_time=T),
        encoder_load=Encoder(),
        friction_load=Directional(coulomb_positive=30.0, coulomb_negative=25.0),
    )
    law = DADSC(mass=40.0, viscous=60.0, tracking_rate=300.0, reaching_rate=300.0, adaptation_rate=300.0)
    bare = Loop(control=Control(law=law), axis=axis, sample_time=T)
    loop = begin_compensation(bare)
    assert list(compensator(loop).parameters()) == ["coulomb_positive", "coulomb_negative"]
    found = iterate_trials(loop, MOVE, 4)
    assert found.rms[-1] < 0.3 * found.rms[0]
    with pytest.raises(StructureError, match="feeds the acceleration forward, which dadsc does already"):
        begin_compensation(bare, ("mass",))


def test_behind_a_prefilter_the_columns_are_those_that_the_feedforward_sees() -> None:
    """e(θ) - e(θ0) = G_d φᵀ (θ0 - θ) again, with φ of the setpoint as it leaves the prefilter."""
    prefilter = TrajectoryPrefilter(theta1=1e-4, theta2=2e-6)
    loop = linear_loop(START, prefilter=prefilter)
    other = tree.vary(loop, {"axis.x.control.feedforward.0.mass": 120.0, "axis.x.control.feedforward.0.viscous": 400.0})
    errors = [simulate(each, MOVE)["following_error"] for each in (loop, other)]
    names, phi, _ = regressors(loop, compensator(loop), MOVE.at(along(MOVE)))
    change = {**dict.fromkeys(names, 0.0), "mass": 90.0, "viscous": 400.0}
    predicted = filtered(true_error_model(loop), phi) @ [change[name] for name in names]
    assert np.max(np.abs(errors[0] - errors[1] - predicted)) < 1e-8 * np.max(np.abs(predicted))


@pytest.mark.parametrize("control", [{"filters": (LowPass2(frequency=400.0),)}, {"force_limit": 2000.0}])
def test_filters_and_limits_that_do_not_act_change_little(control: dict[str, Any]) -> None:
    loop = linear_loop(START, **control)
    for _ in range(2):
        loop = next_iteration(loop, simulated_trial(simulate(loop, MOVE), MOVE)).loop
    assert compensator(loop).parameters()["mass"] == pytest.approx(120.0, rel=0.02)


def test_two_compensators_are_one_too_many() -> None:
    control = linear_loop(START).control
    with pytest.raises(StructureError, match="the force would act twice"):
        dataclasses.replace(control, feedforward=(*control.feedforward, DisturbanceCompensator(mass=1.0)))

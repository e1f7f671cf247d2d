"""Rows that count, forces that the model must not take for mass, and intervals, on logs of the foreign simulator."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

import foreign_axis as fa
from feeddrive.identification.motion.identify import identify_motion, with_rigid
from feeddrive.identification.motion.motion_log import MotionLog, held_readings, lead_of
from feeddrive.identification.motion.rigid import RigidFit, _needs, find_delay, identify_rigid
from feeddrive.loop.axis import Axis

T = 1e-3
LAW = fa.Cascade(Kv=25.0, Kp=95.0 * 150.0, rate=15.0, ff=1.0)
USUAL: dict[str, Any] = {
    "mass": 95.0,
    "viscous": 200.0,
    "coulomb_positive": 60.0,
    "coulomb_negative": 60.0,
    "dead_time": 0.3e-3,
    "noise_log": 3.0,
    "noise_drive": 1.0,
    "colour": 0.8,
    "resolution": 5e-7,
}


@cache
def logs_with(pulse: float = 0.0, setpoint: bool = True, **more: float) -> MotionLog:
    """A log of 6 s, four ways, with what is asked for."""
    xs = fa.smooth_moves(T, (0.2, 0.0) * 2, 0.2, 2.0, 60.0, 0.2, 0.3)
    push = fa.pulses(xs.size, T, np.random.default_rng(4), 5, pulse, 0.1, "rectangle") if pulse else None
    logs = fa.simulate(fa.Axes(**{**USUAL, **more}), LAW, xs, T, np.random.default_rng(1), disturbance=push)
    log = logs.log(0)
    given = log["setpoint"] if setpoint else None
    return MotionLog(name="log", position=log["position"], force=log["force"], set_position=given, sample_time=T)


def off(fit: RigidFit, name: str, truth: float) -> float:
    return abs(fit[name].value - truth) / fit[name].error


@pytest.mark.parametrize("setpoint", [True, False])
def test_unknown_pulses_are_cut_out_and_not_folded_into_the_mass(setpoint: bool) -> None:
    clean, pulsed = (identify_rigid(logs_with(pulse, setpoint)) for pulse in (0.0, 80.0))
    joint = np.hypot(clean["mass"].error, pulsed["mass"].error)
    assert abs(clean["mass"].value - pulsed["mass"].value) < 2.0 * joint
    assert pulsed.left_out["pulse"] > 20
    assert clean.left_out["pulse"] == 0


@pytest.mark.parametrize(("times", "needed"), [(3.0, False), (6.0, True)])
def test_rows_that_tell_a_parameter_are_no_pulse(times: float, needed: bool) -> None:
    """A column whose power in the other rows is 1 / times of that in all: its value scatters `times` as much."""
    out = np.arange(100) >= 50
    column = np.where(out, np.sqrt(times - 1.0), 1.0) * np.where(np.arange(100) % 2, 1.0, -1.0)
    assert _needs(np.column_stack([column, np.ones(100)]), out) is needed


def test_the_ramps_of_an_axis_that_bends_are_no_pulses() -> None:
    """At one speed only the ramps tell mass and viscous friction, and there the load moves on after the motor."""
    bends = {"mass": 30.0, "mass_load": 65.0, "stiffness": 65.0 * (2 * np.pi * 25.0) ** 2, "damping": 200.0}
    xs = fa.smooth_moves(T, (0.2, 0.0) * 2, 0.2, 3.0, 300.0, 0.2, 0.3)
    law = fa.Cascade(Kv=6.0, Kp=95.0 * 35.0, ff=1.0)
    quiet = {"noise_log": 0.5, "noise_drive": 0.1}
    log = fa.simulate(fa.Axes(**{**USUAL, **bends, **quiet}), law, xs, T, np.random.default_rng(1)).log(0)
    fit = identify_rigid(
        MotionLog(
            name="log",
            position=log["position_load"],
            force=log["force"],
            set_position=log["setpoint"],
            sample_time=T,
        )
    )
    assert fit.left_out["pulse"] == 0
    assert fit["mass"].value == pytest.approx(95.0, rel=0.03)


def test_a_remark_counts_the_rows_of_pulses() -> None:
    found = identify_motion(logs_with(80.0, False))
    assert any("acts for short times" in str(remark) for remark in found.remarks)
    assert "unknown force" in str(found.rigid.rows_table())


@pytest.mark.parametrize(("gravity", "slope", "ripple"), [(0.0, 0.0, 0.0), (-300.0, 200.0, 0.0), (0.0, 0.0, 8.0)])
def test_forces_along_the_travel_are_chosen_by_evidence(gravity: float, slope: float, ripple: float) -> None:
    log = logs_with(gravity=gravity, slope=slope, ripple=ripple, ripple_period=0.02)
    fit = identify_rigid(log)
    assert [np.isinf(period) for period in fit.periods] == [True] * bool(slope) + [False] * bool(ripple)
    assert off(fit, "mass", 95.0) < 3.0
    if slope:
        assert off(fit, "slope", slope) < 3.0
    if ripple:
        assert fit.periods[0] == pytest.approx(0.02, rel=2e-3)
        assert np.hypot(fit["sine"].value, fit["cosine"].value) == pytest.approx(ripple, abs=0.6)
    force = fit.position_force()
    assert (force is None) == (not fit.periods)
    if force is not None:
        # the force on the table is opposite to that of the drive which holds it; 3 errors of 0.13 N, slope and ripple
        places = float(force.begin) + float(force.spacing) * np.arange(65)
        middle = 0.5 * (places[0] + places[-1])
        true = -slope * (places - middle) - ripple * np.sin(2.0 * np.pi * places / 0.02)
        assert np.max(np.abs(np.array(force.row) - true)) < 3.0
        axis = with_rigid(Axis(plant=fit.plant()), fit)
        assert any(block.kind == "force_map" for block in axis.forces)


@pytest.mark.parametrize(("gravity", "weight"), [(-300.0, True), (-45.0, True), (-20.0, False)])
def test_levels_that_differ_too_much_are_a_weight(gravity: float, weight: bool) -> None:
    """Levels of 360 and -240 N, or of 105 and 15 N, are no friction; 80 and 40 N may be."""
    fit = identify_rigid(logs_with(gravity=gravity), friction="directional")
    assert bool(fit.levels[2] != 0.0) is weight
    if weight:
        assert fit.levels[2] == pytest.approx(-gravity, abs=3.0)
        force = fit.gravity()
        assert force is not None
        assert float(force.force) == pytest.approx(gravity, abs=3.0)


def test_slow_rows_with_another_friction_are_left_out() -> None:
    plain = identify_rigid(logs_with())
    fit = identify_rigid(logs_with(stribeck=25.0, stribeck_velocity=2e-2, creep=8e-6), friction="symmetric")
    assert plain.slowest == 0.0
    assert fit.slowest >= 0.1
    assert fit.left_out["slow"] > 0
    assert off(fit, "viscous", 200.0) < 3.0
    assert off(fit, "coulomb", 60.0) < 3.0


def test_dead_time_is_fitted_along() -> None:
    fit = identify_rigid(logs_with(dead_time=1.7e-3))
    assert abs(fit.dead_time.value - 1.7) < 3.0 * fit.dead_time.error
    assert fit.dead_time.error < 0.2
    delay = find_delay(logs_with(dead_time=1.7e-3))
    assert delay.dead_time == pytest.approx(1.7, abs=4.0 * delay.error)


@pytest.mark.parametrize(("every", "found"), [(1, 1), (2, 2), (4, 4)])
def test_held_readings_draw_a_hint(every: int, found: int) -> None:
    log = logs_with()
    rows = np.arange(log.position.size) // every * every
    assert held_readings(log.position[rows]) == found
    held = MotionLog(name="held", position=log.position[rows], force=log.force, sample_time=T)
    assert any(f"only every {found}. reading" in str(hint) for hint in held.hints()) is (found > 1)


@pytest.mark.parametrize(("late", "hint"), [(3, False), (7, True), (20, True)])
def test_a_late_set_position_draws_a_hint(late: int, hint: bool) -> None:
    log = logs_with()
    assert log.set_position is not None
    shifted = np.concatenate([np.full(late, log.set_position[0]), log.set_position[:-late]])
    assert lead_of(log.position, shifted, T) == pytest.approx(late, abs=2)
    other = MotionLog(name="late", position=log.position, force=log.force, set_position=shifted, sample_time=T)
    assert any("before its set position" in str(h) for h in other.hints()) is hint


def test_causes_add_up_to_all_rows() -> None:
    log = logs_with()
    fit = identify_rigid(log)
    whole = fit.residuals.values.size + sum(fit.left_out.values())
    assert whole == pytest.approx(log.position.size / 10, abs=1)
    assert fit.left_out["rest"] > 0
    assert fit.left_out["reversal"] > 0

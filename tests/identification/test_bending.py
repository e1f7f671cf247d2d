"""An axis that bends, in logs of motion: its mass, and its law behind the encoder of the load or of the motor."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import foreign_axis as fa
from feeddrive.identification.motion import law_structures
from feeddrive.identification.motion.identify import identify_motion
from feeddrive.identification.motion.identify_law import identify_control
from feeddrive.identification.motion.law_rows import LawRows, Signals
from feeddrive.identification.motion.law_structures import CASCADE, Structure
from feeddrive.identification.motion.motion_log import MotionLog
from feeddrive.identification.motion.rigid import RigidFit, _hides, beside, identify_rigid
from feeddrive.identification.regression import Estimate, cross_validated
from feeddrive.workflow.identify import _terms

T = 5e-4
MASS, SHARE = 80.0, 0.5  # kg, share of the load
LAW = {"Kv": 12.0, "Kp": MASS * 50.0, "rate": 8.0, "ff": 0.8, "n": 2}


@cache
def log_of(
    end: str = "load", stiff: bool = False, resolution: float = 2e-7, resonance: float = 45.0, **law: Any
) -> MotionLog:
    """A log of moves with a jerk that bends the axis; `end`: whose encoder is logged. The law reads the motor."""
    m2 = MASS * SHARE
    k = (2.0 * np.pi * resonance) ** 2 * m2 * (1.0 - SHARE)
    two = {} if stiff else {"mass_load": m2, "stiffness": k, "damping": 0.04 * np.sqrt(k * m2)}
    axes = fa.Axes(
        mass=MASS if stiff else MASS - m2,
        viscous=100.0,
        coulomb_positive=40.0,
        coulomb_negative=40.0,
        dead_time=0.3e-3,
        noise_log=0.5,
        noise_drive=0.2,
        resolution=resolution,
        resolution_load=resolution,
        **two,
    )
    xs = fa.smooth_moves(T, (0.12, 0.0, 0.1, 0.02), 0.25, 3.0, 150.0, 0.15, 0.2)
    log = fa.simulate(axes, fa.Cascade(**{**LAW, **law}), xs, T, np.random.default_rng(3), substeps=4).log(0)
    read = log["position_load"] if end == "load" and not stiff else log["position"]
    return MotionLog(name="log", position=read, force=log["force"], set_position=log["setpoint"], sample_time=T)


@pytest.mark.parametrize(("end", "resonance"), [("load", 45.0), ("motor", 90.0)])
def test_the_mass_of_an_axis_that_bends_is_within_its_error(end: str, resonance: float) -> None:
    """Without the term it is off by the share (f / f_resonance)² of its ramps; a motor bends at its antiresonance."""
    fit = identify_rigid(log_of(end, resonance=resonance))
    assert fit.bends
    assert "bends the axis" in _terms(fit)
    assert abs(fit["mass"].value - MASS) < 3.0 * fit["mass"].error
    assert fit["mass"].error < 0.01 * MASS
    # the load needs more force where the motor runs ahead, the motor less: M / (2 pi f)² with + and -
    assert np.sign(fit["bend"].value) == (1.0 if end == "load" else -1.0)
    assert fit.bends_at is not None
    # of equal masses m2²/k is m1 m2/k; ramps that bend the axis less tell it to 5 % only
    assert fit.bends_at.value == pytest.approx(resonance, rel=0.015 if end == "load" else 0.05)


def test_a_stiff_axis_does_not_bend() -> None:
    fit = identify_rigid(log_of(stiff=True))
    assert not fit.bends
    assert fit.bends_at is None
    assert _terms(fit) == "mass times acceleration plus friction"
    assert abs(fit["mass"].value - MASS) < 3.0 * fit["mass"].error


def test_bending_is_said_and_the_law_is_found_behind_the_load() -> None:
    """By functions of the set motion: the twist, its damping and the gains, within 5 %."""
    found = identify_motion(log_of())
    assert any("the axis bends" in remark and "a resonance at 45" in remark for remark in map(str, found.remarks))
    assert found.control is not None
    assert found.control.other_readings
    assert found.control["Kv"].value == pytest.approx(12.0, rel=0.05)
    assert found.control["Kp"].value == pytest.approx(MASS * 50.0, rel=0.03)
    assert found.control["Tn"].value == pytest.approx(1.0 / 8.0, rel=0.05)


@pytest.mark.slow(reason="a search through all structures and in the slow rows, some 4 s")
def test_a_low_pass_is_found_behind_the_load() -> None:
    """A corner of 2 ms beside the twist: gains within 5 %; half a sample of the velocity may count as its lag."""
    found = identify_control(log_of(tau=2e-3))
    assert found.other_readings
    assert found["Kp"].value == pytest.approx(MASS * 50.0, rel=0.03)
    assert found["Kv"].value == pytest.approx(12.0, rel=0.05)
    lag = found["time_constant"].value + 0.5 * (found.velocity_samples - 1) * T
    assert lag == pytest.approx(2e-3 + 0.5 * T, abs=0.5e-3)


@pytest.mark.slow(reason="one more fit of two encoders")
def test_the_law_is_taken_from_the_reading_that_it_had() -> None:
    """With both encoders in the log the law reads the motor, and the mass is that of the load's reading."""
    load, motor = log_of("load"), log_of("motor")
    found = identify_motion(load, motor=motor.position)
    assert found.control is not None
    assert not found.control.other_readings
    assert any("reads the encoder of the motor" in remark for remark in found.remarks)
    for name, value in {"Kv": 12.0, "Kp": MASS * 50.0, "Tn": 1.0 / 8.0}.items():
        assert found.control[name].value == pytest.approx(value, rel=5e-3), name
    assert found.rigid["mass"].value == identify_rigid(load, dead_time=found.delay.dead_time)["mass"].value


@pytest.mark.slow(reason="a search through all structures and in the slow rows, some 4 s")
def test_a_law_of_the_load_stays_one_if_the_motor_explains_nothing() -> None:
    noise = np.random.default_rng(1).normal(size=log_of().position.size)
    found = identify_motion(log_of(), motor=np.cumsum(noise) * 1e-6)
    assert found.control is not None
    assert found.control["Kp"].value == pytest.approx(MASS * 50.0, rel=0.03)


def test_a_force_along_the_travel_does_not_hide_the_mass() -> None:
    """On a circle x'' = -w² x: beside the acceleration the position is no evidence."""
    t = np.arange(2000) * 1e-3
    x = np.sin(6.0 * t)
    a = -36.0 * x + 0.3 * np.random.default_rng(2).normal(size=t.size)
    columns = np.column_stack([a, np.ones(t.size)])
    assert _hides(columns, np.column_stack([columns, x]))
    assert not _hides(columns, np.column_stack([columns, np.cos(6.0 * t)]))


def test_a_stretch_that_alone_holds_a_direction_is_expected_to_be_predicted_badly() -> None:
    """Levels of 1 and 3 N in two directions, the second one in the last fifth alone: nothing there is known of it."""
    rng = np.random.default_rng(0)
    forward = np.arange(500) < 400
    columns = np.column_stack([forward, ~forward]).astype(float)
    force = columns @ np.array([1.0, 3.0]) + 0.01 * rng.normal(size=500)
    alone = cross_validated(columns, force, 5, "N")
    assert alone.relative > 0.5
    assert alone.expected == pytest.approx(alone.relative, rel=0.01)
    # rows of both directions in each stretch: the error is the noise, and the parameters add little to it
    mixed = np.random.default_rng(1).permutation(500)
    both = cross_validated(columns[mixed], force[mixed], 5, "N")
    assert both.relative < 0.01
    assert both.expected < 0.2 * both.relative


def test_fits_of_many_structures_at_once_are_those_of_each_alone() -> None:
    """All minima over 1/Tn: no neighbor on a fine grid leaves less, and gains and residual are those of lstsq."""
    log = log_of("motor")
    signals = Signals.of(log)
    rows = LawRows.of(signals, signals.free(None))
    part = rows.reduced()
    tried = [
        Structure(CASCADE, integral, n, 0, forward=forward, fed=fed)
        for integral in (True, False)
        for n in (1, 2)
        for forward in law_structures.FORWARD
        for fed in ("", "backward")
    ]
    tasks = [law_structures.problem(one, rows.basis, part) for one in tried]
    together = law_structures.fits(tried, tasks)
    alone = [one for k, structure in enumerate(tried) for one in law_structures.fits([structure], [tasks[k]])]
    assert [one.structure for one in together] == [one.structure for one in alone]
    for one, other in zip(together, alone, strict=True):
        # 1e-6: the search for 1/Tn ends with steps of 1e-5 of its logarithm about a flat minimum
        assert one.rate == pytest.approx(other.rate, rel=1e-6)
        assert one.ssr == pytest.approx(other.ssr, rel=1e-6)
        task = tasks[tried.index(one.structure)]

        def left(rate: float, task: law_structures.Problem = task) -> float:
            C = task.A + rate * task.B
            sizes = np.linalg.norm(C, axis=0)
            values = np.linalg.lstsq(C / sizes, task.y, rcond=1e-13)[0]
            return float(np.sum((task.y - (C / sizes) @ values) ** 2))

        assert one.ssr == pytest.approx(left(one.rate), rel=1e-6)
        if one.structure.curved:
            assert min(left(one.rate * 1.01), left(one.rate / 1.01)) >= one.ssr * (1.0 - 1e-9)


def test_a_smoothed_direction_is_fitted_as_in_the_whole_problem() -> None:
    """Only its columns change: the same as all columns anew."""
    log = log_of("motor", friction_ff=20.0, friction_speed=5e-3)
    signals = Signals.of(log)
    rows = LawRows.of(signals, signals.free(None))
    structure = Structure(CASCADE, True, 2, 0, friction=0, sides=True)
    smoothed = Signals(signals.x, signals.wanted, signals.force, signals.T, smoothing=5e-3)
    one = law_structures.SignProblems(rows, structure).fit(smoothed)
    changed = rows.signed(smoothed)
    other = law_structures.fit(structure, changed.basis, changed.reduced())
    assert one is not None
    assert other is not None
    assert one.ssr == pytest.approx(other.ssr, rel=1e-8)
    assert one.values == pytest.approx(other.values, rel=1e-5, abs=1e-6)
    assert one["friction"] == pytest.approx(20.0, rel=0.03)


def test_two_fits_that_contradict_each_other_are_both_doubted() -> None:
    """Hausman: 100 +- 1 and 100 + d +- 2 kg agree up to d = sqrt(3); what is beyond it widens the error."""
    fit = identify_rigid(log_of(stiff=True), friction="symmetric")
    mass = fit.estimates[0]

    def of(value: float, error: float) -> RigidFit:
        return replace(fit, estimates=(replace(mass, value=value, error=error), *fit.estimates[1:]))

    assert beside(of(100.0, 1.0), of(101.7, 2.0).estimates)["mass"].error == 1.0
    wide = beside(of(100.0, 1.0), of(104.0, 2.0).estimates)
    assert wide["mass"].error == pytest.approx(np.sqrt(1.0 + 16.0 - 3.0))
    assert wide["mass"].value == 100.0
    # the other parameters agree, and the covariance follows the error
    assert [e.error for e in wide.estimates[1:]] == [e.error for e in fit.estimates[1:]]
    assert wide.covariance[0, 1] == pytest.approx(fit.covariance[0, 1] * np.sqrt(14.0))


@pytest.mark.parametrize(
    ("left", "by_other", "share"),
    [(0.01, 0.05, 0.25), (0.01, 0.011, 3.0**-0.5), (0.01, 0.01, 3.0**-0.5)],
)
def test_of_two_masses_that_contradict_each_other_the_truth_is_nearer_to_that_of_the_better_fit(
    left: float, by_other: float, share: float
) -> None:
    """What they leave of the force is 1 : 5, and both lack a part of it: 4 kg apart, the better one is 1 kg off."""
    one, other = (Estimate("mass", value, "kg", 1.0, 1.0) for value in (100.0, 104.0))
    assert one.towards(other, left, by_other).error == pytest.approx(np.hypot(1.0, 4.0 * share))


def test_bending_that_no_instrument_confirms_widens_the_error_by_what_it_would_change() -> None:
    """Without the set position least squares alone sees it: 80 kg at 45 Hz are 0.7 kg less without the term."""
    log = replace(log_of(), set_position=None)
    fit = identify_rigid(log)
    assert not fit.bends
    off = abs(fit["mass"].value - MASS)
    # three white errors, 0.23 kg each, would not reach the truth
    assert off > 3.0 * fit["mass"].ols
    assert off < 1.5 * fit["mass"].error
    stiff = identify_rigid(replace(log_of(stiff=True), set_position=None))
    assert stiff["mass"].error < 0.1 * fit["mass"].error

"""Tuning under equal robustness: the bounds hold, the end is the optimum, and the known figures come out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from feeddrive.analysis.margins import margins
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.controller.dadsc import DADSC
from feeddrive.blocks.plant.modal import Modal
from feeddrive.blocks.plant.mode import Mode
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.files.machine import read_machine
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError, StructureError, UnstableError
from feeddrive.loop.linearize import loop_gain
from feeddrive.loop.loop import Loop
from feeddrive.tuning.designs import designs, two_mass_model
from feeddrive.tuning.equal_robustness import tune
from feeddrive.tuning.robustness import robustness


@pytest.fixture(scope="module")
def motor() -> Loop:
    return read_machine("linear_motor").loop("x")


@pytest.fixture(scope="module")
def screw() -> Loop:
    return read_machine("ball_screw").loop("x")


def with_dadsc(loop: Loop) -> Loop:
    law = DADSC(mass=40.0, viscous=60.0, tracking_rate=300.0, reaching_rate=300.0, adaptation_rate=300.0)
    return replace(loop, control=replace(loop.control, law=law, feedforward=()))


def test_the_cascade_and_dadsc_on_a_rigid_drive_at_equal_robustness(motor: Loop) -> None:
    """0.90 and 1.04 nm √s/N at two samples of dead time, as computed before this project began, to their digits."""
    cascade, dadsc = tune(motor), tune(with_dadsc(motor))
    assert 1e9 * cascade.robustness.rope_snap == pytest.approx(0.90, abs=0.005)
    assert 1e9 * dadsc.robustness.rope_snap == pytest.approx(1.04, abs=0.005)
    for tuned in (cascade, dadsc):
        assert tuned.active == ("Ms = 2",)
        assert tuned.proven, tuned.proof
    # a triple real pole is the optimum of DADSC: its three rates come out equal to a per cent
    rates = np.array(list(dadsc.knobs.values()))
    assert np.ptp(rates) < 0.01 * rates.mean()


def test_equal_to_a_grid_of_all_gains(motor: Loop) -> None:
    """No point of a grid around the end is better by more than the grid's own coarseness, and one comes near."""
    tuned = tune(motor)
    end = np.array([tuned.knobs[f"control.law.{name}"] for name in CascadePPI.knobs])
    best = np.inf
    for a in np.geomspace(0.75, 1.35, 7):
        for b in np.geomspace(0.85, 1.18, 7):
            for c in np.geomspace(0.75, 1.35, 7):
                values = end * [a, b, c]
                loop = tree.vary(
                    motor, dict(zip([f"control.law.{n}" for n in CascadePPI.knobs], values.tolist(), strict=True))
                )
                found = robustness(loop)
                if found.stable and found.sensitivity_peak <= 2.0 and found.delay_margin_samples >= 2.0:
                    best = min(best, found.rope_snap)
    assert tuned.robustness.rope_snap < 1.0005 * best
    assert best < 1.05 * tuned.robustness.rope_snap


def test_the_bounds_hold_on_lines_of_its_own(screw: Loop) -> None:
    tuned = tune(screw)
    found = margins(loop_gain(tuned.loop, np.geomspace(0.5, 10_000, 8000)))
    assert 1.99 < found.sensitivity_peak <= 2.0001
    assert found.delay_margin_samples is not None
    assert found.delay_margin_samples > 2.0
    assert tuned.proven, tuned.proof
    # today's gains are within 3 % of the optimum: they were found by the same criterion
    assert tuned.robustness.rope_snap < robustness(screw).rope_snap < 1.03 * tuned.robustness.rope_snap


def test_the_delay_margin_can_be_the_bound(motor: Loop) -> None:
    """Without dead time Ms <= 2 leaves less than two samples: the other bound is active."""
    tuned = tune(tree.vary(motor, {"axis.actuator.dead_time": 0.0}))
    assert tuned.active == ("delay margin = 2 samples",)
    assert tuned.robustness.delay_margin_samples == pytest.approx(2.0, abs=0.01)
    assert tuned.robustness.sensitivity_peak < 2.0


def test_a_tighter_bound_costs_rope_snap(motor: Loop) -> None:
    softer = tune(motor, sensitivity_peak=1.6, starts=1)
    assert softer.robustness.sensitivity_peak <= 1.6
    assert softer.robustness.rope_snap > 1.2 * tune(motor, starts=1).robustness.rope_snap


def test_it_begins_from_unstable_gains_and_gives_the_same(motor: Loop) -> None:
    wild = tree.vary(motor, {"control.law.Kp": 4e6, "control.law.Kv": 3000.0, "control.law.Tn": 2e-4})
    assert not robustness(wild).stable
    assert tune(wild).robustness.rope_snap == pytest.approx(tune(motor).robustness.rope_snap, rel=2e-3)


def test_the_same_call_gives_the_same_bits(motor: Loop) -> None:
    assert tune(motor).knobs == tune(motor).knobs


def test_what_is_no_knob_is_refused(motor: Loop) -> None:
    with pytest.raises(ParameterError, match=r"control\.law\.Kx"):
        tune(motor, knobs=["control.law.Kx"])
    with pytest.raises(ParameterError, match="number > 0"):
        tune(tree.vary(motor, {"control.feedforward.0.viscous": 0.0}), knobs=["control.feedforward.0.viscous"])
    with pytest.raises(ParameterError, match="sensitivity_peak = 1 "):
        tune(motor, sensitivity_peak=1.0)


def test_no_robust_setting_is_an_error_that_says_how_near_it_came(motor: Loop) -> None:
    slow = tree.vary(motor, {"axis.actuator.dead_time": 0.0})
    with pytest.raises(UnstableError, match=r"least Ms on the way was 1(\.\d+)?:"):
        tune(slow, sensitivity_peak=1.0001)


def test_pole_placement_beats_the_cascade_on_the_ball_screw(screw: Loop) -> None:
    """Known: 0.76 to 0.78 at equal peak compliance too; here without that bound, so at most 0.78."""
    made, _ = designs(screw)
    placement = next(each for each in made if each.name == "pole placement")
    ratio = tune(placement.loop, knobs=placement.knobs).robustness.rope_snap / tune(screw).robustness.rope_snap
    assert 0.65 < ratio <= 0.78


def test_the_two_mass_model_of_a_chain(screw: Loop) -> None:
    model = two_mass_model(screw.axis.plant)
    assert isinstance(model, TwoMass)
    assert (model.mass_motor, model.mass_load, model.viscous_motor) == (130.0, 33.0, 1500.0)
    assert float(model.rigid_mass()) == pytest.approx(float(screw.axis.plant.rigid_mass()), rel=1e-12)


def test_laws_that_do_not_fit_are_refused_with_the_reason(motor: Loop, screw: Loop) -> None:
    _, refused = designs(motor)
    assert "one encoder" in {each.name: each.reason for each in refused}["pole placement"]
    with pytest.raises(StructureError, match="one mass"):
        two_mass_model(motor.axis.plant)
    modal = Modal(mass=100.0, modes=(Mode(frequency=100.0, mass=20.0, motor=1.0, load=-1.0),))
    with pytest.raises(StructureError, match="take two_mass"):
        two_mass_model(modal)
    assert not designs(screw)[1]


def test_nothing_is_fed_forward_twice_and_the_filters_stay(screw: Loop) -> None:
    made, _ = designs(screw)
    for design in made:
        control = design.loop.control
        assert control.filters == screw.control.filters
        fed = [*control.law.feeds, *(name for block in control.feedforward for name in block.fed())]
        assert len(fed) == len(set(fed)), design.name
        assert {"acceleration", "velocity"} <= set(fed), design.name


def test_a_law_without_integral_gets_one_and_says_so() -> None:
    made, _ = designs(read_machine("emps").loop("x"))
    cascade = made[0]
    assert cascade.name == "P-PI"
    assert "integral" in cascade.remark
    assert "control.law.Tn" in cascade.knobs

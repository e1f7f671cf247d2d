"""Tuning under equal robustness: the bounds hold, the end is the optimum, and the known figures come out; and with
which laws, told what, a comparison begins."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest

from feeddrive.analysis.margins import margins
from feeddrive.analysis.stiffness import robustness
from feeddrive.blocks import catalogue
from feeddrive.blocks.catalogue import members
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.controller.dadsc import DADSC
from feeddrive.blocks.families import Friction, Law
from feeddrive.blocks.feedforward.disturbance_compensator import DisturbanceCompensator
from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.blocks.friction.directional import Directional
from feeddrive.blocks.friction.directional_stribeck import DirectionalStribeck
from feeddrive.blocks.friction.generalized_maxwell_slip import GeneralizedMaxwellSlip
from feeddrive.blocks.friction.lugre import Lugre
from feeddrive.blocks.friction.regularised import Regularised
from feeddrive.blocks.friction.stribeck import Stribeck
from feeddrive.blocks.friction.viscous import Viscous
from feeddrive.blocks.plant.modal import Modal
from feeddrive.blocks.plant.mode import Mode
from feeddrive.blocks.plant.two_bodies import two_mass_model
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.comparison.compare import compare_laws
from feeddrive.files.machine import read_machine
from feeddrive.language import tree
from feeddrive.language.block import parameter
from feeddrive.language.errors import ParameterError, StructureError, UnstableError
from feeddrive.loop.linearize import loop_gain
from feeddrive.loop.loop import Loop
from feeddrive.tuning.candidates import axis_model, candidates, control_with
from feeddrive.tuning.criteria import Limits
from feeddrive.tuning.tune import Tuned, law_tunables, tune_control


@pytest.fixture(scope="module")
def motor() -> Loop:
    return read_machine("linear_motor").loop("x")


@pytest.fixture(scope="module")
def screw() -> Loop:
    return read_machine("ball_screw").loop("x")


BARS = Limits(sensitivity_peak=2.0, delay_margin_samples=2.0)


def tuned(loop: Loop, limits: Limits = BARS, **asked: Any) -> Tuned:
    return tune_control(loop, limits=limits, filters="kept", **({"starts": 1} | asked))


def with_dadsc(loop: Loop) -> Loop:
    law = DADSC(mass=40.0, viscous=60.0, tracking_rate=300.0, reaching_rate=300.0, adaptation_rate=300.0)
    return replace(loop, control=replace(loop.control, law=law, feedforward=()))


@pytest.mark.slow(reason="two laws are tuned from two starts each; the comparison has their figures quickly")
def test_the_cascade_and_dadsc_on_a_rigid_drive_at_equal_robustness(motor: Loop) -> None:
    """0.90 and 1.04 nm √s/N at two samples of dead time, as computed before this project began, to their digits."""
    cascade, dadsc = tuned(motor, starts=2), tuned(with_dadsc(motor), starts=2)
    assert 1e9 * cascade.after[0].rope_snap == pytest.approx(0.90, abs=0.005)
    assert 1e9 * dadsc.after[0].rope_snap == pytest.approx(1.04, abs=0.005)
    for found in (cascade, dadsc):
        assert {each.what for each in found.held} == {"Ms"}
        assert found.proven, found.proof
        assert found.settled
    # a triple real pole is the optimum of DADSC: its three rates come out equal to a per cent
    rates = np.array(list(dadsc.tunables.values()))
    assert np.ptp(rates) < 0.01 * rates.mean()


@pytest.mark.slow(reason="a grid of 343 loops; another search finds the same optimum quickly")
def test_equal_to_a_grid_of_all_gains(motor: Loop) -> None:
    """No point of a grid around the end is better by more than the grid's own coarseness, and one comes near."""
    found = tuned(motor)
    end = np.array([found.tunables[f"law.{name}"] for name in CascadePPI.tunables])
    best = np.inf
    for a in np.geomspace(0.75, 1.35, 7):
        for b in np.geomspace(0.85, 1.18, 7):
            for c in np.geomspace(0.75, 1.35, 7):
                values = end * [a, b, c]
                loop = tree.vary(
                    motor,
                    dict(zip([f"axis.x.control.law.{n}" for n in CascadePPI.tunables], values.tolist(), strict=True)),
                )
                there = robustness(loop)
                if there.stable and there.sensitivity_peak <= 2.0 and there.delay_margin_samples >= 2.0:
                    best = min(best, there.rope_snap)
    # the search keeps a thousandth of room to its bounds
    assert found.after[0].rope_snap < 1.002 * best
    assert best < 1.05 * found.after[0].rope_snap


def test_the_bounds_hold_on_lines_of_its_own(screw: Loop) -> None:
    made = tuned(screw)
    found = margins(loop_gain(made.loops[0], np.geomspace(0.5, 10_000, 8000)))
    assert 1.99 < found.sensitivity_peak <= 2.0001
    assert found.delay_margin_samples is not None
    assert found.delay_margin_samples > 2.0
    assert made.proven, made.proof
    # today's gains are within 3 % of the optimum: they were found by the same criterion
    assert made.after[0].rope_snap < robustness(screw).rope_snap < 1.03 * made.after[0].rope_snap


def test_the_delay_margin_can_be_the_bound(motor: Loop) -> None:
    """Without dead time Ms <= 2 leaves less than two samples: the other bound is active."""
    found = tuned(tree.vary(motor, {"axis.x.actuator.dead_time": 0.0}))
    assert {each.what for each in found.held} == {"delay margin"}
    assert found.after[0].margins.delay_margin_samples == pytest.approx(2.0, abs=0.01)
    assert found.after[0].margins.sensitivity_peak < 2.0


def test_a_tighter_bound_costs_rope_snap(motor: Loop) -> None:
    softer = tuned(motor, Limits(sensitivity_peak=1.6, delay_margin_samples=2.0), starts=1).after[0]
    assert softer.margins.sensitivity_peak <= 1.6
    assert softer.rope_snap > 1.2 * tuned(motor, starts=1).after[0].rope_snap


def test_it_begins_from_unstable_gains_and_gives_the_same(motor: Loop) -> None:
    wild = tree.vary(
        motor, {"axis.x.control.law.Kp": 4e6, "axis.x.control.law.Kv": 3000.0, "axis.x.control.law.Tn": 2e-4}
    )
    assert not robustness(wild).stable
    assert tuned(wild).after[0].rope_snap == pytest.approx(tuned(motor).after[0].rope_snap, rel=2e-3)


def test_the_same_call_gives_the_same_bits(motor: Loop) -> None:
    assert tuned(motor).tunables == tuned(motor).tunables


def test_what_is_no_knob_is_refused(motor: Loop) -> None:
    with pytest.raises(ParameterError, match=r"law\.Kx"):
        tuned(motor, tunables=["law.Kx"])
    with pytest.raises(ParameterError, match="number > 0"):
        tuned(tree.vary(motor, {"axis.x.control.feedforward.0.viscous": 0.0}), tunables=["feedforward.0.viscous"])
    with pytest.raises(ParameterError, match="sensitivity_peak = 1 "):
        Limits(sensitivity_peak=1.0)
    with pytest.raises(ParameterError, match="has no axis"):
        tune_control(motor.control)


@pytest.mark.slow(reason="a search over the whole range that finds nothing")
def test_no_robust_setting_is_an_error_that_says_how_near_it_came(motor: Loop) -> None:
    """With Ms <= 1.3 alone the best law has a peak compliance of 0.102 um/N, twice what is asked for."""
    with pytest.raises(UnstableError, match=r"% beyond its limit, in conflict with .*; reachable.*Ms <= "):
        tuned(motor, Limits(sensitivity_peak=1.3, compliance_peak_m_per_N=5e-8), starts=1)


def test_pole_placement_beats_the_cascade_on_the_ball_screw(screw: Loop) -> None:
    """Known: 0.76 to 0.78 at equal peak compliance too; here without that bound, so at most 0.78."""
    made, _ = candidates(screw)
    placement = next(each for each in made if each.name == "pole placement")
    ratio = tuned(placement.loop).after[0].rope_snap / tuned(screw).after[0].rope_snap
    assert 0.65 < ratio <= 0.78


def test_the_two_mass_model_of_a_chain(screw: Loop) -> None:
    model = two_mass_model(screw.axis.plant)
    assert isinstance(model, TwoMass)
    assert (model.mass_motor, model.mass_load, model.viscous_motor) == (130.0, 33.0, 1500.0)
    assert float(model.rigid_mass()) == pytest.approx(float(screw.axis.plant.rigid_mass()), rel=1e-12)


def test_laws_that_do_not_fit_are_refused_with_the_reason(motor: Loop, screw: Loop) -> None:
    _, refused = candidates(motor)
    assert "one encoder" in {each.name: each.reason for each in refused}["pole placement"]
    with pytest.raises(StructureError, match="one mass"):
        two_mass_model(motor.axis.plant)
    modal = Modal(mass=100.0, modes=(Mode(frequency=100.0, mass=20.0, motor=1.0, load=-1.0),))
    with pytest.raises(StructureError, match="take two_mass"):
        two_mass_model(modal)
    assert {each.name.partition(" + ")[2] for each in candidates(screw)[1]} == {"mode compensation"}


def test_nothing_is_fed_forward_twice_and_the_filters_stay(screw: Loop) -> None:
    made, _ = candidates(screw)
    for candidate in made:
        control = candidate.loop.control
        assert control.filters == screw.control.filters
        fed = [*control.law.feeds, *(name for block in control.feedforward for name in block.fed())]
        assert len(fed) == len(set(fed)), candidate.name
        assert {"acceleration", "velocity"} <= set(fed), candidate.name


def test_a_law_without_integral_gets_one_and_says_so() -> None:
    made, _ = candidates(read_machine("emps").loop("x"))
    cascade = made[0]
    assert cascade.name == "P-PI"
    assert "integral" in cascade.remark
    assert "law.Tn" in law_tunables(cascade.loop.control)


def test_all_laws_are_told_the_same_of_the_axis(motor: Loop, screw: Loop) -> None:
    """Mass, viscous friction and delay, in every law, observer and compensation that has a place for them."""
    for loop in (motor, screw):
        axis = axis_model(loop)
        assert axis.delay_samples > 0
        for candidate in candidates(loop)[0]:
            control = candidate.loop.control
            kept = {name for name, _ in tree.leaves(control) if name.startswith(("filters", "law.model"))}
            for name, value in tree.leaves(control):
                last = name.rpartition(".")[2]
                if name not in kept and last in ("mass", "viscous") and not name.startswith("feedforward"):
                    assert value == getattr(axis, last), (candidate.name, name)
            for block in (control.law, *control.compensation):
                observer = getattr(block, "observer", None)
                if observer is not None:
                    assert observer.delay_samples == axis.delay_samples, candidate.name


def test_the_compensator_is_told_the_steady_curve_of_the_axis(motor: Loop) -> None:
    """Every friction block: force of the columns against the block's own curve, from 0.1 mm/s to 0.3 m/s."""
    frictions = {
        Coulomb(coulomb=30.0, viscous=50.0): 1e-9,
        Directional(coulomb_positive=30.0, coulomb_negative=20.0, viscous_positive=5.0, viscous_negative=5.0): 1e-9,
        Stribeck(coulomb=30.0, breakaway=50.0, stribeck_velocity=0.01, viscous=50.0): 0.02,
        # one column for both directions, and exponents other than 2: the best that the columns can do
        DirectionalStribeck(
            coulomb_positive=95.0, coulomb_negative=80.0, breakaway_positive=130.0, breakaway_negative=130.0,
            stribeck_velocity=0.01, viscous=400.0,
        ): 0.08,
        Lugre(coulomb=30.0, breakaway=50.0, stribeck_velocity=0.01, bristle_stiffness=1e6, bristle_damping=100.0,
              viscous=50.0): 0.02,
        Regularised(coulomb=30.0, viscous=50.0, transition_velocity=1e-5): 0.02,
        GeneralizedMaxwellSlip(coulomb=30.0, breakaway=50.0, stribeck_velocity=0.01, viscous=50.0, attraction=3000.0,
                               stiffness=(4e6, 1e6), share=(0.6, 0.4)): 0.02,
    }  # fmt: skip
    assert {type(each) for each in frictions} == {*members(Friction).values()} - {Viscous}
    for friction, share in frictions.items():
        loop = replace(motor, axis=replace(motor.axis, friction_load=friction))
        axis = axis_model(loop)
        block = DisturbanceCompensator.begin(axis)
        dry = replace(block, mass=None, viscous=None)
        speeds = np.geomspace(1e-4, 0.3, 50)
        curve = np.array([axis.dry_friction(v) for v in (*speeds, *-speeds)])
        fed = np.array([dry.step((), Setpoint(0.0, float(v)), 1e-4)[1] for v in (*speeds, *-speeds)])
        assert np.max(np.abs(fed - curve)) <= share * np.max(np.abs(curve)), friction
    bare = replace(motor, axis=replace(motor.axis, friction_load=Viscous(viscous=50.0)))
    assert "no dry friction" in {each.name: each.reason for each in candidates(bare)[1]}["P-PI + compensator"]


class ToyLaw(Law):
    """A law of a user's own, as in CONTRIBUTING: it says nothing of starts and tunables."""

    Kv: float = parameter("1/s", "position gain", above=0)
    Kp: float = parameter("N s/m", "velocity gain", above=0)
    Ki: float = parameter("N/(m s)", "integral gain", above=0)

    class State(NamedTuple):
        """Last position (m) and integral (N)."""

        position: float
        integral: float

    def start(self, prepared: object, setpoint: Setpoint, reading: Reading) -> State:
        return self.State(reading.position_load, reading.applied)

    def step(
        self, prepared: object, state: State, setpoint: Setpoint, reading: Reading, T: float
    ) -> tuple[State, float]:
        error = setpoint.position - reading.position_load
        velocity = (reading.position_load - state.position) / T
        integral = state.integral + self.Ki * T * error
        return self.State(reading.position_load, integral), self.Kp * (self.Kv * error - velocity) + integral


@pytest.mark.slow(reason="a comparison that settles; a law of one's own has a quick one through the command's option")
def test_a_new_law_is_compared_without_another_line(motor: Loop, monkeypatch: pytest.MonkeyPatch) -> None:
    """It stands in the catalogue as a file under blocks/controller would, and nowhere else."""
    found = {family: dict(known) for family, known in catalogue.catalogue().items()}
    found[Law]["toy_law"] = ToyLaw
    monkeypatch.setattr(catalogue, "catalogue", lambda: found)
    made = {each.name: each for each in candidates(motor)[0]}
    assert {"toy law", "toy law + recovery", "toy law + compensator"} <= {*made}
    law = made["toy law"].loop.control.law
    rate, mass = axis_model(motor).rate, 40.0
    assert dict(tree.leaves(law)) == {"Kv": rate, "Kp": mass * rate, "Ki": pytest.approx(mass * rate**3)}
    assert law_tunables(made["toy law"].loop.control) == ("law.Kv", "law.Kp", "law.Ki")
    shown = compare_laws(read_machine("linear_motor"), laws=["toy law"])
    toy, plain = (shown[name].figures["rope_snap_ISE_root_m_per_N"] for name in ("toy law", "P-PI"))
    # a PID like the P-PI, but its zeros may be complex, so that it can only be better
    assert 0.5 * plain < toy < plain
    assert shown["toy law"].unplaced == ""


def test_a_law_begins_by_its_kind_or_by_its_name_in_a_comparison(motor: Loop) -> None:
    """A kind is its first form; a name is one form, with the companion that it names."""
    five, one = (control_with(motor, law).law for law in ("active_disturbance_rejection", "GPI, 1 Taylor state"))
    assert (five.observer.taylor_states, one.observer.taylor_states) == (5, 1)  # type: ignore[attr-defined]
    observed = control_with(motor, "P-P + DOB")
    assert observed.law.Tn is None  # type: ignore[attr-defined]
    assert observed.compensation[0].observer.form == "two_poles"  # type: ignore[attr-defined]
    for name, said in (
        ("P-PI + DOBB", r"'P-PI \+ DOBB' is not known here; did you mean P-PI \+ DOB"),
        ("pole_placemen", "did you mean pole_placement"),
        ("pole placement", "'pole placement' cannot control this axis: .*position of the motor"),
        ("P-PI + compensator", "has the gains of 'P-PI' and nothing else to tune.*compare --take"),
    ):
        with pytest.raises(ParameterError, match=said):
            control_with(motor, name)

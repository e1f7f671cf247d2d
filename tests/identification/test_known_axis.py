"""What identification of a log changes in a machine whose plant or friction says more than a rigid fit can."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from drive_logs import TRUTH, T, loop, set_positions, simulated
from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.blocks.friction.lugre import Lugre
from feeddrive.blocks.friction.stribeck import Stribeck
from feeddrive.blocks.plant.modal import Modal
from feeddrive.blocks.plant.mode import Mode
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.identification.motion.identify import (
    Identified,
    _by_friction,
    axis_remarks,
    identify_motion,
    own_viscous,
    with_counts,
)
from feeddrive.identification.motion.motion_log import MotionLog
from feeddrive.identification.motion.rigid import identify_rigid
from feeddrive.identification.regression import Estimate
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.language.judgment import Judgment
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import simulate

STRIBECK = Stribeck(coulomb=20.0, breakaway=45.0, stribeck_velocity=0.004, viscous=200.0)


def logged(truth: Loop) -> MotionLog:
    """A log of a loop along three strokes, without any other force."""
    reference = set_positions()
    run = simulate(truth, Recorded(position=reference, sample_time=T), record=("force", "reading_load"))
    return MotionLog(
        name="simulated",
        position=run["reading_load"][: reference.size],
        force=run["force"][: reference.size],
        set_position=reference,
        sample_time=T,
    )


def with_axis(**parts: object) -> Loop:
    known = loop()
    return replace(known, axis=replace(known.axis, **parts))  # type: ignore[arg-type]


def test_a_stribeck_curve_that_the_log_needs_stays() -> None:
    start = with_axis(friction_load=replace(STRIBECK, coulomb=30.0, breakaway=67.5, viscous=100.0))
    found = identify_motion(logged(with_axis(friction_load=STRIBECK)), start)
    assert found.loop is not None
    friction = found.loop.axis.friction_load
    assert isinstance(friction, Stribeck)
    # what lies above the curve near standstill counts into the levels of the first fit; the closed loop corrects it
    assert float(friction.coulomb) == pytest.approx(20.0, rel=0.05)
    assert float(friction.stribeck_velocity) == 0.004
    assert any("friction stays stribeck" in said for said in found.remarks)


def test_a_stribeck_curve_against_which_the_log_speaks_goes_and_that_is_said() -> None:
    start = with_axis(friction_load=replace(STRIBECK, coulomb=20.0, breakaway=80.0, stribeck_velocity=0.02))
    found = identify_motion(simulated(size=0.5), start)
    assert found.loop is not None
    assert isinstance(found.loop.axis.friction_load, Coulomb)
    said = next(said for said in found.remarks if "no longer stribeck" in said)
    assert "um RMS" in said


def test_presliding_stays_where_no_closed_loop_can_speak() -> None:
    lugre = Lugre(coulomb=25.0, breakaway=30.0, stribeck_velocity=0.01, bristle_stiffness=1e6, viscous=150.0)
    log = replace(simulated(size=0.5), set_position=None)
    found = identify_motion(log, with_axis(friction_load=lugre), friction="symmetric")
    assert found.loop is not None
    friction = found.loop.axis.friction_load
    assert isinstance(friction, Lugre)
    assert float(friction.coulomb) == pytest.approx(TRUTH["coulomb"], rel=0.05)
    assert float(friction.breakaway) / float(friction.coulomb) == pytest.approx(30.0 / 25.0)
    assert any("stays lugre" in said for said in found.remarks)


@pytest.mark.parametrize(
    "plant",
    [
        TwoMass(mass_motor=60.0, mass_load=35.1089, stiffness=5e7, damping=2000.0, viscous_motor=50.0),
        Modal(mass=95.1089, viscous=50.0, modes=(Mode(frequency=200.0, mass=300.0, load=-0.8),)),
    ],
    ids=["two masses", "modes"],
)
def test_bodies_keep_their_masses_and_the_friction_comes_beside_their_own(plant: TwoMass | Modal) -> None:
    truth = with_axis(plant=plant, friction_load=Coulomb(coulomb=20.0, viscous=150.0))
    found = identify_motion(
        logged(truth), with_axis(plant=plant, friction_load=Coulomb(coulomb=10.0)), friction="symmetric"
    )
    assert own_viscous(truth.axis) == pytest.approx(50.0)
    assert found.loop is not None
    assert repr(found.loop.axis.plant) == repr(plant)
    assert float(tree.get(found.loop, "axis.x.friction_load.coulomb")) == pytest.approx(20.0, rel=0.02)
    assert float(tree.get(found.loop, "axis.x.friction_load.viscous")) == pytest.approx(150.0, rel=0.05)
    said = next(said for said in found.remarks if "the sum of its masses" in said)
    assert "is off by" not in said


def test_a_sum_of_masses_that_is_not_that_of_the_file_is_said() -> None:
    plant = TwoMass(mass_motor=60.0, mass_load=80.0, stiffness=5e7, damping=2000.0)
    found = identify_motion(simulated(size=0.5), with_axis(plant=plant), friction="symmetric")
    said = next(said for said in found.remarks if "the sum of its masses" in said)
    assert "140 kg, is off by -32" in said
    assert np.isclose(float(found.loop.axis.plant.rigid_mass()), 140.0)  # type: ignore[union-attr]


def test_friction_on_both_bodies_stays_as_it_is() -> None:
    plant = TwoMass(mass_motor=60.0, mass_load=35.1, stiffness=5e7, damping=2000.0)
    start = with_axis(plant=plant, friction_motor=Coulomb(coulomb=7.0), friction_load=Coulomb(coulomb=9.0))
    found = identify_motion(simulated(size=0.5), start, friction="symmetric")
    assert found.loop is not None
    assert repr(found.loop.axis.friction_motor) == repr(start.axis.friction_motor)
    assert any("friction acts on both bodies" in said for said in found.remarks)


def test_a_travel_that_no_axis_has_and_a_log_of_another_kind_are_named() -> None:
    log = simulated(size=0.5)
    assert not identify_motion(log, friction="symmetric").doubt
    found = identify_motion(replace(log, position=1e5 * log.position, set_position=None), friction="symmetric")
    assert any("check unit and factor of the position" in said for said in found.remarks)
    assert re.search(r"the speed is 12\d{3} m/s, where feed drives have 0\.01 um/s to 10 m/s", found.doubt)
    assert found.recommendation.startswith("Check the units before anything is done with these values")
    with pytest.raises(ParameterError, match="takes a MotionLog"):
        identify_motion({"position": log.position})  # type: ignore[arg-type]


# ---------------------------------------------------------------- what decides: a case on either side of each bound


def estimated(mass: float) -> Any:
    """What the inverse dynamics found, as far as remarks and recommendation look at it."""
    return {"mass": Estimate("mass", mass, "kg", 1e-3, 1e-3)}


@pytest.mark.parametrize(("off", "said"), [(0.035, False), (0.08, True)])
def test_a_sum_of_masses_that_is_5_percent_off_is_said(off: float, said: bool) -> None:
    axis = with_axis(plant=TwoMass(mass_motor=60.0, mass_load=40.0, stiffness=5e7, damping=2000.0)).axis
    (remark,) = axis_remarks(axis, estimated(100.0 * (1.0 + off)))
    assert ("is off by" in remark) is said


@pytest.mark.parametrize(("left", "usable"), [(0.12, True), (0.2, False)])
def test_values_that_leave_15_percent_of_the_force_are_not_used(left: float, usable: bool) -> None:
    found = judged(left, Estimate("mass", 100.0, "kg", 0.1, 0.1))
    assert (found.unusable == "") is usable


def judged(left: float, mass: Estimate) -> Identified:
    class Rigid(SimpleNamespace):
        def __getitem__(self, _: str) -> Estimate:
            return mass

    rigid: Any = Rigid(
        left=left,
        changed=False,
        friction="symmetric",
        criterion={"symmetric": 0.0},
        validation=SimpleNamespace(relative=0.01),
    )
    anything: Any = None
    return Identified(anything, rigid, anything, None, None, None, None, ())


@pytest.mark.parametrize(
    ("error", "judgment", "usable"),
    [
        (2.0, Judgment.USE_VALUES, True),
        (3.0, Judgment.DO_NOT_TRUST, True),
        (14.0, Judgment.DO_NOT_TRUST, True),
        (16.0, Judgment.DO_NOT_TRUST, False),
    ],
)
def test_a_mass_is_recommended_within_5_percent_and_used_within_30(
    error: float, judgment: Judgment, usable: bool
) -> None:
    """95 % intervals of 100 kg: +-3.9, 5.9, 27.4 and 31.4 kg."""
    found = judged(0.01, Estimate("mass", 100.0, "kg", error, error))
    assert found.advice.judgment is judgment
    assert (found.unusable == "") is usable
    if judgment is Judgment.DO_NOT_TRUST:
        assert "the log tells the mass to +-" in found.recommendation


@pytest.mark.parametrize(("times", "kind"), [(1.012, "stribeck"), (1.035, "coulomb")])
def test_the_friction_of_the_machine_stays_up_to_2_percent_more_of_the_position(
    monkeypatch: pytest.MonkeyPatch, times: float, kind: str
) -> None:
    def fit(left: float) -> Any:
        return SimpleNamespace(replay=SimpleNamespace(rms=lambda _: left))

    log = logged(loop())
    start = with_axis(friction_load=STRIBECK)
    rigid = identify_rigid(log, friction="symmetric")
    monkeypatch.setattr("feeddrive.identification.motion.identify.refine", lambda *_: fit(times * 1e-6))
    kept, _ = _by_friction(log, start, rigid, with_axis(friction_load=Coulomb(coulomb=20.0)), fit(1e-6), [])
    assert kept.axis.friction_load is not None
    assert kept.axis.friction_load.kind == kind


def test_one_log_in_17_leaves_more_than_the_worst_of_its_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def drawn(loop: Any, log: Any, skip: int, count: float, runs: int, seed: int) -> list[Any]:
        asked.append(runs)
        return [(log.position, log.force)]

    monkeypatch.setattr("feeddrive.identification.motion.identify.drawn", drawn)
    monkeypatch.setattr("feeddrive.identification.motion.identify.count_of", lambda _: 1e-6)
    log, fit = logged(loop()), SimpleNamespace(loop=None)
    nothing: Any = None
    with_counts(log, identify_rigid(log, friction="symmetric"), cast(Any, fit), nothing)
    assert [1.0 / (runs + 1) for runs in asked] == [pytest.approx(1.0 / 17.0)]

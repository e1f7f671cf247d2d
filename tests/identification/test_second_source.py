"""What a second source says of clock and scales: patterns of factors in closed form, and thresholds on either side."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import foreign_axis as fa
from feeddrive.blocks.families import Law
from feeddrive.files.columns import Column
from feeddrive.files.commissioning import Commissioning
from feeddrive.files.log import Log
from feeddrive.files.role_checks import doubts_of
from feeddrive.identification.motion.identify import Identified, identify_motion
from feeddrive.identification.motion.known_values import against_known, top_speed
from feeddrive.identification.motion.motion_log import MotionLog
from feeddrive.identification.second_source import CLOCK, FORCE, LENGTH, LOAD, Ratio, causes_of, said
from feeddrive.language.errors import ParameterError
from feeddrive.language.judgment import Judgment
from feeddrive.tuning.filters import read_block
from feeddrive.workflow.channels import scale_doubts
from feeddrive.workflow.commissioning import compared
from feeddrive.workflow.force import DriveValues
from feeddrive.workflow.identify import programmed_feed
from feeddrive.workflow.identify_responses import IdentifyRequest

T = 1e-3
# unit of each value, and how it follows force, sample time and length that are read too large
VALUES: dict[str, tuple[str, int, int, int]] = {
    "mass": ("kg", 1, 2, -1),
    "viscous": ("N s/m", 1, 1, -1),
    "coulomb": ("N", 1, 0, 0),
    "Kp": ("N s/m", 1, 1, -1),
    "Kv": ("1/s", 0, -1, 0),
    "Tn": ("s", 0, 1, 0),
    "velocity_feedforward": ("", 0, 0, 0),
}


def ratio(name: str, times: float, error: float = 0.0, unit: str = "") -> Ratio | None:
    return Ratio.of(name, unit or VALUES[name][0], 7.0 * times, 7.0, error)


def kinds(*ratios: Ratio | None) -> list[str]:
    return [cause.kind for cause in causes_of(ratios)]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("kind", "place"), [(FORCE, 0), (CLOCK, 1), (LENGTH, 2)])
def test_each_cause_is_told_by_the_pattern_of_its_powers(kind: str, place: int, seed: int) -> None:
    """Values scale as their units do; each is off by a normal error of its own, 0.2 %, too."""
    rng = np.random.default_rng(seed)
    factor = float(np.exp(rng.choice((-1.0, 1.0)) * rng.uniform(0.02, 0.2)))
    found = causes_of(
        ratio(name, factor ** power[place] * (1.0 + 0.002 * rng.standard_normal()), 0.002)
        for name, (_, *power) in VALUES.items()
    )
    # force and length differ in Coulomb friction alone, whose slack is large
    assert found[0].kind == kind
    assert {cause.kind for cause in found} <= ({CLOCK} if kind == CLOCK else {FORCE, LENGTH})
    assert abs(found[0].factor - factor) < 3.0 * found[0].error < 0.03
    assert set(found[0].shown) == {name for name, (_, *power) in VALUES.items() if power[place]}


def test_a_load_changes_the_mass_alone_and_a_mass_alone_tells_no_cause() -> None:
    others = [ratio(name, 1.0) for name in VALUES if name != "mass"]
    assert kinds(ratio("mass", 1.08), *others) == [LOAD]
    assert set(kinds(ratio("mass", 1.08))) == {CLOCK, FORCE, LENGTH, LOAD}
    # neither a cause nor a unit is known
    assert kinds(ratio("mass", 1.0, unit="kg"), Ratio.of("Pgain", "V", 2.0, 1.0)) == []
    assert Ratio.of("offset", "N", -1.0, 2.0) is None


@pytest.mark.parametrize(("name", "times", "told"), [
    ("mass", 1.025, False), ("mass", 1.04, True),  # three times 1 %
    ("viscous", 1.25, False), ("viscous", 1.4, True),  # three times 10 %
    ("coulomb", 1.25, False), ("coulomb", 1.4, True),
    ("Kv", 1.008, False), ("Kv", 1.013, True),  # 1 %
])  # fmt: skip
def test_a_value_may_differ_by_its_slack(name: str, times: float, told: bool) -> None:
    assert bool(kinds(ratio(name, times))) is told


@pytest.mark.parametrize(("times", "told"), [(1.008, False), (1.013, True)])
def test_a_clock_matters_from_a_percent(times: float, told: bool) -> None:
    """Two gains tell it to 0.2 %."""
    assert bool(kinds(ratio("Kp", times), ratio("Kv", 1.0 / times))) is told


@pytest.mark.parametrize(("rest", "force"), [(0.0073, True), (0.0081, False)])
def test_a_cause_leaves_no_more_than_chance(rest: float, force: bool) -> None:
    """A force leaves Kv as it is, and a length, too; sqrt(6.63) slacks of 0.3 % are exceeded by one chance in 100."""
    assert (FORCE in kinds(ratio("Kp", 1.05), ratio("Kv", float(np.exp(rest))))) is force


def test_the_sentence_names_log_factor_and_option() -> None:
    by_clock = causes_of([ratio("Kp", 1.02), ratio("Kv", 1.0 / 1.02), ratio("mass", 1.02**2)])
    text = str(said(by_clock, "run.csv", 1.02e-3, "other.csv"))
    assert "sample time of 'run.csv' is stated 2 % too long, 1.02 ms in place of 1 ms" in text
    assert "or that of 'other.csv' as much too short" in text
    assert "--time 'column*0.9804:s'" in text
    by_force = causes_of([ratio("Kp", 80.0), ratio("Kv", 1.0), ratio("mass", 80.0)])
    assert "force of 'run.csv' is read 80 times" in str(said(by_force[:1], "run.csv", T))
    assert "--force 'column*0.0125'" in str(said(by_force[:1], "run.csv", T))


# a velocity beside a position, a current beside a force


def moves(seed: int) -> dict[str, np.ndarray]:
    """Position, true velocity and force of a foreign axis, with counts of 0.5 um and a rounded velocity."""
    rng = np.random.default_rng(seed)
    mass = rng.uniform(40.0, 200.0)
    axes = fa.Axes(mass=mass, viscous=mass, coulomb_positive=mass, coulomb_negative=mass, resolution=5e-7)
    xs = fa.smooth_moves(T, (0.08, 0.0), rng.uniform(0.1, 0.3), 2.0, 60.0, 0.1, 0.1)
    logs = fa.simulate(axes, fa.Cascade(Kv=20.0, Kp=mass * 120.0, ff=1.0), xs, T, rng)
    log = logs.log(0)
    velocity = np.rint(logs.hidden["velocity"][0] / 1e-4) * 1e-4
    return {"position": log["position"], "force": log["force"], "velocity": velocity}


@pytest.mark.parametrize(("times", "told"), [(1.006, False), (1.015, True), (0.985, True)])
def test_a_velocity_tells_a_clock_that_is_a_percent_wrong(times: float, told: bool) -> None:
    log = moves(4)
    channels = {"position_load": log["position"], "velocity_load": log["velocity"]}
    columns = {role: Column(name=role) for role in channels}
    doubts = [doubt for doubt in doubts_of(channels, columns, times * T, {}) if doubt.kind == "clock"]
    assert bool(doubts) is told
    if told:
        # Δx = k ∫ v dt with the stated steps: k is the true step over the stated one
        assert f"{1.0 / times:.4g} times 'velocity_load'" in str(doubts[0].why)
        assert "the sample time is 1 ms" in str(doubts[0].why)


@pytest.mark.parametrize(("times", "told"), [(1.0007, True), (1.0015, False), (82.0, False)])
def test_a_force_with_the_numbers_of_its_current_is_in_amperes(times: float, told: bool) -> None:
    log = moves(5)
    channels = {"position_load": log["position"], "force": log["force"], "current": log["force"] / times}
    columns = {role: Column(name=role) for role in channels}
    doubts = [doubt for doubt in doubts_of(channels, columns, T, {}) if doubt.kind == "clock"]
    assert bool(doubts) is told
    if told:
        assert "it is a current in A and no force" in str(doubts[0].why)


@pytest.mark.parametrize(("times", "told"), [(1.1, False), (1.22, True), (0.8, True)])
def test_the_constant_of_a_motor_is_held_against_force_and_current(times: float, told: bool) -> None:
    log = moves(6)
    channels = {"position_load": log["position"], "force": log["force"], "current": log["force"] / 82.0}
    held = Log(name="run", time=T * np.arange(log["force"].size), channels=channels, units={}, sample_time=T)
    columns = {role: Column(name=role) for role in channels}
    told_of = scale_doubts(held, columns, DriveValues(motor_constant=82.0 / times))
    assert bool(told_of) is told
    if told:
        assert "'force' is 82 N for each A of 'current', where --motor-constant says" in str(told_of[0])


# known values


@pytest.fixture(scope="module")
def identified() -> Identified:
    """A log of a foreign axis of 88 kg at 0.2 m/s under a P-P cascade."""
    axes = fa.Axes(
        mass=88.0, viscous=150.0, coulomb_positive=30.0, coulomb_negative=30.0, noise_log=2.0, resolution=1e-8
    )
    xs = fa.smooth_moves(T, (0.1, 0.0) * 2, 0.2, 2.0, 80.0, 0.1, 0.1)
    law = fa.Cascade(Kv=25.0, Kp=88.0 * 150.0, ff=1.0)
    log = fa.simulate(axes, law, xs, T, np.random.default_rng(8)).log(0)
    motion = MotionLog(
        name="run.csv", position=log["position"], force=log["force"], set_position=log["setpoint"], sample_time=T
    )
    return identify_motion(motion, law=read_block(Law, "cascade_ppi:Kv=25,Kp=13200"), friction="symmetric")


def with_clock(found: Identified, times: float) -> Identified:
    """What the same rows give if their sample time is stated `times` too long: mass s², Kp s, Kv 1/s."""
    assert found.law is not None
    power = {"Kp": times, "Kv": 1.0 / times}
    gains = tuple(gain._replace(needed=gain.stated * power.get(gain.name[-2:], 1.0)) for gain in found.law.gains)
    rigid = replace(
        found.rigid, estimates=(replace(found.rigid["mass"], value=88.0 * times**2), *found.rigid.estimates[1:])
    )
    return replace(
        found,
        log=replace(found.log, sample_time=times * T),
        law=replace(found.law, gains=gains),
        rigid=rigid,
        refinement=None,
    )


def test_a_known_mass_and_feed_confirm_clock_and_scales_or_contradict_them(identified: Identified) -> None:
    against, remarks = against_known(identified, 88.0, 0.2)
    assert against == []
    assert "clock and scales agree with what is known" in str(remarks[0])
    slow = with_clock(identified, 1.02)
    for known in ({"mass": 88.0}, {"feed": 0.2}, {"mass": 88.0, "feed": 0.2}):
        against, _ = against_known(replace(slow, law=None), **known)
        assert len(against) == 1, known
        assert "the sample time of 'run.csv' is stated 2 % too long" in str(against[0])
    # the feed excludes that it is the force
    assert "the force" not in str(against[0])
    assert "the force" in str(against_known(replace(slow, law=None), mass=88.0)[0][0])


def test_the_gains_of_the_law_tell_a_wrong_clock_alone(identified: Identified) -> None:
    assert against_known(identified) == ([], [])
    against, _ = against_known(with_clock(identified, 1.02))
    assert "the law that is stated made the force of the log with other law.Kv and law.Kp" in str(against[0])
    assert "stated 2 % too long" in str(against[0])
    found = replace(identified, contradicted=against[0])
    assert found.advice.judgment is Judgment.SCALES_IN_DOUBT
    # one gain that was typed wrong is no clock
    assert identified.law is not None
    gains = tuple(
        gain._replace(needed=1.05 * gain.needed) if "Kp" in gain.name else gain for gain in identified.law.gains
    )
    assert against_known(replace(identified, law=replace(identified.law, gains=gains)))[0] == []


@pytest.mark.parametrize(
    ("step", "told"),
    [(1e-3, False), (1.006e-3, False), (1.015e-3, True), (0.25e-3, False), (0.985e-3, True), (4.06e-3, True)],
)
def test_the_sample_time_of_a_machine_file_is_that_of_the_log_or_of_each_nth_row(
    step: float, told: bool, identified: Identified
) -> None:
    against, _ = against_known(identified, sample_time=step)
    assert any("the machine file has a sample time" in str(text) for text in against) is told


@pytest.mark.parametrize(("held", "known"), [(0.035, False), (0.06, True)])
def test_a_feed_is_reached_if_it_is_held_for_a_while(held: float, known: bool) -> None:
    """A trapezoid of 0.2 m/s; 2.5 ms of each ramp are within 1 % of it, 5 ms at each end are in the window."""
    speed = np.interp(np.arange(0.0, 2.4, T), np.cumsum([0.0, 0.5, held, 0.5]), [0.0, 0.2, 0.2, 0.0])
    speed = np.concatenate([speed, -speed])
    log = MotionLog(name="run", position=np.cumsum(speed) * T, force=np.sin(np.arange(speed.size)), sample_time=T)
    reached = top_speed(log)
    assert (reached is not None) is known
    if reached is not None:
        # within a tenth of the share in which a speed counts as constant
        assert reached == pytest.approx(0.2, rel=1e-3)


@pytest.mark.parametrize(
    ("text", "rotary", "turning", "lead", "feed"),
    [
        ("6000", False, False, None, 0.1),
        ("6:m/min", False, False, None, 0.1),
        ("3600", True, True, None, 2.0 * math.pi / 6.0),
        ("10 rev/min", True, True, None, 2.0 * math.pi / 6.0),
        ("6000", True, False, 0.02, 0.1 / (0.02 / (2.0 * math.pi))),
    ],
)
def test_a_feed_is_in_mm_per_min_and_in_degrees_per_min_of_an_axis_that_turns(
    text: str, rotary: bool, turning: bool, lead: float | None, feed: float
) -> None:
    log = MotionLog(
        name="run",
        position=np.arange(200.0),
        force=np.sin(np.arange(200)),
        sample_time=T,
        rotary=rotary,
        turning=turning,
    )
    request = IdentifyRequest(Path("run.csv"), feed=text, lead=lead)
    assert programmed_feed(request, log) == pytest.approx(feed, rel=1e-9)
    told = [str(remark) for remark in request.about_gear()]
    assert (len(told) == 1 and "--lead 20 mm without --gear: gear 1 is taken" in told[0]) is (lead is not None)
    assert IdentifyRequest(Path("run.csv"), lead=lead, gear=1.0).about_gear() == []
    with pytest.raises(ParameterError, match="--feed 3:kg: the unit kg must be a speed"):
        programmed_feed(replace(request, feed="3:kg", lead=None), log)


# a commissioning file


@pytest.mark.parametrize(("times", "told"), [(1.1, False), (1.2, True), (0.8, True)])
def test_the_inertia_of_the_tool_is_a_second_source(times: float, told: bool) -> None:
    file = Commissioning("AX1.xml", {}, (), (), {}, inertia=0.02, motor_inertia=0.004)
    remarks = list(map(str, compared(file, 0.02 * times)))
    assert any("times the tool's own" in remark for remark in remarks) is told
    assert any("inertia 0.02 kg m2" in remark for remark in remarks)


@pytest.mark.parametrize(("inertia", "told"), [(0.0036, False), (0.0032, True)])
def test_an_axis_has_the_inertia_of_its_motor_at_least(inertia: float, told: bool) -> None:
    file = Commissioning("AX1.xml", {}, (), (), {}, motor_inertia=0.004)
    assert any("less than that of the motor alone" in str(remark) for remark in compared(file, inertia)) is told

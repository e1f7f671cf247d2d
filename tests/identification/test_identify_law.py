"""The control law of a log: one foreign log of each family, classes that no log can tell apart, and refusals."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import foreign_axis as fa
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.controller.linuxcnc_pid import LinuxcncPid
from feeddrive.identification.motion import identify_law, law_other_readings, law_search, law_structures
from feeddrive.identification.motion.control_law import check_law
from feeddrive.identification.motion.identify_law import (
    ControlFit,
    _held,
    _judged,
    _known,
    _same,
    identify_control,
)
from feeddrive.identification.motion.law_rows import LawRows, Signals, Twist
from feeddrive.identification.motion.law_search import Scored
from feeddrive.identification.motion.law_set_position import restored, steadied
from feeddrive.identification.motion.law_structures import CASCADE as CASCADE_FAMILY
from feeddrive.identification.motion.law_structures import Fitted, Structure
from feeddrive.identification.motion.motion_log import MotionLog
from feeddrive.language.errors import NotIdentifiableError

T = 1e-3
CASCADE = {"Kv": 30.0, "Kp": 9000.0, "n": 1}
PI = CASCADE | {"rate": 20.0, "ff": 0.8, "n": 2}


@cache
def logged(law: str, changes: tuple[tuple[str, Any], ...], limit: float = math.inf, seed: int = 1) -> MotionLog:
    """Two seconds of moves of 100 kg with Coulomb friction, counts of 1 um, and 1 % of noise in the logged force."""
    made = {"Cascade": fa.Cascade, "LinuxCncPid": fa.LinuxCncPid, "Adrc": fa.Adrc}[law](**dict(changes))
    axes = fa.Axes(
        mass=100.0,
        viscous=200.0,
        coulomb_positive=60.0,
        coulomb_negative=50.0,
        resolution=1e-6,
        noise_log=2.0,
        dead_time=0.5 * T,
        limit=limit,
    )
    xs = fa.smooth_moves(T, (0.06, 0.02, 0.08, 0.0), 0.2, 2.0, 60.0, 0.05, 0.1)
    logs = fa.simulate(axes, made, xs, T, np.random.default_rng(seed), substeps=1)
    log = logs.log(0, first=50)
    return MotionLog(
        name="log", position=log["position"], force=log["force"], set_position=log["setpoint"], sample_time=T
    )


def found(law: str, limit: float = math.inf, **changes: Any) -> ControlFit:
    return identify_control(logged(law, tuple(changes.items()), limit))


def near(fit: ControlFit, reading: int = 0, **truth: float) -> None:
    """Each gain is within 2 % and within 4 standard errors (one normal value in 16,000) of the truth."""
    for name, value in truth.items():
        estimate = fit.readings[reading][name]
        assert estimate.value == pytest.approx(value, rel=0.02), name
        assert abs(estimate.value - value) < 4.0 * estimate.error, name


def test_a_cascade_without_an_integral() -> None:
    fit = found("Cascade", **CASCADE, ff=0.9)
    assert fit.readings[0].name == "P-P cascade"
    assert not fit.near
    assert (fit.velocity_samples, fit.delay) == (1, 0)
    near(fit, Kv=30.0, Kp=9000.0, velocity_feedforward=0.9)


def test_a_cascade_with_an_integral_even_at_its_limit() -> None:
    """The limit is reached in 0.5 % of the rows; the integral behind it is whatever the anti-windup made of it."""
    fit = found("Cascade", limit=255.0, **PI, windup="stop")
    assert fit.readings[0].name == "P-PI cascade"
    assert (fit.velocity_samples, fit.delay) == (2, 0)
    near(fit, Kv=30.0, Kp=9000.0, Tn=0.05, velocity_feedforward=0.8)
    law = fit.law()
    assert isinstance(law, CascadePPI)
    assert law.Tn == pytest.approx(0.05, rel=0.02)


def test_feedforward_of_acceleration_and_friction() -> None:
    fed = PI | {"mass_ff": 80.0, "friction_ff": 40.0, "friction_speed": 2e-3}
    fit = found("Cascade", **fed)
    near(fit, Kv=30.0, Kp=9000.0, Tn=0.05, mass=80.0, friction=40.0)
    control = fit.control()
    assert [part.kind for part in control.feedforward] == ["inertia", "friction_feedforward"]
    # the block takes the acceleration in the middle of the sample, the law at its end: 1.5 samples of 60 m/s3 on 80 kg
    assert (
        check_law(
            control,
            logged("Cascade", tuple((PI | {"mass_ff": 80.0, "friction_ff": 40.0, "friction_speed": 2e-3}).items())),
        ).left
        < 0.03
    )


def test_a_reference_model_in_the_integral() -> None:
    fit = found("Cascade", **PI, model_mass=110.0, model_delay=1)
    assert fit.readings[0].name == "P-PI cascade with reference model"
    near(fit, Kv=30.0, Kp=9000.0, Tn=0.05, model_mass=110.0)
    assert any("first order behind a dead time" in remark for remark in fit.remarks)


def test_a_low_pass_of_the_command() -> None:
    fit = found("Cascade", **PI, tau=3e-3)
    assert fit.readings[0].name == "P-PI cascade with low pass"
    near(fit, Kv=30.0, Kp=9000.0, Tn=0.05, time_constant=3e-3)
    assert len(fit.control().filters) == 1


def test_a_low_pass_of_the_velocity_alone() -> None:
    """As drives smooth their actual speed; the set velocity does not pass through it."""
    fit = found("Cascade", **PI, velocity_filter=2e-3)
    assert fit.readings[0].name == "P-PI cascade with low pass of the velocity"
    near(fit, Kv=30.0, Kp=9000.0, Tn=0.05, velocity_feedforward=0.8, velocity_lag=2e-3)
    law = fit.law()
    assert isinstance(law, CascadePPI)
    assert law.velocity_lag == pytest.approx(2e-3, rel=0.02)
    # the block commands what the foreign law did: 2 N of noise in some 150 N are left
    assert check_law(fit.control(), logged("Cascade", tuple((PI | {"velocity_filter": 2e-3}).items()))).left < 0.03


def test_a_position_loop_that_runs_every_fourth_sample_is_refused_by_that() -> None:
    with pytest.raises(NotIdentifiableError, match="its position loop runs slower than the log is sampled"):
        found("Cascade", **PI, slower=4)


def test_gains_that_no_real_law_has_are_none() -> None:
    """A position loop of 0.1 1/s behind a 1/Tn of 20 1/s is a P-P law whose Kv took the place of 1/Tn."""
    cascade = Structure(CASCADE_FAMILY, True, 1, 0, forward="one")
    values = np.array([1.0, 1.0])
    assert Fitted(cascade, values, 20.0, 1.0).sensible
    assert not Fitted(cascade, values * (0.1, 1.0), 20.0, 1.0).sensible


@pytest.mark.parametrize(("samples", "near_"), [(4, False), (7, True)])
def test_a_velocity_over_many_samples_may_be_a_filter(samples: int, near_: bool) -> None:
    """A delay of 1.5 samples is usual; with 3, the gains are those of the law here, but a filter would do the same."""
    fit = found("Cascade", **PI | {"n": samples})
    assert fit.near is near_
    assert any("may be a filter" in remark for remark in fit.remarks) is near_
    near(fit, Kv=30.0, Kp=9000.0, Tn=0.05, velocity_feedforward=0.8)


def test_two_laws_alike_are_one_within_a_tenth() -> None:
    cascade = Structure(CASCADE_FAMILY, True, 1, 0, forward="one")
    errors = np.array([0.2, 0.02, 0.4])
    one, near_, far = (Fitted(cascade, np.array([kv, 1.0]), 20.0, 1.0) for kv in (30.0, 32.5, 34.0))
    assert _same(one, near_, errors)
    assert not _same(one, far, errors)
    # a third as far as the errors tell
    assert _same(one, far, 10.0 * errors)


def test_the_errors_know_the_slow_part_of_colored_noise_that_gains_absorb() -> None:
    """Four regressors of 10 s in noise of 20 samples: 200 draws, each gain within its 95 % interval 92 to 98 times in
    100 (binomial, two standard errors of 1.5 %).
    """
    rng = np.random.default_rng(5)
    t = np.arange(5000) / 5000
    columns = np.stack([np.sin(2 * np.pi * k * t) for k in (1, 2, 3, 5)], axis=1)
    inside = []
    for _ in range(200):
        rest = fa._noise(rng, (1, 5000), 1.0, 0.95)[0]
        gains = np.linalg.lstsq(columns, rest, rcond=None)[0]
        errors = np.sqrt(np.diag(law_search.covariance_of(columns, rest - columns @ gains)))
        inside.append(np.abs(gains) < 1.96 * errors)
    assert np.mean(inside) == pytest.approx(0.95, abs=0.03)


def test_a_pid_of_linuxcnc() -> None:
    """Its default, an error to the target of the sample before, tells it from a cascade."""
    fit = found("LinuxCncPid", P=4.5e5, I=5.4e6, D=9000.0, FF2=80.0, previous_target=True)
    # the foreign pid differences the error to the older target, LinuxCNC's the present one: D T of acceleration
    near(fit, P=4.5e5, I=5.4e6, D=9000.0, FF2=80.0 - 9000.0 * T)
    law = fit.law()
    assert isinstance(law, LinuxcncPid)
    assert law.position.error_previous_target
    # in mm, with a force of 1 N per unit of the output
    assert law.position.Pgain == pytest.approx(450.0, rel=0.02)


def test_kv_and_the_integral_time_that_no_log_can_tell_are_both_given() -> None:
    """With all the set velocity fed forward and one sample, Kv and 1/Tn may change places, and a PID is the same."""
    fit = found("Cascade", **CASCADE, rate=20.0, ff=1.0)
    assert [reading.name for reading in fit.readings] == ["P-PI cascade", "P-PI cascade", "PID"]
    near(fit, 0, Kv=20.0, Tn=1.0 / 30.0, Kp=9000.0)
    near(fit, 1, Kv=30.0, Tn=1.0 / 20.0, Kp=9000.0)
    near(fit, 2, P=9000.0 * 50.0, I=9000.0 * 600.0, D=9000.0)
    assert sum("cannot tell" in remark for remark in fit.remarks) == 2


def test_two_samples_tell_them_apart() -> None:
    fit = found("Cascade", **CASCADE | {"n": 2}, rate=20.0, ff=0.7)
    assert len(fit.readings) == 1


def test_a_rounded_set_position_is_restored() -> None:
    """Rounding to 2 um makes 2 mm/s of one step, 18 N through Kp; the law computed with the exact path."""
    log = logged("Cascade", tuple(PI.items()))
    assert log.set_position is not None
    rounded = 2e-6 * np.round(log.set_position / 2e-6)
    exact, smooth = (np.diff(path) / T for path in (log.set_position, steadied(rounded, 2e-6)))
    assert np.std((smooth - exact)[50:-50]) < 0.15 * np.std((np.diff(rounded) / T - exact)[50:-50])
    fit = identify_control(
        MotionLog(name="log", position=log.position, force=log.force, set_position=rounded, sample_time=T)
    )
    near(fit, Kv=30.0, Kp=9000.0, Tn=0.05)


def test_a_smooth_path_without_steps_of_jerk_is_restored_as_well() -> None:
    """sin⁴ has no instant at which its jerk steps: the weights must not bend it."""
    path = 0.05 * np.sin(2.0 * np.pi * T * np.arange(4000)) ** 4
    rounded = 2e-6 * np.round(path / 2e-6)
    exact, smooth = (np.diff(one) / T for one in (path, steadied(rounded, 2e-6)))
    assert np.std((smooth - exact)[50:-50]) < 0.1 * np.std((np.diff(rounded) / T - exact)[50:-50])


def test_other_set_positions_are_as_far_off_as_the_restored_one() -> None:
    """Errors of the set velocity that are drawn are 0.5 to 2 of the true ones: they depend on few instants."""
    log = logged("Cascade", tuple(PI.items()))
    assert log.set_position is not None
    rounded = 2e-6 * np.round(log.set_position / 2e-6)
    signals = restored(replace(Signals.of(log), wanted=rounded), 2e-6)
    error = np.std(np.diff(signals.wanted - log.set_position)[50:-50])
    drawn = [np.std(np.diff(other - signals.wanted)[50:-50]) for other in signals.others]
    assert np.all(np.abs(np.log(np.array(drawn) / error)) < math.log(2.0))
    # it rests exactly where the exact one does, but for the samples that rounding hides at both ends of a move
    still = np.diff(log.set_position, prepend=log.set_position[0]) == 0.0
    assert np.mean(signals.direction("sign0")[still] == 0.0) > 0.8


def test_errors_of_a_restored_set_position_are_in_the_gains_and_are_no_evidence() -> None:
    """Counts of 5 um: errors of the path that is restored from them make more of the error of Kp than noise does."""
    log = logged("Cascade", tuple(PI.items()))
    assert log.set_position is not None
    rounded = MotionLog(
        name="log",
        position=log.position,
        force=log.force,
        set_position=5e-6 * np.round(log.set_position / 5e-6),
        sample_time=T,
    )
    fit = identify_control(rounded)
    near(fit, Kp=9000.0)
    assert not fit.near
    assert fit["Kp"].error > 1.5 * identify_control(log)["Kp"].error


@pytest.mark.parametrize(
    ("slow", "bend", "held"),
    [(50.0, 0.0, False), (70.0, 0.0, True), (70.0, 90.0, False), (-20.0, -30.0, False), (150.0, 90.0, True)],
)
def test_a_slower_position_loop_is_named_only_where_it_is_seen(slow: float, bend: float, held: bool) -> None:
    assert _held(slow, bend) is held


def bent_log(rate: float = 12.0, count: float = 1e-6) -> dict[str, Any]:
    """Two masses with an antiresonance of 40 Hz: the motor, which the law reads, is 16 um per m/s2 ahead of the load.

    `count`: of the motor; the load has 1 um.
    """
    axes = fa.Axes(
        mass=60.0,
        mass_load=40.0,
        stiffness=40.0 * (2.0 * np.pi * 40.0) ** 2,
        damping=400.0,
        coulomb_positive=60.0,
        coulomb_negative=60.0,
        resolution=count,
        resolution_load=1e-6,
        noise_log=2.0,
    )
    xs = fa.smooth_moves(T, (0.1, 0.02, 0.13, 0.0), 0.2, 2.0, 60.0, 0.1, 0.1)
    law = fa.Cascade(Kv=15.0, Kp=6000.0, rate=rate, ff=0.8)
    return fa.simulate(axes, law, xs, T, np.random.default_rng(3), substeps=2).log(0)


@pytest.mark.parametrize("rate", [12.0, 0.0])
def test_a_load_encoder_is_seen_and_the_gains_of_the_motors_loop_are_found(rate: float) -> None:
    log = bent_log(rate)
    fit = identify_control(
        MotionLog(
            name="log", position=log["position_load"], force=log["force"], set_position=log["setpoint"], sample_time=T
        )
    )
    assert fit.other_readings
    # the gains of the slow part of the log: a percent, as two masses and a lag are found with them
    assert fit["Kv"].value == pytest.approx(15.0, rel=0.02)
    assert fit["Kp"].value == pytest.approx(6000.0, rel=0.02)
    assert [estimate.value for estimate in fit.estimates if estimate.name == "Tn"] == (
        [pytest.approx(1.0 / rate, rel=0.02)] if rate else []
    )


def test_a_law_whose_coarse_counts_move_the_axis_is_found_by_what_the_set_motion_tells() -> None:
    """Counts of 20 um: a free law leaves half as much of the slow rows, in squares, as the law that ran."""
    log = bent_log(count=2e-5)
    signals = Signals(log["position_load"], log["setpoint"], log["force"], T)
    other = law_other_readings.with_other_readings(signals, signals.free(None), blue=True)
    assert other is not None
    assert other.told is not None
    assert not other.misses
    best = other.best.fitted
    # the counts command 1.5 % of the force in the slow rows
    assert best["Kp"] == pytest.approx(6000.0, rel=0.02)
    assert best["Kp Kv"] / best["Kp"] == pytest.approx(15.0, rel=0.02)
    assert best.rate == pytest.approx(12.0, rel=0.02)
    # by the set motion a law with other gains is refused
    columns = law_structures.regressors(best, other.rows.signed(other.best.signals))[:, : best.values.size]
    rest = other.rows.force - columns @ (1.05 * best.values)
    spare = other.floor.unknowns - best.structure.parameters
    assert np.sum(other.told.told(rest) ** 2) > 2.0 * (spare + 3.0 * math.sqrt(2.0 * spare))


@pytest.mark.parametrize("n", [1, 4])
def test_counts_of_a_velocity_are_blue_at_its_samples(n: int) -> None:
    """Half a count, white, differenced over n samples beside white noise of a third of it."""
    rng = np.random.default_rng(4)
    log = logged("Cascade", tuple(PI.items()))
    signals = Signals.of(log)
    noise = rng.standard_normal(log.force.size + n)
    bare = replace(signals, force=signals.force + 0.3 * rng.standard_normal(log.force.size))
    blue = replace(bare, force=bare.force + 20.0 * (noise[n:] - noise[:-n]))
    for one, is_blue in ((bare, False), (blue, True)):
        rows = LawRows.of(one, one.free(None))
        floor = law_search.floor_of(rows, rows.reduced())
        assert floor.blue is is_blue
    assert floor.bluest == pytest.approx(-0.5, abs=0.05)


@pytest.mark.parametrize(("bluest", "blue"), [(-0.1, False), (-0.2, True)])
def test_a_residual_is_blue_beyond_chance(bluest: float, blue: bool) -> None:
    """Logs of the readings that the law had are above -0.06, those of other coarse counts at -0.2 to -0.6."""
    assert law_search.Floor(1.0, 1e4, 0.3, bluest, 300.0, 40, 300).blue is blue


def test_a_twist_is_linear_in_its_compliance_and_loss() -> None:
    """The columns of a bent axis are sums of those of three: to the digits of the sums."""
    basis = law_structures.Basis(T)
    lag = law_structures.Lag(0.3, 0.5)
    one = Structure(
        CASCADE_FAMILY, True, 4, 1, fed="backward", friction=0, twist=Twist(3e-5, 4e-4), shifted=True, lag=lag
    )
    whole = law_structures.Reduced(np.eye(basis.size), np.zeros(basis.size))
    task = law_structures.problem(one, basis, whole)
    for made, terms in zip((task.A, task.B), one.terms(basis), strict=True):
        wanted = np.stack([term.on for term in terms], axis=1)
        assert np.max(np.abs(made - wanted)) < 1e-12 * np.max(np.abs(wanted))


def test_counts_that_the_law_read_are_in_the_force_and_those_of_another_encoder_are_not() -> None:
    log = bent_log(count=5e-6)
    heard = []
    for position in (log["position"], log["position_load"]):
        signals = Signals(position, log["setpoint"], log["force"], T)
        heard.append(law_other_readings.counts_of(LawRows.of(signals, signals.free(None)), "dx"))
    assert heard[0].heard
    assert not heard[1].heard


@pytest.mark.parametrize(
    ("expected", "explained", "heard", "missing"),
    [
        (2000.0, 20.0, False, True),
        (400.0, 20.0, False, False),
        (2000.0, 150.0, False, False),
        (1e5, 400.0, False, True),
        (1e5, 600.0, True, False),
        (350.0, 600.0, False, False),
        (500.0, 600.0, True, False),
    ],
)
def test_counts_are_missed_where_the_law_would_make_more_of_them_than_chance(
    expected: float, explained: float, heard: bool, missing: bool
) -> None:
    counts = law_other_readings.Counts(expected, explained, 13, 6000, expected)
    assert (counts.heard, counts.missing) == (heard, missing)


@pytest.mark.parametrize(("beyond", "misses"), [(2.0, False), (4.0, True)])
def test_a_law_of_other_readings_leaves_no_more_than_chance(beyond: float, misses: bool) -> None:
    """The free law has 40 coefficients, of 300 rows; `beyond`: standard deviations of a chi square."""
    fitted = Fitted(Structure(CASCADE_FAMILY, True, 1, 0), np.array([3e5, 5e3, 9e3]), 20.0, 0.0)
    spare = 40 - fitted.structure.parameters
    left = math.exp((spare + beyond * math.sqrt(2.0 * spare)) / 300.0)
    floor = law_search.Floor(1.0, 1e4, 0.3, 0.0, 300.0, 40, 300)
    rows: Any = None
    best = Scored(replace(fitted, ssr=left), 0.0, rows)
    assert law_other_readings.OtherReadings(rows, rows, floor, 0.0, (best,)).misses is misses


def test_slow_rows_hold_the_law_of_all_rows() -> None:
    """A filter before all signals leaves the law as it is: 40 Hz of 1 kHz, each tenth row."""
    log = logged("Cascade", tuple(PI.items()))
    signals = Signals.of(log)
    rows = LawRows.of(signals, signals.free(None))
    slow = rows.slow(40.0)
    assert (slow.step, slow.kernel.size) == (10, 61)
    assert np.all(np.diff(slow.places) == 10)
    structure = Structure(CASCADE_FAMILY, True, 2, 0)
    fitted = law_structures.fit(structure, slow.basis, slow.reduced())
    assert fitted is not None
    assert fitted["Kp"] == pytest.approx(9000.0, rel=5e-3)
    assert fitted["Kp Kv"] / fitted["Kp"] == pytest.approx(30.0, rel=5e-3)
    assert fitted.rate == pytest.approx(20.0, rel=5e-3)


def test_gains_that_the_slow_part_of_a_log_denies_are_not_the_law() -> None:
    """5 % more of one gain is far beyond the noise of the slow rows."""
    signals = Signals.of(logged("Cascade", tuple(PI.items())))
    rows = LawRows.of(signals, signals.free(None))
    fitted = law_structures.fit(Structure(CASCADE_FAMILY, True, 2, 0), rows.basis, rows.reduced())
    assert fitted is not None
    assert law_other_readings.differs(rows, Scored(fitted, 0.0, signals)) < 0.1 * identify_law.STEADY
    wrong = replace(fitted, values=fitted.values * np.array([1.0, 1.05, 1.0]))
    assert law_other_readings.differs(rows, Scored(wrong, 0.0, signals)) > 2.0 * identify_law.STEADY


def test_stretches_that_are_too_short_for_a_slow_part_confirm_no_law() -> None:
    """Each stretch is shorter than the 61 samples of the low pass of 40 Hz: no slow row is left."""
    signals = Signals.of(logged("Cascade", tuple(PI.items())))
    whole = signals.free(None)
    short = LawRows.of(signals, whole & (np.arange(whole.size) % 60 != 0))
    assert short.force.size > 1000
    assert short.slow(40.0).force.size == 0
    fitted = law_structures.fit(Structure(CASCADE_FAMILY, True, 2, 0), short.basis, short.reduced())
    assert fitted is not None
    assert law_other_readings.differs(short, Scored(fitted, 0.0, signals)) == np.inf


def test_rests_are_left_out_but_for_how_motion_ends_and_begins() -> None:
    """0.5 s of rest: 0.05 s after the end of motion and 0.05 s before the next one stay."""
    wanted = np.concatenate([np.zeros(300), np.linspace(0.0, 0.1, 500), np.full(500, 0.1), np.linspace(0.1, 0.0, 500)])
    kept = Signals(wanted, wanted, wanted, T).between_rests()
    assert np.array_equal(np.flatnonzero(np.diff(kept.astype(int))), [250, 849, 1250])


@pytest.mark.parametrize("dead_band", [40e-6, 7e-6])
def test_a_dead_band_is_refused_with_the_share_of_a_free_law(dead_band: float) -> None:
    """With 7 um, seven counts, its force is within the noise but follows what the band takes from the error.

    `benchmarks/control_laws.py` has more laws outside of the families.
    """
    with pytest.raises(NotIdentifiableError, match=r"a free linear law of the same signals .* a nonlinear part"):
        found("Cascade", **PI, dead_band=dead_band)


def test_a_notch_in_the_law_makes_the_nearest_cascade_near_and_not_the_law() -> None:
    fit = found("Cascade", **PI, notch=60.0)
    assert fit.near
    assert "near to" in fit.remarks[0]


def test_a_log_without_set_position_says_what_to_record() -> None:
    log = logged("Cascade", tuple(PI.items()))
    with pytest.raises(NotIdentifiableError, match="without the set position: record it next"):
        identify_control(MotionLog(name="log", position=log.position, force=log.force, sample_time=T))


def test_a_command_at_its_limit_is_no_row_of_the_law() -> None:
    signals = Signals.of(logged("Cascade", tuple(PI.items())))
    force = np.clip(signals.force, -200.0, 200.0)
    free = Signals(signals.x, signals.wanted, force, T).free(None)
    assert not np.any(free & (np.abs(force) >= 200.0))


class Stand(SimpleNamespace):
    """An object with the fields that a function reads."""


@pytest.mark.parametrize(
    ("held", "why"), [(0.3, "too short to find its law"), (0.6, "at its limit in nearly all rows")]
)
def test_too_few_rows_are_told_from_a_command_at_its_limit(held: float, why: str) -> None:
    """180 rows, a share of them at the largest force: with 0.4 of them free it is the limit, with 0.7 the length."""
    log = logged("Cascade", tuple(PI.items()))
    rows = slice(400, 580)
    force = log.force[rows].copy()
    most = float(np.max(np.abs(force)))
    force[: round(held * force.size)] = most
    assert log.set_position is not None
    cut = Stand(
        name="log",
        position=log.position[rows],
        force=force,
        set_position=log.set_position[rows],
        sample_time=T,
        force_limit=None,
    )
    with pytest.raises(NotIdentifiableError, match=why):
        identify_control(cut)  # type: ignore[arg-type]


@pytest.mark.parametrize(("doubt", "told"), [(0.45, "tells its gains to +-88 % only"), (0.55, "are too short to tell")])
def test_gains_that_are_less_than_their_errors_are_not_told_in_percent(
    doubt: float, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(identify_law.LawReading, "doubt", property(lambda _: doubt))
    with pytest.raises(NotIdentifiableError) as refused:
        found("Cascade", **CASCADE, ff=0.9)
    assert told in str(refused.value)


@pytest.mark.parametrize(
    ("changes", "error", "known"),
    [
        ({}, 0.05, True),
        ({}, 0.15, False),
        ({"misses": True}, 0.05, False),
        ({"twist": 13.0}, 0.05, True),
        ({"twist": 7.0}, 0.05, False),
        ({"twist": 0.0, "missing": True}, 0.05, True),
        ({"twist": 0.0, "blue": True}, 0.05, True),
        ({"twist": 0.0}, 0.05, False),
        ({"heard": True, "blue": True}, 0.05, False),
        ({"told": True}, 0.05, False),
        ({"told": True, "blue": True}, 0.05, True),
    ],
)
def test_a_law_of_other_readings_is_known_within_bounds(
    monkeypatch: pytest.MonkeyPatch, changes: dict[str, Any], error: float, known: bool
) -> None:
    """`missing`: counts of the log are not in the force; `blue`: others are; `told`: by the set motion."""
    given = {"misses": False, "twist": 100.0, "missing": False, "blue": False, "heard": False, "told": None} | changes
    fitted = Fitted(Structure(CASCADE_FAMILY, True, 1, 0, twist=Twist(1e-5)), np.array([3e5, 5e3, 9e3]), 20.0, 1.0)
    reading, wanted = Stand(missing=given["missing"], heard=given["heard"]), Stand(missing=False)
    other: Any = Stand(
        best=Stand(fitted=fitted, structure=fitted.structure),
        misses=given["misses"],
        twist=lambda _: given["twist"],
        counts=(reading, wanted),
        told=given["told"],
    )
    covariance = np.diag((error * np.append(fitted.values, fitted.rate)) ** 2)
    monkeypatch.setattr(law_other_readings, "covariance_of", lambda *_: covariance)
    floor: Any = Stand(blue=given["blue"])
    assert _known(other, floor) is known


@pytest.mark.parametrize(("together", "known"), [(True, True), (False, False)])
def test_a_law_whose_loops_are_equally_fast_is_known_by_their_sum(
    monkeypatch: pytest.MonkeyPatch, together: bool, known: bool
) -> None:
    """Kv and 1/Tn of 20 1/s, each 10 1/s off: their sum is known if one is more where the other is less."""
    fitted = Fitted(Structure(CASCADE_FAMILY, True, 1, 0, forward="one"), np.array([1.8e5, 9e3]), 20.0, 1.0)
    off = np.array([9e4, 0.0, -10.0 if together else 10.0])
    covariance = np.outer(off, off) + np.diag([1e4, 1e4, 1e-2])
    monkeypatch.setattr(law_other_readings, "covariance_of", lambda *_: covariance)
    counts = (Stand(missing=True, heard=False), Stand(missing=False))
    other: Any = Stand(best=Stand(fitted=fitted), misses=False, counts=counts, told=None)
    floor: Any = Stand(blue=False)
    assert _known(other, floor) is known


@pytest.mark.parametrize(
    ("added", "extra", "free", "law", "near_"),
    [
        (0.1, 0.0, 0.1, True, False),
        (0.2, 0.0, 0.1, False, False),
        (0.0, 0.015, 0.1, False, True),
        (0.0, 0.025, 0.1, False, False),
        (0.1, 0.0, 0.3, True, False),
        (0.1, 0.0, 0.4, False, False),
    ],
)
def test_a_law_adds_little_memory_and_little_force(
    monkeypatch: pytest.MonkeyPatch, added: float, extra: float, free: float, law: bool, near_: bool
) -> None:
    """`extra`: of the force, beyond what the free law leaves (`free`); more than nothing misses something here."""
    fitted = Stand(ssr=1.0 + 1e4 * extra**2)
    floor = Stand(ssr=1.0, power=1e4, memory=0.5, price=10.0, left=free, misses=lambda _: extra > 0.0)
    rows = Stand(force=np.zeros(2000))
    best = Stand(fitted=fitted, criterion=5.0)
    found: Any = Stand(best=best, floor=floor, rows=rows, residual=lambda _: None, deep=True)
    monkeypatch.setattr(law_search, "correlation", lambda _: 0.5 + added)
    monkeypatch.setattr(law_search, "nonlinear", lambda *_: -1.0)
    monkeypatch.setattr(law_search, "slower", lambda *_: -1.0)
    monkeypatch.setattr(law_other_readings, "differs", lambda *_: 0.0)
    monkeypatch.setattr(identify_law, "_other", lambda *_: None)
    monkeypatch.setattr(identify_law, "_rows", lambda *_: None)
    verdict, _ = _judged(found, None)
    assert (verdict.law, verdict.near) == (law, near_)


@pytest.mark.parametrize(("excess", "rows", "law"), [(0.1, 1200, True), (0.2, 1200, False), (0.1, 800, False)])
def test_a_law_leaves_little_more_than_the_free_law(
    monkeypatch: pytest.MonkeyPatch, excess: float, rows: int, law: bool
) -> None:
    """With few independent rows chance explains much, but not a seventh of what is left; 20 rows for an unknown."""
    floor = Stand(ssr=1.0, power=1e4, memory=0.5, price=10.0, left=0.01, misses=lambda _: False)
    found: Any = Stand(
        best=Stand(fitted=Stand(ssr=1.0 + excess), criterion=5.0),
        floor=floor,
        rows=Stand(force=np.zeros(rows)),
        residual=lambda _: None,
        deep=True,
    )
    monkeypatch.setattr(law_search, "correlation", lambda _: 0.5)
    monkeypatch.setattr(law_search, "nonlinear", lambda *_: -1.0)
    monkeypatch.setattr(law_search, "slower", lambda *_: -1.0)
    monkeypatch.setattr(law_other_readings, "differs", lambda *_: 0.0)
    monkeypatch.setattr(identify_law, "_other", lambda *_: None)
    monkeypatch.setattr(identify_law, "_rows", lambda *_: None)
    assert _judged(found, None)[0].law is law


@pytest.mark.parametrize(("differs", "ahead", "law"), [(10.0, 10.0, True), (20.0, 10.0, False), (10.0, 20.0, False)])
def test_a_law_gives_way_to_one_of_other_readings_that_leaves_less_of_the_slow_rows(
    monkeypatch: pytest.MonkeyPatch, differs: float, ahead: float, law: bool
) -> None:
    floor = Stand(ssr=1.0, power=1e4, memory=0.5, price=10.0, left=0.01, misses=lambda _: False)
    best, other = Stand(fitted=Stand(ssr=1.0), criterion=5.0), Stand(ahead=lambda _: ahead)
    found: Any = Stand(best=best, floor=floor, rows=Stand(force=np.zeros(1200)), residual=lambda _: None, deep=True)
    monkeypatch.setattr(law_search, "correlation", lambda _: 0.5)
    monkeypatch.setattr(law_search, "nonlinear", lambda *_: -1.0)
    monkeypatch.setattr(law_search, "slower", lambda *_: -1.0)
    monkeypatch.setattr(law_other_readings, "differs", lambda *_: differs)
    monkeypatch.setattr(identify_law, "_other", lambda *_: other)
    monkeypatch.setattr(identify_law, "_rows", lambda *_: None)
    verdict, _ = _judged(found, None)
    assert verdict.law is law
    assert (verdict.other is other) is not law


def test_a_force_that_no_law_of_the_signals_explains_has_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the free law leaves most of the force, a law that leaves as much is no evidence of one."""
    place = "feeddrive.identification.motion.identify_law"
    monkeypatch.setattr(f"{place}.Signals", Stand(of=lambda _: None))
    monkeypatch.setattr(f"{place}._searched", lambda *_: Stand(floor=Stand(left=0.8)))
    silent = Stand(law=False, near=False, silent=True, other=None)
    monkeypatch.setattr(f"{place}._judged", lambda found, _: (silent, found))
    log: Any = Stand(name="log", set_position=np.zeros(3), force_limit=None)
    with pytest.raises(NotIdentifiableError, match="even a free linear law"):
        identify_control(log)

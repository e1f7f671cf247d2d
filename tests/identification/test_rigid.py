"""A rigid drive from a log: errors that cover the truth, and answers where the log holds none."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from math import erf
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from drive_logs import TRUTH, T, changed, loop, set_positions, simulated
from feeddrive.blocks.force.gravity import Gravity
from feeddrive.identification.motion.identify import identify_motion, with_rigid
from feeddrive.identification.motion.identify_law import identify_control
from feeddrive.identification.motion.motion_log import (
    HOLD,
    JANOT,
    MotionLog,
    Preparation,
    central_difference,
    decimated,
    kept,
    prepare,
    zero_phase,
)
from feeddrive.identification.motion.output_error import refine
from feeddrive.identification.motion.rigid import (
    DelayFit,
    RigidFit,
    _check,
    _check_drift,
    _solve,
    _Solved,
    _with_counts,
    check_columns,
    check_mass,
    check_motion,
    columns_of,
    covariance_of,
    find_delay,
    identify_rigid,
)
from feeddrive.identification.plausibility import sizes
from feeddrive.identification.regression import (
    TABLE,
    Estimate,
    Residuals,
    cross_validated,
    errors,
    ols_covariance,
    pulls,
    robust_covariance,
    scores_of,
)
from feeddrive.language import tree
from feeddrive.language.errors import LogError, NotIdentifiableError, ParameterError

RUNS = 80


@cache
def fitted(memory: float) -> tuple[RigidFit, ...]:
    return tuple(identify_rigid(simulated(memory=memory, seed=seed), friction="symmetric") for seed in range(RUNS))


def covered(memory: float, which: str) -> dict[str, float]:
    """Share of simulated logs whose 95 % interval holds the truth."""
    hits = dict.fromkeys(TRUTH, 0)
    for fit in fitted(memory):
        for name, value in TRUTH.items():
            hits[name] += abs(fit[name].value - value) < 1.96 * getattr(fit[name], which)
    return {name: count / RUNS for name, count in hits.items()}


@pytest.mark.slow(reason="80 logs are simulated and fitted for each memory")
@pytest.mark.parametrize("memory", [0.005, 0.05])
def test_intervals_cover_the_truth_where_the_residual_has_a_memory(memory: float) -> None:
    """95 % is meant; of 80 logs 95 % give 0.95 ± 0.024, so that 0.87 is more than three errors below."""
    for name, share in covered(memory, "error").items():
        assert share >= 0.87, (name, share)


def test_errors_that_assume_a_white_residual_do_not_cover() -> None:
    """With a memory of 50 ms and rows each 10 ms they are too small by (1 + rho) / (1 - rho) = 10 in their squares."""
    assert max(covered(0.05, "ols").values()) < 0.85


def test_robust_errors_are_those_of_a_white_residual_where_it_is_white() -> None:
    rng = np.random.default_rng(3)
    columns = np.column_stack([np.ones(4000), np.sin(np.arange(4000) / 90.0)])
    residual = rng.standard_normal(4000)
    residual -= columns @ np.linalg.lstsq(columns, residual, rcond=None)[0]
    # a standard error of a standard error is 1/√(2n) = 1 %, and more with the lags that are summed for nothing
    ratio = errors(robust_covariance(columns, residual)) / errors(ols_covariance(columns, residual))
    np.testing.assert_allclose(ratio, 1.0, atol=0.08)


def test_robust_errors_of_a_mean_are_those_of_the_process() -> None:
    """The mean of r(k) = rho r(k-1) + e has the variance s_e² / (n (1 - rho)²)."""
    rng, rho, n = np.random.default_rng(4), 0.8, 5000
    found = []
    for _ in range(40):
        r = np.zeros(n)
        e = rng.standard_normal(n)
        for k in range(1, n):
            r[k] = rho * r[k - 1] + e[k]
        found.append(errors(robust_covariance(np.ones((n, 1)), r - r.mean()))[0])
    # 40 estimates of about 100 free periods each: 2 % by chance; the Bartlett window takes off and widening adds some
    assert np.mean(found) == pytest.approx(1.0 / ((1.0 - rho) * np.sqrt(n)), rel=0.08)


def test_a_sine_passes_the_filter_in_phase_and_half_at_its_cutoff() -> None:
    t = np.arange(4000) * T
    sine = np.sin(2.0 * np.pi * 100.0 * t)
    passed = zero_phase(sine, 100.0, T)
    # within rounding of the transform: far from both ends only
    np.testing.assert_allclose(passed[1000:3000], 0.5 * sine[1000:3000], atol=1e-6)
    slope = central_difference(np.sin(2.0 * np.pi * 5.0 * t), T)[1:-1]
    exact = 2.0 * np.pi * 5.0 * np.cos(2.0 * np.pi * 5.0 * t)[1:-1]
    # sin(w T) / w T of a central difference
    np.testing.assert_allclose(slope, exact * np.sinc(2.0 * 5.0 * T), atol=1e-9)


def test_decimation_keeps_the_last_sample_and_slow_signals() -> None:
    assert kept(24792, 10)[-1] == 24791
    assert kept(24792, 10).size == 2480
    slow = np.sin(2.0 * np.pi * 2.0 * np.arange(5000) * T)
    # the ripple of 0.05 dB, forth and back, at 0 Hz: an even Chebyshev filter starts at its low edge
    inner = slice(50, -50)
    gain = 10.0 ** (-0.1 / 20.0)
    np.testing.assert_allclose(decimated(slow, 10)[inner], gain * slow[kept(5000, 10)][inner], atol=2e-3)
    assert decimated(slow, 1) is slow


def test_a_dead_time_is_found_by_its_samples() -> None:
    for samples in (0, 1, 3):
        found = find_delay(simulated(size=0.5, dead_samples=samples), friction="symmetric")
        assert found.nearest == samples
        # reversals and the low pass leave a tenth of a sample
        assert found.dead_time == pytest.approx(samples, abs=0.15)


@pytest.mark.parametrize("samples", [0, 3])
def test_the_closed_loop_tells_the_delay_where_a_disturbance_hides_it(samples: int) -> None:
    """3 N of unknown force are 6 % of the force: the inverse dynamics are off by a sample in some of such logs."""
    found = identify_motion(simulated(size=3.0, seed=5, dead_samples=samples))
    assert found.refinement is not None
    control = found.control
    assert control is not None
    assert found.refinement.delay == samples
    assert control.delay == 0  # what the law adds to the dead time of the axis


def test_the_gains_that_ran_are_found() -> None:
    fit = identify_control(simulated())
    law = loop().control.law
    # only the counts of 50 nm in the reading and the order of rounding differ: the loop itself is without noise
    assert (fit.velocity_samples, fit.delay) == (2, 0)
    assert fit["Kv"].value == pytest.approx(float(law.Kv), rel=1e-6)  # type: ignore[attr-defined]
    assert fit["Kp"].value == pytest.approx(float(law.Kp), rel=1e-6)  # type: ignore[attr-defined]
    assert fit.law().velocity_feedforward == 0.0


def test_output_error_finds_the_truth_from_a_wrong_start() -> None:
    log = simulated(size=0.2)
    start = tree.vary(loop(), {"axis.x.plant.mass": 70.0, "axis.x.friction_load.coulomb": 30.0})
    found = refine(start, log, delays=(0, 1))
    assert found.delay == 0
    for name, truth in (("mass", 95.1089), ("coulomb", 20.3935), ("viscous", 203.5034), ("force", 3.1648)):
        # four errors: one in 16,000 of normal ones, times four parameters
        assert abs(found[name].value - truth) < 4.0 * found[name].error, name
    assert found["mass"].value == pytest.approx(95.1089, rel=2e-3)


@pytest.mark.parametrize(
    ("offset", "size", "has"),
    [(-3.16, 0.2, True), (3.16, 0.2, True), (0.5, 0.05, False), (0.0, 0.2, False), (2.0, 12.0, False)],
)
def test_an_offset_is_a_constant_force_if_it_is_significant_and_matters(offset: float, size: float, has: bool) -> None:
    """Any offset was one, and exports then warned of a falling axis.

    Of 20 N of Coulomb friction 5 % are 1.02 N: 0.5 N is significant and does not matter; 2 N beside a disturbance of
    12 N, whose standard error is about 1 N, is the other way round.
    """
    log = simulated(size=size)
    fit = identify_rigid(changed(log, force=log.force + offset - TRUTH["offset"]), friction="symmetric")
    found, bound = fit["offset"], 0.05 * fit["coulomb"].value
    if offset == 0.5:
        assert 3.0 * found.error < abs(found.value) < bound
    if size == 12.0:
        assert bound < abs(found.value) < 3.0 * found.error
    bare = replace(loop().axis, forces=())
    written = [float(each.force) for each in with_rigid(bare, fit).forces if isinstance(each, Gravity)]
    assert written == ([-found.value] if has else [])
    # an axis that has one keeps it, with the new number
    assert [float(each.force) for each in with_rigid(loop().axis, fit).forces if isinstance(each, Gravity)] == [
        -found.value
    ]


def test_rotary_logs_come_out_at_the_table_with_a_lead() -> None:
    log, lead = simulated(), 0.01
    lever = lead / (2.0 * np.pi)
    shaft = changed(log, position=log.position / lever, force=log.force * lever, rotary=True, set_position=None)
    fit = identify_rigid(changed(log, set_position=None), friction="symmetric")
    rotary = identify_rigid(shaft, friction="symmetric")
    assert rotary["mass"].unit == "kg m2"
    with pytest.raises(ParameterError, match=r"at_table\(lead"):
        rotary.plant()
    table = rotary.at_table(lead)
    for name in TRUTH:
        # rounding moves the instants at which the resting axis seems to turn, and with them which rows are left out
        assert table[name].value == pytest.approx(fit[name].value, abs=0.01 * fit[name].error)
        assert table[name].error == pytest.approx(fit[name].error, rel=0.1)
    assert float(table.plant().mass) == table["mass"].value


def test_unused_stretches_are_predicted_as_well_as_used_ones() -> None:
    fit = identify_rigid(simulated(), friction="symmetric")
    assert fit.validation.relative == pytest.approx(fit.residuals.relative, rel=0.2)
    assert fit.validation.values.shape == (5, 4)


def one_way(log: MotionLog) -> MotionLog:
    rising = int(np.argmax(log.position))
    return changed(log, position=log.position[:rising], force=log.force[:rising], set_position=None)


def constant_speed() -> MotionLog:
    """Back and forth at one speed; the turns are cut out and the pieces joined."""
    t = np.arange(8000) * T
    v = np.where(np.sin(2.0 * np.pi * t / 4.0) > 0.0, 0.05, -0.05)
    rng = np.random.default_rng(1)
    x = np.concatenate([[0.0], np.cumsum(v)[:-1]]) * T
    return MotionLog(
        name="constant",
        position=x + 1e-9 * rng.standard_normal(t.size),
        force=20.0 * np.sign(v) + 200.0 * v + rng.standard_normal(t.size),
        sample_time=T,
    )


def test_what_a_log_cannot_tell_is_said_with_what_to_measure_next() -> None:
    log = simulated()
    with pytest.raises(NotIdentifiableError, match=r"towards smaller positions.*to and fro"):
        identify_rigid(one_way(log))
    with pytest.raises(NotIdentifiableError, match=r"viscous is not identifiable.*record next moves at three speeds"):
        identify_rigid(constant_speed())
    limited = np.clip(log.force, -0.5 * np.max(log.force), 0.5 * np.max(log.force))
    with pytest.raises(NotIdentifiableError, match=r"saturated.*lower acceleration"):
        changed(log, force=limited)
    with pytest.raises(NotIdentifiableError, match=r"'force' is 3 in all rows"):
        changed(log, force=np.full(log.force.size, 3.0))
    broken = log.force.copy()
    broken[17] = np.nan
    with pytest.raises(LogError, match=r"'force' is nan at row 18"):
        changed(log, force=broken)


@pytest.mark.parametrize("shift", [-9, 12])
def test_channels_on_two_clocks_are_named(shift: int) -> None:
    log = simulated(size=0.5)
    with pytest.raises(NotIdentifiableError, match=r"not synchronised.*one recorder"):
        find_delay(changed(log, force=np.roll(log.force, shift)))


def test_channels_whose_clocks_drift_are_named() -> None:
    log = simulated(size=0.5)
    k = np.arange(log.force.size)
    slow = np.interp(k * (1.0 + 6.0 / k.size) - 3.0, k, log.force)
    with pytest.raises(NotIdentifiableError, match=r"not on one clock"):
        find_delay(changed(log, force=slow))


def test_a_force_at_its_own_sample_spoils_the_viscous_friction() -> None:
    """In a loop with little disturbance the published half sample is seen in the viscous friction, ours is not."""
    log = simulated(size=0.05)
    ours, published = (identify_rigid(log, friction="symmetric", how=how) for how in (None, JANOT))
    assert abs(ours["viscous"].value - TRUTH["viscous"]) < 0.5 * abs(published["viscous"].value - TRUTH["viscous"])


def test_a_log_of_channels_is_refused_with_how_to_make_a_motion_of_it() -> None:
    class Log:
        sample_time = T

    for take in (identify_motion, identify_rigid, find_delay):
        with pytest.raises(ParameterError, match=r"takes a MotionLog, not a Log: MotionLog\(name=log\.name, position="):
            take(Log())  # type: ignore[arg-type]


def test_rows_are_needed() -> None:
    few = set_positions()[500:550]
    with pytest.raises(LogError, match="at least 100"):
        MotionLog(name="short", position=few, force=few + 1.0, sample_time=T)


# ---------------------------------------------------------------- what decides: a case on either side of each bound


@pytest.mark.parametrize(("back", "enough"), [(0.035, False), (0.08, True)])
def test_a_twentieth_of_the_motion_goes_back(back: float, enough: bool) -> None:
    velocity = np.where(np.arange(1000) < 1000 * back, -0.1, 0.1)
    if enough:
        check_motion("log", velocity, TABLE)
        return
    with pytest.raises(NotIdentifiableError, match="of the motion goes towards"):
        check_motion("log", velocity, TABLE)


@pytest.mark.parametrize(("share", "enough"), [(0.014, False), (0.03, True)])
def test_a_fiftieth_of_a_column_is_independent_of_the_others(share: float, enough: bool) -> None:
    wave = 2.0 * np.pi * np.arange(100) / 100.0
    columns = np.column_stack([np.sin(wave), np.sin(wave) + share * np.cos(wave)])
    if enough:
        check_columns("log", columns, ("mass", "viscous"))
        return
    with pytest.raises(NotIdentifiableError, match="mass is not identifiable"):
        check_columns("log", columns, ("mass", "viscous"))


@pytest.mark.parametrize(("error", "enough"), [(0.35, True), (0.7, False)])
def test_a_mass_is_known_to_a_half(error: float, enough: bool) -> None:
    if enough:
        check_mass("log", 100.0, 100.0 * error, "kg")
        return
    with pytest.raises(NotIdentifiableError, match="mass is not identifiable"):
        check_mass("log", 100.0, 100.0 * error, "kg")


DELAYS = np.arange(-30, 31)


def valley(best: int) -> np.ndarray:
    """Relative residuals with their minimum at a delay, rising to both sides."""
    return 0.1 + 0.02 * np.abs(DELAYS - best)


@pytest.mark.parametrize(
    ("best", "T", "said"),
    [
        (4, 1e-3, ""),
        (7, 1e-3, "7 samples"),
        (-4, 2e-4, ""),
        (-7, 2e-4, "7 samples before"),
        (20, 1e-4, "20 samples"),
    ],
)
def test_a_force_acts_from_1_ms_before_to_5_ms_after_it_was_logged(best: int, T: float, said: str) -> None:
    """The last delay that is tried, 20 samples, tells nothing: the minimum may be beyond it."""
    log: Any = SimpleNamespace(name="log", sample_time=T, set_position=None)
    if not said:
        _check(log, best, DELAYS, valley(best))
        return
    with pytest.raises(NotIdentifiableError, match=f"not synchronised.*{said}"):
        _check(log, best, DELAYS, valley(best))


@pytest.mark.parametrize(("left", "clear"), [(0.85, True), (0.95, False)])
def test_a_delay_is_clear_if_it_leaves_a_tenth_less(left: float, clear: bool) -> None:
    fit = DelayFit("log", 1.0, 0.1, np.array([0, 1]), np.array([1.0, left]), 1e-3)
    assert fit.clear is clear


@pytest.mark.parametrize(("later", "drifts"), [(1, False), (3, True)])
def test_delays_of_both_halves_that_differ_by_two_samples_drift(later: int, drifts: bool) -> None:
    """White columns: at any other delay the residual is that of no fit at all."""
    column = np.random.default_rng(1).standard_normal(2000)
    delays = np.arange(-5, 6)
    force = np.concatenate([column[:1000], np.roll(column, -later)[1000:]])
    forces = np.array([np.roll(force, d) for d in delays])
    log: Any = SimpleNamespace(name="log", sample_time=1e-3)
    found = (log, column[:, None], forces, delays, None)
    _check_drift(*found, lambda _, delay: (float(delay), 0.8))
    if not drifts:
        _check_drift(*found, lambda _, delay: (float(delay), 0.01))
        return
    with pytest.raises(NotIdentifiableError, match="not on one clock"):
        # 3 samples are more than 4 joint errors of 0.5 samples, and less than 4 of 0.8
        _check_drift(*found, lambda _, delay: (float(delay), 0.5))


def test_delays_of_20_samples_to_both_sides_are_tried() -> None:
    delays = find_delay(simulated(seed=1)).delays
    assert (delays[0], delays[-1]) == (-20, 20)


def test_a_part_of_a_log_whose_delay_has_no_minimum_nearby_is_fitted_at_the_delay_of_the_caller() -> None:
    """The force acts 24 samples late: from 19 the steps lead beyond the 20 that are tried."""
    log = simulated(size=0.5)
    late = changed(log, force=np.roll(log.force, -24))
    rows = prepare(late, Preparation())
    columns = columns_of(rows, "directional")
    half = slice(rows.time.size // 2, None)
    solved = _solve(late, rows, columns, HOLD + 19.0, free=True, instruments=columns, used=half)
    assert not solved.free
    assert solved.delay == HOLD + 19.0
    assert solved.residual.size == rows.time.size - rows.time.size // 2


def test_an_interval_holds_95_percent_of_normal_errors() -> None:
    low, high = Estimate("x", 0.0, "", 1.0, 1.0).interval
    assert erf(high / np.sqrt(2.0)) == pytest.approx(0.95, abs=1e-9)
    assert low == -high


@pytest.mark.parametrize(("away", "counts"), [(3, False), (8, True)])
def test_five_rows_beside_a_stretch_are_in_no_fit_of_the_others(away: int, counts: bool) -> None:
    measured = np.zeros(200)
    measured[50 + away - 1] = 1.0  # behind the first of four stretches
    mean = cross_validated(np.ones((200, 1)), measured + 1e-9, 4, "N").values[0, 0]
    assert bool(mean > 1e-3) is counts


@pytest.mark.parametrize(
    ("used", "unused", "changed"),
    [(0.01, 0.019, False), (0.01, 0.021, True), (0.02, 0.029, False), (0.02, 0.031, True), (0.001, 0.012, False)],
)
def test_an_axis_changes_along_a_log_by_half_and_two_percent_of_the_force(
    used: float, unused: float, changed: bool
) -> None:
    """Errors on stretches that were used and that were not, as shares of the force."""
    fit = identify_rigid(simulated(), friction="symmetric")
    residuals = replace(fit.residuals, values=used * fit.residuals.measured)
    made = replace(fit, residuals=residuals, validation=replace(fit.validation, relative=unused, expected=0.0))
    assert replace(made, counts=(0.0, 0.0)).changed is changed


def test_scores_of_more_than_5000_rows_are_summed() -> None:
    def rows(n: int) -> int:
        return scores_of(np.ones((1, n, 1)), np.sin(np.arange(float(n)))[None]).shape[0]

    assert rows(4000) == 4000
    assert rows(8000) == 4000


@pytest.mark.parametrize(("seconds", "what", "value"), [(5e-3, "speed", 0.2), (1e-2, "acceleration", 10.0)])
def test_magnitudes_are_differences_over_5_and_10_ms(seconds: float, what: str, value: float) -> None:
    """A position that jumps by a millimeter: 1 mm in 5 ms, and 1 mm in (10 ms)²."""
    position = np.where(np.arange(200) < 100, 0.0, 1e-3)
    assert value == pytest.approx(1e-3 / seconds ** (1 if what == "speed" else 2))
    assert sizes(TABLE, 1e-3, position, None)[what] == pytest.approx(value)


def test_a_residual_names_five_lags() -> None:
    table = Residuals(np.sin(np.arange(100.0)), np.ones(100), 1.0, "N").table()
    lags = [str(row[0]) for row in table.rows if "lag" in str(row[0])]
    assert lags == [f"autocorrelation at lag {lag}" for lag in (1, 2, 5, 10, 20)]


def test_a_residual_that_hardly_changes_widens_no_error_without_end() -> None:
    """A correlation of 1 - 5e-6 from row to row: taken out as it is, the error would grow by n/π."""
    n = 2000
    slow = np.sin(2.0 * np.pi * np.arange(n) / n + 0.3)
    columns = np.ones((n, 1))
    wider = np.sqrt(covariance_of(columns, slow)[0, 0] / robust_covariance(columns, slow)[0, 0])
    assert wider < 3.0


def test_counts_are_drawn_four_times() -> None:
    drawn: list[float] = []

    def differenced(readings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        drawn.append(float(np.max(np.abs(readings))))
        return np.zeros(100), np.zeros(100)

    wave = np.arange(100.0)
    columns = np.column_stack([np.sin(wave), np.cos(wave), np.sin(2.0 * wave), np.cos(2.0 * wave)])
    log: Any = SimpleNamespace(position=1e-6 * np.arange(100.0), sample_time=1e-3)
    rows: Any = SimpleNamespace(velocity=np.ones(100), differenced=differenced, reduced=lambda values: values)
    solved = _Solved(np.ones(4), 0.5, columns, columns, np.ones(100), free=False, instrumented=False)
    _with_counts(log, rows, np.ones(100, bool), solved, ("mass", "viscous", "coulomb", "offset"))
    assert len(drawn) == 4
    assert max(drawn) <= 0.5e-6


def test_errors_are_not_smaller_than_those_of_the_process_that_made_the_residual() -> None:
    """A first-order process of memory r and steps s: the mean of n rows has the variance s²/(n (1 - r)²)."""
    shares = []
    for seed in range(15):
        residual = lfilter([1.0], [1.0, -0.9], np.random.default_rng(seed).standard_normal(1500))[500:]
        memory = float(residual[1:] @ residual[:-1] / (residual @ residual))
        steps = residual[1:] - memory * residual[:-1]
        variance = float(steps @ steps) / (1000.0 * (1.0 - memory)) ** 2
        shares.append(covariance_of(np.ones((1000, 1)), residual)[0, 0] / variance)
    assert min(shares) > 0.97


@pytest.mark.parametrize(
    ("error", "coulomb", "pulled"), [(0.45, 0.0, False), (0.25, 0.0, True), (0.0, 30.0, False), (0.0, 14.0, True)]
)
def test_an_offset_of_three_errors_and_5_percent_of_the_friction_is_a_force(
    error: float, coulomb: float, pulled: bool
) -> None:
    assert pulls(Estimate("offset", 1.0, "N", error, error), coulomb) is pulled

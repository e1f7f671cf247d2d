"""Output error on readings that stand on coarse counts: values without bias, errors that cover the truth."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.special import stdtrit

import feeddrive as fd
from drive_logs import disturbance
from feeddrive.blocks.load.recorded_force import RecordedForce
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.identification.motion.motion_log import MotionLog, at_rest, count_of
from feeddrive.identification.motion.output_error import _Fit, _Weighed, _with_counts, refine
from feeddrive.identification.regression import long_run
from feeddrive.language import tree
from feeddrive.loop.simulate import simulate

T = 1e-3
TRUTH = {"mass": 620.0, "coulomb": 420.0, "viscous": 1500.0}


def axis_loop(count: float, reset: bool) -> fd.Loop:
    """A heavy axis under P-PI with or without reset time, and an encoder of such counts."""
    law = fd.blocks.CascadePPI(Kv=15.0, Kp=620.0 * 60.0, Tn=0.05 if reset else None)
    axis = fd.Axis(
        plant=fd.blocks.Rigid(mass=TRUTH["mass"]),
        friction_load=fd.blocks.Coulomb(coulomb=TRUTH["coulomb"], viscous=TRUTH["viscous"]),
        encoder_load=fd.blocks.Encoder(resolution=count),
    )
    return fd.Loop(control=fd.Control(law=law), axis=axis, sample_time=T)


def with_dwells(seed: int, count: float, reset: bool, force: float) -> MotionLog:
    """Three strokes to and fro with dwells of 0.6 s, begun anywhere within a count; an unknown force of `force` N."""
    random = np.random.default_rng(seed)
    start = random.uniform(-0.01, 0.01)
    parts: list[np.ndarray] = []
    for speed in (0.2, 0.05, 0.1):
        move = SnapLimitedMove(
            start=start,
            distance=0.75 * speed * random.uniform(0.9, 1.1),
            velocity=speed,
            acceleration=2.0,
            jerk=50.0,
            snap=3000.0,
            back=True,
            dwell_before=0.3,
            dwell_between=0.6,
            dwell_after=0.3,
        )
        parts.append(np.asarray(move.at(np.arange(round(move.duration / T)) * T).position))
    reference = np.concatenate(parts)
    run = simulate(
        axis_loop(count, reset),
        Recorded(position=reference, sample_time=T),
        load=RecordedForce(force=disturbance(force, 0.02, reference.size, seed), sample_time=T),
        record=("force", "reading_load"),
    )
    rows = reference.size
    return MotionLog(
        name="counts",
        position=run["reading_load"][:rows],
        force=run["force"][:rows],
        set_position=reference,
        sample_time=T,
    )


def off(log: MotionLog, count: float, reset: bool) -> dict[str, float]:
    """Value less truth, in standard errors, by name."""
    found = refine(tree.vary(axis_loop(count, reset), {"axis.x.friction_load.coulomb": 300.0}), log, delays=[0])
    return {name: (found[name].value - truth) / found[name].error for name, truth in TRUTH.items()}


def test_a_coarse_count_biases_no_value_beyond_its_error() -> None:
    """Without the runs with counts friction is 4.3 of its errors off here; 3 are a normal error's rarity."""
    log = with_dwells(6, 20e-6, reset=True, force=0.0)
    assert max(abs(each) for each in off(log, 20e-6, reset=True).values()) < 3.0


def test_fine_counts_leave_the_fit_as_it_is() -> None:
    log = with_dwells(3, 1e-8, reset=False, force=4.0)
    assert refine(axis_loop(1e-8, False), log, delays=[0]).count == 0.0


@pytest.mark.timeout(1200)
@pytest.mark.slow(reason="60 logs of a count take a minute: 17 runs of each log, drawn six times")
@pytest.mark.parametrize("count", [1e-6, 5e-6, 20e-6])
def test_errors_cover_the_truth_with_counts_and_dwells(count: float) -> None:
    """Share of 95 % intervals that hold the truth, over 60 logs, every other one with a reset time.

    With 95 % held each, fewer than 53 of 60 have a chance of 1 %; measured were 56 to 59. Wider than the truth by half
    is no error either.
    """
    z = [list(off(with_dwells(seed, count, seed % 2 == 0, 4.0), count, seed % 2 == 0).values()) for seed in range(60)]
    held = np.mean(np.abs(z) < 1.96, axis=0)
    assert np.all(held >= 0.87), (count, held)
    assert np.all(np.sqrt(np.mean(np.square(z), axis=0)) > 0.5), (count, held)


@pytest.mark.parametrize("count", [1e-6, 2.5e-6, 20e-6])
def test_a_count_is_found_from_the_readings(count: float) -> None:
    """To 1e-6 of itself, also from readings in single precision, and with counts that never occur."""
    random = np.random.default_rng(1)
    readings = count * np.round(random.uniform(-500.0, 900.0, 4000)) + 0.37 * count
    assert count_of(readings) == pytest.approx(count, rel=1e-6)
    assert count_of(readings.astype(np.float32).astype(float)) == pytest.approx(count, rel=1e-3)
    assert count_of(random.normal(0.0, 0.01, 4000)) == 0.0
    assert count_of(np.zeros(100)) == 0.0


def test_an_axis_rests_when_its_setpoint_has_stood() -> None:
    """30 ms after the last change, until the next; a log that begins at rest has begun to stand with its first row."""
    log = with_dwells(1, 1e-6, reset=False, force=0.0)
    assert log.set_position is not None
    rest = at_rest(log, 0)
    stands = np.diff(log.set_position, prepend=np.nan) == 0.0
    assert np.all(stands[rest])
    assert not np.any(rest[:30])
    assert np.all(rest[60:200])


# ---------------------------------------------------------------- what decides: a case on either side of each bound

MODULE = "feeddrive.identification.motion.output_error"
ANY: Any = None


@pytest.mark.parametrize(("improves", "delays"), [(False, [0, 1]), (True, list(range(11)))])
def test_delays_of_0_and_1_samples_are_tried_and_up_to_10_as_long_as_they_are_better(
    monkeypatch: pytest.MonkeyPatch, improves: bool, delays: list[int]
) -> None:
    left = iter(np.arange(100.0)[::-1] if improves else np.arange(100.0))
    monkeypatch.setattr(f"{MODULE}._fitted", lambda loop, *_: _Fit(loop, float(next(left)), (), 1))
    monkeypatch.setattr(f"{MODULE}.replay", lambda *_, **__: ANY)
    log = with_dwells(1, 1e-6, reset=False, force=0.0)
    assert list(refine(axis_loop(1e-6, False), log, ()).by_delay) == delays


def weighed(monkeypatch: pytest.MonkeyPatch, scatter: float, moving: int) -> np.ndarray:
    """The scale of position and force in a fit of one parameter, whose residual is 1, with runs of such a variance."""
    runs = np.sqrt(scatter) * np.array([1.0, -1.0, 1.0, -1.0])[:, None, None] * np.sqrt(0.75) * np.ones((4, 2, 400))
    rest = np.arange(400) >= moving
    monkeypatch.setattr(f"{MODULE}.drawn", lambda *_: runs)
    monkeypatch.setattr(f"{MODULE}.at_rest", lambda *_: rest)
    monkeypatch.setattr(f"{MODULE}._signals", lambda *_: np.zeros((2, 400)))
    monkeypatch.setattr(f"{MODULE}._columns", lambda *_: np.ones((2, 400, 1)))
    log: Any = SimpleNamespace(position=np.ones(400), force=np.ones(400))
    return _Weighed.of(ANY, log, ("mass",), 0, 1e-6).scale


@pytest.mark.parametrize(("scatter", "variance"), [(0.3, 1.0), (0.8, 0.5 + 0.8)])
def test_half_of_the_residual_at_least_is_not_that_of_counts(
    monkeypatch: pytest.MonkeyPatch, scatter: float, variance: float
) -> None:
    """What counts make is taken off the residual of 1 and added where it is, row by row."""
    assert weighed(monkeypatch, scatter, 400)[0, 100] ** 2 == pytest.approx(variance)


@pytest.mark.parametrize(("moving", "rest_counts"), [(7, True), (14, False)])
def test_rows_at_rest_count_if_fewer_than_ten_move_for_a_parameter(
    monkeypatch: pytest.MonkeyPatch, moving: int, rest_counts: bool
) -> None:
    assert bool(np.isfinite(weighed(monkeypatch, 0.1, moving)[0, -1])) is rest_counts


def corrected(
    monkeypatch: pytest.MonkeyPatch, moves: float, left: np.ndarray | None = None, others: float = 0.0
) -> _Fit | None:
    """A fit of a mass to runs with counts that move it by some of its errors, with a weighted residual."""
    rows = 4000 if left is None else left.size
    residual = np.zeros(rows) if left is None else left
    both = np.array([residual, 0.0 * residual])
    columns = np.stack([np.ones((rows, 1)), np.zeros((rows, 1))])
    runs = {0: np.zeros((4, 2, rows)), 2: others * np.tile([1.0, -1.0], 8)[:, None, None] * np.ones((16, 2, rows))}
    monkeypatch.setattr(f"{MODULE}.count_of", lambda *_: 1e-6)
    monkeypatch.setattr(f"{MODULE}._signals", lambda *_: np.zeros((2, rows)))
    monkeypatch.setattr(f"{MODULE}.drawn", lambda *_, seed=2: runs[seed] + moves)
    monkeypatch.setattr(
        f"{MODULE}._Weighed.of", lambda *_: _Weighed(both, np.ones((2, rows)), columns, both, np.zeros(rows))
    )
    log: Any = SimpleNamespace(name="log", position=np.ones(rows), force=np.ones(rows))
    plain = axis_loop(1e-6, False)
    return _with_counts(plain, log, (f"{plain.place_of('axis')}.plant.mass",), 0, columns, np.ones(1))


@pytest.mark.parametrize(("moves", "matters"), [(0.07, False), (0.14, True)])
def test_counts_that_move_a_value_by_a_tenth_of_its_error_matter(
    monkeypatch: pytest.MonkeyPatch, moves: float, matters: bool
) -> None:
    """A run that is off by a constant moves the parameter whose column is 1 by it."""
    assert (corrected(monkeypatch, moves) is not None) is matters


def test_counts_are_corrected_three_times_and_sixteen_runs_widen_an_interval_by_student(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fit = corrected(monkeypatch, 1.0, others=2.0)
    assert fit is not None
    assert fit.steps == 3
    student = float(stdtrit(15, 0.975)) / 1.96
    # of sixteen runs that move the value by ±2, without any other residual
    assert fit.estimates[0].error == pytest.approx(student * np.sqrt(16 * 4.0 / 15), rel=1e-3)


def test_scores_are_summed_over_16_rows_to_see_how_long_they_hang_together(monkeypatch: pytest.MonkeyPatch) -> None:
    """A slow wave under noise that cancels over 16 rows is seen, under noise that cancels over 32 it is hidden."""
    rows = np.arange(4096)
    slow = np.sin(2.0 * np.pi * rows / 600)
    seen: list[int] = []

    def recorded(scores: np.ndarray, lags: int) -> np.ndarray:
        seen.append(lags)
        return long_run(scores, lags)

    monkeypatch.setattr("feeddrive.identification.regression.long_run", recorded)
    for period in (16, 32):
        size = 20.0 * np.random.default_rng(1).standard_normal(4096 // period)[rows // period]
        corrected(monkeypatch, 1.0, slow + size * np.where(rows % period < period // 2, 1.0, -1.0))
    assert seen[0] > 2 * seen[1]

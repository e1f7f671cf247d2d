"""Output error on readings that stand on coarse counts: values without bias, errors that cover the truth."""

from __future__ import annotations

import numpy as np
import pytest

import feeddrive as fd
from drive_logs import disturbance
from feeddrive.blocks.load.recorded_force import RecordedForce
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.identification.motion.motion_log import MotionLog, at_rest, count_of
from feeddrive.identification.motion.output_error import refine
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

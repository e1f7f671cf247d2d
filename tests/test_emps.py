"""The published EMPS axis against its measured log: the prediction that the whole tool rests on.

Source of parameters and data: Janot, Gautier, Brunot, Data Set and Reference Models of EMPS, 2019.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from feeddrive.analysis.replay import Replay, estimate_start, replay
from feeddrive.files.job import read_job
from feeddrive.files.machine import read_machine
from feeddrive.jobs.run_laws import run_laws
from feeddrive.language import tree

LOG = Path(__file__).parents[2] / "shared" / "data" / "emps" / "DATA_EMPS.mat"
needs_log = pytest.mark.skipif(not LOG.exists(), reason=f"NOT RUN: the measured log {LOG.name} is not in ../shared")


def predicted(machine: str) -> Replay:
    job = read_job("emps_log", LOG)
    row = run_laws(job).rows[0]
    assert row.replay is not None
    return replay(read_machine(machine).loop("x"), measured(row.replay), skip=49)


def measured(found: Replay) -> dict[str, np.ndarray]:
    position = found.measured["position_load"]
    return {
        "set_position": found.measured["following_error"] + position,
        "position_load": position,
        "force": found.measured["force"],
    }


@needs_log
@pytest.mark.parametrize(
    ("machine", "bar", "published"),
    [("emps", 1.3e-6, 1.23e-6), ("emps_symmetric", 1.7e-6, 1.62e-6)],
    ids=["direction-dependent", "symmetric"],
)
def test_the_measured_position_is_predicted(machine: str, bar: float, published: float) -> None:
    """RMS after 49 samples, in m: below the bar, and within 2 % of the figure found before with another program."""
    found = predicted(machine)
    assert found.rms("position_load") < bar
    # the other program handled the start in its own way, which moves the third digit
    assert found.rms("position_load") == pytest.approx(published, rel=0.02)


@needs_log
def test_the_following_error_of_the_log_is_the_published_one() -> None:
    found = predicted("emps")
    rms = float(np.sqrt(np.mean(found.measured["following_error"][49:] ** 2)))
    assert rms == pytest.approx(578e-6, abs=0.5e-6)  # published to three digits


@needs_log
def test_a_sample_of_delay_that_the_real_loop_does_not_have_makes_the_prediction_worse() -> None:
    log = measured(predicted("emps"))
    loop = read_machine("emps").loop("x")
    delayed = tree.vary(loop, {"axis.x.actuator.dead_time": 1e-3})
    late, right = replay(delayed, log, skip=49), replay(loop, log, skip=49)
    # 2.1 against 1.24 um and 6.6 against 3.7 % when measured: half again as much tells the two loops apart with room
    assert late.rms("position_load") > 1.5 * right.rms("position_load")
    assert late.share("force") > 1.5 * right.share("force")


@needs_log
def test_volts_become_newtons_by_the_force_constant() -> None:
    """4.6 % of the force is left with the symmetric model, 3.7 % here; read as newtons it would be 97 %."""
    assert predicted("emps").share("force") < 0.04


def test_the_start_of_a_log_in_motion_is_estimated_within_its_noise() -> None:
    t = np.arange(200) * 1e-3
    rng = np.random.default_rng(5)
    truth = 0.01 + 0.03 * t + 0.5 * 0.8 * t * t
    rounded = 5e-8 * np.round((truth + 1e-7 * rng.standard_normal(t.size)) / 5e-8)
    position, velocity = estimate_start(rounded, 1e-3)
    # least squares over 50 rows: 3 times the noise over √50 for the position, 12 times that over the 49 ms span for
    # the slope at the end of a parabola, both times 3 for safety
    assert position == pytest.approx(0.01, abs=3 * 3 * 1e-7 / np.sqrt(50))
    assert velocity == pytest.approx(0.03, abs=3 * 16 * 1e-7 / np.sqrt(50) / 0.049)


def test_gain_in_file_is_that_of_the_drive_times_the_force_constant() -> None:
    loop = read_machine("emps").loop("x")
    motor = loop.axis.actuator.motor
    assert motor is not None
    assert tree.get(loop, "axis.x.control.law.Kp") == pytest.approx(243.45 * motor.force_per_unit(), rel=1e-9)
    assert tree.get(loop, "axis.x.control.force_limit") == pytest.approx(10.0 * motor.force_per_unit(), rel=1e-9)

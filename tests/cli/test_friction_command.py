"""`feeddrive friction`, from logs of constant speeds to a friction block and a report."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from feeddrive.blocks.friction.stribeck import Stribeck
from feeddrive.cli.commands import app
from feeddrive.files.machine import BUNDLED, read_machine
from feeddrive.language.errors import FeeddriveError, LogError, NotIdentifiableError, ParameterError

SCREW = Path(__file__).parents[3] / "shared" / "data" / "leadscrew_epos"
RUNS = SCREW / "experiments" / "driveNo1" / "steady_state" / "0.096kg"
needs_screw = pytest.mark.skipif(not RUNS.exists(), reason="NOT RUN: leadscrew_epos is not in ../shared")

T = 1e-3
TRUTH = Stribeck(coulomb=20.0, breakaway=30.0, stribeck_velocity=0.01, viscous=200.0, exponent=1)
SPEEDS = (0.001, 0.003, 0.006, 0.01, 0.015, 0.025, 0.05, 0.1, 0.15, 0.2)
OFFSET = -3.0
runner = CliRunner()


def signals(speeds: tuple[float, ...], rows: int = 400) -> np.ndarray:
    """Time, position, velocity and force at one speed after the other, with ramps between and noise."""
    rng = np.random.default_rng(4)
    velocity = np.concatenate(
        [
            np.concatenate([np.full(rows, v), np.linspace(v, after, 60)])
            for v, after in zip(speeds, [*speeds[1:], 0.0], strict=True)
        ]
    )
    force = np.array([float(TRUTH.steady(np.float64(v))) for v in velocity]) + OFFSET
    force += 0.5 * rng.standard_normal(velocity.size)
    time = T * np.arange(velocity.size)
    return np.column_stack([time, T * np.cumsum(velocity), velocity, force])


def written(folder: Path, speeds: tuple[float, ...], name: str = "runs.csv") -> str:
    path = folder / name
    heads = "time_s,position_mm,velocity_mm_per_s,force_N"
    scaled = signals(speeds) * [1.0, 1e3, 1e3, 1.0]
    np.savetxt(path, scaled, delimiter=",", fmt="%.9g", header=heads, comments="")
    return str(path)


def both(speeds: tuple[float, ...] = SPEEDS) -> tuple[float, ...]:
    return (*speeds, *(-v for v in speeds))


NAMED = ("--velocity", "velocity_mm_per_s:mm/s", "--force", "force_N:N")


def called(*asked: str, code: int = 0) -> str:
    done = runner.invoke(app, ["friction", *asked], catch_exceptions=False)
    assert done.exit_code == code, done.output
    return done.output


def refused(folder: Path, *asked: str) -> FeeddriveError:
    """The error of a call that must write nothing."""
    out = folder / "refused"
    done = runner.invoke(app, ["friction", *asked, "--out", str(out)])
    assert isinstance(done.exception, FeeddriveError), done.output
    assert not out.exists()
    return done.exception


def test_one_log_of_many_speeds_becomes_a_block_in_a_machine_whose_comments_stay(tmp_path: Path) -> None:
    start = tmp_path / "mine.toml"
    text = (BUNDLED / "machines" / "emps_symmetric.toml").read_text(encoding="utf-8")
    start.write_text(text, encoding="utf-8")
    output = called(written(tmp_path, both()), *NAMED, "--machine", str(start), "--out", str(tmp_path / "out"))
    assert "stribeck with offset, exponential" in output
    assert "Take the block 'stribeck'" in output
    made = (tmp_path / "out" / "machine.toml").read_text(encoding="utf-8")
    assert "# the drive must overcome the offset" in made
    loop, before = read_machine(tmp_path / "out" / "machine.toml").loop("x"), read_machine(start).loop("x")
    found = loop.axis.friction_load
    assert isinstance(found, Stribeck)
    # means of 320 rows with noise 0.5 N are known to 0.03 N; the Stribeck part by three times that and its shape
    assert float(found.coulomb) == pytest.approx(20.0, abs=0.3)
    assert float(found.breakaway) == pytest.approx(30.0, abs=0.3)
    assert float(found.stribeck_velocity) == pytest.approx(0.01, rel=0.05)
    assert float(found.viscous) == pytest.approx(200.0, abs=2.0)
    # the drive needs -3 N more than friction, so what acts pushes with 3 N
    assert float(loop.axis.forces[0].force) == pytest.approx(3.0, abs=0.1)  # type: ignore[attr-defined]
    assert repr(loop.control) == repr(before.control)
    assert repr(loop.axis.plant) == repr(before.axis.plant)
    assert re.search(r"^stribeck_velocity = .*standard error .* m/s$", made, re.MULTILINE)
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    for said in ("Take the block", "strong evidence", "standard error", "Friction over velocity", "All runs"):
        assert said in page


def test_several_logs_and_a_position_that_is_differenced_give_the_same_curve(tmp_path: Path) -> None:
    logs = [written(tmp_path, (v,), f"run_{i}.csv") for i, v in enumerate(both())]
    output = called(*logs, "--position", "position_mm:mm", "--force", "force_N:N", "--out", str(tmp_path / "out"))
    row = re.search(r"^ stribeck_velocity +mm/s +([0-9.e+-]+)", output, re.MULTILINE)
    assert row is not None
    assert float(row[1]) == pytest.approx(10.0, rel=0.1)
    section = (tmp_path / "out" / "machine.toml").read_text(encoding="utf-8")
    assert '[axis.x.friction_load]\nkind = "stribeck"' in section


def test_an_offset_of_a_hundredth_of_friction_becomes_no_force(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is found, by the criterion and by 10 of its errors, and is said; an axis of a machine is not pulled by it."""
    monkeypatch.setattr("test_friction_command.OFFSET", -0.3)
    output = called(written(tmp_path, both()), *NAMED, "--out", str(tmp_path / "out"))
    assert "stribeck with offset" in output
    assert "gravity" not in (tmp_path / "out" / "machine.toml").read_text(encoding="utf-8")
    assert "becomes no constant force: that takes more than 3 of its errors and 5 % of Coulomb friction" in output


def test_friction_goes_where_the_axis_has_it(tmp_path: Path) -> None:
    log = written(tmp_path, both())
    output = " ".join(called(log, *NAMED, "--machine", "ball_screw", "--out", str(tmp_path / "out")).split())
    made = (tmp_path / "out" / "machine.toml").read_text(encoding="utf-8")
    assert "[axis.x.friction_motor]         # bearings and nut" in made
    found = read_machine(tmp_path / "out" / "machine.toml").loop("x").axis.friction_motor
    assert isinstance(found, Stribeck)
    # the bundled plant has 1520 N s/m of its own, more than the 200 of these runs
    assert float(found.viscous) == 0.0
    assert "less than the 1520 N s/m that the plant has of its own" in output
    two = tmp_path / "two.toml"
    text = (BUNDLED / "machines" / "ball_screw.toml").read_text(encoding="utf-8")
    two.write_text(f'{text}\n[axis.x.friction_load]\nkind = "coulomb"\ncoulomb = 5\n', encoding="utf-8")
    output = " ".join(called(log, *NAMED, "--machine", str(two), "--out", str(tmp_path / "both")).split())
    assert "constant speeds tell their sum only" in output
    assert not (tmp_path / "both" / "machine.toml").exists()


def test_what_to_measure_next_is_said_with_speeds(tmp_path: Path) -> None:
    """Without runs below the Stribeck velocity its level at standstill is not seen."""
    log = written(tmp_path, both((0.02, 0.025, 0.03, 0.04, 0.05, 0.07, 0.1, 0.15, 0.2)))
    output = " ".join(called(log, *NAMED, "--out", str(tmp_path / "out"), code=1).split())
    assert "Measure more before you take this curve" in output
    assert "so shape and breakaway level are a guess" in output
    assert not (tmp_path / "out" / "machine.toml").exists()
    assert re.search(r"record next runs at 0\.00\d+, 0\.00\d+, 0\.0\d+, 0\.0\d+ m/s in both directions", output)


def test_a_log_without_a_constant_speed_is_left_out_and_named(tmp_path: Path) -> None:
    ramp = tmp_path / "ramp.csv"
    v = np.linspace(0.0, 100.0, 500)
    table = np.column_stack([T * np.arange(500), T * np.cumsum(v), v, np.ones(500)])
    np.savetxt(ramp, table, delimiter=",", header="time_s,position_mm,velocity_mm_per_s,force_N", comments="")
    log = written(tmp_path, both())
    assert "ramp.csv holds no constant speed" in called(log, str(ramp), *NAMED, "--out", str(tmp_path / "out"))
    assert "some seconds each" in str(refused(tmp_path, str(ramp), *NAMED))


def test_a_shaft_stays_one_until_the_lead_is_known(tmp_path: Path) -> None:
    log = written(tmp_path, both())
    # the same numbers as rad/s and N m: a lead of 2 pi m has the lever 1
    named = ("--speed", "velocity_mm_per_s*1e-3:rad/s", "--torque", "force_N*1:N m")
    output = called(log, *named, "--out", str(tmp_path / "out"))
    assert "give --lead" in output
    assert not (tmp_path / "out" / "machine.toml").exists()
    called(log, *named, "--lead", f"{2.0 * np.pi}", "--out", str(tmp_path / "out"))
    assert "# N: level at speed" in (tmp_path / "out" / "machine.toml").read_text(encoding="utf-8")
    error = refused(tmp_path, log, "--velocity", "velocity_mm_per_s:mm/s", "--torque", "force_N*1:N m")
    assert isinstance(error, ParameterError)
    assert "--lead" in str(error)


def test_what_runs_cannot_tell_is_said_and_nothing_is_written(tmp_path: Path) -> None:
    one = refused(tmp_path, written(tmp_path, (0.1, -0.1)), *NAMED)
    assert isinstance(one, NotIdentifiableError)
    assert "not 1 forward and 1 backward; record next runs at" in str(one)
    same = [written(tmp_path, (v,), f"same_{i}.csv") for i, v in enumerate((0.1, 0.1003, 0.1006, -0.1, -0.1003))]
    assert "not 1 forward and 1 backward" in str(refused(tmp_path, *same, *NAMED))
    way = refused(tmp_path, written(tmp_path, SPEEDS), *NAMED)
    assert "10 forward and 0 backward" in str(way)
    log = written(tmp_path, both())
    wrong = refused(tmp_path, log, "--velocity", "velocity", "--force", "force_N:N")
    assert isinstance(wrong, LogError)
    assert "there is no column 'velocity'" in str(wrong)
    assert "sign" in str(refused(tmp_path, log, "--velocity", "velocity_mm_per_s*-1:mm/s", "--force", "force_N:N"))
    assert "--force-constant" in str(refused(tmp_path, log, NAMED[0], NAMED[1], "--command", "force_N"))
    assert "the factor after *" in str(
        refused(tmp_path, log, "--velocity", "velocity_mm_per_s*x", "--force", "force_N")
    )
    assert "unit 'mmm'" in str(refused(tmp_path, log, "--velocity", "velocity_mm_per_s*2:mmm", "--force", "force_N"))


@pytest.mark.pictures
@needs_screw
def test_a_lead_screw_from_its_raw_records(tmp_path: Path) -> None:
    """The curve that another program found: 2.320, 3.196 mN m, 4.78 rad/s, 0.0586 mN m s/rad, -0.359 mN m."""
    logs = [str(path) for path in sorted(RUNS.glob("*.csv"))]
    named = (
        "--speed",
        "Velocity actual value averaged*-1:rpm",
        "--torque",
        "Torque actual value averaged*-0.0984:mN m",
    )
    output = called(*logs, *named, "--out", str(tmp_path / "out"))
    expected = {
        "coulomb": 2.320e-3,
        "breakaway": 3.196e-3,
        "stribeck_velocity": 4.78,
        "viscous": 5.86e-5,
        "offset": -3.59e-4,
    }
    for name, value in expected.items():
        row = re.search(rf"^ {name} +(?:N m|N m s/rad|rad/s) +(-?[0-9.e+-]+)", output, re.MULTILINE)
        assert row is not None, output
        # printed to three or four digits
        assert float(row[1]) == pytest.approx(value, rel=2e-3)
    assert "Take this curve (stribeck with offset, exponential)" in output
    channels = tmp_path / "roles.toml"
    channels.write_text(
        '[log]\nfile = "10.csv"\n[log.channels]\n'
        f'speed_motor = {{ column = "Velocity actual value averaged", factor = {-np.pi / 30.0!r} }}\n'
        'torque = { column = "Torque actual value averaged", factor = -9.84e-5 }\n',
        encoding="utf-8",
    )
    again = called(*logs, "--channels", str(channels), "--out", str(tmp_path / "out"))
    assert again.splitlines()[:30] == output.splitlines()[:30]

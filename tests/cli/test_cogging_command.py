"""`feeddrive cogging`, from logs of slow runs or maps to orders, a force block and a report."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from feeddrive.blocks.force.cogging import Cogging
from feeddrive.cli.commands import app
from feeddrive.files.machine import BUNDLED, read_machine
from feeddrive.language.errors import FeeddriveError, LogError, NotIdentifiableError, ParameterError

MAPS = Path(__file__).parents[3] / "shared" / "data" / "odrive_cogging"
needs_maps = pytest.mark.skipif(not MAPS.exists(), reason="NOT RUN: odrive_cogging is not in ../shared")

T, PAIR = 1e-3, 0.024  # s, and the pole pair in m
runner = CliRunner()


def written(folder: Path, *, periods: float = 3.2, way: str = "both", name: str = "slow.csv") -> str:
    """Order 6 is cogging with 0.5 A, order 2 friction along the travel with 0.2 A; Coulomb 0.3 A, constant 0.1 A."""
    rng = np.random.default_rng(3)
    there = np.linspace(0.0, periods * PAIR, 6000)
    # it stands still at the ends
    x = np.concatenate([np.full(200, there[0]), there, np.full(200, there[-1])])
    direction = np.ones(x.size)
    if way == "both":
        x, direction = np.concatenate([x, x[::-1]]), np.concatenate([direction, -direction])
    angle = 2.0 * np.pi * x / PAIR
    force = 0.1 + direction * (0.3 + 0.2 * np.sin(2.0 * angle)) + 0.5 * np.sin(6.0 * angle + 0.7)
    force += 0.05 * rng.standard_normal(x.size)
    path = folder / name
    np.savetxt(
        path,
        np.column_stack([T * np.arange(x.size), 1e3 * x, force]),
        delimiter=",",
        fmt="%.9g",
        header="time_s,position_mm,current_A",
        comments="",
    )
    return str(path)


NAMED = ("--position", "position_mm:mm", "--current", "current_A:A")


def called(*asked: str, code: int = 0) -> str:
    done = runner.invoke(app, ["cogging", *asked], catch_exceptions=False)
    assert done.exit_code == code, done.output
    return done.output


def refused(folder: Path, *asked: str) -> FeeddriveError:
    """The error of a call that must write nothing."""
    out = folder / "refused"
    done = runner.invoke(app, ["cogging", *asked, "--out", str(out)])
    assert isinstance(done.exception, FeeddriveError), done.output
    assert not out.exists()
    return done.exception


def row(output: str, order: int) -> list[float]:
    """Forward, backward, cogging and friction-like amplitudes of an order."""
    found = re.search(rf"^ {order} +(.*)$", output, re.MULTILINE)
    assert found is not None, output
    return [float(each) for each in re.findall(r"([0-9.e-]+) (?:±|\+-)", found[1])]


@pytest.mark.pictures
def test_one_log_to_and_fro_becomes_a_force_in_a_machine_whose_comments_stay(tmp_path: Path) -> None:
    start = tmp_path / "mine.toml"
    start.write_text((BUNDLED / "machines" / "emps_symmetric.toml").read_text(encoding="utf-8"), encoding="utf-8")
    out = tmp_path / "out"
    output = called(
        written(tmp_path),
        *NAMED,
        "--period",
        "24:mm",
        "--force-constant",
        "40",
        "--machine",
        str(start),
        "--out",
        str(out),
    )
    # an amplitude of 12,000 rows with noise 0.05 A has the error 0.05 √(2/12000) = 0.0006; and the mean of 32 rows
    # a wave takes 0.2 % off the largest order only
    assert row(output, 6)[2] == pytest.approx(0.5, abs=0.003)
    assert row(output, 2)[3] == pytest.approx(0.2, abs=0.003)
    assert "Take order 6 as cogging" in output
    assert "order 2) by position alone" in " ".join(output.split())
    loop = read_machine(out / "machine.toml").loop("x")
    block = loop.axis.forces[-1]
    assert isinstance(block, Cogging)
    # the current that held the axis is the opposite of what pulls it, 40 N/A
    assert float(block.force) == pytest.approx(20.0, abs=0.12)
    assert float(block.period) == pytest.approx(PAIR)
    first = block.harmonics[0]
    assert int(first.order) == 6
    assert np.sin(float(first.phase) - 0.7) == pytest.approx(0.0, abs=0.01)
    assert np.cos(float(first.phase) - 0.7) == pytest.approx(-1.0, abs=0.01)
    before = read_machine(start).loop("x")
    assert repr(loop.axis.forces[:-1]) == repr(before.axis.forces)
    text = (out / "machine.toml").read_text(encoding="utf-8")
    assert "# the drive must overcome the offset" in text
    page = (out / "report.html").read_text(encoding="utf-8")
    for said in ("Take order 6", "Force over one period", "Amplitude by order", "friction-like"):
        assert said in page
    # a second time the block is replaced, not doubled
    called(
        written(tmp_path),
        *NAMED,
        "--period",
        "24:mm",
        "--force-constant",
        "80",
        "--machine",
        str(out / "machine.toml"),
        "--out",
        str(tmp_path / "again"),
    )
    forces = read_machine(tmp_path / "again" / "machine.toml").loop("x").axis.forces
    assert [type(each) for each in forces] == [type(each) for each in loop.axis.forces]
    assert float(forces[-1].force) == pytest.approx(40.0, abs=0.24)  # type: ignore[attr-defined]


def test_an_angle_that_starts_again_each_turn_needs_no_clock_and_no_period(tmp_path: Path) -> None:
    count = np.concatenate([np.arange(3000), np.arange(3000)[::-1]])
    turns = count / 1000.0
    force = 0.1 * np.sign(np.gradient(count)) + 0.5 * np.sin(2.0 * np.pi * 7 * turns)
    force += 0.02 * np.random.default_rng(1).standard_normal(count.size)
    path = tmp_path / "turns.csv"
    np.savetxt(
        path, np.column_stack([360.0 * np.mod(turns, 1.0), force]), delimiter=",", header="theta,iq", comments=""
    )
    output = called(
        str(path), "--angle", "theta:deg", "--torque", "iq*0.05:N m", "--lead", "0.01", "--out", str(tmp_path / "out")
    )
    assert row(output, 7)[2] == pytest.approx(0.025, abs=2e-4)
    section = (tmp_path / "out" / "machine.toml").read_text(encoding="utf-8")
    # 0.025 N m at a lead of 10 mm: F = 2 pi τ / lead
    found = re.search(r"^force = ([0-9.]+)", section, re.MULTILINE)
    assert found is not None
    assert float(found[1]) == pytest.approx(0.025 * 2.0 * np.pi / 0.01, rel=0.01)
    assert re.search(r"^period = 0.01\b", section, re.MULTILINE)


def test_one_direction_gives_a_report_and_no_machine_file(tmp_path: Path) -> None:
    output = called(
        written(tmp_path, way="forward"),
        *NAMED,
        "--period",
        "24:mm",
        "--force-constant",
        "40",
        "--out",
        str(tmp_path / "out"),
        code=1,
    )
    assert "Measure the same travel the other way before you compensate anything" in output
    assert "one direction cannot tell" in " ".join(output.split())
    assert not (tmp_path / "out" / "machine.toml").exists()


def test_what_runs_cannot_tell_is_said_and_nothing_is_written(tmp_path: Path) -> None:
    short = refused(tmp_path, written(tmp_path, periods=0.6), *NAMED, "--period", "24:mm")
    assert isinstance(short, NotIdentifiableError)
    assert "with a period of 0.024 m the longest stretch in one direction is 0.6 periods" in str(short)
    log = written(tmp_path)
    wrong = refused(tmp_path, log, "--position", "x", "--current", "current_A", "--period", "24:mm")
    assert isinstance(wrong, LogError)
    assert "there is no column 'x'" in str(wrong)
    assert "--period is missing" in str(refused(tmp_path, log, *NAMED))
    for period in ("0:mm", "wide", "24:N"):
        assert isinstance(refused(tmp_path, log, *NAMED, "--period", period), ParameterError)
    for orders in ("0..3", "a", "3,3", "5..2"):
        assert "--orders" in str(refused(tmp_path, log, *NAMED, "--period", "24:mm", "--orders", orders))
    np.save(tmp_path / "nameless.npy", np.zeros((9, 3)))
    assert "there are: column_1, column_2, column_3" in str(refused(tmp_path, str(tmp_path / "nameless.npy")))
    assert "--map" in str(refused(tmp_path, str(tmp_path / "nameless.npy"), "--current", "column_1"))
    assert "--backward is for maps" in str(refused(tmp_path, log, *NAMED, "--period", "24:mm", "--backward", log))
    assert "for its force" in str(
        refused(
            tmp_path,
            log,
            "--position",
            "position_mm:mm",
            "--period",
            "24:mm",
            "--time",
            "time_s",
            "--channels",
            str(only_position(tmp_path, log)),
        )
    )


def only_position(folder: Path, log: str) -> Path:
    path = folder / "roles.toml"
    path.write_text(
        f'[log]\nfile = "{Path(log).name}"\n[log.channels]\n'
        'position_load = { column = "position_mm", unit = "mm" }\n',
        encoding="utf-8",
    )
    return path


@needs_maps
def test_maps_of_a_motor_with_14_poles(tmp_path: Path) -> None:
    """Known of this set: orders 7, 28, 14, 36, 12, 84; order 7 with 0.86 A forward; Coulomb friction 0.17 A."""
    forward = [str(MAPS / f"cogging_measure_final_{name}_16.npy") for name in "abd"]
    back = str(MAPS / "cogging_measure_final_e_16r.npy")
    output = called(*forward, "--backward", back, "--map", "--out", str(tmp_path / "out"))
    listed = [int(each) for each in re.findall(r"^ (\d+) +[0-9.]+ (?:±|\+-)", output, re.MULTILINE)]
    assert listed[:6] == [7, 28, 14, 36, 12, 84]
    assert row(output, 7)[0] == pytest.approx(0.868, abs=0.001)
    assert "Coulomb friction 0.171" in output
    assert "Take orders 28, 14, 36, 12, 84" in output
    assert "(0.68 A RMS, orders 7, 21)" in " ".join(output.split())

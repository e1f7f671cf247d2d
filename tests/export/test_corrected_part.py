"""The files of a corrected part: read back bit for bit, and each number as its target reads it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from feeddrive.bus.drive_file import DriveScaling
from feeddrive.export.corrected_part import HAL, RECORD, STREAMER, TEXT, read_correction, write_correction
from feeddrive.language.errors import FileError, ParameterError
from feeddrive.learning.part_correction import Correction, correct_by_plan
from parts import T, machine, plan

PLAN = plan()
CORRECTION = correct_by_plan(machine(), PLAN)
N = PLAN["x"].position.size
REST = round(0.02 / T)


def written(folder: Path, correction: Correction = CORRECTION, **drives: DriveScaling) -> Path:
    write_correction(folder, correction, np.arange(N), drives)
    (folder / RECORD).write_text(json.dumps({"passes": 2}), encoding="utf-8")
    return folder


def test_what_is_read_is_what_was_written(tmp_path: Path) -> None:
    last, before, record = read_correction(written(tmp_path), PLAN)
    assert before is None
    assert record["passes"] == last.passes == 2
    for axis in PLAN:
        assert np.array_equal(last.forces[axis], CORRECTION.forces[axis])


def test_the_change_of_a_path_and_the_force_before_are_kept(tmp_path: Path) -> None:
    change = 1e-6 * np.random.default_rng(1).standard_normal((5, N))
    given = Correction(PLAN, {}, {"x": change})
    write_correction(tmp_path, given, None, {}, before=CORRECTION)
    (tmp_path / RECORD).write_text("{}", encoding="utf-8")
    last, before, _ = read_correction(tmp_path, PLAN)
    assert np.array_equal(last.paths["x"], change)
    assert before is not None
    assert np.array_equal(before.forces["y"], CORRECTION.forces["y"])


def test_text_ends_at_rest_without_force(tmp_path: Path) -> None:
    rows = np.genfromtxt(written(tmp_path) / TEXT, delimiter=",", names=True)
    assert rows.size == N + REST
    assert np.array_equal(rows["x_set_position_m"][:N], PLAN["x"].position)
    assert np.array_equal(rows["y_force_offset_N"][:N], CORRECTION.forces["y"])
    assert rows["x_force_offset_N"][-1] == 0.0
    assert np.ptp(rows["x_set_position_m"][N - 1 :]) == 0.0
    assert rows["line"][-1] == N - 1
    assert rows["time_s"][1] == pytest.approx(T)


def test_linuxcnc_streams_mm_and_newtons(tmp_path: Path) -> None:
    rows = np.loadtxt(written(tmp_path) / STREAMER)
    assert rows.shape == (N + REST, 4)
    assert rows[:N, 1] == pytest.approx(1e3 * PLAN["y"].position)
    assert np.array_equal(rows[:N, 2], CORRECTION.forces["x"])
    hal = (tmp_path / HAL).read_text(encoding="utf-8")
    assert "cfg=ffff" in hal
    assert "its period must be 500000 ns" in hal
    assert "x-force-offset streamer.0.pin.2" in hal


@pytest.mark.parametrize("sign", [1, -1])
def test_a_drive_gets_increments_and_thousandths(tmp_path: Path, sign: int) -> None:
    """10 mm a turn of 2^20 counts, 2.4 N m: one thousandth is 2.4e-3 · 2π / 0.01 = 1.508 N."""
    scaling = DriveScaling(counts_per_turn=2**20, lead=0.01, rated_torque=2.4, force_sign=sign)
    written(tmp_path, x=scaling)
    rows = np.genfromtxt(tmp_path / "cia402_x.csv", delimiter=",", names=True)
    assert not (tmp_path / "cia402_y.csv").exists()
    k = int(np.argmax(np.abs(CORRECTION.forces["x"])))
    assert rows["torque_offset_0x60B2"][k] == sign * round(CORRECTION.forces["x"][k] / (2.4e-3 * 2.0 * np.pi / 0.01))
    assert rows["target_position_0x607A"][k] == round(PLAN["x"].position[k] / 0.01 * 2**20)
    assert rows["torque_offset_0x60B2"][-1] == 0.0


def test_an_offset_that_does_not_fit(tmp_path: Path) -> None:
    weak = DriveScaling(increment=1e-8, rated_force=0.1)
    with pytest.raises(ParameterError, match=r"axis x: the torque offset 0x60B2 is .* beyond 32767.*rated_torque"):
        written(tmp_path, x=weak)
    fine = DriveScaling(increment=1e-12, rated_force=1000.0)
    with pytest.raises(ParameterError, match=r"axis x: the target position 0x607A is .* beyond 2147483647.*increment"):
        written(tmp_path, x=fine)


def test_a_directory_of_something_else(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"has no setpath\.json: name a directory"):
        read_correction(tmp_path, PLAN)
    written(tmp_path)
    with pytest.raises(ParameterError, match="it is of another program"):
        read_correction(tmp_path, {"z": PLAN["x"]})
    (tmp_path / RECORD).write_text("{", encoding="utf-8")
    with pytest.raises(FileError, match="is damaged"):
        read_correction(tmp_path, PLAN)

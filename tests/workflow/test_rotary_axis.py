"""An axis that turns, from its log to a tuned loop: rad, N m and kg m2, and the laws as they are."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.files.machine import BUNDLED, machine_toml, read_machine
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.loop.machine import Machine
from feeddrive.loop.simulate import simulate
from feeddrive.workflow.identify import identify, machine_text
from feeddrive.workflow.tune import tune

FILE = BUNDLED / "machines" / "rotary_table.toml"


@cache
def columns() -> np.ndarray:
    """Time in s, set angle and angle in deg, torque in N m, of moves of a radian to and fro."""
    loop = read_machine("rotary_table").loop("c")
    move = SnapLimitedMove(
        distance=1.0, velocity=2.0, acceleration=20.0, jerk=400.0, snap=20e3, back=True, dwell_before=0.1,
        dwell_between=0.1, dwell_after=0.1,
    )  # fmt: skip
    run = simulate(loop, move, record=("set_position", "reading_load", "force"))
    degrees = 180.0 / np.pi
    return np.column_stack([run.time, degrees * run["set_position"], degrees * run["reading_load"], run["force"]])


def log(folder: Path) -> Path:
    path = folder / "log.csv"
    heads = "t,set_angle [deg],angle [deg],torque [Nm]"
    np.savetxt(path, columns(), delimiter=",", fmt="%.12g", header=heads, comments="")
    return path


def test_units_of_a_file_are_those_of_an_axis_that_turns(tmp_path: Path) -> None:
    text = FILE.read_text(encoding="utf-8")
    path = tmp_path / "table.toml"
    for old, new, said in (
        ("mass_kg_m2 = 0.8", "mass_kg = 0.8", "unit 'kg' does not measure the same thing as 'kg m2'"),
        ("mass_kg_m2 = 0.8", "mass = -1.0", "mass = -1 kg m2 (all that moves, seen at the table) must be > 0 kg m2"),
        ("mass_kg_m2 = 0.8", "", "rigid needs mass (kg m2"),
        ("rotary = true", "rotary = false", "unit 'kg_m2' does not measure the same thing as 'kg'"),
    ):
        path.write_text(text.replace(old, new), encoding="utf-8")
        with pytest.raises(ParameterError) as caught:
            read_machine(path)
        assert said in str(caught.value)
    screw = '"screw_rigid"\nlead = 0.01\nmass = 1.0\ninertia_motor = 1e-3\ninertia_screw = 1e-3'
    path.write_text(text.replace('"rigid"\nmass_kg_m2 = 0.8', screw), encoding="utf-8")
    with pytest.raises((ParameterError, StructureError), match="a screw moves along its lead"):
        read_machine(path)


def test_a_file_that_is_written_is_read_back_and_names_its_units(tmp_path: Path) -> None:
    loop = read_machine("rotary_table").loop("c")
    text = machine_toml(Machine.of({"c": loop}), "again")
    path = tmp_path / "again.toml"
    path.write_text(text, encoding="utf-8")
    assert repr(read_machine(path).loop("c")) == repr(loop)
    for said in ("# kg m2: all that moves", "# N m s/rad: velocity gain", "# N m: "):
        assert said in text
    for line in text.splitlines():
        assert "# kg:" not in line
        assert "# N:" not in line
        assert "# m:" not in line


def test_a_log_of_angle_and_torque_becomes_a_machine_file(tmp_path: Path) -> None:
    """Without noise, by inverse dynamics with its filters: 1 % of the inertia, 5 % of the friction."""
    found = identify(log(tmp_path), rotary=True, axis="c", machine="rotary_table")
    assert found.recommendation.startswith("Use these values")
    assert " urad RMS" in found.recommendation
    assert found.rigid["mass"].unit == "kg m2"
    assert found.rigid["mass"].value == pytest.approx(0.8, rel=0.01)
    text = machine_text(found, read_machine("rotary_table"), "c")
    assert text is not None
    assert "mass_kg_m2 = 0.8" in text or "mass_kg_m2 = 0.79" in text
    assert "standard error" in text
    (tmp_path / "machine.toml").write_text(text, encoding="utf-8")
    loop = read_machine(tmp_path / "machine.toml").loop("c")
    assert loop.axis.rotary
    assert tree.get(loop, "axis.c.friction_load.coulomb") == pytest.approx(6.0, rel=0.05)
    assert tree.declaration(loop, "axis.c.friction_load.viscous").unit == "N m s/rad"


def test_what_does_not_fit_an_axis_that_turns_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="--lead belongs to a screw"):
        identify(log(tmp_path), rotary=True, lead=0.01)
    path = tmp_path / "linear.csv"
    np.savetxt(path, columns()[:, [0, 2, 3]] * [1.0, 1e-3, 1.0], delimiter=",", header="t,pos_m,force_N", comments="")
    with pytest.raises(ParameterError, match="the axis turns, and the log has a position in m"):
        identify(path, rotary=True)


@pytest.mark.slow(reason="a search of gains with certificate and report")
def test_the_way_from_the_log_to_a_tuned_loop(tmp_path: Path) -> None:
    identify(log(tmp_path), machine="rotary_table", axis="c", out=tmp_path / "found")
    machine = tmp_path / "found" / "machine.toml"
    done = tune.run(tune.request(str(machine), starts=1, out=tmp_path / "tuned"))
    assert done.failure is None
    assert any("the axis turns" in each for each in done.remarks)
    text = (tmp_path / "tuned" / "machine.toml").read_text(encoding="utf-8")
    after = read_machine(tmp_path / "tuned" / "machine.toml").loop("c")
    assert after.axis.rotary
    assert "Kp = " in text
    assert float(after.control.law.Kp) > 0.0  # type: ignore[attr-defined]

"""The gains of an ODrive: files of the form of `odrivetool backup-config`, written here, with numbers of the test."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import foreign_axis as fa
from feeddrive.files.odrive import read_odrive
from feeddrive.language.errors import FileError, ParameterError
from feeddrive.workflow.identify import identify

T = 1e-3
MASS, LEVER = 30.0, 0.01 / (2.0 * math.pi)  # kg; m of the table for each radian
KV, KP, TN = 25.0, 120.0 * MASS, 0.05  # at the table


def backup(**changed: Any) -> dict[str, Any]:
    """The properties of a drive under their names; a change of None leaves one out."""
    config: dict[str, Any] = {
        "control_mode": 3,
        "input_mode": 3,
        "pos_gain": KV,
        "vel_gain": KP * LEVER**2 * 2.0 * math.pi,
        "vel_integrator_gain": KP * LEVER**2 * 2.0 * math.pi / TN,
        "vel_limit": 20.0,
    }
    config |= changed
    config = {name: value for name, value in config.items() if value is not None}
    axis = {"controller": {"config": config}, "motor": {"config": {"torque_constant": 0.04, "pole_pairs": 7}}}
    return {"config": {"brake_resistance": 2.0}, "axis0": axis, "can": {"config": {}}}


def flat(content: Any, name: str = "") -> dict[str, Any]:
    if not isinstance(content, dict):
        return {name: content}
    parts = [flat(value, f"{name}.{key}" if name else key) for key, value in content.items()]
    return {key: value for part in parts for key, value in part.items()}


def written(folder: Path, content: Any, name: str = "odrive.json") -> Path:
    path = folder / name
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


@pytest.mark.parametrize("form", [lambda content: content, flat])
def test_gains_are_those_at_the_table(tmp_path: Path, form: Any) -> None:
    law, said = read_odrive(written(tmp_path, form(backup())), lever=LEVER)
    assert (law.Kv, law.Kp, law.Tn) == pytest.approx((KV, KP, TN))
    assert law.velocity_feedforward == 1.0
    assert len(said) == 1
    turning, _ = read_odrive(written(tmp_path, form(backup())))
    assert turning.Kp == pytest.approx(KP * LEVER**2)


def test_without_an_integral_and_without_a_shape_of_its_own(tmp_path: Path) -> None:
    law, said = read_odrive(written(tmp_path, backup(vel_integrator_gain=0.0, input_mode=1)))
    assert law.Tn is None
    assert law.velocity_feedforward == 0.0
    assert "input_vel" in said[1]


@pytest.mark.parametrize(
    ("content", "axis", "message"),
    [
        (backup(pos_gain=None), "axis0", "axis0.controller.config.pos_gain is None, not a number > 0"),
        (backup(vel_gain=-1.0), "axis0", "vel_gain is -1.0, not a number > 0"),
        (backup(vel_integrator_gain=-1.0), "axis0", "vel_integrator_gain is -1.0, not a number >= 0"),
        (backup(control_mode=2), "axis0", "control_mode is 2: its position loop, 3, does not run"),
        (backup(), "axis1", "has gains of axis0"),
        ({"gains": [1.0]}, "axis0", "has no axis0.controller.config"),
        ({"axis0": {"controller": backup()["axis0"]["controller"]}}, "axis0", "older than 0.5"),
    ],
)
def test_what_is_no_law_is_refused(tmp_path: Path, content: Any, axis: str, message: str) -> None:
    with pytest.raises(FileError, match=message):
        read_odrive(written(tmp_path, content), axis)


def test_another_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "odrive.json"
    path.write_text("odrv0.axis0\n", encoding="utf-8")
    with pytest.raises(FileError, match="is no JSON file of an ODrive"):
        read_odrive(path)


def test_a_log_is_identified_under_the_law_of_its_drive(tmp_path: Path) -> None:
    axes = fa.Axes(mass=MASS, viscous=60.0, coulomb_positive=9.0, coulomb_negative=9.0, dead_time=0.9e-3, noise_log=0.1)
    moves = fa.smooth_moves(T, (0.1, 0.0) * 2, 0.2, 2.0, 80.0, 0.15, 0.2)
    law = fa.Cascade(Kv=KV, Kp=KP, rate=1.0 / TN, ff=1.0)
    log = fa.simulate(axes, law, moves, T, np.random.default_rng(5), count=1).log(0)
    columns = np.column_stack([log["time"], log["setpoint"], log["position"], log["force"]])
    np.savetxt(
        tmp_path / "log.csv", columns, delimiter=",", header="t (s),target (m),actual (m),force (N)", comments=""
    )
    file = str(written(tmp_path, backup()))
    done = identify.run(identify.request(tmp_path / "log.csv", law=file, lead=0.01))
    # noise of 0.1 N under 60 N of acceleration
    assert done.result.rigid["mass"].value == pytest.approx(MASS, rel=0.01)
    assert any("law is that of odrive.json, axis0" in str(remark) for remark in done.remarks)
    with pytest.raises(ParameterError, match="give the --lead"):
        identify.run(identify.request(tmp_path / "log.csv", law=file))

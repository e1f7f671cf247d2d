"""Roles guessed by names and units, the TOML of a guess, and what is odd about channels."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from feeddrive.files.columns import Column
from feeddrive.files.log import Log
from feeddrive.files.mapping import Need, axis_called, guess_roles, write_roles
from feeddrive.files.names import read_name, unit_in_name, words_of
from feeddrive.files.read_log import read_log, read_request
from feeddrive.language.errors import ParameterError

T = 1e-3


def log(units: Mapping[str, str], name: str = "a") -> Log:
    values = np.sin(np.arange(50.0))
    return Log(
        name=name, time=T * np.arange(50), channels=dict.fromkeys(units, values), units=dict(units), sample_time=T
    )


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("joint.0.motor-pos-cmd", ["joint", "0", "motor", "pos", "cmd"]),
        ("Axis1.ActVelo", ["axis1", "act", "velo"]),
        ("Lagesollwert", ["lage", "soll"]),
        ("Sollposition", ["soll", "position"]),
        ("IstDrehzahl", ["ist", "drehzahl"]),
        ("x_Istposition", ["x", "ist", "position"]),
        ("twist position", ["twist", "position"]),
        ("x_cmd_mm", ["x", "cmd", "mm"]),
    ],
)
def test_words(name: str, words: list[str]) -> None:
    assert words_of(name) == words


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("pos_act_mm", "mm"),
        ("force_N", "N"),
        ("x_m", ""),
        ("pos_m", "m"),
        ("speed rpm", "rpm"),
        ("u_in", ""),
        ("iq_A", "A"),
        ("theta_mx", ""),
        ("N", ""),
        ("force", ""),
    ],
)
def test_units_in_names(name: str, unit: str) -> None:
    assert unit_in_name(name) == unit


# the names of makers and papers, and what they stand for
LOGS: list[tuple[dict[str, str], dict[str, str]]] = [
    ({"qg": "", "qm": "", "vir": ""}, {"setpoint_position": "qg", "position_load": "qm", "command": "vir"}),
    (
        {"iq_refx": "", "iq_adx": "", "theta_mx": "", "theta_my": "", "omega_max": "", "omega_may": "", "vdc_adx": ""},
        {
            "command": "iq_refx",
            "current": "iq_adx",
            "angle_motor": "theta_mx",
            "angle_load": "theta_my",
            "speed_motor": "omega_max",
            "speed_load": "omega_may",
        },
    ),
    (
        {"Velocity actual value averaged": "rpm", "Current actual value": "mA", "Position actual value": "mm"},
        {
            "speed_motor": "Velocity actual value averaged",
            "current": "Current actual value",
            "position_load": "Position actual value",
        },
    ),
    (
        {"Axis 1.SetPos": "mm", "Axis 1.ActPos": "mm", "Axis 1.PosDiff": "mm", "Axis 1.ActVelo": "mm/s", "x": ""},
        {"setpoint_position": "Axis 1.SetPos", "position_load": "Axis 1.ActPos", "velocity_load": "Axis 1.ActVelo"},
    ),
    (
        {"pid.x.command": "", "pid.x.feedback": "", "pid.x.output": "", "joint.0.f-error": ""},
        {"setpoint_position": "pid.x.command", "position_load": "pid.x.feedback", "command": "pid.x.output"},
    ),
    (
        {"joint.0.motor-pos-cmd": "", "joint.0.motor-pos-fb": ""},
        {"setpoint_position": "joint.0.motor-pos-cmd", "position_motor": "joint.0.motor-pos-fb"},
    ),
    (
        {"Lagesollwert": "mm", "Lageistwert": "mm", "Drehzahlistwert": "U/min", "Drehmoment": "N m"},
        {
            "setpoint_position": "Lagesollwert",
            "position_load": "Lageistwert",
            "speed_motor": "Drehzahlistwert",
            "torque": "Drehmoment",
        },
    ),
    (
        {"Sollposition": "mm", "Istposition": "mm", "Sollkraft": "N", "Schleppabstand": "um"},
        {"setpoint_position": "Sollposition", "position_load": "Istposition", "force": "Sollkraft"},
    ),
    (
        {"phi_soll": "mdeg", "phi_ist": "mdeg", "M": "N m"},
        {"setpoint_angle": "phi_soll", "angle_motor": "phi_ist", "torque": "M"},
    ),
    (
        {"x_motor": "mm", "x_table": "mm", "cutting force": "N", "F_cmd": "N", "table acceleration": "m/s2"},
        {
            "position_motor": "x_motor",
            "position_load": "x_table",
            "load_force": "cutting force",
            "force": "F_cmd",
            "acceleration_load": "table acceleration",
        },
    ),
    (
        {"set_position": "m", "position_load": "m", "force": "N", "dither": "N"},
        {
            "setpoint_position": "set_position",
            "position_load": "position_load",
            "force": "force",
            "excitation": "dither",
        },
    ),
    ({"temperature": "", "state": "", "note": "kg"}, {}),
]


@pytest.mark.parametrize(("units", "roles"), LOGS)
def test_roles_of_usual_names(units: dict[str, str], roles: dict[str, str]) -> None:
    guess = guess_roles(log(units))
    assert {role: column.name for role, column in guess.mapping.items()} == roles
    assert set(guess.mapping.reasons) == set(roles)
    said = {column.name for column in guess.mapping.values()} | {need.column for need in guess.needs.values()}
    assert said | set(guess.unused) == set(units)  # every channel is spoken of
    assert all(name in str(guess) for name in units)


def test_one_axis_of_several() -> None:
    units = {"x_cmd_mm": "", "y_cmd_mm": "", "ux": "", "uy": "", "x_fb_mm": "", "y_fb_mm": "", "gcode_line": ""}
    first, second = guess_roles(log(units)), guess_roles(log(units), "y")
    assert {column.name for column in first.mapping.values()} == {"x_cmd_mm", "ux", "x_fb_mm"}
    assert second.mapping.columns == {
        "setpoint_position": Column(name="y_cmd_mm", unit="mm"),
        "position_load": Column(name="y_fb_mm", unit="mm"),
        "command": Column(name="uy"),
    }
    assert second.unused["ux"] == "of axis x, not y"
    with pytest.raises(ParameterError, match="the log is of one: leave --axis x out"):
        axis_called("log.csv", "x", ())
    with pytest.raises(ParameterError, match=r"no channel names the axis 'z'; there are: x, y"):
        guess_roles(log(units), "z")


def test_two_channels_in_counts_are_motor_and_load_and_need_a_factor_each() -> None:
    guess = guess_roles(log({"pos1": "inc", "pos2": "inc"}))
    assert guess.needs == {
        "position_motor": Need("pos1", "m per inc", "inc"),
        "position_load": Need("pos2", "m per inc", "inc"),
    }
    mixed = guess_roles(log({"pos1": "mm", "pos2": "inc"}))
    assert mixed.mapping.columns == {"position_motor": Column(name="pos1", unit="mm")}
    assert mixed.needs == {"position_load": Need("pos2", "m per inc", "inc")}


def test_what_needs_a_factor_is_left_to_the_user() -> None:
    guess = guess_roles(log({"Torque actual value": "percent", "Position actual value": "inc", "Speed": "rpm"}))
    assert set(guess.mapping) == {"speed_motor"}
    assert guess.needs["torque"] == Need("Torque actual value", "N m per percent: the rated value / 100", "percent")
    assert guess.needs["position_load"] == Need("Position actual value", "m per inc", "inc")
    assert '# torque = { column = "Torque actual value", factor = 1.0 }' in guess.toml()


def test_a_guess_without_units_says_which_it_takes() -> None:
    said, stated = (guess_roles(log({"qm": unit})).mapping.reasons["position_load"] for unit in ("", "mm"))
    assert said == "a usual name; no unit is stated, m is taken"
    assert "taken" not in stated


def test_a_unit_decides_against_a_word() -> None:
    assert read_name("position", "rad").quantity == "angle"
    assert read_name("motor speed", "mm/s").quantity == "velocity"
    assert read_name("speed_rpm", "").quantity == "speed"


def test_the_toml_of_a_guess_reads_the_log_by_its_roles(tmp_path: Path) -> None:
    rows = "".join(f"{k},{k + 1},{2 * k}\n" for k in range(10))
    (tmp_path / 'a "b".csv').write_text(f'x_cmd_mm,x_fb_mm,"u ""x"" [V]"\n{rows}')
    found = read_log(tmp_path / 'a "b".csv', sample_time=2e-3)
    guess = guess_roles(found)
    write_roles(tmp_path / "roles.toml", guess, 'a "b".csv')
    request = read_request(tmp_path / "roles.toml")
    assert request.mapping == guess.mapping
    assert request.mapping.sample_time == 2e-3  # the file has no clock of its own
    again = request.read()
    np.testing.assert_array_equal(again["position_load"], found["x_fb_mm"] * 1e-3)
    assert again.units["setpoint_position"] == "m"
    (tmp_path / "none.toml").write_text("[other]\n")
    with pytest.raises(ParameterError, match=r"none\.toml: section \[log\] is missing; print\(guess_roles"):
        read_request(tmp_path / "none.toml")


def test_measured_logs(shared: Path) -> None:
    """The four kinds of log that lie beside the repository, each with what its description says it holds."""
    for file, roles, sample_time in (
        ("emps/DATA_EMPS.mat", {"setpoint_position": "qg", "position_load": "qm", "command": "vir"}, None),
        ("tokyo_motor_bench/MultisineTypeA.mat", {"current": "iq_adx", "angle_motor": "theta_mx"}, None),
        (
            "leadscrew_epos/experiments/driveNo1/start_stop/50.csv",
            {"speed_motor": "Velocity actual value averaged"},
            None,
        ),
        (
            "linuxcnc_logs/square_r5_closedloop_fullprec.csv.gz",
            {"setpoint_position": "x_cmd_mm", "position_load": "x_fb_mm", "command": "ux"},
            1e-3,
        ),
    ):
        found = read_log(shared / file, sample_time=sample_time)
        guess = guess_roles(found)
        assert roles.items() <= {role: column.name for role, column in guess.mapping.items()}.items()
        read_log(shared / file, guess.mapping, sample_time=sample_time)
        assert found.remarks == ()  # none of them is clipped or constant


# what is odd about channels


def test_constant_clipped_and_slow_channels_are_named() -> None:
    t = 1e-3 * np.arange(5000)
    rng = np.random.default_rng(1)
    swing = np.sin(2 * np.pi * 5 * t) + 0.1 * np.sin(2 * np.pi * 31 * t)
    held = (swing + 0.01 * rng.normal(size=t.size))[np.arange(t.size) // 4 * 4]
    channels = {
        "fine": swing + 1e-3 * rng.normal(size=t.size),
        "dead": np.full(t.size, 3.5),
        "clipped": np.minimum(swing, 0.8),
        "low": np.maximum(swing, -0.7),
        "held": held,
        "line": (np.arange(t.size) // 200 % 5).astype(float),  # a state that stands still by nature
        "quantised": np.round(swing * 20) / 20,
        "resting": np.clip(np.sin(2 * np.pi * 0.4 * t) ** 3 * 2, -2, 2),
    }
    found = Log(name="a", time=t, channels=channels, units={}, sample_time=1e-3).remarks
    said = {remark.split("'")[1]: remark for remark in found}
    assert set(said) == {"dead", "clipped", "low", "held"}
    assert "is constant, 3.5" in said["dead"]
    assert "stays at its largest value 0.8 25 times" in said["clipped"]  # 5 s of 5 Hz
    assert "stays at its smallest value -0.7 25 times" in said["low"]
    assert "changes only at every 4th sample" in said["held"]

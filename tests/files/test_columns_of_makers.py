"""Columns as makers name them, rows without a head, several axes in one log: roles, reasons and options."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from column_logs import Motion, drawn, motion
from feeddrive.files.log import Log
from feeddrive.files.mapping import axes_in, guess_roles
from feeddrive.files.names import axes_of, read_name
from feeddrive.files.read_log import read_log
from feeddrive.language.errors import LogError, ParameterError

# makers' names and units, the axis, and the roles; a role in brackets needs a factor
NAMED: list[tuple[dict[str, str], str | None, dict[str, str]]] = [
    (
        {
            "axis0.encoder.pos_estimate": "",
            "axis0.controller.pos_setpoint": "",
            "axis0.encoder.vel_estimate": "",
            "axis0.motor.current_control.Iq_measured": "",
            "axis1.encoder.pos_estimate": "",
        },
        None,
        {
            "angle_motor": "axis0.encoder.pos_estimate:rev",
            "setpoint_angle": "axis0.controller.pos_setpoint:rev",
            "speed_motor": "axis0.encoder.vel_estimate:rev/s",
            "current": "axis0.motor.current_control.Iq_measured:A",
        },
    ),
    (
        dict.fromkeys(["s actual", "s noml", "v actual", "V (act rpm)", "I nominal", "I (int rpm)", "P mech."], ""),
        None,
        {
            "position_load": "s actual:mm",
            "setpoint_position": "s noml:mm",
            "velocity_load": "v actual:mm/min",
            "velocity_motor": "V (act rpm):mm/min",
            "command": "I nominal:A",
        },
    ),
    (
        {
            f"/Nck/!SD/nckServoData{name}64 [u1, {axis}]": ""
            for axis in (1, 2)
            for name in ("ActPos1stEnc", "ActPos2ndEnc", "CmdPos", "CmdTorque", "ContDev", "ActVelMot")
        },
        "2",
        {
            "position_motor": "/Nck/!SD/nckServoDataActPos1stEnc64 [u1, 2]:mm",
            "position_load": "/Nck/!SD/nckServoDataActPos2ndEnc64 [u1, 2]:mm",
            "setpoint_position": "/Nck/!SD/nckServoDataCmdPos64 [u1, 2]:mm",
            "command": "/Nck/!SD/nckServoDataCmdTorque64 [u1, 2]:N m",
            "speed_motor": "/Nck/!SD/nckServoDataActVelMot64 [u1, 2]:rpm",
        },
    ),
    (
        {
            "Lageistwert Messsystem 1": "mm",
            "Lageistwert Messsystem 2": "mm",
            "Lagesollwert": "mm",
            "Momentensollwert": "N m",
            "Auslastung": "percent",
            "Konturabweichung": "mm",
        },
        None,
        {
            "position_motor": "Lageistwert Messsystem 1:mm",
            "position_load": "Lageistwert Messsystem 2:mm",
            "setpoint_position": "Lagesollwert:mm",
            "command": "Momentensollwert:N m",
        },
    ),
    (
        {"Position demand value": "inc", "Position actual value": "inc", "Torque actual value": "permille"},
        None,
        {
            "setpoint_position": "(Position demand value)",
            "position_load": "(Position actual value)",
            "torque": "(Torque actual value)",
        },
    ),
    (
        {"fActPos": "mm", "fSetPos": "mm", "fActVelo": "mm/s", "nActTorque": "percent", "fPosDiff": "mm"},
        None,
        {
            "position_load": "fActPos:mm",
            "setpoint_position": "fSetPos:mm",
            "velocity_load": "fActVelo:mm/s",
            "torque": "(nActTorque)",
        },
    ),
    (
        {"joint.1.motor-pos-cmd": "", "joint.1.motor-pos-fb": "", "pid.y.output": "", "pid.y.error": ""},
        None,
        {
            "setpoint_position": "joint.1.motor-pos-cmd",
            "position_motor": "joint.1.motor-pos-fb",
            "command": "pid.y.output",
        },
    ),
    (
        {"cmd": "mm", "fb": "mm", "u": "V"},
        None,
        {"setpoint_position": "cmd:mm", "position_load": "fb:mm", "command": "u:V"},
    ),
    (
        {"target": "", "actual": "", "force": "percent"},
        None,
        {"setpoint_position": "target", "position_load": "actual", "force": "(force)"},
    ),
    (
        {"s_soll": "mm", "s_ist": "mm", "v_ist": "mm/s"},
        None,
        {"setpoint_position": "s_soll:mm", "position_load": "s_ist:mm", "velocity_load": "v_ist:mm/s"},
    ),
]


def at_rest(units: Mapping[str, str]) -> Log:
    """A log whose samples tell nothing: too short."""
    values = np.sin(np.arange(50.0))
    stamps = 1e-3 * np.arange(50)
    return Log(name="a", time=stamps, channels=dict.fromkeys(units, values), units=dict(units), sample_time=1e-3)


@pytest.mark.parametrize(("units", "axis", "roles"), NAMED)
def test_the_names_of_makers(units: dict[str, str], axis: str | None, roles: dict[str, str]) -> None:
    guess = guess_roles(at_rest(units), axis)
    found = {role: f"{column.name}:{column.unit}".rstrip(":") for role, column in guess.mapping.items()}
    found |= {role: f"({need.column})" for role, need in guess.needs.items()}
    assert found == roles


# the columns of a public data set of a milling machine with 48 columns ("CNC mill tool wear")
_MOTIONS = [f"{what}{of}" for what in ("Actual", "Command") for of in ("Position", "Velocity", "Acceleration")]
_DRIVES = ["CurrentFeedback", "DCBusVoltage", "OutputCurrent", "OutputVoltage"]
MILL = [
    *(f"{axis}1_{kind}" for axis in "XYZS" for kind in (*_MOTIONS, *_DRIVES)),
    *("X1_OutputPower", "Y1_OutputPower", "S1_OutputPower", "S1_SystemInertia"),
    *("M1_CURRENT_PROGRAM_NUMBER", "M1_sequence_number", "M1_CURRENT_FEEDRATE", "Machining_Process"),
]


@pytest.mark.parametrize("axis", ["x", "Y1", "z1"])
def test_a_log_of_48_columns_gives_one_axis_at_a_time(axis: str) -> None:
    """Y1 was taken for the table of X1, and the voltage of the bus for the command."""
    assert len(MILL) == 48
    guess = guess_roles(at_rest(dict.fromkeys(MILL, "")), axis)
    letter = axis[0].upper()
    assert guess.axes == ("x1", "y1", "z1", "s1")
    assert {role: column.name for role, column in guess.mapping.items()} == {
        "setpoint_position": f"{letter}1_CommandPosition",
        "setpoint_velocity": f"{letter}1_CommandVelocity",
        "position_load": f"{letter}1_ActualPosition",
        "velocity_load": f"{letter}1_ActualVelocity",
        "acceleration_load": f"{letter}1_ActualAcceleration",
        "current": f"{letter}1_CurrentFeedback",
    }
    assert "supply of the drive" in guess.unused[f"{letter}1_DCBusVoltage"]
    other = "Y" if letter != "Y" else "X"
    assert guess.unused[f"{other}1_ActualPosition"] == f"of axis {other.lower()}1, not {letter.lower()}1"
    with pytest.raises(ParameterError, match="no channel names the axis 'm'; there are: x1, y1, z1, s1"):
        guess_roles(at_rest(dict.fromkeys(MILL, "")), "m")


def test_motor_and_table_of_one_axis_are_no_two_axes() -> None:
    """x1 and x2 are the encoders of one axis in papers; with a current each they are two axes."""
    assert set(axes_of(["x1_pos", "x2_pos", "x1_set", "force"]).values()) == {""}
    two = axes_of(["x1_pos", "x2_pos", "x1_current", "x2_current"])
    assert two == {"x1_pos": "x1", "x2_pos": "x2", "x1_current": "x1", "x2_current": "x2"}
    assert axes_of(["X_set", "C_set", "X_ist", "C_ist", "temperature"])["C_ist"] == "c"
    assert read_name("X1_OutputVoltage", "V").quantity == ""


def test_each_column_has_its_reason_and_its_option() -> None:
    guess = guess_roles(at_rest(dict.fromkeys(MILL, "") | {"extra [mm]": "mm", "X1_Torque": "percent"}))
    rows = guess.proposed()
    assert {row.column for row in rows} == {*MILL, "extra [mm]", "X1_Torque"}
    assert all(row.why and "\n" not in row.why for row in rows)
    options = {row.role: row.option for row in rows if row.role}
    assert options["position_load"] == "--position 'X1_ActualPosition'"
    assert options["velocity_load"] == "--velocity 'X1_ActualVelocity'"
    assert options["acceleration_load"] == "acceleration_load = 'X1_ActualAcceleration' in a file for --channels"
    asking = {row.column: row.asks for row in rows if row.asks}
    assert asking == {"X1_Torque": "rated"}


# rows without a head


def halsampler(path: Path, tag: bool, *columns: np.ndarray) -> Path:
    rows = np.column_stack(columns)
    lines = ("".join(f"{value:f} " for value in row) for row in rows)
    path.write_text("".join(f"{f'{k} ' if tag else ''}{line}\n" for k, line in enumerate(lines)), encoding="utf-8")
    return path


@pytest.mark.parametrize("tag", [False, True])
@pytest.mark.parametrize("seed", [0, 1, 5])
def test_rows_of_halsampler_are_known_by_their_samples(seed: int, tag: bool, tmp_path: Path) -> None:
    """Set position and position in mm, command as a share: in three orders, with and without numbers of samples."""
    run = motion(seed)
    signals = {
        "setpoint_position": 1e3 * run.set_position,
        "position_load": 1e3 * run.table,
        "command": run.force / run.rated,
    }
    names = list(np.random.default_rng(seed).permutation([*signals, "error"]))
    signals["error"] = signals["setpoint_position"] - signals["position_load"]
    path = halsampler(tmp_path / "log.txt", tag, *(signals[name] for name in names))
    with pytest.raises(LogError, match=r"halsampler writes .*--sample-time 0\.001"):
        read_log(path)
    guess = guess_roles(read_log(path, sample_time=run.T))
    first = 2 if tag else 1
    found = {role: names[int(column.name.removeprefix("column_")) - first] for role, column in guess.mapping.items()}
    assert found == {role: role for role in ("setpoint_position", "position_load", "command")}
    assert all("by its samples" in reason for reason in guess.mapping.reasons.values())
    assert guess.doubts == ()


def test_an_accelerometer_of_klipper_has_its_unit(tmp_path: Path) -> None:
    rows = "".join(f"{k / 3200:.6f},{k % 7:.6f},{k % 5:.6f},{9810 + k % 3:.6f}\n" for k in range(300))
    path = tmp_path / "raw_data.csv"
    path.write_text("#time,accel_x,accel_y,accel_z\n" + rows, encoding="utf-8")
    log = read_log(path)
    assert log.units["accel_x"] == "mm/s2"
    assert log.sample_time == pytest.approx(1.0 / 3200, rel=1e-5)
    guess = guess_roles(log, "y")
    assert guess.mapping["acceleration_load"].name == "accel_y"


def test_a_closed_loop_driver_of_duet_is_in_steps(tmp_path: Path) -> None:
    rows = [f"{k},{0.5 * k:.2f},{0.1 * k:.2f},{0.1 * k + 0.05:.2f},{k % 9}.0,{k % 4}.0000" for k in range(300)]
    path = tmp_path / "closed_loop.csv"
    head = "Sample,Timestamp,Measured Motor Steps,Target Motor Steps,PID Control Signal,PID P Term"
    path.write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
    guess = guess_roles(read_log(path))
    assert {role: need.column for role, need in guess.needs.items()} == {
        "setpoint_position": "Target Motor Steps",
        "position_motor": "Measured Motor Steps",
    }
    assert guess.mapping["command"].name == "PID Control Signal"
    path.write_text("\n".join([head, *rows, "Data lost"]) + "\n", encoding="utf-8")
    with pytest.raises(LogError, match="line 302 has 1 cells"):
        read_log(path)


# two channels of the same name


def twins(run: Motion, **columns: np.ndarray) -> Log:
    return Log(name="a", time=run.time, channels=columns, units=dict.fromkeys(columns, ""), sample_time=run.T)


def test_two_positions_are_told_apart_by_their_samples() -> None:
    run, other = motion(1), motion(3)
    rows = min(run.table.size, other.table.size)
    guess = guess_roles(twins(run, pos_a=run.table, pos_b=run.set_position, force=run.force))
    assert (guess.mapping["setpoint_position"].name, guess.mapping["position_load"].name) == ("pos_b", "pos_a")
    guess = guess_roles(twins(run, set_position=run.set_position, pos_a=run.table, pos_b=run.motor, force=run.force))
    assert (guess.mapping["position_motor"].name, guess.mapping["position_load"].name) == ("pos_b", "pos_a")
    assert "runs ahead" in guess.mapping.reasons["position_motor"]
    channels = {"pos_a": run.table[:rows], "pos_b": other.table[:rows], "force": run.force[:rows]}
    log = Log(name="a", time=run.time[:rows], channels=channels, units={}, sample_time=run.T)
    assert "moves otherwise" in guess_roles(log).unused["pos_b"]


@pytest.mark.parametrize(("gain", "role"), [(1.3, "setpoint_position"), (1.8, "position_motor")])
def test_a_second_position_of_another_size_is_an_encoder(gain: float, role: str) -> None:
    run = motion(1)
    guess = guess_roles(twins(run, pos_a=run.table, pos_b=gain * run.set_position, force=run.force))
    assert role in guess.mapping


# drawn files


@pytest.mark.parametrize("seed", range(7))
def test_a_drawn_file_gives_its_roles(seed: int, tmp_path: Path) -> None:
    """Seven styles of names, units, percent, kN, separators and a second axis: the columns of the first axis."""
    file = drawn(seed, tmp_path)
    log = read_log(file.path)
    axes = axes_in(log.channels, log.units)
    axis = next((axis for axis in axes if axis.startswith(file.axis)), None)
    guess = guess_roles(log, axis)
    found = {role: column.name for role, column in guess.mapping.items()} | {
        r: n.column for r, n in guess.needs.items()
    }
    names = {"set": "setpoint_position", "position": "position_load", "force": "force"}
    assert {name: found.get(role) for name, role in names.items()} == file.roles, file.said
    assert not [doubt for doubt in guess.doubts if doubt.certain], file.said

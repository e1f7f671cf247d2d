"""Tables of pitch error and backlash in the forms of three makers, read back; LinuxCNC's in a real LinuxCNC."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from feeddrive.blocks.compensation.pitch_compensation import PitchCompensation
from feeddrive.export import linuxcnc_session as session
from feeddrive.export.design import read_design
from feeddrive.export.linuxcnc import write_linuxcnc
from feeddrive.export.pitch_tables import pitch_file
from feeddrive.export.targets import write_export
from feeddrive.files.machine import machine_toml, read_machine
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine
from hal_programs import needs_linuxcnc

PLACE = np.array([-0.02, 0.0, 0.02, 0.04, 0.06])  # m
ERROR = np.array([2e-6, 0.0, -3e-6, -7e-6, -4e-6])  # m, reached minus nominal, without backlash
GAP = np.array([2e-6, 3e-6, 3e-6, 4e-6, 3e-6])  # m by which the table lags the encoder after a reversal
# the table lags the motion by half of the gap
REACHED = {"forward": ERROR - 0.5 * GAP, "backward": ERROR + 0.5 * GAP}


def with_pitch(loop: Loop, count: int = 5, tables: int = 1) -> Loop:
    """A loop with the correction of these errors: what is added is nominal minus reached."""
    rows = {name: np.resize(-row, count) for name, row in REACHED.items()}
    block = PitchCompensation(**rows, table_start=-0.02, spacing=0.02)
    return replace(loop, control=replace(loop.control, compensation=(block,) * tables))


@pytest.fixture(scope="module")
def directory(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The parameters of the ball screw with the tables."""
    place = tmp_path_factory.mktemp("pitch")
    loop = with_pitch(read_machine("ball_screw").loop("x"))
    (place / "screw.toml").write_text(machine_toml(Machine.of({"x": loop}), "screw"), encoding="utf-8")
    return write_export(place / "screw.toml", "parameters", place / "out", axis="x")[1].parent


def test_linuxcnc_gets_nominal_positions_and_trims_of_both_directions(directory: Path) -> None:
    """Type 1: ascending positions in mm; what is added in either direction. No comment, which would end the table."""
    rows = np.loadtxt((directory / "linuxcnc_pitch_x.txt").read_text().splitlines())
    assert np.allclose(rows[:, 0], 1e3 * PLACE, atol=1e-9)
    assert np.allclose(rows[:, 1], -1e3 * REACHED["forward"], atol=1e-9)
    assert np.allclose(rows[:, 2], -1e3 * REACHED["backward"], atol=1e-9)


def test_sinumerik_gets_the_mean_of_what_was_reached_and_a_backlash(directory: Path) -> None:
    """A positive value moves the axis in the negative direction; a backlash is positive if the encoder leads."""
    lines = (directory / "sinumerik_pitch_x.ini").read_text().splitlines()
    assert (lines[0], lines[1], lines[-1]) == ("%_N_AX_EEC_INI", "CHANDATA(1)", "M17")
    found = {k: float(v) for k, v in re.findall(r"^\$AA_(\w+\[[\w,]+\])=(\S+)$", "\n".join(lines), re.MULTILINE)}
    values = [found[f"ENC_COMP[0,{i},X1]"] for i in range(5)]
    assert np.allclose(values, 1e3 * ERROR, atol=1e-9)
    assert found["ENC_COMP_MIN[0,X1]"] == -20.0
    assert found["ENC_COMP_MAX[0,X1]"] == 60.0
    assert found["ENC_COMP_STEP[0,X1]"] == 20.0
    assert found["ENC_COMP_IS_MODULO[0,X1]"] == 0.0
    readme = (directory / "README.md").read_text()
    assert "`MD32450 $MA_BACKLASH[0]` = `0.003`" in readme  # mm, the mean of the gaps
    assert "leave up to 0.5 um" in readme  # half of the largest deviation of a gap from 3 um


def test_twincat_gets_the_same_mean_as_an_array(directory: Path) -> None:
    text = (directory / "twincat_pitch_x.st").read_text()
    rows = np.array(re.findall(r"\(Position := (\S+), Compensation := (\S+)\)", text), dtype=float)
    assert np.allclose(rows, np.column_stack([1e3 * PLACE, 1e3 * ERROR]), atol=1e-9)
    assert "ARRAY[0..4] OF ST_PositionCompensationTableElement" in text
    assert "NoOfTableElements := 5" in text
    assert "NOT CHECKED" in text


def test_a_table_that_is_written_is_not_listed_as_missing(directory: Path) -> None:
    """ODrive has no table: there the compensation is missing."""
    parts = (directory / "README.md").read_text().split("\n## ")
    missing = {part.split("\n")[0]: "control.compensation.0" in part for part in parts[1:-1]}
    assert sum(missing.values()) == 1
    assert next(title for title, lost in missing.items() if lost).startswith("ODrive")


def test_without_a_table_there_is_no_file_and_no_section(tmp_path: Path) -> None:
    place = write_export("ball_screw", "parameters", tmp_path / "out", axis="x")[1].parent
    assert not list(place.glob("*pitch*"))
    assert "Pitch error" not in (place / "README.md").read_text()


@pytest.mark.parametrize(("count", "written"), [(256, True), (257, False)])
def test_linuxcnc_reads_256_positions(count: int, written: bool) -> None:
    found = pitch_file("linuxcnc", with_pitch(read_machine("ball_screw").loop("x"), count))
    assert found is not None
    assert bool(found.name) == written
    assert ("257 positions, and LinuxCNC reads 256" in found.absent) == (not written)


def test_two_tables_are_not_one_and_an_axis_that_turns_has_degrees() -> None:
    loop = with_pitch(read_machine("ball_screw").loop("x"), tables=2)
    two = pitch_file("sinumerik", loop)
    assert two is not None
    assert "add them up" in two.absent
    table = with_pitch(read_machine("rotary_table").loop("c"))
    assert pitch_file("linuxcnc", table) is None
    turning = pitch_file("sinumerik", table)
    assert turning is not None
    assert f"$AA_ENC_COMP_STEP[0,C1]={math.degrees(0.02):.6f}" in turning.text
    assert pitch_file("odrive", table) is None


RUNNER = """\
#!/usr/bin/python3
import struct, sys, time
import hal, linuxcnc

component = hal.component("recorder")
stream = hal.stream(component, 0x48534130)
component.ready()
row = struct.Struct("<%dd" % len(stream.element_types))
out = open("out.bin", "wb")
command, status = linuxcnc.command(), linuxcnc.stat()


def drain():
    while stream.readable:
        out.write(row.pack(*map(float, stream.read())))


def wait(test, patience=40.0):
    until = time.monotonic() + patience
    while time.monotonic() < until:
        status.poll()
        drain()
        if test():
            return
        time.sleep(0.002)
    sys.exit("no end")


def ask(method, *arguments):
    method(*arguments)
    command.wait_complete()
    drain()


ask(command.state, linuxcnc.STATE_ESTOP_RESET)
ask(command.state, linuxcnc.STATE_ON)
ask(command.mode, linuxcnc.MODE_MANUAL)
ask(command.teleop_enable, 0)
ask(command.home, -1)
wait(lambda: all(status.homed[: status.joints]))
ask(command.mode, linuxcnc.MODE_MDI)
for place in (70, -30, 30):
    command.mdi("G1 F3000 X%g" % place)
    wait(lambda: abs(status.joint_position[0] - place) < 1e-3 and status.interp_state == linuxcnc.INTERP_IDLE)
drain()
ask(command.state, linuxcnc.STATE_OFF)
out.close()
print("DONE, overruns:", stream.num_overruns, flush=True)
component.exit()
"""


@needs_linuxcnc
@pytest.mark.slow(reason="LinuxCNC as a whole moves an axis in its own time")
def test_linuxcnc_adds_the_table_to_the_command_of_the_motor(directory: Path, tmp_path: Path) -> None:
    """The desk of an axis with the file in its .ini: motor command less command, within 50 nm away from reversals."""
    folder = tmp_path / "desk"
    design = read_design("emps", "x")
    write_linuxcnc(design, folder)
    (folder / "pitch.txt").write_text((directory / "linuxcnc_pitch_x.txt").read_text())
    ini = (folder / "axis_x.ini").read_text()
    assert "[JOINT_0]" in ini
    ini = ini.replace("[JOINT_0]", "[JOINT_0]\nCOMP_FILE = pitch.txt\nCOMP_FILE_TYPE = 1")
    (folder / "axis_x.ini").write_text(
        re.sub(r"(M(?:IN|AX)_LIMIT) = .*", r"\1 = 100", ini).replace("MIN_LIMIT = 100", "MIN_LIMIT = -100")
    )
    (folder / "runner.py").write_text(RUNNER)
    (folder / "runner.py").chmod(0o755)
    pins = ["joint.0.pos-cmd", "joint.0.motor-pos-cmd", "joint.0.vel-cmd"]
    nets = {"joint.0.motor-pos-cmd": "axis-x-position-cmd", "joint.0.vel-cmd": "axis-x-velocity-cmd"}
    record = ["loadrt sampler depth=50000 cfg=fff", "addf sampler.0 servo-thread"]
    record += [f"net {nets.get(pin, f'record-{i}')} {pin} => sampler.0.pin.{i}" for i, pin in enumerate(pins)]
    (folder / "record.hal").write_text("\n".join(record) + "\n")
    desk = (folder / "desk.ini").read_text().replace("DISPLAY = axis", f"DISPLAY = {folder}/runner.py")
    (folder / "desk.ini").write_text(desk.replace("HALFILE = desk.hal", "HALFILE = desk.hal\nHALFILE = record.hal"))
    components = [folder / "axis_x.comp", folder / "axis_x_plant.comp"]
    printed = session.session(folder, components, "linuxcnc -r desk.ini", 120.0)
    assert "DONE, overruns: 0" in printed, printed
    command, motor, velocity = np.fromfile(folder / "out.bin").reshape(-1, 3).T
    for sign, name in ((1.0, "forward"), (-1.0, "backward")):
        steady = sign * velocity > 49.0  # mm/s: far from a reversal, over which the change of direction is spread
        inside = steady & (command > -15.0) & (command < 55.0)
        assert np.sum(inside) > 1000
        wanted = np.interp(command[inside], 1e3 * PLACE, -1e3 * REACHED[name])
        assert np.max(np.abs(motor[inside] - command[inside] - wanted)) < 5e-5

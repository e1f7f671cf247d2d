"""A compensation file in a whole LinuxCNC, headless: what it adds to the position of the motor, in both directions."""

from __future__ import annotations

import itertools
import os
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import pytest

from feeddrive.blocks.compensation.pitch_compensation import PitchCompensation
from feeddrive.files.handover import write_comp_file
from hal_programs import needs_linuxcnc

pytestmark = [pytest.mark.slow(reason="LinuxCNC as a whole moves in its own time"), needs_linuxcnc]

PLACES = (0, 25, 50, 75, 60, 25, 0, -25, 0, 25)  # mm
_AXIS = "MIN_LIMIT = -200\nMAX_LIMIT = 200\nMAX_VELOCITY = 50\nMAX_ACCELERATION = 500\n"
_JOINT = f"TYPE = LINEAR\nHOME = 0\n{_AXIS}STEPGEN_MAXACCEL = 600\nFERROR = 5\nMIN_FERROR = 5\nHOME_SEARCH_VEL = 0\n"
_HEAD = """\
[EMC]
VERSION = 1.1
[DISPLAY]
DISPLAY = ./runner.py
[TASK]
TASK = milltask
CYCLE_TIME = 0.001
[RS274NGC]
PARAMETER_FILE = t.var
[EMCMOT]
EMCMOT = motmod
SERVO_PERIOD = 1000000
[HAL]
HALFILE = t.hal
[TRAJ]
COORDINATES = X Y Z
LINEAR_UNITS = mm
ANGULAR_UNITS = degree
MAX_LINEAR_VELOCITY = 50
NO_FORCE_HOMING = 1
[KINS]
KINEMATICS = trivkins coordinates=XYZ
JOINTS = 3
[EMCIO]
EMCIO = io
CYCLE_TIME = 0.1
TOOL_TABLE = t.tbl
"""
_HAL = """\
loadrt [KINS]KINEMATICS
loadrt [EMCMOT]EMCMOT servo_period_nsec=[EMCMOT]SERVO_PERIOD num_joints=[KINS]JOINTS
addf motion-command-handler servo-thread
addf motion-controller servo-thread
net x joint.0.motor-pos-cmd => joint.0.motor-pos-fb
net y joint.1.motor-pos-cmd => joint.1.motor-pos-fb
net z joint.2.motor-pos-cmd => joint.2.motor-pos-fb
net estop iocontrol.0.user-enable-out => iocontrol.0.emc-enable-in
"""
_RUNNER = """\
#!/usr/bin/python3
import linuxcnc, subprocess, time
command, status = linuxcnc.command(), linuxcnc.stat()

def wait(test):
    end = time.time() + 20.0
    while time.time() < end:
        status.poll()
        if test():
            return
        time.sleep(0.02)
    raise SystemExit("timeout")

time.sleep(1.0)
for state in (linuxcnc.STATE_ESTOP_RESET, linuxcnc.STATE_ON):
    command.state(state)
    command.wait_complete()
command.mode(linuxcnc.MODE_MANUAL)
command.wait_complete()
for joint in range(3):
    command.home(joint)
    wait(lambda: status.homed[joint])
command.mode(linuxcnc.MODE_MDI)
command.wait_complete()
for x in PLACES:
    command.mdi(f"G1 F1200 X{x}")
    command.wait_complete(20)
    wait(lambda: status.inpos)
    time.sleep(0.4)
    rows = [subprocess.check_output(["halcmd", "getp", f"joint.0.{pin}"]) for pin in ("pos-cmd", "motor-pos-cmd")]
    with open("out.txt", "a") as out:
        out.write(" ".join(f"{float(row.split()[0]):.9f}" for row in rows) + "\\n")
"""


@pytest.mark.parametrize("file_type", [0, 1])
def test_linuxcnc_adds_what_the_block_adds(file_type: int, tmp_path: Path) -> None:
    block = PitchCompensation(
        forward=1e-3 * np.array([0.1, 0.3, 0.5, 0.1, 0.2]),
        backward=1e-3 * np.array([-0.2, 0.1, 0.2, -0.3, -0.1]),
        table_start=-0.1,
        spacing=0.05,
    )
    write_comp_file(block, tmp_path / "x.comp", file_type=file_type)
    joints = (
        "".join(f"[JOINT_{i}]\n{_JOINT}" for i in (1, 2, 0)) + f"COMP_FILE = x.comp\nCOMP_FILE_TYPE = {file_type}\n"
    )
    axes = "".join(f"[AXIS_{letter}]\n{_AXIS}" for letter in "XYZ")
    (tmp_path / "t.ini").write_text(_HEAD + axes + joints)
    (tmp_path / "t.hal").write_text(_HAL)
    (tmp_path / "runner.py").write_text(_RUNNER.replace("PLACES", repr(PLACES)))
    (tmp_path / "runner.py").chmod(0o755)
    for name in ("t.var", "t.tbl"):
        (tmp_path / name).touch()
    with tempfile.TemporaryDirectory(prefix="feeddrive-") as place:
        Path(place).chmod(0o777)  # LinuxCNC does not run as root: its user makes a socket there
        env = {**os.environ, "RTAPI_UID": "65534", "RTAPI_FIFO_PATH": f"{place}/socket", "HOME": str(tmp_path)}
        done = subprocess.run(
            ["linuxcnc", "-r", "t.ini"], cwd=tmp_path, env=env, capture_output=True, text=True, timeout=120, check=False
        )
    assert (tmp_path / "out.txt").exists(), done.stdout[-2000:] + done.stderr[-2000:]
    found = np.loadtxt(tmp_path / "out.txt")
    at = -100.0 + 50.0 * np.arange(5)
    ways = [1, *(1 if after > before else -1 for before, after in itertools.pairwise(PLACES))]
    for (place, motor), way in list(zip(found, ways, strict=True))[1:]:
        row = block.forward if way > 0 else block.backward
        assert motor - place == pytest.approx(np.interp(place, at, 1e3 * row), abs=1e-5)  # mm: digits of a HAL pin

"""A whole LinuxCNC, headless: G-code, its planner, our controller, our axis as a HAL component."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from feeddrive.blocks.coupling.cross_beam import CrossBeam
from feeddrive.blocks.coupling.cross_coupled import CrossCoupled
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.export import linuxcnc_session as session
from feeddrive.export.design import read_design
from feeddrive.export.linuxcnc import hal, input_pin, write_linuxcnc
from feeddrive.export.linuxcnc_session import HalError, output_pin
from feeddrive.files.machine import machine_toml, read_machine
from feeddrive.language.errors import MissingProgramError
from feeddrive.loop.loop import quantity
from feeddrive.loop.machine import Machine
from feeddrive.loop.routine import run


def _missing() -> str:
    try:
        session.check_session()
    except (MissingProgramError, HalError) as error:
        return f"NOT TESTED against LinuxCNC: {error!s}"
    return ""


pytestmark = [
    pytest.mark.slow(reason="LinuxCNC as a whole runs a program in its own time"),
    pytest.mark.skipif(bool(_missing()), reason=_missing()),
]

PROGRAM = """\
G21 G90 G64
G0 {axis}10
G1 {axis}60 F12000
G1 {axis}20 F3000
G4 P0.1
G0 {axis}0
M2
"""

# stands in for a graphical interface: switches on, homes, jogs, runs the program, and drains the sampler
RUNNER = """\
#!/usr/bin/python3
import struct, sys, time
import hal, linuxcnc

component = hal.component("recorder")
stream = hal.stream(component, 0x48534130)
component.ready()
row = struct.Struct("<%dd" % len(stream.element_types))
out = open("out.bin", "wb")
command, status, errors = linuxcnc.command(), linuxcnc.stat(), linuxcnc.error_channel()


def drain():
    while stream.readable:
        out.write(row.pack(*map(float, stream.read())))


def wait(what, test, patience=30.0):
    until = time.monotonic() + patience
    while time.monotonic() < until:
        status.poll()
        drain()
        said = errors.poll()
        if said:
            print("SAID", said, flush=True)
        if test():
            return
        time.sleep(0.002)
    sys.exit("no end of: " + what)


def ask(method, *arguments):
    method(*arguments)
    command.wait_complete()
    drain()


wait("start", lambda: True)
ask(command.state, linuxcnc.STATE_ESTOP_RESET)
ask(command.state, linuxcnc.STATE_ON)
wait("machine on", lambda: status.task_state == linuxcnc.STATE_ON)
ask(command.mode, linuxcnc.MODE_MANUAL)
ask(command.teleop_enable, 0)
ask(command.home, -1)
wait("home", lambda: all(status.homed[: status.joints]))
ask(command.teleop_enable, 1)
command.jog(linuxcnc.JOG_INCREMENT, False, {index}, 20.0, 5.0)
wait("jog", lambda: abs(status.position[{index}] - 5.0) < 1e-3)
time.sleep(0.2)
ask(command.mode, linuxcnc.MODE_AUTO)
ask(command.program_open, sys.path[0] + "/program.ngc")
command.auto(linuxcnc.AUTO_RUN, 0)
wait("program started", lambda: status.interp_state != linuxcnc.INTERP_IDLE)
wait("program", lambda: status.interp_state == linuxcnc.INTERP_IDLE)
time.sleep(0.3)
drain()
ask(command.state, linuxcnc.STATE_OFF)
time.sleep(0.1)
drain()
out.close()
print("DONE, overruns:", stream.num_overruns, flush=True)
component.exit()
"""


@pytest.mark.parametrize(("machine", "axis"), [("emps", "x"), ("xy_table", "y")])
def test_every_servo_cycle_of_a_program_is_the_simulators(tmp_path, machine, axis):
    """`linuxcnc desk.ini` as it was exported, with a script for its interface; each cycle replayed bit for bit."""
    design = read_design(machine, axis)
    write_linuxcnc(design, tmp_path / "desk")
    routine, folder = design.routine, tmp_path / "desk"
    letter = axis.upper()
    index = "XYZ".index(letter)
    (folder / "program.ngc").write_text(PROGRAM.format(axis=letter))
    (folder / "runner.py").write_text(RUNNER.replace("{index}", str(index)))
    (folder / "runner.py").chmod(0o755)
    c, p = hal(routine.name), hal(f"{routine.name}_plant")
    pins = [f"{c}.{input_pin(v.name)}" for v in routine.inputs]
    pins += [f"{c}.{pin}" for pin in ("force-cmd", "drive-cmd", "trip-code", "running", "fault-code")]
    pins.append(f"{p}.load-position")
    kinds = "".join(
        "s" if pin.endswith("code") else "b" if pin.endswith(("enable", "running")) else "f" for pin in pins
    )
    record = [f"loadrt sampler depth=50000 cfg={kinds}", "addf sampler.0 servo-thread"]
    desk_nets = _nets(folder / f"{routine.name}.hal") | _nets(folder / "desk.hal")
    record += [f"net {desk_nets.get(pin, f'record-{i}')} {pin} => sampler.0.pin.{i}" for i, pin in enumerate(pins)]
    (folder / "record.hal").write_text("\n".join(record) + "\n")
    ini = (folder / "desk.ini").read_text()
    ini = ini.replace("DISPLAY = axis", f"DISPLAY = {folder}/runner.py")
    (folder / "desk.ini").write_text(ini.replace("HALFILE = desk.hal", "HALFILE = desk.hal\nHALFILE = record.hal"))
    components = [folder / f"{routine.name}.comp", folder / f"{routine.name}_plant.comp"]
    printed = session.session(folder, components, "linuxcnc -r desk.ini", 120.0)
    assert "DONE, overruns: 0" in printed, printed
    assert "SAID" not in printed, printed
    rows = np.fromfile(folder / "out.bin").reshape(-1, len(pins))
    width = len(routine.inputs)
    given, fault, position = rows[:, :width].copy(), rows[:, -2], rows[:, -1]
    given[:, :-1] /= 1000.0  # as the component does
    assert np.all(fault == 0.0)
    answer = np.ascontiguousarray(rows[:, width:-2])
    expected = run(routine, given)
    assert np.array_equal(answer.view(np.uint64), expected.view(np.uint64))
    # it really moved: jog to 5 mm, 60 mm, home
    enabled = rows[:, width - 1] > 0.5
    assert abs(np.max(position) - 60.0) < 0.5
    assert abs(position[enabled][-1]) < 0.2
    assert np.max(np.abs(rows[:, 2])) > 100.0, "the planner gives its acceleration"
    _check_derivatives(rows[enabled], routine.sample_time)


CIRCLE = """\
G21 G90 G64
G1 X20 Y0 F6000
G2 X20 Y0 I-20 J0 F6000
G1 X-5 Y7
G0 X0 Y0
M2
"""


def test_every_servo_cycle_of_two_axes_under_cross_coupled_control_is_the_simulators(tmp_path):
    """One component for both joints; a circle in G-code; each cycle replayed bit for bit."""
    machine = read_machine("xy_table").machine(CrossCoupled(contour_axes=("x", "y"), contour_gain=60.0))
    source = tmp_path / "table.toml"
    source.write_text(machine_toml(machine, "table"))
    design = read_design(source, name="axes", together=True)
    write_linuxcnc(design, tmp_path / "desk")
    routine, folder = design.routine, tmp_path / "desk"
    (folder / "program.ngc").write_text(CIRCLE)
    (folder / "runner.py").write_text(RUNNER.replace("{index}", "0"))
    (folder / "runner.py").chmod(0o755)
    outputs = [output_pin(v.path) for v in routine.outputs if quantity(v.path) in ("force", "trip")]
    pins = [f"axes.{input_pin(v.path)}" for v in routine.inputs] + [f"axes.{pin}" for pin, _ in outputs]
    pins += ["axes.x.fault-code", "axes.y.fault-code"]
    kinds = "".join("s" if pin.endswith("code") else "b" if pin.endswith("enable") else "f" for pin in pins)
    rows = _recorded(folder, pins, kinds)
    width = len(routine.inputs)
    given = rows[:, :width].copy()
    lengths = [i for i, v in enumerate(routine.inputs) if quantity(v.path) != "enable"]
    given[:, lengths] /= 1000.0  # as the component does
    assert np.all(rows[:, -2:] == 0.0)
    expected = run(routine, given)
    chosen = [i for i, v in enumerate(routine.outputs) if quantity(v.path) in ("force", "trip")]
    answer = np.ascontiguousarray(rows[:, width:-2])
    assert np.array_equal(answer.view(np.uint64), np.ascontiguousarray(expected[:, chosen]).view(np.uint64))
    x, y = (rows[:, pins.index(f"axes.{axis}.position-cmd")] for axis in "xy")
    assert np.ptp(x) > 39.0, "it went around the circle"
    assert np.ptp(y) > 39.0


def test_both_drives_of_a_beam_follow_one_word_of_a_program(tmp_path):
    """`coordinates=XYY`: both joints are homed, commanded alike and without a fault; the beam follows the program."""
    file = read_machine("gantry")
    y = file.loops["y"]
    half = replace(y, axis=replace(y.axis, plant=Rigid(mass=110.0)))
    y, y2 = (
        replace(half, control=replace(half.control, law=replace(half.control.law, Kp=Kp))) for Kp in (3.3e4, 2.5e4)
    )
    beam = CrossBeam(axis="y", follower="y2", stiffness=4e7, damping=3000.0)
    machine = Machine.of({"x": file.loops["x"], "y": y, "y2": y2}, (*file.couplings, beam))
    source = tmp_path / "portal.toml"
    source.write_text(machine_toml(machine, "portal"))
    folder = tmp_path / "desk"
    write_linuxcnc(read_design(source, name="axes", together=True), folder)
    (folder / "program.ngc").write_text(CIRCLE)
    (folder / "runner.py").write_text(RUNNER.replace("{index}", "0"))
    (folder / "runner.py").chmod(0o755)
    names = ["position-cmd", "fault-code", "running"]
    pins = [f"axes.{axis}.{name}" for axis in ("x", "y", "y2") for name in names]
    pins += [f"axes-plant.{axis}.load-position" for axis in ("y", "y2")]
    kinds = "".join({"fault-code": "s", "running": "b"}.get(pin.rpartition(".")[2], "f") for pin in pins)
    found = dict(zip(pins, _recorded(folder, pins, kinds).T, strict=True))
    assert all(np.all(found[f"axes.{axis}.fault-code"] == 0.0) for axis in ("x", "y", "y2"))
    on = found["axes.y.running"] > 0.5  # off, the command of a joint is where its drive stands
    assert np.sum(on) > 5000
    assert np.array_equal(found["axes.y.position-cmd"][on], found["axes.y2.position-cmd"][on])
    assert np.ptp(found["axes.y.position-cmd"]) > 39.0
    skew = found["axes-plant.y.load-position"] - found["axes-plant.y2.load-position"]
    assert 1e-4 < np.max(np.abs(skew)) < 0.1, "mm: the laws differ, and the beam holds them together"


def _check_derivatives(rows, T):
    """`acc-cmd` and `vel-cmd` are the derivatives at the sample: Taylor from one cycle to the next, jerk excepted.

    The planner's acceleration is steady but for its steps: in nine cycles of ten the set position of the next cycle
    follows to rounding, 1 nm in some tens of mm.
    """
    x, v, a = rows[:, 0], rows[:, 1], rows[:, 2]
    rest = np.abs(x[:-1] + T * v[:-1] + 0.5 * T * T * a[:-1] - x[1:])
    moving = np.abs(v[:-1]) > 1.0
    assert np.mean(rest[moving] < 1e-6) > 0.9
    assert np.mean(np.abs(v[:-1] + T * a[:-1] - v[1:])[moving] < 1e-6) > 0.9


def _nets(file: Path) -> dict[str, str]:
    """Signal of every pin in a .hal file."""
    found = {}
    for line in file.read_text().splitlines():
        words = [word for word in line.split() if word not in ("=>", "<=")]
        if words[:1] == ["net"]:
            found |= dict.fromkeys(words[2:], words[1])
    return found


def _recorded(folder: Path, pins: Sequence[str], kinds: str) -> np.ndarray:
    """Run the program of a folder in a whole LinuxCNC; the pins in each servo cycle."""
    record = [f"loadrt sampler depth=50000 cfg={kinds}", "addf sampler.0 servo-thread"]
    nets = _nets(folder / "axes.hal") | _nets(folder / "desk.hal")
    record += [f"net {nets.get(pin, f'record-{i}')} {pin} => sampler.0.pin.{i}" for i, pin in enumerate(pins)]
    (folder / "record.hal").write_text("\n".join(record) + "\n")
    ini = (folder / "desk.ini").read_text().replace("DISPLAY = axis", f"DISPLAY = {folder}/runner.py")
    (folder / "desk.ini").write_text(ini.replace("HALFILE = desk.hal", "HALFILE = desk.hal\nHALFILE = record.hal"))
    printed = session.session(folder, [folder / "axes.comp", folder / "axes_plant.comp"], "linuxcnc -r desk.ini", 120.0)
    assert "DONE, overruns: 0" in printed, printed
    assert "SAID" not in printed, printed
    return np.fromfile(folder / "out.bin").reshape(-1, len(pins))

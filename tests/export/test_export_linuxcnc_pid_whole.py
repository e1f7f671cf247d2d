"""A whole LinuxCNC, headless, on its own pids: G-code, its planner, the exported fragments, our axis as a component."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from export.test_export_linuxcnc_whole import PROGRAM, RUNNER
from feeddrive.blocks.controller.linuxcnc_pid import LinuxcncPid
from feeddrive.export.design import read_design
from feeddrive.export.drive_quantities import read_cascade
from feeddrive.export.linuxcnc import write_linuxcnc
from feeddrive.export.linuxcnc_pid import period, stock_law, write_linuxcnc_pid
from feeddrive.export.linuxcnc_session import session
from hal_programs import needs_linuxcnc

pytestmark = [pytest.mark.slow(reason="LinuxCNC as a whole runs a program in its own time"), needs_linuxcnc]

PINS = {
    "axis-x-set": ("axis-x.position.command", "f"),
    "axis-x-set-v": ("axis-x.forward.in1", "f"),
    "axis-x-set-a": ("axis-x.forward.in0", "f"),
    "axis-x-load": ("axis-x.position.feedback", "f"),
    "axis-x-enable": ("axis-x.position.enable", "b"),
    "axis-x-output": ("", "f"),
}


def desk(folder: Path, pids: Path, law: LinuxcncPid) -> None:
    """The desk of the component, with the fragments of the pids in the place of the component."""
    for file in ("axis-x.hal", "axis-x.ini"):
        (folder / file).write_bytes((pids / file).read_bytes())
    hal = (folder / "desk.hal").read_text()
    for old, new in {
        "source axis_x.hal": "source axis-x.hal\nloadrt mult2 names=amplifier\naddf amplifier servo-thread",
        "net axis-x-position-fb <=": "net axis-x-load <=",
        "net axis-x-force-cmd =>": "net axis-x-output => amplifier.in0\n"
        f"setp amplifier.in1 {float(law.force_per_output)!r}\nnet axis-x-force-cmd amplifier.out =>",
        "setp axis-x.late-limit 0": "",
    }.items():
        assert old in hal
        hal = hal.replace(old, new)
    (folder / "desk.hal").write_text(hal)
    # the joint of the desk keeps its limits; the numbers of the pids come into the same section
    numbers = (pids / "axis-x.ini").read_text().split("[JOINT_0]\n")[1]
    own = [line for line in numbers.splitlines() if not line.startswith(("FERROR", "MIN_", "MAX_"))]
    ini = (folder / "axis_x.ini").read_text().replace("[JOINT_0]\n", "[JOINT_0]\n" + "\n".join(own) + "\n")
    (folder / "axis_x.ini").write_text(ini)
    record = [
        f"loadrt sampler depth=50000 cfg={''.join(kind for _, kind in PINS.values())}",
        "addf sampler.0 servo-thread",
        *(f"net {net} {pin} => sampler.0.pin.{i}" for i, (net, (pin, _)) in enumerate(PINS.items())),
    ]
    (folder / "record.hal").write_text("\n".join(record) + "\n")
    ini = (folder / "desk.ini").read_text().replace("DISPLAY = axis", f"DISPLAY = {folder}/runner.py")
    (folder / "desk.ini").write_text(ini.replace("HALFILE = desk.hal", "HALFILE = desk.hal\nHALFILE = record.hal"))


def replayed(law: LinuxcncPid, rows: np.ndarray, T: float) -> np.ndarray:
    """What ddt, sum2 and the pids answer to recorded commands, positions and enables."""
    assert law.velocity is not None
    assert law.acceleration_gain is not None
    assert law.velocity_gain is not None
    position, velocity, before = law.position.start(0.0, 0.0), law.velocity.start(0.0, 0.0), np.float64(0.0)
    answers = []
    for command, speed, acceleration, feedback, enable in rows[:, :5]:
        motor, before = (feedback - before) / T, feedback
        forward = acceleration * law.acceleration_gain + speed * law.velocity_gain + law.velocity.bias
        position, wanted = law.position.step(position, command, feedback, T, enable=enable)
        velocity, output = law.velocity.step(velocity, wanted, motor, T, bias=forward, enable=enable)
        answers.append(output)
    return np.array(answers)


def test_every_servo_cycle_of_a_program_is_the_blocks(tmp_path: Path) -> None:
    """Switched on, homed, jogged, a program, switched off: each output of the last pid, replayed bit for bit."""
    design = read_design("xy_table", "x")
    cascade = read_cascade(design.loop)
    law = stock_law(cascade)
    folder = tmp_path / "desk"
    write_linuxcnc(design, folder)
    desk(folder, write_linuxcnc_pid(design, tmp_path / "pids").parent, law)
    (folder / "program.ngc").write_text(PROGRAM.format(axis="X"))
    (folder / "runner.py").write_text(RUNNER.replace("{index}", "0"))
    (folder / "runner.py").chmod(0o755)
    printed = session(folder, [folder / "axis_x_plant.comp"], "linuxcnc -r desk.ini", 120.0)
    assert "DONE, overruns: 0" in printed, printed
    assert "SAID" not in printed, printed
    rows = np.fromfile(folder / "out.bin").reshape(-1, len(PINS))
    output = rows[:, -1]
    assert np.array_equal(output, replayed(law, rows, period(design.loop)))
    enabled = rows[:, 4] > 0.5
    assert abs(np.max(rows[:, 3]) - 60.0) < 0.5  # mm: it really moved
    assert abs(rows[enabled][-1, 3]) < 0.2
    assert np.all(output[~enabled] == 0.0)
    assert np.any(output[enabled] != 0.0)

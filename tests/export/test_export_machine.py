"""A machine of several axes, exported: controls and coupled plant, in C and in an FMU, have the simulator's bits."""

from __future__ import annotations

import dataclasses
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.blocks.coupling.dynamometer_force import DynamometerForce
from feeddrive.blocks.coupling.force_record import ForceRecord
from feeddrive.blocks.coupling.milling_cut import MillingCut
from feeddrive.blocks.cutting.helical_cutter import HelicalCutter
from feeddrive.blocks.load.sine_force import SineForce
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.export.design import PLANT, read_design
from feeddrive.export.targets import write_all, write_export
from feeddrive.export.verify import verify_export
from feeddrive.files.machine import machine_toml, read_machine
from feeddrive.language.errors import FeeddriveError, ParameterError
from feeddrive.loop.loop import SETPOINT
from feeddrive.loop.machine import Machine
from feeddrive.loop.runner import Work
from feeddrive.loop.simulate import Run, simulate
from fmus import Played
from slow_share import all_but

HAS_GCC = pytest.mark.skipif(
    shutil.which("gcc") is None, reason="NOT TESTED: exported C needs gcc: apt-get install gcc"
)
MOVE = SnapLimitedMove(distance=0.004, velocity=0.1, acceleration=4.0, jerk=300.0, snap=4e4)
PATH = {"x": MOVE, "y": dataclasses.replace(MOVE, distance=-0.003)}
LOADS = {"y": SineForce(amplitude=150.0, frequency=37.0)}
SECONDS = 0.12
OUT = ("reading_motor", "reading_load", "position_motor", "position_load", "velocity_motor", "velocity_load")


def rich() -> Machine:
    """Two axes, a mode, a cut with a ring, a recorded force, encoder noise and a part of a sample of dead time."""
    file = read_machine("gantry")
    loops = {}
    for i, (name, loop) in enumerate(file.loops.items()):
        late = fd.blocks.Actuator(dead_time=(1.0 + 0.3 * i) * loop.sample_time, current_loop=800.0 if i else None)
        encoder = fd.blocks.Encoder(resolution=1e-7, noise=2e-8)
        axis = dataclasses.replace(loop.axis, substeps=2, encoder_load=encoder, actuator=late)
        loops[name] = dataclasses.replace(loop, axis=axis)
    cutter = dataclasses.replace(HelicalCutter.beltran2013(), axial_depth=2e-4)
    cut = MillingCut(cutter=cutter, spindle_speed=12000.0, cut_from=0.02, surfaces=1, direction=0.3, remembered=24)
    row = 40.0 * np.sin(np.arange(60.0))
    push = DynamometerForce(components=(ForceRecord(axis="x", row=row), ForceRecord(axis="y", row=-row)), interval=1e-3)
    return Machine.of(loops, (*file.couplings, cut, push))


def written(machine: Machine, place: Path) -> Path:
    path = place / "rich.toml"
    path.write_text(machine_toml(machine, "rich"), encoding="utf-8")
    return path


def run(machine: Machine) -> Run:
    still = dict.fromkeys(machine.axes(), (0.0, 0.0))
    return simulate(machine, PATH, load=LOADS, duration=SECONDS, start=still, seed=0)


def bits(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, dtype=np.float64).view(np.int64)


@HAS_GCC
@pytest.mark.parametrize("name", all_but(["gantry"], ["gantry", "rich"], "more couplings, whose plant compiles longer"))
def test_c_of_controls_and_plant_is_the_run_of_the_coupled_machine(name: str, tmp_path: Path) -> None:
    """Three exports in one C program, which knows nothing of feeddrive: every sample of both axes, bit for bit."""
    machine = rich() if name == "rich" else read_machine(name).machine()
    file = written(machine, tmp_path)
    (one, _), (two, _) = write_all(file, "c", tmp_path / "controls")
    plant, _ = write_export(file, "c", tmp_path / "plant", plant=True)
    assert [each.name for each in (one, two, plant)] == ["axis_x", "axis_y", "plant"]
    found = run(machine)
    rows = Work(machine, PATH, LOADS).sampled(0, len(found.time))
    names = [*(f"{axis}.{each}" for axis in PATH for each in SETPOINT), "x.load_force", "y.load_force"]
    given = np.column_stack([rows[name] for name in names])
    (tmp_path / "main.c").write_text(_MAIN, encoding="utf-8")
    folders = [tmp_path / "controls" / "x", tmp_path / "controls" / "y", tmp_path / "plant"]
    sources = [
        str(folder / f"{each.name}{part}.c")
        for folder, each in zip(folders, (one, two, plant), strict=True)
        for part in ("", "_configure")
    ]
    flags = [
        "-std=c99",
        "-O0",
        "-ffp-contract=off",
        "-Wall",
        "-Werror",
        "-Wno-unused-function",
        *(f"-I{folder}" for folder in folders),
    ]
    subprocess.run(["gcc", *flags, *sources, "main.c", "-o", "together", "-lm"], cwd=tmp_path, check=True)
    done = subprocess.run([tmp_path / "together"], input=given.tobytes(), capture_output=True, check=True)
    answers = np.frombuffer(done.stdout).reshape(len(given), 8)
    signals = [
        f"{axis}.{each}" for axis in PATH for each in ("reading_load", "position_load", "velocity_load", "force")
    ]
    for column, signal in enumerate(signals):
        assert np.array_equal(bits(answers[:, column]), bits(found[signal])), signal
    alone = simulate(machine.loop("x"), MOVE, duration=SECONDS, start=(0.0, 0.0), record=["position_load"])
    assert np.max(np.abs(found["x.position_load"] - alone["position_load"])) > 1e-7, "the couplings act"


_MAIN = """
#include "axis_x.h"
#include "axis_y.h"
#include "plant.h"
#include <stdio.h>

int main(void)
{
    static plant_plant plant;
    static axis_x_controller x;
    static axis_y_controller y;
    plant_parameters a;
    axis_x_parameters b;
    axis_y_parameters c;
    plant_inputs forces = {0};
    plant_outputs seen;
    double row[12];
    plant_defaults(&a);
    axis_x_defaults(&b);
    axis_y_defaults(&c);
    if (!plant_configure(&plant, &a) || !axis_x_configure(&x, &b) || !axis_y_configure(&y, &c)) return 1;
    plant_flush_begin();
    plant_reset(&plant, &forces, &seen);
    for (int k = 0; fread(row, sizeof(double), 12, stdin) == 12; k++) {
        axis_x_inputs p = {row[0], row[1], row[2], row[3], row[4], seen.x_reading_load, 1.0};
        axis_y_inputs q = {row[5], row[6], row[7], row[8], row[9], seen.y_reading_load, 1.0};
        axis_x_outputs u;
        axis_y_outputs v;
        if (k == 0) { /* reset where the encoders read 0 without noise, as a run begins */
            axis_x_inputs p0 = p;
            axis_y_inputs q0 = q;
            p0.reading = q0.reading = 0.0;
            axis_x_reset(&x, &p0);
            axis_y_reset(&y, &q0);
        }
        axis_x_step(&x, &p, &u);
        axis_y_step(&y, &q, &v);
        double out[] = {seen.x_reading_load, seen.x_position_load, seen.x_velocity_load, u.force,
                        seen.y_reading_load, seen.y_position_load, seen.y_velocity_load, v.force};
        fwrite(out, sizeof(double), 8, stdout);
        forces.x_force = u.force;
        forces.y_force = v.force;
        forces.x_load_force = row[10];
        forces.y_load_force = row[11];
        plant_step(&plant, &forces, &seen);
    }
    return 0;
}
"""


@HAS_GCC
@pytest.mark.parametrize("version", all_but([3], [2, 3], "the same plant behind the other interface"))
def test_an_fmu_of_the_coupled_plant_is_the_run_of_the_machine(version: int, tmp_path: Path) -> None:
    """Under the forces of the run, each axis is where it was, bit for bit."""
    machine = read_machine("gantry").machine()
    found = run(machine)
    write_export("gantry", f"fmu{version}", tmp_path / "fmu", plant=True)
    plant = Played(tmp_path / "fmu" / "plant.fmu", tmp_path)
    T = machine.sample_time
    names = [f"{axis}_{each}" for axis in PATH for each in OUT]
    seen = np.empty((len(found.time), len(names)))
    for k in range(len(seen)):
        seen[k] = plant.get(*names)
        forces = {
            f"{axis}_{each}": float(found[f"{axis}.{each}"][k]) for axis in PATH for each in ("force", "load_force")
        }
        plant.set(**forces)
        plant.step(k * T, T)
    plant.close()
    for column, name in enumerate(names):
        signal = name.replace("_", ".", 1)
        assert np.array_equal(bits(seen[:, column]), bits(found[signal])), signal
    assert np.ptp(seen[:, names.index("x_position_load")]) > 1e-3


@HAS_GCC
def test_the_control_of_a_coupled_axis_is_verified(tmp_path: Path) -> None:
    write_export("gantry", "c", tmp_path / "x", axis="x")
    assert verify_export(tmp_path / "x", samples=5000).holds


def test_uncoupled_axes_are_exported_at_once_too(tmp_path: Path) -> None:
    for (design, readme), name in zip(write_all("xy_table", "st", tmp_path / "all", name="table"), "xy", strict=True):
        assert (design.axis, design.name, readme.parent.name) == (name, f"table_{name}", name)
    plant = read_design("mill", what=PLANT)
    assert [v.name for v in plant.routine.inputs[::3]] == ["x_force", "y_force", "z_force"]
    with pytest.raises(ParameterError, match="--joint belongs to one axis"):
        write_all("xy_table", "linuxcnc", tmp_path / "hal", joint=1)


def test_what_cannot_hold_a_coupling_says_which_target_can(tmp_path: Path) -> None:
    def refused(target: str, **options: object) -> str:
        with pytest.raises(FeeddriveError) as caught:
            write_all("gantry", target, tmp_path / "out", **options)  # type: ignore[arg-type]
        assert not (tmp_path / "out").exists()
        return str(caught.value)

    for target in ("linuxcnc", "linuxcnc-pid"):
        assert "coupled with y by couplings.0" in refused(target)
        assert "--plant, without --axis, to c, fmu2 or fmu3" in refused(target, axis="x")
    assert "leave out --axis, and all axes are exported as one plant" in refused("c", plant=True, axis="x")
    assert "an axis can be exported to c, fmu2, fmu3" in refused("cortex-m", plant=True)


def test_an_unstable_coupled_machine_is_refused(tmp_path: Path) -> None:
    """Each axis alone is stable; the mode that moves the reading against the force makes the machine unstable."""
    file = read_machine("gantry")
    mode = file.couplings[0]
    shapes = tuple(dataclasses.replace(each, motor=-3.0 * each.load) for each in mode.shapes)  # type: ignore[attr-defined]
    path = written(Machine.of(file.loops, (dataclasses.replace(mode, shapes=shapes),)), tmp_path)  # type: ignore[type-var]
    with pytest.raises(FeeddriveError, match="unstable"):
        write_all(path, "c", tmp_path / "out")
    assert not (tmp_path / "out").exists()

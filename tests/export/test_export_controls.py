"""The controls of several axes with the contour control between them, exported as one."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from feeddrive.blocks.compensation.pitch_compensation import PitchCompensation
from feeddrive.blocks.coupling.cross_coupled import CrossCoupled
from feeddrive.blocks.reference.circle import Circle
from feeddrive.export.targets import write_all, write_export
from feeddrive.export.verify import verify_export
from feeddrive.files.machine import machine_toml, read_machine
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.loop.loop import SETPOINT
from feeddrive.loop.machine import Machine
from feeddrive.loop.routine import ControllerRun, controller_routine
from feeddrive.loop.simulate import simulate

HAS_GCC = pytest.mark.skipif(
    shutil.which("gcc") is None, reason="NOT TESTED: exported C needs gcc: apt-get install gcc"
)
PATH = {"x": Circle(radius=0.02, feed=0.1, turns=0.5, phase=0), "y": Circle(radius=0.02, feed=0.1, turns=0.5, phase=90)}


def crossed(gain: float = 60.0) -> Machine:
    """The bundled table under cross-coupled control, with pitch errors of x taken out."""
    machine = read_machine("xy_table").machine(CrossCoupled(contour_axes=("x", "y"), contour_gain=gain))
    pitch = PitchCompensation(
        forward=np.array([0.0, 4e-6, 6e-6]), backward=np.array([-3e-6, 1e-6, 4e-6]), table_start=-0.03, spacing=0.03
    )
    x = machine.loop("x")
    return machine.with_loops({"x": replace(x, control=replace(x.control, compensation=(pitch,)))})


def written(place: Path, machine: Machine) -> Path:
    path = place / "table.toml"
    path.write_text(machine_toml(machine, "table"), encoding="utf-8")
    return path


@HAS_GCC
def test_c_has_the_simulators_bits(tmp_path: Path) -> None:
    """Without --axis the controls are one, since something runs between them; live changes, trips and NaN included."""
    ((design, _),) = write_all(written(tmp_path, crossed()), "c", tmp_path / "out")
    assert (design.name, design.axis) == ("axes", "x, y")
    assert "couplings.0.contour_gain" in [each.path for each in design.routine.parameters]
    found = verify_export(tmp_path / "out", samples=5_000)
    assert found.holds
    assert found.trips > 10
    assert found.changes > 10


def test_the_routine_is_the_run_of_the_machine() -> None:
    """Fed with setpoints and readings of a run, its forces are those of the run, bit for bit, after a change too."""
    machine = crossed()
    run = simulate(machine, PATH, changes={3000: {"couplings.0.contour_gain": 90.0}})
    without = simulate(crossed(0.0), PATH)
    assert np.max(np.abs(run["y.force"] - without["y.force"])) > 1.0  # N: the coupling acts
    routine = controller_routine(machine, "axes")
    rows = {
        f"{axis}.{name}": row
        for axis, each in PATH.items()
        for name, row in zip(SETPOINT, each.at(run.time), strict=True)
    }
    for axis in PATH:
        rows |= {f"{axis}.reading": run[f"{axis}.reading_load"], f"{axis}.enable": np.ones(run.samples)}
    given = np.column_stack([rows[each.path] for each in routine.inputs])
    before = given[0].copy()  # a run begins one sample before, at rest
    controls = ControllerRun(routine, before)
    first = controls.step(given[:3000])
    controls.retune({"couplings.0.contour_gain": 90.0})
    force = np.vstack([first, controls.step(given[3000:])])
    names = [each.path for each in routine.outputs]
    for axis in PATH:
        assert np.array_equal(force[:, names.index(f"{axis}.force")], run[f"{axis}.force"])


def test_what_cannot_be_one_is_refused(tmp_path: Path) -> None:
    source = written(tmp_path, crossed())
    with pytest.raises(ParameterError, match="leave out --axis"):
        write_export(source, "c", tmp_path / "out", axis="x")
    with pytest.raises(ParameterError, match="can be exported to c, cortex-m"):
        write_all(source, "st", tmp_path / "out")
    with pytest.raises(ParameterError, match="leave out --axis and --plant"):
        write_export("xy_table", "c", tmp_path / "out", axis="x", together=True)
    unguarded = source.read_text().replace("[axis.y.control.guard]", "[axis.y.control.nothing]")
    assert unguarded != source.read_text()
    source.write_text(unguarded.replace("\n[axis.y.control.nothing]", "\n[unused]"))
    with pytest.raises((StructureError, ParameterError)):
        write_all(source, "c", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_controls_without_a_coupling_are_one_if_asked(tmp_path: Path) -> None:
    ((design, readme),) = write_all("xy_table", "c", tmp_path / "out", together=True)
    assert design.title.startswith("Controls of the axes x, y")
    assert "x_force" in readme.read_text()

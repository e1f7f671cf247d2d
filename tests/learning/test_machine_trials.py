"""Feedforward and prefilters of all axes of a machine, learned from repeated runs of one motion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from feeddrive.blocks.feedforward.disturbance_compensator import DisturbanceCompensator
from feeddrive.blocks.prefilter.trajectory_prefilter import TrajectoryPrefilter
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.files.machine import read_machine
from feeddrive.language.errors import ParameterError
from feeddrive.learning.trials import MachineTrials, iterate_machine, tune_prefilters
from feeddrive.loop.machine import Machine
from feeddrive.loop.simulate import simulate
from feeddrive.workflow import iterate
from feeddrive.workflow.learn import IterateRequest

MOVE = SnapLimitedMove(
    distance=0.03,
    velocity=0.1,
    acceleration=2.0,
    jerk=100.0,
    snap=2e4,
    back=True,
    dwell_before=0.05,
    dwell_between=0.1,
    dwell_after=0.1,
)
PATH = {"x": MOVE, "y": replace(MOVE, distance=-0.02)}


def table() -> Machine:
    return read_machine("xy_table").machine()


def test_all_axes_learn_from_the_same_runs():
    found = iterate_machine(table(), PATH, runs=3)
    assert set(found.learned) == {"x", "y"}
    assert all(row[-1] < 0.4 * row[0] for row in found.error.values())
    assert found.contour[-1][1] < 0.5 * found.contour[0][1]
    block = found.learned["y"]
    assert isinstance(block, DisturbanceCompensator)
    plant = read_machine("xy_table").loops["y"].axis.plant
    assert float(block.parameters()["mass"]) == pytest.approx(
        float(plant.rigid_mass()), rel=0.1
    )  # no column holds the Stribeck curve
    again = simulate(found.machine, PATH, seed=2)
    for axis, row in found.error.items():
        assert row[-1] == np.sqrt(np.mean(again[f"{axis}.following_error"] ** 2))  # what is returned is what ran last


def test_an_axis_that_stands_learns_nothing():
    found = iterate_machine(table(), {"x": MOVE, "y": replace(MOVE, distance=0.0)}, runs=2)
    assert list(found.learned) == ["x"]
    assert found.contour == ()
    with pytest.raises(ParameterError, match="must be >= 2"):
        iterate_machine(table(), PATH, runs=1)
    with pytest.raises(ParameterError, match="no axis moves"):
        iterate_machine(table(), dict.fromkeys("xy", replace(MOVE, distance=0.0)))


def test_prefilters_of_all_axes():
    machine = table()
    found = tune_prefilters(machine, PATH, runs=2)
    assert all(isinstance(each, TrajectoryPrefilter) for each in found.learned.values())
    assert all(row[-1] < row[0] for row in found.error.values())


def test_the_command_takes_a_job_of_several_axes(tmp_path: Path):
    (tmp_path / "job.toml").write_text(
        'machine = "xy_table"\naxis = "x"\n[reference]\nkind = "snap_limited_move"\ndistance_mm = 20\nvelocity = 0.1\n'
        "acceleration = 2\njerk = 100\nsnap = 2e4\nback = true\n[others.y.reference]\nkind = "
        '"snap_limited_move"\ndistance_mm = 10\nvelocity = 0.1\nacceleration = 2\njerk = 100\nsnap = 2e4\nback = true\n'
    )
    asked = IterateRequest(source="xy_table", job=(tmp_path / "job.toml",), trials=2, out=tmp_path / "learned.toml")
    outcome = iterate.run(asked)
    assert "[[axis.x.control.feedforward]]" in outcome.section
    assert "[[axis.y.control.feedforward]]" in outcome.section
    assert (tmp_path / "learned.toml").read_text() == outcome.section
    with pytest.raises(ParameterError, match="--prefilter is for the axes of a job"):
        iterate("xy_table", axis="x", prefilter=True, trials=2)


def test_the_run_of_one_axis():
    run = simulate(table(), PATH)
    x = run.axis("x")
    assert np.array_equal(x["force"], run["x.force"])
    assert "y.force" not in x.signals
    with pytest.raises(ParameterError, match="no axis 'z'; it has x, y"):
        run.axis("z")


def test_errors_of_rotary_axes_are_shown_as_angles() -> None:
    errors = {"x": np.array([5e-6]), "c": np.array([7e-6])}
    text = f"{MachineTrials(errors, ((3e-6, 1e-6),), {}, read_machine('trunnion_ac').machine(), ()).table()}"
    rows = {line.partition("  ")[0]: line.split()[-2:] for line in text.splitlines()[3:]}
    assert rows["x: error RMS"] == ["5", "um"]
    assert rows["c: error RMS"] == ["7", "urad"]
    assert rows["contour error, largest"] == ["3", "um"]

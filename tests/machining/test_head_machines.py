"""The bundled machines with heads: the S curve by directions of the tool is planned on each, proven, and run."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.files.job import read_job
from feeddrive.files.machine import read_machine
from feeddrive.jobs.run_laws import run_laws
from slow_share import all_but

# lever arm of the tilting joint, m: from the points in the files, pivot height plus tool; a nutating axis lies at 45
# degrees to them
LEVERS = {"head_table_bc": 0.3, "fork_head_cb": 0.4, "nutating_head_bc": 0.3 * math.sqrt(0.5)}


@pytest.mark.parametrize(
    "name", all_but(["nutating_head_bc"], ["trunnion_ac", *LEVERS], "the same program on the others")
)
def test_directions_of_the_tool_make_one_program_for_all_kinds(name: str, tmp_path: Path) -> None:
    """The first twentieth of s_curve_vectors: proven, and the tool points there as the program says."""
    program = Path(fd.__file__).parent / "files" / "bundled" / "programs" / "s_curve_vectors.ngc"
    lines = program.read_text(encoding="utf-8").splitlines()[:106]
    part = tmp_path / "part.ngc"
    part.write_text("\n".join([*lines, "M2", ""]), encoding="utf-8")
    planned = fd.workflow.plan(part, machine=name)
    assert planned.violations == 0
    assert planned.tip is not None
    assert planned.tip.deviation <= 10e-6
    # the direction, too, where the axes of both rotary joints are not square to one another
    assert planned.tip.angle <= math.radians(0.05)
    assert planned.kinematics is not None
    last = dict(zip("XYZIJK", (float(word[1:]) for word in lines[-1].split()), strict=True))
    joints = planned.course.position[-1]
    place = planned.tips_of(joints[None])[0]
    assert place == pytest.approx([1e-3 * last[letter] for letter in "XYZ"], abs=1e-5)
    rotary = [joints[planned.limits.letters.index(letter)] for letter in planned.kinematics.rotary_letters]
    axis = np.array(planned.kinematics.tool_axis(rotary))
    assert axis == pytest.approx([last[letter] for letter in "IJK"], abs=1e-3)


@pytest.mark.slow(reason="the whole S curve through the loops of two machines")
@pytest.mark.parametrize("name", LEVERS)
def test_the_tilting_joint_of_a_head_makes_most_of_the_error_at_the_tip(name: str, tmp_path: Path) -> None:
    path = tmp_path / "j.toml"
    path.write_text(f'machine = "{name}"\n[program]\nfile = "s_curve_vectors.ngc"\n', encoding="utf-8")
    result = run_laws(read_job(path))
    planned = result.job.program.planned if result.job.program is not None else None
    assert planned is not None
    assert planned.violations == 0
    tip = result.parts["today"].tip
    assert tip is not None
    parts = {joint.letter: joint for joint in tip.joints}
    assert parts["B"].share == max(joint.share for joint in tip.joints) > 0.4
    assert parts["B"].lever == pytest.approx(LEVERS[name], rel=1e-9)
    # the lever arm of B is the same everywhere
    assert parts["B"].tip_peak == pytest.approx(parts["B"].peak * LEVERS[name], rel=1e-9)
    assert tip.contour.largest < 150e-6


@pytest.mark.parametrize("name", LEVERS)
def test_the_file_of_a_machine_holds_what_its_kinematics_need(name: str) -> None:
    file = read_machine(name)
    assert file.kinematics is not None
    assert set(file.kinematics.letters.lower()) == set(file.loops) == set(file.limits)
    for axis, loop in file.loops.items():
        inertia = loop.axis.plant.rigid_mass()
        assert loop.control.feedforward[0].mass == pytest.approx(inertia, rel=1e-12)  # type: ignore[attr-defined]
        assert loop.axis.rotary == (axis in "bc")


def test_the_tolerance_bounds_the_direction_of_a_nutating_head(tmp_path: Path) -> None:
    """Corners of B and C within it: its axes lie at 45 degrees, so that angles within 0.05 degrees turn the tool by up
    to 0.05 √(1 + √½) = 0.065 degrees."""
    part = tmp_path / "part.ngc"
    rows = "".join(f"X{k} B{20 + k % 2} C{0.2 * (k % 2):.1f}\n" for k in range(1, 9))
    part.write_text(f"G21 G90 G64 P0.5 F3000\nG43.4\nG0 X0 Z60 B20\nG1\n{rows}G49\nM2\n", encoding="utf-8")
    planned = fd.workflow.plan(part, machine="nutating_head_bc")
    assert planned.violations == 0
    assert planned.tip is not None
    assert 0.9 * math.radians(0.05) < planned.tip.angle <= math.radians(0.05)


def test_the_nutating_head_is_a_product_of_matrices() -> None:
    """The axis of B is that of Y turned by 45 degrees about X: its rotation is Rx(45) Ry(B) Rx(-45)."""
    machine = read_machine("nutating_head_bc").kinematics
    assert machine is not None
    rng = np.random.default_rng(45)

    def about(axis: int, angle: float) -> np.ndarray:
        matrix, k, m = np.eye(3), (axis + 1) % 3, (axis + 2) % 3
        matrix[[k, m], [k, m]] = math.cos(angle)
        matrix[m, k] = math.sin(angle)
        matrix[k, m] = -math.sin(angle)
        return matrix

    for _ in range(100):
        tip, (b, c) = rng.uniform(-0.3, 0.3, 3), rng.uniform(-3.0, 3.0, 2)
        head = about(0, math.pi / 4) @ about(1, b) @ about(0, -math.pi / 4)
        pivot = np.array([0.0, 0.0, 0.18])
        # from the gauge point to the tip: 180 mm up to the pivot, 180 mm down the spindle, 120 mm down the tool
        reach = pivot + head @ np.array([0.0, 0.0, -0.12 - 0.18])
        # C turns the tool relative to the workpiece: the table the other way
        assert np.array(machine.linear(tip, (b, c))) == pytest.approx(about(2, -c) @ tip - reach, abs=1e-15)
        assert np.array(machine.tool_axis((b, c))) == pytest.approx(about(2, c) @ head[:, 2], abs=1e-15)
    # at B = 180 degrees the tool is horizontal
    assert np.array(machine.tool_axis((math.pi, 0.0))) == pytest.approx([0.0, 1.0, 0.0], abs=1e-15)

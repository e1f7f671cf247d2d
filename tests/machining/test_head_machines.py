"""The bundled machines with heads: the S curve by directions of the tool is planned on each, proven, and run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.files.job import read_job
from feeddrive.files.machine import read_machine
from feeddrive.jobs.run_laws import run_laws
from slow_share import all_but

# lever arm of the tilting joint, m: from the points in the files, pivot height plus tool
LEVERS = {"head_table_bc": 0.3, "fork_head_cb": 0.4}


@pytest.mark.parametrize("name", all_but(["fork_head_cb"], ["trunnion_ac", *LEVERS], "the same program on the others"))
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

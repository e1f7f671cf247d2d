"""A part program of the tip of the tool as a job: run through the loops of five joints, judged at the tip."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from feeddrive import plot
from feeddrive.files.job import read_job
from feeddrive.files.machine import find_bundled
from feeddrive.jobs.run_laws import JobResult, _matched, run_laws
from feeddrive.language.errors import ParameterError, ProgramError
from feeddrive.language.quantity import DRAWN
from feeddrive.plot.drawing import drawn
from feeddrive.workflow.learn import iterate
from feeddrive.workflow.run_job import run
from feeddrive.workflow.setpath import setpath

# approach with all joints, two lines and a turn of C about the standing tip
PART = """G21 G90 G94 G64 P0.01
G0 A-20 C10
G43.4 H0
G0 X10 Y5 Z10
G1 F3000 X20 Y10 A-25 C30
X25 Y0 C15
C40 F1200
X20 F3000
M2
"""
JOB = 'machine = "trunnion_ac"\n[program]\nfile = "part.ngc"\n'
TOOL = """[process.tool.1]
kind = "helical_cutter"
teeth = 2
diameter_mm = 10
axial_depth_mm = 5
helix_angle_deg = 45
specific_energy = 3e9
"""


def job(folder: Path, text: str = JOB, part: str = PART) -> Path:
    (folder / "part.ngc").write_text(part, encoding="utf-8")
    (folder / "j.toml").write_text(text, encoding="utf-8")
    return folder / "j.toml"


def by_formula(joints: np.ndarray) -> np.ndarray:
    """Tip of trunnion_ac in the frame of the workpiece, m, (n, 3): turned back by A about X, then by C about Z."""
    x, y, z, a, c = joints
    ca, sa, cc, sc = np.cos(a), np.sin(a), np.cos(c), np.sin(c)
    y, z = ca * y - sa * z, sa * y + ca * z
    return np.stack([cc * x - sc * y, sc * x + cc * y, z + 0.08], axis=1)


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> JobResult:
    return run_laws(read_job(job(tmp_path_factory.mktemp("job"))))


def test_the_tip_of_a_run_is_that_of_its_joints_by_the_formula_of_the_machine(ran: JobResult) -> None:
    part, together = ran.parts["today"], ran.rows[0].together
    assert part.tip is not None
    assert together is not None
    actual, wanted = (
        np.stack([together[f"{axis}.{name}"] for axis in "xyzac"]) for name in ("position_load", "set_position")
    )
    # m: roundings of 0.1 m
    assert np.abs(part.contour.position - by_formula(actual)).max() < 1e-15
    assert np.abs(part.contour.set_position - by_formula(wanted)).max() < 1e-15
    away = np.linalg.norm(by_formula(actual) - by_formula(wanted), axis=1)
    assert np.hypot(part.tip.along, part.tip.across) == pytest.approx(away, abs=1e-15)
    # m: set positions within 1 nm are one node of the path
    assert np.all(part.contour.error < away + 1e-9)
    assert 1e-6 < part.contour.largest < 1e-4
    assert set(np.unique(part.contour.line[part.contour.counted])) == {5, 6, 7, 8}  # type: ignore[index]
    # the joints of the machine are judged in their own units
    assert part.axes["c"].following_peak == pytest.approx(np.abs(together["c.following_error"]).max(), rel=1e-12)


@pytest.mark.slow(reason="a run of two laws")
def test_a_soft_table_shows_at_the_tip_in_the_share_of_c(tmp_path: Path) -> None:
    text = f'{JOB}[[law]]\nname = "soft table"\nset = {{ "axis.c.control.law.Kv" = 20.0 }}\n'
    today, soft = (part.tip for part in run_laws(read_job(job(tmp_path, text))).parts.values())
    assert today is not None
    assert soft is not None
    of_c = [next(joint for joint in tip.joints if joint.letter == "C") for tip in (today, soft)]
    assert of_c[1].tip_rms > 1.5 * of_c[0].tip_rms
    assert of_c[1].tip_peak <= of_c[1].peak * of_c[1].lever * (1.0 + 1e-12)  # type: ignore[operator]
    for tip in (today, soft):
        assert sum(joint.share for joint in tip.joints) == pytest.approx(1.0, abs=1e-9)
        # to first order: errors of 1e-4 rad at 0.1 m leave 1e-9 m
        total = np.sum(tip.added, axis=0) - tip.contour.error
        assert np.abs(total[tip.contour.counted]).max() < 5e-9


def test_figures_of_rotary_joints_are_in_their_units(ran: JobResult) -> None:
    figures = ran.parts["today"].numbers()
    for key in ("c.following_error_rms_rad", "a.drive_force_peak_N_m", "c.lever_arm_m", "direction_error_peak_rad"):
        assert figures[key] is not None
    assert not [key for key in figures if key.startswith(("a.", "c.")) and key.endswith("_N")]
    assert "x.following_error_rms_m" in figures
    assert "x.lever_arm_m" not in figures
    text = f"{ran.parts['today'].table()}"
    assert "urad" in text
    assert "N m" in text
    assert "tool direction urad" in f"{ran.table()}"


def test_the_charts_of_the_tip_show_its_error_and_the_part_of_each_joint(ran: JobResult) -> None:
    tip = ran.parts["today"].tip
    assert tip is not None
    across, along, direction = tip.chart().shown(DRAWN).panels
    assert np.max(across.curves[0].y) == pytest.approx(1e6 * tip.contour.largest)
    assert np.max(np.abs(along.curves[0].y)) == pytest.approx(1e6 * tip.peak(tip.along))
    assert direction.label == "direction\n(µrad)"
    parts = plot.tip_joints_chart(tip).shown(DRAWN).panels
    assert [panel.label for panel in parts] == [f"{letter}\n(µm)" for letter in "XYZAC"]
    assert "lever arm up to" in parts[-1].caption
    assert "lever arm" not in parts[0].caption
    for made in (tip.chart(), plot.tip_joints_chart(tip)):
        drawn(made)


@pytest.mark.slow(reason="a report with all its pictures")
def test_the_report_says_what_the_tip_does(tmp_path: Path) -> None:
    run(job(tmp_path), out=tmp_path / "out")
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    for said in ("off the direction that belongs to its place", "What each joint adds", "at the tip RMS", "lever arm"):
        assert said in page
    law = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))["laws"]["today"]
    assert law["a.share_of_contour_error"] < 1.0
    again = run(tmp_path / "out" / "job.toml")
    assert again.parts["today"].contour.rms == law["contour_error_rms_m"]


REFUSED = {
    "a cut": (
        JOB + TOOL,
        PART,
        r"j\.toml:\d+: process: part\.ngc moves the rotary joint A \(line \d\), and the forces",
    ),
    "a rotary row": ('axis = "c"\n' + JOB, PART, r"j\.toml:1: axis: 'c' turns, and a run along a program is judged"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_a_job_of_five_axes_cannot_do_is_refused(name: str, tmp_path: Path) -> None:
    text, part, message = REFUSED[name]
    with pytest.raises(ParameterError, match=message):
        read_job(job(tmp_path, text, part))


def test_an_upright_tool_may_cut_on_a_five_axis_machine(tmp_path: Path) -> None:
    part = "G21 G90 G94\nT1 M6\nS3000 M3\n(ap=1)\nG1 X5 Y2 F600\nM2\n"
    read = read_job(job(tmp_path, JOB + TOOL, part))
    assert read.program is not None
    assert any(cut.axial_depth > 0.0 for cut in read.program.cuts)


def test_a_posted_program_is_judged_at_the_tip_of_the_machine_file(tmp_path: Path) -> None:
    read = read_job(job(tmp_path, JOB, "G21 G90 F600\nG1 X1 A-5 C10\nM2\n"))
    assert read.program is not None
    assert not read.program.moves_tip
    assert read.program.kinematics is not None
    assert read.program.kinematics.tool == (0.0, 0.0, 0.0)
    read.require_axes("setpath")
    assert read_job("circle").program.kinematics is None  # type: ignore[union-attr]


def test_the_tips_of_two_tools_are_refused_with_the_line_of_the_second(tmp_path: Path) -> None:
    (tmp_path / "tool.tbl").write_text("T1 P1 Z50\nT2 P2 Z60\n", encoding="utf-8")
    text, part = JOB + 'tools = "tool.tbl"\n', "G21 G90 F600\nG43.4 H1\nG1 X1\nG49\nG43.4 H{}\nG1 X2\nM2\n"
    read = read_job(job(tmp_path, text, part.format(1)))
    assert read.program is not None
    assert read.program.kinematics is not None
    assert read.program.kinematics.tool == (0.0, 0.0, -0.05)
    with pytest.raises(
        ProgramError, match=r"line 5, .*the tip of a second tool, and a job judges a run at the tip of one"
    ):
        read_job(job(tmp_path, text, part.format(2)))


def test_a_cut_of_the_machine_file_is_refused_for_a_tilted_tool(tmp_path: Path) -> None:
    cut = '[[couplings]]\nkind = "milling_cut"\nspindle_speed = 3000\n'
    cutter = TOOL.replace("[process.tool.1]", "[couplings.cutter]")
    machine = find_bundled("trunnion_ac", "machines").read_text(encoding="utf-8")
    (tmp_path / "m.toml").write_text(f"{machine}\n{cut}{cutter}", encoding="utf-8")
    with pytest.raises(
        ParameterError, match=r"j\.toml:2: program: .*take couplings\.0, a milling_cut, out of .*m\.toml"
    ):
        read_job(job(tmp_path, JOB.replace("trunnion_ac", "m.toml")))


def test_corrections_of_the_path_of_each_axis_are_refused(tmp_path: Path) -> None:
    path = job(tmp_path)
    reason = r"program\.file = 'part\.ngc' moves the tip of the tool .*{} corrects each axis along its own path"
    with pytest.raises(ParameterError, match=reason.format("setpath")):
        setpath(path, method="force")
    with pytest.raises(ParameterError, match=reason.format("learn --offsets")):
        iterate("trunnion_ac", job=(path,), offsets=True, trials=1)


@pytest.mark.slow(reason="a run with a cut")
def test_an_upright_cut_is_judged_at_the_tip_and_acts_on_the_linear_joints(tmp_path: Path) -> None:
    part = "G21 G90 G94\nT1 M6\nS6000 M3\n(ap=1)\nG1 X5 Y2 F1200\nM2\n"
    result = run_laws(read_job(job(tmp_path, JOB + TOOL, part)))
    found = result.parts["today"]
    assert found.tip is not None
    assert found.cutting is not None
    assert found.cutting.shape == (found.contour.time.size, 3)
    assert found.cutting_rms is not None
    assert found.cutting_rms > 1.0
    # an upright tool over a table at rest: the tip is off by what X, Y and Z are off, and A and C at their levers
    assert {joint.letter for joint in found.tip.joints if joint.tip_peak > 0.0} >= {"X", "Y"}


def test_the_lag_of_an_angle_is_not_matched_with_that_of_a_length(tmp_path: Path) -> None:
    machine = find_bundled("trunnion_ac", "machines").read_text(encoding="utf-8")
    for axis, remarks in (("c", 0), ("y", 2)):
        law = f'[axis.{axis}.control.law]\nkind = "cascade_ppi"\n'
        assert law in machine
        slow = machine.replace(law, f"{law}velocity_feedforward = 0.5\n")
        (tmp_path / "m.toml").write_text(slow, encoding="utf-8")
        read = read_job(job(tmp_path, JOB.replace("trunnion_ac", "m.toml"), "G21 G90\nG43.4 H0\nG1 X1 F600\nM2\n"))
        assert len(_matched(read)) == remarks

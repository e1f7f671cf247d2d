"""`feeddrive plan`: what it writes, what it refuses, and that nothing unproven leaves."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import feeddrive as fd
from feeddrive.cli import commands
from feeddrive.export.linuxcnc_session import session
from feeddrive.files.machine import machine_toml, planned_limits, read_machine
from feeddrive.files.part_program import SAME_OPTIONS, PartProgramSection
from feeddrive.language import tree
from feeddrive.language.block import declarations, defaults
from feeddrive.language.errors import CancelledError, FeeddriveError, ParameterError
from feeddrive.language.progress import Progress
from feeddrive.path import setpoints
from feeddrive.path.motion import Part
from feeddrive.path.planned import Recorder
from feeddrive.path.program.reading import read_program
from feeddrive.path.setpoints import Sampler, planned
from feeddrive.workflow.plan import FAULT, PlanRequest, plan
from hal_programs import needs_linuxcnc

PART = "G21 G90 G64 P0.05\nG0 X10 Y10\nG1 X60 F3000\nG61 Y40\nG64 P0.05 G3 X50 Y50 I-10\nG4 P0.25\nG1 X10 Y10.5\nM2\n"
LIMITS = """
[axis.x.limits]
velocity_mm_per_s = 500
acceleration_mm_per_s2 = 5000
jerk_mm_per_s3 = 1e5
snap_mm_per_s4 = 5e7
{}
"""


@pytest.fixture
def no_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the pictures, which take longer than all else and have a test of their own."""
    monkeypatch.setattr(sys.modules["feeddrive.workflow.plan"], "html", lambda _: "")


def part(folder: Path, text: str = PART) -> Path:
    path = folder / "part.ngc"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.usefixtures("no_report")
def test_the_files_hold_what_the_plan_says(tmp_path: Path) -> None:
    """Setpoints keep the limits, end where the program ends, and each sample follows from the one before.

    A Taylor step to snap over a sample T misses the next position by what the snap s jumps meanwhile: at most
    2 s T⁴/24, 1.6e-11 m here.
    """
    found = fd.workflow.plan(part(tmp_path), machine="xy_table", out=tmp_path / "out")
    record = json.loads((tmp_path / "out" / "plan.json").read_text())
    assert record["violations"] == 0
    assert record["blocks"] == 5
    assert record["cycle_time_s"] == found.cycle_time
    assert [each["reason"] for each in record["stops"]] == [
        "corner of 90°, exact path (G61)",
        "bend, exact path (G61)",
        "dwell (G4)",
    ]
    assert [each["line"] for each in record["stops"]] == [4, 5, 6]
    assert record["stops"][2]["position_m"] == pytest.approx({"X": 0.05, "Y": 0.05}, abs=1e-15)
    log = fd.read_log(tmp_path / "out" / "setpoints.parquet")
    T = log.sample_time
    assert pytest.approx(2.5e-4) == T
    assert len(log) == record["samples"] == int(np.ceil(found.cycle_time / T)) + 1
    limits = found.limits.array
    for i, axis in enumerate("xy"):
        rows = [log[f"{axis}.set_{name}"] for name in ("position", "velocity", "acceleration", "jerk", "snap")]
        for k in range(4):
            assert np.max(np.abs(rows[k + 1])) <= limits[i, k] * (1.0 + 1e-9)
        x, v, a, j, s = (row[:-1] for row in rows)
        ahead = x + T * (v + T * (0.5 * a + T * (j / 6.0 + T * s / 24.0)))
        assert np.max(np.abs(ahead - rows[0][1:])) <= limits[i, 3] * T**4 / 12.0
        assert [row[-1] for row in rows[1:]] == [0.0] * 4
    assert log["x.set_position"][-1] == pytest.approx(0.01, abs=1e-15)
    text = np.loadtxt(tmp_path / "out" / "streamer.txt")
    np.testing.assert_array_equal(text, 1e3 * np.column_stack([log["x.set_position"], log["y.set_position"]]))


def test_the_report_shows_path_limits_profiles_and_stops(tmp_path: Path) -> None:
    """Each picture is drawn, of an axis that does not move there is none, and the page loads nothing."""
    plan(
        part(tmp_path, "G64 P0.02\nG0 X10\nG1 X60 F3000\nG61 X20\nG2 X20 I5 F1000\nM2\n"),
        machine="mill",
        out=tmp_path / "out",
    )
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    for each in (
        "Path and speed",
        "Where and why the feed falls",
        "What limits the speed, and when",
        "Axis X",
        "Axis Y",
        "corner of 180°",
        "traverse",
        "s⁴",
    ):
        assert each in page
    assert "Axis Z" not in page
    assert page.count("<svg") == 5
    assert "<script" not in page
    assert len(page) < 1_000_000
    assert plan(part(tmp_path, "F600 G1 X5\nM2\n"), machine="emps", limits=one_axis(tmp_path)).plot() is not None


def test_a_report_without_pictures_needs_no_matplotlib(tmp_path: Path) -> None:
    """In a process of its own; counts of one are in the singular."""
    out = tmp_path / "out"
    program = part(tmp_path, "G61 G1 X60 F3000\nY20\nM2\n")
    code = (
        "import sys, feeddrive as fd\n"
        f"fd.workflow.plan({str(program)!r}, machine='mill', out={str(out)!r}, no_pictures=True)\n"
        "print(*(name for name in ('matplotlib', 'pandas', 'scipy') if name in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "<svg" not in page
    assert "Limits" in page
    assert "with 1 stop." in page
    assert "2, in 2 runs from rest to rest" in page


def one_axis(folder: Path) -> Path:
    file = folder / "limits.toml"
    file.write_text(LIMITS.format(""), encoding="utf-8")
    return file


def test_cycle_time_is_split_without_a_rest(tmp_path: Path) -> None:
    """Causes count every sample once: their sum is the cycle time within a sample."""
    found = plan(part(tmp_path), machine="xy_table")
    assert sum(found.seconds.values()) == pytest.approx(found.cycle_time, abs=2.0 * found.sample_time)
    assert found.seconds["standstill"] == pytest.approx(0.25, abs=2.0 * found.sample_time)
    assert "every limit is proven" in repr(found)


def test_the_course_holds_the_extremes_of_all_samples(tmp_path: Path) -> None:
    """Of 40,000 samples, which it keeps in stretches of four, taken in pieces of unequal length."""
    limits = planned_limits(fd.read_machine("xy_table"), None)
    recorder, values = Recorder(2), []
    for samples in setpoints.Setpoints(read_program(part(tmp_path)), limits, 9e-5):
        values.append(samples.values)
        for cut in np.array_split(np.arange(len(samples.values)), 7):
            rows = (samples.values[cut], samples.line[cut], samples.feed[cut], samples.speed[cut])
            recorder.add(setpoints.Samples(samples.first, *rows, True))
    course, whole = recorder.course(9e-5), np.concatenate(values)
    assert len(whole) > 2 * 8192
    assert len(course.time) < 2 * 8192
    np.testing.assert_array_equal(course.high.max(axis=0), whole[:, :, 1:].max(axis=0))
    np.testing.assert_array_equal(course.low.min(axis=0), whole[:, :, 1:].min(axis=0))
    at = np.round(course.time / 9e-5).astype(int)
    np.testing.assert_array_equal(course.position, whole[at, :, 0])


@pytest.mark.parametrize(("mode", "stops"), [("", 0), ("G64\n", 0), ("G61\n", 1)])
def test_a_tolerance_of_the_command_holds_where_the_program_states_none(mode: str, stops: int, tmp_path: Path) -> None:
    """A gentle corner of 2 deg: within 50 um no stop, at exact stops one."""
    path = part(tmp_path, f"{mode}G1 X10 F6000\nX20 Y0.35\nM2\n")
    assert plan(path, machine="xy_table", tolerance=5e-5).stop_count == stops
    assert plan(path, machine="xy_table").stop_count == 1


ROTARY = """
[axis.a.limits]
velocity_rpm = 60
acceleration_deg_per_s2 = 3600
jerk_rad_per_s3 = 1e3
snap_rad_per_s4 = 1e5
travel_most_deg = 720
resolution_mdeg = 1e3
"""


@pytest.mark.usefixtures("no_report")
def test_rotary_axes_move_with_the_linear_ones(tmp_path: Path) -> None:
    """The feed is along X, of A alone in degrees; 20 mm at 100 mm/min, 90 deg at 360 deg/min, G93 2/min, and 6 ramps.

    A tolerance below the resolution of A, 1 deg, is none of X.  A ramp costs some 20 ms.  A turns back within 0.05 deg.
    """
    limits, out = tmp_path / "limits.toml", tmp_path / "out"
    limits.write_text(LIMITS.format("resolution_um = 1") + ROTARY, encoding="utf-8")
    path = part(tmp_path, "G64 P0.01\nG1 X20 A180 F100\nG4 P0\nF360 A270\nG93 X0 A0 F2\nM2\n")
    found = plan(path, limits=limits, sample_time=1e-2, out=out)
    assert found.proof.count == 0
    assert found.cycle_time == pytest.approx(12.0 + 15.0 + 30.0, abs=0.2)
    assert "% of 360 deg/s" in found.table().rows[1][1]
    log = fd.read_log(out / "setpoints.parquet")
    assert [log.units[f"a.set_{name}"] for name in ("position", "velocity", "snap")] == ["rad", "rad/s", "rad/s4"]
    assert log["a.set_position"].max() == pytest.approx(np.radians(270.0), abs=np.radians(0.05))
    rows = np.loadtxt(out / "streamer.txt")
    np.testing.assert_allclose(rows[:, 1], np.degrees(log["a.set_position"]), atol=1e-9)
    stop = json.loads((out / "plan.json").read_text())["stops"][0]
    assert stop["position_m"] == pytest.approx({"X": 0.02})
    assert stop["position_rad"] == pytest.approx({"A": np.pi})
    with pytest.raises(FeeddriveError, match=r"line 1, column 4: A: axis A would go to 721 deg .* travel is .*720"):
        plan(part(tmp_path, "G0 A721\nM2\n"), limits=limits, sample_time=1e-3)


def refused(folder: Path, text: str, **given: Any) -> str:
    chosen: dict[str, Any] = {"machine": "xy_table", "out": folder / "out", **given}
    with pytest.raises(FeeddriveError) as caught:
        plan(part(folder, text), **chosen)
    assert not (folder / "out").exists()
    return str(caught.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("G1 X400 F100\n", "line 1, column 4: X: axis X would go to 400 mm in machine coordinates, its travel is"),
        ("G0 X290\nG3 X290 Y40 I0 J20 F100\n", "line 2, column 4: X: axis X would go to 310 mm in machine coordinates"),
        ("G1 Z1 F100\n", "line 1, column 4: Z: "),
        ("G64 P0.00005\nG1 X1 F100\n", "line 1, column 5: P: the tolerance of 5e-05 mm is smaller than the resol"),
        ("N1 G64 P1001\nG1 X1 F100\n", "line 1, column 8: P: the tolerance of 1001 mm is more than 1000 mm"),
        ("G1 X1\n", "F"),
        ("G1 X1 F0\n", "feed"),
    ],
)
def test_what_the_machine_cannot_do_is_refused_at_its_line(text: str, said: str, tmp_path: Path) -> None:
    """Soft limits, arcs through their farthest points too, missing axes, a tolerance that no axis resolves, no feed."""
    assert said in refused(tmp_path, f"{text}M2\n")


@pytest.mark.parametrize(("mm", "held"), [("0.0000000000000001", False), ("0.0000000009", False), ("0.000001", True)])
def test_a_tolerance_below_rounding_is_refused_without_a_resolution_too(mm: str, held: bool, tmp_path: Path) -> None:
    file = one_axis(tmp_path)
    text = f"G21\nG64 P{mm}\nG1 X1 F600\nM2\n"
    if held:
        assert plan(part(tmp_path, text), limits=file, sample_time=1e-2).blocks == 1
        return
    said = refused(tmp_path, text, machine=None, limits=file, sample_time=1e-2)
    assert "line 2, column 5: P: the tolerance of" in said
    assert "is smaller than the rounding of positions, 1e-09 mm: give a larger one" in said


def test_options_that_are_too_small_are_named(tmp_path: Path) -> None:
    """A tolerance of the command has no line; samples every ns would fill the disk."""
    said = refused(tmp_path, PART, tolerance=1e-5 * 1e-3)
    assert said.startswith("--tolerance: the tolerance of 1e-05 mm is smaller than the resolution of axis X")
    assert "must be >= 0.001 ms" in refused(tmp_path, PART, sample_time=1e-9)


@pytest.mark.parametrize("text", ["", "%\n%\n", "(nothing)\n; at all\n", "M3 S100\nM2\n", "G21 G1 X0 F100\n"])
def test_a_program_that_does_not_move_is_refused(text: str, tmp_path: Path) -> None:
    """An empty file is no program: setpoints of no rows would look like a plan."""
    assert refused(tmp_path, text).startswith("part.ngc: no block moves an axis, so there is nothing to plan")
    assert not (tmp_path / "out").exists()
    # a dwell lasts: the axes are held
    assert fd.workflow.plan(part(tmp_path, "G4 P0.1\nM2\n"), machine="xy_table").cycle_time == pytest.approx(0.1)


def test_limits_of_a_file_replace_those_of_the_machine(tmp_path: Path) -> None:
    file = one_axis(tmp_path)
    file.write_text(LIMITS.format("travel_most_mm = 20"), encoding="utf-8")
    assert "its travel is" in refused(tmp_path, PART, limits=file)
    file.write_text(LIMITS.format("").replace("= 500\n", "= 50\n"), encoding="utf-8")
    slow = plan(part(tmp_path), machine="xy_table", limits=file)
    assert slow.limits.array[0, 0] == 0.05
    assert slow.limits.array[1, 0] == 0.5
    alone = plan(part(tmp_path, "G1 X10 F600\nM2\n"), limits=file, sample_time=1e-3)
    assert alone.limits.letters == "X"


@pytest.mark.parametrize("left_out", ["snap_mm_per_s4 = 5e7", "jerk_mm_per_s3 = 1e5\nsnap_mm_per_s4 = 5e7"])
@pytest.mark.parametrize("stated", [False, True])
def test_a_limit_of_snap_or_jerk_may_be_left_out_or_infinite(left_out: str, stated: bool, tmp_path: Path) -> None:
    """`plan.json` has null for it, the table says that there is none, and the proof covers the others."""
    file, program = tmp_path / "limits.toml", tmp_path / "part.ngc"
    other = "\n".join(f"{line.split(' ')[0]} = inf" for line in left_out.split("\n")) if stated else ""
    text = LIMITS.format("").replace(left_out, other)
    file.write_text(text + text.replace("axis.x", "axis.y"), encoding="utf-8")
    program.write_text("G21 G64 P0.05 F6000\nG1 X20\nG3 X30 Y10 J10\nG1 X10\nM2\n", encoding="utf-8")
    found = fd.workflow.plan(program, limits=file, sample_time=1e-3, out=tmp_path / "out")
    record = json.loads((tmp_path / "out" / "plan.json").read_text())
    assert record["violations"] == 0
    assert record["limits"]["X"]["snap"] == {"limit": None, "largest_use": None}
    assert (record["limits"]["Y"]["jerk"]["limit"] is None) is ("jerk" in left_out)
    assert record["limits"]["X"]["acceleration"]["largest_use"] > 0.5
    assert "no limit" in str(found.table())


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (LIMITS.format("travel_least_mm = 30\ntravel_most_mm = 20"), "travel_least = 0.03 m must be < "),
        (LIMITS.format("").replace("jerk_mm_per_s3 = 1e5", "jerk_mm_per_s3 = -1"), "limits.toml:5: "),
        (LIMITS.format("").replace("acceleration_mm_per_s2 = 5000", ""), "acceleration"),
        (LIMITS.format("").replace("= 5000", "= inf"), "(largest acceleration) must be a finite number"),
        (LIMITS.format("speed = 3"), "speed"),
        (LIMITS.format("").replace("axis.x", "axis.q"), "axis 'q' is not in"),
        ("[axis.x]\nlimit = 3\n", "limits.toml:2: "),
    ],
)
def test_a_wrong_file_of_limits_is_refused_with_its_line(text: str, said: str, tmp_path: Path) -> None:
    file = tmp_path / "limits.toml"
    file.write_text(text, encoding="utf-8")
    assert said in refused(tmp_path, PART, limits=file)


def test_a_machine_without_limits_says_what_to_add(tmp_path: Path) -> None:
    assert "[axis.x.limits]" in refused(tmp_path, PART, machine="ball_screw")
    assert "[axis.c.limits]" in refused(tmp_path, PART, machine="rotary_table")
    file = fd.read_machine("emps")
    other = replace(file, loops={"slide": file.loop(None)})
    assert "a part program moves axes with the names x y z u v w, and a b c" in refused(tmp_path, PART, machine=other)
    with pytest.raises(ParameterError, match="--machine is missing"):
        PlanRequest(Path("part.ngc"))


def test_axes_that_follow_differently_are_said(tmp_path: Path) -> None:
    """Kv 40 and 38 without feedforward leave a line at 45 deg by V/2 (1/38 - 1/40)."""
    machine = read_machine("xy_table").machine()
    names = {f"axis.{axis}.control.law.velocity_feedforward": 0.0 for axis in "xy"} | {"axis.y.control.law.Kv": 38.0}
    limits = read_machine("xy_table").limits
    (tmp_path / "slow.toml").write_text(machine_toml(tree.vary(machine, names), "slow", limits=limits))
    found = plan.run(PlanRequest(program=part(tmp_path), machine=tmp_path / "slow.toml"))
    assert any("x Kv 40, y 38: 65.8 um off a 45 deg line at 100 mm/s" in each for each in found.remarks)
    same = plan.run(PlanRequest(program=part(tmp_path), machine="xy_table"))
    assert not any("45 deg" in each for each in same.remarks)


def test_a_hold_is_a_stop_with_its_place(tmp_path: Path) -> None:
    held = plan(part(tmp_path), machine="xy_table", override="0.2:0, 1:100")
    whole = plan(part(tmp_path), machine="xy_table")
    assert held.stop_reasons["feed hold"] == 1
    (stop,) = [each for each in held.stops if each.reason == "feed hold"]
    assert stop.time + stop.duration == pytest.approx(1.0, abs=1e-9)
    # it stands where the setpoints do
    at = np.searchsorted(held.course.time, stop.time + 0.5 * stop.duration)
    assert np.abs(held.course.position[at] - stop.position).max() <= 1e-9
    assert held.cycle_time > whole.cycle_time


@pytest.mark.usefixtures("no_report")
def test_what_is_not_proven_leaves_no_setpoints(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A plan that uses 1e-6 more of its limits than there is: exit 1, the reason, plan.json alone."""
    made = setpoints.planned
    monkeypatch.setattr(
        setpoints, "planned", lambda moves, axes, limits, *rest: made(moves, axes, limits * (1 + 1e-6), *rest)
    )
    out = tmp_path / "out"
    told = CliRunner().invoke(commands.app, ["plan", str(part(tmp_path)), "--machine", "xy_table", "--out", str(out)])
    assert told.exit_code == 1
    assert "exceeds its limit" in told.output
    assert FAULT in told.output
    record = json.loads((out / "plan.json").read_text())
    assert record["violations"] > 0
    assert "of axis X" in record["proof"]["faults"][0]
    assert sorted(each.name for each in out.iterdir()) == [".feeddrive", "plan.json", "report.html"]


@pytest.mark.usefixtures("no_report")
def test_a_cancelled_plan_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.modules["feeddrive.workflow.plan"], "_SHOWN", 0.0)

    class Stopping(Progress):
        def show_step(self, what: str, done: int | None, of: int | None, part: str) -> None:
            self.cancel()

    program = part(tmp_path, "G64 P0.01 F600\n" + "G4 P0.001\n" * 200 + "M2\n")
    with pytest.raises(CancelledError):
        plan.run(PlanRequest(program, machine="xy_table", out=tmp_path / "out"), Stopping())
    assert [each.name for each in tmp_path.iterdir()] == ["part.ngc"]


def test_parts_shorter_than_a_sample_are_counted_with_the_others(tmp_path: Path) -> None:
    """2 um segments of a circle, stops between them: most parts hold no sample of 20 ms."""
    angles = np.linspace(0.0, 0.02, 40)
    rows = "".join(f"X{4 - 4 * np.cos(a):.5f} Y{4 * np.sin(a):.5f}\n" for a in angles[1:])
    text = f"G61 F600 G1\n{rows}M2\n"
    found = plan(part(tmp_path, text), machine="xy_table", sample_time=0.02)
    assert found.samples == int(np.ceil(found.cycle_time / 0.02)) + 1
    assert sum(found.seconds.values()) == pytest.approx(found.cycle_time, abs=0.04)


JOB = 'machine = "xy_table"\naxis = "y"\n[program]\nfile = "part.ngc"\n'


def job_of(folder: Path) -> Path:
    part(folder, "G64 P0.05\nG1 X5 F6000\nY3\nM2\n")
    job = folder / "job.toml"
    job.write_text(JOB, encoding="utf-8")
    return job


@pytest.mark.usefixtures("no_report")
def test_a_job_takes_a_program_as_the_reference_of_all_axes(tmp_path: Path) -> None:
    """Position to snap are those of the plan, bit for bit; the copy in the results reads the same program."""
    job = fd.read_job(job_of(tmp_path))
    assert "part program part.ngc, 2 blocks" in repr(job)
    plan(tmp_path / "part.ngc", machine="xy_table", out=tmp_path / "out")
    log = fd.read_log(tmp_path / "out" / "setpoints.parquet")
    for axis, reference in (("y", job.reference), ("x", job.others["x"].reference)):
        assert reference is not None
        rows = [log[f"{axis}.set_{name}"] for name in ("position", "velocity", "acceleration", "jerk", "snap")]
        np.testing.assert_array_equal(np.array(reference.at(log.time)), np.array(rows))


OPTIONS: dict[str, dict[str, Any]] = {
    "xy_table": {
        "tolerance": 5e-5,
        "dynamics": "80,50,50",
        "override": "0.05:50, 0.2:120",
        "start": "X=1, Y=2",
        "from_line": 2,
        "parameters": "_far=7",
        "front_end": "own",
        "skip_deleted": True,
    },
    "trunnion_ac": {"orientation": "vector", "angle_tolerance": 1e-3, "purpose": "roughing"},
}
TEXTS = {
    "xy_table": "G21 G90 G1 X5 F2000\nG1 X#<_far> Y5\n/X100\nX2\nM2\n",
    "trunnion_ac": "G21 G90 G43.5 F2000\nG0 I0.1 K1\nG1 X2 I0.4 J0.2 K1\nX4 I0.1 J0.3 K1\nM2\n",
}


@pytest.mark.usefixtures("no_report")
@pytest.mark.parametrize("machine", OPTIONS)
def test_the_job_of_a_plan_has_its_options_and_its_motion(machine: str, tmp_path: Path) -> None:
    """All bits of position to snap; and what the job says is what the options said."""
    options, program = OPTIONS[machine], part(tmp_path, TEXTS[machine])
    plan(program, machine=machine, out=tmp_path / "out", **options)
    section = tomllib.loads((tmp_path / "out" / "job.toml").read_text(encoding="utf-8"))["program"]
    assert section == {"file": str(program), **options}
    job = fd.read_job(tmp_path / "out" / "job.toml")
    log = fd.read_log(tmp_path / "out" / "setpoints.parquet")
    references = {job.axis: job.reference, **{axis: other.reference for axis, other in job.others.items()}}
    for axis, reference in references.items():
        assert reference is not None
        rows = [log[f"{axis}.set_{name}"] for name in ("position", "velocity", "acceleration", "jerk", "snap")]
        np.testing.assert_array_equal(np.array(reference.at(log.time)), np.array(rows))


def test_each_option_of_a_plan_is_one_of_a_job() -> None:
    """But those of the machine and of the command itself; a job has the sample time of its machine."""
    command = {"program", "machine", "sample_time", "longest", "most_cpu", "threads", "watch", "no_pictures", "out"}
    names = {field.name for field in fields(PlanRequest)}
    assert names - command == set(declarations(PartProgramSection)) - {"file"}
    assert set(SAME_OPTIONS) <= names
    usual = defaults(PartProgramSection)
    assert all(usual[field.name] == field.default for field in fields(PlanRequest) if field.name in SAME_OPTIONS)


@pytest.mark.slow(reason="a machine of two axes is compiled, with margins and stiffness: 10 s")
def test_a_job_runs_a_program_and_can_be_repeated(tmp_path: Path) -> None:
    """Both axes follow in one run; the job in the results gives the same figures."""
    found = fd.run(job_of(tmp_path), out=tmp_path / "out")
    together = found.rows[0].together
    assert together is not None
    assert max(together["x.set_position"]) == pytest.approx(5e-3)
    assert max(together["y.set_position"]) == pytest.approx(3e-3)
    again = fd.run(tmp_path / "out" / "job.toml", out=tmp_path / "again")
    assert again.rows[0].together is not None
    assert (tmp_path / "out" / "summary.json").read_text() == (tmp_path / "again" / "summary.json").read_text()


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ("", r"program.file is missing"),
        ('file = "part.ngc"\nspeed = 3', r"job.toml:5: key 'program.speed'"),
        ('file = "part.ngc"\ntolerance_mm = 2000', r"job.toml:5: program.tolerance: the tolerance of 2000 mm is more"),
        ('file = "part.ngc"\nangle_tolerance_deg = 1', r"job.toml:5: program.angle_tolerance is for axes that turn"),
        ('file = "part.ngc"\ndynamics = "150"', r"job.toml:5: program.dynamics: '150': the shares"),
        (
            'file = "part.ngc"\norientation = "planes"',
            r'job.toml:5: program.orientation = .* "axes", "plane"',
        ),
        ('file = "part.ngc"\noverride = "1:0"', r"job.toml:5: program.override: the last factor is 0"),
        ('file = "part.ngc"\noverride = "1"', r"job.toml:5: program.override: '1' is no step"),
        ('file = "part.ngc"\nfrom_line = 0', r"job.toml:5: program.from_line = 0 .* must be >= 1"),
        ('file = "part.ngc"\nstart = "C=3"', r"job.toml:5: program.start: the machine has no axis C; it has X, Y"),
        ('file = "part.ngc"\nparameters = "_a"', r"job.toml:5: program.parameters: '_a' is no name with a number"),
        ('file = "none.ngc"', "program.file = 'none.ngc': there is no such file beside the job"),
        ('file = "part.ngc"\n[reference]\nkind = "circle"', r"not \[reference\] and \[program\]"),
        ('file = "part.ngc"\n[others.x.reference]\nkind = "circle"', "others.x.reference"),
    ],
)
def test_a_wrong_program_section_is_refused(section: str, said: str, tmp_path: Path) -> None:
    part(tmp_path)
    job = tmp_path / "job.toml"
    job.write_text(f'machine = "xy_table"\naxis = "y"\n[program]\n{section}\n', encoding="utf-8")
    with pytest.raises(FeeddriveError, match=said):
        fd.read_job(job)


def test_a_long_part_is_sampled_in_slices(tmp_path: Path) -> None:
    """Runs, an overlap and a corner spline, at most seven samples at once: the bits of all at once."""
    limits = planned_limits(fd.read_machine("xy_table"), None)
    path = part(tmp_path, "G64 P0.05 G1 X8 F6000\nY5\nX3\nX2.9 Y5.05\nX2.8 Y5.15\nX0\nM2\n")
    whole, cut = Sampler(1e-3), Sampler(1e-3)
    parts = [each for each in planned(read_program(path), "XY", limits.array) if isinstance(each, Part)]
    assert any(each.entering is not None for each in parts)
    for each in parts:
        slices = list(cut.slices(each, 7))
        assert max(map(len, slices)) <= 7
        np.testing.assert_array_equal(np.concatenate(slices), whole.sample(each))


@pytest.mark.usefixtures("no_report")
def test_stops_that_are_too_many_for_the_plan_stand_in_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("path.planned", "files.plan_files"):
        monkeypatch.setattr(sys.modules[f"feeddrive.{module}"], "FEW", 10)
    rows = "".join(f"G4 P0.001\nX{k % 2}\n" for k in range(1, 13))
    out = tmp_path / "out"
    plan(part(tmp_path, f"F6000 G1 X0\n{rows}M2\n"), machine="xy_table", out=out)
    record = json.loads((out / "plan.json").read_text())
    stops = fd.files.read_log(out / "stops.parquet")
    assert (record["stop_count"], len(record["stops"]), len(stops)) == (12, 10, 12)
    assert record["stops_file"] == "stops.parquet"


@pytest.mark.slow(reason="LinuxCNC's HAL runs a second at its own pace")
@needs_linuxcnc
@pytest.mark.usefixtures("no_report")
def test_the_streamer_of_linuxcnc_gives_the_setpoints(tmp_path: Path) -> None:
    """Each line comes out of the pins, one a period, bit for bit."""
    plan(part(tmp_path, "G1 X5 Y2 F3000\nM2\n"), machine="xy_table", sample_time=1e-3, out=tmp_path / "out")
    lines = [
        "loadrt threads name1=servo-thread period1=1000000",
        "source streamer.hal",
        "loadrt sampler depth=4000 cfg=ff",
        "net a streamer.0.pin.0 => sampler.0.pin.0",
        "net b streamer.0.pin.1 => sampler.0.pin.1",
        "addf sampler.0 servo-thread",
        "start",
        "loadusr -w sleep 0.5",
        "setp streamer.0.enable 1",
        "loadusr -w halsampler -n 1000 out.txt",
    ]
    (tmp_path / "out" / "run.hal").write_text("\n".join(lines) + "\n", encoding="utf-8")
    session(tmp_path / "out", [], "halrun -f run.hal")
    given, taken = np.loadtxt(tmp_path / "out" / "streamer.txt"), np.loadtxt(tmp_path / "out" / "out.txt")
    start = int(np.argmax(np.any(taken != 0.0, axis=1))) - 1
    np.testing.assert_allclose(taken[start : start + len(given)], given, rtol=0, atol=1e-6)

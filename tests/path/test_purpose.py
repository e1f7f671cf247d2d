"""--for roughing, finishing and precision: what each sets, and which of purpose, options and program wins."""

from __future__ import annotations

import json
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.files.machine import planned_limits, read_machine
from feeddrive.files.part_program import PartProgramSection, planned_program
from feeddrive.language.errors import ParameterError, ProgramError
from feeddrive.path.program.moves import PathMode
from feeddrive.path.program.reading import read_program
from feeddrive.path.purpose import PURPOSES, Dynamics, read_dynamics, settings, with_tolerance
from feeddrive.workflow.plan import PlanRequest, plan

# a corner of 90 degrees; the tolerance decides how fast it is passed
CORNER = "F6000\nG1 X20\nX20 Y20\nM2\n"


@pytest.fixture
def no_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the page, whose pictures have a test of their own."""
    monkeypatch.setattr(sys.modules["feeddrive.workflow.plan"], "html", lambda _: "")


def part(folder: Path, text: str = CORNER) -> Path:
    path = folder / "part.ngc"
    path.write_text(text, encoding="utf-8")
    return path


def test_each_purpose_is_slower_and_gentler_than_the_one_before(tmp_path: Path) -> None:
    path = part(tmp_path)
    machine = planned_limits(read_machine("xy_table"), None).array
    plans = {name: fd.workflow.plan(path, machine="xy_table", purpose=name) for name in PURPOSES}
    times = [found.cycle_time for found in plans.values()]
    assert times == sorted(times)
    assert len(set(times)) == 3
    for name, found in plans.items():
        purpose = PURPOSES[name]
        assert found.proof.count == 0
        np.testing.assert_allclose(found.limits.array / machine, [[1.0, *purpose.dynamics]] * 2)
        assert found.settings == settings(name)
    # as with both options: the purpose is no more than these two
    both = fd.workflow.plan(path, machine="xy_table", tolerance=5e-6, dynamics="70,25,25")
    assert both.cycle_time == plans["precision"].cycle_time


@pytest.mark.usefixtures("no_report")
def test_options_replace_what_the_purpose_sets(tmp_path: Path) -> None:
    path = part(tmp_path)
    request = PlanRequest(
        path, machine="xy_table", purpose="precision", tolerance=1e-4, dynamics="100", out=tmp_path / "o"
    )
    outcome = plan.run(request)
    rough = fd.workflow.plan(path, machine="xy_table", purpose="roughing")
    assert outcome.result.cycle_time == rough.cycle_time
    (told,) = [remark for remark in outcome.remarks if remark.startswith("For precision")]
    assert "tolerance 0.1 mm where the program states none" in told
    assert "acceleration 100 %, jerk 100 %, snap 100 %" in told
    assert "by --tolerance and --dynamics, not by the purpose" in told
    record = json.loads((tmp_path / "o" / "plan.json").read_text())["for"]
    assert record["purpose"] == "precision"
    assert record["tolerance_m"] == 1e-4
    assert record["replaced_by_options"] == ["--tolerance", "--dynamics"]
    section = tomllib.loads((tmp_path / "o" / "job.toml").read_text(encoding="utf-8"))["program"]
    assert (section["purpose"], section["tolerance"], section["dynamics"]) == ("precision", 1e-4, "100")


def test_tolerances_of_the_program_stand(tmp_path: Path) -> None:
    """G64 P0.02 of its first corner stays, G64 without P of its second takes that of the purpose, G61 none."""
    path = part(tmp_path, f"G64 P0.02\n{CORNER[:-3]}G64\nX0\nG61\nY0\nM2\n")
    stated = [move for move in with_tolerance(read_program(path), 1e-4) if isinstance(move, PathMode)]
    found = {(move.mode, move.tolerance) for move in stated}
    assert found == {("continuous", 2e-5), ("continuous", 1e-4), ("exact_path", 0.0)}
    outcome = plan.run(PlanRequest(path, machine="xy_table", purpose="roughing"))
    (told,) = [remark for remark in outcome.remarks if remark.startswith("For roughing")]
    assert "the program states 1 of its own, which stand" in told


@pytest.mark.usefixtures("no_report")
def test_a_job_takes_the_purpose_of_the_plan(tmp_path: Path) -> None:
    outcome = plan.run(PlanRequest(part(tmp_path), machine="xy_table", purpose="finishing", out=tmp_path / "o"))
    assert 'purpose = "finishing"' in (tmp_path / "o" / "job.toml").read_text()
    section = PartProgramSection(file="part.ngc", purpose="finishing")
    planned = planned_program(section, tmp_path / "job.toml", read_machine("xy_table")).planned
    assert planned is not None
    assert planned.cycle_time == outcome.result.cycle_time
    assert planned.settings == settings("finishing")


@pytest.mark.parametrize("text", ["", "0", "101", "50,50", "a", "50,,50", "nan", "100,50,-1"])
def test_wrong_dynamics_are_refused(text: str) -> None:
    with pytest.raises(ParameterError, match=r"--dynamics: .*above 0 and at most 100, such as 100,50,50"):
        read_dynamics(text)
    assert read_dynamics(" 80, 40 ,20") == Dynamics(0.8, 0.4, 0.2)


def test_wrong_purposes_and_tolerances_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="is none of roughing, finishing, precision"):
        settings("fast")
    with pytest.raises(ParameterError, match="roughing"):
        fd.workflow.plan(part(tmp_path), machine="xy_table", purpose="fast")
    coarse = tmp_path / "coarse.toml"
    rows = "velocity_mm_per_s = 500\nacceleration_mm_per_s2 = 5000\njerk_mm_per_s3 = 1e5\nsnap_mm_per_s4 = 5e7\n"
    coarse.write_text("".join(f"[axis.{axis}.limits]\n{rows}resolution_um = 50\n" for axis in "xy"))
    with pytest.raises(ParameterError, match=r"--for: the tolerance of 0\.01 mm is smaller than the resolution"):
        fd.workflow.plan(part(tmp_path), limits=coarse, sample_time=1e-3, purpose="finishing")
    with pytest.raises(ProgramError, match="smaller than the resolution"):
        fd.workflow.plan(part(tmp_path, "G64 P0.01\n" + CORNER), limits=coarse, sample_time=1e-3, purpose="roughing")

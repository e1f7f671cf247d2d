"""`feeddrive setpath`: a part program on all axes, its log, and the path of one axis."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.files.job import read_job
from feeddrive.files.run_files import write_run_csv
from feeddrive.language.errors import FeeddriveError, FileError, LogError, ParameterError
from feeddrive.language.judgment import Judgment
from feeddrive.learning.part_correction import PATH_SHARE, CorrectedProgram
from feeddrive.learning.part_log import LearnedPart
from feeddrive.learning.plant_box import NOMINAL
from feeddrive.loop.simulate import simulate
from feeddrive.plot.part_program import corrected_path_chart
from feeddrive.workflow.setpath import SetpathRequest, setpath

PROGRAM = """(a circle of 5 mm, and a stroke of x out and back)
G21 G17 G90 G94 G64 P0.01
G0 X100 Y80
G4 P0.05
F3000
G3 X100 Y80 I0 J5
G4 P0.1
G1 X104
G1 X100
G4 P0.05
M2
"""
JOB = """title = "a circle and a stroke"
machine = "xy_table"
axis = "x"
seed = 3
[program]
file = "small.ngc"
[[law]]
name = "stiffer"
set = { "axis.x.control.law.Kv" = 50, "axis.y.control.law.Kv" = 50 }
[[law]]
name = "signs"
set = { "axis.x.control.feedforward.0.coulomb_positive" = 20 }
"""


@pytest.fixture
def job(tmp_path: Path) -> Path:
    (tmp_path / "small.ngc").write_text(PROGRAM, encoding="utf-8")
    (tmp_path / "job.toml").write_text(JOB, encoding="utf-8")
    return tmp_path / "job.toml"


def outcome(source: Any, **options: Any) -> Any:
    return setpath.run(SetpathRequest(source, **options))


def log_of(job: Path, out: Path, correction: Path | None = None, law: str = "today") -> Path:
    """The log of a part, as CSV with units in its heads."""
    given = read_job(job)
    machine = given.machines[law]
    references = {"x": given.reference, "y": given.others["y"].reference}
    added = None
    if correction is not None:
        rows = np.genfromtxt(correction / "setpoints.csv", delimiter=",", names=True)
        T = float(machine.sample_time)
        added = {a: fd.blocks.RecordedForce(force=rows[f"{a}_force_offset_N"], sample_time=T) for a in "xy"}
    signals = ("set_position", "reading_load", "force")
    run = simulate(machine, references, added_force=added, record=[f"{a}.{s}" for a in "xy" for s in signals])  # type: ignore[arg-type]
    write_run_csv(out, run.time, run.signals, run.units)
    return out


def test_a_part_is_corrected_judged_and_written(job: Path, tmp_path: Path) -> None:
    out = tmp_path / "part"
    found = outcome(job, out=out)
    assert found.judgment is Judgment.CORRECTED
    figures = json.loads((out / "setpath.json").read_text(encoding="utf-8"))
    rms = figures["contour_rms_m"]
    assert set(rms) == {"plain", "corrected", "worst_plain", "worst_corrected"}
    # measured: 0.40 of plain on the nominal machine
    assert rms["corrected"] < 0.6 * rms["plain"]
    assert rms["worst_corrected"] < rms["worst_plain"]
    assert rms["worst_corrected"] == max(each["corrected"]["rms_m"] for each in figures["machines"])
    assert figures["law"] == "today"
    assert len(figures["machines"]) == 7
    for each in figures["machines"]:
        assert all(each["corrected"][key] <= 1.02 * each["plain"][key] for key in each["plain"])
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.index("The part is corrected") < page.index("figure-deviation")
    words = str(found)
    assert "Report: " in words
    assert "Next: feeddrive setpath" in words
    assert isinstance(found.result, CorrectedProgram)
    # on the path, with one scale of colors for all pictures
    most = max(np.nanmax(row) for errors in found.result.errors.values() for row in errors.values())
    for machine, corrected in ((NOMINAL, False), (found.result.worst.name, True)):
        chart = corrected_path_chart(found.result, machine, corrected=corrected)
        (panel,) = chart.panels
        heat = np.asarray(panel.curves[0].heat)
        size = found.result.errors[machine]["corrected" if corrected else "plain"]
        assert np.nanmax(heat) == pytest.approx(1e6 * np.nanmax(size))
        assert panel.heat is not None
        assert panel.heat.high == pytest.approx(1e6 * most)
        assert chart.square
    # the same correction from Python, without the command
    given = read_job(job)
    again = fd.learning.correct_by_plan(
        given.machines["today"], {"x": given.reference, "y": given.others["y"].reference}
    )  # type: ignore[dict-item]
    rows = np.genfromtxt(out / "setpoints.csv", delimiter=",", names=True)
    assert np.array_equal(rows["x_force_offset_N"][: again.forces["x"].size], again.forces["x"])


def test_the_row_of_the_job_is_chosen(job: Path) -> None:
    today, stiffer = (
        outcome(job, law=law, box="mass=0,friction=0,stiffness=0,dead_time=0").result for law in (None, "stiffer")
    )
    assert len(today.plants) == 1
    assert stiffer.nominal.plain.rms < today.nominal.plain.rms
    with pytest.raises(ParameterError, match=r"--law 'stifer' is no row of .*did you mean stiffer"):
        outcome(job, law="stifer")


def test_a_refused_correction_is_not_written(job: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("feeddrive.learning.part_correction._WORSE", 0.1)
    found = outcome(job, out=tmp_path / "part", box="mass=0,friction=0,stiffness=0,dead_time=0")
    assert found.judgment is Judgment.NOT_CORRECTED
    assert found.judgment.exit_code == 1
    assert "on the machine 'nominal'" in found.failure
    assert not found.then
    names = {path.name for path in (tmp_path / "part").iterdir()}
    assert {"report.html", "setpath.json"} <= names
    assert "setpoints.csv" not in names
    figures = json.loads((tmp_path / "part/setpath.json").read_text(encoding="utf-8"))
    assert figures["accepted"] is False
    assert len(figures["tried"]) == 4


def test_a_path_is_planned_with_a_reserve_and_proven(job: Path, tmp_path: Path) -> None:
    found = outcome(job, method="path", out=tmp_path / "path").result
    assert found.correction.paths
    assert not found.correction.forces
    whole = read_job(job).program
    assert whole is not None
    lengths = [plan.position.size for plan in (found.correction.plan["x"], whole.references["x"])]
    assert lengths[0] > lengths[1]
    # the plan keeps some of each limit back for the change, and the snap of this one needs more: 3/4 of it is proven
    assert found.correction.shares["x"] <= 0.75 * PATH_SHARE


@pytest.mark.slow(reason="three parts of 1.5 s with their logs as text")
def test_part_after_part(job: Path, tmp_path: Path) -> None:
    """Plan, log of the plain part, log of the corrected part: the RMS falls from log to log."""
    first = outcome(job, from_log=log_of(job, tmp_path / "0.csv"), out=tmp_path / "one")
    assert first.judgment is Judgment.LEARNED
    assert isinstance(first.result, LearnedPart)
    log = log_of(job, tmp_path / "1.csv", tmp_path / "one")
    second = outcome(job, from_log=log, last=tmp_path / "one", out=tmp_path / "two")
    assert second.result.history[1] < 0.6 * second.result.history[0]
    record = json.loads((tmp_path / "two/setpath.json").read_text(encoding="utf-8"))
    assert record["passes"] == 2
    assert record["measured_rms_m"] == list(second.result.history)
    log = log_of(job, tmp_path / "2.csv", tmp_path / "two")
    third = outcome(job, from_log=log, last=tmp_path / "two", out=tmp_path / "three")
    assert third.result.history[2] < 1.02 * third.result.history[1]
    with pytest.raises(ParameterError, match="is the correction of another law, today, not stiffer"):
        outcome(job, law="stiffer", from_log=log, last=tmp_path / "two")


def test_a_log_is_read_by_its_columns(job: Path, tmp_path: Path) -> None:
    log = log_of(job, tmp_path / "part.csv")
    text = log.read_text(encoding="utf-8").replace("x.reading_load", "encoder", 1)
    log.write_text(text, encoding="utf-8")
    with pytest.raises(ParameterError, match=r"has no column x.reading_load: name it by --position x=NAME:mm"):
        outcome(job, from_log=log)
    assert outcome(job, from_log=log, position=("x=encoder",)).result.history
    with pytest.raises(
        ParameterError, match=r"--position z=encoder: give each axis once, as x=...; the part moves x, y"
    ):
        outcome(job, from_log=log, position=("z=encoder",))
    # the usual names in other forms: those of `setpoints.csv`, with the unit at the end
    plain = outcome(job, from_log=log, position=("x=encoder",)).result.history
    head, _, rows = text.partition("\n")
    for axis in "xy":
        head = head.replace(f"{axis}.set_position", f"{axis}_set_position_m").replace(
            f"{axis}.reading_load", "Y.reading_load_m"
        )
    renamed = tmp_path / "renamed.csv"
    renamed.write_text(head.replace("encoder", "x_position_load_m") + "\n" + rows, encoding="utf-8")
    assert outcome(job, from_log=renamed).result.history == plain
    cut = tmp_path / "cut.csv"
    cut.write_text("\n".join(text.splitlines()[:-100]) + "\n", encoding="utf-8")
    with pytest.raises(LogError, match="log the part again, to its last sample"):
        outcome(job, from_log=cut, position=("x=encoder",))


def test_what_a_job_refuses(job: Path, tmp_path: Path) -> None:
    for options, said in (
        ({"law": "signs"}, "feeds dry friction forward by the sign of the set velocity.*--from-log"),
        ({"axis": "x"}, "--axis is for one axis of a machine, and .* is a job"),
        ({"window": 20, "method": "splines"}, "job.toml"),
        ({"last": tmp_path}, "--last names the correction that ran with a logged part"),
        ({"box": "mass=2"}, "box.mass = 2 must be >= 0 and < 1: it is a share, such as 0.15 or 15%"),
        (
            {"box": "weight=0.1"},
            "'weight=0.1' is no tolerance with a value; there are: mass, friction, stiffness, dead_time, cut",
        ),
        ({"box": "dead_time=0.5"}, "the dead time is a whole number of samples, such as 1sample"),
        ({"box": "mass=much"}, "mass = much is not a number"),
        ({"drive": ("q=drive.toml",)}, "--drive q=drive.toml: give each axis once"),
        ({"drive": ("x=drive.toml",)}, "drive.toml: cannot be read: no such file"),
        ({"method": "path", "from_log": tmp_path / "0.csv"}, "leave out --method path"),
    ):
        with pytest.raises(FeeddriveError, match=said):
            outcome(job, **options, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()
    with pytest.raises(ParameterError, match="replays a log and plans no motion"):
        outcome("emps_log", method="force")
    with pytest.raises(FileError, match="no such file"):
        outcome(job, from_log=tmp_path / "nothing.csv")
    move = "[reference]\nkind = 'linear_move'\ndistance = 0.01\ntravel_time = 0.2\n"
    job.write_text(JOB.partition("[program]")[0] + move, encoding="utf-8")
    with pytest.raises(ParameterError, match="--method path needs a part program"):
        outcome(job, method="path")


def test_the_written_path_is_followed(tmp_path: Path) -> None:
    out = tmp_path / "path.csv"
    found = fd.workflow.setpath("linear_motor", out=out)
    assert isinstance(found, fd.learning.ChangedReference)
    rows = np.loadtxt(out, delimiter=",", skiprows=1)
    assert np.array_equal(rows[:, 1], found.reference.position)
    loop = fd.read_machine("linear_motor").loop("x")
    path = fd.blocks.Recorded(position=rows[:, 1], sample_time=float(loop.sample_time))
    run = fd.simulate(loop, path, record=["position_load"])
    off = 1e6 * np.max(np.abs(run["position_load"] - rows[: run.time.size, 2]))
    assert off < 3.0  # friction and ripple are left


def test_what_an_axis_refuses(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="--window = 20 is for --method splines"):
        fd.workflow.setpath("linear_motor", window=20)
    with pytest.raises(ParameterError, match="polynomials of degree 12 have lost their digits; take filtered splines"):
        fd.workflow.setpath("ball_screw")
    with pytest.raises(ParameterError, match="--law is for a job, and linear_motor is a machine"):
        fd.workflow.setpath("linear_motor", law="today")
    with pytest.raises(FeeddriveError, match="no_such"):
        fd.workflow.setpath("no_such", out=tmp_path / "path.csv")
    assert not (tmp_path / "path.csv").exists()


def test_iterate_learns_the_force_offsets_of_a_job(job: Path, tmp_path: Path) -> None:
    """The trials of `iterate` are simulated parts: the second one, with the offsets of the first log, is better."""
    out = tmp_path / "offsets.csv"
    found = fd.workflow.iterate("xy_table", job=(str(job),), offsets=True, trials=2, out=out)
    assert isinstance(found, fd.learning.PartTrials)
    assert found.figures[1].rms < 0.6 * found.figures[0].rms
    rows = np.genfromtxt(out, delimiter=",", names=True)
    assert np.array_equal(rows["x_force_offset_N"][: found.correction.forces["x"].size], found.correction.forces["x"])
    with pytest.raises(ParameterError, match="--offsets is for the axes of a job that run together"):
        fd.workflow.iterate("xy_table", axis="x", offsets=True)
    with pytest.raises(ParameterError, match="--offsets learns a force over time and no parameters"):
        fd.workflow.iterate("xy_table", job=(str(job),), offsets=True, columns="mass")

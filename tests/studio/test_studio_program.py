"""The room Program: which programs fit a machine, and what is shown of a plan, a run and a correction."""

from __future__ import annotations

import json
import struct
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from feeddrive.files.machine import BUNDLED, read_machine
from feeddrive.studio.bench import bench_of
from feeddrive.studio.jobs import DONE
from feeddrive.studio.part_program import bundled_programs, example_path, letters_of
from feeddrive.studio.rooms.export import recipe_of
from feeddrive.studio.server import Session

OF_TIP = ["blade.ngc", "dome.ngc", "s_curve.ngc", "s_curve_vectors.ngc"]
# two sides of a square with a rounded corner, within the travel of the table
CORNER = "G21 G90 G17\nG64 P0.02\nG1 X20 F600\nY20\nM2\n"


def read(answer: bytes) -> tuple[dict[str, Any], np.ndarray]:
    (length,) = struct.unpack_from("<I", answer)
    return json.loads(answer[4 : 4 + length]), np.frombuffer(answer[4 + length :], "<f4")


def asked(session: Session, do: str, **more: Any) -> dict[str, Any]:
    return read(session.answer({"number": 1, "do": do, **more}))[0]


def done(session: Session, do: str, **more: Any) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """An act, the end of the work that it began, and what its room shows then, with its tables of numbers."""
    said = asked(session, do, **more)
    assert "error" not in said, said["error"]
    assert session.desk.job is not None
    session.desk.job.join(300.0)
    assert session.desk.job.state.error == ""
    said, numbers = read(session.answer({"number": 1, "do": "program.show"}))
    return said, {name: numbers[at : at + m * n].reshape(m, n) for name, (at, m, n) in said["rows"].items()}


def with_corner(folder: Path, machine: str = "xy_table", axis: str = "x") -> Session:
    session = Session(folder, bench_of(machine, axis))
    (folder / "brought").mkdir(exist_ok=True)
    part = folder / "brought" / "corner.ngc"
    part.write_text(CORNER, encoding="utf-8")
    session.desk.programs["corner.ngc"] = part
    return session


def figure(shown: dict[str, Any], key: str) -> dict[str, str]:
    return next(each for each in shown["figures"] if each["key"] == key)


def test_programs_are_offered_to_machines_that_have_their_axes() -> None:
    five = bundled_programs(read_machine("trunnion_ac"))
    assert five[: len(OF_TIP)] == OF_TIP  # those of the tip first
    assert "circle.ngc" in five
    assert bundled_programs(read_machine("xy_table")) == ["circle.ngc"]  # the others move Z
    assert not set(OF_TIP) & set(bundled_programs(read_machine("mill")))
    assert bundled_programs(read_machine("ball_screw")) == []
    assert letters_of("(Z and A are no words here)\nG1 X1 Y-.5 F100 ; C\nG2 X[#1+2] Y#2 I1 J1") == {"X", "Y"}


def test_without_a_machine_the_example_is_shown_as_it_is_programmed(tmp_path: Path) -> None:
    said, numbers = read(Session(tmp_path).answer({"number": 1, "do": "program.show"}))
    assert said["ready"] is False
    at, m, n = said["rows"]["plan"]
    path = numbers[at : at + m * n].reshape(m, n)
    text = (BUNDLED / "programs" / "s_curve.ngc").read_text(encoding="utf-8").splitlines()
    # its last block with words: its line and its X
    line = int(path[1, -1])
    assert f"X{path[2, -1]:.4f}" in text[line - 1].replace("X75 ", "X75.0000 ")
    assert np.allclose(np.linalg.norm(path[5:8], axis=0), 1.0, atol=1e-6)  # directions, as floats of 32 bits
    assert np.all(np.diff(path[0]) >= 0.0)
    assert example_path().shape == (m, n)


def test_of_a_long_program_the_first_20000_lines_are_shown(tmp_path: Path) -> None:
    session = with_corner(tmp_path)
    session.desk.programs["corner.ngc"].write_text("G1 X1 F600\n" * 50_000, encoding="utf-8")
    assert len(asked(session, "program.text", name="corner.ngc")["text"]["lines"]) == 20_000


def test_a_plan_shows_time_loss_and_the_line_of_each_place(tmp_path: Path) -> None:
    session = with_corner(tmp_path)
    assert asked(session, "program.show")["chosen"] == "corner.ngc"  # the one that was imported
    assert asked(session, "program.text", name="corner.ngc")["text"]["lines"] == CORNER.splitlines()
    assert "not planned yet" in asked(session, "program.run", name="corner.ngc")["error"]
    shown, rows = done(session, "program.plan", name="corner.ngc")
    assert shown["stages"] == ["plan"]
    assert shown["next"] == "run"
    assert figure(shown, "limits")["value"] == "proven"
    assert figure(shown, "limits")["state"] == "kept"
    plan = rows["plan"]
    lines = list(dict.fromkeys(int(each) for each in plan[1] if each))
    assert lines == [3, 4]
    # the corner is rounded within 0.02 mm, and the instants are 0.01 mm apart: one is at most 0.005 mm off its middle
    assert np.min(np.hypot(plan[2] - 20.0, plan[3])) <= np.hypot(0.02, 0.005)
    assert 3000 < plan.shape[1] <= 4000  # of 16,000 samples: a picture has no more pixels
    # what the strip says is lost is the time that the path takes beyond its feed: 40 mm at 10 mm/s, less the corner
    cycle, lost = (float(figure(shown, key)["value"]) for key in ("cycle", "lost"))
    assert cycle - lost == pytest.approx(4.0, abs=5e-3)  # the corner is shorter by 0.02 mm at most, four digits of both
    assert {each["line"] for each in shown["falls"]} <= {3, 4}
    assert [each["label"] for each in shown["charts"]["axes"]["panels"]] == ["linear (mm)", "limit in use (%)"]
    feeds = shown["charts"]["feed"]["panels"][0]
    assert feeds["low"] == 0.0
    assert 1.1 * 600.0 < feeds["high"] < 1.6 * 600.0  # the feed fills the picture, whatever traverses reach
    assert "feeddrive plan " in recipe_of(session.desk).commands
    assert (tmp_path / shown["archive"]).is_file()


@pytest.mark.slow(reason="a plan and two runs of a part program: 6 s")
def test_a_run_compares_the_control_of_now_with_todays(tmp_path: Path) -> None:
    session = with_corner(tmp_path)
    before = session.desk.values["law.Kv"]
    asked(session, "tune.move", name="law.Kv", value=0.5 * before)
    done(session, "program.plan", name="corner.ngc")
    said = list[bytes]()
    session.listen(lambda _, each: said.append(each))
    shown, rows = done(session, "program.run", name="corner.ngc")
    states = [read(each)[0].get("job") for each in said]
    steps = list(dict.fromkeys(each["step"] for each in states if each and each["step"]))
    assert steps.index("today: its linear model") < steps.index("today: seconds of the run") < steps.index("report")
    assert states[-1] is not None
    assert states[-1]["state"] == DONE
    assert shown["runs"] == ["today", "now"]
    now, today = (float(np.nanmax(rows[name][4])) for name in ("now", "today"))
    assert now > today  # half the gain: more than today's error in a corner
    assert figure(shown, "largest")["state"] == "broken"
    largest = float(figure(shown, "largest")["value"])
    assert largest == pytest.approx(now, rel=5e-3)  # three digits
    assert shown["verdict"].startswith("Now: ")
    # the tool is where its foot and its vector say, and the vector is as long as the error
    foot_to_tool = np.linalg.norm(rows["now"][5:8], axis=0)
    counted = np.isfinite(rows["now"][4])
    assert foot_to_tool[counted] == pytest.approx(rows["now"][4][counted], abs=1e-3)  # um, in floats of 32 bits
    for i, place in enumerate(shown["places"]):
        assert place["line"] in (3, 4)
        names = [each["name"] for each in shown["charts"][f"place_{i}"]["panels"][0]["curves"]]
        assert names[:3] == ["commanded", "today", "now"]
    assert [each["number"] for each in shown["charts"]["deviation"]["panels"][0]["curves"]] == [100, 101]
    asked(session, "tune.move", name="law.Kv", value=before)
    assert "earlier control" in asked(session, "program.show")["found"]["said"][0]
    # another plan: what ran belongs to the one before
    shown, _ = done(session, "program.plan", name="corner.ngc")
    assert shown["runs"] == []


@pytest.mark.slow(reason="a five-axis program, planned and run: 8 s")
def test_a_program_of_the_tip_is_judged_at_the_tip_and_along_the_tool(tmp_path: Path) -> None:
    session = Session(tmp_path)
    shown, rows = done(session, "program.example")
    assert shown["tip"]
    assert shown["title"].startswith("small machining center, trunnion A with table C")
    assert shown["letters"] == "XYZAC"
    plan = rows["plan"]
    kinematics = read_machine("trunnion_ac").kinematics
    assert kinematics is not None
    # the tool that is drawn: tip and direction from the joints, at instants all over the program
    for k in np.linspace(0, plan.shape[1] - 1, 7).astype(int):
        x, y, z, a, c = (float(each) for each in plan[9:, k])
        rotary = (np.radians(a), np.radians(c))
        assert plan[5:8, k] == pytest.approx(kinematics.tool_axis(rotary), abs=1e-6)
        assert plan[2:5, k] == pytest.approx(
            1e3 * np.array(kinematics.tip([1e-3 * x, 1e-3 * y, 1e-3 * z], rotary)), abs=2e-4
        )  # mm, from floats of 32 bits at an arm of 100 mm
    assert [each["label"] for each in shown["charts"]["axes"]["panels"]] == [
        "linear (mm)",
        "rotary (deg)",
        "limit in use (%)",
    ]
    shown, rows = done(session, "program.run", name="s_curve.ngc")
    panels = shown["charts"]["deviation"]["panels"]
    assert [each["label"] for each in panels] == ["tip (µm)", "tool angle (µrad)"]
    proven = float(figure(shown, "tip")["value"])
    assert panels[0]["levels"][0]["value"] == pytest.approx(proven, rel=5e-3)
    assert "angle" in {each["key"] for each in shown["figures"]}
    assert shown["next"] == ""
    assert "moves the tip of the tool" in asked(session, "program.correct", name="s_curve.ngc")["error"]


@pytest.mark.slow(reason="a part program on seven machines: 25 s")
def test_a_part_program_is_corrected_and_its_setpoints_are_taken_away(tmp_path: Path) -> None:
    session = Session(tmp_path, bench_of("mill", "x"))
    done(session, "program.plan", name="circle_diamond_square.ngc")
    shown, rows = done(session, "program.correct", name="circle_diamond_square.ngc")
    out = session.desk.folder / "setpath"
    figures = json.loads((out / "setpath.json").read_text(encoding="utf-8"))["contour_rms_m"]
    assert 0.0 < figures["corrected"] < figures["plain"]
    assert float(figure(shown, "rms")["value"]) == pytest.approx(1e6 * figures["corrected"], rel=5e-3)
    assert float(figure(shown, "worst")["value"]) == pytest.approx(1e6 * figures["worst_corrected"], rel=5e-3)
    assert shown["runs"] == ["now", "corrected"]
    assert (len(shown["places"]), len(shown["falls"])) == (8, 12)
    assert {"plan", "now", "corrected"} == set(rows)
    assert shown["heats"]["now"] == shown["heats"]["corrected"]  # one scale of colors
    # what the report says of its trials stands there alone
    found = shown["found"]
    parts = [part for each in found["sections"] for part in each["parts"] if part["kind"] == "remarks"]
    assert not set(found["said"]) & {text for part in parts for text in part["sentences"]}
    with zipfile.ZipFile(session.desk.folder / shown["archive"]) as archive:
        assert {"setpoints.csv", "setpoints.hal", "report.html"} <= {Path(name).name for name in archive.namelist()}
    assert "setpath" in session.desk.results()
    assert "feeddrive setpath " in recipe_of(session.desk).commands


@pytest.mark.slow(reason="a part program on seven machines, with four shares of the correction: 20 s")
def test_a_correction_that_harms_a_machine_is_refused_with_the_machine(tmp_path: Path) -> None:
    session = Session(tmp_path, bench_of("mill", "x"))
    done(session, "program.plan", name="slot.ngc")
    shown, _ = done(session, "program.correct", name="slot.ngc")
    assert shown["found"]["bad"]
    assert "at most 1.02 is accepted" in shown["found"]["verdict"][0]
    assert shown["verdict"].startswith("Not corrected")
    assert figure(shown, "worst")["state"] == "broken"
    assert not (session.desk.folder / "setpath" / "setpoints.csv").exists()

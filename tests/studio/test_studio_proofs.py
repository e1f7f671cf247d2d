"""The rooms Compare and Prove: which laws are compared, what goes on with a law, and what is shown of which control."""

from __future__ import annotations

import json
import shlex
import struct
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from feeddrive.machining.circle_test import quadrant_peaks
from feeddrive.studio.bench import Bench, bench_of
from feeddrive.studio.jobs import CANCELLED
from feeddrive.studio.live import Playback
from feeddrive.studio.rooms.export import recipe_of
from feeddrive.studio.server import Session
from feeddrive.tuning.candidates import candidates, likeliest
from feeddrive.workflow.compare import TAKEN, CompareRequest
from feeddrive.workflow.tour import axis, strokes

WANTED = ["P-PI", "P-PI + compensator", "P-PI + recovery"]


def read(answer: bytes) -> tuple[dict[str, Any], np.ndarray]:
    (length,) = struct.unpack_from("<I", answer)
    return json.loads(answer[4 : 4 + length]), np.frombuffer(answer[4 + length :], "<f4")


def asked(session: Session, do: str, **more: Any) -> dict[str, Any]:
    return read(session.answer({"number": 1, "do": do, **more}))[0]


def done(session: Session, do: str, **more: Any) -> dict[str, Any]:
    """An act, the end of the work that it began, and what its room shows then."""
    assert "error" not in asked(session, do, **more)
    assert session.desk.job is not None
    session.desk.job.join(120.0)
    assert session.desk.job.state.error == ""
    return asked(session, f"{do.partition('.')[0]}.show")


@pytest.fixture(scope="module")
def bench() -> Bench:
    return bench_of("mill", "x")


@pytest.fixture
def session(bench: Bench, tmp_path: Path) -> Session:
    return Session(tmp_path, bench)


@pytest.fixture(scope="module")
def compared(bench: Bench, tmp_path_factory: pytest.TempPathFactory) -> Session:
    """A page on which some laws were chosen and compared; a row came as each of them was finished."""
    session = Session(tmp_path_factory.mktemp("compared"), bench)
    assert "error" not in asked(session, "compare.choose", laws=WANTED[1:])
    begun = asked(session, "compare.start", starts=2)
    assert (begun["found"], sorted(begun["to_come"])) == (None, sorted(WANTED))
    seen = list[list[str]]()
    while not session.desk.is_free:
        said = asked(session, "compare.show")
        rows = [] if said["found"] is None else [each["name"] for each in said["found"]["laws"][1:]]
        assert sorted([*rows, *said["to_come"]]) == sorted(WANTED)
        seen += [rows] if rows not in seen else []
        session.desk.job.join(0.05)  # type: ignore[union-attr]
    assert session.desk.job.state.error == ""  # type: ignore[union-attr]
    assert [len(rows) for rows in seen][:3] == [0, 1, 2]
    last = asked(session, "compare.show")
    assert (last["to_come"], last["partial"]) == ([], False)
    return session


def test_the_page_lists_the_laws_of_the_axis_and_keeps_the_choice(session: Session, bench: Bench) -> None:
    shown = asked(session, "compare.show")
    assert [each["name"] for each in shown["laws"]] == [law.name for law in candidates(bench.needed_loop())[0]]
    wanted = [each["name"] for each in shown["laws"] if each["wanted"]]
    assert sorted(wanted) == sorted(likeliest(bench.needed_loop(), candidates(bench.needed_loop())[0]))
    assert all(each["reason"] for each in shown["refused"])
    said = asked(session, "compare.choose", laws=["P-PI + recovery"])
    assert [each["name"] for each in said["laws"] if each["wanted"]] == ["P-PI", "P-PI + recovery"]
    wrong = asked(session, "compare.choose", laws=[shown["refused"][0]["name"]])
    assert "cannot be compared on this axis; there are: P-PI" in wrong["error"]
    again = asked(session, "compare.show")["laws"]
    assert [each["name"] for each in again if each["wanted"]] == ["P-PI", "P-PI + recovery"]


def test_only_what_was_chosen_is_compared_and_drawn_with_its_figures(compared: Session) -> None:
    said, _ = read(compared.answer({"number": 1, "do": "compare.show"}))
    laws = said["found"]["laws"]
    assert [each["name"] for each in laws] == ["today's gains", *WANTED]
    (request,) = [each.request for each in compared.desk.done if each.command == "compare"]
    assert isinstance(request, CompareRequest)
    assert list(request.law) == WANTED
    drawn = [each["name"] for each in laws if each["drawn"]]
    for panel in said["charts"]["tradeoff"]["panels"]:
        # a line for each law with a place, from the model to the worst plant of the box
        assert len(panel["curves"]) == len([each for each in laws if each["drawn"] and not each["why"]])
        marks = {mark["key"]: mark for mark in panel["marks"]}
        assert list(marks) == drawn
        assert {name for name, mark in marks.items() if mark["hollow"]} == {
            each["name"] for each in laws if each["why"]
        }
    assert laws[0]["why"].startswith("outside of the rule")


@pytest.mark.slow(reason="its commands run again in a process of their own: 10 s; the recipe has tests of its own")
def test_a_law_that_is_taken_is_in_the_recipe_which_writes_the_same_control(compared: Session, tmp_path: Path) -> None:
    said = asked(compared, "compare.take", law="P-PI + recovery")
    assert said["go"] == "tune"
    control = compared.desk.control
    assert [type(each).__name__ for each in control.compensation] == ["DisturbanceRejection"]
    (request,) = [each.request for each in compared.desk.done if each.command == "compare"]
    assert isinstance(request, CompareRequest)
    assert request.take == "P-PI + recovery"
    assert compared.desk.machine_path() == request.out / TAKEN  # type: ignore[operator]
    written = (request.out / TAKEN).read_text(encoding="utf-8")  # type: ignore[operator]
    (line,) = [each for each in recipe_of(compared.desk).commands.splitlines() if each]
    words = shlex.split(line)
    words[words.index("-o") + 1 if "-o" in words else words.index("--out") + 1] = str(tmp_path / "out")
    program = "from feeddrive.cli.commands import app; app()"
    subprocess.run([sys.executable, "-c", program, *words[1:]], check=True, capture_output=True, timeout=120.0)
    assert (tmp_path / "out" / TAKEN).read_text(encoding="utf-8") == written
    assert "undo" in asked(compared, "tune.undo")  # it is a step that can be undone
    assert not compared.desk.control.compensation


def test_the_law_that_is_taken_stands_in_the_recipe_where_it_was_compared(session: Session) -> None:
    """What was moved and written meanwhile comes after it, and a second law beside the first."""
    asked(session, "compare.choose", laws=[])
    name = next(each for each in session.desk.values if each.startswith("law."))
    start = session.desk.values[name]
    asked(session, "tune.move", name=name, value=0.95 * start, begins=True)
    done(session, "compare.start", starts=1)
    asked(session, "tune.move", name=name, value=0.9 * start, begins=True)
    session.desk.machine_path()
    asked(session, "compare.take", law="P-PI")
    asked(session, "compare.take", law="P-PI")
    steps = [(each.command, getattr(each.request, "take", None)) for each in session.desk.done]
    compares = [each for each in steps if each[0] == "compare"]
    assert set(compares) == {("compare", "P-PI")}
    assert steps == [("adjust", None), *compares, ("adjust", None)]
    assert f"={0.95 * start}" in session.desk.done[0].request.set[0]  # type: ignore[attr-defined]


@pytest.mark.slow(reason="a third comparison, whose engine has the same test")
def test_a_comparison_that_was_canceled_goes_on_where_it_was(session: Session) -> None:
    asked(session, "compare.choose", laws=["P-PI + recovery", "P-PI + DOB"])
    assert "error" not in asked(session, "compare.start", starts=1)
    job = session.desk.job
    assert job is not None
    kept = session.desk.folder / "compared_laws"
    while not (kept.is_dir() and any(each.is_file() for each in kept.rglob("*"))):
        job.join(0.05)
        assert job.state.going, "it ended before the first law was finished"
    session.answer({"number": 1, "do": "job.cancel"})
    job.join(20.0)
    assert job.state.state == CANCELLED
    first = {each: each.stat().st_mtime_ns for each in kept.rglob("*") if each.is_file()}
    assert first
    assert asked(session, "compare.show")["found"] is None
    found = done(session, "compare.start", starts=1)["found"]
    assert [each["name"] for each in found["laws"]] == ["today's gains", "P-PI", "P-PI + recovery", "P-PI + DOB"]
    assert {each: each.stat().st_mtime_ns for each in first} == first  # what was finished was not computed again


@pytest.mark.slow(reason="two more circles")
def test_circles_of_the_control_before_lie_under_those_of_now(session: Session) -> None:
    shown = done(session, "prove.circle", x="x", y="y")
    assert not any(curve["look"] == "thin" for curve in shown["charts"]["circle.circle"]["panels"][0]["curves"])
    before = session.rooms["prove"].circles[-1][1].result  # type: ignore[attr-defined]
    name = next(each for each in session.desk.values if each.startswith("law."))
    asked(session, "tune.move", name=name, value=0.95 * session.desk.values[name])
    shown = done(session, "prove.circle", x="x", y="y")
    test = session.rooms["prove"].circles[-1][1].result  # type: ignore[attr-defined]
    curves = shown["charts"]["circle.circle"]["panels"][0]["curves"]
    named = [each for each in curves if each["name"]]
    assert sum(each["look"] == "thin" for each in curves) == 4
    for curve, now, then in zip(named, test.figures, before.figures, strict=False):
        assert curve["said"] == f"G {1e6 * now.G:.4g} µm, before {1e6 * then.G:.4g} µm"
    peaks = shown["shown"]["circle"]["peaks"]
    for said, each in zip(peaks, quadrant_peaks(test), strict=False):
        left, right = said["view"]
        assert left <= np.degrees(each.angle) <= right
        assert said["text"].startswith(f"{1e6 * each.height:.3g} µm at {each.side}{each.axis}")


def test_values_and_radii_go_over_the_wire_behind_their_places(session: Session) -> None:
    said, numbers = read(session.answer({"number": 1, "do": "prove.show"}))
    assert said["shown"] == {}
    done(session, "prove.certify")
    said, numbers = read(session.answer({"number": 1, "do": "prove.show"}))
    (may,) = [each for each in said["charts"]["certificate.discs"]["panels"][0]["curves"] if each["reach"]]
    at, n = may["at"], may["n"]
    x, y, reach = numbers[at : at + n], numbers[at + n : at + 2 * n], numbers[at + 2 * n : at + 3 * n]
    assert np.all(np.hypot(x + 1.0, y) > reach)  # no disc holds -1
    assert np.all(reach > 0.0)
    assert reach == pytest.approx(0.2 * np.hypot(x, y), rel=1e-3)  # r = 0.2 of |L|, the usual radius


def test_of_another_source_no_certificate_is_taken_away_and_of_another_control_it_is_said(
    bench: Bench, tmp_path: Path
) -> None:
    session = Session(tmp_path, bench)
    done(session, "prove.certify")
    assert asked(session, "export.show")["results"] == [{"name": "certificate", "said": ""}]
    name, before = next(iter(session.desk.values.items()))
    asked(session, "tune.move", name=name, value=0.9 * before)
    (found,) = asked(session, "export.show")["results"]
    assert found["said"] == "This result belongs to an earlier control. Run it again for the current one."
    asked(session, "tune.move", name=name, value=before)
    assert asked(session, "export.show")["results"] == [{"name": "certificate", "said": ""}]
    assert "error" not in asked(session, "import.bundled", name="ball_screw")
    assert (tmp_path / "certificate").is_dir()  # of the source before
    assert asked(session, "export.show")["results"] == []
    assert "name must be one of" in asked(session, "export.result", name="certificate")["error"]


def test_what_is_not_proven_says_by_how_much_and_what_can_be_proven_instead(session: Session) -> None:
    """The percentage that is offered is proven by the checker, and two digits more are not."""
    proof = done(session, "prove.certify", model_error=300.0)["shown"]["certificate"]["proof"]
    assert not proof["proven"]
    assert 0.0 < proof["room"] < 1.0
    # 2 digits, rounded down: at most 10 % below what the room admits
    assert 0.9 * 300.0 * proof["room"] < proof["instead"] < 300.0 * proof["room"]
    assert [kept for _, kept in proof["covers"]] == [True, True, True, False]
    assert len(proof["outside"]) == 4
    assert proof["files"] == []
    assert not [step for step in session.desk.done if step.command == "certify"]  # a repetition would fail
    found = done(session, "prove.certify", model_error=proof["instead"])["shown"]["certificate"]["proof"]
    assert found["proven"]
    assert 1.0 < found["room"] < 1.12
    assert all((session.desk.folder / file["name"]).is_file() for file in found["files"])
    # the other control is judged by the same error
    assert {each["name"]: each["room"] for each in found["rooms"]}["Now"] == pytest.approx(found["room"])
    wrong = asked(session, "prove.certify", model_error=0)
    assert "the model may be wrong by more than 0" in wrong["error"]


def test_a_loop_that_is_unstable_is_a_verdict_and_no_fault(session: Session) -> None:
    name = "law.omega_c"
    asked(session, "tune.move", name=name, value=session.desk.values[name] * 30.0, first=True)
    proof = done(session, "prove.certify")["shown"]["certificate"]["proof"]
    assert (proof["proven"], proof["head"], proof["room"]) == (False, "The loop itself is unstable.", None)
    assert "Hz grows" in proof["sentence"]


def test_an_example_stands_where_nothing_was_done(session: Session, tmp_path: Path) -> None:
    assert "example.margin" in asked(session, "prove.show")["charts"]
    rows = asked(session, "compare.show")["example"]["rows"]
    assert rows[0][0] == "P-PI"
    assert all(value < rows[0][1] for _, value, _ in rows[1:])  # the likeliest have less error there
    (tmp_path / "none").mkdir()
    none = Session(tmp_path / "none")
    assert "law_Kp" in asked(none, "export.show")["example"]
    assert "example" in asked(none, "optimize.show")["charts"]
    assert "example" in asked(none, "scope.show")["charts"]
    assert "error" not in asked(none, "scope.follow", name="example")
    deadline = time.monotonic() + 20.0
    while "scope" not in (said := asked(none, "scope.frame"))["charts"] and time.monotonic() < deadline:
        time.sleep(0.05)
    assert said["state"].startswith("plays the bundled example")
    assert said["of"][3] == "drive force N"
    asked(none, "scope.stop")
    none.desk.close()


def test_what_the_model_may_be_wrong_by_is_that_of_the_certificate_and_has_bounds(session: Session) -> None:
    said = done(session, "prove.certify")
    assert said["shown"]["certificate"]["proof"]["proven"]
    document = json.loads((session.desk.folder / "certificate.json").read_text(encoding="utf-8"))
    radii = {r for plant in document["plants"] for band in plant["radius"] for r in band["r"]}
    assert [100.0 * r for r in radii] == [pytest.approx(said["model_error"])]
    assert "at most 500 %" in asked(session, "prove.certify", model_error=501.0)["error"]
    assert not done(session, "prove.certify", model_error=499.0)["shown"]["certificate"]["proof"]["proven"]


def test_the_bundled_source_plays_all_strokes_at_a_thousand_rows_a_second(session: Session) -> None:
    rows = Playback(1.0).take()
    assert np.diff(rows.time) == pytest.approx(1e-3)
    assert 1000 <= rows.time.size <= 1500  # and those of the time that the test took
    chart = asked(session, "scope.show")["charts"]["example"]
    loop = axis()
    lasts = strokes(float(loop.sample_time)).size * float(loop.sample_time)
    assert -chart["low"] == pytest.approx(lasts, abs=0.01)  # ten rows

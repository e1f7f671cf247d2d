"""The room Commission: questions of long work, who may answer them, and what becomes of an axis that nobody watches."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from feeddrive.language.errors import ParameterError
from feeddrive.language.progress import Progress
from feeddrive.studio import jobs
from feeddrive.studio.command import StudioRequest
from feeddrive.studio.jobs import CANCELLED, DONE, Job, Question
from feeddrive.studio.server import Session
from feeddrive.workflow.commission_steps import STEPS

DRIVE = """
bus = "ethercat"
interface = "eth7"
cycle_time = 0.001
[scaling]
increment = 1e-8
rated_force = 500.0
[limits]
travel = 0.1
velocity = 0.5
force = 1500.0
following_error = 0.002
"""


def asking(progress: Progress) -> tuple[bool, float | None]:
    progress.step("before", 0, 2)
    yes = progress.quiet().confirm("Is the travel clear?")
    return yes, progress.measured("By how much did it move?", 0.01, "m")


def braking(path: str, progress: Progress) -> str:
    """Work that needs two seconds after a cancel."""
    while not progress.cancelled:
        time.sleep(0.01)
    time.sleep(2.0)
    Path(path).write_text("the drive is as it was", encoding="utf-8")
    return "put back"


def until(true: Callable[[], Any], seconds: float = 120.0) -> None:
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.02)


@pytest.fixture
def session(tmp_path: Path) -> Session:
    return Session(tmp_path / "page")


def began(session: Session, work: Any, patience: float = 0.0) -> tuple[Job, list[Any]]:
    ended = list[Any]()
    session.desk.start("commission", "the work", work, ended.append, patience=patience)
    assert session.desk.job is not None
    return session.desk.job, ended


def words(content: bytes) -> dict[str, Any]:
    size = struct.unpack("<I", content[:4])[0]
    return dict(json.loads(content[4 : 4 + size]))


def asked(session: Session, do: str, page: object = None, **parameters: Any) -> dict[str, Any]:
    return words(session.answer({"number": 1, "do": f"commission.{do}", **parameters}, page))


# questions of work


def test_a_question_reaches_the_page_and_its_answer_the_work(session: Session) -> None:
    said = list[bytes]()
    session.listen(lambda _, each: said.append(each))
    job, ended = began(session, asking)
    until(lambda: job.state.question)
    assert job.state.question == Question(1, "Is the travel clear?")
    for number, value in ((2, True), (1, 0.5), (1, None)):
        with pytest.raises(ParameterError):
            job.answer(number, value)
    job.answer(1, True)
    with pytest.raises(ParameterError, match="no longer open"):
        job.answer(1, True)
    until(lambda: job.state.question)
    assert job.state.question == Question(2, "By how much did it move?", 0.01, "m")
    with pytest.raises(ParameterError, match="must be a number in m"):
        job.answer(2, True)
    job.answer(2, 0.0101)
    job.join(30.0)
    assert (job.state.state, job.state.question, ended) == (DONE, None, [(True, 0.0101)])
    told = [words(each)["job"] for each in said if b'"job"' in each]
    assert {"number": 1, "text": "Is the travel clear?", "expected": None, "unit": ""} in [
        each["question"] for each in told
    ]
    with pytest.raises(ParameterError, match="no longer open"):
        job.answer(2, 1.0)


def test_a_cancel_is_an_end_to_the_question(session: Session) -> None:
    job, ended = began(session, asking)
    until(lambda: job.state.question)
    job.cancel()
    job.join(30.0)
    assert (job.state.state, job.state.question, ended) == (CANCELLED, None, [])


@pytest.mark.parametrize("end", ["cancel", "close", "all"])
def test_work_that_moves_an_axis_may_brake_and_put_back(
    session: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, end: str
) -> None:
    monkeypatch.setattr(jobs, "_PATIENCE", 0.2)
    job, _ = began(session, partial(braking, str(tmp_path / "told")), patience=30.0)
    until(lambda: job.state.state == "running")
    {"cancel": job.cancel, "close": session.close, "all": jobs.end_all}[end]()
    job.join(30.0)
    assert (tmp_path / "told").read_text(encoding="utf-8") == "the drive is as it was"


def test_work_that_moves_an_axis_brakes_when_its_server_is_killed(tmp_path: Path) -> None:
    script = f"""
import sys, time
from functools import partial
sys.path[:0] = {sys.path!r}
from test_studio_commission import braking, began
from feeddrive.studio.server import Session
from pathlib import Path
if __name__ == "__main__":
    work = partial(braking, {str(tmp_path / "told")!r})
    job, _ = began(Session(Path({str(tmp_path)!r}) / "page"), work, patience=30.0)
    while job.state.state != "running":
        time.sleep(0.01)
    print("runs", flush=True)
    time.sleep(600)
"""
    (tmp_path / "server.py").write_text(script, encoding="utf-8")
    server = subprocess.Popen([sys.executable, str(tmp_path / "server.py")], stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    assert server.stdout.readline() == "runs\n"
    time.sleep(1.0)
    server.kill()
    server.wait()
    server.stdout.close()
    until((tmp_path / "told").is_file, 30.0)


# the room


def test_a_drive_is_moved_only_if_it_was_named_when_the_studio_began(tmp_path: Path) -> None:
    path = tmp_path / "drive.toml"
    path.write_text(DRIVE, encoding="utf-8")
    session = Session(tmp_path / "page", drives=(path,))
    start = {"goal": "rope-snap", "target": "c", "yes": False, "anew": False}
    assert {"name": str(path), "kind": "drive"} in asked(session, "show")["sources"]
    for other in (str(tmp_path / "other.toml"), "/etc/passwd", "gantry"):
        assert "source must be one of" in asked(session, "start", source=other, **start)["error"]
    refused = asked(session, "start", source=str(path), **{**start, "yes": True})["error"]
    assert refused.endswith("may move something real: its questions are answered one by one")
    assert session.desk.job is None
    with pytest.raises(ParameterError, match="whoever moves an axis must stand at its stop"):
        StudioRequest(host="0.0.0.0", password_file=tmp_path / "password", commission=(path,))


def test_only_the_tab_that_began_answers_and_the_axis_stops_when_it_goes(session: Session) -> None:
    mine, other = object(), object()
    leave, leaves = (session.listen(lambda *_: None, page) for page in (mine, other))
    shown = asked(session, "start", mine, source="emps", goal="rope-snap", target="c", yes=False, anew=False)
    assert shown["going"]
    assert [step["name"] for step in shown["steps"]] == list(STEPS)
    assert all(step["does"].endswith(".") for step in shown["steps"])
    job = session.desk.job
    assert job is not None
    until(lambda: job.state.question or not job.state.going)
    assert "Small move" in job.state.question.text  # type: ignore[union-attr]
    for page in (other, None):
        assert "begun in another tab of the browser" in asked(session, "answer", page, question=1, yes=True)["error"]
    assert job.state.question is not None
    shown = asked(session, "show", other)
    assert [step["name"] for step in shown["steps"] if step["says"]] == ["listen"]
    assert shown["found"]["verdict"] == ["Not finished: the last step was listen."]
    assert shown["archive"] == ""
    leaves()
    assert job.state.going
    leave()  # the tab is closed or loaded again
    job.join(60.0)
    shown = asked(session, "show")
    assert not shown["going"]
    assert "stopped by hand" in shown["found"]["verdict"][0]
    assert shown["found"]["bad"]
    assert (session.desk.folder / "commission_emps" / "commission.json").is_file()
    assert shown["archive"] == "commission_emps.zip"
    assert "commission --virtual emps" in shown["line"]
    assert "no question to answer" in asked(session, "answer", mine, question=1, yes=True)["error"]
    assert "no tuned machine file" in asked(session, "open")["error"]


def test_a_measured_number_is_read_in_its_unit(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    room: Any = session.rooms["commission"]
    job, ended = began(session, asking)
    until(lambda: job.state.question)
    asked(session, "answer", question=1, yes=False)
    until(lambda: job.state.question)
    for value, unit, why in ((float("nan"), "mm", "finite"), ("ten", "mm", "number"), (10.0, "kg", "must be one of")):
        assert why in asked(session, "answer", question=2, value=value, unit=unit)["error"]
    asked(session, "answer", question=2, value=9.8, unit="mm")
    job.join(30.0)
    assert ended == [(False, pytest.approx(9.8e-3))]
    assert room.show().words["rulers"]["m"][0] == "mm"

"""Long work of the page in a process of its own: what it says, how it is stopped, and what a crash leaves."""

from __future__ import annotations

import os
import time
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from feeddrive.language.errors import ParameterError
from feeddrive.language.progress import Progress
from feeddrive.studio.desk import Desk
from feeddrive.studio.jobs import CANCELLED, DONE, FAILED, Found
from feeddrive.studio.server import Session


def counted(of: int, progress: Progress) -> int:
    progress.remark("a remark")
    for i in range(of):
        progress.step("counting", i, of)
    return of


def endless(progress: Progress) -> None:
    while True:
        progress.step("waiting")
        time.sleep(0.01)


def deaf(_: Progress) -> None:
    time.sleep(600.0)


def crashing(_: Progress) -> None:
    os._exit(3)


def faulty(progress: Progress) -> None:
    raise ParameterError("mass_load must be > 0 kg")


def reporting(progress: Progress) -> None:
    for cost in (3.0, 2.0, 1.0):  # faster than they are drawn: the last one counts
        progress.better(cost, "a control")


@pytest.fixture
def session(tmp_path: Path) -> Session:
    return Session(tmp_path)


def run(session: Session, work: Any, **more: Any) -> tuple[Desk, list[Any]]:
    ended = list[Any]()
    session.desk.start("optimize", "the work", work, ended.append, **more)
    assert session.desk.job is not None
    session.desk.job.join(60.0)
    return session.desk, ended


def test_work_gives_its_result_remarks_and_last_step(session: Session) -> None:
    said = list[bytes]()
    session.listen(lambda _, each: said.append(each))
    desk, ended = run(session, partial(counted, 4))
    state = desk.job_state()
    assert state is not None
    assert (state.state, state.remarks, ended) == (DONE, ("a remark",), [4])
    assert any(b'"room":"optimize"' in each for each in said)  # the room is shown again


def test_what_work_finds_on_its_way_reaches_its_room(session: Session) -> None:
    met = list[Found]()
    run(session, reporting, improved=met.append)
    assert met == [Found(3.0, "a control"), Found(1.0, "a control")]


def test_another_work_has_to_wait_and_a_cancel_makes_room(session: Session) -> None:
    session.desk.start("optimize", "the first work", endless, lambda _: None)
    with pytest.raises(ParameterError, match="the first work is running: wait for its end, or cancel it"):
        session.desk.start("optimize", "the second", endless, lambda _: None)
    job = session.desk.job
    assert job is not None
    session.answer({"number": 1, "do": "job.cancel"})
    job.join(30.0)
    assert job.state.state == CANCELLED
    assert run(session, partial(counted, 1))[1] == [1]


def test_work_that_does_not_listen_is_ended(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("feeddrive.studio.jobs._PATIENCE", 0.2)
    session.desk.start("optimize", "deaf work", deaf, lambda _: None)
    job = session.desk.job
    assert job is not None
    while job.state.state == "waiting":
        time.sleep(0.01)
    job.cancel()
    job.join(30.0)
    assert job.state.state == CANCELLED


@pytest.mark.parametrize(("work", "said"), [(crashing, "it was killed, or memory ran out"), (faulty, "must be > 0 kg")])
def test_what_goes_wrong_is_said_and_the_page_goes_on(session: Session, work: Any, said: str) -> None:
    desk, ended = run(session, work)
    state = desk.job_state()
    assert state is not None
    assert state.state == FAILED
    assert said in state.error
    assert not ended
    assert run(session, partial(counted, 1))[1] == [1]

"""Long work of the page in a process of its own: what it says, how it is stopped, and what a crash leaves."""

from __future__ import annotations

import json
import os
import struct
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


def asked(session: Session, do: str, **more: Any) -> dict[str, Any]:
    answer = session.answer({"number": 1, "do": do, **more})
    (length,) = struct.unpack_from("<I", answer)
    return json.loads(answer[4 : 4 + length])


@pytest.fixture
def session(tmp_path: Path) -> Session:
    return Session(tmp_path)


def run(session: Session, work: Any, **more: Any) -> tuple[Desk, list[Any]]:
    ended = list[Any]()
    session.desk.start("goal", "the work", work, ended.append, **more)
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
    assert any(b'"room":"goal"' in each for each in said)  # the room is shown again


def test_what_work_finds_on_its_way_reaches_its_room(session: Session) -> None:
    met = list[Found]()
    run(session, reporting, improved=met.append)
    assert met == [Found(3.0, "a control"), Found(1.0, "a control")]


def test_other_works_wait_in_an_order_that_can_be_changed_and_a_cancel_makes_room(session: Session) -> None:
    desk, ended = session.desk, list[str]()
    desk.start("goal", "the first work", endless, lambda _: None)
    for name in ("second", "third", "fourth"):
        desk.start("goal", name, partial(counted, 1), lambda _, name=name: ended.append(name))
    first = desk.job
    assert first is not None
    second, third, fourth = desk.queue
    with pytest.raises(ParameterError, match="the first work is running: wait for its end, or cancel it"):
        desk.start("commission", "a motion", endless, lambda _: None, patience=1.0)  # nobody may stand there later
    session.answer({"number": 1, "do": "job.sooner", "task": fourth.number})
    session.answer({"number": 1, "do": "job.remove", "task": second.number})
    assert desk.queue == [fourth, third]
    said = asked(session, "job.sooner", task=second.number)
    assert "does not wait any more" in said["error"]
    session.answer({"number": 1, "do": "job.cancel"})
    first.join(30.0)
    assert first.state.state == CANCELLED
    begun = time.monotonic()
    while not desk.is_free and time.monotonic() - begun < 60.0:
        time.sleep(0.02)
    assert ended == ["fourth", "third"]


def test_work_that_does_not_listen_is_ended(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("feeddrive.studio.jobs._PATIENCE", 0.2)
    session.desk.start("goal", "deaf work", deaf, lambda _: None)
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


def steady(of: int, progress: Progress) -> None:
    for i in range(of):
        progress.step(f"part {i}", i, of)  # each has a name of its own
        time.sleep(0.1)


def test_the_rest_of_what_is_counted_is_extrapolated_and_nothing_else(session: Session) -> None:
    """At 10 counts a second the end is foretold to a third; on a machine at rest to some percent."""
    said = list[tuple[float, float]]()
    session.desk.start("goal", "the work", partial(steady, 40), lambda _: None)
    job = session.desk.job
    assert job is not None
    while job.state.going:
        if job.state.left is not None:
            said.append((time.monotonic(), job.state.left))
        time.sleep(0.05)
    end = time.monotonic()
    assert said
    first, left = said[0]
    assert left == pytest.approx(end - first, rel=1 / 3)
    assert left <= 2.5  # nothing is said in the first 2 s
    assert run(session, partial(counted, 2))[0].job_state().left is None  # type: ignore[union-attr]


def test_twenty_jobs_may_wait(session: Session) -> None:
    session.desk.start("goal", "the first work", endless, lambda _: None)
    for _ in range(20):
        session.desk.start("goal", "another", endless, lambda _: None)
    with pytest.raises(ParameterError, match="20 jobs are waiting already: remove one of them first"):
        session.desk.start("goal", "one too many", endless, lambda _: None)
    session.close()
    assert session.desk.job is not None
    session.desk.job.join(30.0)
    assert len(session.desk.queue) == 20  # nothing begins after the end

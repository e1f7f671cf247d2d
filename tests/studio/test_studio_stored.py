"""What a page keeps on disk: its state is found again by another server, and a file of somebody else runs no code."""

from __future__ import annotations

import json
import os
import struct
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.language import tree
from feeddrive.language.errors import FileError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.studio import command, stored
from feeddrive.studio.bench import Bench, bench_of
from feeddrive.studio.jobs import DONE
from feeddrive.studio.server import Session, earlier_work, kept_folder
from feeddrive.studio.stored import FOLDER, Code, read_part, same


@pytest.fixture(scope="module")
def bench() -> Bench:
    return bench_of("linear_motor")


@pytest.fixture
def begin(tmp_path: Path) -> Iterator[Callable[..., Session]]:
    """Begins the session of a page in a folder, and ends all of them."""
    made = list[Session]()

    def one(bench: Bench | None, folder: Path = tmp_path / "own", name: str = "page") -> Session:
        folder.mkdir(exist_ok=True)
        made.append(Session(folder, bench, name=name))
        return made[-1]

    yield one
    for each in made:
        each.close()


def ask(session: Session, do: str, page: object = None, **more: Any) -> dict[str, Any]:
    answer = session.answer({"number": 1, "do": do, **more}, page)
    (length,) = struct.unpack_from("<I", answer)
    said: dict[str, Any] = json.loads(answer[4 : 4 + length])
    assert "error" not in said, said["error"]
    return said


def endless(progress: Progress) -> None:
    while True:
        progress.step("waiting")
        time.sleep(0.01)


def killed(session: Session) -> None:
    """What a page keeps is written, and its server ends without another word."""
    session.keeper.write()
    session.keeper.end()
    session.desk.close()


def test_values_survive_their_way_to_a_file() -> None:
    code = Code()
    control, notch = (
        bench_of("ball_screw").before.start,
        fd.blocks.Notch(frequency=5.0, damping_zero=0.1, damping_pole=0.5),
    )
    array = np.array([1.0 + 2.0j, np.nan])
    values = [(1, (2.5, "x")), {"a": {Path("b"): None}}, {"one", "two"}, float("inf"), Quantity(2.0, "N")]
    assert code.value(json.loads(json.dumps(code.data(values)))) == values
    np.testing.assert_array_equal(code.value(json.loads(json.dumps(code.data(array)))), array)
    again, first, second = code.value(json.loads(json.dumps(code.data([control, notch, replace(notch)]))))
    assert dict(tree.leaves(again)) == dict(tree.leaves(control))
    assert first is second  # blocks have no other equality
    with pytest.raises(TypeError, match="a function cannot be kept"):
        code.data(endless)


@pytest.mark.parametrize(
    "kind",
    [
        "os:system",
        "subprocess:Popen",
        "feeddrive.studio.jobs:perform",
        "feeddrive.studio.jobs:Job",
        "feeddrive.bus.none:X",
    ],
)
def test_a_file_of_somebody_else_makes_only_values_of_feeddrive(kind: str, tmp_path: Path) -> None:
    (tmp_path / FOLDER).mkdir()
    state = {"kind": kind, "has": {"command": "touch x"}}
    (tmp_path / FOLDER / "desk.json").write_text(json.dumps({"state": state}), encoding="utf-8")
    with pytest.raises(FileError, match=r"desk\.json: holds a .* which this version of feeddrive does not know"):
        read_part(tmp_path, "desk", Code())


def test_states_are_the_same_by_identity_of_what_is_frozen() -> None:
    one, other = np.zeros(2), np.zeros(2)
    assert same({"a": [1, (one,)]}, {"a": [1, (one,)]})
    assert not same({"a": [1, (one,)]}, {"a": [1, (other,)]})
    assert not same({"a": 1, "b": 2}, {"b": 2, "a": 1})  # a queue is an order


def test_a_server_that_begins_anew_finds_the_work_again(bench: Bench, begin: Callable[..., Session]) -> None:
    session = begin(bench)
    ask(session, "tune.see", names=["open_loop", "nyquist"])  # another filter compiles the run anew
    ask(session, "tune.move", name="law.Kv", value=55.0)
    ask(session, "tune.keep", letter="A")
    ask(session, "tune.move", name="law.Kv", value=60.0)
    ask(session, "tune.undo")
    ask(session, "tune.add", kind="notch", at=200.0)
    ask(session, "tune.switch", place=0, on=False)
    ask(session, "tune.add", kind="notch", at=300.0)
    ask(session, "goal.set", field="max_ms", value="1.75")
    ask(session, "prove.certify")
    assert session.desk.job is not None
    session.desk.job.join(120.0)
    assert session.desk.job.state.state == DONE
    rooms = ("tune", "goal", "prove", "take")
    before = {room: ask(session, f"{room}.show") for room in rooms}
    killed(session)
    again = begin(None)
    after = {room: ask(again, f"{room}.show") for room in rooms}
    for room in rooms:
        assert after[room].pop("work")["lost"] == []
        assert before[room].pop("work")["marks"] == {"prove": "done"}
        before[room].pop("job")
        assert after[room] == before[room]
    assert after["tune"]["undo"] == 4
    # the steps before the restart are undone as ever, and the control that was proven is known as it
    for _ in range(4):
        ask(again, "tune.undo")
    assert again.desk.values == bench.by_hand.values
    assert "earlier control" in " ".join(ask(again, "prove.show")["shown"]["certificate"]["said"])


def test_what_was_interrupted_is_offered_and_goes_on_with_its_own_control(
    bench: Bench, begin: Callable[..., Session]
) -> None:
    session = begin(bench)
    session.desk.start("bring", "the first work", endless, lambda _: None)  # begins by itself: is not offered
    ask(session, "tune.move", name="law.Kv", value=55.0)
    ask(session, "prove.certify")
    ask(session, "tune.move", name="law.Kv", value=56.0)
    (waiting,) = session.desk.queue
    assert waiting.held is not None
    killed(session)
    again = begin(None)
    (offered,) = ask(again, "tune.show")["work"]["broken_off"]
    assert (offered["what"], offered["room"]) == ("prove stability", "prove")
    ask(again, "job.resume", task=offered["number"])
    assert again.desk.job is not None
    again.desk.job.join(120.0)
    assert again.desk.job.state.state == DONE
    held, _ = again.rooms["prove"].shown["certificate"]  # type: ignore[attr-defined]
    assert held.values["law.Kv"] == 55.0
    said = ask(again, "tune.show")
    assert (said["values"]["law.Kv"], said["work"]["broken_off"], said["undo"]) == (56.0, [], 2)


def test_a_part_that_cannot_be_read_is_named_and_all_else_stays(
    bench: Bench, begin: Callable[..., Session], tmp_path: Path
) -> None:
    session = begin(bench)
    ask(session, "tune.move", name="law.Kv", value=55.0)
    killed(session)
    (tmp_path / "own" / FOLDER / "prove.json").write_text("{", encoding="utf-8")
    said = ask(begin(None), "tune.show")
    assert said["values"]["law.Kv"] == 55.0
    assert ["prove.json: cannot be read" in text for text in said["work"]["lost"]] == [True]


def test_a_drag_is_written_once_the_hand_rests(
    bench: Bench, begin: Callable[..., Session], monkeypatch: pytest.MonkeyPatch
) -> None:
    written = list[str]()
    whole = stored.write_whole
    monkeypatch.setattr(stored, "write_whole", lambda path, content: (written.append(path.name), whole(path, content)))
    session = begin(bench)
    for k in range(20):
        ask(session, "tune.move", name="law.Kv", value=50.0 + 0.1 * k, first=k == 0)
    begun = time.monotonic()
    while "desk.json" not in written and time.monotonic() - begun < 20.0:
        time.sleep(0.02)
    time.sleep(0.3)
    assert written.count("desk.json") <= 3


def test_work_is_found_by_its_page_and_offered_to_others(
    bench: Bench, begin: Callable[..., Session], tmp_path: Path
) -> None:
    session = begin(bench)
    ask(session, "tune.move", name="law.Kv", value=55.0)
    killed(session)
    assert kept_folder(tmp_path, "page") == tmp_path / "own"
    assert kept_folder(tmp_path, "") is None
    assert kept_folder(tmp_path, "pag") is None
    (work,) = earlier_work(tmp_path, tmp_path / "other")
    assert (work["page"], work["title"], work["steps"]) == ("page", bench.title, 1)
    assert earlier_work(tmp_path, tmp_path / "own") == []
    (tmp_path / "link").symlink_to(tmp_path / "own")
    (tmp_path / "own" / FOLDER / "page.json").rename(tmp_path / "page.json")
    (tmp_path / "own" / FOLDER / "page.json").symlink_to(tmp_path / "page.json")
    assert kept_folder(tmp_path, "page") is None  # through a link it could be the work of somebody else


def test_two_pages_see_each_other_and_each_drag_is_a_step_of_its_page(
    bench: Bench, begin: Callable[..., Session]
) -> None:
    session = begin(bench)
    one, other = object(), object()
    heard = {one: list[str](), other: list[str]()}
    for page in (one, other):
        session.listen(lambda kind, _, page=page: heard[page].append(kind), page)
    heard[one].clear()
    ask(session, "tune.move", one, name="law.Kv", value=55.0, first=True)
    assert (heard[one], heard[other]) == ([], ["changed"])
    ask(session, "tune.remedy", one)  # changes nothing
    ask(session, "tune.show", other)
    assert (heard[one], heard[other]) == ([], ["changed"])
    # both drag at once: neither is taken for one more step of the other
    ask(session, "tune.move", other, name="law.Kp", value=3e4, first=True)
    ask(session, "tune.move", one, name="law.Kv", value=56.0, first=False)
    history = ask(session, "tune.show", one)["history"]
    assert [row["text"].endswith("another page") for row in history] == [False, True, False, False]
    # Undo takes back the last step, whose ever it is
    assert ask(session, "tune.undo", other)["values"]["law.Kv"] == 55.0
    assert ask(session, "tune.show", one)["work"]["pages"] == 2


def test_a_zoom_is_of_one_page_alone(bench: Bench, begin: Callable[..., Session]) -> None:
    session, one, other = begin(bench), object(), object()
    label = ask(session, "tune.show", one)["charts"]["run"]["label"]
    points = {page: len_of(ask(session, "tune.show", page)) for page in (one, other)}
    ask(session, "view.window", one, shows="tune", label=label, low=0.1, high=0.101)
    assert len_of(ask(session, "tune.show", one)) < points[one]
    assert len_of(ask(session, "tune.show", other)) == points[other]


def len_of(said: dict[str, Any]) -> int:
    return int(said["charts"]["run"]["panels"][0]["curves"][-1]["n"])


def test_five_earlier_works_are_offered_the_latest_first(tmp_path: Path) -> None:
    for k in range(7):
        (tmp_path / f"page_{k}" / FOLDER).mkdir(parents=True)
        state = {"name": f"page {k}", "title": "an axis", "files": 0, "steps": k}
        part = tmp_path / f"page_{k}" / FOLDER / "page.json"
        part.write_text(json.dumps({"state": Code().data(state)}), encoding="utf-8")
        os.utime(part, (1e9 + k, 1e9 + k))
    assert [work["page"] for work in earlier_work(tmp_path, tmp_path / "page_6")] == [
        f"page {k}" for k in (5, 4, 3, 2, 1)
    ]


@pytest.mark.parametrize(
    ("hours", "letters", "known"), [(8.0, 40, True), (17.0, 40, False), (-1.0, 40, False), (8.0, 24, False)]
)
def test_the_door_of_the_last_server_is_known_for_twelve_hours(
    hours: float, letters: int, known: bool, tmp_path: Path
) -> None:
    path = tmp_path / ".door.json"
    kept = {"port": 8765, "secret": "x" * letters, "since": time.time() - 3600.0 * hours}
    path.write_text(json.dumps(kept), encoding="utf-8")
    path.chmod(0o600)
    assert (command.last_door(path) is not None) is known
    if os.name == "posix":
        path.chmod(0o640)
        assert command.last_door(path) is None  # others could have read it


def test_a_server_of_the_same_folder_takes_the_same_door_unless_another_one_holds_it(tmp_path: Path) -> None:
    request = command.StudioRequest(folder=tmp_path)
    first, secret = command.same_door(request)
    port = first.getsockname()[1]
    if os.name == "posix":
        assert (tmp_path / ".door.json").stat().st_mode & 0o777 == 0o600
    with first:
        beside, other = command.same_door(request)
        with beside:
            assert beside.getsockname()[1] != port
            assert other == ""  # a cookie of its own
    again, same_secret = command.same_door(request)
    with again:
        assert (again.getsockname()[1], same_secret) == (port, secret)

"""What the page and its server allow: each limit with a case on either side of it."""

from __future__ import annotations

import asyncio
import json
import os
import struct
import threading
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace as Stand
from typing import Any

import numpy as np
import pytest

from feeddrive.language.errors import FileError, ParameterError
from feeddrive.machining.circle_test import CirclePath, circle_test
from feeddrive.plot.chart import Chart, Curve, Panel
from feeddrive.studio import jobs, live, protection, server, uploads, works
from feeddrive.studio.desk import Asked, Desk
from feeddrive.studio.live import Followable, Following
from feeddrive.studio.pictures import HeldPoles
from feeddrive.studio.protection import read_password
from feeddrive.studio.rooms import tune
from feeddrive.studio.rooms.goal import Goal
from feeddrive.studio.rooms.scope import Scope
from feeddrive.studio.rooms.tune import Tune
from feeddrive.studio.server import Session, Sessions, message

WORD = b"a long password"


def read(answer: bytes) -> tuple[dict[str, Any], np.ndarray]:
    (length,) = struct.unpack_from("<I", answer)
    return json.loads(answer[4 : 4 + length]), np.frombuffer(answer[4 + length :], "<f4")


def test_two_hundred_steps_can_be_undone() -> None:
    for steps, oldest in ((150, 0), (250, 50)):
        counted = iter(range(steps))
        desk = Stand(undo=[], redo=[], held=lambda counted=counted: next(counted))
        for _ in range(steps):
            Desk._remember(desk)  # type: ignore[arg-type]
        assert (desk.undo[0], desk.undo[-1]) == (oldest, steps - 1)


def test_canceled_work_may_end_by_itself_for_more_than_a_second() -> None:
    """A search that ends by itself leaves its best result, one that is killed leaves none."""
    killed = list[float]()
    for needs in (1.0, 2.0):
        job = Stand(_pipe=None, patience=0.0, _over=Stand(wait=lambda seconds, needs=needs: seconds >= needs))
        job.kill = lambda needs=needs: killed.append(needs)
        jobs.Job._end(job)  # type: ignore[arg-type]
    assert killed == [2.0]


def test_a_source_outlives_a_reload_of_the_page_and_not_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """A clock that moves on by a second with each look; the page is open at the first one only."""
    seconds, fed = [0.0], list[float]()

    def clock() -> float:
        seconds[0] += 1.0
        return seconds[0]

    monkeypatch.setattr(live, "time", Stand(monotonic=clock))
    scope = Stand(feed=lambda _: fed.append(seconds[0]) or 0)
    following = Stand(
        _stop=Stand(wait=lambda _: seconds[0] > 100.0, set=lambda: None),
        _watched=lambda: seconds[0] < 3.5,
        lock=threading.Lock(),
        scope=scope,
        source=Stand(close=lambda: None, over=False),
        failed="",
    )
    Following._follow(following)  # type: ignore[arg-type]
    assert following.failed == "stopped, since no page was open"
    assert 8.0 < fed[-1] - 3.0 < 15.0


def test_the_newest_fifty_files_are_offered(tmp_path: Path) -> None:
    def offered(count: int) -> set[str]:
        for i in range(count):
            path = tmp_path / f"{i}.csv"
            path.touch()
            os.utime(path, (1e9 + i, 1e9 + i))
        return {Path(name).stem for name in Followable((), tmp_path).offered()}

    assert len(offered(40)) == 40
    assert offered(60) == {str(i) for i in range(10, 60)}


def test_a_pole_moves_by_two_percent_of_its_distance_from_0_with_a_key() -> None:
    poles = Stand(at=lambda _: -30.0 + 40.0j, moved=lambda _, pole: pole)
    assert HeldPoles.stepped(poles, "loop.0", -2.0, 1.0) == pytest.approx(-32.0 + 41.0j)  # type: ignore[arg-type]


def test_a_hundred_steps_of_a_key_are_taken_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tune.filters, "filter_stepped", lambda *_: {})
    room = Stand(
        _now=Stand(leading=Stand(margins=None)),
        _sample_time=1e-3,
        _poles=Stand(stepped=lambda *_: {}),
        _pictures=lambda: "pictures",
        _moved=lambda *_: "pictures",
        desk=Stand(control=None, values={}, off=(), change=lambda *_, **__: None),
    )
    for act in (Tune.step, Tune.pole_step):
        assert act(room, Asked({"name": "x", "across": 80.0, "up": -80.0})) == "pictures"  # type: ignore[arg-type]
        with pytest.raises(ParameterError, match="at most 100 steps at once"):
            act(room, Asked({"name": "x", "across": 0.0, "up": -120.0}))  # type: ignore[arg-type]


def test_the_whole_loop_is_made_faster_or_slower_by_a_decade(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tune, "speed_powers", lambda _: {"law.Kv": 1.0})
    look = Stand(look=Stand(leading=Stand(margins=Stand(crossover=50.0))))
    desk = Stand(needed=Stand(before=Stand(values={})), control=None)
    slider = Tune._faster(Stand(desk=desk, _look=lambda *_: look))  # type: ignore[arg-type]
    assert (slider["low"], slider["high"]) == pytest.approx((5.0, 500.0))


@pytest.mark.parametrize(("more", "taken"), [(9_000, True), (12_000, False)])
def test_a_file_of_a_password_has_ten_thousand_bytes(more: int, taken: bool, tmp_path: Path) -> None:
    path = tmp_path / "password"
    path.write_bytes(WORD + b"\n" + b"x" * more)
    path.chmod(0o600)
    if taken:
        assert read_password(path) == WORD.decode()
    else:
        with pytest.raises(FileError, match="password"):
            read_password(path)


@pytest.mark.skipif(os.name != "posix", reason="permissions of POSIX")
@pytest.mark.parametrize(("mode", "taken"), [(0o600, True), (0o700, True), (0o640, False), (0o601, False)])
def test_a_file_of_a_password_is_of_its_owner_alone(mode: int, taken: bool, tmp_path: Path) -> None:
    path = tmp_path / "password"
    path.write_bytes(WORD)
    path.chmod(mode)
    if taken:
        assert read_password(path) == WORD.decode()
    else:
        with pytest.raises(ParameterError, match="other users"):
            read_password(path)


def test_the_longest_password_is_heard_with_every_byte_written_as_three() -> None:
    def heard(body: bytes) -> bytes:
        async def receive() -> dict[str, Any]:
            return {"type": "http.request", "body": body}

        return asyncio.run(protection._body(receive))  # type: ignore[arg-type]

    longest = b"password=" + 300 * b"%26"
    assert heard(longest) == longest
    assert heard(longest + 300 * b"%26") == b""


@pytest.mark.parametrize(("limit", "high"), [(15.0, 18.0), (30.0, 3.0)])
def test_a_picture_reaches_up_to_a_limit_less_than_20_dB_above_its_curves(limit: float, high: float) -> None:
    room = Stand(_peak_limit=lambda: limit)
    chart = Chart("frequency (Hz)", (Panel("|S| (dB)", (Curve(np.array([1.0, 10.0]), np.array([-20.0, 0.0])),)),))
    assert Goal._up_to_limit(room, chart).panels[0].high == high  # type: ignore[arg-type]


def test_a_log_begins_with_four_channels_and_shows_eight_at_once() -> None:
    names = [f"c{i}" for i in range(12)]
    room = Stand(scope=Stand(channels=dict.fromkeys(names, "")), drawn={}, _units=lambda: dict.fromkeys(names, ""))
    room._drawn = lambda: Scope._drawn(room)  # type: ignore[arg-type]
    assert room._drawn() == names[:4]
    for count, reason in ((7, "'no unit' is no unit"), (8, "8 channels are shown at most")):
        room.drawn = dict.fromkeys(names[:count], True)
        with pytest.raises(ParameterError, match=reason):
            Scope.channel(room, Asked({"name": "c9", "shown": True, "stated": "no unit"}))  # type: ignore[arg-type]


def test_a_curve_has_as_many_points_as_a_wide_picture_and_keeps_its_peaks() -> None:
    """900 spikes: each is one of the two points of its interval."""
    y = np.zeros(90_000)
    y[50::100] = 1.0
    chart = Chart("time (s)", (Panel("y", (Curve(np.arange(y.size, dtype=float), y),)),))
    said, numbers = read(message({"number": 1}, {"x": chart}))
    (curve,) = said["charts"]["x"]["panels"][0]["curves"]
    assert curve["n"] < 2_500
    assert np.count_nonzero(numbers[curve["at"] + curve["n"] :][: curve["n"]] == 1.0) == 900


@pytest.mark.parametrize(("others", "held"), [(40, True), (60, False)])
def test_a_page_looks_at_fifty_parts(others: int, held: bool, tmp_path: Path) -> None:
    """Labels come from the page: without an end they would fill the memory."""
    session = Session(tmp_path)
    for i in range(others + 1):
        session._view("window", Asked({"shows": "tune", "label": f"part {i}", "low": 0.0, "high": 1.0}))
    assert (("tune", "part 0") in session._windows) is held


def test_sixty_four_pages_are_open_at_once() -> None:
    sessions = Sessions(lambda: Stand(heard=True))  # type: ignore[arg-type,return-value]
    for i in range(60):
        sessions.named(f"page {i}")
    with pytest.raises(ParameterError, match="64 pages are open"):
        [sessions.named(f"page {i}") for i in range(60, 70)]


def test_a_name_of_a_page_counts_up_to_its_64th_character() -> None:
    sessions = Sessions(lambda: Stand(heard=True))  # type: ignore[arg-type,return-value]
    assert sessions.named("x" * 50 + "a") is not sessions.named("x" * 50 + "b")
    assert sessions.named("x" * 80 + "a") is sessions.named("x" * 80 + "b")


def test_a_request_has_64_000_characters() -> None:
    for length, heard in ((60_000, True), (70_000, False)):
        text = json.dumps({"do": "tune.show", "more": "x" * length})
        assert (server._asked({"type": "websocket.receive", "text": text}) is not None) is heard


def test_a_log_that_is_brought_shows_forty_columns_with_their_peaks(tmp_path: Path) -> None:
    """180 spikes in a column: each is one of the two points of its interval."""
    rows = 9_000
    spikes = np.zeros(rows)
    spikes[25::50] = 1.0
    columns = {count: previews(tmp_path, count, spikes) for count in (36, 50)}
    assert {count: len(found) for count, found in columns.items()} == {36: 36, 50: 40}
    x, y = columns[36]["c0"]
    assert x.size < 500
    assert np.count_nonzero(y == 1.0) == 180


def previews(folder: Path, count: int, values: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    channels = {f"c{i}": values for i in range(count)}
    log = Stand(channels=channels, time=1e-3 * np.arange(values.size), units={})
    mapping = Stand(get=lambda _: None, sample_time=1e-3, values=lambda: ())
    file = Stand(columns=Stand(left_out={}, values={}))
    guess = Stand(mapping=mapping, axes=(), needs={})
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(import_module("feeddrive.workflow.channels"), "whole_log", lambda *_: log)
        patched.setattr(import_module("feeddrive.studio.log_check"), "checked", lambda *_: None)
        return dict(uploads._log(folder / "run.csv", file, guess).columns)  # type: ignore[arg-type]


def test_a_file_of_256_MB_is_brought(tmp_path: Path) -> None:
    assert uploads.place_of("run.csv", tmp_path, 250_000_000) == tmp_path / "run.csv"
    with pytest.raises(FileError, match="larger than 256 MB"):
        uploads.place_of("run.csv", tmp_path, 260_000_000)


def test_sixty_four_files_are_brought_to_a_page(tmp_path: Path) -> None:
    for i in range(70):
        if i == 60:
            uploads.place_of("more.csv", tmp_path)
        (tmp_path / f"{i}.csv").touch()
    with pytest.raises(FileError, match="64 files were brought already"):
        uploads.place_of("more.csv", tmp_path)


def test_a_name_of_a_file_leaves_room_for_that_of_its_temporary_file() -> None:
    """File systems take 255 bytes; a letter beyond ASCII has two."""
    assert uploads.safe_name("ä" * 97 + ".csv")
    with pytest.raises(FileError, match="200 bytes at most"):
        uploads.safe_name("ä" * 110 + ".csv")


def circle(peaks_deg: float) -> CirclePath:
    """A circle with a spike behind each reversal."""
    angle = 2.0 * np.pi * (np.arange(360) + 0.5) / 360
    since = angle % (0.5 * np.pi)
    spike = 7e-6 * np.maximum(0.0, 1.0 - np.abs(since - np.radians(peaks_deg)) / np.radians(1.0))
    r = 0.05 + spike
    return CirclePath(r * np.cos(angle), r * np.sin(angle), 1, 0.02, 0.05, center=(0.0, 0.0))


def test_the_largest_peaks_of_circles_are_offered_each_with_its_reversal_and_no_other() -> None:
    def views(count: int) -> list[dict[str, Any]]:
        test = circle_test([circle(8.5)] * count, about="set-up")
        return works.circle_shown(works.Shown({}, result=test), None).words["peaks"]  # type: ignore[no-any-return]

    assert len(views(1)) == 4
    assert len(views(3)) == 8  # of twelve
    inner = [row["view"] for row in views(1) if row["view"][0] > 0.0]
    for low, high in inner:
        (reversal,) = [at for at in (90.0, 180.0, 270.0) if low < at < high]
        assert low < reversal - 2.0
        assert high - low < 45.0
    assert inner

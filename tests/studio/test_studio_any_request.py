"""Whatever a page sends, it gets an answer in plain words: never a fault, and never the end of the conversation."""

from __future__ import annotations

import inspect
import json
import random
import re
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest

from feeddrive.studio.bench import bench_of
from feeddrive.studio.desk import Room
from feeddrive.studio.server import Session

_ODD = (
    None,
    "",
    "x",
    "-1",
    "0",
    "0.5",
    0,
    1,
    -1,
    2.5,
    1e308,
    -1e308,
    1e-320,
    10**400,
    float("nan"),
    float("inf"),
    True,
    False,
    [],
    ["x"],
    [1],
    {},
    {"a": 1},
    "nan",
    "1e999",
    "1" * 5000,
    "\0",
    "\ud800",
    "../x",
    "ball_screw",
    "law.Kp",
    "notch",
    "sensitivity",
    "max_ms",
    "A",
    "auto",
)
_LONG = (
    "tune",
    "start",
    "certify",
    "circle",
    "program",
    "correct",
    "export",
    "tour",
)  # begin long work: asked less often
_MANY = 1500


def acts(session: Session) -> dict[str, list[str]]:
    """Every act of every room, with the names of what it is given."""
    found = dict[str, list[str]]()
    for name, room in session.rooms.items():
        text = inspect.getsource(type(room))
        given = re.findall(r"""asked\.\w+\(["'](\w+)["']""", text)
        for act in re.findall(r"@act\n    def (\w+)", text):
            found[f"{name}.{act}"] = sorted(set(given))
    return {**found, "view.window": ["label", "low", "high", "shows"], "job.end": [], "nothing.show": [], "tune": []}


@pytest.fixture(params=["linear_motor", None])
def session(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Session]:
    made = Session(tmp_path, None if request.param is None else bench_of(request.param))
    yield made
    made.close()


def test_no_request_is_a_fault(session: Session) -> None:
    chance, known = random.Random(20), acts(session)
    assert len(known) > 50
    assert all(isinstance(each, Room) for each in session.rooms.values())
    for _ in range(_MANY):
        do = chance.choice(sorted(known))
        if do.partition(".")[2] in _LONG and chance.random() < 0.9:
            continue
        names = chance.sample(known[do], chance.randint(0, min(4, len(known[do]))))
        given = {name: chance.choice(_ODD) for name in names}
        answer = session.answer({"number": 7, "do": do, **given})
        (length,) = struct.unpack_from("<I", answer)
        said = json.loads(answer[4 : 4 + length])
        assert said["number"] == 7
        assert "a fault in" not in str(said.get("error")), f"{do} {given!r:.300}: {said['error']}"
        if session.desk.job is not None:
            session.desk.job.kill()
            session.desk.job.join(20.0)

"""Files that a page works on: each is the one that it is called, also if others came after it or share its name."""

from __future__ import annotations

import asyncio
import json
import math
import struct
import time
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.files.frf import read_frfs, write_frf
from feeddrive.files.machine import BUNDLED
from feeddrive.files.read_log import read_log
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.loop.frequency_response import FRF
from feeddrive.studio.bench import bench_of, bench_of_responses
from feeddrive.studio.live import Followable
from feeddrive.studio.rooms.compare import Compare
from feeddrive.studio.server import Session
from feeddrive.studio.uploads import keep
from feeddrive.studio.works import Shown
from feeddrive.tuning.by_hand import ByHand
from feeddrive.tuning.operating_point import modelled_point
from feeddrive.workflow.compare import CompareRequest

_TITLE = fd.read_machine("ball_screw").name


def loaded(path: Path, mass: float) -> Path:
    """The bundled machine with another load, kg, under the same title."""
    text = (BUNDLED / "machines" / "ball_screw.toml").read_text(encoding="utf-8")
    assert text.count("mass_load_kg = 33\n") == 1
    path.parent.mkdir(exist_ok=True)
    path.write_text(text.replace("mass_load_kg = 33\n", f"mass_load_kg = {mass}\n"), encoding="utf-8")
    return path


def test_machines_at_other_places_are_points_of_their_own_also_under_one_title(tmp_path: Path) -> None:
    others = [loaded(tmp_path / each / "other.toml", 99.0) for each in ("one", "two")]
    bench = bench_of("ball_screw", at=[*others, loaded(tmp_path / "heavy.toml", 60.0)])
    points = bench.by_hand.points
    names = [each.name for each in points]
    assert names == [_TITLE, f"{_TITLE} (other)", f"{_TITLE} (other, 2)", f"{_TITLE} (heavy)"]
    masses = [each.loop.axis.plant.mass_load for each in points if each.loop is not None]  # type: ignore[union-attr]
    assert masses == [33.0, 99.0, 99.0, 60.0]
    drawn = [bench.overlays(each)[-1].drawn for each in names]
    found = [float(np.interp(20.0, each.frequency, np.abs(each.response))) for each in drawn if each is not None]
    assert found[1] == found[2]
    assert found[0] > 1.1 * found[3] > 1.1 * 1.1 * found[1]  # 163, 190 and 229 kg on the screw


def test_responses_at_other_places_are_points_of_their_own_also_under_one_file_name(tmp_path: Path) -> None:
    f = np.geomspace(1.0, 500.0, 200)
    paths = list[Path]()
    for name, mass in (("left", 100.0), ("right", 150.0)):
        (tmp_path / name).mkdir()
        paths.append(tmp_path / name / "frf.csv")
        write_frf(paths[-1], FRF(f, 1.0 / (mass * (2j * np.pi * f) ** 2), "force", "load", "m/N", 1e-3))
    bench = bench_of_responses(paths[0], at=paths[1:])
    assert [each.name for each in bench.by_hand.points] == ["frf", "frf (right)"]
    first, last = (bench.overlays(each.name)[-1].measured for each in bench.by_hand.points)
    assert first is not None
    assert last is not None
    np.testing.assert_allclose(np.abs(first.response / last.response), 1.5, rtol=1e-9)


def test_two_points_of_one_name_are_refused() -> None:
    loop = fd.read_machine("ball_screw").loop(None)
    point = modelled_point(loop, "here")
    with pytest.raises(ParameterError, match="names of their own, not here, here"):
        ByHand(loop.control, [point, replace(point, loop=None)])


def asked(session: Session, do: str, **more: Any) -> dict[str, Any]:
    """An act, and the end of the work that it began; what its room says then."""
    answer = session.answer({"number": 1, "do": do, **more})
    said = json.loads(answer[4 : 4 + struct.unpack_from("<I", answer)[0]])
    assert "error" not in said, said["error"]
    if session.desk.job is not None and session.desk.job.state.going:
        session.desk.job.join(120.0)
        assert session.desk.job.state.error == ""
        return asked(session, f"{do.partition('.')[0]}.show")
    return said


def brought(session: Session, name: str, content: bytes) -> dict[str, Any]:
    """A file as the page sends it, through the server's route, and the end of its reading."""

    async def pieces() -> AsyncIterator[bytes]:
        yield content

    session.desk.files[name] = asyncio.run(keep(name, pieces(), session.desk.folder / "brought"))
    return asked(session, "import.look", names=[name])


def pushed(mass: float) -> bytes:
    """A log of a free mass, kg, under a force that is noise: position and force at 1 kHz."""
    force = np.random.default_rng(3).standard_normal(8000) * 100.0
    before = np.concatenate([[0.0], force[:-1]]) / mass * 1e-3  # held over a sample
    velocity = np.cumsum(before)
    position = 1e-3 * np.cumsum(velocity - 0.5 * before)
    rows = (f"{1e-3 * k:.4f},{x:.12g},{f:.12g}" for k, (x, f) in enumerate(zip(1e3 * position, force, strict=True)))
    return "\n".join(["t_s,position_mm,force_N", *rows, ""]).encode()


def test_a_file_that_is_brought_again_is_read_anew_and_what_works_on_the_first_one_has_it_still(tmp_path: Path) -> None:
    session = Session(tmp_path)
    first, second = (loaded(tmp_path / "elsewhere" / each, 50.0 + i).read_bytes() for i, each in enumerate("ab"))
    brought(session, "mine.toml", first)
    asked(session, "import.axis", name="mine.toml", axis="x")
    brought(session, "mine.toml", second)
    assert fd.read_machine(session.desk.machine_path()).loop("x").axis.plant.mass_load == 50.0  # type: ignore[union-attr]
    said = asked(session, "import.axis", name="mine.toml", axis="x")
    assert [each["name"] for each in said["files"]] == ["mine.toml"]
    assert fd.read_machine(session.desk.machine_path()).loop("x").axis.plant.mass_load == 51.0  # type: ignore[union-attr]


def test_a_file_named_at_the_start_is_read_as_it_is_dropped_on_the_page_and_forgotten(tmp_path: Path) -> None:
    (tmp_path / "own").mkdir()
    start = loaded(tmp_path / "mine.toml", 50.0)
    session = Session(tmp_path / "own", brought=(start,))
    asked(session, "import.show")
    brought(session, "mine.toml", loaded(tmp_path / "elsewhere" / "mine.toml", 51.0).read_bytes())
    asked(session, "import.axis", name="mine.toml", axis="x")
    assert session.desk.needed.needed_loop().axis.plant.mass_load == 51.0  # type: ignore[union-attr]
    asked(session, "import.drop", name="mine.toml")
    answer = session.answer({"number": 1, "do": "import.look", "names": ["mine.toml"]})
    assert b"no file 'mine.toml' was brought" in answer
    assert "50" in start.read_text(encoding="utf-8")


def test_responses_that_are_estimated_stand_beside_each_other(tmp_path: Path) -> None:
    session = Session(tmp_path)
    for name, mass in (("left.csv", 100.0), ("right.csv", 150.0), ("left.csv", 120.0)):
        brought(session, name, pushed(mass))
        said = asked(session, "import.estimate", name=name)
    names = ["left.csv", "frf_left.csv", "right.csv", "frf_right.csv", "frf_left_2.csv"]
    assert [each["name"] for each in said["files"]] == names
    found = [next(iter(read_frfs(session.desk.files[each]).values())) for each in names if "frf" in each]
    at = [float(abs(each.response[np.searchsorted(each.frequency, 50.0)])) for each in found]
    np.testing.assert_allclose(at[0] / np.array(at), [1.0, 1.5, 1.2], rtol=1e-6)


def test_a_law_that_is_taken_twice_leaves_the_one_before_to_an_undo(tmp_path: Path) -> None:
    """The file that is proven and exported has the numbers of the page after an undo too."""
    session = Session(tmp_path, bench_of("linear_motor"))
    room = session.rooms["compare"]
    assert isinstance(room, Compare)
    request = CompareRequest("linear_motor", axis=session.desk.needed.axis)
    start = session.desk.control
    for share in (1.1, 1.3):
        name = next(each for each in session.desk.values if each.endswith("Kp"))
        control = tree.vary(start, {name: share * session.desk.needed.before.values[name]})
        room.shown, machine = Shown({}, controls={"P-PI": control}), session.desk.machine()
        room._asked, room._machine = request, machine  # type: ignore[attr-defined]
        session.desk.did("compare", request)
        asked(session, "compare.take", law="P-PI")
    asked(session, "tune.undo")
    assert session.desk.values[name] == pytest.approx(1.1 * session.desk.needed.before.values[name])
    written = fd.read_machine(session.desk.machine_path()).loop(session.desk.needed.axis).control
    assert dict(tree.leaves(written))[name] == session.desk.values[name]


def test_a_window_that_is_kept_replaces_no_file_that_was_brought(tmp_path: Path) -> None:
    (tmp_path / "page").mkdir()
    rows = "".join(f"{1e-3 * k:.3f},{math.sin(0.02 * k):.6f}\n" for k in range(500))
    (tmp_path / "run.csv").write_text(f"t_s,x_mm\n{rows}", encoding="utf-8")
    session = Session(tmp_path / "page", live=Followable((tmp_path / "run.csv",)))
    for name in ("scope_1.parquet", "scope_2.parquet"):
        brought(session, name, b"of a person")
    asked(session, "import.drop", name="scope_2.parquet")
    asked(session, "scope.follow", name=str(tmp_path / "run.csv"))
    end = time.monotonic() + 20.0
    while "span" not in asked(session, "scope.frame"):
        assert time.monotonic() < end
        time.sleep(0.02)
    kept = asked(session, "scope.save", between=False)["import"]
    session.close()
    assert kept == "scope_3.parquet"
    assert read_log(session.desk.files[kept]).units["x_mm"] == "mm"
    assert (tmp_path / "page" / "brought" / "scope_1.parquet").read_bytes() == b"of a person"
    said = asked(session, "import.look", names=[kept])
    assert [(each["name"], each["kind"]) for each in said["files"]][-1] == (kept, "log")

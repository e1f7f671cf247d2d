"""The room Scope without a browser: what may be followed, what each page sees, and the log that is kept."""

from __future__ import annotations

import json
import math
import os
import struct
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest

from bus_bench import in_a_namespace
from falling_drive import BESIDE, FEEDDRIVE, HANGING
from feeddrive.analysis.oscilloscope import Oscilloscope, Rows
from feeddrive.files.growing import Pipe
from feeddrive.files.read_log import read_log
from feeddrive.studio import live
from feeddrive.studio.live import Followable
from feeddrive.studio.server import Session


def ask(session: Session, do: str, **more: Any) -> dict[str, Any]:
    answer = session.answer({"number": 1, "do": do, **more})
    (length,) = struct.unpack_from("<I", answer)
    said = json.loads(answer[4 : 4 + length])
    said["numbers"] = np.frombuffer(answer[4 + length :], "<f4")
    said["bytes"] = len(answer)
    return said


def until(session: Session, good: Callable[[dict[str, Any]], bool], seconds: float = 10.0) -> dict[str, Any]:
    """The first picture that is good."""
    end = time.monotonic() + seconds
    while True:
        said = ask(session, "scope.frame")
        if good(said):
            return said
        assert time.monotonic() < end, {key: each for key, each in said.items() if key != "numbers"}
        time.sleep(0.02)


def write(path: Path, first: int, last: int, head: str = "t_s,x_mm,force_N,note\n") -> None:
    """Rows of sin(20 t) mm and a triangle of 100 N, at 1 kHz."""
    with path.open("a", encoding="utf-8") as file:
        if first == 0:
            file.write(head)
        for k in range(first, last):
            t = k * 1e-3
            file.write(f"{t:.4f},{math.sin(20 * t):.6f},{100 * abs(2 * (t % 1) - 1):.4f},{k % 3}\n")


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    (tmp_path / "page").mkdir()
    write(tmp_path / "run.csv", 0, 500)
    made = Session(tmp_path / "page", live=Followable((tmp_path / "run.csv",), tmp_path))
    leave = made.listen(lambda _, __: None)
    yield made
    leave()
    made.close()


def followed(session: Session, tmp_path: Path, name: str = "run.csv") -> dict[str, Any]:
    ask(session, "scope.follow", name=str(tmp_path / name))
    until(session, lambda said: bool(said["charts"]))
    return ask(session, "scope.show")


def curve(said: dict[str, Any], name: str) -> tuple[np.ndarray, np.ndarray]:
    found = [each for panel in said["charts"]["scope"]["panels"] for each in panel["curves"] if each["name"] == name]
    at, n = found[0]["at"], found[0]["n"]
    return said["numbers"][at : at + n], said["numbers"][at + n : at + 2 * n]


def test_a_file_is_followed_while_it_grows(session: Session, tmp_path: Path) -> None:
    said = followed(session, tmp_path)
    assert [(each["name"], each["unit"], each["shown"]) for each in said["channels"]] == [
        ("x_mm", "mm", True),
        ("force_N", "N", True),
        ("note", "", True),
    ]
    assert said["look"].startswith("free running")
    write(tmp_path / "run.csv", 500, 1600)
    said = until(session, lambda said: abs(curve(said, "force_N")[1][-1] - 100 * abs(2 * 0.599 - 1)) < 1e-3)
    x, y = curve(said, "x_mm")
    np.testing.assert_allclose(y, np.sin(20.0 * (1.599 + x)), atol=1e-5)  # x ends at 0, float32
    assert (x[0], x[-1]) == pytest.approx((-1.0, 0.0), abs=1e-6)
    assert all(each["n"] <= 1000 for panel in said["charts"]["scope"]["panels"] for each in panel["curves"])


def test_trigger_cursors_units_and_the_log_that_is_kept(session: Session, tmp_path: Path) -> None:
    followed(session, tmp_path)
    ask(session, "scope.channel", name="x_mm", shown=True, unit="um")
    said = ask(session, "scope.look", mode="normal", channel="x_mm")
    (level,) = [each for each in said["fields"] if each["name"] == "level"]
    assert level["unit"] == "µm"
    assert float(level["value"]) == pytest.approx(0.0, abs=1000.0)  # somewhere on the curve
    ask(session, "scope.set", field="level", value="500")  # um; the file has mm
    ask(session, "scope.set", field="window", value="0.2")
    ask(session, "scope.set", field="before", value="0.5")
    write(tmp_path / "run.csv", 500, 1500)
    said = until(session, lambda said: said["look"].startswith("triggered"))
    x, y = curve(said, "x_mm")
    np.testing.assert_allclose(y, 1e3 * np.sin(20.0 * x + np.arcsin(0.5)), atol=0.2)  # the instant: to 5e-6 s
    assert float(np.interp(0.0, x, y)) == pytest.approx(500.0, abs=0.1)
    ask(session, "scope.move", name="1", x=-0.05)
    said = ask(session, "scope.move", name="2", x=0.075)
    assert said["cursors"] == [-0.05, 0.075]
    time_, first, *_ = said["readout"]
    assert time_[0] == "time (s)"
    assert time_[3] == "0.125; 1/Δt 8 Hz"
    assert first[0] == "x_mm (µm)"
    at = [1e3 * math.sin(20.0 * t + math.asin(0.5)) for t in (-0.05, 0.075)]
    assert [float(each) for each in first[1:]] == pytest.approx([*at, at[1] - at[0]], abs=0.2)
    said = ask(session, "scope.save", between=True)
    assert "error" not in said
    log = read_log(session.desk.folder / "brought" / said["import"])
    assert (log.time[0], log.time[-1]) == pytest.approx((-0.05, 0.075), abs=1e-3)
    assert log.sample_time == 1e-3
    assert dict(log.units) == {"x_mm": "mm", "force_N": "N", "note": ""}
    np.testing.assert_allclose(log["x_mm"], np.sin(20.0 * log.time + np.arcsin(0.5)), atol=2e-4)
    ask(session, "import.look", names=[said["import"]])
    session.desk.job.join(60.0)  # type: ignore[union-attr]
    (brought,) = ask(session, "import.show")["files"]
    assert (brought["name"], brought["kind"], brought["wrong"]) == (said["import"], "log", "")


def test_single_stands_until_it_is_armed_and_a_pause_lets_recording_go_on(session: Session, tmp_path: Path) -> None:
    followed(session, tmp_path)
    ask(session, "scope.set", field="window", value="0.1")
    ask(session, "scope.look", mode="single", channel="x_mm")
    ask(session, "scope.set", field="level", value="0.5")
    write(tmp_path / "run.csv", 500, 1000)
    said = until(session, lambda said: said["look"].startswith("triggered"))
    assert said["look"].endswith("window 1; press Arm for another one")
    write(tmp_path / "run.csv", 1000, 1500)
    time.sleep(0.2)
    assert ask(session, "scope.frame")["look"] == said["look"]
    assert ask(session, "scope.arm")["look"] == "waits for the trigger; what is shown is the one before"
    write(tmp_path / "run.csv", 1500, 2000)
    again = until(session, lambda now: now["look"].startswith("triggered"))
    assert again["look"] != said["look"]
    assert again["look"].endswith("window 1; press Arm for another one")
    ask(session, "scope.look", mode="auto", channel="")
    held = ask(session, "scope.hold", on=True)
    write(tmp_path / "run.csv", 2000, 2600)
    time.sleep(0.2)
    still = ask(session, "scope.frame")
    assert still["look"].startswith("held")
    np.testing.assert_array_equal(curve(still, "force_N")[1], curve(held, "force_N")[1])
    ask(session, "scope.hold", on=False)
    _, y = curve(until(session, lambda now: not now["held"]), "force_N")
    assert y[-1] == pytest.approx(100 * abs(2 * (2.599 % 1) - 1), abs=1e-3)


@pytest.mark.parametrize(
    ("asked", "reason"),
    [
        ({"do": "scope.follow", "name": "/etc/passwd"}, "may not be followed. Others: name files or drives to follow"),
        ({"do": "scope.follow", "name": "../secret.csv"}, "may not be followed"),
        ({"do": "scope.follow", "name": ""}, "may not be followed"),
        ({"do": "scope.follow", "name": "drive.toml"}, "may not be followed"),
        ({"do": "scope.set", "field": "window", "value": "0"}, "must be >= 0.0001 s"),
        ({"do": "scope.set", "field": "window", "value": "long"}, "window: 'long' is no number"),
        ({"do": "scope.set", "field": "out", "value": "x"}, "field must be one of"),
        ({"do": "scope.look", "mode": "normal", "channel": "y"}, "there is no channel 'y'"),
        ({"do": "scope.channel", "name": "note", "shown": True, "stated": "parsec"}, "'parsec' is no unit"),
        ({"do": "scope.channel", "name": "x_mm", "shown": True, "unit": "N"}, "cannot be shown in 'N'"),
        ({"do": "scope.move", "name": "1", "x": math.nan}, "x must be a finite number"),
        ({"do": "scope.save", "between": True}, "set both cursors first"),
    ],
)
def test_what_cannot_be_is_said_and_changes_nothing(
    session: Session, tmp_path: Path, asked: dict[str, Any], reason: str
) -> None:
    before = followed(session, tmp_path)
    assert reason in ask(session, **asked)["error"]
    after = ask(session, "scope.show")
    assert [after[key] for key in ("chosen", "fields", "trigger", "channels")] == [
        before[key] for key in ("chosen", "fields", "trigger", "channels")
    ]


def test_only_tables_that_stand_in_the_folder_are_offered(tmp_path: Path) -> None:
    """No folder below it, as those of other pages are; no link, no hidden file, nothing of another kind."""
    folder = tmp_path / "folder"
    (folder / "other page").mkdir(parents=True)
    for name in ("run.csv", ".hidden.csv", "machine.toml", "a.sh", "other page/secret.csv"):
        (folder / name).write_text("t_s,x\n0,1\n1,2\n2,3\n", encoding="utf-8")
    (tmp_path / "outside.csv").write_text("t_s,x\n0,1\n1,2\n2,3\n", encoding="utf-8")
    (folder / "link.csv").symlink_to(tmp_path / "outside.csv")
    followable = Followable((), folder)
    assert [*followable.offered()] == [str(folder / "run.csv")]
    made = Session(folder / "other page", live=followable)
    leave = made.listen(lambda _, __: None)
    try:
        ask(made, "scope.follow", name=str(folder / "run.csv"))
        until(made, lambda said: bool(said["charts"]))
        (folder / "run.csv").unlink()
        (folder / "run.csv").symlink_to(tmp_path / "outside.csv")  # after it was chosen
        said = until(made, lambda said: said["failed"])
        assert "leads out of" in said["state"]
    finally:
        leave()
        made.close()


def test_two_pages_follow_one_file_each_by_itself(session: Session, tmp_path: Path) -> None:
    (tmp_path / "second").mkdir()
    other = Session(tmp_path / "second", live=session.desk.live)
    leave = other.listen(lambda _, __: None)
    try:
        followed(session, tmp_path)
        followed(other, tmp_path)
        ask(other, "scope.look", mode="normal", channel="force_N")
        ask(other, "scope.hold", on=True)
        said = ask(session, "scope.show")
        assert (said["mode"], said["trigger"], said["held"]) == ("auto", "", False)
    finally:
        leave()
        other.close()


def test_a_source_is_let_go_when_no_page_is_open(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "_DESERTED", 0.2)
    (tmp_path / "page").mkdir()
    write(tmp_path / "run.csv", 0, 500)
    made = Session(tmp_path / "page", live=Followable((tmp_path / "run.csv",)))
    leave = made.listen(lambda _, __: None)
    followed(made, tmp_path)
    time.sleep(0.5)
    assert ask(made, "scope.frame")["following"]
    leave()
    said = until(made, lambda said: not said["following"])
    assert said["state"] == "stopped, since no page was open"


class Broken:
    """A source with a fault that feeddrive did not foresee."""

    name, clock, over, closed = "broken", "s", False, False
    channels: Mapping[str, str] = MappingProxyType({})

    def take(self) -> Rows:
        raise IndexError("no such place")

    def state(self) -> str:
        return "rows come"

    def close(self) -> None:
        self.closed = True


def test_a_fault_that_nobody_foresaw_is_shown() -> None:
    source = Broken()
    following = live.Following(source, Oscilloscope(), lambda: True)
    for _ in range(6000):
        if not following.going:
            break
        time.sleep(0.01)
    assert following.state().startswith("a fault in feeddrive, please report it: IndexError in test_studio_scope.py")
    assert source.closed


def test_a_source_without_a_clock_is_counted_in_samples_and_kept_once_it_has_one(tmp_path: Path) -> None:
    (tmp_path / "page").mkdir()
    (tmp_path / "run.txt").write_text("".join(f"{k / 100:f} \n" for k in range(300)), encoding="utf-8")
    made = Session(tmp_path / "page", live=Followable((tmp_path / "run.txt",)))
    leave = made.listen(lambda _, __: None)
    try:
        ask(made, "scope.follow", name=str(tmp_path / "run.txt"))
        said = until(made, lambda said: bool(said["charts"]))
        assert said["span"] == [-500.0, 0.0]
        assert "give the sample time" in said["look"]
        (window,) = [each for each in ask(made, "scope.show")["fields"] if each["name"] == "window"]
        assert (window["value"], window["unit"]) == ("500", "samples")
        assert said["charts"]["scope"]["label"] == "time until now (samples)"
        assert "give the sample time" in ask(made, "scope.save", between=False)["error"]
        (window,) = [
            each
            for each in ask(made, "scope.set", field="sample_time", value="0.001")["fields"]
            if each["name"] == "window"
        ]
        assert (window["value"], window["unit"]) == ("1", "s")
        ask(made, "scope.set", field="window", value="0.2")
        until(made, lambda said: bool(said["charts"]) and "(s)" in said["charts"]["scope"]["label"])
        ask(made, "scope.channel", name="column_1", shown=True, stated="mm")
        kept = ask(made, "scope.save", between=False)
        log = read_log(made.desk.folder / "brought" / kept["import"])
        assert (log.sample_time, dict(log.units)) == (1e-3, {"column_1": "mm"})
    finally:
        leave()
        made.close()


def test_a_window_keeps_the_names_and_units_of_its_recording_when_the_file_is_replaced(
    session: Session, tmp_path: Path
) -> None:
    """force and position, triggered; then velocity and force: the window that stands is of the first file, and kept."""
    path = tmp_path / "run.csv"
    path.write_text("t_s,force_N,position_mm\n", encoding="utf-8")
    with path.open("a", encoding="utf-8") as file:
        file.writelines(f"{k / 1e3:.3f},{k},{-k}\n" for k in range(400))
    ask(session, "scope.follow", name=str(path))
    until(session, lambda said: bool(said["charts"]))
    ask(session, "scope.channel", name="force_N", shown=True, unit="kN")
    ask(session, "scope.set", field="window", value="0.1")
    ask(session, "scope.set", field="before", value="0.5")
    ask(session, "scope.look", mode="single", channel="position_mm")
    ask(session, "scope.set", field="edge", value="falling")
    ask(session, "scope.set", field="level", value="-600")
    with path.open("a", encoding="utf-8") as file:
        file.writelines(f"{k / 1e3:.3f},{k},{-k}\n" for k in range(400, 1000))
    before = until(session, lambda said: said["look"].startswith("triggered"))
    new = tmp_path / "new.csv"
    new.write_text("t_s,velocity_mm_s,force_N\n" + "".join(f"{k / 1e3:.3f},7,8\n" for k in range(300)), "utf-8")
    new.replace(path)
    said = until(session, lambda said: any("velocity" in each for each in said["of"]))
    assert said["look"] == "the source has other channels now; what is shown was recorded before"
    assert said["charts"]["scope"]["panels"][0]["label"] == before["charts"]["scope"]["panels"][0]["label"]
    x, y = curve(said, "force_N")
    np.testing.assert_allclose(y, (600 + 1e3 * x) / 1e3, atol=1e-5)
    x, y = curve(said, "position_mm")
    np.testing.assert_allclose(y, -(600 + 1e3 * x), atol=1e-3)
    ask(session, "scope.move", name="1", x=0.0)
    assert [each[0] for each in ask(session, "scope.frame")["readout"][1:]] == ["force_N (kN)", "position_mm (mm)"]
    kept = ask(session, "scope.save", between=False)
    log = read_log(session.desk.folder / "brought" / kept["import"])
    assert dict(log.units) == {"force_N": "N", "position_mm": "mm"}
    np.testing.assert_allclose(log["force_N"], -log["position_mm"])
    assert [each["name"] for each in ask(session, "scope.show")["channels"]] == ["velocity_mm_s", "force_N"]


@pytest.mark.parametrize("window", ["", "800"])
def test_a_window_in_samples_is_none_in_seconds(tmp_path: Path, window: str) -> None:
    """Neither the one that nobody chose nor one that was chosen, where a source with a clock is followed next."""
    (tmp_path / "page").mkdir()
    (tmp_path / "run.txt").write_text("".join(f"{k / 100:f} \n" for k in range(900)), encoding="utf-8")
    write(tmp_path / "run.csv", 0, 500)
    made = Session(tmp_path / "page", live=Followable((tmp_path / "run.txt", tmp_path / "run.csv")))
    leave = made.listen(lambda _, __: None)

    def fields() -> tuple[str, str]:
        (found,) = [each for each in ask(made, "scope.show")["fields"] if each["name"] == "window"]
        return found["value"], found["unit"]

    try:
        followed(made, tmp_path, "run.txt")
        assert fields() == ("500", "samples")
        if window:
            assert "error" not in ask(made, "scope.set", field="window", value=window)
            assert fields() == (window, "samples")
        followed(made, tmp_path)
        assert fields() == ("1", "s")
        assert ask(made, "scope.frame")["span"] == [-1.0, 0.0]
        ask(made, "scope.set", field="window", value="0.2")
        followed(made, tmp_path, "run.txt")
        assert fields() == ("500", "samples")
        (tmp_path / "run.txt").unlink()
        write(tmp_path / "run.txt", 0, 500)  # the same source, with a clock now
        until(made, lambda said: bool(said["charts"]) and "(s)" in said["charts"]["scope"]["label"])
        assert fields() == ("1", "s")
    finally:
        leave()
        made.close()


def test_rows_from_a_pipe_reach_every_page(tmp_path: Path) -> None:
    reading, writing = os.pipe()
    pages = [tmp_path / name for name in "ab"]
    with open(reading, "rb") as stream, open(writing, "wb", buffering=0) as end:
        followable = Followable((Path("-"),), pipe=Pipe(stream))
        made = list[Session]()
        for page in pages:
            page.mkdir()
            made.append(Session(page, live=followable))
        leaves = [each.listen(lambda _, __: None) for each in made]
        try:
            end.write("".join(f"{k} {k / 4:f} \n" for k in range(100)).encode())
            for each in made:
                ask(each, "scope.set", field="sample_time", value="0.001")
                assert "error" not in ask(each, "scope.follow", name="-")
            end.write("".join(f"{k} {k / 4:f} \n" for k in range(100, 1200)).encode())
            for each in made:
                said = until(each, lambda said: bool(said["charts"]) and curve(said, "column_2")[1][-1] == 1199 / 4)
                x, y = curve(said, "column_2")
                np.testing.assert_allclose(y, (1199 + 1e3 * x) / 4, atol=1e-3)
            end.close()
            until(made[0], lambda said: said["state"] == "the pipe has ended")
        finally:
            for leave, each in zip(leaves, made, strict=True):
                leave()
                each.close()


DRIVEN = """
import json, sys
from pathlib import Path

def main():  # with its imports, which the processes that sample begin without
    from feeddrive.studio.live import Followable
    from feeddrive.studio.server import Session

    sys.path[:0] = {here!r}
    from test_studio_scope import ask, curve, until

    pages = []
    for name in "ab":
        Path(name).mkdir()
        pages.append(Session(Path(name), live=Followable((Path("drive.toml"),))))
        pages[-1].listen(lambda _, __: None)
    one, other = pages
    ask(one, "scope.follow", name="drive.toml")
    until(one, lambda said: bool(said["charts"]), 30.0)
    found = {{"first": float(curve(until(one, lambda said: bool(said["charts"])), "position")[1][-1])}}
    ask(other, "scope.follow", name="drive.toml")
    found["refused"] = until(other, lambda said: said["failed"], 30.0)["state"]
    said = until(one, lambda said: curve(said, "position")[1][-1] < found["first"] - 1.0)
    found["state"], found["unit"] = said["state"], ask(one, "scope.show")["channels"][0]["in_unit"]
    ask(one, "scope.stop")
    ask(other, "scope.follow", name="drive.toml")
    until(other, lambda said: bool(said["charts"]), 30.0)
    found["then"] = True
    for each in pages:
        each.close()
    print("FOUND", json.dumps(found))

if __name__ == "__main__":
    main()
"""


@pytest.mark.slow(reason="a drive, a server and pages in processes of their own: 9 s")
def test_a_drive_is_sampled_by_one_page_and_free_for_the_next(tmp_path: Path) -> None:
    """Over CANopen between processes; the axis falls by 1 N on 100 kg."""
    (tmp_path / "hanging.toml").write_text(HANGING, encoding="utf-8")
    here = [str(each) for each in Path(__file__).parents[:2]]
    (tmp_path / "pages.py").write_text(DRIVEN.format(here=here), encoding="utf-8")
    drive = "--bus canopen --station 9 --interface udp_multicast:239.74.163.2"
    script = "ip link set lo up; ip route add 239.0.0.0/8 dev lo\n" + BESIDE.format(
        feeddrive=FEEDDRIVE, drive=drive, command=f"{sys.executable} pages.py"
    )
    done = in_a_namespace("bash", "-c", script, cwd=tmp_path)
    assert done.returncode == 0, done.stderr + done.stdout
    (line,) = [each for each in done.stdout.splitlines() if each.startswith("FOUND ")]
    found = json.loads(line.removeprefix("FOUND "))
    assert "the interface is driven by another feeddrive" in found["refused"]
    assert found["state"] == "feeddrive virtual drive. 'switch on disabled'; sampled, not commanded"
    assert (found["unit"], found["then"]) == ("mm", True)
    assert "last in 'switch on disabled'" in done.stdout

"""The import step as its page asks for it: the order of the columns, the queue of files, and rated values."""

from __future__ import annotations

import json
import random
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.files.log import Log
from feeddrive.language.errors import FeeddriveError, ParameterError
from feeddrive.language.progress import Progress
from feeddrive.studio import log_check, uploads
from feeddrive.studio.desk import Asked
from feeddrive.studio.rooms import import_
from feeddrive.studio.rooms.import_ import Import
from feeddrive.studio.server import Session
from plain_drive import Cascade, PlainAxis, write_columns

RUN = PlainAxis(mass=180.0).run(Cascade(30.0, 9000.0))
RATED = 1200.0  # N


def written(path: Path, sign: float = 1.0) -> Path:
    """A log with a force in percent of 1200 N, and a column that means nothing."""
    names = {
        "t_s": RUN["time"],
        "load [%]": sign * RUN["force"] / (RATED / 100.0),
        "spare": RUN["set"] ** 2,
        "target [mm]": 1e3 * RUN["set"],
        "actual [mm]": 1e3 * RUN["position"],
    }
    return write_columns(path, names)


class Desk:
    """A session whose jobs run when a test lets them, in this process."""

    def __init__(self, folder: Path, *names: str) -> None:
        self.session = Session(folder)
        self.bring = self.session.rooms["import"]
        assert isinstance(self.bring, Import)
        self.jobs = list[tuple[Any, Callable[[Any], None]]]()
        self.session.desk.start = self.start  # type: ignore[method-assign]
        self.session.desk.files = {name: written(folder / name) for name in names}

    def start(self, _room: str, _what: str, work: Any, then: Callable[[Any], None], *_: Any) -> None:
        self.jobs.append((work, then))

    def ask(self, act: str, **more: Any) -> dict[str, Any]:
        """What the room says of an act, which must not be refused."""
        answer = self.session.answer({"number": 1, "do": f"import.{act}", **more})
        said: dict[str, Any] = json.loads(answer[4 : 4 + struct.unpack_from("<I", answer)[0]])
        assert "error" not in said, said["error"]
        return said

    def read(self) -> dict[str, Any]:
        """Let the first job end, and say what the page shows then."""
        work, then = self.jobs.pop(0)
        then(work(Progress()))
        return self.ask("show")

    def look(self, *names: str) -> dict[str, Any]:
        self.ask("look", names=[*names])
        return self.read()


def columns(said: dict[str, Any]) -> list[str]:
    return [row["column"] for row in said["columns"]]


def row(said: dict[str, Any], column: str) -> dict[str, Any]:
    return next(each for each in said["columns"] if each["column"] == column)


def test_rows_stay_in_the_order_of_the_file_whatever_their_roles_are(tmp_path: Path) -> None:
    desk = Desk(tmp_path, "a.csv")
    order = columns(desk.look("a.csv"))
    assert order == ["t_s", "load", "spare", "target", "actual"]
    for column, role in (("actual", "setpoint_position"), ("spare", "position_load"), ("target", ""), ("load", "")):
        said = desk.ask("role", name="a.csv", column=column, role=role, unit="")
        assert columns(said) == order
        assert row(said, column)["role"] == role
        assert row(said, column)["why"] == ("you chose it" if role else row(said, column)["why"])


def test_a_second_log_waits_until_the_first_is_used_or_removed(tmp_path: Path) -> None:
    desk = Desk(tmp_path, "a.csv", "b.csv", "c.csv", "d.csv")
    said = desk.look("a.csv", "b.csv")
    assert (said["open"], said["queue"]) == ("a.csv", ["b.csv"])
    said = desk.look("c.csv")
    assert (said["open"], said["queue"]) == ("a.csv", ["b.csv", "c.csv"])
    said = desk.ask("drop", name="b.csv")
    assert (said["open"], said["queue"]) == ("a.csv", ["c.csv"])
    said = desk.ask("pick", name="c.csv")  # before its turn: the other one is next
    assert (said["open"], said["queue"]) == ("c.csv", ["a.csv"])
    said = desk.ask("drop", name="c.csv")
    assert (said["open"], said["queue"]) == ("a.csv", [])
    desk.bring._used.add("a.csv")  # as after an identification
    said = desk.look("d.csv")
    assert (said["open"], said["queue"]) == ("d.csv", [])


def test_other_kinds_of_files_are_listed_beside_a_log_and_what_is_damaged_says_why(tmp_path: Path) -> None:
    desk = Desk(tmp_path, "a.csv")
    (tmp_path / "empty.csv").write_text("", encoding="utf-8")
    (tmp_path / "mine.toml").write_text(fd.read_machine("linear_motor").file.text, encoding="utf-8")
    desk.session.desk.files |= {name: tmp_path / name for name in ("empty.csv", "mine.toml")}
    said = desk.look("a.csv", "empty.csv", "mine.toml")
    assert (said["open"], said["queue"]) == ("a.csv", [])
    assert [each["kind"] for each in said["files"]] == ["log", "unknown", "machine"]
    assert "is empty" in said["files"][1]["wrong"]


def test_a_file_that_comes_during_a_job_is_read_at_its_end_and_one_whose_reading_fails_only_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    desk = Desk(tmp_path, "a.csv", "b.csv", "c.csv")
    busy = True
    monkeypatch.setattr(type(desk.session.desk), "is_free", property(lambda _: not busy))
    said = desk.ask("look", names=["a.csv"])
    assert (said["queue"], desk.jobs) == (["a.csv"], [])
    desk.ask("look", names=["b.csv"])
    assert desk.ask("drop", name="a.csv")["queue"] == ["b.csv"]
    busy = False
    desk.session._freed()
    assert desk.read()["open"] == "b.csv"
    desk.ask("look", names=["c.csv"])
    desk.jobs.clear()  # its process has crashed, say
    desk.session._freed()
    assert (desk.ask("show")["queue"], desk.jobs) == ([], [])


@pytest.mark.parametrize(
    ("typed", "role", "factor"),
    [
        ({"rated": RATED, "rated_unit": "N"}, "force", 12.0),
        ({"rated": 7.5, "rated_unit": "N m"}, "torque", 0.075),
        # 5.6 A peak, 1.3 N m/A RMS, a screw of 10 mm behind a gear of 2: 2π 2 / 0.01 · 1.3 · 5.6 / √2 / 100
        (
            {"rated": 5.6, "rated_unit": "A", "torque_constant": 1.3, "amplitude": True}
            | {"lead_mm": 10.0, "gear": 2.0, "inverted": True},
            "force",
            -64.69,
        ),
    ],
)
def test_a_rated_value_gives_the_factor_of_feeddrive_force(
    tmp_path: Path, typed: dict[str, Any], role: str, factor: float
) -> None:
    desk = Desk(tmp_path, "a.csv")
    desk.look("a.csv")
    said = desk.ask("role", name="a.csv", column="load", role="force", unit="")
    assert row(said, "load")["missing"]
    assert row(said, "load")["signal"] == "percent"
    found = row(desk.ask("scale", name="a.csv", column="load", signal="percent", **typed), "load")
    assert (found["role"], found["missing"]) == (role, False)
    assert found["entered"] == {"signal": "percent", **typed}
    assert found["factor"] == pytest.approx(factor, rel=1e-4)  # of a closed form with four digits
    sent = {key: value for key, value in typed.items() if key not in ("rated_unit", "lead_mm")}
    sent["rated"] = f"{typed['rated']}:{typed['rated_unit']}"
    if "lead_mm" in typed:
        sent["lead"] = 1e-3 * typed["lead_mm"]
    assert found["factor"] == fd.workflow.force("percent", column="load", **sent).factor
    # another role of the column ends it, and the text of the file for --channels has it
    assert f"factor = {found['factor']!r}" in desk.bring.files["a.csv"].guess.toml()  # type: ignore[union-attr]
    assert row(desk.ask("role", name="a.csv", column="load", role="", unit=""), "load")["entered"] == {}


@pytest.mark.parametrize(
    ("typed", "message"),
    [
        ({"rated": -3.0, "rated_unit": "N"}, "must be > 0"),
        ({"rated": 5.0, "rated_unit": "A"}, "a current needs the constant of the motor"),
        ({"rated": 5.0, "rated_unit": "mm"}, "the unit must be one of a torque, a force or a current"),
        ({"rated": "5,x", "rated_unit": "N"}, "rated must be a number"),
    ],
)
def test_a_rated_value_that_is_refused_changes_nothing(tmp_path: Path, typed: dict[str, Any], message: str) -> None:
    desk = Desk(tmp_path, "a.csv")
    before = desk.look("a.csv")["columns"]
    with pytest.raises(FeeddriveError, match=message):
        desk.bring.do("scale", Asked({"name": "a.csv", "column": "load", "signal": "percent", **typed}))
    assert desk.ask("show")["columns"] == before
    with pytest.raises(ParameterError, match="has no column 'other'"):
        desk.bring.do("scale", Asked({"name": "a.csv", "column": "other", "signal": "percent"}))


def test_the_course_of_a_column_has_its_ends_in_the_unit_in_which_it_is_read(tmp_path: Path) -> None:
    desk = Desk(tmp_path, "a.csv")
    found = row(desk.look("a.csv"), "target")
    assert (found["low"], found["high"]) == ("0 mm", "150 mm")
    assert (min(found["course"]), max(found["course"])) == (0, 100)
    assert 70 <= len(found["course"]) <= 100  # a point for each pixel or a little less
    said = desk.ask("scale", name="a.csv", column="load", signal="percent", rated=RATED, rated_unit="N", inverted=True)
    most = max(abs(RUN["force"]))
    assert row(said, "load")["high"] == f"{most:.3g} N"
    assert row(said, "spare")["low"] == "0"


def two_axes(path: Path) -> Path:
    """A log of two axes of which the second moves later and less."""
    columns = {"time [s]": RUN["time"]}
    for axis, share, late in (("X1", 1.0, 0), ("Y1", 0.4, 150)):
        for name, key, factor in (
            ("target [mm]", "set", 1e3),
            ("actual [mm]", "position", 1e3),
            ("torque [%]", "force", 0.1),
        ):
            columns[f"{axis}_{name}"] = share * factor * np.roll(RUN[key], late)
    return write_columns(path, columns)


def test_one_axis_of_several_is_chosen_and_what_was_assigned_of_each_is_kept(tmp_path: Path) -> None:
    desk = Desk(tmp_path)
    desk.session.desk.files = {"two.csv": two_axes(tmp_path / "two.csv")}
    said = desk.look("two.csv")
    assert len(said["axes"]) == 2
    first, second = said["axes"]
    assert said["axis"] == first
    order = columns(said)
    assert [row(said, f"{axis}_actual")["role"] for axis in ("X1", "Y1")] == ["position_load", ""]
    assert "of axis" in row(said, "Y1_actual")["why"]
    desk.ask("role", name="two.csv", column="X1_target", role="", unit="")
    said = desk.ask("choose_axis", name="two.csv", axis=second)
    assert columns(said) == order
    assert [row(said, f"{axis}_actual")["role"] for axis in ("X1", "Y1")] == ["", "position_load"]
    figures = {name: value for name, value, _ in said["check"]["figures"]["rows"]}
    assert figures["travel"] == f"{0.4 * 1e3 * np.ptp(RUN['position']):.2f} mm"
    said = desk.ask("choose_axis", name="two.csv", axis=first)
    assert row(said, "X1_target")["role"] == ""
    with pytest.raises(ParameterError, match="axis must be one of"):
        desk.bring.do("choose_axis", Asked({"name": "two.csv", "axis": "z"}))


def test_the_peak_figures_are_those_of_the_log_in_its_units_and_follow_the_roles(tmp_path: Path) -> None:
    desk = Desk(tmp_path, "a.csv")
    said = desk.look("a.csv")
    assert (said["check"]["outside"], said["remarks"]) == ([], [])
    desk.ask("scale", name="a.csv", column="load", signal="percent", rated=RATED, rated_unit="N")
    figures = {name: value for name, value, _ in desk.ask("show")["check"]["figures"]["rows"]}
    assert figures["travel"] == f"{1e3 * np.ptp(RUN['position']):.1f} mm"
    assert figures["speed"].startswith(f"{1e3 * max(abs(RUN['velocity'])):.0f} mm/s")
    assert figures["largest force"] == f"{max(abs(RUN['force'])):.1f} N"
    # without friction; of the log 60 N of 700 N and 300 N s/m at 0.55 m/s are friction
    assert float(figures["mass, roughly"].split()[0]) == pytest.approx(180.0, rel=0.15)
    # in m the axis would travel 150 m at 550 m/s
    for column in ("actual", "target"):
        said = desk.ask("role", name="a.csv", column=column, role=row(said, column)["role"], unit="m")
    assert said["check"]["outside"][:1] == ["speed"]
    assert said["remarks"] == ["Check the units: no feed drive has such figures."]
    said = desk.ask("role", name="a.csv", column="actual", role="", unit="")
    assert said["check"] == {"figures": None, "outside": [], "readings": None, "choices": [], "notes": 0}


def test_roles_that_the_samples_contradict_are_marked_in_their_row(tmp_path: Path) -> None:
    desk = Desk(tmp_path, "a.csv")
    said = desk.look("a.csv")
    assert not any(each["doubted"] for each in said["columns"])
    desk.ask("role", name="a.csv", column="target", role="position_load", unit="mm")
    said = desk.ask("role", name="a.csv", column="actual", role="setpoint_position", unit="mm")
    assert [each["column"] for each in said["columns"] if each["doubted"]]
    assert any("setpoint" in sentence or "set position" in sentence for sentence in said["remarks"]), said["remarks"]


def test_a_log_without_a_clock_is_read_again_with_its_sample_time(tmp_path: Path) -> None:
    path = write_columns(tmp_path / "bare.csv", {"x_mm": 1e3 * RUN["position"], "F_N": RUN["force"]})
    desk = Desk(tmp_path)
    desk.session.desk.files = {"bare.csv": path, "broken.csv": tmp_path / "broken.csv"}
    (tmp_path / "broken.csv").write_text("no table\n", encoding="utf-8")
    said = desk.look("bare.csv", "broken.csv")
    assert [each["no_clock"] for each in said["files"]] == [True, False]
    said = desk.ask("look", names=["bare.csv"], sample_time=0.002)
    said = desk.read()
    assert said["open"] == "bare.csv"
    assert row(said, "x_mm")["role"] == "position_load"
    figures = {name: value for name, value, _ in said["check"]["figures"]["rows"]}
    assert figures["speed"].startswith(f"{0.5e3 * max(abs(RUN['velocity'])):.0f} mm/s")
    assert "sample_time = 0.002" in desk.bring.files["bare.csv"].guess.toml()  # type: ignore[union-attr]


def test_the_figures_of_a_long_log_are_those_of_all_of_its_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every third row is kept then: speeds are those over 5 ms, within 1 % of the peak."""
    desk = Desk(tmp_path, "a.csv")
    monkeypatch.setattr(uploads, "_HELD", RUN["time"].size * 5 // 3)
    said = desk.look("a.csv")
    log = desk.bring.files["a.csv"].log
    assert log is not None
    assert log.sample_time == pytest.approx(0.003)
    figures = {name: value for name, value, _ in said["check"]["figures"]["rows"]}
    assert float(figures["speed"].split()[0]) == pytest.approx(1e3 * max(abs(RUN["velocity"])), rel=0.01)


def test_units_in_doubt_are_asked_for_with_the_likeliest_ones_to_choose(tmp_path: Path) -> None:
    names = {
        "t_s": RUN["time"],
        "target": 1e3 * RUN["set"],
        "actual": 1e3 * RUN["position"],
        "torque": RUN["force"] / 100.0,
    }
    desk = Desk(tmp_path)
    desk.session.desk.files = {"a.csv": write_columns(tmp_path / "a.csv", names)}
    said = desk.look("a.csv")
    first = said["check"]["choices"][0]
    assert ["actual", "mm"] in first
    assert said["check"]["readings"] is not None
    for column, unit in first:
        said = desk.ask("unit", name="a.csv", column=column, unit=unit)
    assert said["check"]["outside"] == []
    assert row(said, "target")["unit"] == "mm"  # which states none either
    assert "no unit" not in row(said, "target")["why"]
    with pytest.raises(FeeddriveError, match="'kg' does not measure"):
        desk.bring.do("unit", Asked({"name": "a.csv", "column": "actual", "unit": "kg"}))
    # percent that is entered and not stated by the file asks for the rated value too
    said = desk.ask("role", name="a.csv", column="torque", role="torque", unit="%")
    found = row(said, "torque")
    assert (found["missing"], found["signal"], found["unit"]) == (True, "percent", "%")
    said = desk.ask("scale", name="a.csv", column="torque", signal="percent", rated=10.0, rated_unit="N m")
    assert (row(said, "torque")["factor"], row(said, "torque")["signal"]) == (0.1, "percent")


def test_whatever_a_page_sends_of_a_data_sheet_is_refused_in_plain_words(tmp_path: Path) -> None:
    desk = Desk(tmp_path, "a.csv")
    desk.look("a.csv")
    draw = random.Random(5)
    odd = [
        None,
        "",
        "x",
        0,
        -1,
        1.0,
        2.5,
        1e308,
        1e-320,
        10**400,
        True,
        [],
        {},
        "N",
        "N m",
        "A",
        "percent",
        "V",
        float("nan"),
    ]
    names = ["signal", *import_._ENTERED]
    refused = 0
    for _ in range(300):
        sent = {name: draw.choice(odd) for name in draw.sample(names, draw.randrange(1, len(names)))}
        for act in ("scale", "role", "unit", "choose_axis"):
            answer = desk.session.answer(
                {"number": 1, "do": f"import.{act}", "name": "a.csv", "column": "load", **sent}
            )
            said = json.loads(answer[4 : 4 + struct.unpack_from("<I", answer)[0]])
            refused += "error" in said
            assert "a fault in feeddrive" not in said.get("error", ""), (act, sent, said["error"])
    assert refused > 300


def test_a_result_calls_the_file_by_its_name_and_not_by_its_place(tmp_path: Path) -> None:
    words = {"verdict": [f"{tmp_path}/a.csv: good"], "sections": ({"title": f"in {tmp_path}/a.csv", "rows": 3},)}
    found = import_._renamed(words, {f"{tmp_path}/a.csv": "a.csv"})
    assert found == {"verdict": ["a.csv: good"], "sections": [{"title": "in a.csv", "rows": 3}]}


@pytest.mark.parametrize(("rows", "every"), [(1_000_000, 1), (1_200_000, 2)])
def test_two_million_numbers_of_a_log_are_held(rows: int, every: int) -> None:
    """Of two columns a million rows, 16 MB; of a longer log every second row."""
    time = 1e-3 * np.arange(rows)
    log = Log(name="long", time=time, channels={"x": time}, units={}, sample_time=1e-3)
    held = uploads._thinned(log)
    assert held.time.size == rows // every
    assert held.sample_time == pytest.approx(every * 1e-3)
    assert held["x"][1] == time[every]


def test_a_unit_in_the_name_of_a_column_asks_for_the_rated_value_too(tmp_path: Path) -> None:
    columns_ = {"t_s": RUN["time"], "x_mm": 1e3 * RUN["position"], "current_mA": RUN["force"]}
    desk = Desk(tmp_path)
    desk.session.desk.files = {"a.csv": write_columns(tmp_path / "a.csv", columns_)}
    found = row(desk.look("a.csv"), "current_mA")
    assert (found["role"], found["signal"]) == ("current", "A")
    typed = {"signal": "A", "motor_constant": 35.0}
    for _ in range(2):  # the unit is that of the numbers also once there is a factor
        found = row(desk.ask("scale", name="a.csv", column="current_mA", **typed), "current_mA")
        assert (found["role"], found["factor"], found["why"]) == ("force", 0.035, "you gave constant 35 N/A")
    desk.session.desk.files = {"a.csv": written(tmp_path / "b.csv")}
    assert row(desk.look("a.csv"), "load")["entered"] == {}  # another file of this name


def test_a_column_that_cannot_be_judged_leaves_the_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    desk = Desk(tmp_path, "a.csv")
    desk.look("a.csv")
    monkeypatch.setattr(log_check, "log_preview", lambda *_: 1 / 0)
    said = desk.ask("role", name="a.csv", column="spare", role="excitation", unit="")
    assert said["check"]["figures"] is None
    assert "a fault in feeddrive, please report it: ZeroDivisionError" in said["remarks"][0]


def test_what_may_have_a_good_reason_is_a_note_and_marks_no_row(tmp_path: Path) -> None:
    """A set position that trails by three samples: recorded later, or the axis leads by its feedforward."""
    late = np.concatenate([np.zeros(3), RUN["position"][:-3]])
    names = {"t_s": RUN["time"], "set_mm": 1e3 * late, "x_mm": 1e3 * RUN["position"], "F_N": RUN["force"]}
    desk = Desk(tmp_path)
    desk.session.desk.files = {"a.csv": write_columns(tmp_path / "a.csv", names)}
    said = desk.look("a.csv")
    assert (len(said["remarks"]), said["check"]["notes"]) == (1, 1)
    assert "trails" in said["remarks"][0]
    assert not any(each["doubted"] for each in said["columns"])


def test_a_role_that_the_samples_leave_open_is_marked_in_its_row_and_not_as_wrong(tmp_path: Path) -> None:
    """Two encoders on a stiff axis: neither runs ahead of the other, so that one may be at the motor as the other."""
    noise = 1e-7 * np.random.default_rng(3).standard_normal((2, RUN["time"].size))
    names = {"t_s": RUN["time"], "x_motor_mm": 1e3 * (RUN["position"] + noise[0])}
    names |= {"x_table_mm": 1e3 * (RUN["position"] + noise[1]), "F_N": RUN["force"]}
    desk = Desk(tmp_path)
    desk.session.desk.files = {"a.csv": write_columns(tmp_path / "a.csv", names)}
    said = desk.look("a.csv")
    marked = row(said, "x_motor_mm")
    assert (marked["open"], marked["doubted"]) == (True, False)
    assert marked["why"] == "the samples leave this role open"
    assert not row(said, "F_N")["open"]


def test_further_logs_of_an_axis_are_pooled_by_the_columns_of_the_first(tmp_path: Path) -> None:
    desk = Desk(tmp_path, "a.csv", "b.csv", "c.csv")
    desk.look("a.csv", "b.csv", "c.csv")
    desk.ask("identify", name="a.csv", also=["b.csv"])
    work, _ = desk.jobs.pop(0)
    command, request = work.args
    assert command == "identify"
    assert [path.name for path in request.sources] == ["a.csv", "b.csv"]
    assert request.channels.name.startswith("roles_a")
    desk.ask("identify", name="a.csv", also=["a.csv"])  # a log counts once
    assert [path.name for path in desk.jobs.pop(0)[0].args[1].sources] == ["a.csv"]


def test_what_is_no_log_is_not_pooled(tmp_path: Path) -> None:
    desk = Desk(tmp_path, "a.csv")
    (tmp_path / "mine.toml").write_text(fd.read_machine("linear_motor").file.text, encoding="utf-8")
    desk.session.desk.files["mine.toml"] = tmp_path / "mine.toml"
    desk.look("a.csv", "mine.toml")
    for other, why in (("mine.toml", "machine"), ("never.csv", "no such file was brought")):
        asked = Asked({"name": "a.csv", "also": [other]})
        with pytest.raises(ParameterError, match=f"{other} is no log that can be pooled with a.csv: {why}"):
            desk.bring.identify(asked)  # type: ignore[attr-defined]

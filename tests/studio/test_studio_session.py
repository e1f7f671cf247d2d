"""Sessions of the page: what is moved, undone and kept, each page for itself; and what goes over the wire."""

from __future__ import annotations

import json
import struct
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.plot.chart import Band, Chart, Curve, Panel
from feeddrive.plot.style import envelope
from feeddrive.studio.bench import Bench, bench_of
from feeddrive.studio.server import FIELDS, POINTS, Session, message
from feeddrive.tuning.candidates import control_with

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def bench() -> Bench:
    return bench_of("ball_screw")


@pytest.fixture
def session(bench: Bench, tmp_path: Path) -> Session:
    return Session(tmp_path, bench)


def read(answer: bytes) -> tuple[dict[str, Any], np.ndarray]:
    (length,) = struct.unpack_from("<I", answer)
    return json.loads(answer[4 : 4 + length]), np.frombuffer(answer[4 + length :], "<f4")


def asked(session: Session, do: str, **more: Any) -> dict[str, Any]:
    return read(session.answer({"number": 1, "do": do, **more}))[0]


def test_a_move_is_judged_and_drawn_beside_today(session: Session, bench: Bench) -> None:
    said, numbers = read(session.answer({"number": 7, "do": "tune.move", "name": "law.Kv", "value": 150.0}))
    assert said["number"] == 7
    assert said["values"]["law.Kv"] == 150.0
    assert set(said["charts"]) == {"open_loop", "nyquist", "sensitivity", "stiffness", "run"}
    (judged,) = said["judged"]
    values = bench.by_hand.values | {"law.Kv": 150.0}
    margins = bench.by_hand.at(values).leading.margins
    peak = margins.sensitivity_peak
    assert judged["text"] == f"Ms {peak:.4g} at {margins.modulus_frequency:.4g} Hz, limit: Ms <= 2"
    assert judged["keeps"] == (peak <= 2.0)
    curves = said["charts"]["stiffness"]["panels"][0]["curves"]
    assert [each["name"] for each in curves] == ["today", "now"]
    last = curves[-1]
    drawn = numbers[last["at"] + last["n"] : last["at"] + 2 * last["n"]]
    figures = bench.by_hand.at(values).leading.stiffness
    (frequency, heights), at = envelope(figures.frequency, 1e-6 * figures.magnitude, POINTS), last["at"]
    np.testing.assert_allclose(numbers[at : at + last["n"]], frequency, rtol=1e-6)  # float32
    np.testing.assert_allclose(drawn, heights, rtol=1e-6)


def test_a_loop_that_is_not_stable_is_said_and_its_open_loop_is_drawn(session: Session) -> None:
    said = asked(session, "tune.move", name="law.Kp", value=2e6)
    assert said["stable"] is False
    assert [each["name"] for each in said["charts"]["open_loop"]["panels"][0]["curves"] if each["name"]] == [
        "today",
        "now",
    ]
    assert [each["name"] for each in said["charts"]["stiffness"]["panels"][0]["curves"]] == ["today"]


def test_a_drag_is_undone_as_one_and_redone(session: Session) -> None:
    held = session.desk.values["law.Kv"]
    for i, value in enumerate((held, 110.0, 120.0, 130.0)):  # a drag begins where the slider stands
        asked(session, "tune.move", name="law.Kv", value=value, first=i == 0)
    said = asked(session, "tune.move", name="law.Tn", value=0.01)
    assert (said["undo"], said["redo"]) == (2, 0)
    assert asked(session, "tune.undo")["values"]["law.Kv"] == 130.0
    said = asked(session, "tune.undo")
    assert said["values"]["law.Kv"] == session.desk.needed.by_hand.values["law.Kv"]
    assert (said["undo"], said["redo"]) == (0, 2)
    assert asked(session, "tune.redo")["values"]["law.Kv"] == 130.0
    assert asked(session, "tune.move", name="law.Kv", value=90.0)["redo"] == 0  # another way: the old future is gone


def test_a_filter_is_added_moved_and_undone_with_its_numbers(session: Session) -> None:
    """An undo step holds parts and numbers; what was kept to compare has its own parts."""
    asked(session, "tune.move", name="law.Kv", value=90.0)
    begun = asked(session, "tune.show")
    said = asked(session, "tune.add", kind="notch", at=222.0)
    assert said["values"] | {"filters.2.frequency": 222.0} == said["values"]
    assert [each["name"] for each in said["knobs"] if each["block"] == "notch"][-1] == "filters.2.damping_pole"
    asked(session, "tune.move", name="filters.2.damping_pole", value=0.3)
    asked(session, "tune.keep", letter="A")
    said = asked(session, "tune.remove", place=0)
    assert said["values"]["filters.1.damping_pole"] == 0.3  # the ones behind it have moved up
    assert said["undo"] == 4
    for wanted in ({"filters.2.damping_pole": 0.3}, {"filters.2.frequency": 222.0}, {"law.Kv": 90.0}):
        said = asked(session, "tune.undo")
        assert said["values"] | wanted == said["values"]
    assert said["values"] == begun["values"]
    assert said["judged"] == begun["judged"]
    assert asked(session, "tune.take", letter="A")["values"]["filters.2.damping_pole"] == 0.3
    assert asked(session, "tune.reset")["values"] == session.desk.needed.before.values


def test_a_filter_is_held_in_the_picture(session: Session) -> None:
    """Grips lie on |L|; a drag is one step to undo, keys are one each."""
    said = asked(session, "tune.show")
    grips = {each["name"]: each for each in said["grips"]}
    assert set(grips) == {"filters.0.frequency", "filters.0.width", "filters.1.frequency"}
    for i, x in enumerate((450.0, 400.0, 350.0)):
        said = asked(session, "tune.drag", name="filters.0.frequency", x=x, y=-20.0, first=i == 0)
    assert said["undo"] == 1
    (grip,) = (each for each in said["grips"] if each["name"] == "filters.0.frequency")
    assert (grip["x"], grip["y"]) == (350.0, pytest.approx(-20.0, abs=0.1))
    said = asked(session, "tune.step", name="filters.0.width", across=1, up=0)
    assert said["values"]["filters.0.damping_pole"] == pytest.approx(0.6 * 1.02)
    assert said["undo"] == 2
    assert asked(session, "tune.undo")["values"]["filters.0.frequency"] == 350.0
    assert asked(session, "tune.undo")["values"]["filters.0.frequency"] == 460.0


def test_the_whole_loop_is_made_faster_as_one_drag(session: Session) -> None:
    said = asked(session, "tune.show")
    begun, crossover = said["values"], said["speed"]
    for i, share in enumerate((1.1, 1.3, 1.2)):
        said = asked(session, "tune.speed", value=share * crossover, first=i == 0)
    for name, power in {"law.Kv": 1.0, "law.Kp": 1.0, "law.Tn": -1.0}.items():
        assert said["values"][name] == pytest.approx(begun[name] * 1.2**power, rel=1e-6)
    assert said["speed"] == pytest.approx(1.2 * crossover, rel=0.05)  # behind filters and a spring not exactly
    assert said["undo"] == 1
    assert asked(session, "tune.undo")["values"] == begun
    assert "must be > 0 Hz" in asked(session, "tune.speed", value=0.0)["error"]


def test_a_pole_of_the_loop_is_dragged_and_keeps_its_name(session: Session) -> None:
    """The gains follow; a drag is one step to undo."""
    assert "poles" not in asked(session, "tune.show")  # nothing is computed for a picture that is not shown
    said = asked(session, "tune.see", names=["poles"])
    assert "law.Kv, law.Kp and law.Tn follow" in said["poles_said"]
    begun, pair = said["values"], next(each for each in said["poles"] if each["y"] > 0.0)
    for i, share in enumerate((1.0, 1.05, 1.1)):
        said = asked(session, "tune.pole", name=pair["name"], x=share * pair["x"], y=pair["y"], first=i == 0)
    now = next(each for each in said["poles"] if each["name"] == pair["name"])
    assert (now["x"], now["y"]) == (pytest.approx(1.1 * pair["x"], rel=1e-3), pytest.approx(pair["y"], rel=1e-3))
    assert {each["name"] for each in said["poles"]} == {f"loop.{i}" for i in range(4)}
    assert len({(each["x"], each["y"]) for each in said["poles"]}) == 4  # each name has its own pole
    assert said["undo"] == 1
    assert asked(session, "tune.undo")["values"] == begun
    assert "no pole 'loop.99'" in asked(session, "tune.pole", name="loop.99", x=-1.0, y=0.0)["error"]


def test_the_poles_that_a_law_places_are_dragged(session: Session) -> None:
    """Another law is a step to undo, and so is the drag."""
    session.desk.take(control_with(session.desk.needed.needed_loop(), "pole_placement"))
    asked(session, "tune.unit", kind="frequency", unit="rad/s")
    said = asked(session, "tune.see", names=["poles"])
    assert {each["name"] for each in said["poles"]} == {"law.bandwidth", "law.rigid_frequency", "law.axial_frequency"}
    said = asked(session, "tune.pole", name="law.bandwidth", x=-44.0, y=0.0)
    assert said["values"]["law.bandwidth"] == 44.0
    said = asked(session, "tune.pole", name="law.rigid_frequency", x=-44.0 * 0.6, y=2.0 * np.pi * 44.0 * 0.8)
    assert said["values"]["law.rigid_damping"] == pytest.approx(0.6)  # y is in the unit of the picture
    asked(session, "tune.undo")
    asked(session, "tune.undo")
    assert asked(session, "tune.undo")["values"] == session.desk.needed.before.values


def test_what_is_broken_stands_at_its_place_in_the_picture(session: Session) -> None:
    """Limits are those of the goal; the one that is broken most comes first."""
    for field, value in (("max_ms", "1.2"), ("phase_margin", "89"), ("max_compliance", "100")):
        asked(session, "optimize.set", field=field, value=value)
    said = asked(session, "tune.show")
    assert [each["keeps"] for each in said["judged"]] == [False, False, False]
    assert said["judged"][0]["text"].startswith("peak compliance")
    stiff = said["charts"]["stiffness"]["panels"][0]
    assert [each["text"] for each in stiff["levels"]] == ["at least 100 N/µm"]
    (note,) = stiff["notes"]
    look = session.rooms["tune"]._now  # pyright: ignore[reportPrivateUsage,reportAttributeAccessIssue]
    found = look.leading.stiffness
    assert (note["x"], note["y"]) == (
        pytest.approx(found.minimum_frequency),
        pytest.approx(1e-6 * found.minimum, rel=1e-3),
    )
    assert any("phase margin" in each["text"] for each in said["charts"]["open_loop"]["panels"][0]["notes"])
    assert f"{1e-6 * found.minimum:.4g} N/µm at {found.minimum_frequency:.4g} Hz" in said["figures"]


def test_snapshots_are_drawn_and_taken(session: Session) -> None:
    asked(session, "tune.move", name="law.Kv", value=90.0)
    said = asked(session, "tune.keep", letter="A")
    assert said["kept"] == ["A"]
    asked(session, "tune.reset")
    assert [c["name"] for c in asked(session, "tune.show")["charts"]["run"]["panels"][0]["curves"]] == [
        "today",
        "A",
        "now",
    ]
    assert asked(session, "tune.take", letter="A")["values"]["law.Kv"] == 90.0
    assert asked(session, "tune.drop", letter="A")["kept"] == []
    assert "nothing was kept as B" in asked(session, "tune.take", letter="B")["error"]


@pytest.mark.parametrize(
    ("request_", "reason"),
    [
        ({"do": "tune.move", "name": "law.Kv", "value": -1}, "must be > 0 1/s"),
        ({"do": "tune.move", "name": "law.Kv", "value": float("inf")}, "must be a finite number"),
        ({"do": "tune.move", "name": "law.Kv", "value": "10"}, "must be a number"),
        ({"do": "tune.move", "name": "law.Kv", "value": True}, "must be a number"),
        ({"do": "tune.move", "name": "law.__class__", "value": 1}, "has no number"),
        ({"do": "tune.keep", "letter": "Z"}, "one of A, B, C"),
        ({"do": "tune.add", "kind": "law"}, "one of low_pass"),
        ({"do": "tune.add", "kind": "notch", "at": 1e6}, "below half the sample rate"),
        ({"do": "tune.remove", "place": 2}, "no filters.2 to remove"),
        ({"do": "tune.remove", "place": 0.5}, "whole number"),
        ({"do": "compare.choose", "laws": ["this:X"]}, "compared by the command line alone"),
        ({"do": "compare.start", "starts": 0}, "Attempts"),
        ({"do": "answer"}, "none of import"),
    ],
)
def test_a_wrong_request_says_why_and_changes_nothing(session: Session, request_: dict[str, Any], reason: str) -> None:
    before = dict(session.desk.values)
    said = read(session.answer({"number": 3, **request_}))[0]
    assert reason in said["error"]
    assert said["number"] == 3
    assert session.desk.values == before
    assert not session.desk.undo


def test_pages_do_not_see_each_other(bench: Bench, tmp_path: Path) -> None:
    one, other = Session(tmp_path, bench), Session(tmp_path, bench)
    asked(one, "tune.move", name="law.Kv", value=150.0)
    asked(one, "tune.keep", letter="A")
    said = asked(other, "tune.show")
    assert said["values"] == bench.by_hand.values
    assert said["kept"] == []


def test_the_file_has_the_moved_number_and_all_else_as_it_was(session: Session, tmp_path: Path) -> None:
    asked(session, "tune.move", name="law.Kv", value=88.0)
    text = asked(session, "tune.file")["file"]
    machine = session.desk.needed.machine
    before = machine.file.text.splitlines()
    text, _, origins = text.partition("\n[[made_from]]\n")
    assert f'file = "{Path(machine.file.name).name}"' in origins
    changed = [(old, new) for old, new in zip(before, text.splitlines(), strict=True) if old != new]
    assert len(changed) == 1
    assert "88" in changed[0][1]
    (tmp_path / "tuned.toml").write_text(text, encoding="utf-8")
    assert fd.read_machine(tmp_path / "tuned.toml").loop(None).control.law.Kv == 88.0  # type: ignore[attr-defined]


def test_a_message_is_whole_numbers_and_all(session: Session) -> None:
    """Offsets are those of the numbers; what is not finite interrupts a line; over time peaks stay."""
    time = np.linspace(0.0, 1.0, 50_001)
    peak = np.where(np.arange(time.size) == 31_234, 7.0, 0.0)
    gap = np.linspace(0.0, 1.0, 5_000), np.linspace(1.0, 8.0, 5_000)
    gap[1][2_000:3_000] = np.inf
    chart = Chart("time (s)", (Panel("error (µm)", (Curve(time, peak, "long"), Curve(*gap, "broken"))),))
    said, numbers = read(message({"number": 1}, {"x": chart}))
    long, broken = said["charts"]["x"]["panels"][0]["curves"]
    assert long["n"] <= POINTS + 2
    assert np.max(numbers[long["at"] + long["n"] :][: long["n"]]) == 7.0
    x, y = (numbers[broken["at"] + k * broken["n"] :][: broken["n"]] for k in (0, 1))
    assert (x[0], y[0], x[-1], y[-1]) == (0.0, 1.0, 1.0, 8.0)
    assert np.flatnonzero(np.isnan(x)).size == 1  # one point stands for the gap
    assert broken["n"] <= POINTS + 3
    assert numbers.size == broken["at"] + 2 * broken["n"]


def test_a_band_goes_over_the_wire_with_both_ends_and_never_narrower() -> None:
    x = np.linspace(0.0, 1.0, 30_001)
    spike = np.where(np.arange(x.size) == 12_345, 5.0, 1.0)
    gap = np.array([0.0, 1.0, np.nan, 2.0, 3.0])
    chart = Chart("time (s)", (Panel("y", bands=(Band(x, -spike, spike, 2, "wide"), Band(gap, gap, gap + 1.0))),))
    said, numbers = read(message({"number": 1}, {"x": chart}))
    wide, broken = said["charts"]["x"]["panels"][0]["bands"]
    assert (wide["name"], wide["number"]) == ("wide", 2)
    across, low, high = (numbers[wide["at"] + k * wide["n"] :][: wide["n"]] for k in range(3))
    assert wide["n"] <= POINTS
    assert (across[0], across[-1]) == (0.0, 1.0)
    assert (low.min(), high.max()) == (-5.0, 5.0)
    assert np.all(np.diff(across) > 0.0)
    rows = [numbers[broken["at"] + k * broken["n"] :][: broken["n"]] for k in range(3)]
    np.testing.assert_array_equal(rows, [gap, gap, gap + 1.0])


def test_a_part_of_a_curve_that_is_looked_at_has_its_own_points(session: Session) -> None:
    time = np.linspace(0.0, 1.0, 50_001)
    chart = Chart("time (s)", (Panel("error (µm)", (Curve(time, np.sin(3e4 * time)),)),))
    said, numbers = read(message({"number": 1}, {"x": chart}, {"time (s)": (0.5, 0.51)}))
    (curve,) = said["charts"]["x"]["panels"][0]["curves"]
    x, y = (numbers[curve["at"] + k * curve["n"] :][: curve["n"]] for k in (0, 1))
    there = (time >= 0.5 - 1.5 / 50_000) & (time <= 0.51 + 0.5 / 50_000)  # every sample, and one more before
    np.testing.assert_array_equal(x, time[there].astype(np.float32))
    np.testing.assert_array_equal(y, np.sin(3e4 * time[there]).astype(np.float32))


def test_a_window_of_the_page_holds_until_all_is_shown(session: Session) -> None:
    def window(shows: str = "tune", **given: Any) -> dict[str, Any]:
        return asked(session, "view.window", label="time (s)", shows=shows, **given)

    def reach(said: bytes) -> tuple[float, float]:
        found, numbers = read(said)
        curve = found["charts"]["run"]["panels"][0]["curves"][0]
        x = numbers[curve["at"] :][: curve["n"]]
        return float(x[0]), float(x[-1])

    show = {"number": 1, "do": "tune.show"}
    whole = reach(session.answer(show))
    assert "error" not in window(low=0.2, high=0.3)
    low, high = reach(session.answer(show))
    step = session.desk.needed.needed_loop().sample_time + 1e-7  # and 32-bit floats
    assert 0.2 - step <= low <= 0.2 + 1e-7
    assert 0.3 - 1e-7 <= high <= 0.3 + step
    assert "from low to high, not from 0.3 to 0.2" in window(low=0.3, high=0.2)["error"]
    window(low=None, high=None)
    assert reach(session.answer(show)) == whole
    window("scope", low=0.2, high=0.3)
    assert reach(session.answer(show)) == whole  # each room for itself
    window(low=0.2, high=0.3)
    window("scope", low=None, high=None)
    assert reach(session.answer(show)) == (low, high)
    asked(session, "import.bundled", name="ball_screw")
    assert reach(session.answer(show)) == whole  # all of another source


def test_knobs_are_in_the_units_that_people_read(session: Session) -> None:
    found = {each["name"]: each for each in asked(session, "tune.show")["knobs"]}
    assert found["law.Tn"]["unit"] == "ms"
    assert found["law.Tn"]["factor"] == 1e3
    assert [name for name, each in found.items() if each["dragged"]] == ["filters.0.frequency", "filters.1.frequency"]


def test_what_is_missing_is_named_as_the_field_of_the_page_is(tmp_path: Path) -> None:
    frequency = np.geomspace(1.0, 500.0, 200)
    response = 1.0 / (100.0 * (2j * np.pi * frequency) ** 2)
    rows = "\n".join(f"{f},{h.real},{h.imag}" for f, h in zip(frequency, response, strict=True))
    (tmp_path / "brought").mkdir()
    (tmp_path / "brought" / "axis.csv").write_text(f"frequency_Hz,load_re,load_im\n{rows}\n", encoding="utf-8")
    session = Session(tmp_path)
    session.desk.files["axis.csv"] = tmp_path / "brought" / "axis.csv"
    ended = threading.Event()
    session.listen(lambda _, said: ended.set() if read(said)[0].get("files") else None)
    session.answer({"number": 1, "do": "import.look", "names": ["axis.csv"]})
    assert ended.wait(30.0)
    said = asked(session, "import.responses", name="axis.csv")
    assert said["error"].startswith("axis.csv: does not say with which sample time")
    assert "give it with 'Sampling rate', or today's machine with 'Today's machine'" in said["error"]
    words = "".join(each.read_text(encoding="utf-8") for each in (ROOT / "page" / "src" / "rooms").glob("*.ts"))
    shown = {each["label"] for each in asked(session, "optimize.show")["fields"]}
    assert [each for each in FIELDS.values() if f'"{each}' not in words and each not in shown] == []


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("filters.0.frequency", 15_000.0, "must be below half the sample rate, 10000 Hz"),
        ("law.Kp", 1e300, "no finite response"),
        ("law.Tn", 1e-300, "no finite response"),
        ("filters.1.damping", 1e-300, "cannot be computed with these numbers"),
    ],
)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_numbers_that_cannot_be_computed_leave_those_of_before(
    session: Session, name: str, value: float, reason: str
) -> None:
    before = asked(session, "tune.move", name="law.Kv", value=90.0)
    assert reason in asked(session, "tune.move", name=name, value=value)["error"]
    after = asked(session, "tune.show")
    assert "error" not in after
    assert (after["values"], after["undo"], after["judged"]) == (before["values"], before["undo"], before["judged"])


def test_a_control_keeps_its_color_whatever_else_is_shown(session: Session) -> None:
    def numbers(chart: str) -> dict[str, int]:
        panels = asked(session, "tune.show")["charts"][chart]["panels"]
        return {each["name"]: each["number"] for panel in panels for each in panel["curves"] if each["name"]}

    asked(session, "tune.move", name="law.Kv", value=90.0)
    before = {chart: numbers(chart) for chart in ("open_loop", "nyquist", "stiffness", "run")}
    asked(session, "tune.keep", letter="B")
    asked(session, "tune.keep", letter="A")
    for chart, known in before.items():
        assert known == {"today": 100, "now": 101}
        assert numbers(chart) == {"today": 100, "A": 102, "B": 103, "now": 101}
    asked(session, "tune.move", name="law.Kp", value=2e6)  # not stable: it has no stiffness
    assert numbers("stiffness") == {"today": 100, "A": 102, "B": 103}

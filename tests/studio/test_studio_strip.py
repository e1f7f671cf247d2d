"""The strip of figures, the verdict, the history and the filters that are off, beside figures of the library."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.analysis.loop_model import loop_model
from feeddrive.figures.of_loops import COMPLIANCE_PEAK
from feeddrive.language.errors import ParameterError
from feeddrive.plot.chart import BAR, DEGREES
from feeddrive.plot.over_frequency import open_loop_chart
from feeddrive.studio.bench import Bench, bench_of
from feeddrive.studio.desk import Asked, Desk
from feeddrive.studio.pictures import wrapped
from feeddrive.studio.rooms.tune import Tune
from feeddrive.tuning.criteria import Limits
from feeddrive.tuning.filters import filter_response

_DIGITS = 6e-3  # half a unit of the third digit, which is the last one shown


@pytest.fixture(scope="module")
def bench() -> Bench:
    return bench_of("ball_screw")


@pytest.fixture
def room(bench: Bench, tmp_path: Path) -> Tune:
    desk = Desk(tmp_path)
    desk.put(bench)
    return Tune(desk)


def ask(room: Tune, act: str, **asked: Any) -> dict[str, Any]:
    return dict(room.do(act, Asked(asked)).words)


def gauges(words: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {each["title"]: each for each in words["strip"]}


def test_the_strip_has_the_figures_of_the_loop(room: Tune) -> None:
    words = ask(room, "move", name="law.Kp", value=81000.0)
    loop = fd.vary(fd.read_machine("ball_screw").loop("x"), {"axis.x.control.law.Kp": 81000.0})
    margins, shown = fd.analysis.margins(loop), gauges(words)
    stiff = fd.analysis.stiffness(
        loop_model(loop).closed.response(np.geomspace(1.0, 9000.0, 40_000), "position_load", "load_force")
    )
    expected = {
        "Ms": margins.sensitivity_peak,
        "Phase margin": margins.phase_margin_deg,
        "Gain margin": margins.gain_increase_dB,
        "Delay margin": margins.delay_margin_samples,
        "Crossover": margins.crossover,
        "Least stiffness": 1e-6 * stiff.minimum,
    }
    for title, value in expected.items():
        assert float(shown[title]["value"]) == pytest.approx(value, rel=_DIGITS), title
    today = fd.analysis.margins(fd.read_machine("ball_screw").loop("x"))
    assert float(shown["Ms"]["today"]) == pytest.approx(today.sensitivity_peak, rel=_DIGITS)


@pytest.mark.parametrize(("factor", "state"), [(1.2, "kept"), (1.02, "close"), (0.9, "broken")])
def test_a_limit_is_kept_nearly_used_up_or_broken(room: Tune, factor: float, state: str) -> None:
    peak = float(gauges(ask(room, "show"))["Ms"]["value"])
    room.desk.limits = Limits(sensitivity_peak=factor * peak)
    shown = gauges(ask(room, "show"))
    assert shown["Ms"]["state"] == state
    assert shown["Ms"]["used"] == pytest.approx(min(1.0 / factor, 1.0), rel=_DIGITS)
    assert shown["Phase margin"]["state"] == "free"
    assert shown["Phase margin"]["limit"] == ""


def test_the_verdict_says_which_limit_decides(room: Tune) -> None:
    room.desk.limits = Limits(sensitivity_peak=2.5)
    words = ask(room, "show")
    assert (words["headline"], words["sentence"]) == ("All limits kept", "Ms is 1.95 at 88.7 Hz, at most 2.5.")
    room.desk.limits = Limits(sensitivity_peak=1.5, phase_margin_deg=60.0, gain_margin_dB=3.0)
    words = ask(room, "show")
    assert words["headline"] == "Not yet: two limits are broken"
    words = ask(room, "move", name="law.Kp", value=2e6)
    assert words["headline"] == "Not stable"
    assert all(each["value"] == "–" for each in words["strip"])
    assert gauges(words)["Ms"]["state"] == "broken"


def test_the_crossover_that_is_offered_keeps_all_limits_and_is_the_highest(room: Tune) -> None:
    room.desk.limits = Limits(sensitivity_peak=1.7, phase_margin_deg=36.0)
    ask(room, "move", name="law.Kp", value=95000.0)
    found = ask(room, "remedy")["remedy"]
    words = ask(room, "speed", value=found["crossover"], first=True)
    assert words["headline"] == "All limits kept"
    assert ask(room, "remedy")["remedy"] is None
    ask(room, "undo")
    # one step of the search higher, 10.07 %, and rounded to three digits
    assert ask(room, "speed", value=1.105 * found["crossover"], first=True)["headline"].startswith("Not yet")


def test_the_history_says_each_step_and_leads_back(room: Tune) -> None:
    ask(room, "move", name="law.Kv", value=120.0)
    ask(room, "move", name="law.Kp", value=76000.0)
    words = ask(room, "add", kind="notch", at=250.0)
    texts = [each["text"] for each in words["history"]]
    assert texts == ["notch 250 Hz added", "Kp 68000 → 76000 N s/m", "Kv 100 → 120 1/s", "Beginning"]
    assert [each["steps"] for each in words["history"]] == [0, 1, 2, 3]
    words = ask(room, "go", steps=2)
    assert words["values"]["law.Kp"] == 68000.0
    assert words["values"]["law.Kv"] == 120.0
    assert [each["steps"] for each in words["history"]] == [-2, -1, 0, 1]
    words = ask(room, "go", steps=-2)
    assert [each["text"] for each in words["history"]] == texts
    with pytest.raises(fd.FeeddriveError, match="whole number"):
        ask(room, "go", steps=0.5)
    with pytest.raises(fd.FeeddriveError, match="from -200 to 200"):
        ask(room, "go", steps=201)
    assert ask(room, "go", steps=200)["history"][-1] == {"text": "Beginning", "steps": 0}


def test_the_history_shows_the_last_twelve_steps(room: Tune) -> None:
    for k in range(14):
        ask(room, "move", name="law.Kv", value=101.0 + k)
    words = ask(room, "show")
    assert [each["steps"] for each in words["history"]] == list(range(12))
    assert words["history"][-1]["text"] == "Kv 102 → 103 1/s"
    assert [each["steps"] for each in ask(room, "go", steps=13)["history"]] == [*range(-12, 0), 0, 1]


def test_a_filter_that_is_off_keeps_its_numbers_and_comes_back(room: Tune) -> None:
    begun = ask(room, "show")
    notch = {name: value for name, value in begun["values"].items() if name.startswith("filters.0.")}
    words = ask(room, "switch", place=0, on=False)
    assert words["off"] == ["notch 460 Hz"]
    assert len(room.desk.control.filters) == len(room.desk.needed.before.start.filters) - 1
    assert words["history"][0]["text"] == "notch 460 Hz off"
    words = ask(room, "switch", place=0, on=True)
    assert words["off"] == []
    last = len(room.desk.control.filters) - 1
    assert {
        name.replace(f"filters.{last}.", "filters.0."): value
        for name, value in words["values"].items()
        if name.startswith(f"filters.{last}.")
    } == notch
    # filters in another order: the same loop but for rounding
    assert float(gauges(words)["Ms"]["value"]) == float(gauges(begun)["Ms"]["value"])
    ask(room, "switch", place=0, on=False)
    assert ask(room, "forget", place=0)["off"] == []
    assert ask(room, "undo")["off"] != []
    with pytest.raises(fd.FeeddriveError, match="no filter 8 that is on"):
        ask(room, "switch", place=7, on=False)


def test_the_phase_is_drawn_around_the_half_turn(bench: Bench) -> None:
    margins = fd.analysis.margins(fd.read_machine("ball_screw").loop("x"))
    before, after = open_loop_chart(margins), wrapped(open_loop_chart(margins))
    whole, drawn = (next(panel for panel in chart.panels if panel.scale == DEGREES) for chart in (before, after))
    assert min(float(np.min(curve.y)) for curve in whole.curves) < -360.0  # dead time
    assert (drawn.low, drawn.high) == (-270.0, -90.0)
    for one, two in zip(whole.curves, drawn.curves, strict=True):
        there = np.isfinite(two.y)
        assert np.all((two.y[there] >= -360.0) & (two.y[there] <= 0.0))
        if one.look == BAR:
            assert np.ptp(two.y) == pytest.approx(np.ptp(one.y), abs=1e-9)
        else:
            turns = (two.y[there] - one.y) / 360.0
            np.testing.assert_allclose(turns, np.round(turns), atol=1e-9)
            # it is interrupted wherever it passes from -360 to 0 degrees, and only there
            assert np.count_nonzero(~there) == np.count_nonzero(np.diff(turns) != 0.0) > 0


def test_a_notch_is_set_by_depth_and_width(room: Tune) -> None:
    """The two stand for its dampings: each keeps the other, and they read as they were written."""
    where, T = 164.0, fd.read_machine("ball_screw").loop("x").sample_time
    ask(room, "add", kind="notch", at=where)
    place = len(room.desk.control.filters) - 1
    names = [f"filters.{place}.{part}" for part in ("depth", "width")]
    words = ask(room, "show")
    rows = {each["name"]: each for each in words["knobs"]}
    assert [rows[name]["unit"] for name in names] == ["dB", "Hz"]
    assert [rows[f"filters.{place}.{each}"]["exact"] for each in ("frequency", "damping_zero", "damping_pole")] == [
        False,
        True,
        True,
    ]
    ask(room, "move", name=names[1], value=8.0)
    words = ask(room, "move", name=names[0], value=46.0)
    assert [words["shapes"][name] for name in names] == [46.0, 8.0]
    assert words["history"][0]["text"].endswith("→ 46 dB")
    # |H| at the center is the depth, and -3 dB lie 8 Hz apart
    notch = room.desk.control.filters[place]
    f = np.linspace(where - 20.0, where + 20.0, 40_001)
    gain = np.abs(filter_response(notch, f, T))
    assert -20.0 * np.log10(np.min(gain)) == pytest.approx(46.0, abs=0.05)  # dB; between two lines it is deeper
    below = f[gain < np.sqrt(0.5)]
    # sampling changes it by about (π f T)², the lines by 2 mHz
    assert below[-1] - below[0] == pytest.approx(8.0, rel=(np.pi * where * T) ** 2, abs=2e-3)
    ask(room, "move", name=f"filters.{place}.damping_zero", value=0.0)
    assert ask(room, "move", name=names[1], value=9.0)["shapes"][names[0]] == 120.0  # as deep as is said
    assert room.desk.control.filters[place].damping_zero == 0.0  # type: ignore[attr-defined]
    assert ask(room, "move", name=names[0], value=300.0)["shapes"][names[0]] == 60.0
    with pytest.raises(ParameterError, match=r"no number 'filters\.99\.depth'"):
        ask(room, "move", name="filters.99.depth", value=3.0)


def test_a_filter_that_is_off_is_moved_by_its_grip(room: Tune) -> None:
    """It stands where the loop would go through with it, keeps its numbers, and moves nothing else."""
    ask(room, "add", kind="notch", at=150.0)
    on = {each["name"].partition(".")[2].partition(".")[2]: each for each in ask(room, "show")["grips"][-2:]}
    place = len(room.desk.control.filters) - 1
    words = ask(room, "switch", place=place, on=False)
    before, notch = words["judged"], room.desk.off[0]
    off = {each["name"]: each for each in words["grips"] if each["name"].startswith("off.")}
    assert sorted(off) == ["off.0.frequency", "off.0.width"]
    # the same place as with the filter on, but for the lines between which its narrow bottom is interpolated
    assert off["off.0.frequency"]["y"] == pytest.approx(on["frequency"]["y"], abs=0.3)  # dB
    ask(room, "drag", name="off.0.frequency", x=180.0, y=None, first=True)
    words = ask(room, "drag", name="off.0.frequency", x=200.0, y=off["off.0.frequency"]["y"] - 6.0, first=False)
    assert words["judged"] == before
    moved = room.desk.off[0]
    assert (moved.frequency, moved.damping_pole) == (200.0, notch.damping_pole)  # type: ignore[attr-defined]
    grip = next(each for each in words["grips"] if each["name"] == "off.0.frequency")
    assert grip["y"] == pytest.approx(off["off.0.frequency"]["y"] - 6.0, abs=1e-2)  # dB, of 4 digits
    assert words["history"][0]["text"] == "notch 150 Hz → notch 200 Hz, off"
    words = ask(room, "step", name="off.0.width", across=1, up=0)
    assert room.desk.off[0].damping_pole == pytest.approx(1.02 * notch.damping_pole, rel=5e-4)  # type: ignore[attr-defined]
    ask(room, "undo")
    ask(room, "undo")  # the drag as a whole
    assert room.desk.off == (notch,)


def test_a_limit_is_set_in_the_unit_that_is_shown_and_by_its_line(room: Tune) -> None:
    """The server knows which setting of the goal it is: the page names the figure alone."""
    ask(room, "unit", kind="length", unit="nm")
    words = ask(room, "limit", figure="stiffness_least_N_per_m", value="0,004")
    shown = gauges(words)["Least stiffness"]
    assert (shown["unit"], shown["bound"]) == ("N/nm", "0.004")
    # 4 N/µm: 2.5e-7 m/N
    assert room.desk.goal["max_compliance"] == pytest.approx(2.5e-7)
    assert room.desk.limits.bound(COMPLIANCE_PEAK) == pytest.approx(2.5e-7)
    line = next(each for each in words["levels"] if each["picture"] == "stiffness")
    assert (line["at"], line["text"]) == (pytest.approx(0.004), "least stiffness at least 0.004 N/nm")
    words = ask(room, "limit", figure=line["field"], height=0.005)
    assert gauges(words)["Least stiffness"]["bound"] == "0.005"
    words = ask(room, "limit", figure="sensitivity_peak", height=20.0 * np.log10(1.8))
    assert room.desk.goal["max_ms"] == 1.8
    assert words["levels"][0]["at"] == pytest.approx(20.0 * np.log10(1.8))  # dB
    ask(room, "limit", figure="sensitivity_peak", height=-1e9)
    assert room.desk.goal["max_ms"] == 1.02  # the least that is dragged
    for figure, value, why in (
        ("stiffness_least_N_per_m", "0", "Least stiffness must be > 0"),
        ("phase_margin_deg", "much", "the limit of Phase margin must be a number, not 'much'"),
        ("crossover_Hz", "80", "figure must be one of"),
    ):
        with pytest.raises(ParameterError, match=why):
            ask(room, "limit", figure=figure, value=value)
    words = ask(room, "limit", figure="stiffness_least_N_per_m", value="")
    assert "max_compliance" not in room.desk.goal
    assert [each["picture"] for each in words["levels"]] == ["sensitivity"]

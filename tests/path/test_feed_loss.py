"""Where and why the feed falls: programs with one known cause each, and the sum against the time at the feed."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.path.feed_loss import (
    END,
    LISTED,
    ON_LINE,
    OVERRIDE,
    SHAPES,
    START,
    VELOCITY,
    WITHIN,
    CauseOfLoss,
    Fall,
    FeedLoss,
    FeedLossRecorder,
)
from feeddrive.path.limits import AxisLimits, MachineLimits
from feeddrive.path.motion import ARC, PACED
from feeddrive.path.planned import Planned, planned_of
from feeddrive.path.program.moves import Move
from feeddrive.path.program.reading import read_program
from feeddrive.path.schedule.override import override
from feeddrive.path.setpoints import Setpoints
from feeddrive.workflow.plan import PlanRequest, plan

AXIS = AxisLimits(velocity=0.5, acceleration=5.0, jerk=100.0, snap=5e4)
LIMITS = MachineLimits({"X": AXIS, "Y": AXIS, "Z": AXIS})
T = 1e-3


@pytest.fixture
def no_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the page, whose pictures have a test of their own."""
    monkeypatch.setattr(sys.modules["feeddrive.workflow.plan"], "html", lambda _: "")


def planned(folder: Path, text: str, steps: list[tuple[float, float]] | None = None) -> Planned:
    path = folder / "part.ngc"
    path.write_text(text, encoding="utf-8")
    return of(read_program(path), steps)


def of(moves: Iterator[Move], steps: list[tuple[float, float]] | None = None) -> Planned:
    setpoints = Setpoints(moves, LIMITS, T, None if steps is None else override(steps))
    return planned_of(setpoints, "part.ngc", "")


def lost(plan: Planned) -> dict[str, float]:
    """Time lost by cause, s."""
    found: dict[str, float] = {}
    for row in plan.loss.causes:
        found[row.cause] = found.get(row.cause, 0.0) + row.lost
    return found


def test_an_axis_at_its_largest_velocity_is_the_cause_also_where_the_program_ends() -> None:
    """X turns at its largest velocity for 1 s while the tip swings about, then all stops within 50 ms."""
    recorder = FeedLossRecorder(
        np.array([[0.5, 5.0, 100.0, 5e4]] * 2), [f"{name} of {axis}" for axis in "XY" for name in "vajs"], T
    )
    time = T * np.arange(1050)
    fading = np.clip((1.05 - time) / 0.05, 0.0, 1.0)
    values = np.zeros((len(time), 2, 5))
    values[:, 0, 1] = 0.5 * fading
    values[:, 1, 1], values[:, 1, 2] = 0.05 * np.sin(60.0 * time), 3.0 * np.cos(60.0 * time)
    tip = 0.05 * fading + 1e-6
    shape = np.full(len(time), PACED)
    recorder.add(values, np.full(len(time), 0.1), np.ones(len(time)), shape, 1.0, tip)
    causes = recorder.result().causes
    assert causes[0].name == f"{VELOCITY} (v of X)"
    assert causes[0].lost == pytest.approx(0.5, abs=0.05)  # half of 1 s, and the stop


def test_a_line_loses_what_its_two_ramps_take(tmp_path: Path) -> None:
    """From rest to F in 2 t, on the way F t: t is lost at either end.  At F = 0.1 m/s without reaching the
    acceleration limit: F = j a² of two phases of length a, a = (F/j)^(1/2), and the snap limit adds j/s.
    """
    found = planned(tmp_path, "F6000\nG1 X100\nM2\n")
    ramp = 2.0 * math.sqrt(0.1 / 100.0) / 2.0
    causes = lost(found)
    assert causes[START] == pytest.approx(ramp, abs=3e-3)
    assert causes[END] == pytest.approx(ramp, abs=3e-3)
    assert set(causes) == {START, END, WITHIN}
    assert {row.limit for row in found.loss.causes[:2]} == {"jerk of X"}
    # against the feed-only time of the programmed way, which is driven as it is
    assert found.loss.lost == pytest.approx(found.cycle_time - 0.1 / 0.1, abs=2.0 * T)
    first, last = found.loss.falls
    assert (first.first, last.last) == (2, 2)
    # the ramp without its last (0.1 F/j)^(1/2), in which less than 5 % are missing
    assert first.length == pytest.approx(0.1 * ramp - 0.1 * math.sqrt(0.1 * 0.1 / 100.0), abs=1.5e-4)


@pytest.mark.parametrize(
    ("text", "cause", "limit"),
    [
        # v = (a R)^(1/2) = 0.32 m/s of 0.5: the acceleration, of X and Y in turn
        ("F30000\nG3 X0 Y0 I20 J0 P2\nM2\n", "curvature of an arc", ""),
        # R 1 mm: (j R²)^(1/3) = 0.046 m/s below (a R)^(1/2) = 0.07
        ("F18000\nG3 X0 Y0 I1 J0\nG3 X0 Y0 I1 J0\nM2\n", "curvature of an arc", "jerk of "),
        ("F60000\nG1 X200\nM2\n", VELOCITY, "velocity of X"),
        ("G61 F6000\nG1 X50\nY50\nM2\n", "corner, exact path (G61)", "jerk of "),
        ("G61.1 F6000\nG1 X50\nY50\nM2\n", "exact stop (G61.1)", "jerk of "),
        ("G64 F6000\nG1 X50\nY50\nM2\n", "corner, no tolerance (G64 without P)", "jerk of "),
        ("G64 P0.05 F6000\nG1 X50\nX100 Y50\nM2\n", "corner within the tolerance", ""),
        ("G64 P.1 F12000\nG1 X30\nX30.5 Y.2\nX31 Y.6\nX31.3 Y1.2\nX40 Y40\nM2\n", "bend within the tolerance", ""),
        ("F6000\nG1 X50\nG4 P0.3\nX100\nM2\n", "dwell (G4)", "jerk of X"),
        ("F6000\nG1 X50\nM0\nX100\nM2\n", "program stop (M0, M1, M60)", "jerk of X"),
    ],
)
def test_a_known_cause_is_found(text: str, cause: str, limit: str, tmp_path: Path) -> None:
    found = planned(tmp_path, text)
    causes = lost(found)
    assert set(causes) == {START, END, WITHIN, cause}
    assert causes[cause] > 0.01
    assert all(row.limit.startswith(limit) for row in found.loss.causes if row.cause == cause)


def test_an_arc_is_the_cause_as_far_as_its_speed_is_even(tmp_path: Path) -> None:
    """A full circle of 20 mm from stop to stop: the plateau at (a R)^(1/2) is lost to the arc, ramps to the stops."""
    found = planned(tmp_path, "G61 F60000\nG1 X100\nG3 X100 Y0 I-20 J0\nG1 X0\nM2\n")
    causes = lost(found)
    speed = math.sqrt(5.0 * 0.02)
    around = [fall for fall in found.loss.falls if fall.cause == "curvature of an arc"]
    way = sum(fall.length for fall in around)
    assert 0.3 * 2.0 * math.pi * 0.02 < way < 2.0 * math.pi * 0.02
    assert causes["curvature of an arc"] == pytest.approx(way / speed - way, rel=0.05)
    assert {(fall.first, fall.last) for fall in around} == {(3, 3)}


def test_where_runs_overlap_each_counts_with_its_own_feed(tmp_path: Path) -> None:
    """From 6 mm/s into 300 mm/s around a corner; the corner is rounded by less than 0.1 mm, 15 ms at 6 mm/s."""
    found = planned(tmp_path, "G64 P0.05 F360\nG1 X5\nF18000\nG1 X5 Y60\nM2\n")
    assert found.loss.lost == pytest.approx(found.cycle_time - 5.0 / 6.0 - 60.0 / 300.0, abs=0.02)


def test_a_feed_beyond_all_limits_has_a_fall_for_each_corner(tmp_path: Path) -> None:
    """Behind a traverse, which is at its feed: of 17 m/s the corners are at less than a hundredth."""
    corners = "".join(f"X{50 + 20 * k} Y{20 * (k % 2)}\n" for k in range(1, 7))
    found = planned(tmp_path, f"G64 P0.1 F1000000\nG0 X50\nG1\n{corners}M2\n")
    assert found.loss.fall_count >= 8
    assert all(fall.duration < 0.4 for fall in found.loss.falls)


def test_override_and_hold_are_causes(tmp_path: Path) -> None:
    """Half of the feed from 0.5 s to 1 s costs 0.25 s, and a hold of 0.2 s more than that."""
    found = planned(tmp_path, "F6000\nG1 X300\nM2\n", [(0.5, 0.5), (1.0, 1.0), (2.0, 0.0), (2.2, 1.0)])
    causes = lost(found)
    assert set(causes) == {START, END, WITHIN, OVERRIDE, "feed hold"}
    assert causes[OVERRIDE] == pytest.approx(0.25, abs=0.05)
    assert causes["feed hold"] == pytest.approx(0.2, abs=0.08)
    assert found.loss.lost == pytest.approx(found.cycle_time - 3.0, abs=3.0 * T)


def drawn(draw: np.random.Generator) -> tuple[str, float]:
    """Fifteen lines and arcs at feeds of 20 to 300 mm/s, within nothing to 20 um; the time at the feed, s."""
    words, seconds, x, y, heading = ["G64 P0.02" if draw.random() < 0.5 else "G61"], 0.0, 0.0, 0.0, 0.0
    for _ in range(15):
        feed, length = draw.uniform(20.0, 300.0), draw.uniform(2.0, 20.0)
        heading += draw.normal()
        x1, y1 = round(x + length * math.cos(heading), 4), round(y + length * math.sin(heading), 4)
        if draw.random() < 0.3:
            # half a circle
            words.append(f"G3 X{x1} Y{y1} I{(x1 - x) / 2:.5f} J{(y1 - y) / 2:.5f} F{60.0 * feed:.3f}")
            seconds += 0.5 * math.pi * math.hypot(x1 - x, y1 - y) / feed
        else:
            words.append(f"G1 X{x1} Y{y1} F{60.0 * feed:.3f}")
            seconds += math.hypot(x1 - x, y1 - y) / feed
        x, y = x1, y1
    return "\n".join([*words, "M2", ""]), seconds


@pytest.mark.parametrize("seed", range(8))
def test_causes_sum_to_the_time_lost_against_the_feed(seed: int, tmp_path: Path) -> None:
    """Against lengths over feeds as written: within a sample for each move, since corners cut less than 0.1 mm off."""
    text, at_feed = drawn(np.random.default_rng(seed))
    found = planned(tmp_path, text)
    loss = found.loss
    assert loss.lost == pytest.approx(found.cycle_time - at_feed, abs=15 * T)
    assert sum(row.lost for row in loss.causes) == loss.lost
    assert loss.fall_count == len(loss.falls) <= LISTED
    assert sum(row.lost for row in loss.causes[:-1]) == pytest.approx(sum(fall.lost for fall in loss.falls))
    # falls do not overlap, and every one of them is a fall
    ends = [fall.time + fall.duration for fall in loss.falls]
    assert all(b.time >= a - 1e-9 for a, b in zip(ends, loss.falls[1:], strict=False))
    assert all(fall.slowest < 0.95 * fall.feed or fall.feed == 0.0 for fall in loss.falls)


Rows = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def rows(count: int, speed: np.ndarray) -> Rows:
    values = np.zeros((count, 1, 5))
    values[:, 0, 1] = speed
    return values, np.ones(count), np.ones(count, np.int64), np.zeros(count, np.int64)


def recorder() -> FeedLossRecorder:
    names = ("velocity of X", "acceleration of X", "jerk of X", "snap of X")
    return FeedLossRecorder(np.array([[2.0, 5.0, 100.0, 5e4]]), names, T)


@pytest.mark.parametrize(("rise", "falls"), [(0.08, 1), (0.12, 2)])
def test_a_rise_of_a_tenth_separates_two_falls(rise: float, falls: int) -> None:
    """Of the highest level, which is that of the first sample, 0.9."""
    found = recorder()
    speed = np.concatenate(
        [np.linspace(0.9, 0.3, 50), np.linspace(0.3, 0.3 + 0.9 * rise, 50), np.linspace(0.3, 1.0, 50)]
    )
    found.add(*rows(150, speed))
    assert found.result().fall_count == falls


@pytest.mark.parametrize(("speed", "falls"), [(0.96, 0), (0.94, 1)])
def test_a_fall_is_5_percent_below_the_feed(speed: float, falls: int) -> None:
    found = recorder()
    found.add(*rows(100, np.concatenate([np.ones(50), np.full(50, speed)])))
    assert found.result().fall_count == falls


def held(level: np.ndarray, use: float = 0.9, arc: slice | None = None) -> tuple[str, str]:
    """Cause and limit of a fall with these speeds, m/s, between two stretches at the feed of 1 m/s."""
    found = recorder()
    found.add(*rows(5000, np.ones(5000)))
    values, feed, line, shape = rows(len(level), level)
    values[:, 0, 2] = 5.0 * use
    if arc is not None:
        shape[arc] = ARC
    found.add(values, feed, line, shape)
    found.add(*rows(5000, np.ones(5000)))
    (fall,) = found.result().falls
    return fall.cause, fall.limit


@pytest.mark.parametrize(("use", "limit"), [(0.4, "no limit above half"), (0.6, "acceleration of X")])
def test_a_limit_is_named_from_a_half_on(use: float, limit: str) -> None:
    assert held(np.full(50, 0.5), use)[1] == limit


@pytest.mark.parametrize(("above", "cause"), [(1.05, SHAPES[ARC]), (1.15, ON_LINE)])
def test_the_place_of_a_cause_is_within_a_tenth_of_the_lowest_speed(above: float, cause: str) -> None:
    level = np.full(50, 0.5)
    level[:5] *= above
    assert held(level, arc=slice(0, 5))[0] == cause


@pytest.mark.parametrize(
    ("slow", "share", "cause"),
    [(0.97, 1.0, ON_LINE), (0.99, 1.0, VELOCITY), (0.99, 0.4, ON_LINE), (0.99, 0.6, VELOCITY)],
)
def test_a_velocity_limit_holds_what_is_mostly_at_98_percent_of_it(slow: float, share: float, cause: str) -> None:
    """The feed is five times the velocity limit of 2 m/s."""
    level = np.full(100, 0.93)
    level[: round(100 * share)] = slow
    found = recorder()
    values, _, line, shape = rows(100, 2.0 * level)
    found.add(np.zeros((1, 1, 5)), np.ones(1), line[:1], shape[:1])
    found.add(*rows(5000, np.ones(5000)))
    found.add(values, np.full(100, 10.0), line, shape)
    found.add(*rows(5000, np.ones(5000)))
    (fall,) = [fall for fall in found.result().falls if fall.feed == 10.0]
    assert fall.cause == cause


@pytest.mark.parametrize(("share", "apart"), [(0.07, True), (0.15, False)])
def test_a_plateau_has_less_than_a_tenth_of_the_acceleration(share: float, apart: bool) -> None:
    """From rest by a ramp to 0.6 of the feed, which an arc holds."""
    speed = np.concatenate([np.linspace(0.0, 0.6, 100), np.full(200, 0.6), np.ones(100)])
    values, feed, line, shape = rows(400, speed)
    values[:100, 0, 2] = 5.0
    values[100:300, 0, 2] = 5.0 * share
    shape[100:300] = ARC
    found = recorder()
    found.add(values, feed, line, shape)
    causes = [fall.cause for fall in found.result().falls]
    assert causes == ([START, SHAPES[ARC]] if apart else [START])


def test_five_causes_are_told() -> None:
    causes = tuple(CauseOfLoss(f"cause {k}", "", 1, 1.0, 1.0) for k in range(8))
    (told,) = FeedLoss(8.0, causes, 8, (), np.zeros(1), np.zeros(1), (WITHIN,)).sentences(10.0)
    assert "cause 4" in told
    assert "cause 5" not in told


def test_samples_in_pieces_give_the_same_falls() -> None:
    """Cut at any place: 20,000 samples of a wandering speed, with stops among them."""
    draw = np.random.default_rng(5)
    speed = np.interp(np.arange(20_000), np.arange(0, 20_001, 50), draw.uniform(0.0, 1.1, 401))

    def fell(cuts: list[int]) -> tuple[Fall, ...]:
        found = recorder()
        for a, b in zip([0, *cuts], [*cuts, 20_000], strict=True):
            found.add(*rows(b - a, speed[a:b]))
        return found.result().falls

    whole = fell([])
    assert len(whole) > 20
    for _ in range(5):
        assert fell(sorted(draw.integers(1, 20_000, 12).tolist())) == whole
    assert {fall.cause for fall in whole} == {START, END, ON_LINE}


def test_a_plan_lists_the_falls_with_the_largest_loss_and_bounds_its_memory() -> None:
    """18,000 short falls: 1,000 are listed, all are counted, and the causes over time are halved."""
    found = recorder()
    speed = np.tile([1.0, 0.5, 1.0], 1000)
    for k in range(18):
        found.add(*rows(3000, speed * (1.0 - 1e-4 * k)))
    result = found.result()
    assert result.fall_count == 18_000
    assert len(result.falls) == 1000
    assert result.causes[0].falls > 17_990
    assert 16384 < len(result.time) <= 2 * 16384
    assert np.all(np.diff(result.time) > 0.0)
    # those of the last block are the slowest
    assert min(fall.lost for fall in result.falls) == pytest.approx(T * (1.0 - 0.5 * (1.0 - 17e-4)), rel=1e-6)


@pytest.mark.usefixtures("no_report")
def test_the_command_says_where_the_feed_fell(tmp_path: Path) -> None:
    path = tmp_path / "part.ngc"
    path.write_text("G61 F6000\nG1 X50\nY50\nG3 X50 Y50 I-10\nM2\n", encoding="utf-8")
    outcome = plan.run(PlanRequest(path, machine="xy_table", out=tmp_path / "out"))
    (told,) = [remark for remark in outcome.remarks if "Lost by falls" in remark]
    assert "corner, exact path (G61) (jerk of " in told
    record = json.loads((tmp_path / "out" / "plan.json").read_text())
    feed = record["feed"]
    assert feed["lost_s"] == pytest.approx(record["cycle_time_s"] - feed["time_at_feed_s"])
    assert sum(row["lost_s"] for row in feed["by_cause"]) == pytest.approx(feed["lost_s"])
    assert feed["fall_count"] == len(feed["falls"])
    assert any(fall["lines"] == [2, 3] for fall in feed["falls"])
    assert set(SHAPES.values()) >= {fall.cause for fall in outcome.result.loss.falls} - {
        *(START, END),
        *("corner, exact path (G61)", "bend, exact path (G61)"),
    }
    assert fd.plot.plan_losses_chart(outcome.result).panels

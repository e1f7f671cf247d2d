"""Numbers that decide what of a part program is refused, and how it is planned: a case on either side of each."""

# pyright: reportPrivateUsage=false
# most of these numbers decide inside a module

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import closing
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from paths import LIMITS, arc, joined_up, lines

from feeddrive.language.errors import ParameterError, ProgramError
from feeddrive.language.kernels.kernel import interpreted
from feeddrive.language.kernels.source import by_field, columns, rows_for
from feeddrive.path import planned, setpoints
from feeddrive.path.feed_loss import FeedLossRecorder
from feeddrive.path.geometry.cluster import (
    Goals,
    _prepared,
    cluster_room,
    clustered,
    envelope,
    lines_room,
    place_knots,
)
from feeddrive.path.geometry.joints import Joiner, joined
from feeddrive.path.geometry.segments import Chain, blend_at, blend_room, chains, goes_on
from feeddrive.path.limits import AxisLimits, MachineLimits
from feeddrive.path.motion import LINE, POLYNOMIAL, Motion, Part, Piece, Pieces, Section, piece_of
from feeddrive.path.program.blocks import BlockError, Parameters, Values, read_block
from feeddrive.path.program.flow import Flow
from feeddrive.path.program.lines import ProgramLines
from feeddrive.path.program.moves import Command, Feed, Line, PathMode, Spline, Straight
from feeddrive.path.program.reading import read_commands, read_program
from feeddrive.path.proof import Prover, faults_of
from feeddrive.path.purpose import DEFAULT
from feeddrive.path.schedule import lift, plan, ramp, run, spline
from feeddrive.path.schedule.lift import Lifter
from feeddrive.path.schedule.override import override
from feeddrive.path.schedule.plan import timed
from feeddrive.path.schedule.ramp import pieces_room
from feeddrive.path.schedule.run import Schedule, plan_run
from feeddrive.path.setpoints import Samples, Setpoints, Standstill, causes
from feeddrive.path.tip_proof import TipProver

AXIS = AxisLimits(velocity=0.5, acceleration=5.0, jerk=100.0, snap=5e4)
AXES = MachineLimits({"X": AXIS, "Y": AXIS, "Z": AXIS})


@pytest.fixture
def commands(tmp_path: Path) -> Callable[[str], list[Command]]:
    def read(text: str) -> list[Command]:
        program = tmp_path / "program.ngc"
        program.write_text(f"{text}\nM2\n")
        return [*read_commands(program, front_end="own")]

    return read


def refuses(read: Callable[[], object], reason: str) -> bool:
    """True if it is refused; the refusal states this reason."""
    text = ""
    try:
        read()
    except (ProgramError, BlockError, ParameterError) as error:
        text = str(error)
    assert not text or reason in text
    return bool(text)


# tolerances


@pytest.mark.parametrize(("tolerance", "reason"), [
    (0.7e-12, "rounding of positions"), (1.5e-12, ""), (0.8, ""), (1.5, "is more than 1000 mm"),
])  # fmt: skip
def test_a_tolerance_lies_between_the_rounding_of_positions_and_a_meter(tolerance: float, reason: str) -> None:
    text = str(AXES.unfit(tolerance))
    assert reason in text
    assert bool(text) is bool(reason)


# words, parameters and expressions


@pytest.mark.parametrize(("number", "refused"), [(5602, False), (5603, True)])
def test_parameters_have_numbers_up_to_5602(number: int, refused: bool, commands: Callable[[str], Any]) -> None:
    assert refuses(lambda: commands(f"#{number}=1"), "whole number from 1 to 5602") is refused


@pytest.mark.parametrize(("deep", "refused"), [(55, False), (65, True)])
def test_brackets_lie_up_to_60_deep(deep: int, refused: bool) -> None:
    text = f"{'[' * deep}1{']' * deep}"
    assert refuses(lambda: Values(text, Parameters()).value(), "more than 60 deep") is refused


@pytest.mark.parametrize(("apart", "equal"), [(0.7e-5, 1.0), (1.4e-5, 0.0)])
def test_numbers_closer_than_a_hundred_thousandth_are_equal(apart: float, equal: float) -> None:
    """As in LinuxCNC, since programs compare what they have computed."""
    assert Values(f"[1 eq {1.0 + apart:.9f}]".replace(" ", ""), Parameters()).value() == equal


@pytest.mark.parametrize("word", ["X{}", "X[{}]"])
@pytest.mark.parametrize(("value", "refused"), [(8e8, False), (1.5e9, True)])
def test_words_are_at_most_a_milliard(word: str, value: float, refused: bool) -> None:
    line = Line("", 1, word.format(f"{value:.0f}"))
    assert refuses(lambda: read_block(line, Parameters(), False), "a word is at most") is refused


@pytest.mark.parametrize(("size", "refused"), [(60_000, False), (70_000, True)])
def test_lines_have_up_to_65536_bytes(size: int, refused: bool, commands: Callable[[str], Any]) -> None:
    assert refuses(lambda: commands(f"({'x' * size})"), "longer than 65536 bytes") is refused


# coordinates


@pytest.mark.parametrize(("system", "refused"), [(9, False), (10, True)])
def test_there_are_nine_work_offsets(system: int, refused: bool, commands: Callable[[str], Any]) -> None:
    """G54 to G59.3, as in LinuxCNC."""
    assert refuses(lambda: commands(f"G10 L2 P{system} X1"), "P of G10 L2 is a whole number from 0 to 9") is refused


@pytest.mark.parametrize(("kilometers", "refused"), [(800, False), (1500, True)])
def test_coordinates_lie_within_1000_km(kilometers: int, refused: bool, tmp_path: Path) -> None:
    program = tmp_path / "far.ngc"
    program.write_text(f"G20\nG0 X{kilometers * 39370}\nM2\n")  # in inches, since no word is larger than 1e9
    assert refuses(lambda: [*read_program(program)], "is farther than") is refused


@pytest.mark.parametrize(("beyond", "refused"), [(0.7e-9, False), (1.5e-9, True)])
def test_a_coordinate_may_be_a_nanometer_beyond_the_travel(beyond: float, refused: bool, tmp_path: Path) -> None:
    program = tmp_path / "end.ngc"
    program.write_text("G0 X100\nM2\n")
    assert refuses(lambda: [*read_program(program, axes={"X": (0.0, 0.1 - beyond)})], "its travel is") is refused


# calls, loops and repeats


@pytest.mark.parametrize(("deep", "refused"), [(45, False), (60, True)])
def test_subroutines_call_each_other_50_deep(deep: int, refused: bool, commands: Callable[[str], Any]) -> None:
    text = f"o1 sub\no2 if [#1 lt {deep}]\no1 call [#1 + 1]\no2 endif\no1 endsub\no1 call [1]"
    assert refuses(lambda: commands(text), "more than 50 deep") is refused


@pytest.mark.parametrize(("counter", "count", "refused"), [
    ("_again", 8_000_000, False), ("_again", 15_000_000, True),
    ("_at_rest", 240_000, False), ("_at_rest", 450_000, True),
])  # fmt: skip
def test_ten_million_lines_are_read_again_and_300_000_without_a_motion(
    counter: str, count: int, refused: bool, tmp_path: Path
) -> None:
    program = tmp_path / "loop.ngc"
    program.write_text("o1 while [1]\no1 endwhile\n")
    with closing(ProgramLines(program)) as lines:
        flow = Flow(lines, Parameters())

        def go_on() -> None:
            for _ in range(3):
                line = lines.next_line()
                assert line is not None
                flow.act(line.text.replace(" ", ""))

        go_on()
        setattr(lines, counter, count)
        assert refuses(go_on, "does a loop never end?") is refused


@pytest.mark.parametrize(("text", "reason"), [
    ("G81 Z-1 R1 L{}", "L of G81 is a whole number from 1 to 10000"),
    ("G83 Z0 R{}e-3 Q0.001", "makes more than 10000 pecks"),
])  # fmt: skip
@pytest.mark.parametrize(("count", "refused"), [(8_000, False), (15_000, True)])
def test_a_cycle_is_repeated_and_pecks_10000_times_at_most(
    text: str, reason: str, count: int, refused: bool, commands: Callable[[str], Any]
) -> None:
    words = text.format(count / 1000 if "e-3" in text else count).replace("e-3", "")
    assert refuses(lambda: commands(f"F1000 G17\n{words}"), reason) is refused


@pytest.mark.parametrize(("turns", "refused"), [(80_000, False), (150_000, True)])
def test_an_arc_turns_100000_times_at_most(turns: int, refused: bool, commands: Callable[[str], Any]) -> None:
    assert refuses(lambda: commands(f"F1000\nG3 I1 P{turns}"), "whole number from 1 to 100000") is refused


def test_a_pecking_cycle_traverses_to_a_hundredth_of_an_inch_above_its_last_depth(
    commands: Callable[[str], list[Command]],
) -> None:
    levels = [c.values[2] for c in commands("F100\nG83 X0 Y0 Z-2 R1 Q2") if c.name == "STRAIGHT_TRAVERSE"]
    assert levels == pytest.approx([1.0, 1.0, 1.0, -1.0 + 0.254, 1.0])


@pytest.mark.parametrize(("rate", "feed"), [(0.15, 0.15), (0.07, 0.1)])
def test_the_feed_of_inverse_time_is_at_least_a_tenth_of_a_unit_a_minute(
    rate: float, feed: float, commands: Callable[[str], list[Command]]
) -> None:
    feeds = [c.values[0] for c in commands(f"G93\nG1 X1 F{rate}") if c.name == "SET_FEED_RATE"]
    assert feeds[0] == pytest.approx(feed)


@pytest.mark.parametrize(("short", "refused"), [(0.0009, False), (0.0018, True)])
def test_a_radius_may_be_short_of_its_chord_by_the_rounding_of_an_inch_program(
    short: float, refused: bool, commands: Callable[[str], Any]
) -> None:
    """0.00005 inch, half of the fourth decimal."""
    assert refuses(lambda: commands(f"F100\nG2 X10 Y0 R{5.0 - short:.6f}"), "does not reach") is refused


# splines and chains


def segments(tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """Start and way of each segment of a quadratic of 100 mm."""
    move = Spline(Line("", 1, ""), (0.0,) * 9, (0.1, *(0.0,) * 8), ((0.05, 0.05, *(0.0,) * 7),))
    mode = PathMode(move.source, "continuous", tolerance, tolerance)
    chain = next(chains(iter([Feed(move.source, 0.1, 0.1), mode, move]), "XY"))
    assert isinstance(chain, Chain)
    return chain.segments.origin, chain.segments.shape[:, :, 1]


def test_the_chords_of_a_spline_use_a_tenth_of_the_tolerance() -> None:
    """Between two points of a parabola the chord is farthest in the middle, by |B''|/(8 n²)."""
    tolerance = 1e-6
    origin, way = segments(tolerance)
    n, middle = len(origin), origin + 0.5 * way
    s = (np.arange(n) + 0.5) / n
    curve = np.stack([0.1 * s, 0.1 * s * (1.0 - s)], axis=1)
    assert 0.09 < np.max(np.linalg.norm(curve - middle, axis=1)) / tolerance <= 0.1


def test_a_spline_that_is_followed_exactly_has_16_pieces() -> None:
    assert 10 < len(segments(0.0)[0]) < 25


def test_a_chain_has_a_thousand_segments() -> None:
    """Memory does not grow with the program, and joints see a thousand segments at once."""
    source = Line("", 1, "")
    points = [(1e-3 * k, *(0.0,) * 8) for k in range(1801)]
    moves = [Straight(source, a, b, True) for a, b in pairwise(points)]
    sizes = [len(chain.tolerance) for chain in chains(iter(moves), "X") if isinstance(chain, Chain)]
    assert 700 < sizes[0] < 1500


@pytest.mark.parametrize(("count", "deviation", "ways"), [(80, 1e-5, 2), (80, 0.0, 1), (150, 1e-5, 0)])
def test_chains_of_up_to_100_segments_with_rounded_corners_are_joined_in_two_ways(
    count: int, deviation: float, ways: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where no corner is rounded both ways are the same, and longer chains are left to the usual one."""
    made = list[int]()

    class Joiner:
        def __init__(self, *_: object) -> None:
            made.append(1)

        def join(self, _: Chain) -> Any:
            return [], SimpleNamespace(stop=np.zeros(1), deviation=np.array([deviation]))

    monkeypatch.setattr(setpoints, "Joiner", Joiner)
    chain = Chain(lines(np.zeros((2, 3)) + np.arange(2)[:, None], 0.1), np.zeros(count), True)
    setpoints._quicker(chain, setpoints._Frame(LIMITS, None, None), 1.0)
    assert len(made) == ways


# the schedule


@pytest.mark.parametrize(("factor", "refused"), [(1.8, False), (2.5, True)])
def test_a_factor_of_the_feed_is_at_most_2(factor: float, refused: bool) -> None:
    assert refuses(lambda: override([(1.0, factor)]), "must be 0 .. 2 (0 .. 200 %), got 2.5 (250 %)") is refused


def straight(count: int) -> Section:
    return Section(lines(1e-3 * np.arange(count + 1)[:, None] * np.array([[1.0, 0.0, 0.0]]), 0.05), False)


@pytest.mark.parametrize(("count", "planned_yet"), [(600, False), (1000, True)])
def test_800_pieces_are_planned_together(count: int, planned_yet: bool) -> None:
    assert bool([*Schedule(LIMITS).add(straight(count))]) is planned_yet


def test_eight_tenths_of_a_window_become_final() -> None:
    part = next(iter(Schedule(LIMITS).add(straight(1000))))
    assert isinstance(part, Part)
    assert 0.5 < float(np.sum(part.pieces.length)) < 0.7  # of 800 mm


def test_after_two_windows_the_second_pair_of_shares_is_tried_in_every_eighth(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a line both pairs give the same plan, of which the first counts as faster."""
    fastest, tried = run._fastest, list[int]()

    def recorded(*given: Any) -> Any:
        tried.append(1 if given[-1] else 2)
        return fastest(*given)

    monkeypatch.setattr(run, "_fastest", recorded)
    assert [*Schedule(LIMITS, 50).add(straight(600))]
    assert tried[:10] == [2, 2, 1, 1, 1, 1, 1, 1, 2, 1]


def test_planning_a_ramp_ends_after_some_sixteen_passes(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the blend of a corner of 120 degrees, where some ramps do not converge."""
    end = 0.001 * np.array([0.5, math.sqrt(0.75), 0.0])
    segments = lines(np.array([[0.0, 0.0, 0.0], [0.001, 0.0, 0.0], end]), 0.3)
    (run,), _ = joined(segments, np.full(2, 1e-3), sharpest=4.0, lonely=np.inf)
    fit, lacking, passes = plan.fit, ramp.lacking, list[int]()

    def counted(*given: Any) -> Any:
        passes.append(0)
        return fit(*given)

    def counting(*given: Any) -> Any:
        passes[-1] += 1
        return lacking(*given)

    monkeypatch.setattr(plan, "fit", counted)
    monkeypatch.setattr(ramp, "lacking", counting)
    with interpreted():
        plan_run(run, LIMITS)
    assert 10 < max(passes) < 24


def test_ramps_cost_a_thousandth_of_the_time_of_the_fastest_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """In two blends, against a search to 0.01 % of a ramp's duration, which takes more passes."""
    runs = list[Pieces]()
    for degrees in (30, 44):
        end = 1e-3 * np.array([1.0 + math.cos(math.radians(degrees)), math.sin(math.radians(degrees)), 0.0])
        segments = lines(np.array([[0.0, 0.0, 0.0], [1e-3, 0.0, 0.0], end]), 0.3)
        runs += joined(segments, np.full(2, 1e-4), sharpest=4.0, lonely=np.inf)[0]
    found = [float(np.sum(plan_run(run, LIMITS).duration)) for run in runs]
    monkeypatch.setattr(ramp, "_NEAR", 1e-4)
    monkeypatch.setattr(ramp, "_WALKS", 100)
    with interpreted():
        excess = [
            time / float(np.sum(plan_run(run, LIMITS).duration)) - 1.0 for run, time in zip(runs, found, strict=True)
        ]
    assert 6e-4 < max(excess) < 1.2e-3


def test_the_search_for_a_peak_has_enough_tries(monkeypatch: pytest.MonkeyPatch) -> None:
    """On an arc that is too short for its speed limit: less than 0.03 % is left."""
    pieces = arc((0.0, 0.0), 0.01, 0.0, 2.0, 0.5)
    with interpreted():
        found = np.sum(plan_run(pieces, LIMITS).duration)
        monkeypatch.setattr(plan, "_PEAKS", 200)
        assert found <= 1.0003 * np.sum(plan_run(pieces, LIMITS).duration)


def test_all_slow_pieces_of_a_stretch_are_tried_as_plateaus(monkeypatch: pytest.MonkeyPatch) -> None:
    """Then the slowest is tried at two lower speeds; both ramps to a piece find no room on 20 slow lines of 30 um.  A
    plan of few stretches is made with the first pair of shares only.
    """
    split, tries = plan._split, list[object]()

    def counted(path: Any, now: Any, *given: Any) -> Any:
        tries.append(now[:2])
        return split(path, now, *given)

    monkeypatch.setattr(plan, "_split", counted)
    segments = lines(3e-5 * np.arange(21)[:, None] * np.array([[1.0, 0.0, 0.0]]), 0.1)
    segments = segments._replace(feed=1e-3 + 5e-5 * np.arange(20))
    with interpreted():
        plan_run(segments, LIMITS * [1.0, 1.0, 1.0, 1e-3])
    assert 16 < max(map(tries.count, tries)) < 24


@pytest.mark.parametrize(("ratio", "level"), [(1.0005, True), (1.0015, False)])
def test_speed_limits_within_a_thousandth_are_made_equal(ratio: float, level: bool) -> None:
    pieces = lines(np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.2, 0.0, 0.0]]), 0.1)
    caps = np.zeros((2, 2))
    pieces = pieces._replace(feed=pieces.feed * [1.0, ratio])
    pieces_room(pieces, LIMITS, 0.9, 0.6, False, np.zeros((2, 3, 4)), np.zeros(2), caps)
    assert bool(caps[0, 0] == caps[1, 0]) is level


@pytest.mark.parametrize(("length", "count"), [(3e-15, 0), (6e-15, 1)])
def test_a_plateau_shorter_than_the_rounding_of_its_path_is_left_out(length: float, count: int) -> None:
    """The path is 1 m long, and u is rounded to some 1e-16 m at each step."""
    stretches = np.array([columns(plan.Stretch(0.5, 0.5 + length, 0.1, 0.1, peak=0.1))])
    motion = Motion(np.zeros(15), np.zeros(15, np.int64), *(np.zeros(15) for _ in range(5)))
    assert timed(np.array([0.0, 1.0]), stretches, motion) == count


# faults, samples, stops and causes


@pytest.mark.parametrize(("count", "kept"), [(80, 80), (150, 100)])
def test_a_hundred_faults_are_described_and_all_are_counted(count: int, kept: int) -> None:
    prover = Prover(LIMITS)
    prover._note(count, np.zeros((count, 5)), np.zeros(1, np.int64), np.ones(1), 0.0)
    proof = prover.proof()
    assert proof.count == count
    assert len(proof.faults) == kept


@pytest.mark.parametrize(("share", "expected"), [(0.4, "no limit"), (0.7, "acceleration of X")])
def test_a_limit_counts_as_the_cause_from_a_half_on(share: float, expected: str) -> None:
    used = np.zeros((1, 3, 4))
    used[0, 0, 1] = share
    cause = AXES.causes[causes(used, np.array([0.1]), np.array([1.0]))[0]]
    assert cause.startswith(expected)


@pytest.mark.parametrize(("share", "expected"), [(0.9985, "snap of Z"), (0.9995, "feed")])
def test_the_feed_counts_as_the_cause_from_999_thousandths_on(share: float, expected: str) -> None:
    used = np.zeros((1, 3, 4))
    used[0, 2, 3] = 1.0
    assert AXES.causes[causes(used, np.array([share]), np.array([1.0]))[0]] == expected


@pytest.mark.parametrize(("angle", "reason"), [(0.7e-6, "bend"), (1.5e-6, "corner")])
def test_a_turn_of_a_millionth_is_a_corner(angle: float, reason: str, tmp_path: Path) -> None:
    program = tmp_path / "turn.ngc"
    program.write_text(f"G61 F6000\nG1 X100\nX200 Y{100.0 * math.tan(angle):.9f}\nM2\n")
    sampled = Setpoints(read_program(program), AXES, 1e-3)
    for _ in sampled:
        pass
    assert [stop.reason.partition(",")[0] for stop in sampled.stops] == [reason]


def test_a_standstill_comes_in_blocks_of_16384_samples() -> None:
    sizes = [len(samples.values) for samples in Setpoints([], AXES, 1e-3)._rest(20.0, 1)]
    assert sum(sizes) == 20_000
    assert 10_000 < sizes[0] < 18_000


def samples(first: int, count: int) -> Samples:
    return Samples(first, np.zeros((count, 3, 5)), np.zeros(count, np.int64), *np.zeros((2, count)), True)


@pytest.mark.parametrize(("count", "intervals"), [(16_000, 16_000), (17_000, 8_500)])
def test_a_course_has_at_most_16384_intervals(count: int, intervals: int) -> None:
    recorder = planned.Recorder(3)
    for first in range(0, count, 1000):
        recorder.add(samples(first, 1000))
    assert recorder.course(1e-3).time.size == intervals


def test_a_plan_lists_a_thousand_stops_and_counts_all() -> None:
    class Stopping:
        limits, sample_time, samples, time, blocks, runs = AXES, 1e-3, 0, 0.0, 0, 0
        prover, tip, seconds = Prover(LIMITS), TipProver(), dict[str, float]()
        losses, settings = FeedLossRecorder(LIMITS, AXES.causes[:12], 1e-3), DEFAULT
        stops: tuple[Standstill, ...] | list[Standstill] = ()

        def __iter__(self) -> Iterator[Samples]:
            for first in range(2):
                self.stops = [Standstill(0.0, 0.0, 1, np.zeros(3), "dwell (G4)")] * 800
                yield samples(first, 1)

    result = planned.planned_of(Stopping(), "", "")  # type: ignore[arg-type]
    assert result.stop_count == 1600
    assert 800 < len(result.stops) < 1500


# joints of lines and arcs


def polyline(points: list[tuple[float, float]]) -> Pieces:
    return lines(np.column_stack([np.array(points), np.zeros(len(points))]), 0.1)


def corner(turn: float, length: float) -> Pieces:
    """Two lines of one length, whose directions are `turn` apart (the chord of their angle)."""
    angle = 2.0 * math.asin(0.5 * turn)
    return polyline([(0.0, 0.0), (length, 0.0), (length + length * math.cos(angle), length * math.sin(angle))])


@pytest.mark.parametrize(("blends", "stops"), [(4.0, False), (5.5, True)])
def test_lines_longer_than_4_5_blends_stop_at_their_corner(blends: float, stops: bool) -> None:
    """A blend takes P / (0.156 · 2 sin θ/2) of both lines."""
    tolerance, turn = 1e-5, 0.1
    length = blends * tolerance / (0.156 * turn)
    _, joint = joined(corner(turn, length), np.full(2, tolerance))
    assert bool(joint.stop[0]) is stops


def test_a_blend_has_eight_pieces() -> None:
    runs, _ = joined(corner(0.1, 4.0 * 1e-5 / (0.156 * 0.1)), np.full(2, 1e-5))
    assert 5 < np.sum(runs[0].kind == POLYNOMIAL) < 12


def test_the_bound_of_a_blend_with_an_arc_is_at_most_two_percent_above_its_deviation() -> None:
    """Against dense points of a blend of 0.1 m for a jump of curvature of 1/m; less than 1 % would cost more parts."""
    pieces = joined_up(polyline([(-1.0, 0.0), (0.0, 0.0)]), arc((0.0, 1.0), 1.0, -0.5 * math.pi, 0.0, 0.1))
    room = blend_room(3)
    bound = blend_at(piece_of(pieces, 0), piece_of(pieces, 1), 0.05, 2.0, room)
    u = np.linspace(-0.05, 0.05, 2001)
    after = np.maximum(u, 0.0)
    path = np.polynomial.polynomial.polyval(10.0 * (u + 0.05), room.blended.T) + np.array([[-0.05], [0.0], [0.0]])
    segments = np.stack([np.minimum(u, 0.0) + np.sin(after), 1.0 - np.cos(after), 0.0 * u])
    assert 1.008 < bound / np.max(np.linalg.norm(path - segments, axis=0)) < 1.02


def line_and_arc(turn: float) -> Pieces:
    """A line of 50 mm to the origin, and a quarter of a circle of 30 mm that begins `turn` rad off its direction."""
    center = (-0.03 * math.sin(turn), 0.03 * math.cos(turn))
    begin = turn - 0.5 * math.pi
    return joined_up(polyline([(-0.05, 0.0), (0.0, 0.0)]), arc(center, 0.03, begin, begin + 0.5 * math.pi, 0.1))


@pytest.mark.parametrize(("turn", "stops"), [(0.15, False), (0.28, True)])
def test_next_to_an_arc_only_corners_of_more_than_a_fifth_of_a_radian_stop(turn: float, stops: bool) -> None:
    _, joint = joined(line_and_arc(turn), np.full(2, 1e-5))
    assert bool(joint.stop[0]) is stops


@pytest.mark.parametrize(("turn", "tried"), [(1.5e-9, False), (3e-9, True)])
def test_a_turn_of_2e_9_is_a_corner_that_may_be_passed_in_time(turn: float, tried: bool) -> None:
    chain = Chain(line_and_arc(turn), np.full(2, 1e-5), True)
    joined = setpoints._quicker(chain, setpoints._Frame(LIMITS, None, None), 1.0)
    assert joined is not None
    assert (joined.parts is not None) is tried


@pytest.mark.parametrize(("turn", "least", "most"), [(0.7e-3, 0.035, 0.05), (1.5e-3, 0.12, 1.0)])
def test_arcs_of_one_circle_up_to_a_thousandth_stay_within_a_twentieth_of_the_tolerance(
    turn: float, least: float, most: float
) -> None:
    tolerance, radius = 1e-5, 0.03
    turned_by = turn - 0.5 * math.pi
    center = (-radius * math.sin(turn), radius * math.cos(turn))
    first = arc((0.0, radius), radius, -0.5 * math.pi - 1.0, -0.5 * math.pi, 0.1)
    second = arc(center, radius, turned_by, turned_by + 1.0, 0.1)
    _, joint = joined(joined_up(first, second), np.full(2, tolerance))
    assert not joint.stop[0]
    assert least < joint.deviation[0] / tolerance <= most


@pytest.mark.parametrize(("apart", "smooth"), [(1.4e-12, True), (2.8e-12, False)])
def test_derivatives_that_agree_to_1e_12_of_them_go_on(apart: float, smooth: bool) -> None:
    """Of r' = 1: the tolerance is 1e-12 of 1 + |r'|."""
    shape = np.zeros((2, 1, 8))
    shape[:, 0, 1] = 1.0, 1.0 + apart
    one, two = (Piece(POLYNOMIAL, 1.0, each) for each in shape)
    assert goes_on(one, two, np.zeros((1, 5)), np.zeros((1, 5))) is smooth


# clusters


@pytest.mark.parametrize(("step", "count"), [(0.4, 2), (0.5, 1)])
def test_steps_grow_by_35_percent_of_the_way(step: float, count: int) -> None:
    given = Goals(np.array([0.0, 1.0]), np.array([0.1, step]))
    assert envelope(given, 2, Goals(np.zeros(2), np.zeros(2))) == count


def test_the_last_twenty_steps_are_fitted_to_the_end() -> None:
    knots = np.zeros(60)
    count = place_knots(Goals(np.zeros(1), np.ones(1)), 1, 0.01, 0.3005, 0, 50, knots)
    moved = np.flatnonzero(np.abs(np.diff(knots[5 : 6 + count]) - 0.01) > 1e-9)
    assert count == 31
    assert 9 < moved[0] < 14


def marked(points: list[tuple[float, float]]) -> np.ndarray:
    """Joints that belong to a cluster, with a tolerance of 1 mm."""
    pieces, inside = polyline(points), np.zeros(len(points) - 1, np.int64)
    tolerance = np.full(len(points) - 1, 1e-3)
    clustered(pieces, tolerance, 0.35, 4.5, cluster_room(1, 3), inside)
    return inside


def around_a_corner(stretch: int, aside: float = 0.0) -> list[tuple[float, float]]:
    """Steps of 1 mm into a right angle and out of it, straight but for `aside` mm over some of them, then turning."""
    way = [(1e-3 * k, 1e-3 * aside * (k % 2)) for k in range(-stretch, 0)]
    spread = [(-1e-3 * stretch - 0.7e-3 * k, 0.7e-3 * k) for k in range(12, 0, -1)]
    into = [*spread, *way, (0.0, 0.0)]
    return [*into, *[(y, -x) for x, y in reversed(into[:-1])]]


@pytest.mark.parametrize(("stretch", "aside", "ends"), [
    (15, 0.0, True), (7, 0.0, False), (15, 0.18, True), (15, 0.35, False),
])  # fmt: skip
def test_a_sharp_corner_between_ten_tolerances_that_look_straight_ends_a_cluster(
    stretch: int, aside: float, ends: bool
) -> None:
    """Straight is what lies within a quarter of the tolerance beside its chord."""
    points = around_a_corner(stretch, aside)
    assert bool(marked(points)[len(points) // 2 - 1] == 0) is ends


@pytest.mark.parametrize(("turn", "groups"), [(0.7e-13, 1), (1.5e-13, 2)])
def test_lines_within_1e_13_have_one_direction(turn: float, groups: int) -> None:
    made = lines_room(polyline([(0.0, 0.0), (1.0, 0.0), (2.0, turn)]))
    _prepared(made, np.full(2, 1e-3), 0, 1, 0.0, np.zeros(3))
    assert len(set(made.group.tolist())) == groups


def wave(length: float, count: int) -> list[tuple[float, float]]:
    """Chords of a sine of 0.1 mm, 100 mm long each."""
    x = np.linspace(0.0, length, count + 1)
    return [*zip(x.tolist(), (1e-4 * np.sin(20.0 * np.pi * x)).tolist(), strict=True)]


def test_a_gentle_cluster_has_steps_of_10_mm_and_one_that_needs_it_uses_its_tolerance() -> None:
    steps = joined(polyline(wave(0.4, 400)), np.full(400, 1e-3))[0][0].length
    assert 0.007 < np.max(steps) < 0.013
    deviation = joined(polyline(wave(0.4, 400)), np.full(400, 1e-6))[1].deviation
    assert 0.7 < np.max(deviation) / 1e-6 <= 1.0


def test_a_cluster_that_begins_on_a_line_has_three_steps_to_its_first_corner() -> None:
    """A corner changes a spline of fifth degree over three knots."""
    angles = np.concatenate([[0.0, 0.4], 0.4 + 0.02 * np.arange(1, 60)])
    lengths = np.concatenate([[0.01, 5e-4], np.full(59, 2e-4)])
    points = np.cumsum(lengths[:, None] * np.column_stack([np.cos(angles), np.sin(angles)]), axis=0)
    (run,), _ = joined(polyline([(0.0, 0.0), *map(tuple, points.tolist())]), np.full(61, 1e-5))
    assert run.kind[:11].tolist() == [LINE, *[POLYNOMIAL] * 8, LINE, POLYNOMIAL]  # a blend between two lines
    assert 3.0 < np.linalg.norm(points[1] - run.origin[10, :2]) / run.length[10] < 4.2


@pytest.mark.parametrize(("length", "final"), [(0.035, False), (0.08, True)])
def test_50_mm_of_a_long_cluster_are_held_back(length: float, final: bool) -> None:
    chain = Chain(polyline(wave(length, 1500)), np.full(1500, 1e-4), False)
    sections, _ = Joiner().join(chain)
    assert bool(sections) is final


@pytest.mark.parametrize(("excess", "proven"), [(0.7e-9, True), (1.5e-9, False)])
def test_a_limit_is_proven_to_a_relative_1e_9(excess: float, proven: bool) -> None:
    """For rounding: the motion keeps a constant speed of its limit on a line."""
    pieces = lines(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), 10.0)
    rest = [np.zeros(1) for _ in range(3)]
    motion = Motion(np.ones(1), np.zeros(1, np.int64), np.zeros(1), np.full(1, 0.5 * (1.0 + excess)), *rest)
    assert bool(len(faults_of(pieces, motion, LIMITS)) == 0) is proven


def test_a_position_in_mm_is_read_in_inches_after_g20(tmp_path: Path) -> None:
    program = tmp_path / "inch.ngc"
    program.write_text("G21\nG0 X25.4\nG20\nG0 X[#5420 + 1]\nM2\n")
    ends = [move.end[0] for move in read_program(program) if isinstance(move, Straight)]
    assert ends == pytest.approx([0.0254, 0.0508])


# lifting


def wavy() -> Pieces:
    """Chords of a sine, rounded within 10 um."""
    x = np.linspace(0.0, 0.16, 160)
    points = np.stack([x, 0.004 * np.sin(40.0 * np.pi * x), 0.0 * x], axis=1)
    return joined(lines(points, 0.3), np.full(159, 1e-5))[0][0]


@pytest.fixture(scope="module")
def lifting() -> list[tuple[Part, list[Part], Part | None]]:
    """Each part of a wavy path, what lifting makes final after it, and what waits then."""
    lifter = Lifter(LIMITS)
    return [(part, [*lifter.add(part)], lifter.hand) for part in Schedule(LIMITS, 70).add(Section(wavy(), True))]


def count_of(part: Part) -> int:
    return len(part.motion.duration)


def test_a_hundred_time_intervals_are_lifted_together(lifting: list[tuple[Part, list[Part], Part | None]]) -> None:
    (first, nothing, _), (second, lifted, _) = lifting[:2]
    assert 50 < count_of(first) < 100 < count_of(first) + count_of(second) < 200
    assert not nothing
    assert lifted


def test_three_tenths_of_what_is_lifted_wait(lifting: list[tuple[Part, list[Part], Part | None]]) -> None:
    final, waits = next((lifted, hand) for _, lifted, hand in lifting if lifted)
    assert waits is not None
    last = float(np.sum(waits.motion.duration))
    assert 0.22 < last / (last + sum(float(np.sum(part.motion.duration)) for part in final)) < 0.38


@pytest.mark.parametrize(
    ("phases", "snap", "number", "t"),
    [
        ((1e-6, 0.04, 1e-6, 0.06), 0.0, 1, 0.005),  # a twentieth of half a ramp
        ((0.02, 0.02, 0.02, 0.04), 0.0, 0, 0.005),
        ((0.02, 0.0, 0.002, 0.0), 0.0, 0, 0.002),  # a tenth of the first phase at least
        ((0.01, 0.0, 0.01, 0.5), 0.0, 0, 0.005),  # at most a half of it, where the second leaves no room
        ((0.01, 0.02, 0.01, 0.16), 0.0, 1, 0.003),  # well behind it, where it does
        ((0.01, 0.02, 0.01, 0.16), -1.0, 0, 0.005),  # not where the jerk falls again
    ],
)
def test_what_stays_near_rest_ends_early_in_the_first_phase_or_within_the_second(
    phases: tuple[float, ...], snap: float, number: int, t: float
) -> None:
    """z = u'² grows as u^1.5 there, which no cubic spline follows."""
    duration, snaps = np.array([*phases, 1.0]), np.array([1.0, snap, -1.0, 0.0, 0.0])
    for first, sense in ((0, 1), (4, -1)):
        given = [np.ascontiguousarray(each[::sense]) for each in (duration, snaps)]
        assert lift.near_rest(*given, first, sense, 5, 0) == (number, pytest.approx(t, rel=1e-3))


def knot_times(duration: np.ndarray, speed: float, acceleration: float) -> np.ndarray:
    """Return the times of the knots of a spline that follows a uniformly accelerated motion on a line."""
    begin = np.concatenate([[0.0], np.cumsum(duration)])
    speeds, rest = speed + acceleration * begin, np.zeros(len(duration))
    x = begin[:-1] * (speed + 0.5 * acceleration * begin[:-1])
    motion = Motion(duration, np.zeros(len(duration), np.int64), x, speeds[:-1], rest + acceleration, rest, rest)
    path = lift._Path(lines(np.array([[0.0, 0.0, 0.0], [100.0, 0.0, 0.0]]), 10.0), LIMITS)
    ones = np.ones(len(duration), np.int64)
    return path._spline(motion, spline.State(speeds[-1], acceleration, 0.0), 0, (1.0, 1.0), ones)[0]


def test_the_four_time_intervals_of_half_a_ramp_have_seven_spans() -> None:
    spans = len(knot_times(np.full(40, 1e-3), 0.1, 0.0)) - 1
    assert 5 < spans / 10 < 10


def test_spans_are_no_longer_than_a_fourteenth_of_a_ramp_from_rest_on_a_line() -> None:
    """However slow the plan is: it is that of a window whose slow pieces make its ramps long."""
    from_rest = sum(ramp.boxcars(float(LIMITS[0, 0]), *LIMITS[0, 1:].tolist()))
    widest = np.max(np.diff(knot_times(np.full(4, 2.0 * from_rest), 0.1, 0.0)))
    assert 0.8 < widest * 14.0 / from_rest < 1.2


def test_limits_are_lowered_by_less_within_eight_spans_of_a_given_state() -> None:
    assert lift._reduced(100)[[0, 3, 6, 7, 50, 99]].tolist() == pytest.approx([1 / 64, 1 / 4, 49 / 64, 1, 1, 1 / 64])


def test_a_section_is_tried_with_spans_of_three_lengths(monkeypatch: pytest.MonkeyPatch) -> None:
    tries = list[int]()

    def fails(_: object, *given: Any) -> Any:
        tries.append(int(given[-1][1]))
        return None, np.arange(5.0), np.array([1])

    monkeypatch.setattr(lift._Path, "_tried", fails)
    zero = np.zeros(4)
    motion = Motion(np.ones(4), np.zeros(4, np.int64), zero, zero + 1.0, zero, zero, zero)
    path = lift._Path(lines(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), 10.0), LIMITS)
    nothing = lift._some(motion, 0, 0)
    assert path._between(motion, spline.State(1.0, 0.0, 0.0), 0, (1.0, 1.0), (nothing, nothing)) is None
    assert tries == [1, 2, 4]


@pytest.mark.parametrize(("count", "around"), [(100, None), (150, (60, 91))])
def test_a_section_of_120_time_intervals_is_divided_where_it_failed_twice(
    count: int, around: tuple[int, int] | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With room for ramps on either side: 15 time intervals, at all of which there is a node here."""
    tries = list[int]()

    def fails(*_: object) -> Any:
        tries.append(1)
        return None, np.arange(count + 1.0), np.array([count // 2])

    monkeypatch.setattr(lift._Path, "_tried", fails)
    zero = np.zeros(count)
    motion = Motion(zero + 1.0, np.zeros(count, np.int64), zero, zero + 1.0, zero, zero, zero)
    path, nothing = (
        lift._Path(lines(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), 10.0), LIMITS),
        lift._some(motion, 0, 0),
    )
    found = path._between(motion, spline.State(1.0, 0.0, 0.0), 0, (1.0, 1.0), (nothing, nothing))
    assert found is None if around is None else isinstance(found, tuple)
    assert len(tries) == (3 if around is None else 2)
    if isinstance(found, tuple):
        assert np.abs(np.array(found) - around).max() <= 2


def test_a_motion_that_fails_all_over_is_not_divided() -> None:
    zero = np.zeros(100)
    motion = Motion(zero + 1.0, np.zeros(100, np.int64), zero, zero + 1.0, zero, zero, zero)
    assert lift._nodes_around(motion, 40, 60) == (25, 75)
    assert lift._nodes_around(motion, 39, 60) is None


@pytest.mark.parametrize(("share", "follows"), [(0.15, False), (0.3, True)])
def test_spans_follow_time_intervals_down_to_a_fifth_of_their_mean(share: float, follows: bool) -> None:
    """A span lasts a seventh of four intervals; those of rounding must not set its duration."""
    duration = np.full(400, 1e-3)
    duration[200:204] = 7.0 / 4.0 * share * np.mean(duration)
    shortest = np.min(np.diff(knot_times(duration, 0.1, 0.0))) / (share * np.mean(duration))
    assert shortest > 0.9
    assert bool(shortest < 1.1) is follows


def test_the_speed_changes_by_a_fifth_in_the_first_span() -> None:
    first = knot_times(np.ones(1), 0.01, 1.0)[1]
    assert 0.14 < first * 1.0 / 0.01 < 0.28


@pytest.mark.parametrize(("share", "rests"), [(0.7e-9, True), (1.5e-9, False)])
def test_a_motion_rests_below_a_milliardth_of_its_largest_speed(share: float, rests: bool) -> None:
    zero = np.zeros(3)
    motion = Motion(np.ones(3), np.zeros(3, np.int64), zero, np.array([1.0, share, 1.0]), zero, zero, zero)
    assert lift._rests(motion)[1] == rests


@pytest.mark.parametrize(("apart", "ranges"), [(50, 1), (90, 2)])
def test_spans_more_than_64_apart_are_optimized_separately(apart: int, ranges: int) -> None:
    assert len(lift._around(np.array([100, 100 + apart]), 1000)) == ranges


@pytest.mark.parametrize(("step", "kept"), [(0.17, 0.17), (0.25, 0.2)])
def test_the_duration_of_spans_grows_by_a_tenth_of_the_time(step: float, kept: float) -> None:
    edge = np.array([0.1, step])
    spline.graded(np.ones(1), edge)
    assert edge.tolist() == pytest.approx([0.1, kept])


def test_the_limits_hold_at_the_start_the_middle_and_the_end_of_each_span() -> None:
    """On one piece these are three points of each span, with the weights of Simpson's rule: the snap at both ends,
    the other limits at the start and in the middle; the state at the very start is given.
    """
    pieces = lines(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), 10.0)
    inner = np.linspace(0.1, 0.9, 9)
    knots = np.concatenate([inner[:1].repeat(3), inner, inner[-1:].repeat(3)])
    points = lift._Path(pieces, LIMITS)._points(10.0 * (inner - inner[0]), knots)
    assert np.unique(points.span, return_counts=True)[1].tolist() == [3] * 8
    assert points.place == pytest.approx(np.tile([0.0, 0.05, 0.1], 8))
    assert points.looks.tolist() == [2, 1, 2, *[3, 1, 2] * 7]
    assert points.away == pytest.approx(np.tile([1.0, 4.0, 1.0], 8) / 6.0 * 0.1)


@pytest.mark.parametrize(("count", "parts"), [(25, 0), (40, 2)])
def test_a_section_is_halved_if_each_half_can_have_a_ramp_up_a_plateau_and_a_ramp_down(count: int, parts: int) -> None:
    """These have 7, 1 and 7 time intervals."""
    zero = np.zeros(count)
    motion = Motion(zero + 1.0, np.zeros(count, np.int64), zero, zero + 0.1, zero, zero, zero)
    assert len(lift._halves(motion, 0, count)) == parts


@pytest.mark.parametrize(("share", "sections"), [(0.993, 1), (0.997, 2)])
def test_a_plateau_is_kept_from_995_thousandths_of_the_highest_speed_on(share: float, sections: int) -> None:
    zero = np.zeros(3)
    motion = Motion(zero + 1.0, np.zeros(3, np.int64), zero, zero + share, np.array([1.0, 0.0, -1.0]), zero, zero)
    assert len(lift._sections(motion, np.zeros(4, np.int64), np.ones(1), np.ones(1))) == sections


def test_a_limit_whose_proof_fails_is_lowered_by_two_percent_nearby(monkeypatch: pytest.MonkeyPatch) -> None:
    quicker, scaled, calls = lift._quicker, list[np.ndarray](), list[int]()

    def recorded(looked: Any, *rest: Any) -> int:
        scaled.append(looked.r.copy())
        return quicker(looked, *rest)

    def faults(*_: object) -> np.ndarray:
        calls.append(1)
        return np.array([[0.0, 10.0, 0.0, 1.0, 1.001]] if len(calls) == 1 else np.zeros((0, 5)))  # of X, acceleration

    monkeypatch.setattr(lift, "_quicker", recorded)
    monkeypatch.setattr(lift, "faults_of", faults)
    part = Part(wavy(), plan_run(wavy(), LIMITS), True)
    assert [*Lifter(LIMITS).add(part)]
    before, after = (by_field(spline.Rates, each[:, 0]) for each in scaled[:2])
    for name, old, new in zip(spline.Rates._fields, before, after, strict=True):
        old, new = np.asarray(old), np.asarray(new)
        lowered = np.max(new / np.where(old == 0.0, np.inf, old))
        assert lowered == 1.0 if name not in ("a1", "a2") else 1.015 < lowered < 1.03, name


def test_the_motion_meets_its_spline_every_six_spans(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its snap is constant in each span, so that u'' is that of the spline at the ends of groups only."""
    in_time, apart = spline.in_time, list[np.ndarray]()

    def compared(knots: np.ndarray, coefficient: np.ndarray, *rest: Any) -> bool:
        done = in_time(knots, coefficient, *rest)
        (acceleration,) = (each.acceleration for each in rest if isinstance(each, Motion))
        for k in range(1, len(acceleration)):
            z = spline.at(spline.basis(knots, k, knots[k + 3]), coefficient, k)
            apart.append(acceleration[k] - 0.5 * z.z1)
        return done

    monkeypatch.setattr(spline, "in_time", compared)
    monkeypatch.setattr(lift, "faults_of", lambda *_: np.zeros((0, 5)))
    assert [*Lifter(LIMITS).add(Part(wavy(), plan_run(wavy(), LIMITS), True))]
    assert 4 < len(apart) / np.sum(np.abs(apart) < 1e-9) < 10


# lifting: the search for the fastest spline


class Search:
    """The search for the fastest spline of twelve spans on a line, where only the velocity is limited, or the snap."""

    def __init__(self, snap: float = 1e9) -> None:
        inner = np.linspace(0.1, 0.9, 13)
        knots = np.concatenate([inner[:1].repeat(3), inner, inner[-1:].repeat(3)])
        limits = np.array([[1.0, 1e3, 1e6, snap]] * 3)
        pieces = lines(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), 1.0)
        self.points, self.size = lift._Path(pieces, limits)._points(inner - inner[0], knots), 15
        self.rows = rows_for(spline.Basis, 12)
        spline.rows_at_knots(knots, self.rows)

    def run(self, share: float, penalty: float, last: float, steps: int) -> np.ndarray:
        """Return the coefficients after some steps from a constant share of the largest z."""
        m, n = len(self.points.span), self.size
        coefficient = np.full(n, share * np.min(self.points.most))
        room = lift._room(m, n, 3)
        spline.quickest(self.points, self.rows, coefficient, penalty, last, steps, room)
        return coefficient

    def shares(self, coefficient: np.ndarray) -> np.ndarray:
        """Return the share of the largest z at each point."""
        shares = list[float]()
        for k, place, most in zip(self.points.span, self.points.place, self.points.most, strict=True):
            z = spline.shifted(spline.at(by_field(spline.Basis, self.rows[k]), coefficient, int(k)), float(place))
            shares.append(z.z / most)
        return np.array(shares)


@pytest.fixture(scope="module")
def search() -> Search:
    return Search()


@pytest.mark.parametrize(("penalty", "raised"), [(0.2, True), (0.5, False)])
def test_the_penalty_is_at_least_three_tenths_while_a_limit_is_violated(
    penalty: float, raised: bool, search: Search
) -> None:
    steps = [search.run(1.01, p, p, 1).tolist() for p in (penalty, 0.01)]
    assert (steps[0] == steps[1]) is raised


def test_a_step_leaves_a_tenth_of_the_distance_to_a_limit(search: Search) -> None:
    """Without a penalty each step would go beyond the limit."""
    left = list[float]()
    for share in np.linspace(0.3, 0.95, 40).tolist():
        before, after = (search.shares(search.run(share, 1e-9, 1e-9, steps)) for steps in (0, 1))
        left.append(float(np.min((1.0 - after) / (1.0 - before))))
    assert 0.1 - 1e-9 <= min(left) < 0.15


def test_a_step_may_be_halved_six_times() -> None:
    """From 1.2e-6 of a limit of the snap: to first order the step goes along the limit, to second order beyond it."""
    search = Search(snap=1e-3)
    before = np.array([42, 45, 46, 52, 54, 58, 47, 53, 44, 47, 51, 43, 61, 47, 44]) / 100.0
    share = np.zeros(len(search.points.span))
    spline.utilization(search.points, search.rows, before, share)
    for axis in range(3):
        spline.tightened(search.points, 0, len(share), axis, 3, (1.0 - 1.2e-6) / np.max(share))
    after = before.copy()
    spline.quickest(search.points, search.rows, after, 1e-3, 1e-3, 1, lift._room(len(share), len(after), 3))
    assert np.any(after != before)


def test_forty_steps_may_violate_a_limit() -> None:
    """No step lowers a u'² that is 1e3 times too large by more than a tenth; the given states violate nothing."""
    search = Search()
    np.asarray(search.points.r)[:] = 0.0  # no limit but that of u'²
    search.points.most[(search.points.span < 3) | (search.points.span > 8)] = 1e6
    few, enough, many = (search.run(1e3, 0.1, 0.1, steps).tolist() for steps in (22, 60, 200))
    assert few != enough
    assert enough == many


def test_a_search_ends_after_eight_steps_in_which_the_worst_violation_hardly_falls(search: Search) -> None:
    """The given state at either end violates a limit, so that no step can mend it; at first others do, too."""
    few, enough, many = (search.run(1.5, 0.1, 0.1, steps).tolist() for steps in (11, 19, 200))
    assert few != enough
    assert enough == many


@pytest.mark.parametrize(("last", "ends"), [(0.08, False), (0.2, True)])
def test_the_penalty_falls_to_a_tenth_in_a_step(last: float, ends: bool, search: Search) -> None:
    """From 1, so that the second of two steps has the last penalty only if that is higher."""
    steps = [search.run(0.5, 1.0, penalty, 2).tolist() for penalty in (last, 0.01)]
    assert (steps[0] != steps[1]) is ends

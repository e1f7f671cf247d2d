"""Sharp corners passed in time: what they cost, limits and tolerance of the sum, faults that the proof must see."""

# pyright: reportPrivateUsage=false
# the end of a run at a corner is decided inside a module

from __future__ import annotations

from copy import copy
from typing import NamedTuple

import numpy as np
import pytest
from paths import LIMITS, arc, joined_up, lines, random_limits

from feeddrive.language.kernels.kernel import interpreted
from feeddrive.path.geometry.joints import Joiner, joined
from feeddrive.path.geometry.segments import Chain
from feeddrive.path.motion import (
    Interval,
    Motion,
    Part,
    Pieces,
    Section,
    chain,
    derivatives,
    direction,
    from_rows,
    moved,
    part_of_pieces,
    rows,
    slowed,
    way,
)
from feeddrive.path.proof import Proof, Prover
from feeddrive.path.schedule import corner as planner
from feeddrive.path.schedule import planner as schedule_planner
from feeddrive.path.schedule.corner import (
    ROWS,
    End,
    LineStretch,
    Node,
    overlap,
    shared,
    slower_overlap,
    straight,
    together,
    width,
)
from feeddrive.path.schedule.crossings import Crossings, Lines, _end, overlapped
from feeddrive.path.schedule.lift import Lifter
from feeddrive.path.schedule.planner import Planner
from feeddrive.path.schedule.run import Schedule, plan_run
from feeddrive.path.setpoints import Sampler
from fresh_draws import Seeded


def passed(segments: Pieces, tolerance: float, limits: np.ndarray = LIMITS, share: float = 1.0) -> list[Part]:
    """Segments planned with a share of the limits, every joint with the same tolerance (m)."""
    runs, joint = joined(segments, np.full(len(segments.length), tolerance))
    crossings, found = Crossings(limits), []
    corners = np.where(joint.stop == 1, tolerance, 0.0)[joint.stop == 1]
    for pieces, corner in zip(runs, corners, strict=True):
        found += crossings.add(Part(pieces, plan_run(pieces, share * limits), True), float(corner))
    return found + crossings.end()


def stopped(segments: Pieces, limits: np.ndarray = LIMITS) -> float:
    """Time from stop to stop, s."""
    return time([Part(each, plan_run(each, limits), True) for each in joined(segments, np.zeros(10**4))[0]])


def time(parts: list[Part]) -> float:
    return sum(float(np.sum(each.motion.duration)) for each in parts)


def proof(parts: list[Part], limits: np.ndarray = LIMITS) -> Proof:
    prover = Prover(limits)
    for each in parts:
        prover.prove(each)
    return prover.proof()


def corner(degrees: float, turned: float = 0.0, length: float = 0.04) -> np.ndarray:
    """Two lines; the first lies at `turned` degrees to the first axis."""
    angles = np.radians([turned, turned + degrees])
    moves = length * np.array([np.cos(angles), np.sin(angles), 0.0 * angles]).T
    return np.vstack([np.zeros(3), np.cumsum(moves, axis=0)])


class Corner(NamedTuple):
    degrees: float
    turned: float
    tolerance: float  # um
    loss: float  # ms, at most


# against the speed of 150 mm/s kept throughout, from stop to stop 67.2 to 79.5 ms: within 10, 50 and 100 um
CORNERS = [
    Corner(degrees, turned, tolerance, loss)
    for degrees, turned, losses in [
        (90, 0, (62.6, 51.9, 45.2)),
        (90, 45, (66.2, 58.1, 51.2)),
        (135, 0, (58.5, 49.3, 43.5)),
        (45, 0, (71.4, 66.6, 57.8)),
        (20, 0, (71.8, 50.6, 33.6)),
    ]
    for tolerance, loss in zip((10, 50, 100), losses, strict=True)
]


@pytest.mark.parametrize("case", CORNERS, ids=str)
def test_what_a_corner_costs(case: Corner):
    """Lines of 40 mm at 150 mm/s, the loss at both ends taken off; 0.1 ms more than exact."""
    segments = lines(corner(case.degrees, case.turned), 0.15)
    parts = passed(segments, 1e-6 * case.tolerance)
    found = proof(parts)
    assert found.count == 0, found.faults[0]
    assert found.missed <= 1.0
    ends = sum(time([Part(each, plan_run(each, LIMITS), True)]) for each in joined(segments, np.zeros(2))[0])
    half = ends / 2.0 - 0.04 / 0.15  # of a stop, from both sides
    assert 1e3 * (time(parts) - half - 0.08 / 0.15) <= case.loss


def test_nine_speeds_are_tried_with_each_of_four_shapes_of_a_bump(monkeypatch: pytest.MonkeyPatch):
    """In a corner of 30 degrees, where the last tries bring the speed no nearer than 0.5 %."""
    tries = list[float]()

    def counted(away: float, short: float) -> tuple[float, float]:
        tries.append(away)
        return width(away, short)

    monkeypatch.setattr(planner, "width", counted)
    with interpreted():
        passed(lines(corner(30.0, 10.0), 0.15), 3e-5)
    assert 30 < len(tries) < 42


def test_overlapped_runs_stay_near_the_corner_and_are_smooth():
    """Positions every 0.1 ms, independent of the proof: distance to the lines and of the corner, and differences."""
    tolerance, limit = 5e-5, LIMITS[0]
    for points in (corner(90.0), corner(135.0, 20.0), corner(180.0, 10.0)):
        parts = passed(lines(points, 0.15), tolerance)
        sampler = Sampler(1e-4)
        found = np.concatenate([sampler.sample(each) for each in parts])
        assert len(parts) == 3, "the runs overlap"
        place = found[:, :, 0]
        away = np.min([_distance(place, points[0], points[1]), _distance(place, points[1], points[2])], axis=0)
        assert away.max() <= tolerance
        assert np.linalg.norm(place - points[1], axis=1).min() <= tolerance + 2e-8  # m: between two samples
        assert away.max() + np.linalg.norm(place - points[1], axis=1).min() >= 0.5 * tolerance
        for k in range(3):
            slope = (found[2:, :, k] - found[:-2, :, k]) / 2e-4
            rest = 1e-8 / 6.0 * limit[k + 2] if k < 2 else 1e-4 * limit[3]  # T²/6 of the next but one; the snap jumps
            assert np.abs(slope - found[1:-1, :, k + 1]).max() <= 1.1 * (rest if k else 1e-8 / 6.0 * limit[2]), k
        assert np.abs(found[-1, :, 0] - points[2]).max() <= 1e-6


def _distance(place: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    along = np.clip((place - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
    return np.linalg.norm(place - a - along[:, None] * (b - a), axis=1)


@pytest.mark.parametrize(("lasts", "overlaps"), [(0.7e-4, False), (1.5e-4, True)])
def test_runs_that_overlap_by_less_than_a_tenth_of_a_millisecond_stay_apart(lasts: float, overlaps: bool):
    """Both are s (lasts/2)⁴/24 from a corner of 90 degrees when half of the overlap is over."""
    tolerance = np.sqrt(2.0) * LIMITS[0, 3] * (0.5 * lasts) ** 4 / 24.0
    crossings, parts = Crossings(LIMITS), list[Part]()
    for pieces in joined(lines(corner(90.0), 0.15), np.zeros(2))[0]:
        parts += crossings.add(Part(pieces, plan_run(pieces, LIMITS), True), float(tolerance))
    assert any(part.entering is not None for part in [*parts, *crossings.end()]) is overlaps


@pytest.mark.parametrize("lasts", [1e-3, 3e-3])
def test_a_short_overlap_lasts_as_long_as_the_closed_form(lasts: float):
    """Of two stops with full snap, which lasts 2 ms; 1e-4 of the overlap."""
    tolerance = float(np.sqrt(2.0) * LIMITS[0, 3] * (0.5 * lasts) ** 4 / 24.0)
    (both,) = (part for part in passed(lines(corner(90.0), 0.15), tolerance) if part.entering)
    assert np.sum(both.motion.duration) == pytest.approx(lasts, rel=1e-4)


@pytest.mark.parametrize(("apart", "count"), [(0.7e-12, 2), (1.5e-12, 3)])
def test_phases_that_end_within_1e_12_of_an_overlap_end_together(apart: float, count: int):
    one, two = np.zeros((2, 6)), np.zeros((2, 6))
    one[:, 0], two[:, 0] = (0.5, 0.5), (0.5 + apart, 0.5 - apart)
    assert shared(one, 2, two, 2, 1.0, np.zeros((4, 6)), np.zeros((4, 6))).common == count


def test_arcs_overlap_in_corners_as_lines_do():
    """A lens, planned with 0.8 of the limits: the bend of one arc adds to the snap of the other."""
    lens = joined_up(arc((0.0, 0.0), 0.01, 0.0, 0.5 * np.pi, 0.15), arc((0.01, 0.01), 0.01, np.pi, 1.5 * np.pi, 0.15))
    parts = passed(lens, 5e-5, share=0.8)
    assert len(parts) == 3
    found = proof(parts)
    assert found.count == 0, found.faults[0]
    assert 0.9 <= found.missed <= 1.0
    assert time(parts) <= time(passed(lens, 0.0, share=0.8)) - 0.02


FAULTS = {
    "of its tolerance": lambda part: part._replace(entering=part.entering._replace(tolerance=0.999 * 5e-5)),
    "other pieces of time": lambda part: part._replace(
        entering=part.entering._replace(motion=_later(part.entering.motion))
    ),
    "do not meet": lambda part: part._replace(entering=part.entering._replace(pieces=_moved(part.entering.pieces))),
}


def test_a_part_that_does_not_go_on_from_the_one_before_is_seen():
    one, crossing, rest = passed(lines(corner(90.0), 0.15), 5e-5)
    found = proof([one, crossing, rest._replace(pieces=_moved(rest.pieces))])
    assert any("go on from where the one before" in str(fault) for fault in found.faults)


def _later(motion: Motion) -> Motion:
    return motion._replace(duration=motion.duration + 1e-9)


def _moved(pieces: Pieces) -> Pieces:
    return pieces._replace(origin=pieces.origin + 1e-9)


@pytest.mark.parametrize("said", FAULTS)
def test_a_seeded_fault_of_an_overlap_is_seen(said: str):
    parts = passed(lines(corner(90.0), 0.15), 5e-5)
    assert proof(parts).count == 0
    found = proof([parts[0], FAULTS[said](parts[1]), parts[2]])
    assert any(said in str(fault) for fault in found.faults)


@pytest.mark.parametrize(("turned", "said"), [(0.0, "miss the corner"), (45.0, "the snap of")])
def test_a_run_that_begins_too_early_is_seen(turned: float, said: str):
    """1 ms earlier than the tolerance allows, and 1 ms at all where both runs need the whole snap of an axis."""
    segments = lines(corner(90.0, turned), 0.15)
    one, two = (Part(each, plan_run(each, LIMITS), True) for each in joined(segments, np.zeros(2))[0])
    lasts = 0.0 if turned else time([each for each in passed(segments, 5e-5) if each.entering])
    parts, rest = overlapped(one, two, lasts + 1e-3, 5e-5)
    found = proof([*parts, rest])
    assert any(said in str(fault) for fault in found.faults)


@pytest.mark.parametrize("plateau", [2e-15, 6e-15, 1e-13])
def test_no_place_jumps_where_a_plateau_beside_a_bump_is_as_short_as_rounding(plateau: float):
    """From rest to 36 mm/s and down to a bump: each phase begins where the one before it ends, within 4 ulp."""
    corner, rows = Node(0.02, 0.006, 0.002, 1.0, 0.5), np.zeros((ROWS, 6))
    _, acceleration, jerk, snap = LIMITS[0].tolist()
    line = LineStretch(5e-3, 0.036, acceleration, jerk, snap, Node(0.0), corner)
    count = straight(line, rows)
    longest = int(np.argmax(rows[:count, 0]))
    assert rows[longest, 3:].tolist() == [0.0, 0.0, 0.0]
    line = line._replace(length=line.length - (float(rows[longest, 0]) - plateau) * line.fastest)
    count = straight(line, rows)
    ends = [x + way(v, a, j, s, T) for T, x, v, a, j, s in rows[: count - 1].tolist()]
    assert np.abs(rows[1:count, 1] - ends).max() <= 4.0 * np.spacing(line.length)


@pytest.mark.parametrize(("factor", "said"), [(0.95, "the jerk of"), (1.01, "miss the corner")])
def test_a_bump_that_is_too_short_or_too_long_is_seen(factor: float, said: str):
    """At 17 mm/s in a corner of 20 degrees, with the ramps to it at 0.85 of the jerk and half of the snap."""
    segments = lines(corner(20.0), 0.15)
    runs, speed = joined(segments, np.full(2, 1e-5))[0], 0.017
    wide, short = width(1e-5 / (speed * 2.0 * np.sin(np.radians(10.0))), 0.008)

    def parts(wide: float) -> list[Part]:
        made = list[Part]()
        for number, pieces in enumerate(runs):
            room = (LIMITS[0, 1:] / np.abs(direction(pieces, 0)).max()).tolist()
            corner, rest = Node(speed, wide, short, 0.85, 0.5), Node(0.0)
            rows = np.zeros((ROWS, 6))
            ends = (rest, corner) if number == 0 else (corner, rest)
            n = straight(LineStretch(pieces.length[0], 0.15, *room, *ends), rows)
            columns = [rows[:n, 0], np.zeros(n, np.int64), *rows[:n, 1:].T]
            made.append(Part(pieces, Motion(*(each.copy() for each in columns)), True))
        leaves, rest = overlapped(made[0], made[1], 2.0 * wide + short, 1.0001e-5)
        return [*leaves, rest]

    assert proof(parts(wide)).count == 0, proof(parts(wide)).faults[0]
    found = proof(parts(factor * wide))
    assert any(said in str(fault) for fault in found.faults), found.faults


def test_nothing_is_left_of_a_segment_between_two_blends():
    """Each takes half of it: a piece of 1e-19 m would make the joints before and behind it one."""
    points = np.cumsum([[0, 0, 0], [1.0, 0.1, 0], [1.0, -0.1, 0], [1.0, 0.1, 0], [1.0, -0.1, 0]], axis=0) * 1.7e-4
    (run,), _ = joined(lines(points, 0.15), np.full(4, 1e-4))
    assert run.length.min() > 1e-6
    assert proof([Part(run, plan_run(run, LIMITS), True)]).count == 0


def test_wherever_the_stream_is_cut_overlapping_runs_come_to_a_stop():
    """What has left, what is still open, and the stop in hand of the schedule: proven after each part."""
    draw = np.random.default_rng(9)
    square = np.array([[0.0, 0, 0], [0.02, 0, 0], [0.02, 0.02, 0], [0.0, 0.02, 0], [0.0, 0.001, 0]])
    wave = np.array([[0.0005 * k, 0.0003 * np.sin(0.5 * k), 0.0] for k in range(60)])
    segments = lines(np.vstack([square, wave]) + 1e-5 * draw.normal(size=(65, 3)), 0.15)
    schedule, crossings, before, cuts = Schedule(LIMITS, 20), Crossings(LIMITS), list[Part](), 0
    for section in Joiner().join(Chain(segments, np.full(64, 2e-5), True))[0]:
        for part in schedule.add(section):
            before += crossings.add(part, section.tolerance)
            stop = schedule.stop()
            left = [*copy(crossings).end(), *([stop] if stop else [])]
            assert left[-1].ends
            found = proof([*before, *left])
            assert found.count == 0, found.faults[0]
            cuts += 1
    assert cuts > 6


def zigzag(draw: np.random.Generator, sharpest: float) -> tuple[Pieces, float]:
    """30 lines of one length from 0.1 to 20 mm, corners of 5 to `sharpest` degrees in space, within 1 to 500 um."""
    length, tolerance = 10.0 ** draw.uniform(-4.0, np.log10(0.02)), 10.0 ** draw.uniform(-6.0, np.log10(5e-4))
    t = draw.normal(size=3)
    points = [np.zeros(3)]
    for _ in range(30):
        t /= np.linalg.norm(t)
        points.append(points[-1] + length * t)
        normal = np.cross(t, draw.normal(size=3))
        angle = np.radians(draw.uniform(5.0, sharpest))
        t = np.cos(angle) * t + np.sin(angle) * normal / np.linalg.norm(normal)
    return lines(np.array(points), 0.15), tolerance


def _zigzags(sharpest: float, count: int) -> list[float]:
    """Times as shares of those from stop to stop, seed 21."""
    draw, ratios = np.random.default_rng(21), list[float]()
    for number in range(count):
        segments, tolerance = zigzag(draw, sharpest)
        parts = passed(segments, tolerance)
        found = proof(parts)
        assert found.count == 0, f"path {number}: {found.faults[0]}"
        assert found.missed <= 1.0 + 1e-9
        ratios.append(time(parts) / stopped(segments))
    assert max(ratios) <= 1.0
    return ratios


@pytest.mark.parametrize("sharpest", [175.0, 45.0])
def test_zigzags_are_never_slower_than_from_stop_to_stop(sharpest: float):
    _zigzags(sharpest, 2)


@pytest.mark.slow(reason="40 zigzags of 30 lines each, where the quick tests have two")
@pytest.mark.parametrize(("sharpest", "mean"), [(175.0, 0.84), (45.0, 0.78)])
def test_zigzags_take_less_time_than_from_stop_to_stop(sharpest: float, mean: float):
    assert np.mean(_zigzags(sharpest, 40)) <= mean


def test_runs_of_a_square_overlap_by_half_of_a_side():
    """The directions share no axis, and the tolerance is as long as a side; 1e-5 of the time of a side."""
    square = lines(np.array([[0.0, 0, 0], [1e-3, 0, 0], [1e-3, 1e-3, 0], [0.0, 1e-3, 0]]), 0.15)
    sections = [Section(part_of_pieces(square, k, k + 1), True, 1e-3) for k in range(3)]
    parts = list(Planner(LIMITS).along(sections, True))
    both = [float(np.sum(part.motion.duration)) for part in parts if part.entering]
    assert both == pytest.approx([0.5 * stopped(square) / 3.0] * 2, rel=1e-5)


def test_lines_planned_at_once_move_as_one_after_the_other(monkeypatch: pytest.MonkeyPatch):
    """Zigzags in space with stops and arcs between, in groups of seven and alone behind an arc; to rounding."""
    monkeypatch.setattr(schedule_planner, "MANY", 7)
    draw = np.random.default_rng(8)
    for sharpest, tolerance in ((45.0, None), (175.0, None), (175.0, 0.0), (90.0, 1e-3)):
        segments, drawn = zigzag(draw, sharpest)
        tolerances = np.full(30, drawn if tolerance is None else tolerance)
        tolerances[[5, 6, 20]] = 0.0
        runs, joint = joined(segments, tolerances)
        corners = tolerances[: len(joint.stop)][joint.stop == 1]
        sections = [Section(pieces, True, corner) for pieces, corner in zip(runs, corners.tolist(), strict=True)]
        bow = Section(arc((0.0, 0.0), 0.01, 0.0, 0.5 * np.pi, 0.15), True, drawn)
        sections[12:12] = sections[14:14] = [bow]
        alone = Crossings(LIMITS)
        expected = list[Part]()
        for section in sections:
            motion = plan_run(section.pieces, LIMITS)
            expected += alone.add(Part(section.pieces, motion, True), section.tolerance)
        expected += alone.end()
        planned, lines_alone = Crossings(LIMITS), Planner(LIMITS)
        found = list[Part]()
        for scheduled in lines_alone.scheduled(sections):
            if isinstance(scheduled, Lines):
                found += planned.add_lines(scheduled)
            else:
                found += planned.add(scheduled.part, scheduled.tolerance)
        found += planned.end()
        assert len(found) == len(expected)
        for one, other in zip(found, expected, strict=True):
            assert one.ends == other.ends
            both = [(one.pieces, other.pieces), (one.motion, other.motion)]
            assert (one.entering is None) == (other.entering is None)
            if one.entering is not None and other.entering is not None:
                assert one.entering.tolerance == other.entering.tolerance
                both += [(one.entering.pieces, other.entering.pieces), (one.entering.motion, other.entering.motion)]
            for left, right in both:
                for column, wanted in zip(left, right, strict=True):
                    # sums of durations in another order
                    np.testing.assert_allclose(column, wanted, rtol=1e-9, atol=1e-9 * max(1e-30, np.abs(wanted).max()))


def _polyline(draw: np.random.Generator) -> Pieces:
    """Of one scale, of lengths over decades, along axes, or there and back; fed at 0.1 mm/s to 1 m/s, or traversed."""
    n, kind, scale = int(draw.integers(2, 25)), int(draw.integers(0, 4)), 10.0 ** draw.uniform(-6.0, -0.5)
    moves = draw.normal(size=(n, 3)) * scale
    if kind == 1:
        moves *= 10.0 ** draw.uniform(-5.0, 0.0, size=(n, 1))
    elif kind == 2:
        moves *= np.eye(3)[draw.integers(0, 3, n)]
    elif kind == 3:
        moves = moves[:, :1] * draw.normal(size=3)
    feed = 10.0 ** draw.uniform(-4.0, 0.0) if draw.random() < 0.9 else np.inf
    return lines(np.vstack([np.zeros(3), np.cumsum(moves, axis=0)]), feed)


def _polylines(count: int, seed: int) -> None:
    draw = np.random.default_rng(seed)
    for number in range(count):
        limits = random_limits(draw) * 10.0 ** draw.uniform(-0.5, 0.5, size=LIMITS.shape)
        found = proof(passed(_polyline(draw), 10.0 ** draw.uniform(-6.5, -3.0), limits), limits)
        assert found.count == 0, f"path {number}: {found.faults[0]}"
        assert found.missed <= 1.0 + 1e-9


def test_no_limit_is_broken_where_runs_overlap(seeded: Seeded):
    """Polylines within 0.3 um to 1 mm, unequal axes, limits over decades."""
    _polylines(15, seeded(4))


@pytest.mark.slow(reason="500 random polylines, where the quick test has 15")
def test_no_limit_is_broken_where_many_runs_overlap():
    _polylines(500, 5)


def test_a_line_leaves_room_for_the_bend_of_the_arc_that_it_meets():
    """A half disc: the line takes 0.93 of its jerk, and both overlap by 41 ms; with all of it they cannot."""
    half = joined_up(arc((0.0, 0.0), 0.01, 0.0, np.pi, 0.15), lines(np.array([[-0.01, 0, 0], [0.01, 0, 0]]), 0.15))
    for segments in (half, _reversed(half)):
        parts = passed(segments, 5e-5)
        assert [each.entering is not None for each in parts] == [False, True, False]
        found = proof(parts)
        assert found.count == 0, found.faults[0]
        assert time(parts) <= time(passed(segments, 0.0)) - 0.035


def _reversed(segments: Pieces) -> Pieces:
    """The line first, then the arc."""
    line, bow = (Pieces(*(each[k : k + 1] for each in segments)) for k in (1, 0))
    return joined_up(line, bow)


LENS = (arc((0.0, 0.0), 0.01, 0.0, 0.5 * np.pi, 0.15), arc((0.01, 0.01), 0.01, np.pi, 1.5 * np.pi, 0.15))


def _lens() -> list[Part]:
    """Two arcs that meet at 90 degrees, each lifted."""
    return [next(Lifter(LIMITS).add(Part(each, plan_run(each, LIMITS), True))) for each in LENS]


def _at(part: Part, t: float) -> np.ndarray:
    """q' to q'''' of a part in which one piece is run, at a time from its start, shape (N, 4)."""
    whole, rates = np.append(0.0, np.cumsum(part.motion.duration)), np.zeros((3, 5))
    m = int(np.clip(np.searchsorted(whole, t, side="right") - 1, 0, len(part.motion.duration) - 1))
    _, x, v, a, j, s = moved.python(
        Interval(*(float(column[m]) for column in (part.motion.duration, *part.motion[2:]))), t - whole[m]
    )
    derivatives(int(part.pieces.kind[0]), float(part.pieces.length[0]), part.pieces.shape[0], x, rates)
    out = np.zeros((3, 5))
    chain(v, a, j, s, rates, out)
    return out[:, 1:]


@pytest.mark.parametrize(("lasts", "above"), [(0.3, 1.06), (0.6, 1.06)])
def test_the_use_of_limits_by_two_arcs_is_that_at_instants(lasts: float, above: float):
    """At 400 instants velocity to jerk are at most what is found, and hardly less: curvature counts as it is there."""
    parts = _lens()
    end, begin = _end(parts[0], True), _end(parts[1], False)
    lasts *= min(end.lasts, begin.lasts)
    for k, limits in enumerate(np.where(np.eye(4)[:3, None] == 1.0, LIMITS, 1e12)):
        use, _, slower = together(end, begin, lasts, limits, 1e12)
        sums = [_at(parts[0], end.lasts - lasts + t) + _at(parts[1], t) for t in np.linspace(0.0, lasts, 400)[1:-1]]
        largest = float(np.max(np.abs(sums) / limits))
        assert largest * (1.0 - 1e-9) <= use <= above * largest
        assert slower == pytest.approx(use ** (1.0 / (k + 1)), rel=1e-12)


def test_two_arcs_are_both_slower_where_their_sum_is_above_a_limit_by_little():
    """Limits that the arcs break by up to 4 %: as they are they overlap by 2 ms; slower they take 22 ms less."""
    parts = _lens()
    end, begin = _end(parts[0], True), _end(parts[1], False)
    lower = 0.96 * LIMITS
    crossings = Crossings(lower)
    found = [*crossings.add(parts[0], 5e-5), *crossings.add(parts[1], 0.0), *crossings.end()]
    assert proof(found).count == 0, proof(found).faults[0]
    as_they_are = overlap(end, begin, min(end.lasts, begin.lasts), 5e-5, lower)
    assert time(found) < time(parts) - as_they_are - 0.008
    lasts, factor = slower_overlap(end, begin, 0.1, 5e-5, lower, time(parts), 0.0)
    assert 1.0 < factor < 1.1
    use, away, _ = together(_slow(end, factor), _slow(begin, factor), lasts, lower, 0.15)
    assert 0.99 < use <= 1.0 + 1e-9
    assert away <= 5e-5


def _slow(end: End, factor: float) -> End:
    """The end of a run that takes `factor` times as long."""
    return end._replace(
        motion=rows(slowed(from_rows(np.asarray(end.motion), 0), factor)),
        lasts=factor * end.lasts,
    )

"""Clusters of short lines: the tolerance against an independent distance, ends, feeds, cycle times of programs."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from paths import LIMITS, lines
from test_plan_program import LOGS, logged, moving, proven

from feeddrive.language.kernels.kernel import interpreted
from feeddrive.path.geometry.joints import Ended, Joiner, Joint, join, joined
from feeddrive.path.geometry.segments import Chain
from feeddrive.path.motion import LINE, Part, Pieces, Section, derivatives, part_of_pieces
from feeddrive.path.program.moves import Feed, Move, PathMode
from feeddrive.path.program.reading import read_program
from feeddrive.path.proof import Prover
from feeddrive.path.schedule.run import Schedule, plan_run
from feeddrive.path.setpoints import planned

PUBLIC = LOGS.parent / "gcode" / "linuxcnc"
DRAW = np.random.default_rng(13)


def circle(radius: float, chord: float, turn: float) -> np.ndarray:
    """Corners of chords on an arc, m and rad."""
    angle = np.arange(0.0, turn, 2.0 * np.arcsin(0.5 * chord / radius))
    return radius * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])


def spiral(chord: float, count: int) -> np.ndarray:
    radius = 0.002 + 1e-4 * chord * np.arange(count)
    angle = np.cumsum(chord / radius)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), 1e-3 * angle])


def noisy(step: float, noise: float, count: int) -> np.ndarray:
    x = step * np.arange(count)
    return np.column_stack([x, noise * (np.arange(count) % 2), 0.0 * x])


def with_corner() -> np.ndarray:
    """Chords of 50 um on two arcs that meet at a right angle."""
    one = circle(0.01, 5e-5, 0.5)
    return np.vstack([one, one[-1] + (one[-1] - one[::-1])[1:, [1, 0, 2]] * [-1, 1, 1]])


def points(pieces: Pieces, count: int) -> np.ndarray:
    """Positions along pieces."""
    found, r = [], np.zeros((3, 5))
    for k, length in enumerate(pieces.length):
        for x in np.linspace(0.0, length, count):
            derivatives(int(pieces.kind[k]), length, pieces.shape[k], x, r)
            found.append(pieces.origin[k] + r[:, 0])
    return np.array(found)


def distance(places: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Of each place to a polyline, m."""
    least = np.full(len(places), np.inf)
    for a, b in pairwise(corners):
        way = b - a
        share = np.clip((places - a) @ way / (way @ way), 0.0, 1.0)
        least = np.minimum(least, np.linalg.norm(places - a - share[:, None] * way, axis=1))
    return least


def rounded(corners: np.ndarray, tolerance: float, feed: float = 0.1) -> tuple[list[Pieces], Joint]:
    segments = lines(corners, feed)
    return joined(segments, np.full(len(segments.length), tolerance))


@pytest.mark.parametrize(
    ("corners", "tolerance"),
    [
        (circle(0.02, 1e-3, 1.0), 1e-5),
        (circle(0.001, 1e-5, 1.5), 1e-5),
        (circle(0.001, 1e-6, 0.1), 1e-6),
        (spiral(1e-4, 120), 5e-6),
        (noisy(5e-6, 1e-6, 120), 1e-5),
        (noisy(1e-5, 1e-5, 25), 2e-6),
        (with_corner(), 1e-5),
        (np.cumsum(1e-4 * DRAW.normal(size=(40, 3)), axis=0), 3e-5),
    ],
    ids=["chords 1 mm", "chords 10 um", "chords 1 um", "spiral", "zigzag", "rough zigzag", "corner", "random"],
)
def test_clusters_keep_the_tolerance_and_the_limits(corners: np.ndarray, tolerance: float) -> None:
    """Both ways: dense points to the lines, 1 pm for rounding; corners to the path, 10 nm for the chords of the points.

    Then the proof of its motion.
    """
    runs, joint = rounded(corners, tolerance)
    path = np.vstack([points(run, 40) for run in runs])
    assert distance(path, corners).max() <= joint.deviation.max() + 1e-12
    steps = np.append(True, np.any(np.diff(path, axis=0) != 0.0, axis=1))
    assert distance(corners, path[steps]).max() <= tolerance + 1e-8
    assert joint.deviation.max() <= tolerance
    assert np.abs(path[0] - corners[0]).max() <= 1e-15
    assert np.abs(path[-1] - corners[-1]).max() <= 1e-15
    prover = Prover(LIMITS)
    for run in runs:
        prover.prove(Part(run, plan_run(run, LIMITS), True))
    assert prover.proof().count == 0, prover.proof().faults[0]
    assert prover.proof().jump <= 1e-11


def test_a_zigzag_that_needs_many_refinements_is_a_cluster() -> None:
    """Of 1.5 um within 1 um; corners that are rounded one by one use a quarter of their tolerance."""
    _, joint = rounded(noisy(5e-6, 1.5e-6, 60), 1e-6)
    assert joint.deviation.max() > 0.9e-6


def test_a_corner_in_smooth_chords_is_a_stop_and_one_in_noise_is_none() -> None:
    _, joint = rounded(with_corner(), 1e-5)
    assert np.flatnonzero(joint.stop[:-1]).tolist() == [len(circle(0.01, 5e-5, 0.5)) - 2]
    _, joint = rounded(noisy(1e-6, 1e-6, 300), 1e-5)
    assert not joint.stop[:-1].any()


def test_a_corner_between_clusters_shares_its_tolerance_with_them() -> None:
    """Runs overlap in nine tenths of it where a spline begins or ends, whose first and last span keep one tenth."""
    corners = with_corner()
    segments = lines(corners, 0.1)
    one, two = Joiner().join(Chain(segments, np.full(len(segments.length), 1e-5), True))[0]
    assert one.tolerance == pytest.approx(9e-6)
    for pieces in (part_of_pieces(one.pieces, len(one.pieces.length) - 1, len(one.pieces.length)), two.pieces):
        assert distance(points(part_of_pieces(pieces, 0, 1), 40), corners).max() <= 1e-6
    square = lines(np.array([[0.0, 0.0, 0.0], [0.02, 0.0, 0.0], [0.02, 0.02, 0.0]]), 0.1)
    assert Joiner().join(Chain(square, np.full(2, 1e-5), True))[0][0].tolerance == 1e-5


def test_lines_of_nearly_no_length_are_smoothed_with_the_others() -> None:
    """Down to 1e-17 m between lines of 0.1 mm, back and forth: proven; the path ends on the last corner."""
    draw = np.random.default_rng(17)
    moves = 10.0 ** draw.uniform(-17.0, -4.0, (60, 1)) * draw.normal(size=(60, 3))
    moves[::4] = [1e-4, 0.0, 0.0]
    corners = 0.05 + np.cumsum(moves, axis=0)
    corners = corners[np.append(True, np.any(np.diff(corners, axis=0) != 0.0, axis=1))]
    runs, joint = rounded(corners, 1e-5)
    assert joint.deviation.max() <= 1e-5
    prover = Prover(LIMITS)
    assert all(prover.prove(Part(run, plan_run(run, LIMITS), True)) for run in runs), prover.proof().faults[0]
    assert np.abs(runs[-1].origin[-1] + ends_at(runs[-1]) - corners[-1]).max() <= 1e-15


def test_a_cluster_that_cannot_be_fitted_has_blends_and_stops() -> None:
    """Points on a line but for rounding, within less than rounding: no path but with stops, and the same ends."""
    corners = np.linspace([0.01, 0.0, 0.0], [0.011, 0.003, 0.002], 1001)
    runs, joint = rounded(corners, 1e-25)
    assert joint.deviation.max() <= 1e-25
    assert len(runs) == joint.stop.sum() > 100
    assert np.abs(runs[-1].origin[-1] + ends_at(runs[-1]) - corners[-1]).max() <= 1e-15


def test_collinear_points_are_one_line() -> None:
    """1e5 of them: the time of one line, within 1e-12 where the directions are equal to the bit, 1e-9 where not."""
    for end, within in (([0.1, 0.0, 0.0], 1e-12), ([0.03, 0.05, 0.08], 1e-9)):
        whole = np.array([[0.0, 0.0, 0.0], end])
        many = np.linspace(whole[0], whole[1], 100_001)
        (run,), _ = rounded(many, 1e-5)
        (one,), _ = rounded(whole, 1e-5)
        assert len(run.length) <= 20
        took, least = (float(np.sum(plan_run(each, LIMITS).duration)) for each in (run, one))
        assert took == pytest.approx(least, rel=within)


def test_straight_parts_stay_lines_and_neighbors_keep_their_blends() -> None:
    """Lines of 40 mm on both sides of short chords; their other ends are corners of a third of a degree with blends."""
    short = circle(0.005, 1e-4, 0.3)
    first, last = short[1] - short[0], short[-1] - short[-2]
    before = short[0] - 400.0 * first
    after = short[-1] + 400.0 * last
    turned = np.array([[np.cos(0.006), -np.sin(0.006), 0.0], [np.sin(0.006), np.cos(0.006), 0.0], [0.0, 0.0, 1.0]])
    corners = np.vstack([before - 400.0 * turned @ first, before, short, after, after + 400.0 * turned @ last])
    (run,), joint = rounded(corners, 1e-5)
    kinds = "".join("l" if kind == LINE else "p" for kind in run.kind)
    assert kinds.startswith("l" + 8 * "p" + "lp")
    assert kinds.endswith("pl" + 8 * "p" + "l")
    assert joint.deviation[[0, -2]] == pytest.approx(1e-5, rel=0.01)
    assert run.length[kinds.index("lp", 3)] >= 0.027  # of 40 mm, of which the blend takes 10.7 mm


def test_each_piece_keeps_the_slowest_feed_and_the_line_of_what_it_smooths() -> None:
    segments = lines(circle(0.02, 1e-4, 0.5), 0.1)
    n = len(segments.length)
    segments = segments._replace(feed=np.where(np.arange(n) == n // 2, 0.02, 0.1))
    (run,), _ = joined(segments, np.full(n, 1e-5))
    begins = np.append(0.0, np.cumsum(run.length))
    corners = np.append(0.0, np.cumsum(segments.length))
    slow = (begins[1:] > corners[n // 2]) & (begins[:-1] < corners[n // 2 + 1])
    assert slow.any()
    assert run.feed.tolist() == np.where(slow, 0.02, 0.1).tolist()
    assert (corners[run.line] <= begins[:-1] + 1e-12).all()
    assert (corners[run.line + 1] >= begins[:-1] - 1e-12).all()


def streamed(segments: Pieces, tolerance: float, chunk: int, held: int) -> tuple[list[Section], np.ndarray, int]:
    """Sections, the bound of each joint's distance, and the most lines that are waited with."""
    n = len(segments.length)
    joiner, found, deviation, waits = Joiner(held=held), list[Section](), list[np.ndarray](), 0
    for first in range(0, n, chunk):
        last = min(first + chunk, n)
        chain = Chain(part_of_pieces(segments, first, last), np.full(last - first, tolerance), last == n)
        sections, joint = joiner.join(chain)
        found += sections
        deviation.append(joint.deviation)
        waits = max(waits, last - sum(map(len, deviation)))
    return found, np.concatenate(deviation), waits


def test_a_long_cluster_goes_on_from_window_to_window() -> None:
    """Windows of 50 lines, 200 held: one run, C3 to rounding, whole in the tolerance, and as fast but for 3 %."""
    corners = spiral(1e-4, 1000)
    segments = lines(corners, 0.1)
    sections, deviation, waits = streamed(segments, 5e-6, 50, 200)
    assert [each.ends for each in sections] == [False] * (len(sections) - 1) + [True]
    assert len(sections) > 5
    assert waits <= 250
    assert len(deviation) == len(segments.length)
    assert deviation.max() <= 5e-6
    path = np.vstack([points(each.pieces, 3) for each in sections])
    assert distance(path, corners).max() <= deviation.max() + 1e-12
    assert np.abs(path[-1] - corners[-1]).max() <= 1e-15
    prover, schedule, took = Prover(LIMITS), Schedule(LIMITS), 0.0
    for part in (part for each in sections for part in schedule.add(each)):
        prover.prove(part)
        took += float(np.sum(part.motion.duration))
    assert prover.proof().count == 0, prover.proof().faults[0]
    assert prover.proof().jump <= 1e-12
    (whole,), _ = rounded(corners, 5e-6)
    assert took <= 1.03 * float(np.sum(plan_run(whole, LIMITS).duration))


def test_a_spline_that_cannot_go_on_stops_behind_the_lines_it_knows(monkeypatch: pytest.MonkeyPatch) -> None:
    corners = spiral(1e-4, 1000)
    segments = lines(corners, 0.1)
    calls = []

    def fails_once(*given: object) -> Ended:
        calls.append(1)
        return Ended(0, 0, -1, 0.0, 0, 0) if len(calls) == 12 else join(*given)  # pyright: ignore[reportArgumentType]

    monkeypatch.setattr("feeddrive.path.geometry.joints.join", fails_once)
    sections, deviation, _ = streamed(segments, 5e-6, 50, 200)
    assert sum(each.ends for each in sections) == 2
    assert len(deviation) == len(segments.length)
    assert deviation.max() <= 5e-6
    place = next(k for k, each in enumerate(sections) if each.ends)
    tip = points(sections[place].pieces, 2)[-1]
    assert np.linalg.norm(corners - tip, axis=1).min() <= 1e-15
    prover, schedule = Prover(LIMITS), Schedule(LIMITS)
    assert all(prover.prove(part) for each in sections for part in schedule.add(each)), prover.proof().faults[0]
    apart = [a.pieces.origin[-1] + ends_at(a.pieces) - b.pieces.origin[0] for a, b in pairwise(sections)]
    assert np.abs(apart).max() <= 1e-15


def ends_at(pieces: Pieces) -> np.ndarray:
    """r of the last piece's end, from its origin."""
    r = np.zeros((3, 5))
    derivatives(int(pieces.kind[-1]), pieces.length[-1], pieces.shape[-1], pieces.length[-1], r)
    return r[:, 0]


def test_the_interpreter_and_the_processor_agree() -> None:
    corners = np.vstack([circle(0.002, 2e-4, 0.4), np.array([0.002, 0.002, 0.0]) + noisy(1e-5, 3e-6, 6)])
    (run, *_), joint = rounded(corners, 1e-5)
    with interpreted():
        (other, *_), same = rounded(corners, 1e-5)
    assert all(np.array_equal(a, b) for a, b in zip((*run, *joint), (*other, *same), strict=True))


def test_a_pocket_of_chords_takes_little_more_than_a_quarter_of_the_time_of_linuxcnc() -> None:
    """At equal limits; ours keeps a snap limit, too."""
    theirs = logged("spiral_pocket_jerk100.csv.gz")
    proof, found = proven(LOGS / "spiral_pocket.ngc")
    assert proof.count == 0
    assert moving(found) <= 0.28 * theirs


def public(name: str) -> Path:
    if not (PUBLIC / name).exists():
        pytest.skip(f"NOT PLANNED: {PUBLIC / name} is not there")
    return PUBLIC / name


@pytest.mark.slow(reason="4,684 lines are planned: 3 s")
def test_corners_of_a_few_degrees_take_at_most_67_s() -> None:
    """3D_Chips, with 0.1 mm; 59.2 s."""
    proof, found = proven(public("3D_Chips.ngc"))
    assert proof.count == 0
    assert moving(found) <= 67.0


def test_arcs_that_nearly_touch_are_passed_at_the_feed() -> None:
    """Ten times its feed, within 10 um: 26.5 s.  Caps that differ by 1e-7 had taken 31.4 s, with ramps between them."""
    prover, found = Prover(LIMITS), []
    moves = (_faster(each) for each in read_program(public("arcspiral.ngc")))
    for each in planned(moves, "XYZ", LIMITS):
        found.append(each)
        if isinstance(each, Part):
            prover.prove(each)
    assert prover.proof().count == 0
    assert moving(found) <= 27.3


def _faster(move: Move) -> Move:
    if isinstance(move, Feed):
        return replace(move, linear=10.0 * move.linear)
    return replace(move, tolerance=1e-5) if isinstance(move, PathMode) else move

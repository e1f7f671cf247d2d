"""Motions along runs: closed forms, limits proven on random paths, faults that the proof must see, samples."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest
from paths import LIMITS, arc, lines, random_curve, random_limits, square

from feeddrive.path.geometry.joints import joined
from feeddrive.path.motion import Motion, Part, Pieces, Section, derivatives, part_of_pieces, piece_of
from feeddrive.path.proof import Proof, Prover
from feeddrive.path.schedule.ramp import bounds, boxcars, cube_root
from feeddrive.path.schedule.run import Schedule, plan_run
from feeddrive.path.setpoints import Sampler


def proof(pieces: Pieces, motion: Motion, limits: np.ndarray = LIMITS) -> Proof:
    prover = Prover(limits)
    prover.prove(Part(pieces, motion, True))
    return prover.proof()


def duration(motion: Motion) -> float:
    return float(np.sum(motion.duration))


def test_the_cube_root_is_within_two_units_of_the_last_place():
    draw = random.Random(1)
    for x in [0.0, 1.0, 8.0, 0.125, 5e-324, 1.7e308, *(10.0 ** draw.uniform(-300, 300) for _ in range(300))]:
        assert abs(cube_root(x) - math.cbrt(x)) <= 2.0 * math.ulp(math.cbrt(x))
    with pytest.raises(ValueError, match="from 0 on"):
        cube_root(-1.0)


@pytest.mark.parametrize(
    ("step", "widths"),
    [
        (1e-6, (1e-11 ** (1 / 3), 1e-11 ** (1 / 3), 2 * 1e-11 ** (1 / 3))),  # snap alone: dv = 2 S L1³
        (0.1, (0.002, (-0.002 + math.sqrt(4e-6 + 4e-3)) / 2, (0.002 + math.sqrt(4e-6 + 4e-3)) / 2)),  # and jerk
        (10.0, (0.002, 0.05, 2.0)),  # and acceleration
    ],
)
def test_closed_forms_of_the_widths_of_a_ramp(step: float, widths: tuple[float, float, float]):
    assert boxcars(step, 5.0, 100.0, 5e4) == pytest.approx(widths, rel=1e-14)


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.6, 0.8, 0.0), (-0.48, 0.6, 0.64)])
@pytest.mark.parametrize(("way", "feed"), [(0.3, 0.15), (0.3, 10.0), (1e-3, 0.15), (1e-6, 1.0)])
def test_a_straight_move_takes_the_time_of_the_closed_form(
    direction: tuple[float, float, float], way: float, feed: float
):
    """Two ramps and a plateau; the peak of a move that is too short for its feed by bisection. 1e-3 of the time."""
    largest = max(map(abs, direction))
    v, a, j, s = (0.5 / largest, 5.0 / largest, 100.0 / largest, 5e4 / largest)
    high = min(feed, v)
    if high * sum(boxcars(high, a, j, s)) > way:
        low = 0.0
        for _ in range(100):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if middle * sum(boxcars(middle, a, j, s)) <= way else (low, middle)
        high = low
    ramp = sum(boxcars(high, a, j, s))
    exact = 2.0 * ramp + (way - high * ramp) / high
    pieces = lines(np.array([np.zeros(3), way * np.array(direction)]), feed)
    motion = plan_run(pieces, LIMITS)
    assert duration(motion) == pytest.approx(exact, rel=1e-3)
    assert duration(motion) >= exact * (1.0 - 1e-9)
    assert proof(pieces, motion).count == 0


@pytest.mark.parametrize("feed", [0.05, 0.1, 0.25, 0.5, 2.0])
def test_a_circle_is_passed_at_its_feed_or_near_what_its_curvature_allows(feed: float):
    """Caps by acceleration, jerk and snap: (a R)^1/2, (j R²)^1/3, (s R³)^1/4; seven or nine tenths are used."""
    R = 0.02
    cap = min(math.sqrt(5.0 * R), (100.0 * R**2) ** (1 / 3), (5e4 * R**3) ** 0.25)
    pieces = arc((0.0, 0.0), R, 0.0, 4.0 * np.pi, feed)
    motion = plan_run(pieces, LIMITS)
    held = [min(feed, share * cap) for share in (0.9, 0.7)]
    # plateaus stay 6e-7 below, so that lifting can begin on them
    assert min(abs(motion.speed.max() / each - 1.0) for each in held) <= 1e-6
    found = proof(pieces, motion)
    assert found.count == 0
    # on the plateau both axes see v²/R at some time: the look at begin and middle of spans misses little of it
    assert found.use[:2, 1].max() <= motion.speed.max() ** 2 / R / 5.0 + motion.acceleration.max() / 5.0


def test_blends_of_nearly_the_same_corners_take_nearly_the_same_time():
    """From 64 to 92 degrees by 4 degrees, within 0.1 mm: the fastest ramps of some need many passes."""
    times = []
    for degrees in range(64, 93, 4):
        end = 0.03 * np.array([1.0 + math.cos(math.radians(degrees)), math.sin(math.radians(degrees)), 0.0])
        segments = lines(np.array([[0.0, 0.0, 0.0], [0.03, 0.0, 0.0], end]), 0.3)
        (run,), _ = joined(segments, np.full(2, 1e-4), sharpest=4.0, lonely=np.inf)
        times.append(duration(plan_run(run, LIMITS)))
    assert np.abs(np.diff(np.log(times))).max() <= 0.01


@pytest.mark.parametrize(("radius", "way"), [(0.005, 0.01), (0.01, 0.01), (0.02, 0.02)])
def test_two_ramps_fill_an_arc_that_is_too_short_for_its_feed(radius: float, way: float):
    motion = plan_run(arc((0.0, 0.0), radius, 0.0, way / radius, 0.5), LIMITS)
    flat = (motion.acceleration == 0.0) & (motion.jerk == 0.0) & (motion.snap == 0.0)
    assert np.sum((motion.duration * motion.speed)[flat]) <= 1e-3 * way


@pytest.mark.parametrize("feed", [0.02, 0.05, 0.1])
def test_ramps_on_a_circle_use_the_bound_of_a_limit(feed: float):
    """By the chain rule with |r^(k)| = R^(1-k); a ramp that lasts 0.3 % too long takes 1 % less of the snap."""
    R = 0.02
    pieces = arc((0.0, 0.0), R, 0.0, 0.5 * np.pi, feed)
    motion = plan_run(pieces, LIMITS)
    v, a, j, s = (float(np.abs(column).max()) for column in motion[3:])
    acceleration = (v**2 / R + a) / 5.0
    jerk = (v**3 / R**2 + 3.0 * v * a / R + j) / 100.0
    snap = (v**4 / R**3 + 6.0 * v**2 * a / R**2 + (3.0 * a**2 + 4.0 * v * j) / R + s) / 5e4
    assert 0.98 <= max(acceleration, jerk, snap) <= 1.0 + 1e-9


def test_a_proof_states_the_largest_use_of_a_straight_move():
    """Exact: a line takes the shares of its ramp, at the ends of its phases."""
    pieces = lines(np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0]]), 0.15)
    found = proof(pieces, plan_run(pieces, LIMITS))
    widths = boxcars(0.15, 5.0, 100.0, 5e4)
    assert found.use[0] == pytest.approx([0.3, 0.15 / widths[2] / 5.0, 1.0, 1.0], rel=1e-6)
    assert (found.use[1:] == 0.0).all()
    assert "every limit holds" in str(found)


def test_a_slow_line_near_the_start_of_a_long_curve_leaves_a_plan():
    """5 mm at 42 mm/s, 2 mm at 2.1 mm/s, chords at 17 mm/s: of 40 peaks, each 3 % lower, none was low enough."""
    angle = 0.05 * np.arange(100)
    curve = 0.03 * np.column_stack([np.sin(angle), np.cos(angle) - 1.0, 0.0 * angle])
    segments = lines(np.vstack([[[-0.007, 0.0, 0.0], [-0.002, 0.0, 0.0]], curve]), 0.0169)
    feed = segments.feed.copy()
    feed[:2] = 0.0423, 0.0021
    (run,), _ = joined(segments._replace(feed=feed), np.full(len(feed), 1e-5))
    motion = plan_run(run, LIMITS)
    prover = Prover(LIMITS)
    assert prover.prove(Part(run, motion, True)), prover.proof().faults[0]
    assert float(np.sum(motion.duration)) <= 1.05 * float(np.sum(segments.length / feed))


def test_no_limit_is_broken_on_random_curves():
    """In continuous time, by the interval proof, joints included; limits over decades, unequal axes, seed 1."""
    draw = np.random.default_rng(1)
    for number in range(40):
        limits, pieces = random_limits(draw), random_curve(draw)
        found = proof(pieces, plan_run(pieces, limits), limits)
        assert found.count == 0, f"path {number}: {found.faults[0]}"
        assert found.jump <= 1e-9


def test_no_limit_is_broken_on_random_polylines():
    """Corners of any angle, rounded within tolerances of 1 to 300 um, seed 2."""
    draw = np.random.default_rng(2)
    for number in range(15):
        limits = random_limits(draw)
        points = np.cumsum(draw.normal(size=(int(draw.integers(2, 30)), 3)) * 10.0 ** draw.uniform(-5, -1.5), axis=0)
        tolerance = 10.0 ** draw.uniform(-6.0, -3.5)
        segments = lines(points, 10.0 ** draw.uniform(-3.0, 0.0))
        runs, joint = joined(segments, np.full(len(segments.length), tolerance), sharpest=4.0)
        assert joint.deviation.max() <= tolerance
        for pieces in runs:
            found = proof(pieces, plan_run(pieces, limits), limits)
            assert found.count == 0, f"path {number}: {found.faults[0]}"
            assert found.jump <= 1e-9


@pytest.mark.slow(reason="a thousand random curves and polylines, where the quick tests have 55")
def test_no_limit_is_broken_on_many_random_paths():
    draw = np.random.default_rng(3)
    for number in range(1000):
        limits, pieces = random_limits(draw), random_curve(draw)
        found = proof(pieces, plan_run(pieces, limits), limits)
        assert found.count == 0, f"path {number}: {found.faults[0]}"


def test_a_rounded_square_is_quicker_than_with_stops_at_its_corners():
    segments = square(0.06, 0.005, 0.15)
    runs, joint = joined(segments, np.full(8, 1e-5))
    assert len(runs) == 1
    assert joint.deviation.max() <= 1e-5
    motion = plan_run(runs[0], LIMITS)
    found = proof(runs[0], motion)
    assert found.count == 0
    stops = sum(duration(plan_run(pieces, LIMITS)) for pieces in joined(segments, np.zeros(8))[0])
    assert duration(motion) < 0.8 * stops


FAULTS = {
    "the velocity": lambda pieces, motion, limits: (pieces, motion, limits * [0.299999, 1, 1, 1]),
    "the jerk": lambda pieces, motion, limits: (pieces, motion, limits * [1, 1, 1 - 1e-6, 1]),
    "the snap": lambda pieces, motion, limits: (pieces, motion, limits * [1, 1, 1, 1 - 1e-6]),
    "the motion jumps": lambda pieces, motion, limits: (pieces, motion._replace(speed=motion.speed + 1e-7), limits),
    "runs backwards": lambda pieces, motion, limits: (pieces, motion._replace(duration=0.0 * motion.duration), limits),
    "the feed": lambda pieces, motion, limits: (pieces._replace(feed=pieces.feed * (1 - 1e-6)), motion, limits),
}


@pytest.mark.parametrize("said", FAULTS)
def test_a_seeded_fault_of_a_straight_move_is_seen(said: str):
    pieces = lines(np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0]]), 0.15)
    found = proof(*FAULTS[said](pieces, plan_run(pieces, LIMITS), LIMITS))
    assert found.count > 0
    assert any(said in str(fault) for fault in found.faults)


def test_seeded_faults_of_paths_are_seen():
    """A shifted joint, a jump of r', r'' or r''', a lost piece of time: at random places of random curves."""
    draw = np.random.default_rng(4)
    for _ in range(20):
        pieces = random_curve(draw)
        if len(pieces.length) < 3:
            continue
        motion = plan_run(pieces, LIMITS)
        k = int(draw.integers(1, len(pieces.length) - 1))
        moved = pieces._replace(origin=pieces.origin.copy())
        moved.origin[k, 0] += 1e-9
        assert proof(moved, motion).count > 0
        bent = pieces._replace(shape=pieces.shape.copy())
        bent.shape[k, 1, 1] += 1e-4 * bent.length[k]
        assert proof(bent, motion).count > 0
        m = int(draw.choice(np.flatnonzero(motion.duration > 1e-9)))
        assert proof(pieces, Motion(*(np.delete(each, m) for each in motion))).count > 0
        assert proof(pieces, motion._replace(snap=motion.snap * 1.001)).count > 0


def test_a_run_in_parts_is_proven_and_sampled_as_a_whole():
    """Cut where a piece of time begins, within a piece of the path: no jump, the same samples; a lost part is seen."""
    pieces = joined(square(0.06, 0.005, 0.15), np.full(8, 1e-5))[0][0]
    motion = plan_run(pieces, LIMITS)
    cut = len(motion.duration) // 2
    p = int(motion.piece[cut])
    first = Part(Pieces(*(each[: p + 1] for each in pieces)), Motion(*(each[:cut] for each in motion)), False)
    second = Part(Pieces(*(each[p:] for each in pieces)), Motion(*(each[cut:] for each in motion)), True)
    second = second._replace(motion=second.motion._replace(piece=second.motion.piece - p))
    prover, sampler = Prover(LIMITS), Sampler(1e-3)
    assert prover.prove(first)
    assert prover.prove(second)
    found = np.concatenate([sampler.sample(first), sampler.sample(second)])
    whole = Sampler(1e-3).sample(Part(pieces, motion, True))
    assert np.abs(found - whole)[:, :, 0].max() <= 1e-15
    assert not Prover(LIMITS).prove(second)


def test_a_ramp_that_ends_just_before_a_joint_is_not_counted_on_the_next_piece():
    """A sharp piece behind an arc of 1 m: the ramp down to its cap ends within rounding of the joint."""
    t = 1.0  # rad of an arc of 1 m
    curve = arc((0.0, 0.0), 1.0, 0.0, t, 0.3)
    tight = arc((0.999 * np.cos(t), 0.999 * np.sin(t)), 1e-3, t, t + 1.0, 0.3)
    pieces = Pieces(*(np.concatenate(each) for each in zip(curve, tight, strict=True)))
    motion = plan_run(tight, LIMITS)
    assert proof(tight, motion).count == 0
    runs, _ = joined(pieces, np.full(2, 1e-5))
    assert len(runs) == 1
    assert proof(runs[0], plan_run(runs[0], LIMITS)).count == 0


def test_bounds_of_polynomials_hold_and_are_near():
    """The hull of the Bernstein points: never below a dense sample, seldom far above it."""
    draw = np.random.default_rng(5)
    ratios = []
    for _ in range(30):
        pieces = random_curve(draw)
        most, r = np.zeros((3, 4)), np.zeros((3, 5))
        norm = bounds(piece_of(pieces, 0), most)
        seen, fast = np.zeros((3, 4)), 0.0
        for x in np.linspace(0.0, pieces.length[0], 100):
            derivatives(2, pieces.length[0], pieces.shape[0], x, r)
            seen = np.maximum(seen, np.abs(r[:, 1:]))
            fast = max(fast, float(np.linalg.norm(r[:, 1])))
        assert (most >= seen).all()
        assert norm >= fast
        ratios.append((most / seen)[:, 0])
    assert np.median(ratios) < 1.2


def test_samples_are_the_motion():
    """Positions differentiated four times numerically are the samples' own derivatives; ends are exact."""
    segments = square(0.06, 0.005, 0.15)
    runs, _ = joined(segments, np.full(8, 1e-5))
    pieces, motion = runs[0], plan_run(runs[0], LIMITS)
    T = 1e-4
    sampler = Sampler(T)
    found = sampler.sample(Part(pieces, motion, True))
    assert len(found) == math.floor(duration(motion) / T) + 1
    for k in range(4):
        slope = (found[2:, :, k] - found[:-2, :, k]) / (2.0 * T)
        # of second order in T: T²/6 of the next but one derivative; behind the snap it jumps, T/2 of it
        rest = T * T / 6.0 * np.array([100.0, 5e4, np.inf, np.inf])[k] if k < 2 else T * 5e4
        allowed = rest if k < 3 else np.inf
        assert np.abs(slope - found[1:-1, :, k + 1]).max() <= 1.1 * allowed
    last = sampler.rest(found[-1, :, 0], 0.01)
    assert last.shape == (100, 3, 5)
    assert np.abs(found[0, :, 0] - segments.origin[0]).max() <= 1e-15
    assert np.abs(last[0, :, 1:]).max() == 0.0


def test_the_samples_do_not_depend_on_the_sample_time():
    runs, _ = joined(square(0.06, 0.005, 0.15), np.full(8, 1e-5))
    part = Part(runs[0], plan_run(runs[0], LIMITS), True)
    fine, coarse = Sampler(1e-4).sample(part), Sampler(1e-3).sample(part)
    assert np.abs(fine[::10][: len(coarse)] - coarse).max() <= 1e-6  # of snap, m/s⁴: rounding of the instants


def test_a_motion_that_cannot_be_planned_from_its_speed_brakes_and_does_not_stop() -> None:
    """Caps that fall by 0.1 % from piece to piece lie below the speed at the start of a window: it was followed to its
    stop, and a run of 900 mm came to rest 320 mm before its end."""
    count, length = 900, 1e-3
    feed = 0.1 * np.minimum(1.0, 1.001 ** -(np.arange(count) - 500.0))
    ways = np.zeros((count, 3))
    ways[:, 0] = length
    shape = np.zeros((count, 3, 8))
    shape[:, 0, 1] = length
    origin = np.zeros((count, 3))
    origin[:, 0] = length * np.arange(count)
    pieces = Pieces(np.full(count, 2), np.full(count, length), origin, shape, feed, np.arange(count))
    limits = np.array([[0.5, 0.1, 1.0, 1e3]] * 3)
    schedule, prover, speeds = Schedule(limits), Prover(limits), list[np.ndarray]()
    for first in range(0, count, 300):
        some = part_of_pieces(pieces, first, first + 300)
        for part in schedule.add(Section(some, first + 300 == count)):
            assert isinstance(part, Part)
            assert prover.prove(part)
            speeds.append(part.motion.speed)
    assert np.count_nonzero(np.concatenate(speeds) == 0.0) == 1

"""Lifting: the spline of u'², what is lifted is quicker and proven, where it starts and ends, what is not proven."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from paths import LIMITS, arc, lines, random_curve, random_limits

from feeddrive.path.motion import Motion, Part, Pieces, Section
from feeddrive.path.program.reading import read_program
from feeddrive.path.proof import Prover
from feeddrive.path.schedule import lift
from feeddrive.path.schedule.lift import Lifter
from feeddrive.path.schedule.run import Schedule
from feeddrive.path.schedule.spline import at, basis
from feeddrive.path.setpoints import planned
from kernel_oracle import compare

CHIPS = Path(__file__).parents[3] / "shared" / "data" / "gcode" / "linuxcnc" / "3D_Chips.ngc"


def duration(parts: list[Part]) -> float:
    return float(sum(np.sum(part.motion.duration) for part in parts))


def both(pieces: Pieces, limits: np.ndarray, window: int) -> tuple[list[Part], list[Part]]:
    """Planned, and lifted as well."""
    parts, lifter = list(Schedule(limits, window).add(Section(pieces, True))), Lifter(limits)
    return parts, [lifted for part in parts for lifted in lifter.add(part)]


def holds(parts: list[Part], limits: np.ndarray) -> None:
    prover = Prover(limits)
    assert all(prover.prove(part) for part in parts), prover.proof().faults[0]
    assert prover.proof().jump <= 1e-9


def lifted_and_proven(seed: int, count: int) -> list[float]:
    """Ratios of time on random curves, in windows of 40 and 400 pieces."""
    draw, ratios = np.random.default_rng(seed), list[float]()
    for number in range(count):
        limits, pieces = random_limits(draw), random_curve(draw)
        before, after = both(pieces, limits, 40 if number % 2 else 400)
        holds(after, limits)
        ratios.append(duration(after) / duration(before))
        assert after[-1].ends
        assert not any(part.ends for part in after[:-1])
    return ratios


def test_lifted_motions_are_proven_and_never_slower() -> None:
    """Some are held back by the feed alone; the others take about half of the time."""
    ratios = lifted_and_proven(12, 4)
    assert max(ratios) <= 1.0 + 1e-12
    assert min(ratios) <= 0.6


def test_a_ramp_as_short_as_rounding_does_not_ask_for_spans_as_short() -> None:
    """Eight time pieces of 3e-17 s in the middle of a random curve, which caps that differ by rounding had made."""
    draw = np.random.default_rng(33)
    limits, pieces = random_limits(draw), random_curve(draw)
    (part,) = Schedule(limits, 400).add(Section(pieces, True))
    m = len(part.motion.duration) // 2
    short = [np.insert(each, [m] * 8, each[m]) for each in part.motion]
    short[0][m : m + 8] = 3e-17
    after = list(Lifter(limits).add(part._replace(motion=Motion(*short))))
    assert duration(after) < 0.9 * duration([part])
    assert sum(len(each.motion.duration) for each in after) < 10_000
    holds(after, limits)


@pytest.mark.slow(reason="two hundred random curves, where the quick test has eight")
def test_many_lifted_motions_are_proven_and_never_slower() -> None:
    ratios = lifted_and_proven(13, 200)
    assert max(ratios) <= 1.0 + 1e-12
    assert np.mean(ratios) <= 0.7


def test_wherever_the_stream_is_cut_what_waits_goes_on_to_the_stop_in_hand() -> None:
    draw, waited = np.random.default_rng(9), 0
    for _ in range(3):
        limits, pieces = random_limits(draw), random_curve(draw)
        schedule, lifter, given = Schedule(limits, 10), Lifter(limits), list[Part]()
        for part in schedule.add(Section(pieces, True)):
            given += lifter.add(part)
            stop = schedule.stop()
            if stop is not None:
                hand = [] if lifter.hand is None else [lifter.hand]
                holds([*given, *hand, stop], limits)
                waited += len(hand)
        assert lifter.hand is None
    assert waited >= 3


def test_what_the_proof_refuses_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fault in all that is lifted, or jumps between its pieces: the plan stays, but for time pieces cut in two."""
    draw = np.random.default_rng(33)
    limits, pieces = random_limits(draw), random_curve(draw)
    before, after = both(pieces, limits, 400)
    assert duration(after) < 0.9 * duration(before)
    found = lift.faults_of
    for which in (2.0, -3.0):
        monkeypatch.setattr(lift, "faults_of", lambda *_, which=which: np.array([[0.0, 3.0, 0.0, which, 1.0]]))
        assert duration(both(pieces, limits, 400)[1]) == pytest.approx(duration(before), rel=1e-12)

    def moved(pieces: Pieces, motion: Motion, limits: np.ndarray) -> np.ndarray:
        return found(pieces, motion._replace(snap=motion.snap * 1.001), limits)

    monkeypatch.setattr(lift, "faults_of", moved)
    assert duration(both(pieces, limits, 400)[1]) == pytest.approx(duration(before), rel=1e-12)


def test_a_spline_that_takes_too_much_is_drawn_tight_until_it_is_proven(monkeypatch: pytest.MonkeyPatch) -> None:
    """1 % more than the limits at the points that are looked at: the first proof fails, a later one holds."""
    monkeypatch.setattr(lift, "SHARES", (1.0 - 1e-4, 1.01, 1.01, 1.01))
    faults, found, ratios = list[int](), lift.faults_of, list[float]()

    def counted(pieces: Pieces, motion: Motion, limits: np.ndarray) -> np.ndarray:
        rows = found(pieces, motion, limits)
        faults.append(len(rows))
        return rows

    monkeypatch.setattr(lift, "faults_of", counted)
    for seed in (16, 33, 45):
        draw = np.random.default_rng(seed)
        limits, pieces = random_limits(draw), random_curve(draw)
        before, after = both(pieces, limits, 400)
        holds(after, limits)
        ratios.append(duration(after) / duration(before))
    assert min(ratios) < 0.9
    assert any(first > 0 and second == 0 for first, second in pairwise(faults))


def lifted_curve(seed: int) -> float:
    """Return the time of a lifted random curve."""
    return duration(curve(seed)[1])


def curve(seed: int) -> tuple[list[Part], list[Part]]:
    """Return the plan of a random curve, and its lifted plan."""
    draw = np.random.default_rng(seed)
    limits, pieces = random_limits(draw), random_curve(draw)
    return both(pieces, limits, 400)


@pytest.mark.parametrize(
    ("seed", "share"), [(11, 0.61), (56, 0.53), (72, 0.56), (126, 0.59), (156, 0.46), (171, 0.48), (189, 0.50)]
)
def test_lifted_curves_take_about_half_of_the_planned_time(seed: int, share: float) -> None:
    """5 % more than measured."""
    before, after = curve(seed)
    assert duration(after) <= share * duration(before)


def test_what_the_proof_refuses_at_first_costs_less_than_a_percent(monkeypatch: pytest.MonkeyPatch) -> None:
    """Against the first splines, which are optimal but exceed limits between the points."""
    proven = lifted_curve(45)
    monkeypatch.setattr(lift, "faults_of", lambda *_: np.zeros((0, 5)))
    assert 1.0 < proven / lifted_curve(45) < 1.01


def test_the_last_penalty_costs_four_thousandths_of_the_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Against a fortieth of the penalty; a penalty μ of a share costs about μ of the time spent at it."""
    monkeypatch.setattr(lift, "faults_of", lambda *_: np.zeros((0, 5)))
    found = lifted_curve(33)
    monkeypatch.setattr(lift, "_NEAREST", 1e-4)
    monkeypatch.setattr(lift, "_STEPS", 400)
    assert 1.0025 < found / lifted_curve(33) < 1.0055


def test_the_steps_suffice_to_reach_the_optimum(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lift, "faults_of", lambda *_: np.zeros((0, 5)))
    found = lifted_curve(3)
    monkeypatch.setattr(lift, "_STEPS", 400)
    assert found / lifted_curve(3) < 1.001


def test_a_plateau_at_the_feed_and_a_straight_move_stay_as_planned() -> None:
    """Two ramps and a plateau at the feed, and two ramps without one, are the quickest on a line."""
    for way in (0.3, 0.005):
        before, after = both(lines(np.array([np.zeros(3), [way, 0.0, 0.0]]), 0.15), LIMITS, 400)
        assert duration(after) == pytest.approx(duration(before), rel=1e-12)
        holds(after, LIMITS)


def test_ramps_with_little_to_win_stay_as_planned(monkeypatch: pytest.MonkeyPatch) -> None:
    """Arcs from rest to rest: of each, what is not lifted would have saved less than 0.5 % of its time."""
    lost, lifted = list[float](), 0
    for radius, feed in ((0.1, 0.02), (0.01, 0.02), (0.005, 0.02), (0.05, 0.05), (0.02, 0.05)):
        pieces = arc((0.0, 0.0), radius, 0.8, 0.8 + 0.02 / radius, feed)
        before, after = both(pieces, LIMITS, 400)
        with monkeypatch.context() as patch:
            patch.setattr(lift, "_LITTLE", 0.0)
            whole = duration(both(pieces, LIMITS, 400)[1])
        if duration(after) == duration(before):
            lost.append(duration(before) / whole - 1.0)
        else:
            lifted += duration(after) == whole
    assert len(lost) == 3
    assert lifted == 2
    assert 0.0 < min(lost) < max(lost) < 0.005


def test_the_basis_gives_a_spline_with_two_continuous_derivatives() -> None:
    """Knots and coefficients at random: z to z'' at a knot from both sides, and z from one knot to the next."""
    draw = np.random.default_rng(14)
    inner = np.cumsum(np.exp(draw.normal(size=8)))
    knots = np.concatenate([inner[:1], inner[:1], inner[:1], inner, inner[-1:], inner[-1:], inner[-1:]])
    coefficient = draw.normal(size=len(inner) + 2)

    def state(k: int, x: float) -> np.ndarray:
        return np.array(at(basis(knots, k, x), coefficient, k))

    for k in range(len(inner) - 1):
        x, h = inner[k], inner[k + 1] - inner[k]
        size = np.abs(state(k, x)).max()
        ends = np.array([[1.0, h, h * h / 2, h**3 / 6], [0, 1, h, h * h / 2], [0, 0, 1, h], [0, 0, 0, 1]]) @ state(k, x)
        assert np.abs(ends - state(k, inner[k + 1])).max() <= 1e-11 * size
        if k:
            assert np.abs(state(k, x) - state(k - 1, x))[:3].max() <= 1e-11 * size
    assert state(0, inner[0])[0] == coefficient[0]
    assert state(len(inner) - 2, inner[-1])[0] == coefficient[-1]


def test_the_basis_has_the_bits_of_the_interpreter() -> None:
    draw = np.random.default_rng(15)
    knots = [np.cumsum(draw.exponential(size=9)) for _ in range(20)]
    compare(basis, [[each, 1, float(draw.uniform(each[4], each[5]))] for each in knots])


@pytest.mark.slow(reason="a program of 4,684 blocks, planned, lifted and proven")
def test_three_dimensional_chips_take_less_than_46_seconds() -> None:
    """Tolerance 0.1 mm; limits 500 mm/s, 5000 mm/s², 1e5 mm/s³, 5e7 mm/s⁴: 42.7 s measured, 59.2 s not lifted."""
    if not CHIPS.exists():
        pytest.skip(f"NOT PLANNED: {CHIPS} is not there")
    parts = [each for each in planned(read_program(CHIPS), "XYZ", LIMITS) if isinstance(each, Part)]
    holds(parts, LIMITS)
    assert duration(parts) <= 46.0

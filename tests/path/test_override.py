"""Feed hold and override as functions of time: limits hold, the path is the same, reactions are quick."""

from __future__ import annotations

from pathlib import Path
from time import process_time
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from override_cases import Case, check_case, drawn_case, samples
from paths import LIMITS
from quickest_stop import lasts, quickest, state_at
from sample_check import Curve, check_limits, check_path, curves

import feeddrive as fd
from feeddrive.language.errors import ParameterError
from feeddrive.path.motion import LINE, Motion, Pause, Pieces, line_shapes, way
from feeddrive.path.program.moves import Move
from feeddrive.path.program.reading import read_program
from feeddrive.path.proof import Prover
from feeddrive.path.schedule.brake import Moving, braking
from feeddrive.path.schedule.override import Override, override, read_steps
from feeddrive.path.setpoints import Sampler, planned

# lines with a blend, a corner of 90 degrees, arcs, a cluster of chords, a traverse and a dwell
PROGRAM = """G21 G90 G64 P0.02
G0 X5
G1 X25 Y0.5 F6000
G2 X35 Y10.5 I0 J10
G1 Y30
X20
{chords}
G4 P0.05
G1 X0 Y0
M2
"""


class Moved(NamedTuple):
    """What became of a program."""

    time: float
    way: float  # m, that u has gone in all runs
    positions: np.ndarray
    holds: list[tuple[float, float]]  # since when and for how long, s


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    angle = np.linspace(0.0, 3.0, 60)[1:]
    chords = "\n".join(f"X{20 - 8 * np.sin(a):.4f} Y{22 + 8 * np.cos(a):.4f}" for a in angle)
    path = tmp_path_factory.mktemp("override") / "part.ngc"
    path.write_text(PROGRAM.format(chords=chords), encoding="utf-8")
    return path


def gone(motion: Motion) -> float:
    """Way of u, m."""
    rows = zip(*(each.tolist() for each in (*motion[3:], motion.duration)), strict=True)
    return sum(way(*row) for row in rows)


def moved(program: Path, override: Override | None, limits: np.ndarray = LIMITS) -> Moved:
    """A program under an override, proven."""
    prover, sampler = Prover(limits), Sampler(1e-3)
    time = far = 0.0
    positions: list[np.ndarray] = []
    holds: list[tuple[float, float]] = []
    for each in planned(read_program(program), "XYZ", limits, override):
        if isinstance(each, Pause):
            if each.why == "Hold":
                holds.append((time, each.duration))
            time += each.duration
            positions.append(sampler.rest(positions[-1][-1] if positions else np.zeros(3), each.duration)[:, :, 0])
            continue
        assert prover.prove(each), prover.proof().faults[0]
        time += float(np.sum(each.motion.duration))
        far += gone(each.motion) + (gone(each.entering.motion) if each.entering else 0.0)
        samples = sampler.sample(each)[:, :, 0]
        if len(samples):
            positions.append(samples)
    return Moved(time, far, np.concatenate(positions), holds)


def same_path(found: Moved, whole: Moved, within: float = 1e-8) -> None:
    """Nothing of the path is lost or passed twice."""
    assert found.way == pytest.approx(whole.way, rel=1e-12)
    # both stop at the same place; the last sample is less than 1 ms before, 1e-8 m at these limits
    assert np.abs(found.positions[-1] - whole.positions[-1]).max() <= within


def held(program: Path, whole: Moved, begin: float) -> float:
    """Time until the motion stands after a hold that begins then, s."""
    found = moved(program, override([(begin, 0.0), (begin + 1.0, 1.0)]))
    same_path(found, whole)
    if not found.holds:  # at a dwell, or where it rests anyway
        assert found.time < whole.time + 1.0
        return 0.0
    ((since, lasts),) = found.holds
    assert since + lasts == pytest.approx(begin + 1.0, abs=1e-9)
    return since - begin


def test_a_hold_at_any_time_stands_within_a_tenth_of_a_second(program: Path) -> None:
    """From 100 mm/s the shortest stop on a line takes 0.066 s; more where a ramp up has begun."""
    whole = moved(program, override([]))
    for begin in np.linspace(0.02, 0.95, 4) * whole.time:
        assert held(program, whole, float(begin)) <= 0.1


@pytest.mark.slow(reason="a program is planned and proven for a hold at every 10 ms: 30 s")
def test_a_hold_at_every_10_ms(program: Path) -> None:
    """At most 0.0933 s was measured, where a ramp up had begun, and 0.0653 s in the middle."""
    whole = moved(program, override([]))
    for begin in np.arange(0.0, whole.time, 0.01):
        assert held(program, whole, float(begin)) <= 0.1


CURVE = "G21 G90 G64 P0.1\nG1 F24000 X2\n{chords}\nM2\n"


def wavy(folder: Path) -> list[Move]:
    """Chords of 1 mm of a curve whose curvature varies, at 400 mm/s."""
    angle = np.linspace(0.0, 1.2, 80)
    radius = 50.0 + 10.0 * np.sin(7.0 * angle)
    points = zip(2.0 + radius * np.sin(angle), radius * np.cos(angle) - 50.0, strict=True)
    path = folder / "wavy.ngc"
    path.write_text(CURVE.format(chords="\n".join(f"X{x:.4f} Y{y:.4f}" for x, y in points)), encoding="utf-8")
    return list(read_program(path))


def stands(moves: list[Move], begin: float) -> float:
    """Return how long a hold that begins then takes to a standstill, s."""
    time = 0.0
    for each in planned(moves, "XYZ", LIMITS, override([(begin, 0.0), (begin + 3.0, 1.0)])):
        if isinstance(each, Pause):
            return time - begin
        time += lasts(each)
    raise AssertionError("it does not hold")


def compared(moves: list[Move], share: float) -> float:
    """Return the time to standstill of a hold after this share of the motion over that of the quickest stop."""
    parts = list(planned(moves, "XYZ", LIMITS))
    begin = share * sum(map(lasts, parts))
    found, took = state_at(parts, begin), stands(moves, begin)
    assert found
    return took / quickest(found[0], LIMITS, found[1], took)


@pytest.mark.slow(reason="each quickest stop is some thirty linear programs: 20 s")
@pytest.mark.parametrize("share", [0.2, 0.35, 0.5, 0.65, 0.8])
def test_a_hold_on_a_curve_takes_little_longer_than_the_quickest_stop(tmp_path: Path, share: float) -> None:
    assert 0.98 <= compared(wavy(tmp_path), share) <= 1.1


@pytest.mark.parametrize("speed", [0.02, 0.1, 0.4])
def test_a_stop_on_a_line_is_the_quickest(speed: float) -> None:
    """Three boxcars of a/j, j/s and the rest, in closed form: (v / A) + A / J + J / S."""
    pieces = Pieces(
        np.array([LINE]),
        np.array([0.3]),
        np.zeros((1, 3)),
        line_shapes(np.array([[0.3, 0.0, 0.0]])),
        np.array([0.5]),
        np.array([1]),
    )
    J, S = LIMITS[0, 2], LIMITS[0, 3]
    A = min(LIMITS[0, 1], -0.5 * J * J / S + np.sqrt((0.5 * J * J / S) ** 2 + J * speed))
    stop = braking(pieces, Moving(0.01, speed, 0.0, 0.0), 0.0, LIMITS)
    assert stop
    assert float(np.sum(stop.duration)) == pytest.approx(speed / A + A / J + J / S, rel=1e-9)


def test_a_hold_that_ends_while_the_motion_brakes_is_no_standstill(program: Path) -> None:
    """The motion is cut while it brakes, too."""
    whole = moved(program, override([]))
    found = moved(program, override([(1.4, 0.0), (1.42, 1.0)]))
    same_path(found, whole)
    assert not found.holds
    assert found.time < whole.time + 0.1


def test_a_change_is_not_known_before_its_time(program: Path) -> None:
    """Up to it, all samples are those without it, to the bit."""
    whole = moved(program, override([])).positions
    for time, factor in ((0.437, 0.5), (0.65, 2.0), (1.4, 0.1)):
        found, count = moved(program, override([(time, factor)])).positions, int(1e3 * time)
        assert np.array_equal(found[:count], whole[:count])
        assert not np.array_equal(found[: count + 100], whole[: count + 100])


def test_steps_of_the_factor_keep_the_limits_and_the_path(program: Path) -> None:
    """Random steps between 0 and 200 %, seed 11; the proof has the larger feed of both while the motion brakes."""
    draw, whole = np.random.default_rng(11), moved(program, override([]))
    for _ in range(2):
        time = np.cumsum(draw.uniform(0.02, 0.5, 8))
        factor = draw.choice([0.0, 0.1, 0.5, 1.0, 1.5, 2.0], 8)
        factor[-1] = 1.0
        same_path(moved(program, override(list(zip(time.tolist(), factor.tolist(), strict=True)))), whole)


def test_a_factor_scales_the_feed(program: Path) -> None:
    """At a thirtieth of the feed of 100 mm/s ramps cost little: the way over the feed, within 2 %."""
    whole = moved(program, override([]))
    slow = moved(program, override([(0.0, 1.0 / 30.0)]))
    same_path(slow, whole)
    traverse = 5e-3 * 30.0 / 0.5
    assert slow.time - 0.05 == pytest.approx(traverse + (whole.way - 5e-3) * 30.0 / 0.1, rel=0.02)
    assert moved(program, override([(0.0, 2.0)])).time < whole.time


def unlimited(*derivatives: int) -> np.ndarray:
    """Limits without those of some derivatives: 2 the jerk, 3 the snap."""
    limits = LIMITS.copy()
    limits[:, derivatives] = np.inf
    return limits


@pytest.mark.parametrize("limits", [LIMITS, unlimited(3), unlimited(2, 3)], ids=["snap", "jerk", "acceleration"])
def test_a_change_on_a_plateau_is_followed_at_once(tmp_path: Path, limits: np.ndarray) -> None:
    """100 mm/s for 3 s, of these one at the half: half a second more, and what both changes of the speed cost."""
    path = tmp_path / "line.ngc"
    path.write_text("G21 G90 G64 P0.05\nG1 X300 F6000\nM2\n", encoding="utf-8")
    whole = moved(path, None, limits)
    found = moved(path, override([(1.0, 0.5), (2.0, 1.0)]), limits)
    same_path(found, whole)
    # both changes of the speed take the same time, in which the way is that at the mean speed
    assert found.time == pytest.approx(whole.time + 0.5, abs=1e-4)


@pytest.mark.parametrize("limits", [unlimited(3), unlimited(2, 3)], ids=["jerk", "acceleration"])
def test_without_limits_of_jerk_and_snap_a_motion_is_overridden_too(program: Path, limits: np.ndarray) -> None:
    steps, whole = [(0.2, 0.5), (0.5, 1.5), (0.9, 0.0), (1.2, 0.7), (1.8, 1.0)], moved(program, None, limits)
    found = moved(program, override(steps), limits)
    same_path(found, whole, 0.5 * 5.0 * 1e-3**2)  # 5 m/s² up to the end
    ((since, _),) = found.holds
    assert since - 0.9 <= 0.1


def test_tips_and_angles_are_overridden_in_their_own_coordinates(tmp_path: Path) -> None:
    """Rotary axes count as lengths, then the tip follows the program, then they count again; steps in each."""
    text = (
        "G21 G90 G64 P0.01 F3000\nG1 X20 A-30 C40\nX21 C41\nG43.4 H0\n"
        "G1 X5 Y6 Z50 A-20 C30\nX8 A-22\nG49\nG1 X1 A-10\nX0 Y3 C45\nM2\n"
    )
    path = tmp_path / "part.ngc"
    path.write_text(text, encoding="utf-8")
    plain, same, held = (
        fd.workflow.plan(path, machine="trunnion_ac", override=steps)
        for steps in (None, "0:100", "0.3:50, 0.6:0, 0.9:120, 1.3:0, 1.5:70, 2.4:150")
    )
    assert same.cycle_time == plain.cycle_time
    assert held.violations == 0
    assert held.tip is not None
    assert held.tip.faults == 0
    assert held.stop_reasons["feed hold"] == 2


def test_at_100_percent_the_motion_is_that_without_an_override(program: Path) -> None:
    """To the bit, also where runs are both slower in a corner."""
    with_it, without = moved(program, override([])), moved(program, None)
    assert with_it.time == without.time
    assert np.array_equal(with_it.positions, without.positions)


@pytest.mark.parametrize(
    ("steps", "reason"),
    [
        ([(1.0, 0.5), (1.0, 0.7)], "the times must rise from 0 s on, step 2 is at 1 s"),
        ([(-1.0, 0.5)], "the times must rise from 0 s on, step 1 is at -1 s"),
        ([(float("nan"), 0.5)], "the times must rise"),
        ([(1.0, 2.1)], r"the factor of step 1 must be 0 \.\. 2 \(0 \.\. 200 %\), got 2.1"),
        ([(1.0, float("nan"))], "the factor of step 1 must be"),
        ([(1.0, 0.0)], "a hold that never ends"),
    ],
)
def test_steps_that_make_no_sense_are_refused(steps: list[tuple[float, float]], reason: str) -> None:
    with pytest.raises(ParameterError, match=reason):
        override(steps)


def test_steps_are_read_from_a_text() -> None:
    found = read_steps("1:50, 2.5: 0 %,3:120%")
    assert found.time.tolist() == [0.0, 1.0, 2.5, 3.0]
    assert found.factor.tolist() == [1.0, 0.5, 0.0, 1.2]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("1=50", r"'1=50' is no step \(there is no colon\): give"),
        ("1:half", "'1:half' is no step: give"),
        ("", "'' is no"),
    ],
)
def test_a_text_that_is_no_steps_is_refused(text: str, reason: str) -> None:
    with pytest.raises(ParameterError, match=reason):
        read_steps(text)


# a full circle, whose speed is limited by its curvature and not by its feed
CIRCLE = "G21 G90 G64 P0.01 F{feed}\nG3 X0 Y0 I{radius} J0\nM2\n"


def case(path: Path, steps: list[tuple[float, float]]) -> Case:
    """Return a program under an override on the axes X Y Z."""
    return Case(path.name, list(read_program(path)), "XYZ", LIMITS, steps)


@pytest.mark.parametrize(
    ("feed", "radius", "time"),
    [
        (30000, 20, 0.2),
        (30000, 20, 0.5),
        pytest.param(12000, 5, 0.1, marks=pytest.mark.slow(reason="one more circle: 1.4 s of CPU")),
    ],
)
def test_a_smaller_feed_leaves_a_motion_alone_that_is_slow_for_another_reason(
    tmp_path: Path, feed: float, radius: float, time: float
) -> None:
    """Nothing is to be braked then: a stretch without way and time was planned."""
    path = tmp_path / "circle.ngc"
    path.write_text(CIRCLE.format(feed=feed, radius=radius), encoding="utf-8")
    check_case(case(path, [(time, 0.5)]))


def test_a_part_that_ends_behind_a_joint_overlaps_only_before_it(tmp_path: Path) -> None:
    """Under an override a run comes in parts of single ramps, whose last phase may begin on the first piece of its path
    and end on the next: it was lapped over the corner as if it lay on the first."""
    path = tmp_path / "spline.ngc"
    path.write_text("G21 G90 G64 P0.091 F7300\nG0 Y-11.1 U-16.9\nG5 I6.8 J10.4 P-14.6 Q17.0 X0.6 Y-19.3\nM2\n")
    limits = np.array([[1.5, 81.0, 2.7e4, 4.5e6], [2.1, 76.0, 1.4e4, 8e5], [0.29, 4.1, 34.0, 1.4e4]])
    check_case(Case(path.name, list(read_program(path)), "XYU", limits, [(0.3, 0.5)]))


@settings(max_examples=3, phases=(Phase.explicit, Phase.generate))
@given(number=st.integers(0, 2**31))
def test_every_sample_of_drawn_programs_under_drawn_overrides_holds(number: int) -> None:
    """All kinds of programs, holds, 1 to 200 %; `python benchmarks/random_overrides.py` has ten thousand cases."""
    check_case(drawn_case(number, 0, 6))


@pytest.mark.slow(reason="a motion of an hour")
def test_the_clock_is_rounded_late_in_a_slow_motion() -> None:
    """152 s at 1.2 % of the feed: samples 1.5 ms apart are 2e-14 s beside their instants, which their snap shows."""
    check_case(drawn_case(5421, 24))


@pytest.mark.parametrize(("number", "seed"), [(999, 1131), (120, 1132)])
def test_a_run_behind_a_bump_is_not_made_slower_as_a_whole(number: int, seed: int) -> None:
    """The bump would not fit that of the run before it any more; at 100 % as where the factor changes."""
    drawn = drawn_case(number, seed)
    check_case(drawn)
    check_case(drawn._replace(steps=[]))


def test_a_motion_of_twenty_minutes_beside_ramps_of_milliseconds_is_planned_in_seconds() -> None:
    """1 % of the feed, planned twice to draw the case: 1 s of CPU; more than 60 s where lifts have a million spans."""
    begun = process_time()
    assert drawn_case(41, 2031).steps[1][0] > 1000.0
    assert process_time() - begun < 20.0


@pytest.mark.slow(reason="six hundred drawn programs under drawn overrides: 240 s; the quick test has three")
def test_every_sample_of_many_drawn_programs_under_drawn_overrides_holds() -> None:
    for number in range(600):
        check_case(drawn_case(number, 3))


@pytest.fixture
def chips(shared: Path) -> Path:
    """LinuxCNC's sample 3D_Chips."""
    path = shared / "gcode" / "linuxcnc" / "3D_Chips.ngc"
    if not path.exists():
        pytest.skip(f"NOT TESTED on 3D_Chips: {path} is not there")
    return path


def test_3d_chips_begins_under_an_override(chips: Path, tmp_path: Path) -> None:
    path = tmp_path / "begin.ngc"
    path.write_text("\n".join([*chips.read_text(encoding="utf-8").splitlines()[:120], "M2"]), encoding="utf-8")
    check_case(case(path, [(0.5, 0.5)]))


@pytest.mark.slow(reason="the whole of 3D_Chips, planned and sampled three times for each override: 60 s")
@pytest.mark.parametrize("steps", [[(0.2, 0.5)], [(0.2, 0.9)], [(0.5, 0.5), (20.0, 0.0), (21.0, 0.8)], [(3.0, 0.5)]])
def test_3d_chips_under_an_override(chips: Path, steps: list[tuple[float, float]]) -> None:
    check_case(case(chips, steps))


def test_the_check_of_samples_sees_faults(tmp_path: Path) -> None:
    """Each is smaller than what a user would see: 10 nm, 1e-6 of a limit, a lost sample, a move that is left out."""
    path = tmp_path / "circle.ngc"
    path.write_text("G21 G90 G64 P0.1 F6000\nG1 X5 Y1\nX10\nG3 X10 Y1 I20 J0\nG1 X20\nM2\n", encoding="utf-8")
    found = case(path, [(0.1, 0.5)])
    T, way = 1e-3, curves(found.moves, [0, 1, 2])
    values = samples(found, T, 0.0, np.inf)

    def seen(values: np.ndarray, limits: np.ndarray = LIMITS, path: list[Curve] = way, factor: float = 1.0) -> str:
        try:
            check_limits(T, values, limits, 0.2)
            check_path(T, values, limits, path, factor)
        except AssertionError as fault:
            return str(fault)
        return ""

    assert seen(values) == ""
    use = np.abs(values[:, :, 1:]).max(axis=(0, 1)) / LIMITS[0]
    for k in range(4):
        assert "use of limits" in seen(values, LIMITS * np.where(np.arange(4) == k, use[k] * (1.0 - 1e-6), 1.0))
    moved = values.copy()
    moved[100, 0, 0] += 1e-8
    assert "of derivative 0" in seen(moved)
    assert "difference" in seen(np.delete(values, 50, axis=0))
    assert "it ends" in seen(values[:-20])
    assert "away from the path" in seen(values, path=[each._replace(tolerance=1e-6) for each in way])
    assert "away from the path" in seen(values, path=way[:1] + way[2:])
    assert "m/s, at most" in seen(values, factor=0.9)
    assert "not behind the one before" in seen(values, path=[*way[:2], *way[4:6], *way[2:4], *way[6:]])

"""Paths of the tip of a tool: joints follow the inverse kinematics, and the proof of the tip finds what does not."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from importlib import import_module
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from tip_paths import drawn, look, seeds

import feeddrive as fd
from feeddrive import plot
from feeddrive.files.machine import planned_kinematics, planned_limits, read_machine
from feeddrive.language.errors import FeeddriveError, ProgramError
from feeddrive.language.quantity import DRAWN
from feeddrive.language.text import Text
from feeddrive.path.feed_loss import CORNER, SHAPES
from feeddrive.path.geometry.joints import joined
from feeddrive.path.geometry.tip import Mapped, beyond, fastest, mapped
from feeddrive.path.kinematics import Kinematics
from feeddrive.path.motion import ARC, LINE, PACED, Part, Pieces, TipColumns, arc_shape, derivatives, line_shapes
from feeddrive.path.program.blocks import Line
from feeddrive.path.program.moves import Feed, Message, Move, PathMode, Straight, ToolPoint
from feeddrive.path.program.reading import read_program
from feeddrive.path.proof import Prover
from feeddrive.path.setpoints import Sampler, planned
from feeddrive.path.tip_proof import TipProver, tip_bounds

# a trunnion whose workpiece stands 80 mm below its axes; angles as in the formulas of `by_formula`
TRUNNION = Kinematics.of("table_table", "AC", workpiece=(0.0, 0.0, -0.08), reversed_joints="AC")
COLUMNS = TipColumns.of(TRUNNION, "XYZAC")
LIMITS = np.array([[0.5, 5.0, 100.0, 5e4]] * 3 + [[5.0, 30.0, 600.0, 3e5], [10.0, 50.0, 1000.0, 5e5]])


def by_formula(tip: np.ndarray, a: float, c: float) -> np.ndarray:
    """The joints of the trunnion, written out: an independent second source."""
    x, y, z = tip
    turned = np.sin(c) * x + np.cos(c) * y
    low = z - 0.08
    return np.array(
        [np.cos(c) * x - np.sin(c) * y, np.cos(a) * turned - np.sin(a) * low, np.sin(a) * turned + np.cos(a) * low]
    )


def line(way: list[float], start: list[float], feed: float = 0.1) -> Pieces:
    length = float(np.linalg.norm(way))
    kind, size, origin = (np.array([x]) for x in (LINE, length, start))
    return Pieces(kind, size, origin, line_shapes(np.array([way])), np.array([feed]), np.array([7]))


def bend(angle: float = 0.3) -> Pieces:
    """A spline of a joined corner of the tip while both angles turn."""
    ways = np.array([[0.002, 0.0, 0.0, 0.02, 0.05], [0.001, 0.001, 0.0005, -0.02 * angle, 0.05]])
    starts = np.array([[0.02, 0.03, 0.01, 0.4, 1.0], [0.022, 0.03, 0.01, 0.42, 1.05]])
    lengths = np.linalg.norm(ways, axis=1)
    segments = Pieces(np.zeros(2, int), lengths, starts, line_shapes(ways), np.full(2, 0.1), np.arange(2))
    (run,), joint = joined(segments, np.full(2, 1e-5), lonely=1e300)
    assert not joint.stop[0]
    return run


def arc() -> Pieces:
    """A quarter of a circle of the tip with 0.5 rad of both angles."""
    length = 0.02 * math.pi / 2
    e1, e2 = np.array([0.02, 0.0, 0.0, 0.0, 0.0]), np.array([0.0, 0.02, 0.0, 0.0, 0.0])
    shape = arc_shape(e1, e2, np.array([0.0, 0.0, 0.1, 16.0, -16.0]), 50.0)
    start = np.array([0.03, 0.01, 0.0, 0.2, -0.4])
    kind, size, origin, shapes = (np.array([x]) for x in (ARC, length, start, shape))
    return Pieces(kind, size, origin, shapes, np.array([0.1]), np.array([1]))


def turn() -> Pieces:
    """A long line during which the table turns by 200 degrees."""
    return line([0.1, 0.02, 0.0, 0.5, 3.5], [-0.05, 0.0, 0.02, 0.1, -1.0])


def taken(pieces: Pieces, near: float = 1e-9) -> Mapped:
    return mapped(pieces, COLUMNS, (0, 1, 2), lambda path, joints: tip_bounds(path, joints, COLUMNS) > near)


def at(pieces: Pieces, k: int, share: float) -> np.ndarray:
    """Position to r'''' of piece k at a share of its length, (N, 5)."""
    out = np.zeros((pieces.origin.shape[1], 5))
    derivatives(int(pieces.kind[k]), float(pieces.length[k]), pieces.shape[k], share * float(pieces.length[k]), out)
    out[:, 0] += pieces.origin[k]
    return out


@pytest.mark.parametrize("path", [bend, arc, turn])
def test_joints_follow_the_inverse_kinematics_within_the_proven_bound(path: Callable[[], Pieces]) -> None:
    """At 33 points of each piece the joints are within the bound of the formulas of the trunnion, and the bound is no
    more than 1 nm; 1e-15 for rounding of positions of 0.1 m."""
    tip, joints = taken(path())
    bound = tip_bounds(tip, joints, COLUMNS)
    assert np.all(bound <= 1e-9)
    for k in range(len(tip.length)):
        for share in np.linspace(0.0, 1.0, 33):
            p, q = at(tip, k, share)[:, 0], at(joints, k, share)[:, 0]
            np.testing.assert_array_equal(p[3:], q[3:]) if tip.kind[k] != ARC else np.testing.assert_allclose(
                p[3:], q[3:], atol=1e-15
            )
            assert np.linalg.norm(by_formula(p[:3], float(p[3]), float(p[4])) - q[:3]) <= bound[k] + 1e-15


@pytest.mark.parametrize("path", [bend, turn])
def test_joints_are_smooth_across_halved_pieces(path: Callable[[], Pieces]) -> None:
    """r to r''' agree at joints within 1e-11 of their size on the piece."""
    _, joints = taken(path(), 1e-13)
    assert len(joints.length) > 4
    for k in range(len(joints.length) - 1):
        left, right = at(joints, k, 1.0), at(joints, k + 1, 0.0)
        size = np.max(np.abs(left[:, :4]) * float(joints.length[k]) ** np.arange(4), axis=0) + 1e-3
        assert np.all(np.abs(left - right)[:, :4] * float(joints.length[k]) ** np.arange(4) <= 1e-11 * size)


def test_the_bound_is_sharp() -> None:
    """Of a quarter of a circle in pieces whose largest sampled error is above 1e-13 m, the bound is at most 1000 times
    the error: it takes magnitudes, which do not cancel."""
    tip, joints = taken(arc(), 1e-7)
    bound = tip_bounds(tip, joints, COLUMNS)
    error = np.zeros(len(bound))
    for k in range(len(bound)):
        for share in np.linspace(0.1, 0.9, 17):
            p, q = at(tip, k, share)[:, 0], at(joints, k, share)[:, 0]
            error[k] = max(error[k], float(np.linalg.norm(by_formula(p[:3], float(p[3]), float(p[4])) - q[:3])))
    assert error.max() > 1e-13
    assert bound.max() <= 1000.0 * error.max()


@pytest.mark.parametrize(("shift", "holds"), [(1.2e-9, True), (3e-9, False)])
@pytest.mark.parametrize("degree", [0, 1, 3, 4, 7])
def test_a_joint_that_is_shifted_by_three_nanometers_is_found(degree: int, shift: float, holds: bool) -> None:
    """2 nm of the tolerance are for the polynomials: 3 nm are more, as a shift of a joint or as a coefficient.

    A coefficient of fourth degree or higher moves the middle, with both ends held, by up to 1/256; here the ends move.
    """
    tip, joints = taken(bend(), 1e-11)
    prover = TipProver()
    prover.prove(tip, joints, COLUMNS, (0, 1, 2))
    assert prover.proven
    shape, origin = joints.shape.copy(), joints.origin.copy()
    if degree:
        # all four Taylor coefficients at the end grow by multiples
        shape[3, 1, degree] += shift / sum(math.comb(degree, k) for k in range(4))
    else:
        origin[3, 1] += 0.5 * shift
    prover.prove(tip, joints._replace(shape=shape, origin=origin), COLUMNS, (0, 1, 2))
    assert prover.proven == holds
    proof = prover.proof()
    assert proof is not None
    assert proof.faults == (0 if holds else 1)
    assert proof.deviation > 0.5 * shift


def test_a_turned_angle_is_found() -> None:
    """A rotary joint that is 3e-9 rad off its angle is a fault."""
    tip, joints = taken(bend())
    shape = joints.shape.copy()
    shape[2, 4, 1] += 3e-9
    prover = TipProver()
    prover.prove(tip, joints._replace(shape=shape), COLUMNS, (0, 1, 2))
    assert not prover.proven


@pytest.mark.parametrize(("more", "holds"), [(0.0, True), (1e-6, False)])
def test_the_feed_of_the_tip_is_proven(more: float, holds: bool) -> None:
    """A bound on u' that is a millionth too large lets the tip move faster than the feed."""
    tip, joints = taken(bend())
    prover = TipProver()
    prover.prove(tip, joints._replace(feed=joints.feed * (1.0 + more)), COLUMNS, (0, 1, 2))
    assert prover.proven == holds


@pytest.mark.parametrize("path", [bend, arc, turn])
def test_the_largest_speed_of_the_tip_is_a_sharp_bound(path: Callable[[], Pieces]) -> None:
    """Within 0.1 % of the largest |p'| at 101 points, and not below it; 1e-12 for rounding."""
    tip, _ = taken(path())
    bound = fastest(tip, (0, 1, 2))
    for k in range(len(bound)):
        sampled = max(float(np.linalg.norm(at(tip, k, share)[:3, 1])) for share in np.linspace(0.0, 1.0, 101))
        assert sampled * (1.0 - 1e-12) <= bound[k] <= sampled * 1.001 + 1e-9


def test_a_line_without_a_turn_is_a_line_of_the_joints() -> None:
    """It keeps its length and its feed."""
    _, joints = taken(line([0.03, 0.0, 0.04, 0.0, 0.0], [0.0, 0.0, 0.0, 0.7, 0.3]))
    assert joints.kind.tolist() == [LINE]
    assert joints.feed.tolist() == [0.1]
    assert np.linalg.norm(joints.shape[0, :3, 1]) == pytest.approx(0.05, rel=1e-14)


@pytest.mark.parametrize("reach", [0.0995, 0.1005])
def test_a_joint_that_passes_its_travel_between_blocks_is_found(reach: float) -> None:
    """A point 0.1 m from the axis turns by half a turn of the table: y rises to 0.1 m between both ends, where it is
    0; the bound of its hulls is within 0.1 % of the way."""
    pieces = line([1e-9, 0.0, 0.0, 0.0, math.pi], [0.1, 0.0, 0.08, 0.0, 0.0])
    _, joints = taken(pieces)
    travel = [None, (-0.2, reach), None, None, None]
    found = beyond(joints, travel, (0, 1, 2))
    assert (found is not None) == (reach < 0.1)
    if found:
        assert found.column == 1
        assert 0.0995 < found.position < 0.1001


def steps(*moves: Move) -> list[Move]:
    source = Line("p.ngc", 1, "")
    return [PathMode(source, "continuous", 1e-5), Feed(source, 0.1, 1.0), *moves]


def test_a_tip_that_stands_turns_at_the_feed_of_angles() -> None:
    """F 1 rad/s and half a turn of C: the joints take at least π s, and 3 % more for their ramps."""
    here, there = (0.03, 0.0, 0.0, -0.3, 0.0, 0.0, 0.0, 0.0, 0.0), (0.03, 0.0, 0.0, -0.3, 0.0, math.pi, 0.0, 0.0, 0.0)
    source = Line("p.ngc", 2, "")
    moves = steps(ToolPoint(source, TRUNNION), Straight(source, here, there, False))
    prover, tip = Prover(LIMITS), TipProver()
    lasts = 0.0
    for part in planned(moves, "XYZAC", LIMITS, tip=tip):
        if isinstance(part, Part):
            prover.prove(part)
            lasts += float(part.motion.duration.sum())
    assert prover.proof().count == 0
    assert tip.proven
    assert math.pi < lasts < 1.03 * math.pi + 0.1


def test_after_moves_of_the_joints_the_tip_goes_on_from_there(tmp_path: Path) -> None:
    """Rotary moves of the joints are proven with weighted angles, those of the tip without: the proof goes on."""
    text = (
        "G21 G90 G64 P0.01 F3000\nG1 X20 A-30 C40\nX21 C41\nG43.4 H0\n"
        "G1 X5 Y6 Z50 A-20 C30\nX8 A-22\nG49\nG1 X1 A-10\nM2\n"
    )
    path = tmp_path / "part.ngc"
    path.write_text(text, encoding="utf-8")
    result = fd.workflow.plan(path, machine="trunnion_ac")
    assert result.violations == 0
    assert result.stop_reasons["begin or end of the tool point (G43.4, G43.5, G49, TRAORI, TRAFOOF)"] == 2


def test_behind_a_path_of_the_tip_moves_have_their_own_lines(tmp_path: Path) -> None:
    text = "G21 G90 G64 P0.01 F3000\nG1 X20\nG43.4 H0\nG1 X5 Z50 C30\nG49\nG1 X1 A-10\nM2\n"
    parts = [part for part in planned(program(tmp_path, text, TRUNNION), "XYZAC", LIMITS) if isinstance(part, Part)]
    lines = [set((part.pieces if part.lines is None else part.lines).line.tolist()) for part in parts]
    assert [each for k, each in enumerate(lines) if k == 0 or each != lines[k - 1]] == [{2}, {4}, {6}]


def program(tmp_path: Path, text: str, kinematics: Kinematics | None) -> list[Move]:
    path = tmp_path / "part.ngc"
    path.write_text(text, encoding="utf-8")
    return list(read_program(path, kinematics=kinematics))


def test_tool_point_changes_coordinates_and_moves_nothing(tmp_path: Path) -> None:
    """G43.4 gives the tip of the standing machine, by the formulas; G49 its joints; positions within 1e-12 mm."""
    text = (
        "G21 G90\nG0 X30 Y-20 Z10 A20 C70\nG43.4 H0\n(debug,#5420 #5421 #5422)\nG0 X1\nG49\n(debug,#5420)\nG0 X4\nM2\n"
    )
    moves = program(tmp_path, text, TRUNNION)
    straight = [move for move in moves if isinstance(move, Straight)]
    a, c = math.radians(20.0), math.radians(70.0)
    np.testing.assert_allclose(by_formula(np.array(straight[1].start[:3]), a, c), straight[0].end[:3], atol=1e-15)
    told = [float(x) for move in moves if isinstance(move, Message) for x in move.text.split()]
    np.testing.assert_allclose(told[:3], 1e3 * np.array(straight[1].start[:3]), atol=1e-6)
    joints = by_formula(np.array(straight[1].end[:3]), a, c)
    np.testing.assert_allclose(straight[2].start[:3], joints, atol=1e-15)
    assert told[3] == pytest.approx(1e3 * joints[0], abs=1e-6)


def test_the_length_of_the_tool_moves_the_joints(tmp_path: Path) -> None:
    """With a tool of 50 mm the tip of the same joints lies 50 mm lower in the machine."""
    tools = tmp_path / "tool.tbl"
    tools.write_text("T3 P3 Z50\n", encoding="utf-8")
    path = tmp_path / "part.ngc"
    path.write_text("G21 G90\nG0 X30 A20 C70\nG43.4 H3\nG0 X1\nM2\n", encoding="utf-8")
    moves = list(read_program(path, kinematics=TRUNNION, tools=tools))
    straight = [move for move in moves if isinstance(move, Straight)]
    tip = by_formula(np.array(straight[1].start[:3]), math.radians(20.0), math.radians(70.0))
    np.testing.assert_allclose(tip, [0.03, 0.0, -0.05], atol=1e-15)


def test_the_direction_of_the_tool_gives_the_angles(tmp_path: Path) -> None:
    """I J K need not be a unit vector; at the pole the table stays; blocks without them keep the direction."""
    machine = read_machine("trunnion_ac")
    kinematics = planned_kinematics(machine, planned_limits(machine, None))
    assert kinematics is not None
    text = "G21 G90\nG43.5 H0\nG0 X1 I0 J2 K2\nX2\nX3 I1 J1 K2\nX4 K1\nM2\n"
    straight = [move for move in program(tmp_path, text, kinematics) if isinstance(move, Straight)]
    wanted = [[0.0, 1.0, 1.0], [0.0, 1.0, 1.0], [1.0, 1.0, 2.0], [0.0, 0.0, 1.0]]
    for move, axis in zip(straight, wanted, strict=True):
        found = kinematics.tool_axis([move.end[3], move.end[5]])
        np.testing.assert_allclose(np.array(found) * np.linalg.norm(axis), axis, atol=1e-12)
    assert straight[3].end[5] == straight[2].end[5]


BAD = {
    "G43.4 H0": "the machine has no kinematics: give the machine file a section",
    "G43.4 H7": "tool 7 is not in the tool table",
    "G43.4 H0\nG43.1 Z5": "G43.1 changes the tool while its tip is moved",
    "G43.4 H0\nG43.5 H0": "G43.5 changes the tool while its tip is moved",
    "G43.4 H0\nT1 M6": "M6 changes the tool while its tip is moved",
    "G43.4 H0\nM61 Q1": "M61 changes the tool while its tip is moved",
    "G43.4 H0\nG10 L1 P1 Z3": "G10 changes the tool while the tip",
    "G43.4 H0\nG53 G0 Z0": "G53 gives positions of the joints",
    "G43.4 H0\nG28": "G28 gives positions of the joints",
    "G43.4 H0\nG41.1 D3": "has no meaning while the tip of a tilted tool is moved",
    "G43.4 H0\nG0 A-45\nG1 X1 C180": "the tool swings by more than 5 deg beside the plane",
    "G43.4 H0\nG0 A-20\nG1 X1 A20 C180": "the tool swings by more than 5 deg beside the plane",
    "G43.4 H0\nG0 C7201": "its travel is -7200..7200 deg",
    "G43.5 H0\nG1 X1 I0 J0 K0": "the direction of the tool I J K has no length",
    "G43.5 H0\nG1 X1 A3": "G43.5 gives the direction of the tool by I J K, not by A",
    "G43.5 H0\nG0 X1 I1 K-3": "it goes from -120 deg to 30 deg",
    "G43.4 H0\nG1 X1 I1": "no code of this block uses the word I",
}


@pytest.mark.parametrize("text", BAD)
def test_errors_of_the_tool_point_name_their_line(tmp_path: Path, text: str) -> None:
    machine = read_machine("trunnion_ac")
    limits = planned_limits(machine, None)
    kinematics = None if "no kinematics" in BAD[text] else planned_kinematics(machine, limits)
    path = tmp_path / "part.ngc"
    path.write_text(f"G21 G90 F1000\n{text}\nM2\n", encoding="utf-8")
    with pytest.raises(ProgramError) as raised:
        list(read_program(path, axes=limits.travel, kinematics=kinematics))
    assert BAD[text] in str(raised.value)
    assert f"line {2 + text.count(chr(10))}" in str(raised.value)


@pytest.mark.parametrize(("tilt", "holds"), [(4.0, True), (7.0, False)])
def test_a_tool_may_swing_by_five_degrees_in_a_feed(tmp_path: Path, tilt: float, holds: bool) -> None:
    """Half a turn of the table at a tilt swings the tool by the tilt beside the straight way through the pole."""
    text = f"G21 G90 F1000\nG43.4 H0\nG0 A{tilt}\nG1 X1 C180\nM2\n"
    if holds:
        program(tmp_path, text, TRUNNION)
        return
    with pytest.raises(ProgramError, match="swings by more than 5 deg"):
        program(tmp_path, text, TRUNNION)


def test_an_angle_that_is_wound_too_far_is_refused(tmp_path: Path) -> None:
    """An endless table counts up to 1e6 degrees."""
    program(tmp_path, "G21 G90\nG43.4 H0\nG0 C999999\nM2\n", TRUNNION)
    with pytest.raises(ProgramError, match="would be wound to 1"):
        program(tmp_path, "G21 G90\nG43.4 H0\nG0 C1000001\nM2\n", TRUNNION)


def test_a_joint_that_leaves_its_travel_is_an_error_at_its_line(tmp_path: Path) -> None:
    """The tip stays within the travel of the axes, but the table turns its point out of it."""
    path = tmp_path / "part.ngc"
    path.write_text("G21 G90 F1000\nG43.4 H0\nG0 X200 Y200 Z60\nG1 C45\nM2\n", encoding="utf-8")
    with pytest.raises(ProgramError, match=r"line 4.*joint [XY] would go to .*its travel is -250 mm to 250 mm"):
        fd.workflow.plan(path, machine="trunnion_ac")


def test_random_paths_of_the_tip_hold() -> None:
    """All kinds of machines, curves, corners, arcs, traverses, turns on the spot; limits over decades."""
    for k, draw in seeds(41, 4):
        assert look(drawn(draw, 16)).wrong == "", k


@pytest.mark.slow(reason="two hundred random five-axis programs take a minute")
def test_many_random_paths_of_the_tip_hold() -> None:
    """`python benchmarks/random_programs.py --tip` has more."""
    for k, draw in seeds(43, 200):
        assert look(drawn(draw)).wrong == "", k


def check(name: str, folder: Path, lasts: float) -> None:
    """Plan a bundled program: proven within 10 um, in no more than a time with its approach, and five columns."""
    result = fd.workflow.plan(Path(name), machine="trunnion_ac", out=folder / "out")
    record = json.loads((folder / "out" / "plan.json").read_text())
    assert record["violations"] == 0
    assert 5e-6 < record["tip_deviation_m"] <= 1e-5
    assert record["tip_angle_rad"] <= math.radians(0.05)
    assert record["cycle_time_s"] < lasts
    log = fd.read_log(folder / "out" / "setpoints.parquet")
    q = np.array([log[f"{axis}.set_position"] for axis in "xyzac"])
    kinematics = result.kinematics
    assert kinematics is not None
    # the feed is a bound of the speed of the tip: 100 mm/s, but for the traverse to the first point
    speed = np.linalg.norm(np.diff(np.array(kinematics.tip(q[:3], q[3:])), axis=1), axis=0) / log.sample_time
    feeding = speed[np.flatnonzero(np.array(log["line"]) == 6)[-1] + 1 :]
    assert feeding.max() < 0.1 * (1.0 + 1e-6)
    first = (folder / "out" / "streamer.txt").read_text().splitlines()[0]
    assert len(first.split()) == 5


@pytest.fixture
def no_report(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(import_module("feeddrive.workflow.plan"), "html", lambda _: "")


@pytest.mark.usefixtures("no_report")
def test_the_s_curve_keeps_the_tip_within_ten_micrometers(tmp_path: Path) -> None:
    check("s_curve", tmp_path, 2.85)


@pytest.mark.usefixtures("no_report")
@pytest.mark.slow(reason="17 s of motion at 5 kHz are sampled and written")
@pytest.mark.parametrize(("name", "lasts"), [("blade", 7.4), ("dome", 14.95)])
def test_blade_and_dome_keep_the_tip_within_ten_micrometers(tmp_path: Path, name: str, lasts: float) -> None:
    check(name, tmp_path, lasts)


def test_the_pictures_show_tip_and_joints(tmp_path: Path) -> None:
    """The path is that of the tip in the frame of the workpiece; a panel for the tilt, each rotary joint, the linear
    ones."""
    path = tmp_path / "part.ngc"
    path.write_text("G21 G90 F3000 G64 P0.01\nG43.4 H0\nG1 X30 Y5 A-30\nX50 Y10 C20\nM2\n", encoding="utf-8")
    result = fd.workflow.plan(path, machine="trunnion_ac")
    np.testing.assert_allclose(result.tips[-1], [0.05, 0.01, 0.08], atol=1e-9)
    assert math.degrees(float(result.tilts[-1])) == pytest.approx(30.0, abs=1e-9)
    assert [panel.label.split("\n")[0] for panel in plot.plan_joints_chart(result).panels] == [
        "tilt of the tool",
        "A",
        "C",
        "joints",
    ]
    assert plot.planned_chart(result).panels[0].label == "Y (mm)"
    # the axes of the page: X from 0 to 50 and back to its joint's place, of a travel of 500 mm; use of limits to 100 %
    linear, rotary, use = plot.plan_axes_chart(result).panels
    assert [curve.name for curve in (*linear.curves, *rotary.curves)] == ["X", "Y", "Z", "A", "C"]
    x = result.course.position[:, 0]
    least, most = (float(end) for end in (result.limits.axes["X"].travel_least, result.limits.axes["X"].travel_most))  # type: ignore[arg-type]
    assert f"X {100.0 * np.ptp(x) / (most - least):.2g} %" in Text(linear.caption).shown(DRAWN)
    assert max(float(np.max(curve.y)) for curve in use.curves) <= 100.0 * (1.0 + 1e-9)
    assert max(float(np.max(curve.y)) for curve in use.curves) > 90.0  # something limits a motion
    (feed,) = plot.plan_feed_chart(result).panels
    programmed, speed = feed.curves
    assert np.all(speed.y <= programmed.y * (1.0 + 1e-9))
    assert float(np.max(speed.y)) > 2900.0  # mm/min: it reaches its feed of 3000
    for band in feed.bands:  # between the speed and the feed
        assert np.all((band.low <= band.high) | np.isnan(band.low))


def test_joints_that_cannot_follow_the_tip_are_a_cause_of_its_own(tmp_path: Path) -> None:
    """C swings by 8 degrees every 8 mm, at 100 mm/s with 860 rad/s², where its limit is 50 rad/s²; no runs overlap."""
    path = tmp_path / "part.ngc"
    swings = "".join(f"X{30 + x:.2f} C{8.0 * math.sin(math.tau * x / 8.0):.4f}\n" for x in np.arange(0.1, 24.0, 0.1))
    path.write_text(f"G21 G90 F6000 G64 P0.1\nG43.4 H0\nG1 X30\n{swings}M2\n", encoding="utf-8")
    result = fd.workflow.plan(path, machine="trunnion_ac")
    lost = sum(row.lost for row in result.loss.causes if row.cause == SHAPES[PACED])
    # on the half of 24 mm where |sin| is above 0.7 no more than 29 mm/s: 0.41 s in place of 0.12 s
    assert lost > 0.29
    assert SHAPES[CORNER] not in {row.cause for row in result.loss.causes}


@pytest.mark.parametrize(("turn", "stops"), [(0.0, 0), (1.0, 7)])
def test_lines_of_a_tilted_tool_pass_their_corners_without_a_stop(turn: float, stops: int) -> None:
    """Eight lines of 5 mm with square corners, at a tilt of 30 degrees: runs overlap where no angle turns, the tip
    stays within 10 um of the lines, and is no slower than the axes of an upright tool by more than 1 %."""
    source = Line("p.ngc", 1, "")
    corners = [(0.005 * ((k + 1) // 2), 0.005 * (k // 2)) for k in range(9)]
    tilt = math.radians(-30.0)
    points = [(x, y, 0.0, tilt, 0.0, math.radians(turn * k), 0.0, 0.0, 0.0) for k, (x, y) in enumerate(corners)]
    going = [Straight(source, a, b, False) for a, b in pairwise(points)]

    def run(moves: list[Move], tip: TipProver) -> tuple[float, int, np.ndarray]:
        prover, sampler, rows, lasts, runs = Prover(LIMITS), Sampler(1e-3), list[np.ndarray](), 0.0, 0
        for part in planned(moves, "XYZAC", LIMITS, tip=tip):
            if isinstance(part, Part):
                prover.prove(part)
                rows.append(sampler.sample(part)[:, :, 0])
                lasts += float(part.motion.duration.sum())
                runs += part.ends and part.entering is None
        assert prover.proof().count == 0
        return lasts, runs, np.concatenate(rows)

    tip = TipProver()
    lasts, runs, q = run(steps(ToolPoint(source, TRUNNION), *going), tip)
    proof = tip.proof()
    assert proof is not None
    assert proof.faults == 0
    assert runs == 1 + stops
    assert proof.deviation <= 1e-5
    places = np.array(TRUNNION.tip(q[:, :3].T, q[:, 3:].T)).T[:, None]
    begin, way = (np.array(rows) for rows in (corners[:-1], np.diff(corners, axis=0)))
    share = np.clip(np.einsum("mnk,nk->mn", places[..., :2] - begin, way) / np.einsum("nk,nk->n", way, way), 0.0, 1.0)
    off = np.linalg.norm(places[..., :2] - begin - share[:, :, None] * way, axis=2).min(axis=1)
    assert off.max() <= proof.deviation + 1e-12
    if not turn:
        assert off.max() > 1e-6
        assert lasts < 1.01 * run(steps(*going), TipProver())[0]


def test_a_bundled_program_has_a_name() -> None:
    with pytest.raises(FeeddriveError, match="no bundled one of that name"):
        fd.workflow.plan(Path("bladed"), machine="trunnion_ac")

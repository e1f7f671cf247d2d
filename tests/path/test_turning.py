"""Tools that turn in the plane of two directions: parts of a block, whose bound no sample exceeds, and plans."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from tip_paths import machine

from feeddrive.language.errors import ProgramError
from feeddrive.path.kinematics import Kinematics, UnreachableError
from feeddrive.path.motion import Part
from feeddrive.path.orientation import angle_between, interpolate_plane, interpolate_vector
from feeddrive.path.program.aiming import Turning
from feeddrive.path.program.moves import Orientation
from feeddrive.path.program.reading import read_program
from feeddrive.path.proof import Prover
from feeddrive.path.setpoints import Sampler, planned
from feeddrive.path.tip_proof import TipProver
from feeddrive.path.turning import EXACT, Parts, Swing, along_arc, in_plane

TRUNNION = Kinematics.of("table_table", "AC", workpiece=(0.0, 0.0, -0.08), reversed_joints="AC")
LIMITS = np.array([[0.5, 5.0, 100.0, 5e4]] * 3 + [[5.0, 30.0, 600.0, 3e5], [10.0, 50.0, 1000.0, 5e5]])
NEAR = math.radians(0.005)
PLANES: tuple[Orientation, ...] = ("plane", "vector")


def sampled(kinematics: Kinematics, begin: list[float], end: list[float], how: Orientation, parts: Parts) -> float:
    """The largest angle between the tool axis of the joints and the programmed one at 33 points of each part."""
    joints = np.concatenate([np.array(begin)[:, None], parts.rotary, np.array(end)[:, None]], axis=1)
    first, last = (np.array(kinematics.tool_axis(angles))[:, None] for angles in (begin, end))
    interpolate = interpolate_plane if how == "plane" else interpolate_vector
    x = np.linspace(0.0, 1.0, 33)
    most = 0.0
    for k in range(len(parts.share) - 1):
        share = parts.share[k] + x * (parts.share[k + 1] - parts.share[k])
        here = np.array(kinematics.tool_axis(joints[:, [k]] + x * (joints[:, [k + 1]] - joints[:, [k]])))
        most = max(most, float(angle_between(here, interpolate(first, last, share)).max()))
    return most


def compare(how: Orientation, count: int) -> None:
    """Compare the bound of random blocks of random machines with samples.

    It is mostly less than 5 times what samples show.  Blocks whose end is not reached along the arc are refused: no
    more than a third of them.
    """
    draw, sharp, refused = np.random.default_rng(3), list[float](), 0
    for _ in range(count):
        kinematics = machine(draw)
        begin = draw.uniform(-1.0, 1.0, 2)
        end = begin + draw.normal(size=2) * 10.0 ** draw.uniform(-3.0, -0.3)
        try:
            parts = in_plane(kinematics, begin.tolist(), end.tolist(), how, NEAR)
        except UnreachableError:
            refused += 1
            continue
        far = sampled(kinematics, begin.tolist(), end.tolist(), how, parts)
        assert far <= parts.off + 1e-12 <= NEAR + 1e-12
        if len(parts.share) > 2:
            sharp.append(parts.off / far)
    assert refused <= count / 3
    assert len(sharp) > count / 6
    assert np.median(sharp) < 5.0


@pytest.mark.parametrize("how", PLANES)
def test_no_sample_is_farther_from_the_plane_than_the_bound(how: Orientation) -> None:
    compare(how, 8)


@pytest.mark.slow(reason="hundreds of random blocks take a minute")
@pytest.mark.parametrize("how", PLANES)
def test_no_sample_of_many_blocks_is_farther_than_the_bound(how: Orientation) -> None:
    compare(how, 300)


@pytest.mark.parametrize("how", PLANES)
def test_the_bound_holds_over_any_part(how: Orientation) -> None:
    """Over whole blocks, which turn by up to 1 rad and whose joints are off the arc at one end by up to 0.1 rad: the
    largest distance is mostly there."""
    draw, ratios = np.random.default_rng(4), list[float]()
    for _ in range(40):
        kinematics = machine(draw)
        begin = draw.uniform(-1.0, 1.0, 2)
        end = begin + draw.normal(size=2) * 10.0 ** draw.uniform(-2.0, -0.3)
        arc = Swing.between(kinematics, begin, end, how, 0.0)
        off = end + draw.normal(size=2) * 10.0 ** draw.uniform(-4.0, -1.0)
        bound = float(arc.distances(np.stack([begin, off], axis=1), np.array([0.0, 1.0]))[0])
        x = np.linspace(0.0, 1.0, 33)
        here = np.array(kinematics.tool_axis(begin[:, None] + x * (off - begin)[:, None]))
        interpolate = interpolate_plane if how == "plane" else interpolate_vector
        far = angle_between(here, interpolate(arc.first[:, None], arc.last[:, None], x)).max()
        assert far <= bound + 1e-12
        ratios.append(bound / far)
    assert np.median(ratios) < 2.0


def test_a_block_that_turns_by_little_is_one_part() -> None:
    """1 degree of both joints: at most (0.035)²/4 = 3e-4 rad, which 0.05 degrees hold, and a tenth of it not."""
    begin, end = [0.5, 0.2], [0.5 + math.radians(1.0), 0.2 + math.radians(1.0)]
    assert len(in_plane(TRUNNION, begin, end, "plane", 10.0 * NEAR).share) == 2
    assert len(in_plane(TRUNNION, begin, end, "plane", NEAR).share) >= 2
    straight = in_plane(TRUNNION, [0.5, 0.2], [0.9, 0.2], "plane", NEAR)
    # one joint that tilts the tool is the plane itself
    assert len(straight.share) == 2
    assert straight.off < 1e-6


def test_through_the_pole_a_branch_may_change_and_the_table_may_turn() -> None:
    """The arc from a tilt of 0.5 to one of -0.5 leads through the pole: A passes 0, or C turns there by half a turn."""
    for end in ([-0.5, 0.2], [0.5, 0.2 + math.pi]):
        parts = in_plane(TRUNNION, [0.5, 0.2], end, "plane", NEAR)
        assert sampled(TRUNNION, [0.5, 0.2], end, "plane", parts) <= NEAR


def test_by_vector_the_tool_turns_faster_in_the_middle() -> None:
    """Over 60 degrees of one joint by a quarter, 1/cos² 30° = 1.33 of the mean there: more than one part."""
    plane = in_plane(TRUNNION, [0.1, 0.2], [0.1 + math.pi / 3.0, 0.2], "plane", NEAR)
    vector = in_plane(TRUNNION, [0.1, 0.2], [0.1 + math.pi / 3.0, 0.2], "vector", NEAR)
    assert len(plane.share) < 5 < len(vector.share)
    k = int(np.argmin(np.abs(vector.share - 0.5)))
    rate = (vector.rotary[0, k] - vector.rotary[0, k - 2]) / (vector.share[k + 1] - vector.share[k - 1])
    assert rate == pytest.approx(math.pi / 3.0 * 1.1027, rel=0.02)  # 2 tan 30° / 60°, the rate in the middle


@pytest.mark.parametrize(
    ("begin", "end", "what"),
    [
        ([0.5, 0.0], [0.5, 2.0 * math.pi], "joint C would jump by 360 deg"),
        ([0.5, 0.0], [-0.5, 2.6], "joint C would jump by 17"),
        ([math.pi / 2.0, 0.0], [-math.pi / 2.0, 0.0], "to the opposite direction"),
    ],
)
def test_an_end_that_the_arc_does_not_reach_is_refused(begin: list[float], end: list[float], what: str) -> None:
    with pytest.raises(UnreachableError, match=what):
        in_plane(TRUNNION, begin, end, "plane", NEAR)


def swings(tmp_path: Path, head: str, body: str) -> Path:
    path = tmp_path / "part.ngc"
    path.write_text(f"G21 G90 F3000 {head}\n{body}M2\n", encoding="utf-8")
    return path


BODY = "G0 Z60 A-40\nG1 X20 A-45 C35\nX40 A-30 C-10\n"


def off_the_plane(tmp_path: Path, text: str, turning: Turning, mode: str = "G64 P0.01") -> tuple[float, float]:
    """Plan a program of `BODY`; return the largest angle of its samples from the great circles of its feeds, at the
    place of the tip, and the proven one, both rad."""
    moves = read_program(swings(tmp_path, mode, text + BODY), kinematics=TRUNNION, turning=turning)
    prover, tip, sampler, rows = Prover(LIMITS), TipProver(), Sampler(1e-3), list[np.ndarray]()
    for part in planned(moves, "XYZAC", LIMITS, tip=tip):
        if isinstance(part, Part):
            prover.prove(part)
            rows.append(sampler.sample(part)[:, :, 0])
    proof = tip.proof()
    assert proof is not None
    assert prover.proof().count == proof.faults == 0
    q = np.concatenate(rows).T
    place, axis = np.array(TRUNNION.tip(q[:3], q[3:])), np.array(TRUNNION.tool_axis(q[3:]))
    ends = np.radians([[-40.0, 0.0], [-45.0, 35.0], [-30.0, -10.0]])
    directions = [np.array(TRUNNION.tool_axis(angles))[:, None] for angles in ends]
    most = 0.0
    for k in range(2):
        # away from the corner, which is rounded
        share = (place[0] - 0.02 * k) / 0.02
        inside = (share > 0.2) & (share < 0.8)
        wanted = interpolate_plane(directions[k], directions[k + 1], share[inside])
        most = max(most, float(angle_between(axis[:, inside], wanted).max()))
    return most, proof.angle


def test_without_a_tolerance_the_tool_follows_the_arc(tmp_path: Path) -> None:
    """Within EXACT; by axes no bound of the angle is needed, and the program is followed to the rounding."""
    off, proven = off_the_plane(tmp_path, "G43.4 H0 P1\n", Turning(), "G61")
    assert off <= proven <= EXACT
    _, by_axes = off_the_plane(tmp_path, "G43.4 H0 P0\n", Turning(), "G61")
    assert by_axes == 0.0


@pytest.mark.parametrize("how", PLANES)
def test_polynomials_of_the_joints_follow_the_arc_and_one_another(how: Orientation) -> None:
    """At samples within the bound, and C3 where they meet; the bound is mostly less than 1e4 times the distance, since
    it falls with the eighth power of the length of a part.
    """
    draw, ratios, refused = np.random.default_rng(9), list[float](), 0
    x = np.linspace(0.0, 1.0, 17)
    powers = x ** np.arange(8)[:, None]
    for _ in range(8):
        kinematics = machine(draw)
        begin = draw.uniform(-1.0, 1.0, 2)
        end = begin + draw.normal(size=2) * 10.0 ** draw.uniform(-3.0, 0.0)
        try:
            curves = along_arc(kinematics, begin.tolist(), end.tolist(), how)
        except UnreachableError:
            refused += 1
            continue
        first, last = (np.array(kinematics.tool_axis(angles))[:, None] for angles in (begin, end))
        interpolate = interpolate_plane if how == "plane" else interpolate_vector
        far = 0.0
        for origin, shape, here, size in zip(
            curves.origin, curves.shape, curves.share[:-1], np.diff(curves.share), strict=True
        ):
            axis = np.array(kinematics.tool_axis(origin[:, None] + shape @ powers))
            far = max(far, float(angle_between(axis, interpolate(first, last, here + x * size)).max()))
        assert far <= curves.off <= EXACT
        ratios.append(curves.off / max(far, 1e-15))
        sizes = np.diff(curves.share)
        ends = [np.array([math.comb(j, k) if j >= k else 0 for j in range(8)]) for k in range(4)]
        for k in range(len(sizes) - 1):
            before, behind = curves.shape[k], curves.shape[k + 1]
            assert curves.origin[k] + before.sum(axis=1) == pytest.approx(curves.origin[k + 1], abs=1e-14)
            for order in (1, 2, 3):
                # Taylor coefficients of one size of a part; below 1e-10 of the largest they are roundings
                left, right = before @ ends[order], behind[:, order] * (sizes[k] / sizes[k + 1]) ** order
                assert left == pytest.approx(right, rel=1e-6, abs=1e-10 * float(np.abs(before).max()))
    assert refused <= 3
    assert np.median(ratios) < 1e4


def test_an_arc_through_the_pole_is_followed_where_the_joint_about_it_need_not_turn() -> None:
    """A trunnion passes its pole with C at rest; a nutating head turns C on the way, from either side of the pole."""
    curves = along_arc(TRUNNION, [-0.8, 0.3], [0.8, 0.3], "plane")
    assert curves.off <= EXACT
    assert len(curves.share) <= 9  # at the pole itself no part need be shorter
    assert np.abs(curves.shape[:, 1]).max() < 1e-12
    head = Kinematics.of("head_table", "BC", nutating=True)
    ends = head.rotary(np.array([[math.sin(0.3)], [0.0], [math.cos(0.3)]])).angles[0, :, 0]
    for begin in (np.zeros(2), -ends):
        assert along_arc(head, begin.tolist(), ends.tolist(), "plane").off <= EXACT


def test_an_arc_that_leaves_the_travel_of_a_joint_is_refused() -> None:
    """Between two directions 108 degrees from the pole and 60 degrees of C apart the arc reaches 110.6 degrees."""
    limit = Kinematics.of("head_table", "BC").with_travel({"B": (-0.5, math.radians(110.0))})
    begin, end = [math.radians(108.0), 0.0], [math.radians(108.0), math.radians(60.0)]
    with pytest.raises(UnreachableError, match=r"joint B would go to 110\S* deg at .* its travel is .* to 110 deg"):
        in_plane(limit, begin, end, "plane", NEAR)
    with pytest.raises(UnreachableError, match=r"joint B would go to 110\S* deg at"):
        along_arc(limit, begin, end, "plane")
    wide = limit.with_travel({"B": (-0.5, math.radians(111.0))})
    assert len(in_plane(wide, begin, end, "plane", NEAR).share) > 2
    assert along_arc(wide, begin, end, "plane").off <= EXACT


def test_a_plan_keeps_the_tool_in_the_plane_within_the_proven_angle(tmp_path: Path) -> None:
    """0.05 degrees are allowed; by axes the same program leaves the plane by more than a degree."""
    for text, turning in (("G43.4 H0 P1\n", Turning()), ("G43.4 H0\n", Turning("plane"))):
        off, proven = off_the_plane(tmp_path, text, turning)
        assert off <= proven <= math.radians(0.05)
    by_axes, _ = off_the_plane(tmp_path, "G43.4 H0 P0\n", Turning("plane"))
    assert by_axes > math.radians(1.0)


@pytest.mark.parametrize(
    ("head", "body", "what"),
    [
        ("G61", "G43.4 P1\nG0 A-30\nG1 X1 C360\n", "line 4.*joint C would jump by 360 deg"),
        ("G64 P0.01", "G43.4 P1\nG2 X1 I0.5 A-30\n", "line 3.*axis A turns along a curve"),
        ("G64 P0.01", "G43.4 P1\nG0 A-30\nG1 X1 C360\n", "line 4.*joint C would jump by 360 deg"),
        ("G64 P0.01", "G43.4 P3\n", "line 2.*P of G43.4 is a whole number from 0 to 2"),
    ],
)
def test_what_cannot_turn_in_a_plane_is_refused_at_its_line(tmp_path: Path, head: str, body: str, what: str) -> None:
    with pytest.raises(ProgramError, match=what):
        list(planned(read_program(swings(tmp_path, head, body), kinematics=TRUNNION), "XYZAC", LIMITS))

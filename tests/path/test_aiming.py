"""Directions of the tool by I J K: rotary joints are chosen over the whole run of blocks."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from feeddrive.language.errors import ProgramError
from feeddrive.path.kinematics import Kinematics
from feeddrive.path.orientation import angle_between, choose_rotary
from feeddrive.path.program import aiming
from feeddrive.path.program.aiming import BY_AXES, Turning
from feeddrive.path.program.moves import Arc, Feed, Message, Move, Straight
from feeddrive.path.program.reading import read_program

TRUNNION = Kinematics.of("table_table", "AC", workpiece=(0.0, 0.0, -0.08), reversed_joints="AC")
NARROW = TRUNNION.with_travel({"A": (math.radians(-120.0), math.radians(30.0)), "C": (-math.pi, math.pi)})


def moves(folder: Path, text: str, kinematics: Kinematics = TRUNNION, turning: Turning = BY_AXES) -> list[Move]:
    path = folder / "part.ngc"
    path.write_text(f"G21 G90 F1000 G64 P0.01\n{text}\nM2\n", encoding="utf-8")
    return list(read_program(path, kinematics=kinematics, turning=turning))


def straight(folder: Path, text: str, kinematics: Kinematics = TRUNNION, turning: Turning = BY_AXES) -> list[Straight]:
    return [move for move in moves(folder, text, kinematics, turning) if isinstance(move, Straight)]


def words(axis: np.ndarray) -> str:
    return "".join(f"X{k} I{x:.12f} J{y:.12f} K{z:.12f}\n" for k, (x, y, z) in enumerate(axis.T, 1))


def spiral(count: int, turns: float, tilt: float = 0.5) -> np.ndarray:
    phi = 2.0 * math.pi * turns * np.linspace(0.0, 1.0, count)
    return np.array([np.sin(tilt) * np.sin(phi), np.sin(tilt) * np.cos(phi), np.full(count, np.cos(tilt))])


def rotary(found: list[Straight]) -> np.ndarray:
    return np.array([[move.end[3], move.end[5]] for move in found]).T


def test_a_run_begins_where_its_turns_fit_into_the_travel(tmp_path: Path) -> None:
    """C has 360 degrees, and the run turns it by 306: nearest block by block C would come to its end and jump."""
    axis = spiral(50, 0.85)
    found = rotary(straight(tmp_path, f"G43.5 H0\nG0 Z50 {words(axis[:, :1])[2:]}G1{words(axis)}", NARROW))[:, 1:]
    np.testing.assert_allclose(np.array(NARROW.tool_axis(found)), axis, atol=1e-9)
    assert np.abs(np.diff(found[1])).max() < 0.12
    assert np.abs(found[1]).max() <= math.pi
    # what follows is chosen by the same law over all blocks
    np.testing.assert_allclose(found, choose_rotary(NARROW, axis, start=(0.0, 0.0)).rotary, atol=1e-9)


def test_blocks_without_a_direction_and_arcs_keep_it(tmp_path: Path) -> None:
    text = "G43.5 H0\nG0 X1 I0 J1 K1\nG1 X2\nG2 X4 I1\nG1 X5 I1 J1 K1\nX6"
    found = [move for move in moves(tmp_path, text) if isinstance(move, Straight | Arc)]
    ends = np.array([[move.end[3], move.end[5]] for move in found])
    assert np.array_equal(ends[0], ends[1])
    assert np.array_equal(ends[0], ends[2])
    assert np.array_equal(ends[3], ends[4])
    assert not np.array_equal(ends[2], ends[3])
    assert all(np.array_equal(a.end, b.start) for a, b in pairwise(found))


POLE = "G43.5 H0\nG0 X0 Z50 J0.02 K1\nG1 X1 J0.01 K1\nX2 J0.0001 K1\nX3 I0.0002 K1\nX4 I0.01 K1\nX5 I0.02 K1"


def test_in_the_cone_at_the_pole_the_table_turns_evenly(tmp_path: Path) -> None:
    """The quarter of a turn is spread over the three blocks within 0.025 degrees of the pole; none is farther off."""
    cone = math.radians(0.025)
    wide = straight(tmp_path, POLE, turning=Turning(cone=cone))
    exact = straight(tmp_path, POLE)
    steps = np.abs(np.diff(rotary(wide)[1]))
    assert steps.max() == pytest.approx(math.pi / 6.0, rel=0.1)
    assert np.abs(np.diff(rotary(exact)[1])).max() == pytest.approx(math.pi / 2.0, rel=0.01)
    for a, b in zip(wide, exact, strict=True):
        apart = angle_between(*(np.array(TRUNNION.tool_axis([move.end[3], move.end[5]]))[:, None] for move in (a, b)))
        assert apart[0] <= a.off + 1e-12 <= cone + 1e-9
        assert b.off == 0.0
    assert sum(move.off > 0.0 for move in wide) == 3


def test_a_run_that_begins_in_the_cone_turns_the_table_from_where_it_stood(tmp_path: Path) -> None:
    text = "G43.5 H0\nG0 X0 Z50 K1\nG1 X1 K1\nX2 K1\nX3 I0.0002 K1\nX4 I0.02 K1"
    found = rotary(straight(tmp_path, text, turning=Turning(cone=math.radians(0.025))))[1]
    # the approach of 30 mm has most of the way, and each mm of the feed the same
    steps = np.abs(np.diff(found[:-1]))
    assert steps[0] == pytest.approx(math.pi / 2.0 / 34.0, rel=0.05)
    assert np.abs(steps - steps[0]).max() < 0.05 * steps[0]


@pytest.mark.parametrize("mode", ["G61", "G64"])
def test_without_a_tolerance_there_is_no_cone(tmp_path: Path, mode: str) -> None:
    cone = Turning(cone=math.radians(0.025))
    found = straight(tmp_path, POLE.replace("G43.5 H0", f"{mode}\nG43.5 H0"), turning=cone)
    assert all(move.off == 0.0 for move in found)
    if mode == "G64":
        always = straight(tmp_path, POLE.replace("G43.5 H0", "G64\nG43.5 H0"), turning=cone._replace(always=True))
        assert any(move.off > 0.0 for move in always)


def test_long_runs_are_chosen_in_windows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Windows of eight directions: the same joints along a spiral of two turns; memory does not grow with the run."""
    axis = spiral(60, 2.0)
    whole = rotary(straight(tmp_path, f"G43.5 H0\nG0 Z50 {words(axis[:, :1])[2:]}G1{words(axis)}"))
    monkeypatch.setattr(aiming, "MOST_AHEAD", 8)
    np.testing.assert_allclose(
        rotary(straight(tmp_path, f"G43.5 H0\nG0 Z50 {words(axis[:, :1])[2:]}G1{words(axis)}")), whole, atol=1e-12
    )


def test_a_program_that_asks_for_a_rotary_axis_gets_what_is_planned(tmp_path: Path) -> None:
    """#5425 is C; the run is chosen up to there.  Behind G49 the joints are those of the angles chosen."""
    text = "G43.5 H0\nG0 X1 I1 J1 K1\n(debug,#5423 #5425)\nG1 X2 I1 J2 K1\nG49\nG0 Z90"
    found = moves(tmp_path, text)
    lines = [move for move in found if isinstance(move, Straight)]
    told = next(move.text for move in found if isinstance(move, Message))
    np.testing.assert_allclose([float(x) for x in told.split()], np.degrees(rotary(lines)[:, 0]), atol=1e-5)
    joints = TRUNNION.linear(lines[1].end[:3], rotary(lines)[:, 1])
    np.testing.assert_allclose(lines[2].start[:3], joints, atol=1e-12)
    assert lines[2].start[3:] == lines[2].end[3:] == lines[1].end[3:]


def test_offsets_turn_the_direction_and_count_for_the_joints(tmp_path: Path) -> None:
    """G10 R turns the program about Z by 90 degrees: I is along Y then; an offset of C by 30 degrees changes nothing of
    the direction."""
    turned = straight(tmp_path, "G10 L2 P1 R90\nG43.5 H0\nG0 X1 I1 K1")
    np.testing.assert_allclose(TRUNNION.tool_axis(rotary(turned)[:, 0]), [0.0, 0.5**0.5, 0.5**0.5], atol=1e-12)
    shifted = straight(tmp_path, "G10 L2 P1 C30\nG43.5 H0\nG0 X1 I1 K1")
    np.testing.assert_allclose(TRUNNION.tool_axis(rotary(shifted)[:, -1]), [0.5**0.5, 0.0, 0.5**0.5], atol=1e-12)


def test_in_inverse_time_joints_are_chosen_block_by_block(tmp_path: Path) -> None:
    """F 2 is half a minute for the block: the feed is that of the angles, 2 x their way in degrees a minute."""
    found = straight(tmp_path, "G43.5 H0\nG0 Z50 J0.5 K1\nG93\nG1 I0.03 J0.5 K1 F2")
    axis = np.array([0.03, 0.5, 1.0])
    np.testing.assert_allclose(TRUNNION.tool_axis(rotary(found)[:, 1]), axis / np.linalg.norm(axis), atol=1e-12)
    feeds = [
        move for move in moves(tmp_path, "G43.5 H0\nG0 Z50 J0.5 K1\nG93\nG1 I0.03 J0.5 K1 F2") if isinstance(move, Feed)
    ]
    assert feeds[-2].angular == pytest.approx(np.linalg.norm(np.diff(rotary(found))) / 30.0, rel=1e-9)


@pytest.mark.parametrize(
    ("text", "line", "what"),
    [
        ("G43.5 H0\nG0 X1 J0.1 K1\nX2 J1 K-3\nX3 K1\nX4", 4, "it goes from -120 deg to 30 deg"),
        ("G43.5 H0\nG0 X1 J0.1 K1\nX2 I0 J0 K0", 4, "the direction of the tool I J K has no length"),
        ("G43.5 H0\nG0 X1 J1 K1\nG1 X2 J-1 K1\nX3", 4, "axis C turns by 180 deg in this feed"),
        ("G43.5 H0\nG0 X1 J0.1 K1\nX2 A3", 4, "G43.5 gives the direction of the tool by I J K, not by A"),
    ],
)
def test_errors_name_the_line_of_the_direction(tmp_path: Path, text: str, line: int, what: str) -> None:
    """Also of a direction that is chosen when the run has ended, some lines later."""
    with pytest.raises(ProgramError, match=f"line {line},.*{what}"):
        moves(tmp_path, text, NARROW)


def test_a_run_that_winds_a_joint_beyond_a_million_degrees_is_refused(tmp_path: Path) -> None:
    """From 999,000 degrees on, three turns end behind 1e6; the line is that of the block there."""
    text = f"G0 C999500\nG43.5 H0\nG0 Z50\nG1{words(spiral(60, 3.0))}"
    with pytest.raises(ProgramError, match=r"line \d+.*joint C would be wound to 1.*at most 1"):
        moves(tmp_path, text)

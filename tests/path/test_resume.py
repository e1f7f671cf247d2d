"""A program resumed at a line, and one that begins away from the zero of the machine."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.language.errors import FeeddriveError, ParameterError, ProgramError
from feeddrive.path.limits import AxisLimits, MachineLimits
from feeddrive.path.program.moves import Arc, Begin, Feed, Move, PathMode, Spindle, Spline, Straight, ToolChange
from feeddrive.path.program.reading import read_commands, read_program
from feeddrive.path.setpoints import Setpoints

Text = Callable[[str], Path]

PROGRAM = """(units, offsets, planes, cycles, subroutines and loops)
o1 sub
G91 G1 X1 Y#1
G90
o1 endsub
G21 G90 G64 P0.02
G10 L2 P1 X5 Y5 R30
T2 M6
S4000 M3
G0 X1 Y2 Z3
G1 X10 F600
o1 call [2]
G20
G1 X0.5 Y0.1
G18 G2 X0.7 I0.1 K0
G17 G21
G92 X0
G91
G1 X3 Y3 F900
G81 X1 Z-1 R0.5
X1
G80 G90
o2 if [1]
G1 X4
o2 endif
o3 repeat [3]
G91 G1 X1
G90
o3 endrepeat
G55
G61
G93 G1 X1 Y1 F10
G94 F500 G5 I1 J1 P-1 Q1 X3 Y1
G4 P0.5
G1 X2
G41.1 D0.5
G1 X6
X6 Y6
G40
G1 X0
X1
M2
"""
REFUSED = {
    3: "is not run on the way", 4: "is not run on the way", 5: "is not run on the way",
    27: "lies in the loop o3 repeat of line 26", 28: "lies in the loop o3", 29: "lies in the loop o3",
    37: "radius compensation is on", 38: "radius compensation is on", 39: "radius compensation is on",
    40: "or its last move not yet done",
}  # fmt: skip


@pytest.fixture
def program(tmp_path: Path) -> Text:
    def write(text: str) -> Path:
        path = tmp_path / "part.ngc"
        path.write_text(text, encoding="utf-8")
        return path

    return write


class Run(NamedTuple):
    """A move along the path, and the feed, the spindle and the path mode in which it runs."""

    move: Straight | Arc | Spline
    feed: object
    spindle: object
    mode: object


def going(moves: list[Move]) -> list[Run]:
    """The moves along the path."""
    rows: list[Run] = []
    modes: dict[type, object] = {}
    for move in moves:
        if isinstance(move, Feed):
            modes[Feed] = (move.linear, move.angular, move.per_turn)
        elif isinstance(move, Spindle):
            modes[Spindle] = (move.spindle_speed, move.direction)
        elif isinstance(move, PathMode):
            modes[PathMode] = (move.mode, move.tolerance)
        elif isinstance(move, Straight | Arc | Spline):
            rows.append(Run(move, modes.get(Feed), modes.get(Spindle), modes.get(PathMode)))
    return rows


def called(move: Straight | Arc | Spline) -> bool:
    """True for the move of the subroutine, which line 12 calls."""
    return move.source.number == 3


def test_a_resumed_program_makes_the_moves_that_are_left(program: Text) -> None:
    """At each line, to the bit, with their feed, spindle and path mode; lines in loops or compensation are refused."""
    path = program(PROGRAM)
    every = list(read_program(path))
    last = len(PROGRAM.splitlines())
    for line in range(1, last + 1):
        if line in REFUSED:
            with pytest.raises(ProgramError, match=REFUSED[line]) as caught:
                list(read_program(path, from_line=line))
            assert f"line {line} (--from-line)" in str(caught.value)
            continue
        begin, *left = read_program(path, from_line=line)
        assert isinstance(begin, Begin)
        assert begin.source.number == line
        ahead = [run for run in going(every) if run.move.source.number >= line or (line <= 12 and called(run.move))]
        assert going(left) == ahead
        if ahead:
            np.testing.assert_array_equal(begin.position, ahead[0].move.start)
        assert not [move for move in left if isinstance(move, ToolChange) and line > 8]


def test_the_state_is_told_in_words(program: Text) -> None:
    def words(line: int) -> str:
        begin = next(iter(read_program(program(PROGRAM), from_line=line)))
        assert isinstance(begin, Begin)
        return begin.state

    assert words(11) == "G21 G17 G90 G94 G64 P0.02 G40 G54 T2 S4000 M3, no feed"
    assert words(15) == "G20 G17 G90 G94 G64 P0.000787402 G40 G54 T2 S4000 M3, feed 600 mm/min"
    assert words(20).startswith("G21 G17 G91 G94 G64 P0.02 G40 G54 T2 S4000 M3 G92 X")
    assert words(20).endswith(", feed 900 mm/min")
    assert words(33).startswith("G21 G17 G90 G93 G61 G40 G55")


def test_a_start_away_from_the_line_is_a_traverse_to_it(program: Text) -> None:
    """The state is set before; from the place where the line begins there is none."""
    path = program(PROGRAM)
    moves = list(read_program(path, from_line=11, start={"X": 0.02, "Y": 0.01}))
    first = next(move for move in moves if isinstance(move, Straight))
    assert first.traverse
    assert first.start[:3] == (0.02, 0.01, 0.0)
    assert first.end == next(iter(read_program(path, from_line=11))).position  # type: ignore[union-attr]


def test_a_program_begins_where_the_machine_stands(program: Text) -> None:
    """With X alone the other axes stay, in each work offset; a dwell at first stands there."""
    path = program("G4 P0.1\nG64 P0.01\nG1 X20 F600\nM2\n")
    begin, *moves = read_program(path, start={"X": 0.01, "Y": 0.003, "C": 1.0})
    assert isinstance(begin, Begin)
    straight = next(move for move in moves if isinstance(move, Straight))
    assert straight.start[:2] == pytest.approx((0.01, 0.003), abs=1e-15)
    assert straight.end[:2] == pytest.approx((0.02, 0.003), abs=1e-15)
    assert straight.start[5] == straight.end[5] == pytest.approx(1.0, abs=1e-15)
    axis = AxisLimits(velocity=0.5, acceleration=5.0, jerk=100.0, snap=5e4)
    setpoints = Setpoints(
        read_program(path, start={"X": 0.01, "Y": 0.003}), MachineLimits({"X": axis, "Y": axis}), 1e-3
    )
    rows = np.concatenate([samples.values[:, :, 0] for samples in setpoints])
    np.testing.assert_allclose(rows[0], [0.01, 0.003], atol=1e-15)
    assert np.max(np.abs(np.diff(rows, axis=0))) < 1e-3  # no jump between dwell and move
    assert setpoints.proven


def test_the_command_says_what_it_assumes(program: Text) -> None:
    """Through the command, in mm and degrees."""
    path = program("G64 P0.01\nG1 X10 F600\nX20\nX30 Y1\nM2\n")
    whole = fd.workflow.plan(path, machine="xy_table")
    part = fd.workflow.plan(path, machine="xy_table", from_line=4)
    assert part.blocks == 1
    assert whole.blocks == 3
    elsewhere = fd.workflow.plan(path, machine="xy_table", from_line=4, start="X=21, Y=1.5")
    assert elsewhere.blocks == 2


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"start": "X"}, "--start: 'X' is no name with a number: write X=10, Y=-5"),
        ({"start": "Z=1"}, "start: the machine has no axis Z; it has X, Y"),
        ({"start": "X=900"}, "start: axis X at 900 mm is beyond its travel of -50 mm to 300 mm"),
        ({"from_line": 9}, "line 3, column 1: the program ends here, before line 9 (--from-line)"),
        ({"from_line": 2, "front_end": "rs274"}, "starts at the zero of the machine and line 1"),
    ],
)
def test_what_cannot_be_resumed_is_refused(given: dict[str, object], said: str, program: Text) -> None:
    path = program("G64 P0.01\nG1 X10 F600\nM2\n")
    with pytest.raises(FeeddriveError) as caught:
        fd.workflow.plan(path, machine="xy_table", **given)  # type: ignore[arg-type]
    assert said in str(caught.value), str(caught.value)


def test_a_start_is_within_the_travel_of_its_axes(program: Text) -> None:
    """Angles in degrees in the message."""
    path = program("M2\n")
    with pytest.raises(ParameterError, match="axis C at 180 deg is beyond its travel of -90 deg to 90 deg"):
        read_program(path, axes={"C": (-math.pi / 2, math.pi / 2)}, start={"C": math.pi})
    assert [command.name for command in read_commands(path, from_line=1)].count("RESUME") == 1

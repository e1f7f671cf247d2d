"""SINUMERIK programs: what they share with RS-274 (resume, start, compensation, tool point), and subprograms."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from test_resume import going

from feeddrive.files.machine import find_bundled
from feeddrive.language.errors import ProgramError
from feeddrive.path.kinematics import Kinematics
from feeddrive.path.program.moves import Arc, Begin, Feed, Message, Move, PathMode, Spline, Stop, Straight, ToolPoint
from feeddrive.path.program.reading import read_program

TRUNNION = Kinematics.of("table_table", "AC", workpiece=(0.0, 0.0, -0.08), reversed_joints="AC")
TABLE = "T1 P1 Z30 D6 ;MILL\nT2 P2 Z50 D10\n"


def moves(folder: Path, text: str, **options: object) -> list[Move]:
    path = folder / "part.mpf"
    path.write_text(text, encoding="utf-8")
    return list(read_program(path, dialect="siemens", **options))  # type: ignore[arg-type]


def native(folder: Path, text: str, **options: object) -> list[Move]:
    path = folder / "part.ngc"
    path.write_text(text, encoding="utf-8")
    return list(read_program(path, front_end="own", **options))  # type: ignore[arg-type]


def refused(folder: Path, text: str, **options: object) -> str:
    with pytest.raises(ProgramError) as caught:
        moves(folder, text, **options)
    return str(caught.value)


def path_of(found: list[Move]) -> list[Straight | Arc | Spline]:
    return [move for move in found if isinstance(move, Straight | Arc | Spline)]


def ends(found: list[Move]) -> list[tuple[float, ...]]:
    """X Y Z of the ends of all motions, mm."""
    return [tuple(round(1e3 * value, 6) + 0.0 for value in move.end[:3]) for move in path_of(found)]


@pytest.fixture
def table(tmp_path: Path) -> Path:
    path = tmp_path / "tool.tbl"
    path.write_text(TABLE)
    return path


# resume and start

PROGRAM = """G71 G90 G642 CTOL=0.02
T="MILL" M6
S4000 M3
TRANS X5 Y5
AROT RPL=30
G0 X1 Y2 Z3
G1 X10 F600
LAYER
G70 X0.5 Y0.1
G18 G2 X0.7 I0.1 K0
G17 G71
FOR R1=1 TO 3
G1 X=IC(1)
ENDFOR
G41 X20 Y20
Y30
G40 X30
X31
M30
%_N_LAYER_SPF
X=IC(2)
M17
"""
REFUSED = {
    13: "lies in the loop FOR of line 12", 14: "lies in the loop FOR",
    16: "radius compensation is on", 17: "radius compensation is on", 19: "", 20: "ends here, before line 20",
    21: "lies in a subroutine", 22: "lies in a subroutine",
}  # fmt: skip


def test_a_resumed_program_makes_the_moves_that_are_left(tmp_path: Path, table: Path) -> None:
    every = moves(tmp_path, PROGRAM, tools=table)
    for line in range(1, 23):
        if REFUSED.get(line):
            assert REFUSED[line] in refused(tmp_path, PROGRAM, tools=table, from_line=line)
            continue
        begin, *left = moves(tmp_path, PROGRAM, tools=table, from_line=line)
        assert isinstance(begin, Begin)
        ahead = [
            run
            for run in going(every)
            if line <= run.move.source.number <= 19 or (line <= 8 and run.move.source.number == 21)
        ]
        assert going(left) == ahead
        if ahead:
            np.testing.assert_array_equal(begin.position, ahead[0].move.start)


def test_the_state_is_told_in_words_of_the_control(tmp_path: Path, table: Path) -> None:
    begin = moves(tmp_path, PROGRAM, tools=table, from_line=11)[0]
    assert isinstance(begin, Begin)
    assert begin.state == (
        "G70 G18 G90 G94 G642 CTOL=0.02 G54 G450 T1 D1 S4000 M3 TRANS X5 Y5 AROT RPL=30, feed 600 mm/min"
    )


def test_the_machine_may_stand_anywhere(tmp_path: Path) -> None:
    found = moves(tmp_path, "TRANS X10\nG0 X=IC(1) Y1\nM30\n", start={"X": 0.1, "Z": -0.02})
    assert isinstance(found[0], Begin)
    assert ends(found) == [(111, 1, -20)]


# radius compensation

CONTOUR = "G1 X0 Y0 F900\nX40\nG3 X50 Y10 {}10\nG1 Y40\nX30 Y20\nX20 Y40\nG2 X0 Y40 {}10\nG1 Y0\nX10\n"


@pytest.mark.parametrize("word", ["G41", "G42"])
def test_the_way_along_a_contour_is_that_of_rs274(word: str, tmp_path: Path, table: Path) -> None:
    """Lines, arcs, inner and outer corners; the first and the last move differ: NORM ends square to the next move."""
    approach = {"G41": "X-10 Y-5", "G42": "X-10 Y5"}[word]
    own = path_of(
        moves(
            tmp_path,
            f"T1 M6\nG0 {approach}\n{word} G1 X-5 Y0 F900\n{CONTOUR.format('CR=', 'CR=')}G40 X15 Y20\nM30\n",
            tools=table,
        )
    )
    other = path_of(
        native(
            tmp_path,
            f"G43 T1 M6 H1\nG0 {approach}\n{word} D1 G1 X-5 Y0 F900\n{CONTOUR.format('R', 'R')}G40 X15 Y20\nM2\n",
            tools=table,
        )
    )
    both = [[move for move in row if move.source.number > 4] for row in (own, other)]
    assert len(both[0]) == len(both[1]) > 9
    for ours, theirs in zip(*both, strict=True):
        assert type(ours) is type(theirs)
        np.testing.assert_allclose(ours.end, theirs.end, atol=1e-12)
        if isinstance(ours, Arc) and isinstance(theirs, Arc):
            assert ours.turns == theirs.turns
            np.testing.assert_allclose(ours.center, theirs.center, atol=1e-12)


def test_norm_leads_square_to_the_first_move(tmp_path: Path, table: Path) -> None:
    """3 mm to the left of the start of the contour, whatever the direction and length of the lead-in; out in the same
    way, and infeeds stay where the tool is."""
    text = "T1 M6\nG0 X-2 Y-1 Z30\nG41 X0 Y0\nG1 Z29 F900\nX10\nG0 Z30\nG40 X10 Y0\nM30\n"
    assert ends(moves(tmp_path, text, tools=table)) == [
        (-2, -1, 60),
        (0, 3, 60),
        (0, 3, 59),
        (10, 3, 59),
        (10, 3, 60),
        (10, 0, 60),
    ]
    # a move of the infeed axis before the lead-in
    text = "T1 M6\nG0 X-2 Y-1\nG42\nG1 Z-1 F900\nX0 Y0\nY10\nG40 X5 Y10\nM30\n"
    assert ends(moves(tmp_path, text, tools=table))[:4] == [(-2, -1, 0), (-2, -1, 29), (3, 0, 29), (3, 10, 29)]


def test_g451_goes_to_the_intersection_and_g450_around_the_corner(tmp_path: Path, table: Path) -> None:
    square = "T1 M6\nG0 X-10 Y0\nG41 G451 G1 X0 Y0 F900\nY10\nX10\n{}\nG40 X20 Y-5\nM30\n"
    assert ends(moves(tmp_path, square.format("Y0"), tools=table))[2:5] == [(-3, 13, 0), (13, 13, 0), (13, 0, 0)]
    # 120 degrees: an arc, as beyond 100 degrees on the control as delivered
    sharp = path_of(moves(tmp_path, square.format("X5 Y1.3397459621556"), tools=table))
    assert [type(move) for move in sharp[3:6]] == [Straight, Arc, Straight]
    flat = path_of(moves(tmp_path, square.format("X9 Y4"), tools=table))
    assert [type(move) for move in flat[3:5]] == [Straight, Straight]
    mixed = "T1 M6\nG0 X-10\nG41 G451 G1 X0 F900\nY10\nG450 X10\nY0\nG40 X20\nM30\n"
    assert [type(move) for move in path_of(moves(tmp_path, mixed, tools=table))] == [
        *(Straight, Straight, Straight, Arc, Straight, Arc, Straight, Straight),
    ]


def sampled(move: Straight | Arc, count: int) -> np.ndarray:
    """Points of a move in X Y, mm."""
    s = np.linspace(0.0, 1.0, count)[:, None]
    start, end = (1e3 * np.array(point[:2]) for point in (move.start, move.end))
    if isinstance(move, Straight):
        return start + s * (end - start)
    center = 1e3 * np.array(move.center)
    angle = math.atan2(*(start - center)[::-1]) + s[:, 0] * move.angle
    return center + 1e3 * move.radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


@pytest.mark.parametrize("corners", ["G450", "G451"])
@pytest.mark.parametrize("seed", range(4))
def test_the_center_keeps_the_radius_from_the_contour(seed: int, corners: str, tmp_path: Path, table: Path) -> None:
    """Drawn contours of lines and arcs: each point of the center's path lies 3 mm from the contour or more, and on its
    side; with G450 exactly 3 mm, but for corners below 0.05 rad, where 0.00125 of the radius may lack, times
    R/(R - r) inside of an arc."""
    draw = np.random.default_rng(seed)
    left = bool(draw.random() < 0.5)
    turns = draw.uniform(-0.35, 0.35, 12)
    heading, here, lines = 0.0, np.zeros(2), ["G1 X0 Y0 F900"]
    for k, turn in enumerate(turns):
        heading += turn
        way = np.array([math.cos(heading), math.sin(heading)])
        size = float(draw.uniform(10.0, 20.0))
        if k % 3 == 2 and corners == "G450":
            # tangential arc of 30 mm radius, and 0.3 rad
            sense = 1.0 if draw.random() < 0.5 else -1.0
            center = here + 30.0 * sense * np.array([-way[1], way[0]])
            c, s = math.cos(0.3 * sense), math.sin(0.3 * sense)
            away = here - center
            end = center + np.array([c * away[0] - s * away[1], s * away[0] + c * away[1]])
            i, j = center - here
            lines.append(f"G{3 if sense > 0 else 2} X{end[0]:.9f} Y{end[1]:.9f} I{i:.9f} J{j:.9f}")
            here, heading = end, heading + 0.3 * sense
        else:
            here = here + size * way
            lines.append(f"G1 X{here[0]:.9f} Y{here[1]:.9f}")
    body = "\n".join(lines)
    word = "G41" if left else "G42"
    text = f"T1 M6\nG0 X-20\n{word} {corners}\n{body}\nG40 G1 X200 Y200\nM30\n"
    plain = f"F900\nG0 X-20\n\n{body}\nG1 X200 Y200\nM30\n"
    center_path = path_of(moves(tmp_path, text, tools=table))
    contour = path_of(moves(tmp_path, plain))
    dense = np.concatenate([sampled(move, 600) for move in contour if 4 < move.source.number < 17])  # type: ignore[arg-type]
    low = 3.0 * (1.0 - 0.00125 * 30.0 / 27.0) - 1e-4
    for move in center_path:
        if not 4 < move.source.number < 17:
            continue
        points = sampled(move, 9)  # type: ignore[arg-type]
        apart = np.linalg.norm(points[:, None] - dense[None], axis=2)
        nearest, least = dense[apart.argmin(axis=1)], apart.min(axis=1)
        assert np.all(least > low)
        if corners == "G450":
            assert np.all(least < 3.0 + 1e-3)
        middle = points[4] - nearest[4]
        along = points[5] - points[3]
        assert (along[0] * middle[1] - along[1] * middle[0] > 0.0) == left


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("T1 M6\nG41 G2 X5 Y5 CR=10 F9\n", "the move behind G41 or G42 is straight"),
        ("T1 M6\nG0 G41 X1\nG42 X2\n", "line 3, column 1: G42: G41 is on: write G40"),
        ("T1 M6\nKONT\nG41 X1\n", "line 3, column 1: KONT: the way around the start of the contour"),
        ("T1 M6\nG0 G41 X1\nG18\n", "G18 does not go with radius compensation"),
        ("T1 M6\nG0 G41 X1\nTRANS X1\n", "TRANS does not go with radius compensation"),
        ("T1 M6\nG0 G41 X1\nSUPA X1\n", "SUPA does not go"),
        ("T1 M6\nG0 G41 X1\nD0\n", "D does not go"),
        ("T1 M6\nG0 G41 X1\nT2 M6\n", "M6 does not go"),
        ("T1 M6\nG450 DISC=50\n", "DISC distorts the arc at a corner"),
        ("T1 M6\nG41 G451 G1 X10 F900\nX20\nG3 X30 Y0 I5 J0\n", "how G451 lengthens an arc"),
        ("T1 M6\nG41 G1 X10 F900\nX20\nY1\nX21\n", "does not reach this inner corner"),
    ],
)
def test_what_does_not_go_with_compensation_is_refused(text: str, reason: str, tmp_path: Path, table: Path) -> None:
    assert reason in refused(tmp_path, text, tools=table)


# subprograms


def test_subprograms_in_the_file_and_beside_it(tmp_path: Path) -> None:
    (tmp_path / "hole.spf").write_text("PROC HOLE(REAL DEPTH, REAL CLEAR=1, VAR REAL COUNT) DISPLOF\n"
        "DEF REAL HERE=5\nG1 Z=-DEPTH\nG0 Z=CLEAR\nCOUNT=COUNT+1 R9=HERE\nRET\n")  # fmt: skip
    text = """%_N_PART_MPF
;$PATH=/_N_WKS_DIR
EXTERN HOLE(REAL, REAL, VAR REAL)
DEF REAL N1COUNT=0
F900
G0 X1
HOLE(3,,N1COUNT)
X2
HOLE(R1+4,2,N1COUNT)
L10 P2
CALL "STEP"
IF N1COUNT<>2 GOTOF WRONG
IF R9==5 GOTOF RIGHT
WRONG: X99
RIGHT: X0
M30
%_N_L10_SPF
X=IC(10)
GOTOF RIGHT
X77
RIGHT: STEP
M17
%_N_STEP_SPF
Y=IC(1)
"""
    assert ends(moves(tmp_path, text)) == [
        *((1, 0, 0), (1, 0, -3), (1, 0, 1), (2, 0, 1), (2, 0, -4), (2, 0, 2)),
        *((12, 0, 2), (12, 1, 2), (22, 1, 2), (22, 2, 2), (22, 3, 2), (0, 3, 2)),
    ]


SAVING = """G17 G54 G71 G90 G642 CTOL=0.01 F1000
TRANS X5
G1 X10 Y0
STEP P2
X20
Y5
M30
%_N_STEP_SPF
PROC STEP{}
G91 G60
ATRANS X1
G0 X1
G18 G55 F500 CTOL=0.02
M17
"""


def test_a_subprogram_with_save_leaves_g_codes_and_frames_as_they_were(tmp_path: Path) -> None:
    """Without it the caller goes on in G0, G91, G60 and the frames of the subprogram; F and CTOL stand in any case."""
    offsets = tmp_path / "offsets.var"
    offsets.write_text("".join(f"{number}\t{100.0 if number == 5241 else 0.0}\n" for number in range(5221, 5281)))

    def last(attribute: str) -> tuple[list[tuple[float, ...]], list[bool], PathMode, Feed]:
        found = moves(tmp_path, SAVING.format(attribute), offsets=offsets)
        traverses = [move.traverse for move in found if isinstance(move, Straight)]
        modes = [move for move in found if isinstance(move, PathMode)]
        feeds = [move for move in found if isinstance(move, Feed)]
        return ends(found), traverses, modes[-1], feeds[-1]

    points, traverses, mode, feed = last(" SAVE")
    # an incremental move makes the changes of frames before it, too: +1, and in the second pass -1 + 1
    assert points == [(15.0, 0.0, 0.0), (17.0, 0.0, 0.0), (18.0, 0.0, 0.0), (25.0, 0.0, 0.0), (25.0, 5.0, 0.0)]
    assert traverses == [False, True, True, False, False]
    assert (mode.mode, mode.tolerance) == ("continuous", 2e-5)
    assert feed.linear == pytest.approx(0.5 / 60.0)
    points, traverses, mode, _ = last("")
    assert points[-1] != (25.0, 5.0, 0.0)
    assert traverses == [False, True, True, True, True]
    assert mode.mode == "exact_stop"


def test_save_does_not_restore_a_contour(tmp_path: Path) -> None:
    text = "G1 F100 X1\nSTEP\nM30\n%_N_STEP_SPF\nPROC STEP SAVE\nG41 X5\nX9\nM17\n"
    table = tmp_path / "tools.tbl"
    table.write_text("T1 P1 D4\n")
    with pytest.raises(ProgramError, match=r"line 9.*G41 is on at the end of a subprogram with SAVE.*write G40"):
        moves(tmp_path, "T1 M6\n" + text, tools=table)


def test_a_modal_call_is_made_behind_each_motion(tmp_path: Path) -> None:
    drill = "%_N_DRILL_SPF\nPROC DRILL(REAL D)\nZ=-D\nZ0\nM17\n"
    text = f"F900\nMCALL DRILL(2)\nX10\nM8 S1000\nX20 Y5\nMCALL\nX0\nM30\n{drill}"
    assert ends(moves(tmp_path, text)) == [
        *((10, 0, 0), (10, 0, -2), (10, 0, 0), (20, 5, 0), (20, 5, -2), (20, 5, 0), (0, 5, 0)),
    ]


def test_a_call_repeats_9999_times_at_most(tmp_path: Path) -> None:
    text = "L10 P{}\nX=R1 F9\nM30\n%_N_L10_SPF\nR1=R1+1 RET\n"
    assert ends(moves(tmp_path, text.format(9999))) == [(9999, 0, 0)]
    assert "P repeats a call 1 to 9999 times, not 10000" in refused(tmp_path, text.format(10000))


def test_nested_repeats_count_as_lines_that_are_read_again(tmp_path: Path) -> None:
    text = "L1 P99\nM30\n%_N_L1_SPF\nL2 P99\nRET\n%_N_L2_SPF\nX=IC(1) F9\nRET\n"
    assert "does a loop never end" in refused(tmp_path, text, most_again=5000)


@pytest.mark.parametrize(("word", "stops"), [("M17", 1), ("M2", 1), ("RET", 0)])
def test_only_ret_does_not_stop_the_path(word: str, stops: int, tmp_path: Path) -> None:
    found = moves(tmp_path, f"F900\nSTEP\nX5\nM30\n%_N_STEP_SPF\nX1\n{word}\n")
    assert sum(isinstance(move, Stop) for move in found) == stops
    assert ends(found) == [(1, 0, 0), (5, 0, 0)]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("POCKET(1)\n", "column 1: POCKET: the word POCKET is not known here, and there is no subprogram POCKET"),
        ('CALL "../STEP"\n', "is no name of a program beside this one"),
        ('EXTCALL("OTHER")\n', "there is no subprogram OTHER: neither %_N_OTHER_SPF in this file nor OTHER.SPF beside"),
        ("MCALL OTHER\n", "there is no subprogram OTHER"),
        ("STEP X1\nM30\n%_N_STEP_SPF\nM17\n", "stands in a block of its own"),
        ("STEP(1)\nM30\n%_N_STEP_SPF\nX1\n", "STEP was called with arguments, and does not begin with PROC STEP"),
        ("STEP(1,2)\nM30\n%_N_STEP_SPF\nPROC STEP(REAL A)\nX=A\n", "STEP has 1 parameters, and the call 2"),
        ("STEP\nM30\n%_N_STEP_SPF\nPROC STEP ICYCOF\n", "ICYCOF of PROC is not planned"),
        ("STEP\nM30\n%_N_STEP_SPF\nPROC STEP(STRING[9] A)\n", r"none of REAL, INT and BOOL"),
        ("STEP\nM30\n%_N_STEP_SPF\nFOR R1=1 TO 2\nM17\n", "the program ends inside FOR"),
        ("DEF REAL A=1\nSTEP\nM30\n%_N_STEP_SPF\nX=A\n", "line 5, column 3: A: the variable A has no value here"),
        ("STEP\nM30\n%_N_STEP_SPF\nSTEP\n", "more than 50 deep"),
        ("F9\nMCALL L10\nX1 M30\n%_N_L10_SPF\nZ1\n", "does not return in its block: use two lines"),
        ("L10 P0\nM30\n%_N_L10_SPF\nM17\n", "P repeats a call 1 to 9999 times, not 0"),
        ("GOTOF THERE\nM30\n%_N_L10_SPF\nTHERE: X1\n", "no label or block number THERE"),
        ("IF 0\nM30\n%_N_L10_SPF\nENDIF\n", "IF has no ELSE or ENDIF"),
        ("G1 X1 P3 F9\n", "no code of this block uses the word P"),
        ('CALL POCKET\n', "CALL needs the name of a program in quotes"),
    ],
)  # fmt: skip
def test_calls_that_are_wrong_are_refused(text: str, reason: str, tmp_path: Path) -> None:
    assert reason in refused(tmp_path, text)


# the tool point

ORI = """G71 G90 G64 F3000
T2 M6
G0 X20 Y-10 Z60 A-20 C30
TRAORI
ORIAXES
G0 X1 Y2 Z10
G1 X5 A3=0.1 B3=-0.2 C3=2
X8 Y=IC(2)
X9 B3=1 C3=3
A-12
G2 X15 CR=6
TRAFOOF
G1 X30 Z80
M30
"""
POINT = """G21 G90 G64 F3000
T2 M6 G43
G0 X20 Y-10 Z60 A-20 C30
G43.4

G0 X1 Y2 Z10
G1 X5 A{0} C{1}
X8 Y4
X9 A{2} C{3}
A-12
G2 X15 R6
G49
G43
G1 X30 Z80
M2
"""


def test_traori_moves_the_tip_as_g43_4_does(tmp_path: Path, table: Path) -> None:
    """Directions give the angles of the closed form; the same part in both languages has the same moves, in m."""
    own = moves(tmp_path, ORI, tools=table, kinematics=TRUNNION)
    angles: list[float] = []
    start = np.radians([-20.0, 30.0])
    for axis in ([0.1, -0.2, 2.0], [0.0, 1.0, 3.0]):
        branches = TRUNNION.rotary(np.array(axis) / np.linalg.norm(axis)).angles[:, :, 0]
        turns = branches + 2.0 * math.pi * np.round((start - branches) / (2.0 * math.pi))
        start = turns[np.argmin(np.abs(turns - start).max(axis=1))]
        angles += np.degrees(start).tolist()
    other = native(tmp_path, POINT.format(*(f"{x:.15f}" for x in angles)), tools=table, kinematics=TRUNNION)
    ours, theirs = path_of(own), path_of(other)
    assert len(ours) == len(theirs) == 8
    for a, b in zip(ours, theirs, strict=True):
        assert type(a) is type(b)
        np.testing.assert_allclose(a.start, b.start, atol=1e-13)
        np.testing.assert_allclose(a.end, b.end, atol=1e-13)
    points = [[move.kinematics for move in found if isinstance(move, ToolPoint)] for found in (own, other)]
    assert points[0] == points[1]
    assert points[0][0] is not None
    assert points[0][0].tool == (0.0, 0.0, -0.05)


def test_a_bundled_program_is_the_same_in_both_languages(tmp_path: Path) -> None:
    """With rotary letters to the bit; with directions of twelve digits, 1e-9 rad and 1e-12 m."""
    text = find_bundled("s_curve", "programs", ".ngc").read_text(encoding="utf-8")
    text = re.sub(r"\([^)]*\)", "", text)
    for word, ours in {
        "G21": "G71",
        "G64 P0.01": "G642 CTOL=0.01",
        "G43.4 H0": "TRAORI ORIAXES",
        "G49": "TRAFOOF",
    }.items():
        text = text.replace(word, ours)
    lines = text.replace("M2\n", "M30\n").splitlines()
    theirs = path_of(
        list(read_program(find_bundled("s_curve", "programs", ".ngc"), front_end="own", kinematics=TRUNNION))
    )
    letters = path_of(moves(tmp_path, "\n".join(lines), kinematics=TRUNNION))
    assert [(move.start, move.end) for move in letters] == [(move.start, move.end) for move in theirs]
    turned = 4
    for k, line in enumerate(lines[7:], 7):
        if angles := re.search(r"A(\S+) C(\S+)", line):
            x, y, z = TRUNNION.tool_axis(np.radians([float(angles[1]), float(angles[2])]))
            lines[k] = f"{line[: angles.start()]}A3={x:.12f} B3={y:.12f} C3={z:.12f}"
            turned += 1
    assert turned > 1900
    vectors = path_of(moves(tmp_path, "\n".join(lines), kinematics=TRUNNION))
    np.testing.assert_allclose([move.end for move in vectors], [move.end for move in theirs], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("word", "code", "how"),
    [
        ("ORIAXES", 0, "axes"),
        ("ORIMKS", 0, "axes"),
        ("ORIVECT", 1, "plane"),
        ("ORIPLANE", 1, "plane"),
        ("ORIWKS", 1, "plane"),
    ],
)
def test_words_say_how_the_tool_turns(word: str, code: int, how: str, tmp_path: Path) -> None:
    """As G43.5 with P does, before or behind TRAORI; the next word changes it."""
    body = "G1 X1 {0}0.1 {1}0 {2}1 F900\nX2 {0}0.2 {1}0.1 {2}1\nX3\nX4 {0}0 {1}0.3 {2}1\n"
    vector, ijk = body.format("A3=", "B3=", "C3="), body.format("I", "J", "K")
    before = path_of(moves(tmp_path, f"{word}\nTRAORI\n{vector}TRAFOOF\nM30\n", kinematics=TRUNNION))
    behind = path_of(moves(tmp_path, f"TRAORI {word}\n\n{vector}TRAFOOF\nM30\n", kinematics=TRUNNION))
    other = path_of(native(tmp_path, f"G43.5 H0 P{code}\n\n{ijk}G49\nM2\n", kinematics=TRUNNION))
    assert len(before) == len(other) == 4
    for row in zip(before, behind, other, strict=True):
        assert all(isinstance(move, Straight) and move.orientation == how for move in row)
        for move in row[:2]:
            np.testing.assert_array_equal(move.end, row[2].end)
    both = path_of(
        moves(tmp_path, f"TRAORI\n{word}\nG1 X1 B3=0.1 C3=1 F9\nORIAXES\nX2 B3=0 C3=1\nM30\n", kinematics=TRUNNION)
    )
    assert [move.orientation for move in both if isinstance(move, Straight)] == [how, "axes"]


def test_another_edge_while_the_tip_is_moved_changes_its_length(tmp_path: Path, table: Path) -> None:
    """The joints stand still while D0 takes 50 mm of length away, and the tip in the frame of the workpiece moves."""
    text = "T2 M6 D1\nG0 A-90\nTRAORI\nMSG($AA_IW[Y])\nD0\nMSG($AA_IW[Y])\nX1\nM30\n"
    kinematics = Kinematics.of("table_table", "AC", tool_length=0.0)
    told = [float(m.text) for m in moves(tmp_path, text, tools=table, kinematics=kinematics) if isinstance(m, Message)]
    assert abs(told[1] - told[0]) == pytest.approx(50.0, abs=1e-9)


def test_directions_turn_with_the_frame(tmp_path: Path) -> None:
    """ROT RPL=90 turns A3=1 of the program into B3=1 of the machine's frame."""
    turned = path_of(moves(tmp_path, "TRAORI\nROT RPL=90\nG0 A3=1 C3=2\nM30\n", kinematics=TRUNNION))
    plain = path_of(moves(tmp_path, "TRAORI\nG0 B3=1 C3=2\nM30\n", kinematics=TRUNNION))
    np.testing.assert_allclose(turned[-1].end, plain[-1].end, atol=1e-15)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("TRAORI\nA3=0\n", "the direction of the tool A3 B3 C3 has no length: write A3=0 B3=0 C3=1"),
        ("TRAORI\nG0 C3=1 A5\n", "A and A3= B3= C3= exclude each other"),
        ("TRAORI\nSUPA Z0\n", "positions of the machine's axes do not go with TRAORI: write TRAFOOF"),
        ("TRAORI\nT1 M6\n", "M6 changes the tool while its tip is moved (TRAORI): write TRAFOOF in a line before"),
        ("T1 M6\nTRAORI\nG41 X1\n", "while the tip of a tilted tool is moved (TRAORI): write TRAFOOF before"),
        ("ORIVECT ORIAXES\n", "ORIVECT and ORIAXES exclude each other"),
        ("TRAORI\nG1 LEAD=5 X1 F9\n", "LEAD: angles to the path and to the normal of a surface are not planned"),
        ("TRAORI\nORICONIO\n", "ORICONIO: a tool that turns on a cone is not planned"),
        ("TOROT\n", "TOROT: this way to orient the tool or the workpiece is not planned"),
        ("TRAORI\nG1 A2=5 X1 F9\n", "A2: this way to orient the tool"),
        ("TRANSMIT\n", "lathe work"),
    ],
)
def test_what_does_not_go_with_the_tool_point_is_refused(text: str, reason: str, tmp_path: Path, table: Path) -> None:
    assert reason in refused(tmp_path, text, tools=table, kinematics=TRUNNION)


def test_no_way_to_the_midst_of_a_tool_point(tmp_path: Path) -> None:
    text = "TRAORI\nG0 X1\nTRAFOOF\nG0 X2\nM30\n"
    reason = refused(tmp_path, text, kinematics=TRUNNION, from_line=2)
    assert "the tip of the tool is moved (TRAORI): name a line before that word, or behind TRAFOOF" in reason
    assert isinstance(moves(tmp_path, text, kinematics=TRUNNION, from_line=4)[0], Begin)

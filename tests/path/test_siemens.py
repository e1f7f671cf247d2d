"""SINUMERIK programs: moves by hand, those of the same program in RS-274, and what is refused."""

from __future__ import annotations

import json
import math
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from feeddrive.language.errors import ParameterError, ProgramError
from feeddrive.path.program.moves import (
    Arc,
    Dwell,
    End,
    Feed,
    Ignored,
    Message,
    Move,
    PathMode,
    Spindle,
    Spline,
    Straight,
    ToolChange,
)
from feeddrive.path.program.reading import read_commands, read_program
from feeddrive.workflow.plan import PlanRequest, plan


@pytest.fixture
def no_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the page, whose pictures have a test of their own."""
    monkeypatch.setattr(sys.modules["feeddrive.workflow.plan"], "html", lambda _: "")


def moves(folder: Path, text: str, **options: object) -> list[Move]:
    path = folder / "part.mpf"
    path.write_text(text, encoding="utf-8")
    return list(read_program(path, dialect="siemens", **options))  # type: ignore[arg-type]


def ends(found: list[Move]) -> list[tuple[float, ...]]:
    """X Y Z of the ends of all motions, mm."""
    going = [move.end for move in found if isinstance(move, (Straight, Arc, Spline))]
    return [tuple(round(1e3 * value, 6) + 0.0 for value in end[:3]) for end in going]


def refused(folder: Path, text: str) -> ProgramError:
    with pytest.raises(ProgramError) as caught:
        moves(folder, text)
    return caught.value


PART = """%_N_PART_MPF
;$PATH=/_N_WKS_DIR/_N_PART_WPD
N10 G17 G90 G54 G94 G71 FNORM SOFT FFWON DIAMOF
N20 MSG("roughing, layer " << R1)
N30 T="MILL_10" D1 ; ten millimeters
N40 M6
N50 S5000 M3 M8
N60 CYCLE832(0.02,_ROUGH,1)
N70 R1=10 R2=R1*2+SQRT(POT(3)+POT(4))
N80 G0 X0 Y0 Z=R1
N90 G1 X10 Y=IC(5) F=R2*40
N100 G2 X20 Y5 CR=5
N110 G3 X20 Y5 I=AC(25) J0 TURN=1 Z-2
N120 CIP X30 Y5 I1=25 J1=10
N130 G1 G91 X1
N140 X=AC(3) Y=-R1/4
N150 G4 F0.5
N160 SUPA G0 G90 Z0 D0
N170 CYCLE832()
N180 M30
X999
"""


def test_a_program_of_a_mill(tmp_path: Path) -> None:
    found = moves(tmp_path, PART)
    assert ends(found) == [
        (0, 0, 10),
        (10, 5, 10),
        (20, 5, 10),
        (20, 5, -2),
        (30, 5, -2),
        (31, 5, -2),
        (3, 2.5, -2),
        (3, 2.5, 0),
    ]
    first, helix, through = (move for move in found if isinstance(move, Arc))
    assert first.center == pytest.approx((0.015, 0.005))
    assert (first.turns, helix.turns, through.turns) == (-1, 2, -1)
    assert helix.angle == pytest.approx(4.0 * math.pi)
    assert through.center == pytest.approx((0.025, 0.005))
    assert [move.linear for move in found if isinstance(move, Feed)][-1] == pytest.approx(1.0 / 60.0)
    assert [move.duration for move in found if isinstance(move, Dwell)] == [0.5]
    assert [move.number for move in found if isinstance(move, ToolChange)] == [90_001]
    assert next(move.text for move in found if isinstance(move, Message)) == "roughing, layer 0"
    assert [move.code for move in found if isinstance(move, Ignored)] == ["SOFT", "FFWON", "D1", "CYCLE832 _ROUGH"]
    assert [(move.mode, move.tolerance) for move in found if isinstance(move, PathMode)] == [
        ("continuous", 0.0),
        ("continuous", 2e-5),
        ("continuous", 0.0),
    ]
    assert [move.direction for move in found if isinstance(move, Spindle)][-2:] == [1, 0]
    assert isinstance(found[-1], End)
    assert found[-1].source.number == 20


@pytest.mark.parametrize(
    ("words", "mode", "tolerance"),
    [
        ("G60", "exact_stop", 0.0),
        ("G64", "continuous", 0.0),
        ("CTOL=0.05 G64", "continuous", 0.0),
        ("G642 CTOL=0.05", "continuous", 0.05),
        ("G645 CTOL=0.05", "continuous", 0.05),
        ("G641 ADIS=0.5", "continuous", 0.11),
        ("G642", "continuous", 0.0),
        ("CYCLE832(0.01,1,1)", "continuous", 0.01),
        ("CYCLE832(R5*2,102003)", "continuous", 0.2),
        ("CYCLE832(0.01,0,1)", "continuous", 0.0),
        ("CYCLE832()", "continuous", 0.0),
        ("CYCLE832", "continuous", 0.0),
        ("G70 CTOL=0.001 G642", "continuous", 0.0254),
    ],
)
def test_path_modes(words: str, mode: str, tolerance: float, tmp_path: Path) -> None:
    found = [move for move in moves(tmp_path, f"R5=0.1\n{words}\nM30\n") if isinstance(move, PathMode)]
    assert (found[-1].mode, found[-1].tolerance) == (mode, pytest.approx(1e-3 * tolerance))


def test_the_type_of_cycle832_is_named(tmp_path: Path) -> None:
    for words, named in [("0.01,3", "_ROUGH"), ("0.01,102001", "_FINISH"), ("0.01,_ORI_FINISH,1", "_ORI_FINISH")]:
        found = moves(tmp_path, f"CYCLE832({words})\nM30\n")
        assert [move.code for move in found if isinstance(move, Ignored)] == [f"CYCLE832 {named}"]


def test_an_exact_stop_of_one_block_stops_at_its_end(tmp_path: Path) -> None:
    path = tmp_path / "part.mpf"
    path.write_text("G642 CTOL=0.1 F3000\nG1 X20\nG9 X40 Y5\nX60\nX80 Y5.1\nSTOPRE\nX90\nM30\n")
    outcome = plan.run(PlanRequest(path, machine="xy_table", dialect="siemens"))
    assert [(stop.line, stop.reason) for stop in outcome.result.stops] == [
        (3, "exact stop (G61.1)"),
        (6, "exact stop (G61.1)"),
    ]


def test_frames_shift_and_turn(tmp_path: Path) -> None:
    """TRANS replaces the frame, ATRANS adds to it in its turned axes; G54 is of the table; SUPA leaves both out."""
    offsets = tmp_path / "linuxcnc.var"
    offsets.write_text("5221 100\n5222 0\n5241 7\n")
    text = (
        "G0 X0\nTRANS X10 Y20\nX0 Y0\nAROT RPL=90\nX5 Y0\nATRANS X1\nX0 Y0\nTRANS Y1\nX0 Y0\nROT\nX0 Y0\nG55\nX0 Y0\n"
        "G500\nX0\nG54\nSUPA X1\nX=IC(2)\nM30\n"
    )
    assert ends(moves(tmp_path, text, offsets=offsets)) == [
        (100, 0, 0),
        (110, 20, 0),
        (110, 25, 0),
        (110, 21, 0),
        (100, 1, 0),
        (100, 0, 0),
        (7, 0, 0),
        (0, 0, 0),
        (1, 0, 0),
        (3, 0, 0),
    ]


def test_an_incremental_move_makes_a_change_of_frames_too(tmp_path: Path) -> None:
    """As the control does by default (SD42440): X 1 before TRANS X100 and IC(1) behind it is X 102."""
    found = moves(tmp_path, "G0 X1 Y1\nTRANS X100\nY2\nX=IC(1)\nX=IC(1)\nM30\n")
    assert ends(found) == [(1, 1, 0), (1, 2, 0), (102, 2, 0), (103, 2, 0)]


def test_jumps_and_loops(tmp_path: Path) -> None:
    text = """
DEF REAL DEPTH=-1, STEP
DEF INT LAYER
G0 X0
FOR LAYER=1 TO 3
  IF (LAYER==2) AND NOT (DEPTH>0)
    GOTOF NEXT
  ELSE
    X=LAYER
  ENDIF
  NEXT: Y=IC(1)
ENDFOR
STEP=2
WHILE STEP>0
  Z=DEPTH*STEP STEP=STEP-1
ENDWHILE
REPEAT
  X=IC(10)
UNTIL $AA_IW[X]>=23
LOOP
  STEP=STEP+1
  IF STEP==2 GOTOF OUT
  Z=IC(1)
ENDLOOP
OUT: GOTO 900
X777
N800 X0
GOTOF ENDE
N900 X5
GOTOC NOWHERE
IF 0
  X888
ELSE
  X6
ENDIF
GOTOB 800
ENDE: M30
"""
    found = list(ends(moves(tmp_path, text)))
    assert found == [
        *((1, 0, 0), (1, 1, 0), (1, 2, 0), (3, 2, 0), (3, 3, 0)),
        *((3, 3, -2), (3, 3, -1)),
        *((13, 3, -1), (23, 3, -1)),
        (23, 3, 0),
        *((5, 3, 0), (6, 3, 0), (0, 3, 0)),
    ]


def test_a_case_jumps_by_a_whole_number(tmp_path: Path) -> None:
    """Every branch once, DEFAULT for two values; a number that no branch has goes on where no DEFAULT stands."""
    text = (
        "G1 F1000\n"
        "DEF INT K\n"
        "FOR K=-1 TO 2\n"
        "CASE K OF -1 GOTOF MINUS 2 GOTOF N20 DEFAULT GOTOF OTHER\n"
        "MINUS: X1\nGOTOF NEXT\n"
        "N20 X=IC(10)\nGOTOF NEXT\n"
        "OTHER: X=IC(100)\n"
        "NEXT: R1=R1+1\n"
        "ENDFOR\n"
        "CASE R1/3 OF 1 GOTOF BAD\n"
        "AGAIN: Y=IC(1)\n"
        "R2=R2+1\n"
        "CASE R2 OF 1 GOTOB AGAIN 2 GOTOB AGAIN\n"
        "M30\n"
        "BAD: X0\nM30\n"
    )
    found = [end[:2] for end in ends(moves(tmp_path, text))]
    assert found == [(1.0, 0.0), (101.0, 0.0), (201.0, 0.0), (211.0, 0.0), (211.0, 1.0), (211.0, 2.0), (211.0, 3.0)]


def test_polynomials_are_exact_curves(tmp_path: Path) -> None:
    """x = 20 p², y = 10 p - 3 p² + p³ over 0 .. 2, from (1, 0)."""
    found = moves(tmp_path, "F600\nG1 X1\nPOLY PO[X]=(81,20) PO[Y]=(16,-3,1) PL=2\nX90 Y20\nG1 X0\nM30\n")
    curve, straight = (move for move in found if isinstance(move, Spline))
    points = np.array([curve.start, *curve.points, curve.end])[:, :2]
    for s in np.linspace(0.0, 1.0, 5):
        p = 2.0 * s
        weights = [(1 - s) ** 3, 3 * s * (1 - s) ** 2, 3 * s * s * (1 - s), s**3]
        assert 1e3 * (weights @ points) == pytest.approx([1 + 20 * p * p, 10 * p - 3 * p * p + p**3], abs=1e-9)
    assert curve.end[:2] == pytest.approx((0.081, 0.016))
    assert (
        np.linalg.norm(
            np.cross(
                np.diff([straight.start[:3], *[q[:3] for q in straight.points]], axis=0)[0],
                np.subtract(straight.end[:3], straight.start[:3]),
            )
        )
        < 1e-12
    )


def test_arcs_by_angle_and_pole(tmp_path: Path) -> None:
    found = moves(
        tmp_path,
        "F600\nG1 X10\nG3 I-10 J0 AR=90\nG3 X-10 Y0 AR=90\nG2 I10 J0 AR=90\n"
        "G111 X5 Y5\nG1 RP=2 AP=90\nAP=IC(90)\nM30\n",
    )
    assert ends(found) == [(10, 0, 0), (0, 10, 0), (-10, 0, 0), (0, 10, 0), (5, 7, 0), (3, 5, 0)]
    for arc in (move for move in found if isinstance(move, Arc)):
        assert arc.center == pytest.approx((0.0, 0.0), abs=1e-12)


def test_inches_are_read_as_lengths_and_g700_feeds_too(tmp_path: Path) -> None:
    found = moves(tmp_path, "G70 F600\nG1 X1\nG700 F600\nX=IC(1) Y=10/2\nG71\nX0 Y0 F600\nM30\n")
    assert ends(found) == [(25.4, 0, 0), (50.8, 127, 0), (0, 0, 0)]
    assert [move.linear for move in found if isinstance(move, Feed)] == pytest.approx([0.01, 0.254, 0.01])


def test_rotary_words_turn_the_stated_way(tmp_path: Path) -> None:
    found = moves(tmp_path, "G0 C350\nC=DC(10)\nC=ACN(5)\nC=ACP(0)\nC=DC(0)\nM30\n")
    turned = [math.degrees(move.end[5]) for move in found if isinstance(move, Straight)]
    assert turned == pytest.approx([350, 370, 365, 720])


def test_tools_by_name_and_their_length(tmp_path: Path) -> None:
    table = tmp_path / "tool.tbl"
    table.write_text("T7 P7 Z50 D10 ;MILL_10\nT8 P8 Z20\n")
    text = 'T="mill_10" M6\nG0 Z0\nT8 D1\nZ1\nM6\nZ0\nD0\nZ0\nT7 D0 M6\nZ2\nD1\nZ0\nM30\n'
    found = moves(tmp_path, text, tools=table)
    assert [move.number for move in found if isinstance(move, ToolChange)] == [7, 8, 7]
    # D beside T is that of the tool that M6 changes to, and D1 if there is none
    assert ends(found) == [(0, 0, 50), (0, 0, 51), (0, 0, 20), (0, 0, 0), (0, 0, 2), (0, 0, 50)]
    with pytest.raises(ProgramError, match=r"the tool table has one cutting edge a tool, and no D2"):
        moves(tmp_path, "T7 D2\nM6\n", tools=table)
    with pytest.raises(ProgramError, match=r'the tool "BALL" is not in the tool table: add it there, with its name'):
        moves(tmp_path, 'T="BALL"\n', tools=table)


def both(draw: np.random.Generator) -> tuple[str, str]:
    """A drawn program in both languages: lines, arcs by radius and center in three planes, increments, offsets."""
    siemens, rs274 = ["G54 G90 G642 CTOL=0.01 F900"], ["G54 G90 G64 P0.01 F900"]
    here, plane = [0.0, 0.0, 0.0], 0
    shift = [round(float(v), 3) for v in draw.uniform(-50, 50, 3)]
    siemens.append(f"TRANS X{shift[0]} Y{shift[1]} Z{shift[2]}")
    rs274.append(f"G10 L2 P1 X{shift[0]} Y{shift[1]} Z{shift[2]}")
    siemens.append("G0 X0 Y0 Z0")
    rs274.append("G0 X0 Y0 Z0")
    for _ in range(25):
        kind, to = draw.integers(0, 4), [round(float(v), 4) for v in draw.uniform(-20, 20, 3)]
        if kind == 0:
            siemens.append(f"G1 X{to[0]} Y=AC({to[1]}) Z={to[2]} F{900 + 10 * plane}")
            rs274.append(f"G1 X{to[0]} Y{to[1]} Z{to[2]} F{900 + 10 * plane}")
            here = to
        elif kind == 1:
            siemens.append(f"G0 X=IC({to[0]}) G91 Z{to[2]}")
            siemens.append("G90")
            rs274.extend([f"G91 G0 X{to[0]} Z{to[2]}", "G90"])
            here = [here[0] + to[0], here[1], here[2] + to[2]]
        else:
            plane = int(draw.integers(0, 3))
            first, second = ((0, 1), (2, 0), (1, 2))[plane]
            a, b = "XYZ"[first], "XYZ"[second]
            word = "G2" if draw.random() < 0.5 else "G3"
            chord = math.hypot(to[first] - here[first], to[second] - here[second])
            radius = round(chord * float(draw.uniform(0.51, 2.0)) + 0.001, 4) * (1 if draw.random() < 0.5 else -1)
            if kind == 2:
                siemens.append(f"G{17 + plane} {word} {a}{to[first]} {b}{to[second]} CR={radius}")
                rs274.append(f"G{17 + plane} {word} {a}{to[first]} {b}{to[second]} R{radius}")
                here[first], here[second] = to[first], to[second]
            else:
                i, j = "IJK"[first], "IJK"[second]
                siemens.append(f"G{17 + plane} {word} {i}{to[0]} {j}{to[1]} TURN=2")
                rs274.append(f"G{17 + plane} {word} {i}{to[0]} {j}{to[1]} P3")
    return "\n".join([*siemens, "M30", ""]), "\n".join([*rs274, "M2", ""])


@pytest.mark.parametrize("seed", range(20))
def test_both_languages_give_the_same_moves(seed: int, tmp_path: Path) -> None:
    siemens, rs274 = both(np.random.default_rng(seed))
    (tmp_path / "part.ngc").write_text(rs274)
    kinds = (Straight, Arc)
    ours = [move for move in moves(tmp_path, siemens) if isinstance(move, kinds)]
    theirs = [move for move in read_program(tmp_path / "part.ngc", front_end="own") if isinstance(move, kinds)]
    assert len(ours) == len(theirs) > 15
    for a, b in zip(ours, theirs, strict=True):
        assert type(a) is type(b)
        assert a.end == pytest.approx(b.end, abs=1e-12)
        if isinstance(a, Arc) and isinstance(b, Arc):
            assert (a.axes, a.turns) == (b.axes, b.turns)
            assert a.center == pytest.approx(b.center, abs=1e-12)


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        ("G0 X0\nTRAORI\n", 2, "column 1: TRAORI: TRAORI moves the tip of the tool, and the machine has no kinematics"),
        ("G1 X1 A3=0 B3=0 C3=1 F9\n", 1, "A3= is a direction of the tool, whose tip is not moved: write TRAORI"),
        ("G1 X1 A2=0 F9\n", 1, "A2: this way to orient the tool"),
        ("TRAORI(2)\n", 1, "TRAORI has the number 1 or none"),
        ('CYCLE800(1,"TC1",0,57)\n', 1, "CYCLE800: this way to orient the tool or the workpiece is not planned"),
        ("ROT X45\n", 1, "tilted about X or Y need five axes"),
        ("G18\nROT RPL=30\n", 2, "tilted about X or Y need five axes"),
        ("DIAMON\n", 1, "DIAMON: lathe work"),
        ("G96 S200\n", 1, "G96: lathe work"),
        ("TRANSMIT\n", 1, "lathe work"),
        ("BSPLINE X1 Y2 PW=2\n", 1, "BSPLINE needs a feed above 0"),
        ("G41 X1\n", 1, "no tool is in the spindle, whose radius G41 needs"),
        ("KONTT G41 X1\n", 1, "KONTT: this way to the contour or along it is not planned"),
        ("G140\n", 1, "this way to the contour"),
        ("G1 X1 F9 RND=2\n", 1, "RND: a rounding or chamfer"),
        ("SCALE X2\n", 1, "frames that scale or mirror"),
        ("G33 Z1 K2\n", 1, "follows the real spindle"),
        ("G74 Z1=0\n", 1, "datum of the machine"),
        ("CYCLE81(10,0,2,-5)\n", 1, "CYCLE81: cycles of the control"),
        ("MCALL CYCLE81(10,0,2,-5)\n", 1, "CYCLE81: cycles of the control"),
        (
            "L100 P2\n",
            1,
            "L100 is not known here, and there is no subprogram L100: neither %_N_L100_SPF in this file nor",
        ),
        ("G291\n", 1, "ISO dialect is another language"),
        ("G1 X1 F9 M70\n", 1, "M70 does is decided by the maker"),
        ("H=3\n", 1, "machine's own logic"),
        ("WHEN $A_IN[1]==1 DO M8\n", 1, "machine's own logic"),
        ("X1=5\n", 1, "an axis of the machine's own"),
        ("G1 X1 F9 FOO\n", 1, "column 10: FOO: the word FOO is not known here"),
        ("G1 X WHILE\n", 1, "column 4: X: the word X has no value: write X1 or X=1"),
        ("G1 ENDFOR\n", 1, "column 4: ENDFOR: ENDFOR stands at the beginning of a line"),
        ("$AA_IW[X]\n", 1, "is a value: it stands behind ="),
        ("G777\n", 1, "G777: there is no such code"),
        ("G1 X1 X2 F9\n", 1, "the word X stands twice"),
        ("G1 G2 X1\n", 1, "G1 and G2 exclude each other"),
        ("G1 X1\n", 1, "needs a feed above 0"),
        ("G2 X1 Y1 F9\n", 1, "has no center"),
        ("CR=5\n", 1, "no code of this block uses the word CR"),
        ("G0 X=R1/0\n", 1, "division by zero"),
        ("G0 X=SQRT(-1)\n", 1, "SQRT has no value at -1"),
        ("G0 X=DEPTH\n", 1, "the variable DEPTH has no value here"),
        ("G0 X=(1+2\n", 1, "closing parenthesis"),
        ("G0 X=$A_IN[1]\n", 1, r"system variable \$A_IN is not known before"),
        ("$MC_AX=3\n", 1, "machine data cannot be written"),
        ("DEF REAL A[3]\n", 1, "arrays are not read"),
        ("DEF STRING[3] B\n", 1, "others are not read"),
        ("IF R1==1 AND R2==1 GOTOF E\n", 1, "comparisons bind weaker than AND"),
        ("IF R1==0\n", 1, "ends inside IF: write ENDIF"),
        ("IF R1\nX1\n", 1, "IF has no ELSE or ENDIF"),
        ("ENDFOR\n", 1, "ENDFOR ends FOR, and none is open"),
        ("GOTOF A\n", 1, "no label or block number A behind this line"),
        ("AA: G0\nGOTOF AA\n", 2, "behind this line"),
        ("GOTOF AA\nFOR R1=1 TO 2\nAA: X1\nENDFOR\n", 1, "lies inside a loop or condition"),
        ("CASE(R1) OF 0 GOTOF A\n", 1, "there is no label or block number A behind this line"),
        ("CASE R1 1 GOTOF A\nA: M30\n", 1, "a branch is CASE value OF 1 GOTOF FIRST"),
        ("CASE R1 OF\n", 1, "a branch is CASE value OF 1 GOTOF FIRST"),
        ("CASE R1 OF 1.5 GOTOF A\nA: M30\n", 1, "a whole number or DEFAULT, GOTOF or GOTOB"),
        ("CASE R1 OF DEFAULT GOTOF A 1 GOTOF A\nA: M30\n", 1, "DEFAULT is the last branch of CASE"),
        ("G20\n", 1, "G20: it belongs to the ISO dialect: write G700 for inches"),
        ("G21\n", 1, "G21: it belongs to the ISO dialect: write G710 for mm"),
        ("SAVE\n", 1, "SAVE stands behind the name of a subprogram: PROC NAME SAVE"),
        ("CTOL=-1\n", 1, "a tolerance is not negative"),
        ("POLY PO[X]=(1,2,3,4) F9\n", 1, "above third degree"),
        ("F9\nG1 PO[X]=(1,2)\n", 2, r"PO\[\] belongs to POLY"),
        ("F9\nCIP X2 Y2 Z2 I1=1\n", 2, "lies in none of the planes"),
        ("F9\nCIP X2 I1=1\n", 2, "lie on a line"),
        ("TRANS X1 G0\nTRANS X1 ATRANS Y1\n", 2, "a frame stands in a block of its own"),
        ("G4\n", 1, "G4 needs F and the seconds"),
        ('MSG("a\n', 1, 'a closing "'),
    ],
)
def test_what_is_not_planned_is_refused_at_its_line(text: str, line: int, reason: str, tmp_path: Path) -> None:
    fault = refused(tmp_path, text)
    assert fault.line == line
    assert re.search(reason, str(fault)), str(fault)


def test_a_jump_that_never_ends_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ProgramError, match="does a loop never end"):
        moves(tmp_path, "AGAIN: R1=R1+1\nGOTOB AGAIN\n", most_again=1000)


def test_deep_nesting_is_refused(tmp_path: Path) -> None:
    assert "deep" in str(refused(tmp_path, "X=" + "(" * 80 + "1" + ")" * 80 + "\n"))
    assert "more than 200 deep" in str(refused(tmp_path, "LOOP\n" * 201))
    assert "ends inside LOOP" in str(refused(tmp_path, "LOOP\n" * 150))


@pytest.mark.usefixtures("no_report")
def test_the_command_plans_such_a_program(tmp_path: Path) -> None:
    path = tmp_path / "part.mpf"
    path.write_text('G642 F3000 M40\nCYCLE832(0.05,_ROUGH)\nT="M" D1 M6\nG1 X20\nX40 Y5\nX0 Y0\nM30\n')
    outcome = plan.run(PlanRequest(path, machine="xy_table", dialect="siemens", out=tmp_path / "out"))
    assert outcome.result.proof.count == 0
    assert any("1 x CYCLE832 _ROUGH, 1 x D1, 1 x M40" in remark for remark in outcome.remarks)
    assert 'dialect = "siemens"' in (tmp_path / "out" / "job.toml").read_text()
    assert json.loads((tmp_path / "out" / "plan.json").read_text())["violations"] == 0
    with pytest.raises(ParameterError, match="rs274 reads no programs in the dialect siemens"):
        read_commands(path, dialect="siemens", front_end="rs274")

"""Radius compensation G41, G42: the commands of LinuxCNC's interpreter, closed forms, and what no tool reaches."""

from __future__ import annotations

import math
import random
import re
import shutil
from pathlib import Path

import pytest
from test_against_rs274 import same
from test_part_programs import GCODE, of_rs274, told

from feeddrive.language.errors import ProgramError
from feeddrive.path.program.moves import Arc, Message, Move, Straight, canonical_text
from feeddrive.path.program.reading import read_commands, read_program
from fresh_draws import Seeded

needs_rs274 = pytest.mark.skipif(not shutil.which("rs274"), reason="NOT RUN: rs274 of linuxcnc-uspace is not installed")
PACKAGE = Path("/usr/share/linuxcnc/ncfiles")


def moves(folder: Path, text: str, **options: object) -> list[Move]:
    path = folder / "program.ngc"
    path.write_text(text)
    return list(read_program(path, front_end="own", **options))  # type: ignore[arg-type]


def motions(commands: list[str]) -> list[str]:
    """Motions and feeds without the sign of a zero; LinuxCNC prints the messages between them before they wait."""
    wanted = re.compile(r"STRAIGHT|ARC|SET_FEED_RATE|DWELL|FLOOD")
    return [text.replace("-0.0000", "0.0000") for text in commands if wanted.match(text)]


def own(path: Path, table: Path) -> tuple[list[str], str]:
    found: list[str] = []
    try:
        for command in read_commands(path, tools=table, tables_inch=True, front_end="own"):
            found += [canonical_text(command)]
    except ProgramError as error:
        return found, str(error)
    return found, ""


@pytest.fixture
def table(tmp_path: Path) -> Path:
    path = tmp_path / "tools.tbl"
    path.write_text("".join(f"T{n} P{n} Z0.{n} D0.0625\n" for n in range(1, 10)))
    return path


@pytest.mark.skipif(not GCODE.exists(), reason=f"NOT RUN: the public part programs are not in {GCODE}")
@pytest.mark.parametrize("case", ["cam-nisley", "crazy-paths", "inside-corners", "inverse-time-with-comp"])
def test_golden_outputs_of_linuxcnc(case: str, tmp_path: Path):
    """All motions of LinuxCNC's own tests of compensation, to the fourth decimal. In inside-corners two of 548
    intersections of nearly tangent arcs differ by 2e-4 inch: its arcs have radii that differ by 1e-4 inch at their
    ends, and which of them counts is not determined."""
    folder = GCODE / "linuxcnc_interp" / case
    table = folder / "test.tbl"
    if not table.exists():
        table = tmp_path / "tools.tbl"
        table.write_text("")
    ours, refused = own(next(folder.glob("*.ngc")), table)
    assert refused == ""
    golden = [line.split("N..... ", 1)[1] for line in (folder / "expected").read_text().splitlines()]
    pairs = list(zip(motions(ours), motions(golden), strict=True))
    assert len(pairs) > 60
    assert sum(not same(*pair) for pair in pairs) == (2 if case == "inside-corners" else 0)


@needs_rs274
@pytest.mark.skipif(not PACKAGE.exists(), reason="NOT RUN: the examples of linuxcnc-uspace are not installed")
@pytest.mark.parametrize("name", ["comp", "comp-g1", "comp311", "comp311_2", "lathecomp", "useful-subroutines"])
def test_examples_of_linuxcnc_give_what_rs274_gives(name: str, table: Path):
    path = PACKAGE / f"{name}.ngc"
    theirs, complaint = of_rs274(path, table)
    assert complaint.replace("executing", "").strip() == ""
    ours, refused = own(path, table)
    assert refused == ""
    pairs = list(zip(motions(told(ours)), motions(told(theirs)), strict=True))
    assert all(same(*pair) for pair in pairs)


def drawn(seed: int) -> str:
    """A contour of lines and arcs in XY or ZX, with moves of A, dwells and traverses between them."""
    draw = random.Random(seed)
    plane = draw.choice(["G17", "G17", "G18"])
    x, y = ("X", "Y") if plane == "G17" else ("Z", "X")
    diameter = draw.choice([0.6, 2.0, 4.0]) * draw.choice([1, 1, -1])
    blocks = ["F100", plane, f"G0 {x}-5 {y}-5", f"{draw.choice(['G41.1', 'G42.1'])} D{diameter}", f"G1 {x}0 {y}0"]
    at = (0.0, 0.0)
    for _ in range(draw.randint(2, 8)):
        kind, angle, length = draw.random(), draw.uniform(0.0, math.tau), draw.uniform(2.0, 12.0)
        to = round(at[0] + length * math.cos(angle), 3), round(at[1] + length * math.sin(angle), 3)
        end = f"{x}{to[0]} {y}{to[1]}"
        if kind < 0.5:
            blocks.append(f"{draw.choice(['G1', 'G1', 'G1', 'G0'])} {end}{draw.choice(['', ' A2', ''])}")
        elif kind < 0.9:
            blocks.append(f"{draw.choice(['G2', 'G3'])} {end} R{length * draw.uniform(0.55, 2.0):.3f}")
        else:
            blocks += draw.choice([["A3"], ["M8"], ["G4 P1"], ["F50"], ["G91 A1", "G90"]])
            continue
        at = to
    return "\n".join([*blocks, "G40", f"G1 {x}50 {y}50", "M2", ""])


@needs_rs274
@pytest.mark.parametrize("seed", range(25))
def test_drawn_contours_are_those_of_the_interpreter(seed: int, tmp_path: Path, table: Path, seeded: Seeded):
    """The same motions, or a refusal. Near a reversal feeddrive refuses some inner corners that rs274 rounds although
    the tool then cuts into the move before."""
    path = tmp_path / "program.ngc"
    path.write_text(drawn(seeded(seed)))
    theirs, complaint = of_rs274(path, table)
    failed = complaint.replace("executing", "").strip()
    ours, refused = own(path, table)
    if refused:
        assert failed or "does not reach this inner corner" in refused, path.read_text()
        return
    assert not failed, path.read_text()
    pairs = list(zip(motions(ours), motions(theirs), strict=True))
    assert all(same(*pair) for pair in pairs), path.read_text()


@pytest.mark.parametrize(("side", "outside"), [("G41.1", False), ("G42.1", True)])
def test_a_circle_keeps_the_radius_of_the_tool(side: str, outside: bool, tmp_path: Path):
    """A counterclockwise circle of 10 mm with a tool of 4 mm: 12 mm outside, 8 mm inside, all at 2 mm from it."""
    found = moves(tmp_path, f"F100\nG0 X10 Y-20\n{side} D4\nG1 Y0\nG3 X10 Y0 I-10\nG40 G1 X30\nM2\n")
    arc = next(move for move in found if isinstance(move, Arc))
    assert arc.radius == pytest.approx(0.012 if outside else 0.008, abs=1e-15)
    assert abs(arc.angle) == pytest.approx(math.tau, abs=1e-12)


def test_a_square_outside_is_longer_by_the_rounded_corners(tmp_path: Path):
    """Length of the center's path around a square: that of the square, and 2 pi r for the corners, on each turn."""
    lines = ["F100", "G0 X-20 Y0", "G41.1 D6", "G1 X0", *(["X0 Y10", "X10 Y10", "X10 Y0", "X0 Y0"] * 3), "G40", "M2"]
    found = moves(tmp_path, "\n".join(lines))
    arcs = [move for move in found if isinstance(move, Arc)]
    assert len(arcs) == 11, "the lead-in meets the first side at an inner corner"
    assert all(abs(arc.angle) == pytest.approx(math.pi / 2, abs=1e-12) for arc in arcs)
    assert all(arc.radius == pytest.approx(0.003, abs=1e-15) for arc in arcs)
    sides = [move for move in found if isinstance(move, Straight)][2:]
    assert [math.dist(side.start, side.end) for side in sides] == pytest.approx([0.007, *[0.01] * 11], abs=1e-15)


def test_commands_wait_at_their_place_and_G40_leads_back(tmp_path: Path):
    text = "F100\nG0 X0 Y-9\nG41.1 D2\nG1 Y0\nM8\nX10\nM9\nZ-1\nY10\n(debug,#5420 #5421)\nG40\nG0 Z5\nM2\n"
    found = moves(tmp_path, text)
    kinds = [type(move).__name__ for move in found]
    # the dwell before Z-1 belongs to the inner corner at X9, and the message to the center at X9 Y10
    ends = [
        tuple(round(1000 * x, 9) + 0.0 for x in move.end[:3]) for move in found if isinstance(move, (Straight, Arc))
    ]
    assert ends == [(0, -9, 0), (-1, 0, 0), (0, 1, 0), (9, 1, 0), (9, 1, -1), (9, 10, -1), (10, 10, 5)]
    assert kinds.index("Switch") < kinds.index("Arc")
    assert [move.text for move in found if isinstance(move, Message)] == ["9.000000 10.000000"]


ON = "F100 S9 M3\nG0 X0 Y-9\nG41.1 D2\nG1 Y0\nG1 X10\n"


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        (ON + "Y1.5\nX0\n", 7, "does not reach this inner corner"),
        (ON + "G3 X10 Y1 J0.5\n", 6, r"radius 1 does not fit into this arc of radius 0\.5"),
        ("F100\nG41.1 D2\nG1 X0.5\n", 3, "lead-in.*longer than the tool's radius, 1"),
        ("F100\nG41.1 D2\nG1 Z5\n", 3, "lead-in"),
        ("F100\nG41.1 D2\nG3 X0 Y0 I5\n", 3, "touch the contour"),
        ("F100\nG41 D3\n", 2, "tool 3 is not in the tool table.*give the table"),
        ("F100\nG41\n", 2, "no tool is in the spindle: load one"),
        ("F100\nG41.1\n", 2, "needs the word D"),
        ("F100\nG41.1 D2 L3\n", 2, "orientation 3 of a lathe"),
        ("F100\nG19 G41.1 D2\n", 2, "planes XY and ZX"),
        (ON + "G40\nG2 X0 Y0 R20\n", 7, "the move behind G40 is straight"),
        *(
            (ON + code + "\n", 6, f"{code.split()[0]} does not go with radius compensation: write G40")
            for code in ["G18", "G20", "G54", "G92 X1", "G43.1 Z1", "G10 L2 P1 X0", "G28", "G53 G0 Z0"]
        ),
        *(
            (ON + code + "\n", 6, f"{code.split()[0]} does not go with radius compensation: write G40")
            for code in [
                "G81 Z-1 R1",
                "G5 X20 I1 J1 P1 Q1",
                "G41.1 D1",
                "M6",
                "G61",
                "G33 Z2 K1",
                "M62 P1",
                "M67 E0 Q1",
            ]
        ),
    ],
)
def test_what_a_tool_cannot_follow_is_refused_at_its_line(text: str, line: int, reason: str, tmp_path: Path):
    with pytest.raises(ProgramError, match=reason) as caught:
        moves(tmp_path, text + "M2\n")
    assert caught.value.line == line


@pytest.mark.parametrize("code", ["G17", "G21", "G10 L1 P1 R3", "M61 Q1", "T1", "M0", "G91.1", "M64 P1", "G40 G61"])
def test_codes_that_go_with_compensation(code: str, tmp_path: Path):
    (tmp_path / "tools.tbl").write_text("T1 P1 D2\n")
    assert moves(tmp_path, ON + code + "\nX20\nG40\nM2\n", tools=tmp_path / "tools.tbl")


@pytest.mark.parametrize(("angle", "corners"), [(0.03, 0), (0.08, 1)])
def test_a_corner_below_a_twentieth_of_a_radian_has_no_arc(angle: float, corners: int, tmp_path: Path):
    x, y = 10 + 10 * math.cos(angle), -10 * math.sin(angle)
    found = moves(tmp_path, f"F100\nG0 X-5\nG41.1 D2\nG1 X0\nX10\nX{x:.6f} Y{y:.6f}\nG40\nM2\n")
    assert sum(isinstance(move, Arc) for move in found) == corners

"""Part programs: commands equal to those of LinuxCNC's interpreter, moves in machine coordinates, what is refused."""

from __future__ import annotations

import math
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from test_against_rs274 import same

from feeddrive.language.errors import FileError, ParameterError, ProgramError
from feeddrive.path.program.blocks import G_CODES, M_CODES, REFUSED, name_of
from feeddrive.path.program.moves import (
    Arc,
    Command,
    Feed,
    Message,
    Move,
    PathMode,
    Spline,
    Straight,
    Switch,
    Synchronized,
    canonical_text,
    read_command,
)
from feeddrive.path.program.reading import read_commands, read_program

GCODE = Path(__file__).parents[3] / "shared" / "data" / "gcode"
LOGS = GCODE.parent / "linuxcnc_logs"
needs_gcode = pytest.mark.skipif(not GCODE.exists(), reason=f"NOT RUN: the public part programs are not in {GCODE}")
needs_rs274 = pytest.mark.skipif(not shutil.which("rs274"), reason="NOT RUN: rs274 of linuxcnc-uspace is not installed")
NATIVE = ["unit-conversion", "g84_g17_g98", "flowsnake"]
# Of 3D_Chips to tort: written with a tool table, which their readers had in inches.
TABLE = "T1 P1 Z0.511 D0.125\nT2 P2 Z0.1 D0.0625\nT3 P3 Z1.273 D0.201\nT4 P4 D1\nT8 P8 D0.01\n"


@pytest.fixture
def table(tmp_path: Path) -> Path:
    path = tmp_path / "tools.tbl"
    path.write_text(TABLE)
    return path


def texts(commands: Iterator[Command]) -> list[str]:
    return [text for command in commands if (text := canonical_text(command))]


def program(folder: Path, text: str) -> Path:
    path = folder / "program.ngc"
    path.write_text(text)
    return path


def moves(folder: Path, text: str, **options: object) -> list[Move]:
    return list(read_program(program(folder, text), **options))  # type: ignore[arg-type]


def printed(lines: Iterator[str] | list[str]) -> list[str]:
    """Commands of the interpreter's output, without the numbers of lines; a zero has no sign."""
    found = (re.match(r"\s*(?:\d+ )?N\S+\s+(.*)", line) for line in lines)
    return [each[1].replace("-0.0000", "0.0000") for each in found if each]


def told(commands: list[str]) -> list[str]:
    """Without resets, which say nothing, and the row of the tool table, which is another order of the same tools."""
    return [re.sub(r"CHANGE_TOOL\(\d+\)", "CHANGE_TOOL", each) for each in commands if each != "ON_RESET()"]


def of_rs274(path: Path, table: Path) -> tuple[list[str], str]:
    """What the interpreter prints, and what it complains about."""
    command = ["rs274", "-g", "-t", str(table), str(path)]
    done = subprocess.run(command, capture_output=True, stdin=subprocess.DEVNULL, timeout=60, check=False)
    return printed(done.stdout.decode("utf-8", "replace").splitlines()), done.stderr.decode("utf-8", "replace")


@needs_gcode
@pytest.mark.parametrize("case", NATIVE)
def test_the_own_reader_gives_the_golden_commands(case: str):
    folder = GCODE / "linuxcnc_interp" / case
    source = next(folder.glob("*.ngc"))
    expected = [line.split("N..... ", 1)[1] for line in (folder / "expected").read_text().splitlines()]
    assert texts(read_commands(source, front_end="own", tables_inch=True)) == expected


@needs_gcode
@needs_rs274
@pytest.mark.parametrize(
    "path",
    [
        *(path for path in sorted(GCODE.glob("linuxcnc/*.ngc")) if path.name != "flowsnake.ngc"),
        pytest.param(GCODE / "linuxcnc/flowsnake.ngc", marks=pytest.mark.slow(reason="98 000 lines in recursion: 4 s")),
        *sorted(GCODE.glob("cncjs/*.gcode")),
        *sorted(LOGS.glob("*.ngc")),
    ],
    ids=lambda path: path.name,
)
def test_public_programs_give_what_rs274_gives(path: Path, table: Path):
    """Command by command to its fourth decimal, up to the line that both refuse, or to the end."""
    theirs, complaint = of_rs274(path, table)
    ours: list[str] = []
    refused = ""
    try:
        for command in read_commands(path, tools=table, tables_inch=True):
            ours += [canonical_text(command).replace("-0.0000", "0.0000")]
    except ProgramError as error:
        refused = str(error)
    if path.name == "skeleton.ngc":  # after M6 the stand-alone interpreter forgets what G43 in the same block changed
        assert len(ours) == len(theirs) == 76
        return
    assert bool(refused) == ("File ended" not in complaint and complaint.replace("executing", "").strip() != "")
    ended = ["FINISH()"] if "File ended" in complaint else []
    if path.name == "helical-thread-milling.gcode":  # rs274 drops the last move, which waits for a corner behind it
        assert ours.pop(-4).startswith("ARC_FEED")
    pairs = list(zip(told(ours), told(theirs) + ended, strict=True))
    assert [pair for pair in pairs if not same(*pair)] == []


@needs_rs274
def test_both_front_ends_read_the_same_tables(tmp_path: Path):
    """Tools and offsets in mm and in inches, a block-deleted line: the same moves within the four decimals."""
    (tmp_path / "tool.tbl").write_text("T7 P1 Z12.5 X-1 D6\nT8 P2 Z1\n")
    (tmp_path / "machine.var").write_text("5181 5\n5220 2\n5241 100\n5244 30\n5250 15\n100 3.5\n")
    path = program(tmp_path, "T7 M6\nG43\n/G0 X9\nG0 X1 Y#100 Z0\nF100 G1 A20\nG2 X3 Y3.5 I1\nG30\nM2\n")
    for inch in (False, True):
        ends: list[list[float]] = []
        for front_end in ("own", "rs274"):
            options = {"tools": tmp_path / "tool.tbl", "offsets": tmp_path / "machine.var", "skip_deleted": True}
            found = list(read_program(path, front_end=front_end, tables_inch=inch, **options))  # type: ignore[arg-type]
            ends.append(
                [x for each in found if isinstance(each, (Straight, Arc)) for x in (*each.end, each.source.number)]
            )
        assert len(ends[0]) == 40
        assert ends[1] == pytest.approx(ends[0], abs=2e-7), "m: two offsets and a coordinate, 0.05 um each"


@needs_rs274
@pytest.mark.parametrize("block", ["T1 M6", "G41 D1 G1 X10 F100", "G43 H1"])
def test_no_tool_that_rs274_has_of_its_own_is_taken(block: str, tmp_path: Path):
    """Its tool 1 has a diameter of 3.175 mm: the path was off by 1.5875 mm, and nobody was told."""
    with pytest.raises(ProgramError, match=r"line 2, .*Requested tool 1 not found in .*; give the tool table"):
        moves(tmp_path, f"G21\n{block}\nM2\n", front_end="rs274")
    assert moves(tmp_path, "G21\nG41.1 D2 G1 X10 F100\nX20\nG40 X30\nM2\n", front_end="rs274")


@needs_rs274
def test_an_error_of_rs274_has_the_line_of_the_program(tmp_path: Path):
    source = "G21 (mm)\n\no1 repeat [2]\n  g1 x1 F100\no1 endrepeat\n  N7 G41 D77\nM2\n"
    with pytest.raises(ProgramError, match=r"rs274 refuses it: .*tool table") as caught:
        moves(tmp_path, source, front_end="rs274")
    assert (caught.value.line, caught.value.column, caught.value.word) == (6, 3, "N7 G41 D77")
    with pytest.raises(ProgramError, match="prints no U, V and W") as caught:
        moves(tmp_path, "G0 X1\nG0 U2\n", front_end="rs274")
    assert caught.value.line == 2


CUT = "G21 G90\nG41.1 D2\nG1 X20 F100\nG1 X30\nG40\n{}\nG1 X40\nM2\n"


@needs_rs274
@pytest.mark.parametrize(
    "line",
    [
        ";py,open('{}', 'w')",
        "(py,import os)",
        "G1 X35 ( PY,import os)",
        "G1 X35 ; PyRun,module",
        "(pyreload)",
        "(a) (b);\tpy,import os",
    ],
)
def test_python_in_a_comment_is_refused_and_not_run(line: str, tmp_path: Path):
    """LinuxCNC's interpreter runs such a comment: a program that somebody sends would be a program."""
    written = tmp_path / "written"
    with pytest.raises(ProgramError, match="would run this comment as Python") as caught:
        moves(tmp_path, CUT.format(line.format(written)), front_end="rs274")
    assert caught.value.line == 6
    assert not written.exists()
    assert moves(tmp_path, CUT.format("(copy of part 7) (pyramid) ; happy, py"), front_end="rs274")


@needs_rs274
def test_subroutines_beside_a_program_are_called_and_checked_too(tmp_path: Path):
    """A file that a called file calls counts as well; other folders are closed, and so is Python in any of them."""
    (tmp_path / "deep.ngc").write_text("o<deep> sub\nG1 X55\no<deep> endsub\nM2\n", encoding="utf-8")
    (tmp_path / "near.ngc").write_text("o<near> sub\nO<De ep> call\no<near> endsub\nM2\n", encoding="utf-8")
    path = program(tmp_path, CUT.format("o<near> call"))
    assert any("STRAIGHT_FEED(55.0000" in each for each in texts(read_commands(path, front_end="rs274")))
    written = tmp_path / "written"
    (tmp_path / "deep.ngc").write_text(
        f"o<deep> sub\n;py,open('{written}', 'w')\no<deep> endsub\nM2\n", encoding="utf-8"
    )
    with pytest.raises(ProgramError, match=r"deep\.ngc.*would run this comment as Python"):
        moves(tmp_path, CUT.format("o<near> call"), front_end="rs274")
    for name in (str(tmp_path / "deep"), "./deep", "../deep"):
        with pytest.raises(ProgramError, match="beside the program only"):
            moves(tmp_path, CUT.format(f"o<{name}> call"), front_end="rs274")
    assert not written.exists()


def test_rs274_leaves_the_tool_table_of_a_running_linuxcnc_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """It keeps its table in $HOME/.tool.mmap, and empties what it finds there."""
    script, told = tmp_path / "rs274", tmp_path / "told"
    script.write_text(
        f'#!/bin/sh\nfor last; do :; done\necho "  1 N1     PROGRAM_END()" > "$last"\necho "$HOME" > {told}\n'
    )
    script.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    monkeypatch.setenv("HOME", str(tmp_path))
    moves(tmp_path, "G0 X1\nM2\n", front_end="rs274")
    home = Path(told.read_text().strip())
    assert home != tmp_path
    assert not home.exists()  # a folder of the run


def test_an_rs274_that_dies_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    script = tmp_path / "rs274"
    printed = "  1 N1     STRAIGHT_TRAVERSE(1.0, 0.0, 0.0, 0.0, 0.0, 0.0)"
    script.write_text(f'#!/bin/sh\nfor last; do :; done\necho "{printed}" > "$last"\nkill -9 $$\n')
    script.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    with pytest.raises(ProgramError, match="line 1, column 1: G0 X1: rs274 refuses it: it ended with status -9"):
        moves(tmp_path, "G0 X1\nM2\n", front_end="rs274")


@needs_gcode
def test_the_canonical_texts_of_the_recorded_runs():
    for name in ("circle", "square_r5"):
        expected = printed((LOGS / f"{name}.canon.txt").read_text().splitlines())
        assert texts(read_commands(LOGS / f"{name}.ngc", front_end="own")) == expected


@needs_gcode
def test_public_programs_have_the_blocks_that_were_counted():
    """Motions of a planner's study of the same programs, counted by another reader."""
    counts = {
        "linuxcnc/3D_Chips.ngc": 4684,
        "cncjs/tball.gcode": 2679,
        "cncjs/jsdc.gcode": 2377,
        "cncjs/g2-arc.gcode": 9,
    }
    for name, count in counts.items():
        found = read_program(GCODE / name)
        assert sum(isinstance(move, (Straight, Arc)) for move in found) == count, name


def test_text_of_a_command_is_read_back(tmp_path: Path):
    source = program(tmp_path, "G20 F5\nG2 X1 Y1 I1 A3 P2\nG64 P.1\n(msg,hello)\nG43.1 Z2\nM68 E1 Q2\nM2\n")
    for command in read_commands(source):
        back = read_command(canonical_text(command), command.line)
        assert back is not None
        assert canonical_text(back) == canonical_text(command)


def test_inches_rotation_and_offsets_lead_to_machine_coordinates(tmp_path: Path):
    """machine = R(30 degrees) (program + G92) + origin + tool: by hand, to 1e-15 m."""
    found = moves(tmp_path, "G20\nG10 L2 P1 X1 Y2 R30\nG92 X3\nG43.1 Z0.5\nF60 G1 X5 Y0 Z1 A90\nM2\n")
    move = next(each for each in found if isinstance(each, Straight))
    # G92: the machine stands at zero, so in the program at R(-30) (-1, -2); this X is called 3
    there = math.cos(math.pi / 6) * -1 + math.sin(math.pi / 6) * -2
    x, y = 5 + there - 3, 0.0
    c, s = math.cos(math.pi / 6), math.sin(math.pi / 6)
    inch = 0.0254
    assert move.end[0] == pytest.approx(inch * (c * x - s * y + 1), abs=1e-15)
    assert move.end[1] == pytest.approx(inch * (s * x + c * y + 2), abs=1e-15)
    assert move.end[2] == pytest.approx(inch * 1.5, abs=1e-15)
    assert move.end[3] == pytest.approx(math.pi / 2, abs=1e-15)
    feed = next(each for each in found if isinstance(each, Feed))
    assert feed.linear == pytest.approx(0.0254)
    assert feed.angular == pytest.approx(math.radians(1.0))


def test_changed_offsets_do_not_move_the_machine(tmp_path: Path):
    """After each change of offsets a move to where the program now says it stands is no move."""
    codes = [
        "G92 X5 Y1",
        "G10 L2 P1 X3 Y4 R40",
        "G43.1 Z7",
        "G20",
        "G52 X1",
        "G55",
        "G92.1",
        "G10 L20 P2 X8",
        "G49",
        "G21",
    ]
    lines = ["G0 X1 Y2 Z3 F100"]
    for code in codes:
        lines += [code, "G91 G0 X0 Y0 Z0 A0", "G90 G0 X#5420 Y#5421 Z#5422"]
    straight = [each for each in moves(tmp_path, "\n".join([*lines, "M2"])) if isinstance(each, Straight)]
    travel = max(math.dist(each.start, each.end) for each in straight[1:]) if len(straight) > 1 else 0.0
    assert travel < 1e-15, "m: rounding of coordinates of 10 mm"


@pytest.mark.parametrize(
    ("text", "angle", "radius"),
    [
        ("G3 X0 Y2 I0 J1", math.pi, 1e-3),
        ("G2 X0 Y2 I0 J1 P2", -3 * math.pi, 1e-3),
        ("G3 X1 Y1 R1", math.pi / 2, 1e-3),
        ("G3 X1 Y1 R-1", 3 * math.pi / 2, 1e-3),
        ("G2 I2", -2 * math.pi, 2e-3),
        ("G18 G3 Z1 X1 R1", math.pi / 2, 1e-3),
        ("G19 G2 Y1 Z1 R1 X5", -math.pi / 2, 1e-3),
        ("G90.1 G3 X2 Y0 I1 J0 Z3", math.pi, 1e-3),
    ],
)
def test_arcs_turn_as_far_as_they_say(text: str, angle: float, radius: float, tmp_path: Path):
    arc = next(each for each in moves(tmp_path, f"F100\n{text}\nM2\n") if isinstance(each, Arc))
    assert arc.angle == pytest.approx(angle, abs=1e-12)
    assert arc.radius == pytest.approx(radius, abs=1e-15)


def test_modes_are_said_in_meters(tmp_path: Path):
    found = moves(tmp_path, "G20 G64 P.1 Q.2\nM3 S60\nG33 Z1 K.5\nG95 F.1\nG61\nM2\n")
    modes = [each for each in found if isinstance(each, PathMode)]
    assert (modes[-2].tolerance, modes[-2].naive_tolerance) == pytest.approx((0.00254, 0.00508))
    assert modes[-1].mode == "exact_path"
    assert [each.pitch for each in found if isinstance(each, Synchronized)] == pytest.approx([0.0127, 0.0])
    feed = [each for each in found if isinstance(each, Feed) and each.per_turn]
    assert feed[-1].linear == pytest.approx(0.00254)


def test_codes_of_g_and_m_with_one_number_are_kept_apart(tmp_path: Path):
    found = moves(tmp_path, "M53 P1\nM64 P3\nM68 E2 Q0.5\nM52 P0 G0 X1\nM2\n")
    switched = [(each.what, each.value) for each in found if isinstance(each, Switch)]
    assert switched == [("feed_hold", 1.0), ("output 3", 1.0), ("output 2", 0.5), ("adaptive_feed", 0.0)]
    assert sum(isinstance(each, Straight) for each in found) == 1


def test_splines_have_their_control_points(tmp_path: Path):
    found = moves(tmp_path, "F100 G0 X1 Y1 Z2\nG5 I0 J3 P0 Q-3 X2 Y1\nG5 P1 Q0 X4 Y4\nG5.1 X6 I1 J1\nM2\n")
    first, second, third = (each for each in found if isinstance(each, Spline))
    assert [point[:3] for point in first.points] == [(0.001, 0.004, 0.002), (0.002, -0.002, 0.002)]
    assert second.points[0][:2] == pytest.approx((0.002, 0.004)), "as long as the last one, straight on"
    assert len(third.points) == 1


@pytest.mark.parametrize(
    ("text", "least", "most"),
    [
        ("G5 X10 Y0 I0 J20 P0 Q20", 0.0, 0.015),  # 3 s (1-s) 20: 15 at its middle, its control points at 20
        ("G5.1 X10 Y0 I5 J-20", -0.010, 0.0),
        ("G5 X10 Y0 I0 J20 P0 Q-20", -20e-3 / 12.0**0.5, 20e-3 / 12.0**0.5),
        ("G5 X10 Y0 I3 J10 P-3 Q10", 0.0, 0.0075),
    ],
)
def test_a_spline_may_come_to_the_end_of_the_travel_and_no_farther(
    text: str, least: float, most: float, tmp_path: Path
):
    """Its own farthest points count, not its control points; 3 s (1-s) (1-2s) 20 is 20/sqrt(12) at most."""
    for beyond in (0.0, 1e-6):
        axes = {"X": None, "Y": (least - 1e-9 + (beyond if least else 0.0), most + 1e-9 - (beyond if most else 0.0))}
        source = f"F100 {text}\nM2\n"
        if beyond:
            with pytest.raises(ProgramError, match=r"axis Y would go to .* its travel is"):
                moves(tmp_path, source, axes=axes)
        else:
            assert any(isinstance(each, Spline) for each in moves(tmp_path, source, axes=axes))


def test_order_of_values_parameters_and_messages(tmp_path: Path):
    """Parameters of a block change after its values were read; a debug comment sees them changed."""
    found = moves(tmp_path, "#1=3\n#1=5 #<depth>=[#1*2] G0 X#1 (debug,#1 #<depth>)\n#2=1\n#3=##2\n(debug,%d#3)\nM2\n")
    assert next(each for each in found if isinstance(each, Straight)).end[0] == 0.003
    assert [each.text for each in found if isinstance(each, Message)] == ["5.000000 6.000000", "5"]


@pytest.mark.parametrize(
    ("expression", "value"),
    [
        ("2 ** 3 ** 2", 64),
        ("2 + 3 * 4 - 6 / 3", 12),
        ("-2 ** 2", 4),
        ("1 + 2 eq 3 and 4", 1),
        ("[-7 mod 3] + [7 mod -3]", 3),
        ("round[-2.5] + fix[-2.5] + fup[-2.5]", -8),
        ("atan[1]/[-1]", 135),
        ("sin[30] + cos[60] + tan[45]", 2),
        ("sqrt[abs[-16]] + exp[ln[2]]", 6),
        ("acos[0.5] + asin[1]", 150),
        ("exists[#<a>] * 4 + exists[#<b>]", 4),
        ("1 xor 1 or 0 gt -1", 1),
        ("#5420 + #<_metric>", 1),
    ],
)
def test_expressions_are_those_of_the_language(expression: str, value: float, tmp_path: Path):
    found = moves(tmp_path, f"#<a>=1\nG0 X[{expression}]\nM2\n")
    assert next(each for each in found if isinstance(each, Straight)).end[0] == pytest.approx(value / 1000, rel=1e-12)


def test_subroutines_loops_and_conditions(tmp_path: Path):
    """By hand: arguments are the subroutine's own, return gives a value, each kind of loop, each branch once."""
    (tmp_path / "twice.ngc").write_text("%\no<twice> sub\no<twice> endsub [#1 * 2]\n%\n")
    text = """
        o1 sub
        o2 if [#1 gt 2]
          o1 return [#1 * 10]
        o2 elseif [#1 eq 2]
          (debug,two)
        o2 else
          (debug,one #1 #30)
        o2 endif
        o1 endsub
        #1 = 7
        o1 call [1]
        o1 call [2]
        o1 call [3]
        (debug,%d#<_value> #1)
        #2 = 0
        o3 while [#2 lt 5]
          #2 = [#2 + 1]
          o4 if [#2 eq 2]
            o3 continue
          o4 endif
          o5 if [#2 eq 4]
            o3 break
          o5 endif
          (debug,while %d#2)
        o3 endwhile
        o6 do
          #2 = [#2 - 1]
          (debug,do %d#2)
        o6 while [#2 gt 2]
        o7 repeat [2]
          (debug,repeat)
        o7 endrepeat
        o<twice> call [21]
        (debug,%d#<_value>)
        M2
    """
    said = [each.text for each in moves(tmp_path, text) if isinstance(each, Message)]
    assert said == [
        "one 1.000000 0.000000",
        "two",
        "30 7",
        "while 1",
        "while 3",
        "do 3",
        "do 2",
        "repeat",
        "repeat",
        "42",
    ]


def test_the_page_names_each_code():
    """Each code of the tables stands in the right row of the page: read here, through rs274, or by nobody."""
    page = (Path(__file__).parents[2] / "docs" / "reference" / "part_programs.md").read_text(encoding="utf-8")
    rows = re.findall(r"(?m)^\| ([a-z, `0-9]+) \| (.*[GM]\d.*) \|$", page)
    found = {name: row for row, codes in rows for name in re.findall(r"[GM]\d+(?:\.\d)?", codes)}
    for letter, table in (("g", G_CODES), ("m", M_CODES)):
        for number, code in table.items():
            row = found.get(name_of(letter, number), "")
            expected = "refused" if name_of(letter, number) in REFUSED else "through `rs274` only"
            assert row, name_of(letter, number)
            assert (row in ("refused", "through `rs274` only")) != code.native, name_of(letter, number)
            assert code.native or row == expected, name_of(letter, number)


def test_moves_that_nobody_asks_for_leave_no_file_open(tmp_path: Path):
    """An open file would end this test with a ResourceWarning, which the suite takes for an error."""
    read_program(program(tmp_path, "G0 X1\n"))
    found = read_program(tmp_path / "program.ngc")
    next(found)
    del found


def test_a_program_streams(tmp_path: Path):
    """The first moves are there before the rest of the program is read, here one that is wrong."""
    found = read_program(program(tmp_path, "G0 X1\nG0 X2\nG0 Y1.2.3\n"))
    straight = (move for move in found if isinstance(move, Straight))
    assert [next(straight).end[0], next(straight).end[0]] == [0.001, 0.002]
    with pytest.raises(ProgramError):
        next(straight)


@pytest.mark.parametrize(
    ("text", "place", "words"),
    [
        ("G0 X1.2.3", (1, 4), "one decimal point"),
        ("G0  X", (1, 5), "is expected here"),
        ("F100\nG2 X5 Y0 I9", (2, 10), "no point of the circle"),
        ("F100\nG2 X5 Y0 I2.5\nX10", (3, 1), "no center"),
        ("F100 G2 X5 R1", (1, 12), "does not reach"),
        ("G1 X1", (1, 1), "needs a feed above 0"),
        ("F0 G1 X1", (1, 4), "needs a feed above 0"),
        ("G93 G1 X1", (1, 1), "needs F above 0"),
        ("X1", (1, 1), "without a motion"),
        ("G0 G1 X1", (1, 1), "exclude each other"),
        ("G0 X1 X2", (1, 7), "stands twice"),
        ("G0 X1 P3", (1, 7), "no code of this block uses"),
        ("G0 X[1/0]", (1, 4), "division by zero"),
        ("G0 X[1e", (1, 7), "operator or a closing bracket"),
        ("#1=[sqrt[-1]]", (1, 5), "argument lies in"),
        ("G0 X#<free>", (1, 4), "has no value"),
        ("G0 X#0", (1, 4), "whole number from 1"),
        ("G123", (1, 1), "no such code"),
        ("G33.1 Z-1 K1", (1, 1), "rigid tapping"),
        ("G1 X1 F1\n M98 P100", (2, 2), "o100 call"),
        ("\N{ZERO WIDTH NO-BREAK SPACE}G0 X1.2.3", (1, 4), "one decimal point"),
        ("G0 X1 (never closed", (1, 7), "no closing parenthesis"),
        ("o1 call", (1, 1), "no subroutine o1"),
        ("o1 sub\no1 call\no1 endsub\no1 call", (2, 1), "50 deep"),
        ("o1 while [1]\no1 endwhile", (1, 1), "does a loop never end"),
        ("o1 if [1]\nG0 X1", (2, 1), "inside o1 if"),
        ("o1 break", (1, 1), "stands in no loop"),
        ("G0 X[10**400]", (1, 4), "too large"),
        ("G0 X99999999999", (1, 4), "at most"),
        ("G83 X1 Z-9999 R1 Q.00001 F1", (1, 18), "more than 10000 pecks"),
        ("G43 H7", (1, 1), "tool 7 is not in the tool table"),
        ("G0 \N{LATIN SMALL LETTER E WITH ACUTE}1", (1, 4), "no meaning"),
    ],
)
def test_wrong_programs_are_refused_at_their_place(text: str, place: tuple[int, int], words: str, tmp_path: Path):
    path = tmp_path / "program.ngc"
    path.write_text(text + "\n", encoding="utf-8")
    with pytest.raises(ProgramError, match=re.escape(words)) as caught:
        list(read_program(path, most_again=2000))
    assert (caught.value.line, caught.value.column) == place
    assert str(path) in str(caught.value)


def test_a_device_is_no_program():
    """One that never ends had been counted line by line."""
    with pytest.raises(FileError, match=r"/dev/zero: is a device or pipe"):
        read_program("/dev/zero")


def test_text_of_two_bytes_a_character_is_named(tmp_path: Path):
    for code in ("utf-16", "utf-8-sig"):
        program(tmp_path, "").write_text("F100 G1 X1\no1 repeat [2]\nX2\nX1\no1 endrepeat\n", encoding=code)
        found = read_program(tmp_path / "program.ngc")
        if code == "utf-16":
            with pytest.raises(ProgramError, match=r"line 1, column 1: .* \(UTF-16\): save it as plain text"):
                list(found)
        else:
            assert sum(isinstance(each, Straight) for each in found) == 5


def test_axes_and_travel_of_the_machine(tmp_path: Path):
    axes = {"X": (-0.1, 0.1), "Y": (0.0, 0.05), "Z": None}
    with pytest.raises(ProgramError, match=r"no axis A; it has X Y Z"):
        moves(tmp_path, "G0 A1", axes=axes)
    with pytest.raises(ProgramError, match=r"line 2, column 7.*axis X would go to 101 mm .* travel is -100\.\.100 mm"):
        moves(tmp_path, "G0 X1 Y2\nG0 Y1 X101", axes=axes)
    with pytest.raises(ProgramError, match=r"axis Y would go to -5 mm"):
        moves(tmp_path, "F100\nG3 X10 Y0 I5 J0", axes=axes)
    with pytest.raises(ParameterError, match="axes: 'E' is no axis"):
        moves(tmp_path, "G0 X1", axes={"E": None})
    with pytest.raises(ParameterError, match=r"axes: the travel of x is \(1.0, 0.0\)"):
        moves(tmp_path, "G0 X1", axes={"x": (1.0, 0.0)})
    assert moves(tmp_path, "G0 X1", axes={"x": None, "Z": (-0.2, -0.1)}), "Z stands outside and does not move"
    assert moves(tmp_path, "F100\nG2 X10 Y0 I5 J0\nG0 Z500 Y0\nG10 L2 P1 X-200\nG0 X300 Y50", axes=axes)


def test_a_line_without_end_is_refused_before_it_is_read(tmp_path: Path):
    path = tmp_path / "program.ngc"
    with path.open("wb") as file:
        file.write(b"G0 X1\n")
        file.truncate(2**30)
    with pytest.raises(ProgramError, match=r"line 2.*longer than 65536 bytes"):
        list(read_program(path))


def test_without_rs274_lathe_codes_are_refused_with_its_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ProgramError, match=r"line 2, column 4: G7: .*rs274 .*linuxcnc-uspace"):
        moves(tmp_path, "F100 G1 X1\nG1 G7 X2\n")

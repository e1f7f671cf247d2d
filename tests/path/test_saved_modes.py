"""M70 to M73 save and restore modes as LinuxCNC's interpreter does; M19 is a stop; what only lathes do is refused."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from feeddrive.language.errors import ProgramError
from feeddrive.path.program.moves import Command, Spindle, canonical_text
from feeddrive.path.program.reading import needs_rs274, read_commands, read_program

needs = pytest.mark.skipif(not shutil.which("rs274"), reason="NOT RUN: rs274 of linuxcnc-uspace is not installed")


def program(folder: Path, text: str) -> Path:
    path = folder / "part.ngc"
    path.write_text(text, encoding="utf-8")
    return path


def own(folder: Path, text: str) -> list[str]:
    return [canonical_text(command) for command in read_commands(program(folder, text), front_end="own")]


MODES = "G20 G18 G91 G61 F10 S200 M4 M9\nM7 G99 G90.1 M48 G55\nG0 X1\nG93\nM5 M51 P0\nM50 P0\n"
PROGRAMS = {
    "restored": f"G21 G17 G90 G94 G64 P0.05 Q0.02 F600 S1000 M3 M7\nG0 X1\nM70\n{MODES}M72\nG1 X2\nM72\nM2\n",
    "twice": "F60\nM70\nG91 G95 F2 S3\nM72\nG1 X1\nG19 F7\nM72\nG1 X2\nM2\n",
    "on return": "o1 sub\nM73\nG20 G91 G61 F3\nM52 P0\nM53 P0\nG0 X0.1\no1 endsub\nF600 G1 X1\no1 call\nX2\nM2\n",
    "return inside": (
        "o1 sub\nM73\nG91 F3\no2 if [1]\no1 return\no2 endif\nG0 X9\no1 endsub\nF600 G1 X1\no1 call\nX2\nM2\n"
    ),
    "two levels": (
        "o1 sub\nM70\nG19 G91\no2 call\nG1 X1\nM72\no1 endsub\n"
        "o2 sub\nM73\nG17 G90 F9\nG1 X1\no2 endsub\nF60 S500 M4\no1 call\nG1 X5\nM2\n"
    ),
    "dropped in a call": "o1 sub\nM73\nG91\nM71\no1 endsub\nF60\no1 call\nG1 X1\nX1\nM2\n",
}


@needs
@pytest.mark.parametrize("name", PROGRAMS)
def test_modes_are_restored_as_rs274_does(name: str, tmp_path: Path) -> None:
    text = PROGRAMS[name]
    ours = own(tmp_path, text)
    done = subprocess.run(
        ["rs274", "-g", str(tmp_path / "part.ngc")], capture_output=True, stdin=subprocess.DEVNULL, timeout=60
    )
    theirs = re.findall(r"(?m)^\s*\d+ N\S+\s+(.*)$", done.stdout.decode())
    if name == "restored":
        # rs274 leaves mist and flood on that were off when the modes were saved
        ours, theirs = ([line for line in lines if not re.search("MIST|FLOOD", line)] for lines in (ours, theirs))
    # M52 and M53 as they were when the program began are not known to rs274
    ours, theirs = (
        [line for line in lines if "FEED_HOLD" not in line and "ADAPTIVE" not in line] for lines in (ours, theirs)
    )
    assert ours == theirs


def test_a_restored_tool_offset_does_not_move_the_machine(tmp_path: Path) -> None:
    """The offset of 2 inches is gone, and Z is where the machine stands; rs274 mixes up both units here."""
    lines = own(tmp_path, "G21 F60\nG0 Z3\nM70\nG20\nG43.1 Z2\nM72\nG1 X1\nM2\n")
    assert "STRAIGHT_FEED(1.0000, 0.0000, 3.0000, 0.0000, 0.0000, 0.0000)" in lines
    assert sum(line.startswith("USE_TOOL_LENGTH_OFFSET") for line in lines) == 2


def test_coolant_that_was_off_is_off_again(tmp_path: Path) -> None:
    lines = [line for line in own(tmp_path, "M8\nM70\nM9\nM7\nM72\nM2\n") if "MIST" in line or "FLOOD" in line]
    assert lines == [
        *("FLOOD_ON()", "MIST_OFF()", "FLOOD_OFF()", "MIST_ON()"),
        *("MIST_OFF()", "FLOOD_OFF()", "FLOOD_ON()", "FLOOD_OFF()"),
    ]


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        ("M72\n", 1, "M72: no modes are saved at this level"),
        ("M70\nM71\nM72\n", 3, "no modes are saved"),
        ("M70\no1 sub\nM72\no1 endsub\no1 call\n", 3, "no modes are saved at this level"),
        ("M70\nG41.1 D2\nM72\n", 3, "M72 does not go with radius compensation"),
        ("M70 M72\n", 1, "M70 and M72 exclude each other"),
        ("M19 R400\n", 1, "R of M19 is an angle"),
        ("G76 P1 Z-9 I-1 J.1 K1\n", 1, "G76: lathe"),
        (
            "G87 X1 Z-1 R1 I1 J1 K1\n",
            1,
            "G87: back boring: LinuxCNC's manual says that it is accepted, but not defined",
        ),
        ("G88 X1 Z-1 R1 P1\n", 1, "G88: boring with a manual retract"),
        ("G7\n", 1, "G7: .*lathe"),
        ("G71\n", 1, "G71: .*lathe"),
        ("G96 S100 D2000\n", 1, "G96: .*lathe"),
    ],
)
def test_what_cannot_be_restored_or_planned_is_refused(text: str, line: int, reason: str, tmp_path: Path) -> None:
    with pytest.raises(ProgramError, match=reason) as caught:
        own(tmp_path, text)
    assert caught.value.line == line


def test_an_oriented_spindle_is_waited_for(tmp_path: Path) -> None:
    path = program(tmp_path, "S100 M3\nG1 F60 X1\nM19 R30 P1 Q5\nX2\nM2\n")
    commands: list[Command] = list(read_commands(path))
    assert ("ORIENT_SPINDLE", (0, 30.0, 1)) in [command[:2] for command in commands]
    assert 3 in [move.source.number for move in read_program(path) if isinstance(move, Spindle)]


@pytest.mark.parametrize(
    ("code", "needed"), [("G7", True), ("G72.1", True), ("G96", True), ("M70", False), ("G76", False)]
)
def test_only_lathes_need_rs274(code: str, needed: bool, tmp_path: Path) -> None:
    assert needs_rs274(program(tmp_path, f"G0 X1 (G7)\nG0 {code} X2 S1\n")) == needed

"""Drawn part programs give the commands of LinuxCNC's interpreter, to the fourth decimal that it prints."""

from __future__ import annotations

import random
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from feeddrive.language.errors import ProgramError
from feeddrive.path.program.moves import canonical_text
from feeddrive.path.program.reading import read_commands
from fresh_draws import Seeded

pytestmark = pytest.mark.skipif(not shutil.which("rs274"), reason="NOT RUN: rs274 of linuxcnc-uspace is not installed")


class Drawn:
    """Blocks drawn with a seed. Left out is what is another on purpose: see the page on part programs."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.label = 10
        self.loops = self.random.choice(["do", "while"])  # beside while; a break of a while ends a do loop around it
        # rs274 restores the tolerance behind a drilling cycle as a number in the units of the program now; LinuxCNC
        # itself converts it (TO_PROG_LEN in emccanon.cc), as feeddrive does
        self.tolerance_or_units = self.random.choice([["G64 P.1 Q.2"], ["G20", "G21"]])

    def number(self) -> str:
        draw = self.random
        kinds = [f"{draw.randint(-9, 9)}", f"{draw.uniform(-9, 9):.2f}", f"[{draw.randint(0, 3)}+{draw.random():.1f}]"]
        return draw.choice([*kinds, f"#{draw.randint(1, 3)}"])

    def axes(self, most: int = 3) -> str:
        letters = self.random.sample("XYZABC", self.random.randint(1, most))
        return " ".join(letter + self.number() for letter in letters)

    def motion(self) -> list[str]:
        """One or two blocks of motions, modes and offsets."""
        draw = self.random
        i, j = draw.uniform(-3, 3), draw.uniform(-3, 3)
        half = f"X{2 * i:.4f} Y{2 * j:.4f} I{i:.4f} J{j:.4f}"
        hole = f"X{self.number()} Y{self.number()} Z{draw.uniform(-5, 0):.2f} R{draw.uniform(0.1, 4):.2f}"
        drill = draw.choice(["G81", "G82 P.2", "G83 Q.7", "G73 Q.9", "G85", "G89 P1", "G86 P1", "G84 P.3"])
        return draw.choice(
            [
                [draw.choice(["G0 ", "G1 "]) + self.axes()],
                ["G1 " + self.axes(), self.axes()],
                [f"G91 {draw.choice(['G2', 'G3'])} {half}{draw.choice(['', ' P3', ' Z-1', ' A5'])}", "G90"],
                [f"G17 G0 X{self.number()} Y0", f"G2 X[#5420+1] Y1 R{draw.uniform(1, 3):.2f}"],
                [draw.choice([*self.tolerance_or_units, "G17", "G18", "G19", "G61", "G61.1", "G64", "G40", "G49"])],
                [draw.choice(["G54", "G55", "G56", "G59.1", "G59.3"])],
                [f"G10 L{draw.choice(['2', '20'])} P{draw.randint(0, 9)} {self.axes()}"],
                [draw.choice(["G92 ", "G52 "]) + self.axes(), draw.choice(["G92.1", "G92.2", "G92.3"])],
                [f"G53 {draw.choice(['G0', 'G1'])} {self.axes()}"],
                [draw.choice(["G28", "G30", "G28.1", "G30.1", "G28 " + self.axes(2)])],
                ["G0 Z5", f"G17 G99 M3 {drill} {hole}{draw.choice(['', ' L2'])}", f"X{self.number()}", "G80"],
                [draw.choice(["M3", "M4", "M5", "M7", "M8", "M9", "M48", "M49", "M50 P0", "M51 P1", "S100", "T2"])],
                ["G93", f"G1 {self.axes()} F{draw.uniform(1, 5):.2f}", "G94 F20"],
                [f"#{draw.randint(1, 3)}={self.number()}", "(debug,#5420 #5421 #5220 #5221 #1 #<_x>)"],
            ]
        )

    def expression(self, depth: int = 0) -> str:
        draw = self.random
        if depth > 2 or draw.random() < 0.35:
            return draw.choice(["#1", "#2", "#3", "#<v>", str(draw.randint(0, 9)), "-#2", "#[2+1]"])
        if draw.random() < 0.6:
            operator = draw.choice(["+", "-", "*", "eq", "ne", "gt", "ge", "lt", "le", "and", "or", "xor"])
            return f"[{self.expression(depth + 1)} {operator} {self.expression(depth + 1)}]"
        return f"{draw.choice(['abs', 'cos', 'sin', 'round', 'fix', 'fup'])}[{self.expression(depth + 1)}]"

    def flow(self, depth: int = 0, loop: int = 0) -> list[str]:
        """Blocks with o-words, nested up to four deep, in the loop `loop`; a do loop is negative."""
        draw, blocks = self.random, list[str]()
        for _ in range(draw.randint(1, 3)):
            self.label += 1
            n, count = self.label, draw.randint(0, 3)
            kind = draw.choice(["set", "set", "say", "if", "repeat", "while", self.loops, "leave", "call"])
            if depth > 3 or kind == "set":
                blocks.append(f"#{draw.choice(['1', '2', '3', '<v>'])}={self.expression()}")
            elif kind == "say":
                blocks.append("(debug, #1 #2 #3 #<v>)")
            elif kind == "if":
                blocks += [f"o{n} if [{self.expression()} gt 1]", *self.flow(depth + 1, loop)]
                blocks += [f"o{n} elseif [{self.expression()} lt 2]", *self.flow(depth + 1, loop)]
                blocks += [f"o{n} else", *self.flow(depth + 1, loop), f"o{n} endif"]
            elif kind == "repeat":
                blocks += [f"o{n} repeat [{count}]", *self.flow(depth + 1), f"o{n} endrepeat"]
            elif kind == "while":
                blocks += [f"#<k{n}>=0", f"o{n} while [#<k{n}> lt {count}]", f"#<k{n}>=[#<k{n}>+1]"]
                blocks += [*self.flow(depth + 1, n), f"o{n} endwhile"]
            elif kind == "do":
                blocks += [f"#<k{n}>=0", f"o{n} do", f"#<k{n}>=[#<k{n}>+1]", *self.flow(depth + 1, -n)]
                blocks.append(f"o{n} while [#<k{n}> lt {count}]")
            elif kind == "leave" and loop:
                ways = ["break"] if loop < 0 else ["continue"] if self.loops == "do" else ["break", "continue"]
                blocks.append(f"o{abs(loop)} {draw.choice(ways)}")
            elif kind == "call" and depth < 3:
                blocks += [
                    f"o1 call [{self.expression()}] [{self.expression()}]",
                    "(debug,#<_value> #<_value_returned>)",
                ]
        return blocks


def commands(path: Path) -> tuple[list[str], bool]:
    """The own commands, and whether the program was refused."""
    found: list[str] = []
    try:
        for command in read_commands(path, front_end="own", tables_inch=True):
            found += [canonical_text(command)]
    except ProgramError:
        return found, True
    return found, False


def same(ours: str, theirs: str) -> bool:
    """Equal words, and numbers within one of the last digit; the interpreter prints ###### for 22 digits and more."""
    number = r"-?\d+\.\d+|#{6}"
    if re.sub(number, "", ours) != re.sub(number, "", theirs):
        return False
    pairs = zip(re.findall(number, ours), re.findall(number, theirs), strict=True)
    return all(abs(float(a)) > 1e20 if b == "#" * 6 else abs(float(a) - float(b)) < 1.01e-4 for a, b in pairs)


def compare(path: Path, blocks: list[str]) -> None:
    path.write_text("\n".join([*blocks, "M2", ""]))
    done = subprocess.run(
        ["rs274", "-g", str(path)], capture_output=True, stdin=subprocess.DEVNULL, timeout=60, check=False
    )
    found = re.findall(r"(?m)^\s*\d+ N\S+\s+(.*)$", done.stdout.decode("utf-8", "replace"))
    theirs = [each for each in found if each != "ON_RESET()"]
    ours, refused = commands(path)
    ours = [each for each in ours if each != "ON_RESET()"]
    assert refused == (done.returncode != 0), done.stderr.decode()
    # of a block that both refuse, the other may have printed the first commands
    assert len(ours) <= len(theirs) if refused else len(ours) == len(theirs)
    wrong = [(a, b) for a, b in zip(ours, theirs, strict=False) if not same(a, b)]
    assert not wrong, (wrong[0], path.read_text())


@pytest.mark.parametrize("seed", range(40))
def test_drawn_motions_are_those_of_the_interpreter(seed: int, tmp_path: Path, seeded: Seeded):
    drawn = Drawn(seeded(seed))
    blocks = [block for _ in range(drawn.random.randint(3, 14)) for block in drawn.motion()]
    compare(tmp_path / "program.ngc", ["F10", "M3 S10", *blocks])


@pytest.mark.parametrize("condition", ["lt 1", "lt 0"])
def test_a_do_loop_goes_on_behind_a_while_that_was_left_or_skipped(condition: str, tmp_path: Path):
    """A row of the page on part programs: the interpreter keeps the flag of the break, and ends the loop around it."""
    path = tmp_path / "program.ngc"
    inner = ["#<j>=0", f"o2 while [#<j> {condition}]", "#<j>=[#<j>+1]", "o2 break", "o2 endwhile"]
    blocks = ["#<k>=0", "o1 do", "#<k>=[#<k>+1]", "(debug,#<k>)", *inner, "o1 while [#<k> lt 3]", "M2", ""]
    path.write_text("\n".join(blocks))
    messages = [command for command in commands(path)[0] if "MESSAGE" in command]
    assert [re.findall(r"\d\.", message) for message in messages] == [["1."], ["2."], ["3."]]
    done = subprocess.run(["rs274", "-g", str(path)], capture_output=True, stdin=subprocess.DEVNULL, timeout=60)
    assert done.stdout.count(b"MESSAGE") == 1


def test_a_cycle_restores_the_tolerance_as_a_length(tmp_path: Path):
    """A row of the page on part programs: 0.1 mm behind G20 are 0.0039 inch, of which rs274 makes 0.1 inch."""
    path = tmp_path / "program.ngc"
    path.write_text("F10\nM3 S10\nG64 P.1 Q.2\nG20\nG81 X1 Y0 Z-1 R1\nG80\nM2\n")
    modes = [command for command in commands(path)[0] if "CANON_CONTINUOUS" in command]
    assert modes == [f"SET_MOTION_CONTROL_MODE(CANON_CONTINUOUS, {text})" for text in ("0.100000", "0.003937")]
    done = subprocess.run(["rs274", "-g", str(path)], capture_output=True, stdin=subprocess.DEVNULL, timeout=60)
    assert done.stdout.count(b"CANON_CONTINUOUS, 0.100000") == 2


@pytest.mark.parametrize("seed", range(20))
def test_drawn_loops_are_those_of_the_interpreter(seed: int, tmp_path: Path, seeded: Seeded):
    drawn = Drawn(seeded(seed))
    body = ["o1 sub", "#<v>=2", *drawn.flow(3), "o1 endsub [#1+1]", "#1=1 #2=2 #3=3 #<v>=4"]
    compare(tmp_path / "program.ngc", [*body, *drawn.flow(), *drawn.flow()])

"""Programs that ask for more than anyone means end within their budget, or are refused at their line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from time import thread_time
from typing import Any

import pytest
from pathological import KINDS, pathological

import feeddrive as fd
from feeddrive.language.errors import ProgramError
from feeddrive.path.limits import AxisLimits, MachineLimits
from feeddrive.path.planned import planned_of
from feeddrive.path.program import lines
from feeddrive.path.program.blocks import Line
from feeddrive.path.program.budget import Budget, Spending, check_lines
from feeddrive.path.program.reading import read_commands, read_program
from feeddrive.path.setpoints import Setpoints
from slow_share import all_but

LIMITS = MachineLimits(dict.fromkeys("XYZ", AxisLimits(velocity=0.5, acceleration=5.0, jerk=100.0, snap=5e4)))


def refusal(act: Callable[[], Any]) -> str:
    """The reason for which a program is refused, with its line; empty if it is not."""
    try:
        act()
    except ProgramError as error:
        return str(error)
    return ""


def ticking(step: float) -> Callable[[], float]:
    """A clock that advances by `step` s each time it is read."""
    now = [0.0]

    def read() -> float:
        now[0] += step
        return now[0]

    return read


def planned_or_refused(folder: Path, number: int, spending: Spending) -> str:
    """Plan a program of seed 1; return why it is refused, or an empty string if its plan is proven."""
    _, data = pathological(1, number)
    path = folder / "part.ngc"
    path.write_bytes(data)

    def act() -> None:
        moves = read_program(path, axes=LIMITS.travel, front_end="own")
        assert planned_of(Setpoints(moves, LIMITS, 1e-3, None, spending), "part", "table").proof.count == 0

    said = refusal(act)
    assert not said or said.startswith(f"{path}, line "), said
    return said


LONG = (3, 9, 14, 16)  # of these programs: what takes long is their reading, which the clock below does not shorten


@pytest.mark.parametrize(
    "number",
    all_but(
        [number for number in range(2 * len(KINDS)) if number not in LONG],
        range(2 * len(KINDS)),
        "read for some 10 to 30 s of CPU until they are refused",
    ),
)
def test_pathological_programs_end_or_are_refused(number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two of each kind; a clock that is read every 64 moves lets the CPU end after 1,300 of them."""
    monkeypatch.setattr(lines, "MOST_AGAIN_AT_REST", 2000)
    planned_or_refused(tmp_path, number, Spending(Budget(), ticking(1.5)))


@pytest.mark.timeout(1200)
@pytest.mark.slow(reason="a thousand programs, of which one in seven takes its whole budget of 1 s of CPU")
@pytest.mark.parametrize("first", range(0, 1000, 250))
def test_a_thousand_pathological_programs_end_or_are_refused(first: int, tmp_path: Path) -> None:
    """Each within 30 s of CPU: 1 s of budget, 5 s of lines without a motion, and what one chain or block takes."""
    for number in range(first, first + 250):
        begun = thread_time()
        planned_or_refused(tmp_path, number, Spending(Budget(cpu=1.0)))
        assert thread_time() - begun < 30.0, number


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("G1 X1 F0.000001\n", "line 1, column 7: F: the motion up to here lasts 16667 h at the programmed"),
        ("F600\nG1 X1\nG4 P1\nG4 P200000\n", "line 4, column 4: P: the motion up to here lasts 55.56 h"),
        ("F100\no1 repeat [1000]\nG1 X300\nX0\no1 endrepeat\n", "column 1: F: the motion up to here lasts 48"),
    ],
)
def test_a_motion_that_is_too_long_is_refused_at_its_line(text: str, said: str, tmp_path: Path) -> None:
    """With what to do, before anything is written; --longest allows more."""
    path = tmp_path / "part.ngc"
    path.write_text(text + "M2\n", encoding="utf-8")
    with pytest.raises(ProgramError) as caught:
        fd.workflow.plan(path, machine="xy_table", out=tmp_path / "out")
    assert said in str(caught.value), str(caught.value)
    assert "allow more with --longest" in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_longest_allows_more_or_less(tmp_path: Path) -> None:
    """A dwell of 2 s within 1 s and within 3 s."""
    path = tmp_path / "part.ngc"
    path.write_text("G4 P2\nM2\n", encoding="utf-8")
    assert "at most 0.0002778 h" in refusal(lambda: fd.workflow.plan(path, machine="xy_table", longest=1.0))
    assert fd.workflow.plan(path, machine="xy_table", longest=3.0).cycle_time == pytest.approx(2.0)


def test_an_override_cannot_make_a_motion_too_long(tmp_path: Path) -> None:
    """10 mm at 1 mm/s last 10 s at the feed, and 1000 s at 1 %."""
    path = tmp_path / "part.ngc"
    path.write_text("G1 X10 F60\nM2\n", encoding="utf-8")
    said = refusal(lambda: fd.workflow.plan(path, machine="xy_table", longest=100.0, override="0:1"))
    assert "line 1, " in said
    assert "is planned to last" in said


@pytest.mark.parametrize(("hours", "said"), [(40, ""), (60, "and at most 48 h")])
def test_a_motion_lasts_48_h_at_most(hours: float, said: str) -> None:
    found = refusal(lambda: Spending().move(Line("part.ngc", 7, "G1 X1"), 3600.0 * hours, "F"))
    assert said in found if said else not found


@pytest.mark.parametrize(("seconds", "said"), [(31.5, ""), (33.0, "at most 32 s for 1000 lines")])
def test_processor_time_is_30_s_and_2_ms_for_each_line(seconds: float, said: str) -> None:
    spending = Spending(None, ticking(seconds))
    line = Line("part.ngc", 1000, "G1 X1")
    spending.move(line, 0.0, "F")
    found = refusal(lambda: spending.check_cpu(line))
    assert said in found if said else not found


@pytest.mark.parametrize(("count", "refused"), [(80_000, False), (150_000, True)])
def test_a_block_makes_100_000_commands_at_most(count: int, refused: bool, tmp_path: Path) -> None:
    """A cycle of 5,000 pecks of three moves, some times."""
    path = tmp_path / "part.ngc"
    path.write_text(f"F600 G91\nG83 Z-5 R0 Q0.001 L{count // 15_000}\nM2\n", encoding="utf-8")
    said = refusal(lambda: sum(1 for _ in read_commands(path)))
    assert ("moves and events: make fewer pecks" in said) is refused


@pytest.mark.parametrize(("count", "refused"), [(4_000_000, False), (7_000_000, True)])
def test_a_file_has_five_million_lines_at_most(count: int, refused: bool, tmp_path: Path) -> None:
    path = tmp_path / "part.ngc"
    path.write_bytes(b"\n" * count)
    said = refusal(lambda: check_lines(path))
    assert said == (
        f"{path}, line 5000001, column 1: the file has 7,000,000 lines, and a program at most 5,000,000: split it"
        if refused
        else ""
    )

"""Part programs of any bytes: moves or one error with a place, and an end; tables of tools and parameters."""

from __future__ import annotations

import math
import tracemalloc
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from counting import lines_run
from feeddrive.language.errors import FileError, ProgramError
from feeddrive.path.program.blocks import read_offsets
from feeddrive.path.program.moves import Arc, Offsets, Spline, Straight, ToolChange
from feeddrive.path.program.reading import read_program
from feeddrive.path.program.state import read_tools

AXES = {"X": (-10.0, 10.0), "Y": (-10.0, 10.0), "Z": None, "A": None}
NUMBERS = st.one_of(
    st.integers(-9, 99).map(str),
    st.floats(-50, 50).map(lambda value: f"{value:.3f}"),
    st.sampled_from(
        ["#1", "#<a>", "[#1+2]", "[2**#2]", "-[1/3]", "sin[30]", "1.2.3", "#", "[1", "[0/0]", "9" * 400, "-", "##1"]
    ),
)
WORDS = st.builds(str.__add__, st.sampled_from(list("XYZABCUVWIJKRPQLFSTHDEN@^")), NUMBERS)
CODES = st.sampled_from(
    [
        *(
            f"G{code}"
            for code in [
                0,
                1,
                2,
                3,
                4,
                5,
                5.1,
                10,
                17,
                18,
                19,
                20,
                21,
                28,
                28.1,
                30,
                33,
                38.2,
                40,
                41,
                43,
                43.1,
                49,
                52,
            ]
        ),
        *(
            f"G{code}"
            for code in [53, 54, 55, 59.3, 61, 61.1, 64, 73, 74, 76, 80, 81, 82, 83, 84, 85, 86, 89, 90, 90.1, 91]
        ),
        *(f"G{code}" for code in [91.1, 92, 92.1, 92.2, 92.3, 93, 94, 95, 96, 98, 99, 123, 5.25]),
        *(f"M{code}" for code in [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 30, 48, 49, 50, 60, 61, 64, 66, 68, 70, 99]),
    ]
)
FLOW = st.sampled_from(
    [
        *(
            f"o{n} {text}"
            for n in "12"
            for text in ["sub", "endsub", "endsub [1]", "call [1] [2]", "return", "if [#1]", "else"]
        ),
        *(
            f"o{n} {text}"
            for n in "12"
            for text in ["elseif [1]", "endif", "while [#1 lt 5]", "endwhile", "do", "while [0]"]
        ),
        *(f"o{n} {text}" for n in "12" for text in ["repeat [3]", "endrepeat", "break", "continue", "while [1]"]),
        "#1=[#1+1]",
        "o#1 call",
        "o[1+1] if [1]",
        "o<x> call",
        "o",
        "(debug,#1 %d#2 #<a>)",
        "(msg,hello)",
        "(open",
        "#<a>=3 #2=#<a>",
        "%",
        "/G0 X1",
        "; remark",
        "\x00\x7f",
    ]
)
BLOCKS = st.one_of(FLOW, st.lists(st.one_of(CODES, WORDS, WORDS), max_size=6).map(" ".join))
PROGRAMS = st.lists(BLOCKS, max_size=14).map("\n".join).map(str.encode)


def read_whatever(path: Path, content: bytes) -> None:
    """Moves with finite coordinates within the travel, each from where the last ended; or one error with its place."""
    path.write_bytes(content)
    here = None
    refused = None
    try:
        for move in read_program(path, axes=AXES, front_end="own", most_again=2000):
            if isinstance(move, (Straight, Arc, Spline)):
                assert all(math.isfinite(value) for value in move.end)
                assert abs(move.end[0]) <= 10.0 + 1e-9
                assert here is None or move.start == here
                here = move.end
    except ProgramError as error:
        refused = error
    if refused is not None:
        assert refused.file == str(path)
        assert 0 <= refused.line <= content.count(b"\n") + 1
        assert refused.column >= 1
        assert len(str(refused)) < 1000


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    content=st.one_of(PROGRAMS, PROGRAMS.map(lambda program: b"F100 S10 M3 G64\n" + program), st.binary(max_size=200))
)
def test_any_program_gives_moves_or_one_error(content: bytes, tmp_path: Path):
    read_whatever(tmp_path / "program.ngc", content)


@pytest.mark.slow(reason="2 000 drawn programs: 20 s")
@settings(max_examples=2000, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    content=st.one_of(PROGRAMS, PROGRAMS.map(lambda program: b"F100 S10 M3 G64\n" + program), st.binary(max_size=2000))
)
def test_very_many_programs_give_moves_or_one_error(content: bytes, tmp_path: Path):
    read_whatever(tmp_path / "program.ngc", content)


def test_a_plain_line_costs_the_same_wherever_it_stands(tmp_path: Path):
    """Counted in lines of Python: 155 for each of the program, 2.2 million of which a minute were read with so many.

    Half as many again are allowed, with which a million and a half a minute remain.
    """
    path = tmp_path / "program.ngc"

    def cost(lines: int) -> int:
        body = "".join(f"G1 X{i % 977 * 0.01:.4f} Y{i % 1013 * 0.013:.4f} Z{i % 31 * 0.1:.3f}\n" for i in range(lines))
        path.write_text(f"G21 G90 G64 P0.01\nF1000\n{body}M2\n")
        return lines_run(lambda: sum(isinstance(move, Straight) for move in read_program(path)))

    small, middle, large = cost(1000), cost(2000), cost(4000)
    assert large - middle == pytest.approx(2 * (middle - small), rel=1e-3)
    assert large - middle <= 1.5 * 155 * 2000


@pytest.mark.slow(reason="25 000 lines while memory is counted: 4 s")
def test_memory_does_not_grow_with_the_program(tmp_path: Path):
    """Four times the lines need at most 50 kB more: what Python keeps of itself, not 180 kB of text."""
    peaks: list[int] = []
    for lines in (5_000, 20_000):
        path = tmp_path / f"{lines}.ngc"
        path.write_text("F1000\n" + "".join(f"G1 X{i % 977} Y{i % 1013}\n" for i in range(lines)))
        tracemalloc.start()
        for _ in read_program(path):
            pass
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] - peaks[0] < 50_000


def test_tools_and_work_offsets_are_those_of_their_files(tmp_path: Path):
    tools, offsets, program = tmp_path / "tool.tbl", tmp_path / "machine.var", tmp_path / "program.ngc"
    tools.write_text("T7 P2 Z12.5 X-1 D6.0 ;end mill\n\nT8\n")
    offsets.write_text("5220\t2\n5241 100.0\n5250 0.0\n5181 5\n# a remark\n")
    assert read_tools(tools)[7].offset[:3] == (-1.0, 0.0, 12.5)
    assert read_tools(tools)[7].remark == "end mill"
    assert read_offsets(offsets)[5241] == 100.0
    program.write_text("T7 M6 G43\nG0 X1 Z0\nG30\nM2\n")
    found = list(read_program(program, tools=tools, offsets=offsets))
    assert [each.number for each in found if isinstance(each, ToolChange)] == [7]
    first, _, *_ = (each for each in found if isinstance(each, Straight))
    assert first.end[:3] == pytest.approx((0.1, 0.0, 0.0125)), "mm: 1 + 100 - 1, and 12.5"
    assert next(each for each in found if isinstance(each, Offsets)).system == 2
    last = [each for each in found if isinstance(each, Straight)][-1]
    assert last.end[:3] == pytest.approx((0.005, 0.0, 0.0)), "G30 is 5181"


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("tool.tbl", "T1 P1\nT1 P2", "line 2.*T1 stands there twice"),
        ("tool.tbl", "P1 Z3", "line 1.*no number"),
        ("tool.tbl", "T1 Z1 Z2", "line 1, column 7.*each once"),
        ("tool.tbl", "T1.5", "whole number"),
        ("tool.tbl", "T1 Q", "column 4"),
        ("machine.var", "5221 x", "line 1.*number of a parameter and its value"),
        ("machine.var", "5221 nan", "finite"),
        ("machine.var", "0 1", "1..5602"),
        ("machine.var", "5221 1\n5221 2", "line 2.*twice"),
    ],
)
def test_wrong_tables_are_refused_at_their_line(name: str, text: str, words: str, tmp_path: Path):
    path = tmp_path / name
    path.write_text(text + "\n")
    with pytest.raises(FileError, match=words):
        _ = read_tools(path) if name.endswith("tbl") else read_offsets(path)


def test_files_that_are_not_there_are_said(tmp_path: Path):
    for read in (read_program, read_tools, read_offsets):
        with pytest.raises(FileError, match=r"nowhere: cannot be read"):
            _ = list(read(tmp_path / "nowhere"))
    with pytest.raises(FileError, match="is a folder"):
        _ = list(read_program(tmp_path))

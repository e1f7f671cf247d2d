"""The section [process]: what a part program cuts while which lines run, and every way in which it cannot."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from feeddrive.blocks.coupling.milling_cut import MillingCut
from feeddrive.files.job import read_job
from feeddrive.files.machine import BUNDLED
from feeddrive.language.errors import ParameterError, ProgramError

PROGRAM = """G21 G17 G90 G94
T1 M6
S6000 M3
G0 X-10 Y0 Z0
(roughing: ap=4 ae=2.5 down)
G1 X0 F2400
G1 X5
G0 Y5
S8000
(AP=2)
G1 X0
(cut off)
G1 X-5
M5
M2
"""
JOB = """machine = "machining_center"
[program]
file = "p.ngc"
[process.tool.1]
kind = "mechanistic_cutter"
teeth = 4
diameter_mm = 12
axial_depth_mm = 4
flute_length_mm = 24
Ktc_N_per_mm2 = 767
"""


OWN_CUT = """
[[couplings]]
kind = "milling_cut"
spindle_speed = 6000
[couplings.cutter]
kind = "helical_cutter"
teeth = 2
diameter_mm = 10
axial_depth_mm = 5
specific_energy = 3e9
"""
REFERENCE = """[reference]
kind = "linear_move"
distance_mm = 1
travel_time = 1"""


def written(tmp_path: Path, program: str = PROGRAM, job: str = JOB) -> Path:
    """A job and its program."""
    (tmp_path / "p.ngc").write_text(program, encoding="utf-8")
    (tmp_path / "j.toml").write_text(job, encoding="utf-8")
    return tmp_path / "j.toml"


def test_comments_tell_what_the_lines_after_them_cut(tmp_path: Path) -> None:
    job = read_job(written(tmp_path))
    assert job.program is not None
    assert job.axis == "x"
    cuts = [
        (each.line, each.axial_depth, each.radial_depth, each.milling, each.spindle_speed) for each in job.program.cuts
    ]
    assert [each for each in cuts if each[1] > 0.0] == [
        (6, 0.004, 0.0025, "down", 6000.0),
        (11, 0.002, None, "up", 8000.0),
    ]
    # lines 6 and 7 are one section; the traverse in line 8 and line 13 after (cut off) do not cut
    assert [each[0] for each in cuts if each[1] == 0.0 and each[0] > 6] == [8, 13]
    (cut,) = job.machines["today"].couplings
    depth, speed = np.asarray(cut.sections.axial_depth), np.asarray(cut.sections.spindle_speed)
    assert [value for value in depth if value > 0.0] == [0.004, 0.002]
    assert set(speed) == {6000.0, 8000.0}
    counted, line = job.program.counted, job.program.line
    assert counted is not None
    assert line is not None
    assert set(line[counted]) == {6, 7, 11}


def test_a_tooth_meets_as_many_surfaces_in_a_program_as_in_a_cut_of_its_own(tmp_path: Path) -> None:
    """Those that count once a tooth loses contact (Tlusty & Ismail), as the block has them by default."""
    (cut,) = read_job(written(tmp_path)).machines["today"].couplings
    assert cut.surfaces == MillingCut(cutter=cut.cutter, spindle_speed=cut.spindle_speed).surfaces


def test_sections_of_the_job_stand_over_comments(tmp_path: Path) -> None:
    section = """[[process.section]]
first_line = 7
last_line = 11
axial_depth_mm = 1
radial_depth_mm = 6
milling = "up"
spindle_speed = 5000
"""
    job = read_job(written(tmp_path, job=JOB + section))
    assert job.program is not None
    found = {each.line: each for each in job.program.cuts if each.axial_depth > 0.0}
    assert (found[6].axial_depth, found[6].spindle_speed) == (0.004, 6000.0)
    assert found[7][3:] == (0.001, 0.006, "up", 5000.0)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("S6000 M3\n", "", r"p\.ngc, line 5: .*spindle stands: S and M3"),
        ("M3", "M4", r"p\.ngc, line 6: .*counterclockwise \(M4\)"),
        ("T1 M6", "T7 M6", r"line 6: tool 7 cuts, of which the job says nothing: it has \[process\.tool\.1\]"),
        ("ap=4", "ap=30", r"line 6: a depth of cut of 30 mm is more than the tool's flute_length of 24 mm"),
        ("ae=2.5", "ae=13", r"line 6: a width of cut of 13 mm is more than the tool's diameter of 12 mm"),
        ("ap=4", "ap=-4", r"line 5, column 1: .*ap=-4 must be a number of mm > 0"),
        ("ap=4 ", "", r"line 5, column 1: .*ae has no ap"),
        (" down)", ")", r"line 5, column 1: .*either up or down"),
        ("(AP=2)", "(ap=2 up)", r"line 10, column 1: .*up has no ae"),
    ],
)
def test_what_cannot_be_cut_is_named_with_its_line(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in PROGRAM
    with pytest.raises(ProgramError, match=said):
        read_job(written(tmp_path, PROGRAM.replace(old, new)))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[process.tool.1]", "[process.tool.one]", r"j\.toml.*a tool has a number of the program"),
        ('[program]\nfile = "p.ngc"', REFERENCE, "there is no .program."),
        ("teeth = 4", "teeth = 0", r"j\.toml.*teeth"),
        ("Ktc_N_per_mm2 = 767", "Ktc = 767", r"Ktc.*N_per_mm2"),
        ("diameter_mm = 12", "diameter_mm = 12\ncolour = 1", r"key 'process\.tool\.1\.colour' is not known"),
    ],
)
def test_a_process_that_cannot_be_is_named_with_its_key(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in JOB
    job = JOB.replace(old, new)
    with pytest.raises(ParameterError, match=re.compile(said, re.DOTALL)):
        read_job(written(tmp_path, job=job if "[program]" in job else 'axis = "x"\n' + job))


def test_a_line_that_runs_with_two_speeds_is_not_guessed(tmp_path: Path) -> None:
    program = """G21 G90
T1 M6
(ap=1)
o100 sub
G1 X5 F2400
G0 X0
o100 endsub
S6000 M3
o100 call
S8000
o100 call
M2
"""
    with pytest.raises(ProgramError, match=r"line 5: it is run more than once, with different tools or spindle speeds"):
        read_job(written(tmp_path, program))


def test_rows_change_the_control_of_any_axis(tmp_path: Path) -> None:
    row = """[[law]]
name = "soft"
[law.axis.y.control.law]
kind = "cascade_ppi"
Kv = 10
Kp = 5e4
"""
    job = read_job(written(tmp_path, job=JOB + row))
    loops = job.machines["soft"].loops()
    assert loops["y"].control.law.Kv == 10.0  # type: ignore[attr-defined]
    assert loops["y"].control.guard == job.machine.loops["y"].control.guard  # that of today
    assert loops["x"].control == job.machine.loops["x"].control
    with pytest.raises(ParameterError, match=r"there is no axis 'b' in the rows"):
        read_job(written(tmp_path, job=JOB + row.replace("axis.y", "axis.b")))
    twice = row.replace("axis.y", "axis.x") + row.split("\n", 2)[2].replace("law.axis.y.control", "law.control")
    with pytest.raises(ParameterError, match=r"axis 'x' is given twice"):
        read_job(written(tmp_path, job=JOB + twice))


def test_a_tool_of_many_teeth_remembers_a_turn(tmp_path: Path) -> None:
    """The direction of the feed is that of the motion over the last turn of the spindle."""
    assert len(read_job(written(tmp_path, job=JOB.replace("teeth = 4", "teeth = 9"))).machines["today"].couplings) == 1


def test_a_machine_that_cuts_by_itself_takes_no_process(tmp_path: Path) -> None:
    machine = (BUNDLED / "machines" / "machining_center.toml").read_text(encoding="utf-8")
    (tmp_path / "m.toml").write_text(machine + OWN_CUT, encoding="utf-8")
    with pytest.raises(ParameterError, match=r"the machine has a cut of its own: couplings\.0 .* is a milling_cut"):
        read_job(written(tmp_path, job=JOB.replace('"machining_center"', '"m.toml"')))

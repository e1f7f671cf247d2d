"""Part programs of printers and of Grbl, probing and inputs as stops, parameters from outside, and bare waypoints."""

from __future__ import annotations

import math
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.language.errors import ParameterError, ProgramError
from feeddrive.path.program.moves import (
    Arc,
    Dwell,
    Feed,
    Ignored,
    Message,
    Move,
    PathMode,
    Probe,
    Stop,
    Straight,
    ToolChange,
    Wait,
    canonical_text,
)
from feeddrive.path.program.reading import read_commands, read_program
from feeddrive.path.setpoints import PAUSES
from feeddrive.workflow.plan import PlanRequest, plan

needs_rs274 = pytest.mark.skipif(not shutil.which("rs274"), reason="NOT RUN: rs274 of linuxcnc-uspace is not installed")


def moves(folder: Path, text: str, **options: object) -> list[Move]:
    path = folder / "program.gcode"
    path.write_text(text)
    return list(read_program(path, front_end="own", **options))  # type: ignore[arg-type]


def ends(found: list[Move]) -> list[tuple[float, ...]]:
    """X Y Z U of the ends of all motions, mm."""
    going = [move.end for move in found if isinstance(move, (Straight, Arc))]
    return [tuple(round(1e3 * end[axis], 9) + 0.0 for axis in (0, 1, 2, 6)) for end in going]


PRINT = """;FLAVOR:Marlin
M140 S60
M82 ;absolute extrusion mode
G28 X0 Y0
G28
G1 Z15.0 F900
G92 E0
G1 F200 E3
G92 E0
M117 Printing X1 Y2 (100%)
M109 S200
G0 F9000 X10 Y10
G1 F1800 X30 Y10 E0.5
G2 X10 Y30 I-10 J10 E1.4
M83
N12 G1 X20 E.5*35
G91
G1 E-1 F300
G90
G1 X5 E2
G4 P250
G4 S2
T1
M220 S100
G28 Z
M84
"""


def test_a_print_moves_its_extruder_as_the_axis_U(tmp_path: Path):
    """By hand: E absolute and incremental, G92 E0, which shifts the zero of E only, and G28, which ends at 0."""
    found = moves(tmp_path, PRINT, dialect="marlin")
    assert ends(found) == [
        (0, 0, 15, 0),
        (0, 0, 15, 3),
        (10, 10, 15, 3),
        (30, 10, 15, 3.5),
        (10, 30, 15, 4.4),
        (20, 30, 15, 4.9),
        (20, 30, 15, 3.9),
        # G90 makes E absolute again: 2 beyond the zero of G92, which is 3
        (5, 30, 15, 5),
        (5, 30, 0, 5),
    ]
    assert [move.code for move in found if isinstance(move, Ignored)] == ["M140", "M117", "M109", "M220", "M84"]
    assert [move.duration for move in found if isinstance(move, Dwell)] == [0.25, 2.0]
    assert [move.number for move in found if isinstance(move, ToolChange)] == [1]
    assert [move.source.number for move in found if isinstance(move, Stop)] == [11]
    traverses = [move.source.number for move in found if isinstance(move, Straight) and move.traverse]
    assert traverses == [25], "G0 of a printer moves at the feed, G28 does not"
    assert next(move.linear for move in found if isinstance(move, Feed)) == pytest.approx(0.015)


def test_a_print_is_planned_within_the_limits_of_its_extruder(tmp_path: Path):
    """The extruder alone is slow here: 5 mm at 2 mm/s take 2.5 s, and the move along X waits for them."""
    quick = fd.path.AxisLimits(velocity=0.5, acceleration=5.0, jerk=100.0, snap=5e4)
    slow = fd.path.AxisLimits(velocity=0.002, acceleration=5.0, jerk=100.0, snap=5e4)
    limits = fd.path.MachineLimits({"X": quick, "U": slow})
    path = tmp_path / "program.gcode"
    path.write_text("G1 E5 F6000\nG1 X5 E10\n")
    found = read_program(path, dialect="marlin", axes=limits.travel)
    planned = fd.path.planned_of(fd.path.Setpoints(found, limits, 1e-3), "print", "")
    assert planned.proof.count == 0
    # from and to rest at 5 m/s2 and 100 m/s3: less than 20 ms each
    assert 5.0 < planned.cycle_time < 5.08
    path.write_text("G1 E5 F60\n")
    with pytest.raises(ProgramError, match=r"machine has no axis U; it has X"):
        list(read_program(path, dialect="marlin", axes={"X": None}))


@pytest.mark.parametrize(
    ("dialect", "text", "line", "reason"),
    [
        ("marlin", "G21\nG10\n", 2, "length of a retraction is a setting"),
        ("marlin", "M220 S50\n", 1, "scales all feeds: write S100"),
        ("marlin", "M206 X3\n", 1, "shifts the zero"),
        ("marlin", "G1 X1 F9\nM999\n", 2, "M999: the dialect marlin has no such code"),
        ("marlin", "G81 X1\n", 1, "G81: the dialect marlin has no such code"),
        ("marlin", "START_PRINT BED=60\n", 1, "START_PRINT|number, a parameter"),
        ("marlin", "G1 X{x} F9\n", 1, "column 4: x.x.f9"),
        ("grbl", "G0 X1\nG81 Z-1 R1\n", 2, "column 1: G81: the dialect grbl has no such code"),
        ("grbl", "M6 T1\n", 1, "M6: the dialect grbl"),
        ("grbl", "#1=3\n", 1, "grbl has no parameters"),
        ("grbl", "o1 sub\n", 1, "no parameters, expressions and o-words"),
        ("grbl", "$J=X10 F9\n", 1, r"\$J=X10: it moves the machine"),
    ],
)
def test_what_a_dialect_does_not_have_is_refused(dialect: str, text: str, line: int, reason: str, tmp_path: Path):
    with pytest.raises(ProgramError, match=reason) as caught:
        moves(tmp_path, text, dialect=dialect)
    assert caught.value.line == line


def test_grbl_homes_and_leaves_its_settings_out(tmp_path: Path):
    text = "$X\nG54 G0 X3 Y4 (M6 in a comment)\n$H\nG1 X1 F60 ; G81\n$32=1\nT2 M3 S100\nM30\n"
    found = moves(tmp_path, text, dialect="grbl")
    assert ends(found) == [(3, 4, 0, 0), (0, 0, 0, 0), (1, 0, 0, 0)]
    assert [move.code for move in found if isinstance(move, Ignored)] == ["$X", "$32=1"]


def test_linuxcnc_takes_no_word_of_a_printer(tmp_path: Path):
    for text, reason in [
        ("G1 X1 E2 F9\n", "no code of this block uses the word E"),
        ("M104 S3\n", "M100 to M199 start programs of the machine"),
    ]:
        with pytest.raises(ProgramError, match=reason):
            moves(tmp_path, text)
    with pytest.raises(ParameterError, match="rs274 reads no programs in the dialect marlin"):
        read_commands(tmp_path / "program.gcode", dialect="marlin", front_end="rs274")


PROBING = "F60\nG0 X5\nG38.2 Z-5\n(debug,#5061 #5063 #5070 #5422)\nG0 Z1\nG91 G38.3 X2\nG90\nG0 X0\nM2\n"


def test_probing_stops_before_and_after_a_move_to_its_end(tmp_path: Path):
    found = moves(tmp_path, PROBING)
    kinds = [type(move) for move in found if isinstance(move, (Stop, Straight))]
    assert kinds == [Straight, Probe, Straight, Probe, Straight, Probe, Straight, Probe, Straight]
    assert ends(found)[1:4] == [(5, 0, -5, 0), (5, 0, 1, 0), (7, 0, 1, 0)]
    assert [move.text for move in found if isinstance(move, Message)] == ["5.000000 -5.000000 1.000000 -5.000000"]
    assert {"Probe", "Wait"} <= set(PAUSES)


@needs_rs274
def test_probing_moves_are_those_of_rs274(tmp_path: Path):
    path = tmp_path / "program.gcode"
    path.write_text(PROBING.replace("G91 G38.3 X2\nG90", "G38.3 X7"))
    done = subprocess.run(["rs274", "-g", str(path)], capture_output=True, stdin=subprocess.DEVNULL, timeout=60)
    theirs = re.findall(r"(?m)^\s*\d+ N\S+\s+((?:STRAIGHT|TURN).*)$", done.stdout.decode())
    ours = [canonical_text(command) for command in read_commands(path, front_end="own")]
    assert [text for text in ours if re.match("STRAIGHT|TURN", text)] == theirs
    assert len(theirs) == 9


def test_an_input_is_waited_for_and_its_value_is_not_known(tmp_path: Path):
    found = moves(tmp_path, "F60\nG1 X1\nM66 P0 L3 Q5\nG1 X2\nM2\n")
    assert sum(isinstance(move, Wait) for move in found) == 1
    with pytest.raises(ProgramError, match=r"line 2.*#5399, after M66.*not known before"):
        moves(tmp_path, "M66 E0\no1 if [#5399 GT 2]\no1 endif\n")
    with pytest.raises(ProgramError, match="either P or E"):
        moves(tmp_path, "M66 L0\n")


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("F60\nG38.2 Z0\n", "beyond the present position"),
        ("F60\nG38.2\n", "word of an axis"),
        ("G38.2 Z1\n", "feed above 0"),
        ("F60\nG38.2 Z-1\nZ-2\n", "Z stands without a motion"),
    ],
)
def test_faulty_probing_is_refused(text: str, reason: str, tmp_path: Path):
    with pytest.raises(ProgramError, match=reason):
        moves(tmp_path, text)


def test_parameters_from_outside(tmp_path: Path):
    """As plasma programs read them from HAL; a name has neither case nor white space."""
    text = "F#<_hal[plasmac.cut-feed-rate]>\nG1 X#<depth>\nM2\n"
    found = moves(tmp_path, text, parameters={"_HAL[plasmac.cut-feed-rate]": 600.0, "depth": 7.0})
    assert ends(found) == [(7, 0, 0, 0)]
    assert next(move.linear for move in found if isinstance(move, Feed)) == pytest.approx(0.01)
    with pytest.raises(ProgramError, match="has no value here"):
        moves(tmp_path, text)


def test_waypoints_are_passed_in_order_within_the_tolerance():
    """A polygon of 100 points on a circle of 20 mm at 0.1 m/s: the length over the feed, and the run-up and stop."""
    angle = np.linspace(0.0, math.tau, 101)
    points = 0.02 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    axis = fd.path.AxisLimits(velocity=0.5, acceleration=5.0, jerk=100.0, snap=5e4)
    limits = fd.path.MachineLimits({"X": axis, "Y": axis})
    found = fd.path.waypoints(points, 0.1, axes="XY", tolerance=1e-5)
    rows: list[np.ndarray] = []
    setpoints = fd.path.Setpoints(found, limits, 1e-3)
    planned = fd.path.planned_of(setpoints, "circle", "", lambda samples, _: rows.append(samples.values))
    assert planned.proof.count == 0
    assert setpoints.blocks == 100
    places = np.concatenate(rows)[:, :, 0]
    assert places[0] == pytest.approx(points[0], abs=1e-12)
    assert places[-1] == pytest.approx(points[-1], abs=1e-12)
    # the chords lie inside of the circle by R (1 - cos(pi/100)) = 10 um, and the path within 10 um of them
    assert np.max(np.abs(np.hypot(*places.T) - 0.02)) < 2.1e-5
    length = 100 * 0.04 * math.sin(math.pi / 100)
    assert length / 0.1 < planned.cycle_time < length / 0.1 + 0.2


def test_waypoints_with_a_feed_for_each_move():
    found = list(fd.path.waypoints([[0, 0], [1, 0], [1, 0], [1, 2]], [0.1, 0.2, 0.2], axes="za"))
    straight = [move for move in found if isinstance(move, Straight)]
    assert [(move.start[2], move.end[2], move.end[3]) for move in straight] == [(0, 1, 0), (1, 1, 2)]
    assert [move.source.number for move in straight] == [2, 4]
    assert [move.linear for move in found if isinstance(move, Feed)] == [0.1, 0.2]
    assert next(move.tolerance for move in found if isinstance(move, PathMode)) == 0.0


@pytest.mark.parametrize(
    ("points", "feed", "options", "reason"),
    [
        ([[0, 0]], 1, {"axes": "XY"}, r"shape \(1, 2\)"),
        ("abc", 1, {}, "points is no array of numbers: .*abc"),
        ([[0, 0, 0], [1, 1, 1]], "fast", {}, "feed is no array of numbers: .*fast"),
        ([[0, 0], [1, 1]], 1, {}, "3 columns for XYZ"),
        ([[0, 0], [1, np.nan]], 1, {"axes": "XY"}, r"points\[1\].*finite"),
        ([[0, 0], [1, 1]], [1, 2], {"axes": "XY"}, "1, one for each move"),
        ([[0, 0], [1, 1]], 0, {"axes": "XY"}, "above 0"),
        ([[0, 0], [1, 1]], 1, {"axes": "XX"}, "each once"),
        ([[0, 0], [1, 1]], 1, {"axes": "XE"}, "letters of X Y Z"),
        ([[0, 0], [1, 1]], 1, {"axes": "XY", "tolerance": -1.0}, "tolerance = -1.0"),
    ],
)
def test_wrong_waypoints_are_refused(points: list[list[float]], feed: float, options: dict[str, str], reason: str):
    with pytest.raises(ParameterError, match=reason):
        fd.path.waypoints(points, feed, **options)  # type: ignore[arg-type]


def test_a_plan_names_what_it_left_out_and_writes_a_job_in_its_dialect(tmp_path: Path):
    program = tmp_path / "part.gcode"
    program.write_text("M104 S200\nG28\nG1 X5 Y5 F3000\nM104 S0\nM107\n")
    request = PlanRequest(program, machine="xy_table", dialect="marlin", out=tmp_path / "out")
    outcome = plan.run(request)
    assert "Left out, as they move nothing: 2 x M104, 1 x M107." in [str(remark) for remark in outcome.remarks]
    assert 'dialect = "marlin"' in (tmp_path / "out" / "job.toml").read_text()
    with pytest.raises(ProgramError, match="M104"):
        plan.run(PlanRequest(program, machine="xy_table"))


@pytest.mark.parametrize("text", ["_depth", "=3", "_depth=x", "_depth=nan", "_depth=1,,"])
def test_parameters_of_a_plan_are_names_with_numbers(text: str, tmp_path: Path):
    program = tmp_path / "part.ngc"
    program.write_text("G1 X#<_depth> F3000\nM2\n")
    with pytest.raises(ParameterError, match=r"--parameters: .* is no name with a number"):
        plan.run(PlanRequest(program, machine="xy_table", parameters=text))
    assert plan.run(PlanRequest(program, machine="xy_table", parameters="_depth=5, x=1")).result.cycle_time > 0.1

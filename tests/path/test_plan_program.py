"""Part programs to proven motions: cycle times against LinuxCNC's S-curve planner, windows, what is refused."""

from __future__ import annotations

import gzip
import resource
import shutil
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from paths import KINDS, LIMITS, check_all_axes, check_random, random_curve, random_limits, random_program
from scipy.spatial import KDTree

from feeddrive.language.errors import ProgramError
from feeddrive.language.kernels import kernel
from feeddrive.path.geometry.segments import Chain, chains
from feeddrive.path.limits import AxisLimits, MachineLimits
from feeddrive.path.motion import LINE, POLYNOMIAL, Part, Pause, Pieces, Section, derivatives, part_of_pieces
from feeddrive.path.program.moves import Arc, Move, PathMode, Spline, Straight
from feeddrive.path.program.reading import read_program
from feeddrive.path.proof import Proof, Prover
from feeddrive.path.schedule.run import Schedule, plan_run
from feeddrive.path.setpoints import Sampler, Setpoints, planned

LOGS = Path(__file__).parents[3] / "shared" / "data" / "linuxcnc_logs"


def program(folder: Path, text: str) -> Path:
    path = folder / "part.ngc"
    path.write_text(text, encoding="utf-8")
    return path


def proven(path: Path) -> tuple[Proof, list[Part | Pause]]:
    prover, found = Prover(LIMITS), list(planned(read_program(path), "XYZ", LIMITS))
    for each in found:
        if isinstance(each, Part):
            prover.prove(each)
    return prover.proof(), found


def moving(found: list[Part | Pause], lines: range = range(10**9)) -> float:
    """Time of the parts that begin on one of these lines, s; in an overlap the later run counts."""
    parts = (each for each in found if isinstance(each, Part))
    runs = (each for each in parts if int((each.entering or each).pieces.line[0]) in lines)
    return sum(float(np.sum(each.motion.duration)) for each in runs)


def logged(name: str, lines: range = range(10**9)) -> float:
    """Time in which LinuxCNC's planner with jerk 1e5 mm/s³ and no limit of snap moves, s."""
    log = LOGS / name
    if not log.exists():
        pytest.skip(f"NOT COMPARED with LinuxCNC's planner: {log} is not there")
    with gzip.open(log) as file:
        table = np.genfromtxt(file, delimiter=",", names=True)
    positions = np.column_stack([table["x_mm"], table["y_mm"]])
    moves = np.any(np.diff(positions, axis=0) != 0.0, axis=1)
    line = table["gcode_line"][1:]
    return 1e-3 * float(np.sum(moves & (line >= lines.start) & (line < lines.stop)))


def test_a_circle_takes_little_more_than_half_of_the_time_of_linuxcnc() -> None:
    """At equal limits; ours keeps a snap limit, too."""
    theirs = logged("circle_jerk100.csv.gz")
    proof, found = proven(LOGS / "circle.ngc")
    assert proof.count == 0
    assert moving(found) <= 0.575 * theirs


def test_rounded_corners_take_less_than_seven_tenths_of_the_time_of_linuxcnc() -> None:
    """The section of 60 mm squares with R5 corners: lines 4 to 12 of the program, the way to its start left out."""
    theirs = logged("square_r5_jerk100.csv.gz", range(4, 13))
    proof, found = proven(LOGS / "square_r5.ngc")
    assert proof.count == 0
    assert moving(found, range(4, 13)) <= 0.70 * theirs


def test_sharp_corners_and_the_whole_square_take_less_time_than_linuxcnc_needs() -> None:
    """Corners within 50 um, lines 22 to 27 of the program; and all of it, exact stops included."""
    theirs, sharp = logged("square_r5_jerk100.csv.gz"), logged("square_r5_jerk100.csv.gz", range(22, 28))
    proof, found = proven(LOGS / "square_r5.ngc")
    assert proof.count == 0
    assert moving(found, range(22, 28)) <= 0.97 * sharp
    assert moving(found) <= 0.86 * theirs


def test_windows_of_any_size_keep_the_limits_and_cost_little_time() -> None:
    """Random curves in windows of 10, 40 and 400 pieces, seed 7: time within a tenth of the whole."""
    draw = np.random.default_rng(7)
    slower = []
    for _ in range(12):
        limits, pieces = random_limits(draw), random_curve(draw)
        whole = float(np.sum(plan_run(pieces, limits, 10**6).duration))
        for window in (10, 40, 400):
            motion = plan_run(pieces, limits, window)
            prover = Prover(limits)
            assert prover.prove(Part(pieces, motion, True)), prover.proof().faults[0]
            slower.append((window, float(np.sum(motion.duration)) / whole))
    assert max(ratio for window, ratio in slower if window == 400) <= 1.02
    assert np.mean([ratio for window, ratio in slower if window == 40]) <= 1.1


def spiral(folder: Path, blocks: int) -> Path:
    """Chords of 4 mm of an outward spiral, within 10 um, so that each corner is a blend."""
    angle = np.cumsum(np.full(blocks, 0.2))
    points = (20.0 + 0.2 * angle) * np.array([np.cos(angle), np.sin(angle)])
    rows = "\n".join(f"X{x:.4f} Y{y:.4f}" for x, y in points.T)
    return program(folder, f"G21 G90 G64 P0.01 G1 F6000\n{rows}\nM2\n")


def test_a_program_that_comes_in_windows_is_planned_as_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same path, to the bit; in the same time within 2e-3, as lifting sees the path up to the end of a window."""

    def path(found: list[Part | Pause]) -> list[np.ndarray]:
        pieces, goes_on = list[Pieces](), 0
        for each in found:
            if isinstance(each, Part):
                pieces.append(part_of_pieces(each.pieces, goes_on, len(each.pieces.length)))
                goes_on = 0 if each.ends else 1  # the next part begins with the piece on which this one ended
        return [np.concatenate(column) for column in zip(*pieces, strict=True)]

    whole = proven(spiral(tmp_path, 80))[1]
    monkeypatch.setattr("feeddrive.path.geometry.segments.AT_ONCE", 30)
    proof, found = proven(spiral(tmp_path, 80))
    assert proof.count == 0
    assert sum(isinstance(each, Part) and not each.ends for each in found) > 1
    assert moving(found) == pytest.approx(moving(whole), rel=2e-3)
    assert all(map(np.array_equal, path(found), path(whole)))


def test_wherever_the_stream_is_cut_there_is_a_stop_in_hand() -> None:
    """Random curves in windows of 20 and sections of 7 pieces: each part is followed to its stop, and proven."""
    draw = np.random.default_rng(8)
    stops = 0
    for _ in range(8):
        limits, pieces = random_limits(draw), random_curve(draw)
        n = len(pieces.length)
        schedule, before = Schedule(limits, 20), list[Part]()
        for first in range(0, n, 7):
            for part in schedule.add(Section(part_of_pieces(pieces, first, min(first + 7, n)), first + 7 >= n)):
                assert isinstance(part, Part)
                before.append(part)
                stop = schedule.stop()
                prover = Prover(limits)
                assert all(map(prover.prove, [*before, stop] if stop else before)), prover.proof().faults[0]
                assert stop is None or stop.ends
                stops += stop is not None
    assert stops > 15


def test_the_modes_of_the_path_decide_where_it_stops(tmp_path: Path) -> None:
    corner = "G21 G90 F3000\n{}\nG1 X20\nX40 Y0.5\nG4 P0.25\nX60\nM2\n"
    for mode, stops in (("G64 P0.01", 2), ("G61", 3), ("G61.1", 3), ("G64", 3)):
        proof, found = proven(program(tmp_path, corner.format(mode)))
        assert proof.count == 0
        assert sum(isinstance(each, Part) and each.ends and not each.entering for each in found) == stops, mode
        assert [each.duration for each in found if isinstance(each, Pause) and each.duration] == [0.25]


def test_a_run_that_begins_elsewhere_than_the_last_one_ended_is_not_proven(tmp_path: Path) -> None:
    """A lost run, with stops around it, and one that is displaced by 2e-12 m (1e-12 may round)."""
    text = "G21 G90 F3000 G61.1\nG1 X20\nG4 P0.1\nG1 Y20\nX40\nM2\n"
    parts = [each for each in proven(program(tmp_path, text))[1] if isinstance(each, Part)]
    displaced = parts[1]._replace(pieces=parts[1].pieces._replace(origin=parts[1].pieces.origin + 2e-12))
    assert [each.ends for each in parts] == [True] * 3
    for wrong, line in (([parts[0], parts[2]], 5), ([parts[0], displaced, parts[2]], 4)):
        prover = Prover(LIMITS)
        held = [prover.prove(each) for each in wrong]
        assert held == [each is parts[0] or each is not wrong[1] for each in wrong]
        (fault,) = prover.proof().faults
        assert fault.line == line
        assert "does not go on from where the one before has ended" in fault.what


def test_limits_far_beyond_any_machine_are_planned_without_a_warning(tmp_path: Path) -> None:
    """A snap of 1e11 m/s⁴ divided by the share of an axis that does not move had overflowed."""
    limits = np.array([[5.0, 1e3, 1e7, 1e11]] * 3)
    with np.errstate(all="raise", under="ignore"):
        moves = read_program(program(tmp_path, "G21 G90 G64 P0.02 F30000\nG1 X20\nY20\nX0\nM2\n"))
        parts = [each for each in planned(moves, "XYZ", limits) if isinstance(each, Part)]
    prover = Prover(limits)
    held = [prover.prove(each) for each in parts]
    assert held == [True] * len(parts)


def test_segments_end_where_the_program_says(tmp_path: Path) -> None:
    """Ends of arcs and helices in all planes, whose radii differ by the rounding of three decimals: 1e-15 m."""
    blocks = ("G17 G3 X10 Y10 Z3 I0.0004 J10", "G18 G2 X20 Z-7 I10 K0", "G19 G3 Y20 Z3 J0 K10", "G2 J5 K0", "M2")
    path = program(tmp_path, "\n".join(["G21 G90 F3000 G64 P0.01", *blocks]))
    (chain,) = [each for each in chains(read_program(path), "XYZ") if isinstance(each, Chain)]
    r = np.zeros((3, 5))
    ends = np.array([[10, 10, 3], [20, 10, -7], [20, 20, 3], [20, 20, 3]]) * 1e-3
    for k, length in enumerate(chain.segments.length):
        derivatives(int(chain.segments.kind[k]), length, chain.segments.shape[k], length, r)
        assert np.abs(chain.segments.origin[k] + r[:, 0] - ends[k]).max() <= 1e-15


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("G1 X1 F100\nG1 A5\nM2\n", "line 2, column 4: A: the machine has no axis A; it has X, Y, Z"),
        ("G1 X1 F100\nG1 U5\nM2\n", "line 2, column 4: U: the machine has no axis U; it has X, Y, Z"),
        ("M3 S100\nG1 X1 F100\n G33 X2 K1\nM2\n", "line 3, column 2: G33: a move that follows the spindle begins at"),
        ("S100 G95 F1\n G1 X1\nM2\n", "line 2, column 2: G95 is a feed for each turn of the spindle, which stands"),
    ],
)
def test_what_is_not_planned_is_refused_at_its_line(text: str, reason: str, tmp_path: Path) -> None:
    with pytest.raises(ProgramError, match=reason):
        proven(program(tmp_path, text))


def test_a_feed_by_the_turn_follows_the_speed_of_the_spindle(tmp_path: Path) -> None:
    """G95 F0.2 at 600 and 1,200 rpm: 2 and 4 mm/s; the machine stands while the speed changes."""
    text = "M3 S600 G95 F0.2\nG1 X4\nS1200\nX12\nM2\n"
    found = planned(read_program(program(tmp_path, text)), "XYZ", LIMITS)
    feeds = [part.pieces.feed for part in found if isinstance(part, Part)]
    assert np.concatenate(feeds) == pytest.approx([2e-3, 4e-3], rel=1e-15)


SPLINES = """F6000 G5 X50 Y20 I20 J0 P-20 Q0
G5 X100 Y0 P-10 Q10
G5.1 X140 Y0 I20 J40
G1 X160 Y-40
G5 X100 Y0 I0 J0 P0 Q0
G5 X101 Y0 I50 J50 P-50 Q50
M2
"""
POINTS = [
    [(0, 0), (20, 0), (30, 20), (50, 20)], [(50, 20), (70, 20), (90, 10), (100, 0)], [(100, 0), (120, 40), (140, 0)],
    [(140, 0), (160, -40)], [(160, -40), (160, -40), (100, 0), (100, 0)], [(100, 0), (150, 50), (51, 50), (101, 0)],
]  # fmt: skip
"""Of the Bezier curves of that program, mm; the last one has a loop, the one before no direction at its ends."""


def bezier(points: list[tuple[int, int]], count: int) -> np.ndarray:
    """A Bezier curve by de Casteljau's construction, m."""
    s, at = np.linspace(0.0, 1.0, count)[:, None], [np.array(each) * 1e-3 for each in points]
    while len(at) > 1:
        at = [(1.0 - s) * a + s * b for a, b in pairwise(at)]
    return at[0]


@pytest.mark.parametrize(("mode", "tolerance", "runs"), [("G64", 0.0, 6), ("G64 P0.01", 1e-5, 3)])
def test_splines_are_followed_within_the_tolerance(mode: str, tolerance: float, runs: int, tmp_path: Path) -> None:
    """From each sample to the curves: P, and 1 nm for what these bend between points that are some 10 um apart."""
    prover, sampler, rows = Prover(LIMITS), Sampler(4e-3), list[np.ndarray]()
    for part in planned(read_program(program(tmp_path, f"{mode}\n{SPLINES}")), "XYZ", LIMITS):
        if isinstance(part, Part):
            assert prover.prove(part)
            rows.append(sampler.sample(part)[:, :2, 0])
            runs -= part.ends and part.entering is None
    assert runs == 0
    curves = [bezier(each, 10_001) for each in POINTS]
    assert np.min([away(np.concatenate(rows), curve) for curve in curves], axis=0).max() <= tolerance + 1e-9


def away(points: np.ndarray, curve: np.ndarray) -> np.ndarray:
    """From points to a curve of many chords."""
    # where it crosses itself, the nearest chord need not touch the nearest of its points
    near = np.clip(KDTree(curve).query(points, 8)[1], 1, len(curve) - 2).T
    return np.min([distance(points, curve[at + k], curve[at + k + 1]) for at in near for k in (-1, 0)], axis=0)


def distance(points: np.ndarray, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """From points to lines."""
    way = end - begin
    share = np.sum((points - begin) * way, axis=1) / np.maximum(np.sum(way * way, axis=1), 1e-30)
    return np.linalg.norm(points - begin - np.clip(share, 0.0, 1.0)[:, None] * way, axis=1)


GCODE = LOGS.parent / "gcode"
TABLE = "T1 P1 Z0.511 D0.125\nT2 P2 Z0.1 D0.0625\nT3 P3 Z1.273 D0.201\nT4 P4 D1\nT8 P8 D0.01\n"  # inches


def test_nine_axes_in_a_cluster_and_a_kilometre(tmp_path: Path) -> None:
    """Room in the kernels for nine axes; and knots are not counted by the length of lines that have none."""
    letters = "XYZABCUVW"
    lines = [" ".join(f"{letter}{np.cos(0.01 * k + i):.4f}" for i, letter in enumerate(letters)) for k in range(40)]
    text = "\n".join(["G64 P0.01 G1 F6000", *lines, "G0 X999999", "M2"])
    prover, kinds = Prover(np.repeat(LIMITS[:1], 9, axis=0)), set[int]()
    for each in planned(read_program(program(tmp_path, text)), letters, np.repeat(LIMITS[:1], 9, axis=0)):
        if isinstance(each, Part):
            assert prover.prove(each)
            kinds |= set(each.pieces.kind.tolist())
    assert kinds == {LINE, POLYNOMIAL}


REFUSED = {"Circle_Diamond_Square_Calibration.gcode": (624, 18), "full-circle-without-xyz.gcode": (11, 1)}
"""An end beside its circle by 1.4 mm, and a modal G2 without a center; all other public programs are planned."""
LONG = pytest.mark.slow(reason="of 31 public programs the planning of these takes half a minute")


@pytest.mark.skipif(not GCODE.exists(), reason=f"NOT RUN: the public part programs are not in {GCODE}")
@pytest.mark.parametrize(
    "path",
    [
        *(path for path in sorted(GCODE.glob("cncjs/*.gcode")) if path.stat().st_size < 20_000),
        *(pytest.param(path, marks=LONG) for path in sorted(GCODE.glob("cncjs/*")) if path.stat().st_size >= 20_000),
        *(pytest.param(path, marks=LONG) for path in sorted(GCODE.glob("linuxcnc*/**/*.ngc"))),
    ],
    ids=lambda path: path.name,
)
def test_every_public_program_is_planned_or_refused_at_its_line(path: Path, tmp_path: Path) -> None:
    """Within 10 um where the program says nothing; the motion ends where the commands do."""
    (tmp_path / "tool.tbl").write_text(TABLE)
    own = path.parent / "test.tbl"
    tools = own if own.exists() else tmp_path / "tool.tbl"
    ends, last, refused = [(0.0,) * 9], np.zeros(9), list[ProgramError]()
    axis = AxisLimits(velocity=0.5, acceleration=5.0, jerk=100.0, snap=5e4)

    def moves() -> Iterator[Move]:
        try:
            with closing(read_program(path, tools=tools, tables_inch=True)) as found:
                for move in found:
                    yield replace(move, tolerance=move.tolerance or 1e-5) if isinstance(move, PathMode) else move
                    ends.extend([move.end] if isinstance(move, Straight | Arc | Spline) else [])
        except ProgramError as error:
            refused.append(error)

    for samples in Setpoints(moves(), MachineLimits(dict.fromkeys("XYZABCUVW", axis)), 0.01):
        assert samples.proven
        last = samples.values[-1, :, 0] if len(samples.values) else last
    if refused and shutil.which("rs274") is None and "rs274" in refused[0].reason:
        pytest.skip(f"NOT PLANNED without rs274: {refused[0]}")
    assert [(each.line, each.column) for each in refused] == ([REFUSED[path.name]] if path.name in REFUSED else [])
    assert len(ends) > 1
    assert last == pytest.approx(ends[-1], abs=1e-12)


def test_short_chains_are_not_slower_than_from_stop_to_stop() -> None:
    """Programs whose splines and blends alone took 1 to 3 % more."""
    for number, kind in ((34, KINDS[3]), (43, KINDS[5]), (89, KINDS[1])):
        moves, _, limits = random_program(np.random.default_rng([77, number]), kind)
        stopped = [PathMode(moves[0].source, "exact_stop", 0.0), *moves[1:]]
        took, from_stop_to_stop = (moving(list(planned(each, "XYZ", limits))) for each in (moves, stopped))
        assert took < 0.99 * from_stop_to_stop


def test_random_programs_of_six_kinds_hold() -> None:
    """Feeds, tolerances and limits over decades; `python benchmarks/random_programs.py` has a hundred thousand."""
    for number in range(100):
        check_random(number, 1, 6)


@pytest.mark.slow(reason="a thousand random programs, up to 30 moves each; the quick test has a hundred of up to 6")
def test_many_random_programs_of_six_kinds_hold() -> None:
    for number in range(1000):
        check_random(number, 2)


def test_random_splines_and_moves_of_nine_axes_hold() -> None:
    for number in range(8):
        check_all_axes(number, 7)


@pytest.mark.slow(reason="two hundred random programs of up to 400 moves; the quick test has eight")
def test_many_random_splines_and_moves_of_nine_axes_hold() -> None:
    for number in range(200):
        check_all_axes(number, 8)


def test_lifting_leaves_time_pieces_alone_that_have_no_way() -> None:
    """The way of some is lost in rounding: two knots of the spline of u'² were one."""
    check_random(53, 1)


def test_lifting_gives_up_where_the_spline_near_a_motion_runs_backwards() -> None:
    """Its u'² was below 0 at a point, or between the points that are looked at, and its root was taken."""
    for number in (3759, 31277):
        check_random(number, 20261122)


def test_a_line_far_below_its_fastest_speed_keeps_its_limits() -> None:
    """0.3 um, where the speed between its ramps is found by 45 halvings from 10^5 times as much: ramps of another one
    were taken."""
    check_random(13525, 20261122)


@pytest.mark.slow(reason="two times a hundred thousand lines in ten seconds")
@pytest.mark.parametrize("threads", [1, 2])
def test_memory_does_not_grow_with_the_program(threads: int, tmp_path: Path) -> None:
    """From 10,000 lines on by less than 5 MB: read, planned, proven and sampled.

    Thorough code is made before, since that takes 25 MB once, whenever the kernels of a file have run for 0.25 s.
    """
    status = Path("/proc/self/statm")
    if not status.exists():
        pytest.skip("NOT TESTED whether memory grows: there is no /proc/self/statm")
    lines = (f"X{50 * np.cos(a) + 5 * np.cos(7 * a):.4f} Y{50 * np.sin(a):.4f}" for a in 0.002 * np.arange(100_000))
    path = program(tmp_path, "\n".join(["G21 G90 G64 P0.01 G1 F6000", *lines, "M2"]))
    seen = list[int]()

    def counted() -> Iterator[Move]:
        for number, move in enumerate(read_program(path)):
            if number == 8_000:
                for unit in list(kernel._quick):
                    unit.make(kernel.THOROUGH)
            if number % 10_000 == 9_999:
                seen.append(int(status.read_text().split()[1]) * resource.getpagesize())
            yield move

    prover, sampler = Prover(LIMITS), Sampler(1e-3)
    for each in planned(counted(), "XYZ", LIMITS, threads=threads):
        if isinstance(each, Part):
            prover.prove(each)
            sampler.sample(each)
    assert prover.proof().count == 0
    assert len(seen) == 10
    assert max(seen) - seen[0] < 5e6

"""Curves of part programs: NURBS against scipy and circles, arcs in planes rotated by G10 R against the closed form."""

from __future__ import annotations

import itertools
import math
import random
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import BSpline

from feeddrive.language.errors import ProgramError
from feeddrive.path.program.blocks import BlockError
from feeddrive.path.program.frame import TILTED
from feeddrive.path.program.moves import Arc, Spline, Straight
from feeddrive.path.program.nurbs import TOLERANCE, Nurbs
from feeddrive.path.program.reading import read_program
from fresh_draws import Seeded

Curve = Straight | Arc | Spline


def curves(folder: Path, text: str, **options: object) -> list[Curve]:
    path = folder / "program.ngc"
    path.write_text(text)
    found = read_program(path, front_end="own", **options)  # type: ignore[arg-type]
    moves = [move for move in found if isinstance(move, Curve)]
    assert all(a.end == b.start for a, b in itertools.pairwise(moves)), "without a gap"
    return moves


def at(move: Curve, share: np.ndarray) -> np.ndarray:
    """Points of a move at shares of its parameter, shape (n, 9)."""
    start, end = np.array(move.start), np.array(move.end)
    if isinstance(move, Arc):
        points = start + share[:, None] * (end - start)
        first, second, _ = move.axes
        begin = math.atan2(start[second] - move.center[1], start[first] - move.center[0])
        angle = begin + move.angle * share
        points[:, first] = move.center[0] + move.radius * np.cos(angle)
        points[:, second] = move.center[1] + move.radius * np.sin(angle)
        return points
    row = [
        np.broadcast_to(point, (len(share), 9)) for point in (start, *map(np.array, getattr(move, "points", ())), end)
    ]
    while len(row) > 1:
        row = [a + share[:, None] * (b - a) for a, b in itertools.pairwise(row)]
    return row[0]


def polynomial(points: np.ndarray, order: int) -> str:
    """A program with G5.2 through given control points, mm."""
    x, y = points[0]
    lines = [f"G0 X{x:.6f} Y{y:.6f} F100", f"G5.2 P1 L{order}"]
    return "\n".join([*lines, *(f"X{x:.6f} Y{y:.6f}" for x, y in points[1:]), "G5.3", "M2", ""])


@pytest.mark.parametrize("order", [2, 3, 4, 5, 7])
def test_G5_2_is_the_B_spline_with_uniform_knots(order: int, tmp_path: Path, seeded: Seeded):
    """Of order 2 to 4 to rounding, above within the tolerance; by scipy's de Boor, span by span."""
    draw = random.Random(seeded(order))
    points = np.round([(draw.uniform(-20, 20), draw.uniform(-20, 20)) for _ in range(9)], 6)
    spans = len(points) - order + 1
    knots = np.concatenate([np.zeros(order - 1), np.arange(spans + 1.0), np.full(order - 1, float(spans))])
    spline = BSpline(knots, points, order - 1)
    found = [move for move in curves(tmp_path, polynomial(points, order)) if not getattr(move, "traverse", False)]
    bound = 1e-12 if order <= 4 else TOLERANCE
    if order <= 4:
        share = np.linspace(0.0, 1.0, 30)
        assert len(found) == spans
        for span, move in enumerate(found):
            assert np.max(np.abs(1e3 * at(move, share)[:, :2] - spline(span + share))) < bound
    else:
        fine = spline(np.linspace(0.0, spans, 40_001))
        step = float(np.max(np.linalg.norm(np.diff(fine, axis=0), axis=1)))
        for move in found:
            for point in 1e3 * at(move, np.linspace(0.0, 1.0, 5))[:, :2]:
                assert np.min(np.linalg.norm(fine - point, axis=1)) < bound + step
    assert 1e3 * np.array(found[-1].end[:2]) == pytest.approx(points[-1], abs=1e-12)


ROOT = math.sqrt(0.5)
CIRCLE = [
    (1, 0, 1),
    (1, 1, ROOT),
    (0, 1, 1),
    (-1, 1, ROOT),
    (-1, 0, 1),
    (-1, -1, ROOT),
    (0, -1, 1),
    (1, -1, ROOT),
    (1, 0, 1),
]
KNOTS = [0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 4]


def circle(radius: float, unit: str = "G21") -> str:
    """A program with G6.2 for a full circle, with the well-known nine control points."""
    lines = [f"{unit} G0 X{radius} Y0 F100"]
    for i, (x, y, w) in enumerate(CIRCLE):
        lines.append(f"{'G6.2 P3 ' if i == 0 else ''}K{KNOTS[i]} X{radius * x} Y{radius * y} R{w:.15f}")
    return "\n".join([*lines, *(f"K{knot}" for knot in KNOTS[9:]), "G1 Z1", "M2", ""])


@pytest.mark.parametrize(("unit", "factor"), [("G21", 1.0), ("G20", 25.4)])
def test_G6_2_with_weights_is_a_circle(unit: str, factor: float, tmp_path: Path):
    found = [move for move in curves(tmp_path, circle(10.0, unit)) if isinstance(move, Spline)]
    points = 1e3 * np.concatenate([at(move, np.linspace(0.0, 1.0, 40)) for move in found])
    error = np.abs(np.hypot(points[:, 0], points[:, 1]) - 10.0 * factor)
    assert np.max(error) < TOLERANCE
    assert np.max(error) > 0.01 * TOLERANCE, "the bound is not so far off that curves are wasted"
    turned = np.unwrap(np.arctan2(points[:, 1], points[:, 0]))
    assert turned[-1] == pytest.approx(math.tau, abs=1e-12)


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        ("F9\nG5.2 P1 L4\nX1\nX2\nG5.3\n", 5, r"order 4 needs 4 control points.*has 3"),
        ("F9\nG5.2 P1\nX1 P-1\n", 3, "weight of G5.2 lies above 0, not -1"),
        ("F9\nG5.2 P1\nX1 Z2\n", 3, "lies in the plane XY, and moves no other axis"),
        ("F9\nG5.2 P1\nX1\nG1 X2\n", 4, "curve of G5.2 is not ended: write G5.3"),
        ("F9\nG5.2 P1\nX1\nM2\n", 4, "curve of G5.2 is not ended: write G5.3"),
        ("F9\nG5.2 P1\nX1\n", 3, "curve of G5.2 is not ended: write G5.3"),
        ("F9\nG5.3\n", 2, "none is open: write G5.2"),
        ("F9 G91\nG5.2 P1\n", 2, "points of G5.2 are absolute: write G90"),
        ("G5.2 P1\n", 1, "G5.2 needs a feed above 0"),
        ("F9 G18\nG5.2 P1\n", 2, "G5.2 lies in the plane XY"),
        ("F9\nG5.2 P1\nG5.2 P2\n", 3, "has X or Y"),
        ("F9\nG6.2 X5 K0\n", 2, "first control point of G6.2 is the position before it"),
        ("F9\nG6.2 K0\nX5\n", 3, "has a knot: write K"),
        ("F9\nG6.2 P3 K0\nK0 X5\nK0 X6 Y1\nK1\nG1 X2\n", 6, "curve of G6.2 is not ended: write 3 blocks with K alone"),
        ("F9\nG6.2 P2 K0\nK0 X5\nK1\nK2\n", 5, "first 2 knots.*are equal, and so are its last 2"),
        ("F9\nG6.2 P2 K0\nK0 X5\nK1 X6\nK1 X7\nK3\nK3\n", 7, "breaks at a knot that stands there 2 times"),
        ("F9\nG6.2 P2 K0\nK0 X5\nK2 X7\nK1 X8\nK3\nK3\n", 7, "never fall"),
        ("F9\nG6.2 P2 K0\nK0 X5\nK1\nK2 X7\n", 5, "stands behind a knot alone"),
    ],
)
def test_faulty_curves_are_refused_at_their_line(text: str, line: int, reason: str, tmp_path: Path):
    with pytest.raises(ProgramError, match=reason) as caught:
        curves(tmp_path, text)
    assert caught.value.line == line


def test_a_curve_beyond_the_travel_is_refused_also_between_its_ends(tmp_path: Path):
    axes = {"X": (-0.001, 0.02), "Y": (-0.001, 0.004)}
    text = "F9\nG5.2 P1 L4\nX0 Y{}\nX10 Y{}\nX10 Y0\nG5.3\n"
    assert curves(tmp_path, text.format(5, 5), axes=axes)
    with pytest.raises(ProgramError, match=r"line 6.*axis Y would go to 5\.25 mm"):
        curves(tmp_path, text.format(7, 7), axes=axes)


TURNED = [
    ("G19\nG2 Y.5 Z1.5 K1", (1.5, 1.5), (1, 2), -90.0),
    ("G19\nG3 Y.5 Z1.5 K1 X3 P2 A9", (1.5, 1.5), (1, 2), 630.0),
    ("G18\nG2 Z1.5 X1 I1 Y7", (0.5, 1.0), (2, 0), -270.0),
]


@pytest.mark.parametrize(("arc", "center", "plane", "turn"), TURNED)
@pytest.mark.parametrize("rotation", [60.0, 90.0, 180.0, 270.0, -90.0, 450.0, 0.001])
def test_arcs_in_rotated_planes(
    arc: str, center: tuple[float, float], plane: tuple[int, int], turn: float, rotation: float, tmp_path: Path
):
    """LinuxCNC's full_xz.ngc (R60) with other angles and helices: turned back, the points lie on the programmed arc."""
    start = "G20 G90 G61\nG10 L2 P0 X-2 Y1 R{}\nF100\nG0 X0 Y0 Z0\nG0 Y1.5 Z.5\n"
    found = [
        move
        for move in curves(tmp_path, f"{start.format(rotation)}{arc}\nM2\n")
        if isinstance(move, Arc) or not isinstance(move, Straight)
    ]
    assert isinstance(found[0], Arc if rotation % 90.0 == 0.0 else Spline)
    points = np.concatenate([at(move, np.linspace(0.0, 1.0, 40)) for move in found])[:, :3] / 0.0254
    x, y = points[:, 0] + 2.0, points[:, 1] - 1.0
    c, s = math.cos(math.radians(rotation)), math.sin(math.radians(rotation))
    back = np.stack([c * x + s * y, c * y - s * x, points[:, 2]], axis=1)
    first, second = back[:, plane[0]] - center[0], back[:, plane[1]] - center[1]
    inch = 0.0254
    error = inch * np.max(np.abs(np.hypot(first, second) - 1.0))
    assert error < (TILTED if rotation % 90.0 else 1e-15)
    angle = np.degrees(np.unwrap(np.arctan2(second, first)))
    assert angle[-1] - angle[0] == pytest.approx(turn, abs=1e-9)
    # along the normal the helix rises in proportion to the angle
    normal = back[:, 3 - sum(plane)]
    rise = normal[0] + (normal[-1] - normal[0]) * (angle - angle[0]) / (angle[-1] - angle[0])
    assert inch * np.max(np.abs(normal - rise)) < 2e-7, "m: the curves run uniformly but for their tolerance"


@pytest.mark.parametrize(("radius", "count"), [(4.0, 32), (8.0, 64)])
def test_a_circle_is_cut_until_its_cubics_are_within_a_tenth_of_a_micrometer(radius: float, count: int, tmp_path: Path):
    """4 mm are 32 curves at any tolerance from 0.07 to 0.1 µm, 8 mm are 64 of up to 0.1 to 0.13 µm."""
    found = [move for move in curves(tmp_path, circle(radius)) if isinstance(move, Spline)]
    assert len(found) == count


def test_a_tilted_arc_has_as_many_curves_as_its_tolerance_asks_for(tmp_path: Path):
    """Δ⁴ = 384 · 0.1 µm / R: 270° of 25.4 mm are 23.9 arcs of it, so 24; of half the tolerance 29, of twice 21."""
    found = curves(tmp_path, "G20 G10 L2 P0 R60\nF100\nG19\nG2 Y1 Z1 K1 J0\nM2\n")
    angle = (384e-7 / 0.0254) ** 0.25
    assert [type(move) for move in found] == [Spline] * len(found)
    assert len(found) == math.ceil(math.radians(270) / angle) == 24


@pytest.mark.parametrize(("order", "refused"), [(11, False), (8, False), (12, True)])
def test_curves_have_the_order_11_at_most(order: int, refused: bool, tmp_path: Path):
    text = "F9\nG5.2 P1 L{}\n" + "".join(f"X{k} Y{k % 3}\n" for k in range(1, 13)) + "G5.3\n"
    if refused:
        with pytest.raises(ProgramError, match=r"L of G5\.2 is a whole number from 2 to 11"):
            curves(tmp_path, text.format(order))
    else:
        assert curves(tmp_path, text.format(order))


@pytest.mark.parametrize(("count", "refused"), [(15_000, False), (30_000, True)])
def test_curves_have_20000_points_at_most(count: int, refused: bool):
    nurbs = Nurbs("G5.2", 3)

    def fill() -> None:
        for k in range(count):
            nurbs.add([float(k)] * 9, 1.0)

    if refused:
        with pytest.raises(BlockError, match="at most 20000 control points"):
            fill()
    else:
        fill()


@pytest.mark.parametrize(("away", "refused"), [(0.0008, False), (0.0015, True)])
def test_the_first_point_may_be_a_micrometer_off(away: float, refused: bool, tmp_path: Path):
    text = f"F9\nG6.2 P2 K0 X{away}\nK0 X5\nK1\nK1\n"
    if refused:
        with pytest.raises(ProgramError, match=r"first control point of G6\.2 is the position before it"):
            curves(tmp_path, text)
    else:
        assert curves(tmp_path, text)[-1].end[0] == pytest.approx(0.005)

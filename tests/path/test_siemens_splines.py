"""ASPLINE, BSPLINE and CSPLINE of SINUMERIK against scipy, their ends, and what stands between their points."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import Akima1DInterpolator, BSpline, CubicSpline

from feeddrive.language.errors import ProgramError
from feeddrive.path.program.moves import Arc, Dwell, Feed, Message, Move, Spline, Straight
from feeddrive.path.program.reading import read_program

POINTS = np.array(
    [[0.0, 0.0, 0.0], [10.0, 2.0, 1.0], [14.0, 9.0, 1.0], [30.0, 9.5, -2.0], [31.0, 20.0, -3.0], [50, 21, 0]]
)


def moves(folder: Path, text: str, **options: object) -> list[Move]:
    path = folder / "part.mpf"
    path.write_text(text, encoding="utf-8")
    return list(read_program(path, dialect="siemens", **options))  # type: ignore[arg-type]


def refused(folder: Path, text: str) -> str:
    with pytest.raises(ProgramError) as caught:
        moves(folder, text)
    return str(caught.value)


def words(points: np.ndarray) -> str:
    return "".join(f"X{x} Y{y} Z{z}\n" for x, y, z in points.tolist())


def bezier(spline: Spline, s: np.ndarray) -> np.ndarray:
    """Points of a cubic, mm, shape (n, 3)."""
    control = 1e3 * np.array([spline.start, *spline.points, spline.end])[:, :3]
    weights = np.array([(1 - s) ** 3, 3 * s * (1 - s) ** 2, 3 * s * s * (1 - s), s**3])
    return weights.T @ control


def along(spline: Spline | Straight, end: bool) -> np.ndarray:
    inner = spline.points if isinstance(spline, Spline) else ()
    control = np.array([spline.start, *inner, spline.end])[:, :3]
    way = control[-1] - control[-2] if end else control[1] - control[0]
    return way / np.linalg.norm(way)


S = np.linspace(0.0, 1.0, 7)


@pytest.mark.parametrize("count", [2, 3, 4, 6])
@pytest.mark.parametrize(("begin", "how"), [("BAUTO", "not-a-knot"), ("BNAT", (2, 0.0)), ("BTAN", 1)])
@pytest.mark.parametrize(("end", "last"), [("EAUTO", "not-a-knot"), ("ENAT", (2, 0.0)), ("ETAN", 1)])
def test_cspline_is_the_cubic_spline_over_the_chords(
    count: int, begin: str, how: object, end: str, last: object, tmp_path: Path
) -> None:
    """Within 1e-12 mm of scipy's, with each pair of ends; the tangents are those of the lines before and behind."""
    points = POINTS[:count]
    text = f"F900\nG1 X-3 Y-4\nX0 Y0\nCSPLINE {begin} {end}\n{words(points[1:])}G1 X0 Y0 Z0\nM30\n"
    found = [move for move in moves(tmp_path, text) if isinstance(move, Spline)]
    assert len(found) == count - 1
    chords = np.linalg.norm(np.diff(points, axis=0), axis=1)
    t = np.concatenate([[0.0], np.cumsum(chords)])
    natural = (2, np.zeros(3))
    tangents = {"BTAN": (1, np.array([0.6, 0.8, 0.0])), "ETAN": (1, -points[-1] / np.linalg.norm(points[-1]))}
    ends = [tangents.get(name, natural if name.endswith("NAT") else "not-a-knot") for name in (begin, end)]
    if count == 2:
        # a single step has no second one to go on with: no curvature, as BNAT
        ends = [natural if isinstance(row, str) else row for row in ends]
    ours = np.concatenate([bezier(move, S) for move in found])
    if count == 3 and all(isinstance(row, str) for row in ends):
        parabola = np.polyfit(t, points, 2)
        at = np.concatenate([a + S * (b - a) for a, b in pairwise(t)])
        np.testing.assert_allclose(ours, np.stack([np.polyval(row, at) for row in parabola.T], axis=1), atol=1e-11)
        return
    reference = CubicSpline(t, points, bc_type=tuple(ends))  # type: ignore[arg-type]
    at = np.concatenate([a + S * (b - a) for a, b in pairwise(t)])
    np.testing.assert_allclose(ours, reference(at), atol=1e-12)


def test_aspline_is_that_of_akima(tmp_path: Path) -> None:
    """Within 1e-12 mm of scipy's; with the ends of the blocks before and behind only these slopes differ."""
    text = f"F900\nASPLINE BAUTO EAUTO\n{words(POINTS[1:])}G1 X0\nM30\n"
    found = [move for move in moves(tmp_path, text) if isinstance(move, Spline)]
    t = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(POINTS, axis=0), axis=1))])
    at = np.concatenate([a + S * (b - a) for a, b in pairwise(t)])
    np.testing.assert_allclose(
        np.concatenate([bezier(move, S) for move in found]), Akima1DInterpolator(t, POINTS)(at), atol=1e-12
    )
    tangent = f"F900\nG1 Y-4\nX0 Y0\nASPLINE\n{words(POINTS[1:])}G1 X90\nM30\n"
    other = [move for move in moves(tmp_path, tangent) if isinstance(move, Spline)]
    np.testing.assert_allclose(along(other[0], False), [0.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(along(other[-1], True), [1.0, 0.0, 0.0], atol=1e-12)
    for ours, theirs in zip(other[1:-1], found[1:-1], strict=True):
        np.testing.assert_allclose(bezier(ours, S), bezier(theirs, S), atol=1e-12)
    natural = f"F900\nASPLINE BNAT ENAT\n{words(POINTS[1:])}M30\n"
    curves = [move for move in moves(tmp_path, natural) if isinstance(move, Spline)]
    for curve, k in ((curves[0], 0), (curves[-1], 1)):
        control = np.array([curve.start, *curve.points, curve.end])
        np.testing.assert_allclose(control[k] - 2.0 * control[k + 1] + control[k + 2], 0.0, atol=1e-15)
    # collinear points have no weights
    flat = [move for move in moves(tmp_path, "F9\nASPLINE BAUTO EAUTO X1\nX2\nX4\nM30\n") if isinstance(move, Spline)]
    assert all(np.all(bezier(move, S)[:, 1:] == 0.0) for move in flat)


@pytest.mark.parametrize("degree", [2, 3])
def test_bspline_is_the_clamped_spline_over_even_knots(degree: int, tmp_path: Path) -> None:
    text = f"F900\nBSPLINE SD={degree} PL=2\n" + words(POINTS[1:]).replace("\n", " PL=2\n") + "G1 X0\nM30\n"
    found = [move for move in moves(tmp_path, text.replace(" PL=2\n", "\n", 1)) if isinstance(move, Spline)]
    spans = len(POINTS) - degree
    assert len(found) == spans
    knots = np.concatenate([np.zeros(degree), np.arange(spans + 1.0), np.full(degree, float(spans))])
    reference = BSpline(knots, POINTS, degree)
    for k, move in enumerate(found):
        control = 1e3 * np.array([move.start, *move.points, move.end])[:, :3]
        basis = {2: [(1 - S) ** 2, 2 * S * (1 - S), S * S]}.get(degree)
        ours = np.array(basis).T @ control if basis else bezier(move, S)
        np.testing.assert_allclose(ours, reference(k + S), atol=1e-12)


def test_weights_of_bspline_make_a_circle(tmp_path: Path) -> None:
    """A quarter of a circle as a rational spline of second degree, within the tolerance of NURBS, 1e-4 mm."""
    text = "F900\nG1 X10\nBSPLINE SD=2 X10 Y10 PW=0.70710678118654752\nX0 Y10\nG1 X-5\nM30\n"
    found = [move for move in moves(tmp_path, text) if isinstance(move, Spline)]
    radii = np.linalg.norm(np.concatenate([bezier(move, S) for move in found])[:, :2], axis=1)
    assert np.max(np.abs(radii - 10.0)) < 1e-4


def test_ends_follow_arcs_and_polynomials(tmp_path: Path) -> None:
    """Tangents at the transition from and to an arc, a helix and a polynomial agree to 1e-9."""
    text = (
        "F900\nG18\nG3 X10 Z10 I10 K0\nCSPLINE X20 Y5 Z15\nX30 Y5 Z10\nG17 G2 X40 Y15 Z12 I10 TURN=1\n"
        "CSPLINE X50 Y16\nX60 Y10 Z20\nPOLY PO[X]=(70,3) PO[Y]=(10,5,1) PL=2\nG1 X90\nM30\n"
    )
    found = [move for move in moves(tmp_path, text) if isinstance(move, Straight | Arc | Spline)]
    kinds = [type(move) for move in found]
    assert kinds == [Arc, Spline, Spline, Arc, Spline, Spline, Spline, Straight]

    def tangent(arc: Arc, end: bool) -> np.ndarray:
        first, second, across = arc.axes
        x, y = (np.array(arc.end if end else arc.start))[[first, second]] - arc.center
        way = np.zeros(3)
        sense = np.sign(arc.turns)
        way[[first, second]] = -sense * y, sense * x
        way[across] = (arc.end[across] - arc.start[across]) / abs(arc.angle)
        return way / np.linalg.norm(way)

    def way(move: Straight | Arc | Spline, end: bool) -> np.ndarray:
        return tangent(move, end) if isinstance(move, Arc) else along(move, end)

    for before, behind in pairwise(found[:-1]):
        np.testing.assert_allclose(way(before, True), way(behind, False), atol=1e-9)


def test_what_stands_between_the_points_keeps_its_place(tmp_path: Path) -> None:
    text = (
        'F900\nCSPLINE BNAT ENAT X10 Y1\nG40 F600\nX20 Y5\nG4 F1\nX30\nMSG("end")\nG0 X0\nG91 CSPLINE X5\nX5 Y5\nM30\n'
    )
    kinds: list[object] = []
    for move in moves(tmp_path, text):
        if isinstance(move, Straight | Spline):
            kinds.append((type(move).__name__, move.source.number))
        elif isinstance(move, Feed):
            kinds.append(round(6e4 * move.linear))
        elif isinstance(move, Dwell):
            kinds.append("dwell")
        elif isinstance(move, Message):
            kinds.append(move.text[:7])
    assert kinds == [
        *(900, "CSPLINE", ("Spline", 2), 600, ("Spline", 4), "dwell", ("Spline", 6), "end", ("Straight", 8)),
        *(("Spline", 9), ("Spline", 10)),
    ]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("CSPLINE X1 F9\nX2\nG1 X3\n", "BTAN goes on along the move before CSPLINE, and there is none"),
        ("G1 X1 F9\nCSPLINE X2 Y1\nX3\nM30\n", "ETAN ends along the move behind CSPLINE, and there is none"),
        ("G1 X1 F9\nCSPLINE X2 Y1\nX3\nBSPLINE X4\n", "ETAN ends along the move behind CSPLINE"),
        ("CSPLINE BNAT X1\n", "line 1, column 1: CSPLINE: CSPLINE needs a feed above 0"),
        ("F9\nCSPLINE BNAT X1 A1\n", "CSPLINE moves X, Y and Z: move A"),
        ("F9\nCSPLINE BNAT X1 PW=2\n", "PW is the weight of a point of BSPLINE, above 0 and at most 3"),
        ("F9\nBSPLINE X1 PW=4\n", "above 0 and at most 3"),
        ("F9\nBSPLINE X1 PL=1\nX2 PL=2\n", "PL is read in BSPLINE, and if it is the same in all blocks"),
        ("F9\nASPLINE BNAT X1 PL=1\n", "PL is read in BSPLINE"),
        ("F9\nBSPLINE X1\nX2\nG1 X3\n", "a curve of order 4 needs 4 control points at least"),
        ("F9\nBSPLINE SD=4 X1\n", "SD is the degree of BSPLINE, 2 or 3, not 4"),
        ("F9\nCSPLINE BNAT X1\nY0\n", "this point of CSPLINE is the one before"),
        ("F9\nCSPLINE BNAT X1\nTRANS X1\n", "TRANS stands before the end of a spline is known"),
        ("F9\nCSPLINE BNAT X1\nTRAORI\n", "TRAORI stands before the end"),
        ("SPLINEPATH(1,X,Y)\n", "SPLINEPATH: splines of other axes"),
    ],
)
def test_what_is_no_spline_is_refused(text: str, reason: str, tmp_path: Path) -> None:
    assert reason in refused(tmp_path, text)


def test_no_way_into_the_midst_of_a_spline(tmp_path: Path) -> None:
    path = tmp_path / "part.mpf"
    path.write_text("F9\nCSPLINE BNAT ENAT X1\nX2 Y1\nG1 X3\nX4\nM30\n")
    with pytest.raises(ProgramError, match=r"line 3 .--from-line. lies between the control points of a curve"):
        list(read_program(path, dialect="siemens", from_line=3))
    assert len(list(read_program(path, dialect="siemens", from_line=5))) > 2

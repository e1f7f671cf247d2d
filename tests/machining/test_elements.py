"""Elements of a circle-diamond-square part: form errors that were put in are found, corners counted."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from feeddrive.language.errors import ParameterError
from feeddrive.machining.contour import contour_error
from feeddrive.machining.part_run import elements

UM = 1e-6


def part() -> np.ndarray:
    """An outer square with a side inclined by 3 degrees, a diamond in it and a circle; steps of 50 um."""
    tan = np.tan(np.radians(3.0))
    square = [(-40, -40), (40, -40 + 80 * tan), (40, 40), (-40, 40), (-40, 0)]
    corners = [*square, (0, -30), (30, 0), (0, 30), (-30, 0), (-25, 0)]
    found = [np.array(corners[0], float)[None]]
    for a, b in zip(np.array(corners[:-1], float), np.array(corners[1:], float), strict=True):
        count = max(2, round(float(np.linalg.norm(b - a)) / 0.05))
        found.append(a + (b - a) * np.linspace(0.0, 1.0, count + 1)[1:, None])
    angle = np.pi + np.linspace(0.0, 2.0 * np.pi, 3142)[1:]
    found.append(25.0 * np.column_stack([np.cos(angle), np.sin(angle)]))
    return 1e-3 * np.vstack(found)


def test_what_was_put_in_is_found() -> None:
    path = part()
    q, s = 100e-6, 40e-6
    tool = np.column_stack([path[:, 0] * (1.0 + s) + q * path[:, 1], path[:, 1]])
    found = elements(contour_error(tool, path))
    lines = [each for each in found.elements if each.kind == "line"]
    (circle,) = [each for each in found.elements if each.kind == "arc"]
    assert [round(float(np.degrees(each.angle))) % 360 for each in lines[:4]] == [3, 90, 180, 270]
    assert lines[0].angle == pytest.approx(np.radians(3.0), abs=1e-9)
    for each in lines:
        sin, cos = np.sin(each.angle), np.cos(each.angle)
        # a line at φ turns by -q sin²φ - s sin φ cos φ, to first order
        assert each.tilt == pytest.approx(-q * sin**2 - s * sin * cos, abs=2e-8)
        assert each.form < 1e-12
    assert circle.radius == pytest.approx(0.025, abs=1e-12)
    assert circle.angle == pytest.approx(2.0 * np.pi, abs=0.01)
    # an ellipse: R sqrt(q² + s²) between its circles, R s/2 larger in the mean; a tenth of it is left out
    whole = elements(contour_error(tool, path), ends=0.0).elements[-1]
    assert whole.form == pytest.approx(0.025 * np.hypot(q, s), rel=2e-3)
    assert whole.size == pytest.approx(0.5 * 0.025 * s, rel=2e-3)
    assert len(found.corners) == 9
    assert f"{len(found.elements)} elements, 9 corners" in str(found)


def test_straightness_of_a_bowed_side() -> None:
    path = part()
    tool = path.copy()
    side = (path[:, 0] > 0.04 - 1e-9) & (np.abs(path[:, 1]) <= 0.04)
    middle = 0.5 * (np.min(path[side, 1]) + 0.04)
    tool[side, 0] += 5 * UM * np.cos(2.0 * np.pi * (path[side, 1] - middle) / 0.01)  # even: no tilt of its own
    found = elements(contour_error(tool, path, line=np.arange(len(path)) // 100))
    bowed = [each for each in found.elements if each.form > 1 * UM]
    assert len(bowed) == 1
    assert bowed[0].form == pytest.approx(10 * UM, rel=0.02)
    assert np.degrees(bowed[0].angle) == pytest.approx(90.0)
    assert bowed[0].error == pytest.approx(5 * UM, rel=1e-3)
    assert bowed[0].line is not None


def test_wrong_input_is_named() -> None:
    path = part()
    with pytest.raises(ParameterError, match="ends = 0"):
        elements(contour_error(path, path), ends=0.5)
    three = np.column_stack([path, path[:, 0]])
    with pytest.raises(ParameterError, match="plane path, not of x, y, z"):
        elements(contour_error(three, three))


# ---------------------------------------------------------------- what decides: a case on either side of each bound


def follows(*pieces: tuple[float, float]) -> np.ndarray:
    """A tangential path of pieces with length (m) and curvature (1/m), in steps of 50 um."""
    bend = np.concatenate([np.full(round(length / 5e-5), curvature) for length, curvature in pieces])
    # the exact chord of each arc: its direction is that of the middle
    heading = 5e-5 * (np.cumsum(bend) - 0.5 * bend)
    chord = 5e-5 * np.sinc(0.5 * 5e-5 * bend / np.pi)
    step = chord[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
    return np.vstack([[0.0, 0.0], np.cumsum(step, axis=0)])


def kinds(path: np.ndarray) -> list[str]:
    return [each.kind for each in elements(contour_error(path, path)).elements]


@pytest.mark.parametrize(("change", "arcs"), [(0.075, 1), (0.13, 2)])
def test_a_curvature_that_changes_by_5_percent_from_node_to_node_begins_another_arc(change: float, arcs: int) -> None:
    """Between two arcs it changes in two steps: the node in the middle has the mean of both curvatures."""
    assert kinds(follows((0.03, 50.0), (0.03, 50.0 * (1.0 + change)))) == ["arc"] * arcs


@pytest.mark.parametrize(("curvature", "found"), [(0.7e-2, ["line"]), (1.4e-2, [])])
def test_a_radius_of_100_m_is_straight(curvature: float, found: list[str]) -> None:
    """Beyond it the piece turns by far less than an arc must, so that it is neither."""
    assert kinds(follows((0.1, curvature))) == found


@pytest.mark.parametrize(("millimeters", "lines"), [(1.5, 2), (2.6, 3)])
def test_an_element_is_2_mm_long(millimeters: float, lines: int) -> None:
    """A short side between two long ones, at right angles to them."""
    legs = 1e-3 * np.array([[0.0, 0.0], [20.0, 0.0], [20.0, millimeters], [40.0, millimeters]])
    parts = [a + (b - a) * np.linspace(0.0, 1.0, 401)[1:, None] for a, b in pairwise(legs)]
    assert kinds(np.vstack([legs[:1], *parts])) == ["line"] * lines


@pytest.mark.parametrize(("radians", "arcs"), [(0.22, 0), (0.4, 1)])
def test_an_arc_turns_by_17_degrees(radians: float, arcs: int) -> None:
    assert kinds(follows((0.02, 0.0), (0.02 * radians, 50.0), (0.02, 0.0))).count("arc") == arcs


@pytest.mark.parametrize(("share", "seen"), [(0.037, False), (0.07, True)])
def test_a_twentieth_at_each_end_of_an_element_is_left_out(share: float, seen: bool) -> None:
    path = follows((0.05, 0.0))
    tool = path.copy()
    tool[round(share * 1000)] += (0.0, 10 * UM)
    (line,) = elements(contour_error(tool, path)).elements
    assert (line.error > 9 * UM) is seen

"""Where a tool leaves a wall of the part: paths around a square and a circle, along an edge, in a pocket."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from feeddrive.machining.part_run import enclosed, on_part

R = 6e-3  # m, of the tool
STEP = 20e-6  # m, between samples


def along(*corners: tuple[float, float]) -> np.ndarray:
    """Positions on straight lines between corners in mm, m, shape (n, 2)."""
    ends = 1e-3 * np.array(corners)
    lines = [np.linspace(a, b, round(float(np.hypot(*(b - a))) / STEP), endpoint=False) for a, b in pairwise(ends)]
    return np.vstack(lines)


def arc(radius: float, begin: float, end: float, center: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """Positions on an arc, mm and degrees."""
    turn = np.radians(np.linspace(begin, end, round(abs(np.radians(end - begin)) * 1e-3 * radius / STEP)))
    return 1e-3 * (np.array(center) + radius * np.column_stack([np.cos(turn), np.sin(turn)]))


def velocity(path: np.ndarray) -> np.ndarray:
    return np.gradient(path, axis=0) / 5e-5


SQUARE = along((-50, -36), (-36, -36), (-36, 36), (36, 36), (36, -36), (-50, -36))


def test_around_a_square_only_its_sides_count() -> None:
    """A part of 60 mm: on a side of the path of 72 mm the tool touches 60 mm, and nothing on lead-in and lead-out."""
    counted = on_part(SQUARE, velocity(SQUARE), R, "down")
    x, y = 1e3 * np.abs(SQUARE.T)
    assert np.all(np.minimum(x, y)[counted] < 30.1)
    assert np.all(np.abs(np.maximum(x, y)[counted] - 36.0) < 1e-9)
    assert np.count_nonzero(counted) * STEP == pytest.approx(4 * 0.06, rel=2e-3)


def test_up_milling_is_the_same_path_backwards() -> None:
    back = SQUARE[::-1]
    forward = on_part(SQUARE, velocity(SQUARE), R, "down")
    np.testing.assert_array_equal(on_part(back, velocity(back), R, "up"), forward[::-1])


def test_around_a_circle_the_tangential_arcs_of_lead_in_and_out_do_not_count() -> None:
    """A part of radius 20, entered and left by arcs of 7 mm; what is left of them is below the tolerance."""
    path = np.vstack(
        [
            along((-45, 0), (-40, 0)),
            arc(7.0, 180.0, 360.0, (-33.0, 0.0)),
            arc(26.0, 180.0, -180.0),
            arc(7.0, 0.0, 180.0, (-33.0, 0.0)),
        ]
    )
    counted = on_part(path, velocity(path), R, "down")
    turning = np.abs(np.hypot(*path.T) - 26e-3) < 1e-9
    assert np.mean(counted[turning]) > 0.999
    assert np.all(np.hypot(*(path[counted & ~turning] - [-26e-3, 0.0]).T) < 0.8e-3)


def test_an_edge_counts_whole_for_its_ends_are_not_known() -> None:
    path = along((-50, 0), (50, 0))
    assert np.all(on_part(path, velocity(path), R, "down"))


def test_of_two_rings_the_inner_one_leaves_the_part() -> None:
    rings = np.vstack([arc(28.0, 180.0, -180.0), along((-28, 0), (-26, 0)), arc(26.0, 180.0, -180.0)])
    counted = on_part(rings, velocity(rings), R, "down")
    assert np.all(np.hypot(*rings[counted].T) < 26.1e-3)
    assert np.count_nonzero(counted) * STEP == pytest.approx(2 * np.pi * 26e-3, rel=1e-2)


def test_in_a_pocket_the_wall_is_outside_of_the_path() -> None:
    """Down milling runs counterclockwise inside; the way in from the middle leaves no wall."""
    path = np.vstack([along((0, 0), (14, 0)), arc(14.0, 0.0, 360.0)])
    counted = on_part(path, velocity(path), R, "down")
    turning = np.abs(np.hypot(*path.T) - 14e-3) < 1e-9
    assert np.mean(counted[turning]) > 0.99
    assert not np.any(counted[~turning])


def test_a_standstill_leaves_no_wall() -> None:
    path = np.vstack([SQUARE[:3000], np.repeat(SQUARE[2999:3000], 100, axis=0), SQUARE[3000:]])
    moving = velocity(path)
    moving[3000:3099] = 0.0
    assert not np.any(on_part(path, moving, R, "down")[3000:3099])


def test_a_path_goes_around_what_lies_inside() -> None:
    square = along((-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1))
    points = 1e-3 * np.array([[0.0, 0.0], [0.9, -0.9], [1.1, 0.0], [0.0, 5.0]])
    np.testing.assert_array_equal(enclosed(points, square), [True, True, False, False])
    np.testing.assert_array_equal(enclosed(points, square[::-1]), [True, True, False, False])


@pytest.mark.parametrize(("deeper", "counts"), [(3.5e-3, True), (7.5e-3, False)])
def test_a_wall_that_a_later_pass_takes_by_half_a_percent_of_the_radius_is_no_wall_of_the_part(
    deeper: float, counts: bool
) -> None:
    """Two parallel passes in down milling, the second one farther to the right by a share of the radius."""
    first = along((-40, 0), (40, 0))
    path = np.vstack([first, first - [0.0, deeper * R]])
    moving = np.tile([0.4, 0.0], (len(path), 1))
    counted = on_part(path, moving, R, "down")
    assert np.all(counted[len(first) :])
    assert bool(np.mean(counted[: len(first)]) > 0.5) is counts


def test_a_path_with_sixty_lobes_goes_around_all_of_them() -> None:
    """Five of 300 corners lie on each lobe: with fewer, every second tip would lie outside."""
    turn = np.linspace(0.0, 2.0 * np.pi, 60_000, endpoint=False)
    lobes = (1.0 + 0.3 * np.cos(60.0 * turn))[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    tips = 2.0 * np.pi * np.arange(60) / 60.0
    assert np.all(enclosed(1.15 * np.column_stack([np.cos(tips), np.sin(tips)]), lobes))

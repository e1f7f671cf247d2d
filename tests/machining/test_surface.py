"""The wall of an end mill: feed marks against closed forms, and the place of the wall under a vibration."""

from __future__ import annotations

import numpy as np
import pytest

from feeddrive.blocks.coupling.milling_cut import MillingCut
from feeddrive.blocks.cutting.helical_cutter import HelicalCutter
from feeddrive.language.errors import ParameterError
from feeddrive.loop.simulate import Run
from feeddrive.machining.cutting_force import feed_mark, runout_mark, scallop, wall

T = 5e-5
SPEED = 6000.0  # rpm


def moved(feed: float, teeth: int, away: float = 0.0, bend: float = 0.0) -> Run:
    """A tool that moves along x with a feed a tooth in m, `away` from its set position along y, in 40 turns."""
    velocity = feed * teeth * SPEED / 60.0
    time = T * np.arange(round(0.4 / T) + 1)
    passing = 2.0 * np.pi * teeth * SPEED / 60.0
    x, zero = velocity * time, np.zeros(len(time))
    signals = {
        "x.position_load": x,
        "x.velocity_load": zero + velocity,
        "x.set_position": x,
        "y.position_load": away + bend * np.cos(passing * time),
        "y.set_position": zero,
        "y.velocity_load": -bend * passing * np.sin(passing * time),
    }
    return Run("moved", signals, T, len(time))


def cut(teeth: int, radius: float, helix: float = 0.0) -> MillingCut:
    tool = HelicalCutter(teeth=teeth, diameter=2.0 * radius, axial_depth=5e-3, helix_angle=helix, specific_energy=1e9)
    return MillingCut(cutter=tool, spindle_speed=SPEED)


@pytest.mark.parametrize(
    ("feed", "teeth", "milling", "micrometers"),
    [
        (1e-4, 2, "up", 0.2468530838),
        (1e-4, 2, "down", 0.2532202221),
        (2e-4, 4, "up", 0.9510392268),
        (2e-4, 4, "down", 1.0530579249),
    ],
)
def test_feed_marks_are_those_of_the_trochoid(feed: float, teeth: int, milling: str, micrometers: float) -> None:
    # the closed form is that of small marks, c²/R² from the exact one that the golden values are
    assert 1e6 * feed_mark(5e-3, feed, teeth, milling) == pytest.approx(micrometers, rel=2e-4)
    found = wall(moved(feed, teeth), cut(teeth, 5e-3), 0.1, 0.3, milling, points=20001)
    # 1 nm of sag, and half of the slope c/2R over the step of the grid
    assert np.ptp(found.map) == pytest.approx(1e-6 * micrometers, abs=1.5e-9)


@pytest.mark.parametrize(("milling", "left"), [("up", -1.0), ("down", 1.0)])
def test_the_wall_is_where_the_vibration_is_as_its_tooth_passes(milling: str, left: float) -> None:
    """A tool that is 3 um towards +y cuts the wall at +n too deep; one that swings with the teeth only by its phase."""
    still = wall(moved(1e-4, 2), cut(2, 5e-3), 0.1, 0.3, milling)
    away = wall(moved(1e-4, 2, away=3e-6), cut(2, 5e-3), 0.1, 0.3, milling)
    np.testing.assert_allclose(away.map - still.map, left * 3e-6, atol=1e-12)
    swings = wall(moved(1e-4, 2, bend=2e-6), cut(2, 5e-3), 0.1, 0.3, milling)
    # the tooth passes the wall at whole tooth periods in up milling with two teeth, and half a turn later: also whole
    np.testing.assert_allclose(np.mean(swings.map - still.map), left * 2e-6, atol=0.1e-6)


def test_a_helix_leaves_each_height_at_its_own_time() -> None:
    found = wall(moved(1e-4, 2, bend=2e-6), cut(2, 5e-3, helix=0.5), 0.1, 0.3, "down", levels=9)
    lag = 2.0 * np.tan(0.5) / 1e-2 * found.heights
    expected = 2e-6 * np.cos(2.0 * lag)
    np.testing.assert_allclose(
        np.mean(found.map, axis=1) - np.mean(found.map), expected - np.mean(expected), atol=0.15e-6
    )


def test_marks_of_run_out_and_of_a_ball_are_closed_forms() -> None:
    assert [1e6 * runout_mark(5e-3, 1e-4, each) for each in (2e-7, 5e-7, 1e-6, 2e-6)] == pytest.approx(
        [0.36, 0.5625, 1.0, 1.0], rel=1e-12
    )
    assert 1e6 * scallop(3e-3, 2e-4) == pytest.approx(1.6671298870, rel=1e-9)


def test_what_makes_no_wall_is_named() -> None:
    run = moved(1e-4, 2)
    with pytest.raises(ParameterError, match="must be up or down"):
        wall(run, cut(2, 5e-3), 0.1, 0.3, "slot")
    with pytest.raises(ParameterError, match="between two instants of the run"):
        wall(run, cut(2, 5e-3), 0.3, 0.5, "up")
    with pytest.raises(ParameterError, match="teeth pass: a wall needs 8"):
        wall(run, cut(2, 5e-3), 0.1, 0.12, "up")


def test_one_of_eight_teeth_that_cuts_deeper_leaves_marks_of_eight_feeds() -> None:
    """Swinging by 60 um once in four turns of two teeth: marks reach four feeds to each side, (4 c)²/2R deep."""
    time = moved(1e-4, 2).time
    run = moved(1e-4, 2)
    passing = 2.0 * np.pi * 2 * SPEED / 60.0 / 8.0
    signals = dict(run.signals)
    signals["y.position_load"] = 60e-6 * np.cos(passing * time)
    signals["y.velocity_load"] = -60e-6 * passing * np.sin(passing * time)
    found = wall(Run("swinging", signals, T, len(time)), cut(2, 5e-3), 0.1, 0.3, "up", points=2001)
    assert np.ptp(found.map) == pytest.approx((4e-4) ** 2 / (2.0 * 5e-3), rel=0.02)


def test_the_path_of_an_edge_has_a_sagitta_of_a_nanometer() -> None:
    """A tool that hardly moves: its mark is a parabola x²/2R about each pass, and chords lie inside of the arc."""
    feed, R = 2e-4, 5e-3
    found = wall(moved(feed, 1), cut(1, R), 0.1, 0.3, "up", points=40001)
    t = np.linspace(-0.6, 0.6, 4001) * feed / R  # rad beside the pass of the edge
    turn = 2.0 * np.pi * SPEED / 60.0
    s, depth = feed * turn / (2.0 * np.pi) * t / turn + R * np.sin(t), R * (1.0 - np.cos(t))
    exact = np.interp((found.along + 0.5 * feed) % feed - 0.5 * feed, s, depth)
    inside = found.map[0] - exact
    assert np.min(inside) > -1e-11
    assert 0.6e-9 < np.max(inside) < 1.1e-9

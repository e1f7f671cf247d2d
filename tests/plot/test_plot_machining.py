"""Pictures of contour error and circle test: they draw, state units and scale, and hide no curve under a legend."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from io import BytesIO
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from feeddrive import plot
from feeddrive.machining.circle_test import CirclePath, circle_causes, circle_test
from feeddrive.machining.contour import ContourError, contour_error
from feeddrive.machining.load import axis_load
from feeddrive.machining.reversal import Reversal, Reversals

UM = 1e-6


@cache
def contour() -> ContourError:
    """A square with rounded passages of its corners."""
    corners = np.array([[0, 0], [20, 0], [20, 15], [0, 15], [0, 0]]) * 1e-3
    share = np.linspace(0, 1, 400, endpoint=False)[:, None]
    path = np.vstack([a + (b - a) * share for a, b in pairwise(corners)])
    behind = np.vstack([np.repeat(path[:1], 12, axis=0), path[:-12]])
    kernel = np.exp(-np.arange(60) / 8.0)
    kernel /= kernel.sum()
    slow = np.column_stack([np.convolve(np.pad(behind[:, i], (59, 0), "edge"), kernel, "valid") for i in range(2)])
    return contour_error(slow, path, sample_time=1e-3, line=np.repeat(np.arange(4) + 10, 400))


@cache
def circles() -> tuple[CirclePath, ...]:
    angle = 2.0 * np.pi * (np.arange(360) + 0.5) / 360
    found = []
    for d in (1, -1):
        r = 0.05 + 6 * UM * np.sin(2 * angle) + 4 * UM * d * np.sign(np.sin(angle)) * np.cos(angle)
        found.append(CirclePath(r * np.cos(angle), r * np.sin(angle), d, 0.02, 0.05))
    return tuple(found)


def stands() -> Reversals:
    time = np.arange(1000) * 1e-3
    glitch = Reversal("x", "+", 0.2, 1e-6, 2e-5, 0.02, 0.03, 0.0, 5e-3, slice(200, 800))
    return Reversals("run", (glitch,), time, 1e-6 + 2e-5 * np.exp(-np.abs(time - 0.22) / 0.02))


PICTURES: dict[str, Callable[[], Any]] = {
    "contour error": lambda: contour().plot(),
    "on the path": lambda: plot.contour_on_path(contour()),
    "corners": lambda: plot.corner_zoom(contour(), tolerance=2e-5),
    "no corners": lambda: plot.corner_zoom(contour(), corners=[]),
    "circle test": lambda: circle_test(circles()).plot(),
    "unrolled": lambda: plot.circle_unrolled(circle_test(circles())),
    "causes": lambda: circle_causes(circles()).plot(),
    "reversals": lambda: stands().plot(),
    "load": lambda: axis_load(
        np.sin(np.arange(500) / 20.0), np.zeros(501), 0.01, continuous_force=0.8, peak_force=1.5, time_constant=5.0
    ).plot(),
    "load without limits": lambda: axis_load(np.ones(50), np.zeros(51), 0.01).plot(),
}


@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_draws_with_units_and_no_legend_over_a_curve(name: str) -> None:
    figure = PICTURES[name]()
    file = BytesIO()
    figure.savefig(file, format="png", dpi=40)
    assert file.getvalue().startswith(b"\x89PNG")
    for ax in figure.axes:
        assert all(np.all(np.isfinite(limits)) for limits in (ax.get_xlim(), ax.get_ylim()))
        if ax.axison:
            for label in (ax.get_xlabel(), ax.get_ylabel()):
                assert not label or "(" in label
        for legend in [ax.get_legend(), *figure.legends]:
            if legend is not None:
                assert legend.get_window_extent().y0 >= ax.bbox.y1 - 0.03 * ax.bbox.height


def box(figure: Any) -> str:
    """The text that states the scale."""
    texts = [str(each.get_text()) for each in figure.findobj(lambda each: hasattr(each, "get_text"))]
    (found,) = [text for text in texts if "division" in text]
    return found


def test_the_circle_plot_states_its_scale_and_figures() -> None:
    test = circle_test(circles())
    text = box(test.plot())
    assert "5 µm per division" in text  # 10 um on four divisions
    for said in ("R 50 mm, xy plane", "G(b)", "(least squares)", "CCW 1200 mm/min", "both 1200 mm/min"):
        assert said in text
    other = plot.circle_test(test, division=10.0, remark="compensation off")
    assert "10 µm per division" in box(other)
    assert "compensation off" in box(other)


def test_worst_places_are_peaks_of_their_own() -> None:
    corners = contour().corners()
    assert len(corners) == 3
    assert [each.line for each in corners] == [11, 12, 13]
    places = [each.along for each in contour().worst(3)]
    assert all(min(abs(place - each.along) for each in corners) < 2e-3 for place in places)
    assert min(np.diff(sorted(places))) > 5e-3


def test_frames() -> None:
    pytest.importorskip("pandas")
    table = contour().to_pandas()
    assert list(table.columns) == ["along_m", "error_m", "lag_m", "at_corner", "x_m", "y_m", "line"]
    causes = circle_causes(circles()).to_pandas()
    assert causes.loc["backlash x", "unit"] == "m"

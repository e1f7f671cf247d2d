"""Pictures of a contour error: along the path, on the path as color and enlarged, and zooms of corners."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from feeddrive.language.quantity import Quantity, unit_name
from feeddrive.language.text import Text
from feeddrive.plot import style
from feeddrive.plot.chart import (
    ALERT,
    BAR,
    DASHED,
    NEUTRAL,
    PANELS,
    PLAIN,
    RING,
    SOLID,
    THIN,
    WIDTH,
    Abscissa,
    Chart,
    Curve,
    Heat,
    Level,
    Mark,
    Note,
    Panel,
    filled_stairs,
)
from feeddrive.plot.drawing import figure_of
from feeddrive.plot.style import envelope

if TYPE_CHECKING:
    from collections.abc import Sequence

    from feeddrive.machining.contour import ContourError, Corner, Worst

_ENLARGED = 0.08  # of the larger extent: the largest deviation as it is drawn
_STEPS = (1.0, 2.0, 5.0)
_POINTS = 20_000  # of a path that is drawn
_MARKED = 5
_AROUND = 0.12  # of the extent of a path: half of what is shown around a place
_REACH = 3.0  # times the error of a place: half of the width of its 1:1 view


def contour_chart(contour: ContourError) -> Chart:
    """The error over path length with its worst places, and the distribution of the error over the path."""
    along, error = 1e3 * contour.along, 1e6 * contour.error
    places = contour.worst(_MARKED)
    worst = np.array([(1e3 * place.along, 1e6 * place.error) for place in places]).reshape(-1, 2)
    low, high = style.padded(min(0.0, float(error.min())), max(0.0, float(error.max())))
    largest, rms, within = (Quantity(size, "m") for size in (contour.largest, contour.rms, contour.within()))
    over = Panel(
        f"contour error{', + left' if contour.signed else ''}\n({unit_name('um')})",
        (
            Curve(*envelope(along, error), size=0.65),
            Curve(worst[:, 0], worst[:, 1], "worst places", ALERT, RING),
        ),
        levels=(Level(0.0, faint=True),),
        low=low,
        high=high,
        share=1.5,
        caption=Text(f"largest {largest}, RMS {rms}, 95 % within {within}"),
        abscissa=Abscissa(f"length of the path ({unit_name('mm')})"),
    )
    counts, edges = np.histogram(error, bins=60, weights=100.0 * contour.weights)
    share = Panel(
        "part of the path\n(%)",
        (Curve(*filled_stairs(edges, counts), look=SOLID),),
        low=0.0,
        abscissa=Abscissa(f"contour error ({unit_name('um')})"),
    )
    return Chart("", (over, share), height=4.6, legend=PANELS)


contour = figure_of(contour_chart)


def contour_on_path_chart(
    contour: ContourError,
    axes: tuple[int, int] = (0, 1),
    enlarged: float | None = None,
    places: Sequence[Worst] = (),
) -> Chart:
    """The counted part of the path, colored by the size of the error, and the deviation, enlarged by a round factor.

    Places in mm, the size of the error in µm.

    axes      columns of the contour error that span the picture
    enlarged  the factor; default: the largest deviation is a twelfth of the extent
    places    that are marked; the key of a mark is the index of its place
    """
    i, j = axes
    size = np.where(contour.counted, np.abs(contour.error), 0.0)
    rows = envelope(np.arange(len(size), dtype=np.float64), size, _POINTS)[0].astype(np.intp)  # with the largest errors
    kept = contour.counted[rows]
    foot = np.where(kept[:, None], 1e3 * (contour.position - contour.vector)[rows], np.nan)
    factor = _factor(contour, axes) if enlarged is None else enlarged
    tool = foot + factor * 1e3 * contour.vector[rows]
    curves = (
        Curve(tool[:, i], tool[:, j], Text(f"tool, deviation × {Quantity(factor):6}"), NEUTRAL, THIN),
        Curve(foot[:, i], foot[:, j], heat=np.where(kept, 1e6 * size[rows], np.nan)),
    )
    ends = [style.padded(*_ends(np.append(foot[:, k], tool[:, k]))) for k in axes]
    (left, right), (low, high) = ends
    shape = max(0.35, min(1.0, (high - low) / (right - left)))
    caption = Text(f"largest {Quantity(contour.largest, 'm')}, RMS {Quantity(contour.rms, 'm')}")
    heat = Heat(f"contour error ({unit_name('um')})", 0.0, max(1e6 * contour.largest, 1e-9))
    marks = tuple(
        Mark(
            1e3 * float(place.position[i]),
            1e3 * float(place.position[j]),
            ALERT,
            True,
            caption=Text(f"{Quantity(abs(place.error), 'm'):3}"),
            key=str(k),
        )
        for k, place in enumerate(places)
    )
    panel = Panel(
        f"{contour.axes[j]} ({unit_name('mm')})", curves, marks, low=low, high=high, caption=caption, heat=heat
    )
    return Chart(
        f"{contour.axes[i]} ({unit_name('mm')})",
        (panel,),
        low=left,
        high=right,
        square=True,
        height=0.8 + 0.75 * WIDTH * shape,
    )


contour_on_path = figure_of(contour_on_path_chart)


def _factor(contour: ContourError, axes: tuple[int, int]) -> float:
    """Return the round factor by which deviations are enlarged: the largest is about a twelfth of the path's extent."""
    foot = (contour.position - contour.vector)[contour.counted]
    extent = max((float(np.ptp(foot[:, column])) if len(foot) else 0.0 for column in axes), default=0.0)
    return _round(_ENLARGED * max(extent, 1e-12) / max(contour.largest, 1e-15))


def _ends(values: np.ndarray) -> tuple[float, float]:
    there = values[np.isfinite(values)]
    return (float(np.min(there)), float(np.max(there))) if there.size else (0.0, 0.0)


def place_view(
    contour: ContourError, place: Worst, axes: tuple[int, int] = (0, 1)
) -> tuple[float, float, float, float]:
    """The part of `contour_on_path_chart` around a place: left, right, low, high in mm."""
    ends = [_ends(1e3 * contour.position[contour.counted, k]) for k in axes]
    reach = _AROUND * max(high - low for low, high in ends)
    x, y = (1e3 * float(place.position[k]) for k in axes)
    return x - reach, x + reach, y - reach, y + reach


def place_chart(contour: ContourError, place: Worst) -> Chart:
    """Commanded path and tool around a place, in µm from the tool and 1:1, in the plane of the axes that move most."""
    row = int(np.argmin(np.abs(contour.time - place.time)))
    reach = 1e6 * max(_REACH * abs(place.error), 1e-9)
    at, tool = (1e6 * (points - contour.position[row]) for points in (contour.set_position, contour.position))
    near = np.flatnonzero(np.max(np.abs(at - at[row]), axis=1) <= 3.0 * reach)
    begin, end = _together(near, row)
    rows = slice(max(0, begin - 1), end + 2)  # a sample before and behind, for the lines at the edge
    spans = np.ptp(np.vstack([at[rows], tool[rows]]), axis=0)
    i, j = sorted(int(k) for k in np.argsort(spans)[-2:])
    curves = (
        Curve(at[rows, i], at[rows, j], "commanded", NEUTRAL),
        Curve(tool[rows, i], tool[rows, j], "tool", 1, caption=Text(f"{Quantity(abs(place.error), 'm')} off the path")),
    )
    foot = tool[row] - 1e6 * contour.vector[row]
    to_path = Curve(np.array([foot[i], 0.0]), np.array([foot[j], 0.0]), number=ALERT, look=BAR)
    panel = Panel(
        f"{contour.axes[j]} ({unit_name('um')})", (*curves, to_path), (Mark(0.0, 0.0, 1, True),), low=-reach, high=reach
    )
    return Chart(f"{contour.axes[i]} ({unit_name('um')})", (panel,), low=-reach, high=reach, square=True, height=4.8)


def _together(near: np.ndarray, row: int) -> tuple[int, int]:
    """Return the first and the last row of the unbroken run of rows that holds `row`."""
    gaps = np.flatnonzero(np.diff(near) > 1)
    k = int(np.searchsorted(near, row))
    first = gaps[gaps < k]
    last = gaps[gaps >= k]
    return int(near[first[-1] + 1] if len(first) else near[0]), int(near[last[0]] if len(last) else near[-1])


def corner_zoom_chart(
    contour: ContourError, corners: Sequence[Corner] | None = None, tolerance: float | None = None
) -> Chart:
    """Corners 1:1, at most four: the path, the tool, and a band of the tolerance (m) around the path.

    corners  default: the four with the largest error
    """
    wanted = sorted(contour.corners(), key=lambda corner: -corner.error) if corners is None else list(corners)
    panels = [_corner(contour, corner, tolerance) for corner in wanted[:4]]
    if not panels:
        note = Note(0.0, 0.0, "the path has no corner", middle=True)
        return Chart("", (Panel("", notes=(note,), low=-1.0, high=1.0),), low=-1.0, high=1.0, bare=True, height=4.1)
    across = min(2, len(panels))
    return Chart("", tuple(panels), across=across, height=0.5 + 3.6 * -(-len(panels) // across))


corner_zoom = figure_of(corner_zoom_chart)


def _corner(contour: ContourError, corner: Corner, tolerance: float | None) -> Panel:
    at = 1e6 * (contour.set_position - corner.position)
    tool = 1e6 * (contour.position - corner.position)
    reach = 2.2e6 * max(corner.nearest, corner.error, 0.0 if tolerance is None else tolerance, 1e-7)
    near = corner.rows
    curves = [] if tolerance is None else [_tolerance(at[near], 1e6 * tolerance)]
    curves += [
        Curve(at[near, 0], at[near, 1], "path", NEUTRAL, size=0.85),
        Curve(tool[near, 0], tool[near, 1], "tool", 1, PLAIN),
    ]
    where = "" if corner.line is None else f"line {corner.line}, "
    caption = Text(f"{where}{Quantity(np.degrees(corner.turn), 'deg'):3}: passed at {Quantity(corner.nearest, 'm')}")
    x, y = (f"{axis} ({unit_name('um')})" for axis in contour.axes[:2])
    abscissa = Abscissa(x, low=-reach, high=reach, square=True)
    return Panel(y, tuple(curves), low=-reach, high=reach, caption=caption, abscissa=abscissa)


def _tolerance(path: np.ndarray, half: float) -> Curve:
    """A band around a path: the lines left and right of each stretch, open at corners."""
    step = np.diff(path, axis=0)
    moved = np.linalg.norm(step, axis=1) > 0.0
    begin, end, step = path[:-1][moved], path[1:][moved], step[moved]
    normal = half * np.column_stack([-step[:, 1], step[:, 0]]) / np.linalg.norm(step, axis=1)[:, None]
    smooth = np.flatnonzero(np.einsum("ij,ij->i", normal[1:], normal[:-1]) > 0.99 * half * half)
    lines = list[np.ndarray]()
    for side in (1.0, -1.0):
        line = np.full((3 * len(begin), 2), np.nan)
        line[::3], line[1::3] = begin + side * normal, end + side * normal
        line[3 * smooth + 2] = end[smooth] + side * normal[smooth]
        lines.append(line)
    x, y = np.concatenate(lines).T
    return Curve(x, y, number=ALERT, look=DASHED, caption=Text(f"tolerance {Quantity(1e-6 * half, 'm'):3}"), size=0.65)


def _round(factor: float) -> float:
    """Round a factor down to 1, 2 or 5 times a power of ten; at least 1."""
    power = 10.0 ** np.floor(np.log10(max(factor, 1.0)))
    return float(power * max(step for step in _STEPS if step * power <= max(factor, 1.0)))

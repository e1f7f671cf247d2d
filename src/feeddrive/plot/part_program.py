"""Pictures of a part program: its plan, its run on a machine, and the contour error."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from feeddrive.language.quantity import Quantity, unit_name
from feeddrive.language.text import Text
from feeddrive.path.kinematics import LINEAR
from feeddrive.path.limits import FEED, STANDSTILL
from feeddrive.path.planned import Planned
from feeddrive.path.proof import DERIVATIVES
from feeddrive.path.setpoints import causes
from feeddrive.plot import chart, style
from feeddrive.plot.chart import Abscissa, Band, Chart, Curve, Heat, Level, Mark, Note, Panel, Tick
from feeddrive.plot.drawing import figure_of
from feeddrive.plot.style import POINTS, envelope

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from feeddrive.learning.part_correction import CorrectedProgram
    from feeddrive.learning.part_log import LearnedPart
    from feeddrive.machining.contour import ContourError, Corner, Worst
    from feeddrive.machining.part_run import PartRun
    from feeddrive.machining.tip_error import TipError


_ENLARGED = 0.08  # of the larger extent: size of the largest deviation as drawn
_STEPS = (1.0, 2.0, 5.0)
_POINTS = 20_000  # largest number of points of a path
_MARKED = 5
_REACH = 3.0  # multiple of the error of a place: half width of its 1:1 view


def contour_chart(contour: ContourError) -> Chart:
    """Plot the contour error versus path length with its largest values marked, and its distribution over the path."""
    along, error = 1e3 * contour.along, 1e6 * contour.error
    places = contour.worst(_MARKED)
    worst = np.array([(1e3 * place.along, 1e6 * place.error) for place in places]).reshape(-1, 2)
    low, high = style.padded(min(0.0, float(error.min())), max(0.0, float(error.max())))
    largest, rms, within = (Quantity(size, "m") for size in (contour.largest, contour.rms, contour.within()))
    over = Panel(
        f"contour error{', + left' if contour.signed else ''}\n({unit_name('um')})",
        (
            Curve(*envelope(along, error), size=0.65),
            Curve(worst[:, 0], worst[:, 1], "worst places", chart.ALERT, chart.RING),
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
        (Curve(*chart.filled_stairs(edges, counts), look=chart.SOLID),),
        low=0.0,
        abscissa=Abscissa(f"contour error ({unit_name('um')})"),
    )
    return Chart("", (over, share), height=4.6, legend=chart.PANELS)


contour = figure_of(contour_chart)


def contour_on_path_chart(
    contour: ContourError,
    axes: tuple[int, int] = (0, 1),
    enlarged: float | None = None,
    places: Sequence[Worst] = (),
) -> Chart:
    """Plot the path, colored by the size of the contour error, and the enlarged deviation.

    Positions are in mm, the size of the error is in µm. Parts of the path that are not evaluated are omitted.

    axes      the two columns of the contour error that span the picture
    enlarged  enlargement factor; default: a round factor that makes the largest deviation about 1/12 of the extent
    places    places to mark; the key of a mark is the index of its place
    """
    i, j = axes
    size = np.where(contour.counted, np.abs(contour.error), 0.0)
    # Thinned by the error, not evenly: the largest errors stay on a path of any length.
    rows = envelope(np.arange(len(size), dtype=np.float64), size, _POINTS)[0].astype(np.intp)
    kept = contour.counted[rows]
    foot = np.where(kept[:, None], 1e3 * (contour.position - contour.vector)[rows], np.nan)
    factor = _factor(contour, axes) if enlarged is None else enlarged
    tool = foot + factor * 1e3 * contour.vector[rows]
    curves = (
        Curve(tool[:, i], tool[:, j], Text(f"tool, deviation × {Quantity(factor):6}"), chart.NEUTRAL, chart.THIN),
        Curve(foot[:, i], foot[:, j], heat=np.where(kept, 1e6 * size[rows], np.nan)),
    )
    ends = [style.padded(*_ends(np.append(foot[:, k], tool[:, k]))) for k in axes]
    (left, right), (low, high) = ends
    shape = max(0.35, min(1.0, (high - low) / (right - left)))
    caption = Text(f"largest {Quantity(contour.largest, 'm')}, RMS {Quantity(contour.rms, 'm')}")
    # A color scale needs a range, also for a path without an error.
    heat = Heat(f"contour error ({unit_name('um')})", 0.0, max(1e6 * contour.largest, 1e-9))
    marks = tuple(
        Mark(
            1e3 * float(place.position[i]),
            1e3 * float(place.position[j]),
            chart.ALERT,
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
        height=0.8 + 0.75 * chart.WIDTH * shape,
    )


contour_on_path = figure_of(contour_on_path_chart)


def _factor(contour: ContourError, axes: tuple[int, int]) -> float:
    """Return the round enlargement factor that makes the largest deviation about 1/12 of the path's extent."""
    foot = (contour.position - contour.vector)[contour.counted]
    extent = max((float(np.ptp(foot[:, column])) if len(foot) else 0.0 for column in axes), default=0.0)
    return enlargement(extent, contour.largest)


def enlargement(extent: float, largest: float) -> float:
    """Return a factor of at least 1 with which a deviation is about 1/12 of an extent: 1, 2 or 5 times a power of ten.

    extent, largest  extent of the path and largest deviation, m
    """
    wanted = max(_ENLARGED * max(extent, 1e-12) / max(largest, 1e-15), 1.0)
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(power * max(step for step in _STEPS if step * power <= wanted))


def _ends(values: np.ndarray) -> tuple[float, float]:
    there = values[np.isfinite(values)]
    return (float(np.min(there)), float(np.max(there))) if there.size else (0.0, 0.0)


def place_chart(
    contour: ContourError, place: Worst, runs: Sequence[tuple[str, int, ContourError]] | None = None
) -> Chart:
    """Plot the commanded path and the tool's path around a location, in µm relative to the tool position and with equal
    scales, in the plane of the two axes that move most.

    runs  name, number of the curve and contour error of each run of the same program that is drawn; default: the tool
          of `contour` alone
    """
    row = int(np.argmin(np.abs(contour.time - place.time)))
    reach = 1e6 * max(_REACH * abs(place.error), 1e-9)
    at, tool = (1e6 * (points - contour.position[row]) for points in (contour.set_position, contour.position))
    near = np.flatnonzero(np.max(np.abs(at - at[row]), axis=1) <= 3.0 * reach)
    # A path may pass the place several times: only the pass at this instant is shown.
    begin, end = _together(near, row)
    # One more sample before and after, so that the lines reach the edge of the view.
    rows = slice(max(0, begin - 1), end + 2)
    spans = np.ptp(np.vstack([at[rows], tool[rows]]), axis=0)
    i, j = sorted(int(k) for k in np.argsort(spans)[-2:])
    curves = [Curve(at[rows, i], at[rows, j], "commanded", chart.NEUTRAL)]
    for name, number, run in runs or [("tool", 1, contour)]:
        way = 1e6 * (run.position[rows] - contour.position[row])
        off = float(np.abs(run.error[min(row, len(run.error) - 1)]))
        curves.append(Curve(way[:, i], way[:, j], name, number, caption=Text(f"{Quantity(off, 'm'):3} off the path")))
    foot = tool[row] - 1e6 * contour.vector[row]
    to_path = Curve(np.array([foot[i], 0.0]), np.array([foot[j], 0.0]), number=chart.ALERT, look=chart.BAR)
    panel = Panel(
        f"{contour.axes[j]} ({unit_name('um')})", (*curves, to_path), (Mark(0.0, 0.0, 1, True),), low=-reach, high=reach
    )
    return Chart(f"{contour.axes[i]} ({unit_name('um')})", (panel,), low=-reach, high=reach, square=True, height=4.8)


def _together(near: np.ndarray, row: int) -> tuple[int, int]:
    """Return the first and the last row of the contiguous block of rows that contains `row`."""
    gaps = np.flatnonzero(np.diff(near) > 1)
    k = int(np.searchsorted(near, row))
    first = gaps[gaps < k]
    last = gaps[gaps >= k]
    return int(near[first[-1] + 1] if len(first) else near[0]), int(near[last[0]] if len(last) else near[-1])


def corner_zoom_chart(
    contour: ContourError, corners: Sequence[Corner] | None = None, tolerance: float | None = None
) -> Chart:
    """Plot at most four corners with equal scales of both axes: the path, the tool's path, and the tolerance band (m).

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
    # First, so that path and tool are drawn over the band.
    curves = [] if tolerance is None else [_tolerance(at[near], 1e6 * tolerance)]
    curves += [
        Curve(at[near, 0], at[near, 1], "path", chart.NEUTRAL, size=0.85),
        Curve(tool[near, 0], tool[near, 1], "tool", 1, chart.PLAIN),
    ]
    where = "" if corner.line is None else f"line {corner.line}, "
    caption = Text(f"{where}{Quantity(np.degrees(corner.turn), 'deg'):3}: passed at {Quantity(corner.nearest, 'm')}")
    x, y = (f"{axis} ({unit_name('um')})" for axis in contour.axes[:2])
    abscissa = Abscissa(x, low=-reach, high=reach, square=True)
    return Panel(y, tuple(curves), low=-reach, high=reach, caption=caption, abscissa=abscissa)


def _tolerance(path: np.ndarray, half: float) -> Curve:
    """Return a band around a path: lines to the left and right of each segment, open at corners."""
    step = np.diff(path, axis=0)
    moved = np.linalg.norm(step, axis=1) > 0.0
    begin, end, step = path[:-1][moved], path[1:][moved], step[moved]
    normal = half * np.column_stack([-step[:, 1], step[:, 0]]) / np.linalg.norm(step, axis=1)[:, None]
    # cos 8 deg = 0.99: at a sharper corner neither offset line is the border of the tolerance
    smooth = np.flatnonzero(np.einsum("ij,ij->i", normal[1:], normal[:-1]) > 0.99 * half * half)
    lines = list[np.ndarray]()
    for side in (1.0, -1.0):
        line = np.full((3 * len(begin), 2), np.nan)
        line[::3], line[1::3] = begin + side * normal, end + side * normal
        line[3 * smooth + 2] = end[smooth] + side * normal[smooth]
        lines.append(line)
    x, y = np.concatenate(lines).T
    return Curve(
        x,
        y,
        number=chart.ALERT,
        look=chart.DASHED,
        caption=Text(f"tolerance {Quantity(1e-6 * half, 'm'):3}"),
        size=0.65,
    )


# from slow to fast: warm to cold, and thinner, so that gray print shows it too; number of the color, and width
_SPEEDS = ((chart.ALERT, 1.85), (1, 1.6), (4, 1.3), (2, 1.1), (5, 0.95), (0, 0.8))
_CAUSE_NUMBERS = (chart.ALERT, 1, 0, 4, 2)  # colors of the causes of falls, the largest loss first
_COLUMNS = 400  # time intervals over the width of a picture
_ABOVE = 1.3  # of the largest programmed feed: what is faster is cut off
_FLAT = 0.02  # of the largest extent: an axis that moves less has no separate view
_MARKED_STOPS = 300  # largest number of marked stops
_UNITS = {
    "mm": (("mm/s", 1e3), ("m/s²", 1.0), ("m/s³", 1.0), ("m/s⁴", 1.0)),
    "deg": (("deg/s", float(np.degrees(1.0))), ("rad/s²", 1.0), ("rad/s³", 1.0), ("rad/s⁴", 1.0)),
}


def planned_chart(plan: Planned) -> Chart:
    """Plot the planned path with its speed as color, and the stops; with a second view if a third axis moves."""
    return _on_path(plan, _path)


planned = figure_of(planned_chart)


def plan_losses_chart(plan: Planned) -> Chart:
    """Plot the planned path, colored by what makes it slower than the programmed feed; views as in `planned_chart`."""
    return _on_path(plan, _lost)


plan_losses = figure_of(plan_losses_chart)


def _on_path(plan: Planned, curves_of: Callable[[Planned, np.ndarray, np.ndarray], list[Curve]]) -> Chart:
    """Plot curves along the path, and the stops, in each view of the path."""
    factors, units = (list(row) for row in zip(*plan.limits.shown, strict=True))
    place, letters = np.array(factors) * plan.course.position, plan.limits.letters
    # `reshape` gives a table even without a stop.
    stood = np.array([stop.position for stop in plan.stops[:_MARKED_STOPS]]).reshape(-1, len(letters))
    stops = stood * factors
    if plan.kinematics is not None:
        letters, units = LINEAR, ["mm"] * 3
        place, stops = 1e3 * plan.tips, 1e3 * plan.tips_of(stood)
    # One axis makes no path to draw.
    if len(letters) == 1:
        along = Curve(plan.course.time, place[:, 0])
        return Chart("time (s)", (Panel(f"{letters} ({units[0]})", (along,)),))
    extent = np.ptp(place, axis=0)
    order = sorted(range(len(letters)), key=lambda i: (extent[i] <= _FLAT * extent.max(), i))
    views = [(order[0], order[1])]
    if len(letters) > 2 and extent[order[2]] > _FLAT * extent.max():
        views.append((order[0], order[2]))
    # Equal scales of both axes would make a flat path a line and a high one a page.
    shapes = [max(0.12, min(0.8, extent[j] / max(extent[i], 1e-9))) for i, j in views]
    panels = list[Panel]()
    for (i, j), shape in zip(views, shapes, strict=True):
        curves = curves_of(plan, place[:, i], place[:, j])
        if len(stops):
            curves.append(Curve(stops[:, i], stops[:, j], "stop", chart.NEUTRAL, chart.RING, size=0.8))
        abscissa = Abscissa(f"{letters[i]} ({units[i]})", square=True)
        panels.append(Panel(f"{letters[j]} ({units[j]})", tuple(curves), share=shape, abscissa=abscissa))
    return Chart("", tuple(panels), height=0.6 + 0.92 * chart.WIDTH * sum(shapes) * 0.9)


def _path(plan: Planned, x: np.ndarray, y: np.ndarray) -> list[Curve]:
    """Return one curve for each speed class, with gaps where the speed belongs to another class."""
    course = plan.course
    traverse = np.isinf(course.feed)
    speed = 1e3 * course.speed
    # without traverses, which are so fast that all of the cut would have one color
    top = float(np.max(speed[~traverse], initial=0.0)) or float(np.max(speed, initial=0.0)) or 1.0
    edges = np.linspace(0.0, top, len(_SPEEDS) + 1)
    kind = np.clip(np.searchsorted(edges, speed, side="left") - 1, 0, len(_SPEEDS) - 1)
    kind[traverse] = -1
    curves = list[Curve]()
    if np.any(traverse):
        curves.append(Curve(*_stretches(x, y, traverse), "traverse", chart.NEUTRAL, chart.DASHED, size=0.5))
    for k, (number, size) in enumerate(_SPEEDS):
        if np.any(kind == k):
            low, high = Quantity(1e-3 * edges[k], "m/s", bare=True), Quantity(1e-3 * edges[k + 1], "m/s")
            stretches = _stretches(x, y, kind == k)
            curves.append(
                Curve(*stretches, number=number, look=chart.PLAIN, caption=Text(f"{low:3} to {high:3}"), size=size)
            )
    return curves


def _lost(plan: Planned, x: np.ndarray, y: np.ndarray) -> list[Curve]:
    """Return a curve for each cause of falls of the feed, the largest loss first, and one for the path at the feed."""
    loss = plan.loss
    cause = loss.cause[np.searchsorted(loss.time, plan.course.time, side="right") - 1]
    sums = dict.fromkeys(loss.names, 0.0)
    for row in loss.causes:
        sums[row.cause] += row.lost
    order = sorted(range(1, len(loss.names)), key=lambda k: -sums[loss.names[k]])
    shown, rest = order[: len(_CAUSE_NUMBERS)], order[len(_CAUSE_NUMBERS) :]
    curves = list[Curve]()
    if np.any(cause == 0):
        curves.append(Curve(*_stretches(x, y, cause == 0), "at the feed", chart.NEUTRAL, chart.PLAIN, size=0.5))
    for k, number in zip(shown, _CAUSE_NUMBERS, strict=False):
        caption = Text(f"{loss.names[k]}: {Quantity(sums[loss.names[k]], 's'):3 SI}")
        curves.append(Curve(*_stretches(x, y, cause == k), number=number, look=chart.PLAIN, caption=caption, size=1.4))
    if rest:
        caption = Text(f"others: {Quantity(sum(sums[loss.names[k]] for k in rest), 's'):3 SI}")
        there = np.isin(cause, rest)
        curves.append(Curve(*_stretches(x, y, there), number=3, look=chart.PLAIN, caption=caption, size=1.4))
    return curves


def _stretches(x: np.ndarray, y: np.ndarray, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the chosen parts of a path, each extended to the start of the next one, with gaps between them."""
    there = chosen | np.concatenate([[False], chosen[:-1]])
    return np.where(there, x, np.nan), np.where(there, y, np.nan)


def plan_causes_chart(plan: Planned) -> Chart:
    """Plot the active limit versus time, with one row per limit and its share of the cycle time."""
    course = plan.course
    cause = causes(np.maximum(np.abs(course.low), np.abs(course.high)) / plan.limits.array, course.speed, course.feed)
    names = plan.limits.causes
    lengths = np.diff(np.append(course.time, plan.cycle_time))
    edges = np.linspace(0.0, max(plan.cycle_time, 1e-9), _COLUMNS + 1)
    column = np.clip(np.searchsorted(edges, course.time + 0.5 * lengths, side="right") - 1, 0, _COLUMNS - 1)
    whole = np.bincount(column, weights=lengths, minlength=_COLUMNS)
    # a limit that acts for less than 0.2 % of the time leaves an empty row
    shown = [name for name in names if plan.seconds.get(name, 0.0) > 2e-3 * plan.cycle_time]
    shown.sort(key=lambda name: -plan.seconds[name])
    curves, levels, ticks = list[Curve](), list[Level](), list[Tick]()
    for row, name in enumerate(shown):
        here = cause == names.index(name)
        part = np.bincount(column[here], weights=lengths[here], minlength=_COLUMNS) / np.maximum(whole, 1e-12)
        shape = chart.filled_stairs(edges, 0.8 * part, -float(row))
        curves.append(Curve(*shape, number=_cause_number(name), look=chart.SOLID))
        levels.append(Level(-float(row), faint=True))
        share = Text(f"{Quantity(plan.seconds[name] / plan.cycle_time, 'share'):3}")
        ticks.append(Tick(0.4 - row, name, share))
    rows = max(len(shown), 1)
    panel = Panel("", tuple(curves), levels=tuple(levels), ticks=tuple(ticks), low=0.1 - rows, high=1.0)
    return Chart("time (s)", (panel,), low=0.0, high=float(edges[-1]), height=0.8 + 0.34 * rows)


plan_causes = figure_of(plan_causes_chart)


def _cause_number(name: str) -> int:
    """Return the number of the curve whose color marks a cause."""
    what = name.split(" ")[0]
    if what in DERIVATIVES:
        return (5, 0, 1, 4)[DERIVATIVES.index(what)]
    return 2 if name == FEED else chart.NEUTRAL if name == STANDSTILL else 3


def plan_profiles_chart(plan: Planned, axis: int) -> Chart:
    """Plot the velocity to snap of an axis versus time: the limits, and the minimum and maximum of each interval."""
    course, limits, units = plan.course, plan.limits.array[axis], _UNITS[plan.limits.shown[axis][1]]
    begins = np.unique(np.linspace(0, len(course.time), min(len(course.time), _COLUMNS) + 1).astype(int)[:-1])
    edges = np.append(course.time[begins], plan.cycle_time)
    panels = list[Panel]()
    for k, (name, (unit, factor)) in enumerate(zip(DERIVATIVES, units, strict=True)):
        low = factor * np.minimum.reduceat(course.low[:, axis, k], begins)
        high = factor * np.maximum.reduceat(course.high[:, axis, k], begins)
        x = np.repeat(edges, 2)[1:-1]
        low, high = np.repeat(low, 2), np.repeat(high, 2)
        shape = Curve(np.concatenate([x, x[::-1]]), np.concatenate([high, low[::-1]]), look=chart.SOLID)
        # an interval with a single value has no area
        lines = Curve(x, high, look=chart.PLAIN, size=0.6), Curve(x, low, look=chart.PLAIN, size=0.6)
        top = factor * limits[k]
        used = max(-float(low.min()), float(high.max()))
        # a limit far above the curve would flatten it
        within = used > 0.2 * top
        sides = tuple(Level(side, dashed=True, number=chart.ALERT) for side in (-top, top)) if within else ()
        bottom, upper = style.padded(*((-top, top) if within else (-used, used)))
        caption = (
            Text(f"{Quantity(plan.proof.use[axis, k], 'share'):3} of {Quantity(top, unit)}")
            if np.isfinite(top)
            else Text("no limit")
        )
        panels.append(
            Panel(f"{name}\n({unit})", (shape, *lines), levels=sides, low=bottom, high=upper, caption=caption)
        )
    return Chart("time (s)", tuple(panels), low=float(edges[0]), high=float(edges[-1]), height=6.2)


plan_profiles = figure_of(plan_profiles_chart)


def plan_feed_chart(plan: Planned) -> Chart:
    """Plot the path speed versus time under the programmed feed, and between both what each cause takes of it."""
    course, loss = plan.course, plan.loss
    begins = np.unique(np.linspace(0, len(course.time), min(len(course.time), POINTS // 2) + 1).astype(int)[:-1])
    time, minutes = course.time[begins], 6e4
    # the lowest speed of each interval: a dip may be shorter than a pixel
    speed = minutes * np.minimum.reduceat(course.speed, begins)
    feed = minutes * np.maximum.reduceat(np.where(np.isfinite(course.feed), course.feed, 0.0), begins)
    feed = np.where(feed > 0.0, feed, np.nan)
    cause = loss.cause[np.searchsorted(loss.time, time, side="right") - 1]
    sums = dict.fromkeys(loss.names, 0.0)
    for row in loss.causes:
        sums[row.cause] += row.lost
    order = sorted(range(1, len(loss.names)), key=lambda k: -sums[loss.names[k]])
    bands = list[Band]()
    for k, number in zip(order, _CAUSE_NUMBERS, strict=False):
        # one interval more, so that the area reaches the next one
        here = cause == k
        here |= np.append(False, here[:-1])
        low, high = (np.where(here, values, np.nan) for values in (speed, np.fmax(speed, feed)))
        bands.append(Band(time, low, high, number, loss.names[k]))
    curves = Curve(time, feed, "programmed feed", chart.NEUTRAL, chart.THIN), Curve(time, speed, "speed of the path")
    top, fastest = float(np.nanmax(feed, initial=0.0)), float(np.max(speed, initial=0.0))
    # a traverse would flatten all that is cut
    faster = top > 0.0 and fastest > _ABOVE * top
    caption = Text(f"traverses up to {Quantity(fastest / minutes, 'm/s', form='2 m/min')}") if faster else ""
    high = _ABOVE * top if top > 0.0 else None
    return Chart("time (s)", (Panel("feed (mm/min)", curves, bands=tuple(bands), low=0.0, high=high, caption=caption),))


plan_feed = figure_of(plan_feed_chart)


def plan_axes_chart(plan: Planned) -> Chart:
    """Plot the positions of the axes versus time with their travel, linear and rotary ones, and the largest share that
    each axis uses of its limits of velocity to snap.
    """
    course, letters = plan.course, plan.limits.letters
    place = course.position * [factor for factor, _ in plan.limits.shown]
    travel = {
        letter: (float(axis.travel_least), float(axis.travel_most))
        for letter, axis in plan.limits.axes.items()
        if axis.travel_least is not None and axis.travel_most is not None
    }
    panels = list[Panel]()
    for unit in ("mm", "deg"):
        columns = [k for k, (_, of) in enumerate(plan.limits.shown) if of == unit]
        if not columns:
            continue
        curves = [Curve(*envelope(course.time, place[:, k]), letters[k], k) for k in columns]
        low, high = style.padded(float(np.min(place[:, columns])), float(np.max(place[:, columns])))
        ends = {k: travel.get(letters[k]) for k in columns}
        levels = [
            Level(side * plan.limits.shown[k][0], f"end of {letters[k]}", dashed=True, number=chart.ALERT)
            for k, between in ends.items()
            for side in between or ()
        ]
        used = ", ".join(
            f"{letters[k]} {Quantity(_of_travel(place[:, k], between, plan.limits.shown[k][0]), 'share'):2}"
            for k, between in ends.items()
            if between is not None
        )
        caption = Text(f"of the travel: {used}") if used else ""
        label = f"{'linear' if unit == 'mm' else 'rotary'} ({unit})"
        near = tuple(level for level in levels if low <= level.value <= high)
        panels.append(Panel(label, tuple(curves), levels=near, low=low, high=high, caption=caption))
    with np.errstate(invalid="ignore"):
        use = 100.0 * np.max(np.maximum(np.abs(course.low), np.abs(course.high)) / plan.limits.array, axis=2)
    begins = np.unique(np.linspace(0, len(course.time), min(len(course.time), _COLUMNS) + 1).astype(int)[:-1])
    most = np.maximum.reduceat(use, begins)
    curves = tuple(Curve(course.time[begins], most[:, k], "", k, chart.PLAIN) for k in range(len(letters)))
    full = Level(100.0, dashed=True, number=chart.ALERT)
    panels.append(Panel("limit in use (%)", curves, levels=(full,), low=0.0, high=108.0))
    return Chart("time (s)", tuple(panels), height=6.0)


plan_axes = figure_of(plan_axes_chart)


def _of_travel(place: np.ndarray, between: tuple[float, float], factor: float) -> float:
    """Return the share of a travel that positions use."""
    return float(np.ptp(place)) / max(factor * (between[1] - between[0]), 1e-12)


def plan_joints_chart(plan: Planned) -> Chart:
    """Plot the tilt of the tool, the rotary and the linear joints versus time, while the tip of the tool is moved."""
    assert plan.kinematics is not None
    time, letters = plan.course.time, plan.limits.letters
    place = plan.course.position * [factor for factor, _ in plan.limits.shown]
    panels = [Panel("tilt of the tool\n(deg)", (Curve(*envelope(time, np.degrees(plan.tilts))),))]
    panels += [
        Panel(f"{letter}\n(deg)", (Curve(*envelope(time, place[:, letters.index(letter)])),))
        for letter in plan.kinematics.rotary_letters
    ]
    curves = (Curve(*envelope(time, place[:, letters.index(letter)]), letter, k) for k, letter in enumerate(LINEAR))
    panels.append(Panel(f"joints\n({unit_name('mm')})", tuple(curves), share=1.5))
    return Chart("time (s)", tuple(panels), height=6.6)


plan_joints = figure_of(plan_joints_chart)


_WINDOW = 0.15  # s: window of the estimates
_BEFORE, _AFTER = 0.04, 0.1  # s: range before and after the worst instant
_SIZES = ("RMS", "95 % of the path", "largest")


def part_run_chart(part: PartRun) -> Chart:
    """Plot the contour error versus time, in gray where it is not evaluated."""
    contour = part.contour
    error = 1e6 * np.abs(contour.error)
    curves = (
        Curve(*envelope(contour.time, error), "does not count", chart.NEUTRAL, chart.THIN),
        Curve(*envelope(contour.time, np.where(contour.counted, error, 0.0)), "counts"),
    )
    caption = Text(f"RMS {Quantity(contour.rms, 'm')}, largest {Quantity(contour.largest, 'm')}")
    return Chart("time (s)", (Panel(f"contour error ({unit_name('um')})", curves, caption=caption),))


part_run = figure_of(part_run_chart)


def tip_error_chart(tip: TipError) -> Chart:
    """Plot the contour error of the tip, its error along the path and that of the direction of the tool versus time, on
    the samples that count.
    """
    time, counted = tip.contour.time, tip.contour.counted
    along, across = (Quantity(tip.peak(values), "m", form="3") for values in (tip.along, tip.contour.error))
    direction = Quantity(tip.peak(tip.direction), "rad", form="3 urad", stays=True)
    rows = (
        (f"across\n({unit_name('um')})", 1e6 * np.abs(tip.contour.error), across),
        (f"along\n({unit_name('um')})", 1e6 * tip.along, along),
        ("direction\n(µrad)", 1e6 * tip.direction, direction),
    )
    panels = tuple(
        Panel(
            label,
            (Curve(*envelope(time, np.where(counted, values, 0.0)), number=k, look=chart.PLAIN, size=0.7),),
            levels=(Level(0.0, faint=True),),
            caption=Text(f"largest {largest}"),
        )
        for k, (label, values, largest) in enumerate(rows)
    )
    return Chart("time (s)", panels, height=5.6)


tip_error = figure_of(tip_error_chart)


def tip_joints_chart(tip: TipError) -> Chart:
    """Plot the part of each joint in the contour error of the tip versus time, one panel for each joint."""
    time, counted = tip.contour.time, tip.contour.counted
    added = 1e6 * np.where(counted, tip.added, 0.0)
    low, high = style.padded(*_ends(added))
    panels = tuple(
        Panel(
            f"{joint.letter}\n({unit_name('um')})",
            (Curve(*envelope(time, added[k], POINTS // 2), number=k, look=chart.PLAIN, size=0.7),),
            levels=(Level(0.0, faint=True),),
            low=low,
            high=high,
            caption=Text(
                f"{Quantity(joint.share, 'share'):3} of the contour error"
                + ("" if joint.lever is None else f"; lever arm up to {Quantity(joint.lever, 'm', form='3 mm')}")
            ),
        )
        for k, joint in enumerate(tip.joints)
    )
    return Chart("time (s)", panels, height=7.6)


tip_joints = figure_of(tip_joints_chart)


def part_laws_chart(parts: Mapping[str, PartRun]) -> Chart:
    """Plot RMS, 95 % quantile and maximum of the contour error for each law, one row per law, on a logarithmic
    scale.
    """
    sizes = np.array([(part.contour.rms, part.contour.within(), part.contour.largest) for part in parts.values()])
    # the scale is logarithmic: an error of 0 needs a value
    rows, shown = -np.arange(len(parts), dtype=np.float64), 1e6 * np.maximum(sizes, 1e-12)
    spans = tuple(
        Curve(np.array([row.min(), row.max()]), np.full(2, y), number=chart.NEUTRAL, look=chart.WIDE)
        for row, y in zip(shown, rows, strict=True)
    )
    dots = tuple(Curve(shown[:, k], rows, name, k, chart.MARKERS, size=1.4) for k, name in enumerate(_SIZES))
    panel = Panel("", (*spans, *dots), ticks=chart.listed(list(parts)), low=float(rows[-1]) - 0.6, high=0.6)
    return Chart(
        f"contour error ({unit_name('um')})",
        (panel,),
        chart.LOG,
        0.7 * float(shown.min()),
        1.5 * float(shown.max()),
        height=1.1 + 0.36 * len(parts),
    )


part_laws = figure_of(part_laws_chart)


def part_cutting_chart(part: PartRun) -> Chart:
    """Plot the cutting force on each axis versus time."""
    assert part.cutting is not None
    panels = tuple(
        Panel(
            f"on {name} ({unit_name('N')})",
            (
                Curve(
                    *envelope(part.contour.time, part.cutting[:, i], POINTS // 2), number=i, look=chart.PLAIN, size=0.6
                ),
            ),
        )
        for i, name in enumerate(part.contour.axes)
    )
    return Chart("time (s)", panels, height=0.9 + 1.15 * len(panels))


part_cutting = figure_of(part_cutting_chart)


def part_estimates_chart(part: PartRun, axis: str) -> Chart:
    """Plot the disturbance of an axis and its observer estimates in the 150 ms with the largest RMS cutting force."""
    time, true = part.contour.time, part.disturbances[axis]
    middle = _busiest(part, axis)
    shown = (time >= middle - 0.5 * _WINDOW) & (time <= middle + 0.5 * _WINDOW)
    curves = [Curve(1e3 * time[shown], true[shown], "what acts", chart.NEUTRAL, chart.WIDE, size=0.5)]
    for i, (name, by) in enumerate(part.estimates.items()):
        if axis in by:
            late = Text(f"{Quantity(by[axis].lag, 's'):3} late")
            values = by[axis].disturbance[shown]
            curves.append(Curve(1e3 * time[shown], values, name.replace("_", " "), i, caption=late))
    panel = Panel(f"force on {axis} ({unit_name('N')})", tuple(curves))
    return Chart("time (ms)", (panel,), height=3.4, columns=2)


part_estimates = figure_of(part_estimates_chart)


def _busiest(part: PartRun, axis: str) -> float:
    """Return the center of the window with the largest RMS cutting force on an axis, s."""
    assert part.cutting is not None
    time = part.contour.time
    square = part.cutting[:, part.contour.axes.index(axis)] ** 2
    width = max(1, min(len(time) - 1, round(_WINDOW / (time[1] - time[0]))))
    # the mean square of all windows by differences of one cumulative sum
    total = np.cumsum(np.insert(square, 0, 0.0))
    return float(time[int(np.argmax(total[width:] - total[:-width])) + width // 2])


def part_zoom_chart(parts: Mapping[str, PartRun], time: float) -> Chart:
    """Plot the contour error of each law in µm around an instant, versus the time relative to this instant in ms."""
    curves = list[Curve]()
    for k, (name, part) in enumerate(parts.items()):
        at = part.contour.time
        shown = (at >= time - _BEFORE) & (at <= time + _AFTER)
        curves.append(Curve(1e3 * (at[shown] - time), 1e6 * np.abs(part.contour.error[shown]), name, k))
    panel = Panel(f"contour error ({unit_name('um')})", tuple(curves))
    return Chart("time after the worst instant (ms)", (panel,), height=3.4, columns=3)


part_zoom = figure_of(part_zoom_chart)


def corrected_chart(result: CorrectedProgram) -> Chart:
    """Plot the deviation from the path without and with a correction, on the nominal and the worst machine."""
    T = result.correction.sample_time
    figures = {plant.name: plant for plant in result.plants}
    panels = list[Panel]()
    for place, (name, errors) in enumerate(result.errors.items()):
        plain, corrected = (Quantity(of.rms, "m") for of in (figures[name].plain, figures[name].corrected))
        # both panels have the curves of the first one
        labels = ("without", "with the correction") if place == 0 else ("", "")
        curves = (
            Curve(*_sizes(errors[key], T), label, number, chart.PLAIN)
            for number, (key, label) in enumerate(zip(("plain", "corrected"), labels, strict=True))
        )
        of = f"{name}: " if place else ""
        panels.append(
            Panel(
                f"{'worst' if place else name}\n({unit_name('um')})",
                tuple(curves),
                low=0.0,
                caption=Text(f"{of}RMS {plain} without, {corrected} with"),
            )
        )
    return Chart("time (s)", tuple(panels), height=2.6 * len(panels))


corrected = figure_of(corrected_chart)


def corrected_path_chart(result: CorrectedProgram, machine: str, *, corrected: bool) -> Chart:
    """Plot the planned path in mm, colored by the size of the deviation, um, without or with a correction.

    machine  one of `result.errors`: the nominal or the worst machine of the box

    The two axes that move most span the picture.  All pictures of a result have one color scale, whose end is the
    largest deviation on any of them.  Parts of the path that do not count are omitted.
    """
    size = result.errors[machine]["corrected" if corrected else "plain"]
    most = max(float(np.nanmax(row)) for errors in result.errors.values() for row in errors.values())
    plan = result.correction.plan
    x, y = sorted(sorted(plan, key=lambda axis: -float(np.ptp(plan[axis].position)))[:2], key=list(plan).index)
    rows = envelope(np.arange(size.size, dtype=np.float64), np.nan_to_num(size), _POINTS)[0].astype(np.intp)
    heat = 1e6 * size[rows]
    (across, up) = (np.where(np.isfinite(heat), 1e3 * plan[axis].position[rows], np.nan) for axis in (x, y))
    (left, right), (low, high) = (style.padded(*_ends(values)) for values in (across, up))
    shape = max(0.35, min(1.0, (high - low) / (right - left)))
    plant = next(plant for plant in result.plants if plant.name == machine)
    figures = plant.corrected if corrected else plant.plain
    caption = Text(f"largest {Quantity(figures.largest, 'm')}, RMS {Quantity(figures.rms, 'm')}")
    scale = Heat(f"contour error ({unit_name('um')})", 0.0, max(1e6 * most, 1e-9))
    panel = Panel(
        f"{y} ({unit_name('mm')})", (Curve(across, up, heat=heat),), low=low, high=high, caption=caption, heat=scale
    )
    height = 0.8 + 0.75 * chart.WIDTH * shape
    return Chart(f"{x} ({unit_name('mm')})", (panel,), low=left, high=right, square=True, height=height)


corrected_path = figure_of(corrected_path_chart)


def learned_chart(learned: LearnedPart) -> Chart:
    """Plot the deviation from the path in the log of a part."""
    rms = Quantity(learned.figures.rms, "m")
    curve = Curve(*_sizes(learned.error, learned.correction.sample_time))
    panel = Panel(f"deviation from the path\n({unit_name('um')})", (curve,), low=0.0, caption=Text(f"RMS {rms}"))
    return Chart("time (s)", (panel,), height=3.0)


learned = figure_of(learned_chart)


def _sizes(error: np.ndarray, T: float) -> tuple[np.ndarray, np.ndarray]:
    """Return time and size of a deviation, um, as an envelope with a gap where no sample counts."""
    n = error.size
    long = max(1, -(-n // POINTS))
    rows = np.append(np.abs(error), np.full(-n % long, np.nan)).reshape(-1, long)
    counted = np.any(np.isfinite(rows), axis=1)
    largest = np.max(np.where(np.isfinite(rows), rows, -np.inf), axis=1)
    return np.arange(len(rows)) * long * T, 1e6 * np.where(counted, largest, np.nan)

"""Pictures of a plan: the path with its speed, the most used limit over time, and the profiles of each axis."""

from __future__ import annotations

import numpy as np

from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.path.limits import FEED, STANDSTILL
from feeddrive.path.planned import Planned
from feeddrive.path.proof.prove import DERIVATIVES
from feeddrive.path.setpoints import causes
from feeddrive.plot import style
from feeddrive.plot.chart import (
    ALERT,
    DASHED,
    NEUTRAL,
    PLAIN,
    RING,
    SOLID,
    WIDTH,
    Abscissa,
    Chart,
    Curve,
    Level,
    Panel,
    Tick,
    filled_stairs,
)
from feeddrive.plot.drawing import figure_of

# from slow to fast: warm to cold, and thinner, so that gray print shows it too; number of the color, and width
_SPEEDS = ((ALERT, 1.85), (1, 1.6), (4, 1.3), (2, 1.1), (5, 0.95), (0, 0.8))
_COLUMNS = 400  # stretches of time over the width of a picture
_FLAT = 0.02  # of the largest extent: an axis that moves less gets no view of its own
_MARKED = 300  # stops
_UNITS = {
    "mm": (("mm/s", 1e3), ("m/s²", 1.0), ("m/s³", 1.0), ("m/s⁴", 1.0)),
    "deg": (("deg/s", float(np.degrees(1.0))), ("rad/s²", 1.0), ("rad/s³", 1.0), ("rad/s⁴", 1.0)),
}


def planned_chart(plan: Planned) -> Chart:
    """The path with its speed as color, and the stops; a second view where a third axis moves."""
    factors, units = (list(row) for row in zip(*plan.limits.shown, strict=True))
    place, letters = np.array(factors) * plan.course.position, plan.limits.letters
    if len(letters) == 1:
        along = Curve(plan.course.time, place[:, 0])
        return Chart("time (s)", (Panel(f"{letters} ({units[0]})", (along,)),))
    extent = np.ptp(place, axis=0)
    order = sorted(range(len(letters)), key=lambda i: (extent[i] <= _FLAT * extent.max(), i))
    views = [(order[0], order[1])]
    if len(letters) > 2 and extent[order[2]] > _FLAT * extent.max():
        views.append((order[0], order[2]))
    shapes = [max(0.12, min(0.8, extent[j] / max(extent[i], 1e-9))) for i, j in views]
    stops = np.array([stop.position * factors for stop in plan.stops[:_MARKED]]).reshape(-1, len(letters))
    panels = list[Panel]()
    for (i, j), shape in zip(views, shapes, strict=True):
        curves = _path(plan, place[:, i], place[:, j])
        if len(stops):
            curves.append(Curve(stops[:, i], stops[:, j], "stop", NEUTRAL, RING, size=0.8))
        abscissa = Abscissa(f"{letters[i]} ({units[i]})", square=True)
        panels.append(Panel(f"{letters[j]} ({units[j]})", tuple(curves), share=shape, abscissa=abscissa))
    return Chart("", tuple(panels), height=0.6 + 0.92 * WIDTH * sum(shapes) * 0.9)


planned = figure_of(planned_chart)


def _path(plan: Planned, x: np.ndarray, y: np.ndarray) -> list[Curve]:
    """One curve for each class of speed, with gaps where others are."""
    course = plan.course
    traverse = np.isinf(course.feed)
    speed = 1e3 * course.speed
    top = float(np.max(speed[~traverse], initial=0.0)) or float(np.max(speed, initial=0.0)) or 1.0
    edges = np.linspace(0.0, top, len(_SPEEDS) + 1)
    kind = np.clip(np.searchsorted(edges, speed, side="left") - 1, 0, len(_SPEEDS) - 1)
    kind[traverse] = -1
    curves = list[Curve]()
    if np.any(traverse):
        curves.append(Curve(*_stretches(x, y, traverse), "traverse", NEUTRAL, DASHED, size=0.5))
    for k, (number, size) in enumerate(_SPEEDS):
        if np.any(kind == k):
            low, high = Quantity(1e-3 * edges[k], "m/s", bare=True), Quantity(1e-3 * edges[k + 1], "m/s")
            stretches = _stretches(x, y, kind == k)
            curves.append(Curve(*stretches, number=number, look=PLAIN, caption=Text(f"{low:3} to {high:3}"), size=size))
    return curves


def _stretches(x: np.ndarray, y: np.ndarray, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The chosen stretches, each up to the begin of the next one, with gaps between."""
    there = chosen | np.concatenate([[False], chosen[:-1]])
    return np.where(there, x, np.nan), np.where(there, y, np.nan)


def plan_causes_chart(plan: Planned) -> Chart:
    """The most used limit over time: a row for each limit, with its share of the cycle time."""
    course = plan.course
    cause = causes(np.maximum(np.abs(course.low), np.abs(course.high)) / plan.limits.array, course.speed, course.feed)
    names = plan.limits.causes
    lengths = np.diff(np.append(course.time, plan.cycle_time))
    edges = np.linspace(0.0, max(plan.cycle_time, 1e-9), _COLUMNS + 1)
    column = np.clip(np.searchsorted(edges, course.time + 0.5 * lengths, side="right") - 1, 0, _COLUMNS - 1)
    whole = np.bincount(column, weights=lengths, minlength=_COLUMNS)
    shown = [name for name in names if plan.seconds.get(name, 0.0) > 2e-3 * plan.cycle_time]
    shown.sort(key=lambda name: -plan.seconds[name])
    curves, levels, ticks = list[Curve](), list[Level](), list[Tick]()
    for row, name in enumerate(shown):
        here = cause == names.index(name)
        part = np.bincount(column[here], weights=lengths[here], minlength=_COLUMNS) / np.maximum(whole, 1e-12)
        shape = filled_stairs(edges, 0.8 * part, -float(row))
        curves.append(Curve(*shape, number=_cause_number(name), look=SOLID))
        levels.append(Level(-float(row), faint=True))
        share = Text(f"{Quantity(plan.seconds[name] / plan.cycle_time, 'share'):3}")
        ticks.append(Tick(0.4 - row, name, share))
    rows = max(len(shown), 1)
    panel = Panel("", tuple(curves), levels=tuple(levels), ticks=tuple(ticks), low=0.1 - rows, high=1.0)
    return Chart("time (s)", (panel,), low=0.0, high=float(edges[-1]), height=0.8 + 0.34 * rows)


plan_causes = figure_of(plan_causes_chart)


def _cause_number(name: str) -> int:
    """The number of the curve whose color a cause has."""
    what = name.split(" ")[0]
    if what in DERIVATIVES:
        return (5, 0, 1, 4)[DERIVATIVES.index(what)]
    return 2 if name == FEED else NEUTRAL if name == STANDSTILL else 3


def plan_profiles_chart(plan: Planned, axis: int) -> Chart:
    """Velocity to snap of an axis over time, from the least to the most of each stretch, with its limits."""
    course, limits, units = plan.course, plan.limits.array[axis], _UNITS[plan.limits.shown[axis][1]]
    begins = np.unique(np.linspace(0, len(course.time), min(len(course.time), _COLUMNS) + 1).astype(int)[:-1])
    edges = np.append(course.time[begins], plan.cycle_time)
    panels = list[Panel]()
    for k, (name, (unit, factor)) in enumerate(zip(DERIVATIVES, units, strict=True)):
        low = factor * np.minimum.reduceat(course.low[:, axis, k], begins)
        high = factor * np.maximum.reduceat(course.high[:, axis, k], begins)
        x = np.repeat(edges, 2)[1:-1]
        low, high = np.repeat(low, 2), np.repeat(high, 2)
        shape = Curve(np.concatenate([x, x[::-1]]), np.concatenate([high, low[::-1]]), look=SOLID)
        # a stretch of one value has no area
        lines = Curve(x, high, look=PLAIN, size=0.6), Curve(x, low, look=PLAIN, size=0.6)
        top = factor * limits[k]
        used = max(-float(low.min()), float(high.max()))
        within = used > 0.2 * top
        sides = tuple(Level(side, dashed=True, number=ALERT) for side in (-top, top)) if within else ()
        bottom, upper = style.padded(*((-top, top) if within else (-used, used)))
        caption = Text(f"{Quantity(plan.proof.use[axis, k], 'share'):3} of {Quantity(top, unit)}")
        panels.append(
            Panel(f"{name}\n({unit})", (shape, *lines), levels=sides, low=bottom, high=upper, caption=caption)
        )
    return Chart("time (s)", tuple(panels), low=float(edges[0]), high=float(edges[-1]), height=6.2)


plan_profiles = figure_of(plan_profiles_chart)

"""Pictures of a plan: the path with its speed, which limit holds it back when, and the course of each axis."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.path.limits import FEED, STANDSTILL
from feeddrive.path.planned import Planned
from feeddrive.path.proof.prove import DERIVATIVES
from feeddrive.path.setpoints import causes
from feeddrive.plot import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# from slow to fast: warm to cold, and thinner, so that gray print shows it too
_SPEEDS = (style.ALERT, style.COLORS[1], style.COLORS[4], style.COLORS[2], style.COLORS[5], style.COLORS[0])
_WIDTHS = (2.6, 2.2, 1.8, 1.5, 1.3, 1.1)
_COLUMNS = 400  # stretches of time over the width of a picture
_FLAT = 0.02  # of the largest extent: an axis that moves less gets no view of its own
_MARKED = 300  # stops
_UNITS = {
    "mm": (("mm/s", 1e3), ("m/s²", 1.0), ("m/s³", 1.0), ("m/s⁴", 1.0)),
    "deg": (("deg/s", float(np.degrees(1.0))), ("rad/s²", 1.0), ("rad/s³", 1.0), ("rad/s⁴", 1.0)),
}
_LIMIT = (0, (5, 2))


def planned(plan: Planned) -> Any:
    """The path with its speed as color, and the stops; a second view where a third axis moves."""
    factors, units = (list(each) for each in zip(*plan.limits.shown, strict=True))
    place, letters = np.array(factors) * plan.course.position, plan.limits.letters
    if len(letters) == 1:
        return _along(plan)
    extent = np.ptp(place, axis=0)
    order = sorted(range(len(letters)), key=lambda i: (extent[i] <= _FLAT * extent.max(), i))
    views = [(order[0], order[1])]
    if len(letters) > 2 and extent[order[2]] > _FLAT * extent.max():
        views.append((order[0], order[2]))
    shapes = [max(0.12, min(0.8, extent[j] / max(extent[i], 1e-9))) for i, j in views]
    figure, axes = style.picture(
        len(views), height=0.6 + 0.92 * style.WIDTH * sum(shapes) * 0.9, ratios=shapes, share=False
    )
    for ax, (i, j) in zip(axes, views, strict=True):
        _path(ax, plan, place[:, i], place[:, j])
        stops = np.array([each.position * factors for each in plan.stops[:_MARKED]]).reshape(-1, len(letters))
        if len(stops):
            ax.plot(stops[:, i], stops[:, j], "o", color=style.INK, fillstyle="none", markersize=4.5, label="stop")
        ax.set_aspect("equal", adjustable="datalim")
        ax.margins(0.04)
        style.labels(ax, f"{letters[i]} ({units[i]})", f"{letters[j]} ({units[j]})")
    style.legend(figure, axes[0])
    return figure


def _path(ax: Axes, plan: Planned, x: np.ndarray, y: np.ndarray) -> None:
    """One curve for each class of speed, with gaps where others are."""
    course = plan.course
    traverse = np.isinf(course.feed)
    speed = 1e3 * course.speed
    top = float(np.max(speed[~traverse], initial=0.0)) or float(np.max(speed, initial=0.0)) or 1.0
    edges = np.linspace(0.0, top, len(_SPEEDS) + 1)
    kind = np.clip(np.searchsorted(edges, speed, side="left") - 1, 0, len(_SPEEDS) - 1)
    kind[traverse] = -1
    if np.any(traverse):
        _gapped(ax, x, y, traverse, color=style.MUTED, linewidth=0.9, linestyle=(0, (2, 2)), label="traverse")
    for k, (color, width) in enumerate(zip(_SPEEDS, _WIDTHS, strict=True)):
        if np.any(kind == k):
            low, high = Quantity(1e-3 * edges[k], "m/s", bare=True), Quantity(1e-3 * edges[k + 1], "m/s")
            label = style.read(f"{low:3} to {high:3}")
            _gapped(ax, x, y, kind == k, color=color, linewidth=width, label=label, solid_capstyle="round")


def _gapped(ax: Axes, x: np.ndarray, y: np.ndarray, chosen: np.ndarray, **how: Any) -> None:
    """The chosen stretches, each drawn up to the begin of the next one."""
    drawn = chosen | np.concatenate([[False], chosen[:-1]])
    ax.plot(np.where(drawn, x, np.nan), np.where(drawn, y, np.nan), **how)


def _along(plan: Planned) -> Any:
    """The position of a single axis over time."""
    figure, (ax,) = style.picture()
    factor, unit = plan.limits.shown[0]
    ax.plot(plan.course.time, factor * plan.course.position[:, 0], **style.curve(0))
    style.labels(ax, "time (s)", f"{plan.limits.letters} ({unit})")
    return figure


def plan_causes(plan: Planned) -> Any:
    """Which limit is used most, over time: a row for each, and the whole cycle time by cause at the right."""
    course = plan.course
    found = causes(np.maximum(np.abs(course.low), np.abs(course.high)) / plan.limits.array, course.speed, course.feed)
    names = plan.limits.causes
    lengths = np.diff(np.append(course.time, plan.cycle_time))
    edges = np.linspace(0.0, max(plan.cycle_time, 1e-9), _COLUMNS + 1)
    column = np.clip(np.searchsorted(edges, course.time + 0.5 * lengths, side="right") - 1, 0, _COLUMNS - 1)
    whole = np.bincount(column, weights=lengths, minlength=_COLUMNS)
    shown = [name for name in names if plan.seconds.get(name, 0.0) > 2e-3 * plan.cycle_time]
    shown.sort(key=lambda name: -plan.seconds[name])
    figure, (ax,) = style.picture(height=0.8 + 0.34 * max(len(shown), 1))
    for row, name in enumerate(shown):
        here = found == names.index(name)
        part = np.bincount(column[here], weights=lengths[here], minlength=_COLUMNS) / np.maximum(whole, 1e-12)
        ax.stairs(0.8 * part - row, edges, baseline=-row, fill=True, color=_cause_color(name))
        ax.axhline(-row, color=style.GRID, linewidth=0.8)
        told = style.read(f"{Quantity(plan.seconds[name] / plan.cycle_time, 'share'):3}")
        ax.annotate(told, (1.005, -row + 0.4), xycoords=("axes fraction", "data"), ha="left", va="center",
                    fontsize=style.SMALL, color=style.MUTED)  # fmt: skip
    ax.set_yticks([0.4 - row for row in range(len(shown))], shown)
    ax.set_ylim(0.1 - max(len(shown), 1), 1.0)
    ax.grid(visible=False, axis="y")
    ax.set_xlabel("time (s)", fontsize=style.TEXT)
    return figure


def _cause_color(name: str) -> str:
    if name == FEED:
        return style.COLORS[2]
    if name == STANDSTILL:
        return style.INK
    what = name.split(" ")[0]
    own = (style.COLORS[5], style.COLORS[0], style.COLORS[1], style.COLORS[4])
    return own[DERIVATIVES.index(what)] if what in DERIVATIVES else style.MUTED


def plan_profiles(plan: Planned, axis: int) -> Any:
    """Velocity to snap of an axis over time, from the least to the most of each stretch, with its limits."""
    course, limits, units = plan.course, plan.limits.array[axis], _UNITS[plan.limits.shown[axis][1]]
    figure, axes = style.picture(4, height=6.2)
    begins = np.unique(np.linspace(0, len(course.time), min(len(course.time), _COLUMNS) + 1).astype(int)[:-1])
    time = np.append(course.time[begins], plan.cycle_time)
    for k, (ax, name, (unit, factor)) in enumerate(zip(axes, DERIVATIVES, units, strict=True)):
        low = factor * np.minimum.reduceat(course.low[:, axis, k], begins)
        high = factor * np.maximum.reduceat(course.high[:, axis, k], begins)
        ax.fill_between(time, np.append(low, low[-1]), np.append(high, high[-1]), step="post",
                        color=style.color(0), linewidth=0.8)  # fmt: skip
        top = factor * limits[k]
        used = max(-float(low.min()), float(high.max()))
        within = used > 0.2 * top
        for side in (-top, top) if within else ():
            ax.axhline(side, color=style.ALERT, linewidth=1.0, linestyle=_LIMIT)
        ax.set_ylim(*style.padded(*((-top, top) if within else (-used, used))))
        style.labels(ax, "time (s)" if k == 3 else None, f"{name}\n({unit})")
        style.note(ax, Text(f"{Quantity(plan.proof.use[axis, k], 'share'):3} of {Quantity(top, unit)}"))
    return figure

"""The picture of live signals: a panel for each unit, the trigger, and two cursors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from feeddrive.analysis.oscilloscope import Readout, Shown
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.plot.chart import Chart, Curve, Level, Panel
from feeddrive.plot.style import written

POINTS = 960  # points of a curve, two per interval of the window, and one more in an interval with a gap
_PANEL = 1.7  # inches: height of a panel
_SPACE = 0.05  # of the range of a panel: margin above and below its curves
_LEAST_USED = 0.4  # of a panel: a range is kept while its curves use at least this share
_NAME = 14  # letters of a channel name at the axis; the legend shows the full name
_STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)

Ranges = dict[str, tuple[float, float]]
"""The range of each panel by its label."""


@dataclass(frozen=True)
class Channel:
    """A displayed channel.

    name    its name in the source
    place   index of its column among the values
    unit    displayed unit; empty if unknown
    factor  from the unit of the source to the displayed unit
    """

    name: str
    place: int
    unit: str = ""
    factor: float = 1.0


def scope_chart(
    shown: Shown,
    channels: Sequence[Channel],
    clock: str = "s",
    *,
    level: tuple[str, float] | None = None,
    cursors: Readout | None = None,
    before: Mapping[str, tuple[float, float]] | None = None,
) -> tuple[Chart, Ranges]:
    """Return the chart of a window, and the ranges of its panels for use as `before` in the next call.

    level  trigger channel and its level in the unit of the source

    A range is kept while its curves fit into it and use a good part of it, so that the axes do not jump in a picture
    that is redrawn many times a second.
    """
    grouped: dict[str, list[Channel]] = {}
    for channel in channels:
        label = f"{written(channel.unit)}" if channel.unit else channel.name
        grouped.setdefault(label, []).append(channel)
    panels, ranges = list[Panel](), Ranges()
    for unit, group in grouped.items():
        label = f"({unit})" if group[0].unit else unit
        name = group[0].name if len(group[0].name) <= _NAME else f"{group[0].name[: _NAME - 1]}…"
        label = f"{name} {label}" if len(group) == 1 and group[0].unit else label
        panels.append(_panel(label, shown, group, [*channels], level, cursors, before or {}))
        low, high = panels[-1].low, panels[-1].high
        assert low is not None
        assert high is not None
        ranges[label] = low, high
    zero = "from the trigger" if shown.triggered else "until now"
    chart = Chart(
        f"time {zero} ({clock})", tuple(panels), low=shown.start, high=shown.end, height=_PANEL * max(len(panels), 1)
    )
    return chart, ranges


def _panel(
    label: str,
    shown: Shown,
    group: Sequence[Channel],
    all_: Sequence[Channel],
    level: tuple[str, float] | None,
    cursors: Readout | None,
    before: Mapping[str, tuple[float, float]],
) -> Panel:
    curves, levels = list[Curve](), list[Level]()
    width = 2.0 * (shown.end - shown.start) / POINTS
    for channel in group:
        y = channel.factor * shown.values[:, channel.place]
        whole = shown.triggered and bool(np.all(np.diff(shown.time) > 0.0)) and bool(np.all(np.isfinite(y)))
        kept = np.arange(y.size) if whole else kept_points(shown.time, y, width)  # a triggered window may be enlarged
        x = shown.time[kept] - shown.zero
        number = [one.name for one in all_].index(channel.name)
        curves.append(Curve(x, y[kept], channel.name, number, caption=_caption(y, channel.unit)))
    finite = np.concatenate([curve.y for curve in curves]) if curves else np.empty(0)
    finite = finite[np.isfinite(finite)]
    place = [channel for channel in group if level is not None and channel.name == level[0]]
    if level is not None and place:
        levels.append(Level(place[0].factor * level[1], "trigger", dashed=True))
        finite = np.append(finite, levels[0].value)
    if shown.triggered:
        levels.append(Level(0.0, upright=True, faint=True))
    if cursors is not None:
        levels += [Level(cursors.a, "1", upright=True, dashed=True), Level(cursors.b, "2", upright=True, dashed=True)]
    low, high = steady_range(finite, before.get(label))
    return Panel(label, tuple(curves), levels=tuple(levels), low=low, high=high)


def _caption(y: np.ndarray, unit: str) -> str:
    there = y[np.isfinite(y)]
    return Text(f"{Quantity(there[-1], written(unit)):5 SI}") if there.size else "nothing"


def kept_points(time: np.ndarray, y: np.ndarray, width: float) -> np.ndarray:
    """Return the rows of a curve to draw: the minimum and the maximum of each interval of `width` s, in time order.

    Intervals begin at whole multiples of the width, so that a scrolling curve keeps its points. The first and the last
    row are kept, and one row of each gap (NaN). A short curve keeps all its rows.
    """
    if time.size <= POINTS:
        return np.arange(time.size)
    stretch = np.floor(time / width)
    edges = np.concatenate([[0], np.flatnonzero(np.diff(stretch)) + 1, [time.size]])
    gap = ~np.isfinite(y)
    low = _first_of_stretch(np.where(gap, np.inf, y), edges, np.minimum)
    high = _first_of_stretch(np.where(gap, -np.inf, y), edges, np.maximum)
    gaps = np.flatnonzero(gap)
    if gaps.size:  # one row per interval
        gaps = gaps[np.diff(stretch[gaps], prepend=-np.inf) > 0.0]
    return np.unique(np.concatenate([[0], low, high, gaps, [time.size - 1]]))


def _first_of_stretch(y: np.ndarray, edges: np.ndarray, extreme: np.ufunc) -> np.ndarray:
    """Return the index of the first row in each interval at which its extreme value occurs."""
    values = extreme.reduceat(y, edges[:-1])
    met = np.flatnonzero(y == np.repeat(values, np.diff(edges)))
    return met[np.searchsorted(met, edges[:-1])]


def steady_range(y: np.ndarray, before: tuple[float, float] | None = None) -> tuple[float, float]:
    """Return a range with round ends around some values; the previous one if they fit into it and use a good part of
    it.
    """
    if not y.size:
        return before or (-1.0, 1.0)
    low, high = float(np.min(y)), float(np.max(y))
    if high == low:  # a constant has a margin of half its size on either side
        low, high = low - (0.5 * abs(low) or 1.0), high + (0.5 * abs(high) or 1.0)
    span = high - low
    # axes that follow each row would jump in every frame
    if before is not None and before[0] <= low and high <= before[1] and span >= _LEAST_USED * (before[1] - before[0]):
        return before
    low, high = low - _SPACE * span, high + _SPACE * span
    step = _round_up((high - low) / 5.0)
    return float(step * np.floor(low / step)), float(step * np.ceil(high / step))


def _round_up(step: float) -> float:
    size = 10.0 ** np.floor(np.log10(step))
    return float(next(multiple for multiple in _STEPS if step <= multiple * size * (1.0 + 1e-9)) * size)

"""The messages to the browser: a header in JSON and the numbers of all curves as 32-bit floats, in one message.

4 bytes   length of the header, little-endian, a multiple of 4 (padded with blanks)
header    JSON; a curve states the index of its first x and the number of points; its y follow, for a band low and high
numbers   float32, little-endian; non-finite values are NaN and interrupt a line
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from feeddrive.language.text import plain
from feeddrive.plot.chart import Band, Chart, Curve, Level, Mark, Panel
from feeddrive.plot.style import envelope

POINTS = 2000  # of a curve, and pixels of the width of a picture
Window = tuple[float, float]


def message(
    words: Mapping[str, Any], charts: Mapping[str, Chart] | None = None, windows: Mapping[str, Window] | None = None
) -> bytes:
    """Encode one message: its words, and charts by name.

    windows  visible range of x, by label of x, in which curves over that x have their points
    """
    numbers, windows = list[np.ndarray](), windows or {}
    shown = {name: _chart(chart, numbers, windows.get(chart.label)) for name, chart in (charts or {}).items()}
    content = json.dumps({**words, "charts": shown}, allow_nan=False, separators=(",", ":"), ensure_ascii=False)
    header = plain(content).encode("utf-8", "replace")  # a lone surrogate has no bytes
    header += b" " * (-len(header) % 4)
    body = np.concatenate(numbers).astype("<f4").tobytes() if numbers else b""
    return struct.pack("<I", len(header)) + header + body


def _chart(chart: Chart, numbers: list[np.ndarray], window: Window | None) -> dict[str, Any]:
    return {
        "label": chart.label,
        "scale": chart.scale,
        "low": chart.low,
        "high": chart.high,
        "square": chart.square,
        "bare": chart.bare,
        "factor": chart.factor,
        "panels": [_panel(panel, numbers, chart, window) for panel in chart.panels],
    }


def _panel(panel: Panel, numbers: list[np.ndarray], chart: Chart, window: Window | None) -> dict[str, Any]:
    return {
        "label": panel.label,
        "scale": panel.scale,
        "low": panel.low,
        "high": panel.high,
        "share": panel.share,
        "curves": [_curve(curve, numbers, chart, panel, window) for curve in panel.curves],
        "marks": [_mark(mark) for mark in panel.marks],
        "levels": [_level(level) for level in panel.levels],
        "discs": [vars(disc) for disc in panel.discs],
        "notes": [vars(note) for note in panel.notes],
        "bands": [_band(band, numbers) for band in panel.bands],
        "said": panel.caption,
        "heat": panel.heat and vars(panel.heat),
    }


def _mark(mark: Mark) -> dict[str, Any]:
    """Encode a mark; on the page its caption is `said`, as for panels and curves."""
    return {
        **{name: getattr(mark, name) for name in ("x", "y", "number", "hollow", "name", "key")},
        "said": mark.caption,
    }


def _level(level: Level) -> dict[str, Any]:
    return {name: getattr(level, name) for name in ("value", "text", "upright", "dashed", "faint")}


def _curve(
    curve: Curve, numbers: list[np.ndarray], chart: Chart, panel: Panel, window: Window | None
) -> dict[str, Any]:
    x, y = np.asarray(curve.x, np.float64), np.asarray(curve.y, np.float64)
    each_point = [row for row in (curve.heat, curve.reach) if row is not None]
    if x.size > POINTS and not each_point:
        x, y = _thinned(x, y, chart, panel, window)
    at = _put((x, y, *each_point), numbers)
    return {
        "name": curve.name,
        "number": curve.number,
        "look": curve.look,
        "said": curve.caption,
        "at": at,
        "n": x.size,
        "heat": curve.heat is not None,
        "reach": curve.reach is not None,
    }


def _put(rows: Sequence[np.ndarray], numbers: list[np.ndarray]) -> int:
    """Append rows of numbers; return the index of the first number."""
    at = sum(block.size for block in numbers)
    for row in rows:
        with np.errstate(over="ignore"):
            small = row.astype(np.float32)
        numbers.append(np.where(np.isfinite(small), small, np.float32(np.nan)))
    return at


def _band(band: Band, numbers: list[np.ndarray]) -> dict[str, Any]:
    """Encode a band; more points than a picture can show are reduced to the envelope of each interval."""
    x, low, high = (np.asarray(row, np.float64) for row in (band.x, band.low, band.high))
    if x.size > POINTS and np.all(np.isfinite(x)):
        begins = np.linspace(0, x.size, POINTS, endpoint=False).astype(int)
        low, high = np.minimum.reduceat(low, begins), np.maximum.reduceat(high, begins)
        x = np.append(x[begins[:-1]], x[-1])
    at = _put((x, low, high), numbers)
    return {"name": band.name, "number": band.number, "at": at, "n": x.size}


def _thinned(
    x: np.ndarray, y: np.ndarray, chart: Chart, panel: Panel, window: Window | None
) -> tuple[np.ndarray, np.ndarray]:
    """Reduce a curve to the resolution of a picture: the envelope over x, or in a plane points one pixel apart.

    Non-finite values interrupt a curve; its pieces share the points in proportion to their lengths.
    """
    there = np.isfinite(x) & np.isfinite(y)
    if not np.all(there):
        ends = np.flatnonzero(np.diff(there)) + 1
        pieces = [(u, v) for u, v in zip(np.split(x, ends), np.split(y, ends), strict=True)]
        thinned = list[tuple[np.ndarray, np.ndarray]]()
        for u, v in pieces:
            if np.isfinite(u[0]) and np.isfinite(v[0]):
                thinned.append(
                    envelope(u, v, max(2, POINTS * u.size // x.size)) if np.all(np.diff(u) > 0.0) else (u, v)
                )
            else:
                thinned.append((np.array([np.nan]), np.array([np.nan])))  # one point of each gap
        return np.concatenate([u for u, _ in thinned]), np.concatenate([v for _, v in thinned])
    if np.all(np.diff(x) > 0.0):
        if window is not None:  # and one point more on either side
            first, last = np.searchsorted(x, window)
            x, y = x[max(0, first - 1) : last + 1], y[max(0, first - 1) : last + 1]
        return envelope(x, y, POINTS)
    limits = chart.low, chart.high, panel.low, panel.high
    if chart.square and all(limit is not None for limit in limits):
        return _in_plane(x, y, *(float(limit) for limit in limits if limit is not None))
    return x, y


def _in_plane(
    x: np.ndarray, y: np.ndarray, left: float, right: float, low: float, high: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the points of a curve that are a pixel apart within the picture, and increasingly sparse outside it."""
    wide, tall = right - left, high - low
    off = np.maximum(1.0, np.maximum(np.abs(2.0 * (x - left) / wide - 1.0), np.abs(2.0 * (y - low) / tall - 1.0)))
    steps = np.hypot(np.diff(x) / wide, np.diff(y) / tall) * POINTS / np.maximum(off[1:], off[:-1]) ** 2
    place = np.floor(np.concatenate([[0.0], np.cumsum(steps)]))
    kept = np.concatenate([[True], np.diff(place) > 0.0])
    kept |= np.concatenate([kept[1:], [True]])
    return x[kept], y[kept]

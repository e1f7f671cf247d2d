"""Names beside marks, each where it covers neither a mark nor another name."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from feeddrive.plot import style

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from feeddrive.plot.chart import Mark

    Box = tuple[float, float, float, float]  # left, low, right, high in points

_SPOTS = tuple(
    (reach * dx, reach * dy)
    for reach in (1.0, 1.9, 2.9, 4.0)
    for dx, dy in ((1, 0), (-1, 0), (0.7, 0.8), (-0.7, 0.8), (0.7, -0.8), (-0.7, -0.8), (0, 1), (0, -1))
)  # where a name may stand, in steps of 9 points right and up
_STEP, _WIDE, _TALL = 9.0, 4.2, 10.5  # points: of a spot; width of a letter; height of a line


def name_marks(ax: Any, marks: Sequence[Mark], color: Callable[[int], str]) -> None:
    """Write the names of marks; marks at one place share a text. The axes must have their final size and ranges."""
    at: dict[tuple[float, float], list[Mark]] = {}
    scale = 72.0 / ax.figure.dpi
    for mark in (mark for mark in marks if mark.name):
        place = scale * ax.transData.transform((mark.x, mark.y))
        near = next((known for known in at if np.hypot(known[0] - place[0], known[1] - place[1]) < 2.0), None)
        at.setdefault((float(place[0]), float(place[1])) if near is None else near, []).append(mark)
    taken = [(px - 4.0, py - 4.0, px + 4.0, py + 4.0) for px, py in at]
    edge = scale * ax.bbox.extents
    for (px, py), there in at.items():
        text = ", ".join(str(style.caption(mark.name)) for mark in there)
        box = _free(px, py, _WIDE * len(text), taken, edge)
        taken.append(box)
        middle = (0.5 * (box[0] + box[2]), 0.5 * (box[1] + box[3]))
        data, tint = (there[0].x, there[0].y), color(there[0].number)
        ax.annotate(
            text,
            data,
            (middle[0] - px, middle[1] - py),
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=style.SMALL - 1,
            color=tint,
        )
        end = (min(max(px, box[0]), box[2]), min(max(py, box[1]), box[3]))
        if np.hypot(end[0] - px, end[1] - py) > 0.8 * _STEP:
            ax.annotate(
                "",
                data,
                (end[0] - px, end[1] - py),
                textcoords="offset points",
                arrowprops={"arrowstyle": "-", "color": tint, "linewidth": 0.7},
            )


def _free(px: float, py: float, wide: float, taken: Sequence[Box], edge: np.ndarray) -> Box:
    """Return the spot around a place that overlaps least with the taken boxes and the outside, the nearest first."""
    best: tuple[float, Box] | None = None
    for i, (dx, dy) in enumerate(_SPOTS):
        left = px + _STEP * dx - wide * (0.0 if dx > 0 else 1.0 if dx < 0 else 0.5)
        low = py + _STEP * dy - 0.5 * _TALL
        box = (left, low, left + wide, low + _TALL)
        over = sum(_shared(box, other) for other in taken)
        out = max(edge[0] - box[0], 0.0) + max(box[2] - edge[2], 0.0)
        out += max(edge[1] - box[1], 0.0) + max(box[3] - edge[3], 0.0)
        cost = over + 20.0 * out + 3.0 * i
        if best is None or cost < best[0]:
            best = cost, box
    assert best is not None
    return best[1]


def _shared(a: Box, b: Box) -> float:
    """The area that two boxes share."""
    return max(min(a[2], b[2]) - max(a[0], b[0]), 0.0) * max(min(a[3], b[3]) - max(a[1], b[1]), 0.0)

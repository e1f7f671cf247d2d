"""Lines and arcs of a path with their form errors, and the samples of a cut that form the finished part.

A tool in peripheral milling leaves a wall at its radius R beside the path p:

    w(t) = p(t) + R n(t),   n towards the workpiece: right of the feed in down milling, left of it in up milling (M3)

A point of that wall belongs to the part if

1. no other point of the same cut removes it:   min over s of |w(t) - p(s)| >= R.  This excludes a lead-in, a lead-out
   and the corners of the path around an outer corner of the part, where the tool touches nothing.
2. it lies on the same side of the closed path as most of the wall: inside a path around the part, outside a path in a
   pocket.  This excludes lead-in and lead-out from the other side.

A cut along an edge encloses nothing and counts completely, since the end of its part is not known.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column, Result, Table
from feeddrive.language.text import Text
from feeddrive.machining.circle_test import circle_fit, minimum_zone
from feeddrive.machining.contour import ContourError, Corner, size, unit

_PARTS, _FINEST = 20_000, 2e-5  # of a path, m: stretches in which its curvature is looked at
_SAME = 0.05  # of a curvature: what differs more is another element
_STRAIGHT = 1e-2  # 1/m: a curvature that is none
_SHORTEST = 2e-3  # m, of an element
_TURN = 0.3  # rad: an arc that turns less is none
_ENDS = 0.05  # of an element, left out at both ends, where the axes settle behind a corner


class Element(NamedTuple):
    """A line or an arc of the path with the form errors of the tool's motion.

    kind    "line" or "arc"
    begin, end  path length, m
    angle   angle of a line to the first axis, or the angle of an arc, rad
    radius  of an arc, m; 0 for a line
    form    straightness of a line (width of its zone) or roundness of an arc (gap of its zone), m
    tilt    angular deviation of a line, rad, + counter-clockwise; 0 for an arc
    size    radius of an arc minus that of the path, m; 0 for a line
    error   the largest contour error, m, unsigned
    line    of the part program, if known
    """

    kind: str
    begin: float
    end: float
    angle: float
    radius: float
    form: float
    tilt: float
    size: float
    error: float
    line: int | None


@dataclass(frozen=True, eq=False, repr=False)
class Elements(Result):
    """The lines and arcs of a path in order, and its corners."""

    name: str
    elements: tuple[Element, ...]
    corners: tuple[Corner, ...]

    def table(self) -> Table:
        """Return a table with one row for each element, then one for each corner."""
        rows: list[list[str | float | Quantity]] = [
            [
                f"{i + 1} {element.kind}{_in_line(element.line)}",
                element.end - element.begin,
                element.angle,
                element.form,
                Quantity(element.tilt, "rad", form="4 urad")
                if element.kind == "line"
                else Quantity(element.size, "m", form="+.4g"),
                element.error,
            ]
            for i, element in enumerate(self.elements)
        ]
        rows += [
            [
                f"corner{_in_line(corner.line)}",
                "",
                corner.turn,
                "",
                Text(f"passed at {Quantity(corner.nearest, 'm')}"),
                corner.error,
            ]
            for corner in self.corners
        ]
        columns = [
            "element",
            Column("length", "m", "4 mm"),
            Column("angle", "rad", "4 deg"),
            Column("straight, round", "m"),
            "tilt, radius",
            Column("contour error", "m"),
        ]
        return Table(f"{self.name}: {len(self.elements)} elements, {len(self.corners)} corners", columns, rows)


def _in_line(line: int | None) -> str:
    return "" if line is None else f", line {line}"


def elements(contour: ContourError, *, ends: float = _ENDS) -> Elements:
    """Split the path of a two-axis contour error into lines and arcs.

    ends  share of each element that is left out at each end, 0 to 0.4

    An element is at least 2 mm long; an arc turns by at least 17 degrees.  Straightness and tilt are those of the
    least-squares line; roundness is that of the minimum zone for arcs of at least half a turn, else about the center of
    the arc.  Raises ParameterError for more than two axes and for `ends` out of range.
    """
    if not contour.signed:
        raise ParameterError(f"elements are those of a plane path, not of {', '.join(contour.axes)}: choose two axes")
    if not 0.0 <= ends <= 0.4:
        raise ParameterError(f"ends = {Quantity(ends):6} must be >= 0 and <= 0.4")
    curve = contour.curve
    whole = float(curve.along[-1])
    marks = np.linspace(0.0, whole, min(_PARTS, max(3, int(whole / _FINEST))) + 1)
    rows = np.unique(np.searchsorted(curve.along, marks).clip(0, len(curve.along) - 1))
    node, along = curve.node[rows], curve.along[rows]
    step = np.diff(node, axis=0)
    heading = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    length = np.diff(along)
    bend = np.diff(heading) / (0.5 * (length[1:] + length[:-1]))  # at the nodes between two stretches
    change = np.abs(np.diff(bend)) > _SAME * np.maximum(np.abs(bend[1:]), np.abs(bend[:-1])) + _STRAIGHT
    cuts = np.concatenate([[0], np.flatnonzero(change) + 1, [len(bend)]])
    parts: list[Element] = []
    for first, last in pairwise(cuts.tolist()):
        begin, end = float(along[first]), float(along[last + 1])
        if end - begin < _SHORTEST:
            continue
        turn = float(heading[last] - heading[first])
        straight = abs(turn) < _STRAIGHT * (end - begin) + 1e-6
        if not straight and abs(turn) < _TURN:
            continue
        kept = ends * (end - begin)
        inside = (contour.along >= begin + kept) & (contour.along <= end - kept)
        if np.count_nonzero(inside) < 8:
            continue
        nodes = node[first : last + 2]
        place = contour.position[inside]
        line = None if contour.line is None else int(np.median(contour.line[inside]))
        error = float(np.max(np.abs(contour.error[inside])))
        if straight:
            angle, form, tilt = _line(place, nodes[-1] - nodes[0])
            parts.append(Element("line", begin, end, angle, 0.0, form, tilt, 0.0, error, line))
        else:
            radius, form, size = _arc(place, nodes, abs(turn))
            parts.append(Element("arc", begin, end, turn, radius, form, 0.0, size, error, line))
    return Elements(contour.name, tuple(parts), tuple(contour.corners()))


def _line(place: np.ndarray, along: np.ndarray) -> tuple[float, float, float]:
    """Return angle, straightness and tilt of a line through positions."""
    t = along / np.linalg.norm(along)
    middle = place - np.mean(place, axis=0)
    s, off = middle @ t, middle @ np.array([-t[1], t[0]])
    slope = float(s @ off / (s @ s))
    tilt = float(np.arctan(slope))
    return float(np.arctan2(t[1], t[0])), float(np.ptp(off - slope * s)) * float(np.cos(tilt)), tilt


def _arc(place: np.ndarray, nodes: np.ndarray, turn: float) -> tuple[float, float, float]:
    """Return the radius of an arc, the roundness of the positions on it, and their radius minus that of the arc."""
    center, radius = circle_fit(nodes[:, 0], nodes[:, 1])
    if turn >= np.pi:
        zone = minimum_zone(place[:, 0], place[:, 1])
        return radius, zone.width, circle_fit(place[:, 0], place[:, 1])[1] - radius
    r = np.hypot(*(place - center).T)
    return radius, float(np.ptp(r)), float(np.mean(r)) - radius


_TOUCHES = 5e-3  # of the radius: rounded corners and the distance between samples
_APART = 1e-2  # of the radius, between the places from which the wall is looked at: 5e-5 / 4 of it in the distance
_CORNERS = 300  # of the polygon that decides what lies inside: as many places of the path as that


def on_part(position: np.ndarray, velocity: np.ndarray, radius: float, milling: str) -> np.ndarray:
    """Return True for each sample of one cut that leaves a wall of the part, shape (n,).

    position, velocity  of the setpoint in the plane of the cut, m and m/s, shape (n, 2); a standstill leaves no wall
    radius              of the tool, m
    milling             up or down, with clockwise spindle rotation
    """
    from scipy.spatial import KDTree

    feed = unit(velocity)
    to_right = np.column_stack([feed[:, 1], -feed[:, 0]])
    wall = position + radius * (to_right if milling == "down" else -to_right)
    step = float(np.max(size(np.diff(position, axis=0)), initial=0.0))
    stride = max(1, int(_APART * radius / step)) if step > 0.0 else 1
    nearest, _ = KDTree(position[::stride]).query(wall)
    speed = size(velocity)
    stays = (speed > 0.0) & (nearest >= radius * (1.0 - _TOUCHES))
    inside = enclosed(wall, position)
    around = float(np.sum(speed[stays & inside])) >= float(np.sum(speed[stays & ~inside]))
    return stays & (inside if around else ~inside)


def enclosed(points: np.ndarray, path: np.ndarray) -> np.ndarray:
    """Return True for each point that a path, closed by a straight line, encloses: its winding number is not 0.

    points  shape (n, 2); path  shape (m, 2)
    """
    polygon = path[:: max(1, len(path) // _CORNERS)]
    begin, end = polygon, np.roll(polygon, -1, axis=0)
    turns = np.zeros(len(points), dtype=np.int64)
    for (x0, y0), (x1, y1) in zip(begin, end, strict=True):
        if y0 == y1:
            continue
        low, high, sign = (y0, y1, 1) if y0 < y1 else (y1, y0, -1)
        crosses = (points[:, 1] >= low) & (points[:, 1] < high)
        at = x0 + (points[crosses, 1] - y0) * (x1 - x0) / (y1 - y0)
        turns[np.flatnonzero(crosses)[at > points[crosses, 0]]] += sign
    return turns != 0

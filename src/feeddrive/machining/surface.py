"""Machined surface of an end mill: the envelope of its edges under the actual motion of the axes, and feed marks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from feeddrive.blocks.coupling.milling_cut import MillingCut
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column, Result, Table
from feeddrive.loop.simulate import Run
from feeddrive.machining.cutting_force import cutting_forces

_SAG = 1e-9  # m between two angles of an edge
_WIDE = 6.0  # feeds of a tooth beside the middle of its mark that it is followed
SIDES = ("up", "down")


@dataclass(frozen=True, eq=False, repr=False)
class Surface(Result):
    """A machined wall over a patch: its height above the nominal surface, positive where material is left.

    along    position along the feed, m, shape (n,)
    heights  height above the tip of the tool, m, shape (k,)
    map      height above the nominal surface, m, shape (k, n)
    feed     mean feed per tooth over the patch, m; `mark` is the theoretical height of its marks, m
    """

    along: np.ndarray
    heights: np.ndarray
    map: np.ndarray
    feed: float
    mark: float

    @property
    def roughness(self) -> tuple[float, float]:
        """The roughness Ra and Rz of the whole patch, m: mean absolute deviation, and peak-to-valley height."""
        off = self.map - np.mean(self.map)
        return float(np.mean(np.abs(off))), float(np.ptp(self.map))

    def table(self) -> Table:
        """Return a table of roughness, mean height and the theoretical height of the feed mark."""
        ra, rz = self.roughness
        columns = ["", *(Column(head, "m") for head in ("Ra", "Rz", "mean", "feed mark"))]
        return Table("wall that the edges leave", columns, [["patch", ra, rz, float(np.mean(self.map)), self.mark]])


def feed_mark(radius: float, feed: float, teeth: int, milling: str) -> float:
    """Return the height in m of the marks of equal teeth along a straight feed: c²/(8R (1 ± cN/2πR)²), + in up milling.

    radius, feed  tool radius R and feed per tooth c, m.   Source: Martellotti 1941, to second order.
    """
    _side(milling)
    sign = 1.0 if milling == "up" else -1.0
    return feed**2 / (8.0 * radius * (1.0 + sign * feed * teeth / (2.0 * np.pi * radius)) ** 2)


def runout_mark(radius: float, feed: float, difference: float) -> float:
    """Return the height in m of the marks of two teeth whose radii differ by Δ: (R/2)(Δ/c + c/2R)².

    The tooth paths are taken as circles.  For Δ >= c²/2R only one tooth leaves marks, those of twice the feed per
    tooth; 1 µm is often enough for that.
    """
    if difference >= feed**2 / (2.0 * radius):
        return (2.0 * feed) ** 2 / (8.0 * radius)
    return 0.5 * radius * (difference / feed + feed / (2.0 * radius)) ** 2


def scallop(radius: float, step: float) -> float:
    """Return the scallop height R - √(R² - s²/4) in m of a ball end mill for passes at a distance s."""
    return radius - float(np.sqrt(radius**2 - 0.25 * step**2))


def wall(
    run: Run,
    cut: MillingCut,
    begin: float,
    end: float,
    milling: str,
    *,
    points: int = 400,
    levels: int = 1,
    axial_depth: float | None = None,
) -> Surface:
    """Compute the finished wall of a run between two instants, on a straight feed.

    For each line across the wall the deepest edge counts. The angle of an edge is v = angle + 2πj/N - k z; it generates
    the wall near v = 0 in up milling and near π in down milling, so that the vibration at that instant is imprinted.

    begin, end     s; the feed is the straight line between the set positions there
    milling        up or down
    points, levels number of points along the feed and along the spindle; one level is the tip
    axial_depth    of the section, m; default: that of the cutter

    Between samples the motion is a cubic Hermite interpolant of positions and velocities; the path of an edge is a
    polyline with a sagitta of 1 nm, and its crossings are interpolated.  Run-out is left out.
    Raises ParameterError for instants outside the run, a standstill of the feed, or an unknown kind of milling.
    """
    _side(milling)
    if not run.time[0] <= begin < end <= run.time[-1]:
        raise ParameterError(
            f"a wall is made between two instants of the run, {Quantity(run.time[0]):6} to "
            f"{Quantity(run.time[-1], 's'):6 SI}"
        )
    axes = (cut.along_x, cut.along_y)
    sign = 1.0 if cut.moves == "tool" else -1.0
    place, speed, meant = (
        sign * np.column_stack([run[f"{axis}.{signal}"] for axis in axes])
        for signal in ("position_load", "velocity_load", "set_position")
    )
    rows = np.searchsorted(run.time, (begin, end))
    origin, way = meant[rows[0]], meant[rows[1]] - meant[rows[0]]
    length = float(np.hypot(*way))
    edge = cut.cutter.edge()
    turned, rpm = float(cut.start_angle), float(cut.spindle_speed)
    if cut.sections is not None:  # the spindle had other speeds before
        seen = cutting_forces(run, cut)
        rpm = float(seen.spindle_speed[rows[0]])
        turned = float(seen.angle[rows[0]]) - 2.0 * np.pi * rpm / 60.0 * (run.time[rows[0]] + 0.5 * run.sample_time)
    turn = 2.0 * np.pi * rpm / 60.0
    feed = length / (end - begin) * 2.0 * np.pi / (turn * edge.teeth)
    if feed < 1e-9:
        raise ParameterError("the tool stands between these instants: a wall needs a feed")
    t = way / length
    n = np.array([-t[1], t[0]])
    path = CubicHermiteSpline(run.time, (place - origin) @ np.column_stack([t, n]), speed @ np.column_stack([t, n]))
    radius, depth = 0.5 * float(edge.diameter), float(edge.axial_depth if axial_depth is None else axial_depth)
    # whole marks only: away from both ends, where teeth before and after are missing
    along = np.linspace(4.0 * feed, length - 4.0 * feed, points)
    if along[-1] <= along[0]:
        raise ParameterError(f"between these instants {Quantity(length / feed):3} teeth pass: a wall needs 8 or more")
    heights = np.linspace(0.0, depth, levels) if levels > 1 else np.zeros(1)
    lag = 2.0 * np.tan(float(edge.helix_angle)) / float(edge.diameter)
    middle, outward = (0.0, 1.0) if milling == "up" else (np.pi, -1.0)
    half = _WIDE * feed / radius
    walk = np.linspace(-half, half, 2 * int(np.ceil(half / np.sqrt(8.0 * _SAG / radius))) + 1)
    envelope = np.full((levels, points), -np.inf)
    for level, z in enumerate(heights):
        for tooth in range(edge.teeth):
            offset = middle - 2.0 * np.pi * tooth / edge.teeth + lag * z - turned
            first, last = (int(np.ceil((turn * instant - offset) / (2.0 * np.pi))) for instant in (begin, end))
            for pass_ in range(first, last):
                instants = (offset + 2.0 * np.pi * pass_ + walk) / turn
                if instants[0] < begin or instants[-1] > end:
                    continue
                at = path(instants)
                s, w = at[:, 0] + radius * np.sin(middle + walk), at[:, 1] + radius * np.cos(middle + walk)
                if s[0] > s[-1]:
                    s, w = s[::-1], w[::-1]
                reached = np.interp(along, s, outward * w - radius, left=-np.inf, right=-np.inf)
                envelope[level] = np.maximum(envelope[level], reached)
    return Surface(along, heights, -envelope, feed, feed_mark(radius, feed, edge.teeth, milling))


def _side(milling: str) -> None:
    if milling not in SIDES:
        raise ParameterError(f"milling = {milling!r} must be up or down: a slot has a wall of either kind")

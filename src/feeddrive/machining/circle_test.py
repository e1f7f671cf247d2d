"""The circular test of ISO 230-4: full circles at constant feed, and the figures of their radial deviations.

A quadrant peak is the outward deviation of a circle just after a reversal of an axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from feeddrive.language.errors import LogError, ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column, Result, Table
from feeddrive.language.text import Text
from feeddrive.loop.simulate import Run
from feeddrive.machining.contour import tool_columns

POINTS = 3600  # of a circle, evenly in angle
_EVEN = 0.05  # a rate of the angle that differs more from the usual one is no circle at the feed
_SETTLED = 0.005  # within which it begins and ends
_OVER = np.radians(2.0)  # over which the rate is taken
_OPEN = 0.1  # of G: the gap between begin and end of a turn that is no closed circle
_SMALL = 1e-6  # m: of such a gap, which is always allowed
_SAME_FEED = 0.02
_ROUND = 1e-4  # m: a nominal radius that nobody stated is a multiple of it

DIRECTIONS = {1: "CCW", -1: "CW"}


@dataclass(frozen=True, eq=False)
class CirclePath:
    """A full circle at constant feed, sampled evenly in angle.

    x, y       m, shape (n,), in the direction of the motion
    direction  1 counter-clockwise, -1 clockwise, seen on the plane of the axes
    feed       m/s
    radius     nominal, m
    center     of the set-up, m; None if unknown
    axes       names of the axes
    source     what was measured, "tool" or "encoder"; encoders do not see errors between them and the tool
    """

    x: np.ndarray
    y: np.ndarray
    direction: int
    feed: float
    radius: float
    center: tuple[float, float] | None = None
    axes: tuple[str, str] = ("x", "y")
    source: str = "tool"

    @property
    def name(self) -> str:
        """The direction and feed as text."""
        return Text(f"{DIRECTIONS[self.direction]} {Quantity(self.feed, 'm/s'):mm/min}")


class Zone(NamedTuple):
    """The zone between two concentric circles around a path: center and radii, m."""

    center: np.ndarray
    least: float
    most: float

    @property
    def width(self) -> float:
        """The radial width of the zone, m."""
        return self.most - self.least


class Figures(NamedTuple):
    """The ISO 230-4 figures of one circle, or of two circles in both directions at one feed, m.

    name      of the circle, or the feed of both
    G         circular deviation: width of the minimum zone; G(b) for both directions
    F_max, F_min  radial deviations from the nominal radius, about `center`
    D         mean radius of the least-squares circle minus the nominal one; ISO's D for both directions
    center    of the radial deviations
    both      True for the figures of both directions
    """

    name: str
    G: float
    F_max: float
    F_min: float
    D: float
    center: np.ndarray
    both: bool


def circle_fit(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, float]:
    """Return center and radius (m) of the least-squares circle, by Gauss-Newton steps from the center of gravity.

    It minimizes Σ (|p - c| - R)².
    """
    center = np.array([np.mean(x), np.mean(y)])
    for _ in range(50):
        dx, dy = x - center[0], y - center[1]
        r = np.hypot(dx, dy)
        if not np.all(r > 0.0):
            break
        design = np.column_stack([-dx / r, -dy / r, -np.ones(len(x))])
        step = np.linalg.lstsq(design, np.mean(r) - r, rcond=None)[0][:2]
        center = center + step
        if np.max(np.abs(step)) <= 1e-16 + 1e-13 * np.mean(r):
            break
    return center, float(np.mean(np.hypot(x - center[0], y - center[1])))


def minimum_zone(x: np.ndarray, y: np.ndarray) -> Zone:
    """Return the minimum zone of a path: min (s - l) with l <= r - u·δc <= s, repeated.

    The linear programs use the outermost and innermost points; points outside a solution are added until there are
    none.
    """
    from scipy.optimize import linprog  # not for commands that only read

    center, _ = circle_fit(x, y)
    best = _zone(x, y, center)
    for _ in range(8):
        dx, dy = x - center[0], y - center[1]
        r = np.hypot(dx, dy)
        ux, uy = dx / r, dy / r
        middle = float(np.mean(r))
        order = np.argsort(r)
        chosen = set(order[:40].tolist()) | set(order[-40:].tolist()) | set(range(0, len(x), max(1, len(x) // 72)))
        scale = max(float(np.ptp(r)), 1e-12)
        step = np.zeros(2)
        for _ in range(10):
            rows = np.array(sorted(chosen))
            u, e, one = np.column_stack([ux[rows], uy[rows]]), (r[rows] - middle) / scale, np.ones((len(rows), 1))
            zero = np.zeros_like(one)
            # unknown: δc (as a part of `scale`), s, l
            bounds = np.vstack([np.hstack([-u, -one, zero]), np.hstack([u, zero, one])])
            solution = linprog([0, 0, 1, -1], bounds, np.concatenate([-e, e]), bounds=(None, None), method="highs")
            if solution.x is None:
                return best
            step = scale * solution.x[:2]
            left = r - ux * step[0] - uy * step[1] - middle
            slack = 1e-6 * scale  # ten times what the linear program leaves
            beyond = np.flatnonzero((left > scale * solution.x[2] + slack) | (left < scale * solution.x[3] - slack))
            if not len(beyond):
                break
            chosen |= set(beyond[np.argsort(-np.abs(left[beyond]))][:40].tolist())
        center = center + step
        best = min(best, _zone(x, y, center), key=lambda zone: zone.width)
        if np.max(np.abs(step)) < 1e-6 * scale:
            break
    return best


def _zone(x: np.ndarray, y: np.ndarray, center: np.ndarray) -> Zone:
    r = np.hypot(x - center[0], y - center[1])
    return Zone(center, float(np.min(r)), float(np.max(r)))


def circle_path(
    x: np.ndarray,
    y: np.ndarray,
    *,
    sample_time: float | None = None,
    time: np.ndarray | None = None,
    radius: float | None = None,
    center: tuple[float, float] | None = None,
    axes: tuple[str, str] = ("x", "y"),
    source: str = "tool",
    points: int = POINTS,
    name: str = "circle",
) -> CirclePath:
    """Return the last full turn at constant feed of a motion, resampled evenly in angle about its least-squares center.

    x, y         m, shape (n,), of the whole motion: run-in, turns, run-out
    sample_time  s; or the time of each row, s
    radius       nominal, m; default: that of the fit, rounded to 0.1 mm
    center       of the set-up, m, if it is known

    Raises LogError for less than a full turn at constant feed and for a turn that does not close, ParameterError for
    rows that do not match.
    """
    x, y = (np.asarray(coordinate, dtype=np.float64) for coordinate in (x, y))
    if time is None:
        if sample_time is None:
            raise ParameterError(f"{name}: a circle needs its sample_time or the time of each row, s")
        time = sample_time * np.arange(len(x))
    if x.ndim != 1 or x.shape != y.shape or x.shape != np.shape(time) or len(x) < 16:
        raise ParameterError(
            f"{name}: {axes[0]}, {axes[1]} and time need equal rows, 16 or more, not "
            f"{np.size(x)}, {np.size(y)} and {np.size(time)}"
        )
    if not (np.all(np.isfinite(x)) and np.all(np.isfinite(y))):
        raise ParameterError(f"{name}: a position is not finite")
    middle, _ = circle_fit(x, y)
    begin, end = _at_feed(x, y, np.asarray(time), middle, name)
    middle, fitted = circle_fit(x[begin:end], y[begin:end])
    angle = np.unwrap(np.arctan2(y[begin:end] - middle[1], x[begin:end] - middle[0]))
    direction = 1 if angle[-1] > angle[0] else -1
    turned = direction * angle
    if turned[-1] - turned[0] < 2.0 * np.pi:
        raise LogError(
            f"{name}: only {Quantity(turned[-1] - turned[0], 'rad'):deg} are at constant feed: a full circle is "
            "needed, 360 deg without run-in and run-out; command 1.5 turns or more"
        )
    r = np.hypot(x[begin:end] - middle[0], y[begin:end] - middle[1])
    first = int(np.searchsorted(turned, turned[-1] - 2.0 * np.pi, side="right")) - 1
    first = max(first, 0)
    gap = float(r[-1] - np.interp(turned[-1] - 2.0 * np.pi, turned, r))
    if abs(gap) > max(_OPEN * float(np.ptp(r[first:])), _SMALL):
        raise LogError(
            f"{name}: the circle is not closed: after a turn the radius differs by {Quantity(gap, 'm'):3}. Let it "
            "settle for another turn, or look for drift"
        )
    wanted = turned[-1] - 2.0 * np.pi + 2.0 * np.pi * (np.arange(points) + 0.5) / points
    places = np.maximum.accumulate(turned[first:])
    even = _averaged(places, r[first:], wanted) if len(places) > 4 * points else np.interp(wanted, places, r[first:])
    span = float(time[begin:end][-1] - time[begin:end][first])
    nominal = _ROUND * round(fitted / _ROUND) if radius is None else radius
    feed = nominal * float(turned[-1] - turned[first]) / span
    if radius is not None and abs(fitted - radius) > 0.05 * radius:
        raise ParameterError(
            f"{name}: the circle has a radius of {Quantity(fitted, 'm'):mm}, and radius = {Quantity(radius, 'm'):mm} "
            "was stated"
        )
    drawn = direction * wanted
    return CirclePath(
        middle[0] + even * np.cos(drawn),
        middle[1] + even * np.sin(drawn),
        direction,
        feed,
        nominal,
        center,
        axes,
        source,
    )


def _at_feed(x: np.ndarray, y: np.ndarray, time: np.ndarray, middle: np.ndarray, name: str) -> tuple[int, int]:
    """Return first row and end of the longest range of rows with constant angular velocity."""
    angle = np.unwrap(np.arctan2(y - middle[1], x - middle[0]))
    whole = abs(float(angle[-1] - angle[0]))
    if whole < 2.0 * np.pi:
        raise LogError(f"{name}: the motion turns by {Quantity(whole, 'rad'):deg} about its center: no full circle")
    turned = np.abs(angle - angle[0])
    far = np.searchsorted(np.maximum.accumulate(turned), turned + _OVER)
    inside = far < len(x)
    rate = np.zeros(len(x))
    rows = np.flatnonzero(inside)
    rate[rows] = (turned[far[rows]] - turned[rows]) / (time[far[rows]] - time[rows])
    # the usual rate: the median over the angle, which a dwell does not change
    weights = np.abs(np.diff(angle, append=angle[-1]))
    order = np.argsort(rate)
    usual = rate[order[np.searchsorted(np.cumsum(weights[order]), 0.5 * np.sum(weights))]]
    even = inside & (np.abs(rate - usual) <= _EVEN * usual)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], even, [False]]).astype(int)))
    begins, ends = edges[::2], edges[1::2]
    if not len(begins):
        raise LogError(f"{name}: no stretch of the motion has a constant feed")
    longest = int(np.argmax(turned[np.minimum(ends, len(x) - 1)] - turned[begins]))
    stretch = slice(begins[longest], ends[longest])
    there = begins[longest] + np.flatnonzero(np.abs(rate[stretch] - usual) <= _SETTLED * usual)
    return int(there[0]), int(there[-1]) + 1


def _averaged(places: np.ndarray, r: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Average the radius between the midpoints of the wanted angles; interpolate where there are no rows."""
    step = wanted[1] - wanted[0]
    edges = np.searchsorted(places, np.append(wanted - 0.5 * step, wanted[-1] + 0.5 * step))
    sums = np.concatenate([[0.0], np.cumsum(r)])
    count = np.diff(edges)
    return np.where(count > 0, np.diff(sums[edges]) / np.maximum(count, 1), np.interp(wanted, places, r))


def circle_of_run(
    run: Run,
    axes: tuple[str, str] = ("x", "y"),
    *,
    radius: float | None = None,
    center: tuple[float, float] | None = None,
    signal: str = "tool",
    points: int = POINTS,
) -> CirclePath:
    """Return the circle of a simulated run; `signal` as in `contour_error`. Readings have the source "encoder"."""
    position = tool_columns(run, axes, signal)
    return circle_path(
        position[:, 0],
        position[:, 1],
        sample_time=run.sample_time,
        radius=radius,
        center=center,
        axes=axes,
        source="encoder" if signal.startswith("reading") else "tool",
        points=points,
        name=run.name,
    )


@dataclass(frozen=True, eq=False, repr=False)
class CircleTest(Result):
    """The figures of circles of one radius, and of pairs in both directions.

    circles  the measured circles
    figures  of each circle, then of each feed that was run in both directions
    about    center of the radial deviations F: "least squares" or "set-up"
    """

    circles: tuple[CirclePath, ...]
    figures: tuple[Figures, ...]
    about: str

    @property
    def radius(self) -> float:
        """The nominal radius, m."""
        return self.circles[0].radius

    @property
    def largest(self) -> Figures:
        """The figures with the largest circular deviation; those of both directions if available."""
        both = [figure for figure in self.figures if figure.both]
        return max(both or self.figures, key=lambda figure: figure.G)

    def table(self) -> Table:
        """Return a table with one row for each circle and each pair, in um."""
        first = self.circles[0]
        label = "" if first.source == "tool" else "; FROM ENCODERS, which do not see the tool"
        title = Text(
            f"circular test after ISO 230-4: R {Quantity(self.radius, 'm'):5 mm} in {''.join(first.axes)}; F about the "
            f"{self.about} center{label}"
        )
        rows = [
            [
                Text(f"both {circle.name}") if circle.both else circle.name,
                Text(f"{Quantity(circle.G, 'm', bare=True)} (b)") if circle.both else circle.G,
                circle.F_max,
                circle.F_min,
                circle.D,
                *map(float, circle.center),
            ]
            for circle in self.figures
        ]
        signed = [Column(head, "m", "+.4g") for head in ("F max", "F min", "D")]
        centers = [Column(f"center {axis}", "m", "7 mm") for axis in "xy"]
        return Table(title, ["circle", Column("G", "m"), *signed, *centers], rows)


def circle_test(circles: Sequence[CirclePath], *, about: str = "least squares") -> CircleTest:
    """Compute G, F and D of circles, and G(b) and D of both directions at one feed.

    G is the width of the minimum zone, with a free radius; F and D refer to the nominal radius.

    about  center of F: "least squares" of each circle, or "set-up", which all circles must then state

    Raises ParameterError for no circle, circles of different radii, planes or sources, and for another `about`.
    """
    if not circles:
        raise ParameterError("a circular test needs at least one circle")
    if about not in ("least squares", "set-up"):
        raise ParameterError(f"about = {about!r} must be one of least squares, set-up")
    first = circles[0]
    for circle in circles[1:]:
        if abs(circle.radius - first.radius) > 1e-9 or circle.axes != first.axes or circle.source != first.source:
            raise ParameterError(
                f"the circles of one test have one radius, plane and source: {first.name} has "
                f"{Quantity(first.radius, 'm'):5 mm} in {''.join(first.axes)} by {first.source}, {circle.name} "
                f"{Quantity(circle.radius, 'm'):5 mm} in {''.join(circle.axes)} by {circle.source}"
            )
    if about == "set-up" and any(circle.center is None for circle in circles):
        raise ParameterError("F about the set-up center needs the center of each circle")
    figures = [_figures([circle], about) for circle in circles]
    for i, circle in enumerate(circles):
        others = [
            other for other in circles[i + 1 :] if other.direction == -circle.direction and same_feed(circle, other)
        ]
        figures += [_figures([circle, other], about) for other in others[:1]]
    return CircleTest(tuple(circles), tuple(figures), about)


def same_feed(one: CirclePath, other: CirclePath) -> bool:
    """Return True if two feeds differ by at most 2 %."""
    return abs(one.feed - other.feed) <= _SAME_FEED * max(one.feed, other.feed)


def _figures(circles: list[CirclePath], about: str) -> Figures:
    x, y = (np.concatenate([getattr(circle, name) for circle in circles]) for name in ("x", "y"))
    center, mean = circle_fit(x, y)
    first = circles[0]
    if about == "set-up" and first.center is not None:
        center = np.array(first.center)
    r = np.hypot(x - center[0], y - center[1])
    both = len(circles) == 2
    return Figures(
        name=Text(f"{Quantity(first.feed, 'm/s'):mm/min}") if both else first.name,
        G=minimum_zone(x, y).width,
        F_max=float(np.max(r)) - first.radius,
        F_min=float(np.min(r)) - first.radius,
        D=mean - first.radius,
        center=center,
        both=both,
    )


def about_origin(circle: CirclePath) -> CirclePath:
    """Shift a circle so that its set-up center, or else its least-squares center, is the origin."""
    center = circle_fit(circle.x, circle.y)[0] if circle.center is None else np.array(circle.center)
    return replace(circle, x=circle.x - center[0], y=circle.y - center[1], center=(0.0, 0.0))


NEAR = np.radians(10.0)
"""Of a peak: the angle behind a reversal in which it is looked for, rad; the base is taken from as much before it."""


class QuadrantPeak(NamedTuple):
    """The quadrant peak after one reversal on one circle.

    circle     index of the circle in the test
    axis, side  the reversing axis and its end, as "x" and "+": the most positive or most negative position
    angle      polar angle of the peak, rad, 0 to 2π
    deviation  radial deviation at the peak, m
    height     of the peak above the mean deviation of the 10° before the reversal, m
    """

    circle: int
    axis: str
    side: str
    angle: float
    deviation: float
    height: float


def deviation(circle: CirclePath, center: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return polar angle about a center, rad, 0 to 2π, and radial deviation, m, in the order of motion."""
    dx, dy = circle.x - center[0], circle.y - center[1]
    return np.arctan2(dy, dx) % (2.0 * np.pi), np.hypot(dx, dy) - circle.radius


def deviations(test: CircleTest) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the `deviation` of each circle about the center of its figures."""
    centers = [figure.center for figure in test.figures if not figure.both]
    return [deviation(circle, center) for circle, center in zip(test.circles, centers, strict=True)]


def quadrant_peaks(test: CircleTest) -> list[QuadrantPeak]:
    """Return four peaks per circle, the highest first: the largest outward deviation within 10° after a reversal."""
    peaks = list[QuadrantPeak]()
    for k, (circle, (angle, r)) in enumerate(zip(test.circles, deviations(test), strict=True)):
        for quarter in range(4):
            since = circle.direction * (angle - 0.5 * np.pi * quarter)
            since = (since + np.pi) % (2.0 * np.pi) - np.pi
            before, after = (since < 0.0) & (since >= -NEAR), np.flatnonzero((since >= 0.0) & (since <= NEAR))
            if not np.any(before) or not len(after):
                continue
            top = int(after[np.argmax(r[after])])
            axis, side = circle.axes[quarter % 2], "+" if quarter < 2 else "-"
            height = float(r[top] - np.mean(r[before]))
            peaks.append(QuadrantPeak(k, axis, side, float(angle[top]), float(r[top]), height))
    return sorted(peaks, key=lambda peak: -peak.height)


def peaks_table(test: CircleTest) -> Table:
    """Return a table with one row for each circle: the peak heights after its four reversals."""
    first = test.circles[0]
    places = [(axis, side) for side in "+-" for axis in first.axes]
    heights = {(peak.circle, peak.axis, peak.side): peak.height for peak in quadrant_peaks(test)}
    rows = [[circle.name, *(heights.get((k, *place)) for place in places)] for k, circle in enumerate(test.circles)]
    title = "quadrant peaks: outward, in the 10° after a reversal, above the mean of the 10° before it"
    return Table(title, ["circle", *(Column(f"{side}{axis}", "m") for axis, side in places)], rows)

"""The circular test of ISO 230-4: full circles at constant feed, figures of their radial deviations, and the causes.

A quadrant peak is the outward deviation of a circle just after a reversal of an axis.

The causes are scale, squareness, lag, backlash, reversal spikes and the pitch errors of the screws.
All circles are fitted together by linear least squares; each cause has one column, the deviation that it produces on
each circle.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from feeddrive.language.errors import LogError, ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import UNIT, Cell, Column, Result, Table
from feeddrive.language.text import Text
from feeddrive.loop.simulate import Run
from feeddrive.machining.contour import tool_columns

POINTS = 3600  # of a circle, evenly in angle
_EVEN = 0.05  # relative deviation of the angular rate above which the feed is not constant
_SETTLED = 0.005  # the same at both ends of the range at constant feed
_OVER = np.radians(2.0)  # angle over which the rate is computed
_OPEN = 0.1  # of the radial deviation: largest gap between start and end of a closed turn
_SMALL = 1e-6  # m: such a gap is always allowed
_SAME_FEED = 0.02
_MORE_TURNS = "command 1.5 turns or more"
_ROUND = 1e-4  # m: an unstated nominal radius is rounded to a multiple of it

DIRECTIONS = {1: "CCW", -1: "CW"}


@dataclass(frozen=True, eq=False)
class CirclePath:
    """A full circle at constant feed, sampled evenly in angle.

    x, y       positions, m, shape (n,), in the order of motion
    direction  1 for counter-clockwise, -1 for clockwise motion in the plane of the axes
    feed       feed rate, m/s
    radius     nominal radius, m
    center     center of the set-up, m; None if unknown
    axes       names of the axes
    source     measured point, "tool" or "encoder"; encoders do not measure errors between them and the tool
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

    name      name of the circle, or the common feed of both
    G         circular deviation: width of the minimum zone; G(b) for both directions
    F_max, F_min  radial deviations from the nominal radius, about `center`
    D         radius of the least-squares circle minus the nominal radius; for both directions ISO's D
    center    center to which the radial deviations refer, m
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
    """Return the center and radius (m) of the least-squares circle, by Gauss-Newton steps from the center of gravity.

    It minimizes Σ (|p - c| - R)².
    """
    center = np.array([np.mean(x), np.mean(y)])
    for _ in range(50):
        dx, dy = x - center[0], y - center[1]
        r = np.hypot(dx, dy)
        # at the center itself the distance has no derivative
        if not np.all(r > 0.0):
            break
        design = np.column_stack([-dx / r, -dy / r, -np.ones(len(x))])
        step = np.linalg.lstsq(design, np.mean(r) - r, rcond=None)[0][:2]
        center = center + step
        # rounding of the radius ends the descent; 1e-16 m stands for a path without extent
        if np.max(np.abs(step)) <= 1e-16 + 1e-13 * np.mean(r):
            break
    return center, float(np.mean(np.hypot(x - center[0], y - center[1])))


def minimum_zone(x: np.ndarray, y: np.ndarray) -> Zone:
    """Return the minimum zone of a path by repeated linear programs: min (s - l) with l <= r - u·δc <= s.

    Here r is the distance of a point from the center, u its direction, and δc the shift of the center.  Each linear
    program uses only the outermost and innermost points; points that violate its solution are added until none are
    left.
    """
    # Deferred: commands that only read files do not need it.
    from scipy.optimize import linprog

    center, _ = circle_fit(x, y)
    best = _zone(x, y, center)
    # the distance is linear in the center for small shifts only: linearize again about each new center
    for _ in range(8):
        dx, dy = x - center[0], y - center[1]
        r = np.hypot(dx, dy)
        ux, uy = dx / r, dy / r
        middle = float(np.mean(r))
        order = np.argsort(r)
        chosen = set(order[:40].tolist()) | set(order[-40:].tolist()) | set(range(0, len(x), max(1, len(x) // 72)))
        # HiGHS has absolute tolerances of 1e-7, and deviations are micrometers: scale them to 1
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
            # Ten times the tolerance of the linear program.
            slack = 1e-6 * scale
            beyond = np.flatnonzero((left > scale * solution.x[2] + slack) | (left < scale * solution.x[3] - slack))
            if not len(beyond):
                break
            chosen |= set(beyond[np.argsort(-np.abs(left[beyond]))][:40].tolist())
        center = center + step
        # a step of the linearized problem may widen the zone
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
    remedy: str = _MORE_TURNS,
) -> CirclePath:
    """Return the last full turn at constant feed of a motion, resampled evenly in angle about its least-squares center.

    x, y         positions of the whole motion, m, shape (n,): run-in, turns, run-out
    sample_time  sample time, s; alternatively `time`, the time of each row, s
    radius       nominal radius, m; default: that of the fitted circle, rounded to 0.1 mm
    center       center of the set-up, m, if known
    remedy       how to obtain a longer motion at constant feed, for the error message

    Raises LogError for less than a full turn at constant feed and for a turn that does not close, ParameterError for
    arrays that do not match.
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
            f"needed, 360 deg without run-in and run-out; {remedy}"
        )
    r = np.hypot(x[begin:end] - middle[0], y[begin:end] - middle[1])
    # The last turn, when the transients of the run-in have decayed most.
    first = int(np.searchsorted(turned, turned[-1] - 2.0 * np.pi, side="right")) - 1
    first = max(first, 0)
    gap = float(r[-1] - np.interp(turned[-1] - 2.0 * np.pi, turned, r))
    if abs(gap) > max(_OPEN * float(np.ptp(r[first:])), _SMALL):
        raise LogError(
            f"{name}: the circle is not closed: after a turn the radius differs by {Quantity(gap, 'm'):3}. Let it "
            "settle for another turn, or look for drift"
        )
    wanted = turned[-1] - 2.0 * np.pi + 2.0 * np.pi * (np.arange(points) + 0.5) / points
    # noise turns a slow angle back for a row, and interpolation needs ascending places
    places = np.maximum.accumulate(turned[first:])
    # a mean over many rows removes their noise; over few it would be a staircase
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
    """Return the first row of the longest range with constant angular velocity, and the row after its last one."""
    angle = np.unwrap(np.arctan2(y - middle[1], x - middle[0]))
    whole = abs(float(angle[-1] - angle[0]))
    if whole < 2.0 * np.pi:
        raise LogError(f"{name}: the motion turns by {Quantity(whole, 'rad'):deg} about its center: no full circle")
    turned = np.abs(angle - angle[0])
    # over 2° instead of one row: an angle by differences of rows is noise at slow feeds
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
    # the loose tolerance keeps the slow rows of a reversal; its ends are trimmed with the tight one, without run-in
    there = begins[longest] + np.flatnonzero(np.abs(rate[stretch] - usual) <= _SETTLED * usual)
    return int(there[0]), int(there[-1]) + 1


def _averaged(places: np.ndarray, r: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Average the radius over the interval around each angle in `wanted`; interpolate where an interval contains no
    rows.
    """
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
    remedy: str = _MORE_TURNS,
) -> CirclePath:
    """Return the circle of a simulated run. `signal` is the argument of `contour_error`; if it is a reading, the source
    of the circle is "encoder".
    """
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
        remedy=remedy,
    )


@dataclass(frozen=True, eq=False, repr=False)
class CircleTest(Result):
    """The figures of circles of one radius, and of pairs in both directions.

    circles  the measured circles
    figures  the figures of each circle, then those of each feed that was run in both directions
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
        """The figures with the largest circular deviation, out of those of both directions if available."""
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

    about  center of F: "least squares", that of each circle, or "set-up", which all circles must then state

    Raises ParameterError if there is no circle, for different radii, planes or sources, and for an unknown `about`.
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
"""The angle after a reversal in which its peak is searched, rad; the base is the mean over the same angle before it."""


class QuadrantPeak(NamedTuple):
    """The quadrant peak after one reversal on one circle.

    circle     index of the circle in the test
    axis, side  the reversing axis and the end of its travel, such as "x" and "+" for the most positive position
    angle      polar angle of the peak, rad, 0 to 2π
    deviation  radial deviation at the peak, m
    height     height of the peak above the mean deviation in the 10° before the reversal, m
    """

    circle: int
    axis: str
    side: str
    angle: float
    deviation: float
    height: float


def deviation(circle: CirclePath, center: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the polar angle about a center (rad, 0 to 2π) and the radial deviation (m), in the order of motion."""
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


PASSES = 30
_NULL = 1e-7  # of the largest singular value: that of a combination which the circles do not excite
_PART = 0.02  # smallest coefficient of a column that is part of such a combination
_NODES = 24  # nodes of the free shape of a spike after a reversal
_DECAYS = (1e-3, 0.2)  # s: range of the decay of a spike
_WINDOW = 0.25  # s after a reversal in which a spike may last
_WIDEST = np.radians(50.0)
_NARROWEST = np.radians(4.0)
# friction settles with the slowest pole of the loop, Tn or 1/Kv, of 0.02 to 0.2 s: a tail of a half-way time constant
_TAIL = 0.1  # s: decay of what is left of a spike beyond its range
_BLOCKS = 8  # blocks of a circle within which residuals may be alike, 45 degrees each
_PHASES = 9  # blocks of a quarter turn within which the residuals of all quarters at one feed may be alike
# a loop lags with V² to first order; the next order is smaller by (ω/ω_c)², some hundredths at usual feeds
_NEXT_ORDER = 0.1  # of the lag radius at the slowest feed, which may count as scale
_LEFT_OF_SPIKE = 0.002  # of the highest spike: what friction that is not the same at each reversal leaves on the circle


class Rows(NamedTuple):
    """The data of one circle: angle about the fitted center, deviation about the set-up center, direction, feed,
    radius.
    """

    angle: np.ndarray
    deviation: np.ndarray
    d: int
    V: float
    R: float

    @property
    def turning(self) -> float:
        """The angular velocity V/R, rad/s."""
        return self.V / self.R


class Fit(NamedTuple):
    """The data of the fit: circles, axis names, screw pitches, and True if the table remains at rest while a gap is
    crossed.
    """

    data: list[Rows]
    names: tuple[str, str]
    pitches: Mapping[str, float]
    stands: bool

    def best_decay(self) -> float:
        """Return the decay with the smallest residual, from a coarse grid and a search around its best value."""
        # Deferred: commands that only read files do not need it.
        from scipy.optimize import minimize_scalar

        # few passes rank the decays; the fit with the best one then runs until it settles
        grid = np.geomspace(*_DECAYS, 16)
        left = [self.settled(float(t), 4).square for t in grid]
        best = int(np.argmin(left))
        optimum: Any = minimize_scalar(
            lambda u: self.settled(float(np.exp(u)), 6).square,
            bounds=np.log(grid[[max(best - 1, 0), min(best + 1, len(grid) - 1)]]),
            method="bounded",
            options={"xatol": 1e-4},
        )
        return float(np.exp(optimum.x))

    def settled(self, decay: float | None, passes: int = PASSES) -> Solved:
        """Repeat the fit, each pass with the lag mismatch and backlash of the previous one, until both converge."""
        shape = Shape(0.0, (0.0, 0.0))
        solved = Solved(self, shape, decay, 1)
        for count in range(2, passes + 1):
            gaps = [max(solved.value(f"backlash {axis}"), 0.0) if self.stands else 0.0 for axis in self.names]
            solution = Shape(solved.value("lag mismatch"), (gaps[0], gaps[1]))
            if solution.near(shape):
                break
            shape = solution
            solved = Solved(self, shape, decay, count)
        return solved


class Shape(NamedTuple):
    """The parameters of a pass that come from the previous one: lag mismatch, s, and the gap of each axis, m."""

    mismatch: float
    gaps: tuple[float, float]

    def near(self, other: Shape) -> bool:
        """Return True if two passes agree within the convergence tolerances."""
        away = abs(self.mismatch - other.mismatch) <= 1e-9 * abs(self.mismatch) + 1e-12
        return away and all(abs(a - b) <= 1e-4 * a + 1e-9 for a, b in zip(self.gaps, other.gaps, strict=True))


def since_reversal(phase: np.ndarray, d: int, reversal: float) -> np.ndarray:
    """Return the angle since the most recent reversal of an axis, which reverses twice per turn."""
    return np.mod(d * (phase - reversal), np.pi)


class Solved:
    """A pass of the fit: the columns of all circles, and their least-squares solution."""

    def __init__(self, fit: Fit, shape: Shape, decay: float | None, passes: int) -> None:
        self.data, self.names, self.shape, self.decay, self.passes = fit.data, fit.names, shape, decay, passes
        data = fit.data
        self.units: dict[str, str] = {}
        self.feeds = distinct_feeds(data)
        blocks = [self._columns(rows, fit.pitches) for rows in data]
        self.labels = list(blocks[0])
        self.design = np.vstack([np.column_stack(list(block.values())) for block in blocks])
        self.wanted = np.concatenate([rows.deviation for rows in data])
        # columns in m, rad and s² are compared at length 1, so that the rank does not depend on units
        norms = np.linalg.norm(self.design, axis=0)
        self.seen = norms > 1e-12 * np.max(norms)
        self.scale = np.where(self.seen, norms, 1.0)
        # triangular: all that the solution needs of the many rows; the last column is what is wanted
        whole: Any = np.linalg.qr(np.column_stack([self.design / self.scale, self.wanted]), mode="r")
        self._triangle, wanted = whole[:, :-1], whole[:, -1]
        self.kept = self._independent()
        left, sizes, right = np.linalg.svd(self._triangle[:, self.kept], full_matrices=False)
        self.condition = float(sizes[0] / sizes[-1])
        self.solution = np.zeros(len(self.labels))
        self.solution[self.kept] = (right.T @ ((left.T @ wanted) / sizes)) / self.scale[self.kept]
        self._inverse = (right.T / sizes**2) @ right
        self.residual = self.wanted - self.design @ self.solution
        self.square = float(self.residual @ self.residual)

    def _independent(self) -> np.ndarray:
        """Return the indices of linearly independent columns: of every linearly dependent set, the last column is
        dropped.
        """
        kept = np.flatnonzero(self.seen)
        while True:
            _, sizes, right = np.linalg.svd(self._triangle[:, kept], full_matrices=False)
            if sizes[-1] > _NULL * sizes[0]:
                return kept
            part = np.max(np.abs(right[sizes <= _NULL * sizes[0]]), axis=0) > _PART
            kept = np.delete(kept, np.flatnonzero(part)[-1])

    @cached_property
    def unseparable(self) -> dict[int, list[int]]:
        """The columns that the circles cannot separate from others, by index, each with the indices of those others."""
        mixed: dict[int, list[int]] = {}
        for i in np.flatnonzero(self.seen):
            if i in self.kept:
                continue
            parts = np.linalg.lstsq(self._triangle[:, self.kept], self._triangle[:, i], rcond=None)[0]
            together = [int(i), *(int(k) for k in self.kept[np.abs(parts) > _PART])]
            for cause in together:
                mixed.setdefault(cause, []).extend(k for k in together if k != cause)
        return mixed

    def _columns(self, rows: Rows, pitches: Mapping[str, float]) -> dict[str, np.ndarray]:
        x, y = self.names
        angle, d, V, R = rows.angle, rows.d, rows.V, rows.R
        ahead = d * rows.turning * self.shape.mismatch
        # each axis reverses at its own phase: columns that turn at the polar angle find 2.8 µm of a spike of 4 µm
        at_x, at_y = angle - ahead, angle + ahead
        cos, sin = np.cos(angle), np.sin(angle)
        since = {x: since_reversal(at_x, d, 0.0), y: since_reversal(at_y, d, 0.5 * np.pi)}
        held = [_held(since[axis], R, gap) for axis, gap in zip(self.names, self.shape.gaps, strict=True)]
        one = np.ones_like(angle)
        columns = {
            f"set-up offset {x}": ("m", cos),
            f"set-up offset {y}": ("m", sin),
            "scale, mean": ("", R * one),
            "scale, difference": ("", R * np.cos(2.0 * angle)),
            "squareness": ("rad", 0.5 * R * np.sin(2.0 * angle)),
            "lag radius, mean": ("s2", -(V**2) / (2.0 * R) * one),
            "lag radius, difference": ("s2", -(V**2) / (4.0 * R) * np.cos(2.0 * angle)),
            "lag mismatch": ("s", 0.5 * d * V * np.sin(2.0 * angle)),
            f"backlash {x}": ("m", 0.5 * d * np.sign(np.sin(at_x)) * cos - held[0] * np.abs(cos)),
            f"backlash {y}": ("m", -0.5 * d * np.sign(np.cos(at_y)) * sin - held[1] * np.abs(sin)),
        }
        for axis, part in ((x, cos), (y, sin)):
            if axis in pitches:
                wave = 2.0 * np.pi * R * part / pitches[axis]
                columns[f"screw {axis} sine"] = ("m", np.sin(wave) * part)
                columns[f"screw {axis} cosine"] = ("m", np.cos(wave) * part)
        for axis, part in ((x, cos), (y, sin)):
            if self.decay is not None:
                course = np.exp(-since[axis] / (rows.turning * self.decay))
                columns[f"reversal spike {axis}"] = ("m", course * np.abs(part))
                continue
            for i, feed in enumerate(self.feeds):
                here = abs(rows.V - feed) <= 0.02 * feed
                range_ = window(feed / R)
                gone = (since[axis] - range_) / (rows.turning * _TAIL)
                tail = np.where(gone > 0.0, np.exp(-np.maximum(gone, 0.0)), 0.0)
                for k, hat in enumerate([*_hats(since[axis], range_), tail]):
                    columns[f"spike {axis} {i} {k}"] = ("m", hat * np.abs(part) if here else np.zeros_like(hat))
        self.units |= {name: unit for name, (unit, _) in columns.items()}
        return {name: column for name, (_, column) in columns.items()}

    @cached_property
    def variances(self) -> np.ndarray:
        """The variance of each fitted value, (A'A)⁻¹ Σ g g' (A'A)⁻¹ with scores g summed over blocks.

        It is the larger of the results for two kinds of blocks, within which residuals may be fully correlated: any 45°
        of each circle, and the same 10° after the reversals in all quadrants and circles at one feed, where friction
        causes the same residual.  This is the variance of a block bootstrap with random signs, in closed form.
        """
        scores = (self.design[:, self.kept] / self.scale[self.kept]) * self.residual[:, None]
        apart = np.zeros((len(self.kept), len(self.kept)))
        alike: dict[tuple[int, int], np.ndarray] = {}
        for rows, own in zip(self.data, np.split(scores, self.ends), strict=True):
            width = max(1, len(own) // _BLOCKS)
            # a circle is closed: the blocks at its end continue at its start
            around = np.cumsum(np.vstack([np.zeros((1, own.shape[1])), own, own[:width]]), axis=0)
            blocks = around[width:][: len(own)] - around[: len(own)]
            apart += blocks.T @ blocks / width
            feed = next(i for i, feed in enumerate(self.feeds) if abs(rows.V - feed) <= 0.02 * feed)
            phase = np.floor(np.mod(rows.d * rows.angle, 0.5 * np.pi) * (_PHASES / (0.5 * np.pi))).astype(int)
            for k in range(_PHASES):
                alike[feed, k] = alike.get((feed, k), 0.0) + np.sum(own[phase == k], axis=0)
        together = sum(np.outer(total, total) for total in alike.values())
        n, k = self.design.shape[0], len(self.kept)
        spread = [np.diag(self._inverse @ middle @ self._inverse) for middle in (apart, together)]
        return np.maximum(*spread) * (n / max(n - k, 1))

    @cached_property
    def ends(self) -> np.ndarray:
        """The index of the first row of each circle except the first one."""
        return np.cumsum([len(rows.angle) for rows in self.data])[:-1]

    @cached_property
    def _spike(self) -> float:
        """The largest deviation of a reversal spike, m."""
        spikes = [name for name in self.labels if name.startswith(("spike ", "reversal spike "))]
        return max((float(np.max(np.abs(drawn))) for drawn in self.drawn(spikes)), default=0.0)

    def value(self, name: str) -> float:
        """Return the fitted value of a column, 0 if it was dropped."""
        return float(self.solution[self.labels.index(name)])

    def error(self, name: str) -> float:
        """Return the standard error of a column, or inf if it cannot be separated."""
        i = self.labels.index(name)
        if i in self.unseparable or i not in self.kept:
            return float("inf")
        k = int(np.flatnonzero(self.kept == i)[0])
        noise = float(np.sqrt(max(self.variances[k], 0.0))) / float(self.scale[i])
        if name.startswith(("spike ", "reversal spike ", "set-up")):
            return noise
        left = _LEFT_OF_SPIKE * self._spike / float(np.max(np.abs(self.design[:, i])))
        return float(np.linalg.norm([noise, left, self._unlike_scale(name)]))

    def _unlike_scale(self, name: str) -> float:
        """Return the part of a scale error that may be due to higher-order lag, estimated at the slowest feed."""
        if not name.startswith("scale, "):
            return 0.0
        lag, scale = (self.labels.index(f"{what}, {name.removeprefix('scale, ')}") for what in ("lag radius", "scale"))
        slowest = int(np.argmin([rows.V for rows in self.data]))
        rows = [0, *self.ends, len(self.design)][slowest : slowest + 2]
        drawn = float(np.max(np.abs(self.design[slice(*rows), lag]))) * abs(float(self.solution[lag]))
        return _NEXT_ORDER * drawn / float(np.max(np.abs(self.design[:, scale])))

    def drawn(self, names: Sequence[str]) -> list[np.ndarray]:
        """Return the deviation that the named columns together produce on each circle, m."""
        chosen = [self.labels.index(name) for name in names]
        whole = self.design[:, chosen] @ self.solution[chosen]
        return np.split(whole, self.ends)


def _held(since: np.ndarray, R: float, gap: float) -> np.ndarray:
    """Return the fraction of a gap that is not yet crossed at each angle since a reversal; until it is, the table is at
    rest.
    """
    if gap <= 0.0:
        return np.zeros_like(since)
    # the axis leaves its reversal with the acceleration V²/R, and has moved by R since²/2
    return np.maximum(0.0, 1.0 - since**2 * (0.5 * R / gap))


def distinct_feeds(data: list[Rows]) -> list[float]:
    """Return the distinct feeds of all circles; feeds within 2 % count as equal."""
    feeds: list[float] = []
    for rows in data:
        if not any(abs(rows.V - feed) <= 0.02 * feed for feed in feeds):
            feeds.append(rows.V)
    return feeds


def window(turning: float) -> float:
    """Return the angle after a reversal within which a spike must end, rad."""
    return float(np.clip(_WINDOW * turning, _NARROWEST, _WIDEST))


def _hats(since: np.ndarray, window: float) -> list[np.ndarray]:
    """Return piecewise linear basis functions of the angle since a reversal, denser at its start, 0 beyond `window`."""
    nodes = window * (np.arange(_NODES + 1) / _NODES) ** 1.5
    return [np.interp(since, nodes, row, right=0.0) for row in np.eye(_NODES + 1)[:_NODES]]


_AT_ONCE = np.radians(0.2)  # after a reversal: what happens there is the reversal of a backlash, not a spike

_READ_IN = {"": "ppm", "rad": "urad", "s2": "ms2"}  # by SI unit, where it is not the usual unit


class Cause(NamedTuple):
    """A cause of radial deviations.

    name    name, such as "backlash x"
    value, error  fitted value and standard error, in SI units; the error is inf if the cause cannot be separated
    unit    SI unit
    effect  the largest radial deviation that it produces on one of the circles, m
    share   fraction of G: its peak-to-peak deviation over the total one, on the circle where this is largest
    note    the causes from which it cannot be separated, and the test to run; otherwise empty
    """

    name: str
    value: float
    error: float
    unit: str
    effect: float
    share: float
    note: str


class Spike(NamedTuple):
    """The outward deviation after the reversals of an axis at one feed, with all other causes removed.

    axis, feed  the axis, and the feed in m/s
    angle       angle since the reversal, rad, shape (n,)
    height      mean outward deviation over the reversals, m, shape (n,), from 0.2° after the reversal on
    """

    axis: str
    feed: float
    angle: np.ndarray
    height: np.ndarray

    @property
    def peak(self) -> float:
        """The signed deviation of the largest magnitude, m."""
        return float(self.height[int(np.argmax(np.abs(self.height)))])

    @property
    def peak_angle(self) -> float:
        """The angle of the peak after the reversal, rad."""
        return float(self.angle[int(np.argmax(np.abs(self.height)))])


@dataclass(frozen=True, eq=False, repr=False)
class CircleCauses(Result):
    """The causes of the radial deviations of circles, and the residual.

    causes    all fitted causes
    spikes    the deviation after the reversals of each axis at each feed
    residual  RMS of the residual, m
    condition condition number of the separable columns: the ratio of the largest and smallest singular value
    decay     time constant of an exponential spike, s; None for a free shape
    passes    number of passes until the phases of the reversals converged
    left      residual over the points of each circle, m
    measured  lowest and highest position of each axis on the circles, m
    """

    causes: tuple[Cause, ...]
    spikes: tuple[Spike, ...]
    residual: float
    condition: float
    decay: float | None
    passes: int
    left: tuple[np.ndarray, ...]
    measured: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Cause:
        for cause in self.causes:
            if cause.name == name:
                return cause
        raise ParameterError(f"there is no cause '{name}'; there are {', '.join(cause.name for cause in self.causes)}")

    @property
    def ranked(self) -> list[Cause]:
        """The causes by descending effect, without the set-up offset, which is not an error of the machine."""
        return sorted((cause for cause in self.causes if not cause.name.startswith("set-up")), key=lambda c: -c.effect)

    def table(self) -> Table:
        """Return a table with one row for each cause, the largest first."""
        rows: list[list[Cell]] = []
        for cause in self.ranked:
            unit = _READ_IN.get(cause.unit, "")
            value = Quantity(cause.value, cause.unit, form=f"4 {unit}")
            error = Quantity(cause.error, cause.unit, form=f"2 {unit}") if np.isfinite(cause.error) else None
            rows.append([cause.name, value, error, UNIT, cause.effect, cause.share, cause.note])
        columns = [
            "cause",
            "value",
            "+-",
            "unit",
            Column("draws", "m"),
            Column("of G", "share", "3"),
            Column("", sentences=True),
        ]
        return Table(f"causes; {Quantity(self.residual, 'm'):3} RMS are not explained", columns, rows)


def circle_causes(
    circles: Sequence[CirclePath],
    *,
    spike: str = "free",
    backlash: str = "stands",
    decay: float | None = None,
    pitch: Mapping[str, float] | None = None,
) -> CircleCauses:
    """Split the radial deviations of circles of one radius into causes, by least squares over all of them.

    spike  "free": a spike of any shape, equal for both reversals of an axis and both directions at a given feed;
           "exponential": g exp(-t/decay) after each reversal
    backlash  "stands": with the loop closed by the motor encoder, the table remains at rest until the gap is crossed,
              over √(2B/R) rad; "step": the table changes sides at the reversal
    decay  time constant of an exponential spike, s; default: the one with the smallest residual
    pitch  pitch of the screw by axis, m; screw errors are only fitted for axes with a pitch

    The columns are the radial deviations in an ISO 230-4 test to first order, outward positive.  With R the radius, V
    the feed, d the direction and θ the polar angle, they are: scale error s: R s, squareness q: (R q/2) sin 2θ, lag
    -(V²/2R)(κ_mean + Δκ/2 cos 2θ), its mismatch d (V/2) Δτ sin 2θ, backlash ±B/2 along each axis, changing sign at the
    reversals of that axis: θ = d (V/R) Δτ for x and 90° - d (V/R) Δτ for y, with Δτ of the previous pass.  Beyond its
    range, a free spike has an exponential tail.

    Standard errors are valid for residuals that are correlated over 45° or at the same angle after all reversals. They
    include 0.2 % of the largest spike and, for a scale error, a tenth of the lag at the slowest feed.

    Causes that the circles cannot separate are listed with the circle that would separate them; their sum is assigned
    to the first one.

    Raises the same errors as `circle_test`, and ParameterError for an unknown spike and a pitch that is not > 0.
    """
    figures = circle_test(circles)
    names = circles[0].axes
    for what, value, options in (
        ("spike", spike, ("free", "exponential")),
        ("backlash", backlash, ("stands", "step")),
    ):
        if value not in options:
            raise ParameterError(f"{what} = {value!r} must be one of {', '.join(options)}")
    for axis, length in (pitch or {}).items():
        if axis not in names or not 0.0 < length < float("inf"):
            raise ParameterError(
                f"pitch of '{axis}' = {Quantity(length, 'm'):6 SI}: a pitch > 0 m of {' or '.join(names)} is needed"
            )
    placed = [about_origin(circle) for circle in circles]
    center, _ = circle_fit(np.concatenate([c.x for c in placed]), np.concatenate([c.y for c in placed]))
    data = [
        Rows(np.arctan2(c.y - center[1], c.x - center[0]), np.hypot(c.x, c.y) - c.radius, c.direction, c.feed, c.radius)
        for c in placed
    ]
    fit = Fit(data, names, dict(pitch or {}), backlash == "stands")
    measured = {
        axis: (float(min(np.min(row) for row in rows)), float(max(np.max(row) for row in rows)))
        for axis, rows in zip(names, ([c.x for c in circles], [c.y for c in circles]), strict=True)
    }
    if spike == "free":
        found = _result(fit.settled(None), figures.largest.G)
    else:
        found = _result(fit.settled(fit.best_decay() if decay is None else decay), figures.largest.G)
    return replace(found, measured=measured)


def _result(solved: Solved, G: float) -> CircleCauses:
    """Return all causes with their effects and the residual of each circle."""
    x, y = solved.names
    decay = solved.decay
    plain = [name for name in solved.labels if not name.startswith(("screw ", "spike "))]
    causes = [_cause(solved, name, [name], solved.value(name), solved.error(name), G) for name in plain]
    for axis in (x, y):
        pair = [name for name in solved.labels if name.startswith(f"screw {axis} ")]
        if pair:
            values = [solved.value(name) for name in pair]
            size = float(np.linalg.norm(values))
            errors = [solved.error(name) for name in pair]
            error = float(np.linalg.norm([v * e for v, e in zip(values, errors, strict=True)])) / (size or 1.0)
            causes.append(_cause(solved, f"screw error {axis}", pair, size, error or max(errors), G))
    spikes = [_spike(solved, axis, i) for axis in (x, y) for i in range(len(solved.feeds))] if decay is None else []
    for axis in (x, y) if decay is None else ():
        hats = [name for name in solved.labels if name.startswith(f"spike {axis} ")]
        highest = max((spike for spike in spikes if spike.axis == axis), key=lambda spike: abs(spike.peak))
        first = next(name for name in hats if solved.labels.index(name) in solved.kept)
        error = float(np.median([solved.error(name) for name in hats if solved.labels.index(name) in solved.kept]))
        cause = _cause(solved, f"reversal spike {axis}", hats, highest.peak, error, G, like=first)
        causes.append(cause._replace(effect=abs(highest.peak)))
    left = np.split(solved.residual, solved.ends)
    rms = float(np.sqrt(np.mean(solved.residual**2)))
    return CircleCauses(tuple(causes), tuple(spikes), rms, solved.condition, decay, solved.passes, tuple(left))


def _cause(
    solved: Solved, name: str, columns: list[str], value: float, error: float, G: float, like: str | None = None
) -> Cause:
    drawn = solved.drawn(columns)
    effect = max(float(np.max(np.abs(column))) for column in drawn)
    share = max(float(np.ptp(column)) for column in drawn) / G if G > 0.0 else 0.0
    index = solved.labels.index(columns[0] if like is None else like)
    others = list(dict.fromkeys(_named(solved, i) for i in solved.unseparable.get(index, [])))
    others = [other for other in others if other != name]
    note = f"not separable from {', '.join(others)}: {_remedy(solved)}" if others else ""
    if not note and not solved.seen[index]:
        note = "these circles do not show it"
    return Cause(name, value, float("inf") if note else error, solved.units[columns[0]], effect, share, note)


def _named(solved: Solved, i: int) -> str:
    """Return the name of the cause to which a column belongs."""
    words = solved.labels[i].split(" ")
    if words[0] == "screw":
        return f"screw error {words[1]}"
    return f"reversal spike {words[1]}" if words[0] == "spike" else solved.labels[i]


def _remedy(solved: Solved) -> str:
    """Return a text that names the additional circles needed to separate the causes."""
    there = {rows.d for rows in solved.data}
    missing = [f"run {DIRECTIONS[d]}" for d in (1, -1) if d not in there]
    missing += ["run a second feed"] if len(solved.feeds) == 1 else []
    return ", ".join(missing) or "run another radius"


def _spike(solved: Solved, axis: str, place: int) -> Spike:
    """Return the mean outward deviation after the reversals of an axis at a feed, with all other causes removed."""
    first = axis == solved.names[0]
    feed = solved.feeds[place]
    hats = [name for name in solved.labels if name.startswith(f"spike {axis} ")]
    drawn, left = solved.drawn(hats), np.split(solved.residual, solved.ends)
    places: list[np.ndarray] = []
    heights: list[np.ndarray] = []
    reach = window(feed / solved.data[0].R)
    for rows, spike, rest in zip(solved.data, drawn, left, strict=True):
        if abs(rows.V - feed) > 0.02 * feed:
            continue
        ahead = rows.d * rows.turning * solved.shape.mismatch
        since = (
            since_reversal(rows.angle - ahead, rows.d, 0.0)
            if first
            else since_reversal(rows.angle + ahead, rows.d, 0.5 * np.pi)
        )
        inside = since < reach
        # The fit is radial, the spike an error along its axis: divided by the projection.
        part = np.abs(np.cos(rows.angle) if first else np.sin(rows.angle))
        places.append(since[inside])
        heights.append((spike + rest)[inside] / part[inside])
    count = max(8, round(reach * len(solved.data[0].angle) / (2.0 * np.pi)))
    edges = np.linspace(0.0, reach, count + 1)
    which = np.clip(np.searchsorted(edges, np.concatenate(places), side="right") - 1, 0, count - 1)
    number = np.bincount(which, minlength=count)
    total = np.bincount(which, weights=np.concatenate(heights), minlength=count)
    middles = 0.5 * (edges[1:] + edges[:-1])
    there = (number > 0) & (middles > max(_AT_ONCE, edges[1]))
    return Spike(axis, feed, middles[there], total[there] / number[there])

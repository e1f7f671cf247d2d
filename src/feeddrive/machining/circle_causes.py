"""The causes of the deviations of circles: scale, squareness, lag, backlash, reversal spikes and screws.

All circles enter one linear least-squares fit with one column per cause: the deviation it produces on each circle.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import UNIT, Cell, Column, Result, Table
from feeddrive.machining.circle_test import DIRECTIONS, CirclePath, about_origin, circle_fit, circle_test

PASSES = 30
_NULL = 1e-7  # singular value of a combination that the circles do not show, of the largest
_PART = 0.02  # of such a combination: a column with less is not part of it
_NODES = 24  # of the free course of a spike after a reversal
_DECAYS = (1e-3, 0.2)  # s, of a spike
_WINDOW = 0.25  # s after a reversal in which a spike may last
_WIDEST = np.radians(50.0)
_NARROWEST = np.radians(4.0)
_CORRELATED = 36  # blocks of a circle within which residuals may be alike


class Rows(NamedTuple):
    """A circle: polar angle about the fitted center, deviation about the set-up center, direction, feed, radius."""

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
    """The fit problem: circles, axis names, screw pitches, and True if the table stands still within a backlash."""

    data: list[Rows]
    names: tuple[str, str]
    pitches: Mapping[str, float]
    stands: bool

    def best_decay(self) -> float:
        """Return the decay with the smallest residual, by a coarse grid and a search around its best value."""
        from scipy.optimize import minimize_scalar  # not for commands that only read

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
        """Iterate passes with the lag mismatch and backlash of the previous one until they converge."""
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
    """The parameters that a pass takes from the previous one: lag mismatch, s, and the gap of each axis, m."""

    mismatch: float
    gaps: tuple[float, float]

    def near(self, other: Shape) -> bool:
        """Return True if two passes agree within the tolerances of convergence."""
        away = abs(self.mismatch - other.mismatch) <= 1e-9 * abs(self.mismatch) + 1e-12
        return away and all(abs(a - b) <= 1e-4 * a + 1e-9 for a, b in zip(self.gaps, other.gaps, strict=True))


def since_reversal(phase: np.ndarray, d: int, reversal: float) -> np.ndarray:
    """Return the angle since the last of an axis's two reversals per turn."""
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
        """Return independent columns: the last one of each combination that the circles do not excite is dropped."""
        kept = np.flatnonzero(self.seen)
        while True:
            _, sizes, right = np.linalg.svd(self._triangle[:, kept], full_matrices=False)
            if sizes[-1] > _NULL * sizes[0]:
                return kept
            part = np.max(np.abs(right[sizes <= _NULL * sizes[0]]), axis=0) > _PART
            kept = np.delete(kept, np.flatnonzero(part)[-1])

    @cached_property
    def unseparable(self) -> dict[int, list[int]]:
        """The columns from which each column cannot be separated."""
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
                for k, hat in enumerate(_hats(since[axis], window(feed / R))):
                    columns[f"spike {axis} {i} {k}"] = ("m", hat * np.abs(part) if here else np.zeros_like(hat))
        self.units |= {name: unit for name, (unit, _) in columns.items()}
        return {name: column for name, (_, column) in columns.items()}

    @cached_property
    def covariance(self) -> np.ndarray:
        """The covariance of the kept columns, for residuals correlated within blocks: (A'A)⁻¹ Σ g g' (A'A)⁻¹."""
        scores = (self.design[:, self.kept] / self.scale[self.kept]) * self.residual[:, None]
        middle = np.zeros((len(self.kept), len(self.kept)))
        begin = 0
        for rows in self.data:
            own = scores[begin : begin + len(rows.angle)]
            begin += len(rows.angle)
            width = max(1, len(own) // _CORRELATED)
            around = np.cumsum(np.vstack([np.zeros((1, own.shape[1])), own, own[:width]]), axis=0)
            blocks = around[width : width + len(own)] - around[: len(own)]
            middle += blocks.T @ blocks / width
        n, k = self.design.shape[0], len(self.kept)
        return self._inverse @ middle @ self._inverse * (n / max(n - k, 1))

    def value(self, name: str) -> float:
        """Return the fitted value of a column, 0 if it was dropped."""
        return float(self.solution[self.labels.index(name)])

    def error(self, name: str) -> float:
        """Return the standard error of a column; inf if it cannot be separated."""
        i = self.labels.index(name)
        if i in self.unseparable or i not in self.kept:
            return float("inf")
        k = int(np.flatnonzero(self.kept == i)[0])
        return float(np.sqrt(max(self.covariance[k, k], 0.0))) / float(self.scale[i])

    def drawn(self, names: Sequence[str]) -> list[np.ndarray]:
        """Return the deviation that some columns produce on each circle, m."""
        chosen = [self.labels.index(name) for name in names]
        whole = self.design[:, chosen] @ self.solution[chosen]
        return np.split(whole, np.cumsum([len(rows.angle) for rows in self.data])[:-1])


def _held(since: np.ndarray, R: float, gap: float) -> np.ndarray:
    """Return the part of a gap that a table still at rest has not yet crossed, by the angle since the reversal."""
    if gap <= 0.0:
        return np.zeros_like(since)
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

    name    such as "backlash x"
    value, error  fitted value and standard error, in SI; the error is inf if the cause cannot be separated
    unit    SI
    effect  the largest radial deviation that it produces on one of the circles, m
    share   of G: peak-to-peak of its deviation over that of the total, on the circle where it is largest
    note    the causes that it cannot be separated from, and the test to run; else empty
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

    axis, feed  feed in m/s
    angle       since the reversal, rad, shape (n,)
    height      outward deviation, mean over the reversals, m, shape (n,); starting 0.2° after the reversal
    """

    axis: str
    feed: float
    angle: np.ndarray
    height: np.ndarray

    @property
    def peak(self) -> float:
        """The deviation of the largest magnitude, m, signed."""
        return float(self.height[int(np.argmax(np.abs(self.height)))])

    @property
    def peak_angle(self) -> float:
        """The angle of the peak after the reversal, rad."""
        return float(self.angle[int(np.argmax(np.abs(self.height)))])


@dataclass(frozen=True, eq=False, repr=False)
class CircleCauses(Result):
    """The causes of the radial deviations of circles, and the residual.

    causes    all fitted causes
    spikes    after the reversals of each axis at each feed
    residual  RMS of the residual, m
    condition condition number of the separable columns: the ratio of the largest and smallest singular value
    decay     time constant of an exponential spike, s; None for a free shape
    passes    number of passes until the phases of the reversals converged
    left      residual over the points of each circle, m
    """

    causes: tuple[Cause, ...]
    spikes: tuple[Spike, ...]
    residual: float
    condition: float
    decay: float | None
    passes: int
    left: tuple[np.ndarray, ...]

    def __getitem__(self, name: str) -> Cause:
        for cause in self.causes:
            if cause.name == name:
                return cause
        raise ParameterError(f"there is no cause '{name}'; there are {', '.join(cause.name for cause in self.causes)}")

    @property
    def ranked(self) -> list[Cause]:
        """The causes, largest effect first, without the set-up offset, which is not an error of the machine."""
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

    spike  "free": any shape after a reversal, the same for both reversals of an axis and both directions, at each
           feed; "exponential": g exp(-t/decay) after each reversal
    backlash  "stands": with the loop closed by the motor encoder the table stands still until the gap is crossed, over
           √(2B/R) rad; "step": the table changes sides at the reversal
    decay  s, of an exponential spike; default: the one with the smallest residual
    pitch  of the screw of an axis, m, by axis: without it no screw error is fitted

    The columns are those of ISO 230-4 tests to first order, with d the direction, θ the polar angle, outward positive:
    scale R s, squareness (R q/2) sin 2θ, lag -(V²/2R)(κ_mean + Δκ/2 cos 2θ), its mismatch d (V/2) Δτ sin 2θ, backlash
    ±B/2 along each axis, turning over at the reversals of that axis: θ = d (V/R) Δτ for x and 90° - d (V/R) Δτ for y,
    with Δτ of the previous pass.  Standard errors are valid for residuals correlated over 10°.

    Causes that the circles cannot separate are named, with the circle that would separate them; the first one has their
    sum.  Raises ParameterError as `circle_test`, and for an unknown spike and a pitch that is not > 0.
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
    if spike == "free":
        return _result(fit.settled(None), figures.largest.G)
    return _result(fit.settled(fit.best_decay() if decay is None else decay), figures.largest.G)


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
    left = np.split(solved.residual, np.cumsum([len(rows.angle) for rows in solved.data])[:-1])
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
    """Name the additional circles that would separate the causes."""
    there = {rows.d for rows in solved.data}
    missing = [f"run {DIRECTIONS[d]}" for d in (1, -1) if d not in there]
    missing += ["run a second feed"] if len(solved.feeds) == 1 else []
    return ", ".join(missing) or "run another radius"


def _spike(solved: Solved, axis: str, place: int) -> Spike:
    """Return the mean outward deviation after the reversals of an axis at a feed, with all other causes removed."""
    first = axis == solved.names[0]
    feed = solved.feeds[place]
    hats = [name for name in solved.labels if name.startswith(f"spike {axis} ")]
    drawn, left = solved.drawn(hats), np.split(solved.residual, np.cumsum([len(r.angle) for r in solved.data])[:-1])
    places: list[np.ndarray] = []
    heights: list[np.ndarray] = []
    reach = window(feed / solved.data[0].R)
    for rows, own, rest in zip(solved.data, drawn, left, strict=True):
        if abs(rows.V - feed) > 0.02 * feed:
            continue
        ahead = rows.d * rows.turning * solved.shape.mismatch
        since = (
            since_reversal(rows.angle - ahead, rows.d, 0.0)
            if first
            else since_reversal(rows.angle + ahead, rows.d, 0.5 * np.pi)
        )
        inside = since < reach
        part = np.abs(np.cos(rows.angle) if first else np.sin(rows.angle))
        places.append(since[inside])
        heights.append((own + rest)[inside] / part[inside])
    count = max(8, round(reach * len(solved.data[0].angle) / (2.0 * np.pi)))
    edges = np.linspace(0.0, reach, count + 1)
    which = np.clip(np.searchsorted(edges, np.concatenate(places), side="right") - 1, 0, count - 1)
    number = np.bincount(which, minlength=count)
    total = np.bincount(which, weights=np.concatenate(heights), minlength=count)
    middles = 0.5 * (edges[1:] + edges[:-1])
    there = (number > 0) & (middles > max(_AT_ONCE, edges[1]))
    return Spike(axis, feed, middles[there], total[there] / number[there])

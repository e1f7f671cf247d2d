"""What draws the deviations of circles: a fit of scale, squareness, lag, backlash, reversal spikes and screws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import UNIT, Cell, Column, Result, Table
from feeddrive.machining.circle_columns import Fit, Rows, Solved, since_reversal, window
from feeddrive.machining.circle_test import DIRECTIONS, CirclePath, about_origin, circle_fit, circle_test

_AT_ONCE = np.radians(0.2)  # after a reversal: what happens there is the reversal of a backlash, not a spike

_READ_IN = {"": "ppm", "rad": "urad", "s2": "ms2"}  # by SI unit, where it is not the usual unit


class Cause(NamedTuple):
    """A cause of deviations.

    name    as "backlash x"
    value, error  and standard error, in SI; the error is inf where it cannot be separated
    unit    SI
    effect  the largest radial deviation that it draws on one of the circles, m
    share   of G: the peak-to-peak of what it draws, by the peak-to-peak of all, on the circle where it is largest
    note    what it cannot be told apart from, and what to run; else empty
    """

    name: str
    value: float
    error: float
    unit: str
    effect: float
    share: float
    note: str


class Spike(NamedTuple):
    """The course after the reversals of an axis at one feed: outward deviations behind all other causes.

    axis, feed  feed in m/s
    angle       since the reversal, rad, shape (n,)
    height      outward, the mean of its reversals, m, shape (n,); from 0.2° after the reversal on
    """

    axis: str
    feed: float
    angle: np.ndarray
    height: np.ndarray

    @property
    def peak(self) -> float:
        """The largest, m, signed."""
        return float(self.height[int(np.argmax(np.abs(self.height)))])

    @property
    def peak_angle(self) -> float:
        """Where it is, rad since the reversal."""
        return float(self.angle[int(np.argmax(np.abs(self.height)))])


@dataclass(frozen=True, eq=False, repr=False)
class CircleCauses(Result):
    """The causes of what some circles show, and what is left.

    causes    all that were fitted
    spikes    after the reversals of each axis at each feed
    residual  RMS of what no cause explains, m
    condition of the fit: the ratio of its largest and least singular value, of what is separable
    decay     time in which an exponential spike falls to 1/e, s; None for a free course
    passes    in which the phases of the reversals came to rest
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
        for each in self.causes:
            if each.name == name:
                return each
        raise ParameterError(f"there is no cause '{name}'; there are {', '.join(each.name for each in self.causes)}")

    @property
    def ranked(self) -> list[Cause]:
        """The largest effect first; the offset of the set-up, which is no fault of the machine, is left out."""
        return sorted((each for each in self.causes if not each.name.startswith("set-up")), key=lambda c: -c.effect)

    def table(self) -> Table:
        """One row for each cause, the largest first."""
        rows: list[list[Cell]] = []
        for cause in self.ranked:
            unit = _READ_IN.get(cause.unit, "")
            value = Quantity(cause.value, cause.unit, form=f"4 {unit}")
            error = Quantity(cause.error, cause.unit, form=f"2 {unit}") if np.isfinite(cause.error) else None
            rows.append([cause.name, value, error, UNIT, cause.effect, cause.share, cause.note])
        columns = [
            "cause", "value", "+-", "unit", Column("draws", "m"), Column("of G", "share", "3"),
            Column("", sentences=True),
        ]  # fmt: skip
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

    spike  "free": any course after a reversal, the same for both reversals of an axis and both directions, at each
           feed; "exponential": g exp(-t/decay) after each reversal
    backlash  "stands": behind a motor whose encoder closes the loop the table stands until the gap is crossed, over
           √(2B/R) rad; "step": it changes sides at the reversal
    decay  s, of an exponential spike; default: the one that leaves least
    pitch  of the screw of an axis, m, by axis: without it no screw error is looked for

    The columns are those of ISO 230-4 tests to first order, with d the direction, θ the polar angle, outward positive:
    scale R s, squareness (R q/2) sin 2θ, lag -(V²/2R)(κ_mean + Δκ/2 cos 2θ), its mismatch d (V/2) Δτ sin 2θ, backlash
    ±B/2 along each axis, turning over at the reversals of that axis: θ = d (V/R) Δτ for x and 90° - d (V/R) Δτ for y,
    with Δτ of the pass before.  Standard errors hold for residuals that are alike over 10°.

    What the circles cannot tell apart is named, with the circle that would; its sum stands at the first of them.
    Raises ParameterError as `circle_test`, and for another spike and a pitch that is not > 0.
    """
    figures = circle_test(circles)
    names = circles[0].axes
    for what, value, options in (
        ("spike", spike, ("free", "exponential")), ("backlash", backlash, ("stands", "step")),
    ):  # fmt: skip
        if value not in options:
            raise ParameterError(f"{what} = {value!r} must be one of {', '.join(options)}")
    for axis, length in (pitch or {}).items():
        if axis not in names or not 0.0 < length < float("inf"):
            raise ParameterError(
                f"pitch of '{axis}' = {Quantity(length, 'm'):6 SI}: a pitch > 0 m of {' or '.join(names)} is needed"
            )
    placed = [about_origin(each) for each in circles]
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
    """All causes, with their effects."""
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
        highest = max((each for each in spikes if each.axis == axis), key=lambda each: abs(each.peak))
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
    effect = max(float(np.max(np.abs(each))) for each in drawn)
    share = max(float(np.ptp(each)) for each in drawn) / G if G > 0.0 else 0.0
    index = solved.labels.index(columns[0] if like is None else like)
    others = list(dict.fromkeys(_named(solved, i) for i in solved.unseparable.get(index, [])))
    others = [each for each in others if each != name]
    note = f"not separable from {', '.join(others)}: {_remedy(solved)}" if others else ""
    if not note and not solved.seen[index]:
        note = "these circles do not show it"
    return Cause(name, value, float("inf") if note else error, solved.units[columns[0]], effect, share, note)


def _named(solved: Solved, i: int) -> str:
    """The cause of a column."""
    words = solved.labels[i].split(" ")
    if words[0] == "screw":
        return f"screw error {words[1]}"
    return f"reversal spike {words[1]}" if words[0] == "spike" else solved.labels[i]


def _remedy(solved: Solved) -> str:
    """The circles that are missing."""
    there = {rows.d for rows in solved.data}
    missing = [f"run {DIRECTIONS[d]}" for d in (1, -1) if d not in there]
    missing += ["run a second feed"] if len(solved.feeds) == 1 else []
    return ", ".join(missing) or "run another radius"


def _spike(solved: Solved, axis: str, place: int) -> Spike:
    """The mean outward deviation after the reversals of an axis at a feed, behind all other causes."""
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
        since = since_reversal(rows.angle - ahead, rows.d, 0.0) if first else since_reversal(
            rows.angle + ahead, rows.d, 0.5 * np.pi
        )  # fmt: skip
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

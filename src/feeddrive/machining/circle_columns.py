"""Circles as a linear fit: what each cause draws on each circle as a column, and the least-squares solution."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

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
    """A circle: polar angle about the fitted center, deviation about that of the set-up, direction, feed, radius."""

    angle: np.ndarray
    deviation: np.ndarray
    d: int
    V: float
    R: float

    @property
    def turning(self) -> float:
        """V/R, rad/s."""
        return self.V / self.R


class Fit(NamedTuple):
    """What is fitted: circles, names of the axes, pitches of screws, and whether the table stands in a backlash."""

    data: list[Rows]
    names: tuple[str, str]
    pitches: Mapping[str, float]
    stands: bool

    def best_decay(self) -> float:
        """The decay that leaves least: a coarse row of values, then a search between the neighbors of the best."""
        from scipy.optimize import minimize_scalar  # not for commands that only read

        grid = np.geomspace(*_DECAYS, 16)
        left = [self.settled(float(t), 4).square for t in grid]
        best = int(np.argmin(left))
        found: Any = minimize_scalar(
            lambda u: self.settled(float(np.exp(u)), 6).square,
            bounds=np.log(grid[[max(best - 1, 0), min(best + 1, len(grid) - 1)]]),
            method="bounded", options={"xatol": 1e-4},
        )  # fmt: skip
        return float(np.exp(found.x))

    def settled(self, decay: float | None, passes: int = PASSES) -> Solved:
        """Passes with lag mismatch and backlash of the pass before, until they stand."""
        shape = Shape(0.0, (0.0, 0.0))
        solved = Solved(self, shape, decay, 1)
        for count in range(2, passes + 1):
            gaps = [max(solved.value(f"backlash {axis}"), 0.0) if self.stands else 0.0 for axis in self.names]
            found = Shape(solved.value("lag mismatch"), (gaps[0], gaps[1]))
            if found.near(shape):
                break
            shape = found
            solved = Solved(self, shape, decay, count)
        return solved


class Shape(NamedTuple):
    """What the columns of a pass take from the one before: lag mismatch, s, and the gap of each axis, m."""

    mismatch: float
    gaps: tuple[float, float]

    def near(self, other: Shape) -> bool:
        """Whether another pass changes nothing."""
        away = abs(self.mismatch - other.mismatch) <= 1e-9 * abs(self.mismatch) + 1e-12
        return away and all(abs(a - b) <= 1e-4 * a + 1e-9 for a, b in zip(self.gaps, other.gaps, strict=True))


def since_reversal(phase: np.ndarray, d: int, reversal: float) -> np.ndarray:
    """The angle that an axis has gone since its last reversal, of two half a turn apart."""
    return np.mod(d * (phase - reversal), np.pi)


class Solved:
    """One pass: the columns of all circles, and their least-squares solution."""

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
        """The columns without the last one of each combination that the circles do not show."""
        kept = np.flatnonzero(self.seen)
        while True:
            _, sizes, right = np.linalg.svd(self._triangle[:, kept], full_matrices=False)
            if sizes[-1] > _NULL * sizes[0]:
                return kept
            part = np.max(np.abs(right[sizes <= _NULL * sizes[0]]), axis=0) > _PART
            kept = np.delete(kept, np.flatnonzero(part)[-1])

    @cached_property
    def unseparable(self) -> dict[int, list[int]]:
        """The columns that each column cannot be told apart from."""
        found: dict[int, list[int]] = {}
        for i in np.flatnonzero(self.seen):
            if i in self.kept:
                continue
            parts = np.linalg.lstsq(self._triangle[:, self.kept], self._triangle[:, i], rcond=None)[0]
            together = [int(i), *(int(k) for k in self.kept[np.abs(parts) > _PART])]
            for each in together:
                found.setdefault(each, []).extend(k for k in together if k != each)
        return found

    def _columns(self, rows: Rows, pitches: Mapping[str, float]) -> dict[str, np.ndarray]:
        x, y = self.names
        angle, d, V, R = rows.angle, rows.d, rows.V, rows.R
        ahead = d * rows.turning * self.shape.mismatch
        at_x, at_y = angle - ahead, angle + ahead
        cos, sin = np.cos(angle), np.sin(angle)
        since = {x: since_reversal(at_x, d, 0.0), y: since_reversal(at_y, d, 0.5 * np.pi)}
        held = [_held(since[axis], R, gap) for axis, gap in zip(self.names, self.shape.gaps, strict=True)]
        one = np.ones_like(angle)
        found = {
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
                found[f"screw {axis} sine"] = ("m", np.sin(wave) * part)
                found[f"screw {axis} cosine"] = ("m", np.cos(wave) * part)
        for axis, part in ((x, cos), (y, sin)):
            if self.decay is not None:
                course = np.exp(-since[axis] / (rows.turning * self.decay))
                found[f"reversal spike {axis}"] = ("m", course * np.abs(part))
                continue
            for i, feed in enumerate(self.feeds):
                here = abs(rows.V - feed) <= 0.02 * feed
                for k, hat in enumerate(_hats(since[axis], window(feed / R))):
                    found[f"spike {axis} {i} {k}"] = ("m", hat * np.abs(part) if here else np.zeros_like(hat))
        self.units |= {name: unit for name, (unit, _) in found.items()}
        return {name: column for name, (_, column) in found.items()}

    @cached_property
    def covariance(self) -> np.ndarray:
        """Of the kept columns, for residuals that are alike within blocks: (A'A)⁻¹ Σ g g' (A'A)⁻¹."""
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
        """The fitted value of a column, 0 where it was dropped."""
        return float(self.solution[self.labels.index(name)])

    def error(self, name: str) -> float:
        """Its standard error; inf where it cannot be separated."""
        i = self.labels.index(name)
        if i in self.unseparable or i not in self.kept:
            return float("inf")
        k = int(np.flatnonzero(self.kept == i)[0])
        return float(np.sqrt(max(self.covariance[k, k], 0.0))) / float(self.scale[i])

    def drawn(self, names: Sequence[str]) -> list[np.ndarray]:
        """What some columns draw on each circle, m."""
        chosen = [self.labels.index(name) for name in names]
        whole = self.design[:, chosen] @ self.solution[chosen]
        return np.split(whole, np.cumsum([len(rows.angle) for rows in self.data])[:-1])


def _held(since: np.ndarray, R: float, gap: float) -> np.ndarray:
    """The part of a gap, by the angle since the reversal, by which a table that still stands is off the step."""
    if gap <= 0.0:
        return np.zeros_like(since)
    return np.maximum(0.0, 1.0 - since**2 * (0.5 * R / gap))


def distinct_feeds(data: list[Rows]) -> list[float]:
    """The feeds of all circles, those that differ by 2 % at most as one."""
    found: list[float] = []
    for rows in data:
        if not any(abs(rows.V - feed) <= 0.02 * feed for feed in found):
            found.append(rows.V)
    return found


def window(turning: float) -> float:
    """The angle after a reversal in which a spike may last, rad."""
    return float(np.clip(_WINDOW * turning, _NARROWEST, _WIDEST))


def _hats(since: np.ndarray, window: float) -> list[np.ndarray]:
    """Piecewise straight courses over the angle since a reversal, finer at its begin, 0 from the window's end on."""
    nodes = window * (np.arange(_NODES + 1) / _NODES) ** 1.5
    return [np.interp(since, nodes, row, right=0.0) for row in np.eye(_NODES + 1)[:_NODES]]

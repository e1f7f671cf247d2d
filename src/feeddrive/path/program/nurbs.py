"""NURBS (G5.2 and G6.2) as Bezier curves of at most third degree.

    r(t) = Σ w_i N_i(t) P_i / Σ w_i N_i(t)          N_i: B-splines of order k over the knots

Knots are inserted until each span is a Bezier curve (Boehm 1980).  With equal weights and k <= 4 this is exact.
Otherwise a span is halved until the cubic Hermite curve B of its ends is within `TOLERANCE`, which is proven:
N - w B is a polynomial of degree k + 2 for the numerator N and the denominator w, and

    |r - B| <= max |Bernstein points of N - w B| / min weight
"""

import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np

from feeddrive.language.quantity import Quantity
from feeddrive.path.program.blocks import BlockError

TOLERANCE = 1e-4
"""The largest distance of a cubic curve from a rational curve or one of higher degree, mm (and degrees)."""
HIGHEST_ORDER = 11
MOST_POINTS = 20_000
"""The largest number of control points of one curve, which are held in memory."""
_MOST_HALVINGS = 40

Points = np.ndarray
"""Control points of a Bezier curve, shape (degree + 1, N)."""


class Nurbs:
    """The control points, weights and knots of a curve that is being read.

    name   G5.2 or G6.2
    order  degree + 1
    """

    def __init__(self, name: str, order: int) -> None:
        self.name, self.order = name, order
        self.points: list[list[float]] = []
        self.weights: list[float] = []
        self.knots: list[float] = []

    def add(self, point: Sequence[float], weight: float) -> None:
        """Add a control point with its weight; raise BlockError for a weight that is not positive."""
        if not weight > 0.0:
            letter = "P" if self.name == "G5.2" else "R"
            raise BlockError(f"a weight of {self.name} lies above 0, not {Quantity(weight):6}: correct it", letter)
        if len(self.points) >= MOST_POINTS:
            raise BlockError(f"a curve of {self.name} has at most {MOST_POINTS} control points: split it", self.name)
        self.points.append(list(point))
        self.weights.append(weight)

    def pieces(self, unit: float) -> Iterator[Points]:
        """Yield the curve as Bezier curves of first to third degree; `unit`: mm per unit of the points.

        Raises BlockError for too few control points, and for knots that define no curve.
        """
        order, count = self.order, len(self.points)
        if count < order:
            raise BlockError(
                f"a curve of order {order} needs {order} control points at least, with the one at its start: this one "
                f"has {count}",
                self.name,
            )
        knots = self._checked()
        weights = np.array(self.weights)
        points = np.column_stack([np.array(self.points) * weights[:, None], weights])
        exact = order <= 4 and bool(np.all(weights == weights[0]))
        for span in _spans(points, knots, order):
            if exact:
                yield span[:, :-1] / weights[0]
            else:
                yield from _cubics(span, TOLERANCE / unit)

    def _checked(self) -> list[float]:
        """Return the knots, from 0 with equal steps if none were given. Raise BlockError for wrong ones."""
        order, count = self.order, len(self.points)
        if not self.knots:
            return [*[0.0] * order, *(float(k) for k in range(1, count - order + 1)), *[count - order + 1.0] * order]
        knots = self.knots
        if len(knots) != count + order:
            raise BlockError(
                f"{count} control points of order {order} need {count + order} knots, this curve has {len(knots)}: "
                "write K in each of its blocks, and then blocks with K alone",
                "K",
            )
        if any(b < a for a, b in itertools.pairwise(knots)):
            raise BlockError("the knots of a curve never fall: correct K", "K")
        if knots[0] != knots[order - 1] or knots[-1] != knots[-order]:
            raise BlockError(
                f"the first {order} knots of a curve of order {order} are equal, and so are its last {order}: only "
                "then does it begin and end at its control points",
                "K",
            )
        inner = knots[order:count]
        if (
            any(a == b for a, b in zip(inner, inner[order - 1 :], strict=False))
            or knots[0] in inner
            or knots[-1] in inner
        ):
            raise BlockError(f"the curve breaks at a knot that stands there {order} times: write two curves", "K")
        return knots


def _spans(points: Points, knots: list[float], order: int) -> Iterator[Points]:
    """Yield the Bezier points of each span of a B-spline with these control points."""
    degree = order - 1
    # one span at a time, with the control points that count for it: the memory does not grow with the curve
    for index in range(degree, len(points)):
        low, high = knots[index], knots[index + 1]
        if low == high:
            continue
        local, around = points[index - degree : index + 1].copy(), list(knots[index - degree + 1 : index + degree + 1])
        # blossoms: the Bezier point j of a span is the value of the polar form at degree - j times low, j times high
        yield np.array([_polar(local, around, [low] * (degree - j) + [high] * j) for j in range(order)])


def _polar(points: Points, knots: list[float], at: list[float]) -> np.ndarray:
    """Return the polar form of one span of a B-spline at some parameters, by de Boor's scheme."""
    degree = len(at)
    values = list(points)
    for level, t in enumerate(at):
        values = [
            ((knots[i + degree] - t) * values[i] + (t - knots[i + level]) * values[i + 1])
            / (knots[i + degree] - knots[i + level])
            for i in range(degree - level)
        ]
    return values[0]


def _cubics(span: Points, tolerance: float) -> Iterator[Points]:
    """Yield cubic curves within `tolerance` of a rational Bezier curve, in its order."""
    todo = [(span, _MOST_HALVINGS)]
    while todo:
        here, left = todo.pop()
        cubic = _hermite(here)
        if _distance(here, cubic) <= tolerance:
            yield cubic
        elif left == 0:
            raise BlockError("the weights of the curve differ too much: no cubic curve comes close to it", "G")
        else:
            first, second = _halves(here)
            todo += [(second, left - 1), (first, left - 1)]


def _hermite(span: Points) -> Points:
    """Return the cubic with the ends of a rational Bezier curve and its derivatives there."""
    degree = len(span) - 1
    weight = span[:, -1:]
    at = span[:, :-1] / weight
    # the derivative of N/w at an end: degree times w1/w0 (P1 - P0)
    begin = degree * weight[1] / weight[0] * (at[1] - at[0])
    end = degree * weight[-2] / weight[-1] * (at[-1] - at[-2])
    return np.array([at[0], at[0] + begin / 3.0, at[-1] - end / 3.0, at[-1]])


def _distance(span: Points, cubic: Points) -> float:
    """Return a bound on the distance of a rational Bezier curve from a cubic at the same parameters."""
    degree = len(span) - 1
    whole = degree + 3
    # N raised by three degrees, and the product w B, in Bernstein form
    one = np.ones((4, 1))
    difference = _product(span[:, :-1], one, degree, whole) - _product(cubic, span[:, -1:], 3, whole)
    return float(np.max(np.linalg.norm(difference, axis=1)) / np.min(span[:, -1]))


def _product(points: Points, factors: np.ndarray, degree: int, whole: int) -> Points:
    """Return the Bernstein points of the product of a curve of `degree` and a polynomial of degree `whole - degree`."""
    rest = whole - degree
    out = np.zeros((whole + 1, points.shape[1]))
    for i in range(degree + 1):
        for j in range(rest + 1):
            share = math.comb(degree, i) * math.comb(rest, j) / math.comb(whole, i + j)
            out[i + j] += share * points[i] * factors[j]
    return out


def _halves(span: Points) -> tuple[Points, Points]:
    """Split a Bezier curve in the middle, by de Casteljau's construction."""
    left, right = [span[0]], [span[-1]]
    row = span
    while len(row) > 1:
        row = 0.5 * (row[:-1] + row[1:])
        left.append(row[0])
        right.append(row[-1])
    return np.array(left), np.array(right[::-1])

"""Enclosures of traced numbers over cells of a variable: polynomials with a bound on everything else.

    |y(t, u) - Σₖ termₖ tᵏ - Σᵢ (slope₂ᵢ + slope₂ᵢ₊₁ t) uᵢ| <= rest   for all -1 <= t <= 1 and -1 <= uᵢ <= 1

A number is a Taylor model over many cells at once, of order four in t and of first order in each of the others,
alone and times t.  The bound
includes the rounding of its own arithmetic, which is that of float64.  A comparison whose outcome differs within a cell
has the hull of both outcomes; where that is unbounded the cell splits into two branches, each of which encloses the
numbers at the points of the cell that take this branch.

Source: Makino & Berz 2003 (Taylor models); Higham 2002, chapter 3 (bounds of rounding).
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from feeddrive.language.errors import ParameterError
from feeddrive.language.graph import Graph, arguments, reachable

ORDER = 4  # of the polynomials in t: over a hundredth of a number's own size the next term is 1e-10 of it
# of every magnitude: 16 roundings of 2^-53, more than one operation commits in any of its terms
_ROUND = 2.0**-49
_ELEMENTARY = 2.0**-48  # relative error of an elementary function, at most 16 units in the last place
_MOST_BRANCHES = 3  # comparisons without a common outcome in one cell: two branches each


class Enclosed(NamedTuple):
    """A number over cells: terms of shape (1 to ORDER + 1, cells), slope (2 others, cells) or None, rest (cells,).

    A single cell stands for all cells.
    """

    terms: np.ndarray
    slope: np.ndarray | None
    rest: np.ndarray

    @staticmethod
    def exactly(value: float | np.ndarray) -> "Enclosed":
        """Return a number that is known exactly and does not depend on any variable."""
        value = np.atleast_1d(np.asarray(value, float))
        return Enclosed(value[None], None, np.zeros(1))

    @property
    def value(self) -> np.ndarray:
        """The number at the middle, shape (cells,)."""
        return self.terms[0]

    @property
    def reach(self) -> np.ndarray:
        """The largest distance from the value."""
        moved = self.rest + _widths(self.slope)
        return moved if len(self.terms) == 1 else (moved + np.sum(np.abs(self.terms[1:]), axis=0)) * (1.0 + _ROUND)

    @property
    def size(self) -> np.ndarray:
        """An upper bound of the magnitude."""
        return np.abs(self.value) + self.reach

    @property
    def low(self) -> np.ndarray:
        """A lower bound."""
        reach = self.reach
        return self.value - reach - _ROUND * (np.abs(self.value) + reach) * (reach > 0.0)

    @property
    def high(self) -> np.ndarray:
        """An upper bound."""
        reach = self.reach
        return self.value + reach + _ROUND * (np.abs(self.value) + reach) * (reach > 0.0)

    @property
    def is_zero(self) -> bool:
        """True if the number is exactly 0 in all cells."""
        return self.terms.size == 1 and self.terms[0, 0] == 0.0 and self.slope is None and not np.any(self.rest)

    def take(self, which: np.ndarray) -> "Enclosed":
        """Return the number in some of the cells."""
        parts = (part if part is None or part.shape[-1] == 1 else part[..., which] for part in self)
        return Enclosed(*parts)  # type: ignore[arg-type]

    def plus(self, other: "Enclosed") -> "Enclosed":
        """Return the sum."""
        if self.is_zero:
            return other
        if other.is_zero:
            return self
        a, b = (self, other) if len(self.terms) >= len(other.terms) else (other, self)
        low = a.terms[: len(b.terms)] + b.terms
        terms = low if len(a.terms) == len(b.terms) else np.concatenate([low, _wide(a.terms, low)[len(b.terms) :]])
        return _rounded(terms, _sum(a.slope, b.slope), a.rest + b.rest)

    def negative(self) -> "Enclosed":
        """Return the negative."""
        return Enclosed(-self.terms, None if self.slope is None else -self.slope, self.rest)

    def times(self, other: "Enclosed") -> "Enclosed":
        """Return the product."""
        if self.is_zero or other.is_zero:
            return Enclosed.exactly(0.0)
        a, b = self, other
        count = len(a.terms) + len(b.terms) - 1
        cells = max(a.terms.shape[1], b.terms.shape[1])
        whole = np.zeros((count, cells))
        for k, term in enumerate(a.terms):
            whole[k : k + len(b.terms)] += term * b.terms
        sizes = [np.sum(np.abs(x.terms), axis=0) for x in (a, b)]
        widths = [_widths(x.slope) for x in (a, b)]
        rest = np.sum(np.abs(whole[ORDER + 1 :]), axis=0)
        rest = rest + _beyond(a, sizes[1], b) + _beyond(b, sizes[0], a)
        rest = rest + widths[0] * widths[1] + a.rest * (sizes[1] + widths[1] + b.rest) + b.rest * (sizes[0] + widths[0])
        slope = _sum(_scaled(a.slope, b.terms), _scaled(b.slope, a.terms))
        lost = _ROUND * (sizes[0] + widths[0]) * (sizes[1] + widths[1])
        rest = rest * (1.0 + _ROUND) + lost
        # 0 times infinity is no bound
        return Enclosed(whole[: ORDER + 1], slope, np.where(np.isnan(rest), np.inf, rest))

    def inverse(self) -> "Enclosed":
        """Return 1/y; the rest is infinite where y may be 0."""
        return self.through(*_FUNCTIONS["inverse"])

    def through(self, series: Callable[[Any], Sequence[Any]], next_: Callable[[Any, Any], Any]) -> "Enclosed":
        """Return f(y): `series` has the terms of its Taylor series at a number, `next_` bounds the one behind them.

        `next_` bounds |f⁽ⁿ⁾|/n! for n = ORDER + 1 between two numbers; it is infinite where f is not smooth.
        """
        with np.errstate(all="ignore"):
            factors = series(self.value)
            reach = self.reach
            away = Enclosed(np.concatenate([np.zeros_like(self.terms[:1]), self.terms[1:]]), self.slope, self.rest)
            total = Enclosed(np.atleast_1d(factors[-1])[None], None, _ELEMENTARY * np.abs(factors[-1]))
            for factor in factors[-2::-1]:
                near = total.times(away)
                total = near.plus(Enclosed(np.atleast_1d(factor)[None], None, _ELEMENTARY * np.abs(factor)))
            bound = np.where(reach > 0.0, next_(self.low, self.high) * reach ** (ORDER + 1), 0.0)
            rest = total.rest + bound * (1.0 + _ELEMENTARY)
            there = np.all(np.isfinite(total.terms), axis=0) & np.isfinite(rest)
        return Enclosed(np.where(there, total.terms, 0.0), total.slope, np.where(there, rest, np.inf))

    def hull(self, other: "Enclosed") -> "Enclosed":
        """Return an enclosure of both numbers."""
        low, high = np.minimum(self.low, other.low), np.maximum(self.high, other.high)
        middle = 0.5 * (low + high)
        rest = np.maximum(high - middle, middle - low) * (1.0 + _ROUND)
        there = np.isfinite(middle)
        return Enclosed(np.where(there, middle, 0.0)[None], None, np.where(there, rest, np.inf))


def _wide(terms: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.broadcast_to(terms, (len(terms), max(terms.shape[1], other.shape[1])))


def _sum(a: np.ndarray | None, b: np.ndarray | None) -> np.ndarray | None:
    return b if a is None else a if b is None else a + b


def _scaled(slope: np.ndarray | None, terms: np.ndarray) -> np.ndarray | None:
    """Return the slopes of the product with a polynomial."""
    if slope is None:
        return None
    scaled = slope * terms[0]
    if len(terms) > 1:
        scaled[1::2] += slope[::2] * terms[1]
    return scaled


def _beyond(x: Enclosed, size: np.ndarray, other: Enclosed) -> np.ndarray:
    """Return a bound of what `_scaled` leaves out; `size` is the sum of the magnitudes of the other's terms."""
    if x.slope is None or len(other.terms) == 1:
        return np.zeros(1)
    rest = size - np.abs(other.terms[0])
    second = np.sum(np.abs(other.terms[2:]), axis=0)
    return _widths(x.slope[::2]) * second + _widths(x.slope[1::2]) * rest * (1.0 + _ROUND)


def _widths(slope: np.ndarray | None) -> np.ndarray:
    return np.zeros(1) if slope is None else np.sum(np.abs(slope), axis=0)


def _rounded(terms: np.ndarray, slope: np.ndarray | None, rest: np.ndarray) -> Enclosed:
    return Enclosed(terms, slope, rest + _ROUND * (np.sum(np.abs(terms), axis=0) + _widths(slope) + rest))


class Truth(NamedTuple):
    """A truth value over cells: whether it may be true, and whether it may be false."""

    may: np.ndarray
    may_not: np.ndarray


def _where(condition: Truth, a: Enclosed, b: Enclosed) -> Enclosed:
    """Return `a` where the condition is true and `b` where it is false; an enclosure of both where it is undecided."""
    if not np.any(condition.may_not):
        return a
    if not np.any(condition.may):
        return b
    both = a.hull(b)
    cells = max(x.shape[-1] for x in (condition.may, both.rest, a.terms, b.terms))
    others = max((len(x.slope) for x in (a, b) if x.slope is not None), default=0)
    full = [_full(x, cells, others) for x in (both, a, b)]
    may, may_not = (np.broadcast_to(x, cells) for x in condition)
    parts = [np.where(may & may_not, h, np.where(may, x, y)) for h, x, y in zip(*full, strict=True)]
    return Enclosed(parts[0], parts[1] if others else None, parts[2])


def _full(x: Enclosed, cells: int, others: int) -> Enclosed:
    """Return the number with all of its terms and slopes, for each cell apart."""
    terms = np.zeros((ORDER + 1, cells))
    terms[: len(x.terms)] = x.terms
    slope = np.zeros((others, cells)) if x.slope is None else np.broadcast_to(x.slope, (others, cells))
    return Enclosed(terms, slope, np.broadcast_to(x.rest, cells))


def _ends(f: Callable[[Any], Any]) -> Callable[[Any, Any], Any]:
    """Return the larger of f at both ends: the bound of a monotonic function."""
    return lambda low, high: np.maximum(f(low), f(high))


def _beyond_zero(f: Callable[[Any], Any]) -> Callable[[Any, Any], Any]:
    """Return f at the end nearer to 0, which must not be between both ends."""

    def bound(low: Any, high: Any) -> Any:
        near = np.maximum(low, -high)
        return np.where(near > 0.0, f(np.where(near > 0.0, near, 1.0)), np.inf)

    return bound


def _positive(f: Callable[[Any], Any]) -> Callable[[Any, Any], Any]:
    return lambda low, _: np.where(low > 0.0, f(np.where(low > 0.0, low, 1.0)), np.inf)


def _inverse(x: Any) -> list[Any]:
    return [1.0 / x, -(x**-2.0), x**-3.0, -(x**-4.0), x**-5.0]


def _exp(x: Any) -> list[Any]:
    e = np.exp(x)
    return [e, e, e / 2.0, e / 6.0, e / 24.0]


def _sine(x: Any, quarters: int) -> list[Any]:
    turned = [np.sin(x), np.cos(x), -np.sin(x), -np.cos(x)]
    return [turned[(quarters + k) % 4] / factorial for k, factorial in enumerate((1.0, 1.0, 2.0, 6.0, 24.0))]


def _root(x: Any) -> list[Any]:
    r = np.sqrt(x)
    return [r, 0.5 / r, -0.125 * r**-3.0, 0.0625 * r**-5.0, -0.0390625 * r**-7.0]


# the Taylor terms of each function and a bound of the fifth
_FUNCTIONS: dict[str, tuple[Callable[[Any], Sequence[Any]], Callable[[Any, Any], Any]]] = {
    "inverse": (_inverse, _beyond_zero(lambda x: x**-6.0)),
    "exp": (_exp, _ends(lambda x: np.exp(x) / 120.0)),
    "expm1": (lambda x: [np.expm1(x), *_exp(x)[1:]], _ends(lambda x: np.exp(x) / 120.0)),
    "sqrt": (_root, _positive(lambda x: 0.02734375 * x**-4.5)),
    "log": (
        lambda x: [np.log(x), 1.0 / x, -0.5 * x**-2.0, x**-3.0 / 3.0, -0.25 * x**-4.0],
        _positive(lambda x: 0.2 * x**-5.0),
    ),
    "sin": (lambda x: _sine(x, 0), lambda low, _: np.full_like(low, 1.0 / 120.0)),
    "cos": (lambda x: _sine(x, 1), lambda low, _: np.full_like(low, 1.0 / 120.0)),
}


class _Forced(NamedTuple):
    """The outcome to which a comparison without a common one is forced."""

    node: int
    outcome: bool


def enclose(
    graph: Graph, ends: Sequence[int], leaves: Mapping[str, Enclosed], cells: int, others: int
) -> tuple[np.ndarray, list[Enclosed]]:
    """Return enclosures of nodes over cells: the cell of each branch, shape (branches,), and the number at each node.

    leaves  every input of the graph by name, each over all cells
    others  how many slopes there are: two for each variable beside t

    A cell has one branch, or more if comparisons have no common outcome in it and the hull of both is unbounded.
    Raises ParameterError for operations that have no enclosure: tables, rings, random numbers.
    """
    order = reachable(graph, ends)
    last = {index: place for place, index in enumerate(order)}
    for place, index in enumerate(order):
        for inner in arguments(graph.nodes[index]):
            last[inner] = place
    for end in ends:
        last[end] = len(order)

    def branches(which: np.ndarray, forced: tuple[_Forced, ...]) -> list[tuple[np.ndarray, list[Enclosed]]]:
        here = {name: x.take(which) for name, x in leaves.items()}
        with np.errstate(all="ignore"):
            values, undecided = _evaluated(graph, order, last, here, which.size, dict(forced))
        found = [_full(values[end], which.size, others) for end in ends]
        infinite = np.any([~np.isfinite(x.rest) for x in found], axis=0) if found else np.zeros(which.size, bool)
        open_ = next(((node, there) for node, there in undecided if np.any(there & infinite)), None)
        if open_ is None or len(forced) >= _MOST_BRANCHES:
            return [(which, found)]
        split = open_[1] & infinite
        kept = np.flatnonzero(~split)
        parts = [(which[kept], [x.take(kept) for x in found])] if kept.size else []
        for outcome in (True, False):
            parts += branches(which[split], (*forced, _Forced(open_[0], outcome)))
        return parts

    found = branches(np.arange(cells), ())
    cell = np.concatenate([which for which, _ in found])
    return cell, [
        Enclosed(*(np.concatenate(columns, axis=-1) for columns in zip(*(v[place] for _, v in found), strict=True)))
        for place in range(len(ends))
    ]


def _evaluated(
    graph: Graph,
    order: Sequence[int],
    last: Mapping[int, int],
    leaves: Mapping[str, Enclosed],
    cells: int,
    forced: Mapping[int, bool],
) -> tuple[dict[int, Any], list[tuple[int, np.ndarray]]]:
    """Return the numbers at the ends, and each comparison that some cells leave undecided, with a mask of these cells.

    The number of a node is dropped once no later node needs it.
    """
    values: dict[int, Any] = {}
    undecided: list[tuple[int, np.ndarray]] = []
    for place, index in enumerate(order):
        node = graph.nodes[index]
        match node[0]:
            case "const":
                values[index] = Enclosed.exactly(float.fromhex(node[1]))
            case "truth":
                values[index] = Truth(np.array([node[1]]), np.array([not node[1]]))
            case "input":
                values[index] = leaves[node[1]]
            case name:
                values[index] = _apply(name, [values[i] for i in arguments(node)])
        if node[0] in ("lt", "le", "eq"):
            if index in forced:
                values[index] = Truth(np.array([forced[index]]), np.array([not forced[index]]))
            there = values[index].may & values[index].may_not
            if np.any(there):
                undecided.append((index, np.broadcast_to(there, cells)))
        for i in arguments(node):
            if last[i] == place:
                values.pop(i, None)
    return values, undecided


def _apply(name: str, inner: Sequence[Any]) -> Any:
    match name:
        case "add":
            return inner[0].plus(inner[1])
        case "sub":
            return inner[0].plus(inner[1].negative())
        case "mul":
            return inner[0].times(inner[1])
        case "div":
            return inner[0].times(inner[1].inverse())
        case "neg":
            return inner[0].negative()
        case "abs":
            positive = Truth(inner[0].high >= 0.0, inner[0].low < 0.0)
            return _where(positive, inner[0], inner[0].negative())
        case "lt":
            return Truth(inner[0].low < inner[1].high, inner[0].high >= inner[1].low)
        case "le":
            return Truth(inner[0].low <= inner[1].high, inner[0].high > inner[1].low)
        case "eq":
            a, b = inner
            same = (a.low == a.high) & (b.low == b.high) & (a.low == b.low)
            return Truth((a.low <= b.high) & (b.low <= a.high), ~same)
        case "and":
            return Truth(inner[0].may & inner[1].may, inner[0].may_not | inner[1].may_not)
        case "or":
            return Truth(inner[0].may | inner[1].may, inner[0].may_not & inner[1].may_not)
        case "not":
            return Truth(inner[0].may_not, inner[0].may)
        case "select" if isinstance(inner[1], Truth):
            c, a, b = inner
            return Truth((c.may & a.may) | (c.may_not & b.may), (c.may & a.may_not) | (c.may_not & b.may_not))
        case "select":
            return _where(inner[0], inner[1], inner[2])
        case "floor":
            low, high = np.floor(inner[0].low), np.floor(inner[0].high)
            return Enclosed(0.5 * (low + high)[None], None, 0.5 * (high - low))
        case "quantise":
            x, step = inner
            return Enclosed(x.terms, x.slope, x.rest + 0.5 * step.size * (1.0 + _ROUND) + _ROUND * x.size)
        case "power_of_two":
            whole = inner[0].reach == 0.0
            power = np.ldexp(1.0, np.where(whole, inner[0].value, 0.0).astype(int))
            return Enclosed(power[None], None, np.where(whole, 0.0, np.inf))
        case _ if name in _FUNCTIONS:
            return inner[0].through(*_FUNCTIONS[name])
        case _:
            raise ParameterError(
                f"the loop computes '{name}', which has no enclosure over positions: leave out the block that needs it "
                "(a table, a past of a signal, noise)"
            )

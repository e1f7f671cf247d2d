"""A proof that a loop is stable and keeps a bound on Ms at every position of its travel, and up to which speed.

With the closed loop ξ(k+1) = A ξ + b w, S w = c ξ + d w, from a force w added to the command to the force of the drive,
X = [A b; c d], S the sensitivity:

    frozen:   Xᵀ diag(P, 1) X < diag(P, γ²)  and  P > 0   =>   A is stable and |S| < γ at all frequencies
    moving:   A(x)ᵀ P(x) A(x) < P(x')  for all |x - x'| <= v T   =>   ξᵀ P ξ decays along every motion up to the speed v

The first line is the bounded real lemma, the second a Lyapunov function that depends on the position: x and x' are the
positions of a sample and of the one before.

*All positions.*  Both are implied, for any G, by

    [ Π'     Xᵀ Γ       ]
    [ Γᵀ X   Γ + Γᵀ - Π ]  > 0,    Γ = diag(G, 1), Π = diag(P, 1), Π' = diag(P', γ²)

since Γ + Γᵀ - Π <= Γᵀ Π⁻¹ Γ.  This matrix is affine in X, P and P' together.  Over a cell of positions X is enclosed
by polynomials and a bound on the rest, P is a straight line, and G is its middle: the matrix is positive definite in
the cell if it is so, by more than the rest, at the coefficients of the polynomials in Bernstein's basis, whose convex
hull they do not leave.  A cell where it is not is halved.

P is found in floating point, from a Riccati or Lyapunov equation; that it does what it should is proven with bounds on
all rounding.  Sources: Rantzer 1996 (the lemma); de Oliveira, Bernussou & Geromel 1999 (G); Rump 2006 (a Cholesky
factorization that ends proves a matrix positive definite).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product
from math import comb
from typing import Any, NamedTuple, cast

import numpy as np

from feeddrive.analysis.stability import stability
from feeddrive.blocks.controller.gain_schedule import GainSchedule
from feeddrive.blocks.signals import Setpoint
from feeddrive.certificate import travel_check
from feeddrive.certificate.enclosure import ORDER, Enclosed, enclose
from feeddrive.identification.travel import TravelFit
from feeddrive.language import tree
from feeddrive.language.block import Number
from feeddrive.language.errors import ParameterError
from feeddrive.language.graph import Graph, Symbol
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column, Result, Table
from feeddrive.language.text import Text
from feeddrive.loop.control import Control
from feeddrive.loop.gradient import push
from feeddrive.loop.linearize import linearize
from feeddrive.loop.loop import SETPOINT, Loop
from feeddrive.loop.traced_model import traced_loop
from feeddrive.tuning.travel import Travel, frozen

OUTSIDE = (
    "saturation, friction other than its slope, rounding of signals and coefficients",
    "tolerances of the axis, and what its model lacks, such as a further mode",
    "between its measured positions the axis is that of the fitted curves; within a sample it is that of one position",
    "other payloads than that of the proof",
)
WORK = 20_000  # cells of positions that are examined at most: a minute or two
_UNIT = 2.0**-53
_ROUND = 1.05 * _UNIT  # of a sum of products, for each of its operations
_MARGINS = (
    1e-2,
    3e-3,
    1e-3,
    3e-4,
    1e-4,
    3e-5,
    1e-5,
    3e-6,
    1e-6,
)  # by which P is to decay in each sample, largest first
_OF_OUTPUT = 10.0  # times the same for the square of the bound
_WEAK = 1e-6  # weight of all states beside the output, so that P is positive definite
_DOUBLINGS = 40  # 2^40 terms of a sum: enough for a pole 1e-10 from the unit circle
_PARTS = 16  # of each interval between places at the start
_TOGETHER = 96  # cells whose models are enclosed together
_LOOKED = 1e-3  # of the travel: in a cell this short that is not proven, the loop itself is looked at
_LINES = 4000  # frequencies at which a bound is refuted
_MESH = 200  # cells of the travel over which P is linear, for an axis that moves
_SHARES = (0.8, 0.5)  # of the decay of the slowest pole that P is to have
_FASTEST, _SLOWEST = 100.0, 1e-3  # m/s: no feed drive is faster, and a slower one stands still
_NARROW = 1e-6  # of the travel: a cell this short at which the proof fails is not halved again


class Enclosures(NamedTuple):
    """Matrices over cells, entry by entry, as `Enclosed`: polynomials in t, slopes of other variables, and a rest.

    terms  shape (ORDER + 1, cells, rows, columns);  slope  shape (2 others, cells, rows, columns)
    """

    terms: np.ndarray
    slope: np.ndarray
    rest: np.ndarray

    def times(self, other: Enclosures) -> Enclosures:
        """Return the products of the matrices of each cell."""
        a, b = self, other
        whole = np.zeros((2 * ORDER + 1, *a.rest.shape))
        for i, term in enumerate(a.terms):
            whole[i : i + ORDER + 1] += term @ b.terms
        sizes, slopes = (
            [np.sum(np.abs(part), axis=0) for part in parts] for parts in ((a.terms, b.terms), (a.slope, b.slope))
        )
        rest = np.sum(np.abs(whole[ORDER + 1 :]), axis=0)
        seconds = [np.sum(np.abs(x.terms[2:]), axis=0) for x in (a, b)]
        firsts = [np.abs(x.terms[1]) + second for x, second in zip((a, b), seconds, strict=True)]
        alone, along = ([np.sum(np.abs(x.slope[i::2]), axis=0) for x in (a, b)] for i in (0, 1))
        rest = rest + alone[0] @ seconds[1] + along[0] @ firsts[1] + seconds[0] @ alone[1] + firsts[0] @ along[1]
        rest = rest + slopes[0] @ slopes[1] + a.rest @ (sizes[1] + slopes[1] + b.rest) + (sizes[0] + slopes[0]) @ b.rest
        lost = (sizes[0] + slopes[0]) @ (sizes[1] + slopes[1]) + rest
        slope = a.slope @ b.terms[0] + a.terms[0] @ b.slope
        slope[1::2] += a.slope[::2] @ b.terms[1] + a.terms[1] @ b.slope[::2]
        return Enclosures(whole[: ORDER + 1], slope, rest + _ROUND * (4 * rest.shape[-1] + 16) * lost)

    def take(self, which: np.ndarray) -> Enclosures:
        """Return the matrices of some cells."""
        return Enclosures(self.terms[:, which], self.slope[:, which], self.rest[which])

    def scaled(self, scale: np.ndarray) -> Enclosures:
        """Return S⁻¹ X S for a diagonal of powers of two, without rounding."""
        factor = scale[None, :] / scale[:, None]
        return Enclosures(self.terms * factor, self.slope * factor, self.rest * factor)

    def corners(self) -> tuple[np.ndarray, np.ndarray]:
        """Return matrices whose convex hull, but for the rest, holds all of the cell, and the rest.

        These are the coefficients of the polynomials in Bernstein's basis, (ORDER + 1, cells, rows, columns).
        """
        size = np.sum(np.abs(self.terms), axis=0)
        corners = np.einsum("kj,jcrs->kcrs", _TO_BERNSTEIN, self.terms)
        return corners, self.rest + _ROUND * 8 * (ORDER + 1) * np.sum(np.abs(_TO_BERNSTEIN)) * size


def _to_bernstein() -> np.ndarray:
    """Return the matrix from powers of t on -1 <= t <= 1 to Bernstein's basis."""
    n = ORDER
    # t = 2 s - 1, 0 <= s <= 1
    powers = np.array(
        [[comb(j, i) * 2.0**i * (-1.0) ** (j - i) if i <= j else 0.0 for j in range(n + 1)] for i in range(n + 1)]
    )
    basis = np.array([[comb(k, i) / comb(n, i) if i <= k else 0.0 for i in range(n + 1)] for k in range(n + 1)])
    return basis @ powers


_TO_BERNSTEIN = _to_bernstein()


class AlongTravel:
    """The closed loop of a control, with or without a schedule, at the positions of a travel.

    Variables of an enclosure: the position and, if `step` > 0, the step from the last position (in units of `step`) and
    the step to the position that the axis passes while the force acts.
    """

    def __init__(self, travel: Travel, control: Control, velocity: float = 0.05) -> None:
        if travel.payloads is not None:
            raise ParameterError(
                "a proof along the travel is that of one payload: take travel.with_payload(m), once for each payload m "
                "(feeddrive travel --prove-payload)"
            )
        if isinstance(control.law, GainSchedule) and travel.payload is not None:
            control = replace(control, law=control.law.with_payload(travel.payload))
        self.travel, self.control, self.velocity = travel, control, velocity
        self.first, self.last = float(travel.positions[0]), float(travel.positions[-1])
        middle = 0.5 * (self.first + self.last)
        self.loop = self.at(middle)
        self.traced = traced_loop(self.loop, middle, velocity)
        self.T = float(self.loop.sample_time)
        law = control.law
        self.places = [float(p.position) for p in law.places] if isinstance(law, GainSchedule) else []
        self.states = self.traced.model.states
        model = linearize(self.loop, ["added_force"], ["force"], velocity=velocity, position=middle)
        # the size of each state under white noise of 1 N, as powers of two: the entries of P are then near 1
        if np.max(np.abs(model.poles())) < 1.0:
            sizes = np.sqrt(np.diag(_lyapunov(model.A.T, model.B @ model.B.T)))
        else:
            sizes = np.linalg.norm(np.hstack([model.A, model.B]), axis=1)
        self.scale = np.append(2.0 ** np.rint(np.log2(np.maximum(sizes, 1e-30))), 1.0)
        self.retuned = self._retuned() if self.places else None

    def at(self, position: float) -> Loop:
        """Return the frozen loop at a position (m)."""
        return replace(self.travel.at(position), control=frozen(self.control, position))

    def breaks(self) -> np.ndarray:
        """Return the positions at which the parameters of control or axis have a kink, and both ends (m)."""
        inner = [x for x in self.places if self.first < x < self.last]
        return np.array([self.first, *inner, self.last])

    def matrices(self, low: np.ndarray, high: np.ndarray, step: float = 0.0) -> tuple[np.ndarray, Enclosures]:
        """Return enclosures of [A b; c d] over cells of positions (m), in scaled states, and the cell of each.

        No cell may contain a kink inside.  With `step` (m) the law reads a position up to a step away from that of the
        axis, and the states before a sample are those of the last one, up to a step before the reading, which the
        retuning of the law converts: both are other variables.
        """
        count = low.size
        others = 0 if not step else 4 if self.retuned is None else 8
        middle, half = 0.5 * (low + high), 0.5 * (high - low) * (1.0 + 1e-15)
        terms, rounding = np.stack([middle, half]), 4.0 * _UNIT * (np.abs(low) + np.abs(high))

        def along(*slopes: float) -> Enclosed:
            rows = np.zeros((others, count))
            rows[: 2 * len(slopes) : 2] = np.array(slopes).reshape(-1, 1)
            return Enclosed(terms, rows if others else None, rounding)

        plant, x = along(), along(step) if step else along()
        leaves = {name: Enclosed.exactly(float(value)) for name, value in tree.leaves(self.loop)}
        leaves |= {tree.name_of(self.loop, path): _fitted(fit, plant) for path, fit in self.travel.fits.items()}
        law = self._law(x, low, high, step, 2)
        leaves |= {f"control.law.{name}": value for name, value in law.items()}
        starts = {"position": plant, "set_position": plant, "velocity": self.velocity, "set_velocity": self.velocity}
        for name in ("position", "velocity", *SETPOINT):
            start = starts.get(name, 0.0)
            leaves[f"start.{name}"] = start if isinstance(start, Enclosed) else Enclosed.exactly(start)
        beginning = self.traced.beginning
        ends = [*beginning.constants.values(), *beginning.states.values()]
        names = [*beginning.constants, *(f"state.{name}" for name in beginning.states)]
        cell, values = enclose(beginning.graph, ends, leaves, count, others)
        numbers = {name: value.take(cell) for name, value in leaves.items()} | dict(zip(names, values, strict=True))
        numbers |= {name: Enclosed.exactly(value) for name, value in self.traced.fixed.items()}
        model = self.traced.model
        inner, entries = enclose(model.graph, [e for _, _, e in model.entries], numbers, cell.size, others)
        cell = cell[inner]
        found = _matrix(model.shape, [(i, j) for i, j, _ in model.entries], entries, cell.size)
        # the output of the model is the force of the control, and that of the drive has the added force in it
        found.terms[0, :, -1, -1] += 1.0
        found.rest[:, -1, -1] += 4.0 * _UNIT * (1.0 + np.abs(found.terms[0, :, -1, -1]))
        if step and self.retuned is not None:
            old = self._law(along(step, 0.0, -step), low, high, 2.0 * step, 6)
            turned = {f"new.{name}": value.take(cell) for name, value in law.items()}
            turned |= {f"old.{name}": value.take(cell) for name, value in old.items()}
            whole = self._retune_matrix(turned, numbers, inner, cell.size)
            found = found.times(whole)
        return cell, found.scaled(self.scale)

    def _law(self, x: Enclosed, low: np.ndarray, high: np.ndarray, step: float, kink: int) -> dict[str, Enclosed]:
        """Return the parameters of the law along positions that are within `step` of cells.

        Behind a place all parameters bend together: `kink` is the variable for how far, if a cell is near a place.
        """
        if not self.places:
            return {}
        law = self.control.law
        assert isinstance(law, GainSchedule)
        rows = np.array([[float(value) for value in place.numbers(law.payload)] for place in law.places])
        places = np.array(self.places)
        # segment 0 lies before the first place and the last one behind the last place, both with a slope of 0
        segment = np.searchsorted(places, 0.5 * (low + high))
        slopes = np.zeros((places.size + 1, rows.shape[1]))
        slopes[1:-1] = np.diff(rows, axis=0) / np.diff(places)[:, None]
        anchor = np.clip(segment - 1, 0, places.size - 1)
        # of the place before and behind each cell, if a step leads to it: no cell is between two places
        bends = np.diff(slopes, axis=0)
        before, behind = np.maximum(segment - 1, 0), np.minimum(segment, places.size - 1)
        to_before = (segment > 0) & (low - places[before] < step)
        to_behind = (segment < places.size) & (places[behind] - high < step)
        if step and np.any(to_before & to_behind):
            raise ParameterError("a cell between two places is shorter than a step")
        bent = step * np.where(to_before[:, None], bends[before], np.where(to_behind[:, None], bends[behind], 0.0))
        away = x.plus(Enclosed.exactly(-places[anchor]))
        found: dict[str, Enclosed] = {}
        for i, (name, _) in enumerate(tree.leaves(law.places[0].laws()[0][1])):
            # slope and value are computed by the law with a few roundings
            slope = Enclosed(slopes[segment, i][None], None, 4.0 * _UNIT * np.abs(slopes[segment, i]))
            value = Enclosed.exactly(rows[anchor, i]).plus(away.times(slope))
            if x.slope is not None:
                rows_ = np.zeros((len(x.slope), low.size)) if value.slope is None else np.array(value.slope)
                rows_[kink] += bent[:, i]
                value = value._replace(slope=rows_)
            found[name] = value
        return found

    def _retuned(self) -> _Retuned | None:
        """Trace the conversion of the state of the law from old to new parameters; None if it changes nothing."""
        law = self.loop.control.law
        prefix = "control.memory.law"
        graph = Graph()
        T = cast(Number, graph.input("sample_time"))
        old, new = (
            tree.rebuild(law, (graph.input(f"{kind}.{name}") for name, _ in tree.leaves(law)))
            for kind in ("old", "new")
        )
        control, zero = self.loop.control, np.float64(0.0)
        begun = control.start(control.prepare(self.T), Setpoint(zero), zero, zero, zero).memory.law
        names = [name for name, _ in tree.leaves(begun, prefix)]
        state = tree.rebuild(begun, (graph.input(f"state.{name}") for name in names))
        after = new.retune(state, old, old.prepare(T), new.prepare(T))
        ends = [graph.symbol(value).index for _, value in tree.leaves(after)]
        columns = [graph.input(f"state.{name}").index for name in names]
        if ends == columns:
            return None
        values = {i: Symbol(graph, i) for i in range(len(graph.nodes))}
        places = {name: i for i, name in enumerate(self.traced.names)}
        entries: list[tuple[int, int]] = []
        nodes: list[int] = []
        for name, column in zip(names, columns, strict=True):
            for other, tangent in zip(names, push(graph, ends, values, {column: 1.0}), strict=True):
                if tangent is not None and name in places and other in places:
                    entries.append((places[other], places[name]))
                    nodes.append(graph.symbol(tangent).index)
        return _Retuned(
            graph, tuple(entries), tuple(nodes), frozenset(places[name] for name in names if name in places)
        )

    def _retune_matrix(
        self, laws: dict[str, Enclosed], numbers: dict[str, Enclosed], inner: np.ndarray, cells: int
    ) -> Enclosures:
        assert self.retuned is not None
        leaves = laws | {name: value.take(inner) for name, value in numbers.items() if name.startswith("state.")}
        leaves["sample_time"] = Enclosed.exactly(self.T)
        branch, entries = enclose(self.retuned.graph, self.retuned.nodes, leaves, cells, 8)
        if branch.size != cells:
            raise ParameterError("the conversion of the law's state has a choice that positions leave open")
        n = self.states
        found = _matrix((n + 1, n + 1), self.retuned.entries, entries, cells)
        for i in [i for i in range(n + 1) if i not in self.retuned.states]:
            found.terms[0, :, i, i] = 1.0
        return found


def _fitted(fit: TravelFit, x: Enclosed) -> Enclosed:
    """Return a number of the axis, as fitted over the travel, along positions."""
    first, last = float(fit.places[0]), float(fit.places[-1])
    t = x.times(Enclosed.exactly(2.0)).plus(Enclosed.exactly(-first).plus(Enclosed.exactly(-last)))
    t = t.times(Enclosed.exactly(last).plus(Enclosed.exactly(-first)).inverse())
    value = Enclosed.exactly(0.0)
    for coefficient in fit.coefficients[::-1]:
        value = value.times(t).plus(Enclosed.exactly(float(coefficient)))
    return value.inverse() if fit.inverse else value


class _Retuned(NamedTuple):
    """The Jacobian of a law's `retune`: its entries as nodes, and the states of the law among those of the loop."""

    graph: Graph
    entries: tuple[tuple[int, int], ...]
    nodes: tuple[int, ...]
    states: frozenset[int]


def _matrix(
    shape: tuple[int, int], places: Sequence[tuple[int, int]], entries: Sequence[Enclosed], cells: int
) -> Enclosures:
    others = len(entries[0].slope) if entries and entries[0].slope is not None else 0
    terms, slope, rest = (np.zeros((*first, cells, *shape)) for first in ((ORDER + 1,), (others,), ()))
    for (i, j), entry in zip(places, entries, strict=True):
        terms[:, :, i, j], rest[:, i, j] = entry.terms, entry.rest
        if entry.slope is not None:
            slope[:, :, i, j] = entry.slope
    return Enclosures(terms, slope, rest)


def proven_positive(
    value: np.ndarray, rest: np.ndarray, before: np.ndarray, after: np.ndarray, weight: np.ndarray, whiten: np.ndarray
) -> np.ndarray:
    """Return for each cell whether the matrix of the module's docstring is positive definite for all X within a rest.

    value, rest            |X - value| <= rest, entry by entry
    before, after, weight  Π', Π and Γ, symmetric, shape (cells, n, n);  whiten  any matrices W: W Π Wᵀ should be near 1
    """
    cells, n = value.shape[0], value.shape[1]
    W, A = whiten, np.abs(whiten)
    Wt, At = W.transpose(0, 2, 1), A.transpose(0, 2, 1)
    whole, errors = np.empty((cells, 2 * n, 2 * n)), np.empty((cells, 2 * n, 2 * n))
    cross = W @ (weight @ value) @ Wt
    error = A @ (np.abs(weight) @ (rest + _ROUND * (3 * n + 4) * (np.abs(value) + rest))) @ At
    whole[:, :n, :n], whole[:, n:, n:] = W @ before @ Wt, W @ (2.0 * weight - after) @ Wt
    whole[:, n:, :n], whole[:, :n, n:] = cross, cross.transpose(0, 2, 1)
    errors[:, :n, :n] = _ROUND * (2 * n + 12) * (A @ np.abs(before) @ At)
    errors[:, n:, n:] = _ROUND * (2 * n + 12) * (A @ (2.0 * np.abs(weight) + np.abs(after)) @ At)
    errors[:, n:, :n], errors[:, :n, n:] = error, error.transpose(0, 2, 1)
    whole = 0.5 * (whole + whole.transpose(0, 2, 1))
    # |yᵀ E y| <= Σ yᵢ² Σⱼ |Eᵢⱼ| for symmetric |E|
    taken = np.sum(np.maximum(errors, errors.transpose(0, 2, 1)), axis=2) * (1.0 + 1e-12)
    trace = np.trace(np.abs(whole), axis1=1, axis2=2)
    # Rump 2006: the factorization of a matrix less so much of the identity ends only if it is positive definite
    taken += ((2 * n + 2) * 2.0 * _UNIT * trace)[:, None]
    places = np.arange(2 * n)
    whole[:, places, places] = (whole[:, places, places] - taken) * (1.0 - 1e-15) - 1e-300
    return _factorized(whole)


def _factorized(matrices: np.ndarray) -> np.ndarray:
    """Return for each matrix whether its Cholesky factorization ends."""
    holds = np.all(np.isfinite(matrices), axis=(1, 2))
    try:
        if np.all(holds):
            np.linalg.cholesky(matrices)
            return holds
    except np.linalg.LinAlgError:
        pass
    for i in np.flatnonzero(holds):
        try:
            np.linalg.cholesky(matrices[i])
        except np.linalg.LinAlgError:
            holds[i] = False
    return holds


def _padded(P: np.ndarray, bound: float) -> np.ndarray:
    """Return diag(P, bound²) for each matrix."""
    cells, n = P.shape[:2]
    whole = np.zeros((cells, n + 1, n + 1))
    whole[:, :n, :n], whole[:, n, n] = P, bound**2
    return whole


def _lyapunov(A: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """Return Σ (Aᵏ)ᵀ Q Aᵏ of a stable A, by doubling."""
    total, power = Q, A
    for _ in range(_DOUBLINGS):
        total = total + power.T @ total @ power
        power = power @ power
    return total


def _riccati(X: np.ndarray, bound: float | None, start: int) -> tuple[np.ndarray, int] | None:
    """Return P for one matrix [A b; c d], and the index of the margin in `_MARGINS` with which it was found.

    The margin is the largest from `start` on at which the equation has a solution; None if there is none.
    """
    from scipy.linalg import LinAlgError, solve_discrete_are

    n = X.shape[0] - 1
    A, b, c, d = X[:n, :n], X[:n, n:], X[n:, :n], X[n:, n:]
    for i in range(start, len(_MARGINS)):
        decay = np.sqrt(1.0 - _MARGINS[i])
        try:
            if bound is None:
                if np.max(np.abs(np.linalg.eigvals(A))) >= decay:
                    continue
                found = _lyapunov(A / decay, c.T @ c + _WEAK * np.eye(n))
            else:
                weight = c.T @ c + _WEAK * np.eye(n)
                # both P and the output have a margin: where the output takes all, that of P is small
                share = 1.0 + _OF_OUTPUT * _MARGINS[i]
                square = d @ d - bound**2 / share * np.eye(1)
                found = share * solve_discrete_are(A / decay, b / decay, weight, square, s=c.T @ d)
            P = 0.5 * (found + found.T)
            weight = _padded(P[None], 1.0 if bound is None else bound)[0]
            # a solution that is nearly singular is lost to rounding: half of its margin must be there
            np.linalg.cholesky((1.0 - 0.5 * _MARGINS[i]) * weight - X.T @ _padded(P[None], 1.0)[0] @ X if bound else P)
        except (LinAlgError, ValueError):
            continue
        if np.all(np.isfinite(P)):
            return P, i
    return None


class _Functions:
    """P at positions for one bound of Ms (None: stability alone), computed once for each position."""

    def __init__(self, along: AlongTravel, bound: float | None) -> None:
        self.along, self.bound = along, bound
        self._models: dict[float, np.ndarray] = {}
        self._found: dict[tuple[float, int], tuple[np.ndarray, int] | None] = {}

    def at(self, position: float, margin: int) -> tuple[np.ndarray, int] | None:
        """Return P, and the index of its margin, at least `margin`; None if no margin has a solution."""
        if (position, margin) not in self._found:
            found = _riccati(self._models[position], self.bound, margin)
            self._found[position, margin] = found
            if found is not None:
                self._found[position, found[1]] = found
        return self._found[position, margin]

    def models(self, positions: np.ndarray) -> None:
        """Compute the models at positions that are not known yet."""
        new = np.array([x for x in np.unique(positions) if float(x) not in self._models])
        if new.size:
            cell, X = self.along.matrices(new, new)
            for i, place in enumerate(cell):
                self._models[float(new[place])] = X.terms[0, i]

    def pair(self, low: float, high: float, margin: int) -> tuple[np.ndarray, np.ndarray, int] | float:
        """Return P at both ends of a cell with the same margin, and its index; or the position that has none."""
        while True:
            first = self.at(low, margin)
            if first is None:
                return low
            second = self.at(high, first[1])
            if second is None:
                return high
            if second[1] == first[1]:
                return first[0], second[0], first[1]
            margin = second[1]


def _frozen_holds(X: Enclosures, low: np.ndarray, high: np.ndarray, bound: float | None) -> np.ndarray:
    """Return for each cell whether the frozen loop is proven at all of its positions; P at both ends of each cell."""
    n = low.shape[1]
    corners, rest = X.corners()
    middle = 0.5 * (low + high)
    if bound is None:
        corners, rest = corners[:, :, :n, :n], rest[:, :n, :n]
    weight = middle if bound is None else _padded(middle, 1.0)
    whiten = np.linalg.inv(np.linalg.cholesky(weight))
    holds = np.ones(low.shape[0], bool)
    for k, corner in enumerate(corners):
        # the coefficients of a straight line in Bernstein's basis are its values at even distances
        share = k / ORDER
        P = (1.0 - share) * low + share * high
        before, after = (P, P) if bound is None else (_padded(P, bound), _padded(P, 1.0))
        holds &= proven_positive(corner, rest, before, after, weight, whiten)
    return holds


@dataclass(frozen=True, eq=False, repr=False)
class TravelProof(Result):
    """What was proven of a control along the travel of its axis.

    along        the loop along its travel
    bound        the bound on Ms that was to be proven; None for stability alone
    proven       True if it holds at every position between them, False if it does not at `position`, None if that is
                 undecided there
    reason       the reason why it is not proven, as a clause
    cells        the cells of positions that were proven, ascending
    speed        m/s, up to which the moving loop is proven stable; 0 if none was proven, None if none was looked for
    most         True if no higher speed was tried
    top          the largest speed that the guard of the control allows, m/s; None without one
    motion       the proof for the axis that moves, if there is one
    """

    along: AlongTravel
    bound: float | None
    proven: bool | None
    position: float | None
    reason: Text
    cells: tuple[Cell, ...]
    speed: float | None
    most: bool
    top: float | None
    motion: Moving | None

    @property
    def first(self) -> float:
        """The position at which the travel begins, m."""
        return self.along.first

    @property
    def last(self) -> float:
        """The position at which the travel ends, m."""
        return self.along.last

    @property
    def verdict(self) -> str:
        """The verdict in a word or two."""
        return {True: "proven", False: "not proven", None: "undecided"}[self.proven]

    @property
    def claim(self) -> Text:
        """What is to be proven of an axis that stays where it is, as a clause."""
        robust = "" if self.bound is None else f" and has Ms <= {Quantity(self.bound):6}"
        ends = f"{Quantity(self.first, 'm'):6 SI} to {Quantity(self.last, 'm'):6 SI}"
        payload = self.along.travel.payload
        with_ = "" if payload is None else f" with a payload of {Quantity(payload, 'kg'):6 SI}"
        return Text(f"the loop is stable{robust} at every position from {ends}, each frozen{with_}")

    @property
    def moving(self) -> Text:
        """What was proven of an axis that moves, as a clause; empty if nothing was looked for."""
        if self.speed is None:
            return Text()
        if self.speed == 0.0:
            return Text("no speed was found up to which the moving loop is stable")
        beyond = " (no higher speed was tried)" if self.most else ""
        text = f"the moving loop is stable up to {Quantity(self.speed, 'm/s'):3 SI}{beyond}"
        if self.top is None:
            return Text(text)
        share = self.speed / self.top
        return Text(f"{text}, {Quantity(share):2} times the {Quantity(self.top, 'm/s'):3 SI} that its guard allows")

    def sentence(self) -> Text:
        """Return the verdict as a clause."""
        frozen_ = Text(f"proven: {self.claim}") if self.proven else Text(f"{self.verdict}: {self.claim}; {self.reason}")
        return Text(f"{frozen_}; {self.moving}") if self.moving else frozen_

    def table(self) -> Table:
        """Tabulate the intervals that were proven, joined where they touch, and the speed."""
        rows = [[a, b, sum(a <= cell.low < b for cell in self.cells)] for a, b in self.intervals()]
        columns = [Column("from", "m", "6 mm"), Column("to", "m", "6 mm"), "cells"]
        return Table(Text(f"along the travel: {self.verdict}"), columns, rows)

    def intervals(self) -> list[tuple[float, float]]:
        """Return the intervals of positions (m) that were proven, joined where they touch."""
        found: list[tuple[float, float]] = []
        for cell in self.cells:
            if found and found[-1][1] == cell.low:
                found[-1] = found[-1][0], cell.high
            else:
                found.append((cell.low, cell.high))
        return found

    def record(self) -> dict[str, Any]:
        """Return the result as plain values for JSON."""
        return {
            "claim": self.claim,
            "verdict": self.verdict,
            "sensitivity_peak": self.bound,
            "position_m": self.position,
            "reason": self.reason or None,
            "from_m": self.first,
            "to_m": self.last,
            "payload_kg": self.along.travel.payload,
            "cells": len(self.cells),
            "speed_m_s": self.speed,
            "higher_tried": not self.most,
            "top_speed_m_s": self.top,
        }


def document(proof: TravelProof, made_from: Sequence[Mapping[str, str]] = ()) -> dict[str, Any]:
    """Return the proof as a document that `travel_check` accepts. Raises ParameterError for one that is not proven.

    made_from  names and SHA-256 digests of the machine files
    """
    if not proof.proven:
        raise ParameterError(f"there is no proof to write: {proof.reason}")
    along = proof.along
    moving: dict[str, Any] | None = None
    if proof.motion is not None:
        edges, P, step, _ = proof.motion
        cell, X = along.matrices(edges[:-1], edges[1:], step if along.places else 0.0)
        moving = {
            "step_m": step,
            "edges_m": edges.tolist(),
            "P": [_lower(each) for each in P],
            "cells": [[_entries(X, int(i)) for i in np.flatnonzero(cell == place)] for place in range(edges.size - 1)],
        }
    content = {
        "format": travel_check.FORMAT,
        "claim": str(proof.sentence()),
        "outside": list(OUTSIDE),
        "made_from": [dict(origin) for origin in made_from],
        "sensitivity_peak": proof.bound,
        "from_m": along.first,
        "to_m": along.last,
        "sample_time_s": along.T,
        "states": list(along.traced.names),
        "cells": [
            {
                "from_m": c.low,
                "to_m": c.high,
                "low": _lower(c.P),
                "high": _lower(c.Q),
                "branches": [_entries(c.X, i) for i in range(len(c.X.rest))],
            }
            for c in proof.cells
        ],
        "moving": moving,
    }
    return {**content, "sha256": travel_check.digest(content)}


def _lower(P: np.ndarray) -> list[list[float]]:
    return [P[i, : i + 1].tolist() for i in range(len(P))]


def _entries(X: Enclosures, i: int) -> list[list[Any]]:
    """Return the entries of the matrix of a cell that are not 0: row, column, terms, slopes and rest."""
    there = (np.abs(X.terms[:, i]).sum(axis=0) + np.abs(X.slope[:, i]).sum(axis=0) + X.rest[i]) > 0.0
    return [
        [int(r), int(c), X.terms[:, i, r, c].tolist(), X.slope[:, i, r, c].tolist(), float(X.rest[i, r, c])]
        for r, c in np.argwhere(there)
    ]


def prove_along_travel(
    travel: Travel,
    control: Control,
    *,
    sensitivity_peak: float | None = None,
    speed: bool = True,
    velocity: float = 0.05,
    work: int = WORK,
    progress: Progress | None = None,
) -> TravelProof:
    """Prove a control, with or without a schedule, at every position of a travel, and up to which speed it is stable.

    travel    with one payload: `Travel.with_payload`; a schedule over the payload then has the parameters for it

    speed     True to look for the speed up to which the moving loop is stable, too
    velocity  m/s, at which friction is linearized
    work      largest number of cells of positions to examine; when they are used up, the result is undecided

    The axis between its measured positions is that of the curves of `travel`.  A moving axis has in each sample the
    stiffness of one position that it passes in it.  Raises ParameterError for a loop that has no enclosure: two rates,
    a table, the past of a signal.
    """
    if sensitivity_peak is not None and not sensitivity_peak > 1.0:
        raise ParameterError(f"max_ms = {Quantity(sensitivity_peak):6} must be above 1, as 2: |1 + L| is 1 without L")
    progress = progress or Progress()
    along = AlongTravel(travel, control, velocity)
    search = _Search(along, sensitivity_peak)
    search.run(work, progress)
    moving = _fastest(along, progress) if speed and search.proven else None
    guard = control.guard
    top = None if guard is None or guard.velocity_limit is None else float(guard.velocity_limit)
    cells = tuple(sorted(search.cells, key=lambda cell: cell.low))
    fastest = None if not speed else 0.0 if moving is None else moving.step / along.T
    most = moving is not None and moving.most
    return TravelProof(
        along, sensitivity_peak, search.proven, search.position, search.reason, cells, fastest, most, top, moving
    )


class Cell(NamedTuple):
    """A cell of positions (m) at which the frozen loop is proven: P at both ends, and the loop in each branch."""

    low: float
    high: float
    P: np.ndarray
    Q: np.ndarray
    X: Enclosures


class _Search:
    """The halving of cells of positions until each is proven, one is found that cannot be, or the work is used up."""

    def __init__(self, along: AlongTravel, bound: float | None) -> None:
        self.along, self.bound = along, bound
        self.functions = _Functions(along, bound)
        self.cells: list[Cell] = []
        self.proven: bool | None = True
        self.position: float | None = None
        self.reason = Text()

    def run(self, work: int, progress: Progress) -> None:
        """Examine the whole travel; `work` cells at most."""
        breaks = self.along.breaks()
        for place in breaks:
            if self._refuted(float(place)):
                return
        edges = [np.linspace(a, b, _PARTS + 1) for a, b in pairwise(breaks.tolist())]
        waiting = [(float(a), float(b)) for row in edges for a, b in pairwise(row)][::-1]
        narrow = _NARROW * (self.along.last - self.along.first)
        examined, margin = 0, 0
        while waiting:
            progress.step("positions of the travel")
            some, waiting = waiting[-_TOGETHER:], waiting[:-_TOGETHER]
            examined += len(some)
            if examined > work:
                self.proven, self.position = None, float(np.mean(some[-1]))
                self.reason = Text(f"{work} cells of positions were examined, as many as are allowed")
                return
            low, high = (np.array(column) for column in zip(*some, strict=True))
            self.functions.models(np.concatenate([low, high]))
            cell, X = self.along.matrices(low, high)
            pairs = [self.functions.pair(a, b, margin) for a, b in some]
            there = np.array([isinstance(pair, tuple) for pair in pairs])
            found = [pair for pair in pairs if isinstance(pair, tuple)]
            margin = max(min((pair[2] for pair in found), default=1) - 1, 0)
            holds = there.copy()
            rows = np.flatnonzero(there[cell])
            if rows.size:
                place = np.cumsum(there) - 1
                P, Q = (np.array([found[place[cell[i]]][k] for i in rows]) for k in (0, 1))
                proven = _frozen_holds(X.take(rows), P, Q, self.bound)
                np.logical_and.at(holds, cell[rows], proven)
            for i in np.flatnonzero(holds):
                (a, b), pair = some[i], pairs[i]
                assert isinstance(pair, tuple)
                self.cells.append(Cell(a, b, pair[0], pair[1], X.take(np.flatnonzero(cell == i))))
            for i in np.flatnonzero(~holds)[::-1]:
                a, b = some[i]
                pair = pairs[i]
                place = pair if isinstance(pair, float) else 0.5 * (a + b)
                # a look at each place would take longer than the proof
                if (isinstance(pair, float) or b - a < _LOOKED * (edges[-1][-1] - edges[0][0])) and self._refuted(
                    place
                ):
                    return
                if b - a < narrow:
                    self.proven, self.position = None, place
                    self.reason = Text(f"{Quantity(place, 'm'):7 SI} is too near to the bound to decide")
                    return
                waiting += [(0.5 * (a + b), b), (a, 0.5 * (a + b))]

    def _refuted(self, position: float) -> bool:
        """Return True, and note the position, if the frozen loop there is unstable or exceeds the bound."""
        loop = self.along.at(position)
        poles = stability(loop, velocity=self.along.velocity)
        reason = Text()
        if not poles.stable:
            reason = Text(
                f"at {Quantity(position, 'm'):6 SI} it is unstable: a pole at |z| = {Quantity(poles.growth):.6f}"
            )
        elif self.bound is not None:
            peak, frequency = self._peak(loop, position)
            if peak > self.bound:
                reason = Text(
                    f"at {Quantity(position, 'm'):6 SI} |S| is {Quantity(peak):6} at {Quantity(frequency, 'Hz'):4}"
                )
        if reason:
            self.proven, self.position, self.reason = False, position, reason
        return bool(reason)

    def _peak(self, loop: Loop, position: float) -> tuple[float, float]:
        """Return the largest |S| on frequency lines and the line, Hz."""
        model = linearize(loop, ["added_force"], ["force"], velocity=self.along.velocity, position=position)
        nyquist = 0.5 / self.along.T
        lines = nyquist * np.geomspace(1e-5, 1.0, _LINES)
        for _ in range(3):
            size = np.abs(1.0 + model.response(lines).response)
            k = int(np.argmax(size))
            lines = np.linspace(lines[max(k - 1, 0)], lines[min(k + 1, lines.size - 1)], 41)
        size = np.abs(1.0 + model.response(lines).response)
        return float(np.max(size)), float(lines[int(np.argmax(size))])


class Moving(NamedTuple):
    """The proof for an axis that moves: P at the edges of cells, and the largest change of position in a sample, m.

    most  True if no larger one was tried
    """

    edges: np.ndarray
    P: np.ndarray
    step: float
    most: bool


def _fastest(along: AlongTravel, progress: Progress) -> Moving | None:
    """Return the proof for the largest step that was found; None if there is none for the slowest motion."""
    breaks, width = along.breaks(), (along.last - along.first) / _MESH
    parts = [np.linspace(a, b, max(2, int(np.ceil((b - a) / width))) + 1) for a, b in pairwise(breaks.tolist())]
    edges = np.unique(np.concatenate(parts))
    for share in _SHARES:
        P = _lyapunov_along(along, edges, share)
        # the change of P crosses one edge at most: two steps in a cell
        low, high = _SLOWEST * along.T, min(_FASTEST * along.T, 0.49 * float(np.min(np.diff(edges))))
        if P is None or not _moving_holds(along, edges, P, low):
            continue
        if _moving_holds(along, edges, P, high):
            return Moving(edges, P, high, True)
        while high > 1.05 * low:
            progress.step("speeds")
            step = float(np.sqrt(low * high))
            low, high = (step, high) if _moving_holds(along, edges, P, step) else (low, step)
        return Moving(edges, P, low, False)
    return None


def _lyapunov_along(along: AlongTravel, edges: np.ndarray, share: float) -> np.ndarray | None:
    """Return P at positions: Aᵀ P A < decay² P, the decay a share of the way from 1 to the largest |z|."""
    cell, X = along.matrices(edges, edges)
    n = along.states
    found = np.zeros((edges.size, n, n))
    for i, place in enumerate(cell):
        A, c = X.terms[0, i, :n, :n], X.terms[0, i, n:, :n]
        growth = float(np.max(np.abs(np.linalg.eigvals(A))))
        if growth >= 1.0:
            return None
        P = _lyapunov(A / (1.0 - share * (1.0 - growth)), c.T @ c + _WEAK * np.eye(n))
        found[place] = 0.5 * (P + P.T)
    return found


def _moving_holds(along: AlongTravel, edges: np.ndarray, P: np.ndarray, step: float) -> bool:
    """Return True if the moving loop is proven stable for a motion of at most `step` (m) in a sample.

    P  at the edges of the cells, linear between them.  The axis is at y in a sample, and the law reads one within
    a step of it: from one sample to the next y changes by two steps at most.
    """
    low, high = edges[:-1], edges[1:]
    cell, X = along.matrices(low, high, step if along.places else 0.0)
    n = along.states
    corners, rest = X.corners()
    corners, rest, slopes = corners[:, :, :n, :n], rest[:, :n, :n], X.slope[:, :, :n, :n]
    rest = rest + _ROUND * (len(slopes) + 1) * (np.abs(corners).max(axis=0) + np.sum(np.abs(slopes), axis=0))
    first, last = P[:-1][cell], P[1:][cell]
    change = np.diff(P, axis=0) / np.diff(edges)[:, None, None]
    left, right = change[np.maximum(cell - 1, 0)], change[np.minimum(cell + 1, len(change) - 1)]
    weight = 0.5 * (first + last)
    whiten = np.linalg.inv(np.linalg.cholesky(weight))
    # few cells are near a place, and all others have no slope along its variables
    turning = np.any(slopes != 0.0, axis=(2, 3))
    for pattern in np.unique(turning, axis=1).T if len(slopes) else [np.zeros(0, bool)]:
        here = np.flatnonzero(np.all(turning == pattern[:, None], axis=0))
        for k, corner in enumerate(corners):
            after = ((1.0 - k / ORDER) * first + k / ORDER * last)[here]
            for sign in product((-1.0, 1.0), repeat=int(np.sum(pattern))):
                value = corner[here]
                for s, slope in zip(sign, slopes[pattern], strict=True):
                    value = value + s * slope[here]
                # the change of P on the way from the last sample is a mean of those of the cells on it
                for way, each in ((1.0, change[cell]), (-1.0, change[cell]), (1.0, left), (-1.0, right)):
                    before = after - way * 2.0 * step * each[here]
                    if not np.all(proven_positive(value, rest[here], before, after, weight[here], whiten[here])):
                        return False
    return True

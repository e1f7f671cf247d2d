"""A proof that a loop is stable and keeps a bound on Ms along its travel, with every payload, and up to which speed.

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

*All payloads.*  A cell is then a rectangle of positions and payloads.  X is enclosed with a slope along the payload and
a bound on what bends, P is a straight line along the payload, too, and G is the mean of its four corners: at every
position the matrix is affine in the payload and positive definite between two payloads if it is at both.  A payload
does not change while the axis moves.

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
from feeddrive.blocks.families import Law
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
from feeddrive.tuning.travel import Pair, Travel, frozen

OUTSIDE = (
    "saturation, friction other than its slope, rounding of signals and coefficients",
    "tolerances of the axis, and what its model lacks, such as a further mode",
    "between its measured positions the axis is that of the fitted curves; within a sample it is that of one position",
    "a payload that changes while the axis moves",
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
_LOADS = 2  # parts of each interval between payloads at the start
_TOGETHER = 96  # cells whose models are enclosed together
_LOOKED = 1e-3  # of the travel: in a cell this short that is not proven, the loop itself is looked at
_LINES = 4000  # frequencies at which a bound is refuted
_MESH = 200  # cells of the travel over which P is linear, for an axis that moves
_SLABS = (2, 4, 8)  # parts of each interval between payloads over which P is linear, for an axis that moves
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
    """The closed loop of a control, with or without a schedule, at the positions and payloads of a travel.

    Variables of an enclosure: the position and, if `step` > 0, the step from the last position (in units of `step`) and
    the step to the position that the axis passes while the force acts; the last one is the payload, if it changes.
    """

    def __init__(self, travel: Travel, control: Control, velocity: float = 0.05) -> None:
        self.travel, self.control, self.velocity = travel, control, velocity
        self.first, self.last = float(travel.positions[0]), float(travel.positions[-1])
        middle = 0.5 * (self.first + self.last)
        loads = travel.payloads
        self.payloads = None if loads is None else (float(loads[0]), float(loads[-1]))
        self._check_payloads()
        self.loop = self.at(middle, None if self.payloads is None else 0.5 * sum(self.payloads))
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

    def _check_payloads(self) -> None:
        """Raise ParameterError for a schedule over the payload that does not know all payloads of the travel."""
        law = self.control.law
        if self.payloads is None or not isinstance(law, GainSchedule) or law.payload is None:
            return
        for i, place in enumerate(law.places):
            known = float(place.loads[0].payload), float(place.loads[-1].payload)
            if known[0] > self.payloads[0] or known[1] < self.payloads[1]:
                raise ParameterError(
                    f"places.{i} of the schedule has payloads from {Quantity(known[0], 'kg'):6 SI} to "
                    f"{Quantity(known[1], 'kg'):6 SI}, and the axis was measured from "
                    f"{Quantity(self.payloads[0], 'kg'):6 SI} to {Quantity(self.payloads[1], 'kg'):6 SI}: gains are "
                    f"not extrapolated; tune the schedule over the payloads that are to be proven"
                )

    def at(self, position: float, payload: float | None = None) -> Loop:
        """Return the frozen loop at a position (m) with a payload (kg)."""
        return replace(self.travel.at(position, payload), control=frozen(self.control, position, payload))

    def breaks(self) -> np.ndarray:
        """Return the positions at which the parameters of control or axis have a kink, and both ends (m)."""
        inner = [x for x in self.places if self.first < x < self.last]
        return np.array([self.first, *inner, self.last])

    def load_breaks(self) -> np.ndarray:
        """Return the payloads at which the parameters have a kink, and both ends (kg); empty if none changes."""
        if self.payloads is None:
            return np.zeros(0)
        law, (least, most) = self.control.law, self.payloads
        loads = [load for place in law.places for load in place.loads] if isinstance(law, GainSchedule) else []
        return np.unique([least, most, *(float(x.payload) for x in loads if least < float(x.payload) < most)])

    def matrices(
        self,
        low: np.ndarray,
        high: np.ndarray,
        step: float = 0.0,
        least: np.ndarray | None = None,
        most: np.ndarray | None = None,
    ) -> tuple[np.ndarray, Enclosures]:
        """Return enclosures of [A b; c d] over cells of positions (m), in scaled states, and the cell of each.

        least, most  the payloads (kg) of each cell, if they change; along them there is the last slope

        No cell may contain a kink inside.  With `step` (m) the law reads a position up to a step away from that of the
        axis, and the states before a sample are those of the last one, up to a step before the reading, which the
        retuning of the law converts: both are other variables.
        """
        count = low.size
        moving = 0 if not step else 4 if self.retuned is None else 8
        others = moving + (0 if least is None else 2)
        middle, half = 0.5 * (low + high), 0.5 * (high - low) * (1.0 + 1e-15)
        terms, rounding = np.stack([middle, half]), 4.0 * _UNIT * (np.abs(low) + np.abs(high))

        def along(*slopes: float) -> Enclosed:
            rows = np.zeros((others, count))
            rows[: 2 * len(slopes) : 2] = np.array(slopes).reshape(-1, 1)
            return Enclosed(terms, rows if others else None, rounding)

        plant, x = along(), along(step) if step else along()
        load: Enclosed | None = None
        if least is not None and most is not None:
            rows = np.zeros((others, count))
            rows[-2] = 0.5 * (most - least) * (1.0 + 1e-15)
            load = Enclosed(0.5 * (least + most)[None], rows, 4.0 * _UNIT * (np.abs(least) + np.abs(most)))
        leaves = {name: Enclosed.exactly(float(value)) for name, value in tree.leaves(self.loop)}
        leaves |= {tree.name_of(self.loop, path): _fitted(fit, plant, load) for path, fit in self.travel.fits.items()}
        law = self._law(x, load, low, high, step, 2)
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
            old = self._law(along(step, 0.0, -step), load, low, high, 2.0 * step, 6)
            turned = {f"new.{name}": value.take(cell) for name, value in law.items()}
            turned |= {f"old.{name}": value.take(cell) for name, value in old.items()}
            whole = self._retune_matrix(turned, numbers, inner, cell.size, others)
            found = found.times(whole)
        return cell, found.scaled(self.scale)

    def _law(
        self, x: Enclosed, load: Enclosed | None, low: np.ndarray, high: np.ndarray, step: float, kink: int
    ) -> dict[str, Enclosed]:
        """Return the parameters of the law along positions that are within `step` of cells, and along payloads.

        Behind a place all parameters bend together: `kink` is the variable for how far, if a cell is near a place.
        """
        if not self.places:
            return {}
        law = self.control.law
        assert isinstance(law, GainSchedule)
        cells = np.arange(low.size)
        # parameters at each place in each cell, shape (cells, places, parameters): in its middle, and their slope along
        # the payload from there to its ends; what they are computed from has the magnitude `bulk`
        rows, swing = self._at_places(law, load, low.size)
        bulk = np.max([[np.abs(_values(one)) for _, one in place.laws()] for place in law.places], axis=1)
        rises = np.zeros((len(bulk) + 1, bulk.shape[1]))
        places = np.array(self.places)
        # segment 0 lies before the first place and the last one behind the last place, both with a slope of 0
        segment = np.searchsorted(places, 0.5 * (low + high))
        slopes, swings = (np.zeros((low.size, places.size + 1, rows.shape[2])) for _ in range(2))
        for inner, values in ((slopes, rows), (swings, swing)):
            inner[:, 1:-1] = np.diff(values, axis=1) / np.diff(places)[:, None]
        rises[1:-1] = (bulk[1:] + bulk[:-1]) / np.diff(places)[:, None]
        anchor = np.clip(segment - 1, 0, places.size - 1)
        # of the place before and behind each cell, if a step leads to it: no cell is between two places
        before, behind = np.maximum(segment - 1, 0), np.minimum(segment, places.size - 1)
        to_before = (segment > 0) & (low - places[before] < step)
        to_behind = (segment < places.size) & (places[behind] - high < step)
        if step and np.any(to_before & to_behind):
            raise ParameterError("a cell between two places is shorter than a step")

        def bent(values: np.ndarray) -> np.ndarray:
            bends = np.diff(values, axis=1)
            chosen = np.where(to_behind[:, None], bends[cells, behind], 0.0)
            return step * np.where(to_before[:, None], bends[cells, before], chosen)

        bend, bend_swing = bent(slopes), np.abs(bent(swings))
        away = x.plus(Enclosed.exactly(-places[anchor]))
        found: dict[str, Enclosed] = {}
        for i, (name, _) in enumerate(tree.leaves(law.places[0].laws()[0][1])):
            # slope and value are computed by the law with a few roundings
            few = 16.0 * _UNIT
            slope = _swinging(slopes[cells, segment, i], swings[cells, segment, i], x, load, few * rises[segment, i])
            value = _swinging(rows[cells, anchor, i], swing[cells, anchor, i], x, load, few * bulk[anchor, i])
            value = value.plus(away.times(slope))
            if x.slope is not None and step:
                rows_ = np.zeros((len(x.slope), low.size)) if value.slope is None else np.array(value.slope)
                rows_[kink] += bend[:, i]
                value = value._replace(slope=rows_, rest=value.rest + bend_swing[:, i])
            found[name] = value
        return found

    def _at_places(self, law: GainSchedule, load: Enclosed | None, cells: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the parameters at each place in each cell of payloads, in the middle, and their change to its ends.

        Shapes (cells, places, parameters).  No cell has a payload of a place inside, so that both are exact.
        """
        tables = [np.array([_values(one) for _, one in place.laws()]) for place in law.places]
        if load is None or law.payload is None:
            own = None if law.payload is None else float(law.payload)
            row = np.array([[float(value) for value in place.numbers(own)] for place in law.places])
            rows = np.broadcast_to(row, (cells, *row.shape))
            return rows, np.zeros_like(rows)
        assert load.slope is not None
        middle, half = load.terms[0], load.slope[-2]
        rows, swing = [], []
        for place, table in zip(law.places, tables, strict=True):
            payloads = np.array([float(one.payload) for one in place.loads])
            j = np.clip(np.searchsorted(payloads, middle) - 1, 0, payloads.size - 2)
            rise = (table[j + 1] - table[j]) / (payloads[j + 1] - payloads[j])[:, None]
            rows.append(table[j] + (middle - payloads[j])[:, None] * rise)
            swing.append(half[:, None] * rise)
        return np.stack(rows, axis=1), np.stack(swing, axis=1)

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
        self, laws: dict[str, Enclosed], numbers: dict[str, Enclosed], inner: np.ndarray, cells: int, others: int
    ) -> Enclosures:
        assert self.retuned is not None
        leaves = laws | {name: value.take(inner) for name, value in numbers.items() if name.startswith("state.")}
        leaves["sample_time"] = Enclosed.exactly(self.T)
        branch, entries = enclose(self.retuned.graph, self.retuned.nodes, leaves, cells, others)
        if branch.size != cells:
            raise ParameterError("the conversion of the law's state has a choice that positions leave open")
        n = self.states
        found = _matrix((n + 1, n + 1), self.retuned.entries, entries, cells)
        for i in [i for i in range(n + 1) if i not in self.retuned.states]:
            found.terms[0, :, i, i] = 1.0
        return found


def _values(law: Law) -> list[float]:
    return [float(value) for _, value in tree.leaves(law)]


def _swinging(value: np.ndarray, swing: np.ndarray, x: Enclosed, load: Enclosed | None, rest: np.ndarray) -> Enclosed:
    """Return a number with a value in the middle of the payloads of each cell and its change to their ends."""
    if load is None:
        return Enclosed(value[None], None, rest)
    assert x.slope is not None
    rows = np.zeros_like(x.slope)
    rows[-2] = swing
    return Enclosed(value[None], rows, rest)


def _fitted(fit: TravelFit, x: Enclosed, load: Enclosed | None) -> Enclosed:
    """Return a number of the axis, as fitted over the travel and the payload, along both."""

    def powers(row: np.ndarray, at: Enclosed) -> Enclosed:
        first, last = float(np.min(row)), float(np.max(row))
        t = at.times(Enclosed.exactly(2.0)).plus(Enclosed.exactly(-first).plus(Enclosed.exactly(-last)))
        return t.times(Enclosed.exactly(last).plus(Enclosed.exactly(-first)).inverse())

    t = powers(fit.places, x)
    s = None if fit.payloads is None or load is None else powers(fit.payloads, load)
    value = Enclosed.exactly(0.0)
    for row in fit.coefficients.reshape(fit.degree + 1, fit.payload_degree + 1)[::-1]:
        inner = Enclosed.exactly(0.0)
        for coefficient in row[::-1]:
            inner = (inner if s is None else inner.times(s)).plus(Enclosed.exactly(float(coefficient)))
        value = value.times(t).plus(inner)
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


class Region(NamedTuple):
    """A cell of positions (m) and of payloads (kg; None where the payload never changes)."""

    low: float
    high: float
    least: float | None = None
    most: float | None = None

    def corners(self) -> tuple[Pair, ...]:
        """Return both ends with the least payload and then, if payloads change, with the largest."""
        loads = (None,) if self.least is None else (self.least, self.most)
        return tuple(Pair(x, load) for load in loads for x in (self.low, self.high))

    def middle(self) -> Pair:
        """Return the middle."""
        load = None if self.least is None or self.most is None else 0.5 * (self.least + self.most)
        return Pair(0.5 * (self.low + self.high), load)

    def halves(self, *, across: bool) -> tuple[Region, Region]:
        """Return both halves of the positions, or with `across` of the payloads."""
        x, load = self.middle()
        if across:
            return self._replace(most=load), self._replace(least=load)
        return self._replace(high=x), self._replace(low=x)


class _Functions:
    """P at pairs for one bound of Ms (None: stability alone), computed once for each."""

    def __init__(self, along: AlongTravel, bound: float | None) -> None:
        self.along, self.bound = along, bound
        self._models: dict[Pair, np.ndarray] = {}
        self._found: dict[tuple[Pair, int], tuple[np.ndarray, int] | None] = {}

    def at(self, pair: Pair, margin: int) -> tuple[np.ndarray, int] | None:
        """Return P, and the index of its margin, at least `margin`; None if no margin has a solution."""
        if (pair, margin) not in self._found:
            found = _riccati(self._models[pair], self.bound, margin)
            self._found[pair, margin] = found
            if found is not None:
                self._found[pair, found[1]] = found
        return self._found[pair, margin]

    def models(self, regions: Sequence[Region]) -> None:
        """Compute the models at the corners of regions that are not known yet."""
        new = [pair for pair in {corner for region in regions for corner in region.corners()} if pair not in self._models]
        if new:
            x = np.array([pair.position for pair in new])
            load = None if new[0].payload is None else np.array([pair.payload for pair in new], float)
            cell, X = self.along.matrices(x, x, 0.0, load, load)
            for i, place in enumerate(cell):
                self._models[new[int(place)]] = X.terms[0, i]

    def corners(self, region: Region, margin: int) -> tuple[np.ndarray, int] | Pair:
        """Return P at the corners of a cell with the same margin, and its index; or a corner that has none."""
        while True:
            found: list[tuple[np.ndarray, int]] = []
            for corner in region.corners():
                one = self.at(corner, max([margin, *(inner[1] for inner in found)]))
                if one is None:
                    return corner
                found.append(one)
            margin = max(inner[1] for inner in found)
            if all(inner[1] == margin for inner in found):
                return np.array([inner[0] for inner in found]), margin


def _frozen_holds(X: Enclosures, P: np.ndarray, bound: float | None) -> np.ndarray:
    """Return for each cell whether the frozen loop is proven in all of it.

    P  at the corners of each cell as `Region.corners` lists them, shape (cells, 2 or 4, n, n)
    """
    n = P.shape[2]
    corners, rest = X.corners()
    middle = np.mean(P, axis=1)
    slope = X.slope
    rest = rest + _ROUND * 3 * (np.abs(corners).max(axis=0) + np.sum(np.abs(slope), axis=0)) if len(slope) else rest
    if bound is None:
        corners, rest, slope = corners[:, :, :n, :n], rest[:, :n, :n], slope[:, :, :n, :n]
    weight = middle if bound is None else _padded(middle, 1.0)
    whiten = np.linalg.inv(np.linalg.cholesky(weight))
    holds = np.ones(P.shape[0], bool)
    for k, corner in enumerate(corners):
        # the coefficients of a straight line in Bernstein's basis are its values at even distances
        share = k / ORDER
        for end in range(P.shape[1] // 2):
            here = (1.0 - share) * P[:, 2 * end] + share * P[:, 2 * end + 1]
            before, after = (here, here) if bound is None else (_padded(here, bound), _padded(here, 1.0))
            value = corner if not len(slope) else corner + (2 * end - 1) * (slope[0] + (2.0 * share - 1.0) * slope[1])
            holds &= proven_positive(value, rest, before, after, weight, whiten)
    return holds


@dataclass(frozen=True, eq=False, repr=False)
class TravelProof(Result):
    """What was proven of a control along the travel of its axis.

    along        the loop along its travel
    bound        the bound on Ms that was to be proven; None for stability alone
    proven       True if it holds at every position and payload between them, False if it does not at `position`, None if
                 that is undecided there
    reason       the reason why it is not proven, as a clause
    cells        the cells of positions that were proven, ascending
    speed        m/s, up to which the moving loop is proven stable; 0 if none was proven, None if none was looked for
    most         True if no higher speed was tried
    top          the largest speed that the guard of the control allows, m/s; None without one
    motion       the proof for the axis that moves, if there is one
    payload      kg, with which it does not hold or is undecided at `position`; None where the payload never changes
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
    payload: float | None = None

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
        loads = self.along.payloads
        with_ = ""
        if loads is not None:
            with_ = f" with every payload from {Quantity(loads[0], 'kg'):6 SI} to {Quantity(loads[1], 'kg'):6 SI}"
        return Text(f"the loop is stable{robust} at every position from {ends}{with_}, each frozen")

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
        rows = [[a, b, sum(a <= cell.region.low < b for cell in self.cells)] for a, b in self.intervals()]
        columns = [Column("from", "m", "6 mm"), Column("to", "m", "6 mm"), "cells"]
        return Table(Text(f"along the travel: {self.verdict}"), columns, rows)

    def intervals(self) -> list[tuple[float, float]]:
        """Return the intervals of positions (m) that were proven, with all payloads, joined where they touch."""
        found: list[tuple[float, float]] = []
        regions = [cell.region for cell in self.cells]
        for low, high in pairwise(sorted({x for region in regions for x in region[:2]})):
            here = [(r.least or 0.0, r.most or 0.0) for r in regions if r.low <= low and r.high >= high]
            loads = self.along.payloads
            if not here or (loads is not None and not travel_check.covered(here, *loads)):
                continue
            if found and found[-1][1] == low:
                found[-1] = found[-1][0], high
            else:
                found.append((low, high))
        return found

    def record(self) -> dict[str, Any]:
        """Return the result as plain values for JSON."""
        return {
            "claim": self.claim,
            "verdict": self.verdict,
            "sensitivity_peak": self.bound,
            "position_m": self.position,
            "payload_kg": self.payload,
            "reason": self.reason or None,
            "from_m": self.first,
            "to_m": self.last,
            "payloads_kg": None if self.along.payloads is None else list(self.along.payloads),
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
        motion = proof.motion
        moving = {
            "step_m": motion.step,
            "edges_m": motion.edges.tolist(),
            "payloads_kg": None if motion.loads is None else motion.loads.tolist(),
            "P": [[_lower(each) for each in row] for row in motion.P],
            "cells": [
                [
                    [_entries(X, int(i)) for i in np.flatnonzero(cell == place)]
                    for place in range(motion.edges.size - 1)
                ]
                for cell, X in (slab.enclosed(along, motion.step) for slab in _slabs(motion.edges, motion.loads))
            ],
        }
    content = {
        "format": travel_check.FORMAT,
        "claim": str(proof.sentence()),
        "outside": list(OUTSIDE),
        "made_from": [dict(origin) for origin in made_from],
        "sensitivity_peak": proof.bound,
        "from_m": along.first,
        "to_m": along.last,
        "payloads_kg": None if along.payloads is None else list(along.payloads),
        "sample_time_s": along.T,
        "states": list(along.traced.names),
        "cells": [
            {
                "from_m": c.region.low,
                "to_m": c.region.high,
                "payloads_kg": None if c.region.least is None else [c.region.least, c.region.most],
                "P": [_lower(P) for P in c.P],
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
    cells = tuple(sorted(search.cells, key=lambda cell: (cell.region.low, cell.region.least or 0.0)))
    fastest = None if not speed else 0.0 if moving is None else moving.step / along.T
    most = moving is not None and moving.most
    position, payload = (None, None) if search.place is None else search.place
    return TravelProof(
        along, sensitivity_peak, search.proven, position, search.reason, cells, fastest, most, top, moving, payload
    )


class Cell(NamedTuple):
    """A cell in which the frozen loop is proven: P at the corners, and the loop in each branch."""

    region: Region
    P: np.ndarray
    X: Enclosures


class _Search:
    """The halving of cells until each is proven, one is found that cannot be, or the work is used up."""

    def __init__(self, along: AlongTravel, bound: float | None) -> None:
        self.along, self.bound = along, bound
        self.functions = _Functions(along, bound)
        self.cells: list[Cell] = []
        self.proven: bool | None = True
        self.place: Pair | None = None
        self.reason = Text()

    def run(self, work: int, progress: Progress) -> None:
        """Examine the whole travel with all payloads; `work` cells at most."""
        breaks, loads = self.along.breaks(), self.along.load_breaks()
        for x in breaks:
            for load in loads if loads.size else (None,):
                if self._refuted(Pair(float(x), None if load is None else float(load))):
                    return
        rows = [pair for a, b in pairwise(breaks.tolist()) for pair in pairwise(np.linspace(a, b, _PARTS + 1).tolist())]
        parts: list[tuple[float | None, float | None]] = [
            pair for a, b in pairwise(loads.tolist()) for pair in pairwise(np.linspace(a, b, _LOADS + 1).tolist())
        ] or [(None, None)]
        waiting = [Region(*row, *part) for row in rows for part in parts][::-1]
        # of the travel and, if the payload changes, of the payloads: the side of a cell over the whole
        length = self.along.last - self.along.first
        mass = 1.0 if self.along.payloads is None else max(self.along.payloads[1] - self.along.payloads[0], 1e-300)

        def size(region: Region) -> float:
            along = (region.high - region.low) / length
            return along if region.least is None or region.most is None else max(along, (region.most - region.least) / mass)

        examined, margin = 0, 0
        while waiting:
            progress.step("positions of the travel")
            some, waiting = waiting[-_TOGETHER:], waiting[:-_TOGETHER]
            examined += len(some)
            if examined > work:
                self.proven, self.place = None, some[-1].middle()
                self.reason = Text(f"{work} cells of positions were examined, as many as are allowed")
                return
            self.functions.models(some)
            low, high, least, most = (
                None if some[0][k] is None else np.array([region[k] for region in some], float) for k in range(4)
            )
            assert low is not None
            assert high is not None
            cell, X = self.along.matrices(low, high, 0.0, least, most)
            corners = [self.functions.corners(region, margin) for region in some]
            there = np.array([not isinstance(one, Pair) for one in corners])
            found = [one for one in corners if not isinstance(one, Pair)]
            margin = max(min((one[1] for one in found), default=1) - 1, 0)
            holds = there.copy()
            rows_ = np.flatnonzero(there[cell])
            if rows_.size:
                place = np.cumsum(there) - 1
                P = np.array([found[place[cell[i]]][0] for i in rows_])
                np.logical_and.at(holds, cell[rows_], _frozen_holds(X.take(rows_), P, self.bound))
            for i in np.flatnonzero(holds):
                one = corners[i]
                assert not isinstance(one, Pair)
                self.cells.append(Cell(some[i], one[0], X.take(np.flatnonzero(cell == i))))
            for i in np.flatnonzero(~holds)[::-1]:
                region, one = some[i], corners[i]
                place_ = one if isinstance(one, Pair) else region.middle()
                # a look at each place would take longer than the proof
                if (isinstance(one, Pair) or size(region) < _LOOKED) and self._refuted(place_):
                    return
                if size(region) < _NARROW:
                    self.proven, self.place = None, place_
                    self.reason = Text(f"{_near(place_)} is too near to the bound to decide")
                    return
                waiting += region.halves(across=self._across(region, one, length, mass))[::-1]

    @staticmethod
    def _across(region: Region, found: tuple[np.ndarray, int] | Pair, length: float, mass: float) -> bool:
        """Return True if the payloads of a cell should be halved: P changes more along them than along its positions.

        Where P is not known, the side that is the larger share of the whole is halved.
        """
        if region.least is None or region.most is None:
            return False
        if isinstance(found, Pair):
            return (region.most - region.least) / mass > (region.high - region.low) / length
        P = found[0]
        whiten = np.linalg.inv(np.linalg.cholesky(np.mean(P, axis=0)))
        changes = (
            max(float(np.linalg.norm(whiten @ (P[b] - P[a]) @ whiten.T)) for a, b in sides)
            for sides in (((0, 1), (2, 3)), ((0, 2), (1, 3)))
        )
        along, across = changes
        return across > along

    def _refuted(self, pair: Pair) -> bool:
        """Return True, and note the pair, if the frozen loop there is unstable or exceeds the bound."""
        loop = self.along.at(*pair)
        poles = stability(loop, velocity=self.along.velocity)
        reason = Text()
        if not poles.stable:
            reason = Text(f"at {pair.text} it is unstable: a pole at |z| = {Quantity(poles.growth):.6f}")
        elif self.bound is not None:
            peak, frequency = self._peak(loop, pair.position)
            if peak > self.bound:
                reason = Text(f"at {pair.text} |S| is {Quantity(peak):6} at {Quantity(frequency, 'Hz'):4}")
        if reason:
            self.proven, self.place, self.reason = False, pair, reason
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


def _near(pair: Pair) -> Text:
    """Return a pair in words, with as many digits as a narrow cell needs."""
    with_ = "" if pair.payload is None else f" with {Quantity(pair.payload, 'kg'):7 SI}"
    return Text(f"{Quantity(pair.position, 'm'):7 SI}{with_}")


class Moving(NamedTuple):
    """The proof for an axis that moves: P at the edges of cells, and the largest change of position in a sample, m.

    P      shape (payloads, edges, n, n); one row where the payload never changes
    loads  kg, the edges of payloads between which P is linear, or None
    most   True if no larger one was tried
    """

    edges: np.ndarray
    loads: np.ndarray | None
    P: np.ndarray
    step: float
    most: bool


class _Slab(NamedTuple):
    """All cells of positions, with the payloads between two edges (kg; None where the payload never changes)."""

    number: int
    edges: np.ndarray
    least: float | None
    most: float | None

    def enclosed(self, along: AlongTravel, step: float) -> tuple[np.ndarray, Enclosures]:
        """Return the enclosures of the loop whose axis is within a step of where the law read it."""
        low, high = self.edges[:-1], self.edges[1:]
        loads = (None if load is None else np.full(low.size, load) for load in (self.least, self.most))
        return along.matrices(low, high, step if along.places else 0.0, *loads)


def _slabs(edges: np.ndarray, loads: np.ndarray | None) -> list[_Slab]:
    if loads is None:
        return [_Slab(0, edges, None, None)]
    return [_Slab(i, edges, a, b) for i, (a, b) in enumerate(pairwise(loads.tolist()))]


def _fastest(along: AlongTravel, progress: Progress) -> Moving | None:
    """Return the proof for the largest step that was found; None if there is none for the slowest motion."""
    breaks, width = along.breaks(), (along.last - along.first) / _MESH
    parts = [np.linspace(a, b, max(2, int(np.ceil((b - a) / width))) + 1) for a, b in pairwise(breaks.tolist())]
    edges, kinks = np.unique(np.concatenate(parts)), along.load_breaks()
    for count, share in product(_SLABS if kinks.size else (1,), _SHARES):
        loads: np.ndarray | None = None
        if kinks.size:
            loads = np.unique(np.concatenate([np.linspace(a, b, count + 1) for a, b in pairwise(kinks.tolist())]))
        P = _lyapunov_along(along, edges, loads, share)
        # the change of P crosses one edge at most: two steps in a cell
        low, high = _SLOWEST * along.T, min(_FASTEST * along.T, 0.49 * float(np.min(np.diff(edges))))
        if P is None:
            continue

        def holds(step: float, loads: np.ndarray | None = loads, P: np.ndarray = P) -> bool:
            progress.step("speeds")
            return all(
                _moving_holds(along, slab, P[slab.number : slab.number + (1 if loads is None else 2)], step)
                for slab in _slabs(edges, loads)
            )

        if not holds(low):
            continue
        if holds(high):
            return Moving(edges, loads, P, high, True)
        while high > 1.05 * low:
            step = float(np.sqrt(low * high))
            low, high = (step, high) if holds(step) else (low, step)
        return Moving(edges, loads, P, low, False)
    return None


def _lyapunov_along(
    along: AlongTravel, edges: np.ndarray, loads: np.ndarray | None, share: float
) -> np.ndarray | None:
    """Return P at positions and payloads: Aᵀ P A < decay² P, the decay a share of the way from 1 to the largest |z|."""
    n = along.states
    rows: list[np.ndarray] = []
    for load in (None,) if loads is None else loads.tolist():
        payload = None if load is None else np.full(edges.size, load)
        cell, X = along.matrices(edges, edges, 0.0, payload, payload)
        found = np.zeros((edges.size, n, n))
        for i, place in enumerate(cell):
            A, c = X.terms[0, i, :n, :n], X.terms[0, i, n:, :n]
            growth = float(np.max(np.abs(np.linalg.eigvals(A))))
            if growth >= 1.0:
                return None
            P = _lyapunov(A / (1.0 - share * (1.0 - growth)), c.T @ c + _WEAK * np.eye(n))
            found[place] = 0.5 * (P + P.T)
        rows.append(found)
    return np.array(rows)


def _moving_holds(along: AlongTravel, slab: _Slab, P: np.ndarray, step: float) -> bool:
    """Return True if the moving loop is proven stable for a motion of at most `step` (m) in a sample.

    P  at the edges of the cells, linear between them, with the least and the largest payload of the slab: shape
       (1 or 2, edges, n, n).  The axis is at y in a sample, and the law reads one within a step of it: from one sample
       to the next y changes by two steps at most.
    """
    cell, X = slab.enclosed(along, step)
    n = along.states
    corners, rest = X.corners()
    corners, rest, slopes = corners[:, :, :n, :n], rest[:, :n, :n], X.slope[:, :, :n, :n]
    rest = rest + _ROUND * (len(slopes) + 1) * (np.abs(corners).max(axis=0) + np.sum(np.abs(slopes), axis=0))
    # the slope along the payload is the last one: P is linear along it, too
    with_payload = np.zeros((2, *rest.shape)) if slab.least is None else slopes[-2:]
    slopes = slopes if slab.least is None else slopes[:-2]
    weight = 0.5 * np.mean(P[:, :-1] + P[:, 1:], axis=0)[cell]
    whiten = np.linalg.inv(np.linalg.cholesky(weight))
    # few cells are near a place, and all others have no slope along its variables
    turning = np.any(slopes != 0.0, axis=(2, 3))
    patterns = np.unique(turning, axis=1).T if len(slopes) else [np.zeros(0, bool)]
    for (end, here_), pattern in product(enumerate(P), patterns):
        first, last = here_[:-1][cell], here_[1:][cell]
        change = np.diff(here_, axis=0) / np.diff(slab.edges)[:, None, None]
        left, right = change[np.maximum(cell - 1, 0)], change[np.minimum(cell + 1, len(change) - 1)]
        here = np.flatnonzero(np.all(turning == pattern[:, None], axis=0)) if len(slopes) else np.arange(cell.size)
        for k, corner in enumerate(corners):
            share = k / ORDER
            after = ((1.0 - share) * first + share * last)[here]
            loaded = corner + (2 * end - 1) * (with_payload[0] + (2.0 * share - 1.0) * with_payload[1])
            for sign in product((-1.0, 1.0), repeat=int(np.sum(pattern))):
                value = loaded[here]
                for s, slope in zip(sign, slopes[pattern], strict=True):
                    value = value + s * slope[here]
                # the change of P on the way from the last sample is a mean of those of the cells on it
                for way, each in ((1.0, change[cell]), (-1.0, change[cell]), (1.0, left), (-1.0, right)):
                    before = after - way * 2.0 * step * each[here]
                    if not np.all(proven_positive(value, rest[here], before, after, weight[here], whiten[here])):
                        return False
    return True

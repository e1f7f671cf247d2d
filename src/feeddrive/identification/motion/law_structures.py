"""Structures of control laws: their regressors, and their least-squares fit to the command of a log."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from feeddrive.identification.motion.law_rows import Basis, LawRows, Reduced, Term, filtered, reduced, triangle

# 1/Tn in 1/s: integral times from 0.7 ms to 3 s; a slower integral is a constant within a move
_SLOWEST, _FASTEST, _POINTS = 0.3, 1500.0, 33
_ROUNDS, _WITHIN = 5, 9  # of the search for 1/Tn about a minimum, each with so many points

_MERGED = 0.1  # of ln 1/Tn, within which two minima are one

CASCADE, PID = "cascade", "pid"
FORWARD = ("free", "one", "none")  # the velocity feedforward of a cascade


class Lag(NamedTuple):
    """A low pass of the command, y(k) = pole y(k-1) + (1 - pole) ((1 - old) u(k) + old u(k-1)); `old` is 0 or 1/2."""

    pole: float
    old: float


class Model(NamedTuple):
    """A reference model in the integral: r = T Kp / model_mass, and its dead time in samples.

    inside  True if the dead time is in the loop of the model, as in `CascadePPI`; False if it precedes a lag of first
            order
    """

    rate: float
    samples: int
    inside: bool = True

    def coefficients(self) -> tuple[np.ndarray, np.ndarray]:
        """Return b and a of the filter from the velocity command to the velocity that the integral expects.

        v_m(k+1) = v_m(k) + r/2 (u(k-m) + u(k-m-1)),   u = command - v_m                         (inside)
        v_m(k+1) = v_m(k) + r/2 (c(k) - v_m(k+1) + c(k-1) - v_m(k)),   c = command m samples ago  (before)
        """
        half, b = 0.5 * self.rate, np.zeros(self.samples + 3)
        b[-2:] = half
        a = np.zeros(self.samples + 3)
        a[:2] = 1.0, -1.0
        if self.inside:
            return b, a + b
        a[:2] = 1.0 + half, half - 1.0
        return b, a


@dataclass(frozen=True)
class Structure:
    """A control law but for its gains.

    family    a cascade of position and velocity loop, or one PID
    integral  the cascade's velocity loop has an integral
    n, d      samples over which the velocity is differenced, and samples between reading and command
    older     samples by which the setpoint is older than the reading
    central   the set velocity is the planner's own, not a backward difference
    forward   velocity feedforward: of a cascade free, one or none; of a PID free (FF1) or none
    fed       when the set acceleration is taken that is fed forward; empty for none
    friction  samples by which the direction of the set motion is older that friction feedforward uses; None for none
    compliance  s2: the law read a motor that is ahead of the logged load by this times its acceleration, m_load/k
    shifted   the zero of the logged reading is not that of the law: its integral then rises by a straight line
    sides     friction feedforward has a level for each direction
    """

    family: str
    integral: bool
    n: int
    d: int
    older: int = 0
    central: bool = False
    forward: str = "free"
    fed: str = ""
    friction: int | None = None
    sides: bool = False
    model: Model | None = None
    lag: Lag | None = None
    compliance: float = 0.0
    shifted: bool = False

    @property
    def gains(self) -> tuple[str, ...]:
        """The names of the linear coefficients."""
        if self.family == PID:
            names = ["P", *(["I"] if self.integral else []), "D", *(["FF1"] if self.forward == "free" else [])]
        else:
            names = ["Kp Kv", *(["Kp ff"] if self.forward == "free" else []), "Kp"]
        names += ["mass"] if self.fed else []
        if self.friction is not None:
            names += ["friction", *(["difference"] if self.sides else [])]
        names += ["slope"] if self.shifted else []
        return tuple(names)

    @property
    def curved(self) -> bool:
        """True if the force is not linear in the unknowns: 1/Tn multiplies the gains of a cascade."""
        return self.family == CASCADE and self.integral

    @property
    def parameters(self) -> int:
        """The number of unknowns; discrete choices do not count."""
        return (
            len(self.gains) + self.curved + (self.model is not None) + (self.lag is not None) + (self.compliance > 0.0)
        )

    def terms(self, basis: Basis) -> tuple[list[Term], list[Term]]:
        """Return the regressors A and B of the gains: the columns are A + B/Tn."""
        if self.lag is None or self.lag.old == 0.0:
            return self._terms(basis, self.d)
        pairs = zip(self._terms(basis, self.d), self._terms(basis, self.d + 1), strict=True)
        share = self.lag.old
        new, old = (
            [(1.0 - share) * at + share * before for at, before in zip(now, past, strict=True)] for now, past in pairs
        )
        return new, old

    def _terms(self, basis: Basis, d: int) -> tuple[list[Term], list[Term]]:
        n, q, zero = self.n, self.older, basis.zero()
        h = float(self.compliance)
        e, Se, v = basis.error(d, q, h), basis.error_sum(d, q, h), basis.velocity(n, d, h)
        wanted = basis.set_velocity(d + q, central=self.central)
        if self.family == PID:
            # LinuxCNC's pid: an older target enters the error alone
            wanted = basis.set_velocity(d, central=self.central)
            plain = [e, *([Se] if self.integral else []), wanted - v, *([wanted] if self.forward == "free" else [])]
            summed = [zero] * len(plain)
            q = 0
        else:
            X, Sv = basis.travel(n, d, h), basis.set_travel(d + q, central=self.central)
            if self.forward == "free":
                plain, summed = [e, wanted, zero - v], [Se, Sv, zero - X]
            elif self.forward == "one":
                plain, summed = [e, wanted - v], [Se, Sv - X]
            else:
                plain, summed = [e, zero - v], [Se, zero - X]
        if self.fed:
            plain, summed = [*plain, basis.set_acceleration(d + q, self.fed)], [*summed, zero]
        if self.friction is not None:
            age = d + self.friction
            plain, summed = [*plain, basis.one(f"sign{age}")], [*summed, zero]
            if self.sides:
                plain, summed = [*plain, basis.one(f"moves{age}")], [*summed, zero]
        if self.shifted:
            plain, summed = [*plain, basis.one("t")], [*summed, zero]
        return plain, summed


@dataclass(frozen=True, eq=False)
class Fitted:
    """A structure with the gains that a log requires.

    values  the linear coefficients, in the order of `Structure.gains`
    rate    1/Tn, 1/s; 0 without
    ssr     sum of squares of the force that is left
    """

    structure: Structure
    values: np.ndarray
    rate: float
    ssr: float

    def __getitem__(self, gain: str) -> float:
        return float(self.values[self.structure.gains.index(gain)])

    @property
    def sensible(self) -> bool:
        """True if the law acts against the error: its loop gains are positive."""
        kind = self.structure
        if kind.family == PID:
            return self["P"] > 0.0 and self["D"] > 0.0 and (not kind.integral or self["I"] > 0.0)
        forward = self["Kp ff"] > -0.05 * self["Kp"] if kind.forward == "free" else True
        return self["Kp Kv"] > 0.0 and self["Kp"] > 0.0 and forward


class Problem(NamedTuple):
    """The columns A + B/Tn of a structure and the force, reduced to a few rows: (rows, p), (rows, p), (rows,)."""

    A: np.ndarray
    B: np.ndarray
    y: np.ndarray


def problem(structure: Structure, basis: Basis, part: Reduced, extra: int = 0) -> Problem:
    """Return the reduced problem of a structure; `extra` columns behind the basis belong to a reference model."""
    A, B = structure.terms(basis)
    on_a = np.stack([np.pad(term.on, (0, extra)) for term in A], axis=1)
    on_b = np.stack([np.pad(term.on, (0, extra)) for term in B], axis=1)
    if structure.model is not None:
        # the integral compares with the velocity of the model: Se and the set travel pass through it
        on_b[:, 0], on_b[-2, 0] = 0.0, 1.0
        if structure.forward != "none":
            own = -np.pad(basis.travel(structure.n, structure.d).on, (0, extra)) if structure.forward == "one" else 0.0
            on_b[:, 1] = own
            on_b[-1, 1] += 1.0
    return Problem(part.factor @ on_a, part.factor @ on_b, part.right)


def lefts(task: Problem, rates: np.ndarray) -> np.ndarray:
    """Return the sum of squares that is left for each 1/Tn, with the best gains."""
    C = task.A[None] + rates[:, None, None] * task.B[None]
    sizes = np.linalg.norm(C, axis=1, keepdims=True)
    Q, _ = np.linalg.qr(C / np.where(sizes > 0.0, sizes, 1.0))
    z = np.einsum("krp,r->kp", Q, task.y)
    rest = task.y - np.einsum("krp,kp->kr", Q, z)
    return np.einsum("kr,kr->k", rest, rest)


def gains(task: Problem, rate: float) -> tuple[np.ndarray, float]:
    """Return the gains for one 1/Tn, and the sum of squares that is left."""
    C = task.A + rate * task.B
    sizes = np.linalg.norm(C, axis=0)
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    values = np.linalg.lstsq(C / sizes, task.y, rcond=1e-13)[0] / sizes
    rest = task.y - C @ values
    return values, float(rest @ rest)


def fits(structure: Structure, task: Problem) -> Iterator[Fitted]:
    """Yield the fits of a structure: one for each local minimum over 1/Tn, as Kv and 1/Tn may change places."""
    if not structure.curved:
        yield Fitted(structure, *_with(task, 0.0))
        return
    grid = np.geomspace(_SLOWEST, _FASTEST, _POINTS)
    left = lefts(task, grid)
    lowest = np.flatnonzero((left[1:-1] <= left[:-2]) & (left[1:-1] <= left[2:])) + 1
    # a minimum at an end of the range is a law without an integral, or with nothing else
    found = [_lowest(task, math.log(grid[k - 1]), math.log(grid[k + 1])) for k in lowest]
    for rate in list(found):
        values, _ = gains(task, rate)
        Kv = float(values[0] / values[structure.gains.index("Kp")])
        # Kv and 1/Tn exchanged, which the grid may hide between two points
        if Kv > 0.0 and all(abs(math.log(Kv / other)) > _MERGED for other in found):
            low, high = math.log(Kv) - _MERGED, math.log(Kv) + _MERGED
            other = _lowest(task, low, high)
            if low + 0.01 < math.log(other) < high - 0.01:
                found.append(other)
    for rate in found:
        yield Fitted(structure, *_with(task, rate))


def _lowest(task: Problem, low: float, high: float) -> float:
    """Return the 1/Tn that leaves least, between two logarithms."""
    rate = math.exp(0.5 * (low + high))
    for _ in range(_ROUNDS):
        near = np.linspace(low, high, _WITHIN)
        best = int(np.argmin(lefts(task, np.exp(near))))
        low, high = near[max(best - 1, 0)], near[min(best + 1, _WITHIN - 1)]
        rate = math.exp(near[best])
    return rate


def _with(task: Problem, rate: float) -> tuple[np.ndarray, float, float]:
    values, ssr = gains(task, rate)
    return values, rate, ssr


def fit(structure: Structure, basis: Basis, part: Reduced, extra: int = 0) -> Fitted | None:
    """Return the sensible fit with the smallest residual, or None."""
    return sensible(structure, problem(structure, basis, part, extra))


def minima(structure: Structure, basis: Basis, part: Reduced) -> list[Fitted]:
    """Return all sensible fits: where Kv and 1/Tn may change places, there are two."""
    return [one for one in fits(structure, problem(structure, basis, part)) if one.sensible]


def sensible(structure: Structure, task: Problem) -> Fitted | None:
    """Return the fit of a problem with the smallest residual among those that act against the error, or None."""
    found = [one for one in fits(structure, task) if one.sensible]
    return min(found, key=lambda one: one.ssr, default=None)


def wide(basis: Basis, n: int, d: int, *, friction: bool) -> list[Term]:
    """Return the regressors of the superset of all structures with these n and d."""
    terms = [basis.error(d), basis.error_sum(d), basis.set_position(d), basis.travel(n, d), basis.velocity(n, d)]
    terms += [basis.one(f"ds{j}") for j in range(d - 1, d + 3)]
    if friction:
        terms += [basis.one(f"{kind}{j}") for kind in ("sign", "moves") for j in (d - 1, d)]
    return terms


def left_by(part: Reduced, terms: list[Term]) -> float:
    """Return the sum of squares that is left by regressors, and by columns behind the basis, with free coefficients."""
    size = terms[0].on.size
    C = np.hstack([part.factor[:, :size] @ np.stack([term.on for term in terms], axis=1), part.factor[:, size:]])
    sizes = np.linalg.norm(C, axis=0)
    kept = sizes > 0.0
    values = np.linalg.lstsq(C[:, kept] / sizes[kept], part.right, rcond=1e-13)[0]
    rest = part.right - (C[:, kept] / sizes[kept]) @ values
    return float(rest @ rest)


def through_model(rows: LawRows, model: Model, d: int, older: int, *, central: bool) -> np.ndarray:
    """Return Se and the set travel after a reference model, over the rows, shape (rows, 2)."""
    basis = rows.basis
    on = np.stack([basis.error_sum(d, older).on, basis.set_travel(d + older, central=central).on], axis=1)
    return filtered(rows, model.coefficients(), rows.whole @ on)


def lagged(rows: LawRows, pole: float, places: np.ndarray | slice = slice(None)) -> np.ndarray:
    """Return basis columns over the rows after a low pass of first order."""
    return filtered(rows, _low_pass(pole), rows.whole[:, places])


def lagged_problem(rows: LawRows, structure: Structure) -> Problem:
    """Return the problem of one structure with a low pass; only its own columns are filtered."""
    assert structure.lag is not None
    A, B = structure.terms(rows.basis)
    on = np.stack([term.on for term in (*A, *B)], axis=1)
    part = reduced(filtered(rows, _low_pass(structure.lag.pole), rows.whole @ on), rows.force)
    return Problem(part.factor[:, : len(A)], part.factor[:, len(A) :], part.right)


def _low_pass(pole: float) -> tuple[np.ndarray, np.ndarray]:
    return np.array([1.0 - pole]), np.array([1.0, -pole])


def regressors(found: Fitted, rows: LawRows) -> np.ndarray:
    """Return the derivatives of the force with respect to the gains and 1/Tn over the rows."""
    structure, basis = found.structure, rows.basis
    columns = rows.columns if structure.lag is None else lagged(rows, structure.lag.pole)
    extra = 0
    if structure.model is not None:
        more = through_model(rows, structure.model, structure.d, structure.older, central=structure.central)
        columns, extra = np.hstack([columns, more]), more.shape[1]
    whole = Reduced(columns, rows.force)
    task = problem(structure, basis, whole, extra)
    C = task.A + found.rate * task.B
    return np.column_stack([C, task.B @ found.values]) if structure.curved else C


def reduced_for(rows: LawRows, structure: Structure) -> tuple[Reduced, int]:
    """Return the reduced problem in which a structure with a model or a low pass is linear but for 1/Tn."""
    columns, extra = rows.columns, 0
    if structure.lag is not None:
        columns = lagged(rows, structure.lag.pole)
    if structure.model is not None:
        more = through_model(rows, structure.model, structure.d, structure.older, central=structure.central)
        columns, extra = np.hstack([columns, more]), more.shape[1]
    return reduced(columns, rows.force), extra


class ModelProblems:
    """The problems of P-PI cascades with one n and d and any reference model, reduced to the columns that they have."""

    def __init__(self, rows: LawRows, n: int, d: int) -> None:
        self.rows, self.n, self.d = rows, n, d
        basis = rows.basis
        own = [basis.error(d), basis.set_velocity(d, central=False), basis.velocity(n, d), basis.travel(n, d)]
        self.Q, R = np.linalg.qr(np.column_stack([rows.at(own), rows.force]))
        self.own, self.y = R[:, :-1], R[:, -1]
        inputs = [basis.error_sum(d), basis.set_travel(d, central=False)]
        self.inputs = rows.whole @ np.stack([term.on for term in inputs], axis=1)

    def along(self, model: Model, forward: str) -> Callable[[float], Fitted | None]:
        """Return the fit as a function of the rate of the model."""
        return lambda rate: self.fit(model._replace(rate=rate), forward)

    def fit(self, model: Model, forward: str) -> Fitted | None:
        """Return the fit with a model, or None."""
        more = filtered(self.rows, model.coefficients(), self.inputs)
        on = self.Q.T @ more
        outside = triangle(more - self.Q @ on)
        wide = np.block([[self.own, on], [np.zeros((2, 4)), outside]])
        e, wanted, v, X, Se, Sv = wide.T
        y = np.concatenate([self.y, np.zeros(2)])
        columns = {
            "free": ([e, wanted, -v], [Se, Sv, -X]),
            "one": ([e, wanted - v], [Se, Sv - X]),
            "none": ([e, -v], [Se, -X]),
        }
        A, B = columns[forward]
        structure = Structure(CASCADE, True, self.n, self.d, forward=forward, model=model)
        return sensible(structure, Problem(np.stack(A, 1), np.stack(B, 1), y))

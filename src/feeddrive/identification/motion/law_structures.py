"""Structures of control laws: their regressors, and their least-squares fit to the command in a log."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from feeddrive.identification.motion.law_rows import (
    STIFF,
    Basis,
    LawRows,
    Reduced,
    Signals,
    Term,
    Twist,
    filtered,
    reduced,
    triangle,
)

# 1/Tn in 1/s: integral times from 0.7 ms to 3 s; a slower integral is a constant within a move
_SLOWEST, _FASTEST, _POINTS = 0.3, 1500.0, 33
_GRID = np.geomspace(_SLOWEST, _FASTEST, _POINTS)
_ROUNDS, _WITHIN = 5, 9  # of the search for 1/Tn about a minimum, each with so many points
_PARTS = np.arange(float(_WITHIN))

_MERGED = 0.1  # of ln 1/Tn, within which two minima are one

CASCADE, PID = "cascade", "pid"
FORWARD = ("free", "one", "none")  # the velocity feedforward of a cascade


class Lag(NamedTuple):
    """A low pass, y(k) = pole y(k-1) + (1 - pole) ((1 - old) u(k) + old u(k-1)); `old` is 0 or 1/2."""

    pole: float
    old: float

    def coefficients(self) -> tuple[np.ndarray, np.ndarray]:
        """Return b and a of the filter."""
        return (1.0 - self.pole) * np.array([1.0 - self.old, self.old]), np.array([1.0, -self.pole])


class Model(NamedTuple):
    """A reference model in the integral: its rate r = T Kp / model_mass, and its dead time in samples.

    inside  True if the dead time is inside the loop of the model, as in `CascadePPI`; False if it precedes a
            first-order lag
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
    """The structure of a control law, without the values of its gains.

    family    "cascade", of a position and a velocity loop, or "pid"
    integral  True if the velocity loop of the cascade, or the PID, has an integral
    n, d      number of samples over which the velocity is differenced, and from the reading to the command
    older     samples by which the setpoint is older than the reading
    central   True if the set velocity is that of the planner, not a backward difference
    forward   velocity feedforward: "free", "one" or "none" for a cascade, "free" (FF1) or "none" for a PID
    fed       when the set acceleration is taken that is fed forward; empty for none
    friction  samples by which the direction of the set motion is older that friction feedforward uses; None for none
    lag       a low pass of the whole command
    eased     a low pass of the measured velocity alone, as drives smooth the actual speed
    twist     the law read a motor that is ahead of the logged load
    drag      True if load friction twists the axis, so that the motor leads by a constant in the direction of motion
    shifted   True if the zero of the logged reading is not that of the law, whose integral then contains a ramp
    sides     True if friction feedforward has a separate level for each direction
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
    eased: Lag | None = None
    twist: Twist = STIFF
    drag: bool = False
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
        names += ["drag"] if self.drag else []
        return tuple(names)

    @property
    def curved(self) -> bool:
        """True if the force is not linear in the unknowns: 1/Tn multiplies the gains of a cascade."""
        return self.family == CASCADE and self.integral

    @property
    def late(self) -> float:
        """The delay from the motion to the resulting command in samples, without that of a low pass."""
        return 0.5 * (self.n - 1) + self.d

    @property
    def parameters(self) -> int:
        """The number of unknowns, without discrete choices."""
        return (
            len(self.gains)
            + self.curved
            + (self.model is not None)
            + (self.lag is not None)
            + (self.eased is not None)
            + (self.twist.compliance > 0.0)
            + (self.twist.loss > 0.0)
        )

    def terms(self, basis: Basis) -> tuple[list[Term], list[Term]]:
        """Return the regressors A and B of the gains; the columns are A + B/Tn."""
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
        h = self.twist
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
    rate    1/Tn, 1/s; 0 for a structure without Tn
    ssr     residual sum of squares of the force
    """

    structure: Structure
    values: np.ndarray
    rate: float
    ssr: float

    def __getitem__(self, gain: str) -> float:
        return float(self.values[self.structure.gains.index(gain)])

    @property
    def sensible(self) -> bool:
        """True if the law acts against the error, and its friction feedforward against friction.

        A position loop slower than the slowest integral is none: Kv took the place of an 1/Tn that is not there.
        """
        kind = self.structure
        if kind.friction is not None and self["friction"] < 0.0:
            return False
        if kind.family == PID:
            return self["P"] > 0.0 and self["D"] > 0.0 and (not kind.integral or self["I"] > 0.0)
        forward = self["Kp ff"] > -0.05 * self["Kp"] if kind.forward == "free" else True
        return self["Kp"] > 0.0 and self["Kp Kv"] > _SLOWEST * self["Kp"] and forward


class Problem(NamedTuple):
    """The columns A + B/Tn of a structure and the force, reduced to a few rows: (rows, p), (rows, p), (rows,)."""

    A: np.ndarray
    B: np.ndarray
    y: np.ndarray


_BENT, _LOSSY = Twist(1.0, 0.0), Twist(1.0, 1.0)  # with which all twists are told


def _aged(lag: Lag | None) -> Lag | None:
    return lag and Lag(0.0, lag.old)


@lru_cache(maxsize=2048)
def _on(structure: Structure, T: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the coefficients of the regressors A and B on the basis columns, shape (basis, regressors) each."""
    A, B = structure.terms(Basis(T))
    return np.stack([term.on for term in A], axis=1), np.stack([term.on for term in B], axis=1)


def problem(structure: Structure, basis: Basis, part: Reduced) -> Problem:
    """Return the reduced problem of a structure.

    Columns of `part` behind the basis belong to a model or a drag, or are the columns of the reading after a low pass.
    """
    on_a, on_b = np.zeros((2, part.factor.shape[1], len(structure.gains)))
    h, plain = structure.twist, replace(structure, model=None, lag=_aged(structure.lag), eased=None, twist=STIFF)
    own = slice(0, len(structure.gains) - structure.drag)
    parts = [(1.0, STIFF)]
    # the columns are linear in h and h d/k
    if h.compliance:
        parts = [(1.0 - h.compliance, STIFF), (h.compliance * (1.0 - h.loss), _BENT), (h.compliance * h.loss, _LOSSY)]
    for weight, twist in parts:
        A, B = _on(replace(plain, twist=twist), basis.T)
        on_a[: basis.size, own] += weight * A
        on_b[: basis.size, own] += weight * B
    if structure.drag:
        on_a[: basis.size, -1], on_b[-1, -1] = basis.one(f"sign{structure.d}").on, 1.0
    if structure.eased is not None:
        k, read = structure.gains.index("Kp"), basis.reading_places
        for on, term in (
            (on_a, basis.velocity(structure.n, structure.d)),
            (on_b, basis.travel(structure.n, structure.d)),
        ):
            on[: basis.size, k] += term.on
            on[basis.size :, k] = -term.on[read]
    if structure.model is not None:
        # the integral compares with the velocity of the model: Se and the set travel pass through it
        on_b[:, 0], on_b[-2, 0] = 0.0, 1.0
        if structure.forward != "none":
            on_b[:, 1] = 0.0
            if structure.forward == "one":
                on_b[: basis.size, 1] = -basis.travel(structure.n, structure.d).on
            on_b[-1, 1] += 1.0
    return Problem(part.factor @ on_a, part.factor @ on_b, part.right)


def fits(structures: Sequence[Structure], tasks: Sequence[Problem]) -> list[Fitted]:
    """Return the fits of structures, one for each local minimum over 1/Tn, since Kv and 1/Tn may be interchanged.

    All problems have the same number of rows. Those with the same number of gains are solved together.
    """
    found = list[tuple[int, Fitted]]()
    alike = dict[tuple[bool, int], list[int]]()
    for k, (structure, task) in enumerate(zip(structures, tasks, strict=True)):
        alike.setdefault((structure.curved, task.A.shape[1]), []).append(k)
    for (curved, _), members in alike.items():
        stack = _stacked([tasks[k] for k in members])
        which, rates = np.arange(len(members)), np.zeros(len(members))
        if curved:
            which, rates = _minima(stack, [structures[members[k]].gains.index("Kp") for k in which])
        values, left = _gains(stack, which, rates)
        found += [
            (members[k], Fitted(structures[members[k]], gains, float(rate), float(ssr)))
            for k, rate, gains, ssr in zip(which, rates, values, left, strict=True)
        ]
    found.sort(key=lambda pair: pair[0])
    return [one for _, one in found]


def _stacked(tasks: Sequence[Problem]) -> Problem:
    """Return problems of equal size stacked along a new first axis, and reduced to as few rows as possible."""
    A, B, y = (np.stack(parts) for parts in zip(*tasks, strict=True))
    p = A.shape[2]
    if A.shape[1] <= 2 * p + 1:
        return Problem(A, B, y)
    R = np.asarray(np.linalg.qr(np.concatenate([A, B, y[..., None]], axis=2), mode="r"))
    return Problem(R[..., :p], R[..., p : 2 * p], R[..., -1])


def _columns(stack: Problem, which: np.ndarray, rates: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the columns of the problems `which` at one 1/Tn each, scaled to unit norm, their norms, and the force."""
    C = stack.A[which] + rates[:, None, None] * stack.B[which]
    sizes = np.linalg.norm(C, axis=1)
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    return C / sizes[:, None, :], sizes, stack.y[which]


def _lefts(stack: Problem, which: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Return the residual sums of squares of the problems `which` (k,) with the best gains, for 1/Tn (k, m)."""
    p = stack.A.shape[2]
    both = np.empty((*rates.shape, stack.A.shape[1], p + 1))
    both[..., :p] = stack.A[which][:, None] + rates[..., None, None] * stack.B[which][:, None]
    both[..., p] = stack.y[which][:, None]
    # the last entry of the triangular factor of columns and force; `raw` is that factor, transposed, with more below
    factor, _ = np.linalg.qr(both, mode="raw")
    return factor[..., p, p] ** 2


def _gains(stack: Problem, which: np.ndarray, rates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the gains (k, p) and the residual sums of squares (k,) of the problems `which` (k,) at one 1/Tn each."""
    C, sizes, y = _columns(stack, which, rates)
    scaled = (np.linalg.pinv(C, rcond=1e-13) @ y[..., None])[..., 0]
    rest = y - (C @ scaled[..., None])[..., 0]
    return scaled / sizes, np.einsum("kr,kr->k", rest, rest)


def _minima(stack: Problem, damping: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Return all local minima over 1/Tn: the indices of their problems, ascending, and 1/Tn.

    `damping` is the index of the gain Kp in each problem.
    """
    left = _lefts(stack, np.arange(len(damping)), np.tile(_GRID, (len(damping), 1)))
    # a minimum at an end of the range is a law without an integral, or with nothing else
    which, at = np.nonzero((left[:, 1:-1] <= left[:, :-2]) & (left[:, 1:-1] <= left[:, 2:]))
    rates = _lowest(stack, which, np.log(_GRID[at]), np.log(_GRID[at + 2]))
    values, _ = _gains(stack, which, rates)
    Kp = values[np.arange(which.size), np.asarray(damping)[which]]
    with np.errstate(divide="ignore", invalid="ignore"):
        Kv = values[:, 0] / Kp
    # Kv and 1/Tn exchanged, which the grid may hide between two points
    known = [[math.log(rate) for rate in rates[which == k]] for k in range(len(damping))]
    hidden = [
        k
        for k, own in enumerate(which)
        if 0.0 < Kv[k] < math.inf and all(abs(math.log(Kv[k]) - other) > _MERGED for other in known[own])
    ]
    if hidden:
        low, high = np.log(Kv[hidden]) - _MERGED, np.log(Kv[hidden]) + _MERGED
        others = _lowest(stack, which[hidden], low, high)
        inside = (np.log(others) > low + 0.01) & (np.log(others) < high - 0.01)
        which, rates = np.append(which, which[hidden][inside]), np.append(rates, others[inside])
    order = np.argsort(which, kind="stable")
    return which[order], rates[order]


def _lowest(stack: Problem, which: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return the 1/Tn (k,) of smallest residual of the problems `which`, searched for from ln(1/Tn) `low` to `high`."""
    rates, every = np.exp(0.5 * (low + high)), np.arange(which.size)
    for _ in range(_ROUNDS if which.size else 0):
        # `np.linspace` along an axis, which takes half as long as the fits themselves
        near = low[:, None] + _PARTS * ((high - low) / _PARTS[-1])[:, None]
        near[:, -1] = high
        best = np.argmin(_lefts(stack, which, np.exp(near)), axis=1)
        low, high = near[every, np.maximum(best - 1, 0)], near[every, np.minimum(best + 1, _WITHIN - 1)]
        rates = np.exp(near[every, best])
    return rates


def fit(structure: Structure, basis: Basis, part: Reduced) -> Fitted | None:
    """Return the sensible fit with the smallest residual, or None."""
    return sensible(structure, problem(structure, basis, part))


def minima(structures: Iterable[Structure], basis: Basis, part: Reduced) -> list[Fitted]:
    """Return all sensible fits of structures; there are two if Kv and 1/Tn can be interchanged."""
    tried = list(structures)
    return [one for one in fits(tried, [problem(one, basis, part) for one in tried]) if one.sensible]


def sensible(structure: Structure, task: Problem) -> Fitted | None:
    """Return the sensible fit of a problem with the smallest residual, or None."""
    found = [one for one in fits([structure], [task]) if one.sensible]
    return min(found, key=lambda one: one.ssr, default=None)


def wide(basis: Basis, n: int, d: int, *, friction: bool, speed: bool = True) -> list[Term]:
    """Return the regressors of the superset of all structures with these n and d; `speed`: with those of velocity."""
    terms = [basis.error(d), basis.error_sum(d), basis.set_position(d)]
    terms += [basis.travel(n, d), basis.velocity(n, d)] if speed else []
    terms += [basis.one(f"ds{j}") for j in range(d - 1, d + 3)]
    if friction:
        terms += [basis.one(f"{kind}{j}") for kind in ("sign", "moves") for j in (d - 1, d)]
    return terms


def left_by(part: Reduced, terms: list[Term]) -> float:
    """Return the residual sum of squares of a fit of regressors and of the columns of `part` beyond the basis."""
    size = terms[0].on.size
    C = np.hstack([part.factor[:, :size] @ np.stack([term.on for term in terms], axis=1), part.factor[:, size:]])
    sizes = np.linalg.norm(C, axis=0)
    kept = sizes > 0.0
    values = np.linalg.lstsq(C[:, kept] / sizes[kept], part.right, rcond=1e-13)[0]
    rest = part.right - (C[:, kept] / sizes[kept]) @ values
    return float(rest @ rest)


def through_model(rows: LawRows, model: Model, d: int, older: int, *, central: bool) -> np.ndarray:
    """Return Se and the set travel, filtered by a reference model, in the rows, shape (rows, 2)."""
    basis = rows.basis
    on = np.stack([basis.error_sum(d, older).on, basis.set_travel(d + older, central=central).on], axis=1)
    return filtered(rows, model.coefficients(), rows.whole @ on)


def lagged(rows: LawRows, pole: float, places: np.ndarray | slice = slice(None)) -> np.ndarray:
    """Return basis columns over the rows after a low pass of first order."""
    return filtered(rows, Lag(pole, 0.0).coefficients(), rows.whole[:, places])


def at_corner(rows: LawRows, structure: Structure) -> Fitted | None:
    """Return the sensible fit of a structure with one low pass that leaves least, or None."""
    return min(all_at_corner(rows, structure), key=lambda one: one.ssr, default=None)


def all_at_corner(rows: LawRows, structure: Structure) -> list[Fitted]:
    """Return all sensible fits of a structure with one low pass, of the command or of the velocity."""
    if structure.eased is not None:
        task = EasedProblems(rows, structure).problem(structure.eased)
    else:
        task = lagged_problem(rows, structure)
    return [one for one in fits([structure], [task]) if one.sensible]


def lagged_problem(rows: LawRows, structure: Structure) -> Problem:
    """Return the problem of one structure with a low pass; only its own columns are filtered."""
    assert structure.lag is not None
    A, B = structure.terms(rows.basis)
    on = np.stack([term.on for term in (*A, *B)], axis=1)
    part = reduced(filtered(rows, structure.lag._replace(old=0.0).coefficients(), rows.whole @ on), rows.force)
    return Problem(part.factor[:, : len(A)], part.factor[:, len(A) :], part.right)


def with_eased(rows: LawRows, lag: Lag) -> np.ndarray:
    """Return the basis columns over the rows, and behind them those of the reading after a low pass."""
    return np.hstack([rows.columns, eased(rows, lag)])


def eased(rows: LawRows, lag: Lag) -> np.ndarray:
    """Return the basis columns of the reading over the rows after a low pass."""
    return filtered(rows, lag.coefficients(), rows.whole[:, rows.basis.reading_places])


def regressors(found: Fitted, rows: LawRows) -> np.ndarray:
    """Return the derivatives of the force in the rows with respect to the gains and 1/Tn."""
    structure = found.structure
    columns = rows.columns if structure.lag is None else lagged(rows, structure.lag.pole)
    if structure.drag:
        columns = with_drag(rows, structure.lag)
    if structure.eased is not None:
        columns = with_eased(rows, structure.eased)
    if structure.model is not None:
        more = through_model(rows, structure.model, structure.d, structure.older, central=structure.central)
        columns = np.hstack([columns, more])
    task = problem(structure, rows.basis, Reduced(columns, rows.force))
    C = task.A + found.rate * task.B
    return np.column_stack([C, task.B @ found.values]) if structure.curved else C


def with_drag(rows: LawRows, lag: Lag | None) -> np.ndarray:
    """Return the basis columns in the rows after a low pass, followed by T Σ of the direction of motion."""
    drag = rows.basis.T * np.cumsum(rows.whole @ rows.basis.one("sign0").on)[:, None]
    if lag is None:
        return np.hstack([rows.columns, rows.taken(drag)])
    return passed(rows, lag, np.hstack([rows.whole, drag]))


def passed(rows: LawRows, lag: Lag | None, whole: np.ndarray) -> np.ndarray:
    """Return whole-log columns in the rows after a low pass, or as they are."""
    return rows.taken(whole) if lag is None else filtered(rows, Lag(lag.pole, 0.0).coefficients(), whole)


class ModelProblems:
    """The problems of P-PI cascades with one n and d and any reference model, reduced to their own columns."""

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


class EasedProblems:
    """The problems of one cascade with any low pass of its velocity."""

    def __init__(self, rows: LawRows, structure: Structure) -> None:
        self.rows, self.structure = rows, structure
        basis, n, d = rows.basis, structure.n, structure.d
        A, B = replace(structure, eased=None).terms(basis)
        self.p, self.place = len(A), structure.gains.index("Kp")
        speeds = [basis.velocity(n, d), basis.travel(n, d)]
        A[self.place], B[self.place] = A[self.place] + speeds[0], B[self.place] + speeds[1]
        self.Q, R = np.linalg.qr(np.column_stack([rows.at([*A, *B]), rows.force]))
        self.own, self.y = R[:, :-1], R[:, -1]
        self.inputs = rows.whole @ np.stack([term.on for term in speeds], axis=1)

    def at(self, share: float) -> Fitted | None:
        """Return the fit with a low pass whose pole is 1 - `share`, or None."""
        assert self.structure.eased is not None
        lag = self.structure.eased._replace(pole=1.0 - share)
        return sensible(replace(self.structure, eased=lag), self.problem(lag))

    def problem(self, lag: Lag) -> Problem:
        """Return the problem with a low pass."""
        more = filtered(self.rows, lag.coefficients(), self.inputs)
        on = self.Q.T @ more
        added = np.vstack([on, triangle(more - self.Q @ on)])
        wide = np.vstack([self.own, np.zeros((2, 2 * self.p))])
        A, B = wide[:, : self.p].copy(), wide[:, self.p :].copy()
        A[:, self.place] -= added[:, 0]
        B[:, self.place] -= added[:, 1]
        return Problem(A, B, np.append(self.y, np.zeros(2)))


class SignProblems:
    """The problems of one structure with friction feedforward, for any smoothing of the direction."""

    def __init__(self, rows: LawRows, structure: Structure) -> None:
        self.rows, self.structure = rows, structure
        A, B = structure.terms(rows.basis)
        assert structure.friction is not None
        self.age = structure.d + structure.friction
        self.kinds = ("sign", "moves") if structure.sides else ("sign",)
        first = structure.gains.index("friction")
        self.signs = slice(first, first + len(self.kinds))
        self.p = len(A)
        on = np.stack([term.on for term in (*A, *B)], axis=1)
        on[:, self.signs] = 0.0
        columns = self._passed(rows.whole @ on) if structure.lag else rows.columns @ on
        if structure.eased is not None:
            task = problem(structure, rows.basis, Reduced(with_eased(rows, structure.eased), rows.force))
            columns = np.hstack([task.A, task.B])
            columns[:, self.signs] = 0.0
        self.Q, R = np.linalg.qr(np.column_stack([columns, rows.force]))
        self.own, self.y = R[:, :-1], R[:, -1]

    def fit(self, signals: Signals) -> Fitted | None:
        """Return the fit with the direction of the set motion smoothed as in `signals`, or None."""
        more = self._directions(signals, self.age)
        lag = self.structure.lag
        if lag is None:
            more = self.rows.taken(more)
        else:
            more = self._passed((1.0 - lag.old) * more + lag.old * self._directions(signals, self.age + 1))
        on = self.Q.T @ more
        outside = triangle(more - self.Q @ on)
        A = np.vstack([self.own[:, : self.p], np.zeros((len(outside), self.p))])
        A[:, self.signs] = np.vstack([on, outside])
        B = np.vstack([self.own[:, self.p :], np.zeros((len(outside), self.p))])
        return sensible(self.structure, Problem(A, B, np.append(self.y, np.zeros(len(outside)))))

    def _directions(self, signals: Signals, age: int) -> np.ndarray:
        return np.stack([signals.direction(f"{kind}{age}") for kind in self.kinds], axis=1)

    def _passed(self, columns: np.ndarray) -> np.ndarray:
        """Return columns over the whole log, filtered by the low pass of the structure, in the rows."""
        assert self.structure.lag is not None
        return filtered(self.rows, Lag(self.structure.lag.pole, 0.0).coefficients(), columns)

"""The search for the control law of a log: which structures explain its command, and whether one of them is the law."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from feeddrive.identification.motion import law_structures
from feeddrive.identification.motion.law_rows import (
    MOST_DELAY,
    MOST_SAMPLES,
    LawRows,
    Reduced,
    Signals,
    reduced,
    shifted,
    widened,
)
from feeddrive.identification.motion.law_structures import CASCADE, PID, Fitted, Lag, Model, Structure

_ROUNDING = 1e-5  # of the force: what is left below it is rounding of the log, and speaks for no structure
_KEPT = 4  # pairs of n and d that are fitted with every structure
_STRAY = 6.0  # standard deviations beyond which a row is left out: single samples at a limit, a spike of a difference
_FEW = 0.03  # of the rows that may be left out so
_RATES = np.geomspace(0.005, 1.0, 14)  # r = T Kp / model_mass that are tried first
_MOST_DEAD = 3  # samples of dead time in a reference model
_POLES = np.geomspace(0.02, 0.5, 9)  # 1 - pole of a low pass that are tried first
_SMOOTH = (0.003, 0.01, 0.03, 0.1)  # of the largest set speed: smoothed signs of friction feedforward that are tried
_LEAST_ROWS = 100


@dataclass(frozen=True, eq=False)
class Scored:
    """A fitted structure with its criterion, ln-likelihood ratio to the free law plus the price of its unknowns."""

    fitted: Fitted
    criterion: float
    signals: Signals

    @property
    def structure(self) -> Structure:
        return self.fitted.structure


@dataclass(frozen=True, eq=False)
class Floor:
    """What a free linear law leaves: any gains on 13 past readings, 9 set positions and both sums.

    ssr        sum of squares that is left;   power: that of the force
    memory     first autocorrelation of what is left
    effective  number of independent rows
    price      criterion of the free law
    """

    ssr: float
    power: float
    memory: float
    effective: float
    price: float

    @property
    def left(self) -> float:
        return math.sqrt(self.ssr / self.power)

    def criterion(self, ssr: float, unknowns: int) -> float:
        """Return n ln(ssr / floor) + p ln n with n independent rows."""
        noise = _ROUNDING**2 * self.power
        return self.effective * math.log((ssr + noise) / (self.ssr + noise)) + unknowns * math.log(self.effective)


def floor_of(rows: LawRows, part: Reduced) -> Floor:
    """Return the floor of the rows."""
    rest = remains(rows.columns, rows.force)
    ssr, n = part.rest(), rows.force.size
    rho = correlation(rest)
    effective = max(20.0, n * (1.0 - max(0.0, rho)) / (1.0 + max(0.0, rho)))
    return Floor(ssr, part.power, rho, effective, rows.basis.size * math.log(effective))


def remains(columns: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Return what least squares leave of the force."""
    sizes = np.linalg.norm(columns, axis=0)
    kept = sizes > 0.0
    scaled = columns[:, kept] / sizes[kept]
    Q, _ = np.linalg.qr(scaled)
    return force - Q @ (Q.T @ force)


def correlation(rest: np.ndarray) -> float:
    """Return the first autocorrelation of a residual."""
    power = float(rest @ rest)
    return float(rest[1:] @ rest[:-1]) / power if power > 0.0 else 0.0


@dataclass(frozen=True, eq=False)
class Search:
    """All structures that were fitted to a log, best first, and the floor they are held against."""

    rows: LawRows
    floor: Floor
    tried: dict[tuple[int, int], float]
    scored: tuple[Scored, ...]

    @property
    def best(self) -> Scored:
        return self.scored[0]

    def residual(self, scored: Scored) -> np.ndarray:
        """Return what a structure leaves of the force, over the rows."""
        found = scored.fitted
        rows = replace(self.rows, columns=self.rows.columns, raw=scored.signals)
        columns = law_structures.regressors(found, rows)
        gains = columns[:, : found.values.size]
        return self.rows.force - gains @ found.values


def search(signals: Signals, limit: float | None) -> Search | None:
    """Return the structures that explain a log, or None if too few rows are away from the limit."""
    keep = signals.free(limit)
    found = _searched(signals, keep)
    if found is None:
        return None
    # single samples at a limit, where a feedforward spikes, and steps of the set position
    rest = found.residual(found.best)
    spread = 1.4826 * float(np.median(np.abs(rest)))
    noise = _ROUNDING * math.sqrt(found.floor.power / rest.size)
    far = np.abs(rest) > _STRAY * max(spread, noise)
    if 0 < np.sum(far) <= _FEW * far.size:
        strays = np.zeros(keep.size, bool)
        strays[found.rows.places[far]] = True
        again = _searched(signals, keep & ~widened(strays, 0, 0))
        found = again or found
    return found


def _searched(signals: Signals, keep: np.ndarray) -> Search | None:
    rows = LawRows.of(signals, keep)
    if rows.force.size < _LEAST_ROWS:
        return None
    basis, part = rows.basis, rows.reduced()
    floor = floor_of(rows, part)
    tried = {
        (n, d): law_structures.left_by(part, law_structures.wide(basis, n, d, friction=True))
        for n in range(1, MOST_SAMPLES + 1)
        for d in range(MOST_DELAY + 1)
    }
    likely = sorted(tried, key=lambda pair: tried[pair])[:_KEPT]
    scored = [
        Scored(found, floor.criterion(found.ssr, found.structure.parameters), signals)
        for n, d in likely
        for structure in structures(n, d)
        if (found := law_structures.fit(structure, basis, part)) is not None
    ]
    if not scored:
        return None
    scored.sort(key=lambda one: one.criterion)
    if scored[0].criterion > floor.price:
        scored += _models(rows, floor, scored, signals)
        scored += _lags(rows, floor, scored, signals)
        scored.sort(key=lambda one: one.criterion)
    if scored[0].structure.friction is not None and signals.smoothing == 0.0:
        scored += _smoothed(rows, floor, scored[0], keep)
        scored.sort(key=lambda one: one.criterion)
    return Search(rows, floor, tried, tuple(scored))


def structures(n: int, d: int) -> Iterator[Structure]:
    """Yield all structures without a model or a low pass, for one n and d."""
    for older in (0, 1):
        for fed in ("", "backward", "central", "middle"):
            for central in (False, True) if not fed else (False,):
                for friction in (None, 0, -1):
                    for forward in law_structures.FORWARD:
                        for integral in (True, False):
                            yield Structure(CASCADE, integral, n, d, older, central, forward, fed, friction)
                    for forward in ("free", "none"):
                        yield Structure(PID, True, n, d, older, central, forward, fed, friction)


def _models(rows: LawRows, floor: Floor, scored: list[Scored], signals: Signals) -> list[Scored]:
    """Return fits with a reference model in the integral, for the likeliest cascades."""
    found: list[Scored] = []
    pairs = _pairs(scored, 2)
    Q, part = _orthogonal(rows)
    for n, d in pairs:
        for forward in law_structures.FORWARD:
            plain = Structure(CASCADE, True, n, d, forward=forward)
            for samples in range(_MOST_DEAD + 1):

                def at(rate: float, plain: Structure = plain, samples: int = samples) -> Fitted | None:
                    structure = replace(plain, model=Model(rate, samples))
                    more = law_structures.through_model(rows, Model(rate, samples), plain.d, 0, central=False)
                    return law_structures.fit(structure, rows.basis, _extended(rows, Q, part, more), 2)

                best = _profile(at, _RATES)
                if best is not None:
                    found.append(Scored(best, floor.criterion(best.ssr, best.structure.parameters), signals))
    return found


def _lags(rows: LawRows, floor: Floor, scored: list[Scored], signals: Signals) -> list[Scored]:
    """Return fits with a low pass of the command, for the likeliest structures."""
    found: list[Scored] = []
    plain = [
        Structure(family, integral, n, d, forward=forward, fed=fed)
        for n, d in {(n, d) for n in (1, 2, 4) for d in (0, 1)} | set(_pairs(scored, 2))
        for fed in ("", "central")
        for family, integral, forward in ((CASCADE, True, "free"), (CASCADE, False, "free"), (PID, True, "free"))
    ]
    left: dict[tuple[float, Structure], Fitted] = {}
    for share in _POLES:
        part = reduced(law_structures.lagged(rows, 1.0 - share).columns, rows.force)
        for one in plain:
            for old in (0.0, 0.5):
                structure = replace(one, lag=Lag(1.0 - float(share), old))
                fitted = law_structures.fit(structure, rows.basis, part)
                if fitted is not None:
                    left[float(share), structure] = fitted
    best = sorted(left.values(), key=lambda one: one.ssr)[:3]
    for one in best:
        lag = one.structure.lag
        assert lag is not None

        def at(share: float, one: Fitted = one, lag: Lag = lag) -> Fitted | None:
            part = reduced(law_structures.lagged(rows, 1.0 - share).columns, rows.force)
            return law_structures.fit(replace(one.structure, lag=Lag(1.0 - share, lag.old)), rows.basis, part)

        share = 1.0 - lag.pole
        step = float(_POLES[1] / _POLES[0])
        fitted = _profile(at, np.geomspace(share / step, min(0.95, share * step), 5))
        if fitted is None:
            continue
        variants = [fitted]
        for forward in law_structures.FORWARD:
            for fed in ("", "backward", "central", "middle"):
                part = reduced(law_structures.lagged(rows, fitted.structure.lag.pole).columns, rows.force)  # type: ignore[union-attr]
                if fitted.structure.family == PID and forward == "one":
                    continue
                other = law_structures.fit(replace(fitted.structure, forward=forward, fed=fed), rows.basis, part)
                variants += [] if other is None else [other]
        found += [Scored(v, floor.criterion(v.ssr, v.structure.parameters), signals) for v in variants]
    return found


def _smoothed(rows: LawRows, floor: Floor, best: Scored, keep: np.ndarray) -> list[Scored]:
    """Return the best structure with smoothed signs of its friction feedforward, and with a level by direction."""
    found: list[Scored] = []
    fastest = float(np.max(np.abs(np.diff(rows.raw.wanted)))) / rows.raw.T
    for share in (0.0, *_SMOOTH):
        signals = replace(rows.raw, smoothing=share * fastest)
        other = LawRows.of(signals, keep)
        for friction in (0, -1):
            for sides in (False, True):
                structure = replace(best.structure, friction=friction, sides=sides)
                part, extra = law_structures.reduced_for(other, structure)
                fitted = law_structures.fit(structure, other.basis, part, extra)
                if fitted is not None:
                    unknowns = structure.parameters + (share > 0.0)
                    found.append(Scored(fitted, floor.criterion(fitted.ssr, unknowns), signals))
    return found


def _pairs(scored: list[Scored], most: int) -> list[tuple[int, int]]:
    """Return the n and d of the best fits, without repetition."""
    return list(dict.fromkeys((one.structure.n, one.structure.d) for one in scored))[:most]


def _profile(at: object, grid: np.ndarray, rounds: int = 3) -> Fitted | None:
    """Return the best fit over one more unknown, searched on a grid that shrinks about the best value."""
    values, best = grid, None
    for _ in range(rounds):
        fits = [(value, fitted) for value in values if (fitted := at(float(value))) is not None]  # type: ignore[operator]
        if not fits:
            return best
        place, fitted = min(fits, key=lambda pair: pair[1].ssr)
        best = fitted if best is None or fitted.ssr < best.ssr else best
        step = float(values[1] / values[0])
        values = np.geomspace(place / step, place * step, 7)
    return best


def _orthogonal(rows: LawRows) -> tuple[np.ndarray, Reduced]:
    Q, R = np.linalg.qr(np.column_stack([rows.columns, rows.force]))
    return Q, Reduced(R[:, :-1], R[:, -1])


def _extended(rows: LawRows, Q: np.ndarray, part: Reduced, more: np.ndarray) -> Reduced:
    """Return a reduced problem with further columns behind its own."""
    on = Q.T @ more
    outside = np.linalg.qr(more - Q @ on, mode="r")
    size = part.factor.shape[0]
    factor = np.block([[part.factor, on], [np.zeros((outside.shape[0], part.factor.shape[1])), outside]])
    return Reduced(factor, np.concatenate([part.right, np.zeros(factor.shape[0] - size)]))


__all__ = ["Floor", "Scored", "Search", "correlation", "remains", "search", "shifted"]

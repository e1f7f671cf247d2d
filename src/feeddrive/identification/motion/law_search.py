"""The search for the control law of a log: fits of candidate structures, and tests of the best one."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from feeddrive.identification import regression
from feeddrive.identification.motion import law_structures
from feeddrive.identification.motion.law_rows import (
    MOST_DELAY,
    MOST_SAMPLES,
    Basis,
    LawRows,
    Reduced,
    Signals,
    reduced,
    triangle,
)
from feeddrive.identification.motion.law_structures import CASCADE, PID, Fitted, Lag, Model, Structure
from feeddrive.identification.regression import median_spread

ROUNDING = 1e-5  # of the force: what is left below it is rounding of the log, and speaks for no structure
_HOPELESS = 80.0  # of n ln(ssr), by which a pair of n and d must not be worse than the best to be fitted
_SIGNS_PLAY = 15.0  # of n ln(ssr), that the four columns of directions must explain before they are tried
_KEPT = 4  # pairs of n and d that are fitted with every structure
_CLEARLY = 0.5  # of the excess of a law over the free law, that is left without strays, if these hide the law
# autocorrelation, below which a residual is blue noise of counts: those of the logs of the law's readings are above
# -0.06, but for position loops that run every n-th sample (32 logs)
BLUE = 0.15
STRAY = 6.0  # standard deviations beyond which a row is left out: single samples at a limit, a spike of a difference
FEW = 0.03  # of the rows that may be left out so
_RATES = np.geomspace(0.005, 1.0, 14)  # r = T Kp / model_mass that are tried first
_STANDING = (0.02, 0.06, 0.15, 0.4)  # r that stand for any model while n and d are searched
_MOST_DEAD = 3  # samples of dead time in a reference model
_LIKELY = 10  # pairs of n and d that are tried with a model or a low pass, which the superset lacks
_PAIRS = 2  # of n and d, with which the smoothed sign before a low pass is searched
_LAGGED = 4  # kinds of law with a low pass whose corner is searched finely
_VARIED = 2  # of these, whose feedforwards are varied
_NEARBY = 3  # samples of the velocity more or less that are tried then
_LEAST_LAG = 0.1  # samples that a low pass delays: with less, there is none
_ZOOMS = 4  # times that the grid of corners shrinks
_AROUND = 1.2 ** np.arange(-2.0, 3.0)  # of a corner that is searched finely
_CLOSE = 1.03 ** np.arange(-1.0, 2.0)  # the same, after a fit to fewer rows
_FEWER = 6000  # rows with which models and low passes are searched
_ALIKE = 6  # fits at most that are fitted to all rows then
_FINE = 1e-4  # relative, to which the corner of a low pass and the rate of a model are searched
_POLES = np.geomspace(0.02, 0.5, 9)  # 1 - pole of a low pass that are tried first
_SMOOTH = np.geomspace(1e-3, 0.3, 7)  # of the largest set speed: smoothed signs of friction feedforward that are tried
_SMOOTHED = 0.01  # relative change of the smoothing, from which on a search is repeated with it
_TURNS = 2  # in which a low pass and a smoothed sign are searched, each with the other one held
_ODD = 12.0  # difference of the criterion up to which such a fit counts when errors are estimated
_BANDS = np.geomspace(1e-3, 5.0, 9)  # of the usual error: half widths of a dead band that are tried
_SLOWER = (2, 4, 8)  # samples between two runs of a slower position loop that are tried
LEAST_ROWS = 100  # some two for each unknown of the free law: with fewer, nothing is left to judge by
MOST_LAG = 1.5  # samples between motion and command; a law with a low pass looks like one with 2.5 and more
# samples between motion and command from which on a low pass is tried, unless the samples of the velocity are told
# from others by so much of n ln(ssr): a low pass is no further from them
_LATE, _TOLD = 1.0, 400.0
_EXCHANGED = 0.02  # of ln 1/Tn, from which on two fits of one structure are different laws
_TRIED_FROM = 0.02  # of the sum of squares of the free law: from so much more on, further structures are tried
# the errors of a restored set position count so much in squares: those that are drawn for it are 0.3 to 1 of the true
# ones in most logs
_DOUBTED = 4.0
_SUMMED = 8  # rows whose scores are summed at most to show their memory
_ORDER = 8  # of the autoregression of a residual
MOVING = 0.2  # of the rows, in which an axis must move that rests may be left out
_MOST_ALLOWED = 0.15  # of the sum of squares of the free law: where errors of the set position make more, none is sure
_CHANCE = 4.0  # standard deviations of a chi square, beyond which a law misses something that the free law sees


@dataclass(frozen=True, eq=False)
class Scored:
    """A fitted structure with its criterion: log-likelihood ratio to the free law plus a parameter penalty."""

    fitted: Fitted
    criterion: float
    signals: Signals

    @property
    def structure(self) -> Structure:
        """The fitted structure."""
        return self.fitted.structure


@dataclass(frozen=True, eq=False)
class Floor:
    """The fit of a free linear law, with any gains on 13 past readings, 9 set positions and both sums.

    ssr        residual sum of squares
    power      sum of squares of the force
    memory     first autocorrelation of the residual
    bluest     least of its first autocorrelations: -1/2 at n samples by counts of a velocity over n samples
    effective  number of independent rows
    unknowns   number of coefficients
    rows       number of rows of the log
    allowed    sum of squares that a right law may leave more, by the errors of a restored set position, which the free
               law makes up for
    """

    ssr: float
    power: float
    memory: float
    bluest: float
    effective: float
    unknowns: int
    rows: int
    allowed: float = 0.0

    @property
    def price(self) -> float:
        """The criterion of the free law."""
        return self.unknowns * math.log(self.effective)

    @property
    def blue(self) -> bool:
        """True if the residual has counts of a velocity, which those of the log do not explain."""
        return self.bluest < -BLUE

    @property
    def left(self) -> float:
        """The RMS residual, relative to the RMS of the force."""
        return math.sqrt(self.ssr / self.power)

    def misses(self, scored: Scored, chance: float = _CHANCE) -> bool:
        """Return True if the residual of a structure exceeds that of the free law by more than chance.

        `chance`: standard deviations of a chi square.
        """
        spare = self.unknowns - scored.structure.parameters
        return self.criterion(scored.fitted.ssr, 0, self.allowed) > spare + chance * math.sqrt(2.0 * spare)

    def hopeless(self, rows: LawRows, least: float) -> bool:
        """Return True if a superset of structures leaves more of rows of a search than a law may: `least`."""
        share = rows.force.size / self.rows
        part = replace(floor_of(rows, rows.reduced()), effective=self.effective * share, allowed=self.allowed * share)
        return part.criterion(least, 0, part.allowed) > self.unknowns + _CHANCE * math.sqrt(2.0 * self.unknowns)

    def wants_more(self, scored: Scored) -> bool:
        """Return True if the fit of a structure is not good enough, so that other structures should be tried."""
        return self.misses(scored) or scored.fitted.ssr > (1.0 + _TRIED_FROM) * self.ssr + self.allowed

    def gain(self, more: float, less: float) -> float:
        """Return n ln(more / less) for two sums of squares and n independent rows."""
        noise = ROUNDING**2 * self.power
        return self.effective * math.log((more + noise) / (less + noise))

    def criterion(self, ssr: float, unknowns: int, allowed: float = 0.0) -> float:
        """Return n ln(ssr / (floor + allowed)) + p ln n for p unknowns and n independent rows."""
        return self.gain(ssr, self.ssr + allowed) + unknowns * math.log(self.effective)


def floor_of(rows: LawRows, part: Reduced, places: np.ndarray | None = None) -> Floor:
    """Return the fit of the free linear law to the rows, with all basis columns or those at some places."""
    places = np.arange(rows.basis.size) if places is None else places
    own = part.factor[:, places]
    gains = _solution(Reduced(own, part.right))
    rest = rows.force - rows.columns[:, places] @ gains
    left = part.right - own @ gains
    bluest = min(correlation(rest, n) for n in range(1, MOST_SAMPLES + 1))
    return Floor(float(left @ left), part.power, correlation(rest), bluest, independent(rest), places.size, rest.size)


def by_set_position(rows: LawRows, found: Fitted) -> np.ndarray:
    """Return the force of a law, (k, rows), by what k set positions that are as likely differ from the first one."""
    size = found.values.size
    own = law_structures.regressors(found, rows)[:, :size] if rows.raw.others else np.zeros((rows.force.size, size))
    off = [
        (law_structures.regressors(found, other)[:, :size] - own) @ found.values
        for other in rows.with_other_set_positions()
    ]
    return np.array(off).reshape(-1, rows.force.size)


def by_chance(rows: LawRows, found: Fitted, columns: np.ndarray) -> float:
    """Return the sum of squares that columns explain of the errors of a restored set position in the force of a law."""
    off = by_set_position(rows, found)
    if not off.size:
        return 0.0
    sizes = np.linalg.norm(columns, axis=0)
    kept = columns[:, sizes > 0.0] / sizes[sizes > 0.0]
    return _DOUBTED * float(np.sum((off @ np.linalg.qr(kept)[0]) ** 2)) / len(off)


def covariance_of(columns: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Return the covariance of the coefficients: the robust one, widened to that of colored noise where it is less.

        (XᵀX)⁻¹ Xᵀ Γ X (XᵀX)⁻¹,   Xᵀ Γ X = σ² Yᵀ Y,   Y = X after 1/A(z) backwards in time

    A, σ: an autoregression of the residual. Gains absorb the slow part of colored noise, in which few rows are
    independent: its share of the residual is missing in the robust covariance, but not in an autoregression, which the
    fast part shows as well.
    """
    from scipy.linalg import solve_toeplitz  # takes a second to import
    from scipy.signal import lfilter

    robust = regression.robust_covariance(columns, rest, smooth=_SUMMED)
    n = rest.size
    past = np.array([float(rest[j:] @ rest[: n - j]) for j in range(_ORDER + 1)]) / n
    if past[0] <= 0.0:
        return robust
    weights = solve_toeplitz(past[:-1], past[1:])
    power = max(0.0, float(past[0] - weights @ past[1:]))
    passed = np.asarray(lfilter([1.0], np.concatenate([[1.0], -weights]), columns[::-1], axis=0))
    inverse = regression.inverse_gram(columns)
    colored = power * inverse @ (passed.T @ passed) @ inverse
    own, other = np.diag(robust), np.diag(colored)
    wider = np.sqrt(np.maximum(1.0, np.divide(other, own, out=np.ones_like(own), where=own > 0.0)))
    return robust * np.outer(wider, wider)


def independent(rest: np.ndarray) -> float:
    """Return the number of independent rows of a residual."""
    rho = max(0.0, correlation(rest))
    return max(20.0, rest.size * (1.0 - rho) / (1.0 + rho))


def _solution(part: Reduced) -> np.ndarray:
    """Return the coefficients of all columns."""
    sizes = np.linalg.norm(part.factor, axis=0)
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    return np.linalg.lstsq(part.factor / sizes, part.right, rcond=1e-13)[0] / sizes


def correlation(rest: np.ndarray, rows: int = 1) -> float:
    """Return the autocorrelation of a residual, by default the first one."""
    power = float(rest @ rest)
    return float(rest[rows:] @ rest[:-rows]) / power if power > 0.0 else 0.0


def nonlinear(rows: LawRows, found: Fitted, floor: Floor) -> float:
    """Return the evidence that nonlinear functions of the signals explain the residual of a law: > 0 if they do.

    A dead band, a limit inside the law, or friction compensation by the measured velocity causes a residual that no
    linear law explains; if the noise is correlated, only such functions distinguish this residual from noise (Ramsey's
    RESET test).  Dead bands of several widths are tested separately.
    """
    few = rows.fewer(_FEWER)
    error, v = _signals(few, found)
    e = error - np.mean(error[few.places])
    bends = []
    for signal in (e, v):
        size = median_spread(signal[few.places]) or float(np.std(signal))
        bends += [np.tanh(signal / (share * size)) for share in (0.1, 0.5, 2.0)] + [signal * np.abs(signal)]
        bends += [np.abs(signal)]
    # a dead band about 0 takes what is within it from the error, and its integral from that of the law
    widths = _BANDS * median_spread(e[few.places])
    within = [np.clip(error, -width, width) for width in widths if width > 0.0]
    return _explained(few, found, floor, [bends, *([one, few.raw.T * np.cumsum(one)] for one in within)])


def slower(rows: LawRows, found: Fitted, floor: Floor) -> float:
    """Return by how much a position loop that runs every n-th sample explains what a law leaves, as `nonlinear`.

    It holds its velocity command for n samples.
    """
    few = rows.fewer(_FEWER)
    error, _ = _signals(few, found)
    wanted = few.whole @ few.basis.set_velocity(found.structure.d, central=False).on
    kinds = list[list[np.ndarray]]()
    for every in _SLOWER:
        for phase in range(every):
            held = np.maximum((np.arange(error.size) - phase) // every * every + phase, 0)
            parts = [signal[held] - signal for signal in (error, wanted)]
            kinds.append([*parts, *(few.raw.T * np.cumsum(part) for part in parts)])
    return _explained(few, found, floor, kinds)


def _signals(rows: LawRows, found: Fitted) -> tuple[np.ndarray, np.ndarray]:
    """Return the error and the velocity that a law reads, over the whole log."""
    n, d, basis = found.structure.n, found.structure.d, rows.basis
    return rows.whole @ basis.error(d).on, rows.whole @ basis.velocity(n, d).on


def _explained(rows: LawRows, found: Fitted, floor: Floor, kinds: Sequence[Sequence[np.ndarray]]) -> float:
    """Return the largest criterion by which one kind of columns explains what a law leaves in rows of a search."""
    more = rows.taken(np.stack([column for kind in kinds for column in kind], axis=1))
    own = law_structures.regressors(found, rows)
    rest = rows.force - own[:, : found.values.size] @ found.values
    linear = np.hstack([own, rows.columns])
    columns, off = np.hstack([linear, more]), by_set_position(rows, found)
    sizes = np.linalg.norm(columns, axis=0)
    both = np.column_stack([columns / np.where(sizes > 0.0, sizes, 1.0), rest, *off])
    # what the linear columns leave of the others
    R = triangle(both)[linear.shape[1] :, linear.shape[1] :]
    noise = ROUNDING**2 * float(rows.force @ rows.force)
    effective = floor.effective * rows.force.size / floor.rows
    rests, first, explained = R[:, more.shape[1] :], 0, []
    lefts = np.sum(rests**2, axis=0)
    for kind in kinds:
        chosen = R[:, first : first + len(kind)]
        others = np.sum((rests - chosen @ np.linalg.lstsq(chosen, rests, rcond=1e-9)[0]) ** 2, axis=0)
        # errors of the set position are no evidence
        by_chance = _DOUBTED * float(np.mean(lefts[1:] - others[1:])) if off.size else 0.0
        gain = effective * math.log((lefts[0] + noise) / (others[0] + by_chance + noise))
        explained.append(gain - len(kind) * math.log(effective))
        first += len(kind)
    return max(explained)


@dataclass(frozen=True, eq=False)
class Search:
    """All structures fitted to a log, best first, and the free law with which they are compared.

    deep  False if the best one misses something, and neither models nor low passes were tried
    """

    rows: LawRows
    floor: Floor
    tried: dict[tuple[int, int], float]
    scored: tuple[Scored, ...]
    deep: bool = True

    @property
    def best(self) -> Scored:
        """The structure with the best criterion."""
        return self.scored[0]

    def with_fits(self, more: Iterable[Scored]) -> Search:
        """Return the search with additional fits, best first."""
        return replace(self, scored=tuple(sorted((*self.scored, *more), key=lambda one: one.criterion)))

    def residual(self, scored: Scored) -> np.ndarray:
        """Return the residual force of a structure in the rows."""
        found = scored.fitted
        rows = self.rows if scored.signals is self.rows.raw else self.rows.signed(scored.signals)
        columns = law_structures.regressors(found, rows)
        gains = columns[:, : found.values.size]
        return self.rows.force - gains @ found.values


def search(choices: Sequence[Signals], limit: float | None) -> Search | None:
    """Return the search for the structures that explain a log, or None if too few rows are below the limit.

    `choices` are interpretations of the log, likeliest first. If no fit is good enough, the interpretation of which a
    free law leaves least is returned, on which models and low passes are still to be tried (`deeper`).
    """
    every, keep = list[list[Search]](), choices[0].free(limit)
    if choices[0].others:
        # a restored set position is off by up to half a count in a rest, which the integral of a law sums
        moving = keep & choices[0].between_rests()
        keep = moving if np.sum(moving) > MOVING * np.sum(keep) else keep
    for signals in choices:
        first = _searched(signals, keep)
        if first is None:
            continue
        found = [first]
        every.append(found)
        for trial in (keep, *_trials(signals, keep, first)):
            one = first if trial is keep else _searched(signals, trial)
            if one is not None and not one.floor.wants_more(one.best):
                one = _with_models(one) if _is_loose(one.best) else one
                return _with_low_passes(one) if _hidden(one) and not one.floor.blue else one
            found += [] if one is None or one is first else [one]
    if not every:
        return None
    # a model or a low pass may be missing yet: the free law tells whether the law read rounded set positions
    first, *trials = min(every, key=lambda found: found[0].floor.left)

    def excess(one: Search) -> float:
        return one.floor.criterion(one.best.fitted.ssr, 0)

    # where the law is not found yet, strays may be what it leaves
    best = min(trials, key=excess, default=first)
    return replace(best if excess(best) < _CLEARLY * excess(first) else first, deep=False)


def _allowing(found: Search) -> Floor:
    """Return the free law with what it may leave less than the best structure by errors of the set position."""
    floor, rows, best = found.floor, found.rows, found.best.fitted
    if not rows.raw.others:
        return floor
    free = by_chance(rows, best, rows.columns)
    own = by_chance(rows, best, law_structures.regressors(best, rows))
    return replace(floor, allowed=min(_MOST_ALLOWED * floor.ssr, max(0.0, free - own)))


def _trials(signals: Signals, keep: np.ndarray, first: Search) -> Iterator[np.ndarray]:
    """Yield masks of fewer rows: those without outliers, and those below a noisy plateau of the command."""
    # single samples at a limit, where a feedforward spikes, and steps of the set position
    rest = first.residual(first.best)
    spread = median_spread(rest)
    noise = ROUNDING * math.sqrt(first.floor.power / rest.size)
    far = np.abs(rest) > STRAY * max(spread, noise)
    if 0 < np.sum(far) <= FEW * far.size:
        strays = np.zeros(keep.size, bool)
        strays[first.rows.places[far]] = True
        yield keep & ~strays
    # noise of the log hides that the command is held
    below = keep & signals.below_plateau()
    if not np.array_equal(below, keep):
        yield below


def _searched(signals: Signals, keep: np.ndarray, again: int = _TURNS) -> Search | None:
    """Return the search over the rows in `keep` without models and low passes; None if there are too few rows.

    It is repeated at most `again` times with the smoothed direction that it found.
    """
    rows = LawRows.of(signals, keep)
    if rows.force.size < LEAST_ROWS:
        return None
    basis, part = rows.basis, rows.reduced()
    floor = floor_of(rows, part)
    tried = _scanned(rows, part)
    likely, least = _likely(floor, tried), next(iter(tried.values()))
    bare = law_structures.left_by(part, law_structures.wide(basis, *likely[0], friction=False))
    plays = floor.gain(bare, least) > _SIGNS_PLAY
    friction = (None,) if not plays else (None, 0, -1) if signals.smoothing == 0.0 else (None, 0)
    every = (structure for n, d in likely for structure in structures(n, d, friction))
    scored = [
        Scored(one, floor.criterion(one.ssr, one.structure.parameters + _smooth(one.structure, signals)), signals)
        for one in law_structures.minima(every, basis, part)
    ]
    if not scored:
        return None
    found = Search(rows, floor, tried, tuple(scored)).with_fits(())
    # a sign that turns at once, where noise hides that it does not, would bias its level
    found = found.with_fits(_smoothed(rows, floor, found.best))
    better = found.best.signals
    if again > 0 and abs(better.smoothing - signals.smoothing) > _SMOOTHED * better.smoothing:
        # samples and filters made up for the wrong sign before, and the free law had it, too
        return _searched(better, keep, again - 1)
    return _with_more(replace(found, floor=_allowing(found)), (_shifted,))


def deeper(found: Search, *, whole: bool = False) -> Search:
    """Return the search extended by reference models and low passes, the more likely ones first.

    `whole`: only by laws that explain the log as the free law does, none that is near to it.
    """
    found = replace(found, deep=True)
    steps = (_with_models, _with_low_passes)
    # no model has a friction feedforward here
    for step in steps if found.best.structure.friction is None else reversed(steps):
        found = step(found, whole=whole) if found.floor.wants_more(found.best) else found
    return found


def _with_models(found: Search, *, whole: bool = False) -> Search:
    """Return the search extended by reference models in the integral."""
    more = _models(found.rows.fewer(_FEWER), found.floor, whole=whole)
    return found.with_fits(_again(found.rows, found.floor, more)) if more else found


def _with_low_passes(found: Search, *, whole: bool = False) -> Search:
    """Return a search with low passes of the command, and with such of the velocity."""
    best, floor = found.best, found.floor
    # friction feedforward keeps the direction that explains most so far
    rows = found.rows if best.signals is found.rows.raw else found.rows.signed(best.signals)
    few = rows.fewer(_FEWER)
    friction, scans = False, _scans(few, friction=False)
    if best.structure.friction is not None:
        # a friction feedforward may have made up for the low pass
        bare = min(scan.least for scan, _ in scans)
        friction = floor.gain(bare, few.reduced().rest()) > _SIGNS_PLAY
    if friction:
        few = few.signed(replace(few.raw, smoothing=_smoothing_behind(few, floor)))
        rows = rows.signed(replace(rows.raw, smoothing=few.raw.smoothing))
        scans = _scans(few, friction=True)
    every = list[Scored]()
    least = min(scan.least for scan, _ in scans)
    for scan, place in scans:
        # none of these can win if their superset leaves clearly more
        if floor.gain(scan.least, least) > _ODD or (whole and floor.hopeless(few, scan.least)):
            continue
        more = place(few, floor, scan, friction=friction)
        more = sorted(_again(rows, floor, more), key=lambda one: one.criterion)
        for one in more[:1]:
            more += _smoothed(rows, floor, one)
        every += [other for one in more for other in _exchanged(found.rows, floor, one)]
    return found.with_fits(every)


def _scans(rows: LawRows, *, friction: bool) -> tuple[tuple[_Scan, Callable[..., list[Scored]]], ...]:
    """Return the scans of low passes of the command and of the velocity, each with what searches further."""
    return (_scanned_lags(rows, friction=friction), _lags), (_scanned_eased(rows, friction=friction), _eased)


def _exchanged(rows: LawRows, floor: Floor, one: Scored) -> list[Scored]:
    """Return a fit with a low pass, and those of the same structure with Kv and 1/Tn exchanged."""
    if not one.structure.curved:
        return [one]
    own = rows if one.signals is rows.raw else rows.signed(one.signals)
    more = one.criterion - floor.criterion(one.fitted.ssr, 0)
    fits = law_structures.all_at_corner(own, one.structure)
    far = [fitted for fitted in fits if abs(math.log(fitted.rate / one.fitted.rate)) > _EXCHANGED]
    return [one, *(Scored(fitted, floor.criterion(fitted.ssr, 0) + more, one.signals) for fitted in far)]


def _hidden(found: Search) -> bool:
    """Return True if the law is so late that a low pass may be in it, which noise hides."""
    best = found.best.structure
    if best.late > MOST_LAG:
        return True
    least = min(found.tried.values())
    others = [left for (n, _), left in found.tried.items() if n != best.n]
    return best.late >= _LATE and found.floor.gain(min(others), least) < _TOLD


def _is_loose(scored: Scored) -> bool:
    """Return True for a PID with a free velocity feedforward, which a cascade with a reference model resembles."""
    structure = scored.structure
    return structure.family == PID and structure.forward == "free" and structure.older == 0


def _smooth(structure: Structure, signals: Signals) -> int:
    """Return the number of unknowns of a smoothed sign."""
    return int(structure.friction is not None and signals.smoothing > 0.0)


def _with_more(found: Search, further: Sequence[Callable[[LawRows, Floor, Scored], list[Scored]]]) -> Search:
    """Return the search with additional fits, best first; a step runs only if the best fit is not yet good enough."""
    found = found.with_fits(())
    for tried_next in further:
        if found.floor.wants_more(found.best):
            found = found.with_fits(tried_next(found.rows, found.floor, found.best))
    return found


def structures(n: int, d: int, feeds: tuple[int | None, ...] = (None, 0, -1)) -> Iterator[Structure]:
    """Yield all structures without a reference model or a low-pass filter for one n and d; `feeds` are the delays, in
    samples, of the friction feedforward (None: none).
    """
    for older in (0, 1):
        for fed in ("", "backward", "central", "middle"):
            for central in (False, True) if not fed else (False,):
                for friction in feeds:
                    for forward in law_structures.FORWARD:
                        for integral in (True, False):
                            yield Structure(CASCADE, integral, n, d, older, central, forward, fed, friction)
                    for forward in ("free", "none"):
                        yield Structure(PID, True, n, d, older, central, forward, fed, friction)


def _again(rows: LawRows, floor: Floor, found: list[Scored]) -> list[Scored]:
    """Return the likeliest of some fits to fewer rows, refitted to all rows."""
    found.sort(key=lambda one: one.criterion)
    again = list[Scored]()
    near = [one for one in found if one.criterion < found[0].criterion + _ODD]
    # which of a model's dead times, and of a velocity's samples, the log does not tell enters the errors
    kinds = dict[tuple[object, ...], Scored]()
    for one in near:
        kinds.setdefault((one.structure.model and one.structure.model[1:], one.structure.n), one)
    for one in list(kinds.values())[:_ALIKE]:
        structure = one.structure
        if structure.model is not None:
            problems = law_structures.ModelProblems(rows, structure.n, structure.d)
            along = problems.along(structure.model, structure.forward)
            fitted = _profile(rows, along, structure.model.rate * _CLOSE)
        else:
            fitted = _along_lag(rows, structure, _CLOSE)
        if fitted is not None:
            criterion = floor.criterion(fitted.ssr, fitted.structure.parameters)
            again.append(Scored(fitted, criterion, rows.raw))
    return again


def _models(rows: LawRows, floor: Floor, *, whole: bool = False) -> list[Scored]:
    """Return fits with a reference model in the integral, for the likeliest n and d."""
    some = [law_structures.through_model(rows, Model(rate, 0, False), 0, 0, central=False) for rate in _STANDING]
    # models of four rates with free gains stand for any model while n and d are told apart
    Q, part = _orthogonal(rows)
    wide = _extended(part, Q, np.hstack(some))
    found: list[Scored] = []
    scan = _scanned(rows, wide)
    if whole and floor.hopeless(rows, min(scan.values())):
        return []
    for n, d in list(scan)[:2]:
        problems = law_structures.ModelProblems(rows, n, d)
        coarse: list[Fitted] = []
        for inside in (True, False):
            for samples in range(_MOST_DEAD + 1):
                rates = _RATES[_RATES * (samples + 1) < 1.0] if inside else _RATES
                top = _profile(rows, problems.along(Model(1.0, samples, inside), "free"), rates)
                coarse += [] if top is None else [top]
        coarse.sort(key=lambda one: one.ssr)
        # which feedforward it has does not depend on the dead time of the model, which noise may hide
        near = [one for one in coarse if floor.gain(one.ssr, coarse[0].ssr) < _ODD]
        first = [_modelled(problems, floor, one, forward) for one in near[:1] for forward in law_structures.FORWARD]
        first = sorted(filter(None, first), key=lambda one: one.criterion)
        found += first
        if first:
            forward = first[0].structure.forward
            found += filter(None, (_modelled(problems, floor, one, forward) for one in near[1:]))
    return found


def _modelled(problems: law_structures.ModelProblems, floor: Floor, one: Fitted, forward: str) -> Scored | None:
    """Return a fit with a reference model at its best rate, with another velocity feedforward."""
    model, rows = one.structure.model, problems.rows
    assert model is not None
    top = _profile(rows, problems.along(model, forward), model.rate * _AROUND)
    return None if top is None else Scored(top, floor.criterion(top.ssr, top.structure.parameters), rows.raw)


class _Scan(NamedTuple):
    """Low passes that were tried: the reduced problems by 1 - pole, and (left, 1 - pole, (n, d)) of the superset."""

    parts: dict[float, Reduced]
    left: list[tuple[float, float, tuple[int, int]]]

    @property
    def least(self) -> float:
        """The smallest sum of squares that the superset leaves."""
        return min(self.left)[0]


def _lags(rows: LawRows, floor: Floor, scan: _Scan, *, friction: bool) -> list[Scored]:
    """Return fits with a low pass of the command, for the likeliest structures; `friction`: with its feedforward."""
    coarse = list[Fitted]()
    for _, share, (n, d) in sorted(scan.left)[:_LIKELY]:
        for fed in ("", "backward"):
            for old in (0.0, 0.5):
                feed = 0 if friction else None
                structure = Structure(CASCADE, True, n, d, fed=fed, friction=feed, lag=Lag(1.0 - share, old))
                fitted = law_structures.fit(structure, rows.basis, scan.parts[share])
                coarse += [] if fitted is None else [fitted]
    return _with_corners(rows, floor, coarse)


def _scanned_lags(rows: LawRows, *, friction: bool, more: np.ndarray | None = None) -> _Scan:
    """Return a scan of low passes of the command; `more`: further columns of the superset, over the whole log."""
    parts, scans = dict[float, Reduced](), list[tuple[float, float, tuple[int, int]]]()
    grid, step = _POLES, float(_POLES[1] / _POLES[0])
    own = np.arange(rows.basis.size) if friction else rows.basis.motion
    if more is not None:
        own = np.append(own, rows.basis.size + np.arange(more.shape[1]))
        rows = replace(rows, whole=np.hstack([rows.whole, more]))
    # the superset tells n and d apart only near the right corner, so the grid shrinks about the best one
    for _ in range(_ZOOMS):
        for share in map(float, grid):
            factor = reduced(law_structures.lagged(rows, 1.0 - share, own), rows.force)
            whole = np.zeros((factor.factor.shape[0], rows.whole.shape[1]))
            whole[:, own] = factor.factor
            parts[share] = Reduced(whole, factor.right)
            scans += [(left, share, pair) for pair, left in _scanned(rows, parts[share], friction=friction).items()]
        step **= 0.4
        grid = min(scans)[1] * step ** np.array([-1.0, 1.0])
    return _Scan(parts, scans)


def _smoothing_behind(rows: LawRows, floor: Floor) -> float:
    """Return the smoothing (m/s) of a friction feedforward that passes through a low pass, or that of the rows.

    Samples and a low pass make up for a wrong smoothing: a superset with signs of several smoothings tells them first.
    """
    levels = [replace(rows.raw, smoothing=float(speed) * rows.raw.fastest) for speed in _SMOOTH]
    more = np.stack([signals.direction("sign0") for signals in levels], axis=1)
    scan = _scanned_lags(rows, friction=True, more=more)
    pairs = dict[tuple[int, int], float]()
    for _, share, pair in sorted(scan.left):
        pairs.setdefault(pair, share)
    found = list[tuple[float, float]]()
    for (n, d), share in list(pairs.items())[:_PAIRS]:
        bare = Structure(CASCADE, True, n, d, friction=0, lag=Lag(1.0 - share, 0.0))
        fits = [_sign_along(rows, structure) for structure in (bare, replace(bare, fed="backward"))]
        signed = min(filter(None, fits), key=lambda one: _criterion(floor, one[0]), default=None)
        for _ in range(_TURNS):
            if signed is None:
                break
            cornered = _along_lag(rows.signed(signed[1]), signed[0].structure, _CLOSE)
            signed = cornered and _sign_along(rows, cornered.structure)
            found += [] if signed is None else [(_criterion(floor, signed[0]), signed[1].smoothing)]
    return min(found)[1] if found else rows.raw.smoothing


def _criterion(floor: Floor, one: Fitted) -> float:
    return floor.criterion(one.ssr, one.structure.parameters)


def _sign_along(rows: LawRows, structure: Structure) -> tuple[Fitted, Signals] | None:
    """Return the fit with the smoothed sign that leaves least, or None."""
    problems, signals = law_structures.SignProblems(rows, structure), dict[float, Signals]()

    def at(speed: float) -> Fitted | None:
        tried = replace(rows.raw, smoothing=speed * rows.raw.fastest)
        fitted = problems.fit(tried)
        if fitted is not None:
            signals[fitted.ssr] = tried
        return fitted

    best = _profile(rows, at, _SMOOTH)
    return None if best is None else (best, signals[best.ssr])


def _eased(rows: LawRows, floor: Floor, scan: _Scan, *, friction: bool) -> list[Scored]:
    """Return fits with a low pass of the velocity alone, for the likeliest structures, as `_lags` does."""
    feed = 0 if friction else None
    tried = (
        (share, Structure(CASCADE, True, n, d, fed=fed, friction=feed, eased=Lag(1.0 - share, 0.0)))
        for _, share, (n, d) in sorted(scan.left)[:_LIKELY]
        for fed in ("", "backward")
    )
    fits = [law_structures.fit(structure, rows.basis, scan.parts[share]) for share, structure in tried]
    return _with_corners(rows, floor, [one for one in fits if one is not None])


def _scanned_eased(rows: LawRows, *, friction: bool) -> _Scan:
    """Return a scan of low passes of the velocity alone."""
    basis, (Q, part) = rows.basis, _orthogonal(rows)
    parts, scans = dict[float, Reduced](), list[tuple[float, float, tuple[int, int]]]()
    grid, step = _POLES, float(_POLES[1] / _POLES[0])
    for _ in range(_ZOOMS):
        for share in map(float, grid):
            parts[share] = _extended(part, Q, law_structures.eased(rows, Lag(1.0 - share, 0.0)))
            scans += [(left, share, pair) for pair, left in _left_eased(basis, parts[share], friction=friction)]
        step **= 0.4
        grid = min(scans)[1] * step ** np.array([-1.0, 1.0])
    return _Scan(parts, scans)


def _left_eased(basis: Basis, part: Reduced, *, friction: bool) -> Iterator[tuple[tuple[int, int], float]]:
    """Yield what the superset of all structures leaves for each n and d, with a velocity after a low pass."""
    size, read = basis.size, basis.reading_places
    for n in range(1, MOST_SAMPLES + 1):
        for d in range(MOST_DELAY + 1):
            speed, travel = basis.velocity(n, d), basis.travel(n, d)
            own = part.factor[:, size:] @ np.stack([speed.on[read], travel.on[read]], axis=1)
            terms = law_structures.wide(basis, n, d, friction=friction, speed=False)
            yield (n, d), law_structures.left_by(Reduced(np.hstack([part.factor[:, :size], own]), part.right), terms)


def _with_corners(rows: LawRows, floor: Floor, coarse: list[Fitted]) -> list[Scored]:
    """Return fits of the likeliest structures with a low pass, each at its own corner."""
    coarse.sort(key=lambda one: one.ssr)
    # the best of each kind: another kind may be nearer to its minimum on the coarse grid
    kinds = dict[tuple[object, ...], Fitted]()
    for one in coarse:
        kinds.setdefault((one.structure.fed, one.structure.n, one.structure.lag and one.structure.lag.old), one)
    fine = [_along_lag(rows, one.structure, _AROUND) for one in list(kinds.values())[:_LAGGED]]
    found = list[Fitted]()

    def vary(fits: Iterable[Fitted]) -> None:
        """Add fits with each feedforward of the first few kinds of samples."""
        kinds = dict[tuple[object, ...], Fitted]()
        for one in sorted(fits, key=lambda one: _criterion(floor, one)):
            kinds.setdefault((one.structure.n, one.structure.d), one)
        for one in list(kinds.values())[:_VARIED]:
            every = (law_structures.at_corner(rows, structure) for structure in _variants(one.structure))
            found.extend(fitted for fitted in every if fitted is not None)
        found.sort(key=lambda one: _criterion(floor, one))

    vary(filter(None, fine))
    if found:
        # the superset tells the samples of the velocity worse than the law itself does
        vary(filter(None, (_along_lag(rows, structure, _CLOSE) for structure in _as_late(found[0].structure))))
    found[:3] = [better for one in found[:3] if (better := _along_lag(rows, one.structure, _AROUND)) is not None]
    return [Scored(one, _criterion(floor, one), rows.raw) for one in found]


def _as_late(structure: Structure) -> Iterator[Structure]:
    """Yield structures with other samples of the velocity, and a low pass that makes them as late."""
    lag = structure.lag or structure.eased
    assert lag is not None
    whole = 0.5 * (structure.n - 1) + lag.old + lag.pole / (1.0 - lag.pole)
    least, most = max(1, structure.n - _NEARBY), min(MOST_SAMPLES, structure.n + _NEARBY)
    for n in range(least, most + 1):
        for old in (0.0,) if structure.lag is None else (0.0, 0.5):
            late = whole - 0.5 * (n - 1) - old
            if (n, old) != (structure.n, lag.old) and late > _LEAST_LAG:
                other = Lag(late / (1.0 + late), old)
                yield replace(structure, n=n, **{"eased" if structure.lag is None else "lag": other})


def _passed(structure: Structure, share: float) -> Structure:
    assert structure.lag is not None
    return replace(structure, lag=structure.lag._replace(pole=1.0 - share))


def _along_lag(rows: LawRows, structure: Structure, about: np.ndarray) -> Fitted | None:
    """Return the fit of a structure with the best corner of its low pass, of the command or of the velocity."""
    if structure.eased is not None:
        at = law_structures.EasedProblems(rows, structure).at
        return _profile(rows, at, (1.0 - structure.eased.pole) * about)
    lag = structure.lag
    assert lag is not None

    def passed(share: float) -> Fitted | None:
        return law_structures.at_corner(rows, _passed(structure, share))

    return _profile(rows, passed, (1.0 - lag.pole) * about)


def _variants(structure: Structure) -> Iterator[Structure]:
    """Yield a cascade with all combinations of feedforward, with and without an integral."""
    for friction in dict.fromkeys((None, structure.friction)):
        for fed in ("", "backward", "central", "middle"):
            for forward in law_structures.FORWARD:
                for integral in (True, False):
                    yield replace(structure, fed=fed, forward=forward, integral=integral, friction=friction)


def _shifted(rows: LawRows, floor: Floor, best: Scored) -> list[Scored]:
    """Return fits of the structures whose integral refers to a zero position other than that of the logged reading."""
    tried = (
        replace(structure, shifted=True)
        for structure in structures(best.structure.n, best.structure.d)
        if structure.integral and structure.friction == best.structure.friction
    )
    least = dict[Structure, Fitted]()
    for one in law_structures.minima(tried, rows.basis, rows.reduced()):
        if one.structure not in least or one.ssr < least[one.structure].ssr:
            least[one.structure] = one
    return [Scored(one, floor.criterion(one.ssr, one.structure.parameters), rows.raw) for one in least.values()]


def _smoothed(rows: LawRows, floor: Floor, best: Scored) -> list[Scored]:
    """Return fits of the best structure with smoothed signs, and with one level per direction, in its friction
    feedforward.
    """
    if best.structure.friction is None:
        return []
    fastest = rows.raw.fastest
    tried = list[Scored]()
    for sides in (False, True):
        structure = replace(best.structure, sides=sides, friction=0)
        problems = law_structures.SignProblems(rows, structure)

        def at(speed: float, problems: law_structures.SignProblems = problems) -> Fitted | None:
            signals = replace(rows.raw, smoothing=speed * fastest)
            fitted = problems.fit(signals)
            if fitted is not None:
                criterion = floor.criterion(fitted.ssr, fitted.structure.parameters + 1)
                tried.append(Scored(fitted, criterion, signals))
            return fitted

        _profile(rows, at, _SMOOTH)
    if not tried:
        return []
    top = min(tried, key=lambda one: one.criterion)
    if top.structure.lag is not None or top.structure.eased is not None:
        return [top, *_in_turn(rows, floor, top)]
    return [top]


def _in_turn(rows: LawRows, floor: Floor, top: Scored) -> list[Scored]:
    """Return a fit with its low pass and its smoothed sign each at their best, in turn with the other one held."""
    found, signals = list[Scored](), top.signals
    for _ in range(_TURNS):
        fitted = _along_lag(rows.signed(signals), top.structure, _CLOSE)
        if fitted is None:
            break
        found.append(Scored(fitted, floor.criterion(fitted.ssr, fitted.structure.parameters + 1), signals))
        signed = _sign_along(rows, fitted.structure)
        signals = signals if signed is None else signed[1]
    return found


def _likely(floor: Floor, tried: dict[tuple[int, int], float]) -> list[tuple[int, int]]:
    """Return the pairs of n and d that may be the best; the residual of all others is clearly larger."""
    least = next(iter(tried.values()))
    return [pair for pair, left in list(tried.items())[:_KEPT] if floor.gain(left, least) < _HOPELESS]


def _scanned(rows: LawRows, part: Reduced, *, friction: bool = True) -> dict[tuple[int, int], float]:
    """Return the residual sum of squares of the superset of all structures for each n and d, the smallest first."""
    left = {
        (n, d): law_structures.left_by(part, law_structures.wide(rows.basis, n, d, friction=friction))
        for n in range(1, MOST_SAMPLES + 1)
        for d in range(MOST_DELAY + 1)
    }
    return dict(sorted(left.items(), key=lambda item: item[1]))


def _profile(rows: LawRows, at: Callable[[float], Fitted | None], grid: np.ndarray) -> Fitted | None:
    """Return the best fit over one additional parameter, on a grid and then by Brent's method around the best value."""
    from scipy.optimize import minimize_scalar  # takes a second to import

    found, power = dict[float, Fitted](), float(rows.force @ rows.force)

    def left(logarithm: float) -> float:
        value = math.exp(logarithm)
        fitted = at(value) if value < 1.0 else None
        if fitted is not None:
            found[value] = fitted
        return power if fitted is None else fitted.ssr

    lefts = [left(math.log(value)) for value in grid]
    if not found:
        return None
    k = min(max(int(np.argmin(lefts)), 1), len(grid) - 2)
    bounds = math.log(grid[k - 1]), math.log(grid[k + 1])
    minimize_scalar(left, bounds=bounds, method="bounded", options={"xatol": _FINE, "maxiter": 12})
    return min(found.values(), key=lambda one: one.ssr)


def _orthogonal(rows: LawRows) -> tuple[np.ndarray, Reduced]:
    Q, R = np.linalg.qr(np.column_stack([rows.columns, rows.force]))
    return Q, Reduced(R[:, :-1], R[:, -1])


def _extended(part: Reduced, Q: np.ndarray, more: np.ndarray) -> Reduced:
    """Return a reduced problem with additional columns appended."""
    on = Q.T @ more
    outside = triangle(more - Q @ on)
    size = part.factor.shape[0]
    factor = np.block([[part.factor, on], [np.zeros((outside.shape[0], part.factor.shape[1])), outside]])
    return Reduced(factor, np.concatenate([part.right, np.zeros(factor.shape[0] - size)]))

"""The search for the control law of a log: which structures explain its command, and whether one of them is the law."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
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
    triangle,
)
from feeddrive.identification.motion.law_structures import CASCADE, PID, Fitted, Lag, Model, Structure
from feeddrive.identification.regression import median_spread

ROUNDING = 1e-5  # of the force: what is left below it is rounding of the log, and speaks for no structure
_HOPELESS = 80.0  # of n ln(ssr), by which a pair of n and d must not be worse than the best to be fitted
_SIGNS_PLAY = 15.0  # of n ln(ssr), that the four columns of directions must explain before they are tried
_KEPT = 4  # pairs of n and d that are fitted with every structure
STRAY = 6.0  # standard deviations beyond which a row is left out: single samples at a limit, a spike of a difference
FEW = 0.03  # of the rows that may be left out so
_RATES = np.geomspace(0.005, 1.0, 14)  # r = T Kp / model_mass that are tried first
_STANDING = (0.02, 0.06, 0.15, 0.4)  # r that stand for any model while n and d are searched
_MOST_DEAD = 3  # samples of dead time in a reference model
_LIKELY = 10  # pairs of n and d that are tried with a model or a low pass, which the superset lacks
_LAGGED = 3  # kinds of law with a low pass whose corner is searched finely
_ZOOMS = 4  # times that the grid of corners shrinks
_AROUND = 1.2 ** np.arange(-2.0, 3.0)  # of a corner that is searched finely
_CLOSE = 1.03 ** np.arange(-1.0, 2.0)  # the same, after a fit to fewer rows
_FEWER = 6000  # rows with which models and low passes are searched
_REFITTED = 2  # fits that are fitted to all rows then
_FINE = 1e-4  # relative, to which the corner of a low pass and the rate of a model are searched
_POLES = np.geomspace(0.02, 0.5, 9)  # 1 - pole of a low pass that are tried first
_SMOOTH = np.geomspace(1e-3, 0.3, 7)  # of the largest set speed: smoothed signs of friction feedforward that are tried
_BANDS = np.geomspace(1e-3, 0.1, 5)  # of the usual error: half widths of a dead band that are tried
LEAST_ROWS = 100  # some two for each unknown of the free law: with fewer, nothing is left to judge by
MOST_LAG = 1.5  # samples between motion and command; a law with a low pass looks like one with 2.5 and more
_TRIED_FROM = 0.02  # of the sum of squares of the free law: from so much more on, further structures are tried
_CHANCE = 4.0  # standard deviations of a chi square, beyond which a law misses something that the free law sees


@dataclass(frozen=True, eq=False)
class Scored:
    """A fitted structure with its criterion, ln-likelihood ratio to the free law plus the price of its unknowns."""

    fitted: Fitted
    criterion: float
    signals: Signals

    @property
    def structure(self) -> Structure:
        """The fitted structure."""
        return self.fitted.structure


@dataclass(frozen=True, eq=False)
class Floor:
    """What a free linear law leaves: any gains on 13 past readings, 9 set positions and both sums.

    ssr        sum of squares that is left;   power: that of the force
    memory     first autocorrelation of what is left
    effective  number of independent rows
    unknowns   its number of coefficients
    """

    ssr: float
    power: float
    memory: float
    effective: float
    unknowns: int

    @property
    def price(self) -> float:
        """The criterion of the free law."""
        return self.unknowns * math.log(self.effective)

    @property
    def left(self) -> float:
        """The RMS that is left, relative to that of the force."""
        return math.sqrt(self.ssr / self.power)

    def misses(self, scored: Scored, chance: float = _CHANCE) -> bool:
        """Return True if a structure leaves more than chance lets a law leave beyond the free one.

        `chance`: standard deviations of a chi square.
        """
        spare = self.unknowns - scored.structure.parameters
        return self.criterion(scored.fitted.ssr, 0) > spare + chance * math.sqrt(2.0 * spare)

    def wants_more(self, scored: Scored) -> bool:
        """Return True if a structure misses something, or leaves so much more that further ones are worth a trial."""
        return self.misses(scored) or scored.fitted.ssr > (1.0 + _TRIED_FROM) * self.ssr

    def gain(self, more: float, less: float) -> float:
        """Return n ln(more / less) of two sums of squares."""
        noise = ROUNDING**2 * self.power
        return self.effective * math.log((more + noise) / (less + noise))

    def criterion(self, ssr: float, unknowns: int) -> float:
        """Return n ln(ssr / floor) + p ln n with n independent rows."""
        return self.gain(ssr, self.ssr) + unknowns * math.log(self.effective)


def floor_of(rows: LawRows, part: Reduced, places: np.ndarray | None = None) -> Floor:
    """Return the floor of the rows: of a free law of all basis columns, or of those at some places."""
    places = np.arange(rows.basis.size) if places is None else places
    own = part.factor[:, places]
    gains = _solution(Reduced(own, part.right))
    rest = rows.force - rows.columns[:, places] @ gains
    left = part.right - own @ gains
    return Floor(float(left @ left), part.power, correlation(rest), independent(rest), places.size)


def independent(rest: np.ndarray) -> float:
    """Return the number of independent rows of a residual."""
    rho = max(0.0, correlation(rest))
    return max(20.0, rest.size * (1.0 - rho) / (1.0 + rho))


def _solution(part: Reduced) -> np.ndarray:
    """Return the coefficients of all columns."""
    sizes = np.linalg.norm(part.factor, axis=0)
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    return np.linalg.lstsq(part.factor / sizes, part.right, rcond=1e-13)[0] / sizes


def correlation(rest: np.ndarray) -> float:
    """Return the first autocorrelation of a residual."""
    power = float(rest @ rest)
    return float(rest[1:] @ rest[:-1]) / power if power > 0.0 else 0.0


def nonlinear(rows: LawRows, found: Fitted, floor: Floor) -> float:
    """Return by how much nonlinear functions of the signals explain what a law leaves, as a criterion: > 0 if they do.

    A dead band, a limit inside of the law or friction compensation by the measured velocity leave what no linear law
    explains either; with correlated noise only such columns tell it from noise.  (Ramsey's RESET test.)  Dead bands of
    several widths are tried each alone.
    """
    n, d = found.structure.n, found.structure.d
    few = rows.fewer(_FEWER)
    basis, whole = few.basis, few.whole
    e, v = whole @ basis.error(d).on, whole @ basis.velocity(n, d).on
    e = e - np.mean(e[few.places])
    bends = []
    for signal in (e, v):
        size = median_spread(signal[few.places]) or float(np.std(signal))
        bends += [np.tanh(signal / (share * size)) for share in (0.1, 0.5, 2.0)] + [signal * np.abs(signal)]
        bends += [np.abs(signal)]
    # a dead band takes what is within it from the error, and its integral from that of the law
    widths = _BANDS * median_spread(e[few.places])
    within = [np.clip(e, -width, width) for width in widths if width > 0.0]
    kinds = [bends, *([one, rows.raw.T * np.cumsum(one)] for one in within)]
    more = few.taken(np.stack([column for kind in kinds for column in kind], axis=1))
    own = law_structures.regressors(found, few)
    rest = few.force - own[:, : found.values.size] @ found.values
    linear = np.hstack([own, few.columns])
    both = np.column_stack([linear, more, rest])
    sizes = np.linalg.norm(both[:, :-1], axis=0)
    # what the linear columns leave of the others
    R = triangle(both / np.append(np.where(sizes > 0.0, sizes, 1.0), 1.0))[linear.shape[1] :, linear.shape[1] :]
    noise = ROUNDING**2 * float(few.force @ few.force)
    effective = floor.effective * few.force.size / rows.force.size
    least, first, explained = float(np.sum(R[:, -1] ** 2)), 0, []
    for kind in kinds:
        chosen = R[:, first : first + len(kind)]
        other = R[:, -1] - chosen @ np.linalg.lstsq(chosen, R[:, -1], rcond=1e-9)[0]
        gain = effective * math.log((least + noise) / (float(other @ other) + noise))
        explained.append(gain - len(kind) * math.log(effective))
        first += len(kind)
    return max(explained)


@dataclass(frozen=True, eq=False)
class Search:
    """All structures that were fitted to a log, best first, and the floor they are held against.

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
        """Return the search with further fits, best first."""
        return replace(self, scored=tuple(sorted((*self.scored, *more), key=lambda one: one.criterion)))

    def residual(self, scored: Scored) -> np.ndarray:
        """Return what a structure leaves of the force, over the rows."""
        found = scored.fitted
        rows = self.rows if scored.signals is self.rows.raw else self.rows.signed(scored.signals)
        columns = law_structures.regressors(found, rows)
        gains = columns[:, : found.values.size]
        return self.rows.force - gains @ found.values


def search(choices: Sequence[Signals], limit: float | None) -> Search | None:
    """Return the structures that explain a log, or None if too few rows are away from the limit.

    `choices` are ways to read the log, likeliest first. If each misses something, the one that leaves least is
    returned, of which models and low passes are still to be tried (`deeper`).
    """
    found = list[Search]()
    for signals in choices:
        keep = signals.free(limit)
        first = _searched(signals, keep)
        if first is None:
            continue
        found.append(first)
        for trial in (keep, *_trials(signals, keep, first)):
            one = first if trial is keep else _searched(signals, trial)
            if one is not None and not one.floor.wants_more(one.best):
                # what is so late may be delayed by a low pass
                if one.best.structure.late > MOST_LAG:
                    return _with_low_passes(one)
                return _with_models(one) if _is_loose(one.best) else one
            found += [] if one is None or one is first else [one]
    if not found:
        return None
    return replace(min(found, key=lambda one: one.floor.criterion(one.best.fitted.ssr, 0)), deep=False)


def _trials(signals: Signals, keep: np.ndarray, first: Search) -> Iterator[np.ndarray]:
    """Yield masks of fewer rows: those without strays, and those below a noisy plateau of the command."""
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


def _searched(signals: Signals, keep: np.ndarray) -> Search | None:
    """Return the search over the rows in `keep` without models and low passes, or None for too few rows."""
    rows = LawRows.of(signals, keep)
    if rows.force.size < LEAST_ROWS:
        return None
    basis, part = rows.basis, rows.reduced()
    floor = floor_of(rows, part)
    tried = _scanned(rows, part)
    likely, least = _likely(floor, tried), next(iter(tried.values()))
    bare = law_structures.left_by(part, law_structures.wide(basis, *likely[0], friction=False))
    friction = (None, 0, -1) if floor.gain(bare, least) > _SIGNS_PLAY else (None,)
    every = (structure for n, d in likely for structure in structures(n, d, friction))
    scored = [
        Scored(found, floor.criterion(found.ssr, found.structure.parameters), signals)
        for found in law_structures.minima(every, basis, part)
    ]
    if not scored:
        return None
    # the second time with the samples that the first smoothed sign brought out
    return _with_more(Search(rows, floor, tried, tuple(scored)), (_smoothed, _smoothed, _shifted))


def deeper(found: Search) -> Search:
    """Return a search with reference models and low passes."""
    found = replace(found, deep=True)
    found = _with_models(found)
    return _with_low_passes(found) if found.floor.wants_more(found.best) else found


def _with_models(found: Search) -> Search:
    """Return a search with reference models in the integral."""
    return found.with_fits(_again(found.rows, found.floor, _models(found.rows.fewer(_FEWER), found.floor)))


def _with_low_passes(found: Search) -> Search:
    """Return a search with low passes of the command."""
    best, floor = found.best, found.floor
    # friction feedforward keeps the direction that explains most so far
    rows = found.rows if best.signals is found.rows.raw else found.rows.signed(best.signals)
    more = _lags(rows.fewer(_FEWER), floor, friction=best.structure.friction is not None)
    more = sorted(_again(rows, floor, more), key=lambda one: one.criterion)
    for one in more[:1]:
        more += _smoothed(found.rows, floor, one)
    return found.with_fits(more)


def _is_loose(scored: Scored) -> bool:
    """Return True for a PID with velocity feedforward of its own: a cascade with a reference model looks like it."""
    structure = scored.structure
    return structure.family == PID and structure.forward == "free" and structure.older == 0


def _with_more(found: Search, further: Sequence[Callable[[LawRows, Floor, Scored], list[Scored]]]) -> Search:
    """Return a search with further fits, best first; each step is tried only while the best fit misses something."""
    found = found.with_fits(())
    for tried_next in further:
        if found.floor.wants_more(found.best):
            found = found.with_fits(tried_next(found.rows, found.floor, found.best))
    return found


def structures(n: int, d: int, feeds: tuple[int | None, ...] = (None, 0, -1)) -> Iterator[Structure]:
    """Yield all structures without a model or a low pass, for one n and d; `feeds`: of friction feedforward."""
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
    """Return the likeliest of fits to fewer rows, fitted to all rows."""
    found.sort(key=lambda one: one.criterion)
    again = list[Scored]()
    for one in found[:_REFITTED]:
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


def _models(rows: LawRows, floor: Floor) -> list[Scored]:
    """Return fits with a reference model in the integral, for the likeliest n and d."""
    some = [law_structures.through_model(rows, Model(rate, 0, False), 0, 0, central=False) for rate in _STANDING]
    # models of four rates with free gains stand for any model while n and d are told apart
    Q, part = _orthogonal(rows)
    wide = _extended(part, Q, np.hstack(some))
    found: list[Scored] = []
    for n, d in list(_scanned(rows, wide))[:2]:
        problems = law_structures.ModelProblems(rows, n, d)
        coarse: list[Fitted] = []
        for inside in (True, False):
            for samples in range(_MOST_DEAD + 1):
                rates = _RATES[_RATES * (samples + 1) < 1.0] if inside else _RATES
                top = _profile(rows, problems.along(Model(1.0, samples, inside), "free"), rates)
                coarse += [] if top is None else [top]
        coarse.sort(key=lambda one: one.ssr)
        for one in coarse[:3]:
            model = one.structure.model
            assert model is not None
            for forward in law_structures.FORWARD:
                near = model.rate * _AROUND
                top = _profile(rows, problems.along(model, forward), near)
                if top is not None:
                    found.append(Scored(top, floor.criterion(top.ssr, top.structure.parameters), rows.raw))
    return found


def _lags(rows: LawRows, floor: Floor, *, friction: bool) -> list[Scored]:
    """Return fits with a low pass of the command, for the likeliest structures; `friction`: with its feedforward."""
    parts, scans = dict[float, Reduced](), list[tuple[float, float, tuple[int, int]]]()
    grid, step = _POLES, float(_POLES[1] / _POLES[0])
    own = np.arange(rows.basis.size) if friction else rows.basis.motion
    # the superset tells n and d apart only near the right corner, so the grid shrinks about the best one
    for _ in range(_ZOOMS):
        for share in map(float, grid):
            columns = np.zeros_like(rows.columns)
            columns[:, own] = law_structures.lagged(rows, 1.0 - share, own)
            factor = reduced(columns[:, own], rows.force)
            whole = np.zeros((factor.factor.shape[0], rows.basis.size))
            whole[:, own] = factor.factor
            parts[share] = Reduced(whole, factor.right)
            scans += [(left, share, pair) for pair, left in _scanned(rows, parts[share], friction=friction).items()]
        step **= 0.4
        grid = min(scans)[1] * step ** np.array([-1.0, 1.0])
    coarse = list[Fitted]()
    for _, share, (n, d) in sorted(scans)[:_LIKELY]:
        for fed in ("", "backward"):
            for old in (0.0, 0.5):
                feed = 0 if friction else None
                structure = Structure(CASCADE, True, n, d, fed=fed, friction=feed, lag=Lag(1.0 - share, old))
                fitted = law_structures.fit(structure, rows.basis, parts[share])
                coarse += [] if fitted is None else [fitted]
    coarse.sort(key=lambda one: one.ssr)
    # the best of each kind: another kind may be nearer to its minimum on the coarse grid
    kinds = dict[tuple[object, ...], Fitted]()
    for one in coarse:
        assert one.structure.lag is not None
        kinds.setdefault((one.structure.lag.old, one.structure.fed), one)
    fine = [_along_lag(rows, one.structure, _AROUND) for one in list(kinds.values())[:_LAGGED]]
    found = list[Fitted]()
    for one in fine[:2] if len(fine) < 2 else sorted(filter(None, fine), key=lambda one: one.ssr)[:2]:
        if one is None:
            continue
        for structure in _variants(one.structure):
            fitted = law_structures.sensible(structure, law_structures.lagged_problem(rows, structure))
            found += [] if fitted is None else [fitted]
    found.sort(key=lambda one: floor.criterion(one.ssr, one.structure.parameters))
    found[:3] = [better for one in found[:3] if (better := _along_lag(rows, one.structure, _AROUND)) is not None]
    return [Scored(one, floor.criterion(one.ssr, one.structure.parameters), rows.raw) for one in found]


def _passed(structure: Structure, share: float) -> Structure:
    assert structure.lag is not None
    return replace(structure, lag=structure.lag._replace(pole=1.0 - share))


def _along_lag(rows: LawRows, structure: Structure, about: np.ndarray) -> Fitted | None:
    """Return the fit of a structure with the best corner of its low pass."""
    lag = structure.lag
    assert lag is not None

    def at(share: float) -> Fitted | None:
        other = _passed(structure, share)
        return law_structures.sensible(other, law_structures.lagged_problem(rows, other))

    return _profile(rows, at, (1.0 - lag.pole) * about)


def _variants(structure: Structure) -> Iterator[Structure]:
    """Yield a cascade with all feedforwards, with and without an integral."""
    for friction in dict.fromkeys((None, structure.friction)):
        for fed in ("", "backward", "central", "middle"):
            for forward in law_structures.FORWARD:
                for integral in (True, False):
                    yield replace(structure, fed=fed, forward=forward, integral=integral, friction=friction)


def _shifted(rows: LawRows, floor: Floor, best: Scored) -> list[Scored]:
    """Return the structures with an integral of a reading with another zero than the logged one."""
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
    """Return the best structure with smoothed signs of its friction feedforward, and with a level by direction."""
    if best.structure.friction is None:
        return []
    fastest = float(np.max(np.abs(np.diff(rows.raw.wanted)))) / rows.raw.T
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
    if top.structure.lag is not None:
        again = _along_lag(rows.signed(top.signals), top.structure, _CLOSE)
        if again is None:
            return [top]
        return [top, Scored(again, floor.criterion(again.ssr, again.structure.parameters + 1), top.signals)]
    # samples and other feedforwards made up for the wrong sign before
    changed = rows.signed(top.signals)
    part = changed.reduced()
    every = (
        replace(structure, sides=top.structure.sides)
        for n, d in _likely(floor, _scanned(changed, part))
        for structure in structures(n, d, (0,))
    )
    again = [
        Scored(one, floor.criterion(one.ssr, one.structure.parameters + 1), top.signals)
        for one in law_structures.minima(every, changed.basis, part)
    ]
    return [top, *again]


def _likely(floor: Floor, tried: dict[tuple[int, int], float]) -> list[tuple[int, int]]:
    """Return the pairs of n and d that may win: others leave clearly more."""
    least = next(iter(tried.values()))
    return [pair for pair, left in list(tried.items())[:_KEPT] if floor.gain(left, least) < _HOPELESS]


def _scanned(rows: LawRows, part: Reduced, *, friction: bool = True) -> dict[tuple[int, int], float]:
    """Return what the superset of all structures leaves for each n and d, the smallest first."""
    left = {
        (n, d): law_structures.left_by(part, law_structures.wide(rows.basis, n, d, friction=friction))
        for n in range(1, MOST_SAMPLES + 1)
        for d in range(MOST_DELAY + 1)
    }
    return dict(sorted(left.items(), key=lambda item: item[1]))


def _profile(rows: LawRows, at: Callable[[float], Fitted | None], grid: np.ndarray) -> Fitted | None:
    """Return the best fit over one more unknown: on a grid first, then by Brent's method about the best value."""
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
    """Return a reduced problem with further columns behind its own."""
    on = Q.T @ more
    outside = triangle(more - Q @ on)
    size = part.factor.shape[0]
    factor = np.block([[part.factor, on], [np.zeros((outside.shape[0], part.factor.shape[1])), outside]])
    return Reduced(factor, np.concatenate([part.right, np.zeros(factor.shape[0] - size)]))

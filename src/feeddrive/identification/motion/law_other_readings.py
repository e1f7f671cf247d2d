"""The law of a log that holds other readings than the law had: those of the load's encoder, or rounded ones.

The motor, whose position x_m the law reads, is ahead of the load x by its own spring:

    x_m = x + h (a - (d/k) da/dt) + drag sgn v,   h = m_load/k,   a acceleration of the load

drag: friction of the load over the stiffness. With it the law is one of the logged signals:

    u = C(x_set, x_m + count of the motor) + noise

Counts of the load's encoder enter the columns by differences of up to third order, and bias least squares; counts of
the motor, which the log does not hold, are blue noise of the force. Both are fast, while the motion is slow: a low pass
over all columns and the force leaves the equation as it is and takes the noise away. The rows that are left
(`LawRows.slow`) tell gains to the tenth of a percent; samples of the velocity and of delay are one lag in them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from feeddrive.identification.motion import law_search, law_structures
from feeddrive.identification.motion.law_instruments import SetMotion
from feeddrive.identification.motion.law_rows import STIFF, LawRows, Reduced, Signals, Twist, reduced
from feeddrive.identification.motion.law_search import Floor, Scored, floor_of
from feeddrive.identification.motion.law_structures import CASCADE, Fitted, Lag, Structure
from feeddrive.identification.motion.motion_log import count_of
from feeddrive.identification.regression import median_spread

_HIGHEST = 40.0  # Hz: what is faster is counts and noise, in a loop that follows set motion
_SAMPLES = (1, 2, 4, 8)  # of the velocity that are tried: others make nearly the lag of one of these
_DELAYS = (0, 1, 2)  # samples that are tried
_POLES = np.geomspace(0.02, 0.5, 9)  # 1 - pole of a low pass that are tried first
_NODES = np.geomspace(5e-3, 0.97, 17)  # 1 - pole of low passes, between which columns are interpolated
_SMOOTH = np.geomspace(1e-3, 0.3, 7)  # of the largest set speed: smoothed signs of friction feedforward that are tried
_DAMPING = 0.03  # of an axis that twists, with which samples, delay and corner are scanned
_BENDS = np.geomspace(1e-6, 1.5e-4, 9)  # s2: m_load/k of an axis with its antiresonance from 13 to 160 Hz
_STARTS = 4  # fits without and with a low pass that are searched finely
_KEPT = 4  # of these, from which parts are left out
_AS_LATE = 1.0  # samples of delay and of half a difference, by which cascades with some of the parts may differ from it
_NARROWED = 6  # cascades with some of the parts that are searched
_FIRST_STEPS = 3  # of a search, that tell which of them are searched finely
_FINE = 6  # of these, that are searched finely
_MERGED = 0.7  # of ln 1/Tn, within which two starts of a fine search are one
_TWO = 0.1  # of ln 1/Tn, beyond which two fits are two minima
_ANY = Twist(1.0, 1.0)  # stands for any twist
_FAR = 60.0  # difference of the criterion, from which on a fit is not searched any more
_PLAYS = 15.0  # of the criterion, that friction feedforward must explain before its smoothing is searched
_ODD = 12.0  # difference of the criterion up to which such a fit counts when errors are estimated
_LONG = 0.6  # first autocorrelation of what the free law leaves, from which on something wanders in the log
SEEN = 1e-5  # of the largest set speed: a step of the set position by rounding that matters to a difference quotient
_ORDER = 7  # of the differences that leave counts
_PREDICTED = 20  # samples from which the fast force is predicted
_NOTHING = 1e-9  # of the largest column, up to which one holds nothing
# of what counts leave of the fast force, in squares, that they explain if the law read them: motion that is left in
# them and counts of another encoder explain up to 0.07 (of 52 logs of the load's encoder, 6 s at 1 and 2 kHz)
_HEARD = 0.08
# of what counts would command at most, that they explain if the law read them: motion that the coarse counts of
# another encoder make explains 2 and more of it, counts that were read at most 1.05 (43 logs)
_COMMANDED = 1.5
_DEAF = 0.1  # of the command by counts: laws with a filter of the velocity have 0.012 of it, but are heard
_SLIGHT = 0.01  # of the force, that counts at a turn may add to what friction feedforward looks like
_WIDER = (80.0, 160.0)  # Hz: to which a twist is looked for that the slow rows do not show
_CHANCE = 4.0  # standard deviations
_WEIGHTED = 2  # searches by the set motion, each with the noise of the rows that the last one left
# in squares, of what least squares leave, that a law found by the set motion leaves: right ones leave up to 2.1, as
# least squares bend towards the inverse of the plant
_MIXED = 4.0
_REFUSED = 3.0  # standard deviations of a chi square: one right law in 200 is refused, and fewer wrong ones pass
_STEP = 1e-3  # relative, by which the slope of an unknown is taken
_STEPS = 12  # of a fine search
# ranges of the unknowns of a fine search: far beyond those of axes
_RANGES = {
    "compliance": (1e-9, 1e-2),  # s2
    "loss": (1e-7, 0.1),  # s
    "share": (6e-3, 0.95),
    "smoothing": (1e-9, 1e3),  # m/s
    "rate": (0.3, 1500.0),  # 1/s
}


@dataclass(frozen=True, eq=False)
class OtherReadings:
    """A cascade for a log whose readings are not those of the law, in its slow rows.

    rows    the slow rows, and those that they were taken from (`fast`)
    floor   what a free linear law leaves of them
    gain    criterion of the best fit without a twist between motor and load, less that of this one
    likely  this and other fits, best first
    told    instruments of the set motion, if noise moves the axis and only what they tell is explained
    biased  the likeliest fit of least squares then
    counts  what counts of the log's reading and set position are in the force
    """

    rows: LawRows
    fast: LawRows
    floor: Floor
    gain: float
    likely: tuple[Scored, ...]
    counts: tuple[Counts, Counts] | None = None
    told: SetMotion | None = None
    biased: Scored | None = None

    @property
    def misses(self) -> bool:
        """True if the likeliest fit leaves more than chance lets a law leave beyond the free one."""
        return self.floor.misses(self.best, _REFUSED)

    def twist(self, enough: float) -> float:
        """Return `gain`, or that of faster rows if it is not `enough`."""
        gain = self.gain
        for highest in _WIDER:
            if gain > enough:
                break
            faster = _Slow(self.fast.slow(highest), self.fast).likeliest(self.likely)
            gain = gain if faster is None else faster.gain
        return gain

    def residual(self, one: Scored) -> np.ndarray:
        """Return what a law leaves of the force in the slow rows."""
        return residual(self.rows, one)

    def ahead(self, one: Scored) -> float:
        """Return by how much less than a law of all rows the likeliest fit leaves of the slow ones, as a criterion."""
        rest = self.residual(one)
        left = float(rest @ rest)
        if self.told is not None:
            left = self.floor.ssr + float(np.sum(self.told.told(rest) ** 2))
        return self.floor.criterion(left, one.structure.parameters) - self.best.criterion

    @property
    def best(self) -> Scored:
        """The likeliest fit."""
        return self.likely[0]


def with_other_readings(signals: Signals, keep: np.ndarray, *, blue: bool = False) -> OtherReadings | None:
    """Return the likeliest cascade in the slow rows of those in `keep`, or None if the law had the log's readings.

    `blue`: True if the force has counts, which may be those of another encoder.
    """
    fast = LawRows.of(signals, keep)
    exact = count_of(signals.wanted) <= SEEN * float(np.max(np.abs(np.diff(signals.wanted))))
    if exact and not blue and counts_of(fast, "dx").heard:
        return None
    rows = fast.slow(_HIGHEST)
    if rows.force.size < law_search.LEAST_ROWS:
        return None
    found = _Slow(rows, fast).likeliest()
    if found is None or not (found.misses or found.floor.memory > _LONG):
        return found and _with_counts(found, signals, keep)
    # a motor that rests is up to half a count from its reading, and the integral of the law sums that
    rows = LawRows.of(signals, keep & signals.between_rests()).slow(_HIGHEST)
    if rows.force.size < law_search.LEAST_ROWS:
        return _with_counts(found, signals, keep)
    again = _Slow(rows, fast).likeliest()
    if again is None:
        return _with_counts(found, signals, keep)
    found, rest = again, again.residual(again.best)
    far = np.abs(rest) > law_search.STRAY * median_spread(rest)
    # so it is at a turn
    if found.misses and 0 < np.sum(far) <= law_search.FEW * far.size:
        found = _Slow(found.rows.without(far), fast).likeliest(found.likely) or found
    if found.misses or (blue and not _holds(found)):
        found = _by_set_motion(rows, fast, found.best) or found
    return _with_counts(found, signals, keep)


def _holds(found: OtherReadings) -> bool:
    """Return True if what the likeliest fit leaves has nothing, but for chance, that the set motion tells."""
    rest = found.residual(found.best)
    told = SetMotion.of(found.rows, rest).weighted(rest)
    floor = told.floor(found.rows.force, rest)
    left = floor.ssr + float(np.sum(told.told(rest) ** 2))
    return not floor.misses(replace(found.best, fitted=replace(found.best.fitted, ssr=left)), _REFUSED)


def _by_set_motion(rows: LawRows, fast: LawRows, biased: Scored) -> OtherReadings | None:
    """Return the likeliest cascade by what the set motion tells, or None; `biased`: that of least squares.

    The widest cascade, whose residual holds no part of another law, tells how noisy each row is, then the likeliest.
    """
    rest = residual(rows, biased)
    told = SetMotion.of(rows, rest)
    first = _Slow(rows, fast, told)
    starts = first.starts()
    if not starts:
        return None
    likely, found = tuple(first.wide(starts)), None
    for _ in range(_WEIGHTED):
        found = _Slow(rows, fast, told.weighted(residual(rows, likely[0]))).likeliest(likely)
        if found is None:
            return None
        likely = found.likely
    assert found is not None
    left = found.residual(found.best)
    return replace(found, biased=biased) if float(left @ left) < _MIXED * float(rest @ rest) else None


def residual(rows: LawRows, one: Scored) -> np.ndarray:
    """Return what a fit leaves of the force in rows."""
    columns = law_structures.regressors(one.fitted, rows.signed(one.signals))
    return rows.force - columns[:, : one.fitted.values.size] @ one.fitted.values


@dataclass(frozen=True)
class Counts:
    """What the counts of a signal of the log are in the force.

    expected   what they would command by the law, as sum of squares over the variance of the force
    explained  what a free law of them explains of the force, likewise
    unknowns   number of its coefficients
    rows       number of rows
    most       what they would command at most, by a velocity over one sample, likewise
    """

    expected: float
    explained: float
    unknowns: int
    rows: int
    most: float = math.inf

    @property
    def heard(self) -> bool:
        """True if the force follows them: motion that is left explains less, or more than the law could command."""
        return _HEARD * self.rows < self.explained < _COMMANDED * self.most

    @property
    def missing(self) -> bool:
        """True if the force would follow them, if the law had read them, and it does not."""
        chance = _CHANCE * math.sqrt(2.0 * (self.unknowns + 2.0 * self.explained))
        return not self.heard and self.explained + chance < _DEAF * self.expected


def counts_of(rows: LawRows, signal: str, commands: Sequence[np.ndarray] = ()) -> Counts:
    """Return what the counts of a signal, dx of the reading or ds of the set position, are in the force.

    Differences of high order leave counts, which are white, and next to nothing of motion. What they leave of the force
    is made white by the linear prediction of it. `commands`: those of a law by the signal alone, and at most.
    """
    from scipy.linalg import solve_toeplitz  # takes a second to import
    from scipy.signal import lfilter

    near = rows.places[_ORDER:] - rows.places[:-_ORDER] == _ORDER
    past = [k for k, name in enumerate(rows.basis.names) if name.startswith(signal) and int(name[2:]) >= 0]
    columns = np.column_stack([rows.columns[:, past], *commands, rows.force])
    fast = np.diff(columns, _ORDER, axis=0)[near]
    force = fast[:, -1]
    memory = np.array([force[: force.size - k] @ force[k:] for k in range(_PREDICTED + 1)])
    if force.size < law_search.LEAST_ROWS or memory[0] == 0.0:
        return Counts(0.0, 0.0, len(past), force.size)
    memory[0] *= 1.0 + _NOTHING
    predicted = np.append(1.0, -solve_toeplitz(memory[:-1], memory[1:]))
    fast = np.asarray(lfilter(predicted, [1.0], fast, axis=0))[_PREDICTED:]
    force, made, changes = fast[:, -1], fast[:, len(past) : -1], fast[:, : len(past)]
    sizes = np.linalg.norm(changes, axis=0)
    changes = changes[:, sizes > _NOTHING * np.max(sizes, initial=0.0)]
    explained = float(np.sum((np.linalg.qr(changes)[0].T @ force) ** 2))
    noise = (float(force @ force) - explained) / (force.size - changes.shape[1])
    expected, most = np.sum(made**2, axis=0) / noise if commands else (0.0, math.inf)
    return Counts(float(expected), explained / noise, changes.shape[1], force.size, float(most))


def _with_counts(found: OtherReadings, signals: Signals, keep: np.ndarray) -> OtherReadings:
    """Return a fit with what the counts of reading and set position, which it would command, are in the force."""
    one, still = found.best, np.zeros(signals.x.size)
    kind = replace(one.structure, twist=STIFF, drag=False, friction=None, fed="", shifted=False)
    gains = np.array([one.fitted[name] for name in kind.gains])
    laws = [replace(one.fitted, structure=replace(kind, n=n), values=gains) for n in (kind.n, 1)]

    def counts(signal: str, own: Signals) -> Counts:
        rows = LawRows.of(own, keep)
        return counts_of(rows, signal, [law_structures.regressors(law, rows)[:, : gains.size] @ gains for law in laws])

    return replace(
        found, counts=(counts("dx", replace(signals, wanted=still)), counts("ds", replace(signals, x=still)))
    )


def differs(rows: LawRows, one: Scored) -> float:
    """Return by how much other gains of a law explain the slow rows better, as n ln of the sums of squares.

    The gains of a law are those of its slow part. Those that counts of another reading have biased are not. (Hausman's
    test.) Infinite where the rows have no slow part that shows it, as of short stretches.
    """
    slow = rows.slow(_HIGHEST).signed(one.signals)
    columns = law_structures.regressors(one.fitted, slow)
    if slow.force.size <= columns.shape[1]:
        return math.inf
    rest = slow.force - columns[:, : one.fitted.values.size] @ one.fitted.values
    sizes = np.linalg.norm(columns, axis=0)
    columns = columns / np.where(sizes > 0.0, sizes, 1.0)
    other = rest - columns @ np.linalg.lstsq(columns, rest, rcond=1e-12)[0]
    noise = law_search.ROUNDING**2 * float(slow.force @ slow.force)
    noise += law_search.by_chance(slow, one.fitted, columns)
    return law_search.independent(other) * math.log((float(rest @ rest) + noise) / (float(other @ other) + noise))


class _Slow:
    """The problems of cascades in the slow rows."""

    def __init__(self, rows: LawRows, fast: LawRows, told: SetMotion | None = None) -> None:
        self.rows, self.fast, self.told = rows, fast, told
        self.floor = floor_of(rows, rows.reduced()) if told is None else told.floor(rows.force, rows.force)
        self.fastest = float(np.max(np.abs(np.diff(rows.raw.wanted)))) / rows.raw.T
        self._plain = dict[int | None, np.ndarray]()
        self._signs = dict[tuple[int | None, float], np.ndarray]()
        self._parts = dict[tuple[Lag | None, float], Reduced]()

    def part(self, lag: Lag | None, smoothing: float) -> Reduced:
        """Return the reduced problem of all columns after a low pass, with smoothed directions of the set motion.

        Columns between the corners of a grid are interpolated (by Lagrange, in four points of the logarithm).
        """
        key = lag, smoothing
        if key not in self._parts:
            if lag is None:
                columns = self._columns(None, smoothing)
            else:
                place = math.log((1.0 - lag.pole) / _NODES[0]) / math.log(_NODES[1] / _NODES[0])
                first = min(max(int(place) - 1, 0), _NODES.size - 4)
                at = place - first - np.arange(4.0)
                weights = [np.prod(np.delete(at, k) / (k - np.delete(np.arange(4.0), k))) for k in range(4)]
                near = np.stack([self._columns(first + k, smoothing) for k in range(4)])
                columns = np.einsum("k,kij->ij", np.array(weights), near)
            self._parts[key] = (self.told.reduced if self.told else reduced)(columns, self.rows.force)
        return self._parts[key]

    def _columns(self, node: int | None, smoothing: float) -> np.ndarray:
        """Return all columns after no low pass, or after one of the grid."""
        lag = None if node is None else Lag(1.0 - float(_NODES[node]), 0.0)
        if node not in self._plain:
            self._plain[node] = law_structures.with_drag(self.rows, lag)
        if smoothing == 0.0:
            return self._plain[node]
        if (node, smoothing) not in self._signs:
            signals, columns = replace(self.rows.raw, smoothing=smoothing), self._plain[node].copy()
            places = [k for k, name in enumerate(self.rows.basis.names) if name.startswith("sign")]
            own = np.stack([signals.direction(self.rows.basis.names[k]) for k in places], axis=1)
            columns[:, places] = law_structures.passed(self.rows, lag, own)
            self._signs[node, smoothing] = columns
        return self._signs[node, smoothing]

    def scored(self, structures: Iterable[Structure], smoothing: float) -> list[Scored]:
        """Return all fits of structures, best first."""
        alike = dict[Lag | None, list[Structure]]()
        for one in structures:
            alike.setdefault(one.lag, []).append(one)
        found = [
            self._score(fitted, smoothing)
            for lag, some in alike.items()
            for fitted in self._fits(some, self.part(lag, smoothing))
        ]
        return sorted(found, key=lambda one: one.criterion)

    def _fits(self, structures: list[Structure], part: Reduced) -> list[Fitted]:
        tasks = [law_structures.problem(one, self.rows.basis, part) for one in structures]
        return [one for one in law_structures.fits(structures, tasks) if _acts(one)]

    def _score(self, fitted: Fitted, smoothing: float) -> Scored:
        unknowns = fitted.structure.parameters + (fitted.structure.friction is not None and smoothing > 0.0)
        return Scored(fitted, self.floor.criterion(fitted.ssr, unknowns), replace(self.rows.raw, smoothing=smoothing))

    def scan(self) -> list[Scored]:
        """Return the best fit of the widest cascade for each number of samples and delay, with and without a low pass.

        Twists, and low passes, are those of a grid.
        """
        plain = [_widest(n, d, None, h) for n in _SAMPLES for d in _DELAYS for h in (0.0, *map(float, _BENDS))]
        lags = [Lag(1.0 - float(share), 0.0) for share in _POLES]
        passed = [
            _widest(n, d, lag, h)
            for lag in lags
            for n in _SAMPLES
            for d in (0, 1)
            for h in (0.0, *map(float, _BENDS[::2]))
        ]
        tried = [*plain, *passed]
        best = dict[tuple[int, int, bool, bool], Scored]()
        for one in self.scored([*tried, *(replace(kind, integral=False, shifted=False) for kind in tried)], 0.0):
            kind = one.structure
            best.setdefault((kind.n, kind.d, kind.lag is None, kind.integral), one)
        return list(best.values())

    def refined(self, one: Scored, held: tuple[str, ...] = (), steps: int = _STEPS) -> Scored:
        """Return a fit at its own minimum over twist, loss, low pass, smoothing and 1/Tn, but for those `held`."""
        from scipy.optimize import least_squares  # takes a second to import

        start = {name: value for name, value in _unknowns(one).items() if name not in held}
        if not start:
            return one
        names, place = list(start), np.log(np.array(list(start.values())))
        low, high = np.log(np.array([_RANGES[name] for name in names])).T

        def at(values: np.ndarray) -> tuple[Fitted, float, np.ndarray]:
            unknowns = _unknowns(one) | dict(zip(names, map(float, np.exp(values)), strict=True))
            structure, smoothing, rate = _changed(one, unknowns)
            task = law_structures.problem(structure, self.rows.basis, self.part(structure.lag, smoothing))
            C = task.A + rate * task.B
            sizes = np.linalg.norm(C, axis=0)
            sizes = np.where(sizes > 0.0, sizes, 1.0)
            gains = np.linalg.lstsq(C / sizes, task.y, rcond=1e-13)[0] / sizes
            rest = task.y - C @ gains
            return Fitted(structure, gains, rate, float(rest @ rest)), smoothing, rest

        inside = np.clip(place, low + 1e-6, high - 1e-6)
        scale = 1.0 / math.sqrt(self.floor.ssr + law_search.ROUNDING**2 * self.floor.power)
        found = least_squares(
            lambda values: scale * at(values)[2], inside, bounds=(low, high), diff_step=_STEP, max_nfev=steps
        )
        fitted, smoothing, _ = at(found.x)
        return self._score(fitted, smoothing) if _acts(fitted) else one

    def likeliest(self, known: Iterable[Scored] = ()) -> OtherReadings | None:
        """Return the likeliest cascades with what of twist, low pass and friction feedforward the rows tell.

        `known`: fits to more rows, which are fitted again; without them the whole range is searched.
        """
        starts = list(known) or self.starts()
        if not starts:
            return None
        wide = self.wide(starts)
        found = dict[tuple[Structure, int], Scored]()
        for like in wide[:_KEPT]:
            for one in self._narrowed(like):
                kind = replace(
                    one.structure,
                    lag=one.structure.lag and Lag(0.0, 0.0),
                    twist=_ANY if one.structure.twist.compliance else STIFF,
                )
                found.setdefault((kind, round(math.log(one.fitted.rate or 1.0) / _MERGED)), one)
        # with other samples the twist and the low pass are others, too
        coarse = [self.refined(one, ("smoothing",), _FIRST_STEPS) for one in found.values()]
        fine = [self.refined(one, ("smoothing",)) for one in sorted(coarse, key=_criterion)[:_FINE]]
        fine = sorted((one for one in fine if one.fitted.sensible), key=_criterion)
        if not fine:
            return None
        if fine[0].structure.friction is not None and fine[0].signals.smoothing > 0.0:
            # parts that are not there had biased the smoothing
            best = self.refined(fine[0])
            others = (replace(one, signals=best.signals) for one in fine[1:])
            fine = [best, *(self.refined(one, ("smoothing",)) for one in others)]
            fine = sorted((one for one in fine if one.fitted.sensible), key=_criterion)
        # Kv and 1/Tn may change places in the law as well
        other = self.refined(_exchanged(fine[0]), ("smoothing",)) if fine[0].structure.curved else fine[0]
        if other.fitted.sensible and abs(math.log((other.fitted.rate or 1.0) / (fine[0].fitted.rate or 1.0))) > _TWO:
            fine = sorted([*fine, other], key=_criterion)
        best = fine[0].criterion
        floor = self.floor
        bare = [one for one in fine if one.structure.friction is None]
        # counts at a turn look like friction feedforward
        if self.told is None and bare and floor.misses(fine[0]):
            linear = floor_of(self.rows, self.rows.reduced(), self.rows.basis.motion)
            if not linear.misses(bare[0]) and bare[0].fitted.ssr - floor.ssr < _SLIGHT**2 * floor.power:
                fine, floor, best = bare, linear, bare[0].criterion
        stiff = min((one.criterion for one in fine if one.structure.twist.compliance == 0.0), default=math.inf)
        likely = tuple(one for one in fine if one.criterion < best + _ODD)
        return OtherReadings(self.rows, self.fast, floor, stiff - best, likely, told=self.told)

    def starts(self) -> list[Scored]:
        """Return the best fits of the scan without and with a low pass."""
        scan = sorted(self.scan(), key=_criterion)
        alike = ([one for one in scan if (one.structure.lag is None) == plain][:_STARTS] for plain in (True, False))
        return [one for some in alike for one in some]

    def wide(self, starts: list[Scored]) -> list[Scored]:
        """Return fits of cascades with all parts at their own minima, best first."""
        wide = sorted(map(self.refined, map(_bent, starts)), key=_criterion)
        wide = [one for one in wide if one.criterion < wide[0].criterion + _FAR]
        # Kv and 1/Tn may change places
        wide += [self.refined(_exchanged(one)) for one in wide[:2] if one.structure.curved]
        wide.sort(key=_criterion)
        smooth = self._smoothed(wide[0])
        if smooth is not None:
            held = ("smoothing",)
            wide = [smooth, *(self.refined(replace(one, signals=smooth.signals), held) for one in wide)]
            wide.sort(key=_criterion)
        return wide

    def _smoothed(self, one: Scored) -> Scored | None:
        """Return a fit with the smoothed directions of the set motion, if friction feedforward is in the law."""
        bare = self.scored([replace(one.structure, friction=None)], 0.0)
        if bare and bare[0].criterion < one.criterion + _PLAYS:
            return None
        tried = [again for share in _SMOOTH for again in self.scored([one.structure], float(share) * self.fastest)]
        tried.sort(key=_criterion)
        return self.refined(tried[0]) if tried and tried[0].criterion < one.criterion else None

    def _narrowed(self, like: Scored) -> list[Scored]:
        """Return the likeliest cascades with some parts of a wide one and other samples that are about as late.

        Of those with and without a twist, and of those without friction feedforward, at least one is among them.
        """
        kind, smoothing = like.structure, like.signals.smoothing
        part = self.part(kind.lag, smoothing)
        tried, tasks = list[Structure](), list[law_structures.Problem]()
        for n in _SAMPLES:
            for d in _DELAYS:
                if self.told is None and abs(0.5 * (n - 1) + d - kind.late) > _AS_LATE:
                    continue
                for twist in dict.fromkeys((STIFF, kind.twist)):
                    wide = _widest(n, d, kind.lag, 0.0)
                    wide = replace(wide, twist=twist, drag=twist.compliance > 0.0)
                    task = law_structures.problem(wide, self.rows.basis, part)
                    for structure in _parts(wide):
                        tried.append(structure)
                        tasks.append(_some(task, wide, structure))
        fits = [one for one in law_structures.fits(tried, tasks) if _acts(one)]
        variants = sorted((self._score(one, smoothing) for one in fits), key=_criterion)
        rate = like.fitted.rate or 1.0
        near = [one for one in variants if abs(math.log((one.fitted.rate or 1.0) / rate)) < _MERGED]
        stiff = [one for one in near if one.structure.twist.compliance == 0.0]
        bare = [one for one in near if one.structure.friction is None]
        return list(dict.fromkeys([*near[:_NARROWED], *stiff[:1], *bare[:1]]))


def _criterion(one: Scored) -> float:
    return one.criterion


def _bent(one: Scored) -> Scored:
    """Return a fit with a small twist if it has none."""
    if one.structure.twist.compliance > 0.0:
        return one
    kind = one.structure
    twist = _widest(kind.n, kind.d, kind.lag, float(_BENDS[2])).twist
    return replace(one, fitted=replace(one.fitted, structure=replace(kind, twist=twist)))


def _exchanged(one: Scored) -> Scored:
    return replace(one, fitted=replace(one.fitted, rate=one.fitted["Kp Kv"] / one.fitted["Kp"]))


def _acts(one: Fitted) -> bool:
    """Return True if a fit acts against the error; parts that it has too much may have any sign."""
    return one["Kp Kv"] > 0.0 and one["Kp"] > 0.0


def _widest(n: int, d: int, lag: Lag | None, compliance: float) -> Structure:
    """Return the cascade with all parts and the usual damping, d/k = 2 ζ / ω, ω = 1/√compliance."""
    twist = Twist(compliance, 2.0 * _DAMPING * math.sqrt(compliance)) if compliance else STIFF
    return Structure(
        CASCADE, True, n, d, fed="backward", friction=0, lag=lag, twist=twist, drag=compliance > 0.0, shifted=True
    )


def _parts(wide: Structure) -> Iterator[Structure]:
    """Yield a cascade with and without each of its parts, but for the twist and the low pass."""
    for forward in law_structures.FORWARD:
        for fed in ("", wide.fed):
            for friction in (None, wide.friction):
                for integral in (True, False):
                    for drag in (False, True) if wide.drag else (False,):
                        yield replace(
                            wide,
                            forward=forward,
                            fed=fed,
                            friction=friction,
                            integral=integral,
                            shifted=integral,
                            drag=drag,
                        )


def _some(task: law_structures.Problem, wide: Structure, structure: Structure) -> law_structures.Problem:
    """Return the problem of a structure, which has some parts of a wide one, from that of the wide one."""
    places = [wide.gains.index(name) for name in structure.gains]
    A, B = task.A[:, places], task.B[:, places]
    if structure.forward == "one":
        k, whole = structure.gains.index("Kp"), wide.gains.index("Kp ff")
        A[:, k] += task.A[:, whole]
        B[:, k] += task.B[:, whole]
    return law_structures.Problem(A, B, task.y)


def _unknowns(one: Scored) -> dict[str, float]:
    """Return the unknowns of a fit in which the force is not linear."""
    structure, found = one.structure, dict[str, float]()
    if structure.twist.compliance > 0.0:
        found |= structure.twist._asdict()
    if structure.lag is not None:
        found["share"] = 1.0 - structure.lag.pole
    if structure.friction is not None and one.signals.smoothing > 0.0:
        found["smoothing"] = one.signals.smoothing
    if structure.curved:
        found["rate"] = one.fitted.rate
    return found


def _changed(one: Scored, values: dict[str, float]) -> tuple[Structure, float, float]:
    """Return the structure of a fit with other unknowns, the smoothing of its directions and its 1/Tn."""
    structure = one.structure
    if "compliance" in values:
        structure = replace(structure, twist=Twist(values["compliance"], values["loss"]))
    if structure.lag is not None:
        structure = replace(structure, lag=structure.lag._replace(pole=1.0 - values["share"]))
    return structure, values.get("smoothing", one.signals.smoothing), values.get("rate", 0.0)


def covariance_of(found: OtherReadings, one: Scored) -> np.ndarray:
    """Return the covariance of a fit to slow rows: gains, 1/Tn, and its other unknowns."""
    size, unknowns = one.fitted.values.size, _unknowns(one)

    def columns(values: dict[str, float]) -> np.ndarray:
        structure, smoothing, rate = _changed(one, values)
        rows = found.rows.signed(replace(found.rows.raw, smoothing=smoothing))
        return law_structures.regressors(replace(one.fitted, structure=structure, rate=rate), rows)

    own = columns(unknowns)
    slopes = list[np.ndarray]()
    for name, value in unknowns.items():
        if name != "rate":
            other = columns(unknowns | {name: (1.0 + _STEP) * value})
            slopes.append((other - own)[:, :size] @ one.fitted.values / (_STEP * value))
    rest, every = found.rows.force - own[:, :size] @ one.fitted.values, np.column_stack([own, *slopes])
    # by set motion: of instruments without weights, as the weights are of the same rows and make too little of it;
    # counts at turns repeat with the set motion: they may bend the law as far as they bend least squares, evenly
    if found.told is None or found.biased is None:
        return law_search.covariance_of(every, rest)
    off = difference(one.fitted, found.biased.fitted, every.shape[1])
    every = found.told.columns @ (found.told.columns.T @ every)
    return law_search.covariance_of(every, rest) + np.outer(off, off) / 3.0


def difference(one: Fitted, other: Fitted, size: int) -> np.ndarray:
    """Return by how much the gains and 1/Tn of another fit differ, shape (size,), 0 for what only one of them has.

    Where Kv and 1/Tn have changed places in the other fit, they change them back.
    """
    off, rate, gain = np.zeros(size), other.rate, other["Kp Kv"]
    places = {name: one.structure.gains.index(name) for name in ("Kp Kv", "Kp ff", "Kp") if name in one.structure.gains}
    for name, place in places.items():
        off[place] = (other[name] if name in other.structure.gains else other["Kp"]) - one[name]
    if not (one.structure.curved and other.structure.curved):
        return off
    own = one["Kp Kv"] / one["Kp"]
    if abs(math.log(rate / one.rate)) > abs(math.log(gain / other["Kp"] / one.rate)) and own != one.rate:
        gain, rate = rate * other["Kp"], gain / other["Kp"]
    off[places["Kp Kv"]], off[one.values.size] = gain - one["Kp Kv"], rate - one.rate
    return off

"""Identification of the control law of a log: its structure, its gains with errors, and the ambiguities of one log."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.controller.linuxcnc_pid import LinuxcncPid
from feeddrive.blocks.controller.stock_pid import StockPid
from feeddrive.blocks.families import Feedforward, Law
from feeddrive.blocks.feedforward.friction_feedforward import FrictionFeedforward
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.filter.low_pass import LowPass
from feeddrive.identification import regression
from feeddrive.identification.motion import law_other_readings, law_search, law_structures
from feeddrive.identification.motion.law_other_readings import OtherReadings
from feeddrive.identification.motion.law_rows import LawRows, Signals
from feeddrive.identification.motion.law_search import Floor, Scored, Search
from feeddrive.identification.motion.law_set_position import restored
from feeddrive.identification.motion.law_structures import PID, Fitted, Lag, Structure
from feeddrive.identification.motion.motion_log import MotionLog, count_of
from feeddrive.identification.regression import Estimate, Frame
from feeddrive.language.errors import NotIdentifiableError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Result, Table
from feeddrive.language.text import Text
from feeddrive.loop.control import Control

ALIKE = 6.0  # difference of the criterion up to which two laws explain a log equally well: odds of 1 to 20
WHITE = 0.15  # first autocorrelation that a law may add to that of the free law: dead bands add more than 0.5
NEAR = 0.02  # of the force, that a law near to the one that ran may leave beyond the free law
# of the force, that a free law of the signals may leave: where it leaves more, any law explains as much as it by chance
MOST_NOISE = 0.35
TWIST = 10.0  # of the criterion, that the twist between motor and load must explain
LEAST_ROWS = 1000  # some 20 for each unknown of the free law: with fewer, any law leaves as little in noise
SURE = 0.1  # largest relative error of Kp, or of P and D, with which a law counts as known
MOST_EXCESS = 0.15  # by which a law may leave more than the free law, in squares: right laws leave up to 0.1 more
STEADY = (
    15.0  # of n ln of the sums of squares, by which other gains may explain the slow part of a log better: chance is 5
)
# of n ln of the sums of squares, that a slower position loop must explain to be named as the reason of a refusal: such
# loops explain 150 and more, dead bands and errors of rounded set positions up to 40 by chance (25 foreign logs)
HELD = 60.0
_LIMITED = 0.5  # share of the rows below the limit, above which it is the length of the log that leaves too few rows
_APART = 0.3  # of ln 1/Tn, within which two fits are the same minimum
# relative, or in standard errors, up to which the gains of two fits are those of one law, whose error holds both
_SAME, _SAME_ERRORS = 0.1, 3.0
_SHOWN = 3  # laws that are named
_PER_MM = 1000.0  # LinuxCNC's machine unit in a meter


@dataclass(frozen=True)
class LawReading:
    """One law that explains a log: its name and its gains.

    structure  the structure, with its discrete parts
    estimates  gains with errors
    """

    name: str
    structure: Structure
    estimates: tuple[Estimate, ...]

    def __getitem__(self, name: str) -> Estimate:
        return next(estimate for estimate in self.estimates if estimate.name == name)

    @property
    def doubt(self) -> float:
        """The largest relative error of the gain Kp, or of P and D.

        Kv is not included: if Kv and 1/Tn are nearly equal, the log determines only their sum and product, and the
        error of Kv is unbounded.
        """
        return max(e.error / abs(e.value) for e in self.estimates if e.name in ("Kp", "P", "D"))

    def value(self, name: str, default: float = 0.0) -> float:
        """Return a gain, or `default` if this law has no gain of that name."""
        return next((estimate.value for estimate in self.estimates if estimate.name == name), default)


@dataclass(frozen=True, eq=False, repr=False)
class ControlFit(Result):
    """The control law identified from a log, and other laws that the log cannot distinguish from it.

    readings   laws that explain the log equally well; the first one is used. Kv and 1/Tn may be interchanged
    residual   RMS of the force that the law does not explain, relative to the RMS of the force
    free       relative RMS residual of a free linear law, which is the noise of the log
    near       True if the free law explains clearly more, or the velocity is differenced over so many samples that a
               filter may take their place: a filter or another part of the law was not found
    other_readings  True if the log lacks the readings used by the law: its gains are those of the slow part
    remarks    remarks on parts that the blocks of the library represent only approximately
    tried      (velocity samples, delay) -> residual of the superset of all structures
    """

    name: str
    readings: tuple[LawReading, ...]
    residual: float
    free: float
    near: bool
    other_readings: bool
    smoothing: float
    remarks: tuple[str, ...]
    tried: dict[tuple[int, int], float]
    sample_time: float
    turning: bool = False

    def __getitem__(self, parameter: str) -> Estimate:
        return self.readings[0][parameter]

    @property
    def estimates(self) -> tuple[Estimate, ...]:
        """The gains of the law that is used."""
        return self.readings[0].estimates

    @property
    def structure(self) -> Structure:
        """The structure of the law that is used."""
        return self.readings[0].structure

    @property
    def velocity_samples(self) -> int:
        """The number of samples over which the velocity is differenced."""
        return self.structure.n

    @property
    def delay(self) -> int:
        """The number of samples between the reading used by the law and the command."""
        return self.structure.d

    def table(self) -> Table:
        """Return a table of the gains with their errors."""
        first = self.readings[0]
        title = Text(
            f"{self.name}: {first.name}, velocity over {self.velocity_samples} samples, {self.delay} samples of delay; "
            f"{Quantity(self.residual, 'share'):3} of the force is left, {Quantity(self.free, 'share'):3} by a free law"
        )
        return regression.estimates_table(title, first.estimates)

    def law(self) -> Law:
        """Return the feedback law as a block."""
        return self.control().law

    def control(self, force_limit: float | None = None) -> Control:
        """Return the law, the filter and the feedforward as blocks."""
        return _control(self.readings[0], self.smoothing, self.sample_time, self.turning, force_limit)


def identify_control(log: MotionLog) -> ControlFit:
    """Identify the control law that commanded the force in a log, from its set positions and readings.

        cascade   u = Kp (Kv e + ff v_set - v) (1 + S/Tn) (+ mass a_set + friction sgn v_set)
        PID       u = P e + I S e + D (v_set - v) + FF1 v_set + FF2 a_set (+ friction sgn v_set)

    S is the sum over time; v is differenced over n samples, and all signals are d samples old. The integral of a
    cascade may act on the difference from a reference model, and a first-order low pass may follow the law. No plant is
    involved.

    If the log contains the readings used by the law, all errors are in the force, and least squares is exact for any
    resolution. One constant for each stretch between two saturations absorbs the initial value of the integral and the
    effect of any anti-windup. All n from 1 to 8 and d from 0 to 3 are scanned with the superset of all structures. A
    structure is accepted as the law if its residual exceeds that of a free linear law (13 readings, 9 set positions,
    both sums) by chance only, and no nonlinear function of the signals explains more. A rounded set position is first
    replaced by the smoothest path within the rounding errors. If the law used other readings than those in the log,
    such as those of the motor encoder, the gains are those of the slow part of the log (`law_other_readings`).

    Raises NotIdentifiableError, stating the fraction of the force that a free law explains, if no structure is
    accepted.
    """
    if log.set_position is None:
        raise NotIdentifiableError(
            f"{log.name}: the gains of the loop are not identifiable without the set position: record it next, on the "
            f"same clock"
        )
    signals = Signals.of(log)
    found = _searched(log, signals)
    if found is None and np.mean(free := signals.free(log.force_limit)) > _LIMITED:
        raise NotIdentifiableError(
            f"{log.name}: the log is too short to find its law: {LawRows.of(signals, free).force.size} of its "
            f"{log.position.size} rows can be used, at least {law_search.LEAST_ROWS} are needed; record a longer "
            "motion, with ramps in both directions"
        )
    if found is None:
        raise NotIdentifiableError(
            f"{log.name}: the command is at its limit in nearly all rows, where it does not follow the law: record a "
            "motion of lower acceleration"
        )
    verdict, found = _judged(found, log.force_limit)
    if verdict.other is not None:
        return _with_other_readings(log, found, verdict.other)
    if verdict.silent:
        raise NotIdentifiableError(
            f"{log.name}: even a free linear law of set position and position leaves "
            f"{Quantity(found.floor.left, 'share'):3} of the force, more than {Quantity(MOST_NOISE, 'share'):6}: the "
            "columns are not what the law read and commanded, as those of another encoder; state the law in a machine "
            "file"
        )
    if verdict.law or verdict.near:
        return _fit(log, found, near=verdict.near)
    power = found.floor.power
    best = Quantity(math.sqrt(found.best.fitted.ssr / power), "share")
    free = Quantity(found.floor.left, "share")
    why = "a nonlinear part (dead band, limit) is in it" if verdict.bent else "another part (filter, observer) is in it"
    if verdict.held:
        why = "its position loop runs slower than the log is sampled"
    raise NotIdentifiableError(
        f"{log.name}: no cascade and no PID explains the force: the nearest, {_title(found.best.structure)}, leaves "
        f"{best:3} of it, a free linear law of the same signals {free:3}; "
        f"{why}, or the columns are not what the law read and commanded; state the law in a machine file"
    )


def _searched(log: MotionLog, signals: Signals) -> Search | None:
    """Return the search; a rounded set position is tried both smoothed and as logged."""
    count = count_of(signals.wanted)
    if count <= law_other_readings.SEEN * float(np.max(np.abs(np.diff(signals.wanted)))):
        return law_search.search([signals], log.force_limit)
    # a law that computes with the rounded positions itself leaves less with them
    return law_search.search([restored(signals, count), signals], log.force_limit)


@dataclass(frozen=True)
class _Verdict:
    """The verdict of a search: the law was found, a law close to it, or none.

    bent    True if nonlinear functions of the signals explain part of the residual
    held    True if a position loop that runs every n-th sample explains part of the residual
    silent  True if even a free linear law leaves more than `MOST_NOISE` of the force unexplained
    """

    law: bool
    near: bool
    bent: bool
    other: OtherReadings | None
    silent: bool = False
    held: bool = False


def _judged(found: Search, limit: float | None) -> tuple[_Verdict, Search]:
    """Return the verdict, and the search that it judges."""
    exact = law_search.ROUNDING**2 * found.floor.power
    other = _other(found, limit) if found.best.fitted.ssr > exact else None
    # no model and no low pass makes up for counts of other readings; a twist may be one of these
    if not found.deep and (other is None or not _blue(other, found.floor)):
        found = law_search.deeper(found, whole=other is not None)
    best, floor = found.best, found.floor
    if best.fitted.ssr <= exact:
        return _Verdict(True, False, False, None), found
    rest = found.residual(best)
    added = abs(law_search.correlation(rest)) - abs(floor.memory)
    # a smoothed direction, which the free law lacks, may leave less than it, and another memory
    quiet = added < WHITE or best.fitted.ssr < floor.ssr
    left = math.sqrt(max(0.0, best.fitted.ssr - floor.ssr) / floor.power)
    rows = _rows(found, best)
    slow, bend = law_search.slower(rows, best.fitted, floor), law_search.nonlinear(rows, best.fitted, floor)
    if _held(slow, bend):
        return _Verdict(False, False, False, None, held=True), found
    bent, whole = bend > 0.0, max(slow, bend) <= 0.0
    close = best.fitted.ssr < (1.0 + MOST_EXCESS) * floor.ssr
    explains = found.rows.force.size >= LEAST_ROWS and close and best.criterion < floor.price and not floor.misses(best)
    explains = explains and law_other_readings.differs(found.rows, best) < STEADY
    # where even the free law leaves most of the force, a law that leaves as much is no evidence of one
    silent = floor.left > MOST_NOISE
    if explains and quiet and whole and not silent and (other is None or other.ahead(best) < STEADY):
        return _Verdict(True, False, False, None), found
    if other is not None:
        return _Verdict(False, False, bent, other), found
    near = left < NEAR and quiet and whole and not silent
    return _Verdict(False, near, bent, None, silent), found


def _held(slow: float, bend: float) -> bool:
    """Return True if a slower position loop is the reason of what a law leaves, by what it and a bend explain."""
    return slow > max(bend, HELD)


def _other(found: Search, limit: float | None) -> OtherReadings | None:
    """Return the law for other readings than the log holds, or None if it is not known."""
    # the slow rows have their own smoothed directions
    signals = replace(found.rows.raw, smoothing=0.0)
    other = law_other_readings.with_other_readings(signals, signals.free(limit), blue=found.floor.blue)
    return other if other is not None and _known(other, found.floor) else None


def _known(other: OtherReadings, floor: Floor) -> bool:
    """Return True if a cascade in the slow rows is the law, which used other readings than those in the log.

    Other readings are revealed by their counts, which the force lacks, by those that the force has instead, which
    become blue noise when differenced (in what the free law, `floor`, leaves), or by the twist between motor and load.
    """
    best = other.best
    if other.misses:
        return False
    assert other.counts is not None
    if not _sure(best.fitted, law_other_readings.covariance_of(other, best)):
        return False
    # by its set motion alone a log tells less of what is not in the law
    if other.told is not None:
        return _foreign(other, floor)
    # a law that follows the counts of the log has read them, and what looks like a twist is a filter
    return _foreign(other, floor) or (not other.counts[0].heard and other.twist(TWIST) > TWIST)


def _sure(fitted: Fitted, covariance: np.ndarray) -> bool:
    """Return True if the gains of a cascade have errors of at most `SURE`: Kp and the stiffness, Kp (Kv + 1/Tn).

    Where Kv and 1/Tn are nearly equal, a log tells their sum, not each.
    """
    slopes, sums = np.zeros((2, covariance.shape[0])), np.array([fitted["Kp"], fitted["Kp Kv"]])
    for k, name in enumerate(("Kp", "Kp Kv")):
        slopes[k, fitted.structure.gains.index(name)] = 1.0
    if fitted.structure.curved:
        sums[1] += fitted.rate * fitted["Kp"]
        slopes[1, fitted.structure.gains.index("Kp")] = fitted.rate
        slopes[1, fitted.values.size] = fitted["Kp"]
    return bool(np.all(regression.errors(slopes @ covariance @ slopes.T) < SURE * np.abs(sums)))


def _foreign(other: OtherReadings, floor: Floor) -> bool:
    """Return True if the counts of the log are not in the force, or those of another reading are."""
    assert other.counts is not None
    reading, wanted = other.counts
    return wanted.missing or reading.missing or _blue(other, floor)


def _blue(other: OtherReadings, floor: Floor) -> bool:
    """Return True if the force has counts of another reading than that of the log."""
    assert other.counts is not None
    return floor.blue and not other.counts[0].heard


def _fit(log: MotionLog, found: Search, *, near: bool) -> ControlFit:
    """Return the result with all laws that explain the log as well as the best one."""
    best = found.best
    alike = [one for one in found.scored if one.criterion < best.criterion + ALIKE]
    # a law with one more gain that is 0 within its error is the same law
    alike = [one for one in alike if not any(_holds(one.structure, other.structure) for other in alike)]
    long = all(_long(one.structure) for one in alike)
    readings = list[LawReading]()
    while alike:
        reading, same = _reading(log, found, alike)
        readings.append(reading)
        alike = [one for one in alike if one not in same]
    unsure = min(readings, key=lambda reading: reading.doubt)
    readings = [reading for reading in readings if reading.doubt < SURE]
    if not readings:
        off = regression.NORMAL * unsure.doubt
        length = Quantity(log.position.size * log.sample_time, "s")
        # an interval that holds 0 says nothing of a gain
        tells = (
            Text(f"the log tells its gains to +-{Quantity(off, 'share'):2} only")
            if off < 1.0
            else Text(f"{length:3} with so little motion are too short to tell its gains, not even their signs")
        )
        raise NotIdentifiableError(
            f"{log.name}: {unsure.name} explains the force, but {tells}: record a longer motion with ramps, or state "
            "the law in a machine file"
        )
    ordered = sorted(readings, key=_unusual)
    first = ordered[0]
    near = near or long
    power = found.floor.power
    residual, free = math.sqrt(found.best.fitted.ssr / power), found.floor.left
    return ControlFit(
        log.name,
        tuple(ordered[:_SHOWN]),
        residual,
        free,
        near,
        False,
        found.best.signals.smoothing,
        tuple(_remarks(first, ordered[1:_SHOWN], near, residual, free, long=long)),
        {pair: math.sqrt(ssr / power) for pair, ssr in sorted(found.tried.items())},
        log.sample_time,
        log.turning,
    )


def _with_other_readings(log: MotionLog, found: Search, other: OtherReadings) -> ControlFit:
    readings = list[LawReading]()
    for one in other.likely:
        # fits that differ in samples or feedforward alone are one law; a far 1/Tn is another one
        known = any(
            reading.structure.integral == one.structure.integral and _near(reading, one) for reading in readings
        )
        if known or one.criterion > other.best.criterion + ALIKE or len(readings) == _SHOWN:
            continue
        readings.append(_cascade_reading(log.frame, one.fitted, _covariance_of(other, one), log.sample_time))
    readings.sort(key=lambda one: _unusual(one))
    power = found.floor.power
    remark = Text(
        "the log holds other readings than the law had (another encoder, or rounded values): its gains are those of "
        "the slow part of the log, and the samples of the velocity and of the delay are not known"
    )
    return ControlFit(
        log.name,
        tuple(readings),
        math.sqrt(found.best.fitted.ssr / power),
        found.floor.left,
        False,
        True,
        0.0,
        (remark, *_remarks(readings[0], readings[1:], False, 0.0, 0.0)),
        {pair: math.sqrt(ssr / power) for pair, ssr in sorted(found.tried.items())},
        log.sample_time,
        log.turning,
    )


def _near(reading: LawReading, one: Fitted | Scored) -> bool:
    """Return True if the 1/Tn of a fit and of a law agree to within a third, or if neither has one."""
    one = one.fitted if isinstance(one, Scored) else one
    if reading.structure.curved != one.structure.curved:
        return False
    rate = 1.0 / reading["Tn"].value if reading.structure.curved else 1.0
    return abs(math.log((one.rate or 1.0) / rate)) < _APART


def _covariance_of(other: OtherReadings, one: Scored) -> np.ndarray:
    """Return the covariance of a fit to slow rows, including the scatter among likely fits with other parts."""
    covariance = law_other_readings.covariance_of(other, one)
    near = [
        fit
        for fit in other.likely
        if fit.structure.curved == one.structure.curved
        and abs(math.log((fit.fitted.rate or 1.0) / (one.fitted.rate or 1.0))) < _APART
    ]
    # the noise of the rows that instruments are weighted by is that of one fit: it makes too much of its criterion
    odds = 0.0 if other.told is not None else 0.5
    weights = np.exp(-odds * np.array([fit.criterion - one.criterion for fit in near]))
    weights /= np.sum(weights)
    names = [name for name in ("Kp Kv", "Kp ff", "Kp") if name in one.structure.gains]
    places = [one.structure.gains.index(name) for name in names]
    for weight, fit in zip(weights, (fit.fitted for fit in near), strict=True):
        off = np.zeros(covariance.shape[0])
        for place, name in zip(places, names, strict=True):
            off[place] = (fit[name] if name in fit.structure.gains else fit["Kp"]) - one.fitted[name]
        if one.structure.curved:
            off[one.fitted.values.size] = fit.rate - one.fitted.rate
        covariance = covariance + weight * np.outer(off, off)
    return covariance


# Gains of a law from the coefficients of its columns.


def _reading(log: MotionLog, found: Search, alike: Sequence[Scored]) -> tuple[LawReading, list[Scored]]:
    """Return the law of the first structure with its gains, and all structures that are the same law."""
    one, rows = alike[0], _rows(found, alike[0])
    columns = law_structures.regressors(one.fitted, rows)
    columns = np.column_stack([columns, *_slopes(rows, one, columns)])
    covariance = law_search.covariance_of(columns, found.residual(one)) + _by_set_position(rows, one.fitted, columns)
    errors = regression.errors(covariance)
    same = [one, *(other for other in alike[1:] if _same(one.fitted, other.fitted, errors))]
    covariance = covariance + _scatter(one, same, columns.shape[1])
    if one.structure.family == PID:
        return _pid_reading(log.frame, one.fitted, covariance), same
    return _cascade_reading(log.frame, one.fitted, covariance, log.sample_time), same


def _by_set_position(rows: LawRows, fitted: Fitted, columns: np.ndarray) -> np.ndarray:
    """Return the covariance of the coefficients by the errors of a set position that was restored."""
    off = law_search.by_set_position(rows, fitted)
    moved = off @ columns @ regression.inverse_gram(columns)
    return moved.T @ moved / max(1, len(off))


def _holds(structure: Structure, other: Structure) -> bool:
    """Return True if a structure is the other one with further parts."""
    if structure.parameters <= other.parameters or structure.family != other.family:
        return False
    if any(getattr(structure, name) != getattr(other, name) for name in ("n", "d", "older")):
        return False
    parts = (
        (structure.integral, other.integral),
        (structure.forward == "free", other.forward == "free"),
        (bool(structure.fed), bool(other.fed)),
        (structure.friction is not None, other.friction is not None),
        (structure.sides, other.sides),
        (structure.model is not None, other.model is not None),
        (structure.lag is not None, other.lag is not None),
        (structure.eased is not None, other.eased is not None),
        (structure.shifted, other.shifted),
    )
    return all(own or not its for own, its in parts)


def _same(one: Fitted, other: Fitted, errors: np.ndarray) -> bool:
    """Return True if two fits have the same gains: their samples, delays and further parts may differ."""
    if one.structure.family != other.structure.family or one.structure.integral != other.structure.integral:
        return False

    def near(value: float, its: float, error: float) -> bool:
        return abs(its - value) < max(_SAME * abs(value), _SAME_ERRORS * error)

    gains = one.structure.gains
    core = [name for name in ("Kp Kv", "Kp", "P", "I", "D") if name in gains]
    alike = all(near(one[name], other[name], errors[gains.index(name)]) for name in core)
    return alike and (not one.structure.curved or near(one.rate, other.rate, errors[one.values.size]))


def _rows(found: Search, one: Scored) -> LawRows:
    """Return the rows with the direction of the set motion smoothed as in a fit."""
    return found.rows if one.signals is found.rows.raw else found.rows.signed(one.signals)


def _slopes(rows: LawRows, one: Scored, columns: np.ndarray) -> list[np.ndarray]:
    """Return the derivatives of the force with respect to what is not a gain: smoothing, then a rate or a pole."""
    fitted, structure, size = one.fitted, one.fitted.structure, one.fitted.values.size
    step, slopes = 1e-3, list[np.ndarray]()

    def slope(other: Structure, rows: LawRows, step: float) -> np.ndarray:
        moved = law_structures.regressors(replace(fitted, structure=other), rows)
        return (moved[:, :size] - columns[:, :size]) @ fitted.values / step

    if structure.friction is not None and one.signals.smoothing > 0.0:
        wider = replace(one.signals, smoothing=(1.0 + step) * one.signals.smoothing)
        slopes.append(slope(structure, rows.signed(wider), step))
    if structure.model is not None:
        step *= structure.model.rate
        slopes.append(
            slope(replace(structure, model=structure.model._replace(rate=structure.model.rate + step)), rows, step)
        )
    for name in ("lag", "eased"):
        lag: Lag | None = getattr(structure, name)
        if lag is not None:
            step *= 1.0 - lag.pole
            slopes.append(slope(replace(structure, **{name: lag._replace(pole=lag.pole + step)}), rows, step))
    return slopes


def _scatter(one: Scored, alike: Sequence[Scored], size: int) -> np.ndarray:
    """Return the covariance of the coefficients among structures with the same gains.

    The log may not determine their samples, delays and filters exactly; each structure is weighted by its likelihood.
    """
    names = one.structure.gains
    same = [other for other in alike if other.structure.gains == names]
    weights = np.exp(-0.5 * (np.array([other.criterion for other in same]) - one.criterion))
    weights /= np.sum(weights)
    total = np.zeros((size, size))
    for weight, other in zip(weights, same, strict=True):
        off = np.zeros(size)
        off[: one.fitted.values.size] = other.fitted.values - one.fitted.values
        if one.structure.curved:
            off[one.fitted.values.size] = other.fitted.rate - one.fitted.rate
        total += weight * np.outer(off, off)
    return total


def _cascade_reading(frame: Frame, fitted: Fitted, covariance: np.ndarray, T: float) -> LawReading:
    """Return the gains of a cascade, with errors by the delta method."""
    structure, size = fitted.structure, covariance.shape[0]
    gains, values = structure.gains, fitted.values
    a, c = gains.index("Kp Kv"), gains.index("Kp")
    Kp = float(values[c])

    def ratio(k: int) -> tuple[float, np.ndarray]:
        slope = np.zeros(size)
        slope[k], slope[c] = 1.0 / Kp, -values[k] / Kp**2
        return float(values[k] / Kp), slope

    def plain(k: int) -> tuple[float, np.ndarray]:
        slope = np.zeros(size)
        slope[k] = 1.0
        return float(values[k]), slope

    rows: list[tuple[str, str, tuple[float, np.ndarray]]] = [("Kv", "1/s", ratio(a)), ("Kp", frame.viscous, plain(c))]
    if structure.integral:
        slope = np.zeros(size)
        slope[values.size] = -1.0 / fitted.rate**2
        rows.append(("Tn", "s", (1.0 / fitted.rate, slope)))
    if structure.forward == "free":
        rows.append(("velocity_feedforward", "", ratio(gains.index("Kp ff"))))
    if structure.model is not None:
        slope = np.zeros(size)
        mass = T * Kp / structure.model.rate
        slope[c], slope[-1] = mass / Kp, -mass / structure.model.rate
        rows.append(("model_mass", frame.inertia, (mass, slope)))
    rows += _others(frame, fitted, plain, size, T)
    return LawReading(_title(structure), structure, _estimates(rows, covariance))


def _pid_reading(frame: Frame, fitted: Fitted, covariance: np.ndarray) -> LawReading:
    size, gains = covariance.shape[0], fitted.structure.gains

    def plain(k: int) -> tuple[float, np.ndarray]:
        slope = np.zeros(size)
        slope[k] = 1.0
        return float(fitted.values[k]), slope

    stiff = f"{frame.force}/{frame.position}"
    units = {"P": stiff, "I": f"{stiff}/s", "D": frame.viscous, "FF1": frame.viscous}
    rows = [(name, units[name], plain(gains.index(name))) for name in gains if name in units]
    rows += _others(frame, fitted, plain, size, 1.0, fed="FF2")
    return LawReading(_title(fitted.structure), fitted.structure, _estimates(rows, covariance))


def _others(
    frame: Frame, fitted: Fitted, plain: object, size: int, T: float, fed: str = "mass"
) -> list[tuple[str, str, tuple[float, np.ndarray]]]:
    structure, rows = fitted.structure, list[tuple[str, str, tuple[float, np.ndarray]]]()
    if structure.fed:
        rows.append((fed, frame.inertia, plain(structure.gains.index("mass"))))  # type: ignore[operator]
    if structure.friction is not None:
        rows.append(("friction", frame.force, plain(structure.gains.index("friction"))))  # type: ignore[operator]
    if structure.sides:
        rows.append(("difference", frame.force, plain(structure.gains.index("difference"))))  # type: ignore[operator]
    if structure.lag is not None and fitted.structure.family != PID:
        pole = structure.lag.pole
        tau = -T / math.log(pole)
        slope = np.zeros(size)
        slope[-1] = T / (pole * math.log(pole) ** 2)
        rows.append(("time_constant", "s", (tau, slope)))
    if structure.eased is not None:
        # the block passes on T/(lag + T) of a change
        share = 1.0 - structure.eased.pole
        slope = np.zeros(size)
        slope[-1] = T / share**2
        rows.append(("velocity_lag", "s", (T * structure.eased.pole / share, slope)))
    return rows


def _estimates(
    rows: Sequence[tuple[str, str, tuple[float, np.ndarray]]], covariance: np.ndarray
) -> tuple[Estimate, ...]:
    made = []
    for name, unit, (value, slope) in rows:
        error = math.sqrt(max(0.0, float(slope @ covariance @ slope)))
        made.append(Estimate(name, value, unit, error, error))
    return tuple(made)


def _unusual(reading: LawReading) -> tuple[bool, bool, bool, bool]:
    """Return a sort key that puts the more usual of equally good laws first.

    Usual are a PID if the setpoint is older than the reading or velocity feedforward is free, otherwise a cascade, and
    a cascade whose position loop is the slower one.  A cascade whose setpoint is older than its reading comes later,
    and so does a velocity over so many samples that a low pass would have the same effect.
    """
    structure = reading.structure
    pid = structure.family == PID
    plain = pid != (structure.older > 0 or structure.forward == "free")
    swapped = not pid and structure.integral and reading["Kv"].value * reading["Tn"].value > 1.0
    return plain, not pid and structure.older > 0, structure.late > law_search.MOST_LAG, swapped


def _long(structure: Structure) -> bool:
    """Return True if the velocity is differenced over so many samples that noise may hide a filter in their place."""
    return 0.5 * (structure.n - 1) > law_search.MOST_LAG


def _title(structure: Structure) -> str:
    """Return the name of a structure."""
    if structure.family == PID:
        parts = ["PID"]
        parts += ["FF1"] if structure.forward == "free" else []
        parts += ["FF2"] if structure.fed else []
    else:
        parts = ["P-PI cascade" if structure.integral else "P-P cascade"]
        parts += ["reference model"] if structure.model is not None else []
        parts += ["acceleration feedforward"] if structure.fed else []
    parts += ["friction feedforward"] if structure.friction is not None else []
    parts += ["low pass"] if structure.lag is not None else []
    parts += ["low pass of the velocity"] if structure.eased is not None else []
    return parts[0] if len(parts) == 1 else f"{parts[0]} with {' and '.join(parts[1:])}"


def _remarks(
    first: LawReading, others: Sequence[LawReading], near: bool, residual: float, free: float, *, long: bool = False
) -> list[str]:
    remarks = list[str]()
    if long:
        remarks.append(
            f"the law is near to {first.name}: a velocity over {first.structure.n} samples may be a filter or another "
            "part of the law that noise hides, and the gains are then others; state the law in a machine file if you "
            "know it"
        )
    elif near:
        remarks.append(
            Text(
                f"the law is near to {first.name}, which leaves {Quantity(residual, 'share'):3} of the force, where a "
                f"free linear law leaves {Quantity(free, 'share'):3}: a filter or another part of it was not found"
            )
        )
    for other in others:
        gains = ", ".join(f"{e.name} {Quantity(e.value, e.unit, e.error)}" for e in other.estimates)
        remarks.append(Text(f"this log cannot tell {first.name} from {other.name} with {gains}: both make its force"))
    structure = first.structure
    if structure.family == PID and structure.n > 1:
        remarks.append(
            Text(
                f"the velocity of the PID is differenced over {structure.n} samples, that of the block over one: its "
                f"lag is {Quantity(0.5 * (structure.n - 1)):3} samples shorter"
            )
        )
    if structure.model is not None and not structure.model.inside:
        remarks.append(
            "the reference model is a lag of first order behind a dead time; the block's model has the dead time "
            "within its loop"
        )
    if structure.lag is not None and structure.lag.old == 0.0:
        remarks.append("the low pass of the law is half a sample faster than that of the block")
    if structure.older and structure.family != PID:
        remarks.append("the set position is one sample older than the reading: the feedforward is less by Kv T for it")
    return remarks


# Blocks of a law.


def _control(reading: LawReading, smoothing: float, T: float, turning: bool, force_limit: float | None) -> Control:
    """Return the law, its feedforward and its filter as blocks."""
    structure = reading.structure
    feedforward = list[Feedforward]()
    mass, Kp = reading.value("mass"), reading.value("Kp")
    law: Law
    if structure.family == PID:
        law = _stock(reading, turning)
    else:
        share = {"one": 1.0, "none": 0.0}.get(structure.forward, reading.value("velocity_feedforward"))
        # e of a setpoint one sample older is less by v_set T
        share -= reading.value("Kv") * T * structure.older
        # half a sample of the planner's own velocity is an acceleration
        mass += 0.5 * T * share * Kp if structure.central else 0.0
        law = CascadePPI(
            Kv=reading.value("Kv"),
            Kp=Kp,
            Tn=reading.value("Tn") if structure.integral else None,
            velocity_feedforward=max(0.0, share),
            velocity_samples=structure.n,
            velocity_lag=reading.value("velocity_lag") if structure.eased is not None else None,
            model_mass=reading.value("model_mass") if structure.model is not None else None,
            model_samples=1 if structure.model is None else structure.model.samples,
        )
        if mass > 0.0:
            feedforward.append(Inertia(mass=mass))
    level, half = reading.value("friction"), reading.value("difference")
    if level > abs(half):
        smooth = smoothing if smoothing > 0.0 else None
        feedforward.append(
            FrictionFeedforward(coulomb_positive=level + half, coulomb_negative=level - half, smoothing=smooth)
        )
    filters = ()
    if structure.lag is not None:
        pole = structure.lag.pole
        w = (1.0 - pole) / (1.0 + pole)
        filters = (LowPass(frequency=math.atan(w) / (math.pi * T)),)
    return Control(law=law, feedforward=tuple(feedforward), filters=filters, force_limit=force_limit)


def _stock(reading: LawReading, turning: bool) -> LinuxcncPid:
    """Return LinuxCNC's pid with these gains, in mm or degrees."""
    units = math.degrees(1.0) if turning else _PER_MM
    gains = {
        f"{name}gain" if len(name) == 1 else name: reading.value(name) / units for name in ("P", "I", "D", "FF1", "FF2")
    }
    pid = StockPid(**gains, error_previous_target=reading.structure.older > 0)
    return LinuxcncPid(position=pid, units=units)

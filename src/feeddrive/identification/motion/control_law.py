"""A check of a stated control law against the force of a log."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from feeddrive.analysis.replay import commanded
from feeddrive.identification import regression
from feeddrive.identification.motion.law_rows import MOST_DELAY
from feeddrive.identification.motion.motion_log import MotionLog, count_of, decimated
from feeddrive.identification.motion.rigid import LEAST_INDEPENDENT, covariance_of
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column, Table
from feeddrive.language.text import Text, joined
from feeddrive.loop.control import Control

LARGEST = 0.05  # largest unexplained share of the force for which a law counts as the one that ran

# A check of a law against a log: its command at the log's own readings is compared with the force of the log.

# of a gain: where one is 20 % wrong, the mass of the closed loop is up to 10 % off; of half of it, 5 %
MOST_OFF = 0.1
SURE = 3.0  # standard errors
_ROW = 0.01  # s: rows of the inverse dynamics, and their low pass
# s at the start, where filters and differences of the law lack the past of those in the drive
_SKIP = 0.05
_STEP = 1e-3  # of a parameter, for its slope
_ACTS = 1e-3  # of the force: a parameter that makes less of it has no part in the log
_DRAWN = 4  # sets of readings with other places within their counts
_PRESENT = 0.01  # share of what counts could make below which the log does not hold it
# Share of the rows with an added force, at most: of 120 logs with steps of force, none with the law that ran is refused
# at 0.6 and 25 at 0.5; of those with Kp 20 % too small none is taken at 0.6, and 6 at 0.7.
_SELDOM = 0.6
_STEPS, _MOST_STEP = 6, 0.5  # of Gauss and Newton, and the largest one
_LOWER = 0.999  # of the RMS that is left: a step that lowers it by less is the last
_UNLIKE = 0.5  # share of what is left that no other numbers of the law explain, at least
_SHOWN = 0.1  # share of a column in the other rows, at least


class Gain(NamedTuple):
    """A gain of a controller: stated value, value required by the log, and the standard error of the latter."""

    name: str
    stated: float
    needed: float
    error: float

    @property
    def off(self) -> float:
        """The part of the relative error of the stated value that exceeds `SURE` standard errors, or 0."""
        return max(0.0, abs(self.needed - self.stated) - SURE * self.error) / abs(self.stated)

    @property
    def unseen(self) -> bool:
        """True if the log cannot reveal a relative error of `MOST_OFF`."""
        return SURE * self.error > MOST_OFF * abs(self.stated)


@dataclass(frozen=True, eq=False)
class LawCheck:
    """The check of a law against a log's force; residuals are relative to the RMS of this force, in rows of 10 ms.

    left    residual with the stated gains, without the effect of quantization
    remains residual with the fitted gains
    counts  effect of quantization of the readings, to the extent that it is present in the log
    gains   the controller gains that affect the force in this log
    delay   delay of the log's force relative to that of the law, samples
    added   fraction of the rows in which another force was added, if the law explains all other rows; otherwise 0
    """

    name: str
    left: float
    remains: float
    counts: float
    gains: tuple[Gain, ...]
    delay: int
    added: float = 0.0

    @property
    def wrong(self) -> str:
        """The way in which the log contradicts the law; empty if it does not, or if an added force explains it."""
        return "" if self.added else self._against

    @property
    def disagrees(self) -> bool:
        """True if the logged force is not the command of the law alone."""
        return bool(self._against)

    @property
    def proves(self) -> bool:
        """True if the law reproduces the force, possibly with other gains; force and position then share one clock."""
        return self.remains < LARGEST and bool(self.gains)

    @property
    def _against(self) -> str:
        off = sorted((gain for gain in self.gains if gain.off > MOST_OFF), key=lambda gain: -gain.off)
        if off:
            values = joined(", ", (f"{gain.name} = {Quantity(gain.needed, error=gain.error)}" for gain in off[:_NAMED]))
            stated = joined(", ", (f"{Quantity(gain.stated)}" for gain in off[:_NAMED]))
            return Text(
                f"what the law commands at the log's own readings meets its force best with {values}, where {stated} "
                f"{'is' if len(off) == 1 else 'are'} stated{_SO}"
            )
        if self.left > LARGEST:
            return Text(
                f"what the law commands at the log's own readings leaves {Quantity(self.left, 'share'):3} of its force "
                "beyond what the counts of the readings make, where a law that ran leaves "
                f"{Quantity(LARGEST, 'share'):6} at most{_SO}"
            )
        return ""

    @property
    def unseen(self) -> tuple[str, ...]:
        """The names of the gains that the log cannot verify."""
        return tuple(gain.name for gain in self.gains if gain.unseen)

    def table(self) -> Table:
        """Return a table of the stated gains and the gains required by the log."""
        rows = [
            [gain.name, gain.stated, Quantity(gain.needed, error=gain.error, form="5"), gain.error]
            for gain in self.gains
        ]
        title = Text(
            f"{self.name}: the law at the log's own readings; {Quantity(self.left, 'share'):3} of the force is left, "
            f"counts make {Quantity(self.counts, 'share'):3}"
        )
        columns = [
            "parameter",
            Column("stated", form="5"),
            Column("the log needs", form="5"),
            Column("standard error", form="2"),
        ]
        return Table(title, columns, rows)


_NAMED = 3  # gains that a sentence names
_SO = ": it is not the law that ran, or the columns are not the force that it commanded and the position that it read"


def check_law(control: Control, log: MotionLog, *, apart: np.ndarray | None = None, place: str = "control") -> LawCheck:
    """Compare the force of a log with the command of a controller for the setpoints and readings of the log.

        y = F - u(x_set, x) = Σ (θ'/θ - 1) θ ∂u/∂θ + constant + e,   θ the stated gains, θ' those required by the log

    All signals are low-pass filtered and decimated to rows of 10 ms as in the inverse dynamics, since a
    velocity gain turns quantization into a force of much higher frequency than the motion.  The constant is the initial
    state of an integrator.  Plant and friction are not involved, so that disturbances do not affect the result.  F may
    be delayed by up to three samples relative to u.

    If the log contains rounded readings instead of those used by the law, each reading has an error of up to half a
    count.  The effect of such errors on y and θ' is simulated with uniformly distributed errors.  It is then multiplied
    by the fraction of it that is present in the log: the RMS of e(k) - e(k-1) in the log over the same RMS in the
    simulation, at most 1.  This fraction is 0 for a drive that logs the readings used by its law.

    A force that was added to the command intermittently is distinguished from a wrong law (see `_added`).

    apart  position of the motor minus that of the load, m, shape (n,), for a law that reads both
    place  path of the controller in its machine file
    """
    assert log.set_position is not None
    rows = _Rows(log, apart)
    plain = rows.answers(control, log.position)
    force = rows.reduced(log.force)
    size = float(np.std(force))
    slopes = rows.slopes(control, plain, log.position, None)
    slopes = {name: slope for name, slope in slopes.items() if float(np.std(rows.reduced(slope))) > _ACTS * size}
    names = _independent({name: rows.reduced(slope) for name, slope in slopes.items()})
    raw = np.array([slopes[name] for name in names]).reshape(len(names), -1)
    linear = [rows.linear(plain, raw, d) for d in range(MOST_DELAY + 1)]
    # the nonlinear fit simulates the law for each gain: only for the two delays that the linear one prefers
    likely = sorted(range(MOST_DELAY + 1), key=lambda d: linear[d])[:2]
    fit = min((_Fit.of(rows, control, names, plain, raw, d) for d in likely), key=lambda fit: fit.remains)
    delay, y = fit.delay, force - rows.reduced(plain, fit.delay)
    counts, error = _by_counts(rows, fit, names)
    left = float(np.sqrt(max(0.0, float(np.var(y)) - counts**2)))
    gains = tuple(
        Gain(f"{place}.{name}", float(tree.get(control, name)), float(tree.get(fit.control, name)), float(e))
        for name, e in zip(names, error, strict=True)
    )
    integral = rows.reduced(np.cumsum(log.set_position - log.position), delay)
    remains = float(np.std(force - rows.reduced(fit.plain, delay)))
    unlike = remains > _UNLIKE * float(np.std(y))
    added = _added(np.vstack([rows.reduced(raw, delay), integral]), y, size, counts) if unlike else 0.0
    return LawCheck(log.name, left / size, remains / size, counts / size, gains, delay, added)


def _added(columns: np.ndarray, y: np.ndarray, size: float, counts: float) -> float:
    """Return the fraction of the rows in which another force was added, or 0 unless the other rows support the law.

    The other rows are the largest group of rows with y in a band as wide as the residual of a correct law; a median
    would fail if the added force acts in half of the rows. Apart from quantization they must concentrate in the middle
    of the band, whereas a law with another integral would spread them over the whole band. For every gain these rows
    must contain at least a tenth of the power of its column and agree with its stated value. The integral of the
    following error, which is the last column, must have no effect in them.
    """
    width = 2.0 * (LARGEST * size + SURE * counts)
    ordered = np.sort(y)
    lowest = ordered[np.argmax(np.searchsorted(ordered, ordered + width, "right") - np.arange(y.size))]
    away = (y < lowest) | (y > lowest + width)
    if np.mean(away) > _SELDOM or not np.any(away):
        return 0.0
    if float(np.var(y[~away])) > counts**2 + (0.5 * LARGEST * size) ** 2:
        return 0.0
    off = _solved(columns[:, ~away], y[~away])[:-1]
    seen = np.sum(columns[:-1, ~away] ** 2, axis=1) > _SHOWN * np.sum(columns[:-1] ** 2, axis=1)
    other = abs(off[-1]) * float(np.std(columns[-1])) > LARGEST * size
    return 0.0 if other or not np.all(seen & (np.abs(off[:-1]) < MOST_OFF)) else float(np.mean(away))


def _by_counts(rows: _Rows, fit: _Fit, names: tuple[str, ...]) -> tuple[float, np.ndarray]:
    """Return the RMS in N of the effect of quantization on y, and standard errors of the gains that include it."""
    force, values = rows.reduced(rows.log.force), np.array([float(tree.get(fit.control, name)) for name in names])
    drawn = list(_readings(rows.log))
    others = [rows.answers(fit.control, reading) for reading in drawn]
    changes = [rows.cut(other - fit.plain, fit.delay) for other in others]
    quick = np.sqrt(np.mean([np.var(np.diff(change)) for change in changes])) if changes else 0.0
    whole = rows.cut(rows.log.force) - rows.cut(fit.plain, fit.delay)
    present = min(1.0, float(np.std(np.diff(whole)) / quick)) if quick > 0.0 else 0.0
    if present < _PRESENT:
        return 0.0, np.abs(values) * fit.errors
    counts = present * float(np.sqrt(np.mean([np.var(rows.reduced(other - fit.plain, fit.delay)) for other in others])))
    shifts = []
    for reading, other in zip(drawn, others, strict=True):
        columns = rows.reduced(rows.columns(fit.control, other, reading, names), fit.delay)
        shifts.append(_solved(columns, force - rows.reduced(other, fit.delay))[:-1])
    return counts, np.abs(values) * np.sqrt(fit.errors**2 + present**2 * np.mean(np.square(shifts), axis=0))


class _Fit(NamedTuple):
    """A controller with the gains required by a log, its command at each sample, and the relative errors of the gains.

    remains  RMS of the residual over all samples, N
    """

    control: Control
    plain: np.ndarray
    errors: np.ndarray
    delay: int
    remains: float

    @classmethod
    def of(
        cls, rows: _Rows, control: Control, names: tuple[str, ...], plain: np.ndarray, raw: np.ndarray, delay: int
    ) -> _Fit:
        """Fit the gains by Gauss-Newton steps, since limits and dead bands make the force nonlinear in them."""
        force = rows.reduced(rows.log.force)
        y = force - rows.reduced(plain, delay)
        for _ in range(_STEPS):
            change = np.clip(_solved(rows.reduced(raw, delay), y)[:-1], -_MOST_STEP, _MOST_STEP)
            values = {name: float(tree.get(control, name)) * (1.0 + c) for name, c in zip(names, change, strict=True)}
            try:
                tried = tree.vary(control, values)
            # the step leads beyond a bound of a gain
            except ParameterError:
                break
            answer = rows.answers(tried, rows.log.position)
            left = force - rows.reduced(answer, delay)
            # negated, so that NaN ends the fit, too
            if not np.std(left) < _LOWER * np.std(y):
                break
            control, plain, y = tried, answer, left
            raw = rows.columns(control, plain, rows.log.position, names)
        columns = rows.reduced(raw, delay)
        # a limit that the new gains no longer reach has no effect on the command
        acts = np.std(columns, axis=1) > 0.0
        off = np.full(len(names), np.inf)
        wide = np.vstack([columns[acts], np.ones(y.size)]).T
        off[acts] = regression.errors(covariance_of(wide, y - wide @ _solved(columns[acts], y)))[:-1]
        whole = rows.cut(rows.log.force) - rows.cut(plain, delay)
        return cls(control, plain, off, delay, float(np.std(whole)))


def _solved(columns: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.linalg.lstsq(np.vstack([columns, np.ones(y.size)]).T, y, rcond=None)[0]


@dataclass(frozen=True, eq=False)
class _Rows:
    """A log, its decimated rows, and the position of the motor relative to the load (m) if the law reads both."""

    log: MotionLog
    apart: np.ndarray | None

    def cut(self, values: np.ndarray, delay: int = 0) -> np.ndarray:
        """Return a signal delayed by `delay` samples, without the skipped samples at the start of the last axis."""
        skip = max(MOST_DELAY, round(_SKIP / self.log.sample_time))
        return values[..., skip - delay : values.shape[-1] - delay]

    def reduced(self, values: np.ndarray, delay: int = 0) -> np.ndarray:
        """Return a signal decimated to rows of 10 ms."""
        return decimated(self.cut(values, delay), max(1, round(_ROW / self.log.sample_time)))

    def answers(self, control: Control, reading: np.ndarray) -> np.ndarray:
        """Return the command of a controller at each sample, for these load readings."""
        log = self.log
        assert log.set_position is not None
        motor = None if self.apart is None else reading + self.apart
        return commanded(control, log.sample_time, log.set_position, reading, log.force, motor)

    def linear(self, plain: np.ndarray, raw: np.ndarray, delay: int) -> float:
        """Return the RMS in N of the residual over all samples, for gains fitted to the decimated rows."""
        values = _solved(self.reduced(raw, delay), self.reduced(self.log.force) - self.reduced(plain, delay))
        whole = self.cut(self.log.force) - self.cut(plain, delay) - values[:-1] @ self.cut(raw, delay)
        return float(np.std(whole))

    def columns(self, control: Control, plain: np.ndarray, reading: np.ndarray, names: tuple[str, ...]) -> np.ndarray:
        """Return θ ∂u/∂θ of the named gains, shape (gains, samples), which is 0 for a gain at its bound."""
        slopes = self.slopes(control, plain, reading, names)
        return np.array([slopes.get(name, np.zeros(plain.size)) for name in names]).reshape(len(names), plain.size)

    def slopes(
        self, control: Control, plain: np.ndarray, reading: np.ndarray, names: tuple[str, ...] | None
    ) -> dict[str, np.ndarray]:
        """Return θ ∂u/∂θ of gains of a controller by name, over all samples; `plain` is the nominal command."""
        return {name: (self.answers(varied, reading) - plain) / _STEP for name, varied in _varied(control, names)}


def _varied(control: Control, names: tuple[str, ...] | None) -> Iterator[tuple[str, Control]]:
    """Yield the nonzero gains in `names` (None: all), each with a copy of the controller in which it is increased."""
    for name, value in tree.parameters(control).items():
        wanted = not name.startswith("guard.") if names is None else name in names
        if wanted and isinstance(value, float) and value != 0.0:
            try:
                varied = tree.vary(control, {name: value * (1.0 + _STEP)})
            # a share of 1 is at its bound and cannot be increased
            except ParameterError:
                continue
            yield name, varied


def _independent(columns: dict[str, np.ndarray]) -> tuple[str, ...]:
    """Return the names of linearly independent columns; nested parameters are preferred to common factors."""
    kept: list[str] = []
    for name in sorted(columns, key=lambda key: -key.count(".")):
        column = columns[name] - np.mean(columns[name])
        if kept:
            others = np.vstack([*(columns[other] for other in kept), np.ones(column.size)]).T
            column = column - others @ np.linalg.lstsq(others, column, rcond=None)[0]
        if float(np.std(column)) > LEAST_INDEPENDENT * float(np.std(columns[name])):
            kept.append(name)
    return tuple(name for name in columns if name in kept)


def _readings(log: MotionLog) -> Iterator[np.ndarray]:
    """Yield readings plus random errors of up to half a count; an error is constant until the count changes."""
    # a fixed seed: the same log gives the same errors
    count, random = count_of(log.position), np.random.default_rng(0)
    since = np.cumsum(np.diff(log.position, prepend=log.position[0]) != 0.0)
    for _ in range(_DRAWN if count > 0.0 else 0):
        yield log.position + count * random.uniform(-0.5, 0.5, int(since[-1]) + 1)[since]

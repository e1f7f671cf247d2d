"""Identification of a drive from several logs of one axis; the errors of the pooled values include their scatter."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from feeddrive.blocks.families import Law
from feeddrive.identification.motion.control_law import MOST_OFF, SURE
from feeddrive.identification.motion.identify import (
    USABLE_MASS,
    Identified,
    identify_motion,
    is_richer,
    with_rigid,
    within,
)
from feeddrive.identification.motion.identify_law import ControlFit, LawReading
from feeddrive.identification.motion.motion_log import MotionLog, Preparation
from feeddrive.identification.motion.rigid import MORE_RAMPS, SURE_MASS, RigidFit, identify_rigid
from feeddrive.identification.regression import NORMAL, Estimate, estimates_table
from feeddrive.identification.second_source import LOAD, MASS, Cause, Ratio, causes_of, said
from feeddrive.language import tree
from feeddrive.language.errors import LogError, ParameterError
from feeddrive.language.judgment import Advice, Judgment
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Cell, Column, Result, Table
from feeddrive.language.text import Text, joined
from feeddrive.loop.loop import Loop

LEAST_LOGS = 2
# times by which the masses of two logs of one axis may differ: a workpiece on the table makes 20 %, and the pooled mass
# of two logs that are further apart is not known to 10 % whatever their errors are
OTHER_AXIS = 1.25
_HALVINGS = 60  # of the interval of the scatter: its rounding is then far below any error
_CHANCE = 0.05  # of logs that agree: the probability of a larger disagreement below which they are said to differ
_NEVER = 1e-4  # chance below which only that is shown: errors are not known well enough to tell it
_CERTAIN = 1e9  # degrees of freedom of a known scatter
_LAW = "law "  # before the names of gains beside mass and friction


@dataclass(frozen=True)
class LogValues:
    """Values identified from one log other than by a `RigidFit`."""

    name: str
    estimates: tuple[Estimate, ...]

    def __getitem__(self, parameter: str) -> Estimate:
        return next(estimate for estimate in self.estimates if estimate.name == parameter)


LogFit: TypeAlias = RigidFit | LogValues


@dataclass(frozen=True, eq=False, repr=False)
class PooledFit(Result):
    """Values of a drive from several logs of the same axis.

    fits       the fit of each log, with the same friction model
    estimates  the pooled values; ±1.96 `error` is a 95 % interval, `ols` does not include the scatter
    scatter    standard deviation of each parameter from log to log, beyond the errors of the fits
    chance     probability of a larger disagreement if the true value is the same in all logs
    apart      parameters that only some logs have, such as a position-dependent force; they are not pooled
    """

    name: str
    fits: tuple[LogFit, ...]
    estimates: tuple[Estimate, ...]
    scatter: dict[str, float]
    chance: dict[str, float]
    apart: tuple[str, ...] = ()

    def __getitem__(self, parameter: str) -> Estimate:
        for estimate in self.estimates:
            if estimate.name == parameter:
                return estimate
        raise ParameterError(
            f"the fit has no parameter '{parameter}'; it has {', '.join(estimate.name for estimate in self.estimates)}"
        )

    @property
    def differing(self) -> tuple[str, ...]:
        """The parameters in which the logs differ by more than their errors explain."""
        return tuple(name for name, chance in self.chance.items() if chance < _CHANCE)

    @property
    def remark(self) -> str:
        """A sentence on whether the logs agree."""
        if not self.differing:
            return Text(f"the {len(self.fits)} logs agree within their errors")
        parts = ", ".join(f"{name} by {Quantity(self.scatter[name], self[name].unit):2}" for name in self.differing)
        if MASS in self.differing:
            likely = "another load, a clock or a scale that is off, a flexible axis under another motion"
        else:
            likely = "temperature, lubrication, another part of the travel"
        return Text(
            f"the {len(self.fits)} logs differ by more than their errors, from log to log {parts}: the model lacks "
            f"something that changed between them ({likely}); the pooled errors contain this scatter"
        )

    def with_one_more(self, parameter: str) -> float:
        """Return the expected error of a parameter after adding one more log with the same scatter."""
        logs, tau = len(self.fits) + 1, self.scatter[parameter]
        one = float(np.mean([fit[parameter].error ** 2 for fit in self.fits])) + tau**2
        return _student(logs, tau**2 / one) * float(np.sqrt(one / logs))

    def table(self) -> Table:
        """Return a table of the pooled parameters."""
        return estimates_table(f"{self.name}: values of {len(self.fits)} logs", self.estimates)

    def compared(self) -> Table:
        """Return a table of the values of each log, the pooled values, the scatter and its probability by chance."""
        columns = ["log", *(Column(estimate.name, estimate.unit) for estimate in self.estimates)]
        rows: list[list[Cell]] = [
            [fit.name, *(_with_error(fit[estimate.name]) for estimate in self.estimates)] for fit in self.fits
        ]
        rows.append(["pooled", *map(_with_error, self.estimates)])
        scatters = [Quantity(self.scatter[estimate.name], estimate.unit, form="2") for estimate in self.estimates]
        rows.append(["scatter", *scatters])
        rows.append(["chance", *(_chance_shown(self.chance[estimate.name]) for estimate in self.estimates)])
        return Table("the logs compared", columns, rows)


def _chance_shown(chance: float) -> Text:
    if chance < _NEVER:
        return Text(f"< {Quantity(_NEVER, 'share')}")
    return Text(f"{Quantity(chance, 'share', form='2')}")


def _with_error(estimate: Estimate) -> Quantity:
    return Quantity(estimate.value, estimate.unit, estimate.error, bare=True)


def identify_pooled(
    logs: Sequence[MotionLog], *, friction: str = "best", how: Preparation | None = None, name: str = "pooled"
) -> PooledFit:
    """Identify one rigid drive from several logs of the same axis.

        value = Σ w y / Σ w,   w = 1 / (σ² + τ²),   Σ w (y - value)² = logs - 1

    y ± σ are the values of the individual logs; the scatter τ follows from the last equation and is 0 if the logs
    agree. The error is √(1 / Σ w), multiplied by Student's factor for the degrees of freedom of its scatter part
    (Satterthwaite), so that a few differing logs give a wide interval.

    friction  as in `identify_rigid`; "best" selects the model with the lower sum of the information criteria
    how       filters and delays of every log

    Raises ParameterError for fewer than two logs or logs in different units, NotIdentifiableError for a log that
    cannot be identified.
    Sources: Paule & Mandel 1982; Satterthwaite 1946.
    """
    _check_number(logs)
    frames = {log.frame.name for log in logs}
    if len(frames) > 1:
        raise ParameterError(f"the logs are in units of {' and of '.join(sorted(frames))}: give all at the same place")
    fits = [identify_rigid(log, friction=friction, how=how) for log in logs]
    best = _joint_friction(fits)
    return pooled(
        [
            fit if fit.friction == best else identify_rigid(log, friction=best, how=how)
            for log, fit in zip(logs, fits, strict=True)
        ],
        name,
    )


def _check_number(logs: Sequence[object]) -> None:
    if len(logs) < LEAST_LOGS:
        raise ParameterError(f"logs = {len(logs)} must be >= {LEAST_LOGS}: pooling needs several logs of one axis")


def _joint_friction(fits: Sequence[RigidFit]) -> str:
    """Return the friction model with the lowest sum of the information criteria of the logs."""
    return min(fits[0].criterion, key=lambda model: sum(fit.criterion[model] for fit in fits))


def pooled(fits: Sequence[LogFit], name: str = "pooled") -> PooledFit:
    """Pool fits with the same friction model, in the parameters that all of them have; see `identify_pooled`."""
    if len({fit.friction for fit in fits if isinstance(fit, RigidFit)}) > 1:
        raise ParameterError("the fits have different friction models: identify all with the same `friction`")
    from scipy.special import chdtrc  # takes a second to import

    names = {estimate.name: None for fit in fits for estimate in fit.estimates}
    common = [name for name in names if all(any(e.name == name for e in fit.estimates) for fit in fits)]
    estimates, scatter, chance = [], {}, {}
    for parameter in common:
        y = np.array([fit[parameter].value for fit in fits])
        variance = np.maximum([fit[parameter].error ** 2 for fit in fits], np.finfo(float).tiny)
        tau = scatter_of(y, variance)
        weights = 1.0 / (variance + tau**2)
        value, squared = float(weights @ y / weights.sum()), float(1.0 / weights.sum())
        student = _student(len(fits), tau**2 / len(fits) / squared)
        within = 1.0 / variance
        unit = fits[0][parameter].unit
        estimates.append(
            Estimate(parameter, value, unit, student * np.sqrt(squared), float(np.sqrt(1.0 / within.sum())))
        )
        scatter[parameter] = tau
        disagreement = float(within @ (y - within @ y / within.sum()) ** 2)
        chance[parameter] = float(chdtrc(len(fits) - 1, disagreement))
    apart = tuple(parameter for parameter in names if parameter not in common)
    return PooledFit(name, tuple(fits), tuple(estimates), scatter, chance, apart)


def _student(logs: int, share: float) -> float:
    """Return Student's factor over that of a normal error; `share` of the variance is from the scatter of the logs."""
    from scipy.special import stdtrit  # takes a second to import

    freedom = (logs - 1) / share**2 if share > 0.0 else np.inf
    return float(stdtrit(min(freedom, _CERTAIN), 0.975)) / NORMAL


def scatter_of(values: np.ndarray, variance: np.ndarray) -> float:
    """Return τ >= 0 with Σ (y - mean)² / (σ² + τ²) = n - 1, mean weighted by 1 / (σ² + τ²); 0 if the values agree."""

    def excess(squared: float) -> float:
        weights = 1.0 / (variance + squared)
        return float(weights @ (values - weights @ values / weights.sum()) ** 2) - (values.size - 1)

    if excess(0.0) <= 0.0:
        return 0.0
    low, high = 0.0, float(np.sum((values - values.mean()) ** 2)) + float(np.max(variance))
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if excess(middle) > 0.0 else (low, middle)
    return float(np.sqrt(high))


@dataclass(frozen=True, eq=False, repr=False)
class IdentifiedLogs(Result):
    """The model of a drive identified from several logs of one axis.

    logs       the results of the individual logs
    pooled     the pooled values, with those of each log: from the closed loops, or from the inverse dynamics if not all
               logs have a closed loop with the same law
    rigid      the pooled values of the inverse dynamics
    model      the model with the pooled values; the rest, such as the law, is from the log with the most accurate mass
    remarks    remarks on the agreement of the logs and on values that were not pooled
    contradicted  contradictions between the logs that indicate a wrong clock or scale; otherwise empty
    """

    logs: tuple[Identified, ...]
    pooled: PooledFit
    rigid: PooledFit
    model: Identified
    remarks: tuple[str, ...]
    contradicted: str = ""

    @property
    def rotary(self) -> bool:
        """True for a rotary axis."""
        return self.model.rotary

    @property
    def loop(self) -> Loop | None:
        """The loop with the pooled values, ready to simulate; None in shaft units."""
        return self.model.loop

    def __getitem__(self, parameter: str) -> Estimate:
        return self.pooled[parameter]

    def table(self) -> Table:
        """Return a table of the pooled parameters."""
        return self.pooled.table()

    @property
    def unusable(self) -> str:
        """The reason why the values must not be used in a machine file, or an empty string."""
        if self._of_one_log() is not None:
            return "not all logs can be pooled"
        if self.contradicted:
            return "the logs contradict each other in clock or scale"
        mass = self.model.mass
        return self._unsure() if mass.error > USABLE_MASS * mass.value else ""

    @property
    def recommendation(self) -> str:
        """The recommendation as a sentence."""
        return self.advice.sentence

    @property
    def advice(self) -> Advice:
        """The recommended use of the values, with the reason."""
        why = self._of_one_log()
        if why is not None:
            return Advice(why.judgment, Text(f"{why.judgment.says}: {why.sentence}."))
        if self.contradicted:
            return Judgment.SCALES_IN_DOUBT.because(self.contradicted)
        mass = self.model.mass
        if mass.error > SURE_MASS * mass.value:
            return Judgment.DO_NOT_TRUST.because(self._unsure())
        share = Quantity(NORMAL * mass.error / mass.value, "share")
        return Judgment.USE_VALUES.because(
            Text(f"{len(self.logs)} logs tell the mass to +-{share:2} at 95 %, their scatter included")
        )

    def _of_one_log(self) -> Advice | None:
        """Return the judgment on the first log that must not be pooled, with the reason; None if all may be pooled."""
        wrong = {log.log.name: log for log in self.logs if log.doubt or log.contradicted or log.faulty}
        for name, log in wrong.items():
            why = log.doubt or log.contradicted or log.faulty
            named = why if name in why else Text(f"{name}: {why}")
            if len(wrong) == 1:
                rest = "; correct this log, or leave it out"
            else:
                rest = f"; {'all' if len(wrong) == len(self.logs) else len(wrong)} logs are wrong in such a way"
            return Advice(log.advice.judgment, Text(f"{named}{rest}"))
        return None

    def _unsure(self) -> Text:
        mass, scatter = self.model.mass, self.pooled.scatter[MASS]
        text = Text(f"{len(self.logs)} logs tell {within(mass)}")
        if scatter == 0.0:
            return text + Text(f"; {MORE_RAMPS}")
        more = Quantity(NORMAL * self.pooled.with_one_more(MASS) / mass.value, "share")
        return text + Text(
            f": they differ by {Quantity(scatter, mass.unit):2}, and {len(self.logs)} logs tell little of such a "
            f"scatter; with one more log that differs as much it would be +-{more:2}"
        )


def identify_logs(
    logs: Sequence[MotionLog],
    start: Loop | None = None,
    *,
    law: Law | None = None,
    friction: str = "best",
    lead: float | None = None,
    gear: float = 1.0,
) -> IdentifiedLogs:
    """Identify a drive from several logs of one axis: each by `identify_motion`, after which the results are pooled.

    The arguments apply to all logs. Raises the errors of `identify_motion` and `pool_logs`.
    """

    def one(k: int, friction: str) -> Identified:
        return identify_motion(logs[k], start, law=law, friction=friction, lead=lead, gear=gear)

    return pool_logs([one(k, friction) for k in range(len(logs))], one)


def pool_logs(
    found: Sequence[Identified], again: Callable[[int, str], Identified], name: str = "pooled"
) -> IdentifiedLogs:
    """Pool the results of several logs of one axis.

    The friction model is the one with the lower sum of the information criteria. The values of the closed loops are
    pooled if all logs have a closed loop with the same law, otherwise those of the inverse dynamics.

    again  function that identifies a log again, given its index and a friction model

    Raises ParameterError for fewer than two logs, for a log that is given twice, and for logs in different units
    (table, shaft, rotary axis); LogError for logs of different axes.
    """
    _check_number(found)
    _check_places(found)
    best = _joint_friction([log.rigid for log in found])
    found = [log if log.rigid.friction == best else again(k, best) for k, log in enumerate(found)]
    middle = _middle(found)
    _check_axes(found, middle)
    laws = _same_laws(found)
    rigid = pooled([log.rigid for log in found], name)
    remarks: list[str] = []
    closed = _closed(found, name) if laws is not None else None
    values = rigid if closed is None else closed
    remarks.append(values.remark)
    if laws is None:
        remarks.append(_laws_differ(found))
    else:
        remarks += laws.remarks()
    if laws is not None and not laws.without and closed is None and any(log.refinement is not None for log in found):
        remarks.append(
            "the closed loops of the logs do not all have the same parameters: the values of the inverse dynamics are "
            "pooled"
        )
    if len({log.log.sample_time for log in found}) > 1:
        remarks.append("the logs have different sample times")
    base = (_Laws(tuple(found), (), ()) if laws is None else laws).taken
    if values.apart:
        remarks.append(f"not pooled, since not all logs show it: {', '.join(values.apart)}; see each log")
    told = [_against(found[middle], log) for k, log in enumerate(found) if k != middle]
    contradicted = joined("; ", [text for text, certain in told if certain])
    remarks += [text for text, certain in told if text and not certain]
    model = _model(base, rigid, closed, name, keeps_law=laws is not None)
    return IdentifiedLogs(tuple(found), values, rigid, model, tuple(remarks), contradicted)


def _check_places(found: Sequence[Identified]) -> None:
    """Raise ParameterError for logs in different units (table, shaft, rotary axis), and for a log given twice."""
    first = found[0]
    for k, log in enumerate(found):
        if log.rigid.frame is not first.rigid.frame:
            raise ParameterError(
                f"{log.log.name}: is that of a {log.rigid.frame.name}, and {first.log.name} that of a "
                f"{first.rigid.frame.name}: give all at the same place, as with --lead, or leave one out"
            )
        for other in found[:k]:
            if np.array_equal(log.log.position, other.log.position) and np.array_equal(log.log.force, other.log.force):
                raise ParameterError(
                    f"{log.log.name}: holds the same rows as {other.log.name}; a log counts once, leave one of them out"
                )


def _middle(found: Sequence[Identified]) -> int:
    """Return the index of the log whose mass is closest to the masses of all other logs."""
    logs = np.log([log.mass.value for log in found])
    return int(np.argmin(np.sum(np.abs(logs[:, None] - logs), axis=1)))


def _check_axes(found: Sequence[Identified], middle: int) -> None:
    """Raise LogError, with possible causes, for a log whose mass can only be that of another axis."""
    usual = found[middle]
    for log in found:
        a, b = usual.mass, log.mass
        ratio = max(a.value / b.value, b.value / a.value)
        apart = abs(np.log(ratio))
        if ratio > OTHER_AXIS and apart > SURE * float(np.hypot(a.error / a.value, b.error / b.value)):
            texts, _ = _against(usual, log)
            raise LogError(
                f"{log.log.name}: gives a mass of {b.quantity}, where {usual.log.name} gives {a.quantity}: logs of "
                f"different axes or loads are not pooled{f'; if it is one axis, {texts}' if texts else ''}; identify "
                "each alone, or leave one out"
            )


@dataclass(frozen=True)
class _Laws:
    """The control law of the logs, which is the same in all logs with a law.

    logs     logs with this law, one of which provides the law of the model; all logs if none has a law
    without  names of the logs in which no law was found
    further  names of the logs whose law has additional or missing parts
    """

    logs: tuple[Identified, ...]
    without: tuple[str, ...]
    further: tuple[str, ...]

    @property
    def taken(self) -> Identified:
        """The log with the most accurate estimate of the mass."""
        return min(self.logs, key=lambda log: log.mass.error / log.mass.value)

    def remarks(self) -> list[str]:
        """Return remarks on the log that provides the law, if the laws of the logs have different parts."""
        name = self.taken.log.name
        remarks: list[str] = []
        if self.without:
            remarks.append(
                f"the law is that of {name}; none was found in {', '.join(self.without)}, so that the values of the "
                "inverse dynamics are pooled"
            )
        if self.further:
            remarks.append(
                f"the law is that of {name}; in {', '.join(self.further)} it has other parts beside the same gains"
            )
        return remarks


def _same_laws(found: Sequence[Identified]) -> _Laws | None:
    """Return the common law of the logs; None if the laws of two logs differ. A stated law is the same in all logs.

    Several laws may explain a log equally well; the other logs then show which of them is the true one.
    """
    there = [log for log in found if log.loop is not None]
    laws = [(log, log.control) for log in there if log.control is not None]
    without = tuple(log.log.name for log in found if log.loop is None) if there else ()
    if not laws:
        return _Laws(tuple(there or found), without, ())
    best: _Laws | None = None
    for _, candidate in laws:
        reading = candidate.readings[0]
        if any(_matching(reading, law) is None for _, law in laws):
            continue
        logs = tuple(
            log for log, law in laws if law.readings[0].name == reading.name and _fits(reading, law.readings[0])
        )
        further = tuple(log.log.name for log, _ in laws if log not in logs)
        if best is None or len(logs) > len(best.logs):
            best = _Laws(logs, without, further)
    return best


def _matching(reading: LawReading, law: ControlFit) -> LawReading | None:
    """Return the interpretation in `law` that agrees with that of another log; None if there is none."""
    return next((other for other in law.readings if _fits(reading, other)), None)


def _fits(a: LawReading, b: LawReading) -> bool:
    """Return True if two interpretations are the same law.

    Common gains may differ by their errors or by `MOST_OFF`.  An additional part, such as an acceleration feedforward,
    may be present in one of them only.
    """
    gains = {estimate.name for estimate in a.estimates}
    return _basic(a) == _basic(b) and all(_alike(a[e.name], e) for e in b.estimates if e.name in gains)


def _basic(reading: LawReading) -> tuple[str, bool]:
    return reading.structure.family, reading.structure.integral


def _alike(a: Estimate, b: Estimate) -> bool:
    return abs(a.value - b.value) <= max(MOST_OFF * abs(a.value), SURE * float(np.hypot(a.error, b.error)))


def _laws_differ(found: Sequence[Identified]) -> Text:
    laws = joined(
        ", ",
        (
            Text(f"{log.log.name} {log.control.readings[0].name} with ")
            + joined(" and ", (f"{e.name} {e.quantity}" for e in log.control.estimates[:2]))
            for log in found
            if log.control is not None
        ),
    )
    return Text(
        f"the laws of the logs differ ({laws}), so that none of them is taken, and the values of the inverse dynamics "
        "are pooled; give the law that runs now with --law, or with --machine"
    )


def law_table(found: IdentifiedLogs) -> Table | None:
    """Return a table of the gains identified from each log; None if fewer than two logs have a law."""
    laws = [(log.log.name, log.control) for log in found.logs if log.control is not None]
    if len(laws) < LEAST_LOGS:
        return None
    taken = found.model.control
    names = {estimate.name: estimate.unit for _, law in laws for estimate in law.estimates}
    rows: list[list[Cell]] = []
    for name, law in laws:
        reading = law.readings[0] if taken is None else (_matching(taken.readings[0], law) or law.readings[0])
        there = {estimate.name: estimate for estimate in reading.estimates}
        values = [_with_error(there[gain]) if gain in there else None for gain in names]
        rows.append([name, *values, reading.name, "taken" if law is taken else ""])
    columns = ["log", *(Column(gain, unit or None) for gain, unit in names.items()), "law", ""]
    return Table("the law in each log", columns, rows)


def _closed(found: Sequence[Identified], name: str) -> PooledFit | None:
    """Return the pooled values of the closed loops; None unless all logs have one with the same parameters."""
    fits = [log.refinement for log in found if log.refinement is not None]
    if len(fits) < len(found) or len({tuple(e.name for e in fit.estimates) for fit in fits}) > 1:
        return None
    return pooled([LogValues(fit.name, fit.short) for fit in fits], name)


def _model(base: Identified, rigid: PooledFit, closed: PooledFit | None, name: str, *, keeps_law: bool) -> Identified:
    """Return the result of one log with the pooled values in place of its own."""
    values = {estimate.name: estimate for estimate in rigid.estimates}
    estimates = tuple(values.get(estimate.name, estimate) for estimate in base.rigid.estimates)
    grown = np.array(
        [b.error / a.error if a.error else 1.0 for a, b in zip(base.rigid.estimates, estimates, strict=True)]
    )
    size = grown.size
    covariance = base.rigid.covariance.copy()
    covariance[:size, :size] *= np.outer(grown, grown)
    fit = replace(base.rigid, name=name, estimates=estimates, covariance=covariance)
    if not keeps_law or base.loop is None:
        return replace(base, rigid=fit, control=None, refinement=None, loop=None, law=None)
    if closed is None or base.refinement is None:
        axis = with_rigid(base.loop.axis, fit, richer=is_richer(base.loop.axis))
        return replace(base, rigid=fit, refinement=None, loop=replace(base.loop, axis=axis))
    refined = tuple(
        replace(closed[short.name], name=estimate.name)
        for estimate, short in zip(base.refinement.estimates, base.refinement.short, strict=True)
    )
    loop = tree.vary(base.loop, {estimate.name: estimate.value for estimate in refined})
    return replace(
        base, rigid=fit, refinement=replace(base.refinement, name=name, estimates=refined, loop=loop), loop=loop
    )


# What one log says against another one.


def _against(usual: Identified, log: Identified) -> tuple[Text, bool]:
    """Return text on possible causes of the difference between two logs, and True if each is a wrong clock or scale."""
    known, values = _values(usual), _values(log)
    ratios = {
        name: Ratio.of(name, e.unit, e.value, known[name].value, _joint(e, known[name]))
        for name, e in values.items()
        if name in known
    }
    for a, b in _gains(usual, log):
        ratios[f"{_LAW}{b.name}"] = Ratio.of(f"{_LAW}{b.name}", b.unit, b.value, a.value, _joint(b, a))
    causes = causes_of(ratios.values())
    told = [name for name, ratio in ratios.items() if ratio is not None and name.startswith(_LAW) and ratio.unit]
    if not causes and len(told) > 1:
        # friction may have changed as well, which the gains do not follow
        kept = (ratio for name, ratio in ratios.items() if name == MASS or name.startswith(_LAW))
        causes = causes_of(kept)
    if not causes:
        return Text(""), False
    # file names are enough where they differ: a path would be repeated five times
    names = [Path(one.log.name).name for one in (log, usual)]
    first, second = names if names[0] != names[1] else (log.log.name, usual.log.name)
    text = said(causes, first, log.log.sample_time, second)
    certain = all(cause.kind != LOAD for cause in causes)
    return Text(f"{_shown(causes)} of '{first}' and '{second}' differ by one factor, as where {text}"), certain


def _shown(causes: Sequence[Cause]) -> str:
    """Return the values affected by a cause as text: mass, friction, and the names of gains."""
    shown = causes[0].shown if len(causes) == 1 else (MASS,)
    gains = [name.removeprefix(_LAW) for name in shown if name.startswith(_LAW)]
    words = [MASS] if MASS in shown else []
    words += ["friction"] if len(shown) > len(words) + len(gains) else []
    words += [f"the gains {', '.join(gains)}"] if gains else []
    return f"{', '.join(words[:-1])}{' and ' if len(words) > 1 else ''}{words[-1]}"


def _joint(a: Estimate, b: Estimate) -> float:
    return float(np.hypot(a.error / a.value, b.error / b.value)) if a.value and b.value else float("inf")


def _values(log: Identified) -> dict[str, Estimate]:
    """Return the mass and the friction parameters of a log by name."""
    fitted = log.rigid.estimates if log.refinement is None else log.refinement.short
    friction = {e.name: e for e in fitted if e.name.startswith(("viscous", "coulomb"))}
    return {MASS: replace(log.mass, name=MASS), **friction}


def _gains(usual: Identified, log: Identified) -> list[tuple[Estimate, Estimate]]:
    """Return pairs of gains of a law found in both logs; if several laws explain them, of the two that agree best."""
    if usual.control is None or log.control is None:
        return []
    pairs: list[list[tuple[Estimate, Estimate]]] = [
        [(one, e) for e in b.estimates for one in a.estimates if one.name == e.name]
        for a in usual.control.readings
        for b in log.control.readings
        if _basic(a) == _basic(b)
    ]

    def apart(gains: list[tuple[Estimate, Estimate]]) -> float:
        return sum(abs(b.value - a.value) / (abs(a.value) + abs(b.value)) for a, b in gains if a.value or b.value)

    return min(pairs, key=apart, default=[])

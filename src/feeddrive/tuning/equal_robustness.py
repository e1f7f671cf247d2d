"""Tuning under equal robustness: the least rope-snap error with bounded sensitivity peak and delay margin."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize

from feeddrive.language import tree
from feeddrive.language.errors import ParameterError, UnstableError
from feeddrive.loop.loop import Loop
from feeddrive.tuning.proof import proven
from feeddrive.tuning.robustness import Judge, Robustness, robustness
from feeddrive.tuning.tuned import Tuned

# how a gain scales when all frequencies of a loop rise by a factor: to its power, by the unit
_POWERS = {"1/s": 1, "rad/s": 1, "Hz": 1, "N s/m": 1, "N/m": 2, "1/s2": 2, "N/(m s)": 3, "s": -1}
_LADDER = np.log(2.0) * np.arange(3.0, -11.5, -0.5)  # factors 8 ... 1/2048
_RANGE = math.log(1e4)  # how far a knob may move from where the search begins
_ROOM = 3e-4  # of a bound: by so much the search stays inside, for what its lines miss
_DENSE = 600  # lines a decade with which its end is judged
_BOX = 0.5  # of a logarithm: how far a descent goes before it looks around anew
_LEAST_BOX, _BOXES = 0.1, 12  # the box shrinks to this where there is no progress; how many at most in one descent
_BUDGET = 180  # loops judged in one descent, after which no new box is begun
_PROGRESS = 1e-3  # of the rope-snap error: less is none
_PATIENCE = 24  # loops judged without progress, and six more for each knob, before the box is left
_STEP = 1e-3  # of a logarithm, for slopes by differences
_ENOUGH, _FINE = 1e-5, 1e-7  # of the cost's logarithm: less is no progress, at first and at last


def knobs_of(loop: Loop) -> tuple[str, ...]:
    """Dotted names of the law's knobs that are there. Raises ParameterError for a law that names none."""
    law = loop.control.law
    there = dict(tree.leaves(law))
    names = tuple(f"control.law.{name}" for name in law.knobs if name in there)
    if not names:
        raise ParameterError(f"the law '{law.kind}' names no knobs: say which parameters are to be tuned (knobs=...)")
    return names


def tune(
    loop: Loop,
    *,
    knobs: Sequence[str] | None = None,
    sensitivity_peak: float = 2.0,
    delay_margin_samples: float = 2.0,
    velocity: float = 0.05,
    starts: int = 2,
    seed: int = 0,
) -> Tuned:
    """The loop with the knobs that give the least rope-snap error within equal robustness.

        minimise  ISE^½ = [∫ |C|²/ω² dω/π]^½   over ln(knobs)
        subject to  Ms <= sensitivity_peak,  delay margin >= delay_margin_samples,  all poles inside the circle

    The loop is cut at the actuator.  All else stays: filters, feedforward, delays.

    knobs     dotted names of positive parameters; default: those that the law names
    velocity  m/s at which the axis slides
    starts    from how many points the search begins; the best end is taken, and how far the ends differ is stated
    seed      of the points after the first

    The loop may be unstable as it is given: its frequencies are then lowered together until it is stable and robust.
    Sequential quadratic programming, slopes by differences.  The result proves itself: see `Tuned.proof`.
    Raises UnstableError if no robust loop is found, and ParameterError for knobs that are not there or not positive.
    """
    names = knobs_of(loop) if knobs is None else tuple(knobs)
    for bound, value, least in (
        ("sensitivity_peak", sensitivity_peak, 1.0),
        ("delay_margin_samples", delay_margin_samples, 0.0),
    ):
        if not value > least or not math.isfinite(value):
            raise ParameterError(f"{bound} = {value:g} must be a finite number > {least:g}")
    begin = np.array([_logarithm(loop, name) for name in names])
    judge = Judge(loop, names, velocity)
    search = _Search(judge, sensitivity_peak, delay_margin_samples)
    first = search.ladder(begin, [tree.declaration(loop, name).unit for name in names])
    random = np.random.default_rng(seed)
    points = [first, *(first + random.uniform(-0.5, 0.5, len(names)) for _ in range(starts - 1))]
    ends = [search.descend(point, first) for point in points]
    best = search.descend(min(ends, key=lambda end: judge(end).rope_snap), first, _FINE)
    while not search.admits(dense := robustness(judge.at(best), velocity=velocity, per_decade=_DENSE)):
        search.tighten(dense)
        best = search.descend(best, first, _FINE)
    found = judge(best)
    reached = [judge(end).rope_snap / found.rope_snap - 1.0 for end in ends]
    active = [*search.active(found), *(n for n, d in zip(names, best - first, strict=True) if abs(d) > _RANGE - 1e-6)]
    tuned = judge.at(best)
    return Tuned(
        loop=tuned,
        knobs=judge.values(best),
        started=judge.values(begin),
        robustness=found,
        sensitivity_bound=sensitivity_peak,
        delay_bound=delay_margin_samples,
        active=tuple(active),
        evaluations=judge.count,
        spread=max(*reached, 0.0),
        proof=proven(tuned, found, search.admits, judge, best, velocity),
    )


def _logarithm(loop: Loop, name: str) -> float:
    value = tree.get(loop, name)
    if not isinstance(value, (int, float)) or not value > 0.0:
        raise ParameterError(f"{name} = {value!r} is no knob: it must be a number > 0 where the search begins")
    return math.log(value)


class _Search:
    """The minimisation, in logarithms of the knobs."""

    def __init__(self, judge: Judge, peak: float, delay: float) -> None:
        self.judge, self.peak, self.delay = judge, peak, delay
        self.room = _ROOM

    def tighten(self, dense: Robustness) -> None:
        """More room, after dense lines found more than those of the search."""
        if self.room > 0.1 or not dense.stable:
            raise UnstableError("the sensitivity peak is too narrow to be tuned for: damp the resonance, or filter it")
        self.room += max(_ROOM, -2.0 * float(np.min(self.slack(dense))))

    def slack(self, found: Robustness) -> np.ndarray:
        """Logarithms of how far the bounds are kept; negative where they are not."""
        if not found.stable:
            return np.array([-5.0, -5.0])
        return np.array(
            [
                math.log(self.peak / found.sensitivity_peak),
                math.log(max(min(found.delay_margin_samples, 1e6), 1e-6) / self.delay),
            ]
        )

    def admits(self, found: Robustness) -> bool:
        """Stable and within both bounds."""
        return found.stable and bool(np.all(self.slack(found) >= 0.0))

    def keeps(self, found: Robustness) -> bool:
        """The same with room for what the lines of the search miss."""
        return found.stable and bool(np.all(self.slack(found) >= 0.9 * self.room))

    def active(self, found: Robustness) -> list[str]:
        """Names of the bounds that are reached."""
        names = (f"Ms = {self.peak:g}", f"delay margin = {self.delay:g} samples")
        return [name for name, slack in zip(names, self.slack(found), strict=True) if slack <= 5.0 * self.room]

    def ladder(self, begin: np.ndarray, units: Sequence[str]) -> np.ndarray:
        """The best point within the bounds when all frequencies rise or fall together; ratios also doubled."""
        powers = np.array([_POWERS.get(unit, 0) for unit in units], dtype=float)
        ratios = np.array([1.0 if unit == "" else 0.0 for unit in units])
        tried: list[np.ndarray] = []
        for more in (0.0, np.log(2.0), np.log(0.5)):
            if more and not np.any(ratios):
                continue
            rungs = [begin + step * powers + more * ratios for step in (_LADDER if np.any(powers) else (0.0,))]
            good = [rung for rung in rungs if self.keeps(self.judge(rung)) and self.judge.fits(rung)]
            if good:
                return min(good, key=lambda rung: (self.judge(rung).rope_snap, float(np.sum(np.abs(rung - begin)))))
            tried += rungs
        stable = [found for found in map(self.judge, tried) if found.stable]
        nearest = min((found.sensitivity_peak for found in stable), default=math.inf)
        least = f"; the least Ms on the way was {nearest:.4g}" if stable else "; none on the way was stable"
        raise UnstableError(
            f"no setting of {', '.join(name.rpartition('.')[2] for name in self.judge.names)} was found that is stable "
            f"with Ms <= {self.peak:g} and a delay margin >= {self.delay:g} samples{least}: check masses, filters and "
            f"dead time, or begin elsewhere"
        )

    def descend(self, point: np.ndarray, middle: np.ndarray, enough: float = _ENOUGH) -> np.ndarray:
        """The best point within the bounds on the way down from a point; `middle`, which is one, if there is none."""
        best, seen = [middle], [self.judge.count]
        patience = _PATIENCE + 6 * point.size

        def cost(x: np.ndarray) -> float:
            found, least = self.judge(x), self.judge(best[0])
            better = self.keeps(found) and (found.rope_snap < least.rope_snap or not self.keeps(least))
            if better and self.judge.fits(x):
                if not found.rope_snap > (1.0 - 0.1 * _PROGRESS) * least.rope_snap:
                    seen[0] = self.judge.count
                best[0] = np.array(x)
            if self.judge.count - seen[0] > patience:
                raise StopIteration
            # far above any stable loop's, so that a step into the unstable is taken back
            return math.log(found.rope_snap) if 0.0 < found.rope_snap < math.inf else 0.0

        def slack(x: np.ndarray) -> np.ndarray:
            return self.slack(self.judge(x)) - self.room

        size, begun = _BOX, self.judge.count
        for _ in range(_BOXES):
            before, seen[0] = self.judge(best[0]).rope_snap, self.judge.count
            # without a box the first step follows the slope alone, far beyond the edge of stability
            low, high = np.maximum(point - size, middle - _RANGE), np.minimum(point + size, middle + _RANGE)
            with contextlib.suppress(StopIteration):
                minimize(
                    cost, np.clip(point, low, high), method="SLSQP", bounds=np.stack([low, high], axis=1),
                    constraints={"type": "ineq", "fun": slack}, options={"maxiter": 25, "ftol": enough, "eps": _STEP},
                )  # fmt: skip
            point = best[0]
            if self.judge(point).rope_snap > (1.0 - _PROGRESS) * before:
                size *= 0.3
            if size < _LEAST_BOX or self.judge.count - begun > _BUDGET:
                break
        return point

"""Tuning over the machines of a study: one control for all of them, or for a stated share.

    minimize  max over machines of the goal   subject to   all limits on every machine

over hundreds of sampled machines would be a problem of ten thousand bounds, of which some ten are active.  So the tuner
works on few machines.  After each tuning all others are judged under the new control, and the worst of them join,
until none is worse than those that the tuner had: then the control is the best for all sampled ones, as far as the
tuner's independent searches, made at the end, are settled.  Slopes are those of the traced law.

For a share q < 1 the worst (1 - q) n machines under the present control are left out of it.  Which ones these are
follows from the control, so that this is a descent to a local optimum, and the best control of all rounds is taken.

What a sample promises of all machines is not assumed but measured, on others (`fresh.py`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from feeddrive.figures.catalogue import goals
from feeddrive.figures.of_loops import ROPE_SNAP
from feeddrive.language.errors import ParameterError, UnstableError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.table import Cell, Result, Table, chart_of
from feeddrive.language.text import Text, joined
from feeddrive.loop.control import Control
from feeddrive.plot.chart import Chart
from feeddrive.study.answers.shares import Share
from feeddrive.study.fresh import Measured, bounds_of, is_limit, limits_of, measured
from feeddrive.study.scenarios import Merits, scenarios
from feeddrive.study.specification import Bound
from feeddrive.study.study import StudyLike, read_study
from feeddrive.tuning.criteria import Limits
from feeddrive.tuning.tune import Tuned, tune_control

_ROUNDS = 16
_JOIN = 3  # machines that join at once
_SAME = 5e-3  # of the goal's logarithm: a machine that is worse by less need not join


@dataclass(frozen=True, eq=False, repr=False)
class Robust(Result):
    """One control for the machines of a study.

    tuned            the result of the tuner on the machines that decide, whose names are `variant N`
    share            of the sampled machines for which it is made; 1 for all
    rounds           by round how many machines the tuner had, and how many of the sample kept all limits after it
    seen, seen_new   the sampled machines under today's control and under the new one
    before, after    fresh machines under both
    bad              numbers and reasons of variants that cannot be made
    unsettled        why the result may not be the best for the sample; empty if all is well
    """

    tuned: Tuned
    share: float
    rounds: tuple[tuple[int, int], ...]
    seen: Merits
    seen_new: Merits
    before: Measured
    after: Measured
    bad: tuple[tuple[int, str], ...]
    unsettled: str

    @property
    def rotary(self) -> bool:
        """True if the axis is rotary."""
        return self.tuned.rotary

    @property
    def active(self) -> tuple[str, ...]:
        """The machines that the tuner had at the end."""
        return tuple(each.point for each in self.tuned.after)

    @property
    def better(self) -> bool:
        """True if at least as many fresh machines are good as under today's control."""
        return self.after.all.kept >= self.before.all.kept

    def sentence(self) -> str:
        """The result in words, with both yields."""
        n, m = self.seen.goal.size, self.after.count
        aim = "all" if self.share == 1.0 else f"{Quantity(self.share, 'share'):6}"
        kept = int(np.sum(self.seen_new.kept))
        told = Text(
            f"Tuned for {aim} of {n} machines, of which {len(self.active)} decide: {kept} keep all limits, "
            f"{int(np.sum(self.seen.kept))} did before. Of {m} fresh machines that the tuner never saw "
            f"{in_percent(self.after.all)} are good; under today's control {in_percent(self.before.all)} are."
        )
        return told if self.better else told + " Keep today's control: it is good on more machines."

    def table(self) -> Table:
        """Shares of fresh machines within each bound, and quantiles of the rope-snap error, before and after."""
        rows: list[Sequence[Cell]] = [["all bounds", in_percent(self.before.all), in_percent(self.after.all)]]
        rows += [
            [bound_sentence(bound), in_percent(self.before.keeping(bound)), in_percent(self.after.keeping(bound))]
            for bound in self.after.bounds
        ]
        for share in (0.05, 0.5, 0.95):
            head = Text(f"rope-snap error, {Quantity(share, 'share'):6} quantile")
            cells = [
                Quantity(machines.quantile(ROPE_SNAP.key, share), ROPE_SNAP.unit)
                for machines in (self.before, self.after)
            ]
            rows.append([head, *cells])
        title = f"{self.after.count} fresh machines: share within bounds (95 % interval)"
        return Table(title, ["", "today", "new"], rows)


@chart_of.register
def _chart(result: Robust) -> Chart:
    """The fresh machines under both controls."""
    from feeddrive.study.robust_picture import shares_chart

    return shares_chart(result.before, result.after)


def in_percent(share: Share) -> str:
    """A share of the fresh machines with its interval of 95 %: `81.5 % (75.4 .. 86.6 %)`."""
    low, high = share.interval or (share.value, share.value)
    return Text(
        f"{Quantity(share.value, 'share'):3} ({Quantity(low, 'share', bare=True):3} .. {Quantity(high, 'share'):3})"
    )


def bound_sentence(bound: Bound) -> str:
    """A bound in words: `following_error_peak_m <= 30 um`."""
    ends = ((">=", bound.least), ("<=", bound.most))
    texts = [f"{sign} {Quantity(value, bound.figure.unit)}" for sign, value in ends if value is not None]
    return Text(f"{bound.figure.key} {joined(' and ', texts)}")


def tune_robust(
    study: StudyLike,
    *,
    control: Control | None = None,
    goal: str = "rope-snap",
    limits: Limits | None = None,
    filters: str = "free",
    band: tuple[float, float] = (0.0, math.inf),
    share: float = 1.0,
    samples: int | None = None,
    fresh: int | None = None,
    starts: int = 2,
    seed: int = 0,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Robust:
    """The control that is best on the worst machine of a study's sample, proven on machines that were not in it.

    study     a study file, a bundled study, or one that was read; its specification sets the limits of the tuner
    control   the start of the search, today's control of the study's job if none is given
    limits    what the specification does not state
    share     of the sampled machines for which limits and goal count
    samples   how many machines the tuner may see (default: the study's count, at most 1000)
    fresh     how many others it is proven on (default: as many, at least 200)
    workers   processes of the proof (default: all cores)

    All else as in `tune_control`.  Raises UnstableError if no control keeps the limits on all machines that must be
    kept, with their numbers; ParameterError for a study that varies the control or a coupled axis.
    """
    tuner = RobustTuner(
        study,
        goal=goal,
        limits=limits,
        filters=filters,
        band=band,
        share=share,
        samples=samples,
        fresh=fresh,
        starts=starts,
        seed=seed,
        workers=workers,
        progress=progress,
    )
    return tuner.tuned(tuner.loop.control if control is None else control)


class RobustTuner:
    """The machines of a study, drawn once, for the tuning of one control after another; arguments as `tune_robust`."""

    def __init__(
        self,
        study: StudyLike,
        *,
        goal: str = "rope-snap",
        limits: Limits | None = None,
        filters: str = "free",
        band: tuple[float, float] = (0.0, math.inf),
        share: float = 1.0,
        samples: int | None = None,
        fresh: int | None = None,
        starts: int = 2,
        seed: int = 0,
        workers: int | None = None,
        progress: Progress | None = None,
    ) -> None:
        if not 0.5 <= share <= 1.0:
            raise ParameterError(
                f"share = {number(share, 6)} must be >= 0.5 and <= 1: the part of the machines that count"
            )
        if goal not in goals():
            raise ParameterError(f"goal = {goal!r} must be one of {', '.join(goals())}")
        self.study, self.progress, self.workers = read_study(study), progress or Progress(), workers
        self.loop = next(self.study.bases()).loop
        self.limits = limits_of(self.study, limits or Limits())
        self.goal, self.filters, self.band, self.share = goal, filters, band, share
        self.starts, self.seed = starts, seed
        self.sample = scenarios(self.study, samples or min(self.study.count, 1000), self.progress)
        self.fresh = fresh or max(200, len(self.sample.points))

    def tuned(self, control: Control) -> Robust:
        """Tune from a start control. Raises UnstableError as `tune_robust`."""
        search = _Search(self)
        tuned, unsettled = search.run(control)
        return Robust(
            tuned,
            self.share,
            tuple(search.rounds),
            self.seen_today,
            self.judged(tuned.control),
            self.before,
            self._measured(tuned.control),
            self.sample.bad,
            unsettled,
        )

    @property
    def kept_bounds(self) -> tuple[Bound, ...]:
        """The limits of the tuner as bounds of figures."""
        return tuple(bound for bound in bounds_of(self.study, self.limits) if is_limit(bound))

    def judged(self, control: Control) -> Merits:
        """Judge a control on all sampled machines."""
        self.progress.step(f"{len(self.sample.points)} machines under the control")
        return self.sample.merits(control, goals()[self.goal], self.limits, self.band)

    @cached_property
    def seen_today(self) -> Merits:
        """The sampled machines under today's control."""
        return self.judged(self.loop.control)

    @cached_property
    def before(self) -> Measured:
        """Fresh machines under today's control."""
        return self._measured(self.loop.control)

    def _measured(self, control: Control) -> Measured:
        self.progress.step("machines that the tuner never saw")
        bounds = bounds_of(self.study, self.limits)
        return measured(self.study, control, bounds, (ROPE_SNAP,), self.fresh, self.workers, self.progress)


class _Search:
    """Rounds of the tuner on the machines that decide."""

    def __init__(self, tuner: RobustTuner) -> None:
        self.tuner = tuner
        self.kept = math.ceil(tuner.share * len(tuner.sample.points) - 1e-9)
        self.rounds: list[tuple[int, int]] = []

    def run(self, control: Control) -> tuple[Tuned, str]:
        """The best control of all rounds, and why it may not be the best there is.

        Rounds descend from the control of the round before; once no machine joins, independent searches on the same
        machines confirm it or find a better one, with which the rounds go on.
        """
        order = np.argsort(self.tuner.judged(control).severity, kind="stable")
        active = sorted({int(order[self.kept - 1]), int(order[self.kept // 2])})
        best: tuple[float, Tuned] | None = None
        thorough = False
        for _ in range(_ROUNDS):
            tuned = self._tuned(control, active, self.tuner.starts if thorough else 1)
            merits = self.tuner.judged(tuned.control)
            severity = merits.severity
            self.rounds.append((len(active), int(np.sum(merits.kept))))
            counted = [int(i) for i in np.argsort(severity, kind="stable")[: self.kept]]
            worst = float(severity[counted[-1]])
            if best is None or worst < best[0] or (thorough and worst < best[0] + _SAME):
                best = worst, tuned
            staying = [i for i in active if i in set(counted)]
            level = max((float(severity[i]) for i in staying), default=-math.inf)
            joining = [i for i in reversed(counted) if i not in active and severity[i] > level + _SAME][:_JOIN]
            if not joining and thorough:
                return best[1], tuned.unsettled
            thorough = not joining
            active, control = sorted(staying + joining), tuned.control
        assert best is not None
        return best[1], f"after {_ROUNDS} rounds machines still join that are worse than those the tuner had"

    def _tuned(self, control: Control, active: list[int], starts: int) -> Tuned:
        """Run the tuner on some machines; notches are placed in the first round only."""
        of = self.tuner
        filters = "free" if self.rounds and of.filters == "placed" else of.filters
        of.progress.step(f"round {len(self.rounds) + 1}: {len(active)} machines decide")
        points = [of.sample.points[i] for i in active]
        try:
            return tune_control(
                control,
                points,
                goal=of.goal,
                limits=of.limits,
                filters=filters,
                band=of.band,
                starts=starts,
                seed=of.seed,
                velocity=of.sample.velocity,
                today=of.loop.control,
                progress=of.progress,
            )
        except UnstableError as error:
            named = ", ".join(point.name for point in points)
            raise UnstableError(
                f"no control keeps {of.limits.sentence()} on {named} together: {error}. Take a smaller share of the "
                "machines, wider limits, or closer tolerances"
            ) from None

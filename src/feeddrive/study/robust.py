"""Robust tuning: one controller for all machines of a study, or for a share of them, verified on newly drawn machines.

    minimize  (max over machines of the goal)   subject to   all limits on every machine

Over hundreds of sampled machines this is a problem with ten thousand constraints, of which about ten are active.  The
tuner therefore works on a small active set of machines.  After each tuning, all others are evaluated under the new
controller, and the worst of them are added to the set, until none is worse than those in the set.  The controller is
then optimal for the whole sample, provided that the independent searches at the end find nothing better.  Derivatives
are those of the traced law.

For a share q < 1, the worst (1 - q) n of the n sampled machines under the existing controller are excluded.  Since the
excluded machines depend on the controller, the search finds only a local optimum; it returns the best controller of all
rounds.

The result for all other machines is measured, not assumed: on newly drawn machines, which come from another random
stream of the study's seed and are never used by the tuner.  They are drawn independently (Monte Carlo), whatever the
study's sampler is, so that the number of good machines has a binomial distribution and the confidence interval of the
yield is valid.  Both controllers are measured on the same machines.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from feeddrive.evaluation.engine import Engine
from feeddrive.figures.catalogue import goals, limitable
from feeddrive.figures.figure import Figure, Limit
from feeddrive.figures.of_loops import COMPLIANCE_PEAK, ROPE_SNAP, STIFFNESS_LEAST
from feeddrive.language.errors import FeeddriveError, ParameterError, UnstableError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import USUAL, Quantity, number, span, unit_name
from feeddrive.language.table import Cell, Result, Table, chart_of
from feeddrive.language.text import Text, joined
from feeddrive.language.threads import cores
from feeddrive.loop.box import Box as Tolerances
from feeddrive.loop.control import Control
from feeddrive.plot import style
from feeddrive.plot.chart import ALERT, Abscissa, Box, Chart, Curve, Panel, stairs
from feeddrive.study.chunk import Chunk
from feeddrive.study.statistics import Share
from feeddrive.study.study import Bound, Study, StudyLike, read_study
from feeddrive.study.variants import variant_groups, variants
from feeddrive.tuning.control_response import ControlResponse
from feeddrive.tuning.criteria import Criteria, Limits
from feeddrive.tuning.operating_point import OperatingPoint, modelled_point
from feeddrive.tuning.tune import Tuned, tune_control

MOST = 5_000  # machines held in memory, about 100 kB each
KEPT = 2e-3  # relative violation that still counts as kept, as in the proof of a tuning
# Penalty weight relative to ln(goal): any violation outweighs every goal.
_VIOLATION = 1e3


@dataclass(frozen=True, eq=False)
class Scenarios:
    """The machines of a study on which a controller is evaluated.

    points    operating points with all frequency lines, for the tuner
    sparse    the same operating points with fewer frequency lines, for quick evaluation
    velocity  velocity of linearization, m/s
    bad       numbers of the variants that cannot be built, with the reasons
    """

    points: tuple[OperatingPoint, ...]
    sparse: tuple[OperatingPoint, ...]
    velocity: float
    bad: tuple[tuple[int, str], ...]

    def merits(self, control: Control, goal: Figure, limits: Limits, band: tuple[float, float]) -> Merits:
        """Return the goal value and the worst limit violation of a controller on each machine."""
        response = ControlResponse(control, self.points[0].sample_time, (), self.velocity)
        # Without free parameters: the controller is evaluated, not tuned.
        none = np.zeros(0)
        # Machines are evaluated one by one: each needs its own worst violation, not that of the set.
        goals, broken = np.full(len(self.points), np.inf), np.full(len(self.points), np.inf)
        for i, point in enumerate(self.sparse):
            try:
                judged = Criteria((point,), response, goal, limits, band)(none)
            except (FeeddriveError, ArithmeticError, np.linalg.LinAlgError):
                # A loop that cannot be evaluated keeps the infinite cost of an unstable one.
                continue
            if judged.stable and np.isfinite(judged.goal[0]):
                goals[i] = judged.goal[0]
                broken[i] = max((-bound.slack for bound in judged.bounds), default=-math.inf)
        return Merits(goals, broken)


@dataclass(frozen=True, eq=False)
class Merits:
    """The logarithm of the goal and the worst constraint violation of each machine; the violation is negative if all
    constraints are satisfied.

    Both are infinite if the loop is unstable.
    """

    goal: np.ndarray
    broken: np.ndarray

    @property
    def kept(self) -> np.ndarray:
        """True for machines that satisfy all limits."""
        return self.broken <= KEPT

    @property
    def severity(self) -> np.ndarray:
        """The merit of each machine, lower is better; machines that violate a limit rank behind all others."""
        with np.errstate(invalid="ignore"):
            excess = np.maximum(self.broken - KEPT, 0.0)
        return np.where(np.isfinite(self.goal), self.goal + _VIOLATION * excess, np.inf)


def scenarios(study: Study, samples: int, progress: Progress) -> Scenarios:
    """Return the first variants of a study as operating points, and list those that cannot be built.

    Raises ParameterError if the study varies the controller, or if its axis is coupled.
    """
    _require_axis(study)
    if not 1 <= samples <= MOST:
        raise ParameterError(f"samples = {samples} must be 1 to {MOST:,} machines, all of which are held in memory")
    drawn = variants(study, 0, min(samples, study.count))
    by_number: dict[int, OperatingPoint] = {}
    bad: list[tuple[int, str]] = []
    speeds: list[float] = []
    done = 0
    for group in variant_groups(study, drawn):
        velocity = group.speed
        for place, row in enumerate(group.rows.tolist()):
            progress.step("machines", done, len(drawn))
            done += 1
            number = drawn.first + row
            try:
                by_number[number] = modelled_point(group.loop(place), f"variant {number}", velocity=velocity)
            except FeeddriveError as error:
                bad.append((number, str(error)))
        speeds.append(velocity)
    if not by_number:
        raise ParameterError(f"no machine of the study can be made; variant {bad[0][0]}: {bad[0][1]}")
    # Groups are ordered by structure: restore the order of the variants.
    points = tuple(by_number[number] for number in sorted(by_number))
    sparse = tuple(point.chosen(point.sparse()) for point in points)
    # The control is linearized at one velocity for all machines; groups differ in it only if their motions do.
    return Scenarios(points, sparse, float(np.median(speeds)), tuple(sorted(bad)))


def _require_axis(study: Study) -> None:
    """Raise ParameterError if the axis is coupled, or if the study varies the controller."""
    base = next(study.bases())
    coupled = base.job.machine.coupled(base.axis)
    if coupled:
        raise ParameterError(f"{study.file.name}: {coupled}; the tuner works on one axis alone")
    place = f"{base.loop.place_of('control')}."
    for varied in study.vary:
        if any(path.startswith(place) for path in varied.paths) or varied.name == "row":
            raise ParameterError(
                f"{study.file.name}: '{varied.name}' varies the control, which is what is tuned: leave it out"
            )


def with_control(study: Study, control: Control) -> Study:
    """Return a copy of the study that has another controller on the same machines."""
    jobs = {}
    for key, job in study.jobs.items():
        loop = replace(job.loops[study.row], control=control)
        machines = dict(job.machines)
        # Coupled axes run as a machine, which holds the loop once more.
        if study.row in machines:
            whole = machines[study.row]
            machines[study.row] = whole.with_loops({**whole.loops(), loop.name: loop})
        jobs[key] = replace(job, loops={**job.loops, study.row: loop}, machines=machines)
    return replace(study, jobs=jobs)


STREAM = 1  # random stream of the newly drawn machines; the study itself uses stream 0


@dataclass(frozen=True, eq=False)
class Measured:
    """The figures of newly drawn machines under one controller, by key, shape (n,); a missing figure is NaN."""

    values: dict[str, np.ndarray]
    bounds: tuple[Bound, ...]
    figures: tuple[Figure, ...]

    @property
    def count(self) -> int:
        """The number of machines."""
        return len(next(iter(self.values.values())))

    def keeping(self, bound: Bound) -> Share:
        """Return the fraction of the machines that satisfy one bound."""
        return Share(int(np.sum(bound.kept(self.values[bound.figure.key]))), self.count)

    @property
    def good(self) -> np.ndarray:
        """True for the machines that satisfy all bounds, shape (n,)."""
        kept = [bound.kept(self.values[bound.figure.key]) for bound in self.bounds]
        return np.logical_and.reduce([np.ones(self.count, dtype=bool), *kept])

    @property
    def all(self) -> Share:
        """The yield: the fraction of the machines that satisfy all bounds."""
        return Share(int(np.sum(self.good)), self.count)

    def quantile(self, name: str, share: float) -> float:
        """Return a quantile of a figure over the machines for which it exists; NaN if there are none."""
        values = self.values[name]
        values = values[~np.isnan(values)]
        return float(np.quantile(values, share)) if values.size else float("nan")


def measured(
    study: Study,
    control: Control,
    bounds: Sequence[Bound],
    also: Sequence[Figure],
    count: int,
    workers: int | None,
    progress: Progress,
) -> Measured:
    """Return the figures of `count` newly drawn machines of a study under a controller."""
    wanted = {figure.key: figure for figure in (*(bound.figure for bound in bounds), *also)}
    fresh = replace(
        with_control(study, control),
        stream=STREAM,
        sampler="monte_carlo",
        points=count,
        count=count,
        # At least eight chunks, so that several workers share even a few hundred machines.
        chunk=max(16, min(256, -(-count // 8))),
        measure=tuple(wanted.values()),
    )
    chunks = [Chunk(fresh, number) for number in range(fresh.chunks)]
    rows = dict(Engine(workers or cores()).finished(chunks, progress))
    columns = {
        # Chunks finish in any order: they are joined by number, so that both controllers have the same machine in each
        # place.
        name: np.concatenate([rows[chunk].column(name).to_numpy() for chunk in chunks]).astype(np.float64)
        for name in wanted
    }
    return Measured(columns, tuple(bounds), tuple(wanted.values()))


def _limited(figure: Figure) -> tuple[Figure, bool]:
    """Return the study's figure that a tuner limit bounds, and True if it is the inverse of the limited figure."""
    return (STIFFNESS_LEAST, True) if figure == COMPLIANCE_PEAK else (figure, False)


def limits_of(study: Study, otherwise: Limits) -> Limits:
    """Return the tuner's limits: those in the specification of a study, and those of `otherwise` for other figures.

    The least stiffness is the inverse of the largest compliance.  Figures that need a simulation cannot be
    limits of the tuner; they are checked on the newly drawn machines.
    """
    stated = {bound.figure: bound for bound in study.specification}
    limits: list[Limit] = []
    for limited in limitable():
        measurable, inverse = _limited(limited)
        bound = stated.get(measurable)
        value = None if bound is None else bound.least if measurable.higher else bound.most
        if value is not None and not _needs_noise(limited):
            limits.append(Limit(limited, 1.0 / value if inverse else value))
    return otherwise.having(*limits)


def _needs_noise(figure: Figure) -> bool:
    """Return True for a figure that depends on measurement noise, which a study takes from the encoders."""
    return figure.limit is not None and figure.limit.noise


def bounds_of(study: Study, limits: Limits) -> tuple[Bound, ...]:
    """Return the study's specification, extended by the tuner's limits on figures without a bound in the study."""
    bounds = {bound.figure: bound for bound in study.specification}
    for limit in limits.limits:
        limited, inverse = _limited(limit.figure)
        if limited in bounds or _needs_noise(limit.figure):
            continue
        end = 1.0 / limit.bound if inverse else limit.bound
        bounds[limited] = Bound(limited, end if limited.higher else None, None if limited.higher else end)
    return tuple(bounds.values())


def is_limit(bound: Bound) -> bool:
    """Return True for a bound that the tuner can enforce."""
    known = {limited for limited, _ in map(_limited, limitable()) if not _needs_noise(limited)}
    return bound.figure in known and (bound.least if bound.figure.higher else bound.most) is not None


_ROUNDS = 16
_JOIN = 3  # machines added per round
_SAME = 5e-3  # tolerance in ln(goal) below which a worse machine is not added


@dataclass(frozen=True, eq=False, repr=False)
class Robust(Result):
    """One controller for the machines of a study.

    study            the machines
    tuned            the tuner's result on the machines of the active set, which are named `variant N`
    share            the fraction of the sampled machines that must satisfy the limits; 1 for all
    rounds           for each round: the number of machines in the active set, and the number of sampled machines
                     that satisfy all limits afterwards
    seen, seen_new   merits of the sampled machines under the existing controller and under the new one
    before, after    figures of the newly drawn machines under the existing controller and under the new one
    bad              numbers of the variants that cannot be built, with the reasons
    unsettled        the reason why the result may not be optimal for the sample; empty if it is optimal
    """

    study: Study
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
        """The machines in the tuner's final active set."""
        return tuple(each.point for each in self.tuned.after)

    @property
    def better(self) -> bool:
        """True if the new controller has at least as many good newly drawn machines as the existing one."""
        return self.after.all.kept >= self.before.all.kept

    def sentence(self) -> str:
        """Return the result as a sentence, with both yields."""
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
        """Tabulate the shares of newly drawn machines within each bound, and quantiles of the rope-snap figure."""
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
    """Return the chart of the figures of the newly drawn machines under both controllers."""
    return shares_chart(result.before, result.after)


def in_percent(share: Share) -> str:
    """Return a share of the newly drawn machines with its 95 % interval: `81.5 % (75.4 .. 86.6 %)`."""
    low, high = share.interval or (share.value, share.value)
    return Text(f"{Quantity(share.value, 'share'):3} ({span(low, high, 'share', '3', between='..')})")


def bound_sentence(bound: Bound) -> str:
    """Return a bound as text: `following_error_peak_m <= 30 um`."""
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
    box: Tolerances | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Robust:
    """Find the controller with the best worst case over sampled machines, and verify it on newly drawn machines.

    study     a study file, the name of a bundled study, or a `Study`; its specification sets the tuner's limits
    control   the initial controller of the search (default: that of the study's job)
    limits    limits on figures that the specification does not bound
    share     the fraction of the sampled machines to which limits and goal apply; the worst ones are excluded
    samples   the number of machines available to the tuner (default: the study's count, at most 1000)
    fresh     the number of newly drawn machines for verification (default: as many as sampled, at least 200)
    box       tolerances of the plant of the study's job: the limits hold over this box too, beside all machines
    workers   the number of processes for verification (default: all cores)

    All other arguments are as in `tune_control`.  Raises UnstableError, with the machine names, if no controller
    satisfies the limits on all machines to which they apply, and ParameterError if the study varies
    the controller, or if its axis is coupled.
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
        box=box,
        workers=workers,
        progress=progress,
    )
    return tuner.tuned(tuner.loop.control if control is None else control)


class RobustTuner:
    """A tuner for the machines of a study, which are drawn once for all controllers; arguments as in `tune_robust`."""

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
        box: Tolerances | None = None,
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
        self.starts, self.seed, self.box = starts, seed, box
        self.sample = scenarios(self.study, samples or min(self.study.count, 1000), self.progress)
        self.fresh = fresh or max(200, len(self.sample.points))

    def tuned(self, control: Control) -> Robust:
        """Tune from an initial controller. Raises UnstableError as `tune_robust` does."""
        search = _Search(self)
        tuned, unsettled = search.run(control)
        return Robust(
            self.study,
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

    def judged(self, control: Control) -> Merits:
        """Return the goal value and the worst limit violation of a controller on each sampled machine."""
        self.progress.step(f"{len(self.sample.points)} machines under the control")
        return self.sample.merits(control, goals()[self.goal], self.limits, self.band)

    @cached_property
    def seen_today(self) -> Merits:
        """The merits of the sampled machines under the existing controller."""
        return self.judged(self.loop.control)

    @cached_property
    def before(self) -> Measured:
        """The figures of the newly drawn machines under the existing controller."""
        return self._measured(self.loop.control)

    def _measured(self, control: Control) -> Measured:
        self.progress.step("machines that the tuner never saw")
        bounds = bounds_of(self.study, self.limits)
        return measured(self.study, control, bounds, (ROPE_SNAP,), self.fresh, self.workers, self.progress)


class _Search:
    """An active-set search: each round tunes on the machines that limit the result, plus those that became worse."""

    def __init__(self, tuner: RobustTuner) -> None:
        self.tuner = tuner
        # A product such as 0.55 * 100 = 55.00000000000001 must not round up to 56 machines.
        self.kept = math.ceil(tuner.share * len(tuner.sample.points) - 1e-9)
        self.rounds: list[tuple[int, int]] = []

    def run(self, control: Control) -> tuple[Tuned, str]:
        """Return the best controller of all rounds, and the reason why it may not be optimal (empty if there is none).

        Each round starts from the controller of the previous one.  Once no more machines are added, independent
        searches on the same machines either confirm the controller or find a better one, from which the rounds
        continue.
        """
        # A stable sort keeps ties, such as several unstable machines, in the order of their numbers.
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
            # A thorough result replaces an equal one, since only it is confirmed by independent searches.
            if best is None or worst < best[0] or (thorough and worst < best[0] + _SAME):
                best = worst, tuned
            # For a share < 1 the new controller may exclude a machine that was active.
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
        """Run the tuner on the machines in the active set; notches are added in the first round only."""
        of = self.tuner
        # Notches placed in the first round are part of the control from then on, and are only moved.
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
                box=of.box,
                around=[of.loop],
                progress=of.progress,
            )
        except UnstableError as error:
            named = ", ".join(point.name for point in points)
            raise UnstableError(
                f"no control keeps {of.limits.sentence()} on {named} together: {error}. Take a smaller share of the "
                "machines, wider limits, or closer tolerances"
            ) from None


def shares_chart(before: Measured, after: Measured) -> Chart:
    """Return the cumulative distribution of each figure over the machines; values outside the bounds are shaded."""
    bounds = {bound.figure.key: bound for bound in after.bounds}
    across = 2 if len(after.figures) > 1 else 1
    panels = tuple(_share(figure, before, after, bounds.get(figure.key)) for figure in after.figures)
    return Chart("", panels, across=across, height=0.7 + 2.3 * -(-len(panels) // across))


def _share(figure: Figure, before: Measured, after: Measured, bound: Bound | None) -> Panel:
    factor = USUAL.of(figure.unit)[1]
    spread = [factor * _sorted(machines.values[figure.key]) for machines in (before, after)]
    low, high = _range(spread)
    curves = list[Curve]()
    for i, (name, values) in enumerate(zip(("today", "new"), spread, strict=True)):
        # Divided by all machines, so that a curve ends below 100 % if some have no finite figure.
        share = 100.0 * np.arange(1, values.size + 1) / max(before.count, after.count)
        curves.append(Curve(*stairs(values, share), name, i))
    outside = list[Box]()
    if bound is not None and bound.least is not None:
        outside.append(Box(low, max(low, factor * bound.least), number=ALERT, pale=True))
    if bound is not None and bound.most is not None:
        outside.append(Box(min(high, factor * bound.most), high, number=ALERT, pale=True))
    label = f"{_axis_name(figure)}{f' ({unit_name(figure.unit)})' if figure.unit else ''}"
    return Panel(
        "machines below (%)",
        tuple(curves),
        boxes=tuple(outside),
        low=0.0,
        high=100.0,
        abscissa=Abscissa(label, low=low, high=high),
    )


def _sorted(values: np.ndarray) -> np.ndarray:
    """Return the finite values in ascending order."""
    return np.sort(values[np.isfinite(values)])


def _range(spread: list[np.ndarray]) -> tuple[float, float]:
    """Return the limits of an axis: the 0.5 % and 99.5 % quantiles of the values."""
    every = np.concatenate(spread)
    if not every.size:
        return 0.0, 1.0
    # A few nearly unstable machines would otherwise compress the curves of all others.
    low, high = (float(end) for end in np.quantile(every, [0.005, 0.995]))
    # The absolute term gives a constant figure a range even at 0.
    return style.padded(low, high) if high > low else (low - 0.5 * abs(low) - 1e-12, high + 0.5 * abs(high) + 1e-12)


def _axis_name(figure: Figure) -> str:
    """Return the axis label of a figure: its description, or its key if that is too long."""
    return figure.description if len(figure.description) <= 44 else figure.key.replace("_", " ")

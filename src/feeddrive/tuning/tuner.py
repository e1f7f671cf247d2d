"""The steps of a tuning: searches from several starts, then all frequency lines, with a reserve for the noise."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from feeddrive.blocks.filter.notch import Notch
from feeddrive.figures.figure import Figure
from feeddrive.figures.of_loops import SENSITIVITY_PEAK
from feeddrive.language import tree
from feeddrive.language.errors import NotIdentifiableError, UnstableError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text, joined
from feeddrive.loop.control import Control
from feeddrive.tuning.control_response import ControlResponse
from feeddrive.tuning.criteria import Criteria, needed, require_covered, require_good, some
from feeddrive.tuning.limits import Limits
from feeddrive.tuning.operating_point import OperatingPoint
from feeddrive.tuning.search import AGREE, End, Search, unconfirmed
from feeddrive.tuning.tunables import box, logarithms, scattered, speeds

_LADDER = np.log(2.0) * np.arange(2.0, -11.5, -0.5)  # factors 4 ... 1/2048
_NEAR = 0.3  # a start that violates its bounds by less is good enough
_PAYS = 0.02  # of the goal: least gain by a notch
_NOTCHES = 3  # that are tried
_LOUD, _APART = 0.15, 0.12  # |L| of a resonance that is worth a notch; of ln f from a notch that is there
_TURNS = 6  # rounds for the number of standard deviations to keep
_CUTS = 3  # rounds in which lines that the search had left out are added
_MORE = 3  # rounds from still other places, where those before did not confirm the best
_EASED = (1.6, 1.2)  # of the distance of Ms from 1: bounds that are taken first, 2.6 and 2.2 before 2.0
_WIDER, _WIDENED = np.log(10.0), 3  # by how much a range grows in which the best is at the end, and how often
_AT_END = 1e-2  # of a logarithm: distance that counts as the end
_POPULATION, _GENERATIONS = 8, 16  # points a tunable that go on from those all over the range, and how often
_COSTLY = 0.5  # of the goal: when noise costs more, the measurement is too poor


class Best(NamedTuple):
    """A control with the tunables that were varied and their final values."""

    control: Control
    names: tuple[str, ...]
    end: End
    criteria: Criteria
    sure: float
    cost: float
    spread: float
    unsettled: str
    box: tuple[np.ndarray, np.ndarray]


class Tuner:
    """One tuning: the same points, goal and limits for every set of tunables that is tried."""

    def __init__(
        self,
        points: tuple[OperatingPoint, ...],
        goal: Figure,
        limits: Limits,
        band: tuple[float, float],
        confidence: float,
        starts: int,
        seed: int,
        velocity: float,
        progress: Progress,
    ) -> None:
        self.points, self.goal, self.limits, self.band = points, goal, limits, band
        self.confidence, self.starts, self.velocity = confidence, starts, velocity
        self.random = np.random.default_rng(seed)
        self.kept = [point.sparse() for point in points]
        self.noisy = any(point.variance is not None for point in points)
        self.evaluations, self.progress = 0, progress

    def criteria(
        self, control: Control, names: tuple[str, ...], whole: bool = False, *, rough: bool = False
    ) -> Criteria:
        """Of a set of tunables, on the lines of the search or on all; with two rates also on half of them, `rough`."""
        response = ControlResponse(control, self.points[0].sample_time, names, self.velocity)
        kept = [some(lines, 2) for lines in self.kept] if rough else self.kept
        points = self.points if whole else tuple(s.chosen(k) for s, k in zip(self.points, kept, strict=True))
        return Criteria(points, response, self.goal, self.limits, self.band, near=rough)

    def tuned(self, control: Control, names: tuple[str, ...], starts: int | None = None) -> Best:
        """The best result of some searches, on all lines, with the reserve for the noise."""
        x = logarithms(control, names)
        low, high = box(control, names, x, self.points[0].sample_time)
        rough = control.law.period() > 1
        search = Search(self.criteria(control, names, rough=rough), low, high)
        search.report_to(self.progress, control, names)
        self.progress.step("where to begin")
        first = self._begin(search, x, speeds(control, names))
        self.progress.step(f"{len(names)} tunables, first search")
        wanted = self.starts if starts is None else starts
        ends, unsettled = self._searched(search, control, names, x, first, wanted)
        end = min(ends, key=lambda other: search.merit(other.judged))
        if rough:
            end = self._exactly(search, control, names, end)
        end = self._from_below(search, end, x, speeds(control, names))
        costs = [float(np.max(other.judged.goal)) for other in ends]
        end = self._on_all_lines(control, names, search, end)
        free, sure = float(np.max(end.judged.goal)), 0.0
        if self.noisy:
            require_good(search.criteria.answers(end.x), 1.0)
            sure = _one_sided(self.confidence)
            self.progress.step("room for the noise")
            for _ in range(_TURNS):
                search.sure = sure
                end = self._from_below(search, search.descend(end.x), x, speeds(control, names))
                end = self._on_all_lines(control, names, search, end)
                wanted = needed(self.criteria(control, names, whole=True)(end.x).bounds, sure, self.confidence)
                if abs(wanted - sure) < 0.03:
                    break
                sure = wanted
        cost = float(np.exp(float(np.max(end.judged.goal)) - free) - 1.0)
        if search.broken(end.judged) > 5e-3:
            require_covered(self.criteria(control, names, whole=True).answers(end.x))
            self._refuse(search, end)
        require_covered(self.criteria(control, names, whole=True).answers(end.x))
        if self.noisy:
            require_good(search.criteria.answers(end.x), 1.0)
            if cost > _COSTLY:
                self._too_costly(search, end, cost)
        self.evaluations += search.criteria.count
        spread = max(costs) - min(costs)
        return Best(control, names, end, search.criteria, sure, cost, spread, unsettled, (search.low, search.high))

    def _exactly(self, search: Search, control: Control, names: tuple[str, ...], end: End) -> End:
        """The end of a rough search, searched on with all images and all lines of the search."""
        self.evaluations += search.criteria.count
        search.criteria = self.criteria(control, names)
        if search.judge(end.x) is None:
            return search.descend(self._begin(search, end.x, speeds(control, names)))
        return search.descend(end.x, 0.05)

    def _searched(
        self, search: Search, control: Control, names: tuple[str, ...], x: np.ndarray, first: np.ndarray, starts: int
    ) -> tuple[list[End], str]:
        """The ends of all searches, and why the best of them does not count as settled; empty if it does.

        After the first, each round has two that know nothing of it and of each other: from the best of a population
        from all over the range, and by continuation in Ms from the best of other points.  The best is settled when one
        of either kind has come to it, and no range ends there that pays to be wider.
        """
        powers = speeds(control, names)
        ends, kinds = [search.descend(first)], ["start"]
        if starts < 2:
            return ends, "one search was made, and none confirms it"
        soft = np.array([_soft(control, name) for name in names])
        opened = ""
        for i in range(starts - 1 + _MORE):
            if i >= starts - 1 and not opened and not unconfirmed(search, ends, kinds):
                break
            self.progress.step(f"{len(names)} tunables, from all over their range")
            for kind in ("population", "continuation"):
                begun = self._elsewhere(search, x, powers, evolved=kind == "population")
                if begun is not None:
                    ends.append(self._continued(search, begun) if kind == "continuation" else search.descend(begun))
                    kinds.append(kind)
            ends, opened = self._widened(search, ends, soft, names)
        missing = unconfirmed(search, ends, kinds)
        return ends, joined("; ", filter(None, (missing, opened)))

    def _continued(self, search: Search, x: np.ndarray) -> End:
        """The end of searches under bounds of Ms that come down to the one that holds, each from the end before."""
        if self.limits.limit(SENSITIVITY_PEAK) is not None:
            for factor in _EASED:
                eased = self._under(search, self.limits.eased(SENSITIVITY_PEAK, factor))
                if eased.judge(x) is not None:
                    x = eased.descend(x).x
                self.evaluations += eased.criteria.count
        return search.descend(x)

    def _under(self, search: Search, limits: Limits) -> Search:
        """A search as the given one, within other limits."""
        known = search.criteria
        criteria = Criteria(known.points, known.control, self.goal, limits, self.band, near=known.near)
        other = Search(criteria, search.low, search.high)
        other.sure = search.sure
        return other

    def _widened(
        self, search: Search, ends: list[End], soft: np.ndarray, names: tuple[str, ...]
    ) -> tuple[list[End], str]:
        """The ends in ranges so wide that the best gains less than 5 % further out; and what still gains more."""
        reason = ""
        for _ in range(_WIDENED):
            place = min(range(len(ends)), key=lambda i: search.merit(ends[i].judged))
            end = ends[place]
            low, high = (soft & (np.abs(end.x - edge) < _AT_END) for edge in (search.low, search.high))
            if not np.any(low | high):
                return ends, ""
            before = search.low, search.high
            search.low, search.high = search.low - _WIDER * low, search.high + _WIDER * high
            wider = search.descend(end.x)
            gained = search.merit(end.judged) - search.merit(wider.judged)
            if gained < AGREE:
                search.low, search.high = before
                return ends, ""
            ends = [wider if other is end else search.descend(other.x) for other in ends]
            at = [name for name, outside in zip(names, low | high, strict=True) if outside]
            reason = f"{', '.join(at)} at the end of the range of the search, and further out is better"
        return ends, reason

    def as_it_is(self, control: Control, names: tuple[str, ...]) -> Best:
        """A control without a further search, with the tunables it names."""
        x = logarithms(control, names)
        criteria = self.criteria(control, names, whole=True)
        search = Search(criteria, x, x)
        evaluation = search.judge(x)
        if evaluation is None:
            raise UnstableError("the loop is unstable with these gains: take another rule, or search with a goal")
        answers = criteria.answers(x)
        require_covered(answers)
        if self.noisy:
            require_good(answers, 1.0)
        self.evaluations += 1
        return Best(
            control,
            names,
            End(x, evaluation, {}, search.broken(evaluation)),
            criteria,
            0.0,
            0.0,
            0.0,
            "",
            (x - 1.0, x + 1.0),
        )

    def _begin(self, search: Search, x: np.ndarray, powers: np.ndarray) -> np.ndarray:
        """Start of a search: the given values if they are good enough, else the best point of a slower loop."""
        here = search.judge(x)
        if here is not None and search.broken(here) < _NEAR:
            return x
        rungs = [np.clip(x + step * powers, search.low, search.high) for step in _LADDER]
        judged = [(search.judge(rung), rung) for rung in rungs]
        stable = [(evaluation, rung) for evaluation, rung in judged if evaluation is not None]
        if not stable:
            raise UnstableError(
                "no setting was found in which the loop is stable, as it is and with all its gains lower down to a "
                "2000th: check the sign of the response, its unit (m/N), masses, filters and dead time"
            )
        return min(stable, key=lambda pair: (search.merit(pair[0]), abs(float(np.sum(pair[1] - x)))))[1]

    def _from_below(self, search: Search, end: End, x: np.ndarray, powers: np.ndarray) -> End:
        """The end; if it breaks a bound, that of a search from the fastest loop that is slow enough to keep all."""
        if search.broken(end.judged) <= 2e-3:
            return end
        for step in _LADDER[_LADDER <= 0.0]:
            rung = np.clip(x + step * powers, search.low, search.high)
            evaluation = search.judge(rung)
            if evaluation is not None and search.broken(evaluation) <= 0.0:
                other = search.descend(rung)
                return other if search.broken(other.judged) < search.broken(end.judged) else end
        return end

    def _elsewhere(
        self, search: Search, x: np.ndarray, powers: np.ndarray, *, evolved: bool = True
    ) -> np.ndarray | None:
        """Where another search begins: the best of points from all over the box, or what they have come to as a
        population.
        """
        points = scattered(x, search.low, search.high, powers, self.random)
        merits = search.look(points)
        if not evolved:
            best = int(np.argmin(merits))
            return points[best] if np.isfinite(merits[best]) else None
        chosen = np.argsort(merits)[: _POPULATION * max(x.size, 3)]
        points, merits = search.evolve(points[chosen], merits[chosen], self.random, _GENERATIONS)
        return points[0] if np.isfinite(merits[0]) else None

    def _on_all_lines(self, control: Control, names: tuple[str, ...], search: Search, end: End) -> End:
        """The end, searched on with the lines on which a bound is broken, until none is."""
        for _ in range(_CUTS):
            whole = self.criteria(control, names, whole=True)
            evaluation = whole(end.x)
            added = False
            for bound in evaluation.bounds:
                point = self.points[bound.point]
                if search.sure * bound.deviation - bound.slack > 1e-3 and bound.frequency > 0.0:
                    k = min(int(np.searchsorted(point.frequency, bound.frequency)), point.frequency.size - 1)
                    beside = np.arange(max(k - 1, 0), min(k + 2, point.frequency.size))
                    if not np.all(np.isin(beside, self.kept[bound.point])):
                        self.kept[bound.point] = np.union1d(self.kept[bound.point], beside)
                        added = True
            if not added:
                return end
            self.evaluations += search.criteria.count
            search.criteria = self.criteria(control, names)
            if search.judge(end.x) is None:
                return end
            end = search.descend(end.x, 0.05)
        return end

    def _refuse(self, search: Search, end: End) -> None:
        """Raise UnstableError with the conflicting bounds and the values that can be reached."""
        worst = min(end.judged.bounds, key=lambda b: b.slack - search.sure * b.deviation)
        noise = ""
        if search.sure * worst.deviation > 0.5 * abs(worst.slack - search.sure * worst.deviation):
            noise = ", for the noise of the measurement there, and it"
        beyond = Quantity(search.sure * worst.deviation - worst.slack, "share")
        where = f" at {Quantity(worst.frequency, 'Hz')}" if worst.frequency > 0.0 else ""
        near = [b for b in end.judged.bounds if search.room(b) - b.slack > 0.5 * search.broken(end.judged)]
        others = {bound.kind: bound.figure for bound in sorted(near, key=lambda bound: bound.kind)}
        others.pop(worst.kind, None)
        against = f", in conflict with {', '.join(others)}" if others else ""
        texts = [self._reachable(search, end, figure) for figure in (worst.figure, *others.values())]
        reached = [text for text in texts if text]
        best = f"; reachable, each with the other limits kept: {joined(' or ', reached)}" if reached else ""
        raise UnstableError(
            f"no setting was found that keeps {self.limits.sentence()}: {worst.kind}{where} "
            f"('{self.points[worst.point].name}'){noise} stays {beyond:3} beyond its limit{against}{best}; ease a "
            "limit, or add a filter there"
        )

    def _reachable(self, search: Search, end: End, figure: Figure | None) -> str:
        """The limit of a figure that can be met with all others unchanged; empty if relaxing it does not help."""
        if figure is None:
            return ""

        def eased(factor: float) -> bool:
            self.progress.step(f"what {figure.title} can be reached")
            other = self._under(search, self.limits.eased(figure, factor))
            if other.judge(end.x) is None:
                return False
            return other.broken(other.descend(end.x).judged) <= 2e-3

        factors = [1.1, 1.3, 1.7, 2.5, 4.0, 8.0, 20.0, 100.0]
        wide = next((i for i, factor in enumerate(factors) if eased(factor)), None)
        if wide is None:
            return ""
        low, high = (1.0, *factors)[wide], factors[wide]
        for _ in range(3):
            middle = float(np.sqrt(low * high))
            low, high = (low, middle) if eased(middle) else (middle, high)
        limits = self.limits.eased(figure, high)
        limit = limits.limit(figure)
        return "" if limit is None else limits.text(limit)

    def _too_costly(self, search: Search, end: End, cost: float) -> None:
        """Report the frequency at which the noise costs most."""
        forced = [b for b in end.judged.bounds if end.force.get(b.key, 0.0) > 0.0 and b.deviation > 0.0]
        worst = max(forced or end.judged.bounds, key=lambda b: end.force.get(b.key, 0.0) * b.deviation)
        raise NotIdentifiableError(
            f"do not tune, measure again: the noise of '{self.points[worst.point].name}' costs "
            f"{Quantity(cost, 'share'):3} of the goal, most of it from "
            f"{Quantity(0.7 * worst.frequency, 'Hz', bare=True)} to {Quantity(1.4 * worst.frequency, 'Hz')}, where "
            f"{worst.kind} is only known to {Quantity(worst.deviation, 'share'):2}; excite this band more strongly, or "
            "average longer"
        )

    def with_notches(self, best: Best, tried: list[str]) -> Best:
        """Notches at the remaining large resonances, one after the other, as long as each improves the goal."""
        for frequency in self._loud(best)[:_NOTCHES]:
            self.progress.step(Text(f"a notch at {Quantity(frequency, 'Hz')}"))
            # nearly without effect, so that the search begins where the last one ended
            notch = Notch(frequency=frequency, damping_zero=0.35, damping_pole=0.4)
            control = replace(best.control, filters=(*best.control.filters, notch))
            here = dict(zip(best.names, np.exp(best.end.x), strict=True))
            control = tree.rebuild(control, (float(here.get(n, v)) for n, v in tree.leaves(control)))
            i = len(control.filters) - 1
            names = (*best.names, *(f"filters.{i}.{field}" for field in ("frequency", "damping_zero", "damping_pole")))
            try:
                other = self.tuned(control, names, starts=1)
            except (UnstableError, NotIdentifiableError):
                continue
            gained = float(np.max(best.end.judged.goal) - np.max(other.end.judged.goal))
            ended = float(np.exp(other.end.x[len(best.names)]))
            if gained > _PAYS:
                tried.append(
                    Text(
                        f"at {Quantity(ended, 'Hz')} (begun at {Quantity(frequency, 'Hz')}): gains "
                        f"{Quantity(gained, 'share'):2}, taken"
                    )
                )
                best = other
            else:
                tried.append(
                    Text(
                        f"at {Quantity(frequency, 'Hz')}: would gain {Quantity(max(gained, 0.0), 'share'):2}, not taken"
                    )
                )
        return best

    def _loud(self, best: Best) -> list[float]:
        """Frequencies of the largest resonances of the loop gain above the crossover."""
        names = dict(zip(best.names, np.exp(best.end.x), strict=True))
        taken = [
            names.get(f"filters.{i}.frequency", filter_.frequency)
            for i, filter_ in enumerate(best.control.filters)
            if isinstance(filter_, Notch)
        ]
        peaks: dict[float, float] = {}
        for answer in self.criteria(best.control, best.names, whole=True).answers(best.end.x):
            f, size = answer.point.frequency, np.abs(answer.gain)
            above = np.flatnonzero(size >= 1.0)
            crossover = f[above[0]] if above.size else f[0]
            for k in range(2, f.size - 2):
                peak = size[k] == np.max(size[k - 2 : k + 3]) and size[k] > _LOUD and f[k] > 1.2 * crossover
                if peak and all(abs(np.log(f[k] / other)) > _APART for other in (*taken, *peaks)):
                    peaks[float(f[k])] = float(size[k])
        return sorted(peaks, key=lambda frequency: -peaks[frequency])


def _soft(control: Control, name: str) -> bool:
    """Whether the range of a tunable is only that of the search: not for filters, and not for what Nyquist bounds."""
    return not name.startswith("filters.") and tree.declaration(control, name).unit != "Hz"


def _one_sided(confidence: float) -> float:
    from scipy.special import ndtri

    return float(ndtri(confidence))

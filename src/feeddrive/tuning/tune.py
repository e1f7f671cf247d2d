"""Tuning: optimize gains and filters of a controller on measured or modelled axes, and verify the result.

The module contains, in this order, the tunables and their ranges, the steps of a tuning (`Tuner`), the result with its
recommendation in words (`Tuned`), and the functions for users (`tune_control`, `assess`).
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import NamedTuple

import numpy as np

from feeddrive.analysis.margins import Margins, margins
from feeddrive.blocks.axis_model import POWERS
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.families import Observer
from feeddrive.blocks.filter.notch import Notch
from feeddrive.figures.catalogue import goals
from feeddrive.figures.figure import Figure, Goal, Limit
from feeddrive.figures.of_loops import FORCE_NOISE, SENSITIVITY_PEAK
from feeddrive.language import tree
from feeddrive.language.errors import FeeddriveError, NotIdentifiableError, ParameterError, UnstableError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import USUAL, Quantity, number, span
from feeddrive.language.table import UNIT, Cell, Column, Result, Table
from feeddrive.language.text import Text, joined
from feeddrive.language.units import rounded
from feeddrive.loop.box import Box, Corner
from feeddrive.loop.control import Control
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.loop import Loop
from feeddrive.tuning.closed_loop import Figures, figures, reported
from feeddrive.tuning.control_response import ControlResponse
from feeddrive.tuning.criteria import (
    Criteria,
    Evaluation,
    Limits,
    chance,
    judged,
    needed,
    require_covered,
    require_good,
)
from feeddrive.tuning.filters import HIGHEST_FILTER
from feeddrive.tuning.operating_point import OperatingPoint, modelled_point, position_loop, response_on
from feeddrive.tuning.proof import Checked, of_known, of_measurement, of_model
from feeddrive.tuning.screen import ScreenedPlants, can_screen
from feeddrive.tuning.search import AGREE, PENALTY, End, Search, unconfirmed
from feeddrive.tuning.worst import BoxPlants, Examination, Examined, OverBox, box_plants, over_box, worst_plants

_RANGE = math.log(1e3)  # largest factor between a gain and its start value
_FILTER = math.log(4.0)  # largest factor between the frequency of a filter and its start value
_RATIOS = {"damping_zero": (0.02, 1.0), "damping_pole": (0.05, 1.5), "damping": (0.3, 1.5)}
_RATIO = (0.02, 20.0)  # range of a dimensionless tunable of a law


def law_tunables(control: Control) -> tuple[str, ...]:
    """Return the tunables of a law. Raises ParameterError for a law without tunables."""
    names = own_tunables(control)
    if not names:
        raise ParameterError(
            f"the law '{control.law.kind}' names no tunables: state which parameters are to be tuned (tunables=...)"
        )
    return names


def own_tunables(control: Control) -> tuple[str, ...]:
    """Return the dotted names of the tunables that the law, its observers and its compensations declare.

    If the law declares none, its positive parameters without a default take their place.
    """
    law, there = control.law, dict(tree.leaves(control))
    names = [f"law.{name}" for name in law.tuned()]
    for i, block in enumerate(control.compensation):
        observer = getattr(block, "observer", None)
        if isinstance(observer, Observer):
            names += [f"compensation.{i}.observer.{name}" for name in observer.tunables]
    return tuple(dict.fromkeys(name for name in names if name in there))


def filter_tunables(control: Control) -> tuple[str, ...]:
    """Return the dotted names of all filter parameters with a positive value: frequencies and damping ratios."""
    leaves = ((name, value) for name, value in tree.leaves(control) if name.startswith("filters."))
    return tuple(name for name, value in leaves if isinstance(value, float) and value > 0.0)


def logarithms(control: Control, names: Sequence[str]) -> np.ndarray:
    """Return the logarithms of the tunables. Raises ParameterError for a value that is not a positive number."""
    values: list[float] = []
    for name in names:
        value = tree.get(control, name)
        if not isinstance(value, (int, float)) or not value > 0.0:
            raise ParameterError(f"{name} = {value!r} is not a tunable: its start value must be a number > 0")
        values.append(math.log(value))
    return np.array(values)


def box(control: Control, names: Sequence[str], x: np.ndarray, sample_time: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the lower and upper ends of the search ranges of all tunables, as logarithms."""
    low, high = x - _RANGE, x + _RANGE
    for i, name in enumerate(names):
        unit, last = tree.declaration(control, name).unit, name.rpartition(".")[2]
        if unit == "":
            a, b = _RATIOS.get(last, _RATIO) if name.startswith("filters.") else _RATIO
            # a start value outside the usual range stays admissible
            low[i], high[i] = min(math.log(a), x[i]), max(math.log(b), x[i])
        elif name.startswith("filters."):
            low[i], high[i] = x[i] - _FILTER, x[i] + _FILTER
        if unit == "Hz":
            high[i] = min(high[i], math.log(HIGHEST_FILTER / sample_time))
    return low, np.maximum(high, low)


def speeds(control: Control, names: Sequence[str]) -> np.ndarray:
    """Return, for each tunable, the power of a bandwidth factor with which it scales; 0 for filters.

    If every tunable scales with its power of the factor, the whole loop becomes faster by the factor.
    """
    return np.array(
        [
            0.0 if name.startswith("filters.") else float(POWERS.get(tree.declaration(control, name).unit, (0, 0))[1])
            for name in names
        ]
    )


def readable(control: Control, name: str) -> str:
    """Return the name of a tunable with the kind of its filter, such as filters.0 (notch) frequency."""
    parts = name.split(".")
    if parts[0] == "filters" and len(parts) == 3:
        return f"filters.{parts[1]} ({control.filters[int(parts[1])].kind}) {parts[2]}"
    return name


_RUNGS = math.log(2.0) * np.arange(2.0, -8.0, -1.0)  # factors of speed 4 ... 1/128
_SHAPES = 8  # sets of ratios per tunable, except the first one
_WIDE, _RATIO_WIDE = math.log(30.0), math.log(6.0)  # largest factor of a gain and of a ratio, up and down


def scattered(
    x: np.ndarray, low: np.ndarray, high: np.ndarray, powers: np.ndarray, random: np.random.Generator
) -> np.ndarray:
    """Return points over the whole search range, shape (points, tunables).

    The ratios between the tunables are drawn from a Latin hypercube. Whether a point satisfies the bounds depends
    mainly on the bandwidth of the whole loop; each set of ratios is therefore scaled to ten bandwidths.
    Source: McKay, Beckman & Conover 1979 (Latin hypercube).
    """
    count = _SHAPES * max(x.size - 1, 2)
    wide = np.where(powers == 0.0, _RATIO_WIDE, _WIDE)
    below, above = np.maximum(low, x - wide), np.minimum(high, x + wide)
    strata = np.array([random.permutation(count) for _ in x]).T
    shapes = below + (above - below) * (strata + random.random((count, x.size))) / count
    return np.clip((shapes[:, None] + _RUNGS[:, None] * powers).reshape(-1, x.size), low, high)


_SMALLER = ", or take a smaller box of plants (--box), or the model alone (--box none)"
_AT_ODDS = 5e-3  # of a limit: a violation at the end of all searches with which they are at odds
_ROUNDS = 12  # rounds in which plants of a box join
_JOIN = 2  # plants that join in a round
_PLENTY = 0.03  # of a logarithm: plants of a box at which every limit has more slack are left out of a search
_SPARSER = 3.0  # times fewer lines of a plant of a box than of a point with a goal
_LADDER = np.log(2.0) * np.arange(2.0, -11.5, -0.5)  # factors 4 ... 1/2048
_NEAR = 0.3  # largest violation of a bound with which a start is good enough
_PAYS = 0.02  # of the goal: least gain for which a notch is kept
_FLAT = 0.02  # of a logarithm: a notch that is less deep is none
_NOTCHES = 3  # largest number of notches that are tried
_LOUD, _APART = 0.15, 0.12  # least |L| of a resonance for a notch; least distance in ln f from another notch
# iterations for the number of standard deviations, which depends on the bounds active at the end
_TURNS = 6
_SETTLED = 0.03  # standard deviations: a smaller change of the reserve ends them
_KEPT = 2e-3  # of a limit: a bound violated by less counts as kept
_CUTS = 3  # rounds in which lines that the search had left out are added
_MORE = 3  # further rounds of searches if those before did not confirm the best
_EASED = (1.6, 1.2)  # factors of Ms - 1 in a continuation: bounds 2.6 and 2.2 come before 2.0
_WIDER, _WIDENED = np.log(10.0), 3  # growth of a range at whose limit the best value lies; most extensions
_AT_END = 1e-2  # of a logarithm: distance within which a value counts as being at the limit
_POPULATION, _GENERATIONS = 8, 16  # points per tunable in the population, and number of generations
_ROUGH = 10  # of these, the first ones of a multirate controller, with its law at one rate
# share of the goal: if the noise costs more, the measurement is too poor
_COSTLY = 0.5


class Best(NamedTuple):
    """The best result of the searches for one set of tunables.

    control    the controller, with the tunables at their start values
    names      the tunables
    end        the end of the best search, with the final values
    sure       margin to every bound in standard deviations
    cost       relative increase of the goal due to this margin
    spread     relative difference of the goal between the worst and the best search
    unsettled  reason why the result is not confirmed; empty if it is
    box        lower and upper ends of the search ranges, as logarithms
    agreed     number of searches that ended within 5 % of the best one, itself included, and of all searches
    """

    control: Control
    names: tuple[str, ...]
    end: End
    criteria: Criteria
    sure: float
    cost: float
    spread: float
    unsettled: str
    box: tuple[np.ndarray, np.ndarray]
    agreed: tuple[int, int] = (0, 0)


class Tuner:
    """A tuning task: points, goal and limits, which are the same for every set of tunables that is tried."""

    _whole: tuple[Control, tuple[str, ...], Criteria] | None = None
    boxes: Sequence[BoxPlants] = ()

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
        box: Box | None = None,
        around: Sequence[Loop] | None = None,
    ) -> None:
        self.points, self.goal, self.limits, self.band = points, goal, limits, band
        # plants of the box join the points one by one, as soon as they exceed a limit
        self.stated, self.joined = points, list[tuple[int, Corner]]()
        # around a measured point lie the plants of a model that agrees with it
        models = ((point.name, point.loop or point.known_as) for point in points)
        loops = [(name, loop) for name, loop in models if loop is not None]
        if around is not None:
            loops = [(loop.name if len(around) > 1 else "model", loop) for loop in around]
        self.boxes = [] if box is None else [box_plants(box, loop, name, velocity) for name, loop in loops]
        self.confidence, self.starts, self.velocity = confidence, starts, velocity
        self.random = np.random.default_rng(seed)
        # lines that a search turns out to need are added here and stay for the following searches
        self.kept = [point.sparse() for point in points]
        self.noisy = any(point.variance is not None for point in points)
        self.evaluations, self.progress = 0, progress

    def on_all_lines(self, control: Control, names: tuple[str, ...]) -> Criteria:
        """Return the criteria on all lines. Those of the same control are kept, with what they have evaluated."""
        if self._whole is None or self._whole[0] is not control or self._whole[1] != names:
            self._whole = control, names, self.criteria(control, names, whole=True)
        return self._whole[2]

    def criteria(
        self, control: Control, names: tuple[str, ...], whole: bool = False, *, rough: bool = False
    ) -> Criteria:
        """Return the criteria for a set of tunables, on the lines of the search or, if `whole`, on all lines.

        rough  for a multirate controller: True to use its single-rate law, which omits the hold of the slow part but is
               evaluated a hundred times faster
        """
        control = replace(control, law=control.law.at_one_rate()) if rough else control
        response = ControlResponse(control, self.points[0].sample_time, names, self.velocity)
        points = self.points if whole else tuple(s.chosen(k) for s, k in zip(self.points, self.kept, strict=True))
        screened = () if whole or not can_screen(response, self.limits) else self._screened()
        return Criteria(points, response, self.goal, self.limits, self.band, screened=screened)

    def _screened(self) -> tuple[ScreenedPlants, ...]:
        """Return the plants of the box that have joined for the looks of a search; empty if one cannot be screened."""
        screens = [plants.screen for plants in self.boxes]
        of_box = [[corner for box, corner in self.joined if box == i] for i in range(len(screens))]
        if any(screen is None and corners for screen, corners in zip(screens, of_box, strict=True)):
            return ()
        return tuple(
            ScreenedPlants(screen, corners)
            for screen, corners in zip(screens, of_box, strict=True)
            if screen is not None and corners
        )

    def _join(self, plants: Sequence[Examined]) -> None:
        """Add plants of the box to the points at which the limits apply; one that is there gets all of its lines."""
        for plant in plants:
            place = self._place(plant)
            if place in self.joined:
                i = len(self.stated) + self.joined.index(place)
                self.kept[i] = np.arange(self.points[i].frequency.size)
            else:
                point = plant.plants.point(plant.corner)
                self.points += (point,)
                self.kept.append(point.sparse(_SPARSER))
                self.joined.append(place)
        # the criteria on all lines belong to the points before
        self._whole = None

    def _place(self, plant: Examined) -> tuple[int, Corner]:
        return self.boxes.index(plant.plants), plant.corner

    def _on_all(self, plant: Examined) -> bool:
        """Return True for a plant that has joined with all of its lines."""
        place = self._place(plant)
        if place not in self.joined:
            return False
        i = len(self.stated) + self.joined.index(place)
        return self.kept[i].size == self.points[i].frequency.size

    def _prune(self, criteria: Criteria, x: np.ndarray) -> None:
        """Remove the plants of the box at which no limit is nearly used at x."""
        try:
            slacks = {bound.point: bound.slack for bound in sorted(criteria(x).bounds, key=lambda b: -b.slack)}
        except (FeeddriveError, ArithmeticError, np.linalg.LinAlgError):
            return
        first = len(self.stated)
        used = [*range(first), *(i for i in range(first, len(self.points)) if slacks.get(i, np.inf) < _PLENTY)]
        self.points, self.kept = tuple(self.points[i] for i in used), [self.kept[i] for i in used]
        self.joined = [self.joined[i - first] for i in used if i >= first]
        self._whole = None

    def _joining(self, plants: Iterable[Examined]) -> list[Examined]:
        """Return the plants that are to join, with more lines if they have: of those that exceed a limit the worst."""
        exceeding = sorted((plant for plant in plants if plant.used > 1.0), key=lambda plant: -plant.used)
        return [plant for plant in exceeding if not self._on_all(plant)][:_JOIN]

    def _over_corners(
        self,
        search: Search,
        control: Control,
        names: tuple[str, ...],
        x: np.ndarray,
        *,
        rough: bool = False,
        prune: bool = False,
    ) -> np.ndarray:
        """Search from x until no corner of the box exceeds a limit; the worst corners join after each search.

        prune  True to remove those at which all limits have plenty of room in the end: every plant costs time in the
               searches to come, and it joins again where it exceeds a limit

        Returns the start of the next search, at which the loop is stable at all points.
        """
        if not self.boxes:
            return x
        for _ in range(_ROUNDS):
            self.progress.step("worst plants of the box")
            if search.judge(x) is None:
                x = self._begin(search, x, speeds(control, names))
            end = search.descend(x)
            x = end.x
            # more plants do not help where the limits contradict each other at those that have joined
            if self.joined and search.broken(end.judged) > _AT_ODDS:
                break
            search.penalty = PENALTY
            at = tree.vary(control, dict(zip(names, np.exp(x).tolist(), strict=True)))
            at = replace(at, law=at.law.at_one_rate()) if rough else at
            examination = Examination(at, self.points[0].sample_time, self.limits, self.velocity)
            joining = self._joining(plant for plants in self.boxes for plant in examination.corners(plants))
            if not joining:
                break
            self._join(joining)
            self.evaluations += search.criteria.count
            search.criteria = self.criteria(control, names, rough=rough)
        if self.joined and prune:
            self._prune(search.criteria, x)
            search.criteria = self.criteria(control, names, rough=rough)
        return x if search.judge(x) is not None else self._begin(search, x, speeds(control, names))

    def over_box(self, best: Best) -> tuple[Best, OverBox | None]:
        """Return the result with its limits kept over all of the box, and what was examined of it; None without a box.

        Plants between the corners that exceed a limit join the points, and the search goes on, for a few rounds.
        """
        if not self.boxes:
            return best, None
        examined, joining = None, list[Examined]()
        for turn in range(_ROUNDS + 1):
            values = dict(zip(best.names, np.exp(best.end.x).tolist(), strict=True))
            self.progress.step("worst plants of the box")
            control = tree.vary(best.control, values)
            known = worst_plants(control, self.boxes, self.limits)
            joining = self._joining(known[1])
            if not joining or turn == _ROUNDS:
                examined, plants = over_box(control, self.boxes, self.limits, known=known)
                joining = self._joining(plants)
                if not joining or turn == _ROUNDS:
                    break
            self._join(joining)
            search = Search(self.criteria(best.control, best.names), *best.box, best.sure)
            x, powers = best.end.x, speeds(best.control, best.names)
            if search.judge(x) is None:
                x = self._begin(search, x, powers)
            end = search.descend(x)
            if search.broken(end.judged) > _KEPT:
                # with the raised penalty a search from below would stay at the first bound that it meets
                search.penalty = PENALTY
                end = self._from_below(search, end, x, powers)
            end = self._on_all_lines(best.control, best.names, search, end)
            self.evaluations += search.criteria.count
            if search.broken(end.judged) > _AT_ODDS:
                self._refuse(search, end)
            best = best._replace(end=end, criteria=search.criteria)
        if joining and examined is not None and examined.holds:
            examined = replace(examined, reason=f"after {_ROUNDS} rounds plants of the box still exceed a limit")
        return best, examined

    def tuned(
        self, control: Control, names: tuple[str, ...], starts: int | None = None, *, trial: bool = False
    ) -> Best:
        """Run several searches; return the best result, verified on all lines, with a margin for the noise.

        If a `trial` is refused, the error does not state the attainable limits, which would require several searches.
        """
        x = logarithms(control, names)
        low, high = box(control, names, x, self.points[0].sample_time)
        rough = control.law.period() > 1
        search = Search(self.criteria(control, names, rough=rough), low, high)
        if not self.boxes:
            search.report_to(self.progress, control, names)
        self.progress.step("where to begin")
        first = self._begin(search, x, speeds(control, names))
        self.progress.step(f"{len(names)} tunables, first search")
        first = self._over_corners(search, control, names, first, rough=rough, prune=True)
        if self.boxes:
            # before the worst corners have joined, the best control is one that breaks the limits there
            search.report_to(self.progress, control, names)
            judged = search.judge(first)
            if judged is not None:
                search.accepted(first, judged)
        wanted = self.starts if starts is None else starts
        ends, unsettled = self._searched(search, control, names, x, first, wanted)
        end = min(ends, key=lambda other: search.merit(other.judged))
        if rough:
            end = self._exactly(search, control, names, end)
        # a descent may end at a violated bound although a slower loop keeps all of them
        end = self._from_below(search, end, x, speeds(control, names))
        # another search may have ended where other plants are the worst
        if self.boxes:
            end = search.descend(self._over_corners(search, control, names, end.x))
        merits = [search.merit(other.judged) for other in ends]
        agreed = sum(merit < min(merits) + AGREE for merit in merits), len(ends)
        costs = [float(np.max(other.judged.goal)) for other in ends]
        end = self._on_all_lines(control, names, search, end)
        free, sure = float(np.max(end.judged.goal)), 0.0
        if self.noisy:
            require_good(search.criteria.answers(end.x), 1.0)
            sure = _one_sided(self.confidence)
            self.progress.step("room for the noise")
            # the reserve changes the optimum and with it the bounds that share the probability, and the next one need
            # not be better: of those that keep the confidence the best one counts
            sure_ends: list[tuple[End, float]] = []
            evolved = wanted > 1  # at most once: it costs as much as a first search
            for _ in range(_TURNS):
                search.sure = sure
                end = search.descend(end.x)
                if search.broken(end.judged) > _KEPT:
                    end = self._kept(search, end, x, speeds(control, names), evolved=evolved)
                    evolved = False
                end = self._on_all_lines(control, names, search, end)
                wanted = needed(self.on_all_lines(control, names)(end.x).bounds, sure, self.confidence)
                if wanted < sure + _SETTLED and search.broken(end.judged) <= _KEPT:
                    sure_ends.append((end, sure))
                # where a bound stays violated a larger reserve violates it more
                if abs(wanted - sure) < _SETTLED or (wanted > sure and search.broken(end.judged) > _KEPT):
                    break
                sure = wanted
            end, sure = min(sure_ends, key=lambda kept: float(np.max(kept[0].judged.goal)), default=(end, sure))
            search.sure = sure
        cost = float(np.exp(float(np.max(end.judged.goal)) - free) - 1.0)
        # a missing band explains more than conflicting limits, so it is checked before the refusal
        if search.broken(end.judged) > _AT_ODDS:
            require_covered(self.on_all_lines(control, names).answers(end.x))
            if trial:
                raise UnstableError(f"no setting was found that keeps {self.limits.sentence()}")
            self._refuse(search, end)
        require_covered(self.on_all_lines(control, names).answers(end.x))
        if self.noisy:
            require_good(search.criteria.answers(end.x), 1.0)
            if cost > _COSTLY:
                self._too_costly(search, end, cost)
        self.evaluations += search.criteria.count
        spread = max(costs) - min(costs)
        ranges = search.low, search.high
        return Best(control, names, end, search.criteria, sure, cost, spread, unsettled, ranges, agreed)

    def _exactly(self, search: Search, control: Control, names: tuple[str, ...], end: End) -> End:
        """Continue a search made with the single-rate law, using the multirate law itself."""
        self.evaluations += search.criteria.count
        search.criteria = self.criteria(control, names)
        if search.judge(end.x) is None:
            return search.descend(self._begin(search, end.x, speeds(control, names)))
        # a small trust region: the end of the rough search is near
        return search.descend(end.x, 0.05)

    def _searched(
        self, search: Search, control: Control, names: tuple[str, ...], x: np.ndarray, first: np.ndarray, starts: int
    ) -> tuple[list[End], str]:
        """Return the results of all searches, and the reasons why the best one is not settled; empty if it is.

        After the first search, each round adds two independent searches. One starts from the best point of a population
        that was evolved over the whole range; the other starts from the best of other random points and tightens the
        limit of Ms step by step (continuation). The best result is settled if searches of both kinds have reached it
        and wider ranges do not improve it.
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
                # it was looked at without the rules of its blocks
                if begun is not None and search.judge(begun) is not None:
                    ends.append(self._continued(search, begun) if kind == "continuation" else search.descend(begun))
                    kinds.append(kind)
            ends, opened = self._widened(search, ends, soft, names)
        missing = unconfirmed(search, ends, kinds)
        return ends, joined("; ", filter(None, (missing, opened)))

    def _continued(self, search: Search, x: np.ndarray) -> End:
        """Search from x under a relaxed limit on Ms, then from each result under a tighter one.

        The last search is under the specified limit.
        """
        if self.limits.limit(SENSITIVITY_PEAK) is not None:
            for factor in _EASED:
                eased = self._under(search, self.limits.eased(SENSITIVITY_PEAK, factor))
                if eased.judge(x) is not None:
                    x = eased.descend(x).x
                self.evaluations += eased.criteria.count
        return search.descend(x)

    def _under(self, search: Search, limits: Limits) -> Search:
        """Return a search with the same points and ranges but other limits."""
        present = search.criteria
        criteria = Criteria(
            present.points,
            present.control,
            self.goal,
            limits,
            self.band,
            near=present.near,
            screened=present.screened,
        )
        other = Search(criteria, search.low, search.high)
        other.sure = search.sure
        return other

    def _widened(
        self, search: Search, ends: list[End], soft: np.ndarray, names: tuple[str, ...]
    ) -> tuple[list[End], str]:
        """Widen the search ranges at whose ends the best result lies, until this improves it by less than 5 %.

        Returns the results, and a sentence that names the tunables whose ranges would have to be widened further; it is
        empty if there are none.
        """
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
        """Evaluate a controller as it is, without a search; `names` are its tunables."""
        x = logarithms(control, names)
        criteria = self.on_all_lines(control, names)
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
        """Return the start of a search.

        It is the present values if they nearly satisfy the bounds, else the best of several faster and slower loops.
        """
        here = search.judge(x)
        if here is not None and search.broken(here) < _NEAR:
            return x
        rungs = np.clip(x + _LADDER[:, None] * powers, search.low, search.high)
        # compared without derivatives, the best first; the start needs an evaluation
        order = np.lexsort((np.abs(np.sum(rungs - x, axis=1)), search.look(rungs)))
        for rung in rungs[order]:
            if search.judge(rung) is not None:
                return rung
        raise UnstableError(
            "no setting was found in which the loop is stable, as it is and with all its gains lower down to a "
            "2000th: check the sign of the response, its unit (m/N), masses, filters and dead time"
        )

    def _from_below(self, search: Search, end: End, x: np.ndarray, powers: np.ndarray) -> End:
        """Return `end`, or a better result if `end` violates a bound.

        In this case the search is repeated from the fastest loop that satisfies all bounds.
        """
        if search.broken(end.judged) <= _KEPT:
            return end
        for step in _LADDER[_LADDER <= 0.0]:
            rung = np.clip(x + step * powers, search.low, search.high)
            evaluation = search.judge(rung)
            if evaluation is not None and search.broken(evaluation) <= 0.0:
                other = search.descend(rung)
                return other if search.broken(other.judged) < search.broken(end.judged) else end
        return end

    def _kept(self, search: Search, end: End, x: np.ndarray, powers: np.ndarray, *, evolved: bool) -> End:
        """Return the best of `end`, which violates a bound, and the results of other starts with the same noise margin.

        If noise makes |L| cross 1 many times, crossovers appear and disappear, and a search may end at a violated bound
        although a nearby loop satisfies all of them.  The fastest feasible loop may then lie in a different local
        minimum, whose cost would be attributed to the noise. If `evolved`, a population over the whole range provides
        an additional start.
        """
        # a penalty that an earlier search had to raise would hold the next one at the first bound that it meets
        search.penalty = PENALTY
        ends = [end, self._from_below(search, end, x, powers)]
        search.penalty = PENALTY
        begun = self._from_all_over(search, end.x, powers) if evolved else None
        # it was looked at on a part of the lines only
        if begun is not None and search.judge(begun) is not None:
            ends.append(search.descend(begun))
        return min(ends, key=lambda other: (max(search.broken(other.judged), _KEPT), float(np.max(other.judged.goal))))

    def _elsewhere(
        self, search: Search, x: np.ndarray, powers: np.ndarray, *, evolved: bool = True
    ) -> np.ndarray | None:
        """Return the start of another search, or None if no point is stable.

        It is the best of random points over the whole range or, if `evolved`, of a population evolved from them.
        """
        if evolved:
            points, merits = self._population(search, x, powers, _GENERATIONS)
        else:
            points, merits = search.best(scattered(x, search.low, search.high, powers, self.random), 1)
        return points[0] if np.isfinite(merits[0]) else None

    def _population(
        self, search: Search, x: np.ndarray, powers: np.ndarray, generations: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the best of random points over the whole range, evolved for some generations, with their merits."""
        points = scattered(x, search.low, search.high, powers, self.random)
        return search.evolve(*search.best(points, _POPULATION * max(x.size, 3)), self.random, generations)

    def _from_all_over(self, search: Search, x: np.ndarray, powers: np.ndarray) -> np.ndarray | None:
        """Return the best of a population over the whole range under the reserve of a search; None if none is stable.

        For a multirate controller its first generations take the law at one rate, which costs a fraction and shows
        where to look.
        """
        present = search.criteria.control
        if present.period == 1:
            return self._elsewhere(search, x, powers)
        rough = Search(self.criteria(present.control, present.tunables, rough=True), search.low, search.high)
        rough.sure = search.sure
        points, _ = self._population(rough, x, powers, _ROUGH)
        points, merits = search.evolve(points, search.look(points), self.random, _GENERATIONS - _ROUGH)
        return points[0] if np.isfinite(merits[0]) else None

    def _on_all_lines(self, control: Control, names: tuple[str, ...], search: Search, end: End) -> End:
        """Check the result on all lines; add lines on which it violates a bound and search again, for a few rounds."""
        for _ in range(_CUTS):
            whole = self.on_all_lines(control, names)
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
        """Raise UnstableError, naming the limits in conflict and, for each, the value attainable given the others."""
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
            f"limit, or add a filter there{_SMALLER if self.joined else ''}"
        )

    def _reachable(self, search: Search, end: End, figure: Figure | None) -> str:
        """Return, as a clause, the tightest limit of a figure that can be satisfied with all other limits unchanged.

        The clause is empty if relaxing this limit does not help.
        """
        if figure is None:
            return ""

        def eased(factor: float) -> bool:
            self.progress.step(f"what {figure.title} can be reached")
            other = self._under(search, self.limits.eased(figure, factor))
            if other.judge(end.x) is None:
                return False
            return other.broken(other.descend(end.x).judged) <= _KEPT

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
        """Raise NotIdentifiableError, naming the band whose measurement noise degrades the goal most."""
        forced = [b for b in end.judged.bounds if end.force.get(b.key, 0.0) > 0.0 and b.deviation > 0.0]
        worst = max(forced or end.judged.bounds, key=lambda b: end.force.get(b.key, 0.0) * b.deviation)
        raise NotIdentifiableError(
            f"do not tune, measure again: the noise of '{self.points[worst.point].name}' costs "
            f"{Quantity(cost, 'share'):3} of the goal, most of it from "
            f"{span(0.7 * worst.frequency, 1.4 * worst.frequency, 'Hz')}, where "
            f"{worst.kind} is only known to {Quantity(worst.deviation, 'share'):2}; excite this band more strongly, or "
            "average longer"
        )

    def with_notches(self, best: Best, tried: list[str]) -> Best:
        """Add notches one by one at the largest remaining resonances, and keep each one that improves the goal."""
        for frequency in self._loud(best)[:_NOTCHES]:
            self.progress.step(Text(f"a notch at {Quantity(frequency, 'Hz')}"))
            # nearly without effect, so that the search starts where the last one ended
            notch = Notch(frequency=frequency, damping_zero=0.35, damping_pole=0.4)
            control = replace(best.control, filters=(*best.control.filters, notch))
            here = dict(zip(best.names, np.exp(best.end.x), strict=True))
            control = tree.rebuild(control, (float(here.get(n, v)) for n, v in tree.leaves(control)))
            i = len(control.filters) - 1
            names = (*best.names, *(f"filters.{i}.{field}" for field in ("frequency", "damping_zero", "damping_pole")))
            flat = False
            try:
                other = self.tuned(control, names, starts=1, trial=True)
                zero, pole = other.end.x[-2:]
                flat = bool(pole - zero < _FLAT)
                if flat:
                    # what it gained is a better place of the others: a search that begins there, without it
                    there = dict(zip(other.names, np.exp(other.end.x), strict=True))
                    moved = tree.rebuild(control, (float(there.get(n, v)) for n, v in tree.leaves(control)))
                    moved = replace(moved, filters=moved.filters[:-1])
                    other = self.tuned(moved, best.names, starts=1, trial=True)
            except (UnstableError, NotIdentifiableError):
                continue
            gained = float(np.max(best.end.judged.goal) - np.max(other.end.judged.goal))
            if flat:
                best = other if gained > 0.0 else best
                tried.append(Text(f"at {Quantity(frequency, 'Hz')}: ends flat, not taken"))
            elif gained > _PAYS:
                ended = float(np.exp(other.end.x[len(best.names)]))
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
        """Return the frequencies of resonances above the crossover without a nearby notch, largest |L| first."""
        names = dict(zip(best.names, np.exp(best.end.x), strict=True))
        taken = [
            names.get(f"filters.{i}.frequency", filter_.frequency)
            for i, filter_ in enumerate(best.control.filters)
            if isinstance(filter_, Notch)
        ]
        peaks: dict[float, float] = {}
        for answer in self.on_all_lines(best.control, best.names).answers(best.end.x):
            f, size = answer.point.frequency, np.abs(answer.gain)
            for k in resonances_above(f, size):
                if all(abs(np.log(f[k] / other)) > _APART for other in (*taken, *peaks)):
                    peaks[float(f[k])] = float(size[k])
        return sorted(peaks, key=lambda frequency: -peaks[frequency])


def resonances_above(frequency: np.ndarray, size: np.ndarray) -> list[int]:
    """Return the line indices of the resonances above the crossover at which |L| = `size` exceeds 0.15.

    The crossover is where |L| first falls below 1. A search above the last crossover would miss the largest
    resonances, at which |L| rises above 1 again. On the bundled ball screw, machining center and mill, notches at these
    resonances improve the goal.
    """
    falls = np.flatnonzero((size[:-1] >= 1.0) & (size[1:] < 1.0))
    crossover = frequency[falls[0]] if falls.size else frequency[0]
    return [
        k
        for k in range(2, size.size - 2)
        if size[k] == np.max(size[k - 2 : k + 3]) and size[k] > _LOUD and frequency[k] > 1.2 * crossover
    ]


def _soft(control: Control, name: str) -> bool:
    """Return True if the search range of a tunable may be widened; False for filters and for frequencies in Hz."""
    return not name.startswith("filters.") and tree.declaration(control, name).unit != "Hz"


def _one_sided(confidence: float) -> float:
    from scipy.special import ndtri

    return float(ndtri(confidence))


# factor of Kv that opens the position loop; 0 is outside the bounds of Kv
_OFF = 1e-9


@dataclass(frozen=True, eq=False, repr=False)
class CascadeLoops(Result):
    """The margins of the two loops of a cascade.

    velocity  the velocity loop alone, opened at the actuator
    position  the position loop, opened at the velocity command, with the velocity loop closed
    """

    velocity: Margins
    position: Margins

    def table(self) -> Table:
        """Tabulate crossover and margins of both loops."""
        rows: list[Sequence[Cell]] = []
        fast, slow = (loop.loop_gain.sample_time for loop in (self.velocity, self.position))
        ran = "" if fast is None or slow is None or fast == slow else Text(f", every {Quantity(slow, 's'):6}")
        for name, m in (("velocity loop", self.velocity), (f"position loop{ran}", self.position)):
            rows.append([name, m.crossover, m.phase_margin_deg, m.gain_increase_dB, m.sensitivity_peak])
        columns = [
            "loop",
            Column("crossover", "Hz"),
            Column("phase margin", "deg"),
            Column("gain may rise", "dB"),
            "Ms",
        ]
        return Table("the cascade, loop by loop", columns, rows)


def cascade_loops(control: Control, point: OperatingPoint) -> CascadeLoops | None:
    """Return the margins of velocity and position loop of a P-PI controller; None for any other law.

    The velocity loop is the loop at the actuator without position loop (Kv -> 0).
    """
    law = control.law
    if not isinstance(law, CascadePPI):
        return None
    whole, inner = (response_on(point, replace(control, law=replace(law, Kv=Kv))) for Kv in (law.Kv, _OFF * law.Kv))
    gain = -np.einsum("kl,kl->l", inner.value, point.by_force)
    velocity = FRF(point.frequency, gain, "cut", "force", "N/N", point.sample_time)
    return CascadeLoops(margins(velocity), margins(position_loop(point, whole, inner)))


class Verdict(Enum):
    """The recommendation of a tuning.

    TAKE    use the new controller
    LEAVE   keep the present controller
    REFUSE  reject the new controller, because its proof fails
    """

    TAKE = "take"
    LEAVE = "leave"
    REFUSE = "refuse"


@dataclass(frozen=True)
class HeldBack:
    """A limit that is active at the optimum.

    point, frequency  the operating point and the frequency in Hz at which it is active
    gain              improvement of the goal in percent if the limit is relaxed by a tenth
    """

    what: str
    point: str
    frequency: float  # Hz
    gain: float

    def sentence(self) -> str:
        """Return a sentence with the limit, its place and the improvement from relaxing it."""
        where = f" at {Quantity(self.frequency, 'Hz')}" if self.frequency > 0.0 else ""
        gain = Quantity(0.01 * self.gain, "share")
        return Text(f"{self.what}{where} ({self.point}): a tenth more room would gain {gain:2}")


@dataclass(frozen=True, eq=False, repr=False)
class Tuned(Result):
    """A controller tuned for a goal within limits at all points, with its proof: the checks that were made of it.

    tunables, started  new and present values by dotted name; NaN: a parameter of a new filter
    goal              the figure that is optimized
    before, after     figures at each point; `before` is empty if the present controller has no linear response
    held              the active limits, the one with the largest effect first
    advice            suggestions for further improvements
    notches           the notches that were tried, with their effect on the goal, as sentences
    sure, confidence  margin to every bound in standard deviations; probability that all bounds are satisfied
    spread            relative difference of the goal between the worst and the best search
    unsettled         reason why independent searches do not confirm the best one; empty if they do
    cost              relative increase of the goal due to measurement noise
    recipe            the tuning rule that gave the controller, if there was no search
    agreed            number of searches that ended within 5 % of the best one, and of all; (0, 0) without a search
    box, box_before   the new and the present controller over the box of plants; None without a box
    cascade_before    velocity and position loop of the present controller separately; None if it is not a P-PI
                      controller
    cascade           the same loops for the new controller
    """

    control: Control
    loops: tuple[Loop, ...]
    tunables: Mapping[str, float]
    started: Mapping[str, float]
    goal: Figure
    band: tuple[float, float]
    limits: Limits
    before: tuple[Figures, ...]
    after: tuple[Figures, ...]
    held: tuple[HeldBack, ...]
    advice: tuple[str, ...]
    notches: tuple[str, ...]
    sure: float
    confidence: float | None
    cost: float
    evaluations: int
    spread: float
    unsettled: str
    proof: tuple[Checked, ...]
    cascade_before: CascadeLoops | None = None
    cascade: CascadeLoops | None = None
    recipe: str = ""
    agreed: tuple[int, int] = (0, 0)
    box: OverBox | None = None
    box_before: OverBox | None = None

    @property
    def rotary(self) -> bool:
        """True for a rotary axis; False if the axis is known only by measured responses."""
        return any(loop.axis.rotary for loop in self.loops)

    @property
    def settled(self) -> bool:
        """True if independent searches came within 5 % of the best result and no search range limits it."""
        return not self.unsettled

    @property
    def holds(self) -> bool:
        """True if no line of the proof fails; otherwise the tuning must not be used."""
        return all(line.holds is not False for line in self.proof)

    @property
    def proven(self) -> bool:
        """True if all lines of the proof pass."""
        return all(line.holds is True for line in self.proof)

    @property
    def rule(self) -> str:
        """The goal of the tuning, or the rule that gave the controller, in words."""
        if self.recipe:
            return Text(f"{self.recipe}; judged by {self.limits.sentence()}")
        noise = f", kept with {Quantity(self.sure):3} standard deviations of the measurement" if self.sure else ""
        over = Text(f" over the box: {self.box.box.sentence}") if self.box is not None else ""
        return Text(f"{aim(self)} subject to {self.limits.sentence()}{over}{noise}")

    @property
    def at_drive(self) -> bool:
        """True if the compliance refers to a force at the drive, because no response to a force on the table is
        known.
        """
        return any(loop.at_drive for loop in self.after)

    def gained(self) -> float | None:
        """Return the ratio of the present to the new value of the minimized quantity at the worst point.

        A ratio above 1 is an improvement; None if the present loop is unstable or unknown.
        """
        if not self.before or not all(loop.stable for loop in self.before):
            return None
        return goal_of(self, self.before) / goal_of(self, self.after)

    @property
    def verdict(self) -> Verdict:
        """The decision on which the sentence of `recommendation` is based."""
        if not self.holds:
            return Verdict.REFUSE
        gained = self.gained()
        if gained is None or broken_today(self):
            return Verdict.TAKE
        return Verdict.LEAVE if _change(self, gained) < _NOT_WORTH else Verdict.TAKE

    def recommendation(self) -> str:
        """Return the recommendation in words, with its reason and the figures that get worse."""
        return recommendation(self)

    def table(self) -> Table:
        """Tabulate old and new figures, active limits, and the proof."""
        heads = ["what", "today", "new", "unit"] if self.box is None else ["what", *BESIDE, "unit"]

        def cells(today: Cell, new: Cell, *, worst: tuple[Cell, Cell] = ("", "")) -> list[Cell]:
            return [today, new] if self.box is None else [today, worst[0], new, worst[1]]

        rows: list[Sequence[Cell]] = []
        for name, value in self.tunables.items():
            unit = tree.declaration(self.control, name).unit
            started = self.started[name]
            before = "–" if np.isnan(started) else Quantity(started, unit, form="5 SI")
            rows.append([readable(self.control, name), *cells(before, Quantity(value, unit, form="5 SI")), UNIT])
        for i, after in enumerate(self.after):
            before = self.before[i] if self.before else None
            mark = f" ({after.point})" if len(self.after) > 1 else ""
            rows += [
                [
                    f"{figure.label or figure.title}{mark}",
                    *cells(_figure(before, figure), _figure(after, figure), worst=worst_beside(self, figure)),
                    UNIT,
                ]
                for figure in reported()
                if figure.read(after) is not None
            ]
        rows += [["held back by", *cells("", ""), held.sentence()] for held in self.held]
        rows += [["to gain more", *cells("", ""), text] for text in self.advice]
        rows += [["notch", *cells("", ""), text] for text in self.notches]
        rows += [[f"proof: {line.what}", *cells("", _verdict(line.holds)), line.text] for line in self.proof]
        return Table(f"{self.rule}. {self.recommendation()}", heads, rows)


BESIDE = ("today", "worst", "new", "worst of new")
"""The heads of figures with a box: at the model, and at the worst plant of the box."""


def worst_beside(tuned: Tuned, figure: Figure) -> tuple[Cell, Cell]:
    """Return a figure of today's and of the new control at the worst plant of the box; empty where it has none."""
    cells: list[Cell] = []
    for box in (tuned.box_before, tuned.box):
        spread = None if box is None else box.spread(figure)
        unstable = box is not None and not np.isfinite(box.used)
        cells.append("unstable" if unstable else None if spread is None else figure.quantity(spread.worst))
    return cells[0], cells[1]


def broken_today(tuned: Tuned) -> str:
    """Return, as a clause, the first limit that today's control violates at a model or over the box; else empty."""
    broken = broken_limits(tuned.before, tuned.limits)
    over = tuned.box_before
    if broken or over is None or over.holds is not False:
        return broken
    return Text(f"do not keep {tuned.limits.sentence()} over the box: {over.sentence(tuned.limits)}")


def _verdict(holds: bool | None) -> str:
    return "not proven" if holds is None else "holds" if holds else "DOES NOT HOLD"


def _figure(loop: Figures | None, figure: Figure) -> str | Quantity | None:
    if loop is None:
        return ""
    return figure.quantity(figure.read(loop)) if loop.stable else "unstable"


_LISTED = 4  # parameters in a sentence that stays on one line
_NOT_WORTH = 2.0  # percent: a smaller gain does not justify a change
_WORSE = 0.03  # relative change of a figure that counts as worse
TIMES = 3.0  # ratio from which a gain reads as a factor, not as percent
_LEAST_PHASE, _MOST_PEAK = 15.0, 5.0  # phase margin in deg and Ms of the velocity loop alone: limits of a warning


def declared_goal(tuned: Tuned) -> Goal:
    """Return the `Goal` declaration of the tuned figure."""
    assert tuned.goal.goal is not None
    return tuned.goal.goal


def aim(tuned: Tuned) -> str:
    """Return the goal in words."""
    goal = declared_goal(tuned)
    band = "" if tuned.band == (0.0, np.inf) else Text(f" from {span(*tuned.band, 'Hz', '6')}")
    best = "greatest" if tuned.goal.higher else "least"
    return Text(f"{best} {goal.what}{_against(tuned)}{band if goal.banded else ''}")


def _against(tuned: Tuned) -> str:
    return " against a force at the drive" if tuned.at_drive and declared_goal(tuned).on_table else ""


def recommendation(tuned: Tuned) -> str:
    """Return the recommendation in words, with its reason, the most active limit and the figures that get worse."""
    if tuned.verdict is Verdict.REFUSE:
        failed = [line for line in tuned.proof if line.holds is False]
        return Text(f"Do not use this tuning: {failed[0].what} does not hold ({failed[0].text}).")
    worse = _worse(tuned)
    advised = Text(f"{_advised(tuned)}{f'; worse: {worse}' if worse else ''}.")
    # a loop that rings in manual mode is a reason not to take the gains: it comes before them
    return joined(" ", filter(None, (_of_the_velocity_loop(tuned), advised))) + _of_the_table(tuned)


def _of_the_velocity_loop(tuned: Tuned) -> str:
    """Return a warning if the new velocity loop alone is nearly unstable, else an empty string.

    The margins of the whole loop may hide this.
    """
    if tuned.cascade is None or tuned.verdict is Verdict.LEAVE:
        return ""
    alone = tuned.cascade.velocity
    phase, peak = alone.phase_margin_deg, alone.sensitivity_peak
    if (phase is None or abs(phase) >= _LEAST_PHASE) and peak <= _MOST_PEAK:
        return ""
    margin = "" if phase is None else f"a phase margin of {_rough(phase, 'deg')} and "
    return Text(
        f"The velocity loop alone is next to unstable, with {margin}Ms {_rough(peak)}: it rings in manual mode."
    )


def _rough(value: float, unit: str = "") -> Quantity:
    """Return a quantity rounded to two significant digits, in its usual unit."""
    size = USUAL.of(unit)[1]
    return Quantity(float(two_digits(size * value)) / size, unit, form="6")


def two_digits(value: float) -> str:
    """Return a number rounded to two significant digits, as a string without an exponent up to a million."""
    return number(rounded(value, 2), 6)


def _of_the_table(tuned: Tuned) -> str:
    if not tuned.at_drive:
        return ""
    return (
        " The response to a force on the table is not known, and the table may become softer: strike the table or "
        "give a "
        "machine with its plant before cutting with it."
    )


def _advised(tuned: Tuned) -> str:
    limit = f"; {tuned.held[0].what} is the limit" if tuned.held else ""
    gained = tuned.gained()
    over = "" if tuned.box is None else " over the box"
    limits, new = Text(f"{tuned.limits.sentence()}{over}"), _new_values(tuned)
    if gained is None:
        state = "there is no control to compare with" if not tuned.before else "today's loop is unstable"
        return Text(f"{new} within {limits}{limit}; {state}")
    change, gain_text = _change(tuned, gained), _gain_text(tuned, gained)
    broken = broken_today(tuned)
    if broken:
        return Text(f"{new}, {gain_text} within {limits}{limit}; today's gains {broken}")
    drive = _against(tuned)
    if tuned.recipe and change < 0.0:
        return Text(f"Leave the control as it is: this rule gives {gain_text}{drive}{limit}")
    if tuned.verdict is Verdict.LEAVE:
        best = "this rule" if tuned.recipe else "the best that was found"
        return Text(f"Leave the control as it is: {best} has only {gain_text}{drive}{limit}")
    return Text(f"{new}, {gain_text} within {limits}{limit}")


def _gain_text(tuned: Tuned, gained: float) -> str:
    """Return the improvement in words: `50 % more dynamic stiffness`, `570 times the dynamic stiffness`."""
    ratio = gained if tuned.goal.higher else 1.0 / gained
    if ratio >= TIMES:
        return Text(f"{_rough(ratio)} times the {declared_goal(tuned).what}")
    direction = "more" if ratio >= 1.0 else "less"
    return Text(f"{_rough(abs(ratio - 1.0), 'share')} {direction} {declared_goal(tuned).what}")


def _change(tuned: Tuned, gained: float) -> float:
    """Return the improvement of the goal in percent."""
    return 100.0 * (gained - 1.0 if tuned.goal.higher else 1.0 - 1.0 / gained)


def _new_values(tuned: Tuned) -> str:
    """Return the new gains and their largest Ms as text, cautiously worded if no response of the table is known.

    Only the first `_LISTED` parameters of the law are listed; the table contains all.
    """
    law = {name.removeprefix("law."): value for name, value in tuned.tunables.items() if name.startswith("law.")}
    units = {name: tree.declaration(tuned.control, f"law.{name}").unit for name in law}
    listed = [Text(f"{name} {Quantity(rounded(value, 3), units[name]):6}") for name, value in [*law.items()][:_LISTED]]
    further = len(tuned.tunables) - len(listed)
    gains = joined(", ", [*listed, *([Text(f"{further} more")] if further else [])])
    peak = Quantity(max(SENSITIVITY_PEAK.value(loop) for loop in tuned.after))
    spread = None if tuned.box is None else tuned.box.spread(SENSITIVITY_PEAK)
    over = "" if spread is None or spread.worst is None else f" ({Quantity(spread.worst):3} at worst)"
    if not tuned.at_drive:
        return Text(f"Take {gains}: Ms {peak:3}{over}")
    what = "Against a force at the drive" if declared_goal(tuned).on_table else "The new values"
    return Text(f"{what}: {gains} give Ms {peak:3}{over}")


def _worse(tuned: Tuned) -> str:
    """Return, as a clause, the figures that get worse, each at the point where it deteriorates most."""
    if not tuned.before or not all(loop.stable for loop in tuned.before):
        return ""
    clauses: list[str] = []
    for name, now in tuned.tunables.items():
        if name.rpartition(".")[2] == "Kv" and tuned.started[name] > (1.0 + _WORSE) * now:
            clauses.append(_fall("Kv", tuned.started[name], now, "1/s"))
    for figure in reported():
        if not figure.compared:
            continue
        pairs = [(figure.read(a), figure.read(b)) for a, b in zip(tuned.before, tuned.after, strict=True)]
        fell = [
            ((a / b if figure.higher else b / a), a, b)
            for a, b in pairs
            if a is not None and b is not None and a * b > 0
        ]
        if fell and max(fell)[0] > 1.0 + _WORSE:
            clauses.append(_fall(figure.label or figure.title, *max(fell)[1:], figure.unit))
    return joined(", ", clauses)


def _fall(title: str, before: float, after: float, unit: str) -> str:
    return f"{title} {replace(_rough(before, unit), bare=True)} -> {_rough(after, unit)}"


def goal_of(tuned: Tuned, row: Sequence[Figures]) -> float:
    """Return the value of the minimized quantity at the worst point; `row` holds the figures at each point."""
    of = declared_goal(tuned).of
    return max(of(loop, tuned.band) for loop in row)


def broken_limits(before: Sequence[Figures], limits: Limits, room: float = 0.02) -> str:
    """Return, as a clause, the first limit that the figures `before` violate; empty if they satisfy all limits."""
    for loop in before:
        for verdict in judged(limits, loop, room):
            if not verdict.keeps:
                return Text(f"have {verdict.text}, not {limits.text(verdict.limit)}")
    return ""


FILTERS = ("kept", "free", "placed")


def tune_control(
    control: Control | Loop,
    points: OperatingPoint | Loop | Sequence[OperatingPoint | Loop] | None = None,
    *,
    goal: str = "rope-snap",
    limits: Limits | Iterable[Limit] | None = None,
    tunables: Sequence[str] | None = None,
    filters: str = "free",
    band: tuple[float, float] = (0.0, math.inf),
    confidence: float = 0.95,
    starts: int = 2,
    seed: int = 0,
    velocity: float = 0.05,
    today: Control | None = None,
    box: Box | None = None,
    around: Sequence[Loop] | None = None,
    today_over_box: bool = True,
    progress: Progress | None = None,
) -> Tuned:
    """Tune a controller: optimize the goal over its tunables, with all limits satisfied at every point.

        minimize  max over points of the goal   over ln(tunables)   subject to   slack_i >= k σ_i  for all limits i

    goal        a figure with a goal in the catalogue (`figures.goals`).  rope-snap: ISE^½ = [∫ |y|²/ω² dω/π]^½;
                stiffness: the mean of |y|² over ln f in the band;  least-stiffness: max |y| in the band;
                integral-gain: max |y|/ω;  bandwidth: 1/(frequency at which |1/(1 + L)| rises to -3 dB);
                y is the compliance of the closed loop
    limits      `Limits`, or `Limit` objects for figures of the catalogue (`figures.limitable`)
    control     the controller from which the search starts; of a loop, its controller and, without `points`, its axis
    points      operating points, measured (`measured_point`) or modelled, or loops, whose axes are used
    tunables    dotted names within the controller, such as law.Kp; default: those of the law
    filters     kept: unchanged;  free: their frequencies and damping ratios are tuned too;  placed: notches are also
                added where they improve the goal
    confidence  probability that the true axis satisfies all limits; it determines k if the variances of the points are
                known
    today       the controller to compare with; default: `control` itself
    box         tolerances of the plants of modelled points: the limits hold at every plant of it that is found by its
                corners and by searches within it (`Tuned.box`); the goal is that of the models themselves
    around      the loops around which the box lies; default: those of the modelled points
    today_over_box  False to leave out the present controller over the box (`Tuned.box_before`)
    progress    receives the name of each stage, and may cancel the tuning

    The response of the controller is computed by linearizing its code (`ControlResponse`), with exact derivatives.
    Stability is checked at every step: by eigenvalues for a model, by encirclements of -1 for measured responses. A
    tuning for loops is verified by simulation with friction, encoder counts and limits (`Tuned.holds`). If searches
    from different starts do not agree, further ones are run (`Tuned.settled`).
    Raises UnstableError if no controller within the limits is found, NotIdentifiableError if the measurement is too
    poor for a tuning, with the band in which to measure again, and ParameterError for inconsistent arguments.
    """
    if points is None:
        if not isinstance(control, Loop):
            raise ParameterError("a control alone has no axis: give a loop, or the control and its points")
        points = control
    control = control.control if isinstance(control, Loop) else control
    if filters not in FILTERS:
        raise ParameterError(f"filters = {filters!r} must be one of {', '.join(FILTERS)}")
    tuner = _tuner(control, points, goal, limits, band, confidence, starts, seed, velocity, progress, box, around)
    chosen = law_tunables(control) if tunables is None else tuple(tunables)
    best = tuner.tuned(
        control, chosen if filters == "kept" else tuple(dict.fromkeys([*chosen, *filter_tunables(control)]))
    )
    tried: list[str] = []
    if filters == "placed":
        # a notch is tried by one search, which confirms nothing of those before
        best = tuner.with_notches(best, tried)._replace(agreed=best.agreed)
    best, examined = tuner.over_box(best)
    tuner.progress.step("proof")
    return result(tuner, best, today or control, tuple(tried), box=examined, today_over_box=today_over_box)


def assess(
    control: Control,
    points: OperatingPoint | Loop | Sequence[OperatingPoint | Loop],
    *,
    rule: str,
    goal: str = "rope-snap",
    limits: Limits | Iterable[Limit] | None = None,
    band: tuple[float, float] = (0.0, math.inf),
    confidence: float = 0.95,
    velocity: float = 0.05,
    today: Control | None = None,
    box: Box | None = None,
    progress: Progress | None = None,
) -> Tuned:
    """Evaluate a controller, for example one from a recipe, like `tune_control` but without a search.

    rule  name of the rule that gave the controller; the other arguments are those of `tune_control`

    Raises the same errors as `tune_control`, and UnstableError if the loop is unstable at a point.
    """
    tuner = _tuner(control, points, goal, limits, band, confidence, 1, 0, velocity, progress, box)
    names = law_tunables(control)
    best = tuner.as_it_is(control, names)
    examined = over_box(control, tuner.boxes, tuner.limits)[0] if tuner.boxes else None
    return result(tuner, best, today or control, (), rule, examined)


def _tuner(
    control: Control,
    points: OperatingPoint | Loop | Sequence[OperatingPoint | Loop],
    goal: str,
    limits: Limits | Iterable[Limit] | None,
    band: tuple[float, float],
    confidence: float,
    starts: int,
    seed: int,
    velocity: float,
    progress: Progress | None,
    box: Box | None = None,
    around: Sequence[Loop] | None = None,
) -> Tuner:
    """Check the arguments of a tuning and return its `Tuner`."""
    figure = goals().get(goal)
    if figure is None or figure.goal is None:
        raise ParameterError(f"goal = {goal!r} must be one of {', '.join(goals())}")
    if not 0.5 <= confidence < 1.0:
        raise ParameterError(f"confidence = {number(confidence, 6)} must be >= 0.5 and < 1")
    if not 0.0 <= band[0] < band[1]:
        raise ParameterError(f"the band from {span(*band, 'Hz', '6')} is empty: the lower frequency comes first")
    sources = (points,) if isinstance(points, (OperatingPoint, Loop)) else tuple(points)
    operating_points = tuple(
        modelled_point(source, f"axis {i + 1}" if len(sources) > 1 else "model", velocity=velocity)
        if isinstance(source, Loop)
        else source
        for i, source in enumerate(sources)
    )
    if not operating_points:
        raise ParameterError("a tuning needs at least one operating point")
    if len({point.sample_time for point in operating_points}) > 1:
        times = joined(", ", [f"'{point.name}' {Quantity(point.sample_time, 's'):6}" for point in operating_points])
        raise ParameterError(f"one control has one sample time, but the points have {times}")
    _check_band(operating_points, band)
    for point in operating_points:
        if point.commanded != control.law.commanded:
            raise ParameterError(
                f"control.law: {control.law.kind} commands a {control.law.commanded}, and '{point.name}' is the "
                f"response of a drive that takes a {point.commanded}: take a law that commands it"
            )
    kept = limits if isinstance(limits, Limits) else Limits(limits or ())
    tuner = Tuner(
        operating_points, figure, kept, band, confidence, starts, seed, velocity, progress or Progress(), box, around
    )
    integrates = ControlResponse(control, operating_points[0].sample_time, (), velocity).integrates
    held = all(point.holds() for point in operating_points)
    if figure.goal.returns and not held and not integrates(()):
        raise ParameterError(
            f"goal = '{goal}' needs a control with integral action: without it ('{control.law.kind}' as it is) a force "
            "causes a permanent offset of the table; give it one, such as law.Tn, let the search begin with one (law "
            "cascade_ppi), or take the goal stiffness"
        )
    return tuner


def _check_band(points: Sequence[OperatingPoint], band: tuple[float, float]) -> None:
    for point in points:
        inside = np.count_nonzero((point.frequency >= band[0]) & (point.frequency <= band[1]))
        if inside < 3:
            raise ParameterError(
                f"the band from {span(*band, 'Hz', '6')} holds {inside} "
                f"lines of '{point.name}', which has {span(point.frequency[0], point.frequency[-1], 'Hz')}: at least 3"
            )


_MUCH = 0.02  # of the goal: improvement by a tenth of a sample that counts as large


def result(
    tuner: Tuner,
    best: Best,
    today: Control,
    tried: tuple[str, ...],
    recipe: str = "",
    box: OverBox | None = None,
    *,
    today_over_box: bool = True,
) -> Tuned:
    """Assemble the result of a tuning: figures before and after, active limits, advice, and proof."""
    values = dict(zip(best.names, np.exp(best.end.x).tolist(), strict=True))
    control = tree.vary(best.control, values)
    before = _figures(tuner, today)
    after = _figures(tuner, control)
    loops = tuple(replace(point.loop, control=control) for point in tuner.stated if point.loop is not None)
    proof = of_measurement(
        [loop for loop, point in zip(after, tuner.stated, strict=True) if point.loop is None], tuner.limits
    )
    for point in tuner.stated:
        if point.loop is None:
            proof += of_known(point, control, tuner.limits, tuner.velocity)
        else:
            loop = replace(point.loop, control=control)
            proof += of_model(point.name, loop, tuner.limits, tuner.velocity)
    if box is not None:
        proof += (Checked(f"limits over the box, {box.examined} plants", box.holds, box.sentence(tuner.limits)),)
    examined = today_over_box and box is not None and before
    cascades = [cascade_loops(version, tuner.points[0]) if before else None for version in (today, control)]
    whole = tuner.on_all_lines(best.control, best.names)
    return Tuned(
        control=control,
        loops=loops,
        tunables=values,
        started={name: _of_today(today, control, name) for name in values},
        goal=tuner.goal,
        band=tuner.band,
        limits=tuner.limits,
        before=before,
        after=after,
        held=_held(tuner, best),
        advice=() if recipe else _advice(tuner, best),
        notches=tried,
        sure=best.sure,
        confidence=chance(whole(best.end.x).bounds) if tuner.noisy else None,
        cost=best.cost,
        evaluations=tuner.evaluations,
        spread=best.spread,
        unsettled=best.unsettled,
        proof=proof,
        cascade_before=cascades[0],
        cascade=cascades[1],
        recipe=recipe,
        agreed=best.agreed,
        box=box,
        box_before=over_box(today, tuner.boxes, tuner.limits, inside=False)[0] if examined else None,
    )


def _figures(tuner: Tuner, control: Control) -> tuple[Figures, ...]:
    """Return the figures at every point, on all lines; empty if the controller has no finite linear response."""
    try:
        answers = tuner.criteria(control, (), whole=True).answers(np.zeros(0))
    except ParameterError:
        return ()
    stated = (answer for answer in answers if not answer.point.bounds_only)
    return tuple(figures(answer, tuner.limits.reading_noise) for answer in stated)


def _held(tuner: Tuner, best: Best) -> tuple[HeldBack, ...]:
    """Return the active limits, largest effect first; those of one figure at close frequencies are merged."""
    summed: dict[tuple[str, int], list[tuple[float, float]]] = {}
    for bound in best.end.judged.bounds:
        force = best.end.force.get(bound.key, 0.0)
        if force > 1e-4 and bound.figure is not None:
            summed.setdefault((bound.kind, bound.point), []).append((force, bound.frequency))
    held: list[HeldBack] = []
    for (kind, point), parts in summed.items():
        groups: list[list[tuple[float, float]]] = []
        for part in sorted(parts, key=lambda pair: pair[1]):
            if groups and part[1] < 1.3 * groups[-1][-1][1]:
                groups[-1].append(part)
            else:
                groups.append([part])
        for group in groups:
            force = sum(part[0] for part in group)
            where = sum(part[0] * part[1] for part in group) / force
            # a limit relaxed by a tenth moves its slack, a logarithm, by ln 1.1; the multiplier gives the change of the
            # goal
            held.append(HeldBack(kind, tuner.points[point].name, where, 100.0 * force * math.log(1.1)))
    return tuple(sorted(held, key=lambda limit: -limit.gain))


def _advice(tuner: Tuner, best: Best) -> tuple[str, ...]:
    """Return suggestions for further improvements.

    They concern the effect of a shorter dead time, which follows from the multipliers of the optimum, the cost of the
    measurement noise, tunables at an end of their search range, and a missing response to a force on the table.
    """
    advice: list[str] = []
    step = 0.1 * tuner.points[0].sample_time

    def sooner(point: OperatingPoint) -> OperatingPoint:
        ahead = np.exp(2j * np.pi * point.frequency * step)
        moved = point.moved.copy()
        moved[0] = moved[0] * ahead
        late = point.by_force * ahead
        return replace(point, by_force=late, moved=moved, by_load=late if point.at_drive else point.by_load)

    points = tuple(sooner(point) for point in best.criteria.points)
    other = Criteria(points, best.criteria.control, tuner.goal, tuner.limits, tuner.band)(best.end.x)
    gained = _gain(best.end.judged, other, best.end)
    if gained > 1e-4:
        # extrapolated linearly: to a whole sample if the effect is small, else to a tenth of a sample
        small = gained < _MUCH
        how = Text(
            f"{'one sample' if small else 'a tenth of a sample'} ({Quantity(10.0 * step if small else step, 's'):6 us})"
        )
        advice.append(
            Text(
                f"{how} less dead time, from computation, filters or bus, would gain about "
                f"{Quantity(gained * (10.0 if small else 1.0), 'share'):2}"
            )
        )
    if tuner.noisy and best.cost > 5e-3:
        advice.append(Text(f"a measurement without noise would gain {Quantity(best.cost, 'share'):2}"))
    advice += _edges(tuner, best)
    if any(point.at_drive for point in tuner.points):
        advice.append(
            "all compliances are against a force at the drive, not on the table: strike the table (--disturbance), or "
            "give a machine whose plant agrees with the response (--baseline)"
        )
    return tuple(advice)


def _edges(tuner: Tuner, best: Best) -> list[str]:
    """Return a sentence for each tunable that ended at an end of its search range."""
    texts: list[str] = []
    nyquist = 0.5 / tuner.points[0].sample_time
    for name, value, low, high in zip(best.names, best.end.x, *best.box, strict=True):
        if min(value - low, high - value) > 1e-6:
            continue
        shown = readable(best.control, name)
        size, unit = math.exp(value), tree.declaration(best.control, name).unit
        end = "upper" if high - value < 1e-6 else "lower"
        reason = ""
        if name.startswith("filters.") and unit == "Hz" and end == "upper":
            reason = f", {Quantity(size / nyquist, 'share'):3} of half the sample rate: as good as no filter"
            if tuner.limits.limit(FORCE_NOISE) is None:
                reason += f", since no limit on the {FORCE_NOISE.title} prevents it"
        there = Quantity(size, unit, form="SI")
        texts.append(Text(f"{shown} = {there} is the {end} end of the range of the search{reason}"))
    texts += [
        f"filters.{bound.key[2]} (notch) would amplify instead of attenuate, so it is flat"
        for bound in best.end.judged.bounds
        if bound.figure is None and best.end.force.get(bound.key, 0.0) > 1e-3 and bound.slack < 0.02
    ]
    return texts


def _gain(here: Evaluation, there: Evaluation, end: End) -> float:
    """Return the improvement of the goal if the axis changes, predicted from the Lagrangian at the optimum."""
    slack = {bound.key: bound.slack for bound in there.bounds}
    eased = sum(
        end.force.get(bound.key, 0.0) * (slack[bound.key] - bound.slack) for bound in here.bounds if bound.key in slack
    )
    return float(np.max(here.goal) - np.max(there.goal)) + eased


def _of_today(today: Control, control: Control, name: str) -> float:
    """Return the present value of a tunable; NaN if the present controller has no such block or one of another type."""
    place, last = name.rpartition(".")[::2]
    blocks: list[object] = [today, control]
    for step in place.split("."):
        blocks = [
            (block[int(step)] if int(step) < len(block) else None)
            if isinstance(block, tuple)
            else getattr(block, step, None)
            for block in blocks
        ]
    value = getattr(blocks[0], last, None) if type(blocks[0]) is type(blocks[1]) else None
    return float(value) if value is not None else math.nan

"""The worst plants of a box under a control: its corners, and points within it that a search finds.

A limit holds over a box if no plant of it violates the limit.  The corners come first: for most loops one of them is
the worst.  From the worst corners, from middles of edges that are nearly as bad and from the worst of some plants drawn
at random, the utilization of each limit is then increased by steps along its gradient, within the box.  This finds a
worst plant between the corners too, such as one whose resonance meets the phase at which it harms most; it is a search
and no proof.
"""

import pickle
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from feeddrive.figures.figure import Figure
from feeddrive.figures.of_loops import FORCE_NOISE, ROPE_SNAP
from feeddrive.language import tree
from feeddrive.language.errors import FeeddriveError
from feeddrive.language.quantity import Quantity
from feeddrive.language.recent import Recent
from feeddrive.language.table import UNIT, Cell, Result, Table
from feeddrive.language.text import Text, joined
from feeddrive.loop.box import Box, Corner, named
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.tuning.closed_loop import Answer, Figures, figures, reported
from feeddrive.tuning.control_response import ControlResponse
from feeddrive.tuning.criteria import Criteria, Limits, bounds_of
from feeddrive.tuning.operating_point import OperatingPoint, modelled_point
from feeddrive.tuning.sampled_plants import SampledPlants
from feeddrive.tuning.screen import WIDE, Places, Plants, Screen, can_screen

_STARTS = 3  # worst corners from which a search within the box starts
_NEARLY, _MOST = 0.9, 16  # of the worst: middles of edges from which a search starts; the largest number of them
_INSIDE = 64  # plants drawn at random, from the worst of which further searches start
_DIFFERENCE = 0.02  # of half of a dimension: step of the differences
_FIRST, _LEAST = 0.5, 0.05  # of half of a dimension: first and smallest step of a search
_KEPT = 256  # plants between the corners whose models are kept
_LARGEST = 8  # steps of a search
VERDICTS = {True: "holds", False: "does not hold", None: "undecided"}
_TRIALS = 4  # lengths of a step of a screened search that are tried at once, each half of the one before
_CLOSE, _CHECKED = (
    0.98,
    4,
)  # utilization by a screen from which plants are examined, and of each limit at least how many
_UNSHARP, _SHARPENED = 3e-3, 4  # of a limit: error of few lines; plants of each limit that are examined on all lines
_ALIKE = 0.05  # of half of a dimension: plants nearer to each other than this are examined once
_LAWS = 32  # examinations that are kept: more than the laws of a comparison
UNDECIDED = 2e-3  # of a limit: a violation that the lines of the examination cannot tell from none


class BoxPlants:
    """The plants of the box of one modelled axis, each linearized when it is first needed."""

    def __init__(self, box: Box, loop: Loop, name: str, velocity: float) -> None:
        self.box, self.loop, self.name, self.velocity = box, loop, name, velocity
        sampled = SampledPlants(box, loop)
        self._sampled = sampled if sampled.agree(velocity) else None
        self.screen = None if self._sampled is None else Screen(self._sampled)
        self._dimensions = box.dimensions(loop.axis)
        self.corners = tuple(box.corners(loop.axis))
        self.inside = tuple(box.drawn(loop.axis, _INSIDE, 0))
        self.edges = tuple(box.edges(loop.axis))
        # the model itself comes first
        self.middle = tuple(
            Corner((0.0,) * len(box.dimensions(loop.axis)), late) for late in sorted({0, box.dead_time})
        )
        # corners and draws are needed under every control, other plants under one
        self._fixed = {*self.corners, *self.edges, *self.inside, *self.middle}
        self._corners, self._others = Recent[OperatingPoint](len(self._fixed)), Recent[OperatingPoint](_KEPT)

    @cached_property
    def screened(self) -> Plants:
        """The corners, the model, middles of edges and plants drawn at random, for the screen."""
        assert self.screen is not None
        return self.screen.plants(tuple(dict.fromkeys((*self.corners, *self.middle, *self.edges, *self.inside))))

    @cached_property
    def groups(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Which of the plants of the screen are corners, middles of edges, and drawn at random."""
        known = self.screened.corners
        of_kind = [set(some) for some in (self.corners, self.edges, self.inside)]
        corner, edge, inside = (np.array([plant in some for plant in known]) for some in of_kind)
        return corner, edge, inside

    @cached_property
    def adjacent(self) -> np.ndarray:
        """Which plants of the screen are the middle and an end of the same edge, shape (plants, plants)."""
        known = self.screened.corners
        number = {corner: i for i, corner in enumerate(known)}
        adjacent = np.zeros((len(known), len(known)), bool)
        for edge in self.edges:
            k = edge.place.index(0.0)
            for end in (-1.0, 1.0):
                i = number.get(replace(edge, place=(*edge.place[:k], end, *edge.place[k + 1 :])))
                if i is not None:
                    adjacent[i, number[edge]] = adjacent[number[edge], i] = True
        return adjacent

    def coarse(self, corner: Corner) -> OperatingPoint:
        """Return the operating point of a plant, on few lines."""

        def made() -> OperatingPoint:
            return self._modelled(corner, coarse=True)

        return (self._corners if corner in self._fixed else self._others).get(corner, made)

    def point(self, corner: Corner) -> OperatingPoint:
        """Return the operating point of a plant on all lines, at which limits apply and the goal does not."""
        return replace(self._modelled(corner, coarse=False), bounds_only=True)

    def _modelled(self, corner: Corner, *, coarse: bool) -> OperatingPoint:
        name, model = self.named(corner), None if self._sampled is None else self._sampled.model(corner)
        # only the model of its axis is needed of the loop, where it is known
        loop = self.loop if model is not None else self.box.plant(self.loop, corner)
        return modelled_point(loop, name, velocity=self.velocity, coarse=coarse, model=model)

    def named(self, corner: Corner) -> Text:
        """Return the name of a plant: that of the operating point, and how the plant differs from the model."""
        apart = replace(corner, place=tuple(self.box.apart(self._dimensions, corner.place)))
        return Text(f"{self.name}: {named(self._dimensions, apart)}")


_PLANTS = Recent[BoxPlants](8)


def box_plants(box: Box, loop: Loop, name: str, velocity: float) -> BoxPlants:
    """Return the plants of the box around the axis of a loop; those of the last boxes are kept with their models."""
    key = box, name, velocity, float(loop.sample_time), pickle.dumps(loop.axis)
    return _PLANTS.get(key, lambda: BoxPlants(box, loop, name, velocity))


class Examined(NamedTuple):
    """A plant of a box under a control: its figures, and the utilization of the limit that is used most.

    used     above 1 if a limit is violated; infinite if the loop is unstable or cannot be computed
    by_limit  the utilization of each limit that is nearly used, by the key of its figure
    """

    plants: BoxPlants
    corner: Corner
    figures: Figures | None
    used: float
    by_limit: Mapping[str, float]

    def of(self, key: str) -> float:
        """Return the utilization of one limit; 0 if there is plenty of room, infinite for an unstable loop."""
        return self.by_limit.get(key, 0.0) if np.isfinite(self.used) else np.inf

    @property
    def name(self) -> Text:
        """The name of the plant."""
        return self.plants.named(self.corner)


class Examination:
    """A control with given limits, whose figures are computed at plants of a box."""

    def __init__(self, control: Control, sample_time: float, limits: Limits, velocity: float) -> None:
        self.response = ControlResponse(control, sample_time, (), velocity)
        self.limits = limits
        self._known: dict[tuple[int, Corner], Examined] = {}
        # [A B; c d] of a control that can be screened
        self.matrix = self.response.model(())[0] if can_screen(self.response, limits) else None
        self._screens: dict[int, tuple[np.ndarray, Mapping[str, Places]]] = {}
        self._screened: dict[int, int] = {}

    def at(self, plants: BoxPlants, corners: Iterable[Corner]) -> list[Examined]:
        """Return plants under the control, in the order of `corners`."""
        wanted = list(dict.fromkeys(corners))
        new = [corner for corner in wanted if (id(plants), corner) not in self._known]
        for corner, judged in zip(new, self._judged([plants.coarse(corner) for corner in new]), strict=True):
            self._known[id(plants), corner] = Examined(plants, corner, *judged)
        return [self._known[id(plants), corner] for corner in wanted]

    def sharpened(self, found: Sequence[Examined]) -> list[Examined]:
        """Return the plants, those that use a limit most with what they use of it on all lines, the worst first.

        Few lines understate a peak by a thousandth at times, which decides where a limit is used up.
        """
        sharp = dict[tuple[int, Corner], Examined]()
        for limit in self.limits.limits:
            key = limit.figure.key
            near = sorted((p for p in found if 1.0 - _UNSHARP < p.of(key) < np.inf), key=lambda p: -p.of(key))
            for plant in near[:_SHARPENED]:
                place = id(plant.plants), plant.corner
                if place not in sharp:
                    loop, used, by_limit = self._judged([plant.plants.point(plant.corner)])[0]
                    both = {k: max(plant.of(k), by_limit.get(k, 0.0)) for k in {**plant.by_limit, **by_limit}}
                    sharp[place] = plant._replace(figures=loop, used=max(used, plant.used), by_limit=both)
        return _sorted(sharp.get((id(plant.plants), plant.corner), plant) for plant in found)

    def closely(self, plant: Examined) -> Figures | None:
        """Return the figures of a plant on all lines of a model."""
        return self._judged([plant.plants.point(plant.corner)])[0][0]

    def _judged(self, points: Sequence[OperatingPoint]) -> list[tuple[Figures | None, float, Mapping[str, float]]]:
        """Return the figures at points, the utilization of the limits, infinite for an unstable loop, and of each."""
        if not points:
            return []
        criteria = Criteria(tuple(points), self.response, ROPE_SNAP, self.limits, (0.0, np.inf))
        try:
            return [self._of(answer) for answer in criteria.answers(np.zeros(0))]
        except (FeeddriveError, ArithmeticError, np.linalg.LinAlgError):
            # one plant at which the loop has no finite response must not hide the others
            return (
                [(None, np.inf, {})] if len(points) == 1 else [row for point in points for row in self._judged([point])]
            )

    def _of(self, answer: Answer) -> tuple[Figures | None, float, Mapping[str, float]]:
        loop = figures(answer, self.limits.reading_noise)
        if not loop.stable:
            return loop, np.inf, {}
        # the slacks of the search: between few lines those of Ms follow the circle of a resonance
        used: dict[str, float] = {}
        for bound in bounds_of(0, answer, self.limits):
            key = bound.key[0]
            used[key] = max(used.get(key, 0.0), float(np.exp(-bound.slack)))
        return loop, max(used.values(), default=0.0), used

    def count(self, plants: BoxPlants) -> int:
        """Return the number of plants of a box that were examined or screened."""
        return self._screened.get(id(plants), 0) + sum(place == id(plants) for place, _ in self._known)

    def corners(self, plants: BoxPlants) -> list[Examined]:
        """Return the worst plants among corners and middle of a box under the control, the worst first.

        Where the control and its limits can be screened these are the worst of all plants that are known from the
        start, and else the corners.
        """
        if self.matrix is None or plants.screen is None:
            return _sorted(self.at(plants, (*plants.corners, *plants.middle)))
        unstable, used = self._screen(plants)
        corners = plants.screened.corners
        if np.any(unstable):
            bad = np.flatnonzero(unstable)[:_CHECKED]
            return _sorted(self.at(plants, [corners[i] for i in bad]))
        return self._examined(plants, corners, {key: places.largest(len(corners)) for key, places in used.items()})

    def searched(self, plants: BoxPlants) -> list[Examined]:
        """Return the worst plants of a box, also between the corners, the worst first."""
        corners = self.corners(plants)
        if self.matrix is not None and plants.screen is not None:
            for limit in self.limits.limits if np.isfinite(corners[0].used) else ():
                self._climb(plants, plants.screen, limit.figure.key)
            return _sorted([found for (place, _), found in self._known.items() if place == id(plants)])
        edges, drawn = self.at(plants, plants.edges), self.at(plants, plants.inside)
        # of each limit on its own: one that is used up everywhere would hide where another one is exceeded
        for limit in self.limits.limits if np.isfinite(corners[0].used) else ():
            key = limit.figure.key
            ranked = [sorted(found, key=lambda plant, key=key: -plant.of(key)) for found in (corners, edges, drawn)]
            # the middle of an edge is nearly as bad as the worst plant where the worst of the edge lies beside it
            near = _NEARLY * max(found[0].of(key) for found in ranked if found)
            starts = [*ranked[0][:_STARTS], *ranked[2][:_STARTS]]
            for start in (*starts, *[edge for edge in ranked[1] if edge.of(key) > near][:_MOST]):
                self._ascend(plants, start, key)
        return _sorted([found for (place, _), found in self._known.items() if place == id(plants)])

    def _screen(self, plants: BoxPlants) -> tuple[np.ndarray, Mapping[str, Places]]:
        """Return whether the loop is unstable at each plant that is known from the start, and how limits are used."""
        assert plants.screen is not None
        assert self.matrix is not None
        if id(plants) not in self._screens:
            screened = plants.screened
            self._screened[id(plants)] = len(screened.corners)
            unstable = plants.screen.unstable(screened, self.matrix)
            found = plants.screen.each_place(screened, self.response, self.matrix, self.limits)
            self._screens[id(plants)] = unstable, {limit.figure.key: places for limit, places in found}
        return self._screens[id(plants)]

    def _examined(self, plants: BoxPlants, corners: Sequence[Corner], used: Mapping[str, np.ndarray]) -> list[Examined]:
        """Examine the plants that use a limit most by a screen, of several that are alike one; the worst first."""
        chosen = dict[Corner, None]()
        for sizes in used.values():
            picked = list[Corner]()
            for i in np.argsort(-sizes):
                if len(picked) >= _CHECKED or (picked and sizes[i] < _CLOSE):
                    break
                if not any(_alike(corners[i], other) for other in picked):
                    picked.append(corners[i])
            chosen |= dict.fromkeys(picked)
        return _sorted(self.at(plants, chosen or plants.middle))

    def _climb(self, plants: BoxPlants, screen: Screen, key: str) -> None:
        """Increase the utilization of a limit from many plants at once by steps along the gradient within the box.

        Each peak of |S| and each crossover is followed on its own: where one of them is the worst at the start, the
        way to the worst plant may be that of another one.
        """
        assert self.matrix is not None
        matrix, known = self.matrix, plants.screened.corners
        n = len(known[0].place)
        places = self._screen(plants)[1][key]
        # a limit that is hardly used at all of these plants is not exceeded beside them
        if not n or np.max(places.used, initial=0.0) < _NEARLY:
            return
        starts = _starts(plants, places)
        here, middle = places.used[starts], places.frequency[starts]
        place = np.array([known[i].place for i in places.plant[starts]])
        late = [known[i].late for i in places.plant[starts]]

        def at(rows: np.ndarray, there: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            """Return the utilization at places (rows, trials, dimensions), and the frequency."""
            corners = [
                Corner(tuple(u), late[i]) for i, trials in zip(rows, there.tolist(), strict=True) for u in trials
            ]
            self._screened[id(plants)] += len(corners)
            around = np.repeat(middle[rows], there.shape[1])
            some = screen.plants(corners) if key == FORCE_NOISE.key else screen.beside(corners, around)
            result = screen.used(some, self.response, matrix, self.limits.only(key))
            shape = there.shape[:2]
            return result.used[key].reshape(shape), result.where[key].reshape(shape)

        sizes, rows = np.full(len(starts), _FIRST), np.arange(len(starts))
        for _ in range(_LARGEST):
            u = place[rows]
            # inwards, so that every difference is one of plants in the box
            inward = np.where(u > 0.0, -_DIFFERENCE, _DIFFERENCE)
            beside, _where = at(rows, np.concatenate([u[:, None], u[:, None] + inward[:, None] * np.eye(n)], axis=1))
            slope = (beside[:, 1:] - beside[:, :1]) / inward
            # along the faces that hold it: a steep slope out of the box would shorten every step within it
            slope[(u * slope > 0.0) & (np.abs(u) >= 1.0)] = 0.0
            steepest = np.max(np.abs(slope), axis=1)
            moving = np.isfinite(steepest) & (steepest > 0.0)
            rows, u, slope = rows[moving], u[moving], slope[moving] / steepest[moving, None]
            if not rows.size:
                break
            factors = 0.5 ** np.arange(_TRIALS)
            there = np.clip(u[:, None] + (sizes[rows, None] * factors)[:, :, None] * slope[:, None], -1.0, 1.0)
            tried, peaks = at(rows, there)
            best = np.argmax(tried, axis=1)
            each = np.arange(rows.size)
            better = tried[each, best] > beside[moving, 0]
            rows, best, each = rows[better], best[better], each[better]
            place[rows], here[rows], middle[rows] = there[each, best], tried[each, best], peaks[each, best]
            sizes[rows] = np.maximum(1.5 * sizes[rows] * factors[best], _LEAST)
            if not rows.size:
                break
        ends = [Corner(tuple(u), k) for u, k in zip(place.tolist(), late, strict=True)]
        self._examined(plants, ends, {key: here})

    def _ascend(self, plants: BoxPlants, here: Examined, key: str) -> None:
        """Increase the utilization of a limit from a plant by steps along the gradient within the box."""
        n, size = len(here.corner.place), _FIRST
        for _ in range(_LARGEST if n else 0):
            u = np.array(here.corner.place)
            # inwards, so that every difference is one of plants in the box
            inward = np.where(u > 0.0, -_DIFFERENCE, _DIFFERENCE)
            beside = self.at(plants, (_moved(here.corner, u + step) for step in np.diag(inward)))
            slope = np.array([plant.of(key) - here.of(key) for plant in beside]) / inward
            # along the faces that hold it: a steep slope out of the box would shorten every step within it
            slope[(u * slope > 0.0) & (np.abs(u) >= 1.0)] = 0.0
            if not (np.all(np.isfinite(slope)) and np.any(slope)):
                return
            moved = False
            while size >= _LEAST and not moved:
                there = np.clip(u + size * slope / np.max(np.abs(slope)), -1.0, 1.0)
                if np.array_equal(there, u):
                    return
                other = self.at(plants, [_moved(here.corner, there)])[0]
                moved = other.of(key) > here.of(key)
                here, size = (other, 1.5 * size) if moved else (here, 0.5 * size)
            # an unstable plant is as bad as can be: nothing is found beyond
            if not moved or not np.isfinite(here.used):
                return


def _starts(plants: BoxPlants, places: Places) -> np.ndarray:
    """Return the places from which a limit is climbed: of each peak or crossover those at the worst plants.

    A corner, or the middle of an edge, is a start if the same peak is lower at all plants that an edge joins to it;
    of corners and of plants drawn at random the worst are, too.  Two peaks are the same if their frequencies differ by
    less than a search follows.
    """
    high = np.flatnonzero(places.used > _NEARLY * np.max(places.used))
    # the worst first; a peak that is computed twice, on a line and between lines, counts once
    high = high[np.argsort(-places.used[high], kind="stable")]
    plant, x = places.plant[high], np.log(places.frequency[high])
    same = np.abs(x[:, None] - x) < WIDE
    before = np.tri(high.size, k=-1, dtype=bool)
    single = ~np.any(before & same & (plant[:, None] == plant), axis=1)
    lower = np.any(before & same & plants.adjacent[plant[:, None], plant], axis=1)
    corner, on_edge, inside = (numbers[plant] for numbers in plants.groups)
    found = np.flatnonzero(single & ~lower & (corner | on_edge))[:_MOST].tolist()
    for group in (corner, inside):
        chosen = list[int]()
        for i in np.flatnonzero(single & group).tolist():
            if np.count_nonzero(same[i, chosen]) < _STARTS:
                chosen.append(i)
        found += chosen
    return high[list(dict.fromkeys(found))]


def _moved(corner: Corner, place: np.ndarray) -> Corner:
    return replace(corner, place=tuple(place.tolist()))


def _alike(a: Corner, b: Corner) -> bool:
    return a.late == b.late and all(abs(u - v) < _ALIKE for u, v in zip(a.place, b.place, strict=True))


def _sorted(plants: Iterable[Examined]) -> list[Examined]:
    return sorted(plants, key=lambda plant: -plant.used)


class Spread(NamedTuple):
    """A figure of a control at the model and at the worst plant of a box.

    Both are None if the loop has no such figure, for example if it is unstable; `plant` names the worst plant, and
    `at` is its loop under the control of the model.
    """

    figure: Figure
    nominal: float | None
    worst: float | None
    plant: Text
    at: Loop | None = None


@dataclass(frozen=True, eq=False, repr=False)
class OverBox(Result):
    """A control over a box: every figure at the model beside that at the worst plant, and whether its limits hold.

    text      the box in words, with the ends of every parameter
    examined  number of plants that were examined
    corners   number of these that are corners, and of all corners of the box
    used      utilization of the limit that is used most, at the worst plant `plant`; infinite: the loop is unstable
    spreads   the figures
    reason    why it is undecided although the utilization says otherwise; empty if there is no such reason
    """

    box: Box
    text: Text
    examined: int
    corners: tuple[int, int]
    used: float
    plant: Text
    spreads: tuple[Spread, ...]
    reason: str = ""

    @property
    def holds(self) -> bool | None:
        """True if all limits hold at every examined plant, False if one is violated, None if that is undecided."""
        if self.used > 1.0 + UNDECIDED:
            return False
        return None if self.used > 1.0 or self.reason else True

    @property
    def verdict(self) -> str:
        """The verdict in a word."""
        return VERDICTS[self.holds]

    @property
    def covered(self) -> Text:
        """How many plants were examined, in words."""
        of_all = f"{self.corners[0]} of {self.corners[1]} corners"
        return Text(f"{self.examined} plants examined, among them {of_all}")

    def spread(self, figure: Figure) -> Spread | None:
        """Return a figure at the model and at its worst plant; None if it was not computed."""
        return next((spread for spread in self.spreads if spread.figure == figure), None)

    def record(self) -> dict[str, Any]:
        """Return what was examined as plain numbers for JSON; None stands for what does not exist."""
        return {
            "box": str(self.box),
            "parameters": self.text,
            "verdict": self.verdict,
            "plants_examined": self.examined,
            "corners": {"examined": self.corners[0], "all": self.corners[1]},
            "limit_used": self.used if np.isfinite(self.used) else None,
            "worst_plant": self.plant,
            "figures": {s.figure.key: {"model": s.nominal, "worst": s.worst, "plant": s.plant} for s in self.spreads},
        }

    def sentence(self, limits: Limits) -> Text:
        """Return the verdict with the worst plant, as a clause."""
        if not np.isfinite(self.used):
            return Text(f"unstable at {self.plant}")
        worst = [(limit, self.spread(limit.figure)) for limit in limits.limits]
        texts = [
            Text(f"{limit.figure.title} {Quantity(spread.worst, limit.figure.unit)} at worst ({spread.plant})")
            for limit, spread in worst
            if spread is not None and spread.worst is not None
        ]
        return joined("; ", [*texts, *([Text(self.reason)] if self.reason else [])])

    def table(self) -> Table:
        """Tabulate every figure at the model and at the worst plant."""
        rows: list[Sequence[Cell]] = [
            [s.figure.label or s.figure.title, s.figure.quantity(s.nominal), s.figure.quantity(s.worst), UNIT, s.plant]
            for s in self.spreads
        ]
        title = Text(f"over the box: {self.text}; {self.verdict}")
        return Table(title, ["what", "model", "worst", "unit", "worst plant"], rows)


def worst_plants(
    control: Control, boxes: Sequence[BoxPlants], limits: Limits, *, inside: bool = True
) -> tuple[Examination, list[Examined]]:
    """Examine a control over the boxes of all operating points; return the examination and its plants, the worst first.

    inside  False to examine the corners alone, which costs less
    """
    first = boxes[0]

    def examined() -> tuple[Examination, list[Examined]]:
        examination = Examination(control, float(first.loop.sample_time), limits, first.velocity)
        found = examination.searched if inside else examination.corners
        return examination, examination.sharpened([plant for plants in boxes for plant in found(plants)])

    # a comparison asks for the control that its tuning has just examined
    numbers = tuple(value for _, value in tree.leaves(control))
    tables = tuple(row.tobytes() for _, row in tree.tables(control))
    return _LATEST.get((tree.structure(control), numbers, tables, limits, tuple(boxes), inside), examined)


_LATEST = Recent[tuple[Examination, list[Examined]]](_LAWS)


def over_box(
    control: Control,
    boxes: Sequence[BoxPlants],
    limits: Limits,
    *,
    inside: bool = True,
    shown: Sequence[Figure] | None = None,
    known: tuple[Examination, list[Examined]] | None = None,
) -> tuple[OverBox, list[Examined]]:
    """Examine a control over the boxes of all operating points; return the result and its plants, the worst first.

    inside  False to examine the corners alone, which costs less
    shown   the figures beside those at the model; default: those that a tuning reports
    known   what `worst_plants` returned for this control
    """
    first = boxes[0]
    examination, found = known or worst_plants(control, boxes, limits, inside=inside)
    worst = found[0]
    models = [plant for plants in boxes for plant in examination.at(plants, plants.middle[:1])]
    # other figures than those of the limits are worst at a corner, or where a limit is
    corners = [p for plants in boxes for p in examination.at(plants, (*plants.corners, *plants.middle))]
    # those that were examined on all lines take the place of what few lines told of them
    found = _sorted({(id(plant.plants), plant.corner): plant for plant in (*corners, *found)}.values())
    counted = (
        sum(len(plants.corners) for plants in boxes),
        sum(plants.box.all_corners(plants.loop.axis) for plants in boxes),
    )
    result = OverBox(
        box=first.box,
        text=joined("; ", [plants.box.text(plants.loop.axis) for plants in boxes]),
        examined=sum(examination.count(plants) for plants in boxes),
        corners=counted,
        used=max(worst.used, found[0].used),
        plant=found[0].name,
        spreads=tuple(_spreads(examination, models, found, reported() if shown is None else shown)),
    )
    return result, found


def _spreads(
    examination: Examination, models: Sequence[Examined], found: Sequence[Examined], shown: Sequence[Figure]
) -> Iterable[Spread]:
    """Yield the figures at the models and at their worst plants, both on all lines."""
    close: dict[Corner, Examined] = {}
    loops: dict[tuple[int, Corner], Loop] = {}

    def closely(plant: Examined) -> Examined:
        if plant.corner not in close:
            close[plant.corner] = plant._replace(figures=examination.closely(plant))
        return close[plant.corner]

    models = [closely(plant) for plant in models]
    for figure in shown:
        if not figure.better:
            continue
        nominal, plant = _worst_of(figure, models), _worst_of(figure, found)
        unstable = plant is not None and not np.isfinite(plant.used)
        worst = None if plant is None or unstable else figure.read(closely(plant).figures)
        value = None if nominal is None or not np.isfinite(nominal.used) else figure.read(nominal.figures)
        if value is not None or worst is not None:
            named = Text() if plant is None else Text(f"unstable at {plant.name}") if unstable else plant.name
            if plant is not None and (id(plant.plants), plant.corner) not in loops:
                loops[id(plant.plants), plant.corner] = plant.plants.box.plant(plant.plants.loop, plant.corner)
            at = None if plant is None else loops[id(plant.plants), plant.corner]
            yield Spread(figure, value, worst, named, at)


def _worst_of(figure: Figure, plants: Sequence[Examined]) -> Examined | None:
    """Return the plant at which a figure is worst: one at which the loop is unstable, if any; None without figures."""
    unstable = next((plant for plant in plants if not np.isfinite(plant.used)), None)
    if unstable is not None:
        return unstable
    sizes = [
        (abs(value), i)
        for i, plant in enumerate(plants)
        if plant.figures is not None and (value := figure.read(plant.figures)) is not None
    ]
    return plants[(min if figure.higher else max)(sizes)[1]] if sizes else None

"""Goal and limits of a tuning: their values, derivatives and uncertainties at every operating point."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np

from feeddrive.blocks.filter.notch import Notch
from feeddrive.figures.catalogue import limitable
from feeddrive.figures.figure import Figure, Limit
from feeddrive.figures.slopes import JudgedLoop, Place, Places, Slope, SlopedLoop, rope_snap_slope
from feeddrive.language.errors import FeeddriveError, NotIdentifiableError, ParameterError, nearest
from feeddrive.language.quantity import Quantity, number, span
from feeddrive.language.text import Text, joined
from feeddrive.loop.control import Control
from feeddrive.tuning.closed_loop import Answer, Below, answer, encircles, grows, unstable, unstable_among
from feeddrive.tuning.control_response import ControlResponse, Response
from feeddrive.tuning.operating_point import OperatingPoint, one_encoder


@dataclass(frozen=True, init=False)
class Limits:
    """Limits of a tuned loop, at every operating point: `Limits(sensitivity_peak=1.7, gain_margin_dB=6.0)`.

    limits         the limits in effect, in the order of the catalogue of figures
    reading_noise  white noise of the two readings, m RMS, from which the force noise is computed
    snap_force     a force step on the table, N, that must not saturate the command in the simulation of the proof

    Bounds are given as keyword arguments named by figure (`figures.limitable`), in SI, or as `Limit` objects. A default
    limit applies unless it is replaced or, as by `sensitivity_peak=None`, removed.
    Raises ParameterError for a figure that no tuning can limit, and for a bound out of range.
    """

    limits: tuple[Limit, ...]
    reading_noise: tuple[float, float]
    snap_force: float | None

    def __init__(
        self,
        limits: Iterable[Limit] = (),
        *,
        reading_noise: tuple[float, float] = (0.0, 0.0),
        snap_force: float | None = None,
        **bounds: float | None,
    ) -> None:
        limitables = {figure.key: figure for figure in limitable()}
        for key in bounds:
            if key not in limitables:
                raise ParameterError(
                    f"no tuning can limit '{key}'{nearest(key, limitables)}; it can {', '.join(limitables)}"
                )
        stated = {limit.figure.key: limit.bound for limit in limits} | bounds
        chosen = {
            key: stated.get(key, None if figure.limit is None else figure.limit.usual)
            for key, figure in limitables.items()
        }
        effective = tuple(Limit(limitables[key], bound) for key, bound in chosen.items() if bound is not None)
        for limit in effective:
            if limit.declared.noise and not any(value > 0.0 for value in reading_noise):
                raise ParameterError(f"{limit.figure.key} needs reading_noise: the errors of the two readings in m RMS")
        if snap_force is not None and not (np.isfinite(snap_force) and snap_force > 0.0):
            raise ParameterError(f"snap_force = {Quantity(snap_force, 'N'):6 SI} must be a finite number > 0")
        # the class is frozen
        object.__setattr__(self, "limits", effective)
        object.__setattr__(self, "reading_noise", reading_noise)
        object.__setattr__(self, "snap_force", snap_force)

    def limit(self, figure: Figure) -> Limit | None:
        """Return the limit of a figure; None if there is none."""
        return next((limit for limit in self.limits if limit.figure == figure), None)

    def bound(self, figure: Figure) -> float | None:
        """Return the bound of a figure in SI; None if it has no limit."""
        limit = self.limit(figure)
        return None if limit is None else limit.bound

    def having(self, *limits: Limit, reading_noise: tuple[float, float] | None = None) -> Limits:
        """Return a copy of these limits in which the given ones replace those of the same figures."""
        bounds: dict[str, float | None] = {figure.key: self.bound(figure) for figure in limitable()}
        bounds |= {limit.figure.key: limit.bound for limit in limits}
        noise = self.reading_noise if reading_noise is None else reading_noise
        return Limits((), reading_noise=noise, snap_force=self.snap_force, **bounds)

    def only(self, key: str) -> Limits:
        """Return a copy of these limits with the limit of one figure alone, by its key."""
        bounds: dict[str, float | None] = {figure.key: None for figure in limitable()}
        bounds[key] = next((limit.bound for limit in self.limits if limit.figure.key == key), None)
        return Limits((), reading_noise=self.reading_noise, snap_force=self.snap_force, **bounds)

    def eased(self, figure: Figure, factor: float) -> Limits:
        """Return a copy of these limits in which the limit of one figure is relaxed by a factor."""
        limit = self.limit(figure)
        return self if limit is None else self.having(limit.eased(factor))

    def sentence(self) -> Text:
        """Return all limits as a clause."""
        return joined(", ", map(self.text, self.limits)) or Text("stability alone")

    def text(self, limit: Limit) -> Text:
        """Return one limit as a clause."""
        return Text(f"{limit.text} at {self._readings()}") if limit.declared.noise else limit.text

    def bound_text(self, limit: Limit) -> Text:
        """Return the bound of a limit as words that follow its figure: `at most 2`."""
        word = "at least" if limit.figure.higher else "at most"
        noise = f" at {self._readings()}" if limit.declared.noise else ""
        return Text(f"{word} {Quantity(limit.bound, limit.figure.unit)}{noise}")

    def _readings(self) -> str:
        motor, load = (Quantity(noise, "m", form="nm") for noise in self.reading_noise)
        return f"{motor} of white noise in the readings" if motor == load else f"{motor} (motor) and {load} (load)"


class Judged(NamedTuple):
    """A figure of a loop compared with its limit.

    value  value in SI; None if the loop has no such figure, for example no margin because L has no crossover; a
           missing figure satisfies every limit
    """

    limit: Limit
    value: float | None
    keeps: bool

    @property
    def figure(self) -> Figure:
        """The limited figure."""
        return self.limit.figure

    @property
    def used(self) -> float:
        """The utilization of the limit: above 1 the limit is violated; 0 if the figure does not exist."""
        return self.limit.used(self.value)

    @property
    def text(self) -> Text:
        """The title of the figure with its value, in words."""
        if self.value is None:
            return Text(f"no {self.figure.title}, there is no crossover")
        return Text(f"{self.figure.title} {Quantity(self.value, self.figure.unit)}")

    def __str__(self) -> str:
        return str(self.text)


def judged(limits: Limits, loop: JudgedLoop, room: float) -> tuple[Judged, ...]:
    """Compare the figures of a stable loop with the limits; `room` is the tolerance as a fraction of the limit.

    An unknown force noise is not checked. The absolute value of a phase margin counts: in a stable loop a negative
    phase margin means that L passes -1 on the other side at the same distance.
    """
    values = ((limit, limit.figure.read(loop)) for limit in limits.limits)
    return tuple(
        Judged(limit, value, limit.keeps(value, room))
        for limit, value in values
        if value is not None or not limit.declared.noise
    )


NOTCH = "notch"  # the bound that prevents a notch from amplifying


class Bound(NamedTuple):
    """A limit at one frequency of one operating point, as an inequality of the search: slack >= 0.

    figure     the limited figure; None for the bound that ensures that a notch attenuates
    slope      derivatives of the slack with respect to the tunables
    deviation  standard deviation of the slack due to the measurement
    key        kind, operating point, and line of a limit or number of the filter that is a notch
    """

    figure: Figure | None
    point: int
    frequency: float
    slack: float
    slope: np.ndarray
    deviation: float
    key: tuple[str, int, int]

    @property
    def kind(self) -> str:
        """The title of the limited figure, or `notch` for the bound on a notch."""
        return NOTCH if self.figure is None else self.figure.title


class Bounds:
    """The bounds of an evaluation, in groups of one figure at one point.

    Each `Bound` is made when it is asked for: a step of a search needs hundreds of them as columns, and a few one by
    one.
    """

    def __init__(self, groups: Sequence[tuple[Figure | None, str, int, Places]] = ()) -> None:
        self.groups = tuple(groups)

    @classmethod
    def of(cls, bounds: Iterable[Bound]) -> Bounds:
        """Return bounds in groups of one each."""
        return cls([(b.figure, b.key[0], b.point, Places.of([Place(*b[2:6], b.key[2])])) for b in bounds])

    def __add__(self, other: Bounds) -> Bounds:
        return Bounds((*self.groups, *other.groups))

    def __len__(self) -> int:
        return sum(len(places) for *_, places in self.groups)

    def __iter__(self) -> Iterator[Bound]:
        for figure, kind, point, places in self.groups:
            for frequency, slack, slope, deviation, line in places:
                yield Bound(figure, point, frequency, slack, slope, deviation, (kind, point, line))

    @cached_property
    def slack(self) -> np.ndarray:
        """The slack of each bound."""
        return np.concatenate([places.slack for *_, places in self.groups]) if self.groups else np.zeros(0)

    @cached_property
    def deviation(self) -> np.ndarray:
        """The standard deviation of the slack of each bound."""
        return np.concatenate([places.deviation for *_, places in self.groups]) if self.groups else np.zeros(0)

    def slope(self, tunables: int) -> np.ndarray:
        """Return the derivatives of the slack of each bound, shape (bounds, tunables)."""
        some = [places.slope for *_, places in self.groups if len(places)]
        return np.concatenate(some) if some else np.zeros((0, tunables))

    @cached_property
    def keys(self) -> list[tuple[str, int, int]]:
        """The key of each bound."""
        return [(kind, point, line) for _, kind, point, places in self.groups for line in places.line.tolist()]


def bounds_of(i: int, loop: SlopedLoop, limits: Limits) -> Bounds:
    """Return the bounds of point `i` that are violated or close to violation.

    For a loop without derivatives, a limit that applies to every line yields only its most critical line.
    """
    noise = limits.reading_noise
    return Bounds(
        [
            (limit.figure, limit.figure.key, i, Places.of(limit.declared.places(loop, limit.bound, noise)))
            for limit in sorted(limits.limits, key=_order)
        ]
    )


def _order(limit: Limit) -> int:
    return limit.declared.order


def notches_stay_notches(control: Control, tunables: Sequence[str], x: np.ndarray) -> list[Bound]:
    """Return the bounds that ensure that each notch attenuates: damping_zero <= damping_pole.

    x holds the logarithms of the tunables.
    """
    bounds: list[Bound] = []
    for i, block in enumerate(control.filters):
        names = [f"filters.{i}.{field}" for field in ("damping_zero", "damping_pole")]
        if not isinstance(block, Notch) or not set(names) & set(tunables) or not block.damping_zero > 0.0:
            continue
        slope, values = np.zeros(x.size), [np.log(block.damping_zero), np.log(block.damping_pole)]
        for k, (name, sign) in enumerate(zip(names, (-1.0, 1.0), strict=True)):
            if name in tunables:
                place = list(tunables).index(name)
                slope[place], values[k] = sign, x[place]
        bounds.append(Bound(None, 0, 0.0, float(values[1] - values[0]), slope, 0.0, (NOTCH, 0, i)))
    return bounds


# On the ball screw the goal bandwidth alone lowers Kv from 100 to 0.1 1/s for 73 Hz; with this weight it ends at
# 6.4 1/s and 71 Hz (docs/how_to/tuning.md).
_BESIDE = 0.02  # weight of the logarithm of the rope-snap error, added to another goal


_LOOKED = 3  # in a look with plants of a box one of so many lines of a point with a goal counts
_FEWEST = 50  # least number of lines that remain after decimation


def some(lines: np.ndarray, every: int) -> np.ndarray:
    """Thin out lines: return every `every`-th line and the last one if enough lines remain, else all lines."""
    return np.union1d(lines[::every], lines[-1:]) if lines.size >= every * _FEWEST else lines


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The evaluation of a controller: stability, goal at each point (lower is better) with derivatives, and bounds."""

    stable: bool
    goal: np.ndarray  # (points with a goal,)
    slope: np.ndarray  # (points with a goal, tunables)
    curvature: np.ndarray  # (tunables, tunables)
    bounds: Bounds

    def slacks(self, sure: float) -> np.ndarray:
        """Return what the slack of each bound has beyond `sure` standard deviations."""
        return self.bounds.slack - sure * self.bounds.deviation

    @property
    def slopes(self) -> np.ndarray:
        """The derivatives of the slack of each bound, shape (bounds, tunables)."""
        return self._slopes

    @cached_property
    def _slopes(self) -> np.ndarray:
        return self.bounds.slope(self.slope.shape[1])


class Screened(Protocol):
    """Plants of a box whose limits are computed together, without derivatives."""

    def bounds(self, control: ControlResponse, matrix: np.ndarray, limits: Limits) -> Iterable[Bound]:
        """Yield for each limit the bound of the plant that uses it most; `matrix`: [A B; c d] of the control.

        Each is computed when it is asked for: the first one may show that the control is not worth the others.
        """
        ...

    def unstable(self, matrix: np.ndarray) -> bool:
        """Return True if the loop is unstable at any of the plants."""
        ...


class Criteria:
    """The evaluation of goal and limits of a controller at all operating points.

    goal  a figure with a `Goal`, which counts at all points but those with bounds only
    near  True to use only the nearest images of a multirate controller, as in all searches but the last
    screened  the points with bounds only once more, as plants that a look screens; empty if it cannot
    """

    def __init__(
        self,
        points: tuple[OperatingPoint, ...],
        control: ControlResponse,
        goal: Figure,
        limits: Limits,
        band: tuple[float, float],
        *,
        near: bool = False,
        screened: Sequence[Screened] = (),
    ) -> None:
        self.screened = screened
        self.points, self.control, self.goal, self.limits, self.band = points, control, goal, limits, band
        self.near = near
        assert goal.goal is not None
        self._declared = goal.goal
        self._known: dict[bytes, Evaluation] = {}
        self._latest: tuple[bytes, list[Answer]] | None = None
        # what is below the first line counts for the goal alone
        self._below = [None if point.bounds_only else Below(point) for point in points]
        below = [np.zeros(0) if part is None else part.frequency for part in self._below]
        every = [part for pair in zip(below, (point.frequency for point in points), strict=True) for part in pair]
        self._lines, places = np.unique(np.concatenate(every), return_inverse=True)
        self._places = np.split(places, np.cumsum([part.size for part in every])[:-1])
        self._images = [
            _none_below(control.images(point.by_force_at, point.frequency), lines.size)
            for point, lines in zip(points, below, strict=True)
        ]

    @property
    def over_plants(self) -> bool:
        """True if limits apply at plants of a box too."""
        return any(point.bounds_only for point in self.points)

    @property
    def count(self) -> int:
        """The number of sets of tunables that were evaluated."""
        return len(self._known)

    def answers(self, x: np.ndarray) -> list[Answer]:
        """Return the closed loop at each operating point for tunables exp(x), with derivatives with respect to x."""
        key = np.asarray(x, float).tobytes()
        # an evaluation is often followed by a question for its closed loops
        if self._latest is None or self._latest[0] != key:
            values = np.exp(x)
            if self.control.period > 1:
                loops = self._of_two_rates(values)
            else:
                loops = self._answers(self.control.at(values, self._lines), values)
            self._latest = key, loops
        return self._latest[1]

    def _of_two_rates(self, values: np.ndarray, *, look: bool = False) -> list[Answer]:
        """Return the closed loops of a multirate controller, whose response also depends on the axis."""
        answers: list[Answer] = []
        for point, images, below in zip(self.points, self._images, self._below, strict=True):
            # the lines of the point come first, those below it after them: one period for both
            lines = point.frequency if below is None else np.concatenate([point.frequency, below.frequency])
            alike, count = one_encoder(point), point.frequency.size
            whole = self.control.at(values, lines, images, near=self.near, slopes=not look, alike=alike)
            whole = _to_logarithms(whole, np.zeros(0) if look else values)
            rest = whole.rest
            assert rest is not None
            first, last = (
                whole._replace(value=whole.value[:, part], slope=whole.slope[:, part], rest=rest[part])
                for part in (slice(count), slice(count, None))
            )
            answers.append(answer(point, first, None if below is None else below.recovery(last)))
        return answers

    def _answers(self, whole: Response, values: np.ndarray) -> list[Answer]:
        """Return the closed loops of a single-rate controller from its response on the lines of all points."""
        slope = whole.slope * values

        def part(place: np.ndarray) -> Response:
            return whole._replace(value=whole.value[:, place], slope=slope[:, place])

        return [
            answer(point, part(fast), None if below is None else below.recovery(part(slow)))
            for point, below, slow, fast in zip(
                self.points, self._below, self._places[::2], self._places[1::2], strict=True
            )
        ]

    def looked(
        self,
        x: np.ndarray,
        promising: Callable[[int, Evaluation], bool] = lambda _place, _evaluation: True,
        *,
        goal_first: bool = False,
    ) -> Iterator[Evaluation | None]:
        """Evaluate many sets of tunables without derivatives; yield None for a set whose evaluation fails.

        x          the logarithms of the tunables, shape (sets, tunables)
        promising  is asked with the number of a set and what was evaluated of it so far: goal and limits at the points
                   with a goal, then the limits at one plant of a box after the other.  Where it returns False the rest
                   is left out.
        goal_first  True to ask it before the limits at the points with a goal, too

        The models of a single-rate controller are computed for all sets at once, so that a set costs a fraction of a
        search step. A multirate controller is evaluated set by set, on a part of the lines and with the nearest images
        only.
        """
        models = self.control.models(np.exp(x)) if self.control.period == 1 else [None] * len(x)
        for i, (place, matrix) in enumerate(zip(x, models, strict=True)):
            try:
                yield self._look(place, matrix, lambda evaluation, i=i: promising(i, evaluation), goal_first)
            except (FeeddriveError, ArithmeticError, np.linalg.LinAlgError):
                # a scattered point may overflow or leave the bounds of a block: it only drops out of the population
                yield None

    @cached_property
    def _parts(self) -> tuple[Criteria, ...]:
        """The criteria of a look: at the points with a goal, and at the plants of a box, if there are any."""
        points, several = self.points, self.control.period > 1
        if several or self.screened:
            # beside plants that are screened the points with a goal need no more lines than those have
            every = _LOOKED if not several else 2 if self.near else 4
            points = tuple(point.chosen(some(np.arange(point.frequency.size), every)) for point in points)
        return tuple(
            Criteria(tuple(part), self.control, self.goal, self.limits, self.band, near=several)
            for bounds_only in (False, True)
            if (part := [point for point in points if point.bounds_only is bounds_only])
        )

    def _look(
        self, x: np.ndarray, matrix: np.ndarray | None, promising: Callable[[Evaluation], bool], goal_first: bool
    ) -> Evaluation | None:
        """Evaluate one set of tunables; None if its loop is unstable at a point."""
        parts = self._parts[:1] if self.screened else self._parts
        samples = self.control.of_a_period(np.exp(x)) if matrix is None else matrix[None]
        # poles first: they cost a fraction of the lines, and many sets are unstable
        points = self.points if matrix is None else parts[0].points
        if any(grows(point.model, samples) for point in points if point.model is not None):
            return None
        found: Evaluation | None = None
        for part in parts:
            answers = (
                part._of_two_rates(np.exp(x), look=True)
                if matrix is None
                else part._answers(self.control.of_model(matrix, part._lines), np.zeros(0))
            )
            if found is None:
                if any(encircles(loop) for loop in answers if loop.point.model is None):
                    return None
                found = part._goals(answers)
                if goal_first and not promising(found):
                    return found
                found = part._with_bounds(found, x, answers)
                continue
            for loop in answers:
                if not promising(found):
                    return found
                if unstable(loop):
                    return None
                found = replace(found, bounds=found.bounds + bounds_of(0, loop, self.limits))
        assert found is not None
        if matrix is None or not (self.screened and promising(found)):
            return found
        for plants in self.screened:
            for bound in plants.bounds(self.control, matrix, self.limits):
                found = replace(found, bounds=found.bounds + Bounds.of([bound]))
                if not promising(found):
                    return found
        # poles last: they cost more than the lines, and most sets are no longer promising
        return None if any(plants.unstable(matrix) for plants in self.screened) else found

    def __call__(self, x: np.ndarray) -> Evaluation:
        """Return the evaluation for logarithms x of the tunables; results are cached."""
        key = np.asarray(x, float).tobytes()
        if key not in self._known:
            evaluation = self.judged(x, self.answers(x))
            # a control whose blocks refuse the sample time, such as a too fast observer, cannot run
            if evaluation.stable and not self.control.is_admissible(np.exp(x)):
                evaluation = replace(evaluation, stable=False)
            self._known[key] = evaluation
        return self._known[key]

    def judged(self, x: np.ndarray, answers: list[Answer]) -> Evaluation:
        """Evaluate goal and bounds for the given closed loops."""
        evaluation = self._with_bounds(self._goals(answers), x, answers)
        return replace(evaluation, stable=False) if unstable_among(answers) else evaluation

    def _goals(self, answers: list[Answer]) -> Evaluation:
        """Evaluate the goal alone for closed loops that are known to be stable."""
        goals = [self._goal(loop) for loop in answers if not loop.point.bounds_only]
        worst = int(np.argmax([value for value, _, _ in goals]))
        return Evaluation(
            True,
            np.array([value for value, _, _ in goals]),
            np.array([slope for _, slope, _ in goals]),
            goals[worst][2],
            Bounds(),
        )

    def _with_bounds(self, evaluation: Evaluation, x: np.ndarray, answers: list[Answer]) -> Evaluation:
        """Return an evaluation of the goal with the bounds of the closed loops."""
        groups = [group for i, loop in enumerate(answers) for group in bounds_of(i, loop, self.limits).groups]
        notches = notches_stay_notches(self.control.control, self.control.tunables, x)
        return replace(evaluation, bounds=Bounds(groups) + Bounds.of(notches))

    def _goal(self, loop: Answer) -> Slope:
        """Return the logarithm of the quantity to minimize, its derivatives, and the Gauss-Newton part of its Hessian.

        If the goal does not measure the recovery time of the axis, the search would sacrifice the position gain for a
        negligible benefit. The logarithm of the rope-snap error is therefore added with a weight of 1/50.
        """
        goal = self._declared.slope(loop, self.band)
        if self._declared.returns:
            return goal
        snap = rope_snap_slope(loop, self.band)
        return Slope(
            goal.value + _BESIDE * snap.value,
            goal.slope + _BESIDE * snap.slope,
            goal.curvature + _BESIDE * snap.curvature,
        )


def _none_below(images: np.ndarray | None, lines: int) -> np.ndarray | None:
    """Return the axis response at the images with that of further lines, whose loops at the images are left open."""
    return None if images is None else np.concatenate([images, np.zeros((2, lines, images.shape[2]))], axis=1)


def _to_logarithms(response: Response, values: np.ndarray) -> Response:
    """Convert the derivatives of a response to derivatives with respect to the logarithms of the tunables."""
    return response._replace(slope=response.slope * values)


_TOGETHER = 0.15  # of ln f: bounds nearer than this at one point share their noise and count once
_POOR = 0.5  # largest share of the distance to -1 that the noise may take up
_BEYOND = 3.0  # multiple of the crossover up to which the measurement must be accurate
_LOW = 0.3  # largest |L| at the last line
_BEFORE = 2.0  # multiple of the first line: lower limit of the lowest crossover
_GAP = 1.6  # ratio of two neighboring lines around a crossover


def distances(bounds: Iterable[Bound]) -> np.ndarray:
    """Return the slack of each independent bound in standard deviations, smallest first.

    Bounds at neighboring frequencies of a point are not independent; only the most critical one counts.
    """
    left = sorted((b for b in bounds if b.deviation > 0.0), key=lambda b: b.slack / b.deviation)
    kept: list[Bound] = []
    for bound in left:
        if all(b.point != bound.point or abs(np.log(b.frequency / bound.frequency)) > _TOGETHER for b in kept):
            kept.append(bound)
        # 1 - Φ(8) is 6e-16: what lies further away does not change the probability
        if bound.slack / bound.deviation > 8.0:
            break
    return np.array([b.slack / b.deviation for b in kept])


def chance(bounds: Iterable[Bound]) -> float:
    """Return the probability that all bounds are satisfied, Π Φ(slack/σ), for independent normal noise."""
    return _all_below(distances(bounds))


def _all_below(deviations: np.ndarray) -> float:
    """Return the probability that independent standard normal variables are each below the given values."""
    # imported here: scipy is slow to load, and only points with variances need it
    from scipy.special import ndtr

    return float(np.prod(ndtr(deviations)))


def needed(bounds: Iterable[Bound], sure: float, confidence: float) -> float:
    """Return the margin, in standard deviations, with which all bounds are satisfied at the given confidence.

    `sure` is the margin of the search that gave these bounds.
    """
    # assumes that a larger reserve raises all distances alike; the caller repeats the search with it
    separate = distances(bounds)
    if not separate.size:
        return sure

    def off(more: float) -> float:
        return _all_below(separate + more) - confidence

    low, high = -5.0, 8.0
    if off(low) > 0.0 or off(high) < 0.0:
        return sure
    while high - low > 1e-4:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if off(middle) < 0.0 else (low, middle)
    return max(0.0, sure + high)


def require_covered(answers: Sequence[Answer]) -> None:
    """Raise NotIdentifiableError, naming the band, if frequency lines that a tuning needs are missing.

    The lowest crossover must lie above twice the frequency of the first line. From half of the lowest to twice the
    highest crossover, the frequency ratio of neighboring lines must not exceed 1.6. The loop gain must have fallen to
    0.3 at the last line, unless the lines extend to three times the highest crossover, or nearly to half the sample
    rate.
    """
    for loop in answers:
        f, size, point = loop.point.frequency, np.abs(loop.gain), loop.point
        # the lines of a model are chosen, not measured
        if point.loop is not None:
            continue
        above, below = np.flatnonzero(size >= 1.0), np.flatnonzero(size < 1.0)
        again = f"do not tune, measure again: '{point.name}'"
        if not above.size or (below.size and f[below[0]] < _BEFORE * f[0]):
            raise NotIdentifiableError(
                f"{again} begins at {Quantity(f[0], 'Hz')}, where the loop gain is only {number(size[0], 2)}: lower "
                f"frequencies are decisive; measure from {Quantity(0.1 * f[0], 'Hz'):2} on, a fifth of the crossover "
                "or less"
            )
        crossover = float(f[above[-1]])
        if size[-1] > _LOW and f[-1] < _BEYOND * crossover and f[-1] < 0.45 / point.sample_time:
            raise NotIdentifiableError(
                f"{again} ends at {Quantity(f[-1], 'Hz')}, where the loop gain is still {number(size[-1], 2)}; measure "
                f"up to at least {Quantity(_BEYOND * crossover, 'Hz')}, three times the crossover"
            )
        first = float(f[below[0]]) if below.size else crossover
        for k in np.flatnonzero(f[1:] / f[:-1] > _GAP):
            if f[k + 1] > first / _BEFORE and f[k] < _BEFORE * crossover:
                raise NotIdentifiableError(
                    f"{again} has no lines from {span(f[k], f[k + 1], 'Hz')}, and "
                    f"the crossover lies near, at {Quantity(first if f[k] < first else crossover, 'Hz')}; measure this "
                    "band too"
                )


def require_good(answers: Sequence[Answer], sure: float) -> None:
    """Raise NotIdentifiableError, naming the band, if the noise is too large for a tuning.

    On all lines up to three times the highest crossover, `sure` standard deviations of L in the direction of -1 must
    not exceed half of |1 + L|.
    """
    for loop in answers:
        f, L, point = loop.point.frequency, loop.gain, loop.point
        above = np.flatnonzero(np.abs(L) >= 1.0)
        crossover = float(f[above[-1]]) if above.size else float(f[0])
        if point.variance is None:
            continue
        # the variance is that of a complex number: half of it lies in the direction of -1
        excess = sure * np.sqrt(0.5 * loop.gain_variance) > _POOR * np.abs(1.0 + L)
        poor = np.flatnonzero(excess & (f <= _BEYOND * crossover))
        if poor.size:
            low, high = f[poor[0]], f[poor[-1]]
            worst = poor[np.argmax(loop.gain_variance[poor] / np.abs(1.0 + L[poor]) ** 2)]
            share = np.sqrt(point.variance[1, worst]) / np.abs(point.by_force[1, worst])
            raise NotIdentifiableError(
                f"do not tune, measure again: '{point.name}' is too noisy from {span(low, high, 'Hz')}, up to "
                f"{Quantity(share, 'share'):2} of the response at {Quantity(f[worst], 'Hz')}, below three "
                f"times the crossover of {Quantity(crossover, 'Hz')}; excite "
                "this band more strongly, or average longer"
            )

"""Tuning over the travel: the gains of every place, and what the schedule made of them does between the places."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple, Self, cast

import numpy as np

from feeddrive.analysis.stability import stability
from feeddrive.blocks.controller.gain_schedule import GainSchedule
from feeddrive.blocks.controller.schedule_place import SchedulePlace
from feeddrive.blocks.families import Law
from feeddrive.figures.catalogue import goals
from feeddrive.figures.figure import Figure, Limit
from feeddrive.figures.of_loops import SENSITIVITY_PEAK
from feeddrive.identification.travel import FEWEST, TravelFit, fit_over_travel
from feeddrive.language import tree
from feeddrive.language.errors import FeeddriveError, ParameterError, StructureError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column, Result, Table
from feeddrive.language.text import Text, joined
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.tuning.candidates import control_with
from feeddrive.tuning.closed_loop import Figures, figures
from feeddrive.tuning.control_response import ControlResponse
from feeddrive.tuning.criteria import Criteria, Judged, Limits, judged
from feeddrive.tuning.operating_point import modelled_point
from feeddrive.tuning.tune import Tuned, tune_control

_ROOM = 2e-3  # of a limit: tolerance at a position, as in the proof of a tuning
_ROUNDS = 4  # in which places give way to the positions between them


@dataclass(frozen=True, eq=False, repr=False)
class Travel(Result):
    """One axis at several positions, and its numbers between them.

    loop   the axis at the first position, with its control
    fits   each number of the axis that changes along the travel, by path, over the position
    """

    loop: Loop
    positions: np.ndarray
    fits: Mapping[str, TravelFit]

    @classmethod
    def of(cls, loops: Mapping[float, Loop], errors: Mapping[float, Mapping[str, float]] | None = None) -> Self:
        """Return the travel of an axis from its loops at three to ten positions in m, such as machine files.

        errors   standard errors of the numbers by position and path, as `identify` and `fit_two_mass` give them

        Stiffnesses are fitted by their inverse; see `fit_over_travel`. The control is that of the first position.
        Raises StructureError if the axes differ in more than numbers, and the errors of `fit_over_travel`.
        """
        places = np.array(sorted(loops), float)
        if places.size < FEWEST:
            raise ParameterError(
                f"the travel is known at {places.size} positions, and {FEWEST} are needed at least: with fewer nothing "
                f"would show that the axis is not what is assumed between them; measure at more positions"
            )
        first = loops[min(loops)]
        for place in places[1:]:
            differs = tree.difference(first.axis, loops[float(place)].axis, "axis")
            if differs is not None:
                raise StructureError(
                    f"at {Quantity(float(place), 'm'):6 SI} {differs}: along the travel only numbers may differ"
                )
            if loops[float(place)].sample_time != first.sample_time:
                raise ParameterError(
                    f"at {Quantity(float(place), 'm'):6 SI} the sample time is "
                    f"{Quantity(float(loops[float(place)].sample_time), 's'):6 SI}, not "
                    f"{Quantity(float(first.sample_time), 's'):6 SI}: one control has one sample time"
                )
        fits: dict[str, TravelFit] = {}
        rows = {float(place): tree.parameters(loops[float(place)]) for place in places}
        for path in rows[float(places[0])]:
            values = [float(rows[float(place)][path]) for place in places] if ".control." not in path else []
            if len(set(values)) > 1:
                sigma = None if errors is None else [errors[float(place)][path] for place in places]
                unit = tree.declaration(first, path).unit
                fits[path] = fit_over_travel(places, values, sigma, name=path, unit=unit)
        return cls(first, places, fits)

    def at(self, position: float) -> Loop:
        """Return the loop at a position (m), which must lie between the first and the last one that were measured."""
        if not self.positions[0] <= position <= self.positions[-1]:
            raise ParameterError(
                f"the axis at {Quantity(position, 'm'):6 SI}: it is known from "
                f"{Quantity(float(self.positions[0]), 'm'):6 SI} to {Quantity(float(self.positions[-1]), 'm'):6 SI}, "
                f"and nothing is extrapolated; measure there, too"
            )
        return tree.vary(self.loop, {path: fit.at(position)[0] for path, fit in self.fits.items()})

    def table(self) -> Table:
        """Return the numbers that change along the travel, at the positions that were measured."""
        rows = [
            [path, float(place), float(value), float(error), fit.unit]
            for path, fit in self.fits.items()
            for place, value, error in zip(fit.places, *fit.fitted, strict=True)
        ]
        columns = [
            "parameter",
            Column("position", "m", "5 mm"),
            Column("value", ""),
            Column("standard error", ""),
            "unit",
        ]
        return Table("the axis along its travel", columns, rows)


def frozen(control: Control, position: float) -> Control:
    """Return a control whose law has the parameters of a position (m): that of a schedule for an axis that stays there.

    A control without a schedule is returned unchanged.
    """
    law = control.law
    return replace(control, law=law.law_at(position)) if isinstance(law, GainSchedule) else control


class AtPosition(NamedTuple):
    """A frozen loop at a position: the largest |z| of its poles, its figures, the goal, and the limits it exceeds.

    figures   None if the loop is unstable
    goal      the quantity that is minimized; infinite if the loop is unstable
    """

    position: float
    growth: float
    figures: Figures | None
    goal: float
    exceeded: tuple[Judged, ...] = ()

    @property
    def keeps(self) -> bool:
        """True if the loop is stable and keeps all limits."""
        return self.figures is not None and not self.exceeded

    @property
    def text(self) -> Text:
        """What is wrong at the position, in words; empty if nothing is."""
        if self.figures is None:
            return Text("the loop is unstable")
        return joined(", ", [verdict.text for verdict in self.exceeded])


def along_travel(
    travel: Travel,
    control: Control,
    positions: Sequence[float] | np.ndarray,
    *,
    goal: str = "rope-snap",
    limits: Limits | Sequence[Limit] | None = None,
    band: tuple[float, float] = (0.0, np.inf),
    velocity: float = 0.05,
    progress: Progress | None = None,
) -> tuple[AtPosition, ...]:
    """Judge a control, with or without a schedule, on the axis at each position, which the axis does not leave.

    Stability is that of the poles of the whole loop; the figures are those of all frequency lines.
    """
    figure, kept = _goal(goal), limits if isinstance(limits, Limits) else Limits(limits or ())
    rows: list[AtPosition] = []
    for position in positions:
        (progress or Progress()).step("positions along the travel")
        loop = replace(travel.at(float(position)), control=frozen(control, float(position)))
        poles = stability(loop, velocity=velocity)
        if not poles.stable:
            rows.append(AtPosition(float(position), poles.growth, None, np.inf))
            continue
        response = ControlResponse(loop.control, float(loop.sample_time), (), velocity)
        criteria = Criteria((modelled_point(loop, velocity=velocity),), response, figure, kept, band)
        here = figures(criteria.answers(np.zeros(0))[0], kept.reading_noise)
        exceeded = tuple(verdict for verdict in judged(kept, here, _ROOM) if not verdict.keeps)
        assert figure.goal is not None
        value = float(figure.goal.of(here, band))
        rows.append(AtPosition(float(position), poles.growth, here, value, exceeded))
    return tuple(rows)


@dataclass(frozen=True, eq=False, repr=False)
class TunedTravel(Result):
    """A schedule that was tuned over the travel, beside the fixed gains that are best for all its places.

    travel          the axis along its travel
    control         the control with the schedule
    fixed           the tuning of one set of gains for all places
    places          the tuning of each place by itself
    before, after   the fixed gains and the schedule at every position that was judged, the places among them
    """

    travel: Travel
    control: Control
    fixed: Tuned
    places: tuple[Tuned, ...]
    before: tuple[AtPosition, ...]
    after: tuple[AtPosition, ...]
    goal: Figure

    @property
    def holds(self) -> bool:
        """True if the frozen loops keep all limits at all positions that were judged."""
        return all(row.keeps for row in self.after)

    @property
    def gained(self) -> float:
        """The share by which the goal at its worst position is better than with fixed gains: 0.25 for a quarter."""
        return max(row.goal for row in self.before) / max(row.goal for row in self.after) - 1.0

    @cached_property
    def sentence(self) -> str:
        """The verdict in words, with the position that decides."""
        broken = next((row for row in self.after if not row.keeps), None)
        if broken is not None:
            return Text(
                f"at {Quantity(broken.position, 'm'):4 SI} the schedule does not keep its limits ({broken.text}): add "
                f"a place there"
            )
        worst = max(self.after, key=lambda row: row.goal)
        return Text(
            f"the schedule keeps all limits at {len(self.after)} positions; at the worst one, "
            f"{Quantity(worst.position, 'm'):4 SI}, it is better than fixed gains by {Quantity(self.gained, 'share'):3}"
        )

    def table(self) -> Table:
        """Return goal and Ms of fixed gains and schedule at every position."""
        rows = [
            [old.position, old.goal, new.goal, old.goal / new.goal - 1.0, _peak(old), _peak(new), new.text or "kept"]
            for old, new in zip(self.before, self.after, strict=True)
        ]
        columns = [
            Column("position", "m", "5 mm"),
            Column(f"{self.goal.title}, fixed", self.goal.unit),
            Column("schedule", self.goal.unit),
            Column("better by", "share"),
            Column("Ms, fixed", "1", ".2f"),
            Column("Ms, schedule", "1", ".2f"),
            "limits",
        ]
        return Table("fixed gains and schedule along the travel", columns, rows)


def _peak(row: AtPosition) -> float | None:
    return None if row.figures is None else cast(float, SENSITIVITY_PEAK.read(row.figures))


def _goal(goal: str) -> Figure:
    figure = goals().get(goal)
    if figure is None or figure.goal is None:
        raise ParameterError(f"goal = {goal!r} must be one of {', '.join(goals())}")
    return figure


def tune_travel(
    travel: Travel,
    control: Control | None = None,
    *,
    goal: str = "rope-snap",
    limits: Limits | Sequence[Limit] | None = None,
    tunables: Sequence[str] | None = None,
    filters: str = "kept",
    band: tuple[float, float] = (0.0, np.inf),
    starts: int = 2,
    seed: int = 0,
    velocity: float = 0.05,
    between: int = 4,
    progress: Progress | None = None,
) -> TunedTravel:
    """Tune a law over all positions of a travel at once, as a schedule, and compare it with the best fixed gains.

        fixed:     minimize  max_i goal(i, p)    over one set of gains p,   limits kept at every place i
        schedule:  minimize  max_i goal(i, p_i)  over the gains p_i of each place, limits kept at every place i

    At its place a schedule is the law with the gains of this place, so that the second problem falls apart into one for
    each place; each is solved, also where another place is the worst. They begin at the fixed gains.  What a law
    assumes of the axis, such as the model of a pole placement, follows the axis from place to place.

    control    the control from which to begin, default: that of the travel; of one with a schedule the positions of the
               places are kept, else they are those at which the axis is known
    filters    of the fixed gains, as in `tune_control`: they are then the same at all places
    between    positions between two places at which the frozen loop is judged: poles, goal and limits

    Raises the errors of `tune_control`, and StructureError for a law that cannot be scheduled.
    """
    progress = progress or Progress()
    control = travel.loop.control if control is None else control
    _goal(goal)
    law, positions = control.law, travel.positions
    if isinstance(law, GainSchedule):
        positions = np.array([float(place.position) for place in law.places])
        law = law.places[0].law
    # what cannot be scheduled is refused before the searches
    _schedule(positions, [law] * positions.size)
    loops = [travel.at(float(x)) for x in positions]
    kept = limits if isinstance(limits, Limits) else Limits(limits or ())
    arguments: dict[str, Any] = {
        "goal": goal,
        "band": band,
        "tunables": tunables,
        "starts": starts,
        "seed": seed,
        "velocity": velocity,
        "progress": progress,
    }
    fixed = tune_control(replace(control, law=law), loops, limits=kept, filters=filters, **arguments)
    laws = _laws(fixed.control, tuple(fixed.tunables), loops)
    places = [
        tune_control(replace(fixed.control, law=law), loop, limits=kept, filters="kept", **arguments)
        for law, loop in zip(laws, loops, strict=True)
    ]
    every = np.unique(np.concatenate([np.linspace(a, b, between + 2) for a, b in pairwise(positions)]))
    same: dict[str, Any] = {"goal": goal, "limits": kept, "band": band, "velocity": velocity, "progress": progress}
    before = along_travel(travel, fixed.control, every, **same)
    of_place = [kept] * len(places)
    scheduled = replace(fixed.control, law=_schedule(positions, [tuned.control.law for tuned in places]))
    after = along_travel(travel, scheduled, every, **same)
    for _ in range(_ROUNDS):
        tightened = _tightened(after, positions, of_place)
        if not tightened:
            break
        for i, narrower in tightened.items():
            of_place[i] = narrower
            places[i] = tune_control(places[i].control, loops[i], limits=narrower, filters="kept", **arguments)
        scheduled = replace(fixed.control, law=_schedule(positions, [tuned.control.law for tuned in places]))
        after = along_travel(travel, scheduled, every, **same)
    return TunedTravel(travel, scheduled, fixed, tuple(places), before, after, _goal(goal))


def _schedule(positions: np.ndarray, laws: Sequence[Law]) -> GainSchedule:
    pairs = zip(positions, laws, strict=True)
    return GainSchedule(places=tuple(SchedulePlace(position=float(x), law=law) for x, law in pairs))


def _tightened(rows: Sequence[AtPosition], positions: np.ndarray, limits: Sequence[Limits]) -> dict[int, Limits]:
    """Return narrower limits for places beside an interval in which the schedule exceeds a limit, by index.

    Of the two places of an interval the one with the better goal gives way, so that the worst place loses nothing.
    """
    goal = {row.position: row.goal for row in rows}
    narrower: dict[int, Limits] = {}
    for row in rows:
        if row.exceeded and row.position not in positions:
            right = int(np.searchsorted(positions, row.position))
            i = min((right - 1, right), key=lambda place: goal[float(positions[place])])
            for verdict in row.exceeded:
                stated, value = limits[i].limit(verdict.figure), verdict.value
                if stated is None or value is None:
                    continue
                # what the limit leaves above its origin, such as 1 of Ms, is shared as the worst position needs it
                origin, bound = verdict.limit.declared.origin, verdict.limit.bound
                factor = abs(value) / bound if verdict.figure.higher else (bound - origin) / (abs(value) - origin)
                new = stated.eased(factor)
                present = narrower.get(i, limits[i])
                old = present.limit(verdict.figure)
                if old is None or (new.bound > old.bound) == verdict.figure.higher:
                    narrower[i] = present.having(new)
    return narrower


def _laws(control: Control, tuned: Sequence[str], loops: Sequence[Loop]) -> list[Law]:
    """Return the law for each loop, with what the law takes from the axis where that changes along the travel.

    These are the numbers, other than the tuned ones, in which the start values of the law differ from loop to loop.
    """
    law = control.law
    try:
        starts = [control_with(loop, law.kind).law for loop in loops]
    except FeeddriveError:
        return [law] * len(loops)
    if any(tree.structure(start) != tree.structure(law) for start in starts):
        return [law] * len(loops)
    names = {name.removeprefix("law.") for name in tuned if name.startswith("law.")}
    rows = [[value for _, value in tree.leaves(start)] for start in starts]
    follows = [
        name not in names and len({float(row[i]) for row in rows}) > 1 for i, (name, _) in enumerate(tree.leaves(law))
    ]
    own = [value for _, value in tree.leaves(law)]
    return [
        tree.rebuild(law, iter(now if moves else kept for kept, now, moves in zip(own, row, follows, strict=True)))
        for row in rows
    ]

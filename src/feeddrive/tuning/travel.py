"""Tuning over travel and payload: gains of every place, and what the schedule made of them does between the places."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise, product
from typing import Any, NamedTuple, Self, cast

import numpy as np

from feeddrive.analysis.stability import stability
from feeddrive.blocks.controller.gain_schedule import GainSchedule
from feeddrive.blocks.controller.schedule_load import ScheduleLoad
from feeddrive.blocks.controller.schedule_place import SchedulePlace
from feeddrive.blocks.families import Law
from feeddrive.figures.catalogue import goals
from feeddrive.figures.figure import Figure, Limit
from feeddrive.figures.of_loops import SENSITIVITY_PEAK
from feeddrive.identification.travel import FEWEST, TravelFit, fit_over_travel, require_pairs
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
_ROUNDS = 12  # in which places give way to the positions between them


class Pair(NamedTuple):
    """A position of an axis (m) and its payload, the mass on the table (kg); None where the payload never changes."""

    position: float
    payload: float | None = None

    @property
    def text(self) -> Text:
        """The pair in words, as `0.4 m with 150 kg`."""
        with_ = "" if self.payload is None else f" with {Quantity(self.payload, 'kg'):6 SI}"
        return Text(f"{Quantity(self.position, 'm'):6 SI}{with_}")


Measured = Mapping[float, Loop] | Mapping[tuple[float, float], Loop] | Mapping[Pair, Loop]


@dataclass(frozen=True, eq=False, repr=False)
class Travel(Result):
    """One axis at several positions, and its numbers between them; with payloads, at several of both.

    loop      the axis at the first position with the least payload, with its control
    fits      each number of the axis that changes along the travel, by path, over the position and the payload
    payloads  kg, ascending; None for an axis whose payload never changes
    payload   kg, of an axis that was measured with several and that carries this one (`with_payload`)
    """

    loop: Loop
    positions: np.ndarray
    fits: Mapping[str, TravelFit]
    payloads: np.ndarray | None = None
    payload: float | None = None

    @classmethod
    def of(cls, loops: Measured, errors: Mapping[Any, Mapping[str, float]] | None = None) -> Self:
        """Return the travel of an axis from its loops at three to ten positions in m, such as machine files.

        loops    by position, or by pairs of position (m) and payload (kg): three to ten of each, among them the first
                 and the last position with the least and the largest payload
        errors   standard errors of the numbers by position (or pair) and path, as `identify` and `fit_two_mass` give
                 them

        Stiffnesses are fitted by their inverse; see `fit_over_travel`. The control is that of the first position.
        Raises StructureError if the axes differ in more than numbers, and the errors of `fit_over_travel`.
        """
        by_pair: dict[Pair, Any] = {Pair(*key) if isinstance(key, tuple) else Pair(key): key for key in loops}
        pairs = sorted(by_pair, key=lambda pair: (pair.position, pair.payload or 0.0))
        places = np.array([pair.position for pair in pairs], float)
        loads = np.array([pair.payload for pair in pairs if pair.payload is not None], float)
        if loads.size not in (0, places.size):
            raise ParameterError(
                "some positions have a payload and others have none: give the payload of each, or none"
            )
        if loads.size:
            require_pairs("the axis", places, loads)
        elif places.size < FEWEST:
            raise ParameterError(
                f"the travel is known at {places.size} positions, and {FEWEST} are needed at least: with fewer nothing "
                f"would show that the axis is not what is assumed between them; measure at more positions"
            )
        every: dict[Pair, Loop] = {pair: cast(Any, loops)[by_pair[pair]] for pair in pairs}
        first = every[pairs[0]]
        for pair in pairs[1:]:
            differs = tree.difference(first.axis, every[pair].axis, "axis")
            if differs is not None:
                raise StructureError(f"at {pair.text} {differs}: along the travel only numbers may differ")
            if every[pair].sample_time != first.sample_time:
                raise ParameterError(
                    f"at {pair.text} the sample time is {Quantity(float(every[pair].sample_time), 's'):6 SI}, not "
                    f"{Quantity(float(first.sample_time), 's'):6 SI}: one control has one sample time"
                )
        fits: dict[str, TravelFit] = {}
        rows = [tree.parameters(every[pair]) for pair in pairs]
        for path in rows[0]:
            values = [float(row[path]) for row in rows] if ".control." not in path else []
            if len(set(values)) > 1:
                sigma = None if errors is None else [errors[by_pair[pair]][path] for pair in pairs]
                unit = tree.declaration(first, path).unit
                fits[path] = fit_over_travel(
                    places, values, sigma, name=path, unit=unit, payloads=loads if loads.size else None
                )
        return cls(first, np.unique(places), fits, np.unique(loads) if loads.size else None)

    def at(self, position: float, payload: float | None = None) -> Loop:
        """Return the loop at a position (m) with a payload (kg), which must lie between those that were measured."""
        if (payload is None) != (self.payloads is None):
            raise ParameterError(
                "the axis was measured "
                + ("for one payload: leave out the payload" if self.payloads is None else "with payloads: name one")
            )
        for value, row, unit in ((position, self.positions, "m"), (payload, self.payloads, "kg")):
            if row is not None and value is not None and not row[0] <= value <= row[-1]:
                raise ParameterError(
                    f"the axis at {Quantity(value, unit):6 SI}: it is known from {Quantity(float(row[0]), unit):6 SI} "
                    f"to {Quantity(float(row[-1]), unit):6 SI}, and nothing is extrapolated; measure there, too"
                )
        return tree.vary(self.loop, {path: fit.at(position, payload)[0] for path, fit in self.fits.items()})

    def with_payload(self, payload: float) -> Self:
        """Return the travel of the axis with one payload (kg), which must lie between those that were measured."""
        loop = self.at(float(self.positions[0]), payload)
        fits = {path: fit.with_payload(payload) for path, fit in self.fits.items()}
        return replace(self, loop=loop, fits=fits, payloads=None, payload=payload)

    def table(self) -> Table:
        """Return the numbers that change along the travel, at the places that were measured."""
        loads = self.payloads is not None
        rows = [
            [
                path,
                float(place),
                *([float(fit.payloads[i])] if fit.payloads is not None else []),
                value,
                error,
                fit.unit,
            ]
            for path, fit in self.fits.items()
            for i, (place, value, error) in enumerate(zip(fit.places, *map(np.ndarray.tolist, fit.fitted), strict=True))
        ]
        columns = [
            "parameter",
            Column("position", "m", "5 mm"),
            *([Column("payload", "kg", "5 SI")] if loads else []),
            Column("value", ""),
            Column("standard error", ""),
            "unit",
        ]
        return Table("the axis along its travel", columns, rows)


def frozen(control: Control, position: float, payload: float | None = None) -> Control:
    """Return a control whose law has the parameters of a position (m): that of a schedule for an axis that stays there.

    payload  kg, for a schedule over the payload; default: its own.  One over the position alone does not know it.

    A control without a schedule is returned unchanged.
    """
    law = control.law
    if not isinstance(law, GainSchedule):
        return control
    return replace(control, law=(law if payload is None else law.with_payload(payload)).law_at(position))


class AtPosition(NamedTuple):
    """A frozen loop at a position: the largest |z| of its poles, its figures, the goal, and the limits it exceeds.

    figures   None if the loop is unstable
    goal      the quantity that is minimized; infinite if the loop is unstable
    payload   kg; None for an axis whose payload never changes
    """

    position: float
    growth: float
    figures: Figures | None
    goal: float
    exceeded: tuple[Judged, ...] = ()
    payload: float | None = None

    @property
    def pair(self) -> Pair:
        """The position and the payload."""
        return Pair(self.position, self.payload)

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
    payloads: Sequence[float] | np.ndarray | None = None,
    *,
    goal: str = "rope-snap",
    limits: Limits | Sequence[Limit] | None = None,
    band: tuple[float, float] = (0.0, np.inf),
    velocity: float = 0.05,
    progress: Progress | None = None,
) -> tuple[AtPosition, ...]:
    """Judge a control, with or without a schedule, on the axis at each position, which the axis does not leave.

    payloads  kg, each at all positions; for an axis that was measured with payloads

    Stability is that of the poles of the whole loop; the figures are those of all frequency lines.
    """
    figure, kept = _goal(goal), limits if isinstance(limits, Limits) else Limits(limits or ())
    rows: list[AtPosition] = []
    loads: list[float | None] = [None] if payloads is None else [float(load) for load in payloads]
    for pair in (Pair(float(position), load) for position in positions for load in loads):
        (progress or Progress()).step("positions along the travel")
        loop = replace(travel.at(*pair), control=frozen(control, *pair))
        poles = stability(loop, velocity=velocity)
        if not poles.stable:
            rows.append(AtPosition(pair.position, poles.growth, None, np.inf, (), pair.payload))
            continue
        response = ControlResponse(loop.control, float(loop.sample_time), (), velocity)
        criteria = Criteria((modelled_point(loop, velocity=velocity),), response, figure, kept, band)
        here = figures(criteria.answers(np.zeros(0))[0], kept.reading_noise)
        exceeded = tuple(verdict for verdict in judged(kept, here, _ROOM) if not verdict.keeps)
        assert figure.goal is not None
        value = float(figure.goal.of(here, band))
        rows.append(AtPosition(pair.position, poles.growth, here, value, exceeded, pair.payload))
    return tuple(rows)


@dataclass(frozen=True, eq=False, repr=False)
class TunedTravel(Result):
    """A schedule that was tuned over the travel, beside the fixed gains that are best for all its places.

    travel          the axis along its travel
    control         the control with the schedule
    fixed           the tuning of one set of gains for all places
    places          the tuning of each place by itself, position by position, at each one payload by payload
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
                f"at {broken.pair.text} the schedule does not keep its limits ({broken.text}): add a place there"
            )
        worst = max(self.after, key=lambda row: row.goal)
        places = f"{len(self.after)} {'positions' if worst.payload is None else 'pairs of position and payload'}"
        return Text(
            f"the schedule keeps all limits at {places}; at the worst one, "
            f"{worst.pair.text}, it is better than fixed gains by {Quantity(self.gained, 'share'):3}"
        )

    def table(self) -> Table:
        """Return goal and Ms of fixed gains and schedule at every position."""
        rows = [
            [
                *(x for x in old.pair if x is not None),
                old.goal,
                new.goal,
                old.goal / new.goal - 1.0,
                _peak(old),
                _peak(new),
                new.text or "kept",
            ]
            for old, new in zip(self.before, self.after, strict=True)
        ]
        columns = [
            Column("position", "m", "5 mm"),
            *([] if self.travel.payloads is None else [Column("payload", "kg", "5 SI")]),
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
    robust: bool = False,
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
    between    positions between two places, and payloads between two, at which the frozen loop is judged: poles, goal
               and limits
    robust     for an axis with payloads: True for a schedule over the position alone, whose gains at each place keep
               the limits with all payloads and minimize the goal of the worst; False: over the payload, too

    Raises the errors of `tune_control`, and StructureError for a law that cannot be scheduled.
    """
    progress = progress or Progress()
    control = travel.loop.control if control is None else control
    _goal(goal)
    if robust and travel.payloads is None:
        raise ParameterError("robust = True is about payloads, and the axis was measured with none: leave it out")
    law, positions, payloads = control.law, travel.positions, travel.payloads
    if isinstance(law, GainSchedule):
        positions = np.array([float(place.position) for place in law.places])
        if payloads is not None and law.payload is not None:
            payloads = np.array([float(load.payload) for load in law.places[0].loads])
        law = law.places[0].laws()[0][1]
    nodes = _Nodes(positions, payloads, scheduled=payloads is not None and not robust)
    # what cannot be scheduled is refused before the searches
    nodes.schedule([law] * len(nodes.groups))
    groups = [[travel.at(*pair) for pair in group] for group in nodes.groups]
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
    every_loop = [loop for group in groups for loop in group]
    fixed = tune_control(replace(control, law=law), every_loop, limits=kept, filters=filters, **arguments)
    # of the payloads at one position the law takes its model from the one in the middle of the list
    models = [group[len(group) // 2] for group in groups]
    laws = _laws(fixed.control, tuple(fixed.tunables), models)
    places = [
        tune_control(replace(fixed.control, law=law), group, limits=kept, filters="kept", **arguments)
        for law, group in zip(laws, groups, strict=True)
    ]
    every = [
        None if row is None else np.unique(np.concatenate([np.linspace(a, b, between + 2) for a, b in pairwise(row)]))
        for row in (positions, payloads)
    ]
    assert every[0] is not None
    judge = partial(
        along_travel, travel, positions=every[0], payloads=every[1], goal=goal, limits=kept, band=band,
        velocity=velocity, progress=progress,
    )  # fmt: skip
    before = judge(fixed.control)
    of_place = [kept] * len(places)
    scheduled = replace(fixed.control, law=nodes.schedule([tuned.control.law for tuned in places]))
    after = judge(scheduled)
    for _ in range(_ROUNDS):
        tightened = _tightened(after, nodes, of_place)
        if not tightened:
            break
        for i, narrower in tightened.items():
            of_place[i] = narrower
            places[i] = tune_control(places[i].control, groups[i], limits=narrower, filters="kept", **arguments)
        scheduled = replace(fixed.control, law=nodes.schedule([tuned.control.law for tuned in places]))
        after = judge(scheduled)
    return TunedTravel(travel, scheduled, fixed, tuple(places), before, after, _goal(goal))


class _Nodes:
    """The places of a schedule, and for each the pairs at which its law is tuned.

    groups  with `scheduled` one pair each, by position and then by payload; else one a position, with all payloads
    """

    def __init__(self, positions: np.ndarray, payloads: np.ndarray | None, *, scheduled: bool) -> None:
        self.positions: list[float] = positions.tolist()
        self.payloads: list[float] | None = None if payloads is None else payloads.tolist()
        self.scheduled = scheduled
        loads: Sequence[float | None] = self.payloads or [None]
        rows = [[Pair(x, load) for load in loads] for x in self.positions]
        self.groups = [[pair] for row in rows for pair in row] if scheduled else rows
        self._tuned = {pair for row in rows for pair in row}

    def schedule(self, laws: Sequence[Law]) -> GainSchedule:
        """Return the schedule with a law for each group; its payload is the least."""
        if not self.scheduled or self.payloads is None:
            pairs = zip(self.positions, laws, strict=True)
            return GainSchedule(places=tuple(SchedulePlace(position=x, law=law) for x, law in pairs))
        loads = [
            ScheduleLoad(payload=group[0].payload or 0.0, law=law) for group, law in zip(self.groups, laws, strict=True)
        ]
        count = len(self.payloads)
        places = tuple(
            SchedulePlace(position=x, loads=tuple(loads[i * count : (i + 1) * count]))
            for i, x in enumerate(self.positions)
        )
        return GainSchedule(payload=self.payloads[0], places=places)

    def around(self, pair: Pair) -> list[int]:
        """Return the groups of the places around a pair, between which the schedule interpolates there; none at one."""
        if pair in self._tuned:
            return []
        sides: list[list[int]] = []
        for value, row in ((pair.position, self.positions), (pair.payload, self.payloads)):
            if value is None or row is None or (row is self.payloads and not self.scheduled):
                sides.append([0])
            elif value in row:
                sides.append([row.index(value)])
            else:
                right = int(np.searchsorted(row, value))
                sides.append([right - 1, right])
        count = len(self.payloads or ()) if self.scheduled else 1
        return [i * count + j for i, j in product(*sides)]


def _tightened(rows: Sequence[AtPosition], nodes: _Nodes, limits: Sequence[Limits]) -> dict[int, Limits]:
    """Return narrower limits for places around a pair at which the schedule exceeds a limit, by index.

    Of these places the one with the best goal gives way, so that the worst place loses nothing.
    """
    goal = {row.pair: row.goal for row in rows}
    of_group = [max(goal[pair] for pair in group) for group in nodes.groups]
    narrower: dict[int, Limits] = {}
    for row in rows:
        around = nodes.around(row.pair)
        if row.exceeded and around:
            i = min(around, key=lambda place: of_group[place])
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

"""Optimization of a control on measured or modeled axes: gains and filters together, within limits at every point."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from feeddrive.figures.catalogue import goals
from feeddrive.figures.figure import Limit
from feeddrive.figures.of_loops import FORCE_NOISE
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.text import Text, joined
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.tuning.closed_loop import Figures, figures
from feeddrive.tuning.control_response import ControlResponse
from feeddrive.tuning.criteria import Criteria, Evaluation, chance
from feeddrive.tuning.limits import Limits
from feeddrive.tuning.operating_point import OperatingPoint, modelled_point
from feeddrive.tuning.proof import of_known, of_measurement, of_model
from feeddrive.tuning.search import End
from feeddrive.tuning.tunables import filter_tunables, law_tunables, readable
from feeddrive.tuning.tuned import HeldBack, Tuned, cascade_loops
from feeddrive.tuning.tuner import Best, Tuner

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
    progress: Progress | None = None,
) -> Tuned:
    """The control with the tunables that are best for the goal while all limits hold at every point.

        minimize  max over points of the goal   over ln(tunables)   subject to   slack_i >= k σ_i  for all limits i

    goal        a figure with a goal in the catalogue (`figures.goals`).  rope-snap: ISE^½ = [∫ |y|²/ω² dω/π]^½;
                stiffness: the mean of |y|² over ln f in the band;  least-stiffness: max |y| in the band;
                integral-gain: max |y|/ω;  bandwidth: 1/(frequency at which |1/(1 + L)| rises to -3 dB);
                y is the compliance of the closed loop
    limits      `Limits`, or `Limit`s of figures of the catalogue (`figures.limitable`)
    control     the start of the search; of a loop its control is taken, and its axis if no point is given
    points       axes at several positions and loads: `measured_point`, or loops, whose axis is taken
    tunables    dotted names below the control, such as law.Kp; default: those of the law
    filters     kept: not changed;  free: their frequencies and dampings are tuned too;  placed: and notches are added
                where they improve the goal
    confidence  that all limits hold at once on the true axis, if the points know their variance: k follows from it
    today       the control to compare with; default: `control` itself
    progress    receives the name of each next stage, and may cancel

    The response of the control is computed by linearizing its code (`ControlResponse`), with exact derivatives.
    Stability is checked by encirclement of -1 at every step.  A tuning for loops is verified by simulation with
    friction, encoder counts and limits (`Tuned.holds`).  If the searches from different starts do not agree, more are
    made (`Tuned.settled`).
    Raises UnstableError if nothing is found within the limits, NotIdentifiableError if the measurement is too poor to
    tune on, with the band in which to measure again, ParameterError for arguments that do not match.
    """
    if points is None:
        if not isinstance(control, Loop):
            raise ParameterError("a control alone has no axis: give a loop, or the control and its points")
        points = control
    control = control.control if isinstance(control, Loop) else control
    if filters not in FILTERS:
        raise ParameterError(f"filters = {filters!r} must be one of {', '.join(FILTERS)}")
    tuner = _tuner(control, points, goal, limits, band, confidence, starts, seed, velocity, progress)
    chosen = law_tunables(control) if tunables is None else tuple(tunables)
    best = tuner.tuned(
        control, chosen if filters == "kept" else tuple(dict.fromkeys([*chosen, *filter_tunables(control)]))
    )
    tried: list[str] = []
    if filters == "placed":
        best = tuner.with_notches(best, tried)
    tuner.progress.step("proof")
    return result(tuner, best, today or control, tuple(tried))


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
    progress: Progress | None = None,
) -> Tuned:
    """Evaluate a given control, for example from a recipe: the figures and the proof of `tune` without a search.

    rule  the name of the rule that gave it; the other arguments as in `tune`.  Raises the errors of `tune`, and
    UnstableError if the loop is unstable at a point.
    """
    tuner = _tuner(control, points, goal, limits, band, confidence, 1, 0, velocity, progress)
    names = law_tunables(control)
    return result(tuner, tuner.as_it_is(control, names), today or control, (), rule)


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
) -> Tuner:
    """The tuner for checked arguments."""
    figure = goals().get(goal)
    if figure is None or figure.goal is None:
        raise ParameterError(f"goal = {goal!r} must be one of {', '.join(goals())}")
    if not 0.5 <= confidence < 1.0:
        raise ParameterError(f"confidence = {number(confidence, 6)} must be >= 0.5 and < 1")
    if not 0.0 <= band[0] < band[1]:
        raise ParameterError(
            f"the band from {Quantity(band[0], 'Hz', bare=True):6} to {Quantity(band[1], 'Hz'):6} is empty: the lower "
            "frequency comes first"
        )
    sources = (points,) if isinstance(points, (OperatingPoint, Loop)) else tuple(points)
    operating_points = tuple(
        modelled_point(source, f"axis {i + 1}" if len(sources) > 1 else "model", velocity=velocity)
        if isinstance(source, Loop)
        else source
        for i, source in enumerate(sources)
    )
    if not operating_points:
        raise ParameterError("shaping needs at least one point")
    if len({point.sample_time for point in operating_points}) > 1:
        times = joined(", ", [f"'{point.name}' {Quantity(point.sample_time, 's'):6}" for point in operating_points])
        raise ParameterError(f"one control has one sample time, but the points have {times}")
    _check_band(operating_points, band)
    kept = limits if isinstance(limits, Limits) else Limits(limits or ())
    tuner = Tuner(operating_points, figure, kept, band, confidence, starts, seed, velocity, progress or Progress())
    integrates = ControlResponse(control, operating_points[0].sample_time, (), velocity).integrates
    if figure.goal.returns and not integrates(()):
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
                f"the band from {Quantity(band[0], 'Hz', bare=True):6} to {Quantity(band[1], 'Hz'):6} holds {inside} "
                f"lines of '{point.name}', which has {Quantity(point.frequency[0], 'Hz', bare=True)} to "
                f"{Quantity(point.frequency[-1], 'Hz')}: at least 3"
            )


_MUCH = 0.02  # of the goal, by a tenth of a sample


def result(tuner: Tuner, best: Best, today: Control, tried: tuple[str, ...], recipe: str = "") -> Tuned:
    """Figures before and after, the active limits, advice, and the proof."""
    values = dict(zip(best.names, np.exp(best.end.x).tolist(), strict=True))
    control = tree.vary(best.control, values)
    before = _figures(tuner, today)
    after = _figures(tuner, control)
    loops = tuple(replace(point.loop, control=control) for point in tuner.points if point.loop is not None)
    proof = of_measurement(
        [loop for loop, point in zip(after, tuner.points, strict=True) if point.loop is None], tuner.limits
    )
    for point in tuner.points:
        if point.loop is None:
            proof += of_known(point, control, tuner.limits, tuner.velocity)
        else:
            loop = replace(point.loop, control=control)
            proof += of_model(point.name, loop, tuner.limits, tuner.velocity)
    cascades = [cascade_loops(version, tuner.points[0]) for version in (today, control)] if before else []
    whole = tuner.criteria(best.control, best.names, whole=True)
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
        cascade=tuple(gains for gains in cascades if gains is not None),
        recipe=recipe,
    )


def _figures(tuner: Tuner, control: Control) -> tuple[Figures, ...]:
    """At every point, on all lines; empty for a control that has no response."""
    try:
        answers = tuner.criteria(control, (), whole=True).answers(np.zeros(0))
    except ParameterError:
        return ()
    return tuple(figures(answer, tuner.limits.reading_noise) for answer in answers)


def _held(tuner: Tuner, best: Best) -> tuple[HeldBack, ...]:
    """Bounds with a force, those at one place together."""
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
            held.append(HeldBack(kind, tuner.points[point].name, where, 100.0 * force * math.log(1.1)))
    return tuple(sorted(held, key=lambda limit: -limit.gain))


def _advice(tuner: Tuner, best: Best) -> tuple[str, ...]:
    """Gain by less dead time, from the multipliers of the optimum, and loss by the noise."""
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
        # by slopes: for a whole sample where the effect is small, for a tenth where it is large
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
    """The tunables that ended at the edge of their range, in words."""
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
        f"filters.{bound.key[1]} (notch) would amplify instead of attenuate, so it is flat"
        for bound in best.end.judged.bounds
        if bound.figure is None and best.end.force.get(bound.key, 0.0) > 1e-3 and bound.slack < 0.02
    ]
    return texts


def _gain(here: Evaluation, there: Evaluation, end: End) -> float:
    """The decrease of the goal, by the Lagrangian, with the other axis."""
    slack = {bound.key: bound.slack for bound in there.bounds}
    eased = sum(
        end.force.get(bound.key, 0.0) * (slack[bound.key] - bound.slack) for bound in here.bounds if bound.key in slack
    )
    return float(np.max(here.goal) - np.max(there.goal)) + eased


def _of_today(today: Control, control: Control, name: str) -> float:
    """The value of a tunable in today's control; NaN if another block stands there, or none."""
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

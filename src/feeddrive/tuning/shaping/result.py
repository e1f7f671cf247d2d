"""What a shaping says when it is done: figures before and after, what holds it back, what would help, the proof."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.loop.control import Control
from feeddrive.tuning.shaping import certainty, evidence
from feeddrive.tuning.shaping.bounds import NOTCH
from feeddrive.tuning.shaping.cascade import cascade_loops
from feeddrive.tuning.shaping.criteria import Criteria, Judged
from feeddrive.tuning.shaping.figures import Figures, figures
from feeddrive.tuning.shaping.search import End
from feeddrive.tuning.shaping.shaped_loop import HeldBack, Tuned
from feeddrive.tuning.shaping.site import Site
from feeddrive.tuning.shaping.tunables import readable
from feeddrive.tuning.shaping.work import Best, Work

_MUCH = 0.02  # of the goal, by a tenth of a sample


def result(work: Work, best: Best, today: Control, tried: tuple[str, ...], recipe: str = "") -> Tuned:
    """Figures before and after, what holds the goal back, what would help, and the proof."""
    values = dict(zip(best.names, np.exp(best.end.x).tolist(), strict=True))
    control = tree.vary(best.control, values)
    before = _figures(work, today)
    after = _figures(work, control)
    loops = tuple(replace(site.loop, control=control) for site in work.sites if site.loop is not None)
    proof = evidence.of_measurement(
        [each for each, site in zip(after, work.sites, strict=True) if site.loop is None], work.limits
    )
    for site in work.sites:
        if site.loop is None:
            proof += evidence.of_known(site, control, work.limits, work.velocity)
        else:
            loop = replace(site.loop, control=control)
            proof += evidence.of_model(site.name, loop, work.limits, work.velocity)
    cascades = [cascade_loops(each, work.sites[0]) for each in (today, control)] if before else []
    whole = work.criteria(best.control, best.names, whole=True)
    return Tuned(
        control=control,
        loops=loops,
        tunables=values,
        started={name: _of_today(today, control, name) for name in values},
        goal=work.goal,
        band=work.band,
        limits=work.limits,
        before=before,
        after=after,
        held=_held(work, best),
        advice=() if recipe else _advice(work, best),
        notches=tried,
        sure=best.sure,
        confidence=certainty.chance(whole(best.end.x).bounds) if work.noisy else None,
        cost=best.cost,
        evaluations=work.evaluations,
        spread=best.spread,
        settled=best.settled,
        proof=proof,
        cascade=tuple(each for each in cascades if each is not None),
        recipe=recipe,
    )


def _figures(work: Work, control: Control) -> tuple[Figures, ...]:
    """At every site, on all lines; empty for a control that has no response."""
    try:
        found = work.criteria(control, (), whole=True).answers(np.zeros(0))
    except ParameterError:
        return ()
    return tuple(figures(each, work.limits.reading_noise) for each in found)


def _held(work: Work, best: Best) -> tuple[HeldBack, ...]:
    """Bounds with a force, those at one place together."""
    summed: dict[tuple[str, int], list[tuple[float, float]]] = {}
    for bound in best.end.judged.bounds:
        force = best.end.force.get(bound.key, 0.0)
        if force > 1e-4 and bound.kind != NOTCH:
            summed.setdefault((bound.kind, bound.site), []).append((force, bound.frequency))
    found: list[HeldBack] = []
    for (kind, site), parts in summed.items():
        groups: list[list[tuple[float, float]]] = []
        for part in sorted(parts, key=lambda each: each[1]):
            if groups and part[1] < 1.3 * groups[-1][-1][1]:
                groups[-1].append(part)
            else:
                groups.append([part])
        for group in groups:
            force = sum(each[0] for each in group)
            where = sum(each[0] * each[1] for each in group) / force
            found.append(HeldBack(kind, work.sites[site].name, where, 100.0 * force * math.log(1.1)))
    return tuple(sorted(found, key=lambda each: -each.gain))


def _advice(work: Work, best: Best) -> tuple[str, ...]:
    """What less dead time would bring, by the multipliers of the optimum; and what the noise costs."""
    found: list[str] = []
    step = 0.1 * work.sites[0].sample_time

    def sooner(site: Site) -> Site:
        ahead = np.exp(2j * np.pi * site.frequency * step)
        moved = site.moved.copy()
        moved[0] = moved[0] * ahead
        late = site.by_force * ahead
        return replace(site, by_force=late, moved=moved, by_load=late if site.at_drive else site.by_load)

    sites = tuple(sooner(site) for site in best.criteria.sites)
    other = Criteria(sites, best.criteria.control, work.goal, work.limits, work.band)(best.end.x)
    gained = _gain(best.end.judged, other, best.end)
    if gained > 1e-4:
        # by slopes: a whole sample where it says little, a tenth where it says much
        small = gained < _MUCH
        how = f"one sample ({10e6 * step:g} us)" if small else f"a tenth of a sample ({1e6 * step:g} us)"
        found.append(
            f"{how} less dead time, from computation, filters or bus, would gain about "
            f"{100.0 * gained * (10.0 if small else 1.0):.2g} %"
        )
    if work.noisy and best.cost > 5e-3:
        found.append(f"a measurement without noise would gain {100.0 * best.cost:.2g} %")
    found += _edges(work, best)
    if any(site.at_drive for site in work.sites):
        found.append(
            "all compliances are against a force at the drive, not on the table: strike the table (--disturbance), or "
            "give a machine whose plant agrees with the response (--baseline)"
        )
    return tuple(found)


def _edges(work: Work, best: Best) -> list[str]:
    """What stands at the edge of what was searched, in plain words."""
    found: list[str] = []
    nyquist = 0.5 / work.sites[0].sample_time
    for name, value, low, high in zip(best.names, best.end.x, *best.box, strict=True):
        if min(value - low, high - value) > 1e-6:
            continue
        shown = readable(best.control, name)
        size, unit = math.exp(value), tree.declaration(best.control, name).unit
        end = "upper" if high - value < 1e-6 else "lower"
        reason = ""
        if name.startswith("filters.") and unit == "Hz" and end == "upper":
            reason = f", {100.0 * size / nyquist:.3g} % of half the sample rate: as good as no filter"
            if work.limits.force_noise is None:
                reason += ", which no limit on the noise in the force speaks against"
        found.append(f"{shown} = {size:.4g} {unit}".rstrip() + f" is the {end} end of what was searched{reason}")
    found += [
        f"filters.{bound.key[1]} (notch) would rather raise than lower, which is no notch's work: it is flat"
        for bound in best.end.judged.bounds
        if bound.kind == NOTCH and best.end.force.get(bound.key, 0.0) > 1e-3 and bound.slack < 0.02
    ]
    return found


def _gain(here: Judged, there: Judged, end: End) -> float:
    """By how much the goal would fall, by the Lagrangian, if the axis were the other one."""
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
            (each[int(step)] if int(step) < len(each) else None)
            if isinstance(each, tuple)
            else getattr(each, step, None)
            for each in blocks
        ]
    value = getattr(blocks[0], last, None) if type(blocks[0]) is type(blocks[1]) else None
    return float(value) if value is not None else math.nan

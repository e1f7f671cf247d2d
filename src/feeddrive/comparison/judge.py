"""One law at work on one axis: how it is completed for the work, and its figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from feeddrive.analysis.loop_model import LoopModel, loop_model
from feeddrive.analysis.stability import stability
from feeddrive.blocks.families import Law
from feeddrive.comparison.figures import Duty, counted, effort_of, linear, recovered, rms, tracked
from feeddrive.comparison.tune_all import Rule
from feeddrive.figures.of_runs import CUTTING_RMS, SNAP_PEAK, SNAP_SETTLING, STEP_PEAK, STEP_SETTLING
from feeddrive.language.errors import FeeddriveError
from feeddrive.language.text import Text
from feeddrive.learning.stops import learn_stops
from feeddrive.learning.trajectory_prefilter import tune_prefilter
from feeddrive.learning.trials import iterate_trials
from feeddrive.loop.lifting import MOST
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import Run, simulate
from feeddrive.tuning.candidates import Candidate
from feeddrive.tuning.tuned import Tuned

_TRIALS = 6  # in which a compensator learns


@dataclass(frozen=True, eq=False)
class Competitor:
    """One law: its loop, how it was tuned (None: as it is today), its figures in SI, and its runs.

    `unfit` says why there are no figures: the loop is not stable, or left its bounds; `outside` which bound of the rule
    it breaks, as today's gains may, and a compensation that was not tuned.
    """

    name: str
    loop: Loop
    tuned: Tuned | None
    remark: str
    figures: Mapping[str, float | None]
    move: Run | None = None
    snap: Run | None = None
    step: Run | None = None
    model: LoopModel | None = None
    unfit: str = ""
    outside: str = ""

    @property
    def held_by(self) -> str:
        """The bounds that held its tuning back."""
        if self.tuned is None:
            return "not tuned"
        return ", ".join(dict.fromkeys(each.what for each in self.tuned.held)) or "none"

    @property
    def settled(self) -> bool:
        """Whether it can be ranked: it was not tuned, or independent searches ended within 5 % of its best."""
        return self.tuned is None or self.tuned.settled

    @property
    def unplaced(self) -> str:
        """Why it has no place by any criterion; empty if it has."""
        return (
            "not settled" if not self.settled else Text(f"outside of the rule: {self.outside}") if self.outside else ""
        )


def sliding(duty: Duty, loop: Loop) -> float:
    """Half of the largest set speed, in m/s; 10 mm/s for a reference that stands still."""
    t = np.linspace(0.0, duty.move.duration, 4001)
    t = np.unique(np.round(t / loop.sample_time)) * loop.sample_time
    largest = float(np.max(np.abs(duty.move.at(t).velocity)))
    return 0.5 * largest if largest > 0.0 else 0.01


def alike(candidate: Candidate, law: Law, duty: Duty, seed: int) -> Loop:
    """The loop of a candidate that differs from another one in the setpoint's path only, with the law of that one."""
    loop = replace(candidate.loop, control=replace(candidate.loop.control, law=law))
    if candidate.then == "trials":
        return iterate_trials(loop, duty.move, _TRIALS, seed=seed).loop
    if candidate.then == "stops":
        return learn_stops(loop, seed=seed)[0]
    if candidate.then == "prefilter":
        fitted = tune_prefilter(loop, duty.move, seed=seed)[-1].prefilter
        return replace(loop, control=replace(loop.control, prefilter=fitted))
    return loop


def judged(
    name: str,
    loop: Loop,
    tuned: Tuned | None,
    remark: str,
    duty: Duty,
    rule: Rule,
    seed: int,
    model: Loop | None = None,
) -> Competitor:
    """All figures of a law; one that is not stable, by its eigenvalues, or leaves its bounds keeps its row without.

    `model` is the loop of the linear figures, if it is another one: an axis with play has none of its own.
    """
    velocity, model = rule.velocity, model or loop
    verdict = stability(model, velocity=velocity)
    if not verdict.stable:
        return Competitor(name, loop, tuned, remark, effort_of(loop), unfit=verdict.sentence())
    both, figures = None, effort_of(loop)
    if loop.control.law.period() <= MOST:
        both = loop_model(model, velocity=velocity)
        figures = linear(model, both)
    rest = duty.begin + duty.rest
    signals = ["tracking_error", "force", "trip"]
    forces = {"snap": duty.snap, "step": duty.step} | ({} if duty.cut is None else {"cut": duty.cut})
    try:
        move = counted(simulate(loop, duty.move, seed=seed, name=name), duty)
        runs = {
            what: simulate(loop, duty.still(), load=load, duration=rest, seed=seed, record=signals, name=name)
            for what, load in forces.items()
        }
    except FeeddriveError as error:
        return Competitor(name, loop, tuned, remark, figures, model=both, unfit=Text(f"{error}"))
    snap, step = runs["snap"], runs["step"]
    figures |= tracked(move) | recovered(snap, duty, SNAP_PEAK, SNAP_SETTLING)
    figures |= recovered(step, duty, STEP_PEAK, STEP_SETTLING)
    if "cut" in runs:
        figures |= {CUTTING_RMS.key: rms(counted(runs["cut"], duty)["tracking_error"])}
    tripped = "; the guard tripped" if any(np.any(run["trip"] > 0.0) for run in (move, *runs.values())) else ""
    return Competitor(
        name, loop, tuned, Text(f"{remark}{tripped}"), figures, move, snap, step, both, outside=rule.broken(figures)
    )

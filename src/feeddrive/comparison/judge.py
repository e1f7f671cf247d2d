"""The evaluation of one law on one axis: final adaptation to the task, and its figures."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import ClassVar

from feeddrive.analysis.loop_model import LoopModel, loop_model
from feeddrive.analysis.stability import stability
from feeddrive.blocks.families import Law
from feeddrive.comparison.figures import Values, effort_of, linear, worst
from feeddrive.comparison.tune_all import Rule
from feeddrive.evaluation.case import Case
from feeddrive.evaluation.duty import Duty
from feeddrive.language.errors import FeeddriveError
from feeddrive.language.progress import Progress
from feeddrive.language.text import Text, joined, marked
from feeddrive.learning.stops import learn_stops
from feeddrive.learning.trajectory_prefilter import tune_prefilter
from feeddrive.learning.trials import iterate_trials
from feeddrive.loop.linearize import MOST
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import Run
from feeddrive.tuning.candidates import Candidate, Refusal
from feeddrive.tuning.tune import Tuned

_TRIALS = 6  # number of trials in which a compensator learns


@dataclass(frozen=True, eq=False)
class Competitor:
    """A law in a comparison: its loop, its tuning (None for the present control), its figures in SI units, and its
    runs.

    unfit    reason why there are no figures: the loop is unstable or the motion left its bounds
    outside  the bounds of the rule that it exceeds, as the present gains or an untuned compensation may
    """

    name: str
    loop: Loop
    tuned: Tuned | None
    remark: str
    figures: Values
    move: Run | None = None
    snap: Run | None = None
    step: Run | None = None
    model: LoopModel | None = None
    unfit: str = ""
    outside: str = ""

    @property
    def held_by(self) -> str:
        """The active constraints of its tuning."""
        if self.tuned is None:
            return "not tuned"
        return ", ".join(dict.fromkeys(bound.what for bound in self.tuned.held)) or "none"

    @property
    def settled(self) -> bool:
        """True if the law can be ranked: it was not tuned, or independent searches ended within 5 % of its best."""
        return self.tuned is None or self.tuned.settled

    @property
    def unplaced(self) -> str:
        """The reason why the law is not ranked; empty if it is."""
        if not self.settled:
            return "not settled"
        return Text(f"outside of the rule: {self.outside}") if self.outside else ""


@dataclass(frozen=True, eq=False)
class AtWork(Case["Competitor | Refusal"]):
    """The case of one law on the task: with its tuned gains, adapted to the task, simulated and evaluated.

    tuned  tuning of the candidate, or of the law whose gains it takes over; None: evaluated without tuning
    """

    kind: ClassVar[str] = "law_at_work"
    common: ClassVar[tuple[str, ...]] = ("duty", "rule")

    candidate: Candidate
    tuned: Tuned | None
    remark: str
    duty: Duty
    rule: Rule
    seed: int

    @property
    def name(self) -> str:
        """The name of the case: the law, followed by ": the work"."""
        return f"{self.candidate.name}: the work"

    def outcome(self, progress: Progress) -> Competitor | Refusal:
        """Return the law with its figures, or a refusal if it cannot be adapted to the task."""
        candidate, tuned = self.candidate, self.tuned
        loop = candidate.loop if tuned is None else tuned.loops[0]
        if candidate.like:
            try:
                loop = alike(candidate, loop.control.law, self.duty, self.seed)
            except FeeddriveError as error:
                return Refusal(candidate.name, Text(f"{error}"))
            tuned = None if tuned is None else replace(tuned, control=loop.control, loops=(loop,))
        blank = Competitor(candidate.name, loop, tuned, self.remark, {})
        return judged(blank, [(loop, loop)], self.duty, self.rule, [self.seed])


def alike(candidate: Candidate, law: Law, duty: Duty, seed: int) -> Loop:
    """Return the loop of a candidate that differs from another one only in its setpoint path, with the law of the
    other.
    """
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
    law: Competitor, places: Sequence[tuple[Loop, Loop]], duty: Duty, rule: Rule, seeds: Iterable[int]
) -> Competitor:
    """Return the law with its worst figures over all operating points and noise seeds, and the runs of the first.

    places  pairs of the simulated loop and the loop for the linear figures, which differ for an axis with backlash

    A loop that has unstable eigenvalues or leaves its bounds for any of them is `unfit`.
    """
    competitors: list[Competitor] = []
    for (loop, model), seed in product(places, seeds):
        competitors.append(_judged(law, loop, model, duty, rule, seed))
        if competitors[-1].unfit:
            return competitors[-1]
    figures = worst([competitor.figures for competitor in competitors])
    remarks = dict.fromkeys(marked(competitor.remark) for competitor in competitors if competitor.remark)
    remark = Text(joined("; ", remarks))
    return replace(competitors[0], figures=figures, remark=remark, outside=rule.broken(figures))


def _judged(law: Competitor, loop: Loop, model: Loop, duty: Duty, rule: Rule, seed: int) -> Competitor:
    """Return a law with its figures at one place, with the noise of one seed."""
    figures, both = effort_of(loop), None
    verdict = stability(model, velocity=rule.velocity)
    if not verdict.stable:
        return replace(law, figures=figures, unfit=verdict.sentence())
    if loop.control.law.period() <= MOST:
        both = loop_model(model, velocity=rule.velocity)
        figures = linear(model, both)
    try:
        runs = duty.runs(loop, seed, law.name)
    except FeeddriveError as error:
        return replace(law, figures=figures, model=both, unfit=Text(f"{error}"))
    remark = joined("; ", filter(None, (law.remark, "the guard tripped"))) if runs.tripped else law.remark
    return replace(
        law,
        figures={**figures, **runs.figures},
        remark=remark,
        move=runs.move,
        snap=runs.snap,
        step=runs.step,
        model=both,
    )

"""One law on one axis: the case of its evaluation, and the row that comes of it in a comparison or the benchmark."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any, ClassVar

from feeddrive.analysis.loop_model import LoopModel, loop_model
from feeddrive.analysis.margins import margins
from feeddrive.analysis.stability import stability
from feeddrive.evaluation.case import Case
from feeddrive.evaluation.duty import Duty
from feeddrive.evaluation.engine import Bar, Engine
from feeddrive.evaluation.robustness import Design, Rule
from feeddrive.figures.of_loops import SENSITIVITY_PEAK
from feeddrive.figures.ranking import Values, effort_of, linear, worst
from feeddrive.language import tree
from feeddrive.language.errors import FeeddriveError
from feeddrive.language.progress import Progress
from feeddrive.language.text import Text, joined, marked
from feeddrive.loop.axis import Axis
from feeddrive.loop.linearize import MOST
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import Run
from feeddrive.tuning.candidates import Candidate, Refusal
from feeddrive.tuning.recipes import RECIPES
from feeddrive.tuning.tune import Tuned

ROBUST = f"{SENSITIVITY_PEAK.key}_varied"  # key of the largest Ms with wrong masses or stiffnesses
# units of a plant's numbers that are wrong together, and the power of the share that they take: a frequency is a root
_WRONG = ({"kg": 1.0, "kg m2": 1.0}, {"N/m": 1.0, "Hz": 0.5})


@dataclass(frozen=True, eq=False)
class Competitor:
    """A law on one axis: its loop, its figures in SI units, the reason why it is not ranked, and its runs.

    unplaced  empty for a ranked law
    unfit     reason why there are no figures: the loop is unstable or the motion left its bounds
    outside   the bounds of the rule that it exceeds, as the present gains or an untuned compensation may
    tuned     its tuning in a comparison; None for a law that was not tuned
    design    its stored design in the benchmark; None for a law without tunables and for a recipe
    plant     of the benchmark, where a row has no runs, and the loop before it learned or took the gains of a recipe
    recipe    True for gains from a tuning recipe: the row is shown separately and may violate the rule
    """

    name: str
    loop: Loop
    figures: Values = field(default_factory=dict[str, float | None])
    unplaced: str = ""
    remark: str = ""
    unfit: str = ""
    outside: str = ""
    tuned: Tuned | None = None
    design: Design | None = None
    plant: str = ""
    recipe: bool = False
    move: Run | None = None
    snap: Run | None = None
    step: Run | None = None
    model: LoopModel | None = None

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


@dataclass(frozen=True, eq=False)
class AtWork(Case["Competitor | Refusal"]):
    """The case of one law on the task: with its tuned gains, adapted to the task, simulated and evaluated.

    seeds    of the noise in the runs, whose worst figures count
    lesson   seed of the noise in the trials in which a law learns
    places   positions of the axis: as simulated, and as linearized, which differ for an axis with backlash; none: that
             of the candidate
    varied   error of masses and stiffnesses for the robust Ms, as a share; None: it is not computed
    plant    of the benchmark, whose rows are stored; those of a comparison have runs, which are too large for a store
    recipe   name of the tuning recipe that sets the gains of the law; empty for gains that are known
    """

    kind: ClassVar[str] = "law_at_work"
    common: ClassVar[tuple[str, ...]] = ("duty", "rule")

    candidate: Candidate
    remark: str
    duty: Duty
    rule: Rule
    seeds: tuple[int, ...]
    lesson: int
    places: tuple[tuple[Axis, Axis], ...] = ()
    varied: float | None = None
    plant: str = ""
    recipe: str = ""

    @property
    def name(self) -> str:
        """The name of the case: plant and law, or the law followed by ": the work"."""
        return f"{self.plant}: {self.candidate.name}" if self.plant else f"{self.candidate.name}: the work"

    def record(self, outcome: Competitor | Refusal) -> Mapping[str, Any] | None:
        """Return the row of the benchmark as a record, keeping the quantities in its texts."""
        if not self.plant:
            return None
        if isinstance(outcome, Refusal):
            return {"refused": marked(outcome.reason)}
        return {"figures": dict(outcome.figures)} | {name: marked(getattr(outcome, name)) for name in _TEXTS}

    def restored(self, record: Any, progress: Progress) -> Competitor | Refusal:
        """Restore the row from a record."""
        if "refused" in record:
            return Refusal(self.candidate.name, Text(record["refused"]))
        texts: dict[str, Any] = {name: Text(record[name]) for name in _TEXTS}
        return Competitor(self.candidate.name, self.candidate.loop, dict(record["figures"]), **texts)

    def outcome(self, progress: Progress) -> Competitor | Refusal:
        """Return the law with its figures, or a refusal if it cannot be adapted to the task or evaluated."""
        loop, remark = self.candidate.loop, self.remark
        try:
            if self.recipe:
                recipe = RECIPES[self.recipe](self._at_places(loop)[0][1], loop.control)
                loop, remark = replace(loop, control=replace(loop.control, law=recipe.law)), recipe.reason
            else:
                loop = self.candidate.adapted(self.duty.move, self.lesson)
            law = self._judged(Competitor(self.candidate.name, loop, remark=remark))
        except FeeddriveError as error:
            return Refusal(self.candidate.name, Text(f"{error}"))
        if not self.plant:
            return law
        return replace(law, loop=self.candidate.loop, move=None, snap=None, step=None, model=None)

    def _at_places(self, loop: Loop) -> list[tuple[Loop, Loop]]:
        """Return the loop at each position, as simulated and as linearized."""
        places = self.places or ((loop.axis, loop.axis),)
        return [(replace(loop, axis=axis), replace(loop, axis=model)) for axis, model in places]

    def _judged(self, law: Competitor) -> Competitor:
        """Return the law with its worst figures over all positions and noise seeds, and the runs of the first.

        A loop that has unstable eigenvalues or leaves its bounds for any of them is `unfit`.
        """
        places = self._at_places(law.loop)
        rows: list[Competitor] = []
        for (loop, model), seed in product(places, self.seeds):
            rows.append(self._at(law, loop, model, seed))
            if rows[-1].unfit:
                return rows[-1]
        figures = worst([row.figures for row in rows])
        if self.varied is not None and law.loop.control.law.period() <= MOST:
            figures[ROBUST] = max(robust_peak(model, self.rule.velocity, self.varied) for _, model in places)
        remark = max((row.remark for row in rows), key=len)  # that of a run in which the guard tripped, if any
        return replace(rows[0], figures=figures, remark=remark, outside=self.rule.broken(figures))

    def _at(self, law: Competitor, loop: Loop, model: Loop, seed: int) -> Competitor:
        """Return a law with its figures at one position, with the noise of one seed."""
        figures, both = effort_of(loop), None
        verdict = stability(model, velocity=self.rule.velocity)
        if not verdict.stable:
            return replace(law, figures=figures, unfit=verdict.sentence())
        if loop.control.law.period() <= MOST:
            both = loop_model(model, velocity=self.rule.velocity)
            figures = linear(model, both)
        try:
            runs = self.duty.runs(loop, seed, law.name)
        except FeeddriveError as error:
            return replace(law, figures=figures, model=both, unfit=Text(f"{error}"))
        remark = joined("; ", filter(None, (law.remark, "the guard tripped"))) if runs.tripped else law.remark
        figures = {**figures, **runs.figures}
        return replace(law, figures=figures, remark=remark, move=runs.move, snap=runs.snap, step=runs.step, model=both)


_TEXTS = ("remark", "unfit", "outside")


def at_work(
    work: Sequence[AtWork | Refusal], engine: Engine, progress: Progress | Bar | None
) -> list[Competitor | Refusal]:
    """Evaluate the laws that are not refused already; return all in order."""
    evaluated = iter(engine.evaluate([case for case in work if isinstance(case, AtWork)], progress))
    return [next(evaluated) if isinstance(case, AtWork) else case for case in work]


def robust_peak(loop: Loop, velocity: float, share: float) -> float:
    """Return the largest Ms with all masses, or all stiffnesses, of the plant perturbed by ±`share`; infinite if
    unstable.
    """
    peaks: list[float] = []
    for powers, factor in product(_WRONG, (1.0 - share, 1.0 + share)):
        plant = loop.axis.plant
        changes = {
            name: value * factor ** powers[unit]
            for name, value in tree.leaves(plant)
            if (unit := tree.declaration(plant, name).unit) in powers
        }
        if not changes:
            continue
        wrong = replace(loop, axis=replace(loop.axis, plant=tree.vary(plant, changes)))
        if not stability(wrong, velocity=velocity).stable:
            return math.inf
        both = loop_model(wrong, velocity=velocity)
        peaks.append(margins(both.loop_gain(both.lines(200))).sensitivity_peak)
    return max(peaks)

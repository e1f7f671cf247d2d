"""One control law on one plant: the axis with its duty, the case that evaluates the law, and the resulting row."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any, ClassVar

from feeddrive.analysis.loop_model import LoopModel, loop_model
from feeddrive.analysis.stability import stability
from feeddrive.evaluation.case import Case
from feeddrive.evaluation.duty import Duty, DutyRuns
from feeddrive.evaluation.robustness import Design, Rule
from feeddrive.figures import of_loops
from feeddrive.figures.ranking import ROBUST, Values, effort_of, linear, robust_peak, worst
from feeddrive.files.run_files import plain
from feeddrive.language.errors import FeeddriveError
from feeddrive.language.progress import Progress
from feeddrive.language.text import Text, joined, marked
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.linearize import MOST
from feeddrive.loop.loop import Loop
from feeddrive.tuning.candidates import ON_THE_MACHINE, Candidate
from feeddrive.tuning.recipes import RECIPES
from feeddrive.tuning.tune import Tuned
from feeddrive.tuning.worst import OverBox, box_plants, over_box

REFUSED, UNFIT, STALE = "refused", "unfit", "stale"
UNSETTLED, UNSEARCHED, OUTSIDE = "not settled", "not searched", "outside of the rule"
UNDECIDED = "undecided"


_OVER_BOX = (
    of_loops.SENSITIVITY_PEAK,
    of_loops.DELAY_MARGIN,
    of_loops.ROPE_SNAP,
    *of_loops.STIFFNESS_AT,
    of_loops.STIFFNESS_LEAST,
)
"""The figures of the linear model that are shown at the worst plant of a box, too."""


@dataclass(frozen=True)
class Place:
    """An axis at one position: `axis` as simulated, and `model` as used for tuning, without forces that cannot be
    linearized there.
    """

    name: str
    axis: Axis
    model: Axis


@dataclass(frozen=True, eq=False)
class Plant:
    """An axis, the duty on which all laws are evaluated, and the rule that they must satisfy.

    name     name in the benchmark, whose rows are stored; empty in a comparison, whose rows contain runs, which are too
             large for a store
    loop     the axis with its existing control; all laws use its filters, force limit and guard
    places   positions of the axis, the nominal one first
    seeds    noise seeds of the runs; the worst figures over all of them count
    lesson   noise seed of the trials in which a law learns
    varied   relative error of masses and stiffnesses for the robust Ms; None: the robust Ms is not computed
    drawn    plants on which the laws are judged in place of the models, each at all positions; no law is told how they
             differ from the models; the runs at each have the noise of the seed of the same number
    """

    name: str
    loop: Loop
    duty: Duty
    rule: Rule
    places: tuple[Place, ...]
    seeds: tuple[int, ...] = ()
    lesson: int = 0
    varied: float | None = None
    drawn: tuple[tuple[Place, ...], ...] = ()

    @property
    def model(self) -> Loop:
        """The loop used for tuning, at the nominal position."""
        return replace(self.loop, axis=self.places[0].model)

    def loops(self, loop: Loop) -> list[tuple[Loop, Loop]]:
        """Return a loop at each position, as simulated and as linearized."""
        return [(replace(loop, axis=place.axis), replace(loop, axis=place.model)) for place in self.places]

    def label(self, law: str) -> str:
        """Return the name of the evaluation of a law on this plant, for progress and files."""
        return f"{self.name}: {law}" if self.name else f"{law}: the work"


@dataclass(frozen=True, eq=False)
class Competitor:
    """A law on one axis: its loop, its figures in SI units, the reason why it is not ranked, and its runs.

    box       the law over the box of the rule; None if there is no box
    worst     its figures at the worst plant of the box: linear ones over the box, those of runs at the model and at the
              corners of `Box.together`, which are the same plants for every law
    nominal   figures of the model, where `figures` are those of drawn plants
    draws     its figures at each drawn plant; `figures` has the worst of them
    unplaced  empty for a ranked law, otherwise the kind and the reason. "unfit": the loop is unstable or the motion
              left its bounds; "outside of the rule": the bounds that the law exceeds, as the existing gains may
    tuned     result of its search, or its stored design; None for a law that was not tuned and for a recipe
    plant     name of the plant in the benchmark, where `runs` is None and `loop` does not yet have the learned
              parameters or the gains of a recipe; empty in a comparison
    recipe    True for gains from a tuning recipe: the row is shown separately and may violate the rule
    """

    name: str
    loop: Loop
    figures: Values = field(default_factory=dict[str, float | None])
    unplaced: str = ""
    remark: str = ""
    tuned: Tuned | Design | None = None
    plant: str = ""
    recipe: bool = False
    runs: DutyRuns | None = None
    model: LoopModel | None = None
    box: OverBox | None = None
    worst: Values = field(default_factory=dict[str, float | None])
    nominal: Values = field(default_factory=dict[str, float | None])
    draws: tuple[Values, ...] = ()

    @property
    def kind(self) -> str:
        """The kind of reason why the law is not ranked, in a few words; empty if it is ranked."""
        return self.unplaced.partition(":")[0]

    @property
    def reason(self) -> Text:
        """The reason without its kind."""
        return Text(marked(self.unplaced).partition(": ")[2])

    @property
    def held_by(self) -> str:
        """The active constraints of its search."""
        if not isinstance(self.tuned, Tuned):
            return "not tuned"
        return ", ".join(dict.fromkeys(bound.what for bound in self.tuned.held)) or "none"

    @property
    def unproven(self) -> Text:
        """The checks in the proof of the tuning that did not pass, each with its explanation; empty if all passed."""
        proof = self.tuned.proof if isinstance(self.tuned, Tuned) else ()
        return joined("; ", (f"{line.what}: {marked(line.text)}" for line in proof if line.holds is not True))

    def record(self) -> dict[str, Any]:
        """Return the row as plain numbers and texts; infinity is the text "infinite"."""
        tuned, control = self.tuned, self.loop.place_of("control")
        row: dict[str, Any] = {"unplaced": self.unplaced or None, "remark": self.remark or None}
        if tuned is not None:
            row["tunables"] = {f"{control}.{name}": value for name, value in tuned.tunables.items()}
            row["held"] = [bound if isinstance(bound, str) else bound.sentence() for bound in tuned.held]
            row |= {"spread": tuned.spread, "loops_judged": tuned.evaluations}
            row["searches"] = {"within_5_percent": tuned.agreed[0], "all": tuned.agreed[1]}
        if self.box is not None:
            row["box"] = self.box.record()
            row["worst"] = {key: plain(value) for key, value in self.worst.items()}
        if isinstance(tuned, Tuned):
            row["proof"] = {line.what: {"holds": line.holds, "said": line.text} for line in tuned.proof}
        if self.draws:
            row["draws"] = [{key: plain(value) for key, value in figures.items()} for figures in self.draws]
            row["model"] = {key: plain(value) for key, value in self.nominal.items()}
        return row | {"figures": {key: plain(value) for key, value in self.figures.items()}}


@dataclass(frozen=True, eq=False)
class AtWork(Case[Competitor]):
    """The case that adapts one law to the move of a plant, simulates it and computes its figures.

    recipe   name of the tuning recipe that sets the gains of the law; empty if the law already has its gains
    """

    kind: ClassVar[str] = "law_at_work"
    common: ClassVar[tuple[str, ...]] = ("plant",)

    candidate: Candidate
    plant: Plant
    recipe: str = ""

    @property
    def name(self) -> str:
        """The name of the case: plant and law, or the law followed by ": the work"."""
        return self.plant.label(self.candidate.name)

    def record(self, outcome: Competitor) -> Mapping[str, Any] | None:
        """Return the row of the benchmark as a record that preserves the quantities in texts; None in a comparison."""
        if not self.plant.name:
            return None
        return {
            "figures": dict(outcome.figures),
            "unplaced": marked(outcome.unplaced),
            "remark": marked(outcome.remark),
            "nominal": dict(outcome.nominal),
            "draws": [dict(figures) for figures in outcome.draws],
        }

    def restored(self, record: Any, progress: Progress) -> Competitor:
        """Restore the row from a record."""
        unplaced, remark = Text(record["unplaced"]), Text(record["remark"])
        return self._row(
            figures=dict(record["figures"]),
            unplaced=unplaced,
            remark=remark,
            nominal=dict(record["nominal"]),
            draws=tuple(dict(figures) for figures in record["draws"]),
        )

    def outcome(self, progress: Progress) -> Competitor:
        """Return the law with its figures, or as refused if it cannot be adapted to the move or evaluated."""
        (loop, model), *_ = self.plant.loops(self.candidate.loop)
        remark = self.candidate.remark
        try:
            if self.recipe:
                gains = RECIPES[self.recipe](model, loop.control)
                loop, remark = replace(loop, control=replace(loop.control, law=gains.law)), gains.reason
            else:
                loop = replace(self.candidate, loop=loop).adapted(self.plant.duty.move, self.plant.lesson)
            row = self._row(loop=loop, remark=remark)
            law = self._on_drawn(row) if self.plant.drawn else self._judged(row)
        except FeeddriveError as error:
            return self._row(unplaced=Text(f"{REFUSED}: {error}"))
        # runs of all laws on all plants would fill the memory, and a row from the store has none either
        return replace(law, loop=self.candidate.loop, runs=None, model=None) if self.plant.name else law

    def _row(self, **values: Any) -> Competitor:
        row = Competitor(self.candidate.name, self.candidate.loop, plant=self.plant.name, recipe=bool(self.recipe))
        return replace(row, **values)

    def _judged(self, law: Competitor) -> Competitor:
        """Return the law with its worst figures over all positions and noise seeds, and the runs of the first.

        The law is unfit if its loop is unstable or leaves its bounds at any position or noise seed.
        """
        places, rule = self.plant.loops(law.loop), self.plant.rule
        rows: list[Competitor] = []
        for (loop, model), seed in product(places, self.plant.seeds):
            rows.append(self._at(law, loop, model, seed))
            # one position or seed that fails decides for all: further runs would only cost time
            if rows[-1].unplaced:
                return rows[-1]
        figures = worst([row.figures for row in rows])
        if self.plant.varied is not None and law.loop.control.law.period() <= MOST:
            figures[ROBUST.key] = max(robust_peak(model, rule.velocity, self.plant.varied) for _, model in places)
        # judged by the worst figures, so that no position or seed may exceed a bound
        exceeded = rule.broken(figures)
        unplaced = Text(f"{OUTSIDE}: {exceeded}") if exceeded else ""
        box = self._over_box(law.loop) if law.loop.control.law.period() <= MOST else None
        if box is not None and box.holds is not True:
            kind = UNDECIDED if box.holds is None and not exceeded else OUTSIDE
            over = Text(f"over the box {box.sentence(rule.limits())}")
            unplaced = Text(f"{kind}: {joined(', ', [*([exceeded] if exceeded else []), over])}")
        worst_figures = {} if box is None else self._worst_over(box, rows[0])
        # the longest remark is that of a run in which the guard tripped, if any
        remark = max((row.remark for row in rows), key=len)
        return replace(rows[0], figures=figures, remark=remark, unplaced=unplaced, box=box, worst=worst_figures)

    def _on_drawn(self, law: Competitor) -> Competitor:
        """Return the law with its figures at each drawn plant, and the worst of them.

        It is unfit if its loop is unstable or leaves its bounds at any of them.  The bounds of the rule are those of
        the box, over which its gains were tuned.
        """
        nominal = self.plant.rule.figures(replace(law.loop, axis=self.plant.places[0].model))
        rows: list[Competitor] = []
        for number, (places, seed) in enumerate(zip(self.plant.drawn, self.plant.seeds, strict=True), 1):
            control = self._taught(law, places[0].axis)
            at_places: list[Competitor] = []
            for place in places:
                loop, model = (replace(law.loop, axis=axis, control=control) for axis in (place.axis, place.model))
                at_places.append(self._at(law, loop, model, seed))
                if at_places[-1].unplaced:
                    failed = at_places[-1]
                    why = Text(f"{failed.kind}: at drawn plant {number}, {failed.reason}")
                    return replace(failed, nominal=nominal, unplaced=why)
            rows.append(replace(at_places[0], figures=worst([row.figures for row in at_places])))
        figures = worst([row.figures for row in rows])
        remark = max((row.remark for row in rows), key=len)
        return replace(
            rows[0], figures=figures, remark=remark, nominal=nominal, draws=tuple(row.figures for row in rows)
        )

    def _taught(self, law: Competitor, axis: Axis) -> Control:
        """Return the control of a law, which a law that learns on the machine learns on this axis."""
        if self.candidate.then not in ON_THE_MACHINE:
            return law.loop.control
        learner = replace(self.candidate, loop=replace(self.candidate.loop, axis=axis))
        return learner.adapted(self.plant.duty.move, self.plant.lesson).control

    def _over_box(self, loop: Loop) -> OverBox | None:
        """Return the law over the box of the rule; None if the rule has no box."""
        rule = self.plant.rule
        if rule.box is None:
            return None
        places = self.plant.places
        # named as by the tuning, which has computed these plants
        boxes = [
            box_plants(
                rule.box, replace(loop, axis=place.model), place.name if len(places) > 1 else "model", rule.velocity
            )
            for place in places
        ]
        return over_box(loop.control, boxes, rule.limits(), shown=_OVER_BOX)[0]

    def _worst_over(self, box: OverBox, law: Competitor) -> Values:
        """Return the figures at the worst plant of the box; absent ones are None, as where the loop is unstable.

        All laws are run at the same plants: the worst plants of each, at which the linear figures are the worst,
        differ from law to law, and so would the runs.
        """
        over: dict[str, float | None] = {s.figure.key: s.worst for s in box.spreads}
        # a run at an unstable plant shows when it was stopped, not how bad it is
        if not math.isfinite(box.used):
            return over
        runs: list[Values] = [] if law.runs is None else [law.runs.figures]
        for corner, seed in product(box.box.together(law.loop.axis), self.plant.seeds[:1]):
            try:
                runs.append(self.plant.duty.runs(box.box.plant(law.loop, corner), seed, law.name).figures)
            except FeeddriveError:
                # unstable or out of its bounds: it has no figures of runs at its worst plant
                runs.append({})
        return {**(worst(runs) if runs else {}), **over}

    def _at(self, law: Competitor, loop: Loop, model: Loop, seed: int) -> Competitor:
        """Return a law with its figures at one position, with the noise of one seed."""
        figures, both, velocity = effort_of(loop), None, self.plant.rule.velocity
        verdict = stability(model, velocity=velocity)
        if not verdict.stable:
            return replace(law, figures=figures, unplaced=Text(f"{UNFIT}: {verdict.sentence()}"))
        # a law that repeats itself after more samples has no linear model, and is judged by its runs alone
        if loop.control.law.period() <= MOST:
            both = loop_model(model, velocity=velocity)
            figures = linear(model, both)
        try:
            runs = self.plant.duty.runs(loop, seed, law.name)
        except FeeddriveError as error:
            return replace(law, figures=figures, model=both, unplaced=Text(f"{UNFIT}: {error}"))
        remark = joined("; ", filter(None, (law.remark, "the guard tripped"))) if runs.tripped else law.remark
        return replace(law, figures={**figures, **runs.figures}, remark=remark, runs=runs, model=both)

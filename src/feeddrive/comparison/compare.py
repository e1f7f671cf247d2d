"""Compare control laws on one axis: the existing gains first, then each law tuned under the same rule, with identical
motions and loads.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from feeddrive.analysis.stability import stability
from feeddrive.blocks.families import Law, Reference
from feeddrive.evaluation.competitor import (
    OUTSIDE,
    REFUSED,
    UNDECIDED,
    UNFIT,
    UNSETTLED,
    AtWork,
    Competitor,
    Place,
    Plant,
)
from feeddrive.evaluation.duty import Duty, duty_of
from feeddrive.evaluation.engine import Bar, Engine
from feeddrive.evaluation.lineup import Lineup, Trial, judged
from feeddrive.evaluation.robustness import Rule, Tuning, tuned_all
from feeddrive.figures import of_loops, of_runs
from feeddrive.figures.figure import Figure
from feeddrive.figures.ranking import CRITERIA, losses, ranks
from feeddrive.files.job import Job
from feeddrive.files.machine import MachineFile
from feeddrive.files.run_files import versions
from feeddrive.language.errors import ParameterError, UnstableError
from feeddrive.language.judgment import Advice, Judgment
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.table import Cell, Column, Result, Table, chart_of, frame_of
from feeddrive.language.text import Text, joined, marked
from feeddrive.loop.box import Box
from feeddrive.plot.chart import Chart
from feeddrive.tuning.candidates import PLAIN, Candidate, Refusal
from feeddrive.tuning.filters import with_notch_and_low_pass
from feeddrive.tuning.tune import two_digits

TODAY = "today's gains"
_SNAP = of_loops.ROPE_SNAP.key
_SHOWN = {
    "Ms": of_loops.SENSITIVITY_PEAK,
    "delay": of_loops.DELAY_MARGIN,
    "snap": of_loops.ROPE_SNAP,
    "at 10 Hz": of_loops.STIFFNESS_AT[0],
    "at 100 Hz": of_loops.STIFFNESS_AT[1],
    "track RMS": of_runs.TRACKING_RMS,
    "settled": of_runs.SNAP_SETTLING,
    "noise": of_loops.FORCE_NOISE,
}
"""The figures of the short table, under heads that leave it within 100 columns of a terminal."""
_HEADS = {
    UNFIT: "Without figures, unstable or out of bounds",
    UNSETTLED: "Not settled, so not ranked (more --starts may find better gains)",
    OUTSIDE: "Outside of the rule, so not ranked",
    UNDECIDED: "Undecided whether the rule holds over the box, so not ranked",
}
"""The heads of the lists of laws that are not ranked, by the kind of reason."""
# share of the force limit above which force noise gets a remark: it is heard, and heats the motor at standstill
_NOISY = 0.02
# number of criteria in which a law is worse that are named in the advice, the worst first: a sentence must stay short
_NAMED = 4


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Result):
    """The result of a comparison: all competitors, the existing control first, and the refused laws.

    Margins and stiffness are computed for the axis sliding at `velocity`, in m/s.
    """

    machine: MachineFile
    axis: str
    duty: Duty
    velocity: float
    seed: int
    rule: str
    competitors: tuple[Competitor, ...]
    refusals: tuple[Refusal, ...]
    versions: Mapping[str, str]

    def __getitem__(self, name: str) -> Competitor:
        competitor = next((law for law in self.competitors if law.name == name), None)
        if competitor is None:
            raise ParameterError(f"there is no '{name}' here; there are {', '.join(self.names)}")
        return competitor

    @property
    def names(self) -> list[str]:
        """The names of all competitors."""
        return [competitor.name for competitor in self.competitors]

    @property
    def figures(self) -> list[Mapping[str, float | None]]:
        """The figures of all competitors."""
        return [competitor.figures for competitor in self.competitors]

    @property
    def rotary(self) -> bool:
        """True for a rotary axis."""
        return self.machine.loops[self.axis].axis.rotary

    @property
    def quoted(self) -> tuple[str, ...]:
        """The texts quoted from the machine file."""
        return self.machine.quoted

    @property
    def title(self) -> str:
        """The title, with machine and axis."""
        return f"{self.machine.name}, axis {self.axis}: all laws at equal robustness"

    @property
    def remarks(self) -> tuple[str, ...]:
        """The remarks on the laws that are needed to read the figures, as sentences."""
        return (*standings(self), *against_plain(self), *noisy(self))

    def table(self) -> Table:
        """Return a table of robustness and the deciding figures per law; * marks those that are not ranked."""
        rows: list[list[Cell]] = []
        for law in self.competitors:
            name = f"{law.name}{' *' if law.unplaced else ''}"
            rows.append([name, *(law.figures.get(figure.key) for figure in _SHOWN.values())])
            if law.box is not None:
                rows.append(["  at worst", *(law.worst.get(figure.key) for figure in _SHOWN.values())])
        columns = [replace(figure.column(head), form="2") for head, figure in _SHOWN.items()]
        over = ", at worst: over the box" if any(law.box is not None for law in self.competitors) else ""
        return Table(f"{self.title}; * not ranked{over}", [Column("law"), *columns], rows)

    def ranking(self) -> Table:
        """Return a table of the rank of each law by each criterion."""
        places = zip(*map(self.places, CRITERIA), strict=True)
        rows = [
            [law.name, *(law.unplaced or place for place in row)]
            for law, row in zip(self.competitors, places, strict=True)
        ]
        return Table("Places by criterion, 1 is best", ["law", *(criterion.title for criterion in CRITERIA)], rows)

    def places(self, criterion: Figure) -> list[int | None]:
        """Return the rank of each law by a criterion; None for a law that has not settled or violates the rule."""
        return ranks(criterion, [{} if law.unplaced else law.figures for law in self.competitors])


@chart_of.register
def _chart(comparison: Comparison) -> Chart:
    """Plot stiffness versus tracking error, one dot per law."""
    from feeddrive.plot.laws import tradeoff_chart

    laws = comparison.competitors
    return tradeoff_chart([(law.name, law.figures, law.unplaced) for law in laws], [law.worst for law in laws])


@frame_of.register
def _frame(comparison: Comparison) -> Any:
    """Return a data frame with one row per law, in SI units."""
    from feeddrive.plot import frames

    return frames.laws(comparison.names, comparison.figures)


def compare_laws(
    machine: MachineFile,
    axis: str | None = None,
    *,
    laws: Sequence[str | type[Law]] | None = None,
    reference: Reference | None = None,
    force: float | None = None,
    sensitivity_peak: float = 2.0,
    delay_margin_samples: float = 2.0,
    noise_ratio: float = 1.05,
    box: Box | None = None,
    filters: str | None = None,
    seed: int = 0,
    starts: int = 2,
    engine: Engine | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """Tune and compare all laws on one axis of a machine.

    laws               names or kinds of the laws to compare, or user-defined classes; P-PI is always included;
                       default: all
    reference, force   the move, and the force in N of the rope-snap and force-step tests; default: from the limits
                       of the machine (`Duty`)
    sensitivity_peak, delay_margin_samples, noise_ratio   the rule of equal robustness; the last one limits the gain
                       from reading noise to force, relative to that of the tuned P-PI
    box                tolerances of the plant: the rule holds over this box, and every figure is also computed at its
                       worst plant; a law is not ranked if the rule is exceeded, or undecided, at a plant of the box
    filters            kept: the filters of the machine file, unchanged;  free: every law tunes them, and a notch and a
                       low-pass are added where there is none, so that no law knows a resonance that another does not;
                       default: free with a box, kept without one
    seed               seed of the encoder noise, the same for all laws, and of the searches
    starts             number of searches per law; with a single search no law is ranked, since no second search
                       confirms the result
    engine             engine that tunes and evaluates the laws and stores finished cases; default: in this process
    progress           reports each step and the number of steps

    The existing control comes first and is not changed, whether stable or not.  A law that does not suit the axis is
    refused with the reason; a law without tunables is evaluated unchanged.

    Raises ParameterError for an unknown axis or law.
    """
    if not isinstance(machine, MachineFile):  # pyright: ignore[reportUnnecessaryIsInstance]
        remedy = "run a job with fd.run(job)" if isinstance(machine, Job) else "give what fd.read_machine(...) returns"
        raise ParameterError(f"fd.compare takes a machine file, not a {type(machine).__name__}: {remedy}")
    engine = engine or Engine()
    loop = machine.loop(axis)
    name = axis if axis is not None else next(iter(machine.loops))
    duty = duty_of(loop, reference, force)
    filters = filters or ("kept" if box is None else "free")
    if filters not in ("kept", "free"):
        raise ParameterError(f"filters = {filters!r} must be kept or free: all laws of a comparison have the same ones")
    begun = loop if filters == "kept" else with_notch_and_low_pass(loop)
    lineup = Lineup.of(begun, [law for law in laws or () if not isinstance(law, str)])
    if laws is not None:
        lineup = lineup.only(lineup.names(laws))
    if not noise_ratio >= 1.0:
        raise ParameterError(f"noise_ratio = {number(noise_ratio, 6)} must be >= 1: P-PI itself has 1")
    rule = Rule(
        sensitivity_peak,
        delay_margin_samples,
        noise_ratio,
        duty.sliding(loop),
        starts,
        box=box,
        filters=filters,
        seed=seed,
    )
    # an error of the present control ends the comparison here, before searches that take minutes
    stability(loop, velocity=rule.velocity)
    searched = lineup.searched
    bar = Bar(progress or Progress(), Tuning.stages * len(searched) + len(lineup.possible) + len(lineup.refused) + 1)
    tunings, rule = tuned_all(searched, rule, engine, bar)
    plant = Plant("", begun, duty, rule, (Place(name, loop.axis, loop.axis),), (seed,), seed)
    # the present gains come first and unchanged: all other rows are compared with them
    today = Trial(AtWork(Candidate(TODAY, loop, "as in the machine file"), plant))
    rows = judged([today, *lineup.trials(tunings, plant)], engine, bar)
    competitors = tuple(row for row in rows if row.kind != REFUSED)
    refusals = tuple(Refusal(row.name, row.reason) for row in rows if row.kind == REFUSED)
    if all(competitor.runs is None for competitor in competitors):
        reasons = joined("; ", [f"{competitor.name}: {competitor.reason}" for competitor in competitors])
        raise UnstableError(f"{machine.file.name}: axis '{name}': no law can be run on it: {reasons}")
    return Comparison(machine, name, duty, rule.velocity, seed, rule.sentence, competitors, refusals, versions())


def standings(comparison: Comparison) -> list[str]:
    """Return sentences on today's gains, and on the laws that are not ranked or whose stability is not proven, with the
    reasons.
    """
    laws, today = comparison.competitors, comparison.competitors[0]
    groups = {head: {law.name: law.reason for law in laws if law.kind == kind} for kind, head in _HEADS.items()}
    groups["Nothing to tune, so judged as it is"] = {law.name: Text() for law in laws[1:] if law.tuned is None}
    groups["Not proven in every point"] = {law.name: law.unproven for law in laws if law.unproven}
    sentences: list[str] = []
    if not today.unplaced:
        sentences.append(f"'{today.name}' keep the rule.")
    elif today.kind == OUTSIDE and today.figures.get(of_loops.SENSITIVITY_PEAK.key) is None:
        period = today.loop.control.law.period()
        sentences.append(f"'{today.name}' repeats itself every {period} samples: it has no margins.")
    return [*sentences, *(Text(f"{head}: {_by_reason(reasons)}.") for head, reasons in groups.items() if reasons)]


def _by_reason(reasons: Mapping[str, str]) -> Text:
    """Return the names of laws, grouped by reason, with the reason in parentheses after each group."""
    named = dict[str, list[str]]()
    for law, reason in reasons.items():
        named.setdefault(marked(reason), []).append(law)
    return joined("; ", (", ".join(laws) + (f" ({reason})" if reason else "") for reason, laws in named.items()))


def against_plain(comparison: Comparison) -> list[str]:
    """Return sentences on the criteria by which each law is worse or better than plain P-PI under the same rule."""

    def listed(changes: Iterable[tuple[Figure, float, float]]) -> str:
        return joined(", ", (f"{criterion.title} ({_ratio(a, b)})" for criterion, a, b in changes)) or "nothing"

    laws = [law for law in comparison.competitors[1:] if law.kind != UNFIT]
    plain = next((law.figures for law in laws if law.name == PLAIN), {})
    return [
        Text(
            f"'{law.name}' loses to P-PI in {listed(losses(law.figures, plain))}; wins in "
            f"{listed((criterion, ours, theirs) for criterion, theirs, ours in losses(plain, law.figures))}."
        )
        for law in laws
        if plain and law.name != PLAIN
    ]


def _ratio(a: float, b: float) -> str:
    if math.isinf(a) or math.isinf(b):
        return "never" if math.isinf(a) else "P-PI never"
    return f"× {number(a / b, 3)}" if b else f"{number(a, 3)} against 0"


def noisy(comparison: Comparison) -> list[str]:
    """Return sentences on laws whose force noise is too large for practical use, independent of their margins."""
    sentences: list[str] = []
    for law in comparison.competitors:
        limit, noise = law.loop.control.force_limit, law.figures.get(of_loops.FORCE_NOISE.key)
        if limit is not None and noise is not None and noise > _NOISY * limit:
            sentences.append(
                Text(
                    f"'{law.name}': counts and noise of the encoders alone make {Quantity(noise, 'N'):3} RMS of force, "
                    f"{Quantity(noise / limit, 'share'):3} of the limit: a finer encoder, a low-pass or lower gains "
                    "come first."
                )
            )
    return sentences


def best_law(comparison: Comparison) -> str:
    """Return the ranked law with the least rope-snap error; empty if no law but the existing gains is ranked."""
    ranked = {law.name: snap for law in comparison.competitors if not law.unplaced and (snap := law.figures.get(_SNAP))}
    return "" if set(ranked) <= {TODAY} else min(ranked, key=lambda name: ranked[name])


def advice(comparison: Comparison) -> Advice:
    """Recommend the law of least rope-snap error; state first where it is worse than P-PI or the existing gains."""
    snaps = {law.name: snap for law in comparison.competitors if (snap := law.figures.get(_SNAP))}
    best = best_law(comparison)
    if not best:
        return Advice(Judgment.NONE_RANKED, f"{Judgment.NONE_RANKED.says}.")
    if best == TODAY:
        return Advice(Judgment.KEEP_GAINS, f"{Judgment.KEEP_GAINS.says}.")
    least = f"'{best}' {Judgment.RANKED.says}"
    other = PLAIN if best != PLAIN else TODAY
    if other not in snaps:
        return Advice(Judgment.RANKED, f"{least}.")
    # ratios of figures with and without "higher is better" are comparable by the size of their logarithm
    worse = list[tuple[float, str]]()
    for criterion, ours, theirs in losses(comparison[best].figures, comparison[other].figures):
        ratio = ours / theirs if theirs else math.inf
        text = f"{criterion.title} {_times(ratio)} times" if math.isfinite(ratio) else f"{criterion.title} never"
        worse.append((abs(math.log(ratio)) if 0.0 < ratio < math.inf else math.inf, text))
    worst = [text for _, text in sorted(worse, key=lambda loss: -loss[0])]
    more = f", and {len(worst) - _NAMED} more" if len(worst) > _NAMED else ""
    lost = f"Worse than with {other}: {', '.join(worst[:_NAMED])}{more}." if worst else ""
    ratio = _times(snaps[best] / snaps[other])
    won = f"{least}, {ratio} times that of {other}{'' if lost else ', and is worse in nothing'}."
    return Advice(Judgment.RANKED, f"{lost} {won}".strip())


def _times(ratio: float) -> str:
    """Format a ratio with two significant digits, or three near 1: 0.83, 1.05."""
    return number(ratio, 3) if 0.9 < ratio < 1.1 else two_digits(ratio)

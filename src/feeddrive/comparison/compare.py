"""Compare control laws on one axis: the present gains first, then each law tuned under the same rule, with identical
motions and loads.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from feeddrive.analysis.stability import stability
from feeddrive.blocks.families import Law, Reference
from feeddrive.comparison.competitor import AtWork, Competitor, at_work
from feeddrive.evaluation.duty import Duty, duty_of
from feeddrive.evaluation.engine import Bar, Engine
from feeddrive.evaluation.robustness import Rule, Tuning, tuned_all
from feeddrive.figures import of_loops, of_runs
from feeddrive.figures.figure import Figure
from feeddrive.figures.ranking import CRITERIA, beats, ranks
from feeddrive.files.job import Job
from feeddrive.files.machine import MachineFile
from feeddrive.files.run_files import versions
from feeddrive.language.errors import ParameterError, UnstableError
from feeddrive.language.judgment import Advice, Judgment
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.table import Result, Table, chart_of, frame_of
from feeddrive.language.text import Text, joined
from feeddrive.loop.loop import Loop
from feeddrive.plot.chart import Chart
from feeddrive.tuning.candidates import PLAIN, Candidate, Refusal, candidates, names_of
from feeddrive.tuning.tune import Tuned, own_tunables, two_digits

TODAY = "today's gains"
FIXED = "it has nothing to tune and is judged as it is"
_SHOWN = (
    of_loops.SENSITIVITY_PEAK,
    of_loops.DELAY_MARGIN,
    of_loops.NOISE_GAIN,
    of_loops.ROPE_SNAP,
    *of_loops.STIFFNESS_AT,
    of_runs.TRACKING_RMS,
    of_runs.SNAP_SETTLING,
    of_loops.FORCE_NOISE,
    of_loops.EFFORT,
)
"""The figures of the short table."""
_NOISY = 0.02  # share of the force limit above which force noise gets a remark
_NAMED = 4  # number of criteria in which a law is worse that are named in the advice, the worst first


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Result):
    """The result of a comparison: all competitors, the present control first, the refused laws, and the remarks.

    `velocity` in m/s is the speed at which margins and stiffness are taken: the axis must be sliding.
    """

    machine: MachineFile
    axis: str
    duty: Duty
    velocity: float
    seed: int
    rule: str
    competitors: tuple[Competitor, ...]
    refusals: tuple[Refusal, ...]
    remarks: tuple[str, ...]
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

    def table(self) -> Table:
        """Return a table of robustness and the most important figures per law."""
        rows = [
            [law.name, *(law.figures.get(figure.key) for figure in _SHOWN), law.unplaced.partition(":")[0]]
            for law in self.competitors
        ]
        return Table(self.title, ["law", *(figure.column(figure.short) for figure in _SHOWN), ""], rows)

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

    return tradeoff_chart([(law.name, law.figures, law.unplaced) for law in comparison.competitors])


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
    seed: int = 0,
    starts: int = 2,
    engine: Engine | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """Tune and compare all laws on one axis of a machine.

    laws               names or kinds of the laws to compare, or user-defined classes; P-PI is always included;
                       default: all
    reference, force   the move, and the force in N of rope snap and force step; default: from the machine's limits
                       (`Duty`)
    sensitivity_peak, delay_margin_samples, noise_ratio   the rule of equal robustness; the last one limits the gain
                       from reading noise to force, relative to that of the tuned P-PI
    seed               seed of the encoder noise, the same for all laws
    starts             number of searches per law; with a single one nothing is ranked, since no second search confirms
                       it
    engine             engine that tunes and evaluates the laws and stores finished ones; default: in this process
    progress           reports each step and the number of steps

    The present control comes first and is not changed, whether stable or not.  A law that does not fit the axis is
    refused with the reason, a law without tunables is evaluated as it is.  Raises ParameterError for an unknown axis or
    law.
    """
    if not isinstance(machine, MachineFile):  # pyright: ignore[reportUnnecessaryIsInstance]
        remedy = "run a job with fd.run(job)" if isinstance(machine, Job) else "give what fd.read_machine(...) returns"
        raise ParameterError(f"fd.compare takes a machine file, not a {type(machine).__name__}: {remedy}")
    engine = engine or Engine()
    loop = machine.loop(axis)
    name = axis if axis is not None else next(iter(machine.loops))
    duty = duty_of(loop, reference, force)
    possible, refused = _wanted(loop, laws)
    if not noise_ratio >= 1.0:
        raise ParameterError(f"noise_ratio = {number(noise_ratio, 6)} must be >= 1: P-PI itself has 1")
    rule = Rule(sensitivity_peak, delay_margin_samples, noise_ratio, duty.sliding(loop), starts)
    stability(loop, velocity=rule.velocity)  # an error of the present control ends the comparison before the searches
    searched = [candidate for candidate in possible if not candidate.like and own_tunables(candidate.loop.control)]
    bar = Bar(progress or Progress(), Tuning.stages * len(searched) + len(possible) + 1)
    tunings, rule = tuned_all(searched, rule, engine, bar)
    refusals = [*refused, *(tuned for tuned in tunings.values() if isinstance(tuned, Refusal))]
    work: list[AtWork | Refusal] = []
    tuned_as: dict[str, Tuned] = {}
    for candidate in (Candidate(TODAY, loop, "as in the machine file"), *possible):
        tuned, remark = tunings.get(candidate.like or candidate.name), candidate.remark
        if isinstance(tuned, Refusal):
            bar.step(candidate.name)
            if candidate.like:
                work.append(Refusal(candidate.name, f"'{tuned.name}', whose gains it takes, cannot control it"))
            continue
        if tuned is not None:
            tuned_as[candidate.name] = tuned
        elif candidate.name != TODAY:
            remark = joined("; ", filter(None, (remark, FIXED)))
        ready = candidate if tuned is None else candidate.tuned(tuned.control)
        work.append(AtWork(ready, remark, duty, rule, (seed,), seed))
    rows = at_work(work, engine, bar)
    refusals += [row for row in rows if isinstance(row, Refusal)]
    competitors = tuple(_ranked(row, tuned_as.get(row.name)) for row in rows if isinstance(row, Competitor))
    if all(competitor.move is None for competitor in competitors):
        reasons = joined("; ", [f"{competitor.name}: {competitor.unfit}" for competitor in competitors])
        raise UnstableError(f"{machine.file.name}: axis '{name}': no law can be run on it: {reasons}")
    remarks = tuple(remark for part in _REMARKS for remark in part(competitors))
    return Comparison(
        machine, name, duty, rule.velocity, seed, rule.sentence, competitors, tuple(refusals), remarks, versions()
    )


def _ranked(row: Competitor, tuned: Tuned | None) -> Competitor:
    """Return a row with its tuning, and why it is not ranked."""
    outside = Text(f"outside of the rule: {row.outside}") if row.outside else ""
    return replace(row, tuned=tuned, unplaced=outside if tuned is None or tuned.settled else "not settled")


def _wanted(loop: Loop, laws: Sequence[str | type[Law]] | None) -> tuple[tuple[Candidate, ...], tuple[Refusal, ...]]:
    """Select the laws by name; plain P-PI, and any law whose gains another one takes over, are always included."""
    own = tuple(law for law in laws or () if not isinstance(law, str))
    possible, refused = candidates(loop, own)
    if laws is None:
        return possible, refused
    wanted = {name for law in laws for name in names_of(law, possible, refused)}
    wanted |= {PLAIN, *(candidate.like for candidate in possible if candidate.name in wanted)}
    return (
        tuple(candidate for candidate in possible if candidate.name in wanted),
        tuple(refusal for refusal in refused if refusal.name in wanted),
    )


def name_of(law: str, loop: Loop, own: Sequence[type[Law]] = ()) -> str:
    """Return the name of the first row for a law, by name or kind. Raises ParameterError for an unknown or refused
    law.
    """
    possible, refused = candidates(loop, own)
    name = names_of(law, possible, refused)[0]
    reason = next((row.reason for row in refused if row.name == name), "")
    if reason:
        raise ParameterError(f"'{name}' cannot control this axis: {reason}")
    return name


def _outside(rows: tuple[Competitor, ...]) -> list[str]:
    """Return remarks on the rows that are not at equal robustness, the present gains first."""
    today = rows[0]
    remarks: list[str] = []
    if today.unfit:
        remarks.append(Text(f"'{today.name}': {today.unfit}; the row stays without figures."))
    elif today.figures.get(of_loops.SENSITIVITY_PEAK.key) is None:
        period = today.loop.control.law.period()
        remarks.append(f"'{today.name}' repeats itself every {period} samples: it has no margins.")
    elif not today.outside:
        remarks.append(f"'{today.name}' keep the rule.")
    return remarks + [
        Text(
            f"'{row.name}': outside of the rule ({row.outside}): the figures are not at equal robustness, and not "
            "ranked."
        )
        for row in rows
        if row.outside and not row.unfit
    ]


def _against(rows: tuple[Competitor, ...]) -> list[str]:
    """Return remarks on the criteria by which each law is worse or better than plain P-PI under the same rule."""
    plain = next((row for row in rows if row.name == PLAIN and not row.unfit), None)
    remarks: list[str] = []
    for row in rows[1:]:
        if plain is None or row is plain or row.unfit:
            continue
        won = [(criterion, ours, theirs) for criterion, theirs, ours in losses(plain, row)]
        lost, won = (
            joined(", ", [f"{criterion.title} ({_ratio(ours, theirs)})" for criterion, ours, theirs in some])
            for some in (losses(row, plain), won)
        )
        remarks.append(Text(f"'{row.name}' loses to P-PI in {lost or 'nothing'}; wins in {won or 'nothing'}."))
    return remarks


def losses(ours: Competitor, other: Competitor) -> list[tuple[Figure, float, float]]:
    """Return the criteria by which a law is worse than another one, with the values of both."""
    both = ((criterion, ours.figures.get(criterion.key), other.figures.get(criterion.key)) for criterion in CRITERIA)
    return [(c, a, b) for c, a, b in both if a is not None and b is not None and beats(c, b, a)]


def _ratio(a: float, b: float) -> str:
    if math.isinf(a) or math.isinf(b):
        return "never" if math.isinf(a) else "P-PI never"
    return f"× {number(a / b, 3)}" if b else f"{number(a, 3)} against 0"


def _noisy(rows: tuple[Competitor, ...]) -> list[str]:
    """Return remarks on competitors whose force noise is too large for practical use, independent of their margins."""
    remarks: list[str] = []
    for row in rows:
        limit, noise = row.loop.control.force_limit, row.figures.get(of_loops.FORCE_NOISE.key)
        if limit is not None and noise is not None and noise > _NOISY * limit:
            remarks.append(
                Text(
                    f"'{row.name}': counts and noise of the encoders alone make {Quantity(noise, 'N'):3} RMS of force, "
                    f"{Quantity(noise / limit, 'share'):3} of the limit: a finer encoder, a low-pass or lower gains "
                    "come first."
                )
            )
    return remarks


def _unproven(rows: tuple[Competitor, ...]) -> list[str]:
    """Return remarks on the lines of each tuning's proof that do not hold, and on searches that did not settle."""
    remarks: list[str] = []
    for row in rows:
        if row.tuned is None:
            continue
        open_lines = [f"{line.what} ({line.text})" for line in row.tuned.proof if line.holds is not True]
        if open_lines:
            remarks.append(Text(f"'{row.name}': not proven: {joined('; ', open_lines)}."))
        if not row.settled:
            remarks.append(
                Text(
                    f"'{row.name}' is not settled, and not ranked: {row.tuned.unsettled}; more starts (--starts) may "
                    "find a better setting."
                )
            )
    return remarks


_REMARKS: tuple[Callable[[tuple[Competitor, ...]], list[str]], ...] = (_outside, _against, _noisy, _unproven)


def advice(comparison: Comparison) -> Advice:
    """Recommend the law with the least rope-snap error, and first state where it is worse than P-PI (or P-PI worse than
    the present gains).
    """
    snaps = {law.name: snap for law in comparison.competitors if (snap := law.figures.get(of_loops.ROPE_SNAP.key))}
    ranked = [name for name in snaps if not comparison[name].unplaced]
    if set(ranked) <= {TODAY}:
        return Advice(Judgment.NONE_RANKED, f"{Judgment.NONE_RANKED.says}.")
    best = min(ranked, key=lambda name: snaps[name])
    if best == TODAY:
        return Advice(Judgment.KEEP_GAINS, f"{Judgment.KEEP_GAINS.says}.")
    least = f"'{best}' {Judgment.RANKED.says}"
    other = PLAIN if best != PLAIN else TODAY
    if other not in snaps:
        return Advice(Judgment.RANKED, f"{least}.")
    worse = list[tuple[float, str]]()
    for criterion, ours, theirs in losses(comparison[best], comparison[other]):
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

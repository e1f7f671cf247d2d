"""The comparison: the present gains first, then each law tuned under the same rule, for the same motions and loads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from feeddrive.blocks.families import Law, Reference
from feeddrive.comparison.figures import CRITERIA, beats, ranks
from feeddrive.comparison.judge import AtWork, Competitor
from feeddrive.comparison.tune_all import Rule, Tuning, tuned_all
from feeddrive.evaluation.duty import Duty, duty_of
from feeddrive.evaluation.engine import Bar, Engine
from feeddrive.figures.figure import Figure
from feeddrive.figures.of_loops import (
    DELAY_MARGIN,
    EFFORT,
    FORCE_NOISE,
    NOISE_GAIN,
    ROPE_SNAP,
    SENSITIVITY_PEAK,
    STIFFNESS_AT,
)
from feeddrive.figures.of_runs import SNAP_SETTLING, TRACKING_RMS
from feeddrive.files.job import Job
from feeddrive.files.machine import MachineFile
from feeddrive.files.run_files import versions
from feeddrive.language.errors import ParameterError, UnstableError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.table import Result, Table, chart_of, frame_of
from feeddrive.language.text import Text, joined
from feeddrive.loop.loop import Loop
from feeddrive.plot.chart import Chart
from feeddrive.tuning.candidates import PLAIN, Candidate, Refusal, candidates
from feeddrive.tuning.tune import own_tunables

TODAY = "today's gains"
FIXED = "it has nothing to tune and is judged as it is"
_SHOWN = (
    SENSITIVITY_PEAK,
    DELAY_MARGIN,
    NOISE_GAIN,
    ROPE_SNAP,
    *STIFFNESS_AT,
    TRACKING_RMS,
    SNAP_SETTLING,
    FORCE_NOISE,
    EFFORT,
)
"""The figures of the short table."""
_NOISY = 0.02  # share of the force limit beyond which noise in the force is remarked


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Result):
    """All competitors, today's control first, the laws that do not fit, and what must be said.

    `velocity` in m/s is the speed at which margins and stiffness are taken: the axis slides.
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
        found = next((each for each in self.competitors if each.name == name), None)
        if found is None:
            raise ParameterError(f"there is no '{name}' here; there are {', '.join(c.name for c in self.competitors)}")
        return found

    @property
    def rotary(self) -> bool:
        """Whether the axis turns."""
        return self.machine.loops[self.axis].axis.rotary

    @property
    def quoted(self) -> tuple[str, ...]:
        """What a person wrote in the machine file."""
        return self.machine.quoted

    @property
    def title(self) -> str:
        """Machine and axis."""
        return f"{self.machine.name}, axis {self.axis}: all laws at equal robustness"

    def table(self) -> Table:
        """Robustness, and the most important figures."""
        rows = [
            [row.name, *(row.figures.get(figure.key) for figure in _SHOWN), row.unplaced.partition(":")[0]]
            for row in self.competitors
        ]
        return Table(self.title, ["law", *(figure.column(figure.short) for figure in _SHOWN), ""], rows)

    def ranking(self) -> Table:
        """The place of each law by each criterion."""
        by = [self.places(criterion) for criterion in CRITERIA]
        rows = [[each.name, *(each.unplaced or places[i] for places in by)] for i, each in enumerate(self.competitors)]
        return Table("Places by criterion, 1 is best", ["law", *(criterion.title for criterion in CRITERIA)], rows)

    def places(self, criterion: Figure) -> list[int | None]:
        """The place of each law by a criterion; none for one that has not settled or breaks the rule."""
        return ranks(criterion, [{} if each.unplaced else each.figures for each in self.competitors])


@chart_of.register
def _chart(found: Comparison) -> Chart:
    """Stiffness against tracking, a dot for each law."""
    from feeddrive.comparison import pictures

    return pictures.tradeoff_chart([(each.name, each.figures, each.unplaced) for each in found.competitors])


@frame_of.register
def _frame(found: Comparison) -> Any:
    """One row a law, in SI."""
    from feeddrive.plot.frames import frame

    keys = list(dict.fromkeys(key for each in found.competitors for key in each.figures))
    columns = {key: np.array([each.figures.get(key) for each in found.competitors], float) for key in keys}
    return frame([each.name for each in found.competitors], columns, "law")


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
    """Put all laws on an axis of a machine.

    laws               names of those that are wanted, P-PI always among them, or classes of one's own; default: all
    reference, force   the move, and the force in N of rope snap and step; default: from the machine's limits (`Duty`)
    sensitivity_peak, delay_margin_samples, noise_ratio   the rule of equal robustness; the last one bounds the noise in
                       the force per noise of the readings, by that of the tuned P-PI
    seed               of the encoders' noise, the same for all laws
    starts             searches for each law; with one nothing is ranked, since nothing confirms it
    engine             where laws are tuned and judged, and where finished ones are kept; default: in this process
    progress           reports each step, and how many there are

    The present control comes first and is not changed, stable or not.  A law that does not fit the axis is refused
    with the reason, one with nothing to tune is judged as it is.  Raises ParameterError for an unknown axis or law.
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
    searched = [each for each in possible if not each.like and own_tunables(each.loop.control)]
    bar = Bar(progress or Progress(), Tuning.stages * len(searched) + len(possible) + 1)
    tuned, rule = tuned_all(searched, rule, engine, bar)
    refusals = [*refused, *(found for found in tuned.values() if isinstance(found, Refusal))]
    work: list[AtWork | Refusal] = [AtWork(Candidate(TODAY, loop), None, "as in the machine file", duty, rule, seed)]
    for candidate in possible:
        made = tuned.get(candidate.like or candidate.name)  # None: the law has nothing to tune
        if isinstance(made, Refusal):
            bar.step(candidate.name)
            if candidate.like:
                work.append(Refusal(candidate.name, f"'{made.name}', whose gains it takes, cannot control it"))
            continue
        remark = candidate.remark if made else joined("; ", filter(None, (candidate.remark, FIXED)))
        work.append(AtWork(candidate, made, remark, duty, rule, seed))
    judged = iter(engine.evaluate([case for case in work if isinstance(case, AtWork)], bar))
    rows = [next(judged) if isinstance(each, AtWork) else each for each in work]
    refusals += [row for row in rows if isinstance(row, Refusal)]
    competitors = tuple(row for row in rows if isinstance(row, Competitor))
    if all(each.move is None for each in competitors):
        reasons = joined("; ", [f"{row.name}: {row.unfit}" for row in competitors])
        raise UnstableError(f"{machine.file.name}: axis '{name}': no law can be run on it: {reasons}")
    remarks = (*_outside(competitors), *_against(competitors), *_noisy(competitors), *_unproven(competitors))
    return Comparison(
        machine,
        name,
        duty,
        rule.velocity,
        seed,
        rule.sentence,
        competitors,
        tuple(refusals),
        remarks,
        versions(),
    )


def _wanted(loop: Loop, laws: Sequence[str | type[Law]] | None) -> tuple[tuple[Candidate, ...], tuple[Refusal, ...]]:
    """The laws by name, plain P-PI and those whose gains they take over always among them."""
    own = tuple(law for law in laws or () if not isinstance(law, str))
    possible, refused = candidates(loop, own)
    if laws is None:
        return possible, refused
    names = [each.name for each in (*possible, *refused)]
    mine = {each.name for each in possible if type(each.loop.control.law) in own and "+" not in each.name}
    mine |= {law.title or law.kind.replace("_", " ") for law in own}
    laws = [*(law for law in laws if isinstance(law, str)), *(name for name in names if name in mine)]
    for law in laws:
        if law not in names:
            raise ParameterError(f"law '{law}' is not known here; there are: {', '.join(names)}")
    needed = {PLAIN, *laws, *(each.like for each in possible if each.name in laws)}
    return (
        tuple(each for each in possible if each.name in needed),
        tuple(each for each in refused if each.name in needed),
    )


def _outside(rows: tuple[Competitor, ...]) -> list[str]:
    """Rows that are not at equal robustness, today's gains first."""
    today = rows[0]
    said: list[str] = []
    if today.unfit:
        said.append(Text(f"'{today.name}': {today.unfit}; the row stays without figures."))
    elif today.figures.get(SENSITIVITY_PEAK.key) is None:
        period = today.loop.control.law.period()
        said.append(f"'{today.name}' repeats itself every {period} samples: it has no margins.")
    elif not today.outside:
        said.append(f"'{today.name}' keep the rule.")
    return said + [
        Text(
            f"'{row.name}': outside of the rule ({row.outside}): the figures are not at equal robustness, and not "
            "ranked."
        )
        for row in rows
        if row.outside and not row.unfit
    ]


def _against(rows: tuple[Competitor, ...]) -> list[str]:
    """Where each law loses to plain P-PI under the same rule, and where it wins."""
    plain = next((row for row in rows if row.name == PLAIN and not row.unfit), None)
    if plain is None:
        return []
    said: list[str] = []
    for row in rows[1:]:
        if row is plain or row.unfit:
            continue
        wins, losses = [], []
        for criterion in CRITERIA:
            ours, theirs = row.figures.get(criterion.key), plain.figures.get(criterion.key)
            if ours is None or theirs is None:
                continue
            text = f"{criterion.title} ({_ratio(ours, theirs)})"
            if beats(criterion, theirs, ours):
                losses.append(text)
            elif beats(criterion, ours, theirs):
                wins.append(text)
        lost, won = joined(", ", losses) or "nothing", joined(", ", wins) or "nothing"
        said.append(Text(f"'{row.name}' loses to P-PI in {lost}; wins in {won}."))
    return said


def _ratio(a: float, b: float) -> str:
    if np.isinf(a) or np.isinf(b):
        return "never" if np.isinf(a) else "P-PI never"
    return f"× {number(a / b, 3)}" if b else f"{number(a, 3)} against 0"


def _noisy(rows: tuple[Competitor, ...]) -> list[str]:
    """Competitors whose force noise is too large for practical use, independent of their margins."""
    said: list[str] = []
    for row in rows:
        limit, noise = row.loop.control.force_limit, row.figures.get(FORCE_NOISE.key)
        if limit is not None and noise is not None and noise > _NOISY * limit:
            said.append(
                Text(
                    f"'{row.name}': counts and noise of the encoders alone make {Quantity(noise, 'N'):3} RMS of force, "
                    f"{Quantity(noise / limit, 'share'):3} of the limit: a finer encoder, a low-pass or lower gains "
                    "come first."
                )
            )
    return said


def _unproven(rows: tuple[Competitor, ...]) -> list[str]:
    """What of a tuning is not proven."""
    said: list[str] = []
    for row in rows:
        if row.tuned is None:
            continue
        open_lines = [f"{line.what} ({line.said})" for line in row.tuned.proof if line.holds is not True]
        if open_lines:
            said.append(Text(f"'{row.name}': not proven: {joined('; ', open_lines)}."))
        if not row.settled:
            said.append(
                Text(
                    f"'{row.name}' is not settled, and not ranked: {row.tuned.unsettled}; more starts (--starts) may "
                    "find a better setting."
                )
            )
    return said

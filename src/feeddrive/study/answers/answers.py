"""The answers of a study, computed in one pass over its rows, with the memory of one chunk and a sample.

    answers = answers_of(store, study)
    print(*answers.sentences)
    write_report(answers, "out")

Yields, worst cases and fronts are exact over all rows.  Distributions, rank correlations and bands come from a random
sample if there are more than 200,000 rows; Sobol indices take 8 bytes per variant and figure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from feeddrive.language.errors import ParameterError
from feeddrive.language.progress import Progress
from feeddrive.language.table import Cell, Column, Result, Table, chart_of
from feeddrive.plot.chart import Chart
from feeddrive.study.answers.rows import Judged, Sampled, parts
from feeddrive.study.answers.sentences import bound_text, interval_text, sentences
from feeddrive.study.answers.statistics import (
    Band,
    Front,
    FrontKept,
    RankCorrelation,
    SaltelliRows,
    SobolIndices,
    Worst,
    WorstKept,
    Yield,
    YieldCount,
    error_band,
    rank_correlations,
    stiffness_band,
)
from feeddrive.study.store import Store
from feeddrive.study.study import Study

if TYPE_CHECKING:
    import pyarrow


@dataclass(frozen=True, eq=False, repr=False)
class Answers(Result):
    """The answers of a study.

    sample        rows of randomly drawn machines, for distributions
    worst         the worst variants by figure
    bad           numbers and reasons of the first variants without figures
    sobol         an entry per figure, for the sampler saltelli
    correlations  rank correlations with the varied numbers
    stiffness     over frequency, if at least three figures stiffness_F_Hz_N_per_m are measured
    error         following error over time, of machines that were simulated again
    """

    study: Study
    sample: Judged
    yields: Yield
    worst: tuple[Worst, ...]
    bad: tuple[tuple[int, str], ...]
    sobol: tuple[SobolIndices, ...]
    correlations: tuple[RankCorrelation, ...]
    front: Front | None
    stiffness: Band | None
    error: Band | None

    @property
    def rotary(self) -> bool:
        """True if the axis of the study is rotary."""
        return self.study.rotary

    @property
    def quoted(self) -> Sequence[str]:
        """The user's texts: the title, and the names of the choices and varied numbers."""
        return self.study.title, *self.study.columns, *(varied.name for varied in self.study.vary)

    @cached_property
    def sentences(self) -> list[str]:
        """The answers as sentences, most important first."""
        return sentences(self.study, self.yields, self.sobol, self.correlations)

    def table(self) -> Table:
        """Tabulate the yield of each bound, and of all bounds together."""
        rows: list[list[Cell]] = [
            [bound_text(bound_yield.bound), bound_yield.kept.kept, interval_text(bound_yield.kept), bound_yield.alone]
            for bound_yield in self.yields.bounds
        ]
        inside = self.yields.inside
        whole = "all of them" if rows else "with figures"
        rows.append([whole, inside.kept, interval_text(inside), None])
        return Table(
            f"{self.study.title}: yield of {inside.of:,} machines",
            ["kept", Column("machines", "", ",.0f"), "share (95 % interval)", Column("break only this", "", ",.0f")],
            rows,
        )


@chart_of.register
def _chart(answers: Answers) -> Chart:
    from feeddrive.study.answers import pictures

    return pictures.histograms_chart(answers.sample, answers.stiffness is not None)


def answers_of(rows: Store | pyarrow.Table, study: Study, progress: Progress | None = None) -> Answers:
    """Return the answers for the rows of a complete sweep, in a store or as a table.

    Simulates up to 128 machines again for the band of their following error over time.

    Raises ParameterError for rows of another study, FileError for a store that cannot be read.
    """
    progress = progress or Progress()
    counted, worst, front, sampled = YieldCount(study), WorstKept(study), FrontKept(study), Sampled(study)
    saltelli = SaltelliRows(study)
    seen = 0
    for part in parts(rows, study):
        progress.step("answers", seen, study.count)
        for collector in (counted, worst, front, sampled, saltelli):
            collector.add(part)
        seen += part.variant.size
    if seen != study.count:
        raise ParameterError(f"{study.file.name} has {study.count:,} variants, and here are rows of {seen:,}")
    sample = sampled.result()
    progress.step("sensitivity")
    return Answers(
        study=study,
        sample=sample,
        yields=counted.result(),
        worst=worst.result(),
        bad=tuple(worst.bad),
        sobol=saltelli.result(),
        correlations=rank_correlations(sample),
        front=front.result(),
        stiffness=stiffness_band(sample),
        error=error_band(sample, progress),
    )

"""`feeddrive sweep`: run all variants of a study, on the cores of this computer or on a Dask cluster.

manifest.json                 the study as given, digest, version of feeddrive
rows/chunk_00000000.parquet   one row per variant: the varied values, and figures in SI units or why there are none
report.html                   yield, worst cases, main factors, bands and the Pareto front; summary.json: the same in SI
                              units
worst/variant_00000012.toml   the worst machine for a figure, as a job to run again
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

from feeddrive.language.errors import CancelledError, ParameterError
from feeddrive.language.judgment import Judgment
from feeddrive.language.progress import Progress
from feeddrive.study.answers import answers_of
from feeddrive.study.page import study_report, write_report
from feeddrive.study.study import StudyLike
from feeddrive.study.sweep import Sweep
from feeddrive.study.sweep import sweep as run_sweep
from feeddrive.workflow.command import Outcome, argument, command, option, stem
from feeddrive.workflow.evaluated import EvaluationRequest


class SweepRequest(EvaluationRequest):
    """The study, the workers or the cluster that run it, and the output of its rows."""

    study: StudyLike = argument("A study file (TOML), or the name of a bundled study")
    out: str | Path | None = option(
        "Directory of the rows, or an address of fsspec, as s3://bucket/mill", short="-o", default=None
    )
    allow: tuple[str, ...] = option(
        "A module with figures of your own, whose code is then run; may be repeated", default=()
    )

    def usual_out(self) -> Path:
        return Path("results") / f"sweep_{stem(self.study)}"


@command(SweepRequest)
def sweep(request: SweepRequest, progress: Progress) -> Outcome[Sweep]:
    """Run all variants of a study on the cores of this computer, or on a Dask cluster.

    Finished chunks are kept if the sweep ends early, and `resume` computes the rest.  Raises ParameterError if no
    output for the rows is named, and the errors of `feeddrive.study.sweep`.
    """
    if request.out is None:
        raise ParameterError("out: a sweep needs a place for its rows: a directory, or an address of fsspec")
    swept = run_sweep(
        request.study,
        request.out,
        workers=request.workers,
        resume=request.resume,
        scheduler=request.scheduler,
        certificates=request.certificates,
        allow=request.allow,
        progress=progress,
    )
    try:
        told = answers_of(swept.store, swept.study, progress)
        progress.step("report")
        files = {"Report": write_report(told, request.out), "Rows": swept.store.address}
    # the rows are complete by now: only the report is missing, which --resume makes without a run
    except (CancelledError, KeyboardInterrupt):
        raise CancelledError(f"stopped; all rows are in {swept.store.address}: --resume makes the report") from None
    bad = swept.bad
    judgment = Judgment.NO_FIGURES if bad[0] == swept.study.count else Judgment.SWEPT
    return Outcome(
        swept,
        [swept.table(), told.table()],
        [*told.sentences, *_bad(*bad)],
        files=files,
        judgment=judgment,
        failure=judgment.says if judgment.bad else "",
        page=partial(study_report, told),
    )


def _bad(count: int, first: Sequence[tuple[int, str]]) -> Iterator[str]:
    """Yield sentences that name the first variants whose figures could not be computed, and the reasons."""
    for variant, reason in first:
        yield f"variant {variant} has no figures: {reason}"
    if count > len(first):
        yield f"{count - len(first):,} more have none: the column 'reason' of the rows says why"

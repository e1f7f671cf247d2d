"""`feeddrive run` and `feeddrive demo`: the laws of a job over the same work."""

from __future__ import annotations

from pathlib import Path

from feeddrive.files.job import Job, read_job
from feeddrive.language.progress import Progress
from feeddrive.workflow import jobs
from feeddrive.workflow.command import Outcome, command
from feeddrive.workflow.job_results import write_results
from feeddrive.workflow.jobs import JobResult
from feeddrive.workflow.request import OUT, Request, argument, option


class RunRequest(Request):
    """Which job is run, on which log."""

    job: str | Path | Job = argument("A job file (TOML), or the name of a bundled job")
    log: Path | None = option("A measured log (MAT, CSV, Parquet) in place of the one that the job names", default=None)
    out: Path | None = option(OUT, short="-o", default=None)

    def usual_out(self) -> Path:
        """By the name of what it is about."""
        return Path("results") / Path(self.job.file.name if isinstance(self.job, Job) else self.job).stem


class DemoRequest(Request):
    """Where the results of the demo go."""

    out: Path | None = option(OUT, short="-o", default=None)

    def usual_out(self) -> Path:
        """By the name of what it is about."""
        return Path("results") / "demo"


@command(RunRequest)
def run(request: RunRequest, progress: Progress) -> Outcome[JobResult]:
    """Run the laws of a job over the same work; report, summary and signals go into a directory, if one is named.

    Raises UnstableError for a law whose loop is not stable, DivergedError for one whose run leaves its bounds, and
    LogError for a log that does not fit the job.
    """
    job = request.job if isinstance(request.job, Job) else read_job(request.job, request.log)
    step = progress.counted(len(job.loops) + 1)
    found = jobs.run(job, step)
    files: dict[str, Path] = {}
    if request.out is not None:
        step("report")
        files["Report"] = write_results(found, request.out)
    return Outcome(found, [found.table()], [each for each in (job.rule, *found.remarks) if each], files=files)


@command(DemoRequest)
def demo(request: DemoRequest, progress: Progress) -> Outcome[JobResult]:
    """Run the bundled example: a real ball-screw axis under today's control and under three better ones."""
    return run.run(RunRequest("emps", out=request.out), progress)

"""`feeddrive run`, `demo` and `cosimulate`: simulate the laws of a job.

report.html          the report
summary.json         every figure in SI units, by law; versions, seed, digest of the log
runs/LAW.parquet     all signals over time, with units
runs/LAW.csv         the same as text, for runs of up to 100,000 rows
measured.parquet     the measured channels, for a job with a log
job.toml             a copy of the job, next to its machine and part program; to repeat the run: feeddrive run job.toml
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from feeddrive.cosimulation.simulate_with_fmu import Cosimulation, write_cosimulation
from feeddrive.cosimulation.simulate_with_fmu import cosimulate as run_against
from feeddrive.evaluation.engine import MOST_WORKERS, Engine
from feeddrive.files.atomic_io import new_directory
from feeddrive.files.job import Job, JobLike, read_job
from feeddrive.files.log import write_log
from feeddrive.files.part_program import FILES
from feeddrive.files.run_files import file_names, summary_text, write_run_csv, write_run_parquet
from feeddrive.files.toml_file import TomlEdit
from feeddrive.jobs.run_laws import JobResult, job_report, numbers, run_laws
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.language.judgment import Judgment
from feeddrive.language.progress import Progress
from feeddrive.report.laws import Entry
from feeddrive.report.page import html
from feeddrive.workflow.command import OUT, Outcome, Request, argument, command, line, option, stem
from feeddrive.workflow.evaluated import EngineRequest

_TEXT = 100_000  # rows: longer runs are not written as text


class RunRequest(EngineRequest):
    """The job to run, its log, and the number of laws to run in parallel."""

    job: JobLike = argument("A job file (TOML), or the name of a bundled job")
    log: Path | None = option("A measured log (MAT, CSV, Parquet) in place of the one that the job names", default=None)
    out: Path | None = option(OUT, short="-o", default=None)
    workers: int | None = option(
        "number of laws that run side by side, in processes of their own; default: one after the other",
        default=None,
        least=1,
        most=MOST_WORKERS,
        last=True,
    )

    def usual_out(self) -> Path:
        return Path("results") / stem(self.job)


DEMOS = {"axis": "emps", "mill": "circle_diamond_square"}
"""The bundled job of each demo, by name."""


class DemoRequest(Request):
    """The demo, and its output directory."""

    what: str = argument("The demo to run", default="axis", options=tuple(DEMOS))
    out: Path | None = option(OUT, short="-o", default=None)

    def usual_out(self) -> Path:
        return Path("results") / ("demo" if self.what == "axis" else f"demo_{self.what}")


@command(RunRequest)
def run(request: RunRequest, progress: Progress) -> Outcome[JobResult]:
    """Run the laws of a job on the same task; write report, summary and signals if an output directory is named.

    Raises UnstableError for a law with an unstable loop, DivergedError for one whose run diverges, and LogError for a
    log that does not match the job.
    """
    progress.step("reading the job")
    job = read_job(request.job, request.log)
    # starting processes takes a second, longer than most jobs
    workers = 1 if request.workers is None and request.scheduler is None else request.workers
    result = run_laws(job, progress, Engine.of(workers, request.scheduler, certificates=request.certificates))
    files: dict[str, Path] = {}
    if request.out is not None:
        progress.step("report")
        files["Report"] = write_results(result, request.out)
    tables = [result.table(), *([] if (others := result.others()) is None else [others])]
    # a run that ended in the safe force has figures, but they are not those of the motion
    judgment = Judgment.TRIPPED if any(_tripped(job, row) for row in result.rows) else Judgment.RAN
    remarks = [remark for remark in (job.rule, *result.remarks) if remark]
    # the copy of the machine beside the report
    there = request.out is not None and not judgment.bad
    then = line("tune", Path(request.out) / "machine.toml", axis=job.axis) if there and request.out is not None else ""
    return Outcome(
        result,
        tables,
        remarks,
        files=files,
        judgment=judgment,
        failure=judgment.says if judgment.bad else "",
        page=partial(job_report, result),
        then=then,
    )


def _tripped(job: Job, row: Entry) -> bool:
    """Return True if a guard tripped in the run of a law, on any of its axes."""
    axes = () if row.together is None else job.machines[row.name].axes()
    runs = [row.run, *(row.together.axis(name) for name in axes if row.together is not None)]
    return any(np.any(run["trip"] > 0.0) for run in runs)


@command(DemoRequest)
def demo(request: DemoRequest, progress: Progress) -> Outcome[JobResult]:
    """Run a bundled example: a ball-screw axis under today's controller and three better ones, or a milling cut."""
    # a demo ends with the report to open
    return replace(run.run(RunRequest(DEMOS[request.what], out=request.out), progress), then="")


def write_results(result: JobResult, out: str | Path) -> Path:
    """Write the directory of results atomically, and return the path of the report.

    Raises FileError if `out` cannot be written, or is a directory that feeddrive did not write.
    """
    page = html(job_report(result))
    figures = summary_text(summary(result), rotary=result.rotary, quoted=result.quoted)
    with new_directory(out) as folder:
        (folder / "report.html").write_text(page, encoding="utf-8")
        (folder / "summary.json").write_text(figures, encoding="utf-8")
        (folder / "job.toml").write_text(repeatable(result), encoding="utf-8")
        (folder / "machine.toml").write_text(result.job.machine.file.text, encoding="utf-8")
        if (program := program_of(result)) is not None:
            # byte for byte: line ends and encoding of the program stay as they are
            (folder / program.name).write_bytes(program.read_bytes())
        runs = folder / "runs"
        runs.mkdir()
        for name, row in zip(file_names(result.rows), result.rows, strict=True):
            metadata = {"law": row.name, "seed": result.job.seed, **result.versions}
            run = row.run if row.together is None else row.together
            write_run_parquet(runs / f"{name}.parquet", run.time, run.signals, run.units, run.sample_time, metadata)
            if run.samples <= _TEXT:
                write_run_csv(runs / f"{name}.csv", run.time, run.signals, run.units)
        if result.log is not None:
            write_log(folder / "measured.parquet", result.log)
    return Path(out) / "report.html"


def program_of(result: JobResult) -> Path | None:
    """Return the path of the part program, which is copied with the job; None if the job has none."""
    return None if result.job.program is None else result.job.program.file


def repeatable(result: JobResult) -> str:
    """Return the text of the job, in which machine and part program are the copies, and other files have full paths."""
    job = result.job
    edit, folder, program = TomlEdit(job.file.text, job.file.name), Path(job.file.name).parent, program_of(result)
    if edit.has(("machine",)):
        edit.set(("machine",), "machine.toml")
    if job.log is not None:
        # the log itself is not copied, so the copy of the job must find it from any folder
        edit.set(("log", "file"), str(job.log.path.resolve()))
    # relative names in a job count from its folder, and the copy stands in another one
    for name in FILES if job.program is not None else ():
        written = job.file.content["program"].get(name)
        if written is not None:
            copied = program.name if program is not None and name == "file" else None
            edit.set(("program", name), copied or str((folder / written).resolve()))
    return edit.text


def summary(result: JobResult) -> dict[str, Any]:
    """Return all figures as plain numbers for JSON; a figure that does not apply is None."""
    job = result.job
    figures: dict[str, Any] = {
        "title": job.title,
        "rule": job.rule,
        "machine": job.machine.name,
        "source": job.machine.source,
        "seed": job.seed,
        "velocity_of_the_linear_model_m_per_s": result.velocity,
        "versions": dict(result.versions),
        "remarks": list(result.remarks),
        "laws": {row.name: {**numbers(row), "control": _control(row)} for row in result.rows},
    }
    if job.program is not None and job.program.planned is not None:
        planned = job.program.planned
        figures["program"] = {
            "file": planned.program,
            "cycle_time_s": planned.cycle_time,
            "blocks": planned.blocks,
            "stops": planned.stop_count,
            "seconds_by_limit": dict(planned.seconds),
            "cuts": [cut._asdict() for cut in job.program.cuts],
            "chatter": [{**sign._asdict(), "cut": sign.cut.line} for sign in result.chatter],
        }
    if result.log is not None:
        figures["log"] = {key: result.log.provenance[key] for key in ("sha256", "format")}
        figures["log"]["rows"] = len(result.log)
    return figures


def _control(row: Entry) -> dict[str, float]:
    return {name: float(value) for name, value in tree.leaves(row.loop.control)}


class CosimulateRequest(Request):
    """The job, the FMU, and the roles of its variables."""

    job: JobLike = argument("A job file (TOML) with a reference, or the name of a bundled job")
    fmu: Path = argument("The plant: an FMU 2.0 or 3.0. It is a program, and it is run")
    variable: tuple[str, ...] = option(
        "Role of a variable of the FMU, as force=F_drive or reading=x:mm; may be repeated", default=()
    )
    set: tuple[str, ...] = option("A parameter of the FMU, as m=160; may be repeated", default=())
    dead_time: float = option("Dead time before a command acts", default=0.0, unit="s")
    out: Path | None = option(OUT, short="-o", default=None)

    def usual_out(self) -> Path:
        return Path("results") / f"cosimulate_{stem(self.job)}"


@command(CosimulateRequest)
def cosimulate(request: CosimulateRequest, progress: Progress) -> Outcome[Cosimulation]:
    """Run the laws of a job on an external model of the machine, an FMU in place of the plant."""
    job = read_job(request.job)
    values = {name: _number(name, text) for name, text in _pairs("--set", request.set).items()}
    cosimulation = run_against(
        job,
        request.fmu,
        names=_pairs("--variable", request.variable),
        parameters=values,
        dead_time=request.dead_time,
        progress=progress.counted(len(job.loops)),
    )
    files: dict[str, Path] = {}
    if request.out is not None:
        files["Signals"] = write_cosimulation(cosimulation, request.out).parent / "runs"
    remark = "No margins: an FMU states no linear model. `feeddrive run` gives those of the machine file."
    tripped = any(row.figures()["trip"] > 0.0 for row in cosimulation.rows)
    judgment = Judgment.TRIPPED if tripped else Judgment.RAN
    return Outcome(
        cosimulation,
        [cosimulation.table()],
        [remark],
        files=files,
        judgment=judgment,
        failure=judgment.says if tripped else "",
    )


def _pairs(option: str, texts: Sequence[str]) -> dict[str, str]:
    pairs: dict[str, str] = {}
    for text in texts:
        name, mark, value = text.partition("=")
        if not (mark and name and value) or name in pairs:
            raise ParameterError(f"{option} {text}: give each name once, as name=value")
        pairs[name] = value
    return pairs


def _number(name: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ParameterError(f"--set {name}={text}: '{text}' is no number") from None

"""Execution of a job: every law is simulated with the same motion and loads, and analyzed for margins and stiffness."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from feeddrive.analysis.contour_control import matched_dynamics
from feeddrive.analysis.effort import fastest_mode, substeps_needed
from feeddrive.analysis.replay import replay
from feeddrive.analysis.stability import require_stable
from feeddrive.blocks.coupling.milling_cut import MillingCut
from feeddrive.blocks.reference.linear_move import LinearMove
from feeddrive.evaluation.case import Case
from feeddrive.evaluation.engine import Bar, Engine
from feeddrive.files.job import Job, Other
from feeddrive.files.log import Log
from feeddrive.files.run_files import versions
from feeddrive.jobs.along_program import (
    Chatter,
    Listening,
    along_program,
    chatter,
    chatter_remarks,
    cut_sentence,
    cut_table,
    listening,
    out_of_the_work,
)
from feeddrive.jobs.measured import load_text, measured_signals, of_channels, of_injected, placed, without_answer
from feeddrive.language.errors import FeeddriveError, NoSlopeError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Cell, Column, Result, Table, chart_of, frame_of
from feeddrive.language.text import Text, joined
from feeddrive.loop.linearize import MOST, compliance, loop_gain, period_of, tracking
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine, System
from feeddrive.loop.simulate import Run, samples, simulate
from feeddrive.machining.part_run import PartRun
from feeddrive.plot.chart import Chart
from feeddrive.report.laws import Entry, LawsContents, block_sentence, described, facts_of, response_lines
from feeddrive.report.laws_report import laws_report
from feeddrive.report.machining_report import laws_table
from feeddrive.report.report import Report

# figures of the table of laws, in the order of its columns
_FIGURES = (
    "following_error_rms_m",
    "following_error_peak_m",
    "force_peak_N",
    "phase_margin_deg",
    "sensitivity_peak",
    "stiffness_least_N_per_m",
)


@dataclass(frozen=True, eq=False, repr=False)
class JobResult(Result):
    """The result of a job: all rows, with the existing controller first, and remarks.

    Margins and stiffness are computed for the axis sliding at `velocity` in m/s.
    """

    job: Job
    rows: tuple[Entry, ...]
    log: Log | None
    velocity: float
    remarks: tuple[str, ...]
    versions: Mapping[str, str]
    chatter: tuple[Chatter, ...] = ()

    @property
    def rotary(self) -> bool:
        """True if the axis of the rows is rotary."""
        return self.rows[0].loop.axis.rotary

    @property
    def quoted(self) -> tuple[str, ...]:
        """The user-defined strings in the job file and the machine file, such as titles and names."""
        return self.job.title, self.job.rule, *self.job.machine.quoted, *(row.name for row in self.rows)

    def table(self) -> Table:
        """Return a table of error, force, margins and least dynamic stiffness by law.

        For a part program, the table contains the contour figures instead.
        """
        if self.parts:
            return laws_table(self.job.title, self.parts)
        columns = [
            Column("law"),
            Column("RMS", "m"),
            Column("peak", "m"),
            Column("force", "N"),
            Column("PM", "deg", ".1f"),
            Column("Ms", form=".2f"),
            Column("stiffness", "N/m", "3"),
        ]
        lines: list[list[Cell]] = []
        for row in self.rows:
            figures = numbers(row)
            lines.append([row.name, *(figures.get(key) for key in _FIGURES)])
            if row.replay is not None:
                off = (figures["position_residual_rms_m"], figures["position_residual_peak_m"])
                lines.append(["  predicted - measured", *off, *[None] * 4])
        return Table(self.job.title, columns, lines)

    def contents(self) -> LawsContents:
        """Return the contents of the report."""
        job = self.job
        work = {"Work": _work(job, self.log), "Load": load_text(job, self.log), **_couplings(job)}
        work["Noise"] = f"seed {job.seed}"
        return LawsContents(
            title=job.title,
            entries=self.rows,
            facts=facts_of(job.machine, job.machine.name, self.rows[0].loop, self.velocity, work),
            rule=job.rule,
            job=job.file.text,
            versions=self.versions,
            notes=self.remarks,
            extras=[] if self.parts or (others := self.others()) is None else [others],
            planned=None if job.program is None else job.program.planned,
            cuts=cut_table(job, self.rows[0], self.chatter),
        )

    @property
    def parts(self) -> dict[str, PartRun]:
        """The figures along the part program by law; empty for a job without a program."""
        return {row.name: row.part for row in self.rows if row.part is not None}

    def others(self) -> Table | None:
        """Return a table of the errors and forces of the axes that are not compared, or None if there are none."""
        rows: list[list[Cell]] = []
        for row in self.rows:
            if row.together is None or row.part is not None:
                continue
            for axis in self.job.machines[row.name].axes():
                if axis == row.loop.name:
                    continue
                run = row.together.axis(axis)
                error, force = run["following_error"], run["force"]
                tripped = run.time[run["trip"] > 0.0]
                figures = float(np.sqrt(np.mean(error**2))), float(np.max(np.abs(error))), float(np.max(np.abs(force)))
                rows.append([row.name, axis, *figures, float(tripped[0]) if tripped.size else None])
        columns = [
            Column("law"),
            Column("axis"),
            Column("RMS", "m"),
            Column("peak", "m"),
            Column("force", "N"),
            Column("trips at", "s", "SI"),
        ]
        title = "The other axes in the same runs: following error and force"
        return Table(title, columns, rows) if rows else None


def job_report(result: JobResult) -> Report:
    """Return the report of a finished job."""
    return laws_report(result.contents())


@chart_of.register
def _chart(result: JobResult) -> Chart:
    """Return a chart of the following error and force of all laws."""
    # imported here: only a result that is drawn needs the plotting modules
    from feeddrive.plot.over_time import comparison_chart

    return comparison_chart({row.name: row.run for row in result.rows})


@frame_of.register
def _frame(result: JobResult) -> Any:
    """Return a data frame with one row per law, in SI units."""
    from feeddrive.plot import frames

    return frames.laws([row.name for row in result.rows], [numbers(row) for row in result.rows])


def numbers(row: Entry) -> dict[str, float | None]:
    """Return the figures of a row in SI units, by the names under which they are written to files."""
    figures: dict[str, float | None] = {
        "following_error_rms_m": row.rms("following_error"),
        "following_error_peak_m": row.peak("following_error"),
        "tracking_error_rms_m": row.rms("tracking_error"),
        "force_rms_N": row.rms("force"),
        "force_peak_N": row.peak("force"),
    }
    if row.margins is not None:
        figures |= {**row.margins.numbers(), "sensitivity_peak": row.margins.sensitivity_peak}
    if row.stiffness is not None:
        figures["stiffness_least_N_per_m"] = row.stiffness.minimum
        figures["stiffness_least_frequency_Hz"] = row.stiffness.minimum_frequency
    if row.part is not None:
        figures |= row.part.numbers()
    if row.replay is not None:
        figures["position_residual_rms_m"] = row.replay.rms("position_load")
        figures["position_residual_peak_m"] = float(np.max(np.abs(row.replay.residual("position_load"))))
        # a measured force of 0 throughout has no RMS to which a residual could be related
        if np.any(row.replay.measured.get("force", 0.0)):
            figures["force_residual_share"] = row.replay.share("force")
    return figures


@dataclass(frozen=True, eq=False)
class LawRun(Case[Entry]):
    """One law of a job: its analysis, and its run over the job's motion or along its log.

    law        name of its row in the job
    measured   signals of the log; None if there is no log with measured positions
    velocity   sliding speed at which the loop is linearized, m/s
    observers  disturbance observers to run along the simulation, for a job with cuts
    """

    kind: ClassVar[str] = "law_of_job"
    common: ClassVar[tuple[str, ...]] = ("job", "measured", "velocity", "observers")
    stages: ClassVar[int] = 3

    job: Job
    law: str
    measured: Mapping[str, np.ndarray] | None
    velocity: float
    observers: Listening

    @property
    def name(self) -> str:
        """The name of the law."""
        return self.law

    def outcome(self, progress: Progress) -> Entry:
        """Return the row of the law in the report; error messages name the job and the law.

        Raises UnstableError for an unstable loop and DivergedError for a run that leaves its bounds.
        """
        job, velocity, name = self.job, self.velocity, self.law
        # stability and margins apply to the axes in air: chatter in the cut has a separate verdict
        loop = job.loops[name]
        where = f"{job.file.name}: law '{name}'"
        progress.step("its linear model")
        whole: System = job.machines.get(name, loop)
        idle = out_of_the_work(job, whole)
        no_model = ""
        # a law without a linear model, such as one with a root at 0, is still simulated: only its margins are unknown
        try:
            require_stable(idle, velocity=velocity, where=where)
        except NoSlopeError as error:
            no_model = str(error)
        try:
            replayed, together = None, None
            progress.step("the run")
            if self.measured is not None:
                replayed = replay(loop, self.measured, skip=_skipped(job), name=name)
                run = replayed.run
            elif isinstance(whole, Machine):
                together = _together(job, whole, loop.name, name, progress)
                run = dataclasses.replace(together.axis(loop.name), name=name)
            else:
                run = _simulated(job, loop, name, progress)
            frequency = response_lines(loop)
            # a law of long period needs one linear model a sample of the period, and the cost grows with its square
            with_gain = not no_model and period_of(idle) <= MOST
            gain = loop_gain(idle, frequency, velocity=velocity, axis=loop.name) if with_gain else None
            if job.program is not None:
                progress.step("its path")
            return Entry(
                name=name,
                description=described(loop.control),
                run=run,
                loop=loop,
                loop_gain=gain,
                compliance=None if no_model else compliance(idle, frequency, velocity=velocity, axis=loop.name),
                tracking=None if no_model else tracking(idle, frequency, velocity=velocity, axis=loop.name),
                no_model=no_model,
                replay=replayed,
                together=together,
                part=None
                if together is None or not isinstance(whole, Machine)
                else along_program(job, whole, together, self.observers),
            )
        except FeeddriveError as error:
            # the class is kept, since it decides the exit code of the command
            raise type(error)(f"{where}: {error}") from None


def run_laws(job: Job, progress: Progress | None = None, engine: Engine | None = None) -> JobResult:
    """Run all laws of a job on an engine (default: in this process). `progress` reports the stages of each law.

    Raises UnstableError for a law with an unstable loop, DivergedError for a law whose run leaves its bounds, and
    LogError for a log that does not fit the job.
    """
    log = None if job.log is None else job.log.read()
    remarks: list[str] = [] if log is None else of_channels(job, log)
    measured = None
    if log is not None and "position_load" in log.channels:
        # all laws of a job control one axis at one sample time, so that the first loop stands for all
        measured, words = placed(next(iter(job.loops.values())), measured_signals(job, log), _skipped(job))
        remarks += words
    elif log is not None:
        job = without_answer(job, log)
    velocity = _velocity(job, measured, next(iter(job.loops.values())).sample_time)
    observers = listening(job)
    cases = [LawRun(job, name, measured, velocity, observers) for name in job.loops]
    bar = Bar(progress or Progress(), LawRun.stages * len(cases) + int(bool(observers)))
    rows = (engine or Engine()).evaluate(cases, bar)
    # a row from another process holds a copy of its loop: the equal loop of the job replaces it and is shared
    rows = [dataclasses.replace(row, loop=job.loops[row.name]) for row in rows]
    if measured is not None and rows[0].replay is not None:
        remarks += of_injected(rows[0].loop, measured, rows[0].replay)
    if observers:
        bar.step("chatter")
    verdicts = chatter(job, rows)
    remarks += [*chatter_remarks(verdicts), *_matched(job), *_remarks(rows)]
    return JobResult(job, tuple(rows), log, velocity, tuple(remarks), versions(), verdicts)


def _skipped(job: Job) -> int:
    return job.log.skip_samples if job.log else 0


def _matched(job: Job) -> list[str]:
    """Return remarks on the contour error due to mismatched axes; none if the axes match or have no linear model."""
    machine = next(iter(job.machines.values()), None)
    if machine is None or job.program is None or len(job.program.references) < 2:
        return []
    try:
        # the lag of an angle and that of a length make no angle of a line
        linear = job.program.kinematics is not None
        return list(matched_dynamics(machine, None if linear else tuple(job.program.references)).remarks())
    except FeeddriveError:
        # a machine without a linear model already has a remark under its law
        return []


def _simulated(job: Job, loop: Loop, name: str, progress: Progress) -> Run:
    assert job.reference is not None
    return simulate(
        loop, job.reference, load=job.load, duration=job.duration, seed=job.seed, name=name, progress=progress
    )


def _together(job: Job, machine: Machine, axis: str, name: str, progress: Progress) -> Run:
    """Simulate all axes together: the compared one with the job's reference, the others with theirs or at rest."""
    assert job.reference is not None
    moving = {axis: Other(reference=job.reference, load=job.load), **job.others}
    # a reference of one row lasts 0 s, and a travel time must be > 0
    still = LinearMove(distance=0.0, travel_time=max(job.reference.duration, machine.sample_time))
    references = dict.fromkeys(machine.axes(), still)
    references |= {other: motion for other, of in moving.items() if (motion := of.reference) and other in references}
    loads = {other: load for other, of in moving.items() if (load := of.load) is not None}
    return simulate(
        machine, references, load=loads or None, duration=job.duration, seed=job.seed, name=name, progress=progress
    )


def _velocity(job: Job, measured: Mapping[str, np.ndarray] | None, T: float) -> float:
    """Return half of the highest set speed, in m/s, or 0.01 m/s for a reference without motion.

    On a five-axis machine it is that of the tip: one of its joints may stand throughout, and friction would hold it.
    """
    reference, program = job.reference, job.program
    if measured is not None:
        largest = float(np.max(np.abs(np.diff(measured["set_position"])), initial=0.0)) / T
    elif program is not None and program.kinematics is not None and program.planned is not None:
        largest = float(np.max(program.planned.course.speed, initial=0.0))
    else:
        assert reference is not None
        # the peak is an operating point of the linear model only: 2001 instants suffice for a program of any length
        some = np.unique(np.linspace(0, samples(reference.duration, T) - 1, 2001).astype(np.int64)) * T
        largest = float(np.max(np.abs(reference.at(some).velocity)))
    # half of the top speed, and never 0, since at rest Coulomb friction would hold the axis in the linear model
    return 0.5 * largest if largest > 0.0 else 0.01


def _remarks(rows: list[Entry]) -> list[str]:
    """Return remarks on trips, active force limits, too few substeps and unknown margins.

    They also list the figures of each law that are more than 1 % worse than those of the existing controller.
    """
    remarks: list[str] = []
    needed, used = substeps_needed(rows[0].loop), rows[0].loop.axis.substeps
    if used < needed:
        remarks.append(
            Text(
                f"The fastest mode of the axis, {Quantity(fastest_mode(rows[0].loop), 'Hz')}, is too fast for friction "
                f"in {used} substep(s) a sample: set substeps = {needed}."
            )
        )
    for row in rows:
        tripped = np.flatnonzero(row.run["trip"] > 0.0)
        if tripped.size:
            remarks.append(
                Text(
                    f"'{row.name}': the guard tripped at {Quantity(row.run.time[tripped[0]], 's'):SI}, no force after "
                    "it."
                )
            )
        # below the limit the requested force is passed on bit by bit, so that an exact comparison is right
        held = float(np.mean(row.run["force"] != row.run["requested"]))
        if held > 0.0:
            remarks.append(
                Text(f"'{row.name}': the force was at its limit for {Quantity(held, 'share'):3} of the samples.")
            )
        if row.no_model:
            remarks.append(Text(f"'{row.name}': no margins, and that it is stable is not proven: {row.no_model}."))
        elif row.loop_gain is None:
            remarks.append(
                f"'{row.name}' repeats itself every {row.loop.control.law.period()} samples: margins are known up to "
                f"{MOST}."
            )
    today = numbers(rows[0])
    for row in rows[1:]:
        now = numbers(row)
        worse = [
            Text(f"{text} {_ratio(now.get(key), today.get(key))}")
            for key, text in (
                ("following_error_rms_m", "RMS error"),
                ("following_error_peak_m", "peak error"),
                ("force_peak_N", "peak force"),
                ("sensitivity_peak", "Ms"),
            )
            if _above(now.get(key), today.get(key))
        ]
        if _above(today.get("stiffness_least_N_per_m"), now.get("stiffness_least_N_per_m")):
            ratio = _ratio(now["stiffness_least_N_per_m"], today["stiffness_least_N_per_m"])
            worse.append(Text(f"least stiffness {ratio}"))
        if worse:
            remarks.append(Text(f"'{row.name}' is worse than today in: {joined(', ', worse)}."))
    return remarks


def _above(a: float | None, b: float | None) -> bool:
    return a is not None and b is not None and a > 1.01 * b


def _ratio(a: float | None, b: float | None) -> str:
    return Text(f"x {Quantity(a / b):.2f}") if a is not None and b else ""


def _couplings(job: Job) -> dict[str, str]:
    """Return the entries of the report on couplings and other axes; empty for a job with a single axis."""
    if not job.machines:
        return {}
    moving = {axis: "stands" for axis in job.machine.loops if axis != job.axis}
    for axis, other in job.others.items():
        if other.reference:
            moving[axis] = "as the program says" if job.program else block_sentence(other.reference)
    couplings = next(iter(job.machines.values())).couplings
    cuts = [coupling for coupling in couplings if coupling not in job.machine.couplings]
    listed = [
        *map(block_sentence, job.machine.couplings),
        *(cut_sentence(cut) for cut in cuts if isinstance(cut, MillingCut)),
    ]
    return {
        "Couplings": joined("; ", listed or ["none"]),
        "Other axes": joined("; ", (f"{axis}: {text}" for axis, text in moving.items())),
    }


def _work(job: Job, log: Log | None) -> str:
    if log is not None:
        return f"the reference of {log.name}, {len(log)} samples, SHA-256 {log.provenance['sha256']}"
    assert job.reference is not None
    return block_sentence(job.reference) if job.program is None else job.program.description

"""`feeddrive setpath`: a part program, or the motion of one axis, corrected before it runs.

A job is corrected on all its axes, and judged on a box of machines.  Its directory holds

report.html         the path before and after, on the nominal and on the worst machine
setpath.json        every figure in SI units; contour_rms_m has plain, corrected, worst_plain and worst_corrected
correction.parquet  set motion and added force of every axis, sample by sample, in SI units; for --last and iterate
setpoints.csv       the same as text: set positions and force offsets
streamer.txt, setpoints.hal   positions in mm and force offsets in N for the streamer of LinuxCNC
cia402_AXIS.csv     with --drive: 0x607A in increments and 0x60B2 in thousandths of the rated torque

One axis of a machine has the inverse of its linear model: zero phase error, or fitted splines.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from feeddrive.blocks.families import Reference
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.bus.drive_file import DriveScaling, read_drive
from feeddrive.export.corrected_part import read_correction, write_correction
from feeddrive.files.atomic_io import check_directory, new_directory, write_whole
from feeddrive.files.columns import Column as LogColumn
from feeddrive.files.columns import unit_at_the_end
from feeddrive.files.job import Job, JobLike, job_of, read_job
from feeddrive.files.machine import BUNDLED, MachineFile, MachineLike, read_machine
from feeddrive.files.read_log import OpenedFile, read_log
from feeddrive.files.toml_file import read_toml
from feeddrive.language.errors import ParameterError, nearest
from feeddrive.language.judgment import Judgment
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column, Table
from feeddrive.language.text import Text
from feeddrive.learning.part_correction import (
    PATH_SHARE,
    RESERVE,
    SHARE,
    CorrectedProgram,
    Correction,
    Judge,
    PathFigures,
    correct_by_plan,
    correct_path_by_plan,
    judged,
    planned_rows,
)
from feeddrive.learning.part_log import LearnedPart, PartLog, learn_from_log
from feeddrive.learning.plant_box import EXAMPLE, PlantBox
from feeddrive.learning.set_path import ChangedReference, filtered_splines, zero_phase
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine
from feeddrive.loop.simulate import simulate
from feeddrive.path.limits import DERIVATIVES
from feeddrive.path.planned import Planned
from feeddrive.report.page import html
from feeddrive.report.report import Marked, Picture, Remarks, Report, Section, Verdict, facts
from feeddrive.version import __version__
from feeddrive.workflow.command import Outcome, Request, argument, called, command, line, option, stem
from feeddrive.workflow.learn import MOVE, job_reference

OF_JOB, OF_AXIS = ("force", "path"), ("zero-phase", "splines")
_ONLY_OF_JOB = ("law", "share", "box", "seed", "from_log", "last", "set_position", "position", "drive")
_ONLY_OF_AXIS = ("axis", "job", "window")


class SetpathRequest(Request):
    """The part program or the axis, and the method of its correction."""

    source: MachineLike | JobLike = argument(
        "A job file (TOML) or the name of a bundled job, whose axes are corrected together; or a machine file or the "
        "name of a bundled machine, for one axis"
    )
    law: str | None = option("row of the job whose control runs the part; default: the first, today's", default=None)
    method: str | None = option(
        "of a job: force, added to the command, or path, a change of the set path for drives that take no force;  of "
        "an axis: zero-phase, the inverse of the loop (Tomizuka), or splines, fitted answers (Okwudire)",
        default=None,
        options=(*OF_JOB, *OF_AXIS),
    )
    share: float | None = option(
        "share of the model's friction that is fed forward; default: 0.91 by force, 0.7 by path",
        default=None,
        least=0.0,
        most=1.0,
    )
    box: str | None = option(
        f"tolerances of the machine on which the correction is judged, or none; default: standard, which is {EXAMPLE}",
        default=None,
    )
    seed: int | None = option("seed of the noise of the judge; default: that of the job", default=None, least=0)
    from_log: Path | None = option("log of the last part, from which the next one is corrected", default=None)
    last: Path | None = option("directory of the correction that ran with the logged part", default=None)
    set_position: tuple[str, ...] = option(
        "column of a set position, as x=NAME:mm; default: x.set_position or x_set_position_mm; may be repeated",
        default=(),
    )
    position: tuple[str, ...] = option(
        "column of a measured position, as x=NAME:mm; default: x.reading_load or x_position_load_mm; may be repeated",
        default=(),
    )
    drive: tuple[str, ...] = option(
        "drive file of an axis, as x=drive.toml: writes 0x607A and 0x60B2 of CiA 402; may be repeated", default=()
    )
    axis: str | None = option("axis of a machine, if it has several", default=None)
    job: JobLike | None = option(
        "job whose reference the axis of a machine follows; default: 100 mm out and back", default=None
    )
    spacing: int = option("samples between the knots of --method splines", default=20, least=3, most=10_000)
    window: int | None = option("coefficients of --method splines that are known ahead; default: all", default=None)
    out: Path | None = option("Directory to write for a job; file (CSV) for an axis", short="-o", default=None)

    def check(self) -> None:
        """Raise ParameterError for a window with a method that does not use one."""
        if self.method != "splines" and self.window is not None:
            raise ParameterError(
                f"--window = {self.window} is for --method splines, not {self.method or OF_AXIS[0]}: leave it out"
            )

    @property
    def of_job(self) -> bool:
        """True if the axes of a job are corrected together, False for one axis of a machine."""
        if self.method is not None:
            return self.method in OF_JOB
        return _is_job(self.source)

    def usual_out(self) -> Path | None:
        return Path("results") / f"setpath_{stem(self.source)}" if self.of_job else None


def _is_job(source: MachineLike | JobLike) -> bool:
    """Return True for a job, or a file that names a machine; a bundled name of both kinds is a machine."""
    if isinstance(source, Job | MachineFile):
        return isinstance(source, Job)
    file = Path(source)
    if file.is_file():
        return "machine" in read_toml(file).content
    # an unknown name is that of a job, whose error lists the bundled ones
    return not file.suffix and not (BUNDLED / "machines" / f"{file.name}.toml").exists()


@command(SetpathRequest)
def setpath(request: SetpathRequest, progress: Progress) -> Outcome[CorrectedProgram | LearnedPart | ChangedReference]:
    """Correct a part program before it runs: dry friction along the plan, through the inverse of each loop.

    A correction is accepted only if no machine of a box around the model gets worse by it.  With --from-log the log of
    the last part corrects the next one.  For a machine in place of a job, the set path of one axis is changed by its
    linear model.
    """
    of_job = request.of_job
    for name in _ONLY_OF_AXIS if of_job else _ONLY_OF_JOB:
        if getattr(request, name) not in (None, ()):
            whom = "one axis of a machine" if of_job else "a job"
            raise ParameterError(
                f"--{name.replace('_', '-')} is for {whom}, and {called(request.source)} is "
                f"{'a job' if of_job else 'a machine'}: leave it out, or give {whom}"
            )
    if not of_job:
        return _one_axis(request, progress)
    if request.out is not None:
        check_directory(request.out)
    progress.step("reading the job")
    reserve = RESERVE if request.method == "path" else ()
    part = _part(request, reserve)
    if request.from_log is not None:
        return _from_log(request, part, progress)
    if request.last is not None:
        raise ParameterError("--last names the correction that ran with a logged part: give the log by --from-log")
    return _by_plan(request, part, progress)


@dataclass(frozen=True, eq=False)
class Part:
    """The work that is corrected: a job with one of its rows, the motions of its axes, and drives that get a file."""

    job: Job
    law: str
    machine: Machine
    plan: dict[str, Recorded]
    counted: np.ndarray | None
    line: np.ndarray | None
    drives: Mapping[str, DriveScaling]

    @property
    def planned(self) -> Planned | None:
        """The plan of the part program, if there is one."""
        return None if self.job.program is None else self.job.program.planned

    @property
    def kind(self) -> str:
        """The name of the machine and the row, for titles."""
        return f"{self.job.machine.name}, {self.law}"


def _part(request: SetpathRequest, reserve: Sequence[float]) -> Part:
    """Read the job, planned with a reserve of the limits if its path is to be changed."""
    source = request.source
    if isinstance(source, MachineFile):
        raise ParameterError(f"--method {request.method} is for a job, and {called(source)} is a machine: give a job")
    job = read_job(source)
    job.require_axes("setpath")
    if reserve:
        if job.program is None:
            raise ParameterError(
                f"{job.file.name}: --method path needs a part program, which is planned again with a reserve of its "
                "limits: take --method force"
            )
        job = job_of(job.file, Path(job.file.name), reserve=reserve)
    laws = list(job.loops)
    law = laws[0] if request.law is None else request.law
    if law not in laws:
        raise ParameterError(f"--law '{law}' is no row of {job.file.name}{nearest(law, laws)}")
    if job.reference is None:
        raise ParameterError(
            f"{job.file.name}: replays a log and plans no motion: give a job with [reference] or [program]"
        )
    machine = job.machines.get(law) or Machine.of({job.loops[law].name: job.loops[law]})
    named = {job.axis or job.loops[law].name: job.reference}
    named |= {axis: other.reference for axis, other in job.others.items() if other.reference is not None}
    T = float(machine.sample_time)
    plan = planned_rows(named, T)
    program = job.program
    counted = None if program is None else program.counted
    line = None if program is None else program.line
    # read before the work: a name that is wrong is refused at once
    return Part(job, law, machine, plan, counted, line, _drives(request, plan))


def _by_plan(request: SetpathRequest, part: Part, progress: Progress) -> Outcome[Any]:
    """Correct a part by its plan, judge it, and write it."""
    box = PlantBox.parse(request.box or "standard")
    progress.step("inverse of the loops")
    if request.method == "path":
        planned = part.planned
        if planned is None:
            raise ParameterError(
                f"{part.job.file.name}: its setpoints were recorded: --method path needs a part program"
            )
        kept = 1.0 - np.array(RESERVE)
        limits = {
            axis: row / kept
            for axis, row in zip(
                (letter.lower() for letter in planned.limits.letters), planned.limits.array, strict=True
            )
        }
        by_axis = {axis: limits[axis.lower()] for axis in part.plan if axis.lower() in limits}
        for axis, row in by_axis.items():
            for what, limit in zip(DERIVATIVES, row, strict=True):
                if not np.isfinite(limit):
                    raise ParameterError(
                        f"axis {axis} has no limit of the {what}, by which a changed path is proven: "
                        "give it one in the machine file, or take --method force"
                    )
        missing = [axis for axis in part.plan if axis not in by_axis]
        if missing:
            raise ParameterError(f"axis {', '.join(missing)} has no limits of its own: take --method force")
        share = PATH_SHARE if request.share is None else request.share
        correction = correct_path_by_plan(part.machine, part.plan, by_axis, dict.fromkeys(by_axis, kept), share=share)
    else:
        correction = correct_by_plan(part.machine, part.plan, share=SHARE if request.share is None else request.share)
    loads = {axis: other.load for axis, other in part.job.others.items() if other.load is not None}
    if part.job.load is not None:
        loads[part.job.axis or part.job.loops[part.law].name] = part.job.load
    judge = Judge(
        part.machine,
        part.plan,
        counted=part.counted,
        box=box,
        loads=loads or None,
        line=part.line,
        seed=part.job.seed if request.seed is None else request.seed,
        progress=progress,
    )
    remarks = _of_method(part, correction)
    result = judged(judge, correction, box, remarks)
    accepted = result.accepted > 0.0
    files: dict[str, Path] = {}
    page = partial(corrected_report, result, part.kind, _facts(part, result))
    if request.out is not None:
        progress.step("report")
        with new_directory(request.out) as folder:
            (folder / "report.html").write_text(html(page()), encoding="utf-8")
            (folder / "setpath.json").write_text(_json(_record(request, part, result)), encoding="utf-8")
            # a correction that the judge refuses must not reach a machine
            if accepted:
                write_correction(folder, result.correction, part.line, part.drives)
        files = {"Report": request.out / "report.html", "Figures": request.out / "setpath.json"}
        if accepted:
            files["Setpoints and force offsets"] = request.out / "setpoints.csv"
    judgment = Judgment.CORRECTED if accepted else Judgment.NOT_CORRECTED
    then = _next(request, part) if accepted and request.out is not None else ""
    return Outcome(
        result,
        [result.table()],
        result.remarks if accepted else [],
        verdict=_verdict(result) if accepted else "",
        notes=(*result.tried, *result.left),
        files=files,
        judgment=judgment,
        failure="" if accepted else _verdict(result),
        page=page,
        then=then,
    )


def _next(request: SetpathRequest, part: Part) -> str:
    """Return the command that learns from the log of the part that runs with this correction."""
    assert request.out is not None
    law = ("--law", part.law) if request.law is not None else ()
    after = request.out.with_name(f"{request.out.name}_next")
    log = ("--from-log", "part.csv", "--last", request.out, "--out", after)
    return line("setpath", called(request.source), *law, *log)


def _verdict(result: CorrectedProgram) -> str:
    if not result.accepted:
        return Text(f"{Judgment.NOT_CORRECTED.says}: {result.tried[-1]}")
    nominal, worst = result.nominal, result.worst
    what = "" if result.accepted in (0.0, 1.0) else Text(f", {Quantity(result.accepted, 'share'):3} of the correction")
    return Text(
        f"{Judgment.CORRECTED.says}{what}: {Quantity(nominal.corrected.rms, 'm')} RMS from the path in place of "
        f"{Quantity(nominal.plain.rms, 'm')}, and {Quantity(worst.corrected.rms, 'm')} in place of "
        f"{Quantity(worst.plain.rms, 'm')} on the worst machine of the box ({worst.name})."
    )


def _of_method(part: Part, correction: Correction) -> list[str]:
    """Return remarks on how to use the correction."""
    if correction.forces:
        peak = max(float(np.max(np.abs(force))) for force in correction.forces.values())
        remarks: list[str] = [
            Text(
                f"The force offsets reach {Quantity(peak, 'N'):3}; they start with the first set position, and are 0 "
                "after the last row. The control stays as it is."
            )
        ]
    else:
        shift = max(float(np.max(np.abs(change[0]))) for change in correction.paths.values())
        remarks = [
            Text(
                f"The set path is changed by up to {Quantity(shift, 'm')}; the plan keeps "
                f"{Quantity(RESERVE[2], 'share'):2} of the jerk and {Quantity(RESERVE[3], 'share'):2} of the snap back "
                "for it, and the sum is proven."
            )
        ]
    still = [axis for axis, share in correction.shares.items() if share and not _rubs(part.machine.loop(axis))]
    remarks += [f"Axis {axis} has no dry friction in the machine file, and is not corrected." for axis in still]
    remarks.append("It holds for this program, this control and this friction: after a change of any make it anew.")
    return remarks


def _rubs(loop: Loop) -> bool:
    return loop.axis.friction_load is not None or loop.axis.friction_motor is not None


def _facts(part: Part, result: CorrectedProgram) -> dict[str, str]:
    job = part.job
    box = result.box
    return {
        "Job": job.file.name,
        "Machine": job.machine.name,
        "Control": part.law,
        "Work": "" if job.program is None else job.program.description,
        "Counted": "samples in cut, or at feed without a cut; weighed by the way"
        if part.counted is not None
        else "all samples",
        "Box": Text(
            f"mass of the load ±{Quantity(box.mass, 'share'):3}, dry friction ±{Quantity(box.friction, 'share'):3} "
            f"with the cut ±{Quantity(box.cut, 'share'):3}, stiffness down to -{Quantity(box.stiffness, 'share'):3}, "
            f"dead time up to +{box.dead_time} sample"
        ),
        "Accepted if": "RMS, 95 % and largest deviation are each at most 1.02 times those without correction, on every "
        "machine",
        "Written by": f"feeddrive {__version__}",
    }


def corrected_report(result: CorrectedProgram, kind: str = "", known: Mapping[str, str] | None = None) -> Report:
    """Return the report of a corrected part: the path before and after, on the nominal and the worst machine."""
    good = result.accepted > 0.0
    # the row of the worst machine
    worst = [plant.name for plant in result.plants].index(result.worst.name)
    about = [Remarks(result.tried, "What was tried"), Remarks(result.left, "What no correction cancels")]
    if good:
        about.append(Remarks(result.remarks, "How to use it"))
    return Report(
        f"A part program, corrected: {kind}" if kind else "A part program, corrected",
        "feeddrive setpath",
        Verdict((_verdict(result),), good=good),
        (
            Section("plants", "On every machine of the box", (Marked(result.table(), alert=(worst,)),)),
            Section("use", "Use" if good else "Why none", tuple(about)),
            facts("The part", known or {}),
        ),
        Picture(
            "deviation",
            "Deviation from the path over time",
            "Above: the nominal machine; below: the machine of the box on which the corrected part is worst. Gaps: "
            "samples that do not count.",
            "The deviation from the path over time without and with the correction, on two machines.",
            result.chart,
        ),
    )


def _json(record: Mapping[str, Any]) -> str:
    return json.dumps(record, indent=1) + "\n"


def _figures(figures: PathFigures) -> dict[str, float]:
    return {"rms_m": figures.rms, "within_95_percent_m": figures.within, "largest_m": figures.largest}


def _record(request: SetpathRequest, part: Part, result: CorrectedProgram) -> dict[str, Any]:
    """Return the content of `setpath.json`, in SI units."""
    nominal, worst, box = result.nominal, result.worst, result.box
    return {
        "written_by": f"feeddrive {__version__}",
        **_about(part),
        "method": request.method or OF_JOB[0],
        "accepted": result.accepted > 0.0,
        "accepted_share": result.accepted,
        "contour_rms_m": {
            "plain": nominal.plain.rms,
            "corrected": nominal.corrected.rms,
            "worst_plain": worst.plain.rms,
            "worst_corrected": worst.corrected.rms,
        },
        "worst_machine": worst.name,
        "box": {name: getattr(box, name) for name in PlantBox.__dataclass_fields__},
        "machines": [
            {"name": plant.name, "plain": _figures(plant.plain), "corrected": _figures(plant.corrected)}
            for plant in result.plants
        ],
        "tried": [str(text) for text in result.tried],
        "left": [str(text) for text in result.left],
        **_of_correction(result.correction),
    }


def _about(part: Part) -> dict[str, Any]:
    return {
        "job": part.job.file.name,
        "title": part.job.title,
        "machine": part.job.machine.name,
        "law": part.law,
        "program": None if part.planned is None else part.planned.program,
        "sample_time_s": float(part.machine.sample_time),
        "samples": next(iter(part.plan.values())).position.size,
    }


def _of_correction(correction: Correction) -> dict[str, Any]:
    return {
        "passes": correction.passes,
        "axes": {
            axis: {
                "friction_share": correction.shares.get(axis),
                "largest_force_N": _peak(correction.forces.get(axis)),
                "largest_shift_m": _peak(correction.paths.get(axis)),
            }
            for axis in correction.plan
        },
    }


def _peak(rows: np.ndarray | None) -> float:
    """Return the largest force, or the largest shift of a path, whose derivatives follow in further rows."""
    return 0.0 if rows is None else float(np.max(np.abs(np.atleast_2d(rows)[0])))


def _drives(request: SetpathRequest, plan: Mapping[str, Recorded]) -> dict[str, DriveScaling]:
    """Return the scaling of the drives that were named, by axis."""
    return {axis: read_drive(path).drive.scaling for axis, path in _by_axis("--drive", request.drive, plan).items()}


def _by_axis(flag: str, texts: Sequence[str], plan: Mapping[str, Recorded]) -> dict[str, str]:
    """Parse options such as `x=NAME`. Raise ParameterError for an axis that the part does not move, or names twice."""
    values: dict[str, str] = {}
    for text in texts:
        axis, mark, value = text.partition("=")
        if not mark or not value or axis not in plan or axis in values:
            raise ParameterError(
                f"{flag} {text}: give each axis once, as {next(iter(plan))}=...; the part moves {', '.join(plan)}"
            )
        values[axis] = value
    return values


def _from_log(request: SetpathRequest, part: Part, progress: Progress) -> Outcome[Any]:
    """Learn the correction of the next part from the log of the last one."""
    assert request.from_log is not None
    if request.method == "path":
        raise ParameterError("--from-log teaches a force: leave out --method path")
    progress.step(f"reading {request.from_log.name}")
    log = _read_part(request, part)
    last = before = None
    history: tuple[float, ...] = ()
    if request.last is not None:
        last, before, record = read_correction(request.last, part.plan)
        for key, value in _about(part).items():
            if key in ("law", "machine", "samples") and record.get(key) != value:
                raise ParameterError(
                    f"{request.last}: is the correction of another {key}, {record.get(key)}, not {value}: name the "
                    "directory of the correction that ran with this log"
                )
        history = tuple(record.get("measured_rms_m", ()))
    progress.step("learning")
    learned = learn_from_log(
        part.machine, part.plan, log, last=last, before=before, history=history, counted=part.counted
    )
    files: dict[str, Path] = {}
    page = partial(learned_report, learned, part.kind)
    if request.out is not None:
        with new_directory(request.out) as folder:
            (folder / "report.html").write_text(html(page()), encoding="utf-8")
            record = {
                "written_by": f"feeddrive {__version__}",
                **_about(part),
                "method": "log",
                "finished": learned.best,
                "measured_rms_m": list(learned.history),
                "measured": _figures(learned.figures),
                "friction_found": {axis: {"share": a, "standard_error": b} for axis, (a, b) in learned.shares.items()},
                **_of_correction(learned.correction),
            }
            (folder / "setpath.json").write_text(_json(record), encoding="utf-8")
            write_correction(folder, learned.correction, part.line, part.drives, before=last)
        files = {
            "Report": request.out / "report.html",
            "Figures": request.out / "setpath.json",
            "Setpoints and force offsets": request.out / "setpoints.csv",
        }
    then = "" if learned.best or request.out is None else _next(request, part)
    return Outcome(
        learned,
        [learned.table(), *_shares(learned)],
        learned.remarks,
        verdict=_of_log(learned),
        files=files,
        judgment=Judgment.LEARNED,
        page=page,
        then=then,
    )


def _of_log(learned: LearnedPart) -> str:
    rms = Quantity(learned.figures.rms, "m")
    if learned.best:
        return Text(
            f"{Judgment.LEARNED.says}: this part is {rms} RMS from its path, less than 2 % better than the one "
            "before: the better of the two corrections is kept, and nothing more is learned."
        )
    return Text(f"{Judgment.LEARNED.says}: this part is {rms} RMS from its path; run the next one with the correction.")


def _shares(learned: LearnedPart) -> list[Table]:
    """Return a table of the friction that was found; none if it was not looked for."""
    rows = [[axis, share, error] for axis, (share, error) in learned.shares.items()]
    columns = ["axis", Column("of the model's friction", form=".3f"), Column("standard error", form=".3f")]
    return [Table("Friction in the log", columns, rows)] if rows else []


def learned_report(learned: LearnedPart, kind: str = "") -> Report:
    """Return the report of what one log of a part taught."""
    return Report(
        f"A part, learned from its log: {kind}" if kind else "A part, learned from its log",
        "feeddrive setpath",
        Verdict((_of_log(learned),), good=True),
        (Section("parts", "Part by part", (learned.table(), *_shares(learned), Remarks(learned.remarks))),),
        Picture(
            "deviation",
            "Deviation from the path in this log",
            "Gaps: samples that do not count.",
            "The measured deviation from the path over time.",
            learned.chart,
        ),
    )


def _read_part(request: SetpathRequest, part: Part) -> PartLog:
    """Read set positions, positions and forces of all axes from a log."""
    assert request.from_log is not None
    file = OpenedFile(request.from_log)
    whole = read_log(file, sample_time=float(part.machine.sample_time))
    columns = tuple(whole.channels)
    chosen = {
        "setpoint_position": _by_axis("--set-position", request.set_position, part.plan),
        "position_load": _by_axis("--position", request.position, part.plan),
    }
    usual = {"setpoint_position": ("set_position",), "position_load": ("reading_load", "position_load")}
    signals: dict[str, dict[str, np.ndarray]] = {"setpoint_position": {}, "position_load": {}, "force": {}, "trip": {}}
    sample_time = 0.0
    for axis in part.plan:
        for role, named in chosen.items():
            name = named.get(axis) or _usual_column(columns, axis, usual[role], role)
            if not name:
                flag = "--set-position" if role == "setpoint_position" else "--position"
                raise ParameterError(
                    f"{request.from_log}: has no column {axis}.{usual[role][0]}: name it by {flag} {axis}=NAME:mm; it "
                    f"has {', '.join(sorted(columns)[:12])}"
                )
            log = read_log(file, {role: LogColumn.of(name)}, sample_time=float(part.machine.sample_time))
            signals[role][axis], sample_time = log[role], float(log.sample_time)
        if force := _usual_column(columns, axis, ("force",), "force"):
            # by its role, which converts kN and the like
            signals["force"][axis] = read_log(file, {"force": LogColumn.of(force)})["force"]
        if f"{axis}.trip" in columns:
            signals["trip"][axis] = whole[f"{axis}.trip"]
    return PartLog(
        request.from_log.name,
        signals["setpoint_position"],
        signals["position_load"],
        sample_time,
        signals["force"],
        signals["trip"],
    )


def _usual_column(columns: Sequence[str], axis: str, words: Sequence[str], role: str) -> str:
    """Return the column of an axis with a usual name, such as `x.set_position`, `x_set_position_m` or `X.force_kN`;
    empty if there is none.
    """
    stems = {name: name.removesuffix(f"_{unit_at_the_end(name, role)}").lower() for name in columns}
    for word in words:
        for usual in (f"{axis}.{word}", f"{axis}_{word}"):
            if name := next((name for name in columns if stems[name] == usual.lower()), ""):
                return name
    return ""


def _one_axis(request: SetpathRequest, progress: Progress) -> Outcome[Any]:
    """Modify a set path offline, using the linear model of the loop, so that the table follows the desired path.

    Both paths are simulated on the axis of the file, friction included.
    """
    progress.step("model of the loop")
    if isinstance(request.source, Job):
        raise ParameterError(f"--method {request.method} is for one axis: give its machine, and the job by --job")
    method = request.method or OF_AXIS[0]
    loop = read_machine(request.source).loop(request.axis)
    reference = MOVE if request.job is None else job_reference(request.job, "name a job with a reference")
    if method == "zero-phase":
        changed = zero_phase(loop, reference)
    else:
        changed = filtered_splines(loop, reference, spacing=request.spacing, window=request.window)
    progress.step("runs of both paths")
    # simulated with the full axis, friction included: the linear model alone would flatter the changed path
    rows = [
        ["as it was", *_left(loop, reference, reference)],
        ["changed", *_left(loop, changed.reference, changed.wanted)],
    ]
    title = f"{called(request.source)}, axis {loop.name}: distance of the table from the wanted path, {method}"
    remarks = [
        Text(
            f"The changed path is up to {Quantity(changed.shift, 'm')} off the wanted one, and begins "
            f"{Quantity(changed.lead, 's')} earlier than the motion: give every axis of a machine the same lead."
        ),
        "It holds for this load and these gains: after a change of either make it anew.",
    ]
    files: dict[str, Path] = {}
    if request.out is not None:
        progress.step("writing")
        write_whole(request.out, _text(changed))
        files["Written"] = request.out
    table = Table(title, ["path", Column("largest", "m"), Column("RMS", "m")], rows)
    return Outcome(changed, [table], remarks, files=files, rotary=loop.axis.rotary)


def _left(loop: Loop, reference: Reference, wanted: Reference) -> list[float]:
    """Return the maximum and the RMS deviation of the table from the desired path, m."""
    run = simulate(loop, reference, record=["position_load"])
    off = run["position_load"] - np.asarray(wanted.at(run.time).position)
    return [float(np.max(np.abs(off))), float(np.sqrt(np.mean(off**2)))]


def _text(changed: ChangedReference) -> str:
    """Return the text of a CSV file: time, the set positions to play, and the desired positions of the table."""
    T = float(changed.reference.sample_time)
    rows = zip(changed.reference.position, changed.wanted.position, strict=True)
    lines = [f"{k * T:.9g},{float(played)!r},{float(wanted)!r}" for k, (played, wanted) in enumerate(rows)]
    return "\n".join(["time_s,set_position_m,wanted_position_m", *lines, ""])

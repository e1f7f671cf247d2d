"""`feeddrive plan`: setpoints of a part program that provably satisfy the limits of a machine.

The output files are written by `files/plan_files.py`.
"""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from math import degrees
from pathlib import Path
from time import monotonic, process_time, thread_time
from typing import TYPE_CHECKING

from feeddrive.files.atomic_io import new_directory
from feeddrive.files.machine import MachineFile, find_bundled, planned_kinematics, planned_limits, read_machine
from feeddrive.files.toml_file import quoted
from feeddrive.language.block import defaults
from feeddrive.language.errors import NoSlopeError, ParameterError
from feeddrive.language.judgment import Judgment
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity, count_of, number
from feeddrive.language.text import Text, joined
from feeddrive.language.threads import cores
from feeddrive.path.geometry.weights import ROTARY
from feeddrive.path.kinematics import Kinematics
from feeddrive.path.limits import LETTERS, MachineLimits
from feeddrive.path.program.blocks import open_program
from feeddrive.path.program.budget import LONGEST, MOST_CPU, Budget, Spending
from feeddrive.path.program.dialects import DIALECTS, FRONT_ENDS, DialectName, FrontEnd
from feeddrive.path.program.moves import ORIENTATIONS, Begin, Ignored, Move, PathMode, ToolPoint
from feeddrive.path.purpose import PURPOSES, read_dynamics, settings, with_tolerance
from feeddrive.workflow.command import OUT, Outcome, Request, argument, called, command, line, option

if TYPE_CHECKING:
    from feeddrive.files.plan_files import SetpointWriter
    from feeddrive.path.planned import Planned, Take
    from feeddrive.path.setpoints import Samples, Standstill
    from feeddrive.report.report import Report

_SHOWN, _WATCHED = 0.2, 5.0  # s between two reports: on a terminal, and as lines (--watch)
FAULT = (
    f"the motion {Judgment.NOT_PLANNED.says}: this is a fault of feeddrive, not of the program; please report it with "
    "the program and the limits"
)


class PlanRequest(Request):
    """The part program, and the machine for which it is planned."""

    program: Path = argument("A part program (RS-274/NGC), or the name of a bundled one")
    machine: str | Path | MachineFile | None = option(
        "a machine file (TOML) with limits of its axes, or the name of a bundled machine", default=None
    )
    limits: Path | None = option("limits of axes (TOML), in place of those of the machine file", default=None)
    tools: Path | None = option("tool table (.tbl)", default=None)
    offsets: Path | None = option("parameters (.var): work offsets, G28, G30", default=None)
    tables_inch: bool = option("tools and offsets are in inches", default=False)
    skip_deleted: bool = option("leave out lines that begin with /", default=False)
    front_end: str = option("reader of the program", default="auto", options=FRONT_ENDS)
    parameters: str | None = option(
        "values of named parameters that the program does not set: _hal[plasmac.cut-feed-rate]=40, _depth=3",
        default=None,
    )
    dialect: str = option(
        "language of the program; marlin is that of 3D printers, whose E is the axis U",
        default="linuxcnc",
        options=tuple(DIALECTS),
    )
    tolerance: float | None = option(
        "tolerance of corners where the program states none (G64 without P); it stops there if left out",
        default=None,
        unit="m",
        entered="mm",
        above=0.0,
    )
    purpose: str | None = option(
        "what is machined, as with CYCLE832: sets tolerance and dynamics where neither options nor the program do",
        default=None,
        flag="--for",
        options=tuple(PURPOSES),
    )
    dynamics: str | None = option(
        "shares of the limits of acceleration, jerk and snap in %: 100,50,50, or one for all; 100 if left out",
        default=None,
    )
    angle_tolerance: float | None = option(
        "tolerance of rotary axes where corners are rounded, in place of those among the limits of the axes, which are "
        "0.05 if left out",
        default=None,
        unit="rad",
        entered="deg",
        above=0.0,
    )
    orientation: str = option(
        "how the tool turns in a block between two directions, while its tip is moved and the program does not say: "
        "the rotary axes move straight, or it turns in the plane of both, evenly or with straight components",
        default="axes",
        options=ORIENTATIONS,
    )
    override: str | None = option(
        "steps of the feed in % from these times on, in s: 1:50, 2:0, 3.5:120; 0 holds; 100 before the first",
        default=None,
    )
    sample_time: float | None = option(
        "time from setpoint to setpoint; that of the machine's loops if left out",
        default=None,
        unit="s",
        entered="ms",
        least=1e-3,
        most=1e3,
    )
    from_line: int | None = option(
        "line at which the program is resumed, with the modal state that the lines before it leave",
        default=None,
        least=1,
    )
    start: str | None = option(
        "where the machine stands, in its coordinates, mm and degrees: X=10, Y=-5, C=90, other axes at 0; at 0 if left "
        "out, or where the line of --from-line begins",
        default=None,
    )
    longest: float = option(
        "longest motion; a program that lasts longer at its feeds is refused at its line",
        default=LONGEST,
        unit="s",
        entered="h",
        above=0.0,
    )
    most_cpu: float = option(
        "processor time of reading, planning and sampling, to which 2 ms are added for each line of the file",
        default=MOST_CPU,
        unit="s",
        entered="s",
        above=0.0,
    )
    threads: int | None = option(
        "number of threads that plan a program of more than 500 lines; that of the processor's cores if left out. The "
        "plan does not depend on it",
        default=None,
        least=1,
        most=64,
    )
    watch: bool = option("print a line of progress every 5 s", default=False)
    no_pictures: bool = option(
        "write the report without its pictures, which take longer to draw than a short program takes to plan",
        default=False,
    )
    out: Path | None = option(OUT, short="-o", default=None)

    def check(self) -> None:
        """Raise ParameterError if limits or the sample time are missing."""
        if self.machine is None and self.limits is None:
            raise ParameterError("--machine is missing: a machine file with limits, or --limits with a file of limits")
        if self.machine is None and self.sample_time is None:
            raise ParameterError("--sample-time is missing: without a machine nothing says how often its loops run")

    def usual_out(self) -> Path:
        return Path("results") / f"plan_{self.program.stem}"


@command(PlanRequest)
def plan(request: PlanRequest, progress: Progress) -> Outcome[Planned]:
    """Plan a part program within the limits of each axis, prove compliance, and write setpoints, plan and report.

    Raises ProgramError, with file, line, column and word, for a block that cannot be read or executed, and
    ParameterError for a program in which nothing lasts: an empty file, or one without a motion and without a dwell.
    """
    program = find_bundled(request.program, "programs", ".ngc")
    open_program(program, str(program)).close()
    machine = None if request.machine is None else read_machine(request.machine)
    # imported late: a program or a machine that is not there is refused without the planner
    from feeddrive.files.plan_files import setpoint_files, write_plan
    from feeddrive.path.plan_options import turning_within
    from feeddrive.path.planned import planned_of
    from feeddrive.path.schedule.override import read_steps
    from feeddrive.path.setpoints import Setpoints

    dynamics = None if request.dynamics is None else read_dynamics(request.dynamics)
    used = settings(request.purpose, request.tolerance, dynamics)
    limits = used.dynamics.of(planned_limits(machine, request.limits))
    unfit = "" if used.tolerance is None else limits.unfit(used.tolerance)
    if unfit:
        option_name = "--for" if request.tolerance is None else "--tolerance"
        raise ParameterError(f"{option_name}: {unfit}")
    if request.angle_tolerance is not None:
        limits = turning_within(limits, request.angle_tolerance, "--angle-tolerance")
    sample_time = request.sample_time
    if sample_time is None:
        assert machine is not None
        sample_time = float(next(iter(machine.loops.values())).sample_time)
    override = None if request.override is None else read_steps(request.override)
    names = program.name, called(request.machine if machine is None else machine.name)
    # a generator that an error leaves suspended would keep the program file open
    counts = Counts()
    threads = cores() if request.threads is None else request.threads
    # of all threads that plan
    spending = Spending(Budget(request.longest, request.most_cpu), thread_time if threads == 1 else process_time)
    reading = _moves(request, program, limits, planned_kinematics(machine, limits), used.tolerance, progress, counts)
    with contextlib.closing(reading) as moves:
        setpoints = Setpoints(moves, limits, sample_time, override, used, spending, threads)
        if request.out is None:
            planned = _moving(planned_of(setpoints, *names))
            return _outcome(planned, None, machine, counts)
        with new_directory(request.out) as folder:
            with setpoint_files(folder, limits, sample_time, program.name) as writer:
                planned = _moving(planned_of(setpoints, *names, _into(writer)))
            write_plan(folder, planned)
            if job := _job(request, program, machine, planned, len(counts.tools)):
                (folder / JOB).write_text(job, encoding="utf-8")
            progress.step("report")
            (folder / "report.html").write_text(html(_report(planned, not request.no_pictures)), encoding="utf-8")
    outcome = _outcome(planned, request.out, machine, counts)
    return replace(outcome, then=line("run", request.out / JOB)) if job else outcome


def _moving(planned: Planned) -> Planned:
    """Return a plan that lasts; raise ParameterError for one of no time."""
    if planned.cycle_time == 0.0:
        raise ParameterError(
            f"{planned.program}: no block moves an axis, so there is nothing to plan: see that this is the right file, "
            "that the machine does not stand at the end of every block, and, with --from-line, that motions follow"
        )
    return planned


JOB = "job.toml"  # the machine along the program that was planned


def _job(request: PlanRequest, program: Path, machine: MachineFile | None, planned: Planned, tools: int) -> str:
    """Return the text of the job that runs the program on the machine; empty if no job can reproduce this plan.

    tools  number of tools whose tip the program moves
    """
    if machine is None or planned.violations or tools > 1:
        return ""
    # a job has the sample time of the loops
    if planned.sample_time != float(next(iter(machine.loops.values())).sample_time):
        return ""
    axis = next((name for name in machine.loops if name.upper() in planned.limits.letters), None)
    if axis is None:
        return ""
    lines = [
        f"title = {quoted(f'{program.name} on {machine.name}')}",
        f"machine = {quoted(_found(machine.file.name))}",
        f"axis = {quoted(axis)}",
        "",
        "[program]",
        f"file = {quoted(_found(program))}",
    ]
    for name in ("tools", "offsets", "limits"):
        path: Path | None = getattr(request, name)
        lines += [] if path is None else [f"{name} = {quoted(_found(path))}"]
    lines += [f"{name} = true" for name in ("tables_inch", "skip_deleted") if getattr(request, name)]
    from feeddrive.files.part_program import SAME_OPTIONS, PartProgramSection

    usual = defaults(PartProgramSection)
    for name in SAME_OPTIONS:
        value = getattr(request, name)
        if value != usual[name]:
            lines.append(f"{name} = {quoted(value) if isinstance(value, str) else repr(value)}")
    return "\n".join([*lines, ""])


def _found(path: str | Path) -> str:
    """Return the absolute path of an existing file; the name of a bundled file is returned unchanged."""
    return str(Path(path).resolve()) if Path(path).is_file() else str(path)


def _differing(machine: MachineFile, letters: str) -> list[str]:
    """Return remarks on axes with different tracking dynamics, or no remarks if a law has no linear model."""
    names = [name for name, loop in machine.loops.items() if name.upper() in letters and not loop.axis.rotary]
    # imported after the plan, as the pages below: a program that is refused needs neither
    from feeddrive.analysis.contour_control import matched_dynamics

    with contextlib.suppress(NoSlopeError):
        return matched_dynamics(machine.machine(), names).remarks()
    return []


def _into(writer: SetpointWriter) -> Take:
    """Return a function that passes proven samples and stops to the writer and discards all others."""

    def write(samples: Samples, stops: Sequence[Standstill]) -> None:
        # samples that violate a limit must never reach a machine
        if samples.proven:
            writer.add(samples)
            writer.stops(stops)

    return write


@dataclass
class Counts:
    """What was seen while the program was read: codes that are left out, the tolerances that it states, and where it
    begins, if that is not its first line at the machine's zero; and the tools whose tip it moves.
    """

    left_out: Counter[str] = field(default_factory=Counter[str])
    tolerances: int = 0
    begin: Begin | None = None
    tools: set[tuple[float, ...]] = field(default_factory=set[tuple[float, ...]])


def _moves(
    request: PlanRequest,
    program: Path,
    limits: MachineLimits,
    kinematics: Kinematics | None,
    tolerance: float | None,
    progress: Progress,
    counts: Counts,
) -> Generator[Move]:
    """Yield the moves of the program, report the progress of reading, and count what the outcome names."""
    from feeddrive.path.plan_options import named_values, read_start, turning_of
    from feeddrive.path.program.reading import read_program

    front_end: FrontEnd = request.front_end  # type: ignore[assignment]
    dialect: DialectName = request.dialect  # type: ignore[assignment]
    moves = read_program(
        program,
        axes=limits.travel,
        tools=request.tools,
        offsets=request.offsets,
        tables_inch=request.tables_inch,
        skip_deleted=request.skip_deleted,
        front_end=front_end,
        parameters=None if request.parameters is None else named_values("--parameters", request.parameters),
        dialect=dialect,
        kinematics=kinematics,
        start=None if request.start is None else read_start("--start", request.start, limits.letters),
        from_line=request.from_line or 0,
        turning=turning_of(request.orientation, limits, tolerance),
    )
    of = _lines_of(program)
    counted = _counted(moves, counts)
    stated = counted if tolerance is None else with_tolerance(counted, tolerance)
    farthest, shown, watched = 0, monotonic(), monotonic()
    with contextlib.closing(moves):
        for count, move in enumerate(stated):
            yield move
            # a subroutine or a loop goes back in the file; the progress bar must not
            farthest = max(farthest, move.source.number)
            # the clock is read for few moves only: a program may have millions of short ones
            if count % 64:
                continue
            now = monotonic()
            if now - shown >= _SHOWN:
                shown = now
                progress.step(f"line {farthest:,} of {of:,}", farthest, of)
            if request.watch and now - watched >= _WATCHED:
                watched = now
                progress.remark(f"line {farthest:,} of {of:,}, {count_of(count, 'move')}")


def _begun(begin: Begin, letters: str) -> str:
    """Return the sentence that says where the machine is assumed to stand, and in which state."""
    stands = ", ".join(
        f"{letter} {number(degrees(value) if letter in ROTARY else 1e3 * value, 8)}"
        for letter, value in ((letter, begin.position[LETTERS.index(letter)]) for letter in letters)
    )
    place = f"the machine stands at {stands} (mm, degrees, machine coordinates)"
    if not begin.state:
        return f"Assumed: {place}; nothing checks it."
    return (
        f"Resumed at line {begin.source.number}. Assumed, and not checked: {place}, and the lines before have left "
        f"{begin.state}. Set tool, spindle and coolant before."
    )


def _counted(moves: Iterable[Move], counts: Counts) -> Iterator[Move]:
    for move in moves:
        if isinstance(move, Ignored):
            counts.left_out[move.code] += 1
        elif isinstance(move, PathMode) and move.tolerance > 0.0:
            counts.tolerances += 1
        elif isinstance(move, Begin):
            counts.begin = move
        elif isinstance(move, ToolPoint) and move.kinematics is not None:
            counts.tools.add(move.kinematics.tool)
        yield move


def _lines_of(program: Path) -> int:
    """Return the number of lines of a file."""
    with program.open("rb") as file:
        return sum(block.count(b"\n") for block in iter(lambda: file.read(1 << 20), b"")) + 1


def _outcome(planned: Planned, out: Path | None, machine: MachineFile | None, counts: Counts) -> Outcome[Planned]:
    from feeddrive.files.plan_files import PLAN, SETPOINTS, STREAMER

    remarks = [
        f"{count} x {reason}" for reason, count in sorted(planned.stop_reasons.items(), key=lambda item: -item[1])
    ]
    causes = sorted(planned.seconds.items(), key=lambda item: -item[1])
    told = joined(
        ", ",
        (f"{name} {Quantity(seconds / planned.cycle_time, 'share'):3}" for name, seconds in causes[:6]),
    )
    sentences = [] if counts.begin is None else [_begun(counts.begin, planned.limits.letters)]
    if causes:
        sentences += [f"Stops: {', '.join(remarks) or 'none'}.", Text(f"Most of the time is limited by: {told}.")]
        sentences += planned.loss.sentences(planned.cycle_time)
    if planned.settings.purpose:
        sentences.append(planned.settings.sentence(counts.tolerances))
    if tip := planned.tip:
        sentences.append(
            Text(
                f"The tip stays within {Quantity(tip.deviation, 'm'):4} of the program, and the tool within "
                f"{Quantity(tip.angle, 'rad'):deg} of its direction, proven on {count_of(tip.pieces, 'piece')}."
            )
        )
    if counts.left_out:
        codes = ", ".join(f"{count} x {code}" for code, count in sorted(counts.left_out.items()))
        sentences.append(f"Left out, as they move nothing: {codes}.")
    proven = planned.violations == 0
    files = {}
    if out is not None:
        files = {"Plan": out / PLAN, "Report": out / "report.html"}
        files |= {"Setpoints": out / SETPOINTS, "For LinuxCNC's streamer": out / STREAMER} if proven else {}
    differ = [] if machine is None else _differing(machine, planned.limits.letters)
    judgment, failure = (Judgment.PLANNED, "") if proven else (Judgment.NOT_PLANNED, FAULT)
    faults = [planned.limits.named(str(fault)) for fault in planned.proof.faults[:1]]
    return Outcome(
        planned,
        [planned.table()],
        [*sentences, *faults, *differ],
        files=files,
        judgment=judgment,
        failure=failure,
        page=partial(_report, planned),
    )


def _report(planned: Planned, pictures: bool = True) -> Report:
    from feeddrive.report.machining_report import plan_report

    return plan_report(planned, pictures)


def html(report: Report) -> str:
    """Return a report as a page."""
    from feeddrive.report.page import html as written

    return written(report)

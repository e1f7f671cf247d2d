"""`feeddrive plan`: setpoints of a part program that provably satisfy the limits of a machine.

The output files are written by `files/part_program.py`.
"""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import isfinite
from pathlib import Path
from time import monotonic

from feeddrive.analysis.contour_control import matched_dynamics
from feeddrive.files.atomic_io import new_directory
from feeddrive.files.machine import MachineFile, planned_limits, read_machine
from feeddrive.files.part_program import PLAN, SETPOINTS, STREAMER, SetpointWriter, setpoint_files, write_plan
from feeddrive.files.toml_file import quoted
from feeddrive.language.errors import NoSlopeError, ParameterError, shown
from feeddrive.language.judgment import Judgment
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text, joined
from feeddrive.path.limits import MachineLimits
from feeddrive.path.planned import Planned, Take, planned_of
from feeddrive.path.program.dialects import DialectName
from feeddrive.path.program.moves import Ignored, Move, PathMode
from feeddrive.path.program.reading import FrontEnd, read_program
from feeddrive.path.schedule.override import read_steps
from feeddrive.path.setpoints import Samples, Setpoints, Standstill
from feeddrive.report.machining_report import plan_report
from feeddrive.report.page import html
from feeddrive.workflow.command import OUT, Outcome, Request, argument, called, command, line, option

_SHOWN, _WATCHED = 0.2, 5.0  # s between two reports: on a terminal, and as lines (--watch)
FAULT = (
    f"the motion {Judgment.NOT_PLANNED.says}: this is a fault of feeddrive, not of the program; please report it with "
    "the program and the limits"
)


class PlanRequest(Request):
    """The part program, and the machine for which it is planned."""

    program: Path = argument("A part program (RS-274/NGC)")
    machine: str | Path | MachineFile | None = option(
        "a machine file (TOML) with limits of its axes, or the name of a bundled machine", default=None
    )
    limits: Path | None = option("limits of axes (TOML), in place of those of the machine file", default=None)
    tools: Path | None = option("tool table (.tbl)", default=None)
    offsets: Path | None = option("parameters (.var): work offsets, G28, G30", default=None)
    tables_inch: bool = option("tools and offsets are in inches", default=False)
    skip_deleted: bool = option("leave out lines that begin with /", default=False)
    front_end: str = option("reader of the program", default="auto", options=("auto", "own", "rs274"))
    parameters: str | None = option(
        "values of named parameters that the program does not set: _hal[plasmac.cut-feed-rate]=40, _depth=3",
        default=None,
    )
    dialect: str = option(
        "language of the program; marlin is that of 3D printers, whose E is the axis U",
        default="linuxcnc",
        options=("linuxcnc", "grbl", "marlin"),
    )
    tolerance: float | None = option(
        "tolerance of corners where the program states none (G64 without P); it stops there if left out",
        default=None,
        unit="m",
        entered="mm",
        above=0.0,
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
    watch: bool = option("print a line of progress every 5 s", default=False)
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

    Raises ProgramError, with file, line, column and word, for a block that cannot be read or executed.
    """
    machine = None if request.machine is None else read_machine(request.machine)
    limits = planned_limits(machine, request.limits)
    unfit = "" if request.tolerance is None else limits.unfit(request.tolerance)
    if unfit:
        raise ParameterError(f"--tolerance: {unfit}")
    sample_time = request.sample_time
    if sample_time is None:
        assert machine is not None
        sample_time = float(next(iter(machine.loops.values())).sample_time)
    override = None if request.override is None else read_steps(request.override)
    names = request.program.name, called(request.machine if machine is None else machine.name)
    # a generator that an error leaves suspended would keep the program file open
    left_out = Counter[str]()
    with contextlib.closing(_moves(request, limits, progress, left_out)) as moves:
        setpoints = Setpoints(moves, limits, sample_time, override)
        if request.out is None:
            planned = planned_of(setpoints, *names)
            return _outcome(planned, None, machine, left_out)
        with new_directory(request.out) as folder:
            with setpoint_files(folder, limits, sample_time, request.program.name) as writer:
                planned = planned_of(setpoints, *names, _into(writer))
            write_plan(folder, planned)
            if job := _job(request, machine, planned):
                (folder / JOB).write_text(job, encoding="utf-8")
            progress.step("report")
            (folder / "report.html").write_text(html(plan_report(planned)), encoding="utf-8")
    outcome = _outcome(planned, request.out, machine, left_out)
    return replace(outcome, then=line("run", request.out / JOB)) if job else outcome


JOB = "job.toml"  # the machine along the program that was planned


def _job(request: PlanRequest, machine: MachineFile | None, planned: Planned) -> str:
    """Return the text of the job that runs the program on the machine; empty if no job can reproduce this plan."""
    # a job has the tolerance, the feed and the sample time of program and machine
    changed = (request.tolerance, request.override, request.sample_time, request.parameters) != (None,) * 4
    if machine is None or planned.proof.count or changed or request.front_end != "auto":
        return ""
    axis = next((name for name in machine.loops if name.upper() in planned.limits.letters), None)
    if axis is None:
        return ""
    lines = [
        f"title = {quoted(f'{request.program.name} on {machine.name}')}",
        f"machine = {quoted(_found(machine.file.name))}",
        f"axis = {quoted(axis)}",
        "",
        "[program]",
        f"file = {quoted(_found(request.program))}",
    ]
    for name in ("tools", "offsets", "limits"):
        path: Path | None = getattr(request, name)
        lines += [] if path is None else [f"{name} = {quoted(_found(path))}"]
    lines += [f"{name} = true" for name in ("tables_inch", "skip_deleted") if getattr(request, name)]
    lines += [] if request.dialect == "linuxcnc" else [f"dialect = {quoted(request.dialect)}"]
    return "\n".join([*lines, ""])


def _found(path: str | Path) -> str:
    """Return the absolute path of an existing file; the name of a bundled file is returned unchanged."""
    return str(Path(path).resolve()) if Path(path).exists() else str(path)


def _differing(machine: MachineFile, letters: str) -> list[str]:
    """Return remarks on axes with different tracking dynamics, or no remarks if a law has no linear model."""
    names = [name for name, loop in machine.loops.items() if name.upper() in letters and not loop.axis.rotary]
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


def _moves(request: PlanRequest, limits: MachineLimits, progress: Progress, left_out: Counter[str]) -> Generator[Move]:
    """Yield the moves of the program, report the progress of reading, and count the codes that are left out."""
    front_end: FrontEnd = request.front_end  # type: ignore[assignment]
    dialect: DialectName = request.dialect  # type: ignore[assignment]
    moves = read_program(
        request.program,
        axes=limits.travel,
        tools=request.tools,
        offsets=request.offsets,
        tables_inch=request.tables_inch,
        skip_deleted=request.skip_deleted,
        front_end=front_end,
        parameters=None if request.parameters is None else _named_values(request.parameters),
        dialect=dialect,
    )
    of = _lines_of(request.program)
    stated = moves if request.tolerance is None else _with_tolerance(moves, request.tolerance)
    farthest, shown, watched = 0, monotonic(), monotonic()
    with contextlib.closing(moves):
        for count, move in enumerate(stated):
            if isinstance(move, Ignored):
                left_out[move.code] += 1
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
                progress.remark(f"line {farthest:,} of {of:,}, {count:,} moves")


def _named_values(text: str) -> dict[str, float]:
    """Return the values of `--parameters`, by name; raise ParameterError for an entry that is no name and number."""
    values: dict[str, float] = {}
    for entry in text.split(","):
        name, equals, number = entry.rpartition("=")
        with contextlib.suppress(ValueError):
            if name.strip() and equals and isfinite(float(number)):
                values[name.strip()] = float(number)
                continue
        raise ParameterError(f"--parameters: {shown(entry.strip())} is no name with a number: write _depth=3, _feed=40")
    return values


def _with_tolerance(moves: Iterable[Move], tolerance: float) -> Iterator[Move]:
    """Yield the moves, adding the tolerance to every continuous path mode for which the program states none."""
    begun = False
    for move in moves:
        if isinstance(move, PathMode) and move.mode == "continuous" and move.tolerance == 0.0:
            yield replace(move, tolerance=tolerance)
        else:
            # the tolerance must hold from the first motion on, also in a program that never states a path mode
            if not begun and not isinstance(move, PathMode):
                yield PathMode(move.source, "continuous", tolerance)
            yield move
        begun = True


def _lines_of(program: Path) -> int:
    """Return the number of lines of a file; 0 if it is unreadable, which the reader of the program reports."""
    with contextlib.suppress(OSError), program.open("rb") as file:
        return sum(block.count(b"\n") for block in iter(lambda: file.read(1 << 20), b"")) + 1
    return 0


def _outcome(
    planned: Planned, out: Path | None, machine: MachineFile | None, left_out: Mapping[str, int]
) -> Outcome[Planned]:
    remarks = [
        f"{count} x {reason}" for reason, count in sorted(planned.stop_reasons.items(), key=lambda item: -item[1])
    ]
    causes = sorted(planned.seconds.items(), key=lambda item: -item[1])
    told = joined(
        ", ",
        # a program without motion has a cycle time of 0
        (f"{name} {Quantity(seconds / max(planned.cycle_time, 1e-9), 'share'):3}" for name, seconds in causes[:6]),
    )
    sentences: list[str] = []
    if causes:
        sentences += [f"Stops: {', '.join(remarks) or 'none'}.", Text(f"Most of the time is limited by: {told}.")]
    if left_out:
        codes = ", ".join(f"{count} x {code}" for code, count in sorted(left_out.items()))
        sentences.append(f"Left out, as they move nothing: {codes}.")
    proven = planned.proof.count == 0
    files = {}
    if out is not None:
        files = {"Plan": out / PLAN, "Report": out / "report.html"}
        files |= {"Setpoints": out / SETPOINTS, "For LinuxCNC's streamer": out / STREAMER} if proven else {}
    differ = [] if machine is None else _differing(machine, planned.limits.letters)
    judgment, failure = (Judgment.PLANNED, "") if proven else (Judgment.NOT_PLANNED, FAULT)
    faults = [] if proven else [planned.limits.named(str(planned.proof.faults[0]))]
    return Outcome(
        planned,
        [planned.table()],
        [*sentences, *faults, *differ],
        files=files,
        judgment=judgment,
        failure=failure,
        page=partial(plan_report, planned),
    )

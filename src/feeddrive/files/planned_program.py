"""The section [program] of a job: a part program, planned, as the reference of all axes that it moves.

[program]
file = "part.ngc"                  # beside the job, or a bundled one: circle_diamond_square.ngc
tools = "tool.tbl"                 # optional, as offsets, tables_inch, skip_deleted of `feeddrive plan`
limits = "limits.toml"             # in place of [axis.x.limits] of the machine file

or the recorded setpoints of another planner, smoothed (`path/smoothing.py`):

[program]
recorded = "log.csv.gz"
columns = { x = "x_mm", y = "y_mm" }
sample_time_ms = 1                 # of a log without a column of time
average_ms = 4                     # of each of four averages
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from feeddrive.blocks.machine_families import Coupling
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.files.columns import Column
from feeddrive.files.cutting import Cut, Process, ProcessSection, process_of
from feeddrive.files.formats import OpenedFile
from feeddrive.files.machine import BUNDLED, MachineFile, planned_limits
from feeddrive.files.read_log import read_log
from feeddrive.files.section import Section, file_name, named
from feeddrive.files.toml_file import TomlTable
from feeddrive.language.block import Number, choice, parameter
from feeddrive.language.declaration import declarations
from feeddrive.language.errors import FeeddriveError, NotPlannedError, nearest
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.loop.simulate import samples
from feeddrive.path.planned import Planned, planned_of
from feeddrive.path.program.reading import read_program
from feeddrive.path.setpoints import Samples, Setpoints, Standstill
from feeddrive.path.smoothing import reach, smoothed

MOST = 4_000_000
"""Samples of a program that a job runs: a row of each of its signals is held in memory."""


class ProgramSection(Section):
    """A part program, planned, as the reference of all axes that it moves; or setpoints that were recorded."""

    @classmethod
    def choose(cls, table: TomlTable) -> type[Section]:
        """Choose the class by the key that names the file."""
        return RecordedSection if "recorded" in table.values else PartProgramSection


class PartProgramSection(ProgramSection):
    """A part program, planned, which moves all axes that it names."""

    file: str = file_name("the part program, beside the job or a bundled one", example='"part.ngc"')
    tools: str | None = file_name("table of tools", default=None)
    offsets: str | None = file_name("table of offsets", default=None)
    limits: str | None = file_name("limits of the axes in place of those of the machine file", default=None)
    tables_inch: bool = choice("tools and offsets are in inches", default=False)
    skip_deleted: bool = choice("leave out lines that begin with /", default=False)


class RecordedSection(ProgramSection):
    """Setpoints of another planner, smoothed by four averages."""

    recorded: str = file_name("log of the setpoints, beside the job or a bundled one")
    columns: Mapping[str, str] = named("names of the columns by axis", least=1)
    sample_time: Number | None = parameter(
        "s", "sample time of a log without a column of time", above=0, below=1e9, default=None
    )
    average: Number = parameter("s", "length of one of the four averages", above=0, below=1e9, default=4e-3)


FILES = tuple(
    name
    for section in (PartProgramSection, RecordedSection)
    for name, declared in declarations(section).items()
    if declared.role == "file"
)
"""Keys of [program] that name a file."""


@dataclass(frozen=True, eq=False)
class PlannedProgram:
    """A part program as references of axes, by their names in the machine file.

    description  in words, for reports
    file     of the program; None for recorded setpoints, which have none of what follows
    planned  what it came to
    line     of the program by sample, shape (samples,)
    counted  the samples that cut, or without a [process] all that are at a feed, shape (samples,)
    cuts     what the tools do over time, by the section [process]
    process  that section
    """

    references: Mapping[str, Recorded]
    description: str
    file: Path | None = None
    planned: Planned | None = None
    line: np.ndarray | None = None
    counted: np.ndarray | None = None
    cuts: tuple[Cut, ...] = ()
    process: Process | None = None

    def couplings(self, substep: float) -> tuple[Coupling, ...]:
        """Return the cuts as couplings of a machine with these substeps, s. Raise ParameterError without x and y."""
        return () if self.process is None else self.process.couplings(self.cuts, tuple(self.references), substep)


def planned_program(
    section: ProgramSection, place: Path, machine: MachineFile, process: ProcessSection | None = None
) -> PlannedProgram:
    """Plan the program of a section within the limits of the machine, prove it, and return it with its cuts.

    Raises ParameterError or FileError as the files of the section are wrong, ProgramError at a line of the program,
    NotPlannedError if it is too long or its proof does not hold.
    """
    if isinstance(section, RecordedSection):
        if process is not None:
            raise process.error("[process] goes with a part program, whose lines it speaks of, not with recorded = ...")
        return _recorded(section, place, machine)
    assert isinstance(section, PartProgramSection)
    program = _path(section, place, "file")
    tools, offsets, own_limits = (
        None if getattr(section, name) is None else _path(section, place, name)
        for name in ("tools", "offsets", "limits")
    )
    try:
        limits = planned_limits(machine, own_limits)
    except FeeddriveError as error:
        raise section.error(f"{error}", kind=type(error)) from None
    T = float(next(iter(machine.loops.values())).sample_time)
    kept: list[np.ndarray] = []
    lines: list[np.ndarray] = []
    moves = read_program(
        program,
        axes=limits.travel,
        tools=tools,
        offsets=offsets,
        tables_inch=section.tables_inch,
        skip_deleted=section.skip_deleted,
    )
    with closing(moves):
        cut_process = None if process is None else process_of(process, program)
        setpoints = Setpoints(moves if cut_process is None else cut_process.spindle.noted(moves), limits, T)

        def keep(samples: Samples, _: Sequence[Standstill]) -> None:
            kept.append(samples.values)
            lines.append(np.where(np.isinf(samples.feed), -samples.line, samples.line).astype(np.int32))
            if setpoints.samples > MOST:
                raise section.error(
                    f"{program.name} lasts longer than {Quantity(MOST * T, 's'):6 SI}, {MOST:,} samples, which a job "
                    "does not hold in memory: cut the program, or take feeddrive plan for its setpoints",
                    kind=NotPlannedError,
                )
            if not samples.proven:
                raise section.error(
                    f"{program.name}: the motion could not be proven to keep its limits: "
                    f"{limits.named(str(setpoints.prover.proof().faults[0]))}. This is a fault of feeddrive, not of "
                    "the program",
                    kind=NotPlannedError,
                )

        planned = planned_of(setpoints, program.name, machine.name, keep)
    rows, line = np.concatenate(kept), np.concatenate(lines)
    names = {name.upper(): name for name in machine.loops}
    references = {names[letter]: _reference(rows[:, i], T) for i, letter in enumerate(limits.letters)}
    references |= {name: references[leader] for name, leader in machine.followers().items() if leader in references}
    times = np.arange(len(line)) * T
    cuts = () if cut_process is None else cut_process.cuts(times, np.abs(line), line < 0)
    return PlannedProgram(
        references,
        Text(
            f"part program {program.name}, {planned.blocks:,} blocks in {Quantity(planned.cycle_time, 's'):6 SI}, "
            f"planned and proven"
        ),
        program,
        planned,
        np.abs(line),
        line > 0 if cut_process is None else _cutting(cuts, times),
        cuts,
        cut_process,
    )


def _cutting(cuts: Sequence[Cut], times: np.ndarray) -> np.ndarray:
    """Return True where the tool is in the work, for each time."""
    begins = np.array([cut.begin for cut in cuts])
    depths = np.array([cut.axial_depth for cut in cuts])
    # rounding of k T must not put a sample before the begin of its cut
    return depths[np.searchsorted(begins, times + 1e-9, side="right") - 1] > 0.0


def _reference(rows: np.ndarray, T: float) -> Recorded:
    """Return position to snap in columns as a reference."""
    position, velocity, acceleration, jerk, snap = (np.ascontiguousarray(column) for column in rows.T)
    return Recorded(
        position=position, velocity=velocity, acceleration=acceleration, jerk=jerk, snap=snap, sample_time=T
    )


def _recorded(section: RecordedSection, place: Path, machine: MachineFile) -> PlannedProgram:
    """Return the setpoints that another planner has recorded, of the axes that have a column."""
    path = _path(section, place, "recorded")
    file = OpenedFile(path)
    unknown = next((name for name in section.columns if name not in machine.loops), None)
    if unknown is not None:
        raise section.error(
            f"key '{section.dotted('columns')}.{unknown}' is not known{nearest(unknown, machine.loops)}", "columns"
        )
    T = float(next(iter(machine.loops.values())).sample_time)
    references: dict[str, Recorded] = {}
    farthest, rows = 0.0, 0
    for axis, name in section.columns.items():
        log = read_log(file, {"setpoint_position": Column(name=name)}, sample_time=section.sample_time)
        average = max(1, round(section.average / log.sample_time))
        early = reach(average) * log.sample_time  # from rest to rest
        ends = log.sample_time * (len(log) - 1)
        instants = np.arange(samples(ends + 2.0 * early, T)) * T - early
        smooth = smoothed(log["setpoint_position"], log.sample_time, average, instants)
        references[axis] = _reference(smooth, T)
        recorded = np.interp(instants, np.arange(len(log)) * log.sample_time, log["setpoint_position"])
        farthest, rows = max(farthest, float(np.max(np.abs(smooth[:, 0] - recorded)))), average
    return PlannedProgram(
        references,
        Text(
            f"setpoints recorded in {path.name}, averaged four times over {rows} rows as control points of a spline of "
            f"fifth degree; an axis is at most {Quantity(farthest, 'm')} from the record"
        ),
    )


def _path(section: ProgramSection, place: Path, name: str) -> Path:
    """Return the file that a key names: beside the job, or a bundled one."""
    value = str(getattr(section, name))
    beside, bundled = place.parent / value, BUNDLED / "programs" / value
    if beside.exists():
        return beside
    if not bundled.is_file():
        raise section.error(f"{section.dotted(name)} = {value!r}: there is no such file beside the job", name)
    return bundled

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
from feeddrive.files.formats import OpenedFile
from feeddrive.files.job_cuts import Cut, Process, read_process
from feeddrive.files.machine import BUNDLED, MachineFile, planned_limits
from feeddrive.files.read_log import read_log
from feeddrive.files.toml_file import Section
from feeddrive.language import units
from feeddrive.language.errors import FeeddriveError, NotPlannedError, ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.loop.simulate import samples
from feeddrive.path.planned import Planned, planned_of
from feeddrive.path.program.reading import read_program
from feeddrive.path.setpoints import Samples, Setpoints, Standstill
from feeddrive.path.smoothing import reach, smoothed

FILES = ("file", "tools", "offsets", "limits", "recorded")
_FLAGS = ("tables_inch", "skip_deleted")
_AVERAGE = 4e-3  # s, if nothing is said
MOST = 4_000_000
"""Samples of a program that a job runs: a row of each of its signals is held in memory."""


@dataclass(frozen=True, eq=False)
class PlannedProgram:
    """A part program as references of axes, by their names in the machine file.

    said     in words, for reports
    file     of the program; None for recorded setpoints, which have none of what follows
    planned  what it came to
    line     of the program by sample, shape (samples,)
    counted  the samples that cut, or without a [process] all that are at a feed, shape (samples,)
    cuts     what the tools do over time, by the section [process]
    process  that section
    """

    references: Mapping[str, Recorded]
    said: str
    file: Path | None = None
    planned: Planned | None = None
    line: np.ndarray | None = None
    counted: np.ndarray | None = None
    cuts: tuple[Cut, ...] = ()
    process: Process | None = None

    def couplings(self, substep: float) -> tuple[Coupling, ...]:
        """The cuts as couplings of a machine with substeps of so many s. Raises ParameterError without x and y."""
        return () if self.process is None else self.process.couplings(self.cuts, tuple(self.references), substep)


def read_planned(section: Section, place: Path, machine: MachineFile, process: Section | None = None) -> PlannedProgram:
    """The program of a section, planned within the limits of the machine and proven, with what it cuts.

    Raises ParameterError or FileError as the sections and their files are wrong, ProgramError at a line of the program,
    NotPlannedError if it is too long or its proof does not hold.
    """
    if "recorded" in section.values:
        if process is not None:
            raise process.error("[process] goes with a part program, whose lines it speaks of, not with recorded = ...")
        return _recorded(section, place, machine)
    section.refuse_unknown((*FILES, *_FLAGS))
    files = {name: _file(section, place, name) for name in FILES}
    inch, skip = (_flag(section, name) for name in _FLAGS)
    program = files["file"]
    if program is None:
        raise section.error('program.file is missing: file = "part.ngc"')
    try:
        limits = planned_limits(machine, files["limits"])
    except FeeddriveError as error:
        raise type(error)(f"{section.where()}: {error}") from None
    T = float(next(iter(machine.loops.values())).sample_time)
    kept: list[np.ndarray] = []
    lines: list[np.ndarray] = []
    moves = read_program(
        program, axes=limits.travel, tools=files["tools"], offsets=files["offsets"], tables_inch=inch, skip_deleted=skip
    )
    with closing(moves):
        said = read_process(process, program)
        setpoints = Setpoints(moves if said is None else said.spindle.noted(moves), limits, T)

        def keep(samples: Samples, _: Sequence[Standstill]) -> None:
            kept.append(samples.values)
            lines.append(np.where(np.isinf(samples.feed), -samples.line, samples.line).astype(np.int32))
            if setpoints.samples > MOST:
                raise NotPlannedError(
                    f"{section.where()}: {program.name} lasts longer than {Quantity(MOST * T, 's'):6 SI}, {MOST:,} "
                    "samples, which a job does not hold in memory: cut the program, or take feeddrive plan for its "
                    "setpoints"
                )
            if not samples.proven:
                raise NotPlannedError(
                    f"{section.where()}: {program.name}: the motion could not be proven to keep its limits: "
                    f"{limits.named(str(setpoints.prover.proof().faults[0]))}. This is a fault of feeddrive, not of "
                    "the program"
                )

        planned = planned_of(setpoints, program.name, machine.name, keep)
    rows, line = np.concatenate(kept), np.concatenate(lines)
    names = {name.upper(): name for name in machine.loops}
    references = {names[letter]: _reference(rows[:, i], T) for i, letter in enumerate(limits.letters)}
    references |= {name: references[leader] for name, leader in machine.followers().items() if leader in references}
    times = np.arange(len(line)) * T
    cuts = () if said is None else said.cuts(times, np.abs(line), line < 0)
    return PlannedProgram(
        references,
        Text(f"part program {program.name}, {planned.blocks:,} blocks in {Quantity(planned.cycle_time, 's'):6 SI}, "
        f"planned and proven"),
        program, planned, np.abs(line), line > 0 if said is None else _cutting(cuts, times), cuts, said,
    )  # fmt: skip


def _cutting(cuts: Sequence[Cut], times: np.ndarray) -> np.ndarray:
    """Whether the tool is in the work at each time."""
    begins = np.array([each.begin for each in cuts])
    depths = np.array([each.axial_depth for each in cuts])
    return depths[np.searchsorted(begins, times + 1e-9, side="right") - 1] > 0.0


def _reference(rows: np.ndarray, T: float) -> Recorded:
    """Position to snap in columns as a reference."""
    position, velocity, acceleration, jerk, snap = (np.ascontiguousarray(each) for each in rows.T)
    return Recorded(
        position=position, velocity=velocity, acceleration=acceleration, jerk=jerk, snap=snap, sample_time=T
    )


def _recorded(section: Section, place: Path, machine: MachineFile) -> PlannedProgram:
    """Setpoints that another planner has recorded, of the axes that have a column."""
    times = {name: key for name in ("sample_time", "average") for key in section.values if key.startswith(name)}
    section.refuse_unknown(("recorded", "columns", *times.values()))
    path = _file(section, place, "recorded")
    assert path is not None
    columns = section.section("columns")
    columns.refuse_unknown(machine.loops)
    file, step = OpenedFile(path), _time(section, times.get("sample_time", ""))
    T = float(next(iter(machine.loops.values())).sample_time)
    references: dict[str, Recorded] = {}
    farthest, rows = 0.0, 0
    for axis, name in columns.values.items():
        if not isinstance(name, str):
            raise columns.error(f"{columns.dotted(axis)} must be the name of a column in quotes", axis)
        log = read_log(file, {"setpoint_position": Column(name=name)}, sample_time=step)
        average = max(1, round((_time(section, times.get("average", "")) or _AVERAGE) / log.sample_time))
        early = reach(average) * log.sample_time  # from rest to rest
        ends = log.sample_time * (len(log) - 1)
        instants = np.arange(samples(ends + 2.0 * early, T)) * T - early
        smooth = smoothed(log["setpoint_position"], log.sample_time, average, instants)
        references[axis] = _reference(smooth, T)
        recorded = np.interp(instants, np.arange(len(log)) * log.sample_time, log["setpoint_position"])
        farthest, rows = max(farthest, float(np.max(np.abs(smooth[:, 0] - recorded)))), average
    if not references:
        raise columns.error(f"{columns.dotted()} names no axis")
    return PlannedProgram(
        references,
        Text(
            f"setpoints recorded in {path.name}, averaged four times over {rows} rows as control points of a spline of "
            f"fifth degree; an axis is at most {Quantity(farthest, 'm')} from the record"
        ),
    )


def _time(section: Section, key: str) -> float | None:
    """A time in s, or in the unit that its key names; None without a key."""
    if not key:
        return None
    value = section.values[key]
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 < value < 1e9:
        raise section.error(f"{section.dotted(key)} must be a time > 0", key)
    unit = key.removeprefix("sample_time").removeprefix("average").lstrip("_")
    try:
        return units.scaled(value, units.factor(unit, "s") if unit else 1.0)
    except ParameterError as error:
        raise section.error(f"{section.dotted(key)}: {error}", key) from None


def _file(section: Section, place: Path, name: str) -> Path | None:
    value = section.values.get(name)
    if value is not None and not isinstance(value, str):
        raise section.error(f'{section.dotted(name)} must be a text in quotes ("...")', name)
    if value is None:
        return None
    beside, bundled = place.parent / value, BUNDLED / "programs" / value
    if beside.exists():
        return beside
    if not bundled.is_file():
        raise section.error(f"{section.dotted(name)} = {value!r}: there is no such file beside the job", name)
    return bundled


def _flag(section: Section, name: str) -> bool:
    value = section.values.get(name, False)
    if not isinstance(value, bool):
        raise section.error(f"{section.dotted(name)} must be true or false", name)
    return value

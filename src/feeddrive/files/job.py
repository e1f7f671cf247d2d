"""A job file: a machine, the motion and loads for its simulation, and the laws to compare.

title = "softer or stiffer"
machine = "my_mill.toml"           # in the directory of the job, or the name of a bundled one
axis = "x"                         # needed if the machine has several axes
seed = 0                           # seed of the noise
rule = "equal gains"               # why the laws are comparable; printed in the report
[reference]                        # the motion: any reference block ...
kind = "snap_limited_move"
[log]                              # ... or a measured log, whose reference is replayed
file = "run.csv"
[program]                          # ... or a part program, which is planned and moves all axes that it names
file = "part.ngc"
[load]                             # a force on the table
kind = "step_force"
[others.y.reference]               # motion of another axis, if the machine is coupled or all axes run;
kind = "linear_move"               # axes without one are at rest; [others.y.load] is a force on the table
[[law]]                            # rows of the comparison; the existing control is always the first
name = "twice the gain"
set = { "axis.x.control.law.Kv" = 80 }   # changes by path, in SI units; or a whole [law.control], [law.axis.y.control]
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, TypeAlias

from feeddrive.blocks.coupling.milling_cut import MillingCut
from feeddrive.blocks.families import Coupling, Load, Reference
from feeddrive.files.machine import MachineFile, find_bundled, read_machine
from feeddrive.files.mapping import LogSection
from feeddrive.files.part_program import PlannedProgram, ProcessSection, ProgramSection, planned_program
from feeddrive.files.read_log import LogRequest, log_request
from feeddrive.files.section import Section, file_name, named, numbers, read_field, read_section, text
from feeddrive.files.toml_file import Key, TomlFile, TomlTable, read_toml
from feeddrive.language import tree
from feeddrive.language.block import Number, choice, declarations, parameter, part
from feeddrive.language.errors import FeeddriveError, FileError, ParameterError, nearest, plain
from feeddrive.language.table import Result, Table
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine, System
from feeddrive.path.kinematics import LINEAR


class Other(Section):
    """The motion and load of an axis other than the compared one; without a reference this axis is at rest."""

    reference: Reference | None = part("its motion", default=None)
    load: Load | None = part("a force on its table", default=None)


class ControlOfAxis(Section):
    """The control that a row of the comparison specifies for another axis."""

    control: Control = part("all that runs on the controller")


class LawSection(Section):
    """A row of the comparison: a name, and the control that it compares with the existing one."""

    exactly: ClassVar[tuple[tuple[str, ...], ...]] = (("set",), ("control", "axis"))
    needs: ClassVar[str] = (
        "a row needs either set = { ... } or sections: [law.control] for the axis of the rows, "
        "[law.axis.NAME.control] for others"
    )

    name: str = text("name of the row; not that of another row, and not 'today'", shortest=1, example='"half the gain"')
    control: Control | None = part("control of the axis of the rows, in place of today's", default=None)
    axis: Mapping[str, ControlOfAxis] | None = named(
        "controls of axes by name: [law.axis.y.control]", least=1, absent=True
    )
    set: Mapping[str, float] | None = numbers(
        'changes of today\'s control by path: { "axis.x.control.law.Kv" = 80 }',
        default=None,
        example="choices need a whole [law.control]",
    )


class JobSection(Section):
    """A job: a machine, its motion and loads, and the laws to compare on it."""

    exactly: ClassVar[tuple[tuple[str, ...], ...]] = (("reference",), ("log",), ("program",))
    needs: ClassVar[str] = "a job needs one of the sections [reference], [log] and [program]"

    title: str | None = text("title of the report", default=None)
    machine: str = file_name("machine file beside the job, or the name of a bundled one", example='"file.toml"')
    axis: str | None = text("name of the axis of the rows, if the machine has several", default=None)
    seed: int = choice("seed of the noise", least=0, most=2**53 - 1, default=0)
    rule: str = text("rule that makes the rows comparable; printed in the report", default="")
    duration: Number | None = parameter("s", "duration of the runs", above=0, below=1e6, default=None)
    reference: Reference | None = part("the motion", default=None)
    load: Load | None = part("a force on the table", default=None)
    others: Mapping[str, Other] = named("motions of the other axes: [others.y.reference]; axes without one stand still")
    log: LogSection | None = part("a measured log, whose reference is replayed", default=None)
    program: ProgramSection | None = part("a part program, planned, which moves all axes that it names", default=None)
    process: ProcessSection | None = part("the cut of the part program", default=None)
    law: tuple[LawSection, ...] = part("rows of the comparison after today's control", default=())

    def check(self) -> None:
        """Raise ParameterError if the job has a section [process] but no part program."""
        if self.process is not None and self.program is None:
            raise self.error("[process] says what a part program cuts, and there is no [program]", "process")


@dataclass(frozen=True, repr=False)
class Job(Result):
    """The content of a job file.

    loops     the loop of the compared axis, by row
    machines  all axes with their couplings, by row, if the axis is coupled or `others` move; otherwise empty
    program   the planned part program that provides the references, if any
    """

    title: str
    rule: str
    machine: MachineFile
    axis: str | None
    seed: int
    duration: float | None
    reference: Reference | None
    load: Load | None
    log: LogRequest | None
    loops: Mapping[str, Loop]
    file: TomlFile
    others: Mapping[str, Other] = field(default_factory=dict[str, Other])
    machines: Mapping[str, Machine] = field(default_factory=dict[str, Machine])
    program: PlannedProgram | None = None

    instead: ClassVar[str] = "fd.run(job) runs a job; its loops stand by row in job.loops"

    def require_axes(self, what: str) -> None:
        """Raise ParameterError for a program that moves the tip of the tool; `what` works on each axis alone."""
        if self.program is not None and self.program.moves_tip and self.program.file is not None:
            raise ParameterError(
                f"{self.file.name}: program.file = {self.program.file.name!r} moves the tip of the tool (G43.4, "
                f"G43.5), and {what} corrects each axis along its own path: give a program of the joints; feeddrive "
                "run judges the tip"
            )

    def table(self) -> Table:
        """Tabulate the laws, one per row, starting with the existing one."""
        work = self.reference.kind if self.reference is not None else "-"
        work = self.program.description if self.program is not None else work
        work = f"log {self.log.path.name}" if self.log is not None else work
        rows = [
            [name, loop.control.law.kind, ", ".join(filter_.kind for filter_ in loop.control.filters) or "-"]
            for name, loop in self.loops.items()
        ]
        title = f"{plain(self.title)}, {self.file.name}: machine {plain(self.machine.name)}, work {work}"
        return Table(title, ["row", "law", "filters"], rows)


JobLike: TypeAlias = str | Path | Job
"""A job file, the name of a bundled job, or a `Job`."""


def read_job(path: JobLike, log: str | Path | None = None) -> Job:
    """Read a job file, given by path or by the name of a bundled job; a Job is also accepted.

    `log` replaces the log file.

    Raises FileError, ParameterError or StructureError with file, line, key and remedy.
    """
    if isinstance(path, Job):
        if log is None:
            return path
        if path.log is None:
            raise ParameterError(f"{path.file.name}: a log was given, but the job has no section [log]")
        return replace(path, log=replace(path.log, path=Path(log)))
    if not isinstance(path, str | Path):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise ParameterError(f"a job is a file, a bundled name or fd.read_job(...), not a {type(path).__name__}")
    place = find_bundled(path, "jobs")
    return job_of(read_toml(place, "a job"), place, log)


def job_of(
    file: TomlFile,
    place: Path,
    log: str | Path | None = None,
    values: Mapping[Key, Any] = MappingProxyType({}),
    reserve: Sequence[float] = (),
) -> Job:
    """Return the job in a parsed TOML file; the files that it names are relative to `place`.

    values   values by key that replace those of the machine file
    reserve  shares of the limits of velocity to snap that a part program keeps back

    Raises the same errors as `read_job`.
    """
    root = file.root()
    root.refuse_unknown(declarations(JobSection))
    # The machine first: the units of all other sections depend on whether its axes are rotary.
    machine = _machine(root, place, values)
    axis = _axis(root, machine)
    section = read_section(JobSection, replace(root, turning=_turning(root, machine, axis)))
    if log is not None and section.log is None:
        raise section.error("a log was given, but the job has no section [log] that assigns its columns")
    others = _others(section, machine, axis)
    program, others = _program(section, place, machine, others, axis, reserve)
    coupled = others or program or machine.coupled(axis)
    together = machine.machine(*_cuts(section, program, machine)) if coupled else None
    if section.log is not None and together is not None:
        raise section.error(
            "log: a log is replayed on one axis alone, here several run together: give a [reference]", "log"
        )
    rows = _laws(section, machine.loops[axis], together)
    return Job(
        title=section.title or place.stem,
        rule=section.rule,
        machine=machine,
        axis=axis,
        seed=section.seed,
        duration=section.duration,
        reference=_reference(section, program, axis),
        load=section.load,
        log=None if section.log is None else log_request(section.log, place, log),
        loops={row: system.loops()[axis] for row, system in rows.items()},
        file=file,
        others=others,
        machines={row: system for row, system in rows.items() if isinstance(system, Machine)},
        program=program,
    )


def _machine(root: TomlTable, place: Path, values: Mapping[Key, Any]) -> MachineFile:
    """Read the machine file named by the job."""
    name = read_field(JobSection, root, "machine")
    beside = place.parent / name
    try:
        return read_machine(beside if beside.is_file() else name, quoting=False, values=values)
    except FileError as error:
        raise type(error)(f"{root.where('machine')}: machine: {error}") from None


def _axis(root: TomlTable, machine: MachineFile) -> str:
    """Return the axis to compare: the named one, the only one or, with a part program, the first one."""
    axis = read_field(JobSection, root, "axis")
    if axis is None and "program" in root.values:
        # A program moves all of its axes in any case: the axis only selects the loop that the rows compare.
        return next(iter(machine.loops))
    try:
        return machine.named(axis)
    except FeeddriveError as error:
        raise root.error(f"axis: {error}", "axis") from None


def _turning(root: TomlTable, machine: MachineFile, axis: str) -> dict[Key, bool]:
    """Return a dict from the key prefix of each section of the job to True if its axis is rotary."""
    turns = {name: loop.axis.rotary for name, loop in machine.loops.items()}
    # A job contains no axis of its own: which of its values are angles follows from the machine.
    turning: dict[Key, bool] = dict.fromkeys((("reference",), ("load",), ("law",)), turns[axis])
    turning |= {("others", name): rotary for name, rotary in turns.items()}
    laws = root.values.get("law")
    for row in range(len(laws) if isinstance(laws, list) else 0):
        turning |= {("law", row, "axis", name): rotary for name, rotary in turns.items()}
    return turning


def _cuts(section: JobSection, program: PlannedProgram | None, machine: MachineFile) -> tuple[Coupling, ...]:
    """Return the cuts of the section [process] as couplings of the machine."""
    process = section.process
    own = next((i for i, coupling in enumerate(machine.couplings) if isinstance(coupling, MillingCut)), None)
    if own is not None and program is not None and program.moves_tip:
        raise section.error(
            f"program: it moves the tip of a tilted tool (G43.4, G43.5), and the forces of a tilted tool are not "
            f"modelled: take couplings.{own}, a milling_cut, out of {machine.file.name}",
            "program",
        )
    if process is None or program is None:
        return ()
    if own is not None:
        raise process.error(
            f"the machine has a cut of its own: couplings.{own} of {machine.file.name} is a milling_cut, and both "
            "forces "
            "would act; take it out of the machine, or leave out [process]"
        )
    try:
        # All axes of a machine have one sample time and substep, so any of them serves.
        loop = next(iter(machine.loops.values()))
        return program.couplings(float(loop.sample_time) / loop.axis.substeps)
    except FeeddriveError as error:
        raise process.error(f"{error}") from None


def _reference(section: JobSection, program: PlannedProgram | None, axis: str) -> Reference | None:
    """Return the reference of the compared axis; None if the reference is replayed from a log."""
    if program is None:
        return section.reference
    if axis not in program.references:
        raise section.error(
            f"axis: a part program does not move axis '{axis}': name one of {', '.join(program.references)}", "axis"
        )
    if program.kinematics is not None and axis.upper() not in LINEAR:
        raise section.error(
            f"axis: '{axis}' turns, and a run along a program is judged at the tip of the tool, in lengths: name x, y "
            f"or z here, and give a job of '{axis}' alone a [reference] for its margins",
            "axis",
        )
    return program.references[axis]


def _program(
    section: JobSection,
    place: Path,
    machine: MachineFile,
    others: dict[str, Other],
    axis: str,
    reserve: Sequence[float],
) -> tuple[PlannedProgram | None, dict[str, Other]]:
    """Return the planned program of a job, if any, and the other axes with the motions that the program gives them."""
    if section.program is None:
        return None, others
    for name, other in others.items():
        if other.reference is not None and len(name) == 1:
            raise section.error(f"others.{name}.reference: the program gives the motions of all axes: leave it out")
    program = planned_program(section.program, place, machine, section.process, reserve)
    moving = {
        name: Other(reference=reference, load=others.get(name, Other()).load)
        for name, reference in program.references.items()
        if name != axis
    }
    return program, {**others, **moving}


def _others(section: JobSection, machine: MachineFile, axis: str) -> dict[str, Other]:
    """Return motions and loads of the other axes. Raise an error for an unknown axis."""
    there = [name for name in machine.loops if name != axis]
    for name, other in section.others.items():
        if name not in there:
            raise other.error(
                f"{other.dotted()}: there is no other axis '{name}' beside '{axis}'{nearest(name, there)}"
            )
    return dict(section.others)


def _laws(job: JobSection, today: Loop, machine: Machine | None) -> dict[str, System]:
    """Return, by row, the loop or the given machine with the existing control and with each law to compare."""
    whole: System = today if machine is None else machine
    rows = {"today": whole}
    for law in job.law:
        if law.name in rows:
            raise law.error(f"{law.dotted('name')} must be a text that no other row has, and not 'today'", "name")
        if law.set is not None:
            rows[law.name] = _varied(law, law.set, whole)
        else:
            controls = _controls(law, today, machine)
            rows[law.name] = controls[today.name] if machine is None else machine.with_loops(controls)
    return rows


def _controls(law: LawSection, today: Loop, machine: Machine | None) -> dict[str, Loop]:
    """Return the loops of those axes for which the row specifies a control."""
    loops = {today.name: today} if machine is None else machine.loops()
    controls = {} if law.control is None else {today.name: _replaced(law, law.dotted("control"), law.control, today)}
    for name, axis in (law.axis or {}).items():
        if name not in loops:
            raise law.error(f"{axis.dotted()}: there is no axis '{name}' in the rows{nearest(name, loops)}", "axis")
        if name in controls:
            raise law.error(f"axis '{name}' is given twice: by [law.control] and by [{axis.dotted()}]", "axis")
        controls[name] = _replaced(axis, axis.dotted("control"), axis.control, loops[name])
    return controls


def _replaced(section: Section, place: str, control: Control, today: Loop) -> Loop:
    """Return the loop with another control; a missing guard or force limit is taken from the existing control."""
    # Safety functions and force limit belong to the drive: a law to be compared must not run without them by omission.
    guard = today.control.guard if control.guard is None else control.guard
    limit = today.control.force_limit if control.force_limit is None else control.force_limit
    try:
        return replace(today, control=replace(control, guard=guard, force_limit=limit))
    except FeeddriveError as error:
        raise section.error(f"{place}: {error}", "control") from None


def _varied(law: LawSection, values: Mapping[str, float], whole: System) -> System:
    """Return the loop or machine of a row that changes parameters of the existing control."""
    places = [loop.place_of("control") for loop in whole.loops().values()]
    if isinstance(whole, Machine):
        places += [f"couplings.{i}" for i, coupling in enumerate(whole.couplings) if coupling.controls]
    for name in values:
        if not name.startswith((*(f"{place}." for place in places), "control.")):
            raise law.error(
                f"'{name}' is not part of the control: a row changes what is under {' or '.join(places)}", "set"
            )
    try:
        return tree.vary(whole, values)
    except FeeddriveError as error:
        raise law.error(f"{law.dotted('set')}: {error}", "set") from None

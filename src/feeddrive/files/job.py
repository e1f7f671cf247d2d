"""A job file: a machine, the motion and loads it is simulated with, and the laws to compare.

title = "softer or stiffer"
machine = "my_mill.toml" # in the directory of the job, or the name of a bundled one
axis = "x"                         # needed if the machine has several
seed = 0                           # of the noise
rule = "equal gains" # what makes the laws comparable; printed in the report
[reference]                        # the work: any reference block ...
kind = "snap_limited_move"
[log]                              # ... or a measured log, whose reference is replayed
file = "run.csv"
[program]                          # ... or a part program, planned, which moves all axes that it names
file = "part.ngc"
[load]                             # a force on the table
kind = "step_force"
[others.y.reference] # of a coupled machine, or to run all axes: motion of another axis;
kind = "linear_move" # axes without one stand still; [others.y.load] is a force on the table
[[law]]                            # rows of the comparison; today's control is always the first
name = "twice the gain"
set = { "axis.x.control.law.Kv" = 80 }   # changes by path, in SI; or a whole [law.control], [law.axis.y.control]
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, TypeAlias

from feeddrive.blocks.coupling.milling_cut import MillingCut
from feeddrive.blocks.families import Load, Reference
from feeddrive.blocks.machine_families import Coupling
from feeddrive.files.blocks_from_toml import read_block
from feeddrive.files.job_log import LogRequest, log_request, whole
from feeddrive.files.job_program import PlannedProgram, read_planned
from feeddrive.files.machine import MachineFile, found, read_machine
from feeddrive.files.toml_file import Key, Section, TomlFile, read_toml
from feeddrive.files.toml_values import optional_text
from feeddrive.language import tree
from feeddrive.language.errors import FeeddriveError, FileError, ParameterError, nearest, plain
from feeddrive.language.table import Result, Table
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine, System

KEYS = (
    "title",
    "machine",
    "axis",
    "seed",
    "rule",
    "duration",
    "reference",
    "load",
    "others",
    "law",
    "log",
    "program",
    "process",
)


@dataclass(frozen=True)
class Other:
    """Motion and load of an axis other than that of the rows; without a reference it stands still."""

    reference: Reference | None = None
    load: Load | None = None


@dataclass(frozen=True, repr=False)
class Job(Result):
    """The content of a job file.

    loops     the axis of the rows, by row
    machines  by row all axes with their couplings, if the axis is coupled or `others` move; else empty
    program   the planned part program that gives the references, if one does
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

    def table(self) -> Table:
        """One row for each law, today's first."""
        work = self.reference.kind if self.reference is not None else "-"
        work = self.program.said if self.program is not None else work
        work = f"log {self.log.path.name}" if self.log is not None else work
        rows = [
            [name, loop.control.law.kind, ", ".join(each.kind for each in loop.control.filters) or "-"]
            for name, loop in self.loops.items()
        ]
        title = f"{plain(self.title)}, {self.file.name}: machine {plain(self.machine.name)}, work {work}"
        return Table(title, ["row", "law", "filters"], rows)


JobLike: TypeAlias = str | Path | Job
"""A job file, the name of a bundled job, or one that was read."""


def read_job(path: JobLike, log: str | Path | None = None) -> Job:
    """The job in a file, the bundled one of that name, or one that was read; `log` replaces its log's file.

    Raises FileError, ParameterError or StructureError with file, line, key and what to do.
    """
    if isinstance(path, Job):
        if log is None:
            return path
        if path.log is None:
            raise ParameterError(f"{path.file.name}: a log was given, but the job has no section [log]")
        return replace(path, log=replace(path.log, path=Path(log)))
    if not isinstance(path, str | Path):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise ParameterError(f"a job is a file, a bundled name or fd.read_job(...), not a {type(path).__name__}")
    place = found(path, "jobs")
    return job_of(read_toml(place, "a job"), place, log)


def job_of(
    file: TomlFile, place: Path, log: str | Path | None = None, values: Mapping[Key, Any] = MappingProxyType({})
) -> Job:
    """The job of a file that was read, at a place beside which the files stand that it names.

    values  of keys of the machine file, in place of what it says

    Raises as `read_job`.
    """
    root = file.root()
    root.refuse_unknown(KEYS)
    machine = _machine(root, place, values)
    name = _axis(root, machine)
    given = [each for each in ("reference", "log", "program") if root.optional(each) is not None]
    if len(given) != 1:
        told = f", not {' and '.join(f'[{each}]' for each in given)}: each gives the reference" if given else ""
        raise root.error(f"a job needs one of the sections [reference], [log] and [program]{told}")
    if root.optional("process") is not None and given[0] != "program":
        raise root.error("[process] says what a part program cuts, and there is no [program]", "process")
    others = _others(root, machine, name)
    program, others = _program(root, place, machine, others, name)
    root = replace(root, turning=machine.loops[name].axis.rotary)
    together = machine.machine(*_cuts(root, program, machine)) if others or program or machine.coupled(name) else None
    rows = _laws(root, machine.loops[name], together)
    request = log_request(root, place, log)
    if request is not None and together is not None:
        raise root.error(
            "log: a log is replayed on one axis alone, here several run together: give a [reference]", "log"
        )
    load = root.optional("load")
    return Job(
        title=optional_text(root, "title") or place.stem,
        rule=optional_text(root, "rule") or "",
        machine=machine,
        axis=name,
        seed=whole(root, "seed", 0),
        duration=_duration(root),
        reference=_reference(root, program, name),
        load=None if load is None else read_block(Load, load),  # type: ignore[type-abstract]
        log=request,
        loops={row: each.loops()[name] for row, each in rows.items()},
        file=file,
        others=others,
        machines={row: each for row, each in rows.items() if isinstance(each, Machine)},
        program=program,
    )


def _axis(root: Section, machine: MachineFile) -> str:
    """The axis of the rows: the one that is named, the only one, or of a part program the first one."""
    axis = optional_text(root, "axis")
    if axis is None and root.optional("program") is not None:
        return next(iter(machine.loops))
    try:
        return machine.named(axis)
    except FeeddriveError as error:
        raise root.error(f"axis: {error}", "axis") from None


def _cuts(root: Section, program: PlannedProgram | None, machine: MachineFile) -> tuple[Coupling, ...]:
    """The cuts of the process, as couplings of the machine."""
    process = root.optional("process")
    if process is None or program is None:
        return ()
    own = next((i for i, each in enumerate(machine.couplings) if isinstance(each, MillingCut)), None)
    if own is not None:
        raise process.error(
            f"the machine cuts by itself: couplings.{own} of {machine.file.name} is a milling_cut, and both forces "
            "would act; take it out of the machine, or leave out [process]"
        )
    try:
        loop = next(iter(machine.loops.values()))
        return program.couplings(float(loop.sample_time) / loop.axis.substeps)
    except FeeddriveError as error:
        raise process.error(f"{error}") from None


def _reference(root: Section, program: PlannedProgram | None, axis: str) -> Reference | None:
    """The motion of the axis of the rows; None for that of a log."""
    section = root.optional("reference")
    if program is None:
        return None if section is None else read_block(Reference, section)  # type: ignore[type-abstract]
    if axis not in program.references:
        raise root.error(
            f"axis: a part program does not move axis '{axis}': name one of {', '.join(program.references)}", "axis"
        )
    return program.references[axis]


def _program(
    root: Section, place: Path, machine: MachineFile, others: dict[str, Other], axis: str
) -> tuple[PlannedProgram | None, dict[str, Other]]:
    """The planned program of a job, if it has one, and the motions of the other axes with those that it moves."""
    section = root.optional("program")
    if section is None:
        return None, others
    for name, other in others.items():
        if other.reference is not None and len(name) == 1:
            raise root.error(f"others.{name}.reference: the program gives the motions of all axes: leave it out")
    found = read_planned(section, place, machine, root.optional("process"))
    moving = {name: each for name, each in found.references.items() if name != axis}
    return found, {**others, **{name: Other(each, others.get(name, Other()).load) for name, each in moving.items()}}


def _machine(root: Section, place: Path, values: Mapping[Key, Any]) -> MachineFile:
    name = optional_text(root, "machine")
    if name is None:
        raise root.error('machine is missing: machine = "file.toml", or the name of a bundled machine')
    beside = place.parent / name
    try:
        return read_machine(beside if beside.exists() else name, quoting=False, values=values)
    except FileError as error:
        raise type(error)(f"{root.where('machine')}: machine: {error}") from None


def _others(root: Section, machine: MachineFile, axis: str) -> dict[str, Other]:
    """Motions and loads of the other axes."""
    section = root.optional("others")
    found: dict[str, Other] = {}
    for name in () if section is None else section.values:
        assert section is not None
        if name not in machine.loops or name == axis:
            there = [each for each in machine.loops if each != axis]
            raise section.error(
                f"{section.dotted(name)}: there is no other axis '{name}' beside '{axis}'{nearest(name, there)}", name
            )
        own = replace(section.section(name), turning=machine.loops[name].axis.rotary)
        own.refuse_unknown(("reference", "load"))
        reference, load = own.optional("reference"), own.optional("load")
        found[name] = Other(
            None if reference is None else read_block(Reference, reference),  # type: ignore[type-abstract]
            None if load is None else read_block(Load, load),  # type: ignore[type-abstract]
        )
    return found


def _laws(root: Section, today: Loop, machine: Machine | None) -> dict[str, System]:
    """The rows: the axis, or with a machine all its axes, under today's control and under the others."""
    whole: System = today if machine is None else machine
    found = {"today": whole}
    for section in root.listed("law"):
        section.refuse_unknown(("name", "control", "axis", "set"))
        name = optional_text(section, "name")
        if not name or name in found:
            raise section.error(
                f"{section.dotted('name')} must be a text that no other row has, and not 'today'", "name"
            )
        controls, changes = _controls(section, today, machine), section.optional("set")
        if bool(controls) == (changes is not None):
            raise section.error(
                f"row '{name}' needs either set = {{ ... }} or sections: [law.control] for the axis of the rows, "
                "[law.axis.NAME.control] for others"
            )
        if changes is not None:
            found[name] = _varied(section, changes, whole)
        else:
            found[name] = controls[today.name] if machine is None else machine.with_loops(controls)
    return found


def _controls(section: Section, today: Loop, machine: Machine | None) -> dict[str, Loop]:
    """The axes of a row that have a control of their own in it."""
    loops = {today.name: today} if machine is None else machine.loops()
    control = section.optional("control")
    found = {} if control is None else {today.name: _replaced(control, today)}
    for name, axis in section.named("axis").items() if section.optional("axis") is not None else ():
        if name not in loops:
            raise section.error(f"{axis.dotted()}: there is no axis '{name}' in the rows{nearest(name, loops)}", "axis")
        if name in found:
            raise section.error(f"axis '{name}' is given twice: by [law.control] and by [{axis.dotted()}]", "axis")
        axis.refuse_unknown(("control",))
        found[name] = _replaced(replace(axis.section("control"), turning=loops[name].axis.rotary), loops[name])
    return found


def _replaced(section: Section, today: Loop) -> Loop:
    """The loop under another control; a row without guard or limit has those of today."""
    control = read_block(Control, section)
    guard = today.control.guard if control.guard is None else control.guard
    limit = today.control.force_limit if control.force_limit is None else control.force_limit
    try:
        return replace(today, control=replace(control, guard=guard, force_limit=limit))
    except FeeddriveError as error:
        raise section.error(f"{section.dotted()}: {error}") from None


def _varied(section: Section, changes: Any, whole: System) -> System:
    values = dict(_flat(changes.values))
    places = [each.place_of("control") for each in whole.loops().values()]
    if isinstance(whole, Machine):
        places += [f"couplings.{i}" for i, each in enumerate(whole.couplings) if each.controls]
    for name, value in values.items():
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise changes.error(f"'{name}' must be a number in SI, not {value!r}: choices need a whole [law.control]")
        if not name.startswith((*(f"{place}." for place in places), "control.")):
            raise changes.error(
                f"'{name}' is not part of the control: a row changes what is under {' or '.join(places)}", name
            )
    try:
        return tree.vary(whole, values)
    except FeeddriveError as error:
        raise changes.error(f"{section.dotted('set')}: {error}") from None


def _flat(values: Mapping[str, Any], prefix: str = "") -> Any:
    """Dotted names, whether they were written in quotes or as nested tables."""
    for key, value in values.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict):
            yield from _flat(value, f"{name}.")
        else:
            yield name, value


def _duration(root: Section) -> float | None:
    value = root.values.get("duration")
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 < float(value) < 1e6:
        raise root.error("duration must be a time in s, > 0 s and < 1e6 s", "duration")
    return float(value)

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
set = { "axis.x.control.law.Kv" = 80 }   # changes by path, in SI; or a whole [law.control]
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, TypeAlias

from feeddrive.blocks.families import Load, Reference
from feeddrive.files.blocks_from_toml import read_block
from feeddrive.files.columns import ROLES, Column
from feeddrive.files.formats import OpenedFile
from feeddrive.files.job_program import PlannedProgram, read_planned
from feeddrive.files.log import Log
from feeddrive.files.machine import MachineFile, found, read_machine
from feeddrive.files.read_log import read_log, unit_at_the_end
from feeddrive.files.toml_file import Section, TomlFile, read_toml
from feeddrive.language import tree, units
from feeddrive.language.errors import FeeddriveError, FileError, LogError, ParameterError, nearest, plain
from feeddrive.language.table import Result, Table
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine, System

_KEYS = ("title", "machine", "axis", "seed", "rule", "duration", "reference", "load", "others", "law", "log", "program")


@dataclass(frozen=True)
class LogRequest:
    """The log to read, and the roles of its columns."""

    path: Path
    channels: Mapping[str, Column]
    optional: Mapping[str, Column]
    skip_samples: int
    sample_time: float | None = None

    def read(self) -> Log:
        """The log, with those optional channels that it has.

        Raises FileError or LogError as `read_log`, and for an injected force without a unit.
        """
        file = OpenedFile(self.path)
        log = read_log(file, self.channels, optional=self.optional, sample_time=self.sample_time)
        named = self.named("load_force")
        told = named is None or named.unit or named.factor is not None or file.columns.units.get(named.name)
        if named is None or told or "load_force" not in log.channels or unit_at_the_end(named.name, "load_force"):
            return log
        raise LogError(
            f"{self.path}: '{named.name}' (load_force) states no unit, and injected signals are logged in N, in V or "
            f"in percent: state it, as load_force = {{ column = '{named.name}', unit = 'N' }}, or give factor = the N "
            f"at the table for each unit of it; a signal that is added to the drive's command, in the command's unit, "
            f"is excitation = '{named.name}'"
        )

    def named(self, role: str) -> Column | None:
        """The column that has a role."""
        return self.channels.get(role) or self.optional.get(role)


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
    program   in words, if the references are those of a part program; else empty
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
    program: str = ""

    instead: ClassVar[str] = "fd.run(job) runs a job; its loops stand by row in job.loops"

    def table(self) -> Table:
        """One row for each law, today's first."""
        work = self.program or (self.reference.kind if self.reference is not None else "-")
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
    file = read_toml(place, "a job")
    root = file.root()
    root.refuse_unknown(_KEYS)
    machine = _machine(root, place)
    axis = _optional_text(root, "axis")
    try:
        name = machine.named(axis)
    except FeeddriveError as error:
        raise root.error(f"axis: {error}", "axis") from None
    given = [each for each in ("reference", "log", "program") if root.optional(each) is not None]
    if len(given) != 1:
        told = f", not {' and '.join(f'[{each}]' for each in given)}: each gives the reference" if given else ""
        raise root.error(f"a job needs one of the sections [reference], [log] and [program]{told}")
    others = _others(root, machine, name)
    program, others = _program(root, place, machine, others, name)
    root = replace(root, turning=machine.loops[name].axis.rotary)
    together = machine.machine() if others or machine.coupled(name) else None
    rows = _laws(root, machine.loops[name], together)
    request = _log(root, place, log)
    if request is not None and together is not None:
        raise root.error(
            "log: a log is replayed on one axis alone, here several run together: give a [reference]", "log"
        )
    load = root.optional("load")
    return Job(
        title=_optional_text(root, "title") or place.stem,
        rule=_optional_text(root, "rule") or "",
        machine=machine,
        axis=axis,
        seed=_whole(root, "seed", 0),
        duration=_duration(root),
        reference=_reference(root, program, name),
        load=None if load is None else read_block(Load, load),  # type: ignore[type-abstract]
        log=request,
        loops={row: each.loops()[name] for row, each in rows.items()},
        file=file,
        others=others,
        machines={row: each for row, each in rows.items() if isinstance(each, Machine)},
        program="" if program is None else program.said,
    )


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
    found = read_planned(section, place, machine)
    moving = {name: each for name, each in found.references.items() if name != axis}
    return found, {**others, **{name: Other(each, others.get(name, Other()).load) for name, each in moving.items()}}


def _machine(root: Section, place: Path) -> MachineFile:
    name = _optional_text(root, "machine")
    if name is None:
        raise root.error('machine is missing: machine = "file.toml", or the name of a bundled machine')
    beside = place.parent / name
    try:
        return read_machine(beside if beside.exists() else name, quoting=False)
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
        section.refuse_unknown(("name", "control", "set"))
        name = _optional_text(section, "name")
        if not name or name in found:
            raise section.error(
                f"{section.dotted('name')} must be a text that no other row has, and not 'today'", "name"
            )
        control, changes = section.optional("control"), section.optional("set")
        if (control is None) == (changes is None):
            raise section.error(f"row '{name}' needs either a section [law.control] or set = {{ ... }}")
        if control is not None:
            other = _replaced(control, today)
            found[name] = other if machine is None else machine.with_loops({today.name: other})
        else:
            found[name] = _varied(section, changes, whole)
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


def read_request(path: str | Path, log: str | Path | None = None) -> LogRequest:
    """The section [log] of a TOML file, that of a job or one that `Guess.toml` wrote: the roles of a log's columns.

    `log` replaces the log's file.  Raises FileError or ParameterError with file, line, key and what to do.
    """
    root = read_toml(path).root()
    request = _log(root, Path(path), log)
    if request is None:
        raise root.error("section [log] is missing; print(guess_roles(read_log(file)).toml()) shows one")
    return request


def _log(root: Section, place: Path, given: str | Path | None) -> LogRequest | None:
    section = root.optional("log")
    if section is None:
        if given is not None:
            raise root.error("a log was given, but the job has no section [log] that assigns its columns")
        return None
    step = [key for key in section.values if key == "sample_time" or key.startswith("sample_time_")]
    section.refuse_unknown(("file", "channels", "optional", "skip_samples", "sample_time", *step))
    name = _optional_text(section, "file")
    if given is None and name is None:
        raise section.error('log.file is missing: file = "run.csv", or give the log on the command line')
    path = Path(given) if given is not None else place.parent / str(name)
    return LogRequest(
        path,
        _channels(section, "channels"),
        _channels(section, "optional"),
        _whole(section, "skip_samples", 0),
        _step(section, step[0]) if step else None,
    )


def _step(section: Section, key: str) -> float:
    """The sample time of a log without a column of time, in s or in the unit that the key names."""
    value = section.values[key]
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 < value < 1e9:
        raise section.error(f"{section.dotted(key)} must be a time > 0", key)
    try:
        return units.scaled(value, 1.0 if key == "sample_time" else units.factor(key.removeprefix("sample_time_"), "s"))
    except ParameterError as error:
        raise section.error(f"{section.dotted(key)}: {error}", key) from None


def _channels(section: Section, name: str) -> dict[str, Column]:
    channels = section.optional(name)
    if channels is None:
        return {}
    channels.refuse_unknown(ROLES)
    return {role: _column(channels, role, value) for role, value in channels.values.items()}


def _column(channels: Section, role: str, value: Any) -> Column:
    """A column's name, or { column = "x", unit = "mm" }, or { column = "x", factor = 1e-3 }."""
    if isinstance(value, str):
        return Column(name=value)
    wanted = 'must be the name of a column, or { column = "name", unit = "mm" }, or { column = "name", factor = 0.001 }'
    if not isinstance(value, dict) or not isinstance(value.get("column"), str):
        raise channels.error(f"{channels.dotted(role)} {wanted}", role)
    channels.section(role).refuse_unknown(("column", "unit", "factor"))
    unit, factor = value.get("unit", ""), value.get("factor")
    number = factor is None or (isinstance(factor, (int, float)) and not isinstance(factor, bool))
    if not isinstance(unit, str) or not number:
        raise channels.error(f"{channels.dotted(role)} {wanted}", role)
    try:
        return Column(name=value["column"], unit=unit, factor=None if factor is None else float(factor)).checked(role)
    except (ParameterError, OverflowError) as error:
        raise channels.error(f"{channels.dotted(role)}: {error}", role) from None


def _optional_text(section: Section, name: str) -> str | None:
    value = section.values.get(name)
    if value is not None and not isinstance(value, str):
        raise section.error(f'{section.dotted(name)} must be a text in quotes ("...")', name)
    return value


def _whole(section: Section, name: str, default: int) -> int:
    value = section.values.get(name, default)
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**53:
        raise section.error(f"{section.dotted(name)} must be a whole number, 0 <= {name} < 2^53", name)
    return value


def _duration(root: Section) -> float | None:
    value = root.values.get("duration")
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 < float(value) < 1e6:
        raise root.error("duration must be a time in s, > 0 s and < 1e6 s", "duration")
    return float(value)

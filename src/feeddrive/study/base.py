"""The starting point of the variants of a study: one job per combination of choices, and its nominal numbers."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from feeddrive.blocks.families import Load, Reference
from feeddrive.blocks.reference.linear_move import LinearMove
from feeddrive.files.from_toml import read_section
from feeddrive.files.job import Job, JobSection, Other, job_of
from feeddrive.files.machine import find_bundled
from feeddrive.files.toml_edit import with_values
from feeddrive.files.toml_file import Key, TomlFile, TomlTable, read_toml
from feeddrive.language import tree
from feeddrive.language.block import Block, Declaration, declarations
from feeddrive.language.errors import FeeddriveError, FileError, ParameterError, nearest, shown
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine, System
from feeddrive.study.vary import VaryChoice


@dataclass(frozen=True, eq=False)
class Base:
    """A row of a job: its system at nominal numbers, with the motion and the loads of all axes."""

    job: Job
    row: str

    @property
    def system(self) -> System:
        """The loop of the row, or the machine if the axes run together."""
        return self.job.machines.get(self.row, self.job.loops[self.row])

    @property
    def loop(self) -> Loop:
        """The loop of the row's axis alone."""
        return self.job.loops[self.row]

    @property
    def axis(self) -> str:
        """The name of the row's axis."""
        return self.loop.name

    @property
    def moved(self) -> dict[str, Other]:
        """The motion and load of each axis, by name."""
        return {self.axis: Other(reference=self.job.reference, load=self.job.load), **self.job.others}

    def references(self, changed: dict[str, Other] | None = None) -> Reference | dict[str, Reference]:
        """Return the motion as `simulate` takes it; axes without a motion stand still."""
        moved = self.moved if changed is None else changed
        own = moved[self.axis].reference
        assert own is not None
        if not isinstance(self.system, Machine):
            return own
        still = LinearMove(distance=0.0, travel_time=max(own.duration, float(self.system.sample_time)))
        return {axis: (moved[axis].reference or still) if axis in moved else still for axis in self.system.axes()}

    def loads(self, changed: dict[str, Other] | None = None) -> Load | dict[str, Load] | None:
        """Return the forces on the tables as `simulate` takes them."""
        moved = self.moved if changed is None else changed
        if not isinstance(self.system, Machine):
            return moved[self.axis].load
        return {axis: other.load for axis, other in moved.items() if other.load is not None} or None

    def place(self, path: str) -> tuple[str, str, str]:
        """Split the path of a motion or load into axis, "reference" or "load", and remaining path.

        The axis is empty for other paths.
        """
        first, _, rest = path.partition(".")
        if first in ("reference", "load"):
            return self.axis, first, rest
        if first == "others":
            axis, _, inside = rest.partition(".")
            kind, _, rest = inside.partition(".")
            if axis not in self.job.others or kind not in ("reference", "load"):
                raise ParameterError(f"there is no '{path}': others.NAME.reference and others.NAME.load of the job")
            return axis, kind, rest
        return "", "", path

    def block(self, path: str) -> tuple[Any, str]:
        """Return the block that a path belongs to, and the path within it. Raise ParameterError if there is none."""
        axis, kind, rest = self.place(path)
        if not kind:
            return self.system, path
        block = getattr(self.moved[axis], kind)
        if block is None:
            raise ParameterError(f"there is no '{path}': {self.job.file.name} has no [{path.rpartition('.')[0]}]")
        return block, rest

    def declaration(self, path: str) -> Declaration:
        """Return the declaration of a path. Raise ParameterError, naming the row, for an unknown path."""
        block, rest = self.block(path)
        try:
            own = tree.declaration(block, rest)
        except FeeddriveError as error:
            raise type(error)(f"{error} (row '{self.row}' of {self.job.file.name})") from None
        if not isinstance(block, Block):
            return own
        return own.of_axis(self.loop.axis.rotary and block is not self.system)

    def nominal(self, path: str) -> float:
        """Return the nominal value of a path. Raise ParameterError for a path that is unknown or has no value."""
        block, rest = self.block(path)
        value = tree.get(block, rest)
        if value is None:
            raise ParameterError(f"'{path}' has no value in {self.job.machine.file.name}")
        return float(value)

    def blocks(self) -> Iterator[Block]:
        """Yield the system, then the motions and loads of all axes."""
        yield self.system
        for other in self.moved.values():
            yield from (block for block in (other.reference, other.load) if block is not None)


MOST_JOBS = 256  # combinations of choices


def choices_in(root: TomlTable) -> list[VaryChoice]:
    """Return the `[[vary]]` sections with a choice, which must be read before the jobs."""
    return [read_section(VaryChoice, table) for table in root.listed("vary") if "choice" in table.values]


def read_jobs(
    root: TomlTable, place: Path, job: str | None, of_study: Collection[str], choices: Sequence[VaryChoice]
) -> dict[tuple[Any, ...], Job]:
    """Return the job for each combination of choices.

    job       the job file; None if its keys are in the study file
    of_study  the keys that belong to the study only
    """
    file, beside = _job_file(root, place, job, of_study)
    choices = [choice for choice in choices if choice.choice != "row"]
    keys, rows = [_key(choice.choice) for choice in choices], [choice.values for choice in choices]
    count = math.prod(map(len, rows))
    if count > MOST_JOBS:
        raise root.error(f"the choices have {count:,} combinations, each of which is read: at most {MOST_JOBS}", "vary")
    return {tuple(values): _job(root, choices, keys, values, file, beside) for values in itertools.product(*rows)}


def _job_file(root: TomlTable, place: Path, name: str | None, of_study: Collection[str]) -> tuple[TomlFile, Path]:
    """Return the job file and its path; if the study holds the job's keys, the study file without its own keys."""
    if name is None:
        content = {key: value for key, value in root.values.items() if key not in of_study}
        return replace(root.file, content=content), place
    beside = place.parent / name
    try:
        path = beside if beside.exists() else find_bundled(name, "jobs")
        return read_toml(path, "a job", quoting=False), path
    except FileError as error:
        raise type(error)(f"{root.where('job')}: job: {error}") from None


def _key(text: str) -> Key:
    return tuple(int(part) if part.isdigit() else part for part in text.split("."))


def _job(
    root: TomlTable,
    choices: Sequence[VaryChoice],
    keys: Sequence[Key],
    values: Sequence[Any],
    file: TomlFile,
    place: Path,
) -> Job:
    """Return the job with the given values of the choices."""
    by_key = dict(zip(keys, values, strict=True))
    of_job = {key: value for key, value in by_key.items() if _is_of_job(key)}
    of_machine = {key: value for key, value in by_key.items() if key not in of_job}
    try:
        job = job_of(with_values(file, of_job), place, values=of_machine)
    except FeeddriveError as error:
        if not by_key:
            raise
        stated = ", ".join(f"{choice.choice} = {shown(value)}" for choice, value in zip(choices, values, strict=True))
        raise choices[0].error(f"with {stated}: {error}", kind=type(error)) from None
    if job.log is not None:
        raise root.error(
            f"{job.file.name} replays a log, which has one machine: a study needs [reference] or [program]"
        )
    return job


def _is_of_job(key: Key) -> bool:
    """Return True for a key of the job file; `axis` alone is an axis name there, otherwise a section of the machine."""
    return key == ("axis",) or (key[0] in declarations(JobSection) and key[0] != "axis")


def check_rows(root: TomlTable, jobs: Mapping[tuple[Any, ...], Job], row: str, choices: Sequence[VaryChoice]) -> None:
    """Raise ParameterError for a row that is missing from one of the jobs."""
    asked: list[tuple[TomlTable | VaryChoice, str, Any]] = [(root, "row", row)]
    asked += [(choice, "values", value) for choice in choices if choice.choice == "row" for value in choice.values]
    for job in jobs.values():
        for place, key, name in asked:
            if name not in job.loops:
                raise place.error(
                    f"{key}: there is no row {shown(name)} in {job.file.name}{nearest(str(name), job.loops)}", key
                )

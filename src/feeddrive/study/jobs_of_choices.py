"""The job of a study, once for each combination of choices that are read into its files."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from feeddrive.files.from_toml import read_section
from feeddrive.files.job import Job, JobSection, job_of
from feeddrive.files.machine import find_bundled
from feeddrive.files.toml_file import Key, TomlFile, TomlTable, read_toml
from feeddrive.files.toml_values import with_values
from feeddrive.language.declaration import declarations
from feeddrive.language.errors import FeeddriveError, FileError, nearest, shown
from feeddrive.study.vary_sections import VaryChoice

MOST_JOBS = 256  # combinations of choices


def choices_in(root: TomlTable) -> list[VaryChoice]:
    """The sections [[vary]] with a choice, which must be read before the jobs."""
    return [read_section(VaryChoice, table) for table in root.listed("vary") if "choice" in table.values]


def read_jobs(
    root: TomlTable, place: Path, job: str | None, of_study: Collection[str], choices: Sequence[VaryChoice]
) -> dict[tuple[Any, ...], Job]:
    """The job for each combination of choices.

    job       file of the job; None where its keys stand in the study
    of_study  keys of the study alone
    """
    file, beside = _job_file(root, place, job, of_study)
    choices = [choice for choice in choices if choice.choice != "row"]
    keys, rows = [_key(choice.choice) for choice in choices], [choice.values for choice in choices]
    count = math.prod(map(len, rows))
    if count > MOST_JOBS:
        raise root.error(f"the choices have {count:,} combinations, each of which is read: at most {MOST_JOBS}", "vary")
    return {tuple(values): _job(root, choices, keys, values, file, beside) for values in itertools.product(*rows)}


def _job_file(root: TomlTable, place: Path, name: str | None, of_study: Collection[str]) -> tuple[TomlFile, Path]:
    """The job file and its path; for a study that holds the keys of a job, the study file without its own keys."""
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
    """The job with the values of the choices."""
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
    """True if a key stands in the job file; `axis` is the name of an axis there, and a section of the machine file."""
    return key == ("axis",) or (key[0] in declarations(JobSection) and key[0] != "axis")


def check_rows(root: TomlTable, jobs: Mapping[tuple[Any, ...], Job], row: str, choices: Sequence[VaryChoice]) -> None:
    """Raise ParameterError for a row that a job does not have."""
    asked: list[tuple[TomlTable | VaryChoice, str, Any]] = [(root, "row", row)]
    asked += [(choice, "values", value) for choice in choices if choice.choice == "row" for value in choice.values]
    for job in jobs.values():
        for place, key, name in asked:
            if name not in job.loops:
                raise place.error(
                    f"{key}: there is no row {shown(name)} in {job.file.name}{nearest(str(name), job.loops)}", key
                )

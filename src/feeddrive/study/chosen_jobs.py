"""The job of a study, once for each combination of choices that are read into its files."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from feeddrive.files.job import KEYS, Job, job_of
from feeddrive.files.machine import found
from feeddrive.files.toml_file import Key, Section, TomlFile, read_toml
from feeddrive.files.toml_values import optional_text, with_values
from feeddrive.language.errors import FeeddriveError, FileError, nearest, shown

MOST_JOBS = 256  # combinations of choices
STUDY_KEYS = ("job", "row", "sampler", "count", "chunk", "noise", "measure", "specification", "vary")


def read_jobs(root: Section, place: Path, inline: bool) -> dict[tuple[Any, ...], Job]:
    """The job for each combination of choices."""
    file, beside = _job_file(root, place, inline)
    sections = [each for each in root.listed("vary") if each.values.get("choice", "row") != "row"]
    keys, rows = [], list[list[Any]]()
    for each in sections:
        key, values = each.values["choice"], each.values.get("values")
        if not isinstance(key, str) or not isinstance(values, list):
            raise each.error('a choice is a key with its values: choice = "machine", values = ["a.toml", "b.toml"]')
        keys.append(_key(key))
        rows.append(values)
    count = math.prod(map(len, rows))
    if count > MOST_JOBS:
        raise root.error(f"the choices have {count:,} combinations, each of which is read: at most {MOST_JOBS}", "vary")
    return {tuple(values): _job(root, sections, keys, values, file, beside) for values in itertools.product(*rows)}


def _job_file(root: Section, place: Path, inline: bool) -> tuple[TomlFile, Path]:
    """The job file, and where it is; of a study with the keys of a job this file without its own."""
    if inline:
        content = {key: value for key, value in root.values.items() if key not in STUDY_KEYS}
        return replace(root.file, content=content), place
    name = optional_text(root, "job")
    assert name is not None
    beside = place.parent / name
    try:
        given = beside if beside.exists() else found(name, "jobs")
        return read_toml(given, "a job", quoting=False), given
    except FileError as error:
        raise type(error)(f"{root.where('job')}: job: {error}") from None


def _key(text: str) -> Key:
    return tuple(int(part) if part.isdigit() else part for part in text.split("."))


def _job(
    root: Section, sections: Sequence[Section], keys: Sequence[Key], values: Sequence[Any], file: TomlFile, place: Path
) -> Job:
    """The job with the values of the choices."""
    given = dict(zip(keys, values, strict=True))
    of_job = {key: value for key, value in given.items() if _is_of_job(key)}
    of_machine = {key: value for key, value in given.items() if key not in of_job}
    try:
        job = job_of(with_values(file, of_job), place, values=of_machine)
    except FeeddriveError as error:
        if not given:
            raise
        said = ", ".join(
            f"{each.values['choice']} = {shown(value)}" for each, value in zip(sections, values, strict=True)
        )
        raise type(error)(f"{sections[0].where()}: with {said}: {error}") from None
    if job.log is not None:
        raise root.error(
            f"{job.file.name} replays a log, which has one machine: a study needs [reference] or [program]"
        )
    return job


def _is_of_job(key: Key) -> bool:
    """Whether a key stands in the job file; `axis` is the name of an axis there, and a section of the machine file."""
    return key == ("axis",) or (key[0] in KEYS and key[0] != "axis")


def check_rows(root: Section, jobs: Mapping[tuple[Any, ...], Job], row: Any) -> None:
    """Raise ParameterError for a row that a job does not have."""
    asked = [(root, "row", row)]
    for each in root.listed("vary"):
        if each.values.get("choice") == "row":
            values = each.values.get("values")
            asked += [(each, "values", value) for value in (values if isinstance(values, list) else [])]
    for job in jobs.values():
        for section, key, name in asked:
            if name not in job.loops:
                raise section.error(
                    f"{key}: there is no row {shown(name)} in {job.file.name}{nearest(str(name), job.loops)}", key
                )

"""A study file: a job, what varies in it, and what is measured of every variant.

title = "A series of ball-screw axes"
job = "ball_screw"                 # a job file beside this one, or a bundled one; or all keys of a job here
row = "today"                      # which of its laws
sampler = "sobol"                  # grid, latin_hypercube, sobol, monte_carlo or saltelli
count = 200                        # variants; of saltelli the points, each of which has k + 2 variants; none of a grid
seed = 15
measure = ["following_error_rms_m", "stiffness_least_N_per_m"]
[specification]                    # what makes a good machine
following_error_peak_m = { most_um = 8 }
sensitivity_peak = { most = 2 }
[[vary]]                           # see `vary_section.py`
parameter = "axis.x.plant.mass_load"
tolerance_percent = 10
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, TypeAlias

import numpy as np

from feeddrive.figures.figure import Figure
from feeddrive.files.job import KEYS as JOB_KEYS
from feeddrive.files.job import Job
from feeddrive.files.job_log import optional_text, whole
from feeddrive.files.machine import found
from feeddrive.files.toml_file import Section, TomlFile, read_toml
from feeddrive.language import tree
from feeddrive.language.declaration import Declaration
from feeddrive.language.errors import ParameterError, plain, shown
from feeddrive.language.table import Result, Table
from feeddrive.study.base import Base
from feeddrive.study.chosen_jobs import STUDY_KEYS, check_rows, read_jobs
from feeddrive.study.points import BITS
from feeddrive.study.specification import Bound, read_measure, read_specification
from feeddrive.study.vary import Choice, Varied
from feeddrive.study.vary_section import read_varied

SAMPLERS = ("grid", "latin_hypercube", "sobol", "monte_carlo", "saltelli")
MOST = 2**BITS  # variants: where the sequences of Sobol end
_COMMON_KEYS = ("title", "seed")
_NOISE = ("same", "each")


@dataclass(frozen=True, repr=False, eq=False)
class Study(Result):
    """The content of a study file.

    row      the law of the job that runs, where no choice says otherwise
    points   of the sampler; `count` is the number of variants in all, `chunk` of those that are computed together
    noise    "same": all variants have the noise of one seed; "each": every one its own
    jobs     the job by the values of the choices, in their order, but for rows
    stream   0 in a file; with 1, 2, ... other variants of the same distributions, independent of these
    digest   SHA-256 of all that the rows depend on: this file, and what the numbers of job and machine came to
    """

    title: str
    file: TomlFile
    sampler: str
    seed: int
    points: int
    count: int
    chunk: int
    row: str
    noise: str
    vary: tuple[Varied, ...]
    measure: tuple[Figure, ...]
    specification: tuple[Bound, ...]
    jobs: Mapping[tuple[Any, ...], Job]
    digest: str
    stream: int = 0

    instead: ClassVar[str] = "feeddrive sweep runs a study"

    @property
    def text(self) -> str:
        """The text of the study file."""
        return self.file.text

    @cached_property
    def columns(self) -> Mapping[str, str]:
        """SI unit by column of what varies, in the order of the file."""
        return {name: unit for each in self.vary for name, unit in each.columns.items()}

    @property
    def chunks(self) -> int:
        """How many chunks there are."""
        return -(-self.count // self.chunk)

    def range(self, number: int) -> range:
        """The variants of a chunk. Raises ParameterError for one that is not there."""
        if not 0 <= number < self.chunks:
            raise ParameterError(f"{self.file.name} has chunks 0 to {self.chunks - 1}, and no {number}")
        return range(number * self.chunk, min((number + 1) * self.chunk, self.count))

    @property
    def choices(self) -> tuple[Choice, ...]:
        """What is read into the files for each combination."""
        return tuple(each for each in self.vary if isinstance(each, Choice))

    def base(self, values: Mapping[str, Any]) -> Base:
        """What variants with these values of the choices start from, by their keys."""
        job = self.jobs[tuple(values[each.key] for each in self.choices if each.key != "row")]
        return Base(job, values.get("row", self.row))

    def bases(self) -> Iterator[Base]:
        """All of them."""
        rows = [value for each in self.choices if each.key == "row" for value in each.distribution.values]
        for job in self.jobs.values():
            for row in rows or [self.row]:
                yield Base(job, row)

    @property
    def rotary(self) -> bool:
        """Whether the axis of the rows turns."""
        base = next(self.bases())
        return base.loop.axis.rotary

    def table(self) -> Table:
        """What varies, one row each."""
        rows = [[each.name, unit or "1", type(each).__name__.lower()] for each in self.vary
                for unit in each.columns.values()]  # fmt: skip
        said = f"{plain(self.title)}, {self.file.name}: {self.count:,} variants, {self.sampler}, seed {self.seed}"
        return Table(said, ["varies", "unit", "as"], rows)


StudyLike: TypeAlias = str | Path | Study
"""A study file, the name of a bundled study, or one that was read."""


def read_study(path: StudyLike, allow: Sequence[str] = ()) -> Study:
    """The study in a file, the bundled one of that name, or one that was read.

    allow  modules whose figures it may measure

    Raises FileError, ParameterError or StructureError with file, line, key and what to do.
    """
    if isinstance(path, Study):
        return path
    if not isinstance(path, str | Path):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise ParameterError(f"a study is a file, a bundled name or a Study, not a {type(path).__name__}")
    place = found(path, "studies")
    file = read_toml(place, "a study")
    root = file.root()
    inline = root.values.get("job") is None
    root.refuse_unknown((*STUDY_KEYS, *_COMMON_KEYS, *(JOB_KEYS if inline else ())))
    sampler = root.values.get("sampler", "monte_carlo")
    if sampler not in SAMPLERS:
        raise root.error(f"sampler = {shown(sampler)} must be one of {', '.join(SAMPLERS)}", "sampler")
    jobs = read_jobs(root, place, inline)
    row = root.values.get("row", "today")
    check_rows(root, jobs, row)
    made = Study(
        title=optional_text(root, "title") or place.stem,
        file=file,
        sampler=sampler,
        seed=whole(root, "seed", 0),
        points=0,
        count=0,
        chunk=0,
        row=row,
        noise=_noise(root),
        vary=(),
        measure=(),
        specification=(),
        jobs=jobs,
        digest="",
    )
    made = replace(made, vary=_vary(root, made))
    points, count = _counts(root, made)
    bounds = read_specification(root, allow)
    measured = read_measure(root, allow, bounds)
    made = replace(made, points=points, count=count, chunk=_chunk(root, count), measure=measured, specification=bounds)
    return replace(made, digest=_digest(made))


def _noise(root: Section) -> str:
    noise = root.values.get("noise", "same")
    if noise not in _NOISE:
        raise root.error(f"noise = {shown(noise)} must be one of {', '.join(_NOISE)}", "noise")
    return noise


def _vary(root: Section, study: Study) -> tuple[Varied, ...]:
    sections = root.listed("vary")
    if not sections:
        raise root.error("a study needs a section [[vary]]: what differs from variant to variant")
    # the rows are known, but not yet which of them vary
    rows = [value for each in sections if each.values.get("choice") == "row" for value in each.values.get("values", ())]
    bases = [Base(job, row) for job in study.jobs.values() for row in rows or [study.row]]

    def declared(path: str) -> Declaration:
        found = [base.declaration(path) for base in bases]  # it must be there in all of them
        return found[0]

    made: list[Varied] = []
    for section in sections:
        each = read_varied(section, declared, bases[0].nominal, study.sampler == "grid")
        before = {name for other in made for name in (*other.columns, *other.paths)}
        twice = sorted(before & {*each.columns, *each.paths})
        if twice:
            raise section.error(f"'{twice[0]}' varies twice: by {section.dotted()} and by a section before it")
        made.append(each)
    return tuple(made)


def _counts(root: Section, study: Study) -> tuple[int, int]:
    """Points of the sampler and variants in all."""
    given = root.values.get("count")
    if study.sampler == "grid":
        if given is not None:
            raise root.error(
                "count does not go with a grid, whose variants are all combinations of its values", "count"
            )
        points = 1
        for each in study.vary:
            levels = each.levels
            assert levels is not None
            points *= len(levels)
        key = "vary"
    else:
        if isinstance(given, bool) or not isinstance(given, int):
            raise root.error("count must be a whole number: how many variants there are", "count")
        points, key = given, "count"
    each = len(study.vary) + 2 if study.sampler == "saltelli" else 1
    count = points * each
    if points < 1:
        raise root.error(f"count = {points} must be >= 1: a study has at least one variant", key)
    if count > MOST:
        raise root.error(
            f"these are {count:,} variants, more than {MOST:,} (2^{BITS}), where the sequences of the samplers end: "
            "take fewer; a yield from a million variants has an error below 0.1 %",
            key,
        )
    if study.sampler == "saltelli" and points & (points - 1):
        near = 1 << points.bit_length()
        raise root.error(
            f"count = {points} points of the sampler saltelli must be a power of 2, such as {near // 2} or {near}", key
        )
    return points, count


def _chunk(root: Section, count: int) -> int:
    """Variants of a chunk: multiples of 16, so that vectors are full, and some 16 chunks or more."""
    given = root.values.get("chunk")
    if given is None:
        return max(16, min(1024, 16 * -(-count // 256)))
    if isinstance(given, bool) or not isinstance(given, int) or not 1 <= given <= 1_000_000:
        raise root.error(f"chunk = {shown(given)} must be a whole number of variants, 1 to 1,000,000", "chunk")
    return given


def _digest(study: Study) -> str:
    """SHA-256 of the text, and of structure and numbers of every system, reference and load."""
    made = hashlib.sha256(study.text.encode())
    for values in study.jobs:
        made.update(repr(values).encode())
    for base in study.bases():
        for each in base.blocks():
            made.update(repr(tree.structure(each)).encode())
            for name, leaf in (*tree.leaves(each), *tree.tables(each)):
                made.update(name.encode() + np.asarray(leaf, dtype=np.float64).tobytes())
        made.update(repr((base.row, base.job.seed, base.job.duration)).encode())
    return made.hexdigest()

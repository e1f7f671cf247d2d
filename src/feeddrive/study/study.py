"""A study file: a job, what varies in it, the figures to measure, and the specification of a good machine.

title = "A series of ball-screw axes"
job = "ball_screw"                 # a job file next to this one, or a bundled one; or write all keys of a job here
row = "today"                      # one of its laws
sampler = "sobol"                  # grid, latin_hypercube, sobol, monte_carlo or saltelli
count = 200                        # variants; saltelli: points of k + 2 variants each; not for a grid
seed = 15
measure = ["following_error_rms_m", "stiffness_least_N_per_m"]
[specification]                    # requirements on a good machine
following_error_peak_m = { most_um = 8 }
sensitivity_peak = { most = 2 }
[[vary]]                           # see `vary.py`
parameter = "axis.x.plant.mass_load"
tolerance_percent = 10

A base is the starting point of variants: a row of a job at nominal values.  There is one base for each combination of
choices.
"""

import hashlib
import itertools
import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, TypeAlias

import numpy as np

from feeddrive.blocks.families import Load, Reference
from feeddrive.blocks.reference.linear_move import LinearMove
from feeddrive.figures.catalogue import figure
from feeddrive.figures.figure import Figure
from feeddrive.files.job import Job, JobSection, Other, job_of
from feeddrive.files.machine import find_bundled
from feeddrive.files.section import VARIED, Section, file_name, named, read_field, read_section, text
from feeddrive.files.toml_file import Key, TomlFile, TomlTable, key_of, read_toml, with_values
from feeddrive.language import tree
from feeddrive.language.block import Block, Declaration, Number, choice, declarations, parameter, part
from feeddrive.language.errors import FeeddriveError, FileError, ParameterError, nearest, plain, shown
from feeddrive.language.quantity import number
from feeddrive.language.table import Result, Table
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine, System
from feeddrive.study.distributions import BITS
from feeddrive.study.vary import Choice, Varied, VaryChoice, VarySection, unit_varied, varied


@dataclass(frozen=True, eq=False)
class Base:
    """A row of a job: its system at nominal values, with the motions and loads of all axes."""

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
        """Return the motions in the form that `simulate` accepts; axes without a motion remain at standstill."""
        moved = self.moved if changed is None else changed
        own = moved[self.axis].reference
        assert own is not None
        if not isinstance(self.system, Machine):
            return own
        # A move needs a positive time, also beside a motion without a duration.
        still = LinearMove(distance=0.0, travel_time=max(own.duration, float(self.system.sample_time)))
        return {axis: (moved[axis].reference or still) if axis in moved else still for axis in self.system.axes()}

    def loads(self, changed: dict[str, Other] | None = None) -> Load | dict[str, Load] | None:
        """Return the forces on the tables in the form that `simulate` accepts."""
        moved = self.moved if changed is None else changed
        if not isinstance(self.system, Machine):
            return moved[self.axis].load
        return {axis: other.load for axis, other in moved.items() if other.load is not None} or None

    def place(self, path: str) -> tuple[str, str, str]:
        """Split the path of a motion or load into the axis, "reference" or "load", and the remaining path.

        For other paths, the first two are empty and the third is the whole path.
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
        """Return the block to which a path belongs, and the path within it. Raise ParameterError if there is none."""
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
        # Only a system contains its axis; a motion or a load does not, so its units follow from that of the row.
        return own.of_axis(self.loop.axis.rotary and block is not self.system)

    def nominal(self, path: str) -> float:
        """Return the nominal value of a path. Raise ParameterError for a path that is unknown or has no value."""
        block, rest = self.block(path)
        value = tree.get(block, rest)
        if value is None:
            raise ParameterError(f"'{path}' has no value in {self.job.machine.file.name}")
        return float(value)

    def blocks(self) -> Iterator[Block]:
        """Yield the system, then the motion and the load of each axis."""
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

    job       the name of the job file; None if the study file contains the keys of the job
    of_study  the keys of the study file that do not belong to the job
    """
    file, beside = _job_file(root, place, job, of_study)
    # A row is a law within one job and needs no file of its own.
    choices = [choice for choice in choices if choice.choice != "row"]
    keys, rows = [key_of(choice.choice) for choice in choices], [choice.values for choice in choices]
    # Counted before the product is formed: each combination reads the files again.
    count = math.prod(map(len, rows))
    if count > MOST_JOBS:
        raise root.error(f"the choices have {count:,} combinations, each of which is read: at most {MOST_JOBS}", "vary")
    return {tuple(values): _job(root, choices, keys, values, file, beside) for values in itertools.product(*rows)}


def _job_file(root: TomlTable, place: Path, name: str | None, of_study: Collection[str]) -> tuple[TomlFile, Path]:
    """Return the job file and its path; if the study file contains the job's keys, return that file without the study's
    own keys.
    """
    if name is None:
        content = {key: value for key, value in root.values.items() if key not in of_study}
        return replace(root.file, content=content), place
    beside = place.parent / name
    try:
        path = beside if beside.is_file() else find_bundled(name, "jobs")
        return read_toml(path, "a job", quoting=False), path
    except FileError as error:
        raise type(error)(f"{root.where('job')}: job: {error}") from None


def _job(
    root: TomlTable,
    choices: Sequence[VaryChoice],
    keys: Sequence[Key],
    values: Sequence[Any],
    file: TomlFile,
    place: Path,
) -> Job:
    """Return the job for one combination of values of the choices."""
    by_key = dict(zip(keys, values, strict=True))
    of_job = {key: value for key, value in by_key.items() if _is_of_job(key)}
    of_machine = {key: value for key, value in by_key.items() if key not in of_job}
    try:
        job = job_of(with_values(file, of_job), place, values=of_machine)
    except FeeddriveError as error:
        if not by_key:
            raise
        stated = ", ".join(f"{choice.choice} = {shown(value)}" for choice, value in zip(choices, values, strict=True))
        # The combination is named, since each value alone may be valid.
        raise choices[0].error(f"with {stated}: {error}", kind=type(error)) from None
    if job.log is not None:
        raise root.error(
            f"{job.file.name} replays a log, which has one machine: a study needs [reference] or [program]"
        )
    return job


def _is_of_job(key: Key) -> bool:
    """Return True for a key of the job file. This includes the key `axis`, whereas longer keys that begin with `axis`
    belong to the machine file.
    """
    return key == ("axis",) or (key[0] in declarations(JobSection) and key[0] != "axis")


def check_rows(root: TomlTable, jobs: Mapping[tuple[Any, ...], Job], row: str, choices: Sequence[VaryChoice]) -> None:
    """Raise ParameterError for a row that is missing from one of the jobs."""
    # Each name is kept with its place in the file, which the message states.
    asked: list[tuple[TomlTable | VaryChoice, str, Any]] = [(root, "row", row)]
    asked += [(choice, "values", value) for choice in choices if choice.choice == "row" for value in choice.values]
    for job in jobs.values():
        for place, key, name in asked:
            if name not in job.loops:
                raise place.error(
                    f"{key}: there is no row {shown(name)} in {job.file.name}{nearest(str(name), job.loops)}", key
                )


@dataclass(frozen=True)
class Bound:
    """The bounds on a figure of a good machine, in SI units; None if there is no bound on that side."""

    figure: Figure
    least: float | None
    most: float | None

    def kept(self, values: np.ndarray) -> np.ndarray:
        """Return True for values within the bounds, False for NaN."""
        low = -np.inf if self.least is None else self.least
        high = np.inf if self.most is None else self.most
        return (values >= low) & (values <= high)


class BoundSection(Section, kind="bound"):
    """The bounds that a figure of a good machine satisfies."""

    least: Number | None = parameter(VARIED, "least value", infinite=True, default=None)
    most: Number | None = parameter(VARIED, "largest value", infinite=True, default=None)

    def check(self) -> None:
        """Raise ParameterError if there is no bound, or least is not below most."""
        name = "" if self.read_from is None else str(self.read_from.key[-1])
        if self.least is None and self.most is None:
            raise self.error(f"{self.dotted()} needs least or most: {name} = {{ most = ... }}")
        if self.least is not None and self.most is not None and not self.least < self.most:
            raise self.error(
                f"{self.dotted()}: least = {number(self.least, 6)} must be < most = {number(self.most, 6)}"
            )


def unit_bounded(table: TomlTable, allow: Sequence[str]) -> str:
    """Return the unit of a bound: the unit of the figure whose name is the key of the table."""
    name = str(table.key[-1])
    try:
        return figure(name, allow).unit
    except FeeddriveError as error:
        raise table.error(f"{'.'.join(map(str, table.key[:-1]))}: {error}") from None


def bounds_of(specification: Mapping[str, BoundSection], allow: Sequence[str]) -> tuple[Bound, ...]:
    """Return the bounds of a study, each with its figure."""
    return tuple(Bound(figure(name, allow), bound.least, bound.most) for name, bound in specification.items())


def figures_of(
    section: Section, names: Sequence[str], allow: Sequence[str], bounds: Sequence[Bound]
) -> tuple[Figure, ...]:
    """Return the figures to measure, including those of the specification."""
    figures: dict[str, Figure] = {}
    for name in names:
        try:
            figures[name] = figure(name, allow)
        except FeeddriveError as error:
            raise section.error(f"measure: {error}", "measure") from None
    # A bound can be judged only if its figure is measured, listed or not.
    figures |= {bound.figure.key: bound.figure for bound in bounds}
    if not figures:
        raise section.error('a study needs figures to measure: measure = ["following_error_rms_m"]')
    return tuple(figures.values())


SAMPLERS = ("grid", "latin_hypercube", "sobol", "monte_carlo", "saltelli")
MOST = 2**BITS  # variants: the length of the Sobol sequence


class StudySection(Section):
    """A study: a job, its varied factors, and the figures to measure for every variant."""

    inlined: ClassVar[Mapping[str, type[Section]]] = {"job": JobSection}

    title: str | None = text("of the report", default=None)
    job: str | None = file_name(
        "job file beside this one, or the name of a bundled one; absent: the keys of a job stand in this file",
        default=None,
    )
    row: str = text("which law of the job runs, where no choice says otherwise", default="today")
    sampler: str = choice("how variants are drawn", options=SAMPLERS, default="monte_carlo")
    count: int | None = choice("variants; of saltelli points of k + 2 variants; none of a grid", least=1, default=None)
    chunk: int | None = choice("variants that are computed together", least=1, most=1_000_000, default=None)
    seed: int = choice("of the sampler", least=0, most=2**53 - 1, default=0)
    noise: str = choice(
        '"same": all variants have the noise of one seed; "each": every one its own',
        options=("same", "each"),
        default="same",
    )
    measure: tuple[str, ...] = choice("figures to measure", default=())
    specification: Mapping[str, BoundSection] = named("what a good machine keeps, by figure")
    vary: tuple[VarySection, ...] = part("what differs from variant to variant", default=())


_COMMON = ("title", "seed")  # keys of study and job
_OF_STUDY = tuple(name for name in declarations(StudySection) if name not in _COMMON)


@dataclass(frozen=True, repr=False, eq=False)
class Study(Result):
    """The content of a study file.

    row      the row (law) of the job that is run, unless a choice varies it
    points   number of sampler points
    count    total number of variants
    chunk    number of variants per chunk
    noise    "same": all variants use one noise seed; "each": every variant has its own
    jobs     the jobs, by the values of all choices in the order of the file; a choice of the row is omitted
    stream   0 for the variants of the file; 1, 2, ... for other, independent variants from the same distributions
    digest   SHA-256 of everything that determines the rows: this file, and the resulting numbers of job and machine
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
        """The SI unit of each varied column, in the order of the file."""
        return {name: unit for varied in self.vary for name, unit in varied.columns.items()}

    @property
    def chunks(self) -> int:
        """The number of chunks."""
        return -(-self.count // self.chunk)

    def range(self, number: int) -> range:
        """Return the variants of a chunk. Raise ParameterError for an unknown chunk."""
        if not 0 <= number < self.chunks:
            raise ParameterError(f"{self.file.name} has chunks 0 to {self.chunks - 1}, and no {number}")
        return range(number * self.chunk, min((number + 1) * self.chunk, self.count))

    @property
    def choices(self) -> tuple[Choice, ...]:
        """The varied choices, whose values are inserted into the job and machine files."""
        return tuple(varied for varied in self.vary if isinstance(varied, Choice))

    def base(self, values: Mapping[str, Any]) -> Base:
        """Return the starting point of the variants that have the given values of the choices (values by key)."""
        job = self.jobs[tuple(values[choice.key] for choice in self.choices if choice.key != "row")]
        return Base(job, values.get("row", self.row))

    def bases(self) -> Iterator[Base]:
        """Yield the starting points for all combinations of the choices."""
        rows = [value for choice in self.choices if choice.key == "row" for value in choice.distribution.values]
        for job in self.jobs.values():
            for row in rows or [self.row]:
                yield Base(job, row)

    @property
    def rotary(self) -> bool:
        """True if the axis of the rows is rotary."""
        base = next(self.bases())
        return base.loop.axis.rotary

    def table(self) -> Table:
        """Tabulate the varied columns, one row each."""
        rows = [
            [varied.name, unit or "1", type(varied).__name__.lower()]
            for varied in self.vary
            for unit in varied.columns.values()
        ]
        title = f"{plain(self.title)}, {self.file.name}: {self.count:,} variants, {self.sampler}, seed {self.seed}"
        return Table(title, ["varies", "unit", "as"], rows)


StudyLike: TypeAlias = str | Path | Study
"""A study file, the name of a bundled study, or a `Study`."""


def read_study(path: StudyLike, allow: Sequence[str] = ()) -> Study:
    """Return the study in a file, or a bundled study by its name; a `Study` is returned unchanged.

    allow  modules whose figures the study may measure

    Raises FileError, ParameterError or StructureError with file, line, key and remedy.
    """
    if isinstance(path, Study):
        return path
    if not isinstance(path, str | Path):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise ParameterError(f"a study is a file, a bundled name or a Study, not a {type(path).__name__}")
    place = find_bundled(path, "studies")
    file = read_toml(place, "a study")
    root = file.root()
    # The units of [[vary]] follow from the declarations of the job, so the job, its choices and its rows are read
    # before them.
    job = read_field(StudySection, root, "job")
    of_job = () if job is not None else tuple(name for name in declarations(JobSection) if name not in _COMMON)
    root.refuse_unknown((*declarations(StudySection), *of_job))
    choices = choices_in(root)
    jobs = read_jobs(root, place, job, _OF_STUDY, choices)
    row = read_field(StudySection, root, "row")
    check_rows(root, jobs, row, choices)
    declared, nominal = _paths(jobs, row, choices)

    def unit_of(table: TomlTable) -> str:
        return unit_varied(table, declared) if table.key[0] == "vary" else unit_bounded(table, allow)

    section = read_section(StudySection, root, besides=of_job, unit_of=unit_of)
    vary = _vary(section, declared, nominal)
    points, count = _counts(section, vary)
    bounds = bounds_of(section.specification, allow)
    study = Study(
        title=section.title or place.stem,
        file=file,
        sampler=section.sampler,
        seed=section.seed,
        points=points,
        count=count,
        chunk=_chunk(section, count),
        row=row,
        noise=section.noise,
        vary=vary,
        measure=figures_of(section, section.measure, allow, bounds),
        specification=bounds,
        jobs=jobs,
        digest="",
    )
    # The digest covers the bases of the complete study, so it is computed last.
    return replace(study, digest=_digest(study))


def _paths(
    jobs: Mapping[tuple[Any, ...], Job], row: str, choices: Sequence[VaryChoice]
) -> tuple[Callable[[str], Declaration], Callable[[str], float]]:
    """Return two functions that give the declaration and the nominal value of a path that all jobs and rows have."""
    rows = [value for choice in choices if choice.choice == "row" for value in choice.values]
    bases = [Base(job, str(name)) for job in jobs.values() for name in rows or [row]]

    def declared(path: str) -> Declaration:
        # Evaluated for all: the path must exist in each of them.
        in_bases = [base.declaration(path) for base in bases]
        return in_bases[0]

    return declared, bases[0].nominal


def _vary(
    study: StudySection, declared: Callable[[str], Declaration], nominal: Callable[[str], float]
) -> tuple[Varied, ...]:
    if not study.vary:
        raise study.error("a study needs a section [[vary]]: what differs from variant to variant")
    factors: list[Varied] = []
    for section in study.vary:
        factor = varied(section, declared, nominal, study.sampler == "grid")
        before = {name for other in factors for name in (*other.columns, *other.paths)}
        twice = sorted(before & {*factor.columns, *factor.paths})
        if twice:
            raise section.error(f"'{twice[0]}' varies twice: by {section.dotted()} and by a section before it")
        factors.append(factor)
    return tuple(factors)


def _counts(study: StudySection, vary: tuple[Varied, ...]) -> tuple[int, int]:
    """Return the number of sampler points and the total number of variants."""
    key = "count"
    if study.sampler == "grid":
        if study.count is not None:
            raise study.error(
                "count does not go with a grid, whose variants are all combinations of its values", "count"
            )
        points, key = 1, "vary"
        for factor in vary:
            levels = factor.levels
            assert levels is not None
            points *= len(levels)
        if points < 1:
            raise study.error("the grid has no variants: a study has at least one", key)
    elif study.count is None:
        raise study.error("count is missing: how many variants there are")
    else:
        points = study.count
    count = points * (len(vary) + 2 if study.sampler == "saltelli" else 1)
    if count > MOST:
        raise study.error(
            f"these are {count:,} variants, more than {MOST:,} (2^{BITS}), where the sequences of the samplers end: "
            "take fewer; a yield from a million variants has an error below 0.1 %",
            key,
        )
    # Sobol sequences are balanced only at powers of 2, and SciPy refuses other lengths.
    if study.sampler == "saltelli" and points & (points - 1):
        near = 1 << points.bit_length()
        raise study.error(
            f"count = {points} points of the sampler saltelli must be a power of 2, such as {near // 2} or {near}", key
        )
    return points, count


def _chunk(study: StudySection, count: int) -> int:
    """Return the number of variants per chunk: by default, a multiple of 16 that gives at least about 16 chunks."""
    return max(16, min(1024, 16 * -(-count // 256))) if study.chunk is None else study.chunk


def _digest(study: Study) -> str:
    """Return the SHA-256 of the study file and of the structure and numbers of every system, reference and load."""
    # The text alone does not determine the rows: job, machine and part program are other files.
    digest = hashlib.sha256(study.text.encode())
    for values in study.jobs:
        digest.update(repr(values).encode())
    for base in study.bases():
        for block in base.blocks():
            digest.update(repr(tree.structure(block)).encode())
            for name, leaf in (*tree.leaves(block), *tree.tables(block)):
                # The bytes of a double, so that the last bit counts as well.
                digest.update(name.encode() + np.asarray(leaf, dtype=np.float64).tobytes())
        digest.update(repr((base.row, base.job.seed, base.job.duration)).encode())
    return digest.hexdigest()

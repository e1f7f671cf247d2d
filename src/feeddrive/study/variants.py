"""The variants of a study: their values, and the groups that are simulated together."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from feeddrive.blocks.families import Load, Reference
from feeddrive.files.job import Other
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine, System
from feeddrive.study import distributions as points
from feeddrive.study.study import Base, Study


@dataclass(frozen=True, eq=False)
class Variants:
    """The variants first .. first + n - 1 of a study: n values per column, numbers in SI units, others as objects."""

    first: int
    values: Mapping[str, np.ndarray]
    count: int

    def __len__(self) -> int:
        return self.count

    @property
    def numbers(self) -> np.ndarray:
        """The variant numbers, shape (n,)."""
        return np.arange(self.first, self.first + self.count, dtype=np.int64)

    def chosen(self, places: np.ndarray) -> dict[str, np.ndarray]:
        """Return the values of the variants at the given indices, by column."""
        return {name: values[places] for name, values in self.values.items()}


def variants(study: Study, first: int = 0, count: int | None = None) -> Variants:
    """Return `count` variants from `first` on; by default, all of them.

    Raises ParameterError if some of these are not variants of the study.
    """
    count = study.count - first if count is None else count
    if not (first >= 0 and count >= 0 and first + count <= study.count):
        raise ParameterError(f"variants {first} to {first + count - 1} are not in 0 to {study.count - 1}")
    drawn = _points(study, first, count)
    values: dict[str, np.ndarray] = {}
    at = 0
    for factor in study.vary:
        values |= factor.at(drawn[:, at : at + factor.dimensions])
        at += factor.dimensions
    return Variants(first, values, count)


def _points(study: Study, first: int, count: int) -> np.ndarray:
    """Return the points of the unit cube, shape (count, dimensions)."""
    dimensions = tuple(factor.dimensions for factor in study.vary)
    seed = (study.seed, study.stream)
    match study.sampler:
        case "grid":
            levels = [factor.levels for factor in study.vary]
            steps = points.grid(first, count, tuple(0 if row is None else len(row) for row in levels))
            return np.stack([row[steps[:, j]] for j, row in enumerate(levels) if row is not None], axis=1)
        case "latin_hypercube":
            return points.latin_hypercube(seed, first, count, sum(dimensions), study.points)
        case "sobol":
            return points.sobol(seed, first, count, sum(dimensions))
        case "saltelli":
            return points.saltelli(seed, first, count, dimensions, study.points)
        case _:
            return points.uniform(seed, first, count, sum(dimensions))


@dataclass(frozen=True, eq=False)
class VariantGroup:
    """Variants that differ only in numbers of the system.

    rows        indices of these variants in the range of variants, shape (n,)
    system      the loop, or the machine with all axes, at nominal values
    axis        the axis whose figures are measured
    changes     n numbers for each varied path of the system, for `tree.vary`
    references, loads, duration   arguments of `simulate_batch`
    seed        noise seeds, shape (n,)
    """

    base: Base
    rows: np.ndarray
    system: System
    axis: str
    changes: Mapping[str, np.ndarray]
    references: Reference | Mapping[str, Reference]
    loads: Load | Mapping[str, Load] | None
    duration: float | None
    seed: np.ndarray

    @property
    def port(self) -> str:
        """The prefix of the signals of the axis: `x.` in a machine, empty for a loop."""
        return f"{self.axis}." if isinstance(self.system, Machine) else ""

    def chosen(self, places: np.ndarray) -> Self:
        """Return a subgroup with some of the variants, selected by their indices in this group."""
        changes = {path: values[places] for path, values in self.changes.items()}
        return replace(self, rows=self.rows[places], changes=changes, seed=self.seed[places])

    def one(self, place: int) -> System:
        """Return the system of one variant. Raise ParameterError or StructureError for invalid numbers."""
        return tree.vary(self.system, {path: float(values[place]) for path, values in self.changes.items()})

    def loop(self, place: int) -> Loop:
        """Return the loop of the measured axis of one variant."""
        system = self.one(place)
        return system.loop(self.axis) if isinstance(system, Machine) else system

    @property
    def speed(self) -> float:
        """The velocity of linearization, m/s: half of the largest set velocity of the axis; 0.01 at standstill."""
        own = self.references[self.axis] if isinstance(self.references, Mapping) else self.references
        times = np.linspace(0.0, own.duration, 2001)
        largest = float(np.max(np.abs(own.at(times).velocity)))
        return 0.5 * largest if largest > 0.0 else 0.01


def variant_groups(study: Study, variants: Variants) -> Iterator[VariantGroup]:
    """Yield the variants in groups, ordered by the first variant of each group."""
    # Choices may change the graph, the law or the files, so each combination has its own base.
    choices = {choice.key: variants.values[choice.key] for choice in study.choices}
    for values, rows in _groups(list(choices.values()), len(variants)):
        base = study.base(dict(zip(choices, values, strict=True)))
        own = variants.chosen(rows)
        changes: dict[str, np.ndarray] = {}
        for varied in study.vary:
            changes |= varied.changes(own, base.nominal)
        # Motion and load are sampled once for a batch, so variants that differ in them form separate groups.
        work = {path: changes.pop(path) for path in list(changes) if base.place(path)[1]}
        seeds = np.full(rows.size, float(base.job.seed))
        if study.noise == "each":
            # Numbered by the variant, not by its place in the chunk, which depends on the split.
            seeds = seeds + variants.first + rows
        for at, places in _groups(list(work.values()), rows.size):
            moved = _moved(base, dict(zip(work, at, strict=True)))
            yield VariantGroup(
                base=base,
                rows=rows[places],
                system=base.system,
                axis=base.axis,
                changes={path: numbers[places] for path, numbers in changes.items()},
                references=base.references(moved),
                loads=base.loads(moved),
                duration=base.job.duration,
                seed=seeds[places],
            )


def _moved(base: Base, changes: Mapping[str, float]) -> dict[str, Other]:
    """Return the motions and loads of all axes, with the numbers at some paths replaced."""
    # The property returns a new dictionary on each access, which may be modified.
    moved = base.moved
    for path, value in changes.items():
        axis, kind, rest = base.place(path)
        block = tree.vary(getattr(moved[axis], kind), {rest: float(value)})
        moved[axis] = replace(moved[axis], **{kind: block})
    return moved


def _groups(columns: list[np.ndarray], count: int) -> Iterator[tuple[tuple[Any, ...], np.ndarray]]:
    """Yield the values and the indices of each group of rows that are equal in all columns."""
    groups: dict[tuple[Any, ...], list[int]] = {}
    for place, row in enumerate(zip(*columns, strict=True) if columns else [()] * count):
        groups.setdefault(row, []).append(place)
    for values, places in groups.items():
        yield values, np.array(places)

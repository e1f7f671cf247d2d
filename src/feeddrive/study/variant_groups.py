"""Groups of variants for `simulate_batch`: equal choices, equal motions and loads."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from feeddrive.blocks.families import Load, Reference
from feeddrive.files.job import Other
from feeddrive.language import tree
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine, System
from feeddrive.study.base import Base
from feeddrive.study.study import Study
from feeddrive.study.variants import Variants


@dataclass(frozen=True, eq=False)
class VariantGroup:
    """Variants that differ in numbers of the system only.

    rows        their places in the range of variants, shape (n,)
    system      the loop, or the machine of all axes, at nominal numbers
    axis        the axis whose figures are measured
    changes     by path of the system n numbers, for `tree.vary`
    references, loads, duration   as `simulate_batch` takes them
    seed        of the noise, shape (n,)
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

    def chosen(self, places: np.ndarray) -> VariantGroup:
        """Some of the variants, by their places in this group."""
        changes = {path: values[places] for path, values in self.changes.items()}
        return replace(self, rows=self.rows[places], changes=changes, seed=self.seed[places])

    def one(self, place: int) -> System:
        """The system of one variant. Raises ParameterError or StructureError for numbers that it does not take."""
        return tree.vary(self.system, {path: float(values[place]) for path, values in self.changes.items()})

    def loop(self, place: int) -> Loop:
        """The measured axis of one variant, alone."""
        system = self.one(place)
        return system.loop(self.axis) if isinstance(system, Machine) else system

    @property
    def speed(self) -> float:
        """Half of the largest set speed of the axis in m/s, at which it is linearized; 10 mm/s if it stands still."""
        own = self.references[self.axis] if isinstance(self.references, Mapping) else self.references
        times = np.linspace(0.0, own.duration, 2001)
        largest = float(np.max(np.abs(own.at(times).velocity)))
        return 0.5 * largest if largest > 0.0 else 0.01


def variant_groups(study: Study, variants: Variants) -> Iterator[VariantGroup]:
    """The variants in groups, in the order in which each group first occurs."""
    choices = {choice.key: variants.values[choice.key] for choice in study.choices}
    for values, rows in _groups(list(choices.values()), len(variants)):
        base = study.base(dict(zip(choices, values, strict=True)))
        own = variants.chosen(rows)
        changes: dict[str, np.ndarray] = {}
        for varied in study.vary:
            changes |= varied.changes(own, base.nominal)
        work = {path: changes.pop(path) for path in list(changes) if base.place(path)[1]}
        seeds = np.full(rows.size, float(base.job.seed))
        if study.noise == "each":
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
    """Motions and loads with other numbers, by path."""
    moved = base.moved
    for path, value in changes.items():
        axis, kind, rest = base.place(path)
        block = tree.vary(getattr(moved[axis], kind), {rest: float(value)})
        moved[axis] = replace(moved[axis], **{kind: block})
    return moved


def _groups(columns: list[np.ndarray], count: int) -> Iterator[tuple[tuple[Any, ...], np.ndarray]]:
    """Group rows that are equal in all columns: their values, and their places."""
    groups: dict[tuple[Any, ...], list[int]] = {}
    for place, row in enumerate(zip(*columns, strict=True) if columns else [()] * count):
        groups.setdefault(row, []).append(place)
    for values, places in groups.items():
        yield values, np.array(places)

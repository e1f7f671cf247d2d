"""The figures of a study, and the bounds of a good machine: `measure` and `[specification]` of a study file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from feeddrive.figures.catalogue import figure
from feeddrive.figures.figure import Figure
from feeddrive.files.section import VARIED, Section
from feeddrive.files.toml_file import TomlTable
from feeddrive.language.block import Number, parameter
from feeddrive.language.errors import FeeddriveError
from feeddrive.language.quantity import number


@dataclass(frozen=True)
class Bound:
    """The bounds of a figure of a good machine, in SI; None for an open end."""

    figure: Figure
    least: float | None
    most: float | None

    def kept(self, values: np.ndarray) -> np.ndarray:
        """True for values within the bounds, False for NaN."""
        low = -np.inf if self.least is None else self.least
        high = np.inf if self.most is None else self.most
        return (values >= low) & (values <= high)


class BoundSection(Section, kind="bound"):
    """What a figure of a good machine keeps."""

    least: Number | None = parameter(VARIED, "least value", infinite=True, default=None)
    most: Number | None = parameter(VARIED, "largest value", infinite=True, default=None)

    def check(self) -> None:
        """There is a bound, and bounds do not cross."""
        name = "" if self.read_from is None else str(self.read_from.key[-1])
        if self.least is None and self.most is None:
            raise self.error(f"{self.dotted()} needs least or most: {name} = {{ most = ... }}")
        if self.least is not None and self.most is not None and not self.least < self.most:
            raise self.error(
                f"{self.dotted()}: least = {number(self.least, 6)} must be < most = {number(self.most, 6)}"
            )


def unit_bounded(table: TomlTable, allow: Sequence[str]) -> str:
    """Return the unit of a bound: that of the figure that the table is named after."""
    name = str(table.key[-1])
    try:
        return figure(name, allow).unit
    except FeeddriveError as error:
        raise table.error(f"{'.'.join(map(str, table.key[:-1]))}: {error}") from None


def bounds_of(specification: Mapping[str, BoundSection], allow: Sequence[str]) -> tuple[Bound, ...]:
    """The bounds of a study by their figures."""
    return tuple(Bound(figure(name, allow), bound.least, bound.most) for name, bound in specification.items())


def figures_of(
    section: Section, names: Sequence[str], allow: Sequence[str], bounds: Sequence[Bound]
) -> tuple[Figure, ...]:
    """The figures to measure, those of the specification included."""
    figures: dict[str, Figure] = {}
    for name in names:
        try:
            figures[name] = figure(name, allow)
        except FeeddriveError as error:
            raise section.error(f"measure: {error}", "measure") from None
    figures |= {bound.figure.key: bound.figure for bound in bounds}
    if not figures:
        raise section.error('a study needs figures to measure: measure = ["following_error_rms_m"]')
    return tuple(figures.values())

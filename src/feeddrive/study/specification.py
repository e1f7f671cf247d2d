"""What a study measures, and what a good machine keeps: `measure` and `[specification]` of a study file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from feeddrive.figures.catalogue import figure
from feeddrive.figures.figure import Figure
from feeddrive.files.toml_file import Section
from feeddrive.language import units
from feeddrive.language.errors import FeeddriveError, ParameterError, shown
from feeddrive.language.quantity import number


@dataclass(frozen=True)
class Bound:
    """What a figure of a good machine keeps, in SI; None where it is open."""

    figure: Figure
    least: float | None
    most: float | None

    def kept(self, values: np.ndarray) -> np.ndarray:
        """Which values keep it; NaN does not."""
        low = -np.inf if self.least is None else self.least
        high = np.inf if self.most is None else self.most
        return (values >= low) & (values <= high)


def read_measure(root: Section, allow: Sequence[str], bounds: Sequence[Bound]) -> tuple[Figure, ...]:
    """The figures to measure, those of the specification included."""
    names = root.values.get("measure", [])
    if not isinstance(names, list) or not all(isinstance(each, str) for each in names):
        raise root.error('measure must be a list of figures: ["following_error_rms_m"]', "measure")
    made: dict[str, Figure] = {}
    for name in names:
        try:
            made[name] = figure(name, allow)
        except FeeddriveError as error:
            raise root.error(f"measure: {error}", "measure") from None
    made |= {each.figure.key: each.figure for each in bounds}
    if not made:
        raise root.error('a study needs figures to measure: measure = ["following_error_rms_m"]')
    return tuple(made.values())


def read_specification(root: Section, allow: Sequence[str]) -> tuple[Bound, ...]:
    """The bounds of the section [specification]; none without one."""
    section = root.optional("specification")
    made: list[Bound] = []
    for name in () if section is None else section.values:
        assert section is not None
        try:
            of = figure(name, allow)
        except FeeddriveError as error:
            raise section.error(f"{section.dotted()}: {error}", name) from None
        own = section.section(name)
        least, most = (_end(own, key, of.unit) for key in ("least", "most"))
        own.refuse_unknown([key for key in own.values if key.split("_")[0] in ("least", "most")])
        if least is None and most is None:
            raise own.error(f"{own.dotted()} needs least or most: {name} = {{ most = ... }}")
        if least is not None and most is not None and not least < most:
            raise own.error(f"{own.dotted()}: least = {number(least, 6)} must be < most = {number(most, 6)}")
        made.append(Bound(of, least, most))
    return tuple(made)


def _end(section: Section, name: str, unit: str) -> float | None:
    """One end of a bound in SI, with or without a unit in its key."""
    keys = [key for key in section.values if key == name or key.startswith(f"{name}_")]
    if len(keys) > 1:
        raise section.error(f"{section.dotted(name)} is given twice", keys[1])
    if not keys:
        return None
    value, suffix = section.values[keys[0]], keys[0][len(name) + 1 :]
    if isinstance(value, bool) or not isinstance(value, int | float) or value != value:
        raise section.error(f"{section.dotted(keys[0])} = {shown(value)} must be a number", keys[0])
    try:
        return units.scaled(float(value), units.factor(suffix, unit)) if suffix else float(value)
    except ParameterError as error:
        raise section.error(f"key '{section.dotted(keys[0])}': {error}", keys[0]) from None

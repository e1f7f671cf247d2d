"""The answers of a study in sentences, with units that people read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from feeddrive.language.quantity import Quantity, number
from feeddrive.language.table import shown
from feeddrive.language.text import Text
from feeddrive.plot.style import written
from feeddrive.study.answers.sensitivity import RankCorrelation, SobolIndices
from feeddrive.study.answers.shares import Share
from feeddrive.study.answers.yields import BoundYield, Yield
from feeddrive.study.figure import Figure
from feeddrive.study.specification import Bound
from feeddrive.study.study import Study

_STIFF = ("N/um", 1e-6)
_NAMED = 3  # quantities of a sentence
_INFLUENCE = 0.05  # a share of the variance below which a quantity is not named


def read_in(unit: str) -> tuple[str, float]:
    """The unit in which people read a quantity of an SI unit, and the factor to it."""
    name, factor = _STIFF if unit == "N/m" else shown(unit)
    return written(name), factor


def value_text(figure: Figure, value: float) -> str:
    """A value of a figure with its unit."""
    unit, factor = read_in(figure.unit)
    return f"{number(factor * value, 3)} {unit}".rstrip()


def name_of(figure: Figure) -> str:
    """The name of a figure without the unit at its end: following error RMS."""
    end = figure.unit.replace("/", "_per_")
    return (figure.name.removesuffix(f"_{end}") if end else figure.name).replace("_", " ").replace(" rms", " RMS")


def short(names: Sequence[str]) -> dict[str, str]:
    """The ends of dotted names that tell them apart: mass_load for axis.x.plant.mass_load."""
    found: dict[str, str] = {}
    for name in names:
        parts = name.split(".")
        ends = [".".join(parts[i:]) for i in range(len(parts) - 1, -1, -1)]
        found[name] = next(end for end in ends if sum(f".{each}".endswith(f".{end}") for each in names) == 1)
    return found


def bound_text(bound: Bound) -> str:
    """As `following error peak ≤ 30 µm`."""
    unit, factor = read_in(bound.figure.unit)
    low = "" if bound.least is None else f"{factor * bound.least:.6g} ≤ "
    high = "" if bound.most is None else f" ≤ {factor * bound.most:.6g}"
    if low and not high:
        low, high = "", f" ≥ {low[:-3]}"
    return f"{low}{name_of(bound.figure)}{high} {unit}".rstrip()


def interval_text(share: Share) -> str:
    """As `93.5 % (89.1 to 96.5 %)`."""
    interval = share.interval
    if interval is None:
        return f"{_percent(share.value)} %"
    return f"{_percent(share.value)} % ({_percent(interval[0])} to {_percent(interval[1])} %)"


def _percent(share: float) -> str:
    """In percent, with as many digits as are needed to tell it from 0 and 100."""
    value = 100.0 * share
    far = min(value, 100.0 - value)
    digits = 1 if far >= 1.0 or far <= 0.0 else 2 if far >= 0.1 else 4
    return f"{value:.{digits}f}"


def sentences(
    study: Study, yields: Yield, sobol: Sequence[SobolIndices], correlations: Sequence[RankCorrelation]
) -> list[str]:
    """Yield, what fails most, and what decides it."""
    inside = yields.inside
    keep = "keep the specification" if study.specification else "have figures; the study states no specification"
    interval = inside.interval
    said = f"{inside.kept:,} of {inside.of:,} machines ({_percent(inside.value)} %"
    if interval is not None:
        said += f", 95 % interval {_percent(interval[0])} to {_percent(interval[1])} %"
    found = [f"{said}) {keep}."]
    if study.sampler == "grid":
        found[0] += " They are the points of a grid and not a sample: the share has no interval."
    if yields.bad and study.specification:
        found.append(f"{yields.bad:,} of them have no figures, and count as outside.")
    hardest = yields.hardest
    if hardest is not None:
        found.append(_fails(hardest, inside))
    measured = [each.bound.figure.name for each in yields.bounds] or [each.name for each in study.measure]
    about = measured[0] if hardest is None else hardest.bound.figure.name
    figure = next(each for each in study.measure if each.name == about)
    names = short([*study.columns, *(each.name for each in study.vary if each.name not in study.columns)])
    found += _decides(figure, sobol, names) or _goes_with(figure, correlations, names)
    return found


def _fails(hardest: BoundYield, inside: Share) -> str:
    broken = hardest.kept.of - hardest.kept.kept
    alone = f", {hardest.alone:,} of them no other bound" if 0 < hardest.alone < broken else ""
    outside = inside.of - inside.kept
    return f"What fails most is {bound_text(hardest.bound)}: {broken:,} of the {outside:,} outside break it{alone}."


def _decides(figure: Figure, sobol: Sequence[SobolIndices], names: Mapping[str, str]) -> list[str]:
    """By Sobol indices; nothing if there are none of this figure."""
    found = next((each for each in sobol if each.output == figure.name), None)
    if found is None:
        return []
    order = sorted(range(len(found.factors)), key=lambda i: -float(found.first[i]))
    named = [i for i in order if found.first[i] >= _INFLUENCE][:_NAMED]
    said: list[str] = []
    if named:
        first, *others = [
            (names[found.factors[i]], share_text(found.first[i], found.first_interval[:, i])) for i in named
        ]
        rest = "".join(f", {name} {share}" for name, share in others)
        said.append(f"{first[0]} alone decides {first[1]} of the variance of {name_of(figure)}{rest}.")
    together = 1.0 - float(np.sum(found.first))
    if together >= _INFLUENCE:
        said.append(Text(f"{Quantity(together, 'share'):.0f} of it is decided by several together."))
    return said


def share_text(value: float, interval: np.ndarray) -> str:
    """A share of a variance as `63 % (40 to 88 %)`."""
    middle, low, high = (round(100.0 * float(each)) for each in (value, *interval))
    return f"{middle} % ({low} to {high} %)"


def _goes_with(figure: Figure, correlations: Sequence[RankCorrelation], names: Mapping[str, str]) -> list[str]:
    """By rank correlations, where there are no Sobol indices."""
    own = [each for each in correlations if each.output == figure.name and each.value**2 >= _INFLUENCE][:_NAMED]
    if not own:
        return []
    said = [
        f"{names[each.column]} ({each.value:+.2f}"
        + ("" if each.interval is None else f", 95 % interval {each.interval[0]:+.2f} to {each.interval[1]:+.2f}")
        + ")"
        for each in own
    ]
    name = name_of(figure)
    return [
        f"{name[:1].upper()}{name[1:]} goes most with {', '.join(said)}, by rank correlation.",
        'Shares of its variance need the sampler "saltelli".',
    ]

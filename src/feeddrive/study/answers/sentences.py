"""The answers of a study as sentences, in customary units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from feeddrive.figures.figure import Figure
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.study.answers.rows import Share
from feeddrive.study.answers.statistics import BoundYield, RankCorrelation, SobolIndices, Yield
from feeddrive.study.study import Bound, Study

_NAMED = 3  # factors named in a sentence
_INFLUENCE = 0.05  # share of the variance below which a factor is not named


def value_cell(figure: Figure, value: float) -> Quantity | str:
    """Return a value of a figure as a table cell."""
    return "∞" if np.isposinf(value) else Quantity(value, figure.unit, form="3")


def name_of(figure: Figure) -> str:
    """Return the name of a figure without its trailing unit: following error RMS."""
    end = figure.unit.replace("/", "_per_")
    return (figure.key.removesuffix(f"_{end}") if end else figure.key).replace("_", " ").replace(" rms", " RMS")


def short(names: Sequence[str]) -> dict[str, str]:
    """Return the shortest unique ends of dotted names: mass_load for axis.x.plant.mass_load."""
    shortest: dict[str, str] = {}
    for name in names:
        parts = name.split(".")
        ends = [".".join(parts[i:]) for i in range(len(parts) - 1, -1, -1)]
        shortest[name] = next(end for end in ends if sum(f".{other}".endswith(f".{end}") for other in names) == 1)
    return shortest


def bound_text(bound: Bound) -> str:
    """Return a bound as `following error peak ≤ 30 µm`."""
    least, most = (
        None if end is None else Quantity(end, bound.figure.unit, form="6") for end in (bound.least, bound.most)
    )
    if most is None:
        return Text(f"{name_of(bound.figure)} ≥ {least}")
    low = "" if least is None else f"{replace(least, bare=True)} ≤ "
    return Text(f"{low}{name_of(bound.figure)} ≤ {most}")


def interval_text(share: Share) -> str:
    """Return a share as `93.5 % (89.1 to 96.5 %)`."""
    interval = share.interval
    if interval is None:
        return Text(f"{_percent(share.value)}")
    return Text(f"{_percent(share.value)} ({_percent(interval[0], bare=True)} to {_percent(interval[1])})")


def _percent(share: float, *, bare: bool = False) -> Quantity:
    """Return a share with enough digits to distinguish it from 0 and 100 %."""
    value = 100.0 * share
    far = min(value, 100.0 - value)
    digits = 1 if far >= 1.0 or far <= 0.0 else 2 if far >= 0.1 else 4
    return Quantity(share, "share", form=f".{digits}f", bare=bare)


def sentences(
    study: Study, yields: Yield, sobol: Sequence[SobolIndices], correlations: Sequence[RankCorrelation]
) -> list[str]:
    """Return sentences on the yield, the bound that is violated most, and the factors that decide it."""
    inside = yields.inside
    keep = "keep the specification" if study.specification else "have figures; the study states no specification"
    interval = inside.interval
    counts = f"{inside.kept:,} of {inside.of:,} machines ({_percent(inside.value)}"
    if interval is not None:
        counts += f", 95 % interval {_percent(interval[0], bare=True)} to {_percent(interval[1])}"
    texts: list[str] = [Text(f"{counts}) {keep}.")]
    if study.sampler == "grid":
        texts[0] += " They are the points of a grid and not a sample: the share has no interval."
    if yields.bad and study.specification:
        texts.append(f"{yields.bad:,} of them have no figures, and count as outside.")
    hardest = yields.hardest
    if hardest is not None:
        texts.append(_fails(hardest, inside))
    measured = [bound_yield.bound.figure.key for bound_yield in yields.bounds] or [
        figure.key for figure in study.measure
    ]
    about = measured[0] if hardest is None else hardest.bound.figure.key
    figure = next(candidate for candidate in study.measure if candidate.key == about)
    names = short([*study.columns, *(varied.name for varied in study.vary if varied.name not in study.columns)])
    texts += _decides(figure, sobol, names) or _goes_with(figure, correlations, names)
    return texts


def _fails(hardest: BoundYield, inside: Share) -> str:
    broken = hardest.kept.of - hardest.kept.kept
    alone = f", {hardest.alone:,} of them no other bound" if 0 < hardest.alone < broken else ""
    outside = inside.of - inside.kept
    return Text(
        f"What fails most is {bound_text(hardest.bound)}: {broken:,} of the {outside:,} outside break it{alone}."
    )


def _decides(figure: Figure, sobol: Sequence[SobolIndices], names: Mapping[str, str]) -> list[str]:
    """Return sentences on the variance of a figure by Sobol indices; empty if it has none."""
    indices = next((row for row in sobol if row.output == figure.key), None)
    if indices is None:
        return []
    order = sorted(range(len(indices.factors)), key=lambda i: -float(indices.first[i]))
    named = [i for i in order if indices.first[i] >= _INFLUENCE][:_NAMED]
    texts: list[str] = []
    if named:
        first, *others = [
            (names[indices.factors[i]], share_text(indices.first[i], indices.first_interval[:, i])) for i in named
        ]
        rest = "".join(f", {name} {share}" for name, share in others)
        texts.append(Text(f"{first[0]} alone decides {first[1]} of the variance of {name_of(figure)}{rest}."))
    together = 1.0 - float(np.sum(indices.first))
    if together >= _INFLUENCE:
        texts.append(Text(f"{Quantity(together, 'share'):.0f} of it is decided by several together."))
    return texts


def share_text(value: float, interval: np.ndarray) -> str:
    """Return a share of a variance as `63 % (40 to 88 %)`."""
    middle, low, high = (Quantity(part, "share", form=".0f") for part in (value, *interval))
    return Text(f"{middle} ({replace(low, bare=True)} to {high})")


def correlation(value: float) -> str:
    """Return a correlation coefficient as a text with its sign."""
    return f"{Quantity(value):+.2f}"


def _between(rank: RankCorrelation) -> str:
    return "" if rank.interval is None else " to ".join(map(correlation, rank.interval))


def _goes_with(figure: Figure, correlations: Sequence[RankCorrelation], names: Mapping[str, str]) -> list[str]:
    """Return sentences on the variance of a figure by rank correlations, for a study without Sobol indices."""
    own = [rank for rank in correlations if rank.output == figure.key and rank.value**2 >= _INFLUENCE][:_NAMED]
    if not own:
        return []
    parts = [
        f"{names[rank.column]} ({', 95 % interval '.join(filter(None, (correlation(rank.value), _between(rank))))})"
        for rank in own
    ]
    name = name_of(figure)
    return [
        Text(f"{name[:1].upper()}{name[1:]} goes most with {', '.join(parts)}, by rank correlation."),
        'Shares of its variance need the sampler "saltelli".',
    ]

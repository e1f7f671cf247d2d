"""Pictures of the answers of a study: yield by bound, distributions, what decides, bands, and the Pareto front."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from feeddrive.figures.figure import Figure
from feeddrive.figures.of_loops import StiffnessAt
from feeddrive.language.quantity import USUAL, Quantity, unit_name
from feeddrive.plot import style
from feeddrive.study.answers.bands import Band
from feeddrive.study.answers.judged import Judged
from feeddrive.study.answers.sensitivity import INSIDE, RankCorrelation, SobolIndices
from feeddrive.study.answers.sentences import bound_text, name_of, short
from feeddrive.study.answers.yields import Yield
from feeddrive.study.specification import Bound
from feeddrive.study.study import Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from feeddrive.study.answers.fronts import Front

_DOTS = 1200  # of a scatter: the page stays small
_PANELS = 12  # histograms
_OUTPUTS = 4  # of which is shown what decides them
_FACTORS = 8  # of each
_INSIDE, _OUTSIDE = style.COLORS[0], style.COLORS[1]


def labelled(figure: Figure) -> str:
    """A figure with its unit, for an axis."""
    return f"{name_of(figure)} ({unit_name(figure.unit)})" if figure.unit else name_of(figure)


def _scale(unit: str) -> float:
    """Return the factor from an SI unit to the unit in which it is drawn."""
    return USUAL.of(unit)[1]


def yields(found: Yield) -> Any:
    """A row for each bound and one for all: the share that keeps it, with its interval."""
    rows = [(style.read(bound_text(each.bound)), each.kept) for each in found.bounds]
    rows.append(("all of them" if rows else "with figures", found.inside))
    figure, (ax,) = style.picture(height=0.9 + 0.36 * len(rows))
    for row, (_, share) in enumerate(rows):
        color = style.INK if row == len(rows) - 1 else style.color(0)
        if share.interval is not None:
            ax.plot([100.0 * each for each in share.interval], [-row, -row], color=color, linewidth=2.2)
        ax.plot(100.0 * share.value, -row, "o", color=color, markersize=6.0)
    ax.set_yticks([-row for row in range(len(rows))], [text for text, _ in rows])
    low = min((share.interval or (share.value,))[0] for _, share in rows)
    ax.set_xlim(100.0 * max(0.0, low - 0.08 * (1.0 - low) - 0.002), 100.0 + 100.0 * (0.03 * (1.0 - low) + 5e-4))
    ax.set_ylim(0.6 - len(rows), 0.6)
    ax.grid(visible=False, axis="y")
    style.labels(ax, "machines that keep it (%); lines: 95 % interval", "")
    return figure


def histograms(sample: Judged, banded: bool = False) -> Any:
    """The distribution of each figure over the machines, with its bound.

    banded  lines of dynamic stiffness without a bound are left to the picture of their band
    """
    figures = _figures(sample.study, banded)[:_PANELS]
    columns = min(2, len(figures))
    rows = -(-len(figures) // columns)
    picture, _ = style.picture(1, height=0.5 + 1.9 * rows)
    picture.clear()
    axes = [style.dressed(ax) for ax in np.ravel(picture.subplots(rows, columns, squeeze=False))]
    bounds = {each.figure: each for each in sample.study.specification}
    for ax, figure in zip(axes, figures, strict=False):
        _histogram(ax, figure, sample.figures[figure.key], bounds.get(figure))
    for ax in axes[len(figures) :]:
        ax.set_visible(False)
    return picture


def _figures(study: Study, banded: bool) -> list[Figure]:
    """Those with a bound first."""
    bounded = [each.figure for each in study.specification]
    others = [each for each in study.measure if not (banded and isinstance(each.of, StiffnessAt))]
    return list(dict.fromkeys([*bounded, *others]))


def _histogram(ax: Axes, figure: Figure, values: np.ndarray, bound: Bound | None) -> None:
    factor = _scale(figure.unit)
    values = factor * values[np.isfinite(values)]
    if values.size:
        low, high = float(values.min()), float(values.max())
        if high <= low:
            low, high = style.padded(low, high)
        edges = np.linspace(low, high, min(40, 5 + values.size // 8) + 1)
        ax.hist(values, bins=list(edges), color=_INSIDE, alpha=0.75, edgecolor=style.PAPER, linewidth=0.5)
        style.note(ax, f"median {Quantity(np.median(values) / factor, figure.unit, bare=True)}")
    for end in () if bound is None else (bound.least, bound.most):
        if end is not None:
            ax.axvline(factor * end, color=style.ALERT, linewidth=1.4, linestyle=(0, (5, 2)))
    ax.margins(x=0.03)
    style.labels(ax, labelled(figure), "machines")


def decides(study: Study, indices: Sequence[SobolIndices], correlations: Sequence[RankCorrelation]) -> Any:
    """Bars of what decides the figures of the specification: Sobol indices, or rank correlations, with intervals."""
    outputs = _outputs(study)
    sobol = {each.output: each for each in indices if each.output in outputs}
    ranks = {name: [each for each in correlations if each.output == name] for name in outputs}
    shown = [name for name in outputs if (sobol if indices else ranks).get(name)]
    if not shown:
        return None
    count = min(_FACTORS, len(study.vary) if indices else max(len(ranks[name]) for name in shown))
    picture, axes = style.picture(len(shown), height=0.7 + len(shown) * (0.45 + 0.27 * count), share=True)
    names = {each.key: each for each in study.measure}
    for ax, name in zip(axes, shown, strict=True):
        if indices:
            _indices(ax, sobol[name])
        else:
            _correlations(ax, ranks[name])
        style.note(ax, "inside the specification" if name == INSIDE else name_of(names[name]), x=0.0, align="left")
        ax.grid(visible=False, axis="y")
    said = "share of the variance" if indices else "rank correlation, -1 to 1"
    style.labels(axes[-1], f"{said}; lines: 95 % interval", "")
    if indices:
        style.legend(picture, axes[0])
    return picture


def _outputs(study: Study) -> list[str]:
    """Which outputs are shown: those with a bound, and being inside; without bounds the first ones."""
    bounded = [each.figure.key for each in study.specification][: _OUTPUTS - 1]
    return [*bounded, INSIDE] if bounded else [each.key for each in _figures(study, True)][:_OUTPUTS]


def _indices(ax: Axes, found: SobolIndices) -> None:
    order = found.order[:_FACTORS].tolist()
    rows = np.arange(len(order))
    for offset, value, interval, color, label in (
        (0.19, found.first, found.first_interval, style.color(0), "alone"),
        (-0.19, found.total, found.total_interval, style.color(5), "with what it does together with others"),
    ):
        ax.barh(offset - rows, value[order], height=0.36, color=color, label=label)
        for row, i in enumerate(order):
            ax.plot(interval[:, i], [offset - row] * 2, color=style.INK, linewidth=1.3)
    _named_rows(ax, [found.factors[i] for i in order], found.factors)


def _correlations(ax: Axes, found: Sequence[RankCorrelation]) -> None:
    some = found[:_FACTORS]
    for row, each in enumerate(some):
        ax.barh(-row, each.value, height=0.62, color=_INSIDE if each.value < 0.0 else _OUTSIDE)
        if each.interval is not None:
            ax.plot(each.interval, [-row, -row], color=style.INK, linewidth=1.3)
    ax.axvline(0.0, color=style.INK, linewidth=0.9)
    ax.set_xlim(-1.0, 1.0)
    _named_rows(ax, [each.column for each in some], [each.column for each in found])


def _named_rows(ax: Axes, some: Sequence[str], names: Sequence[str]) -> None:
    said = short(names)
    ax.set_yticks([-row for row in range(len(some))], [style.caption(said[name], most=30) or "" for name in some])
    ax.set_ylim(0.55 - len(some), 0.55)


def stiffness_band(band: Band) -> Any:
    """Quantiles of the dynamic stiffness over frequency."""
    figure, (ax,) = style.picture(height=3.2)
    _band(ax, band)
    ax.set_yscale("log")
    style.plain_decades(ax.yaxis, between=True)
    style.frequency_axis(ax, float(band.x[0]), float(band.x[-1]))
    style.labels(ax, f"frequency ({unit_name('Hz')})", f"dynamic stiffness ({unit_name(band.unit)})")
    return figure


def error_band(band: Band) -> Any:
    """Quantiles of the following error over time."""
    figure, (ax,) = style.picture(height=3.0)
    _band(ax, band)
    ax.set_ylim(0.0, None)
    style.labels(ax, "time (s)", f"largest following error ({unit_name(band.unit)})")
    return figure


def _band(ax: Axes, band: Band) -> None:
    values = _scale(band.unit) * band.quantiles
    ax.fill_between(band.x, values[0], values[4], color=_INSIDE, alpha=0.18, linewidth=0)
    ax.fill_between(band.x, values[1], values[3], color=_INSIDE, alpha=0.35, linewidth=0)
    ax.plot(band.x, values[2], color=_INSIDE, linewidth=style.LINE)
    style.note(ax, "line: median; dark: every second machine; light: nine of ten")


def front(found: Front, sample: Judged) -> Any:
    """The machines between tracking, stiffness and robustness; rings: those of the front."""
    first, *others = found.figures.values()
    picture, axes = style.picture(len(others), height=0.6 + 3.0 * len(others))
    some = np.linspace(0, sample.variant.size - 1, min(_DOTS, sample.variant.size)).astype(int)
    for ax, other in zip(axes, others, strict=True):
        for inside, color, label in ((True, _INSIDE, "inside"), (False, _OUTSIDE, "outside")):
            chosen = some[sample.inside[some] == inside]
            if chosen.size:
                ax.plot(*_place(sample.figures, first, other, chosen), ".", color=color, markersize=4.5, label=label)
        kept = np.arange(found.rows.variant.size)[:_DOTS]
        ax.plot(*_place(found.rows.figures, first, other, kept), "o", markersize=8.0, markerfacecolor="none",
                markeredgecolor=style.INK, markeredgewidth=1.0, label="front")  # fmt: skip
        ax.margins(0.04, 0.06)
        style.labels(ax, None, labelled(other))
    axes[-1].set_xlabel(style.read(labelled(first)), fontsize=style.TEXT)
    style.legend(picture, axes[0])
    return picture


def _place(
    figures: Mapping[str, np.ndarray], first: Figure, other: Figure, chosen: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    x, y = (_scale(each.unit) * figures[each.key][chosen] for each in (first, other))
    seen = np.isfinite(x) & np.isfinite(y)
    return x[seen], y[seen]

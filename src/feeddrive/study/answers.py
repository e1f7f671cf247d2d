"""The answers of a study, computed in one pass over its rows; only one chunk and a sample of rows are held in memory.

    answers = answers_of(store, study)
    print(*answers.sentences)
    write_report(answers, "out")

Yields, worst cases and fronts are exact over all rows.  Distributions, rank correlations and bands come from a random
sample if there are more than 200,000 rows; Sobol indices need 8 bytes per variant and figure.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np

from feeddrive.figures.figure import Figure
from feeddrive.figures.of_loops import StiffnessAt
from feeddrive.language.errors import ParameterError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import USUAL, Quantity, unit_name
from feeddrive.language.table import Cell, Column, Result, Table, chart_of
from feeddrive.language.text import Text
from feeddrive.language.units import in_key
from feeddrive.plot import chart, style
from feeddrive.plot.chart import Abscissa, Band, Box, Chart, Curve, Level, Panel, Tick
from feeddrive.plot.curves import histogram
from feeddrive.study import statistics
from feeddrive.study.store import Store
from feeddrive.study.study import Bound, Study

if TYPE_CHECKING:
    import pyarrow


_NAMED = 3  # factors named in a sentence
_INFLUENCE = 0.05  # share of the variance below which a factor is not named


def value_cell(figure: Figure, value: float) -> Quantity | str:
    """Return a value of a figure as a table cell."""
    # A margin without a crossover is infinite: a valid value, not a missing one.
    return "∞" if np.isposinf(value) else Quantity(value, figure.unit, form="3")


def name_of(figure: Figure) -> str:
    """Return the name of a figure in words and without its unit, such as `following error RMS`."""
    end = in_key(figure.unit)
    return (figure.key.removesuffix(f"_{end}") if end else figure.key).replace("_", " ").replace(" rms", " RMS")


def short(names: Sequence[str]) -> dict[str, str]:
    """Return dotted names shortened to their shortest unique endings: mass_load for axis.x.plant.mass_load."""
    shortest: dict[str, str] = {}
    for name in names:
        parts = name.split(".")
        ends = [".".join(parts[i:]) for i in range(len(parts) - 1, -1, -1)]
        # The leading dots compare whole segments: `mass_load` does not end in the segment `load`.
        alone = (end for end in ends if sum(f".{other}".endswith(f".{end}") for other in names) == 1)
        # a factor `mass` beside `axis.x.plant.mass` is the end of another name, and only its whole name is left
        shortest[name] = next(alone, name)
    return shortest


def bound_text(bound: Bound) -> str:
    """Return a bound as text: `following error peak ≤ 30 µm`."""
    least, most = (
        None if end is None else Quantity(end, bound.figure.unit, form="6") for end in (bound.least, bound.most)
    )
    if most is None:
        return Text(f"{name_of(bound.figure)} ≥ {least}")
    low = "" if least is None else f"{replace(least, bare=True)} ≤ "
    return Text(f"{low}{name_of(bound.figure)} ≤ {most}")


def interval_text(share: statistics.Share) -> str:
    """Return a share with its confidence interval as text: `93.5 % (89.1 to 96.5 %)`."""
    interval = share.interval
    if interval is None:
        return Text(f"{_percent(share.value)}")
    return Text(f"{_percent(share.value)} ({_percent(interval[0], bare=True)} to {_percent(interval[1])})")


def _percent(share: float, *, bare: bool = False) -> Quantity:
    """Return a share as a percentage with enough digits to distinguish it from 0 and 100 %."""
    value = 100.0 * share
    far = min(value, 100.0 - value)
    digits = 1 if far >= 1.0 or far <= 0.0 else 2 if far >= 0.1 else 4
    return Quantity(share, "share", form=f".{digits}f", bare=bare)


def sentences(
    study: Study,
    yields: statistics.Yield,
    sobol: Sequence[statistics.SobolIndices],
    correlations: Sequence[statistics.RankCorrelation],
) -> list[str]:
    """Return sentences on the yield, the bound that is violated most often, and the factors that have the largest
    influence on the figure that this bound limits.
    """
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
    # Sobol indices are per factor and rank correlations per column: a joint distribution is one factor with several
    # columns.
    names = short([*study.columns, *(varied.name for varied in study.vary if varied.name not in study.columns)])
    # Sobol indices need the sampler saltelli and an output that varies; rank correlations are the fallback.
    texts += _decides(figure, sobol, names) or _goes_with(figure, correlations, names)
    return texts


def _fails(hardest: statistics.BoundYield, inside: statistics.Share) -> str:
    broken = hardest.kept.of - hardest.kept.kept
    alone = f", {hardest.alone:,} of them no other bound" if 0 < hardest.alone < broken else ""
    outside = inside.of - inside.kept
    return Text(
        f"What fails most is {bound_text(hardest.bound)}: {broken:,} of the {outside:,} outside break it{alone}."
    )


def _decides(figure: Figure, sobol: Sequence[statistics.SobolIndices], names: Mapping[str, str]) -> list[str]:
    """Return sentences on how much of a figure's variance each factor explains; none without Sobol indices."""
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
    # First-order indices add up to 1 if the effects are additive; the rest of the variance is interaction.
    together = 1.0 - float(np.sum(indices.first))
    if together >= _INFLUENCE:
        texts.append(Text(f"{Quantity(together, 'share'):.0f} of it is decided by several together."))
    return texts


def share_text(value: float, interval: np.ndarray) -> str:
    """Return a share of a variance with its interval as text: `63 % (40 to 88 %)`."""
    middle, low, high = (Quantity(part, "share", form=".0f") for part in (value, *interval))
    return Text(f"{middle} ({replace(low, bare=True)} to {high})")


def correlation(value: float) -> str:
    """Return a correlation coefficient as a string with its sign."""
    return f"{Quantity(value):+.2f}"


def _between(rank: statistics.RankCorrelation) -> str:
    return "" if rank.interval is None else " to ".join(map(correlation, rank.interval))


def _goes_with(
    figure: Figure, correlations: Sequence[statistics.RankCorrelation], names: Mapping[str, str]
) -> list[str]:
    """Return sentences on the columns that have the largest rank correlation with a figure; none if all are small."""
    # The square is a share of the rank variance, so the threshold of the Sobol indices applies.
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


_DOTS = 1200  # points of a scatter plot, to keep the page small
_PANELS = 12  # largest number of histograms
_OUTPUTS = 4  # outputs whose sensitivities are shown
_FACTORS = 8  # shown per output
_LETTERS = 30  # longest shown name of a factor


def labelled(figure: Figure) -> str:
    """Return the axis label of a figure, with its unit."""
    return f"{name_of(figure)} ({unit_name(figure.unit)})" if figure.unit else name_of(figure)


def _scale(unit: str) -> float:
    """Return the factor from an SI unit to the unit used in charts."""
    return USUAL.of(unit)[1]


def yields_chart(yields: statistics.Yield) -> Chart:
    """Return a chart of the shares of machines that satisfy each bound and all bounds, with 95 % intervals."""
    rows = [(bound_text(bound.bound), bound.kept) for bound in yields.bounds]
    rows.append(("all of them" if rows else "with figures", yields.inside))
    # Row k is drawn at the ordinate -k, so that the first bound is at the top.
    lines, dots = list[Curve](), list[Curve]()
    for row, (_, share) in enumerate(rows):
        number = chart.NEUTRAL if row == len(rows) - 1 else 0
        if share.interval is not None:
            ends = 100.0 * np.array(share.interval)
            lines.append(Curve(ends, np.full(2, -float(row)), number=number, size=1.6))
        dots.append(
            Curve(np.array([100.0 * share.value]), np.array([-float(row)]), number=number, look=chart.MARKERS, size=1.3)
        )
    # Yields are often close to 100 %: an axis from 0 would hide their differences.
    low = min((share.interval or (share.value,))[0] for _, share in rows)
    left = 100.0 * max(0.0, low - 0.08 * (1.0 - low) - 0.002)
    right = 100.0 + 100.0 * (0.03 * (1.0 - low) + 5e-4)
    ticks = tuple(Tick(-float(row), caption=text) for row, (text, _) in enumerate(rows))
    panel = Panel("", (*lines, *dots), ticks=ticks, low=0.6 - len(rows), high=0.6)
    label = "machines that keep it (%); lines: 95 % interval"
    return Chart(label, (panel,), low=left, high=right, height=0.9 + 0.36 * len(rows))


def histograms_chart(sample: statistics.Judged, banded: bool = False) -> Chart:
    """Return a histogram of each figure over the machines, with its bound.

    banded  True to omit figures of the dynamic stiffness that have no bound; a band chart shows them instead
    """
    figures = _figures(sample.study, banded)[:_PANELS]
    bounds = {bound.figure: bound for bound in sample.study.specification}
    panels = tuple(_histogram(figure, sample.figures[figure.key], bounds.get(figure)) for figure in figures)
    across = min(2, len(panels))
    return Chart("", panels, across=across, height=0.5 + 1.9 * -(-len(panels) // across))


def _figures(study: Study, banded: bool) -> list[Figure]:
    """Return the figures to draw, starting with those that have a bound."""
    bounded = [bound.figure for bound in study.specification]
    others = [figure for figure in study.measure if not (banded and isinstance(figure.of, StiffnessAt))]
    return list(dict.fromkeys([*bounded, *others]))


def _histogram(figure: Figure, values: np.ndarray, bound: Bound | None) -> Panel:
    factor = _scale(figure.unit)
    values = factor * values[np.isfinite(values)]
    panel = Panel("machines", abscissa=Abscissa(labelled(figure)))
    if values.size:
        panel = histogram(values, labelled(figure), "machines", values.size // 8)
        panel = replace(panel, caption=Text(f"median {Quantity(np.median(values) / factor, figure.unit, bare=True)}"))
    ends = [factor * end for end in (() if bound is None else (bound.least, bound.most)) if end is not None]
    if ends and panel.abscissa is not None and panel.abscissa.low is not None and panel.abscissa.high is not None:
        low, high = panel.abscissa.low, panel.abscissa.high
        # A bound far from all values must still be visible.
        room = 0.03 * (max(high, *ends) - min(low, *ends))
        wider = replace(
            panel.abscissa, low=min(low, *(e - room for e in ends)), high=max(high, *(e + room for e in ends))
        )
        panel = replace(panel, abscissa=wider)
    levels = tuple(Level(end, upright=True, dashed=True, number=chart.ALERT) for end in ends)
    return replace(panel, levels=levels)


def decides_chart(
    study: Study, indices: Sequence[statistics.SobolIndices], correlations: Sequence[statistics.RankCorrelation]
) -> Chart:
    """Return a bar chart of the Sobol indices, or else the rank correlations, of each figure that has a bound, with
    confidence intervals.
    """
    outputs = _outputs(study)
    sobol = {row.output: row for row in indices if row.output in outputs}
    ranks = {name: [rank for rank in correlations if rank.output == name] for name in outputs}
    titles = {figure.key: name_of(figure) for figure in study.measure} | {statistics.INSIDE: "inside the specification"}
    shown = [name for name in outputs if (sobol if indices else ranks).get(name)]
    panels = [_indices(sobol[name]) if indices else _correlations(ranks[name]) for name in shown]
    panels = [replace(panel, caption=titles[name]) for panel, name in zip(panels, shown, strict=True)]
    count = min(_FACTORS, len(study.vary) if indices else max((len(ranks[name]) for name in shown), default=0))
    label = "share of the variance" if indices else "rank correlation, -1 to 1"
    low, high = (None, None) if indices else (-1.0, 1.0)
    return Chart(
        f"{label}; lines: 95 % interval",
        tuple(panels) or (Panel("", caption="no output varies"),),
        low=low,
        high=high,
        height=0.7 + max(len(panels), 1) * (0.45 + 0.27 * count),
    )


def _outputs(study: Study) -> list[str]:
    """Return the outputs to show: figures with a bound and `INSIDE`, or, if no bounds exist, the first few figures."""
    bounded = [bound.figure.key for bound in study.specification][: _OUTPUTS - 1]
    return [*bounded, statistics.INSIDE] if bounded else [figure.key for figure in _figures(study, True)][:_OUTPUTS]


def _indices(indices: statistics.SobolIndices) -> Panel:
    order = indices.order[:_FACTORS].tolist()
    boxes, lines = list[Box](), list[Curve]()
    for offset, value, interval, number, name in (
        (0.19, indices.first, indices.first_interval, 0, "alone"),
        (-0.19, indices.total, indices.total_interval, 5, "with what it does together with others"),
    ):
        for row, i in enumerate(order):
            y, size = offset - row, float(value[i])
            boxes.append(Box(min(0.0, size), max(0.0, size), y - 0.18, y + 0.18, number, name))
            lines.append(Curve(interval[:, i], np.full(2, y), number=chart.NEUTRAL))
    return _rows([indices.factors[i] for i in order], indices.factors, boxes, lines)


def _correlations(correlations: Sequence[statistics.RankCorrelation]) -> Panel:
    some = correlations[:_FACTORS]
    boxes = [
        Box(min(0.0, rank.value), max(0.0, rank.value), -row - 0.31, -row + 0.31, int(rank.value >= 0.0))
        for row, rank in enumerate(some)
    ]
    lines = [
        Curve(np.array(rank.interval), np.full(2, -float(row)), number=chart.NEUTRAL)
        for row, rank in enumerate(some)
        if rank.interval is not None
    ]
    panel = _rows([rank.column for rank in some], [rank.column for rank in correlations], boxes, lines)
    # Correlations have either sign, unlike shares of a variance: mark the zero.
    return replace(panel, levels=(Level(0.0, upright=True),))


def _rows(some: Sequence[str], names: Sequence[str], boxes: Sequence[Box], lines: Sequence[Curve]) -> Panel:
    short_names = short(names)
    shown = [style.shortened(short_names[name], _LETTERS) for name in some]
    return Panel("", tuple(lines), boxes=tuple(boxes), ticks=chart.listed(shown), low=0.55 - len(some), high=0.55)


def stiffness_band_chart(band: statistics.Band) -> Chart:
    """Return a chart of the quantiles of the dynamic stiffness over frequency."""
    panel = replace(_quantiles(band, "dynamic stiffness"), scale=chart.LOG)
    ends = float(band.x[0]), float(band.x[-1])
    return Chart(f"frequency ({unit_name('Hz')})", (panel,), chart.FREQUENCY, *ends, height=3.2)


def error_band_chart(band: statistics.Band) -> Chart:
    """Return a chart of the quantiles of the following error over time."""
    return Chart("time (s)", (replace(_quantiles(band, "largest following error"), low=0.0),), height=3.0)


def _quantiles(band: statistics.Band, what: str) -> Panel:
    values = _scale(band.unit) * band.quantiles
    areas = Band(band.x, values[0], values[4], 0), Band(band.x, values[1], values[3], 0)
    caption = "line: median; dark: every second machine; light: nine of ten"
    return Panel(f"{what} ({unit_name(band.unit)})", (Curve(band.x, values[2]),), bands=areas, caption=caption)


def front_chart(front: statistics.Front, sample: statistics.Judged) -> Chart:
    """Return scatter plots of tracking, stiffness and robustness; rings mark the Pareto front."""
    first, *others = front.figures.values()
    some = np.linspace(0, sample.variant.size - 1, min(_DOTS, sample.variant.size)).astype(int)
    kept = np.arange(front.rows.variant.size)[:_DOTS]
    panels = list[Panel]()
    for other in others:
        curves = list[Curve]()
        for inside, number, name in ((True, 0, "inside"), (False, 1, "outside")):
            chosen = some[sample.inside[some] == inside]
            if chosen.size:
                place = _place(sample.figures, first, other, chosen)
                curves.append(Curve(*place, name, number, chart.MARKERS, size=0.5))
        ring = _place(front.rows.figures, first, other, kept)
        curves.append(Curve(*ring, "front", chart.NEUTRAL, chart.RING, size=1.45))
        low, high = _ends(curves, "y", 0.06)
        panels.append(Panel(labelled(other), tuple(curves), low=low, high=high))
    left, right = _ends([curve for panel in panels for curve in panel.curves], "x", 0.04)
    return Chart(labelled(first), tuple(panels), low=left, high=right, height=0.6 + 3.0 * len(others))


def _ends(curves: Sequence[Curve], axis: Literal["x", "y"], part: float) -> tuple[float, float]:
    values = np.concatenate([getattr(curve, axis) for curve in curves])
    # Without any finite value a chart still needs a finite range.
    return style.padded(float(np.min(values)), float(np.max(values)), part) if values.size else (0.0, 1.0)


def _place(
    figures: Mapping[str, np.ndarray], first: Figure, other: Figure, chosen: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    x, y = (_scale(figure.unit) * figures[figure.key][chosen] for figure in (first, other))
    # Infinite margins are valid figures, but have no place on a linear axis.
    seen = np.isfinite(x) & np.isfinite(y)
    return x[seen], y[seen]


@dataclass(frozen=True, eq=False, repr=False)
class Answers(Result):
    """The answers of a study.

    sample        rows of randomly drawn machines, for distributions
    worst         the worst variants by figure
    bad           numbers of the first variants whose figures could not be computed, with the reasons
    sobol         Sobol indices, one entry per output; empty unless the sampler is saltelli
    correlations  rank correlations between the outputs and the varied numbers
    stiffness     quantile band over frequency, if at least three figures stiffness_F_Hz_N_per_m are measured
    error         quantile band of the following error over time, from some machines that are simulated again
    """

    study: Study
    sample: statistics.Judged
    yields: statistics.Yield
    worst: tuple[statistics.Worst, ...]
    bad: tuple[tuple[int, str], ...]
    sobol: tuple[statistics.SobolIndices, ...]
    correlations: tuple[statistics.RankCorrelation, ...]
    front: statistics.Front | None
    stiffness: statistics.Band | None
    error: statistics.Band | None

    @property
    def rotary(self) -> bool:
        """True if the axis of the study is rotary."""
        return self.study.rotary

    @property
    def quoted(self) -> Sequence[str]:
        """The strings written by the user: the title, and the names of the choices and varied numbers."""
        return self.study.title, *self.study.columns, *(varied.name for varied in self.study.vary)

    @cached_property
    def sentences(self) -> list[str]:
        """The answers as sentences, most important first."""
        return sentences(self.study, self.yields, self.sobol, self.correlations)

    def table(self) -> Table:
        """Tabulate the yield of each bound, and of all bounds together."""
        rows: list[list[Cell]] = [
            [bound_text(bound_yield.bound), bound_yield.kept.kept, interval_text(bound_yield.kept), bound_yield.alone]
            for bound_yield in self.yields.bounds
        ]
        inside = self.yields.inside
        whole = "all of them" if rows else "with figures"
        rows.append([whole, inside.kept, interval_text(inside), None])
        return Table(
            f"{self.study.title}: yield of {inside.of:,} machines",
            ["kept", Column("machines", "", ",.0f"), "share (95 % interval)", Column("break only this", "", ",.0f")],
            rows,
        )


@chart_of.register
def _chart(answers: Answers) -> Chart:
    return histograms_chart(answers.sample, answers.stiffness is not None)


def answers_of(rows: Store | pyarrow.Table, study: Study, progress: Progress | None = None) -> Answers:
    """Return the answers for the rows of a complete sweep, in a store or as a table.

    Up to 128 machines are simulated again to compute the quantile band of the following error over time.

    Raises ParameterError for rows of another study, and FileError for a store that cannot be read.
    """
    progress = progress or Progress()
    counted, worst, front, sampled = (
        statistics.YieldCount(study),
        statistics.WorstKept(study),
        statistics.FrontKept(study),
        statistics.Sampled(study),
    )
    saltelli = statistics.SaltelliRows(study)
    seen = 0
    # One pass for all collectors, so that each chunk is read and verified only once.
    for part in statistics.parts(rows, study):
        progress.step("answers", seen, study.count)
        for collector in (counted, worst, front, sampled, saltelli):
            collector.add(part)
        seen += part.variant.size
    # An incomplete store holds the chunks that happened to be finished, which are no sample of a grid or a Saltelli
    # design.
    if seen != study.count:
        raise ParameterError(f"{study.file.name} has {study.count:,} variants, and here are rows of {seen:,}")
    sample = sampled.result()
    progress.step("sensitivity")
    return Answers(
        study=study,
        sample=sample,
        yields=counted.result(),
        worst=worst.result(),
        bad=tuple(worst.bad),
        sobol=saltelli.result(),
        correlations=statistics.rank_correlations(sample),
        front=front.result(),
        stiffness=statistics.stiffness_band(sample),
        error=statistics.error_band(sample, progress),
    )

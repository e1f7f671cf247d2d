"""Drawing of charts with matplotlib in the common style; no other module of feeddrive draws with it."""

from __future__ import annotations

from functools import wraps
from typing import TYPE_CHECKING, Any, ParamSpec

import numpy as np

from feeddrive.language.quantity import Units
from feeddrive.language.table import READER
from feeddrive.plot import chart as looks
from feeddrive.plot import placing, style
from feeddrive.plot.chart import Abscissa, Band, Box, Chart, Curve, Disc, Field, Heat, Level, Note, Panel, Tick

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.axes import Axes
    from matplotlib.axis import Axis

    from feeddrive.plot.chart import Mark
    from feeddrive.plot.picture import Picture


def name_marks(ax: Any, marks: Sequence[Mark], color: Callable[[int], str]) -> None:
    """Write the labels of marks; marks at the same point share a label. The axes must have their final size and
    ranges.
    """
    at: dict[tuple[float, float], list[Mark]] = {}
    # points, in which fonts are measured, not pixels
    scale = 72.0 / ax.figure.dpi
    for mark in (mark for mark in marks if mark.name):
        place = scale * ax.transData.transform((mark.x, mark.y))
        near = next((point for point in at if np.hypot(point[0] - place[0], point[1] - place[1]) < 2.0), None)
        at.setdefault((float(place[0]), float(place[1])) if near is None else near, []).append(mark)
    taken = [(px - 4.0, py - 4.0, px + 4.0, py + 4.0) for px, py in at]
    edge = scale * ax.bbox.extents
    for (px, py), there in at.items():
        text = ", ".join(str(style.caption(mark.name)) for mark in there)
        box = placing.free_spot((px, py), (_WIDE * len(text), _TALL), taken, edge)
        taken.append(box)
        middle = (0.5 * (box[0] + box[2]), 0.5 * (box[1] + box[3]))
        data, tint = (there[0].x, there[0].y), color(there[0].number)
        ax.annotate(
            text,
            data,
            (middle[0] - px, middle[1] - py),
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=style.SMALL - 1,
            color=tint,
        )
        end = (min(max(px, box[0]), box[2]), min(max(py, box[1]), box[3]))
        if np.hypot(end[0] - px, end[1] - py) > 0.8 * placing.STEP:
            ax.annotate(
                "",
                data,
                (end[0] - px, end[1] - py),
                textcoords="offset points",
                arrowprops={"arrowstyle": "-", "color": tint, "linewidth": 0.7},
            )


P = ParamSpec("P")
_WIDE, _TALL = 4.2, 10.5  # points: width of a letter of a label, height of a line
_MANY, _FEW = 1e4, 1e2  # logarithmic ranges: above, only some decades are labeled; below, 2 and 5 are labeled too
_NARROW = 4.0  # on the x axis: logarithmic ranges below have round numbers between the decades too
_DECADES = 5.0  # on the x axes of a row of panels: up to so many, 2 and 5 are labeled too


def figure_of(chart: Callable[P, Chart]) -> Callable[P, Picture]:
    """Return a function that draws the chart of a function `..._chart` as a matplotlib figure."""

    @wraps(chart)
    def draw(*args: P.args, **options: P.kwargs) -> Picture:
        return drawn(chart(*args, **options))

    draw.__name__ = draw.__qualname__ = chart.__name__.removesuffix("_chart")
    return draw


def drawn(chart: Chart, units: Units | None = None) -> Picture:
    """Draw a chart as a matplotlib figure, with its labels in `units`, by default those of `READER`."""
    # not at the top: making a chart must not import matplotlib
    from feeddrive.plot.picture import Picture

    chart = chart.shown(units or READER.get())
    figure = Picture(figsize=(chart.width, chart.height), layout="constrained", facecolor=style.PAPER)
    axes = _axes(figure, chart)
    for ax, panel in zip(axes, chart.panels, strict=True):
        _panel(ax, panel, chart, crowded=len(axes) > 2)
    _abscissas(axes, chart)
    named = [(ax, panel.marks) for ax, panel in zip(axes, chart.panels, strict=True) if _has_names(panel)]
    _legends(figure, axes, chart)
    if len(axes) > 1 and not chart.bare:
        figure.align_ylabels(axes)
    if named:
        # the layout is constrained: only after a draw do the axes have the size for which labels are placed
        figure.draw_without_rendering()
    for ax, marks in named:
        name_marks(ax, marks, _color)
    return figure


def _has_names(panel: Panel) -> bool:
    return any(mark.name for mark in panel.marks)


def _axes(figure: Picture, chart: Chart) -> list[Axes]:
    """Return the axes of the panels, in rows; panels without their own abscissa share one, with numbers at the bottom
    only.
    """
    places, row, column = list[tuple[int, int]](), 0, 0
    for panel in chart.panels:
        if column and (panel.whole or column == chart.across):
            row, column = row + 1, 0
        places.append((row, column))
        column = chart.across if panel.whole else column + 1
    shares, widths = [0.0] * (row + 1), [0.0] * chart.across
    for panel, (row, column) in zip(chart.panels, places, strict=True):
        shares[row] = max(shares[row], panel.share)
        if not panel.whole:
            widths[column] = max(widths[column], panel.width)
    # A column that only whole rows cross has no width yet, and a gridspec refuses 0.
    grid = figure.add_gridspec(
        len(shares), chart.across, height_ratios=shares, width_ratios=[width or 1.0 for width in widths]
    )
    axes: list[Axes] = []
    shared: list[Axes] = []
    for panel, (row, column) in zip(chart.panels, places, strict=True):
        spot = grid[row, :] if panel.whole else grid[row, column]
        with_others = panel.abscissa is None
        ax = style.dressed(figure.add_subplot(spot, sharex=shared[0] if with_others and shared else None))
        shared += [ax] if with_others else []
        axes.append(ax)
    return axes


def _abscissas(axes: Sequence[Axes], chart: Chart) -> None:
    """Set up the x axes once the curves are drawn; the shared one has its numbers below the lowest panel of each
    column.
    """
    shared: list[Axes] = []
    for ax, panel in zip(axes, chart.panels, strict=True):
        if panel.abscissa is None:
            shared.append(ax)
        else:
            _abscissa(ax, panel.abscissa, panel, chart.across)
    if not shared:
        return
    _abscissa(shared[-1], chart.abscissa, chart.panels[-1], chart.across)
    lowest = {spec.colspan.start: ax for ax in shared if (spec := ax.get_subplotspec()) is not None}
    for ax in shared:
        if ax not in lowest.values():
            ax.tick_params(labelbottom=False)
        elif ax is not shared[-1]:
            ax.set_xlabel(chart.label, fontsize=style.TEXT)
    if chart.scale == looks.FREQUENCY:
        style.frequency_grid(shared)
    for ax in shared if chart.square else ():
        _square(ax, chart.abscissa)
    for ax in shared if chart.bare else ():
        ax.set_axis_off()


def _abscissa(ax: Axes, abscissa: Abscissa, panel: Panel, across: int) -> None:
    if abscissa.scale == looks.FREQUENCY:
        assert abscissa.low is not None
        assert abscissa.high is not None
        style.frequency_axis(ax, abscissa.low, abscissa.high)
    elif abscissa.low is not None or abscissa.high is not None:
        ax.set_xlim(abscissa.low, abscissa.high)
    if abscissa.scale == looks.LOG:
        ax.set_xscale("log")
        low, high = ax.get_xlim()
        if high < _NARROW * low:
            # of 1, 2 and 5 there may be a single one in this range
            style.plain_numbers(ax.xaxis, 4)
        else:
            # three numbers a decade touch each other where narrow panels have many decades
            style.plain_decades(ax.xaxis, between=across * np.log10(high / low) <= _DECADES)
    if abscissa.ticks is not None:
        _ticks(ax.xaxis, abscissa.ticks)
    elif abscissa.scale == looks.LINEAR and across > 1:
        style.few_numbers(ax, 6 if across == 2 else 4)
    if any(box.level is not None for box in panel.boxes):
        _table(ax)
    if abscissa.square and panel.abscissa is not None:
        _square(ax, abscissa)
    ax.set_xlabel(abscissa.label, fontsize=style.TEXT)


def _square(ax: Axes, abscissa: Abscissa) -> None:
    """Set equal scales for x and y: adapt the panel shape to the ranges, or widen the ranges if they are not fixed."""
    ax.set_aspect("equal", adjustable="box" if abscissa.low is not None else "datalim")
    if abscissa.low is None:
        ax.margins(0.04)
        ax.locator_params(nbins=6)
        ax.ticklabel_format(scilimits=(-3, 5))


def _ticks(axis: Axis, ticks: Sequence[Tick]) -> None:
    texts = [style.caption(tick.name, tick.caption) or "" for tick in ticks]
    axis.set_ticks([tick.value for tick in ticks], labels=texts)
    # A logarithmic axis would keep its minor ticks between the texts.
    axis.set_ticks([], minor=True)
    if any(tick.name for tick in ticks):
        axis.grid(visible=False)


def _table(ax: Axes) -> None:
    """Set up the axes of a table: slanted column names above the cells, no axis lines and no grid."""
    ax.xaxis.tick_top()
    ax.tick_params(axis="x", labelrotation=40)
    for label in ax.get_xticklabels():
        # Turned about its left end, a name begins above its column.
        label.set_horizontalalignment("left")
        label.set_rotation_mode("anchor")
    ax.tick_params(length=0)
    ax.grid(visible=False)
    for spine in ax.spines.values():
        spine.set_visible(False)


def _legends(figure: Picture, axes: Sequence[Axes], chart: Chart) -> None:
    # limits come last in the legend, behind all curves
    limits = {style.caption("", level.caption) for panel in chart.panels for level in panel.levels}
    curves, levels = dict[str, Any](), dict[str, Any]()
    for ax in axes:
        entries = dict[str, Any]() if chart.legend == looks.PANELS else curves
        for handle, text in zip(*ax.get_legend_handles_labels(), strict=True):
            (levels if text in limits else entries).setdefault(str(text), handle)
        if chart.legend == looks.PANELS:
            style.row_legend(ax, entries)
    entries = curves | levels
    if chart.legend == looks.RIGHT and entries:
        figure.legend(
            list(entries.values()),
            list(entries),
            loc="outside right upper",
            fontsize=style.SMALL,
            frameon=False,
            labelcolor=style.INK,
            handlelength=2.6,
            labelspacing=1.0,
        )
    else:
        style.figure_legend(figure, entries, chart.columns)
    if chart.side:
        figure.supylabel(chart.side, fontsize=style.TEXT, color=style.INK)
    if chart.caption:
        figure.suptitle(style.caption(chart.caption, most=120) or "", fontsize=style.TEXT, color=style.ALERT)
    if chart.beside:
        axes[0].set_anchor("W")
        axes[0].annotate(
            style.escaped(chart.beside),
            (1.02, 0.5),
            xycoords="axes fraction",
            ha="left",
            va="center",
            fontsize=style.SMALL,
            color=style.INK,
            linespacing=1.5,
        )


def _panel(ax: Axes, panel: Panel, chart: Chart, crowded: bool) -> None:
    kinds = list(dict.fromkeys(level.caption for level in panel.levels if level.caption))
    for level in panel.levels:
        _level(ax, level, kinds.index(level.caption) if level.caption else 0)
    # what is drawn later covers what is below: areas first, then curves, then marks and words
    for disc in panel.discs:
        _disc(ax, disc)
    if panel.field is not None and panel.heat is not None:
        _field(ax, panel.field, panel.heat)
    for box in panel.boxes:
        _box(ax, box)
    for band in panel.bands:
        _band(ax, band)
    for curve in panel.curves:
        if curve.heat is None:
            _curve(ax, curve)
        elif panel.heat is not None:
            _heat(ax, curve, curve.heat, panel.heat)
    for mark in panel.marks:
        face: dict[str, Any] = {"markerfacecolor": style.PAPER} if mark.hollow else {}
        ax.plot(
            [mark.x],
            [mark.y],
            style.marker(mark.number),
            color=_color(mark.number),
            markersize=6.0 if mark.name else 4.5,
            **face,
        )
    for note in panel.notes:
        _note(ax, note)
    if panel.scale == looks.LOG:
        # Before the limits, since a change of scale resets them.
        ax.set_yscale("log")
    if panel.scale == looks.DEGREES:
        assert panel.low is not None
        assert panel.high is not None
        style.degrees_axis(ax, panel.low, panel.high)
    elif panel.low is not None or panel.high is not None:
        ax.set_ylim(panel.low, panel.high)
    if panel.scale == looks.LOG:
        low, high = ax.get_ylim()
        many, few = low * _MANY < high, not crowded and high < _FEW * low
        style.plain_decades(ax.yaxis, crowded=crowded or many, between=few or chart.scale == looks.LOG)
        if not many:
            ax.grid(True, which="minor", axis="y", color=style.GRID, linewidth=0.4)
    if panel.ticks is not None:
        _ticks(ax.yaxis, panel.ticks)
    ax.set_ylabel(panel.label, fontsize=style.TEXT)
    if panel.caption:
        style.note(ax, style.caption(panel.caption, most=120) or "")


def _level(ax: Axes, level: Level, kind: int) -> None:
    draw = ax.axvline if level.upright else ax.axhline
    tint = _color(level.number, style.MUTED if level.dashed or level.faint else style.INK)
    draw(
        level.value,
        color=tint,
        linewidth=0.8 if level.faint else 1.0,
        label=style.caption("", level.caption),
        linestyle=_dashes(style.LIMITS[kind % len(style.LIMITS)] if level.dashed else ()),
    )
    if not level.text:
        return
    where, of = (
        ((level.value, 1.0), ("data", "axes fraction"))
        if level.upright
        else ((0.0, level.value), ("axes fraction", "data"))
    )
    ax.annotate(
        style.escaped(level.text),
        where,
        xycoords=of,
        xytext=(4, -2),
        textcoords="offset points",
        va="top",
        fontsize=style.SMALL,
        color=style.MUTED,
    )


def _box(ax: Axes, box: Box) -> None:
    tint = _color(box.number, style.MUTED)
    look: dict[str, Any] = {"facecolor": tint, "edgecolor": style.PAPER, "linewidth": 0.5}
    if box.pale:
        look = {"color": tint, "alpha": 0.14, "linewidth": 0.0}
    if box.hatched:
        look = {"color": style.GRID, "hatch": "///", "edgecolor": style.MUTED, "linewidth": 0.6}
    elif box.level is not None:
        from matplotlib.colors import LinearSegmentedColormap

        shades = LinearSegmentedColormap.from_list("level", [style.BETTER, style.PAPER, style.WORSE])
        look = {"color": shades(0.5 + 0.42 * box.level), "linewidth": 0.0}
    look["label"] = style.caption(box.name)
    if box.low is None or box.high is None:
        ax.axvspan(box.left, box.right, zorder=0.5, **look)
        return
    ax.barh(0.5 * (box.low + box.high), box.right - box.left, box.high - box.low, box.left, **look)
    if not box.text:
        return
    away = 0 if not box.beside else 5 if box.right + box.left >= 0.0 else -5
    x = 0.5 * (box.left + box.right) if not away else box.right if away > 0 else box.left
    ax.annotate(
        style.escaped(box.text),
        (x, 0.5 * (box.low + box.high)),
        xytext=(away, 0),
        textcoords="offset points",
        ha="left" if away > 0 else "right" if away else "center",
        va="center",
        color=style.INK,
        fontsize=style.SMALL if away else style.SMALL - 1,
    )


def _field(ax: Axes, field: Field, scale: Heat) -> None:
    from matplotlib.colors import LinearSegmentedColormap

    colors = LinearSegmentedColormap.from_list("heat", style.HEAT)
    # rasterized: as vectors each cell would be a path of the file
    ax.pcolormesh(
        field.x, field.y, field.values, cmap=colors, vmin=scale.low, vmax=scale.high, shading="nearest", rasterized=True
    )
    ax.grid(visible=False)
    _scale(ax, scale, colors)


def _disc(ax: Axes, disc: Disc) -> None:
    from matplotlib.patches import Circle

    where, tint = (disc.x, disc.y), style.GRID if disc.faint else _color(disc.number, style.MUTED)
    if disc.filled:
        ax.add_patch(Circle(where, disc.radius, facecolor=tint, alpha=0.10, edgecolor="none"))
    dashes = style.LIMITS[0] if disc.number < 0 else style.DASHES[disc.number % len(style.DASHES)]
    line = _dashes(() if disc.faint else dashes)
    ax.add_patch(Circle(where, disc.radius, fill=False, edgecolor=tint, linewidth=0.9, linestyle=line))


def _note(ax: Axes, note: Note) -> None:
    off, across, along = (3, "left", "bottom") if note.right else (-5, "right", "top")
    if note.middle:
        off, across, along = 0, "center", "center"
    back = {"facecolor": style.PAPER, "edgecolor": "none", "alpha": 0.8, "pad": 0.8}
    ax.annotate(
        style.escaped(note.text),
        (note.x, note.y),
        xytext=(off, off),
        textcoords="offset points",
        ha=across,
        va=along,
        fontsize=style.SMALL,
        color=_color(note.number, style.MUTED),
        bbox=None if note.number == looks.NEUTRAL else back,
    )


def _heat(ax: Axes, curve: Curve, heat: np.ndarray, scale: Heat) -> None:
    """Draw a curve in steps of color and width, with its color bar."""
    from matplotlib.colors import LinearSegmentedColormap

    n = style.HEAT_STEPS
    colors = LinearSegmentedColormap.from_list("heat", style.HEAT, n)
    # one line for each of a few colors: a line for each segment would be thousands of objects
    # A segment has the larger value of its two ends, so that a single peak keeps its color.
    larger = np.maximum(heat[:-1], heat[1:])
    # NaN equals no step and therefore draws no line.
    step = style.heat_step(larger, scale)
    for k in range(n):
        rows = np.flatnonzero(step == k)
        if rows.size:
            x, y = (style.stretches(row, rows) for row in (curve.x, curve.y))
            ax.plot(x, y, color=colors(k), linewidth=style.heat_width(k), solid_capstyle="round")
    _scale(ax, scale, colors)


def _scale(ax: Axes, scale: Heat, colors: Any) -> None:
    """Draw the color bar of a color scale."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    bar = ax.figure.colorbar(ScalarMappable(Normalize(scale.low, scale.high), colors), ax=ax, pad=0.02, aspect=30)
    bar.set_label(scale.label, fontsize=style.TEXT, color=style.INK)
    bar.ax.tick_params(colors=style.MUTED, labelcolor=style.INK, labelsize=style.SMALL)
    bar.outline.set_visible(False)  # type: ignore[operator]


def _band(ax: Axes, band: Band) -> None:
    ax.fill_between(
        band.x,
        band.low,
        band.high,
        color=_color(band.number, style.MUTED),
        alpha=style.BAND,
        linewidth=0.0,
        label=style.caption(band.name),
    )


def _curve(ax: Axes, curve: Curve) -> None:
    if curve.reach is not None:
        _discs(ax, curve, curve.reach)
        return
    name = style.caption(curve.name, curve.caption)
    tint = _color(curve.number)
    if curve.look == looks.SOLID:
        ax.fill(*(row for shape in style.shapes(curve) for row in shape), color=tint, linewidth=0.0, label=name)
    elif curve.look == looks.BAR:
        ax.plot(curve.x, curve.y, label=style.caption(curve.name), **_look(style.stroke(curve), tint))
        if curve.caption:
            _beside(ax, float(curve.x[0]), float(np.mean(curve.y)), curve.caption)
    else:
        tint = _color(curve.number, style.MUTED) if curve.look == looks.WIDE else tint
        ax.plot(curve.x, curve.y, label=name, **_look(style.stroke(curve), tint))


def _look(stroke: style.Stroke, tint: str) -> dict[str, Any]:
    """Return the look of a curve for matplotlib."""
    look: dict[str, Any] = {"color": tint, "linewidth": stroke.line, "linestyle": "none"}
    if stroke.line:
        look["linestyle"] = _dashes([part / stroke.line for part in stroke.dashes])
    if stroke.alpha < 1.0:
        look["alpha"] = stroke.alpha
    if stroke.butt:
        look["solid_capstyle"] = "butt"
    if stroke.marker:
        look |= {"marker": stroke.marker, "markersize": stroke.size, "markeredgewidth": stroke.edge}
    if stroke.hollow:
        look["markerfacecolor"] = "none"
    return look


def _dashes(pattern: Sequence[float]) -> Any:
    """Return the line style of dashes in line widths."""
    return (0, tuple(pattern)) if pattern else "-"


def _discs(ax: Axes, curve: Curve, reach: np.ndarray) -> None:
    """Draw discs in one pale opaque color, so that an overlap does not look like a higher probability."""
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Circle

    pale = style.pale(_color(curve.number))
    circles = [Circle((x, y), r) for x, y, r in zip(curve.x, curve.y, reach, strict=True)]
    ax.add_collection(PatchCollection(circles, facecolor=pale, edgecolor="none", zorder=0.5))
    if curve.name:
        # matplotlib has no legend handler for a collection of patches.
        ax.plot([], [], color=pale, linewidth=6, label=style.caption(curve.name, curve.caption))


def _color(number: int, neutral: str = style.INK) -> str:
    return style.ALERT if number == looks.ALERT else neutral if number < 0 else style.color(number)


def _beside(ax: Axes, x: float, y: float, text: str) -> None:
    """Write a text next to a bar, on the side with more room."""
    low, high = ax.get_xlim()
    # bars are margins over frequency, on a logarithmic axis
    right = np.log(x / low) < 0.85 * np.log(high / low)
    ax.annotate(
        style.escaped(text),
        (x, y),
        xytext=(5 if right else -5, 0),
        textcoords="offset points",
        ha="left" if right else "right",
        va="center",
        fontsize=style.SMALL,
        color=style.INK,
        bbox={"facecolor": style.PAPER, "edgecolor": "none", "alpha": 0.8, "pad": 0.8},
    )

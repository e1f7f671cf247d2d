"""The common style of all plots: colors, lines, units, axes, and the decimation of long curves.

No global matplotlib setting is changed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from feeddrive.plot import chart
from feeddrive.plot.chart import WIDTH as WIDTH
from feeddrive.plot.chart import Curve, Heat
from feeddrive.plot.ticks import phase_step

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from feeddrive.plot.picture import Picture

Thing = TypeVar("Thing")

# Okabe & Ito 2008, without yellow, which is unreadable on white, and without black, which is the text color
COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
# dashes and gaps in line widths, for color-blind readers and gray print; the first curve is solid
DASHES: tuple[tuple[float, ...], ...] = ((), (7, 2), (2, 1.5), (7, 2, 2, 2), (12, 3), (4, 1.5, 1, 1.5))
LIMITS = (4.0, 3.0), (1.5, 1.5), (6.0, 1.5, 1.5, 1.5)  # dashes of limits that the legend distinguishes
MARKERS = ("o", "s", "^", "D", "v", "P")
# from small to large values: the lightness decreases uniformly, for gray print and color-blind readers
HEAT = ("#54b0d7", "#4197db", "#5e79d3", "#8554b2", "#98277f", "#8a0c47", "#6c0b1b")
# the same on dark paper, where large values are light
DARK_HEAT = ("#256acf", "#a066ce", "#e464b6", "#ff7c97", "#ffa28d", "#ffc28b", "#fce26c")
HEAT_STEPS = 12
_COLD, _HOT = 1.1, 2.6  # line width of the smallest and the largest value
INK, MUTED, GRID, PAPER, ALERT = "#1c2329", "#5a6772", "#d9dfe4", "#ffffff", "#b3261e"
BETTER, WORSE = COLORS[0], COLORS[1]  # end colors of a comparison; the middle is the background

TEXT, SMALL = 9.5, 8.5  # points
LINE = 1.4
BAND, PALE = 0.18, 0.22  # opacity of bands, and of areas of discs
WIDE = 8.0  # ratio of peaks above which curves need a logarithmic scale, or separate scales


def color(i: int) -> str:
    """Return the color of the i-th curve."""
    return COLORS[i % len(COLORS)]


def pale(tint: str) -> str:
    """Return a pale tint of a color, on which curves stay readable."""
    # opaque, not transparent: overlapping areas of one curve must not look darker
    return _mixed(PAPER, tint, PALE)


def _mixed(first: str, second: str, share: float) -> str:
    """Return the color between two colors, at a share of the way."""
    pairs = ((int(first[k : k + 2], 16), int(second[k : k + 2], 16)) for k in (1, 3, 5))
    return "#" + "".join(f"{round(a + share * (b - a)):02x}" for a, b in pairs)


def heat(k: int, colors: Sequence[str] = HEAT) -> str:
    """Return the color of the k-th of `HEAT_STEPS` steps of a color scale."""
    place = k / (HEAT_STEPS - 1) * (len(colors) - 1)
    i = min(int(place), len(colors) - 2)
    return _mixed(colors[i], colors[i + 1], place - i)


def heat_width(k: int) -> float:
    """Return the line width of the k-th step of a color scale, points."""
    return _COLD + (_HOT - _COLD) * k / (HEAT_STEPS - 1)


def heat_step(values: np.ndarray, scale: Heat) -> np.ndarray:
    """Return the step of values on a color scale, 0 to `HEAT_STEPS` - 1; NaN stays."""
    span = (scale.high - scale.low) or 1.0
    return np.clip(np.floor(HEAT_STEPS * (values - scale.low) / span), 0, HEAT_STEPS - 1)


def stretches(values: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return line segments from the chosen points to their successors, with NaN between consecutive runs."""
    ends = np.append(np.diff(rows) > 1, True)
    count = np.where(ends, 3, 1)
    last = np.cumsum(count)[ends] - 1
    taken = np.repeat(rows, count)
    taken[last - 1] += 1
    joined = values[taken].astype(np.float64)
    joined[last] = np.nan
    return joined


def shapes(curve: Curve) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield x and y of each polygon of a filled curve; NaN separates the polygons."""
    ends = np.flatnonzero(np.isnan(curve.x))
    for x, y in zip(np.split(curve.x, ends), np.split(curve.y, ends), strict=True):
        yield x[np.isfinite(x)], y[np.isfinite(x)]


class Stroke(NamedTuple):
    """The look of a curve, in points: width of its line and size of its markers, 0 for none.

    dashes  dashes and gaps, points
    edge    width of the outline of the markers
    hollow  True for markers that are outlines
    butt    True for a line with cut ends
    """

    line: float = 0.0
    dashes: tuple[float, ...] = ()
    marker: str = ""
    size: float = 0.0
    edge: float = 1.0
    hollow: bool = False
    alpha: float = 1.0
    butt: bool = False


def stroke(curve: Curve) -> Stroke:
    """Return the look of a curve by its kind, its number and its size."""
    size, shape = curve.size, marker(curve.number) if curve.number >= 0 else "o"
    line, dashed = LINE * size, dashes(curve.number) if curve.number >= 0 else ()
    match curve.look:
        case chart.THIN:
            return Stroke(0.6 * size, alpha=0.6)
        case chart.WIDE:
            return Stroke(2.6 * size, alpha=0.55, butt=True)
        case chart.BAR:
            return Stroke(2.4 * size, alpha=0.55, butt=True)
        case chart.PLAIN:
            return Stroke(line)
        case chart.DASHED:
            return Stroke(line, _times((4.0, 2.0), line))
        case chart.MARKED:
            return Stroke(LINE, _times(dashed, LINE), shape, 4.5 * size)
        case chart.MARKERS:
            return Stroke(marker=shape, size=4.5 * size)
        case chart.HOLLOW:
            return Stroke(marker=shape, size=5.0 * size, hollow=True)
        case chart.DOTS:
            return Stroke(marker="o", size=1.5 * size, alpha=0.6)
        case chart.CROSS:
            return Stroke(marker="x", size=7.0 * size, edge=1.6 * min(size, 1.0))
        case chart.RING:
            return Stroke(marker="o", size=5.5 * size, hollow=True)
        case chart.PLUS:
            return Stroke(marker="+", size=11.0 * size, edge=1.8)
        case _:
            return Stroke(line, _times(dashed, line))


def _times(pattern: Sequence[float], width: float) -> tuple[float, ...]:
    return tuple(width * part for part in pattern)


def dashes(i: int) -> tuple[float, ...]:
    """Return the dashes of the i-th curve in line widths; a second cycle of colors uses different dashes."""
    return DASHES[(i + i // len(COLORS)) % len(DASHES)]


def marker(i: int) -> str:
    """Return the marker of the i-th curve."""
    return MARKERS[i % len(MARKERS)]


def written(unit: str) -> str:
    """Return a unit in typographic form: um -> µm, m/s2 -> m/s²."""
    return unit.replace("um", "µm").replace("s2", "s²").replace("s3", "s³").replace("s4", "s⁴")


def named(things: Thing | Mapping[str, Thing] | Sequence[Thing]) -> dict[str, Thing]:
    """Return objects by name: a mapping unchanged, a list by `name`, a single object under an empty name."""
    if isinstance(things, Mapping):
        return dict(things)  # type: ignore[arg-type]
    if isinstance(things, Sequence):
        things_by_name: dict[str, Thing] = {}
        for i, thing in enumerate(things):
            name = str(getattr(thing, "name", "")) or str(i + 1)
            things_by_name[f"{name} {i + 1}" if name in things_by_name else name] = thing  # type: ignore[assignment]
        return things_by_name
    return {"": things}


def shortened(name: str, most: int = 60) -> str:
    """Return a user-given name without unprintable characters, truncated if too long."""
    shown = "".join(filter(str.isprintable, name))
    return shown if len(shown) <= most else shown[: most - 1] + "…"


def titled(name: str, remark: str = "", most: int = 60) -> str:
    """Return a user-given name, truncated if too long, with a remark behind it."""
    shown = shortened(name, most)
    return f"{shown}: {remark}" if shown and remark else shown or remark


def caption(name: str, remark: str = "", most: int = 60) -> str | None:
    """Return `titled` for matplotlib: escaped, visible in the legend, and None if it is empty."""
    text = escaped(titled(name, remark, most))
    # matplotlib leaves a label that begins with _ out of the legend: a zero-width space in front shows it
    return (f"\u200b{text}" if text.startswith("_") else text) or None


def escaped(text: str) -> str:
    """Return a string escaped for matplotlib, so that `$` does not start a formula."""
    return text.replace("$", r"\$")


def dressed(ax: Axes) -> Axes:
    """Apply the common style to axes, and return the axes."""
    ax.set_facecolor(PAPER)
    for side, spine in ax.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(MUTED)
        spine.set_linewidth(0.8)
    ax.tick_params(which="both", colors=MUTED, labelcolor=INK, labelsize=SMALL, width=0.8)
    ax.tick_params(which="minor", length=2)
    ax.grid(True, which="major", color=GRID, linewidth=0.8)
    ax.set_axisbelow(True)
    ax.margins(x=0)
    ax.xaxis.label.set_color(INK)
    ax.yaxis.label.set_color(INK)
    return ax


def narrow(things: Mapping[str, Any]) -> int:
    """Return the number of legend columns for long names: 2 for at most two entries, otherwise 1."""
    return 2 if len(things) <= 2 else 1


def figure_legend(figure: Picture, lines: Mapping[str, Any], columns: int = 4) -> None:
    """Put a legend of named curves above the figure."""
    if not lines:
        return
    rows = -(-len(lines) // columns)
    # each further row of the legend would otherwise be taken from the panels
    figure.set_figheight(figure.get_figheight() + 0.17 * (rows - 1))
    drawn = figure.legend(
        list(lines.values()),
        list(lines),
        loc="outside upper left",
        ncols=min(columns, len(lines)),
        fontsize=SMALL,
        frameon=False,
        handlelength=2.6,
        columnspacing=1.6,
        borderaxespad=0.2,
        labelcolor=INK,
    )
    for handle in drawn.legend_handles:
        # Lines are opaque in the legend; an area stays as pale as in its panel.
        if handle is not None and not hasattr(handle, "get_facecolor"):
            handle.set_alpha(1.0)


def row_legend(ax: Axes, entries: Mapping[str, Any]) -> None:
    """Put the legend of one row above it, left-aligned."""
    if entries:
        ax.legend(
            list(entries.values()),
            list(entries),
            loc="lower left",
            bbox_to_anchor=(0.0, 0.98),
            ncols=4,
            fontsize=SMALL,
            frameon=False,
            borderaxespad=0.0,
            borderpad=0.2,
            handlelength=2.0,
            labelcolor=INK,
        )


def note(ax: Axes, text: str) -> None:
    """Write a short text above the right end of the axes."""
    ax.annotate(
        text,
        (1.0, 1.0),
        xycoords="axes fraction",
        xytext=(0, 3),
        textcoords="offset points",
        ha="right",
        va="bottom",
        fontsize=SMALL,
        color=MUTED,
    )


def frequency_axis(ax: Axes, low: float, high: float) -> None:
    """Set a logarithmic x axis in Hz with plain numbers at decades, and at 2 and 5 if the range is below two
    decades.
    """
    from matplotlib.ticker import LogLocator

    ax.set_xscale("log")
    ax.set_xlim(low, high)
    plain_decades(ax.xaxis)
    # 1e-9: the ends are often decades themselves, and their logarithms a rounding off
    if np.floor(np.log10(high) + 1e-9) - np.ceil(np.log10(low) - 1e-9) < 1:
        ax.xaxis.set_major_locator(LogLocator(base=10, subs=(1.0, 2.0, 5.0)))
    ax.grid(True, which="minor", axis="x", color=GRID, linewidth=0.4)


def frequency_grid(axes: Sequence[Axes]) -> None:
    """Draw the fine vertical grid in all rows with a common frequency axis."""
    for ax in axes:
        ax.grid(True, which="minor", axis="x", color=GRID, linewidth=0.4)


def plain_decades(axis: Any, crowded: bool = False, between: bool = False) -> None:
    """Write numbers such as 0.1, 10, 1000 at the decades of a logarithmic axis; with `between` also at 2 and 5."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(base=10, subs=(1, 2, 5) if between else (1,), numticks=6 if crowded else 12))
    axis.set_major_formatter(FuncFormatter(lambda value, _: _plain(value)))
    axis.set_minor_formatter(NullFormatter())


def plain_numbers(axis: Any, most: int) -> None:
    """Write round numbers, `most` steps or fewer, on a logarithmic axis whose range is less than a decade."""
    from matplotlib.ticker import FuncFormatter, MaxNLocator, NullLocator

    axis.set_major_locator(MaxNLocator(most, steps=(1, 2, 5, 10)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: _plain(value)))
    axis.set_minor_locator(NullLocator())


def _plain(value: float) -> str:
    if 1e-4 < abs(value) < 1e5 or value == 0.0:
        return f"{value:.10g}"
    return f"{value:.0e}".replace("e-0", "e-").replace("e+0", "e")


def few_numbers(ax: Axes, most: int) -> None:
    """Limit the number of intervals on the x axis to `most`, and write its numbers without an offset."""
    from matplotlib.ticker import MaxNLocator

    ax.xaxis.set_major_locator(MaxNLocator(most))
    ax.ticklabel_format(axis="x", useOffset=False)


def degrees_axis(ax: Axes, low: float, high: float) -> None:
    """Choose a tick spacing of 15° to 720° and extend the axis limits to the nearest ticks."""
    from matplotlib.ticker import MultipleLocator

    step = phase_step(low, high)
    ax.yaxis.set_major_locator(MultipleLocator(step))
    ax.set_ylim(*phase_range(low, high, step))


def phase_range(low: float, high: float, step: float) -> tuple[float, float]:
    """Return a range of phase extended to multiples of a step."""
    # A curve that ends on a tick gets another step, so that it does not lie on the edge.
    return step * float(np.floor(low / step)), step * float(np.ceil(high / step + 1e-9))


def decibel(magnitude: np.ndarray) -> np.ndarray:
    """Return 20 log10 |x|, with the smallest positive number in place of zero."""
    return 20.0 * np.log10(np.maximum(magnitude, np.finfo(float).tiny))


def padded(low: float, high: float, part: float = 0.06) -> tuple[float, float]:
    """Widen a range by the fraction `part` of its width on both sides; a single value becomes a range around it."""
    room = part * (high - low) or 0.5 * abs(high) or 1.0
    return low - room, high + room


POINTS = 2000  # more than twice the width of a picture in pixels


def envelope(x: np.ndarray, y: np.ndarray, points: int = POINTS) -> tuple[np.ndarray, np.ndarray]:
    """Return at most `points` + 2 of the points (x, y), both of shape (n,): minimum and maximum of each interval, in
    order.

    The first and the last point are included. A short curve is returned unchanged. No value is interpolated or
    averaged, so peaks and limits stay where they are. `points` is at least 2.
    """
    n = x.size
    if n <= points:
        return x, y
    # Each interval gives two points. The last one may be shorter.
    long = -(-n // (points // 2))
    whole = n - n % long
    first = np.arange(0, whole, long)
    rows = y[:whole].reshape(-1, long)
    low, high = first + np.argmin(rows, axis=1), first + np.argmax(rows, axis=1)
    if whole < n:
        low = np.append(low, whole + np.argmin(y[whole:]))
        high = np.append(high, whole + np.argmax(y[whole:]))
    kept = np.unique(np.concatenate([[0], low, high, [n - 1]]))
    return x[kept], y[kept]

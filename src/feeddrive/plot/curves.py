"""Charts of general curves, distributions and surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from feeddrive.language.quantity import DRAWN, Quantity, number, unit_name
from feeddrive.language.text import Text
from feeddrive.plot import chart, style
from feeddrive.plot.chart import Abscissa, Box, Chart, Curve, Field, Heat, Level, Panel
from feeddrive.plot.drawing import figure_of
from feeddrive.plot.style import envelope

if TYPE_CHECKING:
    from collections.abc import Mapping

    from feeddrive.analysis.effort import Effort
    from feeddrive.loop.gradient import Gradient
    from feeddrive.loop.simulate import Batch
    from feeddrive.machining.cutting_force import Surface


class Row(NamedTuple):
    """A panel of named curves with the y-axis label `ordinate`; `logarithmic` selects a logarithmic y axis."""

    ordinate: str
    curves: Mapping[str, np.ndarray]
    logarithmic: bool = False


def curves_chart(
    abscissa: str,
    x: np.ndarray,
    rows: Sequence[Row],
    *,
    frequency: bool = False,
    levels: Mapping[str, float] | None = None,
) -> Chart:
    """Plot rows of curves over x, with the same color for a name in all rows.

    frequency  True if x is in Hz, on a logarithmic scale
    levels     horizontal lines in the first row, by name
    """
    names = list(dict.fromkeys(name for row in rows for name in row.curves))
    panels = list[Panel]()
    for row in rows:
        lines = tuple(Curve(x, np.asarray(values), name, names.index(name)) for name, values in row.curves.items())
        limits = () if panels else tuple(Level(value, name, dashed=True) for name, value in (levels or {}).items())
        panels.append(Panel(row.ordinate, lines, levels=limits, scale=chart.LOG if row.logarithmic else chart.LINEAR))
    span = (float(x[0]), float(x[-1])) if frequency else (None, None)
    return Chart(
        abscissa, tuple(panels), chart.FREQUENCY if frequency else chart.LINEAR, *span, height=1.2 + 1.9 * len(rows)
    )


curves = figure_of(curves_chart)


def pole_sweep_chart(sweeps: Mapping[str, Sequence[np.ndarray]], caption: str = "") -> Chart:
    """Plot the poles of several systems along a parameter sweep in the s plane (rad/s); the marks grow along the
    sweep.
    """
    marks = tuple(
        Curve(np.real(poles), np.imag(poles), "" if k else name, i, chart.HOLLOW, size=0.7 + 0.3 * k)
        for i, (name, points) in enumerate(sweeps.items())
        for k, poles in enumerate(points)
    )
    # The origin is included, since stability is judged by the side of the imaginary axis.
    x, y = (np.concatenate([[0.0], *(getattr(curve, axis) for curve in marks)]) for axis in ("x", "y"))
    (left, right), (low, high) = (style.padded(float(np.min(row)), float(np.max(row)), 0.08) for row in (x, y))
    axes = Level(0.0, faint=True), Level(0.0, upright=True, faint=True)
    panel = Panel("imaginary part of s (rad/s)", marks, levels=axes, low=low, high=high, caption=caption)
    return Chart("real part of s (rad/s)", (panel,), low=left, high=right, height=4.2)


pole_sweep = figure_of(pole_sweep_chart)


def turn_chart(angle: np.ndarray, forces: Mapping[str, np.ndarray]) -> Chart:
    """Plot forces in N by name versus the spindle angle in rad, with the mean of each as a thin line."""
    lines, means = list[Curve](), list[Level]()
    for i, (name, force) in enumerate(forces.items()):
        mean = float(np.mean(force))
        lines.append(Curve(np.degrees(angle), force, name, i, caption=Text(f"mean {Quantity(mean, 'N')}")))
        means.append(Level(mean, faint=True, number=i))
    panel = Panel(f"force on the tool ({unit_name('N')})", tuple(lines), levels=tuple(means))
    ticks = chart.numbered(np.arange(0.0, 361.0, 45.0))
    return Chart("angle of the spindle (deg)", (panel,), low=0.0, high=360.0, ticks=ticks, height=3.2, columns=3)


turn = figure_of(turn_chart)


def by_axis_chart(time: np.ndarray, rows: Mapping[str, Mapping[str, np.ndarray]], quantity: str) -> Chart:
    """Plot curves by name versus time in s, with one row per axis; `quantity` includes its unit."""
    several = any(len(curves) > 1 for curves in rows.values())
    panels = tuple(
        Panel(
            "",
            tuple(Curve(*envelope(time, v), name if several else "", i) for i, (name, v) in enumerate(lines.items())),
            caption=axis,
        )
        for axis, lines in rows.items()
    )
    return Chart("time (s)", panels, height=0.9 + 1.45 * len(rows), side=quantity)


by_axis = figure_of(by_axis_chart)


def left_over_chart(
    curves: Mapping[str, tuple[np.ndarray, np.ndarray]],
    measured: Mapping[str, tuple[np.ndarray, np.ndarray]],
    quantity: str,
    place: tuple[float, str],
    one: bool = True,
) -> Chart:
    """Plot magnitudes versus frequency in Hz on logarithmic scales, measured ones as marks, with a vertical line at
    one frequency.

    `one` adds a horizontal line at magnitude 1, above which a compensation amplifies.
    """
    lines = [Curve(f, magnitude, name, i) for i, (name, (f, magnitude)) in enumerate(curves.items())]
    lines += [
        Curve(*measured[name], name, i, chart.MARKERS, "measured in the loop", size=1.1)
        for i, name in enumerate(curves)
        if name in measured
    ]
    levels = [Level(1.0, dashed=True)] if one else []
    levels.append(Level(place[0], place[1], upright=True, dashed=True))
    ends = [float(f[k]) for f, _ in curves.values() for k in (0, -1)]
    panel = Panel(quantity, tuple(lines), levels=tuple(levels), scale=chart.LOG)
    return Chart("frequency (Hz)", (panel,), chart.FREQUENCY, min(ends), max(ends), height=3.6, columns=3)


left_over = figure_of(left_over_chart)


def batch_chart(batch: Batch) -> Chart:
    """Plot a histogram of the RMS over the variants for each signal, without variants that exceeded their bounds."""
    inside = batch.left < 0
    units = batch.units
    panels = [_variants(name, units[name], rms[inside], i) for i, (name, rms) in enumerate(batch.rms.items())]
    across = min(2, len(panels))
    lost = int(np.sum(~inside))
    caption = f"{lost} of {inside.size} variants left their bounds and are not shown" if lost else ""
    return Chart("", tuple(panels), across=across, height=0.5 + 2.0 * -(-len(panels) // across), caption=caption)


batch = figure_of(batch_chart)


def _variants(name: str, unit: str, rms: np.ndarray, number: int) -> Panel:
    factor = DRAWN.of(unit)[1]
    values = factor * rms[np.isfinite(rms)]
    abscissa = f"RMS of {name.replace('_', ' ')} ({unit_name(unit)})"
    if not values.size:
        return Panel("variants", abscissa=Abscissa(abscissa))
    median, least = (Quantity(size / factor, unit, bare=True) for size in (np.median(values), values.min()))
    middle = Level(float(np.median(values)), upright=True)
    caption = Text(f"median {median}, least {least}")
    return replace(histogram(values, abscissa, "variants", values.size // 5, number), levels=(middle,), caption=caption)


def histogram(values: np.ndarray, abscissa: str, ordinate: str, more: int, number: int = 0) -> Panel:
    """Return a histogram of values with 5 + `more` bins over their range, at most 40."""
    low, high = float(values.min()), float(values.max())
    # Equal values would give bins of zero width.
    if high <= low:
        low, high = style.padded(low, high)
    counts, edges = np.histogram(values, np.linspace(low, high, min(40, 5 + more) + 1))
    bars = tuple(
        Box(float(a), float(b), 0.0, float(count), number)
        for a, b, count in zip(edges[:-1], edges[1:], counts, strict=True)
        if count
    )
    left, right = style.padded(low, high, 0.03)
    top = 1.05 * float(np.max(counts))
    return Panel(ordinate, boxes=bars, low=0.0, high=top, abscissa=Abscissa(abscissa, low=left, high=right))


def gradient_chart(gradient: Gradient) -> Chart:
    """Plot the relative change of the cost in percent for +1 % of each parameter, with decreases to the left and
    increases to the right.
    """
    names = list(gradient.gradient)
    # A cost of 0 has no relative change.
    scale = gradient.cost or 1.0
    share = {name: gradient.gradient[name] * gradient.values[name] / scale for name in names}
    names.sort(key=lambda name: -abs(share[name]))
    texts = [Text(f"{Quantity(0.01 * share[name], 'share'):+.3f}") for name in names]
    panel = bars(names, [share[name] for name in names], texts, [int(share[name] >= 0.0) for name in names])
    reach = max(map(abs, share.values()), default=0.0) or 1.0
    low, high = (1.3 * end for end in (min(0.0, *share.values()), max(0.0, *share.values())))
    return Chart(
        "change of the cost for +1 % of the parameter (%)",
        (replace(panel, levels=(Level(0.0, upright=True),)),),
        # Room for the texts beside the bars, also if all changes have the same sign.
        low=min(low, -0.18 * reach),
        high=max(high, 0.18 * reach),
        height=1.0 + 0.3 * len(names),
    )


gradient = figure_of(gradient_chart)


def effort_chart(effort: Effort) -> Chart:
    """Plot the number of operations per sample by kind."""
    names = sorted(effort.operations, key=lambda name: -effort.operations[name])
    sizes = [float(effort.operations[name]) for name in names]
    panel = bars(names, sizes, [number(size, 6) for size in sizes])
    label = f"operations a sample, {effort.total} in all"
    return Chart(label, (panel,), low=0.0, high=1.1 * max(sizes, default=1.0), height=1.0 + 0.3 * len(names))


effort = figure_of(effort_chart)


def bars(
    names: Sequence[str],
    sizes: Sequence[float],
    texts: Sequence[str],
    numbers: Sequence[int] | None = None,
    base: float = 0.0,
) -> Panel:
    """Return a panel with one bar per name, from the top, each from `base` to its size with a text next to it."""
    boxes = tuple(
        Box(
            min(base, size),
            max(base, size),
            -row - 0.32,
            -row + 0.32,
            0 if numbers is None else numbers[row],
            text=texts[row],
            beside=True,
        )
        for row, size in enumerate(sizes)
    )
    return Panel("", boxes=boxes, ticks=chart.listed(names), low=0.4 - max(len(names), 1), high=0.6)


def surface_chart(surface: Surface) -> Chart:
    """Plot the height map of a surface in µm, and below it the profile at the tool tip with the analytical feed
    mark.
    """
    along = 1e3 * (surface.along - surface.along[0])
    off = 1e6 * surface.map
    mark = Level(float(np.min(off[0])) + 1e6 * surface.mark, dashed=True, number=chart.ALERT, caption="feed mark alone")
    ra, rz = surface.roughness
    profile = Panel(
        f"left of\nmaterial ({unit_name('um')})",
        (Curve(along, off[0], "profile at the tip"),),
        levels=(mark,),
        share=2.0,
        caption=Text(f"Ra {Quantity(ra, 'm'):3}, Rz {Quantity(rz, 'm'):3} of the patch"),
    )
    panels = [profile]
    if len(surface.heights) > 1:
        heat = Heat(f"left of material ({unit_name('um')})", float(np.min(off)), float(np.max(off)))
        field = Field(along, 1e3 * surface.heights, off)
        panels.insert(0, Panel("above the tip (mm)", field=field, heat=heat, share=3.0))
    return Chart("along the feed (mm)", tuple(panels), height=4.6 if len(panels) > 1 else 2.8)


surface = figure_of(surface_chart)

"""Pictures of a part program on a machine: the contour error of each law, the force of the cut and its estimates."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from feeddrive.language.quantity import Quantity, unit_name
from feeddrive.language.text import Text
from feeddrive.plot.chart import LOG, MARKERS, NEUTRAL, PLAIN, THIN, WIDE, Chart, Curve, Panel, listed
from feeddrive.plot.drawing import figure_of
from feeddrive.plot.style import POINTS, envelope

if TYPE_CHECKING:
    from feeddrive.machining.part_run import PartRun

_WINDOW = 0.15  # s of estimates that are shown
_BEFORE, _AFTER = 0.04, 0.1  # s around a worst place
_SIZES = ("RMS", "95 % of the path", "largest")


def part_run_chart(part: PartRun) -> Chart:
    """The contour error over time; gray: what does not count."""
    contour = part.contour
    error = 1e6 * np.abs(contour.error)
    curves = (
        Curve(*envelope(contour.time, error), "does not count", NEUTRAL, THIN),
        Curve(*envelope(contour.time, np.where(contour.counted, error, 0.0)), "counts"),
    )
    caption = Text(f"RMS {Quantity(contour.rms, 'm')}, largest {Quantity(contour.largest, 'm')}")
    return Chart("time (s)", (Panel(f"contour error ({unit_name('um')})", curves, caption=caption),))


part_run = figure_of(part_run_chart)


def part_laws_chart(parts: Mapping[str, PartRun]) -> Chart:
    """RMS, 95 % and the largest contour error of each law, a row each, on a logarithmic scale."""
    sizes = np.array([(part.contour.rms, part.contour.within(), part.contour.largest) for part in parts.values()])
    rows, shown = -np.arange(len(parts), dtype=np.float64), 1e6 * np.maximum(sizes, 1e-12)
    spans = tuple(
        Curve(np.array([row.min(), row.max()]), np.full(2, y), number=NEUTRAL, look=WIDE)
        for row, y in zip(shown, rows, strict=True)
    )
    dots = tuple(Curve(shown[:, k], rows, name, k, MARKERS, size=1.4) for k, name in enumerate(_SIZES))
    panel = Panel("", (*spans, *dots), ticks=listed(list(parts)), low=float(rows[-1]) - 0.6, high=0.6)
    return Chart(
        f"contour error ({unit_name('um')})",
        (panel,),
        LOG,
        0.7 * float(shown.min()),
        1.5 * float(shown.max()),
        height=1.1 + 0.36 * len(parts),
    )


part_laws = figure_of(part_laws_chart)


def part_cutting_chart(part: PartRun) -> Chart:
    """The force of the cut on each axis over time."""
    assert part.cutting is not None
    panels = tuple(
        Panel(
            f"on {name} ({unit_name('N')})",
            (Curve(*envelope(part.contour.time, part.cutting[:, i], POINTS // 2), number=i, look=PLAIN, size=0.6),),
        )
        for i, name in enumerate(part.contour.axes)
    )
    return Chart("time (s)", panels, height=0.9 + 1.15 * len(panels))


part_cutting = figure_of(part_cutting_chart)


def part_estimates_chart(part: PartRun, axis: str) -> Chart:
    """The disturbance of an axis and its estimates by observers, over the 150 ms with the largest RMS cutting force."""
    time, true = part.contour.time, part.disturbances[axis]
    middle = _busiest(part, axis)
    shown = (time >= middle - 0.5 * _WINDOW) & (time <= middle + 0.5 * _WINDOW)
    curves = [Curve(1e3 * time[shown], true[shown], "what acts", NEUTRAL, WIDE, size=0.5)]
    for i, (name, by) in enumerate(part.estimates.items()):
        if axis in by:
            late = Text(f"{Quantity(by[axis].lag, 's'):3} late")
            values = by[axis].disturbance[shown]
            curves.append(Curve(1e3 * time[shown], values, name.replace("_", " "), i, caption=late))
    panel = Panel(f"force on {axis} ({unit_name('N')})", tuple(curves))
    return Chart("time (ms)", (panel,), height=3.4, columns=2)


part_estimates = figure_of(part_estimates_chart)


def _busiest(part: PartRun, axis: str) -> float:
    """The middle of the window with the largest RMS force of the cut on an axis, s."""
    assert part.cutting is not None
    time = part.contour.time
    square = part.cutting[:, part.contour.axes.index(axis)] ** 2
    width = max(1, min(len(time) - 1, round(_WINDOW / (time[1] - time[0]))))
    total = np.cumsum(np.insert(square, 0, 0.0))
    return float(time[int(np.argmax(total[width:] - total[:-width])) + width // 2])


def part_zoom_chart(parts: Mapping[str, PartRun], time: float) -> Chart:
    """The contour error of each law around an instant: ms from the instant, µm."""
    curves = list[Curve]()
    for k, (name, part) in enumerate(parts.items()):
        at = part.contour.time
        shown = (at >= time - _BEFORE) & (at <= time + _AFTER)
        curves.append(Curve(1e3 * (at[shown] - time), 1e6 * np.abs(part.contour.error[shown]), name, k))
    panel = Panel(f"contour error ({unit_name('um')})", tuple(curves))
    return Chart("time after the worst instant (ms)", (panel,), height=3.4, columns=3)


part_zoom = figure_of(part_zoom_chart)

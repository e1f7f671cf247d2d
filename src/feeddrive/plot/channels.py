"""Picture of a measured log: every channel in a row of its own."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from feeddrive.language.table import shown
from feeddrive.plot import style
from feeddrive.plot.envelope import POINTS, envelope

if TYPE_CHECKING:
    from feeddrive.files.log import Log

MOST = 12  # rows; a log with more channels shows the first ones


def log(log: Log) -> Any:
    """The channels of a log over time, each in the unit in which people read it."""
    chosen = dict(list(log.channels.items())[:MOST])
    figure, axes = style.picture(len(chosen), height=1.0 + 1.3 * len(chosen))
    for i, (name, values) in enumerate(chosen.items()):
        unit, factor = shown(log.units.get(name, ""))
        axes[i].plot(*envelope(log.time, factor * values, POINTS), **style.curve(0))
        head = name.replace("_", " ")
        last = i == len(chosen) - 1
        style.labels(axes[i], "time (s)" if last else None, f"{head}\n({unit.replace('um', 'µm')})" if unit else head)
    return figure

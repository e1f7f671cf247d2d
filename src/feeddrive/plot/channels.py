"""Picture of a measured log: every channel in a row of its own."""

from __future__ import annotations

from typing import Any

from feeddrive.files.guess import Guess
from feeddrive.files.log import Log
from feeddrive.language.errors import ParameterError
from feeddrive.language.table import picture_of, shown
from feeddrive.plot import style
from feeddrive.plot.envelope import POINTS, envelope

MOST = 12  # rows; a log with more channels shows the first ones


@picture_of.register(Log)
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


@picture_of.register
def _guess(found: Guess) -> Any:
    raise ParameterError(f"{found.name}: a guess of roles has no picture; plot the log itself")

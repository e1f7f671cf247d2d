"""A measured log: channels over time on one clock. `log.py` makes one of a file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from feeddrive.files.messages import nearest
from feeddrive.files.readers.parquet import write_parquet
from feeddrive.files.remarks import remarks
from feeddrive.language.errors import LogError, ParameterError
from feeddrive.language.table import Result, Table, shown


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Log(Result):
    """Channels over time, all finite, on one clock. `log["position_load"]` is an array of shape (n,) in `units`.

    `time` holds the stamps as they were recorded, s; `sample_time` their common step, s, and `jitter` the largest
    deviation from it as a share of it.  `constants` are single numbers that stood beside the columns; `left_out` says
    of other columns why they are not there; `provenance` says where all of it comes from.
    """

    name: str
    time: np.ndarray
    channels: Mapping[str, np.ndarray]
    units: Mapping[str, str]
    sample_time: float
    jitter: float = 0.0
    constants: Mapping[str, float] = field(default_factory=dict[str, float])
    left_out: Mapping[str, str] = field(default_factory=dict[str, str])
    provenance: Mapping[str, Any] = field(default_factory=dict[str, Any])

    def __post_init__(self) -> None:
        time = _held(self.name, "time", self.time)
        channels = {channel: _held(self.name, channel, values) for channel, values in self.channels.items()}
        for channel, values in channels.items():
            if values.size != time.size:
                raise LogError(f"{self.name}: '{channel}' has {values.size} rows, time has {time.size}")
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "channels", channels)

    def __getitem__(self, channel: str) -> np.ndarray:
        if channel not in self.channels:
            raise ParameterError(f"the log '{self.name}' has no channel '{channel}'{nearest(channel, self.channels)}")
        return self.channels[channel]

    def __len__(self) -> int:
        return self.time.size

    @property
    def duration(self) -> float:
        """From the first to the last row, s."""
        return float(self.time[-1] - self.time[0])

    @property
    def remarks(self) -> tuple[str, ...]:
        """A sentence for each channel that is constant, clipped, or recorded more slowly than the clock."""
        return remarks(self.channels)

    def table(self) -> Table:
        """Least, largest and RMS value of every channel."""
        rows: list[list[str]] = []
        for channel, values in self.channels.items():
            unit, factor = shown(self.units.get(channel, ""))
            rms = float(np.sqrt(np.mean(np.square(values))))
            figures = (float(np.min(values)), float(np.max(values)), rms)
            rows.append([channel, unit, *(f"{factor * figure:.5g}" for figure in figures)])
        rate = f"{1e3 * self.sample_time:.6g} ms"
        title = f"{self.name}: {self.time.size} rows, {self.duration:.4g} s at {rate}, jitter {100 * self.jitter:.2g} %"
        return Table(title, ["channel", "unit", "least", "most", "RMS"], rows)

    def plot(self) -> Any:
        """Every channel over time, as a matplotlib figure."""
        from feeddrive import plot

        return plot.log(self)

    def to_pandas(self) -> Any:
        """A DataFrame with one column a channel, over time in s."""
        from feeddrive.plot import frames

        return frames.frame(self.time, self.channels, "time")


def _held(name: str, channel: str, values: Any) -> np.ndarray:
    """A float64 array of one dimension that nobody can change; it is copied only if it could be changed elsewhere."""
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 1:
        raise LogError(f"{name}: '{channel}' must be a row of numbers, not of shape {array.shape}")
    if not np.all(np.isfinite(array)):
        raise LogError(f"{name}: '{channel}' is not finite at row {int(np.argmin(np.isfinite(array))) + 1}")
    if array.flags.writeable and array is values:
        array = array.copy()
    array.flags.writeable = False
    return array


def write_log(path: str | Path, log: Log) -> None:
    """Write a log as Parquet, with units, sample time and origin; `read_log` gives the same numbers, bit for bit.

    Raises FileError if it cannot be written.
    """
    metadata = {
        "name": log.name,
        "sample_time": log.sample_time,
        "units": {"time": "s", **log.units},
        "constants": dict(log.constants),
        "provenance": dict(log.provenance),
    }
    write_parquet(path, {"time": log.time, **log.channels}, metadata)

"""A measured log: channels over a common time base, with remarks on irregular channels.

`read_log.py` reads one from a file.  A channel that is constant, clipped or recorded at a lower rate than the log is
accepted with a remark.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self, TypeAlias

import numpy as np

from feeddrive.files.run_files import write_parquet
from feeddrive.language.errors import LogError, ParameterError, nearest
from feeddrive.language.quantity import Quantity, signal_unit
from feeddrive.language.table import UNIT, Cell, Result, Table
from feeddrive.language.text import Text


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Log(Result):
    """The channels of a log, all finite, on one clock. `log["position_load"]` is an array of shape (n,) in `units`.

    `time` holds the recorded time stamps, s, `sample_time` their common step, s, and `jitter` the largest relative
    deviation from it.  `constants` are scalars stored in the file besides the columns; `left_out` gives the reason for
    every omitted column; `provenance` describes the source.
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

    def from_row(self, first: int) -> Self:
        """Return the log from row `first` on. Raise LogError if no row is left."""
        if first == 0:
            return self
        if first >= self.time.size:
            raise LogError(f"{self.name}: has {self.time.size} rows, and skip_samples = {first} leaves none of them")
        channels = {channel: values[first:] for channel, values in self.channels.items()}
        return replace(self, time=self.time[first:], channels=channels)

    @property
    def duration(self) -> float:
        """The time from the first to the last row, s."""
        return float(self.time[-1] - self.time[0])

    @property
    def remarks(self) -> tuple[str, ...]:
        """A sentence for each channel that is constant, clipped, or recorded at a lower rate than the log."""
        return remarks(self.channels)

    def table(self) -> Table:
        """Tabulate the minimum, maximum and RMS value of every channel."""
        rows: list[list[Cell]] = []
        for channel, values in self.channels.items():
            unit = self.units.get(channel, "")
            figures = np.min(values), np.max(values), np.sqrt(np.mean(np.square(values)))
            rows.append([channel, UNIT, *(Quantity(figure, unit, form=f"5 {signal_unit(unit)}") for figure in figures)])
        rate = Text(f"{Quantity(self.sample_time, 's'):6}")
        title = Text(
            f"{self.name}: {self.time.size} rows, {Quantity(self.duration, 's'):SI} at {rate}, jitter "
            f"{Quantity(self.jitter, 'share'):2}"
        )
        return Table(title, ["channel", "unit", "least", "most", "RMS"], rows)


LogLike: TypeAlias = Path | Log
"""A log file, or a `Log`."""


def _held(name: str, channel: str, values: Any) -> np.ndarray:
    """Return a read-only one-dimensional float64 array, copied only if the caller could still modify it."""
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 1:
        raise LogError(f"{name}: '{channel}' must be a row of numbers, not of shape {array.shape}")
    if not np.all(np.isfinite(array)):
        raise LogError(f"{name}: '{channel}' is not finite at row {int(np.argmin(np.isfinite(array))) + 1}")
    # `asarray` returns the caller's own array if nothing had to be converted.
    if array.flags.writeable and array is values:
        array = array.copy()
    array.flags.writeable = False
    return array


def write_log(path: str | Path, log: Log) -> None:
    """Write a log as Parquet, with units, sample time and provenance; `read_log` reads it back bit for bit.

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


# Not clipped: the flat top of a sine (some equal samples), an end stop (once), a selector (few levels), and a position
# that comes to rest (ever smaller steps).
_LONG = 4  # samples at the same extreme value: the least that counts as clipped once
_TIMES = 2  # how often it must happen
_ABRUPT = 0.2  # last whole step before the clip over the usual step: a position that comes to rest has a small one
_COUNTS = 1.5  # ratio of two steps that differ by a count at least
_LEVELS = 32  # different values: fewer are a state or a coarse number, which is often constant
_HELD = 0.98  # share of the changes that lie on one grid of every second, third ... sample


def remarks(channels: Mapping[str, np.ndarray]) -> tuple[str, ...]:
    """Return a sentence for each channel, of shape (n,), that is constant, clipped or recorded at a lower rate than the
    log.
    """
    sentences: list[str] = []
    for name, values in channels.items():
        if values.size < 2:
            continue
        if np.ptp(values) == 0.0:
            level = Quantity(values[0], form="6")
            sentences.append(
                Text(f"'{name}' is constant, {level}: it contains no information, or it was not connected")
            )
            continue
        sentences += [sentence for sentence in (clipped(name, values), _slow(name, values)) if sentence]
    return tuple(sentences)


def clipped(name: str, values: np.ndarray, times: int = _TIMES) -> str:
    """Return a remark if the signal reaches its extreme value at full slope and stays there, otherwise "".

    times  number of occurrences required for a remark; one is enough for a position, since no axis can stop within
           one sample
    """
    if np.unique(values).size < _LEVELS:
        return ""
    steps = np.abs(np.diff(values))
    moving = steps[steps > 0.0]
    # Only steps with a change: a signal at rest most of the time has a small mean step.
    usual = float(np.sqrt(np.mean(moving**2)))
    for limit, word in ((np.max(values), "largest"), (np.min(values), "smallest")):
        starts, lengths = _runs(values == limit)
        long = (lengths >= _LONG) & (starts > 1)
        before = np.abs(values[starts[long] - 2] - limit) > np.abs(values[starts[long] - 1] - limit)
        # The signal must have moved towards the limit in the sample before: a state jumps there.
        long[long] = before
        if np.count_nonzero(long) < times:
            continue
        last = steps[starts[long] - 2]
        # one count is the smallest step that coarse readings can show: after larger ones the axis came to rest
        within = np.maximum(starts[long][:, None] - np.arange(2, 2 + _LONG), 0)
        slower = (last < _COUNTS * np.min(moving)) & (np.max(steps[within], axis=1) > _COUNTS * last)
        if np.median(np.where(slower, 0.0, last)) > _ABRUPT * usual:
            share = Quantity(np.mean(values == limit), "share", form="2")
            return Text(
                f"'{name}' is clipped: it stays at its {word} value {Quantity(limit):6} {np.count_nonzero(long)} times "
                f"for {_LONG} samples or more, and in {share} of the log; fits to these samples are wrong"
            )
    return ""


def _slow(name: str, values: np.ndarray) -> str:
    """Return a remark if the signal changes only at every m-th sample, as if written by a slower task, otherwise ""."""
    changes = np.flatnonzero(np.diff(values))
    # a few changes lie on a common grid by chance
    if changes.size < 20:
        return ""
    gaps = np.diff(changes)
    # the slowest first: gaps of 20 samples lie on the grids of 10, 5, 4 and 2 as well
    for step in (20, 16, 10, 8, 5, 4, 3, 2):
        # The median excludes a signal that changes rarely, at multiples of the step by chance.
        if np.mean(gaps % step == 0) >= _HELD and np.median(gaps) == step:
            return (
                f"'{name}' changes only at every {step}th sample: it comes from a slower clock and lags the other "
                f"channels by up to {step - 1} samples"
            )
    return ""


def _runs(true: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the start and the length of each run of True values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], true.astype(np.int8), [0]])))
    return edges[::2], edges[1::2] - edges[::2]

"""What is odd about the channels of a log: constant, clipped, or slower than the clock. None of it is refused."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

_LONG = 4  # samples at the same extreme value: the least that counts as clipped once
_TIMES = 2  # how often it must happen
_ABRUPT = 0.2  # last whole step before the clip over the usual step: a position that comes to rest has a small one
_LEVELS = 32  # different values: fewer are a state or a coarse number, which stands still by nature
_HELD = 0.98  # share of the changes that lie on one grid of every second, third ... sample


def remarks(channels: Mapping[str, np.ndarray]) -> tuple[str, ...]:
    """One sentence for each channel, of shape (n,), that is constant, clipped or slower than its clock."""
    found: list[str] = []
    for name, values in channels.items():
        if values.size < 2:
            continue
        if np.ptp(values) == 0.0:
            found.append(f"'{name}' is constant, {values[0]:.6g}: it says nothing, or it was not connected")
            continue
        found += [sentence for sentence in (_clipped(name, values), _slow(name, values)) if sentence]
    return tuple(found)


def _clipped(name: str, values: np.ndarray) -> str:
    """A signal that runs into its largest or smallest value at full speed and stays there, several times."""
    if np.unique(values).size < _LEVELS:
        return ""
    steps = np.abs(np.diff(values))
    moving = steps[steps > 0.0]
    usual = float(np.sqrt(np.mean(moving**2)))
    for limit, word in ((np.max(values), "largest"), (np.min(values), "smallest")):
        starts, lengths = _runs(values == limit)
        long = (lengths >= _LONG) & (starts > 1)
        before = np.abs(values[starts[long] - 2] - limit) > np.abs(values[starts[long] - 1] - limit)
        long[long] = before  # on its way there already: a state jumps
        if np.count_nonzero(long) >= _TIMES and np.median(steps[starts[long] - 2]) > _ABRUPT * usual:
            share = 100.0 * np.mean(values == limit)
            return (
                f"'{name}' is clipped: it stands at its {word} value {limit:.6g} {np.count_nonzero(long)} times for "
                f"{_LONG} samples or more, and in {share:.2g} % of the log; what is fitted there is wrong"
            )
    return ""


def _slow(name: str, values: np.ndarray) -> str:
    """A signal that changes only at every m-th sample, as one from a slower task that is not synchronous does."""
    changes = np.flatnonzero(np.diff(values))
    if changes.size < 20:
        return ""
    gaps = np.diff(changes)
    for step in (20, 16, 10, 8, 5, 4, 3, 2):
        if np.mean(gaps % step == 0) >= _HELD and np.median(gaps) == step:
            return (
                f"'{name}' changes only at every {step}th sample: it comes from a slower clock and lags the other "
                f"channels by up to {step - 1} samples"
            )
    return ""


def _runs(true: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Start and length of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], true.astype(np.int8), [0]])))
    return edges[::2], edges[1::2] - edges[::2]

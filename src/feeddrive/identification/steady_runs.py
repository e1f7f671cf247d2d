"""Constant-speed runs: stretches of a log with constant speed, and the mean force of each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from feeddrive.identification.estimate import TABLE, Frame, frame_of, lever
from feeddrive.identification.regression import errors, robust_covariance, strays, strays_said
from feeddrive.language.errors import LogError, NotIdentifiableError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column, Result, Table

LEAST_ROWS = 20  # of a stretch
_CHANGE = 0.1  # share of the speed: a larger change ends a stretch
_SURE = 6.0  # standard errors: the change must also exceed these
_DRIFT = 0.02  # share of the speed by which a constant speed may rise or fall
_TRIM = 0.1  # share of a stretch that is cut off at an end where the speed changed


@dataclass(frozen=True, eq=False, repr=False)
class SteadyRuns(Result):
    """Mean velocity and mean force of constant-speed runs, each of shape (m,), velocities rising, both directions.

    error  standard error of each mean force, robust to its autocorrelation
    rows   number of rows in each mean
    remarks  on single samples that the means lack
    """

    velocity: np.ndarray
    force: np.ndarray
    error: np.ndarray
    rows: np.ndarray
    frame: Frame = TABLE
    remarks: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.velocity.size == self.force.size == self.error.size == self.rows.size:
            raise LogError("constant-speed runs need one velocity, force, error and count each")
        order = np.argsort(self.velocity)
        for name in ("velocity", "force", "error", "rows"):
            values = np.asarray(getattr(self, name), dtype=np.float64)[order]
            if not np.all(np.isfinite(values)) and name != "error":
                raise LogError(
                    f"constant-speed runs: {name} is not finite in run {int(np.argmin(np.isfinite(values))) + 1}"
                )
            object.__setattr__(self, name, values)

    def table(self) -> Table:
        """One row a run."""
        columns = zip(self.velocity, self.force, self.error, self.rows, strict=True)
        rows = [[v, Quantity(f, self.frame.force, e, form="5"), e, int(n)] for v, f, e, n in columns]
        heads = [
            Column("velocity", self.frame.velocity, "5"), Column("force", self.frame.force, "5"),
            Column("standard error", self.frame.force, "2"), "rows",
        ]  # fmt: skip
        return Table(f"{self.velocity.size} constant-speed runs", heads, rows)

    def at_table(self, lead: float, gear: float = 1.0) -> SteadyRuns:
        """The same runs in m/s and N at a table that a screw of `lead` (m) moves."""
        if self.frame is TABLE:
            return self
        r = lever(lead, gear)
        return replace(self, velocity=self.velocity * r, force=self.force / r, error=self.error / r, frame=TABLE)


def runs_of(
    velocity: Sequence[float] | np.ndarray, force: Sequence[float] | np.ndarray, *, rotary: bool = False
) -> SteadyRuns:
    """A given friction map, without the errors of its points."""
    v, f = np.asarray(velocity, dtype=np.float64), np.asarray(force, dtype=np.float64)
    return SteadyRuns(v, f, np.full(v.size, np.nan), np.ones(v.size), frame_of(rotary))


def steady_runs(
    logs: Sequence[tuple[np.ndarray, np.ndarray]],
    *,
    rotary: bool = False,
    least_rows: int = LEAST_ROWS,
    names: Sequence[str] = (),
) -> SteadyRuns:
    """The constant-speed runs of logs of velocity and force, each a pair of shape (n,): m/s and N, or rad/s and N m.

    A log is cut where its mean speed changes most, and each part again, as long as the change is more than 10 % of the
    speed and more than six standard errors.  Parts in which the speed still rises or falls, or that stand still, are
    left out, and so is a tenth of a part at an end where the speed changed.  Single samples far from their neighbors
    (`regression.strays`), of velocity or force, are in no mean; a remark says how many and where, by `names` of the
    logs.
    Raises LogError for logs that are not finite, NotIdentifiableError where no speed is held for `least_rows` rows.
    """
    found: list[tuple[float, float, float, int]] = []
    said: list[str] = []
    frame = frame_of(rotary)
    for place, (velocity, force) in enumerate(logs):
        v, f = np.asarray(velocity, dtype=np.float64), np.asarray(force, dtype=np.float64)
        if v.shape != f.shape or v.ndim != 1:
            raise LogError(f"log {place + 1}: velocity has {v.size} rows, force {f.size}")
        if not (np.all(np.isfinite(v)) and np.all(np.isfinite(f))):
            raise LogError(f"log {place + 1}: velocity or force is not finite at a row; repair or cut it")
        bad_speed, bad_force = strays(v), strays(f)
        where = names[place] if names else f"log {place + 1}"
        said += strays_said(f"{where}, velocity", v, bad_speed, frame.velocity)
        said += strays_said(f"{where}, force", f, bad_force, frame.force)
        good = ~(bad_speed | bad_force)
        v, f = v[good], f[good]
        for begin, end in _stretches(v, 0, v.size, least_rows):
            if _is_held(v[begin:end], v):
                one, rest = np.ones((end - begin, 1)), f[begin:end] - np.mean(f[begin:end])
                error = float(errors(robust_covariance(one, rest))[0])
                found.append((float(np.mean(v[begin:end])), float(np.mean(f[begin:end])), error, end - begin))
    if not found:
        raise NotIdentifiableError(
            f"no constant speed is held for {least_rows} rows; record next runs at a constant speed, some seconds each"
        )
    columns = np.array(found).T
    return SteadyRuns(*columns, frame=frame, remarks=tuple(said))


def _stretches(v: np.ndarray, begin: int, end: int, least: int) -> Iterator[tuple[int, int]]:
    """Parts of [begin, end) between changes of the mean speed, trimmed where there is one."""
    cut = _cut(v[begin:end], least)
    if cut is not None:
        yield from _stretches(v, begin, begin + cut, least)
        yield from _stretches(v, begin + cut, end, least)
        return
    trim = int(np.ceil(_TRIM * (end - begin)))
    first = begin + (trim if begin > 0 else 0)
    last = end - (trim if end < v.size else 0)
    if last - first >= least:
        yield first, last


def _cut(v: np.ndarray, least: int) -> int | None:
    """Where two means fit best, if they differ enough; at least a few rows lie on each side."""
    few = max(3, least // 4)
    if v.size < 2 * few:
        return None
    n = np.arange(few, v.size - few + 1)
    total = np.concatenate([[0.0], np.cumsum(v)])
    left, right = total[n] / n, (total[-1] - total[n]) / (v.size - n)
    gain = n * (v.size - n) / v.size * (left - right) ** 2
    best = int(np.argmax(gain))
    k = int(n[best])
    change = abs(float(left[best] - right[best]))
    within = np.sqrt((np.var(v[:k]) * k + np.var(v[k:]) * (v.size - k)) / v.size)
    error = float(within) * np.sqrt(1.0 / k + 1.0 / (v.size - k))
    larger = max(abs(float(left[best])), abs(float(right[best])))
    return k if change > _CHANGE * larger and change > _SURE * error else None


def _is_held(part: np.ndarray, whole: np.ndarray) -> bool:
    """Whether a part moves, and does not speed up or slow down."""
    mean = abs(float(np.mean(part)))
    error = float(np.std(part)) / np.sqrt(part.size)
    if mean <= 4.0 * error or mean < 1e-3 * float(np.max(np.abs(whole))):
        return False
    k = np.arange(part.size) - 0.5 * (part.size - 1)
    slope = float(k @ part) / float(k @ k)
    left = part - np.mean(part) - slope * k
    drift, error = abs(slope) * part.size, float(np.std(left)) * np.sqrt(12.0 / part.size)
    return drift <= max(_DRIFT * mean, _SURE * error)

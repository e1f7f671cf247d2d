"""What the counts of an encoder do to a closed loop: the run of a log, drawn anew with other places within a count."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from feeddrive.analysis.replay import estimate_start
from feeddrive.blocks.load.recorded_force import RecordedForce
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.identification.motion.motion_log import MotionLog
from feeddrive.language import tree
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import simulate

SIGNALS = ("reading_load", "force")
_ON_COUNT = 0.05  # of a count: how far a reading may be off it by the rounding of its file
_NEAR = 51  # rows over which the spread is averaged: of some sixteen runs each row alone knows it to a fifth
_STILL = 0.03  # s after which an axis whose setpoint stands is taken to be at rest


def count_of(position: np.ndarray) -> float:
    """The length of a count of readings in m: all differ by whole numbers of it. 0 if there is none."""
    levels = np.unique(position)
    steps = np.diff(levels)
    steps = steps[steps > 1e-12 * (levels[-1] - levels[0])]
    if not steps.size:
        return 0.0
    near = float(np.mean(steps[steps < 1.5 * np.min(steps)]))
    count = float((levels[-1] - levels[0]) / np.round((levels[-1] - levels[0]) / near))
    off = (levels - levels[0]) / count
    return count if np.max(np.abs(off - np.round(off))) < _ON_COUNT else 0.0


def at_rest(log: MotionLog, skip: int) -> np.ndarray:
    """Rows where the set position has stood for `_STILL`, after `skip` samples.

    There a reading stands on its count: its error is one number for the whole dwell, and friction holds any force.
    """
    assert log.set_position is not None
    moved = np.diff(log.set_position, prepend=log.set_position[0]) != 0.0
    moved[0] = True
    rows = np.arange(moved.size)
    since = rows - np.maximum.accumulate(np.where(moved, rows, 0))
    return (since > _STILL / log.sample_time)[skip:]


def unknown_force(residual: np.ndarray, runs: np.ndarray, moving: np.ndarray) -> np.ndarray:
    """What acts on the axis besides the model, in N, row by row of a motion without rests; 0 where counts explain it.

        d = -share · r̃,   share² = 1 - Σ s̃² / Σ r̃²

    residual  force measured - mean of the runs, shape (n,); the drive answers a force by its opposite
    runs      their forces less their mean, shape (runs, n), what counts alone make
    moving    rows that count
    r̃ and s̃ are means of `_NEAR` rows: counts make noise that is quicker than what an axis feels.
    """
    from scipy.ndimage import uniform_filter1d  # not for commands that only read

    slow = uniform_filter1d(residual[moving], _NEAR, mode="nearest")
    counts = uniform_filter1d(runs[:, moving], _NEAR, axis=1, mode="nearest")
    power = float(np.mean(slow**2))
    own = float(np.mean(counts**2)) * len(runs) / (len(runs) - 1)
    return -np.sqrt(max(0.0, 1.0 - own / power)) * slow if power > 0.0 else 0.0 * slow


def drawn(
    loop: Loop, log: MotionLog, skip: int, count: float, runs: int, seed: int, unknown: np.ndarray | None = None
) -> np.ndarray:
    """Reading and force of runs of the log with the counts of its encoder, shape (runs, 2, n).

    From run to run the counts lie elsewhere along the travel, evenly over one count, the axis begins anywhere within
    its count, and an unknown force begins at another of its rows.  Raises DivergedError if a run diverges.
    """
    assert log.set_position is not None
    random = np.random.default_rng(seed)
    counted, offsets = _counted(loop, count)
    reference = Recorded(position=log.set_position, sample_time=float(loop.sample_time))
    position, velocity = estimate_start(log.position, log.sample_time)
    found = []
    for i in range(runs):
        shift = count * ((i + random.uniform()) / runs - 0.5)
        begin = position + count * random.uniform(-0.5, 0.5)
        load = None
        if unknown is not None and np.any(unknown):
            turned = np.roll(unknown, random.integers(unknown.size))
            load = RecordedForce(force=np.resize(turned, log.position.size), sample_time=float(loop.sample_time))
        run = simulate(
            tree.vary(counted, {name: value + shift for name, value in offsets.items()}),
            reference,
            load=load,
            start=(begin, velocity),
            record=SIGNALS,
            seed=i,
        )
        found.append([run[name][skip : log.position.size] for name in SIGNALS])
    return np.array(found)


def spread(runs: np.ndarray) -> np.ndarray:
    """Variance from run to run at each row and its neighbors, shape (2, n)."""
    from scipy.ndimage import uniform_filter1d  # not for commands that only read

    return uniform_filter1d(np.var(runs, axis=0, ddof=1), _NEAR, axis=1, mode="nearest")


def _counted(loop: Loop, count: float) -> tuple[Loop, dict[str, float]]:
    """The loop with encoders that count, and the offsets of these by name; an axis without encoder gets one."""
    ends = {end: getattr(loop.axis, end) for end in ("encoder_motor", "encoder_load")}
    if all(encoder is None for encoder in ends.values()):
        ends["encoder_load"] = Encoder(resolution=count)
    made = {
        end: replace(
            encoder, resolution=max(count, float(encoder.resolution or 0.0)), offset=float(encoder.offset or 0.0)
        )
        for end, encoder in ends.items()
        if isinstance(encoder, Encoder)
    }
    counted = replace(loop, axis=replace(loop.axis, **made))
    return counted, {f"{loop.place_of('axis')}.{end}.offset": float(each.offset or 0.0) for end, each in made.items()}

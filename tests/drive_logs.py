"""Simulated motion logs of a known axis, for tests of identification."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
from scipy.signal import lfilter

from feeddrive.blocks.load.recorded_force import RecordedForce
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.files.machine import read_machine
from feeddrive.identification.motion.motion_log import MotionLog
from feeddrive.language import tree
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import simulate

T = 1e-3
TRUTH = {"mass": 95.1089, "viscous": 203.5034, "coulomb": 20.3935, "offset": -3.1648}


def loop(dead_samples: int = 0) -> Loop:
    """The published symmetric axis under its published gains."""
    found = read_machine("emps_symmetric").loop("x")
    return tree.vary(found, {"axis.x.actuator.dead_time": dead_samples * T})


@cache
def set_positions(strokes: int = 3) -> np.ndarray:
    """Several strokes to and fro at different speeds, as many rows as the clock gives."""
    parts: list[np.ndarray] = []
    for speed in (0.125, 0.05, 0.09, 0.02)[:strokes]:
        move = SnapLimitedMove(
            distance=0.2 * speed / 0.125,
            velocity=speed,
            acceleration=0.84,
            jerk=20.0,
            snap=1000.0,
            back=True,
            dwell_before=0.1,
            dwell_between=0.1,
            dwell_after=0.1,
        )
        parts.append(np.asarray(move.at(np.arange(round(move.duration / T)) * T).position))
    return np.concatenate(parts)


def disturbance(size: float, memory: float, rows: int, seed: int) -> np.ndarray:
    """A force of the standard deviation `size` (N) whose autocorrelation falls to 1/e in `memory` s."""
    rho = np.exp(-T / memory)
    white = np.random.default_rng(seed).standard_normal(rows + 5000)
    return lfilter([size * np.sqrt(1.0 - rho * rho)], [1.0, -rho], white)[5000:]


def simulated(size: float = 2.0, memory: float = 0.05, seed: int = 1, dead_samples: int = 0) -> MotionLog:
    """A log of the axis with a disturbing force, counts of 50 nm and nothing else."""
    reference = set_positions()
    run = simulate(
        loop(dead_samples),
        Recorded(position=reference, sample_time=T),
        load=RecordedForce(force=disturbance(size, memory, reference.size, seed), sample_time=T),
        record=("force", "reading_load"),
        seed=seed,
    )
    rows = reference.size
    return MotionLog(
        name="simulated",
        position=run["reading_load"][:rows],
        force=run["force"][:rows],
        set_position=reference,
        sample_time=T,
    )


def changed(log: MotionLog, **fields: object) -> MotionLog:
    """The log with other channels."""
    return dataclasses.replace(log, **fields)  # type: ignore[arg-type]

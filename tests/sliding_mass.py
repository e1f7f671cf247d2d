"""Logs of a mass with dry friction under a control, many at once, in plain numpy: nothing of feeddrive is in it.

Between two changes of the force the motion is integrated in closed form, stops and starts included:

    m dv/dt = F - c sign(v) - b v,   at rest while |F| <= stiction · c
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import lfilter

Lanes = Any  # a number, or an array with one for each log
Step = Callable[[float, np.ndarray], np.ndarray]  # set position and readings -> forces


@dataclass(frozen=True)
class Drive:
    """Mass in kg, Coulomb friction in N, viscous friction in N s/m > 0.

    stiction   largest friction at rest over Coulomb friction
    dead_time  s, from the command to the force
    count      m, of the encoder that the law reads; 0 for none
    start      m, where the axis begins
    limit      N, of the command
    """

    mass: Lanes
    coulomb: Lanes
    viscous: Lanes
    stiction: Lanes = 1.0
    dead_time: float = 0.0
    count: Lanes = 0.0
    start: Lanes = 0.0
    limit: float = np.inf


@dataclass(frozen=True)
class Cascade:
    """F = Kp (w + 1/Tn ∫w),  w = Kv (r - x) + feedforward v_set - v,  v over n samples; Tn = 0: no integral."""

    Kv: Lanes
    Kp: Lanes
    Tn: Lanes = 0.0
    feedforward: float = 0.0
    n: int = 1

    def begin(self, x: np.ndarray, T: float) -> Step:
        past, total, last = [x] * self.n, np.zeros_like(x), [0.0]
        share = np.where(np.asarray(self.Tn) > 0.0, T / np.maximum(self.Tn, 1e-9), 0.0)

        def command(r: float, x: np.ndarray) -> np.ndarray:
            nonlocal total
            v = (x - past[-1]) / (self.n * T)
            past[:] = [x, *past[:-1]]
            w = self.Kv * (r - x) + self.feedforward * (r - last[0]) / T - v
            last[0] = r
            total = total + share * w
            return self.Kp * (w + total)

        return command


@dataclass(frozen=True)
class Pid:
    """LinuxCNC's `pid` in SI: F = P e + I ∫e + D (v_set - v) + F1 v_set + F2 a_set,  e = r of the last sample - x."""

    P: Lanes
    I: Lanes  # noqa: E741
    D: Lanes
    F1: Lanes = 0.0
    F2: Lanes = 0.0

    def begin(self, x: np.ndarray, T: float) -> Step:
        total, last, set_last, speed_last = np.zeros_like(x), x, [0.0], [0.0]

        def command(r: float, x: np.ndarray) -> np.ndarray:
            nonlocal total, last
            e, speed = set_last[0] - x, (r - set_last[0]) / T
            total = total + e * T
            forward = self.F1 * speed + self.F2 * (speed - speed_last[0]) / T
            force = self.P * e + self.I * total + self.D * (speed - (x - last) / T) + forward
            last, set_last[0], speed_last[0] = x, r, speed
            return force

        return command


def moved(drive: Drive, x: np.ndarray, v: np.ndarray, force: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
    """Position and velocity after the time h under a constant force."""
    c, b, rate = drive.coulomb, drive.viscous, drive.viscous / drive.mass
    held = np.abs(force) <= c * drive.stiction
    stuck = (v == 0.0) & held
    way = np.where(v == 0.0, np.sign(force), np.sign(v))
    end = (force - way * c) / b  # the speed that it tends to
    x1, v1 = _glided(x, v, end, rate, h)
    turns = (v1 * way < 0.0) & ~stuck
    if np.any(turns):
        with np.errstate(all="ignore"):
            t0 = np.clip(np.nan_to_num(np.where(turns, np.log((end - v) / end) / rate, 0.0)), 0.0, h)
        x0, _ = _glided(x, v, end, rate, t0)
        x2, v2 = _glided(x0, 0.0 * v, (force - np.sign(force) * c) / b, rate, h - t0)
        x1 = np.where(turns, np.where(held, x0, x2), x1)
        v1 = np.where(turns, np.where(held, 0.0, v2), v1)
    return np.where(stuck, x, x1), np.where(stuck, 0.0, v1)


def _glided(x: Any, v: Any, end: Any, rate: Any, t: Any) -> tuple[Any, Any]:
    gone = -np.expm1(-rate * t)
    return x + end * t + (v - end) * gone / rate, v + (end - v) * gone


def run(
    drive: Drive,
    law: Cascade | Pid,
    reference: np.ndarray,
    T: float,
    *,
    logs: int = 1,
    load: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """What the law read and what it commanded, both of shape (logs, rows); `load` in N is added to its command."""
    x, v = np.full(logs, reference[0]) + drive.start, np.zeros(logs)
    count = np.broadcast_to(np.asarray(drive.count, float), (logs,))
    unit = np.where(count > 0.0, count, 1.0)

    def read(x: np.ndarray) -> np.ndarray:
        return np.where(count > 0.0, count * np.round(x / unit), x)

    command = law.begin(read(x), T)
    whole = int(drive.dead_time / T + 1e-9)
    rest = drive.dead_time - whole * T
    queue = [np.zeros(logs)] * (whole + 2)
    readings, forces = (np.empty((logs, reference.size)) for _ in range(2))
    for k, r in enumerate(reference):
        readings[:, k] = read(x)
        forces[:, k] = np.clip(command(float(r), readings[:, k]), -drive.limit, drive.limit)
        queue = [*queue[1:], forces[:, k]]
        outside = 0.0 if load is None else load[..., k]
        if rest > 0.0:
            x, v = moved(drive, x, v, queue[0] + outside, rest)
        x, v = moved(drive, x, v, queue[1] + outside, T - rest)
    return readings, forces


def strokes(
    T: float,
    speeds: tuple[float, ...] = (0.2, 0.05, 0.1),
    acceleration: float = 2.0,
    dwell: float = 0.3,
    seconds: float = 0.4,
) -> np.ndarray:
    """Set positions of moves to and fro with rests between them; the speed rises and falls as half a cosine."""
    parts = [np.zeros(round(0.3 / T))]
    for speed in speeds:
        rise = 0.5 * np.pi * speed / acceleration
        t = np.arange(round((seconds + rise) / T)) * T
        up, down = (np.clip(each / rise, 0.0, 1.0) for each in (t, t[-1] - t))
        there = np.cumsum(speed * 0.5 * (1.0 - np.cos(np.pi * np.minimum(up, down)))) * T
        parts += [there, np.full(round(dwell / T), there[-1]), there[::-1], np.zeros(round(dwell / T))]
    return np.concatenate(parts)


def unknown(size: Any, memory: float, T: float, logs: int, rows: int, seed: int) -> np.ndarray:
    """Forces of standard deviations `size` (N) whose autocorrelation falls to 1/e in `memory` s, (logs, rows)."""
    rho = np.exp(-T / memory)
    white = np.random.default_rng(seed).standard_normal((logs, rows + 3000))
    made = np.asarray(lfilter([np.sqrt(1.0 - rho * rho)], [1.0, -rho], white, axis=1))[:, 3000:]
    return np.broadcast_to(np.asarray(size, float), (logs,))[:, None] * made

"""Logs of a drive that are computed with numpy alone: an axis and its control, written as a drive names them.

Nothing of feeddrive is used here, so that what is read, mapped and identified is compared with a second source.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

T = 1e-3  # s, of the log
_PARTS = 20  # of a sample, in which the motion is integrated


class PlainLaw(Protocol):
    """The force (N) of one sample from the set position and the reading (m)."""

    def __call__(self, target: float, reading: float) -> float: ...


class Cascade:
    """A P position loop around a P velocity loop, whose velocity is a difference: Kp (Kv (set - x) - (x - x₋₁)/T)."""

    def __init__(self, Kv: float, Kp: float) -> None:
        self.Kv, self.Kp, self.before = Kv, Kp, 0.0

    def __call__(self, target: float, reading: float) -> float:
        velocity, self.before = (reading - self.before) / T, reading
        return self.Kp * (self.Kv * (target - reading) - velocity)


class HalPid:
    """The pid of LinuxCNC as pid(9) describes it, in mm, with `error-previous-target`; its output in N."""

    def __init__(
        self, Pgain: float, Igain: float, Dgain: float, FF1: float, FF2: float, force_per_output: float
    ) -> None:
        self.gains, self.scale = (Pgain, Igain, Dgain, FF1, FF2), force_per_output
        self.target = self.reading = self.rate = self.integral = 0.0

    def __call__(self, target: float, reading: float) -> float:
        target, reading = 1e3 * target, 1e3 * reading
        P, I, D, FF1, FF2 = self.gains  # noqa: E741  as pid(9) calls them
        error = self.target - reading
        self.integral += error * T
        rate, back = (target - self.target) / T, (reading - self.reading) / T
        output = P * error + I * self.integral + D * (rate - back) + FF1 * rate + FF2 * (rate - self.rate) / T
        self.target, self.reading, self.rate = target, reading, rate
        return self.scale * output


@dataclass(frozen=True)
class PlainAxis:
    """A rigid axis with dry and viscous friction; a force acts `late` samples after its sample, at most one."""

    mass: float = 180.0  # kg
    viscous: float = 300.0  # N s/m
    coulomb: float = 60.0  # N
    late: float = 0.0

    def run(self, law: PlainLaw) -> dict[str, np.ndarray]:
        """Time (s), set position and position (m), velocity (m/s) and force (N) of two strokes there and back."""
        wanted = set_positions()
        x = v = force = 0.0
        rows = np.empty((wanted.size, 3))
        waits = round(self.late * _PARTS)
        for k, target in enumerate(wanted):
            old, force = force, law(float(target), x)
            rows[k] = x, v, force
            for part in range(_PARTS):
                x, v = self._moved(x, v, old if part < waits else force, T / _PARTS)
        x, v, force = rows.T
        return {"time": T * np.arange(wanted.size), "set": wanted, "position": x, "velocity": v, "force": force}

    def _moved(self, x: float, v: float, force: float, h: float) -> tuple[float, float]:
        """A short time later, with dry friction that holds what it can stop."""
        free = (v + h * force / self.mass) / (1.0 + h * self.viscous / self.mass)
        most = h * self.coulomb / self.mass
        after = 0.0 if abs(free) <= most else free - np.copysign(most, free)
        return x + h * after, after


def set_positions() -> np.ndarray:
    """Strokes of 0.15 m and 0.04 m there and back, with accelerations that rise and fall smoothly, and rests."""
    parts: list[np.ndarray] = []
    for distance, duration in ((0.15, 0.6), (0.04, 0.35)):
        s = np.arange(0.0, duration, T) / duration
        rise = distance * (35.0 * s**4 - 84.0 * s**5 + 70.0 * s**6 - 20.0 * s**7)
        rest = np.full(round(0.1 / T), distance)
        parts += [rise, rest, distance - rise, 0.0 * rest]
    return np.concatenate([np.zeros(100), *parts])


def write_columns(path: Path, columns: dict[str, np.ndarray], separator: str = ",", decimal: str = ".") -> Path:
    """Write columns under their heads, as a recorder does."""
    rows = np.column_stack([*columns.values()])
    lines = [separator.join(f"{value:.12g}" for value in row).replace(".", decimal) for row in rows]
    path.write_text("\n".join([separator.join(columns), *lines, ""]), encoding="utf-8")
    return path

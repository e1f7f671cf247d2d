"""Logs of a drive that are computed with numpy alone: an axis under cascaded P control, written as a drive names it.

Nothing of feeddrive is used here, so that what is read, mapped and identified is compared with a second source.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

T = 1e-3  # s, of the log
_PARTS = 20  # of a sample, in which the motion is integrated


@dataclass(frozen=True)
class PlainDrive:
    """A rigid axis and its control: a P position loop around a P velocity loop, whose velocity is a difference.

    force = Kp (Kv (set - x) - (x - x_before) / T)
    """

    mass: float = 180.0  # kg
    viscous: float = 300.0  # N s/m
    coulomb: float = 60.0  # N
    Kv: float = 30.0  # 1/s
    Kp: float = 9000.0  # N s/m

    def run(self) -> dict[str, np.ndarray]:
        """Time (s), set position and position (m), velocity (m/s) and force (N) of two strokes there and back."""
        wanted = set_positions()
        x = v = before = 0.0
        rows = np.empty((wanted.size, 3))
        h = T / _PARTS
        for k, target in enumerate(wanted):
            force = self.Kp * (self.Kv * (target - x) - (x - before) / T)
            rows[k], before = (x, v, force), x
            for _ in range(_PARTS):
                x, v = self._moved(x, v, force, h)
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

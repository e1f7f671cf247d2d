"""Logs of a position loop by a small simulator of our own, with names, units and column orders drawn by a seed.

The equations are those of a textbook, stepped in plain Python with ten substeps a sample; nothing of feeddrive's
simulator is used.  `motion(seed)` gives the signals in SI, `written` a file of them under any heads.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

SUBSTEPS = 10


@dataclass(frozen=True)
class Motion:
    """Signals of one axis in SI, each of shape (n,): set position, motor and table position, velocity, force."""

    T: float
    mass: float
    set_position: np.ndarray
    motor: np.ndarray
    table: np.ndarray
    velocity: np.ndarray
    force: np.ndarray
    rated: float  # N, a round force of the drive

    @property
    def time(self) -> np.ndarray:
        return self.T * np.arange(self.table.size)


def trapezoids(rng: np.random.Generator, T: float, strokes: Sequence[float], speed: float, ramp: float) -> np.ndarray:
    """Set positions: strokes with ramps of constant acceleration, smoothed over 10 ms, with rests between them."""
    velocity: list[np.ndarray] = [np.zeros(round(0.1 / T))]
    for stroke in strokes:
        top = speed * rng.uniform(0.6, 1.0)
        up = max(2, round(top / ramp / T))
        flat = max(0, round(abs(stroke) / top / T) - up)
        rise = np.linspace(0.0, top, up)
        velocity += [np.sign(stroke) * np.concatenate([rise, np.full(flat, top), rise[::-1]])]
        velocity += [np.zeros(round(rng.uniform(0.08, 0.2) / T))]
    width = max(2, round(0.01 / T))
    smooth = np.convolve(np.concatenate(velocity), np.full(width, 1.0 / width), mode="full")
    return T * np.cumsum(smooth)


@cache
def motion(seed: int, *, seconds: float = 3.0, count: float = 1e-8, feedforward: float = 0.0) -> Motion:
    """A move to and fro of a mass with friction under a P-PI cascade.

    The table hangs on the motor by a spring, of which only the static part counts: it lags by (m a + friction)/k.
    """
    rng = np.random.default_rng(seed)
    T = float(rng.choice([0.5e-3, 1e-3, 2e-3]))
    mass = float(10.0 ** rng.uniform(1.0, 3.0))
    ramp = float(rng.uniform(1.0, 4.0))
    speed = float(rng.uniform(0.08, 0.4))
    stroke = float(rng.uniform(0.05, 0.25))
    coulomb, viscous = 0.15 * mass * ramp * rng.uniform(0.5, 2.0), 0.5 * mass * rng.uniform(0.5, 2.0)
    Kv, bandwidth = float(rng.uniform(15.0, 40.0)), float(rng.uniform(100.0, 200.0))
    Kp, Tn = bandwidth * mass, 0.03
    set_points = trapezoids(rng, T, [stroke, -stroke, 0.7 * stroke, -0.7 * stroke], speed, ramp)
    set_points = np.pad(set_points, (0, max(0, round(seconds / T) - set_points.size)), mode="edge")
    goal, rate = set_points.tolist(), np.gradient(set_points, T).tolist()
    n, h = len(goal), T / SUBSTEPS
    x, v, total = 0.0, 0.0, 0.0
    position, speed_, force = np.empty(n), np.empty(n), np.empty(n)
    for k in range(n):
        reading = count * round(x / count)
        wanted = Kv * (goal[k] - reading) + feedforward * rate[k]
        error = wanted - v
        total += error * T / Tn
        u = Kp * (error + total)
        position[k], speed_[k], force[k] = reading, v, u
        for _ in range(SUBSTEPS):
            # implicit step: friction stops the mass within the step if it can
            free = v + h * (u - viscous * v) / mass
            slip = h * coulomb / mass
            v = free - min(max(free, -slip), slip)
            x += h * v
    acceleration = np.gradient(speed_, T)
    stiffness = mass * (2.0 * np.pi * 60.0) ** 2
    sag = (0.7 * mass * acceleration + 0.7 * coulomb * np.tanh(speed_ / 1e-3)) / stiffness
    rated = float(f"{1.3 * np.max(np.abs(force)):.2g}")
    return Motion(T, mass, set_points, position, position - sag, speed_, force, rated)


def written(path: Path, columns: Mapping[str, np.ndarray], separator: str = ",", decimal: str = ".") -> Path:
    """Write columns under their heads as text of 12 digits."""
    rows = np.column_stack(list(columns.values()))
    lines = [separator.join(f"{value:.12g}" for value in row) for row in rows]
    text = "\n".join(lines).replace(".", decimal) + "\n"
    path.write_text(f"{separator.join(columns)}\n{text}", encoding="utf-8")
    return path


@dataclass(frozen=True)
class Drawn:
    """A file with drawn names, units and neighbors, and what is true of it.

    roles    the column of each role: setpoint, position, force or torque or current
    options  what a person adds to identify it: unit of nameless lengths, rated value
    """

    path: Path
    motion: Motion
    axis: str
    roles: Mapping[str, str]
    options: Mapping[str, object]
    said: str


# set, actual, force, each as a recorder or a person names it; {} is the axis
STYLES: tuple[tuple[str, str, str], ...] = (
    ("{}_target", "{}_actual", "{}_force"),
    ("{}_cmd", "{}_fb", "{}_force"),
    ("{}1_CommandPosition", "{}1_ActualPosition", "{}1_Force"),
    ("{} Sollposition", "{} Istposition", "{} Kraft"),
    ("{}_Lagesollwert", "{}_Lageistwert", "{}_Kraftistwert"),
    ("Axis_{}.SetPos", "Axis_{}.ActPos", "Axis_{}.ActForce"),
    ("axis {} position nominal", "axis {} position actual", "axis {} force"),
)
_LENGTHS = {"mm": 1e3, "um": 1e6, "in": 1.0 / 0.0254, "m": 1.0}


def drawn(seed: int, folder: Path) -> Drawn:
    """Draw a file: names, units, percent or kN, order of columns, separator, decimal mark, a second axis, neighbors."""
    rng = np.random.default_rng(1000 + seed)
    motions = [motion(2 * seed), motion(2 * seed + 1)]
    axes = ["X", "Y"] if rng.random() < 0.5 else ["Y", "Z"]
    style = STYLES[seed % len(STYLES)]
    several = bool(rng.random() < 0.6)
    length = str(rng.choice([*_LENGTHS]))
    force_unit = str(rng.choice(["N", "kN", "%"]))
    here = motions[0]
    rows = here.table.size
    columns: list[tuple[str, np.ndarray]] = []
    roles: dict[str, str] = {}
    for axis, its in zip(axes[: 1 + several], motions, strict=False):
        # the second axis shares the clock of the first
        signals = (its.set_position * _LENGTHS[length], its.table * _LENGTHS[length], its.force)
        size = {"N": 1.0, "kN": 1e-3, "%": 100.0 / here.rated}[force_unit]
        names = [name.format(axis) for name in style]
        for role, name, values in zip(("set", "position", "force"), names, signals, strict=True):
            unit = force_unit if role == "force" else length
            scaled = values * size if role == "force" else values
            # a shorter motion of the other axis ends at rest
            whole = np.pad(scaled[:rows], (0, max(0, rows - scaled.size)), mode="edge")
            columns.append((f"{name} [{unit}]", whole))
            if its is here:
                roles[role] = name
        noise = np.random.default_rng(seed).normal(size=rows)
        columns += [(f"{axis}_bus_voltage [V]", 600.0 + noise), (f"{axis}_temperature", 40.0 + 0.01 * noise)]
        error = (signals[0] - signals[1])[:rows]
        columns += [(f"{axis}_following_error [{length}]", np.pad(error, (0, rows - error.size), mode="edge"))]
    order = rng.permutation(len(columns))
    # the first axis of the file is the first that is named
    table = {columns[k][0]: columns[k][1] for k in order}
    separator, decimal = [(",", "."), (";", ","), ("\t", ".")][int(rng.integers(3))]
    stamp = str(rng.choice(["ms", "s", "us"]))
    clock = here.time[:rows] * {"ms": 1e3, "s": 1.0, "us": 1e6}[stamp]
    path = written(folder / f"drawn_{seed}.csv", {f"time [{stamp}]": clock, **table}, separator, decimal)
    options: dict[str, object] = {"rated": f"{here.rated:g}N"} if force_unit == "%" else {}
    said = f"seed {seed}: {style[1]}, {length}, {force_unit}, {2 if several else 1} axes, {separator!r}, {stamp}"
    return Drawn(path, here, axes[0].lower(), roles, options, said)

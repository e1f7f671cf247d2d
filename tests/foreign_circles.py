"""Circles of tables from a simulator that shares no code with feeddrive, with friction alone or with true faults.

python tests/foreign_circles.py 50 1          # 50 tables of seed 1: the table of docs/how_to/machining.md
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

import foreign_axis as fa
from feeddrive.machining.circle_test import CircleCauses, CirclePath, circle_causes, circle_path

T, RADIUS, FEEDS, TURNS = 5e-4, 0.02, (0.02, 0.1), 1.45
Distortion = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


class Motion(NamedTuple):
    """The true positions of one circle about 0, m, its set velocities, m/s, feed and direction."""

    x: np.ndarray
    y: np.ndarray
    vx: np.ndarray
    vy: np.ndarray
    feed: float
    direction: int


def tables(rng: np.random.Generator, count: int, kv_of_y: float = 1.0, **over: Any) -> list[list[Motion]]:
    """Draw tables of two foreign axes with one P-PI law, and run them in both directions at two feeds.

    Masses, levels, Stribeck friction, presliding, counts and dead time differ between the axes; viscous friction is
    left out, since its lag is a true cause.  `kv_of_y` is the position gain of y as a share of that of x.
    """

    def drawn() -> list[fa.Axes]:
        usual: dict[str, Any] = {"gravity": 0.0, "offset": 0.0, "limit": np.inf, "viscous": 0.0, "noise_log": 0.0}
        return [
            fa.draw_axes(
                rng,
                T,
                two=False,
                **usual
                | {
                    "dead_time": T * rng.uniform(0.0, 0.5),
                    "resolution": fa.log_uniform(rng, 3e-8, 5e-7),
                    "creep": 0.0 if rng.random() < 0.6 else 5e-6,
                    "noise_drive": 0.0,
                }
                | over,
            )
            for _ in range(count)
        ]

    x, y = drawn(), drawn()
    late = T + np.maximum([axis.dead_time for axis in x], [axis.dead_time for axis in y])
    rate = np.minimum(rng.uniform(0.25, 0.35, count) / late, 500.0)
    gain, integral = rate * rng.uniform(0.15, 0.3, count), rate * rng.uniform(0.08, 0.25, count)
    # x is the same in both directions, y changes its sign: three motions
    axes = fa._stack([*x, *y, *y], fa.SHARED)  # pyright: ignore[reportPrivateUsage]
    forward = 1.0 if kv_of_y == 1.0 else 0.0
    law = fa.Cascade(
        Kv=np.concatenate([gain, kv_of_y * gain, kv_of_y * gain]),
        Kp=np.asarray(axes.mass) * np.tile(rate, 3),
        rate=np.tile(integral, 3),
        ff=forward,
    )
    motions: list[list[Motion]] = [[] for _ in range(count)]
    for feed in FEEDS:
        set_x, set_y = fa.circle(T, RADIUS, feed, turns=TURNS)
        sets = np.stack([set_x, set_y, -set_y])
        found = fa.simulate(axes, law, np.repeat(sets, count, axis=0), T, rng, count=3 * count, substeps=2)
        at, v = found.hidden["position"].reshape(3, count, -1), np.gradient(sets, T, axis=1)
        for i, motion in enumerate(motions):
            motion += [Motion(at[0, i] + RADIUS, at[k, i], v[0], v[k], feed, 3 - 2 * k) for k in (1, 2)]
    return motions


def faulty(scale: tuple[float, float], squareness: float, backlash: tuple[float, float]) -> Distortion:
    """The tool of a table with these faults; the sides of a backlash change with the set velocity."""

    def seen(x: np.ndarray, y: np.ndarray, vx: np.ndarray, vy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        along_x = x * (1.0 + scale[0]) + squareness * y - 0.5 * backlash[0] * np.sign(vx)
        return along_x, y * (1.0 + scale[1]) - 0.5 * backlash[1] * np.sign(vy)

    return seen


def causes(motions: list[Motion], distorted: Distortion | None = None, points: int = 720, **how: Any) -> CircleCauses:
    """Split the circles of one table."""
    circles: list[CirclePath] = []
    for motion in motions:
        x, y = (motion.x, motion.y) if distorted is None else distorted(*motion[:4])
        circles.append(circle_path(x, y, sample_time=T, radius=RADIUS, center=(0.0, 0.0), points=points))
    return circle_causes(circles, **how)


def main() -> int:
    """Print how many causes of friction alone are above 3 standard errors, and how often true faults are held."""
    count, seed = (int(word) for word in sys.argv[1:3])
    above: Counter[str] = Counter()
    held: Counter[str] = Counter()
    largest: dict[str, float] = {}
    rng = np.random.default_rng(seed)
    true = {
        "scale, mean": 20e-6,
        "scale, difference": -15e-6,
        "squareness": 60e-6,
        "backlash x": 3e-6,
        "backlash y": 2e-6,
    }
    fault = faulty((5e-6, 35e-6), 60e-6, (3e-6, 2e-6))
    for motions in tables(rng, count):
        plain = causes(motions)
        for cause in plain.causes:
            if not cause.name.startswith(("set-up", "reversal", "lag radius, mean")):
                above[cause.name] += abs(cause.value) > 3.0 * cause.error
                largest[cause.name] = max(largest.get(cause.name, 0.0), abs(cause.value) / cause.error)
        found = causes(motions, fault, backlash="step")
        for name, value in true.items():
            held[name] += abs(found[name].value - value) <= 1.645 * found[name].error
    sys.stdout.write(f"{count} tables of seed {seed}, friction alone, above 3 standard errors: {dict(above)}\n")
    sys.stdout.write(f"largest, standard errors: { {name: round(z, 1) for name, z in largest.items()} }\n")
    sys.stdout.write(f"with faults, within 1.645 standard errors: {dict(held)}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Trials of axes from a simulator that shares no code with feeddrive, with true mass and friction.

python tests/foreign_trials.py            # the table of docs/reference/laws/iterative-feedforward.md
"""

from __future__ import annotations

import dataclasses
import sys
from typing import Any, NamedTuple

import numpy as np

import foreign_axis as fa
from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.feedforward.disturbance_compensator import DisturbanceCompensator
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.learning.iterative_feedforward import Iteration, next_iteration
from feeddrive.learning.trial import measured_trial
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop

T = 5e-4
NAMES = ("mass", "viscous", "coulomb_positive", "coulomb_negative")
MOVES: dict[str, dict[str, Any]] = {
    "100 mm at 0.25 m/s": {"travel": 0.1, "speed": 0.25, "acceleration": 3.0, "jerk": 60.0},
    "40 mm at 0.1 m/s": {"travel": 0.04, "speed": 0.1, "acceleration": 1.0, "jerk": 20.0},
    "200 mm at 0.5 m/s": {"travel": 0.2, "speed": 0.5, "acceleration": 8.0, "jerk": 300.0},
}


class Table(NamedTuple):
    """Axes of one structure under P-PI with the whole set velocity fed forward, and what is true of them, (N, 4)."""

    axes: fa.Axes
    law: fa.Cascade
    truth: np.ndarray
    setpoint: np.ndarray

    def __len__(self) -> int:
        return len(self.truth)

    def begin(self, rng: np.random.Generator) -> np.ndarray:
        """A first feedforward: a fifth or three fifths of the mass."""
        theta = np.zeros((len(self), 4))
        theta[:, 0] = self.truth[:, 0] * rng.choice((0.2, 0.6), len(self))
        return theta

    def loop(self, i: int, theta: np.ndarray) -> Loop:
        """The loop of axis i as its user knows it: gains, rate and dead time of the drive, a wrong mass."""
        law, block = self.law, DisturbanceCompensator(**dict(zip(NAMES, map(float, theta), strict=True)))
        plant = Axis(plant=Rigid(mass=1.0), actuator=Actuator(dead_time=float(self.axes.dead_time[i])))
        gains = CascadePPI(Kv=float(law.Kv[i]), Kp=float(law.Kp[i]), Tn=1.0 / float(law.rate[i]))
        return Loop(control=Control(law=gains, feedforward=(block,)), axis=plant, sample_time=T)

    def run(self, rng: np.random.Generator, theta: np.ndarray) -> fa.Logs:
        """The logs of all axes with these parameters fed forward, in the middle of the samples."""
        x = np.pad(self.setpoint, 2, mode="edge")
        here, after, later, before = (x[2 + k : 2 + k + self.setpoint.size] for k in (0, 1, 2, -1))
        v, a = (after - here) / T, (later - after - here + before) / (2.0 * T * T)
        v = np.where(np.abs(v) < 1e-9, 0.0, v)
        fed = theta @ np.stack([a, v, v > 0.0, -1.0 * (v < 0.0)])
        return fa.simulate(self.axes, self.law, self.setpoint, T, rng, count=len(self), added=fed, substeps=2)

    def learned(self, logs: fa.Logs, theta: np.ndarray, *, with_force: bool, **how: Any) -> list[Iteration]:
        """The iteration of each axis from its log of set position, position and, if wanted, force."""
        steps: list[Iteration] = []
        for i in range(len(self)):
            log = logs.log(i)
            loop = self.loop(i, theta[i])
            force = log["force"] if with_force else None
            trial = measured_trial(loop, log["setpoint"], log["position"], sample_time=T, force=force)
            steps.append(next_iteration(loop, trial, **how))
        return steps


def table(rng: np.random.Generator, count: int, move: str = "100 mm at 0.25 m/s", trips: int = 1, **over: Any) -> Table:
    """Draw axes and laws: masses, friction with its Stribeck or presliding, counts, noise and dead time of tests."""
    how = MOVES[move]
    travel, speed, acceleration, jerk = how["travel"], how["speed"], how["acceleration"], how["jerk"]
    setpoint = fa.smooth_moves(T, [travel, 0.0] * trips, speed, acceleration, jerk, 0.25, 0.1)
    usual: dict[str, Any] = {"gravity": 0.0, "offset": 0.0, "limit": np.inf}
    drawn = [fa.draw_axes(rng, T, two=False, **(usual | over)) for _ in range(count)]
    laws = [fa.draw_law(rng, axis, T, "P-PI", n=1) for axis in drawn]
    plain = [
        dataclasses.replace(law, ff=1.0, windup="none", mass_ff=0.0, tau=0.0, friction_ff=0.0)  # type: ignore[type-var]
        for law in laws
    ]
    axes, law = fa._stack(drawn, fa.SHARED), fa._stack(plain, fa.SHARED)  # pyright: ignore[reportPrivateUsage]
    truth = np.stack([axes.mass, axes.viscous, axes.coulomb_positive, axes.coulomb_negative], axis=1)
    return Table(axes, law, truth, setpoint)


def values(steps: list[Iteration]) -> np.ndarray:
    """What is fed forward next, (N, 4)."""
    return np.array([[step.after.parameters()[name] for name in NAMES] for step in steps])


def covered(steps: list[Iteration], truth: np.ndarray) -> np.ndarray:
    """Whether each interval holds its true value, (N, 4)."""
    bounds = np.array([[step.intervals[name] for name in NAMES] for step in steps])
    return (bounds[..., 0] <= truth) & (truth <= bounds[..., 1])


def main() -> int:
    """Print coverage and widths for each move, without and with the force, and the errors of the trials."""
    for seed, (move, trips) in enumerate([*((move, 1) for move in MOVES), ("100 mm at 0.25 m/s", 2)], start=11):
        for with_force in (True, False):
            rng = np.random.default_rng(seed)
            axes = table(rng, 100, move, trips)
            theta = axes.begin(rng)
            size = np.stack([*axes.truth.T[:2], *[axes.truth[:, 2:].mean(1)] * 2], axis=1)
            for trial in (1, 2):
                logs = axes.run(rng, theta)
                rms = 1e6 * np.median(np.sqrt(np.mean((logs.columns["setpoint"] - logs.hidden["position"]) ** 2, 1)))
                steps = axes.learned(logs, theta, with_force=with_force)
                half = np.array([[np.ptp(step.intervals[name]) / 2 for name in NAMES] for step in steps]) / size
                sure = np.array([[step.errors[name] for name in NAMES] for step in steps])
                off = np.abs(values(steps) - axes.truth)
                sys.stdout.write(
                    f"{move} x{trips}, force {with_force}, seed {seed}, trial {trial}: rms {rms:.2f} um, covered "
                    f"{covered(steps, axes.truth).mean(0).round(2)}, half {np.median(half, 0).round(3)}, within 1.64 s "
                    f"{np.mean(off < 1.645 * sure, 0).round(2)}, off {np.median(off / size, 0).round(3)}\n"
                )
                theta = values(steps)
    return 0


if __name__ == "__main__":
    sys.exit(main())

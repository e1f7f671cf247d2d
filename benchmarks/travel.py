"""Proofs along the travel, held against draws that share no code with them.

    python benchmarks/travel.py --axes 20 --seed 5

Each drawn axis of two masses has a stiffness by its position, fitted from five places, and a schedule of P-PI gains at
three.  Its frozen loops are proven stable, with a bound on Ms 1 % above what a coarse grid shows,
and its moving loop up to a speed.  Then

- frozen positions are drawn: eigenvalues of the loop, and |S| on 2000 lines refined at the peak, from matrices that are
  written here from the equations of the axis and of the law;
- moving axes are drawn: motions at up to the proven speed (sweeps, dither, random walks), along which the stiffness
  changes within the samples, too. From a random state the loop without setpoint must come to rest.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import expm

from feeddrive.blocks import CascadePPI, GainSchedule, SchedulePlace, TwoMass
from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.certificate.travel_proof import prove_along_travel
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.tuning import Travel

T = 2.5e-4  # s
_LEFT = 1e-2  # of the largest state: after a second an axis that comes to rest has far less
SUBSTEPS = 8  # of the fourth-order Runge-Kutta method in a sample


class Drawn(NamedTuple):
    """An axis and its schedule as plain numbers: compliance a + b x in m/N, gains at the places, all in SI."""

    m1: float
    m2: float
    c: float
    b1: float
    b2: float
    a: float
    b: float
    lag: float
    places: np.ndarray
    gains: np.ndarray  # (places, Kv Kp Tn)

    def stiffness(self, x: np.ndarray | float) -> np.ndarray | float:
        """Return the stiffness at a position, N/m."""
        return 1.0 / (self.a + self.b * x)

    def gains_at(self, x: np.ndarray | float) -> list[np.ndarray]:
        """Return Kv, Kp and Tn at a position."""
        return [np.interp(x, self.places, column) for column in self.gains.T]


def drawn(random: np.random.Generator) -> Drawn:
    """Draw an axis between the large and the small screws of machine tools, and gains near those of a P-PI rule."""
    m1, m2 = np.exp(random.uniform(np.log(100.0), np.log(1500.0))), np.exp(random.uniform(np.log(100.0), np.log(800.0)))
    far, ratio = np.exp(random.uniform(np.log(4e7), np.log(2e8))), random.uniform(1.3, 3.0)
    length = random.uniform(0.6, 3.0)
    a = 1.0 / (far * ratio)
    b = (1.0 / far - a) / length
    reduced = m1 * m2 / (m1 + m2)
    c = 2.0 * random.uniform(0.02, 0.08) * np.sqrt(far * reduced)
    places = np.array([0.0, random.uniform(0.3, 0.7) * length, length])
    gains: list[list[float]] = []
    for x in places:
        mode = np.sqrt(1.0 / (a + b * x) / reduced)
        rate = mode * random.uniform(0.25, 0.4)
        gains.append([0.35 * rate, (m1 + m2) * rate, 4.0 / rate])
    lag = 2.0 * np.pi * random.uniform(600.0, 1500.0)
    b1, b2 = (random.uniform(1.0, 4.0) * m for m in (m1, m2))
    return Drawn(float(m1), float(m2), float(c), float(b1), float(b2), a, b, float(lag), places, np.array(gains))


def loop_of(axis: Drawn, x: float) -> Loop:
    """Return the loop of the library at a position."""
    plant = TwoMass(
        mass_motor=axis.m1,
        mass_load=axis.m2,
        stiffness=float(axis.stiffness(x)),
        damping=axis.c,
        viscous_motor=axis.b1,
        viscous_load=axis.b2,
    )
    actuator = Actuator(dead_time=T, current_loop=axis.lag / (2.0 * np.pi))
    body = Axis(plant=plant, actuator=actuator, encoder_motor=Encoder(), encoder_load=Encoder())
    places = tuple(
        SchedulePlace(position=float(x), law=CascadePPI(Kv=float(Kv), Kp=float(Kp), Tn=float(Tn)))
        for x, (Kv, Kp, Tn) in zip(axis.places, axis.gains, strict=True)
    )
    return Loop(control=Control(law=GainSchedule(places=places)), axis=body, sample_time=T)


def rate_matrix(axis: Drawn, k: float) -> np.ndarray:
    """Return dξ/dt of x1, x2, v1, v2, drive force and command."""
    A = np.zeros((6, 6))
    A[0, 2] = A[1, 3] = 1.0
    A[2] = [-k / axis.m1, k / axis.m1, -(axis.c + axis.b1) / axis.m1, axis.c / axis.m1, 1.0 / axis.m1, 0.0]
    A[3] = [k / axis.m2, -k / axis.m2, axis.c / axis.m2, -(axis.c + axis.b2) / axis.m2, 0.0, 0.0]
    A[4, 4], A[4, 5] = -axis.lag, axis.lag
    return A


def frozen(axis: Drawn, x: float) -> tuple[float, float]:
    """Return the largest |z| of the loop at a position and its Ms, from the equations."""
    Kv, Kp, Tn = (float(g) for g in axis.gains_at(x))
    moved = expm(rate_matrix(axis, float(axis.stiffness(x))) * T)
    A, b = moved[:5, :5], moved[:5, 5]
    # states: the five of the axis, the command of the last sample, x1 of the last sample, the integral
    whole = np.zeros((8, 8))
    whole[:5, :5], whole[:5, 5] = A, b
    e = np.zeros(8)
    e[1], e[0], e[6] = -Kv, -1.0 / T, 1.0 / T
    integral = np.zeros(8)
    integral[7] = 1.0
    integral += Kp * T / Tn * e
    whole[5], whole[6, 0], whole[7] = Kp * e + integral, 1.0, integral
    growth = float(np.max(np.abs(np.linalg.eigvals(whole))))

    def sensitivity(f: np.ndarray) -> np.ndarray:
        z = np.exp(2j * np.pi * f * T)
        inner = np.linalg.solve(z[:, None, None] * np.eye(5) - A, np.broadcast_to(b[:, None], (f.size, 5, 1)))[:, :, 0]
        G = inner[:, :2] / z[:, None]
        PI = Kp * (1.0 + T / Tn * z / (z - 1.0))
        return 1.0 / np.abs(1.0 + PI * (Kv * G[:, 1] + (1.0 - 1.0 / z) / T * G[:, 0]))

    lines = np.geomspace(0.05, 0.5 / T, 2000)
    best = 0.0
    for _ in range(3):
        size = sensitivity(lines)
        k = int(np.argmax(size))
        best = float(size[k])
        lines = np.linspace(lines[max(k - 1, 0)], lines[min(k + 1, lines.size - 1)], 41)
    return growth, best


def motions(
    random: np.random.Generator, first: float, last: float, speed: float, count: int, samples: int
) -> np.ndarray:
    """Return positions at the samples, shape (samples + 1, count): never faster than `speed`."""
    step, length = speed * T, last - first
    t = np.arange(samples + 1)[:, None]
    start = random.uniform(0.0, 2.0 * length, count)
    kind = np.arange(count) % 4
    sweep = start + step * t  # at full speed from end to end
    walk = np.cumsum(np.vstack([start, random.uniform(-step, step, (samples, count))]), axis=0)
    every = random.integers(1, 40, count)
    dither = start + step * np.abs((t + every) % (2 * every) - every)
    jump = np.cumsum(np.vstack([start, step * random.choice([-1.0, 1.0], (samples, count))]), axis=0)
    y = np.choose(kind, [sweep, dither, walk, jump])
    # folded at the ends, which makes no motion faster
    return first + length - np.abs(y % (2.0 * length) - length)


def moving(axis: Drawn, x: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Return how large the state is at the end of motions, over the largest that it was, shape (motions,)."""
    count = x.shape[1]
    q = np.zeros((5, count))
    q[:2], q[2:4] = random.normal(size=(2, count)) * 1e-5, random.normal(size=(2, count)) * 1e-3
    command, last, integral = np.zeros(count), q[0].copy(), random.normal(size=count) * 100.0
    largest = np.zeros(count)

    def rate(q: np.ndarray, k: np.ndarray, u: np.ndarray) -> np.ndarray:
        spring = k * (q[1] - q[0]) + axis.c * (q[3] - q[2])
        a1, a2 = (spring - axis.b1 * q[2] + q[4]) / axis.m1, (-spring - axis.b2 * q[3]) / axis.m2
        return np.stack([q[2], q[3], a1, a2, axis.lag * (u - q[4])])

    h = T / SUBSTEPS
    size = np.zeros(count)
    for now, then in pairwise(x):
        Kv, Kp, Tn = axis.gains_at(now)
        e = -Kv * q[1] - (q[0] - last) / T
        integral = integral + Kp * T / Tn * e
        acting, command, last = command, Kp * e + integral, q[0].copy()
        for i in range(SUBSTEPS):
            a, b, c = (np.asarray(axis.stiffness(now + (then - now) * (i + s) / SUBSTEPS)) for s in (0.0, 0.5, 1.0))
            k1 = rate(q, a, acting)
            k2 = rate(q + 0.5 * h * k1, b, acting)
            k3 = rate(q + 0.5 * h * k2, b, acting)
            k4 = rate(q + h * k3, c, acting)
            q = q + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        size = np.sqrt(q[0] ** 2 + q[1] ** 2 + (q[2] ** 2 + q[3] ** 2) * 1e-4 + (integral * 1e-9) ** 2)
        largest = np.maximum(largest, size)
    return size / largest


def judged(axis: Drawn, random: np.random.Generator, frozen_: int, moving_: int, samples: int) -> dict[str, Any]:
    """Prove the schedule of an axis, draw, and return the figures of both."""
    first, last = float(axis.places[0]), float(axis.places[-1])
    coarse = [frozen(axis, float(x)) for x in np.linspace(first, last, 25)]
    if max(growth for growth, _ in coarse) >= 1.0:
        return {"verdict": "unstable on the grid"}
    bound = 1.01 * max(peak for _, peak in coarse)
    travel = Travel.of({float(x): loop_of(axis, float(x)) for x in np.linspace(first, last, 5)})
    begun = time.process_time()
    proof = prove_along_travel(travel, loop_of(axis, first).control, sensitivity_peak=bound)
    took = time.process_time() - begun
    peaks = [frozen(axis, float(x)) for x in random.uniform(first, last, frozen_)]
    row: dict[str, Any] = {
        "verdict": proof.verdict,
        "bound": bound,
        "largest_Ms": max(peak for _, peak in peaks),
        "largest_growth": max(growth for growth, _ in peaks),
        "cells": len(proof.cells),
        "speed_m_s": proof.speed,
        "cpu_s": took,
    }
    if proof.speed:
        row["left"] = float(np.max(moving(axis, motions(random, first, last, proof.speed, moving_, samples), random)))
    return row


def contradicted(row: Mapping[str, Any]) -> bool:
    """Return True if a draw contradicts the proof of its axis."""
    if row["verdict"] != "proven":
        return False
    return row["largest_Ms"] > row["bound"] or row["largest_growth"] >= 1.0 or row.get("left", 0.0) > _LEFT


def main() -> None:
    """Draw, prove, and count what contradicts a proof."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--axes", type=int, default=20)
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--frozen", type=int, default=10_000)
    parser.add_argument("--moving", type=int, default=1_000)
    parser.add_argument("--samples", type=int, default=4_000)
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args()
    random = np.random.default_rng(asked.seed)
    rows: list[dict[str, Any]] = []
    for i in range(asked.axes):
        axis = drawn(random)
        each = asked.frozen // asked.axes, asked.moving // asked.axes, asked.samples
        rows.append({"axis": i, **judged(axis, random, *each)})
        print(json.dumps(rows[-1]), flush=True)
    wrong = [row for row in rows if contradicted(row)]
    print(f"{len(rows)} axes, {sum(row['verdict'] == 'proven' for row in rows)} proven, {len(wrong)} contradicted")
    if asked.out:
        asked.out.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

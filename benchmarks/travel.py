"""Proofs along the travel, held against draws that share no code with them.

    python benchmarks/travel.py --axes 20 --seed 5
    python benchmarks/travel.py --axes 20 --seed 7 --law linear_adrc
    python benchmarks/travel.py --axes 20 --seed 9 --payloads

Each drawn axis of two masses has a stiffness by its position, fitted from five places, and a schedule of gains at
three; with payloads it is fitted from fifteen pairs, has gains for three payloads at each place, and the payload of its
proof is drawn.  Its frozen loops are proven stable, with a bound on Ms 1 % above what a coarse grid shows,
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
from collections.abc import Callable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import expm

from feeddrive.blocks import CascadePPI, GainSchedule, LinearADRC, ScheduleLoad, SchedulePlace, TwoMass
from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.families import Law
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
    gains: (
        np.ndarray
    )  # (places, Kv Kp Tn) or, of linear ADRC, (places, mass omega_c omega_o); with a payload in between
    law: str = "cascade_ppi"
    loads: np.ndarray | None = None  # payloads of the gains, kg: gains are then (places, loads, 3)

    def stiffness(self, x: np.ndarray | float) -> np.ndarray | float:
        """Return the stiffness at a position, N/m."""
        return 1.0 / (self.a + self.b * x)

    def carrying(self, load: float) -> Drawn:
        """Return the axis with a payload, kg, and the gains that the schedule has for it at the places."""
        if self.loads is None:
            return self
        gains = [[np.interp(load, self.loads, column) for column in place.T] for place in self.gains]
        return self._replace(m2=self.m2 + load, gains=np.array(gains), loads=None)

    def gains_at(self, x: np.ndarray | float) -> list[np.ndarray]:
        """Return the three gains at a position."""
        return [np.interp(x, self.places, column) for column in self.gains.T]


def drawn(random: np.random.Generator, law: str = "cascade_ppi", *, payloads: bool = False) -> Drawn:
    """Draw an axis between the large and the small screws of machine tools, and gains near those of a rule.

    Payloads are up to one and a half times the mass of the table.
    """
    m1, m2 = np.exp(random.uniform(np.log(100.0), np.log(1500.0))), np.exp(random.uniform(np.log(100.0), np.log(800.0)))
    far, ratio = np.exp(random.uniform(np.log(4e7), np.log(2e8))), random.uniform(1.3, 3.0)
    length = random.uniform(0.6, 3.0)
    a = 1.0 / (far * ratio)
    b = (1.0 / far - a) / length
    reduced = m1 * m2 / (m1 + m2)
    c = 2.0 * random.uniform(0.02, 0.08) * np.sqrt(far * reduced)
    places = np.array([0.0, random.uniform(0.3, 0.7) * length, length])
    loads = np.array([0.0, random.uniform(0.3, 0.7), 1.0]) * m2 * random.uniform(0.3, 1.5) if payloads else None
    gains: list[list[list[float]]] = []
    for x in places:
        gains.append([])
        for load in [0.0] if loads is None else loads:
            loaded = m2 + float(load)
            mode = np.sqrt(1.0 / (a + b * x) * (m1 + loaded) / (m1 * loaded))
            if law == "linear_adrc":
                rate = mode * random.uniform(0.03, 0.055)
                gains[-1].append([m1 + loaded, rate, rate * random.uniform(3.0, 5.0)])
            else:
                rate = mode * random.uniform(0.25, 0.4)
                gains[-1].append([0.35 * rate, (m1 + loaded) * rate, 4.0 / rate])
    lag = 2.0 * np.pi * random.uniform(600.0, 1500.0)
    b1, b2 = (random.uniform(1.0, 4.0) * m for m in (m1, m2))
    row = np.array(gains) if payloads else np.array(gains)[:, 0]
    return Drawn(float(m1), float(m2), float(c), float(b1), float(b2), a, b, float(lag), places, row, law, loads)


def law_of(axis: Drawn, gains: np.ndarray) -> Law:
    """Return the law of the library with three gains."""
    first, second, third = map(float, gains)
    if axis.law == "linear_adrc":
        return LinearADRC(mass=first, omega_c=second, omega_o=third, delay_samples=1, encoder="motor", position="load")
    return CascadePPI(Kv=first, Kp=second, Tn=third)


def loop_of(axis: Drawn, x: float, load: float = 0.0) -> Loop:
    """Return the loop of the library at a position with a payload."""
    plant = TwoMass(
        mass_motor=axis.m1,
        mass_load=axis.m2 + load,
        stiffness=float(axis.stiffness(x)),
        damping=axis.c,
        viscous_motor=axis.b1,
        viscous_load=axis.b2,
    )
    actuator = Actuator(dead_time=T, current_loop=axis.lag / (2.0 * np.pi))
    body = Axis(plant=plant, actuator=actuator, encoder_motor=Encoder(), encoder_load=Encoder())
    places: list[SchedulePlace] = []
    for place, gains in zip(axis.places.tolist(), axis.gains, strict=True):
        if axis.loads is None:
            places.append(SchedulePlace(position=place, law=law_of(axis, gains)))
            continue
        loads = zip(axis.loads.tolist(), gains, strict=True)
        loaded = tuple(ScheduleLoad(payload=load, law=law_of(axis, row)) for load, row in loads)
        places.append(SchedulePlace(position=place, loads=loaded))
    schedule = GainSchedule(payload=None if axis.loads is None else load, places=tuple(places))
    return Loop(control=Control(law=schedule), axis=body, sample_time=T)


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
    if axis.law == "linear_adrc":
        return frozen_adrc(A, b, Kv, Kp, Tn)
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

    return growth, peak(sensitivity)


def peak(sensitivity: Callable[[np.ndarray], np.ndarray]) -> float:
    """Return the largest |S| on 2000 lines, refined three times."""
    lines = np.geomspace(0.05, 0.5 / T, 2000)
    best = 0.0
    for _ in range(3):
        size = sensitivity(lines)
        k = int(np.argmax(size))
        best = float(size[k])
        lines = np.linspace(lines[max(k - 1, 0)], lines[min(k + 1, lines.size - 1)], 41)
    return best


def observer_gains(mass: Any, omega_o: Any) -> tuple[Any, Any, Any]:
    """Return the three gains of the observer of linear ADRC, from its three poles at e^(-omega_o T)."""
    beta = np.exp(-omega_o * T)
    return 1.0 - beta**3, 1.5 * (1.0 - beta) ** 2 * (1.0 + beta) / T, mass * (1.0 - beta) ** 3 / T**2


def frozen_adrc(A: np.ndarray, b: np.ndarray, mass: float, omega_c: float, omega_o: float) -> tuple[float, float]:
    """Return the largest |z| and Ms of linear ADRC, its observer at the motor, the load fed back.

    States: the five of the axis, the command that acts next, the last two commands of the law, and its estimates of
    position, velocity and disturbance.  An added force acts on the axis and is not told to the law.
    """
    l1, l2, l3 = observer_gains(mass, omega_o)
    n = 11
    rows = np.eye(n)
    f = (rows[7] + rows[10]) / mass
    ahead, fast = rows[8] + T * rows[9] + 0.5 * T**2 * f, rows[9] + T * f
    missed = rows[0] - ahead
    x, v, d = ahead + l1 * missed, fast + l2 * missed, rows[10] + l3 * missed
    u = -mass * (2.0 * omega_c * v + omega_c**2 * rows[1]) - d
    whole = np.zeros((n, n))
    whole[:5, :5], whole[:5, 5] = A, b
    whole[5], whole[6], whole[7], whole[8], whole[9], whole[10] = u, u, rows[6], x, v, d
    poles, modes = np.linalg.eig(whole)
    growth = float(np.max(np.abs(poles)))
    residues = (u @ modes) * np.linalg.solve(modes, rows[5])

    def sensitivity(lines: np.ndarray) -> np.ndarray:
        z = np.exp(2j * np.pi * lines * T)
        if lines.size > 100:
            # by its modes to find the peak; its value is that of the equations themselves
            return np.abs(1.0 + np.sum(residues / (z[:, None] - poles), axis=1))
        inner = np.linalg.solve(z[:, None, None] * np.eye(n) - whole, np.broadcast_to(rows[5][:, None], (z.size, n, 1)))
        return np.abs(1.0 + (u @ inner)[:, 0])

    return growth, peak(sensitivity)


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
    before, estimate, speed = np.zeros(count), q[0].copy(), np.zeros(count)
    largest = np.zeros(count)

    def rate(q: np.ndarray, k: np.ndarray, u: np.ndarray) -> np.ndarray:
        spring = k * (q[1] - q[0]) + axis.c * (q[3] - q[2])
        a1, a2 = (spring - axis.b1 * q[2] + q[4]) / axis.m1, (-spring - axis.b2 * q[3]) / axis.m2
        return np.stack([q[2], q[3], a1, a2, axis.lag * (u - q[4])])

    h = T / SUBSTEPS
    size = np.zeros(count)
    for now, then in pairwise(x):
        Kv, Kp, Tn = axis.gains_at(now)
        if axis.law == "linear_adrc":
            # Kv, Kp, Tn are mass, omega_c and omega_o; `integral` is the disturbance
            l1, l2, l3 = observer_gains(Kv, Tn)
            f = (before + integral) / Kv
            ahead, fast = estimate + T * speed + 0.5 * T**2 * f, speed + T * f
            missed = q[0] - ahead
            estimate, speed, integral = ahead + l1 * missed, fast + l2 * missed, integral + l3 * missed
            new = -Kv * (2.0 * Kp * speed + Kp**2 * q[1]) - integral
        else:
            e = -Kv * q[1] - (q[0] - last) / T
            integral = integral + Kp * T / Tn * e
            new = Kp * e + integral
        acting, before, command, last = command, command, new, q[0].copy()
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
    control, known = loop_of(axis, first).control, np.linspace(first, last, 5).tolist()
    if axis.loads is None:
        travel = Travel.of({x: loop_of(axis, x) for x in known})
    else:
        load = float(random.uniform(axis.loads[0], axis.loads[-1]))
        pairs = {(x, m): loop_of(axis, x, m) for x in known for m in axis.loads.tolist()}
        travel, axis = Travel.of(pairs).with_payload(load), axis.carrying(load)
    coarse = [frozen(axis, float(x)) for x in np.linspace(first, last, 25)]
    if max(growth for growth, _ in coarse) >= 1.0:
        return {"verdict": "unstable on the grid"}
    bound = 1.01 * max(peak for _, peak in coarse)
    begun = time.process_time()
    proof = prove_along_travel(travel, control, sensitivity_peak=bound)
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
    parser.add_argument("--law", choices=("cascade_ppi", "linear_adrc"), default="cascade_ppi")
    parser.add_argument("--payloads", action="store_true")
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args()
    random = np.random.default_rng(asked.seed)
    rows: list[dict[str, Any]] = []
    for i in range(asked.axes):
        axis = drawn(random, asked.law, payloads=asked.payloads)
        each = asked.frozen // asked.axes, asked.moving // asked.axes, asked.samples
        rows.append({"axis": i, **judged(axis, random, *each)})
        print(json.dumps(rows[-1]), flush=True)
    wrong = [row for row in rows if contradicted(row)]
    print(f"{len(rows)} axes, {sum(row['verdict'] == 'proven' for row in rows)} proven, {len(wrong)} contradicted")
    if asked.out:
        asked.out.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

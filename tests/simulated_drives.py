"""Drives and motions drawn at random and simulated in virtual time, many side by side; nothing of feeddrive is used.

Each drive has a mass with stiction, viscous friction and weight, a servo in one of the three modes, delays, encoder,
and a manner of reporting: what is missing, filtered, late, rounded or noisy.  A run gives what a master would send and
receive in each cycle, and what is true of the axis.  `due_by_force` says when any axis must have moved.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

SUBSTEPS = 8  # of the servo in a bus cycle
CYCLE_TIMES = (125e-6, 250e-6, 500e-6, 1e-3, 2e-3, 4e-3)
COUNTS = (10e-9, 100e-9, 1e-6, 5e-6, 20e-6)
MOTIONS = ("moves", "creep", "slow sine", "small steps", "excited", "rest")
NONE, EXACT, ZERO, OLD = range(4)  # 0x60F4: absent, right, always 0, a cycle old
FILTERED, RAW = 1, 2  # 0x606C


@dataclass
class Run:
    """Rows are cycles, columns drives; lengths in m. `velocity` and `following_error` are NaN where not reported."""

    mode: str
    cycle_time: np.ndarray
    count: np.ndarray
    lag: np.ndarray  # as the drive file states it
    mass: np.ndarray  # largest, as stated
    breakaway: np.ndarray  # largest friction and weight, as stated
    target: np.ndarray
    target_velocity: np.ndarray
    target_force: np.ndarray
    position: np.ndarray = field(default_factory=lambda: np.empty(0))
    velocity: np.ndarray = field(default_factory=lambda: np.empty(0))
    force: np.ndarray = field(default_factory=lambda: np.empty(0))
    following_error: np.ndarray = field(default_factory=lambda: np.empty(0))
    stuck: np.ndarray = field(default_factory=lambda: np.empty(0))  # true standstill
    drawn: dict[str, np.ndarray] = field(default_factory=dict)


def quintic(s: np.ndarray) -> np.ndarray:
    s = np.clip(s, 0.0, 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s * s)


def motion(rng: np.random.Generator, kind: str, cycles: int, T: float, count: float) -> np.ndarray:
    """A set position over so many cycles, m, from rest to rest."""
    k = np.arange(cycles, dtype=float)
    whole = cycles * T
    if kind == "rest":
        return np.zeros(cycles)
    if kind == "moves":  # there and back, with a dwell at the reversal or none
        begin, turn = rng.uniform(0.02, 0.2), rng.uniform(0.4, 0.6)
        dwell = rng.choice([0.0, 0.1])
        speed = rng.choice([1.0, 10 ** rng.uniform(-3.0, -0.3)])
        distance = min(speed * whole * (turn - begin) / 2.0, 5.0 * (whole * (turn - begin)) ** 2 / 6.0)  # 5 m/s2
        s = k / cycles
        return distance * (quintic((s - begin) / (turn - begin)) - quintic((s - turn - dwell) / (turn - begin)))
    if kind == "creep":  # counts a cycle, or a fraction of one, one way and then the other
        rate = 10 ** rng.uniform(-2.5, 1.0) * count
        turned = np.where(k < rng.uniform(0.5, 0.9) * cycles, 1.0, -1.0)
        turned[: cycles // 20] = 0.0
        swell = np.convolve(turned, np.ones(20) / 20.0, mode="same")
        return rate * np.cumsum(swell)
    if kind == "slow sine":
        periods = rng.integers(1, 4)
        return 10 ** rng.uniform(0.0, 3.0) * count * (1.0 - np.cos(2.0 * np.pi * periods * k / cycles))
    if kind == "small steps":  # with a dwell after each
        many = rng.integers(3, 9)
        sizes = 10 ** rng.uniform(0.0, 2.5, many) * count * rng.choice([-1.0, 1.0], many)
        s = k / cycles * (many + 1) - 1.0
        return sum(size * quintic((s - i) / 0.3) for i, size in enumerate(sizes))  # type: ignore[return-value]
    slow = 10 ** rng.uniform(-1.0, 2.0) * count * cycles / 100.0 * quintic(k / cycles)
    window = np.sin(np.pi * k / cycles) ** 2
    return slow + 10 ** rng.uniform(0.0, 2.0) * count * window * np.sin(0.1 * k + 2e-4 * k * k)


def pushes(rng: np.random.Generator, cycles: int, T: float, breakaway: float) -> np.ndarray:
    """A force over so many cycles, N: steps, ramps, chirps and noise around what the axis needs to move."""
    k = np.arange(cycles, dtype=float)
    peak = breakaway * 10 ** rng.uniform(-0.3, 1.0)
    kind = rng.integers(5)
    window = np.sin(np.pi * k / cycles) ** 2
    if kind == 0:
        return peak * np.sign(np.sin(2.0 * np.pi * rng.integers(1, 40) * k / cycles)) * (k > 20)
    if kind == 1:
        return peak * np.sin(2.0 * np.pi * rng.integers(1, 8) * k / cycles)
    if kind == 2:
        return peak * window * np.sin(2.0 * np.pi * (0.005 * k + 0.1 * k * k / cycles))
    if kind == 3:
        return peak * window
    return peak * window * np.repeat(rng.standard_normal(cycles // 3 + 1), 3)[:cycles]


def drawn(seed: int, drives: int, mode: str, cycles: int = 1500) -> Run:
    """So many healthy drives, and their runs."""
    rng = np.random.default_rng([seed, {"csp": 1, "csv": 2, "cst": 3}[mode]])
    T, c = rng.choice(CYCLE_TIMES, drives), rng.choice(COUNTS, drives)
    mass = 10 ** rng.uniform(0.7, 2.7, drives)
    current = rng.uniform(0.05e-3, 1e-3, drives)  # s, current loop
    coulomb = mass * 10 ** rng.uniform(-2.0, 0.3, drives) * (rng.random(drives) < 0.85)
    stiction = coulomb * rng.uniform(1.0, 1.6, drives)
    weight = mass * rng.uniform(-9.81, 9.81, drives) * (rng.random(drives) < 0.3)
    least = stiction + np.abs(weight)
    known = rng.choice([0.0, 0.0, 1.0, 3.0], drives).astype(int)  # cycles of delay that the drive file states
    refresh = rng.choice([1, 1, 1, 1, 2, 3, 5], drives)  # cycles after which the drive reports new values
    refresh = np.where(refresh * T <= 2e-3, refresh, 1)
    most = np.minimum((7e-3 - refresh * T) / T, 6.0)
    unknown = np.floor(rng.random(drives) * rng.choice([0.0, 1.0], drives) * (most + 1.0)).astype(int)  # and not
    if mode == "cst":
        margin = rng.choice([1.0, 1.3], drives)
        least = np.maximum(least, 0.1 * mass)
    else:
        margin = np.ones(drives)
    speed = rng.choice([NONE, FILTERED, FILTERED, FILTERED, RAW], drives)
    speed = np.where((speed == RAW) & (c > 100e-9), FILTERED, speed)  # of coarse counts it would be of no use
    bandwidth = np.minimum(2.0 * np.pi * 10 ** rng.uniform(0.9, 1.9, drives), 0.25 / (T / SUBSTEPS + current))
    Kv = bandwidth / rng.uniform(4.0, 12.0, drives)
    reset = rng.uniform(4.0, 20.0, drives) / bandwidth
    forward = rng.choice([0.0, 0.5, 1.0], drives)
    target, velocity, force = (np.zeros((cycles, drives)) for _ in range(3))
    for i in range(drives):
        if mode == "cst":
            force[:, i] = pushes(rng, cycles, T[i], margin[i] * least[i])
        else:
            path = motion(rng, str(rng.choice(MOTIONS)), cycles, T[i], c[i])
            target[:, i] = np.round(path / c[i]) * c[i]
            velocity[:, i] = np.round(np.gradient(path, T[i]) / c[i]) * c[i]
    return simulated(
        Run(mode, T, c, known + 1, margin * mass, margin * least, target, velocity, force),
        rng,
        mass=mass,
        coulomb=coulomb,
        stiction=stiction,
        weight=weight,
        viscous=mass * rng.uniform(0.0, 5.0, drives),
        current=current,
        Kp=mass * bandwidth,
        Kv=Kv,
        reset=reset,
        forward=forward,
        delay=known + unknown,
        refresh=refresh,
        told=rng.integers(0, 4, drives),
        speed=speed,
        filter=rng.uniform(0.0, 3e-3, drives) * rng.choice([0.0, 0.3, 1.0], drives),
        factor=rng.choice([1.0, 0.97, 1.03], drives),
        noise=rng.choice([0.0, 0.0, 0.5, 2.0], drives),
        shaking=rng.choice([0.0, 2.0], drives),
        unknown=unknown,
    )


def simulated(run: Run, rng: np.random.Generator, **d: np.ndarray) -> Run:
    """The run of all drives: in a cycle the drive reports what was when the cycle began, then obeys its target."""
    cycles, drives = run.target.shape
    T, c = run.cycle_time, run.count
    h = T / SUBSTEPS
    m, most = d["mass"], 20.0 * d["mass"] + 3.0 * (d["stiction"] + np.abs(d["weight"]))
    step = most / 3000.0  # N of a thousandth of the rated force, a third of the peak
    x, v = np.zeros(drives), np.zeros(drives)
    F = -d["weight"] if run.mode != "cst" else np.zeros(drives)
    gathered = -d["weight"] / d["Kp"] if run.mode != "cst" else np.zeros(drives)  # m/s, the integral
    slow = np.where(d["noise"] > 0.0, 4.0 * h, 1e-9)  # a velocity from noisy readings is filtered
    current, smooth = 1.0 - np.exp(-h / d["current"]), 1.0 - np.exp(-h / np.maximum(d["filter"], slow))
    filtered, raw, fine = np.zeros(drives), np.zeros(drives), c / 64.0
    seen: dict[str, Any] = {name: np.zeros((cycles, drives)) for name in ("x", "v", "F", "e", "stuck")}
    before, noise = np.zeros(drives), np.zeros(drives)
    for k in range(cycles):
        seen["x"][k] = np.round(x / c + noise)
        seen["v"][k] = np.where(d["speed"] == RAW, raw, np.round(d["factor"] * filtered / c) * c)
        seen["F"][k] = np.round(F / step + rng.uniform(-1.0, 1.0, drives) * d["shaking"])
        seen["e"][k] = np.where(d["told"] == OLD, run.target[max(0, k - 2)], before)
        seen["stuck"][k] = v == 0.0
        goal = run.target[k]
        for i in range(SUBSTEPS):
            if run.mode == "cst":
                wanted = run.target_force[k]
            else:
                aim = run.target_velocity[k]
                if run.mode == "csp":
                    at = before + (goal - before) * (i + 1) / SUBSTEPS
                    aim = d["forward"] * (goal - before) / T + d["Kv"] * (at - np.round(x / fine) * fine)
                gathered += np.where(np.abs(F) < 0.99 * most, h / d["reset"] * (aim - v), 0.0)
                wanted = d["Kp"] * (aim - v + gathered)
            F = F + current * (np.clip(wanted, -most, most) - F)
            free = v + h / m * (F + d["weight"] - d["viscous"] * v)
            level = d["coulomb"] + (d["stiction"] - d["coulomb"]) * np.exp(-((v / 1e-3) ** 2))
            after = np.sign(free) * np.maximum(np.abs(free) - h / m * level, 0.0)
            old = np.round(x / c)
            x = x + 0.5 * h * (v + after)
            v = after
            raw = (np.round(x / c) - old) * c / h
            noise, noise_before = d["noise"] * rng.uniform(-1.0, 1.0, drives), noise
            filtered = filtered + smooth * (v + (noise - noise_before) * c / h - filtered)  # of the same encoder
        before = goal
    rows = np.arange(cycles)[:, None] - d["delay"] - np.arange(cycles)[:, None] % d["refresh"]
    column = np.arange(drives)[None, :]
    late = {name: np.where(rows >= 0, values[np.maximum(rows, 0), column], values[0]) for name, values in seen.items()}
    run.position, run.force, run.stuck = late["x"] * c, late["F"] * step, late["stuck"]
    run.velocity = np.where(d["speed"] == NONE, np.nan, late["v"])
    own = late["e"] - run.position
    run.following_error = np.where(d["told"] == NONE, np.nan, np.where(d["told"] == ZERO, 0.0, own))
    run.drawn = d
    return run


def due_by_force(force: np.ndarray, mass: float, breakaway: float, within: float, T: float, at: int) -> int | None:
    """No speed at the beginning of a push of one sign leaves the axis within so much; a force may act 10 ms late."""
    late = math.ceil(max(0.01, 5.0 * T) / T - 1e-9)
    windows = np.lib.stride_tricks.sliding_window_view(force, late + 1)  # the last one of row k is of cycle k + late
    least, most = windows.min(axis=1), windows.max(axis=1)
    net = np.zeros(force.size)
    net[late:] = (
        np.where(least > breakaway, least - breakaway, np.where(most < -breakaway, most + breakaway, 0.0)) / mass
    )
    k = at + 1
    while k < force.size:
        end = k + int(np.argmax(np.append(np.sign(net[k:]), 2.0) != np.sign(net[k])))
        if net[k] != 0.0:
            speed = np.concatenate([[0.0], np.cumsum(np.abs(net[k:end])) * T])
            way = np.cumsum((speed[:-1] + speed[1:]) / 2.0 * T)
            time = T * np.arange(1, end - k + 1)
            slowest, fastest = np.maximum.accumulate(-(within + way) / time), (within - way) / time
            if np.any(np.minimum.accumulate(fastest) < slowest):
                return k + int(np.argmax(np.minimum.accumulate(fastest) < slowest))
        k = end
    return None

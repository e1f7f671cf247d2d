"""Dry friction on a circle, event by event: the truth of quadrant glitches.

An axis slides by the matrix exponential of its closed loop, with the circle as two more states; where its velocity
crosses 0 it stands while the drive holds |u| <= F_s, and the integral goes on; it breaks away at |u| = F_s.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq, minimize_scalar

from machining.circles import KP, KV, MASS, TN, VISCOUS


def root(f: Callable[[float], float], low: float, high: float) -> float:
    """Where a function is 0 between two places."""
    found: Any = brentq(f, low, high, xtol=1e-16)
    return float(found)


class Course(NamedTuple):
    """Times, states (x, v, integral, cos, sin) at them, and (begin, end) of each stand."""

    time: np.ndarray
    state: np.ndarray
    stands: list[tuple[float, float]]
    linear: dict[float, np.ndarray]

    def position(self, t: float) -> float:
        """At any time, from the last state before it."""
        i = int(np.searchsorted(self.time, t, side="right")) - 1
        held = any(begin <= self.time[i] + 1e-15 < end for begin, end in self.stands)
        A = self.linear[0.0 if held else float(np.sign(self.state[i, 1] or self.state[i + 1, 1]))]
        return float((expm(A * (t - self.time[i])) @ self.state[i])[0])


def course(
    radius: float, feed: float, *, coulomb: float, breakaway: float, share: float, phase: float, turns: float, h: float
) -> Course:
    """The motion of an axis whose set position is R cos(ωt + phase), in steps of h (s)."""
    w = feed / radius
    # u = Kp (e + z/Tn), e = Kv (R c - x) - share R w s - v, c = cos, s = sin of the angle; one more state is 1
    e = np.array([-KV, -1.0, 0.0, KV * radius, -share * radius * w, 0.0])
    u = KP * (e + np.array([0.0, 0.0, 1.0 / TN, 0.0, 0.0, 0.0]))
    linear: dict[float, np.ndarray] = {}
    for way in (-1.0, 0.0, 1.0):
        A = np.zeros((6, 6))
        A[3, 4], A[4, 3], A[2] = -w, w, e
        if way:
            A[0, 1] = 1.0
            A[1] = u / MASS
            A[1, 1] -= VISCOUS / MASS
            A[1, 5] = -way * coulomb / MASS
        linear[way] = A
    steps = {way: expm(A * h) for way, A in linear.items()}

    def moved(state: np.ndarray, way: float, t: float) -> np.ndarray:
        return expm(linear[way] * t) @ state

    at = np.array([radius * np.cos(phase), -radius * w * np.sin(phase), 0.0, np.cos(phase), np.sin(phase), 1.0])
    way = float(np.sign(at[1])) if abs(at[1]) > 1e-12 else 0.0
    t, end = 0.0, 2.0 * np.pi * turns / w
    times, states, stands = [t], [at], []
    begun = t
    while t < end:
        after = steps[way] @ at
        if way == 0.0:
            if abs(u @ after) <= breakaway:
                t, at = t + h, after
            else:
                level = float(np.sign(u @ after)) * breakaway
                part = root(lambda s, at=at, level=level: float(u @ moved(at, 0.0, s)) - level, 0.0, h)
                t, at = t + part, moved(at, 0.0, part)
                stands.append((begun, t))
                way = float(np.sign(level))
        elif after[1] * way > 0.0:
            t, at = t + h, after
        else:
            low = 1e-9 if at[1] * way <= 0.0 else 0.0
            part = root(lambda s, at=at, way=way: float(moved(at, way, s)[1]), low, h)
            t, at = t + part, moved(at, way, part)
            at[1] = 0.0
            begun = t
            way = 0.0 if abs(u @ at) <= breakaway else float(np.sign(u @ at))
        times.append(t)
        states.append(at)
    return Course(np.array(times), np.array(states), stands, linear)


class Glitch(NamedTuple):
    """Begin of the stand after the reversal and its length, s; peak outward, m, and when after the reversal, s."""

    begin: float
    length: float
    peak: float
    peak_time: float


def glitch(radius: float, feed: float, *, coulomb: float, breakaway: float, share: float = 1.0) -> Glitch:
    """At the third passage of the place where x reverses, with the same friction on y."""
    w = feed / radius
    x, y = (
        course(radius, feed, coulomb=coulomb, breakaway=breakaway, share=share, phase=phase, turns=1.9, h=1e-3)
        for phase in (0.0, -0.5 * np.pi)
    )
    reversal = 3.0 * np.pi / w

    def outward(t: float) -> float:
        return float(np.hypot(x.position(t), y.position(t))) - radius

    grid = reversal + np.linspace(0.0, 0.15, 61)  # s: the peaks come within 0.1 s
    top = int(np.argmax([outward(t) for t in grid]))
    step = grid[1] - grid[0]
    found: Any = minimize_scalar(
        lambda t: -outward(t), bounds=(grid[top] - step, grid[top] + step), method="bounded", options={"xatol": 1e-9}
    )
    begin, end = min(x.stands, key=lambda each: abs(each[0] - reversal))
    return Glitch(begin - reversal, end - begin, -float(found.fun), float(found.x) - reversal)

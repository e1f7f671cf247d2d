"""Dry friction along a planned motion: the force that the drive must overcome, known before the part runs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from feeddrive.blocks.families import Friction
from feeddrive.language import tree
from feeddrive.loop.stepped import stepped

RAMP = 0.02
"""The time over which the friction force changes after a stop and before a start, s."""
KEPT = 0.5
"""The share of the friction force that is kept in a rest.

A body at rest is held by any force up to breakaway.  To keep the whole force winds the integrator of the loop up in the
rest, which costs at the next start where the friction is less than modeled; to keep none costs where it is more.
"""
# a plan at rest has a velocity of exactly 0 or, after smoothing, of rounding: far below any feed
_STILL = 1e-9  # m/s
# `steady` of a set-valued law is 0 at exactly 0: the level towards standstill is its limit from either side
_CREEP = 1e-12  # m/s


def direction_along(velocity: np.ndarray, sample_time: float) -> np.ndarray:
    """Return the mean direction s of the dry friction over each sample interval, -1 to 1, shape (n,).

        moving           s = sgn v; an interval with a reversal has the mean of both directions, by the zero crossing of
                         v, which is taken as linear
        a rest           from a stop in direction a to a start in direction b: s falls from a to a/2 within 20 ms, and
                         changes to b in the last 20 ms, complete at the first moving sample
        a shorter rest   than 20 ms: s changes from a to b over its whole length
        first and last   motion: from 0 and to 0 in the same way, in the rest before the motion and after it

    All changes follow 10 t³ - 15 t⁴ + 6 t⁵.

    velocity     planned velocity at kT, m/s, shape (n,)
    sample_time  T, s
    """
    v = np.where(np.abs(velocity) > _STILL, velocity, 0.0)
    n = v.size
    sign = np.sign(v)
    moving = np.flatnonzero(sign)
    if moving.size == 0:
        return np.zeros(n)
    s = sign.copy()
    # the interval in which the motion reverses without a rest
    ahead = np.append(v[1:], v[-1])
    turns = v * ahead < 0.0
    before = np.abs(v[turns]) / (np.abs(v[turns]) + np.abs(ahead[turns]))
    s[turns] = sign[turns] * (2.0 * before - 1.0)
    ramp = max(1, round(RAMP / sample_time))
    # rests: runs of samples with velocity 0, between the moving samples `last` and `after` (-1 and n: none)
    edges = np.concatenate([[-1], moving, [n]])
    for place in np.flatnonzero(np.diff(edges) > 1):
        last, after = int(edges[place]), int(edges[place + 1])
        begin = 0.0 if last < 0 else sign[last]
        end = 0.0 if after >= n else sign[after]
        if after - last == 2 and last >= 0 and after < n:
            # a zero crossing that falls on a sample is no rest: the interval already moves the new way
            s[last + 1] = end
            continue
        rest = after - last - 1
        k = np.arange(1, rest + 1)
        width = min(ramp, rest)
        if after >= n:
            # the end of the program: no start follows
            s[last + 1 :] = begin * (1.0 - smooth_step(k / width))
            continue
        starting = smooth_step((k - (rest - width)) / width)
        held = begin if rest < ramp else begin * (1.0 - (1.0 - KEPT) * smooth_step(k / width))
        s[last + 1 : after] = held * (1.0 - starting) + end * starting
    return s


def smooth_step(t: np.ndarray) -> np.ndarray:
    """Return a step from 0 at t <= 0 to 1 at t >= 1 without a jump of its first two derivatives."""
    t = np.clip(t, 0.0, 1.0)
    return t**3 * (10.0 - 15.0 * t + 6.0 * t**2)


def around_motion(velocity: np.ndarray, sample_time: float, width: float) -> np.ndarray:
    """Return 1 where a planned motion moves, and 0 in its rests: it fades within `width` s on both sides of a motion.

    velocity     planned velocity at kT, m/s, shape (n,)
    sample_time  T, s
    """
    n = velocity.size
    moving = np.flatnonzero(np.abs(velocity) > _STILL)
    if moving.size == 0:
        return np.zeros(n)
    k = np.arange(n)
    after = np.searchsorted(moving, k)
    ahead = np.abs(moving[np.minimum(after, moving.size - 1)] - k)
    behind = np.abs(k - moving[np.maximum(after - 1, 0)])
    return 1.0 - smooth_step(np.minimum(ahead, behind) * sample_time / width)


def remembers(friction: Friction) -> bool:
    """Return True if the friction depends on the motion before, as in presliding (LuGre, Maxwell slip)."""
    return any(True for _ in tree.leaves(friction.start()))


def friction_along(friction: Friction, velocity: np.ndarray, sample_time: float) -> np.ndarray:
    """Return the force (N) that overcomes the dry friction in each sample interval of a motion, shape (n,).

        f(k) = s(k) level(v(k + 1/2)),   level(v) = |steady(v) - linear · v|
        f(k) = -(F(k) + F(k + 1)) / 2    of a friction with a memory

    A friction with a memory (`remembers`) is followed along the plan by its own step, whose body moves as planned: F is
    its force at kT.  After a reversal it needs the presliding distance, at rest it stays, and after the last motion it
    falls to 0 within 20 ms.

    velocity     planned velocity at kT, m/s, shape (n,)
    sample_time  T, s

    The viscous part is left out: the linear model of the loop holds it.
    """
    middle = 0.5 * (velocity + np.append(velocity[1:], velocity[-1]))
    if remembers(friction):
        return _followed(friction, velocity, middle, sample_time)
    s = direction_along(velocity, sample_time)
    speed = np.maximum(np.abs(middle), _CREEP)
    force = np.zeros(s.size)
    for sign in (1.0, -1.0):
        there = s * sign > 0.0
        along: Any = sign * speed[there]
        force[there] = s[there] * np.abs(np.asarray(friction.steady(along)) - friction.linear() * along)
    return force


def _followed(friction: Friction, velocity: np.ndarray, middle: np.ndarray, T: float) -> np.ndarray:
    """Return the force against the dry friction of a body that moves as planned, whatever acts on it.

    The mean velocity of an interval moves the presliding on by exactly the planned way.
    """

    def step(block: Any, state: Any, signals: Mapping[str, Any], _: Any, h: Any) -> tuple[Any, dict[str, Any]]:
        # a mobility of 0: no force moves the body off its plan
        state, force, _stuck = block.contact(h, state, signals["velocity"], signals["middle"], 0.0)
        return state, {"force": force}

    ends = -stepped(friction, lambda plain: plain.start(), step, {"velocity": velocity, "middle": middle}, T)["force"]
    force = 0.5 * (np.append(0.0, ends[:-1]) + ends)
    moving = np.flatnonzero(np.abs(velocity) > _STILL)
    last = int(moving[-1]) + 1 if moving.size else 0
    force[last:] *= 1.0 - smooth_step((np.arange(force.size - last) + 1.0) * T / RAMP)
    return force

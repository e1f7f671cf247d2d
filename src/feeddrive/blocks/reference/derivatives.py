"""Functions of time with their first four derivatives, and rules for combining them."""

from typing import TypeAlias

import numpy as np

from feeddrive.blocks.signals import Setpoint

# value and derivatives of order 1 to 4, each of shape (n,)
Derivatives: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def product(f: Derivatives, g: Derivatives) -> Derivatives:
    """Return f·g by the Leibniz rule."""
    return (
        f[0] * g[0],
        f[1] * g[0] + f[0] * g[1],
        f[2] * g[0] + 2.0 * f[1] * g[1] + f[0] * g[2],
        f[3] * g[0] + 3.0 * (f[2] * g[1] + f[1] * g[2]) + f[0] * g[3],
        f[4] * g[0] + 4.0 * (f[3] * g[1] + f[1] * g[3]) + 6.0 * f[2] * g[2] + f[0] * g[4],
    )


def sine_of(angle: Derivatives) -> Derivatives:
    """Return the sine of a time-varying angle (rad), by the chain rule (Faà di Bruno)."""
    sine, cosine = np.sin(angle[0]), np.cos(angle[0])
    _, w1, w2, w3, w4 = angle
    square = w1 * w1
    return (
        sine,
        cosine * w1,
        cosine * w2 - sine * square,
        cosine * (w3 - square * w1) - 3.0 * sine * w1 * w2,
        cosine * (w4 - 6.0 * square * w2) + sine * (square * square - 3.0 * w2 * w2 - 4.0 * w1 * w3),
    )


def stretched(f: Derivatives, height: float, time: float) -> Derivatives:
    """Return height · f(t / time) and its derivatives with respect to t, from f and its derivatives."""
    rate = 1.0 / time
    return (
        height * f[0],
        height * rate * f[1],
        height * rate**2 * f[2],
        height * rate**3 * f[3],
        height * rate**4 * f[4],
    )


def resting(t: np.ndarray, duration: float, motion: Derivatives, first: float, last: float) -> Setpoint:
    """Return setpoints of `motion` in 0 <= t < duration, at rest at `first` (m) before and at `last` (m) after it."""
    before, after = t < 0.0, t >= duration
    # the ends as given: those of the motion are rounded
    position = np.where(before, first, np.where(after, last, motion[0]))
    higher = (np.where(before | after, 0.0, derivative) for derivative in motion[1:])
    return Setpoint(position, *higher)  # type: ignore[arg-type]

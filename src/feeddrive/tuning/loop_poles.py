"""Poles of a closed loop that its gains move, and the gains with which one of them lies near a place."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from feeddrive.loop.linearize import StateSpace
from feeddrive.tuning.traced_control import READINGS

_MOVES = 0.2  # |d ln s/d ln p| from which a pole counts as moved by the gains
_SLOWEST, _FASTEST = 1e-4, 0.9  # of half the sample rate, of the poles that can be moved
_SINGLE = 1e-6  # |wᴴ v| of unit eigenvectors below which a pole is not alone, and has no slope
_STEP = 0.25  # of a logarithm: largest change of a gain in one step
_STEPS, _HALVINGS = 6, 3
_NEAR = 1e-3  # of |s|: near enough
_WEAK = 0.05  # of the strongest direction of the gains: weaker ones are not used

Model = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Gains -> [A B; c d] of the control, n + 1 rows and n + 2 columns, and its slopes to them."""


class LoopPole(NamedTuple):
    """A pole of the closed loop in 1/s, and its slopes to the logarithms of the gains."""

    s: complex
    slope: np.ndarray


def closed(axis: StateSpace, matrix: np.ndarray, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Φ of the loop of an axis, from `cut` to both readings, and a control [A B; c d]; and its slopes.

    x ← A_x x + b (d C x + c ξ),    ξ ← A ξ + B C x
    """
    n, many = matrix.shape[0] - 1, axis.A.shape[0]
    b = axis.B[:, axis.inputs.index("cut")]
    C = axis.C[[axis.outputs.index(reading) for reading in READINGS]]
    force = np.concatenate([matrix[n, n:] @ C, matrix[n, :n]])
    loop = np.zeros((many + n, many + n))
    loop[:many] = b[:, None] * force
    loop[:many, :many] += axis.A
    loop[many:] = np.concatenate([matrix[:n, n:] @ C, matrix[:n, :n]], axis=1)
    changes = np.zeros((many + n, many + n, slopes.shape[2]))
    readings = np.einsum("irp,rj->ijp", slopes[:, n:], C)
    along = np.concatenate([readings, slopes[:, :n]], axis=1)
    changes[:many] = b[:, None, None] * along[n]
    changes[many:] = along[:n]
    return loop, changes


def loop_poles(axis: StateSpace, model: Model, gains: np.ndarray) -> list[LoopPole]:
    """Poles s = ln z/T of the closed loop in the upper half plane that its gains > 0 move, slowest first.

        d z/d p = wᴴ (∂Φ/∂p) v / (wᴴ v),   v and w the right and the left eigenvector

    Left out are those that are not single or faster than 0.9 of half the sample rate, and those that no gain moves by
    a fifth of its own change.
    """
    from scipy.linalg import eig, matrix_balance

    T = axis.sample_time
    loop, changes = closed(axis, *model(gains))
    loop, (scale, _) = matrix_balance(loop, permute=False, separate=True)  # states are in m and in N
    changes = changes * (scale / scale[:, None])[:, :, None]
    solved: Any = eig(loop, left=True, right=True)
    z, left, right = solved
    nyquist, poles = np.pi / T, list[LoopPole]()
    for k in range(z.size):
        if z[k].imag < 0.0 or (z[k].imag == 0.0 and z[k].real <= 0.0):
            continue
        s, alone = complex(np.log(z[k]) / T), np.vdot(left[:, k], right[:, k])
        if not (_SLOWEST * nyquist < abs(s) < _FASTEST * nyquist) or abs(alone) < _SINGLE:
            continue
        change = np.einsum("i,ijp,j->p", np.conj(left[:, k]), changes, right[:, k]) / alone
        slope = change * gains / (z[k] * T)
        if np.max(np.abs(slope), initial=0.0) > _MOVES * abs(s):
            poles.append(LoopPole(s, slope))
    return sorted(poles, key=lambda pole: abs(pole.s))


def nearest_pole(poles: list[LoopPole], s: complex) -> LoopPole | None:
    """The pole nearest to a place; None if there is none."""
    return min(poles, key=lambda pole: abs(pole.s - s), default=None)


def pole_moved(
    axis: StateSpace, model: Model, gains: np.ndarray, s: complex, wanted: complex
) -> tuple[np.ndarray, complex]:
    """Gains with which the pole that is at s (1/s) lies as near to a wanted place as they take it, and where it is.

    Newton's method over the logarithms of the gains, with the smallest change of them all: no step changes one by more
    than a quarter of itself, and none is taken that does not bring the pole nearer.  A real pole moves along the real
    axis until it meets another one.
    """
    wanted = complex(wanted.real, max(wanted.imag, 0.0))
    pole = nearest_pole(loop_poles(axis, model, gains), s)
    if pole is None:
        return gains, s
    for _ in range(_STEPS):
        apart = wanted - pole.s
        if abs(apart) <= _NEAR * abs(wanted):
            break
        rows, right = [np.real(pole.slope)], [apart.real]
        if pole.s.imag > 0.0:
            rows, right = [*rows, np.imag(pole.slope)], [*right, apart.imag]
        change = np.linalg.pinv(np.array(rows), rcond=_WEAK) @ np.array(right)
        change *= min(1.0, _STEP / max(float(np.max(np.abs(change))), 1e-300))
        for _ in range(_HALVINGS):
            tried = gains * np.exp(change)
            candidate = nearest_pole(loop_poles(axis, model, tried), pole.s + complex(pole.slope @ change))
            if candidate is not None and abs(wanted - candidate.s) < abs(apart):
                gains, pole = tried, candidate
                break
            change = 0.5 * change
        else:
            break
    return gains, pole.s

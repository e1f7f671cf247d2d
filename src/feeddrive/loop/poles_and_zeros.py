"""Poles and zeros of sampled models: zeros by a matrix pencil, and both as natural frequency and damping."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

_FAR = 1e6  # |z| from which a zero is one at infinity that rounding made finite


class Natural(NamedTuple):
    """Natural frequency in Hz and damping ratio of each pole, of shape (n,); infinite and 1 for z = 0."""

    frequency: np.ndarray
    damping: np.ndarray


def continuous(z: np.ndarray, sample_time: float) -> np.ndarray:
    """Return s = ln(z)/T in 1/s: the continuous pole that a sampled one stands for; -∞ for z = 0."""
    z = np.asarray(z, complex)
    with np.errstate(divide="ignore"):
        return np.where(z == 0.0, complex(-np.inf), np.log(np.where(z == 0.0, 1.0, z)) / sample_time)


def natural(z: np.ndarray, sample_time: float) -> Natural:
    """Return |s|/2π and -Re s/|s| of s = ln(z)/T; damping 1 for z = 0 and for an integrator, z = 1, which has no
    frequency.
    """
    s = continuous(z, sample_time)
    size = np.abs(s)
    there = (size > 0.0) & np.isfinite(size)
    return Natural(size / (2.0 * np.pi), np.where(there, -np.real(s) / np.where(there, size, 1.0), 1.0))


def zeros(A: np.ndarray, b: np.ndarray, c: np.ndarray, d: float) -> np.ndarray:
    """Return the finite zeros z of c (z - A)⁻¹ b + d, b and c of shape (n,): where [A - z, b; c, d] loses its rank.

    Generalized eigenvalues by the QZ algorithm; those beyond 10⁶ count as infinite.
    Source: Emami-Naeini & Van Dooren 1982 (the pencil).
    """
    from scipy.linalg import eigvals

    n = A.shape[0]
    scale = max(float(np.linalg.norm(A)), 1.0)  # zeros do not depend on the sizes of input and output
    wide, tall = (scale / max(float(np.linalg.norm(vector)), 1e-300) for vector in (b, c))
    pencil = np.block([[A, wide * b[:, None]], [tall * c[None, :], np.array([[wide * tall * d]])]])
    mass = np.zeros((n + 1, n + 1))
    mass[:n, :n] = np.eye(n)
    alpha, beta = np.asarray(eigvals(pencil, mass, homogeneous_eigvals=True))
    finite = np.abs(alpha) < _FAR * np.abs(beta)
    return alpha[finite] / beta[finite]

"""A small convex quadratic program, exact: least distance by non-negative least squares."""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls


def least_quadratic(H: np.ndarray, g: np.ndarray, A: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """x and multipliers of  min ½ xᵀHx + gᵀx  subject to  A x >= b,  H positive definite; None if there is no such x.

    Source: Lawson & Hanson 1974, chapter 23 (least distance programming).
    """
    # a few tunables, hundreds of bounds: products with the small inverse do not wake the threads of the BLAS, as a
    # triangular solve does
    inverse = np.linalg.inv(np.linalg.cholesky(H))
    shift, G = inverse @ g, A @ inverse.T
    h = b + G @ shift
    scale = np.maximum(np.sqrt(np.sum(G * G, axis=1)), 1e-300)  # rows of one length: all bounds are seen alike
    E = np.vstack([(G / scale[:, None]).T, h / scale])
    f = np.zeros(E.shape[0])
    f[-1] = 1.0
    try:
        u, _ = nnls(E, f, maxiter=30 * E.shape[1])
    except RuntimeError:
        return None
    r = E @ u - f
    if not -r[-1] > 1e-12:
        return None
    y = -r[:-1] / r[-1]
    return inverse.T @ (y - shift), u / (-r[-1] * scale)

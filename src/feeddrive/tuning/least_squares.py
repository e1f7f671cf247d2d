"""Bounded least squares, with standard errors that remain valid for autocorrelated residuals."""

from __future__ import annotations

import numpy as np
from scipy.optimize import lsq_linear


def solve(
    seen: np.ndarray, error: np.ndarray, mu: float, least: np.ndarray, most: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The step Δ within bounds that minimizes |Ψ Δ - e|² + mu |S Δ|², and which bounds hold it; S scales columns to 1.

    Ψ has shape (samples, columns).  Without an active bound it is (ΨᵀΨ + mu S²)⁻¹ Ψᵀ e.
    """
    if not seen.shape[1]:
        return np.zeros(0), np.zeros(0, dtype=bool)
    sizes = np.linalg.norm(seen, axis=0)
    rows = np.vstack([seen / sizes, np.sqrt(mu) * np.eye(sizes.size)])
    right = np.concatenate([error, np.zeros(sizes.size)])
    step = np.linalg.lstsq(rows, right, rcond=None)[0]
    low, high = least * sizes, most * sizes
    if np.all(step >= low) and np.all(step <= high):
        return step / sizes, np.zeros(sizes.size, dtype=bool)
    # the triangle of the rows has the same minimum and a few rows only
    q, r = np.linalg.qr(rows)
    bounded = lsq_linear(r, q.T @ right, bounds=(low, high), method="bvls", tol=1e-14)
    return bounded.x / sizes, bounded.active_mask != 0


def standard_errors(seen: np.ndarray, residual: np.ndarray, lags: int) -> np.ndarray:
    """Of each parameter, from the residual and its autocorrelation.

        cov = A⁻¹ [Σ_f S(f) Ψ(f) Ψ(f)ᴴ] A⁻¹,   A = ΨᵀΨ,   S: spectrum of the residual

    S is that of its autocorrelation up to `lags`, in a Bartlett window, which keeps S >= 0.  With a white residual this
    is the usual σ² A⁻¹.  The residual's own mean is not taken out, since no column is a constant.
    Source: Newey & West 1987, for regressors that are not random.
    """
    n, count = seen.shape
    if not count:
        return np.zeros(0)
    size = 1 << (2 * n - 1).bit_length()
    lags = max(1, min(lags, n // 4))
    spectrum = np.abs(np.fft.rfft(residual, size)) ** 2
    correlation = np.fft.irfft(spectrum, size)[: lags + 1] / max(n - count, 1)
    correlation *= 1.0 - np.arange(lags + 1) / (lags + 1.0)
    even = np.zeros(size)
    even[: lags + 1], even[size - lags :] = correlation, correlation[1:][::-1]
    colour = np.maximum(np.fft.rfft(even).real, 0.0)
    sizes = np.linalg.norm(seen, axis=0)
    lines = np.fft.rfft(seen / sizes, size, axis=0)
    weight = np.full(colour.size, 2.0)
    weight[0] = weight[-1] = 1.0
    inner = ((weight * colour)[:, None] * lines).T @ lines.conj()
    inverse = np.linalg.inv((seen / sizes).T @ (seen / sizes))
    covariance = inverse @ inner.real @ inverse / size
    return np.sqrt(np.maximum(np.diag(covariance), 0.0)) / sizes

"""Standard errors of least squares, where the residual is neither white nor of one size."""

from __future__ import annotations

import numpy as np
from scipy.signal import oaconvolve

MOST_ROWS = 5000  # scores whose covariance is summed lag by lag


def ols_covariance(columns: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """s² (XᵀX)⁻¹ with s² = rᵀr / (n - p): right only for a white residual of constant size."""
    n, p = columns.shape
    return float(residual @ residual) / max(n - p, 1) * _inverse(columns)


def robust_covariance(columns: np.ndarray, residual: np.ndarray, lags: int | None = None) -> np.ndarray:
    """n / (n - p) (XᵀX)⁻¹ S (XᵀX)⁻¹, with S the long-run covariance of the scores z(k) = x(k) r(k):

        S = Γ(0) + Σ w(j) (Γ(j) + Γ(j)ᵀ),   Γ(j) = Σ z(k) z(k-j)ᵀ,   w(j) = 1 - j / (lags + 1)

    columns   shape (n, p), or (signals, n, p) for several signals with errors that hang together at each time
    residual  shape (n,), or (signals, n)

    It asks nothing of the residual but that its memory ends.  `lags` follows from that memory if it is not given:
    1.1447 (α n)^⅓ of Andrews 1991, taken twice, with α from the first autocorrelation of each score.  S itself is
    uncertain the more lags it has; the factor of `widening` makes 1.96 errors a 95 % interval all the same.
    Sources: Newey & West 1987; Andrews 1991, eqs. (6.2) and (6.4); Kiefer & Vogelsang 2005.
    """
    stacked = columns if columns.ndim == 3 else columns[None]
    remains = residual if residual.ndim == 2 else residual[None]
    n, p = stacked.shape[1:]
    return n / max(n - p, 1) * _long_run(_scores(stacked, remains), lags)


def _scores(columns: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """In the metric of the estimates: what each sample adds to each parameter, shape (rows, p)."""
    inverse = _inverse(columns.reshape(-1, columns.shape[-1]))
    return _in_blocks(np.einsum("snp,sn->np", columns, residual) @ inverse)


def _long_run(scores: np.ndarray, lags: int | None = None) -> np.ndarray:
    """Their covariance over all lags that count."""
    rows = scores.shape[0]
    lags = max(0, min(memory(scores) if lags is None else lags, rows // 4))
    # all lags at once: the scores against themselves, spread by the window
    window = 1.0 - np.abs(np.arange(-lags, lags + 1)) / (lags + 1.0)
    total = scores.T @ oaconvolve(scores, window[:, None], mode="full", axes=0)[lags : lags + rows]
    total = 0.5 * (total + total.T)
    return widening(lags / rows) ** 2 * total


def _in_blocks(scores: np.ndarray) -> np.ndarray:
    """Sums of as many rows in a row as leave at most `MOST_ROWS`: the covariance over long lags stays what it is."""
    size = -(-scores.shape[0] // MOST_ROWS)
    return scores if size == 1 else np.add.reduceat(scores, np.arange(0, scores.shape[0], size), axis=0)


def widening(share: float) -> float:
    """How much wider than 1.96 errors a 95 % interval is, if `share` of all lags was used with a Bartlett window.

    (1.9600 + 2.9694 b + 0.4160 b² - 0.5324 b³) / 1.96, b = share.  Source: Kiefer & Vogelsang 2005, table 1.
    """
    return (1.9600 + 2.9694 * share + 0.4160 * share**2 - 0.5324 * share**3) / 1.96


def memory(scores: np.ndarray) -> int:
    """Lags after which the scores, shape (n, p), have forgotten: Andrews' rule for the Bartlett window, twice."""
    n = scores.shape[0]
    alpha, weight = 0.0, 0.0
    for column in scores.T:
        size = float(column @ column)
        if size <= 0.0 or n < 3:
            continue
        rho = min(0.97, max(-0.97, float(column[1:] @ column[:-1]) / size))
        spread = size * (1.0 - rho * rho)
        alpha += 4.0 * rho**2 * spread**2 / ((1.0 - rho) ** 6 * (1.0 + rho) ** 2)
        weight += spread**2 / (1.0 - rho) ** 4
    return int(np.ceil(2.0 * 1.1447 * (alpha / weight * n) ** (1.0 / 3.0))) if weight > 0.0 else 0


def errors(covariance: np.ndarray) -> np.ndarray:
    """Standard errors: roots of the diagonal."""
    return np.sqrt(np.maximum(np.diag(covariance), 0.0))


def _inverse(columns: np.ndarray) -> np.ndarray:
    sizes = np.linalg.norm(columns, axis=0)
    scaled = columns / sizes
    return np.linalg.inv(scaled.T @ scaled) / np.outer(sizes, sizes)

"""Sums over all time of a sampled linear model, by doubling: no integration, no step size."""

from __future__ import annotations

import numpy as np

from feeddrive.language.errors import UnstableError

_DOUBLINGS = 64  # 2^64 samples: more than any loop is run for


def summed(A: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """P = Σ (Aᵀ)^k Q A^k over k = 0, 1, ...: the solution of P = Aᵀ P A + Q.

    P ← P + Aᵀ P A, A ← A A doubles the number of terms in each step.
    Raises UnstableError if the sum does not end.  Source: Smith 1968 (squaring for the Lyapunov equation).
    """
    total, power = Q.copy(), A.copy()
    with np.errstate(all="ignore"):
        for _ in range(_DOUBLINGS):
            more = power.T @ total @ power
            total = total + more
            if not np.all(np.isfinite(total)):
                break
            if np.max(np.abs(more), initial=0.0) <= 1e-15 * np.max(np.abs(total), initial=0.0):
                return total
            power = power @ power
    raise UnstableError("the sum over all time does not end: the loop is not stable, or at its edge")

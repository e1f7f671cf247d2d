"""How well a model explains rows, against how many parameters it took, if their residual has a memory."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

_MEMORIES = np.linspace(0.0, 0.98, 99)


def information(residual: np.ndarray, parameters: int, stretches: Sequence[slice] | None = None) -> float:
    """The Bayesian information criterion of a residual that follows r(k) = rho r(k-1) + e(k); less is better.

        -2 log L = n log(Σ e² / n) - m log(1 - rho²)
        criterion = -2 log L + k log n · n / (n - k - 1),   k = parameters + 2

    with the rho >= 0 that is most likely; rho and the size of e are the two parameters more.  The last factor corrects
    for few rows, where the plain criterion takes a parameter too many in one case of five.  Without that memory, as
    in the usual criterion, neighboring rows would count as independent, and a model would be allowed to follow what
    they share.  `stretches` are rows in a row, m of them (default: all); rho does not reach from one to the next.
    Sources: Schwarz 1978; McQuarrie 1999 for few rows; the likelihood of a first-order process, Box & Jenkins 1970.
    """
    parts = _parts(residual, stretches)
    best = min(_likelihood(parts, rho) for rho in _MEMORIES)
    n, k = residual.size, parameters + 2
    return float(best + k * np.log(n) * n / max(n - k - 1, 1))


def likely_memory(residual: np.ndarray, stretches: Sequence[slice] | None = None) -> float:
    """The rho >= 0 that is most likely."""
    parts = _parts(residual, stretches)
    return float(min(_MEMORIES, key=lambda rho: _likelihood(parts, rho)))


def _parts(residual: np.ndarray, stretches: Sequence[slice] | None) -> list[np.ndarray]:
    parts = [residual] if stretches is None else [residual[part] for part in stretches]
    return [part for part in parts if part.size]


def _likelihood(parts: list[np.ndarray], rho: float) -> float:
    """-2 log L but for a constant."""
    n = sum(part.size for part in parts)
    first = (1.0 - rho * rho) * sum(float(part[0]) ** 2 for part in parts)
    rest = sum(float(np.sum((part[1:] - rho * part[:-1]) ** 2)) for part in parts)
    # a residual of nothing but rounding is as good as one of 0
    return n * float(np.log(max((first + rest) / n, 1e-300))) - len(parts) * float(np.log(1.0 - rho * rho))

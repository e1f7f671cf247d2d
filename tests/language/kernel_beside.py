"""Kernels of another file."""

from __future__ import annotations

from feeddrive.language.kernels.kernel import kernel


@kernel
def thirds(z: float) -> float:
    return 1.0 / z


@kernel
def halves(x: float) -> float:
    return thirds(x) * 0.5

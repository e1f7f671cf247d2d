"""Responses of a rigid motion and modes in parallel, with their slopes in each parameter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from feeddrive.identification.response.refine import Unknown
from feeddrive.identification.response.vector_fitting import common_poles


@dataclass(frozen=True, eq=False)
class ModalResponse:
    """x/f = e^(-s·dead_time) · s^order · [ free/(s (s + corner)) + Σ (residue + skew s/ω)/(s² + 2ζωs + ω²) + rest ]

    for each output, with common ω, ζ, corner and dead time; the parameters are stacked as
    [frequency ..., damping ..., corner, dead_time, then for each output: free, residue ..., skew ..., rest].
    A `skew` of zero is damping in proportion, all of a mode swinging in step.
    """

    s: tuple[np.ndarray, ...]
    order: int
    modes: int
    rigid: bool
    rest: bool
    skewed: bool

    @property
    def common(self) -> int:
        """How many parameters all outputs share."""
        return 2 * self.modes + 2

    @property
    def own(self) -> int:
        """How many each output has for itself."""
        return 2 * self.modes + 2

    def shapes(self, s: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """What stands beside free, residues and rest in the sum, without delay; shape (lines, 2 modes + 2)."""
        k = self.modes
        omega, ratio, corner = 2.0 * np.pi * parameters[:k], parameters[k : 2 * k], parameters[2 * k]
        factor = s**self.order
        free = factor / (s * (s + corner)) if self.rigid else np.zeros(s.size, complex)
        poles = (factor / ((s * s)[:, None] + 2.0 * np.outer(s, ratio * omega) + omega**2).T).T
        turned = poles * (s[:, None] / omega if self.skewed else 0.0)
        return np.column_stack([free, poles, turned, factor if self.rest else np.zeros(s.size, complex)])

    def __call__(self, parameters: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Response and slopes of each output."""
        k, n = self.modes, self.common
        omega, ratio, corner, late = (
            2.0 * np.pi * parameters[:k], parameters[k : 2 * k], parameters[2 * k], parameters[2 * k + 1],
        )  # fmt: skip
        found: list[tuple[np.ndarray, np.ndarray]] = []
        for i, s in enumerate(self.s):
            place = n + i * self.own
            weights = parameters[place : place + self.own]
            delay = np.exp(-s * late)
            shapes = self.shapes(s, parameters) * delay[:, None]
            response = shapes @ weights
            slopes = np.zeros((s.size, parameters.size), complex)
            slopes[:, place : place + self.own] = shapes
            turned = shapes[:, k + 1 : 2 * k + 1] * weights[k + 1 : 2 * k + 1]
            inner = shapes[:, 1 : k + 1] * weights[1 : k + 1] + turned
            denominator = (s * s)[:, None] + 2.0 * np.outer(s, ratio * omega) + omega**2
            slopes[:, :k] = -inner * 2.0 * np.pi * (2.0 * np.outer(s, ratio) + 2.0 * omega) / denominator
            slopes[:, :k] -= turned / parameters[:k]
            slopes[:, k : 2 * k] = -inner * 2.0 * np.outer(s, omega) / denominator
            slopes[:, 2 * k] = -weights[0] * shapes[:, 0] / (s + corner)
            slopes[:, 2 * k + 1] = -s * response
            found.append((response, slopes))
        return found


class Poles:
    """Resonances that several responses share, found once for each number and weight that is asked."""

    def __init__(self, model: ModalResponse, responses: Sequence[np.ndarray], dead_time: float | None) -> None:
        late = dead_time or 0.0
        self.s = model.s
        # twice differentiated, a rigid motion is a constant
        self.rising = [g * np.exp(s * late) * s ** (2 - model.order) for s, g in zip(model.s, responses, strict=True)]
        self.found: dict[tuple[int, float], tuple[np.ndarray, np.ndarray]] = {}

    def most(self, wanted: int, pairs: int, power: float) -> np.ndarray | None:
        """Of `pairs` resonances the `wanted` ones that stand out most, by frequency; None if there are fewer."""
        if wanted == 0:
            return np.zeros(0, complex)
        if (pairs, power) not in self.found:
            self.found[pairs, power] = common_poles(self.s, self.rising, pairs, 1, power=power)
        poles, heights = self.found[pairs, power]
        alive = np.flatnonzero(-np.real(poles) < 0.5 * np.abs(poles))
        if alive.size < wanted:
            return None
        return poles[np.sort(alive[np.argsort(-heights[alive])][:wanted])]


def begun(
    model: ModalResponse, responses: Sequence[np.ndarray], chosen: np.ndarray, dead_time: float | None
) -> tuple[float, np.ndarray]:
    """Parameters to start from, with the poles of the modes: weights by least squares of relative errors.

    The sum of their squares comes first.  Dead time and corner are those of a coarse search.
    """
    late = [0.0] if dead_time is None else [dead_time]
    highest = max(float(abs(s[-1])) for s in model.s)
    if dead_time is None:
        late += [turn / highest for turn in (0.3, 0.8, 1.5, 2.5)]
    lowest = min(float(abs(s[0])) for s in model.s)
    shared = np.concatenate(
        [np.abs(chosen) / (2.0 * np.pi), np.clip(-np.real(chosen) / np.maximum(np.abs(chosen), 1e-12), 2e-3, 0.5)]
    )
    best: tuple[float, np.ndarray] | None = None
    for delay in late:
        for corner in (0.02 * lowest, 0.5 * lowest, 5.0 * lowest):
            parameters = np.concatenate([shared, [corner, delay]])
            error, parts = 0.0, [parameters]
            for s, g in zip(model.s, responses, strict=True):
                matrix = model.shapes(s, parameters) * (np.exp(-s * delay) / g)[:, None]
                stacked = np.vstack([np.real(matrix), np.imag(matrix)])
                scale = np.linalg.norm(stacked, axis=0)
                scale[scale == 0.0] = np.inf
                wanted = np.concatenate([np.ones(s.size), np.zeros(s.size)])
                weights = np.linalg.lstsq(stacked / scale, wanted, rcond=None)[0] / scale
                error += float(np.sum((stacked @ weights - wanted) ** 2))
                parts.append(weights)
            if best is None or error < best[0]:
                best = error, np.concatenate(parts)
    assert best is not None
    return best


def unknowns(model: ModalResponse, start: np.ndarray, outputs: Sequence[str], unit: str) -> list[Unknown]:
    """The parameters of the model by name; `unit` is that of a response in position, as m/N."""
    k = model.modes
    number = [str(i + 1) for i in range(k)]
    found = [Unknown(f"frequency_{i}", "Hz", start[j], positive=True) for j, i in enumerate(number)]
    found += [
        Unknown(f"damping_ratio_{i}", "", start[k + j], positive=True, least=1e-5, most=2.0)
        for j, i in enumerate(number)
    ]
    lowest = min(float(abs(s[0])) for s in model.s)
    highest = max(float(abs(s[-1])) for s in model.s)
    corner = min(max(start[2 * k], 1e-3 * lowest), highest)
    found.append(Unknown("corner", "1/s", corner, positive=True, least=1e-4 * lowest, most=highest))
    found.append(Unknown("dead_time", "s", start[2 * k + 1], scale=0.1 / highest))
    for i, name in enumerate(outputs):
        weights = start[model.common + i * model.own : model.common + (i + 1) * model.own]
        of = f"_{name}" if name else ""
        top = float(np.max(np.abs(weights[: k + 1]), initial=0.0)) or 1.0
        found.append(Unknown(f"free{of}", f"{unit}/s2", weights[0], scale=abs(weights[0]) or top))
        found += [
            Unknown(
                f"residue_{number[j]}{of}", f"{unit}/s2", weights[1 + j], scale=max(abs(weights[1 + j]), 1e-3 * top)
            )
            for j in range(k)
        ]
        found += [
            Unknown(
                f"skew_{number[j]}{of}", f"{unit}/s2", weights[1 + k + j], scale=max(abs(weights[1 + j]), 1e-3 * top)
            )
            for j in range(k)
        ]
        found.append(Unknown(f"rest{of}", unit, weights[-1], scale=max(abs(weights[-1]), top / highest**2)))
    return found

"""What a site says of a control: the goal, with its slope to the tunables, and every bound."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from feeddrive.tuning.shaping.answer import Answer, answer, encircles
from feeddrive.tuning.shaping.below import Below
from feeddrive.tuning.shaping.bounds import Bound, bounds_of, notches_stay_notches
from feeddrive.tuning.shaping.control_response import ControlResponse, Response
from feeddrive.tuning.shaping.limits import Limits
from feeddrive.tuning.shaping.site import Site

GOALS = ("rope-snap", "stiffness", "least-stiffness", "bandwidth")
_REJECTED = float(np.sqrt(0.5))  # |S| up to here counts as bandwidth
_BESIDE = 0.02  # of the logarithm of the rope-snap error, beside that of another goal


class Judged(NamedTuple):
    """The goal of each site (less is better), its slope, and the bounds; `stable` by encirclement."""

    stable: bool
    goal: np.ndarray  # (sites,)
    slope: np.ndarray  # (sites, tunables)
    curvature: np.ndarray  # (tunables, tunables)
    bounds: tuple[Bound, ...]


class Criteria:
    """Judges a control at all sites, for one goal within limits."""

    def __init__(
        self, sites: tuple[Site, ...], control: ControlResponse, goal: str, limits: Limits, band: tuple[float, float]
    ) -> None:
        self.sites, self.control, self.goal, self.limits, self.band = sites, control, goal, limits, band
        self._known: dict[bytes, Judged] = {}
        self._below = [Below(site) for site in sites]
        every = [part.frequency for pair in zip(self._below, sites, strict=True) for part in pair]
        self._lines, places = np.unique(np.concatenate(every), return_inverse=True)
        self._places = np.split(places, np.cumsum([part.size for part in every])[:-1])

    @property
    def count(self) -> int:
        """Points that were computed."""
        return len(self._known)

    def answers(self, x: np.ndarray) -> list[Answer]:
        """The closed loops at logarithms of the tunables; slopes are to the logarithms."""
        values = np.exp(x)
        whole = self.control.at(values, self._lines)
        parts = [
            Response(whole.value[:, place], whole.slope[:, place] * values, whole.unstable) for place in self._places
        ]
        return [
            answer(site, fast, below.recovery(slow))
            for site, below, slow, fast in zip(self.sites, self._below, parts[::2], parts[1::2], strict=True)
        ]

    def __call__(self, x: np.ndarray) -> Judged:
        """The figures at a point; each is computed once."""
        key = np.asarray(x, float).tobytes()
        if key not in self._known:
            self._known[key] = self.judged(x, self.answers(x))
        return self._known[key]

    def judged(self, x: np.ndarray, answers: list[Answer]) -> Judged:
        """Goal and bounds of closed loops."""
        stable = not any(encircles(each) for each in answers)
        goals = [self._goal(each) for each in answers]
        bounds: list[Bound] = []
        for i, each in enumerate(answers):
            bounds += bounds_of(i, each, self.limits)
        bounds += notches_stay_notches(self.control.control, self.control.tunables, x)
        worst = int(np.argmax([value for value, _, _ in goals]))
        return Judged(
            stable,
            np.array([value for value, _, _ in goals]),
            np.array([slope for _, slope, _ in goals]),
            goals[worst][2],
            tuple(bounds),
        )

    def _goal(self, each: Answer) -> tuple[float, np.ndarray, np.ndarray]:
        """Logarithm of what is to be small, its slope, and the Gauss-Newton part of its curvature.

        A goal that does not see how long a law takes to come back would give away its position gain for nothing; a
        fiftieth of the rope-snap error stands beside it.
        """
        f = each.site.frequency
        inside = (f >= self.band[0]) & (f <= self.band[1])
        lines, y, dy = each.recovery()
        snap = _mean_square(y, dy, snap_weights(lines, each.site.sample_time))
        match self.goal:
            case "rope-snap":
                return snap
            case "stiffness":
                own = _mean_square(each.compliance, each.compliance_slope, _log_weights(f, inside))
            case "least-stiffness":
                size = np.where(inside, np.abs(each.compliance), 0.0)
                k = int(np.argmax(size))
                slope = (each.compliance_slope[k] / each.compliance[k]).real
                own = float(np.log(size[k])), slope, np.outer(slope, slope)
            case _:
                own = _bandwidth(each)
        return own[0] + _BESIDE * snap[0], own[1] + _BESIDE * snap[1], own[2] + _BESIDE * snap[2]


def snap_weights(frequency: np.ndarray, T: float) -> np.ndarray:
    """w of ISE = Σ w |y|²: the trapezoidal rule of ∫ |y|² T²/(2 - 2 cos ωT) dω/π, with the part below the first line.

    Below it the integrand is that of the line, since with integral action y falls as ω.
    """
    kernel = (T / (2.0 * np.sin(np.pi * frequency * T))) ** 2
    width = np.zeros(frequency.size)
    step = 0.5 * np.diff(frequency)
    width[:-1] += step
    width[1:] += step
    width[0] += frequency[0]
    return 2.0 * kernel * width


def _log_weights(frequency: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Weights of the mean of |y|² over ln f inside of the band."""
    x = np.log(frequency)
    width = np.zeros(x.size)
    step = 0.5 * np.diff(x)
    width[:-1] += step
    width[1:] += step
    width = np.where(inside, width, 0.0)
    return width / np.sum(width)


def _mean_square(y: np.ndarray, dy: np.ndarray, weight: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """½ ln Σ w |y|²."""
    total = float(np.sum(weight * np.abs(y) ** 2))
    slope = np.real(dy.T @ (weight * np.conj(y))) / total
    root = np.sqrt(weight)[:, None] * dy
    curvature = np.real(root.conj().T @ root) / total
    return 0.5 * float(np.log(total)), slope, curvature - np.outer(slope, slope)


def _bandwidth(each: Answer) -> tuple[float, np.ndarray, np.ndarray]:
    """-ln of the frequency at which |S| first rises to -3 dB."""
    level = -np.log(np.abs(1.0 + each.gain)) - np.log(_REJECTED)
    rises = np.flatnonzero((level[:-1] < 0.0) & (level[1:] >= 0.0))
    x = np.log(each.site.frequency)
    tunables = each.gain_slope.shape[1]
    if not rises.size:
        return float(-x[0]), np.zeros(tunables), np.zeros((tunables, tunables))
    i = int(rises[0])
    part = level[i] / (level[i] - level[i + 1])
    tilt = (level[i + 1] - level[i]) / (x[i + 1] - x[i])
    pushed = -(each.gain_slope / (1.0 + each.gain)[:, None]).real
    moved = (1.0 - part) * pushed[i] + part * pushed[i + 1]
    slope = moved / tilt
    return float(-(x[i] + part * (x[i + 1] - x[i]))), slope, np.outer(slope, slope)

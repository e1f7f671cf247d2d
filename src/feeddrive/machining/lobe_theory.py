"""Two published methods beside the exact one: the zero-order lobes, a quick picture, and semi-discretization."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from feeddrive.language.errors import ParameterError
from feeddrive.loop.frequency_response import FRF
from feeddrive.machining.regeneration import Regeneration, regeneration
from feeddrive.machining.tool_point import ToolPoint

_LINES = 4000  # of a modeled response over its band


@dataclass(frozen=True)
class ZeroOrder:
    """Zero-order limits: axial depth in m and chatter frequency in Hz by spindle speed in rpm; NaN where none is found.

    `least` is the depth below which no speed chatters by this theory, m.
    """

    spindle_speed: np.ndarray
    depth: np.ndarray
    frequency: np.ndarray
    least: float


def zero_order(tool: ToolPoint | FRF | Any, cutter: Any, spindle_speeds: Any = ()) -> ZeroOrder:
    """The zero-order solution of Altintas and Budak: the directional matrix replaced by its mean over a turn.

        λ an eigenvalue of G(jω) mean(H),  L = -1/λ,  a = |L|²/(2 Re L) if Re L > 0,  ωτ = -arg(1 - L/a) + 2πk

    tool   a `ToolPoint`, or a response from a force on the tool to its position in m/N, an `FRF` along the feed, or a
           pair of them for feed and normal

    It is exact where H is constant and no bound anywhere else: in narrow down milling it is up to twice too high, and
    it knows no flip lobes.  From a measured response it needs no model; its lines are joined by straight ones.
    Raises ParameterError for a response that is not in m/N.
    Source: Altintas & Budak 1995, Analytical Prediction of Stability Lobes in Milling, CIRP Annals 44.
    """
    cut = regeneration(cutter)
    frequency, response, directions = _lines(tool)
    mean = cut.mean()[np.ix_(directions, directions)]
    eigenvalues = np.linalg.eigvals(response @ mean)
    speeds = np.atleast_1d(np.asarray(spindle_speeds, float))
    periods = np.array([cut.period(float(speed)) for speed in speeds])
    depth, chatter = np.full(speeds.size, np.nan), np.full(speeds.size, np.nan)
    least = np.inf
    for branch in _tracked(eigenvalues).T:
        with np.errstate(all="ignore"):  # an eigenvalue may be 0: modes that all lie in one direction
            L = -1.0 / branch
            a = np.where(L.real > 0.0, np.abs(L) ** 2 / (2.0 * L.real), np.nan)
            turn = -np.angle(1.0 - L / a)
        if np.all(np.isnan(a)):
            continue
        least = min(least, float(np.nanmin(a)))
        for i, period in enumerate(periods):
            # whole waves between two teeth: where ωτ - turn crosses a multiple of 2π
            phase = (2.0 * np.pi * frequency * period - turn) / (2.0 * np.pi)
            phase = phase - np.round(phase)
            there = (phase[:-1] * phase[1:] <= 0.0) & (np.abs(phase[:-1] - phase[1:]) < 0.5)
            places = np.flatnonzero(there & np.isfinite(phase[:-1]) & np.isfinite(phase[1:]))
            for k in places:
                share = phase[k] / (phase[k] - phase[k + 1]) if phase[k] != phase[k + 1] else 0.0
                found = float(a[k] + share * (a[k + 1] - a[k]))
                if not found >= depth[i]:
                    depth[i], chatter[i] = found, float(frequency[k] + share * (frequency[k + 1] - frequency[k]))
    return ZeroOrder(speeds, depth, chatter, least)


def _lines(tool: Any) -> tuple[np.ndarray, np.ndarray, list[int]]:
    """Frequencies in Hz, responses (n, q, q) in m/N and their directions."""
    if isinstance(tool, ToolPoint):
        poles = np.linalg.eigvals(tool.A)
        sizes = np.abs(poles) / (2.0 * np.pi)
        lines = [np.geomspace(0.02 * sizes.min(), 4.0 * sizes.max(), _LINES)]
        for pole in poles[poles.imag > 0.0]:
            width, middle = abs(pole.real) / (2.0 * np.pi), pole.imag / (2.0 * np.pi)
            lines.append(middle + width * np.sinh(np.linspace(-7.0, 7.0, _LINES)))
        frequency = np.unique(np.concatenate(lines))
        frequency = frequency[frequency > 0.0]
        kept = tool.directions()
        return frequency, tool.response(frequency)[np.ix_(range(frequency.size), kept, kept)], kept
    given: list[Any] = [tool] if isinstance(tool, FRF) else list(tool)
    if not given or len(given) > 2 or not all(isinstance(each, FRF) for each in given):
        raise ParameterError("zero_order takes a ToolPoint, an FRF along the feed, or a pair of FRFs: feed and normal")
    for each in given:
        if each.unit not in ("", "m/N"):
            raise ParameterError(
                f"the response from {each.input} to {each.output} is in {each.unit}: the lobes need m/N, the position "
                f"of the tool over a force on it"
            )
        if not np.array_equal(each.frequency, given[0].frequency):
            raise ParameterError("the responses along feed and normal must have the same frequencies")
    response = np.zeros((given[0].frequency.size, len(given), len(given)), complex)
    for i, each in enumerate(given):
        response[:, i, i] = each.response
    return given[0].frequency, response, list(range(len(given)))


def _tracked(eigenvalues: np.ndarray) -> np.ndarray:
    """The eigenvalues in the order in which they run on from line to line."""
    if eigenvalues.shape[1] == 1:
        return eigenvalues
    found = eigenvalues.copy()
    for k in range(1, len(found)):
        straight = np.abs(found[k] - found[k - 1]).sum()
        if np.abs(found[k, ::-1] - found[k - 1]).sum() < straight:
            found[k] = found[k, ::-1]
    return found


def semi_discretisation(
    tool: ToolPoint, cutter: Any, speed: float, depth: float, *, steps: int = 40, order: int = 1
) -> np.ndarray:
    """All multipliers µ of a cut by semi-discretization, the largest first; speed in rpm, axial depth in m.

    The tooth period is cut into `steps`; over each the coefficients are their means, and the delayed value is the mean
    of its ends (order 0) or a straight line (order 1).  The error falls with steps²; the usual 40 are 6 % off in |µ|
    where a mode swings 5 times between two teeth, and ω τ / steps <= 0.05 is needed for 2e-4.
    Straight edges only, as in the source; without process damping.  Raises ParameterError for others.
    Source: Insperger & Stépán 2002 and 2004, Semi-discretization method for delayed systems.
    """
    cut: Regeneration = regeneration(cutter)
    if cut.lag or cut.process_damping or order not in (0, 1) or steps < 2:
        raise ParameterError(
            "semi_discretisation is for straight edges without process damping, order 0 or 1 and 2 steps or more: take "
            "stability_lobes for all else"
        )
    from scipy.linalg import expm  # not for commands that only read

    A, B, C = tool.moving()
    d, q = A.shape[0], B.shape[1]
    h = cut.period(speed) / steps
    width = d + steps * q
    state, past = np.eye(d, width), [np.eye(q, width, d + k * q) for k in range(steps)]  # the newest first
    directions = np.ix_(tool.directions(), tool.directions())
    for i in range(steps):
        H = cut.averaged(i / steps * cut.pitch, (i + 1) / steps * cut.pitch)[directions]
        # y' = (A - a B H C) y + a B H (u0 + (u1 - u0) t/h): the exponential with the line as two more rows of states
        whole = np.zeros((d + 2 * q, d + 2 * q))
        whole[:d, :d], whole[:d, d : d + q] = A - depth * B @ H @ C, depth * B @ H
        whole[d : d + q, d + q :] = np.eye(q) / h
        moved = expm(whole * h)
        level, ramp = moved[:d, d : d + q], moved[:d, d + q :]
        first, second = (level - ramp, ramp) if order else (0.5 * level, 0.5 * level)
        past.insert(0, C @ state)
        state = moved[:d, :d] @ state + first @ past[steps] + second @ past[steps - 1]
        past.pop()
    found = np.linalg.eigvals(np.vstack([state, *past]))
    return found[np.argsort(-np.abs(found), kind="stable")]

"""What a site says of a control: the goal and every bound, each with its slope to the knobs and what noise leaves open.

All are logarithms or shares, so that 0.01 is about a per cent: a bound keeps while its slack is >= 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from feeddrive.engineer.analysis.extremum import least
from feeddrive.engineer.tuning.shaping.control_response import ControlResponse, Response
from feeddrive.engineer.tuning.shaping.limits import Limits
from feeddrive.engineer.tuning.shaping.site import Site

GOALS = ("rope-snap", "stiffness", "least-stiffness", "bandwidth")
_NEAR = 0.7  # of a logarithm: bounds with more slack on a line are not written down
_REJECTED = float(np.sqrt(0.5))  # |S| up to here counts as bandwidth


class Bound(NamedTuple):
    """One bound at one frequency of one site: its slack, slope, and standard deviation from the measurement."""

    kind: str
    site: int
    frequency: float
    slack: float
    slope: np.ndarray
    deviation: float
    key: tuple[str, int, int]


class Judged(NamedTuple):
    """The goal of each site (less is better), its slope, and the bounds; `stable` by encirclement."""

    stable: bool
    goal: np.ndarray  # (sites,)
    slope: np.ndarray  # (sites, knobs)
    curvature: np.ndarray  # (knobs, knobs)
    bounds: tuple[Bound, ...]


@dataclass(frozen=True, eq=False)
class Answer:
    """The closed loop of a site on its lines, with slopes (lines, knobs) and variances (lines,)."""

    site: Site
    response: Response
    gain: np.ndarray
    gain_slope: np.ndarray
    gain_variance: np.ndarray
    compliance: np.ndarray
    compliance_slope: np.ndarray
    compliance_variance: np.ndarray


def answer(site: Site, response: Response) -> Answer:
    """L = -C·X_u and the compliance y = y_d + y_u (C·X_d)/(1 + L), with slopes, and variances to first order."""
    C, dC = response.value, response.slope
    xu, xd = site.by_force, site.by_load
    yu, yd = site.moved
    L = -np.einsum("kl,kl->l", C, xu)
    dL = -np.einsum("klp,kl->lp", dC, xu)
    back, dback = np.einsum("kl,kl->l", C, xd), np.einsum("klp,kl->lp", dC, xd)
    S = 1.0 / (1.0 + L)
    y = yd + yu * back * S
    dy = (yu * S)[:, None] * (dback - (back * S)[:, None] * dL)
    zero = np.zeros(site.frequency.size)
    gain_variance = zero if site.variance is None else _through(site, 0, C)
    return Answer(site, response, L, dL, gain_variance, y, dy, _of_compliance(site, C, back, S))


def _through(site: Site, source: int, factors: np.ndarray) -> np.ndarray:
    """The variance of Σ factor · reading of one source (0: the command, 1: a force on the table).

    Where the motor's reading is the load's times a ratio, they have one error; elsewhere they count as independent.
    """
    variance = (site.variance, site.load_variance)[source]
    assert variance is not None
    found = np.einsum("kl,kl->l", np.abs(factors) ** 2, variance)
    if site.ratio is None:
        return found
    ratio = site.ratio[source]
    together = np.abs(factors[0] * ratio + factors[1]) ** 2 * variance[1] + np.abs(factors[0]) ** 2 * variance[0]
    return np.where(np.isnan(ratio), found, together)


def _of_compliance(site: Site, C: np.ndarray, back: np.ndarray, S: np.ndarray) -> np.ndarray:
    """∂y/∂X_u = C_k y_u back S² + back S (load), ∂y/∂X_d = y_u S C_k + 1 (load)."""
    found = np.zeros(S.size)
    if site.variance is None:
        return found
    table = np.array([[0.0], [1.0]])
    yu = site.moved[0]
    if site.at_drive:  # y = y_u S: one measurement stands in all of it
        return _through(site, 0, table * S + C * (yu * S * S))
    found = found + _through(site, 0, C * (yu * back * S * S) + table * (back * S))
    if site.load_variance is not None:
        found = found + _through(site, 1, C * (yu * S) + table)
    return found


def turned(answer: Answer) -> float:
    """The phase of 1 + L at its lowest line in deg, followed down from the highest, where it counts as within ±180°."""
    values = 1.0 + answer.gain
    steps = np.angle(values[:-1] * np.conj(values[1:]))
    return float(np.degrees(np.sum(steps) + np.angle(values[-1])))


def encircles(answer: Answer) -> bool:
    """Whether -1 is encircled in the wrong way: the closed loop is then unstable.

    For an axis that is stable but for its free motion, with N integrators in all (N <= 3) and P poles of the control
    outside of the unit circle, the phase of 1 + L from Nyquist down to 0 falls by (90 N + 180 P)° if the loop is
    stable, and by 360° less for each pair of unstable poles.
    """
    phase = turned(answer) + 180.0 * answer.response.unstable
    return not -330.0 < phase <= 60.0


class Criteria:
    """Judges a control at all sites, for one goal within limits."""

    def __init__(
        self, sites: tuple[Site, ...], control: ControlResponse, goal: str, limits: Limits, band: tuple[float, float]
    ) -> None:
        self.sites, self.control, self.goal, self.limits, self.band = sites, control, goal, limits, band
        self._known: dict[bytes, Judged] = {}
        self._lines, self._places = np.unique(np.concatenate([site.frequency for site in sites]), return_inverse=True)

    @property
    def count(self) -> int:
        """Points that were computed."""
        return len(self._known)

    def answers(self, x: np.ndarray) -> list[Answer]:
        """The closed loops at logarithms of the knobs; slopes are to the logarithms."""
        values = np.exp(x)
        whole = self.control.at(values, self._lines)
        found, begin = [], 0
        for site in self.sites:
            place = self._places[begin : begin + site.frequency.size]
            begin += site.frequency.size
            part = Response(whole.value[:, place], whole.slope[:, place] * values, whole.unstable)
            found.append(answer(site, part))
        return found

    def __call__(self, x: np.ndarray) -> Judged:
        """The figures at a point; each is computed once."""
        key = np.asarray(x, float).tobytes()
        if key not in self._known:
            self._known[key] = self.judged(self.answers(x))
        return self._known[key]

    def judged(self, answers: list[Answer]) -> Judged:
        """Goal and bounds of closed loops."""
        stable = not any(encircles(each) for each in answers)
        goals = [self._goal(each) for each in answers]
        bounds: list[Bound] = []
        for i, each in enumerate(answers):
            bounds += _bounds(i, each, self.limits)
        worst = int(np.argmax([value for value, _, _ in goals]))
        return Judged(
            stable,
            np.array([value for value, _, _ in goals]),
            np.array([slope for _, slope, _ in goals]),
            goals[worst][2],
            tuple(bounds),
        )

    def _goal(self, each: Answer) -> tuple[float, np.ndarray, np.ndarray]:
        """Logarithm of what is to be small, its slope, and the Gauss-Newton part of its curvature."""
        f = each.site.frequency
        inside = (f >= self.band[0]) & (f <= self.band[1])
        match self.goal:
            case "rope-snap":
                return _mean_square(each, snap_weights(f, each.site.sample_time))
            case "stiffness":
                return _mean_square(each, _log_weights(f, inside))
            case "least-stiffness":
                size = np.where(inside, np.abs(each.compliance), 0.0)
                k = int(np.argmax(size))
                slope = (each.compliance_slope[k] / each.compliance[k]).real
                return float(np.log(size[k])), slope, np.outer(slope, slope)
            case _:
                return _bandwidth(each)


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


def _mean_square(each: Answer, weight: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """½ ln Σ w |y|²."""
    y, dy = each.compliance, each.compliance_slope
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
    knobs = each.gain_slope.shape[1]
    if not rises.size:
        return float(-x[0]), np.zeros(knobs), np.zeros((knobs, knobs))
    i = int(rises[0])
    part = level[i] / (level[i] - level[i + 1])
    tilt = (level[i + 1] - level[i]) / (x[i + 1] - x[i])
    pushed = -(each.gain_slope / (1.0 + each.gain)[:, None]).real
    moved = (1.0 - part) * pushed[i] + part * pushed[i + 1]
    slope = moved / tilt
    return float(-(x[i] + part * (x[i + 1] - x[i]))), slope, np.outer(slope, slope)


def _bounds(i: int, each: Answer, limits: Limits) -> list[Bound]:
    """All bounds of a site that are near."""
    found: list[Bound] = []
    f, L, dL = each.site.frequency, each.gain, each.gain_slope
    spread = np.sqrt(0.5 * each.gain_variance)  # of the part along one direction
    if limits.sensitivity_peak is not None:
        away = np.abs(1.0 + L)
        slack = _at_vertex(np.log(f), np.log(away * limits.sensitivity_peak))
        for k in np.flatnonzero(slack < _NEAR).tolist():
            slope = (dL[k] / (1.0 + L[k])).real
            found.append(Bound("Ms", i, float(f[k]), float(slack[k]), slope, float(spread[k] / away[k]), ("Ms", i, k)))
    if limits.compliance_peak is not None:
        size = np.abs(each.compliance)
        slack = _at_vertex(np.log(f), np.log(limits.compliance_peak / size))
        deviation = np.sqrt(0.5 * each.compliance_variance) / size
        for k in np.flatnonzero(slack < _NEAR).tolist():
            slope = -(each.compliance_slope[k] / each.compliance[k]).real
            found.append(
                Bound("peak compliance", i, float(f[k]), float(slack[k]), slope, float(deviation[k]), ("c", i, k))
            )
    found += _crossovers(i, each, limits, spread)
    if limits.force_noise is not None:
        found.append(_noise(i, each, limits))
    return found


def _at_vertex(x: np.ndarray, slack: np.ndarray) -> np.ndarray:
    """The slacks, at each line that has less than its neighbors that of the parabola through the three."""
    out = slack.copy()
    for k in np.flatnonzero((slack[1:-1] < slack[:-2]) & (slack[1:-1] < slack[2:])) + 1:
        if slack[k] < _NEAR:
            out[k] = least(x[k - 1 : k + 2], slack[k - 1 : k + 2])[1]
    return out


def _crossovers(i: int, each: Answer, limits: Limits, spread: np.ndarray) -> list[Bound]:
    """Gain, phase and delay margins, at straight lines of ln L over ln f between two lines of the grid."""
    found: list[Bound] = []
    x, L = np.log(each.site.frequency), each.gain
    pushed = each.gain_slope / L[:, None]  # of ln L
    level, turn = np.log(np.abs(L)), np.angle(L[1:] * np.conj(L[:-1]))
    lead = np.angle(-L)
    T = each.site.sample_time
    if limits.phase_margin_deg is not None or limits.delay_margin_samples is not None:
        for k in np.flatnonzero(level[:-1] * level[1:] < 0.0):
            part = level[k] / (level[k] - level[k + 1])
            width = x[k + 1] - x[k]
            f = float(np.exp(x[k] + part * width))
            moved = (1.0 - part) * pushed[k] + part * pushed[k + 1]
            along = -moved.real / ((level[k + 1] - level[k]) / width)  # of ln f of the crossover
            slope = moved.imag + (turn[k] / width) * along
            angle = float(np.angle(np.exp(1j * (lead[k] + part * turn[k]))))
            deviation = float(spread[k])
            if limits.phase_margin_deg is not None:
                sign = 1.0 if angle >= 0.0 else -1.0
                slack = abs(angle) - np.radians(limits.phase_margin_deg)
                found.append(Bound("phase margin", i, f, float(slack), sign * slope, deviation, ("pm", i, int(k))))
            if limits.delay_margin_samples is not None:
                ahead = angle % (2.0 * np.pi)
                slack = np.log(ahead / (2.0 * np.pi * f * T * limits.delay_margin_samples))
                found.append(
                    Bound("delay margin", i, f, float(slack), slope / ahead - along, deviation / ahead,
                          ("dm", i, int(k)))
                )  # fmt: skip
    if limits.gain_margin_dB is not None:
        least = limits.gain_margin_dB * np.log(10.0) / 20.0
        after = lead[:-1] + turn
        for k in np.flatnonzero((lead[:-1] * after < 0.0) & (np.abs(turn) < 0.9 * np.pi)):
            part = lead[k] / (lead[k] - after[k])
            size = level[k] + part * (level[k + 1] - level[k])
            if size > 0.0:
                continue  # the gain may fall from here: Ms keeps it away
            width = x[k + 1] - x[k]
            moved = (1.0 - part) * pushed[k] + part * pushed[k + 1]
            along = -moved.imag / (turn[k] / width)
            slope = -(moved.real + (level[k + 1] - level[k]) / width * along)
            f = float(np.exp(x[k] + part * width))
            deviation = float(spread[k] / np.abs(L[k]))
            found.append(Bound("gain margin", i, f, float(-size - least), slope, deviation, ("gm", i, int(k))))
    return found


def force_noise(each: Answer, reading_noise: tuple[float, float]) -> tuple[float, np.ndarray]:
    """RMS of the command in N from white errors of the readings in m, and its slope; beyond the last line S = 1."""
    C, dC = each.response.value, each.response.slope
    S = 1.0 / (1.0 + each.gain)
    dS = -(S * S)[:, None] * each.gain_slope
    f, T = each.site.frequency, each.site.sample_time
    width = np.zeros(f.size)
    step = 0.5 * np.diff(f)
    width[:-1] += step
    width[1:] += step
    width[0] += f[0]
    width[-1] += max(0.5 / T - f[-1], 0.0)
    if each.site.ratio is not None and np.all(each.site.ratio[0] == 1.0):  # one encoder gives both readings
        parts = [(C[0] + C[1], dC[0] + dC[1], max(reading_noise))]
    else:
        parts = [(C[k], dC[k], reading_noise[k]) for k in range(2)]
    total, slope = 0.0, np.zeros(dC.shape[2])
    for value, moved, sigma in parts:
        through, change = value * S, moved * S[:, None] + value[:, None] * dS
        weight = 2.0 * T * width * sigma**2
        total += float(np.sum(weight * np.abs(through) ** 2))
        slope = slope + 2.0 * np.einsum("l,lp->p", weight * np.conj(through), change).real
    return float(np.sqrt(total)), slope / (2.0 * np.sqrt(total))


def _noise(i: int, each: Answer, limits: Limits) -> Bound:
    value, slope = force_noise(each, limits.reading_noise)
    assert limits.force_noise is not None
    slack = float(np.log(limits.force_noise / value))
    return Bound("force noise", i, 0.0, slack, -slope / value, 0.0, ("noise", i, 0))

"""Limits of a tuning that hold at every operating point; each becomes a constraint with slack and gradient.

Slacks are logarithms or relative differences: 0.01 is about one percent.  A limit is kept while its slack is >= 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np

from feeddrive.analysis.margins import Margins, gain_crossings, least, logarithms, phase_crossings
from feeddrive.analysis.stiffness import force_noise_weights
from feeddrive.blocks.filter.notch import Notch
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.text import Text, joined
from feeddrive.loop.control import Control
from feeddrive.tuning.closed_loop import Answer, force_noise, noisy_readings


@dataclass(frozen=True)
class Limits:
    """Limits of a tuned loop; None means no limit.

    sensitivity_peak       Ms = max |1/(1 + L)|
    gain_margin_dB         the gain may rise by at least so much
    phase_margin_deg       at every gain crossover, by its size
    delay_margin_samples   extra dead time that reaches -1
    small_gain_samples     extra dead time in samples that the small-gain theorem admits, |T| |e^(-jωτ) - 1| <= 1:
                           a delay margin as an H-infinity bound, on every line and not at the crossovers alone
    compliance_peak        m/N: largest compliance of the closed loop over all frequencies
    force_noise            N RMS in the command, from errors of the readings: reading_noise, white, m RMS
    snap_force             N: a step of this force on the table must not drive the command to its limit, in the run of
                           the proof
    """

    sensitivity_peak: float | None = 2.0
    gain_margin_dB: float | None = None
    phase_margin_deg: float | None = None
    delay_margin_samples: float | None = None
    compliance_peak: float | None = None
    force_noise: float | None = None
    reading_noise: tuple[float, float] = (0.0, 0.0)
    snap_force: float | None = None
    small_gain_samples: float | None = None

    def __post_init__(self) -> None:
        least = {"sensitivity_peak": 1.0}
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name == "reading_noise" or value is None:
                continue
            bound = least.get(field.name, 0.0)
            if not (math.isfinite(value) and value > bound):
                raise ParameterError(f"{field.name} = {number(value, 6)} must be a finite number > {number(bound)}")
        if self.phase_margin_deg is not None and not self.phase_margin_deg < 180.0:
            raise ParameterError(f"phase_margin_deg = {number(self.phase_margin_deg, 6)} must be < 180")
        if self.force_noise is not None and not any(value > 0.0 for value in self.reading_noise):
            raise ParameterError("force_noise needs reading_noise: the errors of the two readings in m RMS")

    def sentence(self) -> str:
        """All limits, as a clause."""
        return joined(", ", filter(None, self._clauses().values())) or "stability alone"

    def _readings(self) -> str:
        motor, load = (Quantity(noise, "m", form="nm") for noise in self.reading_noise)
        return f"{motor} of white noise in the readings" if motor == load else f"{motor} (motor) and {load} (load)"

    def only(self, kind: str) -> str:
        """One limit, as a clause; by the name of its bound."""
        return self._clauses()[kind]

    def used(self, judged: Judged) -> float:
        """How much of its limit a figure uses up: above 1 it is broken, 0 if the figure does not occur."""
        bound = {
            "Ms": self.sensitivity_peak, "gain margin": self.gain_margin_dB, "phase margin": self.phase_margin_deg,
            "delay margin": self.delay_margin_samples, "small-gain delay": self.small_gain_samples,
            "peak compliance": self.compliance_peak, "force noise": self.force_noise,
        }[judged.kind]  # fmt: skip
        if judged.value is None or bound is None:
            return 0.0
        size = max(abs(judged.value), 1e-300)
        return size / bound if judged.kind in ("Ms", "peak compliance", "force noise") else bound / size

    def eased(self, kind: str, factor: float) -> Limits:
        """The same limits with one of them wider by a factor; for Ms the factor applies to its distance from 1."""
        match kind:
            case "Ms":
                return replace(self, sensitivity_peak=1.0 + factor * ((self.sensitivity_peak or 1.0) - 1.0))
            case "gain margin":
                return replace(self, gain_margin_dB=(self.gain_margin_dB or 0.0) / factor)
            case "phase margin":
                return replace(self, phase_margin_deg=(self.phase_margin_deg or 0.0) / factor)
            case "delay margin":
                return replace(self, delay_margin_samples=(self.delay_margin_samples or 0.0) / factor)
            case "small-gain delay":
                return replace(self, small_gain_samples=(self.small_gain_samples or 0.0) / factor)
            case "peak compliance":
                return replace(self, compliance_peak=factor * (self.compliance_peak or 0.0))
            case "force noise":
                return replace(self, force_noise=factor * (self.force_noise or 0.0))
            case _:
                return self

    def _clauses(self) -> dict[str, str]:
        """By the names of bounds; empty for a limit that is not active."""
        clauses = {
            "Ms": (self.sensitivity_peak, "<=", ""),
            "gain margin": (self.gain_margin_dB, ">=", "dB"),
            "phase margin": (self.phase_margin_deg, ">=", "deg"),
            "delay margin": (self.delay_margin_samples, ">=", "samples"),
            "small-gain delay": (self.small_gain_samples, ">=", "samples"),
            "peak compliance": (self.compliance_peak, "<=", "m/N"),
            "force noise": (self.force_noise, "<=", "N RMS"),
        }
        texts = {
            kind: "" if value is None else Text(f"{kind} {sign} {Quantity(value, unit)}")
            for kind, (value, sign, unit) in clauses.items()
        }
        if self.force_noise is not None:
            texts["force noise"] += Text(f" at {self._readings()}")
        return texts


class Judged(NamedTuple):
    """One figure against its limit: its kind (as in `Limits.only`), value in SI and unit, and whether it is kept.

    value  None if it does not occur, such as a margin without a crossover; it then keeps every limit
    """

    kind: str
    value: float | None
    unit: str
    keeps: bool

    @property
    def text(self) -> Text:
        """The figure in words."""
        if self.value is None:
            return Text(f"no {self.kind}, there is no crossover")
        return Text(f"{self.kind} {Quantity(self.value, self.unit)}")

    def __str__(self) -> str:
        return str(self.text)


def judged(
    limits: Limits, margins: Margins, compliance_peak: float, force_noise: float | None, room: float
) -> tuple[Judged, ...]:
    """The figures of a stable loop against each limit that is given, `room` a share of the limit as tolerance.

    compliance_peak in m/N, force_noise in N RMS (None: not known, and not checked).  A phase margin counts by its
    size: in a stable loop a negative one says that L passes -1 on its other side, as near as a positive one.
    """
    m = margins
    found = (  # the last entry: whether the figure must be at least the limit
        ("Ms", m.sensitivity_peak, limits.sensitivity_peak, "", False),
        ("gain margin", m.gain_increase_dB, limits.gain_margin_dB, "dB", True),
        ("phase margin", m.phase_margin_deg, limits.phase_margin_deg, "deg", True),
        ("delay margin", m.delay_margin_samples, limits.delay_margin_samples, "samples", True),
        ("small-gain delay", _in_samples(m), limits.small_gain_samples, "samples", True),
        ("peak compliance", compliance_peak, limits.compliance_peak, "m/N", False),
        ("force noise", force_noise, limits.force_noise, "N RMS", False),
    )
    out: list[Judged] = []
    for kind, value, bound, unit, higher in found:
        if bound is None or (kind == "force noise" and value is None):
            continue
        size = None if value is None else abs(value)
        keeps = size is None or (size >= (1.0 - room) * bound if higher else size <= (1.0 + room) * bound)
        out.append(Judged(kind, value, unit, keeps))
    return tuple(out)


def _in_samples(margins: Margins) -> float | None:
    T = margins.loop_gain.sample_time
    return None if T is None or margins.small_gain_delay is None else margins.small_gain_delay / T


NOTCH = "notch"  # the bound that prevents a notch from amplifying
_NEAR = 0.7  # of a logarithm: bounds with more slack on a line are not stored
_POINTS, _POLE = 41, 0.2  # points between two neighbors of a line; distance to a pole within which no value is used
_AHEAD = 1e-9  # rad: least distance to -1 that is used for a crossover
_STRETCH = 0.08  # of ln f on both sides of a crossover, over which its slopes are taken


class Bound(NamedTuple):
    """One bound at one frequency of one point: its slack, slope, and standard deviation from the measurement."""

    kind: str
    point: int
    frequency: float
    slack: float
    slope: np.ndarray
    deviation: float
    key: tuple[str, int, int]


def bounds_of(i: int, each: Answer, limits: Limits) -> list[Bound]:
    """All bounds of a point that are near; without slopes only the nearest along the lines, which merit goes by."""
    found: list[Bound] = []
    f, L, dL = each.point.frequency, each.gain, each.gain_slope
    spread = np.sqrt(0.5 * each.gain_variance)  # of the part along one direction
    if limits.sensitivity_peak is not None:
        away = np.abs(1.0 + L)
        slack = _between_lines(np.log(f), 1.0 + L, np.log(away * limits.sensitivity_peak))
        for k in _near(slack, dL):
            slope = (dL[k] / (1.0 + L[k])).real
            found.append(Bound("Ms", i, float(f[k]), float(slack[k]), slope, float(spread[k] / away[k]), ("Ms", i, k)))
    if limits.small_gain_samples is not None:
        late = np.pi * f * limits.small_gain_samples * each.point.sample_time
        with np.errstate(divide="ignore"):
            slack = np.log(np.abs((1.0 + L) / L) / (2.0 * np.sin(np.minimum(late, 0.5 * np.pi))))
        slack = _at_vertex(np.log(f), slack)
        for k in _near(slack, dL):
            slope = -(dL[k] / (L[k] * (1.0 + L[k]))).real
            deviation = float(spread[k] / np.abs(L[k] * (1.0 + L[k])))
            found.append(Bound("small-gain delay", i, float(f[k]), float(slack[k]), slope, deviation, ("sg", i, k)))
    if limits.compliance_peak is not None:
        size = np.abs(each.compliance)
        slack = _at_vertex(np.log(f), np.log(limits.compliance_peak / size))
        deviation = np.sqrt(0.5 * each.compliance_variance) / size
        for k in _near(slack, dL):
            slope = -(each.compliance_slope[k] / each.compliance[k]).real
            found.append(
                Bound("peak compliance", i, float(f[k]), float(slack[k]), slope, float(deviation[k]), ("c", i, k))
            )
    found += _crossovers(i, each, limits, spread)
    if limits.force_noise is not None:
        found.append(_noise(i, each, limits))
    return found


def _near(slack: np.ndarray, slopes: np.ndarray) -> list[int]:
    """Lines whose bound is near; where no slopes are asked for, the nearest of them."""
    near = np.flatnonzero(slack < _NEAR)
    return near.tolist() if slopes.shape[1] or not near.size else [int(near[np.argmin(slack[near])])]


def notches_stay_notches(control: Control, tunables: Sequence[str], x: np.ndarray) -> list[Bound]:
    """The bound that a notch attenuates: damping_zero <= damping_pole, at the logarithms x of the tunables."""
    found: list[Bound] = []
    for i, block in enumerate(control.filters):
        names = [f"filters.{i}.{each}" for each in ("damping_zero", "damping_pole")]
        if not isinstance(block, Notch) or not set(names) & set(tunables) or not block.damping_zero > 0.0:
            continue
        slope, values = np.zeros(x.size), [np.log(block.damping_zero), np.log(block.damping_pole)]
        for k, (name, sign) in enumerate(zip(names, (-1.0, 1.0), strict=True)):
            if name in tunables:
                place = list(tunables).index(name)
                slope[place], values[k] = sign, x[place]
        found.append(Bound(NOTCH, 0, 0.0, float(values[1] - values[0]), slope, 0.0, (NOTCH, i, 0)))
    return found


def _between_lines(x: np.ndarray, w: np.ndarray, slack: np.ndarray) -> np.ndarray:
    """The slacks; at each local minimum they follow from the least |w| between the neighboring lines.

    w = (w0 + b u)/(1 + c u) through the three lines, u = ln f - ln f0: a resonance is a circle, and its nearest point
    may lie far between two lines.
    """
    out = slack.copy()
    for k in np.flatnonzero((slack[1:-1] < slack[:-2]) & (slack[1:-1] < slack[2:])) + 1:
        if slack[k] >= _NEAR:
            continue
        u = x[[k - 1, k + 1]] - x[k]
        sides = w[[k - 1, k + 1]]
        b, c = np.linalg.solve(np.stack([u, -u * sides], axis=1), sides - w[k])
        way = np.linspace(u[0], u[1], _POINTS)
        under = np.abs(1.0 + c * way)
        if np.min(under) > _POLE:
            out[k] += min(float(np.min(np.log(np.abs((w[k] + b * way) / (1.0 + c * way))))) - np.log(np.abs(w[k])), 0.0)
    return out


def _at_vertex(x: np.ndarray, slack: np.ndarray) -> np.ndarray:
    """The slacks; at each local minimum that of the parabola through the line and its neighbors."""
    out = slack.copy()
    for k in np.flatnonzero((slack[1:-1] < slack[:-2]) & (slack[1:-1] < slack[2:])) + 1:
        if slack[k] < _NEAR:
            out[k] = least(x[k - 1 : k + 2], slack[k - 1 : k + 2])[1]
    return out


def _crossovers(i: int, each: Answer, limits: Limits, spread: np.ndarray) -> list[Bound]:
    """Gain, phase and delay margins at the crossovers of `margins`, with slopes and deviations."""
    found: list[Bound] = []
    pushed = each.gain_slope / each.gain[:, None]  # of ln L
    lines = logarithms(each.point.frequency, each.gain)
    x, level, _, turn = lines
    T = each.point.sample_time
    if limits.phase_margin_deg is not None or limits.delay_margin_samples is not None:
        for k, part, margin in gain_crossings(lines):
            f, width = margin.frequency, x[k + 1] - x[k]
            moved = (1.0 - part) * pushed[k] + part * pushed[k + 1]
            along = -moved.real / ((level[k + 1] - level[k]) / width)  # of ln f of the crossover
            slope = moved.imag + (turn[k] / width) * along
            tilt, bend = _tilts(x, level, turn, k)
            if limits.phase_margin_deg is not None:
                sign = 1.0 if margin.phase_margin_deg >= 0.0 else -1.0
                slack = float(np.radians(abs(margin.phase_margin_deg) - limits.phase_margin_deg))
                # noise of the phase, and of where it crosses
                deviation = float(spread[k]) * float(np.hypot(1.0, bend / tilt))
                found.append(Bound("phase margin", i, f, slack, sign * slope, deviation, ("pm", i, k)))
            if limits.delay_margin_samples is not None:
                ahead = max(2.0 * np.pi * f * margin.delay_margin, _AHEAD)
                slack = float(np.log(ahead / (2.0 * np.pi * f * T * limits.delay_margin_samples)))
                deviation = float(spread[k]) * float(np.hypot(1.0 / ahead, (bend / ahead - 1.0) / tilt))
                found.append(Bound("delay margin", i, f, slack, slope / ahead - along, deviation, ("dm", i, k)))
    if limits.gain_margin_dB is not None:
        for k, part, margin in phase_crossings(lines):
            # where the gain may fall but not rise, Ms is the limit that applies
            if margin.gain_margin_dB < 0.0 or np.abs(turn[k]) >= 0.9 * np.pi:
                continue
            f, width = margin.frequency, x[k + 1] - x[k]
            moved = (1.0 - part) * pushed[k] + part * pushed[k + 1]
            along = -moved.imag / (turn[k] / width)
            slope = -(moved.real + (level[k + 1] - level[k]) / width * along)
            tilt, bend = _tilts(x, level, turn, k)
            slack = float(np.log(10.0) / 20.0 * (margin.gain_margin_dB - limits.gain_margin_dB))
            deviation = float(spread[k] / np.abs(each.gain[k])) * float(np.hypot(1.0, tilt / bend))
            found.append(Bound("gain margin", i, f, slack, slope, deviation, ("gm", i, k)))
    return found


def _tilts(x: np.ndarray, level: np.ndarray, turn: np.ndarray, k: int) -> tuple[float, float]:
    """d ln|L|/d ln f and dφ/d ln f around a line: over a stretch, since two lines would show their noise."""
    low, high = (int(each) for each in np.searchsorted(x, (x[k] - _STRETCH, x[k + 1] + _STRETCH)))
    low, high = min(low, k), max(high, k + 2)
    apart = x[low:high] - np.mean(x[low:high])
    phase = np.concatenate([[0.0], np.cumsum(turn[low : high - 1])])
    scale = apart @ apart
    return float(apart @ level[low:high] / scale), float(apart @ phase / scale)


def _noise(i: int, each: Answer, limits: Limits) -> Bound:
    """The force noise with its slope: d σ_u = Σ w σ² Re[(C S)* d(C S)] / σ_u."""
    assert limits.force_noise is not None
    value = force_noise(each, limits.reading_noise)
    S = 1.0 / (1.0 + each.gain)
    dS = -(S * S)[:, None] * each.gain_slope
    weight = force_noise_weights(each.point.frequency, each.point.sample_time)
    slope = np.zeros(each.gain_slope.shape[1])
    for C, dC, sigma in noisy_readings(each, limits.reading_noise):
        through, change = C * S, dC * S[:, None] + C[:, None] * dS
        slope = slope + np.einsum("l,lp->p", weight * sigma**2 * np.conj(through), change).real / value
    slack = float(np.log(limits.force_noise / value))
    return Bound("force noise", i, 0.0, slack, -slope / value, 0.0, ("noise", i, 0))

"""The figures of a loop, from its linear model or its measured response, with the goals and limits of a tuning.

A new goal or limit is one entry here: it then is an option of `tune`, a field of the studio's Goal, and a figure that
`compare` and studies know.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from operator import attrgetter

import numpy as np

from feeddrive.analysis.effort import effort
from feeddrive.analysis.stiffness import mean_compliance
from feeddrive.figures import slopes
from feeddrive.figures.figure import HIGHER, LOWER, MODEL, Figure, Goal, Limitable
from feeddrive.figures.linear_loop import LinearLoop
from feeddrive.figures.slopes import Band, JudgedLoop
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text

AT = (10.0, 100.0)  # Hz
BANDS = ((1.0, 10.0), (10.0, 100.0), (100.0, 1000.0))  # Hz
EVERYWHERE: Band = (0.0, math.inf)


def _small_gain(loop: JudgedLoop) -> float | None:
    margins = loop.margins
    T = margins.loop_gain.sample_time
    return None if T is None or margins.small_gain_delay is None else margins.small_gain_delay / T


def _nearest_phase(loop: JudgedLoop) -> float | None:
    crossovers = loop.margins.gain_crossovers
    nearest = min(crossovers, key=lambda crossover: abs(crossover.phase_margin_deg), default=None)
    return None if nearest is None else nearest.frequency


def _nearest_delay(loop: JudgedLoop) -> float | None:
    crossovers = loop.margins.gain_crossovers
    nearest = min(crossovers, key=lambda crossover: crossover.delay_margin, default=None)
    return None if nearest is None else nearest.frequency


def _nearest_gain(loop: JudgedLoop) -> float | None:
    rising = (crossover for crossover in loop.margins.phase_crossovers if crossover.gain_margin_dB >= 0.0)
    nearest = min(rising, key=lambda crossover: crossover.gain_margin_dB, default=None)
    return None if nearest is None else nearest.frequency


def _sizes(loop: JudgedLoop, band: Band) -> tuple[np.ndarray, np.ndarray]:
    """Return frequency (Hz) and compliance (m/N) of the lines in a band."""
    f = loop.compliance.frequency
    inside = (f >= band[0]) & (f <= band[1])
    return f[inside], loop.compliance.magnitude[inside]


def _mean_compliance(loop: JudgedLoop, band: Band) -> float:
    return mean_compliance(loop.compliance.frequency, loop.compliance.response, band)


def _largest_compliance(loop: JudgedLoop, band: Band) -> float:
    return float(np.max(_sizes(loop, band)[1]))


def _largest_integral(loop: JudgedLoop, band: Band) -> float:
    f, size = _sizes(loop, band)
    return float(np.max(size / (2.0 * np.pi * f)))


def _inverse_bandwidth(loop: JudgedLoop, _: Band) -> float:
    return 1.0 / loop.bandwidth if loop.bandwidth else np.inf


def _rope_snap(loop: JudgedLoop, _: Band) -> float:
    return loop.rope_snap


def _mean_stiffness(loop: JudgedLoop) -> float:
    return 1.0 / _mean_compliance(loop, EVERYWHERE)


def _integral_gain(loop: JudgedLoop) -> float:
    return 1.0 / _largest_integral(loop, EVERYWHERE)


def _compliance_peak(loop: JudgedLoop) -> float:
    return 1.0 / loop.stiffness.minimum


def _operations(linear: LinearLoop) -> float:
    return float(effort(linear.loop).total)


def _nowhere(_: JudgedLoop) -> float | None:
    return None


@dataclass(frozen=True)
class StiffnessAt:
    """The dynamic stiffness at a frequency in Hz, as the function of a Figure."""

    frequency: float

    def __call__(self, loop: JudgedLoop) -> float | None:
        """Return it in N/m."""
        return loop.stiffness_at(self.frequency)


@dataclass(frozen=True)
class StiffnessOver:
    """The geometric mean of the dynamic stiffness over a band in Hz, as the function of a Figure."""

    low: float
    high: float

    def __call__(self, loop: LinearLoop) -> float:
        """Return it in N/m."""
        return loop.mean_stiffness(self.low, self.high)


def stiffness_at(frequency: float) -> Figure:
    """Return the figure of the dynamic stiffness at a frequency in Hz."""
    where = f"{Quantity(frequency, 'Hz'):6}"
    return Figure(
        f"stiffness_{frequency:g}_Hz_N_per_m",
        Text(f"stiffness at {where}"),
        "N/m",
        MODEL,
        StiffnessAt(frequency),
        HIGHER,
        Text(f"dynamic stiffness at {where}"),
        short=Text(where),
        tuned=frequency == AT[0],
        compared=frequency == AT[0],
    )


def _over(low: float, high: float) -> Figure:
    ends = f"{Quantity(low, 'Hz', bare=True):6} to {Quantity(high, 'Hz'):6}"
    title = f"stiffness {Quantity(low, 'Hz', bare=True):6}-{Quantity(high, 'Hz'):6}"
    return Figure(
        f"stiffness_{low:g}_{high:g}_Hz_N_per_m",
        Text(title),
        "N/m",
        MODEL,
        StiffnessOver(low, high),
        HIGHER,
        Text(f"mean dynamic stiffness from {ends}"),
    )


SENSITIVITY_PEAK = Figure(
    "sensitivity_peak",
    "Ms",
    "",
    MODEL,
    attrgetter("margins.sensitivity_peak"),
    meaning="largest sensitivity Ms",
    tuned=True,
    limit=Limitable(
        "max_ms",
        "largest sensitivity peak Ms",
        slopes.sensitivity_places,
        attrgetter("margins.modulus_frequency"),
        order=0,
        usual=2.0,
        above=1.0,
        origin=1.0,
    ),
)
CROSSOVER = Figure(
    "crossover_Hz",
    "crossover",
    "Hz",
    MODEL,
    attrgetter("margins.crossover"),
    HIGHER,
    "first frequency at which the loop gain is 1",
    tuned=True,
)
BANDWIDTH = Figure(
    "bandwidth_Hz",
    "bandwidth",
    "Hz",
    MODEL,
    attrgetter("bandwidth"),
    HIGHER,
    "frequency up to which disturbances are rejected, the sensitivity at -3 dB",
    label="bandwidth (|S| at -3 dB)",
    tuned=True,
    compared=True,
    goal=Goal(
        "bandwidth",
        "bandwidth",
        _inverse_bandwidth,
        slopes.bandwidth_slope,
        on_table=False,
    ),
)
PHASE_MARGIN = Figure(
    "phase_margin_deg",
    "phase margin",
    "deg",
    MODEL,
    attrgetter("margins.phase_margin_deg"),
    HIGHER,
    absent=math.inf,
    tuned=True,
    compared=True,
    limit=Limitable(
        "phase_margin", "least phase margin", slopes.phase_margin_places, _nearest_phase, order=3, below=180.0
    ),
)
GAIN_MARGIN = Figure(
    "gain_margin_dB",
    "gain margin",
    "dB",
    MODEL,
    attrgetter("margins.gain_increase_dB"),
    HIGHER,
    "by how much the gain may rise",
    label="gain may rise by",
    absent=math.inf,
    tuned=True,
    compared=True,
    limit=Limitable("gain_margin", "least gain margin", slopes.gain_margin_places, _nearest_gain, order=4),
)
DELAY_MARGIN = Figure(
    "delay_margin_samples",
    "delay margin",
    "samples",
    MODEL,
    attrgetter("margins.delay_margin_samples"),
    HIGHER,
    "dead time that may be added, in samples",
    absent=math.inf,
    tuned=True,
    compared=True,
    limit=Limitable("delay_margin", "least delay margin", slopes.delay_margin_places, _nearest_delay, order=3),
)
SMALL_GAIN = Figure(
    "small_gain_samples",
    "small-gain delay",
    "samples",
    MODEL,
    _small_gain,
    HIGHER,
    "extra dead time in samples that the small-gain theorem admits",
    absent=math.inf,
    limit=Limitable(
        "small_gain_delay",
        "least dead time that the small-gain theorem admits",
        slopes.small_gain_places,
        _nowhere,
        order=1,
    ),
)
STIFFNESS_LEAST = Figure(
    "stiffness_least_N_per_m",
    "least stiffness",
    "N/m",
    MODEL,
    attrgetter("stiffness.minimum"),
    HIGHER,
    "least dynamic stiffness from 1 Hz on",
    tuned=True,
    compared=True,
    goal=Goal("least-stiffness", "least stiffness", _largest_compliance, slopes.compliance_peak_slope, banded=True),
)
STIFFNESS_MEAN = Figure(
    "stiffness_mean_N_per_m",
    "dynamic stiffness",
    "N/m",
    MODEL,
    _mean_stiffness,
    HIGHER,
    "inverse of the compliance, its root mean square over all frequencies",
    goal=Goal("stiffness", "dynamic stiffness", _mean_compliance, slopes.mean_compliance_slope, banded=True),
)
INTEGRAL_GAIN = Figure(
    "integral_gain_N_per_m_s",
    "integral gain",
    "N/(m s)",
    MODEL,
    _integral_gain,
    HIGHER,
    "least dynamic stiffness times the angular frequency",
    goal=Goal("integral-gain", "integral gain", _largest_integral, slopes.integral_slope, banded=True),
)
COMPLIANCE_PEAK = Figure(
    "compliance_peak_m_per_N",
    "peak compliance",
    "m/N",
    MODEL,
    _compliance_peak,
    meaning="largest compliance",
    tuned=True,
    limit=Limitable(
        "max_compliance",
        "largest compliance",
        slopes.compliance_places,
        attrgetter("stiffness.minimum_frequency"),
        order=2,
        entered="um/N",
    ),
)
ROPE_SNAP = Figure(
    "rope_snap_ISE_root_m_per_N",
    "rope snap ISE^½",
    "m √s/N",
    MODEL,
    attrgetter("rope_snap"),
    LOWER,
    "root of the integral of the squared error after a force of 1 N ends",
    "snap ISE^½",
    "rope-snap error",
    tuned=True,
    compared=True,
    goal=Goal("rope-snap", "rope-snap error", _rope_snap, slopes.rope_snap_slope, returns=True),
)
FORCE_NOISE = Figure(
    "force_noise_N",
    "force noise",
    "N",
    MODEL,
    attrgetter("force_noise"),
    LOWER,
    "RMS of the force from the errors of the readings",
    "noise",
    tuned=True,
    compared=True,
    limit=Limitable(
        "max_noise", "largest noise in the force, RMS", slopes.force_noise_places, _nowhere, order=5, noise=True
    ),
)
NOISE_GAIN = Figure(
    "noise_gain_N_per_m",
    "noise gain",
    "N/m",
    MODEL,
    attrgetter("noise_gain"),
    LOWER,
    "RMS of the force for white noise of 1 m RMS in readings",
    "noise",
    form="3 N/nm",
)
EFFORT = Figure(
    "operations",
    "operations a sample",
    "",
    MODEL,
    _operations,
    LOWER,
    "operations of the law in a sample",
    "operations",
)

STIFFNESS_AT = tuple(map(stiffness_at, AT))
STIFFNESS_OVER = tuple(_over(*band) for band in BANDS)
OF_LOOPS = (
    SENSITIVITY_PEAK,
    CROSSOVER,
    GAIN_MARGIN,
    PHASE_MARGIN,
    DELAY_MARGIN,
    SMALL_GAIN,
    ROPE_SNAP,
    STIFFNESS_MEAN,
    STIFFNESS_LEAST,
    *STIFFNESS_AT,
    *STIFFNESS_OVER,
    INTEGRAL_GAIN,
    BANDWIDTH,
    COMPLIANCE_PEAK,
    FORCE_NOISE,
    NOISE_GAIN,
    EFFORT,
)


def at_frequency(key: str) -> Figure | None:
    """Return the figure of a key such as stiffness_35_Hz_N_per_m or stiffness_2.5_Hz_N_per_m; None for any other."""
    match = re.fullmatch(r"stiffness_(\d+(?:\.\d+)?)_Hz_N_per_m", key)
    frequency = 0.0 if match is None else float(match[1])
    return stiffness_at(frequency) if 0.0 < frequency < 1e6 and stiffness_at(frequency).key == key else None

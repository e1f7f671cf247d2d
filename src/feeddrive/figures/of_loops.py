"""The figures of a loop, from its linear model or its measured response.

A new goal or limit is declared by one entry in this module. It automatically becomes an option of `tune`, a field of
the Goal in the studio, a figure of studies and, with `judges_laws`, of `compare` and the benchmark. Define its
derivatives above the entry, with the tools in `slopes.py`.
"""

import math
import re
from dataclasses import dataclass
from functools import cached_property
from operator import attrgetter

import numpy as np

from feeddrive.analysis.effort import effort
from feeddrive.analysis.loop_model import LoopModel, loop_model
from feeddrive.analysis.margins import Margins, bandwidth, margins
from feeddrive.analysis.stiffness import (
    Stiffness,
    force_noise,
    mean_compliance,
    reading_deviation,
    rope_snap,
    stiffness,
)
from feeddrive.figures import slopes
from feeddrive.figures.figure import HIGHER, LOWER, MODEL, Figure, Goal, Limitable
from feeddrive.figures.slopes import Band, JudgedLoop
from feeddrive.language.errors import ParameterError, UnstableError
from feeddrive.language.quantity import Quantity, number, span
from feeddrive.language.text import Text
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.loop import Loop

LOWEST = 1.0  # Hz, lowest frequency for the minimum stiffness
# lines of a band, for a mean within 1 % of that of infinitely many
_LINES = 60


@dataclass(frozen=True, eq=False)
class LinearLoop:
    """A loop with its linear model, which is computed once for all figures.

    velocity       sliding velocity of the axis, m/s
    known          linear model of the loop, if already computed; the loop must be stable
    density        frequency lines per decade
    lowest         lowest frequency for the minimum stiffness, Hz
    reading_noise  white noise of the two readings, m RMS; None: quantization and noise of the encoders

    Raises UnstableError if a figure of an unstable loop is requested.
    """

    loop: Loop
    velocity: float = 0.05
    known: LoopModel | None = None
    density: int = 200
    lowest: float = LOWEST
    reading_noise: tuple[float, float] | None = None

    @cached_property
    def model(self) -> LoopModel:
        """The linear model of the loop: open at the actuator, and closed."""
        if self.known is not None:
            return self.known
        model = loop_model(self.loop, velocity=self.velocity)
        largest = float(np.max(np.abs(model.closed.poles()), initial=0.0))
        if not largest < 1.0:
            raise UnstableError(f"the loop is not stable: its slowest pole has the absolute value {number(largest, 6)}")
        return model

    @cached_property
    def lines(self) -> np.ndarray:
        """The frequency lines in Hz, dense around the resonances."""
        return self.model.lines(self.density)

    # properties that return cached ones, here and below: see JudgedLoop
    @property
    def margins(self) -> Margins:
        """The margins of the loop gain."""
        return self._margins_on_lines

    @cached_property
    def _margins_on_lines(self) -> Margins:
        return margins(self.model.loop_gain(self.lines))

    @property
    def compliance(self) -> FRF:
        """The compliance at all frequency lines, m/N."""
        return self._compliance_on_lines

    @cached_property
    def _compliance_on_lines(self) -> FRF:
        return self._compliance(self.lines)

    @property
    def stiffness(self) -> Stiffness:
        """The dynamic stiffness at the frequency lines over which its minimum is taken."""
        return self._stiffness_on_lines

    @cached_property
    def _stiffness_on_lines(self) -> Stiffness:
        # a slow sample rate must leave two decades of lines, also where its Nyquist frequency is below 100 Hz
        lowest = min(self.lowest, 0.01 * self.nyquist)
        return stiffness(self._compliance(self.lines[self.lines >= lowest]))

    def stiffness_at(self, frequency: float) -> float:
        """Return the dynamic stiffness at a frequency (Hz), N/m. Raises ParameterError beyond half the sample rate."""
        if frequency > self.nyquist:
            raise ParameterError(
                f"a stiffness at {Quantity(frequency, 'Hz'):6} is asked for, and the loop ends at "
                f"{Quantity(self.nyquist, 'Hz'):6}"
            )
        return stiffness(self._compliance(np.array([frequency]))).at(frequency)

    def mean_stiffness(self, low: float, high: float) -> float:
        """Return the geometric mean of the dynamic stiffness over a band in Hz, N/m."""
        return stiffness(self._compliance(np.geomspace(low, min(high, self.nyquist), _LINES))).mean

    def _compliance(self, frequency: np.ndarray) -> FRF:
        return self.model.closed.response(frequency, "position_load", "load_force")

    @cached_property
    def nyquist(self) -> float:
        """The Nyquist frequency, Hz."""
        return 0.5 / float(self.loop.sample_time)

    @property
    def rope_snap(self) -> float:
        """The rope-snap error, m √s/N."""
        return float(rope_snap(self.model.closed))

    @property
    def bandwidth(self) -> float | None:
        """The bandwidth of the disturbance rejection, where |S| rises to -3 dB, Hz; None if there is none."""
        return bandwidth(self.lines, self.model.loop_gain(self.lines).response)

    @property
    def force_noise(self) -> float | None:
        """The RMS force caused by the noise of the readings, N; None for readings without noise."""
        axis = self.loop.axis
        if self.reading_noise is not None:
            motor, load = self.reading_noise
            if axis.one_encoder():
                # one encoder feeds both readings: its noise is one signal that acts twice, not two independent ones
                return force_noise(self.model.closed, 0.0, max(motor, load), shared=True)
            return force_noise(self.model.closed, motor, load)
        motor, load = reading_deviation(axis.encoder_motor), reading_deviation(axis.encoder_load)
        if motor == 0.0 and load == 0.0:
            return None
        if axis.one_encoder():
            # of the two deviations one is 0, that of the encoder which is absent
            return force_noise(self.model.closed, 0.0, motor + load, shared=True)
        return force_noise(self.model.closed, motor, load)

    @cached_property
    def noise_gain(self) -> float:
        """The ratio of RMS force to RMS noise, for independent white noise of equal size in all readings, N/m."""
        one = self.loop.axis.one_encoder()
        return force_noise(self.model.closed, 0.0 if one else 1.0, 1.0, shared=one)


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
    # a margin < 0 dB is that of a falling gain, which the limit on Ms covers
    rising = (crossover for crossover in loop.margins.phase_crossovers if crossover.gain_margin_dB >= 0.0)
    nearest = min(rising, key=lambda crossover: crossover.gain_margin_dB, default=None)
    return None if nearest is None else nearest.frequency


def _sizes(loop: JudgedLoop, band: Band) -> tuple[np.ndarray, np.ndarray]:
    """Return the frequencies (Hz) of the lines in a band, and the magnitude (m/N) of the compliance there."""
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
    # without a bandwidth the search must still be able to compare: no other loop is worse
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
    """The dynamic stiffness at a frequency in Hz, for use as `Figure.of`."""

    frequency: float

    def __call__(self, loop: JudgedLoop) -> float | None:
        """Return the dynamic stiffness in N/m; None outside the frequency range of the loop."""
        return loop.stiffness_at(self.frequency)


@dataclass(frozen=True)
class StiffnessOver:
    """The geometric mean of the dynamic stiffness over a band in Hz, for use as `Figure.of`."""

    low: float
    high: float

    def __call__(self, loop: LinearLoop) -> float:
        """Return the geometric mean stiffness in N/m."""
        return loop.mean_stiffness(self.low, self.high)


def stiffness_at(frequency: float) -> Figure:
    """Return the figure for the dynamic stiffness at a frequency in Hz."""
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
        judges_laws=True,
    )


def _over(low: float, high: float) -> Figure:
    ends = span(low, high, "Hz", "6")
    title = f"stiffness {Quantity(low, 'Hz', bare=True):6}-{Quantity(high, 'Hz'):6}"
    return Figure(
        f"stiffness_{low:g}_{high:g}_Hz_N_per_m",
        Text(title),
        "N/m",
        MODEL,
        StiffnessOver(low, high),
        HIGHER,
        Text(f"mean dynamic stiffness from {ends}"),
        judges_laws=True,
    )


SENSITIVITY_PEAK = Figure(
    "sensitivity_peak",
    "Ms",
    "",
    MODEL,
    attrgetter("margins.sensitivity_peak"),
    meaning="largest sensitivity Ms",
    tuned=True,
    judges_laws=True,
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
    judges_laws=True,
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
    judges_laws=True,
    limit=Limitable(
        "phase_margin", "least phase margin", slopes.phase_margin_places, _nearest_phase, order=3, below=180.0
    ),
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
    judges_laws=True,
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
    judges_laws=True,
    goal=Goal("rope-snap", "rope-snap error", _rope_snap, slopes.rope_snap_slope, returns=True),
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
    judges_laws=True,
    goal=Goal("least-stiffness", "least stiffness", _largest_compliance, slopes.compliance_peak_slope, banded=True),
)
STIFFNESS_AT = tuple(map(stiffness_at, AT))
STIFFNESS_OVER = tuple(_over(*band) for band in BANDS)
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
    judges_laws=True,
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
    judges_laws=True,
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

OF_LOOPS = tuple(
    declared
    for value in tuple(globals().values())
    for declared in (value if isinstance(value, tuple) else (value,))
    if isinstance(declared, Figure)
)
"""All figures above, in their order, which is that of options, tables and limits."""


def at_frequency(key: str) -> Figure | None:
    """Return the figure for a key such as stiffness_2.5_Hz_N_per_m; None for any other key."""
    # 35.0 and 35 name the same frequency: only the spelling that the figure itself uses is accepted
    match = re.fullmatch(r"stiffness_(\d+(?:\.\d+)?)_Hz_N_per_m", key)
    frequency = 0.0 if match is None else float(match[1])
    return stiffness_at(frequency) if 0.0 < frequency < 1e6 and stiffness_at(frequency).key == key else None

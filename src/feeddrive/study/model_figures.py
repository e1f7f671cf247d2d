"""The figures of a study that come from the linear model of a loop: margins, dynamic stiffness, noise."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from feeddrive.analysis.loop_model import LoopModel, loop_model
from feeddrive.analysis.margins import Margins, margins
from feeddrive.analysis.stiffness import Stiffness, rope_snap, stiffness
from feeddrive.comparison.figures import AT, BANDS, noise_gain
from feeddrive.language.errors import ParameterError, UnstableError
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.text import Text
from feeddrive.loop.loop import Loop
from feeddrive.study.figure import Figure

_LINES = 60  # of a band


@dataclass(frozen=True, eq=False)
class LinearLoop:
    """One variant's loop with its linear model, made once for all figures; `velocity` in m/s: it slides.

    Raises UnstableError where a figure of a loop is asked for that is not stable: it has none.
    """

    loop: Loop
    velocity: float = 0.05

    @cached_property
    def model(self) -> LoopModel:
        """The model opened at the actuator, and closed."""
        made = loop_model(self.loop, velocity=self.velocity)
        largest = float(np.max(np.abs(made.closed.poles()), initial=0.0))
        if not largest < 1.0:
            raise UnstableError(f"the loop is not stable: its slowest pole has the absolute value {number(largest, 6)}")
        return made

    @cached_property
    def lines(self) -> np.ndarray:
        """Frequencies in Hz, dense around the resonances."""
        return self.model.lines(200)

    @cached_property
    def margins(self) -> Margins:
        """The margins of the loop gain."""
        return margins(self.model.loop_gain(self.lines))

    def stiffness(self, frequency: np.ndarray) -> Stiffness:
        """The dynamic stiffness at frequencies in Hz."""
        return stiffness(self.model.closed.response(frequency, "position_load", "load_force"))

    @cached_property
    def nyquist(self) -> float:
        """Half of the sampling frequency, Hz."""
        return 0.5 / float(self.loop.sample_time)


def _sensitivity_peak(linear: LinearLoop) -> float:
    return linear.margins.sensitivity_peak


def _phase_margin(linear: LinearLoop) -> float:
    found = linear.margins.phase_margin_deg
    return math.inf if found is None else found


def _gain_margin(linear: LinearLoop) -> float:
    found = linear.margins.gain_increase_dB
    return math.inf if found is None else found


def _delay_margin(linear: LinearLoop) -> float:
    found = linear.margins.delay_margin_samples
    return math.inf if found is None else float(found)


def _crossover(linear: LinearLoop) -> float | None:
    return linear.margins.crossover


def _rope_snap(linear: LinearLoop) -> float:
    return float(rope_snap(linear.model.closed))


def _noise_gain(linear: LinearLoop) -> float:
    return noise_gain(linear.loop, linear.model)


def _stiffness_least(linear: LinearLoop) -> float:
    lowest = min(BANDS[0][0], 0.01 * linear.nyquist)
    return linear.stiffness(linear.lines[linear.lines >= lowest]).minimum


@dataclass(frozen=True)
class StiffnessAt:
    """The dynamic stiffness at a frequency in Hz, as the function of a Figure."""

    frequency: float

    def __call__(self, linear: LinearLoop) -> float:
        """N/m."""
        if self.frequency > linear.nyquist:
            raise ParameterError(
                f"a stiffness at {Quantity(self.frequency, 'Hz'):6} is asked for, and the loop ends at "
                f"{Quantity(linear.nyquist, 'Hz'):6}"
            )
        return linear.stiffness(np.array([self.frequency])).at(self.frequency)


@dataclass(frozen=True)
class StiffnessOver:
    """The geometric mean of the dynamic stiffness over a band in Hz, as the function of a Figure."""

    low: float
    high: float

    def __call__(self, linear: LinearLoop) -> float:
        """N/m."""
        return linear.stiffness(np.geomspace(self.low, min(self.high, linear.nyquist), _LINES)).mean


def _model(
    name: str, unit: str, meaning: str, of: Callable[[LinearLoop], float | None], better: str = "lower"
) -> Figure:
    return Figure(name, unit, meaning, "model", of, better)


def _at(frequency: float) -> Figure:
    return _model(
        f"stiffness_{frequency:g}_Hz_N_per_m", "N/m", Text(f"dynamic stiffness at {Quantity(frequency, 'Hz'):6}"),
        StiffnessAt(frequency), "higher",
    )  # fmt: skip


OF_MODELS = (
    _model("sensitivity_peak", "", "largest sensitivity Ms", _sensitivity_peak),
    _model("phase_margin_deg", "deg", "phase margin", _phase_margin, "higher"),
    _model("gain_margin_dB", "dB", "by how much the gain may rise", _gain_margin, "higher"),
    _model("delay_margin_samples", "", "dead time that may be added, in samples", _delay_margin, "higher"),
    _model("crossover_Hz", "Hz", "first frequency at which the loop gain is 1", _crossover, "higher"),
    _model("stiffness_least_N_per_m", "N/m", "least dynamic stiffness from 1 Hz on", _stiffness_least, "higher"),
    _model(
        "rope_snap_ISE_root_m_per_N", "m √s/N", "root of the integral of the squared error after a force of 1 N ends",
        _rope_snap,
    ),
    _model("noise_gain_N_per_m", "N/m", "RMS of the force for white noise of 1 m RMS in readings", _noise_gain),
    *(_at(frequency) for frequency in AT),
    *(
        _model(
            f"stiffness_{low:g}_{high:g}_Hz_N_per_m", "N/m", Text(
                f"mean dynamic stiffness from {Quantity(low, 'Hz', bare=True):6} to {Quantity(high, 'Hz'):6}"
            ),
            StiffnessOver(low, high), "higher",
        )
        for low, high in BANDS
    ),
)  # fmt: skip


def at_frequency(name: str) -> Figure | None:
    """The figure of a name such as stiffness_35_Hz_N_per_m or stiffness_2.5_Hz_N_per_m; None for any other name."""
    found = re.fullmatch(r"stiffness_(\d+(?:\.\d+)?)_Hz_N_per_m", name)
    frequency = 0.0 if found is None else float(found[1])
    return _at(frequency) if 0.0 < frequency < 1e6 and _at(frequency).name == name else None

"""A controller combined with a measured axis response: margins and responses without a plant model."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from feeddrive.analysis.conversion import as_frf
from feeddrive.analysis.margins import (
    MarginIntervals,
    Margins,
    complementary_sensitivity,
    margin_intervals,
    margins,
    sensitivity,
)
from feeddrive.analysis.stability import Encirclement, encirclement
from feeddrive.analysis.stiffness import Stiffness, stiffness
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Result, Table
from feeddrive.language.text import Text
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.linearize import linearize
from feeddrive.loop.loop import Loop


@dataclass(frozen=True, eq=False, repr=False)
class MeasuredLoop(Result):
    """The loop gain of a controller on a measured axis, and the closed-loop compliance, if it can be computed.

    The compliance requires a measurement of the compliance of the open axis.  Margins alone do not prove that the
    closed loop is stable: see `encirclement`.
    """

    loop_gain: FRF
    compliance: FRF | None

    @property
    def margins(self) -> Margins:
        """The margins of the loop gain."""
        return margins(self.loop_gain)

    def margin_intervals(self, level: float = 0.95, seed: int = 0) -> MarginIntervals:
        """Return confidence intervals of the margins. Raises ParameterError if the measurement has no variances."""
        return margin_intervals(self.loop_gain, level=level, seed=seed)

    def encirclement(self, unstable_poles: int = 0, integrators: int | None = None) -> Encirclement:
        """Assess the stability of the closed loop by the Nyquist criterion.

        unstable_poles  number of unstable poles of the open loop
        integrators     number of integrators of the axis and the law together; None: from the slope of L
        """
        return encirclement(self.loop_gain, unstable_poles=unstable_poles, integrators=integrators)

    @property
    def sensitivity(self) -> FRF:
        """The sensitivity 1/(1 + L)."""
        return sensitivity(self.loop_gain)

    @property
    def complementary_sensitivity(self) -> FRF:
        """The complementary sensitivity L/(1 + L)."""
        return complementary_sensitivity(self.loop_gain)

    @property
    def stiffness(self) -> Stiffness:
        """The inverse of the compliance. Raises ParameterError if the compliance of the open axis was not measured."""
        if self.compliance is None:
            raise ParameterError("the compliance of the open axis was not measured: give `disturbance` for a stiffness")
        return stiffness(self.compliance)

    def table(self) -> Table:
        """Return a table of the margins and the minimum stiffness."""
        table = self.margins.table()
        rows = [list(row) for row in table.rows]
        if self.compliance is not None:
            least = self.stiffness
            rows.append(["least stiffness", least.minimum_frequency, Quantity(least.minimum, "N/m")])
        return Table("control on a measured axis", table.columns, rows)


def measured_loop(
    control: Control | FRF | Any,
    sample_time: float | None,
    load: FRF | Any,
    motor: FRF | Any = None,
    *,
    disturbance: tuple[FRF | Any, FRF | Any] | None = None,
    delay: float = 0.0,
    velocity: float = 0.05,
    frequency: np.ndarray | None = None,
) -> MeasuredLoop:
    """Combine a controller with the measured frequency responses of an axis, all in m/N at the same frequencies.

        u = C1 x1 + C2 x2,   L = -(C1 X1/u + C2 X2/u),   x2/d = X2/d + X2/u (C1 X1/d + C2 X2/d) / (1 + L)

    control       a Control, whose linearization at `velocity` in m/s, with filters and compensation, gives C1 and C2;
                  or a single response C from the position error to the force, N/m, in any form that `as_frf` accepts,
                  so that C2 = -C
    sample_time   sample time in s; None for a response C that is not sampled
    load, motor   X2/u and X1/u, from the commanded force to the readings; omit `motor` for a single encoder
    disturbance   X2/d and X1/d, from a force on the table, such as that of a hammer, to the readings; they are needed
                  for the compliance only
    delay         computation delay, s, if the responses were measured from the actual force rather than the commanded
                  one
    frequency     frequencies in Hz, for responses that are arrays or python-control models

    The variance of L is |C2|² var(X2/u) with one encoder.  With two, whose errors may be correlated, its upper bound
    (|C1| σ(X1/u) + |C2| σ(X2/u))² is used: confidence intervals are then conservative.

    Raises ParameterError for frequencies that differ or lie beyond Nyquist, for a law with two encoders if only one was
    measured, and for a law whose period is several samples.
    Source: Gordon & Erkorkmaz 2013, section 2 (tuning on the measured frequency response).
    """
    load, motor = as_frf(load, frequency), None if motor is None else as_frf(motor, frequency)
    lines = load.frequency
    if isinstance(control, Control):
        by_motor, by_load = _responses(control, sample_time, lines, velocity, one_encoder=motor is None)
    else:
        by_motor, by_load = 0.0, -_as_response(control, sample_time, lines, one_encoder=motor is None)

    def answered(of_load: FRF, of_motor: FRF | None) -> FRF:
        """Return the response of the controller's force to an input of the axis, from the responses of the readings."""
        return of_load * (by_load + by_motor) if of_motor is None else of_load * by_load + of_motor * by_motor

    gain = -answered(load, motor).delayed(delay)
    coherence = _coherence(load, motor)
    variance = gain.variance
    if motor is not None and load.deviation is not None and motor.deviation is not None:
        # the correlation of the errors of both is not known; this is an upper bound for any
        variance = (np.abs(by_load) * load.deviation + np.abs(by_motor) * motor.deviation) ** 2
    L = FRF(lines, gain.response, "cut", "force", "N/N", sample_time, coherence, variance)
    if disturbance is None:
        return MeasuredLoop(L, None)
    free, free_motor = (None if record is None else as_frf(record, lines) for record in disturbance)
    assert free is not None
    back = (load * answered(free, free_motor).response).delayed(delay)
    closed = free + back.response / (1.0 + L.response)
    # each measurement enters several times, so no single variance can be passed on
    closed = replace(
        closed, input="load_force", output="position_load", unit="m/N", sample_time=sample_time, variance=None
    )
    return MeasuredLoop(L, closed)


def _responses(
    control: Control, T: float | None, frequency: np.ndarray, velocity: float, *, one_encoder: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return the frequency responses of the controller alone, from the motor and the load reading to the force."""
    law = control.law
    if T is None:
        raise ParameterError(f"the law '{law.kind}' is sampled: give its sample_time in s")
    if law.period() > 1:
        raise ParameterError(
            f"the law '{law.kind}' repeats itself only every {law.period()} samples: it has no response at the actuator"
        )
    if one_encoder and law.positions() > 1:
        raise ParameterError(f"the law '{law.kind}' needs two encoders: give the response of the motor's as `motor`")
    # any axis will do: with `cut` as an input, its motion does not depend on the control
    swings = 0.1 / T  # rad/s of an axis that only provides readings
    axis = Axis(plant=TwoMass(mass_motor=1.0, mass_load=1.0, stiffness=0.5 * swings * swings))
    loop = Loop(control=control, axis=axis, sample_time=T)
    model = linearize(loop, ["cut", "reading_motor", "reading_load"], ["force"], velocity=velocity)
    motor, load = (model.response(frequency, input=name).response for name in ("reading_motor", "reading_load"))
    return motor, load


def _as_response(control: Any, T: float | None, frequency: np.ndarray, *, one_encoder: bool) -> np.ndarray:
    """Return the response of a controller that is specified by its frequency response from position error to force."""
    if not one_encoder:
        raise ParameterError("a control that is one response reads one encoder: leave `motor` out, or give a Control")
    C = as_frf(control, None if isinstance(control, FRF) or hasattr(control, "omega") else frequency)
    if C.sample_time is not None and (T is None or abs(C.sample_time / T - 1.0) > 1e-9):
        expected = "none" if T is None else Text(f"{Quantity(T, 's'):6 SI}")
        raise ParameterError(
            f"the control's response is sampled with {Quantity(C.sample_time, 's'):6 SI}, and sample_time is {expected}"
        )
    if C.frequency.shape != frequency.shape or not np.allclose(C.frequency, frequency, rtol=1e-9, atol=0.0):
        raise ParameterError("the responses of the control and of the axis are on different frequencies")
    if T is not None and frequency.size and frequency[-1] * T > 0.5 * (1.0 + 1e-9):
        raise ParameterError(
            f"frequency {Quantity(frequency[-1], 'Hz'):6} is beyond Nyquist, {Quantity(0.5 / T, 'Hz'):6}"
        )
    return C.response


def _coherence(load: FRF, motor: FRF | None) -> np.ndarray | None:
    """Return, at each line, the smaller coherence of the two measurements; that of the load if `motor` is None."""
    if load.coherence is None or motor is None or motor.coherence is None:
        return load.coherence
    return np.minimum(load.coherence, motor.coherence)

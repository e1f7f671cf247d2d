"""Tuning of the lead of a repetitive controller, from the response of the loop to a shift of its set position."""

from dataclasses import dataclass, replace

import numpy as np

from feeddrive.blocks.compensation.repetitive_control import RepetitiveControl, taps
from feeddrive.language.errors import ParameterError, UnstableError
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.table import Result, Table
from feeddrive.language.text import Text
from feeddrive.loop.linearize import linearize
from feeddrive.loop.loop import Loop

_LINES = 1500  # from a tenth of the period's frequency up to Nyquist
_WHOLE = 1e-4  # of a period, by which it may miss whole samples


@dataclass(frozen=True, eq=False, repr=False)
class RepetitiveDesign(Result):
    """A repetitive controller for one period, and the convergence factor of its learning for every lead.

    factor   largest convergence factor from period to period over all frequencies; it occurs at `frequency` in Hz
    factors  largest convergence factor for each lead of 0, 1, 2, ... samples
    """

    block: RepetitiveControl
    factor: float
    frequency: float
    factors: tuple[float, ...]

    def table(self) -> Table:
        """Return a table of the convergence factor for each lead, with the selected lead marked."""
        chosen = self.block.lead_samples
        rows = [[lead, factor, "chosen" if lead == chosen else ""] for lead, factor in enumerate(self.factors)]
        title = Text(
            f"left from period to period, at worst {Quantity(self.factor):3} at {Quantity(self.frequency, 'Hz')}; "
            "below 1 it converges"
        )
        return Table(title, ["lead in samples", "left", ""], rows)


def tune_repetitive(
    loop: Loop,
    period: float,
    *,
    passes: int = 32,
    weight: float = 0.25,
    learning_gain: float = 1.0,
    most_shift: float = 1e-3,
    most_lead: int = 40,
    velocity: float = 0.05,
) -> RepetitiveDesign:
    """Return the repetitive controller whose lead converges fastest, for a motion that repeats every `period` s.

        min over leads l of   max over f of   |q (1 - learning_gain T_r z^l)|

    q is the smoothing filter of the controller.  T_r is the response of the load position to a shift of the set
    position while the axis moves at `velocity` (m/s); the difference quotient of the shift is added to the set
    velocity.  A repetitive controller already in the loop is ignored.  Use enough `passes` that q blocks the
    frequencies at which the response of the loop is unknown; with 32 passes, q is at -3 dB at 0.033 of the sample rate.
    Raises ParameterError if the period is not a whole number of samples, and UnstableError if no lead converges.
    """
    T = float(loop.sample_time)
    count = round(period / T) if np.isfinite(period) and period > 0.0 else 0
    if count < 1 or abs(count * T / period - 1.0) > _WHOLE:
        raise ParameterError(
            f"period = {Quantity(period, 's'):6 SI} must be a whole number of samples of {Quantity(T, 's'):6 SI}, to "
            f"{number(_WHOLE)}: the nearest is {Quantity(max(count, 1) * T, 's'):6 SI}"
        )
    if most_lead < 0:
        raise ParameterError(f"most_lead = {most_lead} must be >= 0 samples")
    control = loop.control
    others = tuple(
        compensation for compensation in control.compensation if not isinstance(compensation, RepetitiveControl)
    )
    bare = replace(loop, control=replace(control, compensation=others))
    control_block = RepetitiveControl(
        period_samples=count, passes=passes, weight=weight, learning_gain=learning_gain, most_shift=most_shift
    )
    # from below the lowest harmonic, 1/period: what is not learned there repeats as well
    f = np.geomspace(0.1 / period, 0.5 / T, _LINES)
    z = np.exp(2j * np.pi * f * T)
    Tr = shift_response(bare, f, velocity)
    row = np.array(taps(weight, passes))
    # symmetric taps have no phase: their response is a sum of cosines
    q = row[0] + 2.0 * np.cos(np.outer(2.0 * np.pi * f * T, np.arange(1, row.size))) @ row[1:]
    # the period must hold twice the passes and the lead, as the block itself requires
    leads = range(min(most_lead, count // 2 - passes) + 1)
    left = [np.abs(q * (1.0 - learning_gain * Tr * z**lead)) for lead in leads]
    factors = tuple(float(np.max(remainder)) for remainder in left)
    lead = int(np.argmin(factors))
    worst = float(f[int(np.argmax(left[lead]))])
    if factors[lead] >= 1.0:
        raise UnstableError(
            f"no lead up to {leads[-1]} samples lets learning converge: at best {number(factors[lead])} of the worst "
            f"frequency, {Quantity(worst, 'Hz')}, is left from period to period; take more passes or a smaller "
            "learning_gain"
        )
    return RepetitiveDesign(replace(control_block, lead_samples=lead), factors[lead], worst, factors)


def shift_response(loop: Loop, frequency: np.ndarray, velocity: float = 0.05) -> np.ndarray:
    """Return the frequency response T_r, at frequencies in Hz, from a shift of the set position to the load position.

    The difference quotient of the shift is added to the set velocity.
    """
    T = float(loop.sample_time)
    model = linearize(loop, ("set_position", "set_velocity"), ("position_load",), velocity=velocity)
    by_position, by_velocity = (
        model.response(frequency, "position_load", name).response for name in ("set_position", "set_velocity")
    )
    return by_position + (1.0 - np.exp(-2j * np.pi * frequency * T)) / T * by_velocity

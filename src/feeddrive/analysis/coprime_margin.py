"""The margin in the normalized coprime factors of plant and controller: the goal of loop shaping."""

from __future__ import annotations

import numpy as np

from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.loop.frequency_response import FRF


def coprime_margin(plant: FRF, controller: FRF, crossover: float) -> float:
    """b(P, C) = min |1 + PC| / √((1 + |P|²)(1 + |C|²)) over the lines, with P scaled to 1 at `crossover` in Hz.

    The closed loop, stable itself, stays stable while the normalized coprime factors of P change by less than b; its
    phase margin is at least 2 asin b, its gain margin (1 + b)/(1 - b).  No controller of 1/s² exceeds 1/√(4 + 2√2).
    P is the sampled axis with its dead time where C is a sampled law: P = L/C.
    When not: as a goal for P-PI, which does not roll off: b then measures its gain at half the sample rate.
    Raises ParameterError if the lines are not common to both, or the crossover is not among them.
    Source: McFarlane & Glover 1990.
    """
    f = plant.frequency
    if not np.array_equal(f, controller.frequency):
        raise ParameterError(f"plant ({f.size} lines) and controller ({controller.frequency.size}) need the same lines")
    if not f[0] <= crossover <= f[-1]:
        raise ParameterError(
            f"crossover = {Quantity(crossover, 'Hz'):6} must lie on the lines, {Quantity(f[0], 'Hz', bare=True):6} to "
            f"{Quantity(f[-1], 'Hz'):6}"
        )
    scale = np.exp(np.interp(np.log(crossover), np.log(f), np.log(np.abs(plant.response))))
    P, C = plant.response / scale, controller.response * scale
    return float(np.min(np.abs(1.0 + P * C) / np.sqrt((1.0 + np.abs(P) ** 2) * (1.0 + np.abs(C) ** 2))))

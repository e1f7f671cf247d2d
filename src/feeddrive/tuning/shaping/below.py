"""The closed loop below the first line, where nothing was measured: the axis is followed down as a free mass."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from feeddrive.tuning.shaping.control_response import Response
from feeddrive.tuning.shaping.site import Site

_DEEPEST, _LINES = 1e-3, 40  # of the first line: down to where, and with how many lines


class Recovery(NamedTuple):
    """Frequency, compliance and its slope to the tunables: what a rope-snap error is made of."""

    frequency: np.ndarray
    compliance: np.ndarray
    slope: np.ndarray


class Below:
    """The axis of a site below its first line f₁, as the free motion that it is there.

        X_load(f) = X_load(f₁) (f₁/f)²,    X_motor/X_load = 1 + ρ,  ρ(f) = ρ(f₁) (f/f₁)²
        y = X_d (1 + C_motor X_u (ρ_d - ρ_u)) / (1 + L),    L = -X_u (C_motor (1 + ρ_u) + C_load)

    u is the command, d the force on the table.  With integral action y is nearly 1/C, whatever the mass.  So this shows
    a law that takes long to come back, and serves for nothing else.
    """

    def __init__(self, site: Site) -> None:
        first = site.frequency[0]
        self.frequency = first * np.geomspace(_DEEPEST, 1.0, _LINES, endpoint=False)
        down = (first / self.frequency) ** 2
        self.by_force, self.by_load = site.by_force[1, 0] * down, site.by_load[1, 0] * down
        self.apart_force, self.apart_load = (
            (each[0, 0] / each[1, 0] - 1.0) / down for each in (site.by_force, site.by_load)
        )

    def recovery(self, response: Response) -> Recovery:
        """The closed loop of a control, of which `response` is given on these lines."""
        (C, D), (dC, dD) = response.value, response.slope
        loop = -self.by_force * (C * (1.0 + self.apart_force) + D)
        dloop = -self.by_force[:, None] * (dC * (1.0 + self.apart_force)[:, None] + dD)
        twist = self.by_force * (self.apart_load - self.apart_force)
        S = 1.0 / (1.0 + loop)
        y = self.by_load * (1.0 + C * twist) * S
        return Recovery(self.frequency, y, (self.by_load * S * twist)[:, None] * dC - (y * S)[:, None] * dloop)

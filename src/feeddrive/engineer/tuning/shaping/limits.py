"""What a shaped loop must keep, at every site."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from feeddrive.language.errors import ParameterError


@dataclass(frozen=True)
class Limits:
    """Bounds of a shaped loop; what is None does not bind.

    sensitivity_peak       Ms = max |1/(1 + L)|
    gain_margin_dB         the gain may rise by at least so much
    phase_margin_deg       at every gain crossover
    delay_margin_samples   extra dead time that reaches -1
    compliance_peak        m/N: largest compliance of the closed loop over all frequencies
    force_noise            N RMS in the command, from errors of the readings: reading_noise, white, m RMS
    snap_force             N: a step of it on the table may not drive the command to its limit, in the run that proves
    """

    sensitivity_peak: float | None = 2.0
    gain_margin_dB: float | None = None
    phase_margin_deg: float | None = None
    delay_margin_samples: float | None = None
    compliance_peak: float | None = None
    force_noise: float | None = None
    reading_noise: tuple[float, float] = (0.0, 0.0)
    snap_force: float | None = None

    def __post_init__(self) -> None:
        least = {"sensitivity_peak": 1.0}
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name == "reading_noise" or value is None:
                continue
            bound = least.get(field.name, 0.0)
            if not (math.isfinite(value) and value > bound):
                raise ParameterError(f"{field.name} = {value:g} must be a finite number > {bound:g}")
        if self.force_noise is not None and not any(value > 0.0 for value in self.reading_noise):
            raise ParameterError("force_noise needs reading_noise: the errors of the two readings in m RMS")

    def sentence(self) -> str:
        """All of them, as a clause."""
        found = [
            None if self.sensitivity_peak is None else f"Ms <= {self.sensitivity_peak:g}",
            None if self.gain_margin_dB is None else f"gain margin >= {self.gain_margin_dB:g} dB",
            None if self.phase_margin_deg is None else f"phase margin >= {self.phase_margin_deg:g} deg",
            None if self.delay_margin_samples is None else f"delay margin >= {self.delay_margin_samples:g} samples",
            None if self.compliance_peak is None else f"peak compliance <= {1e6 * self.compliance_peak:g} um/N",
            None if self.force_noise is None else f"force noise <= {self.force_noise:g} N RMS",
        ]
        return ", ".join(each for each in found if each is not None) or "stability alone"

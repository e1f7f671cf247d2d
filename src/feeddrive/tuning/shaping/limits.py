"""What a shaped loop must keep, at every site."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

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
        if self.phase_margin_deg is not None and not self.phase_margin_deg < 180.0:
            raise ParameterError(f"phase_margin_deg = {self.phase_margin_deg:g} must be < 180")
        if self.force_noise is not None and not any(value > 0.0 for value in self.reading_noise):
            raise ParameterError("force_noise needs reading_noise: the errors of the two readings in m RMS")

    def sentence(self) -> str:
        """All of them, as a clause."""
        return ", ".join(each for each in self._clauses().values() if each) or "stability alone"

    def only(self, kind: str) -> str:
        """One of them, as a clause; by the name that a bound has."""
        return self._clauses()[kind]

    def eased(self, kind: str, factor: float) -> Limits:
        """The same with one of them wider by a factor, that of Ms from 1 on."""
        match kind:
            case "Ms":
                return replace(self, sensitivity_peak=1.0 + factor * ((self.sensitivity_peak or 1.0) - 1.0))
            case "gain margin":
                return replace(self, gain_margin_dB=(self.gain_margin_dB or 0.0) / factor)
            case "phase margin":
                return replace(self, phase_margin_deg=(self.phase_margin_deg or 0.0) / factor)
            case "delay margin":
                return replace(self, delay_margin_samples=(self.delay_margin_samples or 0.0) / factor)
            case "peak compliance":
                return replace(self, compliance_peak=factor * (self.compliance_peak or 0.0))
            case "force noise":
                return replace(self, force_noise=factor * (self.force_noise or 0.0))
            case _:
                return self

    def _clauses(self) -> dict[str, str]:
        """By the names of bounds; empty for what does not bind."""
        said = {
            "Ms": (self.sensitivity_peak, "Ms <= {:.4g}"),
            "gain margin": (self.gain_margin_dB, "gain margin >= {:.4g} dB"),
            "phase margin": (self.phase_margin_deg, "phase margin >= {:.4g} deg"),
            "delay margin": (self.delay_margin_samples, "delay margin >= {:.4g} samples"),
            "peak compliance": (None if self.compliance_peak is None else 1e6 * self.compliance_peak,
                                "peak compliance <= {:.4g} um/N"),
            "force noise": (self.force_noise, "force noise <= {:.4g} N RMS"),
        }  # fmt: skip
        return {kind: "" if value is None else text.format(value) for kind, (value, text) in said.items()}

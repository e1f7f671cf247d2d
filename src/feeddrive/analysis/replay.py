"""Replay: the setpoints of a measured log simulated in the model of the loop, compared with the measurement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from feeddrive.blocks.load.recorded_force import RecordedForce
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.language.errors import LogError
from feeddrive.language.table import Result, Table, shown
from feeddrive.loop.loop import UNITS, Loop
from feeddrive.loop.simulate import Run, simulate

FITTED = 50  # samples from which position and velocity at the start are estimated


@dataclass(frozen=True, eq=False, repr=False)
class Replay(Result):
    """A predicted run and the measured signals of the same names, over the same samples.

    `skipped` samples at the start do not count in the errors: there the state of the real loop is not known.
    """

    run: Run
    measured: Mapping[str, np.ndarray]
    skipped: int

    def residual(self, signal: str) -> np.ndarray:
        """Predicted - measured, after the skipped samples."""
        return (self.run[signal] - self.measured[signal])[self.skipped :]

    def rms(self, signal: str) -> float:
        """RMS of the residual in SI."""
        return float(np.sqrt(np.mean(self.residual(signal) ** 2)))

    def share(self, signal: str) -> float:
        """RMS of the residual over RMS of the measured signal."""
        return self.rms(signal) / float(np.sqrt(np.mean(self.measured[signal][self.skipped :] ** 2)))

    def table(self) -> Table:
        """RMS and peak of measured, predicted and residual."""
        rows = []
        for signal, measured in self.measured.items():
            unit, factor = shown(UNITS[signal])
            if signal in ("position_load", "position_motor"):
                size = "-"
            else:
                size = f"{factor * np.sqrt(np.mean(measured[self.skipped :] ** 2)):.4g}"
            off = factor * self.residual(signal)
            rows.append(
                [signal.replace("_", " "), unit, size, f"{np.sqrt(np.mean(off**2)):.4g}", f"{np.max(np.abs(off)):.4g}"]
            )
        title = f"predicted against measured, after {self.skipped} samples"
        return Table(title, ["signal", "unit", "measured RMS", "residual RMS", "residual peak"], rows)


def replay(loop: Loop, measured: Mapping[str, np.ndarray], *, skip: int = 0, name: str = "predicted") -> Replay:
    """Run the recorded reference through the loop, from the position and velocity in which the log starts.

    measured  `set_position` and `position_load` in m, optionally `force` in N and `load_force` in N (a known extra
              force, which is applied to the model too); all of shape (n,), one row a sample of the loop
    skip      samples at the start that do not count

    Raises LogError for a log too short to estimate its start.
    """
    setpoint, position = measured["set_position"], measured["position_load"]
    if position.size <= max(FITTED, skip):
        raise LogError(
            f"the log has {position.size} samples; {max(FITTED, skip) + 1} are needed to estimate how it starts"
        )
    T = float(loop.sample_time)
    load = measured.get("load_force")
    run = simulate(
        loop,
        Recorded(position=setpoint, sample_time=T),
        load=None if load is None else RecordedForce(force=load, sample_time=T),
        start=estimate_start(position, T),
        name=name,
    )
    signals = {"position_load": position, "following_error": setpoint - position}
    if "force" in measured:
        signals["force"] = measured["force"]
    return Replay(run, signals, skip)


def estimate_start(position: np.ndarray, T: float) -> tuple[float, float]:
    """Position (m) and velocity (m/s) at the first sample, by a parabola through the first `FITTED` samples."""
    t = np.arange(FITTED) * T
    _, velocity, start = np.polyfit(t, position[:FITTED], 2)
    return float(start), float(velocity)

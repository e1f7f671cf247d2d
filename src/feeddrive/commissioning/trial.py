"""The closed-loop trial: the same motion simulated and measured, and the same figures of both.

following error    e = set position - reading of the load encoder, over the motion without a force
deflection         largest |x with the force - x without it|, over the pulse and half its length
stiffness          force / deflection: friction, which is in both runs, is not in the difference
noise              RMS of force and reading at rest before the motion
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace

import numpy as np

from feeddrive.analysis.replay import path_of
from feeddrive.blocks.load.recorded_force import RecordedForce
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.bus.play import Profile
from feeddrive.commissioning.motions import TrialMotion
from feeddrive.files.log import Log
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import UNIT, Column, Result, Table
from feeddrive.language.text import Text, joined
from feeddrive.loop.axis import Axis
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import simulate

COMMANDED = {"force": "commanded", "velocity": "commanded_velocity"}  # column of what a control commands
AGREED = 0.1  # share by which measured and predicted may differ


@dataclass(frozen=True)
class Figures:
    """The figures of a trial: following error (m), stiffness (N/m), noise of force (N) and of the reading (m).

    Those of a gantry also have the largest skew of the motion (m), and the stiffness against a skew force (N/m).
    """

    following_rms: float
    following_peak: float
    stiffness: float
    force_noise: float
    position_noise: float
    skew_peak: float | None = None
    skew_stiffness: float | None = None

    def values(self) -> dict[str, float]:
        """Return the figures that are there, by name."""
        return {name: value for name, value in asdict(self).items() if value is not None}


UNITS = {
    "following_rms": ("following error, RMS", "m"),
    "following_peak": ("following error, largest", "m"),
    "stiffness": ("stiffness against a pulse of force", "N/m"),
    "force_noise": ("noise of the force at rest, RMS", "N"),
    "position_noise": ("noise of the position at rest, RMS", "m"),
    "skew_peak": ("skew, largest", "m"),
    "skew_stiffness": ("stiffness against a pulse of skew", "N/m"),
}

JUDGED = {"following_rms": "following error", "stiffness": "stiffness", "skew_stiffness": "stiffness against skew"}


def figures(motion: TrialMotion, alone: Log, pushed: Log) -> Figures:
    """Return the figures of a trial from the logs of both runs, measured or simulated."""
    error = alone["set_position"] - alone["reading_load"]
    moving = error[motion.moving]
    # both runs begin where the axis stands, which need not be the same count
    first, second = (log["reading_load"] - log["set_position"] for log in (alone, pushed))
    apart = (second - first)[motion.pulsed]
    begin = (second - first)[max(0, motion.pulsed.start - 10) : motion.pulsed.start]
    deflection = float(np.max(np.abs(apart - np.mean(begin))))
    force = acting_force(alone)
    return Figures(
        following_rms=float(np.sqrt(np.mean(moving**2))),
        following_peak=float(np.max(np.abs(moving))),
        stiffness=motion.force / deflection if deflection else float("inf"),
        force_noise=float(np.std(force[motion.rest])),
        position_noise=float(np.std(alone["reading_load"][motion.rest])),
    )


def acting_force(log: Log) -> np.ndarray:
    """Return the force of a log, N: that which a control of ours commanded, or the one that the drive tells, where it
    makes the force by itself.
    """
    ours = "commanded" in log.channels and "commanded_velocity" not in log.channels
    return log["commanded"] if ours else log["force"]


def filled(log: Log) -> Log:
    """Return a log whose readings of lost frames lie on straight lines between their neighbors, not at the last one."""
    if "lost" not in log.channels:
        return log
    there = log["lost"] == 0.0
    rows = np.arange(len(log))
    channels = {
        name: np.interp(rows, rows[there], values[there]) if name in _READ and np.any(there) else values
        for name, values in log.channels.items()
    }
    return replace(log, channels=channels)


_READ = ("reading_load", "reading_motor", "velocity_load", "force")  # columns that a frame carries back


def predicted(loop: Loop, played: Profile, increment: float, noise: float, *, seed: int = 0) -> Log:
    """Return the log of a profile as the loop is predicted to answer it, with counts and noise of the encoders (m).

    A drive that is commanded by velocities makes the force by itself: its log has both, as that of `play`.
    """
    real = replace(loop, axis=counted(loop.axis, increment, noise))
    T = float(loop.sample_time)
    inner = real.axis.actuator.velocity_loop
    added = played.excitation
    if inner is not None and played.unit == "N":
        added = inner.equivalent(played.excitation, T)
    # a law that is switched on begins with the force that acts, which carries a hanging axis
    enable = None if real.control.guard is None else (np.arange(played.set_position.size) > 0).astype(float)
    run = simulate(
        real,
        path_of(real.control, played.set_position, T),
        added_force=RecordedForce(force=added, sample_time=T) if np.any(added) else None,
        enable=enable,
        seed=seed,
        record=["set_position", "reading_load", "force", "drive_force", "velocity_load", "velocity_motor"],
        name=played.name,
    )
    rows = slice(0, played.set_position.size)
    command = run["force"][rows]
    force = command if inner is None else run["drive_force"][rows]
    pushed = played.excitation[: force.size]
    channels = {
        "set_position": run["set_position"][rows],
        "reading_load": run["reading_load"][rows],
        "velocity_load": run["velocity_load"][rows],
        "velocity_motor": run["velocity_motor"][rows],
        "force": force,
        "commanded": force + pushed if inner is None else pushed if played.unit == "N" else 0.0 * pushed,
        "excitation": pushed,
    }
    units = {
        "set_position": "m",
        "reading_load": "m",
        "velocity_load": "m/s",
        "velocity_motor": "m/s",
        "force": "N",
        "commanded": "N",
        "excitation": played.unit,
    }
    if inner is not None:
        channels["commanded_velocity"] = command + (pushed if played.unit == "m/s" else 0.0)
        units["commanded_velocity"] = "m/s"
    return Log(name=played.name, time=run.time[rows], channels=channels, units=units, sample_time=T)


def counted(axis: Axis, increment: float, noise: float) -> Axis:
    """Return an axis with counts and noise of its encoders, m."""
    there = [name for name in ("encoder_load", "encoder_motor") if name == "encoder_load" or getattr(axis, name)]
    return replace(axis, **{name: _counted(getattr(axis, name), increment, noise) for name in there})


def _counted(sensor: object, increment: float, noise: float) -> Encoder:
    base = sensor if isinstance(sensor, Encoder) else Encoder()
    return replace(base, resolution=increment or None, noise=noise or None)


@dataclass(frozen=True, eq=False, repr=False)
class Trial(Result):
    """A trial: predicted and measured figures of the new control, and those of the control before, where it ran."""

    predicted: Figures
    measured: Figures
    before: Figures | None = None

    def ratio(self, name: str) -> float:
        """Return measured over predicted of a figure."""
        wanted = float(getattr(self.predicted, name))
        return float(getattr(self.measured, name)) / wanted if wanted else float("inf")

    @property
    def agrees(self) -> bool:
        """True if following error (RMS) and stiffness, that against skew as well, lie within 10 % of their
        predictions.
        """
        return all(abs(self.ratio(name) - 1.0) <= AGREED for name in self._judged)

    @property
    def _judged(self) -> dict[str, str]:
        return {name: said for name, said in JUDGED.items() if name in self.predicted.values()}

    def sentence(self) -> str:
        """Return how near the judged figures are to their predictions, as a clause."""
        said = [Text(f"{words} {Quantity(self.ratio(name), 'share'):3}") for name, words in self._judged.items()]
        return Text(f"{joined(', ', said[:-1])} and {said[-1]} of what was predicted")

    @property
    def is_worse(self) -> bool:
        """True if the control before has both the smaller following error and the larger stiffness."""
        before, now = self.before, self.measured
        return before is not None and (before.following_rms < now.following_rms and before.stiffness > now.stiffness)

    def table(self) -> Table:
        """Return a table of the figures: predicted, measured, their ratio, and before."""
        rows = []
        for name in self.predicted.values():
            title, unit = UNITS[name]
            values = [Quantity(getattr(which, name), unit) for which in (self.predicted, self.measured)]
            before = "-" if self.before is None else Quantity(getattr(self.before, name), unit)
            ratio = self.ratio(name)
            rows.append([title, *values, Quantity(ratio) if np.isfinite(ratio) else "-", before, UNIT])
        heads = [
            "trial",
            Column("predicted", form="4"),
            Column("measured", form="4"),
            Column("ratio", form="3"),
            Column("before", form="4"),
            "unit",
        ]
        return Table("Closed-loop trial", heads, rows)

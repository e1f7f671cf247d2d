"""What the first moves of an unknown drive tell: holding force, friction, sign of the force, and a rough mass.

Nothing of the drive's control is assumed but that it holds the axis: forces are those that the drive reports.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from feeddrive.commissioning.motions import Push
from feeddrive.files.log import Log
from feeddrive.language.errors import NotIdentifiableError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text

_FOLLOWS = 0.5  # of the set travel, that the reading makes at least
_EVEN = 0.99  # of the largest set speed: rows of even motion
_MOST = 0.999  # of the rows of even motion: a single reading may be noise
SCATTER = 0.5  # of the mass, that its lines may scatter: the start law bears 20 % of the mean, of nine lines
RULER, PROTRACTOR = 2e-4, 2e-3  # m and rad that a person reads off, with a tenth of a mm and of a degree
_READ = 5e-3  # share of a distance that is read besides


@dataclass(frozen=True)
class SmallMove:
    """What a slow move told.

    holding   mean of the forces of both directions, N: the weight of a vertical axis; at rest friction may hold it
    friction  half the difference of the forces of both directions, N; negative if forces count against positions
    resistance  largest force of the slow move, N: weight, friction and cogging together
    lag       following error over speed, s: the inverse of the position gain without feedforward
    noise     RMS of the reading at rest, m
    """

    holding: float
    friction: float
    resistance: float
    lag: float
    noise: float


def small_move(log: Log) -> SmallMove:
    """Return what a slow move to and fro told from its log.

    Raises NotIdentifiableError if the reading did not follow the set position, or moved against it.
    """
    target, reading = log["set_position"], log["reading_load"]
    rest = slice(0, int(np.argmax(target != target[0])))
    moved, wanted = float(np.ptp(reading)), float(np.ptp(target))
    speed = np.gradient(target, log.sample_time)
    forth, back = (way * speed >= _EVEN * float(np.max(np.abs(speed))) for way in (1.0, -1.0))
    follows = float(np.polyfit(target - target[0], reading - reading[0], 1)[0])
    if not _FOLLOWS < follows < 1.0 / _FOLLOWS:
        raise NotIdentifiableError(
            Text(
                f"the set position moved by {Quantity(wanted, 'm'):SI} and the reading by {Quantity(moved, 'm'):SI}: "
                "the drive does not follow, or another encoder is read; look at 0x6064 and the scaling of the drive"
            )
        )
    error = target - reading
    return SmallMove(
        holding=0.5 * float(np.median(log["force"][forth]) + np.median(log["force"][back])),
        friction=0.5 * float(np.median(log["force"][forth]) - np.median(log["force"][back])),
        resistance=float(np.quantile(np.abs(log["force"][forth | back]), _MOST)),
        lag=max(0.0, 0.5 * float(np.median(error[forth]) - np.median(error[back])) / float(np.max(speed))),
        noise=float(np.std(reading[rest])),
    )


@dataclass(frozen=True)
class RoughMass:
    """A rough mass, kg, with the sign of the force, +1 or -1, and the scatter of the lines as a share of the mass."""

    mass: float
    force_sign: int
    scatter: float


def rough_mass(log: Log, made: Push) -> RoughMass:
    """Return the mass at the lines of a push, from the force that the drive reports:  M = Re(-F / (ω² X)).

    Raises NotIdentifiableError if the lines contradict each other: no force, or no motion that it causes.
    """
    count = (len(log) - made.first) // made.period
    rows = slice(made.first, made.first + min(count, _whole(log, made)) * made.period)
    force, reading = log["force"][rows], log["reading_load"][rows]
    # the even motion underneath has lines of its own
    time = np.arange(reading.size) * log.sample_time
    reading = reading - np.polyval(np.polyfit(time, reading, 1), time)
    periods = reading.size // made.period
    bins = made.lines * periods
    F, X = np.fft.rfft(force)[bins], np.fft.rfft(reading)[bins]
    omega = 2.0 * np.pi * made.lines / (made.period * log.sample_time)
    masses = np.real(-F / (omega**2 * X))
    mass = float(np.median(masses))
    scatter = float(np.median(np.abs(masses - mass))) / abs(mass) if mass else float("inf")
    if not scatter <= SCATTER:
        raise NotIdentifiableError(
            Text(
                f"the lines of the push give masses from {Quantity(float(np.min(masses)), 'kg'):3} to "
                f"{Quantity(float(np.max(masses)), 'kg'):3}: the force that the drive reports (0x6077) does not move "
                "the axis as a mass; look at the torque objects, a clamped axis, or friction far above the force"
            )
        )
    return RoughMass(abs(mass), 1 if mass > 0.0 else -1, scatter)


def _whole(log: Log, made: Push) -> int:
    """Return the number of whole periods of full height."""
    active = np.flatnonzero(log["excitation"])
    return max(1, (int(active[-1]) + 1 - made.first) // made.period - 1)


def ratio_by_ruler(measured: float, expected: float, *, rotary: bool = False) -> float:
    """Return the true length of one counted metre, from a distance by ruler (m) and by the drive's counts (m).

    What the ruler cannot tell from 1 is 1.
    """
    ratio = measured / expected
    accuracy = (PROTRACTOR if rotary else RULER) / abs(expected) + _READ
    return 1.0 if abs(ratio - 1.0) <= accuracy else ratio

"""Plausible ranges of travel, speed, acceleration, mass and force of feed drives, and how far a log exceeds them.

A log whose unit is wrong by a factor of 1000 can be fitted as well as a correct one; only the magnitudes reveal the
error. The bounds are wide: a log outside them has a wrong unit or is not from a feed drive.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from feeddrive.identification.regression import SHAFT, TABLE, TURNING, Frame
from feeddrive.language.errors import FeeddriveError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text, joined

# s: differences over such times are hardly affected by encoder counts
_SPEED_OVER = 5e-3
_ACCELERATION_OVER = 1e-2


@dataclass(frozen=True)
class Range:
    """The plausible range of a quantity of feed drives in `unit`, its usual magnitude, and the reason for the bounds.

    position, force  exponents with which the quantity scales with the position and the force of a log
    """

    quantity: str
    least: float
    usual: float
    most: float
    unit: str
    position: int
    force: int
    source: str

    def apart(self, value: float) -> float:
        """Return the distance of a value from the range in decades, which is 0 inside it."""
        if not value > 0.0:
            return 0.0 if value == 0.0 and self.least == 0.0 else math.inf
        return max(0.0, math.log10(value / self.most), math.log10(self.least / value) if self.least > 0.0 else 0.0)

    def unusual(self, value: float) -> float:
        """Return the distance of a value from the usual magnitude in decades."""
        return abs(math.log10(value / self.usual)) if value > 0.0 else 0.0

    def bounds(self) -> Text:
        """Return the range as text: `20 um to 60 m`."""
        most = spoken(self.most, self.unit)
        return Text(f"{spoken(self.least, self.unit)} to {most}" if self.least > 0.0 else f"up to {most}")


RANGES = {
    TABLE: (
        Range("travel", 1e-8, 0.3, 100.0, "m", 1, 0,
              "screws and linear motors: a few m; rack and pinion of the longest gantries: some 60 m"),
        Range("speed", 1e-8, 0.3, 10.0, "m/s", 1, 0,
              "screws 1.7 m/s (100 m/min), linear motors on machine tools 2 to 5 m/s"),
        Range("acceleration", 1e-4, 3.0, 300.0, "m/s2", 1, 0,
              "screws up to 20 m/s² (2 g), linear motors up to 100 m/s² (10 g); three times that for what noise adds"),
        Range("force", 1.0, 500.0, 5e5, "N", 0, 1,
              "guideways and seals of the smallest slide take some N; twin drives of portal machines some 100 kN"),
        Range("mass", 0.3, 200.0, 2e5, "kg", -1, 1,
              "slides of small stages 0.5 kg and more; portals 100 t, with the rotors' inertia at the table"),
        Range("force over mass", 0.02, 5.0, 500.0, "m/s2", 1, 0,
              "friction alone is 0.003 to 0.3 of the weight; the largest acceleration with friction on top"),
    ),
    SHAFT: (
        Range("travel", 1e-5, 60.0, 1e6, "rad", 1, 0, "from a hundredth of a degree to some 100,000 turns"),
        Range("speed", 1e-5, 100.0, 1300.0, "rad/s", 1, 0, "servo motors up to 12,000 rpm; rotary tables far less"),
        Range("acceleration", 1e-3, 1e3, 3e5, "rad/s2", 1, 0, "small servo motors reach 1e5 rad/s² without a load"),
        Range("torque", 1e-4, 2.0, 5e4, "N m", 0, 1, "from motors of 10 W to torque motors of large rotary tables"),
        Range("inertia", 1e-8, 1e-3, 1e5, "kg m2", -1, 1, "rotors of 10 W motors to tables of large lathes"),
        Range("torque over inertia", 1e-2, 1e3, 1e6, "rad/s2", 1, 0, "the largest acceleration with friction on top"),
    ),
}  # fmt: skip
# the ranges of a shaft include those of rotary tables
RANGES[TURNING] = RANGES[SHAFT]


def spoken(value: float, unit: str) -> Quantity:
    """Return a magnitude with three digits, small lengths in mm and um, large forces in kN: `125 mm/s`, `0.095 kg`."""
    shown = "SI"
    if unit in ("m", "m/s") and 0.0 < abs(value) < 1.0:
        shown = f"{'u' if abs(value) < 1e-3 else 'm'}{unit}"
    elif unit == "N" and abs(value) >= 1e4:
        shown = "kN"
    return Quantity(value, unit, form=f"3 {shown}")


def sizes(
    frame: Frame,
    sample_time: float,
    position: np.ndarray | None,
    force: np.ndarray | None,
    mass: float | None = None,
) -> dict[str, float]:
    """Return travel, speed, acceleration, largest force and, if identifiable, mass, by the names of `RANGES`.

    position, force  channels of the log, m and N, or rad and N m, shape (n,)
    mass      mass in kg or kg m2, if already known
    """
    names = [limits.quantity for limits in RANGES[frame]]
    magnitudes: dict[str, float] = {}
    if position is not None and position.size > 2:
        magnitudes[names[0]] = float(np.ptp(position))
        near, far = (max(1, round(over / sample_time)) for over in (_SPEED_OVER, _ACCELERATION_OVER))
        if position.size > 2 * far:
            magnitudes[names[1]] = float(np.max(np.abs(position[near:] - position[:-near]))) / (near * sample_time)
            # a second difference over samples would be encoder counts over T²
            bent = position[2 * far :] - 2.0 * position[far:-far] + position[: -2 * far]
            magnitudes[names[2]] = float(np.max(np.abs(bent))) / (far * sample_time) ** 2
    if force is not None and force.size:
        magnitudes[names[3]] = float(np.max(np.abs(force)))
    if position is not None and force is not None:
        mass = _mass(frame, sample_time, position, force) if mass is None else mass
        if mass is not None:
            magnitudes |= {names[4]: mass, names[5]: magnitudes[names[3]] / mass}
    return magnitudes


def _mass(frame: Frame, sample_time: float, position: np.ndarray, force: np.ndarray) -> float | None:
    """Return the mass from the inverse dynamics, whatever the sign of the force; None if it is not identifiable."""
    # imported late: most readers of a log ask only for the ranges
    from feeddrive.identification.motion.motion_log import MotionLog
    from feeddrive.identification.motion.rigid import identify_rigid

    # an inverted force is another fault, with a message of its own: here only the magnitude counts
    for sign in (1.0, -1.0):
        try:
            log = MotionLog(
                name="", position=position, force=sign * force, sample_time=sample_time, rotary=frame is not TABLE
            )
            return identify_rigid(log, friction="symmetric")["mass"].value
        except FeeddriveError:
            continue
    return None


def scaled(frame: Frame, magnitudes: Mapping[str, float], position: float, force: float) -> dict[str, float]:
    """Return the magnitudes that result if position and force are multiplied by these factors."""
    return {
        limits.quantity: magnitudes[limits.quantity] * position**limits.position * force**limits.force
        for limits in RANGES[frame]
        if limits.quantity in magnitudes
    }


def outside(frame: Frame, magnitudes: Mapping[str, float]) -> list[Range]:
    """Return the ranges that the magnitudes violate, the worst first."""
    apart = [
        (limits.apart(magnitudes[limits.quantity]), limits) for limits in RANGES[frame] if limits.quantity in magnitudes
    ]
    return [limits for decades, limits in sorted(apart, key=lambda pair: -pair[0]) if decades > 0.0]


def out_of_range(wrong: Sequence[Range], magnitudes: Mapping[str, float]) -> Text:
    """Return the magnitudes outside their range as text, which is empty if there are none."""
    return joined(
        "; ",
        (
            f"the {limits.quantity} is {spoken(magnitudes[limits.quantity], limits.unit)}, where feed drives have "
            f"{limits.bounds()}"
            for limits in wrong[:3]
        ),
    )


def remedy(wrong: Sequence[Range]) -> str:
    """Return the advice to check the unit of the channel that determines the worst quantity."""
    worst = wrong[0]
    both = worst.position != 0 and worst.force != 0
    return (
        f"check unit and factor of {'position and force' if both else 'the force' if worst.force else 'the position'}"
    )


def unlikely(frame: Frame, magnitudes: Mapping[str, float]) -> tuple[float, float]:
    """Return two measures of implausibility: decades outside the ranges, squared distance from usual magnitudes."""
    there = [(limits, magnitudes[limits.quantity]) for limits in RANGES[frame] if limits.quantity in magnitudes]
    # the decades come first: no usual magnitude outweighs an impossible one
    return sum(limits.apart(value) for limits, value in there), sum(
        limits.unusual(value) ** 2 for limits, value in there
    )

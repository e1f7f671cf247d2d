"""The limits of a machine's axes: velocity to snap, travel, and resolution of the encoder.

[axis.x.limits]                    # in a machine file, or in a file of its own
velocity_mm_per_s = 500
acceleration_mm_per_s2 = 5000
jerk_mm_per_s3 = 1e5                # absent, or inf: no limit
snap_mm_per_s4 = 5e7                # absent, or inf: no limit
travel_least_mm = 0                # soft limits, in machine coordinates; absent for none
travel_most_mm = 600

[axis.c.limits]                    # a, b and c are rotary axes
velocity_rpm = 60                  # deg_per_s, rad_per_s ... are equivalent
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from feeddrive.language.block import Block, Number, Rule, parameter
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.loop.guard import travel_rules
from feeddrive.path.geometry.weights import ANGLE_TOLERANCE, ROTARY

if TYPE_CHECKING:
    from feeddrive.path.program.moves import Move

DERIVATIVES = ("velocity", "acceleration", "jerk", "snap")
FARTHEST = 1e6
"""The largest magnitude of a coordinate, m or rad."""
LETTERS = "XYZABCUVW"
"""The axis letters of a part program."""
ROUNDING = 1e-12
"""The largest gap between consecutive positions that the proof accepts, and the smallest path tolerance, m."""
LARGEST = 1.0
"""The largest path tolerance, m."""
LEAST_ANGLE, LARGEST_ANGLE = 1e-9, math.radians(10.0)
"""The smallest and the largest tolerance of a rotary axis, rad."""
FEED, NONE, STANDSTILL = "feed", "no limit above half", "standstill"


class AxisLimits(Block):
    """The limits of one axis for planned motions: |q'| .. |q''''| in continuous time, and the travel."""

    velocity: Number = parameter("m/s", "largest speed of the axis", above=0)
    acceleration: Number = parameter("m/s2", "largest acceleration", above=0)
    jerk: Number = parameter("m/s3", "largest jerk; absent for no limit", above=0, infinite=True, default=math.inf)
    snap: Number = parameter(
        "m/s4",
        "largest snap, the time derivative of the jerk; absent for no limit",
        above=0,
        infinite=True,
        default=math.inf,
    )
    travel_least: Number | None = parameter("m", "lower end of the travel; absent for none", default=None)
    travel_most: Number | None = parameter("m", "upper end of the travel; absent for none", default=None)
    resolution: Number | None = parameter(
        "m", "of the position; absent: that of the axis's encoder", above=0, default=None
    )
    tolerance: Number | None = parameter(
        "m",
        "of a rotary axis where corners are rounded (G64 P is that of lengths); absent: 0.05 deg",
        above=0,
        default=None,
    )

    def rules(self) -> Iterator[Rule]:
        """Check that the lower end of the travel lies below the upper end, if both are given."""
        yield from travel_rules("limits", self.travel_least, self.travel_most)


@dataclass(frozen=True)
class MachineLimits:
    """The limits of all axes, by letter: X, Y, Z ..., in the order of the setpoints."""

    axes: Mapping[str, AxisLimits]

    def __post_init__(self) -> None:
        for letter in self.axes:
            if len(letter) != 1 or letter not in LETTERS:
                raise ParameterError(
                    f"axis '{letter}' is none of a part program: the axes that are planned are {', '.join(LETTERS)}"
                )
        if not self.axes:
            raise ParameterError("a plan needs the limits of at least one axis")
        for letter, axis in self.axes.items():
            self._check_tolerance(letter, axis)

    @staticmethod
    def _check_tolerance(letter: str, axis: AxisLimits) -> None:
        """Raise ParameterError for a tolerance of an axis that is not rotary, is too large, or is not resolved."""
        if axis.tolerance is None:
            return
        name, tolerance = f"axis '{letter.lower()}': limits.tolerance", Quantity(axis.tolerance, "rad")
        if letter not in ROTARY:
            raise ParameterError(
                f"{name} is for axes that turn ({', '.join(ROTARY.lower())}): the program states that of linear axes "
                "by G64 P, or --tolerance where it states none"
            )
        if axis.tolerance > LARGEST_ANGLE:
            raise ParameterError(
                Text(f"{name} = {tolerance:deg} is more than {Quantity(LARGEST_ANGLE, 'rad'):deg}: give a smaller one")
            )
        least = max(float(axis.resolution or 0.0), LEAST_ANGLE)
        if axis.tolerance < least:
            what = "the resolution of the axis" if axis.resolution == least else "what the planner resolves"
            raise ParameterError(
                Text(
                    f"{name} = {tolerance:deg} is smaller than {what}, {Quantity(least, 'rad'):deg}: give a larger one"
                )
            )

    @property
    def letters(self) -> str:
        """The letters of the axes, such as XYZ."""
        return "".join(self.axes)

    @property
    def rotary(self) -> bool:
        """True if any axis is rotary."""
        return any(letter in ROTARY for letter in self.axes)

    @property
    def shown(self) -> list[tuple[float, str]]:
        """The factor from m or rad to the displayed unit of positions, and this unit (mm or degrees), for each axis."""
        return [(math.degrees(1.0), "deg") if letter in ROTARY else (1e3, "mm") for letter in self.axes]

    @property
    def array(self) -> np.ndarray:
        """The limits of velocity to snap of each axis, m/s .. m/s⁴ (rad/s .. rad/s⁴), shape (N, 4)."""
        rows = [(axis.velocity, axis.acceleration, axis.jerk, axis.snap) for axis in self.axes.values()]
        return np.array(rows, float)

    def less(self, reserve: Sequence[float]) -> MachineLimits:
        """Return the limits less a share of velocity, acceleration, jerk and snap, which is kept back."""
        kept = [1.0 - share for share in reserve]

        def lower(axis: AxisLimits) -> AxisLimits:
            values = (axis.velocity, axis.acceleration, axis.jerk, axis.snap)
            velocity, acceleration, jerk, snap = (share * value for share, value in zip(kept, values, strict=True))
            return replace(axis, velocity=velocity, acceleration=acceleration, jerk=jerk, snap=snap)

        return MachineLimits({letter: lower(axis) for letter, axis in self.axes.items()})

    @property
    def travel(self) -> dict[str, tuple[float, float] | None]:
        """The soft limits in the form `read_program` expects; a missing limit is replaced by -1e6 or 1e6 m."""
        return {letter: _travel(axis) for letter, axis in self.axes.items()}

    @property
    def angle_tolerances(self) -> np.ndarray:
        """The tolerance of each rotary axis, rad, and infinity for linear axes, shape (N,)."""
        return np.array(
            [
                math.inf
                if letter not in ROTARY
                else ANGLE_TOLERANCE
                if axis.tolerance is None
                else float(axis.tolerance)
                for letter, axis in self.axes.items()
            ]
        )

    def turning_within(self, tolerance: float) -> MachineLimits:
        """Return the limits with the same tolerance, rad, for all rotary axes."""
        return MachineLimits(
            {
                letter: replace(axis, tolerance=tolerance) if letter in ROTARY else axis
                for letter, axis in self.axes.items()
            }
        )

    @property
    def causes(self) -> list[str]:
        """The possible limiting causes of a motion: each limit of each axis, the feed, none, or a standstill."""
        return [*(f"{what} of {letter}" for letter in self.axes for what in DERIVATIVES), FEED, NONE, STANDSTILL]

    def named(self, text: str) -> str:
        """Replace axis numbers of the planner, such as `axis 0`, by the letters of the axes."""
        # the planner knows axes as rows of arrays only, so its messages number them
        return re.sub(r"\baxis (\d+)", lambda match: f"axis {self.letters[int(match[1])]}", text)

    def resolved(self, moves: Iterable[Move]) -> Iterator[Move]:
        """Yield the moves unchanged; refuse a path tolerance that is too large, or smaller than the resolution of an
        axis or rounding errors.

        Raises ProgramError at the line of an unsuitable tolerance.
        """
        # imported late: machines are also read where nothing is planned
        from feeddrive.path.program.blocks import BlockError, located
        from feeddrive.path.program.moves import PathMode

        for move in moves:
            unfit = self.unfit(move.tolerance) if isinstance(move, PathMode) else ""
            if unfit:
                raise located(move.source, BlockError(unfit, "P"))
            yield move

    def unfit(self, tolerance: float) -> str:
        """Return the reason why a path tolerance, m, is unsuitable, or an empty string if it is suitable.

        It must not be too large, nor smaller than the resolution of a linear axis or the rounding of positions.
        """
        if tolerance > LARGEST:
            return Text(
                f"the tolerance of {Quantity(tolerance, 'm'):mm} is more than {Quantity(LARGEST, 'm'):6 mm}: give a "
                "smaller one"
            )
        # rotary axes are left out: a tolerance is a length, their resolution an angle
        resolutions = {
            letter: float(axis.resolution or 0.0) for letter, axis in self.axes.items() if letter not in ROTARY
        }
        coarse = max(resolutions, key=lambda letter: resolutions[letter], default="")
        resolved = resolutions.get(coarse, 0.0)
        resolution = max(resolved, ROUNDING)
        if not 0.0 < tolerance < resolution:
            return ""
        what = f"the resolution of axis {coarse}" if resolved >= ROUNDING else "the rounding of positions"
        return Text(
            f"the tolerance of {Quantity(tolerance, 'm'):mm} is smaller than {what}, {Quantity(resolution, 'm'):mm}: "
            "give a larger one"
        )


def _travel(limits: AxisLimits) -> tuple[float, float] | None:
    least, most = limits.travel_least, limits.travel_most
    if least is None and most is None:
        return None
    # the reader compares with two finite ends and has no one-sided travel
    return -FARTHEST if least is None else float(least), FARTHEST if most is None else float(most)

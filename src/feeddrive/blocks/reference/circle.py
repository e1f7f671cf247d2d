"""The motion of one axis along a circle."""

import numpy as np

from feeddrive.blocks.families import Reference
from feeddrive.blocks.reference.derivatives import resting, sine_of, stretched
from feeddrive.blocks.reference.smooth_step import run_up_angle
from feeddrive.blocks.sampled import check_duration, check_single
from feeddrive.blocks.signals import Setpoint
from feeddrive.language.block import Number, choice, parameter
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity


class Circle(Reference):
    """The motion x = center + radius · cos(θ(t) - phase), with an angle θ from 0 to ± 2π · turns.

    The speed along the circle rises from 0 to `feed` in `run_up_time` along a seventh-degree polynomial, is then
    constant, and falls in the same way; all derivatives up to the snap are thus continuous, and the circle takes 2π
    radius turns / feed + run_up_time.  Two axes with phases of 0 and 90 degrees and otherwise equal parameters trace
    the circle, which starts at (radius, 0) relative to its center.
    Raises ParameterError if run-up and run-down do not fit into the turns.
    """

    radius: Number = parameter("m", "radius of the circle", above=0)
    feed: Number = parameter("m/s", "speed along the circle", above=0)
    turns: Number = parameter("", "number of turns, whole or not", default=1, above=0)
    phase: int = choice(
        "degrees by which this axis lags: 0 for the cosine, 90 for the sine", options=(0, 90), default=0
    )
    direction: str = choice("sense of rotation", options=("counterclockwise", "clockwise"), default="counterclockwise")
    center: Number = parameter("m", "coordinate of the center", default=0)
    run_up_time: Number | None = parameter(
        "s",
        "how long the speed rises, and falls; absent: a quarter turn each, at most half of all turns",
        above=0,
        default=None,
    )

    def check(self) -> None:
        """Raise ParameterError unless run-up and run-down fit into the turns."""
        check_single(self)
        check_duration(self.kind, self.duration)
        at_feed = self._time_at_feed()
        if self.run_up_time is not None and self.run_up_time > at_feed:
            raise ParameterError(
                f"circle.run_up_time = {Quantity(self.run_up_time, 's'):6 SI} must be <= "
                f"{Quantity(at_feed, 's'):6 SI}, the time of all turns at the feed: make it shorter, or the turns more"
            )

    def _time_at_feed(self) -> float:
        return 2.0 * np.pi * self.radius * self.turns / self.feed

    def _run_up(self) -> float:
        if self.run_up_time is not None:
            return self.run_up_time
        return min(np.pi * self.radius / self.feed, self._time_at_feed())

    @property
    def duration(self) -> float:
        """The duration of all turns with run-up and run-down, s."""
        return self._time_at_feed() + self._run_up()

    def at(self, t: np.ndarray) -> Setpoint:
        times = np.asarray(t, dtype=np.float64)
        turned = 2.0 * np.pi * self.turns * (1.0 if self.direction == "counterclockwise" else -1.0)
        angle, *rates = run_up_angle(np.clip(times, 0.0, self.duration), turned, self.duration, self._run_up())
        # cos(θ - phase) = sin(θ + π/2 - phase): one rule for the derivatives of both
        ahead = 0.0 if self.phase == 90 else 0.5 * np.pi
        moved = stretched(sine_of((angle + ahead, *rates)), self.radius, 1.0)  # type: ignore[arg-type]
        first, last = (self.center + self.radius * np.sin(end + ahead) for end in (0.0, turned))
        return resting(times, self.duration, (self.center + moved[0], *moved[1:]), first, last)

"""The drive between the commanded and the acting force."""

from __future__ import annotations

from feeddrive.blocks.families import Motor
from feeddrive.language.block import Block, Number, parameter, part


class Actuator(Block):
    """Dead time, then the current loop as a first-order lag, both exact.

        f' = 2π current_loop (force(t - dead_time) - f)

    The lag is part of the linear core and held exactly; the dead time may be any real number of samples.  Without
    `current_loop` the force follows at once.  `motor` states the drive's own unit and limits for files and reports.
    """

    dead_time: Number = parameter("s", "from the sampling instant to the force that answers it", least=0, default=0)
    current_loop: Number | None = parameter(
        "Hz", "bandwidth of the current loop; absent for an ideal one", above=0, default=None
    )
    motor: Motor | None = part("what makes the force", default=None)

"""The actuator: current loop and dead time between the commanded and the acting force."""

from feeddrive.blocks.actuator.velocity_loop import VelocityLoop
from feeddrive.blocks.families import Motor
from feeddrive.language import ops
from feeddrive.language.block import Block, Number, parameter, part
from feeddrive.language.errors import StructureError


class Actuator(Block):
    """A dead time followed by the current loop as a first-order lag; neither is approximated.

        f' = 2π current_loop (force(t - dead_time) - f)

    The lag is part of the linear core and is discretized exactly; the dead time may be any real number of samples.
    Without `current_loop` the force follows at once.  `motor` provides the unit of the drive's command and the drive's
    limits for files and reports.

    With `velocity_loop` the drive closes a velocity loop by itself, and its command is a velocity in m/s: the dead time
    is that of this command, and the current loop is part of the velocity loop.
    """

    dead_time: Number = parameter("s", "from the sampling instant to the force that answers it", least=0, default=0)
    current_loop: Number | None = parameter(
        "Hz", "bandwidth of the current loop; absent for an ideal one", above=0, default=None
    )
    motor: Motor | None = part("what makes the force", default=None)
    velocity_loop: VelocityLoop | None = part(
        "velocity loop of the drive, whose command is a velocity; absent for a drive that takes a force", default=None
    )

    @property
    def commanded(self) -> str:
        """What the drive takes: "force", in N, or "velocity", in m/s."""
        return "force" if self.velocity_loop is None else "velocity"

    def check(self) -> None:
        """Raise StructureError for a current loop beside a velocity loop, which has a lag of its own."""
        if self.velocity_loop is not None and self.current_loop is not None:
            raise StructureError(
                "actuator.current_loop is outside of the drive's velocity loop: give its delay as velocity_loop.lag, s"
            )

    def delay(self) -> Number:
        """Return the delay in s for slowly changing commands: dead time plus the lag 1/(2π current_loop)."""
        # for slow commands the phase of 1/(1 + τ s) is that of a dead time τ
        lag = 0.0 if self.current_loop is None else 1.0 / (2.0 * ops.pi * self.current_loop)
        return self.dead_time + lag

"""The requests of `feeddrive identify`, for a motion log and for frequency responses."""

from __future__ import annotations

from pathlib import Path

from feeddrive.files.log import LogLike
from feeddrive.files.machine import MachineLike
from feeddrive.identification.motion.motion_log import MotionLog
from feeddrive.loop.frequency_response import FRF
from feeddrive.workflow.request import OUT, Request, argument, called, option

MODELS = ("auto", "rigid", "machine", "two-mass", "modal", "modes")


class IdentifyRequest(Request):
    """A log of one motion or a file of frequency responses, which column is what, and what is known before."""

    log: LogLike | MotionLog | FRF = argument(
        "A log of position and force of one motion, or a file of frequency responses"
    )
    machine: MachineLike | None = option("the machine file to start from; its comments are kept", default=None)
    axis: str | None = option("its axis, if it has several", default=None)
    friction: str = option("best, symmetric or directional", default="best")
    set_position: str | None = option("column of the set position, name:unit", default=None)
    position: str | None = option("column of the position, name:unit", default=None)
    force: str | None = option("column of the commanded force, name:unit", default=None)
    command: str | None = option("column of the command in the drive's unit", default=None)
    angle: str | None = option("column of the motor's angle, name:unit", default=None)
    torque: str | None = option("column of the motor's torque, name:unit", default=None)
    force_constant: float | None = option("N at the table per unit of the command", above=0.0, default=None)
    lead: float | None = option("puts angles and torques at the table", unit="m", above=0.0, default=None)
    gear: float = option("turns of the motor in one turn of the screw", default=1.0, above=0.0)
    sample_time: float | None = option("of a log without a clock", unit="s", default=None)
    time: str | None = option("column of the time, name:unit", default=None)
    channels: Path | None = option("which column is what (TOML), as `feeddrive channels` writes it", default=None)
    model: str | None = option("of frequency responses", options=MODELS, default=None)
    modes: int | None = option("how many; found if left out", default=None)
    motor: str | None = option("the motor encoder's response, by name or file", default=None)
    load: str | None = option("the load encoder's response, by name or file", default=None)
    band: str | None = option("of frequency responses, as 5..300 in Hz", default=None)
    fix: tuple[str, ...] = option("a parameter that is known, as mass_motor=85; may be repeated", default=())
    measured_input: bool = option("the responses lead from a measured force or current, not a command", default=False)
    unit: tuple[str, ...] = option(
        "of columns that state none, as mm or kN, or of responses, as um/N; may be repeated", default=()
    )
    out: Path | None = option(OUT, short="-o", default=None)

    def usual_out(self) -> Path:
        """By the name of what it is about."""
        return Path("results") / f"identify_{Path(called(self.log)).name.split('.')[0]}"

    def named(self) -> dict[str, str | None]:
        """The columns that were named, by their roles."""
        return {
            "setpoint_position": self.set_position, "position_load": self.position, "force": self.force,
            "command": self.command, "angle_motor": self.angle, "torque": self.torque, "time": self.time,
        }  # fmt: skip

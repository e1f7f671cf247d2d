"""The options of `feeddrive friction`, a thin door like those of commands.py."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from feeddrive.cli.options import (
    AxisName,
    Channels,
    Command,
    Current,
    Force,
    ForceConstant,
    Gear,
    Lead,
    MachineToWrite,
    SampleTime,
    Time,
    Torque,
)  # fmt: skip
from feeddrive.cli.out import Out


def friction(
    logs: Annotated[list[Path], typer.Argument(help="Logs of constant speeds; one log may hold several.")],
    velocity: Annotated[
        str | None,
        typer.Option("--velocity", help="Column along the table: name:unit or name*factor:unit.", show_default=False),
    ] = None,
    position: Annotated[
        str | None, typer.Option("--position", help="The position instead, to be differenced.", show_default=False)
    ] = None,
    speed: Annotated[
        str | None, typer.Option("--speed", help="Column of the motor's speed, as n:rpm.", show_default=False)
    ] = None,
    angle: Annotated[
        str | None, typer.Option("--angle", help="The motor's angle instead, to be differenced.", show_default=False)
    ] = None,
    force: Force = None,
    torque: Torque = None,
    current: Current = None,
    command: Command = None,
    force_constant: ForceConstant = None,
    lead: Lead = None,
    gear: Gear = None,
    machine: MachineToWrite = None,
    axis: AxisName = None,
    channels: Channels = None,
    time: Time = None,
    sample_time: SampleTime = None,
    out: Out = None,
) -> None:
    """Find the friction curve in runs of constant speed: models compared by evidence, parameters with errors."""
    from feeddrive.cli.friction import perform

    named = {
        "velocity_load": velocity, "position_load": position, "speed_motor": speed, "angle_motor": angle,
        "force": force, "torque": torque, "current": current, "command": command, "time": time,
    }  # fmt: skip
    perform(logs, named, channels, machine, axis, force_constant, lead, gear, sample_time, out)

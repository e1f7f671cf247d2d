"""The options of `feeddrive cogging`, a thin door like those of commands.py."""

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


def cogging(
    logs: Annotated[list[Path], typer.Argument(help="Logs of slow runs over the travel, one way or to and fro.")],
    period: Annotated[
        str | None,
        typer.Option(
            "--period",
            help="After which the force repeats, as 24:mm or 90:deg; a turn of the motor if left out.",
            show_default=False,
        ),
    ] = None,
    position: Annotated[
        str | None,
        typer.Option("--position", help="Column along the table: name:unit or name*factor:unit.", show_default=False),
    ] = None,
    angle: Annotated[
        str | None, typer.Option("--angle", help="Column of the motor's angle, as theta:deg.", show_default=False)
    ] = None,
    force: Force = None,
    torque: Torque = None,
    current: Current = None,
    command: Command = None,
    map_: Annotated[
        bool,
        typer.Option("--map", help="Not logs but maps: each row is a place, all rows are one turn, 0 was not visited."),
    ] = False,
    backward: Annotated[
        list[Path] | None,
        typer.Option("--backward", help="A map of the other direction; may be repeated.", show_default=False),
    ] = None,
    orders: Annotated[
        str | None,
        typer.Option("--orders", help="In a period, as 1..60 or 7,14,28; up to 128 if left out.", show_default=False),
    ] = None,
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
    """Find the cogging of a motor in slow runs: its orders, with errors, and what changes sign with the direction."""
    from feeddrive.cli.cogging import Asked, perform

    named = {
        "position_load": position, "angle_motor": angle, "force": force, "torque": torque, "current": current,
        "command": command, "time": time,
    }  # fmt: skip
    perform(
        logs,
        Asked(
            named=named, channels=channels, period=period, map=map_, backward=backward or (), orders=orders,
            machine=machine, axis=axis, force_constant=force_constant, lead=lead, gear=gear,
            sample_time=sample_time, out=out,
        ),
    )  # fmt: skip

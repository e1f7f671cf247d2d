"""The options of `feeddrive friction`, a thin door like those of commands.py."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from feeddrive.doors.cli.out import Out


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
    force: Annotated[
        str | None, typer.Option("--force", help="Column of the force, name:unit.", show_default=False)
    ] = None,
    torque: Annotated[
        str | None, typer.Option("--torque", help="Column of the motor's torque, name:unit.", show_default=False)
    ] = None,
    current: Annotated[
        str | None, typer.Option("--current", help="Column of the current, name:unit.", show_default=False)
    ] = None,
    command: Annotated[
        str | None, typer.Option("--command", help="Column of the command in the drive's unit.", show_default=False)
    ] = None,
    force_constant: Annotated[
        float | None,
        typer.Option("--force-constant", help="N at the table per unit of command or current.", show_default=False),
    ] = None,
    lead: Annotated[
        float | None, typer.Option("--lead", help="m; puts speeds and torques at the table.", show_default=False)
    ] = None,
    gear: Annotated[
        float | None,
        typer.Option("--gear", help="Turns of the motor in one turn of the screw; 1.", show_default=False),
    ] = None,
    machine: Annotated[
        str | None,
        typer.Option("--machine", help="The machine file to write into; its comments are kept.", show_default=False),
    ] = None,
    axis: Annotated[str | None, typer.Option("--axis", help="Its axis, if it has several.", show_default=False)] = None,
    channels: Annotated[
        Path | None,
        typer.Option(
            "--channels", help="Which column is what (TOML), as `feeddrive channels` writes it.", show_default=False
        ),
    ] = None,
    time: Annotated[
        str | None, typer.Option("--time", help="Column of the time, name:unit.", show_default=False)
    ] = None,
    sample_time: Annotated[
        float | None, typer.Option("--sample-time", help="s, of logs without a clock.", show_default=False)
    ] = None,
    out: Out = None,
) -> None:
    """Find the friction curve in runs of constant speed: models compared by evidence, parameters with errors."""
    from feeddrive.doors.cli.friction import perform

    named = {
        "velocity_load": velocity, "position_load": position, "speed_motor": speed, "angle_motor": angle,
        "force": force, "torque": torque, "current": current, "command": command, "time": time,
    }  # fmt: skip
    perform(logs, named, channels, machine, axis, force_constant, lead, gear, sample_time, out)

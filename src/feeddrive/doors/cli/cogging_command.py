"""The options of `feeddrive cogging`, a thin door like those of commands.py."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from feeddrive.doors.cli.out import Out


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
    force_constant: Annotated[
        float | None,
        typer.Option("--force-constant", help="N at the table per unit of command or current.", show_default=False),
    ] = None,
    lead: Annotated[
        float | None, typer.Option("--lead", help="m; puts angles and torques at the table.", show_default=False)
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
    """Find the cogging of a motor in slow runs: its orders, with errors, and what changes sign with the direction."""
    from feeddrive.doors.cli.cogging import Asked, perform

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

"""`feeddrive play` and `feeddrive listen`: a drive over its bus, thin skins like those of commands.py."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from feeddrive.cli.out import Out

Drive = Annotated[Path, typer.Option("--drive", help="A drive file (TOML): bus, scaling, limits.")]
Unpaced = Annotated[bool, typer.Option("--unpaced", help="As fast as the drive answers; for a virtual drive only.")]


def play(
    profiles: Annotated[list[Path], typer.Argument(help="What `feeddrive excite` wrote to be sent; one a log.")],
    drive: Drive,
    share: Annotated[float, typer.Option("--share", min=0.0, max=1.0, help="Of the excitation; begin with 0.1.")] = 1.0,
    ramp: Annotated[float, typer.Option("--ramp", min=0.0, help="s, over which it swells and fades.")] = 0.0,
    reset_fault: Annotated[bool, typer.Option("--reset-fault", help="Out of an old fault first.")] = False,
    unpaced: Unpaced = False,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask before the axis moves.")] = False,
    out: Out = None,
) -> None:
    """Move an axis: play an excitation on a drive over EtherCAT or CANopen, within limits, and log what it did."""
    from feeddrive.cli.play import perform

    perform(profiles, drive, share, ramp, reset_fault, unpaced, yes, out or Path("results") / f"play_{drive.stem}")


def listen(
    drive: Drive,
    seconds: Annotated[float, typer.Option("--seconds", min=0.001, max=3600.0, help="For how long.")] = 1.0,
    unpaced: Unpaced = False,
    out: Out = None,
) -> None:
    """Log a drive over its bus without switching it on."""
    from feeddrive.cli.play import perform_listening

    perform_listening(drive, seconds, unpaced, out or Path("results") / f"listen_{drive.stem}")

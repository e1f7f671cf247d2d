"""The options of `feeddrive cosimulate`, a thin door like those of commands.py."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from feeddrive.cli.out import Out


def cosimulate(
    job: Annotated[str, typer.Argument(help="A job file (TOML) with a reference, or the name of a bundled job.")],
    fmu: Annotated[Path, typer.Argument(help="The plant: an FMU 2.0 or 3.0. It is a program, and it is run.")],
    names: Annotated[
        list[str] | None,
        typer.Option(
            "--variable",
            help="Which variable of the FMU is what, as force=F_drive or reading=x:mm; may be repeated.",
            show_default=False,
        ),
    ] = None,
    parameters: Annotated[
        list[str] | None,
        typer.Option("--set", help="A parameter of the FMU, as m=160; may be repeated.", show_default=False),
    ] = None,
    dead_time: Annotated[float, typer.Option("--dead-time", help="s, before a command acts.")] = 0.0,
    out: Out = None,
) -> None:
    """Run the laws of a job against somebody else's model of the machine: an FMU in place of the plant."""
    from feeddrive.cli.cosimulate import perform

    perform(job, fmu, names or (), parameters or (), dead_time, out)

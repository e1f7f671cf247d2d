"""Options that several commands for logs have, each stated once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Force = Annotated[str | None, typer.Option("--force", help="Column of the force, name:unit.", show_default=False)]
Torque = Annotated[
    str | None, typer.Option("--torque", help="Column of the motor's torque, name:unit.", show_default=False)
]
Current = Annotated[str | None, typer.Option("--current", help="Column of the current, name:unit.", show_default=False)]
Command = Annotated[
    str | None, typer.Option("--command", help="Column of the command in the drive's unit.", show_default=False)
]
ForceConstant = Annotated[
    float | None,
    typer.Option("--force-constant", help="N at the table per unit of command or current.", show_default=False),
]
Gear = Annotated[
    float | None,
    typer.Option("--gear", help="Turns of the motor in one turn of the screw; 1.", show_default=False),
]
MachineToWrite = Annotated[
    str | None,
    typer.Option("--machine", help="The machine file to write into; its comments are kept.", show_default=False),
]
AxisName = Annotated[str | None, typer.Option("--axis", help="Its axis, if it has several.", show_default=False)]
Channels = Annotated[
    Path | None,
    typer.Option(
        "--channels", help="Which column is what (TOML), as `feeddrive channels` writes it.", show_default=False
    ),
]
Time = Annotated[str | None, typer.Option("--time", help="Column of the time, name:unit.", show_default=False)]
SampleTime = Annotated[
    float | None, typer.Option("--sample-time", help="s, of logs without a clock.", show_default=False)
]
Lead = Annotated[
    float | None, typer.Option("--lead", help="m; puts what stands at the motor at the table.", show_default=False)
]

"""The options of `feeddrive identify` and `feeddrive channels`, thin skins like those of commands.py."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from feeddrive.cli.out import Out


def identify(
    log: Annotated[
        Path, typer.Argument(help="A log of position and force of one motion, or a file of frequency responses.")
    ],
    machine: Annotated[
        str | None,
        typer.Option("--machine", help="The machine file to start from; its comments are kept.", show_default=False),
    ] = None,
    axis: Annotated[str | None, typer.Option("--axis", help="Its axis, if it has several.", show_default=False)] = None,
    friction: Annotated[str, typer.Option("--friction", help="best, symmetric or directional.")] = "best",
    set_position: Annotated[
        str | None, typer.Option("--set-position", help="Column of the set position, name:unit.", show_default=False)
    ] = None,
    position: Annotated[
        str | None, typer.Option("--position", help="Column of the position, name:unit.", show_default=False)
    ] = None,
    force: Annotated[
        str | None, typer.Option("--force", help="Column of the commanded force, name:unit.", show_default=False)
    ] = None,
    command: Annotated[
        str | None, typer.Option("--command", help="Column of the command in the drive's unit.", show_default=False)
    ] = None,
    angle: Annotated[
        str | None, typer.Option("--angle", help="Column of the motor's angle, name:unit.", show_default=False)
    ] = None,
    torque: Annotated[
        str | None, typer.Option("--torque", help="Column of the motor's torque, name:unit.", show_default=False)
    ] = None,
    force_constant: Annotated[
        float | None,
        typer.Option("--force-constant", help="N at the table per unit of the command.", show_default=False),
    ] = None,
    lead: Annotated[
        float | None, typer.Option("--lead", help="m; puts angles and torques at the table.", show_default=False)
    ] = None,
    gear: Annotated[float, typer.Option("--gear", help="Turns of the motor in one turn of the screw.")] = 1.0,
    sample_time: Annotated[
        float | None, typer.Option("--sample-time", help="s, of a log without a clock.", show_default=False)
    ] = None,
    time: Annotated[
        str | None, typer.Option("--time", help="Column of the time, name:unit.", show_default=False)
    ] = None,
    channels: Annotated[
        Path | None,
        typer.Option(
            "--channels", help="Which column is what (TOML), as `feeddrive channels` writes it.", show_default=False
        ),
    ] = None,
    model: Annotated[
        str | None,
        typer.Option("--model", help="auto, rigid, machine, two-mass, modal or modes.", show_default=False),
    ] = None,
    modes: Annotated[
        int | None, typer.Option("--modes", help="How many; found if left out.", show_default=False)
    ] = None,
    motor: Annotated[
        str | None,
        typer.Option("--motor", help="The motor encoder's response, by name or file.", show_default=False),
    ] = None,
    load: Annotated[
        str | None,
        typer.Option("--load", help="The load encoder's response, by name or file.", show_default=False),
    ] = None,
    band: Annotated[
        str | None, typer.Option("--band", help="Of frequency responses, as 5..300 in Hz.", show_default=False)
    ] = None,
    fix: Annotated[
        list[str] | None,
        typer.Option("--fix", help="A parameter that is known, as mass_motor=85; may be repeated.", show_default=False),
    ] = None,
    measured_input: Annotated[
        bool,
        typer.Option("--measured-input", help="The responses lead from a measured force or current, not a command."),
    ] = False,
    unit: Annotated[
        str | None, typer.Option("--unit", help="Of responses that do not say theirs, as m/N.", show_default=False)
    ] = None,
    out: Out = None,
) -> None:
    """Find mass, friction and dead time in a log, or masses and modes in frequency responses; with errors."""
    from feeddrive.cli.identify_frf import Asked, responses_in

    responses = responses_in(log)
    if responses is not None:
        from feeddrive.cli.identify_frf import perform as perform_frf

        asked = Asked(
            motor, load, model, modes, band, unit, tuple(fix or ()), measured_input, force_constant, lead, gear,
            machine, axis, out,
        )  # fmt: skip
        perform_frf(log, responses, asked)
        return
    from feeddrive.cli.identify import perform

    columns = {
        "setpoint_position": set_position, "position_load": position, "force": force, "command": command,
        "angle_motor": angle, "torque": torque, "time": time,
    }  # fmt: skip
    perform(log, machine, axis, friction, columns, channels, force_constant, lead, gear, sample_time, out)


def channels(
    log: Annotated[Path, typer.Argument(help="A log of any known format.")],
    axis: Annotated[
        str | None, typer.Option("--axis", help="Of a log with several, as x or 0.", show_default=False)
    ] = None,
    sample_time: Annotated[
        float | None, typer.Option("--sample-time", help="s, of a log without a clock.", show_default=False)
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="File for the mapping (TOML).", show_default=False)
    ] = None,
) -> None:
    """Guess which column of a log is what, and write it as a short TOML to correct and give with --channels."""
    from feeddrive.cli.roles import perform

    perform(log, axis, sample_time, out)

"""`feeddrive virtual-drive`: a simulated CiA 402 drive on a bus, to try a master on before a real axis moves."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def virtual_drive(
    machine: Annotated[str, typer.Argument(help="A machine file (TOML), or the name of a bundled machine.")],
    interface: Annotated[
        str, typer.Option("--interface", help="ethercat: veth1; canopen: socketcan:vcan0, udp_multicast:239.74.163.2.")
    ],
    axis: Annotated[
        str | None,
        typer.Option("--axis", help="The axis; ethercat: all, one a station, if left out.", show_default=False),
    ] = None,
    bus: Annotated[str, typer.Option("--bus", help="ethercat or canopen.")] = "ethercat",
    station: Annotated[int, typer.Option("--station", min=1, max=127, help="Number of the CANopen node.")] = 1,
    cycle_us: Annotated[
        float | None,
        typer.Option("--cycle-us", help="Bus cycle, us: samples of the machine file. Default: 1.", show_default=False),
    ] = None,
    position: Annotated[float, typer.Option("--position", help="m, where the axis stands.")] = 0.0,
    seed: Annotated[int, typer.Option("--seed", help="Of the noise of the encoders.")] = 0,
    watchdog_ms: Annotated[
        float | None,
        typer.Option(
            "--watchdog-ms", min=1.0, help="Fault without frames for so long, by the clock. Default: none.",
            show_default=False,
        ),
    ] = None,
    master: Annotated[
        str | None,
        typer.Option("--master", help="Interface for the drive file; default: the same.", show_default=False),
    ] = None,
    drive_file: Annotated[
        Path | None, typer.Option("--drive-file", help="Write a drive file for it here.", show_default=False)
    ] = None,
) -> None:  # fmt: skip
    """Be a CiA 402 drive with the plant and the control of a machine file inside, until Ctrl-C."""
    from feeddrive.cli.virtual_drive import perform

    perform(
        machine, axis, bus, interface, station, cycle_us, position, seed, watchdog_ms, master or interface, drive_file
    )

"""Serve a virtual drive until Ctrl-C or a termination."""

from __future__ import annotations

import signal
import sys
import threading
from pathlib import Path
from types import FrameType

from feeddrive.bus.play import ENDINGS
from feeddrive.bus.virtual.canopen_node import serve_canopen
from feeddrive.bus.virtual.described import drive_text, scaling_of
from feeddrive.bus.virtual.driven_axis import DrivenAxis
from feeddrive.bus.virtual.ethercat_slave import serve_ethercat
from feeddrive.bus.virtual.firmware import Firmware
from feeddrive.cli.terminal import open_console
from feeddrive.files.atomic_io import write_whole
from feeddrive.files.machine import read_machine
from feeddrive.language.errors import ParameterError


def perform(
    machine: str, axis: str | None, bus: str, interface: str, station: int, cycle_us: float | None, position: float,
    seed: int, watchdog_ms: float | None, master: str, drive_file: Path | None,
) -> None:  # fmt: skip
    """Read, build, serve, and say at the end how many cycles ran."""
    console = open_console()
    if bus not in ("ethercat", "canopen"):
        raise ParameterError(f"--bus {bus} must be ethercat or canopen")
    if bus == "canopen" and watchdog_ms is not None:
        raise ParameterError("--watchdog-ms is of EtherCAT; a CANopen drive faults when it is taken out of OPERATIONAL")
    held = read_machine(machine)
    several = bus == "ethercat" and axis is None
    loops = dict(held.loops) if several else {axis or "": held.loop(axis)}
    drives: dict[str, Firmware] = {}
    for name, loop in loops.items():
        cycle_time = float(loop.sample_time) if cycle_us is None else 1e-6 * cycle_us
        drives[name] = Firmware(DrivenAxis(loop, position, seed), scaling_of(loop), cycle_time)
    stop = threading.Event()

    def end(_number: int, _frame: FrameType | None) -> None:
        stop.set()

    for number in ENDINGS:
        signal.signal(number, end)
    if drive_file is not None:
        for place, (name, firmware) in enumerate(drives.items()):
            path = drive_file if len(drives) == 1 else drive_file.with_stem(f"{drive_file.stem}_{name}")
            described = (bus, master, 1 + place if bus == "ethercat" else station, firmware.cycle_time)
            write_whole(path, drive_text(loops[name], firmware.scaling, *described))
            console.print(f"Written: {path}", markup=False, soft_wrap=True)

    def ready() -> None:
        for name, firmware in drives.items():
            console.print(
                f"{f'Axis {name}: one' if name else 'One'} increment is {1e9 * firmware.scaling.metre:.6g} nm, a "
                f"thousandth of the rated torque {firmware.scaling.newton:.6g} N, a bus cycle "
                f"{1e6 * firmware.cycle_time:g} us.",
                markup=False,
                soft_wrap=True,
            )
        console.print(f"Ready on {interface}; Ctrl-C ends it.", markup=False, soft_wrap=True)
        sys.stdout.flush()

    firmwares = list(drives.values())
    if bus == "ethercat":
        watchdog = None if watchdog_ms is None else 1e-3 * watchdog_ms
        serve_ethercat(firmwares, interface, ready=ready, stopped=stop.is_set, watchdog=watchdog)
    else:
        serve_canopen(firmwares[0], interface, station, ready=ready, stopped=stop.is_set)
    states = ", ".join(f"'{each.state.words}'" for each in firmwares)
    console.print(f"{firmwares[0].cycles} cycles; last in {states}.", markup=False)

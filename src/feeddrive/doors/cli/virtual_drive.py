"""Serve a virtual drive until Ctrl-C or a termination."""

from __future__ import annotations

import signal
import sys
import threading
from pathlib import Path
from types import FrameType

from rich.console import Console

from feeddrive.artefacts.bus.virtual.canopen_node import serve_canopen
from feeddrive.artefacts.bus.virtual.described import drive_text, scaling_of
from feeddrive.artefacts.bus.virtual.driven_axis import DrivenAxis
from feeddrive.artefacts.bus.virtual.ethercat_slave import serve_ethercat
from feeddrive.artefacts.bus.virtual.firmware import Firmware
from feeddrive.artefacts.files.machine import read_machine
from feeddrive.artefacts.files.whole import write_whole
from feeddrive.language.errors import ParameterError


def perform(
    machine: str, axis: str | None, bus: str, interface: str, station: int, cycle_us: float | None, position: float,
    seed: int, watchdog_ms: float | None, master: str, drive_file: Path | None,
) -> None:  # fmt: skip
    """Read, build, serve, and say at the end how many cycles ran."""
    console = Console(highlight=False)
    if bus not in ("ethercat", "canopen"):
        raise ParameterError(f"--bus {bus} must be ethercat or canopen")
    if bus == "canopen" and watchdog_ms is not None:
        raise ParameterError("--watchdog-ms is of EtherCAT; a CANopen drive faults when it is taken out of OPERATIONAL")
    loop = read_machine(machine).loop(axis)
    scaling = scaling_of(loop)
    cycle_time = float(loop.sample_time) if cycle_us is None else 1e-6 * cycle_us
    firmware = Firmware(DrivenAxis(loop, position, seed), scaling, cycle_time)
    stop = threading.Event()

    def end(_number: int, _frame: FrameType | None) -> None:
        stop.set()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, end)
    if drive_file is not None:
        write_whole(drive_file, drive_text(loop, scaling, bus, master, station, firmware.cycle_time))
        console.print(f"Written: {drive_file}", markup=False, soft_wrap=True)

    def ready() -> None:
        console.print(
            f"Ready on {interface}: one increment is {1e9 * scaling.metre:.6g} nm, a thousandth of the rated torque "
            f"{scaling.newton:.6g} N, a bus cycle {1e6 * firmware.cycle_time:g} us. Ctrl-C ends it.",
            markup=False,
            soft_wrap=True,
        )
        sys.stdout.flush()

    if bus == "ethercat":
        watchdog = None if watchdog_ms is None else 1e-3 * watchdog_ms
        serve_ethercat(firmware, interface, ready=ready, stopped=stop.is_set, watchdog=watchdog)
    else:
        serve_canopen(firmware, interface, station, ready=ready, stopped=stop.is_set)
    console.print(f"{firmware.cycles} cycles; the drive was last in '{firmware.state.words}'.", markup=False)

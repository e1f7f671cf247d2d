"""`feeddrive virtual-drive`: a simulated CiA 402 drive on a bus, to test a master before a real axis moves."""

from __future__ import annotations

from pathlib import Path

from feeddrive.bus.play import interruption
from feeddrive.bus.virtual.canopen_node import serve_canopen
from feeddrive.bus.virtual.ethercat_slave import serve_ethercat
from feeddrive.bus.virtual.firmware import DrivenAxis, Firmware, drive_text, scaling_of
from feeddrive.files.atomic_io import write_whole
from feeddrive.files.machine import MachineLike, read_machine
from feeddrive.language.errors import ParameterError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.workflow.command import Outcome, command
from feeddrive.workflow.request import Request, argument, option


class VirtualDriveRequest(Request):
    """The axes, their bus, and the drive file to write."""

    machine: MachineLike = argument("A machine file (TOML), or the name of a bundled machine")
    interface: str = option("ethercat: veth1; canopen: socketcan:vcan0, udp_multicast:239.74.163.2")
    axis: str | None = option("the axis; ethercat: all, one a station, if left out", default=None)
    bus: str = option("kind of bus", default="ethercat", options=("ethercat", "canopen"))
    station: int = option("number of the CANopen node", default=1, least=1, most=127)
    cycle_us: float | None = option(
        "bus cycle, a whole multiple of the sample time of the machine file; default: one sample",
        unit="s",
        entered="us",
        above=0.0,
        default=None,
    )
    position: float = option("position of the axis at the start", default=0.0, unit="m")
    seed: int = option("seed of the noise of the encoders", default=0)
    watchdog_ms: float | None = option(
        "fault without frames for so long, by the clock; default: none",
        unit="s",
        entered="ms",
        least=1.0,
        default=None,
    )
    master: str | None = option("interface for the drive file; default: the same", default=None)
    drive_file: Path | None = option("write a drive file for it here", default=None)

    def check(self) -> None:
        """Raise ParameterError for options that do not fit each other."""
        if self.bus == "canopen" and self.watchdog_ms is not None:
            raise ParameterError(
                "--watchdog-ms is of EtherCAT; a CANopen drive faults when it is taken out of OPERATIONAL"
            )


@command(VirtualDriveRequest)
def virtual_drive(request: VirtualDriveRequest, progress: Progress) -> Outcome[int]:
    """Be a CiA 402 drive with the plant and the control of a machine file inside, until Ctrl-C or a cancel.

    The result is the number of cycles.
    """
    machine = read_machine(request.machine)
    several = request.bus == "ethercat" and request.axis is None
    loops = (
        {name: machine.loop(name) for name in machine.loops}
        if several
        else {request.axis or "": machine.loop(request.axis)}
    )
    drives: dict[str, Firmware] = {}
    for name, loop in loops.items():
        cycle_time = float(loop.sample_time) if request.cycle_us is None else request.cycle_us
        drives[name] = Firmware(DrivenAxis(loop, request.position, request.seed), scaling_of(loop), cycle_time)

    def ready() -> None:
        for name, firmware in drives.items():
            progress.remark(
                Text(
                    f"{f'Axis {name}: one' if name else 'One'} increment is "
                    f"{Quantity(firmware.scaling.metre, 'm'):6 nm}, a thousandth of the rated torque "
                    f"{Quantity(firmware.scaling.newton, 'N'):6}, a bus cycle "
                    f"{Quantity(firmware.cycle_time, 's'):6 us}."
                )
            )
        progress.remark(f"Ready on {request.interface}; Ctrl-C ends it.")

    firmwares = list(drives.values())
    with interruption() as interrupted:

        def stopped() -> bool:
            return interrupted() or progress.cancelled

        if request.drive_file is not None:
            for place, (name, firmware) in enumerate(drives.items()):
                file = request.drive_file
                path = file if len(drives) == 1 else file.with_stem(f"{file.stem}_{name}")
                station = 1 + place if request.bus == "ethercat" else request.station
                described = (request.bus, request.master or request.interface, station, firmware.cycle_time)
                text = drive_text(loops[name], firmware.scaling, *described)
                write_whole(path, f'axis = "{name}"\n{text}' if name else text)
                progress.remark(f"Written: {path}")
        if request.bus == "ethercat":
            serve_ethercat(firmwares, request.interface, ready=ready, stopped=stopped, watchdog=request.watchdog_ms)
        else:
            serve_canopen(firmwares[0], request.interface, request.station, ready=ready, stopped=stopped)
    states = ", ".join(f"'{firmware.state.words}'" for firmware in firmwares)
    return Outcome(firmwares[0].cycles, verdict=f"{firmwares[0].cycles} cycles; last in {states}.")

"""`feeddrive play`, `listen` and `virtual-drive`: play a motion on a drive, log a drive, or act as a drive on a bus."""

from __future__ import annotations

import contextlib
from collections.abc import Generator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from feeddrive.bus.client import DriveClient, driven_together, transport_of
from feeddrive.bus.drive_file import DriveFile, read_drive
from feeddrive.bus.ethercat import Segment
from feeddrive.bus.faults import KINDS, read_fault
from feeddrive.bus.play import (
    Played,
    Profile,
    interruption,
    listened,
    play_profile,
    play_together,
    read_plan_profiles,
    read_profile,
)
from feeddrive.bus.transport import Lateness
from feeddrive.bus.virtual_drive import DrivenAxis, Firmware, drive_text, scaling_of
from feeddrive.bus.virtual_gantry import DrivenSide, beam_of, driven_gantry, side_text
from feeddrive.bus.virtual_nodes import serve_canopen, serve_ethercat
from feeddrive.files.atomic_io import new_directory, write_whole
from feeddrive.files.log import write_log
from feeddrive.files.machine import MachineFile, MachineLike, read_machine
from feeddrive.files.plan_files import PLAN, SETPOINTS
from feeddrive.language.errors import AbortedError, BusError, FeeddriveError, ParameterError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Table
from feeddrive.language.text import Text
from feeddrive.workflow.command import OUT, Outcome, Request, argument, command, line, option
from feeddrive.workflow.excite import WARNING

T = TypeVar("T")


class PlayRequest(Request):
    """The profiles and their drives, the factor on the amplitude, and the options for starting the motion."""

    profiles: tuple[Path, ...] = argument(
        "Files to be sent that `feeddrive excite` wrote, one a log; or the directory that `feeddrive plan` wrote"
    )
    drive: tuple[Path, ...] = option(
        "a drive file (TOML): bus, scaling, limits; for a plan one for each axis, all on one EtherCAT segment"
    )
    share: float = option("share of the excitation; begin with 0.1", default=1.0, least=0.0, most=1.0)
    ramp: float = option("time over which the amplitude rises and falls", default=0.0, unit="s", least=0.0)
    reset_fault: bool = option("reset a fault of the drive first", default=False)
    unpaced: bool = option("cycle as fast as the drive answers; for a virtual drive only", default=False)
    yes: bool = option("do not ask before the axis moves", default=False)
    out: Path | None = option(OUT, short="-o", default=None)

    def usual_out(self) -> Path:
        return Path("results") / f"play_{self.drive[0].stem}"

    def check(self) -> None:
        """Raise ParameterError for excitation options combined with a plan, and for several drives without a plan."""
        if self.plan is not None and (self.share != 1.0 or self.ramp):
            raise ParameterError("--share and --ramp are for an excitation: a plan is played as it was proven")
        if self.plan is None and len(self.drive) != 1:
            raise ParameterError(
                f"{len(self.drive)} drive files are given: profiles are played on one drive, and only the directory of "
                "a plan (feeddrive plan) on one for each axis"
            )

    @property
    def plan(self) -> Path | None:
        """The setpoint file of a plan; None for profiles."""
        first = self.profiles[0]
        folder = first.parent if first.name in (PLAN, SETPOINTS) else first
        return folder / SETPOINTS if len(self.profiles) == 1 and (folder / PLAN).is_file() else None


class ListenRequest(Request):
    """The drive to log, and the duration of the log."""

    drive: Path = option("a drive file (TOML): bus, scaling, limits")
    seconds: float = option("duration of the log", default=1.0, unit="s", least=0.001, most=3600.0)
    unpaced: bool = option("cycle as fast as the drive answers; for a virtual drive only", default=False)
    out: Path | None = option(OUT, short="-o", default=None)

    def usual_out(self) -> Path:
        return Path("results") / f"listen_{self.drive.stem}"


@command(PlayRequest)
def play(request: PlayRequest, progress: Progress) -> Outcome[Sequence[Played]]:
    """Play an excitation on a drive over EtherCAT or CANopen within limits, and log the motion of the axis.

    All profiles are read and checked before the bus is opened.  The user must confirm the motion unless `yes` is set.
    The log of an aborted motion is kept, too; the reason for the abort is the `error` of the outcome.
    """
    if request.plan is not None:
        return _play_plan(request, request.plan, progress)
    file = read_drive(request.drive[0])
    profiles = [read_profile(path, file.drive, share=request.share, ramp=request.ramp) for path in request.profiles]
    done: list[Played] = []
    trouble: FeeddriveError | None = None
    _ask(request, file.name, progress)
    for profile in profiles:
        try:
            # a fault that appears during the series must stop it, not be reset
            reset = request.reset_fault and not done
            done.append(_play(progress, file, profile, request.unpaced, reset, first=not done))
        except FeeddriveError as error:
            # an error ends the series, but the logs of the profiles before it are results worth keeping
            trouble = error
        if trouble is not None or done[-1].aborted:
            break
    if trouble is None and done and done[-1].aborted:
        trouble = AbortedError(f"{file.name}: {done[-1].aborted}")
    if not done and trouble is not None:
        raise trouble
    return _outcome(done, done, request.out, trouble)


@command(ListenRequest)
def listen(request: ListenRequest, progress: Progress) -> Outcome[Played]:
    """Log a drive over its bus at standstill, or while it is moved by hand, without enabling it."""
    file = read_drive(request.drive)
    with _named(file), _client(file, request.unpaced) as client:
        _greet(progress, client)
        heard = listened(client, request.seconds)
    return _outcome(heard, [heard], request.out, None)


def _ask(request: PlayRequest, name: str, progress: Progress) -> None:
    """Ask for confirmation before the bus is opened: a drive in operation cannot wait for an answer."""
    # an unpaced cycle is for a virtual drive only, where nothing can be hurt
    if request.yes or request.unpaced:
        return
    progress.remark(f"- {WARNING}")
    if not progress.confirm("Is the travel clear, and the stop at hand?"):
        raise AbortedError(f"{name}: it was not confirmed that the travel is clear; nothing was moved")


def _play_plan(request: PlayRequest, setpoints: Path, progress: Progress) -> Outcome[Sequence[Played]]:
    """Play all axes of a plan on one bus segment, in lockstep."""
    files = [read_drive(path) for path in request.drive]
    named = {file.axis: file for file in files}
    if "" in named or len(named) < len(files):
        raise ParameterError(
            f'{", ".join(file.name for file in files)}: for a plan each names an axis of its own, as  axis = "x"'
        )
    segments = {(file.drive.bus, file.interface) for file in files}
    if len(files) > 1 and (len(segments) > 1 or files[0].drive.bus != "ethercat"):
        raise ParameterError(
            f"{', '.join(file.name for file in files)}: several axes are played on drives of one EtherCAT segment, "
            'whose frames have the targets of all of them: one interface, bus = "ethercat"'
        )
    profiles = read_plan_profiles(setpoints, {axis: file.drive for axis, file in named.items()})
    name = ", ".join(file.name for file in files)
    _ask(request, name, progress)
    # one EtherCAT master for all axes: their targets travel in the same frame
    segment = Segment(files[0].interface) if files[0].drive.bus == "ethercat" else None
    clients = [
        DriveClient(
            transport_of(file.drive, file.interface, file.bitrate, segment), file.drive, paced=not request.unpaced
        )
        for file in files
    ]
    done: list[Played] = []
    trouble: FeeddriveError | None = None
    try:
        with driven_together(clients):
            for client in clients:
                _greet(progress, client)
                if request.reset_fault:
                    client.reset_fault()
            done = play_together(clients, profiles, names=list(named), progress=progress)
    except BusError as error:
        trouble = BusError(f"{name}: {error}")
        if not done:
            raise trouble from None
    ends = [played.aborted for played in done if played.aborted]
    if trouble is None and ends:
        trouble = AbortedError(f"{name}: {ends[0]}")
    return _outcome(done, done, request.out, trouble, list(named))


def _play(
    progress: Progress, file: DriveFile, profile: Profile, unpaced: bool, reset_fault: bool, *, first: bool
) -> Played:
    """Play a profile. The bus is reopened for each profile, so that no drive has to wait while a log is written."""
    played: Played | None = None
    try:
        with _named(file), _client(file, unpaced) as client:
            if first:
                _greet(progress, client)
            if reset_fault:
                client.reset_fault()
            played = play_profile(client, profile, name=Path(profile.name).stem, progress=progress)
    except BusError as error:
        if played is None:
            raise
        # disconnecting failed: keep the log of the motion
        return replace(played, aborted=str(error))
    return played


def _client(file: DriveFile, unpaced: bool) -> DriveClient:
    return DriveClient(transport_of(file.drive, file.interface, file.bitrate), file.drive, paced=not unpaced)


@contextlib.contextmanager
def _named(file: DriveFile) -> Generator[None]:
    """Prefix the messages of BusError and ParameterError with the name of the drive file."""
    try:
        yield
    except BusError as error:
        raise BusError(f"{file.name}: {error}") from None
    except ParameterError as error:
        raise ParameterError(f"{file.name}: {error}") from None


def _greet(progress: Progress, client: DriveClient) -> None:
    """Show the identity and the state of the drive."""
    known = client.identity
    text = ", ".join(f"{key} {known[key]:#x}" for key in ("vendor", "product", "revision") if key in known)
    state = client.state
    progress.remark(
        f"{client.transport.where}: {known.get('name') or 'a drive without a name'} ({text}), "
        f"{'unknown state' if state is None else state.words}"
    )
    for remark in client.remarks:
        progress.remark(f"- {remark}")


def _outcome(
    result: T, done: Sequence[Played], out: Path | None, trouble: FeeddriveError | None, names: Sequence[str] = ()
) -> Outcome[T]:
    """Return the outcome of a motion; if `out` is set, write all logs there, named by axis or else by number."""
    lines: list[Table | str] = []
    written = [] if out is None else _write(out, done, names or [str(k) for k in range(1, len(done) + 1)])
    for k, played in enumerate(done):
        lines.append(played.log.table())
        lines += [f"- {remark}" for remark in played.remarks]
        if played.lateness is not None:
            lines.append(f"- {_late(played.lateness)}")
        lines += [f"Log: {path}" for path in written[k : k + 1]]
    then = line("identify", *written) if written and trouble is None else ""
    return Outcome(result, lines, error=trouble, then=then)


def _write(out: Path, done: Sequence[Played], called: Sequence[str]) -> list[Path]:
    names = [
        # a log that ends early must not be taken for a measurement
        f"{'aborted' if played.aborted else 'measured'}_{label}.parquet"
        for label, played in zip(called, done, strict=True)
    ]
    with new_directory(out) as folder:
        for name, played in zip(names, done, strict=True):
            write_log(folder / name, played.log)
    return [out / name for name in names]


def _late(late: Lateness) -> str:
    return Text(
        f"Cycles began late by {Quantity(late.median, 's'):3 us} in the median, {Quantity(late.often, 's'):3 us} in 99 "
        f"%, {Quantity(late.most, 's'):3 us} at most (this computer, not the drive)."
    )


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
    fault: tuple[str, ...] = option(
        f"fault from a cycle in operation on, as freeze@150 or, with a size, jump@150=0.002: {', '.join(KINDS)}",
        default=(),
    )
    master: str | None = option("interface for the drive file; default: the same", default=None)
    drive_file: Path | None = option("write a drive file for it here", default=None)

    def check(self) -> None:
        """Raise ParameterError for incompatible options."""
        if self.bus == "canopen" and self.watchdog_ms is not None:
            raise ParameterError(
                "--watchdog-ms is of EtherCAT; a CANopen drive faults when it is taken out of OPERATIONAL"
            )


def _sides(machine: MachineFile, request: VirtualDriveRequest) -> dict[str, DrivenSide]:
    """Return the two drives on the beam of a machine, which have one plant, by axis; empty for one without a beam."""
    whole = machine.machine() if machine.couplings else None
    if whole is None or beam_of(whole) is None:
        return {}
    if request.position != 0.0:
        raise ParameterError(f"{machine.file.name}: the drives of a gantry begin at 0: leave out --position")
    return {side.name: side for side in driven_gantry(whole, request.seed).sides}


@command(VirtualDriveRequest)
def virtual_drive(request: VirtualDriveRequest, progress: Progress) -> Outcome[int]:
    """Act as a CiA 402 drive with the plant and the control of a machine file, until Ctrl-C or cancellation.

    The result is the number of cycles.
    """
    machine = read_machine(request.machine)
    several = request.bus == "ethercat" and request.axis is None
    sides = _sides(machine, request) if several else {}
    if sides:
        loops = {name: side.loop for name, side in sides.items()}
        others = [name for name in machine.loops if name not in sides]
        if others:
            progress.remark(f"- Of the gantry alone, without {', '.join(others)}.")
    elif several:
        loops = {name: machine.loop(name) for name in machine.loops}
    else:
        loops = {request.axis or "": machine.loop(request.axis)}
    drives: dict[str, Firmware] = {}
    faults = [read_fault(text) for text in request.fault]
    for name, loop in loops.items():
        cycle_time = float(loop.sample_time) if request.cycle_us is None else request.cycle_us
        axis = sides[name] if sides else DrivenAxis(loop, request.position, request.seed)
        # one axis of several: its fault is seen beside healthy ones
        drives[name] = Firmware(axis, scaling_of(loop), cycle_time, () if drives else faults)

    def ready() -> None:
        for fault in faults:
            progress.remark(f"Fault from cycle {fault.cycle} in operation on: {KINDS[fault.kind].meaning}.")
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
    # Ctrl-C only sets a flag: an exception within a bus cycle would leave a frame unanswered
    with interruption() as interrupted:

        def stopped() -> bool:
            return interrupted() > 0 or progress.cancelled

        # before serving, which blocks until the end: a master needs the file to connect
        if request.drive_file is not None:
            for place, (name, firmware) in enumerate(drives.items()):
                file = request.drive_file
                path = file if len(drives) == 1 else file.with_stem(f"{file.stem}_{name}")
                # EtherCAT counts stations by their position on the segment, CANopen by a number that is set
                station = 1 + place if request.bus == "ethercat" else request.station
                where = request.master or request.interface
                if sides:
                    write_whole(path, side_text(sides[name], where, station, firmware.cycle_time))
                else:
                    described = (request.bus, where, station, firmware.cycle_time)
                    text = drive_text(loops[name], firmware.scaling, *described)
                    write_whole(path, f'axis = "{name}"\n{text}' if name else text)
                progress.remark(f"Written: {path}")
        if request.bus == "ethercat":
            serve_ethercat(firmwares, request.interface, ready=ready, stopped=stopped, watchdog=request.watchdog_ms)
        else:
            serve_canopen(firmwares[0], request.interface, request.station, ready=ready, stopped=stopped)
    states = ", ".join(f"'{firmware.state.words}'" for firmware in firmwares)
    return Outcome(firmwares[0].cycles, verdict=f"{firmwares[0].cycles} cycles; last in {states}.")

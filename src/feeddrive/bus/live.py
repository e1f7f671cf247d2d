"""An axis that is there: what commissioning knows of a drive, and how a CiA 402 drive on a bus does it."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Generator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, Protocol, Self, runtime_checkable

import numpy as np

from feeddrive.blocks.families import Feedforward, Filter
from feeddrive.bus import cia402
from feeddrive.bus.client import DriveClient, identify, transport_of
from feeddrive.bus.control_in_master import ControlInMaster
from feeddrive.bus.drive_file import BusDrive, BusLimits, DriveFile, drive_of
from feeddrive.bus.ethercat import Segment
from feeddrive.bus.gains import gains_of, write_gains
from feeddrive.bus.play import Played, Profile, check_profile, interruption, play_profile
from feeddrive.bus.sampling import Sampler
from feeddrive.bus.transport import Pace, RefusedError, Transport, has_object, read_object, write_object
from feeddrive.bus.virtual_bus import VirtualEtherCAT
from feeddrive.bus.virtual_drive import DrivenAxis, Firmware, drive_text, scaling_of
from feeddrive.files.log import Log
from feeddrive.files.toml_file import TomlEdit, parse_toml
from feeddrive.language import units
from feeddrive.language.block import Block
from feeddrive.language.errors import BusError, ParameterError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text, joined
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop

# what `find` writes into a drive, in the order in which it can be written back: a pair of 0x60C2 is judged by its value
_WRITTEN = (
    "mode",
    "cycle_exponent",
    "cycle_value",
    "max_torque",
    "following_error_window",
    "following_error_timeout",
    "max_motor_speed",
    "quick_stop_deceleration",
    "quick_stop_option",
    "disable_operation_option",
    "fault_reaction_option",
    "position_least",
    "position_most",
    "connection_option",
)
_SHORTEST = 0.25e-3  # s, of a bus that masters of today are run with
# columns of a log by the channels of a sampler
_COLUMNS = {
    "force": ("force", "N"),
    "position": ("reading_load", "m"),
    "position_second": ("reading_motor", "m"),
    "velocity": ("velocity_load", "m/s"),
}


@runtime_checkable
class LiveAxis(Protocol):
    """An axis with a drive: it can be listened to, moved, and given a control on trial."""

    @property
    def where(self) -> str:
        """The drive in words: "EtherCAT eth1, station 1"."""
        ...

    @property
    def is_virtual(self) -> bool:
        """True only for a drive that moves nothing real."""
        ...

    @property
    def sample_time(self) -> float:
        """The time from setpoint to setpoint, also of a control in the master, s."""
        ...

    @property
    def increment(self) -> float:
        """The travel of one count at the table, m; 0 if it is not known."""
        ...

    @property
    def limits(self) -> BusLimits:
        """The limits of a motion, as the user stated them."""
        ...

    @property
    def rotary(self) -> bool:
        """True for an axis that turns: lengths are angles in rad, forces torques in N m."""
        ...

    @property
    def takes(self) -> tuple[type[Block], ...]:
        """What a control on trial may have beside its law: feedforward and filters, some kinds of them, or nothing."""
        ...

    def limited(self, limits: BusLimits) -> LiveAxis:
        """Return the same axis under tighter limits."""
        ...

    def scaled(self, factor: float, force_sign: int = 1) -> LiveAxis:
        """Return the same axis whose lengths are `factor` times as large, with the force's sign times `force_sign`."""
        ...

    def as_found(self) -> LiveAxis:
        """Return the same axis whose drive keeps the limit of force that it holds, for a first time at rest.

        By a wrong gear limits.force may be too small for a weight, which its own limit has carried before.
        """
        ...

    def text(self) -> str:
        """Return its drive file, with the corrections."""
        ...

    def listen(self, seconds: float, progress: Progress | None = None) -> Played:
        """Log the axis with its drive switched off; nothing is written to the drive."""
        ...

    def play(self, profile: Profile, progress: Progress | None = None, control: Control | Loop | None = None) -> Played:
        """Play a motion under the control of the drive or, on trial, under ours; the drive is off at the end."""
        ...

    def inside(self) -> Mapping[str, str]:
        """Return what is in the drive now, by the address of its objects."""
        ...

    def keep(self, machine_file: Path, export: Path, inside: Mapping[str, str]) -> Text:
        """Keep the control that was tried, and write back all else that was `inside`; return what is left to do."""
        ...

    def restore(self, inside: Mapping[str, str]) -> Text:
        """Write what was in the drive, and read it back; return what was done."""
        ...


class Ready(NamedTuple):
    """A drive that is ready for a motion: in its mode, with the control that leads it, and what was written into it."""

    drive: BusDrive
    leading: ControlInMaster | None = None
    told: tuple[str, ...] = ()


class BusAxis:
    """The axis of a CiA 402 drive on a bus; see `LiveAxis`.

    A control on trial runs in the master, in `cst` or, with mode = "csv" in the drive file, around the velocity loop of
    the drive.  With [gains] in the drive file its gains are written into the drive, which closes all loops in `csp`.

    file       the drive file
    transport  makes the transport to the drive; default: the bus of the file
    paced      False only for a virtual drive: each answer starts the next cycle at once
    """

    def __init__(
        self, file: DriveFile, transport: Callable[[BusDrive], Transport] | None = None, paced: bool = True
    ) -> None:
        self.file, self._paced = file, paced
        self._transport = transport or (lambda drive: transport_of(drive, file.interface, file.bitrate))
        self._made, self._text = transport, "" if file.read_from is None else file.read_from.file.text
        self._virtual: bool | None = None
        self._encoders: int | None = None
        self._own_force = False
        self._where = self._transport(file.drive).where

    @property
    def where(self) -> str:
        """The bus, the interface and the station."""
        return self._where

    @property
    def sample_time(self) -> float:
        """The cycle time of the bus, s."""
        return float(self.file.drive.cycle_time)

    @property
    def increment(self) -> float:
        """The travel of one count at the table, m."""
        return self.file.drive.scaling.metre

    @property
    def limits(self) -> BusLimits:
        """The limits of the motion."""
        return self.file.drive.limits

    @property
    def rotary(self) -> bool:
        """True for an axis that turns."""
        return self.file.drive.rotary

    @property
    def is_virtual(self) -> bool:
        """True for a virtual drive; it is asked once."""
        if self._virtual is None:
            with self._opened():
                pass
        return bool(self._virtual)

    @property
    def takes(self) -> tuple[type[Block], ...]:
        """What a control on trial may have beside its law: nothing, if only its gains go into the drive."""
        return () if self.file.gains else (Feedforward, Filter)

    def limited(self, limits: BusLimits) -> Self:
        """Return the same axis under tighter limits. Raises ParameterError for one that is looser."""
        mine = self.limits
        for name in ("travel", "velocity", "force", "following_error", "acceleration", "energy"):
            most, got = getattr(mine, name), getattr(limits, name)
            if most is not None and (got is None or got > most):
                raise ParameterError(
                    f"{self.where}: limits.{name} = {'none' if got is None else Quantity(got)} is looser than that of "
                    f"the drive file, {Quantity(most)}"
                )
        return self._with(replace(self.file.drive, limits=limits))

    def scaled(self, factor: float, force_sign: int = 1) -> Self:
        """Return the same axis with lengths `factor` times as large, and the sign of its force times `force_sign`."""
        scaling = self.file.drive.scaling
        name = "increment" if scaling.increment is not None else "lead"
        value = factor * getattr(scaling, name)
        sign = scaling.force_sign * force_sign
        made = self._with(replace(self.file.drive, scaling=replace(scaling, **{name: value}, force_sign=sign)))
        if self._text:
            edit = TomlEdit(self._text, self.file.name)
            unit = "rad" if self.file.drive.rotary else "m"
            if factor != 1.0:
                edit.set(("scaling", name), float(value), unit, digits=9)
            if sign != scaling.force_sign:
                edit.set(("scaling", "force_sign"), sign)
            made._text = edit.text
        return made

    def as_found(self) -> Self:
        """Return the same axis whose drive keeps the limit of force that it holds (0x6072); see `LiveAxis`."""
        made = self._with(self.file.drive)
        made._own_force = True
        return made

    def text(self) -> str:
        """Return the drive file, with the corrections of `scaled`; empty if it was not read from a file."""
        return self._text

    def listen(self, seconds: float, progress: Progress | None = None) -> Played:
        """Log the drive as it is: its actual values are mapped, and nothing else is written. Raises BusError."""
        drive = self.file.drive
        sampler = Sampler(self._transport(drive), drive)
        sampler.pace = Pace(drive.cycle_time if self._paced else None)
        rows: list[list[float] | None] = []
        try:
            sampler.open()
            self._virtual = sampler.virtual
            self._refuse_unpaced()
            count = max(1, round(seconds / drive.cycle_time))
            with interruption() as interrupted:
                # the first answers may be missing while a drive enters operation
                while len(rows) < count and not interrupted() and not (progress is not None and progress.cancelled):
                    _, values = sampler.cycle()
                    if rows or values is not None:
                        rows.append(values)
        finally:
            sampler.close()
        if not rows:
            raise BusError(f"{self.where}: was not listened to: it was stopped by hand")
        lost = np.array([float(row is None) for row in rows])
        held: list[list[float]] = []
        for row in rows:
            held.append(held[-1] if row is None else row)
        table = np.array(held)
        names = list(sampler.channels)
        channels = {
            column: table[:, names.index(channel)] for channel, (column, _) in _COLUMNS.items() if channel in names
        }
        of = {column: units.turning(unit) if drive.rotary else unit for column, unit in _COLUMNS.values()}
        channels |= {"lost": lost} if np.any(lost) else {}
        log = Log(
            name="listened",
            time=np.arange(len(rows)) * float(drive.cycle_time),
            channels=channels,
            units={name: of.get(name, "") for name in channels},
            sample_time=float(drive.cycle_time),
            constants={"lost_frames": float(lost.sum())},
            provenance={"written_by": "feeddrive", "bus": self.where, "increment_m": self.increment},
        )
        return Played(log, None, int(lost.sum()), sampler.pace.lateness(), (sampler.description,))

    def play(self, profile: Profile, progress: Progress | None = None, control: Control | Loop | None = None) -> Played:
        """Play a motion; see `LiveAxis`. The reason for an early end is in `Played.aborted`.

        Raises BusError if the drive cannot be switched on, and ParameterError or StructureError for a profile or a
        control that does not suit it.
        """
        ready = self.ready(profile, control)
        played: Played | None = None
        try:
            with self.client(ready.drive) as client:
                self._virtual = client.is_virtual
                played = play_profile(
                    client,
                    profile,
                    name=Path(profile.name).stem,
                    progress=progress,
                    control=ready.leading,
                )
        except BusError as error:
            if played is None:
                raise
            # it was the end that failed: the log of the motion is kept
            return replace(played, aborted=played.aborted or str(error))
        return replace(played, remarks=(*ready.told, *played.remarks))

    def ready(self, profile: Profile, control: Control | Loop | None = None) -> Ready:
        """Check a motion, compile its control, and write the gains of a drive that closes all loops; see `play`."""
        gains = self.file.gains if control is not None else {}
        mode = "csp"
        if control is not None and not gains:
            mode = "csv" if self.file.drive.mode == "csv" else "cst"
        drive = replace(self.file.drive, mode=mode)
        check_profile(profile, drive, follows=mode == "cst")
        if control is None:
            return Ready(drive)
        if not gains:
            # compiled before the bus is opened for the motion: a drive does not wait for that
            leading = ControlInMaster(
                control,
                self.sample_time,
                mode=mode,
                force=float(drive.limits.force),
                encoders=self._positions(),
                lost_frames=drive.lost_frames,
            )
            return Ready(drive, leading)
        wanted = gains_of(control.control if isinstance(control, Loop) else control)
        with self._opened() as transport:
            told = write_gains(transport, gains, wanted, drive.scaling, rotary=drive.rotary)
        return Ready(drive, None, tuple(told))

    def client(self, drive: BusDrive, segment: Segment | None = None) -> DriveClient:
        """Return the client of the drive, on a `segment` if it shares one with other drives."""
        file = self.file
        made = self._made(drive) if self._made else transport_of(drive, file.interface, file.bitrate, segment)
        return DriveClient(made, drive, paced=self._paced, own_force=self._own_force)

    def inside(self) -> Mapping[str, str]:
        """Return the objects that a motion or a trial writes, by their address, as they are now. Raises BusError."""
        found: dict[str, str] = {}
        with self._opened() as transport:
            for name in _WRITTEN:
                with contextlib.suppress(RefusedError):
                    found[cia402.OBJECTS[name].place] = str(read_object(transport, name))
            for gain in self.file.gains.values():
                found[_place(*gain.place)] = repr(gain.read(transport))
        return found

    def restore(self, inside: Mapping[str, str]) -> Text:
        """Write back what `inside` gave. Raises BusError, after all others, for what does not read back so."""
        return self._written(inside, gains=True)

    def _written(self, inside: Mapping[str, str], *, gains: bool) -> Text:
        refused: list[str] = []
        wrong: list[str] = []
        with self._opened() as transport:
            for name in _WRITTEN:
                place = cia402.OBJECTS[name].place
                if place not in inside:
                    continue
                try:
                    if read_object(transport, name) != int(inside[place]):
                        write_object(transport, name, int(inside[place]))
                    if read_object(transport, name) != int(inside[place]):
                        wrong.append(f"{place} ({name})")
                except RefusedError:
                    refused.append(f"{place} ({name})")
            for name, gain in self.file.gains.items() if gains else ():
                place = _place(*gain.place)
                if place not in inside:
                    continue
                gain.write(transport, float(inside[place]))
                if gain.read(transport) != float(inside[place]):
                    wrong.append(f"{place} ({name})")
        if wrong:
            raise BusError(
                f"{self.where}: {', '.join(wrong)} do not read back as they were: restore them by the tool of the maker"
            )
        ends = f"; {', '.join(refused)} could not be written and stay" if refused else ""
        which = "its objects" if gains or not self.file.gains else "all objects but those of gains"
        return Text(f"{self.where}: {which} are as they were before, and read back so{ends}.")

    def keep(self, machine_file: Path, export: Path, inside: Mapping[str, str]) -> Text:
        """Write back all but the gains; return what is left to do.

        Gains stay in the drive, and a control in the master runs where the master runs.  Raises BusError.
        """
        self._written(inside, gains=False)
        if self.file.gains:
            listed = joined(", ", (Text(f"{gain.object} ({name})") for name, gain in self.file.gains.items()))
            return Text(
                f"{self.where}: the new gains are in the drive ({listed}); store them by the tool of its maker, or by "
                "0x1010, or they are lost when it is switched off."
            )
        mode = "csv" if self.file.drive.mode == "csv" else "cst"
        return Text(
            f"{self.where}: the drive is as it was. The control that was tried runs in the master, in {mode} every "
            f"{Quantity(self.sample_time, 's'):6 us}: build {export.name} into it (made from {machine_file.name})."
        )

    def _positions(self) -> int:
        """Return how many positions the drive gives; it is asked once."""
        if self._encoders is None:
            with self._opened() as transport:
                self._encoders = 2 if has_object(transport, "second_position") else 1
        return self._encoders

    def _with(self, drive: BusDrive) -> Self:
        """Return the same axis with another description of its drive."""
        file = replace(self.file, drive=drive)
        # not a field: messages go on to name the file
        object.__setattr__(file, "read_from", self.file.read_from)
        made = type(self)(file, self._made, self._paced)
        made._text, made._virtual, made._encoders = self._text, self._virtual, self._encoders
        return made

    @contextlib.contextmanager
    def _opened(self) -> Generator[Transport]:
        """Yield the transport for access to objects; nothing is exchanged cyclically."""
        transport = self._transport(self.file.drive)
        try:
            transport.open()
            self._virtual = identify(transport, self.file.drive).get("name") == cia402.VIRTUAL
            self._refuse_unpaced()
            self._refuse_enabled(transport)
            yield transport
        finally:
            transport.close()

    def _refuse_enabled(self, transport: Transport) -> None:
        state = cia402.state_of(read_object(transport, "statusword"))
        if state in (cia402.PowerState.ENABLED, cia402.PowerState.QUICK_STOP):
            raise BusError(
                f"{self.where}: is '{state.words}' already: another master or the tool of its maker commands it; "
                "switch it off there first"
            )

    def _refuse_unpaced(self) -> None:
        if not self._paced and not self._virtual:
            raise BusError(f"{self.where}: only a virtual drive may be run without a clock; leave --unpaced out")


def _place(index: int, subindex: int) -> str:
    return f"0x{index:04X}:{subindex:02X}"


def virtual_cycle_time(loop: Loop) -> float:
    """Return the cycle time of the bus of a virtual drive, s: as many samples as make it no shorter than 0.25 ms."""
    T = float(loop.sample_time)
    return T * max(1, math.ceil(_SHORTEST / T - 1e-9))


def virtual_bus_axis(loop: Loop) -> BusAxis:
    """Return the axis of a virtual drive with a loop, whose control is the old one of the drive, in virtual time.

    A cycle of its bus has as many samples of the loop as make it no shorter than 0.25 ms.
    """
    scaling, cycle_time = scaling_of(loop), virtual_cycle_time(loop)
    firmware = Firmware(DrivenAxis(loop), scaling, cycle_time)
    content = drive_text(loop, scaling, "ethercat", "virtual", 1, cycle_time)
    name = f"virtual drive of axis {loop.name}"
    file = drive_of(parse_toml(content, name))
    return BusAxis(file, lambda _: VirtualEtherCAT(firmware), paced=False)

"""Buses in virtual time: a master's transport straight to a virtual drive in the same process, without any socket.

A cycle of the master is a cycle of the drive, however long either takes on the clock: watchdogs count cycles, too, and
the drive goes on when no frame passes.  Over EtherCAT process data go as LRW frames through registers, FMMUs and sync
managers of the slave controller; over CANopen as messages with SYNC.  Objects are read and written directly.
"""

from __future__ import annotations

import struct
from abc import ABC, abstractmethod

from feeddrive.bus.cia402 import Layout
from feeddrive.bus.transport import RefusedError, holds_mapping, write_mapping
from feeddrive.bus.virtual_drive import Firmware, PdoMap, SdoAbortError
from feeddrive.bus.virtual_nodes import (
    INPUTS,
    MAILBOX_IN,
    MAILBOX_OUT,
    OP,
    OUTPUTS,
    PREOP,
    SAFEOP,
    WATCHDOG_EXPIRED,
    NodeData,
    SlaveController,
)
from feeddrive.language.errors import BusError

_FPRD, _FPWR, _APWR, _LRW = 4, 5, 2, 12  # commands of a datagram
_STATION = 0x1001  # the address that the master gives
_WORKING = 3  # working counter of an LRW that a slave read and wrote
_WATCH_UNIT = 1e-4  # s, of register 0x0420 with the default divider


class _VirtualTransport(ABC):
    """What both buses share: objects, and the watchdog of the drive in cycles. See `Transport`."""

    where = "virtual bus"

    def __init__(self, firmware: Firmware) -> None:
        self.firmware = firmware
        self.cycles = 0
        self._objects = PdoMap(firmware, lambda: True)
        self._sent = self._told = Layout(())
        self._content = b""
        self._limit = 0.0  # s without a frame after which the drive stops by itself
        self._silent = 0

    def open(self) -> None:  # noqa: B027  # a virtual drive is there; on EtherCAT it has states to go through
        """Find the drive."""

    def read(self, index: int, subindex: int) -> bytes:
        """Read an object."""
        try:
            return self._objects.read(index, subindex)
        except SdoAbortError as refused:
            raise RefusedError(self.where, index, subindex, refused.code, False) from None

    def write(self, index: int, subindex: int, content: bytes) -> None:
        """Write an object."""
        try:
            self._objects.write(index, subindex, content)
        except SdoAbortError as refused:
            raise RefusedError(self.where, index, subindex, refused.code, True) from None

    def map(self, sent: Layout, told: Layout) -> None:
        """Map the objects of each cycle, and read the mapping back."""
        self._sent, self._told = sent, told
        for first, assigned, layout in ((0x1600, 0x1C12, sent), (0x1A00, 0x1C13, told)):
            self.write(assigned, 0, b"\x00")
            write_mapping(self, first, layout)
            for k in range(len(layout.groups)):
                self.write(assigned, k + 1, (first + k).to_bytes(2, "little"))
            self.write(assigned, 0, bytes([len(layout.groups)]))
            if not holds_mapping(self, first, assigned, layout):
                raise BusError(f"{self.where}: the mapping reads back as another one than was written")

    def watch(self, seconds: float) -> None:
        """Set the time without frames after which the drive stops by itself, s."""
        self._limit = seconds

    @abstractmethod
    def operate(self, content: bytes) -> None:
        """Start the exchange."""

    def put(self, content: bytes) -> None:
        """Set the outputs of the next cycle."""
        self._content = content

    def take(self, timeout: float) -> bytes | None:
        """Exchange one cycle; None if no answer comes back."""
        self.cycles += 1
        passes = not self.firmware.faults.is_unplugged
        self._silent = 0 if passes else self._silent + 1
        if self._limit and self._silent * self.firmware.cycle_time > self._limit:
            self._expire()
        return self._exchange(passes)

    @abstractmethod
    def _exchange(self, passes: bool) -> bytes | None:
        """Exchange one frame."""

    @abstractmethod
    def _expire(self) -> None:
        """Let the watchdog of the drive expire."""

    def state(self) -> str:
        """Return whether the drive can be reached."""
        return "it does not answer" if self.firmware.faults.is_unplugged else "it answers"

    def close(self) -> None:
        """End the exchange; the drive loses its connection."""
        self.firmware.lost()


class VirtualEtherCAT(_VirtualTransport):
    """An EtherCAT segment with a virtual drive at a station, in virtual time."""

    def __init__(self, firmware: Firmware, station: int = 1) -> None:
        super().__init__(firmware)
        self.where = f"EtherCAT in virtual time, station {station}"
        self._slave = SlaveController(firmware)
        self._objects = self._slave.objects

    def open(self) -> None:
        """Switch the station to PRE-OP, with its mailboxes."""
        self._ask(_APWR, 0, 0x0010, struct.pack("<H", _STATION))
        for k, (start, length) in enumerate((MAILBOX_OUT, MAILBOX_IN)):
            self._register(0x0800 + 8 * k, struct.pack("<HHBBBB", start, length, 0x26 - 4 * k, 0, 1, 0))
        self._to(PREOP)

    def map(self, sent: Layout, told: Layout) -> None:
        """Map the objects of each cycle, and configure sync managers and FMMUs."""
        super().map(sent, told)
        logical = 0
        for k, ((start, _), size, kind) in enumerate(((OUTPUTS, sent.size, 2), (INPUTS, told.size, 1))):
            self._register(0x0810 + 8 * k, struct.pack("<HHBBBB", start, size, 0x64, 0, 1, 0))
            self._register(0x0600 + 16 * k, struct.pack("<IHBBHBBBI", logical, size, 0, 7, start, 0, kind, 1, 0))
            logical += size

    def watch(self, seconds: float) -> None:
        """Write the watchdog's register, and count by what it holds."""
        self._register(0x0420, struct.pack("<H", round(seconds / _WATCH_UNIT)))
        self._limit = self._slave.watchdog

    def operate(self, content: bytes) -> None:
        """Switch the station to SAFE-OP and OP."""
        self._content = content
        self._to(SAFEOP)
        self._to(OP)

    def _exchange(self, passes: bool) -> bytes | None:
        outputs = self._content.ljust(self._sent.size, b"\0")
        answered = self._ask(_LRW, 0, 0, outputs + bytes(self._told.size)) if passes else None
        answering = self.firmware.faults.is_answering
        if not self._slave.advance():
            # without a frame the drive goes on by its own clock
            self.firmware.cycle()
        if answered is None or not answering or answered[1] != (_WORKING if self._sent.size else 1):
            return None
        return answered[0][self._sent.size :]

    def _expire(self) -> None:
        if self._slave.state == OP:
            self._slave.fall(WATCHDOG_EXPIRED)

    def _to(self, state: int) -> None:
        self._register(0x0120, struct.pack("<H", state))
        if self._slave.state != state:
            raise BusError(f"{self.where}: does not go to AL state {state}")

    def _register(self, register: int, content: bytes) -> None:
        self._ask(_FPWR, _STATION, register, content)

    def _ask(self, command: int, station: int, register: int, content: bytes) -> tuple[bytes, int]:
        """Send a frame with one datagram; return its content and its working counter."""
        address = struct.pack("<I", register) if command >= 10 else struct.pack("<HH", station, register)
        datagram = bytes([command, 0]) + address + struct.pack("<HH", len(content), 0) + content + b"\0\0"
        head = b"\xff" * 6 + b"\x10" * 6 + b"\x88\xa4" + struct.pack("<H", len(datagram) | 0x1000)
        back = self._slave.passed(head + datagram)
        assert back is not None
        return back[26 : 26 + len(content)], struct.unpack_from("<H", back, 26 + len(content))[0]


class VirtualCANopen(_VirtualTransport):
    """A CAN bus with one virtual drive as node 1, in virtual time."""

    where = "CANopen in virtual time, node 1"

    def __init__(self, firmware: Firmware) -> None:
        super().__init__(firmware)
        self._objects = PdoMap(firmware, lambda: not self._operational, 1)
        self._operational = False
        self._data = NodeData(firmware, self._objects)

    def map(self, sent: Layout, told: Layout) -> None:
        """Map the objects of each cycle, and switch the messages on that carry them."""
        super().map(sent, told)
        for talks, first, layout in ((0x1400, 0x201, sent), (0x1800, 0x181, told)):
            for k in range(len(layout.groups)):
                self.write(talks + k, 1, (first + 0x100 * k).to_bytes(4, "little"))

    def operate(self, content: bytes) -> None:
        """Switch the node to OPERATIONAL."""
        self._content, self._operational = content, True

    def _exchange(self, passes: bool) -> bytes | None:
        if passes:
            for k in range(len(self._sent.groups)):
                self._data.arrive(0x201 + 0x100 * k, self._content[self._sent.part(k)])
        answers = dict(self._data.answers()) if passes and self._operational else {}
        self._data.advance(is_operational=self._operational and passes)
        wanted = [0x181 + 0x100 * k for k in range(len(self._told.groups))]
        if not all(message in answers for message in wanted):
            return None
        return b"".join(answers[message] for message in wanted)

    def _expire(self) -> None:
        # the heartbeat of the master is missing: PRE-OPERATIONAL, by 0x1029
        if self._operational:
            self._operational = False
            self.firmware.lost()

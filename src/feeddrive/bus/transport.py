"""The interface of a bus to a drive, and the clock of its cycle."""

from __future__ import annotations

import contextlib
import gc
import os
import socket
import struct
import sys
import time
from collections.abc import Generator
from typing import NamedTuple, Protocol

import numpy as np

from feeddrive.bus.cia402 import OBJECTS, Layout
from feeddrive.language.errors import BusError

_REASONS = {
    0x05040000: "no answer",
    0x05040001: "command not known",
    0x06010002: "read only",
    0x06020000: "no such object",
    0x06040041: "cannot be mapped",
    0x06040042: "too long a mapping",
    0x06070010: "of another length",
    0x06090011: "no such subindex",
    0x06090030: "value out of range",
    0x06090031: "value too large",
    0x06090032: "value too small",
    0x08000020: "cannot be stored",
    0x08000021: "local control",
    0x08000022: "not in this state of the drive",
}


class RefusedError(BusError):
    """The drive refused to read or write an object; `code` is its abort code."""

    def __init__(self, where: str, index: int, subindex: int, code: int, writing: bool) -> None:
        reason = _REASONS.get(code, "see the manual of the drive")
        verb = "written" if writing else "read"
        super().__init__(f"{where}: object 0x{index:04X}:{subindex:02X} cannot be {verb}: {reason} (0x{code:08X})")
        self.code = code


class Transport(Protocol):
    """A drive on a bus.

    `where` is bus, interface and station, for errors.  The order is open, objects, `map`, `watch`, `operate`, `put` and
    `take` ..., close; all raise BusError.  Of drives that share a frame each is taken so far before the next step.
    """

    where: str

    def open(self) -> None:
        """Find the drive; objects can be read and written from here on."""

    def read(self, index: int, subindex: int) -> bytes:
        """Return the content of an object. Raises RefusedError."""
        ...

    def write(self, index: int, subindex: int, content: bytes) -> None:
        """Change an object. Raises RefusedError."""

    def map(self, sent: Layout, told: Layout) -> None:
        """Set the objects that are sent and received in each cycle."""

    def watch(self, seconds: float) -> None:
        """Set the time without frames after which the drive stops by itself, and read it back."""

    def operate(self, content: bytes) -> None:
        """Begin the exchange of process data, with this content."""

    def put(self, content: bytes) -> None:
        """Set the outputs of the next cycle."""

    def take(self, timeout: float) -> bytes | None:
        """Exchange one cycle: send, and return what was received within `timeout` s; None for a lost frame.

        Of drives that share a frame all are put before; the first that is taken sends it.
        """
        ...

    def state(self) -> str:
        """Return the state of the station on the bus, as text, for an error after lost frames."""
        ...

    def close(self) -> None:
        """Leave the station as it was found; never raises."""


class Claim:
    """An interface is driven by one process: a second master would reset the drives of the first in motion.

    A name in the network namespace of the interface, which the system frees when the process ends, however it ends.
    There are such names on Linux only; elsewhere another master shows only by its frames.
    """

    def __init__(self) -> None:
        self._held: socket.socket | None = None

    def take(self, where: str, interface: str) -> None:
        """Raise BusError if another process has it, or another client of this one."""
        if not sys.platform.startswith("linux"):
            return
        name = f"\0feeddrive play {interface}".encode()[:100]
        line = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            line.bind(name)
            line.listen(1)
        except OSError:
            line.close()
            raise BusError(
                f"{where}: the interface is driven by another feeddrive{_holder(name)}: wait for its end, or stop it; "
                "nothing was sent"
            ) from None
        self._held = line

    def free(self) -> None:
        """Give it back; never raises."""
        if self._held is not None:
            self._held.close()
            self._held = None


def _holder(name: bytes) -> str:
    """` (process 123)` of the process that holds the name, if the system tells it."""
    with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asking:
        asking.settimeout(0.1)
        asking.connect(name)
        process, *_ = struct.unpack("3i", asking.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
        return f" (process {process})" if process not in (0, os.getpid()) else " (this process)" if process else ""
    return ""


def read_object(transport: Transport, name: str) -> int:
    """Read an object as a number. Raises RefusedError."""
    entry = OBJECTS[name]
    content = transport.read(entry.index, entry.subindex)
    if len(content) < entry.bits // 8:
        raise BusError(
            f"{transport.where}: object {entry.place} ({name}) has {len(content)} bytes, not of {entry.type}"
        )
    return entry.decode(content)


def write_object(transport: Transport, name: str, value: int) -> None:
    """Write a number. Raises RefusedError."""
    entry = OBJECTS[name]
    transport.write(entry.index, entry.subindex, entry.encode(value))


def has_object(transport: Transport, name: str) -> bool:
    """True if the drive permits reading the object."""
    try:
        read_object(transport, name)
    except RefusedError:
        return False
    return True


def write_mapping(transport: Transport, first: int, layout: Layout) -> None:
    """Write the PDOs from 0x1600 or 0x1A00 on: count 0, entries, count."""
    for k, group in enumerate(layout.groups):
        transport.write(first + k, 0, b"\x00")
        for place, name in enumerate(group, start=1):
            transport.write(first + k, place, OBJECTS[name].mapped.to_bytes(4, "little"))
        transport.write(first + k, 0, bytes([len(group)]))


def holds_mapping(transport: Transport, first: int, assigned: int, layout: Layout) -> bool:
    """True if the PDOs from `first` on, and their list `assigned`, read back as they were written."""

    def read(index: int, subindex: int, size: int) -> int:
        return int.from_bytes(transport.read(index, subindex)[:size], "little")

    if read(assigned, 0, 1) != len(layout.groups):
        return False
    for k, group in enumerate(layout.groups):
        if read(assigned, k + 1, 2) != first + k or read(first + k, 0, 1) != len(group):
            return False
        if any(read(first + k, place, 4) != OBJECTS[name].mapped for place, name in enumerate(group, start=1)):
            return False
    return True


_PRIORITY = 60  # SCHED_FIFO, below the interrupts of a real-time kernel


class Lateness(NamedTuple):
    """The lateness of cycles, in s: median, 99 %, maximum; the number late by more than a cycle; and the slip of the
    clock.

    It describes the computer, not the drive.
    """

    median: float
    often: float
    most: float
    missed: int
    slipped: float


class Pace:
    """Begins cycle k at start + k · cycle_time on the monotonic clock; without one, as fast as the drive answers.

    A cycle late by more than a cycle is not made up by sending faster, as the drive would get jumps: the schedule
    slips, the motion pauses for that long, and the log counts such cycles.  How late a cycle may be
    in motion is `late_cycles` of the drive file; `DriveClient.cycle` keeps it.
    """

    def __init__(self, cycle_time: float | None) -> None:
        self.cycle_time = cycle_time
        self.slips = False  # whether the last cycle began more than a cycle late
        self._next = 0.0
        self._late: list[float] = []
        self._missed, self._slipped = 0, 0.0

    def begin(self) -> None:
        """Start the schedule."""
        self._late, self._missed, self._slipped = [], 0, 0.0

    def wait(self) -> float:
        """Wait until the next cycle is due; return its lateness in s."""
        if self.cycle_time is None:
            return 0.0
        now = time.monotonic()
        if self._next == 0.0:
            self._next = now
        if now < self._next:
            time.sleep(self._next - now)
            now = time.monotonic()
        late = max(0.0, now - self._next)
        self._late.append(late)
        self.slips = late > self.cycle_time
        if self.slips:
            self._missed += 1
            self._slipped += late
            self._next = now
        self._next += self.cycle_time
        return late

    def lateness(self) -> Lateness | None:
        """Return the lateness since `begin`; None without a clock."""
        if not self._late:
            return None
        median, often, most = np.quantile(self._late, [0.5, 0.99, 1.0]).tolist()
        return Lateness(median, often, most, self._missed, self._slipped)


@contextlib.contextmanager
def urgent(wanted: bool) -> Generator[bool]:
    """Run a block with real-time scheduling, if permitted, and without garbage collection.

    Its value: whether it was permitted.
    """
    before = None
    if wanted and hasattr(os, "sched_setscheduler"):
        with contextlib.suppress(OSError):
            before = os.sched_getscheduler(0), os.sched_getparam(0)
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    collected = gc.isenabled()
    gc.disable()
    try:
        yield before is not None
    finally:
        if collected:
            gc.enable()
        if before is not None:
            with contextlib.suppress(OSError):
                os.sched_setscheduler(0, *before)

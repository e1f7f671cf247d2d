"""The interface to a drive on a bus, access to its objects, and the timing of its cycle."""

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
    """The error of a refused access to an object; `code` is the SDO abort code."""

    def __init__(self, where: str, index: int, subindex: int, code: int, writing: bool) -> None:
        reason = _REASONS.get(code, "see the manual of the drive")
        verb = "written" if writing else "read"
        super().__init__(f"{where}: object 0x{index:04X}:{subindex:02X} cannot be {verb}: {reason} (0x{code:08X})")
        self.code = code


class Transport(Protocol):
    """A drive on a bus.

    `where` names bus, interface and station in error messages.  The order of calls is `open`, access to objects, `map`,
    `watch`, `operate`, repeated `put` and `take`, `close`; all but `close` raise BusError.  Drives that share a frame
    must all complete a step before any of them continues with the next one.
    """

    where: str

    def open(self) -> None:
        """Find the drive, so that its objects can be read and written."""

    def read(self, index: int, subindex: int) -> bytes:
        """Return the content of an object. Raises RefusedError."""
        ...

    def write(self, index: int, subindex: int, content: bytes) -> None:
        """Change an object. Raises RefusedError."""

    def map(self, sent: Layout, told: Layout) -> None:
        """Map the objects that are sent and received in each cycle."""

    def watch(self, seconds: float) -> None:
        """Set the watchdog to stop the drive after `seconds` without frames, and read the setting back."""

    def operate(self, content: bytes) -> None:
        """Start the process data exchange with this initial content."""

    def put(self, content: bytes) -> None:
        """Set the outputs of the next cycle."""

    def take(self, timeout: float) -> bytes | None:
        """Exchange one cycle: send, and return the data received within `timeout` s; None for a lost frame.

        For drives that share a frame, `put` is called for all of them first; the first `take` sends the frame.
        """
        ...

    def state(self) -> str:
        """Return the bus state of the station as a string for the error message after lost frames."""
        ...

    def close(self) -> None:
        """Restore the initial state of the station; never raises."""


class Claim:
    """An exclusive lock on an interface, since a second master would reset drives that the first one is moving.

    The lock is an abstract socket name in the network namespace of the interface; the system frees it however the
    process ends.  It exists on Linux only; on other systems another master is detected only by its frames.
    """

    def __init__(self) -> None:
        self._held: socket.socket | None = None

    def take(self, where: str, interface: str) -> None:
        """Acquire the lock. Raise BusError if another process, or another client in this process, holds it."""
        if not sys.platform.startswith("linux"):
            return
        # the address of a Unix socket has at most 108 bytes
        name = f"\0feeddrive play {interface}".encode()[:100]
        line = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            line.bind(name)
            # so that `_holder` of another process can connect and read the process id
            line.listen(1)
        except OSError:
            line.close()
            raise BusError(
                f"{where}: the interface is driven by another feeddrive{_holder(name)}: wait for its end, or stop it; "
                "nothing was sent"
            ) from None
        self._held = line

    def free(self) -> None:
        """Release the lock; never raises."""
        if self._held is not None:
            self._held.close()
            self._held = None


def _holder(name: bytes) -> str:
    """Return ` (process 123)` for the process that holds the lock, or "" if the system does not report it."""
    with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asking:
        asking.settimeout(0.1)
        asking.connect(name)
        process, *_ = struct.unpack("3i", asking.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
        # 0: the holder runs in another process namespace, where its id means nothing here
        return f" (process {process})" if process not in (0, os.getpid()) else " (this process)" if process else ""
    return ""


def read_object(transport: Transport, name: str) -> int:
    """Read an object, by name, as a number. Raises RefusedError, and BusError if the content is too short."""
    entry = OBJECTS[name]
    content = transport.read(entry.index, entry.subindex)
    if len(content) < entry.bits // 8:
        raise BusError(
            f"{transport.where}: object {entry.place} ({name}) has {len(content)} bytes, not of {entry.type}"
        )
    return entry.decode(content)


def write_object(transport: Transport, name: str, value: int) -> None:
    """Write a number to an object, by name. Raises RefusedError."""
    entry = OBJECTS[name]
    transport.write(entry.index, entry.subindex, entry.encode(value))


def has_object(transport: Transport, name: str) -> bool:
    """Return True if the object can be read from the drive."""
    try:
        read_object(transport, name)
    except RefusedError:
        return False
    return True


def write_mapping(transport: Transport, first: int, layout: Layout) -> None:
    """Write the PDO mapping from 0x1600 or 0x1A00 onward: set the count to 0, write the entries, set the count."""
    for k, group in enumerate(layout.groups):
        transport.write(first + k, 0, b"\x00")
        for place, name in enumerate(group, start=1):
            transport.write(first + k, place, OBJECTS[name].mapped.to_bytes(4, "little"))
        transport.write(first + k, 0, bytes([len(group)]))


def holds_mapping(transport: Transport, first: int, assigned: int, layout: Layout) -> bool:
    """Return True if the PDO mapping from `first` onward and its assignment read back as written."""

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


# of 1 to 99: before all ordinary programs, behind the kernel's own threads at 99
_PRIORITY = 60  # SCHED_FIFO


class Lateness(NamedTuple):
    """The lateness of cycles: median, 99th percentile and maximum (s), the number of cycles more than one cycle late,
    and the total slip of the schedule (s).

    It characterizes the computer, not the drive.
    """

    median: float
    often: float
    most: float
    missed: int
    slipped: float


class Pace:
    """The schedule of the bus cycles: cycle k begins at start + k · cycle_time on the monotonic clock.

    With cycle_time = None, a cycle begins as soon as the drive has answered.  A delay of more than a cycle is not
    recovered by sending faster, since the setpoints of the drive would jump: the schedule slips, the motion pauses for
    the delay, and the log counts such cycles.  `DriveClient.cycle` limits the delay in motion to `late_cycles`.
    """

    def __init__(self, cycle_time: float | None) -> None:
        self.cycle_time = cycle_time
        self.slips = False  # whether the last cycle began more than a cycle late
        self.elapsed = 1.0  # cycles from the begin of the cycle before to that of the last one
        self._next = 0.0
        self._late: list[float] = []
        self._missed, self._slipped = 0, 0.0

    def begin(self) -> None:
        """Reset the lateness statistics."""
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
        self.elapsed = 1.0 + late / self.cycle_time
        if self.slips:
            self._missed += 1
            self._slipped += late
            self._next = now
        self._next += self.cycle_time
        return late

    def lateness(self) -> Lateness | None:
        """Return the lateness statistics since `begin`; None if there is no cycle time."""
        if not self._late:
            return None
        median, often, most = np.quantile(self._late, [0.5, 0.99, 1.0]).tolist()
        return Lateness(median, often, most, self._missed, self._slipped)


@contextlib.contextmanager
def urgent(wanted: bool) -> Generator[bool]:
    """Run a block with real-time scheduling, if permitted, and without garbage collection.

    Yields True if real-time scheduling was permitted.
    """
    before = None
    if wanted and hasattr(os, "sched_setscheduler"):
        with contextlib.suppress(OSError):
            ordinary = os.sched_getscheduler(0), os.sched_getparam(0)
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
            # only after it succeeded: a refusal leaves None, and nothing to restore
            before = ordinary
    collected = gc.isenabled()
    # a full collection can take longer than a cycle
    gc.disable()
    try:
        yield before is not None
    finally:
        if collected:
            gc.enable()
        if before is not None:
            with contextlib.suppress(OSError):
                os.sched_setscheduler(0, *before)

"""Passive sampling of a drive's actual values over its bus, without commanding the drive.

Only inputs from the drive are mapped: no controlword, mode, target or limit is sent or written, and no watchdog is set,
so that sampling neither enables nor moves a drive.  The drive is switched to OPERATIONAL (CANopen, where its messages
answer SYNC) or OP (EtherCAT) and, at the end, returned to the state described in the transport's `close`.  Like `play`
and `listen`, sampling refuses a bus with another master.
"""

import multiprocessing
import signal
import time as clock
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

import numpy as np

from feeddrive.analysis.oscilloscope import Rows
from feeddrive.bus.cia402 import TOLD, VIRTUAL, Layout, state_of
from feeddrive.bus.client import check_scaling, identify, transport_of
from feeddrive.bus.drive_file import BusDrive, DriveFile, DriveScaling
from feeddrive.bus.transport import Pace, Transport, has_object
from feeddrive.language.errors import BusError, FeeddriveError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text

# a forked copy of the page's process could inherit locks that its threads hold
_CONTEXT = multiprocessing.get_context("spawn")
_TOGETHER = 0.02  # s of rows that are handed over at once
_LOST = 1000  # cycles in a row without an answer after which the drive is given up
_SILENT = 3.0  # s of the same
_END = 3.0  # s in which the process ends by itself

# channels, the objects that they are made of, and their units
_CHANNELS: Mapping[str, tuple[str, str]] = {
    "position": ("position", "m"),
    "velocity": ("velocity", "m/s"),
    "force": ("torque", "N"),
    "following_error": ("following_error", "m"),
    "position_second": ("second_position", "m"),
    # last: `DriveSamples` reads the power state from the last column
    "status": ("statusword", ""),
}
_NEEDED = ("position", "torque", "statusword")


class Sampler:
    """The exchange with one drive: call `open`, `cycle` repeatedly, then `close`; `open` and `cycle` raise BusError."""

    def __init__(self, transport: Transport, drive: BusDrive) -> None:
        self.transport, self.drive = transport, drive
        self.pace = Pace(drive.cycle_time)
        self.channels: dict[str, str] = {}
        self.description, self.virtual = "", False
        self._told = Layout(())
        self._lost = 0
        self._heard = clock.monotonic()

    def open(self) -> None:
        """Identify the drive, check its scaling, map its actual values, and start the exchange."""
        transport = self.transport
        transport.open()
        known = identify(transport, self.drive)
        remarks = check_scaling(transport, self.drive.scaling)
        there = [name for group in TOLD for name in group if has_object(transport, name)]
        missing = [name for name in _NEEDED if name not in there]
        if missing:
            raise BusError(f"{transport.where}: has no object for {', '.join(missing)}, and cannot be sampled")
        self._told = Layout(TOLD).keeping(there)
        self.channels = {name: unit for name, (of, unit) in _CHANNELS.items() if of in there}
        self.virtual = known.get("name") == VIRTUAL
        self.description = " ".join([f"{known.get('name') or 'a drive without a name'}.", *remarks])
        transport.map(Layout(()), self._told)
        transport.operate(b"")

    def cycle(self) -> tuple[float, list[float] | None]:
        """Exchange one cycle; return its lateness (s) and the values of the channels, None for a lost frame."""
        late = self.pace.wait()
        self.transport.put(b"")
        # a virtual drive simulates the cycle before it answers, on a computer that may be busy
        told = self.transport.take(1.0 if self.virtual else max(2e-3, 2.0 * self.drive.cycle_time))
        if told is None:
            self._lost += 1
            silent = clock.monotonic() - self._heard
            if self._lost >= _LOST or silent > _SILENT:
                raise BusError(
                    f"{self.transport.where}: no answer for {Quantity(silent, 's'):2 SI}, in {self._lost} cycles: "
                    f"{self.transport.state()}"
                )
            return late, None
        self._lost, self._heard = 0, clock.monotonic()
        return late, values_of(self._told.unpack(told), self.channels, self.drive.scaling)

    def close(self) -> None:
        """Close the transport; never raises."""
        self.transport.close()


def values_of(raw: Mapping[str, int], channels: Mapping[str, str], scaling: DriveScaling) -> list[float]:
    """Convert object values to the units of the channels: increments to m, thousandths of the rated torque to N."""
    factor = {"m": scaling.metre, "m/s": scaling.metre, "N": scaling.force(1), "": 1.0}
    return [raw[_CHANNELS[name][0]] * factor[unit] for name, unit in channels.items()]


def sample(sampler: Sampler, give: Callable[[np.ndarray, np.ndarray], None], stopped: Callable[[], bool]) -> None:
    """Sample until `stopped` returns True, passing time (s) and values to `give` in chunks; a lost frame gives NaN.

    Row k has the bus time k T, where T is the cycle time, plus the delays of all cycles that this computer began more
    than T late.  A virtual drive has no such delays, since its time is counted in cycles.  Raises BusError.
    """
    T, k, slipped = sampler.drive.cycle_time, 0, 0.0
    gap = [float("nan")] * len(sampler.channels)
    times, rows, delivered = list[float](), list[list[float]](), clock.monotonic()
    while not stopped():
        late, values = sampler.cycle()
        slipped += late if late > T and not sampler.virtual else 0.0
        times.append(k * T + slipped)
        rows.append(gap if values is None else values)
        k += 1
        if clock.monotonic() - delivered > _TOGETHER:
            give(np.array(times), np.array(rows))
            times, rows, delivered = [], [], clock.monotonic()


def _child(file: DriveFile, line: Any) -> None:
    """Sample in a separate process, so that neither the studio nor plotting delays a cycle.

    However the parent process ends, the connection closes with it, and the drive is released properly.
    """
    # Ctrl-C reaches all processes of the terminal: this one is ended by its parent, and then releases the drive
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    sampler = Sampler(transport_of(file.drive, file.interface, file.bitrate), file.drive)
    try:
        sampler.open()
        line.send(("open", sampler.channels, sampler.description))
        # `poll` is true for a message to stop and for a connection closed by a parent that died
        sample(sampler, lambda time, values: line.send(("rows", time, values)), line.poll)
    except FeeddriveError as error:
        with suppress(OSError):
            line.send(("error", Text(f"{file.name}: {error}")))
    except (OSError, EOFError):
        # the parent has ended: nobody is left to receive an error
        pass
    finally:
        sampler.close()


class DriveSamples:
    """A live source of the actual values of a drive: position (m), velocity (m/s), force (N). See `LiveSource`.

    No other program can use the bus while the source is open.
    """

    clock, over = "s", False

    def __init__(self, file: DriveFile) -> None:
        self.name = file.name
        self.channels: Mapping[str, str] = {}
        self._said, self._state, self._rows = "", "opens the bus", 0
        self._line, theirs = _CONTEXT.Pipe()
        self._process = _CONTEXT.Process(target=_child, args=(file, theirs), daemon=True)
        self._process.start()
        # or this process would hold the other end open, and never see that the child has ended
        theirs.close()

    def take(self) -> Rows:
        """Return the samples since the last call. Raises BusError once the drive can no longer be sampled."""
        times, values = list[np.ndarray](), list[np.ndarray]()
        try:
            while self._line.poll():
                kind, *payload = self._line.recv()
                if kind == "error":
                    raise BusError(payload[0])
                if kind == "open":
                    self.channels, self._said = payload
                else:
                    times.append(payload[0])
                    values.append(payload[1])
        except (EOFError, OSError):
            raise BusError(f"{self.name}: the process that samples the drive has ended") from None
        if not times:
            return Rows(np.empty(0), np.empty((0, len(self.channels))))
        rows = Rows(np.concatenate(times), np.concatenate(values))
        self._state = self._power(rows.values)
        return rows

    def _power(self, values: np.ndarray) -> str:
        told = values[np.isfinite(values[:, -1]), -1]
        state = state_of(int(told[-1])) if told.size else None
        return "no answers" if not told.size else f"'{'unknown' if state is None else state.words}'"

    def state(self) -> str:
        """Return a description of the drive and its power state."""
        return f"{self._said} {self._state}".strip() + "; sampled, not commanded"

    def close(self) -> None:
        """Stop the sampling process."""
        with suppress(OSError):
            self._line.send("stop")
        self._process.join(_END)
        if self._process.is_alive():
            self._process.terminate()
        self._line.close()

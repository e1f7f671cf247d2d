"""A virtual drive on an Ethernet interface: frames in, frames back, and one bus cycle of the plant for each of them."""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Callable, Sequence

from feeddrive.bus.ethercat import opened_socket
from feeddrive.bus.virtual.esc import ETHERTYPE, OP, SlaveController
from feeddrive.bus.virtual.firmware import Firmware

_WATCHDOG = 0x001B  # AL status code: sync manager watchdog
_PATIENCE = 0.1  # s between looks at `stopped` where nothing comes


def serve_ethercat(
    firmwares: Firmware | Sequence[Firmware],
    interface: str,
    *,
    ready: Callable[[], None],
    stopped: Callable[[], bool],
    watchdog: float | None = None,
    lose: Callable[[int], bool] = lambda _cycle: False,
) -> None:
    """Serve until `stopped`; several drives are the stations of a segment, in their order.

    watchdog  s without process data after which an enabled drive goes into fault, by the clock on the wall; None: the
              time of the plant is that of the frames, and stands still without them
    lose      whether the answer of a cycle (of the first drive) is swallowed, for tests of a client

    Raises BusError for an interface that is not there or not permitted.
    """
    drives = [firmwares] if isinstance(firmwares, Firmware) else list(firmwares)
    stations = [SlaveController(each) for each in drives]
    line = opened_socket(interface, ETHERTYPE)
    with contextlib.closing(line):
        line.settimeout(_PATIENCE if watchdog is None else min(_PATIENCE, watchdog))
        ready()
        last = time.monotonic()
        while not stopped():
            with contextlib.suppress(socket.timeout):
                frame: bytes | None = line.recv(2048)
                for station in stations:
                    frame = None if frame is None else station.passed(frame)
                if frame is not None and not lose(drives[0].cycles):
                    line.send(frame)
                moved = [station.advance() for station in stations]  # every one of them, not up to the first
                if any(moved):
                    last = time.monotonic()
            if watchdog is not None and time.monotonic() - last > watchdog:
                for station in stations:
                    if station.state == OP:
                        station.fall(_WATCHDOG)

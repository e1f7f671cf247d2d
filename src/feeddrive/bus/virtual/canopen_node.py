"""A virtual drive on a CAN bus: SDO and NMT by the canopen package, process data on every SYNC."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable
from typing import Any

from feeddrive.bus.canopen import opened_network, packages
from feeddrive.bus.cia402 import Layout
from feeddrive.bus.virtual.firmware import INVALID, Firmware, PdoMap, SdoAbortError

# CiA 301: COB-ID of SYNC, producer and consumer time of the heartbeat, COB-ID of the heartbeat of node 0
_SYNC, _HEARTBEAT, _CONSUMER, _BEAT = 0x80, 0x1017, 0x1016, 0x700
_PATIENCE = 0.05  # s between looks at `stopped`


def serve_canopen(
    firmware: Firmware,
    interface: str,
    station: int,
    *,
    ready: Callable[[], None],
    stopped: Callable[[], bool],
    bitrate: int | None = None,
    lose: Callable[[int], bool] = lambda _cycle: False,
) -> None:
    """Serve node `station` on a python-can bus until `stopped`; `lose` drops the answer of a cycle.

    On each SYNC the values of the last cycle are sent, then the plant advances by one bus cycle.  Raises BusError for a
    bus that cannot be opened, MissingExtraError without the packages.
    """
    canopen = packages()
    watch = _MasterWatch()
    objects = PdoMap(firmware, lambda: node.nmt.state == "PRE-OPERATIONAL", station)

    class Node(canopen.LocalNode):
        """A CANopen node with the object dictionary of the firmware; the package handles only the heartbeat."""

        def get_data(self, index: int, subindex: int, check_readable: bool = False) -> bytes:
            if index == _HEARTBEAT:
                return super().get_data(index, subindex, check_readable)
            if (index, subindex) == (_CONSUMER, 1):
                return struct.pack("<I", watch.entry)
            try:
                return objects.read(index, subindex)
            except SdoAbortError as refused:
                raise canopen.SdoAbortedError(refused.code) from None

        def set_data(self, index: int, subindex: int, data: bytes, check_writable: bool = False) -> None:
            if index == _HEARTBEAT:
                super().set_data(index, subindex, data, check_writable)
                return
            if (index, subindex) == (_CONSUMER, 1):
                watch.set(int.from_bytes(data, "little"))
                return
            try:
                objects.write(index, subindex, bytes(data))
            except SdoAbortError as refused:
                raise canopen.SdoAbortedError(refused.code) from None

    network = opened_network(interface, bitrate)
    try:
        dictionary = canopen.ObjectDictionary()
        heartbeat = canopen.objectdictionary.ODVariable("producer heartbeat time", _HEARTBEAT)
        heartbeat.data_type, heartbeat.default = canopen.objectdictionary.UNSIGNED16, 0
        dictionary.add_object(heartbeat)
        node = Node(station, dictionary)
        network.add_node(node)
        for master in range(1, 128):
            if master != station:
                network.subscribe(_BEAT + master, watch.beat)
        arrived: dict[int, bytes] = {}

        def operational() -> bool:
            return node.nmt.state == "OPERATIONAL"

        def arrive(identifier: int, content: bytearray, _stamp: float) -> None:
            arrived[identifier] = bytes(content)

        for k in range(4):
            network.subscribe(0x200 + 0x100 * k + station, arrive)

        def sync(*_: Any) -> None:
            losing = lose(firmware.cycles)
            for k in range(4):
                message = objects.messages[0x1800 + k]
                if operational() and not message & INVALID and not losing:
                    told = Layout([objects.names(0x1A00 + k)])
                    network.send_message(message & 0x7FF, told.pack(firmware.values))
            for k in range(4):
                message = objects.messages[0x1400 + k]
                content = arrived.pop(message & 0x7FF, None)
                if operational() and not message & INVALID and content is not None:
                    firmware.take(Layout([objects.names(0x1600 + k)]).unpack(content))
            firmware.cycle()

        network.subscribe(_SYNC, sync)
        node.nmt.state = "PRE-OPERATIONAL"
        ready()
        while not stopped():
            time.sleep(_PATIENCE)
            if operational() and watch.is_silent():
                node.nmt.state = "PRE-OPERATIONAL"  # as 0x1029 has it by default
            if not operational():
                firmware.lost()
    finally:
        network.disconnect()


class _MasterWatch:
    """The heartbeat consumer of the drive (0x1016:01), which times out once the first heartbeat has been received."""

    def __init__(self) -> None:
        self.set(0)

    def set(self, entry: int) -> None:
        """Set the entry: node in bits 16 to 22, ms in the low 16 bits; 0 ms disables it."""
        self.entry = entry
        self._last: float | None = None

    def beat(self, identifier: int, _content: bytearray, _stamp: float) -> None:
        """Handle a heartbeat of any node."""
        if identifier - _BEAT == self.entry >> 16 & 0x7F:
            self._last = time.monotonic()

    def is_silent(self) -> bool:
        """Return True if the heartbeat has timed out."""
        last, limit = self._last, 1e-3 * (self.entry & 0xFFFF)
        return last is not None and limit > 0.0 and time.monotonic() - last > limit

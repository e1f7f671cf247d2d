"""The process data of a virtual drive: mapping and assignment objects.

0x1600.. and 0x1A00.. define the contents of a process data object, 0x1C12 and 0x1C13 the objects that an EtherCAT
master uses, 0x1400.. and 0x1800.. the CAN messages that carry them.
"""

from __future__ import annotations

import struct
from collections.abc import Callable

from feeddrive.bus.cia402 import AT, OBJECTS, SENT, TOLD, Layout
from feeddrive.bus.virtual.firmware import (
    NO_OBJECT,
    NO_SUBINDEX,
    TOO_LARGE,
    WRONG_LENGTH,
    WRONG_STATE,
    Firmware,
    SdoAbortError,
)

_NOT_MAPPABLE, _TOO_MANY = 0x06040041, 0x06040042
_ASSIGNED = {0x1600: 0x1C12, 0x1A00: 0x1C13}
_MESSAGES = {0x1600: 0x1400, 0x1A00: 0x1800}
_OBJECTS, _ENTRIES = 4, 8  # mapping objects in a direction, and entries in one of them
INVALID = 1 << 31  # bit of a message that is switched off


class PdoMap:
    """The lists of a drive; a write is refused unless `changeable` says that the mapping may be changed now."""

    def __init__(self, firmware: Firmware, changeable: Callable[[], bool], station: int = 0) -> None:
        """`station` is the number of a CANopen node, whose messages are then those of the predefined connections."""
        self.firmware, self._changeable = firmware, changeable
        self._lists: dict[int, list[int]] = {}
        self.messages: dict[int, int] = {}
        there = [each.name for each in AT.values() if firmware.has(each.name)]
        for first, groups in ((0x1600, SENT), (0x1A00, TOLD)):
            kept = Layout(groups).keeping(there)
            for k in range(_OBJECTS):
                names = kept.groups[k] if k < len(kept.groups) else ()
                self._lists[first + k] = [OBJECTS[name].mapped for name in names]
                message = (0x200 if first == 0x1600 else 0x180) + 0x100 * k + station
                self.messages[_MESSAGES[first] + k] = message if names and station else message | INVALID
            self._lists[_ASSIGNED[first]] = [first + k for k in range(len(kept.groups))]
        self._counts = {index: len(entries) for index, entries in self._lists.items()}

    def names(self, index: int) -> list[str]:
        """What one process data object holds."""
        words = self._lists[index][: self._counts[index]]
        return [AT[word >> 16, word >> 8 & 0xFF].name for word in words]

    def assigned(self, first: int) -> Layout:
        """Of all that 0x1C12 (`first` = 0x1600) or 0x1C13 (0x1A00) names, one behind the other."""
        return Layout([self.names(index) for index in self._lists[_ASSIGNED[first]][: self._counts[_ASSIGNED[first]]]])

    def read(self, index: int, subindex: int) -> bytes:
        """An object of the mapping, or one of the firmware. Raises SdoAbortError."""
        if index in self.messages:
            if subindex > 2:
                raise SdoAbortError(NO_SUBINDEX)
            return struct.pack("<I", self.messages[index]) if subindex == 1 else bytes([2 if subindex == 0 else 1])
        if index not in self._lists:
            return self.firmware.read(index, subindex)
        entries = self._lists[index]
        if subindex == 0:
            return bytes([self._counts[index]])
        if subindex > len(entries):
            raise SdoAbortError(NO_SUBINDEX)
        return struct.pack("<H" if index >= 0x1C00 else "<I", entries[subindex - 1])

    def write(self, index: int, subindex: int, content: bytes) -> None:
        """Change one. Raises SdoAbortError."""
        if index not in self._lists and index not in self.messages:
            self.firmware.write(index, subindex, content)
            return
        if not self._changeable():
            raise SdoAbortError(WRONG_STATE)
        value = int.from_bytes(content, "little")
        if index in self.messages:
            if subindex == 1:
                self.messages[index] = value
            elif subindex != 2 or value not in (0, 1):  # with every SYNC
                raise SdoAbortError(TOO_LARGE)
            return
        if len(content) != (1 if subindex == 0 else 2 if index >= 0x1C00 else 4):
            raise SdoAbortError(WRONG_LENGTH)
        entries = self._lists[index]
        if subindex == 0:
            if value > len(entries):
                raise SdoAbortError(_TOO_MANY)
            self._counts[index] = value
            return
        if self._counts[index]:
            raise SdoAbortError(WRONG_STATE)  # the count is set to 0 first
        if subindex > _ENTRIES:
            raise SdoAbortError(_TOO_MANY)
        if index < 0x1C00:
            found = AT.get((value >> 16, value >> 8 & 0xFF))
            if found is None or not self.firmware.has(found.name) or found.mapped != value:
                raise SdoAbortError(_NOT_MAPPABLE)
        elif value not in self._lists or value >= 0x1C00:
            raise SdoAbortError(NO_OBJECT)
        entries += [entries[0] if entries else value] * (subindex - len(entries))
        entries[subindex - 1] = value

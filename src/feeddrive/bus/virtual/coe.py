"""The mailbox of a virtual EtherCAT slave: CANopen over EtherCAT, SDO up and down.

Segmented transfer, complete access and SDO information are refused with an abort code; masters do without them.
"""

from __future__ import annotations

import struct

from feeddrive.bus.virtual.firmware import NO_SUBINDEX, SdoAbortError
from feeddrive.bus.virtual.pdo_map import PdoMap

_COE, _REQUEST, _RESPONSE = 3, 2, 3
_UPLOAD, _DOWNLOAD = 2, 1
_UNKNOWN_COMMAND = 0x05040001
_SYNC_TYPES = 0x1C00  # what each sync manager is for: mailbox out, mailbox in, outputs, inputs


def answer(message: bytes, objects: PdoMap) -> bytes | None:
    """What comes back for a mailbox message; None for one that is no CoE request."""
    length, _, _, kind = struct.unpack_from("<HHBB", message)
    body = message[6 : 6 + length]
    if kind & 0x0F != _COE or len(body) < 10:
        return None
    service = struct.unpack_from("<H", body)[0] >> 12
    command, index, subindex = struct.unpack_from("<BHB", body, 2)
    try:
        if service != _REQUEST or command & 0x10:  # 0x10: complete access
            raise SdoAbortError(_UNKNOWN_COMMAND)
        answered = _sdo(objects, command, index, subindex, body[6:])
    except SdoAbortError as refused:
        # an abort is a request in the other direction
        return _framed(struct.pack("<HBHBI", _REQUEST << 12, 0x80, index, subindex, refused.code), kind)
    return _framed(struct.pack("<H", _RESPONSE << 12) + answered, kind)


def _sdo(objects: PdoMap, command: int, index: int, subindex: int, content: bytes) -> bytes:
    place = struct.pack("<HB", index, subindex)
    if command >> 5 == _UPLOAD:
        value = _sync_type(subindex) if index == _SYNC_TYPES else objects.read(index, subindex)
        if len(value) <= 4:
            return bytes([0x43 | (4 - len(value)) << 2]) + place + value.ljust(4, b"\x00")
        return b"\x41" + place + struct.pack("<I", len(value)) + value
    if command >> 5 != _DOWNLOAD:
        raise SdoAbortError(_UNKNOWN_COMMAND)
    if command & 0x02:  # expedited
        value = content[: 4 - (command >> 2 & 3) if command & 0x01 else 4]
    else:
        size = struct.unpack_from("<I", content)[0]
        value = content[4 : 4 + size]
        if len(value) != size:
            raise SdoAbortError(_UNKNOWN_COMMAND)
    objects.write(index, subindex, value)
    return b"\x60" + place + bytes(4)


def _sync_type(subindex: int) -> bytes:
    if subindex > 4:
        raise SdoAbortError(NO_SUBINDEX)
    return bytes([subindex or 4])


def _framed(content: bytes, kind: int) -> bytes:
    return struct.pack("<HHBB", len(content), 0, 0, kind) + content

"""The EEPROM of a virtual EtherCAT slave (SII): identity, mailboxes, and the sync managers to set up."""

from __future__ import annotations

import struct

# process memory of the slave: address and length
MAILBOX_OUT, MAILBOX_IN = (0x1000, 128), (0x1080, 128)
OUTPUTS, INPUTS = (0x1100, 64), (0x1200, 64)
_GENERAL, _FMMU, _SYNC, _STRINGS, _END = 30, 40, 41, 10, 0xFFFF
_COE = 0x04  # mailbox protocol
_COE_DETAILS = 0x0D  # SDO, PDO assignment and PDO mapping may be written


def eeprom(vendor: int, product: int, revision: int, serial: int, name: str) -> bytes:
    """The image, a multiple of 8 bytes, by ETG.1000.6 and ETG.2010."""
    head = bytearray(128)
    struct.pack_into("<IIII", head, 0x10, vendor, product, revision, serial)
    struct.pack_into("<HHHHH", head, 0x30, *MAILBOX_OUT, *MAILBOX_IN, _COE)
    struct.pack_into("<HH", head, 0x7C, 0x07, 1)  # size 8 kbit, version
    text = name.encode()
    strings = bytes([1, len(text)]) + text
    general = bytearray(32)
    general[3] = 1  # name: first string
    general[5] = _COE_DETAILS
    sync = b"".join(
        struct.pack("<HHBBBB", start, length, control, 0, 1, kind)
        for (start, length), control, kind in (
            (MAILBOX_OUT, 0x26, 1), (MAILBOX_IN, 0x22, 2), ((OUTPUTS[0], 0), 0x64, 3), ((INPUTS[0], 0), 0x20, 4),
        )
    )  # fmt: skip
    categories = ((_STRINGS, strings), (_GENERAL, bytes(general)), (_FMMU, b"\x01\x02"), (_SYNC, sync))
    body = b"".join(_category(kind, content) for kind, content in categories)
    image = bytes(head) + body + struct.pack("<HH", _END, 0)
    return image + b"\xff" * (-len(image) % 8)


def _category(kind: int, content: bytes) -> bytes:
    padded = content + b"\x00" * (len(content) % 2)
    return struct.pack("<HH", kind, len(padded) // 2) + padded

"""A small MDF4 file, built block by block as ASAM MDF 4.1 describes it."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping

import numpy as np


def mdf4(columns: Mapping[str, np.ndarray], T: float, *, packed: bool = False) -> bytes:
    """Channels in mm and raw numbers of 2 bytes with a linear conversion, over time; the records in a list of two."""
    rows = len(next(iter(columns.values())))
    kinds = [("time", "<f8"), *((name, "<f8" if k == 0 else "<i2") for k, name in enumerate(columns))]
    records = np.zeros(rows, dtype=kinds)
    records["time"] = T * np.arange(rows)
    for k, (name, values) in enumerate(columns.items()):
        records[name] = values if k == 0 else np.rint(100.0 * values)
    made = _Made()
    half = rows // 2
    parts = [made.data(part.tobytes(), packed) for part in (records[:half], records[half:])]
    data = made.block(b"##DL", [0, *parts], struct.pack("<B3xI2Q", 0, 2, 0, records[:half].nbytes))
    following, offset = 0, records.itemsize
    for k, (name, kind) in reversed(list(enumerate(kinds))):
        width = np.dtype(kind).itemsize
        offset -= width
        is_time, small = k == 0, kind == "<i2"
        conversion = made.block(b"##CC", [0] * 4, struct.pack("<BBHHHdddd", 1, 0, 0, 0, 2, 0, 0, 0.0, 0.01))
        links = [
            following,
            0,
            made.text(name),
            0,
            conversion if small else 0,
            0,
            made.text("s" if is_time else "mm"),
            0,
        ]
        head = struct.pack("<BBBBIIII", 2 * is_time, is_time, 2 if small else 4, 0, offset, 8 * width, 0, 0)
        following = made.block(b"##CN", links, head + bytes(48))
    group = made.block(
        b"##CG", [0, following, 0, 0, 0, 0], struct.pack("<QQHH4xII", 0, rows, 0, 0, records.itemsize, 0)
    )
    made.point(made.block(b"##DG", [0, group, data, 0], bytes(8)))
    return bytes(made.content)


class _Made:
    """A file with its first block, which is to point at the first group."""

    def __init__(self) -> None:
        self.content = bytearray(b"MDF     4.10    feeddrv ".ljust(28, b"\0") + struct.pack("<H", 410)).ljust(64, b"\0")
        self.block(b"##HD", [0] * 6, bytes(32))

    def block(self, kind: bytes, links: list[int], data: bytes) -> int:
        """Its address."""
        address = len(self.content)
        length = 24 + 8 * len(links) + len(data)
        self.content += struct.pack("<4s4xQQ", kind, length, len(links)) + struct.pack(f"<{len(links)}Q", *links) + data
        self.content += bytes(-len(self.content) % 8)
        return address

    def text(self, text: str) -> int:
        return self.block(b"##TX", [], text.encode() + b"\0")

    def data(self, content: bytes, packed: bool) -> int:
        if not packed:
            return self.block(b"##DT", [], content)
        small = zlib.compress(content)
        return self.block(b"##DZ", [], struct.pack("<2sBxIQQ", b"DT", 0, 0, len(content), len(small)) + small)

    def point(self, address: int) -> None:
        self.content[64 + 24 : 64 + 32] = struct.pack("<Q", address)

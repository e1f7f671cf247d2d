"""Blocks of an MDF4 file (ASAM MDF 4.0 to 4.2): heads, links, texts and data, each checked before it is believed."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from feeddrive.files.columns import most_unpacked
from feeddrive.language.errors import LogError

_HEAD = struct.Struct("<4s4xQQ")  # id, length, number of links
_PACKED = struct.Struct("<2sBxIQQ")  # id of the original, kind, columns, length of the original, of what is packed
_MOST_BLOCKS = 100_000  # visited: chains of a damaged file may run in circles
_MOST_LINKS = 100_000


class DamagedError(Exception):
    """A block is not what a link says, or not in the file."""


@dataclass(frozen=True, eq=False)
class Block:
    """A block: its id such as `##CN`, its links and the bytes behind them."""

    kind: bytes
    links: tuple[int, ...]
    data: memoryview

    def link(self, place: int) -> int:
        """A link, 0 if the block does not have so many."""
        return self.links[place] if place < len(self.links) else 0

    def numbers(self, layout: str, at: int = 0) -> tuple[int, ...]:
        """Little-endian numbers from byte `at` on. Raises DamagedError if the block ends before."""
        return self._unpacked(layout, at)

    def floats(self, count: int, at: int) -> tuple[float, ...]:
        """`count` doubles from byte `at` on. Raises DamagedError if the block ends before."""
        return self._unpacked(f"{count}d", at)

    def _unpacked(self, layout: str, at: int) -> tuple[int, ...]:
        try:
            return struct.unpack_from(f"<{layout}", self.data, at)
        except struct.error:
            raise DamagedError from None


class Blocks:
    """All blocks of a file by their address."""

    def __init__(self, name: str, content: bytes) -> None:
        self.name = name
        self.content = memoryview(content)
        self.visited = 0

    def at(self, address: int, *kinds: bytes) -> Block:
        """The block there. Raises DamagedError if it is none of these kinds or not all in the file."""
        self.visited += 1
        if self.visited > _MOST_BLOCKS or address < 0 or address + _HEAD.size > len(self.content):
            raise DamagedError
        kind, length, count = _HEAD.unpack_from(self.content, address)
        begin = address + _HEAD.size + 8 * count
        if kind not in kinds or count > _MOST_LINKS or begin > address + length or address + length > len(self.content):
            raise DamagedError
        links = struct.unpack_from(f"<{count}Q", self.content, address + _HEAD.size)
        return Block(kind, links, self.content[begin : address + length])

    def chain(self, address: int, kind: bytes) -> Iterator[Block]:
        """A block and those that its first links lead to."""
        while address:
            block = self.at(address, kind)
            yield block
            address = block.link(0)

    def text(self, address: int) -> str:
        """A text, plain or in the TX element of a comment; empty if there is none."""
        if not address:
            return ""
        block = self.at(address, b"##TX", b"##MD")
        text = bytes(block.data).split(b"\0", 1)[0].decode("utf-8", errors="replace")
        if block.kind == b"##MD":
            inside = re.search(r"<TX[^>]*>([^<]*)</TX>", text)
            text = "" if inside is None else inside[1]
        return " ".join(text.split())

    def records(self, address: int) -> list[memoryview]:
        """The pieces of a data group's records: as they stand in the file, or unpacked.

        Raises LogError for packed pieces that hold more than they may, and for ways to store that are not read.
        """
        if not address:
            return []
        block = self.at(address, b"##DT", b"##DZ", b"##DL", b"##HL", b"##DV", b"##LD")
        if block.kind in (b"##DV", b"##LD"):
            raise LogError(f"{self.name}: is an MDF4 file that stores columns (4.2); save it as version 4.10 or 4.11")
        if block.kind == b"##HL":
            block = self.at(block.link(0), b"##DL")
        if block.kind in (b"##DT", b"##DZ"):
            return [self._piece(block, 0)]
        found: list[memoryview] = []
        size = 0
        while True:
            for address in block.links[1:]:
                if address:
                    found.append(self._piece(self.at(address, b"##DT", b"##DZ"), size))
                    size += len(found[-1])
                    self._check(size)
            if not block.link(0):
                return found
            block = self.at(block.link(0), b"##DL")

    def _piece(self, block: Block, before: int) -> memoryview:
        return block.data if block.kind == b"##DT" else memoryview(self._unpacked(block, before))

    def _check(self, size: int) -> None:
        """A block that a list names many times is a bomb, too."""
        if size > most_unpacked(len(self.content)):
            raise LogError(f"{self.name}: its packed blocks hold more than they may; it is damaged or a bomb")

    def _unpacked(self, block: Block, before: int) -> bytes:
        try:
            _, way, columns, stated, packed = _PACKED.unpack_from(block.data)
        except struct.error:
            raise DamagedError from None
        self._check(before + stated)
        if way not in (0, 1):
            raise LogError(f"{self.name}: is an MDF4 file packed in a way that is not read; save it without or by zlib")
        zip_ = zlib.decompressobj()
        try:
            found = zip_.decompress(block.data[_PACKED.size : _PACKED.size + packed], stated + 1)
        except zlib.error:
            raise DamagedError from None
        if len(found) != stated:
            raise DamagedError
        if way == 0 or columns < 2 or stated < columns:
            return found
        # bytes that stand beside each other in the records were put below each other, which packs better
        whole = stated // columns * columns
        turned = np.frombuffer(found, np.uint8, whole).reshape(columns, -1)
        return turned.T.tobytes() + found[whole:]

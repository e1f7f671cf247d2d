"""MDF4 measurement files (ASAM MDF 4.0 to 4.2): the numeric channels of the group with the most requested channels.

Supported are sorted files with row-wise records, plain or zlib-compressed, and numeric conversions.  Formulas are not
executed.  Every header, link and length is checked before it is used: asammdf crashes on damaged files, see
tests/files/test_files_reasons.py.
"""

import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from feeddrive.files.columns import Columns, check_unpacked, is_wanted, most_unpacked, unit_of
from feeddrive.language.errors import LogError
from feeddrive.language.quantity import Quantity

_HEAD = struct.Struct("<4s4xQQ")  # id, length, number of links
_PACKED = struct.Struct("<2sBxIQQ")  # id of the original, kind, columns, length of the original, of what is packed
_MOST_BLOCKS = 100_000  # visited: chains of a damaged file may be circular
_MOST_LINKS = 100_000


class DamagedError(Exception):
    """The exception for a linked block that is of the wrong kind or incomplete."""


@dataclass(frozen=True, eq=False)
class Block:
    """A block of an MDF file: its id such as `##CN`, its links and the data bytes after them."""

    kind: bytes
    links: tuple[int, ...]
    data: memoryview

    def link(self, place: int) -> int:
        """Return a link by index, or 0 if the block has fewer links."""
        return self.links[place] if place < len(self.links) else 0

    def numbers(self, layout: str, at: int = 0) -> tuple[int, ...]:
        """Unpack little-endian numbers from byte `at` onward. Raise DamagedError if the block is too short."""
        return self._unpacked(layout, at)

    def floats(self, count: int, at: int) -> tuple[float, ...]:
        """Unpack `count` doubles from byte `at` onward. Raise DamagedError if the block is too short."""
        return self._unpacked(f"{count}d", at)

    def _unpacked(self, layout: str, at: int) -> tuple[int, ...]:
        try:
            return struct.unpack_from(f"<{layout}", self.data, at)
        except struct.error:
            raise DamagedError from None


class Blocks:
    """The blocks of a file, read by address."""

    def __init__(self, name: str, content: bytes) -> None:
        self.name = name
        self.content = memoryview(content)
        self.visited = 0

    def at(self, address: int, *kinds: bytes) -> Block:
        """Return the block at an address. Raise DamagedError if it is of another kind or truncated."""
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
        """Yield the blocks of a linked list; the first link of a block leads to the next block."""
        while address:
            block = self.at(address, kind)
            yield block
            address = block.link(0)

    def text(self, address: int) -> str:
        """Return the text of a text block or of the TX element of a metadata block, otherwise an empty string."""
        if not address:
            return ""
        block = self.at(address, b"##TX", b"##MD")
        text = bytes(block.data).split(b"\0", 1)[0].decode("utf-8", errors="replace")
        if block.kind == b"##MD":
            inside = re.search(r"<TX[^>]*>([^<]*)</TX>", text)
            text = "" if inside is None else inside[1]
        return " ".join(text.split())

    def records(self, address: int) -> list[memoryview]:
        """Return the record data of a data group in pieces, decompressed where necessary.

        Raises LogError for compressed data above the size limit, and for unsupported storage formats.
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
        pieces: list[memoryview] = []
        size = 0
        while True:
            for address in block.links[1:]:
                if address:
                    pieces.append(self._piece(self.at(address, b"##DT", b"##DZ"), size))
                    size += len(pieces[-1])
                    self._check(size)
            if not block.link(0):
                return pieces
            block = self.at(block.link(0), b"##DL")

    def _piece(self, block: Block, before: int) -> memoryview:
        return block.data if block.kind == b"##DT" else memoryview(self._unpacked(block, before))

    def _check(self, size: int) -> None:
        """Raise LogError if the decompressed size exceeds its limit; a list may reference one block many times."""
        if size > most_unpacked(len(self.content)):
            raise LogError(f"{self.name}: its packed blocks hold more than allowed; it is damaged or a zip bomb")

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
            # one byte beyond shows a block that holds more than it states
            unpacked = zip_.decompress(block.data[_PACKED.size : _PACKED.size + packed], stated + 1)
        except zlib.error:
            raise DamagedError from None
        if len(unpacked) != stated:
            raise DamagedError
        if way == 0 or columns < 2 or stated < columns:
            return unpacked
        # the bytes of the records were transposed, which packs better
        whole = stated // columns * columns
        turned = np.frombuffer(unpacked, np.uint8, whole).reshape(columns, -1)
        return turned.T.tobytes() + unpacked[whole:]


MOST_BYTES = 200_000_000
STARTS = (b"MDF     4", b"UnFinMF 4")
_HEADER = 64  # address of the first block
_FIXED, _MASTER, _VIRTUAL_MASTER = 0, 2, 3
_TIME = 1  # unit of a master channel
_FLOATS = {16: "f2", 32: "f4", 64: "f8"}


@dataclass(frozen=True, eq=False)
class _Channel:
    """The name, unit and block of a channel, and the reason why it is not read, if any."""

    label: str
    unit: str
    block: Block
    trouble: str

    @property
    def is_time(self) -> bool:
        kind, counts = self.block.numbers("BB")
        return kind in (_MASTER, _VIRTUAL_MASTER) and counts == _TIME


@dataclass(frozen=True, eq=False)
class _Group:
    """The channels of one clock: `rows` records of `size` bytes from address `data`, each after a `before`-byte id."""

    channels: tuple[_Channel, ...]
    data: int
    rows: int
    before: int
    kept: int  # bytes of values in a record
    invalid: int  # bytes of flags behind them

    @property
    def size(self) -> int:
        return self.before + self.kept + self.invalid


def read_mdf(name: str, content: bytes, wanted: frozenset[str] | None) -> Columns:
    """Read the group with the most requested channels. Raise LogError for a damaged or unsupported file."""
    if len(content) > MOST_BYTES:
        raise LogError(
            f"{name}: has {Quantity(len(content) / 1e6, 'MB'):,.0f}, more than the "
            f"{Quantity(MOST_BYTES / 1e6, 'MB'):,.0f} of an MDF4 file that are read; export the channels that are "
            "needed"
        )
    blocks = Blocks(name, content)
    try:
        groups = _groups(blocks)
        useful = [group for group in groups if any(not c.trouble and not c.is_time for c in group.channels)]
        if not useful:
            raise LogError(f"{name}: is an MDF4 file without numbers; export its channels")
        chosen = max(useful, key=lambda group: sum(is_wanted(c.label, wanted) for c in group.channels if not c.trouble))
        check_unpacked(name, chosen.rows * len(chosen.channels), len(content))
        return _columns(blocks, chosen, groups, wanted)
    except DamagedError:
        raise LogError(f"{name}: is a damaged or cut off MDF4 file; export it again") from None


def _groups(blocks: Blocks) -> list[_Group]:
    """Return all groups that contain records."""
    recorded: list[_Group] = []
    finished = bytes(blocks.content[:8]) == b"MDF     "
    for data_group in blocks.chain(blocks.at(_HEADER, b"##HD").link(0), b"##DG"):
        (before,) = data_group.numbers("B")
        groups = list(blocks.chain(data_group.link(1), b"##CG"))
        if len(groups) > 1:
            raise LogError(
                f"{blocks.name}: is an unsorted MDF4 file, with records of {len(groups)} groups mixed; save it sorted"
            )
        for group in groups:
            _, rows, flags, _, kept, invalid = group.numbers("QQHH4xII")
            if flags & 1 or not data_group.link(2):  # lengths of texts; nothing recorded
                continue
            size = before + kept + invalid
            # An unfinished file, as after a crash of the recorder, has no count of its records yet.
            if not finished and rows == 0 and size:
                rows = sum(len(piece) for piece in blocks.records(data_group.link(2))) // size
            channels = _channels(blocks, group)
            if rows and channels:
                recorded.append(_Group(channels, data_group.link(2), rows, before, kept, invalid))
    return recorded


def _channels(blocks: Blocks, group: Block) -> tuple[_Channel, ...]:
    channels: list[_Channel] = []
    seen: dict[str, int] = {}
    for block in blocks.chain(group.link(1), b"##CN"):
        kind, _, data, _ = block.numbers("BBBB")
        label = blocks.text(block.link(2)) or f"channel_{len(channels) + 1}"
        seen[label] = seen.get(label, 0) + 1
        label = label if seen[label] == 1 else f"{label}_{seen[label]}"
        conversion = blocks.at(block.link(4), b"##CC") if block.link(4) else None
        unit = blocks.text(block.link(6)) or ("" if conversion is None else blocks.text(conversion.link(1)))
        trouble = "" if conversion is None or conversion.numbers("B")[0] in _CONVERSIONS else _TROUBLE
        if kind not in (_FIXED, _MASTER, _VIRTUAL_MASTER) or (kind != _VIRTUAL_MASTER and data > 5) or block.link(1):
            trouble = "not plain numbers"
        channels.append(_Channel(label, unit, block, trouble))
    return tuple(channels)


def _columns(blocks: Blocks, chosen: _Group, groups: list[_Group], wanted: frozenset[str] | None) -> Columns:
    values: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    left_out = {channel.label: channel.trouble for channel in chosen.channels if channel.trouble}
    unread: list[str] = []
    data = _whole(blocks.records(chosen.data), chosen)
    for channel in chosen.channels:
        if channel.trouble:
            continue
        if not channel.is_time and not is_wanted(channel.label, wanted):
            unread.append(channel.label)
            continue
        label = "time" if channel.is_time else channel.label
        values[label] = _converted(blocks, channel.block, _raw(channel.block, chosen, data))
        unit = channel.unit or ("s" if channel.is_time else "")
        if unit:
            units[label] = unit_of(unit) or unit
    for group in groups:
        if group is not chosen:
            apart = {c.label: "of another group, with a clock of its own" for c in group.channels if not c.is_time}
            left_out = apart | left_out
    return Columns("MDF4", values, units, unread=tuple(unread), left_out=left_out)


def _raw(channel: Block, group: _Group, data: list[memoryview]) -> np.ndarray:
    """Return the raw values of a channel, NaN where its invalidation bit is set."""
    kind, _, form, shift, offset, bits, flags, flag_at = channel.numbers("BBBBIIII")
    if kind == _VIRTUAL_MASTER:
        return np.arange(group.rows, dtype=np.float64)
    width = (shift + bits + 7) // 8
    if not 0 < width <= 8 or offset + width > group.kept:
        raise DamagedError
    big = form in (1, 3, 5)
    if form >= 4:
        if bits not in _FLOATS or shift:
            raise DamagedError
        values = _strided(data, group, offset, (">" if big else "<") + _FLOATS[bits]).astype(np.float64, copy=False)
    else:
        values = _integers(data, group, offset, width, big)
        values = (values >> np.uint64(shift)) & np.uint64((1 << bits) - 1)
        if form >= 2:
            # Two's complement: shifted to the top and back, the sign bit fills the bits above.
            values = (values << np.uint64(64 - bits)).view(np.int64) >> np.int64(64 - bits)
        values = values.astype(np.float64, copy=False)
    if flags & 1:
        values[:] = np.nan
    elif flags & 2:
        if flag_at // 8 >= group.invalid:
            raise DamagedError
        flag = _strided(data, group, group.kept + flag_at // 8, "u1")
        values[flag & np.uint8(1 << flag_at % 8) != 0] = np.nan
    return values


def _integers(data: list[memoryview], group: _Group, offset: int, width: int, big: bool) -> np.ndarray:
    """Decode `width` bytes of each record as an unsigned integer."""
    # byte by byte: a field may have 3, 5, 6 or 7 bytes, for which numpy has no type
    numbers = np.zeros(group.rows, dtype=np.uint64)
    for k in range(width):
        place = offset + (width - 1 - k if big else k)
        numbers |= _strided(data, group, place, "u1").astype(np.uint64) << np.uint64(8 * k)
    return numbers


def _strided(data: list[memoryview], group: _Group, offset: int, dtype: str) -> np.ndarray:
    """Return one field of all records as an array, through a strided view of the data."""
    at, size = group.before + offset, group.size
    return np.concatenate([np.ndarray((len(piece) // size,), dtype, piece, at, (size,)) for piece in data])


def _whole(pieces: list[memoryview], group: _Group) -> list[memoryview]:
    """Return pieces of whole records, joined if any record spans two. Raise DamagedError if records are missing."""
    size, length = group.size, group.rows * group.size
    if size == 0 or length > sum(len(piece) for piece in pieces):
        raise DamagedError
    if any(len(piece) % size for piece in pieces[:-1]):
        pieces = [memoryview(b"".join(pieces))]
    whole: list[memoryview] = []
    for piece in pieces:
        whole.append(piece[: min(len(piece), length) // size * size])
        length -= len(whole[-1])
    return [piece for piece in whole if len(piece)]


_CONVERSIONS = (0, 1, 2, 4, 5)  # none, linear, rational, tables of values with and without interpolation
_TROUBLE = "converted by a formula, a table of ranges or of texts"


def _converted(blocks: Blocks, channel: Block, raw: np.ndarray) -> np.ndarray:
    """Convert raw values to the unit of the channel."""
    if not channel.link(4):
        return raw
    block = blocks.at(channel.link(4), b"##CC")
    kind, _, _, _, count = block.numbers("BBHHH")
    numbers = block.floats(count, 24)
    with np.errstate(all="ignore"):
        match kind:
            case 1 if count >= 2:
                return numbers[0] + numbers[1] * raw
            case 2 if count >= 6:
                a, b, c, d, e, f = numbers[:6]
                return ((a * raw + b) * raw + c) / ((d * raw + e) * raw + f)
            case 4 | 5 if count >= 4 and count % 2 == 0:
                keys, values = np.array(numbers[::2]), np.array(numbers[1::2])
                if not np.all(np.diff(keys) > 0.0):
                    raise DamagedError
                if kind == 4:
                    return np.interp(raw, keys, values)
                # Without interpolation the value of the nearest key holds.
                return values[np.searchsorted(0.5 * (keys[1:] + keys[:-1]), raw)]
            case 0:
                return raw
            case _:
                raise DamagedError

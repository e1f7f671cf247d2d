"""MDF4 measurement files (ASAM MDF 4): the numeric channels of the group that has most of those that are wanted.

Needs asammdf (the extra `mdf`, some 50 MB).  Up to 200 MB; packed blocks are measured before they are unpacked.
"""

from __future__ import annotations

import contextlib
import io
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from feeddrive.artefacts.files.columns import Columns, check_unpacked, is_wanted, most_unpacked, unit_of
from feeddrive.language.errors import LogError, MissingExtraError

MOST_BYTES = 200_000_000
STARTS = (b"MDF     4", b"UnFinMF 4")
_PACKED = b"##DZ"  # a block: id, 4 free bytes, length, links; kind (8 bytes), length of the original, of what is packed
_HEAD = 48
_PIECE = 1_000_000


def read_mdf(name: str, content: bytes, wanted: frozenset[str] | None) -> Columns:
    """The channels of one group. Raises LogError if it is damaged, MissingExtraError without asammdf."""
    try:
        from asammdf import MDF  # pyright: ignore[reportMissingImports]  # an extra that `dev` does not bring
    except ImportError:
        raise MissingExtraError("asammdf", "mdf", f"{name}: reading an MDF4 file") from None
    if len(content) > MOST_BYTES:
        raise LogError(
            f"{name}: has {len(content) / 1e6:,.0f} MB, more than the {MOST_BYTES / 1e6:,.0f} MB of an MDF4 file that "
            "are read; export the channels that are needed"
        )
    _check_packed(name, content)
    try:
        # asammdf prints what it finds odd in a damaged file
        with contextlib.redirect_stdout(io.StringIO()), MDF(io.BytesIO(content)) as file:
            groups = [(k, list(_channels(file, k))) for k in range(len(file.groups))]
            groups = [(k, channels) for k, channels in groups if channels]
            if not groups:
                raise LogError(f"{name}: is an MDF4 file without numbers; export its channels")
            index, chosen = max(groups, key=lambda group: sum(is_wanted(label, wanted) for _, label in group[1]))
            cycles = int(file.groups[index].channel_group.cycles_nr)
            check_unpacked(name, cycles * (len(chosen) + 1), len(content))
            return _columns(file, index, chosen, groups, wanted)
    except LogError:
        raise
    except Exception:  # asammdf hands every kind of error through
        raise LogError(f"{name}: is a damaged or cut off MDF4 file; export it again") from None


def _channels(file: Any, group: int) -> Iterator[tuple[int, str]]:
    """Place and name of the channels of a group that hold plain numbers, without its time."""
    for place, channel in enumerate(file.groups[group].channels):
        if int(channel.channel_type) == 0 and int(channel.data_type) <= 5:  # fixed length; integers and floats
            yield place, str(channel.name)


def _columns(
    file: Any, index: int, chosen: list[tuple[int, str]], groups: list[Any], wanted: frozenset[str] | None
) -> Columns:
    values: dict[str, np.ndarray] = {}
    units: dict[str, str] = {"time": "s"}
    left_out: dict[str, str] = {}
    unread: list[str] = []
    for place, label in chosen:
        if not is_wanted(label, wanted):
            unread.append(label)
            continue
        signal = file.get(group=index, index=place, ignore_invalidation_bits=True)
        numbers = np.asarray(signal.samples)
        if numbers.ndim != 1 or numbers.dtype.kind not in "fiub":
            left_out[label] = "no plain numbers"
            continue
        values.setdefault("time", np.asarray(signal.timestamps, dtype=np.float64))
        values[label] = numbers.astype(np.float64)
        if signal.unit:
            units[label] = unit_of(str(signal.unit)) or str(signal.unit)
    for k, channels in groups:
        if k != index:
            left_out |= {label: "of another group, with a clock of its own" for _, label in channels}
    return Columns("MDF4", values, units, unread=tuple(unread), left_out=left_out)


def _check_packed(name: str, content: bytes) -> None:
    """Raise LogError if the packed blocks hold more than they state, or more than is read."""
    total, at = 0, content.find(_PACKED)
    while at >= 0:
        stated = int.from_bytes(content[at + 32 : at + 40], "little")
        length = int.from_bytes(content[at + 40 : at + _HEAD], "little")
        total += stated
        if total > most_unpacked(len(content)) or _unpacks_to_more(content[at + _HEAD : at + _HEAD + length], stated):
            raise LogError(f"{name}: its packed blocks hold more than they may; it is damaged or a bomb")
        at = content.find(_PACKED, at + 4)


def _unpacks_to_more(packed: bytes, stated: int) -> bool:
    """True if zlib makes more bytes of it than stated; nothing of them is kept."""
    zip_ = zlib.decompressobj()
    size, rest = 0, packed
    try:
        while rest and not zip_.eof:
            size += len(zip_.decompress(rest, _PIECE))
            if size > stated:
                return True
            rest = zip_.unconsumed_tail
    except zlib.error:
        return False  # damaged, which its reader will say
    return False

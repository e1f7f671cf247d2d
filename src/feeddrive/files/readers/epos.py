"""The recorder of maxon EPOS Studio: a text with a head, whose statements about the clock and the rows are checked.

    Date:;2020-07-08 21:13:16
    EPOS Studio Version:;3.6.1.0
    Recorded samples:;500
    Sampling period:;12.800                ms
    ;Velocity actual value averaged;Torque actual value averaged
    ms;rpm;%
    0.000;-101;-24.1

Torque is in percent of the motor's nominal torque, current in mA, position in counts.
"""

from __future__ import annotations

import re
from dataclasses import replace

from feeddrive.files.columns import Columns
from feeddrive.files.readers.csv_log import read_csv
from feeddrive.language.errors import LogError

_HEAD = 4096  # bytes in which the statements stand
_VERSION = re.compile(rb"^EPOS Studio Version:", re.MULTILINE)
_PERIOD = re.compile(rb"^Sampling period:;([0-9]{1,9}(?:[.,][0-9]{0,9})?)\s*$", re.MULTILINE)
_ROWS = re.compile(rb"^Recorded samples:;([0-9]{1,9})\s*$", re.MULTILINE)


def is_epos(content: bytes) -> bool:
    """True for a recording of EPOS Studio."""
    return _VERSION.search(content[:_HEAD]) is not None


def read_epos(name: str, content: bytes, wanted: frozenset[str] | None) -> Columns:
    """The channels of a recording. Raises LogError that names file and line, also for rows that are missing."""
    found = read_csv(name, content, wanted)
    rows = max((column.size for column in found.values.values()), default=0)
    stated = _ROWS.search(content[:_HEAD])
    if stated is not None and found.values and rows != int(stated[1]):
        raise LogError(
            f"{name}: states {int(stated[1])} recorded samples and holds {rows}; it is cut off or was edited: "
            "export it again, or correct the line 'Recorded samples'"
        )
    period = _PERIOD.search(content[:_HEAD])
    seconds = 0.0 if period is None else round(float(period[1].replace(b",", b".")) * 1e-3, 12)
    return replace(found, format="EPOS Studio", metadata={"sample_time": seconds} if seconds > 0.0 else {})

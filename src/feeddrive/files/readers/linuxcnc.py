"""What the recorders of LinuxCNC write: halscope (two layouts) and halsampler.

    # Sampling period is 1000000 ns        halscope since 2.9: names, two lines of its screen, then rows with ';'
    joint.0.motor-pos-cmd;joint.0.motor-pos-fb
    # Position: 0.500000;0.500000
    # Scale: 0;0

    Sampling period is 1000000 ns          halscope before: name and value by turns
    joint.0.motor-pos-cmd +0.0 joint.0.motor-pos-fb +0.0

    17 0.000000 1.250000 0                 halsampler: no names, a number of the sample only with its option -t

halsampler prints six decimals: positions in mm are then exact to a nanometer, small signals in SI are coarse.  It says
`overrun` where samples were lost.
"""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from feeddrive.files.columns import Columns
from feeddrive.files.readers.csv_log import read_csv
from feeddrive.language.errors import LogError

_PERIOD = re.compile(rb"(?:# *)?Sampling period is (-?\d{1,18}) n(?:s|Sec)[ \t]*\r?\n")
_SCREEN = re.compile(rb"^# (?:Position|Scale): [^\n]*", re.MULTILINE)
_SAMPLER = re.compile(rb"(?:overrun\n){0,3}(?:(?:-?\d{1,20}(?:\.\d{6})?|-?nan|-?inf) ){1,64}\n")
_OVERRUNS = re.compile(rb"(?:overrun\n)+")
COUNTER = "sample"


def is_halscope(content: bytes) -> bool:
    """True for a log that halscope wrote."""
    return _PERIOD.match(content) is not None


def is_halsampler(content: bytes) -> bool:
    """True for a log that halsampler wrote: numbers with six decimals or none, a space after each of them."""
    return _SAMPLER.match(content) is not None


def read_halscope(name: str, content: bytes, wanted: frozenset[str] | None) -> Columns:
    """The channels of a halscope log, with its sample time. Raises LogError that names file and line."""
    head = _PERIOD.match(content)
    assert head is not None
    period = int(head[1])
    if period <= 0:
        raise LogError(f"{name}: states a sampling period of {period} ns, which must be > 0 ns; give the sample time")
    metadata = {"sample_time": period / 1e9}
    if content.startswith(b"#"):
        # the lines of the screen stand between the names and the numbers; emptied, they keep the numbers of the lines
        body = b"\n" + _SCREEN.sub(b"", content[head.end() :])
        found = read_csv(name, body, wanted)
        return replace(found, format="halscope", metadata=metadata)
    found = read_csv(name, b"\n" + content[head.end() :], None)
    names = _names_between(name, content[head.end() :])
    places = {f"column_{2 * k + 2}": label for k, label in enumerate(names)}
    if set(found.values) != set(places):
        raise LogError(f"{name}: is a halscope log whose lines are not names and numbers by turns; export it as CSV")
    rows = max(values.size for values in found.values.values())
    for label in names:
        word = label.encode("utf-8", "replace")
        if content.count(word + b" +") + content.count(word + b" -") < rows:
            raise LogError(f"{name}: '{label[:40]}' is not in every line; export it again")
    kept = {places[key]: values for key, values in found.values.items() if wanted is None or places[key] in wanted}
    unread = tuple(label for label in names if label not in kept)
    return replace(found, format="halscope", values=kept, left_out={}, unread=unread, metadata=metadata)


def _names_between(name: str, body: bytes) -> list[str]:
    """The names in the first line of an old log, each once."""
    line = next((line for line in body.split(b"\n", 100) if line.strip()), b"")
    names = line.decode("utf-8", "replace").split()[::2]
    if len(set(names)) != len(names):
        raise LogError(f"{name}: records '{max(names, key=names.count)[:40]}' twice; record each channel once")
    return names


def read_halsampler(name: str, content: bytes, wanted: frozenset[str] | None) -> Columns:
    """The pins of a halsampler log as column_1, column_2, ...; a number of the sample is its clock.

    `overrun` before the first line is no loss within the log; anywhere else it is an error that names the line.
    """
    late = _OVERRUNS.match(content)
    lines = 0 if late is None else late[0].count(b"\n")
    found = read_csv(name, b"\n" * lines + content[0 if late is None else late.end() :], None)
    values = dict(found.values)
    first = values.get("column_1")
    metadata: dict[str, str] = {}
    if first is not None and len(values) > 1 and _counts(first):
        del values["column_1"]
        values = {COUNTER: first, **values}
        metadata["counter"] = COUNTER
    kept = {
        key: column for key, column in values.items() if wanted is None or key in wanted or key in metadata.values()
    }
    unread = tuple(key for key in values if key not in kept)
    return replace(found, format="halsampler", values=kept, unread=unread, metadata=metadata)


def _counts(numbers: np.ndarray) -> bool:
    """True for whole numbers that rise, mostly by one: the numbers of samples."""
    steps = np.diff(numbers)
    return bool(
        steps.size >= 2 and np.all(numbers == np.floor(numbers)) and np.all(steps >= 1) and np.median(steps) == 1.0
    )

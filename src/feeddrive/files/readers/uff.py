"""Universal files (UFF, UNV), dataset 58, text or binary: functions at nodal degrees of freedom.

Time responses become channels; frequency responses become FRFs, with the coherence of the same degrees of freedom.
Requires pyuff (the extra `uff`).  Units are those of the axis labels, otherwise the SI units of the data types.  Limit:
50 MB.
"""

import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from feeddrive.files.columns import Columns, free_name, is_wanted, unit_of
from feeddrive.language.errors import LogError, MissingExtraError
from feeddrive.language.quantity import Quantity

MOST_BYTES = 50_000_000
MOST_SETS = 1000
STARTS = (b"    -1\n", b"    -1\r\n", b"    -1 ")
_TIME, _FRF, _COHERENCE = 1, 4, 6  # types of function
_UNITS = {8: "m", 9: "N", 11: "m/s", 12: "m/s2", 13: "N", 17: "s", 18: "Hz"}  # by kind of data


def sets_of(name: str, content: bytes) -> list[Mapping[str, Any]]:
    """Return all datasets 58 of a universal file. Raise LogError if it is damaged, MissingExtraError without pyuff."""
    try:
        import pyuff
    except ImportError:
        raise MissingExtraError("pyuff", "uff", f"{name}: reading a universal file (UFF)") from None
    if len(content) > MOST_BYTES:
        raise LogError(
            f"{name}: has {Quantity(len(content) / 1e6, 'MB'):,.0f}, more than the "
            f"{Quantity(MOST_BYTES / 1e6, 'MB'):,.0f} of a universal file that are read; export fewer functions"
        )
    try:
        # pyuff reads files only, not bytes.
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "a.uff"
            path.write_bytes(content)
            file = pyuff.UFF(str(path))
            kinds = [int(kind) for kind in file.get_set_types()]
            sets: list[Any] = [file.read_sets(k) for k, kind in enumerate(kinds) if kind == 58][: MOST_SETS + 1]
    except Exception:
        # pyuff raises plain exceptions for all errors.
        raise LogError(f"{name}: is a damaged or cut off universal file; export it again") from None
    if len(sets) > MOST_SETS:
        raise LogError(f"{name}: holds {len(sets)} functions, more than the {MOST_SETS} that are read; export fewer")
    if not sets:
        raise LogError(f"{name}: is a universal file without a function (dataset 58); export functions or FRFs")
    for dataset in sets:
        stated, there = int(dataset.get("num_pts", 0)), np.size(dataset.get("data"))
        if there < stated or np.size(dataset.get("x")) != there:
            raise LogError(f"{name}: '{_label(dataset)}' states {stated} values and holds {there}; export it again")
    return sets


def read_uff(name: str, content: bytes, wanted: frozenset[str] | None) -> Columns:
    """Read the time responses of a universal file as channels on a common time axis. Raise LogError."""
    values: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    left_out: dict[str, str] = {}
    unread: list[str] = []
    names: dict[str, int] = {}
    for dataset in sets_of(name, content):
        label = free_name(_label(dataset), names)
        if dataset["func_type"] != _TIME or np.iscomplexobj(dataset["data"]):
            left_out[label] = "no time response but another function; read_frf reads frequency responses"
        elif not is_wanted(label, wanted):
            unread.append(label)
        else:
            time = np.asarray(dataset["x"], dtype=np.float64)
            if "time" in values and (time.size != values["time"].size or np.any(time != values["time"])):
                left_out[label] = "over another time than the first"
                continue
            values.setdefault("time", time)
            units.setdefault("time", "s")
            values[label] = np.asarray(dataset["data"], dtype=np.float64)
            units[label] = _unit(dataset, "ordinate")
    return Columns("UFF 58", values, units, unread=tuple(unread), left_out=left_out)


def uff_tables(name: str, content: bytes) -> Iterator[tuple[Columns, dict[str, str]]]:
    """Yield, for each frequency response, a table of f, re, im and coherence, and the names of its input and output."""
    sets = sets_of(name, content)
    responses = [dataset for dataset in sets if dataset["func_type"] == _FRF]
    if not responses:
        raise LogError(f"{name}: is a universal file without a frequency response (function type 4)")
    coherences = {
        (_end(dataset, "rsp"), _end(dataset, "ref")): dataset for dataset in sets if dataset["func_type"] == _COHERENCE
    }
    names: dict[str, int] = {}
    for dataset in responses:
        output, entrance = _end(dataset, "rsp"), _end(dataset, "ref")
        label = free_name(f"{output}_{entrance}", names)
        data = np.asarray(dataset["data"])
        values = {
            "f": np.asarray(dataset["x"], dtype=np.float64),
            f"re_{label}": np.real(data).astype(np.float64),
            f"im_{label}": np.imag(data).astype(np.float64),
        }
        coherence = coherences.get((output, entrance))
        if coherence is not None and np.array_equal(coherence["x"], dataset["x"]):
            values[f"coherence_{label}"] = np.real(coherence["data"]).astype(np.float64)
        over, under = _unit(dataset, "ordinate"), _unit(dataset, "orddenom")
        unit = f"{over}/{under}" if over and under and "/" not in under else ""
        units = {"f": "Hz", f"re_{label}": unit} if unit else {"f": "Hz"}
        yield Columns("UFF 58", values, units), {"input": entrance, "output": output}


def _end(dataset: Mapping[str, Any], end: str) -> str:
    """Return the node and direction of the input or output of a dataset, such as 12+Z."""
    direction = int(dataset.get(f"{end}_dir", 0))
    sign = "-" if direction < 0 else "+"
    return f"{int(dataset.get(f'{end}_node', 0))}{sign}{'SXYZUVW'[min(abs(direction), 6)]}".replace("+S", "")


def _label(dataset: Mapping[str, Any]) -> str:
    text = " ".join(str(dataset.get("id1", "")).split())
    return text if text and text != "NONE" else _end(dataset, "rsp")


def _unit(dataset: Mapping[str, Any], axis: str) -> str:
    """Return the unit of an axis from its label, otherwise the SI unit of its data type."""
    stated = str(dataset.get(f"{axis}_axis_units_lab", "")).strip()
    known = unit_of(stated) if stated not in ("", "NONE") else None
    return known or _UNITS.get(int(dataset.get(f"{axis}_spec_data_type", 0)), "")

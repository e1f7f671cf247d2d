"""Damaged files of every format: an error that starts with the file's name, or a valid log; never anything else.

Bits are flipped, pieces cut out, doubled or replaced, ends cut off; seeds are fixed, so a failure can be repeated.
"""

from __future__ import annotations

import gzip
import io
import random
import re
import resource
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io

from feeddrive.artefacts.files import machine
from feeddrive.artefacts.files.job import read_job
from feeddrive.artefacts.files.log import Log, read_log
from feeddrive.artefacts.files.machine import read_machine
from feeddrive.artefacts.files.result import write_run_csv, write_run_parquet
from feeddrive.language.errors import FeeddriveError

TIME = 1e-3 * np.arange(60)
COLUMNS = {"x": np.sin(TIME), "force": 3 * np.cos(50 * TIME)}


def mat(packed: bool) -> bytes:
    file = io.BytesIO()
    scipy.io.savemat(file, {"t": TIME, **COLUMNS, "s": {"y": TIME, "k": 3.0}, "text": "abc"}, do_compression=packed)
    return file.getvalue()


def hdf5() -> bytes:
    file = io.BytesIO()
    with h5py.File(file, "w") as written:
        written["t"] = TIME[None]
        written.create_dataset("x", data=COLUMNS["x"][None], compression="gzip", chunks=(1, 60))
        written["s/k"] = 3.0
    return file.getvalue()


def parquet(folder: Path) -> bytes:
    write_run_parquet(folder / "a.parquet", TIME, COLUMNS, {"x": "m", "force": "N"}, 1e-3, {"seed": 1})
    return (folder / "a.parquet").read_bytes()


def csv(folder: Path) -> bytes:
    write_run_csv(folder / "a.csv", TIME, COLUMNS, {"x": "m", "force": "N"})
    return (folder / "a.csv").read_bytes()


def recorder() -> bytes:
    rows = "".join(f"{6.4 * k:.3f};{k};{0.1 * k:.1f}\r\n" for k in range(60)).replace(".", ",")
    return f"Date:;2020\r\nPeriod:;6,4\r\n;Velocity;Torque\r\nms;rpm;%\r\n{rows}".encode("cp1252")


SOURCES: dict[str, Callable[[Path], bytes]] = {
    "a.mat": lambda _: mat(packed=False),
    "b.mat": lambda _: mat(packed=True),
    "c.mat": lambda _: hdf5(),
    "d.parquet": parquet,
    "e.csv": csv,
    "f.csv": lambda _: recorder(),
    "g.csv.gz": lambda folder: gzip.compress(csv(folder)),
}


def damaged(content: bytes, draw: random.Random) -> bytes:
    """The content with one to four damages."""
    changed = bytearray(content)
    for _ in range(draw.randrange(1, 5)):
        if not changed:
            break
        at = draw.randrange(len(changed))
        match draw.randrange(8):
            case 0 | 1 | 2:
                changed[at] ^= 1 << draw.randrange(8)
            case 3:
                changed[at] = draw.choice([0, 1, 10, 13, 32, 34, 44, 59, 127, 128, 255])
            case 4:
                del changed[at : at + draw.randrange(1, 40)]
            case 5:
                changed[at:at] = changed[at : at + draw.randrange(1, 40)]
            case 6:
                changed[at : at + 4] = draw.choice(
                    [b"\xff\xff\xff\xff", b"\0\0\0\0", b"\xff\xff\xff\x7f", b"\0\0\0\x80"]
                )
            case _:
                if draw.random() < 0.3:
                    del changed[at:]
    return bytes(changed)


def outcome(read: Callable[[], Any]) -> Any:
    """What was read, or the text of the FeeddriveError; every other exception goes through."""
    try:
        return read()
    except FeeddriveError as error:
        return str(error)


@pytest.mark.timeout(120)
@pytest.mark.parametrize("name", SOURCES)
def test_damaged_logs(tmp_path: Path, name: str) -> None:
    content = SOURCES[name](tmp_path)
    path = tmp_path / name
    path.write_bytes(content)
    assert isinstance(outcome(lambda: read_log(path)), Log)
    draw = random.Random(name)
    refused = 0
    for _ in range(1000):
        path.write_bytes(damaged(content, draw))
        mapping = {"position_load": "x"} if draw.random() < 0.3 else None
        found = outcome(lambda: read_log(path, mapping))  # noqa: B023
        if isinstance(found, str):
            refused += 1
            assert found.startswith(f"{path}: ")
            assert "\n" not in found
        else:
            assert len(found) >= 3
            assert all(np.all(np.isfinite(values)) for values in found.channels.values())
    assert refused > 100


def test_random_bytes_and_texts(tmp_path: Path) -> None:
    draw = random.Random(5)
    starts = [
        b"",
        b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM",
        b"PAR1",
        b"\x89HDF\r\n\x1a\n",
        b"\x1f\x8b\x08",
        b"\xff\xfe",
    ]
    alphabets = [bytes(range(256)), b"0123456789.,;- \n", b'019e+-,;\t \n#"[]tx', b"\0\1\x0e\x0f\x05\x06"]
    path = tmp_path / "a.bin"
    for _ in range(1500):
        alphabet = draw.choice(alphabets)
        path.write_bytes(draw.choice(starts) + bytes(draw.choices(alphabet, k=draw.randrange(400))))
        found = outcome(lambda: read_log(path))
        assert isinstance(found, Log) or found.startswith(f"{path}: ")


def test_a_reader_is_never_given_a_file_of_another_format(tmp_path: Path) -> None:
    """Every content under every ending is read all the same."""
    contents = {name: source(tmp_path) for name, source in SOURCES.items()}
    for content in contents.values():
        for name in contents:
            path = tmp_path / f"other_{name}"
            path.write_bytes(content)
            assert isinstance(outcome(lambda: read_log(path)), Log)  # noqa: B023


def test_damaged_logs_take_no_memory(tmp_path: Path) -> None:
    """Lengths that a damaged file states are not believed: 4 GB stated in a file of 4 kB stay within 300 MB."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    content = mat(packed=False)
    path = tmp_path / "a.mat"
    for at in range(128, min(len(content) - 4, 2500), 4):
        for word in (b"\xff\xff\xff\x7f", b"\0\0\0\x60", b"\xff\xff\xff\xff"):
            path.write_bytes(content[:at] + word + content[at + 4 :])
            outcome(lambda: read_log(path))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 300_000  # kB


BUNDLED = [("machine", path) for path in sorted((machine.BUNDLED / "machines").glob("*.toml"))]
BUNDLED += [("job", path) for path in sorted((machine.BUNDLED / "jobs").glob("*.toml"))]


def damaged_text(text: str, draw: random.Random) -> str:
    """The text with a number, a name, a line or a mark changed."""
    lines = text.split("\n")
    for _ in range(draw.randrange(1, 4)):
        at = draw.randrange(len(lines))
        match draw.randrange(5):
            case 0:
                del lines[at : at + draw.randrange(1, 4)]
            case 1:
                lines.insert(at, draw.choice(lines))
            case 2:
                lines[at] = re.sub(r"= *[^ #]+", f"= {draw.choice(VALUES)}", lines[at], count=1)
            case 3:
                lines[at] = re.sub(
                    r"^(\w+)", lambda found: found[1] + draw.choice(["x", "_mm", "_kg_per_s"]), lines[at]
                )
            case _:
                place = draw.randrange(len(lines[at]) + 1)
                lines[at] = lines[at][:place] + draw.choice(list("[]{}=\"'.,#0-e\x00é")) + lines[at][place + 1 :]
        lines = lines or [""]
    return "\n".join(lines)


VALUES = [
    "nan",
    "inf",
    "-1",
    "0",
    "1e308",
    "5e-324",
    "true",
    "''",
    "[]",
    "{}",
    "[[1]]",
    "{kind = 3}",
    "9" * 400,
    "1979-05-27",
]


@pytest.mark.parametrize(
    ("kind", "source"), BUNDLED, ids=lambda value: value.stem if isinstance(value, Path) else value
)
def test_damaged_machines_and_jobs(tmp_path: Path, kind: str, source: Path) -> None:
    text = source.read_text(encoding="utf-8")
    path = tmp_path / "file.toml"
    draw = random.Random(source.stem)
    for _ in range(300):
        path.write_text(damaged_text(text, draw), encoding="utf-8")
        with np.errstate(all="ignore"):
            found = outcome(lambda: read_machine(path) if kind == "machine" else read_job(path))
        if isinstance(found, str):
            assert found.startswith(str(path)), found
            assert "\n" not in found

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
from mdf_files import mdf4

from feeddrive.files import machine
from feeddrive.files.frf import read_frf, read_frfs
from feeddrive.files.job import read_job
from feeddrive.files.log import Log
from feeddrive.files.machine import read_machine
from feeddrive.files.read_log import read_log
from feeddrive.files.run_files import write_run_csv, write_run_parquet
from feeddrive.language.errors import FeeddriveError
from feeddrive.loop.frequency_response import FRF
from fresh_draws import Seeded
from slow_share import all_but

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


def numpy_array() -> bytes:
    file = io.BytesIO()
    np.save(file, np.column_stack([TIME, COLUMNS["x"]]))
    return file.getvalue()


def halscope() -> bytes:
    rows = "".join(f"{x:.14f};{f:.14f}\n" for x, f in zip(COLUMNS["x"], COLUMNS["force"], strict=True))
    return f"# Sampling period is 1000000 ns\nx;force\n# Position: 0.5;0.5\n# Scale: 0;0\n{rows}".encode()


def old_halscope() -> bytes:
    rows = "".join(f"\nx {x:+.14f} force {f:+.14f} " for x, f in zip(*COLUMNS.values(), strict=True))
    return f"Sampling period is 1000000 ns \n{rows}".encode()


def halsampler() -> bytes:
    rows = zip(*COLUMNS.values(), strict=True)
    return "".join(f"{k} {x:f} {f:f} {k % 2} \n" for k, (x, f) in enumerate(rows)).encode()


def epos() -> bytes:
    head = "Date:;2020\r\nEPOS Studio Version:;3.6\r\nRecorded samples:;60\r\nSampling period:;6.400\r\n"
    rows = "".join(f"{6.4 * k:.3f};{k};{0.1 * k:.1f}\r\n" for k in range(60))
    return f"{head};x;Torque\r\nms;rpm;%\r\n{rows}".encode()


def twincat() -> bytes:
    lines = ["Name\tScope", "File\ta.csv", "", "Name\tx\tName\tforce\tName\tslow"]
    lines += ["SampleTime[ms]\t1\tSampleTime[ms]\t1\tSampleTime[ms]\t5", "Unit\tmm\tUnit\tN\tUnit\t(None)", ""]
    for k, (x, f) in enumerate(zip(*COLUMNS.values(), strict=True)):
        lines.append(f"{k}\t{x}\t{k}\t{f}".replace(".", ",") + (f"\t{5 * k}\t{k}" if k < 12 else ""))
    return "\n".join([*lines, "EOF", ""]).encode()


def universal(kind: int) -> bytes:
    """A text of two functions in dataset 58: a time response (1) or a frequency response (4)."""
    complex_ = kind == 4
    numbers = np.column_stack([COLUMNS["x"], COLUMNS["force"]]).ravel() if complex_ else COLUMNS["x"]
    axis = f"{0:5d}{0:5d}{0:5d} {'NONE':20s} {'NONE':20s}\n"
    head = f"    -1\n    58\n{'x':80s}\n" + f"{'NONE':80s}\n" * 4
    head += f"{kind:5d}{0:10d}{0:5d}{0:10d} {'NONE':10s}{1:10d}{3:4d} {'NONE':10s}{2:10d}{-3:4d}\n"
    head += f"{6 if complex_ else 4:10d}{60:10d}{1:10d}{1e-3 if kind == 1 else 1.0:13.5e}{1e-3:13.5e}{0.0:13.5e}\n"
    head += "".join(f"{of:10d}{axis}" for of in ((17 if kind == 1 else 18), 8, 13, 0))
    cells = [f"{number:20.12e}" for number in numbers]
    return (head + "".join("".join(cells[k : k + 4]) + "\n" for k in range(0, len(cells), 4)) + "    -1\n").encode()


def frf_csv() -> bytes:
    rows = zip(1 + 1e3 * TIME, *COLUMNS.values(), strict=True)
    return ("f_Hz,re_m_per_N,im,coherence\n" + "".join(f"{f},{a},{b},0.5\n" for f, a, b in rows)).encode()


def frf_decibel() -> bytes:
    rows = zip(1 + 1e3 * TIME, *COLUMNS.values(), strict=True)
    return ("f [Hz];mag [dB];phase [°]\n" + "".join(f"{f};{a};{b}\n" for f, a, b in rows).replace(".", ",")).encode()


def ast_xml() -> bytes:
    digits = "0123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ!#$`()*+-/:;=?@[]^_{|}~"

    def array(member: str, numbers: np.ndarray) -> str:
        words = np.frombuffer(numbers.astype(">f8" if numbers.dtype.kind == "f" else ">c16").tobytes(), ">u4").tolist()
        text = "".join("".join(digits[word // 85**k % 85] for k in (4, 3, 2, 1, 0)) if word else "." for word in words)
        return f'<NumericArray name="{member}"><raw name="m_pNumberArray"><![CDATA[{text}]]></raw></NumericArray>'

    def measured(member: str, values: np.ndarray) -> str:
        inside = array("m_FrequencyVector", 1 + 1e3 * TIME) + array("m_ValueVector", values)
        return f'<FrequencyResponseFunction name="{member}">{inside}</FrequencyResponseFunction>'

    plant = measured("m_pPlant", COLUMNS["x"] + 1j * COLUMNS["force"])
    coherence = measured("m_pMeasCoherence", np.full(60, 0.5 + 0.0j))
    return f'<?xml version="1.0"?><A><L name="m_List"><M>{plant}{coherence}</M></L></A>'.encode()


RESPONSES: dict[str, Callable[[], bytes]] = {
    "a.csv": frf_csv,
    "b.csv": frf_decibel,
    "c.uff": lambda: universal(4),
    "d.xml": ast_xml,
    "e.csv.gz": lambda: gzip.compress(frf_csv()),
}

SOURCES: dict[str, Callable[[Path], bytes]] = {
    "a.mat": lambda _: mat(packed=False),
    "b.mat": lambda _: mat(packed=True),
    "c.mat": lambda _: hdf5(),
    "d.parquet": parquet,
    "e.csv": csv,
    "f.csv": lambda _: recorder(),
    "g.csv.gz": lambda folder: gzip.compress(csv(folder)),
    "h.npy": lambda _: numpy_array(),
    "i.csv": lambda _: halscope(),
    "j.log": lambda _: old_halscope(),
    "k.txt": lambda _: halsampler(),
    "l.csv": lambda _: epos(),
    "m.csv": lambda _: twincat(),
    "n.uff": lambda _: universal(1),
    "o.mf4": lambda _: mdf4(COLUMNS, 1e-3),
    "p.mf4": lambda _: mdf4(COLUMNS, 1e-3, packed=True),
}
# what a log needs beside itself to be read
NEEDS: dict[str, dict[str, Any]] = {"h.npy": {"mapping": {"time": "column_1"}}, "k.txt": {"sample_time": 1e-3}}
FEW, MANY = 300, 100_000 // (len(SOURCES) + len(RESPONSES)) + 1
HDF5, FEW_HDF5 = ("c.mat",), 12  # each is read in a process of its own


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


def need(name: str) -> None:
    if name.endswith(".uff"):
        pytest.importorskip("pyuff", reason="NOT TESTED on universal files: pyuff is not installed")


def check_logs(folder: Path, name: str, count: int, seed: str) -> None:
    """Damage a log many times; each time it is refused with its name, or is a log of finite numbers."""
    need(name)
    content = SOURCES[name](folder)
    path = folder / name
    path.write_bytes(content)
    assert isinstance(outcome(lambda: read_log(path, **NEEDS.get(name, {}))), Log)
    draw = random.Random(seed)
    refused = 0
    for _ in range(count):
        path.write_bytes(damaged(content, draw))
        options = NEEDS.get(name, {"mapping": {"position_load": "x"}} if draw.random() < 0.3 else {})
        found = outcome(lambda: read_log(path, **options))  # noqa: B023
        if isinstance(found, str):
            refused += 1
            assert found.startswith(f"{path}: ")
            assert "\n" not in found
        else:
            assert len(found) >= 3
            assert all(np.all(np.isfinite(values)) for values in found.channels.values())
    assert refused > count // 20


def check_responses(folder: Path, name: str, count: int, seed: str) -> None:
    """The same for frequency responses."""
    need(name)
    content = RESPONSES[name]()
    path = folder / name
    path.write_bytes(content)
    assert isinstance(outcome(lambda: read_frf(path)), FRF)
    draw = random.Random(seed)
    refused = 0
    for _ in range(count):
        path.write_bytes(damaged(content, draw))
        found = outcome(lambda: read_frfs(path))
        if isinstance(found, str):
            refused += 1
            assert found.startswith(f"{path}: ")
            assert "\n" not in found
        else:
            assert all(isinstance(frf, FRF) and frf.frequency.size for frf in found.values())
    assert refused > count // 20


@pytest.mark.timeout(120)
@pytest.mark.parametrize("name", SOURCES)
def test_damaged_logs(tmp_path: Path, name: str, seeded: Seeded) -> None:
    check_logs(tmp_path, name, FEW_HDF5 if name in HDF5 else FEW, seeded(name))


@pytest.mark.timeout(120)
@pytest.mark.parametrize("name", RESPONSES)
def test_damaged_responses(tmp_path: Path, name: str, seeded: Seeded) -> None:
    check_responses(tmp_path, name, FEW, seeded(name))


@pytest.mark.slow(reason="thousands of damaged files; each kind is damaged a few times quickly")
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("name", SOURCES)
def test_logs_damaged_very_often(tmp_path: Path, name: str) -> None:
    """100,000 damages over all readers."""
    check_logs(tmp_path, name, 40 * FEW_HDF5 if name in HDF5 else MANY, f"often {name}")


@pytest.mark.slow(reason="thousands of damaged files; each kind is damaged a few times quickly")
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("name", RESPONSES)
def test_responses_damaged_very_often(tmp_path: Path, name: str) -> None:
    check_responses(tmp_path, name, MANY, f"often {name}")


def test_random_bytes_and_texts(tmp_path: Path, seeded: Seeded) -> None:
    draw = random.Random(seeded(5))
    starts = [
        b"",
        b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM",
        b"PAR1",
        b"\x1f\x8b\x08",
        b"\xff\xfe",
        b"\x93NUMPY\x01\0",
        b"Sampling period is 1000 ns\n",
        b"<?xml version='1.0'?>",
        b"Name\ta\tSampleTime[ms]\n",
        b"EPOS Studio Version:;1\n",
    ]
    alphabets = [bytes(range(256)), b"0123456789.,;- \n", b'019e+-,;\t \n#"[]tx', b"\0\1\x0e\x0f\x05\x06"]
    path = tmp_path / "a.bin"
    for number in range(1500):
        alphabet = draw.choice(alphabets)
        start = b"\x89HDF\r\n\x1a\n" if number < 6 else draw.choice(starts)  # each takes a process of its own
        path.write_bytes(start + bytes(draw.choices(alphabet, k=draw.randrange(400))))
        found = outcome(lambda: read_log(path))
        assert isinstance(found, Log) or found.startswith(f"{path}: ")


def test_a_reader_is_never_given_a_file_of_another_format(tmp_path: Path) -> None:
    """Every content under every ending is read all the same; as a frequency response it is refused."""
    pytest.importorskip("pyuff", reason="NOT TESTED on universal files: pyuff is not installed")
    contents = {name: source(tmp_path) for name, source in SOURCES.items()}
    for kind, content in contents.items():
        options = NEEDS.get(kind, {})
        for name in contents:
            path = tmp_path / f"other_{name}"
            path.write_bytes(content)
            assert isinstance(outcome(lambda: read_log(path, **options)), Log)  # noqa: B023
        assert outcome(lambda: read_frf(path)).startswith(f"{path}: ")  # noqa: B023
    for source in RESPONSES.values():
        path.write_bytes(source())
        assert outcome(lambda: read_log(path)).startswith(f"{path}: ")


@pytest.mark.parametrize("every", all_but([20], [20, 4], "the same at every word of the file"))
def test_damaged_logs_take_no_memory(tmp_path: Path, every: int) -> None:
    """Lengths that a damaged file states are not believed: 4 GB stated in a file of 4 kB stay within 300 MB."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    content = mat(packed=False)
    path = tmp_path / "a.mat"
    for at in range(128, min(len(content) - 4, 2500), every):
        for word in (b"\xff\xff\xff\x7f", b"\0\0\0\x60", b"\xff\xff\xff\xff"):
            path.write_bytes(content[:at] + word + content[at + 4 :])
            outcome(lambda: read_log(path))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 300_000  # kB


BUNDLED = [("machine", path) for path in sorted((machine.BUNDLED / "machines").glob("*.toml"))]
BUNDLED += [("job", path) for path in sorted((machine.BUNDLED / "jobs").glob("*.toml"))]
THREE_AXES = ("mill", "machining_center", "circle_diamond_square", "circle", "slot")


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
    ("kind", "source"),
    all_but(
        [each for each in BUNDLED if each[1].stem not in THREE_AXES], BUNDLED, "three axes, 3 s; all others are quick"
    ),
    ids=lambda value: value.stem if isinstance(value, Path) else value,
)
def test_damaged_machines_and_jobs(tmp_path: Path, kind: str, source: Path, seeded: Seeded) -> None:
    text = source.read_text(encoding="utf-8")
    path = tmp_path / "file.toml"
    draw = random.Random(seeded(source.stem))
    for _ in range(100):
        path.write_text(damaged_text(text, draw), encoding="utf-8")
        with np.errstate(all="ignore"):
            found = outcome(lambda: read_machine(path) if kind == "machine" else read_job(path))
        if isinstance(found, str):
            assert found.startswith(str(path)), found
            assert "\n" not in found

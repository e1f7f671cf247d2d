"""MDF4 files: built by hand, and written by asammdf, whose own reading is the truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mdf_files import mdf4

from feeddrive.files.read_log import read_columns, read_log
from feeddrive.language.errors import LogError


def test_mdf4_without_its_library(tmp_path: Path) -> None:
    """A file built by hand: units, conversion, two packed pieces; what is not wanted is named and not read."""
    t = 1e-3 * np.arange(200)
    columns = {"x": np.sin(t), "f": np.rint(100 * np.cos(t)) / 100}
    for packed in (False, True):
        path = tmp_path / "a.mf4"
        path.write_bytes(mdf4(columns, 1e-3, packed=packed))
        log = read_log(path)
        assert log.units == {"x": "mm", "f": "mm"}
        np.testing.assert_array_equal(log["x"], columns["x"])
        np.testing.assert_allclose(log["f"], columns["f"], atol=1e-15)
        assert read_log(path, {"position_load": "x"})["position_load"][-1] == pytest.approx(1e-3 * np.sin(0.199))


def damaged_mdf(old: bytes, new: bytes, packed: bool = False) -> bytes:
    content = mdf4({"x": np.sin(np.arange(200)), "f": np.cos(np.arange(200))}, 1e-3, packed=packed)
    assert old in content
    return content.replace(old, new)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (damaged_mdf(b"##DL", b"##DV"), "stores columns"),
        (damaged_mdf(b"##CG", b"##XX"), "damaged or cut off"),
        (damaged_mdf(b"DT\0\0", b"DT\2\0", packed=True), "packed in a way that is not read"),
        (damaged_mdf((200).to_bytes(8, "little"), (2**40).to_bytes(8, "little")), "damaged or a zip bomb"),
        (damaged_mdf((200).to_bytes(8, "little"), (201).to_bytes(8, "little")), "damaged or cut off"),
    ],
)
def test_what_an_mdf4_file_may_not_be(content: bytes, said: str) -> None:
    with pytest.raises(LogError, match=said):
        read_columns("a.mf4", content, None)


def test_packed_blocks_of_mdf4_are_measured_first() -> None:
    """1 GB stated, and unpacked no further than stated."""
    content = mdf4({"x": np.zeros(20_000)}, 1e-3, packed=True)
    at = content.index(b"##DZ") + 24 + 8
    for stated, said in ((10**9, "hold more than allowed"), (1000, "damaged or cut off")):
        with pytest.raises(LogError, match=said):
            read_columns("a.mf4", content[:at] + stated.to_bytes(8, "little") + content[at + 8 :], None)


def test_a_chain_of_mdf4_that_runs_in_a_circle_ends() -> None:
    content = bytearray(mdf4({"x": np.sin(np.arange(50))}, 1e-3))
    at = content.index(b"##CN")
    content[at + 24 : at + 32] = at.to_bytes(8, "little")
    with pytest.raises(LogError, match="damaged or cut off"):
        read_columns("a.mf4", bytes(content), None)


T = 1e-3 * np.arange(3000)
KINDS = ("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f2", "f4", "f8", ">i2", ">u4", ">f4", ">f8")
TABLE = {"raw_0": 0, "phys_0": 10, "raw_1": 2, "phys_1": 30, "raw_2": 4, "phys_2": 31}
CONVERSIONS = {
    "linear": {"a": 0.5, "b": -3.0},
    "rational": {"P1": 0.0, "P2": 2.0, "P3": 1.0, "P4": 0.0, "P5": 0.0, "P6": 4.0},
    "interpolated": TABLE | {"interpolation": True},
    "nearest": TABLE | {"interpolation": False},
    "texts": {"val_0": 0, "val_1": 1, "text_0": b"off", "text_1": b"on"},
    "formula": {"formula": "X*2+1"},
}


@pytest.mark.parametrize("compression", [0, 1, 2], ids=["plain", "packed", "turned and packed"])
@pytest.mark.parametrize("version", ["4.00", "4.10", "4.20"])
def test_files_of_asammdf_are_read_as_it_reads_them(tmp_path: Path, version: str, compression: int) -> None:
    """All kinds of numbers and conversions, in many pieces; two groups; not valid samples are NaN."""
    asammdf = pytest.importorskip("asammdf", reason="NOT TESTED on MDF4 files of asammdf: it is not installed")
    signals = [asammdf.Signal((100 * np.sin(7 * T)).astype(kind), T, unit="mm", name=f"kind_{kind}") for kind in KINDS]
    small = (np.arange(T.size) % 5).astype("i2")
    signals += [
        asammdf.Signal(small, T, unit="N", name=name, conversion=conversion) for name, conversion in CONVERSIONS.items()
    ]
    signals.append(asammdf.Signal(np.sin(T), T, name="partly", invalidation_bits=np.arange(T.size) == 7))
    with asammdf.MDF(version=version) as file:
        file.configure(write_fragment_size=20_000)
        file.append(signals)
        file.append([asammdf.Signal(T[::5], T[::5], unit="A", name="i")])
        path = Path(file.save(tmp_path / "a.mf4", overwrite=True, compression=compression))
    found = read_columns("a.mf4", path.read_bytes(), None)
    assert set(found.left_out) == {"texts", "formula", "i"}
    assert found.units["kind_i1"] == "mm"
    with asammdf.MDF(path) as file:
        for name, values in found.values.items():
            truth = T if name == "time" else file.get(name, group=0, ignore_invalidation_bits=True).samples
            here = ~np.isnan(values)
            np.testing.assert_array_equal(values[here], np.asarray(truth, dtype=float)[here])
            assert list(np.flatnonzero(~here)) == ([7] if name == "partly" else [])
    log = read_log(path, {"position_load": "kind_f8"})
    assert log.sample_time == 1e-3
    assert read_log(path, {"current": "i"}).sample_time == 5e-3
    with pytest.raises(LogError, match=r"'partly' is nan at row 8"):
        read_log(path, {"position_load": "partly"})
    whole = path.read_bytes()
    for cut in (200, 1000, len(whole) // 2):
        path.write_bytes(whole[:cut])
        with pytest.raises(LogError, match=r"damaged or cut off MDF4|without numbers"):
            read_log(path)

"""MATLAB files: the same numbers as scipy and h5py read, and nothing of a damaged file is believed."""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.sparse

from feeddrive.files import columns
from feeddrive.files.read_log import read_columns, read_log
from feeddrive.files.readers import arrays
from feeddrive.files.readers import arrays as reader
from feeddrive.files.readers.arrays import read_here, read_mat, read_mat73
from feeddrive.language.errors import LogError, MissingExtraError

T = np.arange(50) * 1e-3


def mat5(content: dict[str, Any], *, packed: bool = True) -> bytes:
    file = io.BytesIO()
    scipy.io.savemat(file, content, do_compression=packed)
    return file.getvalue()


@pytest.mark.parametrize("packed", [True, False])
@pytest.mark.parametrize("dtype", ["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "?"])
def test_every_type_of_number(dtype: str, packed: bool) -> None:
    numbers = (100 * np.sin(np.arange(77.0)) + 100).astype(dtype)
    found = read_mat("a.mat", mat5({"x": numbers, "y_2": numbers[:, None], "k": numbers[3]}, packed=packed), None)
    np.testing.assert_array_equal(found.values["x"], numbers.astype(float))
    np.testing.assert_array_equal(found.values["y_2"], numbers.astype(float))
    assert found.values["x"].dtype == np.float64
    assert found.constants == {"k": float(numbers[3])}


@pytest.mark.parametrize("packed", [True, False])
def test_structures_are_opened_and_everything_else_is_passed_over(packed: bool) -> None:
    matrix = np.arange(150.0).reshape(50, 3)
    cell = np.empty((2,), dtype=object)
    cell[:] = [1, "a"]
    content = {
        "s": {"t": T, "inner": {"x": -T, "k": 5.0}, "note": "text", "nothing": np.empty((0, 0))},
        "many": np.zeros((2,), dtype=[("a", "f8")]),
        "m": matrix,
        "note": "text",
        "cell": cell,
        "z": T + 1j,
        "sparse": scipy.sparse.csc_matrix(np.eye(4)),
        "cube": np.zeros((2, 3, 4)),
        "n" * 31: T,
    }
    found = read_mat("a.mat", mat5(content, packed=packed), None)
    assert set(found.values) == {"s.t", "s.inner.x", "m.1", "m.2", "m.3", "n" * 31}
    np.testing.assert_array_equal(found.values["s.inner.x"], -T)
    np.testing.assert_array_equal(found.values["m.2"], matrix[:, 1])
    assert found.constants == {"s.inner.k": 5.0}
    assert found.left_out == {
        "s.note": "text",
        "many": "a structure of several elements",
        "note": "text",
        "cell": "a cell array",
        "z": "complex numbers",
        "sparse": "a sparse array",
        "cube": "an array of 3 dimensions",
    }


def test_only_what_is_wanted_is_kept() -> None:
    content = mat5({"t": T, "x": T, "y": T, "m": np.zeros((50, 2))})
    assert set(read_mat("a.mat", content, frozenset(["y", "m.2"])).values) == {"t", "y", "m.2"}
    assert set(read_mat("a.mat", content, frozenset(["m"])).values) == {"t", "m.1", "m.2"}


def big_endian(name: str, numbers: np.ndarray) -> bytes:
    """A file as a big-endian machine writes it, by the published layout."""

    def element(kind: int, content: bytes) -> bytes:
        return struct.pack(">II", kind, len(content)) + content + b"\0" * (-len(content) % 8)

    inner = element(6, struct.pack(">II", 6, 0)) + element(5, struct.pack(">ii", numbers.size, 1))
    inner += element(1, name.encode()) + element(9, numbers.astype(">f8").tobytes())
    return b"MATLAB 5.0 MAT-file".ljust(124) + b"\x01\x00MI" + element(14, inner)


def test_the_other_byte_order() -> None:
    numbers = np.random.default_rng(1).normal(size=33)
    content = big_endian("force", numbers)
    np.testing.assert_array_equal(scipy.io.loadmat(io.BytesIO(content))["force"].ravel(), numbers)
    np.testing.assert_array_equal(read_mat("a.mat", content, None).values["force"], numbers)


def test_the_measured_axis_is_read_as_scipy_reads_it(emps: Path) -> None:
    truth = scipy.io.loadmat(emps)
    log = read_log(emps)
    assert list(log.channels) == ["qg", "qm", "vir"]
    np.testing.assert_array_equal(log.time, truth["t"].ravel())
    for channel in log.channels:
        np.testing.assert_array_equal(log[channel], truth[channel].ravel())
    assert log.sample_time == 1e-3
    assert log.jitter < 1e-4  # stamps are within 40 ns of 1 ms
    assert log.constants == {name: float(truth[name][0, 0]) for name in ("gtau", "kp", "kv")}


def test_the_measured_axis_by_its_roles(emps: Path) -> None:
    truth = scipy.io.loadmat(emps)
    log = read_log(emps, {"setpoint_position": "qg", "position_load": ("qm", "mm"), "force": ("vir", 35.15)})
    np.testing.assert_array_equal(log["setpoint_position"], truth["qg"].ravel())
    np.testing.assert_array_equal(log["position_load"], truth["qm"].ravel() * 1e-3)
    np.testing.assert_array_equal(log["force"], truth["vir"].ravel() * 35.15)
    assert log.units == {"setpoint_position": "m", "position_load": "m", "force": "N"}


def test_a_file_with_objects_gives_its_numbers(shared: Path) -> None:
    bench = shared / "tokyo_motor_bench" / "MultisineTypeA.mat"
    if not bench.exists():
        pytest.skip(f"NOT TESTED on a file with objects: {bench} is not there")
    whole = read_log(bench)  # its time has no unit, but fs = 2500 stands beside it
    assert whole.sample_time == 4e-4
    assert whole.provenance["time"] == "in us, by fs = 2500 Hz in the file"
    assert {"iq_adx", "iq_refx", "omega_max", "omega_may", "theta_mx", "theta_my"} < set(whole.channels)
    assert whole.left_out["BA"] == "an object"  # of the class `tf`: passed over, never built
    log = read_log(bench, {"time": ("time", "us"), "command": ("iq_refx", "A")})
    assert log.sample_time == 4e-4
    assert len(log) == 50_000
    np.testing.assert_array_equal(log["command"], scipy.io.loadmat(bench)["iq_refx"].ravel())
    assert log.units == {"command": "A"}


def test_cut_off_anywhere_it_is_an_error_or_a_shorter_file() -> None:
    whole = mat5({"t": T, "x": T + 1, "y": T + 2}, packed=False)
    ends = {len(mat5({"t": T, "x": T + 1, "y": T + 2}, packed=False)), 128}
    for cut in range(128, len(whole)):
        try:
            found = read_mat("a.mat", whole[:cut], None)
        except LogError as error:
            assert "is damaged or cut off" in str(error)  # noqa: PT017
        else:  # between two variables a file may end
            assert all(values.size == 50 for values in found.values.values())
            ends.add(cut)
    assert len(ends) == 4


def test_an_error_names_the_last_variable_that_could_be_read() -> None:
    whole = mat5({"t": T, "x": T + 1})
    with pytest.raises(LogError, match=r"a\.mat: is damaged or cut off after variable 't'; copy it again"):
        read_mat("a.mat", whole[:-10], None)
    with pytest.raises(LogError, match="its header does not state a byte order"):
        read_mat("a.mat", whole[:126] + b"XX" + whole[128:], None)


def test_a_packed_variable_is_not_unpacked_further_than_it_says() -> None:
    """A variable of 2 MB that unpacks to 2 GB, with a tag that says 64 bytes."""
    zip_ = zlib.compressobj()
    packed = b"".join(
        [zip_.compress(struct.pack("<II", 14, 64)), *(zip_.compress(bytes(1 << 20)) for _ in range(64)), zip_.flush()]
    )
    content = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + struct.pack("<II", 15, len(packed)) + packed
    with pytest.raises(LogError, match="damaged"):
        read_mat("a.mat", content, None)


def test_too_many_numbers_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arrays, "MOST_NUMBERS", 100)
    with pytest.raises(LogError, match="holds more than the 100 numbers that are read; map fewer columns"):
        read_mat("a.mat", mat5({"t": T, "x": T, "y": T}, packed=False), None)
    monkeypatch.setattr(columns, "MOST_NUMBERS", 100)
    with pytest.raises(LogError, match="holds 3 columns of 50 rows, more than the 100 numbers"):
        read_here("a.mat", hdf5({"t": T, "x": T, "y": T}), None)


def hdf5(content: dict[str, Any]) -> bytes:
    file = io.BytesIO()
    with h5py.File(file, "w", userblock_size=512) as written:
        for name, values in content.items():
            written[name] = values
    found = bytearray(file.getvalue())
    found[:19] = b"MATLAB 7.3 MAT-file"
    return bytes(found)


def test_matlab_7_3() -> None:
    content = hdf5({"t": T[None], "s/x": T[:, None], "k": [[2.0]], "m": np.zeros((4, 5)), "n": [[1, 2, 3]]})
    found = read_columns("a.mat", content, None)
    assert set(found.values) == {"t", "s.x", "n"}
    np.testing.assert_array_equal(found.values["s.x"], T)
    assert found.constants == {"k": 2.0}
    assert found.left_out == {"m": "a matrix"}
    assert set(read_columns("a.mat", content, frozenset(["n"])).values) == {"t", "n"}


def test_links_out_of_an_hdf5_file_are_not_followed(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "secret.h5", "w") as secret:
        secret["x"] = T
    (tmp_path / "raw").write_bytes(T.tobytes())
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["t"] = T
        file["link"] = h5py.ExternalLink(str(tmp_path / "secret.h5"), "/x")
        file["soft"] = h5py.SoftLink("/t")
        file.create_dataset("raw", (50,), "f8", external=[(str(tmp_path / "raw"), 0, 400)])
        layout = h5py.VirtualLayout((50,), "f8")
        layout[:] = h5py.VirtualSource(str(tmp_path / "secret.h5"), "x", (50,))
        file.create_virtual_dataset("virtual", layout)
    found = read_columns("a.h5", (tmp_path / "a.h5").read_bytes(), None)
    assert set(found.values) == {"t"}
    assert found.left_out == {
        "link": "a link to another place",
        "soft": "a link to another place",
        "raw": "stored in another file",
        "virtual": "stored in another file",
    }


def test_a_bit_that_makes_the_library_take_all_memory_is_an_error() -> None:
    """A symbol table that states 32 entries for one: HDF5 2.0 goes through them without end."""
    file = io.BytesIO()
    with h5py.File(file, "w") as written:
        written["s/k"] = 3.0
        written["t"] = T
    content = bytearray(file.getvalue())
    table = content.index(b"SNOD")  # version, a free byte, and the number of entries
    assert content[table + 6] in (1, 2)
    content[table + 6] = 32
    with pytest.raises(LogError, match=r"a\.mat: is damaged or cut off; copy it again"):
        read_mat73("a.mat", bytes(content), None)


def test_without_h5py_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reader, "find_spec", lambda *_: None)
    with pytest.raises(MissingExtraError, match=r"a\.mat: .*needs the package 'h5py'.*feeddrive\[matlab\]"):
        read_mat73("a.mat", b"", None)


@pytest.mark.parametrize(
    "content",
    [
        {f"x{i}": np.zeros(4_000_000) for i in range(5)},  # 160 MB in 160 kB, each part of them below the limit
        {"x": np.zeros(20_000_000, "i1")},  # 20 MB that are 160 MB as numbers
        {"s": {f"x{i}": np.zeros(4_000_000, "i1") for i in range(5)}},
    ],
)
def test_a_bomb_of_many_variables_or_of_small_numbers_is_refused(content: dict[str, Any]) -> None:
    packed = mat5(content)
    assert len(packed) < 200_000
    with pytest.raises(LogError, match="zip bomb"):
        read_mat("a.mat", packed, None)

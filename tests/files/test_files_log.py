"""Logs: one clock or an error that names the row; channels by their roles, in SI, whatever unit the file has."""

from __future__ import annotations

import builtins
import gzip
import re
import tracemalloc
import warnings
import zlib
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from feeddrive.files import columns
from feeddrive.files.columns import Column
from feeddrive.files.log import Log
from feeddrive.files.read_log import checked_clock, read_log
from feeddrive.language.errors import FileError, LogError, MissingExtraError, ParameterError

formats = import_module("feeddrive.files.read_log")  # `feeddrive.files.read_log` is the function

TEXT = "t [ms],x [mm],f,note\n" + "".join(f"{2 * k},{k},{10 * k},a\n" for k in range(10))


def row(k: int) -> str:
    return f"row {k + 1}"


def write(tmp_path: Path, text: str | bytes, name: str = "a.csv") -> Path:
    path = tmp_path / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


# the clock


@given(st.floats(1e-6, 0.4), st.integers(3, 3000), st.floats(0, 0.04), st.integers(0, 2**32 - 1), st.floats(-1e3, 1e3))
def test_a_clock_with_jitter_is_found(T: float, n: int, share: float, seed: int, start: float) -> None:
    """Each stamp is off by at most `share` of T; the ends give the sample time to 2 share / n."""
    off = np.random.default_rng(seed).uniform(-share, share, n)
    time = start + T * (np.arange(n) + off)
    clock = checked_clock("a", time, row)
    # 1e-12: stamps near 1e3 s are known to 1e-13 s
    assert abs(clock.sample_time - T) * (n - 1) <= T * 4 * share + 2e-9 * T * n + 1e-12
    assert clock.jitter <= 2 * share * 1.05 + 1e-6


@pytest.mark.parametrize("T", [1e-3, 5e-5, 1 / 16000, 6.4e-3, 1e-3 / 3, 0.25e-3, 1 / 8192])
@pytest.mark.parametrize("digits", [7, 9, 17])
def test_the_sample_time_is_the_shortest_decimal_that_fits(T: float, digits: int) -> None:
    n = 20_000
    time = np.array([float(f"{T * k:.{digits}g}") for k in range(n)]) if digits < 17 else T * np.arange(n)
    found = checked_clock("a", time, row, T if digits == 7 else None).sample_time
    assert found == pytest.approx(T, rel=1e-9)
    if float(f"{T:.4g}") == T:
        assert found == T


def test_what_is_wrong_with_a_clock() -> None:
    time = 1e-3 * np.arange(100)

    def changed(change: Callable[[np.ndarray], Any]) -> np.ndarray:
        copy = time.copy()
        result = change(copy)
        return copy if result is None else result

    def shift(k: int, by: float) -> Callable[[np.ndarray], None]:
        def change(stamps: np.ndarray) -> None:
            stamps[k:] += by

        return change

    cases: list[tuple[np.ndarray, str]] = [
        (time[:2], r"a: has 2 rows; a log needs at least 3"),
        (time[:0], r"a: has 0 rows"),
        (changed(shift(40, 0.005)), r"a: a gap lies before row 41: 0\.039 s is followed by 0\.045 s, where the step"),
        (np.delete(time, 40), r"a gap lies before row 41: 0\.039 s is followed by 0\.041 s.*\(1 such rows\)"),
        (np.insert(time, 40, time[40]), r"time stands still at row 42: 0\.04 s is followed by 0\.04 s \(1 such rows\)"),
        (np.concatenate([time[:50], time[20:]]), r"time runs backward at row 51: 0\.049 s is followed by 0\.02 s"),
        (changed(lambda t: t.__setitem__(7, t[7] + 2e-4)), r"not uniform: the step to row 8 is 0\.0012 s, the"),
        (time**1.3, r"the clock is not uniform|a gap lies"),
        (1e3 * time, r"a sample time of 1 s is not one of a servo loop.*unit = 'ms'"),
        (1e-6 * time, r"a sample time of 1e-09 s is not one"),
    ]
    for stamps, message in cases:
        with pytest.raises(LogError, match=message):
            checked_clock("a", stamps, row)


def test_a_given_sample_time_forgives_rounded_stamps_and_nothing_else() -> None:
    T = 0.4e-3
    rounded = np.round(T * np.arange(1000), 3)  # stamps in whole ms: many stand still
    with pytest.raises(LogError, match=r"stands still at row 2.*give the sample time if the stamps are only rounded"):
        checked_clock("a", rounded, row)
    with pytest.raises(LogError, match=r"row 3 should be at 0\.0008 s, not at 0\.001 s"):
        checked_clock("a", np.array([0.0, 0.0004, 0.0010, 0.0012]), row, T)
    assert checked_clock("a", 50e-6 * np.arange(1000), row, 50 * 1e-6).sample_time == 5e-5 != 50 * 1e-6
    fine = np.round(T * np.arange(1000), 4) + 1e-5 * (np.arange(1000) % 2)
    assert checked_clock("a", fine, row, T).sample_time == T
    with pytest.raises(LogError, match=r"row 501 should be at 0.2 s, not at 0.2004 s; give the right sample time"):
        checked_clock("a", np.delete(T * np.arange(1000), 500), row, T)


# columns and roles


def test_a_column_of_an_input_is_not_in_inches(tmp_path: Path) -> None:
    rows = "".join(f"{2 * k},{k},{k}\n" for k in range(10))
    log = read_log(write(tmp_path, f"t [ms],x_in,y [in]\n{rows}"), {"position_load": "x_in", "position_motor": "y"})
    np.testing.assert_array_equal(log["position_load"], np.arange(10.0))
    np.testing.assert_allclose(log["position_motor"], 0.0254 * np.arange(10), rtol=1e-15)
    stated = read_log(tmp_path / "a.csv", {"position_load": ("x_in", "in")})
    np.testing.assert_allclose(stated["position_load"], 0.0254 * np.arange(10), rtol=1e-15)


def test_every_column_in_the_unit_of_the_file(tmp_path: Path) -> None:
    log = read_log(write(tmp_path, TEXT))
    assert log.name == str(tmp_path / "a.csv")
    assert list(log.channels) == ["x", "f"]
    assert log.units == {"x": "mm", "f": ""}
    assert log.sample_time == 2e-3
    np.testing.assert_allclose(log.time, 2e-3 * np.arange(10), rtol=1e-15)
    assert log["x"].tolist() == list(range(10))
    assert log.left_out == {"note": "text"}
    assert log.duration == pytest.approx(0.018)
    assert len(log) == 10
    assert log.provenance["file"].endswith("a.csv")
    assert re.fullmatch(r"[0-9a-f]{64}", log.provenance["sha256"])


def test_columns_by_role_in_si(tmp_path: Path) -> None:
    path = write(tmp_path, TEXT)
    log = read_log(
        path, {"position_load": "x", "force": Column(name="f", factor=-2.0), "command": ("f", "V")}, name="n"
    )
    np.testing.assert_allclose(log["position_load"], 1e-3 * np.arange(10), rtol=1e-15)
    assert log["force"].tolist() == [-20.0 * k for k in range(10)]
    assert log["command"].tolist() == [10.0 * k for k in range(10)]
    assert log.units == {"position_load": "m", "force": "N", "command": "V"}
    assert log.name == "n"
    again = read_log(
        path, {"time": ("t", "ms"), "position_load": ("x", "um"), "command": Column(name="f", unit="A", factor=3.0)}
    )
    np.testing.assert_allclose(again["position_load"], 1e-6 * np.arange(10), rtol=1e-15)  # who maps knows better
    assert again["command"].tolist() == [30.0 * k for k in range(10)]
    assert again.units["command"] == "A"


def test_a_unit_at_the_end_of_a_name_counts_if_it_fits_the_role(tmp_path: Path) -> None:
    path = write(tmp_path, "time_ms,x_cmd_mm,y_in_N\n" + "".join(f"{k},{k},{k}\n" for k in range(5)))
    log = read_log(path, {"position_load": "x_cmd_mm", "position_motor": "y_in_N", "force": "y_in_N"})
    assert log.sample_time == 1e-3
    assert log["position_load"][4] == pytest.approx(4e-3)
    assert log["position_motor"][4] == 4.0
    assert log["force"][4] == 4.0


def test_optional_columns_may_be_missing(tmp_path: Path) -> None:
    path = write(tmp_path, TEXT)
    log = read_log(path, {"position_load": "x"}, optional={"force": "f", "command": "nothing"})
    assert set(log.channels) == {"position_load", "force"}


def test_a_log_without_time_needs_its_sample_time(tmp_path: Path) -> None:
    path = write(tmp_path, "x,y\n1,2\n3,4\n5,6\n")
    with pytest.raises(
        LogError, match=r"has no column of time among x, y; name it, as in  time = .* or give the sample"
    ):
        read_log(path)
    log = read_log(path, {"position_load": "x"}, sample_time=1e-3)
    assert log.time.tolist() == [0.0, 1e-3, 2e-3]
    assert log["position_load"].tolist() == [1, 3, 5]


@pytest.mark.parametrize(
    ("mapping", "message"),
    [
        ({"positon_load": "x"}, r"a\.csv: a log has no role 'positon_load'; did you mean position_load"),
        ({"position_load": "y"}, r"there is no column 'y' \(position_load\); there are: t, x, f"),
        ({"position_load": "note"}, r"column 'note' \(position_load\) is not numbers but text"),
        ({"position_load": ("x", "kg")}, r"unit 'kg' does not measure the same thing as 'm'"),
        ({"position_load": ("x", "foo")}, r"unit 'foo' is not known"),
        ({"force": "x"}, r"column 'x' is in 'mm', which is not a unit of force \(N\); give the factor"),
        ({"force": ("x", 0.0)}, r"force: factor = 0 must be a finite number that is not 0"),
        ({"force": ("x", float("nan"))}, r"force: factor = nan must be a finite number"),
        ({"force": Column(name="x", unit="kg", factor=2.0)}, r"'kg' .* as 'N'; a factor from it to N is"),
        ({"position_load": ("x", -1.0)}, r"'x' is in mm, .* would take its numbers for m: .* x\*-1.0:mm"),
    ],
)
def test_what_is_wrong_with_a_mapping(tmp_path: Path, mapping: Any, message: str) -> None:
    with pytest.raises((LogError, ParameterError), match=message):
        read_log(write(tmp_path, TEXT), mapping)


def test_numbers_that_are_none_are_named_with_their_row(tmp_path: Path) -> None:
    path = write(tmp_path, "t,x,y\n0,1,1\n.001,2,nan\n.002,3,2\n.003,inf,2\n")
    with pytest.raises(LogError, match=r"a\.csv: column 'x' is inf at line 5 \(1 such rows\); cut the log there"):
        read_log(path)
    with pytest.raises(LogError, match=r"column 'y' is nan at line 3 \(1 such rows\)"):
        read_log(path, {"force": "y"})
    with pytest.raises(LogError, match=r"column 't' is nan at line 3"):
        read_log(write(tmp_path, "t,x\n0,1\nnan,2\n.002,3\n"))
    with pytest.raises(LogError, match=r"a gap lies before line 5: 0\.002 s is followed by 0\.005 s"):
        read_log(write(tmp_path, "t,x\n0,1\n.001,2\n.002,3\n.005,3\n.006,4\n"))


def test_numbers_beyond_all_measure_are_named_with_their_row(tmp_path: Path) -> None:
    """1.8e308 is how some recorders mark a missing value; its square would be infinite."""
    path = write(tmp_path, "t [ms],x,y\n0,1,2\n1,2,1.7976931348623157e308\n2,3,4\n")
    with pytest.raises(LogError, match=r"a\.csv: column 'y' reaches 1\.8e\+308 at line 3, beyond 1e\+30.*map only"):
        read_log(path)
    assert read_log(path, {"position_load": "x"})["position_load"][-1] == 3.0


@pytest.mark.parametrize(
    ("role", "unit", "factor"),
    [
        ("torque", "Nm", 1.0),
        ("torque", "mNm", 1e-3),
        ("torque", "Nmm", 1e-3),
        ("angle_motor", "mdeg", np.pi / 180e3),
        ("angle_motor", "arcsec", np.pi / 648e3),
        ("angle_motor", "°", np.pi / 180),
        ("position_load", "µm", 1e-6),
        ("speed_motor", "1/min", np.pi / 30),
    ],
)
def test_units_of_a_mapping_as_makers_write_them(tmp_path: Path, role: str, unit: str, factor: float) -> None:
    path = write(tmp_path, "t [ms],y\n" + "".join(f"{k},{k}\n" for k in range(10)))
    # two roundings: of the factor and of the product
    np.testing.assert_allclose(read_log(path, {role: ("y", unit)})[role], factor * np.arange(10), rtol=4e-16)


@pytest.mark.parametrize("given_time", [0.0, -1.0, float("nan"), float("inf")])
def test_a_sample_time_that_is_none(tmp_path: Path, given_time: float) -> None:
    with pytest.raises(ParameterError, match=r"sample_time = .* must be > 0 s"):
        read_log(write(tmp_path, TEXT), sample_time=given_time)


def test_constant_channels_are_allowed(tmp_path: Path) -> None:
    log = read_log(write(tmp_path, "t,x\n" + "".join(f"{k * 1e-3},5\n" for k in range(10))))
    assert np.all(log["x"] == 5.0)


# files of other kinds


@pytest.mark.parametrize(("start", "what", "advice"), formats._OTHERS)
def test_a_file_of_another_kind_is_named(tmp_path: Path, start: bytes, what: str, advice: str) -> None:
    for name in ("a.mat", "a.csv"):
        path = write(tmp_path, start + b" and so on\n1,2\n3,4\n", name)
        with pytest.raises(LogError, match=re.escape(f"{path}: is {what}, not a log that can be read")):
            read_log(path)


def test_the_content_decides_not_the_ending(tmp_path: Path) -> None:
    log = read_log(write(tmp_path, TEXT, "a.mat"))
    assert log["x"].tolist() == list(range(10))
    with pytest.raises(LogError, match=r"is a binary file of an unknown kind; .*by its name it should be \.mat"):
        read_log(write(tmp_path, bytes(range(256)) * 10, "b.mat"))
    with pytest.raises(LogError, match=r"c\.csv: is empty"):
        read_log(write(tmp_path, b"", "c.csv"))
    with pytest.raises(FileError, match="no such file"):
        read_log(tmp_path / "nothing.csv")
    with pytest.raises(FileError, match="is a directory"):
        read_log(tmp_path)


def test_gzip_of_many_members_is_read_in_linear_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bytes handed to zlib and back, over the size of the file: they do not grow with the number of members."""
    moved = 0
    real = zlib.decompressobj

    class Counted:
        def __init__(self, wbits: int) -> None:
            self.inner = real(wbits=wbits)

        def decompress(self, data: bytes, most: int) -> bytes:
            nonlocal moved
            found = self.inner.decompress(data, most)
            moved += len(data) + len(self.inner.unused_data) + len(self.inner.unconsumed_tail)
            return found

        def __getattr__(self, name: str) -> object:
            return getattr(self.inner, name)

    monkeypatch.setattr(formats.zlib, "decompressobj", Counted)
    member = gzip.compress(b"")
    ratios = []
    for count in (1000, 4000):
        moved = 0
        with pytest.raises(LogError, match="is empty"):
            formats.unpacked("a.csv.gz", member * count)
        ratios.append(moved / (count * len(member)))
    assert ratios[1] < 1.01 * ratios[0] < 50


def test_members_of_gzip_and_zeros_between_them() -> None:
    """What a member holds does not depend on the pieces in which it is fed."""
    text = b"".join(b"%d," % (k * k) for k in range(30_000))
    packed = gzip.compress(text) + b"\0" * 70_000 + gzip.compress(b"") + gzip.compress(text[::-1]) + b"\0"
    assert formats.unpacked("a.csv.gz", packed) == text + text[::-1]
    for cut in (len(packed) - 3, 12, 300, 20_000):
        with pytest.raises(LogError, match="is packed by gzip and cut off"):
            formats.unpacked("a.csv.gz", packed[:cut])


def test_packed_by_gzip(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    packed = gzip.compress(TEXT.encode())
    assert read_log(write(tmp_path, packed, "a.csv.gz"))["x"].size == 10
    halves = gzip.compress(TEXT[:50].encode()) + gzip.compress(TEXT[50:].encode()) + b"\0\0"
    assert len(read_log(write(tmp_path, halves, "b.csv.gz"))) == 10
    with pytest.raises(LogError, match="is packed by gzip and cut off; copy it again"):
        read_log(write(tmp_path, packed[:-9], "c.csv.gz"))
    with pytest.raises(LogError, match="is packed by gzip and damaged; copy it again"):
        read_log(write(tmp_path, packed[:20] + b"xxxxx" + packed[25:], "d.csv.gz"))
    with pytest.raises(LogError, match="is packed by gzip and damaged"):
        read_log(write(tmp_path, packed[:-5] + b"xxxxx", "e.csv.gz"))
    monkeypatch.setattr(columns, "MOST_BYTES", 50)
    with pytest.raises(LogError, match="holds more than the 0 MB that are read, once unpacked"):
        read_log(write(tmp_path, packed, "f.csv.gz"))


def test_a_bomb_does_not_fill_the_memory(tmp_path: Path) -> None:
    """200 MB of zeros in 200 kB: more than 100 MB and 100 times the file, so that it is left after 120 MB."""
    bomb = gzip.compress(b"0,0\n" * 50_000_000, 1)
    assert len(bomb) < 1_000_000
    tracemalloc.start()
    with pytest.raises(LogError, match=r"holds more than the 1\d\d MB that are read, once unpacked"):
        read_log(write(tmp_path, bomb, "a.csv.gz"))
    assert tracemalloc.get_traced_memory()[1] < 500_000_000
    tracemalloc.stop()


# the result itself


def test_a_log_cannot_be_changed_and_checks_itself() -> None:
    x = np.zeros(5)
    log = Log(name="a", time=np.arange(5) * 1e-3, channels={"x": x}, units={"x": "m"}, sample_time=1e-3)
    x[0] = 1.0
    assert log["x"][0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        log["x"][0] = 1.0
    with pytest.raises(ParameterError, match="the log 'a' has no channel 'y'; there are: x"):
        log["y"]
    for channels, message in [
        ({"x": np.zeros(4)}, "'x' has 4 rows, time has 5"),
        ({"x": np.zeros((5, 1))}, r"'x' must be a row of numbers, not of shape \(5, 1\)"),
        ({"x": np.array([0, 1, np.nan, 3, 4])}, "'x' is not finite at row 3"),
    ]:
        with pytest.raises(LogError, match=message):
            Log(name="a", time=np.arange(5) * 1e-3, channels=channels, units={}, sample_time=1e-3)


def test_the_table_shows_what_people_read() -> None:
    t = np.arange(1000) * 1e-3
    log = Log(name="run", time=t, channels={"x": 5e-6 * np.sin(2 * np.pi * 5 * t)}, units={"x": "m"}, sample_time=1e-3)
    assert str(log.table()).split("\n")[0] == "run: 1000 rows, 0.999 s at 1 ms, jitter 0 %"
    cells = log.table().grid().rows[0]
    assert cells[:2] == ["x", "um"]
    # sine of 5 um amplitude over whole periods: RMS 5/sqrt(2) um, and the peaks are sampled
    assert [float(cell) for cell in cells[2:]] == pytest.approx([-5.0, 5.0, 3.5355], abs=1e-3)
    assert repr(log) == str(log.table())
    assert log._repr_html_().startswith("<table>")


def test_pandas(monkeypatch: pytest.MonkeyPatch) -> None:
    log = Log(name="a", time=np.arange(5) * 1e-3, channels={"x": np.arange(5.0)}, units={}, sample_time=1e-3)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        frame = log.to_pandas()
    assert frame.index.name == "time"
    assert frame["x"].tolist() == [0, 1, 2, 3, 4]
    real = builtins.__import__

    def absent(name: str, *rest: Any) -> Any:
        if name == "pandas":
            raise ImportError
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", absent)
    with pytest.raises(MissingExtraError, match=r"feeddrive\[pandas\]"):
        log.to_pandas()

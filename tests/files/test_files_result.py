"""Parquet and CSV of runs and logs: the same bits back, the same bytes again, whole or not at all."""

from __future__ import annotations

import resource
import signal
from pathlib import Path

import numpy as np
import pandas
import pyarrow as arrow
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from pyarrow import parquet

from feeddrive.files.log import Log, write_log
from feeddrive.files.read_log import read_columns, read_log
from feeddrive.files.run_files import run_stream, write_run_csv, write_run_parquet
from feeddrive.language.errors import FileError, LogError, ParameterError

T = 5e-5
TIME = T * np.arange(1000)
COLUMNS = {"force": np.random.default_rng(0).normal(size=1000), "position_load": np.sin(TIME)}
UNITS = {"force": "N", "position_load": "m"}


@settings(max_examples=60)
@given(arrays.arrays(np.float64, st.integers(3, 100), elements=st.floats(width=64)))
def test_every_bit_comes_back(tmp_path_factory: pytest.TempPathFactory, values: np.ndarray) -> None:
    folder = tmp_path_factory.mktemp("bits")
    time = T * np.arange(values.size)
    write_run_parquet(folder / "a.parquet", time, {"x": values}, {"x": "m"}, T)
    write_run_csv(folder / "a.csv", time, {"x": values}, {"x": "m"})
    for name in ("a.parquet", "a.csv"):
        found = read_columns(name, (folder / name).read_bytes(), None)
        np.testing.assert_array_equal(found.values["time"], time)
        np.testing.assert_array_equal(found.values["x"], values)
        same_sign = np.signbit(found.values["x"]) == np.signbit(values)
        assert np.all(same_sign | np.isnan(values))
        assert found.units == {"time": "s", "x": "m"}


def test_a_run_is_read_back_as_a_log(tmp_path: Path) -> None:
    write_run_parquet(tmp_path / "a.parquet", TIME, COLUMNS, UNITS, T, {"seed": 3, "name": "test run"})
    log = read_log(tmp_path / "a.parquet")
    assert (log.name, log.sample_time, log.units) == ("test run", T, UNITS)
    for name, values in COLUMNS.items():
        np.testing.assert_array_equal(log[name], values)
    write_run_csv(tmp_path / "a.csv", TIME, COLUMNS, UNITS)
    again = read_log(tmp_path / "a.csv", {"force": "force", "position_load": "position_load"})
    assert (again.sample_time, again.units) == (T, UNITS)
    np.testing.assert_array_equal(again["force"], COLUMNS["force"])
    assert (tmp_path / "a.csv").read_text().split("\n")[0] == "time [s],force [N],position_load [m]"


def test_a_log_is_written_and_read_back(tmp_path: Path) -> None:
    log = Log(
        name="axis x",
        time=TIME + 1e-7 * np.sin(np.arange(1000)),
        channels=COLUMNS,
        units=UNITS,
        sample_time=T,
        constants={"gtau": 35.15065188248547},
        provenance={"file": "run.mat", "sha256": "0" * 64, "format": "MATLAB 5"},
    )
    write_log(tmp_path / "a.parquet", log)
    again = read_log(tmp_path / "a.parquet")
    assert (again.name, again.sample_time, dict(again.units)) == (log.name, log.sample_time, dict(log.units))
    assert again.constants == log.constants
    np.testing.assert_array_equal(again.time, log.time)
    for name, values in log.channels.items():
        np.testing.assert_array_equal(again[name], values)
    assert again.provenance["origin"] == log.provenance
    assert again.provenance["format"] == "Parquet"


def test_the_same_content_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_run_parquet(tmp_path / f"{name}.parquet", TIME, COLUMNS, UNITS, T, {"b": 1, "a": [2]})
        write_run_csv(tmp_path / f"{name}.csv", TIME, COLUMNS, UNITS)
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()


def test_piece_by_piece_it_is_the_same_run(tmp_path: Path) -> None:
    write_run_parquet(tmp_path / "whole.parquet", TIME, COLUMNS, UNITS, T)
    with run_stream(tmp_path / "stream.parquet", UNITS, T) as append:
        for start in range(0, 1000, 300):
            part = slice(start, start + 300)
            append(TIME[part], {name: values[part] for name, values in COLUMNS.items()})
            assert not (tmp_path / "stream.parquet").exists()
    whole, stream = read_log(tmp_path / "whole.parquet"), read_log(tmp_path / "stream.parquet")
    np.testing.assert_array_equal(whole.time, stream.time)
    for name in COLUMNS:
        np.testing.assert_array_equal(whole[name], stream[name])


def test_an_interrupted_stream_leaves_nothing(tmp_path: Path) -> None:
    def interrupted() -> None:
        with run_stream(tmp_path / "a.parquet", UNITS, T) as append:
            append(TIME, COLUMNS)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_is_full_leaves_nothing(tmp_path: Path) -> None:
    """A limit of the file size, with its signal ignored, fails a write as a full disk does."""
    noise = np.random.default_rng(1).normal(size=200_000)
    time = T * np.arange(noise.size)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))
        with pytest.raises(FileError, match=r"a\.parquet: cannot be written: .*file too large"):
            write_run_parquet(tmp_path / "a.parquet", time, {"x": noise}, {"x": "m"}, T)
        with pytest.raises(FileError, match=r"a\.csv: cannot be written: .*file too large"):
            write_run_csv(tmp_path / "a.csv", time, {"x": noise}, {"x": "m"})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, before)
    assert list(tmp_path.iterdir()) == []


def test_what_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="columns must have one dimension and one length"):
        write_run_parquet(tmp_path / "a", TIME, {"x": TIME[:-1]}, {}, T)
    with pytest.raises(ParameterError, match="columns must have one dimension and one length"):
        write_run_csv(tmp_path / "a", TIME, {"x": TIME[:, None]}, {})
    with pytest.raises(ParameterError, match="metadata cannot be written as JSON"):
        write_run_parquet(tmp_path / "a", TIME, {}, {}, T, {"x": object()})
    with pytest.raises(ParameterError, match="metadata cannot be written as JSON"):
        write_run_parquet(tmp_path / "a", TIME, {}, {}, T, {"x": float("nan")})
    assert list(tmp_path.iterdir()) == []


def test_heads_with_marks_of_csv_are_quoted(tmp_path: Path) -> None:
    write_run_csv(tmp_path / "a.csv", TIME, {'a "b", c': TIME}, {'a "b", c': "m"})
    assert list(pandas.read_csv(tmp_path / "a.csv").columns) == ["time [s]", 'a "b", c [m]']
    assert list(read_log(tmp_path / "a.csv").channels) == ['a "b", c']


def test_parquet_of_somebody_else(tmp_path: Path) -> None:
    stamps = np.array(["2024-01-01T00:00:00.000", "2024-01-01T00:00:00.001", "2024-01-01T00:00:00.002"], "M8[ms]")
    table = arrow.table(
        {
            "time": stamps.astype("M8[us]"),
            "i": arrow.array([1, 2, 3], arrow.int16()),
            "f": arrow.array([1.5, 2.5, 3.5], arrow.float32()),
            "b": [True, False, True],
            "text": ["a", "b", "c"],
            "nested": [[1], [2], [3]],
        }
    )
    parquet.write_table(table, tmp_path / "a.parquet")
    log = read_log(tmp_path / "a.parquet")
    assert log.sample_time == 1e-3
    assert {name: values.tolist() for name, values in log.channels.items()} == {
        "i": [1, 2, 3],
        "f": [1.5, 2.5, 3.5],
        "b": [1, 0, 1],
    }
    assert set(log.left_out) == {"text", "nested"}
    missing = arrow.table(
        {"t": [0.0, 1e-3, 2e-3], "x": [1.0, None, 3.0], "n": arrow.array([1, None, 3], arrow.int64())}
    )
    parquet.write_table(missing, tmp_path / "b.parquet")
    for name in ("x", "n"):
        with pytest.raises(LogError, match=rf"column '{name}' is nan at row 2"):
            read_log(tmp_path / "b.parquet", {"force": name})


def test_a_file_of_pandas(tmp_path: Path) -> None:
    frame = pandas.DataFrame({"x": [1.0, 2.0, 3.0]}, index=pandas.Index([0.0, 1e-3, 2e-3], name="time"))
    frame.to_parquet(tmp_path / "a.parquet")
    assert read_log(tmp_path / "a.parquet")["x"].tolist() == [1, 2, 3]


def test_flipped_bits_in_the_numbers_are_found_by_the_checksum(tmp_path: Path) -> None:
    write_run_parquet(tmp_path / "a.parquet", TIME, {"x": COLUMNS["force"]}, {"x": "m"}, T)
    content = (tmp_path / "a.parquet").read_bytes()
    for place in range(200, 5000, 97):
        damaged = bytearray(content)
        damaged[place] ^= 1
        with pytest.raises(LogError, match="is a damaged or cut off Parquet file"):
            read_columns("a.parquet", bytes(damaged), None)

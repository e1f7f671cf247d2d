"""Tables that grow: whole lines only, in any pieces; files cut, written anew, replaced; pipes; a writer beside it."""

from __future__ import annotations

import gzip
import os
import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from feeddrive.analysis.oscilloscope import Rows
from feeddrive.files import growing
from feeddrive.files.growing import GrowingFile, GrowingTable, Grown, Pipe
from feeddrive.files.read_log import read_log
from feeddrive.language.errors import FileError, LogError

N = 40
T = np.arange(N) * 1e-3
X = np.round(10.0 * np.sin(T * 50.0), 6)
CSV = "t_ms,x [mm],force_N\n" + "".join(f"{1e3 * t:g},{x},{-2 * x:.6f}\n" for t, x in zip(T, X, strict=True))


class Given:
    """Bytes that come piece by piece."""

    name = "given"

    def __init__(self, content: bytes, sizes: list[int]) -> None:
        edges = [0, *np.cumsum(sizes).clip(0, len(content)).tolist(), len(content)]
        self._pieces = [content[a:b] for a, b in pairwise(edges)]
        self._given = b""

    def head(self) -> bytes:
        return self._given

    def waits(self) -> str:
        return ""

    def read(self) -> Grown:
        begins = not self._given
        piece = self._pieces.pop(0) if self._pieces else b""
        self._given += piece
        return Grown(piece, begins)


def taken(table: GrowingTable, looks: int = 30) -> Rows:
    """All rows of some looks."""
    found = [each for each in (table.take() for _ in range(looks)) if each.time.size]
    return Rows(np.concatenate([each.time for each in found]), np.concatenate([each.values for each in found]))


LAYOUTS = {
    "csv": CSV,
    "windows": CSV.replace("\n", "\r\n"),
    "decimal comma": CSV.replace(",", ";").replace(".", ","),
    "tabs and remarks": "# of a lathe\n" + CSV.replace(",", "\t").replace("\n0.01", "\n# a remark\n\n0.01"),
    "spaces": "% t_ms  x_mm  force_N\n" + CSV.split("\n", 1)[1].replace(",", "  "),
}


@pytest.mark.parametrize("text", LAYOUTS.values(), ids=LAYOUTS)
@given(sizes=st.lists(st.integers(0, 300), max_size=12))
def test_rows_do_not_depend_on_the_pieces_in_which_they_come(text: str, sizes: list[int]) -> None:
    """A line that is half there is waited for: the numbers are those of the file read as a whole."""
    table = GrowingTable(Given(text.encode(), sizes))
    rows = taken(table)
    np.testing.assert_allclose(rows.time, T, atol=1e-15)
    np.testing.assert_array_equal(rows.values, np.column_stack([X, -2.0 * X]))
    assert [*table.channels.values()] == ["mm", "N"]
    assert table.clock == "s"


def test_the_same_as_the_file_read_when_it_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text(CSV, encoding="utf-8")
    table, log = GrowingTable(GrowingFile(path)), read_log(path)
    rows = taken(table)
    np.testing.assert_array_equal(rows.time, log.time)
    for k, name in enumerate(table.channels):
        np.testing.assert_array_equal(rows.values[:, k], log[name])


def test_a_file_may_come_later_be_cut_written_anew_and_replaced(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    table = GrowingTable(GrowingFile(path))
    assert table.take().time.size == 0
    assert table.state() == "waits for the file: it is not there"
    lines = CSV.splitlines(keepends=True)
    path.write_text("".join(lines[:11]), encoding="utf-8")
    assert table.take().time.size == 10
    with path.open("a", encoding="utf-8") as file:
        file.write("".join(lines[11:21]) + lines[21][:3])
    more = table.take()
    assert (more.time.size, more.anew) == (10, False)
    path.write_text("".join(lines[:6]), encoding="utf-8")  # cut
    cut = table.take()
    assert (cut.time.size, cut.anew) == (5, True)
    assert cut.time[0] == 0.0
    other = "t_ms,y_um\n" + "".join(f"{k},{k + 0.5}\n" for k in range(20))
    path.write_text(other, encoding="utf-8")  # anew, and longer than before
    anew = table.take()
    assert (anew.time.size, anew.anew) == (20, True)
    assert dict(table.channels) == {"y_um": "um"}
    path.rename(tmp_path / "run.csv.1")
    assert table.take().time.size == 0
    assert "is not there" in table.state()
    path.write_text(other.replace(".5", ".7"), encoding="utf-8")  # rotated: of the same size
    rotated = table.take()
    assert (rotated.time.size, rotated.anew) == (20, True)
    assert rotated.values[3, 0] == 3.7


def test_a_file_that_is_replaced_by_one_of_the_same_size_begins_anew(tmp_path: Path) -> None:
    path, other = tmp_path / "run.csv", tmp_path / "other.csv"
    path.write_text("t_s,x\n0,1\n1,2\n2,3\n", encoding="utf-8")
    table = GrowingTable(GrowingFile(path))
    table.take()
    other.write_text("t_s,x\n5,1\n6,2\n7,9\n", encoding="utf-8")
    other.replace(path)
    found = table.take()
    assert found.anew
    assert found.time.tolist() == [5.0, 6.0, 7.0]


def test_of_a_long_file_the_end_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(growing, "FIRST", 1000)
    path = tmp_path / "run.csv"
    path.write_text("t_s,x\n" + "".join(f"{k},{2 * k}\n" for k in range(10_000)), encoding="utf-8")
    rows = taken(GrowingTable(GrowingFile(path)))
    assert 80 < rows.time.size < 120
    assert rows.time[-1] == 9999.0
    np.testing.assert_array_equal(rows.values[:, 0], 2.0 * rows.time)
    assert np.all(np.diff(rows.time) == 1.0)


def test_lines_that_are_no_rows_are_left_out_and_counted(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("t_s,x\n0,1\n1,2\n2,3\n", encoding="utf-8")
    table = GrowingTable(GrowingFile(path))
    assert table.take().time.tolist() == [0.0, 1.0, 2.0]
    with path.open("a", encoding="utf-8") as file:
        file.write("3,4\n4\n5,6,7\n6,7\nwatchdog: \x1b[31mlate\n")
    assert table.take().time.tolist() == [3.0, 6.0]
    assert table.state() == "rows come; 3 lines were no rows, the last one 'watchdog: [31mlate'"


def halsampler(tag: bool, lost: int) -> str:
    """As halsampler prints it, with a loss of 7 samples."""
    rows = [(k if k < lost else k + 7, x) for k, x in enumerate(X)]
    lines = [(f"{number} " if tag else "") + f"{x:f} {number % 2} \n" for number, x in rows]
    return "".join([*lines[:lost], "overrun\n", *lines[lost:]])


@pytest.mark.parametrize("tag", [True, False])
@given(sizes=st.lists(st.integers(0, 200), max_size=8))
@example(sizes=[90, 200, 8])  # with numbers a piece of its own holds `overrun` and nothing else
def test_halsampler(tag: bool, sizes: list[int]) -> None:
    """With numbers of samples these are the clock; without, rows are counted; what was lost is a gap."""
    table = GrowingTable(Given(halsampler(tag, 20).encode(), sizes), sample_time=1e-3)
    rows = taken(table)
    first = 2 if tag else 1
    assert [*table.channels] == [f"column_{first}", f"column_{first + 1}"]
    gap = np.isnan(rows.values[:, 0])
    assert np.count_nonzero(gap) == 1
    np.testing.assert_array_equal(rows.values[~gap, 0], X)
    after = rows.time[~gap][20:]
    np.testing.assert_allclose(after, (np.arange(20, 40) + (7 if tag else 1)) * 1e-3)
    assert np.all(np.diff(rows.time) >= 0.0)
    if tag:
        assert rows.time[gap] == after[:1], "a gap has the number of the row after it, whatever the pieces"


@pytest.mark.parametrize("wrong", [1, 3])
def test_a_row_of_halsampler_whose_first_cell_is_no_number_is_left_out(wrong: int) -> None:
    lines = [f"{k} {k / 2:f} {k % 2} \n" for k in range(12)]
    lines[wrong] = "x 0.0 1.0 \n"
    table = GrowingTable(Given("".join(lines).encode(), []), sample_time=1.0)
    rows = taken(table)
    kept = [k for k in range(12) if k != wrong]
    assert rows.time.tolist() == kept
    assert rows.values[:, 0].tolist() == [k / 2 for k in kept]
    assert table.state() == "rows come; 1 lines were no rows, the last one 'x 0.0 1.0'"


def test_text_that_is_never_understood_is_not_gathered() -> None:
    """Lines that are too long for the first bytes: an error, before they fill the memory."""
    line = b"1" + b",1.5" * 10_000 + b"\n"
    given = Given(line * 20, [len(line)] * 20)
    with pytest.raises(LogError, match="in its first 64 kB"):
        taken(GrowingTable(given))
    assert len(given.head()) < 3 * growing.HEAD


def test_without_a_clock_rows_are_counted_in_samples() -> None:
    table = GrowingTable(Given(b"x,y\n" + b"1,2\n" * 10, []))
    assert taken(table).time.tolist() == [*range(10)]
    assert table.clock == "samples"


def test_a_column_of_time_without_a_unit_is_in_the_one_that_is_given() -> None:
    text = ("t,x\n" + "".join(f"{k},1\n" for k in range(10))).encode()
    np.testing.assert_allclose(taken(GrowingTable(Given(text, []), time_unit="ms")).time, np.arange(10) * 1e-3)
    stated = text.replace(b"t,x", b"t_us,x")
    np.testing.assert_allclose(taken(GrowingTable(Given(stated, []))).time, np.arange(10) * 1e-6)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (gzip.compress(CSV.encode()) + b"\n\n\n", "packed or in UTF-16"),
        (CSV.encode("utf-16"), "packed or in UTF-16"),
        (b"PAR1\0\0\0\n\n\n\n", "rows cannot be read while it grows"),
        (b"\1\2\3\n\n\n\n", "binary file"),
        (b"word\n" * 20_000, "no rows of numbers"),
        (b"1" * 1_100_000, "a line of more than 1 MB"),
        (b"t_s,x\n" + b"0" * 100_000, "fewer than 3, in its first 64 kB: shorten the text above them"),
        (b"".join(b"%d" % k + b",1" * 15_000 + b"\n" for k in range(5)), "or record fewer columns"),
        (b"# " + b"a" * 70_000 + b"\nt_s,x\n" + b"0,1\n" * 9, "no rows of numbers, or fewer than 3"),
        (b"# Sampling period is 1000000 ns\n# a b\n" + b"1 2\n" * 9, "rows cannot be read while it grows"),
    ],
)
def test_what_cannot_be_followed_is_refused_with_the_reason(tmp_path: Path, content: bytes, reason: str) -> None:
    path = tmp_path / "run.csv"
    path.write_bytes(content)
    with pytest.raises(LogError, match=reason):
        taken(GrowingTable(GrowingFile(path)))


def test_a_folder_a_pipe_and_a_link_that_leads_out_are_refused(tmp_path: Path) -> None:
    inside = tmp_path / "inside"
    inside.mkdir()
    secret = tmp_path / "secret.csv"
    secret.write_text(CSV, encoding="utf-8")
    (inside / "link.csv").symlink_to(secret)
    with pytest.raises(FileError, match="leads out of"):
        GrowingFile(inside / "link.csv", inside).read()
    assert GrowingFile(inside / "link.csv").read().content  # who names it on the command line may
    with pytest.raises(FileError, match="a directory, a device or a pipe"):
        GrowingFile(inside).read()
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "fifo")
        with pytest.raises(FileError, match="a directory, a device or a pipe"):
            GrowingFile(tmp_path / "fifo").read()


WRITER = """
import sys, time
with open(sys.argv[1], "w") as file:
    file.write("t_s,x_mm\\n")
    for k in range(2000):
        line = f"{k * 1e-3:.3f},{k * k * 1e-3:.6f}\\n"
        half = len(line) // 2
        file.write(line[:half])
        if k % 17 == 0:
            file.flush()
        file.write(line[half:])
        if k % 100 == 0:
            file.flush()
            time.sleep(0.02)
"""


def test_a_file_that_another_process_writes(tmp_path: Path) -> None:
    """It flushes in the middle of lines and pauses; each row comes once, in order, and not only at the end."""
    path = tmp_path / "run.csv"
    table = GrowingTable(GrowingFile(path))
    writer = subprocess.Popen([sys.executable, "-c", WRITER, str(path)])
    pieces, until = list[Rows](), time.monotonic() + 30.0
    while sum(each.time.size for each in pieces) < 2000 and time.monotonic() < until:
        pieces.append(table.take())
        time.sleep(0.005)
    assert writer.wait(10.0) == 0
    rows = Rows(
        np.concatenate([each.time for each in pieces]), np.concatenate([e.values for e in pieces if e.time.size])
    )
    k = np.arange(2000)
    np.testing.assert_allclose(rows.time, k * 1e-3, atol=1e-12)
    np.testing.assert_allclose(rows.values[:, 0], k * k * 1e-3, atol=1e-12)
    assert sum(each.time.size > 0 for each in pieces) > 5
    time.sleep(1.2)
    table.take()
    assert "no new rows for 1 s" in table.state()


def test_a_pipe_is_read_once_for_all_who_follow_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(growing, "_MOST", 2000)
    reading, writing = os.pipe()
    with open(reading, "rb") as stream, open(writing, "wb", buffering=0) as end:
        pipe = Pipe(stream)
        one = GrowingTable(pipe.follower(), sample_time=1e-3)
        for k in range(3):
            end.write(f"{k} {k / 2:f} \n".encode())
        rows = [_until(one, 3)]
        end.write("".join(f"{k} {k / 2:f} \n" for k in range(3, 1000)).encode())
        rows.append(_until(one, 1))
        late = GrowingTable(pipe.follower(), sample_time=1e-3)
        end.close()
        time.sleep(0.1)
        rows.append(one.take())
        last = late.take()
    for each in (rows[-1] if rows[-1].time.size else rows[-2], last):
        assert each.time[-1] == pytest.approx(0.999)
        np.testing.assert_allclose(each.values[:, 0], each.time * 500.0, atol=1e-6)
    assert 0 < last.time.size < 1000  # of the last bytes, from the begin of a line
    assert "the pipe has ended" in late.state()


@pytest.mark.parametrize("most", range(1000, 1022))
def test_who_follows_a_pipe_late_begins_with_a_whole_line(most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Wherever the older bytes end: lines have 22 bytes."""
    monkeypatch.setattr(growing, "_MOST", most)
    reading, writing = os.pipe()
    with open(reading, "rb") as stream, open(writing, "wb", buffering=0) as end:
        pipe = Pipe(stream)
        end.write("".join(f"{k:06d} {k + 100_000:f} \n" for k in range(400)).encode())
        table = GrowingTable(pipe.follower(), sample_time=1.0)
        for _ in range(6000):
            if pipe.since(0)[1] == 400 * 22:
                break
            time.sleep(0.01)
        rows = table.take()
    assert 30 < rows.time.size < 400
    np.testing.assert_array_equal(rows.values[:, 0], rows.time + 100_000)
    assert "no rows" not in table.state()


def _until(table: GrowingTable, least: int) -> Rows:
    for _ in range(6000):
        rows = table.take()
        if rows.time.size >= least:
            return rows
        time.sleep(0.01)
    raise AssertionError("no rows came")

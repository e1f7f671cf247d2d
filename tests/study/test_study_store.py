"""The store of a sweep: whole files or none, exact resume, and refusal of everything that is not its own."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import signal
import subprocess
import sys
import textwrap
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import fsspec
import numpy as np
import pyarrow as arrow
import pytest
from pyarrow import parquet

from feeddrive.files import atomic_io
from feeddrive.language.errors import FileError, ParameterError
from feeddrive.study.chunk import chunk_bytes
from feeddrive.study.store import Manifest, Store
from fresh_draws import Seeded

MANIFEST = Manifest(study='title = "ten of three"\n', digest="ab" * 32, count=10, chunk=3)


def rows(number: int, manifest: Manifest = MANIFEST) -> arrow.Table:
    """What a chunk may hold: numbers that are no decimal fraction, one variant with a reason and no figure."""
    variants = manifest.rows(number)
    return arrow.table(
        {
            "variant": arrow.array(variants, arrow.int64()),
            "axis.x.plant.mass_load": arrow.array([1.0 / (3.0 + each) for each in variants]),
            "following_error_rms_m": arrow.array([None if each == 4 else 1e-7 * each for each in variants]),
            "reason": arrow.array(["diverged" if each == 4 else None for each in variants], arrow.string()),
        }
    )


def filled(address: str | Path, numbers: range | None = None) -> Store:
    store = Store(address)
    store.begin(MANIFEST)
    for number in range(MANIFEST.chunks) if numbers is None else numbers:
        store.write(number, rows(number))
    return store


def everything() -> arrow.Table:
    return arrow.concat_tables([rows(number) for number in range(4)])


def of_before(number: int) -> bytes:
    """A chunk as feeddrive wrote it before its files had a SHA-256."""
    sink = arrow.BufferOutputStream()
    signed = rows(number).replace_schema_metadata({"feeddrive.study": MANIFEST.digest})
    parquet.write_table(signed, sink, compression="zstd", write_page_checksum=True)
    return sink.getvalue().to_pybytes()


def contents(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


@pytest.fixture(params=["folder", "file://", "memory://"])
def address(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    if request.param == "memory://":
        return f"memory://{tmp_path}"
    return f"{'' if request.param == 'folder' else 'file://'}{tmp_path / 'out'}"


def test_chunks_cover_the_variants_once() -> None:
    covered = [each for number in range(MANIFEST.chunks) for each in MANIFEST.rows(number)]
    assert covered == list(range(10))
    assert replace(MANIFEST, count=9).chunks == 3
    assert replace(MANIFEST, chunk=100).chunks == 1


@pytest.mark.parametrize(("count", "chunk"), [(0, 3), (3, 0), (10**12, 1)])
def test_impossible_counts_are_refused(count: int, chunk: int) -> None:
    with pytest.raises(ParameterError, match="at least 1"):
        replace(MANIFEST, count=count, chunk=chunk)


def test_what_was_written_in_any_order_is_read_back_in_the_order_of_variants(address: str) -> None:
    store = Store(address)
    assert store.begin(MANIFEST) == frozenset()
    for number in (2, 0, 3, 1):
        store.write(number, rows(number))
    again = Store(address)
    assert again.manifest() == MANIFEST
    assert again.done() == {0, 1, 2, 3}
    assert again.table().equals(everything())
    assert [each.num_rows for each in again.batches(["variant"])] == [3, 3, 3, 1]
    assert again.table(["variant", "reason"]).column_names == ["variant", "reason"]


def test_resume_names_what_is_done_and_touches_nothing(address: str, tmp_path: Path) -> None:
    filled(address, range(1, 3))
    before = contents(tmp_path)
    assert Store(address).begin(MANIFEST, resume=True) == {1, 2}
    assert contents(tmp_path) == before


def test_a_chunk_that_is_written_twice_is_there_once(tmp_path: Path) -> None:
    store = filled(tmp_path)
    before = contents(tmp_path)
    store.write(2, rows(2))
    assert contents(tmp_path) == before


def test_pandas_polars_and_duckdb_read_one_table(tmp_path: Path) -> None:
    duckdb, pandas, polars = (pytest.importorskip(each) for each in ("duckdb", "pandas", "polars"))
    filled(tmp_path)
    wanted = everything().to_pydict()
    by_pandas = pandas.read_parquet(tmp_path / "rows").sort_values("variant")
    assert arrow.Table.from_pandas(by_pandas, preserve_index=False).to_pydict() == wanted
    by_polars = polars.scan_parquet(tmp_path / "rows" / "*.parquet").sort("variant").collect()
    assert by_polars.to_dict(as_series=False) == wanted
    found = duckdb.sql(f"select * from '{tmp_path}/rows/*.parquet' order by variant")
    assert dict(zip(found.columns, map(list, zip(*found.fetchall(), strict=True)), strict=True)) == wanted


def test_a_sweep_that_is_there_is_not_begun_again(address: str) -> None:
    filled(address, range(2))
    with pytest.raises(FileError, match=r"holds a sweep already, 2 of 4 chunks: go on with --resume"):
        Store(address).begin(MANIFEST)


@pytest.mark.parametrize(
    ("other", "said"),
    [
        (
            {"study": 'title = "ten of three"\nseed = 1\n', "digest": "cd" * 32},
            "another study, which differs from line 2",
        ),
        ({"digest": "cd" * 32}, "machine or another file that it reads was changed"),
        ({"version": "0.0.9"}, r"begun with feeddrive 0\.1.*this is 0\.0\.9"),
        ({"chunk": 5}, "chunks of 3, and 10 in chunks of 5"),
    ],
)
def test_another_study_is_refused(tmp_path: Path, other: dict[str, object], said: str) -> None:
    filled(tmp_path, range(2))
    before = contents(tmp_path)
    with pytest.raises(FileError, match=said):
        Store(tmp_path).begin(replace(MANIFEST, **other), resume=True)
    assert contents(tmp_path) == before


def foreign_file(folder: Path) -> None:
    (folder / "manifest.json").unlink()


def no_json(folder: Path) -> None:
    (folder / "manifest.json").write_text("{")


def other_program(folder: Path) -> None:
    (folder / "manifest.json").write_text('{"kind": "web extension", "version": 3}')


def nested(folder: Path) -> None:
    (folder / "manifest.json").write_text("[" * 100_000)


def wrong_type(folder: Path) -> None:
    found = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps({**found, "count": "many"}))


def cut_off(folder: Path) -> None:
    file = folder / "rows" / "chunk_00000001.parquet"
    file.write_bytes(file.read_bytes()[:-20])


def one_bit(folder: Path) -> None:
    file = folder / "rows" / "chunk_00000001.parquet"
    content = bytearray(file.read_bytes())
    content[60] ^= 4
    file.write_bytes(bytes(content))


def empty(folder: Path) -> None:
    (folder / "rows" / "chunk_00000001.parquet").write_bytes(b"")


def of_another_study(folder: Path) -> None:
    (folder / "rows" / "chunk_00000001.parquet").write_bytes(chunk_bytes(rows(1), "cd" * 32))


def without_seal(folder: Path) -> None:
    (folder / "rows" / "chunk_00000001.parquet").write_bytes(of_before(1))


def of_another_chunk(folder: Path) -> None:
    (folder / "rows" / "chunk_00000001.parquet").write_bytes((folder / "rows" / "chunk_00000000.parquet").read_bytes())


def stranger(folder: Path) -> None:
    (folder / "rows" / "old.parquet").write_bytes(b"")


def beyond(folder: Path) -> None:
    (folder / "rows" / "chunk_00000004.parquet").write_bytes(b"")


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (foreign_file, r"holds 'rows', which is not of a sweep: choose another directory"),
        (no_json, r"manifest\.json: is damaged or not that of a sweep"),
        (other_program, r"manifest\.json: is damaged or not that of a sweep \(it is of another program\)"),
        (nested, r"manifest\.json: is damaged or not that of a sweep"),
        (wrong_type, r"manifest\.json: .*count must be of type int, not 'many'"),
        (cut_off, r"rows/chunk_00000001\.parquet: it is damaged .*move it away, then go on with --resume"),
        (one_bit, r"rows/chunk_00000001\.parquet: it is damaged"),
        (empty, r"rows/chunk_00000001\.parquet: it is damaged"),
        (without_seal, r"rows/chunk_00000001\.parquet: it is damaged \(its SHA-256 is missing\)"),
        (of_another_study, r"rows/chunk_00000001\.parquet: it is of another study"),
        (of_another_chunk, r"rows/chunk_00000001\.parquet: its rows are not those of the variants 3 to 5"),
        (stranger, r"rows/old\.parquet: is no chunk of this sweep"),
        (beyond, r"rows/chunk_00000004\.parquet: is no chunk of this sweep"),
    ],
)
def test_damage_is_named_and_nothing_is_overwritten(tmp_path: Path, damage: Callable[[Path], None], said: str) -> None:
    filled(tmp_path)
    damage(tmp_path)
    before = contents(tmp_path)
    with pytest.raises(FileError, match=said):
        Store(tmp_path).begin(MANIFEST, resume=True)
    assert contents(tmp_path) == before


def flipped(content: bytes, seed: int, many: int) -> Iterator[bytes]:
    """The same bytes with one bit changed, drawn."""
    for bit in np.random.default_rng(seed).integers(8 * len(content), size=many).tolist():
        damaged = bytearray(content)
        damaged[bit // 8] ^= 1 << bit % 8
        yield bytes(damaged)


def test_every_changed_bit_of_a_chunk_is_found(tmp_path: Path, seeded: Seeded) -> None:
    """Of 1,500, some 36 gave other rows and 7 a UnicodeDecodeError: page checksums do not cover the footer."""
    store, file = filled(tmp_path), tmp_path / "rows" / "chunk_00000001.parquet"
    for damaged in flipped(file.read_bytes(), seeded(11), 1500):
        file.write_bytes(damaged)
        with pytest.raises(FileError, match=r"it is damaged \(its SHA-256 .*move it away, then go on with --resume"):
            store.read(1)


def test_a_store_of_before_is_read_and_its_damage_is_no_traceback(tmp_path: Path, seeded: Seeded) -> None:
    """Its chunks have page checksums only: a changed name of a column is found by those of the chunks before it."""
    store, file = filled(tmp_path), tmp_path / "rows" / "chunk_00000001.parquet"
    said = json.loads((tmp_path / "manifest.json").read_text())
    del said["sealed"]
    (tmp_path / "manifest.json").write_text(json.dumps(said))
    for number in range(3):
        (tmp_path / "rows" / f"chunk_{number:08d}.parquet").write_bytes(of_before(number))
    store = Store(tmp_path)
    assert store.table().equals(everything())
    store.write(3, rows(3))  # goes on with sealed ones
    assert store.begin(MANIFEST, resume=True) == {0, 1, 2, 3}
    for damaged in flipped(of_before(1), seeded(12), 400):
        file.write_bytes(damaged)
        with contextlib.suppress(FileError):
            store.read(1)


def test_a_chunk_that_was_moved_away_is_missing_and_is_written_again(tmp_path: Path) -> None:
    filled(tmp_path)
    before = contents(tmp_path)
    (tmp_path / "rows" / "chunk_00000001.parquet").unlink()
    store = Store(tmp_path)
    assert store.begin(MANIFEST, resume=True) == {0, 2, 3}
    store.write(1, rows(1))
    assert contents(tmp_path) == before


def test_a_foreign_directory_is_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("")
    with pytest.raises(FileError, match=r"exists and holds 'thesis\.tex'"):
        Store(tmp_path).begin(MANIFEST)
    with pytest.raises(FileError, match=r"thesis\.tex: cannot be read: not a directory"):
        Store(tmp_path / "thesis.tex").begin(MANIFEST)
    assert list(contents(tmp_path)) == ["thesis.tex"]


def test_rows_of_another_chunk_are_not_written(tmp_path: Path) -> None:
    store = filled(tmp_path, range(1))
    with pytest.raises(ParameterError, match="chunk 2: its rows are not those of the variants 6 to 8"):
        store.write(2, rows(1))
    with pytest.raises(ParameterError, match="chunk 2: it has other columns"):
        store.write(2, rows(2).drop_columns(["reason"]))
    with pytest.raises(ParameterError, match="no column 'variant'"):
        store.write(2, rows(2).drop_columns(["variant"]))
    assert store.done() == {0}


def test_no_rows_yet(tmp_path: Path) -> None:
    store = filled(tmp_path, range(0))
    with pytest.raises(FileError, match="holds no rows yet"):
        store.table()
    with pytest.raises(FileError, match=r"manifest\.json: cannot be read: no such file"):
        Store(tmp_path / "nowhere").table()


def test_an_address_that_cannot_be_opened_is_named() -> None:
    with pytest.raises(FileError, match="nosuch://place: cannot be opened: Protocol not known: nosuch"):
        Store("nosuch://place")


def test_a_full_disk_is_named_and_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = filled(tmp_path, range(1))
    before = contents(tmp_path)

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(atomic_io, "_flush", full)
    with pytest.raises(FileError, match=r"chunk_00000001\.parquet: cannot be written: no space left.*--resume"):
        store.write(1, rows(1))
    assert contents(tmp_path) == before


def test_a_remote_that_fails_leaves_nothing_and_the_older_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    address = f"memory://{tmp_path}"
    store = filled(address, range(2))
    files = fsspec.filesystem("memory")

    def fails(*_: object, **__: object) -> None:
        raise ConnectionError("the bucket is gone")

    with monkeypatch.context() as patch:
        patch.setattr(type(files), "mv", fails)
        with pytest.raises(
            FileError, match=r"rows/chunk_00000002\.parquet: cannot be written: the bucket is gone; then"
        ):
            store.write(2, rows(2))
    assert sorted(each.rpartition("/")[2] for each in files.find(str(tmp_path))) == [
        "chunk_00000000.parquet",
        "chunk_00000001.parquet",
        "manifest.json",
    ]


def test_a_writer_that_is_killed_leaves_only_whole_chunks(tmp_path: Path) -> None:
    """SIGKILL amid writing, twice."""
    writer = textwrap.dedent(
        """
        import sys
        import pyarrow as arrow
        from feeddrive.study.store import Manifest, Store
        manifest = Manifest(study="", digest="", count=4000, chunk=4)
        store = Store(sys.argv[1])
        done = store.begin(manifest, resume=True)
        print("begun", flush=True)
        for number in range(manifest.chunks):
            if number not in done:
                store.write(number, arrow.table({"variant": arrow.array(manifest.rows(number), arrow.int64())}))
                if number == max(done, default=0) + 20:
                    print("some", flush=True)
        """
    )
    manifest = Manifest(study="", digest="", count=4000, chunk=4)
    for _ in range(2):
        with subprocess.Popen([sys.executable, "-c", writer, str(tmp_path)], stdout=subprocess.PIPE) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == b"begun\n"
            assert process.stdout.readline() == b"some\n"
            process.send_signal(signal.SIGKILL)
    done = Store(tmp_path).begin(manifest, resume=True)  # reads each file, and would refuse half of one
    assert 40 <= len(done) < manifest.chunks

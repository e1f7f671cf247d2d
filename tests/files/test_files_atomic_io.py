"""Files and directories are written whole or not at all."""

from __future__ import annotations

import errno
import os
import resource
import signal
from pathlib import Path

import pytest

from feeddrive.files import atomic_io
from feeddrive.files.atomic_io import check_directory, new_directory, read_whole, write_whole, written_whole
from feeddrive.language.errors import FileError


def listing(folder: Path) -> list[str]:
    return sorted(str(file.relative_to(folder)) for file in folder.rglob("*"))


def interrupt(file: Path, interruption: type[BaseException]) -> None:
    file.write_text("half")
    raise interruption


def test_a_file_is_written_and_read_back(tmp_path: Path) -> None:
    write_whole(tmp_path / "a.txt", "μm\n")
    assert read_whole(tmp_path / "a.txt", 100) == "μm\n".encode()
    write_whole(tmp_path / "a.txt", b"\x00")
    assert read_whole(tmp_path / "a.txt", 100) == b"\x00"
    assert listing(tmp_path) == ["a.txt"]


def test_permissions_are_those_of_a_plain_file_or_of_the_older_one(tmp_path: Path) -> None:
    (tmp_path / "plain").write_text("")
    write_whole(tmp_path / "new", "")
    assert (tmp_path / "new").stat().st_mode == (tmp_path / "plain").stat().st_mode
    (tmp_path / "new").chmod(0o640)
    write_whole(tmp_path / "new", "again")
    assert (tmp_path / "new").stat().st_mode & 0o777 == 0o640


def test_a_link_is_followed(tmp_path: Path) -> None:
    (tmp_path / "real").write_text("old")
    (tmp_path / "link").symlink_to(tmp_path / "real")
    write_whole(tmp_path / "link", "new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real").read_text() == "new"


@pytest.mark.parametrize("interruption", [KeyboardInterrupt, RuntimeError, MemoryError])
def test_an_interrupted_write_leaves_the_old_file(tmp_path: Path, interruption: type[BaseException]) -> None:
    (tmp_path / "a").write_text("old")
    with pytest.raises(interruption), written_whole(tmp_path / "a") as temporary:
        interrupt(temporary, interruption)
    assert listing(tmp_path) == ["a"]
    assert (tmp_path / "a").read_text() == "old"


def test_what_cannot_be_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"missing/a: cannot be written: no such file or directory; check the name"):
        write_whole(tmp_path / "missing" / "a", "")
    with pytest.raises(FileError, match=r"cannot be written: is a directory"):
        write_whole(tmp_path, "")
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError, match=r"file/a: cannot be written: .*a part of its path is a file"):
        write_whole(tmp_path / "file" / "a", "")
    with pytest.raises(FileError, match=r"file name too long; choose a shorter name"):
        write_whole(tmp_path / ("x" * 300), "")
    for name in ("a\0b", "\ud800"):
        with pytest.raises(FileError, match="is not a file name"):
            write_whole(name, "")
        with pytest.raises(FileError, match="is not a file name"):
            read_whole(name, 1)
    assert listing(tmp_path) == ["file"]


def test_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The disk fills up at the last moment, when the file is flushed."""

    def full(handle: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(atomic_io.os, "fsync", full)
    with pytest.raises(FileError, match=r"a: cannot be written: no space left on device; free some space"):
        write_whole(tmp_path / "a", "content")
    assert listing(tmp_path) == []


def test_a_file_larger_than_the_system_allows(tmp_path: Path) -> None:
    """A real refusal by the system: the limit of the file size, with its signal ignored, fails a write half-way."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, hard))
        with pytest.raises(FileError, match=r"a: cannot be written: file too large"):
            write_whole(tmp_path / "a", b"x" * 100_000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, before)
    assert listing(tmp_path) == []


def test_what_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"nothing: cannot be read: no such file or directory; check the name"):
        read_whole(tmp_path / "nothing", 10)
    with pytest.raises(FileError, match="is a directory"):
        read_whole(tmp_path, 10)
    with pytest.raises(FileError, match="is a device or pipe"):
        read_whole("/dev/zero", 10)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(FileError, match="is a device or pipe"):
        read_whole(tmp_path / "pipe", 10)
    (tmp_path / "long").write_bytes(b"x" * 2_000_000)
    with pytest.raises(FileError, match=r"has 2\.0 MB, more than the 1\.0 MB that are read"):
        read_whole(tmp_path / "long", 1_000_000)


def test_a_directory_appears_at_the_end(tmp_path: Path) -> None:
    with new_directory(tmp_path / "a" / "b" / "out") as folder:
        (folder / "summary.json").write_text("{}")
        (folder / "runs").mkdir()
        (folder / "runs" / "x.csv").write_text("1")
        assert not (tmp_path / "a" / "b" / "out").exists()
    assert listing(tmp_path / "a" / "b") == ["out", "out/.feeddrive", "out/runs", "out/runs/x.csv", "out/summary.json"]


def test_an_own_directory_is_replaced_a_foreign_one_is_not(tmp_path: Path) -> None:
    out = tmp_path / "out"
    for content in ("first", "second"):
        with new_directory(out) as folder:
            (folder / content).write_text(content)
    assert listing(out) == [".feeddrive", "second"]
    (out / "notes.txt").write_text("mine")
    with pytest.raises(FileError, match=r"out: holds 'notes\.txt', which feeddrive did not write"), new_directory(out):
        pytest.fail("the work must not start")
    (tmp_path / "home").mkdir()
    with new_directory(tmp_path / "home") as folder:  # empty, so there is nothing to lose
        (folder / "x").write_text("")
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign" / "thesis.tex").write_text("")
    with pytest.raises(FileError, match="was not written by feeddrive"), new_directory(tmp_path / "foreign"):
        pytest.fail("the work must not start")
    with pytest.raises(FileError, match="is a file, not a directory"), new_directory(out / "second"):
        pytest.fail("the work must not start")
    (tmp_path / "link").symlink_to(out)
    with pytest.raises(FileError, match="is a symbolic link"), new_directory(tmp_path / "link"):
        pytest.fail("the work must not start")
    assert listing(tmp_path / "foreign") == ["thesis.tex"]


def test_a_place_for_a_directory_is_checked_without_touching_it(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "x").write_text("mine")
    (tmp_path / "link").symlink_to(tmp_path / "mine")
    with new_directory(tmp_path / "ours") as folder:
        (folder / "report.html").write_text("old")
    before = listing(tmp_path)
    check_directory(tmp_path / "ours")
    check_directory(tmp_path / "new" / "and" / "deep")
    for name, reason in (
        ("file", "is a file"),
        ("mine", "was not written by feeddrive"),
        ("link", "symbolic link"),
        ("file/below", "a directory|a part of its path"),
    ):
        with pytest.raises(FileError, match=reason):
            check_directory(tmp_path / name)
    assert listing(tmp_path) == before


@pytest.mark.parametrize("marker", ["", "[]", "{}", '{"files": 3}', '{"files": [[]]}', "\ud800"])
def test_a_damaged_marker_protects_the_directory(tmp_path: Path, marker: str) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / ".feeddrive").write_bytes(marker.encode("utf-8", "surrogatepass"))
    with pytest.raises(FileError, match="was not written by feeddrive"), new_directory(tmp_path / "out"):
        pytest.fail("the work must not start")


@pytest.mark.parametrize("interruption", [KeyboardInterrupt, SystemExit, ValueError])
def test_an_interrupted_directory_leaves_nothing(tmp_path: Path, interruption: type[BaseException]) -> None:
    with pytest.raises(interruption), new_directory(tmp_path / "a" / "out") as folder:
        interrupt(folder / "half", interruption)
    assert listing(tmp_path) == []
    with new_directory(tmp_path / "out") as folder:
        (folder / "old").write_text("")
    with pytest.raises(interruption), new_directory(tmp_path / "out") as folder:
        interrupt(folder / "half", interruption)
    assert listing(tmp_path) == ["out", "out/.feeddrive", "out/old"]


def test_a_file_of_a_directory_that_cannot_be_written_is_named_as_it_would_be(tmp_path: Path) -> None:
    with pytest.raises(FileError) as caught, new_directory(tmp_path / "out") as folder:
        raise FileError(f"{folder / 'setpoints.parquet'}: cannot be written: no space left on device")
    assert str(caught.value) == f"{tmp_path / 'out' / 'setpoints.parquet'}: cannot be written: no space left on device"
    assert listing(tmp_path) == []


def test_a_failing_rename_brings_the_old_directory_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with new_directory(tmp_path / "out") as folder:
        (folder / "old").write_text("")
    rename = Path.rename

    def refuse_new(self: Path, target: Path) -> Path:
        if self.name.endswith(".part"):
            raise OSError(errno.EACCES, os.strerror(errno.EACCES))
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", refuse_new)
    with pytest.raises(FileError, match="permission denied"), new_directory(tmp_path / "out") as folder:
        (folder / "new").write_text("")
    monkeypatch.undo()
    assert listing(tmp_path) == ["out", "out/.feeddrive", "out/old"]


def test_an_error_of_the_system_names_the_file_by_its_later_name(tmp_path: Path) -> None:
    with (
        pytest.raises(FileError, match=r"out/none/x: cannot be written: no such file"),
        new_directory(tmp_path / "out") as folder,
    ):
        (folder / "none" / "x").write_text("")
    (tmp_path / "file").write_text("")
    with (
        pytest.raises(FileError, match=r"file: cannot be .*part of its path is a file"),
        new_directory(tmp_path / "file" / "out"),
    ):
        pytest.fail("the work must not start")
    assert listing(tmp_path) == ["file"]

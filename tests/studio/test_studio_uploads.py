"""Files that are brought: their names stay in the folder, and their size is limited while they arrive."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path, PureWindowsPath

import pytest
from hypothesis import given
from hypothesis import strategies as st

from feeddrive.language.errors import FileError
from feeddrive.studio import uploads


async def pieces(size: int, count: int) -> AsyncIterator[bytes]:
    for _ in range(count):
        yield b"x" * size


def kept(name: str, folder: Path, size: int = 10, count: int = 3, promised: int | None = None) -> Path:
    return asyncio.run(uploads.keep(name, pieces(size, count), folder, promised))


@pytest.mark.parametrize("name", ["run 1 (cold).csv", "Maß-µ.mat", "a.toml"])
def test_a_file_is_kept_under_its_name(tmp_path: Path, name: str) -> None:
    path = kept(name, tmp_path / "brought")
    assert path == tmp_path / "brought" / name
    assert path.stat().st_size == 30


@pytest.mark.parametrize(
    "name",
    [
        "",
        "../a.csv",
        "..",
        "a/b.csv",
        "a\\b.csv",
        "/etc/passwd",
        ".feeddrive",
        "C:a.csv",
        "nul",
        "con.csv",
        "con .csv",
        "COM¹.csv",
        "lpt9 .tar.gz",
        "a\\..\\b.csv",
        "a.csv:hidden",
        "\\\\host\\a.csv",
        "a\x1b[2J.csv",
        "<b>.csv",
        "a\n.csv",
        "a.csv.",
        "x" * 121,
        "-rf",
    ],
)
def test_no_name_leaves_the_folder(tmp_path: Path, name: str) -> None:
    with pytest.raises(FileError, match="is no name for a file here"):
        kept(name, tmp_path / "brought")
    assert not list(tmp_path.rglob("*.csv"))


@given(st.text(st.characters(exclude_categories=["Cs"]), max_size=12) | st.from_regex(uploads._NAME, fullmatch=True))
def test_a_name_that_is_kept_is_one_of_a_file_in_the_folder_on_windows_too(name: str) -> None:
    """What Windows would take for a drive, a folder, a stream or a device, or would write under another name."""
    try:
        kept = uploads.safe_name(name)
    except FileError:
        return
    folder = PureWindowsPath("C:\\studio")
    assert (folder / kept).parent == folder
    assert (folder / kept).name == kept
    assert not PureWindowsPath(kept).drive
    assert not PureWindowsPath(kept).is_reserved()
    assert not set(kept) & set('<>:"/\\|?*')
    for each in (kept, f"identified_{uploads.stem_of(kept)}"):
        assert each == each.rstrip(" .")


@pytest.mark.parametrize("promised", [None, 3_001])
def test_what_is_too_large_is_refused_and_nothing_of_it_stays(
    tmp_path: Path, promised: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(uploads, "LARGEST", 3_000)
    with pytest.raises(FileError, match="is larger than"):
        kept("a.csv", tmp_path, 1_000, 4, promised)
    assert not list(tmp_path.iterdir())
    assert kept("a.csv", tmp_path, 1_000, 3).stat().st_size == 3_000


def test_there_are_not_too_many_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(uploads, "MANY", 2)
    assert kept("a.csv", tmp_path) == tmp_path / "a.csv"
    assert kept("a.csv", tmp_path) == tmp_path / "2" / "a.csv"  # nothing is replaced: each one counts
    for name in ("a.csv", "b.csv"):
        with pytest.raises(FileError, match="2 files were brought already"):
            kept(name, tmp_path)

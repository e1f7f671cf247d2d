"""Prepared kernels: bitcode gives the machine code of the text, and what does not fit is not used."""

from __future__ import annotations

from pathlib import Path

import pytest

import feeddrive
from feeddrive.language.kernels import kernel
from feeddrive.language.kernels.kernel import QUICK, Unit, unit_of
from feeddrive.language.kernels.prepared import prepare
from feeddrive.language.machine_code import bitcode_of
from feeddrive.path.geometry.hermite import hermite


def made(folder: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[dict[str, bytes], int]:
    """The machine code of a small file of kernels without a cache, and how often its text was printed."""
    folder.mkdir(mode=0o700)
    monkeypatch.setenv("FEEDDRIVE_CACHE", str(folder))
    unit, printed = Unit(unit_of(hermite.source).sources), list[str]()
    below = [each.code for each in unit.units[:-1]]
    # the files that it calls are compiled elsewhere: only its own machine code is compared
    for path in folder.glob("*.o"):
        path.unlink()
    text = unit.text
    monkeypatch.setattr(unit, "text", lambda *given: printed.append("") or text(*given))
    assert unit.code.below == tuple(below)
    return {path.name: path.read_bytes() for path in folder.glob("*.o")}, len(printed)


def test_bitcode_gives_the_machine_code_of_the_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    unit = unit_of(hermite.source)
    monkeypatch.setattr(kernel, "BITCODE", tmp_path / "bitcode")
    from_text, printed = made(tmp_path / "text", monkeypatch)
    assert printed == 1
    assert len(from_text) == 1
    kernel.BITCODE.mkdir()
    file = kernel.BITCODE / f"{unit.key}.bc"
    file.write_bytes(bitcode_of(unit.text(QUICK), QUICK.passes))
    assert made(tmp_path / "prepared", monkeypatch) == (from_text, 0)
    # as of a newer version of LLVM, or cut off
    file.write_bytes(file.read_bytes()[:200])
    assert made(tmp_path / "damaged", monkeypatch) == (from_text, 1)


def test_all_kernels_of_the_package_are_prepared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernel, "BITCODE", tmp_path)
    (tmp_path / "former.bc").touch()
    size = prepare()
    files = [path for path in tmp_path.iterdir() if path.stat().st_size > 1000]
    sources = [path.read_text(encoding="utf-8") for path in Path(feeddrive.__file__).parent.rglob("*.py")]
    assert len(files) == len(list(tmp_path.iterdir())) == sum("\n@kernel" in each for each in sources) > 10
    assert size == sum(path.stat().st_size for path in files)
    assert tmp_path / f"{unit_of(hermite.source).key}.bc" in files

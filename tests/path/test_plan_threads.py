"""A program that is planned on several threads: the same parts, pauses and errors as on one."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from paths import LIMITS

import feeddrive as fd
from feeddrive.language.errors import ProgramError
from feeddrive.path import setpoints
from feeddrive.path.motion import Pause
from feeddrive.path.program.reading import read_program
from feeddrive.path.setpoints import planned


def text(lines: int) -> str:
    """Chords, corners in time, arcs and stops by dwells, of 1 mm each; line k + 2 of the file is move k."""
    draw, blocks = np.random.default_rng(1), ["G21 G90 G64 P0.01 F6000"]
    x = y = heading = 0.0
    for k in range(lines):
        heading += draw.choice([0.05, 0.6]) * draw.normal()
        x, y = x + np.cos(heading), y + np.sin(heading)
        arc = k % 7 == 3
        blocks.append(f"G{2 if arc else 1} X{x:.4f} Y{y:.4f}{' R4' if arc else ''}")
        if k % 97 == 96:
            blocks.append("G4 P0.1")
    return "\n".join([*blocks, "M2", ""])


def everything(path: Path, threads: int) -> tuple[list[bytes], str]:
    """All numbers of the plan, and the error that ends it."""
    found = list[bytes]()
    try:
        for part in planned(read_program(path), "XYZ", LIMITS, threads=threads):
            if isinstance(part, Pause):
                found.append(repr(part).encode())
                continue
            arrays = [*part.pieces, *part.motion, *(part.lines or ())]
            arrays += [*part.entering.pieces, *part.entering.motion] if part.entering else []
            found.append(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays) + part.mode.encode())
    except ProgramError as error:
        return found, str(error)
    return found, ""


@pytest.fixture
def short_chains(monkeypatch: pytest.MonkeyPatch) -> None:
    """Threads from 20 segments on, chains of 80: a short program has all that a long one has."""
    monkeypatch.setattr(setpoints, "LONG", 20)
    monkeypatch.setattr("feeddrive.path.geometry.segments.AT_ONCE", 80)


@pytest.mark.usefixtures("short_chains")
def test_a_plan_does_not_depend_on_the_number_of_threads(tmp_path: Path) -> None:
    """Chains from rest to rest, which workers plan, and one that is longer than what is planned at once."""
    before = set(threading.enumerate())  # those of other tests, too
    path = tmp_path / "part.ngc"
    path.write_text(text(130) + text(200).replace("G4 P0.1\n", ""), encoding="utf-8")
    path.write_text(path.read_text(encoding="utf-8").replace("M2\n", "", 1), encoding="utf-8")
    one = everything(path, 1)
    assert len(one[0]) > 10
    assert one == everything(path, 3)
    assert not set(threading.enumerate()) - before


@pytest.mark.usefixtures("short_chains")
@pytest.mark.parametrize("line", [3, 60, 110])
def test_an_error_comes_behind_the_same_parts_and_names_its_line(line: int, tmp_path: Path) -> None:
    path = tmp_path / "part.ngc"
    blocks = text(120).split("\n")
    blocks[line - 1] = "G1 X1 Q?"
    path.write_text("\n".join(blocks), encoding="utf-8")
    one = everything(path, 1)
    assert f"line {line}, " in one[1]
    assert one == everything(path, 2)


@pytest.mark.usefixtures("short_chains")
def test_ctrl_c_ends_the_threads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whether it comes while the program is read or while setpoints are written."""
    before = set(threading.enumerate())  # those of other tests, too
    path = tmp_path / "part.ngc"
    path.write_text(text(150), encoding="utf-8")
    counted = setpoints.Setpoints._counted

    def stopped(self: setpoints.Setpoints) -> Iterator[object]:
        for number, move in enumerate(counted(self)):
            if number == 100:
                raise KeyboardInterrupt
            yield move

    with monkeypatch.context() as patch:
        patch.setattr(setpoints.Setpoints, "_counted", stopped)
        with pytest.raises(KeyboardInterrupt):
            fd.workflow.plan(path, machine="mill", threads=2)
    assert not set(threading.enumerate()) - before

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("feeddrive.path.planned.Recorder.add", interrupted)
    with pytest.raises(KeyboardInterrupt):
        fd.workflow.plan(path, machine="mill", threads=2)
    assert not set(threading.enumerate()) - before

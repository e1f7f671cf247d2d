"""docs/internals/house.md: what it names exists, its rooms are the folders, functions of a walk call each other."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
import sys
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from types import FrameType

import numpy as np
import pytest

import feeddrive as fd
import no_pictures

SOURCE = Path(fd.__file__).parent
ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "docs" / "internals" / "house.md").read_text(encoding="utf-8")


def place(name: str) -> Path:
    return ROOT / name if name.startswith("docs/") else SOURCE / name


def test_files_and_folders_exist() -> None:
    files = set(re.findall(r"`([\w/]+(?:\.py|/))`", TEXT)) - {"src/feeddrive/"}
    assert len(files) > 30
    assert [name for name in files if not place(name).exists()] == []


def test_functions_and_classes_stand_in_the_files() -> None:
    named = re.findall(r"`([\w/]+\.py)`\s`([\w.]+)`", TEXT)
    assert len(named) > 12
    for file, name in named:
        body = ast.parse(place(file).read_text(encoding="utf-8")).body
        for part in name.split("."):
            found = [each for each in body if isinstance(each, (ast.FunctionDef, ast.ClassDef)) and each.name == part]
            assert found, (file, name)
            body = found[0].body


def test_the_rooms_are_the_folders() -> None:
    rows = [line.split("|")[1] for line in TEXT.splitlines() if line.startswith("| `")]
    rooms = {room for row in rows for room in re.findall(r"`(\w+)/`", row)}
    assert rooms == {path.name for path in SOURCE.iterdir() if (path / "__init__.py").exists()}


Step = tuple[str, str]  # file, function


def called(run: Callable[[], object], callees: set[Step], patch: pytest.MonkeyPatch) -> set[tuple[Step, Step]]:
    """(caller, callee) of some functions while something runs; a caller is any function on the stack of the call."""
    pairs: set[tuple[Step, Step]] = set()

    def watched(callee: Step, function: Callable[..., object]) -> Callable[..., object]:
        @wraps(function)
        def look(*args: object, **words: object) -> object:
            frame: FrameType | None = sys._getframe(1)  # pyright: ignore[reportPrivateUsage]
            while frame:
                file = Path(frame.f_code.co_filename)
                if file.is_relative_to(SOURCE):
                    pairs.add(((file.relative_to(SOURCE).as_posix(), frame.f_code.co_qualname), callee))
                frame = frame.f_back
            return function(*args, **words)

        return look

    for file, name in callees:
        module = importlib.import_module("feeddrive." + file.removesuffix(".py").replace("/", "."))
        *inside, last = name.split(".")
        owner = getattr(module, inside[0]) if inside else module
        found = inspect.getattr_static(owner, last)
        if isinstance(found, classmethod):
            patch.setattr(owner, last, classmethod(watched((file, name), found.__func__)))
            continue
        modules = [module for key, module in sys.modules.items() if key.startswith("feeddrive")]
        for each in [owner] if inside else modules:  # also under another name
            for key in [key for key, value in vars(each).items() if value is found]:
                patch.setattr(each, key, watched((file, name), found))
    run()
    return pairs


def export_kv(folder: Path) -> None:
    from feeddrive.workflow.export import export

    export("ball_screw", target="c", out=folder / "out")


def identify_mass(folder: Path) -> None:
    from feeddrive.workflow.identify import identify

    loop = fd.read_machine("emps").loop("x")
    run = fd.simulate(loop, fd.blocks.Polynomial7(distance=0.1, travel_time=1.0, back=True), record=_RECORDED)
    columns = np.column_stack([run.time, *(run[name] for name in _RECORDED)])
    np.savetxt(folder / "log.csv", columns, delimiter=",", header="time_s,position_m,force_N", comments="")
    identify(folder / "log.csv", machine="emps", out=folder / "out")


_RECORDED = ["reading_load", "force"]


def follow_a_law(_: Path) -> None:
    from feeddrive.files.machine import MachineSection
    from feeddrive.files.schema import schema_of
    from feeddrive.tuning.candidates import candidates

    loop = fd.read_machine("linear_motor").loop("x")
    law = fd.blocks.CascadePPI(Kv=50.0, Kp=8000.0, velocity_samples=11)  # a structure that no other test has traced
    loop = fd.Loop(control=fd.Control(law=law), axis=loop.axis, sample_time=loop.sample_time)
    move = fd.blocks.Polynomial7(distance=1e-3, travel_time=0.02)
    fd.simulate(loop, move)
    fd.linearize(loop, ["cut"], ["force"])
    fd.gradient(loop, move, ["axis.x.control.law.Kv"])
    candidates(loop)
    schema_of(MachineSection, "machine")


def plan_circle(folder: Path) -> None:
    from feeddrive.workflow.plan import plan

    program = folder / "circle.ngc"
    program.write_text("G21 G64 P0.01 F2000\nG1 X10\nG2 X30 I10\nG1 X40 Y5\nM2\n")
    plan(program, machine="gantry", out=folder / "out")


def tune_axis(folder: Path) -> None:
    from feeddrive.workflow.tune import tune

    tune("linear_motor", starts=1, out=folder / "out")


WALKS = [
    ("Kv from", export_kv),
    ("A log column", identify_mass),
    ("A new law", follow_a_law),
    ("A part program", plan_circle),
    ("A goal", tune_axis),
]


def test_a_wing_has_a_walk_and_a_room_a_wing() -> None:
    rows = [line for line in TEXT.splitlines() if line.startswith("| ") and line.count("|") == 4]
    wings = [line.split("|") for line in rows if "`" in line.split("|")[2]]
    heads = re.findall(r"^### (.+)", TEXT, re.M)
    for *_, walk, _ in wings:
        assert any(head.startswith(walk.strip()) for head in heads), walk
    assert len(wings) == len(WALKS)
    rooms = [room for _, _, named, *_ in wings for room in re.findall(r"`(\w+)/`", named)]
    assert len(rooms) == len(set(rooms))
    assert set(rooms) == {path.name for path in SOURCE.iterdir() if (path / "__init__.py").exists()}


@pytest.mark.parametrize(("title", "run"), WALKS)
def test_on_a_walk_each_function_calls_the_next(
    title: str, run: Callable[[Path], object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    walk = next(part for part in re.split(r"^#+ ", TEXT, flags=re.M) if part.startswith(title))
    name = r"`([\w/]+\.py)`\s`([\w.]+)`"
    arrows = [
        ((file, function), (other, callee))
        for file, function, other, callee in re.findall(rf"{name}(?=\s→\s{name})", walk)
    ]
    assert len(arrows) >= 5
    if not any(function == "svg" for arrow in arrows for _, function in arrow):
        monkeypatch.setattr(no_pictures.DRAWN_BY, no_pictures.empty)
    pairs = called(lambda: run(tmp_path), {callee for _, callee in arrows}, monkeypatch)
    assert [arrow for arrow in arrows if arrow not in pairs] == []

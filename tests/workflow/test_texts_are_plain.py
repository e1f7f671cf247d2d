"""No mark of a quantity reaches a person: in all texts of results, in what commands show, and in what they write."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import pytest

import feeddrive as fd
from feeddrive.workflow.command import load

MARKS = "\ue000\ue001\ue002"
ASKED: dict[str, dict[str, Any]] = {
    "certify": {"source": "ball_screw"},
    "check": {},
    "circle": {"sources": (Path("xy_table"),), "radius": 0.02},
    "excite": {"machine": "ball_screw", "band": "5..500", "amplitude": 100.0},
    "force": {"signal": "percent", "column": "trq", "rated": "3.2:Nm", "lead": 0.01},
    "adjust": {"machine": "ball_screw", "set": ("law.Kp=52000",)},
    "export": {"source": "ball_screw", "target": "c"},
    "plan": {"program": "", "machine": "xy_table"},
    "run": {"job": "emps"},
}


def texts(value: Any, name: str, seen: set[int], depth: int = 6) -> Iterator[tuple[str, str]]:
    """All texts that hang on a value, with where they hang."""
    if id(value) in seen or depth == 0:
        return
    seen.add(id(value))
    if isinstance(value, str):
        yield name, str(value)
    elif isinstance(value, dict):
        for key, entry in value.items():
            yield from texts(entry, f"{name}[{key!r}]", seen, depth - 1)
    elif isinstance(value, list | tuple):
        for i, entry in enumerate(value):
            yield from texts(entry, f"{name}[{i}]", seen, depth - 1)
    elif is_dataclass(value):
        for field in fields(value):
            yield from texts(getattr(value, field.name), f"{name}.{field.name}", seen, depth - 1)


@pytest.mark.pictures
@pytest.mark.parametrize("command", ASKED)
def test_no_mark_is_in_a_result_or_in_a_file(command: str, tmp_path: Path) -> None:
    asked = dict(ASKED[command])
    if command == "check":
        fd.certify("ball_screw", out=tmp_path / "certified")
        asked["file"] = tmp_path / "certified" / "certificate.json"
    if command == "plan":
        asked["program"] = tmp_path / "part.ngc"
        asked["program"].write_text(
            "G21 G64 P0.01 F600\nG1 X10 Y10\nG2 X20 Y0 I0 J-10\nG1 X0 Y0\nM2\n", encoding="utf-8"
        )
    made = load(command)
    if any(field.name == "out" for field in fields(made.request)) and command not in ("check", "force"):
        asked["out"] = tmp_path / ("out.toml" if command == "adjust" else "out")
    outcome = made.run(made.request(**asked))
    marked = [name for name, text in texts(outcome, command, set()) if set(text) & set(MARKS)]
    assert not marked
    assert not set(repr(outcome)) & set(MARKS)
    files = [file for file in tmp_path.rglob("*") if file.is_file() and file.suffix not in (".parquet", ".zip", ".fmu")]
    assert not [file.name for file in files if any(mark in file.read_text("utf-8", "replace") for mark in MARKS)]

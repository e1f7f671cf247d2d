"""docs/house.md: every file, folder, function and class that it names exists; its rooms are the folders."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import feeddrive

SOURCE = Path(feeddrive.__file__).parent
DOCS = Path(__file__).parents[1] / "docs"
TEXT = (DOCS / "house.md").read_text(encoding="utf-8")


def place(name: str) -> Path:
    return DOCS.parent / name if name.startswith("docs/") else SOURCE / name


def test_files_and_folders_exist() -> None:
    files = set(re.findall(r"`([\w/]+(?:\.py|/))`", TEXT)) - {"src/feeddrive/"}
    assert len(files) > 30
    assert [name for name in files if not place(name).exists()] == []


def test_functions_and_classes_stand_in_the_files() -> None:
    named = re.findall(r"`([\w/]+\.py)`\s`(\w+)`", TEXT)
    assert len(named) > 12
    for file, name in named:
        tree = ast.parse(place(file).read_text(encoding="utf-8"))
        assert name in [each.name for each in tree.body if isinstance(each, (ast.FunctionDef, ast.ClassDef))], file


def test_the_rooms_are_the_folders() -> None:
    rows = [line.split("|")[1] for line in TEXT.splitlines() if line.startswith("| `")]
    rooms = {room for row in rows for room in re.findall(r"`(\w+)/`", row)}
    assert rooms == {path.name for path in SOURCE.iterdir() if (path / "__init__.py").exists()}

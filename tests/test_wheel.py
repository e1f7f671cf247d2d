"""What pip installs holds all that the package reads: templates, bundled machines, headers, stubs."""

from __future__ import annotations

from pathlib import Path

from hatchling.builders.wheel import WheelBuilder

import feeddrive

ROOT = Path(__file__).parents[1]
SOURCE = Path(feeddrive.__file__).parent


def test_a_wheel_holds_every_file_of_the_package() -> None:
    """The build backend lists what it would pack, without a build; `.gitignore` counts there."""
    packed = {Path(each.path).resolve() for each in WheelBuilder(str(ROOT)).recurse_included_files()}
    there = {path.resolve() for path in SOURCE.rglob("*") if path.is_file() and "__pycache__" not in path.parts}
    assert {path.suffix for path in there} >= {".py", ".pyi", ".toml", ".j2", ".html", ".css", ".h", ".c"}
    assert SOURCE / "py.typed" in there
    assert there - packed == set()

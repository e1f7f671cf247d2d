"""What pip installs holds all that the package reads: templates, bundled machines, headers, stubs."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest
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


@pytest.mark.parametrize(
    ("clone", "built", "needed"),
    [
        (True, True, True),
        (True, False, True),
        (False, False, True),
        (False, True, False),
    ],
)
def test_node_is_taken_as_a_package_wherever_the_page_is_built_and_the_machine_has_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, clone: bool, built: bool, needed: bool
) -> None:
    """In a clone the page is always built, since it may be older than its sources; a source distribution holds it."""
    monkeypatch.setenv("PATH", str(tmp_path))
    if clone:
        (tmp_path / ".git").touch()
    if built:
        (tmp_path / "src/feeddrive/studio/page").mkdir(parents=True)
        (tmp_path / "src/feeddrive/studio/page/index.html").touch()
    spec = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    assert spec is not None
    assert spec.loader is not None
    hatch_build = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hatch_build)
    hook = hatch_build.PageHook(str(tmp_path), {}, None, None, str(tmp_path), "wheel")
    assert bool(hook.dependencies()) == needed

"""`make release` refuses sources that are not those of the version, and names what to change."""

from __future__ import annotations

import json
import shutil
from datetime import date
from pathlib import Path

import pytest

import promised
import released

TODAY = date(2031, 4, 5)


@pytest.fixture
def sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Sources of version 7.8.9 that are ready, with a promise of few names."""
    monkeypatch.setattr(promised, "promised", lambda: {"names": ["feeddrive.tune"]})
    for name, text in {
        "src/feeddrive/version.py": '__version__ = "7.8.9"\n',
        "CITATION.cff": "title: x\nversion: 7.8.9\n",
        "CHANGELOG.md": "# Changes\n\n## 7.8.9, 2031-04-05\n\n- A change.\n\n## 7.8.8, 2031-01-01\n",
        "tests/promised.json": json.dumps({"version": "7.8.9", "names": ["feeddrive.tune"]}),
    }.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    return tmp_path


def test_ready_sources_are_released(sources: Path) -> None:
    assert released.unready("7.8.9", TODAY, sources) == []


@pytest.mark.parametrize(
    ("file", "text", "said"),
    [
        ("src/feeddrive/version.py", '__version__ = "7.8.8"\n', 'must say __version__ = "7.8.9"'),
        ("CITATION.cff", "version: 7.8.90\n", "must say version: 7.8.9"),
        ("CHANGELOG.md", "# Changes\n\n## 7.8.9, not released yet\n\n- A change.\n", "## 7.8.9, 2031-04-05"),
        ("CHANGELOG.md", "# Changes\n\n## 7.8.9, 2031-04-05\n\n## 7.8.8\n\n- A change.\n", "must have a section"),
        ("CHANGELOG.md", "## 7.8.9, 2031-04-05\n" + 40 * "- A change.\n", "has 41 lines, at most 40"),
        ("tests/promised.json", '{"version": "7.8.9", "names": []}', "is not what the code promises"),
    ],
)
def test_what_is_not_ready_is_named(sources: Path, file: str, text: str, said: str) -> None:
    (sources / file).write_text(text, encoding="utf-8")
    (problem,) = released.unready("7.8.9", TODAY, sources)
    assert problem.startswith(f"  {file}: ")
    assert said in problem


def test_another_version_needs_all_files(sources: Path) -> None:
    assert len(released.unready("8.0.0", TODAY, sources)) == 4
    shutil.rmtree(sources)

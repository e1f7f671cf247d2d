"""What a release promised to keep is still there, and a former name works until the version that removes it."""

from __future__ import annotations

import json
import sys
from types import ModuleType

import pytest

import promised
from feeddrive.language.lazy_package import make_lazy
from feeddrive.loop.loop import Loop


def test_nothing_is_lost_that_was_promised() -> None:
    """Written by `python tests/promised.py` at each release; what is removed before is announced first."""
    before = json.loads(promised.FILE.read_text(encoding="utf-8"))
    assert promised.lost(before, promised.promised()) == []


def test_a_lost_name_is_found() -> None:
    before = json.loads(promised.FILE.read_text(encoding="utf-8"))
    assert "feeddrive.tune" in before["names"]
    assert "tune --goal" in before["commands"]
    assert "outcome.verdict" in before["json"]
    now = {kind: [name for name in names if name not in ("tune --goal", "outcome.verdict")]
           for kind, names in before.items() if kind != "version"}  # fmt: skip
    assert promised.lost(before, now) == ["commands: tune --goal", "json: outcome.verdict"]


def test_a_former_name_works_and_warns(monkeypatch: pytest.MonkeyPatch) -> None:
    package = ModuleType("smith")
    monkeypatch.setitem(sys.modules, "smith", package)
    make_lazy("smith", {}, former={"Circuit": ("feeddrive.loop.Loop", "0.3")})
    with pytest.warns(DeprecationWarning, match=r"smith.Circuit is now feeddrive.loop.Loop; .* removed in 0.3"):
        assert package.Circuit is Loop
    assert "Circuit" not in dir(package)
    with pytest.raises(AttributeError):
        package.Circuits  # noqa: B018

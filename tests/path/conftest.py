"""What holds for the tests of paths."""

import pytest


@pytest.fixture(autouse=True)
def home(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """A home of its own: `rs274` keeps its tool table there, and two of them at once would empty each other's."""
    monkeypatch.setenv("HOME", str(tmp_path_factory.mktemp("home")))

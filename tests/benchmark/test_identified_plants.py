"""The plants of the benchmark that come from public data have the numbers that the data give."""

from __future__ import annotations

import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
DATA = ROOT.parent / "shared" / "data"


def script() -> ModuleType:
    """The module of `benchmarks/identified_plants.py`."""
    spec = spec_from_file_location("identified_plants", ROOT / "benchmarks" / "identified_plants.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow(reason="a measured response is fitted with one to five modes")
@pytest.mark.parametrize("number", [1, 2])
def test_the_stage_has_the_numbers_that_its_response_gives(number: int) -> None:
    module = script()
    if not (DATA / module.STAGE).is_file():
        pytest.skip(f"NOT TESTED on measured files: {module.STAGE} is not in ../shared/data")
    assert module.differences(DATA, number) == []


def test_without_the_data_the_command_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["identified_plants.py", "--data", str(tmp_path)])
    assert script().main() == 2
    assert "NOT RUN" in capsys.readouterr().err

"""The plants of the benchmark that come from public data have the numbers that the data give; others give none."""

from __future__ import annotations

import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import pytest

import feeddrive as fd
from feeddrive.language.errors import LogError

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


def test_the_records_of_the_lead_screw_do_not_tell_its_inertia() -> None:
    """The speed is the mean of a filter slower than the starts, and its ripple is that of the speed control."""
    module = script()
    if not (DATA / module.SCREW).is_dir():
        pytest.skip(f"NOT TESTED on measured files: {module.SCREW} is not in ../shared/data")
    lag, sample = module.lag_of_speed(DATA)
    # speeds are whole rpm: 1 of the 28 that are left after two rows are 3 % of the logarithm of 107/28
    assert lag == pytest.approx(0.030, rel=0.05)
    assert sample == pytest.approx(0.040, rel=1e-12)
    found = module.inertias_of_screw(DATA)
    inertias = [inertia for inertia, _ in found.values()]
    assert max(inertias) > 5.0 * min(inertias) > 0.0
    assert all(viscous < 0.0 for _, viscous in found.values())
    with pytest.raises(LogError, match="no column with a usual name for the position"):
        fd.identify(DATA / module.SCREW / "start_stop" / "200.csv", rotary=True, torque=f"{module.TORQUE}*-0.0984:mN m")


def test_the_slow_turns_of_the_motor_give_an_inertia_below_0() -> None:
    module = script()
    if not all((DATA / name).is_file() for name in module.MOTOR):
        pytest.skip(f"NOT TESTED on measured files: {module.MOTOR[0]} is not in ../shared/data")
    for cutoff in (10.0, 20.0, 40.0):
        assert all(inertia < 0.0 for inertia in module.inertias_of_motor(DATA, cutoff))


@pytest.mark.parametrize("asked", [(), ("--others",)])
def test_without_the_data_the_command_says_so(
    asked: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["identified_plants.py", *asked, "--data", str(tmp_path)])
    assert script().main() == 2
    assert "NOT RUN" in capsys.readouterr().err

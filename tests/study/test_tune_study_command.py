"""`feeddrive tune --study`: options that do not fit are refused; what is written, and that it can be read again."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import feeddrive as fd
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.workflow.tune import TuneRequest

STUDY = """job = "ball_screw"
sampler = "grid"
[specification]
sensitivity_peak = { most = 2 }
following_error_peak_m = { most_um = 100 }
[[vary]]
parameter = "axis.x.actuator.dead_time"
values_us = [50, 150]
"""


def test_a_machine_or_a_study() -> None:
    for given in ({}, {"source": "ball_screw", "study": "ball_screw_series"}):
        with pytest.raises(ParameterError, match="give either a machine or a response, or --study"):
            TuneRequest(**given)


@pytest.mark.parametrize(("option", "value"), [("axis", "x"), ("at", ("ball_screw",)), ("sample_time", 1e-3)])
def test_options_of_one_machine_do_not_go_with_a_study(option: str, value: object) -> None:
    with pytest.raises(ParameterError, match=f"--{option.replace('_', '-')} belongs to one machine or response"):
        TuneRequest(study="ball_screw_series", **{option: value})


@pytest.mark.slow(reason="a tuning over machines and 32 sweeps of one, 10 s")
def test_what_is_written_can_be_taken(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_text(STUDY, encoding="utf-8")
    found = fd.workflow.tune(study=path, filters="kept", starts=1, fresh=16, out=tmp_path / "out")
    written = {each.name for each in (tmp_path / "out").iterdir()}
    assert written >= {"control.toml", "machine.toml", "report.html", "summary.json"}
    machine = fd.read_machine(tmp_path / "out" / "machine.toml")
    for name, value in found.tuned.tunables.items():
        assert tree.get(machine.loop("x").control, name) == pytest.approx(value, rel=1e-6)
    numbers = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert numbers["yield"]["new"]["value"] == found.after.all.value
    assert numbers["yield"]["new"]["machines"] == 16
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "fresh machines that the tuner never saw" in page
    assert "Counted in the yield, but not kept by the tuner: following_error_peak_m" in page

"""`feeddrive tune --box`: what is written down of the box, and what is said where there is no model of the plant."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.language.errors import ParameterError
from feeddrive.language.table import Table
from feeddrive.loop.box import Box
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.linearize import linearize
from feeddrive.study.robust import tune_robust
from feeddrive.workflow.tune import NO_MODEL, TuneRequest, tune


def test_nominal_and_worst_stand_beside_each_other(tmp_path: Path) -> None:
    request = TuneRequest(
        "linear_motor", box="mass=0.3,dead_time=1sample", filters="kept", starts=1, out=tmp_path / "out"
    )
    outcome = tune.run(request)
    tables = [table for table in outcome.tables if isinstance(table, Table)]
    figures = next(table for table in tables if "figures of the closed loop" in str(table.title))
    assert [str(getattr(column, "name", column)) for column in figures.columns] == [
        "what", "today", "worst", "new", "worst of new", "unit",
    ]  # fmt: skip
    kept = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert kept["box"]["box"] == "stiffness=0,mass=0.3,dead_time=1sample"
    assert kept["box"]["verdict"] == "holds"
    assert kept["box"]["figures"]["sensitivity_peak"]["worst"] <= 2.0
    assert kept["box_today"]["verdict"] == "undecided"  # today's Ms is 2.001 there
    report = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "mass 28 to 52 kg" in report
    assert "4 of 4 corners" in report
    assert "--box mass=0.3,dead_time=1sample" in report


def test_without_a_model_it_says_what_is_done_instead() -> None:
    loop = fd.read_machine("linear_motor").loop("x")
    lines = np.geomspace(2.0, 4000.0, 400)
    response = linearize(loop, ["cut"], ["reading_load"]).response(lines)
    measured = replace(response, output="reading_load", input="force", unit="m/N")
    assert isinstance(measured, FRF)
    request = TuneRequest(measured, motor=("none",), box="standard", filters="kept", starts=1)
    outcome = tune.run(request)
    assert NO_MODEL in outcome.remarks
    assert outcome.result.box is None


def test_a_box_that_cannot_be_read_is_refused_before_the_work() -> None:
    with pytest.raises(ParameterError, match=r"box: mass = 3\.0 must be a share >= 0 and < 1"):
        TuneRequest("linear_motor", box="mass=3")


@pytest.mark.slow(reason="a tuning over the machines of a study and over a box, 15 s")
def test_one_control_for_a_study_holds_over_the_box_of_its_job_too(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_text(
        'job = "ball_screw"\nsampler = "grid"\n[[vary]]\nparameter = "axis.x.plant.mass_load"\nvalues_kg = [33, 36]\n',
        encoding="utf-8",
    )
    plain = tune_robust(path, filters="kept", starts=1, fresh=16)
    boxed = tune_robust(path, filters="kept", starts=1, fresh=16, box=Box(0.0, 0.0, 2))
    assert plain.tuned.box is None
    assert boxed.tuned.box is not None
    assert boxed.tuned.box.holds is True
    assert "2 samples later" in str(boxed.tuned.box.plant)
    assert boxed.tuned.after[0].rope_snap > 1.05 * plain.tuned.after[0].rope_snap

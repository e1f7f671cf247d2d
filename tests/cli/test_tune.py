"""`feeddrive tune`: from a machine and from a measurement to a machine file whose comments are kept."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import feeddrive as fd
from feeddrive.cli.commands import app
from feeddrive.files.machine import BUNDLED
from feeddrive.language.errors import FeeddriveError

RUN = CliRunner()


def tune(*words: str, code: int = 0) -> str:
    found = RUN.invoke(app, ["tune", *words])
    if found.exception is not None and not isinstance(found.exception, SystemExit):
        raise found.exception
    assert found.exit_code == code, found.output
    return " ".join(found.output.split())


@pytest.mark.slow(
    reason="a search with free filters and its report, 15 s; tunings of another law and of a response are quick"
)
@pytest.mark.pictures
def test_a_machine_gets_new_numbers_and_keeps_its_comments(tmp_path: Path) -> None:
    said = tune(
        "ball_screw", "--box", "none", "--max-compliance", "0.2", "--filters", "free", "--out", str(tmp_path / "out")
    )
    assert "Take Kv " in said
    assert f"Next: feeddrive export {tmp_path}/out/machine.toml -t c" in said
    text = (tmp_path / "out" / "machine.toml").read_text()
    old = (BUNDLED / "machines" / "ball_screw.toml").read_text()
    assert "# Hz, the torsional mode" in text
    assert len(text.splitlines()) == len(old.splitlines()) + 1  # the low-pass's damping is written out
    machine = fd.read_machine(tmp_path / "out" / "machine.toml")
    loop = machine.loop("x")
    assert fd.margins(fd.loop_gain(loop, np.geomspace(1.0, 9999.0, 8000))).sensitivity_peak < 2.003
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["holds"] is True
    assert summary["tunables"]["law.Kp"] == pytest.approx(float(fd.parameters(loop)["axis.x.control.law.Kp"]), rel=1e-5)
    assert (
        summary["figures"]["new"]["model"]["rope-snap error"] < summary["figures"]["today"]["model"]["rope-snap error"]
    )
    page = (tmp_path / "out" / "report.html").read_text()
    for word in (
        "Dynamic stiffness",
        "Velocity and position loop",
        "today",
        "Held back by",
        "Old and new in time",
        "time after the cut",
    ):
        assert word in page


def test_another_law_takes_the_place_of_the_old_one(tmp_path: Path) -> None:
    tune(
        "ball_screw",
        "--box",
        "none",
        "--law",
        "pole_placement",
        "--filters",
        "kept",
        "--max-compliance",
        "0.2",
        "--starts",
        "1",
        "--out",
        str(tmp_path / "out"),
    )
    loop = fd.read_machine(tmp_path / "out" / "machine.toml").loop("x")
    assert loop.control.law.kind == "pole_placement"
    assert [each.kind for each in loop.control.feedforward] == ["inverse_dynamics"]
    assert fd.stability(loop).stable
    assert "diaphragm" not in (tmp_path / "out" / "machine.toml").read_text()
    assert "coupling_stiffness_N_per_um = 235.2" in (tmp_path / "out" / "machine.toml").read_text()


@pytest.mark.slow(reason="three tunings, 10 s; one from a log to a tuned loop is quick")
def test_a_measured_response_with_and_without_a_baseline(tmp_path: Path) -> None:
    loop = fd.read_machine("linear_motor").loop("x")
    lines = np.arange(2.0, 3000.0, 2.0)
    true = fd.linearize(loop, ["cut"], ["reading_load"]).response(lines)
    random = np.random.default_rng(1)
    noise = 0.01 * np.abs(true.response) * (random.standard_normal((2, lines.size)))
    frf = fd.FRF(
        lines,
        true.response + (noise[0] + 1j * noise[1]) / np.sqrt(2.0),
        "force",
        "position",
        "m/N",
        float(loop.sample_time),
        variance=(0.01 * np.abs(true.response)) ** 2,
    )
    fd.write_frf(tmp_path / "axis.csv", frf)
    said = tune(
        str(tmp_path / "axis.csv"),
        "--baseline",
        "linear_motor",
        "--goal",
        "stiffness",
        "--band",
        "1..50",
        "--filters",
        "kept",
        "--out",
        str(tmp_path / "one"),
    )
    assert "dynamic stiffness" in said
    assert "certificate.json" in said
    tuned = fd.read_machine(tmp_path / "one" / "machine.toml").loop("x")
    m = fd.margins(fd.loop_gain(tuned, np.geomspace(1.0, 4999.0, 4000)))
    assert m.sensitivity_peak <= 2.01
    tune(str(tmp_path / "axis.csv"), "--filters", "placed", "--out", str(tmp_path / "two"))
    assert not (tmp_path / "two" / "machine.toml").exists()
    assert 'kind = "cascade_ppi"' in (tmp_path / "two" / "control.toml").read_text()


def test_what_does_not_fit_is_said(tmp_path: Path) -> None:
    with pytest.raises(FeeddriveError, match=r"--sample-time 0\.01 s is not that of the machine file, 0\.0001 s"):
        tune("linear_motor", "--sample-time", "0.01")
    with pytest.raises(FeeddriveError, match="neither a file nor"):
        tune("bal_screw")
    with pytest.raises(FeeddriveError, match=r"pole_placement.*cannot control this axis"):
        tune("linear_motor", "--law", "pole_placement")
    lines = np.geomspace(1.0, 500.0, 50)
    fd.write_frf(tmp_path / "axis.csv", fd.FRF(lines, -1.0 / (40.0 * (2 * np.pi * lines) ** 2) + 0j, unit="m/N"))
    with pytest.raises(FeeddriveError, match="--sample-time"):
        tune(str(tmp_path / "axis.csv"))
    with pytest.raises(FeeddriveError, match="goal = 'speed'"):
        tune("linear_motor", "--goal", "speed")

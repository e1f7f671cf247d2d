"""`feeddrive prefilter` as a user meets it."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest

import feeddrive as fd
from feeddrive import cli
from feeddrive.blocks.families import Prefilter
from feeddrive.files.run_files import write_run_csv
from feeddrive.files.section import read_block
from feeddrive.files.toml_file import read_toml
from feeddrive.papers.gordon2013.testbed import LONG, placed


@pytest.fixture
def call(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """Runs `feeddrive prefilter` beside run.csv, a simulated log: exit code, output, errors."""
    monkeypatch.chdir(tmp_path)
    run = fd.simulate(placed(), LONG)
    write_run_csv("run.csv", run.time, run.signals, run.units)

    def asked(*words: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["feeddrive", "prefilter", *words])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        captured = capsys.readouterr()
        return int(ended.value.code or 0), captured.out, captured.err

    return asked


def test_the_section_is_the_fit_of_the_run(call, tmp_path: Path) -> None:
    code, out, _ = call("run.csv", "--controller", "ball_screw", "--out", "section.toml")
    assert code == 0
    assert "std. error" in out
    assert "central differences" in out
    section = read_toml(tmp_path / "section.toml").root().section("axis").section("x")
    made = read_block(Prefilter, section.section("control").section("prefilter"))  # type: ignore[type-abstract]
    fit = fd.learning.fit_prefilter(fd.simulate(placed(), LONG), LONG)
    assert isinstance(made, fd.blocks.TrajectoryPrefilter)
    for number, regressor in enumerate(("velocity", "acceleration", "jerk", "snap"), start=1):
        # differences of the set position for its exact derivatives: they matter less than what the run tells of them
        error = 0.1 * fit.standard_error[regressor]
        assert getattr(made, f"theta{number}") == pytest.approx(fit.theta[regressor], abs=error)


def test_a_job_gives_exact_derivatives(call, tmp_path: Path) -> None:
    (tmp_path / "job.toml").write_text(
        'machine = "ball_screw"\n[reference]\nkind = "snap_limited_move"\ndistance = 0.3\nvelocity = 1\n'
        "acceleration = 10\njerk = 800\nsnap = 8e4\ndwell_after = 0.1\n"
    )
    code, out, _ = call("run.csv", "--job", "job.toml", "--regressors", "a,s")
    assert code == 0
    assert "those of the job's reference, exact" in out
    assert "theta1 = 0.0" in out


def test_named_columns_in_other_units(call, tmp_path: Path) -> None:
    run = fd.simulate(placed(), LONG)
    rows = np.column_stack([run.time, 1e3 * run["set_position"], 1e3 * run["reading_load"]])
    np.savetxt(tmp_path / "own.csv", rows, delimiter=",", header="t,soll_mm,ist_mm", comments="", fmt="%.17g")
    code, out, errors = call("own.csv", "--set-position", "soll_mm", "--position", "ist_mm")
    assert (code, errors) == (0, "")
    in_si = call("run.csv")[1]
    first = next(line for line in in_si.splitlines() if "samples in motion" in line)
    assert re.search(r"error 0\.22\d* um RMS", first)
    assert first in out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("run.csv", "--controller", "emps"), "is not the controller's"),
        (("run.csv", "--regressors", "v,q"), "'q' is none of v, a, j, s"),
        (("run.csv", "--position", "nothing"), "there is no column 'nothing'"),
        (("missing.csv",), "no such file"),
    ],
)
def test_bad_input_is_one_line(call, words: tuple[str, ...], said: str) -> None:
    code, _, errors = call(*words)
    assert code == 2
    assert said in errors
    assert errors.count("\n") == 1

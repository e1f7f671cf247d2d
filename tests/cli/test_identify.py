"""`feeddrive identify`, from a log to a machine file that runs and a report."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from drive_logs import TRUTH, T, changed, simulated
from feeddrive.cli.commands import app
from feeddrive.files.machine import BUNDLED, read_machine
from feeddrive.language import tree
from feeddrive.language.errors import FeeddriveError, NotIdentifiableError, ParameterError

runner = CliRunner()


def written(folder: Path) -> Path:
    """A simulated log as CSV."""
    log = simulated(size=0.5)
    assert log.set_position is not None
    t = np.arange(log.position.size) * T
    path = folder / "log.csv"
    np.savetxt(
        path,
        np.column_stack([t, log.set_position, log.position, log.force]),
        delimiter=",",
        fmt="%.12g",
        header="time_s,set_position_m,position_m,force_N",
        comments="",
    )
    return path


@pytest.mark.pictures
def test_without_a_machine_the_whole_loop_comes_out_of_the_log(tmp_path: Path) -> None:
    done = runner.invoke(app, ["identify", str(written(tmp_path)), "--out", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    assert "Use these values" in done.output
    loop = read_machine(tmp_path / "out" / "machine.toml").loop("x")
    # disturbed by 0.5 N: a tenth of a percent of the mass, a percent of the friction
    assert tree.get(loop, "axis.x.plant.mass") == pytest.approx(TRUTH["mass"], rel=3e-3)
    assert tree.get(loop, "axis.x.friction_load.coulomb") == pytest.approx(TRUTH["coulomb"], rel=0.02)
    assert tree.get(loop, "axis.x.forces.0.force") == pytest.approx(-TRUTH["offset"], abs=0.2)
    assert tree.get(loop, "axis.x.control.law.Kv") == pytest.approx(160.18, rel=1e-4)
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    for said in ("Use these values", "Residual and its autocorrelation", "standard error", "Dead time"):
        assert said in page


def test_a_given_machine_keeps_its_comments_and_the_rest_of_its_values(tmp_path: Path) -> None:
    start = tmp_path / "mine.toml"
    text = (BUNDLED / "machines" / "emps_symmetric.toml").read_text(encoding="utf-8")
    start.write_text(text.replace("mass_kg = 95.1089", "mass_g = 80e3   # as the drawing says"), encoding="utf-8")
    log = str(written(tmp_path))
    done = runner.invoke(
        app, ["identify", log, "--machine", str(start), "--friction", "symmetric", "--out", str(tmp_path / "out")]
    )
    assert done.exit_code == 0, done.output
    made = (tmp_path / "out" / "machine.toml").read_text(encoding="utf-8")
    assert "# as the drawing says; standard error" in made
    assert "# the drive must overcome the offset" in made
    assert re.search(r"^mass_g = 9[45]\d\d\d", made, re.MULTILINE)
    before, after = read_machine(start).loop("x"), read_machine(tmp_path / "out" / "machine.toml").loop("x")
    assert repr(after.control) == repr(before.control)
    assert repr(after.axis.encoder_load) == repr(before.axis.encoder_load)
    assert tree.get(after, "axis.x.plant.mass") == pytest.approx(TRUTH["mass"], rel=3e-3)
    # of all estimates, in SI although the mass stands in g
    errors = read_machine(tmp_path / "out" / "machine.toml").errors["x"]
    assert {"plant.mass", "friction_load.coulomb", "friction_load.viscous"} <= set(errors)
    assert abs(tree.get(after, "axis.x.plant.mass") - TRUTH["mass"]) < 4.0 * errors["plant.mass"] < 0.02 * TRUTH["mass"]


def test_what_is_missing_is_named(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    log = changed(simulated(size=0.5))
    table = np.column_stack([np.arange(log.position.size) * T, log.position, log.force])
    np.savetxt(path, table, delimiter=",", header="time_s,position_m,command", comments="")
    done = runner.invoke(app, ["identify", str(path)])
    assert isinstance(done.exception, ParameterError)
    assert "--force-constant" in str(done.exception)
    half = table[: int(np.argmax(log.position))]
    np.savetxt(path, half, delimiter=",", header="time_s,position_m,force_N", comments="")
    done = runner.invoke(app, ["identify", str(path)])
    assert isinstance(done.exception, NotIdentifiableError)
    assert "to and fro" in str(done.exception)


def test_an_out_that_cannot_be_written_is_refused_before_the_work(tmp_path: Path) -> None:
    """The log is not even there, and it is the directory that is named."""
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    with pytest.raises(FeeddriveError, match="mine"):
        runner.invoke(
            app,
            ["identify", "none.csv", "--out", str(tmp_path / "mine")],
            catch_exceptions=False,
            standalone_mode=False,
        )

"""Which column of a log is what: guessed and shown, written as a short TOML, and taken from there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from drive_logs import TRUTH, T, simulated
from feeddrive.cli.commands import app
from feeddrive.files.machine import read_machine
from feeddrive.language import tree
from feeddrive.language.errors import FileError, LogError, ParameterError

runner = CliRunner()


def written(folder: Path, heads: str, scales: tuple[float, float, float, float]) -> Path:
    """A simulated log under other names and units."""
    log = simulated(size=0.5)
    assert log.set_position is not None
    t = np.arange(log.position.size) * T
    columns = np.column_stack([t, log.set_position, log.position, log.force]) / np.array(scales)
    path = folder / "log.csv"
    np.savetxt(path, columns, delimiter=",", fmt="%.14g", header=heads, comments="")
    return path


def mass(folder: Path) -> float:
    return float(tree.get(read_machine(folder / "machine.toml").loop("x"), "axis.x.plant.mass"))


def test_a_guess_is_shown_before_it_is_used(tmp_path: Path) -> None:
    path = written(tmp_path, "t [ms],x_cmd_mm,x_fb_mm,fx [kN]", (1e-3, 1e-3, 1e-3, 1e3))
    done = runner.invoke(app, ["identify", str(path), "--out", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    assert "roles guessed by names, units and samples" in done.output
    assert "feeddrive channels" in done.output
    assert mass(tmp_path / "out") == pytest.approx(TRUTH["mass"], rel=3e-3)


def test_a_mapping_is_written_corrected_and_used(tmp_path: Path) -> None:
    """Position in counts of 50 nm, force in percent of 200 N: only factors make them physics."""
    heads = "t,wanted [mm],x_fb [counts],torque [%]"
    path = written(tmp_path, heads, (1.0, 1e-3, 50e-9, 2.0))
    roles = tmp_path / "channels.toml"
    done = runner.invoke(app, ["channels", str(path), "--out", str(roles)])
    assert done.exit_code == 0, done.output
    text = roles.read_text(encoding="utf-8")
    assert "[log.channels]" in text
    roles.write_text(
        """[log]
file = "log.csv"
[log.channels]
time = "t"
setpoint_position = { column = "wanted", unit = "mm" }
position_load = { column = "x_fb", factor = 50e-9 }
force = { column = "torque", factor = 2.0 }
""",
        encoding="utf-8",
    )
    asked = ["identify", str(path), "--channels", str(roles), "--out", str(tmp_path / "out")]
    done = runner.invoke(app, asked)
    assert done.exit_code == 0, done.output
    assert "guessed" not in done.output
    assert mass(tmp_path / "out") == pytest.approx(TRUTH["mass"], rel=3e-3)


def test_factors_and_a_clock_of_another_name_on_the_command_line(tmp_path: Path) -> None:
    path = written(tmp_path, "k,wanted,act,push", (1e-3, 1e-3, 50e-9, 2.0))
    names = ["--time", "k:ms", "--set-position", "wanted:mm", "--position", "act*5e-8", "--force", "push*2"]
    done = runner.invoke(app, ["identify", str(path), *names, "--out", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    assert mass(tmp_path / "out") == pytest.approx(TRUTH["mass"], rel=3e-3)


def test_a_response_by_roles(tmp_path: Path) -> None:
    random = np.random.default_rng(1)
    force = 100.0 * random.standard_normal(6000)
    position = np.convolve(force, [0.0, 1e-8, 5e-9])[:6000]
    path = tmp_path / "log.csv"
    table = np.column_stack([np.arange(6000) * 1e-3, force, 1e3 * position])
    np.savetxt(path, table, delimiter=",", header="t,kraft_N,lageistwert_mm", comments="")
    done = runner.invoke(app, ["frf", str(path), "--out", str(tmp_path / "guessed")])
    assert done.exit_code == 0, done.output
    assert "roles guessed" in done.output
    roles = tmp_path / "roles.toml"
    runner.invoke(app, ["channels", str(path), "--out", str(roles)])
    done = runner.invoke(app, ["frf", str(path), "--channels", str(roles), "--out", str(tmp_path / "mapped")])
    assert done.exit_code == 0, done.output
    assert "roles guessed" not in done.output
    responses = [(tmp_path / each / "frf.csv").read_bytes() for each in ("guessed", "mapped")]
    assert responses[0] == responses[1]
    assert b"# unit: m/N" in responses[0]


def test_what_is_missing_is_said_with_what_to_do(tmp_path: Path) -> None:
    path = written(tmp_path, "t,a,b,c", (1.0, 1.0, 1.0, 1.0))
    done = runner.invoke(app, ["identify", str(path), "--channels", str(tmp_path / "none.toml")])
    assert isinstance(done.exception, FileError)
    assert "feeddrive channels" in str(done.exception)
    # the samples tell what a, b and c are, but not in which unit c is
    done = runner.invoke(app, ["identify", str(path)])
    assert isinstance(done.exception, ParameterError)
    assert "--force 'column:N'" in str(done.exception)
    short = tmp_path / "short.csv"
    short.write_text("t,a,b\n" + "".join(f"{k * 1e-3:g},{k % 7},{k % 5}\n" for k in range(50)), encoding="utf-8")
    done = runner.invoke(app, ["identify", str(short)])
    assert isinstance(done.exception, LogError)
    assert "--position" in str(done.exception)


def csv_array(member: str, numbers: str) -> str:
    return f'<NumericArray name="{member}" format="CSV"><raw name="m_pNumberArray">{numbers}</raw></NumericArray>'


AST = f"""<?xml version="1.0"?>
<DynamicModelAxisController><string name="m_szAxisName">X1</string>
 <LinkedList name="m_SpeedPlantMeasurementList"><SpeedPlantMeasurement>
  <FrequencyResponseFunction name="m_pPlant">
   {csv_array("m_FrequencyVector", "1,2,4")}{csv_array("m_ValueVector", "1,0,0.5,-0.5,0.1,-0.2")}
  </FrequencyResponseFunction></SpeedPlantMeasurement></LinkedList>
 <LinkedList name="m_Filters"><PT2Filter><float name="m_dFrequency">1999</float></PT2Filter></LinkedList>
</DynamicModelAxisController>
"""


def test_responses_and_controllers_of_a_tuning_tool_are_listed(tmp_path: Path) -> None:
    (tmp_path / "a.xml").write_text(AST, encoding="utf-8")
    done = runner.invoke(app, ["channels", str(tmp_path / "a.xml")])
    assert done.exit_code == 0, done.output
    for words in (
        f"frequency responses in {tmp_path}",
        "speed_plant_1_plant",
        "(rad/s)/(N m)",
        "PT2Filter[1]",
        "1999",
        "X1",
    ):
        assert words in done.output
    out = tmp_path / "roles.toml"
    refused = runner.invoke(app, ["channels", str(tmp_path / "a.xml"), "--out", str(out)])
    assert isinstance(refused.exception, ParameterError)
    assert "holds frequency responses, which need no --out" in str(refused.exception)
    assert not out.exists()


def test_what_is_wrong_with_the_xml_is_said_and_not_that_it_is_no_log(tmp_path: Path) -> None:
    (tmp_path / "a.xml").write_text(AST.replace("1,2,4", "1,2"), encoding="utf-8")
    for command in ("channels", "identify"):
        refused = runner.invoke(app, [command, str(tmp_path / "a.xml")])
        assert isinstance(refused.exception, LogError)
        assert "m_pPlant has 6 values at 2 frequencies" in str(refused.exception)

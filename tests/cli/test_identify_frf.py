"""`feeddrive identify` on files of frequency responses."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from feeddrive.blocks.plant.three_mass_chain import ThreeMassChain
from feeddrive.cli.commands import app
from feeddrive.files.frf import write_frf
from feeddrive.files.machine import read_machine
from feeddrive.identification.response.plant_fit import fit_two_mass
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.loop.frequency_response import FRF
from feeddrive.workflow.identify_responses import machine_text
from screw_responses import SCREW, F, responses

runner = CliRunner()


def written(folder: Path, scale: float = 1.0, unit: str = "m/N") -> Path:
    """Both encoders with 1 % of noise, as CSV."""
    motor, load = (frf.response * scale for frf in responses(SCREW, noise=0.01, seed=6))
    path = folder / "frf.csv"
    columns = np.column_stack([F, motor.real, motor.imag, load.real, load.imag])
    np.savetxt(
        path,
        columns,
        delimiter=",",
        fmt="%.12g",
        comments="",
        header=f"f_Hz,re_motor[{unit}],im_motor[{unit}],re_load[{unit}],im_load[{unit}]",
    )
    return path


@pytest.mark.pictures
def test_two_masses_go_into_a_machine_file_that_keeps_its_comments(tmp_path: Path) -> None:
    given = tmp_path / "mine.toml"
    given.write_text(
        """name = "mine"
sample_time = 2.5e-4

[axis.x.plant]
kind = "two_mass"
mass_motor = 100.0   # as the drawing says
mass_load = 40.0
stiffness_N_per_um = 20.0
damping = 500.0
viscous_motor = 1000.0

[axis.x.control.law]
kind = "cascade_ppi"
Kv = 40.0
Kp = 2.0e4
Tn = 0.02
""",
        encoding="utf-8",
    )
    log = str(written(tmp_path))
    done = runner.invoke(
        app,
        ["identify", log, "--motor", "motor", "--load", "load", "--machine", str(given), "--out", str(tmp_path / "o")],
    )
    assert done.exit_code == 0, done.output
    assert "Use this model" in done.output
    made = (tmp_path / "o" / "machine.toml").read_text(encoding="utf-8")
    assert "as the drawing says; standard error" in made
    assert "stiffness_N_per_um = 18.0" in made
    machine = read_machine(tmp_path / "o" / "machine.toml")
    loop = machine.loop("x")
    # the errors that `--box identified` is made of: those in the comments, in SI
    assert {"plant.mass_motor", "plant.mass_load", "plant.stiffness"} <= set(machine.errors["x"])
    box = machine.box("identified", "x")
    assert box is not None
    # along the principal axes of three correlated errors: an end is 1 to √3 times two standard errors away
    two = 2.0 * machine.errors["x"]["plant.stiffness"] / 1.8e7
    assert 0.98 * two < dict(box.known)["stiffness"] < 1.02 * 3.0**0.5 * two
    assert box.upright().tied == ()
    assert max(abs(value) for value in machine.correlations["x"].values()) > 0.5
    assert 0.0 < dict(box.known)["stiffness"] < 0.05
    assert tree.get(loop, "axis.x.plant.mass_motor") == pytest.approx(130.0, rel=0.01)
    assert tree.get(loop, "axis.x.plant.viscous_load") == 0.0
    assert loop.control.law.Kv == 40.0  # type: ignore[attr-defined]
    page = (tmp_path / "o" / "report.html").read_text(encoding="utf-8")
    assert "Not identifiable: viscous_load" in page
    assert "standard error" in page


def test_a_modal_axis_takes_the_place_of_another_plant(tmp_path: Path) -> None:
    log = str(written(tmp_path))
    asked = ["identify", log, "--motor", "motor", "--load", "load", "--modes", "1", "--out", str(tmp_path / "o")]
    done = runner.invoke(app, asked)
    assert done.exit_code == 0, done.output
    assert 'kind = "modal"' in (tmp_path / "o" / "machine.toml").read_text(encoding="utf-8")


def test_plain_modes_of_all_responses(tmp_path: Path) -> None:
    done = runner.invoke(
        app, ["identify", str(written(tmp_path)), "--model", "modes", "--modes", "1", "--out", str(tmp_path / "o")]
    )
    assert done.exit_code == 0, done.output
    assert "131.6" in done.output
    assert not (tmp_path / "o" / "machine.toml").exists()


def test_a_current_needs_its_force_constant_for_a_machine(tmp_path: Path) -> None:
    log = str(written(tmp_path, 50.0, "m/A"))
    asked = ["identify", log, "--motor", "motor", "--load", "load", "--out", str(tmp_path / "o")]
    assert "No machine file" in runner.invoke(app, asked).output
    done = runner.invoke(app, [*asked, "--force-constant", "50"])
    assert done.exit_code == 0, done.output
    assert (tmp_path / "o" / "machine.toml").exists()


def test_encoders_must_be_told_apart(tmp_path: Path) -> None:
    path = written(tmp_path)
    path.write_text(path.read_text(encoding="utf-8").replace("_motor[", "_one[").replace("_load[", "_two["))
    done = runner.invoke(app, ["identify", str(path)])
    assert isinstance(done.exception, ParameterError)
    assert "--motor NAME" in str(done.exception)
    done = runner.invoke(app, ["identify", str(path), "--motor", "oen"])
    assert "did you mean one" in str(done.exception)


@pytest.mark.slow(reason="a fit of each structure; the choice has a quick test of the fit")
def test_the_structure_of_a_machine_file_is_a_candidate(tmp_path: Path) -> None:
    """Motor, screw and table; a data sheet's rotor makes the others identifiable."""
    chain = ThreeMassChain(
        mass_motor=85.0,
        mass_screw=45.0,
        mass_load=33.0,
        coupling_stiffness=2.352e8,
        coupling_damping=2496.0,
        stiffness=1.8e7,
        damping=700.0,
        viscous_motor=750.0,
        viscous_screw=750.0,
        viscous_load=20.0,
    )
    path = tmp_path / "frf.csv"
    write_frf(path, *responses(chain, np.linspace(5.0, 700.0, 150), noise=0.003, variance=True, late=5e-5))
    asked = ["identify", str(path), "--machine", "ball_screw", "--fix", "mass_motor=85"]
    done = runner.invoke(app, [*asked, "--verbose", "--out", str(tmp_path / "o")])
    assert done.exit_code == 0, done.output
    assert re.search(r"machine .* taken", done.output)
    plant = read_machine(tmp_path / "o" / "machine.toml").loop("x").axis.plant
    assert isinstance(plant, ThreeMassChain)
    assert float(plant.mass_motor) == 85.0
    assert float(plant.mass_screw) == pytest.approx(45.0, rel=0.02)
    assert float(plant.mass_load) == pytest.approx(33.0, rel=0.01)


def test_known_parameters_come_in_any_unit_and_must_exist(tmp_path: Path) -> None:
    asked = ["identify", str(written(tmp_path)), "--model", "two-mass", "--out", str(tmp_path / "o")]
    done = runner.invoke(app, [*asked, "--fix", "stiffness_N_per_um=18"])
    assert done.exit_code == 0, done.output
    assert "stiffness" not in [line.split()[0] for line in done.output.splitlines() if line.split()]
    assert "did you mean mass_motor" in str(runner.invoke(app, [*asked, "--fix", "mas_motor=1"]).exception)
    assert "NAME=NUMBER" in str(runner.invoke(app, [*asked, "--fix", "mass_motor=heavy"]).exception)


def test_each_encoder_in_a_file_of_its_own(tmp_path: Path) -> None:
    motor, load = responses(SCREW, noise=0.01, seed=6)
    write_frf(tmp_path / "m.csv", motor)
    write_frf(tmp_path / "l.csv", load)
    done = runner.invoke(
        app,
        [
            "identify",
            str(tmp_path / "m.csv"),
            "--motor",
            str(tmp_path / "m.csv"),
            "--load",
            str(tmp_path / "l.csv"),
            "--out",
            str(tmp_path / "o"),
        ],
    )
    assert done.exit_code == 0, done.output
    assert 'kind = "two_mass"' in (tmp_path / "o" / "machine.toml").read_text(encoding="utf-8")


def test_lines_that_end_below_the_resonance_make_no_machine(tmp_path: Path) -> None:
    motor, _ = responses(SCREW, noise=0.01)
    low = motor.frequency <= 30.0
    write_frf(tmp_path / "m.csv", FRF(motor.frequency[low], motor.response[low], "force", "motor", "m/N"))
    asked = ["identify", str(tmp_path / "m.csv"), "--out", str(tmp_path / "o")]
    done = runner.invoke(app, [*asked, "--verbose"])
    assert done.exit_code == 0, done.output
    assert re.search(r"rigid .* taken", done.output)  # a rigid mass predicts these lines as well
    done = runner.invoke(app, [*asked, "--model", "two-mass"])
    assert "Measure once more before you use this model" in done.output
    assert not (tmp_path / "o" / "machine.toml").exists()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--model", "modes", "--modes", "-3"), "modes = -3 must be >= 0"),
        (("--motor", "motor", "--load", "motor"), "are the same response"),
        (("--unit", "rad/A"), "as its file says, not rad/A"),
        (("--force-constant", "-3"), "--force-constant = -3 (N at the table per unit of the command) must be > 0"),
        (("--model", "machine"), "needs a machine file"),
        (("--model", "springs"), "--model = 'springs' (model of frequency responses) must be one of"),
    ],
)
def test_bad_options_are_named(tmp_path: Path, options: tuple[str, ...], said: str) -> None:
    done = runner.invoke(app, ["identify", str(written(tmp_path)), *options])
    assert isinstance(done.exception, ParameterError)
    assert said in str(done.exception)


def test_a_response_from_a_measured_force_leaves_the_delays_of_the_file(tmp_path: Path) -> None:
    """They are not in it; from a command they are, and the file gets them."""
    (tmp_path / "mine.toml").write_text(
        'sample_time_ms = 1\n[axis.x.plant]\nkind = "two_mass"\nmass_motor = 100.0\nmass_load = 50.0\n'
        "stiffness = 1e7\ndamping = 100.0\n[axis.x.actuator]\ndead_time_ms = 0.7\ncurrent_loop = 300.0\n"
        '[axis.x.control.law]\nkind = "cascade_ppi"\nKv = 10.0\nKp = 1e4\n',
        encoding="utf-8",
    )
    fit = fit_two_mass(*responses(SCREW, np.arange(10.0, 300.0, 10.0), noise=0.01, seed=2))
    machine = read_machine(tmp_path / "mine.toml")
    measured, commanded = (machine_text(fit, machine, "x", drive) for drive in (False, True))
    assert "dead_time_ms = 0.7\ncurrent_loop = 300.0\n" in measured
    assert "dead_time_ms = 0.7\n" not in commanded
    for text in (measured, commanded):
        assert float(re.findall(r"mass_load = ([\d.]+)", text)[0]) == pytest.approx(
            fit["mass_load"].value, rel=1e-5
        )  # six digits

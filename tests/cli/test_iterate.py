"""`feeddrive iterate` as a user meets it."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import feeddrive as fd
from feeddrive import cli
from feeddrive.blocks.families import Feedforward
from feeddrive.files.run_files import write_run_csv
from feeddrive.files.section import read_block
from feeddrive.files.toml_file import read_toml
from feeddrive.workflow.learn import MOVE

LOG = Path(__file__).parents[3] / "shared" / "data" / "emps" / "DATA_EMPS.mat"
needs_log = pytest.mark.skipif(not LOG.exists(), reason=f"NOT RUN: the measured log {LOG.name} is not in ../shared")
AXIS = ("--controller", "xy_table", "--axis", "x")


@pytest.fixture
def call(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """Runs `feeddrive iterate`: exit code, output, errors."""
    monkeypatch.chdir(tmp_path)

    def asked(*words: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["feeddrive", "iterate", *words])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        captured = capsys.readouterr()
        return int(ended.value.code or 0), captured.out, captured.err

    return asked


def logged(reference: fd.blocks.SnapLimitedMove, name: str = "run.csv") -> fd.loop.Run:
    run = fd.simulate(fd.read_machine("xy_table").loop("x"), reference)
    write_run_csv(name, run.time, run.signals, run.units)
    return run


def section(path: Path) -> fd.blocks.DisturbanceCompensator:
    control = read_toml(path).root().section("axis").section("x").section("control")
    made = read_block(Feedforward, control.listed("feedforward")[0])  # type: ignore[type-abstract]
    assert isinstance(made, fd.blocks.DisturbanceCompensator)
    return made


def test_a_log_gives_the_parameters_of_the_run(call, tmp_path: Path) -> None:
    run = logged(MOVE)
    code, out, _ = call("run.csv", *AXIS, "--out", "next.toml")
    assert code == 0
    assert "standard error" in out
    assert "predicted" in out
    expected = fd.learning.next_iteration(
        fd.read_machine("xy_table").loop("x"), fd.learning.simulated_trial(run, MOVE)
    ).after.parameters()
    for name, value in section(tmp_path / "next.toml").parameters().items():
        # the log has twelve digits or so, and differences for derivatives
        assert value == pytest.approx(expected[name], rel=0.01), name


@pytest.mark.parametrize("at_rest", ["held", "none"])
def test_friction_at_rest_is_an_option(call, at_rest: str, tmp_path: Path) -> None:
    """Each gives what `next_iteration` gives, and the two differ: the trial dwells between its strokes."""
    trial = fd.learning.simulated_trial(logged(MOVE), MOVE)
    loop = fd.read_machine("xy_table").loop("x")
    expected = {each: fd.learning.next_iteration(loop, trial, at_rest=each) for each in ("held", "none")}
    mass = {each: found.after.parameters()["mass"] for each, found in expected.items()}
    assert abs(mass["held"] - mass["none"]) > 1e-3 * mass["none"]
    code, _, _ = call("run.csv", *AXIS, "--at-rest", at_rest, "--out", "next.toml")
    assert code == 0
    # the log has twelve digits: a thousandth of the difference of the two
    found = section(tmp_path / "next.toml").parameters()["mass"]
    other = mass["none" if at_rest == "held" else "held"]
    assert abs(found - mass[at_rest]) < 0.01 * abs(found - other)


def test_the_printed_section_is_the_written_one(call, tmp_path: Path) -> None:
    logged(MOVE)
    _, out, _ = call("run.csv", *AXIS, "--out", "next.toml")
    text = (tmp_path / "next.toml").read_text(encoding="utf-8")
    assert text.strip() in out
    assert text.startswith("[[axis.x.control.feedforward]]\n")


def test_a_log_without_reversal_freezes_friction_with_the_reason(call, tmp_path: Path) -> None:
    one_way = fd.blocks.SnapLimitedMove(
        distance=0.1, velocity=0.25, acceleration=3.0, jerk=60.0, snap=15e3, dwell_after=0.2
    )
    logged(one_way)
    code, out, _ = call("run.csv", *AXIS, "--out", "next.toml")
    assert code == 0
    assert "coulomb_positive is frozen: the trial has no reversal" in out.replace("\n", " ")
    assert section(tmp_path / "next.toml").coulomb_positive == 0.0
    code, _, errors = call("run.csv", *AXIS, "--columns", "coulomb_positive,coulomb_negative")
    assert code == 1
    assert "identifies no parameter" in errors
    assert "at least 2 % are needed" in errors


def test_a_log_on_another_clock_is_refused(call) -> None:
    logged(MOVE)
    code, _, errors = call("run.csv", "--controller", "ball_screw")
    assert code == 2
    assert "differs from the controller's" in errors
    assert "the nearest admissible clock is" in errors
    assert errors.count("\n") == 1


def test_an_unstable_model_loop_ends_with_1_and_the_nearest_mass(call, tmp_path: Path) -> None:
    from feeddrive.files.machine import BUNDLED

    text = (BUNDLED / "machines" / "xy_table.toml").read_text(encoding="utf-8")
    (tmp_path / "light.toml").write_text(text.replace("mass_kg = 45 ", "mass_kg = 1 ", 1), encoding="utf-8")
    logged(MOVE)
    code, _, errors = call("run.csv", "--controller", "light.toml", "--axis", "x", "--form", "model-based")
    assert code == 1
    assert "nearest admissible mass is" in errors
    assert call("run.csv", "--controller", "light.toml", "--axis", "x")[0] == 0


def test_a_machine_runs_simulated_trials(call, tmp_path: Path) -> None:
    code, out, _ = call(
        "xy_table", "--axis", "x", "--trials", "3", "--stribeck-velocity", "0.006", "--out", "next.toml"
    )
    assert code == 0
    assert "3 trials" in out
    assert "100 mm out and back" in out
    loop = fd.learning.begin_compensation(
        fd.read_machine("xy_table").loop("x"),
        ("mass", "viscous", "coulomb_positive", "coulomb_negative", "stribeck"),
        stribeck_velocity=0.006,
    )
    found = fd.learning.iterate_trials(loop, MOVE, 3)
    expected = found.parameters()
    assert section(tmp_path / "next.toml").parameters() == {name: values[-1] for name, values in expected.items()}


def test_jobs_take_turns(call, tmp_path: Path) -> None:
    for name, distance in (("long", 0.1), ("short", 0.05)):
        (tmp_path / f"{name}.toml").write_text(
            f'machine = "xy_table"\naxis = "x"\n[reference]\nkind = "snap_limited_move"\ndistance = {distance}\n'
            "velocity = 0.2\nacceleration = 2\njerk = 50\nsnap = 1e4\nback = true\ndwell_after = 0.1\n"
        )
    code, out, _ = call("xy_table", "--axis", "x", "--trials", "3", "--job", "long.toml", "--job", "short.toml")
    assert code == 0
    assert "out and back, at most" not in out


def test_columns_are_named_and_have_units(call, tmp_path: Path) -> None:
    run = logged(MOVE)
    table = np.column_stack([run.time, 1e3 * run["set_position"], 1e3 * run["reading_load"]])
    np.savetxt(tmp_path / "own.csv", table, delimiter=",", header="t,soll,ist", comments="", fmt="%.10f")
    code, _, errors = call("own.csv", *AXIS)
    assert code == 2
    assert "--unit mm" in errors
    code, _, _ = call("own.csv", *AXIS, "--set-position", "soll:mm", "--position", "ist:mm", "--out", "next.toml")
    assert code == 0
    expected = fd.learning.next_iteration(
        fd.read_machine("xy_table").loop("x"), fd.learning.simulated_trial(run, MOVE)
    ).after
    assert section(tmp_path / "next.toml").mass == pytest.approx(float(expected.mass or 0.0), rel=0.02)


@needs_log
def test_a_real_log(call, tmp_path: Path) -> None:
    """578 um under P-P control; what the parameters mean stands in tests/tuning/test_trial.py."""
    asked = ("--controller", "emps", "--skip", "49", "--form", "axis-model", "--out", "next.toml")
    code, out, _ = call(str(LOG), *asked)
    assert code == 0
    assert "577.8 um RMS" in out
    # published 95.1 kg, of which 12.8 kg are what the velocity loop without feedforward does not need
    assert section(tmp_path / "next.toml").mass == pytest.approx(95.1 - 1.5e-3 * 8557.4, rel=0.05)


def test_the_machine_file_gets_the_section_in_place_of_the_old_one(call, tmp_path: Path) -> None:
    """With all else as it was, and the log by its digest; several axes at once have no one file to write."""
    logged(MOVE)
    code, out, _ = call("run.csv", *AXIS, "--out", "next.toml", "--into", "learned.toml")
    assert code == 0
    assert "Next: feeddrive certify learned.toml --axis x" in out
    before, after = (fd.read_machine(name) for name in ("xy_table", tmp_path / "learned.toml"))
    (learned,) = after.loop("x").control.feedforward
    assert isinstance(learned, fd.blocks.DisturbanceCompensator)
    assert learned.parameters() == pytest.approx(section(tmp_path / "next.toml").parameters(), rel=1e-6)
    assert repr(after.loop("x").control.law) == repr(before.loop("x").control.law)
    assert repr(after.loop("y")) == repr(before.loop("y"))
    assert 'file = "run.csv"' in (tmp_path / "learned.toml").read_text(encoding="utf-8")


def test_one_machine_file_is_for_one_axis(call) -> None:
    code, _, errors = call("xy_table", "--job", "circle", "--into", "learned.toml")
    assert code == 2
    assert "--into is for one axis, and this job moves several: name one by --axis" in errors

"""`feeddrive identify LOG LOG ...`: logs of one axis through the command, by the names and units of their makers."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import foreign_axis as fa
from feeddrive.cli.commands import app
from feeddrive.files import Mapping as Roles
from feeddrive.files.columns import Column
from feeddrive.files.machine import read_machine
from feeddrive.language import tree
from feeddrive.language.errors import LogError, NotIdentifiableError, ParameterError
from feeddrive.language.judgment import Judgment
from feeddrive.workflow.identify import identify

T = 1e-3


@pytest.fixture(scope="module")
def logs() -> fa.Logs:
    """Three logs of one foreign axis with drawn mass, friction and gains."""
    rng = np.random.default_rng(34)
    mass = rng.uniform(50.0, 200.0)
    axes = fa.Axes(
        mass=np.full(3, mass),
        viscous=mass * rng.uniform(1.0, 3.0),
        coulomb_positive=mass * rng.uniform(0.2, 0.5),
        coulomb_negative=mass * 0.35,
        noise_log=0.02 * mass,
        resolution=1e-8,
    )
    law = fa.Cascade(Kv=rng.uniform(20.0, 30.0), Kp=mass * rng.uniform(120.0, 170.0), ff=1.0)
    xs = fa.smooth_moves(T, (0.1, 0.0) * 2, 0.2, 2.0, 80.0, 0.1, 0.1)
    return fa.simulate(axes, law, xs, T, rng, count=3)


def written(folder: Path, logs: fa.Logs, i: int, *, clock: float = 1.0, force: float = 1.0) -> Path:
    """One log as a file, with a clock and a force that are so many times as large; each with other names and units."""
    log = dict(logs.log(i))
    log["time"], log["force"] = clock * log["time"], force * log["force"]
    path = folder / f"{'abc'[i]}.csv"
    if i != 1:
        return fa.write_csv(path, log, np.random.default_rng(i), language=0, unit="mm", force_unit="N").path
    columns = {"Zeit [ms]": 1e3 * log["time"], "Kraft [kN]": 1e-3 * log["force"]}
    columns |= {"Istposition [m]": log["position"], "Sollposition [m]": log["setpoint"]}
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, delimiter=";", fmt="%.12g", header=";".join(columns), comments="")
    return path


def test_logs_with_names_and_units_of_their_own_become_one_machine_file(tmp_path: Path, logs: fa.Logs) -> None:
    files = [str(written(tmp_path, logs, i)) for i in (0, 1)]
    done = CliRunner().invoke(
        app, ["identify", *files, "--friction", "directional", "--json", "--out", str(tmp_path / "out")]
    )
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout)
    assert said["judgment"] == "use_values"
    assert said["next"] == f"feeddrive tune {tmp_path / 'out' / 'machine.toml'}"
    pooled, compared, laws = said["tables"]
    mass = pooled["rows"][0][2]
    # three standard errors of a log whose error is known to 10 %
    assert abs(mass["value"] - float(logs.true("mass", 0))) < 3.0 * mass["error"]
    assert [row[0] for row in compared["rows"]] == [*files, "pooled", "scatter", "chance"]
    assert {row[-2] for row in laws["rows"]} == {"P-P cascade"}
    assert any("the columns of" in remark.lower() for remark in said["remarks"])
    loop = read_machine(tmp_path / "out" / "machine.toml").loop("x")
    assert tree.get(loop, "axis.x.plant.mass") == pytest.approx(mass["value"], rel=1e-5)  # digits by its error
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "The logs beside the pooled values" in page
    assert "Each log alone" in page


@pytest.mark.slow(reason="two more fits; a wrong unit is seen quickly")
def test_a_clock_that_is_2_percent_wrong_is_seen_by_the_other_log(tmp_path: Path, logs: fa.Logs) -> None:
    a, b = written(tmp_path, logs, 0), written(tmp_path, logs, 1, clock=1.02)
    done = identify.run(identify.request((a, b), friction="directional", out=tmp_path / "out"))
    assert done.judgment is Judgment.SCALES_IN_DOUBT
    assert f"the sample time of '{b.name}' is stated 2 % too long, 1.02 ms in place of 1 ms" in str(done.verdict)
    assert set(done.files) == {"Report"}
    assert done.then == ""


def test_amperes_in_place_of_newtons_are_seen_by_the_other_log(tmp_path: Path, logs: fa.Logs) -> None:
    a, b = written(tmp_path, logs, 0), written(tmp_path, logs, 1, force=1.0 / 23.0)
    with pytest.raises(LogError, match=r"if it is one axis, .* the force of 'b\.csv' is read 0\.04348 times"):
        identify((a, b), friction="directional")


def test_a_log_that_is_refused_is_named_with_the_command_for_the_others(tmp_path: Path, logs: fa.Logs) -> None:
    a = written(tmp_path, logs, 0)
    rest, log = tmp_path / "rest.csv", logs.log(1)
    still = {**log, "position": np.full(log["position"].size, 0.02)}
    fa.write_csv(rest, still, np.random.default_rng(2), language=0, unit="mm", force_unit="N")
    why = r"1 of 2 logs cannot be used: .*rest\.csv: 'position' is .*; without it: feeddrive identify .*a\.csv"
    with pytest.raises(NotIdentifiableError, match=why):
        identify((a, rest), friction="directional")


def test_what_is_no_second_log_is_said(tmp_path: Path, logs: fa.Logs) -> None:
    a = written(tmp_path, logs, 0)
    with pytest.raises(ParameterError, match=r"a\.csv: is given 2 times; a log counts once"):
        identify((a, tmp_path / "." / "a.csv"))
    frf = tmp_path / "frf.csv"
    f = np.geomspace(5.0, 300.0, 80)
    np.savetxt(frf, np.column_stack([f, -1.0 / f**2, 0.0 * f]), delimiter=",", header="f_Hz,re,im", comments="")
    with pytest.raises(ParameterError, match=r"frf\.csv: holds frequency responses.*--motor FILE"):
        identify((a, frf))
    with pytest.raises(ParameterError, match="needs a log of a motion"):
        identify(())


def test_a_column_keeps_its_role_in_all_logs(tmp_path: Path, logs: fa.Logs) -> None:
    """The second log calls its position what is the set position in the first one."""
    log, paths = logs.log(0), (tmp_path / "a.csv", tmp_path / "b.csv")
    columns = np.column_stack([log["time"], log["setpoint"], log["position"], log["force"]])
    for path, heads in zip(paths, ("t [s];x_set [m];x [m];F [N]", "t [s];x [m];x_ist [m];F [N]"), strict=True):
        np.savetxt(path, columns, delimiter=";", header=heads, comments="", fmt="%.10g")
    with pytest.raises(LogError, match=r"b\.csv: 'x' is taken for \w+, and in .*a\.csv for position_load"):
        identify(paths, friction="directional")


def test_a_velocity_beside_the_position_tells_the_clock_of_one_log(tmp_path: Path, logs: fa.Logs) -> None:
    log = logs.log(2)
    velocity = 1e3 * np.round(logs.hidden["velocity"][2], 4)
    columns = {"t [s]": 1.02 * log["time"], "x_act [m]": log["position"], "F [N]": log["force"]}
    path = tmp_path / "run.csv"
    roles = {"time": "t:s", "position_load": "x_act:m", "force": "F:N", "velocity_load": "v_act:mm/s"}
    channels = Roles({role: Column.of(text) for role, text in roles.items()})

    def judged(velocity: np.ndarray, channels: Roles | None) -> tuple[Judgment, str]:
        table = np.column_stack([*columns.values(), velocity])
        np.savetxt(path, table, delimiter=";", header=";".join([*columns, "v_act [mm/s]"]), comments="", fmt="%.10g")
        done = identify.run(identify.request(path, friction="directional", channels=channels))
        return done.judgment, str(done.verdict)

    for given in (None, channels):
        judgment, why = judged(velocity, given)
        assert judgment is Judgment.SCALES_IN_DOUBT
        assert "the rate of change of 'x_act' is 0.9804 times 'v_act'" in why
    # a velocity that was not recorded at all times says nothing, and does not refuse the log
    velocity[100] = np.nan
    assert judged(velocity, channels)[0] is Judgment.USE_VALUES


def test_each_axis_of_several_logs_is_pooled_by_its_own_columns(tmp_path: Path, logs: fa.Logs) -> None:
    files = []
    for i in (0, 1):
        log, other = logs.log(i), logs.log(2 - i)
        columns = {"time [s]": log["time"]}
        for axis, one, times in (("X1", log, 1.0), ("Y1", other, 1.5)):
            columns[f"{axis}_ActualPosition [mm]"] = 1e3 * one["position"]
            columns[f"{axis}_Force [N]"] = times * one["force"]
        files.append(tmp_path / f"{'ab'[i]}.csv")
        table = np.column_stack(list(columns.values()))
        np.savetxt(files[-1], table, delimiter=";", header=";".join(columns), comments="", fmt="%.10g")
    done = identify.run(identify.request(tuple(files), axis="all", friction="directional", out=tmp_path / "out"))
    mass = float(logs.true("mass", 0))
    assert {axis: found["mass"].value / mass for axis, found in done.result.items()} == pytest.approx(
        {"x1": 1.0, "y1": 1.5}, rel=0.01
    )
    assert (tmp_path / "out" / "y1" / "machine.toml").exists()

"""Injected forces in the log of a job: their unit, their scale, and what the logged command holds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from feeddrive.blocks.load.recorded_force import RecordedForce
from feeddrive.blocks.reference.sine import Sine
from feeddrive.files.job import read_job
from feeddrive.files.machine import read_machine
from feeddrive.jobs.run_laws import JobResult, run_laws
from feeddrive.language.errors import LogError
from feeddrive.loop.simulate import simulate
from feeddrive.workflow.identify import identify
from feeddrive.workflow.identify_responses import IdentifyRequest

K = 35.15065188248547  # N for each V of the machine emps


def pulsed(folder: Path, roles: str, *, contained: bool = False) -> JobResult:
    """A job on the log of a simulated run with pulses of 1 V at the drive, logged in V."""
    loop = read_machine("emps").loop("x")
    T = float(loop.sample_time)
    move = Sine(amplitude=0.02, frequency=0.5, cycles=1, blend_time=0.4)
    rows = int(move.duration / T) + 1
    pulses = np.where((np.arange(rows) // 100) % 3 == 1, 1.0, 0.0)
    run = simulate(loop, move, load=RecordedForce(force=K * pulses, sample_time=T), duration=(rows - 1) * T)
    command = run["force"] / K + (pulses if contained else 0.0)
    table = np.column_stack([run.time, run["set_position"], run["position_load"], command, pulses[: run.time.size]])
    head = "t_s,r_m,x_m,u,pulses"
    np.savetxt(folder / "run.csv", table, delimiter=",", header=head, comments="", fmt="%.12g")
    log = '[log]\nfile = "run.csv"\nskip_samples = 300\n[log.channels]\nsetpoint_position = "r_m"\n'
    (folder / "job.toml").write_text(f'machine = "emps"\naxis = "x"\n{log}{roles}')
    return run_laws(read_job(folder / "job.toml"))


MEASURED = 'position_load = "x_m"\ncommand = "u"\n'


def test_an_injected_force_without_a_unit_is_asked_about(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"'pulses' \(load_force\) states no unit.*unit = 'N'.*excitation = 'pulses'"):
        pulsed(tmp_path, MEASURED + 'load_force = "pulses"\n')


def test_an_excitation_acts_in_the_unit_of_the_command(tmp_path: Path) -> None:
    """The run comes back to what twelve digits of the log leave, where without the pulses it would be 10 um off."""
    found = pulsed(tmp_path, MEASURED + 'excitation = "pulses"\n')
    again = found.rows[0].replay
    assert again is not None
    # after 0.3 s, when the guessed start is forgotten; the encoder of 50 nm is read again with other rounding
    assert again.rms("position_load") < 0.1e-6
    assert again.share("force") < 0.02
    facts = found.contents().facts
    assert facts["Load"] == "excitation of the log, column 'pulses'"
    assert any("acts at the drive" in each for each in found.remarks)
    assert not any("times as large" in each for each in found.remarks)


def test_a_command_that_holds_the_pulses_is_seen(tmp_path: Path) -> None:
    found = pulsed(tmp_path, MEASURED + 'excitation = "pulses"\n', contained=True)
    again = found.rows[0].replay
    assert again is not None
    assert again.contained
    assert again.share("force") < 0.02
    assert any("holds the injected one" in each for each in found.remarks)


@pytest.mark.parametrize("place", ["before", "behind"])
def test_before_or_behind_the_limit_is_told_where_the_limit_cuts(place: str, tmp_path: Path) -> None:
    """The axis emps with a limit of 100 N and pulses of 1 V, 35 N; the excess over the limit acts only behind it."""
    machine = read_machine("emps")
    text = machine.file.text.replace("force_limit_N = 351.5065188248547", "force_limit_N = 100")
    (tmp_path / "small.toml").write_text(text, encoding="utf-8")
    loop = read_machine(tmp_path / "small.toml").loop("x")
    limit = float(loop.control.force_limit or 0.0)
    assert limit == pytest.approx(100.0)
    T = float(loop.sample_time)
    move = Sine(amplitude=0.02, frequency=0.5, cycles=1, blend_time=0.4)
    rows = int(move.duration / T) + 1
    pulses = K * np.where((np.arange(rows) // 100) % 3 == 1, 1.0, 0.0)
    acting, run = pulses, None
    for _ in range(12):  # what acts behind the limit, from the requests of the run before
        run = simulate(loop, move, added_force=RecordedForce(force=acting, sample_time=T), duration=(rows - 1) * T)
        u = run["requested"]
        if place == "before":
            acting = np.clip(u + pulses, -limit, limit) - np.clip(u, -limit, limit)
    assert run is not None
    cut = np.abs(run["requested"] + pulses) > limit
    assert 0.01 < np.mean(cut) < 0.5
    if place == "before":  # the run is the one of a drive that limits the sum, sample by sample
        total = np.clip(run["requested"], -limit, limit) + acting
        assert total == pytest.approx(np.clip(run["requested"] + pulses, -limit, limit))
    table = np.column_stack([run.time, run["set_position"], run["position_load"], run["force"], pulses])
    np.savetxt(tmp_path / "run.csv", table, delimiter=",", header="t_s,r_m,x_m,f_N,a_N", comments="", fmt="%.12g")
    (tmp_path / "job.toml").write_text(
        'machine = "small.toml"\n[log]\nfile = "run.csv"\nskip_samples = 300\n[log.channels]\n'
        'setpoint_position = "r_m"\nposition_load = "x_m"\nforce = "f_N"\n'
        'excitation = { column = "a_N", unit = "N" }\n',
        encoding="utf-8",
    )
    found = run_laws(read_job(tmp_path / "job.toml"))
    said = next(each for each in found.remarks if "acts at the drive" in each)
    assert f"at the drive, {place} the limit of the force" in said
    assert "as is taken here" not in said
    again = found.rows[0].replay
    assert again is not None
    assert again.rms("position_load") < 0.2e-6


def test_the_scale_of_an_injected_force_is_found(tmp_path: Path) -> None:
    """Volts that are called newtons: 35.15 times too small, to the 5 % that friction makes of a linear answer."""
    found = pulsed(tmp_path, MEASURED + 'load_force = { column = "pulses", unit = "N" }\n')
    said = next(each for each in found.remarks if "times as large" in each)
    assert float(said.split("best ")[1].split(" times")[0]) == pytest.approx(K, rel=0.05)
    assert "the motor's force per unit of the command" in said


def test_a_log_of_set_positions_alone_is_a_reference_and_unused_columns_are_said(tmp_path: Path) -> None:
    found = pulsed(tmp_path, 'command = "u"\n')
    assert found.rows[0].replay is None
    assert found.rows[0].rms("following_error") > 0.0
    assert any("its set positions are the reference" in each for each in found.remarks)
    assert any("Named and not used: command ('u')" in each for each in found.remarks)


def test_identify_says_which_named_columns_it_does_not_use(tmp_path: Path) -> None:
    pulsed(tmp_path, MEASURED + 'load_force = { column = "pulses", factor = 35.15 }\n')
    request = IdentifyRequest(tmp_path / "run.csv", machine="emps", channels=tmp_path / "job.toml")
    found = identify.run(request)
    said = next(each for each in found.remarks if "amed and not used" in each)
    assert "load_force ('pulses'): what was injected there counts as error of the fit" in said

"""An axis that turns, from its log to a tuned loop: rad, N m and kg m2, and the laws as they are."""

from __future__ import annotations

import html
import json
import math
import re
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.files.machine import BUNDLED, machine_toml, read_machine
from feeddrive.files.run_files import summary_text
from feeddrive.language import tree
from feeddrive.language.errors import FeeddriveError, ParameterError, StructureError
from feeddrive.language.units import turning, turning_docstring
from feeddrive.loop.machine import Machine
from feeddrive.loop.simulate import simulate
from feeddrive.workflow.certify import certify
from feeddrive.workflow.command import Outcome, fields_of
from feeddrive.workflow.excite import excite
from feeddrive.workflow.force import force
from feeddrive.workflow.identify import identify, machine_text
from feeddrive.workflow.run_job import run, summary
from feeddrive.workflow.tune import tune
from feeddrive.workflow.tune_sources import in_metres

FILE = BUNDLED / "machines" / "rotary_table.toml"


@cache
def columns() -> np.ndarray:
    """Time in s, set angle and angle in deg, torque in N m, of moves of a radian to and fro."""
    loop = read_machine("rotary_table").loop("c")
    move = SnapLimitedMove(
        distance=1.0,
        velocity=2.0,
        acceleration=20.0,
        jerk=400.0,
        snap=20e3,
        back=True,
        dwell_before=0.1,
        dwell_between=0.1,
        dwell_after=0.1,
    )
    run = simulate(loop, move, record=("set_position", "reading_load", "force"))
    degrees = 180.0 / np.pi
    return np.column_stack([run.time, degrees * run["set_position"], degrees * run["reading_load"], run["force"]])


def log(folder: Path) -> Path:
    path = folder / "log.csv"
    heads = "t,set_angle [deg],angle [deg],torque [Nm]"
    np.savetxt(path, columns(), delimiter=",", fmt="%.12g", header=heads, comments="")
    return path


JOB = """
title = "pulled with 20 N m"
rule = "as in the shop: 5 N more"
machine = "rotary_table"
[reference]
kind = "snap_limited_move"
distance_deg = 20
velocity_rpm = 15
acceleration = 20
jerk = 400
snap = 2e4
[load]
kind = "step_force"
force_N_m = 20
start = 0.1
[[law]]
name = "stiffer"
set = { "axis.c.control.law.Kv" = 80.0 }
"""
# a unit of an axis that moves along, as a word of its own
LINEAR = re.compile(r"(?<![\w./(])(?:[mnuµ]?m|N|kg)(?:/[a-zµ0-9]+)?(?![\w.])(?! m\b)(?! s?/?rad)(?! m2)(?! m s)")


def spoken(page: Path) -> str:
    """What a page says, without the files that it quotes."""
    text = re.sub(r"<(pre|style|title)\b.*?</\1>", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    return html.unescape(re.sub(r"<[^>]*>", "\n", text)).replace("\u2060", "")


def linear_units(text: str) -> list[str]:
    """What in a text names m, N or kg, with what stands around it."""
    text = re.sub(r"\bN m\b|\bkg m2\b", "", text)
    return [text[max(0, found.start() - 30) : found.end() + 10] for found in LINEAR.finditer(text)]


def shown(outcome: Outcome[Any]) -> str:
    """All that a command shows."""
    return "\n".join(str(each) for each in outcome.shown())


@pytest.mark.parametrize(
    ("said", "turned"),
    [
        ("RMS um, peak 3.2 um at 5 N", "RMS urad, peak 3.2 urad at 5 N m"),
        ("force\n(N)", "force\n(N m)"),
        ("snap nm s^1/2/N", "snap nrad s^1/2/(N m)"),
        ("stiffness N/µm", "stiffness N m/µrad"),
        ("12 N m and 3 kg m2", "12 N m and 3 kg m2"),
        ("in (m/s)/N, 1 N s/m", "in (rad/s)/(N m), 1 N m s/rad"),
        ("at 5 N. So m = 2 kg of run.mm.csv", "at 5 N m. So m = 2 kg m2 of run.mm.csv"),
        ("2 Hz, 3 ms, Ms 1.2", "2 Hz, 3 ms, Ms 1.2"),
    ],
)
def test_words_of_an_axis_that_turns(said: str, turned: str) -> None:
    assert turning_docstring(said) == turned
    assert turning_docstring(turned) == turned  # once is enough


def test_what_a_person_wrote_stays() -> None:
    assert [turning(each) for each in ("N2", "J/m3", "", "1/m")] == ["N2", "J/m3", "", "1/rad"]


def test_a_run_says_its_units() -> None:
    loop = read_machine("rotary_table").loop("c")
    run_ = simulate(loop, fd.blocks.LinearMove(distance=0.1, travel_time=0.05))
    assert [run_.units[each] for each in ("force", "set_position", "velocity_load")] == ["N m", "rad", "rad/s"]
    assert "urad" in repr(run_)
    assert not linear_units(repr(run_))
    figure = run_.plot()
    assert not linear_units("\n".join(each.get_text() for each in figure.findobj(lambda a: hasattr(a, "get_text"))))
    together = simulate(Machine.of({"c": loop}), {"c": fd.blocks.LinearMove(distance=0.1, travel_time=0.05)})
    assert together.units["c.force"] == "N m"
    straight = simulate(read_machine("emps").loop(None), fd.blocks.LinearMove(distance=0.01, travel_time=0.05))
    assert straight.units["force"] == "N"


WRITTEN = "made up: inertia and torques of the size that catalogues give for direct-drive tables of 400 mm"


def test_a_job_on_an_axis_that_turns(tmp_path: Path) -> None:
    """Degrees and N m in the job; table and summary have no m and no N, but for what a person wrote."""
    (tmp_path / "job.toml").write_text(JOB, encoding="utf-8")
    done = run.run(run.request(tmp_path / "job.toml"))
    assert done.result.job.reference is not None
    assert done.result.job.reference.distance == pytest.approx(np.pi / 9.0)  # type: ignore[attr-defined]
    assert "peak urad" in shown(done)
    assert not linear_units(shown(done).replace("as in the shop: 5 N more", ""))
    figures = json.loads(summary_text(summary(done.result), rotary=True, quoted=done.result.quoted))
    assert figures["source"] == WRITTEN
    names = set(figures["laws"]["today"])
    assert {"force_peak_N_m", "following_error_rms_rad", "stiffness_least_N_m_per_rad"} <= names
    assert not [each for each in names if re.search(r"(?<!_N)_m$|_N$", each)]
    (tmp_path / "job.toml").write_text(JOB.replace("distance_deg = 20", "distance_mm = 20"), encoding="utf-8")
    with pytest.raises(ParameterError, match="'mm' does not measure the same thing as 'rad'"):
        run(tmp_path / "job.toml")


def test_a_measured_response_in_mdeg_per_newton_meter() -> None:
    """A pure inertia of 0.8 kg m2 in mdeg/(N m) is that in rad/(N m); on a linear axis it is refused."""
    f = np.geomspace(5.0, 400.0, 60)
    inertia = -1.0 / (0.8 * (2.0 * np.pi * f) ** 2)
    measured = fd.FRF(f, np.degrees(1e3 * inertia), "torque", "angle", "mdeg/(N m)", 5e-4)
    assert in_metres("table.csv", measured, None, turns=True).response == pytest.approx(inertia, rel=1e-12)
    speed = fd.FRF(f, 2j * np.pi * f * inertia, "torque", "speed", "rad/s/(N m)", 5e-4)
    assert in_metres("table.csv", speed, None, turns=True).response == pytest.approx(inertia, rel=1e-12)
    with pytest.raises(ParameterError, match=r"must be position .*, or give the machine of an axis that turns"):
        in_metres("table.csv", measured, None, turns=False)
    with pytest.raises(ParameterError, match=r"must be angle .* over torque .*, since the axis turns"):
        in_metres("table.csv", fd.FRF(f, inertia, unit="um/N"), None, turns=True)


@pytest.mark.slow(reason="pages with all their pictures")
def test_pages_of_an_axis_that_turns(tmp_path: Path) -> None:
    (tmp_path / "job.toml").write_text(JOB, encoding="utf-8")
    run(tmp_path / "job.toml", out=tmp_path / "out")
    report = spoken(tmp_path / "out" / "report.html")
    for each in ("as in the shop: 5 N more", WRITTEN):
        assert each in report
        report = report.replace(each, "")
    assert not linear_units(report)
    head = (tmp_path / "out" / "runs" / "today.csv").read_text(encoding="utf-8").splitlines()[0]
    assert "force [N m]" in head
    assert "set_position [rad]" in head
    done = certify.run(certify.request("rotary_table", out=tmp_path / "certified"))
    assert not linear_units(shown(done))
    assert not linear_units(spoken(tmp_path / "certified" / "report.html"))
    sent = excite.run(excite.request("rotary_table", band="5..200", amplitude=40.0, out=tmp_path / "sent"))
    assert "peak 40 N m" in shown(sent)
    assert not linear_units(shown(sent))
    assert not linear_units(spoken(tmp_path / "sent" / "report.html").replace(WRITTEN, ""))
    head = (tmp_path / "sent" / "excitation_1.csv").read_text(encoding="utf-8").splitlines()[0]
    assert head == "time [s],excitation [N m],set_position [rad]"


@pytest.mark.parametrize("target", ["c", "st"])
def test_an_export_names_rad_and_newton_meters(tmp_path: Path, target: str) -> None:
    fd.workflow.export("rotary_table", target=target, out=tmp_path / "out")
    text = (tmp_path / "out" / "README.md").read_text(encoding="utf-8")
    assert "N m s/rad" in text
    assert not linear_units(text)


@pytest.mark.parametrize("target", ["linuxcnc", "linuxcnc-pid"])
def test_a_target_in_mm_is_refused(tmp_path: Path, target: str) -> None:
    with pytest.raises(ParameterError, match="axis c turns, and this target is written for axes that move along"):
        fd.workflow.export("rotary_table", target=target, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_parameters_of_an_axis_that_turns_are_those_at_its_motor(tmp_path: Path) -> None:
    law = read_machine("rotary_table").loop("c").control.law
    fd.workflow.export("rotary_table", target="parameters", out=tmp_path / "out")
    text = (tmp_path / "out" / "sinumerik.txt").read_text(encoding="utf-8")
    found = {name: float(value) for name, value in re.findall(r"(?m)^(\S.*?) = (\S+)$", text) if name[0] != ";"}
    # six digits are written
    assert found["p1460[0]"] == pytest.approx(law.Kp, rel=5e-6)
    assert found["MD32200 $MA_POSCTRL_GAIN[0]"] == pytest.approx(0.06 * law.Kv, rel=5e-6)
    assert not linear_units(text)
    assert not linear_units((tmp_path / "out" / "twincat.txt").read_text(encoding="utf-8"))
    assert "No file: linuxcnc is written in mm" in (tmp_path / "out" / "README.md").read_text(encoding="utf-8")
    with pytest.raises(ParameterError, match="linuxcnc is written in mm, and the axis turns"):
        fd.workflow.export("rotary_table", target="parameters", maker=("linuxcnc",), out=tmp_path / "other")


def test_units_of_a_file_are_those_of_an_axis_that_turns(tmp_path: Path) -> None:
    text = FILE.read_text(encoding="utf-8")
    path = tmp_path / "table.toml"
    for old, new, said in (
        ("mass_kg_m2 = 0.8", "mass_kg = 0.8", "unit 'kg' does not measure the same thing as 'kg m2'"),
        ("mass_kg_m2 = 0.8", "mass = -1.0", "mass = -1 kg m2 (all that moves, seen at the table) must be > 0 kg m2"),
        ("mass_kg_m2 = 0.8", "", "rigid needs mass (kg m2"),
        ("rotary = true", "rotary = false", "unit 'kg_m2' does not measure the same thing as 'kg'"),
    ):
        path.write_text(text.replace(old, new), encoding="utf-8")
        with pytest.raises(ParameterError) as caught:
            read_machine(path)
        assert said in str(caught.value)
    screw = '"screw_rigid"\nlead = 0.01\nmass = 1.0\ninertia_motor = 1e-3\ninertia_screw = 1e-3'
    path.write_text(text.replace('"rigid"\nmass_kg_m2 = 0.8', screw), encoding="utf-8")
    with pytest.raises((ParameterError, StructureError), match="a screw moves along its lead"):
        read_machine(path)


def test_a_file_that_is_written_is_read_back_and_names_its_units(tmp_path: Path) -> None:
    loop = read_machine("rotary_table").loop("c")
    text = machine_toml(Machine.of({"c": loop}), "again")
    path = tmp_path / "again.toml"
    path.write_text(text, encoding="utf-8")
    assert repr(read_machine(path).loop("c")) == repr(loop)
    for said in ("# kg m2: all that moves", "# N m s/rad: velocity gain", "# N m: "):
        assert said in text
    for line in text.splitlines():
        assert "# kg:" not in line
        assert "# N:" not in line
        assert "# m:" not in line


def test_a_log_of_angle_and_torque_becomes_a_machine_file(tmp_path: Path) -> None:
    """Without noise, by inverse dynamics with its filters: 1 % of the inertia, 5 % of the friction."""
    found = identify(log(tmp_path), rotary=True, axis="c", machine="rotary_table")
    assert found.recommendation.startswith("Use these values")
    assert " urad RMS" in found.recommendation
    assert found.rigid["mass"].unit == "kg m2"
    assert found.rigid["mass"].value == pytest.approx(0.8, rel=0.01)
    text = machine_text(found, read_machine("rotary_table"), "c")
    assert text is not None
    assert "mass_kg_m2 = 0.8" in text or "mass_kg_m2 = 0.79" in text
    assert "standard error" in text
    (tmp_path / "machine.toml").write_text(text, encoding="utf-8")
    loop = read_machine(tmp_path / "machine.toml").loop("c")
    assert loop.axis.rotary
    assert tree.get(loop, "axis.c.friction_load.coulomb") == pytest.approx(6.0, rel=0.05)
    assert tree.declaration(loop, "axis.c.friction_load.viscous").unit == "N m s/rad"


def test_what_does_not_fit_an_axis_that_turns_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="--lead belongs to a screw"):
        identify(log(tmp_path), rotary=True, lead=0.01)
    path = tmp_path / "linear.csv"
    np.savetxt(path, columns()[:, [0, 2, 3]] * [1.0, 1e-3, 1.0], delimiter=",", header="t,pos_m,force_N", comments="")
    with pytest.raises(ParameterError, match="the axis turns, and the log has a position in m"):
        identify(path, rotary=True)


@pytest.mark.slow(reason="a search of gains with certificate and report")
def test_errors_inside_a_command_are_in_the_units_of_an_axis_that_turns(tmp_path: Path) -> None:
    """A table that reaches its limit; a job at whose 5th sample it diverges; the same of an axis that does not turn."""
    with pytest.raises(FeeddriveError) as refused:
        excite(FILE, band="10..100", amplitude=300.0)
    assert not linear_units(str(refused.value)), refused.value
    assert "N m" in str(refused.value)
    with pytest.raises(FeeddriveError) as moving:
        certify(FILE, velocity=math.nan)
    assert not linear_units(str(moving.value)), moving.value
    with pytest.raises(FeeddriveError) as other:
        excite("ball_screw", band="10..100", amplitude=6000.0)
    assert re.search(r"\d N[ ,;.:]", str(other.value)), other.value


def test_help_has_both_units() -> None:
    said = {each.name: each.help() for each in fields_of(excite.request)}  # type: ignore[arg-type]
    assert "(N; N m of an axis that turns)" in said["force"]
    assert "(m; rad of an axis that turns)" in said["travel"]
    given = {each.name: each.help() for each in fields_of(force.request)}  # type: ignore[arg-type]
    assert "axis that turns" not in given["lead"] + given["motor_constant"]


@pytest.mark.slow(reason="a whole identification and tuning of a rotary axis: 12 s; the way of a linear one is quick")
def test_the_way_from_the_log_to_a_tuned_loop(tmp_path: Path) -> None:
    identify(log(tmp_path), machine="rotary_table", axis="c", out=tmp_path / "found")
    machine = tmp_path / "found" / "machine.toml"
    done = tune.run(tune.request(str(machine), starts=1, out=tmp_path / "tuned"))
    assert not done.judgment.bad
    assert not linear_units(shown(done))
    assert not linear_units(spoken(tmp_path / "tuned" / "report.html").replace("table of 400 mm", ""))
    text = (tmp_path / "tuned" / "machine.toml").read_text(encoding="utf-8")
    after = read_machine(tmp_path / "tuned" / "machine.toml").loop("c")
    assert after.axis.rotary
    assert "Kp = " in text
    assert float(after.control.law.Kp) > 0.0  # type: ignore[attr-defined]

"""Units, factors, signs, leads and sample times that are typed count where they are used, or are refused."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from feeddrive.blocks.actuator.direct import Direct
from feeddrive.blocks.actuator.screw import Screw
from feeddrive.files.frf import read_frf
from feeddrive.files.job import read_job
from feeddrive.files.machine import read_machine
from feeddrive.jobs.measured import measured_signals
from feeddrive.language import tree
from feeddrive.language.errors import FeeddriveError, LogError, ParameterError
from feeddrive.language.progress import Progress
from feeddrive.studio.desk import Asked
from feeddrive.studio.rooms.import_ import Import
from feeddrive.studio.server import Session
from feeddrive.workflow import frf, identify
from feeddrive.workflow.drive_logs import drive_with
from plain_drive import Cascade, PlainAxis, write_columns

AXIS, LEAD = PlainAxis(mass=310.0, viscous=900.0, coulomb=120.0), 0.016
RADIANS = 2.0 * np.pi / LEAD
# the law that ran, and a motor whose constant is for A
MACHINE = f"""sample_time_ms = 1
[axis.x.plant]
kind = "rigid"
mass = 200
[axis.x.friction_load]
kind = "coulomb"
coulomb = 50
[axis.x.actuator.motor]
kind = "screw"
torque_constant = 1.5
lead = {LEAD}
[axis.x.control.law]
kind = "cascade_ppi"
Kv = 28
Kp = 15e3
velocity_feedforward = 0
"""


@cache
def run() -> dict[str, np.ndarray]:
    return AXIS.run(Cascade(28.0, 15e3))


def logged(folder: Path, head: str, per_newton: float, **more: np.ndarray) -> Path:
    """A log with the force under a head, as so much of it for each newton."""
    columns = {"t [s]": run()["time"], "xs [mm]": 1e3 * run()["set"], "x [mm]": 1e3 * run()["position"]}
    return write_columns(folder / "log.csv", {**columns, head: per_newton * run()["force"], **more})


NAMED = {"set_position": "xs:mm", "position": "x:mm"}


@pytest.mark.parametrize(
    ("unit", "by_motor", "by_typed"),
    [
        ("N", 1.0, 40.0),
        ("kN", 1000.0, 40.0),
        ("N m", RADIANS, 40.0),
        ("mN m", 1e-3 * RADIANS, 40.0),
        ("", 1.5 * RADIANS, 40.0),
        ("A", 1.5 * RADIANS, 40.0),
        ("percent", 1.5 * RADIANS, 40.0),
    ],
)
def test_one_of_a_command_in_newtons(tmp_path: Path, unit: str, by_motor: float, by_typed: float) -> None:
    """A typed constant, then the unit of the column, then the motor, whose constant is for the drive's own unit."""
    (tmp_path / "m.toml").write_text(MACHINE, encoding="utf-8")
    loop = read_machine(tmp_path / "m.toml").loop("x")
    assert isinstance(loop.axis.actuator.motor, Screw)
    assert drive_with(None, loop, None).force_per_unit(unit) == pytest.approx(by_motor, rel=1e-12)
    assert drive_with(None, loop, None, 40.0).force_per_unit(unit) == by_typed
    alone = drive_with(None, None, None).force_per_unit(unit)
    assert alone == (pytest.approx(by_motor) if unit in ("N", "kN") else None)
    bare = tree.vary(read_machine("linear_motor").loop(None), {})
    assert isinstance(bare.axis.actuator.motor, Direct)
    assert drive_with(None, bare, None).force_per_unit("N m") is None  # of no screw


@pytest.mark.parametrize(
    ("head", "named", "machine"),
    [
        ("M_soll [Nm]", {"torque": "M_soll"}, False),
        ("M", {"torque": "M*1e-3:kNm"}, False),
        ("M_soll [Nm]", {"command": "M_soll"}, False),
        ("M_soll [Nm]", {"command": "M_soll"}, True),
    ],
)
def test_a_torque_beside_a_position_is_put_at_the_table(
    tmp_path: Path, head: str, named: dict[str, str], machine: bool
) -> None:
    """By the lead that is typed, or that of the machine file, whose constant of the motor has no part in it."""
    log = logged(tmp_path, head, 1.0 / RADIANS)
    (tmp_path / "m.toml").write_text(MACHINE, encoding="utf-8")
    more: dict[str, Any] = {"machine": tmp_path / "m.toml"} if machine else {"lead": LEAD}
    found = identify(log, **NAMED, **named, **more)
    assert found.recommendation.startswith("Use these values")
    # integrated in twentieths of a sample
    assert found.rigid["mass"].value == pytest.approx(AXIS.mass, rel=1e-3)
    assert found.loop is not None


def test_an_angle_beside_a_force_is_put_at_the_table(tmp_path: Path) -> None:
    log = logged(tmp_path, "F", 1.0, theta=np.degrees(RADIANS * run()["position"]))
    found = identify(log, angle="theta:deg", force="F:N", lead=LEAD)
    assert found.log.frame.position == "m"
    assert found.rigid["mass"].value == pytest.approx(AXIS.mass, rel=1e-3)


def test_without_a_lead_it_says_which_is_which(tmp_path: Path) -> None:
    log = logged(tmp_path, "M [Nm]", 1.0 / RADIANS, theta=np.degrees(RADIANS * run()["position"]))
    with pytest.raises(ParameterError, match=r"log\.csv: position_load is in m and torque in N m: .* with --lead"):
        identify(log, position="x", torque="M")
    with pytest.raises(ParameterError, match=r"angle_motor is in rad and command in N: .* with --lead"):
        identify(log, angle="theta:deg", command="M*1:V", force_constant=RADIANS)
    assert identify(log, angle="theta:deg", torque="M").log.rotary  # both of the shaft need none


def test_a_torque_without_a_unit_is_asked_about_beside_a_position_too(tmp_path: Path) -> None:
    log = logged(tmp_path, "M", 1.0 / RADIANS)
    with pytest.raises(LogError, match=r"'M' states no unit, and drives log a torque in N m or in percent"):
        identify(log, **NAMED, torque="M", lead=LEAD)


def test_a_command_in_newton_meters_in_a_job_is_no_current(tmp_path: Path) -> None:
    log = logged(tmp_path, "M", 1.0 / RADIANS, kick=np.full(run()["time"].size, 0.02))
    (tmp_path / "m.toml").write_text(MACHINE, encoding="utf-8")
    (tmp_path / "job.toml").write_text(
        f'machine = "m.toml"\n[log]\nfile = "{log.name}"\n[log.channels]\ntime = "t"\n'
        'setpoint_position = "xs"\nposition_load = "x"\ncommand = { column = "M", unit = "Nm" }\n'
        'excitation = { column = "kick", unit = "kN" }\n',
        encoding="utf-8",
    )
    job = read_job(tmp_path / "job.toml")
    assert job.log is not None
    found = measured_signals(job, job.log.read())
    np.testing.assert_allclose(found["force"], run()["force"], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found["added_force"], 20.0)


def test_units_in_the_spelling_of_makers_are_known_where_the_sizes_are_judged(tmp_path: Path) -> None:
    columns = {"t": run()["time"], "theta": np.degrees(RADIANS * run()["position"]), "M": 1e7 * run()["force"]}
    log = write_columns(tmp_path / "log.csv", columns)
    assert "torque is" in identify(log, angle="theta:°", torque="M:Nm").doubt
    with pytest.raises(LogError, match=r"'theta' states no unit, and the torque is"):
        identify(log, angle="theta", torque="M:Nm")


def test_samples_that_do_not_count_are_left_out_with_a_channels_file(tmp_path: Path) -> None:
    """The first rows of this log are of another axis."""
    force = np.concatenate([np.full(90, 3e4), run()["force"][90:]])
    log = logged(tmp_path, "F [N]", 0.0, f=force)
    roles = tmp_path / "roles.toml"
    text = (
        '[log.channels]\ntime = "t"\nsetpoint_position = "xs"\nposition_load = "x"\n'
        'force = { column = "f", unit = "N" }\n'
    )
    roles.write_text(f'[log]\nfile = "log.csv"\nskip_samples = 90\n{text}', encoding="utf-8")
    found = identify(log, channels=roles)
    assert found.log.position.size == force.size - 90
    assert found.rigid["mass"].value == pytest.approx(AXIS.mass, rel=1e-3)
    roles.write_text(f'[log]\nfile = "log.csv"\nskip_samples = 9999\n{text}', encoding="utf-8")
    with pytest.raises(LogError, match=r"log\.csv: has 2400 rows, and skip_samples = 9999 leaves none of them"):
        identify(log, channels=roles)


def test_a_factor_means_the_same_to_frf_as_to_all_others(tmp_path: Path) -> None:
    random = np.random.default_rng(1)
    force = 100.0 * random.standard_normal(4000)
    x = np.cumsum(np.convolve(force, 1e-5 * 0.9 ** np.arange(200.0))[:4000]) * 1e-3
    log = write_columns(tmp_path / "log.csv", {"t": 1e-3 * np.arange(4000), "f [N]": force, "x [mm]": 1e3 * x})

    def response(output: str) -> np.ndarray:
        frf(log, input="f", output=output, method="h1", out=tmp_path / "out")
        found = read_frf(tmp_path / "out" / "frf.csv")
        assert found.unit == "m/N"
        return found.response

    plain = response("x")
    for same in ("x*0.001", "x*1:mm", "x*0.001:m"):
        np.testing.assert_allclose(response(same), plain, rtol=1e-12)
    np.testing.assert_allclose(response("x*-1:mm"), -plain, rtol=1e-12)
    with pytest.raises(LogError, match=re.escape("take its numbers for m: state the unit too, as x*-1.0:mm")):
        response("x*-1")


def test_all_fields_of_the_page_are_in_its_request(tmp_path: Path) -> None:
    """The unit of a response, and the sample time of logs of which a response is estimated."""
    session = Session(tmp_path)
    work: list[Any] = []

    def start(_room: str, _what: str, given: Any, then: Any, *_: Any) -> None:
        work.append(given)
        if not given.args or isinstance(given.args[0], list):  # files are read
            then(given(Progress()))

    session.desk.start = start  # type: ignore[method-assign]
    f = np.geomspace(3.0, 400.0, 60)
    h = 1e6 / (300.0 * (2j * np.pi * f) ** 2)
    rows = "".join(f"{a},{b.real},{b.imag}\n" for a, b in zip(f, h, strict=True))
    (tmp_path / "axis.csv").write_text(f"f_Hz,re,im\n{rows}", encoding="utf-8")
    session.desk.files = {"axis.csv": tmp_path / "axis.csv", "log.csv": logged(tmp_path, "F [N]", 1.0)}
    for do, more in (
        ("look", {"names": ["axis.csv", "log.csv"]}),
        ("identify", {"name": "axis.csv", "unit": "um/N"}),
        ("estimate", {"name": "log.csv", "sample_time": 0.001}),
    ):
        said = session.answer({"number": 1, "do": f"import.{do}", **more})
        assert re.search(rb'"error": ?"[^"]', said) is None, said
    _, identified, estimated = work
    assert identified.args[1].unit == ("um/N",)
    assert estimated.args[1].sample_time == 0.001


def test_what_is_refused_on_the_page_names_the_column(tmp_path: Path) -> None:
    session = Session(tmp_path)
    session.desk.files = {"log.csv": logged(tmp_path, "F [%]", 1.0)}
    bring = session.rooms["import"]
    assert isinstance(bring, Import)
    session.desk.start = lambda _room, _what, work, then, *_: then(work(Progress()))  # type: ignore[method-assign]
    bring.do("look", Asked({"names": ["log.csv"]}))
    for typed, message in (
        ({"factor": "1.2,3"}, "factor must be a number"),
        ({"factor": 0}, "factor = 0 must be a finite number"),
        ({"unit": "percent", "factor": 12}, "'percent' does not measure .* a factor from it to N is stated without a"),
    ):
        with pytest.raises(FeeddriveError, match=message):
            bring.do("role", Asked({"name": "log.csv", "column": "F", "role": "force", **typed}))

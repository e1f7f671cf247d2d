"""Logs in wrong units, with wrong signs or of no motion: each ends with its reason, none in "Use these values"."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from drive_logs import T, simulated
from feeddrive.files.read_log import read_log
from feeddrive.identification.motion.identify import identify_motion
from feeddrive.identification.motion.motion_log import MotionLog
from feeddrive.language.errors import FeeddriveError, LogError, NotIdentifiableError, ParameterError
from feeddrive.loop.frequency_response import FRF
from feeddrive.workflow.channels import channels
from feeddrive.workflow.cogging import cogging
from feeddrive.workflow.command import Outcome
from feeddrive.workflow.force import force
from feeddrive.workflow.frf import frf
from feeddrive.workflow.friction import friction
from feeddrive.workflow.identify import identify
from feeddrive.workflow.learn import iterate, prefilter
from feeddrive.workflow.tune import tune

EMPS = Path(__file__).parents[2] / ".." / "shared" / "data" / "emps" / "DATA_EMPS.mat"
needs_emps = pytest.mark.skipif(not EMPS.exists(), reason=f"the measured EMPS log is not there: {EMPS}")


class Signals(NamedTuple):
    """Time, set position, position and force."""

    t: np.ndarray
    r: np.ndarray
    x: np.ndarray
    f: np.ndarray


def signals(seed: int = 1) -> Signals:
    """Time, set position, position and force of the simulated axis of 95 kg, SI."""
    log = simulated(size=0.5, seed=seed)
    assert log.set_position is not None
    return Signals(np.arange(log.position.size) * T, log.set_position, log.position, log.force)


def measured() -> Signals:
    """The same of the measured axis; 35.15 N/V."""
    log = read_log(EMPS)
    return Signals(log.time - log.time[0], log["qg"], log["qm"], 35.15 * log["vir"])


def written(folder: Path, heads: str, *columns: np.ndarray) -> Path:
    path = folder / "log.csv"
    np.savetxt(path, np.column_stack(columns), delimiter=",", fmt="%.12g", header=heads, comments="")
    return path


def outcome(path: Path, **options: object) -> Outcome[Any]:
    return identify.run(identify.request(path, **options))  # type: ignore[arg-type]


def refused(path: Path, folder: Path, **options: object) -> str:
    """Why a log was refused; nothing may be written."""
    out = folder / "out"
    with pytest.raises(FeeddriveError) as caught:
        identify(path, out=out, **options)  # type: ignore[arg-type]
    assert not out.exists()
    return str(caught.value)


def noise(t: np.ndarray) -> np.ndarray:
    return np.random.default_rng(0).standard_normal(t.size)


def sine(t: np.ndarray, frequency: float) -> tuple[np.ndarray, np.ndarray]:
    """A millimetre of it, and the force on 95 kg with friction."""
    w = 2.0 * np.pi * frequency
    return 1e-3 * np.sin(w * t), -0.095 * w * w * np.sin(w * t) + 20.0 * np.sign(np.cos(w * t)) + noise(t)


def shifted(values: np.ndarray, rows: int) -> np.ndarray:
    """Each value some rows earlier; the last one is held."""
    return np.concatenate([values[rows:], np.full(rows, values[-1])])


def spiked(force: np.ndarray) -> np.ndarray:
    out = force.copy()
    out[3000] = 1e4
    return out


def jumped(position: np.ndarray) -> np.ndarray:
    """Two single rows off: by 4 m, and by as much as a tenth of the travel."""
    out = position.copy()
    out[3000] += 4.0
    out[4500] -= 0.02
    return out


NAMED = "t,set_pos_m,pos_m,force_N"
# what is wrong, heads, columns made of the right ones, and what must be said
WRONG: dict[str, tuple[str, Callable[[Signals], tuple[np.ndarray, ...]], tuple[str, ...]]] = {
    "mm as m": (
        "t,x_set,x,force",
        lambda s: (s.t, 1e3 * s.r, 1e3 * s.x, s.f),
        ("the speed is 126 m/s", "x in mm, force in N (travel 200 mm", "mass 9", "--unit mm or --unit in"),
    ),
    "um as m": ("t,x_set,x,force", lambda s: (s.t, 1e6 * s.r, 1e6 * s.x, s.f), ("x in um", "--unit um")),
    "kN as N": (
        "t,x_set,x,force",
        lambda s: (s.t, s.r, s.x, s.f / 1e3),
        ("the mass is 0.09", "force in kN", "--unit kN"),
    ),
    "mm, and the head says m": (
        NAMED,
        lambda s: (s.t, 1e3 * s.r, 1e3 * s.x, s.f),
        ("'pos_m' is in m, as the file says", "--position 'pos_m:mm'"),
    ),
    "percent as N m": (
        "t,theta,torque",
        lambda s: (s.t, 628.0 * s.x, s.f / 6.28),
        ("in N m or in percent of the rated one", "--unit 'N m'", "--torque 'torque*FACTOR'"),
    ),
    "a log of HAL": (
        "t,joint.0.motor-pos-cmd,joint.0.motor-pos-fb,force",
        lambda s: (s.t, 1e3 * s.r, 1e3 * s.x, s.f),
        ("HAL knows no units", "in mm, force in N (travel 200 mm", "--unit mm or --unit in"),
    ),
    "inverted force": (NAMED, lambda s: (s.t, s.r, s.x, -s.f), ("sign of force or position is inverted", "'f*-1'")),
    "inverted position": (NAMED, lambda s: (s.t, s.r, -s.x, s.f), ("sign of force or position is inverted",)),
    "swapped": (NAMED, lambda s: (s.t, s.r, s.f, s.x), ("position and force are swapped", "--position 'force_N")),
    "a spike": (NAMED, lambda s: (s.t, s.r, s.x, spiked(s.f)), ("1 spike", "row 3001", "repair these rows")),
    "jumps of the position": (
        NAMED,
        lambda s: (s.t, s.r, jumped(s.x), s.f),
        ("position has 2 jumps there and back", "at row 3001", "repair these rows"),
    ),
    "milliseconds in the head, seconds below": (
        "t [ms],pos_m,force_N",
        lambda s: (s.t, s.x, s.f),
        ("long as its time was read", "--time 't:s'"),
    ),
    "microseconds": ("t,pos_m,force_N", lambda s: (1e6 * s.t, s.x, s.f), ("--time t:us", "unit = 'us'")),
    "percent": (
        "t,pos_m,torque [%]",
        lambda s: (s.t, s.x, s.f / 9.0),
        ("no column can be taken for the force: 'torque' is in percent of a rated torque", "--rated 3.2:Nm"),
    ),
    "amperes": ("t,pos_m,current [A]", lambda s: (s.t, s.x, s.f / 60.0), ("'current' is a current in A",)),
    "counts": (
        "t,x [inc],force_N",
        lambda s: (s.t, s.x / 1e-6, s.f),
        ("taken for the position: 'x' needs a factor, m per inc", "--position 'column*FACTOR'"),
    ),
    "35 Hz": ("t,pos_m,force_N", lambda s: (s.t, *sine(s.t, 35.0)), ("rows are left where the axis moves",)),
    "20 Hz": ("t,pos_m,force_N", lambda s: (s.t, *sine(s.t, 20.0)), ("one frequency",)),
    "rest": (
        "t,pos_m,force_N",
        lambda s: (s.t, 5e-8 * np.round(0.4 * noise(s.t)), noise(s.t)),
        ("rows are left where the axis moves",),
    ),
    "noise": ("t,pos_m,force_N", lambda s: (s.t, noise(s.t), noise(s.t)[::-1]), ("rows are left",)),
    "whole milliseconds": (
        "t,pos_m,force_N",
        lambda s: (1e3 * s.t, s.x, s.f),
        ("sample time of 1 s", "ms (1 ms) and us (0.001 ms)", "--time t:ms"),
    ),
    "milliseconds in a column of another name": (
        "Zeit,pos_m,force_N",
        lambda s: (1e3 * s.t, s.x, s.f),
        ("--time Zeit:ms", "column = 'Zeit', unit = 'ms'"),
    ),
}


@pytest.mark.parametrize("what", WRONG)
def test_a_log_that_is_wrong_ends_with_its_reason_and_writes_nothing(what: str, tmp_path: Path) -> None:
    heads, made, words = WRONG[what]
    said = refused(written(tmp_path, heads, *made(signals())), tmp_path)
    for each in words:
        assert each in said
    assert "Use " not in said


@pytest.mark.parametrize("cell", ["empty", "quoted"])
def test_a_column_that_is_no_numbers_is_named_as_the_reason(cell: str, tmp_path: Path) -> None:
    """Every fourth cell is filled, as of a slower recorder, or a comma stands in quotes."""
    s = signals()
    shown = [
        ("" if k % 4 else f"{x:.9g}") if cell == "empty" else f'"{1e3 * x:.6f}"'.replace(".", ",")
        for k, x in enumerate(s.x[:2000])
    ]
    rows = [f"{t:.9g},{x},{f:.9g}" for t, x, f in zip(s.t, shown, s.f, strict=False)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["t,x_mm,force_N", *rows]) + "\n", encoding="utf-8")
    assert "no column can be taken for the position: 'x_mm' is text (cells that are empty" in refused(path, tmp_path)


def test_a_force_beyond_the_limit_of_the_machine_is_said() -> None:
    """It was called saturated, with the share of the rows beyond the limit."""
    s = signals()
    most = float(np.max(np.abs(s.f)))
    with pytest.raises(NotIdentifiableError, match=r"beyond the limit of .* N that the machine has: one of the two"):
        MotionLog(name="log", position=s.x, force=s.f, sample_time=T, force_limit=0.5 * most)


def test_set_and_actual_position_that_are_swapped_are_said() -> None:
    """The axis seems to feel the force before it acts; the set position that trails says why."""
    s = signals()
    late = np.concatenate([np.full(3, s.x[0]), s.x[:-3]])
    with pytest.raises(NotIdentifiableError, match="set position and position are swapped"):
        identify_motion(MotionLog(name="log", position=shifted(s.x, 3), force=s.f, sample_time=T, set_position=late))


def test_a_machine_file_with_a_law_that_did_not_run_is_no_verdict_to_use() -> None:
    """Kv stated a fifth too large: what it commands at the log's own readings is not the force; the log says its Kv."""
    s = signals()
    log = MotionLog(name="log", position=s.x, force=s.f, sample_time=T, set_position=s.r)
    found = identify_motion(log)
    assert found.recommendation.startswith("Use these values")
    assert found.control is not None
    law = found.control.law()
    wrong = identify_motion(log, law=replace(law, Kv=1.2 * float(law.Kv)))
    told = re.search(r"meets its force best with control\.law\.Kv = ([0-9.]+)", wrong.unusable)
    assert told is not None, wrong.unusable
    assert float(told[1]) == pytest.approx(found.control["Kv"].value, rel=1e-3)
    assert wrong.recommendation.startswith("Do not tune on these values")


def test_a_dead_time_counts_also_where_no_law_explains_the_force() -> None:
    """A set position that the law did not follow: no law is found, and the mass is still that of the late force."""
    s = signals()
    other = 0.1 * np.sin(2.0 * np.pi * 0.37 * s.t)
    early = shifted(s.f, 3)
    with_set, without = (
        identify_motion(MotionLog(name="log", position=s.x, force=early, sample_time=T, set_position=each))
        for each in (other, None)
    )
    assert with_set.control is None
    assert without.delay.nearest > 0
    assert [each.value for each in with_set.rigid.estimates] == [each.value for each in without.rigid.estimates]


@needs_emps
@pytest.mark.slow(reason="every wrong log once more from a measured axis of 25,000 rows, and two more seeds")
@pytest.mark.parametrize("source", ["emps", 2, 3])
def test_the_same_holds_of_a_measured_axis_and_other_seeds(source: int | str, tmp_path: Path) -> None:
    right = measured() if source == "emps" else signals(int(source))
    for what, (heads, made, words) in WRONG.items():
        said = refused(written(tmp_path, heads, *made(right)), tmp_path)
        # figures in the sentences are those of the simulated axis
        for each in (word for word in words if not any(c.isdigit() for c in word)):
            assert each in said, what


def test_a_unit_that_is_told_is_taken_and_the_work_goes_on(tmp_path: Path) -> None:
    t, r, x, f = signals()
    path = written(tmp_path, "t,x_set,x,force", t, 1e3 * r, 1e3 * x, f / 1e3)
    done = identify(path, unit=("mm", "kN"))
    assert done.recommendation.startswith("Use these values")
    # 0.3 % as in tests/cli/test_identify.py: a disturbance of 0.5 N
    assert done.rigid["mass"].value == pytest.approx(95.1089, rel=3e-3)
    with pytest.raises(ParameterError, match="no column that states no unit is of that kind"):
        identify(written(tmp_path, NAMED, t, r, x, f), unit=("mm",))


def test_a_unit_that_was_told_and_is_implausible_is_no_verdict_to_use(tmp_path: Path) -> None:
    t, _, x, f = signals()  # without the set position, from which a law would be searched
    done = identify(written(tmp_path, "t,b,c", t, 1e3 * x, f), position="b:m", force="c:N")
    assert done.recommendation.startswith("Check the units before anything is done")
    assert "the speed is 126 m/s" in done.recommendation


def test_values_that_are_advised_against_are_not_written(tmp_path: Path) -> None:
    """Half of the force is something else: 15 % is the most that a rigid drive may leave."""
    t, _, x, f = signals()  # without the set position, from which a law would be searched
    other = 40.0 * np.sin(2.0 * np.pi * 3.7 * t)
    done = outcome(written(tmp_path, "t,pos_m,force_N", t, x, f + other), out=tmp_path / "out")
    assert done.verdict.startswith("Do not tune on these values")
    assert not (tmp_path / "out" / "machine.toml").exists()
    assert (tmp_path / "out" / "report.html").exists()
    assert done.notes[0].startswith("No machine file was written: a rigid drive")


def test_a_log_of_a_shaft_asks_for_the_lead_or_for_an_axis_that_turns(tmp_path: Path) -> None:
    t, _, x, f = signals()
    log = written(tmp_path, "t,angle [rad],torque [N m]", t, 100.0 * x, 0.01 * f)
    asked = outcome(log, out=tmp_path / "out")
    assert "give --lead of the screw in m, or --rotary for an axis that turns" in asked.notes[0]
    assert not (tmp_path / "out" / "machine.toml").exists()
    turning = outcome(log, out=tmp_path / "o", rotary=True)
    assert (tmp_path / "o" / "machine.toml").exists()
    assert not turning.notes


def test_whole_milliseconds_are_read_once_told(tmp_path: Path) -> None:
    t, _, x, f = signals()
    path = written(tmp_path, "t,pos_m,force_N", np.round(1e3 * t), x, f)
    assert "Use these values" in identify(path, time="t:ms").recommendation
    found = channels(path, out=tmp_path / "roles.toml")
    text = (tmp_path / "roles.toml").read_text(encoding="utf-8")
    assert 'time = { column = "t", unit = "ms", reason = "no unit is stated; in ms' in text
    assert "us 0.001 ms" in found.mapping.reasons["time"]
    assert "Use these values" in identify(path, channels=tmp_path / "roles.toml").recommendation
    assert 'unit = "us"' in channels(path, time="t:us").toml()


def test_lesser_spikes_are_left_out_and_said(tmp_path: Path) -> None:
    """Three samples of 2 to 4 times the usual force: the mass as without them, and count and place in a remark."""
    log = simulated(size=0.5)
    usual = float(np.quantile(np.abs(log.force), 0.99))
    force_ = log.force.copy()
    for row, times in ((1000, 2.2), (2500, -3.0), (2501, -3.0), (4000, 4.0)):
        force_[row] = times * usual
    assert log.without_spikes() == (log, ())
    found, clean = (identify_motion(each, friction="symmetric") for each in (replace(log, force=force_), log))
    said = next(each for each in found.remarks if "far from their neighbors" in each)
    assert "4 single samples of" in said
    assert "row 1001, 2501, 2502, 4001" in said
    assert found.rigid["mass"].value == pytest.approx(clean.rigid["mass"].value, rel=1e-4)


@needs_emps
def test_a_measured_force_has_no_spikes_until_one_is_made() -> None:
    """25,000 rows of a drive: none without, and each of 40 random ones of 2 times the usual force."""
    log = read_log(EMPS)
    motion = MotionLog(name="emps", position=log["qm"], force=35.15 * log["vir"], sample_time=log.sample_time)
    assert motion.without_spikes()[1] == ()
    usual = float(np.quantile(np.abs(motion.force), 0.999))
    for row in np.random.default_rng(0).integers(500, motion.force.size - 500, 40):
        force_ = motion.force.copy()
        force_[row] = 2.0 * usual
        assert f"(row {row + 1})" in replace(motion, force=force_).without_spikes()[1][0]


def test_every_command_that_reads_a_log_stops(tmp_path: Path) -> None:
    t, r, x, f = signals()
    path = written(tmp_path, "t,x_set,x,force", t, 1e3 * r, 1e3 * x, f)
    with pytest.raises(LogError, match="--unit mm"):
        friction((path,))
    with pytest.raises(LogError, match="--unit mm"):
        cogging((path,), period="24:mm")
    with pytest.raises(LogError, match="--unit mm"):
        iterate(str(path), controller="emps_symmetric")
    with pytest.raises(LogError, match="--unit mm"):
        prefilter(path)
    roles = tmp_path / "roles.toml"
    roles.write_text(
        f"[log]\nfile = '{path}'\n[log.channels]\ntime = 't'\nposition_load = 'x'\nforce = 'force'\n", encoding="utf-8"
    )
    with pytest.raises(LogError, match="--unit mm"):
        frf((path,), channels=roles, band="5..100")


@pytest.mark.parametrize(("unit", "size"), [("mm/N", 1e3), ("um/N", 1e6)])
def test_a_response_without_a_unit_stops_too(unit: str, size: float, tmp_path: Path) -> None:
    """95 kg and no friction: in m/N it would be 95 or 0.095 g."""
    frequency = np.geomspace(5.0, 200.0, 60)
    response = size / (95.0 * (2j * np.pi * frequency) ** 2)
    path = written(tmp_path, "f_Hz,re,im", frequency, response.real, response.imag)
    for work in (lambda: identify(path), lambda: tune(str(path), sample_time=1e-3)):
        with pytest.raises(LogError) as caught:
            work()
        assert f"--unit '{unit}'" in str(caught.value)
        assert "(95 kg)" in str(caught.value)
    assert FRF(frequency, response, "force", "position", unit).unit == unit


def test_a_response_of_named_columns_in_a_wrong_unit_is_not_written(tmp_path: Path) -> None:
    """A free mass of 95 kg under a random force; the file says m for numbers in mm."""
    force_, T_ = np.random.default_rng(3).normal(0.0, 200.0, 20_000), 1e-3
    velocity = np.cumsum(force_ - np.mean(force_)) * T_ / 95.0
    position = np.cumsum(velocity - np.mean(velocity)) * T_
    t = np.arange(force_.size) * T_
    path = written(tmp_path, "t [s],x [m],f [N]", t, 1e3 * position, force_)
    with pytest.raises(LogError) as caught:
        frf((path,), input="f", output=("x",), reference=("none",), band="5..100", out=tmp_path / "out")
    said = str(caught.value)
    assert "read in m/N its mass is 0.09" in said
    assert "--output 'x:mm' --input 'f:N'" in said
    assert not (tmp_path / "out").exists()
    told = frf.run(frf.request((path,), input="f:N", output=("x:mm",), reference=("none",), band="5..100"))
    frequency, response = told.result[0].frf.frequency, told.result[0].frf.response
    mass = 1.0 / ((2.0 * np.pi * frequency) ** 2 * np.abs(response))
    assert np.median(mass) == pytest.approx(95.0, rel=0.02)  # the sums lag by a sample
    insisted = frf.run(frf.request((path,), input="f:N", output=("x:m",), reference=("none",), band="5..100"))
    assert any("as its unit was told" in each for each in (*insisted.remarks, insisted.verdict))


def test_a_frequency_response_without_heads_is_named_as_one(tmp_path: Path) -> None:
    frequency = np.geomspace(5.0, 200.0, 60)
    table = np.column_stack([frequency, -1.0 / frequency**2, 1e-3 / frequency])
    path = tmp_path / "bare.csv"
    np.savetxt(path, table, delimiter=",")
    assert "head its columns f_Hz,re,im" in refused(path, tmp_path)
    told = {"time": "column_1", "position": "column_2", "force": "column_3"}
    assert "its columns are headed f_Hz,re,im" in refused(path, tmp_path, **told)


@pytest.mark.parametrize(
    ("signal", "given", "role", "size"),
    [
        ("percent", {"rated": "3.2:Nm"}, "torque", 0.032),
        ("percent", {"rated": "3.2:Nm", "lead": 0.01, "gear": 2.0}, "force", 0.032 * 2.0 * np.pi * 2.0 / 0.01),
        ("per-mille", {"rated": "850:N"}, "force", 0.85),
        ("percent", {"rated": "5.6:A", "torque_constant": 0.5}, "torque", 0.028),
        ("A", {"motor_constant": 35.15}, "force", 35.15),
        ("A", {"torque_constant": 0.5, "amplitude": True}, "torque", 0.5 / np.sqrt(2.0)),
        ("V", {"at_full": "300:percent", "rated": "320:N cm"}, "torque", 3.0 * 3.2 / 10.0),
        ("pid.output", {"full": 2000.0, "at_full": "12:A", "torque_constant": 0.5}, "torque", 0.003),
        ("N m", {"lead": 0.01, "inverted": True}, "force", -2.0 * np.pi / 0.01),
    ],
)
def test_from_data_sheets_to_newtons(signal: str, given: dict[str, Any], role: str, size: float) -> None:
    """By hand: torque = signal x rated / 100, force = torque 2 pi gear / lead."""
    found = force(signal, column="trq", **given)
    assert (found.role, found.factor) == (role, pytest.approx(size, rel=1e-12))


@pytest.mark.parametrize(
    ("signal", "given", "said"),
    [
        ("percent", {}, "--rated is missing"),
        ("A", {}, "--torque-constant"),
        ("V", {}, "--at-full is missing"),
        ("V", {"at_full": "300:percent"}, "--rated is missing"),
        ("percent", {"rated": "3.2"}, "unit must be one of"),
        ("percent", {"rated": "x:Nm"}, "must be a number and a unit"),
        ("percent", {"rated": "-1:Nm"}, "must be > 0"),
        ("kg", {}, "must be one of"),
        ("A", {"torque_constant": 1.0, "motor_constant": 1.0}, "give one"),
        ("N", {"lead": 0.01}, "a force already"),
        ("A", {"motor_constant": 35.0, "lead": 0.01}, "a force already"),
    ],
)
def test_a_datum_that_is_missing_is_named(signal: str, given: dict[str, Any], said: str) -> None:
    with pytest.raises(ParameterError, match=said):
        force(signal, **given)


def test_the_line_that_force_writes_makes_newtons_of_percent(tmp_path: Path) -> None:
    """The axis of 95 kg, its force logged in percent of 3.2 N m at a screw of 10 mm."""
    t, _, x, f = signals()
    force("percent", column="trq", rated="3.2:Nm", lead=0.01, out=tmp_path / "line.toml")
    line = (tmp_path / "line.toml").read_text(encoding="utf-8")
    path = written(tmp_path, "t,pos_m,trq", t, x, f / (3.2 / 100.0 * 2.0 * np.pi / 0.01))
    roles = tmp_path / "roles.toml"
    roles.write_text(f"[log]\nfile = 'log.csv'\n{line}time = 't'\nposition_load = 'pos_m'\n", encoding="utf-8")
    # 0.3 %: a disturbance of 0.5 N
    assert identify(path, channels=roles).rigid["mass"].value == pytest.approx(95.1089, rel=3e-3)

"""An axis of LinuxCNC in a real halrun: listened to, moved under its pids, given a control on trial, and back."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.filter.low_pass import LowPass
from feeddrive.blocks.load.recorded_force import RecordedForce
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.bus.drive_file import BusLimits
from feeddrive.bus.play import Profile
from feeddrive.export.drive_quantities import read_cascade
from feeddrive.export.linuxcnc_axis import LinuxcncAxis, simulated_linuxcnc_axis
from feeddrive.export.linuxcnc_file import read_linuxcnc_file
from feeddrive.export.linuxcnc_hal import FED, HANDOVER, AxisHal
from feeddrive.export.linuxcnc_pid import stock_law, stock_loop
from feeddrive.export.linuxcnc_session import session
from feeddrive.files.machine import read_machine
from feeddrive.language.errors import BusError, ParameterError, StructureError
from feeddrive.language.progress import Progress
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.loop.routine import controller_routine, run
from feeddrive.loop.simulate import simulate
from hal_programs import needs_linuxcnc

LIMITS = BusLimits(travel=0.05, velocity=0.5, force=2000.0, following_error=0.02, quick_stop_deceleration=5.0)
MOVE = SnapLimitedMove(
    distance=0.005, velocity=0.1, acceleration=2.0, jerk=200.0, snap=2e4, back=True, dwell_before=0.01, dwell_after=0.02
)


def linear_motor() -> Loop:
    """A rigid carriage with Coulomb friction, an encoder of 10 nm and two samples of dead time, at 0.1 ms."""
    return read_machine("linear_motor").loops["x"]


def profile(T: float, move: SnapLimitedMove = MOVE, excitation: float = 0.0) -> Profile:
    """A move, with a force of 80 Hz that swells up and down."""
    t = np.arange(round(move.duration / T)) * T
    set_position, velocity, *_ = (np.array(row, dtype=float) for row in move.at(t))
    swell = np.sin(np.pi * np.arange(t.size) / t.size) ** 2
    return Profile("move", "", T, "N", excitation * swell * np.sin(2.0 * np.pi * 80.0 * t), set_position, velocity)


def as_set(played: Profile, start: float = 0.0) -> Recorded:
    """The set motion as every drive gives it: accelerations are central differences."""
    acceleration = np.diff(np.pad(played.set_position, 1, mode="edge"), 2) / played.sample_time**2
    position = start + played.set_position
    return Recorded(
        position=position, velocity=played.velocity, acceleration=acceleration, sample_time=played.sample_time
    )


def softer(loop: Loop) -> Loop:
    """The loop with another control: what a tuning might give."""
    law = CascadePPI(Kv=150.0, Kp=2.5e4, Tn=8e-3)
    return replace(loop, control=replace(loop.control, law=law))


@pytest.fixture(scope="module")
def axis(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LinuxcncAxis]:
    """In metres, so that no number is rounded between HAL and `simulate`; closed by each test that wants it fresh."""
    made = simulated_linuxcnc_axis("linear_motor", LIMITS, tmp_path_factory.mktemp("hal"), units=1.0)
    yield made
    made.close()


@needs_linuxcnc
def test_a_trial_is_the_simulation_of_that_loop_to_the_last_bit(axis: LinuxcncAxis) -> None:
    """Listened to, switched on under the pids, switched over at rest, moved with an excitation, and switched back."""
    axis.close()
    loop, played = softer(linear_motor()), profile(axis.sample_time, excitation=60.0)
    heard = axis.listen(0.02)
    assert heard.aborted is None
    assert list(heard.log.channels) == ["force", "reading_load"]
    assert len(heard.log) == 200
    assert not np.any(heard.log["force"])
    tried = axis.play(played, control=loop)
    assert tried.aborted is None
    assert np.all(tried.log["control"] == 1.0)
    added = RecordedForce(force=played.excitation, sample_time=played.sample_time)
    expected = simulate(loop, as_set(played), added_force=added, record=("reading_load", "force"))
    n = len(tried.log)
    assert n == played.excitation.size
    assert np.array_equal(tried.log["reading_load"], expected["reading_load"][:n])
    assert np.array_equal(tried.log["control_force"], expected["force"][:n])
    assert np.array_equal(tried.log["excitation"], played.excitation)
    # the sum of three numbers in one order
    assert np.array_equal(tried.log["commanded"], tried.log["control_force"] + tried.log["excitation"])
    assert not np.any(tried.log["handover"])
    assert np.max(np.abs(tried.log["reading_load"])) > 4.9e-3


@needs_linuxcnc
def test_a_switch_in_motion_does_not_step_the_force(axis: LinuxcncAxis) -> None:
    """Over at row 800 and back at row 2000, in motion both times, with friction of 30 N that the other must take over.

    In the period of a switch the force is that of the control that leaves: the simulated one's, to the rounding of a
    difference.  In the next periods it steps by what the control that came in steps, and the fading adds pi d / 2 N.
    """
    axis.close()
    loop, played, T = softer(linear_motor()), profile(axis.sample_time), axis.sample_time
    over, back = 800, 2000
    acting = np.zeros(played.excitation.size)
    acting[over:back] = 1.0
    tried = axis.play(played, control=loop, acting=acting)
    assert tried.aborted is None
    log = tried.log
    assert np.array_equal(log["control"], acting)
    cascade = read_cascade(linear_motor())
    old = simulate(stock_loop(cascade, stock_law(cascade, units=1.0)), as_set(played), record=("force", "reading_load"))
    assert np.array_equal(log["force"][:over], old["force"][:over])
    assert np.array_equal(log["reading_load"][: over + 1], old["reading_load"][: over + 1])
    assert log["force"][over] == pytest.approx(old["force"][over], abs=1e-9)
    for row in (over, back):
        difference = abs(log["handover"][row])
        assert 20.0 < difference < 50.0, "N: without a hand-over this would be the jump"
        fading = np.pi * difference / (2.0 * HANDOVER / T)
        own = np.abs(np.diff(log["control_force"][row : row + 500]))
        steps = np.abs(np.diff(log["force"][row : row + 500]))
        assert np.all(steps <= own + fading + 1e-9)
        assert np.max(np.abs(np.diff(log["force"][row - 3 : row + 4]))) < 0.2 * difference
    # exactly 0 once it has faded, so that a trial is that of the new control alone
    assert not np.any(log["handover"][over + round(HANDOVER / T) : back])

    routine = controller_routine(loop, "alone")
    names = [v.path for v in routine.inputs]
    rows = np.zeros((len(log), len(names)))
    reference = as_set(played)
    for name, values in {
        "set_position": reference.position,
        "set_velocity": reference.velocity,
        "set_acceleration": reference.acceleration,
        "reading": log["reading_load"],
        "enable": acting,
    }.items():
        rows[:, names.index(name)] = values
    force = run(routine, rows)[:, [v.name for v in routine.outputs].index("force")]
    assert np.array_equal(log["control_force"][over:back], force[over:back]), "it starts and ends with the switches"


@needs_linuxcnc
def test_a_switch_at_rest_under_load_neither_steps_the_force_nor_lets_the_axis_go(axis: LinuxcncAxis) -> None:
    """With 200 N on the table that the control on trial does not know: it starts from a force of 0.

    A force that fades by at most pi d/(2 HANDOVER) N/s moves an axis under P-PI by that over Kp Kv/Tn: as the integral
    of its position error takes it over.  Friction and a count are added.
    """
    loop, T = softer(linear_motor()), axis.sample_time
    rest = np.zeros(6000)
    acting = rest.copy()
    over, back = 1000, 3500
    acting[over:back] = 1.0
    axis.hal.session.halcmd("setp feeddrive-axis.load-force -200")
    try:
        tried = axis.play(Profile("rest", "", T, "N", rest, rest, rest), control=loop, acting=acting)
    finally:
        axis.hal.session.halcmd("setp feeddrive-axis.load-force 0")
    assert tried.aborted is None
    log, law = tried.log, loop.control.law
    assert isinstance(law, CascadePPI)
    assert law.Tn is not None
    fading = HANDOVER / T
    for row, gain in ((over, law.Kp * law.Kv / law.Tn), (back, 4e4 * 250.0 / 4e-3)):
        difference = abs(log["handover"][row])
        assert 150.0 < difference < 250.0, "N: without a hand-over this would be the jump"
        assert log["force"][row] == pytest.approx(log["force"][row - 1], abs=1e-9)
        after = slice(row, row + 1500)
        own = np.abs(np.diff(log["control_force"][after]))
        assert np.all(np.abs(np.diff(log["force"][after])) <= own + np.pi * difference / (2.0 * fading) + 1e-9)
        way = np.max(np.abs(log["reading_load"][after] - log["reading_load"][row]))
        assert way < np.pi * difference / (2.0 * HANDOVER) / gain + 1e-8


@needs_linuxcnc
def test_the_gains_of_the_stock_pids_are_tried_and_restored(axis: LinuxcncAxis) -> None:
    axis.close()
    slower = read_cascade(softer(linear_motor()))
    law, played = stock_law(slower, units=1.0), profile(axis.sample_time)
    before = axis.inside()
    # the cascade as the pids that the axis has: their gains are those of an export for stock pids
    assert axis.gains(axis.as_pids(slower.loop.control)) == pytest.approx(axis.gains(law), rel=1e-12)
    tried = axis.play(played, control=Control(law=law))
    assert tried.aborted is None
    expected = simulate(stock_loop(slower, law), as_set(played), record=("force", "reading_load"))
    n = len(tried.log)
    assert np.array_equal(tried.log["reading_load"], expected["reading_load"][:n])
    assert np.array_equal(tried.log["commanded"], expected["force"][:n])
    assert axis.inside() == before
    assert before["axis.position.Pgain"] == "250.0"
    axis.hal.write({"axis.position.Pgain": 100.0})
    said = axis.restore(before)
    assert axis.inside() == before
    assert "gains of before" in said
    with pytest.raises(StructureError, match=r"the control has a filters, and the gains of pids make none"):
        axis.as_pids(replace(slower.loop.control, filters=(LowPass(frequency=500.0),)))


@needs_linuxcnc
def test_a_motion_beyond_its_limits_is_ended_and_said(axis: LinuxcncAxis) -> None:
    """In virtual time: each bound of the component, as a user meets it."""
    played = profile(axis.sample_time)
    for limits, message in (
        (
            replace(LIMITS, velocity=0.11, following_error=1e-6),
            r"following_error = .* exceeded .* its force was switched",
        ),
        (replace(LIMITS, force=25.0), r"the force was at limits.force = 25 N for longer"),
        (replace(LIMITS, position_most=2e-3), r"could come to rest in row \d+, is beyond .*; the axis was braked"),
    ):
        log = axis.limited(limits).play(played)
        assert log.aborted is not None
        with pytest.raises(AssertionError, match=message):
            raise AssertionError(str(log.aborted))
        assert log.log.provenance["aborted"] == log.aborted
        assert np.max(np.abs(log.log["force"])) <= limits.force
    # once it is said the next motion plays
    assert axis.play(played).aborted is None


HAND_MADE = """\
# a shop's own file: the card is the axis as a component
loadrt threads name1=servo period1=[HAL]PERIOD
loadrt feeddrive_axis
loadrt pid names=pid.x
loadrt constant names=planner
loadrt not names=key
addf feeddrive-axis.read servo
addf pid.x.do-pid-calcs servo
addf feeddrive-axis.write servo
net x-pos feeddrive-axis.load-position-fb => pid.x.feedback
net x-cmd planner.out => pid.x.command
net x-out pid.x.output => feeddrive-axis.force
setp pid.x.Pgain [HAL]P
setp pid.x.Igain [HAL]I
setp pid.x.Dgain [HAL]D
setp pid.x.FF1 [HAL]FF1
setp pid.x.error-previous-target 0
"""
OF_HAND_MADE = """\
axis = "x"
hal = "shop.hal"
ini = "shop.ini"
thread = "servo"
period_us = 100
set_position = "pid.x.command"
position = "feeddrive-axis.load-position-fb"
output = "pid.x.output"
force = "feeddrive-axis.force"
control_enable = "pid.x.enable"
held = "feeddrive-axis.held"
stop = "key.in"
first = "pid.x.do-pid-calcs"
write = "feeddrive-axis.write"
position_pid = "pid.x"
simulated = true
components = "feeddrive_axis.comp"
[limits]
travel_mm = 50
velocity = 0.5
force = 2000
following_error_mm = 2
quick_stop_deceleration = 5
"""


@pytest.fixture
def shop(axis: LinuxcncAxis, tmp_path: Path) -> Path:
    """The file of an axis by a shop's own HAL file, with one pid in mm."""
    made = axis.hal.folder
    for name in ("feeddrive_axis.comp", "feeddrive_axis.h"):
        (tmp_path / name).write_bytes((made / name).read_bytes())
    law = stock_law(read_cascade(linear_motor()), route="one").position
    output = 100.0  # N per A of the motor; here the output is in N
    gains = (f"{key} = {output * value!r}" for key, value in zip("PID", (law.Pgain, law.Igain, law.Dgain), strict=True))
    ini = ["[HAL]", "PERIOD = 100000", *gains, f"FF1 = {output * law.FF1!r}"]
    (tmp_path / "shop.ini").write_text("\n".join(ini) + "\n")
    (tmp_path / "shop.hal").write_text(HAND_MADE)
    (tmp_path / "axis.toml").write_text(OF_HAND_MADE)
    return tmp_path / "axis.toml"


@needs_linuxcnc
@pytest.mark.slow(reason="a session of HAL of its own, with all components compiled once more")
def test_a_shops_own_hal_file_is_taken_as_it_is(shop: Path) -> None:
    """Its links to the planner and to the card are undone in the session; the trial is the simulation in mm, too.

    Rounding of mm shifts a count of the encoder, 10 nm, here and there, and Kp moves the force by 2.5 N for a count.
    """
    loop, played = softer(linear_motor()), profile(1e-4)
    with LinuxcncAxis(read_linuxcnc_file(shop)) as axis:
        assert axis.is_virtual
        assert axis.where == "LinuxCNC, simulated axis x"
        tried = axis.play(played, control=loop)
        assert tried.aborted is None
        expected = simulate(loop, as_set(played), record=("reading_load", "force"))
        assert np.max(np.abs(tried.log["reading_load"] - expected["reading_load"][: len(tried.log)])) < 5e-8
        axis.hal.session.halcmd("sets fd-stop 1")
        assert str(axis.play(played).aborted) == "stopped by hand before it began"
        axis.hal.session.halcmd("sets fd-stop 0")
        under_pid = axis.play(played)
        assert under_pid.aborted is None
        assert np.max(np.abs(under_pid.log["set_position"] - under_pid.log["reading_load"])) < 1e-4
        assert len(axis.inside()) == 16
        with pytest.raises(ParameterError, match="the law has two pids, and the file of the axis names position_pid"):
            axis.play(played, control=Control(law=stock_law(read_cascade(loop))))


MISFITS = [
    ('"pid.x.do-pid-calcs"', '"pid.y.do-pid-calcs"', "no function 'pid.y.do-pid-calcs'; it has feed"),
    ("period_us = 100", "period_us = 1000", "has a period of 100 us, and the file of the axis says period = 1000 us"),
    ('"pid.x.output"', '"pid.x.outputs"', "there is no pin 'pid.x.outputs' after shop.hal"),
]


@needs_linuxcnc
@pytest.mark.slow(reason="a session of HAL for each")
@pytest.mark.parametrize(("old", "new", "message"), MISFITS)
def test_a_file_that_does_not_fit_its_hal_is_refused(shop: Path, old: str, new: str, message: str) -> None:
    shop.write_text(shop.read_text().replace(old, new, 1))
    with LinuxcncAxis(read_linuxcnc_file(shop)) as axis, pytest.raises(BusError, match=message):
        axis.play(profile(1e-4))


def test_a_file_is_read_with_its_limits_and_written_with_corrections(tmp_path: Path) -> None:
    (tmp_path / "axis.toml").write_text(OF_HAND_MADE)
    axis = LinuxcncAxis(read_linuxcnc_file(tmp_path / "axis.toml"))
    right = axis.scaled(2.0, -1)
    assert right.file.units_per_m == 500.0
    (tmp_path / "right.toml").write_text(right.text())
    read = read_linuxcnc_file(tmp_path / "right.toml")
    assert read.units_per_m == 500.0
    assert read.force_per_output == -1.0
    assert axis.limited(replace(axis.limits, force=100.0)).limits.force == 100.0
    with pytest.raises(ParameterError, match=r"limits.force = 3,?000 is looser"):
        axis.limited(replace(axis.limits, force=3000.0))
    for wrong, message in (
        (OF_HAND_MADE.replace("simulated = true\n", ""), "force is of a simulated axis"),
        (OF_HAND_MADE.replace('force = "feeddrive-axis.force"\n', ""), "command is missing"),
        ("force_per_output = 0\n" + OF_HAND_MADE, "force_per_output = 0: state the force"),
    ):
        (tmp_path / "wrong.toml").write_text(wrong)
        with pytest.raises(ParameterError, match=message):
            read_linuxcnc_file(tmp_path / "wrong.toml")


def test_pids_of_a_drive_that_counts_the_other_way_are_turned(tmp_path: Path) -> None:
    """Of two pids only the last one's gains, and those of the sum at its bias; no limit."""
    law = stock_law(read_cascade(linear_motor()))
    content = 'force_per_output = SIGN100\nvelocity_pid = "pid.v"\nforward = "sum"\n' + OF_HAND_MADE
    found = []
    for sign in ("", "-"):
        (tmp_path / "axis.toml").write_text(content.replace("SIGN", sign))
        found.append(LinuxcncAxis(read_linuxcnc_file(tmp_path / "axis.toml")).gains(law))
    turned = {name for name, value in found[0].items() if value != found[1][name]}
    assert turned == {"pid.v.Pgain", "pid.v.Igain", "sum.gain0", "sum.gain1"}
    assert all(found[0][name] == -found[1][name] for name in turned)


def of_shop(folder: Path, content: str = OF_HAND_MADE) -> LinuxcncAxis:
    """An axis that is not loaded."""
    (folder / "axis.toml").write_text(content)
    return LinuxcncAxis(read_linuxcnc_file(folder / "axis.toml"))


def test_the_axis_rests_a_tenth_of_a_second_and_a_switch_fades_for_as_long(tmp_path: Path) -> None:
    """At 0.1 ms: 1,000 rows of rest, and 2,000 for a switch and the rest after it; the brake opens before."""
    axis, played = of_shop(tmp_path), profile(1e-4)
    n = played.excitation.size
    log, new = FED.index("log"), FED.index("new")
    alone = axis.rows(played, None)
    assert len(alone) == 1000 + n + 1000 + 1
    assert np.flatnonzero(alone[:, log])[0] == 1000
    assert not np.any(alone[:, new])
    tried = axis.rows(played, np.ones(n))
    assert len(tried) == 3000 + n + 3000 + 1
    assert np.array_equal(np.flatnonzero(tried[:, new])[[0, -1]], [1000, 3000 + n + 999])
    assert np.array_equal(np.flatnonzero(tried[:, log]), 3000 + np.arange(n))
    braked = of_shop(tmp_path, "brake_time_ms = 50\n" + OF_HAND_MADE)
    assert len(braked.rows(played, None)) == 500 + len(alone)


def test_a_control_of_another_sample_time_is_not_tried(tmp_path: Path) -> None:
    loop = replace(softer(linear_motor()), sample_time=2e-4)
    with pytest.raises(ParameterError, match="made for a sample time of 200 us, and the thread has 100 us"):
        of_shop(tmp_path).play(profile(1e-4), control=loop)


def test_a_control_without_a_guard_is_not_tried(tmp_path: Path) -> None:
    """What it would do with a broken reading is not defined; nothing is loaded for it."""
    loop = linear_motor()
    with pytest.raises(StructureError, match="the control of axis x has no guard"):
        of_shop(tmp_path).play(profile(1e-4), control=replace(loop.control, guard=None))


class Heard:
    """A session that only hears what it is asked."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.order = folder, dict[str, object]()

    def ask(self, **_order: object) -> dict[str, object]:
        return {}

    def halcmd(self, *_lines: str) -> str:
        return ""

    def play(self, _stopped: object, **order: object) -> dict[str, object]:
        self.order = order
        np.zeros(0).tofile(self.folder / str(order["out"]))
        return {"fault": 0}


def test_half_a_second_of_rows_is_fed_ahead(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """At the pace of the clock; in virtual time all of them stand in the queue before it begins."""
    heard = Heard(tmp_path)
    monkeypatch.setattr(AxisHal, "session", property(lambda _: heard))
    axis = of_shop(tmp_path)
    for paced, lead in ((True, 5000), (False, 7000)):
        axis.hal.paced = paced
        axis.hal.play(np.zeros((7000, len(FED))), lambda _: False, 1e-4, listens=False)
        assert heard.order["lead"] == lead


@pytest.mark.parametrize(("rows", "played"), [(500_000, True), (530_000, False)])
def test_a_motion_of_virtual_time_must_fit_into_the_queue(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rows: int, played: bool
) -> None:
    heard = Heard(tmp_path)
    monkeypatch.setattr(AxisHal, "session", property(lambda _: heard))
    axis = of_shop(tmp_path)
    with contextlib.nullcontext() if played else pytest.raises(ParameterError, match="longer than the 524288"):
        axis.hal.play(np.zeros((rows, len(FED))), lambda _: False, 1e-4, listens=False)


class StopsAfter(Progress):
    """A person who stops a motion once a part of it has been played."""

    def show_step(self, what: str, done: int | None, of: int | None, part: str) -> None:
        if done is not None and of is not None and done > of // 3:
            self.cancel()


@needs_linuxcnc
@pytest.mark.slow(reason="waits for seconds of real time in a session of HAL")
def test_a_person_stops_a_motion_at_the_pace_of_the_clock(tmp_path: Path) -> None:
    """The rows are fed half a second ahead, and the stop passes them all: the axis brakes within v/a, and stays."""
    move = replace(MOVE, distance=0.04, velocity=0.02, acceleration=0.2, jerk=20.0, snap=2e3)
    with simulated_linuxcnc_axis("linear_motor", LIMITS, tmp_path, paced=True) as axis:
        whole = profile(axis.sample_time, move)
        stopped = axis.play(whole, StopsAfter())
        assert str(stopped.aborted) == "stopped by hand; the axis was braked"
        assert 0.1 * whole.excitation.size < len(stopped.log) < 0.9 * whole.excitation.size
        assert axis.play(profile(axis.sample_time)).aborted is None


def player_in(work: Path) -> int:
    """The number of the process that feeds the rows of a session."""
    for at in Path("/proc").iterdir():
        with contextlib.suppress(OSError):
            if (at / "cmdline").read_bytes() == b"/usr/bin/python3\0player.py\0" and os.readlink(at / "cwd") == str(
                work
            ):
                return int(at.name)
    raise AssertionError("nobody plays")


@needs_linuxcnc
@pytest.mark.slow(reason="waits for seconds of real time in a session of HAL")
@pytest.mark.parametrize("how", ["the program ends", "it no longer feeds"])
def test_an_axis_whose_program_fails_brakes(tmp_path: Path, how: str) -> None:
    """A program of its own plays a move of some four seconds and is killed, or stopped, within the first two.

    The player finds its input at an end and brakes at once.  If it hangs itself no more rows come: the component then
    brakes behind the half second that was fed ahead.  Both are read from the log that the player goes on to write.
    """
    move = "replace(MOVE, distance=0.04, velocity=0.02, acceleration=0.2, jerk=20.0, snap=2e3)"
    (tmp_path / "play.py").write_text(
        "import sys\n"
        "from pathlib import Path\n"
        "from test_export_linuxcnc_axis import *\n"
        "axis = simulated_linuxcnc_axis('linear_motor', LIMITS, Path(sys.argv[1]), paced=True)\n"
        "print(axis.hal.work, flush=True)\n"
        f"played = axis.play(profile(axis.sample_time, {move}))\n"
        "print(played.aborted, len(played.log), flush=True)\n"
    )
    program = subprocess.Popen(
        [sys.executable, str(tmp_path / "play.py"), str(tmp_path)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join([*sys.path, str(Path(__file__).parent)])},
        stdout=subprocess.PIPE,
        text=True,
    )
    assert program.stdout is not None
    work = Path(program.stdout.readline().strip())
    taken = work / "taken.bin"
    until = time.monotonic() + 60.0
    while not (taken.exists() and taken.stat().st_size > 0) and time.monotonic() < until:
        time.sleep(0.05)
    player = player_in(work)
    if how == "the program ends":
        program.kill()
    else:
        os.kill(player, signal.SIGSTOP)
        time.sleep(1.5)
        os.kill(player, signal.SIGCONT)
    said = program.communicate(timeout=60.0)[0]
    time.sleep(1.0)
    assert not Path(f"/proc/{player}").exists()
    if how == "the program ends":
        count = len(np.fromfile(taken, dtype="<f8").reshape(-1, 8))
    else:
        assert "no row came after row" in said
        count = int(said.split()[-1])
    assert 0 < count < 0.9 * (0.08 / 0.02) / 1e-4


@needs_linuxcnc
@pytest.mark.slow(reason="a session of HAL within another, and seconds of real time")
def test_on_a_machine_the_components_are_the_installed_ones(shop: Path, tmp_path: Path) -> None:
    """Python within a session, in which HAL is that of the machine: real pace, no namespaces, halcompile --install."""
    content = shop.read_text()
    for line in ("simulated = true\n", 'components = "feeddrive_axis.comp"\n', 'held = "feeddrive-axis.held"\n'):
        content = content.replace(line, "")
    # no real-time kernel: a call may be late by tens of milliseconds
    content = content.replace('force = "feeddrive-axis.force"', 'command = "feeddrive-axis.force"\nlate_ms = 1000')
    shop.write_text(content)
    (tmp_path / "machine.py").write_text(
        "import sys, numpy as np\n"
        "from test_export_linuxcnc_axis import *\n"
        f"axis = LinuxcncAxis(read_linuxcnc_file({str(shop)!r}))\n"
        "print('VIRTUAL', axis.is_virtual)\n"
        "heard = axis.listen(0.05)\n"
        "print('HEARD', heard.aborted, len(heard.log))\n"
        "move = profile(axis.sample_time)\n"
        "tried = axis.play(move, control=softer(linear_motor()))\n"
        "print('TRIED', tried.aborted, len(tried.log) - move.excitation.size, np.max(tried.log['reading_load']))\n"
        "print('BACK', axis.restore(axis.inside()))\n"
        "axis.close()\n"
    )
    session_folder = tmp_path / "session"
    session_folder.mkdir()
    path = os.pathsep.join([*sys.path, str(Path(__file__).parent)])
    program = f"PYTHONPATH={path} {sys.executable} {tmp_path / 'machine.py'}"
    printed = session(session_folder, [shop.parent / "feeddrive_axis.comp"], program, patience=120.0)
    assert "VIRTUAL False" in printed
    assert "HEARD None 500" in printed
    assert "TRIED None 0 0.005" in printed
    assert "the 16 gains of before are set" in printed

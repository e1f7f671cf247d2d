"""An axis of LinuxCNC in a real halrun: listened to, moved under its pids, given a control on trial, and back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.load.recorded_force import RecordedForce
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.bus.drive_file import BusLimits
from feeddrive.bus.linuxcnc_axis import LinuxcncAxis, simulated_linuxcnc_axis
from feeddrive.bus.linuxcnc_hal import HANDOVER
from feeddrive.bus.play import Profile
from feeddrive.export.drive_quantities import read_cascade
from feeddrive.export.linuxcnc_pid import stock_law, stock_loop
from feeddrive.files.machine import read_machine
from feeddrive.language.progress import Progress
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.loop.routine import controller_routine, run
from feeddrive.loop.simulate import simulate
from hal_programs import needs_linuxcnc

LIMITS = BusLimits(travel=0.05, velocity=0.5, force=2000.0, following_error=1e-3, quick_stop_deceleration=5.0)
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
def axis(tmp_path_factory: pytest.TempPathFactory) -> LinuxcncAxis:
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
def test_the_gains_of_the_stock_pids_are_tried_and_restored(axis: LinuxcncAxis) -> None:
    axis.close()
    slower = read_cascade(softer(linear_motor()))
    law, played = stock_law(slower, units=1.0), profile(axis.sample_time)
    before = axis.inside()
    tried = axis.play(played, control=Control(law=law))
    assert tried.aborted is None
    expected = simulate(stock_loop(slower, law), as_set(played), record=("force", "reading_load"))
    n = len(tried.log)
    assert np.array_equal(tried.log["reading_load"], expected["reading_load"][:n])
    assert np.array_equal(tried.log["commanded"], expected["force"][:n])
    assert axis.inside() == before
    assert before["axis.position.Pgain"] == "250.0"
    axis._set({"axis.position.Pgain": 100.0})
    said = axis.restore(before)
    assert axis.inside() == before
    assert "gains of before" in said


class Impatient(Progress):
    """A person who stops a motion."""

    def show_step(self, what: str, done: int | None, of: int | None, part: str) -> None:
        if done is not None and of is not None and done > of // 3:
            self.cancel()


@needs_linuxcnc
def test_a_motion_beyond_its_limits_is_ended_and_said(axis: LinuxcncAxis) -> None:
    """In virtual time: each bound of the component, as a user meets it."""
    played = profile(axis.sample_time)
    for limits, message in (
        (
            replace(LIMITS, velocity=0.11, following_error=1e-6),
            r"following_error = .* exceeded .* its force was switched",
        ),
        (replace(LIMITS, force=25.0, following_error=0.02), r"the force was at limits.force = 25 N for longer"),
        (replace(LIMITS, position_most=2e-3), r"could come to rest in row \d+, is beyond .*; the axis was braked"),
    ):
        axis.close()
        log = axis.limited(limits).play(played)
        assert log.aborted is not None
        with pytest.raises(AssertionError, match=message):
            raise AssertionError(str(log.aborted))
        assert log.log.provenance["aborted"] == log.aborted
        assert np.max(np.abs(log.log["force"])) <= limits.force
    axis.close()
    # once it is said the next motion plays
    assert axis.play(played).aborted is None

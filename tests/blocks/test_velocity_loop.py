"""The velocity loop of a drive as physics of an axis, and the position loop around it, against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.actuator.velocity_loop import VelocityLoop
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.controller.position_loop import PositionLoop
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.force.gravity import Gravity
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.reference.polynomial7 import Polynomial7
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.bus.control_in_master import ControlInMaster
from feeddrive.language.errors import StructureError
from feeddrive.language.text import Text
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.guard import Guard
from feeddrive.loop.linearize import linearize
from feeddrive.loop.loop import Loop
from feeddrive.plot.curves import batch_chart

T = 1e-3  # s
MASS, VISCOUS, KP, TN, LAG = 40.0, 120.0, 9000.0, 0.02, 4e-4
DRIVE = VelocityLoop(Kp=KP, Tn=TN, lag=LAG)
MOVE = Polynomial7(distance=0.02, travel_time=0.3)


def axis(substeps: int = 1, drive: VelocityLoop | None = DRIVE, dead_time: float = 0.0) -> Axis:
    actuator = Actuator(dead_time=dead_time, velocity_loop=drive)
    return Axis(plant=Rigid(mass=MASS, viscous=VISCOUS), actuator=actuator, substeps=substeps)


def loop(substeps: int = 1, **more: float) -> Loop:
    control = Control(law=PositionLoop(Kv=20.0), **more)
    return Loop(control=control, axis=axis(substeps), sample_time=T, name="x")


def answer(f: np.ndarray) -> np.ndarray:
    """Position over commanded velocity, m/(m/s), of the continuous loop behind a zero-order hold."""
    s = 2j * np.pi * f
    C = KP * (1.0 + 1.0 / (TN * s)) / (1.0 + s * LAG)
    P = 1.0 / (MASS * s + VISCOUS)
    hold = (1.0 - np.exp(-s * T)) / (s * T)
    return hold * C * P / (1.0 + C * P) / s


def test_its_response_is_that_of_the_continuous_loop_as_its_sampling_grows_faster() -> None:
    f = np.geomspace(2.0, 60.0, 12)  # Hz, around the loop's 35 Hz
    apart = []
    for substeps in (8, 16, 32):
        found = linearize(loop(substeps), ["cut"], ["reading_load"]).response(f).response
        apart.append(float(np.max(np.abs(found / answer(f) - 1.0))))
    # the velocity is read at the beginning of a substep: order 1
    assert apart[0] < 0.05
    assert apart[0] / apart[1] == pytest.approx(2.0, rel=0.1)
    assert apart[1] / apart[2] == pytest.approx(2.0, rel=0.1)


def test_the_lag_is_exact_for_a_force_that_is_held() -> None:
    h, steps, error = 1e-4, 7, 0.01
    drive = VelocityLoop(Kp=KP, lag=LAG, held_force=12.0)
    state, means = drive.start(0.0), []
    for _ in range(steps):
        state, mean = drive.step(state, error, 0.0, h)
        means.append(float(mean))
    wanted, t = KP * error + 12.0, steps * h
    left = np.exp(-t / LAG)
    # float64: a few units in the last place of 100 N
    assert float(state.force) == pytest.approx(wanted + (12.0 - wanted) * left, abs=1e-11)
    assert np.mean(means) == pytest.approx(wanted + (12.0 - wanted) * LAG / t * (1.0 - left), abs=1e-11)


def test_the_integral_waits_at_the_limit_of_force_and_leaves_it_at_once() -> None:
    drive = VelocityLoop(Kp=1000.0, Tn=0.01, most_force=50.0)
    state = drive.start(0.0)
    for _ in range(100):
        state, force = drive.step(state, 0.1, 0.0, 1e-3)  # 100 N are wanted
        assert force == 50.0
    assert state.integral == 0.0
    state, force = drive.step(state, -0.02, 0.0, 1e-3)
    assert force == -20.0
    assert state.integral == pytest.approx(-0.02 * 1000.0 / 0.01 * 1e-3, abs=1e-12)


def test_velocities_act_as_the_forces_do_that_they_stand_for() -> None:
    added = np.array([0.0, 5.0, -3.0, 8.0, 8.0, 0.0, 0.0])
    drive = VelocityLoop(Kp=KP, Tn=TN)
    state, made = drive.start(0.0), []
    for velocity in drive.equivalent(added, T):
        state, force = drive.step(state, float(velocity), 0.0, T)
        made.append(float(force))
    assert np.asarray(made) == pytest.approx(added, abs=1e-11)  # N, rounding


def test_an_axis_follows_and_a_hanging_one_is_held() -> None:
    drive = replace(DRIVE, held_force=MASS * 9.81)
    hanging = replace(axis(8, drive), forces=(Gravity(force=-MASS * 9.81),))
    run = fd.simulate(
        Loop(control=Control(law=PositionLoop(Kv=20.0)), axis=hanging, sample_time=T, name="x"),
        MOVE,
        duration=0.8,
        record=["tracking_error", "force", "drive_force"],
    )
    # m: ten time constants of 1/20 s after the move nothing is left but its e^-10
    assert abs(run["tracking_error"][-1]) < 1e-3 * np.max(np.abs(run["tracking_error"]))
    assert np.max(np.abs(run["tracking_error"])) < 1e-3
    assert run.units["force"] == "m/s"
    # N: held from the first sample on, in which the move begins with a thousandth of a newton
    assert run["drive_force"][0] == pytest.approx(MASS * 9.81, abs=0.01)


def test_its_step_is_kv_of_the_error_and_the_set_velocity() -> None:
    law = PositionLoop(Kv=30.0, velocity_feedforward=0.9)
    setpoint = Setpoint(0.0103, velocity=0.25)
    _, velocity = law.step(None, law.start(None, setpoint, Reading(0.0, 0.0)), setpoint, Reading(0.0, 0.01), T)
    assert velocity == pytest.approx(30.0 * 0.0003 + 0.9 * setpoint.backward_velocity(T), abs=1e-15)


@pytest.mark.parametrize(
    ("made", "says"),
    [
        (lambda: loop(force_limit=100.0), "control.force_limit is a force in N.*give velocity_limit"),
        (
            lambda: Control(law=PositionLoop(Kv=20.0), feedforward=(Inertia(mass=1.0),)),
            "control.feedforward is a force in N",
        ),
        (
            lambda: Control(law=CascadePPI(Kv=20.0, Kp=1e4), velocity_limit=1.0),
            "control.velocity_limit bounds a commanded velocity",
        ),
        (
            lambda: Loop(control=Control(law=CascadePPI(Kv=20.0, Kp=1e4)), axis=axis(), sample_time=T),
            "cascade_ppi commands a force, and the drive of the axis takes a velocity: take a law that commands a vel",
        ),
        (
            lambda: Loop(control=Control(law=PositionLoop(Kv=20.0)), axis=axis(drive=None), sample_time=T),
            "position_loop commands a velocity, and the drive of the axis takes a force",
        ),
        (lambda: Actuator(current_loop=500.0, velocity_loop=DRIVE), "give its delay as velocity_loop.lag"),
        (
            lambda: ControlInMaster(Control(law=PositionLoop(Kv=20.0)), T, mode="cst", force=100.0),
            'position_loop commands a velocity, and mode = "cst" takes a force',
        ),
    ],
)
def test_a_force_where_a_velocity_is_meant_is_refused(made: object, says: str) -> None:
    with pytest.raises(StructureError, match=says):
        made()  # pyright: ignore[reportCallIssue]


def test_a_safe_force_of_the_guard_is_refused() -> None:
    guard = Guard(following_error_limit=1e-3, safe_force=10.0)
    with pytest.raises(fd.FeeddriveError, match=r"control\.guard\.safe_force = 10 N is a force, and position_loop"):
        fd.simulate(loop(guard=guard), MOVE)  # pyright: ignore[reportArgumentType]


def test_in_the_master_it_commands_the_velocity_of_its_step() -> None:
    control = ControlInMaster(Control(law=PositionLoop(Kv=20.0)), T, mode="csv", force=100.0, velocity=0.05)
    control.begin(0.1, None)
    control.rest(0.1, None, 35.0)
    # 20/s of 1 mm, then 20/s of 4 mm, which the limit of 0.05 m/s cuts
    first, second = control.step(Setpoint(0.101), 0.1), control.step(Setpoint(0.104), 0.1)
    assert (first.force, second.force) == (0.0, 0.0)
    assert first.velocity == pytest.approx(0.02, rel=1e-12)
    assert second.velocity == 0.05


def test_a_batch_names_the_units_of_what_is_commanded() -> None:
    """Until now the table and the chart of a batch called every command a force in N, and every way one in m."""
    varied = fd.vary(loop(), {"axis.x.control.law.Kv": np.array([15.0, 20.0, 25.0])})
    batch = fd.simulate_batch(varied, MOVE, gather=["force", "tracking_error"])
    assert batch.units == {"force": "m/s", "tracking_error": "m"}
    shown = {str(row[0]): str(row[2]) for row in batch.table().rows}
    assert shown["force"].endswith("mm/s")
    labels = [f"{Text(panel.abscissa.label)}" for panel in batch_chart(batch).panels]
    assert labels == ["RMS of force (mm/s)", "RMS of tracking error (um)"]

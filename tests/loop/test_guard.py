"""The safety of the loop: enable, trips, broken readings, and what happens to the force in that very sample."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from feeddrive.blocks import Recorded, StepForce
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.families import Law, Load, Reference
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.signals import Setpoint
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.loop import guard as codes
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.guard import Guard
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import simulate

T = 1e-3


class Ramp(Reference):
    """0.1 m/s from the start on."""

    @property
    def duration(self) -> float:
        return 1.0

    def at(self, t: np.ndarray) -> Setpoint:
        zero = np.zeros_like(t)
        return Setpoint(0.1 * t, zero + 0.1, zero, zero, zero)


class Push(Load):
    """20 kN from 0.5 s on."""

    def at(self, t: np.ndarray) -> np.ndarray:
        return np.where(t >= 0.5, 2e4, 0.0)


def loop(**limits: float) -> Loop:
    return Loop(
        sample_time=T,
        control=Control(law=CascadePPI(Kv=30, Kp=2e4, Tn=0.02), force_limit=5000, guard=Guard(**limits)),
        axis=Axis(plant=Rigid(mass=100, viscous=300)),
    )


def first(run: object, code: float) -> int:
    found = np.flatnonzero(run["trip"] == code)  # type: ignore[index]
    assert found.size, "the guard never tripped"
    return int(found[0])


@pytest.mark.parametrize(
    ("limits", "code", "crossed"),
    [
        (
            {"following_error_limit": 2e-3},
            codes.TRIP_FOLLOWING_ERROR,
            lambda run: np.abs(run["following_error"]) > 2e-3,
        ),
        (
            {"velocity_limit": 0.3},
            codes.TRIP_VELOCITY,
            lambda run: np.abs(np.diff(run["reading_load"], prepend=0.0)) > 0.3 * T,
        ),
        ({"travel_most": 0.08}, codes.TRIP_TRAVEL, lambda run: run["reading_load"] > 0.08),
    ],
    ids=["following error", "velocity", "travel"],
)
def test_a_trip_cuts_the_force_in_the_sample_in_which_the_bound_is_broken(limits, code, crossed) -> None:
    run = simulate(loop(**limits), Ramp(), load=Push(), start=(0.0, 0.1), bound=1e6)
    k = first(run, code)
    assert k == int(np.flatnonzero(crossed(run))[0])
    assert np.all(run["force"][k:] == 0.0)
    assert np.any(run["force"][:k] != 0.0)
    assert np.all(run["trip"][k:] == code), "a trip is latched"


def test_a_loop_that_is_not_enabled_gives_no_force_and_starts_where_the_axis_is() -> None:
    enable = np.where(np.arange(1001) < 300, 0.0, 1.0)
    run = simulate(loop(), Ramp(), enable=enable, start=(0.0, 0.0))
    assert np.all(run["force"][:300] == 0.0)
    # at enable the setpoint is 0.03 m ahead: P-PI without stored velocity or integral asks exactly
    # Kp (1 + T/Tn)(Kv e + v_set), limited at 5000 N
    asked = 2e4 * (1 + T / 0.02) * (30 * run["following_error"][300] + 0.1)
    assert run["requested"][300] == pytest.approx(asked, rel=1e-12)


def test_taking_enable_away_clears_a_trip_and_giving_it_again_resets_the_law() -> None:
    enable = np.ones(1001)
    enable[700:720] = 0.0
    limits = loop(following_error_limit=2e-3)

    class Kick(Load):
        def at(self, t: np.ndarray) -> np.ndarray:
            return np.where((t >= 0.5) & (t < 0.52), 2e4, 0.0)

    run = simulate(limits, Ramp(), load=Kick(), enable=enable, start=(0.0, 0.1), bound=1e6)
    assert np.all(run["trip"][600:700] == codes.TRIP_FOLLOWING_ERROR)
    assert np.all(run["trip"][700:720] == codes.TRIP_NONE)
    # enabled again far from its setpoint it trips at once: the error is measured, not forgotten
    assert run["trip"][720] == codes.TRIP_FOLLOWING_ERROR
    assert run["force"][720] == 0.0


class Stepped:
    """A control that is stepped by hand, at rest at 0 unless told otherwise."""

    def __init__(self, law: Law | None = None, *, velocity: float = 0.0, **guard: float) -> None:
        control = Control(law=law or guarded_law(), force_limit=5000, guard=Guard(**guard))
        self.control = tree.rebuild(control, (np.float64(v) for _, v in tree.leaves(control)))
        self.prepared = self.control.prepare(np.float64(T))
        self.state = self.control.start(
            self.prepared, Setpoint(*np.zeros(5)), np.float64(0.0), np.float64(0.0), np.float64(velocity)
        )

    def __call__(self, reading: float = 0.0, setpoint: Sequence[float] = (0.0,) * 5, enable: float = 1.0) -> Any:
        with np.errstate(all="ignore"):
            given = np.float64(reading), np.float64(reading), np.float64(enable), np.float64(T)
            self.state, command = self.control.step(
                self.prepared, self.state, Setpoint(*map(np.float64, setpoint)), *given
            )
        return command

    def finite(self) -> bool:
        return all(np.isfinite(value) for _, value in tree.leaves(self.state))


BROKEN_READINGS = (np.nan, np.inf, -np.inf, 1e9, -1001.0)


@pytest.mark.parametrize("hold", [0, 1, 3])
@pytest.mark.parametrize("broken", BROKEN_READINGS)
def test_a_command_is_held_over_broken_readings_and_then_the_loop_trips(broken: float, hold: int) -> None:
    step = Stepped(hold_samples=hold, safe_force=70.0)
    last = step(1e-6).applied
    assert last == pytest.approx(70.0 - 2e4 * (1 + T / 0.02) * (1e-6 / T + 30 * 1e-6))  # begun with the safe force
    for _ in range(hold):
        command = step(broken)
        assert (command.applied, command.requested, command.trip, command.running) == (last, last, 0.0, 1.0)
    for reading in (broken, 1e-6):
        command = step(reading)
        assert (command.applied, command.requested, command.running) == (70.0, 70.0, 0.0)
        assert command.trip == codes.TRIP_READING, "a trip is latched"
        assert step.finite(), "nothing broken is remembered"


def test_good_readings_in_between_begin_the_count_anew() -> None:
    step = Stepped(hold_samples=2)
    for _ in range(5):
        assert [step(x).trip for x in (1e-6, np.nan, np.nan)] == [0.0, 0.0, 0.0]
    step(1e-6)
    assert [step(np.nan).trip for _ in range(3)] == [0.0, 0.0, codes.TRIP_READING]


@pytest.mark.parametrize("place", range(5))
@pytest.mark.parametrize("broken", [np.nan, np.inf, -np.inf, 1e30])
def test_a_broken_setpoint_counts_like_a_broken_reading(broken: float, place: int) -> None:
    step = Stepped()
    last = step(1e-6).applied
    setpoint = [0.0] * 5
    setpoint[place] = broken
    assert (step(1e-6, setpoint).applied, step(1e-6, setpoint).trip) == (last, codes.TRIP_READING)
    assert step.finite()


def _moving(x: np.ndarray, setpoints: np.ndarray, law: Law | None = None) -> np.ndarray:
    step = Stepped(law, velocity=0.1)
    return np.array([step(reading, setpoint).requested for reading, setpoint in zip(x, setpoints, strict=True)])


@pytest.mark.parametrize("lost", ["reading", "setpoint"])
def test_the_axis_goes_on_while_a_command_is_held(lost: str) -> None:
    """At 0.1 m/s and 5 m/s². A law that saw the last reading twice would jump by Kp v = 2000 N, and again back."""
    t = T * np.arange(1, 60)
    x, v = 0.1 * t + 2.5 * t * t, 0.1 + 5.0 * t
    setpoints = np.column_stack([x + 1e-5, v, np.full_like(t, 5.0), np.zeros_like(t), np.zeros_like(t)])
    whole = _moving(x, setpoints)
    holed_x, holed_setpoints = x.copy(), setpoints.copy()
    (holed_x if lost == "reading" else holed_setpoints)[40] = np.nan
    holed = _moving(holed_x, holed_setpoints)
    assert np.array_equal(holed[:40], whole[:40])
    assert holed[40] == whole[39]
    # what is missed is a T² = 5 um of motion, which is Kp a T = 100 N once for a reading and Kp/Tn of it from then on
    assert np.max(np.abs(holed[41:] - whole[41:])) < (110.0 if lost == "reading" else 10.0)
    assert np.max(np.abs(holed[42:] - whole[42:])) < 10.0


def test_a_loop_is_not_enabled_on_a_broken_reading() -> None:
    step = Stepped()
    assert step(np.nan, enable=0.0).trip == codes.TRIP_NONE
    assert step(np.nan, enable=1.0).trip == codes.TRIP_READING
    assert step(0.0, enable=0.0).trip == codes.TRIP_NONE
    assert step(0.0, enable=1.0).running == 1.0


@pytest.mark.parametrize("enable", [np.nan, 0.0, 0.5, -1.0, -np.inf])
def test_what_is_not_above_one_half_does_not_enable(enable: float) -> None:
    step = Stepped(safe_force=-30.0)
    step(1e-6)
    command = step(1e-6, enable=enable)
    assert (command.applied, command.running, command.trip) == (-30.0, 0.0, codes.TRIP_NONE)


def test_a_law_that_overflows_trips_at_once_and_starts_anew() -> None:
    """Kp = 1e300 asks for 1e297 N at 1 um; the integral is beyond all numbers a little later."""
    wild = Stepped(CascadePPI(Kv=30, Kp=1e300, Tn=1e-10), safe_force=12.0)
    for reading in (1e-6, 2e-6, -1e-6):
        command = wild(reading)
        assert (command.applied, command.requested, command.running) == (12.0, 12.0, 0.0)
        assert command.trip == codes.TRIP_COMMAND
    # tamed by a live change and enabled again, it is as if it had never run
    tame = Stepped(safe_force=12.0)
    state = tame.control.retune(wild.state, wild.control, wild.prepared, tame.prepared)
    off, on = [(3e-6, 0.0), (4e-6, 0.0)], [(4e-6, 1.0), (5e-6, 1.0)]
    fresh = [tame(reading, enable=enable) for reading, enable in (*off, *on)]
    tame.state = state
    again = [tame(reading, enable=enable) for reading, enable in (*off, *on)]
    assert [c.applied for c in again] == [c.applied for c in fresh]
    assert again[-1].running == 1.0


def test_the_safe_force_carries_a_hanging_axis_until_the_law_takes_over() -> None:
    """40 kg hang on the drive: disabled, the axis stays; at enable the law starts from the force that carries it."""
    weight = 9.81 * 40.0
    law = CascadePPI(Kv=50, Kp=8e3, Tn=0.02)
    hanging = Loop(
        sample_time=T, axis=Axis(plant=Rigid(mass=40)), control=Control(law=law, guard=Guard(safe_force=weight))
    )
    enable = np.where(np.arange(400) < 200, 0.0, 1.0)
    still = Recorded(position=np.zeros(400), sample_time=T)
    run = simulate(hanging, still, load=StepForce(force=-weight, start=0.0), enable=enable)
    assert np.all(run["force"][:200] == weight)
    assert np.max(np.abs(run["position_load"])) < 1e-12  # m


def test_a_start_from_broken_numbers_is_finite() -> None:
    for broken in BROKEN_READINGS:
        made = Stepped()
        setpoint = Setpoint(*np.full(5, np.float64(broken)))
        made.state = made.control.start(made.prepared, setpoint, np.float64(broken), np.float64(broken))
        if not np.isfinite(broken) or abs(broken) > 1e12:
            assert made.finite()
        assert [made(0.0, enable=0.0).trip, made(0.0).trip] == [0.0, 0.0]
        assert made.finite()


def test_a_guard_inside_its_bounds_changes_no_bit() -> None:
    guarded = simulate(loop(following_error_limit=0.5), Ramp(), start=(0.0, 0.0))
    bare = Loop(
        sample_time=T,
        control=Control(law=guarded_law(), force_limit=5000),
        axis=Axis(plant=Rigid(mass=100, viscous=300)),
    )
    plain = simulate(bare, Ramp(), start=(0.0, 0.0))
    assert np.array_equal(guarded["force"], plain["force"])
    assert np.array_equal(guarded["position_load"], plain["position_load"])


def guarded_law() -> CascadePPI:
    return CascadePPI(Kv=30, Kp=2e4, Tn=0.02)


def test_a_safe_force_beyond_the_limit_is_refused() -> None:
    """What is commanded while the loop is off keeps the limit of the control, too."""
    law = CascadePPI(Kv=10.0, Kp=100.0)
    with pytest.raises(ParameterError, match=r"safe_force = -60 N is beyond .*force_limit = 50 N by 10 N"):
        Control(law=law, force_limit=50.0, guard=Guard(safe_force=-60.0))


@pytest.mark.parametrize("most", [-0.2, -0.3])
def test_a_travel_without_length_is_refused(most: float) -> None:
    """A loop with such a guard would trip wherever the axis stands."""
    with pytest.raises(ParameterError, match=rf"travel_least = -0.2 m must be < guard.travel_most = {most:g} m"):
        Guard(travel_least=-0.2, travel_most=most)


def test_without_the_hold_the_first_broken_sample_trips() -> None:
    step = Stepped(holds=False, hold_samples=3, safe_force=70.0)
    step(1e-6)
    for reading, setpoint in ((np.nan, (0.0,) * 5), (1e-6, (0.0,) * 5)):
        command = step(reading, setpoint)
        assert (command.applied, command.requested, command.trip) == (70.0, 70.0, codes.TRIP_READING)
        assert step.finite(), "nothing broken is remembered"
    assert step(1e-6, enable=0.0).trip == codes.TRIP_NONE
    assert step(1e-6).running == 1.0
    assert step(1e-6, (np.inf, 0.0, 0.0, 0.0, 0.0)).trip == codes.TRIP_READING
    assert step.finite()


@pytest.mark.parametrize("broken", [np.nan, np.inf, -np.inf, 1e30])
def test_without_the_check_of_the_setpoint_the_command_trips(broken: float) -> None:
    """NaN detection remains: no command is a broken number, and the next enable starts as if nothing had been."""
    step, fresh = Stepped(checks_setpoint=False, safe_force=70.0), Stepped(safe_force=70.0)
    step(1e-6)
    command = step(1e-6, (broken, 0.0, 0.0, 0.0, 0.0))
    assert (command.applied, command.requested, command.trip) == (70.0, 70.0, codes.TRIP_COMMAND)
    for each in (step, fresh):
        each(2e-6, enable=0.0)
        each(2e-6, enable=0.0)
    assert step(2e-6, (1e-6, 0.0, 0.0, 0.0, 0.0)).applied == fresh(2e-6, (1e-6, 0.0, 0.0, 0.0, 0.0)).applied
    assert step.finite()


def test_without_alignment_and_moving_start_the_law_sees_readings_as_they_are() -> None:
    def verdict(**parts: bool) -> Guard.Verdict:
        guard, zero = Guard(**parts), np.float64(0.0)
        prepared = guard.prepare(np.float64(T))
        state = guard.start(prepared, Setpoint(*np.zeros(5)), np.float64(5e-3), zero, np.float64(0.1))
        motor, load, enable = np.float64(5e-3 + 1e-4), np.float64(1e-4), np.float64(1.0)
        return guard.step(prepared, state, Setpoint(*np.zeros(5)), motor, load, enable)[1]

    whole, apart, resting = verdict(), verdict(aligns=False), verdict(starts_moving=False)
    tiny = 1e-15  # m, rounding
    assert whole.position_motor == pytest.approx(1e-4, abs=tiny)
    assert whole.before_motor == pytest.approx(0.0, abs=tiny)
    assert whole.velocity == pytest.approx(0.1)
    assert (apart.position_motor, apart.before_motor) == (5e-3 + 1e-4, 5e-3)
    assert (resting.before_motor, resting.before_load, resting.velocity) == (resting.position_motor, 1e-4, 0.0)


def test_parts_that_are_left_out_change_no_bit_of_a_usual_run() -> None:
    parts = {"checks_setpoint": False, "holds": False, "aligns": False, "starts_moving": False}
    runs = [simulate(loop(following_error_limit=0.5, **each), Ramp(), start=(0.0, 0.0)) for each in ({}, parts)]
    assert np.array_equal(runs[0]["force"], runs[1]["force"])

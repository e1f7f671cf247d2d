"""The safety of the loop: enable, trips, broken readings, and what happens to the force in that very sample."""

from __future__ import annotations

import numpy as np
import pytest

from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.families import Load, Reference
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.signals import Setpoint
from feeddrive.language import tree
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


def test_a_reading_that_is_not_a_number_stops_the_loop_before_the_law_sees_it() -> None:
    plain = loop()
    control = plain.control
    made = tree.rebuild(control, (np.float64(v) for _, v in tree.leaves(control)))
    prepared = made.prepare(np.float64(T))
    setpoint = Setpoint(np.float64(0.0))
    state = made.start(prepared, setpoint, np.float64(0.0), np.float64(0.0))
    state, command = made.step(prepared, state, setpoint, np.float64(1e-6), np.float64(1e-6), 1.0, np.float64(T))
    last = command.applied
    assert last != 0.0
    for broken in (np.nan, np.inf, -np.inf, 1e9):
        after, command = made.step(
            prepared, state, setpoint, np.float64(broken), np.float64(broken), 1.0, np.float64(T)
        )
        assert command.applied == command.requested == last, "the command is held"
        assert command.trip == codes.TRIP_NONE
        after, command = made.step(
            prepared, after, setpoint, np.float64(broken), np.float64(broken), 1.0, np.float64(T)
        )
        assert command.applied == 0.0
        assert command.trip == codes.TRIP_READING
        assert all(np.isfinite(value) for _, value in tree.leaves(after)), "nothing broken is remembered"


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

"""Drives on a bus: the client against the virtual drive, over CANopen in this process and EtherCAT on a veth pair."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import pytest

import bus_scenarios
from bus_bench import SCALING, T, over_ethercat

Scenario = Callable[[str], dict[str, Any]]


@pytest.fixture(params=["canopen", "ethercat"])
def tried(request: pytest.FixtureRequest) -> Scenario:
    """Runs a scenario over one of the buses."""

    return over_ethercat if request.param == "ethercat" else over_canopen


@lru_cache
def over_canopen(name: str) -> dict[str, Any]:
    """Several tests look at one run."""
    return getattr(bus_scenarios, name)("canopen")


def test_position_mode_is_the_simulation_to_half_an_increment(tried: Scenario) -> None:
    """20 mm under 100 N of chirp: what the bus rounds is all that differs; a cycle too late would be thousands."""
    found = tried("exact")
    assert found["rows"] == bus_scenarios.N
    assert found["lost"] == 0
    assert found["target"] == 0.0
    assert found["moved"] > 0.0199
    half = 0.5 + 1e-6  # increments: the rounding of a division
    assert found["load_increments"] <= half
    assert found["motor_increments"] <= half
    assert found["force_per_mille"] <= half


def test_torque_mode_accelerates_by_newton(tried: Scenario) -> None:
    """x(t) = F/c (t - m/c (1 - exp(-ct/m))) of 100 kg and 300 N s/m, 298 samples long; the spring gives under 10 um."""
    found = tried("torque")
    assert found["force"] == pytest.approx(found["sent"], abs=1e-12)
    assert abs(found["sent"] - 60.0) <= 0.5 * SCALING.newton
    m, c, t = 100.0, 300.0, 298 * T
    expected = found["sent"] / c * (t - m / c * (1.0 - math.exp(-c * t / m)))
    assert found["moved"] == pytest.approx(expected, abs=1e-5)


def test_velocity_mode_reaches_its_target(tried: Scenario) -> None:
    """The integral of the velocity loop leaves nothing but an increment a cycle."""
    assert tried("speed")["velocity"] == pytest.approx(0.05, abs=SCALING.metre / T)


def test_lost_frames_are_marked_and_too_many_end_the_motion(tried: Scenario) -> None:
    found = tried("losses")
    few, many = found["few"], found["many"]
    assert few["aborted"] is None
    assert (few["lost"], few["marked"], few["rows"]) == (2, 2.0, bus_scenarios.N)
    assert few["finite"]
    assert many["aborted"].startswith("3 frames in a row were lost: it ")
    assert "the axis was stopped" in many["aborted"]
    assert many["rows"] < 110
    assert many["state"] == "SWITCH_ON_DISABLED"


def test_a_fault_is_named_and_only_a_reset_leads_out_of_it(tried: Scenario) -> None:
    found = tried("faults")
    assert found["state"] == "FAULT"
    assert found["trouble"] == "fault 0x8611, following error too large"
    assert "--reset-fault" in found["refused"]
    assert (found["after"], found["again"], found["off"]) == ("SWITCH_ON_DISABLED", "ENABLED", "SWITCH_ON_DISABLED")


def test_a_broken_limit_and_ctrl_c_stop_the_axis_and_keep_the_log(tried: Scenario) -> None:
    found = tried("limits")
    assert "exceeded limits.following_error = 2e-05 m; the axis was stopped" in found["aborted"]
    assert 0 < found["rows"] < bus_scenarios.N
    assert found["pressed"].startswith("stopped by hand; the axis was stopped")
    assert found["state"] == found["pressed_state"] == "SWITCH_ON_DISABLED"
    assert found["drift"] < 2e-6  # m in 50 ms without force: what the loop had not settled in 0.2 s of standstill


@pytest.mark.parametrize(
    ("what", "words"),
    [
        ("counts", "scaling.counts_per_turn = 2e+06 in the drive file, but the drive says 1e+06 in object 0x608F:01"),
        ("torque", "scaling.rated_torque = 10 in the drive file, but the drive says 1 in object 0x6076:00"),
        ("gear", "scaling.gear = 2 in the drive file, but the drive says 1 in object 0x6091:01"),
        ("unpaced", "only a virtual drive may be run without a clock"),
        ("mode", 'does not support mode = "csv"; it supports csp, cst'),
    ],
)
def test_what_does_not_fit_the_drive_is_refused(tried: Scenario, what: str, words: str) -> None:
    assert words in tried("wrong")[what]


@pytest.mark.parametrize(
    ("what", "words"),
    [
        ("missing", "0x5000:00 cannot be read: no such object"),
        ("read_only", "0x6041:00 cannot be written: read only"),
        ("length", "0x6072:00 cannot be written: of another length"),
        ("mapping", "0x1600:00 cannot be written: not in this state"),
        ("mode", "0x6060:00 cannot be written: value out of range"),
        ("subindex", "0x1018:09 cannot be read: no such subindex"),
    ],
)
def test_an_object_that_is_refused_is_named_with_the_reason(tried: Scenario, what: str, words: str) -> None:
    assert words in tried("refusals")[what]


def test_a_drive_that_left_op_by_its_watchdog_is_named() -> None:
    found = over_ethercat("silence")
    assert "it is in SAFE-OP, Sync manager watchdog (0x001B)" in found["trouble"]
    assert (found["state"], found["code"]) == ("FAULT", 0x7500)
    assert "emergency stop" in found["unreachable"]


def test_a_drive_is_logged_without_being_switched_on(tried: Scenario) -> None:
    found = tried("hearing")
    assert (found["rows"], found["state"]) == (200, "SWITCH_ON_DISABLED")
    assert found["channels"] == ["force", "reading_load", "reading_motor", "velocity_load"]

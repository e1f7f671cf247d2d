"""The safety monitor: each check on either side of its bound; injected faults on both buses in virtual time."""

from __future__ import annotations

import os
import pty
import signal
import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from bus_bench import LIMITS, drive
from feeddrive.bus.cia402 import DISABLE_VOLTAGE, PowerState
from feeddrive.bus.cia402 import MODES as NUMBERS
from feeddrive.bus.drive_file import BusDrive, BusLimits, DriveScaling
from feeddrive.bus.faults import KINDS as ACTED
from feeddrive.bus.faults import read_fault
from feeddrive.bus.monitor import (
    BRAKE,
    OFF,
    QUICK_STOP,
    Braking,
    Cycle,
    Monitor,
    begin_braking,
    brake,
    reaction_to,
)
from feeddrive.bus.play import Profile, check_profile, interruption
from feeddrive.bus.watch import Answer, Fault, Target
from feeddrive.language.errors import ParameterError
from injected_faults import BUSES, KINDS, T, healthy, motion, played, trial, trials, wrong

MODES = ("csp", "csv", "cst")
ON = PowerState.ENABLED.status
EACH = 34  # of 16 classes: 544 in each mode and on each bus
HEALTHY = 167  # in each mode and on each bus: 1,002


REST = Answer(0.0, 0.0, 0.0)


def described(mode: str = "csp", count: float = 1e-6, **limits: Any) -> BusDrive:
    """A drive of 1 ms with limits out of the way, but those that are given."""
    wide = {"travel": 1e6, "velocity": 1e6, "force": 1e9, "following_error": 1e6, "largest_mass": 120.0}
    bounds = BusLimits(**{**wide, "breakaway_force": 5.0, "quick_stop_deceleration": 5.0, **limits})
    scaling = DriveScaling(increment=count, rated_force=1.0)
    return BusDrive(bus="canopen", cycle_time=T, mode=mode, scaling=scaling, limits=bounds)


def watched(
    made: BusDrive,
    answers: Sequence[Answer],
    targets: Sequence[Target] | None = None,
    follows: bool = False,
    **changed: Any,
) -> Any:
    """The first fault of a run from rest, or None; `changed`: fields of its last cycle."""
    monitor = Monitor(made, follows=follows)
    state = monitor.begin(REST)
    for k, answer in enumerate(answers):
        target = Target(0.0, 0.0, 0.0) if targets is None else targets[k]
        cycle = Cycle(target, answer, ON, NUMBERS[made.mode])
        state, fault = monitor.step(state, cycle._replace(**changed) if k == len(answers) - 1 else cycle)
        if fault is not None:
            return fault
    return None


def going(speed: float, cycles: int, ratio: float = 1.0, force: float = 0.0) -> list[Answer]:
    """The answers of an axis at a speed, m/s, whose 0x606C is that times `ratio`."""
    return [REST] * 8 + [Answer(speed * T * k, ratio * speed, force) for k in range(1, cycles + 1)]


@pytest.mark.parametrize(("thousandths", "ends"), [(8.0, False), (15.0, True)])
def test_the_noise_of_a_force_at_its_limit_ends_no_motion(thousandths: float, ends: bool) -> None:
    made = described(force=0.1)
    beyond = Answer(0.0, 0.0, 0.1 + thousandths * made.scaling.newton)
    found = watched(made, [REST, beyond])
    assert (found is not None) == ends
    assert found is None or found.kind == "force"


@pytest.mark.parametrize(("counts", "kind"), [(19, None), (21, "jump")])
def test_a_jump_is_what_no_acceleration_and_no_noise_makes(counts: int, kind: str | None) -> None:
    """A position may be renewed after 5 cycles: 20 m/s2 make 1 mm of it; ten counts of 0.1 mm are noise, rounding."""
    fault = watched(described(count=1e-4, acceleration=20.0), [*[REST] * 8, Answer(counts * 1e-4, 0.0, 0.0)])
    assert (fault and fault.kind) == kind


def test_without_a_limit_of_acceleration_a_jump_is_beyond_the_largest_speed() -> None:
    made = described(velocity=0.5)
    assert watched(made, [*[REST] * 8, Answer(2.5e-3, 0.0, 0.0)]) is None
    fault = watched(made, [*[REST] * 8, Answer(2.52e-3, 0.0, 0.0)])
    assert fault.kind == "jump"
    assert "limits.velocity allows" in fault.message


@pytest.mark.parametrize(("beyond", "kind"), [(1, None), (2, "runaway")])
def test_a_runaway_grows_for_two_cycles_beyond_three_quarters(beyond: int, kind: str | None) -> None:
    """At 50 mm/s from a target that stands, along its force: 15 cycles are 3/4 of 1 mm."""
    answers = [*going(0.05, 15 + beyond, force=10.0), Answer(0.74e-3, 0.0, 10.0)]
    fault = watched(described(following_error=1e-3), answers)
    assert (fault and fault.kind) == kind


def test_a_force_that_brakes_is_no_runaway() -> None:
    """The same way at a speed that does not grow, against its force: the following error ends it."""
    fault = watched(described(following_error=1e-3), going(0.05, 30, force=-10.0))
    assert fault.kind == "following_error"


@pytest.mark.parametrize(
    ("ratio", "kind"), [(1.4, "runaway"), (1.6, "following_error"), (-1.0, "velocity_contradicts")]
)
def test_positions_that_the_velocity_does_not_confirm_are_no_runaway(ratio: float, kind: str) -> None:
    made = described(following_error=1e-3)
    made = replace(made, limits=replace(made.limits, following_error=1e-3))
    assert watched(made, going(0.05, 30, ratio, 10.0)).kind == kind


def test_a_runaway_in_cst_goes_against_its_force() -> None:
    """100 N for 60 ms: the axis may stand or go along, and braked by it, but not go the other way."""
    made, pushed = described("cst", largest_mass=1e6), [Target(0.0, 0.0, 100.0)] * 60
    along = [Answer(1e-3 * (0.02 * k) ** 2, 1e-3 * 0.02**2 * (2 * k - 1) / T, 100.0) for k in range(60)]
    assert watched(made, along, pushed) is None
    away = [Answer(-answer.position, -(answer.velocity or 0.0), answer.force) for answer in along]
    fault = watched(made, away, pushed)
    assert fault.kind == "runaway"
    assert reaction_to(fault) == OFF
    # elastic parts swing against the force of a control, whose set position tells a runaway
    swinging = [target._replace(position=answer.position) for target, answer in zip(pushed, away, strict=True)]
    assert watched(made, away, swinging, follows=True) is None
    braked = [Answer(-0.1 * T * k + 0.5 * (k * T) ** 2, -0.1 + k * T, 100.0) for k in range(60)]
    assert watched(made, braked, pushed) is None


def test_in_csv_under_a_control_the_set_position_is_followed_and_not_the_velocity() -> None:
    """A force pushes the axis along at 0.1 m/s, where the control asks for 0.05 m/s to hold its set position."""
    made = described("csv", following_error=3e-3)
    pushed = [Answer(0.1 * T * k, 0.1, 20.0) for k in range(100)]
    led = [Target(answer.position + 0.5e-3, 0.05, 0.0) for answer in pushed]
    assert watched(made, pushed, led, follows=True) is None
    # of a profile of velocities alone, nothing else is known
    assert watched(made, pushed, led) is not None
    stands = [Target(0.0, 0.05, 0.0)] * 100
    fault = watched(made, pushed, stands, follows=True)
    assert fault.kind == "runaway"
    # 3/4 of 3 mm at 0.1 mm a cycle, 2 cycles more, and the cycle of the target that acts
    assert fault.cycle <= 26


@pytest.mark.parametrize(
    ("bounds", "answers", "kind"),
    [
        ({"energy": 60.1}, going(1.0, 1), None),  # 120 kg at 1 m/s: 60 J
        ({"energy": 59.9}, going(1.0, 1), "energy"),
        ({"acceleration": 5.5}, [Answer(2.5 * (k * T) ** 2, 5.0 * k * T, 0.0) for k in range(60)], None),
        ({"acceleration": 4.5}, [Answer(2.5 * (k * T) ** 2, 5.0 * k * T, 0.0) for k in range(60)], "acceleration"),
        # 0.1 m/s: 6 cycles of reaction are 0.6 mm, and 1 mm at 5 m/s2
        ({"travel": 7.55e-3}, going(0.1, 60), "travel"),
        ({"travel": 7.55e-3}, going(0.1, 59), None),
        ({"position_most": 7.55e-3}, going(0.1, 60), "position"),
        ({"position_least": -7.55e-3}, going(-0.1, 59), None),
        ({"position_least": -7.55e-3}, going(-0.1, 61), "position"),
    ],
)
def test_a_limit_has_a_case_on_either_side(bounds: dict[str, Any], answers: list[Answer], kind: str | None) -> None:
    fault = watched(described(**bounds), answers)
    assert (fault and fault.kind) == kind
    assert fault is None or reaction_to(fault) == BRAKE


def test_the_target_counts_where_it_leads_the_axis() -> None:
    """In csp the axis goes on to a target that is 5 mm ahead, in csv it makes up for what it lags behind."""
    ahead = [Target(5e-3, 0.0, 0.0)] * 10
    assert watched(described(travel=4.9e-3), [REST] * 10, ahead).kind == "travel"
    asked = [Target(0.0, 0.1, 0.0)] * 60
    lagging = [Answer(0.08 * T * k, 0.08, 0.0) for k in range(60)]
    fault = watched(described("csv", travel=6.5e-3), lagging, asked)
    assert fault.kind == "travel"
    assert fault.cycle < 59


@pytest.mark.parametrize(
    ("changed", "kind", "reaction"),
    [
        ({"stop": "a door was opened"}, "stop", BRAKE),
        ({"statusword": PowerState.FAULT.status}, "drive", QUICK_STOP),
        ({"statusword": PowerState.QUICK_STOP.status}, "drive", QUICK_STOP),
        ({"mode": 1}, None, ""),
    ],
)
def test_state_mode_and_a_person_end_the_motion(changed: dict[str, Any], kind: str | None, reaction: str) -> None:
    fault = watched(described(), [REST] * 5, **changed)
    assert (fault and fault.kind) == kind
    assert fault is None or reaction_to(fault) == reaction


@pytest.mark.parametrize(
    ("level", "inputs", "stops"),
    [
        (0, 1 << 16, False),
        (0, ~(1 << 16) & 0xFFFFFFFF, True),
        (1, 1 << 16, True),
        (1, 1 << 15, False),
        (0, None, False),
    ],
)
def test_a_stop_input_ends_the_motion_on_the_ramp_at_its_level(level: int, inputs: int | None, stops: bool) -> None:
    made = replace(described(), stop_input=16, stop_level=level)
    fault = watched(made, [REST] * 5, inputs=inputs)
    assert (fault is not None) == stops
    assert fault is None or (fault.kind, reaction_to(fault)) == ("stop_input", BRAKE)
    # without one no input stops
    assert watched(described(), [REST] * 5, inputs=inputs) is None
    # it stays pressed while the axis brakes
    monitor = Monitor(made)
    cycle = Cycle(Target(0.0, 0.0, 0.0), REST, ON, 8, inputs=inputs)
    assert monitor.step(monitor.brakes(monitor.begin(REST)), cycle, braking=True)[1] is None


def test_another_mode_is_one_that_lasts_for_longer_than_its_command_needs() -> None:
    monitor = Monitor(described())
    state, kinds = monitor.begin(REST), list[str | None]()
    for _ in range(3):
        state, fault = monitor.step(state, Cycle(Target(0.0, 0.0, 0.0), REST, ON, 1))
        kinds.append(fault and fault.kind)
    assert kinds == [None, None, "mode"]


def test_lost_frames_are_counted_in_a_row() -> None:
    monitor = Monitor(described())
    state, kinds = monitor.begin(REST), list[str | None]()
    for answer in (None, None, REST, None, None, None):
        state, fault = monitor.step(state, Cycle(Target(0.0, 0.0, 0.0), answer, ON, 8))
        kinds.append(fault and fault.kind)
    assert kinds == [None] * 5 + ["frames"]


def test_a_velocity_that_is_not_obeyed_is_a_following_error_of_csv() -> None:
    asked = [Target(0.0, 0.05, 0.0)] * 200
    assert watched(described("csv", following_error=1e-3), going(0.05, 192), asked[:200]) is None
    fast = [Answer(0.08 * T * k, 0.08, 0.0) for k in range(200)]
    assert watched(described("csv", following_error=1e-3), fast, asked).kind in ("following_error", "runaway")


def braking_at(speed: float, later: float) -> Fault | None:
    """A fault of an axis that begins to brake at a speed, m/s, and has another one later."""
    monitor = Monitor(described(quick_stop_deceleration=0.1))
    state, x = monitor.begin(REST), 0.0
    for k in range(60):
        v = speed if k < 20 else later
        x += v * T
        if k == 20:
            state = monitor.brakes(state)
        cycle = Cycle(Target(x, 0.0, 0.0), Answer(x, v, 0.0), ON, 8)
        state, fault = monitor.step(state, cycle, braking=k >= 20)
        if fault is not None:
            return fault
    return None


def test_an_axis_that_brakes_is_not_faster_by_a_tenth() -> None:
    assert braking_at(0.1, 0.105) is None
    fault = braking_at(0.1, 0.12)
    assert fault is not None
    assert fault.kind == "braking"
    assert reaction_to(fault) == OFF


@pytest.mark.parametrize(("speed", "rests"), [(0.004, True), (0.006, False)])
def test_an_axis_rests_that_would_not_leave_half_its_following_error_in_a_tenth_of_a_second(
    speed: float, rests: bool
) -> None:
    monitor = Monitor(described(following_error=1e-3))
    state = monitor.begin(REST)
    for k in range(20):
        at = speed * T * k
        state, _ = monitor.step(state, Cycle(Target(at, 0.0, 0.0), Answer(at, speed, 0.0), ON, 8))
    assert (monitor.rests(state) is None) is rests


@pytest.mark.parametrize("mode", ["csp", "csv"])
def test_a_ramp_takes_the_square_of_the_speed_and_then_waits_for_the_position_loop(mode: str) -> None:
    """0.1 m/s at 5 m/s2: 1 mm in 20 cycles; a loop of 30 1/s has then lost all but a hundredth of its lag, in 0.3 s."""
    made = described(mode)
    state = begin_braking(made, Target(1e-4, 0.1, 0.0), Target(0.0, 0.1, 0.0), 0.1)
    begun, rows = state, list[Braking]()
    while state.left > 0:
        state = brake(made, state, 0.1)
        rows.append(state)
    assert state.position - begun.position == pytest.approx(1e-3, rel=1e-6)
    assert max(np.diff([row.velocity for row in rows], prepend=0.1)) <= 0.0
    assert sum(row.velocity > 1e-12 for row in rows) in (19, 20)
    held = T * sum(row.velocity == 0.0 for row in rows)
    assert np.exp(-30.0 * held) < 0.01
    assert held < 0.3


@pytest.mark.parametrize("mass", [120.0, 40.0])
def test_a_braking_force_neither_turns_a_light_axis_nor_lets_a_heavy_one_go_on(mass: float) -> None:
    """120 kg stated; 0.1 m/s at 5 m/s2 are 1 mm, and 3 cycles of delay 0.3 mm. Velocities come a cycle late."""
    made = described("cst", quick_stop_deceleration=5.0)
    state, x, v, told = begin_braking(made, Target(0, 0, 0), Target(0, 0, 0), 0.1), 0.0, 0.1, [0.1, 0.1]
    most, speeds = 0.0, list[float]()
    for _ in range(300):
        state = brake(made, state, told[-2])
        most = max(most, abs(state.force))
        v += state.force / mass * T
        x += v * T
        told.append(v)
        speeds.append(v)
    assert most <= 120.0 * 5.0
    assert min(speeds) > -0.05 * 0.1
    assert x < 1.3e-3
    assert abs(v) < 5e-3


def test_a_plan_that_could_not_be_braked_within_the_travel_is_refused() -> None:
    """20 mm there at 47 mm/s at most: it ends at rest, but a quick stop on its way needs some more than its end."""
    t = np.linspace(0.0, 1.0, 800)
    position = 0.02 * t**3 * (10.0 - 15.0 * t + 6.0 * t * t)
    made = Profile("plan", "", T, "N", np.zeros(800), position, np.gradient(position, T))
    check_profile(made, drive("ethercat", limits=replace(LIMITS, travel=0.0202)))
    with pytest.raises(ParameterError, match="plans travel"):
        check_profile(made, drive("ethercat", limits=replace(LIMITS, travel=0.02)))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_and_the_loss_of_the_terminal_stop(number: signal.Signals) -> None:
    with interruption(keys=True) as interrupted:
        assert interrupted() == 0
        os.kill(os.getpid(), number)
        assert interrupted() == 1
        os.kill(os.getpid(), number)
        assert interrupted() == 2  # the second ends the hold of an axis whose brake slips


def test_a_key_stops(monkeypatch: pytest.MonkeyPatch) -> None:
    """At a terminal with this process in its foreground, and its settings are those of before afterwards."""
    import termios

    master, line = pty.openpty()
    with os.fdopen(line, "r") as terminal:
        monkeypatch.setattr(sys, "stdin", terminal)
        monkeypatch.setattr(os, "tcgetpgrp", lambda _: os.getpgrp())
        before = termios.tcgetattr(line)
        with interruption(keys=True) as interrupted:
            assert interrupted() == 0
            os.write(master, b"x")
            assert (interrupted(), interrupted()) == (1, 1)
        assert termios.tcgetattr(line)[3] == before[3]
        with interruption() as interrupted:
            os.write(master, b"x")
            assert interrupted() == 0
    os.close(master)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("melt@150", "there are freeze, "),
        ("freeze", "must name a kind and a cycle"),
        ("jump@soon", "'soon' is not a number of a cycle"),
        ("jump@150=far", "jump@150=0.002"),
    ],
)
def test_a_fault_that_cannot_be_acted_is_named(text: str, words: str) -> None:
    with pytest.raises(ParameterError) as refused:
        read_fault(text)
    assert words in str(refused.value)


def test_every_fault_of_a_virtual_drive_is_tried() -> None:
    assert set(ACTED) <= set(KINDS)
    assert read_fault("jump@150=0.001") == ("jump", 150, 0.001)
    assert read_fault("lost@7").size == ACTED["lost"].usual


@pytest.mark.parametrize("bus", BUSES)
def test_a_drive_without_frames_stops_by_its_own_watchdog_after_a_tenth_of_a_second(bus: str) -> None:
    """Counted in cycles: those of the drive go on without any frame."""
    rest = Profile("rest", "", T, "N", np.zeros(300), np.zeros(300), np.zeros(300))
    states = list[str]()
    _, frames, firmware, _ = played(
        "csp", bus, rest, (read_fault("cable@50"),), each=lambda firmware: states.append(firmware.state.name)
    )
    assert firmware.values["error_code"] == 0x7500
    assert firmware.faults.began is not None
    assert states.index("FAULT_REACTION") - firmware.faults.began == pytest.approx(100, abs=2)
    assert frames.answers[-1] is None


@pytest.mark.parametrize("seed", range(3))
def test_in_a_runaway_the_force_is_off_before_the_drive_brakes_by_itself(seed: int) -> None:
    """With the wrong sign its own ramp would drive the axis on, and no command ends it: 0x6066 leaves the time."""
    states = list[str]()
    found, frames, firmware, _ = played(
        "csp",
        "ethercat",
        motion(np.random.default_rng([seed, 3]), "csp"),
        (read_fault("sign@200"),),
        each=lambda firmware: states.append(firmware.state.name),
    )
    assert "runs away" in found.aborted
    assert firmware.values["fault_reaction_option"] == 2
    assert "FAULT_REACTION" not in states
    assert frames.sent[-1]["controlword"] == DISABLE_VOLTAGE


def test_a_brake_that_slips_is_held_for_a_second_where_nobody_waits() -> None:
    found, frames, *_ = played(
        "csp", "ethercat", motion(np.random.default_rng(1), "csp"), (read_fault("brake_slip@5"),)
    )
    off = next(f for f in range(100, len(frames.sent)) if frames.sent[f]["controlword"] == 0)
    held = sum(sent["controlword"] == 0x0F for sent in frames.sent[off:])
    assert 700 < held < 1500
    assert "its brake slips" in found.aborted


def test_a_fault_that_is_told_late_is_named() -> None:
    found, *_ = played("csp", "canopen", motion(np.random.default_rng(1), "csp"), (read_fault("late_status@150=5"),))
    assert "fault 0x2310, overcurrent" in found.aborted


@pytest.mark.parametrize("mode", MODES)
def test_each_fault_is_reacted_to_in_time_and_within_its_bound(mode: str) -> None:
    """One of each class; the buses take turns."""
    made = [(trial(kind, mode, tuple(BUSES)[k % 2], 0), tuple(BUSES)[k % 2]) for k, kind in enumerate(KINDS)]
    # what cannot be observed in this motion, and was not, is no reaction
    shown = [(each, bus) for each, bus in made if each.observed is not None or each.commanded is not None]
    assert [text for each, bus in shown if (text := wrong(each, mode, bus))] == []
    assert len(shown) >= 12


@pytest.mark.parametrize("mode", MODES)
def test_healthy_drives_in_virtual_time_are_not_stopped(mode: str) -> None:
    assert [why for bus in BUSES for seed in range(1) if (why := healthy(mode, bus, seed))] == []


@pytest.mark.slow(reason="510 faults in each mode and on each bus, some 400 cycles each")
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("bus", BUSES)
@pytest.mark.parametrize("mode", MODES)
def test_five_hundred_faults_are_reacted_to_in_time_and_within_their_bounds(mode: str, bus: str) -> None:
    found = [made for kind in KINDS for made in trials(kind, mode, bus, EACH)[0]]
    assert [text for made in found if (text := wrong(made, mode, bus))] == []
    assert len(found) >= 500


@pytest.mark.slow(reason="167 healthy motions in each mode and on each bus")
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("bus", BUSES)
@pytest.mark.parametrize("mode", MODES)
def test_a_thousand_healthy_motions_are_not_stopped(mode: str, bus: str) -> None:
    assert [why for seed in range(HEALTHY) if (why := healthy(mode, bus, seed))] == []

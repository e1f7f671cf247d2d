"""The power state machine, the units and the objects of a drive, without any bus."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus_bench import SCALING, T, bench_loop
from feeddrive.blocks.force.gravity import Gravity
from feeddrive.bus.cia402 import (
    DISABLE_VOLTAGE,
    ENABLE_OPERATION,
    FAULT_RESET,
    OBJECTS,
    QUICK_STOP,
    SENT,
    SHUTDOWN,
    SWITCH_ON,
    TOLD,
    Layout,
    PowerState,
    answer,
    state_of,
)
from feeddrive.bus.drive_file import DriveScaling, interpolation_time, read_drive
from feeddrive.bus.virtual_drive import Brake, DrivenAxis, Firmware, drive_text, scaling_of
from feeddrive.files.machine import read_machine
from feeddrive.language.errors import ParameterError

S = PowerState
# the transitions of IEC 61800-7-201 that a controlword asks for; every other pair leaves the state as it is
ALLOWED = {
    (S.SWITCH_ON_DISABLED, SHUTDOWN): S.READY,
    (S.READY, SWITCH_ON): S.SWITCHED_ON,
    (S.READY, ENABLE_OPERATION): S.READY,  # by way of switched on only
    (S.READY, DISABLE_VOLTAGE): S.SWITCH_ON_DISABLED,
    (S.READY, QUICK_STOP): S.SWITCH_ON_DISABLED,
    (S.SWITCHED_ON, ENABLE_OPERATION): S.ENABLED,
    (S.SWITCHED_ON, SHUTDOWN): S.READY,
    (S.SWITCHED_ON, DISABLE_VOLTAGE): S.SWITCH_ON_DISABLED,
    (S.SWITCHED_ON, QUICK_STOP): S.SWITCH_ON_DISABLED,
    (S.ENABLED, SWITCH_ON): S.SWITCHED_ON,
    (S.ENABLED, SHUTDOWN): S.READY,
    (S.ENABLED, DISABLE_VOLTAGE): S.SWITCH_ON_DISABLED,
    (S.ENABLED, QUICK_STOP): S.QUICK_STOP,
    (S.QUICK_STOP, DISABLE_VOLTAGE): S.SWITCH_ON_DISABLED,
    (S.FAULT, FAULT_RESET): S.SWITCH_ON_DISABLED,
}


@pytest.mark.parametrize("state", S, ids=lambda state: state.name)
@pytest.mark.parametrize("word", [SHUTDOWN, SWITCH_ON, ENABLE_OPERATION, DISABLE_VOLTAGE, QUICK_STOP, FAULT_RESET])
def test_only_the_transitions_of_the_standard_happen(state: PowerState, word: int) -> None:
    if word == FAULT_RESET and state is not S.FAULT:
        word = DISABLE_VOLTAGE  # which its other bits say
    assert answer(state, word, 0) is ALLOWED.get((state, word), state)


@given(st.sampled_from(list(S)), st.integers(0, 0xFFFF), st.integers(0, 0xFFFF))
def test_no_controlword_leads_out_of_a_fault_but_a_rising_reset(state: PowerState, word: int, before: int) -> None:
    after = answer(state, word, before)
    if state is S.FAULT:
        assert (after is S.SWITCH_ON_DISABLED) == (bool(word & 0x80) and not before & 0x80)
    if after is S.ENABLED:
        assert state in (S.SWITCHED_ON, S.ENABLED)


@given(st.integers(0, 0xFFFF))
def test_a_statusword_means_one_state_at_most(word: int) -> None:
    fitting = [state for state in S if word & state.value[0] == state.value[1]]
    assert len(fitting) <= 1
    assert state_of(word) is (fitting[0] if fitting else None)


def test_every_state_is_read_from_its_own_statusword() -> None:
    assert all(state_of(state.status) is state for state in S)


def firmware(**guard: float) -> Firmware:
    return Firmware(DrivenAxis(bench_loop(**guard)), SCALING, T)


def enabled(drive: Firmware, **values: int) -> None:
    for word in (SHUTDOWN, SWITCH_ON, ENABLE_OPERATION):
        drive.take({"controlword": word, "mode": 8, "target_position": drive.values["position"], **values})
        drive.cycle()
    assert drive.state is S.ENABLED


@pytest.mark.parametrize(
    ("guard", "target", "window", "code"),
    [
        ({}, 1_000_000, 200_000, 0x8611),  # 10 mm at once, window 2 mm
        ({"following_error_limit": 1e-3}, 200_000, 0xFFFFFFFF, 0x8611),  # that of the guard
        ({"travel_most": 5e-4}, 100_000, 0xFFFFFFFF, 0x8612),
        ({"velocity_limit": 1e-2}, 400_000, 0xFFFFFFFF, 0x8400),
    ],
)
def test_the_drive_watches_over_its_own_limits(guard: dict[str, float], target: int, window: int, code: int) -> None:
    drive = firmware(**guard)
    drive.values["following_error_window"] = window
    enabled(drive)
    for _ in range(500):
        drive.take({"target_position": target})
        drive.cycle()
    assert drive.state is S.FAULT
    assert drive.values["error_code"] == code
    assert drive.values["torque"] == 0


@pytest.mark.parametrize(("timeout", "cycles"), [(0, 1), (5, 6)])
def test_a_following_error_is_a_fault_after_its_time_out(timeout: int, cycles: int) -> None:
    """0x6066 in ms, in cycles of 1 ms: 10 mm off at once, window 2 mm; within it again, the time begins anew."""
    drive = firmware()
    drive.values |= {"following_error_window": 200_000, "following_error_timeout": timeout}
    enabled(drive)
    for _ in range(2):
        for far in [10**6] * (cycles - 1) + [0]:
            drive.take({"target_position": drive.values["position"] + far})
            drive.cycle()
    assert drive.state is S.ENABLED
    for _ in range(cycles):
        assert drive.state is S.ENABLED
        drive.take({"target_position": drive.values["position"] + 10**6})
        drive.cycle()
    assert (drive.state, drive.values["error_code"]) == (S.FAULT, 0x8611)


def moving(option: int, **guard: float) -> Firmware:
    """A drive at 0.1 m/s with this fault reaction (0x605E)."""
    drive = firmware(**guard)
    drive.values |= {"following_error_window": 0xFFFFFFFF, "fault_reaction_option": option}
    enabled(drive)
    for k in range(400):
        drive.take({"target_position": 10_000 * k, "velocity_offset": 10**7})
        drive.cycle()
    assert drive.values["velocity"] * SCALING.metre == pytest.approx(0.1, rel=0.05)
    return drive


def test_in_a_fault_in_which_it_can_a_drive_brakes_if_it_is_told_to() -> None:
    """From 0.1 m/s at 5 m/s²: 1 mm, and what the position loop trails; on friction alone 33 mm, m/c = 0.33 s."""
    braked, free = moving(2), moving(0)
    begun, others = braked.values["position"], free.values["position"]
    for drive in (braked, free):
        drive.lost()
    assert (braked.state, free.state) == (S.FAULT_REACTION, S.FAULT)
    states = list[PowerState]()
    for _ in range(2000):
        for drive in (braked, free):
            drive.cycle()
        states.append(braked.state)
    assert 200 <= states.index(S.FAULT) < 300  # the ramp, and 0.2 s
    assert states[-1] is S.FAULT
    assert braked.values["error_code"] == 0x7500
    assert braked.values["torque"] == 0
    way, coasted = (SCALING.metre * (d.values["position"] - b) for d, b in ((braked, begun), (free, others)))
    assert way < 0.01
    assert coasted == pytest.approx(0.033, rel=0.1)


def test_after_its_reaction_to_a_fault_a_drive_carries_the_weight_until_its_brake_has_closed() -> None:
    """400 N, carried for 50 ms; the brake is open while the drive brakes."""
    loop = bench_loop()
    loop = replace(loop, axis=replace(loop.axis, forces=(Gravity(force=-400.0),)))
    drive = Firmware(DrivenAxis(loop), SCALING, T, brake=Brake(0.05, 0.05))
    drive.values |= {"following_error_window": 0xFFFFFFFF, "fault_reaction_option": 2}
    enabled(drive)
    for _ in range(1000):
        drive.cycle()
    drive.lost()
    while drive.state is S.FAULT_REACTION:
        drive.cycle()
    held = list[float]()
    for _ in range(100):
        drive.cycle()
        held.append(drive.values["torque"] * SCALING.newton)
    assert drive.state is S.FAULT
    assert held[:48] == pytest.approx([400.0] * 48, abs=2.0)
    assert held[52:] == [0.0] * 48


@pytest.mark.parametrize("code", [0x2310, 0x7305])
def test_without_power_stage_or_encoder_a_drive_brakes_in_no_fault(code: int) -> None:
    drive = moving(2)
    drive._fault(code)
    assert drive.state is S.FAULT


def test_a_control_that_its_guard_has_switched_off_brakes_nothing() -> None:
    """The reaction ends with the cycle in which it shows."""
    drive = moving(2, velocity_limit=0.2)
    for _ in range(10):
        drive.take({"target_position": drive.values["target_position"] + 500_000})
        drive.cycle()
    assert (drive.state, drive.values["error_code"]) == (S.FAULT, 0x8400)


def test_a_software_limit_is_a_limit_of_the_target() -> None:
    drive = firmware()
    drive.values["position_most"] = 1000
    enabled(drive)
    drive.take({"target_position": 1001})
    drive.cycle()
    assert (drive.state, drive.values["error_code"]) == (S.FAULT, 0x8612)


def test_a_quick_stop_brakes_with_its_deceleration_and_switches_off() -> None:
    """From 0.1 m/s at 5 m/s²: 20 ms and 1 mm, besides what the position loop trails (0.1/Kv m) and settles."""
    drive = firmware()
    drive.values["following_error_window"] = 0xFFFFFFFF
    enabled(drive)
    step = 10_000  # increments in a cycle of 1 ms: 0.1 m/s
    for k in range(400):
        drive.take({"target_position": k * step, "velocity_offset": 1000 * step})
        drive.cycle()
    last = drive.values["target_position"] * SCALING.metre
    drive.take({"controlword": QUICK_STOP})
    drive.cycle()
    assert drive.state is S.QUICK_STOP
    cycles = 0
    while drive.state is S.QUICK_STOP:
        drive.cycle()
        cycles += 1
        assert cycles < 1000
    assert drive.state is S.SWITCH_ON_DISABLED
    assert drive.axis.last.position - last == pytest.approx(1e-3, abs=2e-4)
    assert abs(drive.values["velocity"]) * SCALING.metre < 1e-3


@pytest.mark.parametrize(("cycles", "state"), [(150, S.QUICK_STOP), (300, S.SWITCH_ON_DISABLED)])
def test_a_quick_stop_holds_the_axis_for_200_ms_after_its_ramp(cycles: int, state: PowerState) -> None:
    """From rest, whose ramp ends at once: until the position loop has settled."""
    drive = firmware()
    enabled(drive)
    drive.take({"controlword": QUICK_STOP})
    for _ in range(cycles):
        drive.cycle()
    assert drive.state is state


def test_without_a_limit_of_the_guard_the_following_error_is_not_watched() -> None:
    """0x6065 with all bits set, by CiA 402: 10 m away are no fault."""
    drive = firmware()
    assert drive.read(0x6065, 0) == b"\xff" * 4
    enabled(drive)
    drive.take({"target_position": 10**9})
    drive.cycle()
    assert drive.state is S.ENABLED


def test_a_drive_that_loses_its_bus_faults_only_while_it_is_enabled() -> None:
    drive = firmware()
    drive.lost()
    assert drive.state is S.SWITCH_ON_DISABLED
    enabled(drive)
    drive.lost()
    assert (drive.state, drive.values["error_code"]) == (S.FAULT, 0x7500)


def test_a_bus_cycle_of_several_samples_runs_along_straight_lines() -> None:
    """Four samples a cycle under a ramp are the same setpoints as four cycles of one: to the last bit of the plant."""
    slow, fast = Firmware(DrivenAxis(bench_loop()), SCALING, 4 * T), firmware()
    enabled(slow)
    enabled(fast)
    for _ in range(9):  # the same number of samples behind both
        fast.cycle()
    step = 1 << 10
    for k in range(1, 50):
        slow.take({"target_position": 4 * step * k})
        slow.cycle()
        for i in range(4):
            fast.take({"target_position": 4 * step * (k - 1) + step * (i + 1)})
            fast.cycle()
    assert slow.axis.last.position == pytest.approx(fast.axis.last.position, abs=1e-12)
    assert slow.values["position"] == fast.values["position"] > 0


@pytest.mark.parametrize("machine", ["emps", "mill", "ball_screw"])
def test_the_drive_file_of_a_virtual_drive_holds_in_every_mode(machine: str, tmp_path: Path) -> None:
    """In cst it needs mass and breakaway force: those of the axis, and half as much again."""
    loop = next(iter(read_machine(machine).loops.values()))
    text = drive_text(loop, scaling_of(loop), "canopen", "virtual:x", 1, float(loop.sample_time))
    for mode in ("csp", "csv", "cst"):
        (tmp_path / "drive.toml").write_text(text.replace('"csp"', f'"{mode}"', 1), encoding="utf-8")
        limits = read_drive(tmp_path / "drive.toml").drive.limits
    friction = {"emps": 20.6277, "mill": 60.0, "ball_screw": 110.0}[machine]  # N at standstill, of the machine files
    mass = {"emps": 95.154, "mill": 138.957, "ball_screw": 163.0}[machine]  # kg
    assert limits.breakaway_force == pytest.approx(1.5 * friction, rel=5e-3)  # and its viscous part at 1 mm/s
    assert limits.largest_mass == pytest.approx(1.5 * mass, rel=1e-3)


def test_what_a_machine_file_does_not_state_of_its_drive_is_taken_as_usual() -> None:
    """Three times the rated force as peak; a newton in a step of the torque; an axis of 20 m in 32 bits of 10 nm."""
    loop = bench_loop()
    limited = scaling_of(loop)
    assert limited.rated_force == pytest.approx(float(loop.control.force_limit) / 3.0)
    free = scaling_of(replace(loop, control=replace(loop.control, force_limit=None)))
    assert free.newton == 1.0
    assert free.increments(20.0) < 2**31
    assert free.metre <= 10e-9


def test_a_virtual_drive_forgives_20_ms_to_an_ordinary_computer() -> None:
    """15 ms pass, 30 ms end the motion."""
    loop = bench_loop()
    text = drive_text(loop, scaling_of(loop), "canopen", "virtual:x", 1, T)
    late = int(text.partition("late_cycles = ")[2].split()[0])
    assert 15e-3 < late * T < 30e-3


@pytest.mark.parametrize("cycle_time", [1.5e-3, 0.5e-3, 0.0])
def test_a_cycle_that_is_no_multiple_of_the_sample_time_is_refused(cycle_time: float) -> None:
    with pytest.raises(ParameterError, match="whole multiple of the sample time"):
        Firmware(DrivenAxis(bench_loop()), SCALING, cycle_time)


@pytest.mark.parametrize(
    ("cycle_time", "expected"),
    [(50e-6, (50, -6)), (250e-6, (250, -6)), (375e-6, (38, -5)), (1e-3, (100, -5)), (4e-3, (40, -4)), (1.0, (100, -2))],
)
def test_the_bus_cycle_as_the_drive_is_told_it(cycle_time: float, expected: tuple[int, int]) -> None:
    value, power = interpolation_time(cycle_time)
    assert value * 10.0**power == pytest.approx(expected[0] * 10.0 ** expected[1], rel=1e-12)
    assert value <= 255


def test_a_drive_that_is_off_has_no_force_whatever_the_loop_commands_when_it_does_not_run() -> None:
    """The safe force of a hanging axis is one of a loop that has power."""
    drive = Firmware(DrivenAxis(bench_loop(safe_force=200.0)), SCALING, T)
    for _ in range(100):
        drive.cycle()
    assert drive.values["position"] == 0
    assert drive.values["torque"] == 0


@given(st.floats(-20.0, 20.0), st.floats(-1e4, 1e4))
def test_units_there_and_back_to_half_a_step(metres: float, newtons: float) -> None:
    assert abs(SCALING.increments(metres) * SCALING.metre - metres) <= 0.5 * SCALING.metre * (1 + 1e-6)
    assert abs(SCALING.per_mille(newtons) * SCALING.newton - newtons) <= 0.5 * SCALING.newton * (1 + 1e-6)


def test_units_of_a_screw_and_of_a_linear_motor() -> None:
    """10 mm over 10^6 counts and 2:1; 1 N m at the motor is 2 · 2π/0.01 N at the table."""
    screw = DriveScaling(counts_per_turn=1e6, lead=0.01, gear=2.0, rated_torque=1.0)
    assert screw.metre == pytest.approx(5e-9, rel=1e-15)
    assert 1000 * screw.newton == pytest.approx(1256.6370614359173, rel=1e-15)
    assert screw.rated_milli == 1000
    linear = DriveScaling(increment=1e-7, rated_force=500.0)
    assert (linear.metre, linear.newton, linear.rated_milli) == (1e-7, 0.5, 500_000)


@pytest.mark.parametrize(
    "given_",
    [{}, {"increment": 1e-8}, {"lead": 0.01}, {"increment": 1e-8, "rated_force": 1.0, "lead": 0.01}],
)
def test_a_scaling_that_is_neither_is_refused(given_: dict[str, float]) -> None:
    with pytest.raises(ParameterError, match="counts_per_turn, lead and rated_torque"):
        DriveScaling(**given_)


@pytest.mark.parametrize("groups", [SENT, TOLD])
def test_process_data_fit_into_messages_of_can_and_come_back(groups: tuple[tuple[str, ...], ...]) -> None:
    layout = Layout(groups)
    values = {name: OBJECTS[name].bounds()[0] for name in layout.names}
    assert layout.unpack(layout.pack(values)) == values
    for k in range(len(groups)):
        assert len(layout.pack(values)[layout.part(k)]) <= 8
    with pytest.raises(struct.error):
        layout.pack({name: OBJECTS[name].bounds()[1] + 1 for name in layout.names})

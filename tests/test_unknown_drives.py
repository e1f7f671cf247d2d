"""The drives that feeddrive does not know, against closed forms: a test that trusts them trusts these."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import unknown_drives as ud
import unknown_mechanics as um
from feeddrive.bus import cia402
from feeddrive.bus.cia402 import PowerState
from feeddrive.bus.client import DriveClient
from feeddrive.bus.drive_file import read_drive
from feeddrive.bus.play import Profile, play_profile

T = 1e-3
H = 25e-6  # s, of a substep
RIGID = {um.MASS_MOTOR: 60.0, um.MASS_LOAD: 40.0, um.STIFFNESS: 1e8, um.DAMPING: 1e4}


def coasted(servo: um.Servo, cycles: int, index: int = um.X2) -> np.ndarray:
    """A state after each of so many cycles without force."""
    values = []
    for _ in range(cycles):
        servo.cycle(loop=um.OFF)
        values.append(servo.s[index])
    return np.array(values)


def swings(x: np.ndarray, step: float) -> float:
    """The frequency of a free oscillation by its crossings of 0, Hz."""
    at = np.flatnonzero(np.diff(np.sign(x)) > 0)
    exact = at + x[at] / (x[at] - x[at + 1])
    return float((len(exact) - 1) / (exact[-1] - exact[0]) / step)


# ------------------------------------------------------------------------------------------------------ mechanics


def test_a_weight_falls_freely() -> None:
    """Both masses at the acceleration of the weight; the spring has been stretched by it, so that nothing swings."""
    servo = um.Servo({**RIGID, um.GRAVITY: -100.0 * 9.81})
    hang = -9.81 * 60.0 / 1e8  # of the load below the motor, as the motor is pulled along
    servo.s[um.X2] += hang
    x = coasted(servo, 500)
    t = T * np.arange(1, 501)
    # the steps are exact under constant forces: rounding of a stiff spring over 20,000 steps
    assert np.max(np.abs(x - hang + 0.5 * 9.81 * t * t)) < 1e-10


def test_friction_stops_a_mass_where_energy_says_and_holds_it() -> None:
    """100 kg at 0.2 m/s against 60 and 40 N: 20 mm; the stop falls into one substep."""
    servo = um.Servo({**RIGID, um.COULOMB_MOTOR: 60.0, um.COULOMB_LOAD: 40.0})
    servo.s[um.V1] = servo.s[um.V2] = 0.2
    x = coasted(servo, 400)
    assert x[-1] == pytest.approx(0.5 * 100.0 * 0.2**2 / 100.0, abs=0.2 * H)
    assert servo.s[um.V1] == servo.s[um.V2] == 0.0
    # it stands exactly, up to its level and not beyond
    for force, moves in ((59.9, False), (-59.9, False), (100.2, True)):
        servo.cycle(loop=um.FORCE_ONLY, added=force)
        before = servo.s[um.X1]
        servo.cycle(added=force)
        assert (servo.s[um.X1] != before) == moves


def test_friction_falls_with_speed_as_stribeck_says() -> None:
    """Driven at a constant speed by a viscous force, the force is level and bell of that speed."""
    p = {um.MASS_MOTOR: 50.0, um.MASS_LOAD: 50.0, um.STIFFNESS: 1e8, um.DAMPING: 1e5, um.KP: 5e4, um.RATE: 100.0}
    more = {um.COULOMB_LOAD: 50.0, um.BREAKAWAY: 1.6, um.STRIBECK_VELOCITY: 5e-3, um.VISCOUS_LOAD: 200.0}
    for speed in (2e-3, 5e-3, 20e-3):
        servo = um.Servo({**p, **more})
        for _ in range(1000):
            servo.cycle(loop=um.VELOCITY, set_velocity=speed)
        expected = 50.0 * (1.0 + 0.6 * math.exp(-((speed / 5e-3) ** 2))) + 200.0 * speed
        # the noise of counts of 1 nm in 0.125 ms is 8 um/s of the velocity loop
        assert servo.s[um.FORCE] == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("frequency", [60.0, 250.0, 600.0])
def test_motor_and_load_swing_at_their_frequency(frequency: float) -> None:
    """sqrt(k (1/m1 + 1/m2)); the steps raise it by (w h)²/24, 0.04 % at 600 Hz."""
    stiffness = (2.0 * math.pi * frequency) ** 2 * 24.0
    servo = um.Servo({um.MASS_MOTOR: 60.0, um.MASS_LOAD: 40.0, um.STIFFNESS: stiffness, um.SAMPLES: 1.0})
    servo.s[um.X1], servo.s[um.X2] = 4e-6, -6e-6
    found = swings(coasted(servo, 4000), um_step())
    assert found == pytest.approx(frequency * (1.0 + (2.0 * math.pi * frequency * H) ** 2 / 24.0), rel=1e-4)


def um_step() -> float:
    """The length of one sample, s."""
    return ud.SAMPLE


def test_the_body_on_the_load_swings_at_its_frequency() -> None:
    swinging = 10.0 * 90.0 / 100.0
    tail = {um.MASS_TAIL: 10.0, um.TAIL_STIFFNESS: (2.0 * math.pi * 60.0) ** 2 * swinging}
    servo = um.Servo({um.MASS_MOTOR: 50.0, um.MASS_LOAD: 40.0, um.STIFFNESS: 4e9, **tail, um.SUBSTEPS: 50.0})
    servo.s[um.X1] = servo.s[um.X2] = -1e-6
    servo.s[um.X3] = 9e-6
    # the spring between motor and load, 2,000 Hz, gives by 0.03 % of the tail's stiffness
    assert swings(coasted(servo, 1000, um.X3), T) == pytest.approx(60.0, rel=1e-3)


def test_a_damped_oscillation_dies_by_its_ratio() -> None:
    """ζ = 2 %: a peak is exp(-2 π ζ / sqrt(1 - ζ²)) of the one before."""
    reduced, w = 24.0, 2.0 * math.pi * 100.0
    p = {um.MASS_MOTOR: 60.0, um.MASS_LOAD: 40.0, um.STIFFNESS: w * w * reduced, um.DAMPING: 0.04 * w * reduced}
    servo = um.Servo({**p, um.SAMPLES: 1.0})
    servo.s[um.X1], servo.s[um.X2] = 4e-6, -6e-6
    x = -coasted(servo, 2000)
    peaks = x[1:-1][(x[1:-1] > x[:-2]) & (x[1:-1] >= x[2:])]
    assert peaks[10] / peaks[0] == pytest.approx(math.exp(-20.0 * math.pi * 0.02 / math.sqrt(1 - 4e-4)), rel=0.01)


@pytest.mark.parametrize("gap", [0.0, 10e-6])
def test_energy_stays_without_friction(gap: float) -> None:
    """Also across a gap, in which nothing acts: no drift in 2 s, 200 oscillations, beyond what swings within one."""
    p = {um.MASS_MOTOR: 60.0, um.MASS_LOAD: 40.0, um.STIFFNESS: 1e7, um.GAP: gap}
    servo = um.Servo(p)
    servo.s[um.V1], servo.s[um.V2] = 0.01, -0.015

    def energy() -> float:
        s = servo.s
        beyond = max(0.0, abs(s[um.X1] - s[um.X2]) - 0.5 * gap)
        return 30.0 * s[um.V1] ** 2 + 20.0 * s[um.V2] ** 2 + 0.5e7 * beyond**2

    begin, kept = energy(), []
    for _ in range(2000):
        servo.cycle(loop=um.OFF)
        kept.append(energy())
    # (w h)²/8 within an oscillation; a step across an end of the gap errs once by about as much
    assert np.max(np.abs(np.array(kept) / begin - 1.0)) < (4e-4 if gap == 0.0 else 5e-3)
    assert np.mean(kept[-200:]) == pytest.approx(np.mean(kept[:200]), rel=2e-4 if gap == 0.0 else 3e-3)


def test_the_load_stays_behind_by_the_gap_at_a_reversal() -> None:
    p = {um.MASS_MOTOR: 60.0, um.MASS_LOAD: 40.0, um.STIFFNESS: 1e8, um.DAMPING: 2e4, um.COULOMB_LOAD: 30.0}
    servo = um.Servo({**p, um.GAP: 20e-6, um.KV: 20.0, um.KP: 1e4, um.RATE: 20.0})
    lost = []
    for way in (1.0, -1.0):
        for _ in range(1000):
            servo.s[um.READING_LOAD] = servo.s[um.X2]
            begin = servo.u[um.END]
            servo.cycle(loop=um.POSITION, begin=begin, end=begin + way * 1e-6, set_velocity=way * 1e-3)
        lost.append(servo.s[um.X1] - servo.s[um.X2])
    # and by what the spring gives under 30 N each way
    assert lost[0] - lost[1] == pytest.approx(20e-6 + 2.0 * 30.0 / 1e8, rel=0.02)


def test_cogging_gives_back_what_it_took() -> None:
    """Over a period it does no work: from 10 mm/s on, a quarter of a period on, the energy of 1 - cos."""
    p = {**RIGID, um.COGGING: 5.0, um.COGGING_PERIOD: 0.02}
    servo = um.Servo(p)
    servo.s[um.V1] = servo.s[um.V2] = 0.1
    x, speeds = [], []
    for _ in range(800):
        servo.cycle(loop=um.OFF)
        x.append(servo.s[um.X1])
        speeds.append((60.0 * servo.s[um.V1] + 40.0 * servo.s[um.V2]) / 100.0)
    work = 5.0 * 0.02 / (2.0 * math.pi) * (1.0 - np.cos(2.0 * math.pi * np.array(x) / 0.02))
    # the spring that is stretched by cogging holds 5²/2e8 J of 0.5 J
    assert 50.0 * np.array(speeds) ** 2 == pytest.approx(0.5 + work, rel=2e-5)


def test_a_delay_is_a_delay_and_the_current_loop_a_lag() -> None:
    def response(delay: float) -> np.ndarray:
        servo = um.Servo({**RIGID, um.DELAY: delay, um.FORCE_SHARE: 0.3, um.SAMPLES: 1.0})
        forces = []
        for k in range(40):
            servo.cycle(loop=um.FORCE_ONLY, added=10.0 * (k > 3))
            forces.append(servo.s[um.FORCE])
        return np.array(forces)

    prompt, late = response(0.0), response(8.0)
    assert np.array_equal(prompt[:-8], late[8:])
    assert prompt[3] == 0.0
    assert prompt[4] == pytest.approx(10.0 * (1.0 - 0.7**5), rel=1e-12)


def test_the_force_is_limited_and_the_integral_does_not_wind_up() -> None:
    p = {**RIGID, um.KV: 20.0, um.KP: 6e3, um.RATE: 10.0, um.CURRENT_LIMIT: 50.0, um.COULOMB_MOTOR: 80.0}
    servo = um.Servo(p)
    for _ in range(1000):
        servo.cycle(loop=um.POSITION, begin=0.01, end=0.01)
    assert servo.s[um.STRONGEST] <= 50.0
    assert abs(servo.s[um.SUM]) < 100.0


def test_compiled_and_plain_arithmetic_are_the_same_bits() -> None:
    if um.compiler() is None:
        pytest.skip("NOT TESTED: the compiled step needs a compiler: apt-get install gcc libc6-dev")
    build = ud.draw(21).build  # gear, delay, backlash, vertical
    p = {**build.parameters, um.COGGING: 4.0, um.MASS_TAIL: 5.0, um.BREAKAWAY: 1.5, um.SAMPLES: 4.0}
    pair = [um.Servo(p, seed=5, compiled=compiled) for compiled in (True, False)]
    for servo in pair:
        for k in range(60):
            loop = (um.OFF, um.POSITION, um.VELOCITY, um.FORCE_ONLY)[k // 5 % 4]
            servo.cycle(
                loop=loop, begin=1e-5 * k, end=1e-5 * (k + 1), set_velocity=0.02, added=300.0, most=900.0, braked=k % 2
            )
    assert list(pair[0].s) == list(pair[1].s)
    assert pair[0].s[um.X2] != 0.0


# ---------------------------------------------------------------------------------------------------------- drives


def plain(**changes: object) -> ud.Build:
    """A drive without traits, friction and noise."""
    parameters = {**RIGID, um.KP: 60.0 * 100.0, um.RATE: 10.0, um.KV: 15.0, um.SUBSTEPS: 5.0}
    build = ud.Build(parameters, 1e-8, 1.0, 1, 10**6, None, 1e-3, 0.0)
    more = changes.pop("parameters", {})
    assert isinstance(more, dict)
    return replace(build, parameters={**parameters, **more}, **changes)  # type: ignore[arg-type]


def switched_on(build: ud.Build, mode: int = cia402.CSP, **values: int) -> ud.Firmware:
    firmware = ud.Firmware(build)
    firmware.values.update(values)
    ud.switch_on(firmware, mode)
    return firmware


def test_an_axis_that_fails_drops_until_its_brake_has_closed_and_one_switched_off_does_not() -> None:
    weight = {um.GRAVITY: -981.0, um.BRAKE: 2000.0}
    build = plain(parameters=weight, opens=0.05, closes=0.04)
    firmware = switched_on(build)
    assert firmware.cycles == 2 + 50
    for _ in range(500):
        firmware.cycle()
    # the brake held the motor, the load hangs on the spring
    assert firmware.true[-1] == pytest.approx(-981.0 / 1e8, rel=0.05)
    firmware.values["controlword"] = cia402.DISABLE_VOLTAGE
    for _ in range(300):
        firmware.cycle()
    assert firmware.state is PowerState.SWITCH_ON_DISABLED
    assert abs(firmware.servo.s[um.FORCE]) < 1e-9
    assert firmware.true[-1] == pytest.approx(-981.0 / 1e8, rel=0.05)
    firmware = switched_on(build)
    before = firmware.true[-1]
    firmware.lost()
    assert firmware.state is PowerState.FAULT
    for _ in range(300):
        firmware.cycle()
    # 40 ms of fall, and the brake's friction of 2000 N against 100 kg
    fall = 0.5 * 9.81 * 0.04**2
    assert before - firmware.true[-1] == pytest.approx(fall + 981.0 * fall / (2000.0 - 981.0), rel=0.03)


def test_in_cst_the_target_torque_must_hold_the_axis() -> None:
    weight = {um.GRAVITY: -981.0, um.BRAKE: 2000.0}
    build = plain(parameters=weight, opens=0.05, closes=0.04)
    held = switched_on(build, cia402.CST, target_torque=981)
    dropped = switched_on(build, cia402.CST)
    for firmware in (held, dropped):
        for _ in range(100):
            firmware.cycle()
    assert abs(held.true[-1]) < 20e-6
    assert dropped.true[-1] == pytest.approx(-0.5 * 9.81 * 0.101**2, rel=0.03)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("mode", [cia402.CSP, cia402.CST])
def test_the_objects_of_torque_have_the_drawn_sign(sign: int, mode: int) -> None:
    braked = plain(sign=sign, opens=0.01, parameters={um.BRAKE: 1e4})
    firmware = switched_on(braked, mode, target_torque=50 * (mode == cia402.CST))
    # as soon as the brake opens the force is there
    assert firmware.servo.s[um.FORCE] == pytest.approx(50.0 * sign * (mode == cia402.CST), abs=1.0)
    firmware = switched_on(plain(sign=sign), mode)
    torques = {"torque_offset": 60, "target_torque": 40} if mode == cia402.CST else {"torque_offset": 100}
    firmware.values |= torques
    for _ in range(20):
        firmware.cycle()
    assert firmware.true[-1] * sign > 1e-5
    if mode == cia402.CST:
        assert firmware.values["torque"] == 100
        assert firmware.true[-1] == pytest.approx(sign * 0.5 * 1.0 * 0.02**2, rel=0.02)


def test_csv_runs_at_its_velocity_and_csp_lags_by_it_over_the_gain() -> None:
    firmware = switched_on(plain(parameters={um.RATE: 0.0}), cia402.CSV)
    firmware.values["target_velocity"] = round(0.05 / 1e-8)
    for _ in range(500):
        firmware.cycle()
    # without friction a P loop has no error left; the velocity is filtered by nothing here
    assert firmware.values["velocity"] * 1e-8 == pytest.approx(0.05, rel=1e-3)
    firmware = switched_on(plain(absent=("velocity_offset",), feedforward=0.0))
    for k in range(1500):
        firmware.values["target_position"] = round(0.02 * T * (k + 1) / 1e-8)
        firmware.cycle()
    assert firmware.values["following_error"] * 1e-8 == pytest.approx(0.02 / 15.0, rel=0.01)


def test_a_quick_stop_brakes_on_its_ramp_and_switches_off() -> None:
    firmware = switched_on(plain(), cia402.CSV)
    firmware.values["target_velocity"] = round(0.1 / 1e-8)
    for _ in range(500):
        firmware.cycle()
    begin = firmware.true[-1]
    firmware.values |= {"controlword": cia402.QUICK_STOP, "quick_stop_deceleration": round(1.0 / 1e-8)}
    for _ in range(450):
        firmware.cycle()
    assert firmware.state is PowerState.SWITCH_ON_DISABLED
    # v²/2a; a loop of 60 and 15 1/s is off by a/(60 · 15) on a ramp
    assert firmware.true[-1] - begin == pytest.approx(0.1**2 / 2.0, abs=1.1e-3)
    assert abs(firmware.true[-1] - firmware.true[-2]) < 0.1 * 0.1 * T


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (lambda values: values.update(following_error_window=1000, target_position=200_000), 0x8611),
        (lambda values: values.update(position_most=100, target_position=200), 0x8612),
    ],
)
def test_a_drive_guards_what_was_written_into_it(change: Callable[[dict[str, int]], None], code: int) -> None:
    firmware = switched_on(plain())
    change(firmware.values)
    firmware.cycle()
    assert firmware.state is PowerState.FAULT
    assert firmware.values["error_code"] == code


def test_a_drive_may_refuse_to_change_its_mode_in_operation() -> None:
    for fixed in (True, False):
        firmware = switched_on(plain(fixed_mode=fixed))
        firmware.values["mode"] = cia402.CST
        firmware.cycle()
        assert firmware.values["mode_display"] == (cia402.CSP if fixed else cia402.CST)


def test_from_csp_to_cst_and_back_the_force_goes_on() -> None:
    build = plain(parameters={um.GRAVITY: -300.0}, opens=None)
    firmware = switched_on(build)
    for _ in range(3000):
        firmware.cycle()
    firmware.values |= {"mode": cia402.CST, "target_torque": 300}
    for _ in range(100):
        firmware.cycle()
    firmware.values |= {"mode": cia402.CSP, "target_position": firmware.values["position"]}
    before = firmware.true[-1]
    for _ in range(100):
        firmware.cycle()
    assert abs(firmware.true[-1] - before) < 5e-6


# ----------------------------------------------------------------------------------------------------------- draws


def test_the_draw_has_all_traits_two_to_four_each_and_repeats_itself() -> None:
    many: Counter[str] = Counter()
    sizes = Counter[int]()
    for seed in range(400):
        traits = ud.draw_traits(np.random.default_rng([seed, 402]))
        many.update(traits)
        sizes[len(traits)] += 1
        assert not {"vertical", "brake"} <= set(traits)
    assert sizes.keys() == {2, 3, 4}
    # 3 of 12 are a quarter: 100 of 400 expected, standard deviation 9
    assert min(many[trait] for trait in ud.TRAITS) > 60
    one, again = ud.draw(7), ud.draw(7)
    assert (one.file, one.truth, one.build) == (again.file, again.truth, again.build)
    assert one.file != ud.draw(8).file


def move(unknown: ud.Unknown, distance: float, force: float) -> Profile:
    """There and back by so many true m, with pulses of force at rest out there."""
    T = unknown.build.cycle_time
    way = ud.smooth(round(max(0.3, 8.0 * distance / unknown.limits.velocity) / T))
    stand = round(0.4 / T)
    path = np.concatenate([np.zeros(stand), way, np.ones(stand), way[::-1], np.zeros(stand)])
    path *= distance / unknown.truth.length_factor
    pulse = np.zeros(path.size)
    begin = stand + way.size + round(0.2 / T)
    pulse[begin : begin + stand // 8] = force * np.sin(np.pi * np.arange(stand // 8) / (stand // 8)) ** 2
    return Profile("move", "", T, "N", pulse, path, np.gradient(path, T))


@pytest.mark.parametrize("seed", [8, 9, 12, 33])
def test_a_drawn_drive_plays_a_move_and_its_person_measures_it(seed: int, tmp_path: Path) -> None:
    """Wrong gear; a table that turns on CANopen with lost frames; wrong sign with lost frames; vertical."""
    unknown = ud.draw(seed)
    assert unknown.build.turning == (seed == 9)
    rim = unknown.build.radius
    described = read_drive(unknown.write(tmp_path)).drive
    with DriveClient(unknown.transport(), described, paced=False) as client:
        played = play_profile(client, move(unknown, 0.005 / rim, 0.05 * unknown.truth.current_limit))
    assert played.aborted is None
    assert unknown.firmware.state is PowerState.SWITCH_ON_DISABLED
    assert (played.lost > 0) == ("lost" in unknown.traits)
    in_degrees = unknown.build.turning
    told = unknown.person().measured("how far?", 5.0, "deg" if in_degrees else "mm")
    assert told is not None
    reached = math.radians(told) if in_degrees else 1e-3 * told
    log = played.log["reading_load"]
    assert reached == pytest.approx(0.005 / rim, abs=1e-3 / rim)  # the old control is sluggish
    true = unknown.truth.length_factor * float(np.max(np.abs(log - log[0])))
    assert reached == pytest.approx(true, abs=4e-4 / rim)
    assert unknown.excursions() == {}
    # a force against a move is positive friction; with the wrong sign it reads as negative
    speed = np.gradient(log, unknown.build.cycle_time)
    fast = np.abs(speed) > 0.5 * np.max(np.abs(speed))
    weight = np.median(played.log["force"][fast & (speed > 0)]) + np.median(played.log["force"][fast & (speed < 0)])
    friction = np.median(played.log["force"][fast & (speed > 0)]) - np.median(played.log["force"][fast & (speed < 0)])
    assert friction * unknown.truth.sign > 0.0
    newtons = unknown.truth.newton / described.scaling.newton
    scale = unknown.truth.sign * newtons
    assert 0.5 * scale * weight == pytest.approx(-unknown.truth.gravity, abs=0.05 * unknown.truth.current_limit)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_excursions_are_those_of_the_real_axis(way: float) -> None:
    firmware = switched_on(plain())
    unknown = ud.draw(0)
    unknown.firmware, unknown.limits = firmware, replace(unknown.limits, travel=1e-3, velocity=1.0, force=1e4)
    for k in range(300):
        firmware.values["target_position"] = round(way * 1.5e-3 * min(1.0, k / 200) / 1e-8)
        firmware.cycle()
    assert set(unknown.excursions()) == {"travel"}
    farthest = max(way * x for x in firmware.true)
    assert unknown.excursions()["travel"] == pytest.approx(farthest / 1e-3, rel=1e-3)
    unknown.limits = replace(unknown.limits, travel=1.01 * farthest, velocity=1e-3, force=1.0)
    assert set(unknown.excursions()) == {"velocity", "force"}


def test_a_drive_with_a_delay_is_switched_on_where_it_stands() -> None:
    """The setpoints that are on their way in the first milliseconds are those of the axis, not of long ago."""
    firmware = ud.Firmware(plain(parameters={um.DELAY: 8.0}, position=0.123))
    ud.switch_on(firmware)
    for _ in range(50):
        firmware.cycle()
    assert np.ptp(firmware.true) < 1e-6


def test_the_file_is_right_but_for_gear(tmp_path: Path) -> None:
    """Length, and force with its reciprocal; 8 that are wrong by lead or by gear, 3 that are right."""
    kinds = Counter[str]()
    for seed in range(60):
        traits = ud.draw_traits(np.random.default_rng([seed, 402]))
        kind = "gear" if "gear" in traits else "right"
        if kinds[kind] >= (8 if kind == "gear" else 3):
            continue
        kinds[kind] += 1
        unknown = ud.draw(seed)
        scaling, truth = read_drive(unknown.write(tmp_path)).drive.scaling, unknown.truth
        assert scaling.metre * truth.length_factor == pytest.approx(truth.metre, rel=1e-8)
        assert scaling.newton / truth.length_factor == pytest.approx(truth.newton, rel=1e-8)
        assert (truth.length_factor == 1.0) == (kind == "right")
        if unknown.build.turns is not None:
            counts, lead, gear, _ = unknown.build.turns
            assert truth.metre == lead / gear / counts
            kinds["lead" if scaling.lead != pytest.approx(lead) else "as it is"] += 1
    assert kinds["lead"] in range(1, 8)


def test_an_axis_stands_where_it_is_found() -> None:
    """Seed 11: its cogging exceeds its friction in places, and it has no brake."""
    unknown = ud.draw(11)
    assert unknown.truth.cogging > unknown.truth.coulomb
    for _ in range(2000):
        unknown.firmware.cycle()
    assert np.ptp(unknown.firmware.true) < 1e-9

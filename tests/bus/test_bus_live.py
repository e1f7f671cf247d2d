"""A control of ours in the master, and an axis on a bus as commissioning knows it; drives in virtual time."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bus_bench import LIMITS, SCALING, T, bench_loop, drive
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.controller.linear_adrc import LinearADRC
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.filter.low_pass import LowPass
from feeddrive.blocks.force.gravity import Gravity
from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.blocks.load.recorded_force import RecordedForce
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.blocks.signals import Setpoint
from feeddrive.bus.cia402 import SENT, TOLD, PowerState
from feeddrive.bus.client import DriveClient, driven_together, set_watchdog
from feeddrive.bus.control_in_master import ControlInMaster
from feeddrive.bus.drive_file import drive_of, read_drive
from feeddrive.bus.faults import InjectedFault
from feeddrive.bus.gains import write_gains
from feeddrive.bus.live import BusAxis, virtual_bus_axis
from feeddrive.bus.play import Played, Profile, play_profile, play_together
from feeddrive.bus.virtual_drive import OVERCURRENT, READ_ONLY, Brake, DrivenAxis, Firmware, SdoAbortError
from feeddrive.files.machine import read_machine
from feeddrive.files.toml_file import parse_toml
from feeddrive.language.errors import BusError, ParameterError, StructureError
from feeddrive.language.progress import Progress
from feeddrive.loop.control import Control
from feeddrive.loop.guard import Guard
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import simulate
from injected_faults import BUSES, KINDS, SIZES, virtual_time

WEIGHT = 400.0  # N
MASS = 100.0  # kg
E = 5e-3  # m, of `WIDE`
WIDE = replace(LIMITS, following_error=E, breakaway_force=600.0)
OURS = Control(law=CascadePPI(Kv=20.0, Kp=8e3, Tn=0.05), force_limit=1500.0)
STIFF = 20.0 * 8e3  # N/m, at least, of that cascade
LAG = 2 * T  # s, from a reading to the force that answers it: `lag` + 1 cycles


def move(rows: int = 600, distance: float = 0.02, peak: float = 0.0) -> Profile:
    """A smooth move, with a chirp of a force on top that swells and fades."""
    t = np.arange(rows) * T
    s = t / t[-1]
    position = distance * s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
    excitation = peak * np.sin(np.pi * s) ** 2 * np.sin(2 * np.pi * (5.0 + 40.0 * s) * t)
    return Profile("move", "", T, "N", excitation, position, np.gradient(position, T))


def hanging(loop: Loop | None = None) -> Loop:
    loop = loop or bench_loop()
    return replace(loop, axis=replace(loop.axis, forces=(Gravity(force=-WEIGHT),)))


def with_control(loop: Loop, control: Control = OURS) -> Loop:
    return replace(loop, control=control)


class Bench:
    """A virtual drive on a bus, and where its axis was after each frame, m."""

    def __init__(self, loop: Loop, bus: str = "ethercat", **options: Any) -> None:
        self.firmware = Firmware(DrivenAxis(loop), SCALING, T, **options)
        self.bus, self.true = bus, list[float]()
        self.lost: set[int] = set()

    def transport(self, _: object = None) -> Any:
        made = BUSES[self.bus](self.firmware)
        take = made.take

        def taken(timeout: float) -> bytes | None:
            answered = take(timeout)
            self.true.append(self.firmware.axis.last.position)
            return None if len(self.true) - 1 in self.lost else answered

        made.take = taken
        return made

    def play(self, profile: Profile, control: Control | Loop, mode: str = "cst", **options: Any) -> Played:
        described = drive(self.bus, mode=mode, limits=options.pop("limits", WIDE))
        made = ControlInMaster(control, T, mode=mode, force=float(described.limits.force), encoders=2)
        with DriveClient(self.transport(), described, paced=False) as client:
            return play_profile(client, profile, control=made, **options)


# the control


@pytest.mark.parametrize(
    "control",
    [
        OURS,
        Control(
            law=CascadePPI(Kv=30.0, Kp=2e4, Tn=0.02),
            filters=(LowPass(frequency=200.0),),
            feedforward=(Inertia(mass=100.0, viscous=300.0),),
            force_limit=300.0,
            guard=Guard(velocity_limit=1.0),
        ),
        Control(law=LinearADRC(mass=100.0, omega_c=60.0, omega_o=300.0, delay_samples=1)),
    ],
    ids=["cascade", "with all parts, at its limit", "without a limit"],
)
def test_a_control_in_the_master_gives_the_bits_of_the_simulation(control: Control) -> None:
    loop = with_control(bench_loop(), control)
    profile = move(peak=100.0)
    run = simulate(
        loop, profile.reference(), added_force=RecordedForce(force=profile.excitation, sample_time=T), start=(0.0, 0.0)
    )
    made = ControlInMaster(loop, T, force=2000.0, encoders=2)
    made.begin(0.0, 0.0)
    made.rest(0.0, 0.0, 0.0)
    rows = np.column_stack([*profile.reference().at(np.arange(600) * T), run["reading_load"], run["reading_motor"]])
    forces = [made.step(Setpoint(*row[:5]), *row[5:]).force for row in rows.tolist()]
    assert np.ptp(run["force"]) > 100.0
    np.testing.assert_array_equal(forces, run["force"])


@pytest.mark.parametrize("bus", BUSES)
def test_a_drive_in_cst_moves_as_the_loop_that_is_simulated(bus: str) -> None:
    loop, profile = with_control(bench_loop()), move(peak=100.0)
    played = Bench(bench_loop(), bus).play(profile, loop)
    log = played.log
    slow = replace(loop, axis=replace(loop.axis, actuator=replace(loop.axis.actuator, dead_time=LAG)))
    added = RecordedForce(force=profile.excitation, sample_time=T)
    run = simulate(slow, profile.reference(), added_force=added, start=(0.0, 0.0))
    assert played.aborted is None
    assert len(log) == 600
    # the drive rounds its force to half a thousandth of the rated torque: so far does that move the axis
    rounding = 0.5 * SCALING.newton / STIFF
    np.testing.assert_allclose(log["reading_load"], run["reading_load"], atol=rounding, rtol=0.0)
    # and as much in the force, with the rounding of the readings in the velocity (Kp times a count in a cycle)
    most = 0.5 * SCALING.newton + 8e3 * SCALING.metre / T + STIFF * rounding
    np.testing.assert_allclose(log["commanded"], run["force"] + profile.excitation, atol=most, rtol=0.0)
    assert {log.units[name] for name in ("force", "commanded")} == {"N"}
    # the force of a row is the one that acted when its reading was taken, `lag` + 1 cycles after it was commanded
    np.testing.assert_allclose(log["force"][2:], log["commanded"][:-2], atol=0.51 * SCALING.newton)


def test_the_sum_of_force_and_excitation_stays_within_the_limit_of_the_drive_file() -> None:
    limited = replace(WIDE, force=80.0, following_error=0.05)
    log = Bench(bench_loop()).play(move(peak=70.0), OURS, limits=limited).log
    assert np.max(np.abs(log["commanded"])) == pytest.approx(80.0)


def test_in_lost_frames_the_command_is_held_and_the_motion_goes_on() -> None:
    bench = Bench(bench_loop())
    bench.lost = {800, 801}
    # after a reading that was held the velocity would be three times as large: 0.19 m/s
    guarded = replace(OURS, guard=Guard(velocity_limit=0.1, hold_samples=0.0))
    played = bench.play(move(), guarded)
    log = played.log
    assert played.aborted is None
    assert played.lost == 2
    (rows,) = np.nonzero(log["lost"])
    assert rows.size == 2
    assert np.all(log["reading_load"][rows] == log["reading_load"][rows[0] - 1])
    assert np.all(log["commanded"][rows] == log["commanded"][rows[0] - 1])


# taking over and giving back


@pytest.mark.parametrize("changes_mode", [True, False], ids=["in operation", "off and on again"])
@pytest.mark.parametrize("brake", [Brake(0.0, 0.0), Brake(0.15, 0.05)], ids=["no brake", "brake"])
def test_a_vertical_axis_is_taken_over_without_a_bump(changes_mode: bool, brake: Brake) -> None:
    bench = Bench(hanging(), brake=brake, changes_mode=changes_mode)
    played = bench.play(move(distance=0.0), hanging(with_control(bench_loop())))
    log = played.log
    assert played.aborted is None
    # half a thousandth of the rated torque, rounded twice, and the noise of counts
    assert abs(log["commanded"][0] - WEIGHT) < SCALING.newton
    assert np.ptp(log["reading_load"]) < 2.0 * SCALING.newton / STIFF
    assert bench.firmware.state is PowerState.SWITCH_ON_DISABLED
    # nor did it fall between csp and cst: since it had settled it has not moved by more
    settled = bench.true[400 : 400 + len(log)]
    assert np.ptp(settled) < 2.0 * SCALING.newton / STIFF


class Sent:
    """The mode and the controlword of each frame."""

    def __init__(self, firmware: Firmware) -> None:
        self.frames: list[tuple[int, int, PowerState]] = []
        self._firmware, self._take = firmware, firmware.take
        firmware.take = self.take  # type: ignore[method-assign]

    def take(self, sent: Any) -> None:
        self._take(sent)
        values = self._firmware.values
        self.frames.append((values["mode"], values["controlword"], self._firmware.state))


@pytest.mark.parametrize(("brake_time", "seconds"), [(0.0, 0.5), (1.0, 1.2)])
def test_a_drive_holds_its_axis_before_a_control_takes_over(brake_time: float, seconds: float) -> None:
    bench = Bench(bench_loop())
    sent = Sent(bench.firmware)
    described = drive("ethercat", mode="cst", limits=WIDE, brake_time=brake_time)
    made = ControlInMaster(OURS, T, force=2000.0, encoders=2)
    with DriveClient(bench.transport(), described, paced=False) as client:
        play_profile(client, move(rows=10, distance=0.0), control=made)
    modes = [mode for mode, _, state in sent.frames if state is PowerState.ENABLED]
    before, after = modes.index(10), modes[::-1].index(10)
    # and the few cycles in which it is switched on
    assert 0 <= before - seconds / T < 10
    # and again at the end, when its brake is open
    assert 0 <= after - 0.5 / T < 10


def test_a_drive_that_keeps_its_mode_is_switched_off_after_20_cycles() -> None:
    bench = Bench(bench_loop(), changes_mode=False)
    sent = Sent(bench.firmware)
    bench.play(move(rows=10, distance=0.0), OURS)
    first = next(k for k, (mode, _, state) in enumerate(sent.frames) if mode == 10 and state is PowerState.ENABLED)
    off = next(k for k, (_, control, _) in enumerate(sent.frames) if k > first and control & 0x0F != 0x0F)
    assert off - first == 20


@pytest.mark.parametrize("changes_mode", [True, False], ids=["in operation", "in a quick stop"])
def test_a_drive_holds_its_axis_again_before_it_is_switched_off(changes_mode: bool) -> None:
    """Whether its axis stands it judges by its own readings, which the noise of a control may hide."""
    bench = Bench(hanging(), changes_mode=changes_mode, brake=Brake(0.1, 0.1))
    sent = Sent(bench.firmware)
    played = bench.play(move(rows=100, distance=0.0), hanging(with_control(bench_loop())))
    assert played.aborted is None
    # after the control the drive is asked for csp; the control led it in cst until then
    led = max(k for k, (mode, _, _) in enumerate(sent.frames) if mode == 10)
    after = [(control, state) for _, control, state in sent.frames[led + 1 :]]
    operating = [control for control, state in after if state is PowerState.ENABLED]
    if changes_mode:
        # half a second, then disable operation; the voltage is not cut from operation
        assert len(operating) == pytest.approx(0.5 / T, abs=8)
        assert next(control for control, _ in after if control & 0x0F != 0x0F) == 0x07
    else:
        assert len(operating) == pytest.approx(20, abs=4)
        assert any(state is PowerState.QUICK_STOP for _, state in after)
    assert bench.firmware.state is PowerState.SWITCH_ON_DISABLED
    # it does not fall meanwhile
    begin = played.log["reading_load"][-1]
    assert abs(bench.true[-1] - begin) < 1e-4


def test_a_drive_that_does_not_hold_its_axis_by_itself_makes_a_quick_stop_and_says_so() -> None:
    bench = Bench(bench_loop(), faults=[InjectedFault("drive_fault", 900, float(OVERCURRENT))])
    # the hold begins after 0.5 s, the motion and 0.1 s at its end
    played = bench.play(move(rows=100, distance=0.0), OURS)
    assert played.aborted is not None
    assert played.aborted.startswith("while the drive held its axis by itself, the drive left operation")
    assert len(played.log) == 100


def test_a_speed_beyond_its_limit_is_braked_along_a_ramp_before_the_drive_has_its_fault() -> None:
    """The drive watches the same speed (0x6080): at one bound its fault would come first, in the very cycle."""
    bench = Bench(bench_loop())
    slow = replace(WIDE, velocity=0.05)
    moves = move(rows=900, distance=0.022, peak=150.0)
    with DriveClient(bench.transport(), drive("ethercat", mode="csp", limits=slow), paced=False) as client:
        played = play_profile(client, moves)
    assert played.aborted is not None
    assert "limits.velocity" in played.aborted
    assert played.cause == "velocity"
    assert bench.firmware.values["error_code"] == 0


@pytest.mark.parametrize("brake_time", [0.0, 0.2])
def test_a_motion_waits_for_the_brake(brake_time: float) -> None:
    bench = Bench(bench_loop(), brake=Brake(0.19, 0.05))
    described = drive("ethercat", limits=LIMITS, brake_time=brake_time)
    with DriveClient(bench.transport(), described, paced=False) as client:
        played = play_profile(client, move())
    # with its brake closed it shows no motion while its target goes on
    assert (played.aborted is None) == (brake_time > 0.0)


def test_a_horizontal_axis_begins_with_no_force() -> None:
    log = Bench(bench_loop()).play(move(distance=0.0), OURS).log
    assert np.max(np.abs(log["commanded"])) < SCALING.newton


def test_a_drive_without_csp_begins_without_the_force_that_holds() -> None:
    bench = Bench(bench_loop())
    bench.firmware.values["supported_modes"] = 1 << 9
    played = bench.play(move(), OURS)
    assert played.aborted is None
    assert any("has no csp" in remark for remark in played.remarks)


def test_a_person_ends_the_hold_before_a_control_takes_over() -> None:
    bench = Bench(bench_loop())
    sent = Sent(bench.firmware)
    progress = Progress()
    progress.cancel()
    played = bench.play(move(), OURS, progress=progress)
    assert played.aborted is not None
    assert "stopped by hand" in played.aborted
    assert sum(mode == 8 and state is PowerState.ENABLED for mode, _, state in sent.frames) < 20
    assert bench.firmware.state is PowerState.SWITCH_ON_DISABLED


def test_a_vertical_axis_falls_without_the_force_that_holds_it() -> None:
    bench = Bench(hanging(), brake=Brake(0.1, 0.1))
    with DriveClient(bench.transport(), drive("ethercat", mode="cst", limits=WIDE), paced=False) as client:
        client.enable()
        begin = len(bench.true)
        for _ in range(60):
            client.command(force=0.0)
            client.cycle()
        assert np.ptp(bench.true[begin:]) == 0.0  # its brake has not opened
        for _ in range(140):
            client.command(force=0.0)
            client.cycle()
    # some 140 ms of a fall of 4 m/s², less 0.33 s of viscous friction
    assert bench.true[0] - min(bench.true) > 0.02


def test_a_drive_that_is_switched_off_in_order_holds_the_axis_until_its_brake_has_closed() -> None:
    bench = Bench(hanging(), brake=Brake(0.05, 0.1))
    played = bench.play(move(distance=0.0), hanging(with_control(bench_loop())))
    held = played.log["reading_load"][-1]
    for _ in range(300):
        bench.firmware.cycle()
    assert abs(bench.firmware.axis.last.position - held) < 1e-3
    stands = bench.firmware.axis.last.position
    for _ in range(50):
        bench.firmware.cycle()
    assert bench.firmware.axis.last.position == stands


@pytest.mark.parametrize("is_fixed", [False, True], ids=["is written", "is refused"])
def test_a_drive_that_would_drop_its_axis_when_it_is_switched_off_is_told_to_hold_it(is_fixed: bool) -> None:
    """0x605C = 0, as somebody has set it: written to 1, or told where the drive refuses it, and the axis falls."""
    closes = 0.04
    bench = Bench(hanging(), brake=Brake(0.05, closes))
    bench.firmware.values["disable_operation_option"] = 0
    if is_fixed:
        write = bench.firmware.write

        def refusing(index: int, subindex: int, content: bytes) -> None:
            if index == 0x605C:
                raise SdoAbortError(READ_ONLY)
            write(index, subindex, content)

        bench.firmware.write = refusing
    played = bench.play(move(distance=0.0), hanging(with_control(bench_loop())))
    assert played.aborted is None
    for _ in range(100):
        bench.firmware.cycle()
    fell = played.log["reading_load"][-1] - bench.firmware.axis.last.position
    told = [remark for remark in played.remarks if "0x605C" in remark]
    if is_fixed:
        assert fell == pytest.approx(falls_by(closes), rel=0.1)
        assert told == [
            "The drive does not take 0x605C:00 (disable operation option), which holds 0 in place of 1: "
            "set this limit with its maker's tool."
        ]
    else:
        assert abs(fell) < 1e-4
        assert not told


def falls_by(seconds: float) -> float:
    """The way in m that the weight pulls the axis: v' = g' - v/τ, x = g' τ (t - τ (1 - exp(-t/τ)))."""
    tau, pull = MASS / 300.0, WEIGHT / MASS
    return pull * tau * (seconds - tau * (1.0 - float(np.exp(-seconds / tau))))


def test_in_a_fault_the_axis_falls_until_its_brake_has_closed() -> None:
    closes = 0.05
    bench = Bench(hanging(), brake=Brake(0.05, closes), faults=[InjectedFault("drive_fault", 800, float(OVERCURRENT))])
    played = bench.play(move(rows=900, distance=0.0), hanging(with_control(bench_loop())))
    assert played.aborted is not None
    assert "0x2310" in played.aborted
    for _ in range(100):
        bench.firmware.cycle()
    fell = played.log["reading_load"][-1] - bench.firmware.axis.last.position
    assert fell == pytest.approx(falls_by(closes), rel=0.1)


def test_in_a_fault_in_which_it_can_brake_a_drive_holds_the_axis_until_its_brake_has_closed() -> None:
    """0x605E = 2, which is written before it is switched on; 50 ms of falling are 4 mm."""
    bench = Bench(hanging(), brake=Brake(0.05, 0.05), faults=[InjectedFault("drive_fault", 800, float(0x8611))])
    played = bench.play(move(rows=900, distance=0.0), hanging(with_control(bench_loop())))
    assert played.aborted is not None
    assert "0x8611" in played.aborted
    for _ in range(100):
        bench.firmware.cycle()
    assert bench.firmware.state is PowerState.FAULT
    assert played.log["reading_load"][-1] - bench.firmware.axis.last.position < 1e-3
    stands = bench.firmware.axis.last.position
    for _ in range(100):
        bench.firmware.cycle()
    assert bench.firmware.axis.last.position == stands


class Pressed(Progress):
    """A person who stops the motion once the axis has moved."""

    def __init__(self, bench: Bench, at: float) -> None:
        super().__init__()
        self._bench, self._at = bench, at

    @property
    def cancelled(self) -> bool:
        return bool(self._bench.true) and self._bench.true[-1] > self._at


def test_a_person_stops_a_vertical_axis_and_it_is_held_meanwhile() -> None:
    bench = Bench(hanging(), brake=Brake(0.05, 0.05))
    played = bench.play(move(), hanging(with_control(bench_loop())), progress=Pressed(bench, 0.01))
    assert played.aborted is not None
    assert "by hand" in played.aborted
    assert "switch on disabled" in played.aborted
    place = int(np.argmax(np.array(bench.true) > 0.01))
    after = np.array(bench.true[place:])
    speed = 0.02 * 1.875 / (600 * T)  # of the move in its middle
    assert max(after) - 0.01 < speed**2 / (2.0 * WIDE.quick_stop_deceleration) + speed * 8 * T + 1e-3
    # the weight is carried on the ramp: it does not fall by more than the drive of the brake lets it
    assert 0.01 - after[-1] < 1e-3


def test_a_trip_of_the_guard_ends_the_motion() -> None:
    guarded = replace(OURS, guard=Guard(velocity_limit=0.03))
    played = Bench(bench_loop()).play(move(), guarded)
    assert played.aborted is not None
    assert "the guard of the control tripped: the velocity" in played.aborted
    assert 100 < len(played.log) < 400


@pytest.mark.parametrize("share", [0.5, 2.0])
def test_under_a_control_in_the_master_the_following_error_is_watched(share: float) -> None:
    soft = replace(OURS, law=CascadePPI(Kv=20.0, Kp=8e3, velocity_feedforward=0.0))
    loop, profile = with_control(bench_loop(), soft), move()
    lags = float(np.max(np.abs(simulate(loop, profile.reference(), start=(0.0, 0.0))["following_error"])))
    played = Bench(bench_loop()).play(profile, loop, limits=replace(WIDE, following_error=lags * share))
    assert (played.aborted is None) == (share > 1.0)
    if played.aborted:
        assert "following_error" in played.aborted
        assert "(set position - 0x6064)" in played.aborted


def test_a_force_with_the_wrong_sign_is_switched_off() -> None:
    bench = Bench(bench_loop())
    wrong = drive("ethercat", mode="cst", limits=WIDE, scaling=replace(SCALING, force_sign=-1))
    made = ControlInMaster(OURS, T, force=2000.0, encoders=2)
    with DriveClient(bench.transport(), wrong, paced=False) as client:
        played = play_profile(client, move(), control=made)
    assert played.aborted is not None
    assert "runs away" in played.aborted
    assert "switched off at once" in played.aborted
    assert max(map(abs, bench.true)) < 0.1


def test_a_dead_encoder_is_noticed_before_the_control_has_driven_the_axis_off() -> None:
    bench = Bench(bench_loop(), faults=[InjectedFault("encoder_loss", 760, 0.0)])
    played = bench.play(move(), OURS, limits=replace(WIDE, following_error=2e-3))
    assert played.aborted is not None
    assert "still stands within 2 increments" in played.aborted
    assert max(bench.true) < 0.02


KINDS_UNDER_A_CONTROL = [kind for kind in KINDS if kind not in ("travel", "brake_slip", "person")]


def fault_under_a_control(kind: str, seed: int, *, vertical: bool) -> tuple[Played, float, Bench]:
    """A motion with a fault, drawn by seed, and how far the axis went beyond the ends of the motion, m."""
    rng = np.random.default_rng([seed, KINDS.index(kind), vertical])
    loop = hanging() if vertical else bench_loop()
    size = SIZES[kind](rng) if kind in SIZES else 0.0
    if kind == "second_master" and size == 1.0:
        size = 0.0  # half the force in every other cycle: nothing of it can be told from friction
    at = 500 + int(rng.integers(150, 400))  # cycles in operation: held for 500 before
    bench = Bench(loop, brake=Brake(0.05, 0.05), faults=[InjectedFault(kind, at, size)])
    distance = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.008, 0.04))
    sent = move(distance=distance, peak=float(rng.choice([0.0, 80.0])))
    made = ControlInMaster(with_control(loop), T, force=2000.0, encoders=2)
    described = drive("ethercat", mode="cst", limits=replace(WIDE, following_error=2e-3, acceleration=20.0))
    transport = bench.transport()
    with virtual_time(transport), DriveClient(transport, described, paced=False) as client:
        set_watchdog(transport, described)
        played = play_profile(client, sent, control=made)
    for _ in range(1500):
        bench.firmware.cycle()
        bench.true.append(bench.firmware.axis.last.position)
    ends = sorted((bench.true[500], bench.true[500] + distance))
    return played, max(max(bench.true[500:]) - ends[1], ends[0] - min(bench.true[500:])), bench


@pytest.mark.slow(reason="120 motions with faults")
@pytest.mark.parametrize("vertical", [False, True])
def test_faults_under_a_control_end_the_motion_with_the_drive_off(vertical: bool) -> None:
    for kind in KINDS_UNDER_A_CONTROL:
        for seed in range(5):
            played, beyond, bench = fault_under_a_control(kind, seed, vertical=vertical)
            where = f"{kind}, seed {seed}: {played.aborted}"
            # a reading that slips shows in the velocity only where it slips by enough
            assert played.aborted is not None or kind == "gear", where
            assert bench.firmware.state is not PowerState.ENABLED, where
            # it coasts where its force is off, as in every mode (docs/explanation/safety.md)
            assert beyond < (0.06 if kind == "sign" else 0.015), where


def healthy_under_a_control(seed: int) -> str:
    """Why a drawn healthy drive was stopped under a control, with a following error as tight as is stated; or ""."""
    rng = np.random.default_rng([seed, 5])
    mass, coulomb = rng.uniform(50.0, 115.0), rng.uniform(5.0, 150.0) * (rng.random() < 0.7)
    plant = TwoMass(
        mass_motor=0.6 * mass,
        mass_load=0.4 * mass,
        stiffness=10 ** rng.uniform(6.8, 7.6),
        damping=2e3,
        viscous_motor=rng.uniform(50.0, 600.0),
    )
    weight = rng.uniform(100.0, 500.0) * (rng.random() < 0.4)
    axis = replace(
        bench_loop().axis,
        plant=plant,
        friction_motor=Coulomb(coulomb=coulomb) if coulomb else None,
        forces=(Gravity(force=-weight),) if weight else (),
    )
    loop = replace(bench_loop(), axis=axis)
    law = CascadePPI(
        Kv=rng.uniform(10.0, 22.0),
        Kp=mass * rng.uniform(50.0, 90.0),
        Tn=rng.uniform(0.03, 0.1),
        velocity_feedforward=float(rng.choice([0.0, 1.0])),
    )
    sent = move(
        rows=int(rng.integers(400, 800)),
        distance=float(rng.choice([-1.0, 1.0]) * rng.uniform(0.008, 0.04)),
        peak=float(rng.choice([0.0, 1.0]) * rng.uniform(20.0, 150.0)),
    )
    lost = set(rng.choice(np.arange(550, 1300), 14, replace=False).tolist())

    def played(most: float) -> Played:
        bench = Bench(loop, brake=Brake(0.05, 0.05))
        bench.lost = {k for k in lost if k - 1 not in lost}
        still = 1.2 * (coulomb + weight) + 5.0
        limits = replace(WIDE, following_error=most, acceleration=20.0, breakaway_force=still)
        return bench.play(sent, with_control(loop, replace(OURS, law=law)), limits=limits)

    wide = played(0.05)
    largest = float(np.max(np.abs(wide.log["set_position"] - wide.log["reading_load"])))
    # the control of the drive lets a weight sag by less than a millimetre when the brake opens
    least = 1e-3 if weight else 2e-5
    return wide.aborted or played(max(4.0 / 3.0 * largest + 2.0 * SCALING.metre, least)).aborted or ""


@pytest.mark.slow(reason="120 motions of 60 drawn drives")
def test_healthy_drives_are_not_stopped_under_a_control() -> None:
    stopped = {seed: why for seed in range(60) if (why := healthy_under_a_control(seed))}
    assert not stopped


def test_two_drives_of_one_beam_are_taken_over_and_move_together() -> None:
    benches = Bench(bench_loop()), Bench(hanging(), brake=Brake(0.1, 0.05))
    described = drive("ethercat", mode="cst", limits=WIDE)
    clients = [DriveClient(bench.transport(), described, paced=False) for bench in benches]
    made = [ControlInMaster(OURS, T, force=2000.0, encoders=2) for _ in benches]
    with driven_together(clients):
        found = play_together(clients, [move(), move()], controls=made)
    assert [each.aborted for each in found] == [None, None]
    one, other = (each.log["reading_load"] - each.log["reading_load"][0] for each in found)
    assert np.max(np.abs(one - other)) < SCALING.newton / STIFF


# what is refused


def test_a_control_of_another_sample_time_is_refused() -> None:
    with pytest.raises(ParameterError, match="runs every 1000 us, and the drive every 500 us"):
        ControlInMaster(bench_loop(), 5e-4, force=1.0)


def test_a_drive_in_csp_closes_its_loops_itself() -> None:
    with pytest.raises(ParameterError, match="closes all loops by itself"):
        ControlInMaster(OURS, T, mode="csp", force=1.0)


@pytest.mark.parametrize(
    ("control", "why"),
    [
        (Control(law=LinearADRC(mass=100.0, omega_c=60.0, omega_o=300.0, delay_samples=1)), "commands a force"),
        (replace(OURS, filters=(LowPass(frequency=100.0),)), "control.filters acts on the force"),
    ],
)
def test_in_csv_only_the_outer_loop_of_a_cascade_runs(control: Control, why: str) -> None:
    with pytest.raises(StructureError, match=why):
        ControlInMaster(control, T, mode="csv", force=1.0)


# the outer loop in csv


def test_in_csv_the_position_loop_commands_a_velocity() -> None:
    made = ControlInMaster(replace(OURS, feedforward=(Inertia(mass=100.0),)), T, mode="csv", force=2000.0)
    made.begin(0.1, None)
    made.rest(0.1, None, 0.0)
    found = made.step(Setpoint(0.102, 0.05, 2.0, 0.0, 0.0), 0.1)
    # Kv e + the difference of the set position in the last cycle; m a
    assert found.velocity == pytest.approx(20.0 * 0.002 + 0.05 - 0.5 * T * 2.0, rel=1e-12)
    assert found.force == pytest.approx(200.0, rel=1e-12)


def test_in_csv_an_axis_follows() -> None:
    played = Bench(bench_loop()).play(move(), OURS, mode="csv")
    log = played.log
    assert played.aborted is None
    # the loop answers three cycles late, and Kv makes up for what that leaves
    late = 3 * T * float(np.max(np.gradient(move().set_position, T)))
    assert np.max(np.abs(log["set_position"] - log["reading_load"])) < late
    assert abs(log["reading_load"][-1] - 0.02) < 0.1 * late


# the axis on a bus


def drive_file(extra: str = "", scaling: str = "increment_nm = 10\nrated_force = 628.3185307179587") -> str:
    return (
        'bus = "ethercat"\ninterface = "virtual"\ncycle_time_ms = 1\n' + extra + f"\n[scaling]\n{scaling}\n"
        "[limits]\ntravel_mm = 200\nvelocity = 0.5\nforce = 2000\nfollowing_error_mm = 5\nlargest_mass = 120\n"
        "breakaway_force = 600\nquick_stop_deceleration = 5\n"
    )


GAINS = (
    '[gains.Kv]\nobject = "0x60FB:1"\nfactor = 0.01\n[gains.Kp]\nobject = "0x60FB:2"\nfactor = 0.1\n'
    '[gains.Tn]\nobject = "0x60FB:3"\nunit = "us"\n'
)
SPINDLE = "counts_per_turn = 1e6\nlead_mm = 10\nrated_torque = 1"


def axis_of(bench: Bench, text: str | None = None) -> BusAxis:
    file = drive_of(parse_toml(text or drive_file(scaling=SPINDLE), "drive.toml"))
    return BusAxis(file, bench.transport, paced=False)


def test_a_drive_is_listened_to_without_writing_to_it() -> None:
    bench = Bench(bench_loop())
    axis = axis_of(bench)
    before, inside = dict(bench.firmware.values), dict(axis.inside())
    heard = axis.listen(0.3)
    assert bench.firmware.state is PowerState.SWITCH_ON_DISABLED
    assert axis.inside() == inside
    assert {name: bench.firmware.values[name] for name in before} == before
    assert len(heard.log) == 300
    assert set(heard.log.channels) == {"force", "reading_load", "reading_motor", "velocity_load"}
    assert axis.is_virtual


def test_what_a_motion_wrote_into_a_drive_is_restored() -> None:
    bench = Bench(bench_loop())
    values = bench.firmware.values
    values |= {"following_error_timeout": 100, "fault_reaction_option": 1, "quick_stop_option": 1, "max_torque": 2900}
    values["disable_operation_option"] = 0

    def settings() -> dict[str, int]:
        """All but what is exchanged in each cycle, whatever the axis takes for what it writes."""
        exchanged = {name for group in (*SENT, *TOLD) for name in group} - {"mode"}
        return {name: value for name, value in values.items() if name not in exchanged}

    axis, before = axis_of(bench), settings()
    inside = dict(axis.inside())
    assert axis.play(move()).aborted is None
    assert axis.play(move(), None, with_control(bench_loop())).aborted is None
    changed = {name for name, value in settings().items() if value != before[name]}
    assert {"following_error_window", "following_error_timeout", "fault_reaction_option"} <= changed
    assert "disable_operation_option" in changed
    assert "its objects are as they were" in axis.restore(inside)
    assert dict(axis.inside()) == inside
    assert settings() == before


def test_a_control_that_is_kept_leaves_all_but_gains_as_it_was() -> None:
    axis = axis_of(Bench(bench_loop()), drive_file(scaling=SPINDLE) + GAINS)
    inside = dict(axis.inside())
    assert axis.play(move(), None, with_control(bench_loop())).aborted is None
    said = axis.keep(Path("x.toml"), Path("export"), inside)
    assert "0x60FB:1 (Kv), 0x60FB:2 (Kp), 0x60FB:3 (Tn)" in said
    differs = {place for place, value in axis.inside().items() if value != inside[place]}
    assert differs == {"0x60FB:01", "0x60FB:02", "0x60FB:03"}


def test_the_bus_of_a_virtual_drive_is_no_faster_than_buses_are() -> None:
    times = [virtual_bus_axis(replace(bench_loop(), sample_time=T)).sample_time for T in (5e-5, 1e-4, 2.5e-4, 5e-4)]
    np.testing.assert_allclose(times, [2.5e-4, 3e-4, 2.5e-4, 5e-4])


def test_a_wrong_gear_and_a_wrong_sign_are_corrected_in_the_drive_file(tmp_path: Path) -> None:
    bench = Bench(bench_loop())
    # true: 10 mm of lead; its torque counts against its positions
    bench.firmware.scaling = replace(SCALING, force_sign=-1)
    wrong = axis_of(bench, drive_file(scaling="counts_per_turn = 1e6\nlead_mm = 12.5\nrated_torque = 1"))
    right = wrong.scaled(0.8, -1)
    assert right.increment == pytest.approx(1e-8)
    path = tmp_path / "drive.toml"
    path.write_text(right.text(), encoding="utf-8")
    scaling = read_drive(path).drive.scaling
    assert (scaling.lead, scaling.force_sign) == (pytest.approx(0.01), -1)
    log = right.play(move(), None, with_control(bench_loop())).log
    assert np.ptp(log["reading_load"]) == pytest.approx(0.02, rel=0.01)
    accelerating = slice(20, 120)
    assert np.mean(log["force"][accelerating]) > 0.0
    assert np.mean(log["commanded"][accelerating]) > 0.0


def test_limits_of_an_axis_are_made_tighter_and_not_looser() -> None:
    axis = axis_of(Bench(bench_loop()))
    assert float(axis.limited(replace(axis.limits, force=200.0)).limits.force) == 200.0
    with pytest.raises(ParameterError, match="looser"):
        axis.limited(replace(axis.limits, force=2001.0))


def test_a_real_drive_is_not_run_without_a_clock() -> None:
    bench = Bench(bench_loop())
    bench.firmware.read, read = lambda *at: b"drive" if at == (0x1008, 0) else read(*at), bench.firmware.read  # type: ignore[method-assign]
    with pytest.raises(BusError, match="only a virtual drive"):
        axis_of(bench).listen(0.1)


def test_gains_are_written_into_a_drive_and_read_back() -> None:
    bench = Bench(bench_loop())
    axis = axis_of(bench, drive_file(scaling=SPINDLE) + GAINS)
    inside = dict(axis.inside())
    assert (inside["0x60FB:01"], inside["0x60FB:02"], inside["0x60FB:03"]) == ("3000", "200000", "20000")
    played = axis.play(move(), None, with_control(bench_loop()))
    assert played.aborted is None
    assert bench.firmware.axis.gains == pytest.approx({"Kv": 20.0, "Kp": 8e3, "Tn": 0.05}, rel=1e-6)
    assert any("0x60FB:2: Kp = 8000" in remark for remark in played.remarks)
    # without the time of a bus, and without the set acceleration, which it does not get
    sent = Recorded(position=move().set_position, velocity=move().velocity, sample_time=T)
    run = simulate(with_control(bench_loop()), sent, start=(0.0, 0.0))
    error = played.log["set_position"] - played.log["reading_load"]
    assert np.max(np.abs(error)) == pytest.approx(np.max(np.abs(run["following_error"])), rel=0.01)
    axis.restore(inside)
    assert bench.firmware.axis.gains == pytest.approx({"Kv": 30.0, "Kp": 2e4, "Tn": 0.02}, rel=1e-6)


def test_gains_that_a_drive_takes_otherwise_are_refused_and_the_old_ones_restored() -> None:
    bench = Bench(bench_loop())
    write = bench.firmware.write

    def coarse(index: int, subindex: int, content: bytes) -> None:
        counts = int.from_bytes(content, "little")
        write(
            index,
            subindex,
            (min(counts, 45_000) if (index, subindex) == (0x60FB, 3) else counts).to_bytes(4, "little")
            if index == 0x60FB
            else content,
        )

    bench.firmware.write = coarse  # type: ignore[method-assign]
    axis = axis_of(bench, drive_file(scaling=SPINDLE) + GAINS)
    with pytest.raises(BusError, match=r"Tn = 0\.05 s was written to 0x60FB:3 as 50000 and reads back as 45000"):
        axis.play(move(), None, with_control(bench_loop()))
    assert bench.firmware.axis.gains == pytest.approx({"Kv": 30.0, "Kp": 2e4, "Tn": 0.02}, rel=1e-6)
    assert bench.firmware.state is PowerState.SWITCH_ON_DISABLED


class Shelf:
    """Objects without a drive."""

    where = "shelf"

    def __init__(self) -> None:
        self.objects = {(0x30C0, 1): b"\0" * 4, (0x3140, 1): b"\0" * 4}

    def read(self, index: int, subindex: int) -> bytes:
        return self.objects[index, subindex]

    def write(self, index: int, subindex: int, content: bytes) -> None:
        self.objects[index, subindex] = content


def test_gains_of_a_rotary_motor_are_those_of_its_shaft() -> None:
    text = (
        '[gains.Kv]\nobject = "0x30C0:01"\ntype = "f32"\n[gains.Kp]\nobject = "0x3140:01"\ntype = "f32"\n'
        'unit = "N m s/rad"\n'
    )
    file = drive_of(parse_toml(drive_file(scaling=SPINDLE) + text, "drive.toml"))
    shelf: Any = Shelf()
    told = write_gains(shelf, file.gains, {"Kv": 20.0, "Kp": 8e3}, file.drive.scaling, rotary=False)
    (kv,), (kp,) = (struct.unpack("<f", shelf.objects[place]) for place in ((0x30C0, 1), (0x3140, 1)))
    assert kv == 20.0
    # force = torque 2π / lead, and the speed of the shaft that of the table times 2π / lead
    assert kp == pytest.approx(8e3 * (0.01 / (2.0 * np.pi)) ** 2, rel=1e-6)
    assert "0x3140:01: Kp = 8000 N s/m" in told[1]


@pytest.mark.parametrize(
    ("gain", "why"),
    [
        ('[gains.Kv]\nobject = "60FB"\n', "must be an index and a subindex"),
        ('[gains.Kv]\nobject = "0x60FB:1"\nunit = "ms"\n', "must be one like 1/s"),
        ('[gains.Kw]\nobject = "0x60FB:1"\n', "is not known"),
    ],
)
def test_a_gain_that_is_described_wrongly_is_named_with_its_line(gain: str, why: str) -> None:
    with pytest.raises(ParameterError, match=rf"drive\.toml:\d+.*{why}"):
        drive_of(parse_toml(drive_file(scaling=SPINDLE) + gain, "drive.toml"))


# an axis that turns


def test_a_drive_file_describes_an_axis_that_turns() -> None:
    text = (
        'bus = "canopen"\ninterface = "can0"\ncycle_time_ms = 1\nrotary = true\n[scaling]\ncounts_per_turn = 1e6\n'
        "lead_deg = 360\ngear = 90\nrated_torque = 2\n[limits]\ntravel_deg = 90\nvelocity = 1\nforce = 100\n"
        "following_error_deg = 0.1\nlargest_mass_kg_m2 = 3\n"
    )
    described = drive_of(parse_toml(text, "c.toml")).drive
    assert described.scaling.metre == pytest.approx(2.0 * np.pi / 90e6)  # rad
    assert described.scaling.newton == pytest.approx(2e-3 * 90.0)  # N m
    assert float(described.limits.travel) == pytest.approx(0.5 * np.pi)


def test_an_axis_that_turns_moves_in_rad_under_a_torque() -> None:
    loop = read_machine("rotary_table").loop(None)
    axis, step = virtual_bus_axis(loop), float(loop.sample_time)
    s = np.linspace(0.0, 1.0, 800)
    position = 0.05 * s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
    profile = Profile("turn", "", step, "N", 0.0 * s, position, np.gradient(position, step))
    for control in (None, loop):
        played = axis.play(profile, None, control)
        assert played.aborted is None
        assert played.log.units["reading_load"] == "rad"
        assert played.log.units["force"] == "N m"
        assert np.ptp(played.log["reading_load"]) == pytest.approx(0.05, rel=0.01)
    ended = axis.limited(replace(axis.limits, following_error=2e-5)).play(profile, None, loop).aborted
    assert ended is not None
    assert " rad" in ended
    assert " m " not in ended


def test_for_a_first_hold_a_drive_keeps_the_limit_of_force_that_carried_its_weight_before() -> None:
    axis = virtual_bus_axis(bench_loop())
    found = axis.inside()["0x6072:00"]
    rest = np.zeros(round(0.1 / axis.sample_time))
    still = Profile("hold", "", axis.sample_time, "N", rest, rest, rest)
    assert axis.as_found().play(still).aborted is None
    assert axis.inside()["0x6072:00"] == found
    assert axis.play(still).aborted is None
    assert axis.inside()["0x6072:00"] != found

"""Every time and threshold of a master on a bus, with a case on either side of it; buses and clocks are made here."""

from __future__ import annotations

import os
import socket
import sys
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bus_bench import drive
from feeddrive.bus import canopen, ethercat, play, sampling
from feeddrive.bus import client as bus_client
from feeddrive.bus.canopen import CANopen
from feeddrive.bus.cia402 import MODES, SENT, TOLD, Layout, PowerState, answer
from feeddrive.bus.client import DriveClient, check_scaling
from feeddrive.bus.drive_file import DriveScaling
from feeddrive.bus.ethercat import EtherCAT, Segment
from feeddrive.bus.play import Profile, check_profile, play_profile
from feeddrive.bus.sampling import DriveSamples, Sampler
from feeddrive.bus.transport import RefusedError, urgent
from feeddrive.language.errors import BusError, ParameterError


class Clock:
    """Time that passes where a test says so."""

    def __init__(self) -> None:
        self.now = 100.0

    def monotonic(self) -> float:
        return self.now


class Mirror:
    """A drive whose position is its target at once. It answers from cycle `deaf` on, and is switched on `slow` s late.

    `enabled` counts its cycles in operation.
    """

    where = "mirror, station 1"

    def __init__(self, deaf: int = 0, clock: Clock | None = None, slow: float = 0.0, cycle_time: float = 1e-3) -> None:
        self.deaf, self.clock, self.slow, self.cycle_time = deaf, clock or Clock(), slow, cycle_time
        self.began = self.clock.now
        self.cycles = self.enabled = 0
        self.state_, self.control = PowerState.SWITCH_ON_DISABLED, 0
        self.sent = dict.fromkeys(Layout(SENT).names, 0)

    def open(self) -> None:
        pass

    def read(self, index: int, subindex: int) -> bytes:
        raise RefusedError(self.where, index, subindex, 0x06020000, False)

    def map(self, sent: Layout, told: Layout) -> None:
        pass

    def operate(self, content: bytes) -> None:
        pass

    def put(self, content: bytes) -> None:
        if content:
            self.sent = Layout(SENT).unpack(content)

    def take(self, timeout: float) -> bytes | None:
        self.cycles += 1
        self.clock.now += self.cycle_time
        if self.cycles <= self.deaf:
            return None
        control = self.sent["controlword"]
        after = answer(self.state_, control, self.control)
        if after is not PowerState.ENABLED or self.clock.now - self.began >= self.slow:
            self.state_ = after
        self.control = control
        self.enabled += self.state_ is PowerState.ENABLED
        values = dict.fromkeys(Layout(TOLD).names, 0)
        values |= {
            "statusword": self.state_.status,
            "mode_display": MODES["csp"],
            "position": self.sent["target_position"],
        }
        return Layout(TOLD).pack(values)

    def state(self) -> str:
        return "it is a mirror"

    def close(self) -> None:
        pass


# CiA 402


@pytest.mark.parametrize(("deaf", "is_heard"), [(15, True), (30, False)])
def test_a_drive_must_answer_within_its_first_twenty_cycles(deaf: int, is_heard: bool):
    client = DriveClient(Mirror(deaf), drive("ethercat"), paced=False)
    with nullcontext() if is_heard else pytest.raises(BusError, match="but its process data are lost"):
        client.hear()


@pytest.mark.parametrize(("milli", "is_near"), [(1004, True), (1007, False)])  # and 0.5 mN m, as it is rounded
def test_a_drive_may_differ_from_its_file_by_half_a_percent(milli: int, is_near: bool):
    class Rated(Mirror):
        def read(self, index: int, subindex: int) -> bytes:
            return milli.to_bytes(4, "little") if index == 0x6076 else super().read(index, subindex)

    scaling = DriveScaling(increment=1e-8, rated_force=1.0)
    with nullcontext() if is_near else pytest.raises(BusError, match="correct the drive file, or the drive"):
        check_scaling(Rated(), scaling)


@pytest.mark.parametrize(("slow", "is_on"), [(2.0, True), (4.0, False)])
def test_a_drive_has_three_seconds_to_switch_on(slow: float, is_on: bool, monkeypatch: pytest.MonkeyPatch):
    clock = Clock()
    monkeypatch.setattr(bus_client, "time", clock)
    mirror = Mirror(clock=clock, slow=slow, cycle_time=0.05)
    client = DriveClient(mirror, drive("ethercat", cycle_time=0.05), paced=False)
    client.map()
    client.hear()
    with nullcontext() if is_on else pytest.raises(BusError, match="does not go to 'operation enabled' within 3 s"):
        client.enable()


@pytest.mark.parametrize(("seconds", "is_held"), [(6.0, True), (7.0, False)])
def test_a_watchdog_is_one_that_16_bits_hold_in_steps_of_a_tenth_of_a_millisecond(seconds: float, is_held: bool):
    assert (seconds / 1e-4 < 2**16) is is_held
    with nullcontext() if is_held else pytest.raises(ParameterError, match="watchdog"):
        drive("ethercat", watchdog=seconds)


# CANopen


@pytest.mark.parametrize(("period", "is_heard"), [(0.04, True), (0.08, False)])
def test_a_master_with_a_cycle_of_50_ms_is_heard(period: float, is_heard: bool, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(canopen, "Event", lambda: SimpleNamespace(set=None, wait=lambda seconds: seconds >= period))
    node = CANopen("virtual:x", 5)
    node._network = SimpleNamespace(subscribe=lambda *_: None, unsubscribe=lambda *_: None)
    with pytest.raises(BusError, match="another master sends SYNC") if is_heard else nullcontext():
        node._check_alone()
    # and on Ethernet, where each frame of the other master is seen
    monkeypatch.setattr(ethercat, "opened_socket", lambda *_: closing_line())
    monkeypatch.setattr(ethercat, "_frames", lambda _, seconds: [(b"", False)] * (seconds >= period))
    with pytest.raises(BusError, match="another EtherCAT master sends") if is_heard else nullcontext():
        ethercat._check_alone("here", "x")


def closing_line(**more: Any) -> Any:
    return SimpleNamespace(close=lambda: None, send=lambda _: None, settimeout=lambda _: None, **more)


@pytest.mark.parametrize(("delay", "words"), [(0.2, "it answers, but"), (0.5, "it does not answer")])
def test_a_node_that_is_silent_is_asked_once_more_for_300_ms(delay: float, words: str):
    class SilenceError(Exception):
        pass

    class Sdo:
        RESPONSE_TIMEOUT = 1.0

        def upload(self, index: int, subindex: int) -> bytes:
            if delay > self.RESPONSE_TIMEOUT:
                raise SilenceError
            return bytes(4)

    node = CANopen("virtual:x", 5)
    node._canopen = SimpleNamespace(SdoAbortedError=KeyError, SdoCommunicationError=SilenceError)
    node._node = SimpleNamespace(sdo=Sdo())
    assert node.state().startswith(words)


# EtherCAT


def station(**of_master: Any) -> EtherCAT:
    """A station whose segment has a master and a library made here."""
    made = EtherCAT("x", 1)
    made.slave = SimpleNamespace(state=2, al_status=0)
    segment = made._segment
    segment.soem = SimpleNamespace(
        SdoError=KeyError, MailboxError=OSError, PacketError=OSError, WkcError=OSError, SAFEOP_STATE=4, OP_STATE=8
    )
    nothing = {name: lambda *_: None for name in ("read_state", "write_state", "send_processdata")}
    segment.master = SimpleNamespace(**nothing, receive_processdata=lambda _: 1, expected_wkc=1, **of_master)
    return made


@pytest.mark.parametrize(("losses", "is_read"), [(3, True), (5, False)])
def test_an_object_is_asked_for_four_times(losses: int, is_read: bool):
    made, tries = station(), list[int]()

    def read(index: int, subindex: int) -> bytes:
        tries.append(index)
        if len(tries) <= losses:
            raise OSError
        return b"\x92\x01\x02\x00"

    made.slave.sdo_read = read
    with nullcontext() if is_read else pytest.raises(BusError, match="object 0x1000:00 was not answered"):
        made.read(0x1000, 0)


@pytest.mark.parametrize(("latency", "is_found"), [(15_000, True), (30_000, False)])
def test_a_frame_has_20_ms_to_come_back_at_standstill(latency: int, is_found: bool, monkeypatch: pytest.MonkeyPatch):
    settings = SimpleNamespace(timeouts=SimpleNamespace())

    class Master:
        slaves: tuple[object, ...] = (object(),)

        def open(self, interface: str) -> None:
            pass

        def config_init(self) -> int:
            return int(settings.timeouts.ret >= latency)

    monkeypatch.setitem(sys.modules, "pysoem", SimpleNamespace(settings=settings, Master=Master))
    monkeypatch.setattr(ethercat, "check_interface", lambda _: None)
    monkeypatch.setattr(ethercat, "_check_alone", lambda *_: None)
    segment = Segment("nowhere")
    try:
        with nullcontext() if is_found else pytest.raises(BusError, match="no station answers"):
            segment.open("here")
    finally:
        segment._claim.free()


@pytest.mark.parametrize(
    ("to_safe_op", "to_op", "missed"),
    [(0.4, 0.0, ""), (0.8, 0.0, "SAFE-OP"), (0.0, 1.5, ""), (0.0, 3.0, "OP")],
)
def test_a_station_has_half_a_second_to_safe_op_and_two_to_op(
    to_safe_op: float, to_op: float, missed: str, monkeypatch: pytest.MonkeyPatch
):
    clock = Clock()

    def check(state: int, microseconds: int) -> int:
        if state == 4:
            return 4 if 1e-6 * microseconds >= to_safe_op else 2
        clock.now += 0.1
        return 8 if clock.now >= 100.0 + to_op else 4

    monkeypatch.setattr(ethercat, "time", clock)
    made = station(state_check=check)
    with pytest.raises(BusError, match=f"does not go to {missed}:") if missed else nullcontext():
        made.operate(b"")


def test_a_master_on_the_same_computer_is_heard(monkeypatch: pytest.MonkeyPatch):
    """Linux gives sent frames to sockets of ETH_P_ALL alone, 3 by linux/if_ether.h."""
    frame = bytes(12) + b"\x88\xa4" + bytes(46)

    def opened(interface: str, protocol: int) -> Any:
        def receive(_: int) -> tuple[bytes, tuple[str, int, int]]:
            if protocol != 3:
                raise TimeoutError
            return frame, (interface, protocol, socket.PACKET_OUTGOING)

        return closing_line(recvfrom=receive)

    monkeypatch.setattr(ethercat, "opened_socket", opened)
    with pytest.raises(BusError, match="another EtherCAT master sends on x"):
        ethercat._check_alone("here", "x")


def test_an_interface_is_up_as_the_kernel_lists_it():
    """IFF_UP is the lowest bit of the flags."""
    interfaces = list(Path("/sys/class/net").glob("*/flags"))
    assert interfaces
    for flags in interfaces:
        is_up = int(flags.read_text(encoding="ascii"), 16) & 1
        assert ethercat._is_up(flags.parent.name) is bool(is_up)


# what is played


@pytest.mark.parametrize(("share", "is_played"), [(0.7e-3, True), (1.5e-3, False)])
def test_a_thousandth_of_the_power_may_lie_between_the_cycles(share: float, is_played: bool):
    """Every fourth row of 1 ms is played: 20 Hz are below half the rate, 200 Hz above."""
    time = 1e-3 * np.arange(2000)
    high = np.sqrt(share / (1.0 - share))
    excitation = np.sin(2 * np.pi * 20.0 * time) + high * np.sin(2 * np.pi * 200.0 * time)
    with nullcontext() if is_played else pytest.raises(ParameterError, match="half the rate of the bus"):
        play._check_band("a", excitation, 4, 1e-3)


def profile(excitation: np.ndarray) -> Profile:
    rest = np.zeros(excitation.size)
    return Profile("p", "", 1e-3, "N", excitation, rest, rest)


@pytest.mark.parametrize(("end", "is_played"), [(0.015, True), (-0.015, True), (0.03, False)])
def test_a_profile_may_end_with_two_percent_of_its_peak(end: float, is_played: bool):
    with nullcontext() if is_played else pytest.raises(ParameterError, match="a jump for the axis"):
        check_profile(profile(np.array([0.0, 1.0, end])), drive("ethercat"))


def test_the_last_target_is_held_for_a_tenth_of_a_second():
    """Ten rows of 1 ms; the cycles in operation before them are few."""
    mirror = Mirror()
    client = DriveClient(mirror, drive("ethercat"), paced=False)
    client.map()
    client.hear()
    assert play_profile(client, profile(np.zeros(10))).aborted is None
    assert 10 + 80 <= mirror.enabled <= 10 + 130


@pytest.mark.parametrize(
    ("lost", "seconds", "is_sampled"), [(700, 0, True), (1100, 0, False), (1, 2, True), (1, 4, False)]
)
def test_a_sampled_drive_is_given_up_after_a_thousand_cycles_or_three_seconds(
    lost: int, seconds: float, is_sampled: bool, monkeypatch: pytest.MonkeyPatch
):
    clock = Clock()
    monkeypatch.setattr(sampling, "clock", clock)
    sampler = Sampler(Mirror(deaf=10_000, clock=clock, cycle_time=0.0), drive("ethercat"))
    sampler.pace = SimpleNamespace(wait=lambda: 0.0)
    clock.now += seconds
    said = f"no answer for {seconds:g} s, in {1 if seconds else 1000} cycles"
    with nullcontext() if is_sampled else pytest.raises(BusError, match=said):
        for _ in range(lost):
            assert sampler.cycle() == (0.0, None)


@pytest.mark.parametrize(("needed", "is_ended"), [(2.0, False), (5.0, True)])
def test_a_process_that_samples_has_three_seconds_to_release_its_drive(needed: float, is_ended: bool):
    class Process:
        waited = 0.0
        ended = False

        def join(self, seconds: float) -> None:
            self.waited = seconds

        def is_alive(self) -> bool:
            return self.waited < needed

        def terminate(self) -> None:
            self.ended = True

    samples = DriveSamples.__new__(DriveSamples)
    samples._process, samples._line = Process(), closing_line()
    samples.close()
    assert samples._process.ended is is_ended


@pytest.mark.parametrize("is_root", [True, False])
def test_real_time_scheduling_is_asked_for_and_left_as_it_was(is_root: bool, monkeypatch: pytest.MonkeyPatch):
    """The kernel takes priorities of 1 to 99."""
    calls = list[tuple[int, Any]]()

    def schedule(_: int, policy: int, parameters: Any) -> None:
        if not is_root or not (policy == 0 or 1 <= parameters <= 99):
            raise PermissionError
        calls.append((policy, parameters))

    for name, function in (
        ("sched_getscheduler", lambda _: 0),
        ("sched_getparam", lambda _: 0),
        ("sched_param", lambda priority: priority),
        ("sched_setscheduler", schedule),
    ):
        monkeypatch.setattr(os, name, function, raising=False)
    with urgent(True) as permitted:
        assert permitted is is_root
        assert len(calls) == is_root
    assert calls[1:] == [(0, 0)] * is_root

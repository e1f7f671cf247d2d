"""What is tried on a virtual drive over either bus; each scenario gives plain figures for a test to judge.

As a program it runs those that it is asked for on its input over EtherCAT, and answers each with a line of JSON.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import struct
import subprocess
import sys
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from bus_bench import LIMITS, SCALING, T, bench_loop, client, drive, powered, with_law
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.controller.pole_placement import PolePlacement
from feeddrive.blocks.load.recorded_force import RecordedForce
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.bus import ethercat, virtual_nodes
from feeddrive.bus.cia402 import FAULT_RESET, OBJECTS, PowerState
from feeddrive.bus.client import DriveClient, driven_together, transport_of
from feeddrive.bus.control_in_master import ControlInMaster
from feeddrive.bus.drive_file import DriveScaling
from feeddrive.bus.faults import InjectedFault
from feeddrive.bus.play import Profile, listened, play_profile, play_together
from feeddrive.bus.transport import Claim, read_object, write_object
from feeddrive.bus.virtual_drive import DrivenAxis, Firmware, PdoMap
from feeddrive.language.errors import FeeddriveError
from feeddrive.language.progress import Progress
from feeddrive.loop.simulate import simulate

N = 800


def profile(rows: int = N, distance: float = 0.02, peak: float = 100.0, unit: str = "N") -> Profile:
    """Out by 20 mm with a chirp of 100 N on top that swells and fades."""
    t = np.arange(rows) * T
    s = t / t[-1]
    position = distance * s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
    excitation = peak * np.sin(np.pi * s) ** 2 * np.sin(2 * np.pi * (5.0 + 40.0 * s) * t)
    return Profile("chirp", "", T, unit, excitation, position, np.gradient(position, T))


def exact(bus: str) -> dict[str, float]:
    """csp against `simulate` of the same setpoints, rounded as the bus rounds them: largest differences."""
    sent = profile()
    with powered(bus) as bench, client(drive(bus), bench.interface) as master:
        played = play_profile(master, sent)
    log, metre, newton = played.log, SCALING.metre, SCALING.newton
    target = np.array([SCALING.increments(x) * metre for x in sent.set_position])
    velocity = np.array([SCALING.increments(v) * metre for v in sent.velocity])
    force = np.array([SCALING.per_mille(f) * newton for f in sent.excitation])
    truth = simulate(
        bench_loop(),
        Recorded(position=target, velocity=velocity, sample_time=T),
        added_force=RecordedForce(force=force, sample_time=T),
        start=(0.0, 0.0),
    )
    return {
        "rows": len(log),
        "lost": played.lost,
        "aborted": float(played.aborted is not None),
        "target": float(np.max(np.abs(log["set_position"] - target))),
        "load_increments": float(np.max(np.abs(log["reading_load"] - truth["reading_load"]))) / metre,
        "motor_increments": float(np.max(np.abs(log["reading_motor"] - truth["reading_motor"]))) / metre,
        "force_per_mille": float(np.max(np.abs(log["force"] - truth["force"] - force))) / newton,
        "moved": float(np.ptp(log["reading_load"])),
    }


def led(bus: str) -> dict[str, float]:
    """A control in the master in cst, against `simulate` of its loop with the time of the bus: largest differences."""
    law = CascadePPI(Kv=20.0, Kp=8e3, Tn=0.05)
    loop, sent = with_law(bench_loop(), law), profile()
    control = ControlInMaster(loop, T, force=2000.0, encoders=2)
    with powered(bus) as bench, client(drive(bus, mode="cst"), bench.interface) as master:
        played = play_profile(master, sent, control=control)
        state = bench.state
    late = replace(loop, axis=replace(loop.axis, actuator=replace(loop.axis.actuator, dead_time=2.0 * T)))
    truth = simulate(
        late,
        sent.reference(),
        added_force=RecordedForce(force=sent.excitation, sample_time=T),
        start=(0.0, 0.0),
    )
    rows = len(played.log)
    return {
        "rows": rows,
        "lost": played.lost,
        "aborted": float(played.aborted is not None),
        "off": float(state == "SWITCH_ON_DISABLED"),
        "load": float(np.max(np.abs(played.log["reading_load"] - truth["reading_load"][:rows]))),
    }


def torque(bus: str) -> dict[str, float]:
    """cst: 60 N on 100 kg with 300 N s/m for 0.3 s."""
    force = SCALING.per_mille(60.0) * SCALING.newton
    with powered(bus) as bench, client(drive(bus, mode="cst"), bench.interface) as master:
        master.enable()
        start = master.told.position  # type: ignore[union-attr]
        for _ in range(300):
            master.command(force=60.0)
            told = master.cycle()
        assert told is not None
        return {"moved": told.position - start, "force": told.force, "sent": force}


def speed(bus: str) -> dict[str, float]:
    """csv: 50 mm/s for a second, through the velocity loop with its integral."""
    with powered(bus) as bench, client(drive(bus, mode="csv"), bench.interface) as master:
        master.enable()
        for _ in range(1000):
            master.command(velocity=0.05)
            told = master.cycle()
        assert told is not None
        return {"velocity": told.velocity}


def losses(bus: str) -> dict[str, Any]:
    """Two frames in a row are lost, and go unpunished; then five, and the motion ends."""
    found: dict[str, Any] = {}
    for name, few in (("few", 2), ("many", 5)):
        with powered(bus) as bench:
            master = client(drive(bus), bench.interface)
            master._timeout = 0.5
            with master:
                master.enable()
                bench.lose(100, few)
                played = play_profile(master, profile())
                found[name] = {
                    "aborted": played.aborted,
                    "lost": played.lost,
                    "rows": len(played.log),
                    "marked": float(np.sum(played.log["lost"])) if "lost" in played.log.channels else 0.0,
                    "finite": bool(np.all(np.isfinite(played.log["reading_load"]))),
                    "state": bench.state,
                }
    return found


def faults(bus: str) -> dict[str, Any]:
    """A target far away trips the drive; it is refused until it is reset, and then runs."""
    found: dict[str, Any] = {}
    with powered(bus) as bench, client(drive(bus), bench.interface) as master:
        master.enable()
        master.command(position=0.1)
        # the time out of the following error, and 0.2 s of standstill after the ramp of the reaction
        for _ in range(400):
            master.cycle()
        found["trouble"] = master.trouble()
        found["state"] = bench.state
        found["refused"] = said(master.enable)
        # the bit alone does not reset: it must rise
        master._values["controlword"] = FAULT_RESET
        master.reset_fault()
        found["after"] = bench.state
        master.enable()
        found["again"] = bench.state
        master.disable()
        found["off"] = bench.state
    return found


def limits(bus: str) -> dict[str, Any]:
    """A following error beyond its limit, and Ctrl-C: quick stop, standstill, switched off, and a log of what was."""
    found: dict[str, Any] = {}
    tight = LIMITS.__class__(travel=0.2, velocity=0.5, force=2000.0, following_error=2e-5)
    with powered(bus) as bench:
        with client(drive(bus, limits=tight), bench.interface) as master:
            # the drive's own window is taken away, so that the limit of the client is what ends the motion
            write_object(master.transport, "following_error_window", 0xFFFFFFFF)
            played = play_profile(master, profile(peak=600.0))
        found["aborted"], found["state"], found["rows"] = played.aborted, bench.state, len(played.log)
    with powered(bus) as bench, client(drive(bus), bench.interface) as master:

        class Press(Progress):
            """Ctrl-C after 300 rows."""

            def show_step(self, what: str, done: int | None, of: int | None, part: str) -> None:
                if done is not None and done >= 300:
                    os.kill(os.getpid(), signal.SIGINT)

        played = play_profile(master, profile(), progress=Press())
        found["pressed"], found["pressed_state"] = played.aborted, bench.state
        before = bench.place
        for _ in range(50):
            master.cycle()
        found["drift"] = abs(bench.place - before)
    return found


def pressed(bus: str) -> dict[str, Any]:
    """A person at a stop that is wired to the drive, whose inputs are mapped as well, in motion and after it."""
    found: dict[str, Any] = {}
    stops = drive(bus, stop_input=16)
    with powered(bus, faults=(InjectedFault("stop_input", 300, 0.0),)) as bench:
        with client(stops, bench.interface) as master:
            played = play_profile(master, profile())
            found["aborted"], found["state"], found["cause"] = played.aborted, bench.state, played.cause
            found["rows"] = len(played.log)
            found["refused"] = said(lambda: play_profile(master, profile()))
        found["still"] = bench.state
    return found


def wrong(bus: str) -> dict[str, str]:
    """What does not fit the drive, each as the sentence that comes of it."""
    found: dict[str, str] = {}
    turn = DriveScaling(counts_per_turn=2e6, lead=0.01, rated_torque=1.0)
    strong = DriveScaling(counts_per_turn=1e6, lead=0.01, rated_torque=10.0)
    geared = DriveScaling(counts_per_turn=1e6, lead=0.01, gear=2.0, rated_torque=1.0)
    with powered(bus) as bench:
        for name, scaling in (("counts", turn), ("torque", strong), ("gear", geared)):
            found[name] = said(lambda s=scaling: client(drive(bus, scaling=s), bench.interface).__enter__())
        slow = drive(bus, cycle_time=2 * T)
        found["cycle"] = said(lambda: client(slow, bench.interface).__enter__())
        found["unpaced"] = _unpaced(bus, bench.interface)
    law = PolePlacement(model=bench_loop().axis.plant, bandwidth=20.0)
    with powered(bus, with_law(bench_loop(), law)) as bench:
        found["mode"] = said(lambda: client(drive(bus, mode="csv"), bench.interface).__enter__())
    return found


def _unpaced(bus: str, interface: str) -> str:
    """Another make of drive may not be run without a clock."""
    master = client(drive(bus), interface)
    DriveClient.is_virtual = property(lambda _: False)  # type: ignore[assignment]
    try:
        return said(master.__enter__)
    finally:
        DriveClient.is_virtual = property(lambda made: made.identity.get("name") == "feeddrive virtual drive")  # type: ignore[assignment]


def refusals(bus: str) -> dict[str, str]:
    """Objects that cannot be read or written."""
    found: dict[str, str] = {}
    with powered(bus) as bench, client(drive(bus), bench.interface) as master:
        line = master.transport
        found["missing"] = said(lambda: line.read(0x5000, 0))
        found["read_only"] = said(lambda: write_object(line, "statusword", 1))
        found["length"] = said(lambda: line.write(OBJECTS["max_torque"].index, 0, b"\1\2\3\4"))
        found["mapping"] = said(lambda: line.write(0x1600, 0, b"\0"))
        found["mode"] = said(lambda: write_object(line, "mode", 3))
        found["subindex"] = said(lambda: line.read(0x1018, 9))
    return found


def silence(bus: str) -> dict[str, Any]:
    """The master pauses for longer than the watchdog (EtherCAT): the drive leaves OP, and says why."""
    with powered(bus, watchdog=1.0) as bench, client(drive(bus), bench.interface) as master:
        master._timeout = 0.2
        master.enable()
        time.sleep(2.5)
        trouble = ""
        for _ in range(10):
            master.command()
            master.cycle()
            trouble = master.trouble()
        unreachable = said(master.stop)
        return {"trouble": trouble, "state": bench.state, "code": bench.error_code, "unreachable": unreachable}


def held_up(bus: str) -> dict[str, Any]:
    """The master, with a clock, is held up for 0.3 s in motion, which is less than its watchdog."""
    with powered(bus) as bench:
        with client(drive(bus), bench.interface) as before:
            write_object(before.transport, "connection_option", 0)
        described = drive(bus, late_cycles=200, lost_frames=100, watchdog=5.0)
        master = DriveClient(transport_of(described, bench.interface, None), described)
        with master:
            found: dict[str, Any] = {"option": read_object(master.transport, "connection_option")}

            class Hold(Progress):
                """A pause at row 100."""

                def show_step(self, what: str, done: int | None, of: int | None, part: str) -> None:
                    if done == 100:
                        time.sleep(0.3)

            played = play_profile(master, profile(), progress=Hold())
    return {**found, "aborted": played.aborted, "rows": len(played.log)}


def pulled(bus: str) -> dict[str, Any]:
    """The interface of the master is taken down in motion (EtherCAT): why it ended."""
    with powered(bus) as bench:
        described = drive(bus, late_cycles=1000)

        class Pull(Progress):
            """At row 100."""

            def show_step(self, what: str, done: int | None, of: int | None, part: str) -> None:
                if done == 100:
                    subprocess.run(["ip", "link", "set", bench.interface, "down"], check=True)
                    master._timeout = 0.02

        with DriveClient(transport_of(described, bench.interface, None), described) as master:
            master._timeout = 1.0  # so that nothing of a busy computer passes for a lost frame
            played = play_profile(master, profile(), progress=Pull())
        subprocess.run(["ip", "link", "set", bench.interface, "up"], check=True)
    return {"aborted": played.aborted}


def kinds(bus: str) -> dict[str, Any]:
    """An excitation of the position, of the velocity and of the torque alone, against the axis without a bus."""
    found: dict[str, Any] = {}
    for mode, unit, peak in (("csp", "m", 1e-4), ("csv", "m/s", 0.02), ("cst", "N", 100.0)):
        sent = profile(400, 0.0 if mode == "cst" else 0.01, peak, unit)
        with powered(bus) as bench, client(drive(bus, mode=mode), bench.interface) as master:
            played = play_profile(master, sent)
        truth = _unbused(mode, sent, 400)
        found[mode] = {
            "aborted": played.aborted,
            "moved": float(np.ptp(truth)),
            "increments": float(np.max(np.abs(played.log["reading_load"] - truth))) / SCALING.metre,
            "excitation": bool(np.array_equal(played.log["excitation"], sent.excitation)),
        }
    return found


@contextmanager
def freezing(after: int, mute: bool) -> Iterator[None]:
    """Virtual drives tell the same values from that cycle in operation on, and 0 as 0x60F4; `mute` ones no velocity.

    Statusword and frames go on, and so does the axis.
    """
    whole = Firmware.cycle
    names = ("position", "velocity", "torque", "following_error", "second_position")

    def cycle(self: Any) -> None:
        self.values.update(getattr(self, "true", {}))
        whole(self)
        self.enabled = getattr(self, "enabled", 0) + (self.state is PowerState.ENABLED)
        if self.enabled >= after:
            self.true = {name: self.values[name] for name in names}
            if self.enabled == after and not hasattr(self, "shown"):
                self.shown = {**self.true, "following_error": 0} | ({"velocity": 0} if mute else {})
            self.values.update(self.shown)

    Firmware.cycle = cycle  # type: ignore[method-assign]
    try:
        yield
    finally:
        Firmware.cycle = whole  # type: ignore[method-assign]


def frozen(bus: str) -> dict[str, Any]:
    """Drives whose values stand still from their 150th cycle in operation, beside a live axis in the same motion."""
    found: dict[str, Any] = {}
    for mode, unit, peak in (("csp", "N", 100.0), ("csv", "m/s", 0.02), ("cst", "N", 100.0)):
        sent = profile(600, 0.0 if mode == "cst" else 0.02, peak, unit)
        found[mode] = {"live": _unbused(mode, sent, 250)}
        for how in ("stale", "mute"):
            with (
                freezing(150, how == "mute"),
                powered(bus) as bench,
                client(drive(bus, mode=mode), bench.interface) as m,
            ):
                dead = play_profile(m, sent)
            found[mode][how] = {"aborted": dead.aborted, "reading_load": dead.log["reading_load"].tolist()}
        moved = np.cumsum(sent.velocity + sent.excitation) * T if mode == "csv" else sent.set_position
        found[mode] |= {"set_position": moved.tolist(), "excitation": sent.excitation.tolist()}
    return found


def _unbused(mode: str, sent: Profile, rows: int) -> list[float]:
    """The readings of the bench's axis in the first rows of a profile, without a bus, m."""
    axis, metre, found = DrivenAxis(bench_loop()), SCALING.metre, list[float]()
    for x, v, each in zip(sent.set_position[:rows], sent.velocity[:rows], sent.excitation[:rows], strict=True):
        if mode == "cst":
            done = axis.push(SCALING.per_mille(each) * SCALING.newton, 1)
        else:
            target = SCALING.increments(x + (each if sent.unit == "m" else 0.0)) * metre
            speed = SCALING.increments(v + (each if sent.unit == "m/s" else 0.0)) * metre
            force = SCALING.per_mille(each) * SCALING.newton if sent.unit == "N" else 0.0
            done = axis.follow(np.array([target]), np.array([speed]), force, True, alone=mode == "csv")
        found.append(done.position)
    return found


def deceived(bus: str) -> dict[str, Any]:
    """A drive that follows, and tells 0 as 0x60F4 all the time; its window is taken away."""
    whole = Firmware.cycle

    def cycle(self: Any) -> None:
        whole(self)
        self.values["following_error"] = 0

    tight = replace(LIMITS, following_error=2e-5)
    Firmware.cycle = cycle  # type: ignore[method-assign]
    try:
        with powered(bus) as bench, client(drive(bus, limits=tight), bench.interface) as master:
            write_object(master.transport, "following_error_window", 0xFFFFFFFF)
            played = play_profile(master, profile(peak=600.0))
    finally:
        Firmware.cycle = whole  # type: ignore[method-assign]
    behind = np.abs(played.log["set_position"] - played.log["reading_load"])
    return {"aborted": played.aborted, "beyond": int(np.sum(behind > tight.following_error))}


def second(bus: str) -> dict[str, Any]:
    """The last of three stations on a segment moves; a fourth is not there."""
    with powered(bus, stations=3) as bench:
        with client(drive(bus, station=3), bench.interface) as master:
            played = play_profile(master, profile(200, 0.002))
            found = {"aborted": played.aborted, "lost": played.lost, "place": bench.place}
        with client(drive(bus, station=1), bench.interface) as master:
            found["first"] = listened(master, 0.01).log["reading_load"][0]
        found["fourth"] = said(lambda: client(drive(bus, station=4), bench.interface).__enter__())
    return found


def _two(interface: str, **changes: Any) -> list[DriveClient]:
    """Masters of two stations of one segment; the changes are those of the second drive."""
    segment = ethercat.Segment(interface)
    drives = drive("ethercat", station=1), drive("ethercat", station=2, **changes)
    return [DriveClient(transport_of(each, interface, None, segment), each, paced=False) for each in drives]


def plan(bus: str) -> dict[str, Any]:
    """Two axes of a plan: against `simulate` of each; and one of them beyond its travel after some way."""
    sent = [profile(400, 0.02, peak=0.0), profile(400, -0.011, peak=0.0)]
    metre = SCALING.metre
    found: dict[str, Any] = {"off": []}
    with powered(bus, stations=2) as bench:
        clients = _two(bench.interface)
        with driven_together(clients):
            played = play_together(clients, sent, names=["x", "y"])
        for each, motion in zip(played, sent, strict=True):
            target = np.array([SCALING.increments(x) * metre for x in motion.set_position])
            velocity = np.array([SCALING.increments(v) * metre for v in motion.velocity])
            reference = Recorded(position=target, velocity=velocity, sample_time=T)
            truth = simulate(bench_loop(), reference, start=(0.0, 0.0))
            found["off"].append(float(np.max(np.abs(each.log["reading_load"] - truth["reading_load"]))) / metre)
        found["aborted"], found["lost"] = [each.aborted for each in played], [each.lost for each in played]
        found["state"], found["place"] = bench.state, bench.place
    with powered(bus, stations=2) as bench:
        clients = _two(bench.interface, limits=replace(LIMITS, travel=0.004))
        with driven_together(clients):
            ended = play_together(clients, sent, names=["x", "y"])
        found["ended"] = [each.aborted for each in ended]
        found["rows"] = [len(each.log) for each in ended]
        found["way"] = [float(abs(each.log["reading_load"][-1])) for each in ended]
        found["after"] = bench.state
    return found


def foreign(bus: str) -> dict[str, Any]:
    """Masters of another make, which know nothing of the lock: sending here, sending on the line, held up in OP."""
    found: dict[str, Any] = {}
    fork = multiprocessing.get_context("fork")
    with powered(bus) as bench:
        for name, interface in (("here", bench.interface), ("line", "veth1")):
            other = fork.Process(target=_sending, args=(interface,), daemon=True)
            other.start()
            time.sleep(0.1)
            before = bench.cycles
            found[name] = said(client(drive(bus), bench.interface).__enter__)
            found[f"{name}_cycles"] = bench.cycles - before
            other.kill()
            other.join()
        here, there = fork.Pipe()
        other = fork.Process(target=_driving, args=(bus, bench.interface, there), daemon=True)
        other.start()
        assert here.poll(20)
        here.recv()
        time.sleep(0.2)
        found["held"] = said(client(drive(bus), bench.interface).__enter__)
        found["held_state"] = bench.state
        os.kill(other.pid or 0, signal.SIGCONT)
        assert here.poll(20)
        found["trouble"] = here.recv()
        other.join(10)
        with client(drive(bus), bench.interface) as master:
            found["after"] = listened(master, 0.01).log["reading_load"].size
    return found


def _sending(interface: str) -> None:
    """A frame with an empty datagram every 5 ms."""
    line = ethercat.opened_socket(interface, 0x88A4)
    while True:
        line.send(b"\xff" * 6 + b"\x02\x00\x00\x00\x00\x02\x88\xa4" + struct.pack("<H", 0x1000 + 14) + bytes(44))
        time.sleep(0.005)


def _driving(bus: str, interface: str, line: Any) -> None:
    """Moves nothing, stands still in OP as a process does under SIGSTOP, and goes on."""
    Claim.take = lambda *_: None  # type: ignore[method-assign]
    Claim.free = lambda *_: None  # type: ignore[method-assign]
    with client(drive(bus), interface) as master:
        master.enable()
        line.send("in OP")
        os.kill(os.getpid(), signal.SIGSTOP)
        for _ in range(20):
            master.command()
            master.cycle()
        line.send(master.trouble())


def hearing(bus: str) -> dict[str, Any]:
    """A log of a drive that stays switched off."""
    with powered(bus) as bench, client(drive(bus), bench.interface) as master:
        heard = listened(master, 0.2)
        return {"rows": len(heard.log), "channels": sorted(heard.log.channels), "state": bench.state}


def mapping(bus: str) -> dict[str, Any]:
    """A drive that answers to an entry of its mapping too late, or never, or keeps a mapping of its own."""
    found: dict[str, Any] = {}
    for name, few in (("late", 1), ("mute", 1 << 30)):
        with unanswered(0x1600, 2, few), powered(bus) as bench:

            def opened(interface: str = bench.interface, name: str = name) -> None:
                with client(drive(bus), interface) as master:
                    found[f"{name}_state"] = str(master.state)

            found[name] = said(opened)
    with kept_mapping(), powered(bus) as bench:
        found["fixed"] = said(client(drive(bus), bench.interface).__enter__)
    return found


@contextmanager
def unanswered(index: int, subindex: int, few: int) -> Iterator[None]:
    """The virtual drive swallows its answers to the first few reads of an object that follow the assignment."""
    whole, left = virtual_nodes.answer, [few]

    def answer(message: bytes, objects: PdoMap) -> bytes | None:
        asked = message[8] >> 5 == 2 and struct.unpack_from("<HB", message, 9) == (index, subindex)
        if asked and left[0] and objects.read(0x1C13, 0) != b"\0":
            left[0] -= 1
            return None
        return whole(message, objects)

    virtual_nodes.answer = answer
    try:
        yield
    finally:
        virtual_nodes.answer = whole


@contextmanager
def kept_mapping() -> Iterator[None]:
    """The virtual drive acknowledges another mapping, and keeps its own, which has an entry less each way."""
    write, begin = PdoMap.write, PdoMap.__init__

    def ignore(self: PdoMap, index: int, subindex: int, content: bytes) -> None:
        if not 0x1600 <= index < 0x1C20:
            write(self, index, subindex, content)

    def shortened(self: PdoMap, *words: Any) -> None:
        begin(self, *words)
        for first in (0x1600, 0x1A00):
            self._counts[first] -= 1

    PdoMap.write, PdoMap.__init__ = ignore, shortened  # type: ignore[method-assign]
    try:
        yield
    finally:
        PdoMap.write, PdoMap.__init__ = write, begin  # type: ignore[method-assign]


def said(asked: Any) -> str:
    """The sentence of the FeeddriveError that it raises; empty if it raises none."""
    try:
        asked()
    except FeeddriveError as error:
        return f"{type(error).__name__}: {error!s}"
    return ""


SCENARIOS = (
    exact,
    led,
    torque,
    speed,
    losses,
    faults,
    limits,
    pressed,
    wrong,
    refusals,
    silence,
    kinds,
    second,
    hearing,
    mapping,
    held_up,
    pulled,
    foreign,
    plan,
    frozen,
    deceived,
)
ANSWER = "ANSWER "  # before the result on its line

if __name__ == "__main__":
    known = {scenario.__name__: scenario for scenario in SCENARIOS}
    for name in map(str.strip, sys.stdin):
        try:
            result = known[name]("ethercat")
        except Exception:  # one that fails is the failure of its own test only
            result = {"failed": traceback.format_exc()}
        sys.stdout.write(f"\n{ANSWER}{json.dumps(result)}\n")
        sys.stdout.flush()

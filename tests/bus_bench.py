"""A bench for tests of drives on a bus: a virtual drive in a thread, and a veth pair in a network namespace of its own.

EtherCAT needs the right to make namespaces and raw sockets; `on_a_veth_pair` skips loudly where it is missing.
"""

from __future__ import annotations

import atexit
import json
import multiprocessing
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import pytest

from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.bus.client import DriveClient, transport_of
from feeddrive.bus.drive_file import BusDrive, BusLimits, DriveScaling
from feeddrive.bus.faults import InjectedFault
from feeddrive.bus.virtual_drive import DrivenAxis, Firmware
from feeddrive.bus.virtual_nodes import serve_canopen, serve_ethercat
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.guard import Guard
from feeddrive.loop.loop import Loop

T = 1e-3
PAIR = "ip link add veth0 type veth peer name veth1 && ip link set veth0 up && ip link set veth1 up && "
LIMITS = BusLimits(
    travel=0.2,
    velocity=0.5,
    force=2000.0,
    following_error=2e-3,
    quick_stop_deceleration=5.0,
    largest_mass=120.0,
    breakaway_force=5.0,
)
SCALING = DriveScaling(counts_per_turn=1e6, lead=0.01, gear=1.0, rated_torque=1.0)  # 10 nm; 0.628 N


def bench_loop(**guard: float) -> Loop:
    """A two-mass axis without encoders' faults, so that only the bus rounds."""
    law = CascadePPI(Kv=30.0, Kp=2e4, Tn=0.02)
    plant = TwoMass(mass_motor=60.0, mass_load=40.0, stiffness=2e7, damping=2e3, viscous_motor=300.0)
    return Loop(
        sample_time=T, control=Control(law=law, force_limit=1500.0, guard=Guard(**guard)), axis=Axis(plant=plant)
    )


def drive(bus: str, **changes: Any) -> BusDrive:
    """Its description, as a drive file would have it."""
    given: dict[str, Any] = {
        "station": 1 if bus == "ethercat" else 5,
        "cycle_time": T,
        "scaling": SCALING,
        "limits": LIMITS,
    }
    return BusDrive(bus=bus, **{**given, **changes})


_buses = iter(range(10_000))


class Bench:
    """A virtual drive that is served beside the test: its interface for a master, and a look at its firmware."""

    def __init__(self, interface: str, ask: Callable[[str], Any], first: Any, few: Any) -> None:
        self.interface, self._ask, self._first, self._few = interface, ask, first, few

    def __getattr__(self, name: str) -> Any:
        """`state`, `cycles`, `place` (m) and `error_code` of the firmware."""
        return self._ask(name)

    def lose(self, after: int, few: int) -> None:
        """Swallow the answers of so many cycles."""
        self._few.value = few
        self._first.value = self.cycles + after


def _look(firmware: Firmware, name: str) -> Any:
    return {
        "state": lambda: firmware.state.name,
        "cycles": lambda: firmware.cycles,
        "place": lambda: firmware.axis.last.position,
        "error_code": lambda: firmware.values["error_code"],
    }[name]()


@contextmanager
def powered(
    bus: str,
    loop: Loop | None = None,
    watchdog: float | None = None,
    stations: int = 1,
    faults: Sequence[InjectedFault] = (),
) -> Iterator[Bench]:
    """A virtual drive: CANopen in a thread; EtherCAT in a process, since its master keeps other threads waiting.

    Of several stations the last is looked at.
    """
    first, few = multiprocessing.Value("l", 1 << 40), multiprocessing.Value("l", 0)

    def lose(cycle: int) -> bool:
        return 0 <= cycle - first.value < few.value

    firmware = Firmware(DrivenAxis(loop or bench_loop()), SCALING, T, faults)
    if bus == "canopen":
        ready, stop = threading.Event(), threading.Event()
        interface = f"virtual:bench{next(_buses)}"
        options = {"ready": ready.set, "stopped": stop.is_set, "lose": lose}
        thread = threading.Thread(target=serve_canopen, args=(firmware, interface, 5), kwargs=options)
        thread.start()
        try:
            assert ready.wait(20), "the virtual drive did not come up"
            yield Bench(interface, lambda name: _look(firmware, name), first, few)
        finally:
            stop.set()
            thread.join(10)
        return
    here, there = multiprocessing.Pipe()
    more = [Firmware(DrivenAxis(loop or bench_loop()), SCALING, T) for _ in range(1, stations)]
    context = multiprocessing.get_context("fork")
    process = context.Process(target=_serve, args=([firmware, *more], there, lose, watchdog))
    process.start()

    def ask(name: str) -> Any:
        here.send(name)
        assert here.poll(10), "the virtual drive does not answer"
        return here.recv()

    try:
        assert here.poll(20), "the virtual drive did not come up"
        here.recv()
        yield Bench("veth0", ask, first, few)
    finally:
        here.send("stop")
        process.join(10)


def _serve(firmwares: list[Firmware], line: Any, lose: Callable[[int], bool], watchdog: float | None) -> None:
    """In a process of its own: frames, and questions about the firmware between them."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    stopped = threading.Event()

    def answer() -> None:
        while (name := line.recv()) != "stop":
            line.send(_look(firmwares[-1], name))
        stopped.set()

    threading.Thread(target=answer, daemon=True).start()
    serve_ethercat(
        firmwares, "veth1", ready=lambda: line.send("ready"), stopped=stopped.is_set, watchdog=watchdog, lose=lose
    )


def client(described: BusDrive, interface: str) -> DriveClient:
    """Without a clock: a cycle begins when the last one is answered."""
    return DriveClient(transport_of(described, interface, None), described, paced=False)


def with_law(loop: Loop, law: Any) -> Loop:
    return replace(loop, control=replace(loop.control, law=law))


@lru_cache(maxsize=1)
def why_no_veth_pair() -> str:
    """Why this machine cannot make one; empty if it can."""
    for program, package in (("unshare", "util-linux"), ("ip", "iproute2")):
        if shutil.which(program) is None:
            return f"needs {program}: apt install {package}"
    probe = PAIR + f"exec {sys.executable} -c 'import socket; socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0)'"
    done = subprocess.run(["unshare", "-rn", "sh", "-c", probe], capture_output=True, text=True, timeout=60)
    said = (done.stderr.strip().splitlines() or ["no reason given"])[-1]
    return "" if done.returncode == 0 else f"needs network namespaces and CAP_NET_RAW in them (unshare -rn): {said}"


def in_a_namespace(*command: str, timeout: float = 120.0, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """A command with a veth pair (veth0, veth1) that nobody else sees. Skips the test where that is not permitted."""
    why = why_no_veth_pair()
    if why:
        pytest.skip(f"EtherCAT over a veth pair {why}")
    whole = ["unshare", "-rn", "sh", "-c", PAIR + 'exec "$@"', "sh", *command]
    return subprocess.run(whole, capture_output=True, text=True, timeout=timeout, cwd=cwd)


@lru_cache(maxsize=1)
def _namespace() -> subprocess.Popen[str]:
    """`bus_scenarios` as a program with a veth pair of its own, until the tests end."""
    program = [sys.executable, str(Path(__file__).with_name("bus_scenarios.py"))]
    whole = ["unshare", "-rn", "sh", "-c", PAIR + 'exec "$@"', "sh", *program]
    made = subprocess.Popen(whole, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    atexit.register(made.kill)
    return made


@lru_cache
def _over_ethercat(name: str) -> dict[str, Any]:
    bench = _namespace()
    assert bench.stdin is not None
    assert bench.stdout is not None
    too_long = threading.Timer(120.0, bench.kill)
    too_long.start()
    try:
        bench.stdin.write(f"{name}\n")
        bench.stdin.flush()
        for line in bench.stdout:
            if line.startswith("ANSWER "):
                return json.loads(line.removeprefix("ANSWER "))
    finally:
        too_long.cancel()
    raise AssertionError(f"the scenario {name} gave no answer")


def over_ethercat(name: str) -> dict[str, Any]:
    """What a scenario of `bus_scenarios` gave over EtherCAT; each runs once, when it is first asked for."""
    if why_no_veth_pair():
        pytest.skip(f"EtherCAT over a veth pair {why_no_veth_pair()}")
    found = _over_ethercat(name)
    assert "failed" not in found, found["failed"]
    return found

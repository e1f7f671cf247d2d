"""Faults injected into virtual drives in virtual time: when they can be observed at the earliest, and what follows.

`observable` is computed from what was sent and answered and from the true motion, by rules of its own; the monitor is
not asked.  Times are frames of the master.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Generator
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from bus_bench import LIMITS, SCALING, T, bench_loop, drive
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.bus import client as bus_client
from feeddrive.bus.cia402 import MODES, PowerState, state_of
from feeddrive.bus.client import DriveClient, set_watchdog
from feeddrive.bus.faults import InjectedFault
from feeddrive.bus.play import Profile, play_profile
from feeddrive.bus.virtual_bus import VirtualCANopen, VirtualEtherCAT
from feeddrive.bus.virtual_drive import DrivenAxis, Firmware
from feeddrive.language.progress import Progress
from feeddrive.loop.loop import Loop
from simulated_drives import due_by_force

BUSES = {"ethercat": VirtualEtherCAT, "canopen": VirtualCANopen}
LOST_FRAMES, LAG = 3, 1
ALLOWED = LOST_FRAMES + 2  # cycles from the first moment at which a fault can be observed to the command
MASS, VISCOUS, PEAK = 100.0, 300.0, 1500.0  # kg, N s/m, N: of the bench, whose only friction is viscous
LIMITED = replace(LIMITS, acceleration=20.0)  # m/s2; the peak force gives 15
E, A, COUNT = LIMITED.following_error, LIMITED.quick_stop_deceleration, SCALING.metre
REACTION = (LAG + ALLOWED) * T  # s
HELD = 100  # cycles for which the last target is held
RESPONSE = 10  # cycles that a force may take to act
SIZES = {
    "jump": lambda rng: float(rng.choice([-1.0, 1.0]) * 10 ** rng.uniform(-3.6, -2.0)),  # 0.25 to 10 mm
    "gear": lambda rng: float(rng.choice([0.1, 0.3, 0.5, 1.7, 2.0, 4.0, -1.0])),
    "late_status": lambda rng: float(rng.integers(1, 60)),
    "lost": lambda rng: float(rng.integers(LOST_FRAMES, 40)),
    "repeat": lambda rng: float(rng.integers(8, 1000)),
    "drive_fault": lambda rng: float(rng.choice([0x2310, 0x3220, 0x4310, 0x7305, 0x8611])),
    "brake_slip": lambda rng: float(rng.uniform(100.0, 300.0)),
    "second_master": lambda rng: float(rng.integers(0, 3)),
}
KINDS = (
    "freeze",
    "encoder_loss",
    "jump",
    "sign",
    "gear",
    "zero_error",
    "late_status",
    "lost",
    "repeat",
    "drive_fault",
    "brake_slip",
    "second_master",
    "cable",
    "travel",
    "person",
    "stop_input",
)


class Trial(NamedTuple):
    """What came of a fault: frames of its first observable moment and of the command of the reaction; travel, m.

    moved  true travel after the first observable moment; of `travel` and `brake_slip` from where the bound counts
    bound  what is stated for the class
    """

    kind: str
    observed: int | None
    commanded: int | None
    moved: float
    bound: float
    reason: str

    @property
    def delay(self) -> int:
        """Cycles from the observable moment to the command."""
        assert self.observed is not None
        assert self.commanded is not None
        return self.commanded - self.observed


class Press(Progress):
    """A person who stops the motion in a row of it."""

    def __init__(self, frames: Any, at: int) -> None:
        super().__init__()
        self._frames, self._at = frames, at

    @property
    def cancelled(self) -> bool:
        return self._frames() > self._at


def motion(rng: np.random.Generator, mode: str) -> Profile:
    """A move, with an excitation or without; in cst pulses of force there and back."""
    rows = int(rng.integers(400, 700))
    t = np.arange(rows) * T
    s = t / t[-1]
    zero = np.zeros(rows)
    window = np.sin(np.pi * s) ** 2
    wave = window * np.sin(2 * np.pi * (5.0 + rng.uniform(10.0, 40.0) * s) * t)
    if mode == "cst":
        long = int(rng.integers(80, 160))
        pulses = np.abs(np.sin(np.pi * np.arange(rows) / long)) * np.where(
            (np.arange(rows) // long + 1) // 2 % 2, -1, 1
        )
        force = rng.uniform(30.0, 120.0) * rng.choice([-1.0, 1.0]) * pulses * (np.arange(rows) < rows // long * long)
        return Profile("pulses", "", T, "N", force, zero, zero)
    distance = rng.choice([-1.0, 1.0]) * rng.uniform(0.008, 0.04)
    position = distance * s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
    unit = "m/s" if mode == "csv" and rng.random() < 0.5 else "N"
    peak = rng.choice([0.0, 1.0]) * (0.02 if unit == "m/s" else rng.uniform(20.0, 150.0))
    return Profile("move", "", T, unit, peak * wave, position, np.gradient(position, T))


@contextmanager
def virtual_time(transport: Any) -> Generator[None]:
    """The clock of the client is that of the bus."""
    clock, bus_client.time = bus_client.time, SimpleNamespace(monotonic=lambda: transport.cycles * T)  # type: ignore[attr-defined]
    try:
        yield
    finally:
        bus_client.time = clock  # type: ignore[attr-defined]


class Frames:
    """What was sent and answered in each frame, and the true position after it."""

    def __init__(self, transport: Any, lost: Container[int], each: Callable[[Firmware], None]) -> None:
        self.transport, self._lost, self._each = transport, lost, each
        self.sent: list[dict[str, int]] = []
        self.answers: list[dict[str, int] | None] = []
        self.true: list[float] = []
        self._take = transport.take
        transport.take = self.take

    def take(self, timeout: float) -> bytes | None:
        line = self.transport
        answered = self._take(timeout)
        if len(self.sent) in self._lost:
            answered = None
        self.sent.append(line._sent.unpack(line._content) if line._sent.size else {})
        self.answers.append(None if answered is None else line._told.unpack(answered))
        self.true.append(line.firmware.axis.last.position)
        self._each(line.firmware)
        return answered


def played(
    mode: str,
    bus: str,
    profile: Profile,
    fault: tuple[InjectedFault, ...] = (),
    *,
    press: int | None = None,
    loop: Loop | None = None,
    lost: Container[int] = (),
    each: Callable[[Firmware], None] = lambda _: None,
    stop_input: int | None = None,
    **limits: Any,
) -> tuple[Any, Frames, Firmware, int]:
    """A motion on a virtual drive: what `play` gives, all frames, the firmware, and the frame of its first row."""
    firmware = Firmware(DrivenAxis(loop or bench_loop()), SCALING, T, fault)
    transport = BUSES[bus](firmware)
    frames = Frames(transport, lost, each)
    described = drive(
        bus, mode=mode, limits=replace(LIMITED, **limits), lost_frames=LOST_FRAMES, lag=LAG, stop_input=stop_input
    )
    with virtual_time(transport), DriveClient(transport, described, paced=False) as client:
        set_watchdog(transport, described)
        client.enable()
        first = len(frames.true) + LAG + 1
        progress = None if press is None else Press(lambda: len(frames.true), first + press)
        found = play_profile(client, profile, progress=progress)
    ended = len(frames.true)
    # until friction has brought it to rest, or nearly
    while len(frames.true) < ended + 3000 and moving(frames.true):
        firmware.cycle()
        frames.true.append(firmware.axis.last.position)
    return found, frames, firmware, first


def moving(true: list[float]) -> bool:
    """Faster than 0.2 mm/s, of which friction leaves less than a tenth of a millimetre."""
    return abs(true[-1] - true[-2]) > 2e-4 * T


def errors(mode: str, frames: Frames, first: int, last: int) -> np.ndarray:
    """The following error as answered: r - x in csp, in csv a sum that forgets in a tenth of a second, m."""
    error, gathered, asked = np.full(last, np.nan), 0.0, 0.0
    before = (frames.answers[first - 1] or {}).get("position", 0)
    for f in range(first, last):
        sent, answer = frames.sent[f - 1], frames.answers[f]
        if mode == "csp":
            acting = sent["target_position"] if f > first else before
            if answer is not None:
                error[f] = COUNT * (acting - answer["position"])
            continue
        asked += COUNT * (sent["target_velocity"] if f > first else 0) * T
        if answer is not None:
            gathered = 0.99 * gathered + asked - COUNT * (answer["position"] - before)
            before, asked, error[f] = answer["position"], 0.0, gathered
    return error


def observable(
    kind: str, mode: str, frames: Frames, begins: int, first: int, profile: Profile, size: float
) -> int | None:
    """The first frame whose answer shows the fault, by the rule of its class; None if none does."""
    last = min(first + profile.excitation.size + HELD, len(frames.answers))
    answers, true = frames.answers, np.array(frames.true)

    def earliest(condition: Any, frm: int = begins) -> int | None:
        return next((f for f in range(frm, last) if condition(f)), None)

    def left(f: int) -> bool:
        answer = answers[f]
        return answer is not None and state_of(answer["statusword"]) is not PowerState.ENABLED

    off = earliest(left)
    if kind in ("jump", "lost", "cable"):
        return begins
    if kind == "stop_input":
        # a contact that opens
        return earliest(lambda f: answers[f] is not None and not answers[f]["digital_inputs"] >> 16 & 1)  # type: ignore[index]
    if kind == "drive_fault" or (kind == "second_master" and size == 0.0):
        return off
    if kind == "second_master" and size == 2.0:
        return earliest(lambda f: answers[f] is not None and answers[f]["mode_display"] != MODES[mode])  # type: ignore[index]
    kept = COUNT * (answers[begins] or {"position": 0})["position"]
    if kind in ("freeze", "repeat"):
        return earliest(lambda f: abs(true[f - 1] - kept) >= 2.0 * COUNT)
    if kind == "encoder_loss" and mode != "cst":
        asked = 0.0
        lead = COUNT * frames.sent[begins - 1]["target_position"] - kept
        for f in range(begins, last):
            sent = frames.sent[f - 1]
            asked += COUNT * sent["target_velocity"] * T
            now = COUNT * sent["target_position"] - kept
            before = max(0.0, math.copysign(lead, lead * now))
            if abs(asked) > 0.75 * E if mode == "csv" else abs(now) > before + 0.75 * (E - before):
                return f
        return None
    if mode != "cst":
        error = np.abs(errors(mode, frames, first, last))
        share = 0.75 if kind == "sign" else 1.0
        found = [off, earliest(lambda f: error[f] > share * E)]
        if kind == "gear":
            found.append(contradiction(answers, begins, first, last))
        return min((f for f in found if f is not None), default=None)
    if kind == "gear":
        return contradiction(answers, begins, first, last)
    found = [off, fallen(frames, begins, first, last)]
    if kind in ("encoder_loss", "zero_error", "late_status"):
        force = np.concatenate([profile.excitation, np.zeros(HELD)])
        assert LIMITED.largest_mass is not None
        assert LIMITED.breakaway_force is not None
        stands = np.flatnonzero(np.abs(np.diff(true[begins - 1 :])) > 0.0)
        still = begins if kind == "encoder_loss" else begins + (int(stands[-1]) + 1 if stands.size else 0)
        due = due_by_force(force, LIMITED.largest_mass, LIMITED.breakaway_force, 3.0 * COUNT, T, still - first)
        found.append(None if due is None else first + due + LAG)
    return min((f for f in found if f is not None), default=None)


def contradiction(answers: list[Any], begins: int, first: int, last: int) -> int | None:
    """The first frame in which velocity and positions of a tenth of a second differ by 10 ms of the speed and 3/4 E."""
    gap = speed = 0.0
    for f in range(first + 1, last):
        if answers[f] is None or answers[f - 1] is None:
            continue
        velocity, moved = COUNT * answers[f]["velocity"], COUNT * (answers[f]["position"] - answers[f - 1]["position"])
        gap, speed = 0.99 * gap + velocity * T - moved, max(0.99 * speed, abs(velocity), abs(moved) / T)
        if f >= begins and abs(gap) > RESPONSE * T * speed + 0.75 * E:
            return f
    return None


def fallen(frames: Frames, begins: int, first: int, last: int) -> int | None:
    """The first frame in which the axis goes against a force beyond breakaway, 10 counts in 10 ms faster than before.

    The force acted for 20 ms before, as it may act 10 ms late, and a velocity may be reported as late.
    """
    assert LIMITED.breakaway_force is not None
    shown = [COUNT * (answer or {"position": 0})["position"] for answer in frames.answers]
    lasted, sign, most = 0, 0.0, -math.inf
    for f in range(first + RESPONSE, last):
        force = SCALING.newton * frames.sent[f - 1]["target_torque"]
        beyond = abs(force) > LIMITED.breakaway_force
        lasted = lasted + 1 if beyond and math.copysign(1.0, force) == sign else 0
        if not lasted:
            sign, most = math.copysign(1.0, force), -math.inf
        speed = sign * (shown[f] - shown[f - RESPONSE]) / (RESPONSE * T)
        if lasted > 2 * RESPONSE:
            most = max(most, min(0.0, speed))
            if f >= begins and most - speed > 10.0 * COUNT / (RESPONSE * T):
                return f
    return None


def trial(kind: str, mode: str, bus: str, seed: int) -> Trial:
    """One fault, drawn by seed, at a moment in motion."""
    rng = np.random.default_rng([seed, KINDS.index(kind), MODES[mode], len(bus)])
    profile = motion(rng, mode)
    rows = profile.excitation.size
    at = int(rng.integers(rows // 4, rows * 6 // 10))
    if kind == "zero_error" and mode == "cst":
        at = int(rng.integers(1, 20))  # at rest: an axis that coasts obeys no force, and none can be missed
    size = SIZES[kind](rng) if kind in SIZES else 0.0
    if kind == "second_master" and size == 1.0 and mode == "cst":
        size = 0.0  # half the force in every other cycle: nothing of it can be told from friction
    if kind == "person":
        found, frames, firmware, first = played(mode, bus, profile, press=at)
        began = first + at
    elif kind == "travel":
        reach = max_travel(mode, bus, profile)
        found, frames, firmware, first = played(mode, bus, profile, travel=float(rng.uniform(0.3, 0.7)) * reach)
        began = None
    else:
        at = 1 if kind == "brake_slip" else at
        fault = InjectedFault(kind, at + LAG + 2, size)
        bit = 16 if kind == "stop_input" else None
        found, frames, firmware, first = played(mode, bus, profile, (fault,), stop_input=bit)
        began = firmware.faults.began
        assert began is not None, found.aborted
    return judged(kind, mode, found, frames, first, began, profile, size, firmware)


def max_travel(mode: str, bus: str, profile: Profile) -> float:
    found, frames, _, first = played(mode, bus, profile)
    assert found.aborted is None, found.aborted
    rows = profile.excitation.size
    return float(np.max(np.abs(np.array(frames.true[first : first + rows]) - frames.true[first - 1])))


def judged(
    kind: str,
    mode: str,
    found: Any,
    frames: Frames,
    first: int,
    began: int | None,
    profile: Profile,
    size: float,
    firmware: Firmware,
) -> Trial:
    """What came of a motion with a fault that began in a cycle; the next frame answers it."""
    true = np.array(frames.true)
    speed = np.abs(np.diff(true, prepend=true[0])) / T
    stopped = None
    if found.aborted is not None and kind != "brake_slip":
        # the log ends `lag` rows before the frame in which the motion was given up
        stopped = first + len(found.log) + LAG - 1
    reason = found.aborted or ""
    if kind == "brake_slip":
        off = next(f for f in range(first, len(true)) if frames.sent[f]["controlword"] == 0)
        begin = true[off + LAG + 1]
        seen = next((f for f in range(off, len(true)) if abs(true[f - 1] - begin) > E), None)
        again = next((f for f in range(off, len(true)) if frames.sent[f]["controlword"] != 0), None)
        held = slice(off, again if again is None else again + 1000)
        return Trial(kind, seen, again, float(np.max(np.abs(true[held] - begin))), 2.0 * E, reason)
    if kind == "travel":
        far = np.abs(true[first:] - true[first - 1])
        limit = float(reason.partition("exceeded limits.travel = ")[2].split(" ")[0] or "nan")
        v = max_speed(speed, first, len(true))
        return Trial(kind, stopped, None if stopped is None else stopped + 1, float(far.max()), limit, reason + f" {v}")
    assert began is not None
    if kind == "person":
        observed: int | None = began
    else:
        observed = observable(kind, mode, frames, began, first, profile, size)
    if stopped is not None and began <= stopped < (observed or stopped + 1):
        observed = stopped  # by a sign that the rule of the class does not know
    if observed is None:
        return Trial(kind, None, None if stopped is None else stopped + 1, 0.0, 0.0, reason)
    moved = float(np.max(np.abs(true[observed:] - true[observed - 1])))
    commanded = None if stopped is None else stopped + 1
    reacted = min(observed + ALLOWED + LAG, len(true) - 1)
    v = max_speed(speed, observed - 1, reacted + 1)
    coast = v * MASS / VISCOUS + v * REACTION
    pushed = abs(SCALING.newton * frames.sent[observed - 1]["target_torque"]) if mode == "cst" else 0.0
    late = 0.1 + REACTION  # s for which a force goes on that nobody changes
    racing = v + pushed / MASS * late
    bound = {
        # against a force, wrong positions may pass for a runaway
        "gear": coast + E if mode == "cst" else v * REACTION + 0.5 * v * v / A + E,
        "sign": coast,
        "zero_error": coast,
        "late_status": coast,
        "drive_fault": coast,
        "second_master": coast,
        "cable": racing * late + 0.5 * racing * racing / A + E,
    }.get(kind, v * REACTION + 0.5 * v * v / A + E)
    return Trial(kind, observed, commanded, moved, bound, reason)


def trials(kind: str, mode: str, bus: str, number: int) -> tuple[list[Trial], int]:
    """So many faults of a class that can be observed, from seed 0 on; and how many others were drawn meanwhile."""
    found, hidden, seed = list[Trial](), 0, 0
    while len(found) < number and hidden < 10 * number:
        made = trial(kind, mode, bus, seed)
        if made.observed is None and made.commanded is None:
            hidden += 1
        else:
            found.append(made)
        seed += 1
    return found, hidden


def wrong(made: Trial, mode: str, bus: str) -> str:
    """What is wrong with the reaction to a fault; empty: nothing."""
    where = f"{made.kind}, {mode}, {bus}: {made.reason}: "
    if made.observed is None:
        return f"{where}stopped before the fault could be observed"
    if made.commanded is None:
        return f"{where}observable in frame {made.observed}, and not stopped"
    if made.delay > ALLOWED:
        return f"{where}observable in frame {made.observed}, stopped in {made.commanded}"
    if not made.moved <= made.bound:
        return f"{where}moved by {1e3 * made.moved:.3f} mm, more than {1e3 * made.bound:.3f} mm"
    return ""


def healthy(mode: str, bus: str, seed: int) -> str:
    """Why a healthy drive of a drawn axis and motion was stopped; empty: it was not. One frame in 50 is lost."""
    rng = np.random.default_rng([seed, 77, MODES[mode], len(bus)])
    mass = rng.uniform(50.0, 115.0)
    plant = TwoMass(
        mass_motor=0.6 * mass,
        mass_load=0.4 * mass,
        stiffness=10 ** rng.uniform(6.8, 7.6),
        damping=2e3,
        viscous_motor=rng.uniform(50.0, 600.0),
    )
    law = CascadePPI(Kv=rng.uniform(15.0, 40.0), Kp=mass * rng.uniform(120.0, 220.0), Tn=rng.uniform(0.015, 0.04))
    loop = bench_loop()
    loop = replace(loop, axis=replace(loop.axis, plant=plant), control=replace(loop.control, law=law))
    lost = set(rng.choice(700, 14, replace=False).tolist())
    found, *_ = played(mode, bus, motion(rng, mode), loop=loop, lost={k for k in lost if k - 1 not in lost})
    return found.aborted or ""


def max_speed(speed: np.ndarray, begin: int, end: int) -> float:
    return float(np.max(speed[max(0, begin) : end]))

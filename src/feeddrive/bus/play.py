"""Playback of motion profiles on drives within limits, with logs of the responses; any fault causes a quick stop."""

from __future__ import annotations

import contextlib
import math
import os
import select
import signal
import sys
import threading
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import FrameType
from typing import NamedTuple

import numpy as np

from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.blocks.signals import Setpoint
from feeddrive.bus.cia402 import CSP, PowerState
from feeddrive.bus.client import ActualValues, DriveClient
from feeddrive.bus.control_in_master import ControlInMaster
from feeddrive.bus.drive_file import BusDrive
from feeddrive.bus.monitor import (
    BRAKE,
    OFF,
    QUICK_STOP,
    RESTING,
    Cycle,
    Monitor,
    Skew,
    begin_braking,
    brake,
    braking_distance,
    reaction_to,
)
from feeddrive.bus.monitor import State as MonitorState
from feeddrive.bus.transport import Lateness, urgent
from feeddrive.bus.watch import Answer, Fault, Target
from feeddrive.files.log import Log
from feeddrive.files.read_log import read_log
from feeddrive.language.errors import BusError, ParameterError
from feeddrive.language.progress import ENDINGS, Progress
from feeddrive.language.quantity import Quantity, Units
from feeddrive.language.text import Text, joined, resolve
from feeddrive.language.units import turning

_UNITS = {"csp": ("N", "m"), "csv": ("N", "m/s"), "cst": ("N",)}
# of an axis that turns, as the motion of a linear one
_STRAIGHT = {turning(unit): unit for unit in ("N", "m", "m/s")}
_NEGLIGIBLE = 0.02  # of the peak, at the ends of a profile
_ABOVE_NYQUIST = 1e-3  # share of the excitation's power that may be lost between the cycles


@dataclass(frozen=True, eq=False)
class Profile:
    """A motion sampled at the bus cycle: excitation in `unit` (N, m or m/s), set position relative to its start (m).

    `velocity` in m/s is the set velocity of the file, or else the central difference of the set position.  Under a
    control in the master `beside` is a force that is added beside the excitation, N.
    """

    name: str
    sha256: str
    sample_time: float
    unit: str
    excitation: np.ndarray
    set_position: np.ndarray
    velocity: np.ndarray
    beside: np.ndarray | None = None

    @property
    def added_force(self) -> np.ndarray:
        """The force that is added to that of a control, N, shape (n,)."""
        force = self.excitation if self.unit == "N" else np.zeros(self.excitation.size)
        return force if self.beside is None else force + self.beside

    def reference(self, start: float = 0.0) -> Recorded:
        """Return the motion from a position (m) on as a control follows it, here and in `simulate`: the acceleration is
        the central difference of the set position.
        """
        acceleration = np.diff(np.pad(self.set_position, 1, mode="edge"), 2) / self.sample_time**2
        return Recorded(
            position=start + self.set_position,
            velocity=self.velocity,
            acceleration=acceleration,
            sample_time=self.sample_time,
        )


def read_profile(path: str | Path, drive: BusDrive, *, share: float = 1.0, ramp: float = 0.0) -> Profile:
    """Read a profile at the cycle time of the drive: time, and any of excitation, set position and set velocity.

    share  fraction of the excitation amplitude that is played
    ramp   fade-in and fade-out time of the excitation, s; 0 for a profile that already has ramps

    Raises LogError for a file that is not a log, ParameterError for a profile that does not suit the drive, its mode or
    its limits.
    """
    log = read_log(path)
    if drive.rotary:
        log = replace(log, units={name: _STRAIGHT.get(unit, unit) for name, unit in log.units.items()})
    known = {"excitation", "set_position"} & set(log.channels)
    if not known:
        raise ParameterError(
            f"{path}: has neither a column 'excitation' nor 'set_position' but {', '.join(log.channels)}; "
            "feeddrive excite writes one"
        )
    zero = np.zeros(len(log))
    excitation = share * log.channels.get("excitation", zero)
    set_position = log.channels.get("set_position", zero)
    set_position = set_position - set_position[0]
    unit = log.units.get("excitation", "") or "N"
    if unit not in _UNITS[drive.mode]:
        raise ParameterError(
            f"{path}: excitation in '{unit}' cannot be played in mode {drive.mode}, which takes "
            f"{' or '.join(_UNITS[drive.mode])}"
        )
    step, T = log.sample_time, drive.cycle_time
    every = _every(path, step, T, "design it for a machine file with that sample time")
    _check_band(str(path), excitation, every, step)
    excitation, set_position = excitation[::every].copy(), set_position[::every].copy()
    if "set_velocity" in log.channels:
        velocity = log["set_velocity"][::every].copy()
    else:
        velocity = np.gradient(set_position, T) if set_position.size > 1 else np.zeros(set_position.size)
    profile = Profile(
        str(path), str(log.provenance["sha256"]), T, unit, _ramped(excitation, round(ramp / T)), set_position, velocity
    )
    check_profile(profile, drive)
    return profile


def _every(path: str | Path, step: float, T: float, advice: str) -> int:
    """Return the number of file rows per bus cycle. Raise ParameterError if it is not a whole number."""
    every = round(T / step)
    # both are decimals in seconds, so that their quotient is whole up to rounding only
    if every < 1 or abs(T / step - every) > 1e-6 * every:
        raise ParameterError(
            f"{path}: has a row every {Quantity(step, 's'):6 us}, of which cycle_time = {Quantity(T, 's'):6 us} of the "
            f"drive file is no whole multiple: {advice}"
        )
    return every


def read_plan_profiles(setpoints: Path, drives: Mapping[str, BusDrive]) -> list[Profile]:
    """Read the motion of each axis of a plan, relative to its start, for the drive of that axis.

    setpoints  the file `setpoints.parquet` written by `feeddrive plan`
    drives     drives by the name of their axis

    Raises ParameterError for a moving axis without a drive, a drive without an axis, a mode other than csp, different
    cycle times, and a motion that exceeds the limits of a drive; LogError for a file that is not a plan.
    """
    log = read_log(setpoints)
    axes = [name.removesuffix(".set_position") for name in log.channels if name.endswith(".set_position")]
    if not axes:
        raise ParameterError(f"{setpoints}: has no columns such as x.set_position, as feeddrive plan writes them")
    moving = [axis for axis in axes if np.ptp(log[f"{axis}.set_position"]) > 0.0]
    missing, strange = (
        [axis_name for axis_name in moving if axis_name not in drives],
        [axis_name for axis_name in drives if axis_name not in axes],
    )
    if missing or strange:
        raise ParameterError(
            f"{setpoints}: moves the axes {', '.join(moving) or '(none)'}, and there "
            + (f"is no drive for {', '.join(missing)}" if missing else f"is no axis {', '.join(strange)}")
            + ': give one drive file (--drive) for each axis, with its name as  axis = "x"'
        )
    for axis in moving:
        turns = log.units.get(f"{axis}.set_position") == "rad"
        if turns != drives[axis].rotary:
            raise ParameterError(
                f"{setpoints}: axis {axis} {'turns' if turns else 'does not turn'}, and its drive file says otherwise: "
                f"{'write' if turns else 'leave out'} rotary = true"
            )
    times = {drive.cycle_time for drive in drives.values()}
    modes = {drive.mode for drive in drives.values()}
    if len(times) > 1 or modes != {"csp"}:
        listed = joined(", ", (Text(f"{Quantity(axis_name, 's'):6 us}") for axis_name in sorted(times)))
        raise ParameterError(
            f"the drives of a plan have one cycle_time and the mode csp, not {listed} and {', '.join(sorted(modes))}"
        )
    profiles: list[Profile] = []
    for axis, drive in drives.items():
        every = _every(setpoints, log.sample_time, drive.cycle_time, "plan it with --sample-time")
        # up to the last row, also if no cycle falls on it: the motion must end where the plan ends
        rows = np.minimum(np.arange(0, len(log) + every - 1, every), len(log) - 1)
        position, velocity = log[f"{axis}.set_position"][rows], log[f"{axis}.set_velocity"][rows]
        rest = np.zeros(len(position))
        sha = str(log.provenance["sha256"])
        profile = Profile(
            f"{setpoints}, axis {axis}", sha, drive.cycle_time, "N", rest, position - position[0], velocity
        )
        check_profile(profile, drive)
        profiles.append(profile)
    return profiles


def _check_band(path: str, excitation: np.ndarray, every: int, step: float) -> None:
    """Raise ParameterError for excitation above the Nyquist frequency of the bus cycle, since it would be aliased."""
    if every == 1 or not np.any(excitation):
        return
    power = np.abs(np.fft.rfft(excitation)) ** 2
    above = np.fft.rfftfreq(excitation.size, step) > 0.5 / (every * step)
    lost = float(power[above].sum() / power.sum())
    if lost > _ABOVE_NYQUIST:
        raise ParameterError(
            f"{path}: {Quantity(lost, 'share'):2} of the power of the excitation lie above "
            f"{Quantity(0.5 / (every * step), 'Hz'):6}, half the rate of the bus: end the band below it, or shorten "
            "cycle_time"
        )


def _ramped(excitation: np.ndarray, rows: int) -> np.ndarray:
    if rows < 1:
        return excitation
    swell = 0.5 - 0.5 * np.cos(np.pi * np.arange(rows) / rows)
    window = np.ones(excitation.size)
    rows = min(rows, excitation.size // 2)
    window[:rows] *= swell[:rows]
    window[excitation.size - rows :] *= swell[:rows][::-1]
    return window * excitation


def check_profile(profile: Profile, drive: BusDrive, *, follows: bool = False) -> None:
    """Raise ParameterError if a profile begins or ends with a step, or exceeds the limits of the drive.

    follows  a control in the master follows the set position
    """
    limits = drive.limits
    for name, row in (("excitation", profile.excitation), ("speed of the set position", profile.velocity)):
        peak = float(np.max(np.abs(row), initial=0.0))
        ends = max(abs(float(row[0])), abs(float(row[-1]))) if row.size else 0.0
        if peak > 0.0 and ends > _NEGLIGIBLE * peak:
            advice = "give --ramp" if name == "excitation" else "let it start and end at rest"
            raise ParameterError(
                f"{profile.name}: the {name} begins or ends with {Quantity(ends / peak, 'share'):3} of its peak, a "
                f"jump for the axis: {advice}"
            )
    if drive.mode == "cst" and not follows and np.any(profile.set_position):
        raise ParameterError(
            f"{profile.name}: holds a motion (set_position), and nothing follows it in mode cst: use csp, or design "
            "the excitation with --offset-velocity 0"
        )
    planned = [
        ("travel", _reach(profile, drive), limits.travel, "m"),
        ("velocity", float(np.max(np.abs(profile.velocity), initial=0.0)), limits.velocity, "m/s"),
        ("force", float(np.max(np.abs(profile.added_force), initial=0.0)), limits.force, "N"),
    ]
    for key, got, most, unit in planned:
        if got > most:
            raise ParameterError(
                f"{profile.name}: plans {key} = {Quantity(got, unit):SI}, and limits.{key} of the drive file is "
                f"{Quantity(most, unit):SI}: raise the limit if the machine allows it, or design a smaller excitation"
            )


def _reach(profile: Profile, drive: BusDrive) -> float:
    """Return the farthest position from the start at which the planned motion could come to rest, m.

    The monitor ends a motion that could no longer be braked within limits.travel.
    """
    position = profile.set_position + (profile.excitation if profile.unit == "m" else 0.0)
    if position.size < 2 or not np.any(position):
        return 0.0
    velocity = np.gradient(position, profile.sample_time)
    rows = zip(position.tolist(), velocity.tolist(), strict=True)
    return max(way * x + braking_distance(drive, max(0.0, way * v)) for x, v in rows for way in (-1.0, 1.0))


# the position trails its target: switched off at once, the axis would stop short of it
_SETTLING = 0.1  # s that the last target is held before the drive is switched off
_HELD = 1.0  # s for which a virtual drive without a clock is held, as nobody waits for it


@dataclass(frozen=True)
class Played:
    """The log of a motion, the reason for an early end (None if completed), lost frames, lateness, and remarks.

    cause  of an early end: "person" (at an input of the drive as well), "guard" (of a control on trial), "bus", or the
           kind of the monitor's fault
    """

    log: Log
    aborted: str | None
    lost: int
    lateness: Lateness | None
    remarks: tuple[str, ...]
    cause: str = ""


@contextlib.contextmanager
def _keyboard() -> Generator[Callable[[], int]]:
    """Yield a function that returns how often a key was pressed at the terminal, or found it gone.

    Without a terminal in the foreground it is always 0.
    """
    line = _terminal()
    if line is None:
        yield lambda: 0
        return
    import termios
    import tty

    pressed = 0

    def count() -> int:
        nonlocal pressed
        if select.select([line], [], [], 0.0)[0]:
            pressed += 1
            # a terminal that is gone can be read without end
            with contextlib.suppress(OSError):
                os.read(line, 1024)
        return pressed

    before = termios.tcgetattr(line)
    # single keys, without Enter; Ctrl-C stays a signal.  What was typed before the motion is no stop
    tty.setcbreak(line, termios.TCSAFLUSH)
    try:
        yield count
    finally:
        with contextlib.suppress(termios.error):
            termios.tcsetattr(line, termios.TCSAFLUSH, before)


def _terminal() -> int | None:
    """Return the file number of the standard input if it is a terminal with this process in its foreground."""
    try:
        line = sys.stdin.fileno()
        # the terminal stops a process in the background that changes its settings
        return line if os.tcgetpgrp(line) == os.getpgrp() else None
    # Windows has no such function
    except (OSError, ValueError, AttributeError):
        return None


@contextlib.contextmanager
def interruption(*, keys: bool = False) -> Generator[Callable[[], int]]:
    """Replace the handlers of Ctrl-C, termination and hangup by a count, so that no signal interrupts a cycle.

    Yields a function that returns how many signals have arrived or, with `keys`, how often a key was pressed as well.
    """
    # Python permits signal handlers in the main thread only; others are stopped by `progress`
    if threading.current_thread() is not threading.main_thread():
        yield lambda: 0
        return
    arrived = 0

    def press(_number: int, _frame: FrameType | None) -> None:
        nonlocal arrived
        arrived += 1

    before = {number: signal.signal(number, press) for number in ENDINGS}
    try:
        with _keyboard() if keys else contextlib.nullcontext(lambda: 0) as typed:
            yield lambda: arrived + typed()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def play_profile(
    client: DriveClient,
    profile: Profile,
    *,
    name: str = "",
    progress: Progress | None = None,
    control: ControlInMaster | None = None,
) -> Played:
    """Switch a drive on, play a profile, hold the last position, and switch off; see `play_together`."""
    return play_together([client], [profile], names=[name], progress=progress, controls=[control])[0]


def play_together(
    clients: Sequence[DriveClient],
    profiles: Sequence[Profile],
    *,
    names: Sequence[str] = (),
    progress: Progress | None = None,
    controls: Sequence[ControlInMaster | None] = (),
    skew: Skew | None = None,
) -> list[Played]:
    """Switch the drives on, play a profile on each in lockstep, hold the last position, and switch them off.

    A drive with one of `controls` is led by it in the master, in the mode of its drive file: `cst` or `csv`.  In `cst`
    the drive first holds the axis by its own control, where it has `csp`: the force that this takes is what the control
    begins with.  The excitation is added to the force of the control, and the sum stays within limits.force.  Row k of
    such a log holds the readings that the control used in cycle k, and what it commanded there (`commanded`, N): from a
    row's command to the readings that show it pass `lag` + 1 cycles.  In `csv` the log has the velocity that was
    commanded, too (`commanded_velocity`, m/s), to which an excitation in m/s is added; `commanded` is the force offset.

    The motions are relative to the positions at the start.  Row k of a log holds the setpoints sent in cycle k and the
    drive's response to them, `lag` cycles later.  `progress` is updated ten times a second; cancelling it ends the
    motion like Ctrl-C, with a controlled stop.  An abort of one drive stops all of them, with a quick stop in the same
    cycle.
    Raises BusError if a drive cannot be switched on; the reason for any later abort is in `Played.aborted`.
    ParameterError is raised for a control that does not suit its drive.
    """
    first, drive = clients[0], clients[0].drive
    for client, profile in zip(clients, profiles, strict=True):
        # for every drive, before the first one is switched on
        if np.any(profile.excitation):
            client.excites(profile.unit)
        if profile.beside is not None:
            client.excites("N")
    # before that as well: it takes longer than a cycle
    leading = [
        None if control is None else _led_by(control, client, profile)
        for control, client, profile in zip(controls or [None] * len(clients), clients, profiles, strict=True)
    ]
    lag, count = max(client.drive.lag for client in clients), max(profile.excitation.size for profile in profiles)
    report_every = max(1, round(0.1 / drive.cycle_time))
    aborted, cause, reactions = "", "", [BRAKE] * len(clients)
    _refuse_stopped(clients)
    with interruption(keys=True) as interrupted, urgent(first.pace.cycle_time is not None) as permitted:

        def stopped() -> bool:
            return interrupted() > 0 or (progress is not None and progress.cancelled)

        held = _switch_on(first, clients, leading, stopped)
        kept = [_Rows(client, led, force) for client, led, force in zip(clients, leading, held, strict=True)]
        first.pace.begin()
        lost_before = [client.lost for client in clients]
        for k in range(count + max(lag, round(_SETTLING / drive.cycle_time))):
            sent: list[_Sent] = []
            try:
                sent += [rows.target(profile, k) for rows, profile in zip(kept, profiles, strict=True)]
                first.cycle()
            except BusError as error:
                aborted, cause = str(error).removeprefix(f"{first.transport.where}: "), "bus"
                reactions = [QUICK_STOP] * len(clients)
                break
            by_hand = stopped()
            stop = "stopped by hand" if by_hand else ""
            faults = [
                rows.watched(row, first.pace.elapsed, stop or row.tripped) for rows, row in zip(kept, sent, strict=True)
            ]
            if skew is not None and not any(faults):
                faults[0] = skew.fault(kept[0].last.position, kept[1].last.position, k)
            if any(faults):
                aborted, reactions = _trouble(kept, faults), _reactions(faults)
                kinds = [fault.kind for fault in faults if fault is not None]
                if by_hand or "stop_input" in kinds:
                    cause = "person"
                else:
                    cause = "guard" if any(row.tripped for row in sent) else kinds[0]
                break
            if progress is not None and k % report_every == 0:
                # unlike `step`, it never raises: a cancel must end the motion by a quick stop
                progress.show_step(profiles[0].name, min(k, count), count, "")
        # before the stop, whose cycles are no part of the motion
        lateness = first.pace.lateness()
        if aborted and all(reaction == BRAKE for reaction in reactions):
            aborted += _braked(first, kept, must_rest=True)
            reactions = [rows.reaction for rows in kept]
        elif not aborted and any(rows.still_moves() for rows in kept):
            # a profile of forces may end with a speed, and friction may be all that brakes the rest of it
            aborted = _braked(first, kept, must_rest=False).removeprefix("; ")
            reactions = [rows.reaction for rows in kept]
        if not aborted:
            try:
                _hand_back(first, kept, stopped)
            except BusError as error:
                aborted, cause = str(error).removeprefix(f"{first.transport.where}: "), "bus"
                reactions = [QUICK_STOP] * len(clients)
        for client, reaction in zip(clients, reactions, strict=True):
            if aborted and reaction != BRAKE:
                # requested for all first: the next cycle carries every stop, while `_halt` waits drive by drive
                client.prepare_stop(force_off=reaction == OFF)
        ends = [
            _shown(f"{aborted}{_halt(client, reaction)}" if aborted else "", client.drive)
            for client, reaction in zip(clients, reactions, strict=True)
        ]
        for client in () if aborted else clients:
            client.prepare_disable()
        for client in () if aborted else clients:
            client.disable()
        # not after another stop: its axis may coast, and a drive that runs away must not be switched on again
        rested = all(reaction == BRAKE for reaction in reactions) and not any(rows.still_moves() for rows in kept)
        slips = _slips(first, clients) if rested else ""
        if slips:
            held_so = _hold(first, clients, slips, interrupted, progress)
            ends = [
                _shown(f"{end}; {slips}{held_so}" if end else f"{slips}{held_so}", client.drive)
                for end, client in zip(ends, clients, strict=True)
            ]
    played: list[Played] = []
    for rows, profile, before, end, name in zip(
        kept, profiles, lost_before, ends, names or [""] * len(clients), strict=True
    ):
        lost = rows.client.lost - before
        led = [] if rows.leading is None else rows.leading.control.remarks
        remarks = [*rows.client.remarks, *led, *_remarks(rows.client, lost, permitted, lateness)]
        log = rows.log(
            profile,
            name or profile.name,
            min(profile.excitation.size, rows.complete),
            end,
            lateness,
        )
        played.append(Played(log, end or None, lost, lateness, tuple(remarks), cause))
    return played


def _refuse_stopped(clients: Sequence[DriveClient]) -> None:
    """Raise BusError for a drive whose stop input asks for a stop before it is switched on."""
    for client in clients:
        drive = client.drive
        if drive.asks_stop(client.inputs):
            raise BusError(
                f"{client.transport.where}: its stop input asks for a stop (bit {drive.stop_input} of 0x60FD is "
                f"{drive.stop_level}): release the stop, or look at the wiring, stop_input and stop_level"
            )


def _shown(end: str, drive: BusDrive) -> str:
    """Return the reason of an end in the units of the axis."""
    return resolve(end, Units(rotary=True)) if drive.rotary else Text(end)


def _remarks(client: DriveClient, lost: int, permitted: bool, lateness: Lateness | None) -> Iterator[str]:
    """Yield remarks on lost frames, missing real-time priority and late cycles."""
    if lost:
        yield (
            f"{lost} frames were lost; their rows hold the last values (column lost): repeat the measurement if there "
            "are many."
        )
    if client.pace.cycle_time is not None and not permitted:
        yield "Real-time priority was not permitted: run as root, or give CAP_SYS_NICE, for fewer late cycles."
    if lateness is not None and lateness.missed:
        yield (
            Text(
                f"{lateness.missed} cycles began more than a cycle late, {Quantity(lateness.slipped, 's'):3} in all; "
                "the motion paused for as long, and the times of the log do not show it."
            )
        )


def _trouble(kept: Sequence[_Rows], faults: Sequence[Fault | None]) -> str:
    """Return the reason to abort: that of the first drive with a fault."""
    rows, fault = next((rows, fault) for rows, fault in zip(kept, faults, strict=True) if fault is not None)
    # the client knows the bus, and the words for the error code of the drive
    reason = (rows.client.trouble() if fault.kind in ("frames", "drive") else "") or fault.message
    of_all = len(kept) == 1 or fault.kind in ("stop", "skew")
    return reason if of_all else Text(f"{rows.client.transport.where}: {reason}")


def _reactions(faults: Sequence[Fault | None]) -> list[str]:
    """Return the reaction of each drive: all brake on their ramps, or all stop, some of them with the force off."""
    wanted = [reaction_to(fault) if fault is not None else BRAKE for fault in faults]
    if all(reaction == BRAKE for reaction in wanted):
        return wanted
    return [OFF if reaction == OFF else QUICK_STOP for reaction in wanted]


def _braked(first: DriveClient, kept: Sequence[_Rows], *, must_rest: bool) -> str:
    """Brake all drives on ramps of their own deceleration, and hold their ends; return what went wrong as a clause.

    A drive that does not brake, leaves operation or, with `must_rest`, still moves at the end makes the quick stop of
    all drives the next reaction.
    """
    for rows in kept:
        rows.begin_braking()
    while any(rows.braking.left > 0 for rows in kept):
        try:
            for rows in kept:
                rows.brake()
            first.cycle()
        except BusError as error:
            reason: str = str(error).removeprefix(f"{first.transport.where}: ")
            faults: list[Fault | None] = []
        else:
            faults = [rows.braked(first.pace.elapsed) for rows in kept]
            reason = _trouble(kept, faults) if any(faults) else ""
        if reason:
            wanted = _reactions(faults) if faults else []
            for rows, reaction in zip(kept, wanted or [QUICK_STOP] * len(kept), strict=True):
                rows.reaction = reaction
            return Text(f"; while it braked, {reason}")
    moving = [rows.still_moves() for rows in kept]
    if not must_rest or not any(moving):
        return ""
    for rows in kept:
        rows.reaction = QUICK_STOP
    return Text(f"; {_trouble(kept, moving)}")


def listened(client: DriveClient, seconds: float) -> Played:
    """Log a switched-off drive, whose axis is at rest or pushed by hand. Raises BusError if it stops answering."""
    assert client.told is not None
    rows, zero = _Rows(client), np.zeros(0)
    count = max(1, round(seconds / client.drive.cycle_time))
    client.pace.begin()
    with interruption() as interrupted:
        for _ in range(count + client.drive.lag):
            rows.add(0.0, 0.0, client.cycle())
            if client.lost_in_row >= client.drive.lost_frames:
                raise BusError(f"{client.transport.where}: {client.trouble()}")
            if interrupted() > 0:
                break
    profile = Profile("", "", client.drive.cycle_time, "N", zero, zero, zero)
    lateness = client.pace.lateness()
    log = rows.log(profile, "listened", max(1, len(rows.told) - client.drive.lag), "", lateness)
    kept = {name: values for name, values in log.channels.items() if name not in ("set_position", "excitation")}
    log = replace(log, channels=kept, units={name: log.units[name] for name in kept})
    return Played(log, None, client.lost, lateness, tuple(client.remarks))


_HOLDS = 0.5  # s for which a drive holds its axis before a control takes over: brakes open in less
_WEIGHED = 0.1  # s at the end of it, over which the force is averaged
_CHANGES = 20  # cycles within which a drive changes its mode


class _Leading(NamedTuple):
    """A control in the master, the setpoints of its motion, relative to where it begins, and the forces added, N."""

    control: ControlInMaster
    setpoints: Sequence[Sequence[float]]
    forces: Sequence[float]


def _led_by(control: ControlInMaster, client: DriveClient, profile: Profile) -> _Leading:
    """Return a control that is started for a drive that is still switched off. Raises ParameterError."""
    drive, told = client.drive, client.told
    assert told is not None
    T = drive.cycle_time
    for what, time in ((profile.name, profile.sample_time), ("the control", control.sample_time)):
        if not math.isclose(time, T):
            raise ParameterError(
                f"{what}: runs every {Quantity(time, 's'):6 us}, and the drive every {Quantity(T, 's'):6 us} "
                "(cycle_time): a control in the master runs with the drive"
            )
    if control.mode != drive.mode:
        raise ParameterError(f"{client.transport.where}: runs in {drive.mode}, and its control in {control.mode}")
    if control.encoders == 2 and told.second is None:
        raise ParameterError(
            f"{client.transport.where}: has no second position (0x60E4), and the control reads two encoders"
        )
    if control.needs_torque_offset:
        client.excites("N")
    control.begin(told.position, told.second)
    rows = profile.reference().at(np.arange(profile.set_position.size) * profile.sample_time)
    return _Leading(control, np.column_stack([*rows]).tolist(), profile.added_force.tolist())


def _switch_on(
    first: DriveClient,
    clients: Sequence[DriveClient],
    leading: Sequence[_Leading | None],
    stopped: Callable[[], bool],
) -> list[float]:
    """Switch the drives on, those that a control leads in cst in the end; return the forces that hold the axes, N.

    Such a drive holds its axis in csp first, with its brake open, and then changes to cst under the force that this
    took: in operation or, if it does not do that, by switching off and on again with that force as the first target.
    """
    torque = [c for c, led in zip(clients, leading, strict=True) if led is not None and led.control.mode == "cst"]
    weighed = [client for client in torque if client.can(CSP)]
    for client in clients:
        if client in weighed:
            client.hold()
        elif client in torque:
            client.remarks.append("The drive has no csp: the control begins without the force that holds the axis.")
            client.ask_torque(0.0)
            client.enable()
        else:
            client.held = 0.0
            client.enable()
    brakes = max(float(client.drive.brake_time) for client in clients)
    if not weighed:
        for _ in range(round(brakes / first.drive.cycle_time)):
            first.cycle()
        return [client.held for client in clients]
    forces = _weigh(first, weighed, max(_HOLDS, brakes + 2.0 * _WEIGHED), stopped)
    for client, force in zip(weighed, forces, strict=True):
        client.ask_torque(force)
    for _ in range(_CHANGES):
        first.cycle()
        if all(client.shows for client in weighed):
            break
    for client in weighed:
        if client.shows:
            continue
        if len(clients) > 1:
            raise BusError(
                f"{client.transport.where}: does not change from csp to cst in operation, and the other axes cannot "
                "wait for it: play it alone"
            )
        client.disable()
        client.enable()
    return [client.held for client in clients]


def _hand_back(first: DriveClient, kept: Sequence[_Rows], stopped: Callable[[], bool]) -> None:
    """Let drives that a control led in cst hold their axes by themselves, before they are switched off.

    A drive waits for its brake if its axis stands by its own readings, which the noise of a control may hide.  It takes
    the axis over in csp, under the force that held it, or in a quick stop where it does not change its mode in
    operation.  Raises BusError.
    """
    clients = [rows.client for rows in kept]
    torque = [rows for rows in kept if rows.leading is not None and rows.leading.control.mode == "cst"]
    held = [rows for rows in torque if rows.client.can(CSP)]
    if not held:
        return
    last = max(1, round(_WEIGHED / first.drive.cycle_time))
    for rows in held:
        force = rows.commanded[-last:]
        rows.client.ask_hold(sum(force) / len(force))
    for _ in range(_CHANGES):
        first.cycle()
        if all(rows.client.shows for rows in held):
            break
    if all(rows.client.shows for rows in held):
        _weigh(first, [rows.client for rows in held], _HOLDS, stopped)
        return
    for client in clients:
        client.prepare_stop()
    for client in clients:
        client.stop()


def _weigh(
    first: DriveClient, clients: Sequence[DriveClient], seconds: float, stopped: Callable[[], bool]
) -> list[float]:
    """Let drives hold their axes by themselves; return the mean force of each at the end, N. Raises BusError."""
    cycles, last = (round(time / first.drive.cycle_time) for time in (seconds, _WEIGHED))
    watching: list[tuple[Monitor, MonitorState, Target]] = []
    for client in clients:
        told = client.told
        assert told is not None
        monitor = Monitor(replace(client.drive, mode="csp"))
        watching.append((monitor, monitor.begin(answer_of(client, told)), Target(told.position, 0.0, 0.0)))
    forces: list[list[float]] = [[] for _ in clients]
    for _ in range(cycles):
        first.cycle()
        for i, (client, (monitor, state, target)) in enumerate(zip(clients, watching, strict=True)):
            answer = None if client.answer is None else answer_of(client, client.answer)
            cycle = Cycle(
                target, answer, client.statusword, client.mode_shown, first.pace.elapsed, inputs=client.inputs
            )
            after, fault = monitor.step(state, cycle)
            watching[i] = monitor, after, target
            if fault is not None:
                raise BusError(
                    Text(f"{client.transport.where}: while the drive held its axis by itself, {fault.message}")
                )
            assert client.told is not None
            forces[i].append(client.told.force)
        # the motion then ends in its first cycle
        if stopped():
            break
    return [sum(row[-last:]) / len(row[-last:]) for row in forces]


def answer_of(client: DriveClient, told: ActualValues) -> Answer:
    """Return the actual values as the monitor takes them."""
    velocity = told.velocity if client.reports_velocity else None
    return Answer(told.position, velocity, told.force, told.following_error, told.second)


class _Sent(NamedTuple):
    """The setpoints of a cycle: the target sent to the drive, the excitation of the profile, the set position, and what
    tripped the guard of a control in the master.
    """

    target: Target
    excitation: float
    set_position: float
    tripped: str = ""


def _target(client: DriveClient, profile: Profile, i: int, start: float, *, rest: bool) -> _Sent:
    """Command row i, or hold the last position, and return the setpoints.

    The logged excitation is that of the profile before rounding to increments, so that its spectral lines are the
    designed ones; the force that acted is in the force column.
    """
    excitation = 0.0 if rest else float(profile.excitation[i])
    position, velocity = start + float(profile.set_position[i]), 0.0 if rest else float(profile.velocity[i])
    force = 0.0
    if profile.unit == "N":
        force = excitation
        position = client.command(position=position, velocity=velocity, force=force)
    elif profile.unit == "m":
        position = client.command(position=position + excitation, velocity=velocity)
    else:
        velocity += excitation
        client.command(velocity=velocity)
    return _Sent(Target(position, velocity, force), excitation, position)


def _slips(first: DriveClient, clients: Sequence[DriveClient]) -> str:
    """Watch the axes for a moment with their drives off; return the reason if one of them moves, else ""."""
    off = [client.told.position if client.told is not None else None for client in clients]
    rested = [client.state is PowerState.SWITCH_ON_DISABLED for client in clients]
    for _ in range(round(RESTING / first.drive.cycle_time) if all(rested) else 0):
        first.rest()
        for client, begin in zip(clients, off, strict=True):
            if client.answer is None or begin is None:
                continue
            moved, bound = abs(client.answer.position - begin), client.drive.limits.following_error
            if moved > bound:
                return Text(
                    f"{client.transport.where}: the axis moves by {Quantity(moved, 'm'):SI} with its drive off, more "
                    f"than limits.following_error = {Quantity(bound, 'm'):SI}: its brake slips, or it has none; the "
                    "drive was switched on again to hold it"
                )
    return ""


def _hold(
    first: DriveClient,
    clients: Sequence[DriveClient],
    why: str,
    interrupted: Callable[[], int],
    progress: Progress | None,
) -> str:
    """Switch the drives on again and hold their positions until a person stops it once more, then switch them off.

    Returns what went wrong as a clause, "" if nothing.
    """
    if progress is not None:
        progress.remark(f"- {why}. Support the axis, then stop (Ctrl-C or a key): its force ends with it.")
    # the stop that ended the motion is none of the hold; one that was cancelled can be cancelled no more
    begun, cancelled = interrupted(), progress is not None and progress.cancelled
    waits = first.pace.cycle_time is not None and not cancelled
    cycles = round(_HELD / first.drive.cycle_time)
    try:
        for client in clients:
            client.hold()
        while waits or cycles > 0:
            stopped = interrupted() > begun or (progress is not None and progress.cancelled and not cancelled)
            if stopped or any(client.trouble() for client in clients):
                break
            first.cycle()
            cycles -= 1
    except BusError as error:
        return Text(f"; it could not be held ({error})")
    finally:
        for client in clients:
            client.disable()
    return ""


def _halt(client: DriveClient, reaction: str) -> str:
    """Stop and switch off by a reaction; return the result as a clause to append to a message."""
    try:
        if reaction == QUICK_STOP:
            client.stop()
        elif reaction == OFF:
            client.cut()
        else:
            client.disable()
    except BusError as error:
        return Text(
            f"; the drive could not be stopped over the bus ({error}): its own watchdog must do it, look at the axis"
        )
    state = client.state
    if state in (PowerState.FAULT, PowerState.FAULT_REACTION):
        return "; the drive stops by itself, by its settings: many switch off the force, and friction brakes it"
    words = "unknown" if state is None else state.words
    if reaction == OFF:
        return f"; its force was switched off at once, as no control of it can be trusted, and it is in '{words}'"
    return f"; the axis was stopped and is in '{words}'"


_FORCES, _SPEEDS = ("force", "commanded"), ("velocity_load", "commanded_velocity")  # columns of a log


class _Rows:
    """The recorder of one drive: the sent and received values of each cycle, and the supervision of the drive."""

    def __init__(
        self,
        client: DriveClient,
        leading: _Leading | None = None,
        held: float = 0.0,
    ) -> None:
        assert client.told is not None
        self.client, self.start = client, client.told.position
        self.sent: list[tuple[float, float]] = []  # set position and excitation
        self.told: list[ActualValues] = []
        self.lost: list[float] = []
        self.commanded: list[float] = []  # N, of a control in the master
        self.velocities: list[float] = []  # m/s, of one that commands a velocity
        self._last, self._heard = client.told, True
        self.leading, self._held = leading, held
        if leading is not None:
            leading.control.rest(client.told.position, client.told.second, held)
        self._monitor = Monitor(client.drive, follows=leading is not None and client.drive.mode != "csp")
        self._state = self._monitor.begin(self._answer(client.told))
        rest = Target(self.start, 0.0, 0.0)
        self._targets = (rest, rest)  # the last two
        self.braking = begin_braking(client.drive, rest, rest, 0.0)
        self.reaction = BRAKE

    @property
    def last(self) -> ActualValues:
        """The last actual values."""
        return self._last

    @property
    def complete(self) -> int:
        """The number of cycles whose row is complete."""
        return len(self.sent) if self.leading is not None else max(0, len(self.told) - self.client.drive.lag)

    def target(self, profile: Profile, k: int) -> _Sent:
        """Command the setpoints of cycle k, or hold the last position, and return them."""
        last = profile.excitation.size
        if self.leading is None:
            return _target(self.client, profile, min(k, last - 1), self.start, rest=k >= last)
        return self._led(self.leading, profile, k)

    def _led(self, leading: _Leading, profile: Profile, k: int) -> _Sent:
        """Command what a control in the master makes of the setpoint and the last readings."""
        limits, last = self.client.drive.limits, len(leading.setpoints) - 1
        position, *derivatives = leading.setpoints[min(k, last)]
        if k > last:
            derivatives = [0.0] * len(derivatives)
        excitation = float(profile.excitation[k]) if k <= last else 0.0
        setpoint = Setpoint(self.start + position, *derivatives)
        told = self._last
        # a reading that is held would be a standstill, and the next one a jump
        lost = None if self._heard else math.nan
        load, motor = (told.position, told.second) if lost is None else (lost, lost)
        found = leading.control.step(setpoint, load, motor)
        # what is added to a velocity is a velocity
        added = excitation if profile.unit == "m/s" else 0.0
        pushed = float(leading.forces[k]) if k <= last else 0.0
        force = max(-limits.force, min(limits.force, found.force + pushed))
        velocity = max(-limits.velocity, min(limits.velocity, found.velocity + added))
        self.client.command(velocity=velocity, force=force)
        self.told.append(told)
        self.lost.append(float(not self._heard))
        self.sent.append((setpoint.position, excitation))
        self.commanded.append(force)
        self.velocities.append(velocity)
        # what the answer to this target is compared with is the setpoint of the sample that reads it
        ahead = self.start + leading.setpoints[min(k + self.client.drive.lag + 1, last)][0]
        return _Sent(Target(ahead, velocity, force), excitation, setpoint.position, found.trip)

    def watched(self, sent: _Sent, elapsed: float, stop: str) -> Fault | None:
        """Add the completed cycle; return the fault for which the monitor ends the motion."""
        if self.leading is None:
            self.add(sent.set_position, sent.excitation, self.client.answer)
        else:
            self._last, self._heard = self.client.answer or self._last, self.client.answer is not None
        self._targets = (self._targets[1], sent.target)
        return self._checked(sent.target, elapsed, stop)

    def _checked(self, target: Target, elapsed: float, stop: str, *, braking: bool = False) -> Fault | None:
        client = self.client
        answer = None if client.answer is None else self._answer(client.answer)
        cycle = Cycle(target, answer, client.statusword, client.mode_shown, elapsed, stop, client.inputs)
        self._state, fault = self._monitor.step(self._state, cycle, braking=braking)
        return fault

    def begin_braking(self) -> None:
        """Prepare the braking profile from the last targets, or in cst from the measured velocity."""
        before, last = self._targets
        self.braking = begin_braking(self.client.drive, last, before, self._last.velocity, self._held)
        self._state = self._monitor.brakes(self._state)

    def brake(self) -> None:
        """Command the next setpoints of the braking profile."""
        self.braking = brake(self.client.drive, self.braking, self._last.velocity)
        self.client.command(position=self.braking.position, velocity=self.braking.velocity, force=self.braking.force)

    def braked(self, elapsed: float) -> Fault | None:
        """Check a completed cycle of the braking; return the fault for which the drive is stopped otherwise."""
        self._last = self.client.answer or self._last
        target = Target(self.braking.position, self.braking.velocity, self.braking.force)
        return self._checked(target, elapsed, "", braking=True)

    def still_moves(self) -> Fault | None:
        """Return a fault if the axis still moves at the end of its braking ramp."""
        return self._monitor.rests(self._state)

    def _answer(self, told: ActualValues) -> Answer:
        return answer_of(self.client, told)

    def add(self, set_position: float, excitation: float, told: ActualValues | None) -> None:
        """Add one cycle; for a lost frame the last values are repeated."""
        self._last = told or self._last
        self.sent.append((set_position, excitation))
        self.told.append(self._last)
        self.lost.append(float(told is None))

    def log(self, profile: Profile, name: str, rows: int, aborted: str, lateness: Lateness | None) -> Log:
        """Return the log of the first `rows` cycles, each with the answer received `lag` cycles later, or with the one
        that a control in the master used.
        """
        client, lag = self.client, 0 if self.leading is not None else self.client.drive.lag
        told, T = self.told[lag : lag + rows], client.drive.cycle_time
        channels: dict[str, list[float]] = {
            "set_position": [position for position, _ in self.sent[:rows]],
            "excitation": [excitation for _, excitation in self.sent[:rows]],
            "force": [actual.force for actual in told],
            "reading_load": [actual.position for actual in told],
        }
        for column, field in (("reading_motor", "second"), ("velocity_load", "velocity")):
            values = [getattr(actual, field) for actual in told]
            if None not in values:
                channels[column] = values
        if self.leading is not None:
            channels["commanded"] = self.commanded[:rows]
        if self.leading is not None and client.drive.mode == "csv":
            channels["commanded_velocity"] = self.velocities[:rows]
        if any(self.lost):
            channels["lost"] = self.lost[lag : lag + rows]
        known = {"excitation": profile.unit, "lost": "", **dict.fromkeys(_FORCES, "N"), **dict.fromkeys(_SPEEDS, "m/s")}
        units = {key: known.get(key, "m") for key in channels}
        if client.drive.rotary:
            units = {key: turning(unit) for key, unit in units.items()}
        provenance: dict[str, object] = {
            "written_by": "feeddrive play",
            "bus": client.transport.where,
            "mode": client.drive.mode,
            "drive": dict(client.identity),
            "profile": profile.name,
            "profile_sha256": profile.sha256,
            "increment_m": client.scaling.metre,
            "newton_per_mille": client.scaling.newton,
            "lag": lag,
            "began_at_m": self.start,
        }
        if aborted:
            provenance["aborted"] = str(aborted)
        constants = {"lost_frames": float(sum(self.lost))}
        if lateness is not None:
            constants |= {f"late_{key}_s": value for key, value in lateness._asdict().items() if key != "missed"}
            constants["late_cycles"] = float(lateness.missed)
        return Log(
            name=name,
            time=np.arange(rows) * T,
            channels={key: np.array(values) for key, values in channels.items()},
            units=units,
            sample_time=T,
            constants=constants,
            provenance=provenance,
        )

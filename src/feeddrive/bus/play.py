"""Plays a profile on a drive within limits and logs the response; on any fault quick stop and switch off."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from types import FrameType
from typing import NamedTuple

import numpy as np

from feeddrive.bus.cia402 import PowerState
from feeddrive.bus.client import ActualValues, DriveClient
from feeddrive.bus.pace import Lateness, urgent
from feeddrive.bus.profile import Profile
from feeddrive.bus.watch import Answer, Target, Watch
from feeddrive.files.log import Log
from feeddrive.language.errors import BusError
from feeddrive.language.progress import ENDINGS, Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text

_SETTLING = 0.1  # s that the last target is held before the drive is switched off


@dataclass(frozen=True)
class Played:
    """The log of a motion, why it ended early (None: it did not), lost frames, lateness of the cycles, and remarks."""

    log: Log
    aborted: str | None
    lost: int
    lateness: Lateness | None
    remarks: tuple[str, ...]


@contextlib.contextmanager
def interruption() -> Generator[Callable[[], bool]]:
    """Turn Ctrl-C into a flag that is read once a cycle, so that it interrupts no cycle; a second
    one changes nothing.
    """
    pressed = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield pressed.is_set
        return

    def press(_number: int, _frame: FrameType | None) -> None:
        pressed.set()

    before = {number: signal.signal(number, press) for number in ENDINGS}
    try:
        yield pressed.is_set
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def play_profile(client: DriveClient, profile: Profile, *, name: str = "", progress: Progress | None = None) -> Played:
    """Switch the drive on, play a profile, hold, and switch off; see `play_together`."""
    return play_together([client], [profile], names=[name], progress=progress)[0]


def play_together(
    clients: Sequence[DriveClient],
    profiles: Sequence[Profile],
    *,
    names: Sequence[str] = (),
    progress: Progress | None = None,
) -> list[Played]:
    """Switch the drives on, play a profile on each in the same cycles, hold, switch them off.

    The motions are relative to where the axes stand.  Row k of a log holds what was sent in cycle k and the drive's
    answer to it, `lag` cycles later.  `progress` is updated ten times a second; cancelling it ends the motion as
    Ctrl-C does, with a controlled stop.  What ends the motion of one ends that of all: they get the quick stop in the
    same cycle.  Raises BusError if a drive cannot be switched on; the reason of any later end is in `Played.aborted`.
    """
    first, drive = clients[0], clients[0].drive
    for client, profile in zip(clients, profiles, strict=True):
        if np.any(profile.excitation):
            client.excites(profile.unit)
    for client in clients:
        client.enable()
    kept = [_Rows(client) for client in clients]
    lag, count = max(client.drive.lag for client in clients), max(profile.excitation.size for profile in profiles)
    report_every = max(1, round(0.1 / drive.cycle_time))
    aborted = ""
    first.pace.begin()
    lost_before = [client.lost for client in clients]
    with interruption() as interrupted, urgent(first.pace.cycle_time is not None) as permitted:
        held = count + max(lag, round(_SETTLING / drive.cycle_time))
        for k in range(held):
            sent: list[_Sent] = []
            try:
                for rows, profile in zip(kept, profiles, strict=True):
                    last = profile.excitation.size
                    sent.append(_target(rows.client, profile, min(k, last - 1), rows.start, rest=k >= last))
                first.cycle()
            except BusError as error:
                aborted = str(error).removeprefix(f"{first.transport.where}: ")
                break
            seen = [rows.watched(profile, first.pace.slips) for rows, profile in zip(kept, sent, strict=True)]
            by_hand = interrupted() or (progress is not None and progress.cancelled)
            aborted = "stopped by hand" if by_hand else _trouble(kept, seen)
            if aborted:
                break
            if progress is not None and k % report_every == 0:
                progress.show_step(profiles[0].name, min(k, count), count, "")  # never raises, so that no cycle breaks
        lateness = first.pace.lateness()
        if aborted:
            for client in clients:
                client.prepare_stop()
        ends = [Text(f"{aborted}{_halt(client)}" if aborted else "") for client in clients]
        for client in () if aborted else clients:
            client.disable()
    played: list[Played] = []
    for rows, profile, before, end, name in zip(
        kept, profiles, lost_before, ends, names or [""] * len(clients), strict=True
    ):
        lost = rows.client.lost - before
        remarks = [*rows.client.remarks, *_remarks(rows.client, lost, permitted, lateness)]
        log = rows.log(
            profile,
            name or profile.name,
            min(profile.excitation.size, max(0, len(rows.told) - rows.client.drive.lag)),
            end,
            lateness,
        )
        played.append(Played(log, end or None, lost, lateness, tuple(remarks)))
    return played


def _remarks(client: DriveClient, lost: int, permitted: bool, lateness: Lateness | None) -> Iterator[str]:
    """Yield remarks on the validity of a motion."""
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


def _trouble(kept: Sequence[_Rows], seen: Sequence[str]) -> str:
    """Return why the motion ends: the first drive that no longer follows, or that its watch stops; empty if there is
    none.
    """
    for rows, fault in zip(kept, seen, strict=True):
        reason = rows.client.trouble() or fault
        if reason:
            return reason if len(kept) == 1 else Text(f"{rows.client.transport.where}: {reason}")
    return ""


def listened(client: DriveClient, seconds: float) -> Played:
    """Log the drive while it is switched off, at rest or moved by hand. Raises BusError if it stops answering."""
    assert client.told is not None
    rows, zero = _Rows(client), np.zeros(0)
    count = max(1, round(seconds / client.drive.cycle_time))
    client.pace.begin()
    with interruption() as interrupted:
        for _ in range(count + client.drive.lag):
            rows.add(0.0, 0.0, client.cycle())
            if client.lost_in_row >= client.drive.lost_frames:
                raise BusError(f"{client.transport.where}: {client.trouble()}")
            if interrupted():
                break
    profile = Profile("", "", client.drive.cycle_time, "N", zero, zero, zero)
    lateness = client.pace.lateness()
    log = rows.log(profile, "listened", max(1, len(rows.told) - client.drive.lag), "", lateness)
    kept = {name: values for name, values in log.channels.items() if name not in ("set_position", "excitation")}
    log = replace(log, channels=kept, units={name: log.units[name] for name in kept})
    return Played(log, None, client.lost, lateness, tuple(client.remarks))


class _Sent(NamedTuple):
    """The setpoints of a cycle: the target as sent to the drive, and the excitation of the profile."""

    target: Target
    excitation: float


def _target(client: DriveClient, profile: Profile, i: int, start: float, *, rest: bool) -> _Sent:
    """Command row i, or hold the last position.

    The logged excitation is that of the profile, before it is rounded to increments, so that its lines are the
    designed ones; the force that acted is in the column of the force.
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
    return _Sent(Target(position, velocity, force), excitation)


def _halt(client: DriveClient) -> str:
    """Quick stop and switch off; return the result as the end of a sentence."""
    try:
        client.stop()
    except BusError as error:
        return Text(
            f"; the drive could not be stopped over the bus ({error}): its own watchdog must do it, look at the axis"
        )
    state = client.state
    if state in (PowerState.FAULT, PowerState.FAULT_REACTION):
        return "; the drive stops by itself, by its settings: many switch off the force, and friction brakes it"
    return f"; the axis was stopped and is in '{'unknown' if state is None else state.words}'"


class _Rows:
    """Sent and received values, cycle by cycle."""

    def __init__(self, client: DriveClient) -> None:
        assert client.told is not None
        self.client, self.start = client, client.told.position
        self.sent: list[tuple[float, float]] = []  # set position and excitation
        self.told: list[ActualValues] = []
        self.lost: list[float] = []
        self._last = client.told
        self._watch = Watch(client.drive)
        self._state = self._watch.begin(self._answer(client.told))

    def watched(self, sent: _Sent, late: bool) -> str:
        """Add the finished cycle; return why its watch ends the motion, empty if it does not."""
        told = self.client.answer
        self.add(sent.target.position, sent.excitation, told)
        answer = None if told is None else self._answer(told)
        self._state, fault = self._watch.step(self._state, sent.target, answer, late=late)
        return "" if fault is None else fault.message

    def _answer(self, told: ActualValues) -> Answer:
        velocity = told.velocity if self.client.reports_velocity else None
        return Answer(told.position, velocity, told.force, told.following_error, told.second)

    def add(self, set_position: float, excitation: float, told: ActualValues | None) -> None:
        """Add one cycle; a lost one holds the last values."""
        self._last = told or self._last
        self.sent.append((set_position, excitation))
        self.told.append(self._last)
        self.lost.append(float(told is None))

    def log(self, profile: Profile, name: str, rows: int, aborted: str, lateness: Lateness | None) -> Log:
        """Return the log of the first rows, each with the answer `lag` cycles later."""
        client, lag = self.client, self.client.drive.lag
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
        if any(self.lost):
            channels["lost"] = self.lost[lag : lag + rows]
        units = {"set_position": "m", "excitation": profile.unit, "force": "N", "velocity_load": "m/s", "lost": ""}
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
            units={key: units.get(key, "m") for key in channels},
            sample_time=T,
            constants=constants,
            provenance=provenance,
        )

"""A gantry: two drives on one beam, moved in lockstep, and its two motions, each seen as an axis of its own.

    x1, x2   positions of the two sides;  s1, s2  their shares of the whole force, s1 + s2 = 1
    common   x = s1 x1 + s2 x2,    F = f1 + f2
    skew     d = x1 - x2,          u = f1/s1 - f2/s2

With shares in the ratio of the masses on both sides, m1 = s1 M and m2 = s2 M, and a beam of stiffness k,

    M x'' = F        M d'' = u - k/(s1 s2) d

are decoupled, and a control C of the whole axis, split to  f1 = s1 C(x1), f2 = s2 C(x2),  acts on either alone:
F = C(x), u = C(d).  The skew is so the same axis under the same control at another operating point.
Source: own; modal coordinates of two masses on a spring.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple, Self, TypeVar

import numpy as np

from feeddrive.bus.client import driven_together
from feeddrive.bus.drive_file import BusLimits
from feeddrive.bus.ethercat import Segment
from feeddrive.bus.live import BusAxis
from feeddrive.bus.monitor import Skew
from feeddrive.bus.play import Played, Profile, play_together
from feeddrive.language import tree
from feeddrive.language.block import Block
from feeddrive.language.errors import BusError, ParameterError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text, joined
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop

Shared = TypeVar("Shared", bound=Block)
SIDES = ("first", "second")
_FORCES = ("N", "kg")  # with which the unit of a number begins that grows with the force


def share_of(block: Shared, share: float) -> Shared:
    """Return a control or an axis all of whose forces, masses and gains to forces are a share of the given ones."""
    changes = {
        path: share * float(value)
        for path, value in tree.parameters(block).items()
        if isinstance(value, int | float) and tree.declaration(block, path).unit.split(" ")[0].split("/")[0] in _FORCES
    }
    return tree.vary(block, changes)


@dataclass(frozen=True)
class Gantry:
    """Two drives of one EtherCAT segment on one beam.

    first, second  the axes of both drives, whose positions count the same way
    shares         of the whole force that each side gets
    free           first minus second position at which the beam is free of force, m; None: where it stands

    Raises ParameterError for drives that cannot be moved in lockstep, and without limits.skew.
    """

    first: BusAxis
    second: BusAxis
    shares: tuple[float, float] = (0.5, 0.5)
    free: float | None = None

    def __post_init__(self) -> None:
        one, other = (side.file for side in self.sides)
        if not one.drive.bus == other.drive.bus == "ethercat" or one.interface != other.interface:
            raise ParameterError(
                f"{one.name} and {other.name}: two drives on one beam are driven in the same frames: give both "
                'bus = "ethercat" and the same interface'
            )
        if one.drive.station == other.drive.station:
            raise ParameterError(f"{one.name} and {other.name}: are both station {one.drive.station} of the segment")
        for name in ("cycle_time", "lag", "rotary"):
            if getattr(one.drive, name) != getattr(other.drive, name):
                raise ParameterError(f"{one.name} and {other.name}: two drives on one beam need the same {name}")
        if one.gains or other.gains or "csv" in (one.drive.mode, other.drive.mode):
            raise ParameterError(
                f"{one.name} and {other.name}: the control of a gantry runs in the master, in cst: leave out [gains], "
                'and mode = "csv"'
            )
        for file in (one, other):
            if file.drive.limits.skew is None:
                raise ParameterError(
                    f"{file.name}: limits.skew is missing: by how much may the two drives of the gantry be apart from "
                    "where the beam is free of force? Look at the play and the strength of its guides"
                )

    @property
    def sides(self) -> tuple[BusAxis, BusAxis]:
        """Both axes."""
        return self.first, self.second

    @property
    def skew(self) -> float:
        """The largest skew, m."""
        return min(float(side.limits.skew or 0.0) for side in self.sides)

    @property
    def common(self) -> GantryMotion:
        """The common motion of both sides as an axis."""
        return GantryMotion(self, "common")

    @property
    def twist(self) -> GantryMotion:
        """The skew as an axis."""
        return GantryMotion(self, "skew")

    def with_sides(self, first: BusAxis, second: BusAxis) -> Self:
        """Return the gantry with other descriptions of its drives."""
        return replace(self, first=first, second=second)

    def profiles(self, common: Profile | None = None, skew: Profile | None = None) -> tuple[Profile, Profile]:
        """Return the profiles of both sides for motions and forces of the whole, of which one may rest."""
        there = [(name, each) for name, each in (("common", common), ("skew", skew)) if each is not None]
        made = list[Profile]()
        for side in (0, 1):
            parts = [(_weights(name, self.shares), each) for name, each in there]
            excitation = sum(w.force[side] * each.excitation for w, each in parts)
            position = sum(w.motion[side] * each.set_position for w, each in parts)
            velocity = sum(w.motion[side] * each.velocity for w, each in parts)
            first = there[0][1]
            made.append(replace(first, excitation=excitation, set_position=position, velocity=velocity))
        return made[0], made[1]

    def play(
        self,
        profiles: tuple[Profile, Profile],
        progress: Progress | None = None,
        controls: tuple[Control | None, Control | None] = (None, None),
    ) -> tuple[Played, Played]:
        """Play a motion on each side in the same cycles; a fault of one stops both.

        The reason for an early end is in `Played.aborted` of both.  Raises BusError if a drive cannot be switched on.
        """
        ready = [
            side.ready(profile, control) for side, profile, control in zip(self.sides, profiles, controls, strict=True)
        ]
        segment = Segment(self.first.file.interface)
        clients = [side.client(each.drive, segment) for side, each in zip(self.sides, ready, strict=True)]
        played: list[Played] = []
        try:
            with driven_together(clients):
                one, other = (client.told for client in clients)
                assert one is not None
                assert other is not None
                free = one.position - other.position if self.free is None else self.free
                played = play_together(
                    clients,
                    profiles,
                    names=SIDES,
                    progress=progress,
                    controls=[each.leading for each in ready],
                    skew=Skew(free, self.skew),
                )
        except BusError as error:
            if not played:
                raise
            # it was the end that failed: the logs of the motion are kept
            played = [replace(each, aborted=each.aborted or str(error)) for each in played]
        return played[0], played[1]


class _Weights(NamedTuple):
    """How a motion is made of both sides: its position from theirs, theirs from its, their forces from its, its force
    from theirs.
    """

    position: tuple[float, float]
    motion: tuple[float, float]
    force: tuple[float, float]
    whole: tuple[float, float]


def _weights(which: str, shares: tuple[float, float]) -> _Weights:
    s1, s2 = shares
    if which == "common":
        return _Weights((s1, s2), (1.0, 1.0), (s1, s2), (1.0, 1.0))
    return _Weights((1.0, -1.0), (s2, -s1), (s1 * s2, -s1 * s2), (1.0 / s1, -1.0 / s2))


@dataclass(frozen=True)
class GantryMotion:
    """One motion of a gantry as an axis; see `LiveAxis` and the head of this file.

    Its logs have the readings and forces of the motion, and those of both sides (`reading_first` ...).
    """

    gantry: Gantry
    which: Literal["common", "skew"]
    stated: BusLimits | None = field(default=None, compare=False)

    @property
    def _weights(self) -> _Weights:
        return _weights(self.which, self.gantry.shares)

    @property
    def where(self) -> str:
        """Both drives."""
        return " and ".join(side.where for side in self.gantry.sides)

    @property
    def sample_time(self) -> float:
        """The cycle time of the bus, s."""
        return self.gantry.first.sample_time

    @property
    def increment(self) -> float:
        """The increment whose rounding has the variance of that of both sides together, m."""
        parts = zip(self._weights.position, self.gantry.sides, strict=True)
        return math.hypot(*(weight * side.increment for weight, side in parts))

    @property
    def rotary(self) -> bool:
        """False: a beam moves along a line."""
        return self.gantry.first.rotary

    @property
    def commanded(self) -> str:
        """What a control on trial commands: a force."""
        return "force"

    @property
    def takes(self) -> tuple[type[Block], ...]:
        """What a control on trial may have beside its law."""
        return self.gantry.first.takes

    @property
    def is_virtual(self) -> bool:
        """True if both drives are virtual."""
        return all(side.is_virtual for side in self.gantry.sides)

    @property
    def limits(self) -> BusLimits:
        """The limits of the motion, within those of both sides; that of the skew bounds how far it may twist."""
        if self.stated is not None:
            return self.stated
        sides, weights = [side.limits for side in self.gantry.sides], self._weights

        def least(name: str, parts: tuple[float, float]) -> float:
            return min(float(getattr(side, name)) / abs(w) for side, w in zip(sides, parts, strict=True))

        accelerations = [side.acceleration for side in sides if side.acceleration is not None]
        twists = self.which == "skew"
        following = least("following_error", weights.motion)
        return BusLimits(
            travel=self.gantry.skew if twists else least("travel", weights.motion),
            velocity=least("velocity", weights.motion),
            force=least("force", weights.force),
            following_error=min(self.gantry.skew, following) if twists else following,
            skew=self.gantry.skew,
            acceleration=min(accelerations) if accelerations else None,
            quick_stop_deceleration=least("quick_stop_deceleration", weights.motion),
        )

    def as_found(self) -> GantryMotion:
        """Return the same motion whose drives keep the limits of force that they hold."""
        gantry = self.gantry.with_sides(self.gantry.first.as_found(), self.gantry.second.as_found())
        return replace(self, gantry=gantry)

    def limited(self, limits: BusLimits) -> GantryMotion:
        """Return the same motion under tighter limits."""
        made = list[BusAxis]()
        for side, share in zip(self.gantry.sides, self._weights.force, strict=True):
            mine = side.limits
            changed = replace(mine, force=min(float(mine.force), limits.force * abs(share)))
            # while it twists, the whole may move as well
            for name in ("following_error", *(("travel", "velocity") if self.which == "common" else ())):
                changed = replace(changed, **{name: min(float(getattr(mine, name)), float(getattr(limits, name)))})
            # one side may have to drag the other by the beam: what is known of the whole holds for either
            for name in ("largest_mass", "breakaway_force"):
                if getattr(limits, name) is not None:
                    changed = replace(changed, **{name: getattr(limits, name)})
            made.append(side.limited(changed))
        return replace(self, gantry=self.gantry.with_sides(*made), stated=limits)

    def scaled(self, factor: float, force_sign: int = 1) -> GantryMotion:
        """Return the same motion with lengths of both sides `factor` times as large, and with another sign of force."""
        gantry = self.gantry.with_sides(*(side.scaled(factor, force_sign) for side in self.gantry.sides))
        free = None if gantry.free is None else factor * gantry.free
        return replace(self, gantry=replace(gantry, free=free), stated=None)

    def text(self) -> str:
        """Return the drive files of both sides, one after the other."""
        return "\n".join(side.text() for side in self.gantry.sides)

    def listen(self, seconds: float, progress: Progress | None = None) -> Played:
        """Log both drives as they are, one after the other."""
        return self._merged(tuple(side.listen(seconds, progress) for side in self.gantry.sides), "listened")

    def play(
        self,
        profile: Profile,
        progress: Progress | None = None,
        control: Control | Loop | None = None,
        along: Profile | None = None,
    ) -> Played:
        """Play a motion under the controls of the drives or, on trial, under the shares of ours; see `LiveAxis`.

        along  what the other motion of the gantry does meanwhile; default: it rests
        """
        if isinstance(control, Loop):
            control = control.control
        controls = [None if control is None else share_of(control, share) for share in self.gantry.shares]
        profiles = self.gantry.profiles(**{self.which: profile, "common" if self.which == "skew" else "skew": along})
        return self._merged(self.gantry.play(profiles, progress, (controls[0], controls[1])), profile.name)

    def inside(self) -> Mapping[str, str]:
        """Return the objects that a motion writes, of both drives."""
        return {
            f"{side}, {place}": value
            for side, axis in zip(SIDES, self.gantry.sides, strict=True)
            for place, value in axis.inside().items()
        }

    def restore(self, inside: Mapping[str, str]) -> Text:
        """Write back what `inside` gave into both drives; raise BusError, after both, for what does not read back."""
        told, wrong = list[str](), list[str]()
        for name, axis in zip(SIDES, self.gantry.sides, strict=True):
            try:
                told.append(axis.restore(_of_side(inside, name)))
            except BusError as error:
                wrong.append(str(error))
        if wrong:
            raise BusError("; ".join(wrong))
        return joined(" ", told)

    def keep(self, machine_file: Path, export: Path, inside: Mapping[str, str]) -> Text:
        """Keep the control that was tried, which runs in the master, and write back all that was inside both drives."""
        self.restore(inside)
        return Text(
            f"{self.where}: the drives are as they were. The control that was tried runs in the master, in cst every "
            f"{Quantity(self.sample_time, 's'):6 us}, a share of it on each side: build {export.name} into it (made "
            f"from {machine_file.name})."
        )

    def _merged(self, played: tuple[Played, ...], name: str) -> Played:
        """Return what both sides played as one log of the motion, with the readings and forces of both beside it."""
        logs = [each.log for each in played]
        rows = min(len(log) for log in logs)
        weights = self._weights
        by: dict[str, tuple[float, float]] = {
            **dict.fromkeys(("set_position", "reading_load", "reading_motor", "velocity_load"), weights.position),
            **dict.fromkeys(("excitation", "force", "commanded"), weights.whole),
        }
        channels, known = dict[str, np.ndarray](), dict[str, str]()
        for column, parts in by.items():
            if all(column in log.channels for log in logs):
                channels[column] = parts[0] * logs[0][column][:rows] + parts[1] * logs[1][column][:rows]
                known[column] = logs[0].units[column]
        for side, log in zip(SIDES, logs, strict=True):
            for column in ("set_position", "reading_load", "reading_motor", "force", "commanded"):
                if column in log.channels:
                    own = f"{column.removesuffix('_load')}_{side}"
                    channels[own], known[own] = log[column][:rows], log.units[column]
        if any("lost" in log.channels for log in logs):
            lost = [log.channels.get("lost", np.zeros(len(log)))[:rows] for log in logs]
            channels["lost"], known["lost"] = np.maximum(*lost), ""
        provenance: dict[str, Any] = {**logs[0].provenance, "bus": self.where, "increment_m": self.increment}
        provenance |= {"gantry": self.which, "shares": list(self.gantry.shares)}
        time = logs[0].time[:rows]
        log = replace(logs[0], name=name, time=time, channels=channels, units=known, provenance=provenance)
        # the reason of the side that caused the end is that of both
        ended = next((each for each in played if each.aborted), played[0])
        remarks = tuple(dict.fromkeys(remark for each in played for remark in each.remarks))
        lost_frames = max(each.lost for each in played)
        return Played(log, ended.aborted, lost_frames, played[0].lateness, remarks, ended.cause)


def _of_side(inside: Mapping[str, str], side: str) -> dict[str, str]:
    """Return what is inside the drive of a side, by the address of its objects."""
    begin = f"{side}, "
    return {place.removeprefix(begin): value for place, value in inside.items() if place.startswith(begin)}

"""Faults that a virtual drive acts out from a cycle in operation on, to test what watches over it.

They are counted in bus cycles with the drive in operation, not in time.  `KINDS` lists them; a text such as
`jump@150=0.002` names kind, cycle and size.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from feeddrive.bus.cia402 import CSP, CST, SHUTDOWN
from feeddrive.language.errors import ParameterError


class Kind(NamedTuple):
    """A kind of fault: its meaning, the unit of its size, and the usual size."""

    meaning: str
    unit: str
    usual: float


KINDS: Mapping[str, Kind] = {
    "freeze": Kind("all actual values stand still, and 0x60F4 is 0; statusword and axis go on", "", 0.0),
    "encoder_loss": Kind("0x6064 stands still and 0x606C is 0; the drive's own loop goes on", "", 0.0),
    "jump": Kind("0x6064 jumps by so much, and stays off", "m", 2e-3),
    "sign": Kind("the force acts the other way: motor or encoder is connected with the wrong sign", "", 0.0),
    "gear": Kind("0x6064 shows so many times the motion, as with a coupling that slips; 0x606C is right", "", 0.5),
    "zero_error": Kind("no force acts, and 0x60F4 is 0; the drive says that it is in operation", "", 0.0),
    "late_status": Kind(
        "no force acts, as after a fault, which the statusword tells so many cycles later", "cycles", 20.0
    ),
    "lost": Kind("so many answers in a row are lost", "cycles", 10.0),
    "repeat": Kind("the same answer comes back so many times, with a working counter that is right", "cycles", 1e6),
    "drive_fault": Kind("a fault of the drive, with this error code", "", float(0x2310)),
    "brake_slip": Kind("once the drive is off its brake slips: so much weight moves the axis", "N", 200.0),
    "second_master": Kind(
        "another master sends as well: 0: it shuts the drive down; 1: it holds the axis in every other cycle; "
        "2: it changes the mode",
        "",
        0.0,
    ),
    "cable": Kind("the cable is pulled: no frame passes either way", "", 0.0),
    "stop_input": Kind("a person at the stop of the drive: all its digital inputs (0x60FD) change", "", 0.0),
}
"""The faults by name."""

_FROZEN = ("position", "velocity", "torque", "following_error", "second_position")


class InjectedFault(NamedTuple):
    """A fault, the cycle in operation from which on it acts, and its size in the unit of its kind."""

    kind: str
    cycle: int
    size: float


def read_fault(text: str) -> InjectedFault:
    """Return the fault that a text names, such as `freeze@150` or `jump@150=0.002`. Raises ParameterError."""
    kind, at, rest = text.partition("@")
    number, equals, size = rest.partition("=")
    if kind not in KINDS or not at:
        raise ParameterError(
            f"fault '{text}' must name a kind and a cycle in operation, as freeze@150, or a size as well, as "
            f"jump@150=0.002 (m); there are {', '.join(KINDS)}"
        )
    try:
        return InjectedFault(kind, int(number), float(size) if equals else KINDS[kind].usual)
    except ValueError:
        raise ParameterError(
            f"fault '{text}': '{rest}' is not a number of a cycle, or one with a size, as in {kind}@150"
            f"={KINDS[kind].usual:g}"
        ) from None


class FaultActor:
    """The faults of one virtual drive: what is sent to it, what its axis does, and what it tells.

    `began` is the number of the bus cycle in which the first fault began, None before it.
    """

    def __init__(self, faults: Sequence[InjectedFault], metre: float) -> None:
        """Set up the faults; `metre` is the length of an increment."""
        self.faults, self._metre = tuple(faults), metre
        self.operated = self.cycle = 0
        self.began: int | None = None
        self._since: dict[str, int] = {}  # cycles for which each fault acts
        self._kept: dict[str, dict[str, int]] = {}  # the values at its begin

    def size(self, kind: str) -> float | None:
        """Return the size of a fault of this kind that acts now, or None."""
        return next((fault.size for fault in self.faults if fault.kind == kind and kind in self._since), None)

    def since(self, kind: str) -> int:
        """Return the number of cycles for which a fault acts, this one among them; 0: it does not."""
        return self._since.get(kind, 0)

    @property
    def is_unplugged(self) -> bool:
        """True once the cable is pulled."""
        return self.since("cable") > 0

    @property
    def is_answering(self) -> bool:
        """True if the answer to the next frame comes back."""
        return not self.is_unplugged and not 0 < self.since("lost") <= (self.size("lost") or 0)

    def taken(self, sent: Mapping[str, int]) -> Mapping[str, int]:
        """Return what the drive gets in place of what its master sent."""
        another = self.size("second_master")
        theirs: Mapping[str, int] = {}
        if another == 0.0:
            theirs = {"controlword": SHUTDOWN}
        elif another == 2.0:
            theirs = {"mode": self._another_mode}
        elif another is not None and self.since("second_master") % 2:
            held = self._kept["second_master"]["position"]
            nothing = ("target_velocity", "target_torque", "velocity_offset", "torque_offset")
            theirs = {"target_position": held} | dict.fromkeys(nothing, 0)
        # on CAN one message holds some of them
        return {**sent, **{name: value for name, value in theirs.items() if name in sent}}

    @property
    def _another_mode(self) -> int:
        return CSP if self._kept["second_master"]["mode"] == CST else CST

    def advance(self, values: Mapping[str, int], *, is_on: bool) -> None:
        """Begin a bus cycle; `is_on`: the drive is in operation."""
        self.cycle += 1
        self.operated += is_on
        for kind in self._since:
            self._since[kind] += 1
        for fault in self.faults:
            if is_on and fault.kind not in self._since and self.operated >= fault.cycle:
                self._since[fault.kind] = 1
                self._kept[fault.kind] = dict(values)
                self.began = self.cycle if self.began is None else self.began

    @property
    def is_limp(self) -> bool:
        """True if no force of the drive acts."""
        return self.since("zero_error") > 0 or self.since("late_status") > 0

    @property
    def sign(self) -> float:
        """The sign of the force, -1 if it acts the other way."""
        return -1.0 if self.since("sign") else 1.0

    def told(self, values: Mapping[str, int]) -> Mapping[str, int]:
        """Return the values that the drive tells in place of its true ones."""
        if not self._since:
            return values
        told = dict(values)
        if self.since("freeze"):
            told |= {name: self._kept["freeze"][name] for name in _FROZEN} | {"following_error": 0}
        if self.since("encoder_loss"):
            told |= {"position": self._kept["encoder_loss"]["position"], "velocity": 0}
        if (factor := self.size("gear")) is not None:
            begin = self._kept["gear"]["position"]
            told["position"] = round(begin + factor * (values["position"] - begin))
        if (jump := self.size("jump")) is not None:
            told["position"] += round(jump / self._metre)
        if self.since("zero_error"):
            told["following_error"] = 0
        if self.since("stop_input"):
            told["digital_inputs"] = values["digital_inputs"] ^ 0xFFFFFFFF
        late = self.size("late_status")
        if late is not None and self.since("late_status") <= late:
            told |= {name: self._kept["late_status"][name] for name in ("statusword", "error_code")}
        repeated = self.size("repeat")
        if repeated is not None and self.since("repeat") <= repeated:
            return self._kept["repeat"]
        return told

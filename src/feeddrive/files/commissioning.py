"""The contents of a drive's commissioning file: type of axis, sample times, controllers and measured responses.

The files are written by the tuning tool of SINUMERIK drives (`readers/ast_xml.py`).  Member names differ between
versions, so values are found by member name anywhere in the file, except in the tool's tuning strategies, which contain
permitted settings and not the active ones.  The units are those of the only public file,
github.com/eliasrhoden/Sinumerik-Ctrl, which also contains some of the values as machine data and drive parameters:

    Kp   N m s/rad, as p1460          Tn   s (p1462 is in ms)          Kv   1000/min, as MD32200
    times in s, frequencies in Hz, inertias in kg m2 at the motor
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from feeddrive.blocks.families import Filter
from feeddrive.blocks.filter.low_pass import LowPass
from feeddrive.blocks.filter.low_pass2 import LowPass2
from feeddrive.blocks.filter.notch import Notch
from feeddrive.blocks.filter.second_order import SecondOrder
from feeddrive.files.frf import read_frfs
from feeddrive.files.read_log import OpenedFile
from feeddrive.files.readers import ast_xml
from feeddrive.files.readers.ast_xml import Element
from feeddrive.language import tree
from feeddrive.language.errors import LogError
from feeddrive.loop.frequency_response import FRF

# the integral time of a speed controller is 1 to 500 ms: a larger number is in ms, as the drive parameter is
_MOST_SECONDS = 1.0
_STRATEGY = re.compile(r"Strateg", re.IGNORECASE)
_ACTUAL = re.compile(r"Actual|Feedback", re.IGNORECASE)

_KP = re.compile(r"kp(gain)?|proportionalgain", re.IGNORECASE)
_TN = re.compile(r"tn|integra(l|tor)time|resettime", re.IGNORECASE)
_KV = re.compile(r"kv(gain|factor)?|positiongain", re.IGNORECASE)
_CLOCK = re.compile(r"(process)?updatetime(seconds)?", re.IGNORECASE)
_SPEED_CLOCK = re.compile(r"processupdatetime(seconds)?", re.IGNORECASE)
_ROTARY = re.compile(r"(axisisrotary|isrotaryaxis)", re.IGNORECASE)
_RATIO = re.compile(r"axisdistpermotordist\w*", re.IGNORECASE)
_USABLE = re.compile(r"\w*usable\w*freq\w*|\w*freq\w*usable\w*|\w*usable\w*from\w*", re.IGNORECASE)
_ZERO = re.compile(r"\w*lowest\w*zero\w*", re.IGNORECASE)
_TOTAL = re.compile(r"total(inertia|mass)", re.IGNORECASE)
_MOTOR = re.compile(r"motor(inertia|mass)", re.IGNORECASE)
_AVERAGES = re.compile(r"number\w*averages", re.IGNORECASE)
_DIRECT_DELAY = re.compile(r"(actval|commandval)delaytime", re.IGNORECASE)
_DSC = re.compile(r"dscisactive", re.IGNORECASE)
_SECOND_ENCODER = re.compile(r"secondencoderpresent", re.IGNORECASE)
_REFERENCE = re.compile(r"usingreferencemodel", re.IGNORECASE)
_MARGINS = re.compile(r"(gain|phase)margin", re.IGNORECASE)
_ENABLED = re.compile(r"\w*enabled", re.IGNORECASE)


@dataclass(frozen=True)
class SpeedController:
    """A PI speed controller in the file, with the filters of its torque setpoint.

    Kp, Tn   gain, N m s/rad (N s/m for a linear motor), and integral time, s; Tn is None if there is no integral action
    filters  enabled filters
    left     features in the file that feeddrive's control law does not support, in words
    stamp    time at which the tool stored the controller, as text
    """

    place: str
    Kp: float
    Tn: float | None
    filters: tuple[Filter, ...] = ()
    left: tuple[str, ...] = ()
    stamp: str = ""

    def values(self) -> tuple[object, ...]:
        """Return the values that determine the behavior of the controller, for comparison with another one."""
        return self.Kp, self.Tn, [(block.kind, [*tree.leaves(block)]) for block in self.filters], self.left


@dataclass(frozen=True)
class Commissioning:
    """The recognized contents of a commissioning file; a value that the file does not contain is None.

    rotary           True for a rotary axis
    linear_motor     True for a linear motor; the plant response is then in (m/s)/N
    per_motor        motion of the axis (m or rad) per radian or meter of the motor
    clock, position_clock    sample times of the speed loop and of the position loop, s
    usable_from      lowest frequency at which the tool considers the plant response usable, Hz
    inertia, motor_inertia, antiresonance   values of the tool's own model: kg m2 at the motor, and Hz
    averages         number of averages of the measurement
    margins          gain margin (dB) and phase margin (deg) required by the tool's active strategy
    Kv               position gain in 1000/min, as in the file
    delays           sum of the additional delays of the position loop, s
    controllers      speed controllers in the order of the file, without consecutive duplicates; the last one is active
    plants, current_loops    names of the responses of speed to torque, and of torque to its setpoint
    stamps           time of each measurement, as text, by name of the response
    """

    name: str
    responses: Mapping[str, FRF]
    plants: tuple[str, ...]
    current_loops: tuple[str, ...]
    stamps: Mapping[str, str]
    axis: str = ""
    rotary: bool | None = None
    linear_motor: bool = False
    per_motor: float | None = None
    clock: float | None = None
    position_clock: float | None = None
    usable_from: float | None = None
    inertia: float | None = None
    motor_inertia: float | None = None
    antiresonance: float | None = None
    averages: int | None = None
    margins: tuple[float | None, float | None] = (None, None)
    Kv: float | None = None
    delays: float = 0.0
    dsc: bool = False
    second_encoder: bool = False
    controllers: tuple[SpeedController, ...] = ()
    understood: frozenset[str] = field(default_factory=frozenset[str])

    @property
    def today(self) -> SpeedController | None:
        """The active speed controller, which is the last one in the file."""
        return self.controllers[-1] if self.controllers else None

    @property
    def plant(self) -> str | None:
        """The name of the plant response to use: preferably with coherence data, then the latest, then the longest."""

        def rank(name: str) -> tuple[bool, str, int]:
            frf = self.responses[name]
            return frf.coherence is not None, self.stamps[name], frf.frequency.size

        return max(self.plants, key=rank, default=None)

    @property
    def current_loop(self) -> str | None:
        """The name of the current-loop response to use: the latest, and of several the one with the most lines."""

        def rank(name: str) -> tuple[str, int]:
            return self.stamps[name], self.responses[name].frequency.size

        return max(self.current_loops, key=rank, default=None)


def read_commissioning(source: str | Path | OpenedFile) -> Commissioning | None:
    """Read a commissioning file; return None for a file of another format. Raise LogError for a damaged one."""
    file = source if isinstance(source, OpenedFile) else OpenedFile(source)
    if not ast_xml.is_ast(file.unpacked):
        return None
    root = ast_xml.parsed(str(file), file.unpacked)
    measured = [*ast_xml.responses(str(file), root)]
    values = _Values(root)
    clocks = [clock for clock in values.numbers(_CLOCK) if clock > 0.0]
    clock = values.number(_SPEED_CLOCK) or min(clocks, default=None)
    margins = _margins(root)
    slow = max(clocks, default=None)
    return Commissioning(
        str(file),
        read_frfs(file),
        tuple(response.label for response in measured if response.is_plant),
        tuple(response.label for response in measured if response.is_current_loop),
        {response.label: response.stamp for response in measured},
        axis=values.text("m_szAxisName"),
        rotary=values.flag(_ROTARY),
        linear_motor=ast_xml.linear_motor(root),
        per_motor=values.number(_RATIO),
        clock=None if clock is None else _decimal(clock),
        position_clock=None if slow is None or clock is None or slow <= 1.5 * clock else _decimal(slow),
        usable_from=values.number(_USABLE),
        inertia=values.number(_TOTAL),
        motor_inertia=values.number(_MOTOR),
        antiresonance=values.number(_ZERO),
        averages=int(averages) if (averages := values.number(_AVERAGES)) is not None and averages >= 1.0 else None,
        margins=margins,
        Kv=values.number(_KV),
        delays=sum(values.first_of_each(_DIRECT_DELAY)),
        dsc=values.flag(_DSC) or False,
        second_encoder=values.flag(_SECOND_ENCODER) or False,
        controllers=_controllers(root),
        understood=frozenset(values.seen),
    )


class _Values:
    """The scalars of a file outside the tool's strategies, found by member name without its prefix."""

    def __init__(self, root: Element) -> None:
        self._members: list[tuple[str, float | str]] = []
        self.seen: set[str] = set()
        for path, element in root.walk():
            if not _in_strategy(path, element):
                self._members += element.scalars().items()

    def _matching(self, pattern: re.Pattern[str]) -> Iterator[tuple[str, float | str]]:
        for member, value in self._members:
            if pattern.fullmatch(_bare(member)):
                self.seen.add(member)
                yield member, value

    def numbers(self, pattern: re.Pattern[str]) -> list[float]:
        """Return all numbers whose member names match the pattern."""
        return [value for _, value in self._matching(pattern) if isinstance(value, float)]

    def number(self, pattern: re.Pattern[str]) -> float | None:
        """Return the first matching number other than zero, which marks an unknown value; None if there is none."""
        return next((value for value in self.numbers(pattern) if value != 0.0), None)

    def first_of_each(self, pattern: re.Pattern[str]) -> list[float]:
        """Return, for each matching member name, its first number."""
        first: dict[str, float] = {}
        for member, value in self._matching(pattern):
            if isinstance(value, float):
                first.setdefault(member, value)
        return [*first.values()]

    def flag(self, pattern: re.Pattern[str]) -> bool | None:
        """Return the first boolean whose member name matches; None if there is none."""
        return next((ast_xml.true(value) for _, value in self._matching(pattern)), None)

    def text(self, member: str) -> str:
        """Return the first value of a member as text; empty if there is none."""
        self.seen.add(member)
        return next((str(value) for name, value in self._members if name == member), "")


def _bare(member: str) -> str:
    """Return a member name without its prefix: KpGain for m_dKpGain."""
    return re.sub(r"^m_(sz|[a-z])?(?=[A-Z])", "", member)


def _in_strategy(path: tuple[str, ...], element: Element) -> bool:
    return any(map(_STRATEGY.search, (*path, element.tag)))


def _decimal(seconds: float) -> float:
    """Round a sample time to six digits, since the file stores it in single precision: 125 us as 0.000125000007629."""
    return float(f"{seconds:.6g}")


def _of(element: Element, pattern: re.Pattern[str]) -> float | None:
    """Return the number of an element's first member whose name matches, or None."""
    return next(
        (v for name, v in element.scalars().items() if pattern.fullmatch(_bare(name)) and isinstance(v, float)), None
    )


def _controllers(root: Element) -> tuple[SpeedController, ...]:
    """Return the speed controllers in the order of the file, without consecutive duplicates."""
    controllers: list[SpeedController] = []
    for path, element in root.walk():
        Kp = _of(element, _KP)
        if Kp is None or Kp <= 0.0 or _in_strategy(path, element):
            continue
        Tn = _of(element, _TN)
        if Tn is not None and Tn > _MOST_SECONDS:
            Tn *= 1e-3
        filters, left = _filters(element)
        flags = {_bare(name): value for name, value in element.scalars().items()}
        if any(_REFERENCE.fullmatch(name) and ast_xml.true(value) for name, value in flags.items()):
            left = (*left, "the reference model of the speed controller")
        stamp = next((text for text in (ast_xml.stamp(element),) if text), "")
        new = SpeedController(".".join(path[1:]), Kp, Tn or None, filters, left, stamp)
        if not controllers or controllers[-1].values() != new.values():
            controllers.append(new)
    return tuple(controllers)


def _filters(regulator: Element) -> tuple[tuple[Filter, ...], tuple[str, ...]]:
    """Return the enabled filters of the torque setpoint, and a phrase for each enabled filter that is not supported."""
    filters: list[Filter] = []
    left: list[str] = []
    for path, element in regulator.walk():
        make = next((maker for end, maker in _MAKERS.items() if element.tag.lower().endswith(end)), None)
        if make is None and not re.search(r"(filter|bandstop|notch)$", element.tag, re.IGNORECASE):
            continue
        scalars = {_bare(name).lower(): value for name, value in element.scalars().items()}
        off = any(_ENABLED.fullmatch(name) and not ast_xml.true(value) for name, value in scalars.items())
        numbers = {name: value for name, value in scalars.items() if isinstance(value, float)}
        block = None if make is None else make(numbers)
        if off or not numbers:
            continue
        if any(map(_ACTUAL.search, path)):
            left.append(f"a filter of the actual speed ({element.tag})")
        elif block is None:
            left.append(f"a filter of class {element.tag}")
        else:
            filters.append(block)
    return tuple(filters), tuple(left)


def _by(numbers: Mapping[str, float], *words: str) -> float | None:
    """Return the number whose member name contains all words."""
    return next((value for name, value in numbers.items() if all(word in name for word in words)), None)


def _low_pass(numbers: Mapping[str, float]) -> Filter | None:
    time, corner = _by(numbers, "timeconst"), _by(numbers, "freq") or _by(numbers, "bandwidth")
    # a time constant of 0 is no filter
    if time is not None and time > 0.0:
        return LowPass(frequency=1.0 / (6.283185307179586 * time))
    return LowPass(frequency=corner) if time is None and corner is not None and corner > 0.0 else None


def _low_pass2(numbers: Mapping[str, float]) -> Filter | None:
    frequency, damping = _by(numbers, "freq"), _by(numbers, "damp")
    if frequency is None or frequency <= 0.0 or damping is None or damping <= 0.0:
        return None
    return LowPass2(frequency=frequency, damping=damping)


def _general(numbers: Mapping[str, float]) -> Filter | None:
    zero, pole = _by(numbers, "num", "damp"), _by(numbers, "den", "damp")
    low = _by(numbers, "num", "freq") or _by(numbers, "freq")
    high = _by(numbers, "den", "freq") or low
    if zero is None or pole is None or low is None or high is None or low <= 0.0 or high <= 0.0 or pole <= 0.0:
        return None
    if low == high:
        return Notch(frequency=low, damping_zero=zero, damping_pole=pole)
    return SecondOrder(frequency_zero=low, damping_zero=zero, frequency_pole=high, damping_pole=pole)


# the end of a class name -> the filter made of its numbers, by words of their member names
_MAKERS: Mapping[str, Callable[[Mapping[str, float]], Filter | None]] = {
    "pt1filter": _low_pass,
    "pt2filter": _low_pass2,
    "secondorderfilter": _general,
    "bandstopfilter": _general,
    "notchfilter": _general,
}


def _margins(root: Element) -> tuple[float | None, float | None]:
    """Return the gain margin in dB and the phase margin in deg of the active strategy; None for a missing margin.

    The index stored with a list of strategies selects the active one; without an index the first one is active.
    """
    for _, parent in root.walk():
        items = next((child for child in parent.children if child.member == "m_StrategyList"), None)
        if items is None or not items.children:
            continue
        place = parent.scalars().get("m_StrategyList_activeIndex", 0.0)
        index = int(place) if isinstance(place, float) and 0.0 <= place < len(items.children) else 0
        found = {
            _bare(name).lower(): value
            for name, value in items.children[index].scalars().items()
            if _MARGINS.fullmatch(_bare(name)) and isinstance(value, float) and value > 0.0
        }
        if found:
            return found.get("gainmargin"), found.get("phasemargin")
    return None, None


def require_plant(commissioning: Commissioning) -> str:
    """Return the name of the plant response. Raise LogError, listing the available responses, if there is none."""
    name = commissioning.plant
    if name is None:
        there = ", ".join(commissioning.responses)
        raise LogError(
            f"{commissioning.name}: holds no response of the motor's speed to its torque (m_pPlant); there are: {there}"
        )
    return name

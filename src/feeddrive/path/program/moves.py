"""Canonical commands of a part program, and its moves in machine coordinates.

A canonical command states what a block requests, in the units and coordinates of the program.  The names and the text
are those of LinuxCNC's stand-alone interpreter, so that both front ends produce the same stream.

Moves are in machine coordinates (m, rad, s), with the geometry of the arcs G2 and G3.  Points have nine coordinates,
for the axes X Y Z A B C U V W.
"""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, NamedTuple, get_args

from feeddrive.language.quantity import Quantity
from feeddrive.path.kinematics import Kinematics
from feeddrive.path.program.blocks import BlockError, Line

Value = float | str
"""A number, or a word such as CANON_EXACT_PATH; whole numbers that identify something are int."""


class Command(NamedTuple):
    """A canonical command: its name, its values, and the line that caused it."""

    name: str
    values: tuple[Value, ...]
    line: Line


def _listed(values: tuple[Value, ...]) -> str:
    return ", ".join(f"{value:.4f}" if isinstance(value, float) else str(value) for value in values)


def _six(values: tuple[Value, ...]) -> str:
    # rs274 prints neither U, V nor W
    return _listed(values[:6])


def _quoted(values: tuple[Value, ...]) -> str:
    return f'"{values[0]}"'


def _mode(values: tuple[Value, ...]) -> str:
    return str(values[0]) if len(values) == 1 else f"{values[0]}, {values[1]:.6f}"


def _offsets(values: tuple[Value, ...]) -> str:
    return ", ".join(" ".join(f"{value:.4f}" for value in values[i : i + 3]) for i in (0, 3, 6))


def _entry(values: tuple[Value, ...]) -> str:
    pocket, tool, *offset = values[:11]
    return f"{pocket}, {tool}, {' '.join(f'{value:.4f}' for value in offset)}, {_listed(values[11:])}"


_TEXT: dict[str, Callable[[tuple[Value, ...]], str]] = {
    "STRAIGHT_TRAVERSE": _six,
    "STRAIGHT_FEED": _six,
    "STRAIGHT_PROBE": _six,
    "ARC_FEED": lambda values: _listed(values[:9]),
    "SET_G5X_OFFSET": lambda values: _listed(values[:7]),
    "SET_G92_OFFSET": _six,
    "COMMENT": _quoted,
    "MESSAGE": _quoted,
    "IGNORED": _quoted,
    "LOG": _quoted,
    "RESUME": _quoted,
    "SET_MOTION_CONTROL_MODE": _mode,
    "USE_TOOL_LENGTH_OFFSET": _offsets,
    "SET_SPINDLE_MODE": lambda values: f"{values[0]} {values[1]:.4f}",
    "SET_TOOL_TABLE_ENTRY": _entry,
    "SET_MOTION_OUTPUT_VALUE": lambda values: f"{values[0]},{values[1]:.6f}",
    "SET_AUX_OUTPUT_VALUE": lambda values: f"{values[0]},{values[1]:.6f}",
    "START_SPEED_FEED_SYNC": lambda values: f"{values[0]:.6f},{values[1]}",
}


def canonical_text(command: Command) -> str:
    """Return the text of a command as LinuxCNC's interpreter prints it, without the line number; the text is empty for
    PRINT, which is not printed there.
    """
    if command.name == "PRINT":
        return ""
    return f"{command.name}({_TEXT.get(command.name, _listed)(command.values)})"


_COMMAND = re.compile(r"([A-Z_][A-Z_0-9]*)\((.*)\)$")


def read_command(text: str, line: Line) -> Command | None:
    """Parse the text of a command; return None for any other text."""
    match = _COMMAND.fullmatch(text)
    if not match:
        return None
    if match[2].startswith('"'):
        return Command(match[1], (match[2][1:-1],), line)
    return Command(match[1], tuple(_value(value) for value in re.split(r"[,\s]+", match[2]) if value), line)


def _value(text: str) -> Value:
    try:
        # rs274 prints quantities with a decimal point, and numbers of tools or systems without one
        return float(text) if "." in text else int(text)
    except ValueError:
        return text


# programs round the end and the center of an arc to a few decimals
LEAST_SPREAD, RELATIVE_SPREAD, LARGEST_SPREAD = 0.03, 1e-3, 0.5
"""The tolerance of the radii at start and end: its minimum (mm), its ratio to the radius, and its maximum (mm)."""
# half of the fourth decimal of a program in inches
CHORD_SPREAD = 0.00127
"""The length by which half of the chord may exceed the radius, mm."""
MOST_TURNS = 100_000


def center_of_radius(
    start: tuple[float, float], end: tuple[float, float], radius: float, clockwise: bool, unit: float
) -> tuple[float, float]:
    """Return the center of an arc from its radius; a negative radius selects the longer arc. `unit`: mm per program
    unit.
    """
    if radius == 0:
        raise BlockError("an arc of radius 0: write its radius R or its center I J K", "R")
    dx, dy = end[0] - start[0], end[1] - start[1]
    half = 0.5 * math.hypot(dx, dy)
    if half == 0:
        raise BlockError(
            "an arc of given R ends where it begins, which leaves its center open: write I J K instead", "R"
        )
    size = abs(radius)
    if half * unit > size * unit + CHORD_SPREAD:
        raise BlockError(
            f"the radius {Quantity(size):6} does not reach: start and end are {Quantity(2 * half):6} apart, so R is "
            f"at least {Quantity(half):6}",
            "R",
        )
    # for half a circle rounding would move the center off the chord by the root of a rounding error
    height = math.sqrt(max(0.0, size * size - half * half)) if half / size < 1 - 1e-12 else 0.0
    if clockwise == (radius > 0):
        height = -height
    return (
        0.5 * (start[0] + end[0]) - height * dy / (2 * half),
        0.5 * (start[1] + end[1]) + height * dx / (2 * half),
    )


def check_radii(
    start: tuple[float, float], end: tuple[float, float], center: tuple[float, float], letters: str, unit: float
) -> None:
    """Refuse an arc whose start and end are not on one circle. `letters`: the words that define the center."""
    first = math.hypot(start[0] - center[0], start[1] - center[1]) * unit
    last = math.hypot(end[0] - center[0], end[1] - center[1]) * unit
    spread = abs(first - last)
    if first * last == 0 or not math.isfinite(spread):
        raise BlockError(f"an arc of radius 0: the center {letters} lies on its start or end", letters[:1])
    most = min(LARGEST_SPREAD, max(LEAST_SPREAD, RELATIVE_SPREAD * max(first, last)))
    if spread > most:
        raise BlockError(
            f"the end is no point of the circle: its radius is {_millimeters(first):6} at the start, "
            f"{_millimeters(last):6} at the end, which may differ by {_millimeters(most):3}; correct the end or "
            f"{letters}",
            letters[:1],
        )


def _millimeters(length: float) -> Quantity:
    """Return a length in mm as a quantity displayed in mm."""
    return Quantity(length, "mm", stays=True)


def sweep(start: tuple[float, float], end: tuple[float, float], center: tuple[float, float], turns: int) -> float:
    """Return the angle of an arc, rad: positive counterclockwise. An arc with equal start and end is a full turn."""
    a = math.atan2(start[1] - center[1], start[0] - center[0])
    b = math.atan2(end[1] - center[1], end[0] - center[0])
    angle = b - a
    if turns > 0:
        # an end equal to the start up to rounding is a full turn, not a zero one
        while angle <= 1e-12:
            angle += math.tau
        return angle + math.tau * (turns - 1)
    while angle >= -1e-12:
        angle -= math.tau
    return angle + math.tau * (turns + 1)


Orientation = Literal["axes", "plane", "vector"]
"""How a tool turns between two directions: the rotary joints move straight; it stays in the plane of both, at a
constant rate; or the components of its direction move straight, in this plane, too.
"""
ORIENTATIONS: tuple[Orientation, ...] = get_args(Orientation)

Point = tuple[float, ...]
"""The coordinates of X Y Z A B C U V W: m, and rad for A B C."""


@dataclass(frozen=True, slots=True)
class Straight:
    """A straight move from `start` to `end` at the feed, or at rapid traverse (`traverse`).

    orientation  how the tool turns while its tip moves: `Orientation`
    off          largest angle of the tool at start and end from the programmed direction, rad
    """

    source: Line
    start: Point
    end: Point
    traverse: bool
    orientation: Orientation = "axes"
    off: float = 0.0


@dataclass(frozen=True, slots=True)
class Arc:
    """An arc or helix at the feed.

    axes    first and second axis of its plane, and the normal axis, right-handed: 0, 1, 2 in XY
    center  center of the circle, along the first and second axis; the radii at start and end may differ by rounding in
            the program
    turns   number of full or partial turns: 1, 2, .. counterclockwise as seen from the third axis, -1, -2, .. clockwise
    off     largest angle of the tool from its programmed direction, rad
    """

    source: Line
    start: Point
    end: Point
    axes: tuple[int, int, int]
    center: tuple[float, float]
    turns: int
    off: float = 0.0

    @property
    def radius(self) -> float:
        """The radius at the start, m."""
        return math.hypot(self.start[self.axes[0]] - self.center[0], self.start[self.axes[1]] - self.center[1])

    @property
    def angle(self) -> float:
        """The angle of the arc, rad: positive counterclockwise."""
        first, second, _ = self.axes
        start, end = self.start, self.end
        return sweep((start[first], start[second]), (end[first], end[second]), self.center, self.turns)


@dataclass(frozen=True, slots=True)
class Spline:
    """A Bezier curve of second or third degree at the feed; `points` are its control points, without start and end.

    off  largest angle of the tool from its programmed direction, rad
    """

    source: Line
    start: Point
    end: Point
    points: tuple[Point, ...]
    off: float = 0.0

    def turns(self, axis: int) -> list[float]:
        """Return the coordinates at which an axis reverses along the curve, m."""
        at = [point[axis] for point in (self.start, *self.points, self.end)]
        # B' over the degree is the Bezier curve of these differences: c + 2 b s + a s²
        slope = [b - a for a, b in pairwise(at)]
        third = len(slope) == 3
        a, b, c = slope[-1] - 2.0 * slope[1] + slope[0] if third else 0.0, slope[1] - slope[0], slope[0]
        b = b if third else 0.5 * b
        # the root without cancellation, times a; the other one by Vieta: s1 s2 = c/a
        far = -b - math.copysign(math.sqrt(max(0.0, b * b - a * c)), b)
        places = [far / a if a else 0.0, c / far if far else 0.0]
        return [_bezier(at, s) for s in places if 0.0 < s < 1.0]


def _bezier(at: list[float], s: float) -> float:
    """Evaluate a Bezier curve by de Casteljau's construction."""
    while len(at) > 1:
        at = [a + s * (b - a) for a, b in pairwise(at)]
    return at[0]


@dataclass(frozen=True, slots=True)
class Dwell:
    """A standstill of `duration` s."""

    source: Line
    duration: float


@dataclass(frozen=True, slots=True)
class PathMode:
    """The path mode of the following moves.

    mode             exact_path (G61), exact_stop (G61.1) or continuous (G64)
    tolerance        largest deviation from the path, m (G64 P); 0 without P: the planner then allows none
    naive_tolerance  tolerance for merging consecutive points into one line, m (G64 Q)
    """

    source: Line
    mode: str
    tolerance: float = 0.0
    naive_tolerance: float = 0.0


@dataclass(frozen=True, slots=True)
class Feed:
    """The feed of the following moves.

    linear    path speed of moves with X Y Z (or U V W), m/s; m per revolution if `per_turn`
    angular   feed of moves of A B C only, from the same F word, rad/s; rad per revolution if `per_turn`
    per_turn  True for a feed per spindle revolution (G95)
    """

    source: Line
    linear: float
    angular: float
    per_turn: bool = False


@dataclass(frozen=True, slots=True)
class Spindle:
    """The spindle state during the following moves: `spindle_speed` in rpm, `direction` 1 clockwise, -1
    counterclockwise, 0 stopped.
    """

    source: Line
    spindle_speed: float
    direction: int


@dataclass(frozen=True, slots=True)
class Synchronized:
    """A spindle-synchronized feed: the following feeds advance by `pitch` (m) per spindle revolution (G33); a pitch of
    0 ends it.
    """

    source: Line
    pitch: float


@dataclass(frozen=True, slots=True)
class ToolChange:
    """A change to tool `number`, where 0 means no tool."""

    source: Line
    number: int


@dataclass(frozen=True, slots=True)
class Offsets:
    """The offsets of the following moves, whose coordinates already include them.

    system       1 to 9: G54 to G59.3
    origin       origin of the work offset
    rotation     rotation of the work offset about Z, rad
    axis_offset  offset of G92 and G52
    tool_offset  offset of G43
    """

    source: Line
    system: int
    origin: Point
    rotation: float
    axis_offset: Point
    tool_offset: Point


@dataclass(frozen=True, slots=True)
class ToolPoint:
    """The frame of the following moves: with `kinematics`, which include the tool, X Y Z are the tip of the tool in the
    frame of the workpiece (G43.4, G43.5); without, they are the joints (G49).
    """

    source: Line
    kinematics: Kinematics | None


@dataclass(frozen=True, slots=True)
class Switch:
    """A switching command: `what` (mist, flood, feed_override, output 3 ...) is set to `value`."""

    source: Line
    what: str
    value: float


@dataclass(frozen=True, slots=True)
class Message:
    """A message to the operator from (MSG, ...), (DEBUG, ...) or (PRINT, ...)."""

    source: Line
    text: str


@dataclass(frozen=True, slots=True)
class Ignored:
    """A code of a dialect that moves nothing, such as M104, and is left out."""

    source: Line
    code: str


@dataclass(frozen=True, slots=True)
class Stop:
    """A program stop; an `optional` one (M1) takes effect only if the operator has enabled optional stops."""

    source: Line
    optional: bool


@dataclass(frozen=True, slots=True)
class Probe(Stop):
    """A stop before and after a probing move (G38.2 to G38.5), which is planned as if it touched at its end."""


@dataclass(frozen=True, slots=True)
class Wait(Stop):
    """A stop that waits for an input (M66), for a time that is not known."""


@dataclass(frozen=True, slots=True)
class ExactStop(Stop):
    """A stop at the end of one block (G9), or until the control has read on (STOPRE)."""


@dataclass(frozen=True, slots=True)
class Begin:
    """The place where the machine stands before the first move, if not at its zero.

    state  the modal state as words of the program, if it is resumed in its midst
    """

    source: Line
    position: Point
    state: str = ""


@dataclass(frozen=True, slots=True)
class End:
    """The end of the program."""

    source: Line


Move = (
    Straight
    | Arc
    | Spline
    | Dwell
    | PathMode
    | Feed
    | Spindle
    | Synchronized
    | ToolChange
    | Offsets
    | ToolPoint
    | Switch
    | Message
    | Ignored
    | Stop
    | Begin
    | End
)
"""A move, or an event between moves, as yielded by `read_program`."""

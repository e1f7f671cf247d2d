"""Conversion of canonical commands in program units and coordinates to moves in SI units and machine coordinates.

machine = R(rotation) (program + axis_offset) + origin + tool_offset          rotation in the XY plane
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import cast

import numpy as np

from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.path.kinematics import Kinematics
from feeddrive.path.limits import FARTHEST
from feeddrive.path.orientation import MOST_WOUND, leaves_arc
from feeddrive.path.program import moves
from feeddrive.path.program.blocks import AXES, BlockError, Line, located
from feeddrive.path.program.budget import MOST_COMMANDS
from feeddrive.path.program.motion import PLANES
from feeddrive.path.program.moves import Arc, Command, Move, Orientation, Point, Spline, sweep
from feeddrive.path.program.state import LINEAR, rotated

Travel = Mapping[str, tuple[float, float] | None]
"""The travel by axis letter: lowest and highest coordinate (m, rad), or None for an axis without travel limits."""
ROUNDING = 1e-9
"""The distance by which a coordinate may exceed the travel, m or rad: the rounding of 15 digits at `FARTHEST`."""

TILTED = 1e-7
"""The largest distance of the curves that stand for an arc in a plane rotated by G10 R from this arc, m."""

SWING = math.radians(5.0)
"""The largest angle by which the tool may leave the plane between its directions at both ends of a feed, rad."""

_ZERO = (0.0,) * 9
_CANON_PLANES = {"CANON_PLANE_XY": PLANES[170], "CANON_PLANE_XZ": PLANES[180], "CANON_PLANE_YZ": PLANES[190]}
_PATH_MODES = {"CANON_EXACT_PATH": "exact_path", "CANON_EXACT_STOP": "exact_stop", "CANON_CONTINUOUS": "continuous"}
_SILENT = {
    "COMMENT",
    "LOG",
    "ON_RESET",
    "SET_FEED_REFERENCE",
    "START_CHANGE",
    "TURN_PROBE_ON",
    "TURN_PROBE_OFF",
    "SET_TOOL_TABLE_ENTRY",
    "SET_SPINDLE_MODE",
}
_SWITCHES = {
    "MIST_ON": "mist",
    "FLOOD_ON": "flood",
    "MIST_OFF": "mist",
    "FLOOD_OFF": "flood",
    "PALLET_SHUTTLE": "pallet",
}
_NUMBERED = ("SET_MOTION_OUTPUT_", "CLEAR_MOTION_OUTPUT_", "SET_AUX_OUTPUT_", "CLEAR_AUX_OUTPUT_")


def _travel_by_axis(axes: Travel) -> list[tuple[float, float] | None]:
    """Return the travel of each of the nine axes; refuse an unknown axis name and an empty travel range."""
    for name, travel in axes.items():
        if name.lower() not in AXES or len(name) != 1:
            raise ParameterError(f"axes: {name!r} is no axis of part programs, which are X Y Z A B C U V W")
        if travel is not None and not (math.isfinite(travel[0] + travel[1]) and travel[0] < travel[1]):
            raise ParameterError(
                f"axes: the travel of {name} is {travel}, in m or rad; its least end lies below its most"
            )
    return [axes.get(letter.upper(), axes.get(letter)) for letter in AXES]


def _unit(axis: int, rotation: float) -> list[float]:
    """Return the direction of an axis of the program in machine coordinates, for a rotation about Z in degrees."""
    unit = [0.0] * 9
    unit[axis] = 1.0
    unit[0], unit[1] = rotated(unit[0], unit[1], rotation)
    return unit


class Frame:
    """The converter of commands to moves, with units, plane, offsets and the machine's position as its state.

    axes        the axes of the machine with their travel; None for all nine without travel limits
    kinematics  kinematics of the machine, with which moves may be those of the tip of the tool
    start       position of the machine before the first move, m and rad

    Raises ParameterError for a start that the machine cannot have.
    """

    def __init__(
        self,
        axes: Travel | None = None,
        kinematics: Kinematics | None = None,
        start: Mapping[str, float] | None = None,
    ) -> None:
        self._kinematics = kinematics
        self._tool_point: Kinematics | None = None
        self._rotary: list[int] = []  # of the kinematics in use
        self._orientation: Orientation = "axes"
        self._off = self._off_here = (
            0.0  # angle of the tool from its programmed direction: at the next points, and here
        )
        self._travel = None if axes is None else _travel_by_axis(axes)
        self._present = None if axes is None else [letter in {name.lower() for name in axes} for letter in AXES]
        self._here: Point = _ZERO if start is None else self.place(start)
        # divisors, not factors: 1/1000 is not exact in binary, and a product with it would be rounded twice
        self._divisors = [1000.0] * 9
        self._rotation = 0.0
        self._system = 1
        self._origin = self._axis_offset = self._tool_offset = _ZERO
        # the sum of the offsets is kept until one of them changes, since most moves follow no change
        self._shift: list[float] | None = None
        self._plane = PLANES[170]
        self._per_turn = False
        self._speed, self._direction = 0.0, 0
        self._selected = 0
        self._makers: dict[str, Callable[[Command], Move | list[Move] | None]] = {
            "STRAIGHT_FEED": self._feed_to,
            "STRAIGHT_TRAVERSE": self._traverse_to,
            "ARC_FEED": self._arc,
            "NURBS_FEED": self._spline,
            "BEZIER_FEED": self._bezier,
            "DWELL": lambda c: moves.Dwell(c.line, float(c.values[0])),
            "SET_MOTION_CONTROL_MODE": self._path_mode,
            "SET_NAIVECAM_TOLERANCE": self._naive,
            "SET_FEED_RATE": self._feed,
            "SET_FEED_MODE": self._feed_mode,
            "USE_LENGTH_UNITS": self._units,
            "SELECT_PLANE": self._select_plane,
            "SET_G5X_OFFSET": self._work_offset,
            "SET_G92_OFFSET": self._set_axis_offset,
            "SET_XY_ROTATION": self._set_rotation,
            "USE_TOOL_LENGTH_OFFSET": self._set_tool_offset,
            "TOOL_POINT": self._set_tool_point,
            "ORIENTATION": self._turn_by,
            "TOOL_OFF_AXIS": self._turn_off,
            "SET_SPINDLE_SPEED": self._spindle,
            "START_SPINDLE_CLOCKWISE": self._spindle,
            "START_SPINDLE_COUNTERCLOCKWISE": self._spindle,
            "STOP_SPINDLE_TURNING": self._spindle,
            "START_SPEED_FEED_SYNC": lambda c: moves.Synchronized(c.line, float(c.values[0]) / self._divisors[0]),
            "STOP_SPEED_FEED_SYNCH": lambda c: moves.Synchronized(c.line, 0.0),
            "SELECT_TOOL": self._select_tool,
            "CHANGE_TOOL": lambda c: moves.ToolChange(c.line, self._selected),
            "CHANGE_TOOL_NUMBER": lambda c: moves.ToolChange(c.line, int(float(c.values[0]))),
            "MESSAGE": lambda c: moves.Message(c.line, str(c.values[0])),
            "IGNORED": lambda c: moves.Ignored(c.line, str(c.values[0])),
            "PRINT": lambda c: moves.Message(c.line, str(c.values[0])),
            "RESUME": lambda c: moves.Begin(c.line, self._here, str(c.values[0])),
            "PROGRAM_STOP": lambda c: moves.Stop(c.line, False),
            "OPTIONAL_PROGRAM_STOP": lambda c: moves.Stop(c.line, True),
            "STRAIGHT_PROBE": self._probe,
            "EXACT_STOP": lambda c: moves.ExactStop(c.line, False),
            "ORIENT_SPINDLE": lambda c: moves.Spindle(c.line, self._speed, self._direction),
            "WAIT": lambda c: moves.Wait(c.line, False),
            "PROGRAM_END": lambda c: moves.End(c.line),
            "FINISH": lambda c: moves.End(c.line),
        }
        self._mode: moves.PathMode | None = None

    def place(self, start: Mapping[str, float]) -> Point:
        """Return the point of a start position, m and rad, by axis letters; axes that are not named are at zero.

        Raises ParameterError for an axis that the machine does not have, and a position beyond its travel.
        """
        point = [0.0] * 9
        for letter, value in start.items():
            axis = AXES.find(letter.lower()) if len(letter) == 1 else -1
            if axis < 0 or (self._present is not None and not self._present[axis]):
                there = [name.upper() for k, name in enumerate(AXES) if self._present is None or self._present[k]]
                raise ParameterError(f"start: the machine has no axis {letter}; it has {', '.join(there)}")
            travel = None if self._travel is None else self._travel[axis]
            low, high = travel or (-FARTHEST, FARTHEST)
            if not low <= value <= high:
                unit = "rad" if 3 <= axis <= 5 else "m"
                form = "deg" if 3 <= axis <= 5 else "mm"
                raise ParameterError(
                    Text(
                        f"start: axis {letter.upper()} at {Quantity(value, unit):{form}} is beyond its travel of "
                        f"{Quantity(low, unit):{form}} to {Quantity(high, unit):{form}}: give the position at which "
                        "it stands"
                    )
                )
            point[axis] = float(value)
        return tuple(point)

    def moves(self, commands: Iterable[Command]) -> Iterator[Move]:
        """Yield the moves of the commands."""
        for command in commands:
            maker = self._makers.get(command.name)
            try:
                move = maker(command) if maker else self._other(command)
            except BlockError as fault:
                raise located(command.line, fault) from None
            if isinstance(move, list):
                yield from move
            elif move is not None:
                yield move

    # coordinates

    def _machine(self, values: Point) -> Point:
        """Convert program coordinates to machine coordinates in SI units."""
        if self._shift is None:
            self._shift = self._sum_of_offsets()
        if len(values) < 9:
            values += _ZERO[len(values) :]
        if not self._rotation:
            return tuple([v / d + s for v, d, s in zip(values, self._divisors, self._shift, strict=True)])
        point = [v / d + a for v, d, a in zip(values, self._divisors, self._axis_offset, strict=True)]
        point[0], point[1] = rotated(point[0], point[1], self._rotation)
        return tuple([p + s for p, s in zip(point, self._shift, strict=True)])

    def _sum_of_offsets(self) -> list[float]:
        parts = (
            (self._origin, self._tool_offset)
            if self._rotation
            else (self._axis_offset, self._origin, self._tool_offset)
        )
        return [sum(components) for components in zip(*parts, strict=True)]

    def _check(self, start: Point, end: Point, travel: bool = True) -> None:
        """Refuse an end point that moves an absent axis or, if `travel`, lies outside the travel."""
        if not (-FARTHEST <= min(end) <= max(end) <= FARTHEST and math.isfinite(sum(end))):
            axis = next(axis for axis, value in enumerate(end) if not abs(value) <= FARTHEST)
            raise BlockError(
                f"the coordinate {Quantity(end[axis]):6} is farther than {Quantity(FARTHEST, 'm', stays=True):6 SI} "
                "or rad: check units and offsets",
                AXES[axis].upper(),
            )
        if self._present is None:
            return
        for axis, value in enumerate(end):
            # an axis outside its travel may stay there, as at the start of a program
            if value == start[axis]:
                continue
            if not self._present[axis]:
                letter = AXES[axis].upper()
                there = " ".join(name.upper() for name, here in zip(AXES, self._present, strict=True) if here)
                raise BlockError(f"the machine has no axis {letter}; it has {there}: take the word out", letter)
            # the joints of the linear axes are not known before the path of the tip is joined
            if travel and not (self._tool_point and axis < 3):
                self._check_travel(axis, value)

    def _check_turn(self, start: Point, end: Point, traverse: bool) -> None:
        """Refuse an angle wound too far, and a feed in which the tool swings far from the plane of both directions."""
        assert self._tool_point is not None
        turn = 0.0
        for axis in self._rotary:
            turn = max(turn, abs(end[axis] - start[axis]))
            if abs(end[axis]) > MOST_WOUND:
                raise BlockError(
                    f"axis {AXES[axis].upper()} would be wound to {Quantity(end[axis], 'rad'):deg}, and at most "
                    f"{Quantity(MOST_WOUND, 'rad'):deg} are planned: unwind it in the program",
                    AXES[axis].upper(),
                )
        # many blocks turn by little: theirs need no look
        if traverse or turn < SWING or self._orientation != "axes":
            return
        rotary = np.array([[start[axis], end[axis]] for axis in self._rotary])
        if len(leaves_arc(self._tool_point, rotary, SWING)):
            letter = max(self._rotary, key=lambda axis: abs(end[axis] - start[axis]))
            raise BlockError(
                f"axis {AXES[letter].upper()} turns by {Quantity(abs(end[letter] - start[letter]), 'rad'):deg} in this "
                f"feed, and the tool swings by more than {Quantity(SWING, 'rad'):deg} beside the plane of its "
                "directions at both ends, as where the branch or the turn changes: lift the tool and write G0, or give "
                "blocks between if the swing is meant",
                AXES[letter].upper(),
            )

    def _check_curve(self, move: Arc | Spline) -> None:
        """Refuse a curve of the tip in which the tool turns in a plane."""
        if self._orientation == "axes":
            return
        through = move.points if isinstance(move, Spline) else ()
        for axis in self._rotary:
            if any(point[axis] != move.start[axis] for point in (*through, move.end)):
                raise BlockError(
                    f"axis {AXES[axis].upper()} turns along a curve, where the tool turns by axes only, not by "
                    f"{self._orientation}: write G1 in short blocks, or G49 and then the tool point by axes",
                    AXES[axis].upper(),
                )

    def _check_travel(self, axis: int, value: float) -> None:
        travel = self._travel[axis] if self._travel else None
        if travel is None or travel[0] - ROUNDING <= value <= travel[1] + ROUNDING:
            return
        letter = AXES[axis].upper()
        unit, shown = ("m", "6 mm") if axis in LINEAR else ("rad", "6 deg")
        place, least, most = (Quantity(x, unit, form=shown, stays=True) for x in (value, *travel))
        raise BlockError(
            f"axis {letter} would go to {place} in machine coordinates, its travel is "
            f"{replace(least, bare=True)}..{most}: move the work offset, or shorten the move",
            letter,
        )

    def _feed_to(self, command: Command) -> Move | None:
        return self._straight(command, False)

    def _traverse_to(self, command: Command) -> Move | None:
        return self._straight(command, True)

    def _probe(self, command: Command) -> list[Move]:
        move, stop = self._straight(command, False), moves.Probe(command.line, False)
        return [stop, *([] if move is None else [move]), stop]

    def _straight(self, command: Command, traverse: bool) -> Move | None:
        start, end = self._here, self._machine(cast("Point", command.values))
        if end == start:
            return None
        self._check(start, end)
        if self._tool_point:
            self._check_turn(start, end, traverse)
        self._here = end
        off = max(self._off, self._off_here)
        self._off_here = self._off
        return moves.Straight(command.line, start, end, traverse, "axes" if traverse else self._orientation, off)

    def _arc(self, command: Command) -> Move | list[Move]:
        numbers = [float(value) for value in command.values]
        first, second, across = self._plane
        program = list(_ZERO)
        program[first], program[second], program[across] = numbers[0], numbers[1], numbers[5]
        program[3 : 3 + len(numbers) - 6] = numbers[6:]
        middle = list(program)
        middle[first], middle[second] = numbers[2], numbers[3]
        start, end, center = self._here, self._machine(tuple(program)), self._machine(tuple(middle))
        turns = int(numbers[4])
        if self._rotation and across != 2:
            # rotated about Z it lies in one of the three planes after quarters of a turn only
            quarters = round(self._rotation / 90.0)
            if self._rotation != 90.0 * quarters:
                return self._tilted(command.line, end, center, turns)
            c, s = ((1, 0), (0, 1), (-1, 0), (0, -1))[quarters % 4]
            if s:
                first, second, across = PLANES[190] if across == 1 else PLANES[180]
            # the normal, seen from which the arc turns, may have become that of the other side
            turns *= c + s if self._plane[2] == 0 else c - s
        arc = Arc(command.line, start, end, (first, second, across), (center[first], center[second]), turns, self._off)
        self._check(start, end)
        self._check_curve(arc)
        if self._travel is not None and not self._tool_point:
            self._check_extremes(arc)
        self._here = end
        return arc

    def _tilted(self, line: Line, end: Point, center: Point, turns: int) -> list[Move]:
        """Return an arc whose plane lies along none of the axes as Bezier curves within `TILTED`.

            r(θ) = center + u cos θ + v sin θ + (θ/φ) drift      drift: along the normal, of other axes, of the radius

        A cubic Hermite curve over the angle Δ is within |r''''| Δ⁴/384 = R Δ⁴/384 of it; the drift is exact.
        """
        start = self._here
        first, second, across = (_unit(axis, self._rotation) for axis in self._plane)
        center = tuple(s if axis > 2 else c for axis, (s, c) in enumerate(zip(start, center, strict=True)))
        # the start lies at the level of the center, and the end anywhere along the normal
        level = sum(n * (s - c) for n, s, c in zip(across, start, center, strict=False))
        center = tuple(c + level * n for c, n in zip(center, across, strict=True))
        sides = [
            tuple(sum(e * (p - c) for e, p, c in zip(unit, point, center, strict=False)) for unit in (first, second))
            for point in (start, end)
        ]
        (x, y), (far, high) = sides
        angle = sweep((x, y), (far, high), (0.0, 0.0), turns)
        u = [x * a + y * b for a, b in zip(first, second, strict=True)]
        v = [x * b - y * a for a, b in zip(first, second, strict=True)]
        c, s = math.cos(angle), math.sin(angle)
        drift = [e - m - c * a - s * b for e, m, a, b in zip(end, center, u, v, strict=True)]
        count = max(1, math.ceil(abs(angle) * (math.hypot(x, y) / (384.0 * TILTED)) ** 0.25))
        if count > MOST_COMMANDS:
            reason = (
                f"this arc in a rotated plane makes {count} curves, and a block at most {MOST_COMMANDS}: fewer turns"
            )
            raise located(line, BlockError(reason, "P"))

        def state(k: int) -> tuple[list[float], list[float]]:
            c, s = math.cos(angle * k / count), math.sin(angle * k / count)
            at = [m + c * a + s * b + k / count * d for m, a, b, d in zip(center, u, v, drift, strict=True)]
            third = angle / (3.0 * count)
            return at, [third * (c * b - s * a) + d / (3.0 * count) for a, b, d in zip(u, v, drift, strict=True)]

        curves: list[Move] = []
        at, slope = state(0)
        for k in range(1, count + 1):
            to, behind = state(k)
            if k == count:
                to = list(end)
            points = [[p + t for p, t in zip(at, slope, strict=True)], [p - t for p, t in zip(to, behind, strict=True)]]
            curves.append(self._through(line, [tuple(point) for point in (*points, to)]))
            at, slope = to, behind
        return curves

    def _check_extremes(self, arc: Arc) -> None:
        """Check that an arc's extreme points on both axes of its plane lie within the travel."""
        first, second, _ = arc.axes
        begin = math.atan2(arc.start[second] - arc.center[1], arc.start[first] - arc.center[0])
        angle, radius = arc.angle, arc.radius
        for quarter in range(4):
            direction = quarter * math.pi / 2
            ahead = (direction - begin) % math.tau if angle > 0 else (begin - direction) % math.tau
            if ahead < abs(angle):
                axis, sign = ((first, 1), (second, 1), (first, -1), (second, -1))[quarter]
                self._check_travel(axis, arc.center[0 if axis == first else 1] + sign * radius)

    def _spline(self, command: Command) -> Move:
        values = [float(value) for value in command.values if isinstance(value, float)]
        if len(values) < 4:
            raise BlockError("the interpreter of LinuxCNC prints no points of a spline: use the own reader", "G5")
        here = self._program_here()
        points = [self._machine((x, y, *here[2:])) for x, y in zip(values[::2], values[1::2], strict=True)]
        return self._through(command.line, points)

    def _bezier(self, command: Command) -> Move:
        values = cast("tuple[float, ...]", command.values)
        return self._through(command.line, [self._machine(values[k : k + 9]) for k in range(0, len(values), 9)])

    def _through(self, line: Line, points: list[Point]) -> Move:
        """Return the Bezier curve from here with these control points; refuse one that leaves the travel."""
        start = self._here
        spline = Spline(line, start, points[-1], tuple(points[:-1]), self._off)
        self._check_curve(spline)
        # control points lie beside the curve: they may lie outside the travel
        for point in points:
            self._check(start, point, travel=point is points[-1])
        for axis in range(9):
            limited = self._travel and self._travel[axis] and not (self._tool_point and axis < 3)
            for value in spline.turns(axis) if limited else ():
                self._check_travel(axis, value)
        self._here = points[-1]
        return spline

    def _program_here(self) -> list[float]:
        """Return the machine's position in program coordinates; valid only for axes that a spline does not move."""
        if self._shift is None:
            self._shift = self._sum_of_offsets()
        here = [h - s for h, s in zip(self._here, self._shift, strict=True)]
        if self._rotation:
            here = [h - a for h, a in zip(here, self._axis_offset, strict=True)]
        return [h * d for h, d in zip(here, self._divisors, strict=True)]

    # modes

    def _units(self, command: Command) -> None:
        length = {"CANON_UNITS_MM": 1000.0, "CANON_UNITS_INCHES": 1000.0 / 25.4, "CANON_UNITS_CM": 100.0}[
            str(command.values[0])
        ]
        self._divisors = [length if axis in LINEAR else math.degrees(1.0) for axis in range(9)]

    def _select_plane(self, command: Command) -> None:
        plane = _CANON_PLANES.get(str(command.values[0]))
        if plane is None:
            raise BlockError("this plane is none of XY, ZX and YZ: write G17, G18 or G19", "G")
        self._plane = plane

    def _path_mode(self, command: Command) -> Move:
        mode = _PATH_MODES[str(command.values[0])]
        tolerance = float(command.values[1]) / self._divisors[0] if len(command.values) > 1 else 0.0
        self._mode = moves.PathMode(command.line, mode, tolerance, tolerance)
        return self._mode

    def _naive(self, command: Command) -> Move | None:
        naive = float(command.values[0]) / self._divisors[0]
        mode = self._mode
        if mode is None or naive == mode.naive_tolerance:
            return None
        self._mode = moves.PathMode(command.line, mode.mode, mode.tolerance, naive)
        return self._mode

    def _feed_mode(self, command: Command) -> None:
        self._per_turn = bool(int(float(command.values[1])))

    def _feed(self, command: Command) -> Move:
        rate = float(command.values[0])
        seconds = 1.0 if self._per_turn else 60.0
        return moves.Feed(
            command.line, rate / self._divisors[0] / seconds, math.radians(rate) / seconds, self._per_turn
        )

    def _spindle(self, command: Command) -> Move:
        number = int(float(command.values[0]))
        if number > 0:
            # another spindle than that of the feed per turn
            on = {"START_SPINDLE_CLOCKWISE": 1.0, "START_SPINDLE_COUNTERCLOCKWISE": -1.0}.get(command.name, 0.0)
            what = "speed of spindle" if command.name == "SET_SPINDLE_SPEED" else "spindle"
            return moves.Switch(command.line, f"{what} {number}", float(command.values[-1]) if "speed" in what else on)
        if command.name == "SET_SPINDLE_SPEED":
            self._speed = float(command.values[-1])
        else:
            self._direction = {"START_SPINDLE_CLOCKWISE": 1, "START_SPINDLE_COUNTERCLOCKWISE": -1}.get(command.name, 0)
        return moves.Spindle(command.line, self._speed, self._direction)

    def _select_tool(self, command: Command) -> None:
        # kept for CHANGE_TOOL, whose value in LinuxCNC is a row of the tool table and not the tool's number
        self._selected = int(float(command.values[0]))

    # offsets

    def _lengths(self, values: tuple[float | str, ...]) -> Point:
        coordinates = tuple(float(value) / divisor for value, divisor in zip(values, self._divisors, strict=False))
        return coordinates + _ZERO[len(coordinates) :]

    def _work_offset(self, command: Command) -> Move:
        self._system = int(float(command.values[0]))
        self._origin = self._lengths(command.values[1:])
        return self._offsets(command.line)

    def _set_axis_offset(self, command: Command) -> Move:
        self._axis_offset = self._lengths(command.values)
        return self._offsets(command.line)

    def _set_rotation(self, command: Command) -> Move | None:
        rotation = float(command.values[0])
        if rotation == self._rotation:
            return None
        self._rotation = rotation
        return self._offsets(command.line)

    def _set_tool_offset(self, command: Command) -> Move:
        self._tool_offset = self._lengths(command.values)
        return self._offsets(command.line)

    def _set_tool_point(self, command: Command) -> Move:
        """Change to the tip of the tool, or back to the joints; the machine does not move."""
        on, *offset = (float(value) for value in command.values)
        kinematics = self._kinematics if on else self._tool_point
        assert kinematics is not None
        if on and any(offset):
            x, y, z = offset
            kinematics = replace(kinematics, tool=(-x, -y, -z))
        self._rotary = [AXES.index(letter.lower()) for letter in kinematics.rotary_letters]
        convert = kinematics.tip if on else kinematics.linear
        here = convert(self._here[:3], [self._here[axis] for axis in self._rotary])
        self._here = (*(float(x) for x in here), *self._here[3:])
        self._tool_point = kinematics if on else None
        self._orientation, self._off, self._off_here = "axes", 0.0, 0.0
        self._tool_offset = _ZERO
        self._shift = None
        return moves.ToolPoint(command.line, self._tool_point)

    def _turn_by(self, command: Command) -> None:
        self._orientation = cast("Orientation", command.values[0])

    def _turn_off(self, command: Command) -> None:
        self._off = math.radians(float(command.values[0]))

    def _offsets(self, line: Line) -> Move:
        self._shift = None
        rotation = math.radians(self._rotation)
        return moves.Offsets(line, self._system, self._origin, rotation, self._axis_offset, self._tool_offset)

    def _other(self, command: Command) -> Move | None:
        name, values = command.name, command.values
        if name in _SILENT:
            return None
        if name in _SWITCHES:
            return moves.Switch(command.line, _SWITCHES[name], float(not name.endswith("_OFF")))
        state, _, what = name.partition("_")
        if state in ("ENABLE", "DISABLE"):
            return moves.Switch(command.line, what.lower(), float(state == "ENABLE"))
        if name.startswith(_NUMBERED):
            number, *value = values
            return moves.Switch(command.line, f"output {number}", float(value[0]) if value else float(state == "SET"))
        raise BlockError(f"the command {name} of the interpreter cannot be planned: take it out of the program")

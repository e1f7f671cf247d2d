"""The state of a part program: modes, position, tools, and the offsets between program and machine, with their codes.

machine = R(rotation) (program + axis_offset) + origin + tool_offset          rotation in the XY plane, degrees

G10, G43, G49, G52, G54 to G59.3 and G92 shift coordinates without motion; G28 and G30 move to a stored position.
"""

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from feeddrive.language.errors import FileError, shown
from feeddrive.language.quantity import Quantity
from feeddrive.path.kinematics import Kinematics
from feeddrive.path.program.aiming import BY_AXES, Aiming
from feeddrive.path.program.blocks import AXES, Block, BlockError, Parameters, name_of
from feeddrive.path.program.compensation import Compensation
from feeddrive.path.program.moves import ORIENTATIONS, Command, Orientation
from feeddrive.path.program.nurbs import Nurbs
from feeddrive.path.program.siemens_splines import PointSpline

_WORD = re.compile(r"([A-Za-z])([+-]?(?:\d+\.?\d*|\.\d+))\s*")
_AXES = "XYZABCUVW"


@dataclass(frozen=True, slots=True)
class Tool:
    """A tool: `offset` of X Y Z A B C U V W and `diameter` in the unit of the table (mm or inch, and degrees)."""

    number: int
    pocket: int
    offset: tuple[float, ...] = (0.0,) * 9
    diameter: float = 0.0
    front_angle: float = 0.0
    back_angle: float = 0.0
    orientation: int = 0
    remark: str = ""


def read_tools(path: Path | str) -> dict[int, Tool]:
    """Read the tools of a `.tbl` file by number: lines such as `T1 P1 Z0.5 D0.0625 ;drill`."""
    file = Path(path)
    try:
        text = file.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise FileError(f"{file}: cannot be read: {error.strerror or error}") from None
    tools: dict[int, Tool] = {}
    for number, line in enumerate(text.splitlines(), 1):
        entry, _, remark = line.partition(";")
        if entry.strip():
            tool = _tool(file, number, entry.strip(), remark.strip())
            if tool.number in tools:
                raise FileError(
                    f"{file}, line {number}: tool T{tool.number} stands there twice: delete one of the lines"
                )
            tools[tool.number] = tool
    return tools


def _tool(file: Path, number: int, entry: str, remark: str) -> Tool:
    words: dict[str, float] = {}
    at = 0
    while at < len(entry):
        match = _WORD.match(entry, at)
        letter = match[1].upper() if match else ""
        if not match or letter not in f"TPDIJQ{_AXES}" or letter in words or not math.isfinite(float(match[2])):
            raise FileError(
                f"{file}, line {number}, column {at + 1}: {shown(entry[at : at + 20])}: a tool has the words "
                "T P X Y Z A B C U V W D I J Q, each once with a number"
            )
        words[letter] = float(match[2])
        at = match.end()
    for letter in "TPQ":
        value = words.get(letter, 0.0)
        if value != round(value) or not 0 <= value <= 99999:
            raise FileError(
                f"{file}, line {number}: {letter}{Quantity(value):6}: a whole number from 0 to 99999 is expected"
            )
    if "T" not in words:
        raise FileError(f"{file}, line {number}: the tool has no number: write T and its number")
    return Tool(
        round(words["T"]),
        round(words.get("P", words["T"])),
        tuple(words.get(letter, 0.0) for letter in _AXES),
        words.get("D", 0.0),
        words.get("I", 0.0),
        words.get("J", 0.0),
        round(words.get("Q", 0.0)),
        remark,
    )


LINEAR = (0, 1, 2, 6, 7, 8)
"""The indices of the linear axes X Y Z U V W; coordinates of the others are in degrees."""
INCH = 25.4
# the numbers of parameters in a .var file are fixed by LinuxCNC
SYSTEM, G92_ON, G92, HOME_1, HOME_2 = 5220, 5210, 5211, 5161, 5181
# the point where a probe touched, behind which #5070 is 1 if it did; and what M66 read
TOUCHED, READ_INPUT = 5061, 5399
SYSTEMS = 9
EXTRUDER = AXES.index("u")
"""The axis that stands for E of a 3D printer."""

Emit = Callable[..., None]
"""The function that writes a canonical command, called with its name and then its values."""


def rotated(x: float, y: float, degrees: float) -> tuple[float, float]:
    """Rotate a point about the origin by an angle in degrees."""
    if degrees == 0:
        return x, y
    angle = math.radians(degrees)
    c, s = math.cos(angle), math.sin(angle)
    return c * x - s * y, s * x + c * y


class Names(NamedTuple):
    """The words of a language of which the messages of all languages speak.

    tool_point  from here on X Y Z are the tip of the tool
    joints      ends it
    """

    tool_point: str = "G43.4, G43.5"
    joints: str = "G49"


class State:
    """The modal state of a program, and the position in program coordinates and in the program's length unit.

    inch      True if the program's unit is the inch
    user_inch True if parameters and tables are stored in inches
    motion    the modal motion as ten times the code: 10 for G1; 800 for none
    cycle     sticky words of a series of canned cycles
    level     initial level of these cycles: axis and coordinate
    compensation  the radius compensation, if it is on; `position` is then that of the programmed contour
    extruder_incremental  `incremental` for the axis U, which G90 and G91 set too, and M82 and M83 of a printer alone
    nurbs         the curve of G5.2 or G6.2 whose control points are being read
    spline        the spline of SINUMERIK whose points are being read, or whose end waits for the next move
    leaving       the position of the tool's center between G40 and the next move; otherwise None
    kinematics    the kinematics of the machine, if it has any
    tool_point    the kinematics with the tool, while X Y Z are its tip in the frame of the workpiece; otherwise None
    aims          True if a block then gives the direction of the tool by I J K (G43.5)
    aiming        the commands that wait for the rotary joints of their directions
    orientation   how the tool turns between two directions now
    turning       how the tool turns where the program does not say
    names         words of the program's language in messages
    """

    def __init__(
        self,
        parameters: Parameters,
        user_inch: bool,
        kinematics: Kinematics | None = None,
        names: Names | None = None,
    ) -> None:
        self.parameters = parameters
        self.names = names or Names()
        self.kinematics, self.aims = kinematics, False
        self.tool_point: Kinematics | None = None
        self.aiming, self.turning = Aiming(), BY_AXES
        self.orientation: Orientation = "axes"
        self.user_inch = user_inch
        self.inch = False
        self.position = [0.0] * 9
        self.origin = [0.0] * 9
        self.rotation = 0.0
        self.axis_offset = [0.0] * 9
        self.tool_offset = [0.0] * 9
        self.system = 1
        self.motion = 800
        self.plane = 170
        self.feed_mode = 940
        self.feed = 0.0
        self.feed_override = True
        self.speed_override = True
        self.adaptive_feed = self.feed_hold = True
        self.incremental = False
        self.extruder_incremental = False
        self.arc_absolute = False
        self.retract_to_r = True
        self.path_mode = "CANON_CONTINUOUS"
        self.tolerance = 0.0
        self.naive_tolerance = 0.0
        self.spindle = 0
        self.speed = 0.0
        self.tool = 0
        self.selected = 0
        self.mist = self.flood = False
        self.cycle: dict[str, float] = {}
        self.level: tuple[int, float] | None = None
        self.compensation: Compensation | None = None
        self.nurbs: Nurbs | None = None
        self.spline: PointSpline | None = None
        self.leaving: list[float] | None = None

    # units

    @property
    def scale(self) -> float:
        """The number of program length units per user unit."""
        return 1.0 if self.inch == self.user_inch else INCH if self.user_inch else 1.0 / INCH

    def use_inch(self, inch: bool) -> None:
        """Change the program's length unit; the machine's position is unchanged."""
        if inch != self.inch:
            self.inch = inch
            if self.level:
                axis, level = self.level
                self.level = axis, level / INCH if inch else level * INCH
            for values in (self.position, self.origin, self.axis_offset, self.tool_offset):
                for axis in LINEAR:
                    values[axis] = values[axis] / INCH if inch else values[axis] * INCH
            # the length stays, not its number, as in LinuxCNC itself; stand-alone rs274 keeps the number
            for name in ("tolerance", "naive_tolerance"):
                value = getattr(self, name)
                setattr(self, name, value / INCH if inch else value * INCH)

    def stored(self, first: int) -> list[float]:
        """Return nine parameters from `first` on, in the program's unit."""
        values = [self.parameters.numbered.get(first + axis, 0.0) for axis in range(9)]
        return self.to_program(values)

    def store(self, first: int, values: Sequence[float]) -> None:
        """Store nine values as parameters, in the user's unit."""
        scale = self.scale
        for axis, value in enumerate(values):
            self.parameters.numbered[first + axis] = value / scale if axis in LINEAR else value

    @property
    def meters(self) -> float:
        """The number of program length units per meter."""
        return 1000.0 / INCH if self.inch else 1000.0

    def to_program(self, values: Sequence[float]) -> list[float]:
        """Convert nine values from the user's unit to the program's."""
        scale = self.scale
        return [value * scale if axis in LINEAR else value for axis, value in enumerate(values)]

    # directions of the tool

    def aim(self, target: list[float], direction: Sequence[float], words: str, at_once: bool = False) -> None:
        """Let the next motion, to a target, end with a direction of the tool, both in program coordinates.

        words    of the program that give the direction, such as I J K
        at_once  True if its rotary axes must be chosen now and not with those behind: on a curve that is not yet known

        Under G93, where the feed depends on their way, they are always chosen at once.
        Raises BlockError for a direction without length.
        """
        assert self.tool_point is not None
        length = math.hypot(*direction)
        word = words.split()[0]
        if not length > 0.0:
            upright = " ".join(f"{name}{'=' if len(name) > 1 else ''}{k // 2}" for k, name in enumerate(words.split()))
            raise BlockError(
                f"the direction of the tool {words} has no length: write {upright} for an upright tool", word
            )
        x, y, z = (component / length for component in direction)
        x, y = rotated(x, y, self.rotation)
        axes = [AXES.index(letter.lower()) for letter in self.tool_point.rotary_letters]
        machine = self.machine(self.position)
        start = [math.radians(machine[axis]) for axis in axes]
        shift = [math.radians(machine[axis] - self.position[axis]) for axis in axes]
        at_once = at_once or self.feed_mode == 930
        if at_once:
            self.settle()
        deviates = (
            not at_once and self.path_mode == "CANON_CONTINUOUS" and (self.tolerance > 0.0 or self.turning.always)
        )
        cone = self.turning.cone if deviates else 0.0
        here, there = ([coordinate / self.meters for coordinate in point[:3]] for point in (self.position, target))
        self.aiming.begin(self.tool_point, here, start, shift, cone, self.orientation)
        self.aiming.aim(np.array((x, y, z)), there, word)
        if at_once:
            before = list(self.position)
            self.settle()
            for axis in axes:
                target[axis] = self.position[axis]
            self.position = before

    def settle(self) -> None:
        """Choose the rotary axes of all motions that wait."""
        if self.aiming.waits:
            self.aiming.settle()
            for axis, angle in self.aiming.position.items():
                self.position[axis] = angle

    def take(self, command: Command) -> list[Command]:
        """Return the commands that are finished with a command, which may wait for a direction behind it."""
        if not self.aiming.holds(command):
            self.settle()
        return self.aiming.take(command)

    # coordinates

    def machine(self, program: Sequence[float]) -> list[float]:
        """Convert program coordinates to machine coordinates."""
        shifted = [p + a for p, a in zip(program, self.axis_offset, strict=True)]
        shifted[0], shifted[1] = rotated(shifted[0], shifted[1], self.rotation)
        return [s + o + t for s, o, t in zip(shifted, self.origin, self.tool_offset, strict=True)]

    def coordinate(self, axis: int) -> float:
        """Return the position of one axis, as `here`."""
        if 3 <= axis <= 5:
            self.settle()
        return self.here()[axis]

    def here(self) -> list[float]:
        """Return the position of the tool in program coordinates, with radius compensation that of its center."""
        return self.compensation.position(self.position) if self.compensation else self.position

    def program(self, machine: Sequence[float]) -> list[float]:
        """Convert machine coordinates to program coordinates."""
        shifted = [m - o - t for m, o, t in zip(machine, self.origin, self.tool_offset, strict=True)]
        shifted[0], shifted[1] = rotated(shifted[0], shifted[1], -self.rotation)
        return [s - a for s, a in zip(shifted, self.axis_offset, strict=True)]

    def keep_machine(
        self,
        origin: Sequence[float] | None = None,
        rotation: float | None = None,
        axis_offset: Sequence[float] | None = None,
        tool_offset: Sequence[float] | None = None,
    ) -> None:
        """Change offsets without moving the machine; the program coordinates of its position change."""
        self.settle()
        # G10, G43, G92 ... never move the machine (unlike rs274 after G92, see docs/reference/part_programs.md)
        standing = self.machine(self.position)
        before = self.position
        if origin is not None:
            self.origin = list(origin)
        if rotation is not None:
            self.rotation = rotation
        if axis_offset is not None:
            self.axis_offset = list(axis_offset)
        if tool_offset is not None:
            self.tool_offset = list(tool_offset)
        self.position = self.program(standing)
        if self.level:
            axis, level = self.level
            self.level = axis, level + self.position[axis] - before[axis]

    def words(self) -> str:
        """Return the modal state as the words that set it, such as G21 G17 G90 G94 G64 P0.01 G40 G54 T3 S8000 M3.

        Not F: its number belongs to the unit that held when it was written.
        """
        mode = {"CANON_EXACT_PATH": "G61", "CANON_EXACT_STOP": "G61.1"}.get(self.path_mode, "G64")
        if mode == "G64" and self.tolerance:
            mode += f" P{self.tolerance:.6g}"
        system = next(code for code, system in BY_CODE.items() if system == self.system)
        words = [
            "G20" if self.inch else "G21",
            name_of("g", self.plane),
            "G91" if self.incremental else "G90",
            name_of("g", self.feed_mode),
            mode,
            "G40",
            name_of("g", system),
            f"T{self.tool}",
            f"S{self.speed:.6g} {'M3' if self.spindle > 0 else 'M4'}" if self.spindle else "M5",
        ]
        words += [word for word, on in (("M7", self.mist), ("M8", self.flood)) if on]
        for name, values in (("G92", self.axis_offset), ("G43", self.tool_offset)):
            moved = [f"{_AXES[axis]}{value:.8g}" for axis, value in enumerate(values) if value]
            words += [" ".join([name, *moved])] if moved else []
        return " ".join(words)

    # parameters that the program can read

    def publish(self) -> None:
        """Publish the parameters that reflect the program's state: #5400 to #5428 and the names that begin with _."""
        live = self.parameters.live
        live[5400] = lambda: float(self.tool)
        for axis in range(9):
            # bound by defaults, since a closure would see the last axis of the loop only
            live[5401 + axis] = lambda axis=axis: self.tool_offset[axis] / (self.scale if axis in LINEAR else 1.0)
            live[5420 + axis] = lambda axis=axis: self.coordinate(axis)
            live[f"_{AXES[axis]}"] = live[5420 + axis]
        live |= {
            "_metric": lambda: float(not self.inch),
            "_imperial": lambda: float(self.inch),
            "_absolute": lambda: float(not self.incremental),
            "_incremental": lambda: float(self.incremental),
            "_plane": lambda: float(self.plane),
            "_motion_mode": lambda: float(self.motion),
            "_feed": lambda: self.feed,
            "_rpm": lambda: self.speed,
            "_spindle_on": lambda: float(self.spindle != 0),
            "_spindle_cw": lambda: float(self.spindle > 0),
            "_mist": lambda: float(self.mist),
            "_flood": lambda: float(self.flood),
            "_inverse_time": lambda: float(self.feed_mode == 930),
            "_units_per_minute": lambda: float(self.feed_mode == 940),
            "_units_per_rev": lambda: float(self.feed_mode == 950),
            "_retract_r_plane": lambda: float(self.retract_to_r),
            "_retract_old_z": lambda: float(not self.retract_to_r),
            # 540 to 590, then 591 to 593: ten times the G code
            "_coord_system": lambda: 530.0 + 10 * self.system if self.system <= 6 else 584.0 + self.system,
            "_tool_offset": lambda: float(any(self.tool_offset)),
            "_current_tool": lambda: float(self.tool),
            "_selected_tool": lambda: float(self.selected),
            # 0 is a preview; what is planned is what the machine does
            "_task": lambda: 1.0,
        }


PATH_MODES = {610: "CANON_EXACT_PATH", 611: "CANON_EXACT_STOP", 640: "CANON_CONTINUOUS"}
BY_CODE = {540: 1, 550: 2, 560: 3, 570: 4, 580: 5, 590: 6, 591: 7, 592: 8, 593: 9}


def first_of(system: int) -> int:
    """Return the first parameter of a coordinate system, 1 to 9."""
    return SYSTEM + 1 + 20 * (system - 1)


def choose_system(state: State, emit: Emit, system: int) -> None:
    """Execute G54 to G59.3: select another work offset."""
    if system == state.system:
        emit("COMMENT", "interpreter: continuing to use same coordinate system")
        return
    state.system = system
    state.parameters.numbered[SYSTEM] = float(system)
    rotation = state.parameters.numbered.get(first_of(system) + 9, 0.0)
    axis_offset = state.stored(G92) if state.parameters.numbered.get(G92_ON) else state.axis_offset
    state.keep_machine(state.stored(first_of(system)), rotation, axis_offset)
    emit("SET_G5X_OFFSET", system, *state.origin)
    emit("SET_G92_OFFSET", *state.axis_offset)
    emit("SET_XY_ROTATION", rotation)


def write_offsets(state: State, block: Block, emit: Emit, tools: dict[int, Tool]) -> None:
    """Execute G10: L2 and L20 write a work offset, L1 and L10 an offset of the tool table."""
    kind = block.whole("l", "G10", 0, 20)
    coordinates = {axis: value for axis, letter in enumerate(AXES) if (value := block.take(letter)) is not None}
    if kind in (2, 20):
        system = block.whole("p", f"G10 L{kind}", 0, SYSTEMS) or state.system
        _write_system(state, emit, system, coordinates, block.take("r"), here=kind == 20)
    elif kind == 0:
        # LinuxCNC reads its table again; here it has not changed
        return
    elif kind in (1, 10):
        number = block.whole("p", f"G10 L{kind}", 1, 99999)
        _write_tool(state, block, emit, tools, number, coordinates, here=kind == 10)
    else:
        raise BlockError(f"G10 has L0, L1, L2, L10 and L20, not L{kind}", "L")


def _write_system(
    state: State, emit: Emit, system: int, coordinates: dict[int, float], rotation: float | None, here: bool
) -> None:
    numbered, first = state.parameters.numbered, first_of(system)
    origin = state.stored(first)
    angle = numbered.get(first + 9, 0.0) if rotation is None else rotation
    if here:
        if rotation is not None:
            raise BlockError("G10 L20 has no R: write the rotation with G10 L2", "R")
        probe = _with_system(state, origin, angle)
        # the origin is added after the rotation, so that a shift along a program axis must be rotated, too
        for axis, value in coordinates.items():
            shift = [0.0] * 9
            shift[axis] = probe[axis] - value
            moved = _turned(shift, angle)
            origin = [o + m for o, m in zip(origin, moved, strict=True)]
    else:
        for axis, value in coordinates.items():
            origin[axis] = value
    state.store(first, origin)
    numbered[first + 9] = angle
    if system == state.system:
        state.keep_machine(state.stored(first), angle)
        emit("SET_G5X_OFFSET", system, *state.origin)
        emit("SET_XY_ROTATION", angle)
    else:
        emit("COMMENT", "interpreter: setting coordinate system origin")


def _with_system(state: State, origin: list[float], rotation: float) -> list[float]:
    """Return the coordinates of the current position under a different work offset."""
    kept = state.origin, state.rotation
    standing = state.machine(state.position)
    state.origin, state.rotation = origin, rotation
    here = state.program(standing)
    state.origin, state.rotation = kept
    return here


def _turned(shift: list[float], rotation: float) -> list[float]:
    x, y = rotated(shift[0], shift[1], rotation)
    return [x, y, *shift[2:]]


def _write_tool(
    state: State,
    block: Block,
    emit: Emit,
    tools: dict[int, Tool],
    number: int,
    coordinates: dict[int, float],
    here: bool,
) -> None:
    tool = tools.get(number)
    if tool is None:
        raise BlockError(f"tool {number} is not in the tool table: add it there", "P")
    scale = state.scale
    offset = list(tool.offset)
    if here:
        standing = state.machine(state.position)
        position = [m - t - o for m, t, o in zip(standing, state.tool_offset, state.origin, strict=True)]
        position = [p - a for p, a in zip(position, state.axis_offset, strict=True)]
        coordinates = {axis: position[axis] - value for axis, value in coordinates.items()}
    for axis, value in coordinates.items():
        offset[axis] = value / scale if axis in LINEAR else value
    radius, front, back = block.take("r"), block.take("i"), block.take("j")
    tool = replace(
        tool,
        offset=tuple(offset),
        diameter=tool.diameter if radius is None else 2 * radius / scale,
        front_angle=tool.front_angle if front is None else front,
        back_angle=tool.back_angle if back is None else back,
        orientation=block.whole("q", "G10", 0, 9, tool.orientation),
    )
    tools[number] = tool
    values = (*tool.offset, tool.diameter, tool.front_angle, tool.back_angle, tool.orientation)
    emit("SET_TOOL_TABLE_ENTRY", tool.pocket, number, *values)


def through(state: State, kinematics: Kinematics, to_joints: bool) -> list[float]:
    """Return the position of the machine in the other frame, in program units: from the tip of the tool to the joints
    or back.
    """
    point, unit = state.machine(state.position), state.meters
    rotary = [math.radians(point[AXES.index(letter.lower())]) for letter in kinematics.rotary_letters]
    convert = kinematics.linear if to_joints else kinematics.tip
    return [*(x * unit for x in convert([x / unit for x in point[:3]], rotary)), *point[3:]]


def end_tool_point(state: State, emit: Emit) -> None:
    """End G43.4 or G43.5: X Y Z are the joints again, which do not move."""
    if state.tool_point:
        state.settle()
        joints = through(state, state.tool_point, True)
        state.tool_point, state.aims, state.orientation = None, False, "axes"
        state.position = state.program(joints)
        emit("TOOL_POINT", 0)


def begin_tool_point(
    state: State, emit: Emit, name: str, offset: Sequence[float], aims: bool, orientation: Orientation | None = None
) -> None:
    """Move the tip of the tool from here on: X Y Z are its place in the frame of the workpiece, whose place in the
    machine is that at rotary zero.

    name    word of the program
    offset  offset of the tool, in the program's unit; all 0: the tool is that of the machine file
    aims    True if blocks give the direction of the tool
    orientation  how the tool turns; None: as where the program does not say
    """
    if state.kinematics is None:
        raise BlockError(
            f"{name} moves the tip of the tool, and the machine has no kinematics: give the machine file a section "
            "[kinematics]",
            name,
        )
    offset = [x / state.meters if axis in LINEAR else x for axis, x in enumerate(offset)]
    if any(offset[axis] for axis in range(9) if axis > 2):
        raise BlockError(f"the tool of {name} has an offset of another axis than X, Y and Z: take it out", "H")
    # a tool without an offset is that of the machine file
    kinematics = state.kinematics
    kinematics = replace(kinematics, tool=(-offset[0], -offset[1], -offset[2])) if any(offset) else kinematics
    tip = through(state, kinematics, False)
    state.tool_point, state.aims = kinematics, aims
    state.tool_offset = [0.0] * 9
    state.position = state.program(tip)
    emit("TOOL_POINT", 1, *(offset[:3]))
    turn_by(state, emit, orientation or state.turning.orientation)


def turn_by(state: State, emit: Emit, orientation: Orientation) -> None:
    """Let the tool turn by axes, in a plane or by vector from here on, until the tool point ends."""
    state.settle()
    state.orientation = orientation
    emit("ORIENTATION", orientation)


def set_tool_offset(state: State, emit: Emit, offset: Sequence[float]) -> None:
    """Set the offset of the tool, in the program's unit; the machine does not move."""
    state.keep_machine(tool_offset=offset)
    emit("USE_TOOL_LENGTH_OFFSET", *offset)


def _of_table(state: State, block: Block, tools: dict[int, Tool], name: str) -> list[float]:
    """Return the offset of tool H, or without H of the tool in the spindle, in the program's unit."""
    number = block.whole("h", name, 0, 99999, None if name == "G43.2" else state.tool)
    tool = tools.get(number)
    if tool is None and number:
        raise BlockError(
            f"tool {number} is not in the tool table: give the table with this tool", "H" if name == "G43.2" else name
        )
    return state.to_program(tool.offset) if tool else [0.0] * 9


def tool_length(state: State, block: Block, emit: Emit, tools: dict[int, Tool], code: int) -> None:
    """Execute G43, G43.1, G43.2 or G49, which set the tool offset, or G43.4 or G43.5."""
    if code == 490:
        end_tool_point(state, emit)
    elif state.tool_point:
        raise BlockError(
            f"{name_of('g', code)} changes the tool while its tip is moved ({state.names.tool_point}): write "
            f"{state.names.joints} in a line before",
            name_of("g", code),
        )
    if code in (434, 435):
        name = name_of("g", code)
        # as in FANUC, where P1 is the control of the tool's posture
        orientation = ORIENTATIONS[block.whole("p", name, 0, 2, ORIENTATIONS.index(state.turning.orientation))]
        begin_tool_point(state, emit, name, _of_table(state, block, tools, name), code == 435, orientation)
        return
    offset = [0.0] * 9
    if code == 431:
        offset = list(state.tool_offset)
        coordinates = {axis: value for axis, letter in enumerate(AXES) if (value := block.take(letter)) is not None}
        if not coordinates:
            raise BlockError("G43.1 needs the offset of an axis at least, such as Z12", "G43.1")
        for axis, value in coordinates.items():
            offset[axis] = value
    elif code in (430, 432):
        offset = _of_table(state, block, tools, name_of("g", code))
        if code == 432:
            offset = [o + t for o, t in zip(offset, state.tool_offset, strict=True)]
    set_tool_offset(state, emit, offset)


def shift_axes(state: State, block: Block, emit: Emit, code: int) -> None:
    """Execute G52 or G92 (assign coordinates to the current position), or G92.1 to G92.3 (clear, suspend, restore)."""
    numbered = state.parameters.numbered
    state.settle()
    offset = list(state.axis_offset)
    if code in (520, 920):
        coordinates = {axis: value for axis, letter in enumerate(AXES) if (value := block.take(letter)) is not None}
        if not coordinates:
            name = name_of("g", code)
            raise BlockError(f"{name} needs an axis at least, such as X0", name)
        for axis, value in coordinates.items():
            offset[axis] = value if code == 520 else offset[axis] + state.position[axis] - value
        numbered[G92_ON] = 1.0
    elif code == 923:
        offset = state.stored(G92)
        numbered[G92_ON] = 1.0
    else:
        offset = [0.0] * 9
        numbered[G92_ON] = 0.0
    if code in (520, 920, 921):
        state.store(G92, offset)
    state.keep_machine(axis_offset=offset)
    emit("SET_G92_OFFSET", *offset)


def go_home(state: State, emit: Emit, code: int, target: list[float], moved: list[int]) -> None:
    """Execute G28 or G30: move via the point given by the axis words to the stored position; only the named axes move,
    or all if none is named.
    """
    state.position = list(target)
    emit("STRAIGHT_TRAVERSE", *target)
    home = state.to_program(
        [state.parameters.numbered.get((HOME_1 if code == 280 else HOME_2) + axis, 0.0) for axis in range(9)]
    )
    machine = state.machine(target)
    for axis in moved or range(9):
        machine[axis] = home[axis]
    state.position = state.program(machine)
    if moved:
        # converting there and back would change the last digits of an axis that does not move
        fixed = [axis for axis in range(9) if axis not in moved and not (state.rotation and axis < 2)]
        for axis in fixed:
            state.position[axis] = target[axis]
    emit("STRAIGHT_TRAVERSE", *state.position)


def set_home(state: State, code: int) -> None:
    """Execute G28.1 or G30.1: store the current position."""
    state.store(HOME_1 if code == 281 else HOME_2, state.machine(state.position))

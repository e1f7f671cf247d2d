"""What a program does besides moving, in any language: feed modes, spindle, tool, coolant, planes, stops, dwells, and
the beginning and end of radius compensation.
"""

from __future__ import annotations

from collections.abc import Callable

from feeddrive.language.quantity import Quantity, number
from feeddrive.path.program.blocks import BlockError, Line
from feeddrive.path.program.compensation import Compensation, Corners
from feeddrive.path.program.motion import PLANES, emit_path_mode
from feeddrive.path.program.moves import Command
from feeddrive.path.program.state import Emit, State, Tool

_FEED_MODES = {930: "inverse time", 940: "units per minute", 950: "units per revolution"}
_PLANES = {170: "CANON_PLANE_XY", 180: "CANON_PLANE_XZ", 190: "CANON_PLANE_YZ"}
_TURNING = {1: "START_SPINDLE_CLOCKWISE", -1: "START_SPINDLE_COUNTERCLOCKWISE", 0: "STOP_SPINDLE_TURNING"}


class Switches:
    """The functions of the machine that move no axis.

    tools  the tool table, by number
    line   function that returns the present line
    write  function that takes a command which is not to wait for a corner of the contour
    """

    def __init__(
        self,
        state: State,
        emit: Emit,
        tools: dict[int, Tool] | None,
        line: Callable[[], Line],
        write: Callable[[Command], None],
    ) -> None:
        self._state, self._emit, self._tools = state, emit, tools
        self._line, self._write = line, write

    # feed and spindle

    def feed_mode(self, code: int) -> None:
        """Set inverse time (930), units per minute (940) or per turn (950); the feed must then be programmed again."""
        self._state.feed_mode = code
        self._state.feed = 0.0
        self._emit("COMMENT", f"interpreter: feed mode set to {_FEED_MODES[code]}")
        self._emit("SET_FEED_MODE", 0, int(code == 950))
        if code != 930:
            self._emit("SET_FEED_RATE", 0.0)

    def feed(self, feed: float) -> None:
        """Set the feed, in the program's unit."""
        if feed < 0:
            raise BlockError(f"a feed is not negative: F{Quantity(feed):6}", "F")
        self._state.feed = feed
        self._emit("SET_FEED_RATE", feed)

    def speed(self, speed: float, spindle: int = 0) -> None:
        """Set the speed of a spindle, rpm; -1 stands for all spindles."""
        if speed < 0:
            raise BlockError(f"a spindle speed is not negative: S{number(speed, 6)}; M4 turns counterclockwise", "S")
        if spindle <= 0:
            self._state.speed = speed
        self._emit("SET_SPINDLE_SPEED", spindle, speed)

    def turn(self, direction: int, spindle: int = 0) -> None:
        """Turn a spindle clockwise (1) or counterclockwise (-1), or stop it (0); -1 stands for all spindles."""
        if spindle <= 0:
            self._state.spindle = direction
        self._emit(_TURNING[direction], spindle)

    def dwell(self, seconds: float, word: str) -> None:
        """Stand still for a time, s, which a word of the program states."""
        if seconds < 0:
            raise BlockError(f"a dwell is a time and not negative: {word}{number(seconds, 6)}", word)
        self._emit("DWELL", seconds)

    # tools and coolant

    def select(self, tool: int) -> None:
        """Select the tool of the next change."""
        if self._tools is not None and tool and tool not in self._tools:
            raise BlockError(f"tool {tool} is not in the tool table: add it there", "T")
        self._state.selected = tool
        self._emit("SELECT_TOOL", tool)

    def change_tool(self, name: str) -> None:
        """Change to the selected tool; `name` is the word of the program."""
        state, emit = self._state, self._emit
        self.check_change(name)
        emit("START_CHANGE")
        emit("STOP_SPINDLE_TURNING", 0)
        state.spindle = 0
        state.tool = state.selected
        emit("CHANGE_TOOL", state.tool)

    def check_change(self, name: str) -> None:
        """Refuse a change of the tool whose tip is moved."""
        if self._state.tool_point:
            names = self._state.names
            raise BlockError(
                f"{name} changes the tool while its tip is moved ({names.tool_point}): write {names.joints} in a line "
                "before",
                name,
            )

    def coolant(self, *, mist: bool = False, flood: bool = False) -> None:
        """Turn mist or flood on; without any, both off."""
        state = self._state
        if not mist and not flood:
            state.mist = state.flood = False
            self._emit("MIST_OFF")
            self._emit("FLOOD_OFF")
        elif mist:
            state.mist = True
            self._emit("MIST_ON")
        else:
            state.flood = True
            self._emit("FLOOD_ON")

    # path and plane

    def plane(self, code: int) -> None:
        """Select the plane XY (170), ZX (180) or YZ (190)."""
        self._state.plane = code
        self._emit("SELECT_PLANE", _PLANES[code])

    def path_mode(self, mode: str, tolerance: float | None = None, naive: float = 0.0) -> None:
        """Set the path mode, and with a `tolerance` both tolerances, in the program's unit."""
        state = self._state
        state.path_mode = mode
        if tolerance is not None:
            state.tolerance, state.naive_tolerance = tolerance, naive
        emit_path_mode(state, self._emit)
        if tolerance is not None:
            self._emit("SET_NAIVECAM_TOLERANCE", state.naive_tolerance)

    # radius compensation

    def begin_contour(self, name: str, diameter: float, left: bool, corners: Corners) -> None:
        """Begin the radius compensation with the tool on the left or right; a negative diameter is on the other side.

        name     word of the program
        corners  how the contour is entered and its corners are rounded
        """
        state = self._state
        if state.tool_point:
            names = state.names
            raise BlockError(
                f"{name} has no meaning while the tip of a tilted tool is moved ({names.tool_point}): write "
                f"{names.joints} before, or program the center of the tool",
                name,
            )
        left = left == (diameter >= 0)
        self._emit("COMMENT", f"interpreter: cutter radius compensation on {'left' if left else 'right'}")
        # of a tool without a radius the center goes along the contour
        if diameter:
            state.compensation = Compensation(
                0.5 * abs(diameter), left, PLANES[state.plane], state.position, self._line, self._write, corners
            )

    @staticmethod
    def check_round(orientation: int, name: str, otherwise: str = "") -> None:
        """Refuse the radius compensation of a lathe tool; `otherwise`: what else the program can do."""
        if orientation not in (0, 9):
            raise BlockError(
                f"the tool has the orientation {orientation} of a lathe, for which there is no compensation here: give "
                f"a round tool{otherwise}",
                name,
            )

    def leave_contour(self) -> None:
        """End the radius compensation, if it is on: the next move leads from beside the contour to its target."""
        state = self._state
        if state.compensation:
            state.compensation.finish()
            state.leaving = state.here()
            state.compensation = None

    # stops

    def stop(self, *, optional: bool = False) -> None:
        """Stop until the operator goes on; an `optional` stop acts if he has enabled it."""
        self._emit("OPTIONAL_PROGRAM_STOP" if optional else "PROGRAM_STOP")

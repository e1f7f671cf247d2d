"""Canned cycles G73, G74, G81 to G86 and G89: traverse over the hole, traverse to R, feed to the depth, come back.

They are written for the plane XY; in G18 and G19 the axis across the plane takes the place of Z.
"""

from __future__ import annotations

from collections.abc import Callable

from feeddrive.language.quantity import Quantity
from feeddrive.path.program.blocks import AXES, Block
from feeddrive.path.program.codes import name_of
from feeddrive.path.program.lines import BlockError
from feeddrive.path.program.state import INCH, State

PLANES = {170: (0, 1, 2), 180: (2, 0, 1), 190: (1, 2, 0)}
"""First and second axis of a plane, and the axis across it: right-handed."""
CLEARANCE = 0.254
"""How far above the last depth (mm) a pecking cycle ends its traverse."""
MOST_REPEATS = 10_000
MOST_PECKS = 10_000

Emit = Callable[..., None]
STICKY = {730: "zrq", 740: "zrp", 810: "zr", 820: "zrp", 830: "zrq", 840: "zrp", 850: "zr", 860: "zrp", 890: "zrp"}
"""Words that a cycle needs, and keeps for the next blocks of its series; Z is the axis across the plane."""


def drill(
    state: State, block: Block, emit: Emit, code: int, same: bool, lead: Callable[[list[float]], list[float]]
) -> None:
    """A cycle at one place, or at L places in a row.

    same  whether the modal motion was this cycle already, whose words are then kept
    lead  where the block's axis words lead from a point
    """
    name = name_of("g", code)
    first, second, across = PLANES[state.plane]
    where = lead(state.position)
    if state.feed_mode == 930:
        raise BlockError(f"{name} has several moves, and G93 gives the time of one: use G94", name)
    if state.feed <= 0:
        raise BlockError(f"{name} needs a feed above 0: write F in this block or before", name)
    kept = _kept_words(state, block, code, same, AXES[across], name)
    repeats = block.whole("l", name, 1, MOST_REPEATS, 1)
    begin = state.level[1] if state.level else state.position[across]
    if state.incremental:
        clearance = kept["r"] + begin
        depth = kept["z"] + clearance
    else:
        clearance, depth = kept["r"], kept["z"]
    if clearance < depth:
        raise BlockError(
            f"R {Quantity(clearance):6} of {name} lies below the depth {Quantity(depth):6}: a cycle drills downwards",
            "R",
        )
    point = list(state.position)
    level = point[across] if state.retract_to_r else max(begin, point[across])
    if min(begin, level) < clearance:
        point[across] = level = clearance
        emit("STRAIGHT_TRAVERSE", *point)
    leave = clearance if state.retract_to_r else level
    if state.path_mode != "CANON_EXACT_PATH":
        emit("SET_MOTION_CONTROL_MODE", "CANON_EXACT_PATH")
    hole = _Hole(state, emit, kept, clearance, depth, leave, across)
    for turn in range(repeats):
        if turn:
            where = lead(where)
        point[first], point[second], point[across] = where[first], where[second], level
        emit("STRAIGHT_TRAVERSE", *point)
        if level != clearance:
            point[across] = clearance
            emit("STRAIGHT_TRAVERSE", *point)
        hole.make(code, name, point)
        level = leave
    point[across] = leave
    state.position = point
    if state.path_mode != "CANON_EXACT_PATH":
        emit_path_mode(state, emit)
        emit("SET_NAIVECAM_TOLERANCE", state.naive_tolerance)


def _kept_words(state: State, block: Block, code: int, same: bool, across: str, name: str) -> dict[str, float]:
    """The words of a series, those of this block included."""
    kept = state.cycle if same else {}
    axis = AXES.index(across)
    if state.level is None or state.level[0] != axis:
        state.level = axis, state.position[axis]
    for letter in STICKY[code]:
        value = block.take(across if letter == "z" else letter)
        if value is not None:
            kept[letter] = value
        elif letter == "p" and code in (740, 840):
            kept.setdefault("p", 0.0)
        elif letter not in kept:
            word = across.upper() if letter == "z" else letter.upper()
            raise BlockError(f"{name} needs the word {word} in the first block of a series: write it", name)
    if kept.get("q", 1.0) <= 0:
        raise BlockError(f"Q of {name} is the depth of a peck and lies above 0, not {kept['q']:g}", "Q")
    if kept.get("p", 0.0) < 0:
        raise BlockError(f"P of {name} is a time and not negative, not {kept['p']:g}", "P")
    state.cycle = kept
    return kept


class _Hole:
    """What a cycle does at its place, from R on."""

    def __init__(
        self,
        state: State,
        emit: Emit,
        kept: dict[str, float],
        clearance: float,
        depth: float,
        leave: float,
        across: int,
    ) -> None:
        self.state, self.emit, self.kept = state, emit, kept
        self.clearance, self.depth, self.leave, self.across = clearance, depth, leave, across

    def make(self, code: int, name: str, point: list[float]) -> None:
        """The moves of the cycle `code` at a point, which is changed."""

        def go(level: float, command: str = "STRAIGHT_FEED") -> None:
            point[self.across] = level
            self.emit(command, *point)

        def traverse(level: float) -> None:
            go(level, "STRAIGHT_TRAVERSE")

        if code in (730, 830):
            self._peck(code == 830, name, go, traverse)
            go(self.depth)
            traverse(self.leave)
        elif code in (740, 840):
            self._tap(code == 840, name, go)
        elif code == 860:
            turning = self._turning(name)
            go(self.depth)
            self.emit("DWELL", self.kept["p"])
            self.emit("STOP_SPINDLE_TURNING", 0)
            traverse(self.leave)
            self.emit("START_SPINDLE_CLOCKWISE" if turning > 0 else "START_SPINDLE_COUNTERCLOCKWISE", 0)
        else:
            go(self.depth)
            if code in (820, 890):
                self.emit("DWELL", self.kept["p"])
            if code == 890:
                go(self.leave)
                return
            if code == 850:
                go(self.clearance)
            traverse(self.leave)

    def _peck(self, out: bool, name: str, go: Callable[[float], None], traverse: Callable[[float], None]) -> None:
        step = self.kept["q"]
        if (self.clearance - self.depth) / step > MOST_PECKS:
            raise BlockError(f"Q {Quantity(step):6} of {name} makes more than {MOST_PECKS} pecks: make Q larger", "Q")
        above = CLEARANCE / INCH if self.state.inch else CLEARANCE
        level = self.clearance - step
        while level > self.depth:
            go(level)
            if out:
                traverse(self.clearance)
            traverse(level + above)
            level -= step

    def _tap(self, right: bool, name: str, go: Callable[[float], None]) -> None:
        state, emit = self.state, self.emit
        if self._turning(name) != (1 if right else -1):
            raise BlockError(
                f"{name} needs the spindle turning {'clockwise (M3)' if right else 'counterclockwise (M4)'}", name
            )
        there, back = "START_SPINDLE_CLOCKWISE", "START_SPINDLE_COUNTERCLOCKWISE"
        if not right:
            there, back = back, there
        emit("DISABLE_FEED_OVERRIDE")
        emit("DISABLE_SPEED_OVERRIDE", 0)
        go(self.depth)
        emit("STOP_SPINDLE_TURNING", 0)
        emit(back, 0)
        emit("DWELL", self.kept["p"])
        go(self.leave)
        emit("STOP_SPINDLE_TURNING", 0)
        emit(there, 0)
        if state.feed_override:
            emit("ENABLE_FEED_OVERRIDE")
        if state.speed_override:
            emit("ENABLE_SPEED_OVERRIDE", 0)

    def _turning(self, name: str) -> int:
        if not self.state.spindle:
            raise BlockError(f"{name} needs a turning spindle: write S and M3 before", name)
        return self.state.spindle


def emit_path_mode(state: State, emit: Emit) -> None:
    """Say how the path is followed."""
    if state.path_mode == "CANON_CONTINUOUS":
        emit("SET_MOTION_CONTROL_MODE", state.path_mode, state.tolerance)
    else:
        emit("SET_MOTION_CONTROL_MODE", state.path_mode)

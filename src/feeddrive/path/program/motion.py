"""The motions of a part program with their feed: straight moves, arcs, splines, synchronized feeds, canned cycles.

The cycles G73, G74, G81 to G86 and G89 traverse to the hole, traverse to R, feed to the depth and retract.  They are
described for the XY plane; in G18 and G19 the axis normal to the plane replaces Z.
"""

import math
from collections.abc import Callable

from feeddrive.language.quantity import Quantity
from feeddrive.path.program.blocks import AXES, Block, BlockError, name_of
from feeddrive.path.program.moves import MOST_TURNS, center_of_radius, check_radii, sweep
from feeddrive.path.program.nurbs import HIGHEST_ORDER, Nurbs
from feeddrive.path.program.state import EXTRUDER, INCH, TOUCHED, Emit, State

PLANES = {170: (0, 1, 2), 180: (2, 0, 1), 190: (1, 2, 0)}
"""The first and second axis of each plane and the axis normal to it, right-handed, by ten times the G code."""
# 0.01 inch, as in LinuxCNC
CLEARANCE = 0.254
"""The distance above the last depth at which the traverse of a pecking cycle ends, mm."""
# programs round the position to a few decimals
START_SPREAD = 1e-3
"""The largest distance of the first control point of G6.2 from the position before it, mm (and degrees)."""
# a mistyped L or Q must not become millions of moves
MOST_REPEATS = 10_000
MOST_PECKS = 10_000

STICKY = {730: "zrq", 740: "zrp", 810: "zr", 820: "zrp", 830: "zrq", 840: "zrp", 850: "zr", 860: "zrp", 890: "zrp"}
"""The words that each cycle requires, retained for the next blocks of its series; Z is the axis normal to the plane."""


def drill(
    state: State, block: Block, emit: Emit, code: int, same: bool, lead: Callable[[list[float]], list[float]]
) -> None:
    """Emit the moves of a canned cycle at one position, or at L successive positions.

    same  True if the modal motion was already this cycle, whose words are then retained
    lead  function that returns the target of the block's axis words for a given start point
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
    # G98 returns to the higher of the start and the present position; rs274 to that of the start of the series
    level = point[across] if state.retract_to_r else max(begin, point[across])
    if min(begin, level) < clearance:
        point[across] = level = clearance
        emit("STRAIGHT_TRAVERSE", *point)
    leave = clearance if state.retract_to_r else level
    # a cycle runs in exact path mode, as in LinuxCNC; the program's mode is restored after it
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
    """Return the sticky words of a series of cycles, updated with those of this block."""
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
    """The moves of a cycle at one hole, starting at the R plane."""

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
        """Emit the moves of the cycle `code` at a point; the point is modified."""

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
        # an override would change the ratio of feed and spindle speed, which must be the pitch of the tap
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
    """Emit the command that sets the path mode."""
    if state.path_mode == "CANON_CONTINUOUS":
        emit("SET_MOTION_CONTROL_MODE", state.path_mode, state.tolerance)
    else:
        emit("SET_MOTION_CONTROL_MODE", state.path_mode)


_CENTER = "ijk"
AXIS_OF = {letter: axis for axis, letter in enumerate(AXES)}
# as in LinuxCNC, for moves of little or no length
LEAST_FEED = 0.1
"""The least feed of a move in inverse time mode, in program units per minute."""
CURVE = frozenset({52, 53, 62})
"""The codes of a NURBS."""
PROBES = frozenset({382, 383, 384, 385})
"""The codes of a probing move."""
MOVING = frozenset(AXES + "@^")
"""The words that specify the target of a move."""


class Motion:
    """The executor of a block's motion, which emits its commands.

    moved  callback that is called before each motion command
    """

    def __init__(self, state: State, emit: Emit, moved: Callable[[], None]) -> None:
        self._state, self._emit, self._moved = state, emit, moved
        self._tangent: tuple[float, float] | None = None

    def target(self, block: Block) -> tuple[list[float], list[int]]:
        """Return the target of the axis words in program coordinates, and the axes that they name."""
        words, state = block.words, self._state
        if "@" in words or "^" in words:
            moving = {letter: words.pop(letter) for letter in list(words) if letter in MOVING}
            return _led(moving, state.position, state.incremental)
        target = list(state.position)
        moved: list[int] = []
        incremental = state.incremental
        for letter in tuple(words):
            axis = AXIS_OF.get(letter)
            if axis is not None:
                value = words.pop(letter)
                added = state.extruder_incremental if axis == EXTRUDER else incremental
                target[axis] = target[axis] + value if added else value
                moved.append(axis)
        return target, moved

    def _machine_target(self, words: dict[str, float]) -> tuple[list[float], list[int]]:
        state = self._state
        if state.incremental:
            raise BlockError("G53 gives machine coordinates, which are absolute: write G90 before", "G53")
        standing = state.machine(state.position)
        moved = [axis for axis, letter in enumerate(AXES) if letter in words]
        scale_free = list(standing)
        for axis in moved:
            scale_free[axis] = words.pop(AXES[axis])
        target = state.program(scale_free)
        for axis in range(9):
            # converting there and back would change the last digits of an axis that does not move
            if scale_free[axis] == standing[axis] and not (state.rotation and axis < 2):
                target[axis] = state.position[axis]
        return target, moved

    def move(self, block: Block, code: int, machine: bool) -> None:
        """Execute a motion code; with `machine` (G53), the axis words are machine coordinates."""
        state = self._state
        if code > 30 or machine:
            self._other_motion(block, code, machine)
            return
        state.motion = code
        if code >= 20:
            self._arc(block, code)
            return
        target, moved = self.target(block)
        if state.aims:
            self._aim(block, target, moved)
        self._straight(block, code, target)

    def _aim(self, block: Block, target: list[float], moved: list[int]) -> None:
        """Let the tool have the direction I J K, from its tip to the spindle, at a target."""
        kinematics = self._state.tool_point
        assert kinematics is not None
        axes = [AXIS_OF[letter.lower()] for letter in kinematics.rotary_letters]
        turned = [AXES[axis].upper() for axis in axes if axis in moved]
        if turned:
            raise BlockError(
                f"G43.5 gives the direction of the tool by I J K, not by {turned[0]}: write I J K, or G43.4 before",
                turned[0],
            )
        words = [block.take(letter) for letter in _CENTER]
        if words == [None, None, None]:
            return
        self._state.aim(target, [word or 0.0 for word in words], "I J K")

    def _other_motion(self, block: Block, code: int, machine: bool) -> None:
        state = self._state
        if machine:
            if code not in (0, 10):
                raise BlockError(f"G53 goes with G0 and G1, not with {name_of('g', code)}", "G53")
            state.motion = code
            target, moved = self._machine_target(block.words)
            if not moved:
                raise BlockError("G53 needs the word of an axis at least", "G53")
            self._straight(block, code, target)
        elif code == 800:
            state.motion = 800
            self._emit("COMMENT", "interpreter: motion mode set to none")
        elif code in (50, 51):
            self._spline(block, code)
        elif code in CURVE:
            self._nurbs(block, code)
        elif code == 330:
            self._synchronized(block)
        elif code in PROBES:
            self._probe(block, code)
        else:
            same = state.motion == code
            # the word of the normal axis is a depth, read by `drill`, and no position
            across = AXES[PLANES[state.plane][2]]
            moving = {
                letter: block.words.pop(letter) for letter in list(block.words) if letter in MOVING and letter != across
            }
            others = [letter.upper() for letter in moving if letter not in "xyz@^"]
            if others:
                name = name_of("g", code)
                raise BlockError(f"{name} moves X, Y and Z only: move {others[0]} in a block of its own", others[0])
            # G98 retracts to the level before the first cycle of a series, which begins here
            if state.motion < 730 or state.motion == 800:
                state.level = None
            state.settle()
            state.motion = code
            self._moved()
            drill(state, block, self._emit, code, same, lambda place: _led(moving, place, state.incremental)[0])

    def _straight(self, block: Block, code: int, target: list[float]) -> None:
        state = self._state
        if code:
            if state.feed_mode == 930:
                self._inverse_time(block, _length(state.position, target), "G1")
            elif state.feed <= 0:
                raise BlockError(
                    "G1 needs a feed above 0: write F in this block or before", "G1" if not block.codes else "G"
                )
        self._moved()
        self._tangent = None
        name = "STRAIGHT_FEED" if code else "STRAIGHT_TRAVERSE"
        if state.compensation:
            state.compensation.move(name, target)
        else:
            self._emit(name, *target)
        state.position, state.leaving = target, None

    def _inverse_time(self, block: Block, length: float, name: str) -> None:
        """Set the feed of this move under G93: F is the inverse of its time in minutes."""
        rate = block.take("f")
        if rate is None or rate <= 0:
            raise BlockError(
                f"{name} in inverse time (G93) needs F above 0 in its own block", "F" if rate is not None else name
            )
        self._state.feed = feed = max(length * rate, LEAST_FEED)
        self._emit("SET_FEED_RATE", feed)

    def _arc(self, block: Block, code: int) -> None:
        state = self._state
        name = "G2" if code == 20 else "G3"
        if state.leaving:
            raise BlockError(f"the move behind G40 is straight: write G0 or G1 before this {name}", name)
        first, second, across = PLANES[state.plane]
        position = state.position
        target, moved = self.target(block)
        radius = block.take("r")
        letters = _CENTER[first].upper() + " " + _CENTER[second].upper()
        offsets = block.take(_CENTER[first]), block.take(_CENTER[second])
        turns = block.whole("p", name, 1, MOST_TURNS, 1)
        unit = INCH if state.inch else 1.0
        start, end = (position[first], position[second]), (target[first], target[second])
        if radius is not None:
            if offsets != (None, None):
                raise BlockError(f"{name} has a radius R or a center {letters}, not both", "R")
            if first not in moved and second not in moved:
                raise BlockError(f"{name} with R needs its end: {AXES[first].upper()} or {AXES[second].upper()}", "R")
            center = center_of_radius(start, end, radius, code == 20, unit)
        else:
            center = self._center(name, offsets, start, letters)
            check_radii(start, end, center, letters, unit)
        if state.feed_mode == 930:
            angle = sweep(start, end, center, turns if code == 30 else -turns)
            size = math.hypot(start[0] - center[0], start[1] - center[1])
            self._inverse_time(block, math.hypot(angle * size, target[across] - position[across]), name)
        elif state.feed <= 0:
            raise BlockError(f"{name} needs a feed above 0: write F in this block or before", name)
        self._moved()
        self._tangent = None
        turns = turns if code == 30 else -turns
        if state.compensation:
            state.compensation.move("ARC_FEED", target, center, turns)
        else:
            self._emit("ARC_FEED", *end, *center, turns, target[across], *target[3:])
        state.position = target

    def _center(
        self, name: str, offsets: tuple[float | None, float | None], start: tuple[float, float], letters: str
    ) -> tuple[float, float]:
        if offsets == (None, None):
            raise BlockError(f"{name} has no center: write {letters}, or the radius R, in each block of an arc", name)
        if self._state.arc_absolute:
            if offsets[0] is None or offsets[1] is None:
                raise BlockError(f"{name} in G90.1 needs both words of its center, {letters}", name)
            return offsets[0], offsets[1]
        return start[0] + (offsets[0] or 0.0), start[1] + (offsets[1] or 0.0)

    def _spline(self, block: Block, code: int) -> None:
        """Emit G5 (cubic) or G5.1 (quadratic) in XY; I J is the offset of the first control point from the start, P
        Q that of the second from the end.
        """
        state, name = self._state, name_of("g", code)
        self._curve(name)
        before = list(state.position)
        target, moved = self.target(block)
        if any(axis > 1 for axis in moved) or not moved:
            raise BlockError(f"{name} needs X or Y, and moves no other axis", name)
        i, j = block.take("i"), block.take("j")
        x, y = before[0], before[1]
        if code == 51:
            if not i and not j:
                raise BlockError("G5.1 needs I or J other than 0: from the start to its control point", name)
            points = [(x + (i or 0.0), y + (j or 0.0))]
            self._tangent = None
        else:
            p, q = block.take("p", name), block.take("q", name)
            assert p is not None
            assert q is not None
            if (i is None) != (j is None) or (i is None and self._tangent is None):
                raise BlockError("G5 needs both I and J, or neither right behind another G5", name)
            if i is None or j is None:
                assert self._tangent is not None
                i, j = self._tangent
            points = [(x + i, y + j), (target[0] + p, target[1] + q)]
            # a G5 right after this one without I J continues in its direction
            self._tangent = (-p, -q)
        state.motion = 800
        state.position = target
        self._moved()
        self._emit("NURBS_FEED", *(value for point in points for value in point), target[0], target[1])

    def _curve(self, name: str, flat: bool = True) -> None:
        """Refuse a curve without a feed, right behind G40, or, if it is `flat`, in another plane than XY."""
        state = self._state
        if flat and state.plane != 170:
            raise BlockError(f"{name} lies in the plane XY: write G17 before", name)
        if state.feed_mode == 930 or state.feed <= 0:
            raise BlockError(f"{name} needs a feed above 0 in G94 or G95: write F in this block or before", name)
        if state.leaving:
            raise BlockError(f"the move behind G40 is straight: write G0 or G1 before this {name}", name)

    def _nurbs(self, block: Block, code: int) -> None:
        """Read a block of a NURBS.

        G5.2 in XY: L the order (3), P the weight; the first point is the position before it.  G5.3 ends it.
        G6.2: P the order (4), K a knot, R the weight; blocks with K alone, as many as the order, end it.
        """
        state = self._state
        if code == 53:
            if state.nurbs is None or state.nurbs.name != "G5.2":
                raise BlockError("G5.3 ends a curve, and none is open: write G5.2 before", "G5.3")
            self._end_curve(state.nurbs)
            return
        name = name_of("g", code)
        nurbs = state.nurbs
        if nurbs is not None and nurbs.name != name:
            raise BlockError(f"{name} stands in a curve of {nurbs.name}: end that one before", name)
        begins = nurbs is None
        if nurbs is None:
            self._curve(name, code == 52)
            state.settle()
            letter, usual = ("l", 3) if code == 52 else ("p", 4)
            nurbs = state.nurbs = Nurbs(name, block.whole(letter, name, 2, HIGHEST_ORDER, usual))
            state.motion = code
        if state.incremental:
            raise BlockError(f"the points of {name} are absolute: write G90 before", name)
        if code == 52:
            self._point(block, nurbs, begins)
        else:
            self._knot(block, nurbs, begins)

    def _point(self, block: Block, nurbs: Nurbs, begins: bool) -> None:
        """Read a control point of G5.2."""
        target, moved = self.target(block)
        weight = block.take("p")
        if any(axis > 1 for axis in moved):
            raise BlockError("G5.2 lies in the plane XY, and moves no other axis", AXES[max(moved)].upper())
        if begins:
            # without X and Y the weight is that of the first point, which is where the machine stands
            nurbs.add(self._state.position, weight if weight is not None and not moved else 1.0)
        if moved:
            nurbs.add(target, 1.0 if weight is None else weight)
            self._state.position = target
        elif not begins:
            raise BlockError("a block between G5.2 and G5.3 has X or Y: write the control point", "P")

    def _knot(self, block: Block, nurbs: Nurbs, begins: bool) -> None:
        """Read a block of G6.2: a control point with its knot, or a knot alone."""
        state, knot = self._state, block.take("k")
        before = state.position
        target, moved = self.target(block)
        weight = block.take("r")
        if begins:
            unit = INCH if state.inch else 1.0
            if math.dist(target, before) * unit > START_SPREAD:
                raise BlockError(
                    "the first control point of G6.2 is the position before it: move there with G1 or G0, or leave the "
                    "words of the axes out",
                    AXES[moved[0]].upper(),
                )
            nurbs.add(before, 1.0 if weight is None else weight)
            if knot is not None:
                nurbs.knots.append(knot)
            return
        if knot is None:
            raise BlockError("each block of a curve of G6.2 has a knot: write K", "G6.2")
        if not nurbs.knots:
            nurbs.knots.append(knot)
        nurbs.knots.append(knot)
        if moved:
            if len(nurbs.knots) > len(nurbs.points) + 1:
                raise BlockError("a control point stands behind a knot alone, which ends a curve: take it out", "K")
            nurbs.add(target, 1.0 if weight is None else weight)
            state.position = target
        elif len(nurbs.knots) == len(nurbs.points) + nurbs.order:
            self._end_curve(nurbs)

    def _end_curve(self, nurbs: Nurbs) -> None:
        """Emit a NURBS as Bezier curves."""
        state = self._state
        state.nurbs, state.motion = None, 800
        self._moved()
        self._tangent = None
        for piece in nurbs.pieces(INCH if state.inch else 1.0):
            # a single point is no motion
            if (piece != piece[0]).any():
                points = [float(value) for point in piece[1:] for value in point]
                self._emit("STRAIGHT_FEED" if len(piece) == 2 else "BEZIER_FEED", *points)

    def _probe(self, block: Block, code: int) -> None:
        """Emit G38.2 to G38.5 as if the probe touched at the end of the move, where #5061 to #5069 then are."""
        state, name = self._state, name_of("g", code)
        state.settle()
        target, moved = self.target(block)
        # behind another probe the real machine would stand before its end, and may have a way to go
        probed = state.parameters.numbered.get(TOUCHED + 9)
        if not moved or (target == state.position and not probed):
            raise BlockError(
                f"{name} moves towards the work: write the word of an axis, beyond the present position", name
            )
        if state.feed_mode == 930 or state.feed <= 0:
            raise BlockError(f"{name} needs a feed above 0 in G94 or G95: write F in this block or before", name)
        self._moved()
        self._tangent = None
        # not modal: the next block needs a code of its own, as in LinuxCNC
        state.motion = 800
        state.position, state.leaving = target, None
        state.parameters.numbered.update({TOUCHED + axis: value for axis, value in enumerate(target)})
        state.parameters.numbered[TOUCHED + 9] = 1.0
        self._emit("TURN_PROBE_ON")
        self._emit("STRAIGHT_PROBE", *target)
        self._emit("TURN_PROBE_OFF")

    def _synchronized(self, block: Block) -> None:
        """Emit G33: a feed that advances K per spindle revolution."""
        state = self._state
        pitch = block.take("k", "G33")
        assert pitch is not None
        if not state.spindle:
            raise BlockError("G33 needs a turning spindle: write S and M3 before", "G33")
        target, _ = self.target(block)
        state.motion = 330
        state.position = target
        self._moved()
        self._emit("START_SPEED_FEED_SYNC", pitch, 0)
        self._emit("STRAIGHT_FEED", *target)
        self._emit("STOP_SPEED_FEED_SYNCH")


def _led(moving: dict[str, float], start: list[float], incremental: bool) -> tuple[list[float], list[int]]:
    """Return the target of axis words for a given start point, and the axes that they name.

    @ and ^ are radius and angle about the program zero.
    """
    target = list(start)
    moved: list[int] = []
    for letter, value in moving.items():
        if letter in AXES:
            axis = AXES.index(letter)
            target[axis] = target[axis] + value if incremental else value
            moved.append(axis)
    if "@" not in moving and "^" not in moving:
        return target, moved
    if 0 in moved or 1 in moved:
        raise BlockError("@ and ^ stand for X and Y: use one of the two ways in a block", "@" if "@" in moving else "^")
    radius, angle = moving.get("@"), moving.get("^")
    size, turned = math.hypot(target[0], target[1]), math.atan2(target[1], target[0])
    if angle is None and size == 0:
        raise BlockError("@ at the zero of the program has no direction: write the angle ^ too", "@")
    if incremental:
        size, turned = size + (radius or 0.0), turned + math.radians(angle or 0.0)
    else:
        size, turned = size if radius is None else radius, turned if angle is None else math.radians(angle)
    target[0], target[1] = size * math.cos(turned), size * math.sin(turned)
    return target, [*moved, 0, 1]


def _length(start: list[float], end: list[float]) -> float:
    """Return the length of a straight move to which its feed refers: along X Y Z, or without these U V W, or A B C
    (degrees).
    """
    for axes in ((0, 1, 2), (6, 7, 8), (3, 4, 5)):
        length = math.hypot(*(end[axis] - start[axis] for axis in axes))
        if length > 0:
            return length
    return 0.0

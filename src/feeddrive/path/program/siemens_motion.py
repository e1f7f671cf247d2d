"""The motions of a block of a SINUMERIK program: moves, arcs, CIP, POLY and splines, with their end points."""

from __future__ import annotations

import math

from feeddrive.path.program.blocks import AXES, Block, BlockError
from feeddrive.path.program.execution import Execution
from feeddrive.path.program.motion import PLANES
from feeddrive.path.program.moves import sweep
from feeddrive.path.program.siemens_block import CURVES, VECTOR, Placed, Words
from feeddrive.path.program.siemens_splines import BEGINS, ENDS, Edges
from feeddrive.path.program.state import INCH, LINEAR, rotated


class SiemensMotion:
    """The executor of the motion of a block.

    inch         True if lengths are in inches (G70, G700)
    incremental  True in G91
    before       coordinates of axes that were not programmed since frames changed
    """

    def __init__(self, run: Execution) -> None:
        self._run, self._state = run, run.state
        self._emit, self._lines, self._switches, self._motion = run.emit, run.lines, run.switches, run.motion
        self.inch = self.incremental = False
        self.before: dict[int, float] = {}
        self._modal = 1  # G0 .. G3; the control starts in G1
        self._curve = ""  # CIP, POLY or a spline in place of G0 .. G3
        self._pole = [0.0, 0.0]
        self._edges, self._degree = Edges(), 3  # of splines
        self._step: float | None = None  # PL of BSPLINE
        self._told: set[str] = set()  # kinds of splines of which the operator was told

    def saved(self) -> tuple[int, str, Edges]:
        """Return the modal words of the motion: G0 to G3 or a curve, and how splines begin and end."""
        return self._modal, self._curve, self._edges

    def restore(self, codes: tuple[int, str, Edges]) -> None:
        """Let the modal words of `saved` act again."""
        spline = self._state.spline
        if spline and codes[1] != spline.kind:
            spline.closed = True
        self._modal, self._curve, self._edges = codes

    def move(self, words: Words) -> bool:
        """Execute the motion of a block; return False if there is none."""
        codes, state = words.codes, self._state
        curve = next((word for word in words.keywords if word in CURVES), "")
        if state.spline and ("motion" in codes or curve not in ("", state.spline.kind)):
            state.spline.closed = True
        if "motion" in codes:
            self._modal, self._curve = codes["motion"], ""
        if curve:
            if "motion" in codes:
                raise BlockError(f"G{codes['motion']} and {curve} exclude each other: use two lines", curve)
            self._curve = curve
        for name in words.keywords:
            field = "begin" if name in BEGINS else "end" if name in ENDS else ""
            self._edges = self._edges._replace(**{field: name}) if field else self._edges
        if (degree := words.take("SD")) is not None:
            if degree not in (2.0, 3.0):
                raise BlockError(f"SD is the degree of BSPLINE, 2 or 3, not {degree:g}", "SD")
            self._degree = round(degree)
        once = codes.get("once", -1)
        if once in (110, 111, 112):
            self._set_pole(words, once)
            return False
        moving = [letter for letter in (*AXES.upper(), "AP", "RP", *VECTOR) if letter in words.values]
        if not moving and not words.polynomials and not any(letter in words.values for letter in ("I", "J", "K", "AR")):
            return False
        block = Block(self._run.line)
        if state.feed_mode == 930 and "F" in words.values:
            block.words["f"] = words.values.pop("F").value
        if "SUPA" in words.keywords or once in (53, 153):
            self._machine_move(words, block)
        else:
            self._contour(words, block)
        if once == 9:
            self._emit("EXACT_STOP")
        return True

    def _contour(self, words: Words, block: Block) -> None:
        target = self._target(words)
        if self._curve not in ("", "CIP") and self._state.compensation:
            raise BlockError(f"{self._curve} does not go with radius compensation: write G40 before", self._curve)
        if words.polynomials and self._curve != "POLY":
            raise BlockError("PO[] belongs to POLY: write POLY in this block or before", "PO")
        if self._curve == "CIP":
            self._through(words, target, block)
        elif self._curve == "POLY":
            self._polynomial(words, target)
        elif self._curve:
            self._spline(words, target)
        else:
            for axis, letter in enumerate(AXES):
                if target[axis] != self._state.position[axis] or self._modal >= 2:
                    block.words[letter] = target[axis]
            if self._modal >= 2:
                self._arc_words(words, target, block)
            elif not block.words.keys() - {"f"}:
                # a move of no length, but with its feed checked as any other
                block.words["x"] = target[0]
            self._motion.move(block, 10 * self._modal, False)

    def _target(self, words: Words) -> list[float]:
        """Return the end point, mm and degrees."""
        if self._curve or not words.values.keys().isdisjoint("ABC"):
            # other blocks keep the angles of the direction before, whatever they will be
            self._state.settle()
        target, unit = list(self._state.position), INCH if self.inch else 1.0
        if "AP" in words.values or "RP" in words.values:
            self._polar_target(words, target, unit)
        for axis, letter in enumerate(AXES.upper()):
            placed = words.values.pop(letter, None)
            if placed is not None:
                target[axis] = self._placed(placed, axis, target[axis], unit if axis in LINEAR else 1.0)
        if not words.values.keys().isdisjoint(VECTOR):
            self._aim(words, target)
        return target

    def _aim(self, words: Words, target: list[float]) -> None:
        """Turn the rotary axes of a target so that the tool has the direction A3= B3= C3= of the workpiece's frame."""
        state = self._state
        if state.tool_point is None:
            word = next(word for word in VECTOR if word in words.values)
            raise BlockError(f"{word}= is a direction of the tool, whose tip is not moved: write TRAORI before", word)
        letters = state.tool_point.rotary_letters
        turned = [
            letter
            for letter in letters
            if target[AXES.index(letter.lower())] != state.position[AXES.index(letter.lower())]
        ]
        if turned:
            raise BlockError(f"{turned[0]} and A3= B3= C3= exclude each other: write one of the two ways", turned[0])
        state.aim(target, [words.take(word) or 0.0 for word in VECTOR], "A3 B3 C3", bool(self._curve))

    def _placed(self, placed: Placed, axis: int, here: float, unit: float) -> float:
        value, how = placed.value * unit, placed.how
        before = self.before.pop(axis, here)
        if how in ("DC", "ACP", "ACN"):
            if axis in LINEAR:
                raise BlockError(f"{how}() belongs to rotary axes", AXES[axis].upper())
            way = (value - here) % 360.0
            if how == "DC":
                return here + (way if way <= 180.0 else way - 360.0)
            return here + (way if how == "ACP" or way == 0.0 else way - 360.0)
        return before + value if how == "IC" or (not how and self.incremental) else value

    def _polar_target(self, words: Words, target: list[float], unit: float) -> None:
        first, second, _ = PLANES[self._state.plane]
        x, y = target[first] - self._pole[0], target[second] - self._pole[1]
        radius, angle = words.values.pop("RP", None), words.values.pop("AP", None)
        size, turned = math.hypot(x, y), math.degrees(math.atan2(y, x))
        if radius is not None:
            size = size + radius.value * unit if radius.how == "IC" else radius.value * unit
        if angle is not None:
            turned = turned + angle.value if angle.how == "IC" else angle.value
        target[first] = self._pole[0] + size * math.cos(math.radians(turned))
        target[second] = self._pole[1] + size * math.sin(math.radians(turned))

    def _set_pole(self, words: Words, code: int) -> None:
        first, second, _ = PLANES[self._state.plane]
        base = {
            110: [self._state.position[first], self._state.position[second]],
            111: [0.0, 0.0],
            112: list(self._pole),
        }
        unit = INCH if self.inch else 1.0
        pole = base[code]
        for k, axis in enumerate((first, second)):
            pole[k] += (words.take(AXES[axis].upper()) or 0.0) * unit
        self._pole = pole

    def _arc_words(self, words: Words, target: list[float], block: Block) -> None:
        """Give the words of an arc to a block of RS-274: I J K from the start, R, and P for TURN."""
        state, unit = self._state, INCH if self.inch else 1.0
        first, second, across = PLANES[state.plane]
        start = state.position[first], state.position[second]
        radius, opening, turns = words.take("CR"), words.take("AR"), words.take("TURN")
        for axis in (first, second):
            placed = words.values.pop("IJK"[axis], None)
            if placed is not None:
                value = placed.value * unit
                block.words["ijk"[axis]] = value - state.position[axis] if placed.how == "AC" else value
        # of a helix the K of its pitch is redundant with TURN and the end
        words.values.pop("IJK"[across], None)
        centered = not block.words.keys().isdisjoint("ijk")
        if radius is not None:
            block.words["r"] = radius * unit
        if opening is not None:
            self._opening(opening, block, target, start, (first, second), centered)
        if turns is not None:
            if turns < 0 or turns != round(turns):
                raise BlockError(f"TURN is a whole number of additional turns, not {turns:g}", "TURN")
            block.words["p"] = turns + 1.0

    def _opening(
        self,
        opening: float,
        block: Block,
        target: list[float],
        start: tuple[float, float],
        axes: tuple[int, int],
        centered: bool,
    ) -> None:
        """Execute AR, the opening angle of an arc, with its center or with its end."""
        if not 0.0 < opening < 360.0:
            raise BlockError(f"AR is an angle above 0 and below 360 degrees, not {opening:g}", "AR")
        first, second = axes
        if centered:
            i, j = block.words.get("ijk"[first], 0.0), block.words.get("ijk"[second], 0.0)
            x, y = rotated(-i, -j, opening if self._modal == 3 else -opening)
            block.words[AXES[first]], block.words[AXES[second]] = start[0] + i + x, start[1] + j + y
            return
        chord = math.hypot(target[first] - start[0], target[second] - start[1])
        size = 0.5 * chord / math.sin(0.5 * math.radians(opening))
        block.words["r"] = size if opening <= 180.0 else -size

    def _through(self, words: Words, target: list[float], block: Block) -> None:
        """Execute CIP: the arc through the point I1 J1 K1, in one of the planes XY, ZX and YZ."""
        state, unit = self._state, INCH if self.inch else 1.0
        middle = list(state.position[:3])
        for axis, name in enumerate(("I1", "J1", "K1")):
            placed = words.values.pop(name, None)
            if placed is not None:
                relative = placed.how == "IC" or (not placed.how and self.incremental)
                middle[axis] = placed.value * unit + (middle[axis] if relative else 0.0)
        begin, end = state.position[:3], target[:3]
        plane = next((code for code, (_, _, k) in PLANES.items() if begin[k] == middle[k] == end[k]), None)
        if plane is None:
            raise BlockError(
                "the circle of CIP lies in none of the planes XY, ZX and YZ: such circles are not planned", "CIP"
            )
        if plane != state.plane and state.compensation:
            raise BlockError("CIP in another plane does not go with radius compensation: write G40 before", "CIP")
        first, second, _ = PLANES[plane]
        a, b, c = ((point[first], point[second]) for point in (begin, middle, end))
        center = _center(a, b, c)
        turned = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        assert sweep(a, c, center, 1) > 0.0
        for axis, letter in enumerate(AXES):
            block.words[letter] = target[axis]
        block.words["ijk"[first]], block.words["ijk"[second]] = center[0] - a[0], center[1] - a[1]
        kept = state.plane
        for code in (plane, kept) if plane != kept else ():
            if code == plane:
                self._switches.plane(code)
        self._motion.move(block, 30 if turned > 0.0 else 20, False)
        if plane != kept:
            self._switches.plane(kept)

    def _spline(self, words: Words, target: list[float]) -> None:
        """Read a block of ASPLINE, BSPLINE or CSPLINE: a point, of BSPLINE with its weight PW."""
        state, kind = self._state, self._curve
        if state.feed_mode == 930 or state.feed <= 0:
            raise BlockError(f"{kind} needs a feed above 0 in G94 or G95: write F in this block or before", kind)
        moved = [AXES[axis].upper() for axis in range(3, 9) if target[axis] != state.position[axis]]
        if moved:
            raise BlockError(f"{kind} moves X, Y and Z: move {moved[0]} in a block of its own", moved[0])
        length = words.take("PL")
        spline = state.spline
        if spline and (spline.closed or spline.kind != kind):
            # its end has no move behind it
            self._run.end_spline(None)
            spline = None
        if spline is None:
            spline = self._run.begin_spline(kind, self._degree, self._edges)
            self._step = length
            if kind not in self._told:
                self._told.add(kind)
                what = "knots are even" if kind == "BSPLINE" else "the parameter is the sum of chords"
                self._emit("MESSAGE", f"{kind}: {what}; those of the control are not documented")
        if length != self._step or (length is not None and kind != "BSPLINE"):
            raise BlockError("PL is read in BSPLINE, and if it is the same in all blocks: even knots", "PL")
        spline.end_by(self._edges.end)
        spline.add(self._run.line, target, words.take("PW"))
        self._lines.moved()
        state.position = list(target)

    def _polynomial(self, words: Words, target: list[float]) -> None:
        """Execute POLY: x(p) = x0 + a1 p + a2 p² + a3 p³ with x(PL) the end, as a Bezier curve of third degree."""
        state = self._state
        length = words.take("PL")
        span = 1.0 if length is None else length
        if not span > 0.0:
            raise BlockError(f"PL is the length of the parameter and above 0, not {span:g}", "PL")
        if state.feed_mode == 930 or state.feed <= 0:
            raise BlockError("POLY needs a feed above 0 in G94 or G95: write F in this block or before", "POLY")
        start = list(state.position)
        higher = [[0.0] * 9, [0.0] * 9]
        for letter, row in words.polynomials.items():
            axis = AXES.index(letter.lower())
            unit = INCH if self.inch and axis in LINEAR else 1.0
            if not 1 <= len(row) <= 3:
                raise BlockError(
                    f"PO[{letter}] has an end and a2, a3: polynomials above third degree are not read", "PO"
                )
            target[axis] = self._placed(Placed(row[0]), axis, start[axis], unit)
            for k, a in enumerate(row[1:]):
                higher[k][axis] = a * unit * span ** (k + 2)
        points: list[float] = []
        # Bernstein form of c1 s + c2 s² + c3 s³ with s = p / PL
        for share, of in (((1.0, 0.0), 3.0), ((2.0, 1.0), 3.0)):
            for x0, x1, c2, c3 in zip(start, target, *higher, strict=True):
                c1 = x1 - x0 - c2 - c3
                points.append(x0 + (share[0] * c1 + share[1] * c2) / of)
        self._lines.moved()
        self._emit("BEZIER_FEED", *points, *target)
        state.position = list(target)

    def _machine_move(self, words: Words, block: Block) -> None:
        """Execute a straight move in machine coordinates (G53, G153, SUPA)."""
        if self._modal > 1 or self._curve:
            raise BlockError("G53, G153 and SUPA go with G0 and G1", "SUPA" if "SUPA" in words.keywords else "G")
        if self._state.tool_point:
            raise BlockError(
                "positions of the machine's axes do not go with TRAORI: write TRAFOOF in a line before",
                "SUPA" if "SUPA" in words.keywords else "G",
            )
        state, unit = self._state, INCH if self.inch else 1.0
        standing = state.machine(state.position)
        machine = list(standing)
        for axis, letter in enumerate(AXES.upper()):
            value = words.take(letter)
            if value is not None:
                machine[axis] = value * (unit if axis in LINEAR else 1.0)
                self.before.pop(axis, None)
        target = state.program(machine)
        for axis, letter in enumerate(AXES):
            # converting there and back would change the last digits of an axis that does not move
            if machine[axis] != standing[axis] or (state.rotation and axis < 2):
                block.words[letter] = target[axis]
        block.words.setdefault("x", state.position[0])
        self._motion.move(block, 10 * self._modal, False)


def _center(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> tuple[float, float]:
    """Return the center of the circle through three points."""
    bx, by, cx, cy = b[0] - a[0], b[1] - a[1], c[0] - a[0], c[1] - a[1]
    twice = 2.0 * (bx * cy - by * cx)
    if abs(twice) <= 1e-12 * (bx * bx + by * by + cx * cx + cy * cy):
        raise BlockError("the three points of CIP lie on a line: write G1, or correct I1 J1 K1", "CIP")
    b2, c2 = bx * bx + by * by, cx * cx + cy * cy
    return a[0] + (cy * b2 - by * c2) / twice, a[1] + (bx * c2 - cx * b2) / twice

"""Part programs of SINUMERIK controls, as canonical commands.

    N10 G17 G54 G642 CTOL=0.02 F2000        words, with values after = where the word ends with a letter and more
    N20 R1=10 DEF REAL DEPTH=-2.5           R parameters and variables; expressions
    N30 TRANS X10 ROT ...                   the programmable frame: shifts, and rotations about Z
    N40 G2 X=IC(20) Y0 CR=10                AC() and IC() of each word, radius, TURN=, AR=, CIP
    N50 IF R1>0 GOTOB AGAIN                 jumps to labels and block numbers, IF, FOR, WHILE, REPEAT, LOOP

    machine = origin of G54 .. + R(rotation) (TRANS + R(ROT) program)

What is programmed in inches (G70, G700) is converted when it is read.  A word that this reader knows but does not plan
is refused with its reason, and so is one that it does not know.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Generator
from pathlib import Path

from feeddrive.language.quantity import Quantity
from feeddrive.path.program.blocks import AXES, BlockError, Line
from feeddrive.path.program.compensation import Corners
from feeddrive.path.program.execution import Execution, Setting
from feeddrive.path.program.moves import Command, Orientation
from feeddrive.path.program.siemens_block import ORIENTATIONS, PATH_MODES, SYSTEMS, BlockReader, Words
from feeddrive.path.program.siemens_flow import Call, SiemensFlow, begin_of, without_comment
from feeddrive.path.program.siemens_motion import SiemensMotion
from feeddrive.path.program.siemens_words import Values
from feeddrive.path.program.state import (
    INCH,
    LINEAR,
    Names,
    begin_tool_point,
    end_tool_point,
    first_of,
    rotated,
    set_tool_offset,
    turn_by,
)

ROUNDED = 0.22
"""The part of ADIS (G641) that is taken as the tolerance: what a blend over that length on both sides of a corner of 90
degrees leaves out of it."""
FIRST_NAMED = 90_001
"""The number of the first tool with a name that neither is a number nor stands as a remark in the tool table."""
NAMES = Names("TRAORI", "TRAFOOF")

_SPINDLE = {3: 1, 4: -1, 5: 0}
_DELETED = re.compile(r"\s*/[0-9]?\s*")
_RETURN = -1  # RET, besides the M codes that end a program
_ENDS = frozenset({2, 17, 30, _RETURN})
_DYNAMICS = {1: "_FINISH", 2: "_SEMIFIN", 3: "_ROUGH", 4: "_PRECISION"}


class SiemensInterpreter:
    """The interpreter of a SINUMERIK part program; parameters of the setting are variables, R1 .. are R parameters."""

    def __init__(self, program: Path, setting: Setting) -> None:
        self._run = run = Execution(program, setting, NAMES)
        self._setting, self._state, self._tools = setting, run.state, run.tools
        self._emit, self._lines, self._switches = run.emit, run.lines, run.switches
        variables = {"".join(name.split()).upper(): value for name, value in setting.parameters.items()}
        self._flow = SiemensFlow(run.lines, variables, self._live, self._save)
        self._reader = BlockReader(self._flow, run.emit)
        self._moves = SiemensMotion(run)
        self._shift, self._angle = [0.0] * 9, 0.0  # programmable frame, mm and degrees
        self._settable: list[float] = [0.0] * 9
        self._system = 1  # 0 for G500
        self._inch_feed = False
        self._contour_tolerance = self._rounding = 0.0
        self._path = 64
        self._named: dict[str, int] = {}
        self._edge = 1.0  # D of the tool in the spindle
        self._length = [0.0] * 9  # its offset, mm and degrees
        self._corners, self._side, self._follows = Corners(square=True), 40, False  # G450 .., G40 .., KONT
        self._turns: Orientation | None = None  # how the tool turns (ORIVECT ..), None until it is said
        self._next_edge = 1.0  # D of the tool that the next M6 changes to
        self._ended = False
        self._rotation = 0.0  # of the settable offset, degrees

    def commands(self) -> Generator[Command]:
        """Yield the canonical commands in program order."""
        return self._run.commands(self)

    # what `Execution` asks of a language

    @property
    def loop(self) -> str:
        """The innermost loop that is running in the program itself, with its line."""
        return self._flow.loop

    def begin(self) -> None:
        """Emit the state at the start of the program."""
        self._emit("USE_LENGTH_UNITS", "CANON_UNITS_MM")
        # the settable offsets act from the start on, as if G54 stood there: 0 without a table
        self._choose_system(1)
        self._state.position = self._state.program(self._setting.start)
        self._emit("SET_G92_OFFSET", *[0.0] * 9)
        self._moves.before.clear()
        self._emit("ON_RESET")
        self._set_path(64)

    def execute(self, line: Line) -> bool:
        """Execute a line; return True if it ends the program."""
        text = without_comment(line.text)
        if deleted := _DELETED.match(text):
            if self._setting.skip_deleted:
                return False
            text = " " * deleted.end() + text[deleted.end() :]
        ends, word, at = self._flow.take(text)
        if ends:
            return self.finish()
        values = Values(text, begin_of(text), self._flow.value)
        if word:
            self._flow.control(word, values, at)
        elif at < len(values.text):
            self._act(self._reader.read(values))
        return self._ended

    def finish(self) -> bool:
        """End the program, or return from a subprogram, at the end of its file or section."""
        self._flow.check_end()
        if not self._flow.leave():
            return False
        self._run.end_spline(None)
        self._switches.leave_contour()
        self._emit("FINISH")
        return True

    def words(self) -> str:
        """Return the modal state as words: that of the path, of the machine and of the frame."""
        state = self._state
        words = [
            "G700" if self._inch_feed else "G70" if self._moves.inch else "G71",
            f"G{state.plane // 10}",
            "G91" if self._moves.incremental else "G90",
            f"G{state.feed_mode // 10}",
            f"G{self._path}",
        ]
        words += [f"CTOL={self._contour_tolerance:.6g}"] if self._contour_tolerance else []
        words += [f"ADIS={self._rounding:.6g}"] if self._rounding else []
        words += [next((f"G{code}" for code, system in SYSTEMS.items() if system == self._system), "G500")]
        words += [f"G{450 + self._corners.sharp}", f"T{state.tool}"]
        words += ["D1"] if any(state.tool_offset) else []
        words += [f"S{state.speed:.6g} {'M3' if state.spindle > 0 else 'M4'}" if state.spindle else "M5"]
        words += [word for word, on in (("M7", state.mist), ("M8", state.flood)) if on]
        shift = [f"{AXES[axis].upper()}{value:.8g}" for axis, value in enumerate(self._shift) if value]
        words += [" ".join(["TRANS", *shift])] if shift else []
        words += [f"AROT RPL={self._angle:.8g}"] if self._angle else []
        return " ".join(words)

    def _save(self) -> Callable[[], None]:
        """Return a function that restores the modal G codes and the frames of now: SAVE of a subprogram.

        F, S, T, D, the tolerances and what is no G code stand as the subprogram leaves them.
        """
        state, moves = self._state, self._moves
        codes = moves.saved()
        unit, distance = (moves.inch, self._inch_feed), moves.incremental
        plane, feed_mode, path = state.plane, state.feed_mode, self._path
        system, shift, angle = self._system, list(self._shift), self._angle
        side, follows, corners, turns = self._side, self._follows, self._corners, self._turns

        def restore() -> None:
            if side != self._side:
                raise BlockError(
                    f"G{self._side} is on at the end of a subprogram with SAVE, which restores G{side}: write G{side} "
                    "and a straight move in it",
                    "SAVE",
                )
            moves.restore(codes)
            moves.inch, self._inch_feed = unit
            moves.incremental = distance
            if state.feed_mode != feed_mode:
                self._switches.feed_mode(feed_mode)
            if state.plane != plane:
                self._switches.plane(plane)
            if self._path != path:
                self._set_path(path)
            self._follows, self._corners = follows, corners
            if state.compensation:
                state.compensation.corners = corners
            if turns is not None and turns != self._turns and state.tool_point:
                turn_by(state, self._emit, turns)
            self._turns = turns
            if (self._system, self._shift, self._angle) != (system, shift, angle):
                # its coordinates turn
                self._run.end_spline(None)
                self._shift, self._angle = list(shift), angle
                self._choose_system(system)

        return restore

    def _live(self, name: str, index: str | None) -> float:
        """Return the value of a system variable."""
        if name in ("$AA_IW", "$P_EP", "$AA_IM") and index is not None:
            axis = AXES.find(index.strip().lower()) if len(index.strip()) == 1 else -1
            if axis < 0:
                raise BlockError(f"{name} needs the letter of an axis: write {name}[X]", name)
            state = self._state
            if axis not in LINEAR:
                state.settle()
            return (state.machine(state.position) if name == "$AA_IM" else state.position)[axis]
        raise BlockError(f"the system variable {name} is not known before: write its value", name)

    # what a block does

    def _act(self, words: Words) -> None:
        codes, state = words.codes, self._state
        if words.high_speed is not None:
            self._high_speed(words.high_speed)
        if words.call and (codes or words.m_codes or words.frames or words.values.keys() - {"P"}):
            raise BlockError(
                f"the call of {words.call.name} stands in a block of its own: use two lines", words.call.name
            )
        if state.compensation and codes.get("radius") != 40:
            self._refuse_on_contour(words)
        if state.spline:
            self._refuse_in_spline(words)
        if "feed" in codes:
            self._switches.feed_mode(10 * codes["feed"])
        if "unit" in codes:
            self._moves.inch, self._inch_feed = codes["unit"] in (70, 700), codes["unit"] == 700
        if "F" in words.values and state.feed_mode != 930 and codes.get("once") != 4:
            self._switches.feed((words.take("F") or 0.0) * (INCH if self._inch_feed else 1.0))
        if codes.get("once") == 4:
            self._dwell(words)
        if (speed := words.take("S")) is not None:
            self._switches.speed(speed)
        stop = self._tools_and_switches(words)
        self._tool_point(words)
        if "plane" in codes:
            self._switches.plane(10 * codes["plane"])
        if "distance" in codes:
            self._moves.incremental = codes["distance"] == 91
        self._path_words(words)
        if "offset" in codes:
            self._choose_system(SYSTEMS.get(codes["offset"], 0))
        self._radius_words(words)
        moved = False
        if words.frames:
            self._set_frame(words)
        else:
            moved = self._moves.move(words)
        call = self._call_of(words)
        if "RET" in words.keywords:
            stop = _RETURN
        if words.values:
            letter = next(iter(words.values))
            raise BlockError(
                f"no code of this block uses the word {letter}: take it out, or write the code it belongs to", letter
            )
        if call:
            self._flow.call(call, "MCALL" in words.keywords)
        elif moved:
            if stop in _ENDS and self._flow.modal:
                raise BlockError("a motion behind which MCALL calls does not return in its block: use two lines", "M17")
            self._flow.moved()
        if stop is not None:
            self._stop(stop)

    def _call_of(self, words: Words) -> Call | None:
        """Return the call of a subprogram, with its repeats, and end the modal call by MCALL alone."""
        call = words.call
        if "MCALL" in words.keywords and call is None:
            self._flow.end_modal()
        if call is None:
            return None
        repeats = words.take("P")
        if repeats is None:
            return call
        if repeats != round(repeats):
            raise BlockError(f"P repeats a call a whole number of times, not {repeats:g}", "P")
        return call._replace(repeats=round(repeats))

    # radius compensation and tool point

    def _refuse_on_contour(self, words: Words) -> None:
        """Refuse what radius compensation excludes."""
        codes, state = words.codes, self._state
        plane = codes.get("plane", state.plane // 10) != state.plane // 10
        named = [f"G{codes[group]}" for group, on in (("plane", plane), ("offset", "offset" in codes)) if on]
        named += [f"G{codes['once']}"] if codes.get("once") in (53, 153) else []
        named += words.frames + [word for word in words.keywords if word in ("SUPA", "TRAORI", "TRAFOOF")]
        named += ["M6"] if 6 in words.m_codes else ["D"] if "D" in words.values and words.tool is None else []
        if named:
            raise BlockError(
                f"{named[0]} does not go with radius compensation: write G40 in a line before it", named[0]
            )

    def _refuse_in_spline(self, words: Words) -> None:
        """Refuse what changes coordinates before the end of a spline is known."""
        codes = words.codes
        named = [f"G{codes[group]}" for group in ("offset", "radius") if codes.get(group, 40) != 40]
        named += words.frames + [word for word in words.keywords if word in ("TRAORI", "TRAFOOF")]
        named += ["M6"] if 6 in words.m_codes else ["D"] if "D" in words.values and words.tool is None else []
        if named:
            raise BlockError(
                f"{named[0]} stands before the end of a spline is known: write the move behind the spline before it",
                named[0],
            )

    def _radius_words(self, words: Words) -> None:
        """Execute G40, G41, G42; how the contour is entered (NORM, KONT); its corners (G450, G451)."""
        codes, state = words.codes, self._state
        self._follows = "KONT" in words.keywords or (self._follows and "NORM" not in words.keywords)
        if words.take("DISC"):
            raise BlockError("DISC distorts the arc at a corner, which is not planned: write DISC=0, or G451", "DISC")
        if "corner" in codes:
            self._corners = self._corners._replace(sharp=codes["corner"] == 451)
            if state.compensation:
                state.compensation.corners = self._corners
        code = codes.get("radius")
        if code == 40:
            self._switches.leave_contour()
            self._side = 40
        elif code is not None and code != self._side:
            name = f"G{code}"
            if self._side != 40:
                raise BlockError(f"G{self._side} is on: write G40 and a straight move before {name}", name)
            if self._follows:
                raise BlockError("the way around the start of the contour (KONT) is not planned: write NORM", "KONT")
            self._side = code
            self._switches.begin_contour(name, self._diameter(name), code == 41, self._corners)

    def _diameter(self, name: str) -> float:
        """Return the diameter of the tool with its active cutting edge, mm."""
        state = self._state
        tool = self._tools.get(state.tool) if self._tools is not None else None
        if tool is None:
            reason = f"tool {state.tool} is not in the tool table" if state.tool else "no tool is in the spindle"
            raise BlockError(f"{reason}, whose radius {name} needs: give the table, and write T, M6 and D1", name)
        self._switches.check_round(tool.orientation, name)
        # D0 is no cutting edge, and its radius 0
        return tool.diameter * state.scale if self._edge else 0.0

    def _tool_point(self, words: Words) -> None:
        """Execute TRAORI (from here on X Y Z are the tip of the tool), TRAFOOF (the axes of the machine), and the words
        that say how the tool turns.
        """
        state = self._state
        turns = [word for word in words.keywords if word in ORIENTATIONS]
        if len(turns) > 1:
            raise BlockError(f"{turns[0]} and {turns[1]} exclude each other: write one of them", turns[1])
        if turns:
            self._turns = ORIENTATIONS[turns[0]]
            if state.tool_point and self._turns != state.orientation:
                turn_by(state, self._emit, self._turns)
        if "TRAORI" in words.keywords and not state.tool_point:
            begin_tool_point(state, self._emit, "TRAORI", state.tool_offset, False, self._turns)
            self._moves.before.clear()
            self._run.forget_heading()
        elif "TRAFOOF" in words.keywords and state.tool_point:
            end_tool_point(state, self._emit)
            if any(self._length):
                set_tool_offset(state, self._emit, self._length)
            self._moves.before.clear()
            self._run.forget_heading()

    def _dwell(self, words: Words) -> None:
        seconds, turns = words.take("F"), words.take("S")
        if seconds is None and turns is not None and self._state.speed > 0:
            seconds = 60.0 * turns / self._state.speed
        if seconds is None or seconds < 0:
            raise BlockError("G4 needs F and the seconds, or S and turns of a turning spindle", "G4")
        self._switches.dwell(seconds, "F")

    def _tools_and_switches(self, words: Words) -> int | None:
        """Execute T, D and M; return the M code that stops or ends the program."""
        stop = None
        edge = words.take("D")
        if words.tool is not None:
            # the cutting edge is that of the tool that M6 will change to, and the first one if none is named
            self._next_edge, edge = 1.0 if edge is None else edge, None
            self._switches.select(self._tool_number(words.tool))
        for code in words.m_codes:
            if code == 6:
                self._switches.change_tool("M6")
                edge, self._next_edge = self._next_edge if edge is None else edge, 1.0
            elif code in _SPINDLE:
                self._switches.turn(_SPINDLE[code])
            elif code in (7, 8, 9):
                self._switches.coolant(mist=code == 7, flood=code == 8)
            elif code in (0, 1, 2, 17, 30):
                stop = code
            elif 40 <= code <= 45:
                self._emit("IGNORED", f"M{code}")
            else:
                raise BlockError(
                    f"what M{code} does is decided by the maker of the machine, or it turns the spindle to a position: "
                    "take it out",
                    f"M{code}",
                )
        if edge is not None:
            self._tool_length(edge)
        if "STOPRE" in words.keywords:
            self._emit("EXACT_STOP")
        return stop

    def _tool_number(self, name: str) -> int:
        if name.isdigit():
            number = int(name)
            if self._tools is not None and number and number not in self._tools:
                raise BlockError(f"tool {number} is not in the tool table: add it there", "T")
            return number
        for number, tool in (self._tools or {}).items():
            if tool.remark.strip().upper() == name.upper():
                return number
        if self._tools is not None:
            raise BlockError(f'the tool "{name}" is not in the tool table: add it there, with its name as remark', "T")
        number = self._named.setdefault(name.upper(), FIRST_NAMED + len(self._named))
        self._emit("MESSAGE", f'tool "{name}" has the number {number} here')
        return number

    def _tool_length(self, edge: float) -> None:
        tool = self._tools.get(self._state.tool) if self._tools is not None else None
        if edge != round(edge) or not 0 <= edge <= 12:
            raise BlockError(f"D is a whole number from 0 to 12, not {edge:g}", "D")
        if edge > 1 and self._tools is not None:
            raise BlockError(f"the tool table has one cutting edge a tool, and no D{edge:g}: write D1", "D")
        if edge and tool is None:
            # without a table the program moves the tip of a tool of no length
            self._emit("IGNORED", f"D{edge:g}")
            return
        state = self._state
        self._edge = edge
        self._length = state.to_program(tool.offset) if tool is not None and edge else [0.0] * 9
        turns = state.tool_point is not None
        # the length changes where the machine stands, and the tip with it
        end_tool_point(state, self._emit)
        set_tool_offset(state, self._emit, self._length)
        if turns:
            begin_tool_point(state, self._emit, "TRAORI", self._length, False, self._turns)

    def _stop(self, code: int) -> None:
        if code in (0, 1):
            self._switches.stop(optional=bool(code))
            return
        if self._lines.calls:
            if code != _RETURN:
                self._emit("EXACT_STOP")
            self._flow.leave()
            return
        self._run.end_spline(None)
        self._switches.leave_contour()
        end_tool_point(self._state, self._emit)
        self._emit("STOP_SPINDLE_TURNING", 0)
        self._emit("PROGRAM_END")
        self._ended = True

    # path modes

    def _path_words(self, words: Words) -> None:
        tolerance, rounding = words.take("CTOL"), words.take("ADIS")
        for name, value in (("CTOL", tolerance), ("ADIS", rounding)):
            if value is not None and value < 0:
                raise BlockError(f"a tolerance is not negative: {name}={Quantity(value):6}", name)
        unit = INCH if self._moves.inch else 1.0
        for name in ("OTOL", "ATOL", "ADISPOS"):
            if words.take(name) is not None:
                self._emit("IGNORED", name)
        if tolerance is not None:
            self._contour_tolerance = tolerance * unit
        if rounding is not None:
            self._rounding = rounding * unit
        if "path" in words.codes or tolerance is not None or rounding is not None:
            self._set_path(words.codes.get("path", self._path))

    def _set_path(self, code: int) -> None:
        """Execute G60 or G64 ff: G641 within a part of ADIS, G642 to G645 within CTOL or the tolerance of CYCLE832."""
        self._path = code
        within = {64: 0.0, 641: ROUNDED * self._rounding}.get(code, self._contour_tolerance)
        self._switches.path_mode(PATH_MODES[code], within, within)

    def _high_speed(self, arguments: list[str]) -> None:
        """Execute CYCLE832(tolerance, type, ...): continuous within the tolerance; CYCLE832() and type 0 end it."""
        given = [argument.strip() for argument in arguments]
        tolerance = Values(given[0], 0, self._flow.value).whole() if given and given[0] else 0.0
        kind = given[1].upper() if len(given) > 1 else ""
        name = (
            ""
            if not kind
            else kind
            if kind.startswith("_")
            else str(int(Values(kind, 0, self._flow.value).whole()) % 10)
        )
        if tolerance < 0:
            raise BlockError(f"a tolerance is not negative: {Quantity(tolerance):6}", "CYCLE832")
        off = name in ("_OFF", "0") or not any(given)
        self._contour_tolerance = 0.0 if off else tolerance * (INCH if self._moves.inch else 1.0)
        self._set_path(64 if off else 645)
        if not off and name:
            # the dynamics of a plan are those of --for, for the whole program
            self._emit("IGNORED", f"CYCLE832 {_DYNAMICS.get(int(name), name) if name.isdigit() else name}")

    # frames

    def _choose_system(self, system: int) -> None:
        state = self._state
        state.system, self._system = system or 1, system
        numbered = state.parameters.numbered
        # the offset acts in mm here, whatever the program's unit is
        self._settable = state.stored(first_of(system)) if system else [0.0] * 9
        self._rotation = numbered.get(first_of(system) + 9, 0.0) if system else 0.0
        self._frame()

    def _frame(self) -> None:
        state = self._state
        state.settle()
        shift = list(self._shift)
        shift[0], shift[1] = rotated(shift[0], shift[1], self._rotation)
        origin = [o + s for o, s in zip(self._settable, shift, strict=True)]
        # an incremental move behind a change of frames also makes the change (SD42440, whose default this is)
        for axis, value in enumerate(state.position):
            self._moves.before.setdefault(axis, value)
        if self._rotation + self._angle != state.rotation:
            self._run.forget_heading()
        state.keep_machine(origin, self._rotation + self._angle)
        self._emit("SET_G5X_OFFSET", state.system, *origin)
        self._emit("SET_XY_ROTATION", state.rotation)

    def _set_frame(self, words: Words) -> None:
        """Execute TRANS, ATRANS, ROT or AROT, which stand in a block of their own."""
        if len(words.frames) > 1 or words.keywords:
            raise BlockError("a frame stands in a block of its own: use two lines", words.frames[-1])
        name, unit = words.frames[0], INCH if self._moves.inch else 1.0
        if not name.startswith("A"):
            # an absolute frame replaces all of the programmable one
            self._shift, self._angle = [0.0] * 9, 0.0
        if name.endswith("TRANS"):
            added = [0.0] * 9
            for axis, letter in enumerate(AXES.upper()):
                value = words.take(letter)
                if value is not None:
                    added[axis] = value * (unit if axis in LINEAR else 1.0)
            added[0], added[1] = rotated(added[0], added[1], self._angle)
            self._shift = [s + a for s, a in zip(self._shift, added, strict=True)]
        else:
            angles = {letter: words.take(letter) for letter in ("X", "Y", "Z", "RPL")}
            plane = "Z" if self._state.plane == 170 else "Y" if self._state.plane == 180 else "X"
            about = {plane if letter == "RPL" else letter: angle for letter, angle in angles.items() if angle}
            if set(about) - {"Z"}:
                raise BlockError("planes that are tilted about X or Y need five axes, which are not planned here", name)
            self._angle += about.get("Z", 0.0)
        self._frame()

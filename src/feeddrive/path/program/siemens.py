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

import math
import re
from collections.abc import Generator
from pathlib import Path
from typing import NamedTuple

from feeddrive.language.quantity import Quantity
from feeddrive.path.program import blocks
from feeddrive.path.program.blocks import AXES, Block, BlockError, Line
from feeddrive.path.program.compensation import Corners
from feeddrive.path.program.execution import Execution, Setting
from feeddrive.path.program.motion import PLANES
from feeddrive.path.program.moves import Command, sweep
from feeddrive.path.program.siemens_flow import Call, SiemensFlow, begin_of, program_name, without_comment
from feeddrive.path.program.siemens_splines import BEGINS, ENDS, KINDS, Edges
from feeddrive.path.program.siemens_words import IGNORED, Values, ignored_g, refusal
from feeddrive.path.program.state import (
    INCH,
    LINEAR,
    Names,
    begin_tool_point,
    end_tool_point,
    first_of,
    rotated,
    set_tool_offset,
)

ROUNDED = 0.22
"""The part of ADIS (G641) that is taken as the tolerance: what a blend over that length on both sides of a corner of 90
degrees leaves out of it."""
FIRST_NAMED = 90_001
"""The number of the first tool with a name that neither is a number nor stands as a remark in the tool table."""

_SYSTEMS = {54: 1, 55: 2, 56: 3, 57: 4, 505: 5, 506: 6, 507: 7, 508: 8, 509: 9}
_MODES = {60: "CANON_EXACT_STOP", **dict.fromkeys((64, 641, 642, 643, 644, 645), "CANON_CONTINUOUS")}
# groups of G codes of which one block has one at most
_GROUPS: dict[str, tuple[int, ...]] = {
    "motion": (0, 1, 2, 3),
    "plane": (17, 18, 19),
    "path": tuple(_MODES),
    "offset": (*_SYSTEMS, 500),
    "distance": (90, 91),
    "feed": (93, 94, 95),
    "unit": (70, 71, 700, 710),
    "once": (4, 9, 53, 110, 111, 112, 153),
    "radius": (40, 41, 42),
    "corner": (450, 451),
    "other": (97,),
}
_GROUP = {code: group for group, codes in _GROUPS.items() for code in codes}
_SPINDLE = {3: 1, 4: -1, 5: 0}
_MOTIONS = {"CIP", "POLY", *KINDS}
_KEYWORDS = {"SUPA", "FNORM", "DIAMOF", "RET", "STOPRE", "NORM", "KONT", "ORIAXES", "ORIMKS", "MCALL", *BEGINS, *ENDS}
_WITH_ARGUMENTS = {"MSG", "CYCLE832", "CYCLE800", "CALL", "EXTCALL", "TRAORI", "TRAFOOF"}
_FRAMES = {"TRANS", "ATRANS", "ROT", "AROT"}
VECTOR = ("A3", "B3", "C3")
"""The words of the direction of the tool, from its tip to the spindle."""
# what can stand before =, besides variables and R parameters
_WORDS = frozenset(
    {
        *(*AXES.upper(), *"IJKFSDT", "CR", "TURN", "AR", "AP", "RP", "I1", "J1", "K1", "CTOL", "OTOL", "ATOL"),
        *("RPL", "ADIS", "ADISPOS", "S1", "M1", "PL", "P", "DISC", "PW", "SD", *VECTOR),
    }
)
_ADDRESS = re.compile(r"([A-Z])([+-]?(?:\d+\.?\d*|\.\d+)(?:EX[+-]?\d+)?)", re.IGNORECASE)
_LETTER_NUMBER = re.compile(r"[A-Z]\d+")
_NAME = re.compile(r"[A-Z_$][A-Z0-9_]*", re.IGNORECASE)
_ASSIGNED = re.compile(r"([A-Z_$][A-Z0-9_]*)\s*(\[[^\]=]*\])?\s*=(?!=)", re.IGNORECASE)
_DELETED = re.compile(r"\s*/[0-9]?\s*")
_RETURN = -1  # RET, besides the M codes that end a program
_DYNAMICS = {1: "_FINISH", 2: "_SEMIFIN", 3: "_ROUGH", 4: "_PRECISION"}


NAMES = Names("TRAORI", "TRAFOOF")


class Placed(NamedTuple):
    """A value of a word: absolute (AC), incremental (IC), as G90 or G91 says (empty), or of a rotary axis (DC ...)."""

    value: float
    how: str = ""


class _Words:
    """The words of one block: values by name, G codes by group, M codes, keywords, and calls."""

    def __init__(self) -> None:
        self.values: dict[str, Placed] = {}
        self.codes: dict[str, int] = {}
        self.m_codes: list[int] = []
        self.keywords: list[str] = []
        self.frames: list[str] = []
        self.polynomials: dict[str, list[float]] = {}
        self.tool: str | None = None
        self.call: Call | None = None

    def take(self, name: str) -> float | None:
        """Remove a word that is always absolute, and return its value."""
        placed = self.values.pop(name, None)
        if placed is None:
            return None
        if placed.how:
            raise BlockError(f"{placed.how}() belongs to words of axes: write {name}= and the value", name)
        return placed.value


class SiemensInterpreter:
    """The interpreter of a SINUMERIK part program; parameters of the setting are variables, R1 .. are R parameters."""

    def __init__(self, program: Path, setting: Setting) -> None:
        self._run = run = Execution(program, setting, NAMES)
        self._setting, self._state, self._tools = setting, run.state, run.tools
        self._emit, self._lines, self._switches, self._motion = run.emit, run.lines, run.switches, run.motion
        variables = {"".join(name.split()).upper(): value for name, value in setting.parameters.items()}
        self._flow = SiemensFlow(run.lines, variables, self._live)
        self._shift, self._angle = [0.0] * 9, 0.0  # programmable frame, mm and degrees
        self._settable: list[float] = [0.0] * 9
        self._system = 1  # 0 for G500
        self._modal = 1  # G0 .. G3; the control starts in G1
        self._curve = ""  # CIP or POLY in place of G0 .. G3
        self._incremental = self._inch = self._inch_feed = False
        self._pole = [0.0, 0.0]
        self._contour_tolerance = self._rounding = 0.0
        self._path = 64
        self._named: dict[str, int] = {}
        self._edge = 1.0  # D of the tool in the spindle
        self._length = [0.0] * 9  # its offset, mm and degrees
        self._corners, self._side, self._follows = Corners(square=True), 40, False  # G450 .., G40 .., KONT
        self._edges, self._degree = Edges(), 3  # of splines
        self._step: float | None = None  # PL of BSPLINE
        self._told: set[str] = set()  # kinds of splines of which the operator was told
        self._next_edge = 1.0  # D of the tool that the next M6 changes to
        self._ended = False
        self._before: dict[int, float] = {}  # coordinates of axes that were not programmed since frames changed
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
        self._before.clear()
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
            self._block(values)
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
            "G700" if self._inch_feed else "G70" if self._inch else "G71",
            f"G{state.plane // 10}",
            "G91" if self._incremental else "G90",
            f"G{state.feed_mode // 10}",
            f"G{self._path}",
        ]
        words += [f"CTOL={self._contour_tolerance:.6g}"] if self._contour_tolerance else []
        words += [f"ADIS={self._rounding:.6g}"] if self._rounding else []
        words += [next((f"G{code}" for code, system in _SYSTEMS.items() if system == self._system), "G500")]
        words += [f"G{450 + self._corners.sharp}", f"T{state.tool}"]
        words += ["D1"] if any(state.tool_offset) else []
        words += [f"S{state.speed:.6g} {'M3' if state.spindle > 0 else 'M4'}" if state.spindle else "M5"]
        words += [word for word, on in (("M7", state.mist), ("M8", state.flood)) if on]
        shift = [f"{AXES[axis].upper()}{value:.8g}" for axis, value in enumerate(self._shift) if value]
        words += [" ".join(["TRANS", *shift])] if shift else []
        words += [f"AROT RPL={self._angle:.8g}"] if self._angle else []
        return " ".join(words)

    def _live(self, name: str, index: str | None) -> float:
        """Return the value of a system variable."""
        if name in ("$AA_IW", "$P_EP", "$AA_IM") and index is not None:
            axis = AXES.find(index.strip().lower()) if len(index.strip()) == 1 else -1
            if axis < 0:
                raise BlockError(f"{name} needs the letter of an axis: write {name}[X]", name)
            state = self._state
            return (state.machine(state.position) if name == "$AA_IM" else state.position)[axis]
        raise BlockError(f"the system variable {name} is not known before: write its value", name)

    # words

    def _block(self, values: Values) -> None:
        words = _Words()
        while values.skipped():
            self._word(values, words)
        self._act(words)

    def _word(self, values: Values, words: _Words) -> None:
        text, at = values.text, values.at
        assigned = _ASSIGNED.match(text, at)
        if assigned and self._assignable(assigned[1].upper()):
            values.at = assigned.end()
            self._assign(values, words, assigned[1].upper(), assigned[2])
            return
        name = _NAME.match(text, at)
        keyword = name[0].upper() if name else ""
        # X1 is the axis X at 1; the axis X1 stands before = only
        if name and not _LETTER_NUMBER.fullmatch(keyword) and (reason := refusal(keyword)):
            raise values.fault(reason, at, keyword)
        if name and keyword in IGNORED:
            values.at = name.end()
            values.arguments()
            self._emit("IGNORED", keyword)
            return
        if name and self._keyword(values, words, keyword, name.end()):
            return
        address = _ADDRESS.match(text, at)
        if name and (not address or re.fullmatch(r"L\d+", keyword)):
            self._subprogram(values, words, keyword, at)
            return
        if not address:
            raise values.fault("a word begins with a letter", at, text[at : at + 8])
        values.at = address.end()
        self._add(values, words, address[1].upper(), Placed(_number(address[2])), at)

    def _subprogram(self, values: Values, words: _Words, name: str, at: int) -> None:
        """Read the call of a subprogram: its name and its arguments."""
        try:
            self._flow.check_known(name)
        except BlockError as fault:
            raise values.fault(f"the word {name} is not known here, and {fault.reason}", at, name) from None
        if words.call:
            raise values.fault(f"{words.call.name} and {name} are called in one block: use two lines", at, name)
        values.at = at + len(name)
        words.call = Call(name, tuple(values.tokens()))

    def _assignable(self, name: str) -> bool:
        if name in _WORDS or name == "PO" or self._flow.is_variable(name):
            return True
        return name.startswith("$") or bool(refusal(name))

    def _assign(self, values: Values, words: _Words, name: str, index: str | None) -> None:
        at = values.at
        if reason := refusal(name):
            raise values.fault(reason, at, name)
        if name == "PO":
            letter = (index or "").strip("[] ").upper()
            if letter not in tuple("XYZABCUVW"):
                raise values.fault(
                    "a polynomial belongs to an axis: write PO[X]=(end,a2,a3); denominators are not read"
                )
            words.polynomials[letter] = values.arguments()
        elif name == "T":
            string = values.string()
            words.tool = string if string is not None else f"{values.expression():g}"
        elif name.startswith("$"):
            raise values.fault(
                "setting and machine data cannot be written by what is planned: take the line out", at, name
            )
        elif name in _WORDS:
            how = values.placing()
            value = values.expression()
            if how:
                values.closing()
            self._add(values, words, {"S1": "S", "M1": "M"}.get(name, name), Placed(value, how), at)
        elif index is not None:
            raise values.fault("arrays are not read: use one variable for each", at, name)
        else:
            self._flow.assign(name, values.expression())

    def _keyword(self, values: Values, words: _Words, keyword: str, end: int) -> bool:
        """Read a keyword with its arguments; return False if the name is none."""
        known = keyword in _MOTIONS or keyword in _FRAMES or keyword in _KEYWORDS
        if not known and keyword not in _WITH_ARGUMENTS:
            return False
        values.at = end
        if keyword in _FRAMES:
            words.frames.append(keyword)
        elif known:
            words.keywords.append(keyword)
        elif keyword == "MSG":
            self._emit("MESSAGE", values.message())
        elif keyword == "CYCLE832":
            self._high_speed(values.tokens())
        elif keyword in ("CALL", "EXTCALL"):
            bracket = values.skipped().startswith("(")
            values.at += bracket
            name = values.string()
            if name is None:
                raise values.fault(f'{keyword} needs the name of a program in quotes, such as {keyword} "POCKET"')
            if bracket:
                values.closing()
            at = values.at
            self._subprogram(values, words, program_name(name), at)
            values.at = at
        else:
            arguments = [argument for argument in values.tokens() if argument]
            if keyword == "CYCLE800" and arguments:
                raise values.fault(refusal("TOROT"), word="CYCLE800")
            if keyword == "TRAORI" and arguments not in ([], ["1"]):
                raise values.fault(
                    "TRAORI has the number 1 or none: the axes of the machine are those of [kinematics]", word="TRAORI"
                )
            if keyword != "CYCLE800":
                words.keywords.append(keyword)
        return True

    def _add(self, values: Values, words: _Words, letter: str, placed: Placed, at: int) -> None:
        if letter == "G":
            code = round(placed.value)
            if reason := refusal(f"G{placed.value:g}"):
                raise values.fault(reason, at, f"G{placed.value:g}")
            if ignored_g(code):
                self._emit("IGNORED", f"G{code}")
                return
            group = _GROUP.get(code) if code == placed.value else None
            if group is None:
                raise values.fault("there is no such code here", at, f"G{placed.value:g}")
            if group in words.codes and group != "other":
                raise values.fault(
                    f"G{words.codes[group]} and G{code} exclude each other: use two lines", at, f"G{code}"
                )
            words.codes[group] = code
        elif letter == "M":
            words.m_codes.append(round(placed.value))
        elif letter == "T":
            words.tool = f"{placed.value:g}"
        elif letter in ("H", "Q", "E", "O"):
            raise values.fault(refusal(letter), at, letter)
        elif letter in words.values:
            raise values.fault(f"the word {letter} stands twice in this block: split the line", at, letter)
        elif not abs(placed.value) <= blocks.LARGEST:
            raise values.fault(f"a word is at most {Quantity(blocks.LARGEST)}", at, letter)
        else:
            words.values[letter] = placed

    # what a block does

    def _act(self, words: _Words) -> None:
        codes, state = words.codes, self._state
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
            self._inch, self._inch_feed = codes["unit"] in (70, 700), codes["unit"] == 700
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
            self._incremental = codes["distance"] == 91
        self._path_words(words)
        if "offset" in codes:
            self._choose_system(_SYSTEMS.get(codes["offset"], 0))
        self._radius_words(words)
        moved = False
        if words.frames:
            self._set_frame(words)
        else:
            moved = self._move(words)
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
            self._flow.moved()
        if stop is not None:
            self._stop(stop)

    def _call_of(self, words: _Words) -> Call | None:
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

    def _refuse_on_contour(self, words: _Words) -> None:
        """Refuse what radius compensation excludes."""
        codes, state = words.codes, self._state
        plane = codes.get("plane", state.plane // 10) != state.plane // 10
        named = [f"G{codes[group]}" for group, on in (("plane", plane), ("offset", "offset" in codes)) if on]
        named += [f"G{codes['once']}"] if codes.get("once") in (53, 153) else []
        named += words.frames + [
            word for word in words.keywords if word in ("SUPA", "TRAORI", "TRAFOOF", "POLY", *KINDS)
        ]
        named += ["M6"] if 6 in words.m_codes else ["D"] if "D" in words.values and words.tool is None else []
        if named:
            raise BlockError(
                f"{named[0]} does not go with radius compensation: write G40 in a line before it", named[0]
            )

    def _refuse_in_spline(self, words: _Words) -> None:
        """Refuse what changes coordinates before the end of a spline is known."""
        codes = words.codes
        named = [f"G{codes[group]}" for group in ("offset", "radius") if group in codes]
        named += words.frames + [word for word in words.keywords if word in ("TRAORI", "TRAFOOF")]
        named += ["M6"] if 6 in words.m_codes else ["D"] if "D" in words.values and words.tool is None else []
        if named:
            raise BlockError(
                f"{named[0]} stands before the end of a spline is known: write the move behind the spline before it",
                named[0],
            )

    def _radius_words(self, words: _Words) -> None:
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

    def _tool_point(self, words: _Words) -> None:
        """Execute TRAORI (from here on X Y Z are the tip of the tool) and TRAFOOF (the axes of the machine)."""
        state = self._state
        if "TRAORI" in words.keywords and not state.tool_point:
            begin_tool_point(state, self._emit, "TRAORI", state.tool_offset, False)
            self._before.clear()
            self._run.forget_heading()
        elif "TRAFOOF" in words.keywords and state.tool_point:
            end_tool_point(state, self._emit)
            if any(self._length):
                set_tool_offset(state, self._emit, self._length)
            self._before.clear()
            self._run.forget_heading()

    def _dwell(self, words: _Words) -> None:
        seconds, turns = words.take("F"), words.take("S")
        if seconds is None and turns is not None and self._state.speed > 0:
            seconds = 60.0 * turns / self._state.speed
        if seconds is None or seconds < 0:
            raise BlockError("G4 needs F and the seconds, or S and turns of a turning spindle", "G4")
        self._switches.dwell(seconds, "F")

    def _tools_and_switches(self, words: _Words) -> int | None:
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
            begin_tool_point(state, self._emit, "TRAORI", self._length, False)

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

    def _path_words(self, words: _Words) -> None:
        tolerance, rounding = words.take("CTOL"), words.take("ADIS")
        for name, value in (("CTOL", tolerance), ("ADIS", rounding)):
            if value is not None and value < 0:
                raise BlockError(f"a tolerance is not negative: {name}={Quantity(value):6}", name)
        unit = INCH if self._inch else 1.0
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
        self._switches.path_mode(_MODES[code], within, within)

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
        self._contour_tolerance = 0.0 if off else tolerance * (INCH if self._inch else 1.0)
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
        shift = list(self._shift)
        shift[0], shift[1] = rotated(shift[0], shift[1], self._rotation)
        origin = [o + s for o, s in zip(self._settable, shift, strict=True)]
        # an incremental move behind a change of frames also makes the change (SD42440, whose default this is)
        for axis, value in enumerate(state.position):
            self._before.setdefault(axis, value)
        if self._rotation + self._angle != state.rotation:
            self._run.forget_heading()
        state.keep_machine(origin, self._rotation + self._angle)
        self._emit("SET_G5X_OFFSET", state.system, *origin)
        self._emit("SET_XY_ROTATION", state.rotation)

    def _set_frame(self, words: _Words) -> None:
        """Execute TRANS, ATRANS, ROT or AROT, which stand in a block of their own."""
        if len(words.frames) > 1 or words.keywords:
            raise BlockError("a frame stands in a block of its own: use two lines", words.frames[-1])
        name, unit = words.frames[0], INCH if self._inch else 1.0
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

    # motion

    def _move(self, words: _Words) -> bool:
        """Execute the motion of a block; return False if there is none."""
        codes, state = words.codes, self._state
        curve = next((word for word in words.keywords if word in _MOTIONS), "")
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

    def _contour(self, words: _Words, block: Block) -> None:
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

    def _target(self, words: _Words) -> list[float]:
        """Return the end point, mm and degrees."""
        target, unit = list(self._state.position), INCH if self._inch else 1.0
        if "AP" in words.values or "RP" in words.values:
            self._polar_target(words, target, unit)
        for axis, letter in enumerate(AXES.upper()):
            placed = words.values.pop(letter, None)
            if placed is not None:
                target[axis] = self._placed(placed, axis, target[axis], unit if axis in LINEAR else 1.0)
        if not words.values.keys().isdisjoint(VECTOR):
            self._aim(words, target)
        return target

    def _aim(self, words: _Words, target: list[float]) -> None:
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
        x, y, z = (words.take(word) or 0.0 for word in VECTOR)
        x, y = rotated(x, y, state.rotation)
        self._motion.turn_to(target, [x, y, z], "A3 B3 C3")

    def _placed(self, placed: Placed, axis: int, here: float, unit: float) -> float:
        value, how = placed.value * unit, placed.how
        before = self._before.pop(axis, here)
        if how in ("DC", "ACP", "ACN"):
            if axis in LINEAR:
                raise BlockError(f"{how}() belongs to rotary axes", AXES[axis].upper())
            way = (value - here) % 360.0
            if how == "DC":
                return here + (way if way <= 180.0 else way - 360.0)
            return here + (way if how == "ACP" or way == 0.0 else way - 360.0)
        return before + value if how == "IC" or (not how and self._incremental) else value

    def _polar_target(self, words: _Words, target: list[float], unit: float) -> None:
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

    def _set_pole(self, words: _Words, code: int) -> None:
        first, second, _ = PLANES[self._state.plane]
        base = {
            110: [self._state.position[first], self._state.position[second]],
            111: [0.0, 0.0],
            112: list(self._pole),
        }
        unit = INCH if self._inch else 1.0
        pole = base[code]
        for k, axis in enumerate((first, second)):
            pole[k] += (words.take(AXES[axis].upper()) or 0.0) * unit
        self._pole = pole

    def _arc_words(self, words: _Words, target: list[float], block: Block) -> None:
        """Give the words of an arc to a block of RS-274: I J K from the start, R, and P for TURN."""
        state, unit = self._state, INCH if self._inch else 1.0
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

    def _through(self, words: _Words, target: list[float], block: Block) -> None:
        """Execute CIP: the arc through the point I1 J1 K1, in one of the planes XY, ZX and YZ."""
        state, unit = self._state, INCH if self._inch else 1.0
        middle = list(state.position[:3])
        for axis, name in enumerate(("I1", "J1", "K1")):
            placed = words.values.pop(name, None)
            if placed is not None:
                relative = placed.how == "IC" or (not placed.how and self._incremental)
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

    def _spline(self, words: _Words, target: list[float]) -> None:
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

    def _polynomial(self, words: _Words, target: list[float]) -> None:
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
            unit = INCH if self._inch and axis in LINEAR else 1.0
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

    def _machine_move(self, words: _Words, block: Block) -> None:
        """Execute a straight move in machine coordinates (G53, G153, SUPA)."""
        if self._modal > 1 or self._curve:
            raise BlockError("G53, G153 and SUPA go with G0 and G1", "SUPA" if "SUPA" in words.keywords else "G")
        if self._state.tool_point:
            raise BlockError(
                "positions of the machine's axes do not go with TRAORI: write TRAFOOF in a line before",
                "SUPA" if "SUPA" in words.keywords else "G",
            )
        state, unit = self._state, INCH if self._inch else 1.0
        standing = state.machine(state.position)
        machine = list(standing)
        for axis, letter in enumerate(AXES.upper()):
            value = words.take(letter)
            if value is not None:
                machine[axis] = value * (unit if axis in LINEAR else 1.0)
                self._before.pop(axis, None)
        target = state.program(machine)
        for axis, letter in enumerate(AXES):
            # converting there and back would change the last digits of an axis that does not move
            if machine[axis] != standing[axis] or (state.rotation and axis < 2):
                block.words[letter] = target[axis]
        block.words.setdefault("x", state.position[0])
        self._motion.move(block, 10 * self._modal, False)


def _number(text: str) -> float:
    """Return the value of a number, whose exponent is EX."""
    return float(re.sub("EX", "e", text, flags=re.IGNORECASE))


def _center(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> tuple[float, float]:
    """Return the center of the circle through three points."""
    bx, by, cx, cy = b[0] - a[0], b[1] - a[1], c[0] - a[0], c[1] - a[1]
    twice = 2.0 * (bx * cy - by * cx)
    if abs(twice) <= 1e-12 * (bx * bx + by * by + cx * cx + cy * cy):
        raise BlockError("the three points of CIP lie on a line: write G1, or correct I1 J1 K1", "CIP")
    b2, c2 = bx * bx + by * by, cx * cx + cy * cy
    return a[0] + (cy * b2 - by * c2) / twice, a[1] + (bx * c2 - cx * b2) / twice

"""The interpreter of part programs, which converts lines to canonical commands block by block in constant memory.

`Switches` handles the codes without motion: modes, spindle, tool, coolant, overrides, outputs and stops.
`Flow` handles O-words: subroutines, loops and conditions.

The program is never held in memory: a loop returns to the position of its line in the file, and a call jumps to the
position of its subroutine.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from feeddrive.language.quantity import Quantity, number
from feeddrive.path.kinematics import Kinematics
from feeddrive.path.program import blocks
from feeddrive.path.program.aiming import BY_AXES, Turning
from feeddrive.path.program.blocks import Block, BlockError, Line, LineReader, Parameters, Place, Step, Values
from feeddrive.path.program.budget import MOST_AGAIN, MOST_AGAIN_AT_REST, MOST_COMMANDS
from feeddrive.path.program.compensation import Compensation
from feeddrive.path.program.dialects import DIALECTS, DialectName, Rewritten
from feeddrive.path.program.motion import CURVE, MOVING, PLANES, Motion, emit_path_mode
from feeddrive.path.program.moves import Command, Value
from feeddrive.path.program.state import (
    BY_CODE,
    G92,
    G92_ON,
    READ_INPUT,
    SYSTEM,
    SYSTEMS,
    Emit,
    State,
    Tool,
    choose_system,
    end_tool_point,
    first_of,
    go_home,
    set_home,
    shift_axes,
    tool_length,
    write_offsets,
)

DEEPEST_CALL = 50
"""The deepest nesting of subroutine calls."""

_STATEMENT = re.compile(
    r"(endsub|sub|call|return|if|elseif|else|endif|while|endwhile|do|repeat|endrepeat|break|continue)"
)
_LABEL = re.compile(r"(\d+)|<([^<>]+)>")
_SKIPPED = re.compile(rf"/?(?:n[\d.]+)?o(?:{_LABEL.pattern}){_STATEMENT.pattern}")
_BEGINS = frozenset("oOnN/(")
"""The characters with which a line with an o-word can begin."""
_ENDS = {"sub": "endsub", "if": "endif", "while": "endwhile", "do": "while", "repeat": "endrepeat"}


@dataclass
class Open:
    """An open loop or condition, with the positions of its body and its first line.

    left  for a repeat, the number of remaining passes; for a condition, 1 if a branch was taken
    """

    kind: str
    label: str
    body: Place
    head: Place
    left: int = 0


class Modes(NamedTuple):
    """The modes that M70 saves and M72 restores, as fields of `State`; lengths are in the unit that was chosen then."""

    inch: bool
    feed_mode: int
    feed: float
    speed: float
    spindle: int
    plane: int
    tool_offset: tuple[float, ...]
    system: int
    path_mode: str
    tolerance: float
    naive_tolerance: float
    incremental: bool
    arc_absolute: bool
    retract_to_r: bool
    mist: bool
    flood: bool
    feed_override: bool
    speed_override: bool
    adaptive_feed: bool
    feed_hold: bool

    @classmethod
    def of(cls, state: State) -> Modes:
        """Return the modes of a state."""
        modes = cls._make(getattr(state, name) for name in cls._fields)
        # the list goes on changing
        return modes._replace(tool_offset=tuple(state.tool_offset))

    def unit_line(self, state: State) -> str:
        """Return the block that restores the unit; empty if it is the same."""
        return "" if self.inch == state.inch else "G20" if self.inch else "G21"

    def lines(self, state: State) -> Iterator[str]:
        """Yield the blocks that restore what differs in a state, which has the unit already."""
        now = Modes.of(state)

        def changed(*names: str) -> bool:
            return any(getattr(self, name) != getattr(now, name) for name in names)

        words = list[str]()
        if changed("feed_mode"):
            words.append(f"G{self.feed_mode // 10}")
        if self.feed_mode != 930 and changed("feed_mode", "feed"):
            words.append(f"F{_word(self.feed)}")
        if changed("speed"):
            words.append(f"S{_word(self.speed)}")
        if changed("spindle"):
            words.append({0: "M5", 1: "M3", -1: "M4"}[self.spindle])
        if changed("plane"):
            words.append(f"G{self.plane // 10}")
        yield " ".join(words)
        if changed("tool_offset"):
            axes = zip(blocks.AXES, self.tool_offset, strict=True)
            yield (
                "G43.1 " + " ".join(f"{letter}{_word(value)}" for letter, value in axes)
                if any(self.tool_offset)
                else "G49"
            )
        if changed("system"):
            yield f"G{_SYSTEM_CODES[self.system]}"
        if changed("path_mode", "tolerance", "naive_tolerance"):
            tolerances = f" P{_word(self.tolerance)} Q{_word(self.naive_tolerance)}"
            code = {name: code for code, name in _PATH_MODES.items()}[self.path_mode]
            yield blocks.name_of("g", code) + (tolerances if code == 640 else "")
        words = ["G91" if self.incremental else "G90"] if changed("incremental") else []
        words += ["G90.1" if self.arc_absolute else "G91.1"] if changed("arc_absolute") else []
        words += ["G99" if self.retract_to_r else "G98"] if changed("retract_to_r") else []
        yield " ".join(words)
        if now.mist > self.mist or now.flood > self.flood:
            # M9 ends both
            yield "M9"
            now = now._replace(mist=False, flood=False)
        yield from (code for code, name in (("M7", "mist"), ("M8", "flood")) if changed(name))
        switched = (("M50", "feed_override"), ("M51", "speed_override"), ("M52", "adaptive_feed"), ("M53", "feed_hold"))
        yield from (f"{code} P{int(getattr(self, name))}" for code, name in switched if changed(name))


def _word(value: float) -> str:
    # no exponent: RS-274 has none
    return f"{value:.17f}"


@dataclass
class Frame:
    """The call frame of a subroutine or of the program: return position, arguments, local parameters, and open
    loops.

    saved     modes that M70 or M73 have saved at this level
    restores  True if they are restored when the subroutine returns (M73)
    """

    label: str
    reader: LineReader
    back: Place
    arguments: dict[int, float] = field(default_factory=dict[int, float])
    local: dict[str, float] = field(default_factory=dict[str, float])
    opened: list[Open] = field(default_factory=list[Open])
    saved: Modes | None = None
    restores: bool = False


def statement_of(text: str) -> tuple[str, str] | None:
    """Return the label and the kind of the o-word in a skipped line, or None for a line without an o-word."""
    try:
        statement = _SKIPPED.match(blocks.compact(text)[0])
    except BlockError:
        return None
    if not statement:
        return None
    return (statement[1].lstrip("0") or "0" if statement[1] else statement[2]), statement[3]


class Flow:
    """The control flow of a program, which returns its lines in order of execution."""

    def __init__(self, program: Path, parameters: Parameters, most_again: int = MOST_AGAIN) -> None:
        self._folder = program.parent
        self._parameters = parameters
        self._most_again = most_again
        self._again = self._at_rest = 0
        self._readers: dict[Path, LineReader] = {}
        self._defined: dict[str, tuple[LineReader, Place]] = {}
        reader = self._reader(program)
        self._frames = [Frame("", reader, reader.place)]
        parameters.live["_call_level"] = lambda: float(len(self._frames) - 1)
        parameters.live["_value"] = lambda: self._value
        parameters.live["_value_returned"] = lambda: self._returned
        self._value = self._returned = 0.0
        self.returned: Modes | None = None  # modes that the subroutine which has just returned restores (M73)

    @property
    def frame(self) -> Frame:
        """The innermost call frame."""
        return self._frames[-1]

    @property
    def reader(self) -> LineReader:
        """The reader of the file whose lines are being executed."""
        return self._frames[-1].reader

    def close(self) -> None:
        """Close all files."""
        for reader in self._readers.values():
            reader.close()

    @property
    def calls(self) -> int:
        """The number of subroutines that are running."""
        return len(self._frames) - 1

    @property
    def loop(self) -> str:
        """The innermost loop that is running in the program itself, with its line; empty if none is."""
        loops = [opened for opened in self._frames[0].opened if opened.kind != "if"]
        return f"o{loops[-1].label} {loops[-1].kind} of line {loops[-1].head.number + 1}" if loops else ""

    def moved(self) -> None:
        """Record a motion or an offset: restart the count of repeated lines that `MOST_AGAIN_AT_REST` limits."""
        self._at_rest = 0

    def next_line(self) -> Line | None:
        """Return the next line, or None at the end of the program."""
        reader = self._frames[-1].reader
        line = reader.read()
        if line is None:
            return None
        if line.number > reader.furthest:
            reader.furthest = line.number
        else:
            self._again += 1
            self._at_rest += 1
            if self._again > self._most_again or self._at_rest > MOST_AGAIN_AT_REST:
                reason = (
                    f"{self._again} lines were read again by loops and calls (at most {self._most_again}, and "
                    f"{MOST_AGAIN_AT_REST} without a motion): does a loop never end?"
                )
                raise blocks.located(line, BlockError(reason))
        return line

    def check_end(self) -> None:
        """Refuse a program that ends inside a subroutine, a loop or a condition."""
        frame = self._frames[-1]
        if frame.opened:
            last = frame.opened[-1]
            raise BlockError(
                f"the program ends inside o{last.label} {last.kind}: write o{last.label} {_ENDS[last.kind]}"
            )
        if len(self._frames) > 1:
            raise BlockError(f"the program ends inside the subroutine o{frame.label}: write o{frame.label} endsub")

    def act(self, statement: str) -> None:
        """Execute the o-word of the last line read."""
        values = Values(statement, self._parameters, 1)
        label = self._label(values)
        match = _STATEMENT.match(statement, values.at)
        if not match:
            raise values.fault(
                "an o-word has its number or <name> and then sub, call, return, if, while, do, repeat, break ..."
            )
        values.at = match.end()
        kind = match[1]
        # after a branch that was taken the condition is not evaluated: its parameters may have no value
        if kind == "elseif" and self._top(label, "if").left:
            self._leave(label)
            return
        if kind in ("if", "elseif", "while", "repeat"):
            arguments = [self._bracket(values)]
        elif kind in ("call", "return", "endsub"):
            arguments = self._brackets(values)
        else:
            arguments = list[float]()
        if values.at < len(statement):
            raise values.fault(f"nothing else stands behind o{label} {kind}")
        getattr(self, f"_{kind}")(label, arguments)

    def _label(self, values: Values) -> str:
        plain = _LABEL.match(values.text, values.at)
        if plain:
            values.at = plain.end()
            return plain[1].lstrip("0") or "0" if plain[1] else plain[2]
        value = values.value()
        if value < 0 or abs(value - round(value)) > 1e-4:
            raise values.fault(f"the number of an o-word is whole and not negative, not {Quantity(value):6}", 1)
        return str(round(value))

    def _bracket(self, values: Values) -> float:
        if not values.text.startswith("[", values.at):
            raise values.fault("a condition or number in brackets [...] is expected here")
        return values.value()

    def _brackets(self, values: Values) -> list[float]:
        numbers: list[float] = []
        while values.text.startswith("[", values.at):
            numbers.append(values.value())
        return numbers

    def _reader(self, path: Path) -> LineReader:
        if path not in self._readers:
            self._readers[path] = LineReader(path)
        return self._readers[path]

    def _skip(self, label: str, kinds: Sequence[str]) -> str:
        """Skip past the next line whose o-word has the given label and one of the given kinds; return its kind."""
        while True:
            line = self.next_line()
            if line is None:
                raise BlockError(f"o{label} has no {' or '.join(kinds)} behind it: write it")
            # a cheap test, since what is skipped may be long
            if line.text.lstrip()[:1] not in _BEGINS:
                continue
            statement = statement_of(line.text)
            if statement and statement[0] == label and statement[1] in kinds:
                return statement[1]

    # subroutines

    def _sub(self, label: str, arguments: list[float]) -> None:
        frame = self._frames[-1]
        if len(self._frames) > 1:
            raise BlockError(
                f"the subroutine o{label} begins inside of the subroutine o{frame.label}: write its endsub before"
            )
        # a loop may pass the same definition again
        defined = self._defined.get(label)
        if defined and defined != (frame.reader, frame.reader.place):
            raise BlockError(f"the subroutine o{label} is there twice: rename one")
        self._defined[label] = frame.reader, frame.reader.place
        self._skip(label, ("endsub",))

    def _call(self, label: str, arguments: list[float]) -> None:
        if len(self._frames) > DEEPEST_CALL:
            raise BlockError(
                f"the call of o{label} is more than {DEEPEST_CALL} deep: does it call itself without end?", "o", 0
            )
        if len(arguments) > len(blocks.ARGUMENTS):
            raise BlockError(
                f"a call has at most {len(blocks.ARGUMENTS)} arguments, this one has {len(arguments)}", "o", 0
            )
        if label not in self._defined:
            self._load(label)
        reader, place = self._defined[label]
        caller = self._frames[-1].reader
        numbered = self._parameters.numbered
        # #1 to #30 are local to a call in LinuxCNC
        kept = {parameter: numbered.pop(parameter) for parameter in blocks.ARGUMENTS if parameter in numbered}
        self._frames.append(Frame(label, reader, caller.place, kept, self._parameters.local))
        self._parameters.local = {}
        for parameter, value in zip(blocks.ARGUMENTS, arguments, strict=False):
            numbered[parameter] = value
        reader.go(place)
        self._again += 1

    def _load(self, label: str) -> None:
        """Load a subroutine from the file of the same name in the program's folder."""
        path = self._folder / f"{label}.ngc"
        # a label must not lead to a file outside the program's folder
        if "/" in label or "\\" in label or not path.is_file():
            raise BlockError(
                f"there is no subroutine o{label} before this line, and no file {label}.ngc beside the program", "o", 0
            )
        reader = self._reader(path)
        start = reader.place
        reader.go(Place(0, 0))
        while True:
            line = reader.read()
            if line is None:
                raise BlockError(f"the file {path} has no line o<{label}> sub: write it at its beginning", "o", 0)
            if statement_of(line.text) == (label, "sub"):
                self._defined[label] = reader, reader.place
                # the call may come from this very file
                reader.go(start)
                return

    def _return(self, label: str, arguments: list[float]) -> None:
        # as in LinuxCNC its number may be any: that of the condition around it, say
        self._endsub(label, arguments, True)

    def _endsub(self, label: str, arguments: list[float], anywhere: bool = False) -> None:
        frame = self._frames[-1]
        if (frame.label != label and not anywhere) or len(self._frames) == 1:
            running = f"o{frame.label} runs" if len(self._frames) > 1 else "none runs"
            raise BlockError(f"this ends the subroutine o{label}, but {running}: o{label} sub stands where?", "o", 0)
        self._value, self._returned = (arguments[0], 1.0) if arguments else (0.0, 0.0)
        self._frames.pop()
        self.returned = frame.saved if frame.restores else None
        numbered = self._parameters.numbered
        for parameter in blocks.ARGUMENTS:
            numbered.pop(parameter, None)
        numbered.update(frame.arguments)
        self._parameters.local = frame.local
        self._frames[-1].reader.go(frame.back)

    # conditions

    def _if(self, label: str, arguments: list[float]) -> None:
        self._open("if", label)
        self._branch(label, arguments[0])

    def _elseif(self, label: str, arguments: list[float]) -> None:
        self._branch(label, arguments[0])

    def _else(self, label: str, arguments: list[float]) -> None:
        self._leave(label)

    def _branch(self, label: str, condition: float) -> None:
        """Enter a branch if its condition is true; otherwise skip to the next elseif, else or endif."""
        here = self._top(label, "if")
        here.left = bool(condition)
        if not condition:
            kind = self._skip(label, ("elseif", "else", "endif"))
            if kind == "elseif":
                self._frames[-1].reader.go(self._frames[-1].reader.last)
            elif kind == "endif":
                self._frames[-1].opened.pop()

    def _leave(self, label: str) -> None:
        """Skip to the end of a conditional block after one of its branches was taken."""
        self._top(label, "if")
        self._skip(label, ("endif",))
        self._frames[-1].opened.pop()

    def _endif(self, label: str, arguments: list[float]) -> None:
        self._top(label, "if")
        self._frames[-1].opened.pop()

    # loops

    def _while(self, label: str, arguments: list[float]) -> None:
        opened = self._frames[-1].opened
        if opened and opened[-1].kind == "do" and opened[-1].label == label:
            if arguments[0]:
                self._frames[-1].reader.go(opened[-1].body)
            else:
                opened.pop()
        elif arguments[0]:
            self._open("while", label)
        else:
            self._skip(label, ("endwhile",))

    def _endwhile(self, label: str, arguments: list[float]) -> None:
        loop = self._top(label, "while")
        self._frames[-1].opened.pop()
        self._frames[-1].reader.go(loop.head)

    def _do(self, label: str, arguments: list[float]) -> None:
        self._open("do", label)

    def _repeat(self, label: str, arguments: list[float]) -> None:
        # more than MOST_AGAIN lines are refused anyway
        times = round(arguments[0]) if abs(arguments[0]) < 1e9 else int(1e9)
        if times < 1:
            self._skip(label, ("endrepeat",))
        else:
            self._open("repeat", label)
            self._frames[-1].opened[-1].left = times

    def _endrepeat(self, label: str, arguments: list[float]) -> None:
        loop = self._top(label, "repeat")
        loop.left -= 1
        if loop.left > 0:
            self._frames[-1].reader.go(loop.body)
        else:
            self._frames[-1].opened.pop()

    def _break(self, label: str, arguments: list[float]) -> None:
        loop = self._loop(label, "break")
        self._frames[-1].opened.pop()
        self._skip(label, (_ENDS[loop.kind],))

    def _continue(self, label: str, arguments: list[float]) -> None:
        loop = self._loop(label, "continue")
        if loop.kind == "while":
            self._endwhile(label, arguments)
        elif loop.kind == "repeat" and loop.left > 1:
            self._endrepeat(label, arguments)
        elif loop.kind == "repeat":
            self._break(label, arguments)
        else:
            # rs274 returns to the start of a `do` loop without testing its condition, so that it may never end
            self._skip(label, ("while",))
            # back to this line, whose condition has yet to be read
            self._frames[-1].reader.go(self._frames[-1].reader.last)

    def _loop(self, label: str, kind: str) -> Open:
        """Return the innermost loop with the label, and close everything opened inside it."""
        opened = self._frames[-1].opened
        while opened and (opened[-1].label != label or opened[-1].kind == "if"):
            opened.pop()
        if not opened:
            raise BlockError(f"o{label} {kind} stands in no loop o{label}: write it between the loop's lines", "o", 0)
        return opened[-1]

    def _open(self, kind: str, label: str) -> None:
        frame = self._frames[-1]
        if len(frame.opened) > 200:
            raise BlockError("loops and conditions lie more than 200 deep: is one never ended?", "o", 0)
        frame.opened.append(Open(kind, label, frame.reader.place, frame.reader.last))

    def _top(self, label: str, kind: str) -> Open:
        opened = self._frames[-1].opened
        if not opened or (opened[-1].kind, opened[-1].label) != (kind, label):
            inside = f"o{opened[-1].label} {opened[-1].kind} is open" if opened else "none is open"
            raise BlockError(f"this belongs to o{label} {kind}, but {inside}: check the numbers of the o-words", "o", 0)
        return opened[-1]


_FEED_MODES = {930: "inverse time", 940: "units per minute", 950: "units per revolution"}
_PLANES = {170: "CANON_PLANE_XY", 180: "CANON_PLANE_XZ", 190: "CANON_PLANE_YZ"}
_PATH_MODES = {610: "CANON_EXACT_PATH", 611: "CANON_EXACT_STOP", 640: "CANON_CONTINUOUS"}
_OUTPUTS = {
    620: "SET_MOTION_OUTPUT_BIT",
    630: "CLEAR_MOTION_OUTPUT_BIT",
    640: "SET_AUX_OUTPUT_BIT",
    650: "CLEAR_AUX_OUTPUT_BIT",
}
_SWITCHED = {500: "FEED_OVERRIDE", 510: "SPEED_OVERRIDE", 520: "ADAPTIVE_FEED", 530: "FEED_HOLD"}


class Switches:
    """The executor of the codes that move no axis; `ended` is True once the program has ended."""

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
        self.ended = False
        self.chosen = 0  # spindle of the block ($)
        self._acts: dict[Step, Callable[[int, Block], None]] = {
            Step.OUTPUT: self._output,
            Step.TOOL_CHANGE: self._change_tool,
            Step.SPINDLE: self._spindle,
            Step.SPINDLE_SPEED: self._rpm,
            Step.COOLANT: self._coolant,
            Step.OVERRIDE: self._override,
            Step.DWELL: self._dwell,
            Step.PLANE: self._plane,
            Step.UNITS: self._units,
            Step.CUTTER: self._cutter,
            Step.TOOL_LENGTH: self._tool_length,
            Step.SYSTEM: self._system,
            Step.PATH_MODE: self._path_mode,
            Step.DISTANCE: self._distance,
            Step.ARC_DISTANCE: self._arc_distance,
            Step.RETRACT: self._retract,
        }

    def act(self, step: Step, code: int, block: Block) -> None:
        """Execute a code."""
        self._acts[step](code, block)

    def feed_mode(self, code: int) -> None:
        """Execute G93, G94 or G95; the feed must then be programmed again."""
        self._state.feed_mode = code
        self._state.feed = 0.0
        self._emit("COMMENT", f"interpreter: feed mode set to {_FEED_MODES[code]}")
        self._emit("SET_FEED_MODE", 0, int(code == 950))
        if code != 930:
            self._emit("SET_FEED_RATE", 0.0)

    def speed(self, speed: float) -> None:
        """Execute S: set the spindle speed in rpm."""
        if speed < 0:
            raise BlockError(f"a spindle speed is not negative: S{number(speed, 6)}; M4 turns counterclockwise", "S")
        if self.chosen <= 0:
            self._state.speed = speed
        self._emit("SET_SPINDLE_SPEED", self.chosen, speed)

    def select(self, tool: int) -> None:
        """Execute T: select the tool for the next change."""
        if self._tools is not None and tool and tool not in self._tools:
            raise BlockError(f"tool {tool} is not in the tool table: add it there", "T")
        self._state.selected = tool
        self._emit("SELECT_TOOL", tool)

    def stop(self, code: int) -> None:
        """Execute M0, M1 or M60 (stop), or M2 or M30 (end)."""
        if code in (20, 300):
            self._end(code == 300)
        elif code == 600:
            self._emit("PALLET_SHUTTLE")
            self._emit("PROGRAM_STOP")
        else:
            self._emit("OPTIONAL_PROGRAM_STOP" if code else "PROGRAM_STOP")

    def _end(self, pallet: bool) -> None:
        state, emit = self._state, self._emit
        end_tool_point(state, emit)
        numbered = state.parameters.numbered
        first = first_of(1)
        state.system = 1
        numbered[SYSTEM] = 1.0
        state.keep_machine(state.stored(first), numbered.get(first + 9, 0.0))
        emit("SET_G5X_OFFSET", 1, *state.origin)
        emit("SET_XY_ROTATION", state.rotation)
        if state.plane != 170:
            emit("SELECT_PLANE", "CANON_PLANE_XY")
        emit("SET_FEED_MODE", 0, 0)
        emit("SET_FEED_RATE", 0.0)
        if not state.feed_override:
            emit("ENABLE_FEED_OVERRIDE")
        emit("STOP_SPINDLE_TURNING", 0)
        emit("SET_SPINDLE_MODE", 0, 0.0)
        if state.mist:
            emit("MIST_OFF")
        if state.flood:
            emit("FLOOD_OFF")
        if pallet:
            emit("PALLET_SHUTTLE")
        # twice, as rs274 prints it: both front ends give the same commands
        for name in ("PROGRAM_END", "ON_RESET", "ON_RESET"):
            emit(name)
        self.ended = True

    def _output(self, code: int, block: Block) -> None:
        name = blocks.name_of("m", code)
        if code == 660:
            self._wait(block, name)
            return
        if code in _OUTPUTS:
            self._emit(_OUTPUTS[code], block.whole("p", name, 0, 63))
            return
        number, value = block.whole("e", name, 0, 63), block.take("q", name)
        assert value is not None
        self._emit("SET_MOTION_OUTPUT_VALUE" if code == 670 else "SET_AUX_OUTPUT_VALUE", number, value)

    def _wait(self, block: Block, name: str) -> None:
        """Execute M66: wait for a digital input P or read an analog input E; L the way, Q the longest time."""
        digital, analog = block.take("p"), block.take("e")
        if (digital is None) == (analog is None):
            raise BlockError("M66 has either P or E, the number of an input: write one of them", name)
        block.whole("l", name, 0, 4, 0)
        block.take("q")

        def unknown() -> float:
            raise BlockError(
                "what an input reads (#5399, after M66) is not known before: take it out of the program", "#"
            )

        self._state.parameters.live[READ_INPUT] = unknown
        self._emit("WAIT")

    def _change_tool(self, code: int, block: Block) -> None:
        state, emit = self._state, self._emit
        if state.tool_point:
            name = blocks.name_of("m", code)
            raise BlockError(
                f"{name} changes the tool while its tip is moved (G43.4, G43.5): write G49 in a line before", name
            )
        if code == 610:
            state.tool = block.whole("q", "M61", 0, 99999)
            emit("CHANGE_TOOL_NUMBER", state.tool)
            return
        if state.leaving:
            # a changer stands for the machine's own position, as in LinuxCNC
            state.position, state.leaving = state.leaving, None
        emit("START_CHANGE")
        emit("STOP_SPINDLE_TURNING", 0)
        state.spindle = 0
        state.tool = state.selected
        emit("CHANGE_TOOL", state.tool)

    def _spindle(self, code: int, block: Block) -> None:
        if code == 190:
            angle, way = block.take("r") or 0.0, block.whole("p", "M19", 0, 2, 0)
            if not 0.0 <= angle <= 360.0:
                raise BlockError(f"R of M19 is an angle from 0 to 360 degrees, not {number(angle, 6)}", "R")
            # the time that it takes is not known: a stop, for which the machine waits
            block.take("q")
            self._emit("ORIENT_SPINDLE", self.chosen, angle, way)
            return
        # -1 stands for all spindles
        if self.chosen <= 0:
            self._state.spindle = {30: 1, 40: -1, 50: 0}[code]
        names = {30: "START_SPINDLE_CLOCKWISE", 40: "START_SPINDLE_COUNTERCLOCKWISE", 50: "STOP_SPINDLE_TURNING"}
        self._emit(names[code], self.chosen)

    def _rpm(self, code: int, block: Block) -> None:
        self._emit("SET_SPINDLE_MODE", 0, 0.0)

    def _cutter(self, code: int, block: Block) -> None:
        if code == 400:
            self.leave_contour()
            self._emit("COMMENT", "interpreter: cutter radius compensation off")
            return
        state, name = self._state, blocks.name_of("g", code)
        if state.tool_point:
            raise BlockError(
                f"{name} has no meaning while the tip of a tilted tool is moved (G43.4, G43.5): write G49 before, or "
                "program the center of the tool",
                name,
            )
        if state.plane == 190:
            raise BlockError(f"{name} acts in the planes XY and ZX: write G17 or G18 before", name)
        diameter = self._diameter(block, code, name)
        left = (code in (410, 411)) == (diameter >= 0)
        self._emit("COMMENT", f"interpreter: cutter radius compensation on {'left' if left else 'right'}")
        # of a tool without a radius the center goes along the contour
        if diameter:
            state.compensation = Compensation(
                0.5 * abs(diameter), left, PLANES[state.plane], state.position, self._line, self._write
            )

    def _diameter(self, block: Block, code: int, name: str) -> float:
        """Return the diameter of the tool for G41 or G42 in the program's unit: D of the block, or of the table."""
        state = self._state
        if code in (411, 421):
            orientation = block.whole("l", name, 0, 9, 0)
            diameter = block.take("d", name)
            assert diameter is not None
        else:
            number = block.whole("d", name, 0, 99999, 0) or state.tool
            tool = self._tools.get(number) if self._tools is not None else None
            if tool is None:
                reason = (
                    f"tool {number} is not in the tool table, which gives its diameter: give the table with this tool"
                    if number
                    else "no tool is in the spindle: load one with T and M6, or name it with D"
                )
                raise BlockError(f"{reason}; {name}.1 D has the diameter in the program", name)
            orientation = tool.orientation
            diameter = tool.diameter * state.scale
        if orientation not in (0, 9):
            raise BlockError(
                f"the tool has the orientation {orientation} of a lathe, for which there is no compensation here: give "
                "a round tool, or take the front end rs274",
                name,
            )
        return diameter

    def leave_contour(self) -> None:
        """End the radius compensation, if it is on: the next move leads from beside the contour to its target."""
        state = self._state
        if state.compensation:
            state.compensation.finish()
            state.leaving = state.here()
            state.compensation = None

    def _system(self, code: int, block: Block) -> None:
        choose_system(self._state, self._emit, BY_CODE[code])

    def _coolant(self, code: int, block: Block) -> None:
        state = self._state
        if code == 90:
            state.mist = state.flood = False
            self._emit("MIST_OFF")
            self._emit("FLOOD_OFF")
        elif code == 70:
            state.mist = True
            self._emit("MIST_ON")
        else:
            state.flood = True
            self._emit("FLOOD_ON")

    def _override(self, code: int, block: Block) -> None:
        state = self._state
        if code in (480, 490):
            state.feed_override = state.speed_override = on = code == 480
            self._switch("FEED_OVERRIDE", on)
            self._switch("SPEED_OVERRIDE", on)
            return
        on = bool(block.whole("p", blocks.name_of("m", code), 0, 1, 1))
        if code == 500:
            state.feed_override = on
        elif code == 510:
            state.speed_override = on
        elif code == 520:
            state.adaptive_feed = on
        else:
            state.feed_hold = on
        self._switch(_SWITCHED[code], on)

    def _switch(self, what: str, on: bool) -> None:
        spindle = (0,) if what == "SPEED_OVERRIDE" else ()
        self._emit(f"{'ENABLE' if on else 'DISABLE'}_{what}", *spindle)

    def _dwell(self, code: int, block: Block) -> None:
        seconds = block.take("p", "G4")
        assert seconds is not None
        if seconds < 0:
            raise BlockError(f"a dwell is a time and not negative: P{number(seconds, 6)}", "P")
        self._emit("DWELL", seconds)

    def _plane(self, code: int, block: Block) -> None:
        self._state.plane = code
        self._emit("SELECT_PLANE", _PLANES[code])

    def _units(self, code: int, block: Block) -> None:
        self._state.use_inch(code == 200)
        self._emit("USE_LENGTH_UNITS", "CANON_UNITS_INCHES" if code == 200 else "CANON_UNITS_MM")

    def _tool_length(self, code: int, block: Block) -> None:
        tools = self._tools if self._tools is not None else {}
        tool_length(self._state, block, self._emit, tools, code)

    def _path_mode(self, code: int, block: Block) -> None:
        state = self._state
        state.path_mode = _PATH_MODES[code]
        if code == 640:
            tolerance, naive = block.take("p"), block.take("q")
            for letter, value in (("P", tolerance), ("Q", naive)):
                if value is not None and value < 0:
                    raise BlockError(f"a tolerance is not negative: {letter}{number(value, 6)}", letter)
            state.tolerance = tolerance or 0.0
            state.naive_tolerance = state.tolerance if naive is None else naive
        emit_path_mode(state, self._emit)
        if code == 640:
            self._emit("SET_NAIVECAM_TOLERANCE", state.naive_tolerance)

    def _distance(self, code: int, block: Block) -> None:
        incremental = self._state.extruder_incremental = code == 910
        if incremental != self._state.incremental:
            self._state.incremental = incremental
            self._emit(
                "COMMENT", f"interpreter: distance mode changed to {'incremental' if incremental else 'absolute'}"
            )

    def _arc_distance(self, code: int, block: Block) -> None:
        absolute = code == 901
        if absolute != self._state.arc_absolute:
            self._state.arc_absolute = absolute
            self._emit(
                "COMMENT", f"interpreter: IJK distance mode changed to {'absolute' if absolute else 'incremental'}"
            )

    def _retract(self, code: int, block: Block) -> None:
        self._state.retract_to_r = code == 990
        self._emit("COMMENT", f"interpreter: retract mode set to {'r_plane' if code == 990 else 'old_z'}")


_EXCLUDED = {
    *(Step.PLANE, Step.UNITS, Step.CUTTER, Step.TOOL_LENGTH, Step.SYSTEM, Step.PATH_MODE, Step.OFFSET, Step.MOTION),
    *(Step.TOOL_CHANGE, Step.OUTPUT),
}
_HARMLESS = {*(("g", code) for code in (0, 10, 20, 30, 800)), *(("m", code) for code in (610, 640, 650, 680))}
"""Codes that radius compensation excludes: those of some steps, without some of them."""
_FEED_MODE, _OFFSET, _MOTION, _STOP = Step.FEED_MODE, Step.OFFSET, Step.MOTION, Step.STOP
_OVERRIDE, _MODAL_STATE = Step.OVERRIDE, frozenset({700, 710, 720, 730})
_SYSTEM_CODES = {1: "54", 2: "55", 3: "56", 4: "57", 5: "58", 6: "59", 7: "59.1", 8: "59.2", 9: "59.3"}
_ARC_WORDS = frozenset("ijkr")


class Interpreter:
    """The interpreter of a part program.

    tools        the tool table, by number
    numbered     numbered parameters at the start, such as those of a `.var` file
    tables_inch  tool table and parameters are in inches instead of mm
    skip_deleted True to skip lines that begin with /
    most_again   largest number of lines that loops and calls may repeat
    dialect      language of the program, a name in `DIALECTS`
    parameters   values of named parameters
    kinematics   kinematics of the machine, for G43.4 and G43.5
    turning      how the tool then turns, where the program does not say
    """

    def __init__(
        self,
        program: Path,
        tools: dict[int, Tool] | None = None,
        numbered: dict[int, float] | None = None,
        tables_inch: bool = False,
        skip_deleted: bool = False,
        most_again: int = MOST_AGAIN,
        dialect: DialectName = "linuxcnc",
        *,
        parameters: Mapping[str, float] | None = None,
        kinematics: Kinematics | None = None,
        start: Sequence[float] = (0.0,) * 9,
        from_line: int = 0,
        turning: Turning = BY_AXES,
    ) -> None:
        self._start, self._from_line = start, from_line
        self._dialect, self._rewrite = dialect, DIALECTS[dialect]
        self._parameters = Parameters(numbered)
        self._state = State(self._parameters, tables_inch, kinematics)
        self._state.turning = turning
        self._tools = None if tools is None else dict(tools)
        self._skip_deleted = skip_deleted
        self._out: list[Command] = []
        self._line = Line(str(program), 0, "")
        self._main = self._line.file
        self._flow = Flow(program, self._parameters, most_again)
        self._switches = Switches(self._state, self._emit, self._tools, lambda: self._line, self._write)
        self._motion = Motion(self._state, self._emit, self._flow.moved)
        self._state.publish()
        self._parameters.live["_line"] = lambda: float(self._line.number)
        for name, value in (parameters or {}).items():
            # as names are compared: without case and white space
            self._parameters.set("".join(name.split()).lower().strip("#<>"), value)

    def commands(self) -> Generator[Command]:
        """Yield the canonical commands in program order."""
        begun = False
        try:
            self._begin()
            while True:
                if self._out:
                    yield from self._taken()
                line = self._flow.next_line()
                if line is None:
                    self._finish()
                    break
                self._line = line
                if self._from_line and line.number >= self._from_line:
                    self._resume(line)
                if self._rewrite:
                    line = self._translated(line, self._rewrite)
                # one % begins a program, a second one ends it
                if "%" in line.text and line.text.strip() == "%":
                    if begun:
                        self._finish()
                        break
                    begun = True
                    continue
                try:
                    self._execute(blocks.read_block(line, self._parameters, self._skip_deleted))
                except BlockError as fault:
                    raise blocks.located(line, fault) from None
                except ArithmeticError:
                    raise blocks.located(
                        line, BlockError("the numbers of this block are too large: check units and parameters")
                    ) from None
                if self._switches.ended:
                    break
                begun = True
            if self._from_line:
                reason = f"the program ends here, before line {self._from_line} (--from-line): name a line that it runs"
                raise blocks.located(self._line, BlockError(reason))
            yield from self._taken()
        finally:
            self._flow.close()

    def _resume(self, line: Line) -> None:
        """Emit RESUME with the modal state in front of the line from which the program is resumed.

        Raises ProgramError if the state there depends on more than the line.
        """
        wanted, state = self._from_line, self._state
        if line.file != self._main or (line.number != wanted and self._flow.calls):
            return
        if line.number > wanted:
            reason = (
                f"line {wanted} (--from-line) is not run on the way to this line: it lies in a subroutine, or in a "
                "branch or loop that is left out; name a line of the program itself that is run, such as the call"
            )
        elif self._flow.calls:
            reason = f"line {wanted} (--from-line) lies in a subroutine: name the line of its call"
        elif self._flow.loop:
            reason = (
                f"line {wanted} (--from-line) lies in the loop {self._flow.loop}, and which pass is meant is not "
                "known: name the line of the loop, or one behind its end"
            )
        elif state.compensation or state.leaving:
            reason = (
                f"at line {wanted} (--from-line) radius compensation is on, or its last move not yet done, so the "
                "position depends on the moves around it: name a line before G41 or G42, or behind the move after G40"
            )
        elif state.tool_point:
            reason = (
                f"at line {wanted} (--from-line) the tip of the tool is moved (G43.4, G43.5): name a line before that "
                "word, or behind G49"
            )
        elif state.nurbs:
            reason = f"line {wanted} (--from-line) lies between the control points of a curve: name its first line"
        else:
            self._from_line = 0
            self._emit("RESUME", state.words())
            return
        raise blocks.located(line, BlockError(reason))

    def _translated(self, line: Line, rewrite: Callable[[str], Rewritten]) -> Line:
        """Return a line of a dialect as RS-274/NGC, and execute what RS-274 has no words for."""
        try:
            meaning = rewrite(line.text)
        except BlockError as fault:
            raise blocks.located(line, fault) from None
        if meaning.ignored:
            self._emit("IGNORED", meaning.ignored)
        if meaning.extruder is not None:
            self._state.extruder_incremental = meaning.extruder
        if meaning.home:
            self._home(meaning.home)
        return line._replace(text=meaning.text)

    def _home(self, letters: str) -> None:
        """Go to the machine's zero with some axes, whose offset of G92 a printer forgets."""
        state = self._state
        axes = [blocks.AXES.index(letter.lower()) for letter in letters]
        self._flow.moved()
        if self._dialect == "marlin" and any(state.axis_offset[axis] for axis in axes):
            state.keep_machine(axis_offset=[0.0 if k in axes else x for k, x in enumerate(state.axis_offset)])
            self._emit("SET_G92_OFFSET", *state.axis_offset)
        machine = state.machine(state.position)
        for axis in axes:
            machine[axis] = 0.0
        state.position = state.program(machine)
        self._emit("STRAIGHT_TRAVERSE", *state.position)

    def _taken(self) -> list[Command]:
        out = self._out
        self._out = []
        return out

    def _emit(self, name: str, *values: Value) -> None:
        command = Command(name, values, self._line)
        if self._state.compensation:
            self._state.compensation.take(command)
        elif self._state.aiming.busy:
            self._out += self._state.take(command)
        else:
            if len(self._out) >= MOST_COMMANDS:
                raise BlockError(
                    f"this block makes more than {MOST_COMMANDS} moves and events: make fewer pecks, repeats or points"
                )
            self._out.append(command)

    def _write(self, command: Command) -> None:
        self._out.append(command)

    def _begin(self) -> None:
        state, numbered = self._state, self._parameters.numbered
        chosen = round(numbered.get(SYSTEM, 1.0))
        numbered.setdefault(SYSTEM, 1.0)
        state.system = chosen if 1 <= chosen <= SYSTEMS else 1
        state.origin = state.stored(first_of(state.system))
        state.rotation = numbered.get(first_of(state.system) + 9, 0.0)
        state.axis_offset = state.stored(G92) if numbered.get(G92_ON) else [0.0] * 9
        # the interpreter does not know where the machine stands: the caller does, or assumes its zero
        state.position = state.program(self._start)
        self._emit("USE_LENGTH_UNITS", "CANON_UNITS_MM")
        self._emit("SET_G5X_OFFSET", state.system, *state.origin)
        self._emit("SET_G92_OFFSET", *state.axis_offset)
        self._emit("SET_XY_ROTATION", state.rotation)
        self._emit("SET_FEED_REFERENCE", "CANON_XYZ")
        self._emit("ON_RESET")

    def _finish(self) -> None:
        try:
            self._flow.check_end()
            if self._state.nurbs:
                raise self._unfinished()
        except BlockError as fault:
            raise blocks.located(self._line, fault) from None
        self._switches.leave_contour()
        self._emit("FINISH")
        self._emit("ON_RESET")
        self._emit("ON_RESET")

    def _execute(self, block: Block) -> None:
        """Execute the codes of a block in order."""
        if block.assigned:
            for key, value in block.assigned:
                self._parameters.set(key, value)
        if block.comments and not block.control:
            # of several comments in a line only the last one acts, as in LinuxCNC
            self._comment(block.comments[-1])
        if block.control:
            self._flow.act(block.control)
            if self._flow.returned:
                saved, self._flow.returned = self._flow.returned, None
                self._restore(saved, "M73")
            return
        words, codes = block.words, block.codes
        self._switches.chosen = self._spindle_of(block) if "$" in words else 0
        motion = -1
        special = stop = -1
        if codes and self._state.compensation:
            self._refuse_on_contour(codes, words)
        if codes and self._state.nurbs and any(step is not _MOTION or code not in CURVE for step, _, code in codes):
            raise self._unfinished()
        if codes:
            at = 0
            while at < len(codes) and codes[at][0] is _FEED_MODE:
                self._switches.feed_mode(codes[at][2])
                at += 1
            if "f" in words or "s" in words or "t" in words:
                self._feed_speed_tool(block)
            for step, _, number in codes[at:]:
                if step is _MOTION:
                    motion = number
                elif step is _STOP:
                    stop = number
                elif step is _OFFSET:
                    special = number
                elif step is _OVERRIDE and number in _MODAL_STATE:
                    self._modes(number)
                else:
                    self._switches.act(step, number, block)
        elif "f" in words or "s" in words or "t" in words:
            self._feed_speed_tool(block)
        if special >= 0 and self._state.tool_point:
            self._refuse_in_joints(special, words)
        if special >= 0 and special != 530:
            self._offset(block, special, motion)
        if motion < 0 and words:
            motion = self._implied_motion(words)
        if motion >= 0:
            self._motion.move(block, motion, special == 530)
        elif special == 530:
            raise BlockError("G53 needs G0 or G1 and the words of axes in its block", "G53")
        # refused, since an ignored word may hide a missing code
        if words:
            letter = next(iter(words))
            raise BlockError(
                f"no code of this block uses the word {letter.upper()}: take it out, or write the code it belongs to",
                letter.upper(),
            )
        if stop >= 0:
            if stop in (20, 300):
                self._switches.leave_contour()
            self._switches.stop(stop)

    def _refuse_on_contour(self, codes: Sequence[tuple[Step, str, int]], words: dict[str, float]) -> None:
        """Refuse the codes that radius compensation excludes."""
        state = self._state
        same = {(Step.PLANE, state.plane), (Step.UNITS, 200 if state.inch else 210), (Step.CUTTER, 400)}
        off = (Step.CUTTER, "g", 400) in codes
        for step, letter, code in codes:
            if step in _EXCLUDED and (step, code) not in same and (letter, code) not in _HARMLESS:
                # L1 and L10 write the table, which acts at the next G41
                if code == 100 and words.get("l") in (1, 10):
                    continue
                # G40 acts before the codes behind it in the order of execution
                if off and step > Step.CUTTER:
                    continue
                name = blocks.name_of(letter, code)
                raise BlockError(f"{name} does not go with radius compensation: write G40 in a line before it", name)

    def _modes(self, code: int) -> None:
        """Execute M70 (save the modes), M71 (drop them), M72 (restore), or M73 (save, and restore on return)."""
        frame = self._flow.frame
        if code in (700, 730):
            frame.saved, frame.restores = Modes.of(self._state), code == 730
        elif code == 710:
            frame.saved, frame.restores = None, False
        elif frame.saved is None:
            raise BlockError("no modes are saved at this level: write M70 or M73 before, in the same subroutine", "M72")
        else:
            self._restore(frame.saved, "M72")

    def _restore(self, saved: Modes, name: str) -> None:
        """Execute the blocks that restore saved modes."""
        state = self._state
        if state.compensation:
            raise BlockError(f"{name} does not go with radius compensation: write G40 in a line before it", name)
        if unit := saved.unit_line(state):
            self._execute(blocks.read_block(self._line._replace(text=unit), self._parameters, False))
        for text in saved.lines(state):
            if text:
                self._execute(blocks.read_block(self._line._replace(text=text), self._parameters, False))

    def _refuse_in_joints(self, code: int, words: dict[str, float]) -> None:
        """Refuse codes whose coordinates are those of the joints while X Y Z are the tip of the tool."""
        name = blocks.name_of("g", code)
        table = code == 100 and words.get("l") in (1, 10)
        if table or code in (530, 280, 281, 300, 301):
            what = "changes the tool" if table else "gives positions of the joints"
            raise BlockError(
                f"{name} {what} while the tip of the tool is moved (G43.4, G43.5): write G49 in a line before", name
            )

    def _spindle_of(self, block: Block) -> int:
        """Return the number of the spindle ($) that S, M3, M4 or M5 of a block mean: 0 the first, -1 all."""
        if "s" not in block.words and all(step is not Step.SPINDLE for step, _, _ in block.codes):
            raise BlockError("$ is the spindle of S, M3, M4 and M5, of which this block has none: take it out", "$")
        return block.whole("$", "a spindle", -1, 7)

    def _unfinished(self) -> BlockError:
        nurbs = self._state.nurbs
        assert nurbs is not None
        ends = "G5.3" if nurbs.name == "G5.2" else f"{nurbs.order} blocks with K alone"
        return BlockError(f"the curve of {nurbs.name} is not ended: write {ends} before", "")

    def _comment(self, text: str) -> None:
        head, comma, rest = text.partition(",")
        kind = "".join(head.split()).lower() if comma else ""
        if kind == "msg":
            self._emit("MESSAGE", rest)
        elif kind == "debug":
            self._emit("MESSAGE", blocks.read_debug(rest, self._parameters))
        elif kind == "print":
            self._emit("PRINT", blocks.read_debug(rest, self._parameters))
        elif kind == "log":
            self._emit("LOG", blocks.read_debug(rest, self._parameters))
        elif text:
            self._emit("COMMENT", text.lstrip())

    def _feed_speed_tool(self, block: Block) -> None:
        words, state = block.words, self._state
        if "f" in words and state.feed_mode != 930:
            feed = words.pop("f")
            if feed < 0:
                raise BlockError(f"a feed is not negative: F{Quantity(feed):6}", "F")
            state.feed = feed
            self._emit("SET_FEED_RATE", feed)
        if "s" in words:
            self._switches.speed(words.pop("s"))
        if "t" in words:
            self._switches.select(block.whole("t", "T", 0, 99999))

    def _implied_motion(self, words: dict[str, float]) -> int:
        """Return the modal motion if the words of a block without a motion code imply one, otherwise -1."""
        motion = self._state.motion
        if not MOVING.isdisjoint(words):
            if motion == 800:
                letter = next(word for word in words if word in MOVING).upper()
                raise BlockError(
                    f"{letter} stands without a motion: write G0, G1 or another motion in this block or before", letter
                )
            return motion
        return motion if motion in (20, 30, 62) and not _ARC_WORDS.isdisjoint(words) else -1

    def _offset(self, block: Block, code: int, motion: int) -> None:
        """Execute a non-modal code that uses axis words."""
        state, name = self._state, blocks.name_of("g", code)
        if motion not in (-1, 0, 10, 800):
            raise BlockError(
                f"{name} and {blocks.name_of('g', motion)} both use the words of axes: use two lines", name
            )
        self._flow.moved()
        if code in (280, 300):
            target, moved = self._motion.target(block)
            go_home(state, self._emit, code, target, moved)
        elif code in (281, 301):
            set_home(state, code)
        elif code == 100:
            write_offsets(state, block, self._emit, self._tools if self._tools is not None else {})
        else:
            shift_axes(state, block, self._emit, code)

"""The interpreter of part programs: lines in, canonical commands out, a block at a time and in constant memory."""

from __future__ import annotations

from collections.abc import Generator
from pathlib import Path

from feeddrive.language.quantity import Quantity
from feeddrive.path.program import offsets
from feeddrive.path.program.blocks import Block, read_block, read_debug
from feeddrive.path.program.codes import Step, name_of
from feeddrive.path.program.commands import Command, Value
from feeddrive.path.program.flow import MOST_AGAIN, Flow
from feeddrive.path.program.lines import BlockError, Line, located
from feeddrive.path.program.motion import MOVING, Motion
from feeddrive.path.program.parameters import Parameters
from feeddrive.path.program.state import G92, G92_ON, SYSTEM, State
from feeddrive.path.program.switches import Switches
from feeddrive.path.program.tools import Tool

_FEED_MODE, _OFFSET, _MOTION, _STOP = Step.FEED_MODE, Step.OFFSET, Step.MOTION, Step.STOP
_ARC_WORDS = frozenset("ijkr")


class Interpreter:
    """Runs a part program.

    tools        the tool table, by number
    numbered     numbered parameters at the start, such as those of a `.var` file
    tables_inch  whether tool table and parameters are in inches instead of mm
    skip_deleted whether lines that begin with / are left out
    most_again   how many lines loops and calls may read again
    """

    def __init__(
        self,
        program: Path,
        tools: dict[int, Tool] | None = None,
        numbered: dict[int, float] | None = None,
        tables_inch: bool = False,
        skip_deleted: bool = False,
        most_again: int = MOST_AGAIN,
    ) -> None:
        self._parameters = Parameters(numbered)
        self._state = State(self._parameters, tables_inch)
        self._tools = None if tools is None else dict(tools)
        self._skip_deleted = skip_deleted
        self._out: list[Command] = []
        self._line = Line(str(program), 0, "")
        self._flow = Flow(program, self._parameters, most_again)
        self._switches = Switches(self._state, self._emit, self._tools)
        self._motion = Motion(self._state, self._emit, self._flow.moved)
        self._state.publish()
        self._parameters.live["_line"] = lambda: float(self._line.number)

    def commands(self) -> Generator[Command]:
        """The canonical commands, in the order of the program."""
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
                if "%" in line.text and line.text.strip() == "%":  # one begins a program, a second one ends it
                    if begun:
                        self._finish()
                        break
                    begun = True
                    continue
                try:
                    self._execute(read_block(line, self._parameters, self._skip_deleted))
                except BlockError as fault:
                    raise located(line, fault) from None
                except ArithmeticError:
                    raise located(
                        line, BlockError("the numbers of this block are too large: check units and parameters")
                    ) from None
                if self._switches.ended:
                    break
                begun = True
            yield from self._taken()
        finally:
            self._flow.close()

    def _taken(self) -> list[Command]:
        out = self._out
        self._out = []
        return out

    def _emit(self, name: str, *values: Value) -> None:
        self._out.append(Command(name, values, self._line))

    def _begin(self) -> None:
        state, numbered = self._state, self._parameters.numbered
        chosen = round(numbered.get(SYSTEM, 1.0))
        numbered.setdefault(SYSTEM, 1.0)
        state.system = chosen if 1 <= chosen <= offsets.SYSTEMS else 1
        state.origin = state.stored(offsets.first_of(state.system))
        state.rotation = numbered.get(offsets.first_of(state.system) + 9, 0.0)
        state.axis_offset = state.stored(G92) if numbered.get(G92_ON) else [0.0] * 9
        state.position = state.program([0.0] * 9)
        self._emit("USE_LENGTH_UNITS", "CANON_UNITS_MM")
        self._emit("SET_G5X_OFFSET", state.system, *state.origin)
        self._emit("SET_G92_OFFSET", *state.axis_offset)
        self._emit("SET_XY_ROTATION", state.rotation)
        self._emit("SET_FEED_REFERENCE", "CANON_XYZ")
        self._emit("ON_RESET")

    def _finish(self) -> None:
        try:
            self._flow.check_end()
        except BlockError as fault:
            raise located(self._line, fault) from None
        self._emit("FINISH")
        self._emit("ON_RESET")
        self._emit("ON_RESET")

    def _execute(self, block: Block) -> None:
        """Do what a block says, in the order of its codes."""
        if block.assigned:
            for key, value in block.assigned:
                self._parameters.set(key, value)
        if block.comments and not block.control:
            self._comment(block.comments[-1])
        if block.control:
            self._flow.act(block.control)
            return
        words, codes = block.words, block.codes
        motion = -1
        special = stop = -1
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
                else:
                    self._switches.act(step, number, block)
        elif "f" in words or "s" in words or "t" in words:
            self._feed_speed_tool(block)
        if special >= 0 and special != 530:
            self._offset(block, special, motion)
        if motion < 0 and words:
            motion = self._implied_motion(words)
        if motion >= 0:
            self._motion.move(block, motion, special == 530)
        elif special == 530:
            raise BlockError("G53 needs G0 or G1 and the words of axes in its block", "G53")
        if words:
            letter = next(iter(words))
            raise BlockError(
                f"no code of this block uses the word {letter.upper()}: take it out, or write the code it belongs to",
                letter.upper(),
            )
        if stop >= 0:
            self._switches.stop(stop)

    def _comment(self, text: str) -> None:
        head, comma, rest = text.partition(",")
        kind = "".join(head.split()).lower() if comma else ""
        if kind == "msg":
            self._emit("MESSAGE", rest)
        elif kind == "debug":
            self._emit("MESSAGE", read_debug(rest, self._parameters))
        elif kind == "print":
            self._emit("PRINT", read_debug(rest, self._parameters))
        elif kind == "log":
            self._emit("LOG", read_debug(rest, self._parameters))
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
        """The modal motion, if the words of a block without a motion code ask for one."""
        motion = self._state.motion
        if not MOVING.isdisjoint(words):
            if motion == 800:
                letter = next(each for each in words if each in MOVING).upper()
                raise BlockError(
                    f"{letter} stands without a motion: write G0, G1 or another motion in this block or before", letter
                )
            return motion
        return motion if motion in (20, 30) and not _ARC_WORDS.isdisjoint(words) else -1

    def _offset(self, block: Block, code: int, motion: int) -> None:
        """Codes that are not modal and use axis words themselves."""
        state, name = self._state, name_of("g", code)
        if motion not in (-1, 0, 10, 800):
            raise BlockError(f"{name} and {name_of('g', motion)} both use the words of axes: use two lines", name)
        self._flow.moved()
        if code in (280, 300):
            target, moved = self._motion.target(block)
            offsets.go_home(state, self._emit, code, target, moved)
        elif code in (281, 301):
            offsets.set_home(state, code)
        elif code == 100:
            offsets.write_offsets(state, block, self._emit, self._tools if self._tools is not None else {})
        else:
            offsets.shift_axes(state, block, self._emit, code)

"""The interpreter of RS-274/NGC and of the dialects that are rewritten to it, block by block in constant memory.

`Codes` executes the codes without motion, `Flow` the o-words, and `Execution` what does not depend on the language.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from pathlib import Path

from feeddrive.path.program import blocks
from feeddrive.path.program.blocks import Block, BlockError, Line, Step
from feeddrive.path.program.codes import Codes
from feeddrive.path.program.dialects import DIALECTS, DialectName, Rewritten
from feeddrive.path.program.execution import Execution, Setting
from feeddrive.path.program.flow import Flow
from feeddrive.path.program.modes import Modes
from feeddrive.path.program.motion import CURVE, MOVING
from feeddrive.path.program.moves import Command
from feeddrive.path.program.state import (
    G92,
    G92_ON,
    SYSTEM,
    SYSTEMS,
    first_of,
    go_home,
    set_home,
    shift_axes,
    write_offsets,
)

_EXCLUDED = {
    *(Step.PLANE, Step.UNITS, Step.CUTTER, Step.TOOL_LENGTH, Step.SYSTEM, Step.PATH_MODE, Step.OFFSET, Step.MOTION),
    *(Step.TOOL_CHANGE, Step.OUTPUT),
}
_HARMLESS = {*(("g", code) for code in (0, 10, 20, 30, 800)), *(("m", code) for code in (610, 640, 650, 680))}
"""Codes that radius compensation excludes: those of some steps, without some of them."""
_FEED_MODE, _OFFSET, _MOTION, _STOP = Step.FEED_MODE, Step.OFFSET, Step.MOTION, Step.STOP
_OVERRIDE, _MODAL_STATE = Step.OVERRIDE, frozenset({700, 710, 720, 730})
_ARC_WORDS = frozenset("ijkr")


class Interpreter:
    """The interpreter of a part program in RS-274/NGC, or in a dialect that is rewritten to it.

    dialect  language of the program, a name in `DIALECTS`
    """

    def __init__(self, program: Path, setting: Setting, dialect: DialectName = "linuxcnc") -> None:
        self._dialect, self._rewrite = dialect, DIALECTS[dialect]
        self._run = run = Execution(program, setting)
        self._setting, self._parameters, self._state = setting, run.parameters, run.state
        self._emit, self._lines, self._switches, self._motion = run.emit, run.lines, run.switches, run.motion
        self._flow = Flow(run.lines, run.parameters)
        self._codes = Codes(run.state, run.emit, run.tools, run.switches)
        self._begun = False
        self._state.publish()
        self._parameters.live["_line"] = lambda: float(run.line.number)
        for name, value in setting.parameters.items():
            # as names are compared: without case and white space
            self._parameters.set("".join(name.split()).lower().strip("#<>"), value)

    def commands(self) -> Generator[Command]:
        """Yield the canonical commands in program order."""
        return self._run.commands(self)

    # what `Execution` asks of a language

    @property
    def loop(self) -> str:
        """The innermost loop that is running in the program itself."""
        return self._flow.loop

    def words(self) -> str:
        """Return the modal state as words."""
        return self._state.words()

    def execute(self, line: Line) -> bool:
        """Execute a line; return True if it ends the program."""
        if self._rewrite:
            line = self._translated(line, self._rewrite)
        # one % begins a program, a second one ends it
        if "%" in line.text and line.text.strip() == "%":
            if self._begun:
                return self.finish()
            self._begun = True
            return False
        self._execute(blocks.read_block(line, self._parameters, self._setting.skip_deleted))
        self._begun = True
        return self._codes.ended

    def _translated(self, line: Line, rewrite: Callable[[str], Rewritten]) -> Line:
        """Return a line of a dialect as RS-274/NGC, and execute what RS-274 has no words for."""
        meaning = rewrite(line.text)
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
        self._lines.moved()
        if self._dialect == "marlin" and any(state.axis_offset[axis] for axis in axes):
            state.keep_machine(axis_offset=[0.0 if k in axes else x for k, x in enumerate(state.axis_offset)])
            self._emit("SET_G92_OFFSET", *state.axis_offset)
        machine = state.machine(state.position)
        for axis in axes:
            machine[axis] = 0.0
        state.position = state.program(machine)
        self._emit("STRAIGHT_TRAVERSE", *state.position)

    def begin(self) -> None:
        """Emit the state at the start of the program."""
        state, numbered = self._state, self._parameters.numbered
        chosen = round(numbered.get(SYSTEM, 1.0))
        numbered.setdefault(SYSTEM, 1.0)
        state.system = chosen if 1 <= chosen <= SYSTEMS else 1
        state.origin = state.stored(first_of(state.system))
        state.rotation = numbered.get(first_of(state.system) + 9, 0.0)
        state.axis_offset = state.stored(G92) if numbered.get(G92_ON) else [0.0] * 9
        # the interpreter does not know where the machine stands: the caller does, or assumes its zero
        state.position = state.program(self._setting.start)
        self._emit("USE_LENGTH_UNITS", "CANON_UNITS_MM")
        self._emit("SET_G5X_OFFSET", state.system, *state.origin)
        self._emit("SET_G92_OFFSET", *state.axis_offset)
        self._emit("SET_XY_ROTATION", state.rotation)
        self._emit("SET_FEED_REFERENCE", "CANON_XYZ")
        self._emit("ON_RESET")

    def finish(self) -> bool:
        """End the program at the end of its file, or at its second %."""
        self._flow.check_end()
        if self._state.nurbs:
            raise self._unfinished()
        self._switches.leave_contour()
        self._emit("FINISH")
        self._emit("ON_RESET")
        self._emit("ON_RESET")
        return True

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
        self._codes.chosen = self._spindle_of(block) if "$" in words else 0
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
                    self._codes.act(step, number, block)
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
            self._codes.stop(stop)

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
            self._execute(blocks.read_block(self._run.line._replace(text=unit), self._parameters, False))
        for text in saved.lines(state):
            if text:
                self._execute(blocks.read_block(self._run.line._replace(text=text), self._parameters, False))

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
            self._switches.feed(words.pop("f"))
        if "s" in words:
            self._switches.speed(words.pop("s"), self._codes.chosen)
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
        self._lines.moved()
        if code in (280, 300):
            target, moved = self._motion.target(block)
            go_home(state, self._emit, code, target, moved)
        elif code in (281, 301):
            set_home(state, code)
        elif code == 100:
            write_offsets(state, block, self._emit, self._run.tools if self._run.tools is not None else {})
        else:
            shift_axes(state, block, self._emit, code)

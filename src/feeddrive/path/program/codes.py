"""The codes of RS-274/NGC that move no axis: modes, spindle, tool, coolant, overrides, outputs and stops."""

from __future__ import annotations

from collections.abc import Callable

from feeddrive.language.quantity import number
from feeddrive.path.program import blocks
from feeddrive.path.program.blocks import Block, BlockError, Step
from feeddrive.path.program.compensation import Corners
from feeddrive.path.program.state import (
    BY_CODE,
    PATH_MODES,
    READ_INPUT,
    SYSTEM,
    Emit,
    State,
    Tool,
    choose_system,
    end_tool_point,
    first_of,
    tool_length,
)
from feeddrive.path.program.switches import Switches

_OUTPUTS = {
    620: "SET_MOTION_OUTPUT_BIT",
    630: "CLEAR_MOTION_OUTPUT_BIT",
    640: "SET_AUX_OUTPUT_BIT",
    650: "CLEAR_AUX_OUTPUT_BIT",
}
_SWITCHED = {500: "FEED_OVERRIDE", 510: "SPEED_OVERRIDE", 520: "ADAPTIVE_FEED", 530: "FEED_HOLD"}


class Codes:
    """The executor of the codes that move no axis; `ended` is True once the program has ended."""

    def __init__(self, state: State, emit: Emit, tools: dict[int, Tool] | None, switches: Switches) -> None:
        self._state, self._emit, self._tools, self._switches = state, emit, tools, switches
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

    def stop(self, code: int) -> None:
        """Execute M0, M1 or M60 (stop), or M2 or M30 (end)."""
        if code in (20, 300):
            self._end(code == 300)
        elif code == 600:
            self._emit("PALLET_SHUTTLE")
            self._switches.stop()
        else:
            self._switches.stop(optional=bool(code))

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
        state, name = self._state, blocks.name_of("m", code)
        if code == 610:
            self._switches.check_change(name)
            state.tool = block.whole("q", "M61", 0, 99999)
            self._emit("CHANGE_TOOL_NUMBER", state.tool)
            return
        if state.leaving:
            # a changer stands for the machine's own position, as in LinuxCNC
            state.position, state.leaving = state.leaving, None
        self._switches.change_tool(name)

    def _spindle(self, code: int, block: Block) -> None:
        if code == 190:
            angle, way = block.take("r") or 0.0, block.whole("p", "M19", 0, 2, 0)
            if not 0.0 <= angle <= 360.0:
                raise BlockError(f"R of M19 is an angle from 0 to 360 degrees, not {number(angle, 6)}", "R")
            # the time that it takes is not known: a stop, for which the machine waits
            block.take("q")
            self._emit("ORIENT_SPINDLE", self.chosen, angle, way)
            return
        self._switches.turn({30: 1, 40: -1, 50: 0}[code], self.chosen)

    def _rpm(self, code: int, block: Block) -> None:
        self._emit("SET_SPINDLE_MODE", 0, 0.0)

    def _cutter(self, code: int, block: Block) -> None:
        if code == 400:
            self._switches.leave_contour()
            self._emit("COMMENT", "interpreter: cutter radius compensation off")
            return
        name = blocks.name_of("g", code)
        if self._state.plane == 190:
            raise BlockError(f"{name} acts in the planes XY and ZX: write G17 or G18 before", name)
        diameter = self._diameter(block, code, name)
        self._switches.begin_contour(name, diameter, code in (410, 411), Corners())

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
        self._switches.check_round(orientation, name, ", or take the front end rs274")
        return diameter

    def _system(self, code: int, block: Block) -> None:
        choose_system(self._state, self._emit, BY_CODE[code])

    def _coolant(self, code: int, block: Block) -> None:
        self._switches.coolant(mist=code == 70, flood=code == 80)

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
        self._switches.dwell(seconds, "P")

    def _plane(self, code: int, block: Block) -> None:
        self._switches.plane(code)

    def _units(self, code: int, block: Block) -> None:
        self._state.use_inch(code == 200)
        self._emit("USE_LENGTH_UNITS", "CANON_UNITS_INCHES" if code == 200 else "CANON_UNITS_MM")

    def _tool_length(self, code: int, block: Block) -> None:
        tools = self._tools if self._tools is not None else {}
        tool_length(self._state, block, self._emit, tools, code)

    def _path_mode(self, code: int, block: Block) -> None:
        if code != 640:
            self._switches.path_mode(PATH_MODES[code])
            return
        tolerance, naive = block.take("p"), block.take("q")
        for letter, value in (("P", tolerance), ("Q", naive)):
            if value is not None and value < 0:
                raise BlockError(f"a tolerance is not negative: {letter}{number(value, 6)}", letter)
        within = tolerance or 0.0
        self._switches.path_mode(PATH_MODES[code], within, within if naive is None else naive)

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

"""Codes that move coordinates, not the machine: G10, G28.1, G43, G49, G52, G54 to G59.3, G92; and G28, G30."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from feeddrive.path.program.blocks import AXES, Block
from feeddrive.path.program.codes import name_of
from feeddrive.path.program.lines import BlockError
from feeddrive.path.program.state import G92, G92_ON, HOME_1, HOME_2, LINEAR, SYSTEM, SYSTEMS, State, rotated
from feeddrive.path.program.tools import Tool

Emit = Callable[..., None]
BY_CODE = {540: 1, 550: 2, 560: 3, 570: 4, 580: 5, 590: 6, 591: 7, 592: 8, 593: 9}


def first_of(system: int) -> int:
    """The first parameter of a coordinate system, 1 to 9."""
    return SYSTEM + 1 + 20 * (system - 1)


def choose_system(state: State, emit: Emit, system: int) -> None:
    """G54 to G59.3: another work offset."""
    if system == state.system:
        emit("COMMENT", "interpreter: continuing to use same coordinate system")
        return
    state.system = system
    state.parameters.numbered[SYSTEM] = float(system)
    rotation = state.parameters.numbered.get(first_of(system) + 9, 0.0)
    axis_offset = state.stored(G92) if state.parameters.numbered.get(G92_ON) else state.axis_offset
    state.keep_machine(state.stored(first_of(system)), rotation, axis_offset)
    emit("SET_G5X_OFFSET", system, *state.origin)
    emit("SET_G92_OFFSET", *state.axis_offset)
    emit("SET_XY_ROTATION", rotation)


def write_offsets(state: State, block: Block, emit: Emit, tools: dict[int, Tool]) -> None:
    """G10: L2 and L20 write a work offset, L1 and L10 one of the tool table."""
    kind = block.whole("l", "G10", 1, 20)
    given = {axis: value for axis, letter in enumerate(AXES) if (value := block.take(letter)) is not None}
    if kind in (2, 20):
        system = block.whole("p", f"G10 L{kind}", 0, SYSTEMS) or state.system
        _write_system(state, emit, system, given, block.take("r"), here=kind == 20)
    elif kind in (1, 10):
        number = block.whole("p", f"G10 L{kind}", 1, 99999)
        _write_tool(state, block, emit, tools, number, given, here=kind == 10)
    else:
        raise BlockError(f"G10 has L1, L2, L10 and L20, not L{kind}", "L")


def _write_system(
    state: State, emit: Emit, system: int, given: dict[int, float], rotation: float | None, here: bool
) -> None:
    numbered, first = state.parameters.numbered, first_of(system)
    origin = state.stored(first)
    angle = numbered.get(first + 9, 0.0) if rotation is None else rotation
    if here:
        if rotation is not None:
            raise BlockError("G10 L20 has no R: write the rotation with G10 L2", "R")
        probe = _with_system(state, origin, angle)
        for axis, value in given.items():  # the present position is to have the coordinate `value`
            shift = [0.0] * 9
            shift[axis] = probe[axis] - value
            moved = _turned(shift, angle)
            origin = [o + m for o, m in zip(origin, moved, strict=True)]
    else:
        for axis, value in given.items():
            origin[axis] = value
    state.store(first, origin)
    numbered[first + 9] = angle
    if system == state.system:
        state.keep_machine(state.stored(first), angle)
        emit("SET_G5X_OFFSET", system, *state.origin)
        emit("SET_XY_ROTATION", angle)
    else:
        emit("COMMENT", "interpreter: setting coordinate system origin")


def _with_system(state: State, origin: list[float], rotation: float) -> list[float]:
    """The coordinates of the present position with another work offset."""
    kept = state.origin, state.rotation
    standing = state.machine(state.position)
    state.origin, state.rotation = origin, rotation
    here = state.program(standing)
    state.origin, state.rotation = kept
    return here


def _turned(shift: list[float], rotation: float) -> list[float]:
    x, y = rotated(shift[0], shift[1], rotation)
    return [x, y, *shift[2:]]


def _write_tool(
    state: State, block: Block, emit: Emit, tools: dict[int, Tool], number: int, given: dict[int, float], here: bool
) -> None:
    tool = tools.get(number)
    if tool is None:
        raise BlockError(f"tool {number} is not in the tool table: add it there", "P")
    scale = state.scale
    offset = list(tool.offset)
    if here:
        standing = state.machine(state.position)
        position = [m - t - o for m, t, o in zip(standing, state.tool_offset, state.origin, strict=True)]
        position = [p - a for p, a in zip(position, state.axis_offset, strict=True)]
        given = {axis: position[axis] - value for axis, value in given.items()}
    for axis, value in given.items():
        offset[axis] = value / scale if axis in LINEAR else value
    radius, front, back = block.take("r"), block.take("i"), block.take("j")
    tool = replace(
        tool,
        offset=tuple(offset),
        diameter=tool.diameter if radius is None else 2 * radius / scale,
        front_angle=tool.front_angle if front is None else front,
        back_angle=tool.back_angle if back is None else back,
        orientation=block.whole("q", "G10", 0, 9, tool.orientation),
    )
    tools[number] = tool
    values = (*tool.offset, tool.diameter, tool.front_angle, tool.back_angle, tool.orientation)
    emit("SET_TOOL_TABLE_ENTRY", tool.pocket, number, *values)


def tool_length(state: State, block: Block, emit: Emit, tools: dict[int, Tool], code: int) -> None:
    """G43, G43.1, G43.2 and G49: the offset of the tool."""
    offset = [0.0] * 9
    if code == 431:
        offset = list(state.tool_offset)
        given = {axis: value for axis, letter in enumerate(AXES) if (value := block.take(letter)) is not None}
        if not given:
            raise BlockError("G43.1 needs the offset of an axis at least, such as Z12", "G43.1")
        for axis, value in given.items():
            offset[axis] = value
    elif code in (430, 432):
        name = name_of("g", code)
        number = block.whole("h", name, 0, 99999, state.tool if code == 430 else None)
        tool = tools.get(number)
        if tool is None and number:
            raise BlockError(
                f"tool {number} is not in the tool table: give the table with this tool", "H" if code == 432 else name
            )
        offset = state.to_program(tool.offset) if tool else offset
        if code == 432:
            offset = [o + t for o, t in zip(offset, state.tool_offset, strict=True)]
    state.keep_machine(tool_offset=offset)
    emit("USE_TOOL_LENGTH_OFFSET", *offset)


def shift_axes(state: State, block: Block, emit: Emit, code: int) -> None:
    """G52 and G92: what the program calls the present position; G92.1 to G92.3 clear, suspend and restore it."""
    numbered = state.parameters.numbered
    offset = list(state.axis_offset)
    if code in (520, 920):
        given = {axis: value for axis, letter in enumerate(AXES) if (value := block.take(letter)) is not None}
        if not given:
            name = name_of("g", code)
            raise BlockError(f"{name} needs an axis at least, such as X0", name)
        for axis, value in given.items():
            offset[axis] = value if code == 520 else offset[axis] + state.position[axis] - value
        numbered[G92_ON] = 1.0
    elif code == 923:
        offset = state.stored(G92)
        numbered[G92_ON] = 1.0
    else:
        offset = [0.0] * 9
        numbered[G92_ON] = 0.0
    if code in (520, 920, 921):
        state.store(G92, offset)
    state.keep_machine(axis_offset=offset)
    emit("SET_G92_OFFSET", *offset)


def go_home(state: State, emit: Emit, code: int, target: list[float], moved: list[int]) -> None:
    """G28 and G30: by way of the point of the axis words to the stored position, with these axes or with all."""
    state.position = list(target)
    emit("STRAIGHT_TRAVERSE", *target)
    home = state.to_program(
        [state.parameters.numbered.get((HOME_1 if code == 280 else HOME_2) + axis, 0.0) for axis in range(9)]
    )
    machine = state.machine(target)
    for axis in moved or range(9):
        machine[axis] = home[axis]
    state.position = state.program(machine)
    if moved:
        fixed = [axis for axis in range(9) if axis not in moved and not (state.rotation and axis < 2)]
        for axis in fixed:
            state.position[axis] = target[axis]
    emit("STRAIGHT_TRAVERSE", *state.position)


def set_home(state: State, code: int) -> None:
    """G28.1 and G30.1: keep the present position."""
    state.store(HOME_1 if code == 281 else HOME_2, state.machine(state.position))

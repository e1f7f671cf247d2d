"""The target `linuxcnc`: components, wiring, axis limits checked by simulation, and a README."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Template
from typing import NamedTuple

import numpy as np

from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.blocks.reference.trapezoidal_move import TrapezoidalMove
from feeddrive.export.c_code import Texts, header_only, rules, texts
from feeddrive.export.design import CONTROL, Design, require_alone
from feeddrive.export.identifiers import HAL_LENGTH, check_name
from feeddrive.export.layout import layout
from feeddrive.export.targets import readme, write_bundle
from feeddrive.files.atomic_io import check_directory
from feeddrive.language.errors import DivergedError, ParameterError, StructureError
from feeddrive.language.quantity import Quantity
from feeddrive.loop.guard import TRIPS
from feeddrive.loop.loop import Loop, quantity
from feeddrive.loop.machine import Machine, System
from feeddrive.loop.routine import Routine, Variable, machine_routine, plant_routine
from feeddrive.loop.simulate import simulate

# The .comp files of a controller and of a simulated axis: HAL names, declarations, and C code.

FAULT_PERIOD, FAULT_LATE, FAULT_PARAMETER = 11, 12, 13  # in addition to the trip codes of the guard
FAULTS = {int(code): word for code, word in TRIPS.items()} | {
    FAULT_PERIOD: "a thread with another period than the sample time",
    FAULT_LATE: "a call that came too late",
    FAULT_PARAMETER: "parameters that break a rule when enable is set",
}
LATE = 10  # longest time between calls, in periods
# pin and meaning of each input of the law; lengths are in the unit of the machine
_INPUTS = {
    "set_position": ("position-cmd", "set position"),
    "set_velocity": ("velocity-cmd", "set velocity"),
    "set_acceleration": ("acceleration-cmd", "set acceleration"),
    "set_jerk": ("jerk-cmd", "set jerk; 0 unless the planner gives it"),
    "set_snap": ("snap-cmd", "set snap; 0 unless the planner gives it"),
    "reading": ("position-fb", "position that the encoder reads"),
    "reading_motor": ("motor-position-fb", "position that the motor's encoder reads, as travel of the table"),
    "reading_load": ("load-position-fb", "position that the encoder at the table reads"),
}
_UNITS = {"m": "mm", "m/s": "mm/s", "m/s2": "mm/s2", "m/s3": "mm/s3", "m/s4": "mm/s4"}


def input_pin(path: str) -> str:
    """Return the pin name of an input of the routine; that of one of several axes has the axis in front."""
    port, name = path[: -len(quantity(path))], quantity(path)
    return hal(port) + ("enable" if name == "enable" else _INPUTS[name][0])


def reading_pin(routine: Routine, port: str = "") -> str:
    """Return the pin name of the controlled position of the axis whose signals begin with `port`."""
    at_load = any(v.path == f"{port}reading_load" for v in routine.inputs)
    return input_pin(f"{port}{'reading_load' if at_load else 'reading'}")


def ports(routine: Routine) -> tuple[str, ...]:
    """Return what the signals of each axis begin with: `x.`, or an empty string if there is one axis only."""
    return routine.origin.ports()


def _of(variables: Iterable[Variable], port: str) -> dict[str, Variable]:
    """Return the inputs or outputs of one axis by quantity."""
    return {quantity(v.path): v for v in variables if v.path == f"{port}{quantity(v.path)}"}


def pins(routine: Routine) -> list[Item]:
    """Return all pins of the controller."""
    codes = "; ".join(f"{code} {word}" for code, word in FAULTS.items())
    items: list[Item] = []
    for port in ports(routine):
        items += [
            pin(input_pin(v.path), "float", "in", f"{_INPUTS[name][1]}, {_UNITS[v.unit]} (units-per-m)")
            for name, v in _of(routine.inputs, port).items()
            if name in _INPUTS
        ]
        said = "the loop runs while it is on; a rising edge starts anew and clears a fault"
        items.append(pin(input_pin(f"{port}enable"), "bit", "in", said))
    items += [
        pin("reset", "bit", "in", "a rising edge clears a fault while enable is off"),
        pin("hold-parameters", "bit", "in", "while on, changed parameters wait; they act together when it goes off"),
    ]
    for port in ports(routine):
        outputs, x = _of(routine.outputs, port), hal(port)
        items.append(pin(f"{x}force-cmd", "float", "out", f"{outputs['force'].meaning}, N"))
        if "command" in outputs:
            items.append(pin(f"{x}drive-cmd", "float", "out", outputs["command"].meaning))
        items += [
            pin(f"{x}running", "bit", "out", "on while the loop runs: enabled, without trip or fault"),
            pin(f"{x}trip-code", "s32", "out", "trip of the guard now, 0 none; it ends when enable goes off"),
            pin(f"{x}fault", "bit", "out", "on from a trip or fault until the next rising edge of enable or reset"),
            pin(f"{x}fault-code", "s32", "out", f"why: 0 none; {codes}"),
        ]
    return [
        *items,
        pin("ok", "bit", "out", "on while there is no fault, for an emergency stop chain"),
        pin("heartbeat", "bit", "out", "changes at every call while there is no fault: for a watchdog or charge pump"),
        pin("parameter-bad", "bit", "out", "the parameters break a rule: no change acts until they are corrected"),
        pin("parameter-rule", "s32", "out", "code of the broken rule, 0 none; the README explains it"),
        pin("retunes", "u32", "out", "number of parameter changes that have acted"),
    ]


def settings(routine: Routine) -> dict[Item, float]:
    """Return the HAL parameters of the component itself, which the controller does not have, with their values."""
    T = servo_period(routine)
    return {
        Item(
            "units-per-m",
            "float",
            "rw",
            "length units of the machine in a metre: 1000 for mm, 39.37007874015748 for inch; read at the first call",
        ): 1000.0,
        Item(
            "period-tolerance", "u32", "rw", f"largest deviation of the period of the thread from {T} ns, in ns"
        ): tolerance(routine),
        Item("late-limit", "u32", "rw", "longest time from call to call, ns; 0: not watched"): LATE * T,
    }


def tolerance(routine: Routine) -> int:
    """Return the largest permitted deviation of the thread's period from the sample time, in ns."""
    return max(servo_period(routine) // 1000, 1)


def controller_comp(routine: Routine, title: str, made_by: str) -> str:
    """Return the text of the controller's .comp file, which includes P.h.

    Raises ParameterError and StructureError for names and sample times that LinuxCNC does not support.
    """
    items, own = pins(routine), settings(routine)
    tuned = {parameter(v, routine): v for v in routine.parameters}
    check_component(routine.name, ("",), [*items, *own, *tuned])
    return component_text(
        routine.name,
        f"{title}. {made_by} Pins in mm, mm/s, ... (units-per-m), N; parameters in SI as in the machine file.",
        items,
        own | {item: v.value for item, v in tuned.items()},
        ["_"],
        filled(
            "controller.c",
            P=routine.name,
            hal=hal(routine.name),
            period=servo_period(routine),
            axes=len(ports(routine)),
            wanted=numbers([item.c for item in tuned]),
            enables=numbers([pin(input_pin(f"{port}enable"), "", "", "").c for port in ports(routine)]),
            inputs=numbers([_input_expression(routine, v.path) for v in routine.inputs]),
            outputs="\n".join(_output_statements(routine, i, port) for i, port in enumerate(ports(routine))),
            period_fault=FAULT_PERIOD,
            late_fault=FAULT_LATE,
            parameter_fault=FAULT_PARAMETER,
        ),
    )


def _input_expression(routine: Routine, path: str) -> str:
    """Return the C expression for an input of the law, in SI units."""
    if quantity(path) == "enable":
        return f"on[{ports(routine).index(path.removesuffix('enable'))}] ? 1.0 : 0.0"
    return f"{pin(input_pin(path), '', '', '').c} / scale"


def _output_statements(routine: Routine, axis: int, port: str) -> str:
    """Return the C statements that put the outputs of an axis on its pins."""
    outputs, x = _of(routine.outputs, port), pin(hal(port), "", "", "").c
    lines = [f"{x}force_cmd = result.{outputs['force'].name};"]
    if "command" in outputs:
        lines.append(f"{x}drive_cmd = result.{outputs['command'].name};")
    lines += [
        f"{x}running = result.{outputs['enabled'].name} > 0.5;",
        f"{x}trip_code = (int)result.{outputs['trip'].name};",
        f"if (fault_now[{axis}] == 0)",
        f"    fault_now[{axis}] = {x}trip_code;",
        f"{x}fault = fault_now[{axis}] != 0;",
        f"{x}fault_code = fault_now[{axis}];",
        f"fine = fine && fault_now[{axis}] == 0;",
    ]
    return "\n".join(f"    {line}" for line in lines)


FUNCTIONS = ("read", "write")
_OUTPUTS = {
    "reading_motor": ("motor-position-fb", "position that the motor's encoder reads, as travel of the table, mm", True),
    "reading_load": ("load-position-fb", "position that the encoder at the table reads, mm", True),
    "position_motor": ("motor-position", "true position of the motor's body, mm", True),
    "position_load": ("load-position", "true position of the table, mm", True),
    "velocity_motor": ("motor-velocity", "true velocity of the motor's body, mm/s", True),
    "velocity_load": ("load-velocity", "true velocity of the table, mm/s", True),
}
_PLANT_INPUTS = {
    "force": ("force", "force of the drive at the table, N: force-cmd of the controller"),
    "load_force": ("load-force", "force of the process on the table, N"),
}


def plant_comp(routine: Routine, title: str, made_by: str) -> str:
    """Return the text of the .comp file of the simulated axis, which includes P.h.

    Its functions `read` and `write` replace those of an I/O card.
    Raises ParameterError and StructureError for names and sample times that LinuxCNC does not support.
    """
    T = servo_period(routine)
    pins = [
        pin(plant_pin(v.path), "float", "in", _PLANT_INPUTS[quantity(v.path)][1])
        for v in routine.inputs
        if quantity(v.path) in _PLANT_INPUTS
    ]
    pins += [pin(plant_pin(v.path), "float", "out", _OUTPUTS[quantity(v.path)][1]) for v in routine.outputs]
    pins.append(pin("held", "bit", "in", "while on, time stands still: as a brake would hold the axis"))
    own = {Item("units-per-m", "float", "rw", "length units of the machine in a metre; read at the first call"): 1000.0}
    for port in ports(routine):
        said = "where the axis stands at first, mm; read at the first call"
        own[Item(plant_pin(f"{port}start_position"), "float", "rw", said)] = 0.0
    physics = {parameter(v, routine): v.value for v in routine.parameters}
    check_component(routine.name, FUNCTIONS, [*pins, *own, *physics])
    return component_text(
        routine.name,
        f"{title}. {made_by} For the desk only: call read before and write after the controller, every {T} ns. "
        "Parameters in SI; they act if set before the first call.",
        pins,
        own | physics,
        FUNCTIONS,
        filled(
            "plant.c",
            P=routine.name,
            wanted=numbers([item.c for item in physics]),
            inputs=numbers(
                [f"{plant_c(v)}{' / scale' if quantity(v.path) == 'start_position' else ''}" for v in routine.inputs]
            ),
            outputs="\n".join(f"    {plant_c(v)} = now.{v.name} * scale;" for v in routine.outputs),
        ),
    )


def plant_pin(path: str) -> str:
    """Return the name of a pin or of the start position of the simulated axes."""
    port, name = path[: -len(quantity(path))], quantity(path)
    if name == "start_position":
        return f"{hal(port)}start-position"
    return hal(port) + (_PLANT_INPUTS[name][0] if name in _PLANT_INPUTS else _OUTPUTS[name][0])


def plant_c(variable: Variable) -> str:
    """Return the name of an input or output of the simulated axes in the C code of their component."""
    return pin(plant_pin(variable.path), "", "", "").c


def text(name: str) -> str:
    """Return the text of a file in `templates/linuxcnc/`."""
    return (Path(__file__).parent / "templates" / "linuxcnc" / name).read_text(encoding="utf-8")


def filled(name: str, /, **values: object) -> str:
    """Return the text of a file in `templates/linuxcnc/` with its placeholders replaced by `values`."""
    return Template(text(name)).substitute({key: str(value) for key, value in values.items()})


# Components of LinuxCNC 2.9: one with the same name would replace them on the user's machine, or not load.
STOCK = frozenset(text("stock.txt").split())
FASTEST, SLOWEST = 10_000, 100_000_000  # ns; shortest period of a PC, and longer than any servo period
MEASURED = ("time", "tmax", "tmax-increased")  # pins that HAL adds to every function


class Item(NamedTuple):
    """A pin or a parameter that a .comp file declares."""

    name: str
    type: str  # "float", "bit", "s32" or "u32"
    direction: str  # "in", "out" or "rw"
    meaning: str  # plain ASCII, with the unit

    @property
    def c(self) -> str:
        """The name of the item in the C code of a component."""
        return re.sub("_+", "_", re.sub("[-.]", "_", self.name))


def pin(name: str, kind: str, direction: str, meaning: str) -> Item:
    """Return a pin, its meaning converted to plain ASCII."""
    return Item(name, kind, direction, plain(meaning))


def parameter(variable: Variable, routine: Routine) -> Item:
    """Return the HAL parameter for a parameter of the controller or the axis.

    `axis.x.control.law.Kv` becomes `law.Kv` of the component `axis-x`, and `x.law.Kv` of that of several axes.
    """
    kept = "" if isinstance(routine.origin, Loop) else r"\1."
    name = re.sub(r"^axis\.([^.]+)\.(control\.|actuator\.(?=motor\.))?", kept, variable.path).replace("_", "-")
    return Item(name, "float", "rw", plain(f"{variable.meaning}, {variable.unit or 'no unit'}"))


def hal(name: str) -> str:
    """Convert a name to HAL spelling: `axis_x` becomes `axis-x`."""
    return name.replace("_", "-")


def check_component(name: str, functions: Sequence[str], items: Iterable[Item]) -> None:
    """Raise ParameterError for a name that is reserved or too long, and StructureError for duplicate names."""
    if name in STOCK:
        raise ParameterError(
            f"the name '{name}' is that of a component of LinuxCNC, which the installed one would replace; "
            f"take another, such as axis_{name}"
        )
    seen: dict[str, str] = {}
    measured = [".".join((*filter(None, (function,)), last)) for function in functions for last in MEASURED]
    for entry in (*(item.name for item in items), *measured):
        whole = f"{hal(name)}.{entry}"
        if len(whole) > HAL_LENGTH:
            raise ParameterError(
                f"'{whole}' has {len(whole)} characters, {len(whole) - HAL_LENGTH} more than the {HAL_LENGTH} of a "
                f"name in LinuxCNC's HAL; take a shorter name than '{name}'"
            )
        # halcompile replaces `-` and `.` in C names by `_`: names that differ only there would collide
        key = re.sub("[-._]+", "_", entry)
        if key in seen:
            raise StructureError(f"'{hal(name)}.{seen[key]}' and '{whole}' are one name in LinuxCNC's HAL")
        seen[key] = entry


def plain(words: str) -> str:
    """Convert a string to what halcompile and its manual pages accept: ASCII, no double quotes or backslashes."""
    words = words.replace("²", "2").replace("³", "3").replace("µ", "u").replace("·", " ").replace("−", "-")
    words = words.replace('"', "'").replace("\\", "/").replace("\n", " ")
    return words.encode("ascii", "replace").decode()


def servo_period(routine: Routine) -> int:
    """Return the sample time in ns. Raises ParameterError if no servo thread of LinuxCNC supports it."""
    exact = routine.sample_time * 1e9
    whole = round(exact)
    if abs(exact - whole) > 1e-3:
        raise ParameterError(
            f"sample_time = {Quantity(routine.sample_time, 's'):12 SI} is not a whole number of nanoseconds, the unit "
            f"of thread periods in LinuxCNC; the nearest is {Quantity(max(whole, FASTEST) * 1e-9, 's'):9 SI}"
        )
    if not FASTEST <= whole <= SLOWEST:
        raise ParameterError(
            f"sample_time = {Quantity(routine.sample_time, 's'):9 SI}: a servo thread of LinuxCNC has a period from "
            f"{Quantity(FASTEST * 1e-9, 's'):6} to {Quantity(SLOWEST * 1e-9, 's'):6}; take a sample time in between"
        )
    return whole


# LinuxCNC's flags permit a fused multiply-add, which processors other than x86 would use.
_EXACT = '#pragma GCC optimize("fp-contract=off")\n\n'
# these functions keep thousands of variables in one frame, of which the compiler would warn
_AS_IT_STANDS = """\
#pragma GCC push_options
#pragma GCC optimize("O0")
#pragma GCC diagnostic ignored "-Wframe-larger-than="
"""


def core(name: str, parts: Texts) -> str:
    """Return the header that a component includes, with the complete routine.

    Code that runs once or at parameter changes may have thousands of lines.  It is compiled without optimization, which
    reduces the compile time to a tenth.
    """
    once = re.compile(
        rf"^static (?:inline bool {name}_retune|int {name}_designed)\([^;{{]*\)\n\{{.*?^\}}\n", re.DOTALL | re.MULTILINE
    )
    whole = header_only(name, parts)
    return _EXACT + once.sub(lambda match: f"{_AS_IT_STANDS}{match[0]}#pragma GCC pop_options\n", whole)


def component_text(
    name: str,
    description: str,
    pins: Iterable[Item],
    parameters: Mapping[Item, float],
    functions: Sequence[str],
    body: str,
) -> str:
    """Return the text of a .comp file that includes `name.h`, for `halcompile --install`."""
    lines = [f'component {name} "{plain(description)}";', ""]
    lines += [f'pin {item.direction} {_TYPES[item.type]} {item.name} "{item.meaning}";' for item in pins]
    lines.append("")
    lines += [
        f'param rw {_TYPES[item.type]} {item.name} = {_number(item, value)} "{item.meaning}";'
        for item, value in parameters.items()
    ]
    lines.append("")
    lines += [f"function {function} fp;" for function in functions]
    lines += ["option singleton yes;", f'include "{name}.h";', 'license "MIT";', 'author "feeddrive";', "", ";;"]
    return "\n".join(lines) + f"\n{body}"


_TYPES = {"float": "float", "bit": "bit", "s32": "signed", "u32": "unsigned"}


def _number(item: Item, value: float) -> str:
    """Return a default value in the syntax of halcompile, which has no `+` in an exponent."""
    return repr(float(value)).replace("e+", "e") if item.type == "float" else str(int(value))


def numbers(texts: Iterable[str]) -> str:
    """Return numbers as the content of a C initializer, wrapped into lines."""
    lines = [""]
    for number_text in texts:
        if len(lines[-1]) + len(number_text) > 90:
            lines.append("")
        lines[-1] += f" {number_text},"
    return "\n        ".join(line.strip() for line in lines).rstrip(",")


# The target `linuxcnc`: components, wiring, axis limits checked by simulation, and a README.


def write_linuxcnc(design: Design, out: str | Path, *, joint: int | None = None) -> Path:
    """Write the controller of a design as a LinuxCNC component, with all files needed to run it.

    Returns the path of the README.

    joint  number of the joint in LinuxCNC, that of the first one for several axes; default: the index of the axis in
           the machine file

    The second drive of a gantry axis gets the letter of the first: a duplicate in `coordinates`, as LinuxCNC has it.
    The directory contains `<name>.comp` with `<name>.h`, `<name>.hal`, `<name>.ini`, the axis as `<name>_plant.comp`,
    `desk.ini` and `desk.hal`, and a README.  It is written atomically.
    Raises ParameterError for a plant instead of a controller, for one axis coupled with others (its desk test simulates
    it alone), for a name or sample time that LinuxCNC does not support, a precision other than double, a wrong joint
    number, or a loop that cannot follow LinuxCNC's motion; FileError for a directory that cannot be written.
    """
    out = Path(out)
    check_directory(out)
    if design.what != CONTROL:
        raise ParameterError("linuxcnc: export the control; the axis comes with it, for the desk")
    if design.layout.precision != "double":
        raise ParameterError("LinuxCNC computes in double precision: export without single precision")
    if not design.together:
        require_alone(design, "linuxcnc, on its desk,")
    wired = joints(design, joint)
    routine, title, made_by = design.routine, design.title, design.made_by
    check_name(f"{design.name}_plant", "the name of the axis on the desk")
    system = design.system
    if isinstance(system, Machine):
        plant = layout(machine_routine(system, f"{design.name}_plant"))
        physics = f"Physics of the axes {design.axis} of '{design.machine.name}'"
    else:
        plant = layout(plant_routine(design.loop, f"{design.name}_plant"))
        physics = f"Physics of axis {design.axis} of '{design.machine.name}': {design.loop.axis.plant.kind}"
    bounds = _limits_of(design, wired)
    files = {
        f"{design.name}.comp": controller_comp(routine, title, made_by),
        f"{design.name}.h": core(design.name, texts(design.layout, title, made_by)),
        f"{design.name}.hal": axis_hal(routine, wired, title, made_by),
        f"{design.name}.ini": axis_ini(routine, wired, bounds, title, made_by),
        f"{design.name}_plant.comp": plant_comp(plant.routine, physics, made_by),
        f"{design.name}_plant.h": core(plant.routine.name, texts(plant, physics, made_by)),
        "desk.hal": desk_hal(routine, plant.routine, wired),
        "desk.ini": desk_ini(routine, wired),
        "README.md": _readme(design, plant.routine, wired, bounds),
    }
    return write_bundle(design, "linuxcnc", out, files, joint=wired[0].number)


def _readme(design: Design, plant: Routine, wired: Sequence[Joint], bounds: Mapping[str, Limits]) -> str:
    routine = design.routine
    period = servo_period(routine)
    tuned = {parameter(v, routine): v.value for v in routine.parameters}
    loops = design.system.loops().values() if design.together else [design.loop]
    return readme(
        "linuxcnc.md.j2",
        design,
        plant=plant.name,
        hal=hal(routine.name),
        joints=wired,
        holds=any(loop.control.guard is not None and loop.control.guard.holds for loop in loops),
        period=period,
        tolerance=tolerance(routine),
        late=LATE * period,
        moves=[
            (
                f"axis {joint.axis}",
                f"{1e3 * limit.velocity:.9g}",
                f"{1e3 * limit.acceleration:.9g}",
                f"{1e3 * limit.following_error:.9g}",
            )
            for joint in wired
            for limit in [bounds[joint.axis]]
        ],
        pins=dict.fromkeys(pins(routine)),
        parameters=settings(routine) | tuned,
        faults=FAULTS,
        rules={code: plain(text) for code, text in rules(routine).items()},
    )


class Joint(NamedTuple):
    """A joint of LinuxCNC: the axis that it moves, what the signals of the axis begin with, its number and letter."""

    axis: str
    port: str
    number: int
    letter: str

    @property
    def net(self) -> str:
        """What the names of the HAL signals of this axis have behind the name of the component: `-x`, or nothing."""
        return f"-{hal(self.axis)}" if self.port else ""


def joints(design: Design, first: int | None) -> tuple[Joint, ...]:
    """Return the joints of a design, numbered from `first` or as the axes of the machine file are.

    Raises ParameterError for a number that LinuxCNC does not have.
    """
    axes = list(design.machine.loops) if design.together else [design.axis]
    number = list(design.machine.loops).index(axes[0]) if first is None else first
    if not number >= 0 or number + len(axes) > len(LETTERS):
        last = len(LETTERS) - len(axes)
        raise ParameterError(f"joint = {number} must be from 0 to {last}")
    leaders = {follower: axis for coupling in design.machine.couplings for follower, axis in coupling.follows().items()}
    letters: dict[str, str] = {axis: axis.upper() for axis in axes if axis.upper() in LETTERS}
    for i, axis in enumerate(axes):
        if axis not in letters and axis not in leaders:
            free = [letter for letter in (LETTERS[number + i], *LETTERS) if letter not in letters.values()]
            letters[axis] = free[0]
    return tuple(
        Joint(axis, port, number + i, letters.get(leaders.get(axis, axis), "") or LETTERS[number + i])
        for i, (axis, port) in enumerate(zip(axes, ports(design.routine), strict=True))
    )


def _limits_of(design: Design, wired: Sequence[Joint]) -> dict[str, Limits]:
    """Return the limits of each axis; drives that share a letter move together."""
    if not design.together:
        return {design.axis: limits(design.loop)}
    found: dict[str, Limits] = {}
    for letter in dict.fromkeys(joint.letter for joint in wired):
        together = [joint.axis for joint in wired if joint.letter == letter]
        found |= dict.fromkeys(together, limits(design.system, together))
    return found


LETTERS = "XYZABCUVW"


def axis_hal(routine: Routine, wired: Sequence[Joint], title: str, made_by: str) -> str:
    """Return the HAL wiring of the controller, from the joints' commands to the forces, without the I/O card."""
    name, P = hal(routine.name), routine.name
    numbers_ = ", ".join(str(joint.number) for joint in wired)
    lines = [
        f"# {plain(title)}",
        f"# {plain(made_by)}",
        "#",
        f"# Joint{'s' * (len(wired) > 1)} {numbers_} of LinuxCNC. Load this file behind the one that loads motmod and "
        "the driver of your card.",
        f"# Once before:  sudo halcompile --install {P}.comp",
        "",
        f"loadrt {P}",
        "# Order in the thread: card read, motion-command-handler, motion-controller, this, card write.",
        f"addf {name} servo-thread",
        "",
    ]
    for i, joint in enumerate(wired):
        lines += _joint_hal(routine, joint, i)
    lines += [
        f"net {name}-ok {name}.ok",
        f"net {name}-heartbeat {name}.heartbeat",
        "# The heartbeat is for a charge pump or a watchdog.",
        f"#   net {name}-heartbeat => CARD.charge-pump",
        "",
        "# Parameters, in SI units as in the machine file; they may be changed while the axis runs.",
        *(
            line
            for v in routine.parameters
            if ".control." in v.path or not v.path.startswith("axis.")
            for item in [parameter(v, routine)]
            for line in (f"# {item.meaning}", f"#   setp {name}.{item.name} {float(v.value)!r}")
        ),
    ]
    return "\n".join(lines) + "\n"


def _joint_hal(routine: Routine, joint: Joint, index: int) -> list[str]:
    """Return the lines of the HAL wiring for one joint; `index` counts the joints of the component."""
    port, number = hal(joint.port), joint.number
    x, pins_ = f"{hal(routine.name)}{joint.net}", f"{hal(routine.name)}.{port}"
    inputs, outputs = _of(routine.inputs, joint.port), _of(routine.outputs, joint.port)
    reading = reading_pin(routine, joint.port).removeprefix(port)
    two, drive = "reading_motor" in inputs, "command" in outputs
    unit = outputs["command"].meaning.rsplit(" ", 1)[-1] if drive else "N"
    encoder = 2 * index if two else index
    said = f" Axis {joint.axis}:" if joint.port else ""
    return [
        f"#{said} commands of the planner. LinuxCNC 2.9 gives no jerk and no snap: their pins stay 0. With 2.10:",
        f"#   net {x}-jerk-cmd joint.{number}.jerk-cmd => {pins_}jerk-cmd",
        f"net {x}-position-cmd joint.{number}.motor-pos-cmd => {pins_}position-cmd",
        f"net {x}-velocity-cmd joint.{number}.vel-cmd => {pins_}velocity-cmd",
        f"net {x}-acceleration-cmd joint.{number}.acc-cmd => {pins_}acceleration-cmd",
        "",
        "# Positions of the encoders, in machine units.",
        f"net {x}-{reading} => {pins_}{reading} joint.{number}.motor-pos-fb",
        *([f"net {x}-motor-position-fb => {pins_}motor-position-fb"] if two else []),
        "",
        "# Enable and fault: a trip switches the machine off, and the next F2 clears it.",
        f"net {x}-enable joint.{number}.amp-enable-out => {pins_}enable",
        f"net {x}-fault {pins_}fault => joint.{number}.amp-fault-in",
        f"net {x}-running {pins_}running",
        "",
        "# Command to the drive.",
        f"net {x}-force-cmd {pins_}force-cmd",
        *([f"net {x}-drive-cmd {pins_}drive-cmd"] if drive else []),
        "",
        "# Your card: put its pins in and uncomment the lines. Try signs and scales with the motor uncoupled.",
        f"#   net {x}-{reading} <= CARD.encoder.{encoder}.position",
        *([f"#   net {x}-motor-position-fb <= CARD.encoder.{encoder + 1}.position"] if two else []),
        f"# The command is in {unit}.",
        f"#   net {x}-{'drive' if drive else 'force'}-cmd => CARD.analogout.{index}.value",
        f"#   net {x}-running => CARD.analogout.{index}.enable",
        "",
    ]


def axis_ini(routine: Routine, wired: Sequence[Joint], bounds: Mapping[str, Limits], title: str, made_by: str) -> str:
    """Return the .ini sections of the joints and the axes, in mm, the LINEAR_UNITS of the desk test."""
    lines = [
        f"# {plain(title)}",
        f"# {plain(made_by)}",
        "#",
        "# In your .ini these must stand as well:",
        "#   [TRAJ]   LINEAR_UNITS = mm",
        f"#   [EMCMOT] SERVO_PERIOD = {servo_period(routine)}",
        "",
    ]
    shown: set[str] = set()
    for joint in wired:
        lines += _joint_ini(joint, bounds[joint.axis], joint.letter not in shown)
        shown.add(joint.letter)
    return "\n".join(lines[:-1]) + "\n"


def _joint_ini(joint: Joint, limit: Limits, with_axis: bool) -> list[str]:
    """Return the .ini section of a joint, behind that of its axis unless an earlier joint had the same letter."""
    velocity, acceleration, error = 1e3 * limit.velocity, 1e3 * limit.acceleration, 1e3 * limit.following_error
    # inside the guard's travel: at its end the smallest overshoot would trip
    room = error if limit.travel_known else 0.0
    ends = [f"MIN_LIMIT = {1e3 * limit.least + room:.9g}", f"MAX_LIMIT = {1e3 * limit.most - room:.9g}"]
    moves = [f"MAX_VELOCITY = {velocity:.9g}", f"MAX_ACCELERATION = {acceleration:.9g}"]
    axis = [f"[AXIS_{joint.letter}]", *moves, *ends, ""]
    return [
        *_unknown(limit),
        *(axis if with_axis else [f"# A second drive of axis {joint.letter}."]),
        f"[JOINT_{joint.number}]",
        "TYPE = LINEAR",
        *moves,
        *ends,
        f"# In a simulated move within these limits the following error was at most {1e3 * limit.peak_error:.3g} mm,",
        f"# the force {limit.peak_force:.3g} N. MIN_FERROR is as large: the error of a servo loop outlasts the motion.",
        f"FERROR = {error:.9g}",
        f"MIN_FERROR = {error:.9g}",
        "# Homing at the present position; enter your switch or index.",
        "HOME_SEARCH_VEL = 0",
        "HOME_LATCH_VEL = 0",
        "HOME_SEQUENCE = 0",
        "",
    ]


def _unknown(limit: Limits) -> list[str]:
    """Return comment lines that warn that the travel limits are placeholders; none if the travel is known."""
    if limit.travel_known:
        return []
    return [
        "# THE TRAVEL IS NOT KNOWN: the machine file has no travel_least and travel_most in its guard.",
        "# MIN_LIMIT and MAX_LIMIT are placeholders; enter yours before the axis moves.",
    ]


def desk_hal(routine: Routine, plant: Routine, wired: Sequence[Joint]) -> str:
    """Return the HAL file of a desk test: planner, controller, and the simulated axes in place of an I/O card."""
    p, name = hal(plant.name), hal(routine.name)
    lines = [
        "# The axis on the desk: its physics in place of drive, motor and encoders. Nothing moves.",
        "loadrt [KINS]KINEMATICS",
        "loadrt [EMCMOT]EMCMOT servo_period_nsec=[EMCMOT]SERVO_PERIOD num_joints=[KINS]JOINTS",
        f"loadrt {plant.name}",
        "",
        f"addf {p}.read servo-thread",
        "addf motion-command-handler servo-thread",
        "addf motion-controller servo-thread",
        f"source {routine.name}.hal",
        f"addf {p}.write servo-thread",
        "",
    ]
    for joint in wired:
        x, port = f"{name}{joint.net}", hal(joint.port)
        own = [input_pin(v.path).removeprefix(port) for v in _of(routine.inputs, joint.port).values()]
        readings = [r for r in ("motor-position-fb", "load-position-fb", "position-fb") if r in own]
        lines += [
            *(f"net {x}-{r} <= {p}.{port}{'load-position-fb' if r == 'position-fb' else r}" for r in readings),
            f"net {x}-force-cmd => {p}.{port}force",
        ]
    lines += [
        "",
        "# A desk has no real-time kernel: a late call is no fault here. On a machine it is.",
        f"setp {name}.late-limit 0",
        "",
        *(f"net joint-{i}-loop joint.{i}.motor-pos-cmd => joint.{i}.motor-pos-fb" for i in range(wired[0].number)),
        "net estop-loop iocontrol.0.user-enable-out iocontrol.0.emc-enable-in",
        "net tool-prepared iocontrol.0.tool-prepare iocontrol.0.tool-prepared",
        "net tool-changed iocontrol.0.tool-change iocontrol.0.tool-changed",
    ]
    return "\n".join(lines) + "\n"


def desk_ini(routine: Routine, wired: Sequence[Joint]) -> str:
    """Return the LinuxCNC configuration `desk.ini` with these axes; joints with lower numbers echo their commands."""
    own = [joint.letter for joint in wired]
    others = [letter for letter in LETTERS if letter not in own][: wired[0].number]
    ideal = "".join(_IDEAL.format(letter=other, joint=i) for i, other in enumerate(others))
    coordinates = "".join([*others, *own])
    # two joints of one letter move alone before they are homed, and together afterwards
    kins = f"{coordinates} kinstype=BOTH" if len(set(own)) < len(own) else coordinates
    return filled(
        "desk.ini",
        name=routine.name,
        period=servo_period(routine),
        kins=kins,
        coordinates=coordinates,
        joints=len(coordinates),
        ideal=ideal,
    )


_IDEAL = """
[AXIS_{letter}]
MAX_VELOCITY = 500
MAX_ACCELERATION = 2500

[JOINT_{joint}]
TYPE = LINEAR
MAX_VELOCITY = 500
MAX_ACCELERATION = 2500
HOME_SEARCH_VEL = 0
HOME_LATCH_VEL = 0
HOME_SEQUENCE = 0
"""


_VELOCITIES = (0.5, 0.25, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)  # m/s, tested in this order
_RAMP = 0.2  # s from rest to the velocity, and at constant velocity
_SHARE = 0.7  # fraction of the limits of force, following error and speed that a move may use
_MARGIN = 2.0  # factor between the following error of the move and FERROR


@dataclass(frozen=True)
class Limits:
    """The limits of an axis in LinuxCNC: velocity (m/s), acceleration (m/s2), following error (m), travel ends (m).

    `peak_error` (m) and `peak_force` (N) are those of the simulated test move; `travel_known` is true if the travel
    ends are those of the guard, not placeholders.
    """

    velocity: float
    acceleration: float
    following_error: float
    least: float
    most: float
    peak_error: float
    peak_force: float
    travel_known: bool


def limits(system: System, moving: Sequence[str] = ()) -> Limits:
    """Return the limits for LinuxCNC, from the fastest test move that uses at most 70 % of controller and motor limits.

    Of a machine the axes `moving` make the move, in its coupled simulation, and the others stand in the middle of their
    travel.  The move has the trapezoidal velocity profile of LinuxCNC.  Its following error is computed as in LinuxCNC,
    from the reading one period later.  Raises ParameterError if even the slowest move exceeds 70 % of a limit.
    """
    loops = system.loops()
    ends = [_travel(loop) for name, loop in loops.items() if not moving or name in moving]
    least, most = max(end for end, _ in ends), min(end for _, end in ends)
    tried = None
    for velocity in _VELOCITIES:
        tried = _tried(system, moving, velocity, least, most)
        if tried is not None:
            break
    if tried is None:
        raise ParameterError(
            f"{f'axis {moving[0]}' if moving else 'the axis'} cannot be moved at "
            f"{Quantity(_VELOCITIES[-1], 'm/s'):6 SI} within 70 % of its limits of force, "
            "following error and speed: LinuxCNC would switch it off at once; look at the simulation of this loop "
            "first"
        )
    return tried


def _travel(loop: Loop) -> tuple[float, float]:
    """Return the ends of the travel in m, from the guard; an end that it does not state is set for a travel of 1 m."""
    guard = loop.control.guard
    least, most = (None, None) if guard is None else (guard.travel_least, guard.travel_most)
    if least is not None and most is not None:
        return least, most
    if least is not None:
        return least, least + 1.0
    if most is not None:
        return most - 1.0, most
    return -0.5, 0.5


def _tried(system: System, moving: Sequence[str], velocity: float, least: float, most: float) -> Limits | None:
    """Simulate a move and return the resulting limits; None if the move exceeds 70 % of a limit or the travel."""
    acceleration = velocity / _RAMP
    distance = 2.0 * _RAMP * velocity
    if distance > most - least:
        return None
    middle = 0.5 * (least + most)
    move = TrapezoidalMove(
        distance=distance, start=middle - 0.5 * distance, velocity=velocity, acceleration=acceleration, dwell_after=0.1
    )
    signals = ("set_position", "reading_load", "requested", "force", "trip", "velocity_load")
    loops = dict(zip(system.ports(), system.loops().values(), strict=True))
    references = {
        port: move if not moving or port.removesuffix(".") in moving else _standing(loop)
        for port, loop in loops.items()
    }
    reference = {port.removesuffix("."): each for port, each in references.items()} if moving else move
    try:
        run = simulate(system, reference, record=[f"{port}{signal}" for port in loops for signal in signals])
    except DivergedError:
        return None
    peaks: list[tuple[float, float]] = []
    for port, loop in loops.items():
        found = {signal: np.asarray(run[f"{port}{signal}"]) for signal in signals}
        error = float(np.max(np.abs(found["set_position"][:-1] - found["reading_load"][1:])))
        # the force before the limit: after it a saturated move would look like one within the limit
        force = float(np.max(np.abs(found["requested"])))
        speed = float(np.max(np.abs(found["velocity_load"])))
        guard, motor = loop.control.guard, loop.axis.actuator.motor
        forces = [loop.control.force_limit, None if motor is None else motor.limits()[0]]
        bounds = [(force, limit) for limit in forces]
        bounds.append((speed, None if motor is None else motor.velocity_limit()))
        if guard is not None:
            bounds += [(error, guard.following_error_limit), (speed, guard.velocity_limit)]
        exceeded = any(bound is not None and value > _SHARE * bound for value, bound in bounds)
        if np.any(found["trip"] > 0.0) or exceeded:
            return None
        if references[port] is move:
            peaks.append((error, force))
    guards = [loop.control.guard for port, loop in loops.items() if references[port] is move]
    known = all(g is not None and g.travel_least is not None and g.travel_most is not None for g in guards)
    error, force = (max(column) for column in zip(*peaks, strict=True))
    return Limits(velocity, acceleration, _rounded_up(_MARGIN * error), least, most, error, force, known)


def _standing(loop: Loop) -> Recorded:
    """Return a reference that stands in the middle of the travel of a loop while another axis moves."""
    least, most = _travel(loop)
    return Recorded(position=np.full(2, 0.5 * (least + most)), sample_time=float(loop.sample_time))


def _rounded_up(value: float) -> float:
    """Round a length in m up to 1, 2 or 5 times a power of ten, at least 10 um."""
    value = max(value, 1e-5)
    power = 10.0 ** math.floor(math.log10(value))
    # 1e-9: a round number must not become the next one by its rounding
    return next(round(step * power, 9) for step in (1.0, 2.0, 5.0, 10.0) if step * power >= value * (1.0 - 1e-9))

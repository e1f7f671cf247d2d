"""The .comp files of a controller and of a simulated axis: HAL names, declarations, and the C text behind them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from string import Template
from typing import NamedTuple

from feeddrive.export.c.text import Texts, header_only
from feeddrive.export.identifiers import HAL_LENGTH
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.language.quantity import Quantity
from feeddrive.loop.guard import TRIPS
from feeddrive.loop.routine import Routine, Variable

FAULT_PERIOD, FAULT_LATE, FAULT_PARAMETER = 11, 12, 13  # beside the trip codes of the guard
FAULTS = {int(code): word for code, word in TRIPS.items()} | {
    FAULT_PERIOD: "a thread with another period than the sample time",
    FAULT_LATE: "a call that came too late",
    FAULT_PARAMETER: "parameters that break a rule when enable is set",
}
LATE = 10  # periods, the longest time from call to call
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


def input_pin(name: str) -> str:
    """The pin of an input of the routine."""
    return "enable" if name == "enable" else _INPUTS[name][0]


def reading(routine: Routine) -> str:
    """The pin of the position that is controlled."""
    return _INPUTS["reading_load" if any(v.name == "reading_load" for v in routine.inputs) else "reading"][0]


def pins(routine: Routine) -> list[Item]:
    """All pins."""
    codes = "; ".join(f"{code} {word}" for code, word in FAULTS.items())
    outputs = {v.name: v for v in routine.outputs}
    found = [
        pin(_INPUTS[v.name][0], "float", "in", f"{_INPUTS[v.name][1]}, {_UNITS[v.unit]} (units-per-m)")
        for v in routine.inputs
        if v.name in _INPUTS
    ]
    found += [
        pin("enable", "bit", "in", "the loop runs while it is on; a rising edge starts anew and clears a fault"),
        pin("reset", "bit", "in", "a rising edge clears a fault while enable is off"),
        pin("hold-parameters", "bit", "in", "while on, changed parameters wait; they act together when it goes off"),
        pin("force-cmd", "float", "out", f"{outputs['force'].meaning}, N"),
    ]
    if "command" in outputs:
        found.append(pin("drive-cmd", "float", "out", outputs["command"].meaning))
    return [
        *found,
        pin("running", "bit", "out", "on while the loop runs: enabled, without trip or fault"),
        pin("trip-code", "s32", "out", "trip of the guard now, 0 none; it ends when enable goes off"),
        pin("fault", "bit", "out", "on from a trip or fault until the next rising edge of enable or reset"),
        pin("fault-code", "s32", "out", f"why: 0 none; {codes}"),
        pin("ok", "bit", "out", "the opposite of fault, for an emergency stop chain"),
        pin("heartbeat", "bit", "out", "changes at every call while there is no fault: for a watchdog or charge pump"),
        pin("parameter-bad", "bit", "out", "the parameters break a rule: no change acts until they are corrected"),
        pin("parameter-rule", "s32", "out", "code of the broken rule, 0 none; the README explains it"),
        pin("retunes", "u32", "out", "number of parameter changes that have acted"),
    ]


def settings(routine: Routine) -> dict[Item, float]:
    """Parameters of the component itself, and their values."""
    T = period(routine)
    return {
        Item("units-per-m", "float", "rw", "length units of the machine in a metre: 1000 for mm, "
             "39.37007874015748 for inch; read at the first call"): 1000.0,
        Item("period-tolerance", "u32", "rw", f"largest deviation of the period of the thread from {T} ns, in ns"):
             tolerance(routine),
        Item("late-limit", "u32", "rw", "longest time from call to call, ns; 0: not watched"): LATE * T,
    }  # fmt: skip


def tolerance(routine: Routine) -> int:
    """By how much the period of the thread may differ from the sample time, ns."""
    return max(period(routine) // 1000, 1)


def controller_comp(routine: Routine, title: str, made_by: str) -> str:
    """The text of the .comp file, which includes P.h.

    Raises ParameterError and StructureError for names and sample times that LinuxCNC cannot have.
    """
    items, own = pins(routine), settings(routine)
    tuned = {parameter(v): v for v in routine.parameters}
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
            period=period(routine),
            wanted=numbers([item.c for item in tuned]),
            inputs=numbers([_given(v.name) for v in routine.inputs]),
            drive=where(any(v.name == "command" for v in routine.outputs), "    drive_cmd = result.command;\n"),
            period_fault=FAULT_PERIOD,
            late_fault=FAULT_LATE,
            parameter_fault=FAULT_PARAMETER,
        ),
    )


def _given(name: str) -> str:
    """A C expression for an input of the law."""
    return "on ? 1.0 : 0.0" if name == "enable" else f"{pin(_INPUTS[name][0], '', '', '').c} / scale"


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
    """The text of the .comp file, which includes P.h; `read` and `write` replace those of a card.

    Raises ParameterError and StructureError for names and sample times that LinuxCNC cannot have.
    """
    T = period(routine)
    pins = [
        pin(*_PLANT_INPUTS[v.name][:1], "float", "in", _PLANT_INPUTS[v.name][1])
        for v in routine.inputs
        if v.name in _PLANT_INPUTS
    ]
    pins += [pin(_OUTPUTS[v.name][0], "float", "out", _OUTPUTS[v.name][1]) for v in routine.outputs]
    own = {
        Item("units-per-m", "float", "rw", "length units of the machine in a metre; read at the first call"): 1000.0,
        Item("start-position", "float", "rw", "where the axis stands at first, mm; read at the first call"): 0.0,
    }
    physics = {parameter(v): v.value for v in routine.parameters}
    check_component(routine.name, FUNCTIONS, [*pins, *own, *physics])
    given = {name: pin(place, "", "", "").c for name, (place, _) in _PLANT_INPUTS.items()}
    given["start_position"] = "start_position / scale"
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
            inputs=numbers([given[v.name] for v in routine.inputs]),
            outputs="\n".join(
                f"    {pin(_OUTPUTS[v.name][0], '', '', '').c} = now.{v.name} * scale;" for v in routine.outputs
            ),
        ),
    )


def text(name: str) -> str:
    """One of the files in `texts/`."""
    return (Path(__file__).parent / "texts" / name).read_text(encoding="utf-8")


def filled(name: str, /, **values: object) -> str:
    """One of the texts, with the values in their places."""
    return Template(text(name)).substitute({key: str(value) for key, value in values.items()})


# Components of LinuxCNC 2.9: one of the same name would take their place on the user's machine, or not load.
STOCK = frozenset(text("stock.txt").split())
FASTEST, SLOWEST = 10_000, 100_000_000  # ns; shortest period of a PC at best, and a period slower than any servo loop
MEASURED = ("time", "tmax", "tmax-increased")  # pins that HAL adds to every function


class Item(NamedTuple):
    """A pin or a parameter that the .comp file declares."""

    name: str
    type: str  # "float", "bit", "s32" or "u32"
    direction: str  # "in", "out" or "rw"
    meaning: str  # plain ASCII, with the unit

    @property
    def c(self) -> str:
        """The name by which halcompile lets C text read and write it."""
        return re.sub("_+", "_", re.sub("[-.]", "_", self.name))


def pin(name: str, kind: str, direction: str, meaning: str) -> Item:
    """A pin."""
    return Item(name, kind, direction, plain(meaning))


def parameter(variable: Variable) -> Item:
    """The HAL parameter of a routine's parameter: `axis.x.control.law.Kv` is `law.Kv` of the component `axis-x`."""
    name = re.sub(r"^axis\.[^.]+\.(control\.|actuator\.(?=motor\.))?", "", variable.path).replace("_", "-")
    return Item(name, "float", "rw", plain(f"{variable.meaning}, {variable.unit or 'no unit'}"))


def hal(name: str) -> str:
    """`axis_x` is written `axis-x` in HAL."""
    return name.replace("_", "-")


def check_component(name: str, functions: Sequence[str], items: Iterable[Item]) -> None:
    """Raise ParameterError for a name that is LinuxCNC's own or too long, StructureError for two that are the same."""
    if name in STOCK:
        raise ParameterError(
            f"the name '{name}' is that of a component of LinuxCNC, which the installed one would replace; "
            f"take another, such as axis_{name}"
        )
    seen: dict[str, str] = {}
    measured = [".".join((*filter(None, (each,)), last)) for each in functions for last in MEASURED]
    for each in (*(item.name for item in items), *measured):
        whole = f"{hal(name)}.{each}"
        if len(whole) > HAL_LENGTH:
            raise ParameterError(
                f"'{whole}' has {len(whole)} characters, {len(whole) - HAL_LENGTH} more than the {HAL_LENGTH} of a "
                f"name in LinuxCNC's HAL; take a shorter name than '{name}'"
            )
        key = re.sub("[-._]+", "_", each)
        if key in seen:
            raise StructureError(f"'{hal(name)}.{seen[key]}' and '{whole}' are one name in LinuxCNC's HAL")
        seen[key] = each


def plain(words: str) -> str:
    """Text that halcompile and its manual pages take: ASCII, without quotes and backslashes."""
    words = words.replace("²", "2").replace("³", "3").replace("µ", "u").replace("·", " ").replace("−", "-")
    words = words.replace('"', "'").replace("\\", "/").replace("\n", " ")
    return words.encode("ascii", "replace").decode()


def period(routine: Routine) -> int:
    """The sample time in ns. Raises ParameterError for one that no servo thread of LinuxCNC can have."""
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


# LinuxCNC's flags do not forbid a fused multiply-add, which processors other than x86 would take.
_EXACT = '#pragma GCC optimize("fp-contract=off")\n\n'
_AS_IT_STANDS = """\
#pragma GCC push_options
#pragma GCC optimize("O0")
#pragma GCC diagnostic ignored "-Wframe-larger-than="
"""


def core(name: str, parts: Texts) -> str:
    """The header that a component includes: the complete routine.

    Code that runs once or at a change of parameters may have thousands of lines: it is compiled without optimization,
    in a tenth of the time.
    """
    once = re.compile(
        rf"^static (?:inline bool {name}_retune|int {name}_designed)\([^;{{]*\)\n\{{.*?^\}}\n", re.DOTALL | re.MULTILINE
    )
    whole = header_only(name, parts)
    return _EXACT + once.sub(lambda found: f"{_AS_IT_STANDS}{found[0]}#pragma GCC pop_options\n", whole)


def component_text(
    name: str,
    description: str,
    pins: Iterable[Item],
    parameters: Mapping[Item, float],
    functions: Sequence[str],
    body: str,
) -> str:
    """The text of a .comp file that includes `name`.h, for `halcompile --install`."""
    lines = [f'component {name} "{plain(description)}";', ""]
    lines += [f'pin {each.direction} {_TYPES[each.type]} {each.name} "{each.meaning}";' for each in pins]
    lines.append("")
    lines += [
        f'param rw {_TYPES[each.type]} {each.name} = {_number(each, value)} "{each.meaning}";'
        for each, value in parameters.items()
    ]
    lines.append("")
    lines += [f"function {each} fp;" for each in functions]
    lines += ["option singleton yes;", f'include "{name}.h";', 'license "MIT";', 'author "feeddrive";', "", ";;"]
    return "\n".join(lines) + f"\n{body}"


_TYPES = {"float": "float", "bit": "bit", "s32": "signed", "u32": "unsigned"}


def _number(item: Item, value: float) -> str:
    """A default as halcompile reads it: without the `+` of an exponent."""
    return repr(float(value)).replace("e+", "e") if item.type == "float" else str(int(value))


def numbers(texts: Iterable[str]) -> str:
    """A C initialiser, broken into lines."""
    lines = [""]
    for each in texts:
        if len(lines[-1]) + len(each) > 90:
            lines.append("")
        lines[-1] += f" {each},"
    return "\n        ".join(line.strip() for line in lines).rstrip(",")


def where(wanted: bool, text: str) -> str:
    """The text if it is wanted, else an empty one."""
    return text if wanted else ""

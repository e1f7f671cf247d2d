"""The .comp file of a controller: pins, parameters, watchdog and faults around the C text of the law."""

from __future__ import annotations

from feeddrive.export.linuxcnc import component
from feeddrive.export.linuxcnc.component import Item, component_text, hal, numbers, pin, where
from feeddrive.export.linuxcnc.texts import filled
from feeddrive.loop.guard import TRIPS
from feeddrive.loop.routine import Routine

FAULT_PERIOD, FAULT_LATE, FAULT_PARAMETER = 11, 12, 13  # beside the trip codes of the guard
FAULTS = {int(code): word for code, word in TRIPS.items()} | {
    FAULT_PERIOD: "a thread with another period than the sample time",
    FAULT_LATE: "a call that came too late",
    FAULT_PARAMETER: "parameters that broke a rule when enable came",
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
        pin("running", "bit", "out", "on while the loop really runs: enabled, without trip or fault"),
        pin("trip-code", "s32", "out", "trip of the guard now, 0 none; it ends when enable goes off"),
        pin("fault", "bit", "out", "on from a trip or fault until the next rising edge of enable or reset"),
        pin("fault-code", "s32", "out", f"why: 0 none; {codes}"),
        pin("ok", "bit", "out", "the opposite of fault, for a chain of what must be well"),
        pin("heartbeat", "bit", "out", "changes at every call while there is no fault: for a watchdog or charge pump"),
        pin("parameter-bad", "bit", "out", "the parameters break a rule: no change acts until they are mended"),
        pin("parameter-rule", "s32", "out", "code of the rule that they break, 0 none; the README has its sentence"),
        pin("retunes", "u32", "out", "how many changes of parameters have acted"),
    ]


def settings(routine: Routine) -> dict[Item, float]:
    """Parameters of the component itself, and their values."""
    T = component.period(routine)
    return {
        Item("units-per-m", "float", "rw", "length units of the machine in a metre: 1000 for mm, "
             "39.37007874015748 for inch; read at the first call"): 1000.0,
        Item("period-tolerance", "u32", "rw", f"by how much the period of the thread may differ from {T} ns, ns"):
             tolerance(routine),
        Item("late-limit", "u32", "rw", "longest time from call to call, ns; 0: not watched"): LATE * T,
    }  # fmt: skip


def tolerance(routine: Routine) -> int:
    """By how much the period of the thread may differ from the sample time, ns."""
    return max(component.period(routine) // 1000, 1)


def controller_comp(routine: Routine, title: str, made_by: str) -> str:
    """The text of the .comp file, which includes P.h.

    Raises ParameterError and StructureError for names and sample times that LinuxCNC cannot have.
    """
    items, own = pins(routine), settings(routine)
    tuned = {component.parameter(v): v for v in routine.parameters}
    component.check_component(routine.name, ("",), [*items, *own, *tuned])
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
            period=component.period(routine),
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

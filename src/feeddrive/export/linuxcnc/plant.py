"""The .comp file of a simulated axis, which replaces drive, motor and encoders for tests without a machine."""

from __future__ import annotations

from feeddrive.export.linuxcnc import component
from feeddrive.export.linuxcnc.component import Item, component_text, numbers, pin
from feeddrive.export.linuxcnc.texts import filled
from feeddrive.loop.routine import Routine

FUNCTIONS = ("read", "write")
_OUTPUTS = {
    "reading_motor": ("motor-position-fb", "position that the motor's encoder reads, as travel of the table, mm", True),
    "reading_load": ("load-position-fb", "position that the encoder at the table reads, mm", True),
    "position_motor": ("motor-position", "true position of the motor's body, mm", True),
    "position_load": ("load-position", "true position of the table, mm", True),
    "velocity_motor": ("motor-velocity", "true velocity of the motor's body, mm/s", True),
    "velocity_load": ("load-velocity", "true velocity of the table, mm/s", True),
}
_INPUTS = {
    "force": ("force", "force of the drive at the table, N: force-cmd of the controller"),
    "load_force": ("load-force", "force of the process on the table, N"),
}


def plant_comp(routine: Routine, title: str, made_by: str) -> str:
    """The text of the .comp file, which includes P.h; the functions `read` and `write` are those of a drive's card.

    Raises ParameterError and StructureError for names and sample times that LinuxCNC cannot have.
    """
    T = component.period(routine)
    pins = [pin(*_INPUTS[v.name][:1], "float", "in", _INPUTS[v.name][1]) for v in routine.inputs if v.name in _INPUTS]
    pins += [pin(_OUTPUTS[v.name][0], "float", "out", _OUTPUTS[v.name][1]) for v in routine.outputs]
    own = {
        Item("units-per-m", "float", "rw", "length units of the machine in a metre; read at the first call"): 1000.0,
        Item("start-position", "float", "rw", "where the axis stands at first, mm; read at the first call"): 0.0,
    }
    physics = {component.parameter(v): v.value for v in routine.parameters}
    component.check_component(routine.name, FUNCTIONS, [*pins, *own, *physics])
    given = {name: pin(place, "", "", "").c for name, (place, _) in _INPUTS.items()}
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

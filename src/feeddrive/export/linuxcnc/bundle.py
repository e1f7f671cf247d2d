"""The target `linuxcnc`: a directory with components, wiring, a simulated axis, and a README."""

from __future__ import annotations

from pathlib import Path

from feeddrive.export.c.text import texts
from feeddrive.export.design import CONTROL, MACHINE_FILE, Design, require_alone
from feeddrive.export.identifiers import check_name
from feeddrive.export.layout import layout
from feeddrive.export.linuxcnc import component, controller
from feeddrive.export.linuxcnc.component import core, hal
from feeddrive.export.linuxcnc.controller import controller_comp
from feeddrive.export.linuxcnc.limits import Limits, limits
from feeddrive.export.linuxcnc.plant import plant_comp
from feeddrive.export.linuxcnc.wiring import LETTERS, axis_hal, axis_ini, desk_hal, desk_ini
from feeddrive.export.manifest import FILE, manifest_text
from feeddrive.export.readme import readme
from feeddrive.files.atomic_io import check_directory, new_directory
from feeddrive.language.errors import ParameterError
from feeddrive.loop.routine import Routine
from feeddrive.loop.routine_trace import plant_routine


def write_linuxcnc(design: Design, out: str | Path, *, joint: int | None = None) -> Path:
    """The control of a design as a component of LinuxCNC, with all that is needed to run it.

    joint  number of the joint in LinuxCNC; absent: the place of the axis in the machine file

    The directory holds `<name>.comp` with `<name>.h`, `<name>.hal`, `<name>.ini`, the axis as `<name>_plant.comp`,
    `desk.ini` and `desk.hal`, and a README, which is returned.  It is written whole or not at all.
    Raises ParameterError for an axis instead of a control, for one that is coupled with others (the desk holds one
    alone), for a name or a sample time that LinuxCNC cannot have, a precision other than double, a joint that is none,
    or a loop that cannot follow LinuxCNC's motion; FileError for a directory that cannot be written.
    """
    out = Path(out)
    check_directory(out)
    if design.what != CONTROL:
        raise ParameterError("linuxcnc: export the control; the axis comes with it, for the desk")
    if design.layout.precision != "double":
        raise ParameterError("LinuxCNC computes in double precision: export without single precision")
    require_alone(design, "linuxcnc, on its desk,")
    place = list(design.machine.loops).index(design.axis)
    number = place if joint is None else joint
    if not 0 <= number < len(LETTERS):
        raise ParameterError(f"joint = {number} must be from 0 to {len(LETTERS) - 1}")
    letter = design.axis.upper() if design.axis.upper() in LETTERS else LETTERS[number]
    routine, title, made_by = design.routine, design.title, design.made_by
    check_name(f"{design.name}_plant", "the name of the axis on the desk")
    plant = layout(plant_routine(design.loop, f"{design.name}_plant"))
    physics = f"Physics of axis {design.axis} of '{design.machine.name}': {design.loop.axis.plant.kind}"
    limit = limits(design.loop)
    files = {
        f"{design.name}.comp": controller_comp(routine, title, made_by),
        f"{design.name}.h": core(design.name, texts(design.layout, title, made_by)),
        f"{design.name}.hal": axis_hal(routine, number, title, made_by),
        f"{design.name}.ini": axis_ini(routine, number, letter, limit, title, made_by),
        f"{design.name}_plant.comp": plant_comp(plant.routine, physics, made_by),
        f"{design.name}_plant.h": core(plant.routine.name, texts(plant, physics, made_by)),
        "desk.hal": desk_hal(routine, plant.routine, number),
        "desk.ini": desk_ini(routine, number, letter),
        "README.md": _readme(design, plant.routine, number, limit),
    }
    files[MACHINE_FILE] = design.machine.file.text
    files[FILE] = manifest_text(design, "linuxcnc", files, joint=number)
    with new_directory(out) as folder:
        for name, text in files.items():
            (folder / name).write_text(text, encoding="utf-8")
    return out / "README.md"


def _readme(design: Design, plant: Routine, joint: int, limit: Limits) -> str:
    routine = design.routine
    period = component.period(routine)
    tuned = {component.parameter(v): v.value for v in routine.parameters}
    return readme(
        "linuxcnc.md.j2", design, plant=plant.name, hal=hal(routine.name), joint=joint,
        period=period, tolerance=controller.tolerance(routine), late=controller.LATE * period,
        velocity=f"{1e3 * limit.velocity:.9g}", acceleration=f"{1e3 * limit.acceleration:.9g}",
        ferror=f"{1e3 * limit.following_error:.9g}", pins=dict.fromkeys(controller.pins(routine)),
        parameters=controller.settings(routine) | tuned, faults=controller.FAULTS,
        rules={code: component.plain(text) for code, text in routine.sentences.items()},
    )  # fmt: skip

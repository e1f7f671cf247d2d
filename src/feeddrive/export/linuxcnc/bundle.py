"""The target `linuxcnc`: components, wiring, limits of the axis checked in a simulation, and a README."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from feeddrive.blocks.reference.trapezoidal_move import TrapezoidalMove
from feeddrive.export.c.arithmetic import rules
from feeddrive.export.c.text import texts
from feeddrive.export.design import CONTROL, Design, require_alone
from feeddrive.export.identifiers import check_name
from feeddrive.export.layout import layout
from feeddrive.export.linuxcnc import component
from feeddrive.export.linuxcnc.component import controller_comp, core, filled, hal, plant_comp
from feeddrive.export.manifest import readme, write_bundle
from feeddrive.files.atomic_io import check_directory
from feeddrive.language.errors import DivergedError, ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.loop.loop import Loop
from feeddrive.loop.routine import Routine
from feeddrive.loop.routine_trace import plant_routine
from feeddrive.loop.simulate import simulate


def write_linuxcnc(design: Design, out: str | Path, *, joint: int | None = None) -> Path:
    """The control of a design as a component of LinuxCNC, with all that is needed to run it.

    joint  number of the joint in LinuxCNC; absent: the place of the axis in the machine file

    The directory holds `<name>.comp` with `<name>.h`, `<name>.hal`, `<name>.ini`, the axis as `<name>_plant.comp`,
    `desk.ini` and `desk.hal`, and a README, which is returned. It is written completely or not at all.
    Raises ParameterError for an axis instead of a control, for one that is coupled with others (the desk holds one
    alone), for a name or a sample time that LinuxCNC cannot have, a precision other than double, a wrong joint number,
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
    return write_bundle(design, "linuxcnc", out, files, joint=number)


def _readme(design: Design, plant: Routine, joint: int, limit: Limits) -> str:
    routine = design.routine
    period = component.period(routine)
    tuned = {component.parameter(v): v.value for v in routine.parameters}
    return readme(
        "linuxcnc.md.j2", design, plant=plant.name, hal=hal(routine.name), joint=joint,
        period=period, tolerance=component.tolerance(routine), late=component.LATE * period,
        velocity=f"{1e3 * limit.velocity:.9g}", acceleration=f"{1e3 * limit.acceleration:.9g}",
        ferror=f"{1e3 * limit.following_error:.9g}", pins=dict.fromkeys(component.pins(routine)),
        parameters=component.settings(routine) | tuned, faults=component.FAULTS,
        rules={code: component.plain(text) for code, text in rules(routine).items()},
    )  # fmt: skip


LETTERS = "XYZABCUVW"


def axis_hal(routine: Routine, joint: int, title: str, made_by: str) -> str:
    """Wiring of the controller: from the joint's commands to the force, without the lines of the I/O card."""
    name, P = hal(routine.name), routine.name
    x = _prefix(routine)
    reading = component.reading(routine)
    two = any(v.name == "reading_motor" for v in routine.inputs)
    drive = any(v.name == "command" for v in routine.outputs)
    unit = next((v.meaning.rsplit(" ", 1)[-1] for v in routine.outputs if v.name == "command"), "")
    lines = [
        f"# {component.plain(title)}", f"# {component.plain(made_by)}", "#",
        f"# Joint {joint} of LinuxCNC. Load this file behind the one that loads motmod and the driver of your card.",
        f"# Once before:  sudo halcompile --install {P}.comp", "",
        f"loadrt {P}",
        "# Order in the thread: card read, motion-command-handler, motion-controller, this, card write.",
        f"addf {name} servo-thread", "",
        "# Commands of the planner. LinuxCNC 2.9 gives no jerk and no snap: their pins stay 0. With LinuxCNC 2.10:",
        f"#   net {x}-jerk-cmd joint.{joint}.jerk-cmd => {name}.jerk-cmd",
        f"net {x}-position-cmd joint.{joint}.motor-pos-cmd => {name}.position-cmd",
        f"net {x}-velocity-cmd joint.{joint}.vel-cmd => {name}.velocity-cmd",
        f"net {x}-acceleration-cmd joint.{joint}.acc-cmd => {name}.acceleration-cmd", "",
        "# Positions of the encoders, in machine units.",
        f"net {x}-{reading} => {name}.{reading} joint.{joint}.motor-pos-fb",
        *([f"net {x}-motor-position-fb => {name}.motor-position-fb"] if two else []), "",
        "# Enable and fault: a trip switches the machine off, and the next F2 clears it.",
        f"net {x}-enable joint.{joint}.amp-enable-out => {name}.enable",
        f"net {x}-fault {name}.fault => joint.{joint}.amp-fault-in",
        f"net {x}-ok {name}.ok",
        f"net {x}-heartbeat {name}.heartbeat",
        f"net {x}-running {name}.running", "",
        "# Command to the drive.",
        f"net {x}-force-cmd {name}.force-cmd",
        *([f"net {x}-drive-cmd {name}.drive-cmd"] if drive else []), "",
        "# Your card: put its pins in and uncomment the lines. Try signs and scales with the motor uncoupled.",
        f"#   net {x}-{reading} <= CARD.encoder.0.position",
        *([f"#   net {x}-motor-position-fb <= CARD.encoder.1.position"] if two else []),
        f"# The command is in {unit or 'N'}; the heartbeat is for a charge pump or a watchdog.",
        f"#   net {x}-{'drive' if drive else 'force'}-cmd => CARD.analogout.0.value",
        f"#   net {x}-running => CARD.analogout.0.enable",
        f"#   net {x}-heartbeat => CARD.charge-pump", "",
        "# Parameters, in SI units as in the machine file; they may be changed while the axis runs.",
        *(line for v in routine.parameters if ".control." in v.path for item in [component.parameter(v)]
          for line in (f"# {item.meaning}", f"#   setp {name}.{item.name} {float(v.value)!r}")),
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def axis_ini(routine: Routine, joint: int, letter: str, limit: Limits, title: str, made_by: str) -> str:
    """Sections of the joint and of the axis; in mm, as LINEAR_UNITS of the desk."""
    velocity, acceleration, error = 1e3 * limit.velocity, 1e3 * limit.acceleration, 1e3 * limit.following_error
    # inside the guard's travel: at its very end the smallest overshoot would trip
    room = error if limit.travel_known else 0.0
    ends = [f"MIN_LIMIT = {1e3 * limit.least + room:.9g}", f"MAX_LIMIT = {1e3 * limit.most - room:.9g}"]
    moves = [f"MAX_VELOCITY = {velocity:.9g}", f"MAX_ACCELERATION = {acceleration:.9g}"]
    lines = [
        f"# {component.plain(title)}", f"# {component.plain(made_by)}", "#",
        "# In your .ini these must stand as well:",
        "#   [TRAJ]   LINEAR_UNITS = mm",
        f"#   [EMCMOT] SERVO_PERIOD = {component.period(routine)}", "",
        *_unknown(limit), f"[AXIS_{letter}]", *moves, *ends, "",
        f"[JOINT_{joint}]", "TYPE = LINEAR", *moves, *ends,
        f"# In a simulated move within these limits the following error was at most {1e3 * limit.peak_error:.3g} mm,",
        f"# the force {limit.peak_force:.3g} N. MIN_FERROR is as large: the error of a servo loop outlasts the motion.",
        f"FERROR = {error:.9g}", f"MIN_FERROR = {error:.9g}",
        "# Homing at the present position; enter your switch or index.",
        "HOME_SEARCH_VEL = 0", "HOME_LATCH_VEL = 0", "HOME_SEQUENCE = 0",
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def _unknown(limit: Limits) -> list[str]:
    """Settings that the machine file does not contain and that must not be assumed."""
    if limit.travel_known:
        return []
    return [
        "# THE TRAVEL IS NOT KNOWN: the machine file has no travel_least and travel_most in its guard.",
        "# MIN_LIMIT and MAX_LIMIT are placeholders; enter yours before the axis moves.",
    ]


def desk_hal(routine: Routine, plant: Routine, joint: int) -> str:
    """The HAL file for a desk: the planner, the controller of this axis, and its physics in place of a card."""
    x, p, name = _prefix(routine), hal(plant.name), hal(routine.name)
    readings = [r for r in ("motor-position-fb", "load-position-fb", "position-fb") if _has(routine, r)]
    lines = [
        "# The axis on the desk: its physics in place of drive, motor and encoders. Nothing moves.",
        "loadrt [KINS]KINEMATICS",
        "loadrt [EMCMOT]EMCMOT servo_period_nsec=[EMCMOT]SERVO_PERIOD num_joints=[KINS]JOINTS",
        f"loadrt {plant.name}", "",
        f"addf {p}.read servo-thread",
        "addf motion-command-handler servo-thread", "addf motion-controller servo-thread",
        f"source {routine.name}.hal", f"addf {p}.write servo-thread", "",
        *(f"net {x}-{r} <= {p}.{'load-position-fb' if r == 'position-fb' else r}" for r in readings),
        f"net {x}-force-cmd => {p}.force", "",
        "# A desk has no real-time kernel: a late call is no fault here. On a machine it is.",
        f"setp {name}.late-limit 0", "",
        *(f"net joint-{i}-loop joint.{i}.motor-pos-cmd => joint.{i}.motor-pos-fb" for i in range(joint)),
        "net estop-loop iocontrol.0.user-enable-out iocontrol.0.emc-enable-in",
        "net tool-prepared iocontrol.0.tool-prepare iocontrol.0.tool-prepared",
        "net tool-changed iocontrol.0.tool-change iocontrol.0.tool-changed",
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def desk_ini(routine: Routine, joint: int, letter: str) -> str:
    """A LinuxCNC configuration with this axis, for `linuxcnc desk.ini`; joints before it follow their commands."""
    others = [each for each in LETTERS if each != letter][:joint]
    ideal = "".join(_IDEAL.format(letter=each, joint=i) for i, each in enumerate(others))
    return filled(
        "desk.ini", name=routine.name, period=component.period(routine), coordinates="".join([*others, letter]),
        joints=joint + 1, ideal=ideal,
    )  # fmt: skip


def _prefix(routine: Routine) -> str:
    """Prefix of the signals, different for each axis."""
    return hal(routine.name)


def _has(routine: Routine, wanted: str) -> bool:
    return any(item.name == wanted for item in component.pins(routine))


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


_VELOCITIES = (0.5, 0.25, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)  # m/s, tried one after the other
_RAMP = 0.2  # s from rest to the velocity, and of the way between two ramps
_SHARE = 0.7  # of the limits of force, following error and speed that a move may use
_MARGIN = 2.0  # between the following error of the move and FERROR


@dataclass(frozen=True)
class Limits:
    """Limits of an axis in LinuxCNC: velocity (m/s), acceleration (m/s2), following error (m), ends of the travel (m).

    `peak_error` (m) and `peak_force` (N) are those of the move in which the axis was tried; `travel_known`: the ends
    are those of the guard, not placeholders.
    """

    velocity: float
    acceleration: float
    following_error: float
    least: float
    most: float
    peak_error: float
    peak_force: float
    travel_known: bool


def limits(loop: Loop) -> Limits:
    """The fastest of some moves that leave a margin of 30 % to the limits of the control and of the motor.

    The move is LinuxCNC's own, a trapezoid of velocity.  Its following error is counted as LinuxCNC does, against the
    reading of one period later.  Raises ParameterError if even the slowest move is too much.
    """
    least, most = _travel(loop)
    found = None
    for velocity in _VELOCITIES:
        found = _tried(loop, velocity, least, most)
        if found is not None:
            break
    if found is None:
        raise ParameterError(
            f"the axis cannot be moved at {Quantity(_VELOCITIES[-1], 'm/s'):6 SI} within 70 % of its limits of force, "
            "following error and speed: LinuxCNC would switch it off at once; look at the simulation of this loop "
            "first"
        )
    return found


def _travel(loop: Loop) -> tuple[float, float]:
    """Ends of the travel in m: those of the guard, else half a metre either way."""
    guard = loop.control.guard
    least, most = (None, None) if guard is None else (guard.travel_least, guard.travel_most)
    if least is not None and most is not None:
        return least, most
    if least is not None:
        return least, least + 1.0
    if most is not None:
        return most - 1.0, most
    return -0.5, 0.5


def _tried(loop: Loop, velocity: float, least: float, most: float) -> Limits | None:
    """The limits, or None if this move is too fast or too long."""
    acceleration = velocity / _RAMP
    distance = 2.0 * _RAMP * velocity
    if distance > most - least:
        return None
    middle = 0.5 * (least + most)
    move = TrapezoidalMove(
        distance=distance, start=middle - 0.5 * distance, velocity=velocity, acceleration=acceleration, dwell_after=0.1
    )
    try:
        run = simulate(
            loop, move, record=("set_position", "reading_load", "requested", "force", "trip", "velocity_load")
        )
    except DivergedError:
        return None
    error = float(np.max(np.abs(run["set_position"][:-1] - run["reading_load"][1:])))
    force = float(np.max(np.abs(run["requested"])))
    speed = float(np.max(np.abs(run["velocity_load"])))
    guard, motor = loop.control.guard, loop.axis.actuator.motor
    forces = [loop.control.force_limit, None if motor is None else motor.limits()[0]]
    bounds = [(force, each) for each in forces]
    bounds.append((speed, None if motor is None else motor.velocity_limit()))
    if guard is not None:
        bounds += [(error, guard.following_error_limit), (speed, guard.velocity_limit)]
    if np.any(run["trip"] > 0.0) or any(bound is not None and value > _SHARE * bound for value, bound in bounds):
        return None
    known = guard is not None and guard.travel_least is not None and guard.travel_most is not None
    return Limits(velocity, acceleration, _rounded_up(_MARGIN * error), least, most, error, force, known)


def _rounded_up(value: float) -> float:
    """To 1, 2 or 5 times a power of ten, in m, and at least 10 um."""
    value = max(value, 1e-5)
    power = 10.0 ** math.floor(math.log10(value))
    return next(round(step * power, 9) for step in (1.0, 2.0, 5.0, 10.0) if step * power >= value * (1.0 - 1e-9))

"""The .hal and .ini files: an axis under its controller, and a configuration with a simulated axis."""

from __future__ import annotations

from feeddrive.export.linuxcnc import component, controller
from feeddrive.export.linuxcnc.component import hal
from feeddrive.export.linuxcnc.limits import Limits
from feeddrive.export.linuxcnc.texts import filled
from feeddrive.loop.routine import Routine

LETTERS = "XYZABCUVW"


def axis_hal(routine: Routine, joint: int, title: str, made_by: str) -> str:
    """Wiring of the controller: from the joint's commands to the force, without the lines of a card."""
    name, P = hal(routine.name), routine.name
    x = _prefix(routine)
    reading = controller.reading(routine)
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
        "# What the planner wants. LinuxCNC 2.9 gives no jerk and no snap: their pins stay 0. With LinuxCNC 2.10:",
        f"#   net {x}-jerk-cmd joint.{joint}.jerk-cmd => {name}.jerk-cmd",
        f"net {x}-position-cmd joint.{joint}.motor-pos-cmd => {name}.position-cmd",
        f"net {x}-velocity-cmd joint.{joint}.vel-cmd => {name}.velocity-cmd",
        f"net {x}-acceleration-cmd joint.{joint}.acc-cmd => {name}.acceleration-cmd", "",
        "# What the encoders read, in the unit of the machine.",
        f"net {x}-{reading} => {name}.{reading} joint.{joint}.motor-pos-fb",
        *([f"net {x}-motor-position-fb => {name}.motor-position-fb"] if two else []), "",
        "# Enable and fault: a trip switches the machine off, and the next F2 clears it.",
        f"net {x}-enable joint.{joint}.amp-enable-out => {name}.enable",
        f"net {x}-fault {name}.fault => joint.{joint}.amp-fault-in",
        f"net {x}-ok {name}.ok",
        f"net {x}-heartbeat {name}.heartbeat",
        f"net {x}-running {name}.running", "",
        "# What the drive does.",
        f"net {x}-force-cmd {name}.force-cmd",
        *([f"net {x}-drive-cmd {name}.drive-cmd"] if drive else []), "",
        "# Your card: put its pins in, and take the comment away. Try signs and scales with the motor uncoupled.",
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
    # inside the guard's travel: at its very end an overshoot of nothing would trip
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
        "# Home where the axis stands; put your switch or index in.",
        "HOME_SEARCH_VEL = 0", "HOME_LATCH_VEL = 0", "HOME_SEQUENCE = 0",
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def _unknown(limit: Limits) -> list[str]:
    """Settings that the machine file does not contain and that must not be assumed."""
    if limit.travel_known:
        return []
    return [
        "# THE TRAVEL IS NOT KNOWN: the machine file has no travel_least and travel_most in its guard.",
        "# MIN_LIMIT and MAX_LIMIT are made up; put in yours before the axis moves.",
    ]


def desk_hal(routine: Routine, plant: Routine, joint: int) -> str:
    """The whole of HAL for a desk: the planner, the controller of this axis, and its physics in place of a card."""
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
    """A LinuxCNC of this axis, `linuxcnc desk.ini`; joints before it follow their commands."""
    others = [each for each in LETTERS if each != letter][:joint]
    ideal = "".join(_IDEAL.format(letter=each, joint=i) for i, each in enumerate(others))
    return filled(
        "desk.ini", name=routine.name, period=component.period(routine), coordinates="".join([*others, letter]),
        joints=joint + 1, ideal=ideal,
    )  # fmt: skip


def _prefix(routine: Routine) -> str:
    """Of the signals: unlike those of another axis."""
    return hal(routine.name)


def _has(routine: Routine, wanted: str) -> bool:
    return any(item.name == wanted for item in controller.pins(routine))


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

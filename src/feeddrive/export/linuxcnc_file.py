"""The file of an axis of LinuxCNC: the names of its pins, its thread, and the limits of a motion.

axis = "x"
hal = "axis.hal"                # loads card, control and thread, and does not start it
period_us = 1000
units_per_m = 1000
force_per_output = 95           # N at the table per unit of the command
set_position = "pid.x.command"
position = "hm2_7i92.0.encoder.00.position"
output = "pid.x.output"
command = "hm2_7i92.0.pwmgen.00.value"
control_enable = "pid.x.enable"
drive_enable = "hm2_7i92.0.pwmgen.00.enable"
first = "pid.x.do-pid-calcs"    # of the control, in the thread
write = "hm2_7i92.0.write"      # passes the command on
position_pid = "pid.x"
[limits]
travel_mm = 100                 # from the start position, in both directions
velocity = 0.2                  # m/s
force = 500                     # N
following_error_mm = 1
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from feeddrive.bus.drive_file import BusLimits
from feeddrive.files.section import Section, read_section, text
from feeddrive.files.toml_file import read_toml
from feeddrive.language.block import Number, choice, declarations, part
from feeddrive.language.block import parameter as number
from feeddrive.language.errors import ParameterError


class LinuxcncFile(Section):
    """An axis of a LinuxCNC: its HAL file, the names of its pins, the thread, and the limits of a motion.

    The HAL file loads the driver of the card, the control and a thread, and does not start it.  Where several pins may
    be named they stand in one text, with blanks between.  The pins that are named as inputs are taken from whatever
    writes them.
    """

    axis: str = text("name of the axis", default="x")
    hal: str = text("HAL file, beside this one", shortest=1, example='"axis.hal"')
    ini: str = text("ini file that the HAL file needs, beside this one; empty for none", default="")
    thread: str = text("servo thread", default="servo-thread")
    period: Number = number("s", "period of the thread", above=0)
    units_per_m: Number = number("1/m", "machine units in a metre: 1000 for mm", above=0, default=1000)
    force_per_output: Number = number("N", "force at the table per unit of the command to the drive", default=1)
    increment: Number | None = number(
        "m", "one count of the encoder at the table; absent: not known", above=0, default=None
    )
    set_position: str = text("pins that take the set position", shortest=1, example='"pid.x.command"')
    set_velocity: str = text("pins that take the set velocity; empty for none", default="")
    set_acceleration: str = text("pins that take the set acceleration; empty for none", default="")
    position: str = text("pin of the position", shortest=1, example='"hm2_7i92.0.encoder.00.position"')
    motor_position: str = text("pin of the position of the motor's encoder; empty if there is one encoder", default="")
    output: str = text("pin of the control's output", shortest=1, example='"pid.x.output"')
    command: str = text("pins that take the command to the drive; empty for none", default="")
    force: str = text("pins that take the force in N, of a simulated axis; empty for none", default="")
    control_enable: str = text("pins that enable the control", shortest=1, example='"pid.x.enable"')
    drive_enable: str = text("pins that enable the drive; empty for none", default="")
    drive_fault: str = text("pin of the drive's fault; empty for none", default="")
    stop: str = text("pin that stops a motion while it is on, of a switch or a key; empty for none", default="")
    brake: str = text("pins that open the brake; empty for none", default="")
    brake_time: Number = number("s", "time in which the brake closes, for which the axis is held", least=0, default=0)
    held: str = text("pins that hold the axis while it is off, of a simulated axis; empty for none", default="")
    first: str = text("function of the control that the thread calls first", shortest=1, example='"pid.x.do-pid-calcs"')
    write: str = text("function that passes the command on to the drive", shortest=1, example='"hm2_7i92.0.write"')
    late: Number | None = number(
        "s", "longest time from call to call of a control on trial; absent: ten periods; 0: any", least=0, default=None
    )
    position_pid: str = text("the pid on the position, whose gains may be tried; empty for none", default="")
    velocity_pid: str = text("the pid on the velocity, likewise", default="")
    forward: str = text("the sum2 of the feedforward at its bias, likewise", default="")
    trial: str = choice(
        "how a control is tried: a component beside the control of the axis, or the gains of its own pids",
        options=("component", "gains"),
        default="component",
    )
    simulated: bool = choice(
        "whether HAL runs in namespaces of its own, which reach no hardware, in virtual time",
        options=(True, False),
        default=False,
    )
    components: str = text("of a simulated axis: .comp files beside this one that its HAL file loads", default="")
    limits: BusLimits = part("where a motion is ended")

    def check(self) -> None:
        """Raise ParameterError for a force per output of 0, no pin of the command, and parts of a simulation."""
        if self.force_per_output == 0.0:
            raise ParameterError("force_per_output = 0: state the force at the table in N per unit of the command")
        if not self.command and not self.force:
            raise ParameterError(
                'command is missing: name the pin that takes the command to the drive, as "pwmgen.0.value"'
            )
        for name in ("force", "held", "components"):
            if getattr(self, name) and not self.simulated:
                raise ParameterError(f"{name} is of a simulated axis: leave it out, or write  simulated = true")


def read_linuxcnc_file(path: str | Path) -> LinuxcncFile:
    """Read the file of an axis of LinuxCNC. Raises FileError and ParameterError with file and line."""
    return read_section(LinuxcncFile, read_toml(path, "an axis of LinuxCNC").root())


def lines_of(section: Section, head: str = "") -> Iterator[str]:
    """Yield the lines of a file with the fields of a section that are not absent."""
    if head:
        yield f"\n[{head}]"
    parts: list[tuple[str, Section]] = []
    for name in declarations(type(section)):
        value = getattr(section, name)
        if isinstance(value, Section):
            parts.append((name, value))
        elif isinstance(value, str):
            yield f"{name} = '{value}'"
        elif value is not None:
            yield f"{name} = {str(value).lower() if isinstance(value, bool) else repr(float(value))}"
    for name, value in parts:
        yield from lines_of(value, name)

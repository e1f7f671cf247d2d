"""An axis of LinuxCNC: motions with excitation in HAL, with the control that it has or with one on trial.

The component `feeddrive_excite` takes the place of planner and joint.  It gives the set motion to the user's own
control (one `pid` or two, as his HAL file wires them) and to the control on trial, a component made from the law as
`feeddrive export --target linuxcnc` makes it, switches between both without a bump, adds the excitation, and ends the
motion at limits of its own.  A streamer feeds it, a sampler records, both at full precision.

A row of the thread:  card read -> streamer -> set -> controls -> act -> sampler -> card write

    force = command of the control that acts + handover + excitation,   limited to limits.force
    handover(n) = d (1 + cos(π n / N))/2 for n = 0 .. N,  N = HANDOVER/T

d is the force of the control that leaves less that of the one that comes in, both of the period of the switch, in which
both are enabled.  So the force of that period is what it would have been without a switch, and later steps by at most
π |d|/(2N) more than the new control itself.  Before and after that period the other control is off: its integral is
cleared, and it cannot wind up.  A `pid` has no input for the force that acts and the component starts from its
`guard.safe-force`, which is why the difference fades instead.
"""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import re
import tempfile
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from feeddrive.blocks.controller.linuxcnc_pid import LinuxcncPid
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.bus.drive_file import BusDrive, BusLimits, DriveScaling
from feeddrive.bus.play import Played, Profile, check_profile, interruption, read_profile
from feeddrive.export.c_code import texts
from feeddrive.export.design import require_guard
from feeddrive.export.drive_quantities import read_cascade
from feeddrive.export.layout import layout
from feeddrive.export.linuxcnc import controller_comp, core, hal, input_pin, parameter, plant_comp
from feeddrive.export.linuxcnc import text as template
from feeddrive.export.linuxcnc_pid import GAINS, hal_fragment, ini_fragment, stock_law
from feeddrive.export.linuxcnc_session import MODULES, HalError, LiveSession
from feeddrive.files.atomic_io import write_whole
from feeddrive.files.log import Log
from feeddrive.files.machine import MachineLike, read_machine
from feeddrive.files.section import Section, read_section, text
from feeddrive.files.toml_file import TomlEdit, read_toml
from feeddrive.language.block import Number, choice, declarations, part
from feeddrive.language.block import parameter as number
from feeddrive.language.errors import BusError, ParameterError, StructureError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.loop.routine import Routine, controller_routine, plant_routine

HANDOVER = 0.1  # s in which the difference of two controls fades away: slower than the loops, which follow it
SETTLING = 0.1  # s of rest before and after a motion, and after a switch
AHEAD = 0.5  # s of rows that are fed ahead: a program that fails lets the axis go on for so long before it brakes
DEPTH = 65_536  # rows that streamer and sampler hold: a second at the fastest thread, and more
LONGEST = 524_288  # rows of virtual time, which all stand in the queue when they are played
NO_END = 1e30  # a position that no axis reaches
EXCITE, TRIAL, SIMULATED = "feeddrive_excite", "feeddrive_trial", "feeddrive_axis"

# streamer: number of the row, set motion, excitation, and what the row does
_FED, _KINDS = ("row", "position", "velocity", "acceleration", "excitation", "new", "log", "last"), "uffffbbb"
# pins of the component that are written, and those of them that are recorded by the place in the sampler
_WRITTEN = (
    *("set-position", "set-velocity", "set-acceleration", "old-enable", "new-enable", "drive-enable", "brake-open"),
    *("off", "command", "force", "control-force", "excitation", "handover", "active", "logging", "streaming"),
)
_RECORDED = {0: "set-position", 1: "excitation", 2: "force", 3: "control-force", 4: "handover", 7: "active"}
_TAKEN = "fffffffu"


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
    brake: str = text("pins that open the brake; empty for none", default="")
    brake_time: Number = number("s", "time in which the brake closes, for which the axis is held", least=0, default=0)
    held: str = text("pins that hold the axis while it is off, of a simulated axis; empty for none", default="")
    first: str = text("function of the control that the thread calls first", shortest=1, example='"pid.x.do-pid-calcs"')
    write: str = text("function that passes the command on to the drive", shortest=1, example='"hm2_7i92.0.write"')
    position_pid: str = text("the pid on the position, whose gains may be tried; empty for none", default="")
    velocity_pid: str = text("the pid on the velocity, likewise", default="")
    forward: str = text("the sum2 of the feedforward at its bias, likewise", default="")
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


def read_linuxcnc_axis(path: str | Path) -> LinuxcncFile:
    """Read the file of an axis of LinuxCNC. Raises FileError and ParameterError with file and line."""
    return read_section(LinuxcncFile, read_toml(path, "an axis of LinuxCNC").root())


class LinuxcncAxis:
    """An axis of LinuxCNC that motions are played on; HAL is loaded by the first call and stays until `close`.

    file   pins, thread and limits, read from a file, beside which the HAL file stands
    paced  False to run a simulated axis in virtual time (default), True to run it at the pace of the clock
    """

    increment = 0.0  # HAL gives positions, and not their counts
    delay = 0.0
    rotary = False

    def __init__(self, file: LinuxcncFile, *, paced: bool | None = None) -> None:
        assert file.read_from is not None, "the HAL file stands beside the file of the axis"
        self._text = file.read_from.file.text
        self._name = file.read_from.file.name
        self._hal = _Hal(file, Path(self._name).resolve().parent, paced=not file.simulated if paced is None else paced)
        self._take(file)

    def _take(self, file: LinuxcncFile) -> None:
        self.file, self.limits = file, file.limits
        # as HAL computes it
        self.sample_time = round(file.period * 1e9) * 1e-9
        self._units, self._per_output = float(file.units_per_m), float(file.force_per_output)
        self.where = f"LinuxCNC, {'simulated ' if file.simulated else ''}axis {file.axis}"

    @property
    def is_virtual(self) -> bool:
        """True for a simulated axis: its HAL reaches no hardware."""
        return self.file.simulated

    def limited(self, limits: BusLimits) -> Self:
        """Return the same axis under other limits."""
        return self._with(replace(self.file, limits=limits), self._text)

    def scaled(self, factor: float, force_sign: int = 1) -> Self:
        """Return the axis with lengths `factor` times as long, and the sign of its force times `force_sign`."""
        units, per_output = self.file.units_per_m / factor, self.file.force_per_output * force_sign
        edit = TomlEdit(self._text, self._name)
        if factor != 1.0:
            edit.set(("units_per_m",), float(units), "1/m", digits=9)
        if force_sign != 1:
            edit.set(("force_per_output",), float(per_output), "N", digits=9)
        return self._with(replace(self.file, units_per_m=units, force_per_output=per_output), edit.text)

    def _with(self, file: LinuxcncFile, content: str) -> Self:
        """Return the axis with another file, on the same HAL."""
        made = copy(self)
        made._text = content
        made._take(file)
        return made

    def text(self) -> str:
        """Return the file of the axis, with the corrections of `scaled`."""
        return self._text

    def read(self, path: str | Path) -> Profile:
        """Read a profile for this axis; see `read_profile`."""
        return read_profile(path, self._judged())

    def close(self) -> None:
        """Unload HAL, which switches the drive off."""
        self._hal.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def listen(self, seconds: float, progress: Progress | None = None) -> Played:
        """Log the axis while it is off."""
        count = max(1, round(seconds / self.sample_time))
        rows = np.zeros((count + 1, len(_FED)))
        rows[:count, _FED.index("log")] = 1.0
        profile = Profile("listened", "", self.sample_time, "N", *(np.zeros(count) for _ in range(3)))
        played = self._played(rows, profile, progress, listens=True)
        kept = {
            name: played.log[name] for name in ("force", "reading_load", "reading_motor") if name in played.log.channels
        }
        log = replace(played.log, channels=kept, units={name: played.log.units[name] for name in kept})
        return replace(played, log=log)

    def play(
        self,
        profile: Profile,
        progress: Progress | None = None,
        control: Control | Loop | None = None,
        *,
        acting: np.ndarray | None = None,
    ) -> Played:
        """Switch the axis on, play a profile, and switch it off; return the log.

        control  the control on trial.  One with the law `linuxcnc_pid` is tried by the gains of the axis's own pids,
                 which are set before, read back, and restored.  Any other is loaded as a component beside the control
                 of the axis, which holds the axis before and after
        acting   for each row of the profile whether the control on trial acts; default: in all

        Raises ParameterError for a profile beyond the limits and for a control that this HAL cannot try, BusError if
        LinuxCNC refuses something.
        """
        check_profile(profile, self._judged())
        if profile.unit not in ("N", "m"):
            raise ParameterError(
                f"{profile.name}: excitation in '{profile.unit}' cannot be played in LinuxCNC: take N or m"
            )
        if control is None:
            return self._played(self._rows(profile, None), profile, progress)
        control = control.control if isinstance(control, Loop) else control
        if isinstance(control.law, LinuxcncPid):
            before = self.inside()
            try:
                self._set(self._gains(control.law))
                return self._played(self._rows(profile, None), profile, progress)
            finally:
                self.restore(before)
        self._hal.load(self._trial(control), self._units)
        new = np.ones(profile.excitation.size) if acting is None else np.asarray(acting, dtype=float)
        return self._played(self._rows(profile, new), profile, progress)

    def inside(self) -> Mapping[str, str]:
        """Return what the gains of the axis's own pids are now, by pin."""
        return self._hal.values(self._gain_pins())

    def restore(self, inside: Mapping[str, str]) -> Text:
        """Set the gains that `inside` returned, read them back, and unload the control on trial."""
        self._hal.unload()
        self._set({pin: float(value) for pin, value in inside.items()})
        return Text(
            f"{self.where}: the {len(inside)} gains of before are set, as read back; the control on trial is unloaded"
            if inside
            else f"{self.where}: the control on trial is unloaded; the control of the axis was not changed"
        )

    def keep(self, machine_file: Path, export: Path) -> Text:
        """Return what makes the new control that of the machine: LinuxCNC reads its own files at the next start."""
        hal_files = sorted(file.name for file in export.glob("*.hal") if file.name != "desk.hal")
        components = sorted(file.name for file in export.glob("*.comp") if not file.stem.endswith("_plant"))
        install = "".join(f"sudo halcompile --install {export / name}; " for name in components)
        return Text(
            f"{self.where}: {install}take {', '.join(hal_files) or 'the export'} of {export} into your HAL files in "
            f"place of the old control; it was made from {machine_file}"
        )

    def _judged(self) -> BusDrive:
        """Return a drive in csp with these limits, by whose rules a profile is judged before it is played."""
        scaling = DriveScaling(increment=1e-9, rated_force=1e-3 * min(1.0, self.limits.force))
        return BusDrive(bus="ethercat", cycle_time=self.sample_time, scaling=scaling, limits=self.limits)

    def _rows(self, profile: Profile, new: np.ndarray | None) -> np.ndarray:
        """Return the rows for the streamer: rest, switch, motion, rest, switch back, and an end.

        Set accelerations are central differences of the set position, as `Profile.reference` has them on every drive.
        """
        T, n = self.sample_time, profile.excitation.size
        rest, switch = round(SETTLING / T), round((HANDOVER + SETTLING) / T)
        before = rest + (switch if new is not None and new[0] else 0)
        after = rest + (switch if new is not None and new[-1] else 0)
        rows = np.zeros((before + n + after + 1, len(_FED)))
        at = {name: rows[:, i] for i, name in enumerate(_FED)}
        moving = slice(before, before + n)
        shifted = profile.set_position + (profile.excitation if profile.unit == "m" else 0.0)
        at["position"][moving] = shifted
        at["position"][before + n :] = shifted[-1]
        at["velocity"][moving] = profile.velocity
        at["acceleration"][moving] = np.diff(np.pad(profile.set_position, 1, mode="edge"), 2) / T**2
        if profile.unit == "N":
            at["excitation"][moving] = profile.excitation
        at["log"][moving] = 1.0
        if new is not None:
            at["new"][rest:before] = 1.0 if new[0] else 0.0
            at["new"][moving] = new
            # rests under the control on trial before it is left
            at["new"][before + n : before + n + rest] = 1.0 if new[-1] else 0.0
        return rows

    def _played(
        self, rows: np.ndarray, profile: Profile, progress: Progress | None, *, listens: bool = False
    ) -> Played:
        """Play rows and return the log of those that are to be recorded."""
        rows[:, 0] = np.arange(1, len(rows) + 1)
        rows[-1, -1] = 1.0
        fed = rows.copy()
        for name in ("position", "velocity", "acceleration"):
            fed[:, _FED.index(name)] *= self._units
        self._hal.limit(self.file)
        with interruption(keys=True) as interrupted:

            def stopped(played: int) -> bool:
                if progress is not None:
                    # unlike `step`, it never raises: a cancel must end the motion by braking
                    progress.show_step(profile.name, min(played, len(rows)), len(rows), "")
                return interrupted() > 0 or (progress is not None and progress.cancelled)

            ended, taken = self._hal.play(fed, stopped, self.sample_time, listens=listens)
        log, why = self._log(taken, profile), self._why(ended)
        if why:
            log = replace(log, provenance={**log.provenance, "aborted": why})
        remarks = []
        if ended["overruns"]:
            remarks.append(f"{ended['overruns']} rows of the log were lost: the program was too slow to take them")
        return Played(log, Text(why) if why else None, 0, None, tuple(remarks))

    def _log(self, taken: np.ndarray, profile: Profile) -> Log:
        """Return the log: row k holds readings, set position and forces of one period of the thread."""
        n, T, units = len(taken), self.sample_time, self._units
        at = taken.T
        channels = {
            "set_position": at[0] / units,
            "excitation": at[1] if profile.unit == "N" else profile.excitation[:n],
            "force": at[2],
            "reading_load": at[5] / units,
            "commanded": at[2],
            "control_force": at[3],
            "handover": at[4],
            "control": at[7],
        }
        if self.file.motor_position:
            channels["reading_motor"] = at[6] / units
        unit = {"excitation": profile.unit, "control": ""} | dict.fromkeys(
            ("force", "commanded", "control_force", "handover"), "N"
        )
        provenance: dict[str, object] = {
            "written_by": "feeddrive play",
            "bus": self.where,
            "profile": profile.name,
            "profile_sha256": profile.sha256,
            "units_per_m": units,
            "newton_per_output": self._per_output,
            "lag": 0,
        }
        return Log(
            name=profile.name,
            time=np.arange(n) * T,
            channels={name: np.array(values, dtype=float) for name, values in channels.items()},
            units={name: unit.get(name, "m") for name in channels},
            sample_time=T,
            constants={"lost_frames": 0.0},
            provenance=provenance,
        )

    def _why(self, ended: Mapping[str, Any]) -> str:
        """Return why a motion ended early, or an empty string."""
        code, value, limits = int(ended["fault"]), float(ended["value"]), self.limits
        if code == 0:
            return ""
        row, length, end = f" in row {ended['played']}", value / self._units, "; its force was switched off at once"
        bounds = {
            3: ("travel", length, limits.travel, "m"),
            4: ("velocity", length, limits.velocity, "m/s"),
            5: ("force", value, limits.force, "N"),
            6: ("following_error", length, limits.following_error, "m"),
        }
        if code in bounds:
            key, found, bound, unit = bounds[code]
            end = "; the axis was braked" if key == "travel" else end
            if key == "force":
                return Text(
                    f"the force was at limits.force = {Quantity(bound, unit):SI} for longer than a healthy control "
                    f"holds it{row}{end}"
                )
            return Text(
                f"{key} = {Quantity(abs(found), unit):SI}{row} exceeded limits.{key} = {Quantity(bound, unit):SI}{end}"
            )
        words = {
            1: "stopped by hand; the axis was braked" if ended["played"] else "stopped by hand before it began",
            2: f"no row came after row {ended['played']}: the program that plays was too slow, or failed; the axis was "
            "braked",
            7: f"the position is not a number{row}{end}",
            8: f"the output of a control is not a number{row}{end}",
            9: f"the control on trial reports a fault{row}; the control of the axis took over and braked",
            10: f"the drive reports a fault{row}{end}",
            11: Text(
                f"the axis runs away{row}: it flees from its target, {Quantity(length, 'm'):SI} off, driven by its "
                f"force: a sign is wrong, or a load drives it{end}"
            ),
            12: Text(
                f"position = {Quantity(length, 'm'):6 SI}, where the axis could come to rest{row}, is beyond "
                "limits.position_least or position_most; the axis was braked"
            ),
        }
        return words[code]

    def _trial(self, control: Control) -> Routine:
        """Return the routine of a control on trial. Raises StructureError for one without a guard."""
        loop = self._loop(control)
        require_guard(loop)
        return controller_routine(loop, TRIAL)

    def _loop(self, control: Control) -> Loop:
        """Return a loop with the control, for its encoders; the axis in it is none of this machine."""
        if not self.file.motor_position:
            axis = Axis(plant=Rigid(mass=1.0))
        else:
            plant = TwoMass(mass_motor=1.0, mass_load=1.0, stiffness=1.0)
            axis = Axis(plant=plant, encoder_motor=Encoder(), encoder_load=Encoder())
        return Loop(control=control, axis=axis, sample_time=self.sample_time, name=self.file.axis)

    def _gain_pins(self) -> list[str]:
        pins = [f"{pid}.{gain}" for pid in (self.file.position_pid, self.file.velocity_pid) if pid for gain in _GAINS]
        return pins + [f"{self.file.forward}.{gain}" for gain in _FORWARD if self.file.forward]

    def _gains(self, law: LinuxcncPid) -> dict[str, float]:
        """Return the values of the pins that make the axis's own pids those of a law.

        Raises ParameterError for a law whose pids are not those of the axis.
        """
        file = self.file
        if not file.position_pid or (law.velocity is not None) != bool(file.velocity_pid):
            raise ParameterError(
                f"{self.where}: the law has {'one pid' if law.velocity is None else 'two pids'}, and the file of the "
                f'axis names position_pid = "{file.position_pid}" and velocity_pid = "{file.velocity_pid}": name the '
                "pids whose gains may be changed, or take the target linuxcnc, whose component is loaded beside them"
            )
        if law.filters:
            raise ParameterError(
                f"{self.where}: the law has filters, and gains alone make none: take the target linuxcnc"
            )
        by_sum = law.acceleration_gain is not None or law.velocity_gain is not None
        if by_sum and not file.forward:
            raise ParameterError(
                f"{self.where}: the law feeds the acceleration forward by a sum2 at the pin bias, and the file of the "
                'axis names none as  forward = "..."'
            )
        if law.units != self._units or law.force_per_output != self._per_output:
            raise ParameterError(
                f"{self.where}: the gains are for {law.units:.9g} units in a metre and {law.force_per_output:.9g} N "
                f"per unit of the output, and this axis has {self._units:.9g} and {self._per_output:.9g}"
            )
        values: dict[str, float] = {}
        for name, pid in ((file.position_pid, law.position), (file.velocity_pid, law.velocity)):
            if pid is not None:
                values |= {f"{name}.{gain}": float(getattr(pid, gain)) for gain in GAINS}
                values[f"{name}.error-previous-target"] = float(pid.error_previous_target)
        last = law.position if law.velocity is None else law.velocity
        if file.forward:
            gains = (law.acceleration_gain or 0.0, law.velocity_gain or 0.0, last.bias)
            values |= {
                f"{file.forward}.{name}": float(v) for name, v in zip(("gain0", "gain1", "offset"), gains, strict=True)
            }
        return values

    def _set(self, values: Mapping[str, float]) -> None:
        """Set pins and read them back. Raises BusError, after restoring them, for one that reads back otherwise."""
        if values:
            self._hal.write(values)


_GAINS = (*GAINS, "error-previous-target")
_FORWARD = ("gain0", "gain1", "offset")


def simulated_linuxcnc_axis(
    machine: MachineLike,
    limits: BusLimits,
    folder: str | Path,
    axis: str | None = None,
    *,
    old: LinuxcncPid | None = None,
    route: str = "two",
    units: float = 1000.0,
    paced: bool = False,
) -> LinuxcncAxis:
    """Write an axis of a machine file as a component, with a HAL file in which stock pids control it, and open it.

    folder  where the files are written; `axis.toml` there may be changed and read again by `read_linuxcnc_axis`
    old     the pids of the control that it has; default: those that realize the control of the machine file
    route   of the default: two pids in cascade, or one
    units   machine units in a metre, of the default
    paced   True to run at the pace of the clock

    Raises the errors of `read_machine`, and of `stock_law` for a control that pids cannot realize.
    """
    read, folder = read_machine(machine), Path(folder)
    name = read.named(axis)
    loop = read.loops[name]
    if loop.axis.rotary:
        raise StructureError(f"axis {name} turns, and HAL components of feeddrive scale lengths only")
    cascade = read_cascade(loop)
    law = stock_law(cascade, route=route, units=units) if old is None else old
    title, made_by = f"Axis {name} of '{read.name}', simulated", "Made by feeddrive."
    plant = layout(plant_routine(loop, SIMULATED))
    component = hal(SIMULATED)
    two, both = law.velocity is not None, loop.axis.encoders() == 2
    load, motor = (f"{component}.{which}-position-fb" for which in ("load", "motor"))
    lines = [
        f"loadrt threads name1=servo-thread period1={round(loop.sample_time * 1e9)}",
        f"loadrt {SIMULATED}",
        f"setp {component}.units-per-m {float(law.units)!r}",
        f"addf {component}.read servo-thread",
        "source pids.hal",
        f"addf {component}.write servo-thread",
        f"net axis-load {load}",
        *([f"net axis-motor {motor}"] if both else []),
    ]
    last = "axis.velocity" if two else "axis.position"
    file = LinuxcncFile(
        axis=name,
        hal="axis.hal",
        ini="pids.ini",
        period=loop.sample_time,
        units_per_m=float(law.units),
        force_per_output=float(law.force_per_output),
        set_position="axis.position.command",
        set_velocity="axis.forward.in1",
        set_acceleration="axis.forward.in0",
        position=load,
        motor_position=motor if both else "",
        output="axis.limit.out" if law.filters else f"{last}.output",
        force=f"{component}.force",
        control_enable="axis.position.enable" + (" axis.velocity.enable" if two else ""),
        held=f"{component}.held",
        first="axis.speed" if two else "axis.forward",
        write=f"{component}.write",
        position_pid="axis.position",
        velocity_pid="axis.velocity" if two else "",
        forward="axis.forward",
        simulated=True,
        components=f"{SIMULATED}.comp",
        limits=limits,
    )
    files = {
        f"{SIMULATED}.comp": plant_comp(plant.routine, title, made_by),
        f"{SIMULATED}.h": core(SIMULATED, texts(plant, title, made_by)),
        "pids.hal": hal_fragment(cascade, law, "axis", None, [title]),
        "pids.ini": ini_fragment(cascade, law, 0, [title]),
        "axis.hal": "\n".join(lines) + "\n",
        "axis.toml": "\n".join(_lines(file)) + "\n",
    }
    for written, content in files.items():
        write_whole(folder / written, content)
    return LinuxcncAxis(read_linuxcnc_axis(folder / "axis.toml"), paced=paced)


class _Hal:
    """The HAL of an axis: loaded when it is needed first, and then kept; the axes made of one another share it."""

    def __init__(self, file: LinuxcncFile, folder: Path, *, paced: bool) -> None:
        self.file, self.folder, self.paced = file, folder, paced
        self._session: LiveSession | None = None
        self._loaded = ""
        self._work = tempfile.TemporaryDirectory(prefix="feeddrive-hal-")
        atexit.register(_closed, weakref.ref(self))

    @property
    def session(self) -> LiveSession:
        """The session, begun if there is none. Raises BusError, with what LinuxCNC said, if it fails."""
        if self._session is not None and self._session.runs:
            return self._session
        work, file = Path(self._work.name), self.file
        (work / f"{EXCITE}.comp").write_text(template(f"{EXCITE}.comp"), encoding="utf-8")
        ini = f"-i {_quoted(self.folder / file.ini)} " if file.ini else ""
        user = f"cd {_quoted(self.folder)} && halcmd {ini}-f {_quoted(self.folder / file.hal)}\n"
        (work / "user.sh").write_text(user, encoding="utf-8")
        components = [work / f"{EXCITE}.comp", *(self.folder / name for name in file.components.split())]
        depth = LONGEST if not self.paced else DEPTH
        lines = [
            "loadusr -w bash user.sh",
            f"loadrt streamer depth={depth} cfg={_KINDS}",
            f"loadrt sampler depth={depth} cfg={_TAKEN}",
            f"loadrt {EXCITE}",
        ]
        self._loaded = ""
        try:
            self._session = LiveSession(work, components, lines, alone=file.simulated, paced=self.paced)
            self._wire(self._session)
            if self.paced:
                self._session.halcmd("start")
        except HalError as error:
            self.close()
            raise BusError(f"LinuxCNC, axis {file.axis}: {error}") from None
        return self._session

    def _wire(self, session: LiveSession) -> None:
        """Put the component between the control of the axis, its drive and its thread."""
        file, e = self.file, hal(EXCITE)
        first, write = self._place(session, file.first), self._place(session, file.write)
        if first >= write:
            raise HalError(
                f"the thread calls {file.first} (first) after {file.write} (write): name the first function of the "
                "control, and the one that passes the command on to the drive"
            )
        functions = [
            f"addf {e}.act {file.thread} {write}",
            f"addf sampler.0 {file.thread} {write + 1}",
            f"addf streamer.0 {file.thread} {first}",
            f"addf {e}.set {file.thread} {first + 1}",
        ]
        read = {
            "position-fb": self._signal(session, file.position, "fd-position-fb"),
            "old-command": self._signal(session, file.output, "fd-old-command"),
        }
        if file.drive_fault:
            read["drive-fault"] = self._signal(session, file.drive_fault, "fd-drive-fault")
        nets = [f"net {signal} => {e}.{pin}" for pin, signal in read.items()]
        nets += [f"net fd-{pin} {e}.{pin}" for pin in _WRITTEN]
        nets += [f"net fd-{pin} => sampler.0.pin.{i}" for i, pin in _RECORDED.items()]
        nets.append(f"net {read['position-fb']} => sampler.0.pin.5")
        if file.motor_position:
            nets.append(f"net {self._signal(session, file.motor_position, 'fd-motor-position')} => sampler.0.pin.6")
        nets += ["net fd-logging => sampler.0.enable", "net fd-streaming => streamer.0.enable"]
        nets += [f"net fd-row-{i} streamer.0.pin.{i} => {e}.{_row_pin(name)}" for i, name in enumerate(_FED)]
        taken = {
            "set-position": file.set_position,
            "set-velocity": file.set_velocity,
            "set-acceleration": file.set_acceleration,
            "old-enable": file.control_enable,
            "drive-enable": file.drive_enable,
            "brake-open": file.brake,
            "command": file.command,
            "force": file.force,
            "off": file.held,
        }
        for source, pins in taken.items():
            nets += [line for pin in pins.split() for line in (f"unlinkp {pin}", f"net fd-{source} => {pin}")]
        session.halcmd(*functions, *nets)

    def _functions(self, session: LiveSession) -> list[str]:
        printed = session.run("halcmd", "show", "thread", self.file.thread)
        found = re.search(rf"^\s*(\d+)\s+\S+\s+{re.escape(self.file.thread)}\b", printed, re.MULTILINE)
        if found is None:
            raise HalError(f"there is no thread '{self.file.thread}' after {self.file.hal}")
        if abs(float(found[1]) * 1e-9 - self.file.period) > 1e-3 * self.file.period:
            there, said = Quantity(float(found[1]) * 1e-9, "s"), Quantity(self.file.period, "s")
            raise HalError(
                Text(
                    f"the thread '{self.file.thread}' has a period of {there:6 SI}, and the file of the axis says "
                    f"period = {said:6 SI}"
                )
            )
        return re.findall(r"^ +\d+ +(\S+)$", printed, re.MULTILINE)

    def _place(self, session: LiveSession, function: str) -> int:
        """Return the place of a function in the thread, from 1 on."""
        functions = self._functions(session)
        if function not in functions:
            raise HalError(
                f"the thread '{self.file.thread}' has no function '{function}'; it has {', '.join(functions) or 'none'}"
            )
        return functions.index(function) + 1

    def _signal(self, session: LiveSession, pin: str, name: str) -> str:
        """Return the signal that a pin is linked to; one of this name is made for a pin without."""
        for line in session.run("halcmd", "-s", "show", "pin", pin).splitlines():
            words = line.split()
            if pin in words:
                if words[-2] in ("==>", "<==", "<=>"):
                    return words[-1]
                session.halcmd(f"net {name} {pin}")
                return name
        raise HalError(f"there is no pin '{pin}' after {self.file.hal}")

    def limit(self, file: LinuxcncFile) -> None:
        """Write scaling and limits into the component, and read them back (BusError)."""
        limits, units = file.limits, float(file.units_per_m)
        values: dict[str, float] = {
            "force-per-unit": file.force_per_output,
            "travel-limit": units * limits.travel,
            "velocity-limit": units * limits.velocity,
            "force-limit": limits.force,
            "error-limit": units * limits.following_error,
            "deceleration": units * limits.quick_stop_deceleration,
            "position-least": -NO_END if limits.position_least is None else units * limits.position_least,
            "position-most": NO_END if limits.position_most is None else units * limits.position_most,
            "brake-time": file.brake_time,
            "handover-rows": round(HANDOVER / file.period),
        }
        self.write({f"{hal(EXCITE)}.{name}": float(value) for name, value in values.items()})

    def write(self, values: Mapping[str, float]) -> None:
        """Set pins and parameters, and read them back; all are restored if one of them is not taken (BusError)."""
        before = self.values(list(values))
        try:
            self._halcmd(*(f"setp {name} {_word(value)}" for name, value in values.items()))
            for name, found in self.values(list(values)).items():
                if float(found) != values[name]:
                    raise BusError(f"LinuxCNC: {name} was set to {values[name]!r} and reads back as {found}")
        except BusError:
            with contextlib.suppress(BusError):
                # one after the other: that which is linked cannot be set, and was not changed
                for name, value in before.items():
                    self._halcmd(f"-setp {name} {_word(float(value))}")
            raise

    def values(self, names: Sequence[str]) -> dict[str, str]:
        """Return the values of pins and parameters, with all digits."""
        if not names:
            return {}
        try:
            answer = self.session.ask(do="values", names=list(names))
        except HalError as error:
            raise BusError(f"LinuxCNC, axis {self.file.axis}: {error}") from None
        return {name: repr(float(value)) for name, value in answer["values"].items()}

    def _halcmd(self, *lines: str) -> str:
        try:
            return self.session.halcmd(*lines)
        except HalError as error:
            raise BusError(f"LinuxCNC, axis {self.file.axis}: {error}") from None

    def load(self, routine: Routine, units: float) -> None:
        """Load a control on trial beside that of the axis, off. Raises BusError if LinuxCNC does not take it."""
        made = controller_comp(routine, "A control on trial", "Made by feeddrive.")
        header = core(TRIAL, texts(layout(routine), "A control on trial", ""))
        digest = hashlib.sha256(f"{made}{header}{units}".encode()).hexdigest()
        if self._loaded == digest:
            return
        session, name, e = self.session, hal(TRIAL), hal(EXCITE)
        self.unload()
        for suffix, content in (("comp", made), ("h", header)):
            (session.folder / f"{TRIAL}.{suffix}").write_text(content, encoding="utf-8")
        try:
            session.run("halcompile", "--install", f"{TRIAL}.comp")
        except HalError as error:
            raise BusError(
                f"LinuxCNC, axis {self.file.axis}: the control on trial could not be installed in {MODULES}: run this "
                f"program as root, or make that folder writable for the commissioning; {error}"
            ) from None
        place = self._place(session, f"{e}.act")
        sources = {v.path: self._source(session, v.path) for v in routine.inputs}
        self._halcmd(
            f"loadrt {TRIAL}",
            f"setp {name}.units-per-m {units!r}",
            # time is virtual there: a call cannot be late
            *([] if self.paced else [f"setp {name}.late-limit 0"]),
            f"addf {name} {self.file.thread} {place}",
            *(f"net {signal} => {name}.{input_pin(path)}" for path, signal in sources.items() if signal),
            f"net fd-new-force {name}.force-cmd => {e}.new-force",
            f"net fd-new-fault {name}.fault => {e}.new-fault",
        )
        # what the loaded component says of itself: no other machine's control is tried
        wanted = {f"{name}.{parameter(v, routine).name}": float(v.value) for v in routine.parameters}
        for pin, value in self.values(list(wanted)).items():
            if float(value) != wanted[pin]:
                self.unload()
                raise BusError(f"LinuxCNC: {pin} of the loaded control is {value}, and {wanted[pin]!r} was exported")
        self._loaded = digest

    def _source(self, session: LiveSession, path: str) -> str:
        """Return the signal for an input of the control on trial; an empty string for jerk and snap, which are 0."""
        if path == "reading_motor":
            return self._signal(session, self.file.motor_position, "fd-motor-position")
        if path.startswith("reading"):
            return self._signal(session, self.file.position, "fd-position-fb")
        fixed = {
            "set_position": "fd-set-position",
            "set_velocity": "fd-set-velocity",
            "set_acceleration": "fd-set-acceleration",
            "enable": "fd-new-enable",
        }
        return fixed.get(path, "")

    def unload(self) -> None:
        """Unload the control on trial, if one is loaded."""
        if self._session is None or not self._session.runs:
            return
        if any(
            line.split()[-1:] == [TRIAL] or TRIAL in line.split() for line in self._halcmd("list comp").splitlines()
        ):
            self._halcmd(
                f"unloadrt {TRIAL}", "delsig fd-new-force", "delsig fd-new-fault", f"setp {hal(EXCITE)}.new-fault 0"
            )
        self._loaded = ""

    def play(
        self, rows: np.ndarray, stopped: Callable[[int], bool], T: float, *, listens: bool
    ) -> tuple[dict[str, Any], np.ndarray]:
        """Play rows; return how the motion ended, and what was recorded, shape (n, recorded pins)."""
        session, e = self.session, hal(EXCITE)
        if not self.paced and len(rows) >= LONGEST:
            raise ParameterError(
                f"a motion of {len(rows)} rows is longer than the {LONGEST} that a simulated axis plays at once"
            )
        file, out = session.folder / "rows.bin", session.folder / "taken.bin"
        rows.astype("<f8").tofile(file)
        try:
            session.ask(do="clear", standing=not self.paced)
            session.halcmd(f"setp {e}.listens {int(listens)}")
            ended = session.play(
                stopped,
                rows=file.name,
                types=_KINDS,
                recorded=len(_TAKEN),
                out=out.name,
                lead=max(1, round(AHEAD / T)) if self.paced else len(rows),
                standing=not self.paced,
                patience=len(rows) * T + 30.0,
            )
        except HalError as error:
            raise BusError(f"LinuxCNC, axis {self.file.axis}: {error}") from None
        return ended, np.fromfile(out, dtype="<f8").reshape(-1, len(_TAKEN))

    def close(self) -> None:
        """End the session, if there is one."""
        if self._session is not None:
            self._session.close()
            self._session = None


def _closed(held: weakref.ref[_Hal]) -> None:
    still = held()
    if still is not None:
        still.close()


def _row_pin(name: str) -> str:
    return name if name == "row" else f"row-{name}"


def _quoted(path: Path) -> str:
    return "'" + str(path).replace("'", "'\\''") + "'"


def _word(value: float) -> str:
    # pins of whole numbers and bits take no point
    return str(int(value)) if value == int(value) and abs(value) < 1e15 else repr(value)


def _lines(section: Section, head: str = "") -> Iterator[str]:
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
        yield from _lines(value, name)

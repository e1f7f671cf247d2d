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

from collections.abc import Mapping
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.actuator.direct import Direct
from feeddrive.blocks.controller.linuxcnc_pid import LinuxcncPid
from feeddrive.blocks.families import Feedforward, Filter
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.bus.drive_file import BusDrive, BusLimits, DriveScaling
from feeddrive.bus.play import Played, Profile, check_profile, interruption
from feeddrive.export.c_code import texts
from feeddrive.export.design import require_guard
from feeddrive.export.drive_quantities import read_cascade
from feeddrive.export.layout import layout
from feeddrive.export.linuxcnc import FAULTS, core, hal, plant_comp
from feeddrive.export.linuxcnc_file import LinuxcncFile, lines_of, read_linuxcnc_file
from feeddrive.export.linuxcnc_hal import FED, HANDOVER, TRIAL, AxisHal
from feeddrive.export.linuxcnc_pid import GAINS, hal_fragment, ini_fragment, stock_law
from feeddrive.files.atomic_io import write_whole
from feeddrive.files.log import Log
from feeddrive.files.machine import MachineLike, read_machine
from feeddrive.files.toml_file import TomlEdit
from feeddrive.language.block import Block
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.loop.routine import Routine, controller_routine, plant_routine

SETTLING = 0.1  # s of rest before and after a motion, and after a switch
SIMULATED = "feeddrive_axis"
# causes of `Played` by the fault codes of the player
_CAUSES = {1: "person", 3: "travel", 4: "velocity", 5: "force", 6: "following_error", 9: "guard"}
_GAINS = (*GAINS, "error-previous-target")
_FORWARD = ("gain0", "gain1", "offset")
# parameters of a pid that are in units of its output, but for its limit
_OF_OUTPUT = ("Pgain", "Igain", "Dgain", "FF0", "FF1", "FF2", "FF3")


class LinuxcncAxis:
    """An axis of LinuxCNC that motions are played on; HAL is loaded by the first call and stays until `close`.

    file   pins, thread and limits, read from a file, beside which the HAL file stands
    paced  False to run a simulated axis in virtual time (default), True to run it at the pace of the clock
    """

    delay = 0.0
    rotary = False

    def __init__(self, file: LinuxcncFile, *, paced: bool | None = None) -> None:
        assert file.read_from is not None, "the HAL file stands beside the file of the axis"
        self._text = file.read_from.file.text
        self._name = file.read_from.file.name
        self.hal = AxisHal(
            file, Path(self._name).resolve().parent, paced=not file.simulated if paced is None else paced
        )
        self._take(file)

    def _take(self, file: LinuxcncFile) -> None:
        self.file, self.limits = file, file.limits
        # as HAL computes it
        self.sample_time = round(file.period * 1e9) * 1e-9
        self._units, self._per_output = float(file.units_per_m), float(file.force_per_output)
        self.increment = 0.0 if file.increment is None else float(file.increment)
        self.where = f"LinuxCNC, {'simulated ' if file.simulated else ''}axis {file.axis}"

    @property
    def is_virtual(self) -> bool:
        """True for a simulated axis: its HAL reaches no hardware."""
        return self.file.simulated

    @property
    def commanded(self) -> str:
        """What a control on trial commands: a force."""
        return "force"

    @property
    def takes(self) -> tuple[type[Block], ...]:
        """What a control on trial may have beside its law: gains of pids feed a mass and a viscous friction forward."""
        return (Inertia,) if self.file.trial == "gains" else (Feedforward, Filter)

    def limited(self, limits: BusLimits) -> Self:
        """Return the same axis under tighter limits. Raises ParameterError for one that is looser."""
        for name in ("travel", "velocity", "force", "following_error"):
            most, got = getattr(self.limits, name), getattr(limits, name)
            if got > most:
                raise ParameterError(
                    f"{self.where}: limits.{name} = {Quantity(got)} is looser than that of the file of the axis, "
                    f"{Quantity(most)}"
                )
        return self._with(replace(self.file, limits=limits), self._text)

    def scaled(self, factor: float, force_sign: int = 1) -> Self:
        """Return the axis with lengths `factor` times as long, and the sign of its force times `force_sign`."""
        file = self.file
        changed: dict[str, float] = {}
        if factor != 1.0:
            changed["units_per_m"] = float(file.units_per_m / factor)
            if file.increment is not None:
                changed["increment"] = float(file.increment * factor)
        if force_sign != 1:
            changed["force_per_output"] = float(file.force_per_output * force_sign)
        edit = TomlEdit(self._text, self._name)
        for name, value in changed.items():
            edit.set((name,), value, {"units_per_m": "1/m", "increment": "m", "force_per_output": "N"}[name], digits=9)
        return self._with(replace(file, **changed), edit.text)

    def as_found(self) -> Self:
        """Return the axis itself: LinuxCNC has no limit of force in the drive."""
        return self

    def _with(self, file: LinuxcncFile, content: str) -> Self:
        """Return the axis with another file, on the same HAL."""
        made = copy(self)
        made._text = content
        made._take(file)
        return made

    def text(self) -> str:
        """Return the file of the axis, with the corrections of `scaled`."""
        return self._text

    def close(self) -> None:
        """Unload HAL, which switches the drive off."""
        self.hal.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def listen(self, seconds: float, progress: Progress | None = None) -> Played:
        """Log the axis while it is off."""
        count = max(1, round(seconds / self.sample_time))
        rows = np.zeros((count + 1, len(FED)))
        rows[:count, FED.index("log")] = 1.0
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

        control  the control on trial.  One with the law `linuxcnc_pid`, and with trial = "gains" a P-PI cascade as
                 well, is tried by the gains of the axis's own pids, which are set before, read back, and restored.
                 Any other is loaded as a component beside the control of the axis, which holds it before and after
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
            return self._played(self.rows(profile, None), profile, progress)
        if isinstance(control, Loop):
            made, there = Quantity(control.sample_time, "s"), Quantity(self.sample_time, "s")
            if round(1e9 * control.sample_time) != round(1e9 * self.sample_time):
                raise ParameterError(
                    f"{self.where}: the control is made for a sample time of {made:6 us}, and the thread has "
                    f"{there:6 us}: tune it for that, or change the thread"
                )
            control = control.control
        law = control.law
        if self.file.trial == "gains" and not isinstance(law, LinuxcncPid):
            law = self.as_pids(control)
        if isinstance(law, LinuxcncPid):
            before = self.inside()
            try:
                self._set(self.gains(law))
                return self._played(self.rows(profile, None), profile, progress)
            finally:
                self.restore(before)
        self.hal.load(self._trial(control), self._units)
        new = np.ones(profile.excitation.size) if acting is None else np.asarray(acting, dtype=float)
        return self._played(self.rows(profile, new), profile, progress)

    def inside(self) -> Mapping[str, str]:
        """Return what the gains of the axis's own pids are now, by pin."""
        return self.hal.values(self._gain_pins())

    def restore(self, inside: Mapping[str, str]) -> Text:
        """Set the gains that `inside` returned, read them back, and unload the control on trial."""
        self.hal.unload()
        self._set({pin: float(value) for pin, value in inside.items()})
        return Text(
            f"{self.where}: the {len(inside)} gains of before are set, as read back; the control on trial is unloaded"
            if inside
            else f"{self.where}: the control on trial is unloaded; the control of the axis was not changed"
        )

    def keep(self, machine_file: Path, export: Path, inside: Mapping[str, str] | None = None) -> Text:
        """Return what makes the new control that of the machine, and leave HAL as it was.

        LinuxCNC reads its own files at the next start: nothing that is set now would last.
        """
        if inside is not None:
            self.restore(inside)
        hal_files = sorted(
            file.name for end in ("hal", "ini") for file in export.glob(f"*.{end}") if file.stem != "desk"
        )
        components = sorted(file.name for file in export.glob("*.comp") if not file.stem.endswith("_plant"))
        install = "".join(f"sudo halcompile --install {export / name}; " for name in components)
        return Text(
            f"{self.where}: {install}take {', '.join(hal_files) or 'the export'} of {export} into your HAL and ini "
            f"files in place of the old control (made from {machine_file.name}). Until then LinuxCNC has the old one."
        )

    def _judged(self) -> BusDrive:
        """Return a drive in csp with these limits, by whose rules a profile is judged before it is played."""
        scaling = DriveScaling(increment=1e-9, rated_force=1e-3 * min(1.0, self.limits.force))
        return BusDrive(bus="ethercat", cycle_time=self.sample_time, scaling=scaling, limits=self.limits)

    def rows(self, profile: Profile, new: np.ndarray | None) -> np.ndarray:
        """Return the rows for the streamer: rest, switch, motion, rest, switch back, and an end.

        Set accelerations are central differences of the set position, as `Profile.reference` has them on every drive.
        """
        T, n = self.sample_time, profile.excitation.size
        rest, switch = round(SETTLING / T), round((HANDOVER + SETTLING) / T)
        # the brake opens as slowly as it closes
        opened = rest + round(self.file.brake_time / T)
        before = opened + (switch if new is not None and new[0] else 0)
        after = rest + (switch if new is not None and new[-1] else 0)
        rows = np.zeros((before + n + after + 1, len(FED)))
        at = {name: rows[:, i] for i, name in enumerate(FED)}
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
            at["new"][opened:before] = 1.0 if new[0] else 0.0
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
            fed[:, FED.index(name)] *= self._units
        self.hal.limit(self.file)
        with interruption(keys=True) as interrupted:

            def stopped(played: int) -> bool:
                if progress is not None:
                    # unlike `step`, it never raises: a cancel must end the motion by braking
                    progress.show_step(profile.name, min(played, len(rows)), len(rows), "")
                return interrupted() > 0 or (progress is not None and progress.cancelled)

            ended, taken = self.hal.play(fed, stopped, self.sample_time, listens=listens)
        log, why = self._log(taken, profile), self._why(ended)
        if why:
            log = replace(log, provenance={**log.provenance, "aborted": why})
        unwatched = [name for name in ("acceleration", "energy") if getattr(self.limits, name) is not None]
        remarks = [f"limits.{name} is not watched in LinuxCNC." for name in unwatched]
        if ended["overruns"]:
            remarks.append(f"{ended['overruns']} rows of the log were lost: the program was too slow to take them")
        return Played(log, Text(why) if why else None, 0, None, tuple(remarks), _CAUSES.get(int(ended["fault"]), ""))

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
        failed = FAULTS.get(int(ended.get("trial", 0)), "it does not run")
        words = {
            1: "stopped by hand; the axis was braked" if ended["played"] else "stopped by hand before it began",
            2: f"no row came after row {ended['played']}: the program that plays was too slow, or failed; the axis was "
            "braked",
            7: f"the position is not a number{row}{end}",
            8: f"the output of a control is not a number{row}{end}",
            9: f"the control on trial reports a fault{row}: {failed}; the control of the axis took over and braked",
            10: f"the drive reports a fault{row}{end}",
            11: Text(
                f"the axis runs away{row}: it flees from its target, {Quantity(length, 'm'):SI} off, driven by its "
                f"force: a sign is wrong, or a load drives it{end}"
            ),
            12: Text(
                f"position = {Quantity(length, 'm'):6 SI}, where the axis could come to rest{row}, is beyond "
                "limits.position_least or position_most; the axis was braked"
            ),
            13: Text(
                f"the row after {ended['played']} asks for {Quantity(abs(length), 'm/s'):SI}, more than "
                f"limits.velocity = {Quantity(limits.velocity, 'm/s'):SI}; the axis was braked"
            ),
        }
        return words[code]

    def _trial(self, control: Control) -> Routine:
        """Return the routine of a control on trial. Raises StructureError for one without a guard."""
        loop = self._loop(control)
        require_guard(loop)
        return controller_routine(loop, TRIAL)

    def _loop(self, control: Control) -> Loop:
        """Return a loop with the control, for its encoders and its unit; the axis in it is none of this machine."""
        actuator = Actuator(motor=Direct(force_constant=abs(self._per_output)))
        if not self.file.motor_position:
            axis = Axis(plant=Rigid(mass=1.0), actuator=actuator)
        else:
            plant = TwoMass(mass_motor=1.0, mass_load=1.0, stiffness=1.0)
            axis = Axis(plant=plant, actuator=actuator, encoder_motor=Encoder(), encoder_load=Encoder())
        return Loop(control=control, axis=axis, sample_time=self.sample_time, name=self.file.axis)

    def as_pids(self, control: Control) -> LinuxcncPid:
        """Return a P-PI cascade as the pids that the axis has.

        Raises StructureError for a control that is more than pids can be, and the errors of `stock_law`.
        """
        more = [name for name in ("prefilter", "compensation", "filters") if getattr(control, name)]
        more += [block.kind for block in control.feedforward if not isinstance(block, Inertia)]
        if more:
            raise StructureError(
                f"{self.where}: the control has a {more[0]}, and the gains of pids make none: leave it out of the "
                'control, or write  trial = "component"  into the file of the axis'
            )
        route = "two" if self.file.velocity_pid else "one"
        return stock_law(read_cascade(self._loop(control)), route=route, units=self._units)

    def _gain_pins(self) -> list[str]:
        pins = [f"{pid}.{gain}" for pid in (self.file.position_pid, self.file.velocity_pid) if pid for gain in _GAINS]
        return pins + [f"{self.file.forward}.{gain}" for gain in _FORWARD if self.file.forward]

    def gains(self, law: LinuxcncPid) -> dict[str, float]:
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
        if law.units != self._units or law.force_per_output != abs(self._per_output):
            raise ParameterError(
                f"{self.where}: the gains are for {law.units:.9g} units in a metre and {law.force_per_output:.9g} N "
                f"per unit of the output, and this axis has {self._units:.9g} and {abs(self._per_output):.9g}"
            )
        last = law.position if law.velocity is None else law.velocity
        # of a drive whose command counts against the force
        sign = 1.0 if self._per_output > 0.0 else -1.0
        values: dict[str, float] = {}
        for name, pid in ((file.position_pid, law.position), (file.velocity_pid, law.velocity)):
            if pid is not None:
                turned = _OF_OUTPUT if pid is last else ()
                values |= {
                    f"{name}.{gain}": (sign if gain in turned else 1.0) * float(getattr(pid, gain)) for gain in GAINS
                }
                values[f"{name}.error-previous-target"] = float(pid.error_previous_target)
        if file.forward:
            gains = (law.acceleration_gain or 0.0, law.velocity_gain or 0.0, last.bias)
            values |= {f"{file.forward}.{name}": sign * float(gain) for name, gain in zip(_FORWARD, gains, strict=True)}
        return values

    def _set(self, values: Mapping[str, float]) -> None:
        """Set pins and read them back. Raises BusError, after restoring them, for one that reads back otherwise."""
        if values:
            self.hal.write(values)


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

    folder  where the files are written; `axis.toml` there may be changed and read again by `read_linuxcnc_file`
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
        increment=getattr(loop.axis.encoder_load, "resolution", None),
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
        "axis.toml": "\n".join(lines_of(file)) + "\n",
    }
    for written, content in files.items():
        write_whole(folder / written, content)
    return LinuxcncAxis(read_linuxcnc_file(folder / "axis.toml"), paced=paced)

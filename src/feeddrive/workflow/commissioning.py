"""The axis of a drive from its commissioning file: plant, current loop and controllers.

Everything is fitted at the motor shaft, where the tool measured. The machine file of a rotary axis also refers to the
motor shaft; that of a linear axis has a screw whose lead is the travel per motor turn.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.families import Plant
from feeddrive.blocks.plant.modal import Modal
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.plant.screw_two_mass import ScrewTwoMass
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.files.commissioning import Commissioning, require_plant
from feeddrive.files.machine import MachineFile, machine_of_text, machine_toml, with_standard_errors
from feeddrive.files.toml_file import TomlEdit
from feeddrive.identification.regression import lever
from feeddrive.identification.response.plant_fit import (
    AxisFits,
    ModelBand,
    PlantFit,
    fit_axis,
    fit_two_mass,
    on_lines,
    simplest,
    two_mass_band,
)
from feeddrive.language.errors import FeeddriveError, LogError, ParameterError, nearest
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity, number, span
from feeddrive.language.text import Text
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.frequency_response import AVERAGES, FRF
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine
from feeddrive.tuning.operating_point import OperatingPoint, measured_point, with_table_force

_TURNING, _LINEAR = "(rad/s)/(N m)", "(m/s)/N"
# of the position gain over the velocity loop's rate: above it no position loop is stable, so that a number read in
# 1000/min was in 1/s
_FASTEST = 0.6
_RATE = 4.0  # the position gain of a file without one is the velocity loop's rate over this, as in `recipes`
_LATE = math.pi / 2.0  # phase lag up to which the lag and the dead time of a current loop are fitted
_FEW = 8  # lines of a current loop
# share by which a fitted inertia may differ from the tool's own: that is a straight line through few points, 10 % off
TOOL_OFF = 0.15
NO_CLOCK = "states no sample time of the speed loop (m_dProcessUpdateTime): give it with --sample-time"


@dataclass(frozen=True)
class DriveAxis:
    """The axis of a commissioning file, measured and modeled.

    plant     speed over torque of the motor, cut to the usable band, with variance
    current   torque over its setpoint at the frequency lines of the plant; None if the file has none
    band      the band in which the model was fitted; None if it was given by the user
    result    the fitted structures, at the motor in kg m2 (kg for a linear motor)
    loop      the existing loop: the fitted axis and the file's controller; None if no sample time is known
    """

    file: Commissioning
    plant: FRF
    current: FRF | None
    band: ModelBand | None
    result: AxisFits
    loop: Loop | None
    remarks: tuple[str, ...]

    @property
    def name(self) -> str:
        """The axis name for a machine file."""
        return axis_key(self.file.axis)

    @property
    def today(self) -> Loop:
        """The present loop. Raises LogError if no sample time is known."""
        if self.loop is None:
            raise LogError(f"{self.file.name}: {NO_CLOCK}")
        return self.loop

    def machine(self) -> MachineFile:
        """Return the machine file of the axis."""
        return machine_of_text(self.text(), "machine.toml")

    def text(self) -> str:
        """Return the text of the machine file, with standard errors as comments."""
        text = machine_toml(
            Machine.of({self.name: self.today}),
            f"axis {self.file.axis or self.name} from a commissioning file",
            f"feeddrive identify {_plain(self.file.name)}",
            "Plant, current loop and controllers as in the file; limits, friction and counts of the encoder are not in "
            "it: add them." + _reach(self),
        )
        edit = TomlEdit(text, "machine.toml")
        place = ("axis", self.name, "plant")
        if isinstance(self.today.axis.plant, TwoMass | Rigid):
            errors: dict[str, float] = {}
            for estimate in self.result.fit.estimates:
                if edit.has((*place, estimate.name)):
                    errors[f"plant.{estimate.name}"] = float(estimate.error)
                    error = Quantity(estimate.error, estimate.unit, form="2 SI")
                    edit.comment((*place, estimate.name), f"standard error {error}")
            with_standard_errors(edit, self.name, errors)
        return edit.text

    def point(self) -> tuple[OperatingPoint, list[str]]:
        """Return the measured operating point of the speed loop and the position loop, in rad/(N m), and remarks.

        The position is defined such that its difference over a sample is the measured speed, so that the velocity loop
        is exactly the measured one.  The current loop is the measured one.
        """
        loop = self.today
        T = float(loop.sample_time)
        f = self.plant.frequency
        inside = f < 0.5 / T
        plant = on_lines(self.plant, inside)
        f = plant.frequency
        whole = T / (1.0 - np.exp(-2j * np.pi * f * T))
        if self.current is not None:
            whole = whole * self.current.response[inside]
        else:
            whole = whole * np.exp(-2j * np.pi * f * _delay_of(loop.axis.actuator))
        # at the table of a linear axis
        r = 1.0 if loop.axis.rotary or self.file.linear_motor else _travel(self.file)
        size = whole * r * r
        variance = None if plant.variance is None else np.abs(size) ** 2 * plant.variance
        load = replace(plant, response=size * plant.response, variance=variance, unit="m/N")
        point = measured_point(load, sample_time=T, name=self.name)
        point, words = with_table_force(point, loop, "the fitted plant")
        return point, [words] if words else []


def axis_key(name: str) -> str:
    """Return an axis name as a key for a machine file; x if the name is not a valid key."""
    key = re.sub(r"\W", "_", name.strip().lower())
    return key if re.fullmatch(r"[a-z]\w{0,15}", key) else "x"


def _plain(name: str) -> str:
    return "".join(letter for letter in name if letter.isprintable())


def _reach(axis: DriveAxis) -> str:
    if axis.band is None or axis.band.whole:
        return ""
    return str(
        Text(
            f" The plant holds up to {Quantity(axis.band.high, 'Hz')}: modes above it are only in the measured "
            "response, so tune on the XML file."
        )
    )


def drive_axis(
    file: Commissioning,
    progress: Progress,
    *,
    motor: str | None = None,
    band: tuple[float, float] | None = None,
    rotary: bool = False,
    lead: float | None = None,
    gear: float = 1.0,
    sample_time: float | None = None,
    model: str = "auto",
    modes: int | None = None,
    fixed: Mapping[str, float] | None = None,
) -> DriveAxis:
    """Return the axis of a commissioning file, with a fitted model.

    motor         name of the plant response; default: the one measured last
    band          band of the frequency lines to be fitted, Hz; default: from the lowest usable frequency stated in the
                  file up to the highest one at which two masses explain the response
    rotary, lead, gear, sample_time   data missing from the file: True for a rotary axis, or the lead and gear of its
                  screw, and the sample time of the speed loop
    model, modes, fixed  as for `fit_axis`

    Raises LogError if the file contains no plant, ParameterError if no structure can be fitted or a name is unknown.
    """
    if lead is not None:
        file = replace(file, rotary=False, per_motor=lever(lead, gear))
    elif rotary:
        file = replace(file, rotary=True)
    file = replace(file, clock=file.clock or sample_time)
    name = require_plant(file) if motor is None else motor
    if name not in file.responses:
        raise ParameterError(
            f"{file.name}: there is no response '{name}'{nearest(name, file.responses)}: name one of "
            f"{', '.join(file.plants)} with --motor"
        )
    remarks = [*_choice(file, name)]
    plant, words = _measured(file, name, band)
    remarks += words
    progress.step("band of the model")
    chosen = two_mass_band(plant, held=False) if band is None and model == "auto" and modes is None else None
    fitted = partial(_fitted, plant, band=band, model=model, modes=modes, fixed=dict(fixed or {}), progress=progress)
    result = fitted(chosen)
    # a mode between the lines from which the band was chosen, where most lines are noise
    while chosen is not None and result.fit.agreement.poor and (lower := chosen.lower()) is not None:
        chosen, result = lower, fitted(lower)
    if chosen is not None and not chosen.whole:
        remarks.append(
            Text(
                f"the model is fitted from {span(chosen.low, chosen.high, 'Hz')}, where two masses explain the "
                "response; what lies above is tuned on as it was measured"
            )
        )
    current = _current_loop(file, plant)
    actuator, words = _actuator(file, current, result.fit)
    remarks += words
    loop, words = (None, []) if file.clock is None else _today(file, result.fit, actuator)
    remarks += words
    remarks += compared(file, float(result.fit.plant.rigid_mass()))
    return DriveAxis(file, plant, current, chosen, result, loop, tuple(remarks))


def _choice(file: Commissioning, name: str) -> list[str]:
    """Return a remark on the plant that was selected if the file has several."""
    if len(file.plants) < 2:
        return []
    others = [other for other in file.plants if other != name]
    when = f", measured {file.stamps[name]}" if file.stamps.get(name) else ""
    return [f"of {len(file.plants)} plants '{name}' is taken{when}; another one with --motor {others[0]}"]


def _measured(file: Commissioning, name: str, band: tuple[float, float] | None) -> tuple[FRF, list[str]]:
    """Return the plant on its usable lines, with the variance computed from its coherence, and remarks."""
    frf = file.responses[name]
    unit = _LINEAR if file.linear_motor else _TURNING
    frf = replace(frf, unit=frf.unit or unit)
    remarks: list[str] = []
    low, high = band or (file.usable_from or 0.0, math.inf)
    inside = (frf.frequency >= low) & (frf.frequency <= high)
    left = int(np.count_nonzero(~inside))
    if band is None and left:
        remarks.append(
            Text(
                f"{left} lines below {Quantity(low, 'Hz'):3} are left out: the tool calls the plant usable from there "
                "(all lines with --band)"
            )
        )
    if np.count_nonzero(inside) < 2 * _FEW:
        raise LogError(
            f"{file.name}: {np.count_nonzero(inside)} lines of '{name}' from {span(low, high, 'Hz')} are too few; give "
            "another band with --band"
        )
    frf = on_lines(frf, inside)
    if frf.coherence is not None:
        frf = replace(frf, variance=frf.known_variance(file.averages or AVERAGES))
        if file.averages is None:
            remarks.append(
                f"the number of averages is not in the file: {AVERAGES} are taken for the noise that the coherence "
                "shows"
            )
    return frf, remarks


def _fitted(
    plant: FRF,
    chosen: ModelBand | None,
    band: tuple[float, float] | None,
    model: str,
    modes: int | None,
    fixed: Mapping[str, float],
    progress: Progress,
) -> AxisFits:
    """Fit a rigid mass and two masses in the band `chosen` or, without it, the structures selected by the user."""
    if chosen is None:
        structure = None if model == "auto" else model
        return fit_axis(plant, structure=structure, modes=modes, fixed=fixed, held=False, band=band, progress=progress)
    fits: dict[str, PlantFit] = {}
    refused: dict[str, str] = {}
    common: dict[str, Any] = {"fixed": fixed, "held": False, "band": (chosen.low, chosen.high)}
    ways = {
        "rigid": lambda: fit_axis(plant, structure="rigid", **common).fit,
        "two-mass": lambda: fit_two_mass(plant, begin=chosen.begin, **common),
    }
    for name, way in ways.items():
        progress.step(name)
        try:
            fits[name] = chosen.widened(way())
        except FeeddriveError as error:
            refused[name] = Text(f"{error}")
    if not fits:
        raise ParameterError("; ".join(f"{name}: {why}" for name, why in refused.items()))
    return AxisFits(fits, simplest(fits), refused)


def _current_loop(file: Commissioning, plant: FRF) -> FRF | None:
    """Return the measured current loop at the frequency lines of the plant; None if the file has none that covers them.

    If its lines differ from those of the plant, ln |H| and phase are interpolated.
    """
    if file.current_loop is None:
        return None
    frf = file.responses[file.current_loop]
    f = plant.frequency
    if frf.frequency.size < _FEW or frf.frequency[0] > f[0] or frf.frequency[-1] < 0.5 * f[-1]:
        return None
    x, there = np.log(frf.frequency), np.log(f)
    level = np.interp(there, x, np.log(np.maximum(np.abs(frf.response), 1e-12)))
    phase = np.interp(there, x, np.unwrap(np.angle(frf.response)))
    return FRF(f, np.exp(level + 1j * phase), frf.input, frf.output)


def _actuator(file: Commissioning, current: FRF | None, fit: PlantFit) -> tuple[Actuator, list[str]]:
    """Return the dead time and current loop of the model, and remarks.

    The measured delays refer to sampled signals. The simulated loop adds half a sample for the zero-order hold and half
    a sample for the differenced velocity; therefore one sample is subtracted.
    """
    estimate = fit["dead_time"]
    late = float(estimate.value)
    T = file.clock or 0.0
    remarks: list[str] = []
    if late < -3.0 * estimate.error and current is not None:
        remarks.append(
            Text(
                f"the plant's dead time of {Quantity(late, 's'):3} is negative: its torque was logged that much late, "
                "or a mode above the band is missing; in the loop it is taken off the delay of the current loop, whose "
                "torque is the same"
            )
        )
    if current is None:
        remarks.append(
            "the file has no response of the current loop: the torque is taken as its setpoint, so give the actuator "
            "its current_loop, and leave margin"
        )
        return Actuator(dead_time=max(late, 0.0)), remarks
    phase = np.unwrap(np.angle(current.response))
    ends = np.flatnonzero(phase < -_LATE)
    used = slice(0, max(int(ends[0]) if ends.size else phase.size, _FEW))
    w = 2.0 * np.pi * current.frequency[used]
    target = np.log(np.abs(current.response[used])) + 1j * (phase[used] - w * late + w * T)
    corner, dead = _lag(w, target)
    off = float(np.sqrt(np.mean(np.abs(np.log(_delayed(w, corner, dead)) - target) ** 2)))
    lag = "" if corner is None else Text(f"{Quantity(corner, 'Hz')} and ")
    remarks.append(
        Text(
            f"current loop as measured ({file.current_loop}): the model has {lag}a dead time "
            f"of {Quantity(dead, 's'):3}, within {Quantity(8.686 * off, 'dB'):2} up to "
            f"{Quantity(current.frequency[used][-1], 'Hz')}"
        )
    )
    return Actuator(dead_time=dead, current_loop=corner), remarks


def _delayed(w: np.ndarray, corner: float | None, dead: float) -> np.ndarray:
    late = np.exp(-1j * w * dead)
    return late if corner is None else late / (1.0 + 1j * w / (2.0 * np.pi * corner))


def _lag(w: np.ndarray, target: np.ndarray) -> tuple[float | None, float]:
    """Return corner (Hz) and dead time (s, >= 0) of the first-order lag closest to ln H, weighted equally over ln f.

    The corner is None if the response does not roll off within these frequency lines.
    """
    weight = np.gradient(np.log(w))
    corners = np.geomspace(0.3 * w[-1], 100.0 * w[-1], 400) / (2.0 * np.pi)
    best = (math.inf, float(corners[0]), 0.0)
    for corner in corners:
        bare = -np.log(1.0 + 1j * w / (2.0 * np.pi * corner))
        # the dead time of least squares for this corner, which only turns the phase
        dead = max(float(-np.sum(weight * w * np.imag(target - bare)) / np.sum(weight * w * w)), 0.0)
        cost = float(np.sum(weight * np.abs(bare - 1j * w * dead - target) ** 2))
        if cost < best[0]:
            best = cost, float(corner), dead
    return None if best[1] == float(corners[-1]) else best[1], best[2]


def _delay_of(actuator: Actuator) -> float:
    """Return the dead time to be added to a speed measurement that does not include the delays of the drive."""
    return float(actuator.delay())


def _travel(file: Commissioning) -> float:
    """Return the travel of a linear axis per radian of its motor, m/rad."""
    assert file.per_motor is not None
    return abs(file.per_motor)


def is_linear(file: Commissioning) -> bool:
    """Return True for a linear axis with a rotary motor and a known travel per turn."""
    return file.rotary is False and not file.linear_motor and bool(file.per_motor)


def _at_axis(plant: Any, file: Commissioning) -> Plant:
    """Return the fitted plant referred to the table of a linear axis; that of a rotary axis remains at its motor."""
    if not is_linear(file):
        return plant
    r = _travel(file)
    scale = 1.0 / (r * r)
    if isinstance(plant, TwoMass):
        return ScrewTwoMass(
            inertia_motor=plant.mass_motor,
            lead=2.0 * math.pi * r,
            mass_load=scale * plant.mass_load,
            stiffness=scale * plant.stiffness,
            damping=scale * plant.damping,
            viscous_bearings=plant.viscous_motor,
            viscous_load=scale * plant.viscous_load,
        )
    if isinstance(plant, Rigid):
        return Rigid(mass=scale * plant.mass, viscous=scale * plant.viscous)
    assert isinstance(plant, Modal)
    modes = tuple(replace(mode, mass=scale * mode.mass) for mode in plant.modes)
    return Modal(mass=scale * plant.mass, viscous=scale * plant.viscous, modes=modes)


def _today(file: Commissioning, fit: PlantFit, actuator: Actuator) -> tuple[Loop, list[str]]:
    """Return the loop of the fitted axis with the file's controller, and remarks."""
    remarks: list[str] = []
    inertia = float(fit.plant.rigid_mass())
    T = file.clock
    assert T is not None
    controller = file.today
    if controller is None:
        delay = float(actuator.delay()) + T
        # a quarter of 1/delay leaves a phase margin of 60 deg, as in `recipes`
        rate = 0.25 / delay
        Kp, Tn, filters = inertia * rate, _RATE / rate, ()
        remarks.append(
            Text(
                f"the file holds no speed controller: {Quantity(Kp, _gain_unit(file))} and {Quantity(Tn, 's'):3} are a "
                "start, not what runs"
            )
        )
    else:
        Kp, Tn, filters = controller.Kp, controller.Tn, controller.filters
        remarks += _said(file)
    Kv, words = _position_gain(file, Kp / inertia)
    remarks += words
    every = 1
    if file.position_clock is not None and not file.dsc:
        every = max(round(file.position_clock / T), 1)
        remarks.append(
            Text(f"speed loop every {Quantity(T, 's'):6}, position loop every {Quantity(file.position_clock, 's'):6}")
        )
        if file.delays > 0.0:
            remarks.append(
                Text(
                    f"the position loop has further delays of {Quantity(file.delays, 's'):3} in the file, which the "
                    f"law has no part for: they take {Quantity(Kv * file.delays, 'rad'):2 deg} of its phase"
                )
            )
    scale = 1.0 if not is_linear(file) else 1.0 / _travel(file) ** 2
    law = CascadePPI(Kv=Kv, Kp=scale * Kp, Tn=Tn, velocity_encoder="motor", position_every=every)
    turns = not is_linear(file) and not file.linear_motor
    if turns and not file.rotary:
        remarks.append(
            "the file does not say how far the axis moves with its motor: everything is at the motor's shaft, in kg m2 "
            "and N m s/rad; give --lead for a screw"
        )
    if file.second_encoder:
        remarks.append(
            "the position loop reads a direct encoder, whose response is not in the file: the motor's is taken for both"
        )
    axis = Axis(plant=_at_axis(fit.plant, file), actuator=actuator, encoder_motor=Encoder(), rotary=turns)
    return Loop(control=Control(law=law, filters=filters), axis=axis, sample_time=T), remarks


def _gain_unit(file: Commissioning) -> str:
    return "N s/m" if file.linear_motor else "N m s/rad"


def _said(file: Commissioning) -> list[str]:
    """Return remarks on the controllers in the file: the active one, its predecessor, and unsupported parts."""
    today = file.today
    assert today is not None
    unit = _gain_unit(file)

    def gains(Kp: float, Tn: float | None) -> str:
        return (
            Text(f"Kp {Quantity(Kp, unit):4}, Tn {Quantity(Tn, 's'):4}") if Tn else Text(f"Kp {Quantity(Kp, unit):4}")
        )

    before = file.controllers[:-1]
    instead = Text(f"; before it {gains(before[0].Kp, before[0].Tn)}") if before else ""
    remarks: list[str] = [
        Text(
            f"today's law is speed controller {len(file.controllers)} of the file: {gains(today.Kp, today.Tn)}{instead}"
        )
    ]
    if today.left:
        remarks.append(f"left out of today's law: {', '.join(today.left)}")
    return remarks


def _position_gain(file: Commissioning, rate: float) -> tuple[float, list[str]]:
    """Return the position gain in 1/s, and remarks; `rate` is the bandwidth of the velocity loop, 1/s."""
    if file.Kv is None:
        return rate / _RATE, [
            Text(f"the file holds no position gain: {Quantity(rate / _RATE, '1/s'):3} is a start, not what runs")
        ]
    read = file.Kv / 0.06
    if read <= _FASTEST * rate:
        return read, [Text(f"position gain {Quantity(file.Kv):4} (1000/min, as MD32200) is {Quantity(read, '1/s'):4}")]
    return file.Kv, [
        Text(
            f"position gain {Quantity(file.Kv):4} is read in 1/s: in 1000/min it would be {Quantity(read, '1/s'):4}, "
            f"more than a velocity loop of {Quantity(rate, '1/s'):3} carries"
        )
    ]


def compared(file: Commissioning, inertia: float) -> list[str]:
    """Return remarks that compare the tool's model with the fitted `inertia` at the motor, in kg m2 or kg.

    The tool's inertia and that of the motor are a second source for the scales of torque and speed.
    """
    unit = "kg" if file.linear_motor else "kg m2"
    fitted = Quantity(inertia, unit)
    if file.motor_inertia is not None and inertia < (1.0 - TOOL_OFF) * file.motor_inertia:
        return [
            Text(
                f"the fitted inertia of {fitted} is less than that of the motor alone, "
                f"{Quantity(file.motor_inertia, unit)} by the file: torque or speed is read "
                f"{number(file.motor_inertia / inertia)} times or more off (torque constant, unit), or the response is "
                "of another motor"
            )
        ]
    own: list[str] = []
    if file.inertia is not None:
        own.append(Text(f"inertia {Quantity(file.inertia, 'kg' if file.linear_motor else 'kg m2'):4}"))
    if file.antiresonance is not None:
        own.append(Text(f"first zero {Quantity(file.antiresonance, 'Hz'):4}"))
    remarks: list[str] = [Text(f"the tool's own model: {', '.join(map(str, own))}")] if own else []
    if file.inertia is not None and abs(inertia / file.inertia - 1.0) > TOOL_OFF:
        remarks.append(
            Text(
                f"the fitted inertia of {fitted} is {number(inertia / file.inertia)} times the tool's own: torque or "
                "speed has another scale in one of them, as by the torque constant, or the load was changed since"
            )
        )
    return remarks

"""The firmware of a virtual drive: CiA 402 around the simulated loop of a machine file, and its process data."""

import math
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from feeddrive.blocks.actuator.screw import Screw
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.force.gravity import Gravity
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.blocks.signals import Setpoint
from feeddrive.bus import cia402
from feeddrive.bus.cia402 import Layout, PowerState
from feeddrive.bus.drive_file import DriveScaling, interpolation_time
from feeddrive.bus.faults import FaultActor, InjectedFault
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.language.quantity import Quantity
from feeddrive.language.units import turning_docstring as turning
from feeddrive.loop.axis import Axis
from feeddrive.loop.engine.llvm import Native
from feeddrive.loop.guard import TRIP_COMMAND, TRIP_FOLLOWING_ERROR, TRIP_READING, TRIP_TRAVEL, TRIP_VELOCITY, Guard
from feeddrive.loop.loop import Loop
from feeddrive.loop.runner import Prepared

# The loop of a machine file as simulated by a virtual drive, some samples per call, and its drive file.
#
# It runs with its complete control, with the velocity loop only, or with a commanded force.  Increments and rated
# torque are taken from the machine file.

_RECORD = ("reading_load", "reading_motor", "force", "trip")


class Sample(NamedTuple):
    """The last sample of a call: encoder readings (m), the force applied afterwards (N), the guard's trip code."""

    position: float
    second: float
    force: float
    trip: float


_LEAST_FORCE = 1e-9  # N: a force limit is above 0


class DrivenAxis:
    """A plant with its controller, simulated step by step by the same native code as in `simulate`.

    A controller without a guard is given a guard without limits, because only a guard can switch it on and off.
    """

    def __init__(self, loop: Loop, position: float = 0.0, seed: int = 0) -> None:
        if loop.control.guard is None:
            loop = replace(loop, control=replace(loop.control, guard=Guard()))
        self.loop = loop
        self.sample = 0
        begin = Setpoint(np.float64(position), *[np.float64(0.0)] * 4)
        prepared = Prepared(loop, begin, (position, 0.0), seed)
        self._closed = self._native(prepared, "added_force")
        self._open = self._native(prepared, "cut")
        if [s.name for s in self._closed.plan.states] != [s.name for s in self._open.plan.states]:
            raise StructureError("the axis has other states in an open loop: it cannot be driven by force")
        self._states = prepared.states(self._closed)
        self.constants = prepared.constants(self._closed)
        self.places = {name: row for row, (name, _) in enumerate(self._closed.plan.constants)}
        self.control = "control"
        self._of_open = prepared.constants(self._open)
        self._tables = prepared.rows(self._closed), prepared.rows(self._open)
        motor, load = loop.axis.still(position)
        self.last = Sample(float(load), float(motor), 0.0, 0.0)

    @property
    def encoders(self) -> int:
        """The number of encoders."""
        return self.loop.axis.encoders()

    @property
    def has_velocity_loop(self) -> bool:
        """True if the law is a cascade: its velocity loop can run alone, with a position gain of 0."""
        return isinstance(self.loop.control.law, CascadePPI)

    @property
    def has_sign(self) -> bool:
        """True if the force of the law has one gain, Kp, whose sign is that of the force."""
        return self.has_velocity_loop and f"{self.control}.law.Kp" in self.places

    @property
    def gains(self) -> dict[str, float]:
        """The gains of a cascade in SI, as they are now; empty for another law."""
        if not self.has_velocity_loop:
            return {}
        rows = {name: self.places.get(f"{self.control}.law.{name}") for name in ("Kv", "Kp", "Tn")}
        return {name: float(self.constants[row, 0]) for name, row in rows.items() if row is not None}

    def set_gain(self, name: str, value: float) -> None:
        """Change a gain of the cascade from the next cycle on: its integral is a force, which stays."""
        self.constants[self.places[f"{self.control}.law.{name}"]] = value

    def change(self, constants: np.ndarray, *, alone: bool, sign: float, most: float) -> None:
        """Change a copy of the constants for one cycle; see `follow`."""
        law = f"{self.control}.law."
        if alone:
            # without its position gain, and with all of the set velocity, a cascade is its velocity loop alone
            constants[self.places[f"{law}Kv"]] = 0.0
            constants[self.places[f"{law}velocity_feedforward"]] = 1.0
        if sign < 0.0:
            # the whole force has the sign of Kp, that of the integral as well
            constants[self.places[f"{law}Kp"]] *= sign
        limit = self.places.get(f"{self.control}.force_limit")
        if limit is not None:
            # of the control alone: against an added force it needs as much itself, and their sum stays small
            constants[limit] = np.minimum(constants[limit], max(_LEAST_FORCE, most))

    def stand(self, samples: int, force: float = 0.0) -> Sample:
        """Let time pass for an axis that its brake holds, whatever force (N) the drive makes."""
        self.sample += samples
        self.last = self.last._replace(force=force, trip=0.0)
        return self.last

    @staticmethod
    def _native(prepared: Prepared, probe: str) -> Native:
        program = prepared.program(load=False, enable=True, probes=(probe,))
        return prepared.native(program, record=_RECORD)

    def follow(
        self,
        position: np.ndarray,
        velocity: np.ndarray,
        added_force: float,
        enable: bool,
        alone: bool = False,
        sign: float = 1.0,
        most: float = math.inf,
    ) -> Sample:
        """Run one sample for each set position (m) and velocity (m/s), adding a force (N) after the force limit.

        With `alone` only the velocity loop runs.  Without `enable` no force acts.  With `sign` = -1 every force acts
        the other way.  What is added stays within `most` (N), and so does the force of a control with a force limit.
        """
        added = max(-most, min(most, sign * added_force * enable))
        values = {"set_position": position, "set_velocity": velocity, "added_force": added}
        constants = self.constants.copy()
        self.change(constants, alone=alone, sign=sign, most=most)
        return self._run(self._closed, constants, values, enable, position.size, 0)

    def push(self, force: float, samples: int) -> Sample:
        """Apply a force (N) directly to the axis with the controller switched off."""
        last = self._run(self._open, self._of_open, {"cut": force}, False, samples, 1)
        self.last = last._replace(force=force)
        return self.last

    def _run(
        self, native: Native, constants: np.ndarray, values: Mapping[str, Any], enable: bool, count: int, table: int
    ) -> Sample:
        inputs = np.zeros((count, len(native.plan.inputs)))
        for column, (name, _) in enumerate(native.plan.inputs):
            inputs[:, column] = float(enable) if name == "enable" else values.get(name, 0.0)
        outputs = np.empty((count, len(_RECORD)))
        native.run(count, self.sample, constants, inputs, self._states, outputs, self._tables[table])
        self.sample += count
        names = [name for name, _ in native.plan.outputs]
        row = dict(zip(names, outputs[-1].tolist(), strict=True))
        # a trip in any sample of the bus cycle is a fault of the drive
        trip = max(outputs[:, names.index("trip")])
        added = float(inputs[-1, [n for n, _ in native.plan.inputs].index("added_force")]) if table == 0 else 0.0
        self.last = Sample(row["reading_load"], row["reading_motor"], row["force"] + added, float(trip))
        return self.last


# 32 bits of it are 21 m to either side
_INCREMENT = 10e-9  # m, of an encoder without resolution
_PEAK = 3.0  # peak over rated force, where only the peak is stated
# a thousandth of it, the unit of the torque objects, is then 1 N
_FORCE = 1000.0  # N, rated, where nothing is stated


def scaling_of(loop: Loop) -> DriveScaling:
    """Return the scaling of a virtual drive: one increment per encoder count, and the continuous force as rated force.

    A motor on a screw gets a whole number of counts per revolution, and a rated torque of a whole number of mN m.
    """
    sensor = loop.axis.encoder_load or loop.axis.encoder_motor
    resolution = sensor.resolution if isinstance(sensor, Encoder) else None
    increment = _INCREMENT if resolution is None else float(resolution)
    motor = loop.axis.actuator.motor
    peak, continuous = (None, None) if motor is None else motor.limits()
    most = peak if peak is not None else loop.control.force_limit
    rated = float(continuous) if continuous is not None else float(most) / _PEAK if most is not None else _FORCE
    if not isinstance(motor, Screw):
        return DriveScaling(increment=increment, rated_force=max(1e-3, round(rated, 3)))
    lead, gear = float(motor.lead), float(motor.gear)
    torque = rated * float(motor.torque_constant) / float(motor.force_per_unit())
    return DriveScaling(
        counts_per_turn=float(max(1, round(lead / (gear * increment)))),
        lead=lead,
        gear=gear,
        rated_torque=max(1e-3, round(torque, 3)),
    )


_HELD_UP = 0.02  # s by which an ordinary computer may be late
_RESERVE = 1.5  # of the mass and breakaway force that are stated, over those of the axis
_SLOW = np.logspace(-9.0, -3.0, 25)  # m/s, among which friction is largest


def _resistance(axis: Axis) -> float | None:
    """Return the largest force on the axis at rest, friction plus weight, N; None if other forces act on it."""
    if not all(isinstance(force, Gravity) for force in axis.forces):
        return None
    frictions = [friction for friction in (axis.friction_motor, axis.friction_load) if friction is not None]
    # both signs: friction may depend on the direction; the viscous part is no resistance at rest
    held = sum(max(abs(float(law.steady(v) - law.linear() * v)) for v in (*-_SLOW, *_SLOW)) for law in frictions)
    return held + abs(sum(float(force.force) for force in axis.forces if isinstance(force, Gravity)))


def drive_text(loop: Loop, scaling: DriveScaling, bus: str, interface: str, station: int, cycle_time: float) -> str:
    """Return the text of a drive file for the virtual drive, with the limits of guard and controller, if any."""
    guard, limits = loop.control.guard, loop.control.force_limit
    velocity = None if guard is None else guard.velocity_limit
    following = None if guard is None else guard.following_error_limit
    force = 1000.0 * 3.0 * scaling.newton if limits is None else float(limits)
    resistance = _resistance(loop.axis)
    axis = (
        ""
        if resistance is None
        else (
            f'largest_mass = {_RESERVE * float(loop.axis.plant.rigid_mass()):.4g}   # kg, for mode = "cst"\n'
            f"breakaway_force = {_RESERVE * resistance:.4g}   # N, likewise\n"
        )
    )
    if scaling.turns:
        units = (
            f"counts_per_turn = {scaling.counts_per_turn:.0f}\nlead = {scaling.lead!r}\ngear = {scaling.gear!r}\n"
            f"rated_torque = {scaling.rated_torque!r}"
        )
    else:
        units = f"increment = {scaling.increment!r}\nrated_force = {scaling.rated_force!r}"
    if scaling.force_sign < 0:
        units += "\nforce_sign = -1"
    turns = loop.axis.rotary
    rotary = "rotary = true\n" if turns else ""
    text = (
        f"# The virtual drive of feeddrive; for your own drive look up every number.\n"
        f'bus = "{bus}"\ninterface = "{interface}"\nstation = {station}\ncycle_time = {cycle_time!r}   # s\n'
        f'mode = "csp"\n'
        f"{rotary}"
        f"late_cycles = {max(3, round(_HELD_UP / cycle_time))}   # for an ordinary computer; a real axis: 3\n\n"
        f"[scaling]\n{units}\n\n[limits]\ntravel = 0.5   # m, from where it starts, to both sides\n"
        f"velocity = {1.0 if velocity is None else float(velocity)!r}   # m/s\nforce = {force!r}   # N\n"
        f"following_error = {5e-3 if following is None else float(following)!r}   # m\n{axis}"
    )
    return _turned(text) if turns else text


def _turned(text: str) -> str:
    """Return the text of a drive file with the units of an axis that turns in its comments."""
    lines = (line.partition("   # ") for line in text.splitlines())
    return "".join(f"{entry}{mark}{turning(words) if mark else ''}\n" for entry, mark, words in lines)


# The firmware of a virtual drive: CiA 402 around an axis that is simulated by the code of `simulate`.
#
# One call of `cycle` is one bus cycle: the plant moves on by exactly that time, however long the cycle took on the
# clock.
#
# Its process data are defined by mapping and assignment objects.
#
# 0x1600.. and 0x1A00.. define the contents of a process data object, 0x1C12 and 0x1C13 the objects that an EtherCAT
# master uses, 0x1400.. and 0x1800.. the CAN messages that carry them.

OVERCURRENT = 0x2310  # error code of an injected fault of the power stage
VENDOR, PRODUCT, REVISION = 0, 0x66656564, 1  # vendor 0: not assigned
_TRIPPED = {
    TRIP_READING: 0x7305,
    TRIP_FOLLOWING_ERROR: 0x8611,
    TRIP_VELOCITY: 0x8400,
    TRIP_TRAVEL: 0x8612,
    TRIP_COMMAND: 0xFF01,
}
_NO_WINDOW = 0xFFFFFFFF  # of 0x6065: it disables the following error window (CiA 402); of 0x6080 no limit, either
# the axis trails the ramp of its setpoint, and the position loop brings it to rest meanwhile
_STANDSTILL = 0.2  # s that a quick stop holds the axis after its ramp
# faults in which position and power stage are sound: the drive brakes in them if 0x605E says so
_BRAKED = frozenset((0x7500, 0x8400, 0x8611, 0x8612))
_WRITABLE = {
    "controlword",
    "connection_option",
    "quick_stop_option",
    "disable_operation_option",
    "fault_reaction_option",
    "mode",
    "following_error_window",
    "following_error_timeout",
    "target_torque",
    "max_torque",
    "target_position",
    "position_least",
    "position_most",
    "max_motor_speed",
    "quick_stop_deceleration",
    "velocity_offset",
    "torque_offset",
    "cycle_value",
    "cycle_exponent",
    "target_velocity",
}


class Brake(NamedTuple):
    """A holding brake: the times that it takes to open once the drive is on, and to close once it is off, s."""

    opens: float
    closes: float


class _Gain(NamedTuple):
    """A gain of the cascade in an object of 32 bits, the SI value of one count of it."""

    name: str
    factor: float


# 0x60FB, the position control parameters, whose content CiA 402 leaves to the maker
GAIN_OBJECTS: Mapping[tuple[int, int], _Gain] = {
    (0x60FB, 1): _Gain("Kv", 0.01),
    (0x60FB, 2): _Gain("Kp", 0.1),
    (0x60FB, 3): _Gain("Tn", 1e-6),
}

# abort codes of SDO
READ_ONLY, NO_OBJECT, NO_SUBINDEX, WRONG_LENGTH, TOO_LARGE, WRONG_STATE = (
    0x06010002,
    0x06020000,
    0x06090011,
    0x06070010,
    0x06090030,
    0x08000022,
)


class SdoAbortError(Exception):
    """A refused SDO transfer, with its abort code."""

    def __init__(self, code: int) -> None:
        super().__init__(f"0x{code:08X}")
        self.code = code


class Firmware:
    """The firmware of a drive: object dictionary, power states and the three cyclic synchronous modes.

    csp  the controller of the machine file, with the target position as setpoint; the velocity offset is its set
         velocity, and the set acceleration is 0: acceleration feedforward arrives as torque offset, after the force
         limit
    csv  its velocity loop alone (a cascade with Kv = 0); not supported for laws without a velocity loop
    cst  torque applied directly to the axis, limited by 0x6072; the guard's limits of velocity and travel apply

    With a `brake` the axis stands until it has opened.  A drive that is switched off in order holds the axis until it
    has closed; in a fault, and on disable operation with 0x605C = 0, the axis falls meanwhile.  Without `changes_mode`
    the mode of operation is taken over only while the drive is off.  The gains of a cascade stand in `GAIN_OBJECTS`,
    and act from the next sample on.

    The target position is interpolated linearly over one bus cycle.  A quick stop decelerates the setpoint at the rate
    in 0x6085 and then switches off.  A fault does the same if 0x605E = 2 and the drive can still brake, and removes the
    force immediately otherwise.  `faults` are acted out in operation.
    """

    def __init__(
        self,
        axis: DrivenAxis,
        scaling: DriveScaling,
        cycle_time: float,
        faults: Sequence[InjectedFault] = (),
        *,
        brake: Brake | None = None,
        changes_mode: bool = True,
    ) -> None:
        """Set up the firmware. Raises ParameterError if `cycle_time` (s) is not a multiple of the sample time, and for
        a fault that the control of the axis cannot have.
        """
        self.axis, self.scaling, self.brake, self._changes_mode = axis, scaling, brake, changes_mode
        self._clamped = brake is not None
        self._moving = 0.0  # s for which the brake opens or closes
        self._kept: float | None = None  # m, where the axis is held until its brake has closed
        self._drops = False  # no force acts while the brake closes
        self.faults = FaultActor(faults, scaling.metre)
        if any(fault.kind == "sign" for fault in faults) and not axis.has_sign:
            raise ParameterError("the fault 'sign' needs a cascade, whose force has the sign of its gain Kp")
        self.T = float(axis.loop.sample_time)
        self.samples = round(cycle_time / self.T)
        if self.samples < 1 or abs(cycle_time / self.T - self.samples) > 1e-6:
            raise ParameterError(
                f"cycle_time = {Quantity(cycle_time, 's'):6 us} must be a whole multiple of the sample time of the "
                f"machine, {Quantity(self.T, 's'):6 us}"
            )
        self.cycle_time = self.samples * self.T
        self.state = PowerState.SWITCH_ON_DISABLED
        self.cycles = 0
        self._control_before = 0
        self._target: float | None = None  # m, where the last straight line ended
        self._braking: tuple[float, float] | None = None  # set position and velocity of a quick stop
        self._still = 0.0  # s since its ramp ended
        self._beyond = 0.0  # s for which the following error is beyond its window
        self.values = self._beginning()
        self._shares = np.arange(1, self.samples + 1) / self.samples
        self._show(axis.last.position, axis.last.second, 0.0, 0)

    def _beginning(self) -> dict[str, int]:
        scaling, guard = self.scaling, self.axis.loop.control.guard
        velocity = self.axis.has_velocity_loop
        cycle_value, cycle_exponent = interpolation_time(self.cycle_time)
        values = dict.fromkeys(cia402.OBJECTS, 0)
        window = None if guard is None or guard.following_error_limit is None else guard.following_error_limit
        values |= {
            "device_type": 0x00020192,
            "vendor": VENDOR,
            "product": PRODUCT,
            "revision": REVISION,
            "serial": 1,
            "connection_option": 1,
            "quick_stop_option": 2,
            "disable_operation_option": 1,
            "max_torque": 0xFFFF,
            "rated_torque": scaling.rated_milli,
            "following_error_window": _NO_WINDOW if window is None else scaling.increments(window),
            "max_motor_speed": _NO_WINDOW,
            "position_least": -(1 << 31),
            "position_most": (1 << 31) - 1,
            "quick_stop_deceleration": min(scaling.increments(5.0), _NO_WINDOW),
            "supported_modes": 1 << (cia402.CSP - 1)
            | 1 << (cia402.CST - 1)
            | (1 << (cia402.CSV - 1) if velocity else 0),
            "digital_inputs": 0xFFFF0000,  # contacts that are closed
            "cycle_value": cycle_value,
            "cycle_exponent": cycle_exponent,
        }
        if scaling.turns:
            assert scaling.counts_per_turn is not None
            values |= {"encoder_increments": round(scaling.counts_per_turn), "encoder_turns": 1}
            # a ratio of whole numbers: three decimals of the gear remain
            turns = round(1000 * scaling.gear)
            values |= {"gear_motor_turns": turns, "gear_shaft_turns": 1000}
            values |= {"feed_constant": round(scaling.counts_per_turn * scaling.gear), "feed_shaft_turns": 1}
        return values

    def has(self, name: str) -> bool:
        """Return True if the drive has the object."""
        if name == "second_position":
            return self.axis.encoders == 2
        if cia402.OBJECTS[name].index in (0x6080, 0x608F, 0x6091, 0x6092):
            return self.scaling.turns
        return name in cia402.OBJECTS

    def read(self, index: int, subindex: int) -> bytes:
        """Return the content of an object. Raises SdoAbortError."""
        if (index, subindex) == cia402.DEVICE_NAME:
            return cia402.VIRTUAL.encode()
        gain = GAIN_OBJECTS.get((index, subindex))
        if gain is not None and gain.name in self.axis.gains:
            return struct.pack("<i", round(self.axis.gains[gain.name] / gain.factor))
        entry = cia402.AT.get((index, subindex))
        same = [other for other in cia402.AT.values() if other.index == index and self.has(other.name)]
        if entry is None or not self.has(entry.name):
            # CiA 301: subindex 0 of a record is its highest subindex
            if subindex == 0 and same:
                return bytes([max(other.subindex for other in same)])
            raise SdoAbortError(NO_SUBINDEX if same else NO_OBJECT)
        return entry.encode(self.values[entry.name])

    def write(self, index: int, subindex: int, content: bytes) -> None:
        """Change an object. Raises SdoAbortError."""
        gain = GAIN_OBJECTS.get((index, subindex))
        if gain is not None and gain.name in self.axis.gains:
            if len(content) != 4:
                raise SdoAbortError(WRONG_LENGTH)
            (counts,) = struct.unpack("<i", content)
            if counts <= 0:
                raise SdoAbortError(TOO_LARGE)
            self.axis.set_gain(gain.name, counts * gain.factor)
            return
        entry = cia402.AT.get((index, subindex))
        if entry is None or not self.has(entry.name):
            raise SdoAbortError(NO_OBJECT)
        if entry.name not in _WRITABLE:
            raise SdoAbortError(READ_ONLY)
        if len(content) != entry.bits // 8:
            raise SdoAbortError(WRONG_LENGTH)
        value = entry.decode(content)
        if entry.name == "mode" and value and not (value > 0 and self.values["supported_modes"] >> (value - 1) & 1):
            raise SdoAbortError(TOO_LARGE)
        expected = (self.values["cycle_exponent"], value) == interpolation_time(self.cycle_time)[::-1]
        if entry.name == "cycle_value" and not expected:
            raise SdoAbortError(TOO_LARGE)
        self.values[entry.name] = value

    def take(self, sent: Mapping[str, int]) -> None:
        """Accept the process data of a cycle."""
        if not self.faults.is_unplugged:
            self.values.update(self.faults.taken(sent))

    @property
    def told(self) -> Mapping[str, int]:
        """The values that the drive tells its master: the true ones, unless a fault acts."""
        return self.faults.told(self.values)

    def lost(self) -> None:
        """Handle a lost connection: an enabled drive enters the fault state, unless 0x6007 = 0."""
        if self.values["connection_option"] == 0:
            return
        if self.state in (PowerState.ENABLED, PowerState.QUICK_STOP):
            self._fault(0x7500)

    def cycle(self) -> None:
        """Run one bus cycle with the most recent process data."""
        values, faults = self.values, self.faults
        faults.advance(values, is_on=self.state is PowerState.ENABLED)
        control, before = values["controlword"], self.state
        self.state = cia402.answer(before, control, self._control_before)
        self._control_before = control
        if before is PowerState.FAULT and self.state is not before:
            values["error_code"] = 0
        mode = values["mode"]
        keeps = not self._changes_mode and before is PowerState.ENABLED
        if mode > 0 and values["supported_modes"] >> (mode - 1) & 1 and not keeps:
            values["mode_display"] = mode
        if before is PowerState.ENABLED:
            disabled = self.state is PowerState.SWITCHED_ON
            self._drops = disabled and values["disable_operation_option"] == 0
        self._move_brake()
        if self.state is PowerState.QUICK_STOP and before is not PowerState.QUICK_STOP:
            self._begin_braking()
        if self.state is PowerState.QUICK_STOP:
            error = self._brake()
        elif self.state is PowerState.FAULT_REACTION:
            # what it cannot brake ends as a fault without a reaction
            if self._brake():
                self.state = PowerState.FAULT
            error = 0
        elif self.state is PowerState.ENABLED:
            error = self._obey(values["mode_display"], fresh=before is not PowerState.ENABLED)
        else:
            error = self._rest()
        self.cycles += 1
        late = faults.size("late_status")
        if faults.since("drive_fault") == 1:
            error = int(faults.size("drive_fault") or 0)
        elif late is not None and faults.since("late_status") == late + 1:
            error = OVERCURRENT
        if error:
            self._fault(error)
        values["statusword"] = self._status()

    def _fault(self, code: int) -> None:
        operates = self.state in (PowerState.ENABLED, PowerState.QUICK_STOP)
        brakes = operates and code in _BRAKED and self.values["fault_reaction_option"] == 2
        if brakes and self.state is PowerState.ENABLED:
            self._begin_braking()
        self.state = PowerState.FAULT_REACTION if brakes else PowerState.FAULT
        self.values["error_code"] = code
        self.values["statusword"] = self._status()

    def _status(self) -> int:
        status = self.state.status | 1 << 9  # remote
        if self.state is PowerState.ENABLED:
            status |= 1 << 12  # the drive follows the command
        return status

    def _rest(self) -> int:
        """Run one cycle with the drive switched off; return 0 for no error.

        Only friction brakes the axis, or its brake, until whose closing the drive holds it.
        """
        slip = self.faults.size("brake_slip")
        if self.brake is None or slip is not None:
            return self._coast(slip or 0.0)
        if self._clamped:
            return self._stand(0.0)
        # after its reaction it holds the axis meanwhile, too
        if self._drops or (self.state is PowerState.FAULT and self._kept is None):
            return self._coast(0.0)
        self._target = None
        self._kept = self.axis.last.position if self._kept is None else self._kept
        self._moved(np.full(self.samples, self._kept), 0.0, 0.0, enable=True)
        return 0

    def _stand(self, force: float) -> int:
        """Run one cycle of an axis that its brake holds."""
        self._target = None
        last = self.axis.stand(self.samples, force)
        self._show(last.position, last.second, 0.0, self.scaling.per_mille(force))
        return 0

    def _move_brake(self) -> None:
        """Let the brake open or close, which takes its time."""
        if self.brake is None:
            return
        opens = self.state in (PowerState.ENABLED, PowerState.QUICK_STOP, PowerState.FAULT_REACTION)
        if opens:
            self._kept = None
        if opens != self._clamped:
            self._moving = 0.0
            return
        self._moving += self.cycle_time
        if self._moving > (self.brake.opens if opens else self.brake.closes):
            self._clamped, self._moving = not opens, 0.0

    def _coast(self, force: float) -> int:
        """Run one cycle under a force that is none of the drive, N."""
        self._target = None
        before = self.axis.last.position
        self.axis.push(force, self.samples)
        self._show(
            self.axis.last.position, self.axis.last.second, (self.axis.last.position - before) / self.cycle_time, 0
        )
        return 0

    def _obey(self, mode: int, *, fresh: bool) -> int:
        values, scaling = self.values, self.scaling
        if self.faults.is_limp:
            return self._coast(0.0)
        if self._clamped:
            asked = scaling.force(values["target_torque"]) if mode == cia402.CST else 0.0
            return self._stand(asked)
        if mode == cia402.CST:
            self._target = None
            return self._push(values["target_torque"] + values["torque_offset"])
        offset = scaling.force(values["torque_offset"])
        if mode == cia402.CSV and self.axis.has_velocity_loop:
            self._target = None
            velocity = (values["target_velocity"] + values["velocity_offset"]) * scaling.metre
            here = np.full(self.samples, self.axis.last.position)
            return self._moved(here, velocity, offset, enable=True, alone=True)
        if mode != cia402.CSP:
            return self._moved(np.full(self.samples, self.axis.last.position), 0.0, 0.0, enable=True)
        counts = values["target_position"]
        if not values["position_least"] <= counts <= values["position_most"]:
            return 0x8612
        target = counts * scaling.metre
        # freshly enabled there is no last target: a line from an old one would be a jump of the setpoint
        begin = target if fresh or self._target is None else self._target
        line = np.full(self.samples, target) if begin == target else begin + self._shares * (target - begin)
        # exactly: begin + (target - begin) may be off in the last bit
        line[-1] = target
        self._target = target
        error = self._moved(line, values["velocity_offset"] * scaling.metre, offset, enable=True)
        window = values["following_error_window"]
        far = window != _NO_WINDOW and abs(counts - values["position"]) > window
        self._beyond = self._beyond + self.cycle_time if far else 0.0
        values["following_error"] = _within("following_error", counts - values["position"])
        return error or (0x8611 if self._beyond > 1e-3 * values["following_error_timeout"] else 0)

    def _push(self, per_mille: int) -> int:
        most = self.values["max_torque"]
        limited = self.scaling.force(max(-most, min(most, per_mille)))
        limit = self.axis.loop.control.force_limit
        if limit is not None:
            limited = max(-float(limit), min(float(limit), limited))
        before = self.axis.last.position
        self.axis.push(self.faults.sign * limited, self.samples)
        # the control is off, and its guard with it: the limits that hold in this mode are checked here
        guard, here = self.axis.loop.control.guard, self.axis.last.position
        speed = (here - before) / self.cycle_time
        if self._races(speed):
            return 0x8400
        self._show(here, self.axis.last.second, speed, self.scaling.per_mille(limited))
        if guard is None or math.isnan(here):
            return 0x7305 if math.isnan(here) else 0
        if guard.velocity_limit is not None and abs(speed) > guard.velocity_limit:
            return 0x8400
        low = guard.travel_least is not None and here < guard.travel_least
        return 0x8612 if low or (guard.travel_most is not None and here > guard.travel_most) else 0

    def _begin_braking(self) -> None:
        """Start the quick stop ramp at the set position or, if there is none, at the present position."""
        velocity = self.values["velocity"] * self.scaling.metre
        at = self.axis.last.position if self._target is None else self._target
        self._braking, self._still, self._target = (at, velocity), 0.0, None

    def _brake(self) -> int:
        assert self._braking is not None
        position, velocity = self._braking
        step = max(1, self.values["quick_stop_deceleration"]) * self.scaling.metre * self.T
        line, speeds = np.empty(self.samples), np.empty(self.samples)
        for k in range(self.samples):
            after = math.copysign(max(0.0, abs(velocity) - step), velocity)
            # exact while the deceleration is constant
            position += 0.5 * (velocity + after) * self.T
            velocity = after
            line[k], speeds[k] = position, velocity
        self._braking = position, velocity
        error = self._moved(line, speeds, 0.0, enable=True)
        self._still += self.cycle_time if velocity == 0.0 else 0.0
        if self._still >= _STANDSTILL:
            if self.state is PowerState.FAULT_REACTION:
                self.state, self._kept = PowerState.FAULT, self.axis.last.position
            # CiA 402: with options 5 to 8 a drive stays in quick stop active
            elif self.values["quick_stop_option"] < 5:
                self.state = PowerState.SWITCH_ON_DISABLED
        return error

    def _moved(
        self, line: np.ndarray, velocity: float | np.ndarray, added: float, *, enable: bool, alone: bool = False
    ) -> int:
        """Run one bus cycle in closed loop; return the error code, 0 if the guard does not trip."""
        before = self.axis.last.position
        sign = self.faults.sign
        most = self.values["max_torque"] * self.scaling.newton
        last = self.axis.follow(line, np.broadcast_to(velocity, line.size), added, enable, alone, sign, most)
        speed = (last.position - before) / self.cycle_time
        if not math.isfinite(last.position) or not math.isfinite(last.force):
            return 0x7305 if not math.isfinite(last.position) else 0xFF01
        self._show(last.position, last.second, speed, self.scaling.per_mille(sign * last.force))
        return _TRIPPED.get(last.trip, 0x8400 if self._races(speed) else 0)

    def _races(self, speed: float) -> bool:
        """Return True if the motor turns faster than 0x6080 allows."""
        return self.scaling.turns and self.scaling.turns_per_minute(abs(speed)) > self.values["max_motor_speed"]

    def _show(self, position: float, second: float, speed: float, per_mille: int) -> None:
        metre = self.scaling.metre
        shown = {
            "position": round(position / metre),
            "second_position": round(second / metre),
            "velocity": round(speed / metre),
            "torque": per_mille,
        }
        for name, value in shown.items():
            self.values[name] = _within(name, value)
        self.values["statusword"] = self._status()


def _within(name: str, value: int) -> int:
    """Clip a value to the range of its object."""
    least, most = cia402.OBJECTS[name].bounds()
    return max(least, min(most, value))


_NOT_MAPPABLE, _TOO_MANY = 0x06040041, 0x06040042  # abort codes: not mappable; PDO length exceeded
_ASSIGNED = {0x1600: 0x1C12, 0x1A00: 0x1C13}
_MESSAGES = {0x1600: 0x1400, 0x1A00: 0x1800}
_OBJECTS, _ENTRIES = 4, 8  # mapping objects in a direction, and entries in one of them
INVALID = 1 << 31  # bit of a message that is switched off


class PdoMap:
    """The PDO mapping and assignment lists of a drive; writes are refused unless `changeable()` is True."""

    def __init__(self, firmware: Firmware, changeable: Callable[[], bool], station: int = 0) -> None:
        """Set up the lists; `station` is the CANopen node number for the COB-IDs, 0 on EtherCAT."""
        self.firmware, self._changeable = firmware, changeable
        self._lists: dict[int, list[int]] = {}
        self.messages: dict[int, int] = {}
        there = [entry.name for entry in cia402.AT.values() if firmware.has(entry.name)]
        for first, groups in ((0x1600, cia402.SENT), (0x1A00, cia402.TOLD)):
            kept = Layout(groups).keeping(there)
            for k in range(_OBJECTS):
                names = kept.groups[k] if k < len(kept.groups) else ()
                self._lists[first + k] = [cia402.OBJECTS[name].mapped for name in names]
                message = (0x200 if first == 0x1600 else 0x180) + 0x100 * k + station
                self.messages[_MESSAGES[first] + k] = message if names and station else message | INVALID
            self._lists[_ASSIGNED[first]] = [first + k for k in range(len(kept.groups))]
        self._counts = {index: len(entries) for index, entries in self._lists.items()}

    def names(self, index: int) -> list[str]:
        """Return the names of the objects in one PDO."""
        words = self._lists[index][: self._counts[index]]
        return [cia402.AT[word >> 16, word >> 8 & 0xFF].name for word in words]

    def assigned(self, first: int) -> Layout:
        """Return the layout of all PDOs assigned by 0x1C12 (`first` = 0x1600) or 0x1C13 (0x1A00)."""
        return Layout([self.names(index) for index in self._lists[_ASSIGNED[first]][: self._counts[_ASSIGNED[first]]]])

    def read(self, index: int, subindex: int) -> bytes:
        """Return the content of a mapping object or any other object of the drive. Raises SdoAbortError."""
        if index in self.messages:
            if subindex > 2:
                raise SdoAbortError(NO_SUBINDEX)
            return struct.pack("<I", self.messages[index]) if subindex == 1 else bytes([2 if subindex == 0 else 1])
        if index not in self._lists:
            return self.firmware.read(index, subindex)
        entries = self._lists[index]
        if subindex == 0:
            return bytes([self._counts[index]])
        if subindex > len(entries):
            raise SdoAbortError(NO_SUBINDEX)
        return struct.pack("<H" if index >= 0x1C00 else "<I", entries[subindex - 1])

    def write(self, index: int, subindex: int, content: bytes) -> None:
        """Change a mapping object or any other object of the drive. Raises SdoAbortError."""
        if index not in self._lists and index not in self.messages:
            self.firmware.write(index, subindex, content)
            return
        if not self._changeable():
            raise SdoAbortError(WRONG_STATE)
        value = int.from_bytes(content, "little")
        if index in self.messages:
            if subindex == 1:
                self.messages[index] = value
            elif subindex != 2 or value not in (0, 1):  # with every SYNC
                raise SdoAbortError(TOO_LARGE)
            return
        if len(content) != (1 if subindex == 0 else 2 if index >= 0x1C00 else 4):
            raise SdoAbortError(WRONG_LENGTH)
        entries = self._lists[index]
        if subindex == 0:
            if value > len(entries):
                raise SdoAbortError(_TOO_MANY)
            self._counts[index] = value
            return
        # CiA 301: entries may be written only while the count is 0
        if self._counts[index]:
            raise SdoAbortError(WRONG_STATE)
        if subindex > _ENTRIES:
            raise SdoAbortError(_TOO_MANY)
        if index < 0x1C00:
            entry = cia402.AT.get((value >> 16, value >> 8 & 0xFF))
            if entry is None or not self.firmware.has(entry.name) or entry.mapped != value:
                raise SdoAbortError(_NOT_MAPPABLE)
        elif value not in self._lists or value >= 0x1C00:
            raise SdoAbortError(NO_OBJECT)
        # entries may arrive in any order: gaps hold a valid entry until theirs is written
        entries += [entries[0] if entries else value] * (subindex - len(entries))
        entries[subindex - 1] = value

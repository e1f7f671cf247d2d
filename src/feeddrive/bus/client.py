"""A CiA 402 client that identifies and checks a drive, switches it on and off, and commands it cyclically."""

import contextlib
import math
import time
from collections.abc import Generator, Iterator, Sequence
from types import TracebackType
from typing import NamedTuple, Self

from feeddrive.bus import cia402
from feeddrive.bus.cia402 import Layout, PowerState
from feeddrive.bus.drive_file import BusDrive, DriveScaling, interpolation_time
from feeddrive.bus.ethercat import EtherCAT, Segment
from feeddrive.bus.monitor import reaction_time
from feeddrive.bus.transport import Pace, RefusedError, Transport, has_object, read_object, write_object
from feeddrive.language.errors import BusError
from feeddrive.language.quantity import Quantity

# Checks before a drive is switched on: its identity, its scaling against the declared one, and its limits.

_PROFILE = 402  # device profile: the low word of 0x1000
# rated data and gears are rounded by their makers; another unit, or the data of another motor, is off by much more
_NEAR = 5e-3  # share by which the data of the drive may differ from the declared ones


def identify(transport: Transport, drive: BusDrive) -> dict[str, int | str]:
    """Read the identity of the drive. Raises BusError for a device of another profile and for an unsupported mode."""
    profile = read_object(transport, "device_type") & 0xFFFF
    if profile != _PROFILE:
        raise BusError(f"{transport.where}: is not a CiA 402 drive but a device of profile {profile}")
    identity: dict[str, int | str] = {
        name: read_object(transport, name)
        for name in ("vendor", "product", "revision", "serial")
        if has_object(transport, name)
    }
    try:
        text = transport.read(*cia402.DEVICE_NAME)
    except RefusedError:
        text = b""
    # latin-1 decodes every byte: names of devices are not always ASCII
    identity["name"] = text.decode("latin-1").strip("\x00 ")
    if has_object(transport, "supported_modes"):
        supported = read_object(transport, "supported_modes")
        can = [name for name, mode in cia402.MODES.items() if supported >> (mode - 1) & 1]
        if drive.mode not in can:
            raise BusError(
                f'{transport.where}: does not support mode = "{drive.mode}"; it supports '
                f"{', '.join(can) or 'none of csp, csv and cst'} (object 0x6502)"
            )
    return identity


def check_scaling(transport: Transport, scaling: DriveScaling) -> list[str]:
    """Compare the declared rated torque, counts and gear with the drive; return remarks on missing data.

    Raises BusError, with both values, if a declared value differs from that of the drive.
    """
    key = "rated_torque" if scaling.rated_force is None else "rated_force"
    pairs = [(key, float(scaling.rated_milli), "rated_torque", 1e-3)]
    if scaling.counts_per_turn is not None:
        turns = _turns(transport, "gear_shaft_turns")
        pairs.append(("gear", turns * scaling.gear, "gear_motor_turns", 1.0 / turns))
        # 0x6092 first: positions may be scaled to other units than increments of the encoder
        if has_object(transport, "feed_constant"):
            turns = scaling.gear * _turns(transport, "feed_shaft_turns")
            pairs.append(("counts_per_turn", turns * scaling.counts_per_turn, "feed_constant", 1.0 / turns))
        else:
            turns = _turns(transport, "encoder_turns")
            pairs.append(("counts_per_turn", turns * scaling.counts_per_turn, "encoder_increments", 1.0 / turns))
    remarks: list[str] = []
    for key, wanted, name, factor in pairs:
        place = cia402.OBJECTS[name].place
        if not has_object(transport, name):
            remarks.append(f"The drive has no object {place}: scaling.{key} could not be checked.")
            continue
        got = read_object(transport, name)
        rounding = 0.5 if name == "rated_torque" else 0.0  # to whole mN m
        if abs(got - wanted) > rounding + _NEAR * abs(wanted):
            raise BusError(
                f"{transport.where}: scaling.{key} = {Quantity(wanted * factor):6} in the drive file, but the drive "
                f"says {Quantity(got * factor):6} in object {place}; correct the drive file, or the drive"
            )
    return remarks


def _turns(transport: Transport, name: str) -> int:
    """Read the denominator of a ratio from the drive; 1 if it is 0 or the drive lacks the object."""
    return max(1, read_object(transport, name)) if has_object(transport, name) else 1


def write_cycle_time(transport: Transport, drive: BusDrive) -> None:
    """Write the interpolation period 0x60C2, if the drive has it. Raises BusError if the drive refuses it."""
    if not has_object(transport, "cycle_value"):
        return
    value, power = interpolation_time(drive.cycle_time)
    try:
        # the exponent first: a drive that accepts only its own cycle times judges the pair when the value arrives
        write_object(transport, "cycle_exponent", power)
        write_object(transport, "cycle_value", value)
    except RefusedError as error:
        raise BusError(
            f"{transport.where}: cycle_time = {Quantity(drive.cycle_time, 's'):6 us} does not suit the drive: object "
            f"0x60C2 is refused (0x{error.code:08X}); take a cycle time that its manual names"
        ) from None


def set_watchdog(transport: Transport, drive: BusDrive) -> list[str]:
    """Set the watchdog of the drive and its reaction; return a remark if the drive file disables the watchdog.

    Raises BusError if either cannot be set, or if a different value is read back.
    """
    if drive.watchdog_time == 0.0:
        return ["No watchdog (watchdog = 0 in the drive file): the axis runs on when this computer stops."]
    if has_object(transport, "connection_option") and read_object(transport, "connection_option") == 0:
        # 1, a fault: the default of the standard
        write_object(transport, "connection_option", 1)
        if read_object(transport, "connection_option") != 1:
            raise BusError(
                f"{transport.where}: goes on when the connection is lost (object 0x6007 = 0 cannot be changed)"
            )
    transport.watch(drive.watchdog_time)
    return []


# times limits.following_error at which the drive trips: the monitor, which brakes along a ramp, is to be first, and at
# one bound the noise of a reading would decide
_WIDER = 1.05
# the direction in which a limit is looser than the one asked for; 0: neither
_LOOSER = {
    "max_torque": 1,
    "max_motor_speed": 1,
    "following_error_window": 1,
    "following_error_timeout": 0,
    "quick_stop_deceleration": -1,
    "quick_stop_option": 0,
    "disable_operation_option": 0,
    "fault_reaction_option": 0,
    "position_least": -1,
    "position_most": 1,
}


def write_limits(transport: Transport, drive: BusDrive, *, own_force: bool = False) -> list[str]:
    """Write the limits that the drive guards by itself, and read them back; return a remark for each that it lacks.

    A limit that reads back tighter is a remark, too.  With `own_force` 0x6072 stays as it was found.  Raises BusError
    for one that reads back looser: the drive would permit more than the drive file.
    """
    limits, scaling = drive.limits, drive.scaling
    wanted: dict[str, int] = {
        # truncated: the drive must not permit more than the file; at least 1, since 0 would forbid every force
        "max_torque": max(1, int(limits.force / scaling.newton)),
        "following_error_window": max(1, scaling.increments(_WIDER * limits.following_error)),
        # ms: in a runaway the monitor switches the force off before the drive, whose own ramp would go on with it
        "following_error_timeout": math.ceil(1e3 * reaction_time(drive) - 1e-9),
        "quick_stop_deceleration": max(1, scaling.increments(limits.quick_stop_deceleration)),
        "quick_stop_option": 2,  # brake on that ramp, then switch off
        "disable_operation_option": 1,  # force until the axis stands and its brake has closed: 0 drops a vertical axis
        "fault_reaction_option": 2,  # as a quick stop, in a fault in which the drive can
    }
    if scaling.turns:
        # as for the following error: what the axis gains in speed until the reaction of the monitor acts
        speed = limits.velocity + limits.quick_stop_deceleration * reaction_time(drive)
        # rounded up: a slow axis has few turns a minute, and below its limit the drive would hold it back
        wanted["max_motor_speed"] = math.ceil(scaling.turns_per_minute(speed))
    for name, metres in (("position_least", limits.position_least), ("position_most", limits.position_most)):
        if metres is not None:
            wanted[name] = scaling.increments(metres)
    if own_force:
        del wanted["max_torque"]
    remarks: list[str] = []
    for name, value in wanted.items():
        least, most = cia402.OBJECTS[name].bounds()
        # clamped: a limit beyond the range of its object could never act
        remarks += _written(transport, name, max(least, min(most, value)))
    return remarks


def _written(transport: Transport, name: str, value: int) -> Iterator[str]:
    """Write a limit and read it back; yield a remark if the drive does not take it as it is."""
    place = f"{cia402.OBJECTS[name].place} ({name.replace('_', ' ')})"
    try:
        write_object(transport, name, value)
        got = read_object(transport, name)
    except RefusedError:
        held = read_object(transport, name) if has_object(transport, name) else None
        if held != value:
            holds = "" if held is None else f", which holds {held} in place of {value}"
            yield f"The drive does not take {place}{holds}: set this limit with its maker's tool."
        return
    if got == value:
        return
    if (got - value) * _LOOSER[name] > 0:
        raise BusError(
            f"{transport.where}: {place} was set to {value} and reads back as {got}, a looser limit: the drive would "
            "permit more than the drive file; set it with its maker's tool, or raise the limit if the machine allows it"
        )
    yield f"The drive holds {got} in {place}, where {value} was written."


# A drive by CiA 402: opened and checked, switched on and off, and commanded in a cycle.

_PATIENCE = 3.0  # s for a change of state, on the clock and in cycles
_CLOSES = 1.0  # s that a drive may need to close its brake before it leaves operation
_FIRST = 20  # cycles at the start within which the drive must answer
_ASKED, _SILENCE = 10, 0.3  # cycles, and s, without any answer, after which the drive is given up
_TARGETS = {cia402.CSP: "target_position", cia402.CST: "target_torque"}


class ActualValues(NamedTuple):
    """The actual values of a drive in SI: positions m, velocity m/s, force N; None where the drive lacks the object."""

    status: int
    position: float
    velocity: float
    force: float
    following_error: float | None
    second: float | None
    error_code: int
    inputs: int | None = None  # 0x60FD


class DriveClient:
    """A CiA 402 drive, opened by a `with` block and always switched off at the end of the block.

    All methods raise BusError, whose message names bus, interface, station and remedy.
    """

    def __init__(self, transport: Transport, drive: BusDrive, *, paced: bool = True, own_force: bool = False) -> None:
        """Set up the client. Without `paced` (virtual drives only), each answer starts the next cycle at once.

        With `own_force` the drive keeps the limit of force that it holds.
        """
        self.transport, self.drive, self._own_force = transport, drive, own_force
        self.scaling = drive.scaling
        self.pace = Pace(drive.cycle_time if paced else None)
        self.remarks: list[str] = []
        self.identity: dict[str, int | str] = {}
        self.lost = self.lost_in_row = 0
        self.told: ActualValues | None = None
        self.mode = cia402.MODES[drive.mode]
        self._values = dict.fromkeys([name for group in cia402.SENT for name in group], 0)
        told = cia402.TOLD if drive.stop_input is None else (*cia402.TOLD, cia402.INPUTS)
        self._sent, self._back = Layout(cia402.SENT), Layout(told)
        self._timeout = max(2e-3, 2.0 * drive.cycle_time) if paced else 1.0
        self._operating = self._unreachable = False
        self._mode = 0
        self._heard = 0.0  # time of the last answer, on the monotonic clock
        self.answer: ActualValues | None = None  # to the last cycle; None if it was lost
        self.supported_modes: int | None = None  # 0x6502; None if the drive has no such object
        self.held = 0.0  # N, of cst while no motion is played: the weight of a vertical axis
        self.together = [self]  # all that are driven in the same cycles, this one among them

    def __enter__(self) -> Self:
        try:
            self.open()
        # BaseException: Ctrl-C while the drive is searched for must release the interface, too
        except BaseException:
            self.transport.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if self._operating and not self._unreachable and self.state is PowerState.ENABLED:
                self.stop()
            elif self._operating:
                self._switch_off()
        except BusError:
            # the error that ended the block is the cause: that of switching off must not replace it
            if error is None:
                raise
        finally:
            # in place: the list is shared by the group, whose other drives go on without this one
            self.together[:] = [other for other in self.together if other is not self]
            self.together = [self]
            self.transport.close()

    @property
    def is_virtual(self) -> bool:
        """True for the drive of `feeddrive virtual-drive`, which moves no real axis."""
        return self.identity.get("name") == cia402.VIRTUAL

    @property
    def reports_velocity(self) -> bool:
        """True if the drive reports a velocity (0x606C); otherwise the velocity is computed from its positions."""
        return "velocity" in self._back.names

    @property
    def statusword(self) -> int:
        """The last statusword; 0 if there is none yet."""
        return 0 if self.told is None else self.told.status

    @property
    def inputs(self) -> int | None:
        """The last digital inputs of the drive (0x60FD), of a drive with a stop input."""
        return None if self.told is None else self.told.inputs

    @property
    def mode_shown(self) -> int:
        """The last mode of operation that the drive displayed (0x6061)."""
        return self._mode

    @property
    def state(self) -> PowerState | None:
        """The power state decoded from the last statusword."""
        return None if self.told is None else cia402.state_of(self.told.status)

    def open(self) -> None:
        """Find and check the drive, write limits and mapping, and start the exchange; the drive stays switched off."""
        self.find()
        self.map()
        self.watch()
        self.operate()
        self.hear()

    def find(self) -> None:
        """Find, identify and check the drive, and write its mode, cycle time and limits."""
        transport = self.transport
        transport.open()
        self.identity = identify(transport, self.drive)
        # before anything is written: a real drive must not be driven as fast as the bus allows
        if self.pace.cycle_time is None and not self.is_virtual:
            raise BusError(f"{transport.where}: only a virtual drive may be run without a clock; leave --unpaced out")
        if has_object(transport, "supported_modes"):
            self.supported_modes = read_object(transport, "supported_modes")
        self.remarks += check_scaling(transport, self.scaling)
        write_object(transport, "mode", self.mode)
        write_cycle_time(transport, self.drive)
        self.remarks += write_limits(transport, self.drive, own_force=self._own_force)
        there = {name for name in (*self._sent.names, *self._back.names) if has_object(transport, name)}
        inputs = () if self.drive.stop_input is None else cia402.INPUTS
        target = _TARGETS.get(self.mode, "target_velocity")
        missing = [name for name in (*cia402.NEEDED, target, *inputs) if name not in there]
        if missing:
            places = ", ".join(f"{cia402.OBJECTS[name].place} ({name})" for name in missing)
            raise BusError(f"{transport.where}: has no object {places}, without which it cannot be driven")
        self._sent, self._back = (layout.keeping(sorted(there)) for layout in (self._sent, self._back))

    def map(self) -> None:
        """Map the objects that are exchanged in each cycle."""
        self.transport.map(self._sent, self._back)
        self._values["mode"] = self.mode

    def watch(self) -> None:
        """Set the watchdog of the drive if the cycles are paced."""
        # unpaced, time is counted in frames: a watchdog on the clock would trip while nothing is late
        if self.pace.cycle_time is not None:
            self.remarks += set_watchdog(self.transport, self.drive)

    def operate(self) -> None:
        """Start the process data exchange."""
        self.transport.operate(self._sent.pack(self._values))
        self._operating = True

    def hear(self) -> None:
        """Wait for the first answer."""
        # the first frames may be lost while the drive enters operation
        for _ in range(_FIRST):
            if self._follow() is not None:
                break
        for _ in range(self.drive.lag):
            self._follow()
        if self.told is None:
            raise BusError(f"{self.transport.where}: {self.transport.state()}, but its process data are lost")

    def cycle(self) -> ActualValues | None:
        """Exchange the setpoints of one cycle; return the actual values, or None for a lost frame.

        Raises BusError, without sending, if the drive is enabled and the cycle is more than `late_cycles` late: the
        drive received no target in the meantime, so that the next one would make it jump.
        """
        late, T = self.pace.wait(), self.drive.cycle_time
        if late > self.drive.late_cycles * T and self.state is PowerState.ENABLED:
            raise BusError(
                f"{self.transport.where}: a cycle began {Quantity(late, 's'):.0f} late, {Quantity(late / T):.0f} "
                f"cycles, more than late_cycles = {self.drive.late_cycles} of the drive file: something held this "
                "computer up; take a real-time kernel, or a longer cycle_time"
            )
        return self._exchange()

    def _exchange(self) -> ActualValues | None:
        """Exchange one cycle with all drives of the group; return the answer of this drive."""
        for client in self.together:
            # all outputs before the first `take`: on EtherCAT one frame carries those of all drives
            client.transport.put(client._sent.pack(client._values))
        for client in self.together:
            client.answer = client._take()
        return self.answer

    def _take(self) -> ActualValues | None:
        answered = self.transport.take(self._timeout)
        if answered is None:
            self.lost += 1
            self.lost_in_row += 1
            return None
        self.lost_in_row, self._heard = 0, time.monotonic()
        raw, scaling = self._back.unpack(answered), self.scaling
        error, second = raw.get("following_error"), raw.get("second_position")
        if "velocity" not in raw:
            raw["velocity"] = 0 if self.told is None else round((raw["position"] - self._here) / self.drive.cycle_time)
        self.told = ActualValues(
            raw["statusword"],
            raw["position"] * scaling.metre,
            raw["velocity"] * scaling.metre,
            scaling.force(raw["torque"]),
            None if error is None else error * scaling.metre,
            None if second is None else second * scaling.metre,
            raw.get("error_code", 0),
            raw.get("digital_inputs"),
        )
        self._here = raw["position"]
        self._mode = raw["mode_display"]
        return self.told

    def excites(self, unit: str) -> None:
        """Raise BusError for an excitation in N that `csp` or `csv` cannot apply, since the drive has no torque offset
        object.
        """
        name = "torque_offset"
        if unit == "N" and self.mode != cia402.CST and name not in self._sent.names:
            raise BusError(
                f"{self.transport.where}: has no object {cia402.OBJECTS[name].place} ({name}), by which a force "
                f'is added in mode {self.drive.mode}: use mode = "cst", or excite the setpoint '
                "(feeddrive excite --where setpoint)"
            )

    def command(self, *, position: float | None = None, velocity: float = 0.0, force: float = 0.0) -> float:
        """Set the setpoints of the next cycle, in SI; return the position (m), in csp rounded to whole increments.

        csp  position, with velocity and force feedforward if the drive has objects for them
        csv  velocity, with force feedforward
        cst  force

        Raises BusError for a value outside the range of its object.
        """
        values, scaling = self._values, self.scaling
        torque, speed = scaling.per_mille(force), scaling.increments(velocity)
        wanted = {"torque_offset": torque, "velocity_offset": speed}
        if self.mode == cia402.CSP:
            wanted["target_position"] = self._here if position is None else scaling.increments(position)
        elif self.mode == cia402.CST:
            wanted = {"target_torque": torque}
        else:
            wanted = {"target_velocity": speed, "torque_offset": torque}
        for name, value in wanted.items():
            least, most = cia402.OBJECTS[name].bounds()
            if not least <= value <= most:
                raise BusError(
                    f"{self.transport.where}: {value} does not fit into {cia402.OBJECTS[name].place} ({name}), {least} "
                    f".. {most}: look at [scaling] of the drive file"
                )
            values[name] = value
        if self.mode == cia402.CSP:
            return wanted["target_position"] * scaling.metre
        return self._here * scaling.metre if position is None else position

    def _follow(self, controlword: int | None = None) -> ActualValues | None:
        """Exchange one cycle that commands the present position."""
        if controlword is not None:
            self._values["controlword"] = controlword
        if self.told is not None:
            self.command(force=self.held if self.mode == cia402.CST else 0.0)
        # without the check for lateness: a target at the present position is never a jump
        self.pace.wait()
        return self._exchange()

    def enable(self) -> None:
        """Switch the drive to operation enabled at its present position."""
        if self.state in (PowerState.FAULT, PowerState.FAULT_REACTION):
            raise BusError(f"{self._fault()}; look for its cause, then reset it (--reset-fault)")
        self._until(PowerState.ENABLED, cia402.TOWARDS_ENABLED)
        # the displayed mode comes `lag` cycles after the first command
        for _ in range(self.drive.lag + 1):
            self._follow()
        if self._mode != self.mode:
            raise BusError(f"{self.transport.where}: runs mode {self._mode} and not {self.mode} ({self.drive.mode})")

    def reset_fault(self) -> None:
        """Reset a fault, if there is one."""
        if self.state is PowerState.FAULT_REACTION:
            self._until(PowerState.FAULT, {PowerState.FAULT_REACTION: cia402.DISABLE_VOLTAGE})
        if self.state is not PowerState.FAULT:
            return
        # the drive reacts to the rising edge of the bit, not to the bit
        self._follow(cia402.DISABLE_VOLTAGE)
        self._follow(cia402.FAULT_RESET)
        self._until(PowerState.SWITCH_ON_DISABLED, {PowerState.FAULT: cia402.FAULT_RESET})

    def prepare_stop(self, *, force_off: bool = False) -> None:
        """Request a quick stop with the next cycle, or the end of all force; `stop` or `cut` completes it."""
        if self.state is PowerState.ENABLED:
            self._values["controlword"] = cia402.DISABLE_VOLTAGE if force_off else cia402.QUICK_STOP

    def prepare_disable(self) -> None:
        """Request with the next cycle that the drive switches off in order; `disable` completes it."""
        if self.state is PowerState.ENABLED:
            self._values["controlword"] = cia402.DISABLE_OPERATION

    def stop(self) -> None:
        """Perform a quick stop, wait until the drive has switched off, and disable the voltage in any case."""
        stopping = {PowerState.ENABLED: cia402.QUICK_STOP, PowerState.QUICK_STOP: cia402.QUICK_STOP}
        try:
            self._until(PowerState.SWITCH_ON_DISABLED, stopping, ending=(PowerState.FAULT, PowerState.READY))
        except BusError:
            # leaving the `with` block must not wait for the same silent drive again
            self._unreachable = True
            raise
        finally:
            self._switch_off()

    def rest(self) -> None:
        """Exchange one cycle with the drives of the group off."""
        self._follow(cia402.DISABLE_VOLTAGE)

    def hold(self) -> None:
        """Switch the drive on again, where it has target positions in csp, and command its present position."""
        if "target_position" in self._sent.names:
            self.mode = cia402.CSP
            self._values["mode"] = self.mode
        self.enable()
        assert self.told is not None
        self.command(position=self.told.position)

    def can(self, mode: int) -> bool:
        """Return True if the drive has the mode, as far as it tells (0x6502)."""
        told = self.supported_modes
        has_target = _TARGETS.get(mode, "target_velocity") in self._sent.names
        return has_target and (told is None or bool(told >> (mode - 1) & 1))

    def ask_hold(self, force: float) -> None:
        """Ask with the next cycle for csp at the present position; until `shows`, the target force (N) stays in cst."""
        self.command(force=force)
        self.mode, self.held = cia402.CSP, 0.0
        self._values["mode"] = self.mode
        self.command()

    def ask_torque(self, force: float) -> None:
        """Ask with the next cycle for cst and a target force, N; `shows` tells when the drive runs it."""
        self.mode, self.held = cia402.CST, force
        self._values |= {"mode": self.mode, "torque_offset": 0, "velocity_offset": 0}
        self.command(force=force)

    @property
    def shows(self) -> bool:
        """True if the drive is in operation in the mode that it was asked for."""
        return self.state is PowerState.ENABLED and self._mode == self.mode

    def disable(self) -> None:
        """Switch off an axis at rest in order: disable operation, and when the drive has left it, disable the voltage.

        On disable voltage alone the force may end before a brake has closed; on disable operation a drive closes it
        first, by 0x605C, and many stay in operation meanwhile.
        """
        for _ in range(round(_CLOSES / self.drive.cycle_time)):
            if self.state is not PowerState.ENABLED:
                break
            self._follow(cia402.DISABLE_OPERATION)
        self._switch_off()

    def cut(self) -> None:
        """Switch off at once, whatever moves."""
        self._switch_off()

    def _switch_off(self) -> None:
        for _ in range(self.drive.lag + 2):
            self._follow(cia402.DISABLE_VOLTAGE)

    def _until(self, wanted: PowerState, sending: dict[PowerState, int], ending: tuple[PowerState, ...] = ()) -> None:
        """Run cycles with the controlword that `sending` assigns to each state, until `wanted` or an `ending` state."""
        began, cycles = time.monotonic(), 0
        before = self.state
        while self.state is not wanted and self.state not in ending:
            state = self.state
            self._follow(sending.get(state, self._values["controlword"]) if state else None)
            failed = self.state in (PowerState.FAULT, PowerState.FAULT_REACTION) and before is not PowerState.FAULT
            if failed and PowerState.FAULT not in ending:
                raise BusError(self._fault())
            cycles += 1
            silent = time.monotonic() - max(began, self._heard)
            given_up = silent > _PATIENCE or (cycles >= _ASKED and silent > _SILENCE)
            if self.lost_in_row >= self.drive.lost_frames and given_up:
                raise BusError(
                    f"{self.transport.where}: no frame came back for {Quantity(silent, 's'):2 SI}; "
                    f"{self.transport.state()}"
                )
            # both times: unpaced cycles run faster than their time, those of a busy computer slower
            if cycles * self.drive.cycle_time > _PATIENCE and time.monotonic() - began > _PATIENCE:
                at = "unknown" if self.state is None else self.state.words
                bus = f"; {self.transport.state()}" if self.lost_in_row else ""
                raise BusError(
                    f"{self.transport.where}: does not go to '{wanted.words}' within {Quantity(_PATIENCE, 's'):6 SI} "
                    f"but stays in '{at}'{bus}; look at supply, enable inputs and the emergency stop"
                )

    def _fault(self) -> str:
        code = 0 if self.told is None else self.told.error_code
        meaning = cia402.ERRORS.get(code) if self.is_virtual else None
        return f"{self.transport.where}: fault 0x{code:04X}" + (f", {meaning}" if meaning else "")

    def trouble(self) -> str:
        """Return the reason why the drive no longer follows its setpoints, or an empty string if it does."""
        if self.lost_in_row >= self.drive.lost_frames:
            return f"{self.lost_in_row} frames in a row were lost: {self.transport.state()}"
        if self.state is PowerState.ENABLED:
            return ""
        if self.state in (PowerState.FAULT, PowerState.FAULT_REACTION):
            return self._fault().removeprefix(f"{self.transport.where}: ")
        at = "an unknown state" if self.state is None else f"'{self.state.words}'"
        return f"the drive left operation by itself and is in {at}"


@contextlib.contextmanager
def driven_together(clients: Sequence[DriveClient]) -> Generator[None]:
    """Open the drives of one segment and exchange their data in the same cycles, paced by the clock of the first drive.

    All are switched off at the end of the block, however it ends.  Raises BusError as `DriveClient` does.
    """
    with contextlib.ExitStack() as stack:
        for client in clients:
            # push registers the exit only: the drives are opened below, each step for all of them
            stack.push(client)
        for step in (DriveClient.find, DriveClient.map, DriveClient.watch, DriveClient.operate):
            for client in clients:
                step(client)
        together = list(clients)
        for client in clients:
            client.pace, client.together = clients[0].pace, together
        for client in clients:
            client.hear()
        yield


def transport_of(drive: BusDrive, interface: str, bitrate: int | None, segment: Segment | None = None) -> Transport:
    """Return the transport to a drive, on a shared EtherCAT segment if one is given.

    Opening the transport raises MissingExtraError if its package is missing.
    """
    if drive.bus == "ethercat":
        return EtherCAT(interface, drive.station, segment)
    from feeddrive.bus.canopen import CANopen

    return CANopen(interface, drive.station, bitrate)

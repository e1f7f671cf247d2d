"""Checks before a drive is switched on: its identity, its units against the declared ones, and its limits."""

from __future__ import annotations

from feeddrive.bus.cia402 import DEVICE_NAME, MODES, OBJECTS
from feeddrive.bus.drive_file import BusDrive, DriveScaling, interpolation_time
from feeddrive.bus.transport import RefusedError, Transport, has_object, read_object, write_object
from feeddrive.language.errors import BusError
from feeddrive.language.quantity import Quantity

_PROFILE = 402
_NEAR = 5e-3  # share by which the data of the drive may differ from the declared ones


def identify(transport: Transport, drive: BusDrive) -> dict[str, int | str]:
    """Numbers and name of the drive. Raises BusError for a device of another profile, or without the wanted mode."""
    profile = read_object(transport, "device_type") & 0xFFFF
    if profile != _PROFILE:
        raise BusError(f"{transport.where}: is not a CiA 402 drive but a device of profile {profile}")
    found: dict[str, int | str] = {
        name: read_object(transport, name)
        for name in ("vendor", "product", "revision", "serial")
        if has_object(transport, name)
    }
    try:
        text = transport.read(*DEVICE_NAME)
    except RefusedError:
        text = b""
    found["name"] = text.decode("latin-1").strip("\x00 ")
    if has_object(transport, "supported_modes"):
        supported = read_object(transport, "supported_modes")
        can = [name for name, mode in MODES.items() if supported >> (mode - 1) & 1]
        if drive.mode not in can:
            raise BusError(
                f'{transport.where}: does not support mode = "{drive.mode}"; it supports '
                f"{', '.join(can) or 'none of csp, csv and cst'} (object 0x6502)"
            )
    return found


def check_scaling(transport: Transport, scaling: DriveScaling) -> list[str]:
    """Declared rated torque, counts and gear against the data of the drive; remarks on data that it does not have.

    Raises BusError for a difference, with both numbers.
    """
    key = "rated_torque" if scaling.rated_force is None else "rated_force"
    pairs = [(key, float(scaling.rated_milli), "rated_torque", 1e-3)]
    if scaling.counts_per_turn is not None:
        turns = _turns(transport, "gear_shaft_turns")
        pairs.append(("gear", turns * scaling.gear, "gear_motor_turns", 1.0 / turns))
        if has_object(transport, "feed_constant"):  # positions may count in other units than the encoder
            turns = scaling.gear * _turns(transport, "feed_shaft_turns")
            pairs.append(("counts_per_turn", turns * scaling.counts_per_turn, "feed_constant", 1.0 / turns))
        else:
            turns = _turns(transport, "encoder_turns")
            pairs.append(("counts_per_turn", turns * scaling.counts_per_turn, "encoder_increments", 1.0 / turns))
    remarks: list[str] = []
    for key, wanted, name, factor in pairs:
        place = OBJECTS[name].place
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
    """The denominator of a ratio; 1 where the drive has none."""
    return max(1, read_object(transport, name)) if has_object(transport, name) else 1


def write_cycle_time(transport: Transport, drive: BusDrive) -> None:
    """Write the cycle time into 0x60C2, over which a drive that has it interpolates. BusError if it refuses."""
    if not has_object(transport, "cycle_value"):
        return
    value, power = interpolation_time(drive.cycle_time)
    try:
        write_object(transport, "cycle_exponent", power)
        write_object(transport, "cycle_value", value)
    except RefusedError as error:
        raise BusError(
            f"{transport.where}: cycle_time = {Quantity(drive.cycle_time, 's'):6 us} does not suit the drive: object "
            f"0x60C2 is refused (0x{error.code:08X}); take a cycle time that its manual names"
        ) from None


def set_watchdog(transport: Transport, drive: BusDrive) -> list[str]:
    """Set the drive's own watchdog and check its reaction; a remark if the drive file switches it off.

    Raises BusError if it cannot be set, or reads back differently.
    """
    if drive.watchdog_time == 0.0:
        return ["No watchdog (watchdog = 0 in the drive file): the axis runs on when this computer stops."]
    if has_object(transport, "connection_option") and read_object(transport, "connection_option") == 0:
        write_object(transport, "connection_option", 1)  # a fault, as the standard has it by default
        if read_object(transport, "connection_option") != 1:
            raise BusError(
                f"{transport.where}: goes on when the connection is lost (object 0x6007 = 0 cannot be changed)"
            )
    transport.watch(drive.watchdog_time)
    return []


def write_limits(transport: Transport, drive: BusDrive) -> list[str]:
    """Write the limits into the drive; remarks on those that it does not take."""
    limits, scaling = drive.limits, drive.scaling
    wanted: dict[str, int] = {
        "max_torque": max(1, int(limits.force / scaling.newton)),
        "following_error_window": max(1, scaling.increments(limits.following_error)),
        "quick_stop_deceleration": max(1, scaling.increments(limits.quick_stop_deceleration)),
        "quick_stop_option": 2,  # brake on that ramp, then switch off
    }
    for name, metres in (("position_least", limits.position_least), ("position_most", limits.position_most)):
        if metres is not None:
            wanted[name] = scaling.increments(metres)
    remarks: list[str] = []
    for name, value in wanted.items():
        least, most = OBJECTS[name].bounds()
        try:
            write_object(transport, name, max(least, min(most, value)))
        except RefusedError:
            remarks.append(
                f"The drive does not take {OBJECTS[name].place} ({name.replace('_', ' ')}): set this limit with its "
                "maker's tool."
            )
    return remarks

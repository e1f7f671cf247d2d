"""The increments and the rated torque of a virtual drive, from the machine file, and a drive file that fits it."""

from __future__ import annotations

from feeddrive.blocks.actuator.screw import Screw
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.bus.scaling import DriveScaling
from feeddrive.loop.loop import Loop

_INCREMENT = 10e-9  # m, of an encoder without resolution
_PEAK = 3.0  # peak over rated force, where only the peak is stated
_FORCE = 1000.0  # N, rated, where nothing is stated


def scaling_of(loop: Loop) -> DriveScaling:
    """One increment is one count of the encoder of the position loop; rated is the continuous force of the motor.

    A motor on a screw gets a whole number of counts in a turn; the rated torque is a whole number of mN m.
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
        counts_per_turn=float(max(1, round(lead / (gear * increment)))), lead=lead, gear=gear,
        rated_torque=max(1e-3, round(torque, 3)),
    )  # fmt: skip


def drive_text(loop: Loop, scaling: DriveScaling, bus: str, interface: str, station: int, cycle_time: float) -> str:
    """A drive file for the virtual drive; its limits are those of the machine's guard and control, if it has any."""
    guard, limits = loop.control.guard, loop.control.force_limit
    velocity = None if guard is None else guard.velocity_limit
    following = None if guard is None else guard.following_error_limit
    force = 1000.0 * 3.0 * scaling.newton if limits is None else float(limits)
    if scaling.turns:
        units = (
            f"counts_per_turn = {scaling.counts_per_turn:.0f}\nlead = {scaling.lead!r}\ngear = {scaling.gear!r}\n"
            f"rated_torque = {scaling.rated_torque!r}"
        )
    else:
        units = f"increment = {scaling.increment!r}\nrated_force = {scaling.rated_force!r}"
    return (
        f"# The virtual drive of feeddrive; for a drive of your own every number is to be looked up.\n"
        f'bus = "{bus}"\ninterface = "{interface}"\nstation = {station}\ncycle_time = {cycle_time!r}   # s\n'
        f'mode = "csp"\n\n[scaling]\n{units}\n\n[limits]\ntravel = 0.5   # m, from where it starts, to both sides\n'
        f"velocity = {1.0 if velocity is None else float(velocity)!r}   # m/s\nforce = {force!r}   # N\n"
        f"following_error = {5e-3 if following is None else float(following)!r}   # m\n"
    )

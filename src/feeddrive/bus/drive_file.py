"""A drive file: the bus address of a drive, its scaling, and its limits of travel, velocity and force.

bus = "ethercat"                # or "canopen"
interface = "eth1"              # canopen: socketcan:can0
station = 1                     # position on the segment, or node number
cycle_time_us = 250
mode = "csp"                    # csv, cst
rotary = true                   # an axis that turns: every m below is a rad, every N a N m; lead_deg = 360; optional
axis = "x"                      # the axis of a plan that this drive plays; optional
[scaling]
counts_per_turn = 1048576
lead_mm = 10
rated_torque = 2.4              # N m, object 0x6076
[limits]
travel_mm = 100                 # from the start position, in both directions
velocity = 0.2                  # m/s
force = 500                     # N
following_error_mm = 1
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

from feeddrive.bus.gains import GAINS, GainSection, check_gain
from feeddrive.files.section import Section, named, read_section, text
from feeddrive.files.toml_file import TomlFile, read_toml
from feeddrive.language.block import Number, choice, parameter, part
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity

# 16 bits in steps of 0.1 ms: registers 0x0400 and 0x0420 of an EtherCAT slave (ETG.1000.4)
MOST_WATCH = 6.5  # s that the registers of a watchdog hold


class BusLimits(Section):
    """The limits at which a motion over the bus is aborted. Travel, velocity, force and following error must be stated.

    They are checked in every cycle, and written to the drive if it has objects for them.
    """

    travel: Number = parameter("m", "farthest from where the axis stands at the start, to both sides", above=0)
    velocity: Number = parameter("m/s", "largest speed", above=0)
    force: Number = parameter("N", "largest force", above=0)
    following_error: Number = parameter("m", "largest difference of target and position", above=0)
    skew: Number | None = parameter(
        "m",
        "largest difference of the two drives of a gantry from where its beam is free of force; needed for a gantry",
        above=0,
        default=None,
    )
    acceleration: Number | None = parameter(
        "m/s2", "largest acceleration; without it only jumps beyond the largest speed are seen", above=0, default=None
    )
    energy: Number | None = parameter(
        "J", "largest kinetic energy of largest_mass; absent: not watched", above=0, default=None
    )
    largest_mass: Number | None = parameter(
        "kg", "largest mass that the axis moves, workpiece included; needed in cst", above=0, default=None
    )
    breakaway_force: Number | None = parameter(
        "N",
        "largest force against which the axis may stand, friction and weight together; needed in cst",
        least=0,
        default=None,
    )
    position_least: Number | None = parameter("m", "lowest position in the drive's own count", default=None)
    position_most: Number | None = parameter("m", "highest position in the drive's own count", default=None)
    quick_stop_deceleration: Number = parameter(
        "m/s2", "with which the axis brakes, and its quick stop", above=0, default=2.0
    )


class BusDrive(Section):
    """A CiA 402 drive on a bus: address, cycle, mode, supervision, scaling and limits."""

    bus: str = choice("ethercat or canopen", options=("ethercat", "canopen"))
    station: int = choice("position on the segment, or number of the node", least=1, most=65535, default=1)
    cycle_time: Number = parameter("s", "from one exchange to the next", least=1e-5, most=1.0)
    mode: str = choice("mode of operation: csp, csv or cst", options=("csp", "csv", "cst"), default="csp")
    lag: int = choice("cycles from a target to the values that answer it", least=0, most=20, default=1)
    lost_frames: int = choice("lost frames in a row that end the motion", least=1, most=1000, default=3)
    late_cycles: int = choice(
        "lateness of a cycle, in cycles, above which the motion ends", least=1, most=10_000, default=3
    )
    watchdog: Number | None = parameter(
        "s",
        "time without frames after which the drive stops by itself; 0: no watchdog",
        least=0,
        most=MOST_WATCH,
        default=None,
    )
    rotary: bool = choice("the axis turns: lengths are angles in rad, forces torques in N m", default=False)
    brake_time: Number = parameter(
        "s",
        "for which the axis is held once it is switched on, before it moves: until its holding brake has opened",
        least=0,
        most=10.0,
        default=0.0,
    )
    stop_input: int | None = choice(
        "bit of the drive's digital inputs (0x60FD) that stops a motion; absent: none", least=0, most=31, default=None
    )
    stop_level: int = choice(
        "level of that input at which it stops; 0: a contact that opens, and so a broken wire, stops",
        options=(0, 1),
        default=0,
    )
    scaling: DriveScaling = part("increments and rated torque")
    limits: BusLimits = part("where a motion is aborted")

    def check(self) -> None:
        """Raise ParameterError for limits below the resolution, a watchdog time that is too short, or limits that are
        missing although cst requires them.
        """
        for name in ("largest_mass", "breakaway_force") if self.mode == "cst" else ():
            if getattr(self.limits, name) is None:
                raise ParameterError(
                    f'limits.{name} is missing: in mode = "cst" a drive that shows no motion counts as dead once its '
                    f"force must have moved the axis: state limits.largest_mass in kg and limits.breakaway_force in N"
                )
        if self.limits.energy is not None and self.limits.largest_mass is None:
            raise ParameterError("limits.energy needs limits.largest_mass, whose kinetic energy it bounds")
        if self.limits.force < self.scaling.newton:
            raise ParameterError(
                f"limits.force = {Quantity(self.limits.force, 'N'):6} is less than a thousandth of the rated torque, "
                f"{Quantity(self.scaling.newton, 'N'):6}: look at scaling.rated_torque or scaling.rated_force"
            )
        if 0.0 < self.watchdog_time <= self._silent_at_most:
            raise ParameterError(
                f"watchdog = {Quantity(self.watchdog_time, 's'):6} must be longer than late_cycles and lost_frames "
                f"together, {self.late_cycles + self.lost_frames} cycles or {Quantity(self._silent_at_most, 's'):6}, "
                "which the motion allows"
            )
        for name in ("travel", "following_error"):
            if getattr(self.limits, name) < self.scaling.metre:
                raise ParameterError(
                    f"limits.{name} = {Quantity(getattr(self.limits, name), 'm'):6 SI} is less than one increment, "
                    f"{Quantity(self.scaling.metre, 'm'):6 SI}: look at scaling.counts_per_turn, lead and increment"
                )

    def asks_stop(self, inputs: int | None) -> bool:
        """Return True if the digital inputs of the drive (0x60FD) ask for a stop; None: they are not known."""
        if self.stop_input is None or inputs is None:
            return False
        return inputs >> self.stop_input & 1 == self.stop_level

    @property
    def watchdog_time(self) -> float:
        """The watchdog time, s: the stated one or, if none is stated, the larger of 0.1 s and twice the longest time
        without a frame that is tolerated in motion.
        """
        if self.watchdog is not None:
            return self.watchdog
        # twice: the watchdog must not stop a drive while `play` still tolerates the silence
        return min(MOST_WATCH, max(0.1, 2.0 * self._silent_at_most))

    @property
    def _silent_at_most(self) -> float:
        """The longest time without a frame that is tolerated in motion, s."""
        return (self.late_cycles + self.lost_frames) * self.cycle_time


class DriveFile(Section):
    """The contents of a drive file: the interface, the name of the axis, and the drive."""

    interface: str = text(
        "interface of the bus; of canopen with its kind", shortest=1, example='"eth1" or "socketcan:can0"'
    )
    bitrate: int | None = choice("of canopen, bits per second; absent: as it is set", least=1, default=None)
    axis: str = text("axis of a plan that the drive moves; empty if none is named", default="")
    gains: dict[str, GainSection] = named(
        "objects of the gains of a drive that closes all loops by itself, as its manual lists them", names=tuple(GAINS)
    )
    drive: BusDrive = part("the drive, whose keys stand here", inline=True)

    def check(self) -> None:
        """Raise ParameterError for a gain whose unit does not measure it."""
        for name, gain in self.gains.items():
            check_gain(name, gain, self.drive.rotary)

    @property
    def name(self) -> str:
        """The name of the file from which the section was read, or an empty string."""
        return "" if self.read_from is None else self.read_from.file.name


def read_drive(path: str | Path) -> DriveFile:
    """Read a drive file. Raises FileError and ParameterError with file and line."""
    return drive_of(read_toml(path, "a drive file"))


def drive_of(file: TomlFile) -> DriveFile:
    """Return the contents of a parsed drive file. Raises ParameterError with file and line."""
    root = file.root()
    turns = root.values.get("rotary") is True
    return read_section(DriveFile, replace(root, turning={(): True}) if turns else root)


def interpolation_time(cycle_time: float) -> tuple[int, int]:
    """Return the two values of object 0x60C2 for a bus cycle in s: an eight-bit mantissa and the power of ten."""
    candidates = [(round(cycle_time / 10.0**power), power) for power in range(-6, 1)]
    fitting = [(value, power) for value, power in candidates if 0 < value <= 255]
    # deviations are rounded, so that equally good candidates tie and the finest power of ten is taken
    return min(
        fitting,
        key=lambda candidate: (round(abs(candidate[0] * 10.0 ** candidate[1] / cycle_time - 1.0), 6), candidate[1]),
    )


class DriveScaling(Section):
    """The length of one increment, and the force of one thousandth of the rated torque, at the table.

        increment = lead / (gear · counts_per_turn)                       for a rotary motor
        force     = torque_per_mille / 1000 · rated_torque · gear · 2π / lead

    A linear motor is described by `increment` and `rated_force` alone.  On an axis that turns, `lead` is its angle in
    one turn behind the gear, 2π rad for a table, and forces are torques of the axis.  With `force_sign` = -1 all
    torques that go to and come from the drive have the other sign; its limit of the torque has none.

    Raises ParameterError for an incomplete or mixed description.
    """

    increment: Number | None = parameter("m", "length of one increment at the table", above=0, default=None)
    rated_force: Number | None = parameter("N", "rated force (linear motor)", above=0, default=None)
    counts_per_turn: Number | None = parameter("", "increments in one turn of the motor", above=0, default=None)
    lead: Number | None = parameter("m", "table motion in one turn of the screw", above=0, default=None)
    gear: Number = parameter("", "turns of the motor in one turn of the screw", above=0, default=1)
    rated_torque: Number | None = parameter("N m", "rated torque of the motor, object 0x6076", above=0, default=None)
    force_sign: int = choice("-1: the torque of the drive counts against its positions", options=(1, -1), default=1)

    def check(self) -> None:
        """Raise ParameterError unless exactly one of the two descriptions is complete."""
        turning = {"counts_per_turn": self.counts_per_turn, "lead": self.lead, "rated_torque": self.rated_torque}
        linear = {"increment": self.increment, "rated_force": self.rated_force}
        # `gear` has a default and so decides nothing: any other rotary field makes the motor a rotary one
        missing = [name for name, value in (turning if self.turns else linear).items() if value is None]
        doubled = self.turns and any(value is not None for value in linear.values())
        if missing or doubled:
            raise ParameterError(
                "scaling needs counts_per_turn, lead and rated_torque of a motor that turns, or increment and "
                "rated_force of a linear motor" + (f"; {', '.join(missing)} is missing" if missing else ", not both")
            )

    @property
    def turns(self) -> bool:
        """True for a rotary motor."""
        return any(value is not None for value in (self.counts_per_turn, self.lead, self.rated_torque))

    @property
    def metre(self) -> float:
        """The travel at the table per increment, m."""
        if self.increment is not None:
            return self.increment
        assert self.lead is not None
        assert self.counts_per_turn is not None
        return self.lead / (self.gear * self.counts_per_turn)

    @property
    def travel_per_turn(self) -> float:
        """The travel at the table in one turn of a rotary motor, m."""
        assert self.lead is not None
        return self.lead / self.gear

    @property
    def newton(self) -> float:
        """The force at the table per thousandth of the rated torque, N."""
        if self.rated_force is not None:
            return 1e-3 * self.rated_force
        assert self.lead is not None
        assert self.rated_torque is not None
        return 1e-3 * self.rated_torque * self.gear * 2.0 * math.pi / self.lead

    @property
    def rated_milli(self) -> int:
        """The rated torque, object 0x6076: mN m for a rotary motor, mN for a linear one."""
        rated = self.rated_torque if self.rated_force is None else self.rated_force
        assert rated is not None
        return round(1e3 * rated)

    def turns_per_minute(self, velocity: float) -> float:
        """Convert a velocity of the table, m/s, to turns of the motor a minute; for a rotary motor only."""
        assert self.lead is not None
        return 60.0 * velocity * self.gear / self.lead

    def increments(self, metres: float) -> int:
        """Convert m, m/s or m/s² to the nearest whole number of increments."""
        return round(metres / self.metre)

    def per_mille(self, newtons: float) -> int:
        """Convert N to the nearest whole number of thousandths of the rated torque, with the sign of the drive."""
        return self.force_sign * round(newtons / self.newton)

    def force(self, per_mille: int) -> float:
        """Convert thousandths of the rated torque, as the drive tells them, to N."""
        return self.force_sign * per_mille * self.newton

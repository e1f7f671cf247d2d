"""A drive file: on which bus a drive is, what its increments are, and how far, fast and hard it may move.

bus = "ethercat"                # or "canopen"
interface = "eth1"              # canopen: socketcan:can0
station = 1                     # position on the segment, or number of the node
cycle_time_us = 250
mode = "csp"                    # csv, cst
[scaling]
counts_per_turn = 1048576
lead_mm = 10
rated_torque = 2.4              # N m, object 0x6076
[limits]
travel_mm = 100                 # from where it starts, to both sides
velocity = 0.2                  # m/s
force = 500                     # N
following_error_mm = 1
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from feeddrive.bus.scaling import DriveScaling
from feeddrive.files.blocks_from_toml import read_block
from feeddrive.files.toml_file import read_toml
from feeddrive.language.block import Block, Number, choice, parameter, part
from feeddrive.language.errors import ParameterError


class BusLimits(Block):
    """Where a motion over the bus is aborted. Every one must be stated, as nobody else knows the machine.

    They are watched here in every cycle, and written into the drive as far as it has objects for them.
    """

    travel: Number = parameter("m", "farthest from where the axis stands at the start, to both sides", above=0)
    velocity: Number = parameter("m/s", "largest speed", above=0)
    force: Number = parameter("N", "largest force", above=0)
    following_error: Number = parameter("m", "largest difference of target and position", above=0)
    position_least: Number | None = parameter("m", "lowest position in the drive's own count", default=None)
    position_most: Number | None = parameter("m", "highest position in the drive's own count", default=None)
    quick_stop_deceleration: Number = parameter("m/s2", "with which a quick stop brakes", above=0, default=2.0)


class BusDrive(Block):
    """A CiA 402 drive on a bus, as a drive file describes it."""

    bus: str = choice("ethercat or canopen", options=("ethercat", "canopen"))
    station: int = choice("position on the segment, or number of the node", least=1, most=65535, default=1)
    cycle_time: Number = parameter("s", "from one exchange to the next", least=1e-5, most=1.0)
    mode: str = choice("mode of operation: csp, csv or cst", options=("csp", "csv", "cst"), default="csp")
    lag: int = choice("cycles from a target to the values that answer it", least=0, most=20, default=1)
    lost_frames: int = choice("so many in a row end the motion", least=1, most=1000, default=3)
    scaling: DriveScaling = part("increments and rated torque")
    limits: BusLimits = part("where a motion is aborted")

    def check(self) -> None:
        """Limits that are less than one increment or one thousandth cannot be kept."""
        if self.limits.force < self.scaling.newton:
            raise ParameterError(
                f"limits.force = {self.limits.force:g} N is less than a thousandth of the rated torque, "
                f"{self.scaling.newton:g} N: look at scaling.rated_torque or scaling.rated_force"
            )
        for name in ("travel", "following_error"):
            if getattr(self.limits, name) < self.scaling.metre:
                raise ParameterError(
                    f"limits.{name} = {getattr(self.limits, name):g} m is less than one increment, "
                    f"{self.scaling.metre:g} m: look at scaling.counts_per_turn, lead and increment"
                )


@dataclass(frozen=True)
class DriveFile:
    """What a drive file says."""

    name: str
    interface: str
    bitrate: int | None
    drive: BusDrive


def read_drive(path: str | Path) -> DriveFile:
    """Read a drive file. Raises FileError and ParameterError with file and line."""
    file = read_toml(path)
    root = file.root()
    drive = read_block(BusDrive, root, besides={"interface", "bitrate"})
    interface, bitrate = root.values.get("interface"), root.values.get("bitrate")
    if not isinstance(interface, str) or not interface:
        raise root.error('interface is missing: name it as a text, as "eth1" or "socketcan:can0"', "interface")
    if bitrate is not None and (isinstance(bitrate, bool) or not isinstance(bitrate, int) or bitrate <= 0):
        raise root.error("bitrate must be a whole number of bits per second, as 1000000", "bitrate")
    return DriveFile(file.name, interface, bitrate, drive)

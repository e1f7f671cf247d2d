"""CiA 402 drives on a field bus: setpoints, logs, commissioning checks, and a virtual drive for tests."""

# written by `make stubs`

from feeddrive.bus.client import DriveClient as DriveClient
from feeddrive.bus.client import transport_of as transport_of
from feeddrive.bus.control_in_master import ControlInMaster as ControlInMaster
from feeddrive.bus.drive_file import BusDrive as BusDrive
from feeddrive.bus.drive_file import BusLimits as BusLimits
from feeddrive.bus.drive_file import DriveScaling as DriveScaling
from feeddrive.bus.drive_file import read_drive as read_drive
from feeddrive.bus.gantry import Gantry as Gantry
from feeddrive.bus.live import BusAxis as BusAxis
from feeddrive.bus.live import LiveAxis as LiveAxis
from feeddrive.bus.live import virtual_bus_axis as virtual_bus_axis
from feeddrive.bus.play import play_profile as play_profile
from feeddrive.bus.play import read_profile as read_profile
from feeddrive.bus.sampling import DriveSamples as DriveSamples
from feeddrive.bus.virtual_gantry import virtual_gantry as virtual_gantry

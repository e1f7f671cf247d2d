"""What was designed, in the form that a target runs: C, LinuxCNC, FMU, microcontroller, PLC, parameter files."""

from feeddrive.export.targets import write_export as write_export
from feeddrive.export.verify import Verified as Verified
from feeddrive.export.verify import verify_export as verify_export

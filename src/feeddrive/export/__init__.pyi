"""Export of a controller or an axis: C, LinuxCNC, FMU, microcontroller, PLC, and parameter files for drives."""

# written by `make stubs`

from feeddrive.export.linuxcnc_axis import LinuxcncAxis as LinuxcncAxis
from feeddrive.export.linuxcnc_axis import simulated_linuxcnc_axis as simulated_linuxcnc_axis
from feeddrive.export.linuxcnc_file import read_linuxcnc_file as read_linuxcnc_file
from feeddrive.export.targets import write_export as write_export
from feeddrive.export.verify import Verified as Verified
from feeddrive.export.verify import verify_export as verify_export

"""Export of a controller or an axis: C, LinuxCNC, FMU, microcontroller, PLC, and parameter files for drives."""

# written by `make stubs`

from feeddrive.export.targets import write_export as write_export
from feeddrive.export.verify import Verified as Verified
from feeddrive.export.verify import verify_export as verify_export

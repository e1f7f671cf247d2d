"""What was designed, in the form that a target runs: C, LinuxCNC, FMU, microcontroller, PLC, parameter files."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(__name__)

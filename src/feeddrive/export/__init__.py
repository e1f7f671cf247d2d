"""Export of a control or an axis: C, LinuxCNC, FMU, microcontroller, PLC, parameter files of makers."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(__name__)

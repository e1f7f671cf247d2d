"""Export of a controller or an axis: C, LinuxCNC, FMU, microcontroller, PLC, and parameter files for drives."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "linuxcnc_axis": "LinuxcncAxis simulated_linuxcnc_axis",
        "linuxcnc_file": "read_linuxcnc_file",
        "targets": "write_export",
        "verify": "Verified verify_export",
    },
    no_function="fd.export is now fd.write_export; feeddrive.export is the room that it stands in",
)

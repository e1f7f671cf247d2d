"""CiA 402 drives on a field bus: setpoints, logs, commissioning checks, and a virtual drive for tests."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "client": "DriveClient transport_of",
        "control_in_master": "ControlInMaster",
        "drive_file": "BusDrive BusLimits DriveScaling read_drive",
        "gantry": "Gantry",
        "live": "BusAxis LiveAxis virtual_bus_axis",
        "virtual_gantry": "virtual_gantry",
        "play": "play_profile read_profile",
        "sampling": "DriveSamples",
    },
)

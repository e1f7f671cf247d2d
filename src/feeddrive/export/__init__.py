"""What was designed, in the form that a target runs: C, LinuxCNC, FMU, microcontroller, PLC, parameter files."""

"""A component, its wiring and its desk trial for LinuxCNC."""

"""Export to LinuxCNC: a component, its wiring, and a simulated axis to try it without a machine."""

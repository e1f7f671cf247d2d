"""An FMU of somebody else as the plant of a loop."""

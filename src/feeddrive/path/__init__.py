"""From a part program to setpoints."""

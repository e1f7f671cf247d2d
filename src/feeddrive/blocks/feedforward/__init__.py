"""Forces computed from the setpoint."""

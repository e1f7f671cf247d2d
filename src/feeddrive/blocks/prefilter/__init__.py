"""Prefilters of the setpoint."""

"""The speed along a path: ramps of constant snap between nodes at which acceleration and jerk are zero."""

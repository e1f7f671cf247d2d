"""Forces that depend on motion and time."""

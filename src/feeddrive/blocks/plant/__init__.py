"""Plants: the linear mechanics of an axis."""

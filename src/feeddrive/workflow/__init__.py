"""Reports of a measurement: a frequency response that was estimated, an excitation that was designed."""

"""Identification from one motion log: mass, friction, dead time and cascade gains from position and force over time."""

"""Milling tools: the cutting force from the angle of the spindle."""

"""Frequency responses go in; modes, masses, springs and dampers come out."""

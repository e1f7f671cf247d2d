"""Identification from frequency responses: modes, masses, stiffnesses and dampings."""

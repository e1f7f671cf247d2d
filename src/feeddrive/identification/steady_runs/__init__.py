"""Identification from constant-speed runs: a friction curve."""

"""Gains: laws tuned under one rule, so that they can be compared."""

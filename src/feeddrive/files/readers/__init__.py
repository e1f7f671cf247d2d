"""Readers of measured logs, one module per format; no content of a file is ever executed."""

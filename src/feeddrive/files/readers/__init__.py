"""Readers of measured logs, one file a format; nothing that is read is ever executed."""

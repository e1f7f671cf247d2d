"""Encoders and their errors."""

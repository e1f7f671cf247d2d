"""Encoders and their faults."""

"""Filters in the forward path."""

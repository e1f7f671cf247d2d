"""Feedback laws, one per file."""

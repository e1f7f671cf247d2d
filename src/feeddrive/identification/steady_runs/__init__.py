"""Runs at constant speeds go in; a friction curve comes out."""

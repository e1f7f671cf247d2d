"""Certificates as files and as a page."""

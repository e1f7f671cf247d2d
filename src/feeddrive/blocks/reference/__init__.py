"""Motions: closed forms and logs."""

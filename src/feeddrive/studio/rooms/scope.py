"""A running log is followed."""

from __future__ import annotations

from feeddrive.studio.room import Room


class Scope(Room):
    """A running log is followed."""

    name = "scope"

"""A goal and limits are set, and the tuner searches for them."""

from __future__ import annotations

from feeddrive.studio.room import Room


class Goal(Room):
    """A goal and limits are set, and the tuner searches for them."""

    name = "goal"

"""What is taken away: machine file, report, exports, and all that was done as commands."""

from __future__ import annotations

from feeddrive.studio.room import Room


class Take(Room):
    """What is taken away: machine file, report, exports, and all that was done as commands."""

    name = "take"

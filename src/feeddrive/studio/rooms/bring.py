"""Files are brought: what each was understood to be, and what was wrong with it."""

from __future__ import annotations

from feeddrive.studio.room import Room


class Bring(Room):
    """Files are brought: what each was understood to be, and what was wrong with it."""

    name = "bring"

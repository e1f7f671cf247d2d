"""The control of now is proven, and works on the machine."""

from __future__ import annotations

from feeddrive.studio.room import Room


class Prove(Room):
    """The control of now is proven, and works on the machine."""

    name = "prove"

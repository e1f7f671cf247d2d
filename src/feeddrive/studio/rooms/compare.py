"""All laws on this axis at equal robustness."""

from __future__ import annotations

from feeddrive.studio.room import Room


class Compare(Room):
    """All laws on this axis at equal robustness."""

    name = "compare"

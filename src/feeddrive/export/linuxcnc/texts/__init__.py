"""Text templates for LinuxCNC files; `${name}` marks a place that is filled in."""

from __future__ import annotations

from pathlib import Path
from string import Template


def text(name: str) -> str:
    """One of the texts in this folder."""
    return (Path(__file__).parent / name).read_text(encoding="utf-8")


def filled(name: str, /, **values: object) -> str:
    """One of the texts, with the values in their places."""
    return Template(text(name)).substitute({key: str(value) for key, value in values.items()})

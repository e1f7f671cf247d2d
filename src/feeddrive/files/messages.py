"""Parts of error messages: values and names from a user's file, shortened to one line."""

from __future__ import annotations

from typing import Any

from feeddrive.language.errors import nearest

__all__ = ["nearest", "plain", "sentence", "shown"]


def plain(text: str) -> str:
    """The text without line ends and other marks that a terminal would obey; they may come from a damaged file."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def sentence(text: str) -> str:
    """A remark as a sentence: a capital at the start, unless that is a name, and a full stop."""
    first = text.split(" ", 1)[0].rstrip(":,;")
    return f"{text[:1].upper() if first.isalpha() else text[:1]}{text[1:]}."


def shown(value: Any) -> str:
    """A value for a message: short, on one line."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int) and abs(value) >= 10**20:
        return "a whole number of more than 20 digits"
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."

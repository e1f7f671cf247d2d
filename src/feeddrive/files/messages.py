"""Parts of error messages: values and names from a user's file, shortened to one line."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any


def plain(text: str) -> str:
    """The text without line ends and other marks that a terminal would obey; they may come from a damaged file."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def nearest(name: str, allowed: Iterable[str]) -> str:
    """`; did you mean a or b?`, or `; there are: ...` (at most 20) if nothing is near."""
    known = list(allowed)
    near = get_close_matches(name, known, 3)
    if near:
        return f"; did you mean {' or '.join(near)}?"
    if not known:
        return "; nothing is expected here"
    return f"; there are: {', '.join(known[:20])}{', ...' if len(known) > 20 else ''}"


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

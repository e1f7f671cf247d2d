"""Strings whose quantities remain numbers, so that they can be rendered in other units later.

A quantity in an f-string of feeddrive leaves a mark: its number, unit and error, and its text in the usual units; in an
f-string of other code it is plain text, so that users never see a mark.
`Text` is a str in the usual units that also keeps the marks, so that the same string can be rendered in other units.
User-written text, such as the name of a row, is never searched for marks.  (Template strings would make marks
unnecessary, but Python has them only since version 3.14.)

    remark = Text(f"the residual is {Quantity(5.88e-6, 'm')} RMS")      # the residual is 5.88 um RMS
    remark.shown(Units(rotary=True))                                    # the residual is 5.88 urad RMS
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Sequence
from typing import NamedTuple, Protocol

# characters of the private use area, which no font and no keyboard has
_BEGIN, _BETWEEN, _END = "\ue000", "\ue001", "\ue002"
_MARK = re.compile(f"{_BEGIN}([^{_BEGIN}{_END}]*){_END}")


KEEPS = "KEEPS_QUANTITIES"
"""A module outside of feeddrive that defines this name keeps quantities in its f-strings, too, and must use `Text`."""


def keeps_marks() -> bool:
    """Return True if the current f-string is in a module that preserves quantities; to be called from `__format__`."""
    # two frames up: the caller of the `__format__` that calls this
    names = sys._getframe(2).f_globals  # pyright: ignore[reportPrivateUsage]
    return str(names.get("__name__", "")).partition(".")[0] == "feeddrive" or KEEPS in names


_NUMBER = re.compile(r"-?(\d+(\.\d*)?(e[+-]?\d+)?|inf)|nan")  # as repr writes it


class Mark(NamedTuple):
    """The mark of a quantity in an f-string. All fields are strings: numbers as returned by `repr`, empty if absent.

    flags  s: the unit is the same for a rotary axis; b: shown without its unit
    plain  the text in the usual units
    """

    value: str
    unit: str
    error: str
    form: str
    flags: str
    plain: str

    def __str__(self) -> str:
        return f"{_BEGIN}{_BETWEEN.join(self)}{_END}"


class Reader(Protocol):
    """The display units chosen by the user, which convert marks to text; see `quantity.Units`."""

    def read(self, mark: Mark) -> str:
        """Return the text that a mark represents."""
        ...


def marks(text: str) -> list[Mark]:
    """Return the marks in a string, in order."""
    return [parsed for mark in _MARK.finditer(marked(text)) if (parsed := _mark(mark[1]))]


def _mark(content: str) -> Mark | None:
    parts: Sequence[str] = content.split(_BETWEEN)
    mark = Mark(*parts) if len(parts) == len(Mark._fields) else None
    return (
        # a text that a user wrote may hold these characters, too
        mark if mark and all(not number or _NUMBER.fullmatch(number) for number in (mark.value, mark.error)) else None
    )


def split(text: str) -> list[tuple[str, bool]]:
    """Split a string into pieces in order, each with a flag that is True if the piece is a mark."""
    pieces = re.split(f"({_BEGIN}[^{_END}]*{_END})", text)
    return [(piece, piece.startswith(_BEGIN)) for piece in pieces if piece]


def plain(text: str) -> str:
    """Return a string with each mark replaced by its quantity in the usual units."""

    def reading(match: re.Match[str]) -> str:
        mark = _mark(match[1])
        # no mark of ours: a user's text contains these characters, and no font shows them
        return ascii(match[0])[1:-1] if mark is None else mark.plain

    return text if _BEGIN not in text else _MARK.sub(reading, text)


def resolve(text: str, units: Reader) -> str:
    """Return a string with each marked quantity rendered in the given display units."""

    def reading(match: re.Match[str]) -> str:
        mark = _mark(match[1])
        return ascii(match[0])[1:-1] if mark is None else units.read(mark)

    text = marked(text)
    return _MARK.sub(reading, text) if _BEGIN in text else text


def marked(text: str) -> str:
    """Return a string that contains the marks of its quantities."""
    return text.marked if isinstance(text, Text) else text


class Text(str):
    """A string whose quantities remain numbers; as a plain str it shows them in the usual units.

    In an f-string it keeps its quantities; `str.join`, slices and other str methods return plain text: see `joined`.
    """

    marked: str

    def __new__(cls, text: str = "") -> Text:
        """Create a `Text` from an f-string or another string."""
        source = marked(text)
        instance = super().__new__(cls, plain(source))
        instance.marked = source
        return instance

    def __reduce__(self) -> tuple[type[Text], tuple[str]]:
        # the pickle of a str would lose the marks
        return Text, (self.marked,)

    def __format__(self, form: str) -> str:
        return self.marked if not form and keeps_marks() else format(str(self), form)

    def __add__(self, other: str) -> Text:
        return Text(self.marked + marked(other))

    def __radd__(self, other: str) -> Text:
        return Text(other + self.marked)

    def __html__(self) -> str:
        from markupsafe import escape

        return str(escape(self.marked))

    def shown(self, units: Reader) -> str:
        """Return the string, without marks, in the given display units."""
        return resolve(self.marked, units)


def joined(between: str, texts: Iterable[str]) -> Text:
    """Join strings, with their quantities preserved; `str.join` returns plain text."""
    return Text(between.join(map(marked, texts)))


def capitalized(text: str) -> Text:
    """Return a string with its first letter capitalized and its quantities preserved."""
    source = marked(text)
    return Text(source[:1].upper() + source[1:])

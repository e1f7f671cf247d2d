"""Where the keys of a TOML text stand: a scanner that follows keys and brackets and leaves the values alone.

The text has been read by tomllib before, so its grammar holds; the scanner only has to keep in step with it.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from typing import TypeAlias

# ("axis", "x", "forces", 0, "amplitude"): names of tables, and places in an array of tables
Key: TypeAlias = tuple[str | int, ...]

# No possessive groups: those of Python 3.11 before 3.11.5 miss matches.
_BLANK = re.compile(r"[ \t\r\n]*(?:#[^\n]*[ \t\r\n]*)*")
_BARE = re.compile(r"[A-Za-z0-9_-]+")
_SCALAR = re.compile(r"[^,\]}\n#]*")
_NUMBERS = re.compile(r"[^\[\]{}\"'#]*")  # in an array: everything up to the next thing that may nest
_STRINGS = (
    re.compile(r'"""[^"\\]*(?:(?:\\.|"(?!""))[^"\\]*)*"{3,5}', re.DOTALL),
    re.compile(r"'''[^']*(?:'(?!'')[^']*)*'{3,5}", re.DOTALL),
    re.compile(r'"[^"\\]*(?:\\.[^"\\]*)*"'),
    re.compile(r"'[^']*'"),
)
_ESCAPE = re.compile(r"\\(?:u([0-9A-Fa-f]{4})|U([0-9A-Fa-f]{8})|(.))")
_SHORT = {"b": "\b", "t": "\t", "n": "\n", "f": "\f", "r": "\r"}


def lines_of_keys(text: str) -> dict[Key, int]:
    """Line, from 1, of every key and table of a valid TOML text."""
    return _Scanner(text).lines


def spans_of_values(text: str) -> dict[Key, tuple[int, int]]:
    """Where the value of every pair of a valid TOML text begins and ends, as places in the text."""
    return _Scanner(text).spans


class _Scanner:
    def __init__(self, text: str) -> None:
        self.text = text
        self.at = 0
        self.ends = [found.start() for found in re.finditer("\n", text)]
        self.lines: dict[Key, int] = {}
        self.spans: dict[Key, tuple[int, int]] = {}
        self.count: dict[Key, int] = {}  # of the elements of each array of tables
        prefix: Key = ()
        self._skip(_BLANK)
        while self.at < len(text):
            if text.startswith("[", self.at):
                prefix = self._header()
            else:
                self._pair(prefix)
            self._skip(_BLANK)

    def _skip(self, pattern: re.Pattern[str]) -> str:
        found = pattern.match(self.text, self.at)
        if found is None:
            return ""
        self.at = found.end()
        return found[0]

    def _mark(self, key: Key) -> None:
        self.lines.setdefault(key, bisect_right(self.ends, self.at - 1) + 1)

    def _header(self) -> Key:
        double = self.text.startswith("[[", self.at)
        self.at += 2 if double else 1
        path: Key = ()
        parts = self._dotted()
        for k, part in enumerate(parts):
            path = (*path, part)
            self._mark(path)
            if double and k == len(parts) - 1:
                self.count[path] = self.count.get(path, 0) + 1
            if path in self.count:
                path = (*path, self.count[path] - 1)
                self._mark(path)
        self.at += 2 if double else 1
        return path

    def _dotted(self) -> list[str]:
        """The parts of a key up to, and not with, its `=` or `]`."""
        parts: list[str] = []
        while True:
            self._skip(_BLANK)
            if self.text[self.at : self.at + 1] in ("'", '"'):
                quoted = self._string()
                parts.append(_unescaped(quoted[1:-1]) if quoted[0] == '"' else quoted[1:-1])
            else:
                parts.append(self._skip(_BARE))
            self._skip(_BLANK)
            if not self.text.startswith(".", self.at):
                return parts
            self.at += 1

    def _pair(self, prefix: Key) -> None:
        start = self.at
        parts = self._dotted()
        end, self.at = self.at, start
        key = prefix
        for part in parts:
            key = (*key, part)
            self._mark(key)
        self.at = end + 1
        self._skip(_BLANK)
        begin = self.at
        self._value(key)
        self.spans[key] = begin, begin + len(self.text[begin : self.at].rstrip())

    def _value(self, key: Key) -> None:
        match self.text[self.at : self.at + 1]:
            case "'" | '"':
                self._string()
            case "[":
                self._array(key)
            case "{":
                self._inline(key)
            case _:
                self._skip(_SCALAR)

    def _string(self) -> str:
        return next((found for pattern in _STRINGS if (found := self._skip(pattern))), "") or self._step()

    def _step(self) -> str:
        self.at += 1
        return self.text[self.at - 1 : self.at] * 2

    def _array(self, key: Key) -> None:
        self.at += 1
        place = 0
        while self.at < len(self.text):
            place += self._skip(_NUMBERS).count(",")
            self._skip(_BLANK)
            match self.text[self.at : self.at + 1]:
                case "]":
                    self.at += 1
                    return
                case "[" | "{":
                    self._mark((*key, place))
                    self._value((*key, place))
                case "'" | '"':
                    self._string()
                case "}":
                    self._step()
                case _:
                    pass

    def _inline(self, key: Key) -> None:
        self.at += 1
        self._skip(_BLANK)
        while self.at < len(self.text) and not self.text.startswith("}", self.at):
            self._pair(key)
            self._skip(_BLANK)
            if self.text.startswith(",", self.at):
                self.at += 1
                self._skip(_BLANK)
        self.at += 1


def _unescaped(text: str) -> str:
    return _ESCAPE.sub(lambda m: chr(int(m[1] or m[2], 16)) if m[1] or m[2] else _SHORT.get(m[3], m[3]), text)

"""Editing of TOML files: values and sections are replaced; all other comments, order and whitespace are kept.

    edit = TomlEdit(text, "machine.toml")
    edit.set(("axis", "x", "plant", "mass"), 95.2, "kg")     # finds mass, mass_kg or mass_g and keeps its unit
    edit.replace(("axis", "x", "friction_load"), section)    # another kind of block; comments in it stay
    edit.text

It uses the scanner that locates lines for error messages, so that no second TOML parser is needed: a library such as
tomlkit would add 8000 lines for these three operations, and may accept texts that tomllib rejects.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import replace
from typing import Any

from feeddrive.files.toml_file import Key, TomlFile, is_rotary, lines_of_keys, parse_toml, spans_of_values
from feeddrive.language import units
from feeddrive.language.errors import FileError, ParameterError
from feeddrive.language.text import plain
from feeddrive.language.units import rounded


def quoted(text: str) -> str:
    """Return a text as a TOML basic string, with every character preserved."""
    # JSON's escapes are TOML's, but JSON leaves DEL as it is, which TOML forbids
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007F")


def with_values(file: TomlFile, values: Mapping[Key, Any]) -> TomlFile:
    """Return the file with some values replaced, as if they were written in it; line numbers are unchanged.

    Raises ParameterError for a key in a missing section.
    """
    content: Any = deepcopy(file.content)
    for key, value in values.items():
        table: Any = content
        for part in key[:-1]:
            inside = isinstance(table, dict) and part in table
            if not inside and not (isinstance(table, list) and isinstance(part, int) and part < len(table)):
                raise ParameterError(f"{file.name}: there is no section [{'.'.join(map(str, key[:-1]))}]")
            held: Any = table  # by a name or by a number, as has just been asked
            table = held[part]
        if not isinstance(table, dict):
            raise ParameterError(f"{file.name}: {'.'.join(map(str, key[:-1]))} is no section")
        table[key[-1]] = value
    return replace(file, content=content)


_HEADER_COMMENT = re.compile(r"^[ \t]*\[[^\]#\"']*\]+([ \t]*#[^\n]*)")
_HEADER = re.compile(r"^[ \t]*\[", re.MULTILINE)


class TomlEdit:
    """A TOML text under edit; `name` is the name of the file in messages.

    Raises FileError for a text that is not TOML, and for a change that would make it invalid.
    """

    def __init__(self, text: str, name: str) -> None:
        self.name = name
        self.text = text
        self._check()

    def set(self, key: Key, value: float | str | bool, unit: str = "", digits: int = 6) -> Key:
        """Change the value of a key, or add it at the end of its section, and return the key as written in the file.

        The key in the file may carry another unit of the same dimension (`mass_g`); the value is then converted.
        Numbers are written with `digits` significant figures.
        Raises ParameterError if the section is missing.
        """
        spans = spans_of_values(self.text)
        place, factor = self._find(spans, key, unit)
        if place is None:
            self._insert(key, value, digits)
        else:
            begin, end = spans[place]
            written = _written(value / factor if isinstance(value, float) else value, digits)
            self.text = self.text[:begin] + written + self.text[end:]
        self._check()
        return key if place is None else place

    def replace(self, key: Key, section: str) -> None:
        """Replace [key] and its subtables by a section with its own header; add the section if there is none.

        Comment lines within the old section are kept above the new one, and so is the comment after the old header.
        """
        places = self._sections(key)
        if not places:
            self.add(section)
            return
        lines = self.text.splitlines(keepends=True)
        gone = sorted(line for begin, end in places for line in range(begin, end))
        kept = [lines[i] for i in gone if lines[i].lstrip().startswith("#")]
        inside = set(gone)
        edited: list[str] = []
        for i, line in enumerate(lines):
            if i == gone[0]:
                header, _, rest = section.strip().partition("\n")
                comment = _HEADER_COMMENT.match(lines[gone[0]])
                edited += [
                    *kept,
                    f"{header}{comment[1] if comment and '#' not in header else ''}\n{rest}".rstrip() + "\n",
                    "\n",
                ]
            if i not in inside:
                edited.append(line)
        self.text = "".join(edited)
        self._check()

    def has(self, key: Key) -> bool:
        """Return True if the key or section exists."""
        return key in lines_of_keys(self.text)

    def remove(self, key: Key) -> None:
        """Remove the sections [key] and [[key]] with their subtables; comments on separate lines are kept.

        Raises FileError if the value is written inline, as `filters = [{ ... }]`.
        """
        places = self._sections(key)
        if not places and (self.has(key) or (isinstance(key[-1], int) and self.has(key[:-1]))):
            named = ".".join(str(part) for part in key if isinstance(part, str))
            raise FileError(f"{self.name}: write {named} as a section, [{named}] or [[{named}]]: only that is removed")
        for begin, end in reversed(places):
            lines = self.text.splitlines(keepends=True)
            kept = [line for line in lines[begin:end] if line.lstrip().startswith("#")]
            self.text = "".join([*lines[:begin], *kept, *lines[end:]])
        self._check()

    def silence(self, key: Key, unit: str = "") -> None:
        """Comment out the line of a key, in any unit; do nothing if the key is absent."""
        spans = spans_of_values(self.text)
        place, _ = self._find(spans, key, unit)
        if place is not None:
            begin = self.text.rfind("\n", 0, spans[place][0]) + 1
            self.text = f"{self.text[:begin]}# {self.text[begin:]}"
            self._check()

    def comment(self, key: Key, words: str) -> None:
        """Append words to the comment after a value, replacing an earlier remark that starts with the same word."""
        _, end = spans_of_values(self.text)[key]
        after = self.text.find("\n", end)
        after = len(self.text) if after < 0 else after
        rest = self.text[end:after]
        words = plain(words)
        head = words.split(" ", 1)[0]
        rest = re.sub(rf"(; |(?<=# )){re.escape(head)} [^;]*$", "", rest).rstrip()
        joined = f"{rest}; {words}" if rest.strip(" #") else f"{rest.replace('#', '').rstrip()}  # {words}"
        self.text = self.text[:end] + joined + self.text[after:]
        self._check()

    def add(self, section: str) -> None:
        """Append a section at the end of the text."""
        self.text = f"{self.text.rstrip()}\n\n{section.strip()}\n"
        self._check()

    def _check(self) -> None:
        try:
            parse_toml(self.text, self.name)
        except FileError as error:
            raise FileError(f"{error} (in the changed text)") from None

    def _find(self, spans: dict[Key, tuple[int, int]], key: Key, unit: str) -> tuple[Key | None, float]:
        """Return the key as written in the file and the factor from its unit to `unit` or its rotary counterpart."""
        unit = units.turning(unit) if is_rotary(parse_toml(self.text, self.name).content, key) else unit
        if key in spans:
            return key, 1.0
        for candidate in spans:
            if candidate[:-1] == key[:-1] and str(candidate[-1]).startswith(f"{key[-1]}_"):
                try:
                    return candidate, units.factor(str(candidate[-1]).removeprefix(f"{key[-1]}_"), unit)
                except ParameterError:
                    continue
        return None, 1.0

    def _insert(self, key: Key, value: float | str | bool, digits: int) -> None:
        """Insert a line after the last key of the section, or after its header."""
        lines = lines_of_keys(self.text)
        section = key[:-1]
        # a value may have several lines: the new line is added after its end
        own = [
            self.text.count("\n", 0, end) + 1
            for candidate, (_, end) in spans_of_values(self.text).items()
            if candidate[:-1] == section
        ]
        if section not in lines and not own:
            raise ParameterError(f"{self.name}: there is no section [{'.'.join(map(str, section))}]")
        after = max([*own, lines.get(section, 0)])
        rows = self.text.splitlines(keepends=True)
        if not own and any(line == after and len(other) > len(section) for other, line in lines.items()):
            # only a part of the section has a header: the section gets one before it
            while after > 1 and rows[after - 2].lstrip().startswith("#"):
                after -= 1
            rows[after - 1 : after - 1] = [f"[{'.'.join(map(str, section))}]\n", "\n"]
        if not rows[after - 1].endswith("\n"):
            rows[after - 1] += "\n"
        rows.insert(after, f"{key[-1]} = {_written(value, digits)}\n")
        self.text = "".join(rows)

    def _sections(self, key: Key) -> list[tuple[int, int]]:
        """Return the line ranges, from 0, of [key], [[key]] and their subtables, each up to the next header."""
        headers = [self.text.count("\n", 0, header.start()) for header in _HEADER.finditer(self.text)]
        lines = lines_of_keys(self.text)
        own = {line - 1 for candidate, line in lines.items() if candidate[: len(key)] == key}
        total = self.text.count("\n") + 1
        ends = [*headers[1:], total]
        ranges: list[tuple[int, int]] = []
        for begin, end in zip(headers, ends, strict=True):
            if begin in own:
                ranges.append((begin, self._before_comments(begin, end)))
        return ranges

    def _before_comments(self, begin: int, end: int) -> int:
        """Return the end of a section, excluding the comments that belong to the next header."""
        rows = self.text.splitlines()
        last = min(end, len(rows))
        while last > begin + 1 and (not rows[last - 1].strip() or rows[last - 1].lstrip().startswith("#")):
            last -= 1
        blank = last
        while blank < min(end, len(rows)) and not rows[blank].strip():
            blank += 1
        return blank


def _written(value: float | str | bool, digits: int) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    return repr(rounded(value, digits))

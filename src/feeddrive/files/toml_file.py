"""TOML files with the line of every key, so that an error says `machine.toml:12: axis.x.plant.mass ...`.

The standard library reads the values.  A small scanner then finds the lines: it follows keys and brackets and skips the
values; the scanner does not check, since tomllib has accepted the text before.  Text is UTF-8, at most 4 MB.
"""

from __future__ import annotations

import re
import tomllib
from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

from feeddrive.files.atomic_io import read_whole
from feeddrive.language.errors import FeeddriveError, FileError, ParameterError, nearest, plain, shown

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
    """Return the line, from 1, of every key and table of a valid TOML text."""
    return _Scanner(text).lines


def spans_of_values(text: str) -> dict[Key, tuple[int, int]]:
    """Return the start and end offsets of the value of every key/value pair of a valid TOML text."""
    return _Scanner(text).spans


class _Scanner:
    def __init__(self, text: str) -> None:
        self.text = text
        self.at = 0
        self.ends = [newline.start() for newline in re.finditer("\n", text)]
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
        match = pattern.match(self.text, self.at)
        if match is None:
            return ""
        self.at = match.end()
        return match[0]

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
        """Return the parts of a dotted key, up to but excluding its `=` or `]`."""
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
        return next((skipped for pattern in _STRINGS if (skipped := self._skip(pattern))), "") or self._step()

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


MOST_BYTES = 4_000_000

# A dotted name of 64 parts: tomllib's time grows with the square of that length, and nothing here nests so deep.
_TOO_DEEP = re.compile(r"(?<![\w\"'-])(?:[\w\"'-]++[ \t]*+\.[ \t]*+){64}")

_ADVICE = {
    "Invalid value": 'a text needs quotes ("..."), a number a decimal point (1.5, not 1,5)',
    "Expected '=' after a key": "a line reads  key = value",
    "Expected newline or end of document": "write one key a line, a number with a decimal point (1.5, not 1,5)",
    "Cannot overwrite a value": "the key is given twice; remove one",
    "Cannot declare": "the section is opened twice; put its keys together",
    "Unclosed array": "a bracket ] is missing",
    "Unterminated string": "a closing quote is missing",
    "Illegal character '\\n'": "a closing quote is missing",
    "Invalid initial character": "a key consists of letters, digits, _ and -",
}


@dataclass(frozen=True)
class TomlFile:
    """The content of a TOML file with the line number of each key."""

    name: str
    text: str
    content: Mapping[str, Any]
    lines: Mapping[Key, int]

    def __repr__(self) -> str:
        return f"TomlFile({self.name!r}, {len(self.lines)} keys)"

    def where(self, key: Key) -> str:
        """Return `machine.toml:12` for a key, or for the innermost table around it that has a line."""
        for end in range(len(key), 0, -1):
            if key[:end] in self.lines:
                return f"{self.name}:{self.lines[key[:end]]}"
        return self.name

    def root(self) -> TomlTable:
        """Return the root table of the file."""
        return TomlTable(self, (), self.content)


Value: TypeAlias = Any


@dataclass(frozen=True)
class TomlTable:
    """A table in a TOML file, with the lines of its keys.

    turning  by key prefix, True if the values below it belong to a rotary axis of another file, as the motion of a job
             does; the longest matching prefix applies
    """

    file: TomlFile
    key: Key
    values: Mapping[str, Value]
    turning: Mapping[Key, bool] = field(default_factory=dict[Key, bool])

    @property
    def rotary(self) -> bool:
        """True if this table belongs to a rotary axis, such as `[axis.c]` with `rotary = true`."""
        begins = (self.key[:end] for end in range(len(self.key), -1, -1))
        turning = next((self.turning[begin] for begin in begins if begin in self.turning), False)
        return turning or is_rotary(self.file.content, self.key)

    def dotted(self, name: str | Key = ()) -> str:
        """Return the dotted name of a key: `axis.x.plant.mass`."""
        return ".".join(map(str, self._key(name)))

    def where(self, name: str | Key = ()) -> str:
        """Return `machine.toml:12` for this section or a key in it."""
        return self.file.where(self._key(name))

    def _key(self, name: str | Key) -> Key:
        return (*self.key, name) if isinstance(name, str) else (*self.key, *name)

    def error(self, message: str, name: str | Key = (), kind: type[FeeddriveError] = ParameterError) -> FeeddriveError:
        """Return the error `file:line: message` for this section or a key in it."""
        return kind(plain(f"{self.where(name)}: {message}"))

    def section(self, name: str) -> TomlTable:
        """Return the table of that name. Raise ParameterError if it is missing or not a table."""
        table = self.optional(name)
        if table is None:
            raise self.error(f"section [{self.dotted(name)}] is missing")
        return table

    def optional(self, name: str) -> TomlTable | None:
        """Return the table of that name, or None. Raise ParameterError for anything else."""
        value = self.values.get(name)
        if value is None:
            return None
        if not isinstance(value, dict):
            raise self.error(f"{self.dotted(name)} = {shown(value)} must be a section [{self.dotted(name)}]", name)
        return TomlTable(self.file, (*self.key, name), value, self.turning)

    def named(self, name: str) -> dict[str, TomlTable]:
        """Return the tables `[name.NAME]` by NAME. Raise ParameterError if there is none."""
        group = self.optional(name)
        if group is None or not group.values:
            raise self.error(f"there must be at least one section [{self.dotted(name)}.NAME]")
        return {own_name: group.section(own_name) for own_name in group.values}

    def listed(self, name: str) -> tuple[TomlTable, ...]:
        """Return the tables `[[name]]` in their order. Raise ParameterError for anything else."""
        value = self.values.get(name, [])
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            raise self.error(
                f"{self.dotted(name)} must be a list of sections, each under [[{self.dotted(name)}]]", name
            )
        return tuple(TomlTable(self.file, (*self.key, name, k), item, self.turning) for k, item in enumerate(value))

    def refuse_unknown(self, known: Iterable[str]) -> None:
        """Raise ParameterError at the first unknown key, suggesting similar known ones."""
        allowed = list(known)
        for name in self.values:
            if name not in allowed:
                raise self.error(f"key '{self.dotted(name)}' is not known{nearest(name, allowed)}", name)


def is_rotary(content: Mapping[str, Any], key: Key) -> bool:
    """Return True if a key belongs to a rotary axis."""
    axes = content.get("axis")
    axis = axes.get(key[1]) if isinstance(axes, dict) and len(key) > 1 and key[0] == "axis" else None
    return isinstance(axis, dict) and axis.get("rotary") is True


# what a file is by its keys, and what takes it
_KINDS: dict[str, tuple[Callable[[Mapping[str, Any]], bool], str]] = {
    "a machine file": (
        lambda keys: isinstance(keys.get("axis"), dict),
        "it has sections [axis.NAME]; `feeddrive tune`, `export` and others take it, and a job names it",
    ),
    "a study": (
        lambda keys: isinstance(keys.get("vary"), list),
        "it says under [[vary]] what varies in a job; `feeddrive sweep` takes it",
    ),
    "a job": (
        lambda keys: (
            isinstance(keys.get("machine"), str)
            and not keys.keys().isdisjoint({"reference", "law", "log", "program"})
            and "vary" not in keys
        ),
        "it names a machine file, as  machine = ...; `feeddrive run` takes it",
    ),
    "a drive file": (
        lambda keys: isinstance(keys.get("interface"), str),
        "it has an interface, scaling and limits; `feeddrive play` and `listen` take it by --drive",
    ),
    "roles of a log's columns": (
        lambda keys: isinstance(keys.get("log"), dict) and "machine" not in keys,
        "`feeddrive channels` writes it, and other commands take it by --channels",
    ),
}
_PAIR = re.compile(r"^\s*(?:\[[^,]*\]\s*(?:#.*)?$|[\w.\"'-]+\s*=)", re.MULTILINE)


def read_toml(path: str | Path, wanted: str = "", *, quoting: bool = True) -> TomlFile:
    """Read a TOML file. Raises FileError with file, line and remedy if it is missing, too large or not TOML.

    wanted   "a machine file", "a job" or "a drive file": a file of another kind is refused with its kind in the message
    quoting  show the line in errors; False for a file that is only referenced by another file
    """
    name, content = str(path), read_whole(path, MOST_BYTES)
    try:
        text = _decoded(name, content)
    except FileError as error:
        raise FileError(f"{error}; {wanted} is wanted here" if wanted else f"{error}") from None
    if wanted and text.strip() and not _PAIR.search(text):
        raise FileError(f"{name}: is no TOML text; {wanted} is wanted here: {_KINDS[wanted][1]}")
    file = parse_toml(text, name, quoting=quoting)
    is_kind = {kind: fits(file.content) for kind, (fits, _) in _KINDS.items()}
    if wanted and not is_kind[wanted] and any(is_kind.values()):
        other = next(kind for kind, fits in is_kind.items() if fits)
        raise FileError(f"{name}: is {other}, not {wanted}; {_KINDS[other][1]}")
    return file


def _decoded(name: str, content: bytes) -> str:
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise FileError(f"{name}: is UTF-16 text; save it as UTF-8")
    if b"\0" in content:
        raise FileError(f"{name}: is a binary file, not TOML text")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise FileError(
            f"{name}:{line}: holds the byte 0x{content[error.start]:02x}, which is not UTF-8 text; save it as UTF-8"
        ) from None


def parse_toml(text: str, name: str, *, quoting: bool = True) -> TomlFile:
    """Parse a TOML text; `name` is the name of the file in messages. Raise FileError as `read_toml`."""
    deep = _TOO_DEEP.search(text)
    if deep is not None:
        raise FileError(f"{name}:{text.count(chr(10), 0, deep.start()) + 1}: a name of more than 64 parts")
    try:
        content = tomllib.loads(text)
        lines = lines_of_keys(text)
    except tomllib.TOMLDecodeError as error:
        raise _syntax_error(name, text, str(error), quoting) from None
    except RecursionError:
        raise FileError(f"{name}: is nested too deeply") from None
    except ValueError as error:  # a whole number of thousands of digits, a date that does not exist
        raise FileError(f"{name}: holds a value that cannot be read: {error}") from None
    return TomlFile(name, text, content, lines)


def _syntax_error(name: str, text: str, message: str, quoting: bool) -> FileError:
    match = re.fullmatch(r"(.*) \(at (?:line (\d+), column \d+|end of document)\)", message, re.DOTALL)
    reason, line = (match[1], int(match[2] or 0)) if match else (message, 0)
    rows = text.rstrip().split("\n")
    line = min(line or len(rows), len(rows))
    quoted = f" in  {_short(rows[line - 1])}" if quoting and rows and rows[line - 1].strip() else ""
    advice = next((f"; {advice}" for start, advice in _ADVICE.items() if reason.startswith(start)), "")
    stated = f"is not valid TOML: {reason[:1].lower()}{reason[1:]}{quoted}{advice}"
    return FileError(plain(f"{name}:{max(line, 1)}: {stated}"))


def _short(row: str) -> str:
    row = row.strip()
    return row if len(row) <= 60 else row[:57] + "..."

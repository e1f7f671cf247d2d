"""TOML files with the line of every key, so that an error begins with `machine.toml:12: axis.x.plant.mass`.

The standard library reads the values.  A small scanner then locates the keys: it follows keys and brackets and skips
values, without validation, since tomllib has already accepted the text.  Text is UTF-8, at most 4 MB.

An edit replaces values and sections and keeps all comments, order and whitespace around them.

    edit = TomlEdit(text, "machine.toml")
    edit.set(("axis", "x", "plant", "mass"), 95.2, "kg")     # finds mass, mass_kg or mass_g and keeps its unit
    edit.replace(("axis", "x", "friction_load"), section)    # another kind of block; comments in it stay
    edit.text

An edit uses the scanner that locates lines for error messages, so that no second TOML parser is needed: a library such
as tomlkit would add 8000 lines for these three operations, and may accept files that tomllib rejects.
"""

from __future__ import annotations

import json
import re
import tomllib
from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping
from copy import deepcopy
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeAlias

from feeddrive.files.atomic_io import read_whole
from feeddrive.language import units
from feeddrive.language.errors import FeeddriveError, FileError, ParameterError, nearest, plain, shown
from feeddrive.language.text import plain as in_usual_units
from feeddrive.language.units import rounded

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


def key_of(path: str) -> Key:
    """Return the key of a dotted path: ("axis", "x", "forces", 0) for `axis.x.forces.0`."""
    return tuple(int(part) if part.isdigit() else part for part in path.split("."))


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
        # The first line counts: a table is opened where it is mentioned first.
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
        # Triple quotes are tried first, since two quotes alone are an empty string.
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

    turning  by key prefix, True if the values under this prefix belong to a rotary axis that another file declares, as
             in the motion of a job; the longest matching prefix applies
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
        """Return the table of that name, or None if it is absent. Raise ParameterError if it is not a table."""
        value = self.values.get(name)
        if value is None:
            return None
        if not isinstance(value, dict):
            raise self.error(f"{self.dotted(name)} = {shown(value)} must be a section [{self.dotted(name)}]", name)
        return TomlTable(self.file, (*self.key, name), value, self.turning)

    def named(self, name: str) -> dict[str, TomlTable]:
        """Return the tables `[name.NAME]` by NAME. Raise ParameterError if there are none."""
        group = self.optional(name)
        if group is None or not group.values:
            raise self.error(f"there must be at least one section [{self.dotted(name)}.NAME]")
        return {own_name: group.section(own_name) for own_name in group.values}

    def listed(self, name: str) -> tuple[TomlTable, ...]:
        """Return the tables `[[name]]` in order. Raise ParameterError if the value is not a list of tables."""
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


# tests of the kind of a file by its keys, and the commands that accept it
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
    "an axis of LinuxCNC": (
        lambda keys: isinstance(keys.get("hal"), str),
        "it names a HAL file, pins, a thread and limits",
    ),
    "roles of a log's columns": (
        lambda keys: isinstance(keys.get("log"), dict) and "machine" not in keys,
        "`feeddrive channels` writes it, and other commands take it by --channels",
    ),
}
_PAIR = re.compile(r"^\s*(?:\[[^,]*\]\s*(?:#.*)?$|[\w.\"'-]+\s*=)", re.MULTILINE)


def read_toml(path: str | Path, wanted: str = "", *, quoting: bool = True) -> TomlFile:
    """Read a TOML file. Raises FileError with file, line and remedy if it is missing, too large or not TOML.

    wanted   "a machine file", "a job", "a drive file" or "an axis of LinuxCNC": a file of another kind is refused,
             and the message names its kind
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
        # Windows editors put a byte order mark in front.
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise FileError(
            f"{name}:{line}: holds the byte 0x{content[error.start]:02x}, which is not UTF-8 text; save it as UTF-8"
        ) from None


def parse_toml(text: str, name: str, *, quoting: bool = True) -> TomlFile:
    """Parse a TOML text; `name` is the name of the file in messages. Raise FileError as `read_toml` does."""
    deep = _TOO_DEEP.search(text)
    if deep is not None:
        raise FileError(f"{name}:{text.count(chr(10), 0, deep.start()) + 1}: a name of more than 64 parts")
    try:
        # tomllib first: the scanner relies on a valid text.
        content = tomllib.loads(text)
        lines = lines_of_keys(text)
    except tomllib.TOMLDecodeError as error:
        raise _syntax_error(name, text, str(error), quoting) from None
    except RecursionError:
        raise FileError(f"{name}: is nested too deeply") from None
    except ValueError as error:
        # Such as a whole number of thousands of digits, or a date that does not exist.
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


def quoted(text: str) -> str:
    """Return a string as a TOML basic string, with every character preserved."""
    # JSON's escapes are TOML's, but JSON leaves DEL as it is, which TOML forbids
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007F")


def with_values(file: TomlFile, values: Mapping[Key, Any]) -> TomlFile:
    """Return a copy of the file in which some values are replaced or added; line numbers are unchanged.

    Raises ParameterError for a key in a missing section.
    """
    # The content of the file stays as it was read, for other combinations of values.
    content: Any = deepcopy(file.content)
    for key, value in values.items():
        table: Any = content
        for part in key[:-1]:
            inside = isinstance(table, dict) and part in table
            if not inside and not (isinstance(table, list) and isinstance(part, int) and part < len(table)):
                raise ParameterError(f"{file.name}: there is no section [{'.'.join(map(str, key[:-1]))}]")
            # Indexed by a name or a number, as checked above.
            held: Any = table
            table = held[part]
        if not isinstance(table, dict):
            raise ParameterError(f"{file.name}: {'.'.join(map(str, key[:-1]))} is no section")
        table[key[-1]] = value
    return replace(file, content=content)


_HEADER_COMMENT = re.compile(r"^[ \t]*\[[^\]#\"']*\]+([ \t]*#[^\n]*)")
_HEADER = re.compile(r"^[ \t]*\[", re.MULTILINE)


class TomlEdit:
    """A TOML text that is being edited; `name` is the name of the file in messages.

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

        Raises FileError if the value is written inline, as in `filters = [{ ... }]`.
        """
        places = self._sections(key)
        if not places and (self.has(key) or (isinstance(key[-1], int) and self.has(key[:-1]))):
            named = ".".join(str(part) for part in key if isinstance(part, str))
            raise FileError(f"{self.name}: write {named} as a section, [{named}] or [[{named}]]: only that is removed")
        # From the end, so that the earlier line numbers stay valid.
        for begin, end in reversed(places):
            lines = self.text.splitlines(keepends=True)
            kept = [line for line in lines[begin:end] if line.lstrip().startswith("#")]
            self.text = "".join([*lines[:begin], *kept, *lines[end:]])
        self._check()

    def silence(self, key: Key, unit: str = "") -> None:
        """Comment out the line of a key, in whichever unit it is given; do nothing if the key is absent."""
        spans = spans_of_values(self.text)
        place, _ = self._find(spans, key, unit)
        if place is not None:
            begin = self.text.rfind("\n", 0, spans[place][0]) + 1
            self.text = f"{self.text[:begin]}# {self.text[begin:]}"
            self._check()

    def comment(self, key: Key, words: str) -> None:
        """Append a remark to the comment after a value; it replaces an earlier one that starts with the same word."""
        _, end = spans_of_values(self.text)[key]
        after = self.text.find("\n", end)
        after = len(self.text) if after < 0 else after
        rest = self.text[end:after]
        words = in_usual_units(words)
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
        """Return the line after a section, excluding the comments that belong to the next header."""
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
        return quoted(value)
    # a whole number of a choice must not become 1.0
    return repr(value) if isinstance(value, int) else repr(rounded(value, digits))

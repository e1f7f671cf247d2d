"""The lines of a part program: read one by one at bounded length, with places to go back to."""

from __future__ import annotations

from codecs import BOM_UTF8, BOM_UTF16_BE, BOM_UTF16_LE
from io import BufferedReader
from pathlib import Path
from typing import NamedTuple

from feeddrive.language.errors import FileError, ProgramError, plain
from feeddrive.language.text import Text

LONGEST_LINE = 65536
"""Bytes of a line, its end included; a longer one is refused after so many bytes were read."""


class Line(NamedTuple):
    """A line of a program: its file, its number from 1, its text without the line end."""

    file: str
    number: int
    text: str


class Place(NamedTuple):
    """The position of a line in its file: bytes and lines before it."""

    offset: int
    number: int


class BlockError(Exception):
    """An error in a block, before its position in the file is known.

    word   the word as the message shows it; its letter is looked for in the line if `index` is missing
    index  characters before it in the line as `compact` leaves it
    column its column in the line as it is, from 1, where that is known
    """

    def __init__(self, reason: str, word: str = "", index: int | None = None, column: int | None = None) -> None:
        self.reason, self.word, self.index, self.column = Text(reason), word, index, column
        super().__init__(self.reason)


class LineReader:
    """Reads the lines of a file, and can return to an earlier position."""

    def __init__(self, path: Path) -> None:
        """Open the file for its first line; raise at once if it cannot be read."""
        self.name = str(path)
        self._path = path
        self._file: BufferedReader | None = None
        self._open().close()
        self._offset = self._number = self._last = 0
        self.furthest = 0

    def _open(self) -> BufferedReader:
        try:
            if self._path.is_dir():
                raise FileError(f"{self.name}: this is a folder, a part program is a file")
            if self._path.exists() and not self._path.is_file():
                raise FileError(f"{self.name}: is a device or pipe, not a file; copy it to a file first")
            return self._path.open("rb")
        except OSError as error:
            raise FileError(f"{self.name}: cannot be read: {error.strerror or error}") from None

    @property
    def place(self) -> Place:
        """The position of the next line."""
        return Place(self._offset, self._number)

    @property
    def last(self) -> Place:
        """The position of the line that was read last."""
        return Place(self._last, self._number - 1)

    def go(self, place: Place) -> None:
        """Continue reading at a position."""
        self._offset, self._number = place
        if self._file is None:
            self._file = self._open()
        self._file.seek(self._offset)

    def read(self) -> Line | None:
        """Return the next line; None behind the last one."""
        if self._file is None:
            self._file = self._open()
        raw = self._file.readline(LONGEST_LINE + 1)
        if not raw:
            return None
        self._number += 1
        self._last = self._offset
        if self._offset == 0:
            raw = self._marked(raw)
        if len(raw) > LONGEST_LINE:
            raise ProgramError(
                self.name,
                self._number,
                LONGEST_LINE + 1,
                "",
                f"the line is longer than {LONGEST_LINE} bytes: a part program has short lines, is this one?",
            )
        self._offset += len(raw)
        return Line(self.name, self._number, raw.decode("utf-8", "replace").rstrip("\r\n"))

    def _marked(self, raw: bytes) -> bytes:
        """Return the first line without the byte order mark of UTF-8; refuse that of UTF-16."""
        if raw.startswith((BOM_UTF16_LE, BOM_UTF16_BE)):
            reason = "the file has two bytes for each character (UTF-16): save it as plain text (UTF-8)"
            raise ProgramError(self.name, 1, 1, "", reason)
        if raw.startswith(BOM_UTF8):
            self._offset += len(BOM_UTF8)
            return raw[len(BOM_UTF8) :]
        return raw

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
            self._file = None


def located(line: Line, fault: BlockError) -> ProgramError:
    """Return the error of a faulty line with file, line and column."""
    column = fault.column or 1
    if fault.column is None and fault.index is not None:
        kept = _kept(line.text)
        column = (kept[fault.index] if fault.index < len(kept) else len(line.text.rstrip())) + 1
    elif fault.column is None and fault.word:
        kept = _kept(line.text)
        column = 1 + next((i for i in kept if line.text[i].lower() == fault.word[0].lower()), kept[0] if kept else 0)
    return ProgramError(line.file, line.number, column, plain(fault.word), fault.reason)


def _kept(text: str) -> list[int]:
    """Return the indices of the characters of a line that are neither white space nor comment."""
    kept: list[int] = []
    inside = False
    for index, letter in enumerate(text):
        if inside:
            inside = letter != ")"
        elif letter == ";":
            break
        elif letter == "(":
            inside = True
        elif not letter.isspace():
            kept.append(index)
    return kept


def compact(text: str) -> tuple[str, list[str]]:
    """Return a line in lower case without white space and comments, and its comments in parentheses.

    White space means nothing in RS-274, not even inside a number: `g0x +0. 12 34y 7` is `g0x+0.1234y7`.
    """
    if "(" not in text:
        return "".join(text.partition(";")[0].split()).lower(), []
    kept: list[str] = []
    comments: list[str] = []
    rest = text
    while rest:
        opened, ended = rest.find("("), rest.find(";")
        if opened < 0 or 0 <= ended < opened:
            kept.append(rest if ended < 0 else rest[:ended])
            break
        kept.append(rest[:opened])
        closed = rest.find(")", opened)
        inner = rest[opened + 1 :] if closed < 0 else rest[opened + 1 : closed]
        if closed < 0 or "(" in inner:
            shown = "(" + (inner if len(inner) <= 20 else inner[:17] + "...")
            what = "a comment opens inside a comment" if closed >= 0 else "the comment has no closing parenthesis"
            raise BlockError(f"{what}: write ) before it", shown, column=len(text) - len(rest) + opened + 1)
        comments.append(inner)
        rest = rest[closed + 1 :]
    return "".join("".join(kept).split()).lower(), comments

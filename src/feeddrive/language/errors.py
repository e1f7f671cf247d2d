"""The errors that a user can cause, and the parts of their messages."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any, ClassVar

from feeddrive.language.text import Text, capitalized, keeps_marks, marked, marks, split


def nearest(name: str, allowed: Iterable[str]) -> str:
    """`; did you mean a or b?`, or `; there are: ...` (at most 20) if no name is similar."""
    known = list(allowed)
    near = get_close_matches(name, known, 3) or [candidate for candidate in known if candidate.lower() == name.lower()]
    if near:
        return f"; did you mean {' or '.join(near)}?"
    if not known:
        return "; nothing is expected here"
    return f"; there are: {', '.join(known[:20])}{', ...' if len(known) > 20 else ''}"


class FeeddriveError(Exception):
    """Base of all errors that a user can cause; the command line prints it without a traceback.

    `exit_code` is the code with which the command line ends: 2 if what was given is wrong or missing, 1 if it was
    understood and the answer is no, 130 after Ctrl-C.
    """

    exit_code: ClassVar[int] = 2

    def __init__(self, *args: object) -> None:
        super().__init__(*(Text(argument) if isinstance(argument, str) else argument for argument in args))

    def __format__(self, form: str) -> str:
        """The message, with its quantities in a text of feeddrive that quotes it."""
        message = self.args[0] if len(self.args) == 1 else str(self)
        text = message if isinstance(message, str) else str(message)
        return marked(text) if not form and keeps_marks() else format(str(self), form)


class ParameterError(FeeddriveError):
    """A parameter is missing, of the wrong type, not finite, or outside its declared bounds."""


class StructureError(FeeddriveError):
    """Blocks that do not fit each other, or a block class that breaks the rules of blocks."""


class LanguageError(StructureError, TypeError):
    """A law that leaves plain arithmetic and `ops`; the message says what to write instead, and where."""


class NoSlopeError(ParameterError):
    """A step without a finite slope where a linear model is needed; the message names the line that is too steep."""

    exit_code = 1


class FileError(FeeddriveError):
    """A file that cannot be read, understood or written; the message starts with the file's name."""


class ProgramError(FileError):
    """A part program that cannot be read: file, line and column (from 1), the word, the reason with what to do."""

    def __init__(self, file: str, line: int, column: int, word: str, reason: str) -> None:
        at = f"{file}, line {line}" + (f", column {column}" if column else "")
        super().__init__(f"{at}: {word}: {reason}" if word else f"{at}: {reason}")
        self.file, self.line, self.column, self.word, self.reason = file, line, column, word, reason


class NotPlannedError(FeeddriveError):
    """A part program whose motion cannot be used: its proof does not hold, or it is too long for what asks for it."""

    exit_code = 1


class LogError(FeeddriveError):
    """A measured log that cannot be used: empty, truncated, with gaps, or on a non-uniform clock."""


class NotIdentifiableError(LogError):
    """A valid log without enough information for the requested parameters; the message says what to measure next."""

    exit_code = 1


class DivergedError(FeeddriveError):
    """A simulated loop left its bounds; the message names the sample at which it did."""

    exit_code = 1


class UnstableError(FeeddriveError):
    """A closed loop that is not stable where a stable one is required."""

    exit_code = 1


class NotCertifiedError(FeeddriveError):
    """A loop that cannot be certified; the message says at which frequency, by how much, and what to do."""

    exit_code = 1


class BusError(FeeddriveError):
    """A drive on a field bus that is missing, differs from its declaration, or does not follow a command."""

    exit_code = 1


class AbortedError(BusError):
    """A motion on a real or virtual drive that was ended before its end; the message says by what."""


class WrongSignError(ParameterError):
    """A measured response with a sign at an encoder that is impossible for an axis of the requested structure."""


class WorkerError(FeeddriveError):
    """Processes or workers of a long work that end by themselves, or cannot be reached; what is done is kept."""

    exit_code = 1


class CancelledError(FeeddriveError):
    """Work that was canceled on request; the message says what is there of it, nothing for most."""

    exit_code = 130


class MissingExtraError(FeeddriveError):
    """An optional dependency is needed and not installed; the message holds the install command."""

    def __init__(self, package: str, extra: str, purpose: str) -> None:
        super().__init__(
            f"{purpose} needs the package '{package}', which is not installed: run  pip install 'feeddrive[{extra}]'"
        )


class MissingProgramError(FeeddriveError):
    """A program of the system is needed and not found; the message holds the name of its package."""

    def __init__(self, program: str, package: str, purpose: str) -> None:
        super().__init__(f"{purpose} needs the program '{program}', which is not found: run  apt-get install {package}")


class FmuError(FeeddriveError):
    """An FMU that cannot be loaded, lacks a required variable, or refuses a call; the message quotes the FMU."""


def plain(text: str) -> str:
    """Replace line ends and other control characters, which may come from a damaged file; quantities stay."""
    if text.isprintable():
        return text
    kept = Text("".join(piece if is_mark else _printable(piece) for piece, is_mark in split(marked(text))))
    is_safe = kept.isprintable() and all(part.isprintable() for mark in marks(kept) for part in mark)
    return kept if is_safe else _printable(text)


def _printable(text: str) -> str:
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def sentence(text: str) -> str:
    """A remark as a sentence: a capital at the start, unless that is a name, and a full stop."""
    first = text.split(" ", 1)[0].rstrip(":,;")
    return Text(f"{capitalized(text) if first.isalpha() else text}.")


def shown(value: Any) -> str:
    """A value for a message: short, on one line."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int) and abs(value) >= 10**20:
        return "a whole number of more than 20 digits"
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."

"""The errors that a user can cause, and helpers for their messages."""

from collections.abc import Iterable
from typing import Any, ClassVar

from feeddrive.language.text import Text, capitalized, keeps_marks, marked, marks, split


def nearest(name: str, allowed: Iterable[str]) -> str:
    """Return a hint: `; did you mean a or b?` or, if no name is similar, `; there are: ...` (at most 20 names)."""
    from difflib import get_close_matches  # only for a message

    names = list(allowed)
    # get_close_matches finds no letter in common in the other case, as in ppi for P-PI
    near = [known for known in names if _letters(known) == _letters(name)] or get_close_matches(name, names, 3)
    if near:
        return f"; did you mean {' or '.join(near)}?"
    if not names:
        return "; nothing is expected here"
    return f"; there are: {', '.join(names[:20])}{', ...' if len(names) > 20 else ''}"


def _letters(name: str) -> str:
    return "".join(filter(str.isalnum, name)).lower()


class FeeddriveError(Exception):
    """The base class of all errors that a user can cause; the command line prints them without a traceback.

    `exit_code` is the exit code of the command line: 2 if the input is wrong or missing, 1 if the input is valid but
    the result is negative, 130 after Ctrl-C.
    """

    exit_code: ClassVar[int] = 2

    def __init__(self, *args: object) -> None:
        super().__init__(*(Text(argument) if isinstance(argument, str) else argument for argument in args))

    def __format__(self, form: str) -> str:
        """Return the message; in an f-string within feeddrive, its quantities remain convertible to other units."""
        message = self.args[0] if len(self.args) == 1 else str(self)
        text = message if isinstance(message, str) else str(message)
        return marked(text) if not form and keeps_marks() else format(str(self), form)


class ParameterError(FeeddriveError):
    """A parameter that is missing, of the wrong type, not finite, or outside its declared bounds."""


class StructureError(FeeddriveError):
    """Incompatible blocks, or a block class that violates the rules for blocks."""


class LanguageError(StructureError, TypeError):
    """A law that uses more than plain arithmetic and `ops`; the message gives the line and the replacement."""


class NoSlopeError(ParameterError):
    """A step without a finite derivative where a linear model is needed; the message names the source line."""

    exit_code = 1


class FileError(FeeddriveError):
    """A file that cannot be read, parsed or written; the message starts with the file's name."""


class ProgramError(FileError):
    """A part program that cannot be read; the message gives file, line, column (from 1), word, reason and remedy."""

    def __init__(self, file: str, line: int, column: int, word: str, reason: str) -> None:
        at = f"{file}, line {line}" + (f", column {column}" if column else "")
        super().__init__(f"{at}: {word}: {reason}" if word else f"{at}: {reason}")
        self.file, self.line, self.column, self.word, self.reason = file, line, column, word, reason


class NotPlannedError(FeeddriveError):
    """A part program whose planned motion cannot be used, because its limits are not proven or it is too long."""

    exit_code = 1


class LogError(FeeddriveError):
    """A measured log that cannot be used: empty, truncated, with gaps, or sampled non-uniformly."""


class NotIdentifiableError(LogError):
    """A valid log with too little information for the requested parameters; the message states what to measure next."""

    exit_code = 1


class DivergedError(FeeddriveError):
    """A simulated loop that diverged; the message names the sample at which it left its bounds."""

    exit_code = 1


class UnstableError(FeeddriveError):
    """A closed loop that is not stable where a stable one is required."""

    exit_code = 1


class NotCertifiedError(FeeddriveError):
    """A loop that cannot be certified; the message gives the frequency, the size of the violation and the remedy.

    draft  what was tried, as a `Certificate` that the checker refuses: for pictures; None if there is nothing to draw
    """

    exit_code = 1

    def __init__(self, message: str, draft: object = None) -> None:
        super().__init__(message)
        self.draft = draft


class BusError(FeeddriveError):
    """A drive on a field bus that is missing, differs from its declaration, or does not follow a command."""

    exit_code = 1


class AbortedError(BusError):
    """A motion on a real or virtual drive that was aborted; the message gives the cause."""


class WrongSignError(ParameterError):
    """A measured response whose sign at one encoder is impossible for an axis of the requested structure."""


class WorkerError(FeeddriveError):
    """Crashed or unreachable worker processes of a long-running job; results finished before are preserved."""

    exit_code = 1


class CancelledError(FeeddriveError):
    """A job that was canceled on request; the message states which results were saved, usually none."""

    # 128 + 2: the exit code of shells after SIGINT
    exit_code = 130


class MissingExtraError(FeeddriveError):
    """An optional dependency that is required but not installed; the message contains the install command."""

    def __init__(self, package: str, extra: str, purpose: str) -> None:
        super().__init__(
            f"{purpose} needs the package '{package}', which is not installed: run  pip install 'feeddrive[{extra}]'"
        )


class MissingProgramError(FeeddriveError):
    """A system program that is required but not found; the message names its package."""

    def __init__(self, program: str, package: str, purpose: str) -> None:
        self.remedy = self.install([package])
        super().__init__(f"{purpose} needs the program '{program}', which is not found: run  {self.remedy}")

    @staticmethod
    def install(packages: Iterable[str]) -> str:
        """Return the command that installs packages, on Debian, Ubuntu and what derives from them."""
        return f"apt-get install {' '.join(dict.fromkeys(packages))}"


class FmuError(FeeddriveError):
    """An FMU that cannot be loaded, lacks a required variable, or rejects a call; the message quotes the FMU."""


def plain(text: str) -> str:
    """Replace line breaks and other control characters, which damaged files may contain; quantities are preserved."""
    if text.isprintable():
        return text
    kept = Text("".join(piece if is_mark else _printable(piece) for piece, is_mark in split(marked(text))))
    # the fields of a mark come from the same text: if they are damaged, the quantities are given up
    is_safe = kept.isprintable() and all(part.isprintable() for mark in marks(kept) for part in mark)
    return kept if is_safe else _printable(text)


def _printable(text: str) -> str:
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def sentence(text: str) -> str:
    """Turn a remark into a sentence: capitalize the first word unless it is an identifier, and add a period."""
    first = text.split(" ", 1)[0].rstrip(":,;")
    return Text(f"{capitalized(text) if first.isalpha() else text}.")


def shown(value: Any) -> str:
    """Format a value for a message, on one line and shortened if necessary."""
    if isinstance(value, bool):
        return "true" if value else "false"
    # repr raises ValueError for an integer of more than 4300 digits, which a file may contain
    if isinstance(value, int) and abs(value) >= 10**20:
        return "a whole number of more than 20 digits"
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."

"""A command: a function with a declared request, one protocol for its progress, and an outcome that shows itself.

The same object serves Python (`fd.tune("ball_screw", goal="stiffness")`), the command line and, later, a page.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Generic, ParamSpec, TypeVar

from feeddrive.language.errors import FeeddriveError
from feeddrive.language.progress import Progress
from feeddrive.language.table import Table
from feeddrive.workflow.request import OUT, Request, fields_of

P = ParamSpec("P")
R = TypeVar("R", bound=Request)
T = TypeVar("T")


@dataclass(frozen=True, repr=False)
class Outcome(Generic[T]):
    """What a command came to.

    result    the object of the analysis
    tables    what is shown first, with sentences between tables
    remarks   what must be known of it
    verdict   one sentence that says what to do, or what came out
    notes     what follows from the verdict
    section   text to be pasted into a file
    files     what was written, by what it is
    failure   None if all is well; else why the result is not what it should be, empty if the verdict says it
    error     what ended the work early, after something was done that is worth keeping
    """

    result: T
    tables: Sequence[Table | str] = ()
    remarks: Sequence[str] = ()
    verdict: str = ""
    notes: Sequence[str] = ()
    section: str = ""
    files: Mapping[str, str | Path] = field(default_factory=dict[str, str | Path])
    failure: str | None = None
    error: FeeddriveError | None = None

    def said(self) -> Iterator[Table | str]:
        """What a person reads of the result, in order."""
        yield from self.tables
        yield from (f"- {remark}" for remark in self.remarks)
        if self.verdict:
            yield self.verdict
        yield from (f"- {note}" for note in self.notes)

    def written(self) -> Iterator[str]:
        """What may be pasted, and where files were written."""
        if self.section:
            yield ""
            yield self.section
        yield from (f"{what}: {path}" for what, path in self.files.items())

    def __repr__(self) -> str:
        return "\n".join(map(str, (*self.said(), *self.written())))


class Command(Generic[P, R, T]):
    """A function of a request and a progress, which may also be called with the fields of the request.

    Nothing is written unless the request names where: `out` is a field of it.
    """

    def __init__(self, request: Callable[P, R], work: Callable[[R, Progress], Outcome[T]]) -> None:
        self.request, self.work = request, work
        self.__doc__, self.__name__, self.__module__ = work.__doc__, work.__name__, work.__module__
        self.__signature__ = inspect.signature(request)

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> Outcome[T]:
        """Do the work silently."""
        return self.run(self.request(*args, **kwargs))

    def run(self, request: R, progress: Progress | None = None) -> Outcome[T]:
        """Do the work that a request asks for. A place that cannot be written is refused before the work."""
        for each in fields_of(type(request)):
            place = getattr(request, each.name)
            if each.declared.meaning == OUT and place is not None:
                from feeddrive.files.atomic_io import check_directory

                check_directory(place)
        return self.work(request, progress or Progress())


def command(request: Callable[P, R]) -> Callable[[Callable[[R, Progress], Outcome[T]]], Command[P, R, T]]:
    """Make a command of a function: `@command(TuneRequest)`."""
    return lambda work: Command(request, work)

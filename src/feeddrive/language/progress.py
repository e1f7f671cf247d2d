"""Progress: one protocol by which long computations report steps and remarks and can be canceled.

    def long_work(..., progress: Progress) -> ...:
        for k, each in enumerate(pieces):
            progress.step(each.name, k, len(pieces))  # raises CancelledError after a cancel

The base class `Progress` shows nothing.  Subclasses override `show_step`, `show_remark` and `confirm`: the command line
shows a bar, a page sends a message to the browser.  Canceled work writes no files: all files of a result are written
at its end, completely or not at all.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from feeddrive.language.errors import CancelledError
from feeddrive.language.table import Table


class Progress:
    """What long work tells, and whether it shall go on. `cancel` may be called from another thread."""

    def __init__(self) -> None:
        self._cancelled = threading.Event()

    @property
    def cancelled(self) -> bool:
        """True once somebody has asked the work to stop."""
        return self._cancelled.is_set()

    def cancel(self) -> None:
        """Ask the work to stop; it ends at its next step with CancelledError."""
        self._cancelled.set()

    def step(self, what: str, done: int | None = None, of: int | None = None, part: str = "") -> None:
        """Tell what begins now, how much is done and of how much; `part` names one of several that run side by side.

        Raises CancelledError if the work was cancelled.
        """
        self.check()
        self.show_step(what, done, of, part)

    def check(self) -> None:
        """Raise CancelledError if the work was cancelled; for work that waits and has nothing to tell."""
        if self.cancelled:
            raise CancelledError("the work was cancelled; nothing was written")

    def remark(self, said: str | Table) -> None:
        """Say something that must be known before the work is over, such as a guess that it rests on."""
        self.show_remark(said)

    def counted(self, of: int) -> Callable[[str], None]:
        """A function for work that tells only what begins: it counts the steps, of which there are `of`."""
        done = 0

        def step(what: str) -> None:
            nonlocal done
            self.step(what, done, of)
            done += 1

        return step

    def show_step(self, what: str, done: int | None, of: int | None, part: str) -> None:
        """What a step looks like; silent unless overridden. It never raises."""

    def show_remark(self, said: str | Table) -> None:
        """What a remark looks like; silent unless overridden."""

    def confirm(self, question: str) -> bool:
        """Ask a person; False where there is none."""
        return False

"""Long computations: progress and cancel by one protocol, and the processes that they run in.

    def long_work(..., progress: Progress) -> ...:
        for k, piece in enumerate(pieces):
            progress.step(piece.name, k, len(pieces))  # raises CancelledError after a cancel

The base class `Progress` shows nothing.  Subclasses override `show_step`, `show_remark` and `confirm`: the command line
shows a bar, a page sends a message to the browser.  Canceled work writes no files: all files of a result are written
at its end, completely or not at all.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Generator

from feeddrive.language.errors import CancelledError
from feeddrive.language.table import Table

ENDINGS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Signals of Ctrl-C, of a service manager and of a closing terminal: work is canceled in order on all of them."""


class Progress:
    """Reports of long work, and its cancellation. `cancel` may be called from another thread."""

    def __init__(self) -> None:
        self._cancelled = threading.Event()

    @property
    def cancelled(self) -> bool:
        """True after a cancel."""
        return self._cancelled.is_set()

    def cancel(self) -> None:
        """Ask the work to stop; it ends at its next step with CancelledError."""
        self._cancelled.set()

    def step(self, what: str, done: int | None = None, of: int | None = None, part: str = "") -> None:
        """Report the step that begins, and how many of how many are done; `part` names one of several parallel jobs.

        Raises CancelledError if the work was cancelled.
        """
        self.check()
        self.show_step(what, done, of, part)

    def check(self) -> None:
        """Raise CancelledError if the work was cancelled; for work that waits and has nothing to report."""
        if self.cancelled:
            raise CancelledError("stopped; nothing was written")

    def remark(self, message: str | Table) -> None:
        """Report a remark before the end of the work, such as an assumption that it depends on."""
        self.show_remark(message)

    def counted(self, of: int) -> Progress:
        """Return the progress for work that reports only the names of its steps: it counts them up to `of`.

        A step that reports its own count is passed on as it is, and does not add to this one.
        """
        return _Forwarded(self, of=of)

    def named(self, part: str) -> Progress:
        """Return the progress of one of several parallel jobs: its steps carry the name."""
        return _Forwarded(self, part=part)

    def show_step(self, what: str, done: int | None, of: int | None, part: str) -> None:
        """Show a step; silent unless overridden. It never raises."""

    def show_remark(self, message: str | Table) -> None:
        """Show a remark; silent unless overridden."""

    def better(self, cost: float, best: object) -> None:
        """Report the best result of a search so far, and its cost: lower is better."""
        self.show_better(cost, best)

    def show_better(self, cost: float, best: object) -> None:
        """Show the best result so far; silent unless overridden."""

    def confirm(self, question: str) -> bool:
        """Ask the user for a confirmation; False without a user."""
        return False


class _Forwarded(Progress):
    """The progress of a part of a work: it reports to the progress of the whole, and is canceled with it."""

    def __init__(self, whole: Progress, part: str = "", of: int | None = None) -> None:
        super().__init__()
        self._whole, self._part, self._of, self._begun = whole, part, of, 0

    @property
    def cancelled(self) -> bool:
        return self._whole.cancelled

    def cancel(self) -> None:
        self._whole.cancel()

    def show_step(self, what: str, done: int | None, of: int | None, part: str) -> None:
        if self._of is not None and of is None:
            done, of = self._begun, self._of
            self._begun += 1
        self._whole.show_step(what, done, of, part or self._part)

    def show_remark(self, message: str | Table) -> None:
        self._whole.show_remark(message)

    def show_better(self, cost: float, best: object) -> None:
        self._whole.show_better(cost, best)

    def confirm(self, question: str) -> bool:
        return self._whole.confirm(question)


_THREADS = "OPENBLAS_NUM_THREADS"


@contextlib.contextmanager
def one_thread() -> Generator[None]:
    """Let processes that start in this context use one thread for matrices: otherwise they compete for cores."""
    before = os.environ.get(_THREADS)
    os.environ[_THREADS] = "1"
    try:
        yield
    finally:
        os.environ.pop(_THREADS)
        if before is not None:
            os.environ[_THREADS] = before


def follow_parent() -> None:
    """Call this in a child process: it then ignores Ctrl-C, which is for its parent, and ends when the parent ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def follow() -> None:
        parent.join()
        os._exit(1)  # the thread that computes may be in machine code for a while

    threading.Thread(target=follow, daemon=True).start()

"""The progress and cancellation protocol of long computations, and helpers for their processes.

    def long_work(..., progress: Progress) -> ...:
        for k, piece in enumerate(pieces):
            progress.step(piece.name, k, len(pieces))  # raises CancelledError after a cancel

The base class `Progress` shows nothing.  Subclasses override `show_step`, `show_remark` and `confirm`: the command line
shows a progress bar, a page sends a message to the browser.  A canceled job writes no files: all files of a result are
written at its end, completely or not at all.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Generator

from feeddrive.language.errors import CancelledError
from feeddrive.language.table import Table

ENDINGS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""The signals of Ctrl-C, of a service manager and of a closing terminal; each cancels the job in an orderly way."""


class Progress:
    """The progress reports of a long-running job, and its cancellation. `cancel` may be called from another thread."""

    def __init__(self) -> None:
        self._cancelled = threading.Event()

    @property
    def cancelled(self) -> bool:
        """True after a call of `cancel`."""
        return self._cancelled.is_set()

    def cancel(self) -> None:
        """Request cancellation; the job ends at its next step with CancelledError."""
        self._cancelled.set()

    def step(self, what: str, done: int | None = None, of: int | None = None, part: str = "") -> None:
        """Report the start of a step, with `done` of `of` steps completed; `part` names one of several parallel jobs.

        Raises CancelledError if the job was canceled.
        """
        self.check()
        self.show_step(what, done, of, part)

    def check(self) -> None:
        """Raise CancelledError if the job was canceled; for use while a job waits and has nothing to report."""
        if self.cancelled:
            raise CancelledError("stopped; nothing was written")

    def remark(self, message: str | Table) -> None:
        """Report a remark before the end of the job, such as an assumption on which the result depends."""
        self.show_remark(message)

    def counted(self, of: int) -> Progress:
        """Return a `Progress` that counts `of` steps, for a job that reports only the names of its steps.

        A step that reports its own count is passed on unchanged and not counted.
        """
        return _Forwarded(self, of=of)

    def named(self, part: str) -> Progress:
        """Return the progress of one of several parallel jobs; its steps carry the job's name."""
        return _Forwarded(self, part=part)

    def quiet(self) -> Progress:
        """Return the progress of a part of a job whose remarks would repeat those of another part: they are dropped."""
        return _Forwarded(self, quiet=True)

    def show_step(self, what: str, done: int | None, of: int | None, part: str) -> None:
        """Show a step; does nothing unless overridden, and never raises."""

    def show_remark(self, message: str | Table) -> None:
        """Show a remark; does nothing unless overridden."""

    def better(self, cost: float, best: object) -> None:
        """Report the best result of a search so far and its cost; lower is better."""
        self.show_better(cost, best)

    def show_better(self, cost: float, best: object) -> None:
        """Show the best result so far; does nothing unless overridden."""

    def confirm(self, question: str) -> bool:
        """Ask the user for confirmation; return False if there is no user."""
        return False

    def measured(self, question: str, expected: float, unit: str) -> float | None:
        """Ask the user for a measured value in an SI unit; return None if there is no user, or no value."""
        return None


class _Forwarded(Progress):
    """The progress of a part of a job. It forwards reports to the progress of the whole job and is canceled with it."""

    def __init__(self, whole: Progress, part: str = "", of: int | None = None, *, quiet: bool = False) -> None:
        super().__init__()
        self._whole, self._part, self._of, self._begun, self._quiet = whole, part, of, 0, quiet

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
        if not self._quiet:
            self._whole.show_remark(message)

    def show_better(self, cost: float, best: object) -> None:
        self._whole.show_better(cost, best)

    def measured(self, question: str, expected: float, unit: str) -> float | None:
        return self._whole.measured(question, expected, unit)

    def confirm(self, question: str) -> bool:
        return self._whole.confirm(question)


_THREADS = "OPENBLAS_NUM_THREADS"


@contextlib.contextmanager
def one_thread() -> Generator[None]:
    """Limit processes started in this context to one BLAS thread each, so that they do not compete for cores."""
    before = os.environ.get(_THREADS)
    # OpenBLAS reads it once, when it is loaded: it must be set before the process starts
    os.environ[_THREADS] = "1"
    try:
        yield
    finally:
        os.environ.pop(_THREADS)
        if before is not None:
            os.environ[_THREADS] = before


def follow_parent(first: Callable[[], None] = lambda: None) -> None:
    """Make this child process ignore Ctrl-C, which its parent handles, and exit when the parent exits.

    first  what is done before that, from a thread
    """
    import multiprocessing  # only a child process needs it

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def follow() -> None:
        parent.join()
        first()
        # not sys.exit: the computing thread may be in machine code for a while
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()

"""Child processes that do not compete for cores, and end with their parent."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Generator

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

"""Processes of one's own, begun so that they neither stand in each other's way nor outlive their work."""

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
    """Processes that begin here leave small matrices to one thread: several of them stand in each other's way."""
    before = os.environ.get(_THREADS)
    os.environ[_THREADS] = "1"
    try:
        yield
    finally:
        os.environ.pop(_THREADS)
        if before is not None:
            os.environ[_THREADS] = before


def follow_parent() -> None:
    """To be called in a process: Ctrl-C is for the one that began it, and it ends with that one, however that ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def follow() -> None:
        parent.join()
        os._exit(1)  # the thread that computes may be in machine code for a while

    threading.Thread(target=follow, daemon=True).start()

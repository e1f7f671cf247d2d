"""Progress of a command in a notebook: a line under the cell while it runs, which is gone when the work is done.

A command that is called in a cell of Jupyter or marimo shows it without being asked. Any other `Progress` that is given
as `progress=` takes its place: the one of `feeddrive.language.progress` shows nothing.  Neither package is imported
unless its notebook already runs.
"""

from __future__ import annotations

import html
import sys
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any

from feeddrive.language.progress import Progress
from feeddrive.language.quantity import USUAL
from feeddrive.language.table import Table
from feeddrive.language.text import Text, resolve

_AFTER = 0.5  # s of work before the line appears: quick commands show none
_EVERY = 0.2  # s between two changes of the line


class CellProgress(Progress):
    """Progress shown by a function that replaces the text under a cell; an empty text removes it.

    write  shows a text (HTML)
    """

    def __init__(self, write: Callable[[str], None]) -> None:
        super().__init__()
        self._write = write
        self._begun = self._shown = time.monotonic()
        self._visible = False

    def show_step(self, what: str, done: int | None, of: int | None, part: str) -> None:
        """Replace the line, at most five times a second."""
        now = time.monotonic()
        if now - self._begun < _AFTER or now - self._shown < _EVERY:
            return
        self._shown, self._visible = now, True
        words = html.escape(resolve(Text(f"{part}: {what}" if part else what), USUAL))
        bar = "" if of is None else f'<progress max="{of}" value="{done or 0}"></progress> '
        self._write(f"<small>{bar}{words}, {now - self._begun:.0f} s</small>")

    def show_remark(self, message: str | Table) -> None:
        """Print a remark, which stays."""
        sys.stdout.write(f"{message if isinstance(message, Table) else resolve(Text(message), USUAL)}\n")

    def clear(self) -> None:
        """Remove the line."""
        if self._visible:
            self._write("")
            self._visible = False


def writer() -> Callable[[str], None] | None:
    """Return the function that replaces the text under the running cell; None outside of a notebook."""
    ipython: Any = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    # a terminal IPython has no cell under which a line could be replaced
    if shell is not None and hasattr(shell, "kernel"):
        return _in_jupyter()
    marimo: Any = sys.modules.get("marimo")
    if marimo is not None and marimo.running_in_notebook():
        return lambda text: marimo.output.replace(marimo.Html(text) if text else None)
    return None


def _in_jupyter() -> Callable[[str], None]:
    display: Any = sys.modules["IPython"].display
    handles: list[Any] = []

    def write(text: str) -> None:
        if handles:
            handles[0].update(display.HTML(text))
        else:
            handles.append(display.display(display.HTML(text), display_id=True))

    return write


@contextmanager
def cell_progress() -> Generator[Progress | None]:
    """Yield the progress of the notebook in which this runs, None outside of one; its line is removed at the end."""
    write = writer()
    if write is None:
        yield None
        return
    progress = CellProgress(write)
    try:
        yield progress
    finally:
        progress.clear()

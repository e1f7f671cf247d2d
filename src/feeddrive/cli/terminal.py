"""Terminal output: progress, tables and sentences; lines are not wrapped if the output is a pipe or a file."""

from __future__ import annotations

import logging
import math
import os
import sys
import warnings
from collections.abc import Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Self

import typer

from feeddrive.language.progress import Progress
from feeddrive.language.table import Grid, Table, visible
from feeddrive.language.text import Text

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, RenderResult

UNBROKEN = 1_000_000
"""The width, in columns, of an output that is not a terminal: wider than any sentence with its paths."""


# as rulers and protractors have them
_RULERS = {"m": ("mm", 1e-3), "rad": ("deg", math.pi / 180.0)}


@contextmanager
def own_words() -> Generator[None]:
    """Suppress warnings and log messages of libraries on the terminal, also in worker processes.

    Warnings requested by `python -W` or PYTHONWARNINGS are shown as usual.
    """
    # with no handler at all, logging would print warnings to the error stream by its handler of last resort
    asked, silent = bool(sys.warnoptions), logging.NullHandler()
    logging.getLogger().addHandler(silent)
    try:
        with warnings.catch_warnings():
            if not asked:
                warnings.simplefilter("ignore")
                # filters are not inherited by spawned worker processes, the environment is
                os.environ["PYTHONWARNINGS"] = "ignore"
            yield
    finally:
        logging.getLogger().removeHandler(silent)
        if not asked:
            os.environ.pop("PYTHONWARNINGS", None)


def open_console(*, errors: bool = False) -> Console:
    """Return a console on the standard output, or on the error stream if `errors` is True.

    If the output is JSON, progress and questions use the error stream.  The console is as wide as the
    terminal; if the stream is not a terminal, its width is unlimited, regardless of COLUMNS.
    """
    from rich.console import Console  # not for `--help`

    stream = sys.stderr if errors else sys.stdout
    return Console(highlight=False, stderr=errors, width=None if stream.isatty() else UNBROKEN)


def show(console: Console, content: Table | Grid | str, *, soft_wrap: bool = False) -> None:
    """Print a table, or a sentence wrapped between words; control sequences are escaped (see `visible`)."""
    if isinstance(content, Table | Grid):
        console.print(DrawnTable(content if isinstance(content, Grid) else content.grid()))
    else:
        console.print(visible(Text(content)), markup=False, soft_wrap=soft_wrap)


class TerminalProgress(Progress):
    """A progress bar with a line for each part of the work, removed at the end."""

    def __init__(self, console: Console) -> None:
        super().__init__()
        self._console = console
        self._bar: Any = None
        self._tasks: dict[str, Any] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def show_step(self, what: str, done: int | None, of: int | None, part: str) -> None:
        """Update the progress bar."""
        if not self._console.is_terminal:
            return
        from rich.markup import escape

        # names from files may hold control sequences of the terminal and markup of rich
        text = escape(visible(Text(f"{part}: {what}" if part else what)))
        if self._bar is None:
            self._bar = _bar(self._console, counted=of is not None)
            self._bar.start()
        if part not in self._tasks:
            self._tasks[part] = self._bar.add_task(text, total=of)
        self._bar.update(self._tasks[part], description=text, completed=done, total=of)

    def show_remark(self, message: str | Table) -> None:
        """Print a remark immediately."""
        show(self._console, message, soft_wrap=True)
        self._console.file.flush()

    def confirm(self, question: str) -> bool:
        """Ask on the terminal; any answer other than yes ends the command."""
        typer.confirm(visible(Text(question)), abort=True, err=self._console.stderr)
        return True

    def measured(self, question: str, expected: float, unit: str) -> float | None:
        """Ask on the terminal for a value in mm or deg; Enter takes the expected one."""
        shown, factor = _RULERS.get(unit, (unit, 1.0))
        value = typer.prompt(
            visible(Text(f"{question} ({shown})")),
            default=round(expected / factor, 3),
            type=float,
            err=self._console.stderr,
        )
        return factor * float(value)


def _bar(console: Console, *, counted: bool) -> Any:
    from rich.progress import BarColumn, SpinnerColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    column = BarColumn() if counted else SpinnerColumn()
    return Bar(column, TextColumn("{task.description}"), TimeElapsedColumn(), console=console, transient=True)


class DrawnTable:
    """A table drawn by rich: headings and columns of sentences may wrap; no value is truncated.

    If the terminal is narrower than the values, the rows continue on the next line.
    """

    def __init__(self, table: Grid) -> None:
        from rich.box import SIMPLE_HEAD
        from rich.markup import escape
        from rich.table import Table as Shown

        self.table, self.drawn = table, Shown(box=SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
        for i, head in enumerate(table.heads):
            left = i in (0, table.sentences)
            widest = None if i == table.sentences else max((len(row[i]) for row in table.rows), default=None)
            self.drawn.add_column(head, justify="left" if left else "right", min_width=widest)
        for row in table.rows:
            self.drawn.add_row(*map(escape, row))

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        from rich.measure import Measurement
        from rich.text import Text

        # measured at a width that fits any table, since the actual width would already wrap its cells
        needed = Measurement.get(console, options.update_width(10_000), self.drawn).minimum
        if needed > options.max_width:
            yield Text(str(self.table), overflow="fold")
        else:
            yield Text(self.table.title, "italic")
            yield self.drawn

"""What a command shows while it works and when it is done."""

from __future__ import annotations

from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console, ConsoleOptions, RenderResult
from rich.markup import escape
from rich.measure import Measurement
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table as Shown
from rich.text import Text

from feeddrive.cli.terminal import open_console
from feeddrive.files.job import read_job
from feeddrive.language.table import Table
from feeddrive.workflow import jobs
from feeddrive.workflow.job_results import write_results


def perform(job: str, log: Path | None, out: Path) -> None:
    """Read a job, run it, write its results, and show a short table and the path of the report."""
    console = open_console()
    asked = read_job(job, log)
    bar = Progress(TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), console=console, transient=True)
    with bar:
        task = bar.add_task(escape(asked.title), total=len(asked.loops) + 2)

        def step(text: str) -> None:
            bar.update(task, description=escape(text), advance=1)

        comparison = jobs.run(asked, step)
        step("report")
        report = write_results(comparison, out)
    console.print(drawn(comparison.table()))
    for remark in (asked.rule, *comparison.remarks):
        if remark:
            console.print(f"- {remark}", markup=False)
    console.print(f"Report: {report}", markup=False, soft_wrap=True)


def drawn(table: Table, wrapped: int | None = None) -> Drawn:
    """A table for the terminal: heads may break their lines, and so may the column `wrapped`; no value is cut."""
    return Drawn(table, wrapped)


class Drawn:
    """What `drawn` gives; where the terminal is narrower than the values, the rows go on in the next line."""

    def __init__(self, table: Table, wrapped: int | None) -> None:
        self.table, self.made = table, Shown(box=SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
        for i, head in enumerate(table.heads):
            left = i == 0 or i == wrapped
            widest = None if i == wrapped else max((len(row[i]) for row in table.rows), default=None)
            self.made.add_column(head, justify="left" if left else "right", min_width=widest)
        for row in table.rows:
            self.made.add_row(*map(escape, row))

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        needed = Measurement.get(console, options.update_width(10_000), self.made).minimum
        if needed > options.max_width:
            yield Text(str(self.table), overflow="fold")
        else:
            yield Text(self.table.title, "italic")
            yield self.made
